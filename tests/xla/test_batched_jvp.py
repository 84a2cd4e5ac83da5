"""One call for all directions: ``together`` against JAX's own derivative of a toy."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.xla.batched_jvp import together

CALLS = []


def plain(x):
    a, b = x
    return jnp.sin(a) * b, jnp.sum(a > 0)


def ahead(x, changes):
    a, b = x
    da, db = changes
    CALLS.append(tuple(None if d is None else d.shape for d in changes))
    along = jnp.zeros(())
    along = along if da is None else along + jnp.cos(a) * b * da
    along = along if db is None else along + jnp.sin(a) * db
    return plain(x), along


F = together(plain, ahead)
A, B = jnp.array([0.3, -1.0, 2.0]), jnp.array([1.0, 2.0, 3.0])


def value(function):
    return lambda a, b: function((a, b))[0]


def test_all_directions_in_one_call():
    CALLS.clear()
    found = jax.jit(jax.jacfwd(value(F)))(A, B)
    # What is not moved is None. JAX traces one direction alone, too, and drops it.
    assert CALLS == [((1, 3), None), ((3, 3), None)]
    assert np.allclose(found, jax.jacfwd(value(plain))(A, B), rtol=1e-15)
    _, slope = jax.jvp(value(F), (A, B), (B, A))
    assert np.allclose(slope, jax.jvp(value(plain), (A, B), (B, A))[1], rtol=1e-15)
    assert F((A, B))[1] == 2


def test_batches_of_points_and_of_directions():
    points = jnp.stack([A, 2 * A])
    for other in (None, 0):
        b = B if other is None else jnp.stack([B, -B])
        maps = [jax.jit(jax.vmap(jax.jacfwd(value(f)), (0, other))) for f in (F, plain)]
        assert np.allclose(maps[0](points, b), maps[1](points, b), rtol=1e-14)
    # Directions outside, points inside.
    outer = [
        jax.vmap(lambda v, f=f: jax.jvp(jax.vmap(lambda a: value(f)(a, B)), (points,), (v,))[1]) for f in (F, plain)
    ]
    ways = jnp.stack([points, jnp.ones_like(points), -points])
    assert np.allclose(outer[0](ways), outer[1](ways), rtol=1e-14)


@pytest.mark.slow
def test_directions_outside_a_batch_of_points_come_together():
    points = jnp.stack([A, 2 * A])
    CALLS.clear()
    found = jax.jit(jax.jacfwd(jax.vmap(lambda a: value(F)(a, B))))(points)
    assert CALLS[-1] == ((6, 3), None)
    assert np.allclose(found, jax.jacfwd(jax.vmap(lambda a: value(plain)(a, B)))(points), rtol=1e-14)
