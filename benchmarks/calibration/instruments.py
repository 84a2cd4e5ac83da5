"""Are files of instruments read right, or refused with a sentence that leads on?

    python -m benchmarks.calibration.instruments

One contact, F = K d^n (1 + a d'), is written as instruments and their programs write it, from knowledge of the formats; no file
is a copy of one that a user sent. ``tests/calibration/test_instruments.py`` holds clock and force to the record. The table is
kept in ``benchmarks/results/dialects.json``.
"""

# ruff: noqa: E501 (heads of files stand here as instruments write them)
from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import common
from benchmarks.references.impact import contact

LAW = {"stiffness": 2e6, "exponent": 1.5, "damping": 0.3}
MASS, SPEED, RATE = 0.8, 1.2, 20000.0
VOLTS = "10 mV/N"


class File(NamedTuple):
    """A file: its name, content, what the command line says, and the part of a message that refuses it without ("" accepts).

    ``si``: "N", or "m/s^2" where it is the acceleration; ``digits``: by how much of the peak readings are rounded.
    """

    name: str
    content: bytes
    said: dict[str, str] = {}
    refused: str = ""
    si: str = "N"
    digits: float = 1e-3
    table: str | None = None


def record() -> tuple[np.ndarray, np.ndarray]:
    """Clock (N,) [s] from -5 ms and force (N,) [N] at 20 kHz with 2 N of noise; by SciPy."""
    clock, hit = np.arange(500) / RATE - 5e-3, contact(LAW, MASS, SPEED)

    return clock, hit.force(clock) + 2.0 * np.random.default_rng(3).standard_normal(clock.size)


CLOCK, FORCE = record()
_S = [f"{t:.6f}" for t in CLOCK]
_MS = [f"{1e3 * t:.3f}" for t in CLOCK - CLOCK[0]]
_N, _V = [f"{f:.4f}" for f in FORCE], [f"{f / 100:.6f}" for f in FORCE]
_ACC = [f"{-f / MASS / 9.80665:.5f}" for f in FORCE]
_POS = [f"{0.0005 * k:.4f}" for k in range(FORCE.size)]
_ZERO = [f"{0.02 * (k % 5):.3f}" for k in range(FORCE.size)]


def _text(
    head: str, *columns: list[str], by: str = ",", comma: bool = False, end: str = "", encoding: str = "utf-8"
) -> bytes:
    rows = [by.join(c.replace(".", ",") if comma else c for c in row) + end for row in zip(*columns, strict=True)]
    return "\r\n".join([*head.strip("\n").split("\n"), *rows, ""]).encode(encoding)


def _stamps(form: str) -> list[str]:
    from datetime import datetime, timedelta

    begin = datetime(2026, 11, 25, 23, 59, 59, 990000)
    return [(begin + timedelta(microseconds=50 * k)).strftime(form) for k in range(CLOCK.size)]


def _texts() -> list[File]:
    volts = {"sensitivity": VOLTS}
    index = [str(k) for k in range(CLOCK.size)]
    beside = [("Record Length,500", "Sample Interval,5e-05", "Source,CH1", "Vertical Units,V", "Horizontal Units,s", "Model,TBS1102")[k]
              if k < 6 else "," for k in range(CLOCK.size)]  # fmt: skip
    clipped = [c if float(c) < 3.0 else "∞" for c in _V]
    daq = [f"{f * 0.9:.4f}" for f in FORCE]
    hours = [
        f"23:59:{59.99 + 5e-5 * k:09.6f}" if 59.99 + 5e-5 * k < 60 else f"00:00:{5e-5 * k - 0.01:09.6f}"
        for k in range(500)
    ]
    return [
        File("tek_mso.csv", _text("Model,MSO46\nLabel,\nWaveform Type,ANALOG\nPoint Format,Y\nHorizontal Units,s\nSample Interval,"
             "5e-05\nRecord Length,500\nVertical Units,V\n\nTIME,CH1", _S, _V), volts, "--sensitivity"),
        File("tek_tbs.csv", _text("", beside, [""] * 500, _S, _V, end=",")[2:], volts, "--sensitivity"),
        File("keysight2.csv", _text("x-axis,1,2\nsecond,Volt,Volt", _S, _V, _ZERO), volts, "--sensitivity"),
        File("rigol_ds.csv", _text("X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-5.000000e-03,5.000000e-05", index, _V, _ZERO, end=","),
             volts, "--sensitivity"),
        File("rigol_dho.csv", _text("Time(s),CH1(V)", _S, _V), volts, "--sensitivity"),
        File("siglent.csv", _text("Record Length,Analog:500\nSample Interval,Analog:0.00005\nVertical Units,CH1:V\nVertical Scale,CH1:1.00"
             "\nHorizontal Units,s\nModel Number,SDS1104X-E\nSource,CH1\nSecond,Value", _S, _V), volts, "--sensitivity"),
        File("lecroy.csv", _text("LECROYWS3024,12345,Waveform\nSegments,1,SegmentSize,500\nSegment,TrigTime,TimeSinceSegment1\n"
             "#1,25-Nov-2026 10:00:00,0\nTime,Ampl", _S, _V), {**volts, "observe": "Ampl [V]"}, "--observe"),
        File("pico2.csv", _text("Time,Channel A,Channel B\n(ms),(V),(mV)\n", _MS, _V, _ZERO), {**volts, "observe": "Channel A [V]"},
             "--sensitivity"),
        File("pico_clipped.csv", _text("Time,Channel A\n(ms),(V)\n", _MS, clipped), volts, "--sensitivity"),
        File("rohde.csv", _text("in s,CH1 in V", _S, _V), volts, "--sensitivity"),
        File("yokogawa.csv", _text('"Header Size",12\n"Model Name","DL850"\n"TraceName","CH1"\n"VUnit","V"\n"HResolution",5.0E-05\n"HUnit",'
             '"s"\n"Horizontal Resolution",5.0E-05\n"Time","CH1 [V]"', _S, _V), volts, "--sensitivity"),
        File("bluehill.csv", _text('"Results Table 1"\n"","Maximum Load (N)"\n"1","411.2"\n\n"Results Table 2"\n"Time","Extension","Load"\n'
             '"(s)","(mm)","(N)"', *([f'"{c}"' for c in col] for col in (_S, _POS, _N)))),
        File("bluehill_de.csv", _text("Zeit;Verlängerung;Last\n(s);(mm);(kN)", _S, _POS, [f"{f / 1e3:.7f}" for f in FORCE], by=";",
             comma=True, encoding="cp1252")),
        File("testxpert.txt", _text("Prüfnorm\tDIN\nVorkraft\t0\tN\nPrüfzeit\tStandardkraft\tStandardweg\ns\tN\tmm", _S, _N, _POS, by="\t",
             comma=True, encoding="cp1252")),
        File("mts.txt", _text("MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\nData Acquisition: Timed\t\t\tTime: 10:00:00\nTime\tAxial Force\tAxial Displacement"
             "\nSec\tN\tmm", _S, _N, _POS, by="\t")),
        File("trapezium.csv", _text('"Name","1 _ 1","",\n"Time","Force","Stroke"\n"sec","N","mm"', _S, _N, _POS)),
        File("bioware2.txt", _text("BioWare Version 5\nFile name:\ttrial.dat\nSampling rate (Hz):\t20000\n\nabs time (s)\tFx\tFy\tFz\tAx\tAy\ns\tN"
             "\tN\tN\tm\tm", _S, _ZERO, _ZERO, _N, _ZERO, _ZERO, by="\t")),
        File("qualisys_f_2.tsv", _text("NO_OF_SAMPLES\t500\nFREQUENCY\t20000\nFIRST_SAMPLE\t1\nFORCE_PLATE_NAME\tplate\nForce_X\tForce_Y\tForce_Z\t"
             "Moment_X\tCOP_X", _ZERO, _ZERO, _N, _ZERO, _ZERO, by="\t")),
        File("vicon.csv", _text("Devices\n20000\n,,Plate - Force,,,Plate - Moment\nFrame,Sub Frame,Fx,Fy,Fz,Mx\n,,N,N,N,N.mm",
             [str(1 + k // 200) for k in range(500)], [str(k % 200) for k in range(500)], _ZERO, _ZERO, _N, _ZERO)),
        File("plate_bare.csv", _text("Fx,Fy,Fz,Mx,My,Mz", _ZERO, _ZERO, _N, _ZERO, _ZERO, _ZERO), {"rate": "20 kHz"},
             '--rate "20 kHz"'),
        File("catman.asc", _text("CATMAN DATA FILE\nChannels\t2\nTime  1 - default sample rate [s]\tForce [N]", _S, _N, by="\t", comma=True)),
        File("dewesoft.txt", _text("Data file: a.dxd\nSample rate: 20000 Hz\n\nTime (s)\tForce; AI 1 (N)", _S, _N, by="\t")),
        File("dewesoft_rate.txt", _text("Data file: a.dxd\nSample rate: 20000 Hz\n\nForce (N)\tAI 2 (V)", _N, _ZERO, by="\t")),
        File("testlab.txt", _text("Test.Lab export\nX-axis\tForce\nTime\tF1:+Z\ns\tN", _S, _N, by="\t")),
        File("millis.csv", _text("millis,force_N", _MS, _N), {"time": "millis [ms]"}),
        File("micros_no_names.txt", _text("", [str(50 * k) for k in range(500)], _N)[2:],
             {"time": "column 1 [us]", "observe": "column 2 [N]"}, "--time"),
        File("iso.csv", _text("Timestamp,Force (N)", _stamps("%Y-%m-%dT%H:%M:%S.%f"), _N)),
        File("german_clock.csv", _text("Zeit;Kraft [N]", _stamps("%d.%m.%Y %H:%M:%S,%f"), _N, by=";")),
        File("am_pm.csv", _text("Date/Time,Load (lbf)", _stamps("%m/%d/%Y %I:%M:%S.%f %p"), [f"{f / 4.4482216:.5f}" for f in FORCE])),
        File("midnight.csv", _text("Time;Force [N]", hours, _N, by=";")),
        File("daqami.csv", _text("Device:,USB-1608\nSample Rate (Hz):,20000\nSample,CH0 (V)", index, _V), volts, "--sensitivity"),
        File("kgf.csv", _text("time [s];load [kgf]", _S, [f"{f / 9.80665:.6f}" for f in FORCE], by=";", comma=True)),
        File("accelerometer.csv", _text("Time (s),Acceleration (mV)", _S, [f"{float(a) * 100:.4f}" for a in _ACC]), {"sensitivity": "100 mV/g"},
             "--sensitivity", "m/s^2"),
        File("charge.csv", _text("t [s],Ch 1 [pC]", _S, [f"{4 * f:.4f}" for f in FORCE]), {"sensitivity": "4 pC/N"}, "--sensitivity"),
        File("unknown_unit.txt", _text("time\tforce\tlevel\ns\tN\tdBFS", _S, _N, _ZERO, by="\t")),
        File("decibel.csv", _text("time [s],force [dB]", _S, _N), {}, "no column is a force"),
        File("comment_head.csv", _text("# rig 4\n# sampling frequency: 20 kHz\nforce_N,other", _N, _ZERO)),
        File("two_rates.csv", _text("Sampling rate (Hz),20000\nSample interval,1e-4\nforce [N],x [mm]", _N, _POS), {}, "two clocks"),
        File("two_plates.csv", _text("time [s],Fz1 [N],Fz2 [N]", _S, daq, _N), {"observe": "Fz2 [N]"}),
    ]  # fmt: skip


def _further() -> list[File]:
    """Other layouts and clocks of the same kinds of instruments, and of loggers."""
    volts, us = {"sensitivity": VOLTS}, [str(50 * k) for k in range(500)]
    bare = {"time": "column 1 [s]", "observe": "column 2 [N]"}
    pounds = [f"{f / 4.4482216:.5f}" for f in FORCE]
    plate = _text("Devices\n20000\n,,AMTI - Force,,,AMTI - CoP,,\nFrame,Sub Frame,Fx,Fy,Fz,Cx,Cy,Cz\n,,N,N,N,mm,mm,mm",
                  [str(1 + k // 20) for k in range(500)], [str(k % 20) for k in range(500)], _ZERO, _ZERO, _N, _POS, _POS, _ZERO)  # fmt: skip
    ball = _text(
        "Trajectories\n1000\n,,ball,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm", *([[str(k) for k in range(25)]] * 5)
    )
    side = [
        "Record Length,Analog:500",
        "Sample Interval,Analog:0.00005",
        "Vertical Units,CH1:V",
        "Horizontal Units,s",
        "Source,CH1",
    ]
    return [
        File("lecroy_units.csv", _text("LECROY,HDO4024,Waveform\nTime(s),Amplitude(V)", _S, _V), volts, "--sensitivity"),
        File("siglent_old.csv", _text("Record Length,500,Points\nSample Interval,5.0e-05,Second\nVertical Units,V,\nHorizontal Units,S,\n"
             "Model Number,SDS1102CML,\nSource,CH1,\nTime,CH1,\nSecond,Volt", _S, _V), volts, "--sensitivity"),
        File("siglent_beside.csv", _text("", [*side, *[","] * 495], _S, _V)[2:], volts, "--sensitivity"),
        File("pico_de.csv", _text("Zeit;Kanal A;Kanal B\n(ms);(mV);(V)\n", _MS, [f"{10 * f:.4f}" for f in FORCE], _ZERO, by=";", comma=True),
             {**volts, "observe": "Kanal A [mV]"}, "--sensitivity"),
        File("pico_us.csv", _text("Time,Average(A)\n(us),(V)\n", us, _V), volts, "--sensitivity"),
        File("catman_de.asc", _text("HBM_CATMAN_DATAFILE\t5.3\nDATUM\t25.11.2026\n\nZeit  1 - Standardmessrate\tKraft\ns\tN\nMX840B_CH 1\t"
             "MX840B_CH 2", _S, _N, by="\t", comma=True, encoding="cp1252")),
        File("catman_rate.txt", _text("Abtastrate [Hz]: 20000\nKraft [kN]\tWeg [mm]", [f"{f / 1e3:.7f}" for f in FORCE], _POS, by="\t",
             comma=True, encoding="cp1252")),
        File("vicon_two.csv", plate + b"\r\n" + ball),
        File("mso_newton.csv", _text("Model,MSO58\nHorizontal Units,s\nSample Interval,5e-05\nRecord Length,500\nVertical Units,N\n,\nLabel,\n"
             "TIME,CH1", _S, _N)),
        File("mso_two.csv", _text("Model,MSO46,,\nHorizontal Units,s,,\nVertical Units,V,,V\n,,,\nTIME,CH1,CH1 Peak Detect,CH2", _S, _V,
             [""] * 500, _ZERO), {**volts, "observe": "CH1 [V]"}, "--observe"),
        File("bare.dat", _text("", _S, _N, by=" ")[2:], bare, "--time"),
        File("bare.d", _text("", _S, _N, by="\t")[2:], bare, "--time"),
        File("names.d", _text("Time (Sec)\tForce [Newton]", _S, _N, by="\t")),
        File("pounds.csv", _text("Time (Sec),Load [lbs]", _S, pounds)),
        File("windaq.csv", _text("Relative Time,Load Cell\nsec,lbf", _S, pounds)),
        File("iso_z.csv", _text("timestamp,force [N]", [f"{s}Z" for s in _stamps("%Y-%m-%dT%H:%M:%S.%f")], _N)),
        File("iso_zone.csv", _text("time;Kraft in N", [f"{s}+01:00" for s in _stamps("%Y-%m-%d %H:%M:%S.%f")], [f.replace(".", ",") for f in _N],
             by=";")),
        File("epoch.csv", _text("timestamp_us,force_N", [str(1764064800000000 + 50 * k) for k in range(500)], _N)),
        File("german.csv", _text("Zeit in s;Kraft in N", _S, _N, by=";", comma=True)),
        File("german_16.csv", _text("Zeit;Kraft\n[s];[kN]", _S, [f"{f / 1e3:.7f}" for f in FORCE], by=";", comma=True, encoding="utf-16")),
        File("axes.csv", _text("Time (s),X (g),Y (g),Z (g)", _S, _ZERO, _ZERO, _ACC), si="m/s^2"),
        File("channel_g.csv", _text("Time(s),Ch 1(G)", _S, _ACC), si="m/s^2"),
        File("counted.csv", _text("sample,t_us,F_raw_N", [str(k) for k in range(500)], us, _N), {"observe": "F_raw_N [N]"}),
        File("signal_express.txt", _text("channel names:\nDev1/ai0\nstart times:\n11/25/2026 10:00:00.000000\ndt:\n0.000050\ndata:\nForce (N)",
             _N)),
        File("spaced.txt", _text("%  Time     Force\n%  [ms]     [N]", _MS, _N, by="   ")),
    ]  # fmt: skip


def _into(write: Callable[[io.BytesIO], Any]) -> bytes:
    """What a library that writes to a file object has written."""
    buffer = io.BytesIO()
    write(buffer)
    return buffer.getvalue()


def _through(suffix: str, write: Callable[[str], Any]) -> bytes:
    """What a library that writes to a path alone has written."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a{suffix}"
        write(str(path))
        return path.read_bytes()


def _wav24() -> bytes:
    import wave

    def write(buffer: io.BytesIO) -> None:
        with wave.open(buffer, "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(3)
            file.setframerate(int(RATE))
            samples = np.round(FORCE / 500.0 * 2**23).astype(int).tolist()
            file.writeframes(b"".join(x.to_bytes(3, "little", signed=True) for x in samples))

    return _into(write)


def _lvm(kind: str = "One", comma: bool = False, segments: int = 1, rates: tuple[float, ...] = (RATE,)) -> bytes:
    n = len(rates)
    head = (f"LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t{',' if comma else '.'}\nMulti_Headings\tYes\n"
            f"X_Columns\t{kind}\n***End_of_Header***\t\n\t\n")  # fmt: skip
    steps = "\t".join(f"{1 / r:.8f}" for r in rates)
    part = "\t".join(
        ["Channels", str(n), "\nSamples", *["500"] * n, "\nY_Unit_Label", *["Newton"] * n, "\nX0", *["0.0"] * n]
    ).replace("\t\n", "\n")
    part += f"\nDelta_X\t{steps}\n***End_of_Header***\t\n"
    multi = kind == "Multi"
    part += "\t".join(
        (x for j in range(n) for x in ("X_Value", f"Force {j + 1}"))
        if multi
        else ("X_Value", *(f"Force {j + 1}" for j in range(n)))
    )
    rows = []
    for k in range(500):
        x = "" if kind == "No" else f"{k / rates[0]:.6f}"
        cells = [x, *([_N[k]] * n)] if not multi else [c for r in rates for c in (f"{k / r:.6f}", _N[k])]
        rows.append("\t".join(cells))
    body = part + "\tComment\n" + "\n".join(rows) + "\n"
    if comma:
        body = body.replace(".", ",")
    return (head + "\n".join([body] * segments)).encode()


def tdms(group: str, channels: Mapping[str, tuple[np.ndarray, dict[str, Any]]]) -> bytes:
    """A TDMS file of channels with their properties."""
    import nptdms

    def write(buffer: io.BytesIO) -> None:
        with nptdms.TdmsWriter(buffer) as writer:
            made: list[Any] = [nptdms.ChannelObject(group, name, *one) for name, one in channels.items()]
            writer.write_segment(made)

    return _into(write)


def _tdms(rates: tuple[float, ...], apart: int = 0) -> bytes:
    """Channels of these rates, each begun so many microseconds after the one before."""
    channels = {}
    for k, rate in enumerate(rates):
        has: dict[str, Any] = {"wf_increment": 1 / rate, "wf_start_offset": 0.0, "wf_samples": 500, "unit_string": "N"}
        if apart:
            has["wf_start_time"] = np.datetime64("2026-11-25T10:00:00") + np.timedelta64(k * apart, "us")
        channels[f"Force {k + 1}"] = FORCE, has
    return tdms("rig", channels)


def _wav(kind: Any, channels: int = 1) -> bytes:
    from scipy.io import wavfile

    share, size = FORCE / 500.0, np.dtype(kind)
    values = (share if size.kind == "f" else np.round(share * 2 ** (8 * size.itemsize - 1))).astype(kind)
    every = np.stack([values] + [np.zeros_like(values)] * (channels - 1), axis=1) if channels > 1 else values
    return _into(lambda buffer: wavfile.write(buffer, int(RATE), every))


def mat(content: dict[str, Any]) -> bytes:
    """A MATLAB file."""
    from scipy.io import savemat

    return _into(lambda buffer: savemat(buffer, content))


def hdf5(sets: Mapping[str, tuple[np.ndarray, dict[str, Any]]]) -> bytes:
    """An HDF5 file of data sets with their attributes."""
    import h5py

    def write(buffer: io.BytesIO) -> None:
        with h5py.File(buffer, "w") as file:
            for name, (values, has) in sets.items():
                file.create_dataset(name, data=values).attrs.update(has)

    return _into(write)


def _uff(binary: bool) -> bytes:
    import pyuff

    def write(path: str) -> None:
        one = pyuff.prepare_58(
            binary=0, func_type=1, rsp_node=1, rsp_dir=3, ref_dir=0, ref_node=0, data=FORCE, x=CLOCK - CLOCK[0], id1="Force",
            rsp_ent_name="NONE", ref_ent_name="NONE", abscissa_spacing=1, abscissa_spec_data_type=17, ordinate_spec_data_type=13,
            orddenom_spec_data_type=0, ordinate_axis_units_lab="N",
            abscissa_axis_units_lab="s", abscissa_min=0.0, abscissa_inc=1 / RATE, num_pts=500, ord_data_type=4, z_axis_value=0.0,
        )  # fmt: skip
        pyuff.UFF(path).write_sets([one], "overwrite")

    text = _through(".uff", write)
    if not binary:
        return text
    head = text.split(b"\n")[2:13]
    second = f"    58b{1:6d}{2:6d}{11:12d}{8 * FORCE.size:12d}{0:6d}{0:6d}{0:12d}{0:12d}".encode()
    return b"\n".join([b"    -1", second, *head, FORCE.astype("<f8").tobytes() + b"\n    -1", b""])


def _mdf() -> bytes:
    import asammdf

    def write(path: str) -> None:
        with asammdf.MDF(version="4.10") as file:
            file.append([asammdf.Signal(FORCE, CLOCK - CLOCK[0], unit="N", name="Force")])
            file.save(path)

    return _through(".mf4", write)


def _c3d() -> bytes:
    import ezc3d

    def write(path: str) -> None:
        file: Any = ezc3d.c3d()
        file["parameters"]["POINT"]["RATE"]["value"] = [RATE]
        file["parameters"]["POINT"]["LABELS"]["value"] = []
        file["parameters"]["ANALOG"]["RATE"]["value"] = [RATE]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = ["Fz"]
        file["parameters"]["ANALOG"]["UNITS"]["value"] = ["N"]
        file["data"]["points"] = np.zeros((4, 0, 500))
        file["data"]["analogs"] = FORCE.reshape(1, 1, -1)
        file.write(path)

    return _through(".c3d", write)


def _c3d_plate() -> bytes:
    """A plate that is hit at x = 20 mm, y = 30 mm, with a ball that lies still; the reaction is along -z."""
    import ezc3d

    def write(path: str) -> None:
        file: Any = ezc3d.c3d()
        has = file["parameters"]
        has["POINT"]["RATE"]["value"], has["POINT"]["LABELS"]["value"] = [200.0], ["ball"]
        has["POINT"]["UNITS"]["value"], has["ANALOG"]["RATE"]["value"] = ["mm"], [RATE]
        has["ANALOG"]["LABELS"]["value"] = [f"{kind}{axis}" for kind in "FM" for axis in "xyz"]
        has["ANALOG"]["UNITS"]["value"] = ["N"] * 3 + ["Nmm"] * 3
        file["data"]["points"] = np.ones((4, 1, 5))
        file["data"]["analogs"] = np.outer([0, 0, -1, -30, 20, 0], FORCE)[None]
        corners = np.array([[300, 200, 0], [-300, 200, 0], [-300, -200, 0], [300, -200, 0]], dtype=float).T[:, :, None]
        origin, channels = np.array([[0.0], [0.0], [-40.0]]), np.arange(1.0, 7.0).reshape(6, 1)
        for name, value in (("USED", [1, 0]), ("TYPE", [2, 0]), ("ZERO", [0, 0]), ("CHANNEL", channels), ("CORNERS", corners),
                            ("ORIGIN", origin)):  # fmt: skip
            file.add_parameter("FORCE_PLATFORM", name, value)
        file.write(path)

    data = bytearray(_through(".c3d", write))
    group = data.index(b"FORCE_PLATFORM")
    # ezc3d writes these as numbers of 4 bytes (type 4), and reads them as whole ones of 2 alone.
    for name, count in ((b"USED", 2), (b"TYPE", 2), (b"ZERO", 2), (b"CHANNEL", 6)):
        at = group
        while data[at - 2] != len(name):
            at = data.index(name, at + 1)
        kind = at + len(name) + 2
        first = kind + 2 + data[kind + 1]
        whole = np.frombuffer(bytes(data[first : first + 4 * count]), "<f4").astype("<i2")
        data[first : first + 4 * count] = whole.tobytes() + bytes(2 * count)
        data[kind], data[kind + 2] = 2, 2 * data[kind + 2]
    return bytes(data)


def _binaries() -> dict[str, Callable[[], File]]:
    pairs, full, volts = np.c_[CLOCK, FORCE], {"full_scale": "500 N"}, {"sensitivity": VOLTS}
    pico = {"Tstart": -5e-3, "Tinterval": 5e-5, "Length": 500.0, "A": (FORCE / 100.0).reshape(-1, 1)}
    scope, columns = {"observe": "A [V]", **volts}, {"time": "column 1 [s]", "observe": "column 2 [N]"}
    named, two = {"time": CLOCK - CLOCK[0], "force": FORCE}, (RATE, 2e3)
    force = {"daq/force": (FORCE, {"unit": "N", "sample_rate": RATE})}
    # The content, and what else a ``File`` is told.
    every: dict[str, tuple[Any, ...]] = {
        "lvm_two.lvm": (lambda: _lvm(rates=(RATE, RATE)),),
        "lvm_comma.lvm": (lambda: _lvm(comma=True),),
        "lvm_segments.lvm": (lambda: _lvm("No", segments=3),),
        "lvm_two_clocks.lvm": (lambda: _lvm("Multi", rates=two), {"table": "Force 1"}, "--table"),
        "wave.tdms": (lambda: _tdms((RATE,)), {}, "", "N", 1e-9),
        "two_clocks.tdms": (lambda: _tdms((RATE, 5e3)), {"table": "rig/Force 1"}, "--table"),
        "two_starts.tdms": (lambda: _tdms((RATE, RATE), 1500), {"table": "rig/Force 1"}, "--table"),
        "force58.uff": (lambda: _uff(False),),
        "force58b.uff": (lambda: _uff(True),),
        "int16.wav": (lambda: _wav(np.int16), full, "--full-scale"),
        "int32.wav": (lambda: _wav(np.int32, 2), full, "--full-scale"),
        "int24.wav": (_wav24, full, "--full-scale"),
        "matrix.npy": (lambda: _into(lambda buffer: np.save(buffer, pairs)), columns, "--time"),
        "named.npz": (lambda: _into(lambda buffer: np.savez(buffer, **named)), {}, "", "N", 1e-9),
        "float.wav": (lambda: _wav(np.float32), full, "--full-scale"),
        "pico.mat": (lambda: mat(pico), scope, "--observe"),
        "matrix.mat": (lambda: mat({"data": pairs}), {"time": "data 1 [s]", "observe": "data 2 [N]"}, "--time"),
        "rate.mat": (lambda: mat({"force": FORCE, "fs": RATE}), {}, "", "N", 1e-9),
        "rate.h5": (lambda: hdf5(force), {}, "", "N", 1e-9),
        "drop.mf4": (_mdf, {}, "", "N", 1e-9),
        "plate_arm.c3d": (_c3d_plate, {}, "", "N", 1e-6),
        "plate.c3d": (_c3d, {}, "", "N", 1e-6),
    }  # fmt: skip
    return {name: lambda name=name, one=one: File(name, one[0](), *one[1:]) for name, one in every.items()}


def files() -> dict[str, Callable[[], File]]:
    """Every file by name; binary ones are written on call, by their libraries."""
    return {**{f.name: (lambda f=f: f) for f in [*_texts(), *_further()]}, **_binaries()}


def tried(file: File, folder: Path, said: dict[str, str]) -> tuple[str, str]:
    """What comes of a file: "right", "refused" or "wrong", and the message."""
    from bcfj_jax import InputError
    from bcfj_jax.data.textfile import Stated
    from calibration import init
    from calibration.impacts.proposal import Hints

    path = folder / file.name
    path.write_bytes(file.content)
    how = Stated(sensitivity=said.get("sensitivity"), full_scale=said.get("full_scale"), rate=said.get("rate"))
    try:
        found = init.found_in(
            path, init.Said(table=said.get("table"), stated=how, hints=Hints(said.get("time"), said.get("observe")))
        )
    except InputError as error:
        return "refused", str(error)
    one = found.records[0]
    values = one.readings.get(file.si)
    if values is None:
        return "wrong", f"read as {found.columns}"
    want = FORCE if file.si == "N" else -FORCE / MASS
    seen = np.isfinite(values)
    clock = np.abs(one.clock - one.clock[0] - (CLOCK - CLOCK[0])).max() if one.clock.size == CLOCK.size else np.inf
    away = np.abs(values - want)[seen].max() / np.abs(want).max() if values.size == want.size and seen.any() else np.inf
    return (
        ("right", "")
        if clock < 2e-6 and away < file.digits
        else ("wrong", f"clock off by {clock:.3g} s, force by {away:.3g}")
    )


def main() -> int:
    """Try every file without and with what its instrument does not write, print and keep the table."""
    rows = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, make in files().items():
            file = make()
            first, message = tried(file, Path(folder), {})
            then = tried(file, Path(folder), file.said)[0] if file.said and first == "refused" else first
            leads = first != "refused" or (bool(file.refused) and file.refused in message)
            rows[name] = {"at once": first, "with what the message names": then, "message leads on": leads}
            print(f"{name:24} {first:8} {then:8} {'' if leads else message}")
    ends = [r["with what the message names"] for r in rows.values()]
    summary = {"files": len(rows), **{end: ends.count(end) for end in ("right", "refused", "wrong")}}
    leading = sum(r["message leads on"] for r in rows.values() if r["at once"] == "refused")
    print(summary, f"{leading} refusals lead on")
    common.add("dialects", {"instruments": {"count": summary, "files": rows}})
    return int(summary["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main())
