"""One check: what is compared, with which source, how far it may differ; and its outcome on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np

# What a deviation is counted in.
RELATIVE, LAST_DIGIT, ABSOLUTE = "relative", "units of the last printed digit", "absolute"


class Check(NamedTuple):
    """A comparison that runs on demand."""

    name: str
    # what, source: what is computed, in a few words; the paper, closed form or program that the expected numbers are
    # from.
    what: str
    source: str
    # tolerance, measure: the largest deviation that passes; RELATIVE, LAST_DIGIT or ABSOLUTE.
    tolerance: float
    measure: str
    run: Callable[[], float]  # computes, compares and returns the largest deviation; NaN where something failed


class Row(NamedTuple):
    """The outcome of a check, its ``deviation`` NaN where nothing could be compared, for which ``error`` has the reason."""

    name: str
    what: str
    source: str
    measure: str
    tolerance: float
    deviation: float
    ok: bool
    seconds: float
    error: str


def check(what: str, source: str, tolerance: float, measure: str = RELATIVE) -> Callable[[Callable[[], float]], Check]:
    """Make a check of a function that returns its largest deviation. Arguments as the fields of ``Check``."""

    def made(function: Callable[[], float]) -> Check:
        return Check(function.__name__, what, source, tolerance, measure, function)

    return made


def carried_out(asked: Check) -> Row:
    """Run a check. A deviation of NaN and an exception are failures."""
    begin, error = time.perf_counter(), ""
    try:
        deviation = float(asked.run())
    except Exception as raised:  # a check that cannot run has not passed, whatever stopped it
        deviation, error = float("nan"), f"{type(raised).__name__}: {raised}"
    about = (*asked[:3], asked.measure, asked.tolerance)
    return Row(*about, deviation, deviation <= asked.tolerance, time.perf_counter() - begin, error)


def _apart(found: Any, expected: Any) -> tuple[np.ndarray, np.ndarray]:
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    if found.shape != expected.shape:
        raise ValueError(f"found {found.shape} numbers, expected {expected.shape}")
    return np.abs(found - expected), np.abs(expected)


def relative(found: Any, expected: Any) -> float:
    """Largest |found - expected| / |expected|, entry by entry; NaN if any is NaN. Shapes that do not fit raise."""
    apart, size = _apart(found, expected)
    return float(np.max(apart / size))


def of_largest(found: Any, expected: Any) -> float:
    """Largest |found - expected| over the largest |expected|; NaN if any is NaN. Shapes that do not fit raise."""
    apart, size = _apart(found, expected)
    return float(np.max(apart) / np.max(size))


def worst(deviations: Iterable[float]) -> float:
    """The largest of several deviations; NaN if any is NaN."""
    return float(np.max(list(deviations)))


def last_digits(found: Iterable[float], printed: Iterable[str]) -> float:
    """Largest difference in units of each number's last printed digit; 0.5 is perfect rounding."""
    pairs = list(zip(found, printed, strict=True))
    units = [10.0 ** int(Decimal(text).as_tuple().exponent) for _, text in pairs]
    return float(np.max([abs(float(x) - float(text)) / unit for (x, text), unit in zip(pairs, units, strict=True)]))
