"""Balances of runs: they close for what is right, miss for what is wrong, and are said first where they miss."""

from __future__ import annotations

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from by_numpy import by_numpy
from hypothesis import given, settings
from hypothesis import strategies as st
from joints import plain_joint
from mechanisms import GAPS, JOINTS, mechanism
from oracles import within

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps, loads
from bcfj_jax.analysis import balance, features
from bcfj_jax.analysis.simulation import folder, page, pictures, results
from bcfj_jax.io.page import BAD, FAIR, GOOD
from bcfj_jax.solve.measured_error import Accuracy

TIMES = np.linspace(0.0, 0.05, 1001)
BALL = {"stiffness": 1e6, "exponent": 1.5, "radius_a": 0.01, "radius_b": 0.01}
SPEED, MASS, GAP = 2.0, 0.1, 0.02


def balls(between=("a", "b"), law="hertz", kind=Mechanism, more=(), **values):
    """Two balls; the first meets the second, at rest, after 10 ms, and both begin and end apart."""
    bodies = [
        Body("a", "particle", mass=MASS, start={"vx": SPEED, "y": 1e-3}),
        Body("b", "particle", mass=MASS, start={"x": 0.02 + GAP}),
    ]
    hit = Contact("hit", between, gaps.SphereOnSphere(), law=law, values=BALL | values)
    return kind("balls", bodies, [hit], more, end=0.05)


def closure(scene, times=TIMES, asked=1e-2, looked=True, **given):
    """A run and its balance."""
    params = scene.parameters(given)
    run = bj.simulate(scene, params, times, accuracy=asked, resolved_peaks=looked)
    return run, balance.of_run(scene, params, run, asked)


# --- at one instant


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joints", "touching", "seed"),
    [
        (["free", "slide"], sorted(GAPS)[:2], 4),
        pytest.param(list(JOINTS), sorted(GAPS), 6, marks=pytest.mark.slow),
        pytest.param(["hinge"] * 4, sorted(GAPS), 3, marks=pytest.mark.slow),
    ],
)
def test_rates_of_momenta_are_those_of_the_motion(joints, touching, seed):
    check_rates(joints, touching, seed)


EDGED = ("box_on_plane", "capsule_on_plane", "cylinder_on_plane", "capsule_on_capsule", "sphere_on_box", "sphere_on_wedge",
         "pin_in_pads", "points_on_box", "rods_on_edges")  # fmt: skip


@pytest.mark.full
def test_rates_of_momenta_with_couplings_screws_bodies_without_mass_and_edges():
    check_rates(["particle"], list(EDGED), 7, True)


@pytest.mark.slow
@settings(max_examples=25)
@given(
    joints=st.lists(st.sampled_from(JOINTS), min_size=1, max_size=5),
    touching=st.lists(st.sampled_from(sorted(GAPS)), min_size=1, max_size=6),
    seed=st.integers(0, 2**32 - 1),
    more=st.booleans(),
)
def test_rates_of_momenta_of_many_are_those_of_the_motion(joints, touching, seed, more):
    check_rates(joints, touching, seed, more)


def check_rates(joints, touching, seed, more=False):
    """Momenta and energy change along the motion, which the mass matrix gives, at the rates that forces alone give."""
    scene, params = mechanism(joints, touching, seed, more=more)

    def moved(t, params):
        def values(t, y):
            found = scene.accounts(t, y, params)
            return {name: one.value for name, one in found.items()}, found

        y = scene.initial_state(params)
        return jax.jvp(values, (t, y), (jnp.ones(()), scene.vector_field(t, y, params)), has_aux=True)[1:]

    gain, found = by_numpy(moved)(jnp.asarray(0.37), params)
    assert len(found) == 1 + sum(len(b.rates) for b in scene.bodies)
    for name, one in found.items():
        assert float(gain[name]) == pytest.approx(float(one.rate), abs=1e-9 * (1.0 + float(one.size)))
        assert float(one.size) >= abs(float(one.rate)) * (1.0 - 1e-9)


# --- over runs


def test_an_impact_closes_and_its_impulse_is_what_the_bodies_exchange():
    run, found = closure(balls(), looked=True)
    assert found.verdict == balance.CLOSED and found.quadrature == "steps" and found.reason == ""
    assert set(found.errors) == {"a", "b", "scene"}
    assert all(one.error < 1e-2 for parts in found.errors.values() for one in parts.values())
    steps, y = run.extremes["hit"], run.trajectory
    rates = y[-1, 6:] - y[0, 6:]
    # Off the line of centres, the impulse is along the line at touch: equal and opposite, of the size that was summed up.
    assert np.allclose(rates[:3], -rates[3:], atol=1e-9)
    assert float(steps.impulse) == within(MASS * np.linalg.norm(rates[:3]), 2e-3)
    assert steps.count == 1.0 and steps.deepest > 0.0 and steps.touching == within(float(steps.end - steps.onset), 1e-9)
    assert abs(steps.work) < 1e-2 * 0.5 * MASS * SPEED**2


@pytest.mark.parametrize("samples", tiers.ci([2, 11, 1001], 2))
def test_features_of_the_steps_do_not_depend_on_samples(samples):
    # Hertz: d0 = (5 m v^2 / 4 K)^(2/5), contact for 2.943275 d0/v, impulse 2 m v; rebound without a loss.
    scene = bj.scenes.impact(law="hertz", smoothing=False)
    params = scene.parameters(stiffness=1e9, mass=1.0, approach_speed=1.0, exponent=1.5, clearance_contact=1e-4)
    deepest = (1.25 / 1e9) ** 0.4
    end = 1e-4 + 4.0 * deepest
    run = bj.simulate(scene, params, np.linspace(0.0, end, samples), accuracy=1e-4, resolved_peaks=True)
    found = results.summary(run, False)["contacts"]["contact"]
    assert found["impulse"] == within(2.0, 1e-4) and found["mean"] == within(2.0 / end, 1e-4)
    assert found["peak_penetration"] == within(deepest, 1e-3) and found["contact_count"] == 1.0
    assert found["contact_start"] == within(1e-4, 1e-6)
    assert found["contact_end"] == within(1e-4 + 2.943275 * deepest, 1e-3)
    assert found["contact_fraction"] == within(2.943275 * deepest / end, 1e-3)
    assert abs(found["dissipated_work"]) < 1e-4 and np.isnan(found["period"])
    assert balance.of_run(scene, params, run, 1e-4).verdict == balance.CLOSED


@pytest.mark.slow
def test_features_of_the_steps_are_those_of_fine_samples():
    scene = bj.scenes.bounce()
    params = scene.parameters()
    run = bj.simulate(scene, params, np.linspace(0.0, 0.7, 20_001), accuracy=1e-4, resolved_peaks=True)
    columns = run.force["contact"][:, 0], run.penetration["contact"], run.rate["contact"]
    fine, steps = features.summary(run.times, *columns), results.summary(run, False)["contacts"]["contact"]
    assert fine["contact_count"] > 2 and set(fine) <= set(steps)
    for name, value in fine.items():
        # A sharp peak between two samples is half a per cent above both.
        assert steps[name] == within(value, 5e-3), name
    assert balance.of_run(scene, params, run, 1e-4).verdict == balance.CLOSED


@pytest.mark.slow
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_signs_and_the_order_of_bodies_change_nothing(way):
    start = {"a.vx": way * SPEED, "b.x": way * (0.02 + GAP)}
    (run, found), (other, swapped) = (closure(balls(order), **start) for order in (("a", "b"), ("b", "a")))
    for body, parts in found.errors.items():
        for what, one in parts.items():
            assert swapped.errors[body][what].error == pytest.approx(one.error, abs=1e-7)
    assert other.extremes["hit"].impulse == within(float(run.extremes["hit"].impulse), 1e-6)


SPRUNG = [
    loads.Gravity("-y"), loads.Spring("cord", ("ground", "b0"), 30.0, 0.5, 0.1, ((0.4, 0.05, 0.1), (0.05, 0.0, 0.0))),
]  # fmt: skip


def linked(spatial, kind=Mechanism):
    """Two bodies on joints, one driven crank, contacts with friction, gravity and a spring: planar or spatial."""
    joints = ("free", "spherical") if spatial else ("planar", "hinge")
    start = {"q0": 1.0, "wx": 2.0, "wy": -1.0} if spatial else {"speed": 2.0}
    bodies = [
        Body(
            "b0",
            joints[0],
            at=(0.0, 0.05, 0.0),
            center=(0.01, 0.02, 0.0),
            mass=0.8,
            inertia=2e-3,
            start={"vx": 0.4} | start,
        ),
        Body("b1", joints[1], "b0", (0.1, 0.0, 0.0), mass=0.3, center=(0.04, 0.0, 0.0), inertia=1e-3),
        Body("crank", "hinge", mass=0.2, inertia=1e-3, drive=bj.Drive("constant", speed=9.0)),
    ]
    rub = {"stiffness": 3e4, "damping": 0.3, "radius": 0.04, "friction_dynamic": 0.3, "friction_speed": 0.05}
    contacts = [
        Contact(f"on_{b}", ("ground", b), gaps.SphereOnPlane("y"), elastic="linear", friction="coulomb", values=rub)
        for b in ("b0", "b1")
    ]
    pulled = loads.Bush("rod", ("crank", "b1"), 200.0, 3.0, at=((0.05, 0.0, 0.0), (0.02, 0.0, 0.0)))
    return kind("linked", bodies, contacts, [*SPRUNG, pulled], end=0.4)


# In space, in CI's tier: every joint at one instant (``check_rates``).
@pytest.mark.slow
@pytest.mark.parametrize("spatial", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("asked", [1e-2, 1e-4])
def test_bodies_on_joints_close(spatial, asked):
    run, found = closure(linked(spatial), np.linspace(0.0, 0.4, 801), asked)
    assert run.status == "ok" and found.verdict == balance.CLOSED, found.reason
    assert {"b0", "b1", "scene"} == set(found.errors) and min(x.count for x in run.extremes.values()) >= 1.0
    # Without the solver's steps the samples say the same, less sharply, or that they are too few.
    plain = balance.of_run(linked(spatial), linked(spatial).parameters(), run._replace(totals={}, extremes={}), asked)
    assert plain.verdict in (balance.CLOSED, balance.UNKNOWN)


@pytest.mark.slow
@settings(max_examples=5)
@given(
    joints=st.lists(st.sampled_from([j for j in JOINTS if j != "fixed"]), min_size=1, max_size=3),
    touching=st.lists(st.sampled_from(sorted(GAPS)), min_size=1, max_size=2),
    seed=st.integers(0, 2**32 - 1),
    asked=st.sampled_from([1e-2, 1e-4]),
)
def test_random_mechanisms_close(joints, touching, seed, asked):
    scene, params = mechanism(joints, touching, seed)
    run = bj.simulate(scene, params, np.linspace(0.0, 0.2, 401), accuracy=asked, resolved_peaks=True, max_steps=20_000)
    found = balance.of_run(scene, params, run, asked)
    assert run.status != "ok" or not scene.traits.history or found.verdict == balance.CLOSED, found.reason


# --- what is wrong is found


class Scaled(Mechanism):
    """Its forces are evaluated a tenth too large; its motion is right."""

    def accounts(self, t, y, prepared):
        return super().accounts(t, y, prepared | {"hit.stiffness": 1.1 * prepared["hit.stiffness"]})


class Blind(Mechanism):
    """Its motion knows no contact: the solver steps over each."""

    def vector_field(self, t, y, prepared):
        return self.motion(t, y, prepared)


class Deaf(Mechanism):
    """Its motion knows no load but its forces do: the solver steps over a pulse."""

    def vector_field(self, t, y, prepared):
        return Mechanism(self.kind, self.bodies, self.contacts).vector_field(t, y, prepared)


@pytest.mark.slow
@pytest.mark.parametrize("alone", tiers.ci([True, False], True))
def test_a_torque_of_rounding_is_no_contradiction(alone):
    """A ball in a circular track, without friction: no force turns it, and what is computed of the torque is rounding."""
    sizes = {"clearance": 2e-3, "ball_radius": 8e-3, "pitch_radius": 0.04, "offset": 0.0}
    track = gaps.BallInGroove(section="circular")
    names = ("ball",) if alone else tuple(f"ball_{k}" for k in range(6))
    places = {name: 0.6 + 0.1 * k for k, name in enumerate(names)}
    bodies = [
        Body(
            name,
            "sphere",
            mass=0.0167,
            inertia=4.3e-7,
            start={"x": 0.04 * np.sin(a), "z": -0.04 * np.cos(a), "vx": 0.15},
        )
        for name, a in places.items()
    ]
    hits = [
        Contact(f"in_{name}", ("ground", name), track, law="carvalho_martins", smoothing=False, values=sizes)
        for name in names
    ]
    scene = Mechanism("track", bodies, hits, [loads.Gravity("-z")], end=0.05)
    _, found = closure(scene, np.linspace(0.0, 0.05, 501), stiffness=2e9, exponent=1.5, restitution=0.7, gravity=9.81)
    assert found.verdict == balance.CLOSED
    assert 0.0 < found.errors[names[0]]["angular_momentum"].error < 1e-2


def test_a_planted_error_of_the_force_is_found():
    _, found = closure(balls(kind=Scaled))
    assert found.verdict == balance.MISSED and "of a and its forces contradict each other" in found.reason
    # A tenth of the impulse, of the impulse that is a tenth too large.
    assert found.errors["a"]["momentum"].error == within(0.1 / 1.1, 0.02)
    assert not found.errors["b"]["momentum"].closed and found.content()["of"]["b"]["verdict"] == balance.MISSED


@pytest.mark.parametrize("looked", tiers.ci([True, False], False))
def test_a_contact_that_is_stepped_over_is_found(looked):
    """Balls that fly through each other: forces at the samples, in some looks or none, and velocities unchanged."""
    run, found = closure(balls(kind=Blind), looked=looked)
    assert np.ptp(run.trajectory[:, 6]) < 1e-9 and run.force["hit"].max() > 1e3
    assert found.verdict == balance.MISSED and found.reason
    content = results.summary(run, False) | {"balance": found.content()}
    said = page.verdict(run, content)
    assert (
        said.kind == BAD
        and said.word.startswith("Forces and motion contradict")
        and said.sentence.startswith(found.reason)
    )
    assert page.balances(content)[0].rows[1:]


@pytest.mark.slow
def test_a_pulse_that_is_stepped_over_is_found():
    table = ((0.0, 0.02, 0.0205, 0.021, 1.0), (0.0, 0.0, 100.0, 0.0, 0.0))
    _, found = closure(balls(kind=Deaf, more=[loads.Force("pulse", "b", "y", table=table)]))
    assert found.verdict == balance.MISSED and " b" in found.reason
    _, right = closure(balls(more=[loads.Force("pulse", "b", "y", size=3.0)]))
    assert right.verdict == balance.CLOSED


@pytest.mark.slow
def test_what_cannot_be_known_says_why():
    scene = balls()
    run, _ = closure(scene)
    failed = bj.simulate(scene, scene.parameters(), TIMES, max_steps=3, resolved_peaks=True)
    assert failed.status == "failed"
    found = balance.of_run(scene, scene.parameters(), failed, 1e-2)
    assert found.verdict == balance.UNKNOWN and "did not reach its end" in found.sentence()
    driven = Mechanism(
        "cam", [Body("arm", "hinge", mass=1.0, inertia=1.0, drive=bj.Drive("constant", speed=1.0))], end=1.0
    )
    still = bj.simulate(driven, driven.parameters(), TIMES, read=["arm.angle"])
    assert "no inertia" in balance.of_run(driven, driven.parameters(), still, 1e-2).reason
    sparse = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 0.05, 5))
    assert balance.of_run(scene, scene.parameters(), sparse, 1e-2).verdict == balance.UNKNOWN
    assert np.isnan(results.summary(failed, False)["contacts"]["hit"]["peak"])
    assert run.totals and not sparse.totals


@pytest.mark.slow
def test_the_energy_of_the_joint_closes_by_its_samples():
    scene = plain_joint()
    run = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 0.1, 1001))
    found = balance.of_run(scene, scene.parameters(), run, 1e-2)
    assert found.verdict == balance.CLOSED and found.quadrature == "samples" and set(found.errors) == {"scene"}


# --- what is said first


def test_the_verdict_is_finished_only_where_balance_and_errors_hold():
    run, found = closure(balls())
    base = results.summary(run, False) | {"balance": found.content()}
    measured = {"hit": {"rms": 1e-3, "peak": 1e-3, "impulse": 1e-3}}
    accuracy = {"asked": 0.01, "measured": measured, "agree_until": float("nan"), "differs": None}
    good = page.verdict(run, base | {"accuracy": accuracy})
    assert (good.kind, good.word) == (GOOD, "Finished")
    top = pictures.peaks(run)["hit"]
    assert top.force == float(run.extremes["hit"].peak) and top.time == float(run.extremes["hit"].peak_time)
    apart = page.verdict(run, base | {"accuracy": accuracy | {"agree_until": 0.012, "differs": "hit"}})
    assert apart.kind == FAIR and "12 ms" in apart.word and "disagree from 12 ms on, in hit" in apart.sentence
    for wrong in (0.5, float("inf")):
        loose = {"accuracy": accuracy | {"measured": {"hit": {"rms": 1e-3, "peak": wrong, "impulse": None}}}}
        said = page.verdict(run, base | loose)
        assert said.kind == FAIR and "Finished" not in said.word
    other = page.verdict(run._replace(status="doubtful", reason="two runs differ"), base)
    assert other.kind == BAD and other.word == "Doubtful" and "two runs differ" in other.sentence
    split = Accuracy(0.01, 1e-5, 0.0, {"hit": 1.0}, {"hit": 1.0}, {"hit": 1.0}, 0.012, "hit", 0.0)
    assert "disagree from 12 ms on, in hit" in results.verdict(run._replace(accuracy=split))


def test_peaks_of_a_folder_are_those_of_the_run():
    run, _ = closure(balls())
    contacts = results.summary(run, False)["contacts"]
    again = folder._extremes({"hit": 0}, contacts)["hit"]
    assert (float(again.peak), float(again.peak_time)) == (contacts["hit"]["peak"], contacts["hit"]["peak_time"])
    shown = SimpleNamespace(times=run.times, force=run.force, extremes={"hit": again})
    assert pictures.peaks(shown) == pictures.peaks(run)
    del contacts["hit"]["peak_of_samples"]
    assert folder._extremes({"hit": 0}, contacts) == {}
