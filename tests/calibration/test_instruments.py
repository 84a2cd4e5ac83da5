"""Files as instruments write them: clock and force are those of the record, or a message says what the file does not."""

from __future__ import annotations

import numpy as np
import pytest
from commands import bcfj

from bcfj_jax import InputError
from bcfj_jax.data import clock
from bcfj_jax.data.reading import read
from bcfj_jax.data.sensitivity import Sensitivities
from bcfj_jax.data.textfile import Stated
from bcfj_jax.io import opening
from bcfj_jax.io.usercode import forget, use_code
from benchmarks.calibration import instruments
from calibration import init, problemfile

for library in ("nptdms", "h5py", "pyuff", "ezc3d", "asammdf"):
    pytest.importorskip(library, reason="the extra io is not installed")
FILES = instruments.files()
# What no option can give: a force in dB, a file that states two clocks.
NEVER = {"decibel.csv", "two_rates.csv"}


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_an_instrument_is_read_right_or_refused(name, tmp_path):
    file = FILES[name]()
    first, message = instruments.tried(file, tmp_path, {})
    assert first == ("refused" if file.refused else "right"), message
    assert file.refused in message
    if file.said:
        assert instruments.tried(file, tmp_path, file.said) == ("right", "")
    assert file.said or first == "right" or name in NEVER


def test_a_record_says_its_channels_clock_and_provenance(tmp_path):
    (tmp_path / "a.csv").write_bytes(FILES["bluehill.csv"]().content)
    record = read(tmp_path / "a.csv", "here")
    assert [(c.name, c.unit) for c in record.channels] == [("Time", "s"), ("Extension", "mm"), ("Load", "N")]
    assert record.clock == "Time [s]" and record.provenance.reader == "text"
    assert len(record.provenance.sha256) == 64 and "names in line 6" in record.provenance.converted


def test_clipped_samples_are_left_out_and_said(tmp_path):
    path = tmp_path / "clipped.csv"
    path.write_bytes(FILES["pico_clipped.csv"]().content)
    said = init.Said("", "0.8 kg", "1.2 m/s", None, None, Stated(sensitivity="10 mV/N"))
    init.run(path, tmp_path, said, lambda line: None)
    (one,) = problemfile.prepared(tmp_path / "clipped.toml")
    assert any("saturat" in note for note in one.notes), one.notes


@pytest.mark.parametrize(
    ("text", "unit", "factor", "si_unit"),
    [
        ("2 mV/N", "V", 500.0, "N"), ("2 mV/N", "mV", 0.5, "N"), ("100 N/V", "mV", 0.1, "N"), ("4 pC/N", "pC", 0.25, "N"),
        ("100 mV/g", "V", 98.0665, "m/s^2"), ("10 mV/(m/s^2)", "mV", 0.1, "m/s^2"), ("A = 2 mV/N, B = 4 pC/N", "mV", 0.5, "N"),
        ("2 mV/V/kN", "mV/V", 500.0, "N"), ("1 kN/(mV/V)", "mV/V", 1e3, "N"), ("16 mA/kN", "mA", 62.5, "N"),
        ("4 pC/N, 100 mV/g", "V", 98.0665, "m/s^2"),
    ],
)  # fmt: skip
def test_a_sensitivity_is_volts_over_a_quantity_or_a_quantity_over_volts(text, unit, factor, si_unit):
    found = Sensitivities(text).of("A", unit)
    assert found is not None and found.si_unit == si_unit
    assert found.factor == pytest.approx(factor, rel=1e-12)


def test_a_sensitivity_says_nothing_of_another_kind_of_sensor():
    assert Sensitivities("4 pC/N").of("Ch 2", "V") is None
    with pytest.raises(InputError, match="is no sensitivity of a column in mV"):
        Sensitivities("2 mV/V/kN").of("Ch 2", "mV")


@pytest.mark.parametrize("text", ["2 N", "mV/N", "2 mV/kg", "2 apples/N"])
def test_what_is_no_sensitivity_is_refused(text):
    with pytest.raises(InputError, match=r'give one such as "2\.3 mV/N"'):
        Sensitivities(text).of("A", "V")


@pytest.mark.parametrize(
    ("cells", "last"),
    [
        (["10:00:01.5", "10:00:02"], 0.5), (["23:59:59.75", "00:00:00.25"], 0.5),
        (["2026-11-25T10:00:00Z", "2026-11-25T10:00:00.001Z"], 1e-3),
        (["25.11.2026 23:59:59,9", "26.11.2026 00:00:00,1"], 0.2), (["11:59:59 AM", "12:00:00 PM"], 1.0),
        (["10:00:01:500", "10:00:01:750"], 0.25), (["1", "2"], None),
    ],
)  # fmt: skip
def test_times_of_day_are_seconds_since_the_first(cells, last):
    found = clock.of_day(cells)
    assert (found is None) if last is None else found == pytest.approx([0.0, last], abs=1e-9)


READER = """
class Rig:
    def sniff(self, path, head):
        return head.startswith(b"MYRIG")

    def read(self, path):
        import numpy as np
        values = np.frombuffer(path.read_bytes()[5:], dtype="<f4")
        return {"time [ms]": 0.05 * np.arange(values.size), "force [N]": values}
"""


def test_a_reader_of_the_users_own(tmp_path):
    (tmp_path / "my.py").write_text(READER)
    path = tmp_path / "drop.rig"
    path.write_bytes(b"MYRIG" + instruments.FORCE.astype("<f4").tobytes())
    with pytest.raises(InputError, match=r"of no kind known here.*--code FILE"):
        read(path, "record")
    try:
        use_code(tmp_path / "my.py")
        record = read(path, "record")
        assert record.reader == "Rig"
        np.testing.assert_allclose(record.numbers("force", "N", "here", False), instruments.FORCE, rtol=1e-6)
    finally:
        forget()
    assert not opening.READERS


def test_files_of_a_pattern_are_runs(tmp_path):
    for k in (1, 2, 3):
        (tmp_path / f"run{k}.csv").write_bytes(FILES["kgf.csv"]().content)
    said = init.Said("", "0.8 kg", "1.2 m/s")
    init.run(tmp_path / "run*.csv", tmp_path / "all.toml", said, lambda line: None)
    assert 'file = "run*.csv"' in (tmp_path / "all.toml").read_text()
    assert len(problemfile.prepared(tmp_path / "all.toml")) == 3
    assert len(problemfile.sources(tmp_path / "all.toml")) == 3


@pytest.mark.parametrize("by", ["Versuchsreihe", "#", "hit"])
def test_a_column_numbers_runs_whatever_its_name(by, tmp_path):
    clock_, force = instruments.CLOCK - instruments.CLOCK[0], instruments.FORCE
    rows = [f"{k},{t:.6f},{f:.3f}" for k in (1, 2, 3) for t, f in zip(clock_, force, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join([f"{by},time [s],force [N]", *rows]) + "\n")
    init.run(tmp_path / "a.csv", tmp_path, init.Said("", "0.8 kg", "1.2 m/s"), lambda line: None)
    assert len(problemfile.prepared(tmp_path / "a.toml")) == 3


def test_a_million_samples_are_read_in_seconds(tmp_path):
    import time

    path = tmp_path / "long.csv"
    count = 300_000
    with path.open("w") as out:
        out.write("Zeit [s];Kraft [N]\n")
        out.writelines(f"{5e-5 * k:.5f};{k % 7}.5\n".replace(".", ",") for k in range(count))
    begin = time.process_time()
    record = read(path, "here")
    assert time.process_time() - begin < 5.0
    assert record.numbers("Kraft", "N", "here", False)[-1] == (count - 1) % 7 + 0.5
    assert record.lines[-1] == count + 1 and f"{count} rows, lines 2 to {count + 1}" in record.found


def test_wrong_samples_side_by_side_and_in_a_contact_are_left_out(tmp_path):
    """A spike and its echo beside it, of four times the peak; what is proposed is as of the record without them."""
    texts = []
    for spikes in ((), ((42, -1500.0), (89, -1497.0), (90, 1499.0), (117, -1411.0), (400, 1499.0), (401, -1499.0))):
        force = instruments.FORCE.copy()
        for at, value in spikes:
            force[at] = value
        rows = [f"{t:.6f},{f:.4f}" for t, f in zip(instruments.CLOCK, force, strict=True)]
        (tmp_path / "a.csv").write_text("\n".join(["time [s],force [N]", *rows]) + "\n")
        out = tmp_path / f"{len(texts)}.toml"
        init.run(tmp_path / "a.csv", out, init.Said("", "0.8 kg", "1.2 m/s"), lambda line: None)
        texts.append([line for line in out.read_text().splitlines() if not line.startswith(("#", "window"))])
        # Two samples more or less at its ends are left to the noise.
        (one,) = problemfile.prepared(out)
        assert one.times[[0, -1]] == pytest.approx([-5.45e-3, 14.2e-3], abs=0.15e-3)
    assert texts[0] == texts[1]


@pytest.mark.parametrize(("unit", "weight"), [("lbs", 4.4482216), ("kg", 9.80665)])
def test_a_force_in_a_unit_of_mass_is_a_weight_and_said(unit, weight, tmp_path):
    path = tmp_path / "a.csv"
    rows = [f"{t:.6f},{f / weight:.6f}" for t, f in zip(instruments.CLOCK, instruments.FORCE, strict=True)]
    path.write_text("\n".join([f"time [s],load [{unit}]", *rows]) + "\n")
    init.run(path, tmp_path, init.Said("", "0.8 kg", "1.2 m/s"), lambda line: None)
    assert f"CHECK: load [{unit}] is taken as the weight of so many {unit}" in (tmp_path / "a.toml").read_text()
    (one,) = problemfile.prepared(tmp_path / "a.toml")
    assert one.readings["contact.normal"].raw.max() == pytest.approx(instruments.FORCE.max(), rel=1e-5)


def _two_sensors(path):
    """Hits 1 and 2 of two sensors, B with half of A's force; "part" is 7, then 3."""
    rows = [
        f"{sensor},{part},{t:.6f},{share * f:.4f}"
        for part in (7, 3)
        for sensor, share in (("A", 1.0), ("B", 0.5))
        for t, f in zip(instruments.CLOCK - instruments.CLOCK[0], instruments.FORCE, strict=True)
    ]
    path.write_text("\n".join(["Sensor,part,time [s],force [N]", *rows]) + "\n")


def _init(path, *options):
    return bcfj("init", "calibration", path, "--out", path.with_suffix(".toml"), *options)


@pytest.mark.parametrize(("sensor", "share"), [("A", 1.0), ("B", 0.5)])
def test_rows_and_runs_by_of_the_command_line(sensor, share, tmp_path):
    path = tmp_path / "a.csv"
    _two_sensors(path)
    done = _init(path, "--mass", "0.8 kg", "--speed", "1.2 m/s", "--rows", f"Sensor = {sensor}", "--runs-by", "part")
    assert done.exit_code == 0, done.output
    text = path.with_suffix(".toml").read_text()
    assert f'rows = {{ "Sensor" = "{sensor}" }}' in text and 'runs_by = "part"' in text
    found = problemfile.prepared(path.with_suffix(".toml"))
    assert [one.name for one in found] == ["part 7", "part 3"]
    for one in found:
        raw = one.readings["contact.normal"].raw
        np.testing.assert_allclose(raw, share * instruments.FORCE, atol=1e-4)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--rows", "Sensor"), 'give a column and a value: "Sensor = A"'),
        (("--rows", "Sensor = C"), "no row has Sensor = C; values there: A, B"),
        (("--rows", "Sensors = A"), "did you mean 'Sensor'"),
        (("--runs-by", "prt"), "did you mean 'part'"),
    ],
)
def test_rows_and_columns_that_are_not_there_are_refused(options, said, tmp_path):
    _two_sensors(tmp_path / "a.csv")
    done = _init(tmp_path / "a.csv", *options)
    assert done.exit_code == 2 and said in " ".join(done.output.split()), done.output
    assert not (tmp_path / "a.toml").exists()
