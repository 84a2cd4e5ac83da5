"""``fidelity = "auto"``: the folding of a motion that repeats, what equilibrium leaves out, and the choice."""

from __future__ import annotations

import json
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from joints import LITTLE, plain_joint
from typer.testing import CliRunner

import bcfj_jax as bj
from bcfj_jax.cli import app
from bcfj_jax.io.scenefile import from_table, quickest
from bcfj_jax.models.joint import fidelity, periodic, system
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.kinematic import kinematic_states, nominal
from bcfj_jax.models.joint.model_error import statics
from bcfj_jax.models.joint.observe import observe
from bcfj_jax.solve.simulation import Run

AUTO = plain_joint(fidelity="auto")
TIMES = np.linspace(0.0, 3.0, 401)


def periodic_force(times, speed, decay=0.0, balls=6):
    """Forces that depend on a ball's azimuth alone, and one of a pilot with a part that dies away."""
    azimuth = speed * times[:, None] + 2.0 * np.pi * np.arange(balls) / balls
    ball = 1e3 * (1.0 + 0.6 * np.sin(azimuth) + 0.2 * np.cos(3.0 * azimuth))
    pilot = 500.0 * (2.0 + np.cos(balls * speed * times)) + decay * np.exp(-times / 0.1)
    return {"seat_ball": np.stack([ball] * 3, -1), "seat_cage": np.stack([pilot] * 3, -1)}


def folded_at(speed, count=2, **more):
    params = AUTO.parameters(drive_speed=speed)
    return params, periodic.fold(AUTO, params, TIMES, periodic.risen(AUTO, params, count), **more)


@pytest.mark.parametrize("speed", [10.0, -17.3])
def test_a_motion_that_repeats_is_unfolded_exactly(speed):
    params, folded = folded_at(speed)
    assert np.all(np.diff(folded.times) > 0) and folded.times[-1] < 0.32
    short = periodic_force(folded.times, speed)
    found = periodic.unfolded(AUTO, params, folded, short)
    for name, right in periodic_force(TIMES, speed).items():
        np.testing.assert_allclose(found[name], right, rtol=1e-6)
    assert max(periodic.mismatch(AUTO, params, folded, short).values()) < 1e-7


def test_a_whole_run_is_left_where_it_is():
    _, folded = folded_at(10.0, whole=True)
    np.testing.assert_allclose(folded.times[folded.index], TIMES, atol=1e-8)
    assert not folded.pitches.any()


def test_mismatch_is_the_difference_of_two_pitches():
    params, folded = folded_at(10.0)
    force = periodic_force(folded.times, 10.0, decay=300.0)
    period, end = 2.0 * np.pi / 60.0, 0.05 + 4.0 * np.pi / 60.0
    phases = end - 0.5 * period * np.arange(48) / 48
    off = 300.0 * (np.exp(-(phases - period) / 0.1) - np.exp(-phases / 0.1))
    top = force["seat_cage"][:, 0].max()
    found = periodic.mismatch(AUTO, params, folded, force)
    assert found["seat_cage"] == pytest.approx(np.sqrt(np.mean(off**2)) / top, rel=1e-6)
    assert found["seat_ball"] < 1e-7


def test_a_cage_that_drifts_between_the_ends_of_its_windows_does_not_repeat():
    scene = plain_joint(window_ends=True)
    params, folded = folded_at(10.0)
    params = scene.parameters(params)
    ends = np.zeros((folded.times.size, scene.balls, 3))
    # The cage at 0.99 of the seat's speed falls behind by 0.01 pi/3 a pitch: by how much in the pitches left out?
    states = np.zeros((folded.times.size, scene.states))
    states[:, scene.azimuth] = 9.9 * folded.times
    way = 0.01 * np.pi / 3 * folded.pitches.max() * 0.0355
    found = periodic.mismatch(scene, params, folded, {"cage_window_end": ends}, states)
    assert found["cage_window_end"] == pytest.approx(way / 2.5e-3, rel=1e-6)
    # Ends that bear hold it.
    ends[..., 0] = 100.0
    assert periodic.mismatch(scene, params, folded, {"cage_window_end": ends}, states)["cage_window_end"] == 0.0
    # Equilibrium knows no friction, which alone presses balls against ends.
    few = {"friction_static": 1e-5, "friction_dynamic": 1e-5}
    assert fidelity._statics_apply(AUTO, AUTO.parameters(few), 0.01)
    assert not fidelity._statics_apply(scene, scene.parameters(few), 0.01)


def test_states_are_unfolded_as_the_closed_form_motion_goes_on():
    scene = plain_joint(spin=True, friction="lugre")
    params = scene.parameters(drive_speed=-12.0)
    folded = periodic.fold(scene, params, TIMES, periodic.risen(scene, params, 2))
    states = jax.jit(kinematic_states, static_argnums=0)
    short, right = (np.asarray(states(scene, params, t)) for t in (folded.times, TIMES))
    np.testing.assert_allclose(periodic.unfolded_states(scene, params, folded, short), right, atol=1e-7)


@pytest.mark.slow
def test_what_equilibrium_leaves_out_is_what_friction_changes():
    """Against SciPy's root of the forces of ``system``, friction at the speeds of the motion without clearance."""
    scene = plain_joint(**LITTLE | {"friction": True}, fidelity="quasistatic")
    params = scene.parameters(friction_static=4e-4, friction_dynamic=1e-4, damping=0.0)
    c, times = constants(scene, params), np.array([0.1, 0.13, 0.17])
    found = statics(scene, params, times)
    n, turn = 9, 9 + scene.slices["head_turn"].start

    @jax.jit
    def pushes(x, t, rough):
        y = nominal(scene, params, params["drive_speed"] * t)
        y = y.at[: n + scene.coupling].add(jnp.concatenate([x[:n] * 1e-5, jnp.zeros(scene.coupling)]))
        y = y.at[turn].add(x[n] * 1e-4)
        y = jnp.where(jnp.arange(y.size) >= n + scene.coupling, rough * y, y)
        state = system.view(scene, c, y)
        contact_forces = system.contact_forces(scene, c, state)
        ball, coupling = system.on_bodies(scene, c, state, contact_forces)
        coupling = coupling + system.applied(scene, c, t, state)
        at = scene.slices["head_turn"].start
        return jnp.concatenate([ball.ravel() * 1e-3, coupling[at : at + 1] * 1e-2]), y

    # Balls half way between tracks that have turned by what the load takes: 0.14 mm each.
    way = np.stack([-np.sin(scene.azimuths), np.cos(scene.azimuths), np.zeros(3)], 1)
    for k, t in enumerate(times):
        turned = float(params["drive_speed"]) * t
        swung = np.array([[np.cos(turned), -np.sin(turned), 0.0], [np.sin(turned), np.cos(turned), 0.0], [0, 0, 1]])
        guess = np.append(-14.0 * way @ swung.T, -79.0)
        normals = []
        for rough in (0.0, 1.0):
            at = scipy.optimize.root(lambda x, t=t, rough=rough: pushes(x, t, rough)[0], guess, tol=1e-11)
            assert np.abs(at.fun).max() < 1e-7
            still = jnp.where(jnp.arange(scene.states) >= n + scene.coupling, 0.0, pushes(at.x, t, 0.0)[1])
            normals.append({name: r.force[..., 0] for name, r in observe(scene, c, still).items()})
        for name, force in found.quasistatic.items():
            # A ball that carries nothing floats, and is held by the grounding's springs alone.
            np.testing.assert_allclose(force[k], normals[0][name], rtol=1e-4, atol=1.0)
            right = normals[1][name] - normals[0][name]
            np.testing.assert_allclose(found.left_out[name][k], right, atol=0.03 * np.abs(right).max())


def test_levels_state_their_errors():
    one = {"a": np.full((4, 2), 10.0)}
    found = fidelity.Statics({"a": one["a"] + 3.0}, one, {"a": np.full((4, 2), -2.0)}, np.ones(4, bool))
    assert fidelity.static_errors(found) == {"kinematic": 5.0 / 8.0, "quasistatic": 2.0 / 8.0}
    nowhere = found._replace(converged=np.array([True, False, True, True]))
    assert set(fidelity.static_errors(nowhere).values()) == {np.inf}


def made_up(decay=0.0, failure=np.nan):
    """A ``run`` for ``adaptive``: made-up forces in place of the dynamic model's; counts the times it is called."""
    calls = []

    def run(scene, times):
        assert scene.fidelity == "dynamic"
        calls.append(times)
        lost = np.where(times >= failure, np.nan, 0.0)
        force = {k: x + lost.reshape(-1, *[1] * (x.ndim - 1)) for k, x in periodic_force(times, 10.0, decay).items()}
        scalars = {name: x[..., 0] for name, x in force.items()}
        failed = bool(np.isnan(lost).any())
        stats = {"accepted": 7, "rejected": 1, "tolerance": 0.01, "wall_s": 0.5, "compile_s": 0.0}
        end = ("failed", "no", failure) if failed else ("ok", "", np.nan)
        states = np.zeros((times.size, scene.states)) + lost[:, None]
        return Run(times, force, scalars, scalars, scalars, *end, stats, trajectory=states)

    return run, calls


@pytest.mark.slow
def test_what_has_not_settled_is_repeated_for_no_budget():
    params = AUTO.parameters(drive_speed=10.0)
    stated = [fidelity.adaptive(AUTO, params, TIMES, budget, made_up(decay=1e5)[0]).choice for budget in (0.5, 0.01)]
    assert 0.01 < stated[0].errors["periodic"] < 0.5
    assert stated[0].fidelity == stated[1].fidelity == "dynamic" and "more than 1 %" in stated[0].reason


def test_a_motion_that_repeats_is_not_solved_to_the_end():
    run, calls = made_up()
    found = fidelity.adaptive(AUTO, AUTO.parameters(drive_speed=10.0), TIMES, 0.01, run)
    assert found.choice.fidelity == "periodic" and len(calls) == 1 and calls[0][-1] < 0.5
    assert found.choice.errors["periodic"] <= 0.01 and "1 %" in found.choice.reason
    np.testing.assert_allclose(found.force["seat_ball"], periodic_force(TIMES, 10.0)["seat_ball"], rtol=1e-6)
    assert found.trajectory.shape == (TIMES.size, AUTO.states) and found.stats["accepted"] == 7


def test_a_motion_that_does_not_repeat_is_solved_to_the_end():
    params = AUTO.parameters(drive_speed=10.0)
    run, calls = made_up(decay=1e5)
    tight = fidelity.adaptive(AUTO, params, TIMES, 1e-9, run)
    assert tight.choice.fidelity == "dynamic" and "more than" in tight.choice.reason
    assert calls[-1][-1] == pytest.approx(3.0) and tight.stats["accepted"] == 7 * len(calls) > 7
    right = periodic_force(TIMES, 10.0, decay=1e5)
    np.testing.assert_allclose(tight.force["seat_cage"], right["seat_cage"], rtol=1e-6)
    run, calls = made_up()
    short = fidelity.adaptive(AUTO, params, np.linspace(0.0, 0.3, 21), 0.01, run)
    assert short.choice.fidelity == "dynamic" and "too short" in short.choice.reason and len(calls) == 1


def test_a_run_that_fails_is_nothing_from_then_on():
    run, calls = made_up(failure=0.1)
    found = fidelity.adaptive(AUTO, AUTO.parameters(drive_speed=10.0), TIMES, 0.01, run)
    assert found.status == "failed" and found.failure_time == 0.1 and len(calls) == 1
    lost = np.isnan(found.force["seat_ball"]).all(axis=(1, 2))
    np.testing.assert_array_equal(lost, TIMES >= 0.1)


def test_derivatives_ask_for_a_model():
    with pytest.raises(bj.InputError, match=r"auto.*kinematic, quasistatic, dynamic"):
        bj.force_history(AUTO, AUTO.parameters(), TIMES)


FILE = """
[scene]
kind = "joint"
fidelity = "auto"
friction = {friction}
contacts = ["seat_ball", "head_ball"]
cage = "fixed"
head = "fixed"
balls = 3
[parameters]
joint_angle = "{angle} deg"
load_ramp = 0.2
[time]
end = {end}
samples = 101
[accuracy]
force_error = "{error} %"
"""


def simulated(folder, path):
    found = CliRunner().invoke(app, ["simulate", str(path), "--out", str(folder)])
    assert found.exit_code == 0, found.output
    return found.output, json.loads((folder / "summary.json").read_text())


@pytest.mark.parametrize(("errors", "expected"), [((0.009, 0.001), "kinematic"), ((0.02, 0.009), "quasistatic")])
def test_the_cheapest_level_within_the_budget_is_taken(monkeypatch, errors, expected):
    params = AUTO.parameters(friction_static=0.002, friction_dynamic=0.001)
    stated = dict(zip(("kinematic", "quasistatic"), errors, strict=True))
    monkeypatch.setattr(fidelity, "_look", lambda *_: (stated, {"wall_s": 0.25, "compile_s": 1.0}))
    ran = []
    blank = made_up()[0](plain_joint(), TIMES)
    found = fidelity.adaptive(AUTO, params, TIMES, 0.01, lambda scene, _: ran.append(scene.fidelity) or blank)
    assert found.choice.fidelity == expected and ran == [expected] and found.choice.errors == stated
    assert found.stats["wall_s"] == 0.75 and found.stats["compile_s"] == 1.0


@pytest.mark.slow
def test_without_friction_a_static_level_is_right(tmp_path):
    expected = "quasistatic"
    path = tmp_path / "little.toml"
    path.write_text(FILE.format(friction="false", angle=20, end=0.6, error=5))
    output, summary = simulated(tmp_path / "run", path)
    assert summary["fidelity"]["errors"]["kinematic"] > summary["fidelity"]["budget"] == 0.05
    assert summary["fidelity"]["fidelity"] == expected and f"Fidelity {expected}" in output
    assert not (tmp_path / "run" / "resultants.csv").exists()
    text = (tmp_path / "run" / "run.toml").read_text()
    assert f"# Fidelity {expected}" in text and tomllib.loads(text)["scene"]["fidelity"] == "auto"
    simulated(tmp_path / "again", tmp_path / "run" / "run.toml")
    one, two = ((tmp_path / name / "forces.csv").read_text() for name in ("run", "again"))
    assert one == two


def test_fast_leaves_an_open_fidelity_to_auto():
    def given(scene=(), **accuracy):
        return from_table({"scene": {"kind": "joint", **dict(scene)}, "accuracy": accuracy}, None)

    found = quickest(given(level="fast"))
    assert found.scene.fidelity == found.resolved["scene"]["fidelity"] == "auto"
    assert from_table(found.resolved, None).resolved == found.resolved
    # What derivatives and fits read is the dynamic model all the same.
    assert given(level="fast").scene.fidelity == "dynamic"
    for other in (given(level="balanced"), given(force_error=0.05), given({"fidelity": "dynamic"}, level="fast")):
        assert quickest(other) is other and other.scene.fidelity == "dynamic"


@pytest.mark.slow
def test_commands_that_need_a_model_refuse(tmp_path):
    path = tmp_path / "little.toml"
    path.write_text(FILE.format(friction="false", angle=20, end=0.6, error=5))
    found = CliRunner().invoke(app, ["sensitivity", str(path), "--wrt", "damping", "--out", str(tmp_path / "out")])
    assert found.exit_code == 2 and "auto" in found.output, found.output


@pytest.mark.slow
def test_the_default_joint_repeats_its_pitch():
    """Beside the dynamic model itself, to the end: forces, and the states that go with them."""
    times = np.linspace(1.5, 2.0, 151)
    runs = [bj.simulate(scene, scene.parameters(), times) for scene in (AUTO, plain_joint())]
    assert runs[0].choice.fidelity == "periodic", runs[0].choice
    assert runs[0].stats["accepted"] < 0.5 * runs[1].stats["accepted"]
    for name, force in runs[1].force.items():
        off = np.sqrt(np.mean((runs[0].force[name] - force) ** 2, axis=0)).max()
        assert off <= 0.01 * np.abs(force).max(), name
    np.testing.assert_allclose(runs[0].trajectory, runs[1].trajectory, atol=0.02 * np.abs(runs[1].trajectory).max())
