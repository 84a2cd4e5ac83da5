"""Cost against size: time by horizon, balls and parameters; memory of forward derivatives by horizon.

An exponent of 1 is linear: log(time) by log(size) is a line of that slope, given with its 95 % interval. Time is the
median of repeated runs, compiling apart; of each run its wall or the processor time of the call, whichever is less,
so that others on the same core do not count. Time by horizon and by balls is also given per step, which chance shifts
do not touch. Memory is what the compiled program reserves beside its input and output, and the process's peak.

    python -m benchmarks.solve.size    writes results/size.json and the table in docs/tradeoff.md
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import t as student

import benchmarks.common as harness
from bcfj_jax import scenes, simulate
from bcfj_jax.analysis.derivatives.jacobian import level
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import plan
from bcfj_jax.solve.simulation import force_history
from benchmarks.clock import keep_programs
from benchmarks.common import load, publish, save

REPEATS = 5
REVOLUTION = 0.6
TURNS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
DROPS = (5, 10, 20, 40, 80, 160)
BALLS = (3, 6, 9, 18)
PARAMETERS = (1, 2, 8, 24)
SAMPLES = 201


def slope(sizes: Any, values: Any) -> tuple[float, float, float]:
    """Exponent of values by sizes, and the ends of its 95 % interval."""
    (power, _), spread = np.polyfit(np.log(sizes), np.log(values), 1, cov=True)
    half = student.ppf(0.975, len(sizes) - 2) * np.sqrt(spread[0, 0])
    return float(power), float(power - half), float(power + half)


def row(what: str, sizes: Any, walls: list[float], steps: list[int]) -> dict[str, Any]:
    found = {"what": what, "sizes": list(sizes), "time_s": walls, "steps": steps}
    per_step = np.array(walls) / np.array(steps)
    found |= {"time": slope(sizes, walls), "work": slope(sizes, per_step)}
    print(what, found["time"], walls, flush=True)
    return found


def median(run: Callable[[], tuple[float, int]], repeats: int) -> tuple[float, int]:
    """Median time [s] and steps of a run that tells its wall [s] and steps, after one that compiles."""
    run()
    spent = []
    for _ in range(repeats):
        begin = time.process_time()
        wall, steps = run()
        spent.append((min(wall, time.process_time() - begin), steps))
    return float(np.median([seconds for seconds, _ in spent])), spent[0][1]


def runs(scene: Any, params: Any, end: float) -> tuple[float, int]:
    """Median time [s] and steps of a run."""

    def one() -> tuple[float, int]:
        stats = simulate(scene, params, np.linspace(0.0, end, SAMPLES)).stats
        return stats["wall_s"], int(stats["accepted"] + stats["rejected"])

    return median(one, REPEATS)


def slopes(scene: Any, params: Any, names: tuple[str, ...], end: float) -> tuple[float, int]:
    """The same of a run with derivatives by names."""

    def one() -> tuple[float, int]:
        found = level(scene, params, np.linspace(0.0, end, SAMPLES), names, plan(scene))
        return found.wall_s, found.steps

    return median(one, REPEATS // 2 + 1)


def reserved(scene: Any, params: Any, end: float) -> dict[str, float]:
    """Memory [MB] of forward derivatives of a bounce: of the program, and the process's peak after running it."""
    times = jnp.linspace(0.0, end, SAMPLES)

    def one(stiffness: jax.Array, times: jax.Array) -> jax.Array:
        return force_history(scene, {**params, "stiffness": stiffness}, times, mode="forward")["contact"]

    program = jax.jit(jax.jacfwd(one)).lower(params["stiffness"], times).compile()
    jax.block_until_ready(program(params["stiffness"], times))
    analysis = program.memory_analysis()
    assert analysis is not None, "this backend does not tell its memory"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"end": end, "program": analysis.temp_size_in_bytes / 2**20, "peak": peak}


def sized(params: Any, balls: int) -> dict[str, float]:
    """Numbers of a joint of so many balls that fit, each loaded as one of the six, and sliding as fast."""
    grow = max(1.0, balls / 9)
    pitch, wall = grow * float(params["pitch_radius"]), float(params["seat_radius"] - params["pitch_radius"])
    radii = {"pitch_radius": pitch, "seat_radius": pitch + wall, "head_radius": pitch - wall}
    torque = float(params["load_torque"]) * balls / 6 * grow
    speed = grow * float(params["friction_speed"])
    return {"load_torque": torque, "offset": grow * float(params["offset"]), "friction_speed": speed, **radii}


def main() -> None:
    keep_programs()
    drop, joint = scenes.bounce(), scenes.joint_of_keys(**PLAIN)
    elastic, params = drop.parameters(damping=0.0), joint.parameters()
    flight = 2 * float(np.sqrt(2 * 0.1 / 9.81))
    names = tuple(name for name in joint.quantities if params.get(name) and name != "load_ramp")

    def of_balls(n: int) -> tuple[float, int]:
        scene = scenes.joint_of_keys(balls=n, **PLAIN)
        return runs(scene, scene.parameters(sized(params, n)), 0.1)

    memory = [reserved(drop, elastic, n * flight) for n in DROPS]
    cases: dict[str, tuple[tuple, Callable[..., tuple[float, int]]]] = {
        "bounce by contacts": (DROPS, lambda n: runs(drop, elastic, (n + 0.5) * flight)),
        "joint by revolutions": (TURNS, lambda n: runs(joint, params, n * REVOLUTION)),
        "joint's derivatives by parameters": (PARAMETERS, lambda n: slopes(joint, params, names[:n], 0.1)),
        "joint by balls": (BALLS, of_balls),
    }
    rows = [row(name, sizes, *map(list, zip(*map(one, sizes), strict=True))) for name, (sizes, one) in cases.items()]
    save("size", {"rows": rows, "memory": memory})
    publish("size", table(load("size")), "docs/tradeoff.md")


def table(result: dict[str, Any]) -> str:
    text, memory = "{%s[0]:.2f} ({%s[1]:.2f} to {%s[2]:.2f})", result["memory"]
    note = f"Forward derivatives of {DROPS[0]} to {DROPS[-1]} contacts reserve {memory[0]['program']:.2f} to "
    return harness.table({
        "size": "{what}", "from": "{sizes[0]:g}", "to": lambda r: f"{r['sizes'][-1]:g}",
        "time goes as size to the": text.replace("%s", "time"), "time a step as size to the": text.replace("%s", "work"),
    }, result["rows"]) + f"\n\n{note}{memory[-1]['program']:.2f} MB."  # fmt: skip


if __name__ == "__main__":
    main()
