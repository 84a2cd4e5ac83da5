"""Records that are no impact, and the way to a fit of them: bodies in motion, and results without a clock."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping

from bcfj_jax import InputError
from bcfj_jax.data.clock import TIMES
from bcfj_jax.data.record import Record
from bcfj_jax.io.units import column
from calibration.impacts import headers
from calibration.impacts.events import falls

PLACES, ATTITUDE = ("x", "y", "z"), ("q0", "q1", "q2", "q3")
_METRES = {1.0: "m", 1e-2: "cm", 1e-3: "mm"}  # Units of places by their size.
_ANGLES = ("roll", "pitch", "yaw")
_NAMED = {"qw": "q0", "qx": "q1", "qy": "q2", "qz": "q3", **dict(zip(("rx", "ry", "rz"), _ANGLES, strict=True))}
_NAMED |= {f"{a}{k}": k for a in "pt" for k in PLACES}
# Words before x, y, z by which they are an attitude's, and by which they are no place's.
_TURNED = {"rot", "rotation", "quat", "quaternion", "orientation", "attitude", "q"}
_MOVED = {"linear", "angular", "spin", "omega", "w", "moment"}.union(*(headers.NAMES[u] for u in ("N", "m/s^2", "m/s")))
# Vectors whose parts are numbered.
_VECTORS, _NUMBERED = {"tvec", "position", "pos", "translation", "xyz", "place"}, dict(zip("123", PLACES, strict=True))
_WORDS = {
    "friction": re.compile(r"(?i)\b(?:mu|cof|friction|reib\w*|coefficient)\b|µ"),
    "speed": re.compile(r"(?i)speed|velocity|slip|geschw"),
}
# What came of an impact: a rebound, a restitution, a duration.
_RESULTS = re.compile(
    r"(?i)rebound|r[üu]ck(?:prall|sprung)|restitu[tcz]i|\bcor\b|sto(?:ss|ß)zahl|reb(?:ote|ond)|rimbalz"
    r"|\b(?:contact|impact|collision|kontakt|sto(?:ss|ß))[ -]?(?:time|duration|dauer|zeit)"
    r"|(?:dur[ée]e|temps|duraci[óo]n|tiempo|durata|tempo) d\S* ?(?:contat?to|contact|impact|choque?)"
)
# Rows of a table of results are fewer; words for what is read behind an impact.
_FEW = 64
_AFTER = re.compile(r"(?i)\b(?:after|nach(?:her|dem)?|danach|apr[èe]s|despu[ée]s|dopo|depois|efter)\b")
_EACH = 'give each row as an [[experiment]] with features = { "contact.impulse" = "0.9 N s" }: docs/howto/problem_file.md#results'


class InMotion(InputError):
    """A record of a body's places and attitudes: no channel of it is an impact along one axis."""

    def __init__(self, table: Record, columns: dict[str, str]) -> None:
        way = (
            "propose a scene of a tossed body with bcfj init calibration, as examples/tossed_cube.toml, without --scene"
        )
        super().__init__(table.name, "it holds places and attitudes of a body in motion", way)
        self.table, self.columns, self.tables = table, columns, [table.inside or None]


class Steady(InputError):
    """A curve of steady states: friction against speed, without a clock; ``columns``: speed, friction, and "" or normal force."""

    def __init__(self, table: Record, columns: tuple[str, str, str]) -> None:
        found = f"'{columns[1]}' against '{columns[0]}' is a curve of steady states, without a time"
        way = "propose a scene that is driven from state to state with bcfj init calibration, without --scene"
        super().__init__(table.name, found, way)
        self.table, self.columns = table, columns


def refuse_motion(table: Record) -> None:
    """Refuse a record of places and attitudes, scalar first, whatever else it holds: "pose.orientation.x", "Position X".

    So is a table whose rows are impacts, by a column of what came of them; a duration is no clock.
    """
    found: dict[str, str] = {}
    moving = [h for h in table.header if h and headers.read_unit(table, h) in ("m/s", "m")]
    few = bool(table.clock and moving) and table.lines.size < _FEW
    lasts = few and headers.name_of(table.clock) not in TIMES and not headers.rises(table, table.clock)
    for header in table.header:
        name = column(header)[0].replace("_", " ")
        result = _RESULTS.search(name) or (header in moving and _AFTER.search(name)) or (header and lasts)
        if table.clock in ("", header) and result:
            raise InputError(table.name, f"'{header}' is a result of each impact, and no column is a time", _EACH)
        *about, last = re.findall(r"[^\W_]+", column(header)[0].lower()) or [""]
        last = _NUMBERED.get(str(last), str(last)) if _VECTORS & {*about} else str(last)  # "tvec 1" is along x.
        key = f"q{last}" if _TURNED & {*about} and len(last) == 1 else last
        key, unit = _NAMED.get(key, key), column(header)[1]
        turns = key in _ANGLES and unit in (None, "deg", "°", "rad")
        # "tx" may be a torque.
        moves = key in PLACES and (last in PLACES or unit is None or headers.read_unit(table, header) == "m")
        if key in ATTITUDE or turns or (moves and not _MOVED & {*about}):
            found.setdefault(key, header)
    if {*PLACES, *ATTITUDE} <= found.keys():
        places = {k: in_metres(table, found[k]) for k in PLACES}
        raise InMotion(table, {**places, **{k: found[k] for k in ATTITUDE}})
    if {*PLACES, *_ANGLES} <= found.keys():
        known = (
            f"'{found['roll']}' and others turn a body in an order that nothing states, and its motion does not show"
        )
        height = f'of a ball take its height alone, as --observe "{found["z"]}"'
        raise InputError(table.name, known, f"write its attitude as columns q0 to q3, scalar first; {height}")


def in_metres(table: Record, header: str) -> str:
    """A column of places with its unit: as it states, or where it or another axis of the body falls, by gravity."""
    if column(header)[1] is not None or not table.clock:
        return header
    bare = [h.strip() for h in table.header if column(h)[1] is None]
    alike = [header, *(h for h in bare if h[-1:].lower() in PLACES or h[:-1] == header.strip()[:-1])]
    with contextlib.suppress(InputError):
        clock = table.numbers(table.clock, "s", table.name, False)
        unit = max(abs(falls(clock, table.numbers(h, "m", table.name, True))) for h in alike)
        return f"{header} [{_METRES[unit]}]" if unit else header
    return header


def without_time(table: Record, kinds: Mapping[str, str], other: str) -> InputError | None:
    """What a table without a clock is, by its headers and by the readings found, header by unit; None for nothing known.

    ``other``: a column that may be a clock which is not named as one; "" for none.
    """
    header, where = table.header, table.name
    names = {h: column(h)[0].replace("_", " ") for h in header}
    named = {key: next((h for h, name in names.items() if w.search(name)), "") for key, w in _WORDS.items()}
    # A ratio named as one goes before forces, of which the second is friction.
    force = kinds.get("tangential", kinds.get("N", ""))
    ratio = "" if named["friction"] in kinds.values() else named["friction"]
    if (h := ratio or force) and (speed := kinds.get("m/s", named["speed"])):
        return Steady(table, (speed, h, kinds.get("N", "") if h == kinds.get("tangential") else ""))
    if {"N", "m"} <= kinds.keys() and not other:
        found = f"'{kinds['N']}' against '{kinds['m']}' is a curve without a time"
        remedy = 'add a column "time [s]", of a test at constant speed the displacement over the speed, then repeat the command'
        remedy += (
            '; where the force does not depend on the speed --rate "1 Hz" of init calibration takes a row a second'
        )
        return InputError(where, found, remedy)
    return None
