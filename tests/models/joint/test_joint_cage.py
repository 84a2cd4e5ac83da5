"""The cage as it is: windows that end, its azimuth; and the joint of before where options are off."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from joints import QUICK, SEEDS, constants, flows, noisy, plain_joint, solved
from oracles import within
from scipy.spatial.transform import Rotation

import bcfj_jax as bj
from bcfj_jax.core.errors import InputError
from bcfj_jax.models.joint import checks, geometry, periodic, system
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.quasistatic import quasistatic
from bcfj_jax.models.joint.scene import OF_A_BALL
from benchmarks.references.joint_parts import as_mechanism

# The joint before windows had ends: field, a solved step and forces of contacts in disturbed states.
BEFORE = json.loads((Path(__file__).parents[2] / "data" / "joint_before.json").read_text(encoding="utf-8"))
OLD = {
    "all": {},
    "spin": {"spin": True},
    "fixed cage": {"cage": "fixed"},
    "bristles, spin": {"friction": "lugre", "spin": True},
    "unlike": {
        "laws": {"head_ball": "kelvin_voigt", "head_cage": "hertz"},
        "frictions": {"seat_ball": "coulomb", "seat_cage": False}, "spin": True,
    },
}  # fmt: skip
NEW = {
    "ends": {"window_ends": True},
    "ends, spin, bristles": {"window_ends": True, "spin": True, "friction": "lugre"},
    "ends, circular, unlike": {
        "window_ends": True, "track": "circular", "drive": "flexible",
        "laws": {"cage_window_end": "hertz"}, "frictions": {"cage_window_end": "coulomb"},
    },
    "bands": {"bands": True},
    "all": {"window_ends": True, "bands": True, "spin": True},
    "all, bristles, flexible": {
        "window_ends": True, "bands": True, "spin": True, "friction": "lugre", "drive": "flexible",
    },
    "bands, fixed cage": {"bands": True, "cage": "fixed"},
    "bands, memory": {"bands": True, "friction": "memory"},
    "all, frictional lag": {"window_ends": True, "bands": True, "spin": True, "friction": "frictional_lag"},
    "all, memory, fixed cage": {"bands": True, "spin": True, "cage": "fixed", "friction": "memory"},
}  # fmt: skip
# In CI's tier: the one with most in it; the old ones are those of test_joint_system.py.
FULL = ((NEW, "all, bristles, flexible"),)


def each(names):
    marks = {name: pytest.mark.full if (names, name) in FULL else pytest.mark.slow for name in names}
    return pytest.mark.parametrize("name", [pytest.param(name, marks=mark) for name, mark in marks.items()])


@each(OLD)
def test_without_the_new_options_nothing_has_changed(name):
    scene = plain_joint(**OLD[name])
    params = scene.parameters(axial_load=2e3)
    y, t = jnp.asarray(noisy(scene, params, 7, places=1.5e-4)), jnp.asarray(0.02)
    right = jnp.sin(1.0 + jnp.arange(y.size))

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(y, c):
        structure, args = Arrowhead(), (scene, c)
        solved = structure.solve(structure.factor(t, y, args, 1e-4), right)
        jacobian = jax.jacfwd(lambda y: system.field(t, y, args))(y)
        return system.field(t, y, args), solved, jacobian, {k: r.force for k, r in scene.observe(t, y, c).items()}

    field, solved, jacobian, forces = jax.device_get(look(y, constants(scene, params)))
    # Another order of the same operations moves the solution by 4e-10 of its size: it is judged by what it leaves.
    matrix = np.eye(y.size) / 1e-4 - jacobian
    assert np.all(np.abs(matrix @ solved - right) <= 1e-12 * (np.abs(matrix) @ np.abs(solved) + np.abs(right)))
    found = {"field": field, **forces}
    known = {"field": BEFORE[name]["field"], **BEFORE[name]["readings"]}
    assert set(found) == set(known)
    assert np.abs(solved - BEFORE[name]["solved"]).max() <= 1e-9 * np.abs(solved).max()
    for what, values in known.items():
        size = np.abs(values).max()
        assert size > 0.0 and np.abs(found[what] - np.asarray(values)).max() <= 1e-10 * size, what


# --- states and their derivatives


def pressed(scene, params, seed, side=1.0):
    """A disturbed state whose balls press the ends of some windows, and spheres the edges of bands; bristles bent."""
    y = np.array(noisy(scene, params, seed, places=8e-5))
    draw = np.random.default_rng(seed)
    stated = draw.normal(size=y[scene.moving : scene.azimuth].size)
    y[scene.moving : scene.azimuth] = 1e-6 * stated if scene.width == 3 else 0.05 * np.abs(stated)
    if scene.azimuth is not None:
        y[scene.azimuth] -= side * float(params["clearance_cage_window_end"]) / float(params["pitch_radius"])
    if scene.banded:
        half, first = 0.5 * float(params["joint_angle"]), 3 * scene.balls
        off, where = 1.15e-4 * side * np.array([np.sin(half), 0.0, np.cos(half)]), scene.slices
        cage = np.zeros(3)
        if where["cage"] is not None:
            at = slice(first + where["cage"].start, first + where["cage"].stop)
            cage = y[at] = off + 4e-6 * draw.normal(size=3)
        y[first + where["head"].start : first + where["head"].stop] = cage + off + 4e-6 * draw.normal(size=3)
    return y


@pytest.mark.slow
@each(NEW)
def test_arrowhead_solves_with_the_exact_jacobian(name):
    scene = plain_joint(**NEW[name])
    params = scene.parameters(axial_load=2e3)
    y, t = pressed(scene, params, 3), jnp.asarray(0.02)
    places = 3 * scene.balls + scene.coupling
    index, last = np.arange(y.size), scene.states if scene.azimuth is None else scene.azimuth
    new = [*(scene.pilots if scene.banded else ()), *(["cage_window_end"] if scene.azimuth else [])]
    right = np.random.default_rng(1).normal(size=y.size)
    right *= np.select([index < places, index < scene.moving, index < last], [1.0, 1e4, 1e-5], 1.0)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(y, scale, c):
        structure, args = Arrowhead(), (scene, c)
        jacobian = jax.jacfwd(lambda y: system.field(t, y, args))(y)
        readings = scene.observe(t, y, c)
        forces = {name: readings[name].force[..., 0] for name in new}
        return structure.solve(structure.factor(t, y, args, scale), right), jacobian, forces

    for scale in (2e-5, 1e-3):
        got, jacobian, forces = jax.device_get(both(jnp.asarray(y), scale, constants(scene, params)))
        assert all(np.any(force) for force in forces.values())
        matrix = np.eye(y.size) / scale - jacobian
        wanted = np.linalg.solve(matrix, right)
        # The dense solution is the worse one, until its rest is seen with more digits.
        for _ in range(3):
            wanted = wanted + np.linalg.solve(matrix, np.asarray(right - matrix.astype(np.longdouble) @ wanted, float))
        velocities = (index >= places) & (index < scene.moving)
        for part in (index < places, velocities, index[scene.moving : last], index[last:]):
            if wanted[part].size:
                assert np.abs(got - wanted)[part].max() <= 2e-10 * np.abs(wanted[part]).max()


@jax.jit
def turned(axis, spin, azimuth):
    """Axes of a cage and their rates; derivative of the azimuth's rate by the axis, forward and in closed form."""

    def axes(b, psi):
        return geometry.cage_axes(b / jnp.sqrt(b @ b), psi)

    rate = geometry.azimuth_rate(axis, spin)
    moved = jax.jvp(axes, (axis, azimuth), (jnp.cross(spin, axis), rate))
    slope = jax.grad(lambda b: geometry.azimuth_rate(b / jnp.sqrt(b @ b), spin))(axis)
    return *moved, slope, geometry.rate_by_axis(axis, spin)


@given(seed=SEEDS)
@settings(max_examples=25)
def test_the_azimuths_axes_turn_with_the_cage(seed):
    draw = np.random.default_rng(seed)
    axis = np.array([np.sin(0.2), 0.0, np.cos(0.2)]) + 0.1 * draw.normal(size=3)
    axis, spin, azimuth = axis / np.linalg.norm(axis), draw.normal(size=3), draw.uniform(-9.0, 9.0)
    found, moving, slope, by_axis = jax.device_get(turned(axis, spin, azimuth))
    assert np.allclose(found.T @ found, np.eye(3), atol=1e-14) and np.linalg.det(found) > 0.0
    # Every one of the axes turns at the cage's own angular velocity.
    assert np.allclose(moving, np.cross(spin, np.asarray(found), axis=0), atol=1e-13 * np.linalg.norm(spin))
    assert np.allclose(by_axis, slope, atol=1e-13)


def test_windows_stand_around_the_cage_at_their_azimuths():
    """From y x b, by the azimuth about b: the middle of a window; its ends' normal is another quarter turn on."""
    draw = np.random.default_rng(2)
    axis = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
    azimuths = draw.uniform(-9.0, 9.0, 7)
    first = np.cross([0.0, 1.0, 0.0], axis) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], axis))
    turn = Rotation.from_rotvec((azimuths + 0.5 * np.pi)[:, None] * axis)
    assert np.allclose(geometry.windows_around(axis, azimuths), turn.apply(first), rtol=0, atol=1e-14)
    middle = Rotation.from_rotvec(azimuths[0] * axis).apply(first)
    assert np.allclose(geometry.cage_axes(axis, azimuths[0])[:, 0], middle, rtol=0, atol=1e-14)


def test_balls_swing_in_their_windows_as_the_check_says():
    # The swing of all balls of the zero-clearance joint against the ends, over a pitch, the cage where it fits best.
    scene = plain_joint(window_ends=True, balls=5)
    params = scene.parameters()
    beta, pitch, offset = (float(params[key]) for key in ("joint_angle", "pitch_radius", "offset"))
    turns = np.linspace(0.0, 2.0 * np.pi / 5, 400)[:, None]
    radius = geometry.track_radius(pitch, offset)
    places = np.asarray(geometry.ball_centre(turns + scene.azimuths, beta, radius, offset))
    axis = geometry.bisector(beta)
    around = jax.vmap(lambda turn: geometry.windows_around(axis, turn + scene.azimuths))(turns[:, 0])
    swing = np.sum(places * around, -1)
    swing = np.asarray(swing)
    need = 0.5 * float(np.max(swing.max(1) - swing.min(1)))
    assert checks.swing(5.0, pitch, offset, beta) == within(need, 1e-3)
    # The check asks for it; and something must be left between windows.
    scene.check(scene.parameters(clearance_cage_window_end=1.01 * need))
    with pytest.raises(InputError, match=r"clearance_cage_window_end.*joint_angle of at most"):
        scene.check(scene.parameters(clearance_cage_window_end=0.99 * need))
    with pytest.raises(InputError, match="leaves nothing of the cage"):
        scene.check(scene.parameters(clearance_cage_window_end=0.016))


def test_window_ends_are_refused_where_there_is_no_free_window():
    grooves = ["seat_ball", "head_ball"]
    with pytest.raises(InputError, match=r"with a fixed cage.*turns as the drive"):
        plain_joint(cage="fixed", contacts=["cage_ball", *grooves, "cage_window_end"])
    with pytest.raises(InputError, match="without cage_ball"):
        plain_joint(contacts=["seat_cage", *grooves, "cage_window_end"])
    assert not plain_joint(cage="fixed", window_ends=True).has("cage_window_end")
    named = [*grooves, "cage_ball", "seat_cage", "head_cage", "cage_window_end"]
    assert plain_joint(contacts=named) == plain_joint(window_ends=True)
    assert plain_joint().azimuth is None and "clearance_cage_window_end" not in plain_joint().quantities


# --- what they do


@functools.cache
def steady():
    """Scene, parameters, times and states of a joint with window ends, its fifth pitch."""
    scene = plain_joint(window_ends=True)
    params = scene.parameters()
    times = jnp.concatenate([jnp.zeros(1), jnp.linspace(0.4, 0.5, 201)])
    start = scene.initial_state(params)
    return scene, params, np.asarray(times[1:]), solved(scene, params, start, times, 2e-3)[1:]


@pytest.mark.slow
def test_window_ends_bear_the_torque_that_holds_the_cage():
    scene, params, times, states = steady()
    c, tilt = constants(scene, params), scene.slices["cage_turn"]

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(states):
        def one(y):
            state = system.view(scene, c, y)
            found = system.contact_forces(scene, c, state)
            # All contacts of the cage but the ends of its windows.
            but = found._replace(balls=tuple(jax.tree.map(lambda x: x[:, :3], touch) for touch in found.balls))
            others = system.on_bodies(scene, c, state, but)[1][tilt]
            return others @ state.cage_axis, scene.observe(0.0, y, c)["cage_window_end"].force[:, 0]

        return jax.lax.map(one, states)

    drag, force = jax.device_get(look(states))
    # Pilots and faces brake the cage by some 22 N m; the balls push the ends by as much over the pitch radius.
    assert -25.0 < drag.mean() < -20.0 and np.ptp(drag) > 1.0
    assert force.sum(1).mean() == within(-drag.mean() / float(params["pitch_radius"]), 0.02)
    assert 550.0 < force.sum(1).mean() < 750.0 and force.min() > -1.0
    # The cage turns as the seat does, behind it by a clearance less the balls' swing.
    lag = np.asarray(states)[:, scene.azimuth] - float(params["drive_speed"]) * times
    assert -2.5e-3 / 0.0355 < lag.mean() < -2.1e-3 / 0.0355 and np.ptp(lag) < 0.01


@pytest.mark.slow
def test_gyroscopic_couples_of_a_ring_are_small():
    # What a spherical shell leaves out: (0.917 - 0.542) m R^2 |w x (w . b) b| for a ring between +-30 degrees.
    scene, params, _, found = steady()
    states = jax.vmap(lambda y: system.view(scene, constants(scene, params), y))(found)
    along = np.sum(states.cage_spin * states.cage_axis, -1, keepdims=True) * np.asarray(states.cage_axis)
    couple = 0.375 * float(params["cage_mass"]) * float(params["pitch_radius"]) ** 2
    couple *= np.linalg.norm(np.cross(states.cage_spin, along), axis=-1).max()
    assert couple < 1e-3 < 1e-4 * 23.0


@each(NEW)
def test_power_is_the_rate_of_what_is_stored(name):
    scene = plain_joint(**NEW[name])
    params = scene.parameters(axial_load=2e3)
    read = flows(scene, params)
    for seed, side in ((1, 1.0), (2, -1.0), (3, 1.0)):
        y = pressed(scene, params, seed, side)
        y[scene.moving : scene.azimuth] = 0.0
        flow, store, rate = read(0.05, y)
        size = sum(abs(x) for x in flow) + sum(abs(x) for x in rate)
        assert float(store.elastic) > 0.0 and abs(float(flow.net - rate.total)) < 1e-9 * float(size)


@pytest.mark.slow
def test_without_friction_window_ends_bear_nothing():
    scene = plain_joint(window_ends=True, fidelity="quasistatic")
    params = scene.parameters()
    times = np.array([0.06, 0.11])
    found = quasistatic(scene, params, times)
    assert np.all(found.converged)
    assert np.asarray(found.states)[:, scene.azimuth] == pytest.approx(float(params["drive_speed"]) * times)
    readings = jax.vmap(lambda y: scene.observe(0.0, y, scene.prepare(params)))(found.states)
    assert not np.any(readings["cage_window_end"].force) and np.all(readings["seat_cage"].force[:, 0] > 1e3)


@pytest.mark.slow
def test_motion_with_window_ends_repeats_itself_with_balls_and_windows_renumbered():
    scene, params, times, states = steady()
    before = np.asarray(periodic.pitch_before(scene, params, states[-1]))
    assert times[-1] - times[0] == within(float(scene.pitch(params)), 1e-9)
    n = scene.balls
    states = np.asarray(states)
    # The motion has settled to a few um and mrad.
    assert np.abs(before - states[0])[: 3 * n].max() < 5e-6
    assert abs(before - states[0])[scene.azimuth] < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("load", [0.0, 2e4])
def test_a_mirrored_joint_does_what_a_mirror_shows(load):
    # Across the plane of deflection: drive and torque turn the other way, and so do balls and the ends of windows.
    scene = plain_joint(window_ends=True, bands=True, spin=True)
    times = np.linspace(0.0, 0.25, 251)
    # Ends so near that the cage comes to them within the run.
    params = scene.parameters(axial_load=load, clearance_cage_window_end=0.5e-3)
    other = {name: -params[name] for name in ("drive_speed", "load_torque")}
    one, two = (bj.simulate(scene, p, times, accuracy=3e-5) for p in (params, {**params, **other}))
    assert one.status == two.status == "ok"
    which = -np.arange(scene.balls) % scene.balls
    for contact in scene.contacts:
        left, right = one.force[contact.name][..., 0], two.force[contact.name][..., 0]
        if contact.name in OF_A_BALL:
            right = right[:, which] * (-1.0 if contact.name == "cage_window_end" else 1.0)
        # Rounding differs, and where contacts begin it grows: 2e-4 at most.
        assert np.abs(left).max() > 50.0 and np.sqrt(np.mean((left - right) ** 2)) <= 1e-4 * np.abs(left).max()
        assert np.abs(left - right).max() <= 1e-3 * np.abs(left).max(), contact.name
    assert two.trajectory[:, scene.azimuth] == pytest.approx(-one.trajectory[:, scene.azimuth], abs=1e-6)


# --- as others see it


@pytest.mark.full
def test_the_generic_mechanism_has_the_same_window_ends():
    scene = plain_joint(window_ends=True, spin=True)
    gaps = {contact.name: contact.gap for contact in as_mechanism(scene).contacts}
    assert gaps["cage_window_end"].windows == scene.balls and gaps["cage_ball"].windows == 0


@pytest.mark.full
def test_the_cage_is_drawn_and_read_with_its_azimuth():
    scene = plain_joint(window_ends=True)
    params = scene.parameters()
    y = np.array(scene.initial_state(params))
    y[scene.azimuth] = 0.3
    c = scene.prepare(params)
    look = jax.jit(lambda y: (scene.motions(0.0, y, c)["cage"], scene.scenery(0.0, y, params).poses["cage"]))
    moved, pose = jax.device_get(look(jnp.asarray(y)))
    axes = moved.axes
    assert moved.angle == 0.3 and pose.axes == pytest.approx(axes)
    half = 0.5 * float(params["joint_angle"])
    first = np.array([np.cos(half), 0.0, -np.sin(half)])
    assert axes[:, 0] == pytest.approx(np.cos(0.3) * first + np.sin(0.3) * np.array([0.0, 1.0, 0.0]))
    assert not any("azimuth" in note for note in scene.drawing(params).notes)
    assert any("azimuth" in note for note in plain_joint().drawing(params).notes)
