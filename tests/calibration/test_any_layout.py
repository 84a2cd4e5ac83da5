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
