"""A function of one lane, evaluated for many with the lanes as the last axis of every array.

``jax.vmap`` puts the batch first, and keeps products of matrices and sums over axes of length 3 to 11 as operations of
their own. XLA then calls a small kernel for each, none of which is vectorised. Here every operation of the traced function
is written anew: lanes are the last, contiguous axis, and sums and products of matrices over short axes are sums of slices,
which XLA fuses and vectorises. The function stays as it is written for one lane; the formulas stand once.

What is not known here (a factorisation by LAPACK, a sort) goes through ``vmap``, right and as slow as there.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from functools import reduce
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.extend import core

# Longest sum that is written out.
SHORT = 12


class Lane:
    """A traced value; ``wide`` where it differs by lane, and then has them as its last axis."""

    __slots__ = ("value", "wide")

    def __init__(self, value: Any, wide: bool) -> None:
        self.value, self.wide = value, wide


def lanes(function: Callable) -> Callable:
    """``function`` of arrays whose last axis is that of the lanes; results have them last, too."""

    def batched(*args: Any) -> Any:
        flat, tree = jax.tree.flatten(args)
        size = flat[0].shape[-1]
        one = [jax.ShapeDtypeStruct(x.shape[:-1], x.dtype) for x in flat]
        closed, shape = jax.make_jaxpr(lambda *xs: function(*jax.tree.unflatten(tree, xs)), return_shape=True)(*one)
        found = evaluate(closed.jaxpr, [Lane(x, False) for x in closed.consts], [Lane(x, True) for x in flat], size)
        return jax.tree.unflatten(jax.tree.structure(shape), [spread(x, size) for x in found])

    return batched


def spread(x: Lane, size: int) -> Array:
    """The value for every lane."""
    return x.value if x.wide else jnp.broadcast_to(jnp.asarray(x.value)[..., None], (*jnp.shape(x.value), size))


def evaluate(jaxpr: Any, consts: Sequence[Lane], args: Sequence[Lane], size: int) -> list[Lane]:
    """Evaluate a jaxpr for so many lanes."""
    known: dict[Any, Lane] = {}

    def read(atom: Any) -> Lane:
        return Lane(atom.val, False) if isinstance(atom, core.Literal) else known[atom]

    known.update(zip(jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))
    uses = Counter(x for eqn in jaxpr.eqns for x in eqn.invars if not isinstance(x, core.Literal))
    uses.update(x for x in jaxpr.outvars if not isinstance(x, core.Literal))
    for eqn in jaxpr.eqns:
        found = operate(eqn, [read(x) for x in eqn.invars], size)
        if eqn.primitive.name in KEPT:
            for x, var in zip(found, eqn.outvars, strict=True):
                if x.wide and uses[var] > 1:
                    x.value = jax.lax.optimization_barrier(x.value)
        known.update(zip(eqn.outvars, found, strict=True))
    return [read(x) for x in jaxpr.outvars]


def operate(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    """One operation."""
    name = eqn.primitive.name
    if name in INNER:
        inner = eqn.params[INNER[name]]
        jaxpr, consts = (inner.jaxpr, inner.consts) if hasattr(inner, "jaxpr") else (inner, [])
        return evaluate(jaxpr, [Lane(x, False) for x in consts], given[: len(jaxpr.invars)], size)
    if not any(x.wide for x in given):
        found = eqn.primitive.bind(*(x.value for x in given), **eqn.params)
        return [Lane(x, False) for x in (found if eqn.primitive.multiple_results else [found])]
    rule = RULES.get(name)
    if name in ELEMENTWISE:
        ranks = [x.ndim for x in (v.aval for v in eqn.invars)]
        values = [
            jnp.asarray(x.value)[..., None] if not x.wide and rank else x.value
            for x, rank in zip(given, ranks, strict=True)
        ]
        return [Lane(aligned(eqn.primitive, values, ranks, given, eqn.params), True)]
    if rule is not None:
        found = rule(eqn, given, size)
        if found is not None:
            return found
    return slowly(eqn, given)


def aligned(primitive: Any, values: list[Any], ranks: list[int], given: list[Lane], params: Any) -> Array:
    """An elementwise operation; what is the same in all lanes is broadcast."""
    rank = max(ranks)
    shaped = []
    for value, of, x in zip(values, ranks, given, strict=True):
        if x.wide and of < rank:
            value = value.reshape(*[1] * (rank - of), -1)
        shaped.append(value)
    shape = jnp.broadcast_shapes(*(jnp.shape(x) for x in shaped))
    shaped = [jnp.broadcast_to(x, shape) for x in shaped]
    return primitive.bind(*shaped, **params)


def slowly(eqn: Any, given: list[Lane]) -> list[Lane]:
    """Through JAX's own batching."""
    axes = tuple(x.value.ndim - 1 if x.wide else None for x in given)
    call = lambda *xs: eqn.primitive.bind(*xs, **eqn.params)  # noqa: E731
    found = jax.vmap(call, axes, -1)(*(x.value for x in given))
    return [Lane(x, True) for x in (found if eqn.primitive.multiple_results else [found])]


def _broadcast(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    shape, dims = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    return [Lane(jax.lax.broadcast_in_dim(given[0].value, (*shape, size), (*dims, len(shape))), True)]


def _reshape(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    return [Lane(jax.lax.reshape(given[0].value, (*eqn.params["new_sizes"], size)), True)]


def _squeeze(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    return [Lane(jax.lax.squeeze(given[0].value, eqn.params["dimensions"]), True)]


def _expand(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    return [Lane(jax.lax.expand_dims(given[0].value, eqn.params["dimensions"]), True)]


def _transpose(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    order = eqn.params["permutation"]
    return [Lane(jax.lax.transpose(given[0].value, (*order, len(order))), True)]


def _slice(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    p = eqn.params
    steps = None if p["strides"] is None else (*p["strides"], 1)
    return [Lane(jax.lax.slice(given[0].value, (*p["start_indices"], 0), (*p["limit_indices"], size), steps), True)]


def _pad(eqn: Any, given: list[Lane], size: int) -> list[Lane] | None:
    if given[1].wide:
        return None
    return [Lane(jax.lax.pad(given[0].value, given[1].value, (*eqn.params["padding_config"], (0, 0, 0))), True)]


def _concatenate(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    return [Lane(jax.lax.concatenate([spread(x, size) for x in given], eqn.params["dimension"]), True)]


def _stack(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    axis = eqn.params.get("axis", 0)
    return [Lane(jnp.stack([spread(x, size) for x in given], axis), True)]


def _rev(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    return [Lane(jax.lax.rev(given[0].value, eqn.params["dimensions"]), True)]


def _reduce(operation: Callable) -> Callable:
    def rule(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
        value, axes = given[0].value, eqn.params["axes"]
        for axis in sorted(axes, reverse=True):
            if value.shape[axis] > SHORT:
                value = eqn.primitive.bind(value, **{**eqn.params, "axes": (axis,)})
            else:
                value = reduce(operation, (at(value, i, axis) for i in range(value.shape[axis])))
        return [Lane(value, True)]

    return rule


def at(x: Array, index: int, axis: int) -> Array:
    """One entry along an axis."""
    return jax.lax.index_in_dim(x, index, axis, keepdims=False)


def _dot(eqn: Any, given: list[Lane], size: int) -> list[Lane] | None:
    """A product of matrices as a sum of outer products: (batch, left, right, lanes)."""
    (over_a, over_b), (batch_a, batch_b) = eqn.params["dimension_numbers"]
    a, b = ((jnp.asarray(x.value) if x.wide else jnp.asarray(x.value)[..., None]) for x in given)
    rank_a, rank_b = a.ndim - 1, b.ndim - 1
    free_a = [i for i in range(rank_a) if i not in (*over_a, *batch_a)]
    free_b = [i for i in range(rank_b) if i not in (*over_b, *batch_b)]
    sizes = [a.shape[i] for i in over_a]
    if prod(sizes) > 2 * SHORT:
        return None
    a = jnp.transpose(a, (*over_a, *batch_a, *free_a, rank_a))
    b = jnp.transpose(b, (*over_b, *batch_b, *free_b, rank_b))
    inner = len(over_a)
    a = a.reshape(prod(sizes), *a.shape[inner : inner + len(batch_a) + len(free_a)], *[1] * len(free_b), a.shape[-1])
    b = b.reshape(
        prod(sizes), *b.shape[inner : inner + len(batch_b)], *[1] * len(free_a), *b.shape[inner + len(batch_b) :]
    )
    return [Lane(reduce(jax.lax.add, (a[i] * b[i] for i in range(prod(sizes)))), True)]


def _split(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    found = jax.lax.split(given[0].value, eqn.params["sizes"], eqn.params["axis"])
    return [Lane(x, True) for x in found]


def _scatter(add: bool) -> Callable:
    """x.at[piece].set(update) of one box at a place that is known."""

    def rule(eqn: Any, given: list[Lane], size: int) -> list[Lane] | None:
        operand, index, update = given
        d = eqn.params["dimension_numbers"]
        if index.wide or d.inserted_window_dims or d.operand_batching_dims or len(d.scatter_dims_to_operand_dims) != jnp.size(index.value):
            return None
        try:
            import numpy as np

            start = [0] * len(eqn.invars[0].aval.shape)
            for dim, i in zip(d.scatter_dims_to_operand_dims, np.asarray(index.value).ravel(), strict=True):
                start[dim] = int(i)
        except jax.errors.TracerArrayConversionError:
            return None
        whole, piece = spread(operand, size), spread(update, size)
        where = tuple(slice(i, i + n) for i, n in zip(start, piece.shape[:-1], strict=True))
        return [Lane(whole.at[where].add(piece) if add else whole.at[where].set(piece), True)]

    return rule


def _dynamic_slice(eqn: Any, given: list[Lane], size: int) -> list[Lane] | None:
    operand, *starts = given
    if any(x.wide for x in starts):
        return None
    sizes = (*eqn.params["slice_sizes"], size)
    return [Lane(jax.lax.dynamic_slice(operand.value, (*(x.value for x in starts), 0), sizes), True)]


def _dynamic_update(eqn: Any, given: list[Lane], size: int) -> list[Lane] | None:
    operand, update, *starts = given
    if any(x.wide for x in starts):
        return None
    whole, piece = spread(operand, size), spread(update, size)
    return [Lane(jax.lax.dynamic_update_slice(whole, piece, (*(x.value for x in starts), 0)), True)]


def _scan(eqn: Any, given: list[Lane], size: int) -> list[Lane]:
    p = eqn.params
    consts, carry, rows = (
        given[: p["num_consts"]],
        given[p["num_consts"] : p["num_consts"] + p["num_carry"]],
        given[p["num_consts"] + p["num_carry"] :],
    )
    body = p["jaxpr"]

    def step(carry: list[Array], rows: list[Array]) -> tuple[list[Array], list[Array]]:
        inputs = [*consts, *(Lane(x, True) for x in carry), *(Lane(x, y.wide) for x, y in zip(rows, wides, strict=True))]
        found = evaluate(body.jaxpr, [Lane(x, False) for x in body.consts], inputs, size)
        found = [spread(x, size) for x in found]
        return found[: p["num_carry"]], found[p["num_carry"] :]

    wides = rows
    carried, stacked = jax.lax.scan(
        step, [spread(x, size) for x in carry], [x.value for x in rows], p["length"], p["reverse"], p["unroll"]
    )
    return [Lane(x, True) for x in (*carried, *stacked)]


def _cond(eqn: Any, given: list[Lane], size: int) -> list[Lane] | None:
    which, *rest = given
    if which.wide:
        return None
    wide = [x.wide for x in rest]

    def branch(closed: Any) -> Callable:
        def run(*values: Any) -> list[Array]:
            inputs = [Lane(x, w) for x, w in zip(values, wide, strict=True)]
            found = evaluate(closed.jaxpr, [Lane(x, False) for x in closed.consts], inputs, size)
            return [spread(x, size) for x in found]

        return run

    found = jax.lax.switch(which.value, [branch(b) for b in eqn.params["branches"]], *(x.value for x in rest))
    return [Lane(x, True) for x in found]


INNER = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr", "remat": "jaxpr"}
ELEMENTWISE = {
    "abs", "add", "add_any", "and", "atan2", "ceil", "clamp", "convert_element_type", "cos", "div", "eq", "erf", "exp",
    "exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p", "lt", "max", "min", "mul",
    "ne", "neg", "not", "or", "pow", "rem", "round", "rsqrt", "select_n", "sign", "sin", "square", "sqrt", "stop_gradient",
    "sub", "tan", "tanh", "xor", "copy", "shift_right_logical", "shift_left", "bitcast_convert_type",
}  # fmt: skip
MOVES = {"convert_element_type", "copy", "stop_gradient", "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose", "slice", "pad", "rev", "split"}
KEPT = (ELEMENTWISE | {"concatenate", "stack", "dot_general", "reduce_sum", "scatter", "scatter-add"}) - MOVES
RULES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "concatenate": _concatenate,
    "cond": _cond,
    "dot_general": _dot,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update,
    "expand_dims": _expand,
    "pad": _pad,
    "reduce_and": _reduce(jax.lax.bitwise_and),
    "reduce_max": _reduce(jax.lax.max),
    "reduce_min": _reduce(jax.lax.min),
    "reduce_or": _reduce(jax.lax.bitwise_or),
    "reduce_sum": _reduce(jax.lax.add),
    "reshape": _reshape,
    "rev": _rev,
    "scan": _scan,
    "scatter": _scatter(False),
    "scatter-add": _scatter(True),
    "slice": _slice,
    "split": _split,
    "squeeze": _squeeze,
    "stack": _stack,
    "transpose": _transpose,
}
