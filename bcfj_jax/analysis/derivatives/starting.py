"""Features of a start, of any contact whose force comes to a settled course; on the host, from samples.

| feature | of one contact | of members |
|---|---|---|
| ``onset`` | time at which the force first has 5 % of its settled peak, linear between samples | the first one's |
| ``start_window`` | the same | the last one's: by then all of them have borne load |
| ``settling`` | time from which the force repeats itself a period later within 5 % of its settled peak | the last one's |

The settled peak of an onset is the greatest size in the last third of the run, that of ``settling`` the greatest in the last period
(``histories.settling_time``). Times count from the run's first sample at 0. NaN for a force that stays 0, and, of
``settling``, for one without a period, for a run shorter than two, and where fewer than a whole period is repeated. The
paper's Q29 is the difference of the onsets of two contacts, Q30 a start-up window, Q31 a settling time.

An onset moves by  dt = (0.05 dP - dF)/F'  with the settled peak P and the force F of the parameters; a settling time jumps
from sample to sample and has no derivative (NaN).
"""  # noqa: E501

from __future__ import annotations

import math

import numpy as np

from bcfj_jax.analysis import features, histories
from bcfj_jax.core.errors import InputError

# Share of its settled peak at which a contact's load has begun; and within which a settled force repeats itself.
BEGUN = SETTLED = 0.05
START = ("onset", "start_window", "settling")


def starting(
    kind: str, times: np.ndarray, force: np.ndarray, slope: np.ndarray, period: float = math.nan
) -> tuple[float, np.ndarray]:
    """A feature of ``START`` of one channel and its derivative.

    Args:
        kind: which.
        times, force: (T,) [s], normal force [N].
        slope: (P, T) derivatives of the force.
        period: of the settled force [s], for ``settling``.
    """
    unknown = np.full(len(slope), np.nan)
    if not np.isfinite(force).all():
        return math.nan, unknown
    if kind == "settling":
        try:
            return histories.settling_time(times, force, period, SETTLED), unknown
        except InputError:
            return math.nan, unknown
    at = features.onset_time(times, force, BEGUN)
    if not math.isfinite(at):
        return math.nan, unknown
    k = int(np.searchsorted(times, at))
    if k == 0:
        return at, np.zeros(len(slope))
    size, change = np.abs(force), slope * np.sign(force)
    late = int(np.searchsorted(times, times[0] + 2.0 * (times[-1] - times[0]) / 3.0))
    step, top = times[k] - times[k - 1], late + int(np.argmax(size[late:]))
    share = (at - times[k - 1]) / step
    moved = (1.0 - share) * change[:, k - 1] + share * change[:, k]
    return at, (BEGUN * change[:, top] - moved) * step / (size[k] - size[k - 1])


def of_members(kind: str, found: list[tuple[float, np.ndarray]]) -> tuple[float, np.ndarray]:
    """The first member's onset, the last one's of the others; of members that are known."""
    known = [one for one in found if math.isfinite(one[0])]
    if not known or (kind != "onset" and len(known) < len(found)):
        return math.nan, np.full_like(found[0][1], np.nan)
    return (min if kind == "onset" else max)(known, key=lambda one: one[0])
