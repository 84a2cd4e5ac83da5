"""A function that every order and direction of differentiation goes through, each by its own cheap method.

diffrax offers an adjoint for either direction; the one that does both costs time in proportion to the step budget.
``forward_and_reverse`` makes one primitive of the function. Its tangent map is the same primitive again, linear in some
operands, which knows its transpose: only the direction that is asked for is traced. Derivatives of derivatives go by
forward differentiation alone, whatever their order; where one is to be transposed, it is computed column by column.
JAX looks into the primitive only where it is compiled. So ``shard_map`` and ``pmap`` do not ask how loops inside vary
from device to device. (``jax.custom_derivatives.linear_call`` is the first derivative of this, without vmap.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.sharding import AbstractMesh, NamedSharding, PartitionSpec

from bcfj_jax.core.errors import InputError
from bcfj_jax.xla import inside
from bcfj_jax.xla.inside import NOT_MAPPED, Primitive, ShapedArray, ad

X = TypeVar("X")
Y = TypeVar("Y")
Leaves = Sequence[Array]


class _Map(NamedTuple):
    """What the primitive computes: (points, vectors) -> outs, linear in the vectors."""

    smooth: Callable[[Leaves, Leaves], list[Array]]  # the map, which goes through ``jax.jvp`` any number of times
    quick: Callable[[Leaves, Leaves], list[Array]]  # the same where it is only evaluated
    pull: Callable[[Leaves, Leaves], list[Array]]  # its transpose, (points, cotangents) -> vectors
    # Of a map without vectors the function again, which goes through ``jax.vjp``; None for none.
    reverse: Callable[[Leaves], list[Array]] | None
    # vectors, outs: shapes.
    vectors: tuple[jax.ShapeDtypeStruct, ...]
    outs: tuple[jax.ShapeDtypeStruct, ...]
    # Of a function and its tangents together, how many points, the last, the first half of the outs does not depend on:
    # the ways in which the tangents go.
    ways: int = 0


# Operands: the points (so many), then the vectors.
_map_p = Primitive("forward_and_reverse")
_map_p.multiple_results = True


def _bound(operands: Leaves, points: int, of: _Map) -> list[Array]:
    """The primitive; what varies from device to device under ``shard_map`` does so in all operands."""
    varying = [jax.typeof(x).mat.varying for x in operands]
    axes = frozenset().union(*varying)
    if axes:
        operands = [
            jax.lax.pcast(x, tuple(sorted(axes - v)), to="varying") for x, v in zip(operands, varying, strict=True)
        ]
    return _map_p.bind(*operands, points=points, of=of)


def _by_columns(smooth: Callable[[Leaves, Leaves], list[Array]], vectors: tuple[jax.ShapeDtypeStruct, ...]) -> Any:
    """The transpose of a map, from what it makes of every unit vector."""

    def pull(at: Leaves, cotangents: Leaves) -> list[Array]:
        sizes = [math.prod(v.shape) for v in vectors]
        units = jnp.split(jnp.eye(sum(sizes)), list(_running(sizes)), axis=1)
        basis = [u.reshape(-1, *v.shape).astype(v.dtype) for u, v in zip(units, vectors, strict=True)]
        columns = jax.vmap(lambda *unit: smooth(at, unit))(*basis)
        found = sum(jnp.tensordot(out, c, axes=c.ndim) for out, c in zip(columns, cotangents, strict=True))
        parts = jnp.split(jnp.asarray(found), list(_running(sizes)))
        return [x.reshape(v.shape).astype(v.dtype) for x, v in zip(parts, vectors, strict=True)]

    return pull


def _running(sizes: Sequence[int]) -> list[int]:
    """Where a row of so many parts is cut."""
    return [sum(sizes[: i + 1]) for i in range(len(sizes) - 1)]


def _shapes(leaves: Leaves) -> tuple[jax.ShapeDtypeStruct, ...]:
    return tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves)


def _evaluate(*operands, points, of):
    return of.quick(operands[:points], operands[points:])


def _abstract(*operands, points, of):
    plain = [ShapedArray(s.shape, s.dtype) for s in of.outs]
    first = operands[0]
    if not first.mat.varying:
        return plain
    mesh = first.sharding.mesh
    return [
        a.update(sharding=NamedSharding(mesh, PartitionSpec(*[None] * a.ndim)), manual_axis_type=first.mat)
        for a in plain
    ]


def _derivative(primals, tangents, *, points, of):
    moving = [i for i, t in enumerate(tangents[:points]) if not isinstance(t, ad.Zero)]
    split = any(inside.to_be_transposed(t) for t in tangents)

    def moved(at: Leaves, new: Leaves) -> Leaves:
        return [new[moving.index(i)] if i in moving else x for i, x in enumerate(at)]

    if moving and not (of.vectors or of.reverse or split):
        # Nobody will transpose this: value and tangents at once.
        def both(at: Leaves, _: Leaves) -> list[Array]:
            x, ways = at[:points], at[points:]
            along = lambda *new: of.smooth(moved(x, new), [])  # noqa: E731
            return [y for part in jax.jvp(along, tuple(x[i] for i in moving), tuple(ways)) for y in part]

        pair = [*primals, *(tangents[i] for i in moving)]
        found = _bound(pair, len(pair), of._replace(smooth=both, quick=both, outs=of.outs * 2, ways=len(moving)))
        return found[: len(of.outs)], found[len(of.outs) :]
    values = _bound(primals, points, of)
    changes: list[list[Array]] = []
    if moving:

        def smooth(at: Leaves, ways: Leaves) -> list[Array]:
            x, fixed = at[:points], at[points:]
            along = lambda *new: of.smooth(moved(x, new), fixed)  # noqa: E731
            return jax.jvp(along, tuple(x[i] for i in moving), tuple(ways))[1]

        def pull(at: Leaves, cotangents: Leaves) -> list[Array]:
            assert of.reverse is not None
            along = lambda *new: of.reverse(moved(at, new))  # noqa: E731
            return list(jax.vjp(along, *(at[i] for i in moving))[1](list(cotangents)))

        ways = [tangents[i] for i in moving]
        back = pull if of.reverse is not None else _by_columns(smooth, _shapes(ways))
        more = _Map(smooth, smooth, back, None, _shapes(ways), of.outs)
        changes.append(_bound([*primals, *ways], len(primals), more))
    if not all(isinstance(t, ad.Zero) for t in tangents[points:]):
        ways = [ad.instantiate_zeros(t) for t in tangents[points:]]
        changes.append(_bound([*primals[:points], *ways], points, of))
    if not changes:
        return values, [ad.Zero(jax.typeof(x).to_tangent_aval()) for x in values]
    return values, changes[0] if len(changes) == 1 else [a + b for a, b in zip(*changes, strict=True)]


def _transpose(cotangents, *operands, points, of):
    dense = [ad.instantiate_zeros(c) for c in cotangents]
    back = _Map(_by_columns(of.smooth, of.vectors), of.pull, of.quick, None, of.outs, of.vectors)
    out = _bound([*operands[:points], *dense], points, back)
    linear = [ad.is_undefined_primal(x) for x in operands[points:]]
    return [None] * points + [c if is_linear else None for c, is_linear in zip(out, linear, strict=True)]


def _batch(operands, axes, *, points, of):
    size = next(x.shape[a] for x, a in zip(operands, axes, strict=True) if a is not NOT_MAPPED)
    moved = [x if a is NOT_MAPPED else jnp.moveaxis(x, a, 0) for x, a in zip(operands, axes, strict=True)]
    point_axes = [None if a is NOT_MAPPED else 0 for a in axes[:points]]

    def each(x: Array, axis: int | None) -> Array:
        # JAX 0.12 refuses a custom vjp some of whose results are the same for the whole batch.
        return jnp.broadcast_to(x, (size, *x.shape)) if axis is None else x

    # Vectors are broadcast so that the batched map and its transpose have the same shape of arguments.
    vectors = [each(x, None if a is NOT_MAPPED else 0) for x, a in zip(moved[points:], axes[points:], strict=True)]
    # Values beside tangents of several ways are the same for all of them.
    same = len(of.outs) // 2 if all(a is None for a in point_axes[: points - of.ways]) and of.ways else 0
    out_axes = [None] * same + [0] * (len(of.outs) - same)
    wide = lambda shapes: tuple(jax.ShapeDtypeStruct((size, *s.shape), s.dtype) for s in shapes)  # noqa: E731

    def many(f: Callable[..., list[Array]], axes: Any) -> Callable[..., list[Array]]:
        return lambda at, ways: jax.vmap(lambda at, ways: list(f(at, ways)), (point_axes, 0), axes)(
            list(at), list(ways)
        )

    batched = of._replace(
        smooth=many(of.smooth, out_axes),
        quick=many(of.quick, out_axes),
        pull=many(of.pull, 0),
        reverse=of.reverse and (lambda at: jax.vmap(of.reverse)([*map(each, at, point_axes)])),
        vectors=wide(of.vectors),
        outs=of.outs[:same] + wide(of.outs[same:]),
    )
    return _bound([*moved[:points], *vectors], points, batched), [NOT_MAPPED if a is None else a for a in out_axes]


def _lowered(ctx, *operands, **what):
    """Compiled as for one device: nothing within asks what varies between devices."""
    plain = [ShapedArray(a.shape, a.dtype) for a in ctx.avals_in]
    with jax.sharding.use_abstract_mesh(AbstractMesh((), ())):
        return inside.lowered_by(_evaluate, multiple_results=True)(ctx.replace(avals_in=plain), *operands, **what)


_map_p.def_impl(_evaluate)
_map_p.def_abstract_eval(_abstract)
ad.primitive_jvps[_map_p] = _derivative
ad.primitive_transposes[_map_p] = _transpose
inside.batchers[_map_p] = _batch
inside.register_lowering(_map_p, _lowered)


def forward_and_reverse(
    forward: Callable[[X], Y], reverse: Callable[[X], Y] | None, value: Callable[[X], Y] | None = None
) -> Callable[[X], Y]:
    """One function out of two that compute the same: one with a jvp, one with a vjp.

    Both must be closed over static things only: everything traced is in their argument, arrays all.
    Where there is a reverse, the value is computed beside the tangents, so a jvp costs one evaluation more than
    ``forward``'s. Second derivatives, those of ``jax.hessian`` too, are tangents of tangents, one for each pair of the
    scalars that they are taken by.

    Args:
        forward: the function, supporting ``jax.jvp`` (of any order).
        reverse: the same function, supporting ``jax.vjp``; None where gradients are to be made of tangents.
        value: the same function where no derivative is asked for, if another way to it is cheaper.
    """

    def function(x: X) -> Y:
        leaves, structure = jax.tree.flatten(jax.tree.map(jnp.asarray, x))
        # Of the shapes alone, which do not vary between devices.
        shapes = jax.tree.unflatten(structure, _shapes(leaves))
        out = jax.eval_shape(forward if value is None else value, shapes)
        outs, of_outs = jax.tree.flatten(out)

        def flat(f: Callable[[X], Y]) -> Callable[[Leaves], list[Array]]:
            return lambda at: jax.tree.leaves(f(jax.tree.unflatten(structure, at)))

        smooth, quick = flat(forward), flat(value or forward)
        back = flat(reverse) if reverse else None
        of = _Map(lambda at, _: smooth(at), lambda at, _: quick(at), lambda at, _: [], back, (), _shapes(outs))
        return jax.tree.unflatten(of_outs, _bound(leaves, len(leaves), of))

    return function


# Around a function that has a vjp alone: whoever evaluates a tangent of it, or differentiates its gradient, is told so.
_reverse_only_p, _tangent_p, _gradient_p = map(Primitive, ("reverse_only", "reverse_tangent", "reverse_gradient"))


def _no_tangent(*_, **__):
    found = "'reverse' has gradients alone: no tangents (jvp, jacfwd) and no second derivatives (hessian)"
    raise InputError("mode", found, "use mode='auto', or 'forward'")


for _p in (_reverse_only_p, _tangent_p, _gradient_p):
    _p.def_abstract_eval(lambda x: x)
    _p.def_impl(lambda x: x)
    inside.elementwise(_p)
    inside.register_lowering(_p, lambda _, x: [x])
_tangent_p.def_impl(_no_tangent)
inside.register_lowering(_tangent_p, _no_tangent)
inside.batchers[_tangent_p] = ad.primitive_jvps[_gradient_p] = _no_tangent
ad.defjvp(_reverse_only_p, lambda dx, _: _tangent_p.bind(dx))
ad.deflinear2(_tangent_p, lambda ct, _: [ct if isinstance(ct, ad.Zero) else _gradient_p.bind(ct)])


def reverse_only(x: X) -> X:
    """The same arrays; where a tangent of them is evaluated, an ``InputError`` says that mode='reverse' has none."""
    return jax.tree.map(_reverse_only_p.bind, x)
