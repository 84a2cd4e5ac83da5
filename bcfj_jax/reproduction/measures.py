"""The model's value for every figure of the paper that a run of the model can give.

Read from the run as the paper read its own: output every millisecond, peaks over the whole run, start-up included;
periods and delays over its later part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis import features, histories
from bcfj_jax.core.errors import InputError
from bcfj_jax.reproduction.claims import claim
from bcfj_jax.reproduction.record import Balance
from bcfj_jax.solve.simulation import Run

# Share of the run that counts as its start.
_EARLY = 0.4
# How many times the other components a force must be to be "far above" them.
FAR_ABOVE = 5.0
ORDER = int(claim("Q32").values[0])
WINDOW_NORMAL = (claim("Q33").values[0], claim("Q33").values[1])
WINDOW_AXIAL = (claim("Q34").values[0], claim("Q34").values[1])
SETTLED_WITHIN = 0.05


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


def later(times: np.ndarray) -> tuple[float, float]:
    """The window of the settled joint."""
    return float(times[0] + _EARLY * (times[-1] - times[0])), float(times[-1])


def measure(run: Run, balance: Balance, turn: float) -> dict[str, Measured]:
    """Values for the figures Q17 to Q36.

    Args:
        run: the joint's.
        balance: of the cage.
        turn: time of one revolution [s].
    """
    found = _rhythm(run, turn) | _peaks(run) | _start(run, turn) | _residuals(run)
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
    passed = [
        _delay(t, run.force["seat_ball"][:, k, 0], run.force["head_ball"][:, k, 0], turn, window)
        for k in range(run.force["seat_ball"].shape[1])
    ]
    lags = f"known up to whole periods of {base:.4g} s" if math.isfinite(apart) else ""
    return {
        "Q17": Measured(cage, why),
        "Q18": Measured((spread,), "greatest less smallest of Q17"),
        "Q19": Measured((1.0 / repeats,), why),
        "Q22": Measured((apart,), lags),
        "Q25": Measured((ball, 1.0 / ball)),
        "Q29": Measured((max(passed, key=abs),), "greatest of the balls'; both tracks bear a ball at once"),
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


def _start(run: Run, turn: float) -> dict[str, Measured]:
    t, force = run.times, run.force["seat_ball"][..., 0]
    balls = range(force.shape[1])
    try:
        begun = [histories.start_up_time(t, force[:, k], period=turn) for k in balls]
        settled = [histories.settling_time(t, force[:, k], turn, SETTLED_WITHIN) for k in balls]
    except InputError:
        begun = settled = [math.nan]
    return {
        "Q30": Measured((min(begun),), "first ball at half its settled peak; set by load_ramp, a GUESS"),
        "Q31": Measured(
            (max(settled),), f"every ball repeats itself within {SETTLED_WITHIN:.0%} of its peak from there"
        ),
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


def _smoother_balls(run: Run) -> Inequality:
    text = "residual of ball on groove below that of cage on seat (rms over mean fit, window of Q33)"
    if run.times[-1] < WINDOW_NORMAL[1]:
        return Inequality(text, None, "the run ends before the window does")
    ball, cage = (
        float(features.oscillation(run.times, force, WINDOW_NORMAL, ORDER).relative)
        for force in (run.force["seat_ball"][:, 0, 0], run.force["seat_cage"][:, 0])
    )
    return Inequality(text, ball < cage, f"{ball:.3g} against {cage:.3g}")


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
