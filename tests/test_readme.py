"""README and docs/accuracy.md say what was measured; ``test_docs`` follows their links and runs their commands."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from benchmarks import common
from benchmarks.calibration import demo
from benchmarks.common import load
from benchmarks.solve import accuracy, times

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text()
TABLES = (ROOT / "docs" / "accuracy.md").read_text()


@pytest.mark.parametrize(("benchmark", "page"), [(accuracy, TABLES), (demo, README), (times, TABLES)])
def test_tables_are_those_of_the_kept_results(benchmark, page):
    assert benchmark.table(load(benchmark.__name__.rpartition(".")[2])) in page


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 120


def test_the_joints_table_is_that_of_the_kept_results(monkeypatch):
    # The benchmark asks for one thread where it is imported: of itself alone.
    for name in ("XLA_FLAGS", "EQX_ON_ERROR"):
        monkeypatch.setenv(name, os.environ.get(name, ""))
    from benchmarks.models import joint

    shown = re.search(r"<!-- joint: begin -->\n(.*?)\n<!-- joint: end -->", TABLES, re.DOTALL)
    assert shown and shown[1] == joint.readme()


def test_the_promised_force_error_was_kept():
    """docs/accuracy.md: "asked for as a force error": peak and impulse of every benchmark case are within what was asked for."""
    for row in load("accuracy")["rows"]:
        assert max(*row["impact"][:3], *row["bounce"][:2]) < row["asked"]


def test_a_table_is_put_between_its_markers_and_nowhere_else(tmp_path, monkeypatch):
    monkeypatch.setattr(common, "ROOT", tmp_path)
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- x: begin -->\n<!-- x: end -->\nafter\n")
    for table in ("first", "second"):
        common.publish("x", table)
        assert readme.read_text() == f"before\n<!-- x: begin -->\n{table}\n<!-- x: end -->\nafter\n"
    with pytest.raises(ValueError, match=r"README\.md: the markers '<!-- y: begin"):
        common.publish("y", "lost")
    assert "second" in readme.read_text()
