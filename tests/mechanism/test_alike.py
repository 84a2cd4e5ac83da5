"""Contacts that are alike are computed side by side: nothing that a mechanism answers may tell that they are."""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from by_numpy import by_numpy

from bcfj_jax import Body, Contact, Mechanism, gaps, loads
from bcfj_jax.contact.laws import FRICTION
from bcfj_jax.contact.laws import LAWS as LAWS_BY_NAME
from bcfj_jax.mechanism import alike, dynamics, rows, scales

COEFFICIENTS = {
    "stiffness": 1e6, "exponent": 1.5, "damping": 0.2, "restitution": 0.7, "radius": 2e-3, "smoothing": 1e-5,
    "friction_static": 0.3, "friction_dynamic": 0.2, "friction_speed": 0.01, "friction_stribeck": 0.02,
    "bristle_stiffness": 1e5, "bristle_damping": 1e-3,
}  # fmt: skip
LAWS = ["memory_free", "flores"]
FRICTIONS = [None, "brown_mcphee", "lugre"]


def tossed(law: str, friction: str | None) -> Mechanism:
    """A body with corners on the ground and on a table, in any order, one of its own law, one stiffer than the others."""
    rng = np.random.default_rng(3)
    body = Body("cube", "free", mass=1.0, inertia=(1e-3, 2e-3, 3e-3), start={"z": -0.005, "vx": 0.5, "wy": 2.0})
    table = Body("table", "slide", axis="x", mass=2.0)
    marks = [tuple(float(x) for x in rng.uniform(-0.04, 0.04, 3)) for _ in range(7)]
    options = {"law": law, "friction": friction}

    def corner(k: int, below: str, **more) -> Contact:
        return Contact(f"c{k}", (below, "cube"), gaps.SphereOnPlane(), at=((0, 0, 0), marks[k]), **(options | more))

    contacts = [
        corner(0, "ground"), corner(1, "table"), corner(2, "ground", law="kelvin_voigt"), corner(3, "ground"),
        corner(4, "table"), corner(5, "ground"), corner(6, "ground", values={"stiffness": 3e6}),
    ]  # fmt: skip
    scene = Mechanism("tossed", [body, table], contacts)
    bare = [name for name in scene.quantities if name not in dict(scene.defaults) and "." not in name]
    return Mechanism("tossed", [body, table], contacts, given={name: COEFFICIENTS.get(name, 10.0) for name in bare})


def row(law: str, friction: str | None) -> Mechanism:
    """Balls in a row, one softer than the others, between two walls; the last but one is fixed to a hinge."""
    options = {"law": law, "friction": friction}
    balls = [
        Body(f"b{k}", "free", mass=0.1 + 0.02 * k, inertia=1e-5, start={"x": 0.0199 * k, "vy": 0.1 * k, "wz": 3.0 * k})
        for k in range(6)
    ]
    contacts = [
        Contact(
            f"c{k}",
            (f"b{k}", f"b{k + 1}"),
            gaps.SphereOnSphere(),
            values={"stiffness": 4e5} if k == 2 else {},
            **options,
        )
        for k in range(5)
    ]
    walls = [Contact(f"w{k}", ("ground", f"b{k}"), gaps.SphereOnPlane(), **options) for k in range(6)]
    every = [x for pair in zip(walls, contacts, strict=False) for x in pair] + walls[5:]
    scene = Mechanism("row", balls, every)
    bare = [name for name in scene.quantities if name not in dict(scene.defaults) and "." not in name]
    sizes = {"radius": 0.01, "radius_a": 0.01, "radius_b": 0.01}
    return Mechanism("row", balls, every, given={name: (COEFFICIENTS | sizes).get(name, 10.0) for name in bare})


def heap(law: str, friction: str | None) -> Mechanism:
    """Bodies of two joints at random places, with corners on the ground, on a table and on each other, a spring and weights."""
    rng, options = np.random.default_rng(5), {"law": law, "friction": friction}
    some = lambda n, size: tuple(float(x) for x in size * rng.uniform(-1.0, 1.0, n))  # noqa: E731
    boxes = [
        Body(
            f"box{k}", "free", mass=0.1 + 0.1 * k, inertia=(1e-3, 2e-3, 1.5e-3 + 1e-4 * k), center=some(3, 1e-3),
            at=some(3, 0.02), start=dict(zip(("x", "z", "vy", "wx", "q2"), some(5, 0.1), strict=True)),
        )
        for k in range(5)
    ]  # fmt: skip
    grains = [Body(f"grain{k}", "particle", mass=0.1, start={"x": 0.0199 * k}) for k in range(4)]
    table = Body("table", "slide", axis="x", mass=2.0)

    def touch(name: str, a: str, b: str, mark: tuple[float, ...], gap=None) -> Contact:
        return Contact(name, (a, b), gap or gaps.SphereOnPlane(), at=((0.0, 0.0, 0.0), mark), **options)

    contacts = [touch(f"corner{k}{i}", "ground", f"box{k}", some(3, 0.04)) for i in range(2) for k in range(5)]
    contacts += [touch(f"on{k}", "table", f"box{k}", some(3, 0.04)) for k in (0, 3)]
    contacts += [
        touch(f"next{k}", f"grain{k}", f"grain{k + 1}", (0.0, 0.0, 0.0), gaps.SphereOnSphere()) for k in range(3)
    ]
    contacts += [touch(f"floor{k}", "ground", f"grain{k}", (0.0, 0.0, 0.0)) for k in range(4)]
    ends = ((0.01, 0.0, 0.0), (0.0, 0.0, 0.0))
    spring = loads.Spring("spring", ("box1", "grain2"), at=ends, stiffness=100.0, damping=0.5, free_length=0.1)
    parts = (boxes[:3] + grains + [table] + boxes[3:], contacts, [loads.Gravity("-z"), spring])
    scene = Mechanism("heap", *parts)
    bare = [name for name in scene.quantities if name not in dict(scene.defaults) and "." not in name]
    sizes = {"radius": 0.01, "radius_a": 0.01, "radius_b": 0.01}
    return Mechanism("heap", *parts, given={name: (COEFFICIENTS | sizes).get(name, 10.0) for name in bare})


def answers(scene: Mechanism) -> tuple[dict, list[str]]:
    """Everything that a mechanism answers from its contacts, in a state in which some press; and its readings' order."""
    params, order = scene.parameters(), []

    def look(t, params):
        start, prepared = scene.initial_state(params), scene.prepare(params)
        y = start + 1e-3 * np.random.default_rng(1).uniform(0.5, 1.0, start.size)
        asked = [scene.observe, scene.flows, scene.motions, scene.proximity, scene.accounts]
        asked += [scene.approaches] if scene.remembered else []
        found = {one.__name__: one(t, y, prepared) for one in asked}
        order[:] = found["observe"]
        field = lambda y: scene.vector_field(t, y, prepared)  # noqa: E731
        # Levers stand by rows of bodies; the scale has each one's.
        return found | {
            "start": start, "field": field(y), "slope": jax.jvp(field, (y,), (jnp.ones_like(y),))[1],
            "scale": scene.error_scale(params), "expected": scales.expected(scene, params)._replace(levers=[]),
        }  # fmt: skip

    # Op by op each kind of operation would be compiled.
    found = by_numpy(look)(jnp.zeros(()), params)
    found["places"] = sum(k or 1 for *_, k in scene._placed)
    found["suspects"] = scene.suspects({name: np.array([value, value]) for name, value in params.items()})
    return found, order


# In CI's tier the row, whose contacts and bodies are both side by side.
MACHINES = tiers.ci(itertools.product([tossed, row, heap], LAWS, FRICTIONS), (row, "memory_free", "brown_mcphee"))


@pytest.mark.slow
@pytest.mark.parametrize(("made", "law", "friction"), MACHINES)
def test_a_mechanism_does_not_tell_which_contacts_are_alike(made, law, friction, monkeypatch):
    together = made(law, friction)
    assert len(together.bundles) < len(together.contacts)
    found, order = answers(together)
    # The order of contacts is the mechanism's, whatever is computed with what.
    assert order == [c.name for c in together.contacts]
    monkeypatch.setattr(dynamics, "_alike", dynamics._alike.__wrapped__)
    monkeypatch.setattr(alike, "bundled", lambda contacts, members, kind: tuple(contacts))
    monkeypatch.setattr(rows, "rows", lambda bodies, tied: tuple(rows.Row(b.name, (b,)) for b in bodies))
    apart = made(law, friction)
    assert len(apart.bundles) == len(apart.contacts) and len(apart.rows) == len(apart.bodies)
    other, order = answers(apart)
    assert order == [c.name for c in apart.contacts]
    force = np.stack([reading.force for reading in other["observe"].values()])
    assert np.count_nonzero(force[:, 0]) > 1
    assert jax.tree.structure(found) == jax.tree.structure(other)
    for one, two in zip(jax.tree.leaves(found), jax.tree.leaves(other), strict=True):
        size = max(float(np.max(np.abs(np.nan_to_num(two, posinf=0.0)), initial=0.0)), 1e-30)
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-11 * size)


@pytest.mark.parametrize("friction", [None, *FRICTION])
@pytest.mark.parametrize("law", LAWS_BY_NAME)
def test_contacts_of_every_law_are_computed_side_by_side(law, friction):
    marks = [(0.01 * k, 0.0, 0.0) for k in range(6)]
    options = {"law": law, "friction": friction}
    contacts = [
        Contact(f"c{k}", ("ground", "cube"), gaps.SphereOnPlane(), at=((0, 0, 0), mark), **options)
        for k, mark in enumerate(marks)
    ]
    scene = Mechanism("cube", [Body("cube", "free", mass=1.0, inertia=1e-3)], contacts)
    assert len(scene.bundles) == 1


def test_users_own_code_is_not_given_more_than_a_scalar():
    def flat(place):
        assert jnp.shape(place[2]) == ()
        return -place[2]

    marks = [(0.01, 0.0, 0.0), (-0.01, 0.0, 0.0), (0.0, 0.01, 0.0)]
    own = gaps.from_depth(flat)
    contacts = [Contact(f"c{k}", ("ground", "cube"), own, at=((0, 0, 0), mark)) for k, mark in enumerate(marks)]
    scene = Mechanism("own", [Body("cube", "free", mass=1.0, inertia=1e-3)], contacts)
    assert scene.bundles == scene.contacts


def test_a_program_grows_little_with_contacts_that_are_alike():
    def size(count: int) -> int:
        rng = np.random.default_rng(0)
        body = Body("cube", "free", mass=1.0, inertia=1e-3, start={"z": 0.1})
        marks = [tuple(float(x) for x in rng.uniform(-0.04, 0.04, 3)) for _ in range(count)]
        contacts = [
            Contact(f"c{k}", ("ground", "cube"), gaps.PointOnPlane(), at=((0, 0, 0), mark), friction="brown_mcphee")
            for k, mark in enumerate(marks)
        ]
        scene = Mechanism("corners", [body], contacts)
        given = {n: 1.0 for n in scene.quantities if n not in dict(scene.defaults)}
        params = scene.parameters(**given)
        prepared = scene.prepare(params)
        y = scene.initial_state(params)
        return len(jax.make_jaxpr(lambda y: scene.vector_field(0.0, y, prepared))(y).jaxpr.eqns)

    assert size(32) < 1.3 * size(1)


def test_a_program_grows_little_with_bodies_that_are_alike():
    def size(count: int) -> int:
        balls = [Body(f"b{k}", "free", mass=0.1, inertia=1e-5, start={"x": 0.02 * k}) for k in range(count)]
        contacts = [Contact(f"c{k}", (f"b{k}", f"b{k + 1}"), gaps.SphereOnSphere()) for k in range(count - 1)]
        scene = Mechanism("row", balls, contacts, [loads.Gravity("-z")])
        params = scene.parameters(**{n: 1.0 for n in scene.quantities if n not in dict(scene.defaults)})
        y = scene.initial_state(params)
        return len(jax.make_jaxpr(lambda y: scene.vector_field(0.0, y, params))(y).jaxpr.eqns)

    # What is left for each body are its own numbers.
    assert size(32) < 1.5 * size(8)
