"""``forward_and_reverse`` by itself: every transformation of a toy function equals plain JAX on it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.solve.forward_reverse import forward_and_reverse


def toy(x):
    """Two outputs of two inputs."""
    return {"sum": jnp.sin(x["a"]) * x["b"], "product": x["b"] ** 2}


@pytest.mark.full
def test_forward_and_reverse_on_a_toy():
    both = forward_and_reverse(toy, toy)
    x = {"a": jnp.array([0.3, 0.4]), "b": jnp.array([2.0, -1.0])}
    dx = {"a": jnp.array([1.0, -2.0]), "b": jnp.array([0.5, 3.0])}
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, 2 * leaf, 3 * leaf]), x)
    push = lambda f: lambda p, v: jax.jvp(f, (p,), (v,))[1]  # noqa: E731
    pull = lambda f: lambda p, v: jax.vjp(f, p)[1](v)[0]  # noqa: E731
    uses = {
        "value": (lambda f: f(x)),
        "jit": (lambda f: jax.jit(f)(x)),
        "jvp": (lambda f: push(f)(x, dx)),
        "vjp": (lambda f: pull(f)(x, toy(dx))),
        "jit vjp": (lambda f: jax.jit(pull(f))(x, toy(dx))),
        "vmap": (lambda f: jax.vmap(f)(batch)),
        "vmap jvp over points": (lambda f: jax.vmap(push(f), (0, None))(batch, dx)),
        "vmap jvp over vectors": (lambda f: jax.vmap(push(f), (None, 0))(x, batch)),
        "vmap vjp over points": (lambda f: jax.vmap(pull(f), (0, None))(batch, toy(x))),
        "vmap vjp over vectors": (lambda f: jax.vmap(pull(f), (None, 0))(x, batch_out)),
        "jacfwd of vmap": (lambda f: jax.jit(jax.jacfwd(jax.vmap(f)))(batch)),
        "jacrev of vmap": (lambda f: jax.jit(jax.jacrev(jax.vmap(f)))(batch)),
        "vmap of jacrev": (lambda f: jax.vmap(jax.jacrev(f))(batch)),
        "one leaf": (lambda f: jax.grad(lambda a: jnp.sum(f({**x, "a": a})["sum"]))(x["a"])),
    }
    batch_out = jax.tree.map(lambda leaf: jnp.stack([leaf, 2 * leaf, 3 * leaf]), toy(dx))
    for name, use in uses.items():
        # Plain JAX on the toy is the oracle; the same arithmetic in another order.
        same = jax.tree.map(lambda p, q: np.allclose(p, q, rtol=1e-13, atol=1e-15), use(both), use(toy))
        assert jax.tree.all(same), name
