"""Geometry and statics of the joint, against NumPy, mpmath and the numbers of the physics sheet (5.2, 5.4, 5.5)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import agrees, within
from scipy.optimize import brentq, minimize_scalar

from bcfj_jax.models.joint import geometry

T, RP, E, Z = 1800.0, 0.0355, 0.0045, 6
RC = float(np.hypot(RP, E))
DEFLECTION = np.radians(23.0)
AROUND = np.linspace(-np.pi, np.pi, 721)

centre = jax.jit(geometry.ball_centre)
distance = jax.jit(geometry.ball_distance)
in_cage = jax.jit(geometry.cage_azimuth)


def numpy_axes(beta: float) -> tuple[np.ndarray, np.ndarray]:
    """Axis of the head and its azimuth-zero direction: the seat's, turned about y."""
    return np.array([np.sin(beta), 0.0, np.cos(beta)]), np.array([np.cos(beta), 0.0, -np.sin(beta)])


@given(
    phi=st.floats(-20.0, 20.0),
    beta=st.floats(-1.5, 1.5),
    ratio=st.floats(-0.9, 0.9),
    rc=st.floats(1e-3, 10.0),
)
def test_constant_velocity(phi, beta, ratio, rc):
    e = ratio * rc
    p = np.asarray(centre(phi, beta, rc, e))
    head, first = numpy_axes(beta)
    assert np.linalg.norm(p - e * np.array([0.0, 0.0, 1.0])) == within(rc, 1e-12)
    assert np.linalg.norm(p + e * head) == within(rc, 1e-12)
    assert abs(p @ np.asarray(geometry.bisector(beta))) <= 1e-12 * rc
    # The same azimuth about either axis, without a jump: compared as directions.
    for x in (p[0], p @ first):
        length = np.hypot(x, p[1])
        assert np.allclose((x / length, p[1] / length), (np.cos(phi), np.sin(phi)), atol=1e-12, rtol=0.0)
    assert np.linalg.norm(p) == within(float(distance(phi, beta, rc, e)), 1e-12)


def test_ball_centre_is_where_the_two_track_circles_cross():
    # Either circle as a curve in its own plane, with no use of the bisecting plane.
    phi, beta = mpmath.mpf("0.7"), mpmath.mpf(float(DEFLECTION))
    e, rc = mpmath.mpf(E), mpmath.mpf(RC)

    def gap(seat, head):
        outer = [rc * mpmath.cos(seat) * mpmath.cos(phi), rc * mpmath.cos(seat) * mpmath.sin(phi)]
        outer.append(e + rc * mpmath.sin(seat))
        x, y, z = [rc * mpmath.cos(head) * f(phi) for f in (mpmath.cos, mpmath.sin)] + [rc * mpmath.sin(head) - e]
        inner = [x * mpmath.cos(beta) + z * mpmath.sin(beta), y, z * mpmath.cos(beta) - x * mpmath.sin(beta)]
        return outer, [a - b for a, b in zip(outer, inner, strict=True)]

    seat, head = mpmath.findroot(lambda s, h: gap(s, h)[1][:2], (-0.2, 0.2))
    outer, difference = gap(seat, head)
    assert max(abs(d) for d in difference) < 1e-14
    assert np.allclose(centre(0.7, DEFLECTION, RC, E), [float(x) for x in outer], rtol=1e-13, atol=0.0)


def test_shapes_and_axes():
    assert centre(AROUND, DEFLECTION, RC, E).shape == (721, 3)
    assert centre(AROUND[:, None], jnp.array([0.0, 0.2]), RC, E).shape == (721, 2, 3)
    assert geometry.bisector(0.3).shape == geometry.head_axis(0.3).shape == (3,)
    assert np.allclose(geometry.head_axis(0.3), (np.sin(0.3), 0.0, np.cos(0.3)), rtol=1e-15)
    assert np.allclose(geometry.bisector(0.6), geometry.head_axis(0.3), rtol=1e-15)
    assert geometry.pitch_radius(RC, E) == within(RP, 1e-15)
    assert geometry.track_radius(RP, E) == within(RC, 1e-15)


def test_distances_and_cage_azimuth_of_the_sheet():
    reach = np.asarray(distance(AROUND, DEFLECTION, RC, E)) * 1e3
    assert agrees(reach.min(), "34.61") and agrees(reach.max(), "36.41")
    assert reach.argmin() == 360 and reach.argmax() in (0, 720)
    deviation = np.asarray(in_cage(AROUND, DEFLECTION)) - AROUND
    q = float(geometry.window_deviation(DEFLECTION))
    assert agrees(q, ".01014") and agrees(abs(deviation).max(), ".01014") and agrees(np.degrees(q), ".581")
    finest = minimize_scalar(lambda x: float(in_cage(x, DEFLECTION)) - x, bounds=(0.5, 1.1), method="bounded")
    assert np.sin(-finest.fun) == within(q, 1e-9)
    # Along its window a ball moves by .36 mm.
    assert agrees(q * RP * 1e3, ".36")


@given(phi=st.floats(-30.0, 30.0), beta=st.floats(-2.5, 2.5))
def test_cage_azimuth_is_that_of_the_ball_and_counts_turns(phi, beta):
    p = np.asarray(centre(phi, beta, RC, E))
    direction = p @ np.array([np.cos(beta / 2), 0.0, -np.sin(beta / 2)]), p[1]
    turned = float(in_cage(phi, beta))
    expected = np.array(direction) / np.hypot(*direction)
    assert np.allclose((np.cos(turned), np.sin(turned)), expected, atol=1e-12, rtol=0.0)
    assert abs(turned - phi) < np.pi / 2
    assert float(in_cage(phi + 2.0 * np.pi, beta)) - turned == pytest.approx(2.0 * np.pi, abs=1e-12)


def test_derivatives_are_finite_and_right_where_formulas_degenerate():
    def everything(x):
        phi, beta, e = x
        parts = (
            geometry.ball_centre(phi, beta, RC, e).sum(),
            geometry.ball_distance(phi, beta, RC, e),
            geometry.cage_azimuth(phi, beta),
            geometry.window_deviation(beta),
            geometry.chord_length(1.0, beta),
            geometry.secondary_couple(T, beta),
            geometry.static_cage_load(T, RP, 0.7, Z, e),
            geometry.separating_force(T, RP, 0.7, e),
            geometry.deflected_cage_load(1e4, phi, 0.7, beta, geometry.track_radius(RP, e), e),
        )
        return jnp.stack(parts)

    forward, backward = jax.jit(jax.jacfwd(everything)), jax.jit(jax.jacrev(everything))
    second = jax.jit(jax.hessian(everything))
    for phi in (0.0, np.pi / 2, 0.7, np.pi):
        for beta in (0.0, DEFLECTION):
            for e in (0.0, E):
                x = jnp.array([phi, beta, e])
                slopes = forward(x)
                assert np.all(np.isfinite(slopes)) and np.all(np.isfinite(second(x)))
                assert np.allclose(slopes, backward(x), rtol=1e-12, atol=1e-9)
                step = 1e-6
                for k in range(3):
                    up, down = (everything(x.at[k].add(s)) for s in (step, -step))
                    assert np.allclose(slopes[:, k], (up - down) / (2 * step), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize(
    ("alpha", "normal", "cage", "total", "two_balls"),
    [
        (30, "16901", "3681", "22.09", "50.7"),
        (35, "14733", "3035", "18.21", "44.2"),
        (40, "13147", "2533", "15.20", "39.4"),
        (45, "11951.1", "2125.4", "12.75", "35.9"),
    ],
)
def test_statics_of_the_sheet(alpha, normal, cage, total, two_balls):
    angle = np.radians(alpha)
    tangential, pressed = geometry.static_ball_load(T, RP, angle, Z)
    load = geometry.static_cage_load(T, RP, angle, Z, E)
    assert agrees(tangential, "8450.7") and agrees(pressed, normal) and agrees(load, cage)
    assert agrees(Z * load / 1e3, total)
    assert agrees(geometry.static_ball_load(T, RP, angle, 2)[1] / 1e3, two_balls)
    # Balance: seat and head carry half of the cage's sum each, and Q = N sin(alpha) at Rp carries the torque.
    assert 2.0 * geometry.separating_force(T, RP, angle, E) == within(float(Z * load), 1e-14)
    assert geometry.separating_force(T, RP, angle, E) == within(T / np.tan(angle) * E / (RP * RC), 1e-14)
    assert Z * pressed * np.sin(angle) * RP == within(T, 1e-14)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_deflected_cage_load_balances_the_ball(direction):
    # Contact normals built from the ball's own position; the cage takes what the two tracks leave.
    alpha, normal = np.radians(40.0), 1e4
    head, first = numpy_axes(DEFLECTION)
    for phi in np.linspace(0.0, 6.0, 13):
        p = np.asarray(centre(phi, DEFLECTION, RC, E))
        across_seat = direction * np.array([-np.sin(phi), np.cos(phi), 0.0])
        across_head = direction * (-np.sin(phi) * first + np.cos(phi) * np.array([0.0, 1.0, 0.0]))
        n_seat = np.sin(alpha) * across_seat + np.cos(alpha) * (p - [0.0, 0.0, E]) / RC
        n_head = np.sin(alpha) * across_head + np.cos(alpha) * (p + E * head) / RC
        # The seat presses inwards and back, the head outwards and on.
        force = normal * (n_head - n_seat)
        load = float(geometry.deflected_cage_load(normal, direction * phi, alpha, DEFLECTION, RC, E))
        assert np.allclose(force, load * np.asarray(geometry.bisector(DEFLECTION)), rtol=1e-12, atol=1e-8)


def test_load_sharing_and_alternation():
    assert agrees(geometry.kappa(np.pi / 4, DEFLECTION, RC, E), "1.62")
    phi = np.radians(np.arange(0.0, 360.0, 60.0))
    solved = np.array([15221.3, 6198.3, 5868.7, 15018.1, 18403.3, 18334.8])
    first = np.asarray(geometry.load_sharing(phi, T, RP, np.radians(40.0), Z, np.radians(10.0), E))
    assert np.all(abs(first / solved - 1.0) < 0.14)
    assert first.sum() == within(T / (RP * np.sin(np.radians(40.0))), 1e-14)
    even = geometry.load_sharing(phi, T, RP, 0.7, Z, 0.0, E)
    assert np.allclose(even, geometry.static_ball_load(T, RP, 0.7, Z)[1], rtol=1e-15)
    for alpha, beta, e in ((np.pi / 4, DEFLECTION, E), (0.6, 0.1, E), (0.6, 0.1, 0.0), (0.6, 0.0, E), (0.6, 0.0, 0.0)):
        loads = np.asarray(geometry.deflected_cage_load(1.0, AROUND, alpha, beta, RC, e))
        assert bool(geometry.sign_alternates(alpha, beta, RC, e)) == (loads.min() < -1e-12 and loads.max() > 1e-12)
    # Concentric tracks: as documented.
    assert geometry.kappa(0.7, 0.3, RC, 0.0) == np.inf and np.isnan(geometry.kappa(0.7, 0.0, RC, 0.0))


def test_secondary_couples_balance_the_two_torques():
    couple = float(geometry.secondary_couple(T, DEFLECTION))
    assert agrees(couple, "366")
    head, first = numpy_axes(DEFLECTION)
    torques = T * np.array([0.0, 0.0, 1.0]) - T * head
    assert np.allclose(torques + couple * (np.array([1.0, 0.0, 0.0]) + first), 0.0, atol=1e-12 * T)


@pytest.mark.parametrize(("clearance", "printed"), [(0.003, "224.5"), (0.005, "289.8"), (0.01, "409.9")])
def test_flexible_length_is_the_longest_cylinder_in_the_torus(clearance, printed):
    bend, body = 1.0, 0.05
    length = float(geometry.flexible_length(bend, clearance, body))
    assert agrees(length * 1e3, printed)
    around = np.linspace(0.0, np.pi, 721)
    along = np.linspace(0.0, 1.0, 101)[:, None]

    def sticks_out(shift: float, long: float) -> float:
        # Surface of the cylinder, moved by ``shift`` inwards, against the wall of the hole.
        radial = np.hypot(bend - shift + body * np.cos(around), 0.5 * long * along)
        return float(np.max(np.hypot(radial - bend, body * np.sin(around))) - (body + clearance))

    def best(long: float) -> float:
        found = minimize_scalar(
            lambda s: sticks_out(s, long), bounds=(0.0, 2 * clearance), method="bounded", options={"xatol": 1e-12}
        )
        return float(found.fun)

    assert brentq(best, 0.5 * length, 1.5 * length, xtol=1e-12) == pytest.approx(length, rel=1e-7)
    one_sided = float(geometry.flexible_length_one_sided(bend, clearance, body))
    assert one_sided == within(2.0 * np.sqrt(2.0 * clearance * (bend + body)), 1e-14)
    assert one_sided == within(float(geometry.flexible_length(bend, clearance / 2, body)), 1e-15)


def test_chord():
    assert agrees(geometry.chord_length(1.0, DEFLECTION) * 1e3, "398.7")
    ends = np.array([[1.0, 0.0], [np.cos(DEFLECTION), np.sin(DEFLECTION)]])
    assert geometry.chord_length(1.0, DEFLECTION) == within(np.linalg.norm(ends[1] - ends[0]), 1e-14)


def test_longest_flexible_body_by_mpmath():
    r, c, d = mpmath.mpf(1), mpmath.mpf("0.005"), mpmath.mpf("0.05")
    half = mpmath.findroot(lambda x: (r + d - c) ** 2 + x**2 - (r + d + c) ** 2, 0.1)
    assert geometry.flexible_length(1.0, 0.005, 0.05) == within(float(2 * half), 1e-14)
    slope = jax.grad(geometry.flexible_length, (0, 1, 2))(1.0, 0.005, 0.05)
    assert np.allclose(slope, (2 * (0.005 / 1.05) ** 0.5, 2 * (1.05 / 0.005) ** 0.5, 2 * (0.005 / 1.05) ** 0.5))
