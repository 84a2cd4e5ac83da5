"""What would explain a miss: planted by SciPy or by hand, it is named; a clean record names nothing; lines can be used."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from pages import check
from scipy.signal import lsim

from bcfj_jax import InputError, scenes, simulate
from calibration import Channel, Experiment, Fit, Free, Problem, command, fit, load
from calibration.diagnostics import catalogue, signatures, suspects
from calibration.diagnostics.residual_tests import Series
from calibration.forward.observables import low_pass, resonant
from calibration.impacts import stated
from calibration.report.diagnosis import as_json, sections, sentence
from calibration.selection.diagnosis import diagnose, rank
from calibration.selection.remedies import altered, joined

SCENE = scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
TIMES = np.linspace(0.0, 1.3e-3, 160)
PARAMS = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, **TRUTH}).items()}
FREE = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))


@pytest.fixture(scope="module")
def force() -> np.ndarray:
    return np.asarray(simulate(SCENE, PARAMS, TIMES, accuracy=1e-8).force["contact"][:, 0])


def ringing(force: np.ndarray) -> np.ndarray:
    w = 2.0 * np.pi * 1e4
    return lsim(([w**2], [1.0, 0.1 * w, w**2]), force, TIMES)[1]


def hum(force: np.ndarray) -> np.ndarray:
    return force + 0.03 * force.max() * np.sin(2.0 * np.pi * 2.2e3 * TIMES + 1.0)


PLANTED = {
    "hum": hum,
    "resonance": ringing,
    "gain bend": lambda f: f * (1.0 + 0.03 * f / f.max()),
    "drift": lambda f: f + 20.0 * f.max() * TIMES,
}


def fitted(force: np.ndarray, change=lambda f: f, seed: int = 0) -> tuple[Problem, Fit]:
    values = change(force) + 5e-3 * force.max() * np.random.default_rng(seed).standard_normal(force.size)
    one = Experiment("drop", TIMES, (Channel("contact.normal", values, None),))
    problem = Problem(SCENE, PARAMS, (one,), FREE)
    return problem, fit(problem, starts=4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", tiers.ci(["hum", "resonance"], "resonance"))
def test_what_was_planted_is_named(force, kind):
    problem, plain = fitted(force, PLANTED[kind])
    found = rank(problem, plain)
    assert found is not None and found.named == [kind], found
    values, lines = found.found[0].values, tomllib.loads(found.lines[kind])["free"]
    frequency, true = ("hum_frequency", 2.2e3) if kind == "hum" else ("resonance", 1e4)
    assert values[frequency] == pytest.approx(true, rel=0.05)
    assert lines[frequency]["lower"] < true < lines[frequency]["upper"]
    assert "--diagnose" in sentence(found)
    shown = sections(found, plain)
    assert [f"# {kind}"] in [rows[0] for _, rows in shown]


def test_a_clean_record_names_none(force):
    for seed in (1, 2):
        found = rank(*fitted(force, seed=seed))
        assert found is not None and not found.named and "no suspect" in sentence(found)


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLANTED)
def test_a_fit_with_the_lines_confirms(force, kind):
    """And its stiffness holds the truth, which the plain fit's noise interval does not."""
    problem, plain = fitted(force, PLANTED[kind])
    found = diagnose(problem, plain)
    assert found is not None and found.named[0] == kind
    best = found.trials[0]
    assert best.names == (kind,) and best.confirmed and best.fit is not None and best.fit.law.answer == "consistent"
    low, high = best.fit.parameters["exponent"].intervals["noise"]
    assert low < 1.5 + 0.01 and high > 1.5 - 0.01
    json.dumps(as_json(found, plain))


@pytest.mark.slow
def test_two_at_once_are_fitted_together(force):
    problem, plain = fitted(force, lambda f: PLANTED["drift"](hum(f)))
    found = diagnose(problem, plain)
    assert found is not None
    pair = [t for t in found.trials if len(t.names) == 2]
    assert pair and set(pair[0].names) == {"hum", "drift"} and pair[0].confirmed
    assert pair[0].fit is not None and pair[0].fit.law.answer == "consistent"


@pytest.mark.slow
def test_a_stop_is_named_and_its_model_fits(force):
    params = {**PARAMS, "bottoming_stiffness": 4e5, "bottoming_penetration": 2e-4, "bottoming_width": 1e-6}
    hard = simulate(scenes.impact(elastic="two_stage", smoothing=False), params, TIMES, accuracy=1e-8)
    problem, plain = fitted(np.asarray(hard.force["contact"][:, 0]))
    found = diagnose(problem, plain)
    assert found is not None and found.named[0] == "stop"
    stop = found.trials[0].fit
    assert found.trials[0].confirmed and stop is not None and stop.law.answer == "consistent"
    assert stop.values["bottoming_penetration"] == pytest.approx(2e-4, rel=0.1)
    json.dumps(as_json(found, plain))


def series(values: np.ndarray, read: np.ndarray, sigma: float) -> Series:
    size = values.size
    return Series(
        np.arange(size), read > 0, 0.01, 1e-3, clock=TIMES[:size], values=values, weights=np.full(size, 1.0 / sigma)
    )


def view(values: np.ndarray, read: np.ndarray, sigma: float) -> signatures.Scene:
    return signatures.Scene(values.size, [series(values, read, sigma)], [0], [read], [None], 9e-4, float(read.max()))


@pytest.mark.full
def test_a_sensors_signature_is_what_the_model_would_read(force):
    scene = view(force, force, 2.0)
    x, t = jnp.asarray(force)[:, None], jnp.asarray(TIMES)
    for seen, read in (
        (catalogue.first_order(scene, 3e3), jax.jit(low_pass)(t, x, 3e3)),
        (catalogue.second_order(scene, 9e3, 0.05), jax.jit(resonant)(t, x, 9e3, 0.05)),
    ):
        np.testing.assert_allclose(2.0 * seen, np.asarray(read) - force[:, None], atol=2e-3 * force.max())


def test_noises_are_seen_in_residuals_and_readings(force):
    rng, sigma = np.random.default_rng(0), 2.0
    jacobian = np.stack([force, TIMES * 1e3], axis=1)
    slope = np.gradient(force, TIMES)
    noise = sigma * rng.standard_normal(force.size)
    jitter = slope * 5e-6 * rng.standard_normal(force.size)
    for name, values in (
        ("clock jitter", force + noise + jitter),
        ("quantisation", 12.0 * np.round((force + noise) / 12.0)),
        ("saturation", np.minimum(force + noise, 0.95 * force.max())),
    ):
        found = suspects.ranked(view(values, force, sigma), (force - values) / sigma, jacobian)
        assert found[0].name == name and found[0].named
    values = force + noise + jitter
    found = suspects.ranked(view(values, force, sigma), (force - values) / sigma, jacobian)
    assert found[0].values["jitter"] == pytest.approx(5e-6, rel=0.3)
    assert found[0].values["sigma"] == pytest.approx(sigma, rel=0.3)


def test_correlated_noise_comes_last(force):
    """It is named where no shape explains the residuals."""
    rng, noise = np.random.default_rng(3), np.zeros(force.size)
    for k in range(1, force.size):
        noise[k] = 0.5 * noise[k - 1] + rng.standard_normal()
    found = suspects.ranked(view(force + noise, force, 1.15), noise / 1.15, np.stack([force], axis=1))
    assert [f.name for f in found if f.likely] == ["correlated noise"] and found[0].named
    assert found[0].values["correlation"] == pytest.approx(np.diff(TIMES)[0] / np.log(2.0), rel=0.5)


def test_steps_of_readings():
    assert suspects.lattice(0.5 * np.arange(40.0).repeat(3)) == pytest.approx(0.5)
    assert suspects.lattice(np.random.default_rng(0).standard_normal(100)) == 0.0
    assert suspects.lattice(np.arange(100.0)) == 0.0


def test_noise_of_a_clock_and_of_steps_is_read():
    values = np.linspace(0.0, 100.0, 11)
    sigma, relative, jitter = stated.noise("3 N + 2 us of clock + 12 N of steps", "contact.normal", values, "noise")
    assert (sigma, relative, jitter) == (pytest.approx(np.hypot(3.0, 12.0 / np.sqrt(12.0))), 0.0, pytest.approx(2e-6))
    channel = Channel("contact.normal", values, sigma, jitter=jitter)
    slow = channel.deviation(values, np.arange(11.0) * 1e-6)
    np.testing.assert_allclose(slow, np.hypot(sigma, 2e-6 * 10.0 / 1e-6))
    with pytest.raises(InputError, match="is zero where the reading does not change"):
        stated.noise("2 us of clock", "contact.normal", values, "noise")


def test_lines_of_two_are_one_toml():
    text = joined("[free.drift]\nlower = 0.0\nupper = 1.0\n", 'noise = "1 N + 2 us of clock"\n')
    assert list(tomllib.loads(text)) == ["noise", "free"]
    assert joined("[[model]]\na = 1\n", "[[model]]\na = 2\n") == "" == joined("a = 1\n", "")


@pytest.mark.slow
def test_the_command_says_what_would_explain(force, tmp_path, monkeypatch):
    """And the lines that it prints, put in the file, make the law consistent."""
    monkeypatch.chdir(tmp_path)
    problem, _ = fitted(force, hum)
    values = problem.experiments[0].channels[0].values
    rows = "".join(f"{t!r},{v!r}\n" for t, v in zip(TIMES.tolist(), values.tolist(), strict=True))
    Path("d.csv").write_text("time [s],force [N]\n" + rows)
    Path("s.toml").write_text(
        '[scene]\nkind = "impact"\nsmoothing = false\n[parameters]\nmass = 0.1\napproach_speed = 1.0\n'
        "stiffness = 1e8\ndamping = 0.1\n"
    )
    text = 'scene = "s.toml"\nsensor = "exact"\n[[experiment]]\nfile = "d.csv"\ntime = "time [s]"\n'
    text += 'observe = { "contact.normal" = "force [N]" }\n'
    text += "".join(f"[free.{f.name}]\nlower = {f.lower}\nupper = {f.upper}\n" for f in FREE)
    Path("p.toml").write_text(text)
    code = command.run(Path("p.toml"), Path("out"), 0, 4, diagnose=True)
    assert code == command.DONE, json.loads(Path("out/fit.json").read_text())["reasons"]
    found = json.loads(Path("out/fit.json").read_text())["diagnosis"]
    assert found["named"] == ["hum"] and found["fits"][0]["confirmed"]
    check(Path("out/report.html"))
    assert "What would explain the miss" in Path("out/report.html").read_text()
    Path("q.toml").write_text(text + found["suspects"][0]["lines"])
    assert fit(load("q.toml"), starts=4).law.answer == "consistent"
    assert altered(load("p.toml"), found["suspects"][0]["lines"], fitted(force)[1]).free[-1].name == "hum_cosine"
