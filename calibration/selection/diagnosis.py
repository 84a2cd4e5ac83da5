"""What would explain the miss: suspects ranked by residuals, the best of them confirmed by fits with their lines.

A fit with a suspect's lines (``remedies``) is compared with the plain one by BIC. What is left at the best of these fits is
ranked again, and the two best suspects are fitted together.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

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

# Suspects that are fitted, and starts of such a fit.
_MOST, _STARTS = 3, 4


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
        """Whether the fit converged and the data want it decisively."""
        return self.fit is not None and self.fit.search.answer == "converged" and self.gain > DECISIVE


@dataclass(frozen=True)
class Diagnosis:
    """Suspects, the named ones first; their lines by name; the fits with them, the best first where there are any."""

    found: list[Found]
    lines: dict[str, str]
    trials: list[Trial]

    @property
    def named(self) -> list[str]:
        """Names of the suspects that are named."""
        return [f.name for f in self.found if f.named]


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
    likely = [f for f in ranking.found if f.likely and ranking.lines[f.name]]
    before = _bic(problem, result)
    trials = [_trial(problem, result, before, (f.name,), ranking.lines[f.name], seed) for f in likely[:_MOST]]
    trials.sort(key=lambda t: (not t.confirmed, -t.gain))
    best = trials[0] if trials and trials[0].confirmed else None
    if best is not None and best.fit is not None:
        left = rank(altered(problem, best.lines, result), best.fit)
        second = next((f.name for f in left.found if f.named and f.name not in best.names), "") if left else ""
        both = joined(best.lines, left.lines[second]) if left and second else ""
        if both:
            trials.append(_trial(problem, result, before, (*best.names, second), both, seed))
    return _confirmed(Diagnosis(ranking.found, ranking.lines, trials))


def _confirmed(d: Diagnosis) -> Diagnosis:
    """With the name that the fits give where they disagree with the residuals: the best fit's."""
    alone = [t for t in d.trials if len(t.names) == 1 and t.confirmed]
    if not alone or not d.named or alone[0].names[0] == d.named[0]:
        return d
    mine = next((t for t in alone if t.names[0] == d.named[0]), None)
    if mine is not None and alone[0].gain - mine.gain < DECISIVE:
        return d
    found = [f._replace(named=int(f.name == alone[0].names[0])) for f in d.found]
    return replace(d, found=sorted(found, key=lambda f: not f.named))


def _trial(problem: Problem, plain: Fit, before: float, names: tuple[str, ...], text: str, seed: int) -> Trial:
    log.info("diagnosis: a fit with %s", " and ".join(names))
    try:
        other = altered(problem, text, plain)
        found = fit(other, seed=seed, starts=_STARTS)
    except (InputError, AllStartsFailed) as error:
        return Trial(names, text, None, 0.0, str(error))
    return Trial(names, text, found, before - _bic(other, found))


def _bic(problem: Problem, found: Fit) -> float:
    fitted = tuple(e for e in problem.experiments if not e.hold_out)
    at = found.optimum
    return likelihood_of(fitted, at.model, at.end.residuals, at.noise).bic
