"""Parts that hold arrays: a spline or a network as law, friction or load becomes static structure and parameters.

A scene is static, so that one program serves all values. The arrays of a part are therefore taken out of it where it is
put into a scene: in the structure a ``Held`` stands for each, and the array is a parameter with a shape, of which it is
the default. Its name is that of the part and the path of the array in it: ``wall.law.knots``,
``wall.friction.layers.0.weight``, ``wind.net.bias``. Where the part is evaluated, it is filled with the parameters.
Only arrays of floating-point numbers are parameters; others stay as they are.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.friction import AbstractFriction
from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.contact.part import Part, of
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.quantities import Quantity

P = TypeVar("P")
Values = Mapping[str, Any]


@jax.tree_util.register_static
class Held:
    """An array as static structure: equal where path and numbers are.

    Attributes:
        key: path in the part; value: the array, read-only.
    """

    def __init__(self, key: str, value: Any) -> None:
        self.key, self.value = key, np.array(value)
        self.value.setflags(write=False)
        digest = hashlib.sha256(np.ascontiguousarray(self.value).tobytes()).digest()
        self._what = (key, self.value.shape, str(self.value.dtype), digest)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Held) and self._what == other._what

    def __hash__(self) -> int:
        return hash(self._what)

    def __repr__(self) -> str:
        return f"Held({self.key!r}, {self._what[2]}{list(self.value.shape)})"

    @property
    def varies(self) -> bool:
        """Whether it is a parameter."""
        return np.issubdtype(self.value.dtype, np.floating)


def _is_array(x: Any) -> bool:
    return isinstance(x, (np.ndarray, Array))


def _is_held(x: Any) -> bool:
    return isinstance(x, Held)


def path_of(path: Any) -> str:
    """A path in a pytree as a name: "layers.0.weight"."""
    return jax.tree_util.keystr(path, simple=True, separator=".")


def taken(where: str, part: P) -> P:
    """A part whose arrays are ``Held``; the part itself where it has none."""
    refuse_traced(where, part)
    if not any(map(_is_array, jax.tree.leaves(part))):
        return part
    hold = lambda path, x: Held(path_of(path), x) if _is_array(x) else x  # noqa: E731
    return jax.tree_util.tree_map_with_path(hold, part)


def filled(part: P, values: Values, prefix: str) -> P:
    """The part with its arrays, from values by name."""
    full = lambda x: (values[prefix + x.key] if x.varies else jnp.asarray(x.value)) if _is_held(x) else x  # noqa: E731
    return jax.tree.map(full, part, is_leaf=_is_held)


def held(part: Any) -> dict[str, Held]:
    """The arrays of a part that are parameters, by path."""
    found = filter(_is_held, jax.tree.leaves(part, is_leaf=_is_held))
    return {x.key: x for x in found if x.varies}


def own_quantities(part: Any) -> Mapping[str, Quantity]:
    """What a law, and its elastic part, say of coefficients of their own."""
    return {**getattr(getattr(part, "elastic", None), "quantities", {}), **getattr(part, "quantities", {})}


def _described(part: Any, prefix: str) -> dict[str, Quantity]:
    """What its arrays are: as the part's own ``quantities`` say by path, else numbers without a unit."""
    told = own_quantities(part) if isinstance(part, Part) else {}
    return {
        prefix + key: told.get(key, Quantity(key, "1", f"array {key} of {type(part).__name__}"))._replace(
            name=prefix + key, shape=x.value.shape
        )
        for key, x in held(part).items()
    }


class _Filled:
    """What law and friction with arrays have in common; the arrays are coefficients whose names have a dot."""

    part: eqx.AbstractVar[Any]
    prefix: eqx.AbstractClassVar[str]

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.part.needs, *(self.prefix + key for key in held(self.part)))

    @property
    def quantities(self) -> dict[str, Quantity]:
        return {**own_quantities(self.part), **_described(self.part, self.prefix)}

    @property
    def arrays(self) -> dict[str, Held]:
        """The arrays by the names of their coefficients."""
        return {self.prefix + key: x for key, x in held(self.part).items()}


def _filling(name: str) -> Any:
    """A method of the part, filled with the coefficients, which are the last argument."""
    return lambda self, *args: getattr(filled(self.part, args[-1], self.prefix), name)(*args)


class HeldLaw(_Filled, AbstractLaw):
    """A normal-force law with arrays."""

    part: AbstractLaw
    prefix = "law."
    states = of("part", "states")
    force, rates, sizes, stored = map(_filling, ("force", "rates", "sizes", "stored"))


class HeldFriction(_Filled, AbstractFriction):
    """A friction law with arrays."""

    part: AbstractFriction
    prefix = "friction."
    bristles, lags, span = map(partial(of, "part"), ("bristles", "lags", "span"))
    mobility, bond, lag, reach = map(_filling, ("mobility", "bond", "lag", "reach"))


def kept(where: str, part: Any, holder: Callable[..., Any]) -> Any:
    """A part as a scene keeps it: in a ``holder`` where it has arrays."""
    found = taken(where, part)
    return part if found is part else holder(part=found)


def defaults(*parts: Any) -> dict[str, np.ndarray]:
    """Default values of the coefficients of laws that are arrays."""
    return {name: x.value for part in parts for name, x in getattr(part, "arrays", {}).items()}


def of_load(load: Any) -> dict[str, tuple[Quantity, Any]]:
    """The parameters that the arrays of a load are, with their defaults."""
    arrays, prefix = held(load), f"{load.name}."
    return {name: (q, arrays[name.removeprefix(prefix)].value) for name, q in _described(load, prefix).items()}


def expanded(where: str, given: Mapping[Any, Any]) -> dict[Any, Any]:
    """Values by name, in which a module stands for its arrays: {"wall.law": law} for {"wall.law.knots": ...}."""
    found: dict[Any, Any] = {}
    for name, value in given.items():
        if not isinstance(value, eqx.Module):
            found[name] = value
            continue
        leaves = [(path, x) for path, x in jax.tree_util.tree_leaves_with_path(value) if _is_array(x)]
        arrays = {f"{name}.{path_of(path)}": x for path, x in leaves if jnp.issubdtype(x.dtype, jnp.floating)}
        if not arrays:
            raise InputError(where, f"{name} = {quoted(value)} holds no array", "give its numbers by their names")
        found |= arrays
    return found


def number(where: str, value: Any) -> Any:
    """A default value: a ``float``, or an array as ``Held``."""
    if isinstance(value, Held):
        return value
    refuse_traced(where, value)
    try:
        return Held("", np.asarray(value, dtype=float)) if np.ndim(value) else float(value)
    except (TypeError, ValueError):
        raise InputError(where, f"{quoted(value)} is no number", "give a number in SI units") from None


def plain(value: Any) -> Any:
    """A default value as it goes into parameters: the array of what is held."""
    return value.value if isinstance(value, Held) else value


def refuse_traced(where: str, part: Any) -> None:
    """Refuse structure with traced values in it: in its fields, or closed over by its functions."""
    if _traced(part, set()):
        remedy = (
            "a scene is made of plain numbers, outside of jit, grad and vmap; pass the values as parameters: "
            'bj.force_history(scene, {**params, "ball.mass": mass}, times); arrays of a module by '
            'scene.parameters({"wall.law": law})'
        )
        raise InputError(where, "a traced value is part of it", remedy)


def _traced(x: Any, seen: set[int]) -> bool:
    if is_traced(x):
        return True
    if id(x) in seen or isinstance(x, (str, bytes, int, float, type(None), np.ndarray, Array, type, Held)):
        return False
    seen.add(id(x))
    inner: Any = ()
    if isinstance(x, (tuple, list, set, frozenset)):
        inner = x
    elif isinstance(x, Mapping):
        inner = x.values()
    elif isinstance(x, partial):
        inner = (x.func, x.args, x.keywords)
    elif isinstance(x, types.MethodType):
        inner = (x.__self__,)
    elif isinstance(x, types.FunctionType):
        inner = [*(cell.cell_contents for cell in x.__closure__ or () if _full(cell)), x.__defaults__]
    elif isinstance(x, eqx.Module):
        inner = vars(x).values()
    return any(_traced(one, seen) for one in inner)


def _full(cell: types.CellType) -> bool:
    try:
        return cell.cell_contents is not None
    except ValueError:
        return False


def leaf(value: ArrayLike) -> Array:
    """A value of a parameter in float64; of a plain number nothing is compiled, so that bad ones are refused at once."""
    if isinstance(value, (int, float, np.ndarray, np.generic)):
        return jax.device_put(np.asarray(value, dtype=np.float64))
    return jnp.asarray(value, dtype=jnp.float64)
