"""A command shows and keeps its first figures before it has all; what it tells changes nothing of the result."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest
from conftest import BUILD
from problems import PROBLEM, SCENE, TABLE
from typer.testing import CliRunner

import bcfj_jax as bj
import calibration
from bcfj_jax.analysis.designs import api
from bcfj_jax.analysis.studies import api as studies_api
from bcfj_jax.analysis.tradeoff import study
from bcfj_jax.analysis.tradeoff.measures import MAIN
from bcfj_jax.analysis.tradeoff.settings import settings
from bcfj_jax.cli import app
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.outputs import plain
from bcfj_jax.io.scenefile import load
from calibration.command import as_json


def bcfj(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)], env={"BCFJ_CACHE": str(BUILD / "jax-cache")})


def cut(monkeypatch, module, name):
    """Interrupt a command where it would call a function."""

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, name, interrupted)


def in_order(text, *parts):
    places = [text.index(part) for part in parts]
    assert places == sorted(places) and places[0] < 200


@pytest.mark.slow
def test_a_design_shows_its_best_point_first(tmp_path, monkeypatch):
    words = ("design", "impact", "--minimize", "contact.peak", "--vary", "damping=0.1:1", "--starts", 2)
    out = tmp_path / "out"
    cut(monkeypatch, api, "_optimum")
    done = bcfj(*words, "--out", out)
    assert done.exit_code == 130
    assert "Status: not checked yet." in done.stdout and "results in" not in done.stdout
    assert f"what there was stays in {out} (stage: not checked yet)" in done.stderr
    kept = json.loads((out / "design.json").read_text())
    assert kept["stage"] == kept["status"] == "not checked yet" and kept["confirmation"] is None
    monkeypatch.undo()
    done = bcfj(*words, "--out", out)
    assert done.exit_code == 0
    in_order(done.stdout, "Status: not checked yet.", "Status: not complete yet.", "Confirmed by", "results in")
    found = json.loads((out / "design.json").read_text())
    assert found["stage"] == "complete"
    assert found["after"] == pytest.approx(kept["after"], rel=1e-6)


@pytest.mark.slow
def test_what_a_design_tells_changes_nothing():
    scene = bj.scenes.impact()
    times, told = np.linspace(0.0, 7.7e-5, 201), []
    given = scene, scene.parameters(), times, "contact.peak", {"damping": (0.1, 1.0)}
    how = {"starts": 2, "samples": 8, "slices": False}
    found = bj.design(*given, tell=told.append, **how)
    assert [one.status for one in told] == ["not checked yet", "not complete yet"]
    assert told[0].confirmation is None and told[1].confirmation == found.confirmation
    same, other = (plain(one.content()) | {"stats": None} for one in (found, bj.design(*given, **how)))
    assert same == other


def test_a_tradeoff_shows_its_own_run_first(tmp_path, monkeypatch):
    words = ("tradeoff", "impact", "--only", "output", "--no-derivatives", "--out", tmp_path / "out")
    cut(monkeypatch, study, "reference")
    done = bcfj(*words)
    assert done.exit_code == 5 and "interrupted; go on with: bcfj tradeoff impact" in done.stderr
    in_order(done.stdout, "as given: ", "largest normal force: contact 1.7", "Not compared yet")
    kept = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    assert kept["stage"] == kept["status"] == "interrupted"
    assert kept["settings"][0]["status"] == study.UNCOMPARED and kept["settings"][0]["wall_s"] > 0.0
    assert kept["peaks"]["contact"] == pytest.approx(1710.0, rel=0.01)
    monkeypatch.undo()
    done = bcfj(*words)
    assert done.exit_code == 0
    in_order(done.stdout, "as given: ", "[1/3] as given: worst error", "[3/3] ", "Recommended settings")
    found = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    assert found["stage"] == "complete" and {row["status"] for row in found["settings"]} == {"ok"}
    given = load("impact")
    with Journal(tmp_path / "untold", "key") as journal:
        silent = study.study(given, settings(given, ("output",), False), journal, 600.0, print)
    for row, other in zip(found["settings"], silent.rows, strict=True):
        assert [row[name] for name in MAIN] == [other[name] for name in MAIN]


@pytest.mark.slow
def test_a_fit_shows_its_values_before_they_are_tested(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in {"s.toml": SCENE, "d.csv": TABLE, "p.toml": PROBLEM}.items():
        (tmp_path / name).write_text(text)
    problem, told = calibration.load("p.toml"), []
    found = calibration.fit(problem, starts=4, tell=told.append)
    assert told[0].stage == told[0].verdict == "not tested yet" and told[0].parameters["stiffness"].ci95 is None
    assert found.stage == "complete" and all(one.stage != "complete" for one in told)
    assert plain(as_json(found)) == plain(as_json(calibration.fit(problem, starts=4)))
    words = ("calibrate", "p.toml", "--starts", 4, "--out", "out")
    cut(monkeypatch, importlib.import_module("calibration.fit"), "_assess")
    done = bcfj(*words)
    assert done.exit_code == 5 and "the fit so far (not tested yet) is in out/fit.json" in done.stderr
    in_order(done.stdout, "best fit, not tested yet", "stiffness", "Not tested yet")
    kept = json.loads((tmp_path / "out" / "fit.json").read_text())
    best = json.loads((tmp_path / "out" / "interrupted.json").read_text())["best"]["stiffness"]
    assert kept["stage"] == "not tested yet" and kept["parameters"]["stiffness"]["value"] == best
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    done = bcfj(*words)
    assert done.exit_code in (0, 4), done.stderr
    in_order(done.stdout, "best fit, not tested yet", "verdict: ", "results and pictures")
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["stage"] == "complete"
    assert not (tmp_path / "out" / "interrupted.json").exists()


STUDY = """scene = "impact"
[design]
kind = "grid"
[vary.stiffness]
lower = 1e9
upper = 1e10
steps = 8
[results]
features = ["contact.peak"]
derivatives = ["exponent"]
"""


@pytest.mark.slow
def test_a_study_shows_its_first_block_first(tmp_path, monkeypatch):
    file, out = tmp_path / "study.toml", tmp_path / "out"
    file.write_text(STUDY)
    monkeypatch.setattr(studies_api, "default_workers", lambda: 1)
    cut(monkeypatch, studies_api, "finish")
    done = bcfj("study", "run", file, "--out", out)
    assert done.exit_code == 5 and "Over 4 of 8 points, 0 of them failed; not complete yet." in done.stdout
    assert "d(contact.peak)/d(exponent)" in done.stdout
    assert json.loads((out / "study.json").read_text())["status"] == "unfinished"
    monkeypatch.undo()
    done = bcfj("study", "resume", file, "--out", out)
    assert done.exit_code == 0 and "not complete yet" not in done.stdout
    assert json.loads((out / "study.json").read_text())["status"] == "finished"


@pytest.mark.slow
def test_what_a_study_tells_is_what_it_will_hold(tmp_path):
    file, told = tmp_path / "study.toml", []
    file.write_text(STUDY)
    found = bj.study(file, tmp_path / "out", workers=1, tell=told.append)
    assert [one.state["finished"] for one in told] == [4] and told[0].state["left"] == 4
    for name in found.table.column_names:
        at = told[0].column("point")
        assert list(found.column(name)[at]) == list(told[0].column(name))
