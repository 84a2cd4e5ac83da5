"""``forward_and_reverse`` by itself: every transformation of a toy function equals plain JAX on it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import Mesh, PartitionSpec

from bcfj_jax.core.errors import InputError
from bcfj_jax.xla.forward_reverse import forward_and_reverse, reverse_only


def toy(x):
    """Two outputs of two inputs."""
    return {"sum": jnp.sin(x["a"]) * x["b"], "product": x["b"] ** 2}


@jax.custom_jvp
def ahead(x):
    """The toy, which goes through forward differentiation alone: its tangents run in a loop."""
    return toy(x)


@ahead.defjvp
def _(primals, tangents):
    step = lambda kept: (kept[0] + 1, jax.jvp(toy, primals, tangents)[1])  # noqa: E731
    zero = jax.tree.map(jnp.zeros_like, toy(*primals))
    return ahead(*primals), jax.lax.while_loop(lambda kept: kept[0] < 1, step, (0, zero))[1]


@jax.custom_vjp
def back(x):
    """The toy, which goes through reverse differentiation alone."""
    return toy(x)


back.defvjp(lambda x: (toy(x), x), lambda x, ct: jax.vjp(toy, x)[1](ct))


@pytest.mark.parametrize(
    "both",
    [
        pytest.param(forward_and_reverse(ahead, back), id="auto", marks=pytest.mark.full),
        pytest.param(forward_and_reverse(ahead, None), id="forward", marks=pytest.mark.slow),
    ],
)
def test_forward_and_reverse_on_a_toy(both):
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
        "hessian": (lambda f: jax.hessian(f)(x)),
        "jit hessian": (lambda f: jax.jit(jax.hessian(f))(x)),
        "hessian of jit": (lambda f: jax.hessian(jax.jit(f))(x)),
        "jacfwd of jacfwd": (lambda f: jax.jacfwd(jax.jacfwd(f))(x)),
        "jacrev of jacfwd": (lambda f: jax.jacrev(jax.jacfwd(f))(x)),
        "jacrev of jacrev": (lambda f: jax.jacrev(jax.jacrev(f))(x)),
        "third": (lambda f: jax.jacfwd(jax.jacrev(jax.jacfwd(f)))(x)),
        "hessian of a loss": (lambda f: jax.hessian(lambda x: jnp.sum(f(x)["sum"] * f(x)["product"]) ** 2)(x)),
        "vmap of hessian": (lambda f: jax.vmap(jax.hessian(f))(batch)),
        "hessian of one leaf": (lambda f: jax.hessian(lambda a: f({**x, "a": a})["sum"])(x["a"])),
        "linearize": (lambda f: jax.linearize(f, x)[1](dx)),
        "one leaf": (lambda f: jax.grad(lambda a: jnp.sum(f({**x, "a": a})["sum"]))(x["a"])),
    }
    batch_out = jax.tree.map(lambda leaf: jnp.stack([leaf, 2 * leaf, 3 * leaf]), toy(dx))
    plain = ("value", "jvp", "vjp", "vmap", "one leaf")
    # The rest in one program, which compiles sooner.
    rest = {name: use for name, use in uses.items() if name not in plain}
    found, expected = (
        {name: uses[name](f) for name in plain} | jax.jit(lambda f=f: {name: use(f) for name, use in rest.items()})()
        for f in (both, toy)
    )
    for name in uses:
        # Plain JAX on the toy is the oracle; the same arithmetic in another order.
        same = jax.tree.map(lambda p, q: np.allclose(p, q, rtol=1e-13, atol=1e-15), found[name], expected[name])
        assert jax.tree.all(same), name


@pytest.mark.parametrize(
    "both", [forward_and_reverse(ahead, back), forward_and_reverse(ahead, None)], ids=["auto", "forward"]
)
def test_values_and_derivatives_among_devices(both):
    """``shard_map`` keeps account of what varies between devices; what does not has the sum of their gradients."""
    mesh = Mesh(np.array(jax.devices()[:1]), ("i",))
    rows, every = PartitionSpec("i"), PartitionSpec()
    x, b = jnp.linspace(0.1, 0.9, 4), jnp.array([2.0])

    def of(f):
        one = lambda a, b: jnp.sum(f({"a": a[None], "b": b})["sum"])  # noqa: E731
        each = lambda a, b: jax.vmap(jax.value_and_grad(one), (0, None))(a, b)  # noqa: E731
        total = lambda a, b: jax.grad(lambda b: jnp.sum(jax.vmap(one, (0, None))(a, b)))(b)  # noqa: E731
        return lambda a, b: (*each(a, b), jax.lax.psum(total(a, jax.lax.pcast(b, "i", to="varying")), "i"))

    found = jax.jit(jax.shard_map(of(both), mesh=mesh, in_specs=(rows, every), out_specs=(rows, rows, every)))(x, b)
    np.testing.assert_allclose(found[0], np.sin(x) * 2.0, rtol=1e-14)
    np.testing.assert_allclose(found[1], np.cos(x) * 2.0, rtol=1e-14)
    np.testing.assert_allclose(found[2], [np.sum(np.sin(x))], rtol=1e-14)
    over = jax.pmap(jax.grad(lambda a: jnp.sum(both({"a": a, "b": b})["sum"])))
    np.testing.assert_allclose(over(x[None, :1]), np.cos(x[:1])[None] * 2.0, rtol=1e-14)


def test_gradients_are_exported():
    both = forward_and_reverse(ahead, back)
    gradient = jax.jit(jax.grad(lambda a: jnp.sum(both({"a": a, "b": a})["sum"])))
    again = jax.export.deserialize(jax.export.export(gradient)(jnp.ones(2)).serialize())
    np.testing.assert_array_equal(again.call(jnp.array([0.3, 0.4])), gradient(jnp.array([0.3, 0.4])))


@pytest.mark.slow
def test_what_has_gradients_alone_says_so():
    f = lambda a: jnp.sum(back(reverse_only({"a": a, "b": a}))["sum"])  # noqa: E731
    x = jnp.array([0.3, 0.4])
    for gradient in (jax.grad(f), jax.jit(jax.grad(f)), jax.grad(jax.jit(f)), jax.jacrev(f)):
        np.testing.assert_allclose(gradient(x), np.cos(x) * x + np.sin(x), rtol=1e-14)
    np.testing.assert_allclose(jax.vmap(jax.grad(f))(x[None]), (np.cos(x) * x + np.sin(x))[None], rtol=1e-14)
    np.testing.assert_allclose(jax.grad(lambda x: jax.vmap(f)(x).sum())(x[None])[0], jax.grad(f)(x), rtol=1e-14)
    for use in (
        jax.jacfwd(f), jax.jit(jax.jacfwd(f)), jax.hessian(f), jax.jit(jax.hessian(f)), jax.jacrev(jax.jacrev(f)),
        jax.jacrev(jax.jacfwd(f)), jax.hessian(jax.jit(f)), lambda x: jax.jvp(f, (x,), (x,)),
    ):  # fmt: skip
        with pytest.raises(InputError, match=r"'reverse' has gradients alone.*use mode='auto', or 'forward'"):
            use(x)
