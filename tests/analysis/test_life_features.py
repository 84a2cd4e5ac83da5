"""Wear volume, peak pressure and rolling life as features: by hand, against differences, in files and refusals."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Drive, InputError, Mechanism, gaps
from bcfj_jax.analysis import features, life
from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.measures import measure, vector
from bcfj_jax.analysis.derivatives.names import feature, feature_unit
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism import materials
from bcfj_jax.mechanism.observed import observing
from calibration import Experiment, Free, Observation, Problem, fit

WEAR, PRESSURE, LIFE = (f"track.{kind}" for kind in ("wear_volume", "peak_pressure", "rolling_life"))
DEPTH, SPEED, RADIUS, STIFFNESS, END = 1e-5, 0.3, 8e-3, 1.3e10, 0.25
FORCE = STIFFNESS * DEPTH**1.5


def dragged(friction: Any = True, recedes: bool = False):
    """A ball that is dragged over a plane at a constant depth and speed: nothing is integrated."""
    bodies = (
        Body("sled", "slide", axis="x", mass=1.0, drive=Drive("constant", speed=SPEED)),
        Body("ball", "fixed", parent="sled", at=(0, 0, RADIUS - DEPTH), mass=1.0),
    )
    track = Contact(
        "track", ("ground", "ball"), gaps.SphereOnPlane(clearance=recedes), smoothing=False, friction=friction
    )
    given = {
        "stiffness": STIFFNESS, "exponent": 1.5, "damping": 0.0, "radius": RADIUS, "friction_static": 0.12,
        "friction_dynamic": 0.03, "friction_speed": 0.01,
    }  # fmt: skip
    return Mechanism(
        "dragged", bodies, (track,), given={k: x for k, x in given.items() if k in (*track.reads, "radius")}
    )


def by_hand(hardness=7.0e9):
    """Of ``dragged`` for ``END`` seconds: k/H N v T, Hertz's (6 N E*^2/(pi^3 R^2))^(1/3), (C/N)^3."""
    return {
        WEAR: 1e-6 / hardness * FORCE * SPEED * END,
        PRESSURE: (6.0 * FORCE * 113e9**2 / (math.pi**3 * RADIUS**2)) ** (1.0 / 3.0),
        LIFE: (30e3 / FORCE) ** 3,
    }


def values(scene, wanted=(WEAR, PRESSURE, LIFE)):
    """Features of ``dragged`` by the definitions of commands, from a run that shows them."""
    shown = observing(scene, wanted)
    times = np.linspace(0.0, END, 11)
    run = bj.simulate(shown, shown.parameters(), times)
    force = np.concatenate([run.force[c.name].reshape(11, -1, 3) for c in shown.contacts], axis=1)
    depth = np.concatenate([run.penetration[c.name].reshape(11, -1) for c in shown.contacts], axis=1)
    found = Histories(force, depth, np.zeros_like(depth), None)
    named = [feature(name, shown.members) for name in wanted]
    none = Histories(force[None][:0], depth[None][:0], depth[None][:0], None)
    numbers, _ = measure(times, found, none, named, shown.members, False)
    assert np.allclose(vector(times, found, named, shown.members, {}), numbers, rtol=1e-14)
    return dict(zip(wanted, numbers, strict=True))


def test_by_hand():
    for name, expected in by_hand().items():
        assert values(dragged())[name] == pytest.approx(expected, rel=1e-12)


def test_of_a_run_and_with_other_materials():
    scene = dragged()
    own = life.with_materials(scene, {"hardness": 14.0e9, "track": {"load_rating": 15e3}})
    expected = by_hand(14.0e9)
    expected[LIFE] /= 8.0
    assert values(own) == pytest.approx(expected, rel=1e-12)
    run = bj.simulate(own, own.parameters(), np.linspace(0.0, END, 11))
    found = life.of_run(own, own.parameters(), run)["track"]
    assert {f"track.{kind}": x for kind, x in found.items()} == pytest.approx(expected, rel=1e-12)


def test_clearance_grows_by_what_is_worn():
    """The plane recedes from the sled's track by what was worn, block after block, and the ball presses less on it."""
    scene = dragged(recedes=True)
    params = scene.parameters(clearance_track=2e-6)
    times, area, repeats = np.linspace(0.0, END, 11), 1e-6, 5e2
    found = life.grown(scene, params, times, "track", repeats / area, 3)
    expected = [2e-6]
    for _ in range(3):
        force = STIFFNESS * (DEPTH - expected[-1]) ** 1.5
        expected.append(expected[-1] + repeats * 1e-6 / 7.0e9 * force * SPEED * END / area)
    assert found == pytest.approx(expected, rel=1e-10) and expected[-1] < DEPTH
    assert expected[-1] > 3e-6
    with pytest.raises(InputError, match="no clearance"):
        life.grown(dragged(), dragged().parameters(), times, "track", 1.0 / area, 1)


def test_members_and_kinds():
    force = np.zeros((3, 2, 3))
    force[:, :, 0] = [[1.0, 2.0]] * 3
    found = Histories(force, force[:, :, 0], force[:, :, 0], None)
    none = Histories(force[None][:0], force[None][:0, :, :, 0], force[None][:0, :, :, 0], None)
    times, contacts = np.array([0.0, 1.0, 2.0]), {"a.load_share": 2}
    one = feature("a.rolling_life", {"a": 2})
    assert one.contacts == ("a.load_share",)
    # Of members the least: (C/P)^3 of the second.
    assert measure(times, found, none, [one], contacts, False)[0][0] == pytest.approx(1.0 / 8.0)
    assert [feature_unit(name) for name in (WEAR, PRESSURE, LIFE)] == ["m^3", "Pa", "1"]
    # A study scales times to one second: a volume that grows with the time, too.
    assert features.KINDS["wear_volume"].per_second and not features.KINDS["peak_pressure"].per_second


@pytest.mark.slow
def test_derivatives_of_the_wear_volume_are_those_of_differences():
    scene = bj.scenes.oblique_impact()
    params = scene.parameters(friction_dynamic=0.08)
    times = np.linspace(0.0, float(scene.horizon(params)), 801)
    wrt = ("friction_dynamic", "mass", "stiffness")
    found = bj.sensitivity(scene, params, times, wrt, features=["contact.wear_volume"], accuracy=1e-4)
    for name in wrt:
        step = 1e-3 * params[name]
        ends = [
            float(life.wear_volume(scene, params | {name: params[name] + sign * step}, times, "contact"))
            for sign in (1, -1)
        ]
        slope = (ends[0] - ends[1]) / (2.0 * float(step))
        elastic = float(slope * params[name]) / found.features["contact.wear_volume"]
        ours = found.feature_derivatives[name]["contact.wear_volume"] * float(params[name])
        assert ours / found.features["contact.wear_volume"] == pytest.approx(elastic, abs=1e-3)


def test_what_a_contact_has_not_is_refused():
    with pytest.raises(InputError, match="no friction"):
        observing(dragged(friction=None), [WEAR])
    scene = bj.scenes.slider_guide()
    shown = observing(scene, ["guide.peak_pressure"])
    with pytest.raises(InputError, match="Hertz"):
        shown.prepare(shown.parameters())
    with pytest.raises(InputError, match="wear_volume"):
        feature("track.wear_volum", {"track": 0})


def test_the_table_of_a_file():
    table = {"scene": {"kind": "oblique_impact"}, "life": {"hardness": "7.5 GPa", "contact": {"load_rating": "25 kN"}}}
    given = scenefile.from_table(table, None)
    assert materials.material(given.scene, "contact") == materials.STEEL | {"hardness": 7.5e9, "load_rating": 25e3}
    again = scenefile.from_table(given.resolved, None)
    assert again.scene == given.scene and "life" not in scenefile.load("oblique_impact").resolved
    for wrong, said in (
        ({"hardnes": 1.0}, "hardness"), ({"hardness": -1.0}, "> 0"), ({"hardness": "3 mm"}, "Pa"),
        ({"contact": {"load_ratin": 1.0}}, "load_rating"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            scenefile.from_table({"scene": {"kind": "oblique_impact"}, "life": wrong}, None)
    with pytest.raises(InputError, match="reads no materials"):
        life.with_materials(observing(dragged(), [PRESSURE]), {"hardness": 1e9})
    assert set(materials.SOURCES) == set(materials.STEEL)


@pytest.mark.filterwarnings("error")
def test_a_contact_that_bears_nothing_lives_without_end_and_wears_nothing():
    times, nothing = np.linspace(0.0, 1.0, 11), np.zeros(11)
    seen = features.Seen(times, nothing, None)
    assert features.KINDS["rolling_life"].of(seen) == math.inf
    assert features.KINDS["wear_volume"].of(seen) == features.KINDS["peak_pressure"].of(seen) == 0.0
    slope = jax.grad(lambda x: features.KINDS["rolling_life"].of(features.Seen(times, x * jnp.ones(11), None)))
    assert float(slope(2.0)) == pytest.approx(-3.0 / 16.0) and float(slope(0.0)) == 0.0


def test_a_pin_presses_along_a_line():
    # Johnson 1985, 4.45: p0 = sqrt(F E*/(pi L R)), a = sqrt(4 F R/(pi L E*)), F = pi/2 p0 a L.
    line = bj.stiffness.LineContact(113e9, 0.02, 0.8, np.inf)
    force = jnp.asarray([0.0, 100.0, 2e3])
    pressure, width = line.peak_pressure(force), line.half_width(force)
    assert np.allclose(pressure, np.sqrt(np.asarray(force) * 113e9 / (math.pi * 0.02 * 0.8)), rtol=1e-12)
    assert np.allclose(0.5 * math.pi * pressure * width * 0.02, force, rtol=1e-12)
    # Where the patch would be wider than the pin the load is the cosine's over half of the hole: F = pi/2 p0 r L.
    pin = bj.stiffness.LineContact(113e9, 0.016, 8e-3 * 8.01e-3 / 1e-5, 8e-3)
    assert float(pin.half_width(33e3)) == 8e-3
    assert float(pin.peak_pressure(33e3)) == pytest.approx(33e3 / (0.5 * math.pi * 8e-3 * 0.016), rel=1e-12)
    assert float(pin.peak_pressure(1e3)) == pytest.approx(math.sqrt(1e3 * 113e9 / (math.pi * 0.016 * 6.408)), rel=1e-12)


@pytest.mark.parametrize("length", [None, 0.02])
def test_pressure_of_hookes_pins(length):
    scene = bj.scenes.hooke()
    if length is not None:
        scene = life.with_materials(scene, {"input_pins": {"contact_length": length}})
    params, name = scene.parameters(), "input_pins"
    read = materials.share(scene, params, name, "pressure")
    radius, play = float(params["radius"]), float(params[f"clearance_{name}"])
    right = bj.stiffness.LineContact(113e9, length or 2.0 * radius, radius * (radius + play) / play, radius)
    assert np.allclose(read, right.unit_pressure, rtol=1e-12)


@pytest.mark.slow
def test_a_string_reads_the_materials_of_its_joints():
    string = life.with_materials(bj.scenes.string(n=2, fidelity="kinematic"), {"seat_ball": {"load_rating": 20e3}})
    joint = bj.scenes.joint(fidelity="kinematic")
    params = string.parameters()
    assert string.unit_pressure(params, "seat_ball", {}) == pytest.approx(
        joint.unit_pressure(joint.parameters(), "seat_ball", {})
    )
    shown = observing(string, ["seat_ball_8.peak_pressure", "seat_ball_8.rolling_life"])
    run = bj.simulate(shown, shown.parameters(), np.linspace(0.0, 0.2, 5))
    force = run.force["seat_ball"][:, 7, 0]
    share = float(string.unit_pressure(params, "seat_ball", {})[0])
    assert np.allclose(run.force["seat_ball_8.pressure"][..., 0], share * np.cbrt(force), rtol=1e-12)
    assert np.allclose(run.force["seat_ball_8.load_share"][..., 0], force / 20e3, rtol=1e-12)


@pytest.mark.slow
def test_a_worn_volume_and_a_pressure_tell_the_stiffness():
    """ln V goes with ln K, ln p with a third of it: 2 % of each leave 2 %/sqrt(1 + 1/9), by hand."""
    scene, truth = dragged(), by_hand()
    seen = tuple(Observation(name, truth[name], 0.02 * truth[name]) for name in (WEAR, PRESSURE))
    one = Experiment("dragged", np.zeros(0), (), features=seen, span=END)
    found = fit(Problem(scene, scene.parameters(stiffness=5e9), (one,), (Free("stiffness", 1e9, 1e11),)), starts=4)
    assert found.verdict == "identified", found.reasons
    assert found.parameters["stiffness"].value == pytest.approx(STIFFNESS, rel=1e-6)
    low, high = np.log(found.parameters["stiffness"].ci95)
    assert (high - low) / 2 == pytest.approx(1.96 * 0.02 / math.sqrt(1.0 + 1.0 / 9.0), rel=1e-3)
