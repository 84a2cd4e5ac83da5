"""The interval to quote: a fit's estimates with errors of which few act (``uncertainty.sets``), and what each error costs.

Signatures and Jacobian hold about one point. Where a probable set leads an estimate so far that this counts, both are made anew
about the point where it leads; every set is then evaluated about the point that it leads away from least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcfj_jax.core.quantities import percent, rounded
from calibration.diagnostics.fit_tests import WORST_CONDITION
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import overstated
from calibration.forward.losses import influence
from calibration.forward.model import residuals_and_jacobian
from calibration.solver_budget import budget
from calibration.uncertainty.estimates import Moving, Parameter, in_si, moving
from calibration.uncertainty.sets import QUANTILE, Error, Linear, Mixture, evaluated, merged, nearest

# Kind of interval.
KIND = "errors"
BEYOND = (
    "the record shows '{}' larger than its prior, so nobody knows how large errors are here: intervals reach to where "
    "residuals are least; state what the instrument is known to, or fit another law"
)
# An error that moves no estimate by more than this share is not named.
_NAMED = 1e-4
# A move whose square is such a share of the interval's half width is far, both as shares of the estimate: to second order
# that is what a line about the point where it began is off by. Sets that lead far with a smaller share of the weight stay.
_FAR, _LITTLE = 0.05, 0.1
# Points that are tried.
_POINTS = 10
# The chance from which on a record is said to show an error, and the share of the prior's chance below which it rules it out.
SHOWN, OUT = 0.95, 0.2


# Errors about a point.
Anew = Callable[..., Sequence[Error]]


class Line(NamedTuple):
    """One error: the ``amplitude`` up to which it is allowed for, alone; what each estimate ``moves`` by then, a share of
    itself where its coordinate is logarithmic, else in SI; the chance that it acts, and the prior's; the combined
    uncertainty of each over that without it.
    """

    error: str
    amplitude: float
    unit: str
    moves: dict[str, float]
    chance: float = 1.0
    prior: float = 1.0
    cost: dict[str, float] = {}

    @property
    def limit(self) -> str:
        """The amplitude in words; of a resonance the frequency."""
        if self.error.startswith("resonance"):
            return f"{rounded(1.0 / (2.0 * np.pi * np.sqrt(self.amplitude)))} oscillations in a contact's duration"
        return f"{percent(self.amplitude, 2)} {self.unit}"

    @property
    def says(self) -> str:
        """What the record says of it; of an instrument's statement, that it is one."""
        if self.prior >= 1.0:
            return "stated"
        return "acts" if self.chance >= SHOWN else "ruled out" if self.chance <= OUT * self.prior else "open"


class Uncertainty(NamedTuple):
    """Standard uncertainty of an estimate in the words of JCGM 100, relative where its coordinate is logarithmic, else SI."""

    type_a: float
    type_b: float
    combined: float
    coverage_factor: float
    relative: bool


class Quoted(NamedTuple):
    """What is quoted: names, how far the ends of each interval (K, 2) and the expectation (K,) lie from the optimum,
    uncertainties, every error, and the one that the record shows larger than its prior, or "".

    What is held where it is, as an estimate at its bound, has no uncertainty.
    """

    names: tuple[str, ...]
    ends: np.ndarray
    expected: np.ndarray
    uncertainties: dict[str, Uncertainty]
    lines: list[Line]
    beyond: str = ""


def quoted(
    at: Optimum, errors: Sequence[Error], free: np.ndarray | None = None, bound: bool = False, anew: Anew | None = None
) -> Quoted:
    """The intervals of an optimum whose covariance is known.

    Args:
        free: (P,) coordinates that are not held; all where None.
        bound: every error at its limit at once in place of few that act: a bound, no interval of 95 %.
        anew: errors about another point; where None, or of a rough cost or a robust loss, the optimum's stay.
    """
    how, free = moving(at), np.ones(at.end.point.size, bool) if free is None else free
    lin, every = linear(at, errors, free)
    last, found = _led(_Around(at, lin, every, evaluated(lin, every)), free, None if bound else anew)
    known, beyond = _lines(last.lin, last.errors, found, how), found.beyond()
    ends, expected = found.ends(), found.weights @ found.means
    if bound:
        half = QUANTILE * lin.student * np.sqrt(found.variance) * np.linalg.norm(_rows(lin), axis=1)
        half += np.sum([list(line.moves.values()) for line in known], axis=0)
        ends, expected, beyond = np.column_stack([-half, half]), np.zeros(half.size), None
    combined, type_a, type_b = found.combined()
    factors = 0.5 * (ends[:, 1] - ends[:, 0]) / np.maximum(combined, 1e-300)
    columns = (x.tolist() for x in (type_a, type_b, combined, factors))
    standard = ((name, Uncertainty(*rest)) for name, *rest in zip(how.names, *columns, how.log, strict=True))
    standard = {name: own for name, own in standard if own.type_a > 0.0}
    return Quoted(how.names, ends, expected, standard, known, "" if beyond is None else last.errors[beyond].name)


class _Around(NamedTuple):
    """The fit made linear about a point, its errors there, and every set: moves of what is quoted."""

    at: Optimum
    lin: Linear
    errors: list[Error]
    sets: Mixture


def _led(begin: _Around, free: np.ndarray, anew: Anew | None) -> tuple[_Around, Mixture]:
    """The point that the most probable set leads to, and the moves of all sets from the first."""
    points, origin, model = [begin], moving(begin.at).z, begin.at.model
    anew = None if model.loss != "linear" or budget(model).rough else anew
    while True:
        places = [moving(p.at).z - origin for p in points]
        own = [p.sets for p in points]
        found = merged(own, places)
        leading = _leading(own, found, begin, places) if anew and len(points) < _POINTS else None
        # The noise is what the most probable set leaves about a point where one leads, once there is such a point.
        variance = points[0].sets.variance if len(points) > 1 else None
        following = leading and anew and _following(points[leading[0]], leading[1], begin, free, anew, variance)
        if following is None:
            at, _, log = nearest(own, "log")
            return points[at[np.argmax(log)]], found
        if len(points) == 1:
            points = [begin._replace(sets=evaluated(begin.lin, begin.errors, following.sets.variance))]
        points.append(following)


def _leading(
    own: Sequence[Mixture], found: Mixture, begin: _Around, places: Sequence[np.ndarray]
) -> tuple[int, int] | None:
    """The point and the most probable of the sets that lead further than a line reaches, where no point is yet; None of few."""
    how, ends = moving(begin.at), found.ends()
    size = np.where(how.log, 1.0, np.maximum(np.abs(how.z), 1e-300))
    at, reach, log, means = nearest(own, "log", "means")
    target, unit = means + np.stack(places)[at], np.maximum(own[0].type_a[0], 1e-300)
    apart = np.min([np.max(np.abs(target - place) / unit, axis=1) for place in places], axis=0)
    far = np.any(means**2 > _FAR * 0.5 * (ends[:, 1] - ends[:, 0]) * size, axis=1) & (apart > 0.5 * reach)
    weight = np.exp(log - log.max())
    i = int(np.argmax(np.where(far, weight, -1.0)))
    return (int(at[i]), i) if weight[far].sum() > _LITTLE * weight.sum() else None


def _following(
    here: _Around, i: int, begin: _Around, free: np.ndarray, anew: Anew, variance: float | None
) -> _Around | None:
    """The fit about the point where a set leads; None where the model does not run there, knows other errors, or loses a
    direction, as of a stop that the motion no longer reaches.

    The motion of the point does not know the error, that of the optimum follows the record and does. What an error of the law
    changes between the two is its slope midway, to third order.
    """
    point, rows = np.array(here.at.end.point, dtype=float), here.lin.rows
    size = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)
    # The shortest move of the coordinates that moves what is quoted as the set does.
    point[free] += np.linalg.lstsq(rows / size[:, None], here.sets.means[i] / size)[0]
    point = np.clip(point, 1e-9, 1.0 - 1e-9)
    residuals, jacobian = residuals_and_jacobian(here.at.model, point)
    if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
        return None
    if np.linalg.cond(jacobian[:, free]) >= WORST_CONDITION:
        return None
    there = replace(here.at, end=replace(here.at.end, point=point, residuals=residuals, jacobian=jacobian))
    errors = list(anew(there, 0.5 * (point + begin.at.end.point)))
    if [e.name for e in errors] != [e.name for e in here.errors]:
        return None
    lin = here.lin._replace(data=-residuals, jacobian=jacobian[:, free], rows=moving(there).slopes[:, free])
    return _Around(there, lin, errors, evaluated(lin, errors, variance))


def linear(at: Optimum, errors: Sequence[Error], free: np.ndarray) -> tuple[Linear, list[Error]]:
    """The fit as readings that are linear in coordinates and errors; least squares over these rows is a step of a robust loss."""
    best, spread, loss, slopes = at.end, at.spread, at.model.loss, moving(at).slopes
    psi, bend = influence(loss, best.residuals)
    root = np.sqrt(np.maximum(bend, 1e-3))
    data, jacobian, rows = -psi / root, root[:, None] * best.jacobian[:, free], slopes[:, free]
    stated = [not s.estimated or s.integrator for s in at.series] or [True]
    large = bool(at.series) and all(overstated(s, best.residuals) for s in at.series)
    share = float(data @ data) / max(spread.freedom, 1) if large else 1.0
    floor = 0.0 if large or (loss == "linear" and not any(stated)) else 1.0
    series, ceiling = ([s.rows for s in at.series], np.inf) if loss == "linear" else ([], 1.0)
    lin = Linear(data, jacobian, rows, floor, max(spread.freedom, 1), series, ceiling=ceiling)
    alone, halves = np.linalg.norm(_rows(lin), axis=1), np.array([spread.half_width(s) for s in slopes])
    moved = (alone > 0.0) & np.isfinite(halves) & (halves > 0.0)
    if moved.any() and free.all():
        lin = lin._replace(student=float(np.max(halves[moved] / alone[moved])) / QUANTILE / np.sqrt(share))
    return lin, [e._replace(columns=root[:, None] * e.columns) for e in errors]


def _rows(lin: Linear) -> np.ndarray:
    """(K, P) moves of what is quoted with an orthonormal basis of the Jacobian."""
    return np.linalg.solve(np.linalg.qr(lin.jacobian)[1].T, lin.rows.T).T


def _lines(lin: Linear, errors: list[Error], found: Mixture, how: Moving) -> list[Line]:
    """Every error that moves an estimate: alone as large as residuals and prior let pass; its chance, and what it costs."""
    basis, _ = np.linalg.qr(lin.jacobian)
    rows, chances = _rows(lin), found.chances
    rest = lin.data - basis @ (basis.T @ lin.data)
    combined = found.combined()[0]
    sizes = np.where(how.log, 1.0, np.maximum(np.abs(how.z), 1e-300))
    every, lines = evaluated(lin, errors, found.variance) if any(e.stated for e in errors) else found, []
    for k, error in enumerate(errors):
        columns, lean = error.prior
        beside = columns - basis @ (basis.T @ columns)
        _, seen, turn = np.linalg.svd(beside, full_matrices=False)
        root = turn.T / np.sqrt(1.0 + seen**2 / found.variance)
        covariance = root @ root.T
        mean, way = covariance @ (beside.T @ rest / found.variance + lean), rows @ (basis.T @ columns)
        moves = np.abs(way @ mean) + QUANTILE * np.linalg.norm(way @ root, axis=1)
        if np.max(moves / sizes) <= _NAMED:
            continue
        size = error.most
        if columns.shape[1] == 1:
            unit = np.linalg.norm(columns) / np.linalg.norm(error.columns)
            size = float(unit * (abs(mean[0]) + QUANTILE * np.sqrt(covariance[0, 0])))
        cost = combined / np.maximum(found.without(k).combined()[0], 1e-300)
        if error.stated:  # It is in every set, each of which is narrower without it.
            bare = [e._replace(columns=0.0 * e.columns) if e is error else e for e in errors]
            apart = evaluated(lin, bare, found.variance, every.log)
            cost = merged([every]).combined()[0] / np.maximum(merged([apart]).combined()[0], 1e-300)
        chance = (1.0, 1.0) if error.stated else (float(chances[k]), float(found.prior[k]))
        by_name = [dict(zip(how.names, x.tolist(), strict=True)) for x in (moves, cost)]
        lines.append(Line(error.name, size, error.unit, by_name[0], *chance, by_name[1]))
    return lines


def with_errors(p: Parameter, k: int, how: Moving, by: Quoted, moved: bool, kept: bool = False) -> Parameter:
    """Estimate k with the interval to quote, where it has one.

    Where ``moved`` its value is the expectation (JCGM 101, 7.6): residuals are least where an error that acts moves the
    estimate. Else the value stays, and the interval reaches to it, as it does where an error acts beyond its prior: what moves
    the estimate then is of no known size. Where ``kept`` it holds the interval that the estimate has.
    """
    if p.ci95 is None:
        return p
    log, limits = how.log[k], how.limits[k]
    z = p.value if not log else np.log(p.value) if p.value > 0.0 else 0.0
    own = in_si(z + by.ends[k, 0], z + by.ends[k, 1], log, limits)
    value = in_si(z + by.expected[k], np.inf, log, limits)[0] if moved else p.value
    low, high = p.ci95 if kept else (p.value, p.value) if by.beyond else (value, value)
    ends = (min(own[0], low, value), max(own[1], high, value))
    kind, kinds = p.headline if kept and ends != own else KIND, {**p.intervals, KIND: own}
    found = {"value": value, "least_squares": p.value, "ci95": ends, "with_budget": ends}
    return replace(p, **found, headline=kind, intervals=kinds)
