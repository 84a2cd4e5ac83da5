"""The string of joints: against one joint, closed forms, balances, and what is refused."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

import bcfj_jax as bj
from bcfj_jax.models.string import buckling_force, loads, segments

TIMES = np.linspace(0.0, 0.65, 14)


def told(count=10, **more):
    scene = bj.scenes.string(n=count, fidelity="kinematic")
    params = scene.parameters(more)
    return params, loads(params, count)


@pytest.mark.parametrize("fidelity", tiers.ci(["kinematic", "quasistatic"], "kinematic"))
def test_one_joint_is_the_joint(fidelity):
    string, joint = bj.scenes.string(n=1, fidelity=fidelity), bj.scenes.joint(fidelity=fidelity)
    params = string.parameters()
    angle = 2.0 * math.asin(0.5 * float(params["segment_length"]) / float(params["hole_radius"]))
    alone = joint.parameters(joint_angle=angle, load_torque=1800.0, axial_load=20e3)
    found, right = bj.simulate(string, params, TIMES), bj.simulate(joint, alone, TIMES)
    assert found.status == right.status == "ok"
    for name, force in right.force.items():
        assert np.allclose(found.force[name], force, atol=1e-9 * max(1.0, np.abs(force).max()))


@pytest.mark.slow
def test_each_of_several_is_the_joint_under_its_own_load():
    string, joint = bj.scenes.string(n=3), bj.scenes.joint(fidelity="quasistatic")
    params = string.parameters()
    found, run = loads(params, 3), bj.simulate(string, params, TIMES)
    for i in range(3):
        own = {"joint_angle": found.bend[i], "load_torque": found.torque[i], "axial_load": found.axial[i]}
        right = bj.simulate(joint, joint.parameters(own), TIMES)
        for name, force in right.force.items():
            mine = run.force[name].reshape(len(TIMES), 3, -1, 3)[:, i].reshape(force.shape)
            assert np.allclose(mine, force, atol=1e-6 * max(1.0, np.abs(force).max())), name


def test_drag_is_the_capstan_formula():
    # A string that is fed and does not turn rubs along itself alone.
    _, found = told(drive_speed=0.0)
    angle = 10 * float(found.bend[0])
    assert float(found.hook_load) == pytest.approx(20e3 * math.exp(0.25 * angle), rel=1e-12)
    assert float(found.drive_torque) == pytest.approx(1800.0, rel=1e-12)
    # One that turns and is hardly fed rubs around: F stays, and T = mu d W theta is added.
    _, found = told(feed_speed=0.0)
    assert float(found.hook_load) == pytest.approx(20e3, rel=1e-12)
    assert float(found.drive_torque) == pytest.approx(1800.0 + 0.25 * 0.05 * 20e3 * angle, rel=1e-9)


def test_torque_force_and_power_balance_along_the_string():
    params, found = told(feed_speed=0.2)
    speed, feed = float(params["drive_speed"]), 0.2
    around, along = float(found.around.sum()), float(found.along.sum())
    assert float(found.drive_torque) == pytest.approx(1800.0 + around, rel=1e-12)
    assert float(found.hook_load) == pytest.approx(20e3 + along, rel=1e-12)
    given = float(found.drive_torque) * speed + float(found.hook_load) * feed
    slip = math.hypot(feed, 0.05 * speed)
    taken = 1800.0 * speed + 20e3 * feed + 0.25 * slip * float(found.wall.sum())
    assert given == pytest.approx(taken, rel=1e-9)


def test_a_straight_string_bears_nothing_sideways():
    _, found = told(hole_radius=1e9)
    assert np.allclose(found.wall, 0.0, atol=1e-3)
    assert np.allclose(found.side, 0.0, atol=1e-3)
    assert np.allclose(found.torque, 1800.0)
    _, found = told(weight_on_bit=0.0, bit_torque=0.0)
    assert not np.asarray(found.wall).any()
    assert not np.asarray(found.torque).any()


def test_the_joint_at_the_drive_is_loaded_most():
    _, found = told()
    assert np.all(np.diff(found.torque) < 0)
    assert np.all(np.diff(found.axial) < 0)


def test_segments_twist_shorten_and_bend_as_bars():
    # A solid bar of 100 mm and 0.3987 m, E = 207 GPa, nu = 0.29: G J/L = 80.23e9*9.817e-6/0.3987.
    params, found = told(3, segment_bore=0.0, wall_friction=0.0, weight_on_bit=10e3)
    each = segments(params, 3)
    stiff = 207e9 / 2.58 * math.pi / 2.0 * 0.05**4 / 0.3987
    assert np.allclose(each.twist, 1800.0 / stiff, rtol=1e-9)
    assert np.allclose(each.stretch, -10e3 * 0.3987 / (207e9 * math.pi * 0.05**2), rtol=1e-9)
    # 16 T/(pi D^3), F/A, 32 M/(pi D^3).
    bent = 1800.0 * math.tan(0.5 * float(found.bend[0]))
    shear, axial, bending = 16.0 * 1800.0 / (math.pi * 1e-3), 10e3 / (math.pi * 0.0025), 32.0 * bent / (math.pi * 1e-3)
    assert np.allclose(each.shear, shear, rtol=1e-9) and np.allclose(each.bending, bending, rtol=1e-9)
    assert np.allclose(each.stress, math.sqrt((axial + bending) ** 2 + 3.0 * shear**2), rtol=1e-9)
    straight = segments(told(3, hole_radius=1e9)[0], 3)
    assert np.allclose(straight.moment, 0.0, atol=1e-5)


def test_euler():
    # pi^2 E I/L^2 of a rod of 20 mm and 2 m: I = 7.854e-9 m^4, 4.011 kN.
    rod = {"segment_radius": 0.01, "segment_bore": 0.0, "segment_modulus": 207e9, "segment_length": 2.0}
    force = float(buckling_force(rod))
    assert force == pytest.approx(math.pi**2 * 207e9 * 7.853981634e-9 / 4.0, rel=1e-9)
    # E I w'' + P w = 0 between two pins, by differences over 400 pieces.
    piece = 2.0 / 400
    bent = (2.0 * np.eye(399) - np.eye(399, k=1) - np.eye(399, k=-1)) / piece**2
    assert force == pytest.approx(207e9 * 7.853981634e-9 * np.linalg.eigvalsh(bent)[0], rel=1e-4)


@pytest.mark.parametrize(
    ("more", "key"),
    [
        ({"hole_radius": 0.5}, "hole_radius"),
        ({"hole_clearance": 0.005}, "segment_length"),
        ({"bit_torque": 5900.0}, "bit_torque"),
        ({"segment_bore": 0.06}, "segment_bore"),
        ({"weight_on_bit": 20e3, "segment_modulus": 1e8, "segment_bore": 0.049}, "weight_on_bit"),
    ],
)
@pytest.mark.parametrize("motion", ["none", "torsional"])
def test_what_is_refused_is_told_with_the_number_that_would_do(more, key, motion):
    scene = bj.scenes.string(n=10, fidelity="kinematic", motion=motion)
    with pytest.raises(bj.InputError, match=key) as refused:
        bj.simulate(scene, scene.parameters(more), TIMES)
    if key in ("segment_bore",):
        return
    said = str(refused.value)
    number = float(said.split("give at least ")[-1].split("give at most ")[-1].split()[0])
    mended = more | {key: number * (1.0 + 2e-3 if "at least" in said.split("or ")[0] else 1.0 - 2e-3)}
    # The default segments ask for 10 mm of clearance in a hole that is wide enough for the joints.
    if key == "hole_radius":
        mended |= {"hole_clearance": 0.05}
    scene.check(scene.parameters(mended))


def test_where_the_wall_takes_more_than_the_drive_has_the_weight_that_would_do_is_told():
    scene = bj.scenes.string(n=10, fidelity="kinematic")
    given = {"weight_on_bit": 2e6, "segment_modulus": 1e13}
    with pytest.raises(bj.InputError, match="a weight_on_bit of at most") as refused:
        scene.check(scene.parameters(given))
    most = float(str(refused.value).split("at most ")[1].split()[0])
    scene.check(scene.parameters(given | {"weight_on_bit": 0.999 * most}))
    with pytest.raises(bj.InputError, match="takes"):
        scene.check(scene.parameters(given | {"weight_on_bit": 1.001 * most}))
    # No weight at all would do where the drive has less than the bit takes.
    with pytest.raises(bj.InputError, match=r"give a drive_torque of 2804\.4 N m"):
        scene.check(scene.parameters(drive_torque=1000.0))
    with pytest.raises(bj.InputError, match="give a hole_clearance of at least"):
        scene.check(scene.parameters(hole_clearance=0.0))


def test_a_string_has_no_motion_of_its_own():
    with pytest.raises(bj.InputError, match="exchange no dynamics"):
        bj.scenes.string(fidelity="dynamic")


def test_derivative_of_the_greatest_torque_by_wall_friction():
    params, _ = told(feed_speed=0.0)
    top = lambda mu: loads(params | {"wall_friction": mu}, 10).drive_torque  # noqa: E731
    angle = 10 * float(loads(params, 10).bend[0])
    assert float(jax.grad(top)(0.25)) == pytest.approx(0.05 * 20e3 * angle, rel=1e-9)


@pytest.mark.slow
def test_the_summary_tells_what_each_joint_bears_and_which_most():
    scene = bj.scenes.string(n=3, fidelity="kinematic")
    params = scene.parameters()
    run = bj.simulate(scene, params, TIMES)
    told = scene.whole(params, run)[0]["string"]
    assert told["most_loaded"] == 1
    assert len(told["torque"]) == len(told["peaks"]["seat_ball"]) == 3
    assert told["peaks"]["seat_ball"][0] == pytest.approx(np.abs(run.force["seat_ball"][:, :6, 0]).max())


def test_the_picture_has_every_joint_on_the_hole_and_walls_that_push_inwards():
    scene = bj.scenes.string(n=6, fidelity="kinematic")
    chain = scene.chain(scene.parameters())
    middle = chain.corners[0] + np.array(
        [math.cos(0.5 * told(6)[1].bend[0]), -math.sin(0.5 * float(told(6)[1].bend[0]))]
    )
    assert np.allclose(np.hypot(*(chain.corners - middle).T), 1.0)
    assert np.all(np.sum(chain.pushes * (middle - chain.corners[1:-1]), 1) > 0.0)
    assert np.allclose(np.hypot(*chain.pushes.T), chain.loads["force of the wall"][1])


def test_drawn_segments_meet_in_the_joints_and_turn_as_the_drive():
    scene = bj.scenes.string(n=3, fidelity="kinematic")
    params = scene.parameters()
    corners, poses = scene.chain(params).corners, scene.scenery(jnp.asarray(0.02), jnp.zeros(0), params).poses
    place = np.vstack([poses["top"].place, poses["lump"].place])
    axes = np.concatenate([poses["top"].axes[None], poses["lump"].axes])
    assert np.allclose(place[:, [0, 2]], corners[:-1], atol=1e-12)
    assert np.allclose(place + 0.3987 * axes[..., 2], np.insert(corners[1:], 1, 0.0, 1), atol=1e-9)
    assert np.allclose(axes @ np.swapaxes(axes, 1, 2), np.eye(3)) and np.allclose(np.linalg.det(axes), 1.0)
    # Across the plane of the bend: minus the sine of the turn.
    assert np.allclose(axes[:, 1, 0], -math.sin(0.02 * float(params["drive_speed"])))
    wall = next(x for x in scene.drawing(params).shapes if x.body == "ground").mesh.points
    middle = np.array([math.cos(0.5 * 0.4013891), 0.0, -math.sin(0.5 * 0.4013891)])
    away = np.hypot(np.hypot(*(wall - middle)[:, [0, 2]].T) - 1.0, wall[:, 1])
    assert np.allclose(away, 0.06, atol=1e-6)
    # The wall goes along with the string, from the upper connection to the last segment.
    ends = np.vstack([place[:1], corners[-1:] @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])])
    for end in ends:
        assert np.min(np.linalg.norm(wall - end, axis=1)) < 0.08
