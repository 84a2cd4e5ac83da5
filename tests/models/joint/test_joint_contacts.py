"""The joint's contacts one by one: gaps, normals and forces against the physics sheet 5.3."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import GROOVES, MANY, in_grooves, made, touches, unit
from oracles import within
from scipy.optimize import minimize

from bcfj_jax.models.joint import contacts, system
from bcfj_jax.models.joint.constants import constants, laws_of, laws_together
from bcfj_jax.models.joint.contacts import Geometry, act
from bcfj_jax.models.joint.kinematic import nominal

grooves, windows = jax.jit(contacts.grooves), jax.jit(contacts.windows)
acted = jax.jit(act)


def turned(angle: float, axis: np.ndarray) -> np.ndarray:
    """Rotation by an angle about a unit axis (Rodrigues)."""
    cross = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


# --- gaps and normals


def disturbed(scene, params, seed: int, size: float = 5e-5) -> jax.Array:
    """A state some 50 um and 0.2 m/s off the nominal one, the cage's axis a unit vector, turned by 0.3 rad."""
    rng = np.random.default_rng(seed)
    y = np.array(nominal(scene, params, jnp.asarray(0.3)))
    places = 3 * scene.balls + scene.coupling
    y += np.r_[size * rng.normal(size=places), 0.2 * rng.normal(size=y.size - places)]
    tilt = scene.slices["cage_turn"]
    if tilt is not None:
        axis = y[3 * scene.balls :][tilt]
        axis /= np.linalg.norm(axis)
    return jnp.asarray(y)


@pytest.mark.full
@pytest.mark.parametrize("track", ["gothic", "circular"])
def test_gaps_of_the_sheet(track):
    scene, params, _ = made(track=track)
    values = {name: float(value) for name, value in params.items()}
    values |= {"clearance_seat_ball": 13e-6, "clearance_head_ball": 17e-6, "clearance_seat_cage": 44e-6}
    params = scene.parameters(values)
    c, y = constants(scene, params), disturbed(scene, params, 4)
    state = system.view(scene, c, y)
    found = jax.jit(lambda y: touches(scene, c, system.view(scene, c, y)))(y)

    ball, cage, head = (np.asarray(x) for x in (state.ball_place, state.cage_place, state.head_place))
    beta, e, r = values["joint_angle"], values["offset"], values["ball_radius"]
    up = np.array([0.0, 0.0, 1.0])
    lean = turned(beta, np.array([0.0, 1.0, 0.0]))
    radius = np.sqrt(values["pitch_radius"] ** 2 + e**2)

    # Rows 1 and 2, seat and cage, cage and head: hollow radius less the inner radius less the centres' distance.
    wanted = np.linalg.norm(cage) - values["clearance_seat_cage"], np.linalg.norm(head - cage) - 50e-6
    assert np.allclose(found.pilots.penetration[:, 0], wanted, rtol=0, atol=1e-15)
    # Row 3.
    height = (ball - cage) @ np.asarray(state.cage_axis)
    sides = np.stack([height, -height], -1) - values["clearance_cage_ball"]
    assert np.allclose(found.windows.penetration, sides, rtol=0, atol=1e-15)
    # Rows 4 and 5 with the gothic arch: frames of seat and head, turned by their own angles.
    clearances = (13e-6, 17e-6)
    for i in range(scene.balls):
        for race, (axes, centre, turn, kappa) in enumerate(
            (
                (np.eye(3), e * up, float(state.seat_turn), 1.0),
                (lean, head - e * lean @ up, float(state.head_turn), -1.0),
            )
        ):
            frame = axes @ turned(turn + 2 * np.pi * i / scene.balls, up)
            p = frame.T @ (ball[i] - centre)
            q = radius * np.array([p[0], 0.0, p[2]]) / np.hypot(p[0], p[2])
            if track == "circular":
                wanted = [np.linalg.norm(p - q) - clearances[race]]
            else:
                rg = 2 * values["conformity"] * r
                alpha = values["contact_angle"]
                aside, outward = np.sin(alpha) * np.array([0.0, 1.0, 0.0]), kappa * np.cos(alpha) * q / radius
                flanks = [q - (rg - r) * (s * aside + outward) for s in (1, -1)]
                wanted = [np.linalg.norm(p - flank) - (rg - r) - clearances[race] for flank in flanks]
            assert np.allclose(found.grooves.penetration[i, race], wanted, rtol=0, atol=1e-15)


@pytest.mark.parametrize("track", ["gothic", "circular"])
def test_groove_is_a_torus(track):
    # The least distance between the ball's centre and any point of the torus, searched for.
    _, _, c = made(track=track)
    g = c.groove
    place, across = in_grooves(np.random.default_rng(5), float(g.radius))
    got = grooves(g, jnp.asarray(place), jnp.asarray(across)).penetration
    r, flank = float(g.ball), float(g.flank)
    for race, side in enumerate((1.0, -1.0)):
        for n in range(3):
            t, p = across[n, race], place[n, race]
            flat, high = np.linalg.norm(p - (p @ t) * t), p @ t
            for face, sign in enumerate(np.asarray(g.gothic)):
                circle = float(g.radius) - side * flank * float(g.cosine)
                level = -sign * flank * float(g.sine)
                tube = r + flank + float(g.clearance[race])

                def distance(x, circle=circle, level=level, tube=tube, flat=flat, high=high):
                    reach = circle + tube * np.cos(x[0])
                    surface = np.array([reach * np.cos(x[1]), reach * np.sin(x[1]), level + tube * np.sin(x[0])])
                    return 1e3 * np.linalg.norm(surface - [flat, 0.0, high])

                starts = [(v, 0.1) for v in np.linspace(0, 2 * np.pi, 6, endpoint=False)]
                least = min(minimize(distance, x, method="BFGS", options={"gtol": 1e-7}).fun for x in starts)
                assert float(got[n, race, face]) == pytest.approx(r - 1e-3 * least, abs=1e-10)


def test_pilot_is_a_sphere_in_a_sphere():
    place, clearance, hollow = np.array([[3e-5, -4e-5, 6e-5]]), np.array([5e-5]), np.array([0.04])
    at = contacts.pilots(clearance, hollow, jnp.asarray(place))
    inner = hollow[0] - clearance[0]

    def least(x):
        point = place[0] + inner * np.array([np.cos(x[0]) * np.cos(x[1]), np.cos(x[0]) * np.sin(x[1]), np.sin(x[0])])
        return 1e3 * (hollow[0] - np.linalg.norm(point))

    starts = ((0.5, 0.5), (1.0, -1.0), (0.7, 3.0))
    gap = min(minimize(least, x, method="BFGS", options={"gtol": 1e-9}).fun for x in starts)
    assert float(at.penetration[0, 0]) == pytest.approx(-1e-3 * gap, abs=1e-10)
    # The point of contact lies on the hollow sphere, on the inner centre's far side.
    point = place[0] + float(at.lever[0, 0]) * np.asarray(at.normal[0, 0])
    assert np.linalg.norm(point) == within(hollow[0], 1e-12)


def geometries():
    """(name, geometry by place, places): every kind of contact."""
    rng = np.random.default_rng(6)
    for track in ("gothic", "circular"):
        _, _, c = made(track=track)
        place, across = in_grooves(rng, float(c.groove.radius))
        yield track, functools.partial(grooves, c.groove, across=jnp.asarray(across)), place
    axis = unit(rng)
    yield "window", functools.partial(windows, 1e-5, 8e-3, axis=jnp.asarray(axis)), 0.03 * unit(rng, MANY)
    clearance, hollow = jnp.array([5e-5]), jnp.array([0.04])

    def pilot(place: jax.Array) -> Geometry:
        at = contacts.pilots(clearance, hollow, place[:, None])
        return at._replace(penetration=at.penetration[:, 0], normal=at.normal[:, 0])

    yield "pilot", pilot, 6e-5 * unit(rng, MANY)


def test_normals_are_gradients_of_the_gap():
    for name, geometry, place in geometries():
        normal = np.asarray(geometry(jnp.asarray(place)).normal)
        assert np.allclose(np.linalg.norm(normal, axis=-1), 1.0, rtol=0, atol=1e-12), name
        step = 1e-9 if name == "pilot" else 1e-7
        if name == "circular":
            # Deep in the middle the direction turns within the step.
            step = 1e-9
        for k in range(3):
            shift = step * np.eye(3)[k]
            up, down = (np.asarray(geometry(jnp.asarray(place + s * shift)).penetration) for s in (1, -1))
            # Gap = -penetration.
            assert np.allclose(normal[..., k], -((-up) - (-down)) / (2 * step), rtol=0, atol=1e-5), name


# --- what grooves do


def test_ball_without_clearance_touches_both_flanks_at_the_contact_angle():
    scene, params, c = made(smoothing=False)
    g = c.groove._replace(clearance=jnp.zeros(2))
    across = np.array([[0.0, 1.0, 0.0], [0.0, 0.6, 0.8]])
    radial = np.array([[0.6, 0.0, 0.8], [1.0, 0.0, 0.0]])
    at = grooves(g, jnp.asarray(float(g.radius) * radial), jnp.asarray(across))
    assert np.allclose(at.penetration, 0.0, rtol=0, atol=1e-15)
    alpha = np.radians(40.0)
    for race, side in enumerate((1.0, -1.0)):
        for face, sign in enumerate((1.0, -1.0)):
            wanted = sign * np.sin(alpha) * across[race] + side * np.cos(alpha) * radial[race]
            assert np.allclose(at.normal[race, face], wanted, rtol=0, atol=1e-12)
    assert np.all(np.asarray(at.gate) == 1.0)
    # Pressed into the groove, outwards in the seat and inwards in the head, both flanks push back alike.
    depth = 20e-6 * np.array([[1.0], [-1.0]]) * radial
    at = grooves(g, jnp.asarray(float(g.radius) * radial + depth), jnp.asarray(across))
    touch = acted(laws_together(scene, params, GROOVES), at, jnp.zeros((2, 3)), None)
    assert np.allclose(touch.normal[:, 0], touch.normal[:, 1], rtol=1e-10) and np.all(np.asarray(touch.normal) > 100)
    pressed = np.asarray(touch.force)
    assert np.allclose(np.cross(pressed, -depth), 0.0, rtol=0, atol=1e-9 * abs(pressed).max() * 2e-5)
    # The law itself: d = 20 um cos(alpha), to first order in d over the flank's 320 um.
    assert float(touch.normal[0, 0]) == within(3.7e10 * (20e-6 * np.cos(alpha)) ** 1.5, 0.05)
    d = float(touch.penetration[0, 0])
    assert float(touch.normal[0, 0]) == within(3.7e10 * d**1.5, 1e-12)


def test_sector_gate():
    # A ball beyond the middle of a flank's circle is not that flank's any more.
    scene, params, c = made()
    g = c.groove
    across, radial = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    reach = float(g.flank) * np.sin(np.radians(40.0))
    shares = np.linspace(-1.5, 1.5, 61)
    place = float(g.radius) * radial + (reach * shares)[:, None] * across + 3e-4 * radial
    both = np.broadcast_to(place[:, None], (61, 2, 3))
    lines = jnp.broadcast_to(jnp.asarray(across), (61, 2, 3))
    at = grooves(g, jnp.asarray(both), lines)
    towards = np.einsum("nrfk,k->nrf", np.asarray(at.normal), across) * np.array([1.0, -1.0])
    s = np.clip(20.0 * towards, 0.0, 1.0)
    assert np.allclose(at.gate, s * s * (3 - 2 * s), rtol=0, atol=1e-12)
    gate = np.asarray(at.gate[:, 0])
    assert np.all(gate[shares < -1, 0] == 0.0) and np.all(gate[shares > 1, 1] == 0.0)
    assert np.all(gate[abs(shares) < 0.8] == 1.0)
    normal = np.asarray(acted(laws_together(scene, params, GROOVES), at, jnp.zeros((61, 2, 3)), None).normal[:, 0])
    assert np.all(normal[shares < -1, 0] == 0.0) and np.all(normal[shares > 0.9, 0] > 0.0)
    # Its slope, where it is between 0 and 1.
    # (Its second derivative jumps at either end: samples whose step straddles one are left out.)
    gate_of = jax.jit(lambda x: grooves(g, x, lines).gate)
    moved = (jnp.broadcast_to(e, both.shape) for e in jnp.eye(3))
    slope, step = np.stack([jax.jvp(gate_of, (jnp.asarray(both),), (e,))[1] for e in moved], -1), 1e-9
    for k in range(3):
        shift = step * np.eye(3)[k]
        up, down = (np.asarray(grooves(g, jnp.asarray(both + s * shift), lines).gate) for s in (1, -1))
        inside = (abs(20.0 * towards - 0.5) > 0.501) | (abs(20.0 * towards - 0.5) < 0.499)
        assert np.isclose(slope[..., k], (up - down) / (2 * step), rtol=0, atol=1e-3 * abs(slope).max())[inside].all()
    assert grooves(made(track="circular")[2].groove, jnp.asarray(both), lines).gate is None


# --- what contacts do


def test_forces_of_a_window():
    # Normal: K d^n (1 + a d'). Friction: N mu(u)/u u, against the slip, at the ball's surface where it spins.
    scene, params, c = made(spin=True)
    laws = laws_of(scene, params, "cage_ball")
    axis, depth, v, w = np.array([0.0, 0.0, 1.0]), 20e-6, np.array([0.3, -0.1, 0.05]), np.array([30.0, 10.0, 5.0])
    place = np.array([0.03, 0.01, 1e-5 + depth])
    at = windows(params["clearance_cage_ball"], c.groove.ball, jnp.asarray(place), jnp.asarray(axis))
    touch = acted(laws, at, jnp.asarray(v), jnp.asarray(w))
    normal = 1.3476e10 * depth**1.5 * (1.0 + 0.111 * v[2])
    assert float(touch.normal[0]) == within(normal, 1e-12) and float(touch.normal[1]) == 0.0
    slip = v - v[2] * axis + np.cross(w, 8e-3 * axis)
    x = np.linalg.norm(slip) / 0.1
    mu = 0.03 * np.tanh(4 * x) + 0.09 * x / (x * x / 4 + 0.75) ** 2
    drag = -normal * mu * slip / np.linalg.norm(slip)
    assert np.allclose(touch.drag, drag, rtol=1e-12)
    assert np.allclose(touch.force, drag - normal * axis, rtol=1e-12)
    assert np.allclose(touch.moment, np.cross(8e-3 * axis, drag), rtol=1e-12, atol=1e-15)
    assert float(touch.slip[0]) == within(np.linalg.norm(slip), 1e-12)
    # A ball that rolls does not slip; without spin it is a particle, and slides.
    rolling = acted(laws, at, jnp.asarray(-np.cross(w, 8e-3 * axis)), jnp.asarray(w))
    assert np.allclose(rolling.drag, 0.0, atol=1e-12 * normal)


@pytest.mark.parametrize("spin", [False, True], ids=["particle", "spin"])
def test_contacts_take_power_and_do_not_give_any(spin):
    # Frame-indifferent, so power is that on the relative twist: elastic part aside, it is lost.
    scene, params, c = made(spin=spin, law="hertz")
    rng = np.random.default_rng(7)
    place, across = in_grooves(rng, float(c.groove.radius))
    velocity, twist = 0.2 * rng.normal(size=place.shape), 20.0 * rng.normal(size=place.shape) if spin else None
    at = grooves(c.groove, jnp.asarray(place), jnp.asarray(across))
    laws = laws_together(scene, params, GROOVES)
    touch = acted(laws, at, jnp.asarray(velocity), twist if twist is None else jnp.asarray(twist))
    power = np.sum(np.asarray(touch.drag) * velocity, -1)
    if twist is not None:
        power = power + np.sum(np.asarray(touch.moment) * twist, -1)
    assert np.all(power <= 0.0) and power.min() < -1.0
    assert np.allclose(
        np.sum(np.asarray(touch.force) * velocity, -1),
        np.sum(np.asarray(touch.drag) * velocity, -1) - np.sum(np.asarray(touch.normal) * np.asarray(touch.rate), -1),
        rtol=1e-10,
        atol=1e-9,
    )
