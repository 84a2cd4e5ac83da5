"""Calibration against measured impacts on rubber pads: runs fitted, run 5 predicted, laws compared.

The problems are the examples' own, which fit runs 1 to 4. The measured tables lie beside the project.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration import Fit, Problem, fit, load
from calibration.diagnostics.misfit_location import misses
from calibration.selection.alternatives import models
from calibration.selection.choice import Choice, choose

EXAMPLES = Path(__file__).parents[2] / "examples"
DATA = EXAMPLES.parent.parent / "shared" / "data"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("error"),
    pytest.mark.skipif(not DATA.exists(), reason=f"the measured data are not here: no {DATA}"),
]


def ordered(found: Fit) -> bool:
    """Whether residuals in contact are of one sign too long, by shuffling: nothing of the verdict's own tests."""
    rng = np.random.default_rng(0)
    signs = []
    for record in found.records:
        if record.held_out:
            continue
        (data,), (predicted,) = record.data.values(), record.prediction.values()
        inside = predicted - predicted.min() > 0.02 * np.ptp(predicted)
        residual = (predicted - data)[inside]
        signs.append(residual > np.median(residual))
    changes = lambda parts: sum(np.count_nonzero(np.diff(p)) for p in parts)  # noqa: E731
    shuffled = [changes([rng.permutation(p) for p in signs]) for _ in range(4000)]
    return bool(np.mean(np.array(shuffled) <= changes(signs)) < 5e-4)


def measured_spikes(found: Fit) -> dict[str, float]:
    """Time of each record's largest reading: that of its spike, for no smooth pulse is higher."""
    return {r.name: float(r.times[np.nanargmax(next(iter(r.data.values())))]) for r in found.records}


def stated(pad: str) -> list[tuple[str, Problem]]:
    """The models of an example, with two of its four fitted runs, for time."""
    path = EXAMPLES / f"pad_{pad}.toml"
    whole = load(path)
    kept = tuple(e for e in whole.experiments if e.name in ("run 2", "run 3", "run 5"))
    return [(a.name, a.problem) for a in models(path, replace(whole, experiments=kept))]


@pytest.fixture(scope="module")
def thin() -> Choice:
    return choose(stated("4mm"), starts=12)


def test_thick_pad_is_predicted_and_its_law_is_adequate():
    found = fit(load(EXAMPLES / "pad_40mm.toml"), starts=6)
    (errors,) = found.held_out.values()
    # The peaks of the five runs themselves differ by 4 %.
    assert errors["max_error_of_peak"] <= 0.06
    assert ordered(found) and found.verdict == "adequate", found.reasons
    # The intervals allow for the shape that is missed.
    shared = {name: found.parameters[name] for name in ("stiffness", "exponent", "damping")}
    assert {p.headline for p in shared.values()} == {"errors"}
    assert shared["exponent"].ci95 is not None and shared["stiffness"].ci95 is not None
    for p in shared.values():
        (low, high), (lower, upper) = p.intervals["noise"], p.intervals["discrepancy"]
        assert lower <= low and high <= upper and upper - lower > 1.5 * (high - low)


def test_thin_pad_is_a_misfit_of_one_law_named_by_its_time(thin):
    one = next(r.fit for r in thin.rivals if r.name == "power law")
    assert one.verdict == "misfit", one.reasons
    assert all(p.headline != "noise" for p in one.parameters.values())
    spikes = measured_spikes(one)
    named = [m for m in misses(one.records) if m.brief and m.record != "run 5"]
    assert {m.record for m in named} == {"run 2", "run 3"}
    for miss in named:
        assert miss.time == spikes[miss.record] and miss.error > 0
    assert any("bottoms out" in r and f"at {named[0].time:.4g} s" in r and named[0].record in r for r in one.reasons)


def test_thin_pad_is_a_misfit_whatever_the_noise_is_said_to_be():
    whole = stated("4mm")[0][1]
    loud = tuple(
        replace(e, channels=tuple(replace(c, sigma=0.1 * float(np.nanmax(np.abs(c.values)))) for c in e.channels))
        for e in whole.experiments
    )
    found = fit(replace(whole, experiments=loud), starts=4)
    assert found.verdict == "misfit", found.reasons
    assert all(p.headline != "noise" for p in found.parameters.values())


def test_a_stop_is_chosen_for_the_thin_pad(thin):
    by_name = {r.name: r for r in thin.rivals}
    one, two, own = (by_name[name] for name in ("power law", "two stages", "damped stop"))
    assert thin.chosen == "damped stop" and thin.rivals[0] is own
    for stop in (two, own):
        assert stop.held_out < 0.5 * one.held_out
        # Where it bottoms out is inside the data: just short of what a soft pad alone would be pressed, v sqrt(m/K).
        assert 0.05 < stop.fit.values["bottoming_penetration"] < 0.08
    assert one.likelihood.bic - 10.0 > two.likelihood.bic > own.likelihood.bic + 10.0
    assert own.fit.values["bottoming_damping"] > 3.0 * own.fit.values["damping"]
