"""Derivatives against variational equations that SciPy integrates, and against closed forms."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import close
from scipy.integrate import solve_ivp

from bcfj_jax import force_history, scenes
from bcfj_jax.contact.restitution import delivered_restitution, undamped_duration, undamped_peak
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import Plan

STRUCK = ("stiffness", "exponent", "damping", "mass")
FRACTIONS = np.array([0.15, 0.4, 0.6, 0.85])
TIGHT = Plan(jnp.asarray(1e-14))
# Stiffness, exponent, mass and approach speed of the closed forms, the undamped duration and peak they give.
AT = (1e10, 1.5, 0.02, 1.5)
DURATION, PEAK = float(undamped_duration(*AT)), float(undamped_peak(*AT))


class Exact:
    """A mass on a surface by ``memory_free`` with smoothed onset, and its variational equations, by SciPy.

    F = r' K r^n (1 + a d'), r(d) the onset of half-width w. State: penetration d, its rate, and the derivatives of
    both by the logarithms of K, n, a, m and of the start's height (falling under ``gravity``) or speed (without).
    """

    def __init__(self, theta, width, gravity):
        self.theta, self.width, self.gravity = np.asarray(theta, float), width, gravity

    def onset(self, d):
        """The onset r, r' and r''; a polynomial of s = (d + w)/2w below d = w."""
        w = self.width
        if d >= w:
            return max(d, 0.0), float(d > 0), 0.0
        s = max((d + w) / (2 * w), 0.0)
        ramp = 2 * w * s**4 * (2.5 - 3 * s + s**2)
        return ramp, s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / (2 * w)

    def force(self, d, rate):
        """Force, and its derivatives by d, d', and the five logarithms at fixed motion."""
        k, n, a, _, _ = self.theta
        r, slope, bend = self.onset(d)
        if r <= 0.0:
            return 0.0, 0.0, 0.0, np.zeros(5)
        damped, power = 1 + a * rate, k * r**n
        force = slope * power * damped
        by_depth = (bend * power + n * slope**2 * power / r) * damped
        by_logs = np.array([force, force * n * np.log(r), slope * power * a * rate, 0.0, 0.0])
        return force, by_depth, slope * power * a, by_logs

    def right(self, _, y):
        m = self.theta[3]
        force, by_depth, by_rate, by_logs = self.force(y[0], y[1])
        slopes = y[2:].reshape(2, 5)
        push = by_depth * slopes[0] + by_rate * slopes[1] + by_logs
        push[3] -= force
        return np.concatenate([[y[1], self.gravity - force / m], slopes[1], -push / m])

    def contacts(self, count):
        """Dense outputs of the first contacts, each with its start and end."""
        start, g = self.theta[4], self.gravity
        y, now, found = np.zeros(12), 0.0, []
        if g:
            y[0], y[2 + 4] = -start, -start
        else:
            y[0], y[1], y[7 + 4] = -self.width, start, start

        def leaves(_, y):
            return y[0] + self.width

        leaves.terminal, leaves.direction = True, -1
        for _ in range(count):
            if g:
                # Flight: d'' = g, to d = -w.
                wait = (-y[1] + np.sqrt(y[1] ** 2 - 2 * g * (y[0] + self.width))) / g
                y = np.concatenate([[-self.width, y[1] + g * wait], y[2:7] + wait * y[7:], y[7:]])
                now += wait
            size = np.concatenate([[1e-3, 1.0], np.full(10, 1.0)])
            run = solve_ivp(self.right, (now, now + 1.0), y, method="DOP853", rtol=1e-12, atol=1e-13 * size,
                            events=leaves, dense_output=True)  # fmt: skip
            found.append((now, run.t[-1], run.sol))
            # The first instant past the surface begins a flight, not a contact.
            y, now = run.y[:, -1].copy(), run.t[-1]
        return found

    def slopes(self, sol, t):
        """Force and its derivatives by the five logarithms at fixed times (T,)."""
        forces, columns = [], []
        for y in sol(t).T:
            force, by_depth, by_rate, by_logs = self.force(y[0], y[1])
            forces.append(force)
            columns.append(by_depth * y[2:7] + by_rate * y[7:] + by_logs)
        return np.array(forces), np.array(columns)


def agree_with_exact(scene, names, theta, fixed, exact, contacts, relative):
    """Force and Jacobian by logarithms in the middle of some contacts, in units of each contact's largest entries."""
    every = exact.contacts(max(contacts))
    found = [every[i - 1] for i in contacts]
    times = [begin + FRACTIONS * (end - begin) for begin, end, _ in found]

    def force(logs):
        values = {name: value * jnp.exp(log) for name, value, log in zip(names, theta, logs, strict=True)}
        history = force_history(scene, scene.parameters({**values, **fixed}), np.concatenate(times),
                                accuracy=TIGHT, mode="forward")  # fmt: skip
        return history["contact"][:, 0]

    values, jacobian = jax.jit(lambda x: (force(x), jax.jacfwd(force)(x)))(jnp.zeros(5))
    for i, (t, (_, _, sol)) in enumerate(zip(times, found, strict=True)):
        here = slice(i * FRACTIONS.size, (i + 1) * FRACTIONS.size)
        expected, columns = exact.slopes(sol, t)
        assert np.allclose(values[here], expected, rtol=0, atol=relative * expected.max())
        close(jacobian[here], columns, relative)


@pytest.mark.slow
def test_impact_against_variational_equations():
    # The start is at the edge of the onset: no kink within the run.
    width, theta = 4e-6, (1e10, 1.5, 0.1, 0.02, 1.5)
    names = (*STRUCK, "approach_speed")
    fixed = {"smoothing": width, "clearance_contact": width}
    agree_with_exact(scenes.impact("memory_free"), names, theta, fixed, Exact(theta, width, 0.0), (1,), 1e-6)


@pytest.mark.slow
def test_ten_bounces_against_variational_equations():
    width, theta = 1e-3, (1e4, 1.5, 0.05, 0.016731, 0.1)
    names, scene = (*STRUCK, "drop_height"), scenes.bounce("memory_free")
    gravity = float(scene.parameters()["gravity"])
    fixed = {"smoothing": width}
    agree_with_exact(scene, names, theta, fixed, Exact(theta, width, gravity), (1, 2, 10), 1e-6)


@pytest.mark.slow
def test_duration_and_restitution_against_closed_forms():
    # T ~ (m/K)^(1/(n+1)) v^((1-n)/(1+n)) undamped; e is a function of a v alone (physics sheet 3).
    scene, later = scenes.impact("memory_free", smoothing=False), 2.0 * DURATION
    names = (*STRUCK, "approach_speed")

    def leaving(logs, damping):
        theta = jnp.array([1e10, 1.5, 0.0, 0.02, 1.5]) * jnp.exp(logs)
        theta = theta.at[2].set(damping * jnp.exp(logs[2]))
        params = scene.parameters(dict(zip(names, theta, strict=True)))
        found = integrate(scene, params, jnp.array([later]), TIGHT, "forward", True)
        place, rate = found.states[0, :2]
        return jnp.stack([jnp.log(later - place / rate), -rate / theta[4]])

    both = jax.jit(lambda damping: (leaving(jnp.zeros(5), damping), jax.jacfwd(leaving)(jnp.zeros(5), damping)))
    (duration, _), jacobian = both(0.0)
    assert float(duration) == pytest.approx(np.log(DURATION), abs=1e-9)
    assert jacobian[0, jnp.array([0, 3, 4])] == pytest.approx([-0.4, 0.4, -0.2], abs=1e-6)
    by_exponent = jax.grad(lambda n: jnp.log(undamped_duration(1e10, n, 0.02, 1.5)))(1.5) * 1.5
    assert float(jacobian[0, 1]) == pytest.approx(float(by_exponent), abs=1e-6 * abs(float(by_exponent)))
    assert jacobian[1] == pytest.approx(np.zeros(5), abs=1e-6)
    (_, restitution), jacobian = both(0.2)
    value, slope = jax.value_and_grad(lambda log: delivered_restitution(0.2 * 1.5 * jnp.exp(log)))(0.0)
    assert float(restitution) == pytest.approx(float(value), abs=1e-8)
    assert jacobian[1] == pytest.approx(float(slope) * np.array([0.0, 0.0, 1.0, 0.0, 1.0]), abs=1e-6)


def logarithmic_peak(logs, mode="forward"):
    """Logarithm of the undamped peak, from the force at its time, over those of stiffness and mass."""
    hertz = scenes.impact("hertz", smoothing=False)
    stiffness, mass = jnp.exp(logs)
    values = hertz.parameters(stiffness=stiffness, exponent=1.5, mass=mass, approach_speed=1.5)
    time = undamped_duration(stiffness, 1.5, mass, 1.5) / 2
    return jnp.log(force_history(hertz, values, time[None], accuracy=1e-9, mode=mode)["contact"][0, 0])


def test_peak_against_its_closed_form():
    # F0 = K^(1/(n+1)) ((n+1) m v^2 / 2)^(n/(n+1)): constant slopes of its logarithm, and no curvature.
    logs = jnp.log(jnp.array([1e10, 0.02]))
    assert float(logarithmic_peak(logs)) == pytest.approx(float(jnp.log(PEAK)), abs=1e-8)
    gradient = np.asarray(jax.jit(jax.jacfwd(logarithmic_peak))(logs))
    assert gradient == pytest.approx([0.4, 0.6], abs=1e-5)


@pytest.mark.slow
def test_second_derivatives():
    def peak(stiffness):
        return jnp.exp(logarithmic_peak(jnp.log(jnp.stack([stiffness, jnp.asarray(0.02)]))))

    found = jax.jit(jax.jacfwd(jax.jacfwd(peak)))(1e10)
    # d2F/dK2 = F (1/(n+1)) (1/(n+1) - 1) / K^2. The interpolation's second derivative costs most of the 1e-3.
    assert float(found) == pytest.approx(PEAK * 0.4 * -0.6 / 1e20, rel=1e-3, abs=0.0)
    # The logarithm of the peak has constant slopes; "auto" makes tangents of tangents too.
    bent = jax.jit(jax.jacfwd(jax.jacfwd(lambda logs: logarithmic_peak(logs, "auto"))))(
        jnp.log(jnp.array([1e10, 0.02]))
    )
    assert np.abs(np.asarray(bent)).max() < 1e-3
