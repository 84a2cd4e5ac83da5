"""Derivatives and calibration of the joint with rolling balls, window ends and bands, beside those of the plain joint.

    python -m benchmarks.models.joint_fuller                    all parts, into benchmarks/results/joint_fuller.json
    python -m benchmarks.models.joint_fuller derivatives plain  or any other part, variant or both

Derivatives: of the normal forces of 0.3 s by eight logarithms at the level ``balanced``, with their certificate: each
parameter's verdict and its difference, as averages over 5 ms, from derivatives four times tighter and from central
differences. Calibration: the seven coefficients that the record tells (``benchmarks.calibration.joint_calibration``) and the
clearance of one ball in its groove, 5 um more than that of the others, from a record of 0.3 s with noise of 2 % of each
peak, of the same joint solved to 1e-5 of the peak. The fit ends at 1e-3 of it. Walls hang on what else runs.
Tangents: how large they become by tolerance and method, here and in joints in which a ball carries nothing.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from typing import Any

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are.
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import MAX_STEPS, Plan
from benchmarks.calibration.joint_calibration import BOUNDS
from benchmarks.common import RESULTS, ROOT, load, save
from calibration import Channel, Experiment, Free, Problem, fit

FULLER = dict.fromkeys(PLAIN, True)
BANDS = PLAIN | {"bands": True}
# Contact regularisation of 20 um, the default, holds a ball that carries nothing with less than a newton.
WIDE = {"smoothing": 30e-6}
# Options and values.
VARIANTS: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "plain": (PLAIN, {}),
    "fuller": (FULLER, {}),
    "fuller, 30 um": (FULLER, WIDE),
    "plain, 0.5 rad": (PLAIN, {"joint_angle": 0.5}),
    "bands": (BANDS, {}),
    "bands, 30 um": (BANDS, WIDE),
}
TIMES = np.linspace(0.0, 0.3, 301)
CONTACTS = ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball")
ONE_BALL, EXTRA = "seat_ball_2.extra_clearance", 5e-6
NOISE, STARTS = 0.02, 4
# Solver tolerances, and whether tangents count in the step control (BDF) or not (SDIRK2).
TOLERANCES = ((5e-3, False), (1e-3, False), (1e-3, True), (1e-4, True), (1e-5, True))


def derivatives(options: dict[str, Any], values: dict[str, float]) -> dict[str, Any]:
    """Verdicts and differences of a variant."""
    scene = bj.scenes.joint(**options)
    begin = time.process_time()
    found = bj.sensitivity(scene, scene.parameters(values), TIMES, list(BOUNDS), features=["seat_cage.mean"])
    certificate = found.certificate
    assert certificate is not None
    return {
        "verdict": certificate.verdict,
        "parameters": {name: _check(check) for name, check in certificate.parameters.items()},
        "direction": certificate.direction, "steps": certificate.steps, "cpu_s": time.process_time() - begin,
    }  # fmt: skip


def _check(check: Any) -> dict[str, Any]:
    names = ("verdict", "remark", "pointwise", "average", "influence")
    return {name: getattr(check, name) for name in names}


def calibration(options: dict[str, Any], values: dict[str, float]) -> dict[str, Any]:
    """Estimates over the truth, and the extra clearance of one ball, of a variant."""
    scene = bj.scenes.joint(unequal=True, **options)
    truth = {name: float(value) for name, value in scene.parameters(values | {ONE_BALL: EXTRA}).items()}
    run = bj.simulate(scene, scene.parameters(truth), TIMES, accuracy=1e-5)
    assert run.status == "ok", run.reason
    draw, channels = np.random.default_rng(0), []
    for contact in CONTACTS:
        force = np.asarray(run.force[contact])[..., 0].reshape(TIMES.size, -1)
        for i, normal in enumerate(force.T):
            sigma = NOISE * float(np.abs(normal).max())
            name = f"{contact}_{i + 1}" if force.shape[1] > 1 else contact
            channels.append(Channel(f"{name}.normal", normal + sigma * draw.standard_normal(normal.size), sigma))
    free = [Free(name, a * truth[name], b * truth[name]) for name, (a, b) in BOUNDS.items() if name != "damping"]
    free.append(Free(ONE_BALL, -15e-6, 15e-6))
    problem = Problem(scene, truth, (Experiment("record", TIMES, tuple(channels)),), tuple(free))
    begin, cpu = time.perf_counter(), time.process_time()
    found = fit(problem, seed=0, starts=STARTS)
    return {
        "verdict": found.verdict, "reasons": found.reasons, "reduced_chi2": found.residual["reduced_chi2"],
        "parameters": {
            name: {
                "estimate_over_truth": one.value / truth[name],
                "ci95_over_truth": one.ci95 and [end / truth[name] for end in one.ci95],
                "identifiable": one.identifiable,
            }
            for name, one in found.parameters.items()
        },
        "wall_s": time.perf_counter() - begin, "cpu_s": time.process_time() - cpu,
    }  # fmt: skip


def tangents(options: dict[str, Any], values: dict[str, float]) -> dict[str, float]:
    """Largest derivative [N] of any normal force of the first 0.12 s by the logarithm of ``stiffness``, by tolerance."""
    scene = bj.scenes.joint(**options)
    params = scene.parameters(values)

    def largest(tolerance: Any, controlled: bool) -> Any:
        def forces(log: Any) -> Any:
            moved = {**params, "stiffness": params["stiffness"] * jnp.exp(log)}
            how = Plan(tolerance, MAX_STEPS, controlled)
            found = bj.force_history(scene, moved, TIMES[:121], accuracy=how, mode="forward")
            return [force[..., 0] for force in found.values()]

        slopes = jax.jvp(forces, (jnp.zeros(()),), (jnp.ones(()),))[1]
        return jnp.max(jnp.stack([jnp.max(jnp.abs(slope)) for slope in slopes]))

    programs = {controlled: jax.jit(lambda x, c=controlled: largest(x, c)) for controlled in (False, True)}
    return {
        f"{'BDF' if controlled else 'SDIRK2'} {tolerance:g}": float(programs[controlled](jnp.asarray(tolerance)))
        for tolerance, controlled in TOLERANCES
    }


PARTS: dict[str, Callable[..., Any]] = {"derivatives": derivatives, "calibration": calibration, "tangents": tangents}
# Of which variants, unless some are asked for.
USUAL = {name: list(VARIANTS)[: 3 if name != "tangents" else None] for name in PARTS}


def main() -> None:
    """The parts asked for, of the variants asked for or all."""
    jax.config.update("jax_compilation_cache_dir", str(ROOT / "build" / "jax-cache"))
    asked = sys.argv[1:]
    for name in [x for x in asked if x in PARTS] or PARTS:
        for variant in [x for x in asked if x in VARIANTS] or USUAL[name]:
            found = PARTS[name](*VARIANTS[variant])
            known = load("joint_fuller") if (RESULTS / "joint_fuller.json").exists() else {}
            known.pop("environment", None)
            save("joint_fuller", known | {name: known.get(name, {}) | {variant: found}})


if __name__ == "__main__":
    main()
