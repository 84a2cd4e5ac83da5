"""What calibrate reads: every bad input is named with its remedy and leaves nothing behind; what a table may hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import BUILD
from typer.testing import CliRunner

from bcfj_jax import InputError
from bcfj_jax.cli import app
from calibration import command
from calibration.problemfile import load

pytestmark = pytest.mark.filterwarnings("error")

# A small smooth pulse of 100 N over 1 ms; none of these tests asks whether a law fits it.
TIMES = np.linspace(0.0, 1.2, 13)
FORCES = 100.0 * np.clip(np.sin(np.pi * TIMES), 0.0, None)
TABLE = "time [ms],force [N]\n" + "".join(f"{t:.3f},{f:.6f}\n" for t, f in zip(TIMES, FORCES, strict=True))
SCENE = '[scene]\nkind = "impact"\n[parameters]\nmass = 0.1\napproach_speed = 1.0\nstiffness = 1e8\n'
PROBLEM = """scene = "s.toml"
[[experiment]]
file = "d.csv"
time = "time [ms]"
observe = { "contact.normal" = "force [N]" }
noise = "1 N"
[free.stiffness]
lower = 1e6
upper = 1e10
"""
FREE = PROBLEM[PROBLEM.index("[free") :]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Each test in its own folder, with a good problem in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    for name, text in (("p.toml", PROBLEM), ("s.toml", SCENE), ("d.csv", TABLE)):
        Path(name).write_text(text)
    return tmp_path


def swap(old: str, new: str, file: str = "p.toml"):
    """A change of one of the files, which must indeed change it."""

    def change():
        text = Path(file).read_text()
        assert old in text
        Path(file).write_text(text.replace(old, new, 1))

    return change


def drop(file: str):
    return lambda: Path(file).unlink()


def lines(change) -> None:
    """Change the data's lines, the header being line 1."""

    def apply():
        rows = Path("d.csv").read_text().splitlines()
        Path("d.csv").write_text("\n".join(change(rows)) + "\n")

    return apply


def refused(*parts: str, outs=((), ("--out", "out"))) -> None:
    """The command refuses with these words, on stderr, with exit code 2, and leaves the folder as it was."""
    before = {p: p.read_bytes() for p in Path(".").rglob("*") if p.is_file()}
    for out in outs:
        done = CliRunner().invoke(app, ["calibrate", "p.toml", "--starts", "4", *out])
        assert done.exit_code == 2, done.exception
        assert done.stdout == ""
        for part in parts:
            assert part in done.stderr
        assert {p: p.read_bytes() for p in Path(".").rglob("*") if p.is_file()} == before
        assert not Path("out").exists() and not Path("results").exists()


BAD = {
    "no problem": (drop("p.toml"), ["p.toml", "there is no such file", "give the path"]),
    "no data": (drop("d.csv"), ["p.toml: [[experiment]] 1 file", "no file d.csv", "relative to the problem file"]),
    "no scene": (drop("s.toml"), ["p.toml: scene", "no file s.toml", "relative to this file"]),
    "scene name": (swap('"s.toml"', '"impakt"'), ["p.toml: scene", "no scene 'impakt'", "impact"]),
    "no TOML": (swap('"d.csv"', "d.csv"), ["p.toml, line 3", "not TOML"]),
    "top key": (swap("scene =", "scen ="), ["p.toml: scen", "unknown key 'scen'", "did you mean 'scene'?"]),
    "experiment key": (swap("noise =", "nose ="), ["p.toml: [experiment.0] nose", "did you mean 'noise'?"]),
    "free key": (swap("lower", "lowest"), ["p.toml: [free.stiffness] lowest", "did you mean 'lower'?"]),
    "missing key": (swap("upper = 1e10\n", ""), ["p.toml: [free.stiffness] upper", "is missing"]),
    "scene key": (swap("stiffness", "stifnes", "s.toml"), ["s.toml: [parameters] stifnes", "mean 'stiffness'?"]),
    "bounds' unit": (
        swap(FREE, '[free.time_offset]\nlower = "-1 mm"\nupper = "1 ms"\n'),
        ["p.toml: [free.time_offset] lower", "'-1 mm'", "converts to s"],
    ),
    "noise's unit": (swap("1 N", "1 mm"), ["p.toml: [[experiment]] 1 noise", "'1 mm'", "converts to N"]),
    "no noise": (swap("1 N", "0 N"), ["noise", "0 N", '"estimate"']),
    "header's unit": (
        lambda: (swap('"force [N]"', '"force"')(), lines(lambda r: ["time [ms],force [mm]", *r[1:]])()),
        ["d.csv: column 'force [mm]'", "'mm'", "converts to N"],
    ),
    "infinite": (
        lines(lambda r: [*r[:4], r[4].split(",")[0] + ",inf", *r[5:]]),
        ["d.csv: line 5, column 'force [N]'", "'inf'", "not a finite number", "blank"],
    ),
    "text column": (
        lines(lambda r: [r[0], *(row.split(",")[0] + ",open" for row in r[1:])]),
        ["d.csv: line 2, column 'force [N]'", "'open'", "13 of the column's 13 cells", "another column"],
    ),
    "decimal comma": (
        lines(lambda r: [r[0], *(row.split(",")[0] + ',"1,5"' for row in r[1:])]),
        ["d.csv: line 2, column 'force [N]'", "'1,5'", "decimals with a point"],
    ),
    "semicolons": (
        lines(lambda r: [row.replace(",", ";") for row in r]),
        ["d.csv: line 1", "no comma but a semicolon: 'time [ms];force [N]'", "separate by commas"],
    ),
    "tabs in .csv": (
        lines(lambda r: [row.replace(",", "\t") for row in r]),
        ["d.csv: line 1", "no comma but a tab", "name the file .tsv"],
    ),
    "Latin-1": (
        lambda: Path("d.csv").write_bytes(TABLE.replace("ms", "µs").encode("latin-1")),
        ["d.csv: line 1", "byte 0xb5 is not UTF-8", "in Latin-1 it is 'µ'", "save the file as UTF-8"],
    ),
    "Latin-1 far below": (
        lambda: Path("d.csv").write_bytes(("x\n" * 9000 + "µ\n").encode("latin-1")),
        ["d.csv: line 9001", "byte 0xb5"],
    ),
    "UTF-16": (lambda: Path("d.csv").write_text(TABLE, encoding="utf-16"), ["d.csv", "is UTF-16", "UTF-8"]),
    "kind of file": (
        lambda: (Path("d.csv").rename("d.dat"), swap('"d.csv"', '"d.dat"')()),
        ["[[experiment]] 1 file", "d.dat is of no kind known here", ".csv, .h5, .hdf5, .mat"],
    ),
    "table in a CSV": (swap("time =", 'table = "a"\ntime ='), ["[[experiment]] 1 file table", "d.csv holds no tables"]),
    "two of a name": (
        lines(lambda r: [row + "," + row.split(",")[1] for row in r]),
        ["observe", "2 columns of d.csv are headed 'force [N]'", "rename one"],
    ),
    "blank time": (lines(lambda r: [*r[:4], ",1.0", *r[5:]]), ["d.csv: line 5, column 'time [ms]'", "''"]),
    "short row": (lines(lambda r: [*r[:4], "0.3", *r[5:]]), ["d.csv: line 5", "1 cells under 2 headers"]),
    "no rows": (lines(lambda r: r[:1]), ["d.csv", "no rows below a header"]),
    "unsorted": (lines(lambda r: [*r[:5], r[6], r[5], *r[7:]]), ["d.csv: line 7, column 'time [ms]'", "sort the rows"]),
    "time twice": (
        lines(lambda r: [*r[:5], r[4], *r[5:]]),
        ["d.csv: line 6, column 'time [ms]'", "time 0.0003 s stands twice", "repeated rows"],
    ),
    "constant": (
        lines(lambda r: [r[0], *(row.split(",")[0] + ",2.5" for row in r[1:])]),
        ["d.csv: lines 2 to 14, column 'force [N]'", "reads 2.5 N in every row", "choose the column"],
    ),
    "empty column": (
        lines(lambda r: [r[0], *(row.split(",")[0] + ",NaN" for row in r[1:])]),
        ["d.csv: lines 2 to 14, column 'force [N]'", "no number at all", "another column"],
    ),
    "wrong sign": (
        swap('"force', '"-force'),
        ["d.csv: lines 2 to 14, column 'force [N]'", "100% of the impulse is negative", 'flip its sign with "-"'],
    ),
    "wrong sign and offset": (
        lambda: (
            lines(lambda r: [r[0], *(f"{t},{20 - f}" for t, f in zip(TIMES, FORCES * (TIMES < 0.45), strict=True))])(),
            swap(FREE, FREE + "[free.force_offset]\nlower = -50\nupper = 50\n")(),
        ),
        ["d.csv: lines 2 to 14", "of the impulse is negative", 'flip its sign with "-"'],
    ),
    "loading only": (
        lines(lambda r: r[:6]),
        [
            "d.csv: lines 2 to 6",
            "largest at its last sample (95.1057 N at 400 us)",
            "shorter than a contact",
            "after it",
        ],
    ),
    "contact of two samples": (
        lines(lambda r: [r[0], "0,0", "1,80", "2,100", "3,1", "4,0"]),
        ["d.csv: lines 2 to 6", "2 samples lie within the contact", "sample faster"],
    ),
    "all saturated": (
        lambda: (swap("noise", 'saturation = "1 N"\nnoise')(), lines(lambda r: [r[0], *r[2:-3]])()),
        ["column 'force [N]'", "every sample is at or beyond the saturation"],
    ),
    "saturation": (swap("noise", 'saturation = "-1 N"\nnoise'), ["[[experiment]] 1 saturation", "-1 N", "positive"]),
    "saturation's unit": (swap("noise", 'saturation = "1 V"\nnoise'), ["saturation", "'1 V'", "converts to N"]),
    "rate": (
        swap("noise", 'resample = "20 kHz"\nnoise'),
        ["[[experiment]] 1 resample", "20 kHz is above the 10 kHz", "no knowledge"],
    ),
    "rate of a short record": (
        swap("noise", 'resample = "5 kHz"\nnoise'),
        ["[[experiment]] 1 resample", "longer than 30 samples", "take resample out"],
    ),
    "column": (
        swap('"force [N]"', '"fors [N]"'),
        ["p.toml: [[experiment]] 1 observe", "no column 'fors [N]' in d.csv", "did you mean 'force [N]'?"],
    ),
    "noise of another channel": (
        swap('"1 N"', '{ "contact.axial" = "1 N" }'),
        ["[[experiment]] 1 noise", "no noise of 'contact.normal'", "for each channel"],
    ),
    "no clock": (swap('time = "time [ms]"\n', ""), ["[[experiment]] 1 time", "the key 'time' is missing"]),
    "nothing observed": (swap('{ "contact.normal" = "force [N]" }', "{}"), ["observe", "nothing is observed"]),
    "feature": (
        swap("noise", 'features = { "contact.peek" = 1 }\nfeature_noise = "1 N"\nnoise'),
        ["[[experiment]] 1 features", "no feature 'peek'", "mean 'peak'?"],
    ),
    "feature's noise": (
        swap("noise", 'features = { "contact.peak" = 1.0 }\nnoise'),
        ["[[experiment]] 1 feature_noise", "no noise of 'contact.peak'"],
    ),
    "loss": (swap("scene =", 'loss = "soft"\nscene ='), ["p.toml: loss", "no loss 'soft'", "'soft_l1'"]),
    "channel": (swap("contact.normal", "contat.normal"), ["no contact 'contat'", "did you mean 'contact'?"]),
    "component": (swap("contact.normal", "contact.norml"), ["contact.norml", "did you mean 'normal'?"]),
    "rows": (
        swap("noise", 'rows = { "force [N]" = 7 }\nnoise'),
        ["p.toml: [[experiment]] 1: rows", "no row has force [N] = 7", "values there: 0.000000"],
    ),
    "bounds swapped": (swap("= 1e6", "= 1e11"), ["p.toml: [free.stiffness]", "lower = 1e+11 is not below", "swap"]),
    "bounds out of range": (swap("1e6", "-1e6"), ["p.toml: [free.stiffness]", "-1e+06", "must be"]),
    "start": (
        swap("1e10\n", "1e10\nstart = 1e5\n"),
        ["p.toml: [free.stiffness]", "start = 100000 is outside [1e+06, 1e+10]", "within the bounds"],
    ),
    "free name": (swap("stiffness", "stifnes"), ["p.toml: [free.stifnes]", "no parameter 'stifnes'", "'stiffness'?"]),
    "own parameter's name": (
        swap("noise", "parameters = { masss = 1 }\nnoise"),
        ["[[experiment]] 1 parameters", "no parameter 'masss'", "mass"],
    ),
    "few samples": (
        lambda: (
            lines(lambda r: [r[0], *r[5:8]])(),
            swap("1e10\n", "1e10\n[free.exponent]\nlower = 1\nupper = 2\n[free.gain]\nlower = 0.5\nupper = 2\n")(),
        ),
        ["p.toml", "3 samples for 3 free parameters", "free fewer"],
    ),
    "never positive": (
        lambda: (swap('"force', '"-force')(), swap("noise", 'align = "onset"\nnoise')()),
        ["[[experiment]] 1 observe", "never positive", "flip its sign"],
    ),
    "window": (swap("noise", 'window = ["5 ms", "6 ms"]\nnoise'), ["[[experiment]] 1 window", "0 samples", "widen"]),
    "no free": (swap(FREE, ""), ["p.toml: free", "the key 'free' is missing"]),
    "accuracy": (swap("scene", "accuracy = 2.0\nscene"), ["p.toml: accuracy", "2.0 is not accepted", "0.5"]),
    "only held out": (swap("noise", "hold_out = true\nnoise"), ["p.toml", "no experiment to fit", "without hold_out"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_exits_2_and_writes_nothing(name, here):
    change, parts = BAD[name]
    change()
    refused(*parts)


def test_the_command_raises_before_it_writes(here):
    drop("d.csv")()
    with pytest.raises(InputError, match=r"no file d\.csv"):
        command.run(Path("p.toml"), Path("out"), 0, 4)
    assert not Path("out").exists()


@pytest.mark.slow
def test_a_parameter_that_moves_nothing_is_refused(here):
    # 10 mm away at 1 m/s, the body touches 10 ms after the start; the record ends at 1.2 ms.
    swap("mass", "clearance_contact = 0.01\nmass", "s.toml")()
    refused(
        "p.toml: [free.stiffness]",
        "'stiffness' moves no residual",
        "fix it in the scene, or add data",
        outs=[("--out", "out")],
    )


def test_accuracy_is_what_the_file_says(here):
    assert load("p.toml").accuracy == 1e-7
    swap("scene", "accuracy = 1e-4\nscene")()
    assert load("p.toml").accuracy == 1e-4


def loaded(table: str, entry: str = "") -> tuple:
    Path("d.csv").write_text(table, encoding="utf-8")
    swap("noise", entry + "\nnoise")()
    return load("p.toml").experiments


def test_tables_may_quote_lead_with_a_mark_and_leave_blanks(here):
    text = '\ufeff"time [ms]","force, filtered [kN]",note\r\n"0","-0.25","a, b"\r\n\r\n'
    text += '1,,\r\n2," -0.5 ",\r\n3,NaN,\r\n4,-0.25,\r\n'
    swap("force [N]", "-force, filtered [kN]")()
    (one,) = loaded(text)
    np.testing.assert_array_equal(one.times, [0.0, 1e-3, 2e-3, 3e-3, 4e-3])
    np.testing.assert_array_equal(one.channels[0].values, [250.0, np.nan, 500.0, np.nan, 250.0])
    assert one.channels[0].sigma == 1.0


RUNS = "{0},time [ms],force [N]\n" + "".join(f"{r},{t},{10 * r + t * (3 - t)}\n" for r in (1, 2, 3) for t in range(4))


@pytest.mark.parametrize(
    ("column", "entry", "names", "firsts"),
    [
        ("run", "", ["run 1", "run 2", "run 3"], [10, 20, 30]),
        ("shot", "rows = { shot = [1, 3] }", ["shot 1", "shot 3"], [10, 30]),
        ("shot", "rows = { shot = 2 }", ["d"], [20]),
        ("run", "rows = { run = [2, 3] }", ["run 2", "run 3"], [20, 30]),
    ],
    ids=["run column", "list", "one", "some runs"],
)
def test_runs_and_lists_of_rows_become_experiments(column, entry, names, firsts, here):
    experiments = loaded(RUNS.format(column), entry)
    assert [e.name for e in experiments] == names
    for experiment, first in zip(experiments, firsts, strict=True):
        np.testing.assert_array_equal(experiment.channels[0].values, first + np.array([0.0, 2.0, 2.0, 0.0]))


def test_onset_and_window(here):
    # The pulse first exceeds a tenth of its peak at 0.1 ms (sin 18 deg = 0.31): that becomes time 0.
    (one,) = loaded(TABLE, 'align = "onset"\nwindow = ["-0.05 ms", "0.45 ms"]')
    np.testing.assert_allclose(one.times, [0.0, 1e-4, 2e-4, 3e-4, 4e-4], atol=1e-18)
    np.testing.assert_allclose(one.channels[0].values, FORCES[1:6], rtol=1e-7)


@pytest.mark.parametrize(
    ("entry", "sigma", "relative", "memory"),
    [
        ('"2 %"', 2.0, 0.0, 0.0),
        ("3.0", 3.0, 0.0, 0.0),
        ('"0.003 kN + 4 % + 5 % of reading"', 5.0, 0.05, 0.0),
        ('{ "contact.normal" = "2 N" }', 2.0, 0.0, 0.0),
        ('"estimate"\ncorrelation = "0.2 ms"', None, 0.0, 2e-4),
        ('"2 N"\ncorrelation = "estimate"', 2.0, 0.0, None),
    ],
)
def test_noise(entry, sigma, relative, memory, here):
    """A percentage is of the largest reading, 100 N; independent parts add in their squares."""
    swap('"1 N"', entry)()
    channel = load("p.toml").experiments[0].channels[0]
    assert (channel.relative, channel.correlation) == (pytest.approx(relative), memory)
    assert channel.sigma == (sigma if sigma is None else pytest.approx(sigma, rel=1e-6))


def test_features_beside_and_instead_of_histories(here):
    only = '[[experiment]]\nfeatures = { "contact.peak" = "0.1 kN" }\nfeature_noise = "2 %"\nspan = "5 ms"\n'
    swap("[free", only + "[free")()
    swap("noise", 'name = "drop"\nfeatures = { "contact.impulse" = 0.06 }\nfeature_noise = "1 mN s"\nnoise')()
    first, second = load("p.toml").experiments
    assert [(o.feature, o.value, o.sigma) for o in first.features] == [("contact.impulse", 0.06, 1e-3)]
    assert [(o.feature, o.value, o.sigma) for o in second.features] == [("contact.peak", 100.0, 2.0)]
    assert (first.name, second.name, second.span, second.channels) == ("drop", "[[experiment]] 2", 5e-3, ())


def test_two_records_never_share_a_name(here):
    entry = PROBLEM[PROBLEM.index("[[exp") : PROBLEM.index("[free")]
    swap("[free", entry + "[free")()
    assert [e.name for e in load("p.toml").experiments] == ["d", "d (2)"]
