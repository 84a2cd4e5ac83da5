"""The numerical error of a run, measured: the same program again, tighter and with other steps. NumPy, on the host.

The tighter run stands for the truth. It has a tenth of the tolerance and no step longer than 1/200 of the run, so that what
one of them steps over the other does not. What is measured is the error of steps and solver, not that of the model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

# Two runs agree as long as no force differs by more than this multiple of the error asked for. That error is an rms
# over the run; single instants, as on the steep side of an impact, are off by more.
FACTOR = 10.0
# Shares of the greatest rate by which bodies that move alike, and those that an event has parted, differ (``parted``).
ALIKE, APART = 5e-3, 0.2


class Accuracy(NamedTuple):
    """How far a run is from one at a tenth of its tolerance."""

    asked: float  # force error asked for, a fraction of the peak
    tolerance: float  # of the run; the tighter run had a tenth of it
    # Time from which the two are compared [s]: from where on the promised error holds, or 0 for a run that ends before.
    begin: float
    # By contact, rms over the times of the force difference, worst member's worst component, over the peak, the largest
    # component; of a contact that no sample sees pressed, of the rate of its penetration over the largest.
    rms: dict[str, float]
    # By contact, difference of the largest normal force of a member, worst member, over the peak.
    peak: dict[str, float]
    # By contact, integral of the difference of normal forces, worst member, over the largest integral of the size of a
    # component.
    impulse: dict[str, float]
    # First time [s] at which a force differs by more than ``FACTOR`` times ``asked`` times the contact's peak, or at
    # which one of the runs has failed; NaN for none.
    agree_until: float
    differs: str  # the contact whose force does so, "" for none
    wall_s: float  # seconds that the tighter run took
    # First time [s] from which on the bodies of a contact move otherwise in one run than in the other, though they
    # moved alike until then: an event happened in one of them alone; NaN for none.
    parts: float = float("nan")
    parts_at: str = ""  # the contact whose bodies do so, "" for none

    @property
    def doubt(self) -> tuple[str, float]:
        """Why a run that reached its end is not to be trusted, and from when on [s]; "" and NaN where nothing says so."""
        if self.parts_at:
            same = "a run with other and finer steps"
            return f"it and {same} part there: an event at '{self.parts_at}' happened in one of them alone", self.parts
        lost = [name for name in self.peak if not np.isfinite(max(self.rms[name], self.peak[name], self.impulse[name]))]
        if lost:
            found = f"its error is unknown: a run with finer steps has no force at '{lost[0]}'"
            return f"{found}, or has not reached its end", self.agree_until
        return "", float("nan")

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
    rates: tuple[Mapping[str, np.ndarray], Mapping[str, np.ndarray]] = ({}, {}),
    **more: float,
) -> Accuracy:
    """How far the forces of a run are from those of the tighter one.

    Args:
        asked: force error, a fraction of the peak.
        begin: time from which the promised error holds [s].
        times: (T,) [s].
        force, finer: by contact (T, 3) or (T, k, 3) [N], of the run and of the tighter one; NaN from a failure on.
        rates: by contact (T,) or (T, k) rates of the penetration [m/s] of both runs; a contact may be missing.
        more: ``tolerance`` and ``wall_s`` of ``Accuracy``.
    """
    late = times >= begin
    if np.count_nonzero(late) < 2:
        begin, late = 0.0, times >= times[0]
    times = times[late]
    pressed = {
        name: _pressed(force[name][late]) & _pressed(finer[name][late]) for name in rates[0].keys() & force.keys()
    }
    moves, others = ({name: x[late] for name, x in side.items()} for side in rates)
    parts, parts_at = parted(times, moves, others, pressed)
    rms, peaks, impulse = {}, {}, {}
    first, differs = float("nan"), ""
    for name in force:
        ours, truth = (side[name][late].reshape(times.size, -1, 3) for side in (force, finer))
        rms[name], peaks[name], impulse[name] = shares(ours, truth, times)
        if name in moves and name in others and name != parts_at and not np.any(ours) and not np.any(truth):
            a, b = (np.nan_to_num(side[name].reshape(times.size, -1)) for side in (moves, others))
            rms[name] = _share(np.sqrt(np.mean(np.square(a - b), axis=0)).max(), np.abs(b).max())
        off, peak = ours - truth, _peak(truth)
        # Not ``>``: NaN is no agreement.
        apart = times[~(np.abs(off).max(axis=(1, 2)) <= FACTOR * asked * peak)]
        if apart.size and not apart[0] >= first:
            first, differs = float(apart[0]), name
    return Accuracy(
        asked=asked, begin=float(begin), rms=rms, peak=peaks, impulse=impulse, agree_until=first, differs=differs,
        parts=parts, parts_at=parts_at, **more,
    )  # fmt: skip


def shares(ours: np.ndarray, truth: np.ndarray, times: np.ndarray) -> tuple[float, float, float]:
    """Errors of a contact's forces (T, k, 3), see ``Accuracy``: rms, of the peak, of the impulse."""
    off, tops = ours - truth, [np.abs(side[..., 0]).max(axis=0) for side in (ours, truth)]
    pushed = np.trapezoid(np.abs(truth), times, axis=0).max()
    return (
        _share(np.sqrt(np.mean(np.square(off), axis=0)).max(), _peak(truth)),
        _share(np.abs(tops[0] - tops[1]).max(), _peak(truth)),
        _share(np.abs(np.trapezoid(off[..., 0], times, axis=0)).max(), pushed),
    )


def _peak(truth: np.ndarray) -> float:
    # The forces before a failure still say until when the two agree. A signed contact that presses on both sides alike, by a
    # preload, has no normal force to read, but friction.
    return float(np.nanmax(np.abs(truth), initial=0.0))


def _pressed(force: np.ndarray) -> np.ndarray:
    """Whether members touch, (T, k), by forces (T, 3) or (T, k, 3)."""
    return force.reshape(len(force), -1, 3)[..., 0] > 0.0


def parted(
    times: np.ndarray,
    ours: Mapping[str, np.ndarray],
    truth: Mapping[str, np.ndarray],
    pressed: Mapping[str, np.ndarray],
) -> tuple[float, str]:
    """When and at which contact the bodies of two runs part in one event; NaN and "" where they do not.

    Errors grow from event to event, in a chaotic motion by some ten times each. An event that one run has alone is told from
    that: bodies that moved alike, to ``ALIKE`` of the greatest rate, move otherwise by ``APART`` of it from there on. By contact
    rates (T,) or (T, k) of the penetration [m/s], and whether both runs press, (T, k): a load that stays on has small rates,
    which steps of another length ring in otherwise, and its forces are compared themselves.
    """
    first, contact = float("nan"), ""
    for name in ours.keys() & truth.keys():
        a, b = (np.nan_to_num(side[name].reshape(times.size, -1)) for side in (ours, truth))
        off, greatest = np.abs(a - b), max(np.abs(a).max(), np.abs(b).max())
        apart = (off > APART * greatest) & ~pressed.get(name, np.zeros((1, 1), bool))
        # A contact that is a little earlier in one run lasts less than two samples, or has alike rates within it.
        lasting = apart[:-1] & apart[1:]
        for member in np.flatnonzero(lasting.any(axis=0)):
            k = int(np.argmax(lasting[:, member]))
            alike = off[: max(k - 1, 0), member] <= ALIKE * greatest
            if alike.all() and not times[k] >= first:
                first, contact = float(times[k]), name
    return first, contact


def _share(part: float, whole: float) -> float:
    """A part of a whole; of no whole 0 for no part."""
    with np.errstate(divide="ignore"):
        return 0.0 if part == 0.0 else float(np.float64(part) / whole)
