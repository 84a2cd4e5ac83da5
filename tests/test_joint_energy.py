"""The joint's books: energy, momentum, Newton's law of the cage, and the symmetry of six like balls."""

from __future__ import annotations

import functools

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import within

import bcfj_jax as bj
from bcfj_jax import ledger
from bcfj_jax.errors import InputError
from bcfj_jax.joint import energy, system
from bcfj_jax.joint.arrowhead import Arrowhead
from bcfj_jax.joint.constants import constants
from bcfj_jax.joint.guides import GUIDES
from bcfj_jax.joint.scales import scales
from bcfj_jax.joint.start import nominal
from bcfj_jax.solvers.rodas import Rodas

SEEDS = st.integers(0, 2**31 - 1)
JOINT = bj.scenes.joint()
# Neither drive nor load: the spring is too weak to notice, and there must be one.
FREED = {"drive_stiffness": 1e-12, "drive_damping": 0.0, "load_torque": 0.0, "joint_angle": 0.0}


def noisy(scene, params, seed, places=3e-5, speeds=0.3):
    """A state in contact: the nominal one at some angle, with noise [m] and [m/s]; angles by each body's radius."""
    draw = np.random.default_rng(seed)
    p, n, b = params, scene.balls, scene.border
    radius = float(p["pitch_radius"])
    turns = [name.endswith("turn") for name, slot in scene.slots.items() if slot for _ in range(slot.stop - slot.start)]
    lever = np.where(turns, 1.0 / radius, 1.0)
    twist = np.ones((n, scene.twist))
    twist[:, 3:] = 1.0 / float(p["ball_radius"])
    size = np.concatenate([np.full(3 * n, places), places * lever, speeds * twist.ravel(), speeds * lever])
    start = nominal(scene, params, jnp.asarray(draw.uniform(0.0, 2 * np.pi)))
    y = np.asarray(start) + size * draw.normal(size=size.size)
    tilt = scene.slots["cage_turn"]
    if tilt is not None:
        axis = y[3 * n : 3 * n + b][tilt]
        axis /= np.linalg.norm(axis)
    if scene.drive == "prescribed":
        y[-1] = float(p["drive_speed"])
    return y


# --- Energy, instant by instant ---

VARIANTS = {
    "default": ({}, {"axial_load": 2e3}),
    "flexible": ({"drive": "flexible", "spin": True}, {}),
    "fixed cage": ({"cage": "fixed", "spin": True, "track": "circular"}, {}),
    "unlike": (
        {"laws": {"seat_ball": "adams_impact", "head_cage": "kelvin_voigt"}, "elastic": "power", "smoothing": False},
        {},
    ),
    "bare": (
        {"contacts": ["cage_ball", "seat_ball", "head_ball"], "head": "fixed", "friction": False, "elastic": "liu"},
        {},
    ),
}
# Lightly optimised: these run a few hundred times, once.
QUICK = {"xla_backend_optimization_level": 0}


@functools.cache
def flows(name):
    """Power, store and the store's rate at (t, y) of a variant, compiled; its scene and parameters."""
    options, values = VARIANTS[name]
    scene = bj.scenes.joint(**options)
    params = scene.parameters(values)
    c = constants(scene, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def read(t, y):
        flow = energy.power(scene, c, t, y)
        drift = system.field(t, y, (scene, c))
        store, rate = jax.jvp(lambda t, y: energy.stored(scene, c, t, y), (t, y), (jnp.ones(()), drift))
        return flow, store, rate

    return read, scene, params


@pytest.mark.parametrize("name", VARIANTS)
@given(seed=SEEDS, t=st.floats(0.0, 0.1))
@settings(max_examples=25)
def test_power_is_the_rate_of_what_is_stored(name, seed, t):
    read, scene, params = flows(name)
    flow, store, rate = read(t, noisy(scene, params, seed))
    # What balls and bodies exchange is much more than what is left over.
    size = sum(abs(x) for x in flow) + sum(abs(x) for x in rate)
    assert float(store.elastic) > 0.0
    assert abs(float(flow.net - rate.total)) < 1e-9 * float(size)
    assert float(flow.edge) == 0.0


@pytest.mark.parametrize("name", VARIANTS)
@given(seed=SEEDS, places=st.floats(3e-5, 1e-4), speeds=st.floats(0.0, 3.0))
@settings(max_examples=25)
def test_contacts_never_create_energy(name, seed, places, speeds):
    read, scene, params = flows(name)
    flow, store, _ = read(0.05, noisy(scene, params, seed, places, speeds))
    assert float(flow.friction) >= 0.0 and float(flow.damping) >= 0.0
    assert scene.contact("seat_ball").friction is not None or float(flow.friction) == 0.0
    assert min(store) >= 0.0 and float(store.elastic) > 0.0


def test_flank_ends_are_accounted_for():
    # A ball far to the side and pressed outwards by more than a service load: one flank's gate is half open.
    read, scene, params = flows("default")
    c = constants(scene, params)
    y = noisy(scene, params, 5)
    across = system.around(scene, c, system.view(scene, c, y)).across
    side = np.asarray(across[0, 0])
    outward = y[:3] - (y[:3] @ side) * side
    outward /= np.linalg.norm(outward)
    seen = []
    for shift in np.linspace(-3e-4, 3e-4, 61):
        moved = y.copy()
        moved[:3] += shift * side + 2e-4 * outward
        flow, _, rate = read(0.05, moved)
        size = sum(abs(x) for x in flow) + sum(abs(x) for x in rate)
        assert abs(float(flow.net - rate.total)) < 1e-9 * float(size)
        seen.append(abs(float(flow.edge)) / float(size))
    assert max(seen) > 1e-3


@pytest.mark.parametrize("exponent", [1.0, 1.1, 1.5, 2.2])
def test_stored_energy_is_that_of_the_power_law(exponent):
    scene = bj.scenes.joint(smoothing=False)
    params = scene.parameters(exponent=exponent)
    c = constants(scene, params)
    y = noisy(scene, params, 3)
    found = system.touches(scene, c, system.view(scene, c, y))
    stiffness = {"seat_cage": 8.518e11, "head_cage": 6.606e11, "cage_ball": 1.3476e10}
    parts = [(3.7e10, found.grooves), (stiffness["cage_ball"], found.windows)]
    exact = sum(k * np.sum(np.maximum(x.penetration, 0.0) ** (exponent + 1.0)) for k, x in parts)
    exact += sum(
        stiffness[name] * max(float(d), 0.0) ** (exponent + 1.0)
        for name, d in zip(scene.pilots, found.pilots.penetration[:, 0], strict=True)
    )
    assert float(energy.stored(scene, c, 0.0, y).elastic) == within(exact / (exponent + 1.0), 1e-10)


def test_stored_energy_of_motion():
    read, scene, params = flows("flexible")
    y = noisy(scene, params, 9)
    p = {k: float(v) for k, v in params.items()}
    state = system.view(scene, constants(scene, params), y)
    ball = 0.5 * p["ball_mass"] * np.sum(state.ball_velocity**2)
    ball += 0.2 * p["ball_mass"] * p["ball_radius"] ** 2 * np.sum(state.ball_spin**2)
    head = 0.5 * p["head_mass"] * np.sum(state.head_velocity**2) + 0.5 * p["head_inertia"] * state.head_spin**2
    cage = 0.5 * p["cage_mass"] * np.sum(state.cage_velocity**2) + 0.5 * p["cage_inertia"] * np.sum(state.cage_spin**2)
    seat = 0.5 * p["seat_inertia"] * state.seat_spin**2
    store = read(0.01, y)[1]
    assert float(store.kinetic) == within(float(ball + head + cage + seat), 1e-12)
    lag = p["drive_speed"] * 0.01 - float(state.seat_turn)
    assert float(store.spring) == within(0.5 * p["drive_stiffness"] * lag**2, 1e-12)


# --- Energy over a run ---


@pytest.mark.slow
def test_books_close_over_a_revolution():
    params = JOINT.parameters()
    found = ledger.balance(JOINT, params, np.linspace(0.0, 0.6, 61))
    # 0.1 % is asked; 11 kJ pass.
    assert found.closure < 2e-5
    assert found.drive[-1] > 1.1e4 and 0.9 < found.load[-1] / found.drive[-1] < 0.98
    assert found.friction[-1] > 100.0 and found.damping[-1] > 0.0
    assert np.all(np.diff(found.friction) > 0.0) and np.all(np.diff(found.damping) >= 0.0)
    assert not found.edge.any() and not found.hold.any() and not found.stored.spring.any()


@pytest.mark.slow
def test_books_close_with_rolling_balls():
    scene = bj.scenes.joint(spin=True)
    found = ledger.balance(scene, scene.parameters(), np.linspace(0.0, 0.1, 11))
    assert found.closure < 2e-5
    assert 0.0 < found.friction[-1] < found.drive[-1]


@pytest.mark.parametrize("what", ["scene", "fidelity", "times", "step"])
def test_books_are_refused(what):
    scenes = {"scene": bj.scenes.impact(), "fidelity": bj.scenes.joint(fidelity="quasistatic")}
    scene = scenes.get(what, JOINT)
    times = [0.1, 0.0] if what == "times" else [0.0, 0.1]
    with pytest.raises(InputError, match="balance" if what in scenes else what):
        ledger.balance(scene, scene.parameters(), times, step=0.0 if what == "step" else 1e-5)


def test_simpson_over_uneven_intervals():
    times = np.array([0.1, 0.3, 0.35, 1.0])
    instants, panels = ledger._instants(times, 0.05)
    assert panels == 14 and np.all(instants[::panels] == times) and np.diff(instants).max() <= 0.05
    assert ledger._work(instants**3, times, panels) == pytest.approx((times**4 - 0.1**4) / 4.0, abs=1e-15)


# --- Newton's law of the cage, and what is transmitted ---


def solved(scene, params, start, times, tolerance):
    """States at the times from any start."""
    c = constants(scene, params)
    control = dfx.PIDController(rtol=0.0, atol=tolerance * scales(scene, params), pcoeff=0.2, icoeff=0.5)
    solution = dfx.diffeqsolve(
        dfx.ODETerm(system.field), Rodas(Arrowhead()), 0.0, times[-1], 1e-7, start, (scene, c),
        saveat=dfx.SaveAt(ts=times), stepsize_controller=control, adjoint=dfx.ForwardMode(), max_steps=100_000,
    )  # fmt: skip
    return solution.ys


_solved = jax.jit(solved, static_argnums=0)


@functools.cache
def run(turn=0.0):
    """Parameters, times and states of the default joint from an angle on, under an axial load."""
    params = JOINT.parameters(axial_load=1e3)
    times = jnp.linspace(0.0, 0.075, 1501)
    return params, times, _solved(JOINT, params, nominal(JOINT, params, jnp.asarray(turn)), times, 1e-3)


def test_cage_is_in_dynamic_equilibrium_at_every_instant():
    params, times, states = run()
    c = constants(JOINT, params)
    residual = jax.vmap(lambda t, y: energy.cage_equilibrium(JOINT, c, y, t))(times, states)
    forces = jax.vmap(lambda y: energy.cage_forces(JOINT, c, y))(states)
    assert set(forces) == {"seat_cage", "head_cage", "cage_ball"}
    peak = max(np.abs(force).max() for force in forces.values())
    assert peak > 10.0 and residual.shape == (times.size, 3)
    assert np.abs(residual).max() < 1e-9 * peak
    # The accelerations are those of the run: the cage's velocity changes by their integral.
    n, slot = JOINT.balls, JOINT.slots["cage"]
    velocity = np.asarray(states[:, 6 * n + JOINT.border :][:, slot])
    impulse = np.trapezoid(sum(np.asarray(force) for force in forces.values()), times, axis=0)
    assert float(params["cage_mass"]) * (velocity[-1] - velocity[0]) == pytest.approx(impulse, abs=1e-3 * peak * 0.075)


def test_a_fixed_cage_has_no_equation():
    _, scene, params = flows("fixed cage")
    with pytest.raises(InputError, match="fixed cage"):
        energy.cage_equilibrium(scene, constants(scene, params), noisy(scene, params, 0), 0.0)


def test_transmission_of_a_constant_velocity_joint():
    params, times, states = run()
    found = energy.transmission(JOINT, params, states, times)
    assert found.angle_error.shape == (times.size,)
    late = np.asarray(times) > 0.06
    assert np.asarray(found.speed_ratio)[late].mean() == pytest.approx(1.0, abs=5e-3)
    # The head lags by clearances and deflections over the pitch radius.
    assert np.all(np.abs(np.asarray(found.angle_error)) < 2e-2)
    assert np.asarray(found.torque_out)[late] == pytest.approx(1800.0)
    assert 0.9 < float(found.efficiency) < 1.0
    after = energy.transmission(JOINT, params, states[late], times[late])
    assert float(found.efficiency) != float(after.efficiency) < 1.0


# --- Momentum ---


@functools.cache
def wrenches(scene):
    """All bodies' contact forces and moments about O, (k, 2, 3), and what ``on_bodies`` makes of the border."""
    params = scene.parameters()
    c = constants(scene, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def read(y):
        state = system.view(scene, c, y)
        found = system.touches(scene, c, state)
        ball, border = system.on_bodies(scene, c, state, found)
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
        return total, border, state, c.axes

    return read, params


@pytest.mark.parametrize("spin", [False, True])
@given(seed=SEEDS)
@settings(max_examples=50)
def test_contact_wrenches_sum_to_nothing(spin, seed):
    scene = bj.scenes.joint(spin=spin)
    read, params = wrenches(scene)
    total, border, state, axes = jax.device_get(read(noisy(scene, params, seed)))
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
    for name, slot in scene.slots.items():
        scale = size[1] if name.endswith("turn") else size[0]
        assert np.abs(border[slot] - expected[name]).max() < 1e-9 * scale, name


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


@pytest.mark.parametrize("spin", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_free_joint_keeps_its_spin_and_loses_energy(spin):
    scene = bj.scenes.joint(drive="flexible", spin=spin)
    params = scene.parameters(**FREED)
    c = constants(scene, params)
    # Dense at the start, where most is lost in impacts.
    share = np.linspace(0.0, 1.0, 4001)
    start, times = noisy(scene, params, 1, 2e-5), jnp.asarray(0.02 * share**2)
    states = _solved(scene, params, start, times, 1e-5)
    momentum, size = jax.lax.map(lambda y: spin_about_z(scene, params, y), states, batch_size=512)
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * size[0]
    flow, store = jax.lax.map(
        lambda at: (energy.power(scene, c, *at), energy.stored(scene, c, *at)), (times, states), batch_size=512
    )
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
    n, b, k = scene.balls, scene.border, scene.twist
    places, at, twists, rates = np.split(np.array(y), [3 * n, 3 * n + b, (3 + k) * n + b])
    for name in ("head_turn", "seat_turn"):
        at[scene.slots[name]] += turn
    return np.concatenate(
        [
            np.roll(x.reshape(n, -1), -1, 0).ravel() if i % 2 == 0 else x
            for i, x in enumerate((places, at, twists, rates))
        ]
    )


@pytest.mark.parametrize("spin", [False, True])
def test_sixfold_symmetry_of_the_field(spin):
    scene = bj.scenes.joint(spin=spin)
    params = scene.parameters()
    c = constants(scene, params)
    field = jax.jit(lambda y: system.field(0.05, y, (scene, c)), compiler_options=QUICK)
    for seed in range(20):
        y = noisy(scene, params, seed)
        expected = renumbered(scene, field(y), 0.0)
        found = np.asarray(field(renumbered(scene, y, np.pi / 3)))
        for part in np.split(np.arange(y.size), np.cumsum([3 * scene.balls, scene.border, scene.twist * scene.balls])):
            assert np.abs(found - expected)[part].max() < 3e-12 * np.abs(expected[part]).max()


def test_sixfold_symmetry_of_a_run():
    params, times, states = run()
    _, _, turned = run(np.pi / 3)
    expected = np.array([renumbered(JOINT, y, np.pi / 3) for y in np.asarray(states)])
    off = np.max(np.abs(np.asarray(turned) - expected) / np.asarray(scales(JOINT, params)), axis=1)
    # Rounding at first. Free play then makes the runs part as runs of two tolerances do: by less than a penetration.
    assert off[times <= 1e-3].max() < 1e-7
    assert np.median(off[(times > 0.02) & (times <= 0.03)]) < 1.0
