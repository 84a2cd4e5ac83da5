"""Closed-form slopes of the joint's contact forces against forward differentiation."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import MANY, in_grooves, made, unit

from bcfj_jax.models.joint import contacts, system
from bcfj_jax.models.joint.contacts import act
from bcfj_jax.models.joint.slopes import slopes


class FrozenDict(dict):
    """A dictionary that ``functools.cache`` can take as an option."""

    def __hash__(self):
        return hash(tuple(sorted(self.items())))


def blocks(matrix: np.ndarray) -> list[np.ndarray]:
    """Force and moment by place, velocity and spin, apart: their sizes are far apart."""
    return [part for rows in np.split(matrix, matrix.shape[-2] // 3, -2)
            for part in np.split(rows, matrix.shape[-1] // 3, -1)]  # fmt: skip


def compare(laws, geometry, place, velocity, spin):
    """``slopes`` against forward differentiation of ``act``."""
    parts = [place, velocity] if spin is None else [place, velocity, spin]
    x = jnp.concatenate([jnp.asarray(part) for part in parts], -1)

    def wrench(x):
        return system.wrench(act(laws, geometry(x[..., :3]), x[..., 3:6], None if spin is None else x[..., 6:]))

    @jax.jit
    def both(x):
        value, push = jax.linearize(wrench, x)
        # Contacts are independent: one direction of all of them at once.
        wanted = jax.vmap(lambda d: push(jnp.broadcast_to(d, x.shape)), out_axes=-1)(jnp.eye(x.shape[-1]))
        return value, wanted, slopes(laws, geometry(x[..., :3]), x[..., 3:6], None if spin is None else x[..., 6:])[:3]

    value, wanted, (same, by_place, by_twist) = jax.device_get(both(x))
    assert abs(value).max() > 1.0
    assert np.allclose(same, value, rtol=0, atol=1e-12 * abs(value).max())
    assert by_place.shape[-1] == 3 and by_twist.shape[-1] == by_twist.shape[-2] == value.shape[-1]
    for got, right in zip(blocks(np.concatenate([by_place, by_twist], -1)), blocks(wanted), strict=True):
        assert np.all(np.isfinite(right))
        assert abs(got - right).max() <= 1e-12 * abs(right).max()


# In make test with friction on the default track, in make all-tests without and on the other track.
@pytest.mark.parametrize(
    "track", [pytest.param("gothic", marks=pytest.mark.full), pytest.param("circular", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("spin", [False, True], ids=["particle", "spin"])
@pytest.mark.parametrize("friction", [pytest.param(False, marks=pytest.mark.slow), True], ids=["smooth", "rough"])
def test_slopes_of_grooves(track, spin, friction):
    _, _, c = made(track=track, spin=spin, friction=friction)
    rng = np.random.default_rng(1)
    place, across = in_grooves(rng, float(c.groove.radius))
    velocity, twist = 0.2 * rng.normal(size=place.shape), 20.0 * rng.normal(size=place.shape) if spin else None
    compare(c.groove_laws, lambda p: contacts.grooves(c.groove, p, across), place, velocity, twist)


@pytest.mark.full
@pytest.mark.parametrize("spin", [False, True], ids=["particle", "spin"])
@pytest.mark.parametrize("friction", [False, True], ids=["smooth", "rough"])
def test_slopes_of_windows_and_pilots(spin, friction):
    _, _, c = made(spin=spin, friction=friction)
    rng = np.random.default_rng(2)
    axis = unit(rng)
    place = 0.0355 * np.cross(unit(rng, MANY), axis) + 3e-5 * rng.normal(size=(MANY, 1)) * axis
    velocity, twist = 0.2 * rng.normal(size=place.shape), 20.0 * rng.normal(size=place.shape) if spin else None
    clearance, ball = c.window_clearance, c.groove.ball
    compare(c.window_laws, lambda p: contacts.windows(clearance, ball, p, jnp.asarray(axis)), place, velocity, twist)
    # Pilots come in pairs, coefficients side by side.
    place = 6e-5 * unit(rng, MANY, 2) * rng.uniform(0.5, 1.5, (MANY, 2, 1))
    velocity, twist = 0.2 * rng.normal(size=place.shape), 20.0 * rng.normal(size=place.shape) if spin else None
    pair = jax.vmap(lambda p: contacts.pilots(c.pilot_clearance, c.pilot_hollow, p)._replace(lever_slope=None))
    compare(c.pilot_laws, lambda p: pair(p)._replace(lever_slope=-1.0), place, velocity, twist)


@pytest.mark.full
def test_slopes_of_unlike_laws():
    # A LawPair: other laws on either race, friction on one of them alone.
    _, _, c = made(laws=FrozenDict(head_ball="kelvin_voigt"), frictions=FrozenDict(head_ball=False), spin=True)
    rng = np.random.default_rng(3)
    place, across = in_grooves(rng, float(c.groove.radius))
    velocity, twist = 0.2 * rng.normal(size=place.shape), 20.0 * rng.normal(size=place.shape)
    compare(c.groove_laws, lambda p: contacts.grooves(c.groove, p, across), place, velocity, twist)
