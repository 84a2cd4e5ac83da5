"""Penetrations and pressures that no solid body has are said before all else; sound runs are not troubled."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tiers
from commands import bcfj

import bcfj_jax as bj
from bcfj_jax.analysis import plausibility
from bcfj_jax.analysis.plausibility import PENETRATION, PRESSURE

TIMES = np.linspace(0.0, 2e-4, 401)
MODULUS = 1.15e11


def scene_of_a_ball():
    body = bj.Body("ball", "slide", axis="z", mass=1.0, start={"position": 1.0, "velocity": -1.0})
    contact = bj.Contact("floor", ("ground", "ball"), bj.gaps.SphereOnPlane(), "hertz", smoothing=False)
    return bj.Mechanism("ball", (body,), (contact,), given={"stiffness": 1.0, "exponent": 1.5, "radius": 1.0})


BALL = scene_of_a_ball()


def ball(radius: float, stiffness: float, mass: float, speed: float):
    """A sphere that strikes a plane, by Hertz's law, and its parameters: one program."""
    numbers = {"ball.mass": mass, "ball.position": radius, "ball.velocity": -speed}
    return BALL, BALL.parameters({**numbers, "stiffness": stiffness, "radius": radius})


def found(what, times=TIMES):
    scene, params = what
    return plausibility.of_run(scene, params, bj.simulate(scene, params, times, accuracy=1e-4))


@pytest.mark.parametrize("speed", [0.05, 0.5, 5.0])
def test_the_pressure_is_hertzs(speed):
    """p_0 = (6 F E*^2/(pi^3 R^2))^(1/3), at the peak of an impact by Hertz's stiffness 4/3 E* sqrt(R)."""
    radius, mass = 5e-3, 4e-3
    what = ball(radius, 4.0 / 3.0 * MODULUS * radius**0.5, mass, speed)
    depth = (1.25 * mass * speed**2 / (4.0 / 3.0 * MODULUS * radius**0.5)) ** 0.4
    force = 4.0 / 3.0 * MODULUS * radius**0.5 * depth**1.5
    hertz = (6.0 * force * MODULUS**2 / (np.pi**3 * radius**2)) ** (1.0 / 3.0)
    (one, *more) = found(what) or [None]
    assert not more
    assert (one is not None) == (hertz > plausibility.ISO_76)
    if one is not None:
        assert (one.contact, one.what) == ("floor", PRESSURE)
        assert one.value == pytest.approx(hertz, rel=1e-2)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_it_does_not_depend_on_the_scale(scale):
    """Lengths x s, masses x s^3, the same stiffness of the material and speed: the same depth by size, and pressure."""
    one = found(ball(5e-3, 4.0 / 3.0 * MODULUS * 5e-3**0.5, 4e-3, 5.0))
    other = found(ball(5e-3 * scale, 4.0 / 3.0 * MODULUS * (5e-3 * scale) ** 0.5, 4e-3 * scale**3, 5.0), TIMES * scale)
    assert other[0].value == pytest.approx(one[0].value, rel=1e-2)


def test_a_stiffness_in_another_unit_is_said_with_its_cause():
    # 1e9 N/m^1.5 meant as N/mm^1.5 the other way round.
    sound, soft = ball(5e-3, 1e9, 4e-3, 0.1), ball(5e-3, 1e9 / 1e3**1.5 / 10.0, 4e-3, 0.5)
    assert not found(sound)
    (one,) = found(soft, np.linspace(0.0, 0.05, 401))
    assert one.what == PENETRATION and one.most == pytest.approx(0.1 * 5e-3)
    text = plausibility.headline([one])
    assert "the bodies pass into each other" in text and "unit of the stiffness" in text


@pytest.mark.parametrize("scale", tiers.ci([1e-2, 1.0, 1e2], 1e2))
@pytest.mark.parametrize(("stiffness", "sound"), [(1e10, True), (1e7, True), (10.0, False)])
def test_without_sizes_a_depth_is_judged_by_the_mass(scale, stiffness, sound):
    """Lengths x s, masses x s^3, K/s^(1/2): the same depth d = (5 m v^2/(4 K))^(2/5) by the edge of a cube of water."""
    mass, speed = 0.5 * scale**3, 3.0
    scene = bj.scenes.impact(law="hertz", smoothing=False)
    params = scene.parameters(mass=mass, stiffness=stiffness * scale**0.5, exponent=1.5, approach_speed=speed)
    depth = (1.25 * mass * speed**2 / (stiffness * scale**0.5)) ** 0.4
    edge = (mass / 1000.0) ** (1.0 / 3.0)
    assert (depth < edge) == sound
    times = np.linspace(0.0, 4.0 * depth / speed, 201)
    said = plausibility.of_run(scene, params, bj.simulate(scene, params, times))
    assert bool(said) != sound
    if said:
        assert said[0].most == pytest.approx(edge) and "cube of" in plausibility.headline(said)


@pytest.mark.slow
def test_nothing_is_said_where_a_scene_is_sound():
    assert not found((bj.scenes.impact(), bj.scenes.impact().parameters()))
    for kind in ("oblique_impact", "slider_crank"):
        scene = getattr(bj.scenes, kind)()
        assert not found((scene, scene.parameters()), np.linspace(0.0, 2e-4, 201)), kind


SCENE = """[scene]
kind = "mechanism"
[[body]]
name = "ball"
joint = "slide"
axis = "z"
mass = 0.004
start = { position = "5 mm", velocity = "-0.5 m/s" }
[[contact]]
name = "floor"
between = ["ground", "ball"]
gap = "sphere_on_plane"
law = "memory_free"
values = { radius = "5 mm" }
[parameters]
stiffness = 3e3
exponent = 1.5
damping = 0.1
[time]
end = "50 ms"
samples = 201
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("absurd")
    (place / "ball.toml").write_text(SCENE)
    return place


def run(*arguments: str):
    return bcfj(*list(arguments))


@pytest.mark.slow
def test_simulate_says_it_first(folder):
    done = run("simulate", str(folder / "ball.toml"), "--out", str(folder / "run"))
    assert done.stdout.startswith("Not plausible. floor is pressed"), done.stdout
    assert "Finished. " in done.stdout.split("\n\n")[0] and done.exit_code == 0
    summary = json.loads((folder / "run" / "summary.json").read_text())
    assert summary["plausibility"]["verdict"] == "implausible"
    assert summary["warnings"][0] == summary["plausibility"]["reason"]
    page = json.loads((folder / "run" / "report.json").read_text())
    assert page["verdict"]["word"] == "Not plausible" and page["verdict"]["kind"] == "bad"


@pytest.mark.slow
@pytest.mark.parametrize("verb", tiers.ci(["sensitivity", "study", "design"], "study"))
def test_every_verb_says_it_first(verb, folder):
    scene, out = str(folder / "ball.toml"), str(folder / verb)
    study = folder / "vary.toml"
    study.write_text(
        f'scene = "{scene}"\n[vary.damping]\nlower = 0.05\nupper = 0.2\nsteps = 2\n[results]\nfeatures = ["floor.peak"]\n'
    )
    arguments = {
        "sensitivity": ("sensitivity", scene, "--wrt", "ball.mass", "--budget", "1"),
        "study": ("study", "run", str(study), "--workers", "1"),
        "design": ("design", scene, "--minimize", "floor.peak", "--vary", "damping=0.05:0.2", "--starts", "2",
                   "--no-confirm", "--no-certify"),
    }[verb]  # fmt: skip
    done = run(*arguments, "--out", out)
    first = done.stdout.strip().splitlines()[0]
    assert "floor is pressed" in first and "unit of the stiffness" in first, done.stdout + done.stderr
    page = json.loads((folder / verb / "report.json").read_text())
    assert page["verdict"]["word"] == "Not plausible"


@pytest.mark.slow
def test_a_run_that_failed_stays_failed(folder):
    done = run("simulate", str(folder / "ball.toml"), "--set", "accuracy.max_steps=5", "--out", str(folder / "failed"))
    assert done.exit_code == 3, done.stdout + done.stderr
    page = json.loads((folder / "failed" / "report.json").read_text())
    assert page["verdict"]["word"] == "Failed"
