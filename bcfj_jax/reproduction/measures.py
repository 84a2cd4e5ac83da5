"""The model's value for every figure of the paper that a run of the model can give.

Read from the run as the paper read its own: output every millisecond, peaks over the whole run, start-up included;
periods and delays over its later part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis import features, histories
from bcfj_jax.analysis.features import KINDS, SETTLED, Seen
from bcfj_jax.reproduction.claims import claim
from bcfj_jax.reproduction.frames import ORDER, WINDOW_NORMAL, later, rhythm
from bcfj_jax.reproduction.record import Balance
from bcfj_jax.solve.simulation import Run

# How many times the other components a force must be to be "far above" them.
FAR_ABOVE = 5.0
# Of ball centres [m].
RIM = 35.5e-3


def onset_remark() -> str:
    """What play gives the paper's onsets if the drive comes up to speed by a STEP until the joint is stable (Q31): the rim
    moves by w R (s^3 - s^4/2) T with s = t/T (ADAMS' STEP s^2 (3 - 2 s) integrated).
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

    ``turn`` is the time of one revolution [s]; ``fine`` the same run with more times in it, for peaks and onsets.
    """
    fine = fine or run
    rest, whole = (float(np.linalg.norm(x)) for x in (balance.forces - balance.inertia, balance.forces))
    return {
        **_rhythm(run, turn),
        **_peaks(fine),
        **_start(run, fine, turn),
        "Q24": Measured(
            (rest,),
            f"at t = {balance.time:g} s; sum of forces {whole:.2g} N; acceleration from the cage's velocity at "
            "neighbouring instants, so that the run is tested and not its own right-hand side",
        ),
    }


def _rhythm(run: Run, turn: float) -> dict[str, Measured]:
    t = run.times
    found = rhythm(t, run.force["seat_cage"], run.force["head_cage"], turn)
    repeats, apart = found["Q17"][0], found["Q22"][0]
    share, why = turn / repeats, ""
    if math.isfinite(share) and abs(share - round(share)) < 0.02 and round(share) > 1:
        why = f"equal balls follow each other: the cage's load repeats {round(share)} times a turn"
    base = repeats if math.isfinite(repeats) else turn
    left = (
        "half of greatest less smallest residual; a load that repeats itself more often than the polynomial bends counts as "
        "residual"
    )
    remarks = {"Q17": why, "Q18": "greatest less smallest of Q17", "Q19": why}
    remarks["Q22"] = f"known up to whole periods of {base:.4g} s" if math.isfinite(apart) else ""
    for id in ("Q35", "Q36"):
        remarks[id] = left if math.isfinite(found[id][0]) else "the run ends before the window does"
    ball = histories.period(t, run.force["seat_ball"][:, 0, 0], later(t))
    return {id: Measured(found[id], text) for id, text in remarks.items()} | {"Q25": Measured((ball, 1.0 / ball))}


def _members(peaks: np.ndarray) -> str:
    best = [str(k + 1) for k in np.flatnonzero(peaks >= 0.999 * peaks.max())]
    return "all balls alike" if len(best) == peaks.size else f"ball {' and '.join(best)}"


def _peaks(run: Run) -> dict[str, Measured]:
    seat, head, least, greatest, *_ = six(run).tolist()
    into, out = (resultant(run.force[name]) for name in ("seat_ball", "head_ball"))
    return {
        "Q20": Measured((seat,)),
        "Q21": Measured((head,)),
        "Q23": Measured((least, greatest)),
        "Q26": Measured((float(np.max(into)),), _members(np.max(into, axis=0))),
        "Q27": Measured((float(np.max(out)),), _members(np.max(out, axis=0))),
        "Q28": Measured((float(features.transfer_loss(into, out)),)),
    }


def six(run: Run, every: int = 1) -> np.ndarray:
    """The six peaks of a run in the order of ``fit.TARGETS``, of every so many samples [N]."""
    force = {name: values[::every] for name, values in run.force.items()}
    window = force["cage_ball"][..., 0]
    grooves = [np.max(resultant(force[name])) for name in ("seat_ball", "head_ball")]
    pilots = [np.max(force[name][:, 0]) for name in ("seat_cage", "head_cage")]
    return np.array([*pilots, np.min(window), np.max(window), *grooves])


def _started(kind: str, times: np.ndarray, forces: np.ndarray, turn: float) -> float:
    each = [KINDS[kind].of(Seen(times, force, None, cycle=turn)) for force in forces.T]
    return float(KINDS[kind].members(np.array(each, dtype=float)))


def _parted(run: Run) -> float:
    """First time from which both pilots bear without a break [s]; NaN where they part in the later run, too."""
    free = (run.penetration["seat_cage"] <= 0) | (run.penetration["head_cage"] <= 0)
    last = int(np.flatnonzero(free)[-1]) + 1 if free.any() else 0
    return float(run.times[last]) if last < run.times.size and run.times[last] <= later(run.times)[0] else math.nan


def _start(run: Run, fine: Run, turn: float) -> dict[str, Measured]:
    first, second = (
        _started("onset", fine.times, resultant(fine.force[name]), turn) for name in ("seat_ball", "head_ball")
    )
    settled = _started("settling", run.times, run.force["seat_ball"][..., 0], turn)
    begin = f"loads begin at {1e3 * first:.3g} ms at point 4 and {1e3 * second:.3g} ms at point 5"
    return {
        "Q29": Measured((second - first,), begin),
        "Q30": Measured((_parted(fine),), "both pilots bear without a break from there"),
        "Q31": Measured((settled,), f"every ball repeats itself within {SETTLED:.0%} of its peak from there"),
    }


def inequalities(run: Run, turn: float, tight: Run | None) -> list[Inequality]:
    """The qualitative claims Q37, each as an inequality; ``tight`` is the run with smaller clearances."""
    rows = []
    for point, name in ((1, "seat_cage"), (2, "head_cage")):
        normal, *others = np.max(np.abs(run.force[name]), axis=0)
        text = f"point {point}: normal far above axial and tangential (at least {FAR_ABOVE:g} times)"
        numbers = f"{normal / 1e3:.4g} kN against {max(others) / 1e3:.4g} kN"
        rows.append(Inequality(text, bool(normal >= FAR_ABOVE * max(others)), numbers))
    return [*rows, _smoother_balls(run), _wear(run, turn), *([] if tight is None else _clearance(run, tight))]


def residuals(run: Run) -> dict[str, tuple[float, float]]:
    """By contact (ball 1 in the grooves) what the polynomial's fit in the window of Q33 leaves: rms [N], and rms over the
    mean fit. Empty for a run that ends before.
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
        counts, peaks = [], []
        for r in (run, tight):
            # While the load rises the spheres chatter, a sample long: chance, and not what is claimed.
            pressed = r.penetration[name][features.within(r.times, later(r.times))] > 0
            counts.append(int(np.sum(pressed[1:] & ~pressed[:-1])))
            peaks.append(float(np.max(r.force[name][:, 0])))
        met = f"{counts[0]} against {counts[1]} with a tenth of the clearances"
        fewer = counts[0] < counts[1] if any(counts) else None
        met = met if any(counts) else "once loaded, the spheres do not part with either"
        tops = f"{peaks[0] / 1e3:.4g} kN against {peaks[1] / 1e3:.4g} kN with a tenth of the clearances"
        rows.append(Inequality(f"{name}: larger clearance gives fewer contacts", fewer, met))
        rows.append(Inequality(f"{name}: larger clearance gives a higher peak", peaks[0] > peaks[1], tops))
    return rows
