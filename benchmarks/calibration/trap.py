"""The trap test: a bouncing mass, 1 to 30 contacts, stiffness from three decades. Is a verdict confidently wrong?

Records are made by our own integrator (tight) and by SciPy from the exact law: flights are parabolas in closed form,
contacts are DOP853 to 1e-12 up to the event that ends them. The fit integrates at its own, looser accuracy.

Seeds that were fitted before are taken from results/trap_seeds.csv, others are added to it: begin again without it.

python -m benchmarks.calibration.trap [SEEDS] [--minutes M] [--workers N] [--contacts ...] [--source ...] [--peer SEEDS]
    writes results/trap.json and the table in docs/fits_measured.md
"""

from __future__ import annotations

import csv
import itertools
import time
from typing import Any

import jax.numpy as jnp
import numpy as np

import benchmarks.common as harness
from bcfj_jax import scenes, simulate
from benchmarks.clock import clocked, keep_programs, pool
from benchmarks.common import RESULTS, Some, known, options, publish, save, tally, told
from benchmarks.references.impact import bounces
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.forward.model import build, residuals_and_jacobian
from calibration.search.starts import referred

# A 0.1 kg rubber-like ball dropped from 0.1 m: 43 N, 5.7 mm deep, 12 ms of contact, 5 % of its speed lost.
TRUTH = {"stiffness": 1e5, "exponent": 1.5, "damping": 0.05}
MASS, HEIGHT, GRAVITY = 0.1, 0.1, 9.81
SCENE = scenes.bounce(smoothing=False)
FREE = (Free("stiffness", 10**3.5, 10**6.5), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 0.5))
CONTACTS, NOISES = (1, 2, 10, 30), (0.01, 0.001, 0.0)
# Samples [s]: close from a little before each contact to a little after it, coarse in flight. A single contact must be
# read so closely for its exponent to be known to 2 % at all.
STEPS, MARGIN, COARSE = {1: 1e-4, 2: 1e-4, 10: 5e-4, 30: 5e-4}, 4e-3, 4e-3
STARTS, CLOSE = 12, 0.02
# Exponent and reference force among stiffness, exponent, damping, reference force.
LAW = [1, 3]
SEEDS, BLOCK = RESULTS / "trap_seeds.csv", 10
# Of the fit's integration. Errors add up from contact to contact: at 1e-5 the forces of the tenth are wrong by 4e-4 of
# the peak, which moves chi2 by 0.6, at 1e-7 by 6e-6 and 0.007, for twice the steps.
ACCURACY = 1e-7


def record(count: int, source: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and force [N] of so many contacts, without noise."""
    found = bounces(TRUTH, MASS, HEIGHT, GRAVITY, count)
    grid, last = [np.zeros(1)], 0.0
    for c in found:
        grid.append(np.arange(last + COARSE, c.begin - MARGIN, COARSE))
        grid.append(np.arange(c.begin - MARGIN, c.end + MARGIN, STEPS[count]))
        last = grid[-1][-1]
    times = np.concatenate(grid)
    if source == "own":
        params = SCENE.parameters({"mass": MASS, "drop_height": HEIGHT, "gravity": GRAVITY, **TRUTH})
        return times, simulate(SCENE, params, times, accuracy=1e-8).force["contact"][:, 0]
    return times, np.sum([c.force(times) for c in found], axis=0)


def problem(times: np.ndarray, force: np.ndarray, noise: float, seed: int) -> Problem:
    """The record with noise of that share of its peak, stated; of a clean one it is to be estimated."""
    sigma = noise * float(force.max())
    values = force + sigma * np.random.default_rng([seed, times.size, NOISES.index(noise)]).standard_normal(times.size)
    params = {k: float(v) for k, v in SCENE.parameters(mass=MASS, drop_height=HEIGHT, gravity=GRAVITY).items()}
    experiment = Experiment("drop", times, (Channel("contact.normal", values, sigma or None),))
    return Problem(SCENE, {**params, **TRUTH}, (experiment,), FREE, accuracy=ACCURACY)


def one(found: Any, seconds: float) -> dict[str, Any]:
    """What is kept of a fit: errors relative to the truth, intervals printed and how many exclude it."""
    error = {name: found.parameters[name].value / true - 1.0 for name, true in TRUTH.items()}
    intervals = [(found.parameters[name].ci95, true) for name, true in TRUTH.items()]
    true = TRUTH["stiffness"] * found.reference.penetration ** TRUTH["exponent"]
    error["reference_force"] = found.reference.force / true - 1.0
    intervals.append((found.reference.ci95, true))
    printed = [(ends, true) for ends, true in intervals if ends]
    excluding = sum(not ends[0] <= true <= ends[1] for ends, true in printed)
    return {
        "verdict": found.verdict, "reasons": "; ".join(found.reasons), **{n: f"{e:.4g}" for n, e in error.items()},
        "printed": len(printed), "excluding": excluding, "cpu_s": f"{seconds:.2f}",
    }  # fmt: skip


def fits(task: tuple[str, int, float, tuple[int, ...]], end: float) -> list[dict[str, Any]]:
    """Some seeds of one case, in this process, unless the time is up."""
    if time.time() >= end:
        return []
    source, contacts, noise, seeds = task
    keep_programs(0.2)
    times, force = record(contacts, source)
    rows = []
    for seed in seeds:
        given = problem(times, force, noise, seed)
        found, took = clocked(lambda seed=seed, given=given: fit(given, seed=seed, starts=STARTS))
        case = {"source": source, "contacts": contacts, "noise": noise, "seed": seed}
        rows.append({**case, **one(found, took["cpu_s"])})
    return rows


def bound(contacts: int, noise: float) -> dict[str, Any]:
    """Cramer-Rao bound: deviations relative to the truth, and how often an estimator that reaches it is within 2 %.

    The reference force is that where the fits have it.
    """
    stated = problem(*record(contacts, "scipy"), noise, 0)
    model = build(stated, stated.experiments)
    values = np.array(list(TRUTH.values()))
    model = referred(model, [model.point(values)])
    point = model.point(values)
    jacobian = np.asarray(residuals_and_jacobian(model, jnp.asarray(point))[1])
    width = np.asarray(model.box[1])
    # All coordinates are logarithms; ln K = ln F_ref - n ln d_ref.
    force, exponent, damping = np.diag(width)
    slopes = np.array([force - model.log_depth * TRUTH["exponent"] * exponent, exponent, damping, force])
    covariance = slopes @ np.linalg.inv(jacobian.T @ jacobian) @ slopes.T
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(4), covariance, 100_000, method="eigh")
    close = np.abs(draws) <= CLOSE
    names = ("stiffness", "exponent", "damping", "reference_force")
    return {
        "deviation": dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        "recovered": float(np.mean(close[:, LAW].all(axis=1))), "all_recovered": float(np.mean(close.all(axis=1))),
    }  # fmt: skip


def summary(source: str, contacts: int, noise: float, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """A case: share recovered, verdicts, intervals.

    Recovered is the force law: reference force and exponent within 2 %; or all of it, stiffness and damping too.
    """
    names = ("stiffness", "exponent", "damping", "reference_force")
    error = {n: np.array([float(r[n]) for r in rows]) for n in names}
    close = np.abs(np.stack([error[n] for n in names], axis=1)) <= CLOSE
    reasons = [r["reasons"] for r in rows]
    return {
        "source": source, "contacts": contacts, "noise": noise, "seeds": len(rows),
        "recovered": float(np.mean(close[:, LAW].all(axis=1))), "all_recovered": float(np.mean(close.all(axis=1))),
        "within_2_percent": {n: float(np.mean(np.abs(e) <= CLOSE)) for n, e in error.items()},
        "verdicts": tally(r["verdict"] for r in rows),
        "reasons": {r: reasons.count(r) for r in sorted(set(reasons) - {""}, key=reasons.count)[-5:]},
        "printed": sum(int(r["printed"]) for r in rows), "excluding": sum(int(r["excluding"]) for r in rows),
        "rms_error": {n: float(np.sqrt(np.mean(e**2))) for n, e in error.items()},
        "cramer_rao": bound(contacts, noise) if noise else None,
        "median_cpu_s": float(np.median([float(r["cpu_s"]) for r in rows])),
        "all_cpu_s": float(np.sum([float(r["cpu_s"]) for r in rows])),
    }  # fmt: skip


def fitted() -> list[dict[str, Any]]:
    """Fits of earlier runs."""
    if not SEEDS.exists():
        return []
    with SEEDS.open(newline="") as file:
        return list(csv.DictReader(file))


def keep(rows: list[dict[str, Any]]) -> None:
    """Add fits to those of earlier runs."""
    new = not SEEDS.exists()
    with SEEDS.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerows(rows)


def case_of(row: dict[str, Any]) -> tuple[str, int, float]:
    """Source, contacts, noise."""
    return row["source"], int(row["contacts"]), float(row["noise"])


def table(cases: list[dict[str, Any]]) -> str:
    """The cases as Markdown."""

    def share(key: str) -> Any:
        return lambda c: f"{c[key]:.1%}" + (f" ({c['cramer_rao'][key]:.1%})" if c["cramer_rao"] else "")

    return harness.table({
        "record by": "{source}", "contacts": "{contacts}", "noise": "{noise:.1%}", "seeds": "{seeds}",
        "force law within 2 % (Cramer-Rao)": share("recovered"), "all coefficients (C.-R.)": share("all_recovered"),
        "verdicts": lambda c: told(c["verdicts"]), "intervals that exclude the truth": "{excluding} of {printed}",
        "CPU s a fit": "{median_cpu_s:.1f}",
    }, cases)  # fmt: skip


def peer_table(cases: list[dict[str, Any]]) -> str:
    """MuJoCo's cases as Markdown: it has no verdict, so that every start prints its intervals."""
    return harness.table({
        "mujoco.sysid, contacts": "{contacts}", "noise": lambda c: "noisy" if any(c["noise"]) else "clean",
        "seeds": "{seeds}", "starts recovered": "{starts_recovered:.0%}", "best of starts": "{best_recovered:.0%}",
        "intervals that exclude": "{excluding} of {printed}",
    }, cases)  # fmt: skip


def main() -> None:
    """Run all cases, and the peer if asked for."""
    given = options(
        __doc__, {"seeds": 200}, minutes=(np.inf, "no block of seeds begins later"), workers=1, contacts=list(CONTACTS),
        noise=list(NOISES), source=Some(["scipy"]), peer=(0, "seeds for mujoco.sysid on equivalent records"),
    )  # fmt: skip
    keep_programs(0.2)
    cases = list(itertools.product(given.source, given.contacts, given.noise))
    done = {(case_of(row), int(row["seed"])) for row in fitted()}
    tasks = []
    for first, case in itertools.product(range(0, given.seeds, BLOCK), cases):
        seeds = tuple(k for k in range(first, min(first + BLOCK, given.seeds)) if (case, k) not in done)
        tasks += [(*case, seeds)] if seeds else []
    with pool(given.workers) as processes:
        waiting = [processes.submit(fits, task, time.time() + 60.0 * given.minutes) for task in tasks]
        for task, job in zip(tasks, waiting, strict=True):
            if rows := job.result():
                keep(rows)
                print(*task[:3], f"seeds {task[3][0]} to {task[3][-1]}", *(r["verdict"] for r in rows), flush=True)
    rows = fitted()
    summaries = [summary(*case, [r for r in rows if case_of(r) == case]) for case in sorted({*map(case_of, rows)})]
    printed, excluding = (sum(c[key] for c in summaries) for key in ("printed", "excluding"))
    result: dict[str, Any] = {
        "truth": TRUTH, "starts": STARTS, "stiffness_bounds": [FREE[0].lower, FREE[0].upper], "cases": summaries,
        "printed": printed, "excluding": excluding, "excluding_share": excluding / max(printed, 1),
        "cpu_s": sum(c["all_cpu_s"] for c in summaries), "mujoco_sysid": known("trap").get("mujoco_sysid"),
    }  # fmt: skip
    if given.peer:
        from benchmarks.calibration.trap_mujoco import peer

        result["mujoco_sysid"] = peer(given.peer)
    save("trap", result)
    text = f"{table(summaries)}\n\n{excluding} of {printed} printed intervals exclude the truth."
    text += f"\n\n{peer_table(result['mujoco_sysid'])}" if result["mujoco_sysid"] else ""
    publish("trap", text, "docs/fits_measured.md")


if __name__ == "__main__":
    main()
