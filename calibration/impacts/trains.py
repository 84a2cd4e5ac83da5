"""A record of a train of impacts as features of its contacts: when each was, how long, its peak and its impulse.

Times, peaks and impulses of numbered contacts change smoothly with the parameters, where samples of moving spikes do not.
With rest r, samples F_i, trapezoidal weights w_i [s] and white noise of deviation s, over the samples of one contact and its
margins (linear propagation of errors):

    J = sum w_i (F_i - r)                        s_J = s sqrt(sum w_i^2)
    c = sum w_i (F_i - r) t_i / J                s_c = s sqrt(sum w_i^2 (t_i - c)^2) / J
    w^2 = sum w_i (F_i - r) (t_i - c)^2 / J      s_w = s sqrt(sum w_i^2 ((t_i - c)^2 - w^2)^2) / (2 w J)
    peak: top of the least-squares polynomial of degree 6 through the samples above ``_TOP`` of the highest, with its deviation
(of degree 4 it would read K d^1.5 too low by 3e-4, of degree 6 by 1e-5). Every sum has an error of its own besides, from
samples that lie apart: a third of its difference to that over every second sample. These are the features ``impulse``,
``center``, ``width`` and ``peak`` (``names.EVENTS``). Begin and end are not among them: a force K d^n rises from 0 without
a mark, and where it leaves the noise says little of where it began.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bcfj_jax import InputError
from calibration.impacts.events import contacts, rest
from calibration.problem import Observation

# Samples about a contact that belong to it, as a share of its duration; and the fewest in it.
_MARGIN, _FEWEST = 0.15, 6
# Samples of the top; the fewest for a polynomial of degree 4, and of degree 6.
_TOP, _MANY, _MORE = 0.5, 8, 10


def observations(
    observes: str, times: np.ndarray, values: np.ndarray, sigma: float | None = None, relative: float = 0.0
) -> tuple[Observation, ...]:
    """Features of every contact that a record (T,) of a normal force, NaN where nothing was read, shows, from number 1.

    The record must begin before the first contact of the run. A contact that its end cuts is left out. The noise has a
    deviation [N], None for that of the samples apart from contacts, and a part that grows with the reading.
    """
    place, _, kind = observes.rpartition(".")
    where = f"events of {observes}"
    if kind != "normal":
        raise InputError(where, "is no normal force", 'observe "<contact>.normal"')
    seen = np.isfinite(values)
    t, f = np.asarray(times, dtype=float)[seen], np.asarray(values, dtype=float)[seen]
    found = contacts(observes, t, f)
    if not found:
        raise InputError(where, "the record shows no contact", "take samples, without events")
    level, spread = _rest(t, f, found)
    noise = spread if sigma is None else sigma
    rows: list[Observation] = []
    for number, event in enumerate(found, start=1):
        margin = max(_MARGIN * event.duration, 1.5 * event.step)
        first, last = np.searchsorted(t, (event.begin - margin, event.end + margin))
        if event.first == 0 or event.last >= t.size - 2:
            if number == 1 and event.first == 0:
                raise InputError(where, "the record begins in contact", "let it begin before the first contact")
            break
        if event.last - event.first + 1 < _FEWEST:
            remedy = "sample faster, or take samples without events"
            raise InputError(where, f"contact {number} has {event.last - event.first + 1} samples", remedy)
        own, above = t[first:last], f[first:last] - level
        scatter = np.hypot(noise, relative * np.abs(above))
        for name, (value, deviation) in {**_moments(own, above, scatter), "peak": _peak(own, above, scatter)}.items():
            rows.append(Observation(f"{place}.{name}_{number}", value, deviation))
    if not rows:
        raise InputError(where, "no contact lies within the record", "take samples, without events")
    return tuple(rows)


def _rest(t: np.ndarray, f: np.ndarray, found: list[Any]) -> tuple[float, float]:
    """Reading apart from contacts and its deviation."""
    apart = np.ones(t.size, dtype=bool)
    for event in found:
        apart &= (t < event.begin - event.duration) | (t > event.end + event.duration)
    if np.count_nonzero(apart) < _MANY:
        return rest(f) or 0.0, 0.0
    return float(np.mean(f[apart])), float(np.std(f[apart], ddof=1))


def _moments(t: np.ndarray, f: np.ndarray, noise: np.ndarray) -> dict[str, tuple[float, float]]:
    """Impulse, centre and width of samples (T,), each with its deviation."""

    def of(t: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gaps = np.diff(t)
        weights = 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps))
        impulse = float(weights @ f)
        center = float(weights @ (f * t)) / impulse
        square = float(weights @ (f * (t - center) ** 2)) / impulse
        return np.array([impulse, center, np.sqrt(max(square, 0.0))]), weights

    (found, weights), coarse = of(t, f), [of(t[k::2], f[k::2])[0] for k in (0, 1)]
    impulse, center, width = found
    away = t - center
    shares = (np.ones(t.size), away / impulse, (away**2 - width**2) / (2.0 * width * impulse))
    by_noise = [float(np.sqrt(np.sum((weights * noise * share) ** 2))) for share in shares]
    # Twice the step has four times the error; the noise's part in the difference is not counted twice.
    apart = np.sqrt(np.mean(np.square(np.array(coarse) - found), axis=0)) / 3.0
    apart = np.sqrt(np.maximum(apart**2 - (np.array(by_noise) / 3.0) ** 2, 0.0))
    parts = zip(("impulse", "center", "width"), found, np.hypot(by_noise, apart), strict=True)
    return {name: (float(x), float(s)) for name, x, s in parts}


def _peak(t: np.ndarray, f: np.ndarray, noise: np.ndarray) -> tuple[float, float]:
    """Top of the polynomial through the highest samples, and its deviation; the highest itself where these are few."""
    top = int(np.argmax(f))
    high = np.flatnonzero(f > _TOP * f[top])
    high = np.arange(high[0], high[-1] + 1)
    if high.size < _MANY:
        near = slice(max(top - 1, 0), top + 2)
        bend = float(np.ptp(f[near]))
        return float(f[top]), float(np.hypot(noise[top], 0.5 * bend))
    x = (t[high] - t[high[0]]) / (t[high[-1]] - t[high[0]]) * 2.0 - 1.0
    terms, scale = 7 if high.size >= _MORE else 5, noise[high]
    basis = np.vander(x, terms, increasing=True)
    safe = np.where(scale > 0.0, scale, 1.0)
    spread = np.linalg.pinv(basis / safe[:, None])
    c = spread @ (f[high] / safe)
    fine = np.linspace(-1.0, 1.0, 2001)
    values = np.vander(fine, terms, increasing=True) @ c
    at = float(fine[np.argmax(values)]) ** np.arange(terms)
    deviation = float(np.linalg.norm(at @ spread)) if np.all(scale > 0.0) else 0.0
    # What a polynomial leaves of so large a part of a contact beyond the noise.
    left = float(np.mean((f[high] - basis @ c) ** 2)) - float(np.mean(scale**2))
    return float(values.max()), float(np.hypot(deviation, np.sqrt(max(left, 0.0)) / np.sqrt(high.size / terms)))
