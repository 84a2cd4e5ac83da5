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
_ROUNDS = 4
# Of sums of squares the share that is rounding.
_ROUNDED = 1e-13


class Error(NamedTuple):
    """An error that may act.

    Attributes:
        unit, most: of its amplitude, and the size that it has with 95 % if it acts.
        columns: (N, K) a unit of it, in deviations of the noise; several have independent amplitudes.
        kind: errors of one kind exclude each other; alone where empty.
        floor: share of its prior with which it always acts; what acts in full is of no set.
        sign: 1 where its amplitude cannot be negative, as a lag's.
        chance: that it acts, before the record is looked at.
    """

    name: str
    unit: str
    most: float
    columns: np.ndarray
    kind: str = ""
    floor: float = 0.0
    sign: int = 0
    chance: float = ACTS

    @property
    def prior(self) -> tuple[np.ndarray, float]:
        """Columns (N, K) of a deviation of the prior, and its mean over the deviation."""
        mean, deviation = _HALF if self.sign else (0.0, 1.0)
        return self.columns * (deviation * self.most / QUANTILE), mean / deviation


class Linear(NamedTuple):
    """A fit, linear about its optimum.

    Attributes:
        data: (N,) readings less predictions, in deviations; jacobian: (N, P) of the predictions.
        rows: (Q, P) how what is quoted moves with the coordinates.
        floor, ceiling: limits of the variance of the noise: at least 1 where its deviation is stated; 1 of a robust loss.
        freedom: readings less coordinates.
        series: rows in order of time, which may share more than the noise.
        student: quantile of an interval of the noise alone, over the normal one.
    """

    data: np.ndarray
    jacobian: np.ndarray
    rows: np.ndarray
    floor: float
    freedom: int
    series: Sequence[np.ndarray] = ()
    student: float = 1.0
    ceiling: float = np.inf


class Mixture(NamedTuple):
    """Normal estimates by set of acting errors.

    Attributes:
        log: (M,) logarithms of weights; members: (M, E) with which share of its prior an error acts, 0 where not.
        means, type_a, type_b: (M, Q) moves from the optimum, or from the point that they are about, and their deviations.
        variance: of the noise.
        prior: (E,) that each error acts, before the record is looked at.
    """

    log: np.ndarray
    members: np.ndarray
    means: np.ndarray
    type_a: np.ndarray
    type_b: np.ndarray
    variance: float
    prior: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """(M,), sum 1."""
        weights = np.exp(self.log - self.log.max())
        return weights / weights.sum()

    @property
    def reach(self) -> np.ndarray:
        """(M,) how far sets lead from the point, in deviations of the noise alone."""
        return np.max(np.abs(self.means) / np.maximum(self.type_a[0], 1e-300), axis=1)

    def ends(self, level: float = 0.95) -> np.ndarray:
        """(Q, 2) ends of the interval, as moves from the optimum."""
        spread = np.hypot(self.type_a, self.type_b)
        tails = 0.5 * (1.0 - level), 0.5 * (1.0 + level)
        parts = zip(self.means.T, spread.T, strict=True)
        return np.array([[_quantile(m, s, self.weights, q) for q in tails] for m, s in parts])

    @property
    def chances(self) -> np.ndarray:
        """(E,) that each error acts."""
        return self.weights @ (self.members > 0.0)

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


def nearest(every: Sequence[Mixture], of: Sequence[Mixture], *names: str) -> tuple[np.ndarray, ...]:
    """Of every set the point that it leads away from least, and what is found there."""
    k = np.argmin([e.reach for e in every], axis=0)
    return k, *(np.stack([getattr(e, n) for e in of])[k, np.arange(k.size)] for n in names)


def merged(every: Sequence[Mixture], origins: Sequence[np.ndarray | float] = (0.0,)) -> Mixture:
    """Of every set that counts what was found about the point that it leads away from least; (Q,) where each point is."""
    names = ("log", "means", "type_a", "type_b")
    there = [e._replace(means=e.means + o) for e, o in zip(every, origins, strict=True)]
    found = dict(zip(names, nearest(every, there, *names)[1:], strict=True)) | {"members": every[0].members}
    kept = found["log"] > found["log"].max() + np.log(_LEAST)
    return every[0]._replace(**{name: x[kept] for name, x in found.items()})


def mixture(at: Linear, errors: Sequence[Error]) -> Mixture:
    """The sets' average about one point."""
    return merged([evaluated(at, errors)])


class _Sums(NamedTuple):
    """S'^T S', S'^T y; moves of what is quoted without errors (Q,) and by column (Q, C); means of amplitudes (C,)."""

    gram: np.ndarray
    push: np.ndarray
    moved: np.ndarray
    moves: np.ndarray
    lean: np.ndarray


class _Always(NamedTuple):
    """Errors that always act a little: inverse of their H (B, B), mean amplitudes (B,), sums with others (B, C), moves (Q, B)."""

    inner: np.ndarray
    amplitude: np.ndarray
    cross: np.ndarray
    moves: np.ndarray


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


def evaluated(at: Linear, errors: Sequence[Error], variance: float | None = None) -> Mixture:
    """All sets of at most ``MOST`` errors, those of the prior's scales each; beside them what is stated acts always.

    ``variance``: of the noise, where that is known from another point.
    """
    basis, triangle = np.linalg.qr(at.jacobian)
    columns = [np.zeros((at.data.size, 0)), *(e.prior[0] for e in errors)]
    lean = np.concatenate([np.zeros(0), *(np.full(e.columns.shape[1], e.prior[1]) for e in errors)])
    little = [c * e.floor for c, e in zip(columns[1:], errors, strict=True) if e.floor]
    count, stacked = sum(c.shape[1] for c in columns), np.hstack([*columns, *little])
    beside = stacked - basis @ (basis.T @ stacked)
    rest = at.data - basis @ (basis.T @ at.data)
    inverse = np.linalg.solve(triangle.T, at.rows.T).T
    sums = _Sums(beside.T @ beside, beside.T @ rest, inverse @ (basis.T @ at.data), inverse @ (basis.T @ stacked), lean)
    sizes = tuple(c.shape[1] for c in columns[1:])
    every = _sets(sizes, tuple(e.kind for e in errors), tuple(e.chance if e.floor < 1.0 else 0.0 for e in errors))
    known, begin = variance, min(max(at.floor, float(rest @ rest) / max(at.freedom, 1)), at.ceiling)
    variance = begin if known is None else known
    for _ in range(_ROUNDS):
        own, always, turn = _split(sums, sizes, variance)
        found = [_weighed(own, batch, variance) for batch in every]
        if known is not None:
            break
        # The most probable set says how large the noise is.
        k = max(range(len(found)), key=lambda j: found[j].max())
        best = every[k].some(np.array([np.argmax(found[k])]))
        amplitude, used = _amplitudes(own, best, variance)
        full = np.zeros(count)
        full[best.index[0]] = amplitude
        left = rest - beside @ np.r_[turn @ full, always.amplitude - always.inner @ (always.cross @ full) / variance]
        used += len(always.inner) - np.trace(always.inner)
        seen = float(left @ left) / max(at.freedom - used, 0.1 * at.freedom) * _memory(left, at.series)
        before, variance = variance, min(max(at.floor, seen), at.ceiling)
        if abs(variance - before) < 1e-3 * before:
            break
    parts = zip(*(_moments(own, always, batch, variance) for batch in every), strict=True)
    means, covered, doubt = (np.concatenate(part) for part in parts)
    noise = at.student * np.linalg.norm(inverse, axis=1)
    type_a = np.sqrt(np.maximum(variance * noise**2 + covered - doubt, 0.0))
    # Of all sets alike, and other about another point: what no coordinate explains, how many readings tell them apart, and the
    # evidence of what always acts.
    common = -0.5 * float(rest @ rest) / variance - float(np.log(np.abs(np.diag(triangle))).sum())
    common += 0.5 * float(always.amplitude @ sums.push[count:] / variance + np.linalg.slogdet(always.inner)[1])
    log, members = np.concatenate(found) + common, np.concatenate([b.members for b in every])
    return Mixture(log, members, means, type_a, np.sqrt(np.maximum(doubt, 0.0)), variance, _prior(every))


def _prior(every: Sequence[_Batch]) -> np.ndarray:
    chance, members = np.exp(np.concatenate([b.prior for b in every])), np.concatenate([b.members > 0.0 for b in every])
    return chance @ members / chance.sum()


def _split(sums: _Sums, sizes: Sequence[int], variance: float) -> tuple[_Sums, _Always, np.ndarray]:
    """Sums of the first columns with what the others, which always act, take up; and the turn (C, C) of each error's columns
    by which they are orthogonal.
    """
    gram, push, moved, moves, lean = sums
    count = sum(sizes)
    inner = np.linalg.inv(gram[count:, count:] / variance + np.eye(push.size - count))
    cross, amplitude = gram[count:, :count], inner @ push[count:] / variance
    own = gram[:count, :count] - cross.T @ inner @ cross / variance
    ends = np.cumsum(sizes)
    turn = np.zeros((count, count))
    for k, b in zip(sizes, ends, strict=True):
        turn[b - k : b, b - k : b] = np.linalg.eigh(own[b - k : b, b - k : b])[1]
    cross = cross @ turn
    own = turn.T @ own @ turn
    # What a record shows within rounding it does not show.
    seen = np.diag(own) > _ROUNDED * np.max(np.diag(own), initial=0.0)
    turned = _Sums(
        np.where(np.outer(seen, seen), own, 0.0), np.where(seen, turn.T @ push[:count] - cross.T @ amplitude, 0.0),
        moved - moves[:, count:] @ amplitude, moves[:, :count] @ turn - moves[:, count:] @ inner @ cross / variance,
        turn.T @ lean,
    )  # fmt: skip
    return turned, _Always(inner, amplitude, cross, moves[:, count:]), turn


def _memory(left: np.ndarray, series: Sequence[np.ndarray]) -> float:
    """How many times the variance of a mean grows where neighbours correlate by c, (1 + c)/(1 - c); 1 where chance explains c."""
    count, kept = sum(r.size for r in series), neighbours(left, series)
    return (1.0 + kept) / (1.0 - kept) if count and kept > QUANTILE / np.sqrt(count) else 1.0


@lru_cache(maxsize=4)
def _sets(sizes: tuple[int, ...], kinds: tuple[str, ...], chances: tuple[float, ...]) -> tuple[_Batch, ...]:
    """Of errors with so many columns each, which act with these chances; none of those that cannot."""
    names = [kind or f"#{k}" for k, kind in enumerate(kinds)]
    odds = [c / (1.0 - c) / names.count(name) for name, c in zip(names, chances, strict=True)]
    ends, found = np.cumsum(sizes).astype(int), {}
    for count in range(MOST + 1):
        scales = np.array(list(product(SCALES, repeat=count))).reshape(len(SCALES) ** count, count)
        chance = np.array([sum(np.log(SCALES[s]) for s in row) for row in scales.tolist()])
        for chosen in combinations([k for k, c in enumerate(chances) if c], count):
            if len({names[k] for k in chosen}) < count:
                continue
            # The one with more columns is eliminated first.
            chosen = sorted(chosen, key=lambda k: -sizes[k])
            index = np.concatenate([np.zeros(0, int), *(np.arange(ends[k] - sizes[k], ends[k]) for k in chosen)])
            members = np.zeros((len(scales), len(sizes)))
            members[:, chosen] = scales
            own = [sizes[k] for k in chosen]
            found.setdefault((sum(own), sum(own[:1])), []).append(
                (
                    np.tile(index, (len(scales), 1)),
                    np.repeat(scales, own, axis=1),
                    members,
                    chance + np.log([odds[k] for k in chosen]).sum(),
                )
            )
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


def _moments(at: _Sums, always: _Always, sets: _Batch, variance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of every set, (M, Q): mean; variance W H^-1 W^T by errors; of it the prior's, W H^-1 H^-1 W^T."""
    way = at.moves.T[sets.index] * sets.scale[..., None]
    pull, _ = _solved(at, sets, variance, way)
    mean = at.moved - np.einsum("miq,mi->mq", pull, _pushed(at, sets, variance))
    covered = np.sum(way * pull, axis=1) + np.sum(always.moves.T * (always.inner @ always.moves.T), axis=0)
    shared = np.moveaxis(always.cross[:, sets.index], 0, 1) * (sets.scale[:, None, :] / variance) @ pull
    rest = always.inner @ (always.moves.T - shared)
    return mean, covered, np.sum(pull**2, axis=1) + np.sum(rest**2, axis=1)


def _quantile(means: np.ndarray, spread: np.ndarray, weights: np.ndarray, q: float) -> float:
    wide = np.maximum(spread, 1e-300)
    low, high = float(np.min(means - 8.0 * wide)), float(np.max(means + 8.0 * wide))
    beyond = lambda x: float(weights @ ndtr((x - means) / wide)) - q  # noqa: E731
    # Where nothing spreads the means, the share steps at one of them, which may be an end.
    if beyond(low) >= 0.0 or beyond(high) <= 0.0:
        return low if beyond(low) >= 0.0 else high
    return float(brentq(beyond, low, high, xtol=1e-12 * (high - low)))  # pyright: ignore[reportArgumentType]
