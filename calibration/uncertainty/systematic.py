"""Errors that may act about an optimum, each with a signature and a prior; what estimates they leave: ``uncertainty.sets``.

Those of sensor and law are of ``diagnostics.catalogue``; beside them what was held fixed, and the weight. A signature is an
error of the prediction in deviations of the noise for a unit of its amplitude. The prior is the size that the error has with
95 % if it acts; what is stated of an instrument (``calibration.instrument``) acts always, in full, once a channel. What one
record has for itself (its rest, drift, clock, speed) is a part that all records share and one of each, as large.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import equinox as eqx
import numpy as np

from bcfj_jax.core.quantities import CATALOGUE, GRAVITY
from calibration.diagnostics import signatures
from calibration.diagnostics.catalogue import ACTS, QUANTILE, SENSOR, SHAPES, Sensor, step_of
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.diagnostics.signatures import Scene, part, shared_and_own, weight
from calibration.forward.model import Model, evaluation, predictions
from calibration.instrument import Limit
from calibration.problem import OFFSETS, Problem
from calibration.search.refinement import End
from calibration.solver_budget import budget
from calibration.uncertainty.sets import Error

# Step of a fixed value as a share of its tolerance, which is this share of it where none is stated: of gravity what places
# at sea level differ by, 9.780 m/s^2 at the equator and 9.832 at the poles (WGS 84).
_STEP, _SHARE, _GRAVITY = 1e-2, 0.01, 0.003


def every(problem: Problem, at: Optimum, moved: np.ndarray | None = None) -> list[Error]:
    """Every error that may act; what an error of the law does is told by the motion of a point ``moved`` (P,), where given."""
    model, best, rough = at.model, at.end, budget(at.model).rough
    free = {axis.name for axis in model.coordinates}
    stated = frozenset(n for n in model.data.chain if all(n in e.fixed for e in at.experiments))
    places = [np.unravel_index(s.rows[0], model.data.values.shape)[:2] for s in at.series]
    said = [{c.observes: c.instrument for c in e.channels} for e in at.experiments]
    taken, known = free | stated, [said[i].get(model.channels[j], {}) for i, j in places]
    taken |= {"force_offset"} if taken & set(OFFSETS.values()) else set()
    # Of a rough cost a motion costs seconds, and it has no linear answer that many waves would leave standing.
    motion = None if rough else best.point if moved is None else moved
    scene = signatures.scene_of(model, at.series, predictions(model, best.point), motion)
    sensor = of_sensor(scene, taken, known)
    if model.data.passed:  # The stated filter is the lag that every sensor has; another acts as other errors do.
        sensor = [e._replace(chance=min(e.chance, ACTS)) for e in sensor]
    found = [*sensor, *of_fixed(model, best, _tolerances(problem, at), stated, at.series)]
    fixed = free | model.data.fixed.keys()
    if rough or not any(_shows(s) for s in at.series):
        return found
    if "approach_speed" in fixed and "gravity" not in fixed:  # A body strikes at a speed, in a scene without weight.
        found.append(Error("gravity", f"of {GRAVITY} m/s^2", 1.0, weight(scene, GRAVITY)[:, None]))
    slow = [1.0 / (2.0 * np.pi * own["bandwidth"].value) for own in known if "bandwidth" in own]
    slowest = max(slow) if len(slow) == len(known) else np.inf
    return [*found, *of_shape(scene, taken | ({"bandwidth"} if model.data.passed else set()), slowest)]


def _shows(s: Series) -> bool:
    """Whether a series has a contact, and samples of it."""
    return bool(s.rows.size > 3 and s.touching.any())


def _tolerances(problem: Problem, at: Optimum) -> dict[str, np.ndarray]:
    """What is said of fixed values by name and record (E,), SI; 0 where a record has its own value without a tolerance."""
    fitted, common = at.experiments, problem.tolerances
    names = dict.fromkeys((*common, *(name for e in fitted for name in e.tolerances)))
    return {
        n: np.array([e.tolerances.get(n, 0.0 if n in e.fixed else common.get(n, 0.0)) for e in fitted]) for n in names
    }


# Of each series what is stated of its instrument.
_Known = Sequence[Mapping[str, Limit]]


def of_sensor(scene: Scene, taken: Collection[str], known: _Known = ()) -> list[Error]:
    """Errors of the sensor, but for nuisances that are ``taken``: fitted, or stated of every record."""
    known, every = known or [{} for _ in scene.series], []
    for name, own in SENSOR.items():
        if own.nuisance in taken:
            continue
        column = of_channels(scene, own)
        rest = [s for s, said in zip(scene.series, known, strict=True) if own.key not in said]
        if np.any(columns := _of(own, column, rest)):
            every.append(Error(name, own.unit, own.most, columns, sign=own.sign, chance=own.chance))
        every += _as_stated(name, own, column, scene, known) if len(rest) < len(scene.series) else []
    return [*every, *_steps(scene, known)]


def of_channels(scene: Scene, own: Sensor) -> np.ndarray:
    """A unit of an error of the sensor (N, 1), in series that have a contact."""
    read = zip(scene.series, scene.read, np.maximum(scene.peaks, 1e-300), strict=True)
    errors = [own.adds(s, x, peak, scene.contact) if _shows(s) else np.zeros(x.size) for s, x, peak in read]
    return signatures.of_readings(scene, errors)


def _of(own: Sensor, column: np.ndarray, series: list[Series]) -> np.ndarray:
    """The columns of an error in some series."""
    signature = part(column, series)
    return shared_and_own(signature, series) if own.own else signature


def _as_stated(name: str, own: Sensor, column: np.ndarray, scene: Scene, known: _Known) -> list[Error]:
    """An error of which instruments say how large it is: no two channels share it."""
    sized, most, by_channel = np.zeros_like(column), 0.0, dict[str, list[Series]]()
    for s, said, peak, channel in zip(scene.series, known, scene.peaks, scene.channels, strict=True):
        if own.key in said and np.any(column[s.rows]):
            size = _amplitude(own.key, said[own.key], s, peak, scene.contact)
            sized[s.rows], most = size * column[s.rows], max(most, size)
            by_channel.setdefault(channel, []).append(s)
    if not most:
        return []
    columns = np.hstack([_of(own, sized / most, series) for series in by_channel.values()])
    return [Error(f"{name}, as stated", own.unit, most, columns, stated=True)]


def _amplitude(key: str, limit: Limit, s: Series, peak: float, duration: float) -> float:
    """A stated size in the unit of an error's amplitude."""
    late = 1.0 / (2.0 * np.pi * limit.value * duration) if key in ("bandwidth", "resonance") else 0.0
    plain = limit.value if limit.share else limit.value / max(peak, 1e-300)
    return {"bandwidth": late, "resonance": late**2, "clock": limit.value / step_of(s)}.get(key, plain)


def _steps(scene: Scene, known: _Known) -> list[Error]:
    """Rounding to steps of q by its first harmonic, which has the variance q^2/12 and a phase that nobody knows."""
    said = [(own.get("resolution", Limit(0.0)), peak) for own, peak in zip(known, scene.peaks, strict=True)]
    steps = [limit.value * (peak if limit.share else 1.0) for limit, peak in said]
    if not any(steps):
        return []
    read = list(zip(scene.read, steps, strict=True))
    waves = [[f(2.0 * np.pi * x / (q or 1.0)) * q for x, q in read] for f in (np.sin, np.cos)]
    columns = np.hstack([signatures.of_readings(scene, wave) for wave in waves]) * QUANTILE / np.sqrt(12.0)
    return [Error("resolution, as stated", "of its step", 1.0, columns, stated=True)]


def of_fixed(
    model: Model, best: End, tolerances: dict[str, np.ndarray], stated: frozenset[str], series: list[Series]
) -> list[Error]:
    """Errors of scene parameters that were held fixed, and of nuisances that were ``stated``, by runs with a little of each.

    Of a rough cost only those with a stated tolerance (``tolerances`` (E,) by name, SI): a motion of the joint costs seconds
    each.
    """
    point, found = np.asarray(best.point)[None], []
    free, ranges = {axis.name for axis in model.coordinates}, model.scene.quantities
    plain = evaluation(model)(point).residuals[0]
    every = [("fixed", n) for n in model.data.fixed] + [("chain", n) for n in model.data.chain if n in stated]
    for table, name in every:
        own, known = np.asarray(getattr(model.data, table)[name], dtype=float), tolerances.get(name)
        # What may be 0, such as a place where a body starts, has no share of itself.
        signed = name not in CATALOGUE and name in ranges and ranges[name].low < 0.0
        if name in free or (known is None and (signed or budget(model).rough)):
            continue
        tolerance = (_GRAVITY if name == "gravity" else _SHARE) * np.abs(own) if known is None else known
        if not np.any(tolerance):
            if known is not None:  # An error that is known not to act.
                found.append(Error(name, "of itself", 0.0, np.zeros((plain.size, 1))))
            continue
        moved = eqx.tree_at(lambda m, t=table, n=name: getattr(m.data, t)[n], model, own + _STEP * tolerance)
        change = (evaluation(moved)(point).residuals[0] - plain) / _STEP
        if np.isfinite(change).all():
            share = float(np.max(tolerance / np.where(own != 0.0, np.abs(own), np.inf)))
            unit, most = ("of itself", share) if share else ("of its tolerance", 1.0)
            column = change[:, None] / most
            columns = shared_and_own(column, series) if name == "approach_speed" else column
            found.append(Error(name, unit, most, columns))
    return found


def of_shape(scene: Scene, taken: Collection[str], slowest: float = np.inf) -> list[Error]:
    """Errors with listed numbers, and those of what nobody listed.

    Delays and widths are no longer than ``slowest`` [s], which a stated bandwidth lets pass.
    """
    peak = float(max(np.abs(s.white(x)).max() for s, x in zip(scene.series, scene.read, strict=True)))
    found = []
    for shape in (e for e in SHAPES if not (e.nuisance and e.nuisance in taken) and (any(scene.motions) or not e.law)):
        listed = shape.listed(scene)
        # Those of a kind exclude each other and share their odds by that.
        chance = shape.chance / (shape.chance + (1.0 - shape.chance) * (1 if shape.kind else len(listed)))
        for name, numbers in listed.items():
            if shape.nuisance and numbers["time"] > slowest:
                continue
            column = shape.columns(scene, **numbers)
            size = float(np.abs(column).max())
            if size > 0.0:
                scaled = column * (peak / size) if shape.law else column
                found.append(Error(name, shape.unit, shape.most, scaled, shape.kind, sign=shape.sign, chance=chance))
    return found
