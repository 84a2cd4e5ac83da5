"""Rules by which a file is read that no list names: texts about numbers, clocks by words, settings, pages of codes, questions."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bcfj_jax import InputError
from bcfj_jax.data import clock
from bcfj_jax.data.reading import read
from bcfj_jax.data.textfile import Stated
from benchmarks.calibration import instruments
from calibration import init
from calibration.impacts.proposal import Hints

COUNT, STEP = 200, 5e-5
FORCE = instruments.FORCE[60 : 60 + COUNT]
TIMES = STEP * np.arange(COUNT)
STAMPS = [f"10:00:{t:09.6f}" for t in TIMES]
PAIRS = list(zip(TIMES, FORCE, strict=True))


def of(tmp_path, name, content, **options):
    """What is understood of a file."""
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    hints = Hints(**{k: options.pop(k) for k in ("time", "observe", "runs_by") if k in options})
    return init.found_in(path, init.Said("", "0.8 kg", "1.2 m/s", stated=Stated(**options), hints=hints))


def holds(found, *forces, step=STEP):
    """Whether these forces were read, every ``step`` seconds."""
    assert len(found.records) == len(forces)
    for run, force in zip(found.records, forces, strict=True):
        np.testing.assert_allclose(run.readings["N"], force, atol=1e-3 * force.max())
        np.testing.assert_allclose(run.clock - run.clock[0], step * np.arange(force.size), atol=1e-6)


@pytest.mark.parametrize(
    ("line", "options"),
    [
        ("I ({k}) rig: t={us} us F={f} N", {}),
        ('{{"time": {t}, "force": {f}}}', {}),
        ("[{day}] {f}", {"observe": "column 2 [N]"}),
        ("{day} -> {f}", {"observe": "column 2 [N]"}),
        ("load,rig=a force={f} {ns}", {"time": "column 2 [ns]"}),
        ("t = {us} us, F = {f} N", {}),
    ],
)
def test_a_line_may_be_a_text_about_numbers(line, options, tmp_path):
    rows = [
        line.format(k=k // 9, us=50 * k, t=f"{t:.6f}", f=f"{f:.3f}", day=STAMPS[k], ns=1764064800000000000 + 50000 * k)
        for k, (t, f) in enumerate(PAIRS)
    ]
    holds(of(tmp_path, "log.txt", "\n".join(["boot: ok", *rows]) + "\n", **options), FORCE)


def test_a_clock_is_stated_by_words_for_a_rate_or_step_of_samples():
    rates = ["Meßrate", "Fréquence d'échantillonnage", "camera fps", "Capture Frame Rate", "采样频率", "Data rate"]
    steps = ["サンプリング周期", "Sample period [us]", "Horizontal Interval", "Delta X", "dt", "Abtastzeit"]
    others = ["Number of samples", "Analog filter frequency", "Messzeit", "Recording period", "Baud rate", "Test rate"]
    assert all(clock.is_rate(key) and not clock.is_step(key) for key in rates)
    assert all(clock.is_step(key) and not clock.is_rate(key) for key in steps)
    assert not any(clock.is_rate(key) or clock.is_step(key) for key in others)


def test_titles_of_rows_and_settings_are_no_data(tmp_path):
    rows = "\n".join(f";{t:.6f};{f:.3f}" for t, f in PAIRS)
    holds(of(tmp_path, "a.csv", f"Kanal;Zeit;Kraft\nEinheit;s;N\nLänge;200;200\nKommentar;;\n{rows}\n"), FORCE)
    head = "Unit;N\nSampleRate;20 kHz\nNumber;Time (ms);A1 (N)\n"
    rows = "\n".join(f"{k};{1e3 * t:.3f};{f:.3f}" for k, (t, f) in enumerate(PAIRS))
    holds(of(tmp_path, "b.csv", head + rows + "\n"), FORCE)
    rows = "\n".join(f"{f:.3f}," for f in FORCE)
    holds(
        of(tmp_path, "c.csv", f"Memory Length,200\nSampling Period,5E-05\nVertical Units,N\nProbe,1\n{rows}\n"), FORCE
    )
    rows = "\n".join(f"{t:.6f}\t{f:.3f}" for t, f in PAIRS)
    holds(of(tmp_path, "d.txt", f"rig 3\nTime (s);Force (N)\n{rows}\n"), FORCE)


def test_pages_of_codes_are_known_by_words_of_measuring(tmp_path):
    rows = "\n".join(f"{f:.3f}" for f in FORCE)
    holds(of(tmp_path, "a.csv", f"サンプリング周期,50us\n荷重[N]\n{rows}\n".encode("cp932")), FORCE)
    rows = "\n".join(f"{t:.6f},{f:.3f}" for t, f in PAIRS)
    holds(of(tmp_path, "b.csv", f"시간(s),하중(N)\n{rows}\n".encode("cp949")), FORCE)


def test_json_and_matrices_have_the_names_that_stand_beside_them(tmp_path):
    h5py = pytest.importorskip("h5py")
    rows = [{"time": t, "load": {"force": f}} for t, f in PAIRS]
    holds(of(tmp_path, "a.json", json.dumps(rows)), FORCE)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        data = file.create_dataset("data", data=np.c_[FORCE, -FORCE])
        data.attrs.update({"names": ["Force [N]", "Acc [m/s^2]"], "sample_rate": 2e4})
        file["speeds"] = [0.9, 1.2, 1.5]
    holds(init.found_in(tmp_path / "b.h5", init.Said()), FORCE)


def test_the_clock_is_asked_for_by_what_increases_and_the_reading_by_what_stands_out(tmp_path):
    rows = "\n".join(f"{0.01 * (k % 5)},{50 * k},{f:.3f}" for k, (_, f) in enumerate(PAIRS))
    with pytest.raises(InputError) as caught:
        of(tmp_path, "a.csv", f"spare,ticks,sensor\n{rows}\n")
    assert '--time "ticks [us]" (a contact of' in str(caught.value) and '--observe "sensor [N]"' in str(caught.value)
    holds(of(tmp_path, "a.csv", f"spare,ticks,sensor\n{rows}\n", time="ticks [us]", observe="sensor [N]"), FORCE)
    rows = "\n".join(f"{1764064800000 + 0.05 * k:.2f},{f:.3f}" for k, (_, f) in enumerate(PAIRS))
    holds(of(tmp_path, "b.csv", f"time,force [N]\n{rows}\n"), FORCE)


def test_columns_that_are_hits_of_their_own_are_asked_for(tmp_path):
    late = np.roll(FORCE, 9)
    rows = "\n".join(f"{1e3 * t:.3f},{f:.3f},{g:.3f}" for t, f, g in zip(TIMES, FORCE, late, strict=True))
    text = f"t [ms],F1 [N],F2 [N]\n{rows}\n"
    with pytest.raises(InputError, match=r"2 columns hold a contact each.*--runs-by columns.*--observe"):
        of(tmp_path, "a.csv", text)
    holds(of(tmp_path, "a.csv", text, runs_by="columns"), FORCE, late)
    holds(of(tmp_path, "a.csv", text, observe="F2 [N]"), late)
    # A height above a column is no unit of it.
    with pytest.raises(InputError, match=r'no column is a force.*--observe "(50|75) mm '):
        of(tmp_path, "b.csv", f"t [ms],50 mm,75 mm\n{rows}\n")


def test_a_full_scale_and_a_sensitivity_that_the_file_states(tmp_path):
    rows = "\n".join(f"{1e3 * t:.3f},{2.25 * f:.4f}" for t, f in PAIRS)
    with pytest.raises(InputError, match=r'--sensitivity "2\.25 mV/N"'):
        of(tmp_path, "a.csv", f"Sensor,208C03\nSensitivity,2.25 mV/N\nTime (ms),Voltage (mV)\n{rows}\n")
    path = tmp_path / "two.wav"
    wavfile = pytest.importorskip("scipy.io.wavfile")
    wavfile.write(path, 20000, np.c_[FORCE / 2000.0, -FORCE / 4000.0].astype(np.float32))
    stated = Stated(full_scale="channel 1 = 2 kN, channel 2 = 400 g")
    table = read(path, "record", None, stated)
    assert [table.unit(h) for h in table.header] == ["s", "N", "m/s^2"]
    # The full scale of a converter, and the sensor before it: 10 V / 5 mV/N are 2000 N.
    stated = Stated(full_scale="10 V", sensitivity="5 mV/N, channel 2 = 25 mV/N")
    table = read(path, "record", None, stated)
    for header, factor in zip(table.header[1:], (1.0, -0.1), strict=True):
        np.testing.assert_allclose(table.numbers(header, "N", "", True), factor * FORCE, atol=1e-3)
    with pytest.raises(InputError, match='or "10 V" and the sensitivity'):
        read(path, "record", None, Stated(full_scale="10 V")).numbers("channel 1", "N", "", True)


ROWS = [f"{f:.3f},{0.01 * (k % 7):.2f}" for k, f in enumerate(FORCE)]
MS = [f"{1e3 * t:.2f}" for t in TIMES]


def test_settings_name_each_channel_and_its_unit(tmp_path):
    titled = '"Model Name","DLM"\n"TraceName","CH1","CH2"\n"VUnit","N","V"\n"HResolution"," 5.0E-05"," 5.0E-05"\n'
    titled += '"Date","2026/11/27","2026/11/27"\n'
    found = of(tmp_path, "titled.csv", titled + "".join(f",{row}\n" for row in ROWS))
    holds(found, FORCE)
    assert found.columns == {"N": "CH1 [N]"}
    units = "Model,MSO\nVertical Units,kN,V\nVertical Scale,1,2\nTIME,CH1,CH2\n"
    content = units + "".join(f"{t:.6f},{f / 1e3:.6f},0.{k % 5}\n" for k, (t, f) in enumerate(PAIRS))
    holds(of(tmp_path, "units.csv", content), FORCE)
    # A setting's value is no name, and a list of values no row of names.
    scope = "Unit:(mV)\n,CH1\nProbe attenuation,X1\nTime interval,50.0000uS\n"
    content = scope + "".join(f"{k},{0.1 * f:.4f}\n" for k, f in enumerate(FORCE, 1))
    holds(of(tmp_path, "scope.csv", content, sensitivity="0.1 mV/N"), FORCE)


def test_a_time_that_stands_still_is_no_clock_and_parts_of_seconds_go_on_with_it(tmp_path):
    still = "Sampling interval,50us\nNo.,Time,Load [N]\n" + "".join(
        f"{k},2026/11/27 10:00:00,{f:.3f}\n" for k, f in enumerate(FORCE, 1)
    )
    holds(of(tmp_path, "still.csv", still), FORCE)
    # Two seconds in a record do not tell its rate.
    stamps = [f"10:00:0{int(1.995 + t)}" for t in TIMES]
    text = "Time,Load [N]\n" + "".join(f"{day},{f:.3f}\n" for day, f in zip(stamps, FORCE, strict=True))
    with pytest.raises(InputError, match=r"no column is a time.*--rate"):
        of(tmp_path, "seconds.csv", text)
    holds(of(tmp_path, "seconds.csv", text, rate="20 kHz"), FORCE)
    parts = [f"{day},{round(1e6 * ((1.995 + t) % 1))}" for day, t in zip(stamps, TIMES, strict=True)]
    text = "Time,us,Load [N]\n" + "".join(f"{p},{f:.3f}\n" for p, f in zip(parts, FORCE, strict=True))
    holds(of(tmp_path, "parts.csv", text), FORCE)


def test_counts_are_no_volts_and_grams_of_a_weight_no_newtons(tmp_path):
    counts = "Vertical Units,V\nSampling Period,5.0E-05\nWaveform Data\n" + "".join(f"{round(f)}\n" for f in FORCE)
    with pytest.raises(InputError, match=r"is in V, and all its readings are whole numbers.*counts/N"):
        of(tmp_path, "counts.csv", counts, sensitivity="10 mV/N")
    holds(of(tmp_path, "counts.csv", counts, sensitivity="1 counts/N"), np.round(FORCE))
    heavy = "t_ms,weight_g\n" + "".join(f"{ms},{1e3 * f / 9.80665:.3f}\n" for ms, f in zip(MS, FORCE, strict=True))
    holds(of(tmp_path, "heavy.csv", heavy), FORCE)


def test_a_force_that_stands_at_its_peak_is_said_to_clip(tmp_path):
    flat = np.minimum(FORCE, np.round(0.7 * FORCE.max(), 2))
    for force, count in ((flat, 1), (FORCE, 0)):
        rows = "".join(f"{ms},{f:.3f}\n" for ms, f in zip(MS, force, strict=True))
        (tmp_path / "a.csv").write_text("t [ms],F [N]\n" + rows)
        (tmp_path / "a.toml").unlink(missing_ok=True)
        init.run(tmp_path / "a.csv", tmp_path, init.Said("", "0.8 kg", "1.2 m/s"), lambda text: None)
        assert (tmp_path / "a.toml").read_text().count("saturation =") == count


def test_a_mass_beside_the_table_is_that_of_what_strikes(tmp_path):
    rows = "".join(f"{ms};{f:.3f}\n" for ms, f in zip(MS, FORCE, strict=True)).replace(".", ",")
    text = f"{{}}\n\nZeit [ms];Kraft [N]\n{rows}"
    for line in ("Hammermasse;0,8;kg", "Total mass [kg];0,8", "Masse : 0,8 kg;", "Test Mass;800 g"):
        assert of(tmp_path, "a.csv", text.format(line)).mass == pytest.approx(0.8)
    for line in ("Specimen mass [kg];0,8", "Masse;0,8", "Masse : 0,8 kg;\nTest mass: 0,9 kg;"):
        assert of(tmp_path, "b.csv", text.format(line)).mass is None
    assert (
        of(
            tmp_path,
            "c.json",
            json.dumps({"meta": {"fs": 20e3, "unit": "kN", "mass": "800 g"}, "force": [*FORCE / 1e3]}),
        ).mass
        == 0.8
    )


def test_structs_in_lists_are_channels_or_runs_and_stamps_a_clock(tmp_path):
    one = {"name": "force", "unit": "kN", "sample_rate": 20e3, "data": [*FORCE / 1e3]}
    holds(of(tmp_path, "a.json", json.dumps({"id": 7, "channels": [one, {**one, "name": "b", "unit": "g"}]})), FORCE)
    runs = np.array([(TIMES, FORCE), (TIMES, 2.0 * FORCE)], dtype=[("t", "O"), ("F", "O")])
    holds(of(tmp_path, "b.mat", instruments.mat({"hits": runs})), FORCE, 2.0 * FORCE)
    stamps = np.datetime64("2026-11-27") + np.round(1e6 * TIMES).astype("m8[us]")
    frame = pytest.importorskip("pandas").DataFrame({"timestamp": stamps, "force_N": FORCE})
    frame.to_parquet(tmp_path / "c.parquet")
    holds(of(tmp_path, "c.parquet", (tmp_path / "c.parquet").read_bytes()), FORCE)


def test_friction_alone_beside_a_motion_is_a_force_that_rubs(tmp_path):
    clock = np.arange(600) / 200
    rows = "".join(f"{t:.3f},{np.sin(9 * t):.4f},{9 * np.tanh(99 * np.cos(9 * t)):.3f}\n" for t in clock)
    (tmp_path / "rig.csv").write_text("time [s],place [mm],friction [N]\n" + rows)
    said = []
    init.run(tmp_path / "rig.csv", tmp_path, init.Said(), said.append)
    assert any("taken for friction of a driven body" in text for text in said)
    rows = "".join(f"{t:.3f},{99 + k % 9},{3 + k % 2},{600 + k % 7}\n" for k, t in enumerate(clock))
    (tmp_path / "bit.csv").write_text("time [s],bit speed [rpm],torque [N m],weight on bit [N]\n" + rows)
    with pytest.raises(InputError, match=r"never rests.*'torque \[N m\]' is a torque: write a scene"):
        init.run(tmp_path / "bit.csv", tmp_path, init.Said(), said.append)


def test_a_table_of_channels_above_gives_units_and_axes_named_beside_a_clock(tmp_path):
    listed = "AMP settings;;;\nCH;Name;Range;Unit\nCH1;Load;5V;N\nCH2;Acc;5V;m/s2\nData;;;\nNo;t [ms];CH1;CH2\n"
    rows = "".join(f"{k};{ms};{f:.3f};0\n" for k, (ms, f) in enumerate(zip(MS, FORCE, strict=True)))
    assert of(tmp_path, "listed.csv", listed + rows).columns["N"] == "CH1 [N]"
    axes = "X-Axis Unit:\ts\nX-Axis Delta:\t5e-05\nY-Axis Unit:\tN\n"
    holds(of(tmp_path, "a.txt", axes + "".join(f"{k}\t{t:.6E}\t{f:.6E}\n" for k, (t, f) in enumerate(PAIRS))), FORCE)
    titled = "サンプリング周波数(Hz),20000\nCH名称,荷重,加速度\n単位,N,G\n"
    content = titled + "".join(f"{t:.6f},{f:.3f},{0.1 * f:.4f}\n" for t, f in PAIRS)
    holds(of(tmp_path, "b.csv", content.encode("cp932")), FORCE)
    each = "Sample Interval,Analog:5.0E-05\nVertical Units,CH1:V,CH2:V\nSource,CH1,CH2\nSecond,Volt,Volt\n"
    rows = "".join(f"{t:.6f},{0.01 * f:.5f},0.{k % 5}\n" for k, (t, f) in enumerate(PAIRS))
    holds(of(tmp_path, "c.csv", each + rows, sensitivity="CH1 = 10 mV/N"), FORCE)
    comment = "% hit 3, fs = 20 kHz\n% n force[N]\n" + "".join(f"{k} {f:.3f}\n" for k, f in enumerate(FORCE))
    holds(of(tmp_path, "d.dat", comment), FORCE)


def test_rows_that_read_several_channels_ask_for_one(tmp_path):
    rows = "".join(f"{ms},{name},{f:.3f}\n" for ms, f in zip(MS, FORCE, strict=True) for name in ("load_N", "acc"))
    (tmp_path / "long.csv").write_text("t_ms,what,value\n" + rows)
    with pytest.raises(InputError, match=r"'what' says what each row reads.*--rows \"what = load_N\""):
        init.found_in(tmp_path / "long.csv", init.Said())
    hints = Hints(observe="value [N]", rows={"what": "load_N"})
    holds(init.found_in(tmp_path / "long.csv", init.Said(hints=hints)), FORCE)
    # A text that stands beside the samples parts nothing.
    rows = "".join(
        f"{ms},{'up' if k < 90 else 'down'},{f:.3f}\n" for k, (ms, f) in enumerate(zip(MS, FORCE, strict=True))
    )
    holds(of(tmp_path, "one.csv", "t_ms,phase,load_N\n" + rows), FORCE)


def test_heights_speeds_and_runs_by_their_words(tmp_path):
    rows = [(k, ms, f) for k in (7, 8) for ms, f in zip(MS, FORCE, strict=True)]
    for name, size, unit in (
        ("Vitesse d'impact (m/s)", 0.9, "m/s"),
        ("drop_height_cm", 5, "m"),
        ("speed_mm_s", 900, "m/s"),
    ):
        text = f"shot_id,{name},t_ms,load_N\n" + "".join(f"{k},{size},{ms},{f:.3f}\n" for k, ms, f in rows)
        found = of(tmp_path, "a.csv", text)
        holds(found, FORCE, FORCE)
        assert found.runs[0] == "shot_id" and found.given == (name, unit)
        assert found.speeds == pytest.approx([np.sqrt(2 * 9.81 * 0.05) if unit == "m" else 0.9] * 2, rel=1e-3)
    text = "shot_id,rebound height (mm),t_ms,load_N\n" + "".join(f"{k},50,{ms},{f:.3f}\n" for k, ms, f in rows)
    assert of(tmp_path, "b.csv", text).given == ("", "")
    frame = pytest.importorskip("pandas").DataFrame(
        {"shot": [k for k, *_ in rows], "t_s": 1e-3 * np.array([*MS, *MS], float)}
    )
    frame.assign(force_N=[f for *_, f in rows]).to_parquet(tmp_path / "c.parquet")
    holds(of(tmp_path, "c.parquet", (tmp_path / "c.parquet").read_bytes()), FORCE, FORCE)
    for text in ("Ensayo;masa del martillo: 0,8 kg", "Pad;hmotnost = 0,8 kg"):
        rows = "".join(f"{ms};{f:.3f}\n" for ms, f in zip(MS, FORCE, strict=True)).replace(".", ",")
        assert of(tmp_path, "d.csv", f"{text}\nt [ms];F [N]\n{rows}").mass == pytest.approx(0.8)


def test_a_place_is_read_along_the_axis_that_bends_and_archives_are_to_be_unpacked(tmp_path):
    clock = np.arange(300) / 500
    high = np.abs(0.2 - 0.5 * 9.8 * clock**2) - 0.1 * (clock > 0.3)
    rows = "".join(f"{t:.3f},{2e3 * t:.3f},-3.4,{1e3 * z:.3f}\n" for t, z in zip(clock, high, strict=True))
    assert of(tmp_path, "ball.csv", "t [s],X [mm],Y [mm],Z [mm]\n" + rows).columns["m"].endswith("Z [mm]")
    with pytest.raises(InputError, match=r'--observe "Z \[mm\]"'):
        of(tmp_path, "bare.csv", "t [s],X,Y,Z\n" + rows)
    for name, begins in (("a.csv.gz", b"\x1f\x8b\x08"), ("b.zip", b"PK\x03\x04")):
        with pytest.raises(InputError, match=r"unpack it"):
            of(tmp_path, name, begins + bytes(99))
    grams = "ready\n" + "".join(f"{50 * k},{f:.3f} g\n" for k, f in enumerate(FORCE))
    with pytest.raises(
        InputError, match=r'--observe "column 2 \[g\]".*if it is an acceleration; head a weight "force \[g\]"'
    ):
        of(tmp_path, "c.txt", grams)


def test_tables_alike_but_for_a_number_and_rates_of_the_struct_about_them(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for height in (30, 60):
        sheet = book.create_sheet(f"h={height} mm")
        for row in (("t [ms]", "F [N]"), *zip(map(float, MS), FORCE.tolist(), strict=True)):
            sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    holds(of(tmp_path, "a.xlsx", (tmp_path / "a.xlsx").read_bytes()), FORCE, FORCE)
    content = {"device": "q", "fs": 20e3, "channels": [{"name": "force", "unit": "N", "data": [*FORCE]}]}
    holds(of(tmp_path, "b.json", json.dumps(content)), FORCE)


def test_monitors_counters_and_heads_of_other_loggers(tmp_path):
    rows = [f"14:03:{22 + t:06.3f} -> {1e6 * t:.0f}, {f:.2f}" for t, f in PAIRS]
    holds(of(tmp_path, "monitor.txt", "\n".join(["14:03:21.900 -> micros, force_N", *rows]) + "\n"), FORCE)
    for size in (2**16, 2**32):
        rows = "".join(f"{(size - 3000 + 50 * k) % size},{f:.3f}\n" for k, f in enumerate(FORCE))
        holds(of(tmp_path, "ticks.csv", "tick_us,force_N\n" + rows), FORCE)
    # A clock that falls back otherwise is a fault.
    rows = "".join(f"{50 * k - 1000 * (k > 90)},{f:.3f}\n" for k, f in enumerate(FORCE))
    with pytest.raises(InputError, match="times must increase"):
        of(tmp_path, "back.csv", "tick_us,force_N\n" + rows)
    head = "Kanal:;Kraft\nDelta-X:;5E-05\nX-Einheit:;s\nY-Einheit:;N\nAnzahl Werte:;200\n\n"
    rows = "".join(f"{f:.4f}\n" for f in FORCE).replace(".", ",")
    found = of(tmp_path, "famos.txt", head + rows)
    holds(found, FORCE)
    assert found.columns == {"N": "Kraft [N]"}
    rows = "".join(f"{1e3 * t:.3f}\t{f / 9.80665:.5f}\n" for t, f in PAIRS)
    found = of(tmp_path, "shock.txt", "TEST: 3\nTIME(mS)\tAMPLITUDE(G)\n" + rows)
    np.testing.assert_allclose(-found.records[0].readings["m/s^2"], FORCE, atol=1e-3 * FORCE.max())
    head = "Sample rate (samples/sec),20000\nSample,Ch 1 X (G),Ch 3 Z (G)\n"
    rows = "".join(f"{k},{0.01 * (k % 3)},{-f / 9.80665:.5f}\n" for k, f in enumerate(FORCE))
    found = of(tmp_path, "saver.csv", head + rows)
    np.testing.assert_allclose(-found.records[0].readings["m/s^2"], FORCE, atol=1e-3 * FORCE.max())
    np.testing.assert_allclose(found.records[0].clock, TIMES, atol=1e-9)
    head = "Interval=\t5e-05 s\nChannelTitle=\tForce\tAccel\nUnitName=\tN\tg\n"
    found = of(tmp_path, "chart.txt", head + "".join(f"{t:.5f}\t{f:.3f}\t{f / 8:.4f}\n" for t, f in PAIRS))
    holds(found, FORCE)
    assert found.columns == {"N": "Force [N]", "m/s^2": "-Accel [g]"}
    head = "*CREATOR\nMSR 7.0\n*CHANNEL\nTIME;ACC x;ACC z;\n*UNIT\n;G;G;\n*LIMITS\n;;;\n*DATA\n"
    rows = "".join(f"2026-03-02 {stamp};0.0;{f / 9.80665:.5f};\n" for stamp, f in zip(STAMPS, FORCE, strict=True))
    found = of(tmp_path, "msr.csv", head + rows)
    np.testing.assert_allclose(-found.records[0].readings["m/s^2"], FORCE, atol=1e-3 * FORCE.max())
    rows = "".join(
        f"{t:.6f},{f:.3f}" + (f",{2 * t:.6f},0.{k % 7}\n" if k < 90 else ",,\n") for k, (t, f) in enumerate(PAIRS)
    )
    holds(of(tmp_path, "two.csv", "X[s],Load[N],X[s],EMG[mV]\n" + rows), FORCE)


def test_a_column_that_is_one_word_throughout_numbers_no_runs(tmp_path):
    rows = "".join(f"{run},EPDM,{ms},{f:.3f}\n" for run in ("R1", "R2") for ms, f in zip(MS, FORCE, strict=True))
    for name in ("run_id", "label"):
        found = of(tmp_path, "tidy.csv", f"{name},specimen,t_ms,force_N\n" + rows)
        holds(found, FORCE, FORCE)
        assert found.runs == ("run_id" if name == "run_id" else "sweep", 2)


def test_a_marker_has_three_places_and_a_struct_beside_a_vector_is_its_head(tmp_path):
    """As Qualisys names markers, and as catman writes MATLAB files."""
    clock = np.arange(200) / 200.0
    height = np.where(clock < 0.4, 800.0 - 0.5 * 9810.0 * clock**2, 15.2)
    rows = "".join(f"1.0\t2.0\t3.0\t{50 * t:.3f}\t7.0\t{z:.3f}\n" for t, z in zip(clock, height, strict=True))
    (tmp_path / "m.tsv").write_text("FREQUENCY\t200\nMARKER_NAMES\tfloor\tball\n" + rows)
    table = read(tmp_path / "m.tsv", "record")
    assert table.header[1:] == ("floor X", "floor Y", "floor Z", "ball X", "ball Y", "ball Z")
    found = of(tmp_path, "m.tsv", (tmp_path / "m.tsv").read_text())
    assert found.columns == {"m": "-ball Z [mm]"} and found.falls
    from scipy.io import savemat

    channels = ("Zeit", "ms", 1e3 * TIMES), ("Kraft", "kN", 1e-3 * FORCE), ("Weg", "mm", TIMES)
    held = {f"Channel_{k}_Data": v[:, None] for k, (*_, v) in enumerate(channels, 1)}
    held |= {f"Channel_{k}_Header": {"SignalName": n, "Unit": u} for k, (n, u, _) in enumerate(channels, 1)}
    savemat(tmp_path / "c.mat", held)
    found = of(tmp_path, "c.mat", (tmp_path / "c.mat").read_bytes())
    assert found.time == "Zeit [ms]" and found.columns["N"] == "Kraft [kN]"
    holds(found, FORCE)
