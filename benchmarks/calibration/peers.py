"""The same imperfect records to SciPy, lmfit, MuJoCo's sysid, pyPESTO and us: false intervals, width, error, time to answer.

Records are those of ``imperfect``: an impact with one imperfection or two, none named to anyone. The peers get what a user
would write: the same law integrated by SciPy's LSODA in its natural coordinates (logarithms of stiffness and damping, the
exponent), a start a factor of three off, the box that we get, and the intervals that each tool prints. MuJoCo has no contact
K d^n of its own, and gets the residuals from the same function. pyPESTO gets nuisances, too: the errors of a sensor and of
fixed values that we allow for, each with our prior (``Nuisances``); the most probable point and its Fisher information give its
interval, for a profile takes minutes.

    python -m benchmarks.calibration.peers [--records 100] [--minutes 30]

keeps results/peers.json; needs the extras bench and test. A tool that is not installed has no row.
"""

from __future__ import annotations

import contextlib
import io
import itertools
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

import benchmarks.common as harness
from benchmarks.calibration.imperfect import MAGNITUDES, MASS, STARTS, TRUTH, WORLDS, imperfections, problem
from benchmarks.clock import clocked, until
from benchmarks.common import options, publish, save
from calibration import Problem, fit
from calibration.diagnostics.catalogue import SENSOR

RUNS = (1, 4)
LOWER, UPPER = np.array([np.log(1e7), 1.0, np.log(1e-3)]), np.array([np.log(1e9), 2.5, np.log(1.0)])
START = np.array([np.log(3.3e7), 1.4, np.log(0.03)])
TRUE = np.array([np.log(TRUTH["stiffness"]), TRUTH["exponent"], np.log(TRUTH["damping"])])
NAMES = tuple(TRUTH)
# Of each coefficient lower end, value and upper end.
Ends = list[tuple[float, float, float]]
Records = list[tuple[np.ndarray, np.ndarray, float]]


def records_of(given: Problem) -> Records:
    """Times, forces and speed of approach of each run."""
    return [(e.times, e.channels[0].values, e.fixed["approach_speed"]) for e in given.experiments]


def predicted(records: Records, at: Sequence[float], mass: float = MASS, faster: float = 0.0) -> list[np.ndarray]:
    """Forces of each run [N] at (ln K, n, ln a), of a body that comes ``faster`` by a share than the record says."""
    k, n, a = np.exp(at[0]), at[1], np.exp(at[2])

    def force(d: Any, v: Any) -> Any:
        return k * np.maximum(d, 0.0) ** n * np.maximum(1.0 + a * v, 0.0)

    found = []
    for times, _, speed in records:
        run = solve_ivp(
            lambda _, s: (s[1], -force(s[0], s[1]) / mass), (0.0, times[-1]), (0.0, speed * (1.0 + faster)), "LSODA",
            t_eval=times, rtol=1e-8, atol=1e-12, max_step=times[-1] / 20.0,
        )  # fmt: skip
        found.append(force(run.y[0], run.y[1]))
    return found


def residuals_of(given: Problem) -> Callable[[np.ndarray], np.ndarray]:
    """Prediction less record, in newtons, of (ln K, n, ln a)."""
    records = records_of(given)
    values = np.concatenate([values for _, values, _ in records])
    return lambda at: np.concatenate(predicted(records, at)) - values


def about(at: np.ndarray, half: np.ndarray) -> Ends:
    return list(zip((at - half).tolist(), at.tolist(), (at + half).tolist(), strict=True))


def by_scipy(given: Problem) -> Ends:
    """``least_squares`` and 1.96 deviations of s^2 (J^T J)^-1."""
    found = least_squares(residuals_of(given), START, bounds=(LOWER, UPPER), x_scale="jac")
    variance = 2.0 * found.cost / (found.fun.size - 3)
    return about(found.x, 1.96 * np.sqrt(np.diag(variance * np.linalg.inv(found.jac.T @ found.jac))))


def by_lmfit(given: Problem) -> Ends:
    """``minimize`` and 1.96 of the stderr that its report prints."""
    import lmfit

    params, residuals = lmfit.Parameters(), residuals_of(given)
    for name, start, low, high in zip(NAMES, START, LOWER, UPPER, strict=True):
        params.add(name, value=start, min=low, max=high)
    found: Any = lmfit.minimize(lambda p: residuals(np.array([p[name].value for name in NAMES])), params)
    ends = np.array([(found.params[n].value, 1.96 * (found.params[n].stderr or np.nan)) for n in NAMES])
    return about(*ends.T)


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
    return about(at, np.asarray(sysid.calculate_intervals([plain(at)], result.jac)[1]))


class Nuisances:
    """Residuals of a law and of errors that act always, in deviations, each with a normal prior: rows of 1 / deviation.

    All runs share a gain, its bend, a lag, and errors of mass and speed; each has a zero, a drift and a clock. Errors of the
    sensor are linear, as in ``calibration.diagnostics.catalogue``, whose limits of 95 % the priors have. The noise is that of the
    last fifth of each record, after contact.
    """

    def __init__(self, given: Problem) -> None:
        self.records = records_of(given)
        each = [SENSOR[name].most for name in ("rest", "drift", "clock")]
        shared = [SENSOR[name].most for name in ("gain", "bend of the gain", "lag")]
        self.most = np.array([*shared, 0.01, 0.01, *(each * len(self.records))])
        self.sigma = float(np.std(np.concatenate([x[-x.size // 5 :] for _, x, _ in self.records])))
        self.known: dict[bytes, list[np.ndarray]] = {}

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """(ln K, n, ln a) and amplitudes in deviations of their priors, to residuals."""
        law, amplitudes = at[:3], at[3:] * self.most / 1.96
        (gain, bend, lag, heavier, faster), own = amplitudes[:5], amplitudes[5:].reshape(-1, 3)
        # Only the law, mass and speed need a run.
        key = np.array([*law, heavier, faster]).tobytes()
        if key not in self.known:
            self.known[key] = predicted(self.records, law, MASS * (1.0 + heavier), faster)
        found = []
        for (times, values, _), x, (zero, drift, late) in zip(self.records, self.known[key], own, strict=True):
            peak, length = float(np.abs(values).max()), float(times[1] - times[0]) * np.count_nonzero(x)
            shift = late * (times[1] - times[0]) + lag * length
            read = x * (1.0 + gain + bend * x / peak) - shift * np.gradient(x, times)
            read = read + peak * (zero + drift * (times - times.mean()) / np.ptp(times))
            found.append((read - values) / self.sigma)
        return np.concatenate([*found, at[3:]])


def by_pypesto(given: Problem) -> Ends:
    """``minimize`` over law and nuisances, and 1.96 deviations by the Fisher information of its optimum."""
    import pypesto
    from pypesto import optimize

    residuals = Nuisances(given)
    count = residuals.most.size
    objective = pypesto.FD(pypesto.Objective(res=residuals), sres=True)
    bounds = (np.concatenate([LOWER, np.full(count, -10.0)]), np.concatenate([UPPER, np.full(count, 10.0)]))
    start = np.concatenate([START, np.zeros(count)])
    found = optimize.minimize(
        pypesto.Problem(objective, *bounds), optimize.ScipyOptimizer("ls_trf"), n_starts=1,
        startpoint_method=lambda **_: start[None], progress_bar=False, filename=None,
    ).optimize_result[0]  # fmt: skip
    slopes = objective(found.x, sensi_orders=(1,), mode="mode_res")
    return about(found.x[:3], 1.96 * np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))[:3])


def by_us(given: Problem) -> dict[str, Ends]:
    """The interval of the noise about the least squares' value, and the one to quote with its value; NaN for none."""
    found = fit(given, starts=STARTS)
    rows: dict[str, Ends] = {"noise": [], "quoted": []}
    for name, p in found.parameters.items():
        for kind, ends, value in (("noise", p.intervals.get("noise"), p.least_squares), ("quoted", p.ci95, p.value)):
            low, high = ends or (np.nan, np.nan)
            natural = (low, value, high) if name == "exponent" else np.log([low, value, high]).tolist()
            rows[kind].append(tuple(natural))
    return rows


def judged(ends: Ends) -> dict[str, list[float]]:
    """Of each coefficient: 1 where the interval excludes the truth (NaN where there is none), its width, and the value's error
    (NaN likewise).
    """
    given = [bool(np.isfinite(low + high)) for low, _, high in ends]
    every = list(zip(given, ends, TRUE.tolist(), strict=True))
    return {
        "false": [float(not low <= true <= high) if known else np.nan for known, (low, _, high), true in every],
        "width": [float(high - low) for low, _, high in ends],
        "off": [abs(value - true) if known else np.nan for known, (_, value, _), true in every],
    }


TOOLS = {
    "SciPy least_squares": ("scipy", by_scipy), "lmfit": ("lmfit", by_lmfit), "mujoco.sysid": ("mujoco", by_mujoco),
    "pyPESTO, nuisances": ("pypesto", by_pypesto),
}  # fmt: skip


def one(world: str, deviations: float, runs: int, seed: int) -> dict[str, Any]:
    given, row = problem(imperfections(world, deviations, seed), runs, seed), {}
    for name, (package, tool) in TOOLS.items():
        if find_spec(package) is None:
            continue
        ends, took = clocked(lambda tool=tool: tool(given))
        row[name] = {**judged(ends), "wall_s": took["wall_s"]}
    ours, took = clocked(lambda: by_us(given))
    row |= {f"bcfj-jax, {kind}": {**judged(ends), "wall_s": took["wall_s"]} for kind, ends in ours.items()}
    return {"world": world, "effect_over_noise": deviations, "runs": runs, "seed": seed, "tools": row}


def table(rows: list[dict[str, Any]]) -> str:
    shown = []
    for tool in rows[0]["tools"]:
        own = [r["tools"][tool] for r in rows]
        wrong, widths, off = (np.array([o[key] for o in own]) for key in ("false", "width", "off"))
        given = int(np.isfinite(wrong).sum())
        wall = float(np.median([o["wall_s"] for o in own]))
        sizes = {n: f"+- {size(n, 0.5 * w)}" for n, w in zip(NAMES, np.nanmedian(widths, axis=0), strict=True)}
        errors = {f"{n} off": size(n, x) for n, x in zip(NAMES, np.nanmedian(off, axis=0), strict=True)}
        share = np.nansum(wrong) / max(given, 1)
        shown.append({"tool": tool, "n": given, "false": share, "wall": wall, **sizes, **errors})
    columns = {f"width of {name}": f"{{{name}}}" for name in NAMES}
    columns |= {f"error of {name}": f"{{{name} off}}" for name in NAMES}
    head = {"tool": "{tool}", "intervals": "{n}", "false": "{false:.1%}"}
    return harness.table({**head, **columns, "s an answer": "{wall:.2f}"}, shown)


def size(name: str, x: float) -> str:
    return f"{x:.2g}" if name == "exponent" else f"{100 * np.expm1(x):.2g} %"


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
    said = f"Widths, errors of the value and seconds are medians over {len(rows)} records."
    publish("peers", f"{table(rows)}\n\n{said}", "docs/fits_measured.md")


if __name__ == "__main__":
    main()
