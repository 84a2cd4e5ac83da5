"""What a scene does not list is not in the compiled program."""

from __future__ import annotations

from collections import Counter

import jax
import jax.numpy as jnp
import pytest
from jax.extend.core import jaxprs_in_params

from bcfj_jax import scenes


def right_hand_side(scene):
    """The scene's rates by state and parameters, and arguments for it."""
    params = scene.parameters()

    def motion(state, p):
        return scene.vector_field(jnp.asarray(0.0), state, p)

    return motion, (scene.initial_state(params), params)


def operations(scene) -> Counter:
    """Primitives of the scene's right-hand side by name, those of nested programs included."""
    motion, arguments = right_hand_side(scene)
    program = jax.make_jaxpr(motion)(*arguments)
    count: Counter = Counter()

    def walk(jaxpr):
        for equation in jaxpr.eqns:
            inner = list(jaxprs_in_params(equation.params))
            count[equation.primitive.name] += not inner
            for nested in inner:
                walk(nested)

    walk(program.jaxpr)
    return count


def size(*options, kind=scenes.impact) -> int:
    return operations(kind(*options)).total()


def test_each_part_costs_only_where_it_is():
    hertz, damped, smooth = (
        size("hertz", None, False), size("memory_free", None, False), size("memory_free", None, True)
    )  # fmt: skip
    assert hertz < damped < smooth
    # The linear part needs no power, nor does anything else in it.
    assert operations(scenes.impact("hertz", "linear", False))["pow"] == 0
    assert operations(scenes.impact("hertz", "power", False))["pow"] == 1


def solves(scene) -> tuple[bool, bool]:
    """Whether the compiled right-hand side iterates, and whether it takes an exponential.

    Read from what is compiled: primitives with derivatives of their own hide their program from a walk in newer JAX.
    """
    motion, arguments = right_hand_side(scene)
    text = jax.jit(motion).lower(*arguments).as_text()
    return "stablehlo.while" in text, "stablehlo.exponential " in text


def test_only_what_asks_for_a_root_solves_for_one():
    assert solves(scenes.impact("exact")) == (True, True)
    for law in ("memory_free", "hu_guo"):
        assert solves(scenes.impact(law)) == (False, False)


@pytest.mark.parametrize(
    ("scene", "states"),
    [
        (scenes.impact("exact"), 2),
        (scenes.bounce("exact"), 3),
        (scenes.bounce("memory_free"), 2),
        (scenes.bounce("kelvin_voigt"), 2),
    ],
)
def test_only_a_law_that_asks_for_it_is_remembered(scene, states):
    params = scene.parameters()
    assert scene.initial_state(params).shape == scene.error_scale(params).shape == (states,)


def test_parameters_are_those_of_what_is_listed():
    shared = {name for name in scenes.impact("hertz", smoothing=False).quantities if "." not in name}
    assert shared == {
        "stiffness", "exponent", "mass", "approach_speed", "clearance_contact",
    }  # fmt: skip
    assert "gravity" not in scenes.impact().quantities and "gravity" in scenes.bounce().quantities
    assert "approach_speed" not in scenes.bounce("exact").quantities
    assert "exponent" not in scenes.impact("hertz", "linear").quantities
    for name in ("damping", "restitution", "dashpot", "damping_depth"):
        assert name not in scenes.impact("hertz").quantities


def test_scenes_are_static_structure():
    assert scenes.impact("exact") == scenes.impact("exact") and hash(scenes.impact()) == hash(scenes.impact())
    assert scenes.impact("exact") != scenes.impact("hu_guo")
    assert not jax.tree.leaves(scenes.bounce("exact"))
