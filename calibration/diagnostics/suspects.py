"""The usual suspects for a miss, ranked by what they explain of held-out residuals; nothing here simulates anew.

Residuals r of a fit with the Jacobian J are compared with the signatures S of each suspect (``signatures``): [J S] is fitted
to a part of the samples and predicts the others. Numbers such as a frequency are sought on a grid in each training part. What
a suspect explains is the share by which the held-out sum of squares falls; of a noise (jitter, steps of a quantisation) the
share of the variance that has its size. A suspect is significant where chance would let the best of all grids fall so far in
less than one record of a hundred (F, Bonferroni). Correlated noise is named only where nothing else is: a missed shape looks
the same.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import special

from calibration.diagnostics.catalogue import LOSS, SUSPECTS
from calibration.diagnostics.residual_tests import neighbours
from calibration.diagnostics.signatures import Scene, thinned

# Chance of a name in a record without any imperfection, all suspects together.
_LEVEL = 0.01
# Samples of a block that is held out, at least, and blocks of a contact.
_FEWEST, _BLOCKS = 4, 8
_FOLDS = 6
# Samples that are enough: of more a part is taken.
_SAMPLES = 4000
# So many runs or contacts are folds, and so many at most.
_SEVERAL, _MOST = 3, 8
# Rounds of a finer grid about the best point, and points of each number in it.
_ROUNDS, _POINTS = 3, 5
# A suspect that explains less of the held-out squares than this is not named, however significant.
_LEAST = 0.05
# Readings equal to the largest, from which on a sensor may be saturated; readings that show a lattice.
_EQUAL, _LATTICE = 3, 8
NOISES = ("clock jitter", "quantisation", "saturation", "correlated noise")


class Found(NamedTuple):
    """What one suspect explains."""

    name: str
    explained: float  # share of the held-out sum of squares
    chance: float  # that noise alone lets any suspect explain as much as this; 1 where it explains nothing
    values: dict[str, float]  # numbers of its best shape, SI, and its amplitude where that is one number
    columns: np.ndarray | None = None  # (N, K) its signature there; none of a noise
    given: bool = False  # whether its amplitude is 1
    numbers: int = 1  # that are fitted or sought for it
    named: bool = False  # whether it is the one that explains most

    @property
    def likely(self) -> bool:
        """Whether it explains more than chance would, and enough to matter."""
        return self.chance < _LEVEL and self.explained > _LEAST


class _Errors(NamedTuple):
    """Sum of squares of all samples fitted, of each training part (F,), and of the held-out parts together (F,)."""

    whole: float
    trained: np.ndarray
    held_out: np.ndarray
    amplitudes: np.ndarray


class _Folds:
    """Residuals (n,) and Jacobian (n, P) in the ``order`` of their folds, whose first rows are ``starts``; errors without any
    suspect, and degrees of freedom.

    Folds: runs where there are three or more, else contacts, else blocks of a contact's eighth. Every second block of a run or
    contact is held out at a time: a hum's phase in a run can be learnt there only.
    """

    def __init__(self, scene: Scene, residuals: np.ndarray, jacobian: np.ndarray) -> None:
        fold, runs = np.full(residuals.size, -1), len(set(scene.runs))
        for s, run in zip(scene.series, scene.runs, strict=True):
            starts = s.touching & ~np.r_[False, s.touching[:-1]]
            contacts = int(starts.sum())
            blocks = np.arange(s.rows.size) // max(_FEWEST, int(s.touching.sum()) // max(contacts, 1) // _BLOCKS)
            if runs >= _SEVERAL or contacts >= _SEVERAL:
                part = run if runs >= _SEVERAL else np.maximum(np.cumsum(starts) - 1, 0)
                fold[s.rows] = 2 * (part % _MOST) + blocks % 2
            else:
                fold[s.rows] = blocks % _FOLDS
        rows = np.flatnonzero(fold >= 0)
        self.order = rows[np.argsort(fold[rows], kind="stable")]
        self.starts = np.flatnonzero(np.diff(np.r_[-1, fold[self.order]]))
        size = np.linalg.norm(jacobian, axis=0)
        self.residuals = residuals[self.order]
        self.jacobian = (jacobian / np.where(size > 0.0, size, 1.0))[self.order]
        self.plain = self.errors(self.jacobian, self.residuals)
        self.count = int(self.order.size) - jacobian.shape[1]

    def errors(self, columns: np.ndarray, target: np.ndarray) -> _Errors:
        """Of least squares of the target by columns: on all rows, and on all folds but one."""
        ends = [*self.starts[1:], self.order.size]
        parts = [(columns[a:b], target[a:b]) for a, b in zip(self.starts, ends, strict=True)]
        gram, push = np.stack([c.T @ c for c, _ in parts]), np.stack([c.T @ t for c, t in parts])
        square, ridge = np.array([t @ t for _, t in parts]), 1e-9 * np.eye(columns.shape[1])
        rest, given = gram.sum(axis=0) - gram + ridge, push.sum(axis=0) - push
        amplitudes = np.linalg.solve(gram.sum(axis=0) + ridge, push.sum(axis=0))
        x = np.linalg.solve(rest, given[..., None])[..., 0]
        trained = square.sum() - square - np.einsum("fp,fp->f", given, x)
        held = square - 2.0 * np.einsum("fp,fp->f", push, x) + np.einsum("fp,fpq,fq->f", x, gram, x)
        return _Errors(float(square.sum() - push.sum(axis=0) @ amplitudes), trained, held, amplitudes)

    def tried(self, columns: np.ndarray, given: bool) -> _Errors | None:
        """Errors with a signature's columns (N, K) beside the Jacobian."""
        own = columns[self.order]
        if not np.isfinite(own).all():
            return None
        if given:
            # The data have what the prediction lacks: residuals are prediction less data.
            return self.errors(self.jacobian, self.residuals + own[:, 0])
        size = np.linalg.norm(own, axis=0)
        own = own[:, size > 0.0] / size[size > 0.0]
        return self.errors(np.hstack([self.jacobian, own]), -self.residuals) if own.size else None


def ranked(
    scene: Scene, residuals: np.ndarray, jacobian: np.ndarray, laws: Sequence[str] = (), taken: Collection[str] = ()
) -> list[Found]:
    """Every suspect, the best first; one that predicts held-out samples worse explains less than nothing.

    ``laws``: suspects of the law that may be tried; ``taken``: suspects that the model has in it already.
    """
    scene = thinned(scene, _SAMPLES)
    at = _Folds(scene, residuals, jacobian)
    free = {name: s for name, s in SUSPECTS.items() if name not in taken}
    tried = [name for name, s in free.items() if not s.law or (name in laws and any(scene.motions))]
    tests = len(tried) + len(NOISES)
    found = [f for name in tried if (f := _scanned(at, name, scene, tests))]
    found += [_jitter(at, scene, tests), _quantised(at, scene), *_saturated(at, scene, tests)]
    found = [f for f in found if f.name not in taken]
    # Of two that explain the same, the one with fewer numbers. Another loss bends the loops of all runs, and so takes a part
    # of what any shape does: it goes before one that explains less than half as much.
    share = {LOSS: 0.5}
    found.sort(key=lambda f: 2.0 * f.numbers / at.order.size - f.explained * share.get(f.name, 1.0))
    if not any(f.likely for f in found) and "correlated noise" not in taken:
        found.append(_correlated(scene, residuals, tests))
    # Of two that are likely, the one that explains more comes first; what chance explains comes last.
    found.sort(key=lambda f: not f.likely)
    return [f._replace(named=k == 0 and f.likely) for k, f in enumerate(found)]


def _scanned(at: _Folds, name: str, scene: Scene, tests: int) -> Found | None:
    """A suspect's best shape, and what it explains of held-out samples, the shape sought in each training part."""
    suspect = SUSPECTS[name]
    grid = suspect.sought(scene)
    tried: list[tuple[dict[str, float], _Errors]] = []

    def attempt(grid: dict[str, np.ndarray]) -> None:
        for numbers in product(*grid.values()):
            values = _within(dict(zip(grid, map(float, numbers), strict=True)))
            errors = at.tried(suspect.columns(scene, **values), suspect.given)
            if errors is not None and (suspect.sign == 0 or errors.amplitudes[-1] > 0.0):
                tried.append((values, errors))

    attempt(grid)
    if not tried:
        return None
    # Steps of the grid as ratios, halved from round to round.
    ratios = {key: (v[-1] / v[0]) ** (1.0 / max(v.size - 1, 1)) for key, v in grid.items()}
    for _ in range(_ROUNDS if grid else 0):
        centre = min(tried, key=lambda t: t[1].whole)[0]
        attempt({key: centre[key] * ratio ** np.linspace(-1.0, 1.0, _POINTS) for key, ratio in ratios.items()})
        ratios = {key: ratio**0.4 for key, ratio in ratios.items()}
    values, best = min(tried, key=lambda t: t[1].whole)
    chosen = np.argmin([errors.trained for _, errors in tried], axis=0)
    held = sum(float(tried[c][1].held_out[f]) for f, c in enumerate(chosen))
    columns = suspect.columns(scene, **values)
    more = len(grid) + (0 if suspect.given else int(np.count_nonzero(np.any(columns, axis=0))))
    if suspect.amplitude:
        size = np.linalg.norm(columns[at.order, 0])
        values = {**values, suspect.amplitude: float(best.amplitudes[-1] / size)}
    explained = 1.0 - held / float(at.plain.held_out.sum())
    points = int(np.prod([v.size for v in grid.values()]))
    chance = _chance(at.plain.whole, best.whole, more, at.count) * points * tests
    return Found(name, explained, min(chance, 1.0), values, columns, suspect.given, more)


def _within(values: dict[str, float]) -> dict[str, float]:
    damping = values.get("resonance_damping")
    return values if damping is None else {**values, "resonance_damping": min(max(damping, 2e-3), 0.6)}


def _chance(before: float, after: float, more: int, count: int) -> float:
    """Chance of a fall of the sum of squares by so much with so many numbers more: F."""
    left = count - more
    if left < 1 or not after > 0.0:
        return 1.0
    ratio = max(before - after, 0.0) / more / (after / left)
    return float(special.fdtrc(more, left, ratio))


def _jitter(at: _Folds, scene: Scene, tests: int) -> Found:
    """Whether the variance grows with the square of the slope: 1 + (j w x')^2, j sought on a grid.

    Of the residuals' second differences, (r_-1 - 2 r + r_+1)/sqrt(6), in which a smooth shape leaves little.
    """
    slope, rough = np.zeros(scene.size), np.zeros(scene.size)
    residuals = np.zeros(scene.size)
    residuals[at.order] = at.residuals
    for s, x in zip(scene.series, scene.read, strict=True):
        if s.clock.size > 2:
            slope[s.rows] = _second(np.square(np.gradient(x, s.clock) * s.weights), np.array([1.0, 4.0, 1.0]) / 6.0)
            rough[s.rows] = _second(residuals[s.rows], np.array([1.0, -2.0, 1.0]) / np.sqrt(6.0))
    square, own = rough[at.order] ** 2, slope[at.order]
    if not (own.any() and square.any()):
        return Found("clock jitter", 0.0, 1.0, {})
    scales = np.r_[0.0, np.geomspace(0.1, 1e3, 25)] / float(np.mean(own))
    variance = 1.0 + scales[:, None] * own
    logs, sizes = np.add.reduceat(np.log(variance), at.starts, axis=1), np.add.reduceat(square / variance, at.starts, 1)
    counts = np.diff(np.r_[at.starts, at.order.size])

    def cost(log: np.ndarray, size: np.ndarray, count: np.ndarray | int) -> np.ndarray:
        return 0.5 * log + 0.5 * count * np.log(size / count)

    whole = cost(logs.sum(1), sizes.sum(1), at.order.size)
    rest = cost(logs.sum(1)[:, None] - logs, sizes.sum(1)[:, None] - sizes, at.order.size - counts)
    gain = 0.0
    for f, k in enumerate(np.argmin(rest, axis=0)):
        for sign, i in ((1.0, 0), (-1.0, k)):
            level = (sizes[i].sum() - sizes[i, f]) / (at.order.size - counts[f])
            gain += sign * 0.5 * (logs[i, f] + counts[f] * np.log(level) + sizes[i, f] / level)
    best = int(np.argmin(whole))
    # Differences of white residuals correlate by -2/3 and 1/6: they tell half as much as they are.
    chance = float(special.chdtrc(1.0, max(whole[0] - whole[best], 0.0))) * tests
    level = np.sqrt(sizes[best].sum() / at.order.size)
    sigma = level / float(np.median(np.concatenate([s.weights for s in scene.series])))
    uneven = min(float(square.sum()) / float(at.residuals @ at.residuals), 1.0)
    explained = uneven * (1.0 - float(np.exp(-2.0 * gain / at.order.size)))
    values = {"jitter": float(level * np.sqrt(scales[best])), "sigma": sigma}
    return Found("clock jitter", explained, min(chance, 1.0), values)


def _second(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Each value (N,) with its two neighbours, weighted; at the ends as beside them."""
    return np.pad(np.convolve(values, weights, "valid"), 1, "edge")


def _quantised(at: _Folds, scene: Scene) -> Found:
    """Share of the residuals' variance that steps of the readings have: step^2/12."""
    steps = [lattice(s.values) for s in scene.series]
    share = sum(float(np.sum((q * s.weights) ** 2)) / 12.0 for q, s in zip(steps, scene.series, strict=True))
    explained, widest = min(share / float(np.sum(at.residuals**2)), 1.0), max(steps, default=0.0)
    return Found("quantisation", explained, 0.0 if widest else 1.0, {"step": widest})


def lattice(values: np.ndarray) -> float:
    """Step of which all readings are whole multiples apart; 0 where there is none, or few levels."""
    levels = np.unique(values)
    if levels.size < _LATTICE or levels.size > 0.9 * values.size:
        return 0.0
    step = float(np.min(np.diff(levels)))
    if step < 1e-9 * float(np.ptp(levels)):
        return 0.0
    parts = (levels - levels[0]) / step
    return step if np.max(np.abs(parts - np.round(parts))) < 1e-3 else 0.0


def _saturated(at: _Folds, scene: Scene, tests: int) -> list[Found]:
    """What is left without the samples that equal the largest reading."""
    level = max((float(np.abs(s.values).max()) for s in scene.series), default=0.0)
    keep = np.ones(scene.size)
    for s in scene.series:
        keep[s.rows] = np.abs(s.values) < level * (1.0 - 1e-9)
    keep = keep[at.order]
    count = int(keep.size - keep.sum())
    if count < _EQUAL:
        return []
    errors = at.errors(at.jacobian * keep[:, None], at.residuals * keep)
    before = at.plain.held_out.sum() / at.order.size
    explained = 1.0 - float(errors.held_out.sum() / (at.order.size - count) / before)
    chance = _chance(at.plain.whole, errors.whole, count, at.count) * tests
    return [Found("saturation", explained, min(chance, 1.0), {"level": level})]


def _correlated(scene: Scene, residuals: np.ndarray, tests: int) -> Found:
    """Correlation of successive residuals, which any shape that is missed makes, too."""
    phi = neighbours(residuals, [s.rows for s in scene.series])
    count = sum(s.rows.size - 1 for s in scene.series)
    step = float(np.median(np.concatenate([np.diff(s.clock) for s in scene.series])))
    chance = float(special.ndtr(-phi * np.sqrt(count))) * tests
    time = -step / np.log(phi) if 0.0 < phi < 1.0 else 0.0
    return Found("correlated noise", max(phi, 0.0) ** 2, min(chance, 1.0), {"correlation": time})
