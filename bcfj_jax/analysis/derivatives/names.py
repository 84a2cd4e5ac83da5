"""What is differentiated and by what: names of parameters and of features, checked."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from jax import Array

from bcfj_jax.analysis.features import DEFAULT, EVENTS, KINDS, NAMED, OF_READING, PAIR
from bcfj_jax.core.errors import InputError, nearest, texts
from bcfj_jax.mechanism.channels import READ_BY, is_reading, unit_of
from bcfj_jax.mechanism.model import AbstractModel, Params

_EVENT = re.compile(rf"({'|'.join(EVENTS)})_([1-9][0-9]{{0,3}})")


def event(kind: str) -> tuple[str, int] | None:
    """A kind such as ``begin_3`` as ("begin", 3); None for what is of no single contact."""
    found = _EVENT.fullmatch(kind)
    return (found[1], int(found[2])) if found else None


def smooth(kind: str) -> bool:
    """Whether JAX differentiates a kind of feature of one run, backward and twice, too."""
    return kind in KINDS and not KINDS[kind].host and kind != PAIR


def kind_unit(kind: str) -> str | None:
    """Unit of a kind of feature, with N for that of a reading; None for none that is known."""
    one = event(kind)
    if one:
        return EVENTS[one[0]].unit
    return KINDS[kind].unit if kind in KINDS and KINDS[kind].named else None


def nearest_kind(kind: str) -> str:
    """A remedy for a kind that is not known: the nearest that is, with its number where it has one."""
    plain, _, number = kind.rpartition("_")
    known = [*NAMED, *(f"{name}_{number if plain and number.isdigit() and int(number) else 1}" for name in EVENTS)]
    return nearest(kind, known)


def feature_unit(name: str) -> str:
    """Unit of a feature by its name: a reading's own where it is of one, else of a force."""
    place, _, kind = name.rpartition(".")
    unit = kind_unit(kind)
    if unit is None:
        raise KeyError(kind)
    return unit.replace("N", unit_of(place)) if is_reading(place) else unit


# Parameters that go by one name: patterns of their shared and of their contacts' own names.
GROUPS: dict[str, tuple[str, ...]] = {
    "clearances": ("clearance_*", "*.clearance"),
    "stiffnesses": ("stiffness", "*.stiffness"),
    "dampings": ("damping", "*.damping"),
    "exponents": ("exponent", "*.exponent"),
    "frictions": ("friction_*", "*.friction_*"),
    "masses": ("mass", "*mass"),
    "all": ("*",),
}


def expanded(scene: AbstractModel, params: Params, wrt: Sequence[str]) -> tuple[str, ...]:
    """Names of parameters, in which a group (``clearances``) or a pattern (``clearance_*``) stands for all that have a
    value here and may be differentiated by.

    ``InputError`` for a group or pattern that stands for nothing.
    """
    found: list[str] = []
    for name in wrt:
        patterns = GROUPS.get(name, (name,) if set(name) & set("*?[") else ())
        if not patterns or name in scene.quantities:
            found.append(name)
            continue
        own = [p for p in scene.quantities if p in params and any(fnmatch.fnmatchcase(p, x) for x in patterns)]
        if not own:
            known = ", ".join(p for p in scene.quantities if p in params)
            raise InputError("wrt", f"'{name}' names no parameter of the scene '{scene.kind}'", f"known here: {known}")
        found += [p for p in own if p not in found]
    return tuple(found)


class Feature(NamedTuple):
    """One number of a run: its full name, its kind (``features.KINDS`` or ``event``) and the contact, or the pair, it is of."""

    name: str
    kind: str
    contacts: tuple[str, ...]

    @property
    def of_size(self) -> bool:
        """Whether it is of the size of a history: all are that are of contacts, and ``largest`` of a reading."""
        return self.kind == "largest" or not is_reading(self.contacts[0])


def complete(scene: AbstractModel, params: Params, wrt: Sequence[str]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Parameters in which every name of ``wrt`` has a value of its own, and the names, checked.

    A contact's own coefficient that the parameters leave to the shared one is given the shared value.

    ``InputError`` for no name, an unknown one (with the nearest) or a repeated one, and one without a value; as ``expanded``,
    which says what groups and patterns are.
    """
    asked = texts("wrt", wrt, f"name one or more of {', '.join(scene.quantities)}")
    names = tuple(map(scene.canonical, expanded(scene, params, asked)))
    if not names:
        raise InputError("wrt", "no parameter", f"name one or more of {', '.join(scene.quantities)}")
    full = dict(params)
    for name in names:
        if name not in scene.quantities:
            known = (*scene.quantities, *GROUPS)
            raise InputError("wrt", f"scene '{scene.kind}' has no parameter '{name}'", nearest(name, known))
        if shape := scene.quantities[name].shape:
            remedy = "name parameters that are one number each; arrays are trained by jax.grad of bj.force_history"
            raise InputError("wrt", f"'{name}' is an array of shape {shape}", remedy)
        if names.count(name) > 1:
            raise InputError("wrt", f"'{name}' is named twice", "name it once")
        own = in_its_place(full, name)
        if own is not None:
            remedy = f"name {' or '.join(own)}" if own else f"give one: scene.parameters({{'{name}': ...}})"
            raise InputError("wrt", f"'{name}' has no value here", remedy)
        full[name] = full[name] if name in full else full[name.rpartition(".")[2]]
    return full, names


def in_its_place(params: Collection[str], name: str) -> list[str] | None:
    """Names of the parameters that have a value where this one has none; None where it has one, its own or the shared."""
    if name in params or name.rpartition(".")[2] in params:
        return None
    return [known for known in params if known.endswith(f".{name}")]


def feature(name: str, contacts: Mapping[str, int]) -> Feature:
    """A feature by name: ``contact.peak``, ``contact_3.peak`` of one member, ``first:second.delay`` of a pair.

    Without a member's number, of a contact with members (``contacts``: their number, or 0), ``peak`` is the largest member's, a
    life the least's, and the other features are the members' mean; a delay between contacts of unlike numbers is that of the
    first members. ``InputError`` for what is not known, with the nearest that is.
    """
    place, _, kind = name.rpartition(".")
    if kind_unit(kind) is None or not place:
        found = f"no feature '{kind}'" if place else f"'{name}' is not <contact>.<feature>"
        raise InputError(f"feature '{name}'", found, nearest_kind(kind))
    parts = tuple(place.split(":"))
    if len(parts) != (2 if kind == PAIR else 1):
        right = f"write <first>:<second>.{kind}" if kind == PAIR else f"write <contact>.{kind}"
        raise InputError(f"feature '{name}'", f"of {len(parts)} contact(s)", right)
    known = [*contacts, *(f"{c}_{k + 1}" for c, members in contacts.items() for k in range(members))]
    for part in parts:
        if part not in known:
            raise InputError(f"feature '{name}'", f"no contact '{part}'", nearest(part, known))
        if event(kind) and is_reading(part):
            raise InputError(f"feature '{name}'", f"'{part}' is a reading", "name a contact, such as contact.begin_1")
    # What is of a reading of the contact, which ``observing`` shows in a contact's place.
    return Feature(name, kind, tuple(f"{part}.{READ_BY[kind]}" for part in parts) if kind in READ_BY else parts)


def default_features(contacts: Mapping[str, int]) -> list[Feature]:
    """Every feature of every contact, members taken together; of a reading in a contact's place its size and mean."""
    kinds = {contact: OF_READING if is_reading(contact) else DEFAULT for contact in contacts}
    return [Feature(f"{contact}.{kind}", kind, (contact,)) for contact in contacts for kind in kinds[contact]]


def members(place: str, contacts: Mapping[str, int]) -> list[str]:
    """The channels a place in a feature's name stands for: seat_ball -> seat_ball_1 .. seat_ball_6."""
    return [f"{place}_{k + 1}" for k in range(contacts[place])] if contacts.get(place) else [place]


def derivative_unit(unit: str, parameter_unit: str) -> str:
    """Unit of a derivative: ("N", "kg") -> "N/kg", ("N", "N/m^n") -> "N/(N/m^n)"."""
    if parameter_unit == "1":
        return unit
    plain = parameter_unit.replace("^", "").isalnum()
    return f"{unit}/{parameter_unit}" if plain else f"{unit}/({parameter_unit})"
