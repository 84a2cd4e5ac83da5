"""Gaps beside the joint's closed forms of the same contacts, and by hand: grooves, windows, pilots."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gap_cases import CASES, ZERO, Case, R, found, frame, numbers, turned
from joints import made, unit

from bcfj_jax.contact.gaps import make_gap
from bcfj_jax.core.vectors import array
from bcfj_jax.models.joint import contacts


@pytest.mark.parametrize("section", ["gothic", "circular"])
@pytest.mark.parametrize("ground", [True, False])
def test_balls_in_grooves_are_those_of_the_joint(section, ground):
    _, params, c = made(track=section)
    rng = np.random.default_rng(11)
    grooves = jax.jit(contacts.grooves)
    for race, (side, name) in enumerate((("outer", "seat"), ("inner", "head"))):
        options = {"tracks": 6, "side": side, "section": section}
        gap = make_gap("ball_in_groove", **options)
        coefficients = {key: params[f"clearance_{name}_ball" if key == "clearance" else key] for key in gap.needs}
        sizes = {key: float(x) for key, x in coefficients.items()}
        axes = np.eye(3) if ground else turned(rng.uniform(0, 3), unit(rng))
        start = ZERO if ground else 1e-4 * rng.normal(size=3)
        balls = start + Case("ball_in_groove", options, sizes, None, 5e-5).place(rng) @ axes.T
        depth, normal, lever, gate = found(gap, frame(start, axes), frame(balls, np.eye(3)), coefficients)
        f = 2 * np.pi * np.arange(6) / 6
        across = (np.cos(f) * axes[:, [1]] - np.sin(f) * axes[:, [0]]).T
        place = balls - start - float(c.groove.offset[race]) * axes[:, 2]
        both = [jnp.broadcast_to(jnp.asarray(x)[:, None], (6, 2, 3)) for x in (place, across)]
        at = grooves(c.groove, *both)
        penetration, way, arm = (np.asarray(x)[:, race].swapaxes(0, 1) for x in (at.penetration, at.normal, at.lever))
        assert np.allclose(depth, penetration, rtol=0, atol=1e-15)
        # Rounding of the places, some 1e-17 m, over the distance whose direction the normal is.
        distance = penetration + float(c.groove.flank + c.groove.clearance[race])
        error = np.abs(normal - way).max(-1)
        assert np.all(error <= 1e-14 + 3e-17 / distance), np.max(error * distance)
        assert np.allclose(lever, arm[..., None] * way, rtol=0, atol=1e-14)
        along = np.cross(place, across)
        axial = array(gap.axial(frame(start, axes), frame(balls, np.eye(3)), coefficients))
        assert np.allclose(axial, along / np.linalg.norm(along, axis=-1, keepdims=True), rtol=0, atol=1e-14)
        wanted = 1.0 if at.gate is None else np.asarray(at.gate)[:, race].T
        assert np.allclose(gate, wanted, rtol=0, atol=1e-11)


def test_balls_in_windows_are_those_of_the_joint():
    rng = np.random.default_rng(12)
    axes, start = turned(1.3, unit(rng)), rng.normal(size=3)
    balls = start + 0.03 * unit(rng, 6)
    sizes = numbers({"clearance": 1e-5, "ball_radius": R})
    gap = make_gap("ball_between_planes")
    depth, normal, lever, _ = found(gap, frame(start, axes), frame(balls, np.eye(3)), sizes)
    at = contacts.windows(jnp.asarray(1e-5), jnp.asarray(R), jnp.asarray(balls - start), jnp.asarray(axes[:, 2]))
    assert np.allclose(depth.T, at.penetration, rtol=0, atol=1e-14)
    assert np.allclose(np.swapaxes(normal, 0, 1), at.normal, rtol=0, atol=1e-14)
    assert np.allclose(np.swapaxes(lever, 0, 1), at.lever[..., None] * at.normal, rtol=0, atol=1e-14)
    # Either sign: the first face's force less the second's; its axial reference is outward.
    outward = array(gap.axial(frame(start, axes), frame(balls, np.eye(3)), sizes))
    assert gap.signed and np.allclose(outward, balls - start)


@pytest.mark.parametrize(("axis", "windows"), [("y", 6), ("-x", 3), ((0.0, 0.6, 0.8), 5)])
def test_windows_turn_around_the_cage_by_a_full_turn(axis, windows):
    """Ball i is off the middle by its own way along e, turned by i/windows of a turn about z of the cage."""
    rng = np.random.default_rng(14)
    axes, start = turned(0.8, unit(rng)), rng.normal(size=3)
    first = {"y": (0.0, 1.0, 0.0), "-x": (-1.0, 0.0, 0.0)}.get(axis, axis)
    ways = np.array([turned(2 * np.pi * i / windows, np.array([0.0, 0.0, 1.0])) @ first for i in range(windows)])
    off = 1e-4 * rng.normal(size=windows)
    across = np.cross(ways, unit(rng, windows))
    balls = start + (off[:, None] * ways + 0.03 * across) @ axes.T
    gap = make_gap("ball_between_planes", axis=axis, windows=windows)
    sizes = numbers({"clearance": 1e-5, "ball_radius": R})
    depth, normal, lever, _ = found(gap, frame(start, axes), frame(balls, np.eye(3)), sizes)
    assert np.allclose(depth, [off - 1e-5, -off - 1e-5], rtol=0, atol=1e-14)
    assert np.allclose(normal, [ways @ axes.T, -ways @ axes.T], rtol=0, atol=1e-14)
    assert np.allclose(lever, R * np.asarray(normal), rtol=0, atol=1e-16)


@pytest.mark.parametrize("side", ["outer", "inner"])
def test_a_flank_is_there_on_its_own_side_of_the_grooves_middle(side):
    """A ball pressed out of the groove feels the flank of its side whole, the other one not; within 3 degrees, in part.

    Both of the gap and of the joint's own contact.
    """
    case = CASES[f"groove-{side}-gothic-0"]
    s, kappa = case.sizes, 1.0 if side == "outer" else -1.0
    q = R * (2.0 * s["conformity"] - 1.0)
    middle = np.array([q * np.sin(s["contact_angle"]), q * np.cos(s["contact_angle"])])
    out = case.track(0) - [0.0, 0.0, kappa * s["offset"]]
    out /= np.linalg.norm(out)
    _, _, c = made()
    for lean, share in ((0.5, 1.0), (np.arcsin(0.05), 1.0), (np.arcsin(0.025), 0.5), (0.0, 0.0), (-0.5, 0.0)):
        for sign in (1.0, -1.0):
            # From the centre of the circle of flank ``sign``, at an angle from the groove's middle.
            aside = sign * (np.sin(lean) - np.sin(s["contact_angle"])) * q
            high = kappa * (np.cos(lean) * q - middle[1])
            place = case.track(0) + high * out + aside * np.array([0.0, 1.0, 0.0])
            depth, _, _, gate = found(case.gap, frame(ZERO, np.eye(3)), frame(place, np.eye(3)), numbers(s))
            face = 0 if sign > 0 else 1
            assert depth[face] == pytest.approx(-s["clearance"], abs=1e-15)
            assert gate[face] == pytest.approx(share, abs=1e-9)
            race = 0 if side == "outer" else 1
            both = np.broadcast_to(place - [0.0, 0.0, kappa * s["offset"]], (1, 2, 3))
            at = jax.jit(contacts.grooves)(c.groove, both, np.broadcast_to([0.0, 1.0, 0.0], (1, 2, 3)))
            assert at.gate is not None and at.gate[0, race, face] == pytest.approx(share, abs=1e-6)


def test_pilots_are_those_of_the_joint():
    rng = np.random.default_rng(13)
    start = 1e-3 * rng.normal(size=3)
    for clearance, hollow in ((5e-5, 0.04), (7e-5, 0.031)):
        inner = start + 6e-5 * unit(rng, 5)
        sizes = numbers({"clearance": clearance, "radius": hollow})
        parts = found(make_gap("sphere_in_socket"), frame(start, np.eye(3)), frame(inner, np.eye(3)), sizes)
        depth, normal, lever, _ = parts
        at = contacts.pilots(jnp.full(5, clearance), jnp.full(5, hollow), jnp.asarray(inner - start))
        assert np.allclose(depth[0], at.penetration[:, 0], rtol=0, atol=1e-14)
        assert np.allclose(normal[0], at.normal[:, 0], rtol=0, atol=1e-14)
        assert np.allclose(lever[0], at.lever * at.normal[:, 0], rtol=0, atol=1e-14)
