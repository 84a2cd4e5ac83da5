"""Friction of a tossed cube from motion capture: eight tosses fitted, four predicted from their first row.

    python -m benchmarks.calibration.cube [DATA] [--starts 4] [--keep]

DATA holds toss_0.csv to toss_11.csv of "ContactNets" (Pfrommer, Halm, Posa; DAIRLab/contact-nets, BSD 3-clause), which are not
part of this project. ``bcfj init calibration`` proposes the problem; size and inertia are those that the authors state. The error
of a prediction is the mean over a toss, then over tosses; its parts are the spread of predictions over the noise of the first
row, the spread over the intervals of the law, and what the best first state of each fitted toss leaves. "first rows" begins at
the state that ``init`` reads from eight rows of flight: the speeds of the file's first row are half a row late. "about" moves
one coefficient of the law by a factor: which of them decides. Without DATA the
gradient alone: the derivative of a tossed cube's place by its speed at five accuracies, against differences, and what it costs
beside the run (the toss of DiffMJX, arXiv 2506.14186, on the contact of this project). With ``--keep`` tables are kept in
``benchmarks/results/cube.json``.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

import bcfj_jax as bj
from bcfj_jax.mechanism.model import AbstractModel
from benchmarks import common
from benchmarks.clock import clocked, turns
from benchmarks.common import options
from calibration import Fit, fit, init, load
from calibration.impacts import tosses

# As the data's authors state them: mass [kg], half width [m], inertia [kg m^2], friction.
MASS, HALF, INERTIA, FRICTION = 0.37, 0.0524, 8.1e-4, 0.18
FITTED, HELD = range(8), range(8, 12)
READ = [*(f"body.place.{a}" for a in "xyz"), *(f"body.attitude.q{k}" for k in range(4))]
# Deviations of a first row: motion capture of a marker [m], of an attitude [rad], and of their rates over eight rows.
ROW = {"place": 3e-4, "attitude": 3e-3, "velocity": 0.01, "spin": 0.05}
DRAWS, ROWS = 24, 128
FACTORS = (0.5, 0.8, 0.9, 1.0, 1.1, 1.25, 2.0)


class Toss(NamedTuple):
    """Clock (N,) [s], places (N, 3) [m], attitudes; the first row, and what eight rows say, as starts of the scene."""

    clock: np.ndarray
    places: np.ndarray
    turned: Rotation
    start: dict[str, float]
    flight: dict[str, float]


def toss(path: Path) -> Toss:
    """A toss as it was measured; the spin, which is in the body's axes, turned to the world's."""
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    turned = Rotation.from_quat(rows[:, 4:8], scalar_first=True)
    spin = turned[0].apply(rows[0, 11:14])
    values = (*rows[0, 1:8], *rows[0, 8:11], *spin)
    names = ("x", "y", "z", "q0", "q1", "q2", "q3", "vx", "vy", "vz", "wx", "wy", "wz")
    start = dict(zip((f"body.{n}" for n in names), map(float, values), strict=True))
    flight = tosses.first(rows[:, 0], rows[:, 1:4].T, rows[:, 4:8].T, 2).values
    return Toss(rows[:, 0], rows[:, 1:4], turned, start, {f"body.{n}": x for n, x in flight.items()})


def shaken(start: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    """A first row within its noise."""
    q = Rotation.from_quat([start[f"body.q{k}"] for k in range(4)], scalar_first=True)
    q = (Rotation.from_rotvec(ROW["attitude"] * rng.standard_normal(3)) * q).as_quat(scalar_first=True)
    found = {f"body.q{k}": float(q[k]) for k in range(4)}
    for a in "xyz":
        for name, size in ((a, ROW["place"]), (f"v{a}", ROW["velocity"]), (f"w{a}", ROW["spin"])):
            found[f"body.{name}"] = start[f"body.{name}"] + size * float(rng.standard_normal())
    return found


def predicted(scene: AbstractModel, params: dict[str, float], one: Toss) -> tuple[np.ndarray, Rotation]:
    """Places (N, 3) and attitudes from a start; tosses are filled up to as many rows, so that they share one program."""
    count = one.clock.size
    clock = np.r_[one.clock, one.clock[-1] + 1e-3 * np.arange(1, ROWS - count + 1)]
    read = bj.reading_history(scene, scene.parameters(params), clock, READ, accuracy=1e-3)
    found = np.stack([np.asarray(read[n])[:count] for n in READ], axis=1)
    return found[:, :3], Rotation.from_quat(found[:, 3:], scalar_first=True)


def misses(places: np.ndarray, turned: Rotation, one: Toss) -> tuple[float, float]:
    """Mean error over a toss: place [widths of the cube], angle [degrees]."""
    off = np.linalg.norm(places - one.places, axis=1)
    return float(off.mean() / (2.0 * HALF)), float(np.degrees((turned * one.turned.inv()).magnitude()).mean())


def spread(scene: AbstractModel, draws: list[dict[str, float]], one: Toss) -> tuple[float, float]:
    """Mean distance of predictions from the first of them, likewise."""
    plain = predicted(scene, draws[0], one)
    others = [misses(*predicted(scene, p, one), one._replace(places=plain[0], turned=plain[1])) for p in draws[1:]]
    place, angle = np.mean(others, axis=0)
    return float(place), float(angle)


def fitted(data: Path, starts: int, folder: Path) -> tuple[Fit, dict[str, Any]]:
    """The problem that ``bcfj init calibration`` proposes of the first tosses, with the stated size, and its fit."""
    for k in FITTED:
        shutil.copy(data / f"toss_{k}.csv", folder)
    path = folder / "tosses.toml"
    init.run(folder / "toss_*.csv", path, init.Said(mass=f"{MASS} kg"), lambda line: None)
    sizes = {"half_length": HALF, "half_width": HALF, "half_height": HALF, "inertia": INERTIA}
    scene = folder / "tosses_scene.toml"
    lines = [
        f"{key} = {sizes[key]}" if (key := line.partition(" = ")[0]) in sizes else line
        for line in scene.read_text().splitlines()
    ]
    scene.write_text("\n".join(lines) + "\n")
    # The inertia is known; as it is proposed it would be searched.
    known = [line for line in path.read_text().splitlines() if not line.startswith("inertia = ")]
    path.write_text("\n".join(known) + "\n")
    return clocked(lambda: fit(load(path), starts=starts))


def table(data: Path, starts: int) -> dict[str, Any]:
    """The fit, its time, and errors of predictions with their parts."""
    with tempfile.TemporaryDirectory() as name:
        found, seconds = fitted(data, starts, Path(name))
    scene, rng = found.optimum.model.scene, np.random.default_rng(0)
    law = {n: p for n, p in found.parameters.items() if n in ("stiffness", "damping", "friction_dynamic")}
    halves = {n: 0.25 * (p.ci95[1] - p.ci95[0]) if p.ci95 else 0.0 for n, p in law.items()}
    rows: dict[str, Any] = {"fitted": [], "held": []}
    for kind, numbers in (("fitted", FITTED), ("held", HELD)):
        for k in numbers:
            one = toss(data / f"toss_{k}.csv")
            plain = {**found.values, **one.start}
            moved = [
                plain | {n: max(p.value + halves[n] * float(rng.standard_normal()), 1e-3) for n, p in law.items()}
                for _ in range(DRAWS)
            ]
            off = misses(*predicted(scene, plain, one), one)
            by_row = spread(scene, [plain, *(plain | shaken(one.start, rng) for _ in range(DRAWS))], one)
            row = {
                "toss": k,
                "row 0": off,
                "first rows": misses(*predicted(scene, {**found.values, **one.flight}, one), one),
                "noise of row 0": by_row,
                "law's interval": spread(scene, [plain, *moved], one),
            }
            if kind == "fitted":
                own = {
                    n: found.parameters[f"{n}[toss_{k}]"].value
                    for n in one.start
                    if f"{n}[toss_{k}]" in found.parameters
                }
                held = {n: float(x[k]) for n, x in found.optimum.model.data.fixed.items() if n in one.start}
                row["own first state"] = misses(*predicted(scene, {**found.values, **held, **own}, one), one)
            rows[kind].append(row)
            print(row, flush=True)
    means = {
        kind: {key: np.mean([r[key] for r in every], axis=0).round(4).tolist() for key in every[0] if key != "toss"}
        for kind, every in rows.items()
    }
    estimates = {n: {"value": p.value, "least_squares": p.least_squares, "ci95": p.ci95} for n, p in law.items()}
    return {
        "verdict": found.verdict,
        "reasons": found.reasons,
        "notes": found.notes,
        **seconds,
        "law": estimates,
        "mean": means,
        "about": about(scene, found.values, data),
        "tosses": rows,
    }


def about(scene: AbstractModel, values: dict[str, float], data: Path) -> dict[str, dict[str, list[float]]]:
    """Place error [widths] of tosses fitted and held out, from row 0, with one coefficient times a factor."""
    every = [[toss(data / f"toss_{k}.csv") for k in numbers] for numbers in (FITTED, HELD)]

    def errors(params: dict[str, float]) -> list[float]:
        off = [[misses(*predicted(scene, {**params, **one.start}, one), one)[0] for one in some] for some in every]
        return [round(float(np.mean(x)), 4) for x in off]

    return {
        name: {str(by): errors({**values, name: by * values[name]}) for by in FACTORS}
        for name in ("stiffness", "damping", "friction_dynamic")
    }


LEVELS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)


def gradient() -> list[dict[str, Any]]:
    """Derivative of a cube's y after a second by its vertical speed; differences are of runs at 1e-9."""
    start = {"z": 0.2, "vy": -0.1, "vz": -2.0, "q0": float(np.cos(np.pi / 6)), "q1": float(np.sin(np.pi / 6))}
    half, mass = 0.05, 0.1
    scene = bj.Mechanism(
        "toss",
        [bj.Body("body", joint="free", start=start)],
        [bj.Contact("corner", ("ground", "body"), bj.gaps.BoxOnPlane(), friction="coulomb")],
        [bj.loads.Gravity("-z")],
        given=dict(mass=mass, inertia=2 / 3 * mass * half**2, gravity=2.0, stiffness=2e3, exponent=1.0, damping=2.0,
                   half_length=half, half_width=half, half_height=half, friction_dynamic=1.0, friction_speed=0.02),
    )  # fmt: skip
    params, clock = scene.parameters(), np.linspace(0.0, 1.0, 11)

    def place(speed: Any, accuracy: float) -> Any:
        moved = {**params, "body.vz": speed}
        return bj.reading_history(scene, moved, clock, ["body.place.y"], accuracy=accuracy)["body.place.y"][-1]

    speed, step = start["vz"], 1e-5
    ends = [float(jax.jit(lambda v: place(v, 1e-9))(speed + x)) for x in (-step, step)]
    differences = (ends[1] - ends[0]) / (2.0 * step)
    rows = []
    for accuracy in LEVELS:
        run = jax.jit(partial(place, accuracy=accuracy))
        both = jax.jit(lambda v, run=run: jax.jvp(run, (v,), (1.0,)))
        calls = {"run_s": partial(run, speed), "with_derivative_s": partial(both, speed)}
        taken = {name: float(np.median(x)) for name, x in turns(calls, 7).items()}
        slope = float(both(speed)[1])
        row = {
            "accuracy": accuracy,
            "derivative": slope,
            "differences": differences,
            "off": abs(slope / differences - 1.0),
        }
        rows.append({**row, **taken, "times_the_run": taken["with_derivative_s"] / taken["run_s"]})
        print(rows[-1], flush=True)
    return rows


def main() -> int:
    """Print and keep the tables; fail where the gradient is off or dear."""
    given = options(__doc__, {"data": ""}, starts=4, keep=False)
    content: dict[str, Any] = {"gradient": gradient()}
    if given.data:
        content |= table(Path(given.data), given.starts)
        print({key: content[key] for key in ("verdict", "reasons", "notes", "wall_s", "cpu_s", "law", "mean", "about")})
    if given.keep:
        common.add("cube", content)
    fine = [r for r in content["gradient"] if r["accuracy"] <= 1e-4]
    return int(any(r["off"] > 1e-3 or r["times_the_run"] > 4.0 for r in fine))


if __name__ == "__main__":
    sys.exit(main())
