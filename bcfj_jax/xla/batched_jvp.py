"""A function whose forward derivatives in many directions come from one call: ``jacfwd`` does not batch its loops."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_batching import custom_vmap, sequential_vmap
from jax.custom_derivatives import SymbolicZero

X = TypeVar("X")
Y = TypeVar("Y")
Z = TypeVar("Z")


def together(
    function: Callable[[X], tuple[Y, Z]], ahead: Callable[[X, X], tuple[tuple[Y, Z], Y]]
) -> Callable[[X], tuple[Y, Z]]:
    """``function(x) -> (y, aside)``, with ``ahead(x, changes)`` for it and for y's changes in k directions at once.

    Forward mode and first derivatives only. What vmap adds to a tangent becomes directions; what it adds to the point
    stays a batch.

    Args:
        function: over a pytree of arrays; closed over static things only. ``aside`` is not differentiated.
        ahead: what ``function`` returns, and the changes of y; changes have a leading axis k in and out, and are None
            of what does not change.
    """

    @jax.custom_jvp
    def differentiable(x: X) -> tuple[Y, Z]:
        return function(x)

    @partial(differentiable.defjvp, symbolic_zeros=True)
    def _(primals, tangents):
        leaves, structure = jax.tree.flatten(primals[0])
        slopes = structure.flatten_up_to(tangents[0])
        moving = [not isinstance(slope, SymbolicZero) for slope in slopes]

        def many(leaves: list, changes: list) -> tuple:
            spread = iter(changes)
            tree = jax.tree.unflatten(structure, [next(spread) if moves else None for moves in moving])
            return ahead(jax.tree.unflatten(structure, leaves), tree)

        found, change = _gathered(many)(leaves, [slope for slope, moves in zip(slopes, moving, strict=True) if moves])
        return found, (change, jax.tree.map(still, found[1]))

    return differentiable


def changes(function: Callable[[Array], Any], x: Array) -> Any:
    """Forward derivatives of a pytree by every coordinate of x (P,): leaves (P, ...), None of what never changes."""
    moving: list[bool] = []

    @jax.custom_jvp
    def seen(leaves: list) -> Array:
        return jnp.zeros(())

    @partial(seen.defjvp, symbolic_zeros=True)
    def _(primals, tangents):
        moving[:] = [not isinstance(slope, SymbolicZero) for slope in tangents[0]]
        return seen(*primals), jnp.zeros(())

    jax.eval_shape(lambda x: jax.jvp(lambda x: seen(jax.tree.leaves(function(x))), (x,), (x,)), x)
    structure = jax.tree.structure(jax.eval_shape(function, x))

    def parts(x: Array) -> list:
        return [leaf for leaf, moves in zip(jax.tree.leaves(function(x)), moving, strict=True) if moves]

    along = jax.vmap(lambda direction: jax.jvp(parts, (x,), (direction,))[1])(jnp.eye(x.size))
    spread = iter(along)
    return jax.tree.unflatten(structure, [next(spread) if moves else None for moves in moving])


def along(function: Callable[[Any], Y], x: Any, changes: Any) -> tuple[Y, Y]:
    """Value of ``function(x)``, and its changes in k directions from those of x (k, ...), None of what does not change."""
    moving = jax.tree.map(lambda d, x: None if d is None else x, changes, x, is_leaf=lambda d: d is None)

    def push(change: Any) -> tuple:
        return jax.jvp(lambda moving: function(eqx.combine(moving, x)), (moving,), (change,))

    return jax.vmap(push, out_axes=(None, 0))(changes)


def lane_by_lane(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function(*x, y)``, whose vmap over anything in x takes one lane after another; over y alone it is vmap's own.

    For loops that keep long records: those of a batch would go on until its longest ends, and copy all records in every
    round. First derivatives do not go through.
    """
    one = custom_vmap(function)

    @one.def_vmap
    def _(size, batched, *operands):
        axes = jax.tree.map(lambda b: 0 if b else None, tuple(batched))
        if any(jax.tree.leaves(batched[:-1])):
            found = jax.vmap(sequential_vmap(lane_by_lane(function)), axes, axis_size=size)(*operands)
        else:
            found = lane_by_lane(jax.vmap(function, axes, axis_size=size))(*operands)
        return found, jax.tree.map(lambda _: True, found)

    return one


def _gathered(many: Callable[[list, list], tuple]) -> Callable[[list, list], tuple]:
    """One direction of ``many``, whose vmap over directions is ``many`` itself."""

    def alone(x: list, change: list) -> tuple:
        value, changes = many(x, jax.tree.map(lambda d: d[None], change))
        return value, jax.tree.map(lambda d: d[0], changes)

    one = custom_vmap(alone)

    @one.def_vmap
    def _(size, batched, x, change):
        at, along = batched
        changes = [d if b else jnp.broadcast_to(d, (size, *d.shape)) for d, b in zip(change, along, strict=True)]
        if any(at):
            # All points together are one point, whose directions may still come together.
            axes = [0 if b else None for b in at]
            points = jax.vmap(many, in_axes=(axes, 1), out_axes=(0, 1), axis_size=size)
            found = _gathered(points)(x, changes)
            return found, jax.tree.map(lambda _: True, found)
        value, moved = many(x, changes)
        return (value, moved), (jax.tree.map(lambda _: False, value), jax.tree.map(lambda _: True, moved))

    return one


def still(x: Array) -> Any:
    """The tangent of what is not differentiated."""
    return jnp.zeros_like(x) if jnp.issubdtype(x.dtype, jnp.inexact) else np.zeros(x.shape, jax.dtypes.float0)
