"""Records of motion alone: what falls, what bounces on a slope, what is struck, and what holds no contact to be fitted."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from bcfj_jax import InputError
from bcfj_jax.data.reading import read
from calibration import init, load
from calibration.impacts.events import even_pull, falls
from calibration.impacts.proposal import understood

RNG = np.random.default_rng(11)
CLOCK = np.arange(0.0, 1.0, 5e-3)


def write(path, columns):
    rows = [",".join(f"{v:.12g}" for v in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


def propose(path, columns, said=None):
    init.run(write(path, columns), path.with_suffix(".toml"), said or init.Said(), lambda line: None)
    return load(path.with_suffix(".toml"))


def bounces(clock, pull, height, kept):
    """Heights of a ball that falls by ``pull`` and leaves at ``kept`` of its speed at once; closed form."""
    places, begin, speed = np.zeros(clock.size), -np.sqrt(2.0 * height / pull), np.sqrt(2.0 * height * pull)
    while begin < clock[-1]:
        inside = (clock >= begin) & (clock < begin + 2.0 * speed / pull)
        t = clock[inside] - begin
        places[inside] = speed * t - 0.5 * pull * t**2
        begin, speed = begin + 2.0 * speed / pull, kept * speed
    return places


@pytest.mark.parametrize("height", [0.012, 0.4])
def test_bounces_low_and_high_fall(height):
    clock = np.arange(0.0, 12.0 * np.sqrt(height / 9.81), 5e-4)
    heights = bounces(clock, 9.81, height, 0.8) + 4e-6 * RNG.standard_normal(clock.size)
    assert falls(clock, 1e3 * heights) == 1e-3
    assert falls(clock, -heights) == -1.0


def test_bounces_on_a_slope_have_its_gravity(tmp_path):
    """Of a cart with columns for place, velocity and a derived acceleration; a cart that rolls down alone bounces not."""
    clock = np.arange(0.0, 6.0, 0.02)
    places = bounces(clock, 0.5, 0.6, 0.8) + 2e-4 * RNG.standard_normal(clock.size)
    speeds = np.gradient(places, clock)
    columns = {"t [s]": clock, "X [m]": 1.3 - places, "v [m/s]": -speeds, "a [m/s²]": -np.gradient(speeds, clock)}
    (one,) = propose(tmp_path / "slope.csv", columns, init.Said(mass="0.5 kg")).experiments
    assert [c.observes for c in one.channels] == ["body.place.y"]
    free = {f.name: f for f in load(tmp_path / "slope.toml").free}
    assert free["drop_height"].lower < 0.6 < free["drop_height"].upper < 2.0
    (gravity,) = re.findall(r'gravity = "(\S+) m/s\^2 \+- 1 %"', (tmp_path / "slope.toml").read_text())
    assert float(gravity) == pytest.approx(0.5, rel=0.05)
    assert even_pull(clock, {"m": places}) == pytest.approx(0.5, rel=0.05)
    assert even_pull(clock, {"m": 0.25 * clock**2}) == even_pull(clock, {"m": bounces(clock, 9.81, 4.0, 0.9)}) == 0.0


OTHERS = {
    "turns between samples": (
        {"time [s]": CLOCK, "x [cm]": 100.0 * np.where(CLOCK < 0.5, 0.5 - CLOCK, 0.6 * (CLOCK - 0.5))},
        r"turns between two samples: .* 1 m/s before and 600 mm/s after, a restitution of 0\.6, but",
    ),
    "slides to rest": (
        {"time [s]": CLOCK, "speed [m/s]": np.maximum(1.6 - 2.0 * CLOCK, 0.0)},
        r"changes its speed.*a-body-that-slides-to-rest",
    ),
    "is struck": (
        {"time [s]": CLOCK / 50, "v [m/s]": 0.2 * np.clip(CLOCK - 0.4, 0.0, 0.1)},
        r"begins at rest, as of a body that is struck.*--mass .*--struck-mass",
    ),
    "two bodies": (
        {
            "time [s]": CLOCK / 50, "Hammer [m/s²]": -400.0 * np.exp(-(((CLOCK - 0.4) / 0.05) ** 2)),
            "Amboss [m/s²]": 50.0 * np.exp(-(((CLOCK - 0.4) / 0.05) ** 2)),
        },
        r"'Hammer \[m/s²\]' and 'Amboss \[m/s²\]' are of two bodies.*--struck-mass",
    ),
    "marks": (
        {"time [s]": CLOCK} | {
            f"Cube:{m} Z [mm]": 1e3 * bounces(CLOCK, 9.81, 0.3, 0.7) + 30.0 * np.sin(5.0 * CLOCK + k)
            for k, m in enumerate("ABC")
        },
        r"places of 3 marks on a body that turns.*q0 to q3.*of a ball one mark",
    ),
    "speeds": (
        {"v vorher [m/s]": 0.5 + CLOCK[:8], "v nachher [m/s]": 0.4 + CLOCK[:8]},
        r"'v nachher \[m/s\]' is a result of each impact.*features = ",
    ),
    "duration": (
        {"v [m/s]": 0.5 + CLOCK[:8], "Tc [us]": 70.0 - CLOCK[:8]},
        r"'Tc \[us\]' is a result of each impact.*features = ",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_what_holds_no_contact_is_refused_with_the_way(name, tmp_path):
    columns, message = OTHERS[name]
    with pytest.raises(InputError, match=message):
        propose(tmp_path / "a.csv", columns)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_velocity_of_the_struck_body_is_read_as_one(sign, tmp_path):
    """0.3 kg at 1 m/s with e = 0.7 moves 2 kg at 1.7 * 0.3/2.3 = 0.22 m/s."""
    speeds = 1.7 * 0.3 / 2.3 * np.clip((CLOCK - 0.4) / 0.1, 0.0, 1.0) + 1e-3 * RNG.standard_normal(CLOCK.size)
    found = propose(
        tmp_path / "a.csv", {"time [s]": CLOCK / 50, "v [m/s]": sign * speeds}, init.Said(mass="0.3 kg", struck="2 kg")
    )
    (channel,) = found.experiments[0].channels
    assert channel.observes == "struck.velocity.x" and np.nanmean(channel.values[-20:]) > 0.2
    (speed,) = (f for f in found.free if f.name == "approach_speed")
    assert speed.lower < 1.0 < speed.upper < 3.0


def test_a_machine_that_moves_to_and_fro_is_no_impact(tmp_path):
    """A bumper of 8e5 N/m on a shaker of 1 Hz, touched in a third of each cycle."""
    clock = np.arange(0.0, 3.0, 5e-3)
    places = -5e-4 - 7.6e-4 * np.cos(2.0 * np.pi * clock)
    force = 8e5 * np.maximum(places, 0.0) + 0.2 * RNG.standard_normal(clock.size)
    found = propose(tmp_path / "a.csv", {"Time [s]": clock, "x [mm]": 1e3 * places, "Axial Force [N]": force})
    assert [f.name for f in found.free] == ["stiffness", "exponent", "clearance_contact"]


def tossed():
    """A cube in flight that turns evenly: places (3, N), attitudes."""
    clock = np.arange(0.0, 0.5, 1.0 / 150.0)
    places = np.array([0.6 * clock, 0.2 * clock, 1.5 - 0.5 * 9.80665 * clock**2])
    return clock, places, Rotation.from_rotvec(np.outer(clock, [3.0, 5.0, 1.0])) * Rotation.from_rotvec([0.4, 0.1, 0.2])


def test_a_clock_in_two_columns_is_one(tmp_path):
    clock, places, turned = tossed()
    stamps = 1.7e9 + np.floor(12.8 + clock), np.round(1e9 * ((12.8 + clock) % 1.0))
    names = [f"pose.position.{k}" for k in "xyz"] + [f"pose.orientation.{k}" for k in "xyzw"]
    columns = dict(zip(["stamp.sec", "stamp.nanosec", *names], [*stamps, *places, *turned.as_quat().T], strict=True))
    table = read(write(tmp_path / "a.csv", columns), "record")
    assert table.clock == "time [s]"
    assert np.diff(table.numbers("time [s]", "s", "", False)) == pytest.approx(1.0 / 150.0, rel=1e-3)
    with pytest.raises(InputError, match=r"no column is a time; say how often was sampled: --rate"):
        propose(tmp_path / "b.csv", {k: v for k, v in columns.items() if "stamp" not in k})


def test_a_rotation_vector_and_numbered_places_are_those_of_a_body(tmp_path):
    clock, places, turned = tossed()
    vectors = {f"{k} {j + 1}": v[j] for k, v in (("tvec", places), ("rvec", turned.as_rotvec().T)) for j in range(3)}
    table = read(write(tmp_path / "a.csv", {"t": clock, **vectors}), "record")
    q = np.array([table.numbers(f"q{k}", "1", "", True) for k in range(4)])
    assert np.abs(np.sum(q * turned.as_quat(scalar_first=True).T, axis=0)) == pytest.approx(1.0)
    with pytest.raises(InputError, match="places and attitudes of a body in motion"):
        understood(table)


def test_structs_of_name_data_and_unit_are_channels(tmp_path):
    kind = [("Name", object), ("Data", object), ("Unit", object)]
    channels = np.array([("Platform.Weg", 1e3 * CLOCK, "mm"), ("Platform.Kraft", 7.0 * CLOCK, "N")], dtype=kind)
    savemat(tmp_path / "a.mat", {"rec": {"X": {"Name": "time", "Data": CLOCK, "Unit": "s"}, "Y": channels}})
    table = read(tmp_path / "a.mat", "record", "rec")
    assert table.header == ("time [s]", "Platform.Weg [mm]", "Platform.Kraft [N]")
