"""Gears, rack, screw and belt as couplings of two joints, and the universal joint: kinematics and forces by hand."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, InputError, Mechanism
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism.bodies import Drive
from bcfj_jax.mechanism.loads import Coupling, Force, Torque


def hinge(name, inertia=0.01, **more):
    return Body(name, "hinge", mass=1.0, inertia=inertia, **more)


RATIOS = {"rack": 0.02, "screw": 5e-3 / (2.0 * np.pi)}


@pytest.mark.parametrize("kind", RATIOS)
def test_a_rack_and_a_screw_go_by_their_ratio(kind):
    """A hinge that is driven 40 turns on: the slide is ratio times all of them along; a load of F leans back F/k."""
    ratio = RATIOS[kind]
    drive = Drive("constant", speed=7.0, start=80.0 * np.pi)
    bodies = [hinge("wheel", drive=drive), Body("table", "slide", axis="x", mass=2.0)]
    nut = Coupling("nut", ("wheel", "table"), ratio, 1e7)
    scene = Mechanism("feed", bodies, loads=[nut, Force("load", "table", "x", -50.0)], start="static")
    for load in (-50.0, 1e-12):
        params = scene.parameters({"load.size": load})
        y = scene.initial_state(params)
        assert float(y[0]) == pytest.approx(ratio * 80.0 * np.pi + load / 1e7, abs=1e-12)
    params = scene.parameters()
    y, t = scene.initial_state(params), jnp.zeros(())
    assert float(scene.motions(t, y, params)["wheel"].drive) == pytest.approx(50.0 * ratio, rel=1e-6)
    slope = jax.jacfwd(lambda p: scene.initial_state(p)[0])(params)
    assert float(slope["nut.ratio"]) == pytest.approx(80.0 * np.pi, rel=1e-9)
    assert float(slope["nut.stiffness"]) == pytest.approx(50.0 / 1e14, rel=1e-6)


def test_gears_share_torque_and_power():
    """With e the deviation: F = -k e - c e' on the second, -i F on the first; what is lost is c e'^2, kept k e e'."""
    i, k, c = -0.4, 300.0, 0.7
    bodies = [
        hinge("pinion", 0.01, start={"angle": 10.0, "speed": 3.0}),
        hinge("wheel", 0.05, start={"angle": -3.97, "speed": -1.0}),
    ]
    scene = Mechanism("gears", bodies, loads=[Coupling("mesh", ("pinion", "wheel"), i, k, c)])
    params, t = scene.parameters(), jnp.zeros(())
    y = scene.initial_state(params)
    e, rate = -3.97 - i * 10.0, -1.0 - i * 3.0
    force = -k * e - c * rate
    np.testing.assert_allclose(scene.vector_field(t, y, params)[2:], [-i * force / 0.01, force / 0.05], rtol=1e-12)
    did = scene.efforts(t, y, params)
    assert float(did["mesh"].drive) == pytest.approx(force)
    assert float(did["mesh"].power) == pytest.approx(-k * e * rate - c * rate**2)
    assert float(did["wheel"].moment[2]) == pytest.approx(force)


@pytest.mark.parametrize(("apart", "force"), [(0.0, 0.0), (0.049, 0.0), (0.06, -3.0), (-0.08, 9.0)])
def test_backlash_is_free_within_and_hard_beyond(apart, force):
    bodies = [hinge("pinion"), hinge("wheel", start={"angle": apart})]
    scene = Mechanism("gears", bodies, loads=[Coupling("mesh", ("pinion", "wheel"), -1.0, 300.0, backlash=0.1)])
    params = scene.parameters()
    y = scene.initial_state(params)
    assert float(scene.efforts(jnp.zeros(()), y, params)["mesh"].drive) == pytest.approx(force, abs=1e-12)


def test_a_belt_in_a_file(tmp_path):
    """A torque on the second pulley winds the belt up by T/k; the file's numbers have the units of its joints."""
    path = tmp_path / "belt.toml"
    path.write_text("""
[scene]
kind = "mechanism"
start = "static"
[[body]]
name = "motor"
joint = "hinge"
mass = 1.0
inertia = [1e-2, 1e-2, 2e-2, 1e-3, 0, 0]
drive = { kind = "constant", speed = "10 rad/s" }
[[body]]
name = "pulley"
joint = "hinge"
mass = 1.0
inertia = 1e-2
[[load]]
kind = "coupling"
name = "belt"
joints = ["motor", "pulley"]
ratio = 0.5
stiffness = "200 N m/rad"
backlash = "1 mrad"
[[load]]
kind = "torque"
name = "brake"
body = "pulley"
direction = "z"
size = "-4 N m"
[[load]]
kind = "joint_spring"
name = "stop"
body = "pulley"
side = "pull"
table = [["0 deg", "90 deg"], ["0 N m", "9 N m"]]
rest = "200 deg"
""")
    file = scenefile.load(path)
    assert float(file.scene.initial_state(file.params)[0]) == pytest.approx(-4.0 / 200.0 - 0.5e-3, rel=1e-9)
    for bad, said in (('["motor", "motor"]', "two different"), ('["motor", "disc"]', "disc")):
        path.write_text(path.read_text().replace('["motor", "pulley"]', bad))
        with pytest.raises(InputError, match=said):
            scenefile.load(path)
        path.write_text(path.read_text().replace(bad, '["motor", "pulley"]'))


def test_a_coupling_of_what_does_not_slide_or_turn_is_refused():
    bodies = [hinge("pinion"), Body("plate", "planar", mass=1.0, inertia=1.0)]
    with pytest.raises(InputError, match="'plate' has 3 free"):
        Mechanism("gears", bodies, loads=[Coupling("mesh", ("pinion", "plate"), -1.0, 300.0)])


def test_a_universal_joint_turns_about_one_pin_and_then_the_other():
    """Axes R_x(a) R_y(b) of a joint about z, and the spin that is their rate; a torque along the cross does no work."""
    a, b = 0.6, -0.9
    start = {"first": a, "second": b, "first_speed": 1.3, "second_speed": -0.4}
    body = Body("shaft", "universal", mass=1.0, inertia=(0.01, 0.02, 0.025), center=(0, 0, 0.3), start=start)
    scene = Mechanism("shaft", [body], loads=[Torque("twist", "shaft", "z", 5.0)])
    params, t = scene.parameters(), jnp.zeros(())
    y = scene.initial_state(params)
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    moved = scene.motions(t, y, params)["shaft"]
    np.testing.assert_allclose(moved.axes, about_x @ about_y, atol=1e-12)
    axes = lambda t: scene.motions(t, y + t * scene.vector_field(t, y, params), params)["shaft"].axes  # noqa: E731
    rate = np.asarray(jax.jvp(axes, (t,), (jnp.ones(()),))[1]) @ np.asarray(moved.axes).T
    np.testing.assert_allclose(moved.spin, [rate[2, 1], rate[0, 2], rate[1, 0]], atol=1e-12)
    np.testing.assert_allclose(moved.spin, 1.3 * np.eye(3)[0] - 0.4 * about_x[:, 1], atol=1e-12)


def test_a_stop_after_three_turns_by_a_gap_of_ones_own(tmp_path):
    """The page's gap: force K d of d = r (turn - c), its torque r F on the shaft, their derivatives; a load reads the turns."""
    page = (Path(__file__).parents[2] / "docs" / "mechanisms.md").read_text(encoding="utf-8")
    space: dict = {"bj": bj, "gaps": bj.gaps}
    exec(page[page.index("class LeverStop") : page.index("```", page.index("class LeverStop"))], space)
    turns, k, r = 6.2 * np.pi, 1e5, 0.03
    shaft = hinge("shaft", start={"angle": turns, "speed": 2.0})
    stop = Contact("stop", ("ground", "shaft"), space["LeverStop"](), "kelvin_voigt")
    coil = bj.loads.Load("coil", lambda t, bodies, p: [
        bj.loads.Action("shaft", torque=(0.0, 0.0, -0.1 * bodies.parts["shaft"].turn))], ("shaft",))  # fmt: skip
    scene = Mechanism("shaft", [shaft], [stop], [coil])
    given = {"stiffness": k, "dashpot": 10.0, "smoothing": 0.0, "radius": r, "stop_angle": 6.0 * np.pi}
    params, t = scene.parameters(given), jnp.zeros(())
    y = scene.initial_state(params)
    depth, rate = r * 0.2 * np.pi, r * 2.0
    read = scene.observe(t, y, params)["stop"]
    assert float(read.penetration) == pytest.approx(depth, rel=1e-9) and float(read.rate) == pytest.approx(
        rate, rel=1e-9
    )
    force = k * depth + 10.0 * rate
    assert float(read.force[0]) == pytest.approx(force, rel=1e-9)
    speeding = lambda p: 0.01 * scene.vector_field(t, y, p)[1]  # noqa: E731
    assert float(speeding(params)) == pytest.approx(-r * force - 0.1 * turns, rel=1e-9)
    slope = jax.grad(speeding)(params)
    assert float(slope["stop_angle"]) == pytest.approx(k * r * r, rel=1e-9)
    assert float(slope["radius"]) == pytest.approx(-2.0 * force, rel=1e-9)
