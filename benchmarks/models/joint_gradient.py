"""Gradient of one number by a hundred parameters of the joint: reverse mode beside the run itself, and its memory.

python -m benchmarks.models.joint_gradient    writes results/joint_gradient.json, prints a table
"""

from __future__ import annotations

import os
import time
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.common import markdown, save

END_S, SAMPLES, COUNT, REPEATS = 0.6, 601, 100, 5
SCENE = bj.scenes.joint(**PLAIN)
TIMES = jnp.linspace(0.0, END_S, SAMPLES)


def parameters() -> dict[str, Any]:
    """The joint's parameters, and as many of its contacts' own coefficients as make up ``COUNT`` that are not 0."""
    params = SCENE.parameters()
    names = [name for name, value in params.items() if float(value) != 0.0]
    for own in SCENE.quantities:
        shared = own.partition(".")[2]
        if len(names) < COUNT and own not in params and shared in params and float(params[shared]) != 0.0:
            params, _ = complete(SCENE, params, (own,))
            names.append(own)
    return {name: params[name] for name in names}


def timed(program: Any, *arguments: Any) -> tuple[Any, float]:
    """What a program returns, and the median wall of several runs."""
    result, walls = jax.block_until_ready(program(*arguments)), []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        jax.block_until_ready(program(*arguments))
        walls.append(time.perf_counter() - begin)
    return result, float(np.median(walls))


def main() -> None:
    named = parameters()
    tolerance = plan(SCENE, "balanced").tolerance
    fixed = SCENE.parameters()

    def scalar(logs: Any, max_steps: int, mode: Any) -> Any:
        changed = {name: value * jnp.exp(log) for (name, value), log in zip(named.items(), logs, strict=True)}
        forces = bj.force_history(SCENE, {**fixed, **changed}, TIMES, accuracy=Plan(tolerance, max_steps), mode=mode)
        return jnp.mean(forces["seat_cage"][:, 0] ** 2)

    zero, rows = jnp.zeros(len(named)), []
    forward = jax.jit(lambda x: scalar(x, 4000, "forward")).lower(zero).compile()
    _, alone = timed(forward, zero)
    directional = jax.jit(lambda x, v: jax.jvp(lambda x: scalar(x, 4000, "forward"), (x,), (v,))[1])
    way = jnp.asarray(np.random.default_rng(0).normal(size=len(named)))
    expected = float(directional(zero, way))
    # The adjoint's checkpoints grow with the root of the budget.
    for max_steps in (4000, 400_000):
        begin = time.perf_counter()
        program = jax.jit(jax.grad(lambda x, n=max_steps: scalar(x, n, "reverse"))).lower(zero).compile()
        compile_s = time.perf_counter() - begin
        gradient, wall = timed(program, zero)
        memory = program.memory_analysis()
        assert memory is not None
        rows.append(
            {
                "max_steps": max_steps,
                "parameters": len(named),
                "wall_s": wall,
                "forward_wall_s": alone,
                "ratio": wall / alone,
                "memory_MB": memory.temp_size_in_bytes / 1e6,
                "compile_s": compile_s,
                "against_forward": abs(float(gradient @ way) / expected - 1.0),
            }
        )
        print(rows[-1], flush=True)
    save("joint_gradient", {"rows": rows})
    head = [
        "budget",
        "parameters",
        "run s",
        "gradient s",
        "times",
        "memory MB",
        "compile s",
        "along a direction, from jvp",
    ]
    table = [
        [f"{r['max_steps']}", f"{r['parameters']}", f"{r['forward_wall_s']:.3f}", f"{r['wall_s']:.3f}",
         f"{r['ratio']:.1f}", f"{r['memory_MB']:.0f}", f"{r['compile_s']:.0f}", f"{r['against_forward']:.1e}"]
        for r in rows
    ]  # fmt: skip
    print(markdown([head, *table]))


if __name__ == "__main__":
    main()
