"""Poincaré sections: a driven scene once per revolution of its drive, an undriven one at every touch.

    P : y(t_k) -> y(t_k + T),   T = 2 pi/|drive_speed|,   t_k = (k + phase/2 pi) T

(the stroboscopic section; Guckenheimer and Holmes 1983, section 1.5). ``impact`` and ``bounce`` have no drive: their
section is the surface itself, crossed inwards, and what is read there is the approach speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import ArrayLike

from bcfj_jax.analysis.features import contact_times
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import Quantity, scalar, whole
from bcfj_jax.core.settings import taking
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, as_model
from bcfj_jax.solve.plan import Solving, SolvingKeys
from bcfj_jax.solve.simulation import simulate


class Section(NamedTuple):
    """What a driven scene reads once per revolution, at N instants; NaN from a failure on.

    Attributes:
        times: (N,) [s].
        states: (N, n) flat states, as ``joint.system`` reads them.
        force: per contact (N, 3), or (N, balls, 3): normal, axial, tangential [N].
        penetration, rate: per contact (N,), or (N, balls): [m], [m/s].
        reason: why the run failed; "" for a good one.
    """

    times: np.ndarray
    states: np.ndarray
    force: dict[str, np.ndarray]
    penetration: dict[str, np.ndarray]
    rate: dict[str, np.ndarray]
    reason: str


class Impacts(NamedTuple):
    """Successive touches of one contact: times [s] and approach speeds [m/s], (N,) each."""

    times: np.ndarray
    speeds: np.ndarray


# Of a drive that swings [s]: a number, or a function of the parameters.
Period = float | Callable[[Params], ArrayLike] | None


def drive_period(scene: AbstractModel, params: Params, period: Period = None) -> float:
    """Duration of one revolution of the drive [s], or the period that is given.

    Raises:
        InputError: for a scene without a drive, or without a history (a fidelity that is no ``dynamic`` one), for a
            drive that stands still or swings with no period given, and for a period that is not positive.
    """
    if period is None:
        return scene.period(params)[0]
    found = float(np.asarray(period(params) if callable(period) else period))
    if not 0.0 < found < math.inf:
        raise InputError("period", f"{found:g} s", "give a time that is positive")
    return found


_PHASE = Quantity("phase", "rad", "drive angle of the section", 0.0, math.nextafter(2.0 * math.pi, 0.0))


class SectioningKeys(SolvingKeys, total=False):
    """``Sectioning`` as keywords."""

    transients: int
    phase: float
    period: Period


@dataclass(frozen=True)
class Sectioning(Solving):
    """Settings of ``stroboscopic``."""

    transients: int = 20
    phase: float = 0.0
    period: Period = None

    def turns(self, revolutions: int) -> np.ndarray:
        """Drive angles of the section over 2 pi, (N,): transients, transients + 1 .. revolutions, each plus the phase.

        Raises:
            InputError: for a phase outside [0, 2 pi), a negative number of transients, and for nothing to keep.
        """
        phase = scalar("section", _PHASE, self.phase)
        revolutions = whole("revolutions", revolutions, most=limits.SAMPLES)
        transients = whole("transients", self.transients, least=0)
        if revolutions < max(transients, 1):
            found = f"{revolutions} revolutions, of which {transients} are transients"
            raise InputError("revolutions", found, "give more revolutions than transients")
        first = max(transients, 0 if phase > 0.0 else 1)
        return np.arange(first, revolutions + 1) + phase / (2.0 * math.pi)


@taking(Sectioning)
def stroboscopic(
    scene: AbstractModel, params: Params, revolutions: int = 40, **settings: Unpack[SectioningKeys]
) -> Section:
    """States and contact readings of a driven scene, once per revolution of its drive.

    Sampled by the drive's phase: with a ``flexible`` drive the seat itself is ahead or behind. The load must have
    risen (``load_ramp``) before the transients are over, or the section sees it rise.

    Args:
        scene, params, accuracy, max_steps: as ``simulate``.
        revolutions: of the whole run.
        transients: of which so many are not kept.
        phase: drive angle of the section [rad], 0 to 2 pi.
        period: of a drive that swings: [s], or a function of the parameters.

    Raises:
        InputError: ``drive_period``, ``Sectioning.turns``, ``simulate``.
    """
    params = inputs.parameters(as_model(scene), params, traced=False)
    asked = Sectioning(**settings)
    times = asked.turns(revolutions) * drive_period(scene, params, asked.period)
    run = simulate(scene, params, times, accuracy=asked.accuracy, max_steps=asked.max_steps)
    assert run.trajectory is not None
    return Section(run.times, run.trajectory, run.force, run.penetration, run.rate, run.reason)


def impacts(times: ArrayLike, penetration: ArrayLike, rate: ArrayLike) -> Impacts:
    """Approach speed at every touch of a contact, from its history in samples that resolve flights.

    The touch is the start that ``features.contact_times`` finds. What comes before a touch knows nothing of it, so from the
    last two samples apart, t_j and t_k, the flight is continued with constant acceleration a = (v_k - v_j)/(t_k - t_j):

        d_k + v_k s + a s^2/2 = 0,   speed = v_k + a s = sqrt(v_k^2 - 2 a d_k),

    exact under gravity; else wrong by a jerk's worth, O(h^2). With no second sample apart, a = 0. A contact at the
    first sample has no approach and is left out.

    Args:
        times, penetration, rate: (T,) [s], [m] (negative: gap), [m/s], as in a ``Run``.
    """
    t, d, v = (np.asarray(x, dtype=float) for x in (times, penetration, rate))
    starts = [start for start, _ in contact_times(t, d, v)]
    found: list[tuple[float, float]] = []
    for start in starts:
        k = int(np.searchsorted(t, start, side="right")) - 1
        # At a root the Hermite cubic may be a rounding beyond the sample that is pressed.
        k -= k > 0 and d[k] > 0
        if d[k] > 0:
            continue
        j = k - 1
        still = j >= 0 and d[j] <= 0
        acceleration = (v[k] - v[j]) / (t[k] - t[j]) if still else 0.0
        # A flight that began within the interval has turned round in it: no constant acceleration.
        if still and v[j] > 0 > v[k]:
            acceleration = 0.0
        square = v[k] ** 2 - 2.0 * acceleration * d[k]
        speed = math.sqrt(square) if square > 0.0 else max(v[k], 0.0)
        if acceleration != 0.0 and speed > 0.0:
            start = t[k] + (speed - v[k]) / acceleration
        found.append((start, speed))
    both = np.asarray(found).reshape(-1, 2)
    return Impacts(both[:, 0], both[:, 1])


def period_number(values: ArrayLike, tolerance: float, most: int = 16) -> int:
    """Of how many points a settled section (N,) or (N, m) consists: the least p with |x_(k+p) - x_k| <= tolerance for all k.

    ``most``: the largest p tried; p needs N >= 2 p. 0 where there is none: a longer period, quasi-periodic, chaotic, or a
    section that failed.
    """
    x, most = np.asarray(values, dtype=float), whole("most", most)
    for p in range(1, min(most, len(x) // 2) + 1):
        # NaN compares false, so that a failed section has no period.
        if np.all(np.abs(x[p:] - x[:-p]) <= tolerance):
            return p
    return 0
