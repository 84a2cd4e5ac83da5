"""Every kind of measured file is read as another library wrote it; preparation keeps what was measured, and no more."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from bcfj_jax import InputError
from bcfj_jax.data import child
from bcfj_jax.data.reading import read
from bcfj_jax.data.record import Record
from bcfj_jax.io.plots import COLOURS
from calibration.impacts.plot import data
from calibration.impacts.preparation import Recipe, prepare

h5py = pytest.importorskip("h5py", reason="the extra io is not installed")
nptdms = pytest.importorskip("nptdms", reason="the extra io is not installed")
pyarrow = pytest.importorskip("pyarrow", reason="the extra io is not installed")

pytestmark = pytest.mark.filterwarnings("error")

TIME = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
FORCE = np.array([0.0, 1.0, np.nan, 0.5, 0.0])
NOTE = ["a", "b", "c", "d", "e"]


def text(path: Path, separator: str) -> None:
    rows = [
        f"{t}{separator}{'' if np.isnan(f) else f}{separator}{n}" for t, f, n in zip(TIME, FORCE, NOTE, strict=True)
    ]
    path.write_text(separator.join(["t [ms]", "F [kN]", "note"]) + "\n" + "\n".join(rows) + "\n")


def parquet(path: Path) -> None:
    from pyarrow import parquet

    unit = pyarrow.field("F", pyarrow.float64(), metadata={"unit": "kN"})
    schema = pyarrow.schema([pyarrow.field("t [ms]", pyarrow.float32()), unit, pyarrow.field("note", pyarrow.string())])
    force = [None if np.isnan(f) else f for f in FORCE]
    parquet.write_table(pyarrow.table([TIME, force, NOTE], schema=schema), path)


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run_3/sensors")
        group.create_dataset("t", data=TIME).attrs["units"] = "ms"
        group.create_dataset("F", data=FORCE.reshape(-1, 1)).attrs["unit"] = np.bytes_("kN")
        group.create_dataset("note", data=NOTE)
        group.create_dataset("rate", data=2000.0)
        group.create_dataset("frames", data=np.zeros((5, 3)))


def compound(path: Path) -> None:
    with h5py.File(path, "w") as file:
        rows = list(zip(TIME, FORCE, [n.encode() for n in NOTE], strict=True))
        file["log"] = np.array(rows, dtype=[("t [ms]", "f8"), ("F [kN]", "f4"), ("note", "S1")])


def mat5(path: Path) -> None:
    from scipy.io import savemat

    units = {"t": "ms", "F": "kN"}
    columns = {"t": TIME, "F": FORCE, "note": np.array(NOTE, dtype=object), "gain": 2.0, "units": units}
    savemat(path, {"run": columns, "who": "somebody"})


def mat73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        run = file.create_group("run")
        run.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in (("t", TIME), ("F", FORCE)):
            run.create_dataset(name, data=values.reshape(1, -1)).attrs["MATLAB_class"] = np.bytes_("double")
        run.create_dataset("note", data=NOTE)
        units = run.create_group("units")
        for name, unit in (("t", "ms"), ("F", "kN")):
            letters = np.array([[ord(c)] for c in unit], dtype=np.uint16)
            units.create_dataset(name, data=letters).attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=np.zeros(7))
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM"
    with path.open("r+b") as stream:
        stream.write(header.ljust(512, b"\0"))


def tdms(path: Path) -> None:
    columns = [("t", TIME, "ms"), ("F", FORCE, "kN"), ("note", np.array(NOTE), None)]
    with nptdms.TdmsWriter(path) as writer:
        for name, values, unit in columns:
            properties = {"unit_string": unit} if unit else {}
            writer.write_segment([nptdms.ChannelObject("rig", name, values, properties=properties)])


FORMATS = {
    ".csv": lambda path: text(path, ","),
    ".tsv": lambda path: text(path, "\t"),
    ".parquet": parquet,
    ".h5": hdf5,
    ".hdf5": compound,
    ".mat": mat5,
    "7.3.mat": mat73,
    ".tdms": tdms,
}


@pytest.mark.parametrize("kind", FORMATS)
def test_every_kind_of_file_gives_the_same_table(kind, tmp_path):
    path = tmp_path / f"record{kind}"
    FORMATS[kind](path)
    # scipy and h5py differ in whether the struct is the only table: 'who' is a text beside it.
    inside = "run" if kind == ".mat" else None
    table = read(path, "here", inside)
    np.testing.assert_allclose(table.numbers("t", "s", "here", False), 1e-3 * TIME, rtol=1e-7)
    np.testing.assert_allclose(table.numbers("F", "N", "here", True), 1e3 * FORCE, rtol=1e-7)
    assert table.texts("note", "here") == NOTE
    counted, first = ("line", 2) if kind in (".csv", ".tsv") else ("row", 1)
    assert (table.counted, list(table.lines)) == (counted, list(range(first, first + 5)))
    with pytest.raises(InputError, match=rf"{counted} {first + 2}, column 'F.*not a finite number"):
        table.numbers("F", "N", "here", False)
    with pytest.raises(InputError, match=r"column 'F.*converts to s"):
        table.numbers("F", "s", "here", True)
    with pytest.raises(InputError, match=r"no column 'G' in .*record"):
        table.numbers("G", "N", "here", True)


@pytest.mark.parametrize("kind", [".parquet", ".h5", ".mat", "7.3.mat", ".tdms"])
@pytest.mark.parametrize("damage", ["another kind", "cut short"])
def test_a_broken_file_is_refused(kind, damage, tmp_path):
    path = tmp_path / f"record{kind}"
    FORMATS[kind](path)
    path.write_bytes(b"time [s],force [N]\n0,1\n" * 20 if damage == "another kind" else path.read_bytes()[:-100])
    if kind == ".tdms" and damage == "cut short":
        # npTDMS keeps the whole segments of a file that is cut; what is missing then is a column.
        with pytest.raises(InputError, match=r"no column 'note'|different lengths"):
            read(path, "here").numbers("note", "1", "here", False)
        return
    with pytest.raises(InputError, match=rf"here: .*record{kind} cannot be read as .*extension of its kind"):
        read(path, "here", "run" if kind == ".mat" else None)


@pytest.mark.parametrize("module", ["pyarrow.parquet", "h5py", "nptdms"])
def test_a_library_that_is_missing_is_named(module, tmp_path, monkeypatch):
    kind = {"pyarrow.parquet": ".parquet", "h5py": ".h5", "nptdms": ".tdms"}[module]
    FORMATS[kind](tmp_path / f"record{kind}")
    monkeypatch.setitem(sys.modules, module, None)
    # In the process that reads, too.
    without = tmp_path / "child.py"
    source = Path(child.__file__).read_text(encoding="utf-8")
    without.write_text(source.replace("def main()", f"sys.modules[{module!r}] = None\n\n\ndef main()"))
    monkeypatch.setattr(child, "__file__", str(without))
    with pytest.raises(InputError, match=r'not installed; pip install "bcfj-jax\[io\]"'):
        read(tmp_path / f"record{kind}", "here")


def test_a_file_of_several_tables_asks_which(tmp_path):
    path = tmp_path / "runs.h5"
    with h5py.File(path, "w") as file:
        for name in ("a/fast", "a/slow"):
            file[f"{name}/F [N]"] = FORCE
        file["b/F [N]"], file["b/t [s]"] = FORCE, TIME[:3]
    with pytest.raises(InputError, match=r"holds 3 tables; choose with table = .*'a/fast', 'a/slow', 'b'"):
        read(path, "here")
    with pytest.raises(InputError, match=r"here table: no table 'a/slwo' .*did you mean 'a/slow'"):
        read(path, "here", "a/slwo")
    with pytest.raises(InputError, match=r"b: its columns have different lengths: 'F \[N\]' 5, 't \[s\]' 3"):
        read(path, "here", "b")
    assert read(path, "here", "/a/slow").name.endswith("runs.h5: a/slow")


def test_a_file_without_columns_says_how_to_store_them(tmp_path):
    from scipy.io import savemat

    savemat(tmp_path / "m.mat", {"matrix": np.zeros((4, 4, 4))})
    with pytest.raises(InputError, match=r"holds no columns.*table2struct"):
        read(tmp_path / "m.mat", "here")


def test_a_waveform_brings_its_own_clock(tmp_path):
    path = tmp_path / "wave.tdms"
    properties = {"wf_increment": 2e-5, "wf_start_offset": 1e-3, "wf_samples": 5, "unit_string": "kN"}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", "F", FORCE, properties=properties)])
    np.testing.assert_allclose(read(path, "here").numbers("time", "s", "here", False), 1e-3 + 2e-5 * np.arange(5))


def wave(path: Path, segments: int = 1) -> None:
    """Segments of 5 readings, with the clock in the channel's properties."""
    properties = {"wf_increment": 2e-5, "wf_start_offset": 0.0, "wf_samples": 5, "unit_string": "kN"}
    with nptdms.TdmsWriter(path) as writer:
        for _ in range(segments):
            writer.write_segment([nptdms.ChannelObject("rig", "F", np.arange(5.0), properties=properties)])


@pytest.mark.parametrize(
    ("cut", "kept", "said"),
    [
        (16, 8, "at least 2 of 'rig/F'"),
        (37, 5, "at least 5 of|1. bytes|not known"),
        (60, 5, "bytes"),
        (None, 5, "not known"),
    ],
)
def test_a_tdms_file_that_was_cut_off_says_what_is_missing(cut, kept, said, tmp_path, capfd, caplog):
    path = tmp_path / "wave.tdms"
    wave(path, 2)
    assert read(path, "here").found == ""
    first = tmp_path / "first.tdms"
    wave(first)
    content, second = path.read_bytes(), first.stat().st_size
    # Of the second segment 20 bytes stay, fewer than its head.
    path.write_bytes(content[: second + 20 if cut is None else -cut])
    table = read(path, "here")
    np.testing.assert_array_equal(table.numbers("F", "N", "here", False), 1e3 * np.tile(np.arange(5.0), 2)[:kept])
    assert re.search(rf"^the file is cut off: values are missing at its end \(.*{said}", table.found)
    assert not any(capfd.readouterr()) and not caplog.records


def test_columns_that_a_cut_made_unequal_are_blamed_on_the_cut(tmp_path):
    path = tmp_path / "two.tdms"
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", name, TIME) for name in ("time [s]", "F [N]")])
    path.write_bytes(path.read_bytes()[:-12])
    with pytest.raises(
        InputError, match=r"here: .*two\.tdms: the file is cut off.* 2 of 'rig/F \[N\]'.*export the file again"
    ):
        read(path, "here")


def test_dates_are_times_since_the_first(tmp_path):
    from pyarrow import parquet

    stamps = np.array(["2026-01-01T00:00:00", "2026-01-01T00:00:01"], dtype="datetime64[us]")
    parquet.write_table(pyarrow.table({"time": stamps, "F [N]": [0.0, 1.0]}), tmp_path / "d.parquet")
    np.testing.assert_array_equal(read(tmp_path / "d.parquet", "here").numbers("time", "s", "here", False), [0.0, 1.0])


def test_a_unit_may_be_given_where_the_file_has_none():
    table = Record(Path("m.mat"), ("t", "F [N]"), (TIME, FORCE), np.arange(1, 6), "row")
    np.testing.assert_allclose(table.numbers("t [ms]", "s", "here", False), 1e-3 * TIME, rtol=1e-15)
    with pytest.raises(InputError, match=r"no column 'F \[kN\]'"):
        table.numbers("F [kN]", "N", "here", True)


def record(clock: np.ndarray, force: np.ndarray, **recipe) -> tuple:
    """Times and values that preparation keeps, and all that it says."""
    table = Record(Path("d.csv"), ("t [s]", "F [N]"), (clock, force), np.arange(2, clock.size + 2))
    done = prepare("d", table, "t", {"contact.normal": "F"}, Recipe(**recipe), "p.toml: [[experiment]] 1")
    return done.times, done.readings["contact.normal"].values, "; ".join(done.notes), done


CLOCK = np.arange(2001) / 1e5


def pulse(clock: np.ndarray) -> np.ndarray:
    """A smooth 2 kN contact of about 4 ms, whose spectrum ends far below 5 kHz."""
    return 2000.0 * np.exp(-(((clock - 8e-3) / 1e-3) ** 2))


def test_resampling_keeps_the_signal_and_removes_what_would_alias():
    # 9.3 kHz would come back as 0.7 kHz at a rate of 10 kHz; it is gone instead.
    hum = 300.0 * np.sin(2 * np.pi * 9.3e3 * CLOCK)
    times, values, said, _ = record(CLOCK, pulse(CLOCK) + hum, resample=1e4)
    np.testing.assert_allclose(np.diff(times), 1e-4, rtol=1e-9)
    # The hum begins and ends abruptly, so the ends of the record are left out of the comparison.
    middle = slice(10, -10)
    assert np.abs(values - pulse(times))[middle].max() < 1.0
    assert np.abs((pulse(CLOCK) + hum)[::10] - pulse(CLOCK[::10])).max() > 100.0
    assert "resampled from 100 kHz to 10 kHz, 201 samples" in said


def test_resampling_of_an_uneven_clock():
    uneven = CLOCK + 3e-6 * np.sin(1e4 * CLOCK)
    times, values, said, _ = record(uneven, pulse(uneven), resample=1e4)
    np.testing.assert_allclose(values, pulse(times), atol=0.5)
    assert "jitter" in said


def test_nothing_is_put_into_a_gap():
    # The clock jumps over 2 ms, and 40 cells hold no number: 10 kHz has 20 and 3 to 4 samples less there.
    force = pulse(CLOCK)
    force[1200:1240] = np.nan
    stays = (CLOCK < 2e-3) | (CLOCK > 4e-3)
    times, values, said, done = record(CLOCK[stays], force[stays], resample=1e4)
    seen = times[np.isfinite(values)]
    for first, last in ((2e-3, 4e-3), (CLOCK[1199], CLOCK[1240])):
        assert not ((seen > first + 1e-9) & (seen < last - 1e-9)).any()
    np.testing.assert_allclose(values[np.isfinite(values)], pulse(seen), atol=1.0)
    np.testing.assert_allclose(done.gaps, [(1.99e-3, 4.01e-3)])
    assert (
        "a gap in time of 2.02 ms; nothing is interpolated over it" in said
        and "40 of 1800 cells hold no number" in said
    )


def test_saturated_samples_are_dropped_before_anything_smears_them():
    clipped = np.minimum(pulse(CLOCK), 1500.0)
    _, values, said, _ = record(CLOCK, clipped)
    assert 'reads 1.5 kN 107 times in a row at its peak; if it clips there, give saturation = "1.5 kN"' in said
    assert np.count_nonzero(clipped == 1500.0) == 107
    times, values, said, _ = record(CLOCK, clipped, saturation={"contact.normal": 1500.0})
    np.testing.assert_array_equal(values, np.where(pulse(CLOCK) < 1500.0, pulse(CLOCK), np.nan))
    assert "107 samples dropped as saturated" in said and "in a row" not in said
    times, values, said, _ = record(CLOCK, clipped, saturation={"contact.normal": 1500.0}, resample=1e4)
    seen = np.isfinite(values)
    np.testing.assert_allclose(values[seen], pulse(times[seen]), atol=15.0)


def test_a_quantised_peak_is_not_taken_for_clipping():
    for resolution in (20.0, 1.0, 0.3):
        read = np.round(pulse(CLOCK) / resolution) * resolution
        assert "in a row" not in record(CLOCK, read)[2]
        # The flanks leave the limit by 6 N, which a resolution of 20 N cannot tell from a natural peak.
        count = np.count_nonzero(read >= 1500.0)
        said = f"reads 1.5 kN {count} times in a row" in record(CLOCK, np.minimum(read, 1500.0))[2]
        assert said == (resolution < 20.0)
    assert "in a row" not in record(CLOCK, pulse(CLOCK))[2]


def test_the_picture_shows_what_was_left_out(tmp_path):
    """Looked at by eye once; here, that the marks of what is left out are there only where something is."""
    from matplotlib.colors import to_rgb
    from matplotlib.image import imread

    force = np.minimum(pulse(CLOCK), 1500.0)
    plain = record(CLOCK, force)[3]
    force[1200:1240] = np.nan
    marked = record(CLOCK, force, saturation={"contact.normal": 1500.0}, align=True, window=(-5e-3, 8e-3))[3]
    for name, done in (("plain", plain), ("marked", marked)):
        data([done], tmp_path / f"{name}.png")
        drawn = imread(tmp_path / f"{name}.png")[:, :, :3]
        for colour in (1, 2, 3):
            near = np.abs(drawn - np.array(to_rgb(COLOURS[colour]))).max(axis=2) < 0.02
            assert near.any() == (name == "marked")
    data([], tmp_path / "none.png")
    assert not (tmp_path / "none.png").exists()


@pytest.mark.parametrize("offset", [-900.0, 200.0, 900.0])
def test_onset_is_seen_above_the_level_at_which_the_sensor_rests(offset):
    noise = 5.0 * np.random.default_rng(5).standard_normal(CLOCK.size)
    expected = record(CLOCK, pulse(CLOCK) + noise, align=True)[3].first_contact
    found = record(CLOCK, pulse(CLOCK) + noise + offset, align=True, offset=True)[3].first_contact
    assert found == pytest.approx(expected, abs=2e-5)


def test_a_record_that_is_all_contact_has_no_rest():
    force = 100.0 + 50.0 * np.sin(2.0 * np.pi * 200.0 * CLOCK)
    assert record(CLOCK, force, align=True)[3].first_contact == CLOCK[0]


def test_jitter_is_reported():
    rng = np.random.default_rng(3)
    steps = 1e-4 * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, 200))
    clock = np.concatenate([[0.0], np.cumsum(steps)])
    said = record(clock, pulse(clock))[2]
    expected = np.sqrt(np.mean((steps / np.median(steps) - 1.0) ** 2))
    assert f"jitter {100 * expected:.2g} % of a step rms" in said and "gaps" not in said
    assert "2001 samples over 20 ms, every 10 us; an even clock" in record(CLOCK, pulse(CLOCK))[2]


def test_columns_without_a_row_are_refused(tmp_path):
    np.savez(tmp_path / "r.npz", time=np.zeros(0), force=np.zeros(0))
    with pytest.raises(InputError, match="has no rows"):
        read(tmp_path / "r.npz", "here")
