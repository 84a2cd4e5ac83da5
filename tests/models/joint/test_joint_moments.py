"""Moments on cage and shafts against Newton's laws of every body, and against the closed form of a bent joint."""

from __future__ import annotations

import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import QUICK, constants, noisy
from oracles import within

from bcfj_jax import scenes
from bcfj_jax.analysis.simulation import page
from bcfj_jax.models.joint import energy, moments, system
from bcfj_jax.models.joint.geometry import cage_axes

VARIANTS = {
    "all": {"window_ends": True, "bands": True, "spin": True},
    "particles": {"window_ends": False, "bands": False, "spin": False},
    "bristles, head fixed": {"friction": "lugre", "head": "fixed", "bands": False},
    "fixed cage": {"cage": "fixed", "window_ends": False, "bands": True},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_moments_are_the_rates_of_angular_momentum(name):
    scene = scenes.make("joint", **VARIANTS[name])
    params = scene.parameters(axial_load=2e3, load_torque=1800.0)
    y, t, c = jnp.asarray(noisy(scene, params, 5, places=1.5e-4)), jnp.asarray(1.0), constants(scene, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(t, y):
        state = system.view(scene, c, y)
        # What the equations of motion read: mass times acceleration, inertia times angular acceleration.
        pushed = system.on_bodies(scene, c, state, system.contact_forces(scene, c, state))
        more = energy.rubbed(scene, c, y), energy.power(scene, c, t, y).friction
        return state, pushed, system.on_parts(scene, c, state), moments.moments(scene, c, t, y), more

    state, (on_balls, coupling), exerted, found, more = jax.device_get(look(t, y))
    total = {
        body: [sum(part) for part in zip(*((x.force, x.moment) for x in found.values()), strict=True)]
        for body, found in exerted.items()
    }
    axis, where = np.asarray(c.axes[1]), scene.slices
    scale = max(np.abs(moment).max() for _, moment in total.values())
    assert total["head"][1] @ axis == pytest.approx(coupling[where["head_turn"]][0], abs=1e-10 * scale)
    if where["head"] is not None:
        assert total["head"][0] == pytest.approx(coupling[where["head"]], abs=1e-6)
        assert not np.any(found.bearings["head"].force)
    else:
        held = found.bearings["head"].force
        assert held[2] == pytest.approx(2e3 - total["head"][0] @ axis, rel=1e-12)
    if where["cage_turn"] is not None:
        azimuth = state.seat_turn if state.cage_azimuth is None else state.cage_azimuth
        axes = np.asarray(cage_axes(jnp.asarray(state.cage_axis), jnp.asarray(azimuth)))
        assert axes @ sum(found.cage.values()) == pytest.approx(coupling[where["cage_turn"]], abs=1e-10 * scale)
    # Action and reaction, about the joint's centre; bearings cancel all but the turning of a shaft.
    places = {"seat": np.zeros(3), "head": state.head_place, "cage": state.cage_place}
    balls = np.cross(state.ball_place, on_balls[:, :3]).sum(0) + (on_balls[:, 3:].sum(0) if scene.spin else 0.0)
    whole = balls + sum(moment + np.cross(places[body], force) for body, (force, moment) in total.items())
    assert whole == pytest.approx(np.zeros(3), abs=1e-9 * scale)
    assert sum(force for force, _ in total.values()) + on_balls[:, :3].sum(0) == pytest.approx(np.zeros(3), abs=1e-6)
    assert total["seat"][1][:2] == pytest.approx(-found.bearings["seat"].moment[:2], rel=1e-12)
    assert found.bearings["seat"].force == pytest.approx(-total["seat"][0], rel=1e-12)
    rubbed, friction = more
    assert set(rubbed) == {contact.name for contact in scene.contacts}
    assert sum(rubbed.values()) == within(friction, 1e-12) and min(rubbed.values()) != max(rubbed.values())


def test_what_tables_say_of_moments():
    times = np.linspace(0.0, 3.0, 4)
    cage = {"cage_ball": np.outer([0.0, 3.0, 3.0, 9.0], [0.6, 0.8, 0.0]), "seat_cage": np.zeros((4, 3))}
    held = moments.Loads(np.tile([3.0, 0.0, 4.0], (4, 1)), np.tile([0.0, 2.0, 0.0], (4, 1)))
    secondary = np.array([-1.0, -2.0, -4.0, -3.0])
    found = moments.Moments(cage, {"seat": held, "head": held}, {"seat": secondary, "head": secondary})
    free, fixed = (SimpleNamespace(slices={"head": at}) for at in (slice(0, 3), None))
    said = moments.quantities(free, times, found)
    assert said["moment on the cage, of all contacts"] == {"mean": 5.0, "peak": 9.0, "unit": "N m"}
    assert said["secondary couple on the head"] == {"mean": 3.0, "peak": 4.0, "unit": "N m"}
    assert said["bearing force of the seat"]["peak"] == 5.0 and "bearing force of the head" not in said
    assert "bearing force of the head" in moments.quantities(fixed, times, found)
    heads = moments.table(free, found)
    assert list(heads["cage.moment.y [N m]"]) == pytest.approx([0.0, 2.4, 2.4, 7.2])
    assert "head_bearing.force.x [N]" not in heads and heads["seat_bearing.couple.y [N m]"][0] == 2.0
    rows = page.quantity_rows({"engineering": {"quantities": said}})
    assert rows[0] == ["quantity", "mean", "peak"] and ["secondary couple on the seat", "3 N m", "4 N m"] in rows
    assert page.quantity_rows({}) == []
