"""Derivatives of force histories: forward = reverse = differences = closed forms, and finite where it hurts.

A reverse program takes ten seconds to compile, so each is compiled once for many tests.
"""

from __future__ import annotations

from types import SimpleNamespace

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from bcfj_jax import force_history, scenes
from bcfj_jax.integrate import Plan, integrate
from bcfj_jax.restitution import delivered_restitution, undamped_duration, undamped_peak

ACCURACY = 1e-9
NAMES = ("stiffness", "exponent", "damping", "mass", "approach_speed", "clearance_contact", "smoothing")
AT = dict(zip(NAMES, (1e10, 1.5, 0.1, 0.02, 1.5, 2e-6, 1e-6), strict=True))
IMPACT = scenes.impact("memory_free")
HERTZ = scenes.impact("hertz", smoothing=False)
SOFT = {"stiffness": 1e4, "damping": 0.05, "drop_height": 0.1}  # contacts long beside a difference's step
BOUNCE = scenes.bounce("memory_free", smoothing=False)
BOUNCE_TIMES = (0.1457, 0.1500, 0.434, 0.438)


def impact_force(theta, mode="auto"):
    """Normal force at the times theta[7:] under the parameters theta[:7]."""
    values = IMPACT.parameters(dict(zip(NAMES, theta[:7], strict=True)))
    return force_history(IMPACT, values, theta[7:], accuracy=ACCURACY, mode=mode)["contact"][:, 0]


def bounce_force(theta):
    """Normal force within the first and the second bounce."""
    values = BOUNCE.parameters(dict(zip(SOFT, theta, strict=True)))
    return force_history(BOUNCE, values, jnp.array(BOUNCE_TIMES), accuracy=ACCURACY)["contact"][:, 0]


def point(times, **changes):
    """theta of ``impact_force``."""
    return jnp.array([*({**AT, **changes}.values()), *times])


def contact_time(**changes):
    """Undamped duration of a contact [s] at the given speed, or at 1.5 m/s where that is 0."""
    v = {**AT, **changes}
    return float(undamped_duration(v["stiffness"], v["exponent"], v["mass"], v["approach_speed"] or 1.5))


POINT = point(AT["clearance_contact"] / 1.5 + contact_time() * np.array([0.2, 0.45, 0.7]))


@pytest.fixture(scope="module")
def impact():
    """The compiled programs of one impact: value, Jacobians by direction, and gradients of a batch."""

    def loss(theta):
        return jnp.sum(jnp.square(impact_force(theta) / 1e3))

    return SimpleNamespace(
        force=jax.jit(impact_force),
        forward=jax.jit(jax.jacfwd(impact_force)),
        reverse=jax.jit(jax.jacrev(impact_force)),
        only_forward=jax.jit(jax.jacfwd(lambda x: impact_force(x, "forward"))),
        only_reverse=jax.jit(jax.jacrev(lambda x: impact_force(x, "reverse"))),
        batched_gradients=jax.jit(jax.vmap(jax.grad(loss))),
        gradient_of_batch=jax.jit(jax.grad(lambda x: jnp.sum(jax.vmap(loss)(x)))),
        gradient=jax.jit(jax.grad(loss)),
    )


def differences(function, theta, relative):
    """Fourth-order central differences, in relative changes: columns d f / d ln theta."""
    columns = []
    for k in range(theta.size):
        step = jnp.zeros(theta.size).at[k].set(relative * theta[k])
        near = function(theta + step) - function(theta - step)
        far = function(theta + 2 * step) - function(theta - 2 * step)
        columns.append((8 * near - far) / (12 * relative))
    return np.stack(columns, axis=1)


def close(found, expected, relative):
    """Derivatives over relative changes, equal to a tolerance in units of each column's largest entry.

    A column below 1 % of the largest of all counts as 1 %: smoothing changes next to nothing, by design,
    and what it does change is below the accuracy of the run.
    """
    found, expected = np.asarray(found), np.asarray(expected)
    size = np.maximum(np.abs(expected).max(axis=0), 1e-2 * np.abs(expected).max())
    assert np.all(np.abs(found - expected) <= relative * size), (np.abs(found - expected) / size).max()


def test_all_directions_agree(impact):
    # The same discrete solution differentiated twice: rounding over some 500 steps.
    expected = impact.only_forward(POINT) * POINT
    for way in (impact.forward, impact.reverse, impact.only_reverse):
        close(way(POINT) * POINT, expected, 1e-9)


def test_impact_against_differences(impact):
    # Noise: a force error of 1e-9 over a step of 1e-3. Truncation: (1e-3)^4. Both are well below 1e-5.
    close(impact.forward(POINT) * POINT, differences(impact.force, POINT, 1e-3), 1e-5)


def test_times_against_an_offset(impact):
    jacobian = impact.forward(POINT)
    by_time = np.diag(jacobian[:, 7:])
    assert not np.any(jacobian[:, 7:] - np.diag(by_time))  # a force depends on its own time alone
    start = jnp.zeros(POINT.size).at[7:].set(1.0)
    by_offset = jax.jit(jax.jacfwd(lambda offset: impact_force(POINT - offset * start)))(0.0)
    assert np.asarray(by_offset) == pytest.approx(-by_time, rel=1e-12)
    h = 1e-3 * contact_time()
    slope = (impact.force(POINT + h * start) - impact.force(POINT - h * start)) / (2 * h)
    # Second order: (pi h)^2 / 6 of the largest slope, 2e-6, and more near the onset where F''' is large.
    assert np.asarray(slope) == pytest.approx(by_time, abs=5e-5 * np.abs(by_time).max())


@pytest.fixture(scope="module")
def bounce():
    return SimpleNamespace(
        force=jax.jit(bounce_force),
        forward=jax.jit(jax.jacfwd(bounce_force)),
        reverse=jax.jit(jax.jacrev(bounce_force)),
    )


def test_bounces(bounce):
    theta = jnp.array(list(SOFT.values()))
    assert np.all(bounce.force(theta) > 1.0)  # every time is inside a contact
    forward = bounce.forward(theta) * theta
    close(bounce.reverse(theta) * theta, forward, 1e-9)
    # A drop 3e-4 higher comes 1 % of a contact later at the second bounce: truncation 1e-8, noise 3e-6.
    expected = differences(bounce.force, theta, 3e-4)
    close(forward[:2], expected[:2], 1e-5)
    # Steps are not differentiated, and one that straddles a kink (the end of the first contact, the touch of
    # the second) has an error that depends on where. Against SciPy the derivatives are off by 3e-5 there.
    close(forward[2:], expected[2:], 1e-4)


CASES = {
    "touching at time 0": {"clearance_contact": 0.0},
    "sharp": {"smoothing": 0.0},
    "undamped, sharp": {"damping": 0.0, "clearance_contact": 0.0, "smoothing": 0.0},
    "at rest, smooth": {"approach_speed": 0.0, "clearance_contact": 0.0},
    "at rest, sharp": {"approach_speed": 0.0, "clearance_contact": 0.0, "smoothing": 0.0},
    "never in contact, smooth": {"clearance_contact": 1.0},
    "never in contact, sharp": {"clearance_contact": 1.0, "smoothing": 0.0},
}


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("case", CASES)
def test_finite(impact, case, n):
    changes = {"stiffness": 1e10 * 1e-5 ** (1.5 - n), "exponent": n, **CASES[case]}
    # Time 0 and, undamped and sharp, the very instant of separation.
    theta = point([0.0, 0.5 * contact_time(**changes), contact_time(**changes)], **changes)
    forward, reverse = np.asarray(impact.forward(theta)), np.asarray(impact.reverse(theta))
    assert np.all(np.isfinite(impact.force(theta))) and np.all(np.isfinite(forward)) and np.all(np.isfinite(reverse))
    assert "never" not in case or not (np.any(forward) or np.any(reverse))


def test_gradients_of_batches(impact):
    lanes = POINT * jnp.linspace(0.99, 1.01, 3)[:, None]
    one_by_one = np.stack([impact.gradient(lane) for lane in lanes]) * lanes
    # Other programs round otherwise and rounding may move a step: the accuracy asked for, with a margin.
    close(impact.batched_gradients(lanes) * lanes, one_by_one, 1e-7)
    close(impact.gradient_of_batch(lanes) * lanes, one_by_one, 1e-7)


def logarithmic_peak(logs, mode="forward"):
    """Logarithm of the undamped peak, from the force at its time, over those of stiffness and mass."""
    stiffness, mass = jnp.exp(logs)
    values = HERTZ.parameters(stiffness=stiffness, exponent=1.5, mass=mass, approach_speed=1.5)
    time = undamped_duration(stiffness, 1.5, mass, 1.5) / 2
    return jnp.log(force_history(HERTZ, values, time[None], accuracy=ACCURACY, mode=mode)["contact"][0, 0])


PEAK = float(undamped_peak(1e10, 1.5, 0.02, 1.5))


def test_peak_against_its_closed_form():
    # F0 = K^(1/(n+1)) ((n+1) m v^2 / 2)^(n/(n+1)): constant slopes of its logarithm, and no curvature.
    logs = jnp.log(jnp.array([1e10, 0.02]))
    assert float(logarithmic_peak(logs)) == pytest.approx(float(jnp.log(PEAK)), abs=1e-8)
    gradient = np.asarray(jax.jit(jax.jacfwd(logarithmic_peak))(logs))
    assert gradient == pytest.approx([0.4, 0.6], abs=1e-5)


def test_second_derivatives():
    def peak(stiffness):
        return jnp.exp(logarithmic_peak(jnp.log(jnp.stack([stiffness, jnp.asarray(0.02)]))))

    found = jax.jit(jax.jacfwd(jax.jacfwd(peak)))(1e10)
    # d2F/dK2 = F (1/(n+1)) (1/(n+1) - 1) / K^2. The interpolation's second derivative costs most of the 1e-3.
    assert float(found) == pytest.approx(PEAK * 0.4 * -0.6 / 1e20, rel=1e-3, abs=0.0)
    with pytest.raises(RuntimeError, match="mode='forward'"):
        jax.jit(jax.jacfwd(jax.jacfwd(lambda logs: logarithmic_peak(logs, "auto"))))(jnp.log(jnp.array([1e10, 0.02])))


STRUCK = ("stiffness", "exponent", "damping", "mass", "height or speed")


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


FRACTIONS = np.array([0.15, 0.4, 0.6, 0.85])


TIGHT = Plan(jnp.asarray(1e-14))


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


def test_impact_against_variational_equations():
    # The start is at the edge of the onset: no kink within the run.
    width, theta = 4e-6, (1e10, 1.5, 0.1, 0.02, 1.5)
    names = (*STRUCK[:4], "approach_speed")
    fixed = {"smoothing": width, "clearance_contact": width}
    agree_with_exact(IMPACT, names, theta, fixed, Exact(theta, width, 0.0), (1,), 1e-6)


def test_ten_bounces_against_variational_equations():
    width, theta = 1e-3, (1e4, 1.5, 0.05, 0.016731, 0.1)
    names, scene = (*STRUCK[:4], "drop_height"), scenes.bounce("memory_free")
    gravity = float(scene.parameters()["gravity"])
    fixed = {"smoothing": width}
    agree_with_exact(scene, names, theta, fixed, Exact(theta, width, gravity), (1, 2, 10), 1e-6)


def test_duration_and_restitution_against_closed_forms():
    # T ~ (m/K)^(1/(n+1)) v^((1-n)/(1+n)) undamped; e is a function of a v alone (physics sheet 3).
    scene, later = scenes.impact("memory_free", smoothing=False), 2.0 * contact_time()
    names = (*STRUCK[:4], "approach_speed")

    def leaving(logs, damping):
        theta = jnp.array([1e10, 1.5, 0.0, 0.02, 1.5]) * jnp.exp(logs)
        theta = theta.at[2].set(damping * jnp.exp(logs[2]))
        params = scene.parameters(dict(zip(names, theta, strict=True)))
        found = integrate(scene, params, jnp.array([later]), TIGHT, dfx.ForwardMode(), True)
        place, rate = found.states[0, :2]
        return jnp.stack([jnp.log(later - place / rate), -rate / theta[4]])

    both = jax.jit(lambda damping: (leaving(jnp.zeros(5), damping), jax.jacfwd(leaving)(jnp.zeros(5), damping)))
    (duration, _), jacobian = both(0.0)
    assert float(duration) == pytest.approx(np.log(contact_time()), abs=1e-9)
    assert jacobian[0, jnp.array([0, 3, 4])] == pytest.approx([-0.4, 0.4, -0.2], abs=1e-6)
    by_exponent = jax.grad(lambda n: jnp.log(undamped_duration(1e10, n, 0.02, 1.5)))(1.5) * 1.5
    assert float(jacobian[0, 1]) == pytest.approx(float(by_exponent), abs=1e-6 * abs(float(by_exponent)))
    assert jacobian[1] == pytest.approx(np.zeros(5), abs=1e-6)
    (_, restitution), jacobian = both(0.2)
    value, slope = jax.value_and_grad(lambda log: delivered_restitution(0.2 * 1.5 * jnp.exp(log)))(0.0)
    assert float(restitution) == pytest.approx(float(value), abs=1e-8)
    assert jacobian[1] == pytest.approx(float(slope) * np.array([0.0, 0.0, 1.0, 0.0, 1.0]), abs=1e-6)


CORNERS = {
    "stiffness": st.sampled_from([1e3, 1e10]),
    "exponent": st.sampled_from([1.0, 1.5, 3.0]) | st.floats(1.0, 3.0),
    "damping": st.sampled_from([0.0, 0.111, 10.0]),
    "speed": st.sampled_from([0.0, 1e-9, 1.5]),
    "clearance": st.sampled_from([0.0, 1e-9, 2e-6, 1.0]),
    "smoothing": st.sampled_from([0.0, 1e-9, 1e-6]),
}


@given(**CORNERS)
@settings(max_examples=40)
@example(stiffness=1e10, exponent=1.0, damping=0.0, speed=0.0, clearance=0.0, smoothing=0.0)
def test_impact_is_finite_over_the_box(impact, stiffness, exponent, damping, speed, clearance, smoothing):
    # Times: the start, in contact, the very end; K d^n of 1e-5 m is the same for every exponent.
    stiffness = stiffness * 1e-5 ** (1.5 - exponent)
    changes = {"stiffness": stiffness, "exponent": exponent, "damping": damping, "approach_speed": speed}
    duration = contact_time(**changes)
    theta = point(duration * np.array([0.0, 0.5, 1.0]), **changes, clearance_contact=clearance, smoothing=smoothing)
    assert np.all(np.isfinite(impact.force(theta)))
    assert np.all(np.isfinite(impact.only_forward(theta)))


@pytest.fixture(scope="module")
def restituting():
    """Value and Jacobian of bounces whose damping is stated by restitution, over (K, n, m, e, height, smoothing)."""
    scene = scenes.bounce("flores")
    names = ("stiffness", "exponent", "mass", "restitution", "drop_height", "smoothing")

    def force(theta):
        values = scene.parameters(dict(zip(names, theta, strict=True)))
        return force_history(scene, values, jnp.linspace(0.0, 0.6, 13), mode="forward")["contact"][:, 0]

    return jax.jit(lambda theta: (force(theta), jax.jacfwd(force)(theta)))


@given(
    exponent=st.sampled_from([1.0, 1.5, 3.0]),
    restitution=st.sampled_from([0.0, 0.5, 1.0]),
    # Found here: released at 0 m with restitution below 1, a run spends its budget of steps, says so, and is NaN.
    height=st.sampled_from([1e-6, 1e-3, 0.1]),
    smoothing=st.sampled_from([0.0, 1e-6]),
)
@settings(max_examples=20)
def test_bounces_are_finite_over_the_box(restituting, exponent, restitution, height, smoothing):
    stiffness = 1e4 * 1e-2 ** (1.5 - exponent)
    value, jacobian = restituting(jnp.array([stiffness, exponent, 0.0167, restitution, height, smoothing]))
    assert np.all(np.isfinite(value)) and np.all(np.isfinite(jacobian))
