"""Reactions of joints, forces and powers of loads and drives: closed forms, and balances of random trees."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from mechanisms import mechanism

import bcfj_jax as bj
from bcfj_jax import Body, InputError, Mechanism
from bcfj_jax.mechanism.bodies import GROUND, Drive
from bcfj_jax.mechanism.channels import quantity_of
from bcfj_jax.mechanism.loads import Bush, Gravity, JointSpring, Spring

G, L, M, SPIN = 9.81, 0.4, 2.0, 0.01
SWING = Body(
    "bar", "hinge", center=(L, 0, 0), mass=M, inertia=SPIN, tilt=("z", 0.5), start={"angle": -0.2, "speed": 1.5}
)


def states(scene, params, names, times):
    return bj.simulate(scene, params, times, read=names, accuracy=1e-5).readings


def test_a_pendulums_pin():
    """R = -m L w^2 + m g sin a along the bar, m g cos a I/(I + m L^2) across it; no moment about the pin's axis."""
    scene, times = Mechanism("pendulum", [SWING], loads=[Gravity()]), np.linspace(0.0, 1.0, 51)
    names = ["bar.angle", "bar.speed", "bar.moment.z", "gravity.power", "bar.velocity.y"]
    names += [f"bar.reaction.{k} in {frame}" for k in "xy" for frame in ("bar", "joint")]
    r = states(scene, scene.parameters(), names, times)
    angle, speed = 0.5 + r["bar.angle"], r["bar.speed"]
    along, across = -M * L * speed**2 + M * G * np.sin(angle), M * G * np.cos(angle) * SPIN / (SPIN + M * L * L)
    np.testing.assert_allclose(r["bar.reaction.x in bar"], along, atol=1e-12 * M * G)
    np.testing.assert_allclose(r["bar.reaction.y in bar"], across, atol=1e-12 * M * G)
    # The joint's axes are the bar's less its angle.
    c, s = np.cos(r["bar.angle"]), np.sin(r["bar.angle"])
    np.testing.assert_allclose(r["bar.reaction.x in joint"], c * along - s * across, atol=1e-12 * M * G)
    np.testing.assert_allclose(r["bar.moment.z"], 0.0, atol=1e-12)
    np.testing.assert_allclose(r["gravity.power"], -M * G * r["bar.velocity.y"], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", tiers.ci(range(3), 2))
def test_random_trees_balance(seed):
    """Of every body and all that hangs on it: what its joint and the loads bring is the rate of both momenta."""
    rng = np.random.default_rng(seed)
    joints = [
        str(x)
        for x in rng.choice(["hinge", "slide", "planar", "spherical", "free", "fixed", "bearing", "universal"], 5)
    ]
    scene, p = mechanism(joints, ["sphere_on_plane", "pin_in_slot", "sphere_in_socket"], seed)
    t, y = jnp.asarray(0.2), scene.initial_state(p)

    def momenta(t, y):
        """By body: momentum, and angular momentum about the world's origin."""
        found = {}
        for name, moved in scene.motions(t, y, p).items():
            inertia = scene.inertia(scene.body(name), p)
            spun = jnp.zeros(3)
            if inertia is not None:
                own = jnp.eye(3) if moved.axes is None else moved.axes
                spun = own @ (jnp.asarray(inertia) * (own.T @ moved.spin))
            push = scene.coefficient(p, name, "mass") * moved.velocity
            found[name] = jnp.stack([push, jnp.cross(moved.place, push) + spun])
        return found

    rate = jax.jvp(momenta, (t, y), (jnp.ones(()), scene.vector_field(t, y, p)))[1]
    now, brought = scene.instant(t, y, p), {name: np.zeros((2, 3)) for name in (*scene.body_names, GROUND)}

    def bring(body, force, point, torque=(0.0, 0.0, 0.0)):
        force, torque = np.array(force, float), np.array(torque, float)
        brought[body] += np.stack([force, np.cross(np.array(point, float), force) + torque])

    for c in scene.contacts:
        for face, touch in scene.faces_of(now, c.name):
            point = np.array(c.place(1, now.bodies.parts[c.between[1]], p), float) + np.array(face.lever, float)
            bring(c.between[1], touch.force, point)
            bring(c.between[0], -np.array(touch.force, float), point)
    for load in scene.loads:
        for action in load.actions(t, now.bodies, p):
            bring(action.body, action.force, now.bodies.place(action.body, action.at), action.torque)
    efforts, left = scene.efforts(t, y, p), {name: np.array(x) for name, x in rate.items()}
    size = max(np.abs(x).max() for x in (*left.values(), *brought.values()))
    for b in scene.ordered:
        one, place = efforts[b.name], np.array(now.bodies.parts[b.name].place, float)
        wrench = np.stack([one.reaction, one.moment + np.cross(place, one.reaction)])
        left[b.name] -= wrench
        if b.parent != GROUND:
            left[b.parent] += wrench
        # Along every free coordinate the joint does what the loads on it do: nothing, of most.
        part = now.bodies.parts[b.name]
        springs = sum(float(efforts[x.name].drive) for x in scene.loads if getattr(x, "body", "") == b.name
                      and isinstance(x, JointSpring))  # fmt: skip
        first = sum(len(x.rates) for x in scene.ordered[: scene.ordered.index(b)])
        for j in range(first, first + len(b.rates)):
            w, v = (np.array(x, float) for x in part.partials[j])
            assert abs(v @ np.array(one.reaction) + w @ np.array(one.moment) - springs) < 1e-9 * size
    for name, x in left.items():
        np.testing.assert_allclose(x, brought[name], atol=1e-9 * size, err_msg=name)


def test_a_slider_cranks_pins_by_hand():
    """Newton and Euler for every part of a slider-crank whose motion is given, in NumPy: pins, motor, guide.

    A rod of twice the crank's length as its slider's guide keeps it: theta' = w, sin b = -r sin theta/l.
    """
    r, length, w = 0.05, 0.12, 40.0
    m, inertia = {"crank": 0.3, "rod": 0.21, "slider": 0.14}, {"crank": 1e-4, "rod": 2.5e-4}
    tilt = lambda t: jnp.arcsin(-r / length * jnp.sin(w * t)) - w * t  # noqa: E731
    bodies = [
        Body("crank", "hinge", center=(0.02, 0, 0), mass=m["crank"], inertia=inertia["crank"], drive=Drive("constant", speed=w)),
        Body("rod", "hinge", "crank", at=(r, 0, 0), center=(0.07, 0.0, 0), mass=m["rod"], inertia=inertia["rod"],
             drive=Drive("function", function=lambda t, p: tilt(t), breaks=())),
        Body("slider", "hinge", "rod", at=(length, 0, 0), mass=m["slider"], inertia=1e-5,
             drive=Drive("function", function=lambda t, p: -tilt(t) - w * t, breaks=())),
    ]  # fmt: skip
    scene, times = Mechanism("given", bodies), np.linspace(1e-3, 0.15, 40)
    names = [f"{b}.{what}.{k}" for b in m for what, ks in (("reaction", "xy"), ("moment", "z")) for k in ks]
    got = states(scene, scene.parameters(), [*names, "crank.torque", "crank.power"], times)
    one, slope = (np.asarray(jax.vmap(f)(jnp.asarray(times))) for f in (
        lambda t: w * t + tilt(t), jax.grad(jax.grad(lambda t: w * t + tilt(t)))))  # fmt: skip
    gain = lambda place: np.asarray(jax.vmap(jax.jacfwd(jax.jacfwd(place)))(jnp.asarray(times)))  # noqa: E731
    way = lambda a: jnp.array([jnp.cos(a), jnp.sin(a)])  # noqa: E731
    rod = gain(lambda t: r * way(w * t) + 0.07 * way(w * t + tilt(t)))
    crank, slider = gain(lambda t: 0.02 * way(w * t)), gain(lambda t: r * way(w * t) + length * way(w * t + tilt(t)))
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]  # noqa: E731
    at = lambda size, angle: size * np.stack([np.cos(angle), np.sin(angle)], 1)  # noqa: E731
    pin = m["slider"] * slider
    wrist, knee = pin, pin + m["rod"] * rod
    shaft = knee + m["crank"] * crank
    turn = inertia["rod"] * slope + cross(at(0.07, one), m["rod"] * rod) + cross(at(length, one), wrist)
    motor = turn + cross(at(r, w * times), knee) + cross(at(0.02, w * times), m["crank"] * crank)
    for body, force in (("slider", wrist), ("rod", knee), ("crank", shaft)):
        for k, axis in enumerate("xy"):
            np.testing.assert_allclose(got[f"{body}.reaction.{axis}"], force[:, k], atol=1e-9 * np.abs(shaft).max())
    for name, moment in (("rod.moment.z", turn), ("crank.moment.z", motor), ("crank.torque", motor)):
        np.testing.assert_allclose(got[name], moment, atol=1e-9 * np.abs(motor).max())
    np.testing.assert_allclose(got["crank.power"], w * motor, atol=1e-9 * w * np.abs(motor).max())


@pytest.mark.full
def test_springs_and_bushes_by_their_formulas_and_their_derivatives():
    """A mass between a spring and a bush; d(pull)/dk by JAX against central differences."""
    body = Body("mass", "slide", axis="x", mass=1.0, start={"position": 0.1})
    loads = [
        Spring("spring", (GROUND, "mass"), 50.0, 2.0, 0.3, at=((-0.5, 0, 0), (0, 0, 0))),
        Bush("bush", (GROUND, "mass"), 40.0, 1.0, at=((0, 0, 0), (0, 0.2, 0))),
        JointSpring("coil", "mass", 5.0, 0.1, rest=0.02),
    ]
    scene, times = Mechanism("held", [body], loads=loads, end=1.0), np.linspace(0.0, 1.0, 21)
    params = scene.parameters()
    names = ["mass.position", "mass.velocity", "spring.pull", "spring.length", "spring.force.x", "bush.force.x",
             "bush.force.y", "coil.drive", "spring.power", "mass.reaction.x", "mass.reaction.y"]  # fmt: skip
    r = states(scene, params, names, times)
    x, v = r["mass.position"], r["mass.velocity"]
    pull = 50.0 * (x + 0.5 - 0.3) + 2.0 * v
    np.testing.assert_allclose(r["spring.pull"], pull, rtol=1e-12)
    np.testing.assert_allclose(r["spring.force.x"], -pull, rtol=1e-12)
    np.testing.assert_allclose(r["spring.length"], x + 0.5, rtol=1e-12)
    np.testing.assert_allclose(r["bush.force.x"], -40.0 * x - v, rtol=1e-12)
    np.testing.assert_allclose(r["bush.force.y"], -8.0, rtol=1e-12)
    np.testing.assert_allclose(r["coil.drive"], -5.0 * (x - 0.02) - 0.1 * v, rtol=1e-12)
    np.testing.assert_allclose(r["mass.reaction.x"], r["coil.drive"], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(r["mass.reaction.y"], 8.0, rtol=1e-12)

    # x'' = -w^2 (x - x_0) - 2 b x' of 1 kg: swings about the place where all three balance.
    def pulled(k):
        rate, b = k + 45.0, 0.5 * 3.1
        rest, w = (0.1 - 0.2 * k) / rate, jnp.sqrt(rate - b * b)
        left, fade = 0.1 - rest, jnp.exp(-b * times)
        swing = left * fade * (jnp.cos(w * times) + b / w * jnp.sin(w * times))
        return k * (rest + swing + 0.2) - 2.0 * left * fade * rate / w * jnp.sin(w * times)

    def found(k):
        given = {**params, "spring.stiffness": k}
        return bj.reading_history(scene, given, times, ["spring.pull"], accuracy=1e-6)["spring.pull"]

    ours, theirs = (jax.jvp(f, (jnp.asarray(50.0),), (jnp.ones(()),)) for f in (found, pulled))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-5 * np.abs(other).max())


@pytest.mark.slow
def test_reactions_are_features_with_derivatives():
    """A pendulum's motion does not depend on its mass where that is all at a point: its forces are proportional to it."""
    point = Body("bar", "hinge", center=(L, 0, 0), mass=M, inertia=1e-12, start={"angle": -0.2, "speed": 1.5})
    scene, times = Mechanism("pendulum", [point], loads=[Gravity()], end=0.5), np.linspace(0.0, 0.5, 51)
    params, feature = scene.parameters(), "bar.reaction.y.peak"
    peak = np.abs(states(scene, params, ["bar.reaction.y"], times)["bar.reaction.y"]).max()
    found = bj.sensitivity(scene, params, times, ["bar.mass"], features=[feature], accuracy=1e-4)
    assert found.features[feature] == pytest.approx(peak, rel=2e-3)
    assert found.feature_derivatives["bar.mass"][feature] == pytest.approx(peak / M, rel=2e-3)


def test_what_is_not_there_is_told():
    scene = Mechanism("pendulum", [SWING], loads=[Gravity()], end=0.5)
    params = scene.parameters()
    assert quantity_of("bar.moment.x") == ("moment", "N m") and quantity_of("a.power") == ("power", "W")
    for name, told in (("bar.pull", "no reading"), ("gravity.pull", "has no pull"), ("spring.force.x", "body or load")):
        with pytest.raises(InputError, match=told):
            bj.simulate(scene, params, np.linspace(0.0, 0.5, 3), read=[name])
    joint = bj.scenes.joint()
    with pytest.raises(InputError, match="keeps no forces of joints"):
        bj.reading_history(joint, joint.parameters(), np.linspace(0.0, 1e-4, 2), ["head.reaction.x"])
