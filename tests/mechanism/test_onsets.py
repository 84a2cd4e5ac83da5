"""Loads that begin somewhere: stops, cables and backlash are not stepped over, and derivatives pass their corners."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps
from bcfj_jax.mechanism.loads import Coupling, Force, Gravity, JointSpring, Spring

G, K, C, V = 9.81, 1e4, 20.0, 1.0
# A damped spring that pushes alone (Schwager and Poeschel, Granular Matter 9 (2007) 465): b = c/(2 m) of 1 kg, w^2 = k/m - b^2.
B = 0.5 * C
W = np.sqrt(K - B * B)
E = np.exp(-B / W * (np.pi - np.arctan(2.0 * B * W / (W * W - B * B))))


def mass(**start):
    return Body("a", "slide", axis="x", mass=1.0, start=start)


def after(scene, name, value, names, end, accuracy: str | float = "balanced"):
    """Readings at the end, and their derivatives by a parameter."""
    params = scene.parameters()

    def found(x):
        return bj.reading_history(scene, {**params, name: x}, jnp.array([0.5 * end, end]), names, accuracy=accuracy)

    values, slopes = jax.jvp(found, (jnp.asarray(value),), (jnp.ones(()),))
    return [float(x[name][-1]) for name in names for x in (values, slopes)]


STOPS = {
    "push": (JointSpring("stop", "a", K, C, rest=0.01, side="push"), "stop.rest", 0.01, -V),
    "pull": (Spring("stop", ("ground", "a"), K, C, 0.09, side="pull"), "stop.free_length", 0.09, V),
    "table": (
        Spring("stop", ("ground", "a"), 0.0, 0.0, 0.03, table=((0.0, 0.06, 0.07), (0.0, 0.0, 100.0))),
        "stop.free_length", 0.03, V,
    ),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("kind", tiers.ci(STOPS, "push"))
def test_derivatives_pass_where_a_spring_begins_and_lets_go(kind):
    """A mass flies against a stop: velocity -e v after it; a stop that is moved by s moves the place by (1 + e) s."""
    load, name, value, speed = STOPS[kind]
    e = 1.0 if kind == "table" else E
    scene = Mechanism("bump", [mass(position=0.05, velocity=speed)], loads=[load])
    _, by, velocity, changes = after(scene, name, value, ("a.position", "a.velocity"), 0.15)
    assert velocity == pytest.approx(-e * speed, rel=1e-5)
    assert by == pytest.approx(1.0 + e, rel=1e-5) and changes == pytest.approx(0.0, abs=1e-4)


def test_derivatives_pass_a_break_after_a_landing():
    """A step ends where a table has a knot, which stays where it is, whatever a landing before has moved."""
    load, name, value, speed = STOPS["push"]
    nothing = Force("nothing", "a", "x", table=((0.0, 0.1, 1.0), (0.0, 0.0, 0.0)))
    scene = Mechanism("bump", [mass(position=0.05, velocity=speed)], loads=[load, nothing])
    _, by, _, changes = after(scene, name, value, ("a.position", "a.velocity"), 0.15)
    assert by == pytest.approx(1.0 + E, rel=1e-5) and changes == pytest.approx(0.0, abs=1e-4)


def gears(**how):
    """Two wheels of 2 and 1 kg m^2 with damped teeth, which meet at 10 rad/s."""
    wheels = [
        Body("a", "hinge", mass=1.0, inertia=2.0, start={"speed": 10.0}),
        Body("b", "hinge", mass=1.0, inertia=1.0),
    ]
    mesh = Coupling("mesh", joints=("a", "b"), ratio=1.0, stiffness=1e5, damping=20.0, backlash=0.4)
    return Mechanism("gears", wheels, loads=[mesh], **how)


@pytest.mark.slow
def test_derivatives_pass_a_backlash():
    """The speeds after do not depend on the play, and momentum stays."""
    one, by_one, other, by_other = after(gears(), "mesh.backlash", 0.4, ("a.speed", "b.speed"), 0.05)
    assert 2.0 * one + other == pytest.approx(20.0, rel=1e-9) and other > 10.0
    assert (by_one, by_other) == pytest.approx((0.0, 0.0), abs=1e-4)


@pytest.mark.full
def test_derivatives_pass_a_jump_however_tight_the_steps():
    """A step across a force that jumps is rejected until it is as short as rounding: it lands on the surface before."""
    found = after(gears(), "mesh.backlash", 0.4, ("b.speed",), 0.05, accuracy=1e-7)
    assert found[1] == pytest.approx(0.0, abs=1e-4)


def bumper(**how):
    """``STOPS``' damped stop as a contact."""
    contact = Contact("c", ("ground", "a"), gaps.PointOnPlane("x"), law="kelvin_voigt", smoothing=False)
    return Mechanism(
        "bumper", [mass(position=0.05, velocity=-V)], [contact], given={"stiffness": K, "dashpot": C}, **how
    )


@pytest.mark.parametrize("kind", tiers.ci(["stop", "contact"], "stop"))
def test_implicit_solvers_pass_a_jump(kind):
    """As explicit ones: a dashpot that begins at once takes the tangent of the flight along."""
    load, *_ = STOPS["push"]
    stop = Mechanism("bump", [mass(position=0.05, velocity=-V)], loads=[load], implicit=True)
    scene, name, value = (stop, "stop.rest", 0.01) if kind == "stop" else (bumper(implicit=True), "a.position", 0.05)
    by = 1.0 + E if kind == "stop" else -E
    _, slope, velocity, change = after(scene, name, value, ("a.position", "a.velocity"), 0.15)
    assert velocity == pytest.approx(E * V, rel=1e-4)
    assert slope == pytest.approx(by, rel=2e-3) and change == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_implicit_solvers_pass_a_jump_in_reverse():
    """Reverse derivatives are those of forward tangents there."""
    scene, params = bumper(implicit=True), bumper().parameters()

    def place(x):
        return bj.reading_history(
            scene, {**params, "a.position": x}, jnp.array([0.1, 0.15]), ["a.position"], mode="reverse"
        )["a.position"][-1]

    assert jax.grad(place)(jnp.asarray(0.05)) == pytest.approx(-E, rel=2e-3)


@pytest.mark.parametrize("share", tiers.ci([0.99, 0.99999], 0.99))
def test_a_stop_near_the_top_of_a_flight_is_met(share):
    """Thrown up by v against a hard stop at a share of its height: it comes down sooner, by twice what was left above."""
    speed = 4.0
    stop = share * speed**2 / (2.0 * G)
    body = Body("a", "slide", mass=1.0, start={"velocity": speed})
    loads = [Gravity("-z"), JointSpring("stop", "a", 1e9, rest=stop, side="pull")]
    scene = Mechanism("thrown", [body], loads=loads)
    run = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 0.7, 8), read=("a.position",))
    left = np.sqrt(speed**2 - 2.0 * G * stop)
    down = 0.7 - (speed - left) / G - np.pi / np.sqrt(1e9)
    assert run.readings["a.position"][-1] == pytest.approx(stop - left * down - 0.5 * G * down**2, abs=1e-5)
