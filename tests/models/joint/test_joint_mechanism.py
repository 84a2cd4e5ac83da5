"""The joint's own equations of motion against the same joint made of generic parts."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import GROOVES, QUICK, constants, noisy, plain_joint, view
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from bcfj_jax.core.rotations import attitude
from bcfj_jax.core.vectors import array
from bcfj_jax.mechanism.model import Flows
from bcfj_jax.models.joint.geometry import cage_axes
from bcfj_jax.models.joint.scene import PILOTS, split
from bcfj_jax.models.joint.system import drive_motion
from benchmarks.references.joint_parts import as_mechanism

OPTIONS = {
    "default": {},
    "spin": {"spin": True},
    "circular": {"track": "circular"},
    "fixed cage": {"cage": "fixed"},
    "fixed head": {"head": "fixed"},
    "flexible drive": {"drive": "flexible"},
    "no friction": {"friction": False},
    "bristles": {"friction": "lugre"},
    "memory, spin": {"friction": "memory", "spin": True},
    "frictional lag, spin": {"friction": "frictional_lag", "spin": True},
    "bristles, spin, flexible": {"friction": "lugre", "spin": True, "drive": "flexible"},
    "unlike laws, five balls": {
        "laws": {"head_ball": "kelvin_voigt", "head_cage": "flores"}, "balls": 5, "smoothing": False,
        "frictions": {"seat_ball": "coulomb", "head_cage": "lugre", "seat_cage": False},
    },
    "window ends, bristles, spin": {"window_ends": True, "friction": "lugre", "spin": True},
    "stiffness from geometry": {"stiffness": "geometry", "elastics": {"seat_cage": "liu_sphere", "head_ball": "liu"}},
    "unequal balls": {"unequal": True, "window_ends": True, "spin": True},
    "drive and loads over time": {
        "drive_profile": "step", "load_profile": "linear", "axial_profile": "smooth",
        "fluctuating": ("torque", "axial"), "torque_reversal": True,
    },
    "tables": {
        "drive_profile": "table", "drive_table": ((0.0, 1.0), (4.0, 9.0)), "load_profile": "table",
        "load_table": ((0.0, 2.0), (0.0, 900.0)), "drive": "flexible",
    },
    "no pilots, fixed": {"contacts": ("cage_ball", *GROOVES), "cage": "fixed", "head": "fixed", "spin": True},
}  # fmt: skip
EACH = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.full if name == "default" else pytest.mark.slow) for name in OPTIONS]
)
SEEDS = (1, 2, 3)
# Of the largest: two ways of adding up differ by rounding, some 1e-13 where flanks push against each other.
TOLERANCE = 1e-12


def tilted(joint_angle) -> np.ndarray:
    """Axes of the head's joint, as columns (3, 3)."""
    c, s = np.cos(joint_angle), np.sin(joint_angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def named(joint, params, y) -> dict[tuple[str, str], np.ndarray]:
    """A joint's state by the mechanism's body and coordinate or velocity."""
    state = jax.tree.map(np.asarray, view(joint, constants(joint, params), jnp.asarray(y)))
    turned = tilted(float(params["joint_angle"])).T
    axis = state.cage_axis
    vectors = {
        ("head", "place"): turned @ state.head_place, ("head", "velocity"): turned @ state.head_velocity,
        ("cage", "place"): state.cage_place, ("cage", "velocity"): state.cage_velocity, ("cage", "spin"): state.cage_spin,
        ("ball", "place"): state.ball_place, ("ball", "velocity"): state.ball_velocity, ("ball", "spin"): state.ball_spin,
    }  # fmt: skip
    keys = {"place": ("x", "y", "z"), "velocity": ("vx", "vy", "vz"), "spin": ("wx", "wy", "wz")}
    found = {
        (body, key): vector[..., k]
        for (body, what), vector in vectors.items()
        if vector is not None
        for k, key in enumerate(keys[what])
    }
    found |= {("seat", "angle"): state.seat_turn, ("seat", "speed"): state.seat_spin}
    found |= {("head", "angle"): state.head_turn, ("head", "speed"): state.head_spin}
    # The shortest turn from z to the cage's axis; where the cage has an azimuth the turn to all of its axes.
    quaternion = np.array([1.0 + axis[2], -axis[1], axis[0], 0.0])
    quaternion /= np.linalg.norm(quaternion)
    if state.cage_azimuth is not None:
        axes = cage_axes(jnp.asarray(axis), jnp.asarray(state.cage_azimuth))
        quaternion = Rotation.from_matrix(axes).as_quat(canonical=True, scalar_first=True)
    return found | {("cage", f"q{k}"): x for k, x in enumerate(quaternion)}


def remembered(joint, y) -> list[np.ndarray]:
    """Bristles of a joint's state or its rate in the mechanism's order, as numbers and (balls,)."""
    if not joint.bristles:
        return []
    parts = {name: np.asarray(x) for name, x in split(joint, jnp.asarray(y)).items()}
    found = []
    for contact in joint.contacts:
        if contact.name in parts:
            part = parts[contact.name] if contact.name not in PILOTS else parts[contact.name][None]
            for face in range(part.shape[1]):
                found += [part[:, face, k] for k in range(joint.width)]
    return found


class Pair(NamedTuple):
    """What the mechanism and the joint say of one state; bristles in the mechanism's order."""

    state: dict[tuple[str, str], np.ndarray]
    rates: dict[tuple[str, str], np.ndarray]
    own_rates: dict[tuple[str, str], np.ndarray]
    bristles: list[tuple[np.ndarray, np.ndarray]]
    readings: tuple[dict, dict]
    flows: tuple[Flows, Flows]
    params: dict
    drive_speed: float


def when(joint, params, turn) -> tuple[float, float]:
    """Time at which the drive has turned by an angle [s], a flexible one a little later, and its speed then [rad/s]."""
    c = constants(joint, params)
    motion = jax.jit(lambda t: drive_motion(joint, c, t))
    at = brentq(lambda t: float(motion(t)[0]) - turn, 0.0, 1e3, xtol=1e-15, rtol=1e-15)
    at += 1e-4 if joint.drive == "flexible" else 0.0
    return at, float(motion(at)[1])


@functools.cache
def compared(name: str) -> tuple[Any, list[Pair]]:
    """A joint in disturbed states of disturbed parameters, by its own equations and as a mechanism."""
    joint = plain_joint(**OPTIONS[name])
    mechanism = as_mechanism(joint)
    keys = [(body, key) for body, key, _ in (*mechanism._placed, *mechanism._free)]

    def looking(model):
        def look(t, y, prepared):
            return model.vector_field(t, y, prepared), model.observe(t, y, prepared), model.flows(t, y, prepared)

        return jax.jit(look, compiler_options=QUICK)

    of_mechanism, of_joint, found = looking(mechanism), looking(joint), []
    for seed in SEEDS:
        draw = np.random.default_rng(seed)
        ramp = {"load_ramp": 1.0} if "load_ramp" in joint.quantities else {}
        values = joint.parameters({"axial_load": 500.0} | ramp)
        params = {key: x * draw.uniform(1.0, 1.05) for key, x in values.items()}
        params |= {key: jnp.asarray(1e-5 * draw.normal()) for key in joint.each_ball}
        y = noisy(joint, params, seed, places=5e-5)
        y[joint.moving : joint.azimuth] = 1e-6 * draw.normal(size=y[joint.moving : joint.azimuth].size)
        if joint.azimuth is not None:
            y[joint.azimuth] += float(params["clearance_cage_window_end"] / params["pitch_radius"])
        # A driven seat is where its drive is, and as fast; a flexible drive is ahead of its own.
        seat = joint.slices["seat_turn"]
        assert seat is not None
        turn = 3 * joint.balls + seat.start
        t, speed = when(joint, params, y[turn])
        if joint.drive == "prescribed":
            y[joint.moving - 1] = speed
        state = named(joint, params, y)
        numbers = [state[key] for key in keys] + remembered(joint, y)
        flat = jnp.concatenate([jnp.atleast_1d(x) for x in numbers])
        given = {key: x for key, x in params.items() if key in mechanism.quantities}
        rates, readings, flows = of_mechanism(t, flat, given)
        own_rates, own_readings, own_flows = of_joint(t, jnp.asarray(y), joint.prepare(params))
        ends = np.cumsum([np.size(x) for x in numbers])[:-1]
        parts = [part.reshape(np.shape(x)) for part, x in zip(np.split(np.asarray(rates), ends), numbers, strict=True)]
        bristles = list(zip(parts[len(keys) :], remembered(joint, own_rates), strict=True))
        # Accelerations as velocities, of a state whose places are those that were.
        places = 3 * joint.balls + joint.coupling
        own = named(joint, params, np.r_[y[:places], np.asarray(own_rates)[places:]])
        own = {key: x for key, x in own.items() if key in keys}
        found.append(
            Pair(
                state,
                dict(zip(keys, parts, strict=False)),
                own,
                bristles,
                (readings, own_readings),
                (flows, own_flows),
                params,
                speed,
            )
        )
    return joint, found


def apart(pairs) -> float:
    """Largest difference of pairs over the largest number in them."""
    pairs = [(np.asarray(a), np.asarray(b)) for a, b in pairs]
    return max(np.max(np.abs(a - b)) for a, b in pairs) / max(np.max(np.abs(b)) for _, b in pairs)


def turned_by_balls(pair, shaft) -> float:
    """Acceleration of a shaft by its balls' forces, were they all in one sense [rad/s^2]."""
    normal = np.abs(pair.readings[1][f"{shaft}_ball"].force[..., 0]).sum()
    return float(normal * pair.params["pitch_radius"] / pair.params[f"{shaft}_inertia"])


@EACH
def test_bodies_and_bristles_move_as_in_the_joints_own_equations(name):
    joint, found = compared(name)
    for pair in found:
        for body in {body for body, _ in pair.own_rates}:
            for keys in (("vx", "vy", "vz"), ("wx", "wy", "wz")):
                own = [(pair.rates[body, key], pair.own_rates[body, key]) for key in keys if (body, key) in pair.rates]
                assert not own or apart(own) < TOLERANCE, (body, keys)
            if (body, "speed") in pair.rates:
                found_speed, own_speed = pair.rates[body, "speed"], pair.own_rates[body, "speed"]
                # A tenth of what is allowed of the largest where the sum of flanks that push against each other counts.
                size = max(abs(own_speed), turned_by_balls(pair, body))
                assert abs(found_speed - own_speed) < 0.1 * TOLERANCE * size, body
        assert bool(pair.bristles) == bool(joint.bristles)
        assert not pair.bristles or apart(pair.bristles) < TOLERANCE


@pytest.mark.full
def test_the_cages_attitude_turns_with_its_spin():
    _, found = compared("default")
    for pair in found:
        at, rate = ([jnp.asarray(x["cage", f"q{k}"]) for k in range(4)] for x in (pair.state, pair.rates))
        axis, moving = jax.jvp(lambda q: array(attitude(q)[2]), (at,), (rate,))
        spin = np.array([pair.state["cage", key] for key in ("wx", "wy", "wz")])
        np.testing.assert_allclose(moving, np.cross(spin, axis), rtol=0, atol=1e-14 * float(np.linalg.norm(spin)))


@EACH
def test_instruments_read_the_same(name):
    _, found = compared(name)
    pressed = set()
    for pair in found:
        left, right = pair.readings
        assert list(left) == list(right)
        for part in ("force", "penetration", "rate", "slip", "world"):
            both = [(getattr(left[contact], part), getattr(right[contact], part)) for contact in right]
            # The mechanism does not read how a contact without friction slides.
            both = [x for x in both if x[0] is not None]
            assert not both or apart(both) < TOLERANCE, part
        for contact in right:
            assert np.array_equal(left[contact].force[..., 0] != 0, right[contact].force[..., 0] != 0)
            pressed |= {contact} if np.any(right[contact].force[..., 0]) else set()
    assert pressed == set(found[0].readings[1]), "a contact that never touches is not compared"


@EACH
def test_energy_flows_agree(name):
    joint, found = compared(name)
    for pair in found:
        left, right = pair.flows
        speed, drive, lost = pair.state["seat", "speed"], right.given["drive"], right.taken["damping"]
        if joint.drive == "flexible":
            # The mechanism's load is what its spring and damper do on the seat; the joint's begins at the drive.
            lag = pair.drive_speed - speed
            drive, lost = drive * speed / pair.drive_speed, lost - pair.params["drive_damping"] * lag**2
        powers = {
            "drive": (left.given["drive" if joint.drive == "flexible" else "seat drive"], drive),
            "hold": (left.given.get("cage drive", 0.0), right.given["hold"]),
            "load": (-left.given["load_torque"], right.taken["load"]),
            "axial": (-left.given["axial_load"], right.taken["axial"]),
            "friction": (left.taken["friction"], right.taken["friction"]),
            "damping": (left.taken["damping"], lost),
            "kinetic": (left.stored["kinetic"], right.stored["kinetic"]),
            "elastic": (left.stored["elastic"], right.stored["elastic"]),
        }
        for what, (a, b) in powers.items():
            np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-300, err_msg=what)


@EACH
def test_parameters_and_start_are_the_joints(name):
    joint = plain_joint(**OPTIONS[name])
    mechanism = as_mechanism(joint)
    unread = set(joint.quantities) - set(mechanism.quantities)
    own = {name for name in joint.quantities if name.endswith(".effective_modulus")}
    assert unread <= {"seat_radius", "head_radius"} | own and set(mechanism.quantities) <= set(joint.quantities)
    assert dict(mechanism.defaults) == {key: x for key, x in joint.defaults if key not in unread}
    assert mechanism == as_mechanism(joint) and hash(mechanism) == hash(as_mechanism(joint))
    params = mechanism.parameters(joint_angle=0.3)
    mechanism.check(params)
    values = joint.parameters(joint_angle=0.3)
    state = named(joint, values, joint.initial_state(values))
    expected = [np.ravel(state[body, key]) for body, key, _ in (*mechanism._placed, *mechanism._free)]
    found = np.asarray(mechanism.initial_state(params))
    expected = np.pad(np.concatenate(expected), (0, found.size - sum(x.size for x in expected)))
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-16)
