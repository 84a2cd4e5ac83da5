"""How far the interval to quote would shrink: by experiments that might be made, or by an instrument that is known better.

By the evaluation that the fit's interval comes from (``uncertainty.sets``), about the same optimum. What an experiment would
read is not known: it is drawn from what the record leaves open (which errors act, how large, the coefficients, noise), the
interval evaluated, and the median of some draws counts. For an instrument that is known better the readings stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from bcfj_jax.core.quantities import percent, rounded
from calibration import instrument
from calibration.diagnostics import fit_tests
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.records import series_of
from calibration.fit import Fit
from calibration.forward.model import build, predictions, residuals_and_jacobian
from calibration.forward.runs import contacts
from calibration.problem import Experiment, Problem
from calibration.search.refinement import End
from calibration.solver_budget import budget
from calibration.uncertainty import quote, systematic
from calibration.uncertainty.intervals import half
from calibration.uncertainty.sets import Error, Linear, mixture

_DRAWS = 5
# A change by less is none: as far as draws scatter.
_SAME = 0.05


class Half(NamedTuple):
    """Half width of an interval now and then, a share of the value where it is ``relative``, else SI."""

    now: float
    then: float
    relative: bool

    @property
    def said(self) -> str:
        """In words; "" where nothing changes."""
        now, then = (percent(x, 2) if self.relative else rounded(x) for x in (self.now, self.then))
        return f"+- {now} to +- {then}" if abs(self.then / self.now - 1.0) > _SAME else ""


def narrowed(
    problem: Problem, found: Fit, planned: Experiment | None, runs: int, said: Mapping[str, Any]
) -> dict[str, Half]:
    """None where the fit quotes no interval, and of a rough cost or a robust loss.

    Args:
        planned: what each of the runs would be; None for no experiment.
        said: of the instruments, as in a calibration file.
    """
    at = found.optimum
    if at is None or found.systematic is None or at.model.loss != "linear" or budget(at.model).rough:
        return {}
    if at.model.data.features.size or at.spread.covariance is None:
        return {}
    how = quote.moving(at)
    now = dict(zip(how.names, _halves(*_evaluated(problem, at)), strict=True))
    # What is stated acts always, in full, where it is taken alone (JCGM 100, 4.3.3); beside what is known without it no statement
    # makes anything less known (4.3.1: all the information that there is).
    each = [_after(problem, at, planned, runs, known) for known in ([{}, said] if said else [{}])]
    then = {name: min(one[name] for one in each) for name in each[0]}
    log, halves = dict(zip(how.names, how.log, strict=True)), {}
    for name, p in found.every.items():
        # Values of one record alone stay what they are.
        if p.ci95 and now.get(name) and name in then:
            own = half(p.ci95, log[name])
            halves[name] = Half(own, own * then[name] / float(now[name]), log[name])
    return halves


def _after(
    problem: Problem, at: Optimum, planned: Experiment | None, runs: int, said: Mapping[str, Any]
) -> dict[str, float]:
    """Half widths by name where the runs are made, with what is said of the instruments."""
    there = replace(at, experiments=tuple(_known(e, said, problem.where) for e in at.experiments))
    if planned is not None:
        there = _extended(problem, there, _known(planned, said, problem.where), runs)
    lin, errors = _evaluated(problem, there)
    halves = _halves(lin, errors) if planned is None else _drawn(at, there, lin, errors)
    return dict(zip(quote.moving(there).names, halves.tolist(), strict=True))


def _known(e: Experiment, said: Mapping[str, Any], where: str) -> Experiment:
    read = {c.observes: c for c in e.channels}
    own = {name: {**c.instrument, **instrument.stated(said, name, read, where)} for name, c in read.items()}
    return replace(e, channels=tuple(replace(c, instrument=own[c.observes]) for c in e.channels)) if said else e


def _evaluated(problem: Problem, at: Optimum) -> tuple[Linear, list[Error]]:
    return quote.linear(at, systematic.every(problem, at), np.ones(at.end.point.size, bool))


def _halves(lin: Linear, errors: list[Error]) -> np.ndarray:
    ends = mixture(lin, errors).ends()
    return 0.5 * (ends[:, 1] - ends[:, 0])


def _extended(problem: Problem, at: Optimum, planned: Experiment, runs: int) -> Optimum:
    """The optimum with runs that read what it predicts."""
    more = tuple(replace(planned, name=f"{planned.name} {k + 1}") for k in range(runs))
    every, old = (*at.experiments, *more), at.model.data
    model = replace(build(problem, every).at_depth(at.model.log_depth), how=at.model.how)
    count, channels, length = old.values.shape
    values, weights, memory = (np.array(x) for x in (model.data.values, model.data.weights, model.data.memory))
    for new, kept in ((values, old.values), (weights, old.weights), (memory, old.memory)):
        new[:count, :channels, :length] = kept
    pairs = list(zip(at.model.coordinates, at.model.values(at.end.point).tolist(), strict=True))
    # A record's own value of a fit of one record is of no number.
    known = {(axis.name, axis.experiment or 0): value for axis, value in pairs}
    usual = {axis.name: value for axis, value in pairs} | {"time_offset": 0.0}
    own = [known.get((axis.name, axis.experiment or 0), usual[axis.name]) for axis in model.coordinates]
    point = model.point(np.array(own))
    values[count:] = predictions(model, point)[count:]
    model = eqx.tree_at(lambda m: (m.data.values, m.data.weights, m.data.memory), model, (values, weights, memory))
    residuals, jacobian = residuals_and_jacobian(model, point)
    end = End(point, point, float(residuals @ residuals), residuals, jacobian, True)
    spread = fit_tests.spread(end, sum(e.samples for e in every), [], model.loss)
    there = Optimum(model, every, end, at.noise, spread)
    return replace(there, series=series_of(there, contacts(model, point), np.zeros(residuals.size), problem.accuracy))


def _drawn(at: Optimum, there: Optimum, lin: Linear, errors: list[Error]) -> np.ndarray:
    """Median of the half widths for readings of the new runs that are drawn."""
    count, rng = len(at.experiments), np.random.default_rng(0)
    place = [int(np.unravel_index(s.rows[0], there.model.data.values.shape)[0]) for s in there.series]
    old = np.concatenate([s.rows for s, i in zip(there.series, place, strict=True) if i < count])
    new = np.concatenate([s.rows for s, i in zip(there.series, place, strict=True) if i >= count])
    seen = np.any(lin.jacobian[old] != 0.0, axis=0)
    data, jacobian = lin.data[old], lin.jacobian[old][:, seen]
    base = Linear(data, jacobian, lin.rows[:, seen], lin.floor, at.spread.freedom, (), lin.student, lin.ceiling)
    found = mixture(base, [e._replace(columns=e.columns[old]) for e in errors])
    halves = []
    for _ in range(_DRAWS):
        shares = found.members[rng.choice(found.weights.size, p=found.weights)]
        acting = [(e.prior[0] * (1.0 if e.stated else x), e.prior[1]) for e, x in zip(errors, shares, strict=True)]
        acting = [(c, lean) for c, lean in acting if c.any()]
        design = np.hstack([lin.jacobian[:, seen], *(c for c, _ in acting)])
        prior = np.sqrt(found.variance) * np.eye(design.shape[1])[int(seen.sum()) :]
        means = [np.full(c.shape[1], np.sqrt(found.variance) * lean) for c, lean in acting]
        basis, triangle = np.linalg.qr(np.vstack([design[old], prior]))
        push = basis.T @ np.concatenate([base.data, *means])
        chance = np.sqrt(found.variance) * rng.standard_normal(push.size)
        data = lin.data.copy()
        data[new] = design[new] @ np.linalg.solve(triangle, push + chance) + rng.standard_normal(new.size)
        halves.append(_halves(lin._replace(data=data), errors))
    return np.median(halves, axis=0)
