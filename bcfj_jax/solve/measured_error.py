"""The numerical error of a run, measured: the same program again at a tenth of the tolerance. NumPy, on the host.

The tighter run stands for the truth. What is measured is the error of steps and solver, not that of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

# Two runs agree as long as no force differs by more than this multiple of the error asked for. That error is an rms
# over the run; single instants, as on the steep side of an impact, are off by more.
FACTOR = 10.0


class Accuracy(NamedTuple):
    """How far a run is from one at a tenth of its tolerance.

    Attributes:
        asked: force error asked for, a fraction of the peak.
        tolerance: of the run; the tighter run had a tenth of it.
        begin: time from which the two are compared [s]: from where on the promised error holds, or 0 for a run that
            ends before.
        rms: by contact, rms over the times of the force difference, worst member's worst component, over the peak.
        peak: by contact, difference of the largest normal force of a member, worst member, over the peak.
        impulse: by contact, integral of the difference of normal forces, worst member, over the largest member's
            integral of normal force.
        agree_until: first time [s] at which a force differs by more than ``FACTOR`` times ``asked`` times the
            contact's peak, or at which one of the runs has failed; NaN for none.
        differs: the contact whose force does so, "" for none.
        wall_s: seconds that the tighter run took.
    """

    asked: float
    tolerance: float
    begin: float
    rms: dict[str, float]
    peak: dict[str, float]
    impulse: dict[str, float]
    agree_until: float
    differs: str
    wall_s: float

    @property
    def worst(self) -> float:
        """Largest of all measured errors; NaN where a run failed, or where nothing was measured."""
        errors = [x for part in (self.rms, self.peak, self.impulse) for x in part.values()]
        return float(np.max(errors)) if errors else float("nan")


def measured(
    asked: float,
    begin: float,
    times: np.ndarray,
    force: Mapping[str, np.ndarray],
    finer: Mapping[str, np.ndarray],
    **more: float,
) -> Accuracy:
    """How far the forces of a run are from those of the tighter one.

    Args:
        asked: force error, a fraction of the peak.
        begin: time from which the promised error holds [s].
        times: (T,) [s].
        force, finer: by contact (T, 3) or (T, k, 3) [N], of the run and of the tighter one; NaN from a failure on.
        more: ``tolerance`` and ``wall_s`` of ``Accuracy``.
    """
    late = times >= begin
    if np.count_nonzero(late) < 2:
        begin, late = 0.0, times >= times[0]
    times = times[late]
    rms, peaks, impulse = {}, {}, {}
    first, differs = float("nan"), ""
    for name in force:
        ours, truth = (side[name][late].reshape(times.size, -1, 3) for side in (force, finer))
        off = ours - truth
        # The forces before a failure still say until when the two agree.
        peak = float(np.nanmax(np.abs(truth[..., 0]), initial=0.0))
        tops = [np.abs(side[..., 0]).max(axis=0) for side in (ours, truth)]
        pushed = np.trapezoid(np.abs(truth[..., 0]), times, axis=0).max()
        rms[name] = _share(np.sqrt(np.mean(np.square(off), axis=0)).max(), peak)
        peaks[name] = _share(np.abs(tops[0] - tops[1]).max(), peak)
        impulse[name] = _share(np.abs(np.trapezoid(off[..., 0], times, axis=0)).max(), pushed)
        # Not ``>``: NaN is no agreement.
        apart = times[~(np.abs(off).max(axis=(1, 2)) <= FACTOR * asked * peak)]
        if apart.size and not apart[0] >= first:
            first, differs = float(apart[0]), name
    return Accuracy(
        asked=asked,
        begin=float(begin),
        rms=rms,
        peak=peaks,
        impulse=impulse,
        agree_until=first,
        differs=differs,
        **more,
    )


def _share(part: float, whole: float) -> float:
    """A part of a whole; of no whole 0 for no part."""
    with np.errstate(divide="ignore"):
        return 0.0 if part == 0.0 else float(np.float64(part) / whole)
