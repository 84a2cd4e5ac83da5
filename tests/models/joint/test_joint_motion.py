"""The joint in motion: Newton's law of the cage, momentum, what is transmitted, the symmetry of six like balls."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from joints import JOINT, QUICK, SEEDS, constants, noisy, plain_joint, solved, touches
from oracles import within

from bcfj_jax.models.joint import energy, system
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.quasistatic import quasistatic
from bcfj_jax.models.joint.scales import scales
from bcfj_jax.models.joint.scene import GUIDES

# Neither drive nor load: the spring is too weak to notice, and there must be one.
FREED = {"drive_stiffness": 1e-12, "drive_damping": 0.0, "load_torque": 0.0, "joint_angle": 0.0}


# --- Newton's law of the cage, and what is transmitted ---


@functools.cache
def run(turn=0.0):
    """Parameters, times and states of the default joint from an angle on, under an axial load."""
    params = JOINT.parameters(axial_load=1e3)
    times = jnp.linspace(0.0, 0.075, 1501)
    return params, times, solved(JOINT, params, nominal(JOINT, params, jnp.asarray(turn)), times, 1e-3)


@pytest.mark.slow
def test_cage_is_in_dynamic_equilibrium_at_every_instant():
    params, times, states = run()
    c = constants(JOINT, params)
    look = jax.vmap(lambda t, y: (energy.cage_equilibrium(JOINT, c, y, t), energy.cage_forces(JOINT, c, y)))
    residual, forces = jax.device_get(jax.jit(look, compiler_options=QUICK)(times, states))
    assert set(forces) == {"seat_cage", "head_cage", "cage_ball"}
    peak = max(np.abs(force).max() for force in forces.values())
    assert peak > 10.0 and residual.shape == (times.size, 3)
    assert np.abs(residual).max() < 1e-9 * peak
    # The accelerations are those of the run: the cage's velocity changes by their integral.
    n, piece = JOINT.balls, JOINT.slices["cage"]
    velocity = np.asarray(states[:, 6 * n + JOINT.coupling :][:, piece])
    impulse = np.trapezoid(sum(np.asarray(force) for force in forces.values()), times, axis=0)
    assert float(params["cage_mass"]) * (velocity[-1] - velocity[0]) == pytest.approx(impulse, abs=1e-3 * peak * 0.075)


def transmission(params, states, times):
    """Angle error [rad], speed ratio and torque out [N m] (T,), and energy out over energy in."""
    c = constants(JOINT, params)

    def one(t, y):
        state, flow = system.view(JOINT, c, y), energy.power(JOINT, c, t, y)
        error, ratio = state.head_turn - state.seat_turn, state.head_spin / state.seat_spin
        return error, ratio, system.loads(JOINT, c, t, state)[0], flow.drive + flow.hold, flow.load

    error, ratio, outward, given, passed = jax.vmap(one)(times, states)
    return error, ratio, outward, jnp.trapezoid(passed, times) / jnp.trapezoid(given, times)


@pytest.mark.slow
def test_transmission_of_a_constant_velocity_joint():
    params, times, states = run()
    transmitted = jax.jit(transmission, compiler_options=QUICK)
    angle_error, speed_ratio, torque_out, efficiency = transmitted(params, states, times)
    assert angle_error.shape == (times.size,)
    late = np.asarray(times) > 0.06
    # The head lags by clearances and deflections: as far as statics says, and it follows how that changes.
    scene = plain_joint(fidelity="quasistatic")
    still = quasistatic(scene, params, times[late][::60])
    place = np.asarray(still.states)[:, 3 * scene.balls :]
    lag = place[:, scene.slices["head_turn"]] - place[:, scene.slices["seat_turn"]]
    assert np.all(still.converged) and np.all(lag < -5e-3)
    assert np.asarray(angle_error)[late][::60] == pytest.approx(np.ravel(lag), rel=0.02)
    follows = 1.0 + np.ptp(lag) / (float(params["drive_speed"]) * np.ptp(times[late][::60]))
    assert np.asarray(speed_ratio)[late].mean() == pytest.approx(follows, abs=1e-3)
    assert np.asarray(torque_out)[late] == pytest.approx(1800.0)
    assert 0.9 < float(efficiency) < 1.0
    after = transmitted(params, states[late], times[late])[3]
    assert float(efficiency) != float(after) < 1.0


# --- Momentum ---


@functools.cache
def wrenches(scene):
    """All bodies' contact forces and moments about O, (k, 2, 3), and what ``on_bodies`` makes of the coupling."""
    params = scene.parameters()
    c = constants(scene, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def read(y):
        state = system.view(scene, c, y)
        found = touches(scene, c, state)
        ball, coupling = system.on_bodies(scene, c, state, system.contact_forces(scene, c, state))
        total = {body: jnp.zeros((2, 3)) for body in ("seat", "head", "cage")}

        def add(body, force, point, moment=0.0):
            total[body] = total[body] + jnp.stack([force, jnp.cross(point, force) + moment])

        rings, push = found.grooves, found.windows
        for j, body in enumerate(("seat", "head")):
            moment = 0.0 if rings.moment is None else jnp.sum(rings.moment[:, j], 0)
            moment = moment + jnp.sum(jnp.cross(state.ball_place, rings.force[:, j]), 0)
            add(body, -jnp.sum(rings.force[:, j], 0), jnp.zeros(3), -moment)
        moment = 0.0 if push.moment is None else jnp.sum(push.moment, 0)
        moment = moment + jnp.sum(jnp.cross(state.ball_place, push.force), 0)
        add("cage", -jnp.sum(push.force, 0), jnp.zeros(3), -moment)
        places = {"seat": jnp.zeros(3), "cage": state.cage_place, "head": state.head_place}
        for k, name in enumerate(scene.pilots):
            outer, inner = GUIDES[name]
            force, moment = found.pilots.force[k], found.pilots.moment[k]
            # Where the spheres touch: on the hollow one, towards the inner one's centre.
            way = places[inner] - places[outer]
            point = places[outer] + c.pilot_hollow[k] * way / jnp.sqrt(way @ way)
            add(inner, force, point)
            add(outer, -force, point)
            lever = jnp.cross(point - places[inner], force)
            total[f"{name} moment"] = jnp.stack([jnp.zeros(3), lever - moment])
        balls = jnp.sum(ball[:, :3], 0)
        turns = jnp.sum(jnp.cross(state.ball_place, ball[:, :3]), 0)
        if scene.spin:
            turns = turns + jnp.sum(ball[:, 3:], 0)
        total["balls"] = jnp.stack([balls, turns])
        return total, coupling, state, c.axes

    return read, params


@pytest.mark.parametrize("spin", [False, True])
@given(seed=SEEDS)
@settings(max_examples=50)
def test_contact_wrenches_sum_to_nothing(spin, seed):
    scene = plain_joint(spin=spin)
    read, params = wrenches(scene)
    total, coupling, state, axes = jax.device_get(read(noisy(scene, params, seed)))
    for name in scene.pilots:
        assert np.abs(total.pop(f"{name} moment")[1]).max() < 1e-9 * np.abs(total["cage"][1]).max()
    size = np.max([np.abs(x) for x in total.values()], axis=(0, 2))
    assert size[0] > 100.0
    # Balls from the equations of motion, the others from the contacts ...
    assert np.abs(sum(total.values())).max(-1) / size == pytest.approx(0.0, abs=1e-9)
    # ... which are the equations of motion's: forces, and moments about each body's own centre.
    centres = {"head": state.head_place, "cage": state.cage_place, "seat": np.zeros(3)}
    own = {body: total[body][1] - np.cross(place, total[body][0]) for body, place in centres.items()}
    expected = {
        "head": total["head"][0],
        "head_turn": own["head"] @ axes[1],
        "cage": total["cage"][0],
        "cage_turn": own["cage"],
        "seat_turn": own["seat"] @ axes[0],
    }
    for name, piece in scene.slices.items():
        scale = size[1] if name.endswith("turn") else size[0]
        assert np.abs(coupling[piece] - expected[name]).max() < 1e-9 * scale, name


def spin_about_z(scene, params, y):
    """Angular momentum of all bodies about the seat's axis, and the sum of its parts' sizes [N m s]."""
    p, state = params, system.view(scene, constants(scene, params), y)

    def orbit(mass, place, velocity):
        return mass * jnp.cross(place, velocity)[..., 2]

    ball = orbit(p["ball_mass"], state.ball_place, state.ball_velocity)
    if scene.spin:
        ball = ball + 0.4 * p["ball_mass"] * p["ball_radius"] ** 2 * state.ball_spin[:, 2]
    parts = [
        *ball,
        orbit(p["head_mass"], state.head_place, state.head_velocity),
        p["head_inertia"] * state.head_spin,
        orbit(p["cage_mass"], state.cage_place, state.cage_velocity),
        p["cage_inertia"] * state.cage_spin[2],
        p["seat_inertia"] * state.seat_spin,
    ]
    return sum(parts), sum(abs(x) for x in parts)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"spin": True}, {"spin": True, "bands": True, "window_ends": True}], ids=str)
def test_a_free_joint_keeps_its_spin_and_loses_energy(options):
    scene = plain_joint(drive="flexible", **options)
    params = scene.parameters(**FREED)
    c = constants(scene, params)
    # Dense at the start, where most is lost in impacts.
    share = np.linspace(0.0, 1.0, 4001)
    start, times = noisy(scene, params, 1, 2e-5), jnp.asarray(0.02 * share**2)
    states = solved(scene, params, start, times, 1e-5)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(times, states):
        def one(at):
            t, y = at
            return spin_about_z(scene, params, y), energy.power(scene, c, t, y), energy.stored(scene, c, t, y)

        return jax.lax.map(one, (times, states), batch_size=512)

    (momentum, size), flow, store = jax.device_get(look(times, states))
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * size[0]
    total = np.asarray(store.total)
    # The states between steps are interpolated.
    assert np.diff(total).max() < 1e-8 * total[0]
    assert total[-1] < 0.5 * total[0]
    # Where it went: the stored energy lost is what friction and damping took.
    lost = np.asarray(flow.lost) * 0.04 * share
    taken = (lost[0] + lost[-1] + 4.0 * lost[1::2].sum() + 2.0 * lost[2:-1:2].sum()) * share[1] / 3.0
    assert total[0] - total[-1] == within(taken, 1e-3)
    assert np.abs(flow.drive).max() < 1e-9 and not np.asarray(flow.load).any()


# --- Symmetry: a sixth of a turn renumbers the balls ---


def renumbered(scene, y, turn):
    """The state with each ball called by the number before, all tracks turned on by as much."""
    n, b, k = scene.balls, scene.coupling, scene.twist
    places, at, twists, rates = np.split(np.array(y), [3 * n, 3 * n + b, (3 + k) * n + b])
    for name in ("head_turn", "seat_turn"):
        at[scene.slices[name]] += turn
    return np.concatenate(
        [
            np.roll(x.reshape(n, -1), -1, 0).ravel() if i % 2 == 0 else x
            for i, x in enumerate((places, at, twists, rates))
        ]
    )


@pytest.mark.parametrize("spin", [False, True])
def test_sixfold_symmetry_of_the_field(spin):
    scene = plain_joint(spin=spin)
    params = scene.parameters()
    c = constants(scene, params)
    field = jax.jit(lambda y: system.field(0.05, y, (scene, c)), compiler_options=QUICK)
    for seed in range(20):
        y = noisy(scene, params, seed)
        expected = renumbered(scene, field(y), 0.0)
        found = np.asarray(field(renumbered(scene, y, np.pi / 3)))
        for part in np.split(
            np.arange(y.size), np.cumsum([3 * scene.balls, scene.coupling, scene.twist * scene.balls])
        ):
            assert np.abs(found - expected)[part].max() < 3e-12 * np.abs(expected[part]).max()


@pytest.mark.slow
def test_sixfold_symmetry_of_a_run():
    params, times, states = run()
    _, _, turned = run(np.pi / 3)
    expected = np.array([renumbered(JOINT, y, np.pi / 3) for y in np.asarray(states)])
    off = np.max(np.abs(np.asarray(turned) - expected) / np.asarray(scales(JOINT, params)), axis=1)
    # Rounding at first; then a step taken here and rejected there.
    assert off[times <= 2e-4].max() < 2e-9 and off.max() < 1e-3
