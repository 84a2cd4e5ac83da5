"""Whether mass, speed and force of an impact agree with each other, asked of the record before anything is fitted.

Of a body of the mass m that strikes at the speed v and leaves at e v the force has the impulse J = m v (1 + e), whatever the
law: J/(m v) lies between 1 and 2. Where both bodies are free, m is their effective mass m1 m2/(m1 + m2).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.quantities import rounded
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import column, format_si
from calibration.impacts.events import contacts, quantity, rest, told
from calibration.impacts.headers import read_unit
from calibration.impacts.preparation import Prepared
from calibration.impacts.proposal import Sizes, Understood, first_and_last
from calibration.noise.scatter import scatter

# J/(m v) and what it may be missed by; so much of the level of rest may be wrong over a contact, of the peak.
_LEAST, _MOST, _MARGIN, _LEVEL = 1.0, 2.0, 0.03, 0.01
# A mass is that of a column of accelerations to this share; a force explains such a column from this correlation on.
_SAME, _ALIKE = 0.25, 0.7
# The least mass or speed that is searched where noise hides the impulse, over the largest.
_FAINT = 1e-3
# Impulses over mass that differ by more than this ratio, beyond their doubts, are of several speeds.
_ONE_SPEED = 1.1
# Deviations of the noise below which the sum of a contact's readings may be noise alone: of many places the highest.
_HEARD = 5.0
# Names of a reading on what is struck.
TARGET = re.compile(r"(?i)\b(?:anvil|amboss|enclume|incudine|yunque|target|cible|ziel|block|blo[cq]\w*|struck)")


def effective(mass: float, struck: float | None) -> float:
    """Mass [kg] that a contact feels: m, or m M/(m + M) where a free body of mass M is struck."""
    return mass if struck is None else mass * struck / (mass + struck)


def one_of_two(
    found: Understood, s: Sizes, masses: tuple[float | None, float | None], speed: float | None, said: bool
) -> tuple[Understood, Sizes]:
    """What was understood of one body's motion, of two free ones m, M [kg]: which one's, and sizes of their approach.

    Of that the striking body has M/(m + M), the struck one m/(m + M). An approach at v changes by v to 2 v; else a name says.
    ``said``: whether the struck body is. Where a second column is of it, or it alone moves, it has to be.
    """
    header, (mass, other), struck = next(iter(found.columns.values())).removeprefix("-"), masses, found.body == "struck"
    beside = [h for h in found.others if TARGET.search(h) and column(h)[1] and column(h)[1] == column(header)[1]]
    how = f"'{header}' and '{beside[0]}' are of two bodies" if beside and not said else ""
    if struck and (mass is None or other is None):
        how = f"'{header}' begins at rest, as of a body that is struck (of one that is let go begin shortly before it strikes)"
    if how:
        raise InputError(str(found.path), how, 'give --mass "0.8 kg" of what strikes and --struck-mass "4.8 kg"')
    if mass is None or other is None or not (struck or "m/s^2" in found.columns):
        return found, s
    ways = {"body": (mass + other) / other, "struck": (mass + other) / mass}
    if struck:  # Its speed behind the contact is what it changed by.
        changed = [ways["struck"] * abs(first_and_last(r.readings["m/s"])[1]) for r in found.records]
        return found, s._replace(impulse=float(np.mean(changed)), impulses=(min(changed), max(changed)), speed=None)
    fits = [b for b, x in ways.items() if speed and 0.95 <= x * s.impulse / speed <= 2.05]
    which = fits[0] if len(fits) == 1 else "struck" if TARGET.search(str(found.columns)) else "body"
    peak, impulse, *ends = ways[which] * np.array([s.peak, s.impulse, *s.impulses])
    return replace(found, body=which), s._replace(peak=peak, impulse=impulse, impulses=tuple(ends))


def pushed(record: Prepared) -> tuple[float, float] | None:
    """Impulse of the first contact [N s], and by how much it may be wrong.

    None of a record whose first contact is not whole, and of one that does not show the normal force alone.
    """
    reading = record.readings.get("contact.normal")
    if reading is None:
        return None
    seen = np.isfinite(reading.values)
    clock, values = record.times[seen], reading.values[seen]
    found = contacts("contact.normal", record.times, reading.values)
    if not found or clock.size < 8:
        return None
    first = found[0]
    longer = max(0.25 * first.duration, 2.0 * first.step)
    end = first.end + longer if len(found) == 1 else min(first.end + longer, found[1].before)
    inside = (clock >= first.begin - longer) & (clock <= end)
    before = values[clock < first.begin - longer]
    if before.size < 4 or clock[-1] < end:
        return None
    noise = scatter(values)
    span = first.duration + 2.0 * longer
    doubt = 3.0 * noise * float(np.sqrt(span * first.step + span**2 / before.size)) + _LEVEL * first.peak * span
    return float(np.trapezoid(values[inside] - np.mean(before), clock[inside])), doubt


def impulse(record: Prepared, mass: float, speed: tuple[float, float]) -> tuple[str, float, float]:
    """Why an impact's mass [kg] and the bounds of its speed [m/s] contradict its impulse; "" where they do not.

    Behind it the effective mass that the impulse and the speed leave, from least to most [kg].
    """
    seen = pushed(record)
    if seen is None or not speed[0] > 0.0 or not mass > 0.0:
        return "", 0.0, 0.0
    push, doubt = seen
    low, high = (push - doubt) / (mass * speed[1]), (push + doubt) / (mass * speed[0])
    if high > _LEAST - _MARGIN and low < _MOST + _MARGIN:
        return "", 0.0, 0.0
    ratio = push / (mass * float(np.sqrt(speed[0] * speed[1])))
    most = mass * high / (_LEAST - _MARGIN)
    least = max(mass * low / (_MOST + _MARGIN), _FAINT * most)
    text = (
        f"{record.name}: impulse / (mass x speed) is {ratio:.3g}, and 1 + e is 1 to 2: mass ({format_si(mass, 'kg', 3)}), "
        "speed, a unit or the gain is wrong; where both bodies are free, give mass and struck_mass, or their effective mass "
        f"m1 m2/(m1 + m2): impulse and speed imply {format_si(least, 'kg', 2)} to {format_si(most, 'kg', 2)}"
    )
    return text, float(least), float(most)


def unheard(record: Prepared) -> str:
    """Why a record may show no contact: the readings of the largest are, together, hardly more than noise; "" where they are."""
    observes, found = told(record.times, {o: reading.values for o, reading in record.readings.items()})
    if not found or quantity(observes) not in ("normal", "pulse"):
        return ""
    values, largest = record.readings[observes].values, max(found, key=lambda e: e.peak)
    seen = np.isfinite(values)
    inside = (record.times[seen] >= largest.begin) & (record.times[seen] <= largest.end)
    noise = scatter(values[seen]) * float(np.sqrt(np.count_nonzero(inside)))
    # With its sign, by which noise cancels: ``rise`` of a pulse has none.
    above = abs(float(np.sum(values[seen][inside] - (rest(values[seen]) or 0.0))))
    if not noise > 0.0 or above >= _HEARD * noise:
        return ""
    return f"{record.name}: {observes} may show no contact: its largest is {rounded(above / noise)} deviations of the noise"


def speeds(seen: Sequence[tuple[Prepared, float]]) -> tuple[str, float, float]:
    """Why impacts of masses [kg] cannot have one speed: of one law they would have one impulse over mass; "" where they may.

    Behind it the speeds that the impulses leave, from least to most [m/s].
    """
    found = [(record.name, mass, push) for record, mass in seen if mass > 0.0 and (push := pushed(record))]
    ends = [((push - doubt) / mass, (push + doubt) / mass) for _, mass, (push, doubt) in found]
    low, high = max((a for a, _ in ends), default=0.0), min((b for _, b in ends), default=0.0)
    if len(ends) < 2 or not low > _ONE_SPEED * high or not high > 0.0:
        return "", 0.0, 0.0
    shown = ", ".join(f"{name} {format_si(push / mass, 'm/s', 3)}" for name, mass, (push, _) in found)
    text = (
        f"impulse / mass is {shown}, and of one approach_speed it would be one number: give each record its own, "
        "each = true in [free.approach_speed]"
    )
    least, most = min(a for a, _ in ends) / (_MOST + _MARGIN), max(b for _, b in ends) / (_LEAST - _MARGIN)
    return text, float(max(least, _FAINT * most)), float(most)


def other_body(record: Prepared, part: Record, observe: Mapping[str, str], mass: float) -> str:
    """Why a mass [kg] may be of the wrong body, where force alone is read and the speed is not known; "" where nothing says so.

    A column of accelerations that is not fitted and goes with the force is of one body. That this mass is the effective one
    needs the other body to be held.
    """
    reading = record.readings.get("contact.normal")
    if reading is None:
        return ""
    taken = {header.removeprefix("-").strip() for header in observe.values()}
    force = reading.raw - np.nanmedian(reading.raw)
    for header in part.header:
        if not header or header in taken or read_unit(part, header) != "m/s^2":
            continue
        try:
            read = part.numbers(header, "m/s^2", part.name, blank=True)
        except InputError:
            continue
        both = np.isfinite(force) & np.isfinite(read)
        read = read - np.nanmedian(read)
        square = float(read[both] @ read[both])
        product, size = float(force[both] @ read[both]), float(force[both] @ force[both])
        if not square > 0.0 or abs(product) < _ALIKE * np.sqrt(square * size):
            continue
        # By the force, whose noise is the smaller share, and by the acceleration: noise of either pulls one of them down.
        ends = sorted((abs(product) / square, size / abs(product)))
        if ends[0] * (1.0 - _SAME) <= mass <= ends[1] * (1.0 + _SAME):
            return (
                f"the mass given, {format_si(mass, 'kg', 3)}, is force over '{header}', the mass of the "
                "body with that sensor, and forces alone do not show whether the other body is free: then the contact feels "
                "m1 m2/(m1 + m2): the stiffness goes as its power n, the exponent, the damping as it, speeds as its inverse. "
                "Give mass and struck_mass (the mass of the "
                'body that is struck, or "fixed"), or say how well the mass is known, as in "4 kg +- 1 %", or give the speed'
            )
    return ""
