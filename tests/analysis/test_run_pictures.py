"""What pictures of a run show: loading cycles, clearance circles, orders, states; held to closed forms and readings."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import numpy as np
import pytest
from joints import plain_joint

import bcfj_jax as bj
from bcfj_jax.analysis import features
from bcfj_jax.analysis.simulation import page, pictures, results, views
from bcfj_jax.analysis.simulation.views import Turning
from bcfj_jax.io.page import BAD, FAIR, GOOD
from bcfj_jax.mechanism.readings import contact_states
from bcfj_jax.solve.simulation import Run, readings

STATS = {"accepted": 1, "rejected": 0, "tolerance": 1e-3, "wall_s": 0.1, "compile_s": 1.0}


def run_of(times, force, depth, state=None, **more) -> Run:
    """A run from normal forces and penetrations by contact, (T,) or (T, k)."""
    full = {name: np.stack([f, 0 * f, 0 * f], -1) for name, f in force.items()}
    nothing = {name: np.full_like(d, np.nan) for name, d in depth.items()}
    fixed = {"status": "ok", "reason": "", "failure_time": float("nan"), "stats": STATS} | more
    return Run(times, full, depth, nothing, {}, state=state or {}, **fixed)


def impacts():
    """Two impacts of a spring with losses; the second is the higher one. The loop of each is an ellipse's upper half."""
    phase = np.linspace(0.0, np.pi, 101)
    depth = np.concatenate([1e-5 * np.sin(phase), -1e-5 * np.sin(phase)[1:], 2e-5 * np.sin(phase)[1:], [-1e-6]])
    force = np.where(depth > 0, 1e8 * depth, 0.0)
    push = np.concatenate([200 * np.cos(phase), 0 * phase[1:], 400 * np.cos(phase)[1:], [0.0]])
    times = np.arange(depth.size) * 1e-6
    return times, np.where(depth > 0, np.maximum(force + 0.3 * push * depth / 2e-5, 0.0), 0.0), depth


def test_the_loop_is_the_contact_with_the_highest_force():
    times, force, depth = impacts()
    run = run_of(times, {"contact": force}, {"contact": depth})
    peak = pictures.peaks(run)["contact"]
    assert peak.force == force.max() and peak.member == 0 and times[200] < peak.time < times[300]
    found = pictures.loop(run, "contact", peak)
    assert found is not None and found.closed
    # It begins and ends without a force, and holds no other impact.
    assert found.force[0] < 0.01 * peak.force and found.force[-1] < 0.01 * peak.force
    assert found.depth.max() == depth.max() and 95 < found.depth.size < 106
    # Area by Green's theorem over the closed polygon.
    x, y = found.depth, found.force
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert np.trapezoid(y, x) == pytest.approx(area, rel=1e-3)


def test_the_loop_of_steady_motion_is_one_period_of_its_load():
    times = np.linspace(0.0, 1.0, 2001)
    load = 5e3 + 2e3 * np.sin(20 * np.pi * times)
    depth = 3e-6 + 1e-6 * np.sin(20 * np.pi * times - 0.1)
    run = run_of(times, {"pin": load}, {"pin": depth})
    found = pictures.loop(run, "pin", pictures.peaks(run)["pin"], cycle=0.1)
    assert found is not None and found.closed and found.force.size == 201
    assert found.force[0] == pytest.approx(found.force[-1]) and found.depth[0] == pytest.approx(found.depth[-1])
    # pi a b sin(lag): the energy that a harmonic contact takes in a cycle.
    assert np.trapezoid(found.force, found.depth) == pytest.approx(-np.pi * 2e3 * 1e-6 * np.sin(-0.1), rel=1e-3)


def test_a_contact_that_never_touches_has_no_loop(tmp_path):
    times = np.linspace(0.0, 1.0, 50)
    run = run_of(times, {"pin": 0 * times}, {"pin": -1e-6 + 0 * times})
    assert pictures.loop(run, "pin", pictures.peaks(run)["pin"]) is None
    assert "no contact at any sample" in pictures.loops(run, tmp_path / "a.png").shows


def test_the_force_at_zero_penetration_is_said_to_be_smoothing(tmp_path):
    depth = np.concatenate([np.linspace(-5e-6, 5e-6, 200), np.linspace(5e-6, -5e-6, 200)])
    force = 1e8 * np.maximum(depth + 3e-6, 0.0)
    run = run_of(np.arange(400.0), {"seat": force}, {"seat": depth})
    shows = pictures.loops(run, tmp_path / "a.png", widths={"seat": 3e-6}).shows
    assert "300 N at zero penetration because contact begins 3 µm early (smoothing)" in shows
    assert "zero penetration" not in pictures.loops(run, tmp_path / "b.png").shows


def test_orders_are_those_of_the_shaft(tmp_path):
    times = np.linspace(0.0, 3.0, 3001)
    wave = 1e3 + 300 * np.cos(2 * np.pi * 6 * times / 0.6) + 50 * np.cos(2 * np.pi * 2 * times / 0.6)
    run = run_of(times, {"pin": wave}, {"pin": 0 * times})
    found = views.orders(run, tmp_path / "orders.png", Turning(0.6, 0.1))
    assert found is not None and "pin 300 N at order 6" in found.shows and "members pass at orders 6, 12" in found.shows
    assert views.orders(run, tmp_path / "none.png", Turning(60.0, 10.0)) is None


def test_members_loads_are_by_angle_and_states_by_share(tmp_path):
    times = np.linspace(0.0, 1.2, 601)
    angle = 2 * np.pi * (times[:, None] / 0.6 + np.arange(4) / 4)
    force = 1e3 * np.maximum(np.cos(angle), 0.0)
    state = np.where(force > 0, 1, 0).astype(np.int8)
    run = run_of(times, {"ball": force}, {"ball": force / 1e8}, {"ball": state})
    said = views.around(run, tmp_path / "around.png", Turning(0.6, 0.15)).shows
    assert "ball: at most 1 kN" in said and "of 4 members" in said and "over the last turn" in said
    shares = views.states(run, tmp_path / "states.png", Turning(0.6, 0.15)).shows
    assert "apart 50 %" in shares and "touching 50 %" in shares


def test_the_verdict_names_the_highest_force_and_its_error():
    times, force, depth = impacts()
    run = run_of(times, {"a": force, "b": 2 * force}, {"a": depth, "b": depth})
    errors = {name: {"rms": 1e-4, "peak": 2e-4, "impulse": None} for name in "ab"}
    good = page.verdict(run, {"accuracy": {"asked": 0.01, "measured": errors}})
    assert good.kind == GOOD and "in b at" in good.sentence and "measured error 0.02 %, asked 1 %" in good.sentence
    assert page.verdict(run, {"accuracy": {"asked": 1e-5, "measured": errors}}).kind == FAIR
    lost = page.verdict(run._replace(status="failed", reason="too many steps", failure_time=1e-3), {})
    assert lost.kind == BAD and "1 ms" in lost.sentence and "too many steps" in lost.sentence


# Clearance circles: how far a centre is from the middle is the clearance and the penetration.


@pytest.mark.slow
def test_the_pin_of_the_slider_crank_is_where_its_penetration_says():
    scene = bj.scenes.slider_crank()
    params = scene.parameters()
    # As many samples as in io/test_view.py: one compiled program serves both.
    run = bj.simulate(scene, params, np.linspace(0.0, 2e-3, 401))
    orbit = scene.orbits(params, run)["journal"]
    size = np.hypot(orbit.x, orbit.y)
    assert orbit.clearance == float(params["clearance_journal"]) and orbit.what == "rod in slider"
    np.testing.assert_allclose(size - orbit.clearance, run.penetration["journal"], atol=1e-9)


@pytest.mark.full
def test_the_cage_of_the_joint_is_where_its_penetrations_say():
    scene = plain_joint()
    params = scene.parameters()
    state = np.array(scene.initial_state(params))
    states = np.repeat(state[None], 4, axis=0)
    coupling = 3 * scene.balls
    for body, scale in (("cage", 3e-5), ("head", 2e-5)):
        at = scene.slices[body]
        moved = scale * np.random.default_rng(1).standard_normal((4, 3))
        states[:, coupling + at.start : coupling + at.stop] += moved
    times = np.zeros(4)
    found = jax.jit(lambda t, y: readings(scene, params, t, y))(times, states)
    orbits = scene.orbits(params, SimpleNamespace(trajectory=states, choice=None, times=times))
    assert set(orbits) == {"seat_cage", "head_cage"}
    for name, orbit in orbits.items():
        size = np.sqrt(orbit.x**2 + orbit.y**2 + orbit.along**2)
        np.testing.assert_allclose(size - orbit.clearance, found[name].penetration, atol=1e-11)
    assert contact_states(scene, params, found)["seat_cage"].shape == (4,)


@pytest.mark.parametrize(("rests", "warned"), [(True, False), (False, True)])
def test_bounces_between_samples_are_counted_and_warned_of_where_they_matter(rests, warned):
    """A contact that rests for most of the run, with one bounce that no sample shows; and one that only bounces."""
    depth, rate = np.full(100, -1e-5), np.full(100, 1e-3)
    depth[10:15], rate[50:] = 1e-6, -1e-3
    rate[10:15] = 0.0
    if rests:
        depth[10:49] = 1e-6
    run = SimpleNamespace(
        times=np.linspace(0.0, 1.0, 100), penetration={"c": depth}, rate={"c": rate}, force={"c": np.zeros((100, 3))},
        readings={}, status="failed", extremes={},
    )  # fmt: skip
    depth[60:95] = 1e-6 if rests else depth[60:95]
    assert features.unseen(run.times, depth, rate).size == 1
    assert any("between two samples" in line for line in results.resolution_warnings(run)) == warned


def test_a_column_of_contacts_between_samples_is_there_where_one_was_missed():
    scene = bj.scenes.impact()
    assert "between samples" not in str(
        page.contact_rows(scene, {"contacts": {"contact": {"peak": 1.0, page.BETWEEN: 0}}})
    )
    contacts = {"contact": {"peak": 1.0, page.BETWEEN: 7}}
    assert ["between samples", "7"] in page.contact_rows(scene, {"contacts": contacts}) and "leave out" in page.note(
        contacts
    )
