"""The envelope: where the promised error held, drawn and written, from ``levels.py`` and wider scenes.

Wider random scenes are run at the level ``balanced`` beside those of the levels; the pictures show by every measure
what error they had as a share of the promise. Of the levels' joints those that are not ``levels.calm`` count as wider.

    python -m benchmarks.analysis.envelope [--scenes 40] [--joints 20] [--drawn]
        writes bcfj_jax/envelope.json, results/envelope.json, docs/envelope.md and docs/images/envelope_*.png;
        --drawn takes the wider scenes from results/envelope.json
"""

from __future__ import annotations

import textwrap
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from bcfj_jax import scenes
from bcfj_jax.analysis.envelope import KEPT, MEANING
from bcfj_jax.io.outputs import write_json
from bcfj_jax.solve.plan import LEVELS, plan
from benchmarks.clock import keep_programs
from benchmarks.common import IMAGES, ROOT, load, markdown, options, publish, save
from benchmarks.solve.levels import CERTAIN, LADDER, PROMISES, calm, joints_down, springs_down
from benchmarks.solve.random_scenes import LAWS

PAGE = "docs/envelope.md"
SCENES = ("impact", "bounce", "joint")
# Measures that a scene may have too little of, too.
BOTH_WAYS = ("exponent", "angle", "friction", "damping", "play", "knock", "onset_under_load")
Row = dict[str, Any]


def balanced(kind: str) -> float:
    """The tolerance of the level."""
    return float(plan(scenes.make(kind), "balanced").tolerance)


def ranges(rows: list[Row]) -> dict[str, list[float]]:
    """Of every measure the range over the calm scenes, to two digits outward; from 0 where less is easier."""
    rows = [row for row in rows if calm(row)]
    names = dict.fromkeys(name for row in rows for name in row["measures"])
    every = {name: [row["measures"][name] for row in rows if name in row["measures"]] for name in names}
    return {
        name: [outward(min(values), np.floor) if name in BOTH_WAYS else 0.0, outward(max(values), np.ceil)]
        for name, values in every.items()
    }


def outward(value: float, rounded: Any) -> float:
    """A value to two digits, rounded by ``floor`` or ``ceil``."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1.0) if value > 0.0 else 1.0
    return float(f"{rounded(value / unit) * unit:.2g}")


def share(kind: str, row: Row) -> float:
    """Error over promise at ``balanced``: of a row down the ladder, or of a wider one, which was run there alone."""
    k = 0
    if len(row["error"]) > 1:
        k = next((k for k, level in enumerate(LADDER[kind]) if level <= 1.001 * balanced(kind)), len(LADDER[kind]) - 1)
    return row["error"][k] / LEVELS["balanced"]


def certain(row: Row) -> bool:
    return row["apart"] <= CERTAIN * LEVELS["balanced"]


def picture(kind: str, inside: list[Row], wider: list[Row]) -> None:
    """Error over promise by every measure."""
    box = ranges(inside)
    rows = -(-len(box) // 4)
    figure, axes = plt.subplots(rows, 4, figsize=(12, 2.8 * rows), sharey=True, layout="constrained", squeeze=False)
    for axis, (name, (low, high)) in zip(axes.flat, box.items(), strict=False):
        for some, colour, label in ((wider, "C3", "wider scenes"), (inside, "C0", "scenes of the levels")):
            points = [(r["measures"][name], share(kind, r)) for r in some if name in r["measures"] and certain(r)]
            points = [(x, min(y, 1e3)) for x, y in points]
            if points:
                axis.plot(*zip(*points, strict=True), ".", ms=3, color=colour, label=label)
            lost = [r["measures"][name] for r in some if name in r["measures"] and not certain(r)]
            if lost:
                axis.plot(lost, [1e3] * len(lost), "x", ms=4, color=colour, label=f"{label}: no reference")
        axis.axvspan(low, high, color="C2", alpha=0.12, label="guaranteed")
        axis.axhline(1.0, color="k", lw=0.8)
        spread = [r["measures"][name] for r in (*inside, *wider) if name in r["measures"]]
        axis.set(yscale="log", xlabel=textwrap.fill(MEANING[name], 44), ylim=(1e-7, 2e3))
        if min(spread) > 0 and max(spread) > 20 * min(spread):
            axis.set_xscale("log")
            axis.xaxis.set_minor_formatter("")
        axis.xaxis.label.set_fontsize(8)
    for axis in axes.flat[len(box) :]:
        axis.axis("off")
    for row in axes:
        row[0].set_ylabel("error over promise")
    axes[0, 0].legend(fontsize=7)
    figure.suptitle(f"{kind} at the level balanced")
    figure.savefig(IMAGES / f"envelope_{kind}.png", dpi=100)
    plt.close(figure)


def section(kind: str, inside: list[Row], wider: list[Row]) -> str:
    """A scene's part of the page."""
    table = [["measure", "guaranteed from", "to"]]
    table += [[MEANING[name], f"{low:g}", f"{high:g}"] for name, (low, high) in ranges(inside).items()]
    sure = [row for row in inside if row["apart"] <= CERTAIN * PROMISES[0]]
    beyond = np.array([share(kind, row) for row in wider if certain(row)])
    kept, most = int((beyond <= 1.0).sum()), float(np.max(beyond, initial=0.0))
    return "\n\n".join([
        f"## {kind}",
        markdown(table),
        f"Measured on {len(inside)} random scenes; of {len(sure)} two references agree.",
        f"Of {len(beyond)} wider scenes {kept} kept the promise of 1 % all the same; the worst error was {most:.2g} "
        f"times the promise. Of {len(wider) - len(beyond)} more no two tight references agreed, or one failed.",
        f"![error over promise by measure](images/envelope_{kind}.png)",
    ])  # fmt: skip


def main() -> None:
    asked = options(__doc__, scenes=(40, "wider ones of each law"), joints=(20, "wider ones"), drawn=False)
    keep_programs()
    levels = load("levels")
    wider = load("envelope")["wider"] if asked.drawn else {}
    for kind in () if asked.drawn else SCENES:
        at = (balanced(kind),)
        if kind == "joint":
            wider[kind] = list(joints_down(asked.joints, 1, at, wide=True))
        else:
            wider[kind] = [r for law in LAWS for r in springs_down(kind, law, asked.scenes, 1, at, wide=True)]
        save("envelope", {"wider": wider})
    write_json(ROOT / "bcfj_jax" / "analysis" / KEPT, {kind: ranges(levels[kind]["rows"]) for kind in SCENES})
    sections = []
    for kind in SCENES:
        rows = levels[kind]["rows"]
        inside, beyond = ([row for row in rows if calm(row) == yes] for yes in (True, False))
        picture(kind, inside, beyond + wider[kind])
        sections.append(section(kind, inside, beyond + wider[kind]))
    publish("guaranteed", "\n\n".join(sections), PAGE)


if __name__ == "__main__":
    main()
