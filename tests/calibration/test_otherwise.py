"""Records that are no impact: a slow test is proposed as one, all else is refused with the way to a fit."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from bcfj_jax import InputError, reading_history, scenes, simulate
from bcfj_jax.data import clock
from benchmarks.calibration import instruments
from calibration import fit, init, load
from calibration.problemfile import prepared

RNG = np.random.default_rng(5)


def write(path, columns):
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


def press(path, restitution):
    """A triangle of 0.5 mm in 2 s onto a pad of 2e5 N/m touched at 0.1 mm; unloading is steeper by 1/e^2 (Walton, Braun)."""
    times = np.linspace(0.0, 2.0, 201)
    places = 5e-4 * np.minimum(times, 2.0 - times)
    depth, deepest = places - 1e-4, 4e-4
    loaded = 2e5 * np.maximum(depth, 0.0)
    back = np.maximum(2e5 * (deepest - (deepest - depth) / restitution**2), 0.0)
    force = np.where(times < 1.0, loaded, np.minimum(loaded, back)) + 0.5 * RNG.standard_normal(times.size)
    return write(path, {"time [s]": times, "displacement [mm]": 1e3 * places, "force [N]": force})


@pytest.mark.parametrize(("restitution", "shape"), [(0.7, "restitution"), (1.0, "exponent")])
def test_a_slow_test_is_proposed_with_its_driven_scene(restitution, shape, tmp_path):
    said = []
    init.run(press(tmp_path / "pad.csv", restitution), tmp_path / "pad.toml", init.Said(), said.append)
    assert "force and displacement are those of a slow test, no impact; --scene impact takes one all the same" in said
    found = load(tmp_path / "pad.toml")
    assert [f.name for f in found.free] == ["stiffness", shape, "clearance_contact"]
    assert (tmp_path / "pad_scene.toml").exists()
    # With --scene it is what the user says.
    init.run(tmp_path / "pad.csv", tmp_path / "hit.toml", init.Said("impact", "1 kg"), said.append)
    assert 'scene = "impact"' in (tmp_path / "hit.toml").read_text()


@pytest.mark.slow
def test_a_loop_of_loading_and_unloading_is_identified(tmp_path):
    init.run(press(tmp_path / "pad.csv", 0.7), tmp_path / "pad.toml", init.Said(), lambda line: None)
    found = fit(load(tmp_path / "pad.toml"))
    assert found.verdict == "identified", found.reasons
    for name, true in (("stiffness", 2e5), ("restitution", 0.7), ("clearance_contact", 1e-4)):
        low, high = found.parameters[name].ci95 or (np.nan, np.nan)
        assert low < true < high and high - low < 0.1 * true, name


def test_nothing_is_overwritten_and_nothing_half_written(tmp_path):
    path = press(tmp_path / "pad.csv", 0.7)
    (tmp_path / "pad.toml").write_text("mine")
    with pytest.raises(InputError, match="nothing is overwritten"):
        init.run(path, tmp_path / "pad.toml", init.Said(), lambda line: None)
    assert (tmp_path / "pad.toml").read_text() == "mine" and not (tmp_path / "pad_scene.toml").exists()


TIMES = np.linspace(0.0, 3.0, 301)
SPEED = 0.03 * np.cos(6 * TIMES)
BRAKE = 20.0 * SPEED / np.hypot(SPEED, 1e-3)  # of 20 N, which fades below 1 mm/s (Coulomb)


def brake(path, sign, by):
    """A brake that is driven to and fro by a sine, its force read with either sign, its place or its speed beside."""
    moved = {"displacement [mm]": 5.0 * np.sin(6 * TIMES)} if by == "place" else {"velocity [m/s]": SPEED}
    force = sign * BRAKE + 0.2 * np.random.default_rng(1).standard_normal(TIMES.size)
    return write(path, {"time [s]": TIMES, **moved, "force [N]": force})


@pytest.mark.parametrize(("sign", "by"), [(1.0, "place"), (-1.0, "place"), (1.0, "speed"), (-1.0, "speed")])
def test_a_brake_is_proposed_as_friction_of_a_driven_body(sign, by, tmp_path):
    """The sign of its column is that of the scene's friction, whichever way displacement and force are read."""
    init.run(brake(tmp_path / "brake.csv", sign, by), tmp_path / "brake.toml", init.Said(), lambda line: None)
    found = load(tmp_path / "brake.toml")
    ((channel,),) = (one.channels for one in found.experiments)
    assert channel.observes == "friction.drive"
    scene, (one,) = found.scene, found.experiments
    run = simulate(scene, scene.parameters(), one.times, read=["friction.drive"])
    assert np.corrcoef(channel.values, run.readings["friction.drive"])[0, 1] > 0.99
    assert [f.name for f in found.free] == ["friction.sliding", "friction.speed"]


@pytest.mark.parametrize("turns", [6.0, 400.0])
def test_a_driven_body_follows_the_places_between_the_rows_of_its_table(turns, tmp_path):
    """Of 60 cycles 300 rows are five a cycle, which would be another motion."""
    clock = np.linspace(0.0, 1.0, 6001)
    place, speed = 5.0 * np.sin(turns * clock), np.cos(turns * clock)
    columns = {"time [s]": clock, "displacement [mm]": place, "force [N]": 20.0 * speed / np.hypot(speed, 0.1)}
    init.run(write(tmp_path / "a.csv", columns), tmp_path / "a.toml", init.Said(), lambda line: None)
    text = re.search(r"table = (\[\[.*?\]\])", (tmp_path / "a_scene.toml").read_text())
    times, places = np.array(json.loads(text[1])) if text else np.zeros((2, 2))
    assert np.abs(1e3 * np.interp(clock, times, places) - place + place[0]).max() < 0.03
    assert times.size == 300 if turns == 6.0 else times.size > 300


@pytest.mark.parametrize(
    ("force", "rubs"),
    [
        (lambda x: 4.4 * (x > 0.0) + 1.6 * ((x > 0.0) & (x < 0.2)), True),  # A sled that breaks away and goes on.
        (lambda x: 4.4 * (x > 0.0) + 0.02 * x, True),
        (
            lambda x: 3.0 * np.maximum(x - 2.0, 0.0),
            False,
        ),  # Pressed: in proportion to the depth, less, or more than that.
        (lambda x: 3.0 * np.maximum(x - 2.0, 0.0) ** 1.5, False),
        (lambda x: np.minimum(3.0 * np.maximum(x - 2.0, 0.0), 9.0) + 1.0 * np.maximum(x - 5.0, 0.0), False),
    ],
)
def test_a_force_that_stays_as_the_body_goes_on_is_friction(force, rubs, tmp_path):
    clock = np.linspace(0.0, 6.0, 1501)
    place = 4.0 * np.maximum(clock - 1.0, 0.0)
    read = force(place) + 0.02 * np.random.default_rng(3).standard_normal(clock.size)
    path = write(tmp_path / "sled.csv", {"time [s]": clock, "way [mm]": place, "pull [N]": read})
    init.run(path, tmp_path / "sled.toml", init.Said(), lambda line: None)
    (one,) = load(tmp_path / "sled.toml").experiments
    assert one.channels[0].observes == ("friction.drive" if rubs else "contact.normal")


def test_a_pin_that_rubs_at_one_speed_is_no_impact(tmp_path):
    rng, clock = np.random.default_rng(5), np.linspace(0.0, 20.0, 1001)
    rubs = 3.0 + 1.2 * np.exp(-clock / 5.0) + 0.1 * rng.standard_normal(clock.size)
    columns = {"time [s]": clock, "speed [m/s]": 0.2 + 1e-3 * rng.standard_normal(clock.size), "Reibkraft [N]": rubs}
    path = write(tmp_path / "pin.csv", {**columns, "Normalkraft [N]": 10.0 + 0.0 * clock})
    init.run(path, tmp_path / "pin.toml", init.Said(), lambda line: None)
    assert load(tmp_path / "pin.toml").experiments[0].channels[0].observes == "friction.drive"


def test_friction_under_a_load_that_stays_is_read_and_not_the_load(tmp_path):
    load_ = 50.0 + 0.2 * np.random.default_rng(4).standard_normal(TIMES.size)
    moved = {"time [s]": TIMES, "position [mm]": 5.0 * np.sin(6 * TIMES)}
    path = write(tmp_path / "rig.csv", {**moved, "Fx Friction [N]": BRAKE, "Fz Load [N]": load_})
    init.run(path, tmp_path / "rig.toml", init.Said(), lambda line: None)
    (one,) = load(tmp_path / "rig.toml").experiments
    assert one.channels[0].observes == "friction.drive" and np.abs(one.channels[0].values).max() < 21.0


@pytest.mark.full
def test_a_brake_is_identified_as_proposed(tmp_path):
    init.run(brake(tmp_path / "brake.csv", 1.0, "place"), tmp_path / "brake.toml", init.Said(), lambda line: None)
    found = fit(load(tmp_path / "brake.toml"))
    assert found.verdict == "identified", found.reasons
    for name, true in (("friction.sliding", 20.0), ("friction.speed", 1e-3)):
        low, high = found.parameters[name].ci95 or (np.nan, np.nan)
        assert low < true < high and high - low < 0.3 * true, name


OTHERS = {
    "brake": (
        {"time [s]": TIMES, "force [N]": 20 * np.sign(np.cos(6 * TIMES))},
        r"the force pulls as it pushes.*drive = .*--scene impact",
    ),
    "spring": (
        {"time [s]": TIMES, "displacement [mm]": 5 * np.sin(6 * TIMES), "force [N]": 20 * np.sin(6 * TIMES)},
        r"the force pulls as it pushes.*drive = .*--scene impact",
    ),
    "curve": (
        {"displacement [mm]": TIMES, "force [N]": 10 * np.maximum(TIMES - 1, 0)},
        r"'force \[N\]' against 'displacement \[mm\]' is a curve without a time; add a column \"time \[s\]\"",
    ),
    "rebound": (
        {"drop height [mm]": 10 + TIMES, "rebound height [mm]": 6 + TIMES},
        r"'rebound height \[mm\]' is a result of each impact.*features = .*contact\.impulse.*problem_file.md#results",
    ),
    "restitution": (
        {"impact speed [m/s]": TIMES, "COR (-)": 0.9 - 0.05 * TIMES, "std COR": 0.01 + 0.0 * TIMES},
        r"'COR \(-\)' is a result of each impact.*features = ",
    ),
    "duration": (  # Its unit is that of a clock.
        {"Auftreffgeschwindigkeit [m/s]": TIMES, "Kontaktdauer [us]": 200.0 - TIMES},
        r"'Kontaktdauer \[us\]' is a result of each impact.*features = ",
    ),
    "pendulum": (
        {"time [s]": TIMES, "angle [mdeg]": 5e3 * np.abs(np.cos(6 * TIMES)), "rate [deg/s]": np.sin(6 * TIMES)},
        r"'angle \[mdeg\]' is of a body that turns.*hinge.*bodies-that-turn",
    ),
    "gear": ({"time [s]": TIMES, "shaft [rpm]": np.sin(6 * TIMES)}, r"'shaft \[rpm\]' is of a body that turns"),
    "torque": ({"time [s]": TIMES, "T [lbf-in]": np.sin(6 * TIMES)}, r"'T \[lbf-in\]' is a torque.*bodies-that-turn"),
    "table": (  # A slide with backlash, of which one side rings: no press.
        {
            "time [s]": TIMES, "set [mm]": 5 * np.sin(2 * TIMES),
            "force [N]": 20 * np.maximum(np.sin(2 * TIMES), 0) + 20 * np.minimum(np.sin(2 * TIMES) + 0.2, 0),
        },
        r"the force pulls as it pushes",
    ),
}  # fmt: skip


def steady(path, headers=("speed [mm/s]", "friction force [N]"), press=1.0):
    """Stribeck's curve by other code, 12 N + 8 N exp(-(v/20 mm/s)^2) + 15 N s/m v, without a clock."""
    speeds = np.geomspace(1e-4, 0.3, 60)
    force = (12.0 + 8.0 * np.exp(-((speeds / 0.02) ** 2)) + 15.0 * speeds) * (1.0 + 0.01 * RNG.standard_normal(60))
    columns = (1e3 * speeds, press * force, np.full(60, press) + 1e-9 * speeds)
    return write(path, dict(zip(headers, columns, strict=False)))


def test_friction_against_speed_is_proposed_without_a_clock(tmp_path):
    """As a driven scene and the rows as states; beside a normal force as a coefficient; with --scene it is refused."""
    said = []
    init.run(steady(tmp_path / "a.csv"), tmp_path / "a.toml", init.Said(), said.append)
    assert any("its rows are taken for steady states, the force is fitted" in line for line in said)
    found = load(tmp_path / "a.toml")
    assert [f.name for f in found.free] == ["friction.breakaway", "friction.sliding", "friction.speed", "oil.damping"]
    assert 'friction = "lugre"' in (tmp_path / "a_scene.toml").read_text()
    headers = ("slip speed [mm/s]", "friction force [N]", "normal force [N]")
    init.run(steady(tmp_path / "b.csv", headers, 50.0), tmp_path / "b.toml", init.Said(), said.append)
    assert np.median(load(tmp_path / "b.toml").experiments[0].channels[0].values) < 21.0
    slow = {"speed [m/s]": TIMES, "friction coefficient": 0.3 - 0.05 * TIMES}
    init.run(write(tmp_path / "c.csv", slow), tmp_path / "c.toml", init.Said(), said.append)
    assert (tmp_path / "c_states.csv").read_text().count("\n") == min(TIMES.size, 301)
    with pytest.raises(
        InputError, match=r"'friction force \[N\]' against 'speed \[mm/s\]' is a curve of steady states"
    ):
        init.run(tmp_path / "a.csv", tmp_path / "d.toml", init.Said("impact"), said.append)
    spread = {"speed [m/s]": TIMES, "Reibkraft [N]": 20.0 - TIMES, "Streuung [N]": 0.2 + 0.1 * TIMES}
    init.run(write(tmp_path / "f.csv", spread), tmp_path / "f.toml", init.Said(), said.append)
    assert load(tmp_path / "f.toml").experiments[0].channels[0].values[0] == pytest.approx(20.0 - TIMES[1], rel=1e-3)
    set_ = {"time [s]": TIMES, "Sollweg [mm]": 9.0 * np.sin(6 * TIMES), "Istweg [mm]": 5.0 * np.sin(6 * TIMES)}
    init.run(write(tmp_path / "g.csv", {**set_, "Kraft [N]": BRAKE}), tmp_path / "g.toml", init.Said(), said.append)
    drive = re.search(r"\], \[(.*?)\]\]", (tmp_path / "g_scene.toml").read_text())
    assert drive and np.ptp([float(x) for x in drive[1].split(",")]) == pytest.approx(0.01, rel=1e-2)
    few = {"speed [m/s]": TIMES[:4], "friction coefficient": TIMES[:4]}
    with pytest.raises(InputError, match="3 rows hold a speed above 0"):
        init.run(write(tmp_path / "e.csv", few), tmp_path / "e.toml", init.Said(), said.append)


@pytest.mark.slow
def test_friction_against_speed_is_identified_as_proposed(tmp_path):
    init.run(steady(tmp_path / "a.csv"), tmp_path / "a.toml", init.Said(), lambda line: None)
    found = fit(load(tmp_path / "a.toml"))
    assert found.verdict == "identified", found.reasons
    for name, true in zip(
        ("friction.breakaway", "friction.sliding", "friction.speed", "oil.damping"), (20, 12, 0.02, 15), strict=True
    ):
        low, high = found.parameters[name].ci95 or (np.nan, np.nan)
        assert low < true < high and high - low < 0.3 * true, name


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_no_impact_is_refused_with_the_way(name, tmp_path):
    columns, message = OTHERS[name]
    with pytest.raises(InputError, match=message):
        init.run(write(tmp_path / "a.csv", columns), tmp_path, init.Said(), lambda line: None)


@pytest.mark.parametrize("digits", [3, 4])
def test_a_clock_rounded_until_times_stand_twice_is_even_and_said(digits, tmp_path):
    rows = [f"{t:.{digits}f},{f:.3f}" for t, f in zip(instruments.CLOCK + 5e-3, instruments.FORCE, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["time [s],force [N]", *rows]) + "\n")
    init.run(tmp_path / "a.csv", tmp_path, init.Said("", "0.8 kg", "1.2 m/s"), lambda line: None)
    (one,) = prepared(tmp_path / "a.toml")
    assert f"times are rounded to {10.0**-digits:.3g} s" in "; ".join(one.notes)
    step = np.diff(one.times)
    assert step == pytest.approx(5e-5, rel=2e-3)


def test_times_that_stand_twice_for_another_reason_are_refused():
    even = 1e-3 * np.arange(100.0)
    for wrong in (np.sort(np.r_[even, even[40]]), np.sort(np.r_[even[:50], even[:50] + 0.01]), even):
        assert clock.evened(wrong)[1] == ""


def test_a_place_from_first_touch_on_keeps_its_whole_contact(tmp_path):
    """A contact of 240 us read as a place alone, which begins in it: the window holds all of it, the clock's bounds its touch."""
    law = {"stiffness": 1e9, "exponent": 1.5, "damping": 0.03, "mass": 0.1, "approach_speed": 4.2}
    times, scene = 3e-6 * np.arange(100), scenes.impact()
    places = reading_history(scene, scene.parameters(**law), times, ["body.place.x"])["body.place.x"]
    places = 1e3 * (np.asarray(places) + 2e-7 * RNG.standard_normal(times.size))
    path = write(tmp_path / "a.csv", {"time [us]": 1e6 * times, "position [mm]": places})
    init.run(path, tmp_path / "a.toml", init.Said(mass="0.1 kg", speed="4.2 m/s"), lambda line: None)
    (one,) = prepared(tmp_path / "a.toml")
    assert one.times.size == times.size
    # Touch is at the record's first sample.
    (experiment,) = load(tmp_path / "a.toml").experiments
    low, high = experiment.bounds["time_offset"]
    assert low < one.times[0] < high
    assert {f.name: f.lower < law[f.name] < f.upper for f in load(tmp_path / "a.toml").free if f.name in law} == {
        "stiffness": True, "exponent": True, "damping": True,
    }  # fmt: skip
