"""The trade of every built-in scene: ``bcfj tradeoff`` on impact, bounce and the joint, kept, drawn, and in docs/accuracy.md.

Beside it the levels as ``bcfj simulate`` runs them: seconds of ``fast``, ``balanced`` and ``reference`` on the same
scene, their error against the study's own truth; of the joint against CVODES (``joint_reference``), from a pitch after
the load has risen. A study goes on where it was cut off (build/tradeoff).

    python -m benchmarks.analysis.tradeoff [SCENE ...] [--budget 900] [--drawn]
        writes results/tradeoff_SCENE.json, docs/images/tradeoff.png and a table of docs/accuracy.md; --drawn measures nothing
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bcfj_jax.analysis.tradeoff import advice
from bcfj_jax.analysis.tradeoff.command import as_json
from bcfj_jax.analysis.tradeoff.measures import errors, measured, worst
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.analysis.tradeoff.study import OK, Study, study
from bcfj_jax.analysis.tradeoff.trial import trial
from bcfj_jax.io import plots
from bcfj_jax.io.journal import Journal, key_of
from bcfj_jax.io.outputs import plain
from bcfj_jax.io.scenefile import from_table, quickest
from bcfj_jax.io.stop import heeded
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import LEVELS
from benchmarks.clock import keep_programs
from benchmarks.common import IMAGES, RESULTS, ROOT, load, markdown, options, publish, save
from benchmarks.models import joint_reference
from benchmarks.solve.levels import off

TABLES: dict[str, dict[str, Any]] = {
    "impact": {"scene": {"kind": "impact"}},
    "bounce": {"scene": {"kind": "bounce"}},
    # Its truth is the kept run of another solver.
    "joint": {"scene": {"kind": "joint", **PLAIN}},
}
BUDGETS = ("5 %", "1 %", "0.1 %")


def levels(name: str, found: Study) -> dict[str, dict[str, float]]:
    """Wall, steps and error of every level, on the scene of a study."""
    assert found.reference is not None and found.reference.truth is not None
    kept = {}
    for level in LEVELS:
        given = quickest(from_table({**TABLES[name], "accuracy": {"level": level}}, None))
        run, cost = trial(given)
        begin = given.scene.settled_from(given.params)
        if begin > 0.0:
            truth = joint_reference.load()
            late = truth.times >= begin
            ours, theirs = ({key: force[late] for key, force in x.force.items()} for x in (run, truth))
            error = off(ours, theirs, truth.times[late])
        else:
            ours = measured(run, given.times, given.scene.traits.turning)
            error = worst(errors(ours, found.reference.truth, given.times))
        kept[level] = cost | {"error": error}
    return kept


def measure(name: str, budget: float, only: list[str], derivatives: bool) -> None:
    """Study a scene, or go on with it; keep what is known."""
    given = from_table(TABLES[name], None)
    folder = ROOT / "build" / "tradeoff" / name
    folder.mkdir(parents=True, exist_ok=True)
    with heeded(), Journal(folder, key_of("tradeoff", given.resolved, derivatives)) as journal:
        found = study(
            given, settings(given, only, derivatives), journal, budget, lambda text: print(name, text, flush=True)
        )
    content = as_json(found, advice.recommended(found), advice.doubts(found.reference))
    save(f"tradeoff_{name}", plain({**content, "levels": levels(name, found)}))


def known() -> list[str]:
    """Scenes with a kept study."""
    return [name for name in TABLES if (RESULTS / f"tradeoff_{name}.json").exists()]


def table() -> str:
    """The levels, and what is recommended, of every scene."""
    rows = [["scene", "", "wall", "steps", "worst error", "as fast as `reference`"]]
    for name in known():
        kept = load(f"tradeoff_{name}")
        slowest = kept["levels"]["reference"]["wall_s"]
        for level, one in kept["levels"].items():
            rows.append(
                [name, f"`{level}`: {100 * LEVELS[level]:g} %", f"{1e3 * one['wall_s']:.3g} ms", f"{one['steps']:.0f}",
                 f"{100 * one['error']:.2g} %", f"{slowest / one['wall_s']:.2g}"]
            )  # fmt: skip
        for budget in BUDGETS:
            one = kept["recommended"][budget]
            if one["setting"]:
                error = f"{100 * max(one['errors'].values()):.2g} %"
                wall = f"{1e3 * one['wall_s']:.3g} ms"
                text = f"advice for {budget}: {one['setting']}"
                rows.append([name, text, wall, "", error, f"{slowest / one['wall_s']:.2g}"])
    return markdown(rows)


def picture() -> None:
    """Error against wall of every setting of every scene; ladders of solvers as lines."""
    with plots.style():
        figure, axes = plots.figure(1, len(known()), width=14.0, height=5.0)
        for axis, name in zip(axes, known(), strict=True):
            kept = load(f"tradeoff_{name}")
            rows = [row for row in kept["settings"] if row["status"] == OK]
            groups: dict[str, list[tuple[float, float]]] = {}
            for row in rows:
                ladder = row["setting"].split(" at ")[0] if row["group"] == "tolerance" else row["group"]
                if row["setting"] != "as given":
                    groups.setdefault(ladder, []).append((row["wall_s"], worst(row)))
            solvers = {r["setting"].split(" at ")[0] for r in rows if r["group"] == "tolerance"}
            # Solvers first: theirs are the colours that do not come again.
            for number, (label, points) in enumerate(sorted(groups.items(), key=lambda item: item[0] not in solvers)):
                x, y = np.array(points).T
                how = {"color": plots.COLOURS[number % len(plots.COLOURS)], "label": label, "markersize": 4}
                mark = "o-" if label in solvers else "x+*1"[number % 4]
                axis.loglog(x, np.clip(y, 1e-12, 10.0), mark, linewidth=0.8, **how)
            # Levels that are one run, but for the noise of walls, share a star.
            names: dict[float, list[str]] = {}
            for level, one in kept["levels"].items():
                names.setdefault(max(one["error"], 1e-12), []).append(level)
            for error, same in names.items():
                place = (min(kept["levels"][level]["wall_s"] for level in same), error)
                axis.loglog(*place, "k*", markersize=11, zorder=5)
                ground = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
                text = {"textcoords": "offset points", "fontsize": 9, "zorder": 6, "bbox": ground}
                axis.annotate(", ".join(same), place, (9, 3), **text)
            # Of less than a decade the numbers between are many, and long.
            axis.xaxis.set_minor_formatter("")
            axis.set_title(name)
            axis.set_xlabel("wall time of a run, compiled [s]")
            axis.legend(fontsize=7)
        axes[0].set_ylabel("worst of force rms, peak and impulse [of the peak]")
        plots.save(figure, IMAGES / "tradeoff.png")


def main() -> None:
    given = options(
        __doc__, {"scenes": TABLES}, budget=(900.0, "seconds a scene"),
        no_derivatives=(False, "values alone: most of a joint's cost is left out"),
        only=("", "groups of settings or solvers, as of bcfj tradeoff"), drawn=False,
    )  # fmt: skip
    keep_programs()
    for name in () if given.drawn else given.scenes:
        measure(name, given.budget, [x for x in given.only.split(",") if x], not given.no_derivatives)
    picture()
    publish("tradeoff", table(), "docs/accuracy.md")


if __name__ == "__main__":
    main()
