"""Mechanisms of one's own in a scene file: its bodies, contacts, loads and quantities become a ``Mechanism``.

    [scene]          kind = "mechanism"; law, elastic, friction, smoothing: of every contact that does not say its own;
                     start = "static": from where all is at rest
    [[body]]         name, joint, parent, at, axis, tilt = [axis, angle], center, mass, inertia, start, drive, members
    [[contact]]      name, between, gap, at = [on a, on b], law, elastic, friction, smoothing, approach, rolling,
                     values
    [[load]]         kind = gravity | force | torque | spring | bush | joint_spring | joint_friction | coupling, or one's
                     own; name, ...
    [quantity.NAME]  unit, lower, upper, default, meaning: a parameter that places and coefficients may name
    [[read]]         of, frame: readings to keep

A number is SI, a text with a unit ("50 mm"), or the name of a quantity ("rod_length", "-rod_length"). A number is the
default of a parameter, which has the name of its part: "rod.mass", "rod.at_x", "journal.stiffness".
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact import laws
from bcfj_jax.contact.gaps import GAPS, AbstractGap, make_gap
from bcfj_jax.core.errors import InputError, nearest, one_of
from bcfj_jax.core.quantities import CATALOGUE, Quantity, check_value
from bcfj_jax.io import mechanismtables as keys
from bcfj_jax.io import programmes, tables, usercode
from bcfj_jax.io.units import alike, coherent, quantity
from bcfj_jax.io.usercode import MECHANISM as KIND
from bcfj_jax.mechanism import channels, sizes
from bcfj_jax.mechanism.bodies import DRIVES, GROUND, JOINTS, Body, Drive, unit_of
from bcfj_jax.mechanism.channels import Channel
from bcfj_jax.mechanism.checks import names_read
from bcfj_jax.mechanism.contacts import Approach, Contact
from bcfj_jax.mechanism.loads import LOADS, AbstractLoad, Coupling, Load
from bcfj_jax.mechanism.mechanism import Mechanism

# Tables of a mechanism beside those of every scene file.
TABLES = ("body", "contact", "load", "quantity")
_NAME = re.compile(r"-?[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
_WHERE = re.compile(r"(?:mechanism|scene) '[^']*'\s*(.*)", re.DOTALL)
_PART = re.compile(r"(body|contact|load) '([^']*)'\s*(.*)", re.DOTALL)
# What a drive of each kind reads.
_DRIVES = {kind: reads for kind, reads in DRIVES.items() if kind != "function"} | {"speeds": ("table", "start")}
M = TypeVar("M", bound=tables.Table)


@dataclasses.dataclass(frozen=True)
class OneTurn:
    """Time in which a driven body turns once [s]: where a mechanism ends if nobody says."""

    body: str
    speed: Any

    def __call__(self, p: Mapping[str, Array]) -> Array:
        """The time."""
        speed = jnp.abs(sizes.value(self.speed, self.body, "drive_speed", p))
        return 2.0 * jnp.pi / jnp.maximum(speed, 1e-6)


def build(content: Mapping[str, Any], where: str, given: Mapping[str, Any]) -> tuple[Mechanism, dict[str, Any]]:
    """The mechanism that the tables of a file list, and the tables with every default, SI, which a file may hold again.

    ``given`` is what the file's [parameters] say, as they are written.
    """
    return _Builder(content, where, given).built()


def placed(content: Mapping[str, Any], where: str) -> contextlib.AbstractContextManager[None]:
    """Within, what is refused of a body, a contact or a load names the entry of the file."""

    def place(said: str) -> str:
        rest = said.removeprefix(where).strip()
        match = _WHERE.fullmatch(rest)
        text = match[1] if match else rest
        found = _PART.fullmatch(text)
        if found is None:
            return f"{where if said.startswith(where) or match else ''} {text}".strip()
        table, name, key = found[1], found[2], found[3]
        # The last of that name: of two, the first was right when it was read.
        numbers = [k for k, entry in enumerate(content.get(table, ())) if entry.get("name", entry.get("kind")) == name]
        entry = f"[[{table}]] {numbers[-1] + 1} '{name}'" if numbers else f"[[{table}]] '{name}'"
        return f"{where}: {entry} {key}".strip()

    return tables.placed(place)


def refuse_unread(scene: Any, params: Mapping[str, Array], given: Mapping[str, Any], where: str) -> None:
    """Refuse a parameter that the file gives and that every part has a value of its own in place of."""
    read, defaults = names_read(scene, params, where), dict(scene.defaults)
    for key in given:
        name = scene.canonical(key)
        # A file that was written with every default gives those that nobody reads, too.
        if name in read or float(params[name]) == defaults.get(name):
            continue
        own = [n for n in read if n.endswith(f".{name}")]
        beside = f": {', '.join(sorted(own))} stand in its place" if own else ""
        raise InputError(f"{where}: [parameters] {key}", f"nothing reads the parameter '{key}'{beside}", "take it out")


def readings(content: Mapping[str, Any], scene: Any, where: str) -> tuple[list[dict[str, str]], tuple[Channel, ...]]:
    """What [[read]] asks for: the resolved tables, and the readings."""
    found, resolved = [], []
    for k, table in enumerate(_listed(content, "read", where)):
        place = f"{where}: [[read]] {k + 1}"
        entry = _checked(keys.ReadTable, table, place)
        try:
            found.append(channels.channel(entry.of, scene, entry.frame or "", f"{place} of"))
        except InputError as error:
            frame = entry.frame and "to resolve" in error.found
            raise InputError(f"{place} {'frame' if frame else 'of'}", error.found, error.remedy) from None
        resolved.append({"of": entry.of} | ({"frame": entry.frame} if entry.frame else {}))
    return resolved, tuple(found)


class _Builder:
    """Reads a file's tables; remembers every name that stands for a number, to be looked up when all parts are known."""

    def __init__(self, content: Mapping[str, Any], where: str, given: Mapping[str, Any]) -> None:
        self.content, self.where, self.given = content, where, given
        self.named: list[tuple[str, str, str]] = []

    def built(self) -> tuple[Mechanism, dict[str, Any]]:
        scene = _checked(keys.SceneTable, self.content["scene"], f"{self.where}: [scene]")
        returns = any(name.rpartition(".")[2] == "restitution" for name in self.given)
        self.options = scene.model_copy(update={"law": scene.law or ("exact" if returns else "memory_free")})
        own, quantities = self._quantities()
        parts: list[tuple[Any, ...]] = []
        resolved: dict[str, Any] = {"scene": self.options.model_dump(exclude_none=True)}
        for table, read in (("body", self._body), ("contact", self._contact), ("load", self._load)):
            entries = enumerate(_listed(self.content, table, self.where))
            found = [read(entry, self._place(table, k, entry)) for k, entry in entries]
            parts.append(tuple(part for part, _ in found))
            resolved[table] = [plain for _, plain in found]
        with placed(self.content, self.where):
            mechanism = Mechanism(KIND, *parts, own=own, end=_end(parts[0]), start=self.options.start)
        self._look_up(mechanism)
        resolved["quantity"] = quantities
        return mechanism, {name: table for name, table in resolved.items() if table}

    def _place(self, table: str, k: int, entry: Mapping[str, Any]) -> str:
        name = entry.get("name")
        return f"{self.where}: [[{table}]] {k + 1}" + (f" '{name}'" if isinstance(name, str) else "")

    def _look_up(self, scene: Mechanism) -> None:
        """Refuse names that no parameter has, and those of parameters of another kind."""
        known = scene.quantities
        for place, text, unit in self.named:
            name = scene.canonical(text.removeprefix("-"))
            if name not in known:
                remedy = f"{nearest(name, known)} Declare one of your own in [quantity.{name}]"
                raise InputError(place, f"no quantity '{name}'", remedy)
            if not alike(known[name].unit, unit):
                found = f"'{name}' is in {known[name].unit}, and this is in {unit}"
                raise InputError(place, found, f"name a quantity in {unit}")

    # Numbers.

    def _size(self, value: Any, unit: str, place: str, exponent: float | None = None) -> float | str | None:
        """A number in SI, or a name, which is looked up later."""
        if value is None:
            return None
        if isinstance(value, str) and _NAME.fullmatch(value.strip()):
            self.named.append((place, value.strip(), unit))
            return value.strip()
        try:
            return quantity(value, unit, place, exponent=exponent)
        except InputError as error:
            remedy = f"{error.remedy}, or the name of a quantity" if isinstance(value, str) else error.remedy
            raise InputError(error.where, error.found, remedy) from None

    def _sized(self, value: Any, unit: str, shape: tuple[int, ...], place: str) -> Any:
        """A number, or a list of this shape of numbers, which becomes a tuple."""
        if not shape or value is None:
            return self._size(value, unit, place)
        if len(value) != shape[0]:
            example = '"50 mm"' if unit == "m" else '"1e-4 kg m^2"'
            if len(shape) == 2:
                raise InputError(place, f"{len(value)} places", "give two: [on the first body, on the second]")
            raise InputError(place, f"{list(value)}", f"give three numbers, such as [{example}, 0, 0]")
        return tuple(self._sized(x, unit, shape[1:], f"{place}[{k}]") for k, x in enumerate(value))

    def _numbers(self, entry: tables.Table, place: str, turns: bool = False) -> dict[str, Any]:
        """The fields of an entry, those that have a unit in SI; of a joint that turns in radians."""
        found = {key: getattr(entry, key) for key in type(entry).model_fields}
        for key, field in type(entry).model_fields.items():
            for unit, shape in (x for x in field.metadata if isinstance(x, keys.In)):
                # An inertia may be one number.
                shape = shape if isinstance(found[key], list) else ()
                if key == "inertia" and shape and len(found[key]) == 6:
                    shape = (6,)
                found[key] = self._sized(found[key], keys.TURNED.get(unit, unit) if turns else unit, shape, place + key)
        return found

    def _table(self, rows: list[list[Any]], unit: str, place: str, over: str = "s") -> Any:
        if len(rows) != 2 or len(rows[0]) != len(rows[1]):
            raise InputError(place, "has not two rows of one length", "give [[times], [values]]")
        return tuple(map(tuple, programmes.table(rows, unit, place, over=over)))

    def _quantities(self) -> tuple[list[tuple[Quantity, float | None]], dict[str, dict[str, Any]]]:
        found, resolved = [], {}
        for name, table in self.content.get("quantity", {}).items():
            place = f"{self.where}: [quantity.{name}]"
            if not name.isidentifier():
                raise InputError(place, f"'{name}' is no name for a quantity", "give a word of letters, digits and '_'")
            entry = _checked(keys.QuantityTable, table, place)
            unit = coherent(entry.unit, f"{place} unit")
            known = CATALOGUE.get(name)
            if known is not None and not alike(known.unit, unit):
                found_ = f"'{name}' is {known.meaning}, in {known.unit}, not in {unit}"
                raise InputError(f"{place} unit", found_, f"give {known.unit}, or the quantity another name")
            numbers = {
                key: quantity(getattr(entry, key), unit, f"{place} {key}")
                for key in ("lower", "upper", "default")
                if getattr(entry, key) is not None
            }
            low, high = numbers.get("lower", float("-inf")), numbers.get("upper", float("inf"))
            if not low <= high:
                raise InputError(f"{place} lower", f"{low:g} is above upper = {high:g}", "give lower <= upper")
            own = Quantity(name, unit, entry.meaning or name.replace("_", " "), low, high)
            if "default" in numbers:
                check_value(f"{place} default", own, numbers["default"])
            found.append((own, numbers.get("default")))
            finite = {key: x for key, x in numbers.items() if abs(x) != float("inf")}
            resolved[name] = {"unit": unit, **finite, "meaning": own.meaning}
        return found, resolved

    # Parts.

    def _body(self, table: Mapping[str, Any], place: str) -> tuple[Body, dict[str, Any]]:
        entry = _checked(keys.BodyTable, table, place)
        if isinstance(entry.parent, list):
            parents = " and on ".join(map(repr, entry.parent))
            found = f"'{entry.name}' hangs on {parents}: joints alone would close a loop"
            remedy = "give it one parent, and close the loop by a contact with clearance or a bush"
            raise InputError(f"{place} parent", found, remedy)
        if not isinstance(entry.parent, str):
            raise InputError(f"{place} parent", f"{entry.parent!r}", f"give the name of a body, or '{GROUND}'")
        one_of(f"{place} joint", "joint", entry.joint, JOINTS)
        given = self._numbers(entry, f"{place} ") | {"axis": _axis(entry.axis, f"{place} axis")}
        if entry.tilt is not None:
            if len(entry.tilt) != 2:
                raise InputError(f"{place} tilt", f"{entry.tilt}", 'give [axis, angle], such as ["y", "90 deg"]')
            axis = _axis(entry.tilt[0], f"{place} tilt[0]")
            given["tilt"] = (axis, self._size(entry.tilt[1], "rad", f"{place} tilt[1]"))
        asked = given.pop("drive")
        drive = self._drive(asked, entry.joint == "hinge", f"{place} drive") if asked else None
        moves = None if drive else Body("moves", entry.joint)
        known = (*moves.coordinates, *moves.rates) if moves else ()
        for key in entry.start:
            one_of(f"{place} start.{key}", "coordinate", key, known)
        given["start"] = {key: self._size(x, unit_of(key), f"{place} start.{key}") for key, x in entry.start.items()}
        with _said_of(f"body '{entry.name}'", place):
            body = Body(**{key: x for key, x in given.items() if key != "tilt" or x is not None}, drive=drive)
        plain = {key: _listing(x) for key, x in given.items() if x not in (None, {}, (0.0, 0.0, 0.0))}
        return body, plain | ({"drive": _drive_table(asked, drive)} if asked and drive else {})

    def _drive(self, entry: keys.DriveTable, turns: bool, place: str) -> Drive:
        known = (*_DRIVES, *usercode.functions())
        one_of(f"{place}.kind", "kind of drive", entry.kind, known, usercode.hint())
        reads = _DRIVES.get(entry.kind, ())
        for key in ("speed", "over", "start", "first", "shape", "table"):
            if key not in reads and getattr(entry, key) is not None:
                found = f"a drive of kind '{entry.kind}' has no {key}"
                raise InputError(f"{place}.{key}", found, nearest(key, reads) if reads else "its function says all")
        if entry.kind not in _DRIVES:
            return Drive("function", function=usercode.functions()[entry.kind])
        given = {key: x for key, x in self._numbers(entry, f"{place}.", turns).items() if x is not None}
        if "table" in given:
            values = "m/s" if entry.kind == "speeds" else "m"
            unit = keys.TURNED[values] if turns else values
            given["table"] = self._table(given["table"], unit, f"{place}.table")
        with _said_of("drive", place):
            return Drive(**given)

    def _contact(self, table: Mapping[str, Any], place: str) -> tuple[Contact, dict[str, Any]]:
        _check_misplaced(table, place)
        entry = _checked(keys.ContactTable, table, place)
        gap, gap_table = _gap(entry.gap, f"{place} gap")
        # A law of its own has its own elastic part, whatever the other contacts have.
        elastic = entry.elastic or (self.options.elastic if entry.law is None else None)
        law = _named("law", entry.law or self.options.law, elastic, place)
        try:
            friction = laws.make_friction(self.options.friction if entry.friction is None else entry.friction)
        except InputError as error:
            raise InputError(f"{place} friction", error.found, error.remedy + usercode.hint()) from None
        smoothing = self.options.smoothing if entry.smoothing is None else entry.smoothing
        one_of(f"{place} approach", "approach", entry.approach, ("memory", "parameter"))
        given: dict[str, Any] = {
            "name": entry.name, "between": tuple(entry.between), "gap": gap, "law": law, "friction": friction,
            "smoothing": smoothing, "at": self._numbers(entry, f"{place} ")["at"],
            "approach": "parameter" if entry.approach == "parameter" else Approach(), "rolling": entry.rolling,
        }  # fmt: skip
        with _said_of(f"contact '{entry.name}'", place):
            contact = Contact(**given)
            if entry.values:
                values = self._coefficients(contact, entry.values, f"{place} values")
                contact = Contact(**given, values=values)
        plain = {"name": entry.name, "between": list(entry.between), "gap": gap_table, "at": _listing(contact.at)}
        own = {key: getattr(entry, key) for key in ("law", "elastic", "friction", "smoothing")}
        plain |= {key: x for key, x in own.items() if x is not None} | {"approach": entry.approach}
        plain |= {"rolling": True} if entry.rolling else {}
        return contact, plain | ({"values": dict(contact.values)} if contact.values else {})

    def _coefficients(self, contact: Contact, values: Mapping[str, Any], place: str) -> dict[str, Any]:
        known = contact.parameters()
        units = {key.removeprefix(f"{contact.name}."): q.unit for key, (q, _) in known.items()}
        units |= {"clearance": "m"} if "clearance" in contact.reads else {}
        found = {}
        for key in sorted(values, key=lambda key: key != "exponent"):
            if key not in contact.reads:
                said = f"its gap, law and friction read no '{key}'"
                raise InputError(f"{place}.{key}", said, nearest(key, contact.reads))
            exponents = (found, self.given)
            names = ("exponent", f"{contact.name}.exponent")
            exponent = next((x[n] for n in names for x in exponents if isinstance(x.get(n), (int, float))), None)
            found[key] = self._size(values[key], units[key], f"{place}.{key}", exponent)
        return found

    def _load(self, table: Mapping[str, Any], place: str) -> tuple[AbstractLoad, dict[str, Any]]:
        kind, known = table.get("kind"), (*LOADS, *usercode.functions())
        if kind is None:
            raise InputError(f"{place} kind", "the key 'kind' is missing", f"give one of {', '.join(known)}")
        one_of(f"{place} kind", "kind of load", kind, known, usercode.hint())
        if kind not in LOADS:
            own = _checked(keys.OwnTable, table, place)
            return Load(own.name, usercode.functions()[kind], tuple(own.bodies)), own.model_dump(exclude_none=True)
        entry: Any = _checked(keys.LOAD_TABLES[kind], table, place)
        joints = {body.get("name"): body.get("joint") for body in self.content.get("body", ())}
        turns = kind in ("joint_spring", "joint_friction") and joints.get(entry.body) == "hinge"
        given = self._numbers(entry, f"{place} ", turns)
        del given["kind"]
        if "direction" in given:
            given["direction"] = _axis(entry.direction, f"{place} direction")
        if "between" in given:
            if len(entry.between) != 2 or entry.between[0] == entry.between[1]:
                raise InputError(f"{place} between", f"{entry.between}", "give the names of two different bodies")
            given["between"] = tuple(entry.between)
        if kind == "coupling":
            for name in entry.joints:
                one_of(f"{place} joints", "body", name, joints)
            units = Coupling.units(*(joints[name] == "hinge" for name in entry.joints))
            given |= {key: self._size(given[key], unit, f"{place} {key}") for key, unit in units.items()}
        if given.get("table") is not None and kind in ("spring", "joint_spring"):
            rows = ("rad", "N m") if turns else ("m", "N")
            given["table"] = self._table(given["table"], rows[1], f"{place} table", rows[0])
        elif given.get("table") is not None:
            if any(x is not None for x in (entry.size, entry.ramp, entry.amplitude, entry.reversal)):
                raise InputError(f"{place} table", "is given beside a size or a ramp", "give one of them")
            given["table"] = self._table(given["table"], programmes.OF_LOADS[kind], f"{place} table")
        drive = given.pop("drive", None)
        made: dict[str, Any] = {"drive": self._drive(drive, turns, f"{place} drive")} if drive else {}
        with _said_of(f"load '{entry.name}'", place):
            load = LOADS[kind](**given, **made)
        plain = {"kind": kind} | {key: _listing(x) for key, x in given.items() if x is not None}
        return load, plain | ({"drive": _drive_table(drive, made["drive"])} if drive else {})


def _listed(content: Mapping[str, Any], table: str, where: str) -> list[Mapping[str, Any]]:
    entries = content.get(table) or []
    for k, entry in enumerate(entries):
        if not isinstance(entry, Mapping):
            remedy = f"write [[{table}]] and keys below"
            raise InputError(f"{where}: [[{table}]] {k + 1}", f"{entry!r} is no table", remedy)
    return entries


def _checked(model: type[M], table: object, place: str) -> M:
    """``tables.validated`` with an entry's place in front of the key."""

    def key(where: str) -> str:
        return re.sub(r"^@: (?:\[(.*?)\] )?", lambda m: f"{m[1]}." if m[1] else "", where)

    with tables.placed(lambda where: f"{place} {key(where)}".rstrip()):
        return tables.validated(model, table, "@")


def _said_of(part: str, place: str) -> contextlib.AbstractContextManager[None]:
    """Within, what a part refuses of itself names the entry of the file."""
    return tables.placed(
        lambda where: where if where.startswith(place) else f"{place} {where.removeprefix(part).strip()}".strip()
    )


def _axis(axis: Any, place: str) -> Any:
    sizes.axis(axis, place)
    return axis if isinstance(axis, str) else tuple(float(x) for x in axis)


def _check_misplaced(table: Mapping[str, Any], place: str) -> None:
    """Refuse an option of the gap, or a coefficient, that stands among the keys of a contact, and say where it belongs."""
    kind = table.get("gap")
    gap = GAPS.get(kind) if isinstance(kind, str) else None
    options = [field.name for field in dataclasses.fields(gap)] if isinstance(gap, type) else []
    for key in table.keys() - keys.ContactTable.model_fields.keys():
        remedy = f'it is an option of the gap: gap = {{ kind = "{kind}", {key} = ... }}'
        if key not in options:
            remedy = f'it is a coefficient: values = {{ {key} = ... }}, or "{table.get("name")}.{key}" in [parameters]'
        if key in options or key in CATALOGUE:
            raise InputError(f"{place} {key}", f"unknown key '{key}'", remedy)


def _gap(given: str | dict[str, Any], place: str) -> tuple[AbstractGap, Any]:
    """A gap, and how a file says it with every default."""
    options = {} if isinstance(given, str) else {key: x for key, x in given.items() if key != "kind"}
    kind = given if isinstance(given, str) else given.get("kind")
    if kind is None:
        raise InputError(f"{place}.kind", "the key 'kind' is missing", f"give one of {', '.join(GAPS)}")
    one_of(place, "gap", kind, GAPS, usercode.hint())
    try:
        gap = make_gap(kind, **options)
    except InputError as error:
        key = re.search(r"option '(\w+)'", f"{error.where} {error.found}")
        raise InputError(f"{place}.{key[1]}" if key else place, error.found, error.remedy) from None
    if not isinstance(GAPS[kind], type):
        return gap, kind
    fields = {f.name: _listing(getattr(gap, f.name)) for f in dataclasses.fields(gap)}
    return gap, {"kind": kind, **fields} if fields else kind


def _named(what: str, name: str | None, elastic: str | None, place: str) -> Any:
    for key, value, known in ((what, name, laws.LAWS), ("elastic", elastic, laws.ELASTIC)):
        if value is not None:
            one_of(f"{place} {key}", f"such {key}", value, known, usercode.hint())
    with tables.placed(lambda where: f"{place} {where}"):
        return laws.make(name or "memory_free", elastic)


def _end(bodies: Sequence[Body]) -> Any:
    driven = ((b.name, b.drive) for b in bodies if b.drive is not None and b.joint == "hinge")
    return next((OneTurn(name, d.speed) for name, d in driven if d.kind in ("constant", "ramp")), 1.0)


def _drive_table(entry: keys.DriveTable, drive: Drive) -> dict[str, Any]:
    given = {key: _listing(getattr(drive, key)) for key in _DRIVES.get(entry.kind, ())}
    return {"kind": entry.kind} | {key: x for key, x in given.items() if x is not None}


def _listing(x: Any) -> Any:
    return [_listing(part) for part in x] if isinstance(x, (tuple, list)) else x
