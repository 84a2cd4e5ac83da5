"""Mechanisms are identified from what a rig reads of them: SciPy's records in, coefficients out, by Python and by file."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcfj_jax import InputError, scenes, simulate
from bcfj_jax.io.outputs import write_toml
from benchmarks.calibration import mechanisms
from benchmarks.calibration.coverage import bound
from benchmarks.common import ROOT
from benchmarks.common import load as load_result
from benchmarks.references import oblique_impact
from calibration import Channel, Experiment, Free, Problem, command, fit
from calibration.problemfile import load, prepared

pytestmark = pytest.mark.filterwarnings("error")

ACCELERATION = "slider.acceleration.x"
FILE = """scene = "slider_crank"
[[experiment]]
name = "start"
file = "d.csv"
time = "time [us]"
observe = { "slider.acceleration.x" = "acceleration [m/s^2]" }
noise = "1 %"
[free."journal.clearance"]
lower = "0.1 mm"
upper = "1 mm"
[free.stiffness]
lower = 1e10
upper = 5e11
"""


@pytest.fixture(autouse=True)
def alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def recovered(found: Any, truth: dict[str, float]) -> None:
    """Identified, and no estimate four deviations of the noise off: one seed's intervals may miss."""
    assert found.verdict == "identified", found.reasons
    for name, true in truth.items():
        p = found.parameters[name]
        low, high = p.intervals["noise"]
        assert abs(p.value - true) < high - low < 0.1 * true, (name, p.value, low, high)
        assert p.ci95[0] < true < p.ci95[1]


@pytest.mark.slow
def test_friction_from_impacts_that_stick_and_that_slide():
    whole = mechanisms.friction(0.01, 0)
    some = tuple(e for e in whole.experiments if e.name in ("10 deg", "30 deg", "55 deg"))
    tangential = tuple(replace(e, channels=e.channels[:1]) for e in some)
    recovered(fit(replace(whole, experiments=tangential), starts=6), mechanisms.FRICTION)


@pytest.mark.slow
def test_the_bound_is_that_of_scipys_own_derivatives():
    """Cramer-Rao by central differences of the independent code; the estimate that attains it has its variance."""

    def white(**coefficients):
        parts = []
        for angle, times, *peaks in mechanisms.rebounds():
            given = mechanisms.FRICTION | coefficients
            made = oblique_impact.Impact(
                angle=np.radians(angle), friction="brown_mcphee", friction_speed=mechanisms.FRICTION_SPEED, **given
            )
            course = oblique_impact.history(made, times)
            for force, true in zip((course.tangential, course.normal), peaks, strict=True):
                parts.append(force / (0.01 * np.abs(true).max()))
        return np.concatenate(parts)

    step, truth = 1e-4, mechanisms.FRICTION
    columns = [(white(**{n: v * (1 + step)}) - white(**{n: v * (1 - step)})) / (2 * step) for n, v in truth.items()]
    jacobian = np.stack(columns, axis=1)
    expected = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    case = mechanisms.CASES["friction"]
    assert list(bound(case, 0.01, mechanisms.FINE).values()) == pytest.approx(expected, rel=1e-3)
    # Of 400 draws: 0.87 to 1.14 with 95 %, 0.78 to 1.25 with 99.95 %.
    assert np.all(np.abs(np.log(np.mean(mechanisms.linear(case, 400) ** 2, axis=0) / expected**2)) < np.log(1.25))


def test_the_pages_table_is_that_of_the_kept_result():
    assert mechanisms.table(load_result("identification")["cases"]) in (ROOT / "docs" / "fits_measured.md").read_text()


def written(problem: Problem, text: str = FILE) -> Path:
    """The slider-crank's record as a CSV in microseconds, and a calibration file beside it."""
    (one,) = problem.experiments
    rows = np.column_stack([1e6 * one.times, one.channels[0].values])
    np.savetxt("d.csv", rows, "%.17g", ",", header="time [us],acceleration [m/s^2]", comments="")
    Path("p.toml").write_text(text)
    return Path("p.toml")


@pytest.mark.slow
def test_clearance_and_stiffness_from_an_acceleration_by_python_and_by_file():
    problem = mechanisms.clearance(0.01, 0)
    found = fit(problem, starts=6)
    recovered(found, mechanisms.CLEARANCE)
    assert set(found.residual["rms"]) == {"m/s^2"}
    path = written(problem)
    read = load(path)
    assert [f.name for f in read.free] == ["clearance_journal", "stiffness"]
    np.testing.assert_allclose(read.experiments[0].times, problem.experiments[0].times, atol=1e-18)
    # A percentage is of the noisy record's peak, which is not quite the true one.
    assert read.experiments[0].channels[0].sigma == pytest.approx(problem.experiments[0].channels[0].sigma, rel=0.05)
    assert command.run(path, Path("out"), 0, 6) == command.DONE
    told = json.loads(Path("out/fit.json").read_text())
    for name, p in found.parameters.items():
        assert told["parameters"][name]["value"] == pytest.approx(p.value, rel=1e-3)
    assert told["residual"]["rms"]["m/s^2"] == pytest.approx(found.residual["rms"]["m/s^2"], rel=1e-3)
    for picture in ("data", "fit", "force_penetration", "residual_acf"):
        assert Path(f"out/{picture}.png").stat().st_size > 10_000


@pytest.mark.full
def test_the_report_speaks_of_accelerations():
    read = prepared(written(mechanisms.clearance(0.01, 0)))[0]
    assert list(read.readings) == [ACCELERATION] and "N" not in "".join(read.notes).split()
    # On a clipped record the limit is in the channel's unit.
    clipped = FILE.replace("noise", 'saturation = "2e5 m/s^2"\nnoise')
    said = "; ".join(prepared(written(mechanisms.clearance(0.01, 0), clipped))[0].notes)
    assert "samples dropped as saturated" in said
    # What only a normal force must have is a sign.
    flipped = FILE.replace('"acceleration', '"-acceleration').replace("noise", 'align = "onset"\nnoise')
    first_contact = prepared(written(mechanisms.clearance(0.01, 0), flipped))[0].first_contact
    assert first_contact == pytest.approx(2.3e-4, abs=2e-5)


@pytest.mark.parametrize(
    "stated", ["5 m/s^2 + 2 % of reading", "5 m/s^2", "500 cm/s^2", 5.0, "2 %", '{ "%s" = "5 m/s^2" }']
)
def test_noise_is_stated_in_the_readings_own_unit(stated):
    text = f'"{stated}"' if isinstance(stated, str) and "{" not in stated else str(stated)
    problem = mechanisms.clearance(0.01, 0)
    channel = load(written(problem, FILE.replace('"1 %"', text.replace("%s", ACCELERATION)))).experiments[0].channels[0]
    peak = np.abs(channel.values).max()
    assert channel.sigma == pytest.approx(0.02 * peak if stated == "2 %" else 5.0)
    assert channel.relative == (0.02 if "of reading" in str(stated) else 0.0)


WRONG = {
    "body": ("slider.acc", "slidr.acc", ["no contact 'slidr' and no body or load of that name", "did you mean 'slider'?"]),
    "reading": ("acceleration.x", "aceleration.x", ["'slider' has no reading 'aceleration.x'", "did you mean 'acceleration.x'?"]),
    "axis": ("acceleration.x", "acceleration", ["no reading 'acceleration'", "acceleration."]),
    "frame": ('on.x"', 'on.x in rodd"', ["no body 'rodd'", "did you mean 'rod'?"]),
    "unit": ('"acceleration [m/s^2]"', '"time [us]"', ["column 'time [us]'", "converts to m/s^2", "9.81 m/s^2"]),
    "noise's unit": ('"1 %"', '"5 N"', ["noise", "'5 N' is not in a unit that converts to m/s^2"]),
    "saturation's unit": ("noise", 'saturation = "1 kN"\nnoise', ["saturation", "converts to m/s^2"]),
    "saturation of another": ("noise", 'saturation = { "crank.angle" = 1.0 }\nnoise', ["'crank.angle' is not observed"]),
    "offset's unit": ("[free.stiffness]", '[free.force_offset]\nlower = "-1 N"\nupper = "1 N"\n[free.stiffness]',
                      ["[free.force_offset] lower", "converts to m/s^2"]),
    "clearance": ('"journal.clearance"', "clearance_jurnal", ["no parameter 'clearance_jurnal'", "clearance_journal"]),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG, ids=str)
def test_wrong_names_and_units_are_refused_with_the_nearest(case):
    old, new, said = WRONG[case]
    assert old in FILE
    with pytest.raises(InputError) as refused:
        load(written(mechanisms.clearance(0.01, 0), FILE.replace(old, new, 1)))
    for words in said:
        assert words in str(refused.value)


def driven(observed: dict[str, float], **free: tuple[float, float]) -> Problem:
    """A crank without play: readings with noise of a share of each one's peak."""
    scene, times = scenes.slider_crank(ideal=True), np.linspace(0.0, 0.012, 61)
    seen = simulate(scene, scene.parameters(), times, read=tuple(observed)).readings
    channels, draw = [], np.random.default_rng(1)
    for name, share in observed.items():
        sigma = share * float(np.abs(seen[name]).max())
        channels.append(Channel(name, seen[name] + sigma * draw.standard_normal(times.size), sigma))
    params = {name: float(value) for name, value in scene.parameters().items()}
    bounds = tuple(Free(name, low, high) for name, (low, high) in free.items())
    return Problem(scene, params, (Experiment("turn", times, tuple(channels)),), bounds)


@pytest.mark.full
def test_a_drives_torque_and_an_angle_identify_a_mechanism_without_contacts():
    problem = driven({"crank.torque": 0.01, "rod.angle": 0.01}, crank_length=(0.02, 0.09), **{"rod.mass": (0.05, 1.0)})
    found = fit(problem, starts=4)
    recovered(found, {"crank_length": 0.05, "rod.mass": 0.21})
    assert set(found.residual["rms"]) == {"N m", "rad"}
    said = command.text(found)
    assert " mN m and " in said and " rad rms over 122 samples" in said
    assert found.parameters["crank_length"].unit == "m"


@pytest.mark.full
def test_an_offset_is_in_the_channels_unit_and_of_one_unit():
    problem = driven({"rod.angle": 0.002}, rod_length=(0.06, 0.3), force_offset=(-0.1, 0.1))
    seen = problem.experiments[0]
    moved = replace(seen, channels=(replace(seen.channels[0], values=seen.channels[0].values + 0.05),))
    found = fit(replace(problem, experiments=(moved,)), starts=4)
    recovered(found, {"rod_length": 0.12})
    assert found.parameters["force_offset"].unit == "rad"
    assert found.parameters["force_offset"].value == pytest.approx(0.05, abs=0.01)
    with pytest.raises(InputError, match="one force_offset for channels in N m and rad"):
        driven({"crank.torque": 0.01, "rod.angle": 0.01}, force_offset=(-0.1, 0.1))


@pytest.mark.slow
def test_a_whole_contact_is_found_by_the_contact_where_no_force_is_read():
    """A body that flies off is farthest away at the record's end; the contact was over long before."""
    scene = scenes.impact(smoothing=False)
    given = {"mass": 0.1, "stiffness": 1e6, "exponent": 1.5, "approach_speed": 1.0}
    params, name, sigma = scene.parameters(given), "body.place.x", 1e-5
    fixed = {name: float(value) for name, value in params.items()}
    for end, verdict in ((1.2e-2, "identified"), (1.8e-3, "not_identified")):
        times = np.linspace(0.0, end, 61)
        place = simulate(scene, params, times, accuracy=1e-8, read=(name,)).readings[name]
        noisy = place + sigma * np.random.default_rng(0).standard_normal(times.size)
        one = Experiment("a", times, (Channel(name, noisy, sigma),))
        found = fit(Problem(scene, fixed, (one,), (Free("stiffness", 1e5, 1e7),)), starts=4)
        assert found.verdict == verdict, found.reasons
    assert any("shorter than a contact" in reason for reason in found.reasons)


def test_petab_keeps_readings_of_bodies(tmp_path):
    petab = pytest.importorskip("calibration.petab")
    pytest.importorskip("petab.v2", reason="the extra petab is not installed")
    problem = mechanisms.clearance(0.01, 0)
    (one,) = problem.experiments
    turned = replace(one.channels[0], observes="slider.acceleration.x in rod")
    torque = Channel("crank.torque", np.sin(1e4 * one.times), 0.5)
    problem = replace(problem, experiments=(replace(one, channels=(*one.channels, turned, torque)),))
    write_toml(Path("s.toml"), {"scene": {"kind": "slider_crank"}}, "")
    back = petab.load(petab.export(problem, {"scene": {"kind": "slider_crank"}}, tmp_path / "tables"))
    (read,) = back.experiments
    assert [c.observes for c in read.channels] == [c.observes for c in problem.experiments[0].channels]
    for ours, theirs in zip(problem.experiments[0].channels, read.channels, strict=True):
        np.testing.assert_array_equal(theirs.values, ours.values)
        assert theirs.sigma == ours.sigma
    assert {f.name: f for f in back.free} == {f.name: f for f in problem.free}
