"""Coefficients of mechanisms from records that an independent SciPy code makes: are they found, and with honest intervals?

    python -m benchmarks.calibration.mechanisms [CASE ...] [--seeds 100] [--workers 2]
writes results/identification.json and docs/fits_measured.md. Cases: friction, clearance; both by default.

| case | free | record, noise of 1 % of each history's peak |
|---|---|---|
| friction | friction_static, friction_dynamic | tangential and normal force of a sphere that strikes a plane at 5 to 60 degrees |
| clearance | clearance_journal, stiffness | slider acceleration of a slider-crank at 5000 r/min: the first three contacts |

Below 32 degrees the sphere ends rolling, above it slides all the time. The slider-crank's record ends before its fourth
contact. A seed is fresh noise and a whole fit with starts of its own; what is finished is kept in build/coverage.
Beside each fit stands the estimate that is linear in the same noise (``linear``): it tells the estimator's share from chance's.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

import benchmarks.common as harness
from bcfj_jax import scenes
from benchmarks.calibration.coverage import Case, at_truth, finished, fit_missing, noisy, summary
from benchmarks.common import known, options, publish, save
from benchmarks.references import oblique_impact, slider_crank
from calibration import Experiment, Free, Problem

NOISE = 0.01
ANGLES = tuple(range(5, 65, 5))
FRICTION = {"friction_static": 0.15, "friction_dynamic": 0.092}
# From which slip on friction is sliding friction [m/s]: known.
FRICTION_SPEED = 0.1
CLEARANCE = {"clearance_journal": 0.5e-3, "stiffness": 6.61e10}
# Of the impacts, whose default takes five times as long; it moves estimates by a hundredth of their deviation.
ACCURACY = 1e-4
# Runs that the Cramer-Rao bound is taken from are as exact as may be, whatever the fits make do with.
FINE = 1e-6
# Seeds whose noise is drawn, though not fitted, for what chance leaves of the bound.
DRAWS = 3000


@functools.cache
def rebounds() -> tuple[tuple[int, np.ndarray, np.ndarray, np.ndarray], ...]:
    """Angle [deg], times [s], tangential and normal force [N] of each impact."""
    found = []
    for angle in ANGLES:
        impact = oblique_impact.Impact(
            angle=math.radians(angle), friction="brown_mcphee", friction_speed=FRICTION_SPEED, **FRICTION
        )
        times = np.linspace(0.0, 1.15 * oblique_impact.rebound(impact).duration, 61)
        course = oblique_impact.history(impact, times)
        # That code's T is along the motion, our force against it.
        found.append((angle, times, -course.tangential, course.normal))
    return tuple(found)


def friction(noise: float, seed: int) -> Problem:
    """Twelve impacts, each of a known angle."""
    scene, known = scenes.oblique_impact(smoothing=False), oblique_impact.Impact()
    given: dict[str, Any] = {"stiffness": known.stiffness, "mass": known.mass, "friction_speed": FRICTION_SPEED}
    params = {name: float(value) for name, value in scene.parameters(**given).items()}
    experiments = []
    for angle, times, tangential, normal in rebounds():
        names = ["contact.tangential", "contact.normal"]
        channels = noisy(names, [tangential, normal], noise, 100 * seed + angle)
        fixed = {"impact_angle": math.radians(angle)}
        experiments.append(Experiment(f"{angle} deg", times, channels, fixed=fixed))
    free = (Free("friction_static", 0.02, 0.6), Free("friction_dynamic", 0.02, 0.6))
    return Problem(scene, params, tuple(experiments), free, accuracy=ACCURACY)


@functools.cache
def strokes() -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and acceleration of the slider [m/s^2]."""
    scene, times = scenes.slider_crank(), np.linspace(0.0, 7.6e-4, 381)
    radius, damping = (float(scene.parameters()[name]) for name in ("radius", "damping"))
    machine = slider_crank.SliderCrank(
        bearing_radius=radius + CLEARANCE["clearance_journal"], journal_radius=radius, stiffness=CLEARANCE["stiffness"],
        damping=damping,
    )  # fmt: skip
    return times, slider_crank.readings(machine, slider_crank.simulate(machine, times)).slider_acceleration


def clearance(noise: float, seed: int) -> Problem:
    """A twelfth of a turn from line to line."""
    scene, (times, acceleration) = scenes.slider_crank(), strokes()
    params = {name: float(value) for name, value in scene.parameters().items()}
    channels = noisy(["slider.acceleration.x"], [acceleration], noise, seed)
    free = (Free("clearance_journal", 1e-4, 1e-3), Free("stiffness", 1e10, 5e11))
    return Problem(scene, params, (Experiment("start", times, channels),), free)


CASES = {"friction": Case(friction, FRICTION, 12, 100), "clearance": Case(clearance, CLEARANCE, 12, 100)}


def linear(case: Case, seeds: int) -> np.ndarray:
    """Errors (S, P), as shares, of the estimate that is linear in the noise: the very noise of each seed, no fit.

    e = (J^T J)^-1 J^T noise with J at the truth. Over all noise its variance is the Cramer-Rao bound; over some seeds it
    is what their draws leave to any efficient estimator.
    """
    residuals, jacobian = at_truth(case, NOISE, FINE)
    # A problem must state some noise.
    clean = [c.values for e in case.problem(1e-12, 0).experiments for c in e.channels]
    draws = []
    for seed in range(seeds):
        channels = [c for e in case.problem(NOISE, seed).experiments for c in e.channels]
        draws.append(np.concatenate([(c.values - x) / c.sigma for c, x in zip(channels, clean, strict=True)]))
    # Model less record: the rows are in one order, and SciPy's records are our own runs but for the noise.
    assert np.allclose(residuals, -draws[0], atol=0.01)
    return np.array(draws) @ np.linalg.pinv(jacobian).T


def beside_linear(name: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """``summary``, and how each seed's fit compares with the linear estimate from the same noise."""
    case = CASES[name]
    found, errors = summary(name, case, NOISE, rows, FINE), linear(case, DRAWS)
    mine = errors[[row["seed"] for row in rows]]
    for i, (parameter, told) in enumerate(found["parameters"].items()):
        share = np.array([row["parameters"][parameter][0] for row in rows]) / case.truth[parameter]
        fitted = np.log(share) if case.problem(NOISE, 0).free[i].as_share else share - 1.0
        least = told["cramer_rao"]
        told["linear_variance_over_bound"] = float(np.var(mine[:, i])) / least**2
        told["linear_variance_over_bound_of_draws"] = float(np.var(errors[:, i])) / least**2
        told["linear_coverage"] = float(np.mean(np.abs(mine[:, i]) < norm.isf(0.025) * least))
        told["linear_coverage_of_draws"] = float(np.mean(np.abs(errors[:, i]) < norm.isf(0.025) * least))
        told["from_linear_over_bound"] = float(np.sqrt(np.mean((fitted - mine[:, i]) ** 2))) / least
    limits = np.array(chi2.interval(0.95, DRAWS)) / DRAWS
    return found | {"draws": DRAWS, "draws_ratio_expected": limits.tolist()}


def table(cases: list[dict[str, Any]]) -> str:
    """All parameters of both cases as Markdown."""

    def coverage(p: dict[str, Any]) -> str:
        ends = p["coverage_ci95"]
        return f"{p['coverage']:.0%} of {p['printed']} ({ends[0]:.0%} to {ends[1]:.0%})" if ends else "none printed"

    columns = {
        "case": "{case}", "parameter": "{name}",
        "identified": lambda p: f"{p['verdicts'].get('identified', 0)} of {p['replicates']}", "coverage (its 95 %)": coverage,
        "bias / its standard error": "{bias_over_standard_error:+.1f}", "Cramer-Rao deviation": "{cramer_rao:.2%}",
        "variance / Cramer-Rao (95 % of chance)":
            "{variance_over_bound:.2f} ({ratio_expected[0]:.2f} to {ratio_expected[1]:.2f})",
        "linear, same noise: coverage, variance": "{linear_coverage:.0%}, {linear_variance_over_bound:.2f}",
        f"linear, {DRAWS} draws: coverage, variance (95 % of chance)":
            "{linear_coverage_of_draws:.1%}, {linear_variance_over_bound_of_draws:.2f} "
            "({draws_ratio_expected[0]:.2f} to {draws_ratio_expected[1]:.2f})",
        "fit less linear, rms / Cramer-Rao": "{from_linear_over_bound:.3f}",
    }  # fmt: skip
    return harness.table(columns, ({**c, "name": name, **p} for c in cases for name, p in c["parameters"].items()))


def main() -> None:
    """Fit the seeds that are missing of the cases asked for, and put together all that is there."""
    given = options(__doc__, {"cases": CASES}, seeds=100, workers=2)
    fit_missing({name: CASES[name] for name in given.cases}, (NOISE,), given.seeds, given.workers)
    earlier = {c["case"]: c for c in known("identification").get("cases", [])}
    done = {name: finished(name, NOISE) for name in CASES}
    # Of a case that this clone has no fits of, what is committed stays.
    found = [beside_linear(n, rows) if rows else earlier.get(n) for n, rows in done.items()]
    cases = [case for case in found if case]
    what = "whole fits of SciPy's records with fresh noise of 1 % of each peak"
    save("identification", {"what": what, "cases": cases})
    publish("identification", table(cases), "docs/fits_measured.md")


if __name__ == "__main__":
    main()
