"""Bodies without mass between joints: the cross of a universal joint, a light arm; what they pass on, and refusals."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax import Body, InputError, Mechanism
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism.loads import Force, Gravity, JointSpring

SHAFT = {"mass": 1.3, "inertia": (0.02, 0.03, 0.04), "center": (0.1, 0.02, 0.0)}
PUSH = [Gravity(), Force("push", "shaft", (0.3, 1.0, -0.2), 2.0, (0.2, 0.0, 0.1))]


def test_a_cross_without_mass_is_a_universal_joint():
    """Two hinges through it against the joint of two hinges: accelerations, their derivatives, and both reactions."""
    cross = Body("cross", "hinge", axis="x", mass=0, start={"angle": 0.3, "speed": -0.7})
    two = Mechanism(
        "two",
        [cross, Body("shaft", "hinge", "cross", axis="y", start={"angle": 0.5, "speed": 1.1}, **SHAFT)],
        loads=PUSH,
    )
    start = {"first": 0.3, "second": 0.5, "first_speed": -0.7, "second_speed": 1.1}
    one = Mechanism("one", [Body("shaft", "universal", axis="z", start=start, **SHAFT)], loads=PUSH)
    assert "cross.mass" not in two.quantities and "cross.inertia" not in two.quantities
    found, t = [], jnp.zeros(())
    for scene in (two, one):
        p = scene.parameters()
        y = scene.initial_state(p)
        rate = lambda p, scene=scene, y=y: scene.vector_field(t, y, p)  # noqa: E731
        slopes = jax.jacfwd(rate)(p)
        efforts = scene.efforts(t, y, p)
        reaction = np.concatenate([efforts["shaft"].reaction, efforts["shaft"].moment])
        found.append((rate(p), slopes["shaft.mass"], slopes["shaft.inertia_y"], reaction, efforts))
    for ours, theirs in zip(*(x[:4] for x in found), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-12)
    # What has no mass passes on what it is given.
    passed = found[0][4]["cross"]
    np.testing.assert_allclose(np.concatenate([passed.reaction, passed.moment]), found[0][3], rtol=1e-11, atol=1e-12)
    assert abs(passed.moment[0]) < 1e-12 * np.abs(passed.moment).max()  # none about its own axis


def test_a_light_arm_with_a_weight():
    """a = -g cos(q)/L - k q/(m L^2), and energy is the weight's alone; in a file mass = 0 says it."""
    arm = Body("arm", "hinge", mass=0, start={"angle": 0.4, "speed": 2.0})
    bob = Body("bob", "slide", "arm", at=(0.5, 0, 0), axis="x", mass=0.7, inertia=0.0001, start={"velocity": 0.1})
    scene = Mechanism("arm", [arm, bob], loads=[Gravity(), JointSpring("coil", "arm", 3.0)])
    p, t = scene.parameters(), jnp.zeros(())
    y = scene.initial_state(p)
    whole = 0.7 * 0.25 + 1e-4
    turn = (-0.7 * 9.81 * 0.5 * np.cos(0.4) - 3.0 * 0.4 - 2.0 * 0.7 * 0.5 * 2.0 * 0.1) / whole
    np.testing.assert_allclose(scene.vector_field(t, y, p)[2:], [turn, 0.5 * 4.0 - 9.81 * np.sin(0.4)], rtol=1e-12)
    flows = scene.flows(t, y, p)
    assert float(flows.stored["kinetic"]) == pytest.approx(0.5 * whole * 4.0 + 0.5 * 0.7 * 0.01, rel=1e-12)


def test_refusals(tmp_path):
    """What nothing gives inertia: no mass on it, or two light joints about one axis, which numbers alone show."""
    with pytest.raises(InputError, match="nothing that has one hangs on it"):
        Mechanism("no", [Body("arm", "hinge", mass=0), Body("end", "hinge", "arm", mass=0.0, inertia=0)])
    path = tmp_path / "scene.toml"
    for off, joined in (("100 mm", True), ("0 mm", False)):
        path.write_text(f"""
[scene]
kind = "mechanism"
[[body]]
name = "arm"
joint = "hinge"
mass = 0
[[body]]
name = "elbow"
parent = "arm"
at = ["{off}", 0, 0]
joint = "hinge"
mass = 0
start = {{ angle = "30 deg" }}
[[body]]
name = "weight"
parent = "elbow"
at = ["0.2 m", 0, 0]
joint = "fixed"
mass = 1.0
inertia = 1e-12
""")
        if joined:
            assert scenefile.load(path).scene.kind == "mechanism"
            continue
        with pytest.raises(InputError, match="mass: it has no mass, and at the start its joint moves nothing"):
            scenefile.load(path)
