"""What an optimum is worth: independent runs of the design before and after, and what manufacture makes of it.

The check is by runs that know nothing of gradients, norms or batches, tighter and, where there is another, by another solver;
of a design of equilibria by the equations of motion, which have what equilibrium leaves out.

Worst case and scatter over tolerances, with half widths t_i of their box and g_i = df/dp_i at the nominal values, are

    worst change = sum_i |g_i| t_i,     standard deviation = sqrt(sum_i (g_i s_i)^2),

s_i = t_i/3 where deviations are normal, t_i/sqrt(3) where they are uniform: first order, and right only while the box is small
beside the feature's bends. Where several peaks are equally high it is the highest of their own worst cases, and the deviation
is by one peak's slopes alone. The same by runs: at scrambled Sobol points of the box, at the corner the slopes point to, and
for normal deviations at as many normal points.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm as normal
from scipy.stats import qmc

from bcfj_jax.analysis.derivatives.jacobian import of_run
from bcfj_jax.analysis.designs.evaluate import Evaluator, Values
from bcfj_jax.analysis.designs.objective import Objective, measured
from bcfj_jax.analysis.designs.space import SIGMAS, Search
from bcfj_jax.core.progress import stage
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import LEVELS, force_error
from bcfj_jax.solve.simulation import Run, simulate

# Share of the gain that must be seen again: with the same model, and with one that has more in it.
SAME, OTHER = 0.9, 0.5
_TIGHTEST = 1e-9


class By(NamedTuple):
    """What checks: a model, a solver, None for the model's own, and the force error."""

    model: AbstractModel
    solver: str | None
    accuracy: float


class Confirmation(NamedTuple):
    """What independent runs found."""

    # before, after: the true objective; NaN where a run failed.
    before: float
    after: float
    # features_before, features_after: what it is made of.
    features_before: dict[str, float]
    features_after: dict[str, float]
    gain: float  # of the objective, positive where it became better
    share: float  # that over the optimiser's
    confirmed: bool  # whether the share is enough, ``SAME`` or ``OTHER``
    how: str  # in words: fidelity, solver, accuracy
    reason: str  # why a run failed; "" for none


def independent(scene: AbstractModel, model: AbstractModel | str, accuracy: str | float) -> By:
    """What checks a design: the model that leaves nothing out, or the one named, by another method, at a tenth of the
    optimiser's force error, and no more than ``reference``.
    """
    checker = scene.full() if isinstance(model, str) else model
    asked = max(min(0.1 * force_error(accuracy), LEVELS["reference"]), _TIGHTEST)
    return By(checker, "rodas3" if checker.traits.stiff else "dopri5", asked)


def confirm(
    scene: AbstractModel, by: By, designs: Sequence[tuple[Params, np.ndarray]], objective: Objective, gain: float
) -> Confirmation:
    """Run the designs before and after again, each with its times; ``scene`` was optimised, by so much ``gain``."""
    found = []
    for params, times in designs:
        # Another model may not have every parameter.
        known: Any = {name: np.asarray(x, dtype=float) for name, x in params.items() if name in by.model.quantities}
        run = simulate(by.model, known, times, accuracy=by.accuracy, solver=by.solver)
        found.append((*features(run, by.model, times, objective), run.reason if run.status != "ok" else ""))
    (before, first, why), (after, second, also) = found
    seen = objective.sign * (before - after)
    share = seen / gain if gain else np.nan
    least = SAME if by.model == scene else OTHER
    how = f"{by.model.title} by {by.solver or 'its own solver'} at a force error of {by.accuracy:.0e}"
    confirmed, said = bool(gain > 0 and share >= least), "; ".join(filter(None, (why, also)))
    return Confirmation(before, after, first, second, seen, share, confirmed, how, said)


def features(run: Run, scene: AbstractModel, times: np.ndarray, objective: Objective) -> tuple[float, dict[str, float]]:
    """The true objective of a run, and the features it is made of by name; NaN where it failed."""
    if run.status != "ok":
        return float("nan"), {f.name: float("nan") for f in objective.features}
    value = of_run(run)
    # Designs of explicit models are compared by summits, which a crest between samples stands for here.
    norm = np.inf if scene.traits.history and not scene.traits.stiff else None
    values = measured(times, value, value.constant, objective, scene.members, norm)
    found = {f.name: float(x.value) for f, x in zip(objective.features, values, strict=True)}
    return float(objective.of(values).value), found


# Differences for the gradient of a worst change, over a range; and where |g_i| t_i is rounded, over the objective.
_DIFFERENCE, _ROUNDED = 1e-4, 1e-6


class Robustness(NamedTuple):
    """Of the true feature at the nominal design; NaN where unknown."""

    nominal: float  # its value
    # linear_worst, linear_deviation: worst value and standard deviation by the gradient.
    linear_worst: float
    linear_deviation: float
    # sampled_worst, sampled_deviation, sampled_mean: by runs.
    sampled_worst: float
    sampled_deviation: float
    sampled_mean: float
    worst_at: dict[str, float]  # SI values of the worst, by name
    # samples, failed, reasons: runs asked for, those without a value, and why with their numbers.
    samples: int
    failed: int
    reasons: dict[str, int]


def robustness(
    evaluate: Evaluator, unit: np.ndarray, values: Values, search: Search, kinked: bool
) -> Robustness | None:
    """Of a design (P,) in unit coordinates and the values of that one point; None without any tolerance.

    The worst case is that of the box, whatever the distribution. ``kinked``: whether several peaks are equally high there,
    so that a single gradient is not enough.
    """
    space = evaluate.space
    at = space.values(unit)
    halves = space.halves(at)
    if not halves.any():
        return None
    widths = halves / space.slope(at)
    changes, nominal, sign = values.slope[0] * widths, float(values.true[0]), evaluate.objective.sign
    steepest, toward = nominal + sign * float(np.abs(changes).sum()), np.sign(values.slope[0])
    read = evaluate.samples(unit) if kinked else None
    if read is not None:
        reach = np.where(read[2], read[0] + np.abs(read[1] * widths).sum(axis=1), -np.inf)
        k = int(np.argmax(reach))
        steepest, toward = float(reach[k]), np.sign(read[1][k])
    moved, power = np.flatnonzero(halves), int(np.ceil(np.log2(search.samples)))
    shares = qmc.Sobol(moved.size, rng=np.random.default_rng(search.seed)).random_base2(power)
    box = np.zeros((len(shares), len(at)))
    box[:, moved] = 2.0 * shares - 1.0
    points = [at + halves * toward, *(at + halves * box)]
    if search.distribution == "normal":
        scatter = np.zeros_like(box)
        scatter[:, moved] = normal.ppf(np.clip(shares, 1e-9, 1.0 - 1e-9)) / SIGMAS["normal"]
        points += [*(at + halves * scatter)]
    with stage("runs over the tolerances"):
        found = evaluate.at(np.array(points))
    inside = sign * found.true[: 1 + len(box)]
    good = found.true[-len(box) :]
    good, reasons = good[np.isfinite(good)], dict(Counter(filter(None, found.reasons)))
    linear, unknown = float(np.linalg.norm(changes) / SIGMAS[search.distribution]), float("nan")
    scattered = (float(good.std()), float(good.mean())) if good.size else (unknown, unknown)
    worst, worst_at = unknown, {}
    if np.isfinite(inside).any():
        k = int(np.nanargmax(inside))
        worst, worst_at = float(found.true[k]), space.named(points[k])
    counts = len(points), sum(reasons.values())
    return Robustness(nominal, steepest, linear, worst, *scattered, worst_at, *counts, reasons)


def robust(evaluate: Evaluator, kappa: float) -> Callable[..., Values]:
    """The objective with  kappa sum_i |g_i| t_i  added, and its gradient.

    |x| is rounded, sqrt(x^2 + (1e-6 f)^2): the optimum often has a g_i = 0. The gradient of the sum is H d with
    d_i = sign(g_i) t_i, taken as a central difference of two gradients along d. ``true`` stays the feature alone.
    """
    if not kappa:
        return evaluate
    space = evaluate.space

    def widths(unit: np.ndarray) -> np.ndarray:
        """Half widths in unit coordinates, (N, P)."""
        at = space.values(unit)
        return space.halves(at) / space.slope(at)

    def wrapped(unit: np.ndarray, norm: float = np.inf) -> Values:
        here, halves = evaluate(unit, norm), widths(unit)
        # Relative tolerances, and logarithmic axes, have widths that change with the place.
        growth = (widths(unit + _DIFFERENCE) - widths(unit - _DIFFERENCE)) / (2.0 * _DIFFERENCE)
        small = _ROUNDED * np.abs(here.goal)[:, None]
        change = np.sqrt((here.slope * halves) ** 2 + small**2)
        share = here.slope**2 * halves / np.where(change > 0, change, 1.0)
        along = np.where(halves > 0, share * halves / np.where(here.slope == 0, 1.0, here.slope), 0.0)
        bend = _along(evaluate, unit, along, norm)
        total, slope = np.sum(change - small, axis=1), bend + share * growth
        return here._replace(
            smooth=here.smooth + kappa * total, slope=here.slope + kappa * slope, goal=here.goal + kappa * total
        )

    return wrapped


def _along(evaluate: Evaluator, unit: np.ndarray, along: np.ndarray, norm: float) -> np.ndarray:
    """Hessian times a vector at each point (N, P); from one side where the other one leaves the box."""
    length = np.linalg.norm(along, axis=1, keepdims=True)
    way = _DIFFERENCE * np.where(np.isfinite(along), along, 0.0) / np.where(length > 0, length, 1.0)
    out = [np.any((unit + s * way < 0.0) | (unit + s * way > 1.0), axis=1, keepdims=True) for s in (1.0, -1.0)]
    sides = [np.where(o, 0.0, s) for o, s in zip(out, (1.0, -1.0), strict=True)]
    # In a corner that both leave, both are taken: a bound is no wall of the model.
    sides = [np.where(out[0] & out[1], s, side) for side, s in zip(sides, (1.0, -1.0), strict=True)]
    ahead, behind = (evaluate(unit + side * way, norm).slope for side in sides)
    return (ahead - behind) / ((sides[0] - sides[1]) * _DIFFERENCE) * length
