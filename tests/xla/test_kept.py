"""A fence between kernels changes no number: values, derivatives of both modes, second derivatives, batches, NaN."""

import jax
import jax.numpy as jnp
import numpy as np

from bcfj_jax.xla import kept as kept_module
from bcfj_jax.xla.kept import each, kept, once


def fenced(x):
    a, b = kept(jnp.sin(x), x * x)
    return jnp.sum(kept(a * b) * a)


def plain(x):
    return jnp.sum(jnp.sin(x) ** 2 * x * x)


def test_values_and_derivatives_go_through():
    x = jnp.linspace(-1.0, 2.0, 7)
    along = jnp.cos(jnp.arange(7.0))
    for change in (jax.grad, jax.jacfwd, lambda f: jax.hessian(f), lambda f: lambda x: jax.jvp(f, (x,), (along,))[1]):
        np.testing.assert_allclose(jax.jit(change(fenced))(x), change(plain)(x), rtol=1e-13, atol=1e-13)
    # One argument of two that moves.
    slope = jax.grad(lambda s: kept(s * x, x)[0].sum())(2.0)
    np.testing.assert_allclose(slope, x.sum())


def test_a_nan_stays_in_its_own_lane():
    rows = jnp.ones((3, 7)).at[0].set(jnp.nan).at[1].multiply(2.0)
    found = jax.jit(jax.vmap(fenced))(rows)
    assert jnp.isnan(found[0])
    np.testing.assert_allclose(found[1:], [plain(rows[1]), plain(rows[2])])


def test_once_is_a_branch():
    def tried(wanted, x):
        return once(wanted, lambda: (jnp.sin(x), x + 1.0), (x, x))

    x = jnp.linspace(0.0, 1.0, 3)
    for wanted, expected in ((True, (np.sin(x), x + 1.0)), (False, (x, x))):
        np.testing.assert_allclose(jax.jit(tried)(wanted, x), expected, rtol=1e-15)
    rows, slopes = jax.jvp(lambda x: jax.vmap(tried)(jnp.array([True, False, True]), x), (x,), (jnp.ones(3),))
    np.testing.assert_allclose(rows[0], [0.0, 0.5, np.sin(1.0)])
    np.testing.assert_allclose(slopes[0], [1.0, 1.0, np.cos(1.0)])


def test_each_row_is_the_same_one_after_the_other_and_at_once(monkeypatch):
    matrix, rows = jnp.arange(9.0).reshape(3, 3) + jnp.eye(3), jnp.arange(12.0).reshape(4, 3)
    found = {}
    for on_cpu in (True, False):
        monkeypatch.setattr(kept_module, "on_cpu", lambda on_cpu=on_cpu: on_cpu)
        text = jax.jit(lambda rows: each(lambda row: matrix @ row, rows)).lower(rows).as_text()
        assert ("stablehlo.while" in text) == on_cpu
        found[on_cpu] = each(lambda row: matrix @ row, rows)
    np.testing.assert_allclose(found[True], found[False], rtol=1e-14)
    np.testing.assert_allclose(found[True], rows @ matrix.T, rtol=1e-14)
