"""What certificates and data sheets say of a sensor, in the place of the default priors of its errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bcfj_jax import InputError, scenes, simulate
from calibration import Candidate, Channel, Experiment, Fit, Free, Problem, fit, load, next_experiment
from calibration.instrument import Limit, merged, stated
from calibration.selection.alternatives import candidates
from calibration.selection.next_experiment import said as told
from calibration.uncertainty import quote, systematic
from calibration.uncertainty.sets import QUANTILE, Error, Linear, mixture

SCENE = scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
TIMES = np.linspace(0.0, 1.6e-3, 161)
FORCE = {"contact.normal": "force [N]"}


def of(**said: Any) -> dict[str, Limit]:
    return stated(said, "contact.normal", FORCE, "lab.toml: [instrument]")


def test_what_a_certificate_says_is_a_limit_of_95_percent():
    said = of(
        gain="0.5 % of reading, k = 2", nonlinearity="0.1 % of full scale", full_scale="2 kN", zero="0.2 %",
        resolution="0.5 N", drift="1 N (k=2)", bandwidth="10 kHz", resonance="45 kHz", clock="1 us",
    )  # fmt: skip
    two = QUANTILE / 2.0
    wanted = {
        "gain": (0.005 * two, True), "nonlinearity": (2.0, False), "zero": (0.002, True), "resolution": (0.5, False),
        "drift": (two, False), "bandwidth": (1e4, False), "resonance": (4.5e4, False), "clock": (1e-6, False),
    }  # fmt: skip
    assert set(said) == set(wanted)
    for key, (value, share) in wanted.items():
        assert said[key] == (pytest.approx(value), share), key


def test_a_channel_and_an_experiment_say_more():
    common = {"gain": "1 %", "contact.normal": {"clock": "1 us"}}
    both = merged(common, {"gain": "0.5 %", "contact.normal": {"gain": "0.2 %"}})
    found = stated(both, "contact.normal", FORCE, "here")
    assert found["gain"].value == pytest.approx(0.002) and found["clock"].value == pytest.approx(1e-6)
    other = stated(both, "block.acceleration", {**FORCE, "block.acceleration": ""}, "here")
    assert set(other) == {"gain"} and other["gain"].value == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"gian": "1 %"}, r"lab.toml: \[instrument\].gian: no property 'gian' of an instrument.*gain"),
        ({"gain": "2 N"}, r"gain: .*'2 N'.*share of the reading"),
        ({"gain": "1 % of full scale"}, "gain: .*share of the reading"),
        ({"zero": "0.1 % of full scale"}, r"unknown scale.*full_scale = "),
        ({"bandwidth": "10 us"}, "bandwidth"),
        ({"bandwidth": "0 Hz"}, "bandwidth: .*above 0"),
        ({"clock": "-1 us"}, "clock"),
        ({"zero": "2 kg"}, "zero"),
        ({"gain": "0.5 %, k = 0"}, "gain: a tolerance"),
        ({"contact.tangent": {"gain": "1 %"}}, "'contact.tangent' is not observed"),
    ],
)
def test_mistakes_name_table_key_value_and_remedy(said, message):
    with pytest.raises(InputError, match=message):
        of(**said)


def test_a_stated_error_widens_as_the_closed_form_says():
    """One coordinate that a gain moves by -1: v/sum(j^2) + (u/1.96)^2, and no noise says otherwise."""
    rng = np.random.default_rng(0)
    column = 10.0 * (1.0 + rng.random((80, 1)))
    data = rng.standard_normal(80)
    for most in (0.0, 0.002, 0.01, 0.05):
        errors = [Error("gain, as stated", "of itself", most, column, stated=True)] if most else []
        found = mixture(Linear(data, column, np.eye(1), 1.0, 79), errors)
        (combined,), (a,), (b,) = found.combined()
        noise = float(np.sqrt(found.variance / np.sum(column**2)))
        assert a == pytest.approx(noise, rel=1e-6) and b == pytest.approx(most / QUANTILE, rel=1e-6, abs=1e-12)
        low, high = found.ends()[0]
        assert high - low == pytest.approx(2.0 * QUANTILE * combined, rel=1e-6)
        assert combined == pytest.approx(np.hypot(noise, most / QUANTILE), rel=1e-6)


def problem(**said: Any) -> Problem:
    params = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, **TRUTH}).items()}
    force = simulate(SCENE, params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    values = force + 2e-3 * float(force.max()) * np.random.default_rng(0).standard_normal(force.size)
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    channel = Channel("contact.normal", values, None, instrument=said)
    return Problem(SCENE, params, (Experiment("drop", TIMES, (channel,)),), free, tolerances={"mass": 0.0})


def width(found: Fit) -> float:
    ends = found.reference and found.reference.ci95
    assert ends
    return float(np.log(ends[1] / ends[0]))


@pytest.mark.slow
def test_a_fit_says_what_is_stated_and_what_it_costs():
    """A gain known to 1 and to 0.1 %; the force at the reference depth moves by it as by any gain, and by nothing else."""
    loose, tight = (fit(problem(gain=said), starts=4) for said in ("1 % of reading", "0.1 % of reading"))
    for found, size in ((loose, 0.01), (tight, 0.001)):
        lines = {line.error: line for line in found.systematic.lines}
        line = lines["gain, as stated"]
        assert "gain" not in lines and line.says == "stated" and line.amplitude <= 1.05 * size
        assert line.cost["reference force"] >= 1.0
    assert width(tight) < width(loose)


@pytest.mark.slow
def test_a_smaller_gain_error_narrows_a_fit_as_the_closed_form_says():
    """Generalised least squares with a reading 0 of the gain, by the fit's own Jacobian and the reading itself."""
    for said, share in (("2 %, k = 2", 0.02 * QUANTILE / 2.0), ("0.2 %", 0.002)):
        plain = problem(gain=said)
        found = fit(plain, starts=4)
        at = found.optimum
        error = next(e for e in systematic.every(plain, at) if e.name == "gain, as stated")
        given = quote.quoted(at, [error])
        end, slopes = at.end, quote.moving(at).slopes
        values, weight = at.experiments[0].channels[0].values, float(at.model.data.weights[0, 0, 0])
        signature = end.residuals + weight * values
        design = np.column_stack([end.jacobian, signature])
        precision = design.T @ design
        left = end.residuals - design @ np.linalg.lstsq(design, end.residuals)[0]
        precision[-1, -1] += (QUANTILE / share) ** 2 * float(left @ left) / (left.size - 4)
        count = end.jacobian.shape[1]
        covariance = slopes @ np.linalg.inv(precision)[:count, :count] @ slopes.T * float(left @ left) / (left.size - 4)
        for name, variance in zip(quote.moving(at).names, np.diag(covariance), strict=True):
            assert given.uncertainties[name].combined == pytest.approx(np.sqrt(variance), rel=0.03), (said, name)


FILE = """
scene = "impact"
[[experiment]]
file = "drop.csv"
time = "time [s]"
observe = { "contact.normal" = "force [N]" }
parameters = { mass = "0.1 kg", approach_speed = "1 m/s" }
%s
[free]
stiffness = [1e7, 1e9]
exponent = [1.0, 2.5]
damping = [1e-3, 1.0]
%s
"""


def test_a_file_states_it_for_all_and_for_one(tmp_path):
    own = problem().experiments[0].channels[0].values
    rows = "\n".join(f"{t!r},{f!r}" for t, f in zip(TIMES.tolist(), own.tolist(), strict=True))
    (tmp_path / "drop.csv").write_text("time [s],force [N]\n" + rows + "\n")
    text = FILE % ('instrument = { gain = "0.2 %" }', '[instrument]\ngain = "0.5 %, k = 2"\nbandwidth = "20 kHz"')
    (tmp_path / "lab.toml").write_text(text)
    (channel,) = load(tmp_path / "lab.toml").experiments[0].channels
    assert channel.instrument == {"gain": (pytest.approx(0.002), True), "bandwidth": (2e4, False)}
    (tmp_path / "lab.toml").write_text(text.replace("0.2 %", "0.2 N"))
    with pytest.raises(InputError, match=r"lab.toml: \[\[experiment\]\] 1 instrument.gain: .*0.2 N"):
        load(tmp_path / "lab.toml")


def test_python_states_it_by_texts_too():
    plain = problem(gain="0.5 %, k = 2").experiments[0].channels[0]
    assert plain.instrument["gain"].value == pytest.approx(0.0025 * QUANTILE)
    assert replace(plain, jitter=1e-6).instrument == plain.instrument


@pytest.mark.slow
def test_what_would_narrow_it_is_what_does():
    """Three runs at another speed are made and fitted, thrice: as wide as was foretold. A better gain changes little."""
    plain = problem()
    found = fit(plain, starts=4)
    clock, sigma = 1.2 * TIMES, 2e-3 * float(np.max(plain.experiments[0].channels[0].values))
    planned = Candidate("three more runs", clock, {"contact.normal": sigma}, {"approach_speed": 0.4}, runs=3)
    better = Candidate("a better gain", np.zeros(0), {}, instrument={"gain": "0.2 %"})
    gains = {gain.name: gain for gain in next_experiment(plain, found, [planned, better])}
    force = simulate(SCENE, plain.params | {"approach_speed": 0.4}, clock, accuracy=1e-8).force["contact"][:, 0]
    # What is foretold is the median over records: one alone may show more or less of what acts.
    halves: dict[str, list[float]] = {name: [] for name in gains["three more runs"].quoted}
    for seed in (5, 6, 7):
        rng, more = np.random.default_rng(seed), []
        for k in range(3):
            channel = Channel("contact.normal", force + sigma * rng.standard_normal(force.size), None)
            more.append(Experiment(f"more {k}", clock, (channel,), fixed={"approach_speed": 0.4}))
        after = fit(replace(plain, experiments=(*plain.experiments, *more)), starts=4)
        for name, found_halves in halves.items():
            low, high = after.every[name].ci95 or (np.nan, np.nan)
            found_halves.append(0.5 * float(np.log(high / low)))
    for name, half in gains["three more runs"].quoted.items():
        assert np.median(halves[name]) == pytest.approx(half.then, rel=0.3), name
    assert gains["three more runs"].quoted["stiffness"].then < 0.8 * gains["three more runs"].quoted["stiffness"].now
    assert all(half.then == pytest.approx(half.now, rel=0.1) for half in gains["a better gain"].quoted.values())
    sentences = dict(text.split(": ", 1) for text in told(list(gains.values())))
    assert sentences["a better gain"] == "no change" and " % to +- " in sentences["three more runs"]


def test_a_file_asks_what_would_narrow_it(tmp_path):
    plain = problem()
    text = '[[candidate]]\nname = "a"\ninstrument = { gain = "0.2 %" }\n'
    (tmp_path / "ask.toml").write_text(text)
    (one,) = candidates(tmp_path / "ask.toml", plain)
    assert not one.made and one.instrument == {"gain": "0.2 %"}
    for wrong, message in (
        ('name = "a"', "observe: the key 'observe' is missing"),
        ('name = "a"\nobserve = { "contact.normal" = "1 %" }\nsamples = 9', "end: the key 'end' is missing"),
        ('name = "a"\ninstrument = { gian = "1 %" }', "instrument.gian"),
    ):
        (tmp_path / "ask.toml").write_text(f"[[candidate]]\n{wrong}\n")
        with pytest.raises(InputError, match=message):
            candidates(tmp_path / "ask.toml", plain)


@pytest.mark.slow
def test_a_record_with_a_clock_of_its_own_is_extended_too():
    """Its coordinate has no number in a fit of one record; the new runs have clocks of their own."""
    plain = problem()
    plain = replace(plain, free=(*plain.free, Free("time_offset", -2e-5, 2e-5)))
    planned = Candidate("slower", 1.2 * TIMES, {"contact.normal": 0.005}, {"approach_speed": 0.4}, share=True, runs=2)
    (gain,) = next_experiment(plain, fit(plain, starts=4), [planned])
    assert {"stiffness", "exponent", "damping", "reference force"} == set(gain.quoted)
    assert gain.quoted["stiffness"].then < 0.9 * gain.quoted["stiffness"].now
