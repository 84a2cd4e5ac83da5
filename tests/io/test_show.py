"""Results in Python: text, HTML, tables, labelled arrays and figures of runs, sensitivities and studies.

Of a design: analysis/test_designs.py; of a fit: calibration/test_systematic.py.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest
from shown import brief, drawn

import bcfj_jax as bj

TIMES = np.linspace(0.0, 60e-6, 61)


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Results of single runs."""
    scene = bj.scenes.impact()
    params, folder = scene.parameters(), tmp_path_factory.mktemp("shown")
    study = {
        "scene": {"scene": {"kind": "impact"}, "time": {"samples": 61}},
        "vary": {"mass": {"lower": 1.0, "upper": 2.0, "steps": 2}, "damping": {"values": [0.0, 0.1, 0.2]}},
        "results": {"features": ["contact.peak"]},
    }
    return {
        "run": bj.simulate(scene, params, TIMES, measure_error=True),
        "sensitivity": bj.sensitivity(scene, params, TIMES, ("stiffness", "damping"), differences="none"),
        "study": bj.study(study, folder / "study", workers=1),
    }


FIRST = {
    "run": "Run: ok, reached 60 us",
    "sensitivity": "Sensitivity: trusted",
    "study": "Result: finished, 6 points of scene 'impact', 0 failed",
}
pytestmark = pytest.mark.full


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIRST)
def test_a_result_is_told_in_a_few_lines(shown, kind):
    brief(shown[kind], FIRST[kind])


@pytest.mark.slow
def test_a_failed_run_says_when_and_why():
    scene = bj.scenes.impact()
    found = bj.simulate(scene, scene.parameters(), TIMES, max_steps=3)
    assert repr(found).startswith("Run: failed at ") and "step budget" in repr(found)
    assert len(found.to_pandas()) == len(TIMES)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FIRST)
def test_figures_open_no_window_and_write_no_file(shown, kind, tmp_path, monkeypatch):
    drawn(shown[kind], tmp_path, monkeypatch)


@pytest.mark.slow
def test_tables_hold_the_numbers(shown):
    run, table = shown["run"], shown["run"].to_pandas()
    np.testing.assert_array_equal(table["contact.normal [N]"], run.force["contact"][:, 0])
    np.testing.assert_array_equal(table.index, TIMES)
    slopes = shown["sensitivity"].to_pandas().set_index(["feature", "parameter"])
    found = shown["sensitivity"].feature_derivatives["stiffness"]["contact.peak"]
    assert slopes.loc[("contact.peak", "stiffness"), "derivative"] == found
    assert slopes.loc[("contact.impulse", "stiffness"), "unit"] == "N s"
    assert list(shown["study"].to_pandas()["status"]) == ["ok"] * 6


def test_labelled_arrays_hold_the_numbers(shown):
    run, data = shown["run"], shown["run"].to_xarray()
    normal = data["contact.force"].sel(component="normal")
    np.testing.assert_array_equal(normal, run.force["contact"][:, 0])
    assert normal.attrs["units"] == "N" and data.attrs["status"] == "ok"
    slopes = shown["sensitivity"].to_xarray()
    assert slopes["contact.derivative"].dims == ("parameter", "time", "component")
    grid = shown["study"].to_xarray()
    assert dict(grid.sizes) == {"mass": 2, "damping": 3}
    assert float(grid["contact.peak"].sel(mass=2.0, damping=0.1)) > float(
        grid["contact.peak"].sel(mass=1.0, damping=0.1)
    )


@pytest.mark.parametrize(("library", "method"), [("pandas", "to_pandas"), ("xarray", "to_xarray")])
def test_a_missing_library_is_named_with_what_installs_it(shown, library, method, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(bj.InputError, match=rf"needs {library}.*pip install \"bcfj-jax\[table\]\""):
        getattr(shown["run"], method)()


def test_a_run_is_still_a_tuple(shown):
    times, force, *_ = shown["run"]
    assert times is shown["run"].times and force is shown["run"].force
