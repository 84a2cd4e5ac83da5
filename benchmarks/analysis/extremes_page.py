"""The tables of docs/extremes.md: what was varied how far, how the cases ended, and what was checked.

python -m benchmarks.analysis.extremes_page    after extremes.py and extremes_check.py
"""

from __future__ import annotations

from typing import Any

from benchmarks.analysis.extremes_box import VARIANTS, Axis
from benchmarks.common import load, markdown, publish, table


def spread(axis: Axis) -> str:
    """An axis's range in words: corner values, then its ends."""
    inside = f"{axis.low:.3g} to {axis.high:.3g}"
    beside = [f"{value:.3g}" for value in axis.corners if not axis.low <= value <= axis.high]
    return "; ".join((*beside, inside)) + (", by decades" if axis.log and axis.high > axis.low else "")


def ranges() -> list[list[str]]:
    """Rows: parameter, range, in which scenes."""
    found: dict[tuple[str, str], list[str]] = {}
    for variant in VARIANTS:
        # Near the default numbers: no extremes.
        if variant.name != "30 s":
            for axis in (*variant.axes, variant.horizon):
                found.setdefault((axis.name, spread(axis)), []).append(variant.scene)
    return [["parameter (SI)", "range", "scenes"]] + [
        [f"`{name}`", text, ", ".join(dict.fromkeys(scenes))] for (name, text), scenes in found.items()
    ]


def counts(scenes: dict[str, Any]) -> str:
    """Scene, cases, ok, failed, refused, defects, the most energy created."""

    def of(kind: str) -> Any:
        return lambda found: found["all"]["classes"].get(kind, 0)

    def energy(found: dict[str, Any]) -> str:
        most = found["all"]["most_energy_created"]
        return f"{most:.1%} at most" if most else ""

    failed, void = of("failed"), of("void")
    return table({
        "scene": "{name}", "cases": "{all[cases]}", "ok": of("ok"),
        "failed, told why": lambda found: failed(found) + void(found), "refused": of("refused"), "defects": of("defect"),
        "energy created": energy,
    }, ({"name": name, **found} for name, found in scenes.items()))  # fmt: skip


def checks(scenes: dict[str, Any]) -> str:
    """What was checked against what, its promise, how many kept it, the errors, and what checked nothing."""
    rows = [{"name": name, **one} for found in scenes.values() for name, one in found.get("checked", {}).items()]
    errors = lambda one: (f"{k} {mid:.1g}, {most:.1g}" for k, (_, mid, most) in one["count_median_worst"].items())  # noqa: E731
    return table({
        "what": "{name}", "against": "{against}",
        "allowed": lambda one: "; ".join(f"{key} {value:g}" for key, value in one["allowed"].items()),
        "kept it": "{within} of {cases}", "error: median, worst": lambda one: "; ".join(errors(one)),
        "no verdict": lambda one: "; ".join(f"{count} {why}" for why, count in one["beside"].items()),
    }, rows)  # fmt: skip


def main() -> None:
    scenes = load("extremes")["scenes"]
    reasons = [(name, text, n) for name, found in scenes.items() for text, n in found["all"]["reasons"].items()]
    for name, text in {
        "ranges": markdown(ranges()), "counts": counts(scenes), "checks": checks(scenes),
        "reasons": markdown([("scene", "how it ended", "cases"), *reasons]),
    }.items():  # fmt: skip
        publish(name, text, "docs/extremes.md")


if __name__ == "__main__":
    main()
