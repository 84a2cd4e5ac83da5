"""The same imperfect records to SciPy, lmfit, MuJoCo's sysid and us: false intervals, their width, time to answer.

Records are those of ``imperfect``: an impact with one imperfection or two, none named to anyone. The peers get what a user
would write: the same law integrated by SciPy's LSODA in its natural coordinates (logarithms of stiffness and damping, the
exponent), a start a factor of three off, the box that we get, and the intervals that each tool prints. MuJoCo has no contact
K d^n of its own, and gets the residuals from the same function.

    python -m benchmarks.calibration.peers [--records 100] [--minutes 30]    keeps results/peers.json; needs the extra bench
"""

from __future__ import annotations

import contextlib
import io
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import benchmarks.common as harness
from benchmarks.calibration.imperfect import MAGNITUDES, MASS, STARTS, TRUTH, WORLDS, imperfections, problem
from benchmarks.clock import clocked, until
from benchmarks.common import options, publish, save
from calibration import Problem, fit

RUNS = (1, 4)
LOWER, UPPER = np.array([np.log(1e7), 1.0, np.log(1e-3)]), np.array([np.log(1e9), 2.5, np.log(1.0)])
START = np.array([np.log(3.3e7), 1.4, np.log(0.03)])
TRUE = np.array([np.log(TRUTH["stiffness"]), TRUTH["exponent"], np.log(TRUTH["damping"])])
NAMES = tuple(TRUTH)
Ends = list[tuple[float, float]]


def residuals_of(given: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """Prediction less record, in newtons, of (ln K, n, ln a)."""
    records = [(e.times, e.channels[0].values, e.fixed["approach_speed"]) for e in given.experiments]

    def residuals(at: np.ndarray) -> np.ndarray:
        k, n, a = np.exp(at[0]), at[1], np.exp(at[2])

        def force(d: Any, v: Any) -> Any:
            return k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * v, 0.0)

        found = []
        for times, values, speed in records:
            run = solve_ivp(
                lambda _, s: (s[1], -force(s[0], s[1]) / MASS), (0.0, times[-1]), (0.0, speed), "LSODA", t_eval=times,
                rtol=1e-8, atol=1e-12, max_step=times[-1] / 20.0,
            )  # fmt: skip
            found.append(force(run.y[0], run.y[1]) - values)
        return np.concatenate(found)

    return residuals


def by_scipy(given: Problem) -> Ends:
    """``least_squares`` and 1.96 deviations of s^2 (J^T J)^-1."""
    found = least_squares(residuals_of(given), START, bounds=(LOWER, UPPER), x_scale="jac")
    variance = 2.0 * found.cost / (found.fun.size - 3)
    half = 1.96 * np.sqrt(np.diag(variance * np.linalg.inv(found.jac.T @ found.jac)))
    return list(zip(found.x - half, found.x + half, strict=True))


def by_lmfit(given: Problem) -> Ends:
    """``minimize`` and 1.96 of the stderr that its report prints."""
    import lmfit

    params, residuals = lmfit.Parameters(), residuals_of(given)
    for name, start, low, high in zip(NAMES, START, LOWER, UPPER, strict=True):
        params.add(name, value=start, min=low, max=high)
    found: Any = lmfit.minimize(lambda p: residuals(np.array([p[name].value for name in NAMES])), params)
    ends = [(found.params[n].value, 1.96 * (found.params[n].stderr or np.nan)) for n in NAMES]
    return [(value - half, value + half) for value, half in ends]


def by_mujoco(given: Problem) -> Ends:
    """``sysid.optimize`` and ``calculate_intervals``."""
    from absl import logging
    from mujoco import sysid

    logging.set_verbosity(logging.ERROR)
    plain = residuals_of(given)
    params = sysid.ParameterDict()
    for name, start, low, high in zip(NAMES, START, LOWER, UPPER, strict=True):
        params.add(sysid.Parameter(name, start, low, high, modifier=lambda spec, p: None))

    def residual(x: np.ndarray, _: Any) -> tuple[list[np.ndarray], None, None]:
        columns = np.reshape(x, (3, -1))
        found = np.stack([plain(column) for column in columns.T], axis=1)
        return [found[:, 0] if np.ndim(x) == 1 else found], None, None

    with contextlib.redirect_stdout(io.StringIO()):
        found, result = sysid.optimize(params, residual, "mujoco", verbose=False, max_iters=100)
    at = found.as_vector()
    half = np.asarray(sysid.calculate_intervals([plain(at)], result.jac)[1])
    return list(zip(at - half, at + half, strict=True))


def by_us(given: Problem) -> dict[str, Ends]:
    """The interval of the noise, and the one to quote; NaN for none."""
    found = fit(given, starts=STARTS)
    rows: dict[str, Ends] = {"noise": [], "quoted": []}
    for name, p in found.parameters.items():
        for kind, ends in zip(rows, (p.intervals.get("noise"), p.ci95), strict=True):
            low, high = ends or (np.nan, np.nan)
            rows[kind].append((low, high) if name == "exponent" else (float(np.log(low)), float(np.log(high))))
    return rows


def judged(ends: Ends) -> dict[str, list[float]]:
    """Of each coefficient: 1 where the interval excludes the truth (NaN where there is none), and its width."""
    wrong = [
        float(not low <= true <= high) if np.isfinite(low + high) else np.nan
        for (low, high), true in zip(ends, TRUE, strict=True)
    ]
    return {"false": wrong, "width": [float(high - low) for low, high in ends]}


TOOLS = {"SciPy least_squares": by_scipy, "lmfit": by_lmfit, "mujoco.sysid": by_mujoco}


def one(world: str, deviations: float, runs: int, seed: int) -> dict[str, Any]:
    given, row = problem(imperfections(world, deviations, seed), runs, seed), {}
    for name, tool in TOOLS.items():
        ends, took = clocked(lambda tool=tool: tool(given))
        row[name] = {**judged(ends), "wall_s": took["wall_s"]}
    ours, took = clocked(lambda: by_us(given))
    row |= {f"bcfj-jax, {kind}": {**judged(ends), "wall_s": took["wall_s"]} for kind, ends in ours.items()}
    return {"world": world, "effect_over_noise": deviations, "runs": runs, "seed": seed, "tools": row}


def table(rows: list[dict[str, Any]]) -> str:
    shown = []
    for tool in rows[0]["tools"]:
        own = [r["tools"][tool] for r in rows]
        wrong, widths = np.array([o["false"] for o in own]), np.array([o["width"] for o in own])
        given = int(np.isfinite(wrong).sum())
        wall = float(np.median([o["wall_s"] for o in own]))
        halves = dict(zip(NAMES, 0.5 * np.nanmedian(widths, axis=0), strict=True))
        sizes = {n: f"+- {h:.2g}" if n == "exponent" else f"+- {100 * np.expm1(h):.2g} %" for n, h in halves.items()}
        shown.append({"tool": tool, "n": given, "false": np.nansum(wrong) / max(given, 1), "wall": wall, **sizes})
    widths = {f"width of {name} (median)": f"{{{name}}}" for name in NAMES}
    head = {"tool": "{tool}", "intervals": "{n}", "false": "{false:.1%}"}
    return harness.table({**head, **widths, "s an answer (median)": "{wall:.2f}"}, shown)


def main() -> None:
    given, rows = options(__doc__, records=100, minutes=30.0), []
    worlds = [world for world in WORLDS if world != "none"]
    plans = [(w, m, r, s) for s, w, m, r in itertools.product(range(99), worlds, MAGNITUDES, RUNS)]
    one(*plans[0])  # Programs are compiled once.
    one(*plans[1])
    for plan in until(given.minutes, plans[: given.records]):
        rows.append(one(*plan))
        print(plan, {k: (v["false"], round(v["wall_s"], 2)) for k, v in rows[-1]["tools"].items()}, flush=True)
        save("peers", {"records": rows})
    publish("peers", f"{table(rows)}\n\n{len(rows)} records.", "docs/fits_measured.md")


if __name__ == "__main__":
    main()
