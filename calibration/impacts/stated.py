"""What a problem file states of noise and of measured features: texts become numbers in SI.

noise = "0.1 kN + 2 % of reading"    variance 0.1^2 + (0.02 reading)^2
noise = "2 N + 3 us of clock"        variance 2^2 + (3e-6 slope)^2: jitter of the sampling clock
noise = "2 N + 5 N of steps"         variance 2^2 + 5^2/12: steps of a converter
"""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.analysis.derivatives.names import feature_unit, kind_unit, nearest_kind
from bcfj_jax.core.errors import clip
from bcfj_jax.io.units import quantity
from calibration.problem import Observation, error_unit, size

_OF = re.compile(r"(.*?)\s*of\s+(?:the\s+)?(reading|clock|steps)")
_RIGHT = 'give "2 %", "0.1 kN", "0.1 kN + 2 % of reading", "2 N + 3 us of clock", "2 N + 5 N of steps" or "estimate"'


class Noise(NamedTuple):
    """Standard deviation, SI (None: to be estimated), the part that grows with the reading, as a share, jitter [s]."""

    sigma: float | None
    relative: float
    jitter: float

    def of_means(self, count: int) -> Noise:
        """That of the mean of several samples."""
        shrunk = math.sqrt(count)
        return Noise(None if self.sigma is None else self.sigma / shrunk, self.relative / shrunk, self.jitter / shrunk)


def noise(stated: object, observes: str, values: np.ndarray, where: str) -> Noise:
    """The noise of one channel: stated by a number, SI, a text, or a table of these by channel."""
    if isinstance(stated, dict):
        if observes not in stated:
            raise InputError(where, f"no noise of '{observes}'", f"{_RIGHT} for each channel")
        stated, where = stated[observes], f"{where}.{observes}"
    if stated == "estimate":
        return Noise(None, 0.0, 0.0)
    largest = size(observes, values)
    if not largest > 0:
        raise InputError(where, "the record is zero throughout", "choose another column, or widen the window")
    sigmas, shares, jitters = [], [], []
    unit = error_unit(observes)
    kinds = {
        "reading": (shares, "1", 1.0), "clock": (jitters, "s", 1.0), "steps": (sigmas, unit, 1.0 / math.sqrt(12.0)),
        "%": (sigmas, "1", largest), "": (sigmas, unit, 1.0),
    }  # fmt: skip
    for part in stated.split(" + ") if isinstance(stated, str) else [stated]:
        text = part.strip() if isinstance(part, str) else part
        of = _OF.fullmatch(text) if isinstance(text, str) else None
        kind = of[2] if of else "%" if isinstance(text, str) and text.endswith("%") else ""
        parts, own, scale = kinds[kind]
        parts.append(quantity(of[1] if of else text, own, where) * scale)
    least, said = min(sigmas + shares + jitters), f"noise = {clip(stated)}"
    if not (least > 0 and math.isfinite(sum(sigmas + shares + jitters))):
        raise InputError(where, f"{said} gives a deviation of {least:g}", _RIGHT)
    if not sigmas and not shares:
        raise InputError(where, f"{said} is zero where the reading does not change", _RIGHT)
    # Independent parts add in their squares.
    return Noise(math.hypot(*sigmas), math.hypot(*shares), math.hypot(*jitters))


def correlation(stated: object, where: str) -> float | None:
    """Time [s] over which noise remembers itself; None: to be estimated."""
    if stated == "estimate":
        return None
    time = quantity(stated, "s", where)
    if not 0.0 <= time < math.inf:
        raise InputError(where, f"a correlation time of {time:g} s", "give a finite time, 0 or more")
    return time


def features(stated: dict[str, Any], deviation: object, where: str) -> tuple[Observation, ...]:
    """Measured features by name, such as "contact.peak", with the noise that is stated of them."""
    found = []
    for name, value in stated.items():
        kind = name.rpartition(".")[2]
        if kind_unit(kind) is None:
            raise InputError(f"{where} features", f"no feature '{kind}'", nearest_kind(kind))
        number = quantity(value, feature_unit(name), f"{where} features.{name}")
        own = deviation.get(name) if isinstance(deviation, dict) else deviation
        if own is None:
            raise InputError(f"{where} feature_noise", f"no noise of '{name}'", 'give feature_noise = "2 %"')
        place = f"{where} feature_noise"
        share = isinstance(own, str) and own.strip().endswith("%")
        sigma = quantity(own, "1", place) * abs(number) if share else quantity(own, feature_unit(name), place)
        found.append(Observation(name, number, sigma))
    return tuple(found)
