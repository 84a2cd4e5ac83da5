"""Errors of sensor and law that may act in any rig: what each adds to the readings, how large it may be, and its names.

The diagnosis asks which of them a record shows, numbers such as a frequency sought on a grid (``suspects``). The interval to
quote sums over sets of few, with numbers that are listed and priors (``uncertainty.systematic``): the size that an error has
with 95 % if it acts. Four generic groups stand for what nobody listed.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from calibration.diagnostics.residual_tests import Series
from calibration.diagnostics.signatures import Motion, Scene, apart, of_force, of_readings, shared_and_own
from calibration.forward.runs import stretches

LOSS = "loss depends on speed otherwise"
# Speeds of approach in a ratio below this are one speed.
_SPEEDS = 1.25
# Depths of a second contact as shares of the greatest: so close that runs of several speeds find one like theirs.
_DEPTHS = (0.2, 0.35, 0.5, 0.65, 0.8)
# Of a contact's duration: times of relaxation, delays of a sensor of first order, widths of a low-pass without delay.
_TIMES, _LAGS, _WIDTHS = (0.1, 0.5), (0.01, 0.03, 0.1), (0.02, 0.06)
# Powers of the rate in another loss.
_LOSSES = (0.25, 0.5, 2.0)
# Waves of the generic groups: of a record, and of a force by its size or depth.
_WAVES = [(f, np.pi * k) for k in range(1, 5) for f in (np.cos, np.sin)]
_BY_SIZE = [(np.cos, np.pi * k) for k in (0.5, 1.0, 1.5, 2.0, 3.0)] + [
    (np.sin, np.pi * k) for k in (0.5, 1.0, 2.0, 3.0)
]
# A share of the peak that is called a large error of the law; of itself, of a gain.
_LAW, GAIN = 0.05, 0.01
# Chance that an error acts, before the record is looked at; of a lag, which every sensor has; of a loss that is another.
ACTS, EVERYWHERE, SELDOM = 0.6, 0.97, 0.4
# Normal quantile that sizes of errors are stated with.
QUANTILE = 1.959964
Numbers = dict[str, float]


class Sensor(NamedTuple):
    """An error of a sensor, to first order."""

    # To a reading (n,) of a series, with the channel's peak and the longest contact's duration.
    adds: Callable[[Series, np.ndarray, float, float], np.ndarray]
    # unit, most: of its amplitude, and the size with 95 % if it acts.
    unit: str
    most: float
    nuisance: str  # of a problem that fits it
    key: str  # of an instrument that states it
    own: bool = False  # every record has it for itself, too
    sign: int = 0  # 1 where its amplitude cannot be negative
    chance: float = ACTS  # that it acts


def _slope(s: Series, read: np.ndarray) -> np.ndarray:
    return np.gradient(read, s.clock)


def step_of(s: Series) -> float:
    """Time between samples [s]."""
    return float(np.median(np.diff(s.clock)))


SENSOR = {
    "gain": Sensor(lambda s, x, peak, late: x, "of itself", GAIN, "gain", "gain"),
    "bend of the gain": Sensor(
        lambda s, x, peak, late: x * np.abs(x) / peak, "of the peak, at the peak", 0.05, "gain_bend", "nonlinearity"
    ),
    "lag": Sensor(
        lambda s, x, peak, late: -late * _slope(s, x),
        "of a contact's duration", 0.1, "bandwidth", "bandwidth", sign=1, chance=EVERYWHERE,
    ),
    # Its amplitude is 1/w^2.
    "resonance": Sensor(
        lambda s, x, peak, late: -(late**2) * _slope(s, _slope(s, x)),
        "of a contact's duration squared", 0.01, "resonance", "resonance", sign=1,
    ),
    "drift": Sensor(
        lambda s, x, peak, late: peak * (s.clock - s.clock.mean()) / max(float(np.ptp(s.clock)), 1e-300),
        "of the peak, over the record", 0.05, "drift", "drift", True,
    ),
    "rest": Sensor(lambda s, x, peak, late: np.full(x.size, peak), "of the peak", 0.02, "force_offset", "zero", True),
    "clock": Sensor(
        lambda s, x, peak, late: -step_of(s) * _slope(s, x), "of the time between samples", 0.5, "time_offset", "clock", True
    ),
}  # fmt: skip


class Shape(NamedTuple):
    """An error with numbers that say what it looks like."""

    columns: Callable[..., np.ndarray]  # (N, K) of a scene and its numbers, a unit of it
    # unit, most: as of Sensor; of an error of the law a unit moves readings by the peak.
    unit: str = ""
    most: float = 0.0
    # Numbers by name, which intervals allow for and which share the odds of acting; those of a ``kind`` exclude each
    # other.
    listed: Callable[[Scene], dict[str, Numbers]] = lambda scene: {}
    kind: str = ""
    suspect: str = ""  # its name in the diagnosis, "" for none there
    sought: Callable[[Scene], dict[str, np.ndarray]] = lambda scene: {}  # its numbers on a grid
    given: bool = False  # whether its amplitude is 1, the numbers alone saying how large it is
    # sign, chance: as of Sensor, the chance of all that is listed.
    sign: int = 0
    amplitude: str = ""  # its name, where that is one number
    law: bool = False
    nuisance: str = ""  # of a problem that fits it, or knows it of a record
    chance: float = ACTS


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
        read = weight * _followed(keep, push, complex(x[0]))
        errors.append((read.imag if isinstance(rate, complex) else read.real) - x)
    return of_readings(scene, errors)


def _followed(keep: np.ndarray, push: np.ndarray, first: complex) -> np.ndarray:
    """(N + 1,) of u_n+1 = keep_n u_n + push_n from the first on."""
    moves = zip(keep.tolist(), push.tolist(), strict=True)
    return np.array(list(accumulate(moves, lambda last, move: move[0] * last + move[1], initial=first)))


def _smoothed(scene: Scene, time: float) -> np.ndarray:
    """Of a low-pass without delay, a Gaussian of this deviation [s]."""
    read = zip(scene.series, scene.read, strict=True)
    return of_readings(scene, [gaussian_filter1d(x, time / step_of(s), mode="nearest") - x for s, x in read])


def _each(scene: Scene, adds: Callable[[Series, np.ndarray], np.ndarray]) -> np.ndarray:
    """(N, series) of what every series has with an amplitude of its own."""
    return apart(of_readings(scene, [adds(s, x) for s, x in zip(scene.series, scene.read, strict=True)]), scene.series)


def _hum(scene: Scene, hum_frequency: float) -> np.ndarray:
    """Of a hum's sine and cosine, in every record others."""
    waves = [lambda s, x, f=f: f(2.0 * np.pi * hum_frequency * s.clock) for f in (np.sin, np.cos)]
    return np.hstack([_each(scene, wave) for wave in waves])


# Of the law.


def _stop(scene: Scene, bottoming_penetration: float) -> np.ndarray:
    """Of a second contact of 1 N/m from a depth [m] on."""
    return of_force(scene, lambda m: np.maximum(m.depth - bottoming_penetration, 0.0))


def _relaxation(scene: Scene, relaxation_time: float) -> np.ndarray:
    """Of a Maxwell branch s' = f' - s/time as stiff as the contact itself, f its elastic force."""
    return of_force(scene, lambda m: _branch(m, relaxation_time))


def _branch(motion: Motion, time: float) -> np.ndarray:
    kept = np.exp(-np.diff(motion.times) / time)
    grown = np.diff(motion.elastic) * np.exp(-0.5 * np.diff(motion.times) / time)
    touching = motion.depth[1:] > 0.0
    return _followed(touching * kept, touching * grown, 0.0)


def _loss(scene: Scene, loss_exponent: float) -> np.ndarray:
    """Of a loss f |d'|^p sign(d') beside the law's, f its elastic force: of the energy a share that goes as v^p."""
    return of_force(scene, lambda m: m.elastic * np.sign(m.rate) * np.abs(m.rate) ** loss_exponent)


# Of what nobody listed.


def _waves(scene: Scene, count: int, of: list[np.ndarray], own: bool) -> np.ndarray:
    """Waves over each record of what readings are multiplied by; records share them, or have their ``own`` beside."""
    phases = [(s.clock - s.clock[0]) / max(float(np.ptp(s.clock)), 1e-300) for s in scene.series]
    every = [[f(k * x) * y for x, y in zip(phases, of, strict=True)] for f, k in _WAVES[: 2 * count]]
    shared = np.hstack([of_readings(scene, one) for one in every])
    return shared_and_own(shared, scene.series) if own else shared


def _bent_clock(scene: Scene, own: bool) -> np.ndarray:
    slopes = [-_slope(s, x) * scene.contact for s, x in zip(scene.series, scene.read, strict=True)]
    return _waves(scene, 3, slopes, own)


def _of_records(scene: Scene, name: str) -> dict[str, Numbers]:
    """One amplitude of what all records share, which may be large, and one of what each has: a size is of both else."""
    each: dict[str, Numbers] = {f"{name}, of each record": {"own": True}} if len(scene.series) > 1 else {}
    return {name: {"own": False}, **each}


def _factor_by_size(scene: Scene) -> np.ndarray:
    return np.hstack([of_readings(scene, [x * f(k * x / scene.peak) for x in scene.read]) for f, k in _BY_SIZE])


def _factor_by_depth(scene: Scene) -> np.ndarray:
    deepest = scene.deepest
    shapes = [lambda m, f=f, k=k: m.elastic * f(k * m.depth.clip(0.0) / deepest) for f, k in _BY_SIZE]
    return np.hstack([of_force(scene, shape) for shape in shapes])


# Numbers on a grid.


def _nyquist(scene: Scene) -> float:
    step = float(np.median(np.concatenate([np.diff(s.clock) for s in scene.series if s.clock.size > 1])))
    return max(0.5 / step, 4.0 / scene.contact)


def _resonances(scene: Scene) -> dict[str, np.ndarray]:
    return {
        "resonance": np.geomspace(1.0 / scene.contact, _nyquist(scene), 48),
        "resonance_damping": np.array([0.01, 0.05, 0.15, 0.4]),
    }


def _hums(scene: Scene) -> dict[str, np.ndarray]:
    """From one period in the longest record on, four points in what a record tells apart."""
    span, highest = max(float(np.ptp(s.clock)) for s in scene.series), _nyquist(scene)
    return {"hum_frequency": np.linspace(1.0 / span, highest, int(np.clip(2.0 * span * highest, 8, 600)))}


def _powers(scene: Scene) -> dict[str, np.ndarray]:
    """Of the rate in the force of a loss; none where contacts begin at one speed, which shows no dependence on it."""
    motions = [held.motion for held in scene.motions if held]
    speeds = np.array([abs(m.rate[first]) for m in motions for first, _ in stretches(m.depth > 0.0)])
    speeds = speeds[speeds > 0.0]
    differ = speeds.size > 1 and speeds.max() > _SPEEDS * speeds.min()
    return {"loss_exponent": np.geomspace(0.05, 3.0, 12) if differ else np.zeros(0)}


SHAPES = (
    Shape(
        first_order, suspect="bandwidth", nuisance="bandwidth", given=True,
        sought=lambda x: {"bandwidth": np.geomspace(0.3, 50.0, 30) / x.contact},
    ),
    Shape(
        lambda x, time: first_order(x, 1.0 / (2.0 * np.pi * time)),
        "of itself", QUANTILE, kind="lag", nuisance="bandwidth", sign=1,
        listed=lambda x: {f"lag of {t:.0%} of a contact": {"time": t * x.contact} for t in _LAGS},
    ),
    Shape(
        _smoothed, "of itself", 1.0, kind="low-pass without delay", nuisance="bandwidth", sign=1,
        listed=lambda x: {f"low-pass of {t:.0%} of a contact": {"time": t * x.contact} for t in _WIDTHS},
    ),
    Shape(second_order, suspect="resonance", nuisance="resonance", sought=_resonances, given=True),
    Shape(_hum, suspect="hum", nuisance="hum_frequency", sought=_hums),
    Shape(lambda x: _each(x, lambda s, read: s.clock), suspect="drift", nuisance="drift"),
    Shape(lambda x: _each(x, lambda s, read: -_slope(s, read)), suspect="clock offset", nuisance="time_offset"),
    Shape(lambda x: _each(x, lambda s, read: np.ones(read.size)), suspect="offset", nuisance="force_offset"),
    Shape(
        lambda x: of_readings(x, [r * np.abs(r) for r in x.read]),
        suspect="gain bend", nuisance="gain_bend", amplitude="gain_bend",
    ),
    Shape(
        _stop, "of the peak", _LAW, suspect="stop", sign=1, amplitude="bottoming_stiffness", law=True,
        listed=lambda x: {
            f"second contact behind {s:.0%} of the depth": {"bottoming_penetration": s * x.deepest} for s in _DEPTHS
        },
        sought=lambda x: {"bottoming_penetration": x.deepest * np.linspace(0.3, 0.96, 23)} if x.deepest > 0.0 else {},
    ),
    Shape(
        _relaxation, "of the peak", _LAW, suspect="relaxation", sign=1, amplitude="relaxation", law=True,
        listed=lambda x: {f"relaxation within {t:.0%} of a contact": {"relaxation_time": t * x.contact} for t in _TIMES},
        sought=lambda x: {"relaxation_time": np.geomspace(0.02, 3.0, 16) * x.contact},
    ),
    # An unloading that falls by 1 N/m more steeply than the loading rose.
    Shape(
        lambda x: of_force(x, lambda m: m.depth.clip(0.0) - m.deepest), "of the peak", _LAW,
        kind="another loss", listed=lambda x: {"plasticity": {}}, suspect="plasticity", sign=1, law=True, chance=SELDOM,
    ),
    Shape(
        _loss, "of the peak", _LAW, kind="another loss", suspect=LOSS, sought=_powers, law=True, chance=SELDOM,
        listed=lambda x: {f"loss as rate^{p:g}": {"loss_exponent": p} for p in _LOSSES},
    ),
    Shape(
        lambda x, own: _waves(x, 4, [np.full(r.size, x.peak) for r in x.read], own), "of the peak", 0.01,
        kind="disturbance", listed=lambda x: _of_records(x, "a smooth disturbance in time"),
    ),
    Shape(
        _bent_clock, "of a contact's duration", 0.01,
        kind="bent clock", listed=lambda x: _of_records(x, "a clock that bends"),
    ),
    Shape(_factor_by_size, "of itself", 0.02, listed=lambda x: {"a smooth factor of the force by its size": {}}),
    Shape(
        _factor_by_depth, "of itself", 0.02,
        listed=lambda x: {"a smooth factor of the force by depth": {}} if x.deepest > 0.0 else {},
    ),
)  # fmt: skip
SUSPECTS = {shape.suspect: shape for shape in SHAPES if shape.suspect}
