"""The solver's error in an estimate: measured in deviations of the estimate, and taken out where it is no small part.

It is systematic: it may move an estimate by more than one sample's noise does, though it is far smaller. Where that is too
much the fit goes on from its optimum with tighter runs (``solver_budget.tighter``).
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import special

from calibration.diagnostics.fit_tests import shift
from calibration.forward import integration
from calibration.forward.model import Model
from calibration.noise.averaging import stepped
from calibration.search.evaluate import evaluator
from calibration.search.refinement import End, finish
from calibration.solver_budget import budget

log = logging.getLogger("calibration")

# Deviations of the estimate that the solver's error may move it by: an interval of 95 % then covers 94.5 %.
LITTLE = 0.2
_ROUNDS = 2


class Corrected(NamedTuple):
    """An optimum on the model that it is one of, the solver's part in its white residuals (N,), and what was done, in words."""

    model: Model
    end: End
    errors: np.ndarray
    notes: list[str]


def corrected(model: Model, best: End, errors: np.ndarray) -> Corrected:
    """An optimum whose estimates the solver's error moves by at most ``LITTLE`` deviations, if tighter runs succeed.

    Nothing is run where that holds already, nor where ``errors`` (N,) of the residuals (``integration.errors``) are not known.
    """
    first = now = shift(errors, best.jacobian)
    rounds = 0
    while now > LITTLE and rounds < _ROUNDS:
        finer = integration.tighter(model)
        end = _again(finer, best)
        left = np.full(1, np.nan) if end is None else integration.errors(finer, end.point, end.residuals)
        if end is None or not np.isfinite(left).all():
            break
        model, best, errors, rounds = finer, end, left, rounds + 1
        now = shift(errors, best.jacobian)
        log.info("refined at a tighter tolerance: chi2 %.6g", best.cost)
    notes, error = [], "the integrator's error"
    if rounds:
        on = f"the fit went on at a tolerance {budget(model).tighter ** rounds:g} times tighter"
        moved = f"{error} would move the estimates by {first:.2g} of their deviation"
        notes.append(f"at the accuracy asked for, {moved}: {on}")
    if now > LITTLE:
        covers = f"an interval of 95 % covers {100.0 * covered(now):.0f} %"
        notes.append(f"{error} may move an estimate by {now:.2g} of its deviation: then {covers}")
    return Corrected(model, best, errors, notes)


def covered(moved: float) -> float:
    """What an interval of 95 % covers where the estimate is moved by so many of its deviations."""
    half = float(special.ndtri(0.975))
    return float(special.ndtr(half - moved) - special.ndtr(-half - moved))


def _again(finer: Model, best: End) -> End | None:
    """The optimum on a tighter model, from that on the looser one; None where there is no way to it."""
    if not budget(finer).rough:
        end = finish(finer, best.start, np.clip(best.point, 1e-9, 1.0 - 1e-9))
        return None if end.failure else end
    if finer.loss != "linear":
        return None
    # With the mean Jacobian: where the cost is rough, that at one point leads nowhere.
    evaluate = evaluator(finer)
    begin = replace(best, residuals=evaluate(best.point[None])[0][0])
    end = stepped(evaluate, begin) if np.isfinite(begin.residuals).all() else begin
    return None if end is begin else end
