"""What a verb is given, checked once: a model, and the values of its parameters. Files and Python meet here.

Concrete values are looked at: name, unit, type, shape, range. Traced values pass, so that jit, vmap and grad pay nothing
when they run. What comes out is a table of float64 scalars, whatever went in: programs are kept by shapes and types, so
the same numbers in another type would be another program.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.quantities import CATALOGUE, Quantity, check_order, number
from bcfj_jax.mechanism.arrays import expanded


class Described(Protocol):
    """What is read of a model here; ``AbstractModel`` is one, and tells what each is."""

    if TYPE_CHECKING:

        @property
        def kind(self) -> str: ...
        @property
        def title(self) -> str: ...
        @property
        def quantities(self) -> dict[str, Quantity]: ...
        @property
        def defaults(self) -> tuple[tuple[str, Any], ...]: ...
        def canonical(self, name: str) -> str: ...
        def require(self, params: Mapping[str, Array], where: str = "") -> None: ...


def named(scene: Described, given: Any, where: str) -> dict[str, Any]:
    """Values by the scene's own names of parameters; of two names of one parameter the last counts."""
    if not isinstance(given, Mapping):
        raise InputError(where, f"{quoted(given)} is no table of parameters", "give scene.parameters(...)")
    # Once: an equinox module makes a method anew each time that it is asked for.
    known, canonical, found = scene.quantities, scene.canonical, {}
    for key, value in expanded(where, given).items():
        name = canonical(key) if isinstance(key, str) else key
        if not isinstance(name, str) or name not in known:
            # A right name in the wrong place is no misspelling: the law, or another option, does not read it.
            hint = f"known here: {', '.join(sorted(known))}" if name in CATALOGUE else nearest(key, known)
            found_here = f"{scene.title} with these options has no parameter {quoted(key)} (= {quoted(value)})"
            raise InputError(where, found_here, hint)
        found[name] = value
    return found


def exponents_first(name: str) -> bool:
    """Order in which values are read: the unit of a stiffness depends on the exponent."""
    return not name.endswith("exponent")


def exponent(scene: Described, name: str, *tables: Mapping[str, Any]) -> float | None:
    """The exponent that goes with a parameter, from the first table that has it: its contact's, or the shared one; else 1.

    None where it is traced, or one of many: then the unit itself says it.
    """
    contact = name.rpartition(".")[0]
    own = f"{contact}.exponent" if contact else "exponent"
    if own not in scene.quantities:
        return 1.0
    found = (table[key] for key in dict.fromkeys((own, "exponent")) for table in tables if key in table)
    value = next(found, 1.0)
    return None if is_traced(value) or np.ndim(value) else float(value)


def values(scene: Described, given: Any, where: str = "") -> dict[str, Any]:
    """Values of some of the scene's parameters: float64, SI, each in its range; arrays stand for a batch.

    ``given`` has by name numbers, arrays, traced values, or texts with a unit such as "20 um".
    """
    where = where or f"scene '{scene.kind}'"
    by_name, defaults, found = named(scene, given, where), dict(scene.defaults), {}
    known: Mapping[str, Quantity] = scene.quantities
    for name in sorted(by_name, key=exponents_first):
        power = exponent(scene, name, found, defaults) if isinstance(by_name[name], str) else None
        found[name] = number(where, known[name], by_name[name], power)
        shape = known[name].shape
        if shape and np.shape(found[name])[-len(shape) :] != shape:
            raise _misshapen(where, name, np.shape(found[name]), f"give an array of shape {shape}")
    check_order(where, known, {**defaults, **found})
    return {name: found[name] for name in by_name}


def parameters(scene: Described, given: Any, where: str = "", traced: bool = True) -> dict[str, Array]:
    """All parameters of one run: ``values``, each a scalar, and none missing; ``traced``: whether traced values pass."""
    where = where or f"scene '{scene.kind}'"
    found = values(scene, given, where)
    known: Mapping[str, Quantity] = scene.quantities
    for name, value in found.items():
        if np.shape(value) != known[name].shape:
            right = f"an array of shape {known[name].shape}" if known[name].shape else "one number"
            many = f"give {right}; many runs are bj.study, or jax.vmap of bj.force_history"
            raise _misshapen(where, name, np.shape(value), many)
        if is_traced(value) and not traced:
            remedy = "call this outside of jit, grad and vmap; bj.force_history and bj.reading_history go through them"
            raise InputError(where, f"{name} is traced", remedy)
    scene.require(found, where)
    return found


def poison(scene: Described, given: Mapping[str, Array]) -> ArrayLike:
    """What the values of one run and all that comes of them are multiplied by: NaN where a traced one is out of range, else 1.

    Under jit and vmap nothing can be refused. A run whose parameters are not finite ends in some twenty attempts.
    """
    known: Mapping[str, Quantity] = scene.quantities
    inside = [jnp.all(known[name].valid(value)) for name, value in given.items() if is_traced(value)]
    return jnp.where(jnp.all(jnp.stack(inside)), 1.0, jnp.nan) if inside else 1.0


def _misshapen(where: str, name: str, shape: tuple[int, ...], remedy: str) -> InputError:
    return InputError(where, f"{name} has shape {shape}", remedy)


def require_defaults(scene: Described, given: Mapping[str, Any], where: str) -> None:
    """Refuse parameters among which one with a default has no value, neither its own nor the shared one."""
    for name in dict(scene.defaults):
        shared = name.rpartition(".")[2]
        readers = [key for key in scene.quantities if key.endswith(f".{name}")]
        if name in given or (shared != name and shared in given) or (readers and all(key in given for key in readers)):
            continue
        remedy = "scene.parameters() has every default; change it by {**params, name: value}"
        raise InputError(where, f"the parameter '{name}' has no value", remedy)


def merged(values: Any, more: Mapping[str, Any]) -> dict[str, Any]:
    """Two tables as one; the second counts."""
    if values is not None and not isinstance(values, Mapping):
        remedy = 'give a table by names, or names: scene.parameters({"contact.mass": 1.0}), scene.parameters(mass=1.0)'
        raise InputError("parameters", f"{quoted(values)} is no table", remedy)
    return {**(values or {}), **more}
