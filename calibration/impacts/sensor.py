"""What a record leaves open of its sensor: when its clock shows the first contact, and what it reads at rest.

The bounds that the record gives to each are in docs/howto/problem_file.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from bcfj_jax.core.quantities import Quantity
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import unit_of
from bcfj_jax.mechanism.model import AbstractModel
from calibration.filters import Filter
from calibration.impacts.events import Event, quantity, told
from calibration.impacts.preparation import Prepared
from calibration.problem import OFFSETS, units_of

# Bounds of the clock about the first contact: shares of a contact's duration before and after, by what is read.
_BEFORE, _AFTER = {"normal": 0.25, "pulse": 0.25, "velocity": 0.5, "place": 2.0}, 0.1
# Bounds of a level of rest: so many deviations, and at least this share of the peak.
_SIGMAS, _SHARE = 5.0, 0.02
# Bounds of a filter's cut-off, by a contact's duration; how far, by the cut-off, a filter run back spreads a contact.
_CUTOFFS, _SPREAD = (0.3, 100.0), 0.3
# Samples before the first contact that are a rest, and what of a contact's duration before it is none.
_RESTING, _CLEAR = 4, 0.25
_FALLS = {"bounce": -1.0, "impact": 1.0}  # Along which axis a scene falls.
# What sets the time of the first contact, and would move it as the record's clock does.
_MOVES = ("clearance_contact", "drop_height")


class Proposal(NamedTuple):
    """Bounds [SI] of a nuisance in one record; ``doubt`` says why it should not be free unasked, "" if nothing does."""

    lower: float
    upper: float
    doubt: str = ""


@dataclass
class Sensor:
    """What was freed of the sensors of all records: bounds and notes by the place of the record."""

    names: list[str] = field(default_factory=list)
    bounds: dict[int, dict[str, tuple[float, float]]] = field(default_factory=dict)
    notes: dict[int, list[str]] = field(default_factory=dict)

    def add(self, name: str, proposals: Mapping[int, Proposal], quantities: Mapping[str, Quantity]) -> None:
        """Free a nuisance within the bounds that are proposed of each record."""
        self.names.append(name)
        unit = quantities[name].unit
        for k, p in proposals.items():
            self.bounds.setdefault(k, {})[name] = (p.lower, p.upper)
            self.say(k, f"{name} is free from {format_si(p.lower, unit, 3)} to {format_si(p.upper, unit, 3)}")

    def say(self, record: int, note: str) -> None:
        """A note on one record."""
        self.notes.setdefault(record, []).append(note)

    def envelope(self, name: str) -> tuple[float, float]:
        """Bounds that hold those of all records."""
        own = [bounds[name] for bounds in self.bounds.values() if name in bounds]
        return min(low for low, _ in own), max(high for _, high in own)


def proposed(
    name: str,
    record: Prepared,
    scene: AbstractModel,
    params: Mapping[str, float],
    free: Mapping[str, tuple[float, float]],
    passed: Filter | None = None,
) -> Proposal | str:
    """Bounds of one nuisance from one record, or why there are none; ``free``: what else is searched, with its bounds."""
    if name not in ("time_offset", "cutoff") and name not in OFFSETS.values():
        return f"a record does not give a {name}"
    observes, found = told(record.times, {o: reading.values for o, reading in record.readings.items()})
    if not found:
        return "it shows no contact"
    slow, fast = (share / found[0].duration for share in _CUTOFFS)
    if name == "cutoff":
        return Proposal(slow, fast)
    if name == "time_offset":
        given = _clock(observes, found, record, scene, params, free)
        if passed is None or isinstance(given, str):
            return given
        # What the filter delays or, run back, spreads to before the contact.
        slowest = params.get("cutoff", free.get("cutoff", (slow,))[0])
        late, early = passed.delay / slowest, _SPREAD / slowest if passed.zero_phase else 0.0
        return given._replace(lower=given.lower - late, upper=given.upper + early)
    return _zero(name, found[0], record, params, _FALLS.get(scene.kind, 0.0) * params.get("gravity", 0.0))


def _clock(
    observes: str, found: list[Event], record: Prepared, scene: AbstractModel, params: Mapping[str, float],
    free: Mapping[str, tuple[float, float]],
) -> Proposal | str:  # fmt: skip
    moving, event = next((n for n in _MOVES if n in free), ""), found[0]
    # The flights between several contacts tell what moves the first, as a drop that is seen: the clock is another unknown.
    several = bool(moving) and (len(found) > 1 or (moving != _MOVES[0] and quantity(observes) in ("place", "velocity")))
    ends = free[moving] if several else (params.get(moving, 0.0),) * 2
    first, last = (scene.first_touch({**params, **({moving: x} if moving else {})}) for x in ends)
    if first is None or last is None:
        return f"the time of the first contact of scene '{scene.kind}' follows only from a simulation"
    lower = event.before - event.step - event.loose - _BEFORE[quantity(observes)] * event.duration - last
    upper = event.begin + event.step + event.loose + _AFTER * event.duration - first
    doubt = "" if event.first else "the record begins in contact"
    return Proposal(
        lower, upper, f"{moving} is free and moves the contact as well" if moving and not several else doubt
    )


def _zero(name: str, event: Event, record: Prepared, params: Mapping[str, float], fall: float) -> Proposal | str:
    """``fall``: the acceleration before the first contact, of which an accelerometer reads nothing."""
    units = units_of(record.readings)
    unit = next((u for u, offset in OFFSETS.items() if offset == name and u in units), "")
    unit = unit or (next(iter(units)) if name == "force_offset" and len(units) == 1 else "")
    if not unit:
        return f"it has no channel that a {name} acts on"
    lows, highs = [], []
    for observes in units[unit]:
        values = record.readings[observes].values
        seen = np.isfinite(values)
        if quantity(observes) == "place":
            at = float(np.interp(event.begin, record.times[seen], values[seen]))
            level, half = at - params.get("clearance_contact", 0.0), 0.5 * float(np.ptp(values[seen]))
        else:
            apart = seen & (record.times < event.begin - max(_CLEAR * event.duration, event.step))
            if np.count_nonzero(apart) < _RESTING:
                return f"{observes} has no {_RESTING} samples of rest before the first contact"
            level, noise = float(np.mean(values[apart])), float(np.std(values[apart]))
            half = max(_SIGMAS * noise, _SHARE * float(np.nanmax(np.abs(values - level))))
        level -= fall if unit == "m/s^2" else 0.0
        lows.append(level - half)
        highs.append(level + half)
    doubt = f"{' and '.join(units[unit])} rest at different levels: subtract them in the file"
    return Proposal(min(lows), max(highs), doubt if max(lows) > min(highs) else "")


def unasked(observed: Collection[str]) -> list[str]:
    """Nuisances that are free unless the file says otherwise; a velocity's zero trades against the speed."""
    return ["time_offset", *(OFFSETS[unit_of(o)] for o in observed if unit_of(o) in ("N", "m", "m/s^2"))]
