"""A box on a plane: it slides, tips and lands on an edge as in closed form, in value and in derivative."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, InputError, Mechanism, gaps
from bcfj_jax.mechanism import statics
from bcfj_jax.mechanism.bodies import GROUND
from bcfj_jax.mechanism.loads import Force, Gravity

M, A, B, G, MU, K = 2.0, 0.1, 0.05, 9.81, 0.3, 1e7
INERTIA = M * (A * A + B * B) / 3.0
SINK = M * G / (8.0 * K)
GIVEN = {
    "half_length": A, "half_width": B, "half_height": 0.04, "stiffness": K, "dashpot": 0.0, "friction_dynamic": MU,
    "friction_speed": 1e-3, "gravity": G,
}  # fmt: skip


def box(start, loads=(), friction="coulomb", **more):
    """In the plane of x and y on a floor across y; its lower four corners bear."""
    body = Body("box", "planar", mass=M, inertia=INERTIA, start=start)
    floor = Contact("floor", (GROUND, "box"), gaps.BoxOnPlane("y"), "kelvin_voigt", friction=friction)
    scene = Mechanism("box", [body], [floor], [Gravity("-y"), *loads], **more)
    return scene, scene.parameters({key: x for key, x in GIVEN.items() if key in scene.quantities})


def test_a_box_slides_and_is_braked_by_its_coefficient():
    """dv/dt = -mu g v/sqrt(v^2 + v_t^2), d(that)/dmu; friction at the floor turns it forwards by m mu g b/I."""
    scene, p = box({"y": B - 2.0 * SINK, "vx": 0.5})
    rate = jax.jit(
        lambda p: (
            scene.vector_field(0.0, scene.initial_state(p), p),
            jax.jacfwd(lambda mu: scene.vector_field(0.0, scene.initial_state(p), {**p, "friction_dynamic": mu}))(
                p["friction_dynamic"]
            ),
        )
    )
    field, slope = rate(p)
    share = 0.5 / np.hypot(0.5, 1e-3)
    np.testing.assert_allclose(
        field[3:], [-MU * G * share, 0.0, -M * MU * G * share * B / INERTIA], rtol=1e-7, atol=1e-9
    )
    np.testing.assert_allclose(slope[3:], np.asarray(field[3:]) / MU, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_a_box_slides_as_far_as_its_energy_goes():
    """v^2/(2 mu g), and its derivative by mu, -1/mu of it."""
    scene, p = box({"y": B - 2.0 * SINK, "vx": 0.2}, end=0.1)
    p = {**p, "dashpot": jnp.asarray(3e3)}
    times = jnp.asarray([0.0, 0.1])

    def far(mu):
        return bj.reading_history(scene, {**p, "friction_dynamic": mu}, times, ["box.place.x"], accuracy=1e-4)[
            "box.place.x"
        ][-1]

    value, slope = jax.jvp(far, (jnp.asarray(MU),), (jnp.ones(()),))
    assert float(value) == pytest.approx(0.2**2 / (2.0 * MU * G), rel=5e-3)
    assert float(slope) == pytest.approx(-(0.2**2) / (2.0 * MU**2 * G), rel=1e-2)


@pytest.mark.slow
def test_a_box_bears_a_push_on_its_far_corners_and_tips():
    """At rest by friction: far corners bear m g/4 + F h/(4 a), h above the floor; it tips at F = m g a/h."""
    tall = 0.08
    made = lambda size: box({"y": B - 2.0 * SINK}, [Force("push", "box", "x", size, at=(0.0, tall - B, 0.0))], end=0.1)  # noqa: E731
    scene, p = made(4.0)
    scene = replace(scene, start="static")

    def bears(size):
        now = {**p, "push.size": size}
        return scene.observe(jnp.zeros(()), scene.initial_state(now), now)["floor"].force[:, 0]

    value, slope = jax.jit(lambda f: jax.jvp(bears, (f,), (jnp.ones(()),)))(jnp.asarray(4.0))
    for found, low, high in ((value, M * G / 4.0 - 4.0 * tall / (4.0 * A), M * G / 4.0 + 4.0 * tall / (4.0 * A)),
                             (slope, -tall / (4.0 * A), tall / (4.0 * A))):  # fmt: skip
        # Corners 1, 2, 5, 6 are below, 1 and 2 behind.
        np.testing.assert_allclose(found, [low, low, 0.0, 0.0, high, high, 0.0, 0.0], rtol=1e-4, atol=1e-6)
    over = {**p, "push.size": jnp.asarray(1.05 * M * G * A / tall), "friction_dynamic": jnp.asarray(2.0)}
    with pytest.raises(InputError, match=r"no equilibrium|unstable"):
        statics.check(scene, over, "box")


@pytest.mark.full
def test_a_box_that_lands_on_an_edge_bounces_and_turns():
    """Without loss and friction: J = 2 v/(1/m + x^2/I) at the arm x = a cos q - b sin q; then v - J/m and x J/I, each as v."""
    angle, speed = 0.4, 1.0
    low = A * np.sin(angle) + B * np.cos(angle)
    scene, p = box({"y": low + 1e-6, "angle": angle, "vy": -speed}, friction=None, end=2e-3)
    p = {**p, "gravity": jnp.asarray(0.0), "stiffness": jnp.asarray(1e9)}
    names, arm = ["box.velocity.y", "box.spin.z"], -(A * np.cos(angle) - B * np.sin(angle))

    def after(v):
        found = bj.reading_history(scene, {**p, "box.vy": -v}, jnp.asarray([0.0, 2e-3]), names, accuracy=1e-4)
        return jnp.stack([found[name][-1] for name in names])

    value, slope = jax.jvp(after, (jnp.asarray(speed),), (jnp.ones(()),))
    push = 2.0 / (1.0 / M + arm**2 / INERTIA)
    want = np.array([-1.0 + push / M, arm * push / INERTIA])
    np.testing.assert_allclose(value, want * speed, rtol=2e-3)
    np.testing.assert_allclose(slope, want, rtol=5e-3)
