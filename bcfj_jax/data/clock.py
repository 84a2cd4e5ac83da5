"""The clock of a record: a column of times, or the step or rate that a file states beside its channels.

What instruments call these is recognised by words: names without blanks, signs and units, in lower case (``plain``).
"""

from __future__ import annotations

import contextlib
import re
import unicodedata
from collections.abc import Iterable, Sequence
from datetime import datetime

import numpy as np

from bcfj_jax.core.errors import InputError, clip
from bcfj_jax.io.units import column, scale_of

TIMES = (
    "time", "t", "zeit", "clock", "seconds", "second", "temps", "tiempo", "messzeit", "prüfzeit", "testzeit", "versuchszeit",
    "elapsed time", "abs time", "tout", "time stamp", "timestamp", "x_value", "zeitstempel", "tid", "tempo", "test time",
    "date/time", "datetime", "ts", "tijd", "czas", "čas", "aika", "idő", "время", "时间", "時間", "시간",
)  # fmt: skip
# A rate is named by one of these words alone, or by one behind or before a word for samples; so is a step.
_RATE = re.compile(r"rate|fre[qc]|fps|hz$|takt|cadence|周波数|频率|率|частот")
_STEP = re.compile(
    r"interval|period|cycle|increment|incr?$|step|delta|^dt$|resolution|schritt|abtastzeit|pas$|周期|间隔|間隔|период|шаг"
)
_OF_SAMPLES = re.compile(
    r"sampl|scan|acqui|update|abtast|mess|frame|captur|record|logg|aufnahm|aufzeich|erfass|data|daq|adc|analog|camera|video|echantillon|muestr|campion|"
    r"サンプル|サンプリング|采样|дискретиз"
)
_OF_TIMES = re.compile(r"^(?:x|t|time|horiz(?:ontal)?)(?:axis)?(?=inc|delta|step|interval|resol|dt)|(?:delta|inc)[xt]$")
_RATES = ("fs", "rate", "frequency", "sps", "fps", "samplespersecond", "samplespersec")
_STEPS = ("dt", "increment", "interval", "tinc", "tinterval", "hresolution", "clock", "samplinginc", "schrittweite")
# Frequencies of something else, and lengths of records.
_OTHERS = re.compile(
    r"filter|cut|tiefpass|lowpass|alias|trigger|grenz|eigen|natural|resonan|nyquist|band|baud|bit|number|count|length|"
    r"calibrat|generat|integrat|accelerat|operat|(?:record|mess|acqui|data|captur|log)\w*period"
)
STARTS = {
    "x0", "xzero", "t0", "tstart", "start", "xorigin", "xstart", "firsttime", "horizontalstart", "xfirst", "xorg", "hoffset",
    "timeoffirstsample", "xaxisoffset",
}  # fmt: skip
_NUMBER = re.compile(r"(?:.*:)?\s*([-+]?\d[\d.,]*(?:[eE][-+]?\d+)?)\s*\[?([^\]]*)\]?\s*")
_THOUSANDS = re.compile(r"[1-9]\d{0,2}(?:,\d{3})+")
OF_DAY = (
    r"(?:\d+ days?|"
    r"\d{4}-\d\d-\d\d|\d\d?[./]\d\d?[./]\d{4}|\d{4}/\d\d/\d\d|\d\d?-[A-Z][a-z]{2}-\d{4})?[ T]?(?:\d\d?:\d\d:\d\d(?:[.,:]\d+)?"
    r"(?:Z|[-+]\d\d:?\d\d| ?[AaPp][Mm])?|\d{1,3}:\d\d[.,]\d+)"
)
_DATE = re.compile(r"(?i)\bdat(?:e|um)(?![a-z])|fecha|日期|日時")
# As 20261125T100000.5Z, and minutes and seconds alone, as 00:01.5.
_BASIC = re.compile(r"(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)(?!:)(.*)")
_MINUTES = re.compile(r"(\d{1,3}):(\d\d[.,]\d+)")
# Fewest times of a clock that can be taken as even, and of its steps the share that are 0: a row that stands twice is a fault.
# A clock that stands still but for fewer steps than these tells no rate.
# Of numbers with some digits one unit is up to ten of another.
_FEW, _TWICE, _TICKS, _LARGEST = 16, 0.25, 4, 10.1
_SAMPLES_A_SECOND = re.compile(
    r"([kKM]?)(?i:(?:sa?|samples|sps|scans|fps|frames)(?:/s|/sec|/second)?|(?:samples|frames) per second)"
)


def plain(key: str) -> str:
    """A name without its unit, blanks, signs and accents, in lower case."""
    bare = unicodedata.normalize("NFKD", re.sub(r"[\W_]+", "", column(key)[0].casefold()))
    return unicodedata.normalize("NFC", "".join(c for c in bare if not "\u0300" <= c <= "\u036f"))


def is_rate(key: str) -> bool:
    """Whether a name is one of a rate of samples."""
    name = plain(key)
    return name in _RATES or bool(_RATE.search(name) and _OF_SAMPLES.search(name) and not _OTHERS.search(name))


def is_step(key: str) -> bool:
    """Whether a name is one of the time between samples."""
    name = plain(key)
    of_samples = _STEP.search(name) and _OF_SAMPLES.search(name) and not _RATE.search(name)
    return name in _STEPS or bool((of_samples or _OF_TIMES.search(name)) and not _OTHERS.search(name))


def is_time(header: str) -> bool:
    """Whether a column is one of times, by its unit or else its name."""
    name, unit = column(header)
    if unit is None:
        return name.strip().lower().removesuffix("_s") in TIMES
    with contextlib.suppress(InputError):
        return bool(scale_of(unit, "s", header))
    return False


def is_of_day(cell: object) -> bool:
    """Whether a cell is a time of day, or a date and a time."""
    return isinstance(cell, str) and (":" in cell or "T" in cell) and re.fullmatch(OF_DAY, _extended(cell)) is not None


def _extended(cell: object) -> str:
    """A time of day in the extended format of ISO 8601."""
    return _BASIC.sub(r"\1-\2-\3T\4:\5:\6\7", str(cell).strip())


def of_day(cells: Sequence[object]) -> np.ndarray | None:
    """Seconds (N,) since the first of cells that are times of day, over midnight too; None where one is none."""
    if not cells or not all(map(is_of_day, cells)):
        return None
    days, seconds = np.zeros(len(cells)), np.zeros(len(cells))
    for k, cell in enumerate(cells):
        text = _extended(cell)
        if short := _MINUTES.fullmatch(text):
            text = f"{int(short[1]) // 60}:{int(short[1]) % 60:02}:{short[2]}"
        date, hours = re.fullmatch(r"(.*?)[ T]?(\d\d?:\d\d:\d\d.*)", text).groups()  # pyright: ignore
        whole, fraction = re.fullmatch(r"(\d\d?:\d\d:\d\d)(?:[.,:](\d+))?.*", hours).groups()  # pyright: ignore
        h, m, s = map(int, whole.split(":"))
        if hours[-1:] in "mM":
            h = h % 12 + (12 if hours[-2] in "pP" else 0)
        seconds[k] = 3600.0 * h + 60.0 * m + s + (float(f"0.{fraction}") if fraction else 0.0)
        days[k] = day(date)
    if (days > 0).all():
        return 86400.0 * (days - days[0]) + seconds - seconds[0]
    # Without dates a day begins where the clock falls by more than half of one.
    return seconds - seconds[0] + 86400.0 * np.cumsum(np.r_[0.0, np.diff(seconds) < -43200.0])


def evened(times: np.ndarray) -> tuple[np.ndarray, str]:
    """Times (N,) [s] that stand several times as the even clock that they are rounded from, with a note; others as they are."""
    steps = np.diff(times)
    if times.size < _FEW or not np.isfinite(times).all() or steps.min() < 0.0 or not steps.max() > 0.0:
        return times, ""
    if np.mean(steps == 0.0) < _TWICE or not ticks(times):
        return times, ""
    at = np.arange(times.size)
    step, start = np.polyfit(at, times, 1)
    rounded, even = float(steps.max()), start + step * at
    # Roundings of an even clock are apart by 0 or by their unit, but for one of the last digit.
    if rounded > _LARGEST * float(steps[steps > 0.0].min()) or np.abs(times - even).max() > 0.6 * rounded:
        return times, ""
    said = f"times are rounded to {rounded:.3g} s, so that some stand twice: an even clock is taken, every {step:.4g} s"
    return even, said


def ticks(cells: np.ndarray) -> bool:
    """Whether cells (N,) of times change often enough for a clock."""
    return bool(np.count_nonzero(cells[1:] != cells[:-1]) >= min(_TICKS, len(cells) - 1))


def since_1970(times: np.ndarray, name: str) -> float:
    """The unit [s] of times (N,) without one: of this century since 1970, or a spreadsheet's days since 1900 by name; else 1."""
    seen = times[np.isfinite(times)]
    if _DATE.search(name) and seen.size > 1 and seen.min() > 36526.0 and seen.max() < 73051.0:
        return 86400.0
    for unit in (1e-3, 1e-6, 1e-9):
        of_this_century = seen.size > 1 and unit * seen.min() > 1e9 and unit * seen.max() < 4e9
        if of_this_century and unit * np.median(np.diff(seen)) < 1.0:
            return unit
    return 1.0


def day(text: str) -> float:
    """The number of a day; whether a day or a month comes first does not matter but where a record runs over midnight."""
    for form in ("%Y-%m-%d", "%Y/%m/%d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%b-%Y"):
        with contextlib.suppress(ValueError):
            return float(datetime.strptime(text, form).toordinal())
    return 0.0


def stated(facts: Iterable[tuple[str, str]], where: str) -> tuple[float, float] | None:
    """Start and step [s] that facts of a file state; None where they state no step. Two steps that differ are refused."""
    steps: dict[str, float] = {}
    start = 0.0
    for key, value in facts:
        name, unit = plain(key), column(key)[1]
        if is_step(key) and (step := _number(value, unit, "s")):
            steps[key] = step
        elif is_rate(key) and (rate := _number(value, unit, "Hz")):
            steps[key] = 1.0 / rate
        elif name in STARTS:
            start = _number(value, unit, "s") or start
    right = {key: step for key, step in steps.items() if step > 0.0}
    # "Frequency" is that of the signal where a rate of samples stands beside it.
    right = {key: step for key, step in right.items() if plain(key) != "frequency"} or right
    if not right:
        return None
    if max(right.values()) > 1.001 * min(right.values()):
        shown = " and ".join(f"'{clip(key, 40)}' a step of {step:g} s" for key, step in list(right.items())[:2])
        remedy = "take out the one that is wrong, or add a column of times"
        raise InputError(where, f"it states two clocks: {shown}", remedy)
    return start, next(iter(right.values()))


def _number(value: str, unit: str | None, si_unit: str) -> float | None:
    found = _NUMBER.fullmatch(str(value))
    if found is None:
        return None
    if _THOUSANDS.fullmatch(found[1]):
        return None  # 20,000 is 20 or 20000.
    text = found[1].replace(",", "." if "." not in found[1] else "")
    said: str = (found[2].strip(' "') or unit or "").strip()
    said = said[:-1] + "s" if si_unit == "s" and said.endswith("S") else said  # No clock is in siemens.
    with contextlib.suppress(ValueError, InputError):
        if si_unit == "Hz" and (each := _SAMPLES_A_SECOND.fullmatch(said)):
            return float(text) * {"": 1.0, "k": 1e3, "m": 1e6}[each[1].lower()]
        return float(text) * (scale_of(said, si_unit, "clock") if said else 1.0)
    return None
