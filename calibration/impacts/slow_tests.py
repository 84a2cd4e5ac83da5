"""Slow tests, of a body that is driven into a contact, and forces that pull as they push; by their channels alone."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import numpy as np

from bcfj_jax import InputError
from calibration.impacts.lines import NOISE, Draft, Line, Said, box, read_as, scene_of, toml, with_scene
from calibration.impacts.proposal import Run, Understood

# A contact of a body that strikes is shorter [s]; up to its peak such a body loses at least that share of its speed.
_LONG, _LOST = 1.0, 0.1
# A force that pulls: its ends are alike but for this share of its range, and this share of the samples is near each.
_ALIKE, _PULLS = 0.33, 0.1
# Of a loop the share of the work that comes back from which on nothing is lost.
_ELASTIC = 0.96
# Rows of a table of places, and samples up to a peak by which a speed is told.
_ROWS, _FEW = 300, 4
_DRIVEN = (
    'write a scene file whose body follows the measured displacement, drive = { kind = "table", table = [[times], [places]] }, '
    "and a calibration file that observes its force: docs/howto/problem_file.md"
)


def refuse_pulling(run: Run, where: str) -> None:
    """Refuse a force that pulls about as it pushes."""
    force = run.readings.get("N", np.zeros(0))
    force = force[np.isfinite(force)]
    if force.size < _FEW:
        return
    # Of three readings the middle one: a wrong sample is no pull.
    middle = np.median([force[:-2], force[1:-1], force[2:]], axis=0)
    high, low = float(middle.max()), float(middle.min())
    shares = np.mean(middle > 0.5 * high), np.mean(middle < 0.5 * low)
    if high > 0.0 > low and abs(high + low) < _ALIKE * (high - low) and min(shares) > _PULLS:
        found = "the force pulls as it pushes, as friction and joints with two sides do, and a contact only pushes"
        raise InputError(where, found, f"{_DRIVEN}; to take it as impacts all the same give --scene impact")


def is_slow(run: Run) -> bool:
    """Whether force and place are those of a slow test: the body is driven into the contact, which does not slow it down."""
    if not {"N", "m"} <= run.readings.keys():
        return False
    event, place = run.events[0], run.readings["m"]
    peak = event.first + int(np.nanargmax(run.readings["N"][event.first : event.last + 1]))
    way, speeds = peak - event.first, []
    for rows in (slice(max(event.first - way, 0), event.first + 1), slice(event.first, peak + 1)):
        seen = np.isfinite(place[rows])
        if np.count_nonzero(seen) < _FEW:
            return False
        speeds.append(abs(float(np.polyfit(run.clock[rows][seen], place[rows][seen], 1)[0])))
    return event.duration > _LONG or speeds[1] > (1.0 - _LOST) * speeds[0]


def draft(found: Understood, said: Said, path: Path, file: str) -> Draft:
    """The problem file at ``path`` of a slow test, which names the record ``file``."""
    if found.runs[0]:
        many = f"{found.runs[1]} slow tests, by {found.runs[0]}"
        raise InputError(str(found.path), many, f'choose one: --rows "{found.runs[0]} = 1"')
    scene, free = _driven(found.records[0])
    lines = [
        f"# A slow test, {found.path.name}: the body is driven, its mass does not count. Next: bcfj calibrate {quote(path.name)}",
        *([f"# Read as {found.said}."] if found.said else []),
        Line(f"scene = {toml(scene_of(path).name)}", "in which the body follows the measured displacement"),
        "[[experiment]]",
        *read_as(found, said, file),
        f'observe = {{ "contact.normal" = {toml(found.columns["N"])} }}',
        NOISE,
        "[free]",
        *free,
    ]
    kind = "force and displacement are those of a slow test, no impact; --scene impact takes one all the same"
    return with_scene(path, scene, lines, kind)


def _driven(run: Run) -> tuple[str, list[Line]]:
    """A scene in which a body follows the measured places, and what of its contact is searched."""
    seen = np.flatnonzero(np.isfinite(run.readings["m"]))
    rows = seen[np.unique(np.linspace(0, seen.size - 1, min(_ROWS, seen.size)).astype(int))]
    clock, place = run.clock[rows], run.readings["m"][rows]
    force, event = run.readings["N"] - run.rest("N"), run.events[0]
    peak = event.first + int(np.nanargmax(force[event.first : event.last + 1]))
    places = np.interp(run.clock, run.clock[seen], run.readings["m"][seen])
    place = place - places[0]
    touch, deep = (float(places[k] - places[0]) for k in (event.first, peak))
    depth = max(deep - touch, 1e-3 * deep)
    # A press that comes back shows what it lost.
    taken = float(np.trapezoid(np.nan_to_num(force[: peak + 1]), places[: peak + 1]))
    given = -float(np.trapezoid(np.nan_to_num(force[peak:]), places[peak:]))
    back = bool(places[-1] - places[0] < touch + 0.5 * depth) and given < _ELASTIC * taken
    ends = [float(force[peak]) / depth**n for n in ((1.0,) if back else (1.0, 2.5))]
    table = ", ".join("[" + ", ".join(f"{x:.6g}" for x in row) + "]" for row in (clock, place))
    law = 'law = "walton_braun"\n' if back else ""
    values = "restitution = 0.7" if back else "exponent = 1.0\ndamping = 0.0"
    scene = f"""# A slow test: the body follows the measured places, and no inertia counts; written by bcfj init calibration.
[scene]
kind = "mechanism"
[[body]]
name = "body"
joint = "slide"
axis = "x"
mass = "1 kg"
drive = {{ kind = "table", table = [{table}] }}
[[contact]]
name = "contact"
between = ["ground", "body"]
gap = {{ kind = "point_on_plane", axis = [-1.0, 0.0, 0.0], clearance = true }}
{law}[parameters]
stiffness = {ends[0]:.3g}
{values}
"contact.clearance" = {max(touch, 0.0):.3g}
[time]
end = {clock[-1]:.6g}
samples = {clock.size}
"""
    shape = ("restitution", ("0.05", "1.0")) if back else ("exponent", ("1.0", "2.5"))
    return scene, [
        box("stiffness", (f"{min(ends) / 30:.1g}", f"{30 * max(ends):.1g}")),
        box(*shape),
        box('"contact.clearance"', ("0.0", f"{touch + 0.5 * depth:.3g}"), "m; where the body touches"),
    ]
