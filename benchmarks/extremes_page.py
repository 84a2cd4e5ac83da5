"""The tables of docs/extremes.md: what was varied how far, and how the cases ended.

python benchmarks/extremes_page.py    after extremes.py and extremes_check.py
"""

from __future__ import annotations

from typing import Any

from _common import load, markdown, put_in_readme
from extremes_box import VARIANTS, Axis


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
    """Rows: scene, cases, ok, failed, refused, defects, the most energy created, spot checks within the promise."""
    rows = [["scene", "cases", "ok", "failed, told why", "refused", "defects", "energy created", "spot checks"]]
    for name, found in scenes.items():
        total, checked = found["all"], found.get("checked")
        kinds = [str(total["classes"].get(kind, 0)) for kind in ("ok", "failed", "refused", "defect")]
        energy = f"{total['most_energy_created']:.1%} at most" if total["most_energy_created"] else ""
        right = f"{checked['within']} of {checked['cases']} within 1 %" if checked else ""
        rows.append([name, str(total["cases"]), *kinds, energy, right])
    return rows


def main() -> None:
    scenes = load("extremes")["scenes"]
    put_in_readme("ranges", markdown(ranges()), "docs/extremes.md")
    put_in_readme("counts", markdown(counts(scenes)), "docs/extremes.md")
    reasons = [["scene", "how it ended", "cases"]]
    reasons += [[name, text, str(n)] for name, found in scenes.items() for text, n in found["all"]["reasons"].items()]
    put_in_readme("reasons", markdown(reasons), "docs/extremes.md")


if __name__ == "__main__":
    main()
