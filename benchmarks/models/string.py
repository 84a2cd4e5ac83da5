"""What does a string of n joints cost, at rest and in motion, and do torque and power balance along it?

    python -m benchmarks.models.string --parts motion rest balance     some five minutes each; benchmarks/results/string.json

Every string runs in a process of its own that keeps no program: 0.6 s at an error of 1 %, twice. Seconds are those of the
processor. The exponent of cost is fitted to the second runs from 5 joints on; compilation is what the first run takes more.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

import benchmarks.common as harness
from benchmarks import processes
from benchmarks.clock import clocked
from benchmarks.common import options, parts, publish

COUNTS, END, SAMPLES, ERROR = (1, 2, 5, 10, 20, 50), 0.6, 61, 0.01
# Of 50 joints the wall takes more than the usual drive has.
GIVEN = {"drive_torque": 50e3}
MOTIONS = {"rest": "none", "motion": "torsional"}


def measured(count: int, motion: str) -> dict[str, Any]:
    """Of one string: CPU seconds of the first and of a second run (in a process of its own)."""
    import bcfj_jax as bj

    scene = bj.scenes.string(n=count, motion=motion)
    params = scene.parameters(GIVEN)
    times = np.linspace(0.0, END, SAMPLES)
    run, first = clocked(lambda: bj.simulate(scene, params, times, accuracy=ERROR))
    again = min((clocked(lambda: bj.simulate(scene, params, times, accuracy=ERROR))[1] for _ in range(3)), key=_cpu)
    return {"status": run.status, "first_s": _cpu(first), "again_s": _cpu(again), "wall_s": again["wall_s"]}


def _cpu(seconds: dict[str, float]) -> float:
    return seconds["cpu_s"]


def balance() -> dict[str, Any]:
    """By number of joints, how far momentum and energy are from what torques bring and take, as shares of the drive's.

    Of a run at a tenth of the tolerance, from 3001 instants. Momentum: that of all lumps about the string's axis.
    """
    import jax
    import jax.numpy as jnp

    import bcfj_jax as bj
    from bcfj_jax.models.string_motion import inertias
    from bcfj_jax.solve.integrate import integrate
    from bcfj_jax.solve.plan import plan

    times, rows = jnp.linspace(0.0, END, 3001), {}
    for count in COUNTS:
        scene: Any = bj.scenes.string(n=count, motion="torsional")
        params = scene.parameters(GIVEN)

        @jax.jit
        def history(params: Any, scene: Any = scene, count: int = count) -> Any:
            states = integrate(scene, params, times, plan(scene, 0.1 * ERROR)).states
            held = scene.prepare(params)

            def look(t: Any, y: Any) -> Any:
                angle, speed = y[:count], y[count:]
                rest = sum(load.on_coordinate(t, angle, speed, held).sum() for load in scene.torsion.loads[1:])
                torque = scene.torque(t, y, held)[0]
                return scene.flows(t, y, held), torque, rest, inertias(params, count) @ speed

            return jax.vmap(look)(times, states)

        found: Any = jax.tree.map(np.asarray, history(params))
        flows, torque, rest, momentum = found
        brought = np.trapezoid(torque, times)
        turned = brought + np.trapezoid(rest, times) - (momentum[-1] - momentum[0])
        given, taken = (np.trapezoid(sum(part.values()), times) for part in (flows.given, flows.taken))
        stored: Any = sum(flows.stored.values())
        power = given - taken - (stored[-1] - stored[0])
        rows[str(count)] = {"torque": float(abs(turned) / brought), "power": float(abs(power) / given)}
        print(count, rows[str(count)], flush=True)
    return rows


def of(part: str) -> dict[str, Any]:
    """Rows of all counts, the exponent and the ratio of compilation."""
    rows = {}
    for count in COUNTS:
        rows[str(count)] = processes.call(__file__, "measured", count, MOTIONS[part], variables={"BCFJ_CACHE": "off"})
        print(part, count, rows[str(count)], flush=True)
    many = [n for n in COUNTS if n >= 5]
    again = {n: rows[str(n)]["again_s"] for n in COUNTS}
    compiled = {n: rows[str(n)]["first_s"] - again[n] for n in COUNTS}
    slope = float(np.polyfit(np.log(many), np.log([again[n] for n in many]), 1)[0])
    return {"rows": rows, "exponent": slope, "compilation": compiled[50] / compiled[2], "load": os.getloadavg()[0]}


def table(found: dict[str, Any]) -> str:
    """Rows by joints; of motion its balances."""
    columns = {
        "joints": lambda one: one[0],
        "at rest: first run, compiling [s]": lambda one: f"{found['rest']['rows'][one[0]]['first_s']:.1f}",
        "again [s]": lambda one: f"{found['rest']['rows'][one[0]]['again_s']:.2f}",
        "in motion: first run [s]": lambda one: f"{one[1]['first_s']:.1f}",
        "again [s] ": lambda one: f"{one[1]['again_s']:.2f}",
        "torque off balance": lambda one: f"{found['balance'][one[0]]['torque']:.1e}",
        "power off balance": lambda one: f"{found['balance'][one[0]]['power']:.1e}",
    }
    said = (
        f"Exponent from 5 to 50 joints: {found['rest']['exponent']:.2f} at rest, {found['motion']['exponent']:.2f} in motion. "
        f"Compilation at 50 joints over 2: {found['rest']['compilation']:.2f} and {found['motion']['compilation']:.2f}."
    )
    return f"{harness.table(columns, found['motion']['rows'].items())}\n\n{said}"


def main() -> None:
    """The parts chosen, and the table."""
    todo: dict[str, Any] = {part: lambda part=part: of(part) for part in MOTIONS} | {"balance": balance}
    parts("string", todo, options(__doc__, parts=list(todo)).parts)
    publish("string", table(harness.known("string")), "docs/string.md")


if __name__ == "__main__":
    main()
