"""Errors that may act: of the sensor, its clock, what was held fixed, the law; each with a signature and a prior.

A signature is an error of the prediction in deviations of the noise for a unit of its amplitude. The prior is the size that
the error has with 95 % if it acts; what is stated of an instrument (``calibration.instrument``) acts always, in full, once a
channel. What one record has for itself (its rest, drift, clock, speed) is a part that all records share and one of each, as
large. Four generic groups stand for what nobody listed. What estimates they leave: ``uncertainty.sets``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from scipy.ndimage import gaussian_filter1d

from bcfj_jax.core.quantities import CATALOGUE, GRAVITY
from calibration.diagnostics import law_errors, signatures
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series
from calibration.diagnostics.signatures import weight
from calibration.forward.model import Model, evaluation, predictions
from calibration.forward.runs import contacts, of_contacts
from calibration.instrument import Limit
from calibration.problem import OFFSETS, Problem
from calibration.search.refinement import End
from calibration.solver_budget import budget
from calibration.uncertainty.sets import QUANTILE, Error


class _Sensor(NamedTuple):
    """An error of a sensor: its unit, the amplitude that is called large, the nuisance that fits it, and what states it."""

    unit: str
    most: float
    nuisance: str
    key: str


# Of itself.
GAIN = 0.01
# Its amplitude is 1/w^2.
_RESONANCE = "resonance"
_SENSOR = {
    "gain": _Sensor("of itself", GAIN, "gain", "gain"),
    "bend of the gain": _Sensor("of the peak, at the peak", 0.05, "gain_bend", "nonlinearity"),
    "lag": _Sensor("of a contact's duration", 0.1, "bandwidth", "bandwidth"),
    _RESONANCE: _Sensor("of a contact's duration squared", 0.01, "resonance", "resonance"),
    "drift": _Sensor("of the peak, over the record", 0.05, "drift", "drift"),
    "rest": _Sensor("of the peak", 0.02, "force_offset", "zero"),
    "clock": _Sensor("of the time between samples", 0.5, "time_offset", "clock"),
}
# Step of a fixed value as a share of its tolerance, which is this share of it where none is stated.
_STEP, _SHARE = 1e-2, 0.01
# A share of the peak that is called a large error of the law.
_LAW = 0.05
# Constants, which are known.
_KNOWN = ("gravity",)
# Errors that every record has for itself, too.
_EACH = ("drift", "rest", "clock", "approach_speed")
# Shares of their priors with which errors always act: a record begins between two samples, and every sensor lags.
_THERE = {"clock": 0.4, "lag": 0.05}
# Of a contact's duration: delays of a sensor of first order, and widths of a low-pass without delay.
_LAGS, _WIDTHS = (0.01, 0.03, 0.1), (0.02, 0.06)
# Powers of the rate in another loss.
_LOSSES = (0.25, 0.5, 2.0)
# Generic groups: share of the peak, of a contact's duration, and of the force, with 95 %.
_WAVES, _BENT, _LAW_WAVES = 0.01, 0.01, 0.02
_GENERIC = ("a smooth disturbance in time", "a clock that bends", "a smooth factor of the force by its size")


def every(problem: Problem, at: Optimum) -> list[Error]:
    """Every error that may act."""
    model, best = at.model, at.end
    seen = contacts(model, best.point)
    deepest, peak = (max((getattr(c, key) for c in seen), default=0.0) for key in ("deepest", "peak"))
    longest = max((float(c.durations.max(initial=0.0)) for c in seen), default=0.0)
    law = law_errors.signatures(model, best.point, deepest, peak, longest)
    stated = frozenset(n for n in model.data.chain if all(n in e.fixed for e in at.experiments))
    readings = predictions(model, best.point)
    known = _instruments(at)
    found = [
        *of_sensor(model, readings, at.series, stated, known),
        *of_law(law),
        *of_fixed(model, best, _tolerances(problem, at), stated, at.series),
        *of_weight(model, best, at.series),
    ]
    # A rough cost has no linear answer that many waves would leave standing, and a motion costs seconds.
    if budget(model).rough or not any(s.rows.size > 3 and s.touching.any() for s in at.series):
        return found
    scene = signatures.scene_of(model, at.series, readings, best.point)
    slow = [1.0 / (2.0 * np.pi * own["bandwidth"].value * scene.contact) for _, own in known if "bandwidth" in own]
    slowest = max(slow) if len(slow) == len(known) else np.inf
    return [*found, *of_shape(model, scene, stated, slowest), *generic(scene)]


def _tolerances(problem: Problem, at: Optimum) -> dict[str, np.ndarray]:
    """What is said of fixed values by name and record (E,), SI; 0 where a record has its own value without a tolerance."""
    fitted, common = at.experiments, problem.tolerances
    names = dict.fromkeys((*common, *(name for e in fitted for name in e.tolerances)))
    return {
        n: np.array([e.tolerances.get(n, 0.0 if n in e.fixed else common.get(n, 0.0)) for e in fitted]) for n in names
    }


# Of each series the channel that it is of, and what is stated of its instrument.
_Known = Sequence[tuple[str, Mapping[str, Limit]]]


def _instruments(at: Optimum) -> _Known:
    found = []
    for s in at.series:
        i, j, _ = np.unravel_index(s.rows[0], at.model.data.values.shape)
        name = at.model.channels[j]
        own = {c.observes: c.instrument for c in at.experiments[int(i)].channels}
        found.append((name, own.get(name, {})))
    return found


def of_sensor(
    model: Model, readings: np.ndarray, series: list[Series], stated: frozenset[str], known: _Known = ()
) -> list[Error]:
    """Errors of the sensor, but for what is fitted and nuisances that are ``stated`` of every record; ``readings`` (E, C, T)
    are predicted.
    """
    taken = {axis.name for axis in model.coordinates} | stated
    taken |= {"force_offset"} if taken & set(OFFSETS.values()) else set()
    if not of_contacts(model):
        flat = readings.reshape(-1)
        series = [s._replace(longest=_passed(s.clock, flat[s.rows])) for s in series]
    found, known = _signatures(model, readings, series), known or [("", {}) for _ in series]
    errors = []
    for name, own in _SENSOR.items():
        rest = [s for s, (_, said) in zip(series, known, strict=True) if own.key not in said]
        signature = _part(found[name], rest)
        if own.nuisance not in taken and np.any(signature):
            errors.append(Error(name, own.unit, own.most, _own(name, signature, rest), floor=_THERE.get(name, 0.0)))
        if own.nuisance not in taken and len(rest) < len(series):
            errors += _as_stated(name, own, found[name], readings, series, known)
    return [*errors, *_steps(readings, series, known, found["gain"].size)]


def _passed(clock: np.ndarray, seen: np.ndarray) -> float:
    """What stands for a contact's duration in a record without one [s]: 2/w with w = rms(f'')/rms(f') of the reading.

    w is about the highest frequency that the reading visibly carries. Priors of a tenth of 2/w and a hundredth of its square are
    then a bandwidth and a resonance of 5 w: a sensor is used up to a fifth of its resonance, where it errs by 4 %.
    """
    first = np.gradient(seen, clock)
    steep, bent = (float(np.sqrt(np.mean(x * x))) for x in (first, np.gradient(first, clock)))
    return min(2.0 * steep / bent if bent > 0.0 else np.inf, float(np.ptp(clock)))


def _part(columns: np.ndarray, series: Sequence[Series]) -> np.ndarray:
    """The rows of some series, of all columns; 0 elsewhere."""
    part = np.zeros_like(columns)
    for s in series:
        part[s.rows] = columns[s.rows]
    return part


def _as_stated(
    name: str, own: _Sensor, signature: np.ndarray, readings: np.ndarray, series: list[Series], known: _Known
) -> list[Error]:
    """An error of which instruments say how large it is: no two channels share it."""
    flat, sizes = readings.reshape(-1), {}
    for k, (s, (_, said)) in enumerate(zip(series, known, strict=True)):
        if own.key in said and np.any(signature[s.rows]):
            sizes[k] = _amplitude(own.key, said[own.key], s, flat[s.rows])
    most, columns = max(sizes.values(), default=0.0), []
    if not most:
        return []
    for channel in dict.fromkeys(known[k][0] for k in sizes):
        of = [k for k in sizes if known[k][0] == channel]
        column = sum((_part(signature, [series[k]]) * (sizes[k] / most) for k in of), np.zeros_like(signature))
        columns.append(_own(name, column, [series[k] for k in of]))
    return [Error(f"{name}, as stated", own.unit, most, np.hstack(columns), floor=1.0)]


def _amplitude(key: str, limit: Limit, s: Series, seen: np.ndarray) -> float:
    """A stated size in the unit of an error's amplitude."""
    peak, duration, step = _scales(s, seen)
    late = 1.0 / (2.0 * np.pi * limit.value * duration) if key in ("bandwidth", "resonance") else 0.0
    plain = limit.value if limit.share else limit.value / max(peak, 1e-300)
    return {"bandwidth": late, "resonance": late**2, "clock": limit.value / step}.get(key, plain)


def _scales(s: Series, seen: np.ndarray) -> tuple[float, float, float]:
    """Peak of a series, duration of a contact, time between samples."""
    duration = s.longest if np.isfinite(s.longest) and s.longest > 0.0 else float(np.ptp(s.clock))
    return float(np.max(np.abs(seen))), duration, float(np.median(np.diff(s.clock)))


def _steps(readings: np.ndarray, series: list[Series], known: _Known, size: int) -> list[Error]:
    """Rounding to steps of q by its first harmonic, which has the variance q^2/12 and a phase that nobody knows."""
    flat, columns = readings.reshape(-1), np.zeros((size, 2))
    for s, (_, said) in zip(series, known, strict=True):
        if "resolution" in said and s.rows.size > 3:
            seen, limit = flat[s.rows], said["resolution"]
            step = limit.value * (float(np.max(np.abs(seen))) if limit.share else 1.0)
            for k, f in enumerate((np.sin, np.cos)):
                columns[s.rows, k] = (
                    s.white(QUANTILE * step / np.sqrt(12.0) * f(2.0 * np.pi * seen / step)) if step else 0.0
                )
    return [Error("resolution, as stated", "of its step", 1.0, columns, floor=1.0)] if columns.any() else []


def _own(name: str, signature: np.ndarray, series: list[Series]) -> np.ndarray:
    """(N, 1), or (N, 1 + E) of an error that E records share and have for themselves, each half of its variance."""
    if name not in _EACH or len(series) < 2:
        return signature[:, None]
    return np.hstack([signature[:, None], _apart(signature[:, None], series)]) * np.sqrt(0.5)


def _apart(columns: np.ndarray, series: Sequence[Series]) -> np.ndarray:
    """(N, K E): the part of each record by itself."""
    return np.hstack([_part(columns, [s]) for s in series])


def of_fixed(
    model: Model, best: End, tolerances: dict[str, np.ndarray], stated: frozenset[str], series: list[Series]
) -> list[Error]:
    """Errors of scene parameters that were held fixed, and of nuisances that were ``stated``, by runs with a little of each.

    Of a rough cost only those with a stated tolerance (``tolerances`` (E,) by name, SI): a motion of the joint costs seconds
    each.
    """
    point, found = np.asarray(best.point)[None], []
    free = {axis.name for axis in model.coordinates}
    plain = evaluation(model)(point).residuals[0]
    every = [("fixed", name) for name in model.data.fixed] + [
        ("chain", name) for name in model.data.chain if name in stated
    ]
    for table, name in every:
        own, known = np.asarray(getattr(model.data, table)[name], dtype=float), tolerances.get(name)
        # What may be 0, such as a place where a body starts, has no share of itself.
        own_range = None if name in CATALOGUE else model.scene.quantities.get(name)
        signed = own_range is not None and own_range.low < 0.0
        if name in free or name in _KNOWN or (known is None and (signed or budget(model).rough)):
            continue
        tolerance = _SHARE * np.abs(own) if known is None else known
        if not np.any(tolerance):
            continue
        moved = eqx.tree_at(lambda m, t=table, n=name: getattr(m.data, t)[n], model, own + _STEP * tolerance)
        change = (evaluation(moved)(point).residuals[0] - plain) / _STEP
        if np.isfinite(change).all():
            share = float(np.max(tolerance / np.where(own != 0.0, np.abs(own), np.inf)))
            unit, most = ("of itself", share) if share else ("of its tolerance", 1.0)
            found.append(Error(name, unit, most, _own(name, change / most, series)))
    return found


def of_weight(model: Model, best: End, series: list[Series]) -> list[Error]:
    """The weight of a body that strikes at a speed, of a scene that knows no gravity: as much of it as may act."""
    known = {axis.name for axis in model.coordinates} | model.data.fixed.keys()
    if "approach_speed" not in known or "gravity" in known or budget(model).rough:
        return []
    return [Error("gravity", f"of {GRAVITY} m/s^2", 1.0, weight(model, series, best.point, GRAVITY)[:, None])]


def of_law(signatures: dict[str, dict[str, np.ndarray]]) -> list[Error]:
    """Errors of the contact law (``law_errors.signatures``); two of one kind stand for one between them."""
    every = [item for found in signatures.values() for item in found.items()]
    return [Error(name, "of the peak", _LAW, signature[:, None]) for name, signature in every]


def of_shape(model: Model, scene: signatures.Scene, stated: frozenset[str], slowest: float = np.inf) -> list[Error]:
    """Finite delays and low-passes without delay, which the slope of a reading is not; losses of another power of the rate.

    Delays and widths are no longer than ``slowest``, of a contact, which a stated bandwidth lets pass.
    """
    found, taken = (
        [],
        {axis.name for axis in model.coordinates} | stated | ({"bandwidth"} if model.data.passed else set()),
    )
    if "bandwidth" not in taken:
        for share in (x for x in _LAGS if x <= slowest):
            column = signatures.first_order(scene, 1.0 / (2.0 * np.pi * share * scene.contact))
            found.append(Error(f"lag of {share:.0%} of a contact", "of itself", QUANTILE, column, "lag"))
        for share in (x for x in _WIDTHS if x <= slowest):
            smooth = [_smoothed(s, x, share * scene.contact) - x for s, x in zip(scene.series, scene.read, strict=True)]
            column = signatures.of_readings(scene, smooth)
            found.append(
                Error(f"low-pass of {share:.0%} of a contact", "of itself", 1.0, column, "low-pass without delay")
            )
    if any(scene.motions):
        columns = {f"loss as rate^{p:g}": signatures.loss(scene, p) for p in _LOSSES}
        columns["plasticity"] = signatures.plasticity(scene)
        peak = float(max(np.abs(s.white(x)).max() for s, x in zip(scene.series, scene.read, strict=True)))
        for name, column in columns.items():
            if size := float(np.abs(column).max()):
                found.append(Error(name, "of the peak", _LAW, column * (peak / size), "another loss"))
    return found


def _smoothed(s: Series, read: np.ndarray, width: float) -> np.ndarray:
    step = float(np.median(np.diff(s.clock)))
    return gaussian_filter1d(read, width / step, mode="nearest")


def generic(scene: signatures.Scene) -> list[Error]:
    """Waves in time, of the clock and of the force by depth, for what nobody listed; shared by records and of each."""
    series, read, peak = scene.series, scene.read, scene.peak
    phases = [(s.clock - s.clock[0]) / max(float(np.ptp(s.clock)), 1e-300) for s in series]
    slopes = [-np.gradient(x, s.clock) * scene.contact for s, x in zip(series, read, strict=True)]

    def waves(count: int, of: list[np.ndarray]) -> np.ndarray:
        shapes = [(f, np.pi * k) for k in range(1, count + 1) for f in (np.cos, np.sin)]
        columns = [
            signatures.of_readings(scene, [f(k * x) * own for x, own in zip(phases, of, strict=True)])
            for f, k in shapes
        ]
        found = np.hstack(columns)
        return found if len(series) < 2 else np.hstack([found, _apart(found, series)]) * np.sqrt(0.5)

    shapes: list[tuple[Callable, float]] = [(np.cos, np.pi * k) for k in (0.5, 1.0, 1.5, 2.0, 3.0)]
    shapes += [(np.sin, np.pi * k) for k in (0.5, 1.0, 2.0, 3.0)]
    by_size = [signatures.of_readings(scene, [x * f(k * x / peak) for x in read]) for f, k in shapes]
    found = [
        Error(_GENERIC[0], "of the peak", _WAVES, waves(4, [np.full(x.size, peak) for x in read])),
        Error(_GENERIC[1], "of a contact's duration", _BENT, waves(3, slopes)),
        Error(_GENERIC[2], "of itself", _LAW_WAVES, np.hstack(by_size)),
    ]
    deepest = max((float(held[0].depth.max()) for held in scene.motions if held), default=0.0)
    if deepest > 0.0:
        forces = [
            [held and held[0].elastic * f(k * held[0].depth.clip(0.0) / deepest) for held in scene.motions]
            for f, k in shapes
        ]
        columns = np.hstack([signatures.of_force(scene, force) for force in forces])
        found.append(Error("a smooth factor of the force by depth", "of itself", _LAW_WAVES, columns))
    return found


def _signatures(model: Model, readings: np.ndarray, series: list[Series]) -> dict[str, np.ndarray]:
    """Errors of the sensor (N,) in deviations of the noise, a unit of each, freed of the noise's memory."""
    size = model.data.values.size + model.data.features.size
    found = {name: np.zeros(size) for name in _SENSOR}
    flat = readings.reshape(-1)
    for s in series:
        if s.rows.size < 4 or not s.touching.any():
            continue
        seen, clock = flat[s.rows], s.clock
        (peak, duration, step), first = _scales(s, seen), np.gradient(seen, clock)
        errors = {
            "gain": seen,
            "bend of the gain": seen * np.abs(seen) / max(peak, 1e-300),
            "lag": -duration * first,
            _RESONANCE: -(duration**2) * np.gradient(first, clock),
            "drift": peak * (clock - clock.mean()) / max(float(np.ptp(clock)), 1e-300),
            "rest": np.full(clock.size, peak),
            "clock": -step * first,
        }
        for name, error in errors.items():
            found[name][s.rows] = s.white(error)
    return found
