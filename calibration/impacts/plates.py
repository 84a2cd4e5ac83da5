"""Force plates: three forces, three moments or a centre of pressure; which force is read, and where on the plate the hit was."""

from __future__ import annotations

import re

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import column, format_si

_NAMES = {
    "force": re.compile(r"(?i)(?:force[ _-]?|f)([xyz])[ _-]?\d*"),
    "moment": re.compile(r"(?i)(?:moment[ _-]?|m)([xyz])[ _-]?\d*"),
    "pressure": re.compile(r"(?i)(?:cof?p\W*[ca]?|[ca])[ _-]?([xyz])[ _-]?\d*"),
}
_UNITS = {"pressure": "m", "moment": "N m"}


def _axes(table: Record, kind: str) -> dict[str, str]:
    """Headers by axis of the first plate in a table."""
    found: dict[str, str] = {}
    for header in table.header:
        if match := _NAMES[kind].fullmatch(column(header)[0].strip()):
            found.setdefault(match[1].lower(), header)
    return found


def is_pressure(table: Record, header: str) -> bool:
    """Whether a column is where a force acts on its plate: a place, and not that of a body."""
    named = _NAMES["pressure"].fullmatch(column(header)[0].strip())
    return named is not None and len(_axes(table, "force")) > 1


def said(table: Record, header: str, force: np.ndarray) -> str:
    """Which force of a plate is read, by its readings (N,) [N] less rest, and where it acts at its peak; "" of no plate."""
    forces = _axes(table, "force")
    if len(forces) < 2 or header not in forces.values():
        return ""
    text = f"Of {', '.join(forces.values())} the one that changes most is read, {header}"
    place = _place(table, header, force) if header == forces.get("z") else None
    if place is None:
        return text
    x, y = (format_si(v, "m", 3) for v in place)
    return (
        f"{text}; at its peak it acts at x = {x}, y = {y} of the plate's axes: far from its middle a plate tilts and rings, "
        "which its force then holds, too"
    )


def _place(table: Record, header: str, force: np.ndarray) -> tuple[float, float] | None:
    """Where the force acts at its peak [m]: by the centre of pressure, or else by moments about the plate's origin."""
    peak, places = int(np.nanargmax(np.abs(force))), {kind: _axes(table, kind) for kind in _UNITS}
    kind, axes = next(((kind, axes) for kind, axes in places.items() if {"x", "y"} <= axes.keys()), ("", {}))
    if not axes:
        return None
    try:
        x, y = (float(table.numbers(axes[k], _UNITS[kind], table.name, True)[peak]) for k in "xy")
        push = float(table.numbers(header, "N", table.name, True)[peak])
    except InputError:
        return None
    found = (x, y) if kind == "pressure" else (-y / push, x / push)
    return found if np.isfinite(found).all() else None
