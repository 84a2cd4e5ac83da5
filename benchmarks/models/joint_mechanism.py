"""Why the joint keeps a closed form: its own field and structure beside the same joint of generic parts.

    python -m benchmarks.models.joint_mechanism        some five minutes

Variants take turns. Times are CPU times of the process, which does nothing else, of compiled programs, one thread of XLA,
results awaited: on a busy machine they are steady where wall times are not. A run is 0.1 s by RODAS3 at the joint's
tolerance for 1 %, its error measured in the joint's sizes in each layout of the state. The field's state is the run's
last, of full load.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import bcfj_jax as bj
import benchmarks.clock as clock
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import field
from bcfj_jax.mechanism.structure import AbstractStructure, Dense
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.integrate import _solved, problem
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.rodas import Rodas
from benchmarks.common import save
from benchmarks.references.joint_parts import as_mechanism

# Waiting for another thread costs CPU time.
jax.config.update("jax_cpu_enable_async_dispatch", False)

# By size of the batch, fields in a row.
ROUNDS, PASSES = 7, {1: 5000, 64: 200}
TIMES = jnp.linspace(0.0, 0.1, 51)
JOINT = bj.scenes.joint_of_keys(**PLAIN)


def sizes(mechanism: Mechanism, params: Any, end: Any) -> Array:
    """The joint's error scale in the mechanism's layout; the cage's axis moves by twice its quaternion."""
    own = JOINT.error_scale(params, end)
    place, speed, radius = own[0], own[3 * JOINT.balls + JOINT.coupling], params["pitch_radius"]
    turning = {"angle": 1.0, "speed": 1.0, "wx": 1.0, "wy": 1.0, "wz": 1.0} | dict.fromkeys(
        ("q0", "q1", "q2", "q3"), 0.5
    )
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
    "closed form, dense": (JOINT, Dense(field)),
    "generic, dense": (GENERIC, Dense(field)),
}


def run(model: Any, structure: AbstractStructure, how: Plan, params: Any) -> Any:
    """0.1 s by RODAS3 on a structure."""
    posed = problem(model, params, TIMES[-1], how, False)
    posed = posed._replace(field=structure.field, solver=Rodas(structure))
    return _solved(posed, TIMES, how, "forward")


def field_passes(model: Any, params: Any, y: Array, count: int) -> Callable[[], Any]:
    """Compiled: the field ``count`` times, one after the other, of states (n,) or (batch, n)."""
    prepared = model.prepare(params)
    one = lambda y: y + 1e-15 * model.vector_field(jnp.asarray(0.09), y, prepared)  # noqa: E731
    body = jax.vmap(one) if y.ndim == 2 else one
    loop = jax.jit(lambda y: jax.lax.scan(lambda y, _: (body(y), None), y, None, length=count)[0]).lower(y).compile()
    return lambda: loop(y)


def turns(programs: dict[str, Callable[[], Any]], per: float, first: str) -> dict[str, dict[str, float]]:
    """Microseconds over ``per`` of every program, taking turns, median and least; and over those of the first."""
    taken = clock.turns(programs, ROUNDS)
    found = {name: {"median": float(np.median(x)), "least": float(np.min(x))} for name, x in taken.items()}
    return {
        name: {f"{what}, us": 1e6 * x / per for what, x in own.items()}
        | {f"{what} over that of {first}": x / found[first][what] for what, x in own.items()}
        for name, own in found.items()
    }


def fields(states: dict[str, Array]) -> dict[str, Any]:
    """One field, alone and per run of 64, in a loaded state of each model."""
    found = {}
    for many, count in PASSES.items():
        programs = {}
        for name, model in {"closed form": JOINT, "generic": GENERIC}.items():
            noise = 1e-9 * jnp.asarray(np.random.default_rng(0).normal(size=(many, states[name].size)))
            y = states[name] + (noise[0] if many == 1 else noise)
            programs[name] = field_passes(model, model.parameters(), y, count)
        found[f"lanes {many}"] = turns(programs, count * many, "closed form")
    return found


def runs() -> tuple[dict[str, Any], dict[str, Array]]:
    """A run alone and per run of 64 clearances, with seconds to compile and steps; and the last states by field."""
    how, found, states = plan(JOINT, 1e-2), {}, {}
    for many in PASSES:
        programs, made = {}, {}
        for name, (model, structure) in VARIANTS.items():
            params = model.parameters()
            call = partial(run, model, structure, how)
            if many > 1:
                params = {key: jnp.broadcast_to(x, (many,)) for key, x in params.items()}
                params["clearance_seat_cage"] = jnp.linspace(20e-6, 100e-6, many)
                call = jax.vmap(call)
            compiled, took = clock.clocked(lambda call=call, params=params: jax.jit(call).lower(params).compile())
            programs[name] = partial(compiled, params)
            steps = compiled(params)
            made[name] = {"compile, s": took["cpu_s"]}
            made[name] |= {key: float(jnp.mean(getattr(steps, key))) for key in ("accepted", "rejected")}
            if many == 1:
                states[name.partition(",")[0]] = steps.states[-1]
        seconds = turns(programs, many, "closed form, arrowhead")
        found[f"lanes {many}"] = {name: own | made[name] for name, own in seconds.items()}
    return found, states


def main() -> None:
    run_times, states = runs()
    content = {"run": run_times, "field": fields(states)}
    print(content)
    save("joint_mechanism", content)


if __name__ == "__main__":
    main()
