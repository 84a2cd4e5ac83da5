"""Rolling and drilling resistance of a contact: a ball that spins down and one that rolls out, in closed form."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps
from bcfj_jax.mechanism.bodies import GROUND
from bcfj_jax.mechanism.loads import Gravity

M, R, G, ROLL, DRILL, S = 0.5, 0.02, 9.81, 2e-4, 5e-4, 1e-3
INERTIA = 0.4 * M * R * R
NUMBERS = {
    "stiffness": 1e8, "exponent": 1.5, "damping": 0.3, "smoothing": 0.0, "radius": R, "rolling_length": ROLL,
    "friction_static": 0.5, "drilling_length": DRILL, "spin_speed": S, "friction_dynamic": 0.4, "friction_speed": 1e-3,
    "gravity": G,
}  # fmt: skip
DEPTH = (M * G / 1e8) ** (1.0 / 1.5)


def ball(names=("ball",), friction=True, **start):
    bodies = [Body(name, "sphere", mass=M, inertia=INERTIA, start={"z": R - DEPTH, **start}) for name in names]
    floors = [
        Contact(f"floor_of_{name}", (GROUND, name), gaps.SphereOnPlane("z"), friction=friction, rolling=True)
        for name in names
    ]
    scene = Mechanism("ball", bodies, floors, [Gravity("-z")], end=0.1)
    return scene, scene.parameters({key: x for key, x in NUMBERS.items() if key in scene.quantities})


@pytest.mark.parametrize(
    "names",
    [pytest.param(("ball",), id="one"), pytest.param(("b1", "b2", "b3", "b4"), id="row", marks=pytest.mark.slow)],
)
def test_torques_and_powers(names):
    """-N r w_t/|w_t| and -N b w_n/|w_n| on each ball, and their power is friction's; in a row, too."""
    spin = np.array([3.0, -4.0, 12.0])
    scene, p = ball(names, friction=None, wx=3.0, wy=-4.0, wz=12.0)
    t, y = jnp.zeros(()), scene.initial_state(p)
    torque = -M * G * np.array([ROLL * 0.6, -ROLL * 0.8, DRILL])
    moved = scene.motions(t, y, p)
    for name in names:
        np.testing.assert_allclose(moved[name].spin_rate, torque / INERTIA, rtol=1e-6)
    # Each torque is proportional to its lever.
    for key, across, along in (("rolling_length", 1.0, 0.0), ("drilling_length", 0.0, 1.0)):
        slope = jax.jacfwd(lambda x, k=key: scene.motions(t, y, {**p, k: x})[names[0]].spin_rate)(p[key])
        part = torque * np.array([across, across, along]) / INERTIA / float(p[key])
        np.testing.assert_allclose(slope, part, rtol=1e-6, atol=1e-9 * np.abs(part).max())
    flows = scene.flows(t, y, p)
    assert float(flows.taken["friction"]) == pytest.approx(-len(names) * torque @ spin, rel=1e-6)
    # At rest nothing resists, and nothing is NaN.
    still = y.at[-6 * len(names) :].set(0.0)
    assert np.abs(scene.vector_field(t, still, p)).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("friction", ["lugre", "coulomb"])
def test_a_ball_at_rest_on_a_slope_creeps_as_its_resistance_does(friction):
    """m g R sin a = N r w/sqrt(w^2 + s^2): it begins to roll at that w, bristles without slip, and nothing accelerates."""
    tilt, lever = 0.1, 0.2 * R
    up = (np.sin(tilt), 0.0, np.cos(tilt))
    start = {key: R * x for key, x in zip("xz", (up[0], up[2]), strict=True)}
    body = Body("ball", "free", mass=M, inertia=INERTIA, start=start)
    floor = Contact("floor", (GROUND, "ball"), gaps.SphereOnPlane(up), friction=friction, rolling=True)
    made = Mechanism("slope", [body], [floor], [Gravity("-z")], start="static")
    given = {**NUMBERS, "rolling_length": lever, "bristle_stiffness": 1e5, "bristle_damping": 100.0}
    p = made.parameters({key: x for key, x in given.items() if key in made.quantities})
    y = made.initial_state(p)
    used = R * np.tan(tilt) / lever
    spin = S * used / np.sqrt(1.0 - used**2)
    np.testing.assert_allclose(y[10:13], [0.0, spin, 0.0], rtol=1e-6, atol=1e-12)
    slip = 1e-3 * np.tan(tilt) / np.sqrt(0.4**2 - np.tan(tilt) ** 2) if friction == "coulomb" else 0.0
    down = (R * spin + slip) * np.array([up[2], 0.0, -up[0]])
    np.testing.assert_allclose(y[7:10], down, rtol=2e-4, atol=1e-10)
    assert np.abs(made.vector_field(jnp.zeros(()), y, p)[7:13]).max() < 1e-5 * G / R


@pytest.mark.full
def test_a_ball_rolls_out():
    """It rolls on with dv/dt = -N r R/(I + m R^2), that is -(5/7) g r/R, while friction keeps it from slipping."""
    scene, p = ball(vx=0.2, wy=0.2 / R, wz=5.0)
    times = np.linspace(0.0, 0.05, 11)
    run = bj.simulate(scene, p, times, read=["ball.velocity.x", "ball.spin.y", "ball.spin.z"], accuracy=1e-3)
    assert run.status == "ok"
    speed = 0.2 - 5.0 / 7.0 * G * ROLL / R * times
    np.testing.assert_allclose(run.readings["ball.velocity.x"], speed, atol=2e-4)
    np.testing.assert_allclose(run.readings["ball.spin.y"] * R, speed, atol=1e-3)
    # Along the normal it turns slower by N b/I.
    np.testing.assert_allclose(
        run.readings["ball.spin.z"], np.maximum(5.0 - M * G * DRILL / INERTIA * times, 0.0), atol=0.01
    )


@pytest.mark.slow
def test_how_far_it_rolls_and_spins_has_its_derivative():
    """dv/dr = -(5/7) g t/R of the lever r of rolling; of that of drilling b the spin's -N t/I."""
    scene, p = ball(vx=0.2, wy=0.2 / R, wz=5.0)
    times, names = np.array([0.0, 0.02]), ["ball.velocity.x", "ball.spin.z"]

    def after(roll, drill):
        now = {**p, "rolling_length": roll, "drilling_length": drill}
        found = bj.reading_history(scene, now, times, names, accuracy=1e-3)
        return jnp.stack([found[name][-1] for name in names])

    slope = jax.jacfwd(after, (0, 1))(jnp.asarray(ROLL), jnp.asarray(DRILL))
    assert float(slope[0][0]) == pytest.approx(-5.0 / 7.0 * G * 0.02 / R, rel=1e-2)
    assert float(slope[1][1]) == pytest.approx(-M * G * 0.02 / INERTIA, rel=1e-2)
