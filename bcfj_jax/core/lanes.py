"""A function of one lane, evaluated for many: lanes are the last axis, and vectors are taken apart into components.

``jax.vmap`` puts the batch first and keeps the arrays of the function as they are: vectors (..., 3), matrices (..., 3, 3),
sums and products of matrices over short axes. XLA then makes kernels whose innermost loop has length 3, and none is
vectorised. Here every operation of the traced function is written anew. Lanes are the last, contiguous axis. Axes of
length 3, and those that are put together from such, are not axes of an array any more but components by name: cross
products, slices, stacks and transposes cost nothing, sums are written out, and a known 0 or 1 (of a unit matrix, of a
vector along an axis) leaves the program. The function stays as it is written for one lane; each formula stands once.

What is not known here (a factorisation by LAPACK, a sort) goes through ``vmap``, right and as slow as there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend import core

# Length of axes that are taken apart.
VECTOR = 3
# Longest sum that is written out.
SHORT = 40

Piece = Any  # Array with the lanes last | a number that is the same everywhere
Shape = tuple[int, ...]


class Value:
    """An array of a traced function, for all lanes.

    Attributes:
        shape: as the function has it, without lanes.
        pieces: array of objects of as many axes. Along an axis that is taken apart it has an entry for each index, along
            any other one. An entry is a number, or an array with all axes and the lanes last, whose length along an axis
            is 1 where it is taken apart or where nothing changes along it.
        whole: which axes must not be taken apart.
    """

    __slots__ = ("pieces", "shape", "whole")

    def __init__(self, shape: Shape, pieces: np.ndarray, whole: tuple[bool, ...] | None = None) -> None:
        self.shape, self.pieces = shape, pieces
        self.whole = whole if whole is not None else (False,) * len(shape)


def lanes(function: Callable) -> Callable:
    """``function`` for arrays whose last axis is that of the lanes; results have them last, too. Values only."""

    def batched(*args: Any) -> Any:
        flat, tree = jax.tree.flatten(args)
        one = [jax.ShapeDtypeStruct(x.shape[:-1], x.dtype) for x in flat]
        closed, shape = jax.make_jaxpr(lambda *xs: function(*jax.tree.unflatten(tree, xs)), return_shape=True)(*one)
        found = evaluate(closed.jaxpr, closed.consts, [given(x) for x in flat], flat[0].shape[-1])
        return jax.tree.unflatten(jax.tree.structure(shape), found)

    def given(x: Array) -> Value:
        return apart(box(x.shape[:-1], x))

    def evaluate(jaxpr: Any, consts: Sequence[Any], args: Sequence[Value], size: int) -> list[Array]:
        kinds = [v.aval.dtype for v in jaxpr.outvars]
        return [
            jnp.broadcast_to(together(x, kind), (*x.shape, size))
            for x, kind in zip(evaluated(jaxpr, consts, args, size), kinds, strict=True)
        ]

    return batched


def members(x: Array, axis: int) -> Array:
    """``x``; its axis counts members of a kind, such as bodies, and is no vector's even where its length is 3."""
    return _MEMBERS.bind(x, axis=axis % x.ndim)


_MEMBERS = core.Primitive("members")
_MEMBERS.def_impl(lambda x, axis: x)
_MEMBERS.def_abstract_eval(lambda x, axis: x)
jax.interpreters.mlir.register_lowering(_MEMBERS, lambda context, x, axis: [x])
jax.interpreters.batching.primitive_batchers[_MEMBERS] = lambda xs, axes, axis: (
    _MEMBERS.bind(xs[0], axis=axis + (axes[0] <= axis)), axes[0]
)  # fmt: skip
jax.interpreters.ad.deflinear2(_MEMBERS, lambda ct, x, axis: [ct])


# -- values ------------------------------------------------------------------------------------------------------------


def box(shape: Shape, piece: Piece) -> Value:
    """One piece as a value."""
    pieces = np.empty((1,) * len(shape), object)
    pieces[(0,) * len(shape)] = piece
    return Value(shape, pieces)


def constant(x: Any) -> Value:
    """An array that is known, taken apart into numbers as far as may be."""
    x = np.asarray(x)
    return apart(box(x.shape, plain(x[..., None])))


def plain(x: np.ndarray) -> Piece:
    """A number in place of an array that is the same everywhere."""
    return x.flat[0] if x.size and (x == x.flat[0]).all() else x


def number(x: Piece) -> bool:
    """Whether a piece is a number."""
    return not np.ndim(x)


def along(x: Piece, axis: int) -> int:
    """Length of a piece along an axis."""
    return 1 if number(x) else x.shape[axis]


def new(shape: Iterable[int]) -> np.ndarray:
    return np.empty(tuple(shape), object)


def mapped(function: Callable[[Piece], Piece], pieces: np.ndarray) -> np.ndarray:
    """A function of each piece."""
    found = new(pieces.shape)
    for i, x in np.ndenumerate(pieces):
        found[i] = function(x)
    return found


def cut(x: Piece, axis: int, start: int, stop: int, step: int = 1) -> Piece:
    """A piece between two indices of an axis."""
    if along(x, axis) == 1:
        return x
    if isinstance(x, np.ndarray):
        return plain(x[(slice(None),) * axis + (slice(start, stop, step),)])
    return jax.lax.slice_in_dim(x, start, stop, step, axis)


def take(v: Value, axis: int) -> Value:
    """A value taken apart along an axis."""
    n = v.shape[axis]
    if v.pieces.shape[axis] == n:
        return v
    pieces = [mapped(lambda x, i=i: cut(x, axis, i, i + 1), v.pieces) for i in range(n)]
    return Value(v.shape, np.concatenate(pieces, axis), v.whole)


def apart(v: Value) -> Value:
    """A value taken apart along every axis that may be a vector's."""
    for axis, n in enumerate(v.shape):
        if n == VECTOR and not v.whole[axis]:
            v = take(v, axis)
    return v


def spread(x: Piece, shape: Shape, dtype: Any) -> Array:
    """A piece as an array of a shape."""
    if number(x):
        return jnp.full(shape, x, dtype)
    return x if x.shape == shape else jnp.broadcast_to(x, shape)


def common(pieces: Iterable[Piece]) -> Shape:
    return np.broadcast_shapes(*(np.shape(x) for x in pieces))


def joined(v: Value, axis: int, dtype: Any) -> Value:
    """A value put together along an axis."""
    n = v.shape[axis]
    if v.pieces.shape[axis] == 1:
        return v
    found = new(1 if i == axis else k for i, k in enumerate(v.pieces.shape))
    for i in np.ndindex(found.shape):
        row = list(v.pieces[i[:axis] + (slice(None),) + i[axis + 1 :]])
        if all(number(x) for x in row):
            whole = np.reshape(np.array(row), [n if k == axis else 1 for k in range(len(v.shape) + 1)])
            found[i] = plain(whole)
        elif all(x is row[0] for x in row):
            found[i] = row[0]
        else:
            shape = common(row)
            if len(shape) == 0:
                shape = (1,) * (len(v.shape) + 1)
            found[i] = jax.lax.concatenate([spread(x, shape, dtype) for x in row], axis)
    return Value(v.shape, found, v.whole)


def together(v: Value, dtype: Any) -> Array:
    """A value as one array, lanes last (one where nothing changes by lane)."""
    for axis in reversed(range(len(v.shape))):
        v = joined(v, axis, dtype)
    x = v.pieces[(0,) * len(v.shape)]
    return spread(x, (*v.shape, 1 if number(x) else x.shape[-1]), dtype)


def known_array(v: Value) -> np.ndarray:
    """A value of numbers as an array."""
    found = np.zeros(v.shape)
    for i, x in np.ndenumerate(v.pieces):
        box = tuple(slice(None) if n == 1 else slice(k, k + 1) for k, n in zip(i, v.pieces.shape, strict=True))
        found[box] = x if number(x) else x[..., 0]
    return found


def level(values: Sequence[Value], dtypes: Sequence[Any]) -> list[Value]:
    """Values of one shape, or scalars, taken apart along the same axes."""
    rank = max(len(v.shape) for v in values)
    shape = next(v.shape for v in values if len(v.shape) == rank)
    full = []
    for v in values:
        if len(v.shape) < rank:
            piece = v.pieces[()]
            piece = piece if number(piece) else piece.reshape(*[1] * rank, piece.shape[-1])
            v = box((1,) * rank, piece)
        full.append(v)
    whole = tuple(any(v.whole[i] for v in full) for i in range(rank))
    for axis in range(rank):
        if whole[axis]:
            full = [joined(v, axis, d) for v, d in zip(full, dtypes, strict=True)]
        elif any(v.pieces.shape[axis] > 1 for v in full):
            full = [v if v.shape[axis] == 1 else take(v, axis) for v in full]
    return [Value(shape, v.pieces, whole) for v in full]


# -- evaluation --------------------------------------------------------------------------------------------------------


def evaluated(jaxpr: Any, consts: Sequence[Any], args: Sequence[Value], size: int) -> list[Value]:
    """A jaxpr's results for so many lanes."""
    known: dict[Any, Value] = {}

    def read(atom: Any) -> Value:
        return constant(atom.val) if isinstance(atom, core.Literal) else known[atom]

    for var, x in zip(jaxpr.constvars, consts, strict=True):
        known[var] = constant(x) if not isinstance(x, jax.core.Tracer) else apart(box(x.shape, x[..., None]))
    known.update(zip(jaxpr.invars, args, strict=True))
    for eqn in jaxpr.eqns:
        found = operate(eqn, [read(x) for x in eqn.invars], size)
        known.update(zip(eqn.outvars, found, strict=True))
    return [read(x) for x in jaxpr.outvars]


def operate(eqn: Any, given: list[Value], size: int) -> list[Value]:
    """One operation."""
    name = eqn.primitive.name
    if name in INNER:
        inner = eqn.params[INNER[name]]
        jaxpr, consts = (inner.jaxpr, inner.consts) if hasattr(inner, "jaxpr") else (inner, [])
        return evaluated(jaxpr, consts, given[: len(jaxpr.invars)], size)
    if name in ELEMENTWISE:
        dtypes = [v.aval.dtype for v in eqn.invars]
        values = level(given, dtypes)
        shape = np.broadcast_shapes(*(v.pieces.shape for v in values))
        found, wide = new(shape), [np.broadcast_to(v.pieces, shape) for v in values]
        for i in np.ndindex(shape):
            found[i] = calculate(eqn, [x[i] for x in wide], dtypes)
        return [Value(eqn.outvars[0].aval.shape, found, values[0].whole)]
    if name in RULES:
        found = RULES[name](eqn, given, size)
        if found is not None:
            return found
    return slowly(eqn, given)


def calculate(eqn: Any, pieces: list[Piece], dtypes: Sequence[Any]) -> Piece:
    """An elementwise operation on pieces; known zeros and ones leave it."""
    name = eqn.primitive.name
    if all(not isinstance(x, Array) for x in pieces):
        shape = common(pieces)
        with jax.ensure_compile_time_eval():
            given = [jnp.asarray(np.broadcast_to(np.asarray(x, d), shape)) for x, d in zip(pieces, dtypes, strict=True)]
            return plain(np.asarray(eqn.primitive.bind(*given, **eqn.params))[()])
    if name in FOLDS and (found := FOLDS[name](*pieces)) is not None:
        return found
    shape = common(pieces)
    return eqn.primitive.bind(*(spread(x, shape, d) for x, d in zip(pieces, dtypes, strict=True)), **eqn.params)


def _is(x: Piece, value: float) -> bool:
    return number(x) and not isinstance(x, Array) and bool(x == value)


def _zero(x: Piece) -> Piece:
    return np.float64(0.0)


FOLDS: dict[str, Callable[..., Piece | None]] = {
    "add": lambda a, b: b if _is(a, 0.0) else a if _is(b, 0.0) else None,
    "add_any": lambda a, b: b if _is(a, 0.0) else a if _is(b, 0.0) else None,
    "sub": lambda a, b: a if _is(b, 0.0) else -b if _is(a, 0.0) else None,
    "mul": lambda a, b: (
        np.float64(0.0)
        if _is(a, 0.0) or _is(b, 0.0)
        else b if _is(a, 1.0) else a if _is(b, 1.0) else -b if _is(a, -1.0) else -a if _is(b, -1.0) else None
    ),
    "div": lambda a, b: np.float64(0.0) if _is(a, 0.0) else a if _is(b, 1.0) else None,
    "select_n": lambda which, *cases: (
        cases[int(which)] if number(which) and not isinstance(which, Array) else None
    ),
}  # fmt: skip


def slowly(eqn: Any, given: list[Value]) -> list[Value]:
    """Through JAX's own batching."""
    arrays = [together(v, var.aval.dtype) for v, var in zip(given, eqn.invars, strict=True)]
    axes = tuple(None if x.shape[-1] == 1 else x.ndim - 1 for x in arrays)
    arrays = [x[..., 0] if axis is None else x for x, axis in zip(arrays, axes, strict=True)]
    call = lambda *xs: eqn.primitive.bind(*xs, **eqn.params)  # noqa: E731
    if all(axis is None for axis in axes):
        found = call(*arrays)
        found = [x[..., None] for x in (found if eqn.primitive.multiple_results else [found])]
    else:
        found = jax.vmap(call, axes, -1)(*arrays)
        found = found if eqn.primitive.multiple_results else [found]
    return [apart(box(x.shape[:-1], x)) for x in found]


# -- rules -------------------------------------------------------------------------------------------------------------


def _broadcast(eqn: Any, given: list[Value], size: int) -> list[Value]:
    v, shape, dims = given[0], eqn.params["shape"], eqn.params["broadcast_dimensions"]
    outer, whole = [1] * len(shape), [False] * len(shape)
    for i, d in enumerate(dims):
        outer[d], whole[d] = v.pieces.shape[i], v.whole[i]

    def one(x: Piece) -> Piece:
        if number(x):
            return x
        sizes = [1] * len(shape)
        for i, d in enumerate(dims):
            sizes[d] = x.shape[i]
        return x.reshape(*sizes, x.shape[-1])

    return [Value(shape, mapped(one, v.pieces).reshape(outer), tuple(whole))]


def _reshape(eqn: Any, given: list[Value], size: int) -> list[Value]:
    v, shape, dtype = given[0], eqn.params["new_sizes"], eqn.invars[0].aval.dtype
    groups = _groups(v.shape, shape)
    kept = {old[0]: new[0] for old, new in groups if len(old) == len(new) == 1}
    for old, _ in groups:
        for axis in old:
            if axis not in kept:
                v = joined(v, axis, dtype)
    outer, whole = [1] * len(shape), [False] * len(shape)
    for a, b in kept.items():
        outer[b], whole[b] = v.pieces.shape[a], v.whole[a]

    def one(x: Piece) -> Piece:
        if number(x):
            return x
        sizes, full = [1] * len(shape), list(x.shape)
        for old, fresh in groups:
            if len(old) == len(fresh) == 1:
                sizes[fresh[0]] = x.shape[old[0]]
            elif any(x.shape[i] > 1 for i in old):
                for i in old:
                    full[i] = v.shape[i]
                for i in fresh:
                    sizes[i] = shape[i]
        return jnp.broadcast_to(x, full).reshape(*sizes, x.shape[-1])

    return [apart(Value(shape, mapped(one, v.pieces).reshape(outer), tuple(whole)))]


def _groups(old: Shape, fresh: Shape) -> list[tuple[list[int], list[int]]]:
    """Axes before and after that hold the same entries, the fewest together."""
    groups, i, j = [], 0, 0
    while i < len(old) or j < len(fresh):
        a, b = [], []
        x = y = 1
        if i < len(old):
            a.append(i)
            x *= old[i]
            i += 1
        if j < len(fresh):
            b.append(j)
            y *= fresh[j]
            j += 1
        while x != y:
            if x < y:
                x *= old[i]
                a.append(i)
                i += 1
            else:
                y *= fresh[j]
                b.append(j)
                j += 1
        groups.append((a, b))
    return groups


def _squeeze(eqn: Any, given: list[Value], size: int) -> list[Value]:
    v, gone = given[0], eqn.params["dimensions"]
    keep = [i for i in range(len(v.shape)) if i not in gone]
    one = lambda x: x if number(x) else x.reshape(*(x.shape[i] for i in keep), x.shape[-1])  # noqa: E731
    pieces = mapped(one, v.pieces).reshape([v.pieces.shape[i] for i in keep])
    return [Value(tuple(v.shape[i] for i in keep), pieces, tuple(v.whole[i] for i in keep))]


def _expand(eqn: Any, given: list[Value], size: int) -> list[Value]:
    shape, dims = eqn.outvars[0].aval.shape, eqn.params["dimensions"]
    return turned(given[0], shape, [i for i in range(len(shape)) if i not in dims])


def turned(v: Value, shape: Shape, dims: list[int]) -> list[Value]:
    outer, whole = [1] * len(shape), [False] * len(shape)
    for i, d in enumerate(dims):
        outer[d], whole[d] = v.pieces.shape[i], v.whole[i]

    def one(x: Piece) -> Piece:
        if number(x):
            return x
        sizes = [1] * len(shape)
        for i, d in enumerate(dims):
            sizes[d] = x.shape[i]
        return x.reshape(*sizes, x.shape[-1])

    return [Value(shape, mapped(one, v.pieces).reshape(outer), tuple(whole))]


def _transpose(eqn: Any, given: list[Value], size: int) -> list[Value]:
    v, order = given[0], eqn.params["permutation"]
    one = lambda x: x if number(x) else x.transpose(*order, len(order))  # noqa: E731
    return [Value(tuple(v.shape[i] for i in order), mapped(one, v.pieces).transpose(order), tuple(v.whole[i] for i in order))]


def sliced(v: Value, axis: int, start: int, stop: int, step: int = 1) -> Value:
    """Part of a value along an axis."""
    count = len(range(start, stop, step))
    shape = (*v.shape[:axis], count, *v.shape[axis + 1 :])
    if count == v.shape[axis]:
        return v
    if v.pieces.shape[axis] > 1:
        return Value(shape, v.pieces[(slice(None),) * axis + (slice(start, stop, step),)], v.whole)
    return Value(shape, mapped(lambda x: cut(x, axis, start, stop, step), v.pieces), v.whole)


def _slice(eqn: Any, given: list[Value], size: int) -> list[Value]:
    v, p = given[0], eqn.params
    steps = p["strides"] or (1,) * len(v.shape)
    for axis, (start, stop, step) in enumerate(zip(p["start_indices"], p["limit_indices"], steps, strict=True)):
        v = sliced(v, axis, start, stop, step)
    return [v]


def _dynamic_slice(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    v, *starts = given
    where = [x.pieces[()] for x in starts]
    if all(not isinstance(x, Array) for x in where):
        for axis, (start, n) in enumerate(zip(where, eqn.params["slice_sizes"], strict=True)):
            start = min(max(int(start), 0), v.shape[axis] - n)
            v = sliced(v, axis, start, start + n)
        return [v]
    if any(isinstance(x, Array) and x.shape[-1] > 1 for x in where):
        return None
    x = together(v, eqn.invars[0].aval.dtype)
    at = [x[0] if isinstance(x, Array) else x for x in where]
    found = jax.lax.dynamic_slice(x, (*at, 0), (*eqn.params["slice_sizes"], x.shape[-1]))
    return [apart(box(found.shape[:-1], found))]


def _dynamic_update(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    v, update, *starts = given
    where = [x.pieces[()] for x in starts]
    if any(isinstance(x, Array) and x.shape[-1] > 1 for x in where):
        return None
    dtype = eqn.invars[0].aval.dtype
    x, piece = together(v, dtype), together(update, dtype)
    width = max(x.shape[-1], piece.shape[-1])
    x, piece = (jnp.broadcast_to(y, (*y.shape[:-1], width)) for y in (x, piece))
    at = [x[0] if isinstance(x, Array) else x for x in where]
    found = jax.lax.dynamic_update_slice(x, piece, (*at, 0))
    return [apart(box(found.shape[:-1], found))]


def chained(values: Sequence[Value], axis: int, dtype: Any) -> Value:
    """Values one after the other along an axis."""
    values = [v for v in values if v.shape[axis]]
    rank = len(values[0].shape)
    total = sum(v.shape[axis] for v in values)
    shape = (*values[0].shape[:axis], total, *values[0].shape[axis + 1 :])
    whole = tuple(any(v.whole[i] for v in values) for i in range(rank))
    for other in range(rank):
        if other == axis:
            continue
        if whole[other]:
            values = [joined(v, other, dtype) for v in values]
        elif any(v.pieces.shape[other] > 1 for v in values):
            values = [take(v, other) for v in values]
    some = any(v.pieces.shape[axis] > 1 for v in values)
    vector = total == VECTOR and all(v.shape[axis] == 1 for v in values)
    if (some or vector) and not whole[axis]:
        return Value(shape, np.concatenate([take(v, axis).pieces for v in values], axis), whole)
    values = [joined(v, axis, dtype) for v in values]
    found = new(np.broadcast_shapes(*(v.pieces.shape for v in values)))
    for i in np.ndindex(found.shape):
        row = [np.broadcast_to(v.pieces, found.shape)[i] for v in values]
        if all(number(x) and not isinstance(x, Array) for x in row):
            parts = [np.full(v.shape[axis], x) for v, x in zip(values, row, strict=True)]
            found[i] = plain(np.concatenate(parts).reshape([total if k == axis else 1 for k in range(rank + 1)]))
            continue
        outer = list(common([x if number(x) else cut(x, axis, 0, 1) for x in row]))
        parts = []
        for v, x in zip(values, row, strict=True):
            outer[axis] = v.shape[axis]
            parts.append(spread(x, tuple(outer), dtype))
        found[i] = jax.lax.concatenate(parts, axis)
    return Value(shape, found, whole)


def _concatenate(eqn: Any, given: list[Value], size: int) -> list[Value]:
    return [chained(given, eqn.params["dimension"], eqn.outvars[0].aval.dtype)]


def _stack(eqn: Any, given: list[Value], size: int) -> list[Value]:
    axis, shape = eqn.params.get("axis", 0), eqn.outvars[0].aval.shape
    axis %= len(shape)
    one = (*shape[:axis], 1, *shape[axis + 1 :])
    dims = [i for i in range(len(shape)) if i != axis]
    return [chained([turned(v, one, dims)[0] for v in given], axis, eqn.outvars[0].aval.dtype)]


def _pad(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    v, fill = given
    if any(low < 0 or high < 0 or inner for low, high, inner in eqn.params["padding_config"]):
        return None
    for axis, (low, high, _) in enumerate(eqn.params["padding_config"]):
        parts = []
        for n in (low, None, high):
            if n is None:
                parts.append(v)
            elif n:
                piece = fill.pieces[()]
                piece = piece if number(piece) else piece.reshape(*[1] * len(v.shape), piece.shape[-1])
                parts.append(box((*v.shape[:axis], n, *v.shape[axis + 1 :]), piece))
        v = chained(parts, axis, eqn.outvars[0].aval.dtype) if len(parts) > 1 else v
    return [v]


def _split(eqn: Any, given: list[Value], size: int) -> list[Value]:
    found, start = [], 0
    for n in eqn.params["sizes"]:
        found.append(sliced(given[0], eqn.params["axis"], start, start + n))
        start += n
    return found


def _scatter(add: bool) -> Callable:
    """x.at[piece].set(update) of one box at a place that is known."""

    def rule(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
        v, index, update = given
        d, dtype = eqn.params["dimension_numbers"], eqn.outvars[0].aval.dtype
        at = index.pieces
        known = all(not isinstance(x, Array) for x in at.flat)
        dims = d.scatter_dims_to_operand_dims
        if not known or d.operand_batching_dims or prod(index.shape) != len(dims):
            return None
        place = known_array(index)
        start = [0] * len(v.shape)
        for axis, i in zip(dims, place.ravel(), strict=True):
            start[axis] = int(i)
        window = [i for i in range(len(v.shape)) if i not in d.inserted_window_dims]
        if len(d.update_window_dims) != len(window) or list(d.update_window_dims) != list(range(len(window))):
            return None
        piece = turned(update, tuple(update.shape[window.index(i)] if i in window else 1 for i in range(len(v.shape))), window)[0]
        return [_set(v, piece, start, 0, add, dtype)]

    return rule


def _set(v: Value, piece: Value, start: list[int], axis: int, add: bool, dtype: Any) -> Value:
    """A box of a value replaced, or added to, axis by axis."""
    if axis == len(v.shape):
        if not add:
            return piece
        a, b = level([v, piece], [dtype, dtype])
        shape = np.broadcast_shapes(a.pieces.shape, b.pieces.shape)
        found = new(shape)
        for i in np.ndindex(shape):
            x, y = np.broadcast_to(a.pieces, shape)[i], np.broadcast_to(b.pieces, shape)[i]
            found[i] = y if _is(x, 0.0) else x if _is(y, 0.0) else x + y
        return Value(v.shape, found, a.whole)
    first, last, n = start[axis], start[axis] + piece.shape[axis], v.shape[axis]
    inner = _set(sliced(v, axis, first, last), piece, start, axis + 1, add, dtype)
    parts = [sliced(v, axis, 0, first)] if first else []
    parts.append(inner)
    if last < n:
        parts.append(sliced(v, axis, last, n))
    return chained(parts, axis, dtype) if len(parts) > 1 else inner


def _reduce(operation: Callable, fold: str | None = None) -> Callable:
    def rule(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
        v, axes = given[0], eqn.params["axes"]
        dtype = eqn.invars[0].aval.dtype
        if prod(v.shape[i] for i in axes) > SHORT:
            return None
        for axis in sorted(axes, reverse=True):
            parts = take(v, axis).pieces
            keep = v.shape[:axis] + v.shape[axis + 1 :]
            found = new(parts.shape[:axis] + parts.shape[axis + 1 :])
            for i in np.ndindex(found.shape):
                row = [_drop(parts[i[:axis] + (k,) + i[axis:]], axis) for k in range(v.shape[axis])]
                found[i] = reduce(lambda a, b: _both(operation, fold, a, b, dtype), row)
            v = Value(keep, found, v.whole[:axis] + v.whole[axis + 1 :])
        return [v]

    return rule


def _drop(x: Piece, axis: int) -> Piece:
    return x if number(x) else x.reshape(x.shape[:axis] + x.shape[axis + 1 :])


def _both(operation: Callable, fold: str | None, a: Piece, b: Piece, dtype: Any) -> Piece:
    if fold is not None and (found := FOLDS[fold](a, b)) is not None:
        return found
    if not isinstance(a, Array) and not isinstance(b, Array):
        with jax.ensure_compile_time_eval():
            shape = common([a, b])
            return plain(np.asarray(operation(*(jnp.asarray(np.broadcast_to(np.asarray(x, dtype), shape)) for x in (a, b))))[()])
    shape = common([a, b])
    return operation(spread(a, shape, dtype), spread(b, shape, dtype))


def _dot(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    """A product of matrices as a sum of outer products."""
    (over_a, over_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    a, b = given
    dtype = eqn.outvars[0].aval.dtype
    sizes = [a.shape[i] for i in over_a]
    if prod(sizes) > SHORT:
        return None
    free_a = [i for i in range(len(a.shape)) if i not in (*over_a, *batch_a)]
    free_b = [i for i in range(len(b.shape)) if i not in (*over_b, *batch_b)]
    if any(n > VECTOR for n in sizes):
        # Components of long vectors would be too many: arrays again.
        a, b = (_merged(v, dtype) for v in (a, b))
        if prod(a.shape[i] for i in free_a) > 1 and prod(b.shape[i] for i in free_b) > 1:
            return [_looped(a, b, (over_a, batch_a, free_a), (over_b, batch_b, free_b), dtype)]
    n, left, right = len(batch_a), len(free_a), len(free_b)
    first = _arranged(a, [*over_a, *batch_a, *free_a], len(over_a) + n + left, right)
    second = _arranged(b, [*over_b, *batch_b, *free_b], len(over_b) + n, left)
    total: Value | None = None
    for index in itertools.product(*(range(k) for k in sizes)):
        x, y = first, second
        for k, i in enumerate(index):
            x, y = (sliced(v, k, i, i + 1) for v in (x, y))
        term = _apply(jax.lax.mul, "mul", x, y, dtype)
        total = term if total is None else _apply(jax.lax.add, "add", total, term, dtype)
    assert total is not None
    shape = (1,) * len(sizes) + eqn.outvars[0].aval.shape
    keep = list(range(len(sizes), len(shape)))
    one = lambda x: x if number(x) else x.reshape(*(x.shape[i] for i in keep), x.shape[-1])  # noqa: E731
    pieces = mapped(one, total.pieces).reshape([total.pieces.shape[i] for i in keep])
    return [Value(tuple(shape[i] for i in keep), pieces, tuple(total.whole[i] for i in keep))]


def _looped(a: Value, b: Value, axes_a: tuple, axes_b: tuple, dtype: Any) -> Value:
    """A product of matrices in a loop over the first axis: of the batch, else of the sum.

    XLA makes one kernel of what is not a loop, and computes an entry of a factor anew for each product that it is in.
    """
    x, y = (
        jnp.transpose(together(v, dtype), (*batch, *over, *free, len(v.shape)))
        for v, (over, batch, free) in ((a, axes_a), (b, axes_b))
    )
    batch, over, left, right = len(axes_a[1]), len(axes_a[0]), len(axes_a[2]), len(axes_b[2])
    x = x.reshape(*x.shape[:-1], *[1] * right, x.shape[-1])
    y = y.reshape(*y.shape[: batch + over], *[1] * left, *y.shape[batch + over :])

    if batch:
        x, y = (z.reshape(prod(z.shape[:batch]), prod(z.shape[batch : batch + over]), *z.shape[batch + over :]) for z in (x, y))
        found = jax.lax.map(lambda xy: reduce(jax.lax.add, (xy[0][i] * xy[1][i] for i in range(xy[0].shape[0]))), (x, y))
        found = found.reshape(*(a.shape[i] for i in axes_a[1]), *found.shape[1:])
    else:
        x, y = (z.reshape(z.shape[0], prod(z.shape[1:over]), *z.shape[over:]) for z in (x, y))
        term = lambda k: reduce(jax.lax.add, (x[k, i] * y[k, i] for i in range(x.shape[1])))  # noqa: E731
        found = jax.lax.fori_loop(1, x.shape[0], lambda k, total: total + term(k), term(0))
    return apart(box(found.shape[:-1], found))


def _merged(v: Value, dtype: Any) -> Value:
    for axis in range(len(v.shape)):
        v = joined(v, axis, dtype)
    return v


def _arranged(v: Value, order: list[int], where: int, extra: int) -> Value:
    """Axes in an order, and so many of length 1 put in."""
    one = lambda x: x if number(x) else x.transpose(*order, len(order))  # noqa: E731
    pieces, shape = mapped(one, v.pieces).transpose(order), [v.shape[i] for i in order]
    whole = [v.whole[i] for i in order]
    ones = (1,) * extra
    widen = lambda x: x if number(x) else x.reshape(*x.shape[:where], *ones, *x.shape[where:])  # noqa: E731
    outer = (*pieces.shape[:where], *ones, *pieces.shape[where:])
    return Value(
        (*shape[:where], *ones, *shape[where:]),
        mapped(widen, pieces).reshape(outer),
        (*whole[:where], *[False] * extra, *whole[where:]),
    )


def _apply(operation: Callable, fold: str, a: Value, b: Value, dtype: Any) -> Value:
    """An operation on values that broadcast against each other."""
    rank = len(a.shape)
    shape = np.broadcast_shapes(a.shape, b.shape)
    whole = tuple(x or y for x, y in zip(a.whole, b.whole, strict=True))
    for axis in range(rank):
        if whole[axis]:
            a, b = joined(a, axis, dtype), joined(b, axis, dtype)
        elif a.pieces.shape[axis] > 1 or b.pieces.shape[axis] > 1:
            a, b = (v if v.shape[axis] == 1 else take(v, axis) for v in (a, b))
    outer = np.broadcast_shapes(a.pieces.shape, b.pieces.shape)
    x, y = np.broadcast_to(a.pieces, outer), np.broadcast_to(b.pieces, outer)
    found = new(outer)
    for i in np.ndindex(outer):
        found[i] = _both(operation, fold, x[i], y[i], dtype)
    return Value(shape, found, whole)


def _scan(eqn: Any, given: list[Value], size: int) -> list[Value]:
    p = eqn.params
    n, m = p["num_consts"], p["num_consts"] + p["num_carry"]
    consts, carry, rows = given[:n], given[n:m], given[m:]
    body, kinds = p["jaxpr"], [v.aval.dtype for v in eqn.invars]

    def whole(v: Value, dtype: Any, full: bool = True) -> Array:
        x = together(v, dtype)
        return jnp.broadcast_to(x, (*v.shape, size)) if full else x

    def step(carry: list[Array], rows: list[Array]) -> tuple[list[Array], list[Array]]:
        inputs = [*consts, *(apart(box(x.shape[:-1], x)) for x in (*carry, *rows))]
        found = evaluated(body.jaxpr, body.consts, inputs, size)
        arrays = [whole(v, x.aval.dtype) for v, x in zip(found, body.jaxpr.outvars, strict=True)]
        return arrays[: p["num_carry"]], arrays[p["num_carry"] :]

    start = [whole(v, d) for v, d in zip(carry, kinds[n:m], strict=True)]
    lists = [whole(v, d, False) for v, d in zip(rows, kinds[m:], strict=True)]
    carried, stacked = jax.lax.scan(step, start, lists, p["length"], p["reverse"], p["unroll"])
    return [apart(box(x.shape[:-1], x)) for x in (*carried, *stacked)]


def _cond(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    which, *rest = given
    at = which.pieces[()]
    if isinstance(at, Array) and at.shape[-1] > 1:
        return None
    arrays = [together(v, var.aval.dtype) for v, var in zip(rest, eqn.invars[1:], strict=True)]

    def branch(closed: Any) -> Callable:
        def run(*values: Any) -> list[Array]:
            found = evaluated(closed.jaxpr, closed.consts, [apart(box(x.shape[:-1], x)) for x in values], size)
            return [
                jnp.broadcast_to(together(v, x.aval.dtype), (*v.shape, size))
                for v, x in zip(found, closed.jaxpr.outvars, strict=True)
            ]

        return run

    found = jax.lax.switch(at if number(at) else at[0], [branch(b) for b in eqn.params["branches"]], *arrays)
    return [apart(box(x.shape[:-1], x)) for x in found]


def _members(eqn: Any, given: list[Value], size: int) -> list[Value]:
    v, axis = given[0], eqn.params["axis"]
    v = joined(v, axis, eqn.invars[0].aval.dtype)
    return [Value(v.shape, v.pieces, (*v.whole[:axis], True, *v.whole[axis + 1 :]))]


def _iota(eqn: Any, given: list[Value], size: int) -> list[Value]:
    with jax.ensure_compile_time_eval():
        return [constant(eqn.primitive.bind(**eqn.params))]


INNER = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr", "remat": "jaxpr"}
ELEMENTWISE = {
    "abs", "add", "add_any", "and", "atan2", "ceil", "clamp", "convert_element_type", "cos", "div", "eq", "erf", "exp",
    "exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p", "lt", "max", "min", "mul",
    "ne", "neg", "not", "or", "pow", "rem", "round", "rsqrt", "select_n", "sign", "sin", "square", "sqrt", "stop_gradient",
    "sub", "tan", "tanh", "xor", "copy", "shift_right_logical", "shift_left", "bitcast_convert_type",
}  # fmt: skip
RULES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": _concatenate,
    "cond": _cond,
    "dot_general": _dot,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update,
    "expand_dims": _expand,
    "iota": _iota,
    "members": _members,
    "pad": _pad,
    "reduce_and": _reduce(jax.lax.bitwise_and),
    "reduce_max": _reduce(jax.lax.max),
    "reduce_min": _reduce(jax.lax.min),
    "reduce_or": _reduce(jax.lax.bitwise_or),
    "reduce_sum": _reduce(jax.lax.add, "add"),
    "reshape": _reshape,
    "scan": _scan,
    "scatter": _scatter(False),
    "scatter-add": _scatter(True),
    "slice": _slice,
    "split": _split,
    "squeeze": _squeeze,
    "stack": _stack,
    "transpose": _transpose,
}
