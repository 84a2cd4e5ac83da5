"""From options of the scene ``joint`` to its structure: what each option switches in, and which do not go together."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from bcfj_jax.contact import laws as normal_laws
from bcfj_jax.core import limits, quantities
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.models.joint import programmes
from bcfj_jax.models.joint.options import JointMaterials, JointOptions
from bcfj_jax.models.joint.scene import (
    AUTO,
    CAGES,
    CONTACTS,
    DRIVES,
    FIDELITIES,
    GEOMETRY,
    GROOVES,
    HEADS,
    OF_A_BALL,
    PILOTS,
    STIFFNESSES,
    TRACKS,
    USUAL,
    WINDOW_END,
    JointContact,
)

WHERE = "scene 'joint'"


def structure(options: JointOptions) -> dict[str, Any]:
    """Fields of ``scene.Joint``; InputError for a name that is not known, and for contacts that do not make a joint."""
    geometry, cage, drive = options.geometry, options.cage, options.drive
    for name, value, choices in (
        ("track", geometry.track, TRACKS), ("head", geometry.head, HEADS), ("cage", cage.cage, CAGES),
        ("drive", drive.drive, DRIVES), ("fidelity", options.fidelity, (*FIDELITIES, AUTO)),
        ("stiffness", options.materials.stiffness, STIFFNESSES),
    ):  # fmt: skip
        if value not in choices:
            raise InputError(f"{WHERE} {name}", f"no {name} {quoted(value)}", nearest(str(value), choices))
    balls = quantities.whole(f"{WHERE} balls", geometry.balls, least=0)
    if not 3 <= balls <= limits.MEMBERS:
        remedy = f"give a whole number from 3 to {limits.MEMBERS}: a joint has 3 or more"
        raise InputError(f"{WHERE} balls", f"{balls} balls", remedy)
    names = _names(options)
    _check_single(options.materials, names)
    _check_contacts(options, names)
    over_time = programmes.made(WHERE, drive, options.loads)
    if not over_time.usual and options.fidelity != "dynamic":
        found = f"'{options.fidelity}' with a drive or a load over time"
        raise InputError(f"{WHERE} fidelity", found, "give fidelity = 'dynamic'")
    if over_time.drive is not None and cage.cage == "fixed":
        found = f"'{drive.drive_profile}' with a fixed cage, which turns evenly"
        raise InputError(f"{WHERE} drive_profile", found, "give cage = 'free'")
    contacts = tuple(_contact(options.materials, name) for name in CONTACTS if name in names)
    rubs = {contact.name: contact.friction for contact in contacts if contact.friction}
    of_balls = [rubs[name] for name in OF_A_BALL if name in rubs]
    rolls = bool(of_balls) and not any(law.bristles or law.lags for law in of_balls)
    ends = not any(rubs[name].bristles for name in PILOTS if name in rubs)
    return {
        "contacts": contacts, "balls": balls, "track": geometry.track, "unequal": geometry.unequal,
        "spin": rolls if geometry.spin is None else geometry.spin, "cage": cage.cage,
        "bands": ends if cage.bands is None else cage.bands, "head": geometry.head, "drive": drive.drive,
        "smoothing": options.materials.smoothing, "fidelity": options.fidelity, "programmes": over_time,
    }  # fmt: skip


def _names(options: JointOptions) -> tuple[str, ...]:
    """Contacts that there are. Who lists them has listed those of the windows."""
    listed, cage = options.materials.contacts, options.cage
    names = tuple(listed) if listed is not None else USUAL[1:] if cage.cage == "fixed" else USUAL
    ends = listed is None if cage.window_ends is None else cage.window_ends
    if ends and cage.cage == "free" and "cage_ball" in names and WINDOW_END not in names:
        return (*names, WINDOW_END)
    return names


def _contact(materials: JointMaterials, name: str) -> JointContact:
    def own(table: str, shared: Any) -> Any:
        return (getattr(materials, table) or {}).get(name, shared)

    law = normal_laws.make(own("laws", materials.law), own("elastics", materials.elastic))
    friction = normal_laws.make_friction(own("frictions", materials.friction))
    return JointContact(name, law, friction, own("stiffnesses", materials.stiffness) == GEOMETRY)


def _check_single(materials: JointMaterials, names: tuple[str, ...]) -> None:
    """Refuse contacts, and laws of single contacts, that are not known."""
    known: dict[str, tuple[str, Collection[str]]] = {
        "laws": ("law", normal_laws.LAWS), "elastics": ("elastic part", normal_laws.ELASTIC),
        "stiffnesses": ("stiffness", STIFFNESSES),
    }  # fmt: skip
    tables = {what: getattr(materials, what) or {} for what in ("laws", "frictions", "elastics", "stiffnesses")}
    for what, group in {"contacts": names, **tables}.items():
        for name in group:
            if name not in CONTACTS:
                raise InputError(f"{WHERE} {what}", f"no contact '{name}'", nearest(name, CONTACTS))
            if name not in names:
                found = f"'{name}' is not among the contacts"
                raise InputError(f"{WHERE} {what}", found, f"there are {', '.join(names)}")
    for what, (one, choices) in known.items():
        for name, value in tables[what].items():
            if value not in choices:
                raise InputError(f"{WHERE} {what}", f"{name}: no {one} {quoted(value)}", nearest(value, choices))


def _check_contacts(options: JointOptions, names: tuple[str, ...]) -> None:
    """Refuse contacts that do not make a joint."""
    fixed = options.cage.cage == "fixed"
    found = {
        f"without {name}": "give it: balls need both tracks to carry torque" for name in GROOVES if name not in names
    }
    if fixed and "seat_cage" in names:
        found["seat_cage with a fixed cage"] = "remove it: seat and fixed cage never touch"
    if fixed and WINDOW_END in names:
        remedy = f"remove {WINDOW_END}: a fixed cage turns as the drive does"
        found[f"{WINDOW_END} with a fixed cage"] = remedy
    if WINDOW_END in names and "cage_ball" not in names:
        found[f"{WINDOW_END} without cage_ball"] = "add cage_ball: a window that has ends has faces"
    if options.fidelity == "quasistatic" and not fixed and not set(PILOTS) & set(names):
        remedy = f"add {' or '.join(PILOTS)}, or give cage = 'fixed'"
        found["only the windows hold the free cage, so it has no equilibrium"] = remedy
    for wrong, remedy in found.items():
        raise InputError(f"{WHERE} contacts", wrong, remedy)
