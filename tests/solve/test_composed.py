"""``force_history`` of an impact among devices, exported, and differentiated twice: as plain derivatives are."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from jax.sharding import Mesh, PartitionSpec

import bcfj_jax as bj
from bcfj_jax.solve import named
from bcfj_jax.solve.plan import plan

SCENE = bj.scenes.impact()
PARAMS = SCENE.parameters(mass=0.5)
TIMES = np.linspace(0.0, 60e-6, 21)


def total(x, mode):
    """A number of a run of a mass and a damping."""
    params = {**PARAMS, "mass": x[0], "damping": x[1]}
    return 1e-5 * jnp.sum(bj.force_history(SCENE, params, TIMES, mode=mode)["contact"][:, 0])


@functools.cache
def slope_of_one(mode):
    return jax.jit(jax.grad(lambda x: total(x, mode)))(jnp.array([0.5, 0.1]))


# In CI's tier test_forward_reverse.py has every way on a function of one line.
@pytest.mark.slow
@pytest.mark.parametrize("mode", ["auto", "forward", "reverse"])
@pytest.mark.parametrize("way", ["shard_map", "pmap", "export"])
def test_gradients_among_devices_and_exported(mode, way):
    x = jnp.array([[0.5, 0.1]])
    slope = jax.grad(lambda x: total(x, mode))
    if way == "shard_map":
        mesh, rows = Mesh(np.array(jax.devices()[:1]), ("i",)), PartitionSpec("i")
        found = jax.jit(jax.shard_map(jax.vmap(slope), mesh=mesh, in_specs=rows, out_specs=rows))(x)[0]
    elif way == "pmap":
        found = jax.pmap(slope)(x)[0]
    else:
        found = jax.export.deserialize(jax.export.export(jax.jit(slope))(x[0]).serialize()).call(x[0])
    np.testing.assert_allclose(found, slope_of_one(mode), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("mode", tiers.ci(["auto", "forward"], "forward"))
def test_hessians_are_differences_of_gradients(mode):
    x, step = jnp.array([0.5, 0.1]), 1e-4
    found = jax.jit(jax.hessian(lambda x: total(x, mode)))(x)
    slope = jax.jit(jax.jacfwd(lambda x: total(x, mode)))
    ends = [jnp.stack([slope(x + s * step * e) for e in jnp.eye(2)]) for s in (1, -1)]
    np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2 * step), rtol=2e-3)


DERIVATIVES = {"grad": jax.grad, "jacfwd": jax.jacfwd, "jacrev": jax.jacrev, "jvp": lambda f: lambda x: jax.jvp(f, (x,), (x,))[1],
               "hessian": jax.hessian}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n == "jacfwd" else pytest.mark.slow) for n in DERIVATIVES],
)
def test_derivatives_of_a_batch_are_those_of_its_runs(name):
    """vmap of a derivative and the derivative of a vmap, compiled and not, against one run after the other.

    Those that are slow: test_forward_reverse.py has them on a function of one line.
    """
    x, derivative = jnp.array([[0.5, 0.1], [0.3, 0.2]]), DERIVATIVES[name](lambda x: total(x, "auto"))
    one = jnp.stack([jax.jit(derivative)(row) for row in x])
    np.testing.assert_allclose(jax.vmap(derivative)(x), one, rtol=1e-6)
    np.testing.assert_allclose(jax.jit(jax.vmap(derivative))(x), one, rtol=1e-6)
    if name in ("jacfwd", "jacrev"):
        both = DERIVATIVES[name](lambda x: jax.vmap(lambda row: total(row, "auto"))(x))(x)
        np.testing.assert_allclose(jnp.stack([both[i, i] for i in range(2)]), one, rtol=1e-6)


@pytest.mark.full
def test_reverse_alone_names_the_mode_to_use():
    for use in (jax.jacfwd, jax.hessian):
        with pytest.raises(bj.InputError, match=r"mode: 'reverse' has gradients alone.*use mode='auto', or 'forward'"):
            use(lambda x: total(x, "reverse"))(jnp.array([0.5, 0.1]))


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, *(pytest.param(s, marks=pytest.mark.slow) for s in named.NOT_STIFF)])
def test_derivatives_after_a_contact_are_those_of_the_motion(solver):
    """At "balanced", of every explicit solver and both directions: a body leaves a linear spring after T = pi sqrt(m/K).

    From then on x = x_0 - v (t - t_0 - T), so that dx/dK = v dT/dK = -v T/(2 K).
    """
    stiffness, mass = 1e7, 0.1
    given = {"exponent": 1.0, "damping": 0.0, "smoothing": 0.0, "mass": mass, "approach_speed": 1.0}
    params = SCENE.parameters({**given, "clearance_contact": 1e-5})
    period = np.pi * np.sqrt(mass / stiffness)
    times = 1e-5 + period + np.array([1e-4, 3e-4])
    how = plan(SCENE, "balanced", solver=solver)

    def place(k, mode="forward"):
        values = {**params, "stiffness": k}
        return bj.reading_history(SCENE, values, times, ["body.position"], accuracy=how, mode=mode)["body.position"]

    exact = -period / (2.0 * stiffness)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(place))(stiffness), exact, rtol=5e-3)
    for mode in ("forward", "reverse"):
        np.testing.assert_allclose(jax.jit(jax.grad(lambda k, m=mode: place(k, m)[-1]))(stiffness), exact, rtol=5e-3)
    if solver is None:
        with pytest.raises(bj.InputError, match="'auto' is of force_history alone"):
            place(stiffness, "auto")
