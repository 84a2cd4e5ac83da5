"""The model's value for every figure of the paper that a run of the model can give.

Read from the run as the paper read its own: output every millisecond, peaks over the whole run, start-up included;
periods and delays over its later part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis import features, histories
from bcfj_jax.analysis.derivatives.starting import SETTLED, of_members, starting
from bcfj_jax.core.errors import InputError
from bcfj_jax.reproduction.claims import claim
from bcfj_jax.reproduction.frames import ORDER, WINDOW_AXIAL, WINDOW_NORMAL, later
from bcfj_jax.reproduction.record import Balance
from bcfj_jax.solve.simulation import Run

# How many times the other components a force must be to be "far above" them.
FAR_ABOVE = 5.0
# Of ball centres [m].
RIM = 35.5e-3


def onset_remark() -> str:
    """What play gives the paper's onsets if the drive comes up to speed by a STEP until the joint is stable (Q31).

    The rim moves by  w R (s^3 - s^4/2) T  with s = t/T (ADAMS' STEP s^2 (3 - 2 s) integrated).
    """
    rise, speed = claim("Q31").values[0], claim("Q14").values[0]

    def moved(time: float) -> float:
        s = time / rise
        return speed * RIM * rise * (s**3 - 0.5 * s**4)

    first, second = moved(0.042), moved(0.082)
    return (
        f"A drive raised by ADAMS' STEP over {rise:g} s closes a play of {1e6 * first:.0f} um at the rim in 0.042 s and of "
        f"{1e3 * second:.2f} mm in 0.082 s: the numbers can be had, by guesses"
    )


class Measured(NamedTuple):
    """The model's numbers for a claim, in its unit (NaN: none), and what must be known to read them."""

    values: tuple[float, ...]
    remark: str = ""


class Inequality(NamedTuple):
    """One of the qualitative claims: what is said, whether the model does so (None: unknown), the numbers."""

    text: str
    holds: bool | None
    numbers: str


def resultant(force: np.ndarray) -> np.ndarray:
    """Length of (normal, axial, tangential), which are at right angles."""
    return np.sqrt(np.sum(force * force, axis=-1))


def measure(run: Run, balance: Balance, turn: float, fine: Run | None = None) -> dict[str, Measured]:
    """Values for the figures Q17 to Q36, forces as each contact resolves them (``frames`` has other axes).

    Args:
        run: the joint's, at even times.
        balance: of the cage.
        turn: time of one revolution [s].
        fine: the same run with more times in it, for peaks and onsets.
    """
    fine = fine or run
    found = _rhythm(run, turn) | _peaks(fine) | _start(run, fine, turn) | _residuals(run)
    rest = float(np.linalg.norm(balance.forces - balance.inertia))
    sum_of_forces = float(np.linalg.norm(balance.forces))
    found["Q24"] = Measured(
        (rest,),
        f"at t = {balance.time:g} s; sum of forces {sum_of_forces:.2g} N; acceleration from the cage's velocity at "
        "neighbouring instants, so that the run is tested and not its own right-hand side",
    )
    return found


def _period(times: np.ndarray, values: np.ndarray) -> float:
    return histories.period(times, values, later(times))


def _rhythm(run: Run, turn: float) -> dict[str, Measured]:
    t, seat, head = run.times, run.force["seat_cage"], run.force["head_cage"]
    cage = tuple(_period(t, seat[:, k]) for k in range(3))
    repeats = cage[0]
    share = turn / repeats if math.isfinite(repeats) else math.nan
    why = ""
    if math.isfinite(share) and abs(share - round(share)) < 0.02 and round(share) > 1:
        why = f"equal balls follow each other: the cage's load repeats {round(share)} times a turn"
    spread = max(cage) - min(cage) if np.isfinite(cage).all() else math.nan
    first = run.force["seat_ball"][:, 0, 0]
    ball = _period(t, first)
    window = later(t)
    base = repeats if math.isfinite(repeats) else turn
    apart = _delay(t, seat[:, 0], head[:, 0], base, window)
    lags = f"known up to whole periods of {base:.4g} s" if math.isfinite(apart) else ""
    return {
        "Q17": Measured(cage, why),
        "Q18": Measured((spread,), "greatest less smallest of Q17"),
        "Q19": Measured((1.0 / repeats,), why),
        "Q22": Measured((apart,), lags),
        "Q25": Measured((ball, 1.0 / ball)),
    }


def _delay(t: np.ndarray, first: np.ndarray, second: np.ndarray, period: float, window: tuple[float, float]) -> float:
    try:
        return float(histories.delay(t, first, second, period, window))
    except InputError:
        return math.nan


def _members(peaks: np.ndarray) -> str:
    best = [str(k + 1) for k in np.flatnonzero(peaks >= 0.999 * peaks.max())]
    return "all balls alike" if len(best) == peaks.size else f"ball {' and '.join(best)}"


def _peaks(run: Run) -> dict[str, Measured]:
    window, seat, head = (run.force[name] for name in ("cage_ball", "seat_ball", "head_ball"))
    into, out = resultant(seat), resultant(head)
    return {
        "Q20": Measured((float(np.max(run.force["seat_cage"][:, 0])),)),
        "Q21": Measured((float(np.max(run.force["head_cage"][:, 0])),)),
        "Q23": Measured((float(np.min(window[..., 0])), float(np.max(window[..., 0])))),
        "Q26": Measured((float(np.max(into)),), _members(np.max(into, axis=0))),
        "Q27": Measured((float(np.max(out)),), _members(np.max(out, axis=0))),
        "Q28": Measured((float(features.transfer_loss(into, out)),)),
    }


def _started(kind: str, times: np.ndarray, forces: np.ndarray, turn: float) -> float:
    """A feature of ``starting`` [s] of the members' forces (T, k)."""
    none = np.zeros((0, times.size))
    return of_members(kind, [starting(kind, times, force, none, turn) for force in forces.T])[0]


def _parted(run: Run) -> float:
    """First time from which both pilots bear without a break [s]; NaN where they part in the later run, too."""
    free = np.zeros(run.times.size, bool)
    for name in ("seat_cage", "head_cage"):
        free |= run.penetration[name] <= 0
    last = int(np.flatnonzero(free)[-1]) + 1 if free.any() else 0
    return float(run.times[last]) if last < run.times.size and run.times[last] <= later(run.times)[0] else math.nan


def _start(run: Run, fine: Run, turn: float) -> dict[str, Measured]:
    """Onsets, start-up window and settling."""
    t, force = run.times, run.force["seat_ball"][..., 0]
    first, second = (
        _started("onset", fine.times, resultant(fine.force[name]), turn) for name in ("seat_ball", "head_ball")
    )
    settled = _started("settling", t, force, turn)
    return {
        "Q29": Measured(
            (second - first,),
            f"loads begin at {1e3 * first:.3g} ms at point 4 and {1e3 * second:.3g} ms at point 5",
        ),
        "Q30": Measured((_parted(fine),), "both pilots bear without a break from there"),
        "Q31": Measured((settled,), f"every ball repeats itself within {SETTLED:.0%} of its peak from there"),
    }


def _residuals(run: Run) -> dict[str, Measured]:
    found = {}
    for name, axis, window in (("Q35", 0, WINDOW_NORMAL), ("Q36", 1, WINDOW_AXIAL)):
        if run.times[-1] < window[1]:
            found[name] = Measured((math.nan,), "the run ends before the window does")
            continue
        size = features.residual_oscillation(run.times, run.force["seat_cage"][:, axis], window, ORDER)
        found[name] = Measured(
            (float(size),), "half of greatest less smallest residual; a load that repeats itself "
            "more often than the polynomial bends counts as residual",
        )  # fmt: skip
    return found


def inequalities(run: Run, turn: float, tight: Run | None) -> list[Inequality]:
    """The qualitative claims Q37, each as an inequality.

    Args:
        run: the joint's.
        turn: time of one revolution [s].
        tight: the same with smaller clearances, if it was run.
    """
    rows = []
    for point, name in ((1, "seat_cage"), (2, "head_cage")):
        normal, axial, tangential = np.max(np.abs(run.force[name]), axis=0)
        others = max(axial, tangential)
        rows.append(
            Inequality(
                f"point {point}: normal far above axial and tangential (at least {FAR_ABOVE:g} times)",
                bool(normal >= FAR_ABOVE * others),
                f"{normal / 1e3:.4g} kN against {others / 1e3:.4g} kN",
            )
        )
    rows.append(_smoother_balls(run))
    rows.append(_wear(run, turn))
    if tight is not None:
        rows += _clearance(run, tight)
    return rows


def residuals(run: Run) -> dict[str, tuple[float, float]]:
    """By contact the residual of the polynomial's fit in the window of Q33: rms [N], and rms over the mean fit.

    Of ball 1 in the grooves. Empty for a run that ends before the window does.
    """
    if run.times[-1] < WINDOW_NORMAL[1]:
        return {}
    found = {}
    for name in ("seat_cage", "head_cage", "seat_ball", "head_ball"):
        force = run.force[name][..., 0]
        force = force if force.ndim == 1 else force[:, 0]
        left = features.oscillation(run.times, force, WINDOW_NORMAL, ORDER)
        found[name] = (float(left.rms), float(left.relative))
    return found


def _smoother_balls(run: Run) -> Inequality:
    """One claim, two measures, and no verdict unless they agree."""
    text = "residual of ball on groove below that of cage on seat (in newtons, and relative to the mean fit)"
    found = residuals(run)
    if not found:
        return Inequality(text, None, "the run ends before the window does")
    ball, cage = found["seat_ball"], found["seat_cage"]
    absolute, relative = ball[0] < cage[0], ball[1] < cage[1]
    numbers = f"rms {ball[0] / 1e3:.3g} kN against {cage[0] / 1e3:.3g} kN, relative {ball[1]:.3g} against {cage[1]:.3g}"
    if absolute == relative:
        return Inequality(text, absolute, numbers)
    holds = "relative to the mean" if relative else "in newtons"
    return Inequality(text, None, f"{numbers}: holds {holds} only, and the paper does not say which it means")


def _wear(run: Run, turn: float) -> Inequality:
    """Archard: wear goes with the integral of F |v| dt; per ball, over the last turn."""
    late = run.times >= run.times[-1] - turn * (1 + 1e-9)
    work = {}
    for name in ("seat_ball", "head_ball"):
        power = run.force[name][late][..., 0] * np.abs(run.slip[name][late])
        work[name] = float(np.max(np.trapezoid(power, run.times[late], axis=0)))
    inner, outer = work["head_ball"], work["seat_ball"]
    return Inequality(
        "first wear between ball and inner race (integral of force times sliding over a turn, head against seat)",
        inner > outer,
        f"{inner:.4g} J against {outer:.4g} J",
    )


def _clearance(run: Run, tight: Run) -> list[Inequality]:
    rows = []
    for name in ("seat_cage", "head_cage"):
        counts = []
        for r in (run, tight):
            # While the load rises the spheres chatter, a sample long: chance, and not what is claimed.
            late = features.within(r.times, later(r.times))
            pressed = r.penetration[name][late] > 0
            counts.append(int(np.sum(pressed[1:] & ~pressed[:-1])))
        peaks = [float(np.max(r.force[name][:, 0])) for r in (run, tight)]
        rows.append(
            Inequality(
                f"{name}: larger clearance gives fewer contacts", counts[0] < counts[1] if any(counts) else None,
                f"{counts[0]} against {counts[1]} with a tenth of the clearances" if any(counts)
                else "once loaded, the spheres do not part with either",
            )
        )  # fmt: skip
        rows.append(
            Inequality(
                f"{name}: larger clearance gives a higher peak", peaks[0] > peaks[1],
                f"{peaks[0] / 1e3:.4g} kN against {peaks[1] / 1e3:.4g} kN with a tenth of the clearances",
            )
        )  # fmt: skip
    return rows
