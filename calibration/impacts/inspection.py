"""What is wrong with a measured record, and what is worth saying of it: its clock, its channels, its contact.

Every doubt becomes an ``InputError`` with the place and the remedy, or a note in words; nothing is changed here.
"""

from __future__ import annotations

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.quantities import percent
from bcfj_jax.data.layout import others
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import unit_of
from calibration.forward.runs import stretches

# A step of the clock that much above all but the longest tenth of the steps is a gap.
_JUMP = 1.5
# A share of the peak: above it is contact, and a contact of fewer samples than these is not resolved.
TOUCHING, _FEW_IN_CONTACT = 0.1, 3
# Equal readings in a row at the peak that look clipped.
_PLATEAU = 4


def check_clock(clock: np.ndarray, part: Record, time: str) -> None:
    """Refuse times (N,) that do not increase, with the row of the table; ``time`` is their column's header."""
    late = np.flatnonzero(np.diff(clock) <= 0)
    if late.size:
        k = int(late[0]) + 1
        twice = "take the repeated rows out, or another clock by time or rate (--time, --rate)"
        said, remedy = f"follows {clock[k - 1]:.9g} s", "sort the rows"
        said, remedy = ("stands twice", twice) if clock[k] == clock[k - 1] else (said, remedy)
        found = f"time {clock[k]:.9g} s {said}{others(part.lines[late + 1].tolist(), part.counted)}"
        remedy = f"times must increase: {remedy}, or split the runs with rows = {{ column = [values] }} or --runs-by"
        raise InputError(part.place(k, time), found, remedy)


def jumps(clock: np.ndarray) -> np.ndarray:
    """Rows after which the clock jumps."""
    steps = np.diff(clock)
    return np.flatnonzero(steps > _JUMP * np.quantile(steps, 0.9)) if steps.size else np.zeros(0, dtype=int)


def clock_note(clock: np.ndarray) -> str:
    """How many samples, over what time, how often and how evenly."""
    steps = np.diff(clock)
    if not steps.size:
        return "1 sample"
    step = float(np.median(steps))
    regular = np.delete(steps, jumps(clock))
    rms, most = np.sqrt(np.mean((regular / step - 1.0) ** 2)), np.abs(regular / step - 1.0).max()
    span = f"{clock.size} samples over {format_si(clock[-1] - clock[0], 's', 4)}, every {format_si(step, 's', 4)}"
    jitter = f"jitter {percent(rms, 2)} of a step rms, at most {percent(most, 2)}" if most > 1e-6 else "an even clock"
    return f"{span}; {jitter}"


def check_channel(observes: str, values: np.ndarray, masked: np.ndarray, zero: float, place: str) -> None:
    """Refuse readings (N,), SI, that are empty, constant, all ``masked`` as saturated or of the wrong sign.

    ``zero`` is the reading where there is nothing to read.
    """
    seen = values[np.isfinite(values)]
    if not seen.size:
        raise InputError(place, "holds no number at all", "choose another column, or other rows")
    if seen.min() == seen.max():
        remedy = "choose the column that the sensor wrote, or take the channel out"
        raise InputError(place, f"reads {format_si(float(seen[0]), unit_of(observes))} in every row", remedy)
    if not (np.isfinite(values) & ~masked).any():
        raise InputError(place, "every sample is at or beyond the saturation", "give the sensor's true limit")
    level = seen - zero
    pull, push = -level[level < 0].sum(), level[level > 0].sum()
    if observes.endswith(".normal") and pull > 2.0 * push and -level.min() > level.max():
        found = f"{pull / (pull + push):.0%} of the impulse is negative, and '{observes}' can only push"
        raise InputError(place, found, 'flip its sign with "-" before the column')


def channel_notes(observes: str, values: np.ndarray, masked: np.ndarray) -> list[str]:
    """What a channel's readings (N,), SI, lack, what is ``masked`` of them, and whether they look clipped."""
    notes = []
    blanks = int((np.isnan(values) & ~masked).sum())
    if blanks:
        notes.append(f"{observes}: {blanks} of {values.size} cells hold no number; nothing is interpolated over them")
    if masked.any():
        notes.append(f"{observes}: {int(masked.sum())} samples dropped as saturated")
    level, count = plateau(values[np.isfinite(values) & ~masked])
    if count:
        shown = format_si(level, unit_of(observes))
        row = f"{observes}: reads {shown} {count} times in a row at its peak"
        notes.append(f'{row}; if it clips there, give saturation = "{shown}"')
    return notes


def plateau(values: np.ndarray) -> tuple[float, int]:
    """The largest magnitude and how often it stands in a row, where that looks clipped; else 0 times.

    A quantised signal also rests at its peak, but goes there in single steps of its resolution.
    """
    size = np.abs(values)
    top = float(size.max())
    first, last = max(stretches(size == top), key=lambda run: run[1] - run[0])
    steps = np.abs(np.diff(size))
    # Below a millionth of the peak is rounding of the file.
    resolution = float(steps[steps > 1e-6 * top].min(initial=np.inf))
    sides = [top - size[k] for k in (first - 1, last) if 0 <= k < size.size]
    count = last - first
    # A parabola that stays within one step of the resolution over n samples leaves by at most 1 + 4n/(n-1)^2 steps;
    # one more is left to noise.
    natural = resolution * (2.0 + 4.0 * count / max(count - 1, 1) ** 2)
    clipped = count >= _PLATEAU and top > 0 and max(sides, default=0.0) > natural
    return top, count if clipped else 0


def check_contact(times: np.ndarray, values: np.ndarray, zero: float, cut: bool, place: str) -> list[str]:
    """Refuse an impact that readings (T,) do not hold whole; where a window ``cut`` it, only say so.

    ``zero`` is the reading where there is nothing to read.
    """
    seen = np.isfinite(values)
    if not seen.any():
        return []
    force, at = values[seen] - zero, times[seen]
    peak = int(np.argmax(force))
    inside = int(np.count_nonzero(force > TOUCHING * force[peak]))
    if inside < _FEW_IN_CONTACT:
        found = f"{inside} samples lie within the contact (above a tenth of the peak of {format_si(force[peak], 'N')})"
        raise InputError(place, found, "sample faster: so few samples determine no law")
    edge = "first" if peak == 0 else "last" if peak == force.size - 1 else ""
    if not edge:
        return []
    found = f"the force is largest at its {edge} sample ({format_si(force[peak], 'N')} at {format_si(at[peak], 's')})"
    if not cut:
        short = f"{found}: the record is shorter than a contact"
        raise InputError(place, short, "record from before the contact to after it")
    return [f"{found}; the window cuts the contact"]
