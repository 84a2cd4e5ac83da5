"""Where a model misses the data: the record, the time and the size of the worst stretch of residuals.

A test says that residuals are no noise. This says at which moment to look, in words.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from bcfj_jax.mechanism.channels import unit_of
from calibration.diagnostics.records import Record

# A stretch counts where its weight is so many deviations of the record's other errors; the worst few are reported.
_LEAST, _MOST = 4.0, 3
# In contact is where the model reads more than this share of its peak.
_TOUCHING = 0.02
# A contact bottoms out for less than this share of its duration, this near to the middle of the pulse.
_BRIEF, _MIDDLE = 0.25, 0.25


class Miss(NamedTuple):
    """A stretch of samples on one side of the model: time and size (data less model, SI) of its largest error, that over the peak
    of the data, and whether it is a spike above the middle of a contact, as where a soft layer bottoms out.
    """

    record: str
    channel: str
    time: float
    first: float
    last: float
    error: float
    share: float
    brief: bool

    def text(self) -> str:
        """The miss as a sentence."""
        side = "above" if self.error > 0 else "below"
        size = f"{abs(self.error):.3g} {unit_of(self.channel)} ({abs(self.share):.0%} of its peak)"
        said = f"in {self.record}, {self.channel} is {size} {side} the model at {self.time:.4g} s"
        if self.brief:
            return f"{said}: a short spike on top of the contact, as where a soft layer bottoms out"
        return said if self.first == self.last else f"{said} (on that side from {self.first:.4g} to {self.last:.4g} s)"


def misses(records: Iterable[Record]) -> list[Miss]:
    """The worst run of errors of one sign of each record and channel that stands out from the record's others, worst first.

    By the sum of its errors over the square root of their number, in their median deviation: a spike does not hide itself.
    """
    every = [_worst(record, channel) for record in records for channel in record.data]
    return [miss for _, miss in sorted((m for m in every if m), key=lambda pair: -pair[0])]


def reasons(records: Iterable[Record]) -> list[str]:
    """Sentences for a verdict: the worst misses of the fitted records."""
    return [miss.text() for miss in misses(r for r in records if not r.held_out)[:_MOST]]


def _worst(record: Record, channel: str) -> tuple[float, Miss] | None:
    seen = np.isfinite(record.data[channel])
    times, data, predicted = (x[seen] for x in (record.times, record.data[channel], record.prediction[channel]))
    error = data - predicted
    if error.size < 3 or not np.any(error):
        return None
    runs = np.split(np.arange(error.size), np.flatnonzero(np.diff(np.sign(error)) != 0) + 1)
    weight, worst = max(((abs(float(error[run].sum())) / np.sqrt(run.size), run) for run in runs), key=lambda w: w[0])
    elsewhere = np.delete(error, worst)
    deviation = 1.4826 * float(np.median(np.abs(elsewhere))) if elsewhere.size else 0.0
    if weight < _LEAST * deviation:
        return None
    k = int(worst[np.argmax(np.abs(error[worst]))])
    force = np.abs(predicted - predicted[np.argmin(np.abs(predicted))])
    inside = times[force > _TOUCHING * force.max()]
    brief = False
    if inside.size > 3 and error[k] * np.sign(data[np.argmax(np.abs(data))]) > 0:
        # Of the spike, not of the run of errors that it stands in: from half its height to half its height.
        high = times[worst[np.abs(error[worst]) > 0.5 * abs(error[k])]]
        span = float(np.ptp(inside))
        middle = abs(float(times[k]) - 0.5 * float(inside[0] + inside[-1])) < _MIDDLE * span
        brief = bool(middle and np.ptp(high) < _BRIEF * span and abs(error[k]) > 5.0 * deviation)
    place = (float(times[k]), float(times[worst[0]]), float(times[worst[-1]]))
    miss = Miss(record.name, channel, *place, float(error[k]), float(error[k]) / float(np.max(np.abs(data))), brief)
    return weight / max(deviation, 1e-300), miss
