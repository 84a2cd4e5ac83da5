"""The implicit solvers on problems with known answers: order, stability, tangents."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bcfj_jax.mechanism.structure import Dense
from bcfj_jax.solve.rodas import Rodas
from bcfj_jax.solve.sdirk import Sdirk
from bcfj_jax.solve.tangents import SdirkTangents


def pol(t, y, mu):
    """Van der Pol, driven: nonlinear, depends on time."""
    return jnp.stack([y[1], mu * ((1 - y[0] ** 2) * y[1]) - y[0] + jnp.sin(3 * t)])


THETAS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])


def run(solver, args, y0, end, steps):
    """Equal steps: the last state, and states (steps, 5, n) within every step, at ``THETAS`` of it."""
    h = end / steps

    def step(carry, t0):
        y, memory = carry
        y1, _, dense, memory, _ = solver.step(None, t0, t0 + h, y, args, memory, False)
        inside = solver.interpolation_cls(t0=t0, t1=t0 + h, **dense)
        return (y1, memory), jax.vmap(inside.evaluate)(t0 + THETAS * h)

    start = (y0, solver.init(None, 0.0, h, y0, args))
    (last, _), within_steps = jax.lax.scan(step, start, h * jnp.arange(steps))
    return last, within_steps


def sdirk(function, size: int = 2) -> Sdirk:
    return Sdirk(Dense(function), jnp.full(size, 1e-11))


def tangents(function, size: int = 2) -> SdirkTangents:
    """Every step is good, for one that is not has no tangents, and Newton as strict as above."""
    return SdirkTangents(Sdirk(Dense(function), jnp.full(size, 1e3), newton=2e-16))


@functools.cache
def reference():
    def right(t, y):
        return [y[1], 2 * ((1 - y[0] ** 2) * y[1]) - y[0] + np.sin(3 * t)]

    return solve_ivp(right, (0, 2), [2.0, 0.0], rtol=1e-12, atol=1e-13, method="DOP853", dense_output=True)


@pytest.mark.full
@pytest.mark.parametrize(("solver", "order"), [(Rodas(Dense(pol)), 3), (sdirk(pol), 2)], ids=["rodas", "sdirk"])
def test_orders_of_convergence(solver, order):
    ends, insides = [], []
    for steps in (40, 80, 160):
        last, inside = jax.jit(functools.partial(run, solver, steps=steps))(2.0, jnp.array([2.0, 0.0]), 2.0)
        ends.append(abs(np.asarray(last) - reference().y[:, -1]).max())
        times = (np.arange(steps)[:, None] + THETAS) * 2.0 / steps
        wanted = reference().sol(np.ravel(times)).T.reshape(steps, 5, 2)
        insides.append(abs(np.asarray(inside) - wanted).max())
    rates = {name: np.log2(np.array(e[:-1]) / e[1:]) for name, e in (("end", ends), ("inside", insides))}
    assert np.all(rates["end"] > order - 0.35) and np.all(rates["end"] < order + 0.8)
    assert np.all(rates["inside"] > order - 0.35)
    assert ends[-1] < (1e-5 if order == 3 else 1e-3)
    assert solver.order(None) == order


def stiff(t, y, rate):
    return -rate * (y - jnp.cos(t))


@pytest.mark.parametrize("solver", [Rodas(Dense(stiff)), sdirk(stiff, 1)], ids=["rodas", "sdirk"])
def test_l_stability(solver):
    # What is off the slow solution vanishes as 1/(h rate) in one step; the slow solution is followed.
    one, many = (jax.jit(functools.partial(run, solver, steps=steps)) for steps in (1, 20))
    for rate in (1e4, 1e8, 1e12):
        off, on = (float(one(rate, jnp.array([y0]), 0.1)[0][0]) for y0 in (2.0, 1.0))
        assert abs(off - on) < 20.0 / (0.1 * rate) + 1e-15
        assert abs(float(many(rate, jnp.array([2.0]), 1.0)[0][0]) - np.cos(1.0)) < 1e-3


def spun(t, y, rate):
    del t
    return rate * jnp.stack([y[1], -y[0]])


@pytest.mark.parametrize("solver", [Rodas(Dense(spun)), sdirk(spun)], ids=["rodas", "sdirk"])
def test_a_stability_on_the_imaginary_axis(solver):
    step = jax.jit(lambda rate: run(solver, rate, jnp.array([1.0, 0.0]), 1.0, 1)[0])
    sizes = np.array([float(jnp.linalg.norm(step(rate))) for rate in 10.0 ** np.arange(-2, 7)])
    assert np.all(sizes <= 1.0 + 1e-9)
    assert sizes[-1] < 1e-3


@pytest.mark.full
def test_tangents_of_sdirk_are_those_of_its_values():
    solver, x = sdirk(pol), np.array([2.0, 0.3, 2.0])
    value = jax.jit(lambda x: run(solver, x[2], x[:2], 2.0, 60)[0])
    rows, changes = jnp.asarray([x[:2], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), jnp.array([0.0, 0.0, 1.0])
    found = np.asarray(jax.jit(lambda rows: run(tangents(pol), (x[2], changes), rows, 2.0, 60)[0])(rows))
    assert np.allclose(found[0], np.asarray(value(x)), rtol=1e-10)
    h = 1e-4
    for k in range(3):
        up, down = (np.asarray(value(x + s * h * np.eye(3)[k])) for s in (1, -1))
        assert np.allclose(found[1 + k], (up - down) / (2 * h), rtol=1e-7, atol=1e-7 * abs(found[1:]).max())


def test_tangents_of_sdirk_are_bounded_however_stiff():
    # h J = -1e6: the state follows sin(p t) + start's remainder; its tangents follow t cos(p t) and nothing.
    def follow(t, y, p):
        return -1e7 * (y - jnp.sin(p * t)) * (1.0 + 0.1 * y * y)

    solver, changes = tangents(follow, 1), jnp.array([0.0, 1.0])
    final = jax.jit(lambda rows: run(solver, (jnp.asarray(1.3), changes), rows, 1.0, 10)[0])
    value, by_start, by_p = np.asarray(final(jnp.array([[0.5], [1.0], [0.0]])))[:, 0]
    assert value == pytest.approx(np.sin(1.3), abs=1e-5)
    assert abs(by_start) < 1e-5
    assert by_p == pytest.approx(np.cos(1.3), abs=1e-4)
