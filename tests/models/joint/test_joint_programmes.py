"""Drive and loads of the joint over time: shapes, tables, fluctuation, reversal, a bit that sticks; start from rest."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import QUICK, constants, noisy, plain_joint
from oracles import within

import bcfj_jax as bj
from bcfj_jax.analysis import energy_balance
from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism import programmes as generic
from bcfj_jax.models.joint import programmes, system
from bcfj_jax.models.joint.arrowhead import Arrowhead
from benchmarks.references.joint_parts import as_mechanism

T_TABLE, W_TABLE = [[0.0, 0.02, 0.1], [0.0, -900.0, 300.0]], [[0.0, 0.01, 0.03], [2.0, 2.0, 10.0]]
OPTIONS = {
    "all": {
        "drive_profile": "step", "load_profile": "linear", "axial_profile": "smooth",
        "fluctuating": ("torque", "axial"), "torque_reversal": True,
    },
    "stick-slip": {"stick_slip": True, "drive": "flexible", "drive_profile": "linear"},
    "tables": {"drive_profile": "table", "drive_table": W_TABLE, "load_profile": "table", "load_table": T_TABLE},
}  # fmt: skip
EACH = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.full if name == "all" else pytest.mark.slow) for name in OPTIONS]
)
VALUES = {"all": {"axial_load": 2e4, "drive_ramp": 0.05, "reversal_time": 0.012, "reversal_ramp": 0.02}}


@functools.cache
def made(name):
    scene = plain_joint(**OPTIONS[name])
    return scene, scene.parameters(VALUES.get(name))


@pytest.mark.parametrize("shape", generic.SHAPES)
def test_a_drive_turns_by_the_integral_of_its_speed(shape):
    drive = bj.Drive("ramp", speed=10.0, over=0.2, first=2.0, shape=shape)
    p = {"seat.drive_speed": 10.0, "seat.drive_ramp": 0.2, "seat.drive_first": 2.0}
    t = jnp.linspace(0.0, 0.3, 2001)
    turn, speed, rate = jax.device_get(jax.vmap(lambda t: drive.motion(t, "seat", p))(t))
    # 2 + 8 s: half of the rise on average until its end, from then on 10 rad/s.
    assert turn[-1] == within(0.2 * 6.0 + 0.1 * 10.0, 1e-12) and speed[0] == 2.0 and speed[-1] == 10.0
    assert np.trapezoid(speed, t) == within(turn[-1], 1e-6)
    assert np.trapezoid(rate, t) == within(8.0, 1e-3) and rate[-1] == 0.0


def test_a_table_of_speeds_is_integrated_exactly():
    drive = bj.Drive("speeds", table=((0.1, 0.2, 0.4), (1.0, 3.0, -1.0)))
    turns = [float(drive.position(jnp.asarray(t), "seat", {})) for t in (0.0, 0.1, 0.2, 0.4, 0.5)]
    assert turns == within([0.0, 0.1, 0.3, 0.5, 0.4], 1e-13)
    assert float(drive.motion(jnp.asarray(0.15), "seat", {})[2]) == within(20.0, 1e-13)


def test_loads_over_time_are_what_their_formulas_say():
    scene, p = made("all")
    p = {name: float(x) for name, x in p.items()}
    t = jnp.asarray([0.0, 0.005, 0.011, 0.05, 0.2])
    torque = jax.vmap(lambda t: programmes.torque_at(scene.programmes, t, jnp.zeros(()), p))(t)
    back = 1.0 - 2.0 * np.clip((np.asarray(t) - 0.012) / 0.02, 0.0, 1.0)
    rise = np.clip(np.asarray(t) / 0.05, 0.0, 1.0)
    assert np.asarray(torque) == within(rise * back * (1800.0 + 360.0 * np.sin(2 * np.pi * 5.0 * np.asarray(t))), 1e-12)
    axial = float(programmes.axial_at(scene.programmes, jnp.asarray(0.25), p))
    assert axial == within(2e4 + 4e3 * np.sin(2 * np.pi * 5.0 * 0.25), 1e-12)
    assert scene.programmes.lasting and not scene.recurs(p)
    # The bit: 1 where it is fast, the ratio where it sticks, nothing at rest, against the motion where it turns back.
    share = [float(programmes.falling(jnp.asarray(w), made("stick-slip")[1])) for w in (1e4, 1.0, 0.0, -1.0)]
    assert share == within([1.0, 1.5, 0.0, -1.5], 1e-6)


def test_a_table_gives_its_own_values_and_is_scaled_by_its_parameter():
    scene, p = made("tables")
    assert dict(scene.defaults)["load_torque"] == -900.0 and dict(scene.defaults)["drive_speed"] == 10.0
    assert "load_ramp" not in scene.quantities and float(scene.programmes.start_speed(p)) == 2.0
    at = jnp.asarray(0.01)
    for factor in (1.0, 2.0):
        torque = programmes.torque_at(scene.programmes, at, at, p | {"load_torque": -900.0 * factor})
        assert float(torque) == within(-450.0 * factor, 1e-13)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"load_profile": "smoth"}, r"load_profile.*smooth"),
        ({"load_table": T_TABLE}, r"load_table.*load_profile = 'table'"),
        ({"axial_profile": "table"}, "axial_table: is missing"),
        ({"drive_profile": "table", "drive_table": [[0.0, 0.0], [1.0, 2.0]]}, "times do not increase"),
        ({"fluctuating": ["torqe"]}, r"fluctuating.*torque"),
        ({"load_profile": "table", "load_table": T_TABLE, "torque_reversal": True}, "put that into the table"),
        ({"drive_profile": "linear", "fidelity": "quasistatic"}, "fidelity = 'dynamic'"),
        ({"drive_profile": "linear", "cage": "fixed"}, "cage = 'free'"),
    ],
)
def test_programmes_that_do_not_go_together_are_refused(options, what):
    with pytest.raises(InputError, match=what):
        plain_joint(**options)


def test_a_stick_slip_torque_is_no_generic_load():
    with pytest.raises(InputError, match="as_mechanism"):
        as_mechanism(made("stick-slip")[0])


@pytest.mark.slow
@EACH
def test_the_arrowhead_has_the_derivatives_of_programmes(name):
    scene, params = made(name)
    y, t = jnp.asarray(noisy(scene, params, 3, places=8e-5)), jnp.asarray(0.013)
    places = 3 * scene.balls + scene.coupling
    right = jnp.asarray(np.cos(1.0 + np.arange(y.size)) * np.where(np.arange(y.size) < places, 1.0, 1e4))

    @functools.partial(jax.jit, compiler_options=QUICK)
    def both(y, t, c):
        structure, args = Arrowhead(), (scene, c)
        by_state, by_time = jax.jacfwd(lambda y, t: system.field(t, y, args), (0, 1))(y, t)
        solved = structure.solve(structure.factor(t, y, args, 1e-3), right)
        return solved, by_state, by_time, structure.time_derivative(t, y, args)

    got, by_state, by_time, drift = jax.device_get(both(y, t, constants(scene, params)))
    wanted = np.linalg.solve(np.eye(y.size) / 1e-3 - by_state, right)
    for part in (slice(places), slice(places, None)):
        assert np.abs(got - wanted)[part].max() <= 2e-9 * np.abs(wanted[part]).max()
    assert np.abs(by_time).max() > 0.0 and np.abs(drift - by_time).max() <= 1e-12 * np.abs(by_time).max()


@functools.cache
def run(name):
    """A run of 40 ms with what seat and head do."""
    scene, params = made(name)
    reads = ["seat.angle", "seat.spin.z"]
    return bj.simulate(scene, params, np.linspace(0.0, 0.04, 401), read=reads)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["all", "tables"])
def test_a_prescribed_seat_turns_as_it_is_told(name):
    scene, params = made(name)
    found = run(name)
    drive = jax.vmap(lambda t: jnp.stack(programmes.drive_at(scene.programmes, t, params)))(jnp.asarray(found.times))
    turn, speed, _ = np.asarray(drive).T
    assert found.status == "ok"
    assert np.abs(found.readings["seat.spin.z"] - speed).max() <= 1e-4 * float(params["drive_speed"])
    assert np.abs(found.readings["seat.angle"] - turn).max() <= 1e-5 * turn[-1]


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIONS)
def test_the_energy_balance_closes_under_programmes(name):
    # The work of a torque that fluctuates, reverses, falls with the speed or follows a table is in it.
    scene, params = made(name)
    found = energy_balance.balance(scene, params, np.linspace(0.0, 0.04, 5), 1e-4)
    assert found.closure < 1e-4 and abs(found.taken["load"][-1]) > 0.0


FREE = {"contacts": ("seat_ball", "head_ball"), "cage": "fixed", "head": "fixed", "friction": False, "balls": 3}


@functools.cache
def alone(**options):
    """The head's speed under its load alone, its balls in clearances that do not close; times and parameters."""
    scene = plain_joint(**FREE, drive="flexible", **options)
    values = {"clearance_seat_ball": 5e-3, "clearance_head_ball": 5e-3, "drive_speed": 1e-9, "load_torque": 2.0}
    params = scene.parameters(values, load_ramp=1e-3, ball_mass=10.0)
    found = bj.simulate(scene, params, np.linspace(0.0, 4e-3, 41), read=["head.spin.z in head"], accuracy=1e-3)
    assert found.status == "ok" and max(np.abs(x).max() for x in found.force.values()) == 0.0
    return found.times, found.readings["head.spin.z in head"], {name: float(x) for name, x in params.items()}


@pytest.mark.slow
def test_the_impulse_of_a_torque_is_the_heads_angular_momentum():
    # From rest: I w(t) = -integral of the torque, T (t^2/2 ramp) and then T (t - ramp/2) for a line.
    t, w, p = alone(load_profile="linear")
    impulse = 2.0 * np.where(t < 1e-3, 0.5 * t**2 / 1e-3, t - 0.5e-3)
    assert np.abs(p["head_inertia"] * w + impulse).max() <= 1e-4 * impulse[-1]


@pytest.mark.slow
def test_a_bit_that_sticks_holds_the_head_from_which_it_takes_torque():
    # dw/dt = -(T/I) falling(w), integrated by itself.
    from scipy.integrate import solve_ivp

    scene = plain_joint(**FREE, drive="flexible", stick_slip=True)
    values = {"clearance_seat_ball": 5e-3, "clearance_head_ball": 5e-3, "load_torque": 2.0}
    params = scene.parameters(values, load_ramp=1e-6, ball_mass=10.0)
    times = np.linspace(0.0, 4e-3, 41)
    found = bj.simulate(scene, params, times, read=["head.spin.z in head"], accuracy=1e-4)

    def slowed(t, w):
        peak = 1.0 / (1.0 + w**2)
        return -2.0 / 1e-3 * np.tanh(w / 0.1) * (1.0 + peak) * (t > 0.5e-6)

    begin = [float(params["drive_speed"])]
    w = solve_ivp(slowed, (0.0, times[-1]), begin, t_eval=times, rtol=1e-9, atol=1e-9, max_step=1e-5)
    assert found.readings["head.spin.z in head"] == within(w.y[0], 2e-3)
