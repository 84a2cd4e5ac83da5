"""Why the joint keeps a closed form: its own field and structure beside the same joint of generic parts.

    python -m benchmarks.models.joint_mechanism        some five minutes

The state is that of full load. Variants take turns, so that what else runs on the machine falls on all alike; times are
medians of compiled programs, one thread of XLA, results awaited. A run is 0.1 s by RODAS3 at the joint's tolerance for
1 %, its error measured in the joint's sizes in each layout of the state.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
os.environ.setdefault("EQX_ON_ERROR", "nan")

import dataclasses

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import bcfj_jax as bj
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.structure import AbstractStructure, Dense
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.parts import as_mechanism
from bcfj_jax.solve.integrate import Plan, _field, _solved, integrate, plan, problem
from bcfj_jax.solve.rodas import Rodas
from benchmarks.common import save

LANES, ROUNDS, PASSES = 64, 7, {1: 2000, 64: 100}
TIMES = jnp.linspace(0.0, 0.1, 51)
JOINT = bj.scenes.joint()


def sizes(mechanism: Mechanism, params: Any, end: Any) -> Array:
    """The joint's error scale in the mechanism's layout; the cage's axis moves by twice its quaternion."""
    own = JOINT.error_scale(params, end)
    place, speed, radius = own[0], own[3 * JOINT.balls + JOINT.border], params["pitch_radius"]
    turning = {"angle": 1.0, "speed": 1.0, "wx": 1.0, "wy": 1.0, "wz": 1.0} | dict.fromkeys(("q0", "q1", "q2", "q3"), 0.5)
    found = []
    for scale, group in ((place, mechanism._placed), (speed, mechanism._free)):
        for _, key, members in group:
            size = scale * turning[key] / radius if key in turning else scale
            found.append(jnp.broadcast_to(size, (members or 1,)))
    return jnp.concatenate(found)


GENERIC = dataclasses.replace(as_mechanism(JOINT), scale=sizes)
# By variant: the model, and the structure for an implicit solver.
VARIANTS: dict[str, tuple[Any, AbstractStructure]] = {
    "closed form, arrowhead": (JOINT, Arrowhead()),
    "closed form, dense": (JOINT, Dense(_field)),
    "generic, dense": (GENERIC, Dense(_field)),
}


def run(model: Any, structure: AbstractStructure, params: Any, how: Plan) -> Any:
    """0.1 s by RODAS3 on a structure."""
    posed = problem(model, params, TIMES[-1], how, False)
    posed = posed._replace(field=structure.field, solver=Rodas(structure))
    return _solved(posed, TIMES, how, dfx.ForwardMode())


def field_passes(model: Any, params: Any, y: Array, count: int) -> Callable[[], Any]:
    """Compiled: the field ``count`` times, one after the other, of states (n,) or (lanes, n)."""
    prepared = model.prepare(params)
    one = lambda y: y + 1e-15 * model.vector_field(jnp.asarray(0.09), y, prepared)  # noqa: E731
    body = jax.vmap(one) if y.ndim == 2 else one
    loop = jax.jit(lambda y: jax.lax.scan(lambda y, _: (body(y), None), y, None, length=count)[0]).lower(y).compile()
    return lambda: loop(y)


def turns(programs: dict[str, Callable[[], Any]], per: dict[str, float]) -> dict[str, float]:
    """Median seconds over ``per`` of every program, taking turns."""
    taken: dict[str, list[float]] = {name: [] for name in programs}
    for call in programs.values():
        jax.block_until_ready(call())
    for _ in range(ROUNDS):
        for name, call in programs.items():
            begin = time.perf_counter()
            jax.block_until_ready(call())
            taken[name].append(time.perf_counter() - begin)
    return {name: float(np.median(x)) / per[name] for name, x in taken.items()}


def fields() -> dict[str, Any]:
    """Microseconds of one field, alone and per lane of 64."""
    found = {}
    models = {"closed form": JOINT, "generic": GENERIC}
    for lanes, count in PASSES.items():
        programs = {}
        for name, model in models.items():
            params = model.parameters()
            loaded = integrate(model, params, jnp.asarray([0.0, 0.09]), plan(JOINT), dfx.ForwardMode()).states[-1]
            noise = 1e-9 * jnp.asarray(np.random.default_rng(0).normal(size=(lanes, loaded.size)))
            programs[name] = field_passes(model, params, loaded + noise[0] if lanes == 1 else loaded + noise, count)
        seconds = turns(programs, dict.fromkeys(programs, count * lanes))
        found[f"lanes {lanes}"] = {f"{name}, us": 1e6 * x for name, x in seconds.items()}
        found[f"lanes {lanes}"]["generic over closed form"] = seconds["generic"] / seconds["closed form"]
    return found


def runs() -> dict[str, Any]:
    """Seconds of a run, alone and per lane of 64 clearances; seconds to compile; steps."""
    how, found = plan(JOINT, 1e-2), {}
    for lanes in PASSES:
        programs, made = {}, {}
        for name, (model, structure) in VARIANTS.items():
            params = model.parameters()
            call = lambda p, model=model, structure=structure: run(model, structure, p, how)  # noqa: E731
            if lanes > 1:
                params = {key: jnp.broadcast_to(x, (lanes,)) for key, x in params.items()}
                params["clearance_seat_cage"] = jnp.linspace(20e-6, 100e-6, lanes)
                call = jax.vmap(call)
            begin = time.perf_counter()
            compiled = jax.jit(call).lower(params).compile()
            spent = time.perf_counter() - begin
            steps = compiled(params)
            programs[name] = lambda compiled=compiled, params=params: compiled(params)
            made[name] = {
                "compile, s": spent,
                "accepted": float(jnp.mean(steps.accepted)), "rejected": float(jnp.mean(steps.rejected)),
            }  # fmt: skip
        seconds = turns(programs, dict.fromkeys(programs, lanes))
        first = seconds["closed form, arrowhead"]
        found[f"lanes {lanes}"] = {
            name: {"run, ms": 1e3 * x, "over closed form, arrowhead": x / first, **made[name]} for name, x in seconds.items()
        }
    return found


def main() -> None:
    content = {"field": fields(), "run": runs()}
    print(content)
    save("joint_mechanism", content)


if __name__ == "__main__":
    main()
