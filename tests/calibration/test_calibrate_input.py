"""What calibrate reads: every bad input is named with its remedy and leaves nothing behind."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import bcfj
from problems import FORCES, FREE, TIMES, drop, lines, swap

from bcfj_jax import InputError
from calibration import command

pytestmark = pytest.mark.filterwarnings("error")


def refused(*parts: str, outs=((), ("--out", "out"))) -> None:
    """The command refuses with these words, on stderr, with exit code 2, and leaves the folder as it was."""
    before = {p: p.read_bytes() for p in Path(".").rglob("*") if p.is_file()}
    for out in outs:
        done = bcfj("calibrate", "p.toml", "--starts", "4", *out)
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
        lines(lambda r: [*r[:4], '0.3,"1,5"', *r[5:]]),
        ["d.csv: line 5, column 'force [N]'", "'1,5'", "decimals with a point"],
    ),
    "kind of file": (
        lambda: (Path("d.foo").write_bytes(b"\0\1\2" * 50), swap('"d.csv"', '"d.foo"')()),
        ["[[experiment]] 1 file", "d.foo is of no kind known here", ".csv, .dat, .dat4, .h5", "--code FILE"],
    ),
    "table in a CSV": (swap("time =", 'table = "a"\ntime ='), ["[[experiment]] 1 file table", "d.csv holds no tables"]),
    "two of a name": (
        lines(lambda r: [row + "," + row.split(",")[1] for row in r]),
        ["observe", "2 columns of d.csv are headed 'force [N]'", "rename one"],
    ),
    "blank time": (lines(lambda r: [*r[:4], ",1.0", *r[5:]]), ["d.csv: line 5, column 'time [ms]'", "''"]),
    "short row": (lines(lambda r: [*r[:4], "0.3", *r[5:]]), ["d.csv: line 5", "1 cell under 2 headers: '0.3'"]),
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
        ["[[experiment]] 1 resample", "20 kHz is above the 10 kHz", "no information"],
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
    "own parameter that is no number": (
        swap("noise", "parameters = { mass = nan }\nnoise"),
        ["p.toml: [[experiment]] 1 parameters.mass", "nan is not a number", "give a mass"],
    ),
    "own parameter below 0": (
        swap("noise", "parameters = { mass = -1 }\nnoise"),
        ["p.toml: parameters of d", "mass = -1 kg is out of range", "must be > 0"],
    ),
    "correlation": (swap("noise", "correlation = inf\nnoise"), ["correlation time of inf s", "finite time"]),
    "infinite noise": (swap('"1 N"', "inf"), ["[[experiment]] 1 noise", "noise = inf gives", "2 % of reading"]),
    "few samples": (
        lambda: (
            lines(lambda r: [r[0], *r[5:8]])(),
            swap("1e10\n", "1e10\n[free.exponent]\nlower = 1\nupper = 2\n[free.gain]\nlower = 0.5\nupper = 2\n")(),
        ),
        ["p.toml", "3 samples for 3 free parameters", "free fewer"],
    ),
    "never positive": (
        lambda: (swap('"force', '"-force')(), swap("noise", 'align = "onset"\nnoise')()),
        ["lines 2 to 14, column 'force [N]'", "can only push", "flip its sign"],
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
    # 10 mm away at 1 m/s, the body touches 10 ms after the start; the record ends at 1.2 ms, and its clock is the model's.
    swap("mass", "clearance_contact = 0.01\nmass", "s.toml")()
    swap("scene =", 'sensor = "exact"\nscene =')()
    refused(
        "p.toml: [free.stiffness]",
        "'stiffness' moves no residual",
        "fix it in the scene, or add data",
        outs=[("--out", "out")],
    )


def test_fewer_than_four_starts_are_refused_with_the_help(here):
    done = bcfj("calibrate", "p.toml", "--starts", "3")
    assert done.exit_code == 2 and "--starts" in done.output
