"""What an error of the sensor or of the law adds to a record, to first order about an optimum, in deviations of the noise.

Of the sensor it follows from what is predicted; of the law it is a force f beside the predicted one, and what the motion
makes of it: m x'' = -(k x + c x' + f) changes the force by f + k x + c x', with the tangent k, c of F = K d^n exp(a d')
fitted to the predicted force, and m that of d'' = g - F/m: a contact of one mass. Where the motion is another, the force
alone is taken. A reading that goes as the depth, its rate or the force of the one contact changes with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded

from calibration.diagnostics.residual_tests import Series
from calibration.forward.model import Model
from calibration.forward.runs import instants, of_contacts, params_at, ran, stretches

# Samples of a block of flight that is kept where there are too many.
_BLOCK = 32
# A contact's tangent is fitted where its depth is above this share of the largest.
_DEEP = 0.02
# Share of the acceleration that one mass must explain.
_ONE_MASS = 0.98


class Motion(NamedTuple):
    """One contact's predicted motion in one record, and how a force beside it would change what is read."""

    # times, depth, rate, force: (T,) of the model's clock.
    times: np.ndarray
    depth: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    elastic: np.ndarray  # the force without its damping
    deepest: np.ndarray  # largest depth since the contact began
    # (T - 1, 2, 2) from one instant's small change to the next one's; None where the motion is not of one mass.
    moves: np.ndarray | None
    tangent: np.ndarray  # (T, 2) k [N/m] and c [N s/m]
    mass: float

    def reply(self, force: np.ndarray) -> np.ndarray:
        """Changes (T, 3) of force, depth and its rate for a force (T,) beside it [N]."""
        if self.moves is None:
            return force[:, None] * np.array([1.0, 0.0, 0.0])
        # x' = A x + (0, -f/m) from rest, by the trapezoidal rule, all instants as one banded system: a product of moves
        # over many contacts has no inverse.
        push, half, count = -force / self.mass, 0.5 * np.diff(self.times), self.times.size
        right, bands = np.zeros((count, 2)), np.zeros((4, count, 2))
        right[1:] = half[:, None] * self.moves[:, :, 1] * push[:-1, None]
        right[1:, 1] += half * push[1:]
        bands[0] = 1.0
        for row, column in np.ndindex(2, 2):
            bands[2 + row - column, :-1, column] = -self.moves[:, row, column]
        moved = solve_banded((3, 0), bands.reshape(4, -1), right.ravel(), check_finite=False).reshape(count, 2)
        return np.column_stack([force + np.sum(self.tangent * moved, axis=1), moved])

    def follows(self, clock: np.ndarray, read: np.ndarray) -> np.ndarray | None:
        """How a reading (n,) goes with force, depth and rate: one of three numbers is not 0; None where it is another thing."""
        best, found = (1.0 - _ONE_MASS) * float(np.sum((read - read.mean()) ** 2)), None
        for k, own in enumerate((self.force, self.depth, self.rate)):
            columns = np.column_stack([np.ones(clock.size), np.interp(clock, self.times, own)])
            slope = np.linalg.lstsq(columns, read, rcond=None)[0]
            left = float(np.sum((read - columns @ slope) ** 2))
            best, found = (left, slope[1] * np.eye(3)[k]) if left < best else (best, found)
        return found


class Held(NamedTuple):
    """The motion that a series reads: with the offset of its clock [s], and how readings go with force, depth and rate (3,)."""

    motion: Motion
    offset: float
    follows: np.ndarray


class Scene(NamedTuple):
    """What signatures are made from."""

    size: int  # N, residuals of the fit
    series: list[Series]  # residuals by record and channel
    runs: list[int]  # the record of each
    read: list[np.ndarray]  # (n,) what is predicted of each, SI
    motions: list[Held | None]  # of the contact that each reads; None where it reads another thing
    contact: float  # duration of the longest contact [s]
    peak: float  # largest predicted reading, SI
    channels: Sequence[str] = ()  # what each series reads; of one channel where none are named

    @property
    def deepest(self) -> float:
        """Greatest depth of its motions [m]; 0 of none."""
        return max((float(held.motion.depth.max()) for held in self.motions if held), default=0.0)

    @property
    def peaks(self) -> list[float]:
        """By series the largest predicted reading of its channel."""
        names = self.channels or [""] * len(self.series)
        every = [float(np.abs(x).max()) for x in self.read]
        return [max(x for x, other in zip(every, names, strict=True) if other == name) for name in names]


def scene_of(model: Model, series: list[Series], readings: np.ndarray, point: np.ndarray | None) -> Scene:
    """The scene about an optimum; ``readings`` (E, C, T) are the predicted ones there. Without a point it has no motions."""
    flat, table = readings.reshape(-1), [] if point is None else params_at(model, point)
    motions: list[Held | None] = []
    known: dict[tuple[int, str], Motion | None] = {}
    places = [np.unravel_index(s.rows[0], readings.shape)[:2] for s in series]
    for s, (i, j) in zip(series, places, strict=True):
        part, _, what = model.channels[j].partition(".") if table else ("", "", "")
        names = list(model.scene.members) if table else []
        name = part if what == "normal" else names[0] if len(names) == 1 else ""
        offset = table[i]["time_offset"] if table else 0.0
        if name and (i, name) not in known:
            known[i, name] = _motion(model, int(i), table[i], name, s.clock - offset)
        motion = known.get((i, name))
        plain = np.array([1.0, 0.0, 0.0]) if what == "normal" else None
        follows = motion and (motion.follows(s.clock - offset, flat[s.rows]) if plain is None else plain)
        motions.append(Held(motion, offset, follows) if motion and follows is not None else None)
    read = [flat[s.rows] for s in series]
    if of_contacts(model):
        spans = [s.longest if np.isfinite(s.longest) and s.longest > 0 else float(np.ptp(s.clock)) for s in series]
    else:
        spans = [_passing(s.clock, x) for s, x in zip(series, read, strict=True)]
    size = int(model.data.values.size + model.data.features.size)
    peak = max((float(np.abs(x).max()) for x in read), default=0.0)
    channels = [model.channels[j] for _, j in places]
    return Scene(size, series, [int(i) for i, _ in places], read, motions, max(spans, default=0.0), peak, channels)


def _passing(clock: np.ndarray, seen: np.ndarray) -> float:
    """What stands for a contact's duration in a record without one [s]: 2/w with w = rms(f'')/rms(f') of the reading.

    w is about the highest frequency that the reading visibly carries. Priors of a tenth of 2/w and a hundredth of its square are
    then a bandwidth and a resonance of 5 w: a sensor is used up to a fifth of its resonance, where it errs by 4 %.
    """
    first = np.gradient(seen, clock)
    steep, bent = (float(np.sqrt(np.mean(x * x))) for x in (first, np.gradient(first, clock)))
    return min(2.0 * steep / bent if bent > 0.0 else np.inf, float(np.ptp(clock)))


def thinned(scene: Scene, most: int) -> Scene:
    """The scene with about ``most`` samples: whole contacts with what rings after them, and blocks of the rest."""
    if sum(s.rows.size for s in scene.series) <= most:
        return scene
    series, read = [], []
    for s, x in zip(scene.series, scene.read, strict=True):
        kept = _kept(s.touching, max(most // len(scene.series), 4 * _BLOCK))
        own = {name: getattr(s, name)[kept] for name in ("rows", "touching", "clock", "values", "weights")}
        series.append(s._replace(**own))
        read.append(x[kept])
    return scene._replace(series=series, read=read)


def _kept(touching: np.ndarray, most: int) -> np.ndarray:
    """Which samples of a series stay; contacts at even distances, each as far again as it is long."""
    spans = [(a, min(2 * b - a, touching.size)) for a, b in stretches(touching)]
    near = sum(b - a for a, b in spans)
    kept = np.zeros(touching.size, dtype=bool)
    for a, b in spans[:: max(1, -(-2 * near // most))]:
        kept[a : min(b, a + most)] = True
    apart = ~touching & ~kept
    every = max(1, -(-2 * int(apart.sum()) // most))
    return kept | (apart & (np.arange(touching.size) // _BLOCK % every == 0))


def _motion(model: Model, experiment: int, params: dict[str, float], name: str, clock: np.ndarray) -> Motion | None:
    first, last = max(float(clock[0]), 0.0), float(clock[-1])
    times = instants(model, experiment, params["time_offset"], first, max(last, first + 1e-9))
    run = ran(model, params, times)
    if name not in run.penetration or run.penetration[name].ndim != 1 or run.status != "ok":
        return None
    depth, rate, force = run.penetration[name], run.rate[name], run.force[name][:, 0]
    inside = (depth > _DEEP * depth.max()) & (force > 0.0)
    if inside.sum() < 8:
        return None
    d, v, f = depth[inside], rate[inside], force[inside]
    columns = np.stack([np.ones(d.size), np.log(d), v], axis=1)
    _, exponent, damping = np.linalg.lstsq(columns * f[:, None], np.log(f) * f, rcond=None)[0]
    touching = depth > 0.0
    shallow = np.maximum(depth, _DEEP * depth.max())
    tangent = np.stack([exponent * force / shallow, damping * force], axis=1) * touching[:, None]
    deepest = np.zeros(depth.size)
    for a, b in stretches(touching):
        deepest[a:b] = np.maximum.accumulate(depth[a:b])
    mass = _one_mass(times, rate, force)
    moves = _moves(times, tangent / mass) if mass else None
    return Motion(times, depth, rate, force, force * np.exp(-damping * rate), deepest, moves, tangent, mass)


def _one_mass(times: np.ndarray, rate: np.ndarray, force: np.ndarray) -> float:
    """m of d'' = g - F/m, by the impulse between instants; 0 where that does not hold."""
    step, change = np.diff(times), np.diff(rate)
    impulse = 0.5 * (force[1:] + force[:-1]) * step
    columns = np.stack([step, impulse], axis=1)
    slopes = np.linalg.lstsq(columns, change, rcond=None)[0]
    left = float(np.sum((change - columns @ slopes) ** 2))
    good = slopes[1] < 0.0 and left < (1.0 - _ONE_MASS) * float(np.sum(change**2))
    return float(-1.0 / slopes[1]) if good else 0.0


def _moves(times: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """(T - 1, 2, 2) of x'' = -(k x + c x')/m over each step, by the implicit midpoint rule."""
    step, (k, c) = np.diff(times), (0.5 * (tangent[1:] + tangent[:-1])).T
    system = np.zeros((step.size, 2, 2))
    system[:, 0, 1], system[:, 1, 0], system[:, 1, 1] = 1.0, -k, -c
    half = 0.5 * step[:, None, None] * system
    return np.linalg.solve(np.eye(2) - half, np.eye(2) + half)


def weight(scene: Scene, gravity: float) -> np.ndarray:
    """What a gravity [m/s^2] towards the surface adds to the residuals (N,) of single impacts; 0 where a record shows none.

    In contact the force beside is the weight: the contact force changes by k x + c x', an acceleration that a sensor on the
    body reads (free of gravity itself) by that over the mass. Before touch it is in the speed of approach.
    """

    def change(motion: Motion) -> np.ndarray:
        push = np.full(motion.times.size, -motion.mass * gravity)
        acting = (motion.depth > 0.0) & (motion.moves is not None)
        return np.outer(np.where(acting, motion.reply(push)[:, 0] - push, 0.0), [1.0, 0.0, 0.0])

    return _of_motion(scene, change)[:, 0]


def of_readings(scene: Scene, errors: list[np.ndarray]) -> np.ndarray:
    """Errors of every series' readings [SI], the same amplitude for all, as a column (N, 1)."""
    column = np.zeros((scene.size, 1))
    for s, error in zip(scene.series, errors, strict=True):
        column[s.rows, 0] = s.white(error)
    return column


def of_force(scene: Scene, force: Callable[[Motion], np.ndarray]) -> np.ndarray:
    """A force (T,) of each motion beside the predicted one, as a column (N, 1)."""
    return _of_motion(scene, lambda motion: motion.reply(force(motion)))


def _of_motion(scene: Scene, change: Callable[[Motion], np.ndarray]) -> np.ndarray:
    """Changes (T, 3) of each motion's force, depth and rate, as a column (N, 1) of readings."""
    errors = [np.zeros(s.rows.size) for s in scene.series]
    for k, (s, held) in enumerate(zip(scene.series, scene.motions, strict=True)):
        if held:
            moved = change(held.motion) @ held.follows
            errors[k] = np.interp(s.clock - held.offset, held.motion.times, moved, left=0.0)
    return of_readings(scene, errors)


def apart(columns: np.ndarray, series: Sequence[Series]) -> np.ndarray:
    """The part of each series by itself: (N, K) as (N, K times series)."""
    return np.hstack([part(columns, [s]) for s in series])


def part(columns: np.ndarray, series: Sequence[Series]) -> np.ndarray:
    """The rows of some series, of all columns; 0 elsewhere."""
    kept = np.zeros_like(columns)
    for s in series:
        kept[s.rows] = columns[s.rows]
    return kept


def shared_and_own(columns: np.ndarray, series: Sequence[Series]) -> np.ndarray:
    """(N, K), or (N, K + K E) of errors that E series share and have for themselves, each half of the variance."""
    return columns if len(series) < 2 else np.hstack([columns, apart(columns, series)]) * np.sqrt(0.5)
