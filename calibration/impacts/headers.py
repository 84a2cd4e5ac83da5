"""What columns of a record are, by names, units and what their numbers do; and what is asked where they do not say it."""

from __future__ import annotations

import contextlib
import re

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.data.clock import TIMES, plain
from bcfj_jax.data.numbers import is_missing, is_number
from bcfj_jax.data.record import IN_SI, SWEEP, Record, stated
from bcfj_jax.data.sensitivity import ELECTRICAL, NEEDED
from bcfj_jax.io.units import GRAVITIES, WEIGHTS, accelerates, column, format_si, scale_of
from calibration.impacts.events import contacts
from calibration.noise.scatter import scatter

# Readings by the unit of their column, as scenes of one body have them; and names by which a column without a unit is one.
KINDS = ("s", "N", "m/s^2", "m/s", "m")
NAMES = {
    "s": TIMES,
    "N": (
        "force", "load", "f", "fn", "f_n", "fz", "fx", "fy", "kraft", "normal", "normalkraft", "fuerza", "standardkraft",
        "prüfkraft", "effort", "forza", "loadcell", "last", "weight", "gewicht", "poids", "força", "forca", "siła", "síla",
        "kracht", "voima", "erő", "сила", "усилие", "нагрузка", "力", "荷重", "힘",
    ),
    "m/s^2": ("acceleration", "accel", "acc", "a", "az", "ax", "ay", "beschleunigung", "accélération",
        "aceleración", "ускорение"),
    "m/s": ("velocity", "speed", "v", "vel", "geschwindigkeit"),
    "m": ("position", "displacement", "x", "y", "z", "height", "place", "weg", "перемещение", "変位", "位移"),
}  # fmt: skip
TANGENTIAL = {
    "tangential", "friction", "shear", "ft", "lateral", "tangentialkraft", "reibkraft", "reibungskraft", "querkraft",
}  # fmt: skip
_AXIS = re.compile(r"(?:\b|_|(?<=[fF]))[xyzXYZ]\d*$")
_NEITHER = {"moment", "torque", "drehmoment", "moments", "max", "maximum", "count", "rate", "power"}
# Readings of the scenes, in the order in which they tell a contact; an acceleration along +x is negative in contact.
READ = {"N": "contact.normal", "m/s^2": "body.acceleration.x", "m/s": "body.velocity.x", "m": "body.place.x"}
# How long contacts of impacts last [s]; a clock that states no unit is asked for it elsewhere.
_LASTS = (3e-6, 0.3)
# A range over the noise that is a hit's, and the share by which another hit differs.
_STANDS_OUT, _AS_MUCH, _LEVELS = 12.0, 0.04, 8
_CLOCKS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "d": 86400.0, "s": 1.0}
# What strikes, and not what is struck.
_MASS = re.compile(
    r"(?:total|test|impact\w*|hammer|strik\w*|drop\w*|fall\w*|moving|tup|carriage|ram|pendul\w*|stoss\w*|schlag\w*)?mass[ea]?(?:kg)?"
    r"|(?:impact\w*|hammer|strik\w*|drop\w*|fall\w*|tup|carriage|ram|pendul\w*|stoss\w*|schlag\w*)(?:weight|gewicht)"
    r"|(?:[落冲摆]?锤体?|冲头)质量|(?:落下|衝撃体?)質量|(?:충격체|낙하|추)?질량|(?:mass[ea]?|masa|hmotnost|质量|質量)(?:of(?:the)?|del?l?(?:[aeou]l?)?)?"
    r"(?:martillo|marteau|martelo|mazza|mobile|impact\w*|percut\w*|carro|bijaka|młota|battente|tombante?|chute|mouton|cadente|caduta|caida|hammer|striker|drop\w*)?"
)
# A sensitivity's column and electric unit, or that of counts, whichever side it is on.
_STATED = re.compile(
    rf"(?:(.+?)\s*=)?\s*[-+\d.eE]+\s*(?:({'|'.join(map(re.escape, sorted(ELECTRICAL, reverse=True)))})/|[^/]+/(\w*V|\w*C))"
)
_HINGED = "write a scene file with a hinge, and observe its angle or torque: docs/howto/force_displacement.md#bodies-that-turn"
_ROTATES = re.compile(r"(?i)(?:deg|°)(?! ?[CFK]\b)|rad|rpm|rev|\b(?:[1U]|tr|giri|ob)/min|min-1")
# What stands beside a reading: its scatter over several tests, or what was asked of a machine.
BESIDE = re.compile(
    r"\b(?:std\w*|sd|sigma|deviation|uncertainty|streuung|\w*abweichung|écart|incert\w*|desviación|scarto"
    r"|soll\w*|set ?point|command\w*|demand\w*|consigne|consigna)\b"
)
# So many whole numbers without a unit, or in volts, may be counts.
_COUNTED, _VOLTS = 20, ("V", "Volt", "Volts", "volt", "volts", "Vdc", "VDC")


def name_of(header: str) -> str:
    """The name of a column without its unit, in lower case."""
    return column(header)[0].lower().strip()


def words_of(header: str) -> set[str]:
    """The words of a name, in lower case."""
    return set(re.split(r"[\W\d_]+", name_of(header)))


def named(header: str, unit: str) -> bool:
    """Whether a name is one of a reading of a unit: as a whole, or by one of its words of three letters and more."""
    name = name_of(header)
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", column(header)[0]).lower()
    words = {w for w in re.split(r"[\W\d_]+", parted) if len(w) > 2}
    # "A" is a channel of an oscilloscope.
    whole = name in NAMES[unit] and column(header)[0].strip() != "A"
    return whole or bool(words & set(NAMES[unit]) and not words & _NEITHER)


def stated_mass(table: Record) -> float | None:
    """The mass of what strikes [kg], where lines beside the table state one with its unit; None where they do not."""
    bare = "kg" if table.reader in IN_SI else None
    found = {stated(*fact, "kg", bare) for fact in table.facts if _MASS.fullmatch(plain(fact[0]))} - {0.0}
    return found.pop() if len(found) == 1 else None


def values_of(table: Record, header: str, unit: str) -> np.ndarray:
    """The readings of a column, SI; none where it cannot be read."""
    try:
        return table.numbers(header, unit, table.name, True)
    except InputError:
        return np.zeros(0)


def counts(table: Record, header: str) -> bool:
    """Whether a column counts the samples."""
    values = values_of(table, header, "1")
    return values.size > 1 and bool((np.diff(values) == 1.0).all())


def rises(table: Record, header: str) -> bool:
    """Whether a column increases throughout."""
    values = values_of(table, header, "1") if header else np.zeros(0)
    return values.size > 1 and bool((np.diff(values) > 0.0).all())


def is_numeric(cells: np.ndarray) -> bool:
    """Whether most cells of a column (N,) are numbers."""
    if cells.dtype.kind in "iuf":
        return True
    seen = [c for c in cells[:: max(1, cells.size // 500)].tolist() if not is_missing(c)]
    # A column of readings with some faults is one all the same, so that its faults can be named.
    return sum(map(is_number, seen)) > 0.5 * len(seen)


def read_unit(table: Record, header: str) -> str | None:
    """The SI unit of ``KINDS`` that a header's unit converts to, or that of its sensor's sensitivity."""
    name, text = column(header)[0], table.unit(header)
    if text in KINDS:
        return text
    if text in WEIGHTS and named(header, "N"):
        return "N"
    for unit in KINDS if text else ():
        # G is no mass, and no record of an impact is in gauss.
        if text in GRAVITIES and not (unit == "m/s^2" and (accelerates(name) or text == "G")):
            continue
        if _is_of(header, unit, str(text)):
            return unit
    return None


def physical(table: Record, header: str, unit: str) -> None:
    """Refuse readings without a unit that are whole numbers, as a converter counts, of an unknown size."""
    values = values_of(table, header, unit)
    values = values[np.isfinite(values)]
    said = column(header)[1]
    factor = table.sensitivities.of(column(header)[0], said)
    volts = factor is not None and said in _VOLTS and "count" not in factor.text
    values = values / factor.factor if factor is not None else values
    whole = len(np.unique(values)) > _COUNTED and np.allclose(values, np.round(values), 0.0, 1e-6)
    if whole and (said is None or volts):
        stated = f"'{header}' is in {said}" if volts else f"no unit of '{header}' is stated"
        found = f"{stated}, and all its readings are whole numbers, as a converter counts"
        counted = f'--sensitivity "85 counts/{unit}"'
        ways = counted if volts else f'--observe "{header} [{unit}]", or --observe "{header} [counts]" {counted}'
        raise InputError(table.name, found, f"say what they are, with init calibration: {ways}")


def seconds(where: str, time: str, duration: float) -> None:
    """Refuse a clock without a unit by which a contact is longer or shorter than impacts are, if it is in seconds."""
    if not _LASTS[0] < duration < _LASTS[1]:
        found = f"no unit of '{time}' is stated, and in seconds a contact would last {format_si(duration, 's', 2)}"
        units = [u for u, size in _CLOCKS.items() if _LASTS[0] < duration * size < _LASTS[1]]
        ways = " or ".join(f'"{time} [{u}]", {format_si(duration * _CLOCKS[u], "s", 2)}' for u in (*units, "s"))
        raise InputError(where, found, f"say which it is: --time of init calibration is {ways}")


def clock_of(table: Record, found: dict[str, str]) -> str:
    """A column without a unit that may be the clock since it increases, and neither counts nor is a reading; "" for none."""
    bare = [h for h in table.header if column(h)[1] is None and h not in found.values()]
    return next((h for h in bare if rises(table, h) and not counts(table, h)), "")


def clock_remedy(table: Record, found: dict[str, str]) -> str:
    """How to say which column is the clock, in units in which a contact is neither too short nor too long; or a rate."""
    rate = '--rate "20 kHz" of init calibration says how often was sampled'
    h = clock_of(table, found)
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
    if turns := torque(table):
        return turns
    if h := next((h for h in table.header if _ROTATES.search(column(h)[1] or "")), ""):
        return f"'{h}' is of a body that turns: {_HINGED}"
    other = pulsing(table, found.get("s", ""))
    if said := _STATED.match(given := table.sensitivities.stated or table.sensor):
        here, unit = next((h for h in table.header if h == said[1]), other), said[3] or said[2]
        ways = f'"{here} [V]" or "{here} [mV]"' if unit.endswith("V") else f'"{here} [{unit}]"'
        return f'say what its numbers are: --observe {ways} --sensitivity "{given}" of init calibration'
    heavy = [h for h in table.header if column(h)[1] in {*GRAVITIES, *WEIGHTS}]
    pull = {h: values_of(table, h, "m/s^2" if column(h)[1] in GRAVITIES else "N") for h in heavy}
    heavy = max(heavy, key=lambda h: np.ptp(np.nan_to_num(pull[h])) if pull[h].size else 0.0, default="")
    # A letter alone may be of anything.
    kind = next((u for u in READ if len(column(other)[0]) > 1 and named(other, u)), "")
    kind = "mm" if {"x", "y", "z"} <= {h.lower() for h in table.header} and other.lower() in ("x", "y", "z") else kind
    unit = column(heavy)[1] or ("g" if re.search(r"(?i)\(g\)$", other) else kind or "N")
    said = column(heavy or other)[0]
    unit = unit if unit == "g" else WEIGHTS.get(unit, unit)
    units = ', if it is an acceleration; head a weight "force [g]"' if unit == "g" else ""
    units = units if kind or heavy else ', or its own unit: g, m/s^2, mm, or V with --sensitivity "10 mV/N"'
    said = f', or say which it is: --observe "{said} [{unit}]" of init calibration{units}' if said else ""
    return f'head one with its unit, as in "force [N]"{said}'


def torque(table: Record) -> str:
    """What is to be done with a torque; "" of a table without one."""
    found = next((h for h in table.header if _is_of(h, "N m")), "")
    return f"'{found}' is a torque: {_HINGED}" if found else ""


def _is_of(header: str, si_unit: str, unit: str | None = None) -> bool:
    """Whether a column's unit, or another, is one of a quantity in SI; joules are of no torque."""
    unit = unit or column(header)[1] or ""
    with contextlib.suppress(InputError):
        return "J" not in unit and scale_of(unit, si_unit, header) != 0.0
    return False


def pulsing(table: Record, clock: str) -> str:
    """The column of numbers without a unit that stands out most from its noise; "" for none."""

    def stands_out(header: str) -> float:
        values = values_of(table, header, "1")
        values = values[np.isfinite(values)] / max(float(np.abs(values[np.isfinite(values)]).max(initial=0.0)), 1e-300)
        # What has few levels is a switch, or one number in each run.
        levels = np.unique(values).size
        return float(np.ptp(values) / max(scatter(values), 1e-3 * np.ptp(values), 1e-300)) if levels > _LEVELS else 0.0

    bare = [h for h in table.header if h not in ("", SWEEP, clock) and column(h)[1] is None and not rises(table, h)]
    bare = [h for h in bare if is_numeric(table.columns[table.header.index(h)])]
    return max(bare, key=stands_out, default="")


def one_of(table: Record, header: str, unit: str) -> None:
    """Refuse a reading beside which others, forces or named as it is but for a number or letter, show hits of another course.

    Two sensors of one hit, and two hits that are the same, are proportional: the law is the same whichever is read. Axes
    x, y, z are of one body; of motions two bodies are meant, whose way to each other is what counts.
    """
    moves = unit in ("m/s", "m")
    one = re.compile(r"(?i)\d+|\b[a-w]\b")
    alike = [h for h in table.header if one.sub("#", h) == one.sub("#", header)]
    if unit == "N" and not _AXIS.search(column(header)[0]):  # Of any name, but for axes, sides and what is derived.
        others = [h for h in table.header if column(h)[1] is not None and not _AXIS.search(column(h)[0])]
        others = [h for h in others if not words_of(h) & (_NEITHER | TANGENTIAL) and read_unit(table, h) == unit]
        alike += [h for h in others if h not in alike]
    values = {h: v for h in alike if np.isfinite(v := values_of(table, h, unit)).any()}
    sizes = {h: float(np.abs(v[np.isfinite(v)]).max()) for h, v in values.items()}
    read = {h: _unit_pulse(v) for h, v in values.items() if sizes[h] > _AS_MUCH * max(sizes.values())}
    hits = [h for h, v in read.items() if np.ptp(v) > _STANDS_OUT * scatter(v)]
    if header not in hits:
        return
    own = read[header]
    same = {h: own if moves else np.polyval(np.polyfit(own, read[h], 1), own) for h in hits}
    apart = [h for h in hits if np.abs(read[h] - same[h]).max() > _AS_MUCH]
    if apart:
        which = ", ".join(f"'{h}'" for h in hits)
        if moves and len(marks := {_AXIS.sub("", column(h)[0]) for h in hits if _AXIS.search(column(h)[0])}) > 2:
            known = f"places of {len(marks)} marks on a body that turns: {which}"
            way = "give its centre and attitude, columns x, y, z and q0 to q3, scalar first, as the program exports a rigid body"
            raise InputError(table.name, known, f'{way}; of a ball one mark, --observe "{hits[0]}"')
        if moves:
            way = f'write their difference as a column "relative [{unit}]" alone, and give --mass and --struck-mass'
            raise InputError(table.name, f"two bodies move: {which}", f'{way}; where one is held --observe "{hits[0]}"')
        # A sensor that clips reads less than one beside it.
        largest = max(hits, key=lambda h: sizes[h])
        ways = f'--runs-by columns where each is a run; else the one to be read, --observe "{largest}"'
        raise InputError(table.name, f"{len(hits)} columns hold a contact each: {which}", f"say what they are: {ways}")


def one_channel(table: Record, header: str, texts: np.ndarray, time: str) -> None:
    """Refuse a table whose rows are readings of several channels, named by texts (N,) in a column, at the same times."""
    names, clock = list(dict.fromkeys(texts.tolist())), values_of(table, time, "s")
    if not 1 < len(names) <= _COUNTED or clock.size != texts.size or (np.diff(clock) > 0.0).all():
        return
    blocks = 1 + np.count_nonzero(texts[1:] != texts[:-1])
    # "load" and "unload" are phases.
    if 2 * blocks > texts.size or sum(any(named(n, u) for u in READ) for n in names) > 1:
        shown, first = ", ".join(f"'{n}'" for n in names[:8]), next((n for n in names if named(n, "N")), names[0])
        remedy = f'say which is to be read: --rows "{header} = {first}" of init calibration'
        raise InputError(table.name, f"'{header}' says what each row reads: {shown}", remedy)


def _unit_pulse(values: np.ndarray) -> np.ndarray:
    """Readings (N,) less their median, over the largest of them; 0 where nothing was read."""
    seen = np.where(np.isfinite(values), values, np.nan) / max(
        float(np.nanmax(np.abs(values[np.isfinite(values)]))), 1e-300
    )
    away = np.nan_to_num(seen - np.nanmedian(seen))
    return away / max(float(np.abs(away).max()), 1e-300)
