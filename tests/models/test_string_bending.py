"""Segments that bend: closed forms of beams, differences along the beam, Euler's force, balances, and what is refused."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.models.string import buckling_force, loads
from bcfj_jax.models.string_bending import bent, rigidity, swayed
from bcfj_jax.models.string_motion import inertias

# A pipe of 40 mm and 1 m in a hole of 4 m: straight, 0.802 m pass.
LONG = {
    "hole_radius": 4.0, "segment_length": 1.0, "segment_radius": 0.02, "segment_bore": 0.01, "hole_clearance": 0.01,
    "weight_on_bit": 20e3,
}  # fmt: skip
BOW = 1.0 / (8.0 * 4.02) - 0.02
BENT, SWAYED = jax.jit(bent), jax.jit(swayed)


def told(count=4, **more):
    scene = bj.scenes.string(n=count, fidelity="kinematic", bending=True)
    params = scene.parameters(LONG | more)
    return scene, params, loads(params, count, True)


def by_differences(params, axial, pieces=800):
    """Slope and force per deflection of a beam pushed in its middle, slope and quarter's deflection of one held by a moment.

    E I w'' + F w = M along the beam, w = 0 at both ends.
    """
    stiff, length = float(rigidity(params)), float(params["segment_length"])
    piece = length / pieces
    x = piece * np.arange(1, pieces)
    second = (np.eye(pieces - 1, k=1) + np.eye(pieces - 1, k=-1) - 2.0 * np.eye(pieces - 1)) / piece**2
    system = stiff * second + axial * np.eye(pieces - 1)
    pushed = np.linalg.solve(system, -0.5 * np.minimum(x, length - x))
    held = np.linalg.solve(system, -(1.0 - 2.0 * x / length))
    slope = lambda w, of: (w[0] - 0.5 * piece**2 * of) / piece  # noqa: E731
    top, middle = pushed[pieces // 2 - 1], 0.25 * length + axial * pushed[pieces // 2 - 1]
    return slope(pushed, 0.0) / top, 1.0 / top, middle / top, slope(held, -1.0 / stiff), held[pieces // 4 - 1]


def test_without_axial_force_it_is_the_beam_of_the_textbook():
    # Half of the segment is a cantilever of L/2 that P/2 bends by (P/2) (L/2)^3/(3 E I); Timoshenko 1955, 1.5.
    params, none = told()[1], jnp.zeros(())
    stiff = 207e9 * math.pi / 4.0 * (0.02**4 - 0.01**4)
    found = BENT(params, none)
    assert float(found.bow) == pytest.approx(BOW, rel=1e-12)
    assert float(found.push) / 2.0 * 0.5**3 / (3.0 * stiff) == pytest.approx(BOW, rel=1e-12)
    assert float(found.slope) == pytest.approx(float(found.push) / 2.0 * 0.5**2 / (2.0 * stiff), rel=1e-12)
    assert float(found.moment) == pytest.approx(float(found.push) / 4.0, rel=1e-12)
    # Equal moments of one sense at both ends: M L/3 E I less M L/6 E I; at a quarter M x (L - x) (L - 2 x)/(6 L E I).
    slope, sway = SWAYED(params, none, jnp.asarray(300.0))
    assert float(slope) == pytest.approx(300.0 / (6.0 * stiff), rel=1e-12)
    assert float(sway) == pytest.approx(300.0 * 0.25 * 0.75 * 0.5 / (6.0 * stiff), rel=1e-12)


@pytest.mark.parametrize("share", [-2.0, 0.3, 0.9])
def test_under_axial_force_it_is_the_beam_of_differences(share):
    params = told()[1]
    axial = share * float(buckling_force(params))
    slope, push, moment, held, sway = by_differences(params, axial)
    found, other = BENT(params, jnp.asarray(axial)), SWAYED(params, jnp.asarray(axial), jnp.ones(()))
    assert np.allclose(np.array(found[1:]) / float(found.bow), [push, slope, moment], rtol=2e-5)
    assert np.allclose(other, [held, sway], rtol=2e-5)


def test_at_eulers_force_the_wall_need_not_push():
    params = told()[1]
    euler = float(buckling_force(params))
    push = lambda share: float(BENT(params, jnp.asarray(share * euler)).push)  # noqa: E731
    assert push(1.0) == pytest.approx(0.0, abs=1e-12 * push(0.0))
    assert push(0.999) > 0.0 and push(1.001) == 0.0
    # A string that is pushed beyond it is refused, bent or not.
    scene = bj.scenes.string(n=2, fidelity="kinematic", bending=True)
    with pytest.raises(bj.InputError, match="buckles at"):
        scene.check(scene.parameters(LONG | {"weight_on_bit": 1.01 * euler}))


def test_segments_that_pass_straight_are_rigid():
    params = told(segment_length=0.8)[1]
    mine, right = loads(params, 4, True), loads(params, 4, False)
    assert not np.asarray(mine.pushed).any()
    assert all(np.allclose(*both, rtol=1e-14) for both in zip(mine, right, strict=True))


def test_force_torque_and_power_balance_and_the_wall_takes_more():
    _, params, found = told(feed_speed=0.2)
    slip = math.hypot(0.2, 0.02 * float(params["drive_speed"]))
    normal = float((found.wall + 2.0 * found.pushed).sum())
    given = float(found.drive_torque * params["drive_speed"] + 0.2 * found.hook_load)
    taken = 1800.0 * float(params["drive_speed"]) + 0.2 * 20e3 + 0.25 * slip * normal
    assert given == pytest.approx(taken, rel=1e-12)
    assert float(found.drive_torque) == pytest.approx(1800.0 + float(found.around.sum()), rel=1e-12)
    assert float(found.hook_load) == pytest.approx(20e3 + float(found.along.sum()), rel=1e-12)
    # From the upper end of the lowest segment to the joint above: the bend, then the segment, each by its own share.
    share = 0.25 * 0.2 / slip
    lowest = 20e3 + 2.0 * share * float(found.pushed[-1])
    assert float(found.axial[-1]) == pytest.approx(lowest, rel=1e-12)
    above = lowest * math.exp(share * 2.0 * math.asin(0.125)) + 2.0 * share * float(found.pushed[-2])
    assert float(found.axial[-2]) == pytest.approx(above, rel=1e-12)
    assert float(found.drive_torque) > 1.1 * float(loads(params, 4, False).drive_torque)


def test_joints_bend_by_less_and_that_is_what_they_are_told():
    scene, params, found = told(2)
    straight = 2.0 * math.asin(0.125)
    slope = 3.0 * BOW
    assert np.allclose(straight - np.asarray(found.bend), [slope, 2.0 * slope], rtol=0.05)
    assert np.array_equal(scene.joints(params)["joint_angle"], found.bend)


@pytest.mark.slow
def test_each_joint_is_the_joint_under_what_bent_segments_hand_it():
    scene, params, found = told(2)
    times = np.linspace(0.0, 0.1, 3)
    run, joint = bj.simulate(scene, params, times), bj.scenes.joint(fidelity="kinematic")
    own = {"joint_angle": found.bend[1], "load_torque": found.torque[1], "axial_load": found.axial[1]}
    right = bj.simulate(joint, joint.parameters(own), times)
    for name in ("seat_ball", "head_ball"):
        np.testing.assert_allclose(run.force[name][:, 6:], right.force[name], rtol=1e-9, atol=1e-6)
    entry = scene.whole(params, run)[0]["string"]
    assert entry["pushed"] == pytest.approx(found.pushed) and entry["segments"]["bow"] == pytest.approx([BOW] * 2)
    assert "push on the middle" in scene.chain(params).loads


@pytest.mark.parametrize(
    ("more", "limit"), [({}, "yields"), ({"segment_strength": 1e12}, "wraps"), ({"segment_length": 0.5}, "")]
)
def test_a_segment_that_is_too_long_is_told_the_length_that_passes(more, limit):
    scene = bj.scenes.string(n=2, fidelity="kinematic", bending=True)
    if not limit:
        scene.check(scene.parameters(LONG | more))
        return
    with pytest.raises(bj.InputError, match=limit) as refused:
        scene.check(scene.parameters(LONG | {"segment_length": 1.6} | more))
    words = str(refused.value)
    most, wide = (float(words.split(f"at {which} ")[1].split()[0]) for which in ("most", "least"))
    scene.check(scene.parameters(LONG | more | {"segment_length": 0.999 * most}))
    scene.check(scene.parameters(LONG | more | {"segment_length": 1.6, "hole_clearance": 1.001 * wide}))
    with pytest.raises(bj.InputError, match=limit):
        scene.check(scene.parameters(LONG | more | {"segment_length": 1.001 * most}))
    # At the length that would do, the middle is stressed to its strength, or as curved as the hole.
    params = scene.parameters(LONG | more | {"segment_length": most})
    found = BENT(params, jnp.zeros(()))
    stress, curve = found.moment * 0.02 / (rigidity(params) / 207e9), found.moment / rigidity(params)
    reached = stress / 758e6 if limit == "yields" else 4.0 * curve
    assert float(reached) == pytest.approx(1.0, rel=2e-3)


def test_rigid_segments_are_told_that_bent_ones_may_pass():
    scene = bj.scenes.string(n=2, fidelity="kinematic")
    with pytest.raises(bj.InputError, match="or bending = true"):
        scene.check(scene.parameters(LONG))


def test_derivatives_are_those_of_differences():
    _, params, _ = told()

    def of(length, weight):
        found = loads(params | {"segment_length": length, "weight_on_bit": weight}, 4, True)
        return found.drive_torque + 1e3 * found.bend.sum()

    of, by = jax.jit(of), jax.jit(jax.grad(of, (0, 1)))
    at = (jnp.asarray(1.0), jnp.asarray(20e3))
    for i, step in ((0, 1e-6), (1, 1.0)):
        moved = [at[:i] + (at[i] + side * step,) + at[i + 1 :] for side in (1.0, -1.0)]
        right = float(of(*moved[0]) - of(*moved[1])) / (2.0 * step)
        assert float(by(*at)[i]) == pytest.approx(right, rel=1e-6)


def test_in_motion_each_lump_loses_what_the_statics_say():
    scene = bj.scenes.string(n=3, fidelity="kinematic", motion="torsional", bending=True)
    params = scene.parameters(LONG)
    held, found = jax.jit(scene.coupled)(params, jnp.full(3, 4e5)), loads(params, 3, True)
    each = held["wall_arm"] * params["weight_on_bit"] + held["wall_kept"]
    torque = np.append(np.asarray(found.torque), 1800.0)
    assert np.allclose(each, torque[:-1] - torque[1:], rtol=1e-12)
    speed = float(params["drive_speed"])
    slip = 1.0 / math.hypot(1.0, float(params["wall_speed"]) / 0.02 / speed)
    angle = 0.1 * speed - np.cumsum(
        (np.cumsum(np.asarray(each)[::-1])[::-1] * slip + 1800.0) / np.asarray(held["coupling"])
    )
    y = jnp.concatenate([jnp.asarray(angle), jnp.full(3, speed)])
    rates = jax.jit(scene.vector_field)(jnp.asarray(0.1), y, held)
    assert np.allclose(np.asarray(rates[3:]) * np.asarray(inertias(params, 3)), 0.0, atol=1e-6 * 1800.0)
