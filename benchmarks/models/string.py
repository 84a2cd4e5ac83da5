"""What does a string of n joints cost, at rest, in motion and with joints in full motion, and does it balance?

    python -m benchmarks.models.string --parts motion rest full balance accuracy     some five minutes each; results/string.json
    python -m benchmarks.models.string --parts rest --counts 20 50     in pieces: every count is kept as soon as it is there

Every string runs in a process of its own that keeps no program: 0.6 s at an error of 1 %, twice. Seconds are those of the
processor. The exponent of cost is fitted to the second runs from 5 joints on; of joints in full motion to all as well, with that
of the steps. Compilation is what the first run takes more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import benchmarks.common as harness
from benchmarks import processes
from benchmarks.clock import clocked
from benchmarks.common import options, parts, publish

COUNTS, END, SAMPLES, ERROR = (1, 2, 5, 10, 20, 50), 0.6, 61, 0.01
# Of 50 joints the wall takes more than the usual drive has.
GIVEN = {"drive_torque": 50e3}
MOTIONS = {"rest": ("none", "quasistatic"), "motion": ("torsional", "quasistatic"), "full": ("torsional", "dynamic")}


def measured(count: int, motion: str, fidelity: str) -> dict[str, Any]:
    """Of one string: CPU seconds of the first and of a second run (in a process of its own)."""
    import bcfj_jax as bj

    scene = bj.scenes.string(n=count, motion=motion, fidelity=fidelity)
    params = scene.parameters(GIVEN)
    times = np.linspace(0.0, END, SAMPLES)
    run, first = clocked(lambda: bj.simulate(scene, params, times, accuracy=ERROR))
    again = min((clocked(lambda: bj.simulate(scene, params, times, accuracy=ERROR))[1] for _ in range(3)), key=_cpu)
    seconds = {"first_s": _cpu(first), "again_s": _cpu(again), "wall_s": again["wall_s"]}
    return {"status": run.status, "steps": int(run.stats["accepted"] + run.stats["rejected"]), **seconds}


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


def accuracy() -> dict[str, Any]:
    """By number of joints in full motion, the forces of the worst joint off those at a tenth of the error: rms over the peak."""
    import bcfj_jax as bj

    times, rows = np.linspace(0.0, END, 10 * SAMPLES), {}
    for count in (1, 10, 50):
        scene = bj.scenes.string(n=count, motion="torsional", fidelity="dynamic")
        coarse, fine = (bj.simulate(scene, scene.parameters(GIVEN), times, accuracy=e) for e in (ERROR, 0.1 * ERROR))
        off = 0.0
        for name, force in fine.force.items():
            if top := float(np.abs(force[..., 0]).max()):
                apart = np.sqrt(np.mean((coarse.force[name] - force)[..., 0] ** 2, axis=0))
                off = max(off, float(apart.max()) / top)
        rows[str(count)] = off
        print(count, off, flush=True)
    return rows


def of(part: str, counts: Sequence[int]) -> dict[str, Any]:
    """Rows of some counts beside those that are kept, and ``fitted`` where all are there."""
    rows = dict(harness.known("string").get(part, {}).get("rows", {})) if len(counts) < len(COUNTS) else {}
    for count in counts:
        rows[str(count)] = processes.call(__file__, "measured", count, *MOTIONS[part], variables={"BCFJ_CACHE": "off"})
        print(part, count, rows[str(count)], flush=True)
        harness.add("string", {part: {"rows": rows}})
    rows = {str(n): rows[str(n)] for n in COUNTS if str(n) in rows}
    return fitted(rows) if len(rows) == len(COUNTS) else {"rows": rows}


def fitted(rows: dict[str, Any]) -> dict[str, Any]:
    """With the exponent of cost from 5 joints on, and compilation at the most joints over that at 2."""
    again = {int(n): row["again_s"] for n, row in rows.items()}
    many = [n for n in again if n >= 5]
    compiled = {int(n): row["first_s"] - row["again_s"] for n, row in rows.items()}
    slope = lambda x, counts: float(np.polyfit(np.log(counts), np.log([x[n] for n in counts]), 1)[0])  # noqa: E731
    found = {"rows": rows, "exponent": slope(again, many), "compilation": compiled[max(again)] / compiled[2]}
    if all("steps" in row for row in rows.values()):
        steps = {int(n): row["steps"] for n, row in rows.items()}
        found |= {"exponent_all": slope(again, [*again]), "exponent_steps": slope(steps, [*steps])}
    return found


def table(found: dict[str, Any]) -> str:
    """Rows by joints, of the parts that were measured."""
    heads = {"rest": "at rest", "motion": "in motion", "full": "with joints in full motion"}
    columns: dict[str, Any] = {"joints": lambda n: n}
    whole = [part for part in heads if "exponent" in found.get(part, {})]
    for part in whole:
        rows = found[part]["rows"]
        columns[f"{heads[part]}: first run, compiling [s]"] = lambda n, rows=rows: f"{rows[n]['first_s']:.1f}"
        columns[f"{heads[part]}: again [s]"] = lambda n, rows=rows: f"{rows[n]['again_s']:.2f}"
        if part == "full":
            columns["steps"] = lambda n, rows=rows: str(rows[n]["steps"])
    for key in ("torque", "power"):
        columns[f"{key} off balance"] = lambda n, key=key: f"{found['balance'][n][key]:.1e}"
    said = [_said(found[part], heads[part]) for part in whole]
    if off := found.get("accuracy"):
        worst = ", ".join(f"{100 * x:.2g} % at {n}" for n, x in off.items())
        said.append(
            f"Forces of the worst joint in full motion off those at a tenth of the error, rms over the peak: {worst}."
        )
    return "\n\n".join([harness.table(columns, map(str, COUNTS)), " ".join(said)])


def _said(part: dict[str, Any], where: str) -> str:
    most = list(part["rows"])[-1]
    steps = ""
    if "exponent_all" in part:
        steps = f" (from 1 on {part['exponent_all']:.2f}, of which steps {part['exponent_steps']:.2f})"
    return (
        f"Exponent of cost from 5 joints on {where}: {part['exponent']:.2f}{steps}; compilation at {most} joints over that at 2: "
        f"{part['compilation']:.2f}."
    )


def main() -> None:
    """The parts chosen, and the table."""
    todo: dict[str, Any] = {"balance": balance, "accuracy": accuracy}
    todo |= {part: lambda part=part: of(part, asked.counts) for part in MOTIONS}
    asked = options(__doc__, parts=list(todo), counts=list(COUNTS))
    parts("string", todo, asked.parts)
    publish("string", table(harness.known("string")), "docs/string.md")


if __name__ == "__main__":
    main()
