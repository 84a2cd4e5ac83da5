"""Accuracy levels from measurement: how wrong and how dear runs are at a tolerance, and what a level may take.

Random scenes of every kind (``random_scenes``) are run down a ladder of tolerances and compared with a tight run that
another method confirms. A scene's error is the worst of force rms, peak and impulse. Of every promise the largest
tolerance that keeps it on nearly all of these scenes is derived; ``tests/analysis/test_levels.py`` holds ``integrate`` to that,
and the promise to scenes drawn anew.

    python -m benchmarks.solve.levels [--scenes 60] [--joints 30] [--only KIND ...]
        writes results/levels.json, docs/images/levels.png and the table in docs/tradeoff.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import benchmarks.common as harness
from bcfj_jax import scenes
from bcfj_jax.analysis.tradeoff.measures import Measured, errors, worst
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.models.joint.periodic import risen
from bcfj_jax.models.joint.scene import WINDOW_END, Joint
from bcfj_jax.solve.plan import LEVELS, Plan, plan
from bcfj_jax.solve.simulation import outcome
from benchmarks.clock import keep_programs
from benchmarks.common import IMAGES, add, load, options, publish
from benchmarks.solve.random_scenes import LAWS, joints, springs

KINDS = ("impact", "bounce", "joint")
_HALVES = tuple(4e-4 * 0.5**k for k in range(19))
LADDER = {
    "impact": _HALVES,
    "bounce": _HALVES,
    "joint": (0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 5e-4, 2e-4, 5e-5, 2e-5, 5e-6, 2e-6),
}
PROMISES = (5e-2, 1e-2, 1e-3, 1e-4, 1e-5)
# References further apart than this fraction of the promise are none.
CERTAIN = 0.05
# A steep edge of a force may fall on either side of an output time, however small the error: 2 in 100 are let pass.
MOST = 0.98
BUDGET, JOINT_BUDGET = 200_000, 1_500_000
Row = dict[str, Any]
# Stands for the error of a failed run.
LOST = 1e9
# Of a joint: with a promise, and two without.
JOINT_ERRORS = ("error", "ends", "whole")
OTHER_ERRORS = {"ends": "its window ends", "whole": "its start, too"}
# A ball's speed along its track over friction's transition speed, beyond which not every joint has a reference.
SLIDES = 2.0
SAMPLES, JOINT_TIMES = {"impact": 2001, "bounce": 20001}, np.linspace(0.0, 0.6, 601)


def runner(scene: AbstractModel, batched: bool) -> Callable[..., tuple[Any, Any, Any]]:
    """(params, times, plan) -> forces by contact, code, steps; over a batch of params and times, or of one scene."""

    def one(p: Params, t: jax.Array, how: Plan) -> tuple[dict[str, jax.Array], jax.Array, jax.Array]:
        solution, readings = outcome(scene, p, t, how, "forward")
        forces = {name: reading.force for name, reading in readings.items()}
        return forces, solution.code, solution.accepted + solution.rejected

    return jax.jit(jax.vmap(one, in_axes=(0, 0, None)) if batched else one)


def compared(forces: dict[str, np.ndarray]) -> Measured:
    """Forces by contact, (T, 3) or (T, members, 3), as ``measures.errors`` compares them."""
    parts = [forces[name].reshape(len(forces[name]), -1, 3) for name in sorted(forces)]
    owners = np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])
    nothing = np.zeros(len(owners))
    return Measured(np.concatenate(parts, 1), owners, nothing * np.nan, nothing, nothing)


def off(found: dict[str, np.ndarray], truth: dict[str, np.ndarray], times: np.ndarray) -> float:
    """The worst error of a run; ``LOST`` where it is not finite."""
    value = worst(errors(compared(found), compared(truth), times))
    return float(value) if np.isfinite(value) else LOST


def springs_down(kind: str, law: str, count: int, seed: int, ladder: Sequence[float], wide: bool = False) -> list[Row]:
    """Errors and steps down the ladder, of random scenes of a law, all in one batch."""
    scene, params, ends = springs(kind, law, count, seed, wide)
    grid = np.linspace(0.0, 1.0, SAMPLES[kind]) * ends[:, None]
    run = runner(scene, batched=True)

    def at(tolerance: float, solver: str | None = None) -> tuple[list[dict[str, np.ndarray]], Any, Any]:
        how = Plan(jnp.asarray(tolerance), BUDGET, solver=solver)
        forces, code, steps = jax.device_get(run(params, jnp.asarray(grid), how))
        each = [{name: f[k] for name, f in forces.items()} for k in range(count)]
        return each, code, steps

    truth, code, _ = at(1e-10)
    other, code_2, _ = at(1e-9, "dopri5")
    rows: list[Row] = [
        {"law": law, "apart": off(b, a, t) if c == d == 0 else LOST, "error": [], "steps": []}
        for a, b, c, d, t in zip(truth, other, code, code_2, grid, strict=True)
    ]
    for k, row in enumerate(rows):
        row["measures"] = scene.envelope({name: value[k] for name, value in params.items()}, grid[k])[0]
    for tolerance in ladder:
        found, code, steps = at(tolerance)
        for k, row in enumerate(rows):
            row["error"].append(off(found[k], truth[k], grid[k]) if code[k] == 0 else LOST)
            row["steps"].append(int(steps[k]))
    return rows


def joints_down(
    count: int, seed: int, ladder: Sequence[float], wide: bool = False, scene: Joint | None = None
) -> Iterator[Row]:
    """The same of dynamic joints, one after the other; the reference is BDF's, confirmed by RODAS3.

    A joint's promise is of the contacts that carry its load, from a pitch after the load has risen: ``error``. Two
    more errors have no promise. ``ends``: of the window ends in this time, which bear what is left of friction.
    ``whole``: of what is before, too: the cage's knocks in its clearances, which no load holds yet.
    """
    scene, tight = scene or scenes.joint(), (1e-8, 1e-6)
    run, times = runner(scene, batched=False), jnp.asarray(JOINT_TIMES)
    for params in joints(count, seed, wide, scene):
        loaded = risen(scene, params, 1) <= JOINT_TIMES

        def at(tolerance: float, solver: str | None = None, params: Params = params) -> tuple[Any, int, int]:
            how = Plan(jnp.asarray(tolerance), JOINT_BUDGET, solver=solver)
            forces, code, steps = jax.device_get(run(params, times, how))
            return forces, int(code), int(steps)

        def both(found: Any, truth: Any, good: bool, loaded: np.ndarray = loaded) -> dict[str, float]:
            """The errors by name."""
            if not good:
                return dict.fromkeys(JOINT_ERRORS, LOST)
            late, true = ({name: f[loaded] for name, f in some.items()} for some in (found, truth))
            ends = [{WINDOW_END: some.pop(WINDOW_END)} for some in (late, true) if WINDOW_END in some]
            left = JOINT_TIMES[loaded]
            found, truth = ({name: f for name, f in some.items() if name != WINDOW_END} for some in (found, truth))
            return {
                "error": off(late, true, left),
                "ends": off(ends[0], ends[1], left) if ends else 0.0,
                "whole": off(found, truth, JOINT_TIMES),
            }

        truth, code, _ = at(tight[0], "bdf")
        other, code_2, _ = at(tight[1]) if code == 0 else ({}, 1, 0)
        between = both(other, truth, code == code_2 == 0)
        apart = between["error"]
        row: Row = {"law": "default", "apart": apart, "steps": [], **{name: [] for name in JOINT_ERRORS}}
        row |= {f"apart_{name}": between[name] for name in JOINT_ERRORS[1:]}
        row["measures"] = scene.envelope(params, JOINT_TIMES)[0]
        # Balls that stick and slip without order take a million steps at tighter ones.
        for tolerance in ladder if calm(row) else [x for x in ladder if x >= 2e-5]:
            # Without a truth there is no error to tell.
            found, code, steps = at(tolerance) if apart < LOST else ({}, 1, 0)
            for name, error in both(found, truth, apart < LOST and code == 0).items():
                row[name].append(error)
            row["steps"].append(steps)
        print("joint:", {k: np.array(v) for k, v in row.items() if k != "law"}, flush=True)
        yield row


def calm(row: Row) -> bool:
    """Whether a scene has a promise: not a joint whose balls slide so fast that some stick and slip without order."""
    return row["measures"].get("sliding", 0.0) <= SLIDES


def derived(kind: str, rows: list[Row]) -> list[Row]:
    """Of every promise the largest tolerance at which, and at all tighter ones, ``MOST`` kept it; None for none."""
    rows, table = [row for row in rows if calm(row)], []
    for promise in PROMISES:
        sure = [row for row in rows if row["apart"] <= CERTAIN * promise]
        broken = np.sum([[e > promise for e in row["error"]] for row in sure] or [np.zeros(len(LADDER[kind]))], axis=0)
        after = int(np.flatnonzero(broken > (1.0 - MOST) * len(sure)).max(initial=-1)) + 1
        kept = float(LADDER[kind][after]) if sure and after < len(broken) else None
        table.append(
            {"promise": promise, "scenes": len(sure), "broken": broken.astype(int).tolist(), "tolerance": kept}
        )
    return table


def at_level(kind: str, rows: list[Row], level: str, error: str = "error") -> Row:
    """A row of the table: a level's promise, and what came of it at the next tighter level of the ladder."""
    rows = [row for row in rows if calm(row)]
    promised = error == "error"
    apart = "apart" if promised else f"apart_{error}"
    promise, tolerance = LEVELS[level], float(plan(scenes.make(kind), level).tolerance)
    k = next((k for k, level in enumerate(LADDER[kind]) if level <= tolerance * 1.001), len(LADDER[kind]) - 1)
    sure = [row[error][k] for row in rows if row[apart] <= CERTAIN * promise]
    return {
        "scene": kind if promised else f"{kind}, {OTHER_ERRORS[error]}", "level": level, "tolerance": tolerance,
        "promise": f"{100 * promise:g} %" if promised else "none", "kept": f"{sum(e <= promise for e in sure)} of {len(sure)}",
        "worst": f"{100 * max(sure):.2g} %" if sure else "-",
        "steps": np.median([row["steps"][k] for row in rows if row[apart] < LOST]),
    }  # fmt: skip


def report(kept: dict[str, Any]) -> None:
    """The table of the levels and the picture."""
    table = []
    figure, axes = plt.subplots(1, len(KINDS), figsize=(12, 4), sharey=True, layout="constrained")
    for axis, kind in zip(axes, KINDS, strict=True):
        if kind not in kept:
            continue
        rows, scene = kept[kind]["rows"], scenes.make(kind)
        table += [at_level(kind, rows, level) for level in LEVELS]
        others = JOINT_ERRORS[1:] if kind == "joint" else ()
        table += [at_level(kind, rows, level, name) for name in others for level in LEVELS]
        errors_ = np.array([row["error"] for row in rows if row["apart"] < LOST and calm(row)])
        axis.loglog(LADDER[kind], np.maximum(errors_, 1e-12).T, color="0.7", lw=0.6)
        axis.loglog(LADDER[kind], errors_.max(axis=0), "C3", label="worst scene")
        axis.loglog(LADDER[kind], np.median(errors_, axis=0), "C0", label="median scene")
        asked = np.array(PROMISES)
        used = [float(plan(scene, float(e)).tolerance) for e in asked]
        axis.loglog(used, asked, "k.--", label="promise at its tolerance")
        axis.set(title=kind, xlabel="tolerance [state sizes]", ylim=(1e-9, 3))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("worst of force rms, peak, impulse [of peak]")
    axes[0].legend(fontsize=8)
    figure.savefig(IMAGES / "levels.png", dpi=110)
    publish("levels", harness.table({
        "scene": "{scene}", "level": "{level}", "promise": "{promise}", "tolerance": "{tolerance:.1g}", "kept it": "{kept}",
        "worst error": "{worst}", "steps (median)": "{steps:.0f}",
    }, table), "docs/tradeoff.md")  # fmt: skip


def keep(kind: str, rows: list[Row]) -> None:
    """Save a kind's rows; what another process measured meanwhile stays."""
    add("levels", {kind: {"ladder": LADDER[kind], "derived": derived(kind, rows), "rows": rows}})


def main() -> None:
    given = options(__doc__, scenes=(60, "of each law"), joints=30, seed=0, only=list(KINDS))
    keep_programs()
    for kind in given.only:
        if kind == "joint":
            rows: list[Row] = []
            for row in joints_down(given.joints, given.seed, LADDER["joint"]):
                rows.append(row)
                keep(kind, rows)
        else:
            keep(kind, [x for law in LAWS for x in springs_down(kind, law, given.scenes, given.seed, LADDER[kind])])
        print(kind, load("levels")[kind]["derived"], flush=True)
    report(load("levels"))


if __name__ == "__main__":
    main()
