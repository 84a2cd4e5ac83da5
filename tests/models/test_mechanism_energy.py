"""Random mechanisms against Lagrange's equations, and their balances of energy and momentum."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from by_numpy import by_numpy
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from mechanisms import GAPS, JOINTS, mechanism, poses

from bcfj_jax.mechanism.loads import Bush, Force, Gravity, JointSpring, Spring, Torque

SEEDS = st.integers(0, 2**32 - 1)
TREES = st.lists(st.sampled_from(JOINTS), min_size=1, max_size=5)
TOUCHING = st.lists(st.sampled_from(sorted(GAPS)), min_size=1, max_size=6)


def axle(joints):
    """A list of joints of which at least one moves."""
    return joints if set(joints) != {"fixed"} else ["hinge", *joints[1:]]


# --- Lagrange's equations, from positions alone: d/dt(dT/dw) - dT/dx = Q


def lagrange(scene, params, t):
    """Accelerations of the free velocities at the start; every velocity is a derivative of ``poses``."""
    x = [0.0 if key.startswith("w") else dict(b.start)[_place(key)] for b in scene.ordered for key in b.rates]
    w = [dict(b.start)[key] for b in scene.ordered for key in b.rates]

    def moving(x, w, t):
        """Poses and their time derivatives."""
        return jax.jvp(lambda x, t: poses(scene.ordered, x, t, params), (x, t), (w, jnp.ones(())))

    def spin(turn, rate):
        wheel = rate @ turn.T
        return jnp.array([wheel[2, 1], wheel[0, 2], wheel[1, 0]])

    def kinetic(x, w, t):
        now, rates, total = *moving(x, w, t), 0.0
        for b in scene.ordered:
            (turn, _), (turned, moved) = now[b.name], rates[b.name]
            v, local = moved + turned @ jnp.asarray(b.center), turn.T @ spin(turn, turned)
            total += 0.5 * b.mass * v @ v + 0.5 * local @ (jnp.asarray(b.inertia) * local)
        return total

    def power(w, forces, x, t):
        now, rates = moving(x, w, t)
        total = 0.0
        for name, at, force, torque in forces:
            (turn, _), (turned, moved) = now[name], rates[name]
            total += force @ (moved + turned @ at) + torque @ spin(turn, turned)
        return total

    def sides(x, w, t):
        """Matrix of masses and right-hand side; forward derivatives alone, which NumPy evaluates."""
        forces, single = pushes(scene, params, t, *moving(x, w, t), spin)
        push = jax.jacfwd(power)(w, forces, x, t)
        for name, on in single.items():
            j = [b.name for b in scene.ordered for _ in b.rates].index(name)
            push += np.eye(len(w))[j] * on(x[j], w[j])
        slope = jax.jacfwd(kinetic, 1)
        mass = jax.jacfwd(slope, 1)(x, w, t)
        _, drift = jax.jvp(lambda x, t: slope(x, w, t), (x, t), (w, jnp.ones(())))
        return mass, push + jax.jacfwd(kinetic)(x, w, t) - drift

    return np.linalg.solve(*by_numpy(sides)(np.array(x), np.array(w), t))


def _place(rate):
    return {"velocity": "position", "speed": "angle", "vx": "x", "vy": "y", "vz": "z"}[rate]


def pushes(scene, params, t, now, rates, spin):
    """Loads, written anew: (body, point, force, torque) in world components, and forces on single coordinates."""
    found, single, zero = [], {}, jnp.zeros(3)
    way = lambda direction: jnp.asarray(direction) / np.linalg.norm(direction)  # noqa: E731
    point = lambda name, at: now[name][1] + now[name][0] @ jnp.asarray(at)  # noqa: E731
    speed = lambda name, at: rates[name][1] + rates[name][0] @ jnp.asarray(at)  # noqa: E731
    for load in scene.loads:
        if isinstance(load, Gravity):
            weight = {b.name: b.mass * params["gravity"] * way(load.direction) for b in scene.ordered}
            found += [(b.name, jnp.asarray(b.center), weight[b.name], zero) for b in scene.ordered]
        elif isinstance(load, Torque):
            found.append((load.body, zero, zero, load.size * way(load.direction)))
        elif isinstance(load, Force):
            s = t / load.ramp if load.ramp else 1.0
            force = load.size * s**3 * (10.0 - 15.0 * s + 6.0 * s * s) * way(load.direction)
            found.append((load.body, jnp.asarray(load.at), now[load.body][0] @ force if load.follows else force, zero))
        elif isinstance(load, (Spring, Bush)):
            (first, second), (a, b) = load.between, load.at
            arm, rate = point(second, b) - point(first, a), speed(second, b) - speed(first, a)
            if isinstance(load, Bush):
                # The first is the ground: half of the second's spin, and midway between both points.
                turning = spin(now[second][0], rates[second][0])
                damper = -load.damping * (rate - 0.5 * jnp.cross(turning, arm))
                pull = damper - load.stiffness * arm
                drag = -load.turning_damping * turning - 0.5 * jnp.cross(arm, damper)
            else:
                length = jnp.linalg.norm(arm)
                stretched = load.stiffness * (length - load.free_length) + load.damping * (arm @ rate) / length
                pull, drag = -stretched * arm / length, zero
            found.append((second, jnp.asarray(b), pull, drag))
        elif isinstance(load, JointSpring):
            single[load.body] = lambda x, w, c=load: -c.stiffness * (x - c.rest) - c.damping * w
    return found, single


@pytest.mark.full
@pytest.mark.parametrize(
    ("joints", "seed"),
    [
        (["free", "hinge", "spherical", "sphere"], 1),
        pytest.param(["slide", "planar", "bearing", "particle"], 2, marks=pytest.mark.slow),
        pytest.param(["hinge"] * 5, 3, marks=pytest.mark.slow),
    ],
)
def test_accelerations_are_lagranges(joints, seed):
    check_accelerations(joints, seed)


@pytest.mark.slow
@settings(max_examples=60)
@given(joints=TREES, seed=SEEDS)
def test_accelerations_of_many_are_lagranges(joints, seed):
    check_accelerations(joints, seed)


def check_accelerations(joints, seed):
    """The equations of motion against Lagrange's."""
    scene, params = mechanism(axle(joints), [], seed)
    t, count = jnp.asarray(0.37), sum(len(b.rates) for b in scene.ordered)
    if not count:
        return
    found = by_numpy(lambda t, p: scene.vector_field(t, scene.initial_state(p), p))(t, params)[-count:]
    expected = lagrange(scene, params, t)
    assert np.abs(found - expected).max() < 1e-10 * (1.0 + np.abs(expected).max())


# --- balances at one instant


@pytest.mark.full
@pytest.mark.parametrize(
    ("joints", "touching", "seed", "more"),
    [
        (["free", "free"], sorted(GAPS)[:5], 4, False),
        tiers.slow((["hinge", "planar", "sphere"], sorted(GAPS)[5:], 5, False)),
        (["free", "particle"], ["points_on_box", "rods_on_edges", "pin_in_pads"], 6, True),
    ],
)
def test_power_is_balanced(joints, touching, seed, more):
    check_power(joints, touching, seed, more)


@pytest.mark.slow
@settings(max_examples=60)
@given(joints=TREES, touching=TOUCHING, seed=SEEDS, more=st.booleans())
def test_power_of_many_is_balanced(joints, touching, seed, more):
    try:
        check_power(joints, touching, seed, more)
    except NothingTouches:
        reject()


class NothingTouches(Exception):
    """A drive has parted what touches at the start."""


def check_power(joints, touching, seed, more):
    """At one instant: what is stored grows by what is given less what is taken."""
    scene, params = mechanism(axle(joints), touching, seed, more=more)
    t, y = jnp.asarray(0.37), np.array(by_numpy(scene.initial_state)(params))
    # Bristles that are bent, memories of some speed.
    count = sum(k or 1 for _, k in scene._memory)
    y[y.size - count :] += np.random.default_rng(seed).uniform(0.0, 1e-3, count)

    def stored(t, y):
        flows = scene.flows(t, y, params)
        return sum(flows.stored.values()), flows

    def balance(t, y):
        way = jnp.ones(()), scene.vector_field(t, y, params)
        _, gain, flows = jax.jvp(stored, (t, y), way, has_aux=True)
        return gain, flows, [jnp.max(f.depth) for c in scene.instant(t, y, params).faces.values() for f, _ in c]

    gain, flows, depths = by_numpy(balance)(t, y)
    assert all(c.name for c in scene.contacts)
    if depths and max(depths) <= 0.0:
        raise NothingTouches
    powers = [float(x) for x in (*flows.given.values(), *flows.taken.values())]
    given_, taken = sum(map(float, flows.given.values())), sum(map(float, flows.taken.values()))
    assert float(gain) == pytest.approx(given_ - taken, abs=1e-9 * (1.0 + np.abs(powers).sum()))
    # Plastic contacts unload without a loss, to rounding.
    assert float(flows.taken["damping"]) >= -1e-12 * np.abs(powers).sum()
    if not any(c.bristles for c in scene.contacts):
        assert float(flows.taken["friction"]) >= 0.0
