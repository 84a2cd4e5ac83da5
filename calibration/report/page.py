"""The report of a fit: the verdict with the number to quote first."""

from __future__ import annotations

from bcfj_jax.io.page import BAD, FAIR, GOOD, Listing, Rows, Table, Verdict, bounded, brief
from calibration.fit import Fit, Parameter
from calibration.uncertainty.notes import SPANNING

_KINDS = {"identified": GOOD, "adequate": GOOD, "not_identified": FAIR, "not_converged": BAD, "misfit": BAD}


def verdict(result: Fit) -> Verdict:
    """The verdict, and the force where the data are, or the first parameter, with the interval to quote."""
    kind = _KINDS.get(result.verdict, BAD)
    word = result.verdict.replace("_", " ")
    found = result.conditional
    parameters = found.parameters if found else result.parameters
    shown = [(name, p) for name, p in parameters.items() if p.ci95] or list(result.parameters.items())
    force = found.reference if found else result.reference
    if force and force.ci95:
        own = Parameter(force.force, "N", force.ci95, True, "")
        shown.insert(0, (f"The force at {brief(force.penetration, 'm')}", own))
    known = _known(*shown[0]) if shown else ""
    known = f"If {found.condition}, {known}" if found and shown[0][1].ci95 else known
    wide = [note for note in result.notes if note.startswith(SPANNING)]
    lost = [name for name, p in result.parameters.items() if not p.identifiable]
    unknown = f"Not determined by the data: {', '.join(lost)}." if lost else ""
    return Verdict(
        kind, f"{word[0].upper()}{word[1:]}", " ".join(filter(None, [known, *(f"{note}." for note in wide), unknown]))
    )


def _known(name: str, p: Parameter) -> str:
    value, *ends = bounded([p.value, *(p.ci95 or ())], p.ci95 or (), p.unit)
    if not ends:
        return f"{name} is {value}, without an interval: the data do not determine it."
    return f"{name} is {value}, with 95 % confidence {' to '.join(ends)}."


def block(heading: str, rows: Rows) -> Table | Listing:
    """A table, or lines for an input file where there is one column."""
    if len(rows[0]) == 1:
        return Listing(heading, "\n".join(row[0] for row in rows))
    return Table(heading, rows)
