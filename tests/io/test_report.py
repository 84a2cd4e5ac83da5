"""Reports: the structure of a page, its colours, what is inside it, and how it is made again from its folder."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import bcfj
from conftest import BUILD
from pages import check

from bcfj_jax.analysis.simulation import folder as runs
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import percent, rounded
from bcfj_jax.io import plots, report
from bcfj_jax.io.page import (
    BAD,
    FAIR,
    GOOD,
    PLAIN,
    Listing,
    Page,
    Picture,
    Table,
    Verdict,
    bounded,
    brief,
    from_content,
    span,
)

STYLE = Path(report.__file__).with_name("templates") / "report.css"


def picture(folder: Path, name: str = "one.png") -> Picture:
    with plots.panels(1, 1, folder / name, 3.0, 2.0) as axes:
        axes[0].plot([0, 1], [0, 2])
    return Picture(name, "A line", "A line from 0 to 2 N.")


def page_in(folder: Path) -> Page:
    inner = Table("Each", [["contact", "peak"], ["a_1", "1 N"], ["a_2", "2 N"]])
    return Page(
        "A run", Verdict(GOOD, "Finished", "Highest force 2 N, in a_2."), (picture(folder),), ("mind <this>",),
        (Table("Contacts", [["contact", "peak"], ["a", "1 to 2 N"]], "Three digits.", (inner,)), Listing("Lines", "x = 1")),
        (picture(folder, "two.png"),), (inner,),
    )  # fmt: skip


def test_a_page_has_its_parts_in_order_and_keeps_them(tmp_path):
    (tmp_path / "run.toml").write_text('[scene]\nkind = "impact & more"\n')
    page = page_in(tmp_path)
    seen = check(report.write(tmp_path, page))
    texts = [text for _, text in seen.text]
    places = [
        texts.index(text)
        for text in ("A run", "Finished.", "Warnings", "Contacts", "Each", "Further pictures", "Details")
    ]
    assert places == sorted(places)
    assert "mind <this>" in texts, "text is escaped"
    assert any("impact & more" in text for tag, text in seen.text if tag == "pre")
    assert len(seen.all("img")) == 2
    assert report.kept(tmp_path) == page


def test_micro_is_a_unit_and_no_word(tmp_path):
    page = Page(
        "Units",
        Verdict(GOOD, "Good", "."),
        tables=(Table("T", [["what", "value"], ["a", "50 um"], ["b", "3 unknown"]]),),
    )
    text = report.html(page, tmp_path)
    assert "50 µm" in text and "3 unknown" in text


def test_an_animation_is_kept_when_the_page_is_made_again(tmp_path):
    scene = '<section aria-label="Animation"><canvas></canvas><script>1 < 2</script></section>'
    report.write(tmp_path, replace(page_in(tmp_path), animation=scene))
    check(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.index("data:image/png") < page.index(scene) < page.index("<table>")
    assert "animation" not in json.loads((tmp_path / "report.json").read_text())
    assert report.kept(tmp_path).animation == scene


def test_a_lost_picture_is_said(tmp_path):
    page = page_in(tmp_path)
    (tmp_path / "two.png").unlink()
    seen = check(report.write(tmp_path, page))
    assert any("two.png" in text for _, text in seen.text)


def test_a_text_in_place_of_a_list_is_refused(tmp_path):
    content = page_in(tmp_path).content()
    for wrong in ({"warnings": "text"}, {"tables": [{"title": "x", "rows": ["text"], "note": "", "folded": []}]}):
        with pytest.raises(InputError, match="'text' is no list"):
            from_content(content | wrong, "report.json")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("{", "no JSON"),
        ("[]", "not what a command"),
        ('{"title": "x"}', "not what a command"),
    ],
)
def test_what_is_no_page_is_refused(tmp_path, content, says):
    (tmp_path / "report.json").write_text(content)
    with pytest.raises(InputError, match=says):
        report.kept(tmp_path)


@pytest.mark.parametrize(
    "name", ["../secret.png", "/secret.png", "a/../../secret.png", "c:secret.png", "..\\secret.png"]
)
def test_a_page_cannot_show_files_elsewhere(tmp_path, name):
    folder = tmp_path / "run"
    folder.mkdir()
    picture(tmp_path, "secret.png")
    page = replace(page_in(folder), more=(Picture(name, "x", "x."),))
    with pytest.raises(InputError, match=r"report.json.* may leave its folder"):
        report.html(page, folder)
    with pytest.raises(InputError, match="no PNG"):
        from_content(page.content() | {"more": [{"file": "fit.json", "title": "x", "shows": "x."}]}, "report.json")


def test_a_folder_without_results_is_refused(tmp_path):
    with pytest.raises(InputError, match="holds no results"):
        report.kept(tmp_path)
    (tmp_path / "fit.json").write_text("{}")
    with pytest.raises(InputError, match=r"holds fit.json"):
        report.kept(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        report.kept(tmp_path / "none")


# Colours.


def luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour (WCAG 2)."""
    digits = colour.lstrip("#")
    digits = "".join(2 * d for d in digits) if len(digits) == 3 else digits
    parts = np.array([int(digits[k : k + 2], 16) for k in (0, 2, 4)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(first: str, second: str) -> float:
    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_contrast_is_that_of_the_standard():
    assert contrast("#fff", "#000000") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.478, abs=1e-3)


def test_text_has_contrast():
    style = STYLE.read_text(encoding="utf-8")
    values = dict(re.findall(r"--(\w+): (#\w+)", style))
    assert contrast(values["text"], values["paper"]) >= 7.0
    assert contrast(values["soft"], values["paper"]) >= 4.5
    for kind in (GOOD, FAIR, BAD, PLAIN, "warnings"):
        found = re.search(rf"\.{kind} {{ color: (#\w+); background: (#\w+);", style)
        assert found and contrast(found[1], found[2]) >= 4.5, kind
    for colour in plots.COLOURS:
        assert contrast(colour, "#ffffff") >= 4.5


def seen_by(colour: str, matrix: list[list[float]]) -> np.ndarray:
    """A colour in CIELAB as someone without one kind of cone sees it (Machado, Oliveira, Fernandes 2009, severity 1)."""
    parts = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.array(matrix) @ linear, 0.0, 1.0)
    to_xyz = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    x, y, z = np.array(to_xyz) @ linear / [0.9505, 1.0, 1.089]
    f = [v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116 for v in (x, y, z)]
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize(
    "matrix",
    [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    ],
    ids=["all cones", "protanopia", "deuteranopia"],
)
def test_the_first_colours_differ_for_everyone(matrix):
    # Three lines on one panel is the most that pictures tell apart by colour alone.
    found = [seen_by(colour, matrix) for colour in plots.COLOURS[:3]]
    for i, one in enumerate(found):
        for other in found[i + 1 :]:
            assert np.linalg.norm(one - other) > 15.0


# Numbers for people.


def test_numbers_have_three_digits_and_one_unit():
    assert brief(1709.03, "N") == "1.71 kN" and brief(999.7, "N") == "1 kN" and brief(-2.3456e-5, "m") == "-23.5 µm"
    assert brief(None, "N") == "-" == brief(float("nan")) and brief(123456.0) == "123000"
    assert bounded([1.50481, 1.48421, 1.52607], (1.48421, 1.52607)) == ["1.505", "1.484", "1.526"]
    assert bounded([2.4452e9, 1e9], (2.072e9, 2.885e9)) == ["2.45e+09", "1e+09"]
    assert bounded([1.23456], ()) == ["1.23"] == bounded([1.23456], (1.0, math.inf))
    assert bounded([1234.5678901], (1234.567, 1234.569), "N") == ["1.2345679 kN"]
    assert span([29504.0, 29571.0], "N") == "29.5 to 29.6 kN" and span([29.5, 29.51]) == "29.5"
    assert span([0.31, 1.21], "J") == "0.31 to 1.21 J"
    assert span([None, float("nan")], "N") == "-"  # pyright: ignore[reportArgumentType]
    assert percent(0.012345) == "1.23 %" and percent(None) == percent(float("nan")) == "-"
    assert percent(0.998, 2) == "100 %" and percent(-12.3, 2, "+") == "-1200 %" and percent(0.5, 2, "+") == "+50 %"
    assert [rounded(x) for x in (123.4, -0.0123, 1.23e-9, 0.0)] == ["120", "-0.012", "1.2e-09", "0"]
    assert rounded(17.0, 1, "+") == "+20"


# Folders of runs.


@pytest.mark.slow
def test_the_report_of_a_run_is_made_again_from_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    assert bcfj("simulate", "slider_crank", "--out", "out").exit_code == 0
    folder = tmp_path / "out"
    first = check(folder / "report.html")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    # Of the page itself the animation alone is kept; all else is made again.
    page = (folder / "report.html").read_text()
    begin, end = page.index("<!-- animation: begin -->"), page.index("<!-- animation: end -->")
    (folder / "report.html").write_text(page[begin:end] + "<!-- animation: end -->")
    (folder / "forces.png").unlink()
    done = bcfj("report", "out")
    assert done.exit_code == 0 and "out/report.html" in done.stdout
    again = check(folder / "report.html")
    assert [text for _, text in again.text] == [text for _, text in first.text]
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert set(after) == set(before)
    assert {name for name in after if after[name] != before[name]} <= {"report.html", "forces.png"}

    # A folder of a version that kept no page: from its numbers, which have no path of the centre.
    (folder / "report.json").unlink()
    assert bcfj("report", "out").exit_code == 0
    assert [text for tag, text in check(folder / "report.html").text if tag == "p"][:1] == [
        text for tag, text in first.text if tag == "p"
    ][:1]
    assert len(check(folder / "report.html").all("img")) == len(first.all("img")) - 1
    # Without its histories the page remains, with the pictures that are there.
    (folder / "forces.csv").write_text("time [s]\n0\n")
    done = bcfj("report", "out")
    assert done.exit_code == 0 and "pictures are kept as they are" in done.stderr
    assert len(check(folder / "report.html").all("img")) == len(first.all("img")) - 1
    (folder / "report.json").unlink()
    done = bcfj("report", "out")
    assert done.exit_code == 2 and "forces.csv" in done.stderr


def test_report_of_no_results_is_bad_input(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = bcfj("report", ".")
    assert done.exit_code == 2 and "holds no results" in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("contacts", ["time [s]\n0\n1\n2\n", "t\n0\n1\n"])
def test_histories_of_two_runs_are_refused(tmp_path, contacts):
    (tmp_path / "forces.csv").write_text("time [s]\n0\n1\n")
    (tmp_path / "contacts.csv").write_text(contacts)
    with pytest.raises(InputError, match=r"forces\.csv and contacts\.csv have no time"):
        runs.read(tmp_path, None, {})
