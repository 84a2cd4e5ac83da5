"""What options take out of the joint is not in its program."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr
from joints import GROOVES, plain_joint

from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.constants import constants


def primitives(jaxpr: Jaxpr) -> list[str]:
    """Names of all primitives, inside calls and loops too, once for each number that comes out."""
    names = []
    for equation in jaxpr.eqns:
        names += [equation.primitive.name] * sum(x.aval.size for x in equation.outvars)
        for value in equation.params.values():
            for inner in value if isinstance(value, (tuple, list)) else (value,):
                if isinstance(inner, ClosedJaxpr):
                    names += primitives(inner.jaxpr)
                elif isinstance(inner, Jaxpr):
                    names += primitives(inner)
    return names


@functools.cache
def program(**options) -> tuple[int, tuple[str, ...]]:
    scene = plain_joint(**options)
    params = scene.parameters()
    y = jax.ShapeDtypeStruct((scene.states,), jnp.float64)
    c = jax.eval_shape(functools.partial(constants, scene), params)
    traced = jax.make_jaxpr(lambda t, y, c: system.field(t, y, (scene, c)))(0.0, y, c)
    return scene.states, tuple(primitives(traced.jaxpr))


SMALLER = [
    ({}, {"friction": False}),
    ({}, {"smoothing": False}),
    ({}, {"cage": "fixed"}),
    ({}, {"head": "fixed"}),
    ({}, {"track": "circular"}),
    ({}, {"law": "hertz"}),
    ({"spin": True}, {}),
    ({"window_ends": True}, {}),
    ({"bands": True}, {}),
    ({"drive": "flexible"}, {}),
    ({}, {"contacts": ("head_cage", "cage_ball", *GROOVES)}),
    ({}, {"contacts": ("cage_ball", *GROOVES)}),
    ({}, {"contacts": ("seat_cage", "head_cage", *GROOVES)}),
]


@pytest.mark.parametrize(("full", "less"), SMALLER, ids=[str(less or f"no {full}") for full, less in SMALLER])
def test_what_an_option_takes_out_is_not_in_the_program(full, less):
    assert len(program(**less)[1]) < len(program(**full)[1])


def test_a_frictionless_joint_has_no_friction_and_a_fixed_cage_no_state():
    assert "tanh" in program()[1]
    assert "tanh" not in program(friction=False)[1]
    assert program(friction=False)[0] == program()[0] == 2 * (18 + 11)
    assert program(cage="fixed")[0] == 2 * (18 + 5)
    assert program(head="fixed")[0] == 2 * (18 + 8)
    assert program(spin=True)[0] == (3 + 6) * 6 + 2 * 11
    assert program(balls=3)[0] == 2 * (9 + 11)
    for name, needed in (("friction_static", "friction"), ("smoothing", "smoothing")):
        assert name in plain_joint().quantities and name not in plain_joint(**{needed: False}).quantities
    assert "cage_mass" not in plain_joint(cage="fixed").quantities
    assert "clearance_seat_cage" not in plain_joint(cage="fixed").quantities
    assert "contact_angle" not in plain_joint(track="circular").quantities
    assert "drive_stiffness" in plain_joint(drive="flexible").quantities
