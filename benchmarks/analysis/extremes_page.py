"""The tables of docs/extremes.md: what was varied how far, how the cases ended, and what was checked.

python -m benchmarks.analysis.extremes_page    after extremes.py and extremes_check.py
"""

from __future__ import annotations

from typing import Any

from benchmarks.analysis.extremes_box import VARIANTS, Axis
from benchmarks.common import load, markdown, put_in_readme


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


def counts(scenes: dict[str, Any]) -> list[list[str]]:
    """Rows: scene, cases, ok, failed, refused, defects, the most energy created."""
    rows = [["scene", "cases", "ok", "failed, told why", "refused", "defects", "energy created"]]
    for name, found in scenes.items():
        total = found["all"]
        told = {**total["classes"], "failed": sum(total["classes"].get(kind, 0) for kind in ("failed", "void"))}
        kinds = [str(told.get(kind, 0)) for kind in ("ok", "failed", "refused", "defect")]
        energy = f"{total['most_energy_created']:.1%} at most" if total["most_energy_created"] else ""
        rows.append([name, str(total["cases"]), *kinds, energy])
    return rows


def checks(scenes: dict[str, Any]) -> list[list[str]]:
    """Rows: what was checked against what, its promise, how many kept it, the errors, and what checked nothing."""
    rows = [["what", "against", "allowed", "kept it", "error: median, worst", "no verdict"]]
    for found in scenes.values():
        for name, one in found.get("checked", {}).items():
            errors = [f"{key} {mid:.1g}, {most:.1g}" for key, (_, mid, most) in one["count_median_worst"].items()]
            allowed = "; ".join(f"{key} {value:g}" for key, value in one["allowed"].items())
            beside = "; ".join(f"{count} {why}" for why, count in one["beside"].items())
            rows.append(
                [name, one["against"], allowed, f"{one['within']} of {one['cases']}", "; ".join(errors), beside]
            )
    return rows


def main() -> None:
    scenes = load("extremes")["scenes"]
    put_in_readme("ranges", markdown(ranges()), "docs/extremes.md")
    put_in_readme("counts", markdown(counts(scenes)), "docs/extremes.md")
    put_in_readme("checks", markdown(checks(scenes)), "docs/extremes.md")
    reasons = [["scene", "how it ended", "cases"]]
    reasons += [[name, text, str(n)] for name, found in scenes.items() for text, n in found["all"]["reasons"].items()]
    put_in_readme("reasons", markdown(reasons), "docs/extremes.md")


if __name__ == "__main__":
    main()
