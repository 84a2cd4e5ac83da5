"""What an imperfection of the sensor or of the law adds to a record, to first order about an optimum, in deviations of the
noise.

Of the sensor it follows from what is predicted; of the law it is a force f beside the predicted one, and what the motion
makes of it: m x'' = -(k x + c x' + f) changes the force by f + k x + c x', with the tangent k, c of F = K d^n exp(a d')
fitted to the predicted force, and m that of d'' = g - F/m: a contact of one mass. Where the motion is another, the force
alone is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_banded

from calibration.diagnostics.residual_tests import Series
from calibration.forward.model import Model
from calibration.forward.runs import instants, params_at, ran

# Samples of a block of flight that is kept where there are too many.
_BLOCK = 32
# A contact's tangent is fitted where its depth is above this share of the largest.
_DEEP = 0.02
# Share of the acceleration that one mass must explain.
_ONE_MASS = 0.98


class Motion(NamedTuple):
    """One contact's predicted motion in one record, and how a force beside it would change what is read.

    Attributes:
        times, depth, rate, force: (T,) of the model's clock; elastic: the force without its damping; deepest: largest depth since
            the contact began.
        moves: (T - 1, 2, 2) from one instant's small change to the next one's; None where the motion is not of one mass.
        tangent: (T, 2) k [N/m] and c [N s/m].
    """

    times: np.ndarray
    depth: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    elastic: np.ndarray
    deepest: np.ndarray
    moves: np.ndarray | None
    tangent: np.ndarray
    mass: float

    @property
    def begins(self) -> np.ndarray:
        """Where contacts begin: (T,)."""
        touching = self.depth > 0.0
        return touching & ~np.r_[False, touching[:-1]]

    def reply(self, force: np.ndarray) -> np.ndarray:
        """Change of the force for a force (T,) beside it [N]."""
        if self.moves is None:
            return force
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
        return force + np.sum(self.tangent * moved, axis=1)


class Scene(NamedTuple):
    """What signatures are made from.

    Attributes:
        size: N, residuals of the fit.
        series: residuals by record and channel; runs: the record of each; read: (n,) what is predicted of each, SI.
        motions: the contact that each reads, with the offset of its clock [s]; None where it reads another thing.
        contact: duration of the longest contact [s]; peak: largest predicted reading, SI.
    """

    size: int
    series: list[Series]
    runs: list[int]
    read: list[np.ndarray]
    motions: list[tuple[Motion, float] | None]
    contact: float
    peak: float


def scene_of(model: Model, series: list[Series], readings: np.ndarray, point: np.ndarray) -> Scene:
    """The scene about an optimum; ``readings`` (E, C, T) are the predicted ones there."""
    flat, table = readings.reshape(-1), params_at(model, point)
    motions: list[tuple[Motion, float] | None] = []
    runs: list[int] = []
    known: dict[tuple[int, str], Motion | None] = {}
    for s in series:
        i, j, _ = np.unravel_index(s.rows[0], readings.shape)
        runs.append(int(i))
        part, _, what = model.channels[j].partition(".")
        offset, key = table[i]["time_offset"], (int(i), part)
        if what == "normal" and key not in known:
            known[key] = _motion(model, int(i), table[i], part, s.clock - offset)
        own = known.get(key) if what == "normal" else None
        motions.append((own, offset) if own is not None else None)
    spans = [s.longest if np.isfinite(s.longest) and s.longest > 0 else float(np.ptp(s.clock)) for s in series]
    read = [flat[s.rows] for s in series]
    size = int(model.data.values.size + model.data.features.size)
    return Scene(size, series, runs, read, motions, max(spans), max(float(np.abs(x).max()) for x in read))


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
    edges = np.flatnonzero(np.diff(np.r_[False, touching, False].astype(int)))
    spans = [(a, min(2 * b - a, touching.size)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
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
    deepest, edges = np.zeros(depth.size), np.flatnonzero(np.diff(np.r_[False, touching, False].astype(int)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
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


def weight(model: Model, series: list[Series], point: np.ndarray, gravity: float) -> np.ndarray:
    """What a gravity [m/s^2] towards the surface adds to the residuals (N,) of single impacts; 0 where a record shows none.

    In contact the force beside is the weight: the contact force changes by k x + c x', an acceleration that a sensor on the
    body reads (free of gravity itself) by that over the mass. Before touch it is in the speed of approach.
    """
    table, shape = params_at(model, point), model.data.values.shape
    column, known = np.zeros(model.data.values.size + model.data.features.size), {}
    names = list(model.scene.members)
    for s in series:
        i, j, _ = np.unravel_index(s.rows[0], shape)
        part, _, what = model.channels[j].partition(".")
        felt = part if what == "normal" else names[0] if len(names) == 1 and what.startswith("acceleration") else ""
        offset = table[i]["time_offset"]
        if felt and i not in known:
            known[i] = _motion(model, int(i), table[i], felt, s.clock - offset)
        motion = known.get(i) if felt else None
        if motion is None or motion.moves is None:
            continue
        push = np.full(motion.times.size, -motion.mass * gravity)
        change = np.where(motion.depth > 0.0, motion.reply(push) - push, 0.0)
        read = change if what == "normal" else -change / motion.mass
        column[s.rows] = s.white(np.interp(s.clock - offset, motion.times, read, left=0.0))
    return column


def of_readings(scene: Scene, errors: list[np.ndarray]) -> np.ndarray:
    """Errors of every series' readings [SI], the same amplitude for all, as a column (N, 1)."""
    column = np.zeros((scene.size, 1))
    for s, error in zip(scene.series, errors, strict=True):
        column[s.rows, 0] = s.white(error)
    return column


def of_each(scene: Scene, errors: list[list[np.ndarray]]) -> np.ndarray:
    """Errors of which every series has amplitudes of its own: (N, series times errors)."""
    columns = np.zeros((scene.size, sum(len(own) for own in errors)))
    k = 0
    for s, own in zip(scene.series, errors, strict=True):
        for error in own:
            columns[s.rows, k] = s.white(error)
            k += 1
    return columns


def of_force(scene: Scene, forces: list[np.ndarray | None]) -> np.ndarray:
    """Forces beside the predicted ones, at each motion's times, as a column (N, 1)."""
    errors = []
    for s, held, force in zip(scene.series, scene.motions, forces, strict=True):
        if held is None or force is None:
            errors.append(np.zeros(s.rows.size))
            continue
        motion, offset = held
        errors.append(np.interp(s.clock - offset, motion.times, motion.reply(force), left=0.0))
    return of_readings(scene, errors)


# Of the sensor.


def first_order(scene: Scene, bandwidth: float) -> np.ndarray:
    """Of a first-order sensor, as large as its bandwidth [Hz] makes it."""
    return _filtered(scene, 2.0 * np.pi * bandwidth, 1.0)


def second_order(scene: Scene, resonance: float, resonance_damping: float) -> np.ndarray:
    """Of a second-order sensor, as large as its frequency [Hz] and damping make it."""
    s = np.sqrt(1.0 - resonance_damping**2)
    pole = complex(resonance_damping, s)
    return _filtered(scene, 2.0 * np.pi * resonance * pole.conjugate(), pole / s)


def _filtered(scene: Scene, rate: complex, weight: complex) -> np.ndarray:
    """Output of u' = rate (x - u) less its input x, linear between samples; the output is Im or Re of weight u."""
    errors = []
    for s, x in zip(scene.series, scene.read, strict=True):
        angle = rate * np.diff(s.clock)
        keep = np.exp(-angle)
        mean = -np.expm1(-angle) / angle
        push = (mean - keep) * x[:-1] + (1.0 - mean) * x[1:]
        out = list(accumulate(zip(keep.tolist(), push.tolist(), strict=True), _step, initial=complex(x[0])))
        read = weight * np.array(out)
        errors.append((read.imag if isinstance(rate, complex) else read.real) - x)
    return of_readings(scene, errors)


def _step(last: complex, move: tuple[complex, complex]) -> complex:
    return move[0] * last + move[1]


def gain_bend(scene: Scene) -> np.ndarray:
    """Of a gain that changes by 1 a unit of what is read."""
    return of_readings(scene, [x * np.abs(x) for x in scene.read])


# Errors of one series' reading and clock that every record has otherwise, a unit of each.
EACH: dict[str, Callable[[Series, np.ndarray], np.ndarray]] = {
    "drift": lambda s, read: s.clock,
    "clock offset": lambda s, read: -np.gradient(read, s.clock),
    "offset": lambda s, read: np.ones(s.clock.size),
}


def each(scene: Scene, name: str) -> np.ndarray:
    """Of one of ``EACH``."""
    return of_each(scene, [[EACH[name](s, x)] for s, x in zip(scene.series, scene.read, strict=True)])


def hum(scene: Scene, hum_frequency: float) -> np.ndarray:
    """Of a hum's sine and cosine, in every record others."""
    angles = [2.0 * np.pi * hum_frequency * s.clock for s in scene.series]
    return of_each(scene, [[np.sin(a), np.cos(a)] for a in angles])


# Of the law.


def stop(scene: Scene, bottoming_penetration: float) -> np.ndarray:
    """Of a second contact of 1 N/m from a depth [m] on."""
    return of_force(scene, [held and np.maximum(held[0].depth - bottoming_penetration, 0.0) for held in scene.motions])


def relaxation(scene: Scene, relaxation_time: float) -> np.ndarray:
    """Of a Maxwell branch s' = f' - s/time as stiff as the contact itself, f its elastic force."""
    return of_force(scene, [held and _branch(held[0], relaxation_time) for held in scene.motions])


def _branch(motion: Motion, time: float) -> np.ndarray:
    kept = np.exp(-np.diff(motion.times) / time)
    grown = np.diff(motion.elastic) * np.exp(-0.5 * np.diff(motion.times) / time)
    touching, stress = motion.depth > 0.0, np.zeros(motion.times.size)
    for n in range(kept.size):
        stress[n + 1] = touching[n + 1] * (kept[n] * stress[n] + grown[n])
    return stress


def plasticity(scene: Scene) -> np.ndarray:
    """Of an unloading that falls by 1 N/m more steeply than the loading rose."""
    return of_force(scene, [held and held[0].depth.clip(0.0) - held[0].deepest for held in scene.motions])


def loss(scene: Scene, loss_exponent: float) -> np.ndarray:
    """Of a loss f |d'|^p sign(d') beside the law's, f its elastic force: of the energy a share that goes as v^p."""
    return of_force(scene, [held and held[0].elastic * _power(held[0].rate, loss_exponent) for held in scene.motions])


def _power(rate: np.ndarray, exponent: float) -> np.ndarray:
    return np.sign(rate) * np.abs(rate) ** exponent
