"""Gaps beside the joint's closed forms of the same contacts: grooves, windows, pilots."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gap_cases import ZERO, Case, R, found, frame, numbers, turned
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
