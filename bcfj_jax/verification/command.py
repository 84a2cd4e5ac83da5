"""What ``bcfj verify`` does: run the checks, and lay out what came of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.io import report
from bcfj_jax.verification import derivatives, formulas, motion
from bcfj_jax.verification.check import Check, Row, carried_out

# What the simulator checks; ``calibration.verification`` has more.
CHECKS: tuple[Check, ...] = (*formulas.CHECKS, *motion.CHECKS, *derivatives.CHECKS)


def picked(checks: Sequence[Check], names: Iterable[str]) -> list[Check]:
    """The checks of these names, in their own order; all where no name is given.

    Raises:
        InputError: for a name that no check has, with the nearest one that exists.
    """
    known, wanted = {one.name for one in checks}, set(names)
    for name in sorted(wanted - known):
        raise InputError("--only", f"no check '{name}'", nearest(name, sorted(known)))
    return [one for one in checks if not wanted or one.name in wanted]


def run(checks: Sequence[Check], say: Callable[[str], None]) -> list[Row]:
    """Run the checks one after the other; ``say`` gets a line before each."""
    rows = []
    for number, one in enumerate(checks, 1):
        say(f"check {number} of {len(checks)}: {one.what}")
        rows.append(carried_out(one))
    return rows


def passed(rows: Sequence[Row]) -> bool:
    """Whether there are rows, and every one is within its tolerance."""
    return bool(rows) and all(row.ok for row in rows)


def table(rows: Sequence[Row]) -> str:
    """The rows as a table for a terminal, what failed in words below it, and a sentence on the whole."""
    failed = {False: "FAILED", True: "ok"}
    cells = [[failed[r.ok], _number(r.deviation), _number(r.tolerance), r.what, r.source] for r in rows]
    text = [report.text([["", "deviation", "tolerance", "what", "source"], *cells]), ""]
    for row in (row for row in rows if not row.ok):
        why = f"deviation {_number(row.deviation)} ({row.measure}), tolerance {_number(row.tolerance)}"
        text.append(f"failed: {row.name}: {row.error or why}")
    good, seconds = sum(row.ok for row in rows), sum(row.seconds for row in rows)
    text.append(f"{good} of {len(rows)} checks passed in {seconds:.0f} s")
    text.append("Deviations are relative, but of printed tables: those are in units of the last printed digit.")
    return "\n".join(text)


def document(rows: Sequence[Row]) -> dict[str, Any]:
    """The rows for JSON; a deviation that could not be computed is null."""
    return {
        "passed": passed(rows),
        "seconds": sum(row.seconds for row in rows),
        "checks": [
            row._asdict() | {"deviation": row.deviation if math.isfinite(row.deviation) else None} for row in rows
        ],
    }


def _number(value: float) -> str:
    return "none" if math.isnan(value) else f"{value:.2g}"
