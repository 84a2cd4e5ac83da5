"""Diffrax's loop as it is shortened: the same bits, fewer operations, and nobody else's solve."""

import contextlib
import threading

import diffrax._integrate as loop
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from hypothesis import given
from hypothesis import strategies as st

import bcfj_jax as bj
from bcfj_jax.solve import integrate
from bcfj_jax.solve.plan import Plan
from bcfj_jax.xla.diffrax_loop import Below, shortened

TIMES = jnp.linspace(0.0, 1e-4, 21)


@given(st.floats(1e-300, 1e300), st.integers(1, 100))
def test_below_is_as_many_neighbours_down(time, ulps):
    down = np.float64(time)
    for _ in range(ulps):
        down = np.nextafter(down, -np.inf)
    below = Below(time, ulps)
    assert float(below.value()) == down
    assert not below < down
    assert below < np.nextafter(down, np.inf)


def run(scene, differentiable):
    """States of a run; with them their derivative by the damping."""

    def states(damping):
        params, plan = scene.completed(scene.parameters(damping=damping)), Plan(jnp.asarray(1e-6), 1000)
        return integrate.integrate(scene, params, TIMES, plan, differentiable=differentiable).states

    return (lambda damping: jax.jvp(states, (damping,), (1.0,))) if differentiable else states


@pytest.mark.parametrize("differentiable", [False, tiers.slow(True)])
@pytest.mark.parametrize("lanes", [2, tiers.slow(1)])
def test_values_and_derivatives_have_the_same_bits(lanes, differentiable, monkeypatch):
    scene = bj.scenes.impact()
    found, operations = [], []
    for context in (shortened, contextlib.nullcontext):
        monkeypatch.setattr(integrate, "shortened", context)
        jax.clear_caches()
        traced = jax.jit(jax.vmap(run(scene, differentiable))).trace(np.linspace(0.1, 0.2, lanes))
        operations.append(str(traced.jaxpr).count(" nextafter"))
        found.append(traced.lower().compile()(np.linspace(0.1, 0.2, lanes)))
    np.testing.assert_array_equal(*found)
    assert operations[0] == 0
    assert operations[1] >= 1


def test_only_what_is_traced_within_it_is_shortened():
    elsewhere, names = [], vars(loop)
    with shortened():
        assert isinstance(names["eqxi"].prevbefore(1.0), Below)
        other = threading.Thread(target=lambda: elsewhere.append(names["eqxi"].prevbefore))
        other.start()
        other.join()
    assert elsewhere == [eqxi.prevbefore]
    assert names["eqxi"].prevbefore is eqxi.prevbefore
    assert names["eqx"].filter_eval_shape is eqx.filter_eval_shape
