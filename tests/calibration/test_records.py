"""Records as they come: baseline, clock, few samples, motion instead of force; and what they leave open of the scale.

The records are SciPy's, of F = K d^n (1 + a d') without regularisation.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bcfj_jax import InputError
from calibration import fit, load
from calibration.impacts.events import contacts, rest
from calibration.impacts.inspection import check_channel
from calibration.problemfile import prepared

pytestmark = pytest.mark.filterwarnings("error")

STIFFNESS, EXPONENT, DAMPING = 9e4, 1.3, 0.15
MASS, SPEED, TOUCH = 0.4, 1.2, 21.3e-3
TRUTH = {"stiffness": STIFFNESS, "exponent": EXPONENT, "damping": DAMPING}
LAW = """[free]
stiffness = { lower = 1e3, upper = 1e7 }
exponent = { lower = 1.0, upper = 2.5 }
damping = { lower = 0.01, upper = 3 }
"""
FORCE = '"contact.normal" = "force [N]"'
ACCELERATION = '"body.acceleration.x" = "-acceleration [m/s^2]"'
POSITION = '"body.place.x" = "position [mm]"'
VELOCITY = '"body.velocity.x" = "velocity [m/s]"'
KNOWN = 'mass = "0.4 kg", approach_speed = "1.2 m/s"'


def law(depth: np.ndarray, rate: np.ndarray) -> np.ndarray:
    return np.where(depth > 0, STIFFNESS * np.maximum(depth, 0.0) ** EXPONENT * (1.0 + DAMPING * rate), 0.0)


def impact(times: np.ndarray, speed: float = SPEED) -> tuple[np.ndarray, ...]:
    """Position, velocity, acceleration and force (T,), contact from time 0 on."""
    run = solve_ivp(
        lambda t, y: [y[1], -float(law(y[0], y[1])) / MASS], (0.0, max(times[-1], 1e-3)), [0.0, speed], "DOP853",
        dense_output=True, rtol=1e-10, atol=1e-13, max_step=5e-4,
    )  # fmt: skip
    later = run.sol(np.maximum(times, 0.0))
    place, rate = (np.where(times > 0, a, b) for a, b in zip(later, (speed * times, speed), strict=True))
    force = law(place, rate)
    return place, rate, -force / MASS, force


def table(path: str, columns: dict[str, np.ndarray]) -> None:
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def drop(path: str = "drop.csv", step: float = 2.5e-4, end: float = 0.06, clock: float = 0.0) -> None:
    """A drop as a rig writes it: every sensor with a zero of its own, 1 % noise, the accelerometer turned round."""
    times, rng = np.arange(0.0, end, step), np.random.default_rng(1)
    place, rate, acceleration, force = impact(times - TOUCH)
    noisy = lambda x, share: x + share * np.ptp(x) * rng.standard_normal(x.size)  # noqa: E731
    table(path, {
        "time [s]": times + clock, "force [N]": noisy(force, 0.01) + 2.0, "position [mm]": 1e3 * noisy(place, 0.002) + 350.0,
        "velocity [m/s]": noisy(rate, 0.002), "acceleration [m/s^2]": 1.0 - noisy(acceleration, 0.01),
    })  # fmt: skip


def problem(
    observe: str, known: str = KNOWN, free: str = LAW, top: str = "", entry: str = "", file: str = "drop.csv"
) -> Path:
    text = f'scene = "impact"\n{top}\n[[experiment]]\nfile = "{file}"\ntime = "time [s]"\nobserve = {{ {observe} }}\n{entry}\n'
    Path("r.toml").write_text(f"{text}parameters = {{ {known} }}\n{free}")
    return Path("r.toml")


def holds(found, names=("stiffness", "exponent", "damping")) -> None:
    """Intervals of 95 %, three at a time: within 1.6 of their half-widths of the truth."""
    for name in names:
        low, high = np.log(found.parameters[name].intervals["noise"])
        assert abs(np.log(TRUTH[name]) - 0.5 * (low + high)) < 0.8 * (high - low), name


@pytest.fixture
def rig(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drop()


def test_clock_and_zero_are_free_within_bounds_of_each_record(rig):
    drop("late.csv", clock=100.0)
    more = (
        f'[[experiment]]\nfile = "late.csv"\ntime = "time [s]"\nobserve = {{ {FORCE} }}\nparameters = {{ {KNOWN} }}\n'
    )
    path = problem(FORCE, free=more + LAW)
    found = load(path)
    assert [f.name for f in found.free] == ["stiffness", "exponent", "damping", "time_offset", "force_offset"]
    for e, clock in zip(found.experiments, (0.0, 100.0), strict=True):
        (lower, upper), (low, high) = e.bounds["time_offset"], e.bounds["force_offset"]
        assert lower < clock + TOUCH < upper and upper - lower < 7e-3
        assert low < 2.0 < high
    assert "time_offset is free from" in prepared(path)[1].notes[-2]
    assert [f.name for f in load(problem(FORCE, top='sensor = "exact"')).free] == ["stiffness", "exponent", "damping"]


def test_what_the_file_says_of_a_sensor_holds(rig):
    own = load(problem(FORCE, free=LAW + 'time_offset = { lower = "20 ms", upper = "22 ms" }\nforce_offset = {}\n'))
    assert list(own.experiments[0].bounds) == ["force_offset"]
    here = load(problem(FORCE, entry='bounds = { time_offset = ["20 ms", "22 ms"] }'))
    assert here.experiments[0].bounds["time_offset"] == (0.02, 0.022)
    known = load(problem(FORCE, known=f'{KNOWN}, time_offset = "21.3 ms", force_offset = "2 N"'))
    assert [f.name for f in known.free] == ["stiffness", "exponent", "damping"]
    gap = load(problem(FORCE, free=LAW + 'clearance_contact = { lower = "1 mm", upper = "50 mm" }\n'))
    assert "time_offset" not in {f.name for f in gap.free}
    assert any("clearance_contact is free and moves" in note for note in prepared("r.toml")[0].notes)


@pytest.mark.parametrize(
    ("entry", "free", "words"),
    [
        ('bounds = { stiffness = [1e4, 1e5] }', "", "'stiffness' is not free with a value of its own.*time_offset"),
        ('bounds = { time_offset = ["1 ms"] }', "", "bounds.time_offset.*give .lower, upper."),
        ('bounds = { time_ofset = ["1 ms", "2 ms"] }', "", "no parameter 'time_ofset'.*time_offset"),
        ('bounds = { time_offset = ["3 ms", "2 ms"] }', "", "0.003 is not below 0.002"),
        ("", "gain = {}\n", "no bounds, and none can be proposed for drop: a record does not give a gain"),
        ("", "velocity_offset = {}\n", "no channel that a velocity_offset acts on"),
        ("", 'time_offset = { lower = "1 ms" }\n', "the key 'upper' is missing"),
    ],
)  # fmt: skip
def test_bounds_that_are_not_right_are_named(entry, free, words, rig):
    with pytest.raises(InputError, match=words):
        load(problem(FORCE, entry=entry, free=LAW + free))


def test_events_of_every_kind_of_reading():
    times = np.arange(0.0, 0.06, 2.5e-4)
    place, rate, acceleration, force = impact(times - TOUCH)
    for name, values in (
        ("contact.normal", force + 2.0),
        ("body.acceleration.x", acceleration),
        ("contact.axial", -force),
    ):
        (one,) = contacts(name, times, values)
        assert one.before - 1e-3 < TOUCH < one.begin and 13e-3 < one.duration < 15e-3, name
    for name, values in (("body.velocity.x", rate), ("body.place.x", place + 0.35)):
        (one,) = contacts(name, times, values)
        assert TOUCH < one.begin < TOUCH + 8e-3, name
    assert rest(np.array([3.0, 3.0, 3.1, 5.0, 9.0, 8.0, 3.0, 3.1])) == pytest.approx(3.0, abs=0.1)
    assert rest(force[100:150]) is None


def test_a_loaded_force_that_swings_has_no_rest_where_it_turns():
    """Samples lie close together at a turning point; read as the rest, a pushing force would look like a pulling one."""
    swing = 9500.0 + 1500.0 * np.cos(2.0 * np.pi * np.arange(41) / 6.7)
    assert rest(swing) is None
    check_channel("head_cage.normal", swing, np.zeros(41, dtype=bool), rest(swing) or 0.0, "head")


@pytest.mark.parametrize(
    "observe",
    [
        pytest.param(FORCE, marks=pytest.mark.slow),
        pytest.param(ACCELERATION, marks=pytest.mark.slow),
        pytest.param(f"{FORCE}, {POSITION}", marks=pytest.mark.slow),
    ],
    ids=["force", "acceleration", "both"],
)
def test_a_drop_is_fitted_by_whatever_was_read(observe, rig):
    """The zero of each sensor and the clock are found with the law."""
    found = fit(load(problem(observe)), starts=4)
    assert found.verdict == "identified", found.reasons
    holds(found)
    assert found.parameters["time_offset"].value == pytest.approx(TOUCH, abs=2e-4)
    zeros = {"force_offset": 2.0, "acceleration_offset": -1.0, "position_offset": 0.35}
    for name in {"force_offset", "acceleration_offset", "position_offset"} & found.parameters.keys():
        low, high = found.parameters[name].intervals["noise"]
        assert abs(zeros[name] - 0.5 * (low + high)) < 0.8 * (high - low), name


@pytest.mark.slow
@pytest.mark.parametrize("observe", [pytest.param(POSITION, id="position"), pytest.param(VELOCITY, id="velocity")])
def test_motion_alone_says_what_it_leaves_open(observe, rig):
    """A position before contact goes on as it came: its line is fitted, too."""
    found = fit(load(problem(observe, free=LAW.replace("exponent = { lower = 1.0, upper = 2.5 }\n", ""),
                             known=f"{KNOWN}, exponent = {EXPONENT}")), starts=4)  # fmt: skip
    assert found.verdict == "identified", found.reasons
    holds(found, ("stiffness", "damping"))
    assert any("only for the mass given" in note and "read a force as well" in note for note in found.notes)


@pytest.mark.slow
@pytest.mark.parametrize("runs", [pytest.param(1, marks=pytest.mark.full), pytest.param(3, marks=pytest.mark.slow)])
def test_five_samples_a_contact_are_fitted(runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng, parts = np.random.default_rng(4), []
    for k in range(runs):
        times = (np.arange(18) - 6.0 + rng.uniform()) * 2.4e-3
        force = impact(times, SPEED * (1.0 + 0.1 * k))[3]
        assert 4 <= np.count_nonzero(force > 0.1 * force.max()) <= 6
        parts.append(np.stack([np.full(18, k + 1.0), times + 5.0 + k, force + 2.0 + 1.0 * rng.standard_normal(18)]))
    rows = np.concatenate(parts, axis=1)
    table("few.csv", dict(zip(("run", "time [s]", "force [N]"), rows, strict=True)))
    speed = 'approach_speed = { lower = "0.5 m/s", upper = "3 m/s", each = true }\n'
    found = fit(load(problem(FORCE, 'mass = "0.4 kg"', LAW + speed, file="few.csv")))
    assert found.search.answer == "converged" and found.law.answer == "consistent", found.reasons
    assert found.verdict in ("identified", "not_identified")
    if found.verdict == "identified":
        holds(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("observe", "known", "free", "words"),
    [
        pytest.param(FORCE, KNOWN, "",
                     ["only for the mass and the approach_speed given", "approach_speed by -1 % gives the same readings",
                      "damping by +1 %", "weigh the mass and measure the speed"], marks=pytest.mark.slow),
        pytest.param(FORCE, 'mass = "0.4 kg"', 'approach_speed = { lower = 0.3, upper = 4 }\n',
                     ["only for the mass given", "approach_speed by -1 %"], marks=pytest.mark.slow),
        (FORCE, "", 'approach_speed = { lower = 0.3, upper = 4 }\nmass = { lower = 0.1, upper = 2 }\n',
         ["only the product of", "is determined", "or weigh the mass", "read a position, velocity or acceleration"]),
        pytest.param(ACCELERATION, KNOWN, "",
                     ["accelerations alone", "1 % of mass moves stiffness by +1 %", "read a force as well"],
                     marks=pytest.mark.slow),
        pytest.param(f"{FORCE}, {POSITION}", KNOWN, "", [], marks=pytest.mark.slow),
    ],
    ids=["both fixed", "speed free", "both free", "acceleration", "force and position"],
)  # fmt: skip
def test_a_scale_that_no_channel_shows_is_said_before_the_fit(observe, known, free, words, rig, monkeypatch, caplog):
    class Stop(Exception):
        pass

    def stop(*_: object) -> None:
        raise Stop

    monkeypatch.setattr(sys.modules["calibration.fit"], "search", stop)
    caplog.set_level(logging.INFO, "calibration")
    with pytest.raises(Stop):
        fit(load(problem(observe, known, LAW + free)), starts=4)
    said = "".join(r.getMessage() for r in caplog.records if "before the fit" in r.getMessage())
    assert bool(said) == bool(words), said
    for word in words:
        assert word in said
