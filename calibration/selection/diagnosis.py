"""What would explain the miss: suspects ranked by residuals, the best of them confirmed by fits with their lines.

A fit with a suspect's lines (``remedies``) is compared with the plain one by BIC. What is left at the best of these fits is
ranked again, and the two best suspects are fitted together.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np

from bcfj_jax import InputError
from calibration.diagnostics import suspects
from calibration.diagnostics.signatures import scene_of
from calibration.diagnostics.suspects import Found
from calibration.fit import AllStartsFailed, Fit, fit
from calibration.forward.model import predictions
from calibration.problem import Problem
from calibration.selection.choice import DECISIVE, likelihood_of
from calibration.selection.remedies import altered, joined, laws_of, lines, taken
from calibration.solver_budget import budget

log = logging.getLogger("calibration")

# Suspects that are fitted, if they explain more than this share of what the best one does; starts of such a fit.
_MOST, _NEAR, _STARTS = 3, 0.5, 4
# What is seen in the readings themselves: a fit has nothing to add.
SEEN = ("quantisation",)


@dataclass(frozen=True)
class Trial:
    """A fit with one or two suspects' lines.

    Attributes:
        names: of the suspects.
        lines: for the problem file.
        fit: None where it failed, or where there is nothing to fit.
        gain: by how much BIC falls against the plain fit.
        reason: why there is no fit.
    """

    names: tuple[str, ...]
    lines: str
    fit: Fit | None
    gain: float
    reason: str = ""

    @property
    def confirmed(self) -> bool:
        """Whether the data want it decisively; to leave samples out takes no number that they must pay for."""
        return self.fit is not None and self.gain > (0.0 if self.names == ("saturation",) else DECISIVE)


@dataclass(frozen=True)
class Diagnosis:
    """Suspects, the named one first; their lines by name; the fits with them, the best first where there are any."""

    found: list[Found]
    lines: dict[str, str]
    trials: list[Trial]

    @property
    def named(self) -> list[str]:
        """The suspect that is named, and after it those that the fits cannot tell from it; none where none explains."""
        first = [f.name for f in self.found if f.named]
        return first + [t.names[0] for t in self.alone if t.names[0] not in first and self._as_good(t, first)]

    @property
    def alone(self) -> list[Trial]:
        """Fits with one suspect that the data want, the best first."""
        return [t for t in self.trials if len(t.names) == 1 and t.confirmed]

    def _as_good(self, trial: Trial, first: list[str]) -> bool:
        own = [t for t in self.alone if [t.names[0]] == first]
        return bool(own) and own[0].gain - trial.gain < DECISIVE


def rank(problem: Problem, result: Fit) -> Diagnosis | None:
    """The suspects by residuals alone: no fit. None of a rough cost, a robust loss, and noise that is the integrator's.

    Args:
        problem: that was fitted.
        result: its fit.
    """
    at = result.optimum
    if not at.series or budget(problem.scene).rough or problem.loss != "linear" or at.noise.integrator:
        return None
    if at.spread.covariance is None or min(s.rows.size for s in at.series) < 4:
        return None
    readings = predictions(at.model, at.end.point, at.log_depth)
    scene = scene_of(at.model, at.series, readings, at.end.point, at.log_depth)
    found = suspects.ranked(scene, at.end.residuals, at.end.jacobian, laws_of(problem), taken(problem))
    texts = {f.name: lines(f, scene, problem, result) for f in found}
    return Diagnosis(found, texts, [])


def diagnose(problem: Problem, result: Fit, seed: int = 0) -> Diagnosis | None:
    """The suspects, the best confirmed by fits; None as ``rank``.

    Args:
        problem, result: what was fitted, and its fit.
        seed: of the fits.
    """
    ranking = rank(problem, result)
    if ranking is None:
        return None
    likely = [f for f in ranking.found if f.likely and f.explained > _NEAR * ranking.found[0].explained]
    likely = [f for f in likely if ranking.lines[f.name] and f.name not in SEEN]
    trials = [_trial(problem, result, (f.name,), ranking.lines[f.name], seed) for f in likely[:_MOST]]
    trials.sort(key=lambda t: (not t.confirmed, -t.gain))
    best = trials[0] if trials and trials[0].confirmed else None
    if best is not None and best.fit is not None:
        left = rank(altered(problem, best.lines, result), best.fit)
        second = next((f.name for f in left.found if f.named and f.name not in best.names), "") if left else ""
        both = joined(best.lines, left.lines[second]) if left and second else ""
        if both:
            trials.append(_trial(problem, result, (*best.names, second), both, seed))
    return _confirmed(Diagnosis(ranking.found, ranking.lines, trials))


def _confirmed(d: Diagnosis) -> Diagnosis:
    """With the name that the fits give: that of the best fit, where the residuals named one that was fitted."""
    if not d.alone or (d.found[0].name,) not in [t.names for t in d.trials]:
        return d
    best = d.alone[0].names[0]
    found = [f._replace(named=f.name == best) for f in d.found]
    return replace(d, found=sorted(found, key=lambda f: not f.named))


def _trial(problem: Problem, plain: Fit, names: tuple[str, ...], text: str, seed: int) -> Trial:
    log.info("diagnosis: a fit with %s", " and ".join(names))
    try:
        other = altered(problem, text, plain)
        found = fit(other, seed=seed, starts=_STARTS)
    except (InputError, AllStartsFailed) as error:
        return Trial(names, text, None, 0.0, str(error))
    # On the samples that both have: those at a sensor's limit are dropped.
    weights = np.where(
        np.asarray(found.optimum.model.data.weights) > 0, np.asarray(plain.optimum.model.data.weights), 0
    )
    return Trial(names, text, found, _bic(other, plain, weights) - _bic(other, found))


def _bic(problem: Problem, found: Fit, weights: np.ndarray | None = None) -> float:
    at = found.optimum
    model, residuals = at.model, at.end.residuals
    if weights is not None:
        model = eqx.tree_at(lambda m: m.data.weights, model, weights)
        residuals = np.r_[residuals[: weights.size] * (weights.ravel() > 0), residuals[weights.size :]]
    estimated = tuple(e for e in problem.experiments if not e.hold_out)
    if at.noise.sigma:  # As it was fitted: a suspect's lines may state the noise.
        estimated = tuple(replace(e, channels=tuple(replace(c, sigma=None) for c in e.channels)) for e in estimated)
    return likelihood_of(estimated, model, residuals, at.noise).bic
