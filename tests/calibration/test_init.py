"""``bcfj init calibration RECORD``: what it finds in measured files of every kind, and a file that calibrates at once."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import bcfj
from scipy.integrate import solve_ivp
from test_records import MASS, SPEED, TRUTH, drop, impact, law, table

from bcfj_jax import InputError
from benchmarks.references.impact import contact
from calibration import load

pytestmark = pytest.mark.filterwarnings("error")

TIMES = np.arange(0.0, 0.06, 2.5e-4)
PLACE, RATE, ACCELERATION, PUSH = impact(TIMES - 21.3e-3)


def init(*arguments: str):
    return bcfj("init", "calibration", *arguments)


def written(record: str, *options: str) -> dict:
    done = init(record, *options)
    assert done.exit_code == 0, done.output
    path = Path(record).with_suffix(".toml").name
    assert f"wrote {path}" in done.output
    text = Path(path).read_text()
    assert len(text.splitlines()) <= 22 and text.isascii()
    return tomllib.loads(text)


def noisy(values: np.ndarray, share: float = 0.01) -> np.ndarray:
    return values + share * np.ptp(values) * np.random.default_rng(3).standard_normal(values.size)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_rig_with_force_and_motion_needs_nothing_more(here):
    drop()
    found = written("drop.csv")
    (entry,) = found["experiment"]
    assert (found["scene"], found["sensor"]) == ("impact", "free")
    assert entry["observe"] == {"contact.normal": "force [N]"} and entry["align"] == "onset"
    assert float(entry["parameters"]["mass"].split()[0]) == pytest.approx(MASS, rel=0.02)
    bounds = {name: [float(str(b[end]).split()[0]) for end in ("lower", "upper")] for name, b in found["free"].items()}
    for name, true in {**TRUTH, "approach_speed": SPEED}.items():
        assert bounds[name][0] < true < bounds[name][1]
    text = Path("drop.toml").read_text()
    for said in (
        "every 250 us",
        "1 contact",
        '"body.place.x" = "position [mm]"',
        "CHECK the mass",
        "approach at 1.2 m/s",
    ):
        assert said in text
    assert [f.name for f in load("drop.toml").free][-2:] == ["time_offset", "force_offset"]


def test_nothing_is_overwritten_and_nothing_else_is_taken(here):
    drop()
    written("drop.csv")
    again = init("drop.csv")
    assert again.exit_code == 2 and "already holds drop.toml" in again.output
    assert bcfj("init", "impact", "drop.csv").exit_code == 2
    assert bcfj("init", "calibration").exit_code == 2
    assert bcfj("init", "impact").exit_code == 0 and Path("impact.toml").exists()


def test_what_a_force_alone_cannot_tell_is_asked_for(here):
    table("f.csv", {"time [ms]": 1e3 * TIMES, "load [kN]": -1e-3 * noisy(PUSH)})
    found = written("f.csv")
    assert found["experiment"][0]["parameters"] == {"mass": "? kg"}
    assert found["experiment"][0]["observe"] == {"contact.normal": "-load [kN]"}
    done = bcfj("calibrate", "f.toml", "--out", "fit")
    assert done.exit_code == 2 and "[[experiment]] 1 parameters.mass" in done.output and "give a mass" in done.output
    Path("f.toml").unlink()
    known = written("f.csv", "--mass", "0.4 kg")["free"]["approach_speed"]
    low, high = (float(known[end].split()[0]) for end in ("lower", "upper"))
    assert low < SPEED < high < 4.0 * low
    Path("f.toml").unlink()
    both = written("f.csv", "--mass", "40 g", "--speed", "1.2 m/s")
    assert "approach_speed" not in both["free"] and "CHECK: impulse / (mass x speed)" in Path("f.toml").read_text()


def hdf5(path: str) -> None:
    h5py = pytest.importorskip("h5py", reason="the extra io is not installed")
    with h5py.File(path, "w") as file:
        group = file.create_group("daq")
        group.create_dataset("t", data=1e3 * TIMES).attrs["unit"] = "ms"
        group.create_dataset("a1", data=noisy(ACCELERATION) / 9.80665).attrs["unit"] = "g_0"


def mat(path: str) -> None:
    from scipy.io import savemat

    units = {"time": "s", "x": "mm", "F": "kN"}
    columns = {"time": TIMES, "x": 350.0 - 1e3 * PLACE, "F": -1e-3 * noisy(PUSH), "units": units}
    savemat(path, {"shot": columns})


def tdms(path: str) -> None:
    nptdms = pytest.importorskip("nptdms", reason="the extra io is not installed")
    columns = (("time", TIMES, "s"), ("Laser", noisy(-RATE, 0.002), "m/s"))
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("g", n, v, properties={"unit_string": u}) for n, v, u in columns])


def parquet(path: str) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="the extra io is not installed")
    from pyarrow import parquet

    runs = np.repeat([1, 2], TIMES.size)
    force = np.concatenate([PUSH, impact(TIMES - 15e-3, 1.5)[3]])
    parquet.write_table(pyarrow.table({"run": runs, "time [s]": np.tile(TIMES, 2), "tare [N]": force + 7.0}), path)


@pytest.mark.parametrize(
    ("make", "record", "observe", "options"),
    [
        (hdf5, "a.h5", {"body.acceleration.x": "a1 [g_0]"}, ("--mass", "0.4 kg")),
        (mat, "x.mat", {"contact.normal": "-F [kN]"}, ()),
        (tdms, "v.tdms", {"body.velocity.x": "-Laser [m/s]"}, ("--mass", "0.4 kg")),
        (parquet, "r.parquet", {"contact.normal": "tare [N]"}, ("--mass", "0.4 kg")),
    ],
)
def test_every_kind_of_file_gives_a_problem_that_loads(make, record, observe, options, here):
    make(record)
    found = written(record, *options)
    assert found["experiment"][0]["observe"] == observe
    problem = load(Path(record).with_suffix(".toml"))
    assert len(problem.experiments) == (2 if make is parquet else 1)
    assert {"stiffness", "exponent", "damping", "approach_speed", "time_offset"} <= {f.name for f in problem.free}
    if make is parquet:
        assert all(e.bounds["force_offset"][0] < 7.0 < e.bounds["force_offset"][1] for e in problem.experiments)
        assert next(f for f in problem.free if f.name == "approach_speed").each


def bounces() -> None:
    """A drop from 0.1 m, three contacts of five samples, on a clock of the rig's own."""
    run = solve_ivp(
        lambda t, y: [y[1], -9.81 + float(law(-y[0], -y[1])) / 0.2], (0.0, 0.9), [0.1, 0.0], "DOP853", dense_output=True,
        rtol=1e-10, atol=1e-12, max_step=5e-4,
    )  # fmt: skip
    times = np.arange(0.0, 0.9, 2e-3)
    height, rate = run.sol(times)
    table("b.csv", {"time [s]": times + 7.3, "force [N]": noisy(law(-height, -rate), 0.005)})


def test_flights_between_contacts_tell_the_height_and_the_mass(here):
    bounces()
    found = written("b.csv")
    assert found["scene"] == "bounce" and "parameters" not in found["experiment"][0]
    for name, true in (("drop_height", 0.1), ("mass", 0.2)):
        low, high = (float(found["free"][name][end].split()[0]) for end in ("lower", "upper"))
        assert low < true < high
    lower, upper = load("b.toml").experiments[0].bounds["time_offset"]
    assert lower < 7.3 < upper
    Path("b.toml").unlink()
    assert written("b.csv", "--scene", "impact", "--mass", "0.2 kg")["scene"] == "impact"


@pytest.mark.parametrize(
    ("columns", "options", "words"),
    [
        ({"force [N]": PUSH}, (), "no column is a time: force [N]"),
        ({"time [s]": TIMES, "voltage [V]": PUSH}, (), "no column is a force, a position"),
        (
            {"time [s]": TIMES, "force [N]": PUSH},
            ("--scene", "chain"),
            "no problem file is proposed for the scene 'chain'",
        ),
        ({"time [s]": TIMES, "force [N]": PUSH}, ("--scene", "bounce"), "no record holds two contacts"),
        ({"time [s]": TIMES, "force [N]": PUSH}, ("--mass", "3 m"), "--mass: '3 m'"),
    ],
)
def test_what_cannot_be_proposed_is_said(columns, options, words, here):
    table("d.csv", columns)
    done = init("d.csv", *options)
    assert done.exit_code == 2 and words in done.output
    assert not Path("d.toml").exists()


@pytest.mark.slow
def test_the_file_calibrates_at_once(here):
    """After the answer to the one question; without it the numbers stand there on its condition."""
    drop()
    written("drop.csv")
    question = '# parameters.struck_mass = "fixed"'
    assert Path("drop.toml").read_text().count(question) == 1
    command = ["calibrate", "drop.toml", "--starts", "4", "--out"]
    asked = bcfj(*command, "asked")
    assert asked.exit_code == 4 and "verdict: not_identified" in asked.stdout, asked.output
    Path("drop.toml").write_text(Path("drop.toml").read_text().replace(question, question[2:]))
    done = bcfj(*command, "fit")
    assert done.exit_code == 0, done.output
    assert "verdict: identified" in done.stdout
    open_, known = (json.loads(Path(f"{name}/fit.json").read_text()) for name in ("asked", "fit"))
    assert known["conditional"] is None and open_["conditional"]["condition"] == "the struck body is fixed"
    for name, true in TRUTH.items():
        (low, high), own = known["parameters"][name]["with_budget"], open_["conditional"]["parameters"][name]
        assert low < true < high and open_["parameters"][name]["ci95"] is None
        np.testing.assert_allclose(own["with_budget"], (low, high), rtol=1e-6)


def test_the_struck_body_may_be_given_to_init(here):
    drop()
    assert written("drop.csv", "--struck-mass", "fixed")["experiment"][0]["parameters"]["struck_mass"] == "fixed"
    assert not load("drop.toml").doubts
    Path("drop.toml").unlink()
    written("drop.csv", "--struck-mass", "4.8 kg")
    assert load("drop.toml").experiments[0].fixed["struck_mass"] == 4.8
    Path("drop.toml").unlink()
    assert "--struck-mass: 'heavy'" in init("drop.csv", "--struck-mass", "heavy").output


LAB = Path(__file__).resolve().parents[2] / "examples" / "lab_drop.csv"


def test_a_german_lab_file_is_understood_and_what_it_lacks_is_asked_for(here):
    """Semicolons, decimal commas, Latin-1, a preamble: one message says so, and the next says what to fill in."""
    Path("lab_drop.csv").write_bytes(LAB.read_bytes())
    done = init("lab_drop.csv")
    for said in (
        "Latin-1 text, semicolons, decimal commas", "2 comment lines left out", "2 columns: Zeit [ms], Kraft [kN]",
        "400 samples over 39.9 ms", "does not give mass: write it in lab_drop.toml in place of the question mark",
    ):  # fmt: skip
        assert said in done.output
    text = Path("lab_drop.toml").read_text(encoding="utf-8")
    Path("lab_drop.toml").write_text(text.replace("? kg", "0,5 kg"), encoding="utf-8")
    done = bcfj("calibrate", "lab_drop.toml")
    assert done.exit_code == 2 and 'write "0.5 kg"' in done.output


@pytest.mark.full
def test_a_german_lab_file_goes_to_a_verdict_in_two_commands(here):
    Path("lab_drop.csv").write_bytes(LAB.read_bytes())
    assert init("lab_drop.csv", "--mass", "0.5 kg").exit_code == 0
    done = bcfj("calibrate", "lab_drop.toml", "--starts", "4", "--out", "fit")
    assert done.exit_code == 0, done.output
    assert "verdict: identified" in done.stdout
    found = json.loads(Path("fit/fit.json").read_text(encoding="utf-8"))["parameters"]
    for name, true in (("stiffness", 8e5), ("exponent", 1.4), ("approach_speed", 1.1)):
        low, high = found[name]["ci95"]
        assert low < true < high, name


@pytest.mark.parametrize(
    ("axis", "header"),
    [(a, "Acceleration {} (m/s^2)") for a in "xyz"] + [("z", "Ch{} (g)"), ("y", "Accel {} [g]")],
)
def test_of_three_axes_the_one_that_is_hit_is_taken(axis, header, here):
    clock = np.arange(200) * 1e-4
    hit = np.where((clock > 5e-3) & (clock < 1e-2), -250.0 * np.sin(np.pi * (clock - 5e-3) / 5e-3), 0.0)
    rng = np.random.default_rng(4)
    names = [header.format(f"1 {a}" if header[:2] == "Ch" else a) for a in "xyz"]
    columns = [rng.normal(scale=0.5, size=clock.size) + (hit if a == axis else 0.0) for a in "xyz"]
    np.savetxt(
        "axes.csv",
        np.column_stack([clock, *columns]),
        delimiter=",",
        header=",".join(["Time (s)", *names]),
        comments="",
    )
    (experiment,) = written("axes.csv")["experiment"]
    assert names["xyz".index(axis)] in experiment["observe"]["body.acceleration.x"]


@pytest.mark.parametrize("name", ["Drop", "hit", "Test"])
def test_a_column_that_is_one_number_in_each_run_is_no_reading(name, here):
    clock = np.arange(200) * 1e-4
    rows = []
    for run, height in ((1, 50.0), (2, 100.0), (3, 200.0)):
        hit = np.where((clock > 5e-3) & (clock < 1e-2), np.sqrt(height) * np.sin(np.pi * (clock - 5e-3) / 5e-3), 0.0)
        rows += [[run, 1e3 * t, height, a] for t, a in zip(clock, -hit, strict=True)]
    np.savetxt("drops.csv", rows, delimiter=",", header=f"{name},time [ms],height [mm],acceleration [g]", comments="")
    (experiment,) = written("drops.csv")["experiment"]
    assert list(experiment["observe"]) == ["body.acceleration.x"]


SPEEDS = (0.6, 1.1, 1.1, 2.0)


def several(header: str, values: tuple[float, ...], read: str = "force [N]", number: str = "run") -> None:
    """Impacts at SPEEDS, each beside a number of its own in a column."""
    clock, rows = np.arange(0.0, 0.05, 2.5e-4), []
    rng = np.random.default_rng(6)
    for run, (speed, value) in enumerate(zip(SPEEDS, values, strict=True), 1):
        _, _, acceleration, force = impact(clock - 12e-3, speed)
        seen = force if "force" in read else acceleration / 9.80665
        seen = seen + 0.005 * np.ptp(seen) * rng.standard_normal(clock.size)
        rows += [f"{run};{t:.9g};{value:.9g};{x:.9g}" for t, x in zip(clock, seen, strict=True)]
    Path("runs.csv").write_text(f"{number};time [s];{header};{read}\n" + "\n".join(rows) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("header", "key", "scale", "read"),
    [
        ("height [mm]", "drop_height", 1e3, "force [N]"),
        ("Fallhoehe [cm]", "drop_height", 1e2, "force [N]"),
        ("drop height", "drop_height", 1.0, "acceleration [g]"),
        ("speed [m/s]", "approach_speed", 1.0, "force [N]"),
        ("v0 [km/h]", "approach_speed", 3.6, "acceleration [g]"),
    ],
)
def test_heights_and_speeds_in_a_column_are_the_speed_of_each_run(header, key, scale, read, here):
    """A height h is the speed sqrt(2 g h): what the problem has is the speed that SciPy's impacts had."""
    values = tuple(scale * (v if key == "approach_speed" else v**2 / (2.0 * 9.81)) for v in SPEEDS)
    several(header, values, read)
    found = written("runs.csv", "--mass", f"{MASS} kg")
    (entry,) = found["experiment"]
    assert entry["columns"] == {key: header} and "approach_speed" not in found["free"]
    # What falls from a height has its weight in contact, too.
    assert ("gravity" in entry["parameters"]) == (key == "drop_height")
    assert len(entry["observe"]) == 1 and "Not understood" not in Path("runs.toml").read_text()
    problem = load("runs.toml")
    assert [e.fixed["approach_speed"] for e in problem.experiments] == pytest.approx(SPEEDS, rel=1e-7)
    assert not problem.doubts
    bounds = {f.name: (f.lower, f.upper) for f in problem.free}
    for name, true in TRUTH.items():
        assert bounds[name][0] < true < bounds[name][1]
    # How well a height is known: half its share is the speed's.
    text = Path("runs.toml").read_text().replace(f"= {json.dumps(header)} }}", f'= "{header} +- 4 %" }}')
    Path("runs.toml").write_text(text)
    share = 0.04 if key == "approach_speed" else 0.02
    for e in load("runs.toml").experiments:
        assert e.tolerances["approach_speed"] == pytest.approx(share * e.fixed["approach_speed"], rel=1e-6)


def test_a_wrong_height_is_said_before_the_fit(here):
    """Heights in m that are taken for mm: the impulse contradicts the speed."""
    several("height [mm]", tuple(v**2 / (2.0 * 9.81) for v in SPEEDS))
    written("runs.csv", "--mass", f"{MASS} kg")
    assert all("impulse / (mass x speed)" in doubt.text for doubt in load("runs.toml").doubts)
    assert load("runs.toml").doubts


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ('columns = { drop_height = "force [N]" }', "force"),
        ('columns = { heigth = "height [mm]" }', "no parameter 'heigth'"),
        ('columns = { drop_height = "time [s]" }', "time"),
        ('columns = { approach_speed = "height [mm]" }', "height"),
        ('columns = { drop_height = "height [mm]", approach_speed = "height [mm]" }', "given twice"),
    ],
)
def test_columns_that_give_no_parameter_are_refused(line, said, here):
    several("height [mm]", tuple(1e3 * v**2 / (2.0 * 9.81) for v in SPEEDS))
    written("runs.csv", "--mass", f"{MASS} kg")
    text = "\n".join(line if x.startswith("columns") else x for x in Path("runs.toml").read_text().splitlines())
    Path("runs.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        load("runs.toml")


def test_a_column_that_changes_within_a_run_is_refused(here):
    several("height [mm]", tuple(1e3 * v**2 / (2.0 * 9.81) for v in SPEEDS), number="lauf")
    lines = [
        'scene = "impact"', "[[experiment]]", 'file = "runs.csv"', 'time = "time [s]"', "rows = { lauf = [2, 3] }",
        'observe = { "contact.normal" = "force [N]" }', 'columns = { drop_height = "height [mm]" }',
        'parameters = { mass = "0.4 kg" }', "[free]", "stiffness = [1e3, 1e7]",
    ]  # fmt: skip
    Path("p.toml").write_text("\n".join(lines))
    assert [e.fixed["approach_speed"] for e in load("p.toml").experiments] == pytest.approx([1.1, 1.1], rel=1e-7)
    Path("p.toml").write_text("\n".join(line for line in lines if not line.startswith("rows")))
    with pytest.raises(InputError, match=r"'height \[mm\]' goes from 18.3\d* mm to 203.\d* mm within runs"):
        load("p.toml")


CLOCK = np.arange(500) / 2e4 - 5e-3


def loud(noise: float, seed: int, restitution_lost: float = 0.3) -> np.ndarray:
    """A hit that loses energy, by SciPy, with noise that is a share of its peak."""
    force = contact({"stiffness": 2e6, "exponent": 1.5, "damping": restitution_lost}, 0.8, 1.2).force(CLOCK)
    return force + noise * force.max() * np.random.default_rng(seed).standard_normal(CLOCK.size)


@pytest.mark.parametrize("noise", [0.002, 0.1, 0.5])
def test_an_impulse_within_its_noise_takes_no_damping_away(noise, here):
    for seed in range(8):
        table("hit.csv", {"time [s]": CLOCK, "force [N]": loud(noise, seed)})
        found = written("hit.csv", "--mass", "0.8 kg", "--speed", "1.2 m/s")
        assert "damping" in found["free"], seed
        assert not load("hit.toml").doubts
        Path("hit.toml").unlink()


def test_a_hit_that_loses_nothing_is_still_one(here):
    table("hit.csv", {"time [s]": CLOCK, "force [N]": loud(0.002, 0, 0.0)})
    assert "damping" not in written("hit.csv", "--mass", "0.8 kg", "--speed", "1.2 m/s")["free"]


def test_a_hit_that_may_lose_nothing_has_a_damping_from_none_on(here):
    """So its interval has one side, and is no estimate at a bound; one that loses is searched on the scale of a logarithm."""
    for loss, least in ((0.0, 0.0), (0.3, 0.01 / 1.2)):
        table("hit.csv", {"time [s]": CLOCK, "force [N]": loud(0.1, 0, loss)})
        damping = written("hit.csv", "--mass", "0.8 kg", "--speed", "1.2 m/s")["free"]["damping"]
        assert damping["lower"] == pytest.approx(least, rel=0.05)
        assert damping.get("scale", "log") == ("linear" if least == 0.0 else "log")
        Path("hit.toml").unlink()


@pytest.mark.parametrize("header", ["force [N]", "acceleration [g]"])
def test_a_record_of_noise_alone_is_refused_or_said_to_show_no_contact(header, here):
    for seed in range(10):
        values = np.random.default_rng(seed).standard_normal(120)
        table("hit.csv", {"time [s]": CLOCK[:120], header: values})
        done = init("hit.csv", "--mass", "0.8 kg")
        assert isinstance(done.exception, SystemExit | None), (seed, done.exception)
        if done.exit_code:
            words = "the force pulls|no impulse|can only push|samples lie within the contact|no contact"
            assert re.search(words, " ".join(done.output.split())), (seed, done.output)
            continue
        text = Path("hit.toml").read_text()
        Path("hit.toml").unlink()
        assert "deviations of the noise: the record may show none" in text, seed
