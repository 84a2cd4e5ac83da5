"""Does the advice of ``bcfj tradeoff`` hold beside the scene it was given for? Random springs, and variants of each.

A scene's ladder of tolerances gives the setting that ``tradeoff.advice`` would recommend for each budget; it is then
taken for variants of the scene, whose mass, stiffness, speed and clearance differ by up to a tenth. Counted is how many
keep the budget: as it is advised, and by the scene's own errors alone.

    python -m benchmarks.analysis.advice [--scenes 8]    writes results/advice.json and the table in docs/tradeoff.md
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import benchmarks.common as harness
from bcfj_jax.analysis.tradeoff import advice
from bcfj_jax.analysis.tradeoff.settings import ERRORS, Setting
from bcfj_jax.analysis.tradeoff.study import OK, Study
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.clock import keep_programs
from benchmarks.common import options, publish, save
from benchmarks.solve.levels import BUDGET, LOST, SAMPLES, off, runner
from benchmarks.solve.random_scenes import LAWS, springs

VARIANTS, SPREAD, SEED = 8, 0.1, 3
CHANGED = ("mass", "stiffness", "approach_speed", "drop_height", "clearance_contact")


def ladder(kind: str, law: str, count: int) -> np.ndarray:
    """Errors (count, 1 + VARIANTS, levels) of scenes of a law and of their variants; the scene itself comes first."""
    scene, params, ends = springs(kind, law, count, SEED)
    rng = np.random.default_rng(SEED)
    runs = count * (1 + VARIANTS)
    wide = {name: np.repeat(np.asarray(value), 1 + VARIANTS) for name, value in params.items()}
    for name in set(CHANGED) & set(wide):
        factor = rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, (count, 1 + VARIANTS))
        factor[:, 0] = 1.0
        wide[name] = wide[name] * factor.ravel()
    grid = np.linspace(0.0, 1.0, SAMPLES[kind]) * np.repeat(ends, 1 + VARIANTS)[:, None]
    run = runner(scene, batched=True)
    given = {name: jnp.asarray(value) for name, value in wide.items()}

    def at(tolerance: float) -> tuple[Any, np.ndarray]:
        forces, code, _ = jax.device_get(run(given, jnp.asarray(grid), Plan(jnp.asarray(tolerance), BUDGET)))
        return [{name: f[k] for name, f in forces.items()} for k in range(runs)], code

    truth, code = at(1e-10)
    found = np.full((runs, len(ERRORS)), np.nan)
    for level, error in enumerate(ERRORS):
        forces, ended = at(float(plan(scene, error).tolerance))
        for k in np.flatnonzero(code == 0):
            found[k, level] = off(forces[k], truth[k], grid[k]) if ended[k] == 0 else LOST
    return found.reshape(count, 1 + VARIANTS, -1)


def advised(errors: np.ndarray, budget: float) -> int | None:
    """The level that is recommended to a scene with these errors (levels,): the loosest that may be."""
    todo = [Setting(f"{error:g}", "tolerance", "tsit5", error, {"scene": {}}) for error in ERRORS]
    rows = [{"status": OK} | dict.fromkeys(advice.MAIN, float(error)) for error in errors]
    known = advice.expected(Study(todo, rows, None, False))
    fit = (advice.SAFETY * e <= budget and advice.asks(s, budget) for s, e in zip(todo, known, strict=True))
    return next((k for k, yes in enumerate(fit) if yes), None)


def loosest(errors: np.ndarray, budget: float) -> int | None:
    """The loosest level that is right on the scene itself."""
    return next((k for k, error in enumerate(errors) if error <= budget), None)


WAYS = {"advised": advised, "loosest": loosest}


def counted(found: np.ndarray) -> list[dict[str, Any]]:
    """A row a budget: how many scenes, and how many of their variants, keep it, each way of choosing."""
    rows = []
    for budget in advice.BUDGETS:
        row: dict[str, Any] = {"budget": budget}
        for name, way in WAYS.items():
            chosen = [(each, way(each[0], budget)) for each in found if np.isfinite(each[0]).all()]
            own = [each[0, k] for each, k in chosen if k is not None]
            near = np.concatenate([each[1:, k] for each, k in chosen if k is not None] or [np.zeros(0)])
            near = near[np.isfinite(near)]
            row[name] = {
                "scenes": len(own), "own": int(np.sum(np.array(own) <= budget)),
                "variants": int(near.size), "kept": int((near <= budget).sum()), "worst": float((near / budget).max()),
            }  # fmt: skip
        rows.append(row)
    return rows


def table(kinds: dict[str, list[dict[str, Any]]]) -> str:
    """The rows of both kinds."""
    return harness.table([
        ("scene", "{kind}"), ("budget", lambda row: f"{100 * row['budget']:g} %"),
        ("as advised: variants within", "{advised[kept]} of {advised[variants]}"), ("worst over budget", "{advised[worst]:.2g}"),
        ("loosest: within", "{loosest[kept]} of {loosest[variants]}"), ("worst", "{loosest[worst]:.2g}"),
    ], ({"kind": kind, **row} for kind, rows in kinds.items() for row in rows))  # fmt: skip


def main() -> None:
    scenes = options(__doc__, scenes=(8, "of each kind and law")).scenes
    keep_programs()
    kinds = {
        kind: counted(np.concatenate([ladder(kind, law, scenes) for law in LAWS])) for kind in ("impact", "bounce")
    }
    save("advice", {"variants": VARIANTS, "spread": SPREAD, "safety": advice.SAFETY, **kinds})
    publish("advice", table(kinds), "docs/tradeoff.md")


if __name__ == "__main__":
    main()
