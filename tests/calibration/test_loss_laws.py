"""Runs of several speeds whose loss no law has: that is named before a clock's jitter, and the elastic force is given.

The records are by SciPy. F = K d^n (1 + a sign(d') |d'|^q) loses a share of the energy that goes as the q-th power of the
speed of approach, to first order: with q = 1 it is Hunt and Crossley's law, with q = 0.2 no law in the list.
"""

from __future__ import annotations

import itertools
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
import tiers
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from bcfj_jax import scenes
from calibration import Channel, Experiment, Fit, Free, Problem, command, fit
from calibration.diagnostics.catalogue import LOSS
from calibration.report.diagnosis import as_json, sections
from calibration.selection import agreement
from calibration.selection.choice import decided, rival
from calibration.selection.diagnosis import rank

MASS, STIFFNESS, EXPONENT, SPEEDS = 0.5, 5e7, 1.5, (0.3, 0.6, 1.2, 2.4)
TIMES = np.linspace(-2e-4, 3.6e-3, 240)
COEFFICIENT = {"memory_free": Free("damping", 1e-3, 3.0), "exact": Free("restitution", 0.1, 1.0)}


def contact(speed: float, share: float, power: float, times: np.ndarray) -> tuple[np.ndarray, float]:
    """Force (T,) of a contact that begins at time 0, and its restitution."""

    def law(depth: float, rate: float) -> float:
        loss = 1.0 + share * np.sign(rate) * abs(rate) ** power
        return STIFFNESS * max(depth, 0.0) ** EXPONENT * max(loss, 0.0)

    run = solve_ivp(
        lambda t, y: [y[1], -law(y[0], y[1]) / MASS], (0.0, 1e-2), [0.0, speed], "DOP853", rtol=1e-9, atol=1e-14,
        max_step=2e-5, dense_output=True,
    )  # fmt: skip
    end = int(np.flatnonzero((run.y[0] < 0.0) & (run.t > 1e-5))[0])
    states = run.sol(np.clip(times, 0.0, 1e-2))
    force = np.array([law(d, v) for d, v in states.T]) * (times > 0.0) * (times < run.t[end])
    return force, -float(run.y[1][end]) / speed


def calibrated(
    law: str,
    share: float,
    power: float,
    speeds: tuple[float, ...] = SPEEDS,
    noise: float = 0.005,
    jitter: float = 0.0,
    change=lambda force: force,
) -> tuple[Problem, Fit]:
    rng, runs = np.random.default_rng(1), []
    scene = scenes.impact(law=law, smoothing=False)
    for k, speed in enumerate(speeds):
        force, _ = contact(speed, share, power, TIMES + jitter * rng.standard_normal(TIMES.size))
        values = change(force) + noise * force.max() * rng.standard_normal(TIMES.size)
        fixed = {"approach_speed": speed, "mass": MASS}
        runs.append(Experiment(f"run {k}", TIMES + 2e-4, (Channel("contact.normal", values, None),), fixed=fixed))
    free = (Free("stiffness", 1e6, 1e9), Free("exponent", 1.0, 2.5), COEFFICIENT[law], Free("time_offset", 0.0, 4e-4))
    problem = Problem(scene, {k: float(v) for k, v in scene.parameters({}).items()}, tuple(runs), free)
    return problem, fit(problem, starts=4, systematic=False)


def test_the_record_loses_as_a_power_of_the_speed():
    """What the tests below stand on: 1 - e goes as v^0.2."""
    lost = [1.0 - contact(v, 0.15, 0.2, TIMES)[1] for v in SPEEDS]
    powers = np.diff(np.log(lost)) / np.diff(np.log(SPEEDS))
    np.testing.assert_allclose(powers, 0.2, atol=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "power"), tiers.ci([("memory_free", 0.2), ("memory_free", 2.0), ("exact", 1.0)], ("memory_free", 2.0))
)
def test_a_loss_that_goes_otherwise_is_named_before_jitter(law, power):
    problem, plain = calibrated(law, 0.05 if power == 2.0 else 0.15, power)
    found = rank(problem, plain)
    assert plain.law.answer != "consistent" and found is not None and found.named == [LOSS], found
    # Beside the law's own loss, which goes as the first power of the speed or as none.
    exponent = found.found[0].values["loss_exponent"]
    assert (exponent > 0.5) if law == "exact" else (exponent < 1.0) == (power < 1.0)
    jitter = next(f for f in found.found if f.name == "clock jitter")
    assert jitter.explained < 0.25 * found.found[0].explained and not jitter.likely
    # Every other law, and the one that was fitted.
    models = tomllib.loads(found.lines[LOSS])["model"]
    assert len(models) >= 4 and models[0]["name"] == "as fitted" and law not in {m["name"] for m in models}
    # The elastic force: to first order the other loss takes it nearer to the truth.
    agreed = found.agreed
    assert agreed is not None and {"as fitted", LOSS} <= agreed.forces.keys()
    true, every = STIFFNESS * agreed.penetrations**EXPONENT, np.stack(list(agreed.forces.values()))
    off = {name: np.log(force / true) for name, force in agreed.forces.items()}
    assert np.abs(off[LOSS]).max() < 0.1 and np.sum(off[LOSS] ** 2) < np.sum(off["as fitted"] ** 2)
    np.testing.assert_allclose(agreed.spread, np.ptp(every, axis=0) / every.mean(axis=0))
    assert any("elastic force" in heading for heading, _ in sections(found, plain))
    json.dumps(as_json(found, plain))


def behind(numerator: list[float], denominator: list[float], force: np.ndarray) -> np.ndarray:
    return lsim((numerator, denominator), force, TIMES - TIMES[0])[1]


CELL = 2.0 * np.pi * 3e3
SENSORS = {
    "resonance": lambda f: behind([CELL**2], [1.0, 0.1 * CELL, CELL**2], f),
    "bandwidth": lambda f: behind([1.0], [3.0 / CELL, 1.0], f),
    "drift": lambda f: f + 20.0 * f.max() * (TIMES - TIMES[0]),
    "gain bend": lambda f: f * (1.0 + 4e-5 * f),
    "hum": lambda f: f + 20.0 * np.sin(2.0 * np.pi * 700.0 * TIMES),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "speeds"),
    tiers.ci(
        itertools.product(SENSORS, [(0.6, 1.2), SPEEDS]),
        ("bandwidth", SPEEDS),
    ),
)
def test_a_sensor_that_errs_at_several_speeds_is_no_loss(kind, speeds):
    """Each bends the loops of all runs, too, and is named by what it is."""
    found = rank(*calibrated("memory_free", 0.1, 1.0, speeds, change=SENSORS[kind]))
    assert found is not None and found.named == [kind], found.found


@pytest.mark.slow
def test_jitter_stays_jitter():
    """The same runs with the law's own loss, read by a clock that errs by 4 us."""
    problem, plain = calibrated("memory_free", 0.1, 1.0, noise=1e-3, jitter=4e-6)
    found = rank(problem, plain)
    assert found is not None and found.named == ["clock jitter"], found
    assert found.found[0].values["jitter"] == pytest.approx(4e-6, rel=0.2)
    assert found.agreed is None


@pytest.mark.slow
def test_the_laws_own_loss_names_none():
    problem, plain = calibrated("memory_free", 0.1, 1.0)
    found = rank(problem, plain)
    assert plain.law.answer == "consistent" and found is not None and not found.named


@pytest.mark.slow
def test_one_speed_shows_no_dependence_on_it():
    problem, plain = calibrated("memory_free", 0.15, 0.2, speeds=(1.2, 1.2, 1.2))
    found = rank(problem, plain)
    assert found is not None and LOSS not in {f.name for f in found.found}


@pytest.mark.slow
def test_models_of_a_file_agree_on_an_elastic_force():
    """Of two laws, neither of which has the loss: the truth lies between what they say, and a law that misses is left out."""
    pairs = {law: calibrated(law, 0.15, 0.2) for law in COEFFICIENT}
    choice = decided([rival(law, *pair) for law, pair in pairs.items()])
    found = agreement.of_choice(choice)
    assert found is not None and found.by == agreement.FITS and found.forces.keys() == pairs.keys()
    true, every = STIFFNESS * found.penetrations**EXPONENT, np.stack(list(found.forces.values()))
    assert (true > 0.98 * every.min(axis=0)).all() and (true < 1.02 * every.max(axis=0)).all()
    assert found.missed == {law: f.residual["rms_of_peak"] for law, (_, f) in pairs.items()}
    assert agreement.rows(found)[-1][0] == "spread" and len(agreement.rows(found)) == 5
    best = min(pairs, key=lambda law: found.missed[law])
    assert agreement.of_fits({best: pairs[best][1]}) is None


@pytest.mark.slow
def test_the_command_prints_the_force_that_fitted_laws_agree_on(tmp_path, monkeypatch):
    """Of the laws that fit: the true force lies within what is printed, and each law stands beside what it misses."""
    monkeypatch.chdir(tmp_path)
    text = '[scene]\nkind = "impact"\nsmoothing = false\n[parameters]\nstiffness = 1e7\ndamping = 0.1\n'
    Path("s.toml").write_text(text)
    rng, rows, text = np.random.default_rng(1), [], 'scene = "s.toml"\nsensor = "exact"\n'
    for k, speed in enumerate(SPEEDS):
        force, _ = contact(speed, 0.15, 0.2, TIMES)
        values = force + 0.005 * force.max() * rng.standard_normal(TIMES.size)
        rows += [f"{k},{t!r},{v!r}" for t, v in zip((TIMES + 2e-4).tolist(), values.tolist(), strict=True)]
        text += f'[[experiment]]\nfile = "d.csv"\ntime = "time [s]"\nrows = {{ run = {k} }}\nnoise = "estimate"\n'
        text += 'observe = { "contact.normal" = "force [N]" }\n'
        text += f"parameters = {{ mass = {MASS}, approach_speed = {speed} }}\n"
    Path("d.csv").write_text("run,time [s],force [N]\n" + "\n".join(rows))
    text += "[free]\nstiffness = [1e6, 1e9]\nexponent = [1.0, 2.5]\ndamping = [1e-3, 3.0]\ntime_offset = [0.0, 4e-4]\n"
    Path("p.toml").write_text(text)
    command.run(Path("p.toml"), Path("out"), 0, 4, diagnose=True)
    content = json.loads(Path("out/fit.json").read_text())
    assert content["diagnosis"]["named"][0] == LOSS and "none of" in content["diagnosis"]["sentence"]
    found = content["elastic_force"]
    true, every = STIFFNESS * np.array(found["penetrations"]) ** EXPONENT, np.array(list(found["forces"].values()))
    assert found["by"] == "fits" and len(every) >= 2
    assert (true > 0.98 * every.min(axis=0)).all() and (true < 1.02 * every.max(axis=0)).all()
    assert "elastic force that" in Path("out/report.html").read_text()
