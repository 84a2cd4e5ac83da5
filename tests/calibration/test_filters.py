"""Low-passes between sensor and record, against SciPy; and records that do not tell one from the law."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from scipy import signal
from scipy.integrate import solve_ivp

from bcfj_jax import InputError
from calibration import Filter, fit, load
from calibration.forward.model import build, predictions
from calibration.forward.observables import Passed, filtered

pytestmark = pytest.mark.filterwarnings("error")
KINDS = [(kind, order) for kind in ("butterworth", "bessel") for order in range(1, 9)]
TRUTH = {"stiffness": 4e6, "exponent": 1.6, "damping": 0.15}
MASS, SPEED, COUNT, STEP = 1.1, 0.7, 320, 1e-4
FILE = """scene = "impact"
{filter}
[[experiment]]
file = "run.csv"
time = "time [s]"
observe = {{ "contact.normal" = "force [N]" }}
align = "onset"
noise = "estimate"
parameters = {{ mass = "1.1 kg", approach_speed = "0.7 m/s" }}
[free]
stiffness = [1e5, 1e9]
exponent = [1.0, 2.5]
damping = [0.01, 3.0]
"""


def designed(kind: str, order: int, cutoff: float, **how):
    more = {"norm": "mag"} if kind == "bessel" else {}
    return (signal.bessel if kind == "bessel" else signal.butter)(order, cutoff, **more, **how)


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_partial_fractions_are_scipys_filter(kind, order):
    w = np.array([0.01, 0.3, 1.0, 2.0, 7.0])
    rates, weights = Filter(kind, order).terms
    # y = Re c u of a real input: half of each term and of its conjugate.
    ours = sum(
        0.5 * c * r / (1j * w + r) + 0.5 * np.conj(c * r) / (1j * w + np.conj(r))
        for r, c in zip(rates, weights, strict=True)
    )
    expected = signal.freqs_zpk(*designed(kind, order, 1.0, analog=True, output="zpk"), w)[1]
    np.testing.assert_allclose(ours, expected, atol=1e-12)
    delay = -np.angle(signal.freqs_zpk(*designed(kind, order, 1.0, analog=True, output="zpk"), [1e-4])[1][0]) / 1e-4
    assert Filter(kind, order).delay * 2.0 * np.pi == pytest.approx(delay, rel=1e-4)
    assert Filter(kind, order, True).delay == 0.0


def output(times: np.ndarray, values: np.ndarray, cutoff: float, one: Filter) -> np.ndarray:
    passed = Passed(*one.terms, np.array(one.zero_phase))
    read = jax.jit(filtered)(jnp.asarray(times), jnp.asarray(values)[:, None], jnp.asarray(cutoff), passed)
    return np.asarray(read)[:, 0]


@pytest.mark.parametrize(("kind", "order"), [("butterworth", 1), ("butterworth", 4), ("bessel", 7)])
def test_a_causal_filter_is_scipys_at_uneven_steps(kind, order):
    rng = np.random.default_rng(order)
    times, values = np.linspace(0.0, 0.05, 501), np.cumsum(rng.standard_normal(501))
    values -= values[0]
    system = designed(kind, order, 2.0 * np.pi * 90.0, analog=True, output="zpk")
    expected = signal.lsim(signal.ZerosPolesGain(*system), values, times)[1]
    np.testing.assert_allclose(output(times, values, 90.0, Filter(kind, order)), expected, atol=1e-6)
    # Every second step parted in three says nothing new of a signal that is linear between samples.
    more = np.unique(np.concatenate([times, times[:-1:2] + 0.3e-4, times[:-1:2] + 0.8e-4]))
    finer = output(more, np.interp(more, times, values), 90.0, Filter(kind, order))
    np.testing.assert_allclose(finer[np.searchsorted(more, times)], expected, atol=1e-6)


def test_run_forwards_and_backwards_it_shifts_nothing_and_squares_the_gain():
    times = np.linspace(-0.1, 0.1, 8001)
    pulse = np.exp(-0.5 * (times / 4e-3) ** 2)
    one = Filter("bessel", 3, True)
    ours = output(times, pulse, 60.0, one)
    np.testing.assert_allclose(ours, ours[::-1], atol=1e-9)
    sections = designed("bessel", 3, 60.0, fs=1.0 / (times[1] - times[0]), output="sos")
    np.testing.assert_allclose(ours, signal.sosfiltfilt(sections, pulse), atol=1e-3)


def force(times: np.ndarray) -> np.ndarray:
    """Force (T,) of a contact from time 0 on."""

    def law(d: float, v: float) -> float:
        return TRUTH["stiffness"] * max(d, 0.0) ** TRUTH["exponent"] * (1.0 + TRUTH["damping"] * v)

    run = solve_ivp(
        lambda t, y: [y[1], -law(y[0], y[1]) / MASS], (0.0, 0.04), [0.0, SPEED], "DOP853",
        rtol=1e-10, atol=1e-13, max_step=2e-4, dense_output=True,
    )  # fmt: skip
    return np.array([law(*state) for state in run.sol(np.clip(times, 0.0, 0.04)).T]) * (times > 0.0)


def written(folder: Path, line: str = "", passed: Filter | None = None, cutoff: float = 0.0, noise: float = 2.0):
    """A problem whose record is behind a filter that SciPy makes at a twentieth of its step."""
    fine = STEP / 20.0 * np.arange(20 * COUNT) - 9.13e-3
    read = force(fine)
    if passed is not None:
        sections = designed(passed.kind, passed.order, cutoff, fs=20.0 / STEP, output="sos")
        read = (signal.sosfiltfilt if passed.zero_phase else signal.sosfilt)(sections, read)
    rows = np.stack([fine, read], axis=1)[::20]
    rows[:, 1] += noise * np.random.default_rng(5).standard_normal(COUNT)
    np.savetxt(folder / "run.csv", rows, delimiter=",", header="time [s],force [N]", comments="")
    (folder / "run.toml").write_text(FILE.format(filter=line))
    return load(folder / "run.toml")


def held(found) -> bool:
    ends = [found.parameters[name].ci95 for name in TRUTH]
    true = TRUTH["stiffness"] * found.reference.penetration ** TRUTH["exponent"]
    inside = [low <= x <= high for (low, high), x in zip(ends, TRUTH.values(), strict=True)]
    return all(inside) and found.reference.ci95[0] <= true <= found.reference.ci95[1]


@pytest.mark.slow
def test_a_filter_far_above_the_contact_is_none(tmp_path):
    problem = written(tmp_path, 'filter = { cutoff = "1 GHz" }')
    plain = replace(problem, filter="none", experiments=tuple(replace(e, fixed={
        k: v for k, v in e.fixed.items() if k != "cutoff"}) for e in problem.experiments))  # fmt: skip
    at = [build(p, p.experiments).at_depth(np.log(1e-3)) for p in (problem, plain)]
    point = np.full(len(at[0].coordinates), 0.45)
    with_it, without = (predictions(model, point) for model in at)
    np.testing.assert_allclose(with_it, without, atol=1e-5 * np.abs(without).max())


@pytest.mark.slow
def test_a_record_that_no_filter_touched_stays_identified_with_intervals_that_allow_for_one(tmp_path):
    problem = written(tmp_path)
    assert problem.filter == "unknown"
    found, sure = fit(problem), fit(replace(problem, filter="none"))
    assert found.verdict == sure.verdict == "identified" and held(found)
    for name in TRUTH:
        wide, narrow = found.parameters[name].ci95, sure.parameters[name].ci95
        assert wide[0] <= narrow[0] and wide[1] >= narrow[1]
        assert "filter" in found.parameters[name].intervals and "filter" not in sure.parameters[name].intervals


PASSED = {
    "back and forth": Filter("butterworth", 3, True), "bessel": Filter("bessel", 2), "butterworth": Filter("butterworth", 6),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("passed", tiers.ci(PASSED, "butterworth"))
@pytest.mark.parametrize("share", tiers.ci([1.5, 4.0], 4.0))
def test_a_filter_that_nobody_stated_is_never_taken_for_the_law(tmp_path, passed, share):
    duration = float(np.ptp(np.flatnonzero(force(1e-5 * np.arange(4000)))) * 1e-5)
    found = fit(written(tmp_path, "", PASSED[passed], share / (2.0 * duration)))
    if found.verdict in ("identified", "adequate"):
        assert held(found)
    else:
        assert all(p.ci95 is None for p in found.parameters.values()) or found.verdict == "misfit"
    if found.verdict == "not_identified" and found.law.answer != "inadequate":
        assert any("low-pass of order" in reason and "state the low-pass" in reason for reason in found.reasons)


@pytest.mark.slow
@pytest.mark.parametrize("known", tiers.ci([True, False], True))
def test_a_stated_filter_is_part_of_the_model_with_its_cutoff_given_or_free(tmp_path, known):
    cutoff = ', cutoff = "300 Hz"' if known else ""
    line = f'filter = {{ kind = "butterworth", order = 3, zero_phase = true{cutoff} }}'
    problem = written(tmp_path, line, Filter("butterworth", 3, True), 300.0, 0.2)
    assert ("cutoff" in {f.name for f in problem.free}) is not known
    found = fit(problem)
    assert found.verdict in ("identified", "adequate") and held(found)
    if not known:
        low, high = found.parameters["cutoff"].ci95
        assert low < 300.0 < high < 1.3 * low


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('filter = { kind = "chebyshev" }', "butterworth"),
        ("filter = { order = 9 }", "order"),
        ('filter = "some"', "filter"),
    ],
)
def test_filters_that_there_are_not_are_refused(tmp_path, line, said):
    with pytest.raises(InputError, match=said):
        written(tmp_path, line)


def test_a_cutoff_needs_a_filter(tmp_path):
    problem = written(tmp_path, 'filter = { cutoff = "1 kHz" }')
    with pytest.raises(InputError, match="no filter is given"):
        replace(problem, filter="none")
    with pytest.raises(InputError, match="cut-off is missing"):
        replace(written(tmp_path), filter=Filter("bessel", 4))
    with pytest.raises(InputError, match="order"):
        replace(problem, filter=Filter("bessel", 12))
