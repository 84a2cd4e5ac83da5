"""The joint's equations of motion: their linear algebra, the start, forces in balance."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from joints import GROOVES, LITTLE, QUICK, constants, plain_joint, touches
from oracles import within

from bcfj_jax.models.joint import geometry, system
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.scene import USUAL
from bcfj_jax.xla.small import inverse, inverse3, inverse6, product, skew

UNLIKE = {"head_ball": "kelvin_voigt", "head_cage": "hertz"}
OPTIONS = {
    "all": {},
    "spin": {"spin": True},
    "fixed cage": {"cage": "fixed"},
    "circular, flexible": {"track": "circular", "drive": "flexible"},
    "frictionless, fixed head, no pilots": {
        "friction": False, "head": "fixed", "contacts": ("cage_ball", *GROOVES),
    },
    "unlike": {"laws": UNLIKE, "frictions": {"seat_ball": "coulomb", "seat_cage": False}, "spin": True},
    "elastic parts": {"stiffness": "geometry", "elastics": {"seat_cage": "liu_sphere", "head_ball": "liu"}, "spin": True},
    "unequal balls": {"unequal": True},
    "bristles, spin": {"friction": "lugre", "spin": True},
    "bristles, circular": {"friction": "lugre", "track": "circular", "cage": "fixed"},
    "memory": {"friction": "memory"},
    "memory, spin": {"friction": "memory", "spin": True},
    "memory, window ends": {"friction": "memory", "window_ends": True},
    "bristles of some": {"frictions": {"head_ball": "lugre", "head_cage": "lugre", "seat_ball": False}},
    "grooves": {"contacts": GROOVES, "cage": "fixed", "head": "fixed"},
    "one pilot, no windows, sharp": {"contacts": ("seat_cage", *GROOVES), "balls": 3, "smoothing": False},
}  # fmt: skip
# The plain joint and the one with most in it; the rest in make all-tests.
FULL = ("all", "bristles, spin")
EACH = pytest.mark.parametrize(
    "options",
    [
        pytest.param(options, id=name, marks=pytest.mark.full if name in FULL else pytest.mark.slow)
        for name, options in OPTIONS.items()
    ],
)


def made(options):
    scene = plain_joint(**options)
    draw = np.random.default_rng(5)
    params = scene.parameters({name: 1e-5 * draw.normal() for name in scene.each_ball})
    return scene, params, constants(scene, params)


def disturbed(scene, params, seed: int = 0) -> jax.Array:
    """A state some 30 um and 0.3 m/s off the nominal one, turned by 0.3 rad; the cage's axis is a unit vector."""
    rng = np.random.default_rng(seed)
    y = np.array(nominal(scene, params, jnp.asarray(0.3)))
    places = 3 * scene.balls + scene.coupling
    bristles = y.size - scene.moving
    y += np.r_[
        3e-5 * rng.normal(size=places), 0.3 * rng.normal(size=scene.moving - places), 1e-6 * rng.normal(size=bristles)
    ]
    if scene.slices["cage_turn"] is not None:
        axis = y[3 * scene.balls :][scene.slices["cage_turn"]]
        axis /= np.linalg.norm(axis)
    return jnp.asarray(y)


# --- linear algebra


@pytest.mark.parametrize("options", tiers.ci(OPTIONS.values(), OPTIONS["all"]), ids=OPTIONS)
def test_arrowhead_solves_with_the_exact_jacobian(options):
    scene, params, c = made(options)
    # Contacts of unlike laws are computed apart.
    kinds = 1 + (scene.track == "circular" and scene.has("cage_ball"))
    assert (len(c.ball_laws) > kinds) == bool({"laws", "frictions", "elastics"} & set(options))
    y, t, places = disturbed(scene, params), jnp.asarray(0.02), 3 * scene.balls + scene.coupling
    right = np.random.default_rng(1).normal(size=y.size) * np.where(np.arange(y.size) < places, 1.0, 1e4)
    right[scene.moving :] *= 1e-5
    structure, left = Arrowhead(), 1.0 / right

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(y, right, scale, c):
        jacobian = jax.jacfwd(lambda y: system.field(t, y, (scene, c)))(y)
        factors = structure.factor(t, y, (scene, c), scale)
        return structure.solve(factors, right), structure.solve_transposed(factors, left), jacobian

    for scale in (2e-5, 1e-3):
        got, back, jacobian = both(y, right, scale, c)
        terms, matrix = np.stack([left * np.asarray(got), right * np.asarray(back)]), np.eye(y.size) / scale - jacobian
        wanted, other = np.linalg.solve(matrix, right), np.linalg.solve(matrix.T, left)
        # Conditions reach 4e16: with unlike laws NumPy's own two solutions differ by as much.
        rounding = 10.0 * abs(left @ wanted - right @ other)
        assert abs(np.diff(terms.sum(1))[0]) <= 1e-11 * abs(terms).sum() + rounding
        for part in (slice(0, places), slice(places, scene.moving), slice(scene.moving, None)):
            if not wanted[part].size:
                continue
            # Rounding of two Jacobians, amplified: 1.6e-9 with unlike laws, below 1e-9 elsewhere.
            assert abs(np.asarray(got) - wanted)[part].max() <= 2e-9 * abs(wanted[part]).max()


def test_time_derivative_is_that_of_load_and_drive():
    scene, params, c = made({"drive": "flexible", **LITTLE})
    y, t, h = disturbed(scene, params), 0.02, 1e-5
    got = np.asarray(Arrowhead().time_derivative(jnp.asarray(t), y, (scene, c)))
    field = jax.jit(lambda t: system.field(t, y, (scene, c)), compiler_options=QUICK)
    up, down = (np.asarray(field(x)) for x in (t + h, t - h))
    assert np.allclose(got, (up - down) / (2 * h), rtol=1e-4, atol=1e-6 * abs(got).max())
    assert np.flatnonzero(got).tolist() == [scene.states - 2, scene.states - 1]


def test_small_matrices():
    rng = np.random.default_rng(2)
    v, w = rng.normal(size=(2, 20, 3))
    for found, wanted in (
        (product(skew(v), w[..., None])[..., 0], np.cross(v, w)),
        (product(w[:, None], skew(v))[:, 0], np.cross(w, v)),
    ):
        assert np.allclose(found, wanted, rtol=0, atol=1e-14)
    for size, function in ((3, inverse3), (6, inverse6)):
        many = rng.normal(size=(20, size, size)) + 4.0 * np.eye(size)
        assert np.allclose(jax.jit(function)(many), np.linalg.inv(many), rtol=0, atol=1e-12)
    one = rng.normal(size=(11, 11)) + 8.0 * np.eye(11)
    assert np.allclose(inverse(jnp.asarray(one)), np.linalg.inv(one), rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_matrix_has_derivatives_at_rest():
    """No contact slides in the start of a joint that does not turn; the square root of a slip has no derivative there."""
    scene, params, c = made({})
    y = jnp.where(jnp.arange(scene.states) < scene.moving // 2, scene.initial_state(params), 0.0)
    schur = jax.jit(lambda y: Arrowhead().factor(jnp.zeros(()), y, (scene, c), 1e-5).coupling_inverse)
    moving = jnp.arange(scene.states) >= scene.moving // 2
    way = jnp.asarray(np.random.default_rng(4).normal(size=y.size)) * jnp.where(moving, 1e-4, 1e-10)
    slope = jax.jit(lambda y: jax.jvp(schur, (y,), (way,))[1])(y)
    assert np.abs(slope).max() > 0.0
    np.testing.assert_allclose(slope, 0.5 * (schur(y + way) - schur(y - way)), atol=1e-3 * float(np.abs(slope).max()))


# --- start


@EACH
def test_start_is_assembled_and_consistent(options):
    scene = plain_joint(**options)
    # An onset narrower than the balls' play; with the default one, flanks hold a free ball with half a newton each.
    params = scene.parameters({"load_torque": 0.0} | ({"smoothing": 5e-6} if scene.smoothing else {}))
    turn, h = 0.3, 1e-4

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(params):
        c, now = constants(scene, params), turn / params["drive_speed"]
        before, y, after = (nominal(scene, params, jnp.asarray(turn + s * h)) for s in (-1.0, 0.0, 1.0))
        rates = params["drive_speed"] * (after - before) / (2 * h)
        return y, rates, touches(scene, c, system.view(scene, c, y)), system.field(now, y, (scene, c))

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
    places = 3 * scene.balls + scene.coupling
    assert np.allclose(moving[:places], rates[:places], rtol=0, atol=1e-7)
    assert np.all(abs(moving[places : scene.moving]) <= 1e-6)
    if scene.azimuth is not None:
        assert moving[scene.azimuth] == pytest.approx(float(params["drive_speed"]), rel=1e-6)
    # Bristles are straight; a memory takes up the sliding before any contact bears.
    if scene.width == 3:
        assert np.all(abs(moving[scene.moving : scene.azimuth]) <= 1e-6)


def test_start_without_any_clearance():
    scene = plain_joint()
    params = scene.parameters({f"clearance_{name}": 0.0 for name in USUAL})

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(params, turn):
        c, y = constants(scene, params), nominal(scene, params, turn)
        return y, touches(scene, c, system.view(scene, c, y))

    for turn in (0.0, 1.0):
        y, found = look(params, turn)
        for touch in (x for x in found if x is not None):
            assert np.all(abs(np.asarray(touch.penetration)) <= 2e-12)
        beta, radius = params["joint_angle"], geometry.track_radius(params["pitch_radius"], params["offset"])
        assert np.allclose(y[:3], geometry.ball_centre(turn, beta, radius, params["offset"]), rtol=0, atol=1e-16)


# --- forces on bodies


def test_forces_balance():
    # All contact forces are internal: with the reactions of the seat, their sum and moment vanish.
    scene, params, c = made({"spin": True})

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(y):
        state = system.view(scene, c, y)
        pushed, found = system.contact_forces(scene, c, state), touches(scene, c, state)
        motion = jax.tree.map(lambda x: x[:, :2], system.relative_motions(scene, c, state).motion)
        window = system.relative(state, state.cage_place, state.cage_velocity, state.cage_spin)
        pairs = ((found.grooves, motion), (found.windows, window), (found.pilots, system.guided(scene, c, state)[0]))
        taken = sum(jnp.sum(touch.force * move.velocity) + jnp.sum(touch.moment * move.spin) for touch, move in pairs)
        return state, found, system.on_bodies(scene, c, state, pushed), taken

    state, found, (ball, coupling), taken = jax.device_get(look(disturbed(scene, params)))
    seat = -np.sum(np.asarray(found.grooves.force[:, 0]), 0) - np.asarray(found.pilots.force[0])
    at = {name: np.asarray(coupling[piece]) for name, piece in scene.slices.items()}
    total = np.sum(np.asarray(ball[:, :3]), 0) + at["head"] + at["cage"] + seat
    assert np.allclose(total, 0.0, rtol=0, atol=1e-9 * abs(np.asarray(ball)).max())
    # Power of all generalised forces is what contacts take on their relative twists.
    y = disturbed(scene, params)
    rates = np.asarray(y[(3 + scene.twist) * scene.balls + scene.coupling :])
    twists = np.concatenate([state.ball_velocity, state.ball_spin], -1)
    power = np.sum(np.asarray(ball) * twists) + np.asarray(coupling) @ rates
    assert power == within(float(taken), 1e-10)
