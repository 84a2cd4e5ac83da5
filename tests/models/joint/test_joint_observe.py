"""States of contacts, resultants, and what is said of the joint as a whole: hand-made states and closed forms."""

from __future__ import annotations

import csv
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from joints import plain_joint
from oracles import within

import bcfj_jax as bj
from bcfj_jax.analysis.simulation.results import share_of_time
from bcfj_jax.io import outputs
from bcfj_jax.mechanism.model import Reading
from bcfj_jax.mechanism.readings import (
    APART,
    CREEPING,
    SLIDING,
    STATES,
    STUCK,
    TOUCHING,
    UNKNOWN,
    contact_state,
    contact_states,
)
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.energy import Power, Stored
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.observe import motions, observe, resultants
from bcfj_jax.models.joint.summary import Whole, of_the_whole
from bcfj_jax.solve.simulation import Run

JOINT = plain_joint()
# Lightly optimised: these run once or a few times.
QUICK = {"xla_backend_optimization_level": 0}
observed, summed = (jax.jit(f, static_argnums=0, compiler_options=QUICK) for f in (observe, resultants))
PLACES = 3 * 6 + 11
HEAD, CAGE = slice(18, 21), slice(22, 25)


def state(**moved):
    """The zero-clearance joint standing still at turn 0, its cage upright, parts put elsewhere [m] or made to move."""
    params = JOINT.parameters(joint_angle=0.0)
    y = np.array(nominal(JOINT, params, jnp.zeros(())))
    y[PLACES:] = 0.0
    for where, value in moved.values():
        y[where] += value
    return params, y


def read(params, y):
    readings = observed(JOINT, constants(JOINT, params), jnp.asarray(y))
    return readings, contact_states(JOINT, params, readings)


# --- States ---


def test_the_five_states_and_the_unknown():
    normal = np.array([0.0, 5.0, -5.0, 5.0, math.nan, 0.0])
    slip = np.array([9.0, 0.09, 0.1, 3.0, 0.0, math.nan])
    assert contact_state(normal, slip, 0.1).tolist() == [APART, CREEPING, SLIDING, SLIDING, UNKNOWN, UNKNOWN]
    held = np.array([True, True, True, False, True, True])
    assert contact_state(normal, slip, 0.1, held).tolist() == [APART, STUCK, SLIDING, SLIDING, UNKNOWN, UNKNOWN]
    assert contact_state(normal).tolist() == [APART, TOUCHING, TOUCHING, TOUCHING, UNKNOWN, APART]
    assert contact_state(normal).dtype == np.int8
    assert [STATES[code] for code in (APART, TOUCHING, CREEPING, SLIDING, STUCK)] == list(STATES)


# The face is 10 um away; the smoothed onset bears a little before, which is no contact.
@pytest.mark.full
@pytest.mark.parametrize(
    ("height", "wanted"),
    tiers.ci([(4e-6, APART), (9e-6, APART), (1.1e-5, CREEPING), (2e-5, CREEPING)], (1.1e-5, CREEPING)),
)
def test_a_ball_in_its_window(height, wanted):
    params, y = state(up=(2, height))
    readings, states = read(params, y)
    assert readings["cage_ball"].penetration[0] == pytest.approx(height - 1e-5, abs=1e-15)
    assert states["cage_ball"].tolist() == [wanted, *[APART] * 5]


# Sideways in the window: friction_speed is 0.1 m/s.
@pytest.mark.parametrize(("speed", "wanted"), [(0.0, CREEPING), (0.0999, CREEPING), (0.1001, SLIDING), (2.0, SLIDING)])
def test_a_window_slides_from_the_transition_speed_on(speed, wanted):
    params, y = state(up=(2, 5e-5), along=(PLACES, speed))
    readings, states = read(params, y)
    assert readings["cage_ball"].slip[0] == pytest.approx(speed, abs=1e-14)
    assert states["cage_ball"][0] == wanted


def test_a_contacts_own_transition_speed_wins():
    params, y = state(up=(2, 5e-5), along=(PLACES, 0.2))
    params["cage_ball.friction_speed"] = jnp.asarray(0.3)
    assert read(params, y)[1]["cage_ball"][0] == CREEPING


def test_a_damped_rebound_that_bears_no_force_is_apart():
    # 1 + a d' < 0 at d' < -1/0.111 m/s = -9 m/s, deep in the wall.
    params, y = state(up=(2, 5e-5), back=(PLACES + 2, -9.1))
    readings, states = read(params, y)
    assert readings["cage_ball"].penetration[0] > 0.0
    assert states["cage_ball"][0] == APART


@pytest.mark.parametrize(("friction", "fidelity"), [(False, "dynamic"), (True, "quasistatic"), (True, "kinematic")])
def test_without_friction_what_presses_is_touching(friction, fidelity):
    scene = plain_joint(friction=friction, fidelity=fidelity)
    force = np.zeros((2, 6, 3))
    force[0, 0, 0] = -4.0
    single = Reading(force[:, 0], np.zeros(2), np.zeros(2), np.full(2, 7.0))
    readings = {name: Reading(force, np.zeros((2, 6)), np.zeros((2, 6)), np.full((2, 6), 7.0)) for name in
                ("cage_ball", "seat_ball", "head_ball")} | {"seat_cage": single, "head_cage": single}  # fmt: skip
    states = contact_states(scene, scene.parameters(), readings)
    assert list(states) == ["seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball"]
    assert states["cage_ball"][0].tolist() == [TOUCHING, *[APART] * 5] and not states["cage_ball"][1].any()
    assert states["seat_cage"].tolist() == [TOUCHING, APART]


@pytest.mark.slow
def test_a_run_of_one_mass_has_its_states():
    scene = bj.scenes.impact(law="hertz")
    params = scene.parameters(clearance_contact=1e-6)
    run = bj.simulate(scene, params, np.linspace(0.0, 60e-6, 121))
    flight = 1e-6 / 1.5
    state = run.state["contact"]
    assert set(state.tolist()) == {APART, TOUCHING}
    assert np.all(state[run.times < flight] == APART) and np.all(state[(run.times > flight) & (run.times < 3e-5)])
    assert run.trajectory.shape == (121, 2)
    assert run.trajectory[0].tolist() == [0.0, 1.5]


# --- Resultants ---


def test_guides_press_the_cage_back_and_the_head_back():
    # Cage 60 um from the seat's centre along x, of which 50 um are clearance; head 60 um from the cage along y.
    params, y = state(cage=(CAGE, [6e-5, 0, 0]), head=(HEAD, [6e-5, 6e-5, 0]))
    params |= {"smoothing": jnp.zeros(())}
    found = summed(JOINT, constants(JOINT, params), jnp.asarray(y))
    assert found["seat_cage"] == pytest.approx(np.array([-8.518e11 * 1e-5**1.5, 0, 0]), rel=1e-6)
    assert found["head_cage"] == pytest.approx(np.array([0, -6.606e11 * 1e-5**1.5, 0]), rel=1e-6)


def test_windows_sum_over_the_balls_and_carry_friction():
    params, y = state(first=(2, 3e-5), second=(5, 5e-5), along=(PLACES, 10.0))
    params |= {"smoothing": jnp.zeros(())}
    found = summed(JOINT, constants(JOINT, params), jnp.asarray(y))["cage_ball"]
    first, second = (1.3476e10 * depth**1.5 for depth in (2e-5, 4e-5))
    # Brown-McPhee at a hundred times the transition speed: dynamic friction, and a rest of 16 (mu_s - mu_d)/1e6 ...
    assert found[2] == within(-(first + second), 1e-9)
    assert found[0] == within(-0.03 * first, 1e-3) and found[1] == 0.0


@pytest.mark.slow
def test_forces_of_the_tracks_add_up_to_the_torque():
    # Undeflected and alike: N sin(alpha) tangentially at Rp on each ball, which add up to no resultant across the axis;
    # along it the tracks push the balls by T cot(alpha) e/(R_c Rp), physics sheet 5.4.
    scene = plain_joint(friction=False, fidelity="quasistatic", smoothing=False, head="fixed")
    params = scene.parameters(joint_angle=0.0, load_ramp=1e-6, stiffness=1e15, exponent=1.0)
    params = {name: jnp.asarray(1e13) if name.endswith(".stiffness") else x for name, x in params.items()}
    params |= {name: jnp.zeros(()) for name in params if name.startswith("clearance")}
    run = bj.simulate(scene, params, [1.0])
    # At rest, as the equilibrium is: damping has no part in it.
    still = jnp.asarray(run.trajectory[0]).at[3 * scene.balls + scene.coupling :].set(0.0)
    found = summed(scene, constants(scene, params), still)
    radius = math.hypot(0.0355, 0.0045)
    along = 1800.0 / 0.0355 / math.tan(math.radians(40.0)) * 0.0045 / radius
    for name in ("seat_ball", "head_ball"):
        assert abs(found[name][2]) == within(along, 2e-3)
        assert np.abs(found[name][:2]).max() < 1e-3 * along
    assert abs(found["cage_ball"][2]) == within(2.0 * along, 2e-3)


# --- Files ---


def test_share_of_time_weighs_samples_by_their_intervals():
    times = np.array([0.0, 1.0, 3.0, 4.0])
    # Half of 1, half of 1 + 2, half of 2 + 1, half of 1; the last is not known.
    found = share_of_time(times, np.array([APART, CREEPING, SLIDING, UNKNOWN]))
    assert found == pytest.approx(
        {"apart": 0.5 / 3.5, "touching": 0.0, "creeping": 1.5 / 3.5, "sliding": 1.5 / 3.5, "stuck": 0.0}
    )
    assert math.isnan(share_of_time(times, np.full(4, UNKNOWN))["apart"])


def handmade():
    times = np.array([0.0, 1.0])
    force = {"seat_ball": np.zeros((2, 2, 3)), "seat_cage": np.zeros((2, 3))}
    slip = {"seat_ball": np.array([[0.5, 0.0], [0.25, np.nan]]), "seat_cage": np.array([1.0, 2.0])}
    depth = {"seat_ball": np.array([[1e-5, -1e-5], [2e-5, np.nan]]), "seat_cage": np.array([0.0, 1e-6])}
    codes = {"seat_ball": np.array([[SLIDING, APART], [CREEPING, UNKNOWN]]), "seat_cage": np.array([APART, TOUCHING])}
    return Run(times, force, depth, depth, slip, "ok", "", math.nan, {}, codes)


def test_contacts_csv(tmp_path):
    run = handmade()
    outputs.write_columns(tmp_path / "contacts.csv", {"time [s]": run.times, **outputs.contact_columns(run)})
    with (tmp_path / "contacts.csv").open(newline="") as file:
        header, first, second = csv.reader(file)
    assert header[:4] == [
        "time [s]",
        "seat_ball_1.penetration [m]",
        "seat_ball_1.sliding_speed [m/s]",
        "seat_ball_1.state",
    ]
    assert header[7:] == ["seat_cage.penetration [m]", "seat_cage.sliding_speed [m/s]", "seat_cage.state"]
    assert first == ["0.0", "1e-05", "0.5", "sliding", "-1e-05", "0.0", "apart", "0.0", "1.0", "apart"]
    assert second == ["1.0", "2e-05", "0.25", "creeping", "", "", "", "1e-06", "2.0", "touching"]


def test_histories_csv_keeps_the_order_of_its_columns(tmp_path):
    columns = {"seat_cage.x [N]": np.array([1.0, 4.0]), "seat_ball.x [N]": np.array([7.0, 10.0])}
    outputs.write_columns(tmp_path / "resultants.csv", {"time [s]": np.array([0.0, 1.0]), **columns})
    lines = (tmp_path / "resultants.csv").read_text().splitlines()
    assert lines == ["time [s],seat_cage.x [N],seat_ball.x [N]", "0.0,1.0,7.0", "1.0,4.0,10.0"]


def test_the_joint_as_a_whole_in_numbers():
    # 10 W in and 9 W out over 3 s; 0.5 W rubbed away; the store takes 1 J of the 1.5 J left: 0.5 J of 30 J are missing.
    times = np.linspace(0.0, 3.0, 31)
    ones, none = np.ones(31), np.zeros(31)
    power = Power(10 * ones, none, 9 * ones, none, 0.5 * ones, none, none)
    stored = Stored(times / 3.0, none, 2 * ones)
    # What happens in the first third is the start, and no part of the transmission.
    error, ratio = np.where(times < 0.95, 9.0, -0.2), np.where(times < 0.95, 9.0, 1.0)
    forces = {"seat_cage": 3 * np.ones((31, 3)), "head_cage": -4 * np.ones((31, 3)), "seat_ball": 9 * np.ones((31, 3))}
    arrays = jax.tree.map(jnp.asarray, Whole(forces, power, stored, 0.25 * np.ones((31, 3)), error, ratio))
    found = of_the_whole(times, arrays)
    assert found["transmission"]["efficiency"] == within(0.9, 1e-12)
    assert found["transmission"]["angle_error_max"] == found["transmission"]["angle_error_min"] == -0.2
    assert found["transmission"]["speed_ratio_mean"] == within(1.0, 1e-12)
    assert (found["energy"]["drive"], found["energy"]["friction"]) == (within(30.0, 1e-12), within(1.5, 1e-12))
    assert found["energy"]["stored_change"] == within(1.0, 1e-12)
    assert found["energy"]["closure"] == within(0.5 / 30.0, 1e-9)
    assert found["cage_equilibrium"]["largest_residual"] == 0.25
    assert found["cage_equilibrium"]["largest_resultant"] == 4.0
    assert "cage_equilibrium" not in of_the_whole(times, arrays._replace(cage_residual=None))


def test_the_axes_of_a_cage_without_an_azimuth_turn_with_the_seat():
    scene = plain_joint()
    params = scene.parameters()
    c = jax.jit(constants, static_argnums=0)(scene, params)
    look = jax.jit(lambda y: motions(scene, c, 0.0, y)["cage"], compiler_options={"xla_backend_optimization_level": 0})
    first, later = (look(jax.jit(nominal, static_argnums=0)(scene, params, jnp.asarray(turn))) for turn in (0.0, 1.0))
    turned = np.asarray(first.axes).T @ np.asarray(later.axes)
    wanted = np.array([[np.cos(1), -np.sin(1), 0], [np.sin(1), np.cos(1), 0], [0, 0, 1]])
    assert np.abs(turned - wanted).max() < 1e-12
    assert first.angle is None and np.abs(np.asarray(first.axes)[:, 2] - np.asarray(c.bisector)).max() < 1e-14
