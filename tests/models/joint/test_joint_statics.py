"""The joint at rest and without a solve: published and independent statics, derivatives, symmetry."""

from __future__ import annotations

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import QUICK, touches
from oracles import within
from scipy.optimize import root

from bcfj_jax import laws
from bcfj_jax.models.joint import geometry, moments, system
from bcfj_jax.models.joint.constants import constants, laws_of
from bcfj_jax.models.joint.kinematic import ball_loads, kinematic_readings, kinematic_states, penetration
from bcfj_jax.models.joint.model import JointModel
from bcfj_jax.models.joint.quasistatic import GROUND, quasistatic
from bcfj_jax.models.joint.scene import CONTACTS, JointContact
from bcfj_jax.verification import oracles

E, RP = oracles.JOINT_OFFSET, oracles.JOINT_PITCH_RADIUS
# Deflected by 10 degrees, phi = 0, 60, ..., 300.
NORMAL, CAGE = np.array(oracles.JOINT_DEFLECTED_GROOVES), np.array(oracles.JOINT_DEFLECTED_WINDOWS)
# The sheet counts azimuths against the sense in which the head drives back.
MIRROR = -np.arange(6) % 6


def joint(drop=(), smoothing=False, **options):
    contacts = [JointContact(name, laws.make("hertz"), None) for name in CONTACTS if name not in drop]
    return JointModel(tuple(contacts), smoothing=smoothing, **options)


# Head and cage at their centres: a fixed head, and pilots without play a hundred times stiffer than the rest.
LINEAR = joint(head="fixed")
PLAY = joint()
SMALL = joint(drop=("seat_cage", "head_cage", "cage_window_end"), cage="fixed", head="fixed", smoothing=True)


def rigid(angle, deflection, stiffness=1e12, pilots=1e2):
    """Linear contacts, too stiff to change the geometry, without play."""
    values = {f"{name}.stiffness": stiffness * (pilots if name in LINEAR.pilots else 1.0) for name in CONTACTS}
    values |= {f"clearance_{name}": 0.0 for name in CONTACTS} | {"exponent": 1.0, "load_ramp": 1e-6}
    return LINEAR.parameters(
        values, contact_angle=math.radians(angle), joint_angle=math.radians(deflection), offset=E, pitch_radius=RP
    )


@functools.partial(jax.jit, static_argnums=0)
def touching(scene, params, states):
    """Contacts at rest."""
    c = constants(scene, params)
    still = states.at[:, 3 * scene.balls + scene.coupling :].set(0.0)
    return jax.vmap(lambda y: touches(scene, c, system.view(scene, c, y)))(still)


def solved(scene, params, times):
    found = quasistatic(scene, params, jnp.asarray(times))
    assert np.all(found.converged)
    return found.states, touching(scene, params, found.states)


def turn(params):
    return 2.0 * np.pi / float(params["drive_speed"])


@pytest.mark.full
@pytest.mark.parametrize(("angle", "normal", "cage", "total"), oracles.JOINT_UNDEFLECTED)
def test_undeflected_joint_against_the_sheet(angle, normal, cage, total):
    params = rigid(angle, 0.0)
    _, touch = solved(LINEAR, params, [1.0])
    assert touch.grooves.normal.sum(-1) == within(np.full((1, 6, 2), normal), 1e-3)
    assert touch.windows.normal[0, :, 0] == within(np.full(6, cage), 1e-3)
    assert np.all(touch.windows.normal[0, :, 1] == 0.0)
    assert touch.windows.normal.sum() == within(total, 1e-3)
    assert touch.pilots.normal[0, :, 0] == within(np.full(2, total / 2), 1e-3)
    # Force of the races on the balls along the axis; the head's by the balls, seat's by balance.
    # T cot(alpha) e/(Rp Rc) (physics sheet 5.4).
    apart = 1800.0 / math.tan(math.radians(angle)) * E / (RP * math.hypot(RP, E))
    assert abs(touch.grooves.force[0, :, :, 2].sum(0)) == within(np.full(2, apart), 1e-3)
    loads, cages = ball_loads(LINEAR, params, jnp.array([1.0]))
    assert np.asarray(loads) == within(np.full((1, 6), normal), 1e-4)
    assert np.asarray(cages) == within(np.full((1, 6), cage), 2e-4)
    readings = kinematic_readings(LINEAR, params, jnp.array([1.0]))
    assert readings["seat_cage"].force[0, 0] == within(total / 2, 1e-3)


@pytest.mark.full
def test_deflected_joint_against_the_sheet():
    params = rigid(40.0, 10.0)
    _, touch = solved(LINEAR, params, [turn(params)])
    for race in (0, 1):
        assert touch.grooves.normal[0, :, race].sum(-1) == within(NORMAL[MIRROR], 5e-3)
    assert touch.windows.normal[0, :, 0] - touch.windows.normal[0, :, 1] == within(CAGE[MIRROR], 5e-3)


@pytest.mark.full
def test_secondary_couple_of_a_bent_joint():
    # Stiff, without play or friction: constant velocity, and T tan(beta/2) on either shaft.
    params = rigid(40.0, 10.0)
    states, _ = solved(LINEAR, params, [turn(params)])
    still = states[0].at[3 * LINEAR.balls + LINEAR.coupling :].set(0.0)
    c = constants(LINEAR, params)

    @functools.partial(jax.jit, compiler_options=QUICK)
    def look(y):
        return moments.moments(LINEAR, c, jnp.ones(()), y), system.on_parts(LINEAR, c, system.view(LINEAR, c, y))

    found, parts = look(still)
    couple = 1800.0 * math.tan(math.radians(5.0))
    for shaft in ("seat", "head"):
        assert abs(found.secondary[shaft]) == within(couple, 5e-3)
        assert found.bearings[shaft].moment == pytest.approx(np.array([-found.secondary[shaft], 0.0, 0.0]), abs=1.0)
    # The balance of the held joint: couples of both shafts and torques cancel; across its axis the cage is in equilibrium.
    seat, head = (sum(x.moment for x in parts[shaft].values()) for shaft in ("seat", "head"))
    assert seat + head == pytest.approx(np.zeros(3), abs=1e-4)
    assert sum(found.cage.values())[:2] == pytest.approx(np.zeros(2), abs=0.02)
    assert head @ c.axes[1] == within(1800.0, 1e-6)


# At azimuths 0, 60, ...; between them it is 24 % of the least loaded ball at 10 degrees.
@pytest.mark.parametrize(("deflection", "accuracy"), [(6.0, 0.10), (10.0, 0.14)])
def test_first_order_sharing_is_as_good_as_it_says(deflection, accuracy):
    params = rigid(40.0, deflection)
    times = [turn(params)]
    _, touch = solved(LINEAR, params, times)
    normal = touch.grooves.normal[:, :, 0].sum(-1)
    loads, cages = ball_loads(LINEAR, params, jnp.asarray(times))
    assert abs(loads / normal - 1.0).max() < accuracy
    assert np.sum(loads) == within(np.sum(1800.0 / RP / math.sin(math.radians(40.0))), 1e-12)
    # Exact for the loads it is given.
    formula = geometry.deflected_cage_load(
        normal, -geometry_azimuth(params, times), math.radians(40.0), math.radians(deflection), math.hypot(RP, E), E
    )
    assert touch.windows.normal[:, :, 0] - touch.windows.normal[:, :, 1] == within(np.asarray(formula), 2e-3)
    assert cages.shape == loads.shape == (1, 6)


def geometry_azimuth(params, times):
    return float(params["drive_speed"]) * np.asarray(times)[:, None] + np.arange(6) * np.pi / 3


def energy_of(params, time):
    """Energy of the joint with play over (balls, head, turn, cage, tilt), sheet 5.2, 5.3; real or complex."""
    p = {key: float(value) for key, value in params.items()}
    beta, e, rc = p["joint_angle"], p["offset"], math.hypot(p["pitch_radius"], p["offset"])
    seat, bisector = p["drive_speed"] * time, np.array([math.sin(beta / 2), 0.0, math.cos(beta / 2)])
    head_axes = np.array([[math.cos(beta), 0, -math.sin(beta)], [0, 1, 0], [math.sin(beta), 0, math.cos(beta)]])
    tilts = np.array([[math.cos(beta / 2), 0, -math.sin(beta / 2)], [0, 1, 0]])
    h = -np.cos(seat + np.arange(6) * np.pi / 3) * math.tan(beta / 2)
    reach = (e * h + np.sqrt(e**2 * h**2 + (1 + h**2) * (rc**2 - e**2))) / (1 + h**2)
    phi = seat + np.arange(6) * np.pi / 3
    nominal = reach[:, None] * np.stack([np.cos(phi), np.sin(phi), h], 1)
    flank = p["ball_radius"] * (2 * p["conformity"] - 1)
    spring = GROUND * p["load_torque"] / (6 * p["pitch_radius"]) + 1e-3

    def stored(name, depth):
        depth = np.where(depth.real > 0, depth, 0.0)
        return p.get(f"{name}.stiffness", p["stiffness"]) / (p["exponent"] + 1) * np.sum(depth ** (p["exponent"] + 1))

    def length(v):
        return np.sqrt(np.sum(v * v, -1))

    def energy(x):
        balls, head, turned, cage, tilt = x[:18].reshape(6, 3) + nominal, x[18:21], x[21], x[22:25], x[25:27]
        total = spring / 2 * np.sum(x * x) + p["load_torque"] * turned / p["pitch_radius"]
        for name, place, axes, angle, offset, side in (
            ("seat_ball", balls, np.eye(3), seat, e, 1),
            ("head_ball", balls - head, head_axes, seat + turned / p["pitch_radius"], -e, -1),
        ):
            local = place @ axes.T - np.array([0, 0, offset])
            azimuths = angle + np.arange(6) * np.pi / 3
            t = -local[:, 0] * np.sin(azimuths) + local[:, 1] * np.cos(azimuths)
            mid = local[:, 0] * np.cos(azimuths) + local[:, 1] * np.sin(azimuths)
            a = np.sqrt(mid**2 + local[:, 2] ** 2) - rc + side * flank * math.cos(p["contact_angle"])
            for sign in (1, -1):
                y = t + sign * flank * math.sin(p["contact_angle"])
                depth = np.sqrt(y * y + a * a) - flank - p[f"clearance_{name}"]
                total = total + stored(name, np.where(sign * y.real > 0, depth, -1.0))
        axis = bisector + tilt / p["pitch_radius"] @ tilts
        height = (balls - cage) @ axis / length(axis)
        for sign in (1, -1):
            total = total + stored("cage_ball", sign * height - p["clearance_cage_ball"])
        total = total + stored("seat_cage", length(cage) - p["clearance_seat_cage"])
        return total + stored("head_cage", length(head - cage) - p["clearance_head_cage"])

    return nominal, energy


@pytest.mark.slow
def test_joint_with_play_against_an_independent_solve_and_its_sixfold_symmetry():
    params = PLAY.parameters()
    time = 1.023
    states, touch = solved(PLAY, params, [time, time + turn(params) / 6])
    nominal, energy = energy_of(params, time)

    def gradient(x):
        return np.array([energy(x + 1e-30j * d).imag for d in np.eye(27)]) / 1e-30

    y, lever = np.asarray(states[0]), RP
    tilt = np.array([y[25:28] @ way for way in geometry_ways(params)]) / (y[25:28] @ geometry_bisector(params))
    x = np.concatenate([y[:18] - nominal.ravel(), y[18:21], [(y[21] - y[28]) * lever], y[22:25], tilt * lever])
    rng = np.random.default_rng(1)
    found = root(gradient, x + 3e-8 * rng.normal(size=27), tol=1e-15, options={"maxfev": 3000})
    load = 1.0 / (6 * RP) * 1800.0
    assert abs(gradient(found.x)).max() < 1e-7 * load
    assert x == pytest.approx(found.x, abs=1e-10)
    assert abs(gradient(x)).max() < 1e-7 * load
    # The next sixth of a turn: the same places, each ball where the next one was.
    for part in (touch.grooves.normal, touch.windows.normal):
        assert np.asarray(part[1]) == pytest.approx(np.roll(part[0], -1, 0), rel=1e-7, abs=1e-4)
    assert np.asarray(touch.pilots.normal[1]) == pytest.approx(np.asarray(touch.pilots.normal[0]), rel=1e-7)
    # Rates: the balls move with the cage, about the bisector.
    assert states[0, PLAY.moving - 1] == within(float(params["drive_speed"]), 1e-12)


def geometry_bisector(params):
    return np.asarray(geometry.bisector(params["joint_angle"]))


def geometry_ways(params):
    half = float(params["joint_angle"]) / 2
    return np.array([[math.cos(half), 0, -math.sin(half)], [0, 1, 0]])


SOME = ("load_torque", "clearance_seat_ball", "contact_angle", "joint_angle", "stiffness", "drive_speed")


@pytest.mark.slow
def test_derivatives_against_differences_and_batches():
    base = SMALL.parameters()
    times = jnp.array([1.01])

    def places(values):
        params = {**base, **dict(zip(SOME, values, strict=True))}
        return quasistatic(SMALL, params, times).states[0, :20]

    values = np.array([float(base[name]) for name in SOME])
    forward = np.asarray(jax.jit(jax.jacfwd(places))(values))
    steps = values[:, None] * np.array([1e-5, -1e-5, 2e-5, -2e-5])
    batch = (values + steps[..., None] * np.eye(6)[:, None]).reshape(24, 6)
    moved = np.asarray(jax.jit(jax.vmap(places))(batch)).reshape(6, 4, -1)
    near, far = (moved[:, 0] - moved[:, 1]), (moved[:, 2] - moved[:, 3])
    slope = ((8.0 * near - far) / 12.0 / steps[:, :1]).T
    assert np.max(abs(forward - slope) / abs(slope).max(0)) < 1e-5
    some = jnp.array([0, 5, 18])
    reverse = np.asarray(jax.jit(jax.jacrev(lambda v: places(v)[some]))(values))
    assert np.max(abs(reverse - forward[some]) / abs(forward).max(0)) < 1e-9


@pytest.mark.slow
def test_rates_are_derivatives_by_time_and_what_does_not_converge_is_nan_alone():
    step = 1e-6
    found = quasistatic(SMALL, SMALL.parameters(), jnp.array([1.01, 1.01 + step, 1.01 - step, jnp.nan]))
    assert found.converged.tolist() == [True, True, True, False]
    y = np.asarray(found.states)
    assert (y[1] - y[2])[:20] / (2.0 * step) == pytest.approx(y[0, 20:], rel=1e-5, abs=1e-6)
    assert np.all(np.isfinite(y[:3])) and np.all(np.isnan(y[3]))


@pytest.mark.slow
def test_kinematic_states_and_penetration():
    params = PLAY.parameters()
    times = jnp.linspace(0.0, 0.7, 30)
    readings = kinematic_readings(PLAY, params, times)
    assert kinematic_states(PLAY, params, times).shape == (30, PLAY.states)
    assert {name: r.force.shape for name, r in readings.items()} == {
        name: (30, 3) if name in PLAY.pilots else (30, 6, 3) for name in CONTACTS
    }
    for name, reading in readings.items():
        force = abs(np.asarray(reading.force[..., 0]))
        k = float(PLAY.coefficient(params, name, "stiffness"))
        assert np.asarray(reading.penetration) == pytest.approx((force / k) ** (1 / 1.5), rel=1e-9, abs=1e-18)
    laws = laws_of(SMALL, SMALL.parameters(), "seat_ball")
    forces = jnp.array([0.0, 1e-3, 1.0, 1e4])
    depth, slope = jax.jvp(lambda f: penetration(laws, f), (forces,), (jnp.ones(4),))
    assert laws.normal(depth, 0.0 * depth)[1:] == within(np.asarray(forces[1:]), 1e-9)
    assert depth[0] == 0.0 and np.all(np.isfinite(slope))
    assert slope[3] == within(float(depth[3] / 1e4 / 1.5), 1e-9)
    fixed = kinematic_readings(SMALL, SMALL.parameters(), times)
    assert set(fixed) == {"cage_ball", "seat_ball", "head_ball"}
