"""How far into a record to fit: contacts found in the data, and a model that ends after some of them.

A fit of many contacts at once traps: where a contact is predicted beside the measured one, no small change of a
parameter improves the residual. Fitted contact by contact, each stage predicts the next arrival well enough.
"""

from __future__ import annotations

import equinox as eqx
import numpy as np

from calibration.attitudes import attitudes
from calibration.forward.model import Model

# A contact rises above the rest level by so many deviations of the noise, or this share of the peak if that is more.
_SIGMAS, _SHARE = 5.0, 0.02
# Contacts lie apart by more quiet samples than this: fewer are noise or a force that dips.
_QUIET = 3
# A step so many times as long as the usual one is a gap.
_GAP = 10.0
# Readings that a contact makes pulse, beside normal forces.
_PULSING = ("axial", "tangential", "force", "acceleration")
# Contacts are met where the residuals hold less than this share of the data's own energy: they overlap by most.
_MET = 0.2
# Of a body that tumbles shares of a record: on which face it falls hangs on all contacts before.
_SHARES = (0.25, 0.5)


def contacts(values: np.ndarray, sigma: float) -> list[tuple[int, int]]:
    """First and last sample of each contact in a record (T,), in order: values positive in contact, without gaps, of noise
    ``sigma``.
    """
    rise = values - np.percentile(values, 10)
    peak = float(rise.max(initial=0.0))
    above = np.flatnonzero(rise > min(max(_SIGMAS * sigma, _SHARE * peak), 0.5 * peak))
    if not above.size:
        return []
    breaks = np.flatnonzero(np.diff(above) > _QUIET + 1)
    firsts, lasts = above[np.r_[0, breaks + 1]], above[np.r_[breaks, above.size - 1]]
    return [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True)]


def _rise(name: str, values: np.ndarray) -> np.ndarray:
    """How far readings (..., T) are above rest: of a normal force, which can only push; on either side of it of others."""
    if name.endswith(".normal"):
        return values - np.nanpercentile(values, 10, axis=-1, keepdims=True)
    return np.abs(values - np.nanmedian(values, axis=-1, keepdims=True))


def _at_rest(values: np.ndarray) -> float:
    """Deviation of the noise of readings (T,) by the steps between neighbours in their lower half."""
    low = values <= np.median(values)
    steps = np.abs(np.diff(values))[low[1:] & low[:-1]]
    return 1.4826 / np.sqrt(2.0) * float(np.median(steps)) if steps.size else 0.0


def _pulses(model: Model) -> list[int]:
    """Which readings show contacts as pulses: normal forces, or else others that contacts make pulse."""
    normal = [j for j, name in enumerate(model.channels) if name.endswith(".normal")]
    return normal or [j for j, name in enumerate(model.channels) if name.split(".")[1] in _PULSING]


def tumbles(model: Model) -> bool:
    """Whether a body's attitude is fitted, and no pulse: where it goes after some contacts hangs on all of them."""
    return not _pulses(model) and bool(attitudes(model.channels))


def stages(model: Model) -> list[np.ndarray]:
    """Ends of the data (E,) [s] to fit one after the other: the 1st contact, all before the 3rd, the 5th, ..., all.

    An experiment's contacts are those of the normal force that has most, or of another reading that contacts make pulse. Of
    the flight after the first, only as much is fitted as the contact took. Of an attitude without such a reading, a quarter
    and half of the time stand for contacts. Where each instant is solved for itself, all is the only stage.
    """
    if not model.scene.traits.history:
        return [np.asarray(model.data.times)[:, -1]]
    times, values, weights = (np.asarray(a) for a in (model.data.times, model.data.values, model.data.weights))
    pulsing, tumbling, ends = _pulses(model), tumbles(model), []
    for i in range(len(times)):
        clock = times[i][(weights[i] > 0).any(axis=0)]
        most = [clock[0] + x * np.ptp(clock) for x in _SHARES] if tumbling and clock.size else list[float]()
        for j in pulsing:
            seen = weights[i, j] > 0
            if np.any(seen):
                rise = _rise(model.channels[j], values[i, j][seen])
                # Noise that is to be estimated may be larger than the 1 % that is assumed until then.
                found = contacts(rise, max(1.0 / float(weights[i, j][seen].min()), _at_rest(rise)))
                # The last quiet sample: that nothing has arrived by then is known, too.
                clock = times[i][seen]
                quiet = [float(clock[first - 1]) for first, _ in found[1:]]
                if quiet:
                    first, last = found[0]
                    quiet[0] = min(quiet[0], float(2.0 * clock[last] - clock[first]))
                most = max(most, quiet, key=len)
        ends.append([*most, float(times[i, -1])])
    longest = max(len(e) for e in ends)
    counts = [2**k for k in range(32) if 2**k < longest]
    return [np.array([e[min(n, len(e)) - 1] for e in ends]) for n in [*counts, longest]]


def until(model: Model, ends: np.ndarray) -> Model:
    """The same model with the data after ``ends`` (E,) [s] left out; integration stops there.

    Shapes stay, so no program is compiled again. What is left out reads the beginning; of a filtered record, whose
    times must grow, the end.
    """
    times, last = model.data.times, ends[:, None]
    inside = times <= last
    weights = np.where(inside[:, None, :], model.data.weights, 0.0)
    read = np.where(inside, times, last if model.parts else 0.0)
    return eqx.tree_at(lambda m: (m.data.times, m.data.weights), model, (read, weights))


def meets(model: Model, residuals: np.ndarray, ends: list[np.ndarray]) -> np.ndarray:
    """Whether weighted residuals (B, N) meet the contacts that each stage adds, (B, stages)."""
    times, values, weights = (np.asarray(a) for a in (model.data.times, model.data.values, model.data.weights))
    seen = weights > 0
    known = np.where(seen, values, np.where(seen.any(axis=2, keepdims=True), np.nan, 0.0))
    rise = np.stack([_rise(name, known[:, j]) for j, name in enumerate(model.channels)], axis=1)
    data = np.square(weights * np.where(seen, rise, 0.0))
    errors = np.square(residuals[:, : weights.size].reshape(-1, *weights.shape))
    firsts = [np.full(len(times), -np.inf), *ends[:-1]]
    met = []
    for first, last in zip(firsts, ends, strict=True):
        own = ((times > first[:, None]) & (times <= last[:, None]))[:, None, :] & seen
        met.append(np.sum(errors * own, axis=(1, 2, 3)) < _MET * np.sum(data * own))
    return np.stack(met, axis=1)


def impulses(model: Model, residuals: np.ndarray) -> np.ndarray:
    """Running sums over time of weighted residuals (B, N) or their Jacobians (B, N, P): errors of the impulse so far.

    A contact predicted too late leaves an impulse missing for as long as it is late, so the sum of squares falls all the way
    to the right arrival, where that of the forces is flat. Residuals that are of no history stay.
    """
    shape = model.data.weights.shape
    count = int(np.prod(shape))
    steps = np.diff(np.asarray(model.data.times), axis=1, append=np.nan)
    steps[:, -1] = steps[:, -2] if steps.shape[1] > 1 else 1.0
    # A model that ends early repeats a time. Across a gap in the record nothing is known.
    usual = np.array([np.median(row[row > 0.0]) if np.any(row > 0.0) else 1.0 for row in steps])[:, None]
    scale = np.clip(steps / usual, 0.0, _GAP)
    rest = residuals.shape[2:]
    histories = residuals[:, :count].reshape(len(residuals), *shape, *rest)
    scale = scale[None, :, None, :].reshape(1, shape[0], 1, shape[2], *[1] * len(rest))
    summed = np.cumsum(histories * scale, axis=3).reshape(len(residuals), count, *rest)
    return np.concatenate([summed, residuals[:, count:]], axis=1)
