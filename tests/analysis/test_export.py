"""Coefficients that leave: the drop with the translated law beside the scene's, and in the other simulator itself."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import tiers
from commands import bcfj

from bcfj_jax.analysis import export as leaving
from bcfj_jax.core.errors import InputError

SCENE = """[scene]
kind = "impact"
law = "{law}"
elastic = "{elastic}"
[parameters]
mass = 0.5
approach_speed = 1.2
{parameters}
"""
STEEL = "stiffness = 1e9\nexponent = 1.4\n"


def scene(folder, law="memory_free", parameters=STEEL + "damping = 0.2", elastic="power"):
    path = folder / "scene.toml"
    path.write_text(SCENE.format(law=law, elastic=elastic, parameters=parameters))
    return path


def close(a, b, share):
    return abs(a - b) <= share * abs(a)


@pytest.mark.parametrize("tool", tiers.ci(leaving.TOOLS, "exudyn"))
def test_the_drop_keeps_its_rebound_and_what_is_the_same_is_said(tool, tmp_path):
    found = leaving.export(leaving.source(scene(tmp_path)), tool)
    assert close(found.before.rebound, found.after.rebound, 1e-4)
    assert found.same == close(found.before.peak, found.after.peak, leaving.AGREES)
    # Springs that the tool has are copied; MuJoCo's linear one is matched to the peak.
    assert close(found.before.peak, found.after.peak, {"exudyn": 1e-6, "mujoco": 1e-4}.get(tool, 0.03))
    how = {row.what: row.how for row in found.rows}
    assert how["spring K d^n"] == ("approximate" if tool in ("mujoco", "chrono") else "exact")
    assert how["loss"] == ("exact" if tool == "exudyn" else "approximate")


OWN = {
    "adams": ("adams_impact", "dashpot = 300.0\ndamping_depth = 1e-4", {"cmax": 300.0, "d": 1e-4, "k": 1e9, "e": 1.4}),
    "modelica": ("elasto_gap", "dashpot = 300.0", {"c": 1e9, "n": 1.4, "d": 300.0}),
    "exudyn": ("hunt_crossley", "restitution = 0.8", {"restitutionCoefficient": 0.8, "contactStiffness": 1e9}),
}


@pytest.mark.parametrize("tool", tiers.ci(OWN, "adams"))
def test_a_law_that_the_tool_has_is_copied(tool, tmp_path):
    law, more, terms = OWN[tool]
    found = leaving.export(leaving.source(scene(tmp_path, law, STEEL + more)), tool)
    assert {row.how for row in found.rows} == {"exact"}
    assert found.terms == pytest.approx(found.terms | terms, rel=1e-12)
    np.testing.assert_allclose(found.after, found.before, rtol=1e-7)


def test_a_linear_dashpot_is_mujocos_and_per_unit_of_mass(tmp_path):
    path = scene(tmp_path, "kelvin_voigt", "stiffness = 1e6\ndashpot = 200.0", "linear")
    found = leaving.export(leaving.source(path), "mujoco")
    assert found.terms == {"stiffness": 1e6 / 0.5, "damping": 200.0 / 0.5}
    np.testing.assert_allclose(found.after, found.before, rtol=1e-9)
    assert [row.how for row in found.rows] == ["exact", "exact", "lost"]


def test_what_cannot_leave_is_refused(tmp_path):
    more = STEEL + "damping = 0.2\nbottoming_stiffness = 1e8\nbottoming_penetration = 1e-4\nbottoming_width = 1e-5"
    with pytest.raises(InputError, match=r"no tool here has the law MemoryFree with TwoStage.*memory_free"):
        leaving.source(scene(tmp_path, parameters=more, elastic="two_stage"))
    with pytest.raises(InputError, match="adams"):
        leaving.export(leaving.source("impact"), "adam")
    with pytest.raises(InputError, match=r"--mass|--speed"):
        leaving.source("backlash")
    given = leaving.source("backlash", mass="2 kg", speed="0.5 m/s")
    assert (given.mass, given.speed) == (2.0, 0.5)


def test_the_command_writes_a_file_from_a_fits_folder_and_replaces_none(tmp_path):
    (tmp_path / "fitted_scene.toml").write_text(scene(tmp_path).read_text())
    (tmp_path / "fit.json").write_text("{}")
    words = ["export", str(tmp_path / "fit.json"), "--to", "adams", "--out", str(tmp_path / "out"), "--json"]
    done = bcfj(*words)
    assert done.exit_code == 0, done.stderr
    said = json.loads(done.stdout)["result"]
    assert (
        said["terms"]["k"] == 1e9
        and "IMPACT(DZ(2, 1), VZ(2, 1), 0.0, 1000000000," in (tmp_path / "out/drop.adm").read_text()
    )
    assert bcfj(*words).exit_code == 2


def _file(tmp_path, tool, **scene_of):
    found = leaving.export(leaving.source(scene(tmp_path, **scene_of)), tool)
    path = tmp_path / found.name
    path.write_text(found.text)
    return found, path


def test_mujoco_itself_has_the_translated_peak_and_rebound(tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is in the extra bench")
    found, path = _file(tmp_path, "mujoco")
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    speed, peak = -data.qvel[0], 0.0
    for _ in range(12000):
        mujoco.mj_step(model, data)
        peak = max(peak, abs(data.qfrc_constraint[0]))
    assert close(found.before.peak, peak, 0.01) and close(found.before.rebound, data.qvel[0] / speed, 0.01)


@pytest.mark.parametrize("law", ["memory_free", "hertz", "adams_impact"])
def test_exudyn_itself_has_the_translated_peak_and_rebound(law, tmp_path):
    pytest.importorskip("exudyn", reason="Exudyn is in the extra bench")
    more = {"memory_free": "damping = 0.2", "hertz": "", "adams_impact": "dashpot = 300.0\ndamping_depth = 1e-4"}[law]
    found, path = _file(tmp_path, "exudyn", law=law, parameters=STEEL + more)
    done = subprocess.run([sys.executable, "-W", "ignore", str(path)], capture_output=True, text=True, timeout=120)
    words = done.stdout.split()
    assert "peak" in words, done.stderr
    assert close(found.after.peak, float(words[words.index("peak") + 1]), 0.002)
    assert close(found.after.rebound, float(words[words.index("rebound") + 1]), 0.002)
