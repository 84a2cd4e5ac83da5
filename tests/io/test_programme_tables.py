"""Tables over time in scene files: rows with units and CSV files."""

from __future__ import annotations

import pytest
from oracles import within

from bcfj_jax import scenes
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import programmes, scenefile
from bcfj_jax.io.outputs import write_toml


def test_a_csv_file_is_a_table_in_si(tmp_path):
    (tmp_path / "torque.csv").write_text("time [ms],torque [kN m]\n0,0\n20,1.5\n\n50,-0.3\n", encoding="utf-8")
    found = programmes.table("torque.csv", "N m", "here", tmp_path)
    assert found == [within([0.0, 0.02, 0.05], 1e-14), within([0.0, 1500.0, -300.0], 1e-14)]
    assert programmes.table([["0 s", "20 ms"], [0, "1.5 kN m"]], "N m", "here") == [[0.0, 0.02], [0.0, 1500.0]]


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("time [s],torque [N m]\n0,0\n", "has 2 rows"),
        ("time [s],torque [N m]\n0,0\n1,2,3\n", "row 3 has 3 cells"),
        ("time [s],torque [N m]\n0,0\n1,two\n", "row 3"),
        ("time [s],torque [N]\n0,0\n1,2\n", "N m"),
    ],
)
def test_a_csv_file_that_is_no_table_is_refused(tmp_path, text, what):
    (tmp_path / "torque.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=what):
        programmes.table("torque.csv", "N m", "here", tmp_path)
    with pytest.raises(InputError, match="no file"):
        programmes.table("none.csv", "N m", "here", tmp_path)


def test_a_joint_follows_a_table_beside_its_file(tmp_path):
    (tmp_path / "torque.csv").write_text("time [ms],torque [kN m]\n0,0\n20,1.5\n50,-0.3\n", encoding="utf-8")
    content = {
        "scene": {"kind": "joint", "load_profile": "table", "load_table": "torque.csv"},
        "time": {"end": "10 ms", "samples": 5},
        "accuracy": {"resolved_peaks": True},
    }
    write_toml(tmp_path / "scene.toml", content)
    given = scenefile.load(tmp_path / "scene.toml")
    table = [[0.0, 0.02, 0.05], [0.0, 1500.0, -300.0]]
    assert given.scene == scenes.joint(loads=scenes.JointLoads("table", table)) and given.resolved_peaks
    assert float(given.params["load_torque"]) == 1500.0 and "load_ramp" not in given.params
    # What was run loads again, wherever the CSV file is, and Python takes the file's name, too.
    again = scenefile.from_table(given.resolved, None)
    assert again.scene == given.scene and again.resolved == given.resolved
    assert scenes.joint(loads=scenes.JointLoads("table", str(tmp_path / "torque.csv"))) == given.scene


def test_loads_of_a_mechanism_fluctuate_and_follow_a_file(tmp_path):
    (tmp_path / "push.csv").write_text("t [s],F [kN]\n0,0\n1,2\n", encoding="utf-8")
    body = {"name": "mass", "joint": "slide", "axis": "x", "mass": 1.0}
    swing = {"kind": "force", "name": "swing", "body": "mass", "size": 3.0, "amplitude": "2 kN", "frequency": "5 Hz"}
    push = {"kind": "force", "name": "push", "body": "mass", "table": "push.csv"}
    content = {"scene": {"kind": "mechanism"}, "body": [body], "load": [swing, push]}
    write_toml(tmp_path / "scene.toml", content | {"read": [{"of": "mass.place.x"}]})
    given = scenefile.load(tmp_path / "scene.toml")
    assert float(given.params["swing.amplitude"]) == 2000.0 and float(given.params["swing.frequency"]) == 5.0
    assert given.resolved["load"][1]["table"] == [[0.0, 1.0], [0.0, 2000.0]]
    with pytest.raises(InputError, match=r"amplitude.*frequency"):
        scenefile.from_table(content | {"load": [{k: v for k, v in swing.items() if k != "frequency"}]}, None)
