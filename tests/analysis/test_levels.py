"""Levels of accuracy and the envelope: derived from committed results, and kept on scenes drawn anew."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bcfj_jax import scenes, simulate
from bcfj_jax.analysis import envelope
from bcfj_jax.analysis.simulation.results import write
from bcfj_jax.solve.plan import LEVELS, plan
from benchmarks.common import load
from benchmarks.solve.levels import CERTAIN, KINDS, calm, compared, derived, joints_down, off, springs_down
from benchmarks.solve.random_scenes import LAWS

UNSEEN = 20261121


@pytest.mark.parametrize("kind", KINDS)
def test_levels_take_no_more_than_was_derived(kind):
    kept = load("levels")[kind]
    assert derived(kind, kept["rows"]) == kept["derived"]
    for one in kept["derived"]:
        assert float(plan(scenes.make(kind), one["promise"]).tolerance) <= 1.001 * one["tolerance"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["impact", "bounce"])
@pytest.mark.parametrize("law", LAWS)
def test_promises_hold_on_unseen_scenes(kind, law):
    ladder = [float(plan(scenes.make(kind), error).tolerance) for error in LEVELS.values()]
    box = envelope.guaranteed()[kind]
    rows = [
        row
        for row in springs_down(kind, law, 16, UNSEEN, ladder)
        if all(box[name][0] <= value <= box[name][1] for name, value in row["measures"].items())
    ]
    for k, promise in enumerate(LEVELS.values()):
        sure = [row for row in rows if row["apart"] <= CERTAIN * promise]
        assert len(sure) >= 8
        # A steep edge may fall on either side of an output time.
        assert sum(row["error"][k] > promise for row in sure) <= 1
        assert np.median([row["error"][k] for row in sure]) <= 0.5 * promise


@pytest.mark.slow
def test_the_promise_holds_on_unseen_joints():
    scene, levels = scenes.joint(), list(LEVELS.values())
    ladder = [float(plan(scene, error).tolerance) for error in levels]
    box = envelope.guaranteed()["joint"]
    rows = [
        row
        for row in joints_down(6, UNSEEN, ladder)
        if calm(row) and all(box[name][0] <= value <= box[name][1] for name, value in row["measures"].items())
    ]
    # Of the tightest promise not every joint has a reference that is certain enough.
    for k, (promise, least) in enumerate(zip(levels, (5, 5, 4), strict=True)):
        sure = [row for row in rows if row["apart"] <= CERTAIN * promise]
        assert len(sure) >= least
        assert all(row["error"][k] <= promise for row in sure)


def test_an_error_is_the_worst_of_three():
    # A rectangle of 1 N for 1 s beside one of 1.1 N: 10 % of the peak in rms, peak and impulse.
    times = np.linspace(0.0, 1.0, 101)
    truth = {"contact": np.stack([np.ones(101), np.zeros(101), np.zeros(101)], 1)}
    assert off({"contact": 1.1 * truth["contact"]}, truth, times) == pytest.approx(0.1)
    assert compared({"balls": np.ones((5, 6, 3))}).force.shape == (5, 6, 3)


def test_the_envelope_is_that_of_the_levels():
    from benchmarks.analysis.envelope import ranges as measured_ranges

    kept = load("levels")
    assert envelope.guaranteed() == {
        kind: {name: tuple(x) for name, x in measured_ranges(kept[kind]["rows"]).items()} for kind in KINDS
    }


def test_measures_by_hand():
    # K d^(n+1)/(n+1) = m v^2/2 for n = 1: d = v sqrt(m/K) = 1 mm; force times depth is twice the energy there.
    scene = scenes.impact(law="kelvin_voigt")
    params = scene.parameters(
        mass=1.0, stiffness=1e6, approach_speed=1.0, dashpot=100.0, smoothing=1e-4, clearance_contact=1e-3
    )
    found, _ = scene.envelope(params, np.array([0.0, 6e-3]))
    assert found == pytest.approx({"onset": 0.1, "loss": 0.1, "durations": 2.0}, rel=1e-6)


@pytest.mark.slow
def test_a_run_beyond_the_envelope_is_reported(tmp_path):
    from bcfj_jax.io.scenefile import from_table

    table = {
        "scene": {"kind": "impact"},
        "parameters": {"damping": 40.0},
        "time": {"end": 1e-3, "samples": 201},
    }
    given = from_table(table, None)
    run = simulate(given.scene, given.params, given.times)
    warned = write(tmp_path, given, run, "impact").warnings
    stated = [text for text in warned if "not guaranteed" in text]
    assert len(stated) == 1 and "share of the speed that damping takes" in stated[0] and " 60," in stated[0]
    assert stated[0] in json.loads((tmp_path / "summary.json").read_text())["warnings"]
    usual = from_table({"scene": {"kind": "impact"}}, None)
    assert envelope.warnings(usual.scene, usual.params, usual.times) == []


def test_a_joint_beyond_the_envelope_is_reported():
    def stated(end=3.0, parameters=(), **options):
        scene = scenes.make("joint", **options)
        return envelope.warnings(scene, scene.parameters(dict(parameters)), np.array([0.0, end]))

    assert stated() == [] and stated(fidelity="auto") == [] and stated(friction="lugre", fidelity="quasistatic") == []
    (fast,) = stated(parameters={"drive_speed": 30.0})
    assert "along its track over friction's transition speed is 4.16" in fast
    (wide,) = stated(parameters={"clearance_seat_ball": 90e-6})
    assert "a ball's clearance over the width of contact regularisation is 3," in wide
    (own,) = stated(parameters={"seat_cage.exponent": 2.5})
    assert "exponent is 2.5, measured from 1.5 to 1.5" in own
    (other,) = stated(spin=False)
    assert "options other than the defaults" in other
    (short,) = stated(end=0.1)
    # The ramp's 50 ms and a sixth of a turn at 100 r/min.
    assert "before the load has risen and the drive has turned on by one ball (150 ms)" in short
    (still,) = stated(parameters={"drive_speed": 0.0})
    assert "has turned on by one ball (never, because the drive does not turn)" in still
    assert stated(friction=False) and stated(contacts=("seat_ball", "head_ball"), cage="fixed")


def test_peaks_of_the_start_are_reported():
    scene = scenes.joint()
    params, times = scene.parameters(), np.linspace(0.0, 0.3, 301)
    force = {"seat_cage": np.zeros((301, 3)), "seat_ball": np.zeros((301, 6, 3))}
    force["seat_cage"][[4, 200], 0] = 2000.0, 1500.0
    force["seat_ball"][[4, 200], 2, 0] = 10.0, -20.0
    (stated,) = envelope.of_the_start(scene, params, times, force)
    assert "seat_cage 2 kN at 4 ms (1.5 kN from then on)" in stated and "seat_ball" not in stated
    quasistatic = scenes.joint(fidelity="quasistatic")
    assert envelope.of_the_start(quasistatic, params, times, force) == []
    force["seat_cage"][201:] = np.nan
    assert envelope.of_the_start(scene, params, times, force) == []


def test_the_defaults_are_inside():
    for kind in ("impact", "bounce", "joint"):
        scene = scenes.make(kind)
        params = scene.parameters()
        assert envelope.warnings(scene, params, np.array([0.0, float(scene.horizon(params))])) == [], kind
