"""Layouts put together by chance from what instruments write: the runs that are read are those that were written."""

from __future__ import annotations

from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy.io import savemat

from bcfj_jax import InputError
from bcfj_jax.data.columns import wrong_length
from bcfj_jax.data.record import Record
from bcfj_jax.data.textfile import Stated
from benchmarks.calibration import instruments
from calibration import init, problemfile
from calibration.impacts.proposal import Hints

COUNT, STEP = 260, 5e-5
FORCE = instruments.FORCE[60 : 60 + COUNT]
RUNS = [FORCE, 0.8 * FORCE, 0.6 * FORCE[: COUNT - 30]]
NAMED = {
    "square": "{} [{}]",
    "round": "{} ({})",
    "slash": "{} / {}",
    "in": "{} in {}",
    "brace": "{} {{{}}}",
    "row": "{}",
}
PREAMBLES = (
    [], ["Model,MSO46", "Serial Number,C0123"], ["# Prüfer: Müller", "# 25.11.2026"], ["Operator: lab", "Points: 260"],
    ["File name;drop.dat", "Recording started;25.11.2026 10:00:00", ""],
)  # fmt: skip


def stamps(count):
    begin = datetime(2026, 11, 25, 23, 59, 59, 995000)
    return [(begin + timedelta(microseconds=50 * k)).strftime("%Y-%m-%dT%H:%M:%S.%f") for k in range(count)]


def written(rng):
    """A file, and the options that it needs."""
    style, (unit, scale) = (
        str(rng.choice(list(NAMED))),
        [("N", 1.0), ("kN", 1e-3), ("lbf", 1 / 4.4482216)][rng.integers(3)],
    )
    by, comma = [(",", False), (";", True), (";", False), ("\t", True), ("\t", False)][rng.integers(5)]
    clock = str(rng.choice(["s", "ms", "us", "stamps", "rate"]))
    runs = str(rng.choice(["one", "column", "sweeps", "again", "beside"])) if clock in ("s", "ms", "us") else "one"
    factor = {"s": 1.0, "ms": 1e3, "us": 1e6}.get(clock, 0.0)

    def cells(force):
        digits = [f"{factor * STEP * k:.7g}" for k in range(force.size)]
        times = stamps(force.size) if clock == "stamps" else digits
        body = [[] if clock == "rate" else times, [f"{scale * f:.9f}" for f in force]]
        return [
            [c.replace(".", ",") if comma and clock != "stamps" else c for c in column] for column in body if column
        ]

    def heads(label=""):
        units = [u for u in ({"stamps": "", "rate": None}.get(clock, clock), unit) if u is not None]
        names = [f"{label}{n}" for n in ("Zeit", "Kraft")[-len(units) :]]
        if style == "row":
            return [by.join(names), by.join(f"[{u}]" if u else "" for u in units)]
        return [by.join(NAMED[style].format(n, u) if u else n for n, u in zip(names, units, strict=True))]

    def rows(columns):
        return [by.join(row) for row in zip(*columns, strict=True)]

    every = RUNS if runs != "one" else RUNS[:1]
    lines = [*PREAMBLES[rng.integers(len(PREAMBLES))]]
    lines += [f"Sample rate: {1 / STEP:g} Hz"] if clock == "rate" else []
    if runs == "beside":
        tables = [heads(f"Run {k + 1} ") for k in range(len(every))]
        lines += [by.join(parts) for parts in zip(*tables, strict=True)]
        columns = [c + [""] * (COUNT - len(c)) for force in every for c in cells(force)]
        lines += rows(columns)
    elif runs == "column":
        head = heads()
        lines += [by.join(("Versuch", head[0])), *(by + h for h in head[1:])]
        lines += [by.join((str(k + 1), row)) for k, force in enumerate(every) for row in rows(cells(force))]
    else:
        for k, force in enumerate(every):
            lines += ([""] if k else []) + (heads() if not k or runs == "again" else []) + rows(cells(force))
    lines += [[], ["", f"Maximum{by}1"], ["*** end of data ***"]][rng.integers(3)] if runs in ("one", "column") else []
    end, mark = str(rng.choice(["\n", "\r\n", "\r"])), by if rng.integers(4) == 0 and runs != "column" else ""
    coding = str(rng.choice(["utf-8", "utf-8-sig", "cp1252", "utf-16"]))
    return end.join(line + (mark if line else "") for line in [*lines, ""]).encode(coding), every, unit, style, runs


@pytest.mark.parametrize("seed", range(24))
def test_what_is_read_is_what_was_written(seed, tmp_path):
    content, every, *how = written(np.random.default_rng([51, seed]))
    path = tmp_path / "a.txt"
    path.write_bytes(content)
    found = init.found_in(path, init.Said())
    assert len(found.records) == len(every), how
    for one, force in zip(found.records, every, strict=True):
        np.testing.assert_allclose(one.readings["N"], force, atol=1e-5 * FORCE.max(), err_msg=str(how))
        np.testing.assert_allclose(one.clock - one.clock[0], STEP * np.arange(force.size), atol=1e-9, err_msg=str(how))
    init.run(path, tmp_path / "a.toml", init.Said("", "0.8 kg"), lambda line: None)
    raw = [r.readings["contact.normal"].raw for r in problemfile.prepared(tmp_path / "a.toml")]
    assert [len(r) for r in raw] == [len(f) for f in every], how


def file(tmp_path, head, *columns):
    """A file of columns under a head."""
    rows = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


TIMES = [f"{1e3 * STEP * k:.3f}" for k in range(COUNT)]


def test_a_clock_without_a_unit_is_asked_for_where_seconds_cannot_be(tmp_path):
    path = file(tmp_path, "time,force", TIMES, FORCE)
    with pytest.raises(InputError, match=r'"time \[ms\]", 8.* or "time \[us\]"'):
        init.found_in(path, init.Said())
    found = init.found_in(path, init.Said(hints=Hints("time [ms]")))
    assert found.records[0].clock[1] == pytest.approx(STEP)


def test_a_reading_is_on_the_clock_before_it_and_two_clocks_are_asked_for(tmp_path):
    late = [f"{float(t) + 7.0:.3f}" for t in TIMES]
    slow = [t if k % 2 == 0 and k < 99 else "" for k, t in enumerate(TIMES)]
    found = init.found_in(file(tmp_path, "ta [ms],temp [degC],tb [ms],F [N]", slow, slow, late, FORCE), init.Said())
    assert found.time == "tb [ms]" and found.records[0].clock[0] == pytest.approx(7e-3)
    path = file(tmp_path, "ta [ms],Fa [N],tb [ms],Fb [N]", TIMES, FORCE, late, 2.0 * FORCE)
    with pytest.raises(InputError, match=r'2 clocks.*--time "ta \[ms\]" --observe "Fa \[N\]"'):
        init.found_in(path, init.Said())
    found = init.found_in(path, init.Said(hints=Hints("ta [ms]")))
    assert found.columns == {"N": "Fa [N]"}


def test_a_record_without_a_clock_has_the_rate_that_is_stated(tmp_path):
    path = file(tmp_path, "Sample,Force (N)", range(COUNT), FORCE)
    with pytest.raises(InputError, match='--rate "20 kHz"'):
        init.found_in(path, init.Said())
    init.run(path, tmp_path, init.Said("", "0.8 kg", stated=Stated(rate="20 kSa/s")), lambda line: None)
    (one,) = problemfile.prepared(tmp_path / "a.toml")
    assert np.diff(one.clock) == pytest.approx(STEP)
    for rate, said in (("fast", "no rate"), ("20 kHz", "has a clock")):
        path = file(tmp_path, "Force (N),t [ms]" if said != "no rate" else "Force (N),n", FORCE, TIMES)
        with pytest.raises(InputError, match=said):
            init.found_in(path, init.Said(stated=Stated(rate=rate)))


@pytest.mark.parametrize(
    ("head", "scale"), [("t_ms,force_lbf", 4.4482216), ("t_ms,load_kg", 9.80665), ("t {ms},Weight(g)", 9.80665e-3)]
)  # fmt: skip
def test_a_unit_behind_a_name_is_not_taken_for_newtons(head, scale, tmp_path):
    found = init.found_in(file(tmp_path, head, TIMES, FORCE / scale), init.Said())
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE, rtol=1e-6)


def test_the_change_of_speed_of_an_acceleration_is_not_divided_by_the_mass(tmp_path):
    path = file(tmp_path, "t [ms],a [m/s^2]", TIMES, -FORCE / 0.8)
    init.run(path, tmp_path, init.Said("", "0.8 kg", "1.2 m/s"), lambda line: None)
    text = (tmp_path / "a.toml").read_text()
    assert "CHECK: impulse" not in text and "damping = {" in text


@pytest.mark.parametrize(
    ("size", "said"), [(100, ""), (112, ""), (90, "cut off: it lacks 10 bytes"), (113, "13 bytes more than it states")]
)
def test_a_file_of_another_length_than_it_states_is_said(size, said):
    assert said in wrong_length(size, 100, 112) and bool(said) == bool(wrong_length(size, 100, 112))


KN = [f"{f / 1e3:.8f}" for f in FORCE]
DAYS = [f"0 days 00:00:00.{50 * k:06d}" for k in range(COUNT)]
# Head, columns, what parts them, and the encoding.
OTHERS = {
    "numbers with labels and units": ("", [f"t={t} ms" for t in TIMES], [f"F = {f} kN" for f in KN], ", ", "utf-8"),
    "numbers with units": ("Time;Force", [f"{t} ms" for t in TIMES], [f"{f} kN" for f in KN], ";", "utf-8"),
    "columns in comments": ("# rig A\n# column 1: time [ms]\n# column 2: force [kN]", TIMES, KN, " ", "utf-8"),
    "units in a comment": ("# units: ms, kN\ntime,force", TIMES, KN, ",", "utf-8"),
    "units in a sentence": ("# time in ms; all forces are in kN\ntime,force", TIMES, KN, ",", "utf-8"),
    "Cyrillic": ("Время, мс;Сила, кН", TIMES, KN, ";", "cp1251"),
    "words": ("Temps;Force\nmillisecondes;kilonewtons", TIMES, KN, ";", "utf-8"),
    "capitals": ("TIME (MS),FORCE (KN)", TIMES, KN, ",", "utf-8"),
    "sums below names": ("Time [ms],Force [kN]\nMin,-0.1\nMax,4.2", TIMES, KN, ",", "utf-8"),
    "a row that repeats names": ("Number,Time,CH1\nNO.,ms,kN", TIMES, KN, ",", "utf-8"),
    "a line below names": ("Time [ms]  Force [kN]\n---------  ----------", TIMES, KN, "  ", "utf-8"),
    "differences of time": (",Force [kN]", DAYS, KN, ",", "utf-8"),
    "marked as texts": ("'Time [ms]','Force [kN]'", [f"'{t}'" for t in TIMES], [f"'{f}'" for f in KN], ",", "utf-8"),
    "units as names": ("ms;kN", TIMES, KN, ";", "utf-8"),
    "a comment behind": ("Time [ms],Force [kN]", TIMES, [*KN[:-1], f"{KN[-1]} # end"], ",", "utf-8"),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_units_and_names_wherever_they_stand(name, tmp_path):
    head, times, forces, by, encoding = OTHERS[name]
    columns = ([str(k) for k in range(COUNT)], times, forces) if "NO." in head else (times, forces)
    rows = [by.join(row) for row in zip(*columns, strict=True)]
    path = tmp_path / "a.txt"
    path.write_text("\n".join([*filter(None, [head]), *rows]) + "\n", encoding=encoding)
    (one,) = init.found_in(path, init.Said()).records
    assert np.diff(one.clock) == pytest.approx(STEP)
    np.testing.assert_allclose(one.readings["N"], FORCE, atol=1e-4)


def test_channels_in_rows_and_numbers_without_a_blank_between(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(f"time [ms],{','.join(TIMES)}\nforce [kN],{','.join(KN)}\n")
    np.testing.assert_allclose(init.found_in(path, init.Said()).records[0].readings["N"], FORCE, atol=1e-4)
    rows = [f"{float(t):12.5E}{-f - 20.0:12.5E}{-float(t) - 1.0:12.5E}" for t, f in zip(TIMES, FORCE, strict=True)]
    path.write_text("\n".join(["T(MS) F(N) X(MM)", *rows]) + "\n")
    found = init.found_in(path, init.Said())
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE + 20.0, atol=2e-3)


def test_what_stands_for_no_number_is_none_and_a_sum_goes_before_its_parts(tmp_path):
    holes = [-9999.0 if k % 41 in (7, 8, 9) else f for k, f in enumerate(FORCE)]
    read = init.found_in(file(tmp_path, "t [ms],F [N]", TIMES, holes), init.Said()).records[0].readings["N"]
    assert np.isnan(read[7]) and np.nanmax(np.abs(read - FORCE)) < 1e-9
    parts = (0.3 * FORCE, 0.7 * FORCE, FORCE)
    found = init.found_in(file(tmp_path, "t [ms],Kraft 1 [N],Kraft 2 [N],Summe [N]", TIMES, *parts), init.Said())
    assert found.columns == {"N": "Summe [N]"}


def test_pixels_and_counts_are_no_lengths_and_no_forces(tmp_path):
    path = file(tmp_path, "t [ms],X [px]", TIMES, np.cumsum(np.clip(10.0 - FORCE / 100.0, -10.0, 10.0)))
    with pytest.raises(InputError, match='--sensitivity "20 px/mm"'):
        init.found_in(path, init.Said())
    counts = np.round(85.0 * FORCE).astype(int)
    with pytest.raises(InputError, match="all its readings are whole numbers, as a converter counts"):
        init.found_in(file(tmp_path, "t [ms],force", TIMES, counts), init.Said())
    said = init.Said(stated=Stated(sensitivity="85 counts/N"), hints=Hints(observe="force [counts]"))
    read = init.found_in(tmp_path / "a.csv", said).records[0].readings["N"]
    np.testing.assert_allclose(read, FORCE, atol=0.01)


def said(path, text, **stated):
    path.write_text(text)
    return init.found_in(path, init.Said(stated=Stated(**stated)))


def lines(head, *columns):
    return "\n".join([head, *(",".join(map(str, row)) for row in zip(*columns, strict=True))])


def test_seconds_and_their_parts_in_two_columns_are_one_clock(tmp_path):
    ticks = 987_654_321 + 50_000 * np.arange(COUNT)
    whole, part = 1_741_684_000 + ticks // 10**9, ticks % 10**9
    for names in ("stamp.secs,stamp.nsecs", "tv_sec,tv_nsec", "Seconds,Nanoseconds", "Time (s),Time (ns)"):
        (run,) = said(tmp_path / "a.csv", lines(f"{names},F [N]", whole, part, FORCE)).records
        np.testing.assert_allclose(run.clock - run.clock[0], STEP * np.arange(COUNT), atol=1e-8)
    # Milliseconds since the start beside seconds since the start are no parts of these.
    ms = 0.05 * np.arange(COUNT)
    found = said(tmp_path / "a.csv", lines("time_s,time_ms,F [N]", ms / 1e3, ms, FORCE))
    assert found.time == "time_ms" and np.diff(found.records[0].clock) == pytest.approx(STEP)


def test_names_that_stand_twice_beside_one_clock_are_numbered(tmp_path):
    text = lines("t [ms],Fx [N],Fz [N],Fx [N],Fz [N]", TIMES, 0 * FORCE, 1.0 + 0 * FORCE, 0.1 * FORCE, FORCE)
    assert said(tmp_path / "a.csv", text).columns == {"N": "Fz 2 [N]"}
    with pytest.raises(InputError, match=r"2 columns .* 'Fz \[N\]'; give 'Fz 1 \[N\]' or 'Fz 2 \[N\]'"):
        init.found_in(tmp_path / "a.csv", init.Said(hints=Hints(observe="Fz [N]")))
    units = lines("V1,,V2,", ["t in ms", *TIMES], ["F in kN", *KN], ["t in ms", *TIMES], ["F in kN", *KN])
    found = said(tmp_path / "a.csv", units)
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE, atol=1e-4)


@pytest.mark.parametrize(
    "form", ["{2},{3},{1:+010.4f}kg", "{0} {2},{3},{1:+010.4f} kg", "{0},{2},{3},{1:+.4f} kg", "S {4} {1:10.4f} kg"]
)
def test_flags_of_a_weighing_indicator_are_no_names(form, tmp_path):
    stamped = [f"10:02:03.{50 * k // 1000:03d}{50 * k % 1000:03d}" for k in range(COUNT)]
    weights, step = FORCE / 9.80665, np.abs(np.diff(FORCE, prepend=0.0)) < 1.0
    flags = [("ST" if still else "US", "GS", "S" if still else "D") for still in step]
    rows = [form.format(t, w, *f) for t, w, f in zip(stamped, weights, flags, strict=True)]
    path = tmp_path / "a.txt"
    path.write_text("\n".join(rows))
    hints = Hints(observe=f"column {2 if '{0}' in form else 1} [kgf]")
    stated = Stated(rate=None if "{0}" in form else "20 kHz")
    (run,) = init.found_in(path, init.Said(stated=stated, hints=hints)).records
    np.testing.assert_allclose(run.readings["N"], FORCE, atol=1e-3)


def test_a_letter_before_numbers_is_no_unit_behind_one(tmp_path):
    text = "\n".join(f"A {t} {f:.3f}" for t, f in zip(TIMES, FORCE, strict=True))
    with pytest.raises(InputError, match="column 1, column 2, column 3"):
        said(tmp_path / "a.txt", text)


def test_a_value_within_an_object_has_its_name_and_unit(tmp_path):
    rows = [f'{{"t_us": {50 * k}, "load": {{"value": {f:.4f}, "unit": "N"}}}}' for k, f in enumerate(FORCE)]
    found = said(tmp_path / "a.jsonl", "\n".join(rows))
    assert found.columns == {"N": "load value [N]"}


def test_what_has_few_levels_is_not_offered_as_a_reading(tmp_path):
    with pytest.raises(InputError, match=r'--observe "Channel 0 \[N\]"'):
        said(
            tmp_path / "a.csv", lines("Time [s],Channel 0,Channel 1", STEP * np.arange(COUNT), FORCE, 3.3 * (FORCE > 9))
        )


def test_a_place_that_is_noise_gives_no_speed(tmp_path):
    noise = 4.0 + 1e-3 * np.random.default_rng(0).normal(size=COUNT)
    head = "Vitesse d'impact : 0.55 m/s\n\n"
    found = said(tmp_path / "a.csv", head + lines("t [ms],F [N],Depl [mm]", TIMES, FORCE, noise))
    assert found.records[0].speeds() is None and found.speeds == (0.55,)
    moves = lines("t [ms],F [N],Depl [mm]", TIMES, FORCE, noise + 0.55 * 0.05 * np.arange(COUNT))
    assert said(tmp_path / "a.csv", moves).records[0].speeds()[0] == pytest.approx(0.55, rel=0.01)


@pytest.mark.parametrize(
    ("line", "mass"),
    [
        ("Impactor weight: 11 lb", 4.98952), ("Masse tombante : 25 kg", 25.0), ("Mass of the hammer: 2 kg", 2.0),
        ("[落下質量],10 kg", 10.0), ("Specimen mass: 3 kg", None), ("Drop weight: 50 N", None),
    ],
)  # fmt: skip
def test_the_mass_of_what_strikes_in_other_words(line, mass, tmp_path):
    found = said(tmp_path / "a.csv", f"{line}\n\n" + lines("t [ms],F [N]", TIMES, FORCE)).mass
    assert found == (pytest.approx(mass) if mass else None)


def test_settings_in_brackets_and_rules_of_a_wiki_are_no_names(tmp_path):
    rows = lines("", *[[f"{x:.4f}" for x in c] for c in (FORCE / 1e3, 0 * FORCE)])
    head = "[サンプリング周波数(Hz)],20000\n[CH名称],荷重計,変位計\n[単位],kN,mm\n[レンジ],50kN,100mm\n[データ]"
    found = said(tmp_path / "a.csv", head + rows)
    assert found.columns == {"N": "荷重計 [kN]", "m": "変位計 [mm]"}
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE, atol=0.06)
    wiki = [f"| {t} | {f:.3f} |" for t, f in zip(TIMES, FORCE, strict=True)]
    assert said(tmp_path / "a.txt", "\n".join(["| t (ms) | F (N) |", "|-----:|---:|", *wiki])).time == "t (ms)"


def test_units_that_stand_beside_a_matrix_and_a_clock_of_durations(tmp_path):
    data = {"Data": np.c_[-FORCE / 4.4482216, FORCE], "ChanNames": np.array(["Load", "Trig"], object), "Fs": 20e3}
    savemat(tmp_path / "a.mat", data | {"ChanUnits": np.array(["lbf", "V"], object)})
    found = init.found_in(tmp_path / "a.mat", init.Said())
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE, rtol=1e-6)
    ticks = np.arange(0, 50_000 * COUNT, 50_000).astype("timedelta64[ns]")
    table = Record(tmp_path / "a", ("elapsed", "F [N]"), (ticks, FORCE), np.arange(COUNT))
    assert table.clock == "elapsed" and not table.bare("elapsed")


def test_of_two_ranges_of_one_sensor_the_one_that_clips_is_not_offered(tmp_path):
    with pytest.raises(InputError, match=r'--observe "F 20kN \[N\]"'):
        said(
            tmp_path / "a.csv", lines("t [ms],F 1kN [N],F 20kN [N]", TIMES, np.minimum(FORCE, 0.4 * FORCE.max()), FORCE)
        )
