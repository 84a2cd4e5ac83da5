"""How wrong a run is against another: each error relative, the worst over contacts. NumPy.

| error | of a contact | over |
|---|---|---|
| ``force_rms_error`` | rms over the times of the difference, the worst member's worst component | its peak |
| ``peak_error`` | difference of the largest normal force, worst member | its peak |
| ``impulse_error`` | integral of the difference of normal forces, worst member | largest member's integral of force |
| ``period_error`` | difference of the period, members that carry a tenth of the contact's peak or more | the period |
| ``dissipated_error`` | difference of the work on all members | the same of all contacts |

A contact's peak is the reference's largest normal force over the times and its members. The period is the mean interval
of contacts, of a scene that turns that of the force's history (``histories.period``, last two thirds); nan where the
reference has none, 1 where only the reference has one. The work on a contact is the integral of F dd + |F_friction| slip
dt over the run, so that what is still stored at its end counts; nan for a scene that loses less than a millionth of what
it moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.io.outputs import channels
from bcfj_jax.solve.measured_error import shares
from bcfj_jax.solve.simulation import Run

NAMES = ("force_rms_error", "peak_error", "impulse_error", "period_error", "dissipated_error")
# What a budget is about.
MAIN = NAMES[:3]
_CARRIES, _LOSES = 0.1, 1e-6


class Measured(NamedTuple):
    """What of a run is compared, C channels, a contact's members one by one: force (T, C, 3) [N]; (C,) which contact a channel
    belongs to, its period [s], NaN for none, its work [J], and the same with every sign positive.
    """

    force: np.ndarray
    contact: np.ndarray
    period: np.ndarray
    work: np.ndarray
    moved: np.ndarray


def measured(run: Run, times: np.ndarray, turning: bool) -> Measured:
    """A good run's forces at times (T,) [s], straight lines between its own where these differ; the rest on its own."""
    force, depth, rate = channels(run.force, 1), channels(run.penetration), channels(run.rate)
    slip = channels(run.slip)
    owners = [k for k, part in enumerate(run.force.values()) for _ in range(part.shape[1] if part.ndim == 3 else 1)]
    stacked = np.stack(list(force.values()), axis=1)
    period, work, moved = [], [], []
    for name, part in force.items():
        normal = np.abs(part[:, 0])
        step = 0.5 * (normal[1:] + normal[:-1]) * np.diff(depth[name])
        rubbed = 0.0
        if name in slip:
            rubbed = np.trapezoid(np.hypot(part[:, 1], part[:, 2]) * slip[name], run.times)
        work.append(step.sum() + rubbed)
        moved.append(np.abs(step).sum() + rubbed)
        seen = features.Seen(run.times, normal, depth[name], rate[name], turning=turning)
        period.append(features.KINDS["period"].of(seen))
    if len(times) != len(run.times):
        flat = stacked.reshape(len(run.times), -1)
        stacked = np.stack([np.interp(times, run.times, x) for x in flat.T], 1).reshape(len(times), *stacked.shape[1:])
    return Measured(stacked, np.array(owners), np.array(period), np.array(work), np.array(moved))


def compared(
    found: Measured, names: Sequence[str], truth: Measured, wanted: Sequence[str]
) -> tuple[Measured, Measured]:
    """What two models with contacts of these names have in common, contacts numbered as in ``wanted``."""
    if list(names) == list(wanted):
        return found, truth
    return _of(found, names, wanted), _of(truth, wanted, names)


def _of(one: Measured, names: Sequence[str], others: Sequence[str]) -> Measured:
    both: list[str] = [name for name in names if name in others]
    owners = [names[int(k)] for k in one.contact]
    keep = np.array([owner in both for owner in owners])
    number = np.array([both.index(owner) for owner in owners if owner in both])
    return Measured(one.force[:, keep], number, one.period[keep], one.work[keep], one.moved[keep])


def peak_change(found: Measured, truth: Measured) -> tuple[int, float] | None:
    """The contact whose peak moves by the most newtons, so that none that bears next to nothing stands for the model, and
    its relative change. None where no contact has a peak.
    """
    tops = [np.abs(x.force[..., 0]).max(axis=0) for x in (found, truth)]
    ours, theirs = (np.array([top[truth.contact == k].max() for k in np.unique(truth.contact)]) for top in tops)
    moved = np.where((theirs > 0.0) & np.isfinite(ours), np.abs(ours - theirs), -1.0)
    most = int(np.argmax(moved)) if moved.size else -1
    return (most, float(ours[most] / theirs[most] - 1.0)) if most >= 0 and moved[most] >= 0.0 else None


def errors(found: Measured, truth: Measured, times: np.ndarray) -> dict[str, float]:
    """Every error of ``NAMES``, see the top of the file."""
    owner, contacts = truth.contact, np.unique(truth.contact)
    each = [shares(found.force[:, owner == k], truth.force[:, owner == k], times) for k in contacts]
    tops = np.abs(truth.force[..., 0]).max(axis=0)
    peak = np.array([tops[owner == k].max() for k in owner])
    with np.errstate(invalid="ignore", divide="ignore"):
        late = np.abs(found.period / truth.period - 1.0)
    late = np.where(np.isnan(late), 1.0, late)[np.isfinite(truth.period) & (tops >= _CARRIES * peak) & (peak > 0)]
    worst = {name: float(np.max(row)) for name, row in zip(MAIN, zip(*each, strict=True), strict=True)}
    worst["period_error"] = float(late.max()) if late.size else float("nan")
    return worst | {"dissipated_error": _dissipated(found, truth)}


def _dissipated(found: Measured, truth: Measured) -> float:
    ours, theirs = (np.bincount(x.contact, x.work) for x in (found, truth))
    total = float(np.abs(theirs).sum())
    if total <= _LOSES * truth.moved.sum():
        return float("nan")
    return float(np.max(np.abs(ours - theirs)) / total)


def derivative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """Worst over parameters of the rms difference of (P, T, C, 3) over the rms of the truth; parameters in any unit."""
    off, size = (np.sqrt(np.mean(np.square(x), axis=(1, 2, 3))) for x in (found - truth, truth))
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(np.max(np.where((off == 0) & (size == 0), 0.0, off / size)))


def worst(row: dict) -> float:
    """The worst of ``MAIN``; nan if one is unknown."""
    return float(np.max([row[name] if row.get(name) is not None else np.nan for name in MAIN]))
