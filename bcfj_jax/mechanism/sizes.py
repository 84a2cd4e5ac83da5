"""How a part of a mechanism names its numbers: as a number, as another parameter's name, or as a function.

0.05            a parameter of the part's own, ``<part>.<key>``, with this default
"rod_length"    the parameter of that name; "-rod_length" is its negative
a function      of all parameters (SI), in Python only
None            ``<part>.<key>`` where the parameters have it, else the shared ``<key>``
0 (a length)    zero, which is no parameter and leaves the program

A number may be of any library, and a row of numbers any sequence or array: ``plain`` makes them Python's, once.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from numbers import Real
from typing import Any

import equinox as eqx
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps.base import direction as unit_direction
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.mechanism.arrays import refuse_traced

Params = Mapping[str, Array]
Size = float | int | str | Callable[[Params], Any] | None
Place = tuple[Size, Size, Size]
# By name what parameters are, with their defaults.
Parameters = dict[str, tuple[Quantity, Any]]

ORIGIN: Place = (0.0, 0.0, 0.0)
GROUND = "ground"
_POSITIVE = {"mass", "inertia", "inertia_x", "inertia_y", "inertia_z"}


def plain(where: str, given: Any) -> Any:
    """What was given as a size or several: Python's numbers and tuples; names, functions and None stay."""
    refuse_traced(where, given)
    return _plain(where, given)


def _plain(where: str, given: Any) -> Any:
    if isinstance(given, str) and given.lstrip("+-.")[:1].isdigit():
        raise InputError(where, f"{quoted(given)} is no name of a parameter", _FIELDS[Size][1])
    if given is None or isinstance(given, (str, bool)) or callable(given):
        return given
    if isinstance(given, (list, tuple)) or np.ndim(given):
        return tuple(_plain(where, one) for one in given)
    if isinstance(given, int):
        return given
    try:
        return float(given)
    except (TypeError, ValueError):
        remedy = "give a number in SI units, the name of a parameter, or a function of the parameters"
        raise InputError(where, f"{quoted(given)} is no number", remedy) from None


def field(where: str, **more: Any) -> Any:
    """A static field of a part that is a size, or several; ``where`` is its name in messages."""
    return eqx.field(static=True, converter=partial(plain, where), metadata={"size": True}, **more)


def checked_name(what: str, name: Any) -> str:
    """Where a part stands, for messages, once its name is a word."""
    where = f"{what} {quoted(name)}"
    if not isinstance(name, str) or not name.isidentifier() or name == GROUND:
        remedy = f"give a word of letters, digits and '_', other than '{GROUND}'"
        raise InputError(where, f"is not a valid name of a {what}", remedy)
    return where


def items(where: str, given: Any) -> tuple[tuple[str, Size], ...]:
    """Sizes by name, as ``plain``."""
    return tuple((key, plain(f"{where} {key}", size)) for key, size in by_name(where, given))


def by_name(where: str, given: Any) -> list[tuple[str, Any]]:
    """What was given by names: a table of Python's, or pairs."""
    found = given.items() if isinstance(given, Mapping) else given
    pairs: list[Any] = list(found) if isinstance(found, Iterable) and not isinstance(found, str) else [found]
    if not all(isinstance(one, tuple) and len(one) == 2 and isinstance(one[0], str) for one in pairs):
        raise InputError(where, f"{quoted(given)} is no table by names", 'give values by names: {"name": value}')
    return pairs


def pair(given: Any) -> tuple[Any, ...]:
    """Two names as a tuple; what is none stays one thing, for ``check_fields``."""
    return tuple(given) if isinstance(given, (list, tuple)) else (given,)


def parts(what: str, kind: type[Any], given: Any) -> tuple[Any, ...]:
    """The bodies, contacts or loads of a mechanism, from any sequence of them."""
    where, remedy = f"mechanism {what}", 'give bj.Mechanism("name", [bodies], [contacts], [loads])'
    if not isinstance(given, Iterable) or isinstance(given, (str, Mapping)):
        raise InputError(where, f"{quoted(given)} is no list", remedy)
    found = tuple(given)
    for one in found:
        if not isinstance(one, kind):
            raise InputError(where, f"{quoted(one)} is no {kind.__name__.lower()}", remedy)
    return found


def _is_size(x: Any) -> bool:
    return x is None or callable(x) or (isinstance(x, (int, float, str)) and not isinstance(x, bool))


def _is_place(x: Any) -> bool:
    return isinstance(x, tuple) and len(x) == 3 and all(map(_is_size, x))


_BOOL = (bool, np.bool_)
# By the annotation of a part's field, as it is or as a text: what may stand there, and what to give.
_FIELDS: dict[Any, tuple[Callable[[Any], bool], str]] = {
    Size: (_is_size, "give a number in SI units, the name of a parameter, or a function of the parameters"),
    Place: (_is_place, "give three numbers [m] or names of parameters: (0.0, 0.0, 0.01)"),
    tuple[Place, Place]: (
        lambda x: isinstance(x, tuple) and len(x) == 2 and all(map(_is_place, x)),
        "give a place in each body's axes: ((0.0, 0.0, 0.0), (0.0, 0.0, 0.01))",
    ),
    tuple[str, str]: (
        lambda x: len(x) == 2 and all(isinstance(one, str) for one in x), "give the names of two bodies",
    ),
    str: (lambda x: isinstance(x, str), "give a text"),
    bool: (lambda x: isinstance(x, _BOOL), "give True or False"),
    float | None: (lambda x: x is None or (isinstance(x, Real) and not isinstance(x, bool)), "give a number, or None"),
    bool | None: (lambda x: x is None or isinstance(x, _BOOL), "give True, False or None"),
}  # fmt: skip
_NAMED = {"Size": Size, "Place": Place, "tuple[Place, Place]": tuple[Place, Place], "tuple[str, str]": tuple[str, str]}
_NAMED |= {"str": str, "bool": bool, "bool | None": bool | None, "float | None": float | None}


def check_fields(where: str, part: Any) -> None:
    """Refuse a field of a part that cannot be what its annotation says."""
    for one in dataclasses.fields(part):
        value, kind, place = getattr(part, one.name), str(one.type), f"{where} {one.name}"
        fits, remedy = _FIELDS.get(_NAMED.get(kind, one.type), (lambda x: True, ""))
        if kind.startswith(("Callable[", "collections.abc.Callable[")):
            fits, remedy = lambda x, kind=kind: callable(x) or (x is None and "None" in kind), "give a function"
        if not fits(value):
            named = [x.name for x in (value if isinstance(value, tuple) else (value,)) if hasattr(x, "name")]
            raise InputError(place, quoted(value), f"give its name, '{named[0]}'" if named else remedy)
        if one.name == "direction":
            axis(value, place)


def check_read(where: str, part: Any, kind: str, names: Iterable[str], remedy: str) -> None:
    """Refuse fields of a part that its kind does not read, where they are given."""
    for one in dataclasses.fields(part):
        if one.name in names and getattr(part, one.name) != one.default:
            raise InputError(f"{where} {one.name}", f"{kind} has no {one.name}", remedy)


def given(part: Any) -> list[Any]:
    """What a part has in its fields that are sizes."""
    return [getattr(part, f.name) for f in dataclasses.fields(part) if "size" in f.metadata]


def length(size: Size, part: str, key: str, p: Params) -> Any:
    """Value of a size of which a literal zero is no parameter."""
    return 0.0 if nothing(size) else value(size, part, key, p)


def value(size: Size, part: str, key: str, p: Params) -> Any:
    """Value of a size (module docstring)."""
    if size is None:
        own = f"{part}.{key}"
        return p[own] if own in p else p[key]
    if isinstance(size, str):
        return -p[size[1:]] if size.startswith("-") else p[size]
    if callable(size):
        return size(p)
    return p[f"{part}.{key}"]


def point(place: Place, part: str, key: str, p: Params) -> tuple[Any, Any, Any]:
    """Values of three lengths, ``<part>.<key>_x`` and so on."""
    x, y, z = (length(size, part, f"{key}_{letter}", p) for letter, size in zip("xyz", place, strict=True))
    return x, y, z


def of_point(place: Place, part: str, key: str, meaning: str, unit: str = "m") -> Parameters:
    """The parameters that three lengths are, or others of a ``unit``; ``meaning`` has {} for the letter, "" for their names."""
    found: Parameters = {}
    for letter, size in zip("xyz", place, strict=True):
        found |= stated(size, part, f"{key}_{letter}", unit, meaning.format(letter))
    return found


def several(size: Any, part: str, key: str, p: Params) -> Any:
    """Value of a size that is one number, or three along axes: ``<part>.<key>_x`` and so on."""
    return point(size, part, key, p) if isinstance(size, tuple) else length(size, part, key, p)


def of_several(size: Any, part: str, key: str, unit: str) -> Parameters:
    """The parameters that it is."""
    if not isinstance(size, tuple):
        return stated(size, part, key, unit)
    if len(size) != 3:
        raise InputError(
            f"{part} {key}", f"{len(size)} numbers", "give one number, or three along the first body's axes"
        )
    return of_point(size, part, key, "", unit)


def values(part: Any, keys: Iterable[str], p: Params) -> list[Any]:
    """``several`` of the fields of a part that are named."""
    return [several(getattr(part, key), part.name, key, p) for key in keys]


def parameters(part: Any, units: Mapping[str, str]) -> Parameters:
    """``of_several`` of the fields of a part that are named, with their units."""
    found: Parameters = {}
    for key, unit in units.items():
        found |= of_several(getattr(part, key), part.name, key, unit)
    return found


def coordinate(turns: bool) -> tuple[str, str]:
    """Units of a force on a joint's coordinate and of the coordinate, an angle where it turns."""
    return ("N m", "rad") if turns else ("N", "m")


def nothing(size: Any) -> bool:
    """Whether a size is the number 0, which is no parameter."""
    return isinstance(size, (int, float)) and not isinstance(size, bool) and size == 0


def own(size: Size, part: str, key: str, unit: str, meaning: str) -> Parameters:
    """The parameter that a size is by itself, with its default; nothing for a name, a function or a zero length."""
    if isinstance(size, str) or callable(size):
        return {}
    name = f"{part}.{key}"
    low = 0.0 if key in _POSITIVE else float("-inf")
    quantity = Quantity(name, unit, meaning, low=low, open_low=key in _POSITIVE)
    if size is None:
        # The shared one beside it: of the same meaning, for every part.
        shared = CATALOGUE.get(key) or Quantity(key, unit, f"{meaning.split(' of ')[0]}, of every part without its own")
        return {key: (shared, None), name: (quantity, None)}
    return {name: (quantity, float(size))}


def stated(size: Size, part: str, key: str, unit: str, meaning: str = "") -> Parameters:
    """``own``, by default under its own name; nothing of a 0."""
    return {} if nothing(size) else own(size, part, key, unit, meaning or f"{key.replace('_', ' ')} of {part}")


def axis(direction: Any, where: str) -> Any:
    """A unit vector from "x", "-y" or three numbers, as Python floats; a function is kept."""
    return direction if callable(direction) else unit_direction(plain(where, direction), where)
