"""Every verb on mechanisms that are neither an impact nor the joint: a pendulum, stops, a shaker, a valve, strong damping."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import bcfj
from compiled import COMPILED

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Drive, InputError, Mechanism, Quantity, gaps, loads
from bcfj_jax.analysis import features, nonlinear
from bcfj_jax.analysis.derivatives import certificate
from bcfj_jax.analysis.derivatives.certificate import Difference, Growth
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.analysis.designs import objective, space
from bcfj_jax.analysis.simulation import results
from bcfj_jax.analysis.studies import specification
from bcfj_jax.analysis.tradeoff import advice
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.contact.restitution import exact
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.xla import programs

PENDULUM = """\
[scene]
kind = "mechanism"
[[body]]
name = "bob"
joint = "hinge"
center = ["0.5 m", 0, 0]
mass = "2 kg"
inertia = 0.01
start = { angle = -1.5 }
[[load]]
kind = "gravity"
direction = "-y"
[time]
end = "2 s"
samples = 201
"""
READS = '[[read]]\nof = "bob.angle"\n[[read]]\nof = "bob.acceleration.x"\n'
# Between two stops, and with a friction of its own.
STOPPED = (
    PENDULUM
    + READS
    + """\
[[contact]]
name = "stop"
between = ["ground", "bob"]
gap = { kind = "two_sided_stop", axis = "x" }
at = [[0, "-0.5 m", 0], ["0.5 m", 0, 0]]
law = "memory_free"
friction = "coulomb"
[parameters]
stiffness = 1e6
exponent = 1.2
damping = 0.3
"stop.clearance" = "50 mm"
friction_dynamic = 0.1
friction_speed = "10 mm/s"
"""
)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def written(text, name="my.toml"):
    Path(name).write_text(text)
    return name


# A mechanism without contacts: its readings stand in their place.


@pytest.mark.full
def test_a_pendulum_is_simulated_and_its_readings_are_drawn():
    done = bcfj("simulate", written(PENDULUM + READS), "--out", "out")
    assert done.exit_code == 0, done.stderr
    files = {path.name for path in Path("out").iterdir()}
    assert {"readings.png", "readings.csv", "report.html"} <= files and not files & set(results.PICTURES)
    assert Path("out/readings.png").read_bytes()[:4] == b"\x89PNG"
    # The readings, and the still picture of the animation.
    assert Path("out/report.html").read_text().count("data:image/png") == 2
    assert re.search(r"bob.angle: asked 1 %, measured \S+e-\d+ %", done.stdout)
    # Small swings about -pi/2: T = 2 pi sqrt((I + m l^2)/(m g l)).
    with Path("out/readings.csv").open(newline="") as file:
        table = np.array(list(csv.reader(file))[1:], dtype=float)
    period = 2 * math.pi * math.sqrt((0.01 + 2 * 0.25) / (2 * 9.81 * 0.5))
    expected = -math.pi / 2 + (math.pi / 2 - 1.5) * np.cos(2 * math.pi * table[:, 0] / period)
    np.testing.assert_allclose(table[:, 1], expected, atol=5e-4)


@pytest.mark.slow
def test_a_pendulum_is_differentiated():
    done = bcfj("sensitivity", written(PENDULUM + READS), "--wrt", "bob.center_x", "--out", "out")
    assert done.exit_code == 0, done.stderr
    with Path("out/sensitivity.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head[1:] == ["d(bob.angle)/d(bob.center_x) [rad/m]", "d(bob.acceleration.x)/d(bob.center_x) [m/s^2/m]"] or (
        head[1:] == ["d(bob.angle)/d(bob.center_x) [rad/m]", "d(bob.acceleration.x)/d(bob.center_x) [(m/s^2)/m]"]
    )
    found = json.loads(Path("out/certificate.json").read_text())
    assert found["verdict"] == "trusted"
    assert found["features"]["bob.acceleration.x.largest"]["unit"] == "m/s^2"
    times, slope = (np.array([float(row[k]) for row in rows]) for k in (0, 1))

    def angle(arm):
        return 0.0707963 * np.cos(times / math.sqrt((0.01 + 2 * arm**2) / (2 * 9.81 * arm)))

    np.testing.assert_allclose(slope, (angle(0.501) - angle(0.499)) / 2e-3, atol=2e-3)


def test_without_contact_and_reading_it_says_so(monkeypatch):
    # What other tests have kept is compiled as it is fetched, and what is asked often is compiled, too.
    monkeypatch.setenv("BCFJ_CACHE", "off")
    monkeypatch.setattr(programs.Settings, "folder", None)
    programs.forget()
    COMPILED.clear()
    written(PENDULUM)
    for verb in (("sensitivity", "my.toml", "--wrt", "gravity"), ("tradeoff", "my.toml")):
        done = bcfj(*verb)
        assert done.exit_code == 2 and "has no contact and no reading" in done.stderr
    programs.forget()
    given = scenefile.load("my.toml")
    with pytest.raises(InputError, match="no contact to take features of"):
        bj.sensitivity(given.scene, given.params, given.times, ["gravity"])
    programs.forget()
    with pytest.raises(InputError, match="no contact and no reading"):
        specification.from_table(study_of("my.toml"), "study.toml")
    assert not COMPILED


def study_of(scene):
    return {
        "scene": scene, "design": {"kind": "grid"}, "vary": {"bob.mass": {"lower": 1.0, "upper": 2.0, "steps": 2}},
    }  # fmt: skip


def test_a_study_keeps_readings_by_default():
    study = specification.from_table(study_of(written(PENDULUM + READS)), "study.toml")
    assert [f.name for f in study.features] == ["bob.angle.largest", "bob.acceleration.x.largest"]


# Contacts with a memory between driven bodies: there is no coordinate, and yet a history.

SPEED, NORMAL = 0.02, 1e-4
RUBBING = {"friction_static": 0.2, "friction_dynamic": 0.1, "friction_speed": 0.01, "bristle_stiffness": 1e4}
RUBBING |= {"bristle_damping": 0.1, "stiffness": 1e8, "exponent": 1.5, "damping": 0.0}


@pytest.mark.slow
def test_bristles_between_two_driven_bodies():
    slide = Body("slide", "slide", axis="x", mass=1.0, drive=Drive("constant", speed=SPEED))
    held = Body("held", "slide", axis="y", mass=1.0, drive=Drive("constant", speed=0.0, start=-NORMAL))
    touch = Contact("touch", ("slide", "held"), gaps.PointOnPlane("y"), law="memory_free", friction="lugre")
    scene = Mechanism("rubbing", [slide, held], [touch], given=RUBBING)
    assert scene.traits.history and not scene.coordinates()
    params, times = scene.parameters(), np.linspace(0.0, 5e-3, 51)
    run = bj.simulate(scene, params, times, read=["slide.drive"])
    assert run.status == "ok"
    # The bristle in closed form at constant slip v, z = g (1 - exp(-v t/g)); the plane drags the body that is held.
    static, dynamic, speed = (RUBBING[f"friction_{name}"] for name in ("static", "dynamic", "speed"))
    sigma0, sigma1 = RUBBING["bristle_stiffness"], RUBBING["bristle_damping"]
    g = (dynamic + (static - dynamic) * np.exp(-((SPEED / speed) ** 2))) / sigma0
    left = np.exp(-SPEED * times / g)
    drag = 1e8 * NORMAL**1.5 * (sigma0 * g * (1.0 - left) + sigma1 * SPEED * left)
    np.testing.assert_allclose(run.readings["slide.drive"], drag, rtol=0, atol=2e-3 * drag.max())


@pytest.mark.slow
def test_frictional_lag_between_two_driven_bodies():
    own = {
        name: RUBBING[name]
        for name in ("friction_static", "friction_dynamic", "friction_speed", "stiffness", "exponent", "damping")
    }
    own |= {"friction_memory": 2e-3, "friction_viscous": 0.5}
    slide = Body("slide", "slide", axis="x", mass=1.0, drive=Drive("constant", speed=SPEED))
    held = Body("held", "slide", axis="y", mass=1.0, drive=Drive("constant", speed=0.0, start=-NORMAL))
    touch = Contact("touch", ("slide", "held"), gaps.PointOnPlane("y"), law="memory_free", friction="frictional_lag")
    scene = Mechanism("rubbing", [slide, held], [touch], given=own)
    times = np.linspace(0.0, 1e-2, 51)
    run = bj.simulate(scene, scene.parameters(), times, read=["slide.drive"])
    # In closed form at constant slip v = 2 v_t: x = 16/97 (1 - exp(-t/tau)).
    fallen = 16.0 / 97.0 * (1.0 - np.exp(-times / 2e-3))
    drag = 1e8 * NORMAL**1.5 * ((0.2 - 0.1 * fallen) * np.tanh(8.0) + 0.5 * SPEED)
    np.testing.assert_allclose(run.readings["slide.drive"], drag, rtol=0, atol=1e-4 * drag.max())
    assert drag.min() < 0.94 * drag.max()


@pytest.mark.slow
def test_an_approach_is_remembered_between_two_driven_bodies():
    own = {"stiffness": 1e8, "exponent": 1.5, "restitution": 0.6}
    fall = Body("fall", "slide", axis="y", mass=1.0, drive=Drive("constant", speed=-SPEED, start=1e-4))
    scene = Mechanism(
        "falling", [fall], [Contact("touch", ("ground", "fall"), gaps.PointOnPlane("y"), law="exact")], given=own
    )
    run = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 0.01, 51))
    depth = np.clip(SPEED * run.times - 1e-4, 0.0, None)
    # At the speed that is remembered d'/v0 is 1.
    np.testing.assert_allclose(run.force["touch"][:, 0], 1e8 * depth**1.5 * (1.0 + float(exact(0.6))), rtol=1e-6)


# Drives that swing.


def swinging():
    """A mass on a spring and damper on a table that swings at ``rate``."""
    own = [(Quantity("rate", "rad/s", "of the table"), 20.0), (Quantity("size", "m", "of the swing"), 1e-3)]
    way = Drive("function", function=lambda t, p: p["size"] * jnp.sin(p["rate"] * t))
    bodies = [Body("table", "slide", axis="x", mass=1.0, drive=way), Body("load", "slide", "table", axis="x", mass=2.0)]
    return Mechanism("swing", bodies, loads=[loads.JointSpring("mount", "load", stiffness=800.0, damping=8.0)], own=own)


@pytest.mark.slow
def test_the_exponent_of_a_drive_that_swings():
    scene = swinging()
    # Tangents of m x'' + c x' + k x fade by c/(2 m), whole periods of theirs apart.
    period = 2 * math.pi / math.sqrt(800.0 / 2.0 - 2.0**2)
    found = nonlinear.scene_exponent(scene, scene.parameters(), 10, interval=period, settle=1.0, batches=2)
    assert not found.reason and found.value == pytest.approx(-2.0, abs=1e-3)


@pytest.mark.slow
def test_a_section_of_a_drive_that_swings():
    scene, rate = swinging(), 20.0
    params = scene.parameters()
    section = nonlinear.stroboscopic(scene, params, 40, transients=36, period=lambda p: 2 * math.pi / p["rate"])
    # Steady swing on the table: x = Im(X e^(i w t)), X = a w^2 m/(k - m w^2 + i c w).
    steady = 1e-3 * rate**2 * 2.0 / complex(800.0 - 2.0 * rate**2, 8.0 * rate)
    np.testing.assert_allclose(section.states[:, 0], steady.imag, rtol=1e-4)
    assert nonlinear.period_number(section.states, 1e-6) == 1


def test_periods_that_are_not_there_are_asked_for():
    scene = swinging()
    params = scene.parameters()
    for ask in (
        lambda: nonlinear.stroboscopic(scene, params, 4, transients=1),
        lambda: nonlinear.bifurcation(scene, params, "rate", [20.0], 4, transients=1),
        lambda: nonlinear.scene_exponent(scene, params, 10, settle=1.0),
    ):
        with pytest.raises(
            InputError, match=r"none of its drives turns: table; give the period, or interval and settle"
        ):
            ask()
    with pytest.raises(InputError, match="period: -1 s"):
        nonlinear.stroboscopic(scene, params, 4, transients=1, period=-1.0)


# Strong damping.


def mount(damping, *, stiffness=1e3):
    """A mass pushed with 10 N against a spring and a damper, for 1 s."""
    oil = loads.JointSpring("oil", "mass", stiffness=stiffness, damping=damping)
    return Mechanism(
        "mount", [Body("mass", "slide", axis="x", mass=1.0)], loads=[oil, loads.Force("push", "mass", size=10.0)]
    )


def test_strong_damping_runs_in_few_steps():
    scene, times = mount(1e7), np.linspace(0.0, 1.0, 51)
    assert scene.traits.stiff
    run = bj.simulate(scene, scene.parameters(), times, read=["mass.place.x"])
    # An explicit solver would take some r T/3 = 3e6 steps.
    assert run.stats["accepted"] + run.stats["rejected"] < 2000
    expected = 1e-2 * -np.expm1(-times * 1e3 / 1e7)
    np.testing.assert_allclose(run.readings["mass.place.x"], expected, atol=1e-5 * expected.max())


def test_which_damping_is_strong():
    COMPILED.clear()
    weak = mount(10.0)
    assert not weak.traits.stiff
    # Values that a run is given count, and its length.
    strong = weak.suited(weak.parameters({"oil.damping": 1e6}), 1.0)
    assert strong.traits.stiff and not weak.suited(weak.parameters({"oil.damping": 1e6}), 0.01).traits.stiff
    # One program more, whatever the values are.
    other = weak.suited(weak.parameters({"oil.damping": 1e7}), 2.0)
    assert other.traits.stiff and strong == other
    # A spring that oscillates faster asks for short steps of every solver.
    assert not mount(1e5, stiffness=1e11).traits.stiff
    # A damper across a bush, and a load of the user's own.
    bodies = [Body("mass", "planar", mass=1.0, inertia=1e-3)]
    held = Mechanism("held", bodies, loads=[loads.Bush("bush", ("ground", "mass"), stiffness=10.0, damping=1e6)])
    assert held.traits.stiff
    own = loads.Load(
        "drag", lambda t, now, p: [loads.Action("mass", tuple(-1e6 * v for v in now.velocity("mass")))], ("mass",)
    )
    assert Mechanism("drag", bodies, loads=[own]).traits.stiff
    # A value that is missing is a matter of ``check``.
    assert not Mechanism(
        "bare", [Body("mass", "slide")], loads=[loads.JointSpring("oil", "mass", damping=1e9)]
    ).traits.stiff
    assert not COMPILED


def test_a_scene_file_with_strong_damping_takes_an_implicit_solver():
    table = PENDULUM + '[[load]]\nkind = "joint_spring"\nname = "oil"\nbody = "bob"\ndamping = 1.0\n'
    assert not scenefile.load(written(table)).scene.traits.stiff
    assert scenefile.load(written(table + '[parameters]\n"oil.damping" = 1e6\n')).scene.traits.stiff


# Words and numbers of the verbs.


def difference(relative):
    return Difference(relative, 0.5, 0.7)


def test_before_two_tolerances_agree_no_kink_is_blamed():
    def remark(rungs):
        apart = [
            certificate.Comparison(what, difference(x), difference(x))
            for what, x in (("rungs", rungs), ("differences", 0.3))
        ]
        return certificate.check(apart, certificate.Seen({}, Growth(1.0, 0.0), 1.0, math.nan)).remark

    assert "kink or a jump" in remark(0.01)
    assert "it depends on the tolerance" in remark(0.2)


def test_both_names_of_a_clearance_are_known_to_every_verb():
    given = scenefile.load(written(STOPPED))
    assert complete(given.scene, given.params, ["stop.clearance"])[1] == ("clearance_stop",)
    assert space.space(given.scene, given.params, {"stop.clearance": (0.01, 0.06)}).names == ("clearance_stop",)


def test_a_design_by_a_reading_has_its_unit():
    assert objective.unit_of("bob.acceleration.x.largest") == "m/s^2"
    assert objective.unit_of("stop.peak_penetration") == "m" and objective.unit_of("stop.largest") == "N"
    with pytest.raises(InputError, match="each with a finite weight"):
        objective.objective({"stop.peak": math.inf}, (), {"stop": 0})
    free: Any = {"stop.clearance": (0.0, 1.0)}
    with pytest.raises(InputError, match="each with a finite weight"):
        objective.objective(free, (), {"stop": 0})


def test_the_work_on_a_signed_contact_is_that_of_both_sides():
    times = np.linspace(0.0, 1.0, 1001)
    depth = np.abs(np.sin(2 * np.pi * times)) - 0.2
    rate = np.gradient(depth, times)
    force = np.where(depth > 0, depth * (1.0 + 0.01 * rate), 0.0)
    plain = features.summary(times, force, depth, rate)["dissipated_work"]
    signed = features.summary(times, np.where(times < 0.5, force, -force), depth, rate)["dissipated_work"]
    assert plain > 0 and signed == pytest.approx(plain)


def test_a_feature_of_a_reading_of_members():
    scene = bj.scenes.slider_guide()
    watched = observing(scene, ["guide.penetration.largest", "guide_2.penetration.largest"])
    assert watched.members == {"guide": 4, "guide.penetration": 4, "guide_2.penetration": 0}
    params = scene.parameters()
    y = jax.eval_shape(scene.initial_state, params)
    found = jax.eval_shape(lambda y: watched.observe(jnp.zeros(()), y, params), y)
    assert found["guide.penetration"].force.shape == (4, 3) and found["guide_2.penetration"].force.shape == (3,)


def test_a_tradeoff_tries_what_a_mechanism_heeds_and_gives_its_whole_file():
    stopped = scenefile.load(written(STOPPED))
    pendulum = scenefile.shown(scenefile.load(written(PENDULUM + READS, "pendulum.toml")))
    for given in (stopped, pendulum):
        todo = settings(given)
        assert not [setting.name for setting in todo if setting.group == "friction law"]
        again = scenefile.load(written(advice.pasted(todo[0], "1 %")["toml"], "again.toml"))
        assert again.resolved == given.resolved
    # Where contacts leave friction to the scene, its law is one of the settings.
    shared = STOPPED.replace('friction = "coulomb"\n', "").replace(
        '"mechanism"', '"mechanism"\nfriction = "coulomb"', 1
    )
    assert [s for s in settings(scenefile.load(written(shared))) if s.name.startswith("friction none")]


# Whole verbs.


@pytest.mark.slow
def test_every_command_on_a_pendulum_between_stops():
    written(STOPPED.replace("angle = -1.5", "angle = -1.57, speed = 2"))
    for verb in (
        ("simulate", "my.toml"),
        ("sensitivity", "my.toml", "--wrt", "stop.clearance,damping"),
        ("tradeoff", "my.toml", "--only", "bosh3", "--no-derivatives", "--budget", 120),
    ):
        done = bcfj(*verb, "--out", f"out-{verb[0]}")
        assert done.exit_code == 0, done.stderr
    assert set(json.loads(Path("out-sensitivity/certificate.json").read_text())["parameters"]) == {
        "clearance_stop",
        "damping",
    }
    told = json.loads(Path("out-tradeoff/tradeoff.json").read_text())
    assert told["status"] == "ok" and told["recommended"]["10 %"]["setting"]


@pytest.mark.slow
def test_a_tradeoff_and_a_fit_of_a_pendulum():
    written(PENDULUM + READS)
    done = bcfj("tradeoff", "my.toml", "--only", "tsit5", "--budget", 120, "--out", "out")
    assert done.exit_code == 0, done.stderr
    assert bcfj("simulate", "my.toml", "--out", "run").exit_code == 0
    fit = 'scene = "my.toml"\n[[experiment]]\nfile = "run/readings.csv"\ntime = "time [s]"\nnoise = "0.01 m/s^2"\n'
    fit += 'observe = { "bob.acceleration.x" = "bob.acceleration.x [m/s^2]" }\n'
    written(fit + '[free."bob.center_x"]\nlower = "0.3 m"\nupper = "0.8 m"\n', "fit.toml")
    done = bcfj("calibrate", "fit.toml", "--starts", 4, "--out", "fit")
    found = json.loads(Path("fit/fit.json").read_text())
    assert found["parameters"]["bob.center_x"]["value"] == pytest.approx(0.5, rel=1e-4), done.stdout


@pytest.mark.slow
def test_a_design_of_a_pendulum():
    given = scenefile.load(written(PENDULUM + READS))
    times = np.linspace(0.0, 1.0, 201)
    free = {"bob.center_x": (0.1, 0.4)}
    found = bj.design(given.scene, given.params, times, "bob.spin.z.largest", free, sense="maximise", starts=4)
    # The quickest pendulum has its arm equal to its radius of gyration: m l^2 = I.
    assert found.status == "ok" and found.unit == "rad/s"
    assert found.values["bob.center_x"] == pytest.approx(math.sqrt(0.01 / 2), abs=1e-3) or found.at_bound


@pytest.mark.slow
def test_a_bifurcation_of_a_ball_on_a_shaker():
    own = [(Quantity("rate", "rad/s", "of the table"), 200.0), (Quantity("size", "m", "of the swing"), 1e-4)]
    way = Drive("function", function=lambda t, p: p["size"] * jnp.sin(p["rate"] * t))
    bodies = [Body("table", "slide", axis="z", mass=1.0, drive=way), Body("ball", "slide", axis="z", mass=0.1)]
    hit = Contact("hit", ("table", "ball"), gaps.PointOnPlane("z"), law="kelvin_voigt")
    numbers = {"stiffness": 1e6, "dashpot": 300.0}
    scene = Mechanism("shaker", bodies, [hit], [loads.Gravity("-z")], own=own, given=numbers)
    # Below a w^2 = g the ball stays on the table, and presses with m g where the table passes its middle.
    found = nonlinear.bifurcation(
        scene, scene.parameters(), "rate", [100.0, 200.0], 30, transients=26, period=lambda p: 2 * math.pi / p["rate"]
    )
    assert not found.failed.any()
    np.testing.assert_allclose(found.force["hit"][..., 0], 0.1 * 9.81, rtol=0.02)
