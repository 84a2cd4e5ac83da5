"""Contacts of a drop one by one: what flights and impulses say, and the law with a filter, against drops made by SciPy."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import butter, sosfilt

from bcfj_jax import InputError, scenes
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.command import as_json, text
from calibration.impacts.events import contacts
from calibration.impacts.flights import passages
from calibration.selection.apart import _known, _passages, rows, single_impacts, with_contacts_apart

G, FINE = 9.80665, 2e-5


class Drop(NamedTuple):
    """A drop whose force is K d^n + C d^q d', read through a Butterworth low-pass of some order; 1 kHz or so."""

    stiffness: float = 6.5e5
    exponent: float = 1.5
    loss: float = 170.0
    power: float = 0.5
    mass: float = 0.15
    speed: float = 3.1
    cutoff: float = 400.0
    order: int = 2
    rate: float = 1000.0
    noise: float = 0.7
    seed: int = 0
    offset: float = 1.6
    drift: float = 0.4

    def read(self) -> tuple[np.ndarray, np.ndarray, list[float], list[float]]:
        """Times and readings of six contacts, and the speeds before and after each."""

        def force(d: np.ndarray, v: np.ndarray) -> np.ndarray:
            d = np.maximum(d, 0.0)
            return np.maximum(self.stiffness * d**self.exponent + self.loss * d**self.power * v, 0.0) * (d > 0.0)

        def slope(_: float, y: np.ndarray) -> list[float]:
            return [y[1], G - float(force(y[0], y[1])) / self.mass]

        def parted(_: float, y: np.ndarray) -> float:
            return y[0]

        parted.terminal, parted.direction = True, -1.0
        begin, speed, pieces, before, after = 0.3, self.speed, [], [], []
        for _ in range(6):
            one = solve_ivp(
                slope, (0.0, 0.1), [0.0, speed], events=parted, rtol=1e-9, atol=1e-12, dense_output=True, max_step=1e-4
            )
            pieces.append((begin, one.t[-1], one.sol))
            before.append(speed)
            speed = -float(one.y[1, -1])
            after.append(speed)
            begin += one.t[-1] + 2.0 * speed / G
        fine = np.arange(0.0, begin, FINE)
        pushed = np.zeros(fine.size)
        for start, lasts, path in pieces:
            inside = (fine > start) & (fine < start + lasts)
            pushed[inside] = force(*path(fine[inside] - start))
        pushed = (
            sosfilt(butter(self.order, self.cutoff, fs=1.0 / FINE, output="sos"), pushed) if self.cutoff else pushed
        )
        every = round(1.0 / self.rate / FINE)
        draws = np.random.default_rng(self.seed).standard_normal(fine[::every].size)
        read = pushed[::every] + self.offset + self.drift * fine[::every] + self.noise * draws
        return fine[::every], read, before, after

    def problem(self, **more) -> Problem:
        """As ``bcfj init calibration`` proposes it: mass, height and clock free; the loss is a damping's."""
        times, read, before, _ = self.read()
        scene = scenes.bounce()
        speed = 1.0 / before[0]
        free = (
            Free("stiffness", 1e3, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 0.003 * speed, 5.0 * speed),
            Free("mass", 0.5 * self.mass, 2.0 * self.mass), Free("drop_height", 0.2, 1.0), Free("time_offset", -0.1, 0.1),
        )  # fmt: skip
        run = Experiment("ball", times, (Channel("contact.normal", read, None),))
        params = {name: float(x) for name, x in scene.parameters({"gravity": G}).items()}
        return Problem(scene, params, (run,), free, **more)


@pytest.mark.parametrize("cutoff", [0.0, 200.0, 400.0, 2000.0])
@pytest.mark.parametrize("power", [0.25, 0.5, 1.5])
def test_flights_and_impulses_tell_speed_restitution_and_mass_behind_any_filter(cutoff, power):
    drop = Drop(cutoff=cutoff, power=power, loss=170.0 * 5e-3 ** (0.5 - power), mass=0.15, seed=int(cutoff))
    times, read, before, after = drop.read()
    found = passages(times, read, contacts("contact.normal", times, read))
    assert len(found) == 4
    for one, v, left in zip(found, before[1:-1], after[1:-1], strict=True):
        # Ends of a contact are known to a sample.
        assert one.speed == pytest.approx(v, abs=G / drop.rate)
        assert one.kept == pytest.approx(left / v, abs=2.0 * G / drop.rate / v)
        assert one.mass == pytest.approx(drop.mass, rel=0.015)
        # The change of momentum, and that of the weight while it lasts.
        assert one.impulse == pytest.approx(drop.mass * (v + left + G * one.duration), rel=0.015)
    known = _known(drop.problem(), found)
    low, high = known["mass"].ci95
    assert low < drop.mass * 1.005 and high > drop.mass * 0.995 and high < 1.02 * low


def test_contacts_without_flights_beside_them_are_left_out():
    times, read, *_ = Drop().read()
    events = contacts("contact.normal", times, read)
    assert passages(times, read, events[:2]) == []
    # Flights no longer than contacts tell no rest.
    first, spaced = events[0], 3.0 * events[0].duration
    closer = [first._replace(begin=first.begin + k * spaced, end=first.end + k * spaced) for k in range(5)]
    assert passages(times, read, closer) == []


def test_the_contacts_become_impacts_that_lose_what_flights_say():
    problem = Drop().problem()
    single = single_impacts(problem, _passages(problem))
    free = {f.name: f for f in single.free}
    assert set(free) == {"stiffness", "exponent", "time_offset"}
    assert not free["stiffness"].per_experiment and len(single.experiments) == 4 and single.filter == problem.filter
    for e in single.experiments:
        assert e.fixed["mass"] == pytest.approx(0.15, rel=0.01) and 0 < e.tolerances["approach_speed"] < 0.02
        assert 0.8 < e.fixed["restitution"] < 0.9 and 0 < e.tolerances["restitution"] < 0.01
    # A mass that is stated is kept.
    stated = Problem(
        problem.scene, problem.params | {"mass": 0.16}, problem.experiments,
        tuple(f for f in problem.free if f.name != "mass"),
    )  # fmt: skip
    assert all("mass" not in e.fixed for e in single_impacts(stated, _passages(stated)).experiments)
    assert single_impacts(stated, _passages(stated)).params["mass"] == 0.16


def refused(*_, **__):
    raise InputError("problem", "cannot be fitted", "give other data")


@pytest.mark.slow
def test_a_fit_that_knows_nothing_says_what_its_contacts_do(monkeypatch):
    """Of a fit that failed, with that of its contacts."""
    drop = Drop(cutoff=0.0, seed=3, power=1.5, loss=3e4, rate=4000.0)
    problem = drop.problem(filter="none")
    one = fit(single_impacts(problem, _passages(problem)), starts=4)
    low, high = one.parameters["stiffness"].with_budget
    assert one.verdict in ("identified", "adequate") and low < drop.stiffness < high
    bare = {name: replace(one.parameters[name], ci95=None, intervals={}) for name in ("stiffness", "exponent")}
    failed = replace(one, verdict="not_converged", parameters={**bare, "mass": bare["stiffness"]}, conditional=None)
    monkeypatch.setattr("calibration.selection.supposed.fit", lambda *_, **__: one)
    found = with_contacts_apart(problem, failed)
    assert found.verdict == "not_converged" and found.parameters == failed.parameters
    given = found.conditional.parameters
    assert given["stiffness"].ci95 == one.parameters["stiffness"].ci95 and not any("[" in name for name in given)
    low, high = given["mass"].with_budget
    assert low < drop.mass < high and given["mass"].headline == "flights"
    printed = text(found)
    assert "if bodies fall freely between contacts and each contact loses" in printed and "; exponent 1." in printed
    assert [row[0] for row in rows(found)] == ["record", *["ball"] * 4]
    assert len(as_json(found)["check"]["flights"]) == 4
    # Where the contacts cannot be fitted the mass is still known; a fit that stands is left alone.
    monkeypatch.setattr("calibration.selection.supposed.fit", refused)
    alone = with_contacts_apart(problem, failed).conditional
    assert alone.condition == "bodies fall freely between contacts" and set(alone.parameters) == {"mass"}
    stands = with_contacts_apart(problem, one)
    assert stands.parameters == one.parameters and stands.conditional is None and rows(stands) == []


@pytest.mark.slow
def test_a_drop_behind_a_filter_with_another_loss_is_not_left_without_an_answer():
    drop = Drop(seed=7)
    problem = drop.problem()
    found = with_contacts_apart(problem, fit(problem, starts=6))
    assert found.verdict not in ("identified", "adequate") and "filter" in " ".join(found.reasons)
    for name, true in {"mass": drop.mass, "stiffness": drop.stiffness, "exponent": drop.exponent}.items():
        low, high = found.conditional.parameters[name].with_budget
        assert low < true < high


SEEN = [
    Drop(seed=1),
    Drop(seed=2, cutoff=300.0, order=1, power=0.25, loss=40.0),
    Drop(seed=3, cutoff=500.0, order=4, power=1.5, loss=3e4),
    Drop(seed=4, cutoff=350.0, order=2, stiffness=3e5, exponent=1.3, mass=0.3, loss=150.0),
    Drop(seed=5, cutoff=600.0, rate=2000.0, stiffness=2e6, exponent=1.7, mass=0.2, loss=170.0),
    Drop(seed=6, cutoff=250.0, order=8, power=0.5, speed=2.5),
]


@pytest.mark.slow
@pytest.mark.parametrize("drop", SEEN, ids=lambda d: f"{d.cutoff:g} Hz of order {d.order}, d^{d.power:g}")
def test_a_filter_and_another_loss_leave_the_law_in_its_interval(drop):
    problem = drop.problem()
    found = fit(single_impacts(problem, _passages(problem)), starts=4)
    given = found.conditional.parameters if found.conditional else found.parameters
    for name in ("stiffness", "exponent"):
        ends = given[name].ci95
        assert ends is None or ends[0] < getattr(drop, name) < ends[1], (name, ends)
    # A filter slower than the contact's third harmonic is told, or no interval is given without saying so.
    assert found.verdict != "identified"
    assert "filter" in " ".join(found.reasons)
