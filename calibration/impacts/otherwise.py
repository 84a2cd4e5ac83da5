"""Records that are no impact, and the way to a fit of them: slow tests, forces that pull, results without a clock."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import column

if TYPE_CHECKING:
    from calibration.impacts.proposal import Run

# A contact of a body that strikes is shorter [s]; up to its peak such a body loses at least that share of its speed.
_LONG, _LOST = 1.0, 0.1
# A force that pulls: its ends are alike but for this share of its range, and this share of the samples is near each.
_ALIKE, _PULLS = 0.33, 0.1
# Of a loop the share of the work that comes back from which on nothing is lost.
_ELASTIC = 0.96
# Rows of a table of places, and samples up to a peak by which a speed is told.
_ROWS, _FEW = 300, 4
PLACES, ATTITUDE = ("x", "y", "z"), ("q0", "q1", "q2", "q3")
_NAMED = {"qw": "q0", "qx": "q1", "qy": "q2", "qz": "q3", "q_w": "q0", "q_x": "q1", "q_y": "q2", "q_z": "q3"}
_WORDS = {
    "friction": re.compile(r"(?i)\b(?:mu|cof|friction|reib\w*|coefficient)\b|µ"),
    "rebound": re.compile(r"(?i)rebound|r[üu]ck(?:prall|sprung)|restitution"),
    "speed": re.compile(r"(?i)speed|velocity|slip|geschw"),
}
_DRIVEN = (
    'write a scene file whose body follows the measured displacement, drive = { kind = "table", table = [[times], [places]] }, '
    "and a calibration file that observes its force: docs/howto/problem_file.md"
)
_EACH = "give each row as an [[experiment]] with {} and features = {{ {} }}: docs/howto/problem_file.md"


class InMotion(InputError):
    """A record of a body's places and attitudes: no channel of it is an impact along one axis."""

    def __init__(self, table: Record, columns: dict[str, str]) -> None:
        super().__init__(
            table.name,
            "it holds places and attitudes of a body in motion",
            "propose a scene of a tossed body with bcfj init calibration, as examples/tossed_cube.toml, without --scene",
        )
        self.table, self.columns = table, columns


def refuse_motion(table: Record) -> None:
    """Refuse a record of places and attitudes, scalar first, whatever else it holds.

    Raises:
        InMotion: with the headers by coordinate.
    """
    found: dict[str, str] = {}
    for header in table.header:
        name = re.sub(r"^(?:pos(?:ition)?|place|cube|body)[ _.]", "", column(header)[0].strip().lower())
        key = _NAMED.get(name, name)
        if key in (*PLACES, *ATTITUDE):
            found.setdefault(key, header)
    if {*PLACES, *ATTITUDE} <= found.keys():
        raise InMotion(table, found)


def without_time(header: tuple[str, ...], kinds: Mapping[str, str], where: str) -> InputError | None:
    """What a table without a clock is, by its headers and by the readings found, header by unit; None for nothing known."""
    names = {h: column(h)[0].replace("_", " ") for h in header}
    named = {key: next((h for h, name in names.items() if w.search(name)), "") for key, w in _WORDS.items()}
    if h := named["rebound"]:
        e = 'of heights e = sqrt(rebound/drop); "contact.impulse" is m v (1 + e)'
        remedy = _EACH.format('parameters = { drop_height = "100 mm" }', '"contact.impulse" = "0.9 N s"')
        return InputError(where, f"'{h}' is a result of each impact, and no column is a time", f"{remedy} ({e})")
    if (h := named["friction"]) and (speed := kinds.get("m/s", named["speed"])):
        remedy = _EACH.format("its speed as a parameter of a driven scene", '"contact.mean" = "5 N"')
        return InputError(where, f"'{h}' against '{speed}' is a curve of steady states, without a time", remedy)
    if {"N", "m"} <= kinds.keys():
        found = f"'{kinds['N']}' against '{kinds['m']}' is a curve without a time"
        remedy = 'add a column "time [s]", of a test at constant speed the displacement over the speed, then repeat the command'
        return InputError(where, found, remedy)
    return None


def refuse_pulling(run: Run, where: str) -> None:
    """Refuse a force that pulls about as it pushes.

    Raises:
        InputError: with the way to a driven scene.
    """
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


def driven(run: Run) -> tuple[str, str]:
    """A slow test's scene, in which a body follows the measured places, and what of its contact is searched, as texts of TOML."""
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
    shape = "restitution = { lower = 0.05, upper = 1.0 }" if back else "exponent = { lower = 1.0, upper = 2.5 }"
    free = (
        f"stiffness = {{ lower = {min(ends) / 30:.1g}, upper = {30 * max(ends):.1g} }}\n{shape}\n"
        f'"contact.clearance" = {{ lower = 0.0, upper = {touch + 0.5 * depth:.3g} }}  # m; where the body touches'
    )
    return scene, free
