"""Estimates with errors of which few act: an average over sets of acting errors, each set linear and Gaussian.

Readings less predictions y = J x + S a + e in deviations of the noise, e of variance v; coordinates x, of which nothing is known
before; amplitudes a of the acting errors, normal with deviation 1 in columns S that are a share of their priors (``SCALES``),
about 0 or, of those that have a sign, with the moments of a half normal distribution.
How x, a and the evidence of a set follow: docs/theory/calibration.md. Noise that is estimated is what the most probable set
leaves. What is quoted are quantiles of the mixture of all sets by their evidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.special import ndtr

from calibration.diagnostics.catalogue import ACTS as ACTS
from calibration.diagnostics.catalogue import QUANTILE as QUANTILE
from calibration.diagnostics.residual_tests import neighbours

# Shares of its prior that an error has if it acts, with their chances.
SCALES = {0.1: 0.3, 0.3: 0.3, 1.0: 0.3, 3.0: 0.1}
# Errors that act at once, at most.
MOST = 2
# Mean and deviation of a half normal distribution of deviation 1: an error that has a sign has these moments.
_HALF = float(np.sqrt(2.0 / np.pi)), float(np.sqrt(1.0 - 2.0 / np.pi))
# A set with a smaller share of the largest weight is left out.
_LEAST = 1e-6
# One with such a share is not looked at about the point where it is so small.
_NONE = 1e-12
_ROUNDS = 4
# Of sums of squares the share that is rounding.
_ROUNDED = 1e-13


class Error(NamedTuple):
    """An error that may act."""

    name: str
    # unit, most: of its amplitude, and the size that it has with 95 % if it acts.
    unit: str
    most: float
    columns: np.ndarray  # (N, K) a unit of it, in deviations of the noise; several have independent amplitudes
    kind: str = ""  # errors of one kind exclude each other; alone where empty
    # Whether it acts always, in full. Of sets it is a member like others, that adds nothing: so no other error acts
    # more often where one is known.
    stated: bool = False
    sign: int = 0  # 1 where its amplitude cannot be negative, as a lag's
    chance: float = ACTS  # that it acts, before the record is looked at

    @property
    def prior(self) -> tuple[np.ndarray, float]:
        """Columns (N, K) of a deviation of the prior, and its mean over the deviation."""
        mean, deviation = _HALF if self.sign else (0.0, 1.0)
        return self.columns * (deviation * self.most / QUANTILE), mean / deviation


class Linear(NamedTuple):
    """A fit, linear about its optimum."""

    data: np.ndarray  # (N,) readings less predictions, in deviations
    jacobian: np.ndarray  # (N, P) of the predictions
    rows: np.ndarray  # (Q, P) how what is quoted moves with the coordinates
    # floor, ceiling: limits of the variance of the noise: at least 1 where its deviation is stated; 1 of a robust loss.
    floor: float
    freedom: int  # readings less coordinates
    series: Sequence[np.ndarray] = ()  # rows in order of time, which may share more than the noise
    student: float = 1.0  # quantile of an interval of the noise alone, over the normal one
    ceiling: float = np.inf


class Mixture(NamedTuple):
    """Normal estimates by set of acting errors."""

    log: np.ndarray  # (M,) logarithms of weights
    members: np.ndarray  # (M, E) with which share of its prior an error acts, 0 where not
    # means, type_a, type_b: (M, Q) moves from the optimum, or from the point that they are about, and their deviations.
    means: np.ndarray
    type_a: np.ndarray
    type_b: np.ndarray
    variance: float  # of the noise
    prior: np.ndarray  # (E,) that each error acts, before the record is looked at

    @property
    def weights(self) -> np.ndarray:
        """(M,), sum 1."""
        weights = np.exp(self.log - self.log.max())
        return weights / weights.sum()

    def ends(self) -> np.ndarray:
        """(Q, 2) ends of the interval of 95 %, as moves from the optimum."""
        parts = zip(self.means.T, np.hypot(self.type_a, self.type_b).T, strict=True)
        return np.array([[_quantile(m, s, self.weights, q) for q in (0.025, 0.975)] for m, s in parts])

    @property
    def chances(self) -> np.ndarray:
        """(E,) that each error acts."""
        return self.weights @ (self.members > 0.0)

    def beyond(self) -> int | None:
        """The error that acts beyond its prior in most sets, by weight, where it does so in more than half of them."""
        shares = self.weights @ (self.members > 1.0)
        return int(np.argmax(shares)) if self.weights @ np.any(self.members > 1.0, axis=1) > 0.5 else None

    def combined(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Standard uncertainties (Q,): combined, Type A, Type B; what sets differ by is of Type B."""
        mean = self.weights @ self.means
        between = self.weights @ (self.means - mean) ** 2
        a, b = self.weights @ self.type_a**2, self.weights @ self.type_b**2 + between
        return np.sqrt(a + b), np.sqrt(a), np.sqrt(b)

    def without(self, error: int) -> Mixture:
        """As if one error were known not to act."""
        kept = self.members[:, error] == 0.0
        return self._replace(log=np.where(kept, self.log, -np.inf)) if kept.any() else self


def nearest(every: Sequence[Mixture], *names: str) -> tuple[np.ndarray, ...]:
    """Of every set the point that it leads away from least, how far, in deviations of the first point's noise, and what is
    found there.
    """
    unit = np.maximum(every[0].type_a[0], 1e-300)
    reach = np.array([np.max(np.abs(e.means) / unit, axis=1) for e in every])
    k = np.argmin(reach, axis=0)
    return k, *(x[k, np.arange(k.size)] for x in (reach, *(np.stack([getattr(e, n) for e in every]) for n in names)))


def merged(every: Sequence[Mixture], origins: Sequence[np.ndarray | float] = (0.0,)) -> Mixture:
    """Of every set that counts what was found about the point that it leads away from least; (Q,) where each point is."""
    k, _, log, means, type_a, type_b = nearest(every, "log", "means", "type_a", "type_b")
    kept, means = log > log.max() + np.log(_LEAST), means + np.stack(origins).reshape(len(every), -1)[k]
    log, members, means, type_a, type_b = (x[kept] for x in (log, every[0].members, means, type_a, type_b))
    return Mixture(log, members, means, type_a, type_b, every[0].variance, every[0].prior)


def mixture(at: Linear, errors: Sequence[Error]) -> Mixture:
    """The sets' average about one point."""
    return merged([evaluated(at, errors)])


class _Sums(NamedTuple):
    """What is left of columns S and data y beside the coordinates and what always acts, for a variance of the noise."""

    # beside, rest: (N + B, C) S' and (N + B,) y'; the last B rows say that amplitudes of what always acts are about 0.
    beside: np.ndarray
    rest: np.ndarray
    # gram, push: S'^T S', S'^T y'.
    gram: np.ndarray
    push: np.ndarray
    lean: np.ndarray  # (C,) means of amplitudes
    # moved, moves: moves of what is quoted without errors (Q,) and by column (Q, C).
    moved: np.ndarray
    moves: np.ndarray
    given: np.ndarray  # (Q, B) moves by a deviation of each of the last rows
    used: float  # how many of those the data replace
    alone: np.ndarray  # (Q,) variance without errors
    log: float  # logarithm of the evidence, as far as no set changes it


class _Batch(NamedTuple):
    """Sets with as many columns each, of which the first ``head`` are one error's: (M, K) columns and their scales, (M, E) by
    error, (M,) logarithm of the prior.
    """

    head: int
    index: np.ndarray
    scale: np.ndarray
    members: np.ndarray
    prior: np.ndarray

    def some(self, kept: np.ndarray) -> _Batch:
        return _Batch(self.head, *(x[kept] for x in self[1:]))


def evaluated(
    at: Linear, errors: Sequence[Error], variance: float | None = None, log: np.ndarray | None = None
) -> Mixture:
    """All sets of at most ``MOST`` errors, those of the prior's scales each; beside them what is stated acts always.

    ``variance``: of the noise, where that is known from another point; ``log``: of the weights, where those are known.
    """
    sizes = tuple(e.columns.shape[1] for e in errors)
    every = _sets(sizes, tuple(e.kind for e in errors), tuple(e.chance for e in errors))
    basis = np.linalg.qr(at.jacobian)[0]
    rest = at.data - basis @ (basis.T @ at.data)
    within = lambda seen: min(max(at.floor, float(seen)), at.ceiling)  # noqa: E731
    last = 0 if variance is not None else _ROUNDS
    variance = within(rest @ rest / max(at.freedom, 1)) if variance is None else variance
    for count in range(last + 1):
        own = _sums(at, errors, variance)
        found = [_weighed(own, batch, variance) for batch in every]
        if count == last:
            break
        # The most probable set says how large the noise is.
        k = max(range(len(found)), key=lambda j: found[j].max())
        best = every[k].some(np.array([np.argmax(found[k])]))
        amplitude, used = _amplitudes(own, best, variance)
        left, used = (own.rest - own.beside[:, best.index[0]] @ amplitude)[: at.data.size], used + own.used
        seen = within(left @ left / max(at.freedom - used, 0.1 * at.freedom) * _memory(left, at.series))
        if abs(seen - variance) < 1e-3 * variance:
            break
        variance = seen
    log = np.concatenate(found) + own.log if log is None else log
    members, chance = (np.concatenate(x) for x in zip(*((b.members, np.exp(b.prior)) for b in every), strict=True))
    # Where a set without weight leads, which takes most of the time, nobody asks; of the first, without errors, all do.
    kept = log > log.max() + np.log(_NONE)
    kept[0] = True
    parts = np.split(kept, np.cumsum([b.prior.size for b in every])[:-1])
    moments = [_moments(own, b.some(k), variance) for b, k in zip(every, parts, strict=True) if k.any()]
    means, type_a, type_b = (np.full((log.size, at.rows.shape[0]), np.inf) for _ in range(3))
    means[kept], type_a[kept], type_b[kept] = map(np.concatenate, zip(*moments, strict=True))
    deviations, prior = (np.sqrt(np.maximum(type_a, 0.0)), np.sqrt(type_b)), chance @ (members > 0.0) / chance.sum()
    return Mixture(np.where(kept, log, -np.inf), members, means, *deviations, variance, prior)


def _sums(at: Linear, errors: Sequence[Error], variance: float) -> _Sums:
    """What always acts is of the coordinates, each amplitude with a row that says about how large it is.

    Columns of an error are turned so that they are orthogonal beside those.
    """
    size, width = at.jacobian.shape
    always = np.hstack([np.zeros((size, 0)), *(e.prior[0] for e in errors if e.stated)])
    columns = [e.prior[0] * (not e.stated) for e in errors]
    count, deviation = always.shape[1], np.sqrt(variance)
    rows = np.hstack([np.zeros((count, width)), deviation * np.eye(count)])
    basis, triangle = np.linalg.qr(np.vstack([np.hstack([at.jacobian, always]), rows]))
    inverse = np.linalg.solve(triangle.T, np.pad(at.rows, ((0, 0), (0, count))).T).T
    noise = np.sum(np.linalg.solve(triangle[:width, :width].T, at.rows.T) ** 2, axis=0)
    stacked = np.pad(np.column_stack([at.data, *columns]), ((0, count), (0, 0)))
    within = basis.T @ stacked
    beside = stacked - basis @ within
    parts = np.split(beside[:, 1:], np.cumsum([c.shape[1] for c in columns])[:-1].astype(int), axis=1)
    turn = np.asarray(block_diag(*(np.linalg.eigh(x.T @ x)[1] for x in parts)))
    rest, beside, moves = beside[:, 0], beside[:, 1:] @ turn, inverse @ within[:, 1:] @ turn
    gram = beside.T @ beside
    # What a record shows within rounding it does not show.
    seen = np.diag(gram) > _ROUNDED * np.max(np.diag(gram), initial=0.0)
    lean = turn.T @ np.concatenate([np.zeros(0), *(np.full(e.columns.shape[1], e.prior[1]) for e in errors)])
    # Between points how many readings tell the coordinates apart counts, and what no coordinate explains.
    log = 0.5 * count * np.log(variance) - 0.5 * rest @ rest / variance - np.log(np.abs(np.diag(triangle))).sum()
    return _Sums(
        beside, rest, np.where(np.outer(seen, seen), gram, 0.0), np.where(seen, beside.T @ rest, 0.0), lean,
        inverse @ within[:, 0], moves, deviation * inverse @ basis[size:].T, count - float(np.sum(basis[size:] ** 2)),
        variance * (np.sum(inverse**2, axis=1) + (at.student**2 - 1.0) * noise), float(log),
    )  # fmt: skip


def _memory(left: np.ndarray, series: Sequence[np.ndarray]) -> float:
    """How many times the variance of a mean grows where neighbours correlate by c, (1 + c)/(1 - c); 1 where chance explains c."""
    count, kept = sum(r.size for r in series), neighbours(left, series)
    return (1.0 + kept) / (1.0 - kept) if count and kept > QUANTILE / np.sqrt(count) else 1.0


@lru_cache(maxsize=4)
def _sets(sizes: tuple[int, ...], kinds: tuple[str, ...], chances: tuple[float, ...]) -> tuple[_Batch, ...]:
    """Of errors with so many columns each, which act with these chances."""
    names = [kind or f"#{k}" for k, kind in enumerate(kinds)]
    odds = [c / (1.0 - c) / names.count(name) for name, c in zip(names, chances, strict=True)]
    ends, found = np.cumsum(sizes).astype(int), {}
    for count in range(MOST + 1):
        scales = np.array(list(product(SCALES, repeat=count))).reshape(len(SCALES) ** count, count)
        chance = np.array([sum(np.log(SCALES[s]) for s in row) for row in scales.tolist()])
        for chosen in combinations(range(len(chances)), count):
            if len({names[k] for k in chosen}) < count:
                continue
            # The one with more columns is eliminated first.
            chosen = sorted(chosen, key=lambda k: -sizes[k])
            index = np.concatenate([np.zeros(0, int), *(np.arange(ends[k] - sizes[k], ends[k]) for k in chosen)])
            members = np.zeros((len(scales), len(sizes)))
            members[:, chosen] = scales
            own, prior = [sizes[k] for k in chosen], chance + np.log([odds[k] for k in chosen]).sum()
            sets = np.tile(index, (len(scales), 1)), np.repeat(scales, own, axis=1), members, prior
            found.setdefault((sum(own), sum(own[:1])), []).append(sets)
    return tuple(_Batch(head, *map(np.concatenate, zip(*rows, strict=True))) for (_, head), rows in found.items())


def _solved(at: _Sums, sets: _Batch, variance: float, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of every set H^-1 R of its own ``right`` (M, K, R), and ln |H| (M,).

    Columns of one error are orthogonal: those of the first are eliminated by a diagonal.
    """
    index, scale, k = sets.index, sets.scale, sets.head
    size = 1.0 + np.diag(at.gram)[index] * scale**2 / variance
    cross = at.gram[index[:, :k, None], index[:, None, k:]] * (scale[:, :k, None] * scale[:, None, k:] / variance)
    way = cross / size[:, :k, None]
    rest = size[:, k:, None] * np.eye(size.shape[1] - k) - np.swapaxes(cross, 1, 2) @ way
    last = np.linalg.solve(rest, right[:, k:] - np.swapaxes(way, 1, 2) @ right[:, :k])
    first = right[:, :k] / size[:, :k, None] - way @ last
    return np.concatenate([first, last], axis=1), np.log(size[:, :k]).sum(axis=1) + np.linalg.slogdet(rest)[1]


def _pushed(at: _Sums, sets: _Batch, variance: float) -> np.ndarray:
    """(M, K) S'^T y / v and the prior's mean: H times the amplitudes."""
    return at.push[sets.index] * sets.scale / variance + at.lean[sets.index]


def _weighed(at: _Sums, sets: _Batch, variance: float) -> np.ndarray:
    """Logarithm of the weight of every set (M,)."""
    push = _pushed(at, sets, variance)
    solved, size = _solved(at, sets, variance, push[..., None])
    return 0.5 * (np.sum(push * solved[..., 0] - at.lean[sets.index] ** 2, axis=1) - size) + sets.prior


def _amplitudes(at: _Sums, one: _Batch, variance: float) -> tuple[np.ndarray, float]:
    """Of one set the amplitudes (K,), and how many of its columns are used."""
    inverse = _solved(at, one, variance, np.eye(one.index.shape[1])[None])[0][0]
    return inverse @ _pushed(at, one, variance)[0] * one.scale[0], len(inverse) - float(np.trace(inverse))


def _moments(at: _Sums, sets: _Batch, variance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every set, (M, Q): mean and variances of Type A and B; W H^-1 W^T is by errors, of it W H^-1 H^-1 W^T by the prior."""
    way = at.moves.T[sets.index] * sets.scale[..., None]
    pull, _ = _solved(at, sets, variance, way)
    mean = at.moved - np.einsum("miq,mi->mq", pull, _pushed(at, sets, variance))
    above = np.moveaxis(at.beside[-at.given.shape[1] or at.rest.size :, sets.index], 0, 1) * sets.scale[:, None, :]
    given = at.given.T - above @ pull / np.sqrt(variance)
    doubt = np.sum(pull**2, axis=1) + np.sum(given**2, axis=1)
    return mean, at.alone + np.sum(way * pull, axis=1) - doubt, doubt


def _quantile(means: np.ndarray, spread: np.ndarray, weights: np.ndarray, q: float) -> float:
    wide = np.maximum(spread, 1e-300)
    low, high = float(np.min(means - 8.0 * wide)), float(np.max(means + 8.0 * wide))
    beyond = lambda x: float(weights @ ndtr((x - means) / wide)) - q  # noqa: E731
    # Where nothing spreads the means, the share steps at one of them, which may be an end.
    if beyond(low) >= 0.0 or beyond(high) <= 0.0:
        return low if beyond(low) >= 0.0 else high
    return float(brentq(beyond, low, high, xtol=1e-12 * (high - low)))  # pyright: ignore[reportArgumentType]
