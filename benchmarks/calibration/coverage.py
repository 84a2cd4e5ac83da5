"""Do 95 % intervals hold the truth 95 times in 100, and is the estimator as good as the Cramer-Rao bound?

    python -m benchmarks.calibration.coverage [CASE ...] [--replicates N] [--noise 0.01 0.02 0.05] [--workers 2]
writes results/coverage.json and docs/fits_measured.md. Cases: impact, exact, quasistatic, dynamic; all by default.

A replicate is a record with fresh noise, and a whole fit of it with its own starts. What is finished is kept in
build/coverage/ and not done again, so a case may be run in pieces. ``impact`` and the joints' records are our own
simulation, at a tighter tolerance than the fit's; ``exact`` are impacts by SciPy under the law with nothing smoothed.
The dynamic joint's are by CVODES (``joint_calibration``).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.stats import binomtest, chi2

import benchmarks.common as harness
from bcfj_jax import scenes, simulate
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.calibration.joint_calibration import BOUNDS as JOINT_BOUNDS
from benchmarks.calibration.joint_calibration import problem as joint_problem
from benchmarks.clock import Compilation, clocked, keep_programs, on_core, pool
from benchmarks.common import ROOT, Some, load, options, publish, save, tally, told
from benchmarks.references.impact import contact
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.forward.model import build, residuals_and_jacobian

KEPT = ROOT / "build" / "coverage"
# A fit after the first must not compile; profiles, which a few fits ask for, may, and little programs of NumPy's kind.
MOST_COMPILING_S = 2.0

# 0.1 kg at 1 m/s on 1e8 N/m^1.5: 0.82 ms of contact, 434 N.
IMPACT = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.15}
MASS, SPEED, TIMES = 0.1, 1.0, np.linspace(0.0, 9e-4, 401)
IMPACT_FREE = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 0.015, 1.5))
# What equilibria without friction tell; instants of one revolution under full load.
STATIC = ("stiffness", "exponent", "clearance_cage_ball", "contact_angle")
INSTANTS = np.linspace(0.06, 0.66, 41)


class Case(NamedTuple):
    """The problem of a noise and a seed; the truth by free parameter; starts, and replicates by default."""

    problem: Callable[[float, int], Problem]
    truth: dict[str, float]
    starts: int
    replicates: int


def noisy(names: list[str], forces: list[np.ndarray], noise: float, seed: int) -> tuple[Channel, ...]:
    """Channels with noise of a share of each one's peak."""
    draw = np.random.default_rng(seed)
    sigmas = [noise * float(np.abs(force).max()) for force in forces]
    return tuple(
        Channel(name, force + sigma * draw.standard_normal(force.size), sigma)
        for name, force, sigma in zip(names, forces, sigmas, strict=True)
    )


def impact_force(source: str) -> np.ndarray:
    """Force (T,) [N] of the impact: our own, or SciPy's with an event where the bodies part."""
    if source == "own":
        scene = scenes.impact(smoothing=False)
        params = scene.parameters({**IMPACT, "mass": MASS, "approach_speed": SPEED})
        return simulate(scene, params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    return contact(IMPACT, MASS, SPEED).force(TIMES)


def impact(source: str, noise: float, seed: int) -> Problem:
    """One impact of 401 samples."""
    scene = scenes.impact(smoothing=False)
    params = {k: float(v) for k, v in scene.parameters({**IMPACT, "mass": MASS, "approach_speed": SPEED}).items()}
    channels = noisy(["contact.normal"], [impact_force(source)], noise, seed)
    return Problem(scene, params, (Experiment("impact", TIMES, channels),), IMPACT_FREE)


@functools.cache
def static_forces() -> dict[str, np.ndarray]:
    """Normal forces (T,) [N] by channel of the joint in equilibrium."""
    scene = scenes.joint_of_keys(fidelity="quasistatic", **PLAIN)
    found = simulate(scene, scene.parameters(), INSTANTS).force
    return {
        f"{name}_{i + 1}.normal" if force.ndim == 3 else f"{name}.normal": one
        for name, force in found.items()
        for i, one in enumerate(force[..., 0].reshape(INSTANTS.size, -1).T)
    }


def static(noise: float, seed: int) -> Problem:
    """The joint without inertia and friction at 41 angles."""
    scene, forces = scenes.joint_of_keys(fidelity="quasistatic", **PLAIN), static_forces()
    truth = {name: float(value) for name, value in scene.parameters().items()}
    free = tuple(Free(n, JOINT_BOUNDS[n][0] * truth[n], JOINT_BOUNDS[n][1] * truth[n]) for n in STATIC)
    channels = noisy(list(forces), list(forces.values()), noise, seed)
    return Problem(scene, truth, (Experiment("revolution", INSTANTS, channels),), free)


def dynamic(noise: float, seed: int) -> Problem:
    """The joint's motion over 0.6 s; damping, which the forces do not tell, fixed."""
    return joint_problem(noise, seed, {"damping": JOINT_TRUTH["damping"]})


JOINT_TRUTH = {name: float(value) for name, value in scenes.joint_of_keys(**PLAIN).parameters().items()}
CASES = {
    "impact": Case(functools.partial(impact, "own"), IMPACT, 6, 200),
    "exact": Case(functools.partial(impact, "scipy"), IMPACT, 6, 200),
    "quasistatic": Case(static, {n: JOINT_TRUTH[n] for n in STATIC}, 4, 200),
    "dynamic": Case(dynamic, {n: JOINT_TRUTH[n] for n in JOINT_BOUNDS if n != "damping"}, 4, 30),
}


def at_truth(case: Case, noise: float, accuracy: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """White residuals (N,) of seed 0 at the truth, and their Jacobian (N, P) by each parameter as a share of it.

    ``accuracy``: of the runs that both are taken from; None: the fit's own.
    """
    made = case.problem(noise, 0)
    model = build(dataclasses.replace(made, accuracy=accuracy or made.accuracy), made.experiments)
    # At a reference penetration of 1 m the coordinate of the stiffness is that of the stiffness itself.
    point = jnp.asarray(model.point(np.array([case.truth[s.name] for s in model.coordinates])))
    residuals, jacobian = (np.asarray(found) for found in residuals_and_jacobian(model, point))
    width = np.asarray(model.box[1])
    return residuals, jacobian / (width / [1.0 if s.log else case.truth[s.name] for s in model.coordinates])


def bound(case: Case, noise: float, accuracy: float | None = None) -> dict[str, float]:
    """Cramer-Rao deviation of each parameter, as a share of it, from the Jacobian at the truth and the noise."""
    jacobian = at_truth(case, noise, accuracy)[1]
    deviation = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    return {free.name: float(s) for free, s in zip(case.problem(noise, 0).free, deviation, strict=True)}


def replicates(task: tuple[str, Case, float, list[int], int]) -> int:
    """Fit each seed's record in this process, which keeps to one core, and keep what came of it."""
    name, case, noise, seeds, worker = task
    on_core(worker)
    keep_programs(0.2)
    compilation = Compilation()
    for count, seed in enumerate(seeds):
        found, took = clocked(lambda seed=seed: fit(case.problem(noise, seed), seed=seed, starts=case.starts))
        compiling, profiled = compilation.since(), bool(found.evidence.profiles)
        assert count == 0 or profiled or compiling < MOST_COMPILING_S, f"{compiling:.1f} s of compiling in a later fit"
        row = {
            "seed": seed, "verdict": found.verdict, "reasons": found.reasons, "compiling_s": compiling, **took,
            "parameters": {k: [p.value, p.ci95, p.identifiable] for k, p in found.parameters.items()},
        }  # fmt: skip
        with kept(name, noise, worker).open("a") as file:
            file.write(json.dumps(row) + "\n")
    return len(seeds)


def kept(name: str, noise: float, worker: int | str) -> Any:
    """File of one worker's finished replicates."""
    KEPT.mkdir(parents=True, exist_ok=True)
    return KEPT / f"{name}_{noise:g}_{worker}.jsonl"


def finished(name: str, noise: float) -> list[dict[str, Any]]:
    """Finished replicates of a case by seed; a last line that was cut off is none."""
    rows = {}
    for path in KEPT.glob(kept(name, noise, "*").name):
        for line in path.read_text().splitlines():
            try:
                row = json.loads(line)
            except json.JSONDecodeError:
                continue
            rows[row["seed"]] = row
    return [rows[seed] for seed in sorted(rows)]


def fit_missing(todo: Mapping[str, Case], noises: Sequence[float], count: int | None, workers: int) -> None:
    """Fit those seeds of cases that are not kept; of each case ``count``, or its own number."""
    with pool(workers) as processes:
        for (name, case), noise in itertools.product(todo.items(), noises):
            have = {row["seed"] for row in finished(name, noise)}
            missing = [seed for seed in range(count or case.replicates) if seed not in have]
            list(processes.map(replicates, [(name, case, noise, missing[k::workers], k) for k in range(workers)]))


def summary(
    name: str, case: Case, noise: float, rows: list[dict[str, Any]], accuracy: float | None = None
) -> dict[str, Any]:
    """Coverage and efficiency of each parameter over a case's replicates; ``accuracy`` as ``bound``."""
    least = bound(case, noise, accuracy)
    log, parameters = {f.name: f.as_share for f in case.problem(noise, 0).free}, {}
    for parameter, true in case.truth.items():
        values, intervals, identifiable = zip(*(r["parameters"][parameter] for r in rows), strict=True)
        printed = [ends for ends in intervals if ends]
        inside = sum(low <= true <= high for low, high in printed)
        error = np.log(np.array(values) / true) if log[parameter] else np.array(values) / true - 1.0
        ratio = float(np.mean(error**2)) / least[parameter] ** 2
        # Of n squared errors of the bound's own deviation.
        limits = np.array(chi2.interval(0.95, len(rows))) / len(rows)
        binomial = binomtest(inside, len(printed)).proportion_ci() if printed else None
        parameters[parameter] = {
            "printed": len(printed), "inside": inside, "coverage": inside / len(printed) if printed else None,
            "coverage_ci95": binomial and [float(binomial.low), float(binomial.high)],
            "identifiable_share": float(np.mean(identifiable)), "cramer_rao": least[parameter],
            "square_error_over_bound": ratio, "variance_over_bound": float(np.var(error)) / least[parameter] ** 2,
            "ratio_expected": limits.tolist(), "bias_over_bound": float(np.mean(error)) / least[parameter],
            "bias_over_standard_error": float(np.mean(error) / np.std(error, ddof=1)) * len(rows) ** 0.5,
        }  # fmt: skip
    reasons = [reason for r in rows for reason in r["reasons"]]
    return {
        "case": name, "noise": noise, "replicates": len(rows), "starts": case.starts, "parameters": parameters,
        "verdicts": tally(r["verdict"] for r in rows),
        "reasons": {r: reasons.count(r) for r in sorted(set(reasons), key=reasons.count)[-5:]},
        "median_wall_s": float(np.median([r["wall_s"] for r in rows])),
        "median_cpu_s": float(np.median([r["cpu_s"] for r in rows])),
    }  # fmt: skip


def table(cases: list[dict[str, Any]]) -> str:
    """All parameters of all cases as Markdown."""

    def coverage(p: dict[str, Any]) -> str:
        ends = p["coverage_ci95"]
        return f"{p['coverage']:.1%} of {p['printed']} ({ends[0]:.0%} to {ends[1]:.0%})" if ends else "none printed"

    columns = {
        "case": "{case}", "noise": "{noise:.0%}", "parameter": "{name}", "coverage (its 95 %)": coverage,
        "variance / Cramer-Rao (95 % of chance)":
            "{variance_over_bound:.2f} ({ratio_expected[0]:.2f} to {ratio_expected[1]:.2f})",
        "verdicts": lambda row: told(row["verdicts"]),
    }  # fmt: skip
    return harness.table(columns, ({**c, "name": name, **p} for c in cases for name, p in c["parameters"].items()))


def main() -> None:
    """Do what is missing of the cases asked for, and put together all that is there."""
    noises = (0.01, 0.02, 0.05)
    given = options(__doc__, {"cases": CASES}, replicates=int, noise=Some(noises), workers=2)
    fit_missing({name: CASES[name] for name in given.cases}, given.noise, given.replicates, given.workers)
    earlier = {(c["case"], c["noise"]): c for c in load("coverage")["cases"]}
    done = [(name, noise, finished(name, noise)) for name in CASES for noise in noises]
    # Of a case that this clone has no replicates of, what is committed stays.
    found = [summary(n, CASES[n], noise, rows) if rows else earlier.get((n, noise)) for n, noise, rows in done]
    cases = [case for case in found if case]
    save("coverage", {"what": "whole fits of records with fresh noise, as a share of each peak", "cases": cases})
    publish("coverage", table(cases), "docs/fits_measured.md")


if __name__ == "__main__":
    main()
