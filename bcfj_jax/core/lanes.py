"""A function of one lane, evaluated for many, with the lanes as the last axis of every array.

``jax.vmap`` puts the batch first. XLA's kernels then have an innermost loop over a vector's three components, and none
is vectorised. Here every operation of the traced function is written anew with one more axis behind all others, which
is contiguous and as long as there are lanes. Products of matrices are sums of products. The function stays as it is
written for one lane, each formula stands once, and as many operations are compiled.

What is not known here (a factorisation by LAPACK, a sort) goes through ``vmap``, right and as slow as there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend import core
from jax.interpreters import ad, batching, mlir

from bcfj_jax.core.kept import kept


# Longest sum that is written out.
_SHORT = 12
# Fewer lanes than this are an ordinary batch.
_FEW = 8


class Value(NamedTuple):
    """An array of the traced function: with the lanes as its last axis, or the same in all of them."""

    array: Any
    laned: bool


def lanes_last(function: Callable) -> Callable:
    """``function`` of arrays, the same but for batches: ``vmap`` has their lanes last inside.

    Derivatives are those of the function; where they are taken, batches are ordinary ones.
    """

    def laned(*args: Any) -> Any:
        flat, tree = jax.tree.flatten(args)
        closed, shape = jax.make_jaxpr(lambda *xs: function(*jax.tree.unflatten(tree, xs)), return_shape=True)(*flat)
        return jax.tree.unflatten(jax.tree.structure(shape), _LANES.bind(*flat, closed=closed))

    return laned


def evaluated(closed: Any, args: Sequence[Value], size: int) -> list[Array]:
    """A traced function's results for so many lanes, which are last in the results, too."""
    return [full(x, size) for x in evaluate(closed.jaxpr, closed.consts, args, size)]


def _batched(args: Sequence[Array], axes: Sequence[Any], closed: Any) -> tuple[list[Array], list[int]]:
    size = next(x.shape[axis] for x, axis in zip(args, axes, strict=True) if axis is not None)
    if size < _FEW:
        return jax.vmap(core.jaxpr_as_fun(closed), axes)(*args), [0] * len(closed.out_avals)
    given = [Value(x, False) if at is None else Value(jnp.moveaxis(x, at, -1), True) for x, at in zip(args, axes, strict=True)]
    found = evaluated(closed, given, size)
    return found, [x.ndim - 1 for x in found]


def _run(*args: Array, closed: Any) -> list[Array]:
    return core.jaxpr_as_fun(closed)(*args)


_LANES = core.Primitive("lanes")
_LANES.multiple_results = True
_LANES.def_impl(_run)
_LANES.def_abstract_eval(lambda *args, closed: closed.out_avals)
mlir.register_lowering(_LANES, mlir.lower_fun(_run, multiple_results=True))
batching.primitive_batchers[_LANES] = _batched
ad.primitive_jvps[_LANES] = lambda primals, tangents, closed: jax.jvp(
    core.jaxpr_as_fun(closed), primals, [ad.instantiate_zeros(x) for x in tangents]
)


def full(value: Value, size: int) -> Array:
    """The array of a value with its lanes."""
    x = value.array
    return x if value.laned else jnp.broadcast_to(jnp.asarray(x)[..., None], (*np.shape(x), size))


def evaluate(jaxpr: Any, consts: Sequence[Any], args: Sequence[Value], size: int) -> list[Value]:
    """A jaxpr's results for so many lanes."""
    known: dict[Any, Value] = {}

    def read(atom: Any) -> Value:
        return Value(atom.val, False) if isinstance(atom, core.Literal) else known[atom]

    known.update(zip(jaxpr.constvars, (Value(x, False) for x in consts), strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))
    for eqn in jaxpr.eqns:
        found = _operate(eqn, [read(x) for x in eqn.invars], size)
        known.update(zip(eqn.outvars, found, strict=True))
    return [read(x) for x in jaxpr.outvars]


def _operate(eqn: Any, given: list[Value], size: int) -> list[Value]:
    name = eqn.primitive.name
    if name in _INNER:
        inner = eqn.params[_INNER[name]]
        jaxpr, consts = (inner.jaxpr, inner.consts) if hasattr(inner, "jaxpr") else (inner, [])
        return evaluate(jaxpr, consts, given, size)
    if not any(x.laned for x in given):
        found = eqn.primitive.bind(*(x.array for x in given), **eqn.params)
        return [Value(x, False) for x in (found if eqn.primitive.multiple_results else [found])]
    if name in _ELEMENTWISE:
        return [Value(_elementwise(eqn, given, size), True)]
    if name in _RULES:
        found = _RULES[name](eqn, given, size)
        if found is not None:
            return found
    return _slowly(eqn, given)


def _slowly(eqn: Any, given: list[Value]) -> list[Value]:
    """Through JAX's own batching."""
    call = lambda *xs: eqn.primitive.bind(*xs, **eqn.params)  # noqa: E731
    found = jax.vmap(call, [-1 if x.laned else None for x in given], -1)(*(x.array for x in given))
    return [Value(x, True) for x in (found if eqn.primitive.multiple_results else [found])]


# -- rules -------------------------------------------------------------------------------------------------------------


def _elementwise(eqn: Any, given: list[Value], size: int) -> Array:
    shape = (*eqn.outvars[0].aval.shape, size)
    arrays = []
    for x in given:
        array = x.array
        if x.laned and array.ndim < len(shape):
            array = array.reshape(*(1,) * (len(shape) - array.ndim), size)
        elif not x.laned:
            array = jnp.asarray(array)[..., None]
        arrays.append(jnp.broadcast_to(array, shape))
    return eqn.primitive.bind(*arrays, **eqn.params)


def _changed(change: Callable[[Any, Any], dict[str, Any]]) -> Callable:
    """A rule for an operation of one array, whose parameters are other ones with lanes: (eqn, array) -> those."""

    def rule(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
        if any(x.laned for x in given[1:]):
            return None
        x, *rest = (x.array for x in given)
        return [Value(eqn.primitive.bind(x, *rest, **(eqn.params | change(eqn, x))), True)]

    return rule


def _dot(eqn: Any, given: list[Value], size: int) -> list[Value]:
    """A sum of products, over the axes that both arrays lose."""
    (over_a, over_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    ranks = [len(v.aval.shape) for v in eqn.invars]
    free_a = [i for i in range(ranks[0]) if i not in (*over_a, *batch_a)]
    free_b = [i for i in range(ranks[1]) if i not in (*over_b, *batch_b)]
    a, b = (x.array if x.laned else jnp.asarray(x.array)[..., None] for x in given)
    a = a.transpose(*batch_a, *over_a, *free_a, ranks[0])
    b = b.transpose(*batch_b, *over_b, *free_b, ranks[1])
    common = len(batch_a) + len(over_a)
    a = a.reshape(*a.shape[:-1], *(1,) * len(free_b), a.shape[-1])
    b = b.reshape(*b.shape[:common], *(1,) * len(free_a), *b.shape[common:])
    return [Value(kept(_summed(a * b, tuple(range(len(batch_a), common)))), True)]


def _summed(x: Array, axes: Sequence[int]) -> Array:
    """Sum over axes, written out where they are short: XLA's loop over them would stand inside that over the lanes."""
    for axis in sorted(axes, reverse=True):
        n = x.shape[axis]
        parts = (jax.lax.index_in_dim(x, i, axis, False) for i in range(n))
        x = reduce(jax.lax.add, parts) if 0 < n <= _SHORT else jnp.sum(x, axis)
    return x


def _sum(eqn: Any, given: list[Value], size: int) -> list[Value]:
    return [Value(jnp.sum(given[0].array, eqn.params["axes"]), True)]


def _concatenate(eqn: Any, given: list[Value], size: int) -> list[Value]:
    return [Value(eqn.primitive.bind(*(full(x, size) for x in given), **eqn.params), True)]


def _stack(eqn: Any, given: list[Value], size: int) -> list[Value]:
    axis = eqn.params.get("axis", 0) % len(eqn.outvars[0].aval.shape)
    return [Value(jnp.stack([full(x, size) for x in given], axis), True)]


def _split(eqn: Any, given: list[Value], size: int) -> list[Value]:
    return [Value(x, True) for x in eqn.primitive.bind(given[0].array, **eqn.params)]


def _dynamic_slice(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    x, *starts = given
    if any(at.laned for at in starts):
        return None
    sizes = (*eqn.params["slice_sizes"], size)
    at = [jnp.asarray(at.array, jnp.int32) for at in (*starts, Value(0, False))]
    return [Value(jax.lax.dynamic_slice(x.array, at, sizes), True)]


def _dynamic_update(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    x, update, *starts = given
    if any(at.laned for at in starts):
        return None
    at = [jnp.asarray(at.array, jnp.int32) for at in (*starts, Value(0, False))]
    return [Value(jax.lax.dynamic_update_slice(full(x, size), full(update, size), at), True)]


def _gather(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    x, index = given
    if index.laned:
        return None
    d = eqn.params["dimension_numbers"]
    rank = len(eqn.outvars[0].aval.shape)
    params = eqn.params | {
        "dimension_numbers": d._replace(offset_dims=(*d.offset_dims, rank))
        if hasattr(d, "_replace")
        else type(d)(**(vars(d) | {"offset_dims": (*d.offset_dims, rank)})),
        "slice_sizes": (*eqn.params["slice_sizes"], size),
    }
    return [Value(eqn.primitive.bind(x.array, index.array, **params), True)]


def _scatter(add: bool) -> Callable:
    """x.at[box].set(update), or add, of one box."""

    def rule(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
        x, index, update = given
        d = eqn.params["dimension_numbers"]
        dims = d.scatter_dims_to_operand_dims
        if index.laned or d.operand_batching_dims or int(np.prod(np.shape(index.array))) != len(dims):
            return None
        shape = eqn.invars[0].aval.shape
        window = [i for i in range(len(shape)) if i not in d.inserted_window_dims]
        if list(d.update_window_dims) != list(range(len(window))) or len(eqn.invars[2].aval.shape) != len(window):
            return None
        sizes = [1] * len(shape)
        for i, n in zip(window, eqn.invars[2].aval.shape, strict=True):
            sizes[i] = n
        zero = jnp.int32(0)
        start: list[Any] = [zero] * len(shape)
        for i, at in zip(dims, jnp.asarray(index.array).reshape(-1), strict=True):
            start[i] = jnp.asarray(at, jnp.int32)
        piece, whole = full(update, size).reshape(*sizes, size), full(x, size)
        if add:
            piece = piece + jax.lax.dynamic_slice(whole, (*start, zero), (*sizes, size))
        return [Value(jax.lax.dynamic_update_slice(whole, piece, (*start, zero)), True)]

    return rule


def _kept(eqn: Any, given: list[Value], size: int) -> list[Value]:
    found = iter(eqn.primitive.bind(*(x.array for x in given if x.laned)))
    return [Value(next(found), True) if x.laned else x for x in given]


def _while(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    p = eqn.params
    n, m = p["cond_nconsts"], p["cond_nconsts"] + p["body_nconsts"]
    tests, consts, carry = given[:n], given[n:m], given[m:]
    body = p["body_jaxpr"]

    def step(values: Sequence[Value]) -> list[Value]:
        return evaluate(body.jaxpr, body.consts, [*consts, *values], size)

    laned = [x.laned for x in carry]
    while True:
        found: list[bool] = []

        def trial(*arrays: Any, found: list[bool] = found, laned: list[bool] = laned) -> list[Any]:
            values = step([Value(x, m) for x, m in zip(arrays, laned, strict=True)])
            found.extend(x.laned for x in values)
            return [x.array for x in values]

        jax.eval_shape(trial, *(full(x, size) if m else x.array for x, m in zip(carry, laned, strict=True)))
        wider = [a or b for a, b in zip(laned, found, strict=True)]
        if wider == laned:
            break
        laned = wider
    test = p["cond_jaxpr"]

    def goes(arrays: Sequence[Any]) -> Value:
        held = [Value(x, m) for x, m in zip(arrays, laned, strict=True)]
        return evaluate(test.jaxpr, test.consts, [*tests, *held], size)[0]

    start = [full(x, size) if m else jnp.asarray(x.array) for x, m in zip(carry, laned, strict=True)]
    apart: list[bool] = []
    jax.eval_shape(lambda *xs: (apart.append((v := goes(xs)).laned), v.array)[1], *start)
    if apart[0]:
        return None

    def turn(arrays: Sequence[Any]) -> list[Any]:
        found = step([Value(x, m) for x, m in zip(arrays, laned, strict=True)])
        return [full(x, size) if m else x.array for x, m in zip(found, laned, strict=True)]

    found = jax.lax.while_loop(lambda xs: goes(xs).array, turn, start)
    return [Value(x, m) for x, m in zip(found, laned, strict=True)]


def _scan(eqn: Any, given: list[Value], size: int) -> list[Value]:
    p = eqn.params
    n, m = p["num_consts"], p["num_consts"] + p["num_carry"]
    consts, carry, rows = given[:n], given[n:m], given[m:]
    body = p["jaxpr"]

    def step(values: Sequence[Any], row: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        held = [Value(x, True) for x in values]
        lists = [Value(x, v.laned) for x, v in zip(row, rows, strict=True)]
        found = [full(x, size) for x in evaluate(body.jaxpr, body.consts, [*consts, *held, *lists], size)]
        return found[: p["num_carry"]], found[p["num_carry"] :]

    start = [full(x, size) for x in carry]
    carried, stacked = jax.lax.scan(step, start, [x.array for x in rows], p["length"], p["reverse"], p["unroll"])
    return [Value(x, True) for x in (*carried, *stacked)]


def _cond(eqn: Any, given: list[Value], size: int) -> list[Value] | None:
    which, *rest = given
    if which.laned:
        return None

    def branch(closed: Any) -> Callable:
        def run(*arrays: Any) -> list[Array]:
            held = [Value(x, v.laned) for x, v in zip(arrays, rest, strict=True)]
            return [full(x, size) for x in evaluate(closed.jaxpr, closed.consts, held, size)]

        return run

    found = jax.lax.switch(which.array, [branch(b) for b in eqn.params["branches"]], *(x.array for x in rest))
    return [Value(x, True) for x in found]


_INNER = {
    "lanes": "closed",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "remat": "jaxpr",
    "checkpoint": "jaxpr",
}
_ELEMENTWISE = {
    "abs", "acos", "add", "add_any", "and", "asin", "atan", "atan2", "ceil", "clamp", "convert_element_type", "copy", "cos",
    "cosh", "div", "eq", "erf", "exp", "exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p",
    "lt", "max", "min", "mul", "ne", "neg", "nextafter", "not", "or", "pow", "rem", "round", "rsqrt", "select_n", "sign",
    "sin", "sinh", "sqrt", "square", "stop_gradient", "sub", "tan", "tanh", "xor",
}  # fmt: skip
_reduced = _changed(lambda eqn, x: {})
_RULES: dict[str, Callable] = {
    "argmax": _reduced,
    "argmin": _reduced,
    "broadcast_in_dim": _changed(
        lambda eqn, x: {
            "shape": (*eqn.params["shape"], x.shape[-1]),
            "broadcast_dimensions": (*eqn.params["broadcast_dimensions"], len(eqn.params["shape"])),
        }
    ),
    "concatenate": _concatenate,
    "cond": _cond,
    "dot_general": _dot,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update,
    "expand_dims": _reduced,
    "gather": _gather,
    "kept": _kept,
    "pad": _changed(lambda eqn, x: {"padding_config": (*eqn.params["padding_config"], (0, 0, 0))}),
    "reduce_and": _reduced,
    "reduce_max": _reduced,
    "reduce_min": _reduced,
    "reduce_or": _reduced,
    "reduce_prod": _reduced,
    "reduce_sum": _sum,
    "reshape": _changed(lambda eqn, x: {"new_sizes": (*eqn.params["new_sizes"], x.shape[-1])}),
    "scan": _scan,
    "scatter": _scatter(False),
    "scatter-add": _scatter(True),
    "slice": _changed(
        lambda eqn, x: {
            "start_indices": (*eqn.params["start_indices"], 0),
            "limit_indices": (*eqn.params["limit_indices"], x.shape[-1]),
            "strides": None if eqn.params["strides"] is None else (*eqn.params["strides"], 1),
        }
    ),
    "split": _split,
    "squeeze": _reduced,
    "stack": _stack,
    "transpose": _changed(lambda eqn, x: {"permutation": (*eqn.params["permutation"], x.ndim - 1)}),
    "while": _while,
}
