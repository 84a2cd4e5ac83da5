"""What is asked of a record that does not say it: the unit of its clock, which column is a reading, and in what."""

from __future__ import annotations

import re

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.data.record import SWEEP, Record
from bcfj_jax.data.sensitivity import ELECTRICAL, NEEDED
from bcfj_jax.io.units import GRAVITIES, WEIGHTS, column, format_si
from calibration.impacts.events import contacts
from calibration.impacts.headers import READ, counts, is_numeric, named, rises, values_of

# How long contacts of impacts last [s]; a clock that states no unit is asked for it elsewhere.
_LASTS = (3e-6, 0.3)
# Peaks over the usual reading, and over that of the largest, from which on columns hold a contact each.
_STANDS_OUT, _AS_MUCH = 12.0, 0.2
_CLOCKS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0, "s": 1.0}
# Whole numbers without a unit that may be counts.
_COUNTED = 20


def physical(table: Record, header: str, unit: str) -> None:
    """Refuse readings without a unit that are whole numbers, as a converter counts, of an unknown size."""
    values = values_of(table, header, unit)
    values = values[np.isfinite(values)]
    if column(header)[1] is None and len(np.unique(values)) > _COUNTED and (values == np.round(values)).all():
        found = f"no unit of '{header}' is stated, and all its readings are whole numbers, as a converter counts"
        ways = f'--observe "{header} [{unit}]", or --observe "{header} [counts]" --sensitivity "85 counts/{unit}"'
        raise InputError(table.name, found, f"say what they are, with init calibration: {ways}")


def seconds(where: str, time: str, duration: float) -> None:
    """Refuse a clock without a unit by which a contact is longer or shorter than impacts are, if it is in seconds."""
    if not _LASTS[0] < duration < _LASTS[1]:
        found = f"no unit of '{time}' is stated, and in seconds a contact would last {format_si(duration, 's', 2)}"
        units = [u for u, size in _CLOCKS.items() if _LASTS[0] < duration * size < _LASTS[1]]
        ways = " or ".join(f'"{time} [{u}]", {format_si(duration * _CLOCKS[u], "s", 2)}' for u in (*units, "s"))
        raise InputError(where, found, f"say which it is: --time of init calibration is {ways}")


def clock_remedy(table: Record, found: dict[str, str]) -> str:
    """How to say which column is the clock, in units in which a contact is neither too short nor too long; or a rate."""
    rate = '--rate "20 kHz" of init calibration says how often was sampled'
    h = next((h for h in table.header if column(h)[1] is None and rises(table, h) and not counts(table, h)), "")
    pulses = next((found[u] for u in READ if u in found), "") or pulsing(table, h)
    if not h:
        return rate
    clock, values = values_of(table, h, "1"), values_of(table, pulses, "1") if pulses else np.zeros(0)
    if pulses and not values.size:
        values = values_of(table, pulses, next((u for u in found if found[u] == pulses), "1"))
    events = contacts("contact.pulse", clock, values) if values.size == clock.size else []
    lasts = max(events, key=lambda e: e.peak).duration if events else 0.0
    units = [u for u, size in _CLOCKS.items() if _LASTS[0] < lasts * size < _LASTS[1]]
    ways = [f'"{h} [{u}]" (a contact of {format_si(_CLOCKS[u] * lasts, "s", 2)})' for u in units] or [f'"{h} [us]"']
    return f"say which it is: --time {' or '.join(ways)}; else {rate}"


def reading_remedy(table: Record, found: dict[str, str]) -> str:
    """How to say which column is a reading: by its sensor's sensitivity, or by its header; the one that stands out most."""
    for h in table.header:
        if (unit := column(h)[1]) in ELECTRICAL:
            needed = NEEDED.get(str(unit), NEEDED[""])
            return f"'{h}' is in {unit}: {needed.replace('10 mV/N', table.sensor) if table.sensor else needed}"
    other = pulsing(table, found.get("s", ""))
    heavy = next((h for h in table.header if column(h)[1] in {*GRAVITIES, *WEIGHTS}), "")
    # A letter alone may be of anything.
    kind = next((u for u in READ if len(column(other)[0]) > 1 and named(other, u)), "")
    unit = column(heavy)[1] or ("g" if re.search(r"(?i)\(g\)$", other) else kind or "N")
    said = column(heavy or other)[0]
    unit = unit if unit == "g" else WEIGHTS.get(unit, unit)
    units = "" if kind or heavy else ', or its own unit: g, m/s^2, mm, or V with --sensitivity "10 mV/N"'
    said = f', or say which it is: --observe "{said} [{unit}]" of init calibration{units}' if said else ""
    return f'head one with its unit, as in "force [N]"{said}'


def pulsing(table: Record, clock: str) -> str:
    """The column of numbers without a unit that stands out most from its own median; "" for none."""

    def stands_out(header: str) -> float:
        values = values_of(table, header, "1")
        away = np.abs(values - np.nanmedian(values)) if np.isfinite(values).any() else np.zeros(1)
        return float(np.nanmax(away) / max(np.nanmedian(away), 1e-3 * np.nanmax(away), 1e-300))

    bare = [h for h in table.header if h not in ("", SWEEP, clock) and column(h)[1] is None and not rises(table, h)]
    bare = [h for h in bare if is_numeric(table.columns[table.header.index(h)])]
    return max(bare, key=stands_out, default="")


def one_of(table: Record, header: str, unit: str) -> None:
    """Refuse a force or acceleration beside which others stand that are named as it is but for a number, and pulse as much."""
    same = [h for h in table.header if re.sub(r"\d+", "#", h) == re.sub(r"\d+", "#", header)]
    sizes = {h: np.abs(v - np.nanmedian(v)) for h in same if np.isfinite(v := values_of(table, h, unit)).any()}
    peaks = {h: float(np.nanmax(v)) for h, v in sizes.items() if np.nanmax(v) > _STANDS_OUT * np.nanmedian(v)}
    several = [h for h in peaks if peaks[h] > _AS_MUCH * max(peaks.values())]
    if unit in ("N", "m/s^2") and len(several) > 1:
        which = ", ".join(f"'{h}'" for h in several)
        ways = f'--runs-by columns where each is a run; else the one to be read, --observe "{several[0]}"'
        raise InputError(
            table.name, f"{len(several)} columns hold a contact each: {which}", f"say what they are: {ways}"
        )
