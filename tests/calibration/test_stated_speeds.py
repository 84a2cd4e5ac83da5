"""Runs whose speed or height is stated beside a table, by its name or on another sheet; columns and tables as runs; strains."""

from __future__ import annotations

import json

import numpy as np
import openpyxl
import pytest
from scipy.io import savemat

from bcfj_jax import InputError
from bcfj_jax.core.quantities import GRAVITY
from bcfj_jax.data.reading import read
from bcfj_jax.data.textfile import Stated
from benchmarks.calibration import instruments
from calibration import init
from calibration.impacts.events import contacts
from calibration.impacts.proposal import Hints

STEP = 5e-5
FORCE = instruments.FORCE[60:260]
TIMES = STEP * np.arange(FORCE.size)


def rows(*columns, sep=","):
    return "".join(sep.join(f"{c:.5f}" for c in row) + "\n" for row in zip(*columns, strict=True))


def bounce(height=1.0, kept=0.8, rate=240.0):
    """Times (N,) and places (N,) of a ball that bounces once."""
    times = np.arange(0.0, 1.5, 1.0 / rate)
    falls, speed = np.sqrt(2.0 * height / GRAVITY), np.sqrt(2.0 * GRAVITY * height)
    later = times - falls
    after = np.abs(kept * speed * later - 0.5 * GRAVITY * later**2)
    return times, np.where(later < 0.0, height - 0.5 * GRAVITY * times**2, after)


def of(path, content="", stated=Stated(), **hints):  # noqa: B008
    """What is understood of a file, or of all of a pattern."""
    if content:
        path.write_text(content)
    return init.found_in(path, init.Said("", "0.8 kg", stated=stated, hints=Hints(**hints)))


@pytest.mark.parametrize(
    ("head", "speed"),
    [
        ("v0: 0,93 m/s", 0.93),
        ("Impact velocity (m/s): 3.1", 3.1),
        ("Drop height: 30 cm", np.sqrt(2.0 * GRAVITY * 0.3)),
        ("Speed: 5 mm/min", None),
        ("Height: 20 mm", None),
        ("v0: 0.93", None),
    ],
)
def test_a_line_beside_the_table_states_the_speed(head, speed, tmp_path):
    found = of(tmp_path / "a.txt", f"{head}\n\nt [s]\tF [N]\n{rows(TIMES, FORCE, sep=chr(9))}")
    assert found.speeds == ((pytest.approx(speed),) if speed else ())


def test_names_of_files_and_lines_of_blocks_state_each_runs(tmp_path):
    for name, scale in (("hit_0p5mps.csv", 1.0), ("hit_1p5mps.csv", 3.0)):
        of(tmp_path / name, "t [s],F [N]\n" + rows(TIMES, scale * FORCE))
    found = of(tmp_path / "hit_*.csv")
    assert found.speeds == (0.5, 1.5) and found.given[1] == "m/s"
    blocks = "\n".join(f"# v = {v} m/s\n# t/s F/N\n{rows(TIMES, v * FORCE, sep=' ')}" for v in (0.8, 1.2, 1.2, 1.6))
    assert of(tmp_path / "four.dat", blocks).speeds == ()  # Two are alike, and which run has which is not said.
    assert of(tmp_path / "two.dat", "\n".join(blocks.split("\n# v")[0::1][:2]).replace("\n =", "\n# v =")).speeds == (
        0.8,
        1.2,
    )


def test_the_proposed_file_has_the_stated_speeds(tmp_path):
    path = tmp_path / "drop_300mm.csv"
    path.write_text("t [s],F [N]\n" + rows(TIMES, FORCE))
    assert init.run(path, tmp_path, init.Said(), lambda _: None) == 0
    text = (tmp_path / "drop_300mm.toml").read_text()
    assert 'columns = { drop_height = "stated drop height [m]" }' in text
    assert "gravity" in text and "mass = { lower" in text and "?" not in text


def test_another_sheet_states_mass_and_speed_and_sheets_may_be_runs(tmp_path):
    book = openpyxl.Workbook()
    book.remove(book.worksheets[0])
    info = book.create_sheet("Info")
    for row in (["Impactor mass (kg)", 2.35], ["Impact velocity (m/s)", 1.65]):
        info.append(row)

    def add(name, force):
        sheet = book.create_sheet(name)
        for row in (["t [s]", "F [N]"], *zip(TIMES.tolist(), force.tolist(), strict=True)):
            sheet.append(row)

    add("links", FORCE)
    book.save(tmp_path / "a.xlsx")
    found = of(tmp_path / "a.xlsx")
    assert (found.mass, found.speeds) == (2.35, (1.65,))
    assert read(tmp_path / "a.xlsx", "", "links").header[-1] == "stated approach speed [m/s]"
    add("rechts", 2.0 * FORCE)
    book.save(tmp_path / "b.xlsx")
    with pytest.raises(InputError, match="--runs-by tables"):
        of(tmp_path / "b.xlsx")
    assert [p.name for p in of(tmp_path / "b.xlsx", runs_by="tables").parts] == ["links", "rechts"]


@pytest.mark.parametrize(
    "names", [("F1 [N]", "F2 [N]"), ("links [N]", "rechts [N]"), ("Force (N) A", "Force (N) B"), ("20 mm", "40 mm")]
)
def test_all_columns_are_runs_whichever_is_named(names, tmp_path):
    late = np.roll(FORCE, 20)
    text = f"t [s],{','.join(names)}\n{rows(TIMES, FORCE, late)}"
    observe = names[1] if "[" in names[1] or "(" in names[1] else f"{names[1]} [N]"
    found = of(tmp_path / "a.csv", text, runs_by="columns", observe=observe)
    assert len(found.records) == len(found.parts) == 2
    for run, force in zip(found.records, (FORCE, late), strict=True):
        np.testing.assert_allclose(run.readings["N"], force, atol=1e-4)


def test_columns_as_runs_need_two(tmp_path):
    with pytest.raises(InputError, match="no other column"):
        of(tmp_path / "a.csv", f"t [s],F [N]\n{rows(TIMES, FORCE)}", runs_by="columns", observe="F [N]")


def test_columns_that_differ_by_a_letter_are_asked_for(tmp_path):
    with pytest.raises(InputError, match="--runs-by columns"):
        of(tmp_path / "a.csv", f"t [s],Force (N) A,Force (N) B\n{rows(TIMES, FORCE, np.roll(FORCE, 20))}")


def test_counts_per_millimetre_are_no_millimetres_and_are_asked_for(tmp_path):
    times, places = bounce()
    text = "# encoder, 200 counts/mm\ntime_ms,count\n" + rows(1e3 * times, np.round(2e5 * places))
    with pytest.raises(InputError, match=r'--observe "count \[counts\]" --sensitivity "200 counts/mm"'):
        of(tmp_path / "a.csv", text)
    found = of(tmp_path / "a.csv", text, Stated(sensitivity="200 counts/mm"), observe="count [counts]")
    assert found.falls
    np.testing.assert_allclose(np.abs(found.records[0].readings["m"]), places, atol=3e-6)


def test_a_strain_is_a_force_by_its_sensitivity_and_the_message_says_how(tmp_path):
    text = "t [s];DMS [µm/m]\n" + rows(TIMES, -0.4 * FORCE, sep=";")
    with pytest.raises(InputError, match=r"0\.5 ue/N"):
        of(tmp_path / "a.csv", text)
    for said in ("0.4 ue/N", "0.4 um/m/N", "DMS = 0.4 (µm/m)/N"):
        found = of(tmp_path / "a.csv", text, Stated(sensitivity=said))
        np.testing.assert_allclose(found.records[0].readings["N"], FORCE, atol=1e-4)


def test_a_bare_column_and_a_sensitivity_lead_on(tmp_path):
    text = f"t [s],A,B\n{rows(TIMES, 1e-3 * FORCE, 0.0 * FORCE)}"
    with pytest.raises(InputError, match=r'--observe "A \[V\]" or "A \[mV\]" --sensitivity "A = 2 mV/N"'):
        of(tmp_path / "a.csv", text, Stated(sensitivity="A = 2 mV/N"))


def test_a_struct_of_a_quantity_has_its_unit_and_the_name_beside(tmp_path):
    def signal(name, unit, values):
        x = {"start_value": 0.0, "increment": STEP, "number_of_values": values.size}
        y = {"values": values[:, None], "quantity": {"label": unit}}
        return {"x_values": x, "y_values": y, "function_record": {"name": name}}

    savemat(
        tmp_path / "a.mat", {"Signal_0": signal("Hammer", "N", FORCE), "Signal_1": signal("Plate", "g", 0.0 * FORCE)}
    )
    assert of(tmp_path / "a.mat").columns == {"N": "Hammer [N]"}


def test_noise_of_places_is_no_contact():
    times, places = bounce()
    places = places + 8e-4 * np.random.default_rng(1).normal(size=times.size)
    assert [round(e.begin, 1) for e in contacts("body.place.y", times, places)] == [0.4, 1.2]


def test_a_harder_second_hit_is_no_bounce_and_a_number_for_none_is_none(tmp_path):
    quiet = np.zeros(1500)
    force = np.r_[quiet, FORCE, quiet, 1.8 * FORCE, quiet]
    found = of(tmp_path / "a.csv", "t [s],F [N]\n" + rows(STEP * np.arange(force.size), force))
    assert init._kind(found) == "impact"
    lines = ("t [s],F [lbF]\n" + rows(TIMES, FORCE)).splitlines()
    lines[5] = lines[5].split(",")[0] + ",-3.697314e+28"
    lines[9] = lines[9].split(",")[0] + ",-3.697314e+28"
    readings = of(tmp_path / "b.csv", "\n".join(lines)).records[0].readings["N"]
    assert np.isnan(readings[[4, 8]]).all() and np.nanmax(readings) == pytest.approx(4.4482216 * FORCE.max(), rel=1e-4)


@pytest.mark.parametrize("names", ["Rubber (N),Cork (N)", "Amboss [kN],Puffer [kN]"])
def test_forces_of_unlike_names_that_show_other_hits_are_asked_for(names, tmp_path):
    with pytest.raises(InputError, match="--runs-by columns"):
        of(tmp_path / "a.csv", f"t [s],{names}\n{rows(TIMES, FORCE, np.roll(FORCE, 20))}")


def test_a_sum_an_axis_or_what_is_derived_is_no_other_hit(tmp_path):
    for other in ("Friction (N)", "Kraft max (N)", "F_x [N]"):
        found = of(tmp_path / "a.csv", f"t [s],Kraft [N],{other}\n{rows(TIMES, FORCE, 0.5 * np.roll(FORCE, 20))}")
        assert found.columns["N"] == "Kraft [N]"
    found = of(tmp_path / "a.csv", f"t [s],Links [N],Rechts [N]\n{rows(TIMES, FORCE, 0.5 * FORCE)}")
    assert found.columns["N"] == "Links [N]"


def test_two_sensors_of_one_stated_hit_are_no_runs(tmp_path):
    text = f"v0: 0.9 m/s\n\nt [s],F1 [N],F2 [N]\n{rows(TIMES, FORCE, 0.5 * FORCE)}"
    assert of(tmp_path / "a.csv", text).parts == ()


def impulse():
    return float(np.trapezoid(FORCE, TIMES))


@pytest.mark.parametrize(
    ("head", "mass", "used"),
    [
        ("Drop height: HEIGHT", "MASS kg", True),
        ("Drop height: HEIGHT", None, True),
        ("Height: HEIGHT\nRig: drop tower", "MASS kg", True),
        ("Height: HEIGHT\nRig: drop tower", None, False),
        ("Height: 2 mm\nRig: drop tower", "MASS kg", False),
        ("Impact velocity: 0.05 m/s", "MASS kg", False),
    ],
)
def test_a_stated_speed_is_used_as_far_as_mass_and_impulse_bear_it_out(head, mass, used, tmp_path):
    speed = 1.2  # Of which the impulse is 1.6 m v.
    mass = mass and mass.replace("MASS", f"{impulse() / 1.6 / speed:.4f}")
    head = head.replace("HEIGHT", f"{1e3 * speed**2 / 2.0 / GRAVITY:.2f} mm")
    (tmp_path / "a.txt").write_text(f"{head}\n\nt [s]\tF [N]\n{rows(TIMES, FORCE, sep=chr(9))}")
    init.run(tmp_path / "a.txt", tmp_path, init.Said("", mass), lambda _: None)
    text = (tmp_path / "a.toml").read_text()
    assert ("columns = {" in text) is used and ("is not used" in text) is not used


@pytest.mark.parametrize(
    ("names", "speeds"),
    [
        ("F @ 0.5 m/s [N],F @ 1.5 m/s [N]", (0.5, 1.5)),
        ("drop 20mm (N),drop 80mm (N)", (np.sqrt(0.04 * GRAVITY), np.sqrt(0.16 * GRAVITY))),
    ],
)
def test_speeds_and_heights_in_names_of_columns_are_of_their_runs(names, speeds, tmp_path):
    path = tmp_path / "a.csv"
    found = of(path, f"t [s],{names}\n{rows(TIMES, FORCE, speeds[1] / speeds[0] * FORCE)}")
    assert found.speeds == pytest.approx(speeds) and len(found.parts) == 2
    init.run(path, tmp_path, init.Said(), lambda _: None)
    for speed in speeds:
        assert f'approach_speed = "{speed:.6g} m/s"' in (tmp_path / "a.toml").read_text()


def test_columns_whose_clock_begins_anew_have_no_speed_by_their_names(tmp_path):
    twice = [np.r_[x, x] for x in (TIMES, FORCE, 3.0 * FORCE)]
    found = of(tmp_path / "a.csv", "t [s],F @ 0.5 m/s [N],F @ 1.5 m/s [N]\n" + rows(*twice))
    assert (len(found.records), found.speeds) == (4, ())


def test_variables_of_a_matlab_file_state_mass_and_speeds(tmp_path):
    path = tmp_path / "a.mat"
    savemat(path, {"t": TIMES, "F": np.c_[FORCE, 3.0 * FORCE], "v0": [0.5, 1.5], "mass": 0.4, "units": "N"})
    found = of(path)
    assert (found.speeds, found.mass, len(found.parts)) == ((0.5, 1.5), 0.4, 2)
    one = {"t": TIMES, "F": FORCE}
    savemat(path, {"run": [{**one, "v0": 0.5}, {**one, "F": 3.0 * FORCE, "v0": 1.5}], "mass": 0.4})
    assert (of(path).speeds, of(path).mass) == ((0.5, 1.5), 0.4)
    savemat(path, {**one, "v0": 0.5, "h": 400.0})
    assert of(path).speeds == (0.5,)


def test_properties_of_a_tdms_file_and_of_its_groups_state_mass_and_speeds(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    wave = {"wf_increment": STEP, "wf_start_offset": 0.0, "wf_samples": FORCE.size, "unit_string": "N"}
    parts = [nptdms.RootObject({"Drop Mass (kg)": 0.4, "name": "a"})]
    for k, speed in enumerate((0.5, 1.5), 1):
        force = nptdms.ChannelObject(f"Hit {k}", "Force", 2.0 * speed * FORCE, wave)
        parts += [nptdms.GroupObject(f"Hit {k}", {"v0_m_s": speed}), force]
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as file:
        file.write_segment(parts)
    found = of(tmp_path / "a.tdms")
    assert (found.speeds, found.mass, len(found.parts)) == ((0.5, 1.5), 0.4, 2)


def test_a_sheet_that_lists_the_others_states_their_speeds(tmp_path):
    book = openpyxl.Workbook()
    book.worksheets[0].title = "Summary"
    for row in (["Hit", "v0 [m/s]"], [1, 0.5], [2, 1.5]):
        book.worksheets[0].append(row)
    for k in (1, 2):
        sheet = book.create_sheet(f"Hit {k}")
        for row in (["t [s]", "F [N]"], *zip(TIMES.tolist(), (k * FORCE).tolist(), strict=True)):
            sheet.append(row)
    book.save(tmp_path / "a.xlsx")
    assert of(tmp_path / "a.xlsx").speeds == (0.5, 1.5)


def test_objects_in_lines_name_their_numbers(tmp_path):
    line = '{{"ts": "10:00:{0:09.6f}", "force": {{"value": {1:.4f}, "unit": "N"}}, "acc": {{"value": {2:.4f}, "unit": "g"}}}}\n'
    text = "".join(line.format(t, f, -f / 40.0) for t, f in zip(TIMES, FORCE, strict=True))
    found = of(tmp_path / "a.jsonl", text)
    assert found.columns["N"] == "force value [N]" and found.columns["m/s^2"].endswith("acc value [g]")
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE, atol=1e-4)


@pytest.mark.parametrize(
    ("head", "mass"),
    [
        ("Altezza di caduta: 150 mm\nMassa battente: 0,5 kg", 0.5),
        ("낙하높이: 150 mm\n충격체 질량: 0.5 kg", 0.5),
        ("Valhoogte (mm): 150", None),
        ("落下高さ: 15 cm", None),
    ],
)
def test_heights_and_masses_of_other_languages(head, mass, tmp_path):
    found = of(tmp_path / "a.txt", f"{head}\n\nt [s]\tF [N]\n{rows(TIMES, FORCE, sep=chr(9))}")
    assert (found.speeds, found.mass) == ((pytest.approx(np.sqrt(0.3 * GRAVITY)),), mass)


def test_the_mean_beside_runs_is_none_of_them(tmp_path):
    forces = (FORCE, np.roll(FORCE, 5), 0.5 * FORCE + 0.5 * np.roll(FORCE, 5))
    found = of(tmp_path / "a.csv", f"t [s],Test 1 (N),Test 2 (N),Mean (N)\n{rows(TIMES, *forces)}")
    assert [p.columns["N"] for p in found.parts] == ["Test 1 (N)", "Test 2 (N)"]


def test_labels_and_units_of_a_matrix_stand_in_cells(tmp_path):
    cells = {"labels": np.array(["Force", "Accel"], object), "units": np.array(["kN", "g"], object), "v_impact": 1.1}
    savemat(tmp_path / "a.mat", {"S": {"time": TIMES, "data": np.c_[1e-3 * FORCE, -FORCE / 8.0], **cells}})
    found = of(tmp_path / "a.mat")
    assert (found.columns["N"], found.speeds) == ("Force [kN]", (1.1,))
    np.testing.assert_allclose(found.records[0].readings["N"], FORCE, atol=1e-9)


def test_what_stands_beside_the_channels_of_a_json_file_is_about_them(tmp_path):
    channels = [{"name": "force", "unit": "N", "data": FORCE.tolist()}, {"name": "T", "unit": "K", "data": [0.0] * 200}]
    content = {
        "meta": {"drop_height_mm": 150, "mass_kg": 1.1, "name": "b"},
        "fs": 1.0 / STEP,
        "channels": channels,
        "rows": [[1], [1, 2]],
    }
    (tmp_path / "a.json").write_text(json.dumps(content))
    found = of(tmp_path / "a.json")
    assert (found.speeds, found.mass) == ((pytest.approx(np.sqrt(0.3 * GRAVITY)),), 1.1)


def test_days_of_a_spreadsheet_are_days_where_the_column_is_named_so(tmp_path):
    days = 46351.41 + np.arange(200) / 86400.0
    text = "".join(f"{d:.9f},{f:.4f}\n" for d, f in zip(days, FORCE, strict=True))
    for name, step in (("Date Time", 1.0), ("Time", 1.0 / 86400.0)):
        (tmp_path / "a.csv").write_text(f"{name},F [N]\n{text}")
        table = read(tmp_path / "a.csv", "record")
        clock = table.numbers(name, "s", "", False)
        assert np.diff(clock) == pytest.approx(step, rel=1e-3) and table.bare(name) is (step < 1.0)
