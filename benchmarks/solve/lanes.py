"""What one lane of a batch costs: the joint's field, Jacobian blocks, factorisation, solve and RODAS3 step.

    python -m benchmarks.solve.lanes [--lanes 1 64 256] [--what step] [--name now]    results/lanes.json, under that name

One core, compiled programs, CPU time, medians. Every operation stands in a loop on the device, so that its dispatch does not
count; a lane has its own state, its own parameters and its own step. States are those of a run at full load.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

# Before jax is imported: one thread. bcfj_jax adds its own options.
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_multi_thread_eigen=false".strip()

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import bcfj_jax as bj
from bcfj_jax.models.joint import arrowhead
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve import rodas
from bcfj_jax.xla.backend import set_up
from benchmarks.clock import clocked, seconds
from benchmarks.common import Some, add, markdown, options

SCENES: dict[str, dict[str, Any]] = {"default": {}, "plain": PLAIN}
LANES = (1, 64, 256)
REPEATS, LEAST = 7, 0.1  # CPU seconds of one timed call at least
STEP = 2e-5  # [s]


def states(scene: Any, lanes: int) -> tuple[dict[str, Array], Array]:
    """Parameters (lanes,) and states (lanes, n): of one run between 0.1 and 0.15 s, with clearances that differ by 5 %."""
    params = scene.parameters()
    run = bj.simulate(scene, params, np.linspace(0.0, 0.15, 1501))
    some = np.asarray(run.trajectory)[1000 + (np.arange(lanes) * 131) % 500]
    factor = 1.0 + 0.05 * np.linspace(-1.0, 1.0, lanes)
    leaves = {name: jnp.full(lanes, value) for name, value in params.items()}
    leaves["clearance_seat_cage"] = leaves["clearance_seat_cage"] * factor
    return leaves, jnp.asarray(some)


def operations(scene: Any) -> dict[str, Callable[..., Any]]:
    """What is timed, of one lane: (args, factors, t, y, h) -> arrays."""
    structure = scene.structure()
    return {
        "field": lambda args, factors, t, y, h: structure.field(t, y, args),
        "blocks": lambda args, factors, t, y, h: arrowhead._blocks(*args, y, None),
        "factor": lambda args, factors, t, y, h: structure.factor(t, y, args, h * rodas.GAMMA),
        "solve": lambda args, factors, t, y, h: structure.solve(factors, y),
        "step": lambda args, factors, t, y, h: rodas._step(structure, t, t + h, y, args),
    }


def timed(scene: Any, params: dict[str, Array], y: Array, what: Callable[..., Any]) -> dict[str, float]:
    """Microseconds of one lane, and seconds of tracing and compiling, of one operation."""
    lanes = len(y)
    structure = scene.structure()
    t, h = 0.1 + jnp.zeros(lanes), STEP * (1.0 + 0.01 * jnp.arange(lanes))
    prepared = jax.jit(jax.vmap(scene.prepare))(params)
    factor = lambda c, t, y, h: structure.factor(t, y, (scene, c), h * rodas.GAMMA)  # noqa: E731
    factors = jax.jit(jax.vmap(factor))(prepared, t, y, h)
    one = lambda c, factors, t, y, h: what((scene, c), factors, t, y, h)  # noqa: E731
    batch = jax.vmap(one)

    def loop(count: Array, c: Any, factors: Any, t: Array, y: Array, h: Array) -> Any:
        """Every result is kept, and the next state hangs on it: nothing can be left out."""

        def body(_: Any, carry: tuple[Array, Any]) -> tuple[Array, Any]:
            y, _ = carry
            found = batch(c, factors, t, y, h)
            first = jax.tree.leaves(found)[0].reshape(lanes, -1)[:, :1]
            return y + 1e-30 * first, found

        empty = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(batch, c, factors, t, y, h))
        return jax.lax.fori_loop(0, count, body, (y, empty))

    arguments = prepared, factors, t, y, h
    program, took = clocked(lambda: jax.jit(loop).lower(jnp.asarray(1), *arguments).compile())

    def took_s(count: int, repeats: int = 1) -> float:
        return float(np.median(seconds(lambda: program(jnp.asarray(count), *arguments), repeats)))

    count = 1
    while took_s(count) < LEAST:
        count *= 2
    return {"us": 1e6 * took_s(count, REPEATS) / count / lanes, "compile_s": took["cpu_s"]}


def main() -> None:
    every = ["field", "blocks", "factor", "solve", "step"]
    given = options(__doc__, lanes=Some(LANES), name="now", scenes=SCENES, what=every)
    set_up()
    jax.config.update("jax_enable_compilation_cache", False)
    found: dict[str, Any] = {}
    table: list[list[Any]] = [["joint", "lanes", *given.what]]
    for name in given.scenes:
        scene, found[name] = bj.scenes.joint_of_keys(**SCENES[name]), {}
        for lanes in given.lanes:
            params, y = states(scene, lanes)
            row = {what: timed(scene, params, y, operations(scene)[what]) for what in given.what}
            print(name, lanes, row, flush=True)
            found[name][str(lanes)] = row
            table.append([name, lanes, *(f"{cell['us']:.3g}" for cell in row.values())])
    print(markdown(table))
    add("lanes", {given.name: found})


if __name__ == "__main__":
    main()
