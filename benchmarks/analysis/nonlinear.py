"""Nonlinear dynamics: the exponents and bifurcations that are known, and what the joint does.

    python -m benchmarks.analysis.nonlinear [--only known exponents clearance scatter crossing portraits]
writes results/nonlinear.json (costs in CPU seconds), the tables in docs/nonlinear.md and its pictures. On one core:

- known: maps and flows with published or closed-form exponents, period doublings, a bouncing ball;
- exponents: of the joint with the default onset and with a sharp one, by its tangent at four accuracies and by two
  trajectories of another solver;
- clearance: what a window contact's section is at 10 clearances, both onsets: the two minutes' example;
- scatter: how much of the calm joint's scatter is the solver's;
- crossing: the exponent against the same clearance, default onset;
- portraits: of one revolution of the joint.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from bcfj_jax import nonlinear, scenes, simulate
from bcfj_jax.analysis.nonlinear.exponents import advance
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.integrate import integrate, problem
from bcfj_jax.solve.plan import Plan
from benchmarks.clock import clocked, keep_programs
from benchmarks.common import IMAGES, add, markdown, options, publish

PAGE = "docs/nonlinear.md"
SHARP = 1e-6
GRAVITY, HEIGHT, DAMPING = 9.81, 0.1, 20.0
ONSETS = {"default onset, 20 µm": 20e-6, "sharp onset, 1 µm": SHARP}


def lorenz(t, y):
    return jnp.stack([10.0 * (y[1] - y[0]), y[0] * (28.0 - y[2]) - y[1], y[0] * y[1] - 8.0 / 3.0 * y[2]])


def oscillator(t, y):
    return jnp.stack([y[1], -4.0 * y[0] - 0.3 * y[1]])


def logistic(x, r):
    return r * x * (1.0 - x)


def known() -> dict[str, Any]:
    henon = lambda s: jnp.stack([1.0 - 1.4 * s[0] ** 2 + s[1], 0.3 * s[0]])  # noqa: E731
    corner = jnp.array([0.1, 0.1])
    rest = scenes.bounce(smoothing=False)
    at_rest = rest.parameters(drop_height=0.0, damping=DAMPING)
    found = {
        "logistic map, r = 4": (nonlinear.map_exponent(lambda x: logistic(x, 4.0), 0.3, 100_000), math.log(2.0)),
        "Hénon map": (nonlinear.map_exponent(henon, corner, 100_000, transients=100), 0.41922),
        "Hénon map, two trajectories": (nonlinear.two_trajectories(henon, corner, 100_000, transients=100), 0.41922),
        "Lorenz system": (nonlinear.flow_exponent(lorenz, [1.0, 1.0, 20.0], 4000, interval=0.5, transients=40), 0.9056),
        "oscillator, x'' + 0.3 x' + 4 x = 0": (
            nonlinear.flow_exponent(oscillator, [1.0, 0.0], 400, interval=1.0, transients=20), -0.15,
        ),
        "body at rest on its surface (scene bounce)": (
            nonlinear.scene_exponent(rest, at_rest, 50, interval=0.02, settle=0.5), -0.5 * DAMPING * GRAVITY,
        ),
    }  # fmt: skip
    rows = {
        name: {"found": one.value, "standard_error": one.standard_error, "known": right}
        for name, (one, right) in found.items()
    }
    step = 1e-3
    values = np.arange(2.9, 3.5, step)
    orbits = nonlinear.map_bifurcation(logistic, 0.3, values, transients=20_000, kept=64)
    periods = np.array([nonlinear.period_number(row, 1e-6) for row in orbits])
    doublings = [float(values[np.argmax(periods >= p)]) for p in (2, 4)]
    values = np.linspace(2.8, 4.0, 800)
    orbits = nonlinear.map_bifurcation(logistic, 0.3, values, transients=2000, kept=150)
    path = IMAGES / "nonlinear_logistic.png"
    nonlinear.draw_bifurcation(values, orbits, path, parameter="r", reading="x")
    table = [("", "found", "known")]
    table += [
        (name, f"{row['found']:.5g} ± {row['standard_error']:.1g}", f"{row['known']:.5g}") for name, row in rows.items()
    ]
    names = ("logistic map, first doubling", "logistic map, second doubling")
    for name, at, right in zip(names, doublings, (3.0, 1.0 + math.sqrt(6.0)), strict=True):
        table.append((name, f"{at:.3f} (steps of {step:g})", f"{right:.4f}"))
    bounces = bouncing()
    for e, one in bounces.items():
        name = f"bouncing ball, e = {e}: worst of 6 speeds, time of rest"
        table.append((name, f"{one['worst']:.1e}, {one['rest_s']:.4f} s", f"0, {one['zeno_s']:.4f} s"))
    publish("known", markdown(table), PAGE)
    return {"exponents": rows, "doublings": doublings, "doubling_step": step, "bounces": bounces}


def bouncing() -> dict[str, Any]:
    """Six bounces against Newton's restitution and Zeno's time."""
    scene = scenes.bounce("exact", smoothing=False)
    fall, result = math.sqrt(2.0 * HEIGHT / GRAVITY), {}
    for e in (0.5, 0.7, 0.85):
        k = np.arange(6)
        end = fall * (1.0 + 2.0 * sum(e**j for j in range(1, 6))) + 0.5 * fall * e**6
        params = scene.parameters(restitution=e, stiffness=1e12, drop_height=HEIGHT, gravity=GRAVITY)
        run = simulate(scene, params, np.linspace(0.0, end, 8001), accuracy=1e-7)
        found = nonlinear.impacts(run.times, run.penetration["contact"], run.rate["contact"])
        worst = np.max(np.abs(found.speeds / (e**k * fall * GRAVITY) - 1.0))
        rest = found.times[-1] + 2.0 * found.speeds[-1] * e / GRAVITY / (1.0 - e)
        result[str(e)] = {"worst": float(worst), "rest_s": float(rest), "zeno_s": fall * (1.0 + e) / (1.0 - e)}
    return result


def pair_of_runs(smoothing: float, interval: float, intervals: int, separation: float, tolerance: float):
    """The joint's exponent from two runs of RODAS3 at a tolerance far below the separation."""
    scene = scenes.joint_of_keys(**PLAIN)
    params = scene.parameters(smoothing=smoothing)
    settle, how = 1.2, Plan(jnp.asarray(tolerance), 4_000_000)
    start = integrate(scene, params, jnp.array([0.5, 1.0]) * settle, Plan(jnp.asarray(1e-3)), "forward").states[-1]
    posed = problem(scene, params, jnp.asarray(settle + 1.0), how, False)
    seat, cage = scene.slices["seat_turn"], scene.slices["cage_turn"]
    assert seat is not None and cage is not None
    places, rates = 3 * scene.balls, 3 * scene.balls + scene.coupling + 3 * scene.balls
    common = posed.scales.at[jnp.array([places + seat.start, rates + seat.start])].set(0.0)
    axis = slice(places + cage.start, places + cage.stop)

    def step(y):
        y = y.at[axis].set(y[axis] / jnp.linalg.norm(y[axis]))
        # After the load's rise nothing depends on time but the seat's turn, which is a state.
        return advance(posed, how, y, jnp.asarray(settle), jnp.asarray(settle + interval))[0]

    return nonlinear.two_trajectories(
        step, start, intervals, separation=separation, scales=common, transients=intervals // 6, interval=interval,
        batches=2,
    )  # fmt: skip


def exponents() -> dict[str, Any]:
    scene = scenes.joint_of_keys(**PLAIN)
    result: dict[str, Any] = {}
    shown = {}
    table: list[tuple[str, ...]] = [("joint", "force error 1e-3", "1e-4", "1e-5", "1e-6", "two trajectories")]
    for name, smoothing in ONSETS.items():
        params, row = scene.parameters(smoothing=smoothing), {}
        # Two pitches of the rattle, whose separation grows; six of the calm joint.
        pair = (0.1, 6, 1e-3) if smoothing > SHARP else (0.005, 40, 1e-4)
        ways: dict[str, Any] = {
            f"{accuracy:g}": partial(
                nonlinear.scene_exponent, scene, params, 36, settle=1.2, accuracy=accuracy, batches=6
            )
            for accuracy in (1e-3, 1e-4, 1e-5, 1e-6)
        }
        ways["two trajectories"] = partial(pair_of_runs, smoothing, *pair, 1e-6)
        for way, run in ways.items():
            one, took = clocked(run)
            row[way] = {"found": one.value, "standard_error": one.standard_error, "cpu_s": took["cpu_s"]}
            if way == "1e-06":
                shown[name] = one
        result[name] = row
        table.append((name, *(f"{x['found']:.4g} ± {x['standard_error']:.1g} 1/s" for x in row.values())))
        print(name, row, flush=True)
    nonlinear.draw_exponent(shown, IMAGES / "nonlinear_exponents.png")
    publish("exponents", markdown(table), PAGE)
    return result


def clearance() -> dict[str, Any]:
    """Penetration of the windows once per revolution, at 10 clearances of theirs."""
    scene, result = scenes.joint_of_keys(**PLAIN), {}
    values = np.linspace(4e-6, 40e-6, 10)
    # The calm joint's scatter at looser accuracy would be the solver's; the rattle needs no digits, and costs more.
    budgets = (1e-4, 1e-3)
    for key, (name, smoothing), accuracy in zip(("default", "sharp"), ONSETS.items(), budgets, strict=True):
        begin = time.process_time()
        params = scene.parameters(smoothing=smoothing)
        found = nonlinear.bifurcation(
            scene, params, "clearance_cage_ball", values, 24, transients=20, accuracy=accuracy, places=5
        )
        depth = found.penetration["cage_ball"]
        path = IMAGES / f"nonlinear_clearance_{key}.png"
        labels = {"parameter": "clearance of the windows [µm]", "reading": "penetration at phase 0 [µm]"}
        nonlinear.draw_bifurcation(1e6 * values, 1e6 * depth, path, **labels)
        periods = [[nonlinear.period_number(row[:, k], 1e-8, most=2) for k in range(6)] for row in depth]
        result[name] = {
            "clearances_m": values.tolist(), "failed": int(found.failed.sum()), "periods": periods,
            "widest_spread_m": np.ptp(depth, axis=1).max(axis=1).tolist(),
            "cpu_s": time.process_time() - begin,
        }  # fmt: skip
        print(name, result[name], flush=True)
    return result


def scatter() -> dict[str, Any]:
    """How far the unloaded ball's section at the default onset scatters, against the accuracy asked for."""
    scene, result = scenes.joint_of_keys(**PLAIN), {}
    values = np.array([12e-6, 20e-6, 40e-6])
    table = [("force error", *(f"{1e6 * value:.0f} µm" for value in values))]
    for accuracy in (1e-4, 1e-5, 1e-6):
        found = nonlinear.bifurcation(
            scene, scene.parameters(), "clearance_cage_ball", values, 9, transients=5, accuracy=accuracy, places=3
        )
        spread = np.ptp(found.penetration["cage_ball"], axis=1).max(axis=1)
        result[f"{accuracy:g}"] = spread.tolist()
        table.append((f"{accuracy:g}", *(f"{1e6 * one:.2g} µm" for one in spread)))
        print(accuracy, spread, flush=True)
    publish("scatter", markdown(table), PAGE)
    return {"clearances_m": values.tolist(), "spread_m": result}


def crossing() -> dict[str, Any]:
    """The joint's exponent against the clearance of the windows."""
    scene = scenes.joint_of_keys(**PLAIN)
    values, found = np.array([8.0, 12.0, 16.0, 20.0, 30.0, 40.0]) * 1e-6, []
    for value in values:
        params = scene.parameters(clearance_cage_ball=value)
        found.append(nonlinear.scene_exponent(scene, params, 36, settle=1.2, accuracy=1e-5, batches=6))
        print(value, found[-1].value, found[-1].standard_error, flush=True)
    table = [("clearance of the windows", *(f"{1e6 * value:.0f} µm" for value in values))]
    table.append(("exponent [1/s]", *(f"{one.value:.4g} ± {one.standard_error:.1g}" for one in found)))
    publish("crossing", markdown(table), PAGE)
    return {
        "clearances_m": values.tolist(), "found": [one.value for one in found],
        "standard_error": [one.standard_error for one in found],
    }  # fmt: skip


def portraits() -> dict[str, Any]:
    scene = scenes.joint_of_keys(**PLAIN)
    params = scene.parameters(smoothing=SHARP)
    turn = nonlinear.drive_period(scene, params)
    run = simulate(scene, params, np.linspace(0.0, 3.0 * turn, 24_001), accuracy=1e-4)
    window, pitch = (2.0 * turn, 3.0 * turn), (8.0 / 3.0 * turn, 17.0 / 6.0 * turn)
    drawn = [
        nonlinear.contact_portrait(run, "cage_ball", IMAGES / "nonlinear_portrait.png", window=pitch),
        nonlinear.state_portrait(run, scene, "cage.x", IMAGES / "nonlinear_cage.png", window=window),
        nonlinear.contact_raster(run, IMAGES / "nonlinear_raster.png", impact_time=5e-3, window=window),
        nonlinear.ball_loads(run, scene, IMAGES / "nonlinear_polar.png", window=window),
    ]
    return {"drawn": [path.name for path in drawn]}


PARTS = {
    "known": known, "exponents": exponents, "clearance": clearance, "scatter": scatter, "crossing": crossing,
    "portraits": portraits,
}  # fmt: skip


def main() -> None:
    only = options(__doc__, only=PARTS).only
    keep_programs(0.2)
    for name in only:
        part, took = clocked(PARTS[name])
        add("nonlinear", {name: part | {"part_cpu_s": took["cpu_s"]}})
        print(f"{name}: {took['cpu_s']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
