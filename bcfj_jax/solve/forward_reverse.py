"""A function that forward and reverse differentiation both go through, each by its own cheap method.

diffrax offers an adjoint for either direction; the one that does both costs time in proportion to the
step budget. ``forward_and_reverse`` gives JAX the tangent map as one linear primitive that knows its transpose, and
traces only the direction that is asked for. (``jax.custom_derivatives.linear_call`` is this without vmap.)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

X = TypeVar("X")
Y = TypeVar("Y")

# Operands: the point (``points`` arrays), then the vector. ``push`` and ``pull`` map (point, vector) -> vector.
_linear_p = Primitive("forward_and_reverse_linear")
_linear_p.multiple_results = True


def _apply(*operands, points, push, pull, shapes):
    del pull, shapes
    return push(list(operands[:points]), list(operands[points:]))


def _abstract(*operands, points, push, pull, shapes):
    del operands, points, push, pull
    return [ShapedArray(s.shape, s.dtype) for s in shapes[1]]


def _transpose(cotangents, *operands, points, push, pull, shapes):
    dense = [
        jnp.zeros(s.shape, s.dtype) if isinstance(c, ad.Zero) else c for c, s in zip(cotangents, shapes[1], strict=True)
    ]
    out = _linear_p.bind(*operands[:points], *dense, points=points, push=pull, pull=push, shapes=shapes[::-1])
    linear = [ad.is_undefined_primal(x) for x in operands[points:]]
    return [None] * points + [c if is_linear else None for c, is_linear in zip(out, linear, strict=True)]


def _batch(operands, axes, *, points, push, pull, shapes):
    size = next(x.shape[a] for x, a in zip(operands, axes, strict=True) if a is not batching.not_mapped)
    moved = [x if a is batching.not_mapped else jnp.moveaxis(x, a, 0) for x, a in zip(operands, axes, strict=True)]
    point_axes = [None if a is batching.not_mapped else 0 for a in axes[:points]]
    # Vectors are broadcast so that the batched map and its transpose have the same shape of arguments.
    vectors = [
        jnp.broadcast_to(x, (size, *x.shape)) if a is batching.not_mapped else x
        for x, a in zip(moved[points:], axes[points:], strict=True)
    ]
    batched = tuple(tuple(jax.ShapeDtypeStruct((size, *s.shape), s.dtype) for s in side) for side in shapes)
    out = _linear_p.bind(
        *moved[:points],
        *vectors,
        points=points,
        push=jax.vmap(push, in_axes=(point_axes, 0)),
        pull=jax.vmap(pull, in_axes=(point_axes, 0)),
        shapes=batched,
    )
    return out, [0] * len(out)


_linear_p.def_impl(_apply)
_linear_p.def_abstract_eval(_abstract)
ad.primitive_transposes[_linear_p] = _transpose
batching.primitive_batchers[_linear_p] = _batch
mlir.register_lowering(_linear_p, mlir.lower_fun(_apply, multiple_results=True))


def forward_and_reverse(
    forward: Callable[[X], Y], reverse: Callable[[X], Y], value: Callable[[X], Y] | None = None
) -> Callable[[X], Y]:
    """One function out of two that compute the same: one with a jvp, one with a vjp.

    Both must be closed over static things only: everything traced is in their argument, arrays all.
    First derivatives only; differentiating twice raises, since ``forward`` alone can do that.
    The value is computed beside the tangents, so a jvp costs one evaluation more than ``forward``'s.

    Args:
        forward: the function, supporting ``jax.jvp``.
        reverse: the same function, supporting ``jax.vjp``.
        value: the same function where no derivative is asked for, if another way to it is cheaper.
    """
    value = forward if value is None else value

    @jax.custom_jvp
    def function(x: X) -> Y:
        return value(x)

    @function.defjvp
    def _(primals, tangents):
        point = eqx.internal.nondifferentiable(
            primals[0], msg="only first derivatives go through mode='auto'; use mode='forward' for higher ones"
        )
        values = value(point)
        leaves, structure = jax.tree.flatten(point)
        vectors = jax.tree.leaves(tangents[0])
        out_leaves, out_structure = jax.tree.flatten(values)

        def push(at, vector):
            x, dx = jax.tree.unflatten(structure, at), jax.tree.unflatten(structure, vector)
            return jax.tree.leaves(jax.jvp(forward, (x,), (dx,))[1])

        def pull(at, vector):
            _, transpose = jax.vjp(reverse, jax.tree.unflatten(structure, at))
            return jax.tree.leaves(transpose(jax.tree.unflatten(out_structure, vector))[0])

        shapes = tuple(tuple(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in side) for side in (vectors, out_leaves))
        changes = _linear_p.bind(*leaves, *vectors, points=len(leaves), push=push, pull=pull, shapes=shapes)
        return values, jax.tree.unflatten(out_structure, changes)

    return function
