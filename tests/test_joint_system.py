"""The joint's equations of motion, their linear algebra, and what options take out of the program."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import ClosedJaxpr, Jaxpr
from oracles import within

from bcfj_jax import scenes, simulation
from bcfj_jax.joint import geometry, system
from bcfj_jax.joint.arrowhead import Arrowhead
from bcfj_jax.joint.constants import constants
from bcfj_jax.joint.scene import CONTACTS
from bcfj_jax.joint.skin import SkinPair
from bcfj_jax.joint.start import nominal
from bcfj_jax.solvers.small import inverse, inverse3, inverse6

UNLIKE = {"head_ball": "kelvin_voigt", "head_cage": "hertz"}
GROOVES = ("seat_ball", "head_ball")
OPTIONS = {
    "all": {},
    "spin": {"spin": True},
    "fixed cage": {"cage": "fixed"},
    "circular, flexible": {"track": "circular", "drive": "flexible"},
    "frictionless, fixed head, no pilots": {
        "friction": False, "head": "fixed", "contacts": ("cage_ball", *GROOVES),
    },
    "unlike": {"laws": UNLIKE, "frictions": {"seat_ball": "coulomb", "seat_cage": False}, "spin": True},
    "grooves": {"contacts": GROOVES, "cage": "fixed", "head": "fixed"},
    "one pilot, no windows, sharp": {"contacts": ("seat_cage", *GROOVES), "balls": 3, "smoothing": False},
}  # fmt: skip
# The smallest joint that runs, so that it compiles quickly; what is tested with it does not depend on its options.
LITTLE = {"friction": False, "cage": "fixed", "contacts": GROOVES, "head": "fixed", "balls": 3}
# What runs once is compiled without care.
QUICK = {"xla_backend_optimization_level": 0, "xla_llvm_disable_expensive_passes": True}
EACH = pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS.keys())


def made(options):
    scene = scenes.joint(**options)
    params = scene.parameters()
    return scene, params, jax.jit(constants, static_argnums=0)(scene, params)


def disturbed(scene, params, seed: int = 0) -> jax.Array:
    """A state some 30 um and 0.3 m/s off the nominal one, turned by 0.3 rad; the cage's axis is a unit vector."""
    rng = np.random.default_rng(seed)
    y = np.array(nominal(scene, params, jnp.asarray(0.3)))
    places = 3 * scene.balls + scene.border
    y += np.r_[3e-5 * rng.normal(size=places), 0.3 * rng.normal(size=y.size - places)]
    if scene.slots["cage_turn"] is not None:
        axis = y[3 * scene.balls :][scene.slots["cage_turn"]]
        axis /= np.linalg.norm(axis)
    return jnp.asarray(y)


# --- linear algebra


@EACH
def test_arrowhead_solves_with_the_exact_jacobian(options):
    scene, params, c = made(options)
    assert isinstance(c.groove_skin, SkinPair) == ("laws" in options)
    y, t, places = disturbed(scene, params), jnp.asarray(0.02), 3 * scene.balls + scene.border
    right = np.random.default_rng(1).normal(size=y.size) * np.where(np.arange(y.size) < places, 1.0, 1e4)
    structure = Arrowhead()

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(y, right, scale, c):
        jacobian = jax.jacfwd(lambda y: system.field(t, y, (scene, c)))(y)
        return structure.solve(structure.factor(t, y, (scene, c), scale), right), jacobian

    for scale in (2e-5, 1e-3):
        got, jacobian = both(y, right, scale, c)
        wanted = np.linalg.solve(np.eye(y.size) / scale - np.asarray(jacobian), right)
        for part in (slice(0, places), slice(places, None)):
            assert abs(np.asarray(got) - wanted)[part].max() <= 1e-9 * abs(wanted[part]).max()


def test_time_derivative_is_that_of_load_and_drive():
    scene, params, c = made({"drive": "flexible", **LITTLE})
    y, t, h = disturbed(scene, params), 0.02, 1e-5
    got = np.asarray(Arrowhead().time_derivative(jnp.asarray(t), y, (scene, c)))
    field = jax.jit(lambda t: system.field(t, y, (scene, c)), compiler_options=QUICK)
    up, down = (np.asarray(field(x)) for x in (t + h, t - h))
    assert np.allclose(got, (up - down) / (2 * h), rtol=1e-4, atol=1e-6 * abs(got).max())
    assert np.flatnonzero(got).tolist() == [scene.states - 2, scene.states - 1]


def test_small_inverses():
    rng = np.random.default_rng(2)
    for size, function in ((3, inverse3), (6, inverse6)):
        many = rng.normal(size=(20, size, size)) + 4.0 * np.eye(size)
        assert np.allclose(jax.jit(function)(many), np.linalg.inv(many), rtol=0, atol=1e-12)
    one = rng.normal(size=(11, 11)) + 8.0 * np.eye(11)
    assert np.allclose(inverse(jnp.asarray(one)), np.linalg.inv(one), rtol=0, atol=1e-12)


# --- start


@EACH
def test_start_is_assembled_and_consistent(options):
    scene = scenes.joint(**options)
    params = scene.parameters(load_torque=0.0)
    turn, h = 0.3, 1e-4

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(params):
        c, now = constants(scene, params), turn / params["drive_speed"]
        before, y, after = (nominal(scene, params, jnp.asarray(turn + s * h)) for s in (-1.0, 0.0, 1.0))
        rates = params["drive_speed"] * (after - before) / (2 * h)
        return y, rates, system.touches(scene, c, system.view(scene, c, y)), system.field(now, y, (scene, c))

    y, rates, found, moving = jax.device_get(look(params))
    assert y.shape == (scene.states,)
    # On the tracks, no gap negative; up to the 1e-12 m that keep spheres and circular sections smooth.
    assert np.allclose(found.grooves.penetration, -1e-5, rtol=0, atol=2e-12 if scene.track == "circular" else 1e-15)
    if found.windows is not None:
        assert np.allclose(found.windows.penetration, -1e-5, rtol=0, atol=1e-15)
    if found.pilots is not None:
        assert np.allclose(found.pilots.penetration, -5e-5, rtol=0, atol=2e-12)
    for touch in (x for x in found if x is not None):
        assert np.all(touch.normal == 0.0) and np.all(touch.force == 0.0)
    # Velocities are those of the nominal motion. Nothing touches and nothing is loaded: nothing is accelerated.
    places = 3 * scene.balls + scene.border
    assert np.allclose(moving[:places], rates[:places], rtol=0, atol=1e-7)
    assert np.all(abs(moving[places:]) <= 1e-6)


def test_start_without_any_clearance():
    scene = scenes.joint()
    params = scene.parameters({f"clearance_{name}": 0.0 for name in CONTACTS})

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(params, turn):
        c, y = constants(scene, params), nominal(scene, params, turn)
        return y, system.touches(scene, c, system.view(scene, c, y))

    for turn in (0.0, 1.0):
        y, found = look(params, turn)
        for touch in found:
            assert np.all(abs(np.asarray(touch.penetration)) <= 2e-12)
        beta, radius = params["joint_angle"], geometry.track_radius(params["pitch_radius"], params["offset"])
        assert np.allclose(y[:3], geometry.ball_centre(turn, beta, radius, params["offset"]), rtol=0, atol=1e-16)


# --- forces on bodies


def test_forces_balance():
    # All contact forces are internal: with the reactions of the seat, their sum and moment vanish.
    scene, params, c = made({"spin": True})
    state = system.view(scene, c, disturbed(scene, params))
    found = system.touches(scene, c, state)
    ball, border = system.on_bodies(scene, c, state, found)
    seat = -np.sum(np.asarray(found.grooves.force[:, 0]), 0) - np.asarray(found.pilots.force[0])
    at = {name: np.asarray(border[slot]) for name, slot in scene.slots.items()}
    total = np.sum(np.asarray(ball[:, :3]), 0) + at["head"] + at["cage"] + seat
    assert np.allclose(total, 0.0, rtol=0, atol=1e-9 * abs(np.asarray(ball)).max())
    # Power of all generalised forces is what contacts take on their relative twists.
    y = disturbed(scene, params)
    rates = np.asarray(y[(3 + scene.twist) * scene.balls + scene.border :])
    twists = np.concatenate([state.ball_velocity, state.ball_spin], -1)
    power = np.sum(np.asarray(ball) * twists) + np.asarray(border) @ rates
    motion = jax.tree.map(lambda x: x[:, :2], system.around(scene, c, state).motion)
    window = system.relative(state, state.cage_place, state.cage_velocity, state.cage_spin)
    pilot, _ = system.guided(scene, c, state)
    pairs = ((found.grooves, motion), (found.windows, window), (found.pilots, pilot))
    taken = sum(jnp.sum(touch.force * move.velocity) + jnp.sum(touch.moment * move.spin) for touch, move in pairs)
    assert power == within(float(taken), 1e-10)


# --- options


def primitives(jaxpr: Jaxpr) -> list[str]:
    """Names of all primitives, inside calls and loops too, once for each number that comes out."""
    names = []
    for equation in jaxpr.eqns:
        names += [equation.primitive.name] * sum(x.aval.size for x in equation.outvars)
        for value in equation.params.values():
            for inner in value if isinstance(value, (tuple, list)) else (value,):
                if isinstance(inner, ClosedJaxpr):
                    names += primitives(inner.jaxpr)
                elif isinstance(inner, Jaxpr):
                    names += primitives(inner)
    return names


@functools.cache
def program(**options) -> tuple[int, tuple[str, ...]]:
    scene = scenes.joint(**options)
    params = scene.parameters()
    y = jax.ShapeDtypeStruct((scene.states,), jnp.float64)
    c = jax.eval_shape(functools.partial(constants, scene), params)
    traced = jax.make_jaxpr(lambda t, y, c: system.field(t, y, (scene, c)))(0.0, y, c)
    return scene.states, tuple(primitives(traced.jaxpr))


SMALLER = [
    ({}, {"friction": False}),
    ({}, {"smoothing": False}),
    ({}, {"cage": "fixed"}),
    ({}, {"head": "fixed"}),
    ({}, {"track": "circular"}),
    ({}, {"law": "hertz"}),
    ({"spin": True}, {}),
    ({"drive": "flexible"}, {}),
    ({}, {"contacts": ("head_cage", "cage_ball", *GROOVES)}),
    ({}, {"contacts": ("cage_ball", *GROOVES)}),
    ({}, {"contacts": ("seat_cage", "head_cage", *GROOVES)}),
]


@pytest.mark.parametrize(("full", "less"), SMALLER, ids=[str(less or f"no {full}") for full, less in SMALLER])
def test_what_an_option_takes_out_is_not_in_the_program(full, less):
    assert len(program(**less)[1]) < len(program(**full)[1])


def test_a_frictionless_joint_has_no_friction_and_a_fixed_cage_no_state():
    assert "tanh" in program()[1]
    assert "tanh" not in program(friction=False)[1]
    assert program(friction=False)[0] == program()[0] == 2 * (18 + 11)
    assert program(cage="fixed")[0] == 2 * (18 + 5)
    assert program(head="fixed")[0] == 2 * (18 + 8)
    assert program(spin=True)[0] == (3 + 6) * 6 + 2 * 11
    assert program(balls=3)[0] == 2 * (9 + 11)
    for name, needed in (("friction_static", "friction"), ("smoothing", "smoothing")):
        assert name in scenes.joint().quantities and name not in scenes.joint(**{needed: False}).quantities
    assert "cage_mass" not in scenes.joint(cage="fixed").quantities
    assert "clearance_seat_cage" not in scenes.joint(cage="fixed").quantities
    assert "contact_angle" not in scenes.joint(track="circular").quantities
    assert "drive_stiffness" in scenes.joint(drive="flexible").quantities


# --- runs

BUDGET = 200
# Impacts multiply a difference by ten within some 200 us: longer runs would compare rounding.
SHORT = np.linspace(0.0, 1e-3, 5)


@functools.cache
def little():
    scene = scenes.joint(**LITTLE)
    return scene, scene.parameters(load_ramp=1e-3, load_torque=200.0)


def simulated(params, times=SHORT):
    return simulation.simulate(little()[0], params, times, max_steps=BUDGET)


def test_failures_say_why_and_when():
    _, params = little()
    good = simulated(params)
    assert good.status == "ok" and good.reason == "" and np.isnan(good.failure_time)
    assert set(good.force) == set(GROOVES) and good.force["seat_ball"].shape == (5, 3, 3)
    assert good.force["seat_ball"].max() > 100.0
    assert good.stats["accepted"] > 0
    # Times and parameters are no part of the program: none of these compiles again.
    long = simulated(params, np.linspace(0.0, 1.0, 5))
    assert long.status == "failed" and f"the step budget of {BUDGET} steps was spent" in long.reason
    assert 0 < long.failure_time < 1.0 and long.stats["accepted"] + long.stats["rejected"] == BUDGET
    assert np.all(np.isnan(long.force["seat_ball"][-1])) and np.all(np.isfinite(long.force["seat_ball"][0]))
    assert long.stats["compile_s"] < 0.1
    for name in ("stiffness", "ball_mass", "load_torque", "joint_angle"):
        bad = simulated({**params, name: jnp.asarray(jnp.nan)})
        assert bad.status == "failed" and bad.reason and bad.failure_time == 0.0 and bad.stats["accepted"] == 0
        for contact in bad.force.values():
            assert np.all(np.isnan(contact[1:]))


def test_a_batch_equals_its_members_and_is_traced_once():
    scene, params = little()
    how = simulation.plan(scene, "balanced", BUDGET)
    traces = []

    def forces(clearance):
        traces.append(clearance)
        return simulation.force_history(scene, {**params, "clearance_seat_ball": clearance}, SHORT, accuracy=how)

    clearances = np.array([5e-6, 1e-5, 4e-5])
    batch = jax.jit(jax.vmap(forces))
    together = jax.device_get(batch(clearances))
    for i, clearance in enumerate(clearances):
        alone = simulated({**params, "clearance_seat_ball": jnp.asarray(clearance)})
        for name, force in alone.force.items():
            assert np.allclose(together[name][i], force, rtol=1e-6, atol=1e-6 * abs(force).max())
    again = batch(clearances[::-1].copy())
    assert np.allclose(again["seat_ball"][::-1], together["seat_ball"], rtol=1e-12)
    assert len(traces) == 1


@functools.cache
def derivatives():
    """Both directions of the derivative of 10 ms of a dynamic joint with friction, compiled; values; weights."""
    scene = scenes.joint(**LITTLE | {"friction": True})
    params = scene.parameters()
    free = ("stiffness", "damping", "friction_static", "clearance_seat_ball", "ball_mass", "load_torque")
    times = np.linspace(0.0, 0.01, 5)

    def forces(x):
        values = {**params, **dict(zip(free, x, strict=True))}
        return simulation.force_history(scene, values, times, accuracy="fast")

    x = jnp.array([float(params[name]) for name in free])
    rng = np.random.default_rng(8)
    weights = {name: rng.normal(size=leaf.shape) for name, leaf in jax.eval_shape(forces, x).items()}

    def both(x, direction, weights):
        _, tangent = jax.jvp(forces, (x,), (direction,))
        return tangent, jax.vjp(forces, x)[1](weights)[0]

    return jax.jit(both), x, weights


@pytest.mark.slow
def test_derivatives_go_both_ways():
    both, x, weights = derivatives()
    x = x.at[-1].set(100.0)
    direction = np.asarray(x) * np.random.default_rng(9).normal(size=x.shape)
    tangent, cotangent = jax.device_get(both(x, direction, weights))
    assert all(np.all(np.isfinite(part)) for part in tangent.values()) and np.all(np.isfinite(cotangent))
    parts = np.concatenate([np.ravel(weights[name] * tangent[name]) for name in tangent])
    assert abs(parts).max() > 1.0
    assert abs(parts.sum() - cotangent @ direction) <= 1e-9 * abs(parts).max()
