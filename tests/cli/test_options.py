"""Options that verbs share: --set and its short forms, --json, --quiet; groups of parameters; doctor; stages."""

from __future__ import annotations

import json
import re
import shutil
import time
import tomllib
from pathlib import Path

import pytest
from commands import bcfj
from conftest import BUILD
from joints import plain_joint
from problems import PROBLEM, TABLE

import bcfj_jax as bj
from bcfj_jax import InputError
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.analysis.designs import command as designs
from bcfj_jax.analysis.designs import designfile
from bcfj_jax.analysis.studies import command as studies
from bcfj_jax.analysis.studies import specification
from bcfj_jax.cli import app, plan
from bcfj_jax.cli.options import asked
from bcfj_jax.core.progress import Waiting, stage
from bcfj_jax.io import changes, doctor, outputs, scenefile
from bcfj_jax.xla import programs
from calibration import problemfile

STUDY = 'scene = "s.toml"\n[vary.mass]\nlower = "10 g"\nupper = "30 g"\nsteps = 3\n'


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Each test in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    Path("s.toml").write_text('[scene]\nkind = "impact"\n[accuracy]\nforce_error = 0.02\n')
    Path("p.toml").write_text(PROBLEM)
    Path("d.csv").write_text(TABLE)
    return tmp_path


def changed(what: str, *texts: str):
    with changes.changing(what, [changes.parse(text) for text in texts]):
        return scenefile.load(what)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("x=4e10", 4e10), ("x=3", 3), ("x=true", True), ("x=3 s", "3 s"), ("x='3 s'", "3 s"), ("x=.5", 0.5),
        ("x=[1, 2]", [1, 2]), ("x=tsit5", "tsit5"), ("x=a=b", "a=b"), ("x=1\ny=2", "1\ny=2"),
    ],
)  # fmt: skip
def test_values_are_read_as_in_toml(text, value):
    found = changes.parse(text)
    assert found.words == ("x",) and found.value == value and type(found.value) is type(value)


def test_a_path_is_a_table_or_a_parameter():
    given = changed("s.toml", "mass=20 g", "parameters.damping=0.2", "time.end=40 us", "accuracy.level=fast")
    assert float(given.params["mass"]) == pytest.approx(0.02) and float(given.params["damping"]) == 0.2
    assert given.times[-1] == pytest.approx(40e-6) and given.accuracy == "fast"
    # The file is as it was outside.
    assert scenefile.load("s.toml").accuracy == 0.02
    joint = changed("joint", "seat_ball.stiffness=1e10", "scene.friction=false")
    assert float(joint.params["seat_ball.stiffness"]) == 1e10 and "friction_static" not in joint.params


def test_names_with_a_point_need_no_quotes():
    Path("j.toml").write_text('[scene]\nkind = "joint"\n[parameters]\nseat_ball.stiffness = 1e10\n')
    assert float(scenefile.load("j.toml").params["seat_ball.stiffness"]) == 1e10
    Path("v.toml").write_text('scene = "joint"\n[vary.seat_ball.stiffness]\nlower = 1e9\nupper = 1e10\nsteps = 2\n')
    assert studies.find("v.toml")[0].names == ("seat_ball.stiffness",)


def test_a_mechanism_is_changed_by_names_of_its_parts():
    bcfj("init", "mechanism")
    table = tomllib.loads(Path("mechanism.toml").read_text())
    first, second = (body["name"] for body in table["body"][:2])
    given = changed("mechanism.toml", f"body.{first}.mass=6 kg", "body.2.mass=7 kg")
    assert [float(given.params[f"{name}.mass"]) for name in (first, second)] == [6.0, 7.0]
    with pytest.raises(InputError, match=r"--set body.zzz.mass=1: no entry 'zzz'"):
        changed("mechanism.toml", "body.zzz.mass=1")


@pytest.mark.parametrize(
    "path", ["results.features.1.x", "results.features.²", "results.features.3", "results.histories.x"]
)
def test_a_path_into_what_is_no_table_is_refused(path):
    Path("study.toml").write_text(f'{STUDY}[results]\nfeatures = ["contact.peak"]\nhistories = false\n')
    with (
        pytest.raises(InputError, match=f"--set {path}=1"),
        studies.changing("study.toml", [changes.parse(f"{path}=1")]),
    ):
        studies.find("study.toml")


def test_a_study_is_changed_with_its_scene():
    Path("study.toml").write_text(STUDY)
    wanted = [changes.parse(text) for text in ("vary.mass.steps=5", "stiffness=2e9", "time.end=50 us")]
    with studies.changing("study.toml", wanted):
        study = studies.find("study.toml")[0]
    assert study.count == 5 and float(study.given.params["stiffness"]) == 2e9 and not study.own_end
    Path("study.toml").write_text('scene = { scene = { kind = "impact" } }\n' + STUDY.partition("\n")[2])
    with studies.changing("study.toml", wanted):
        again = studies.find("study.toml")[0]
    assert again.count == 5 and float(again.given.params["stiffness"]) == 2e9


def test_the_seed_of_a_study_is_an_option_and_is_said_again():
    text = STUDY.partition("\n")[2].replace("steps = 3\n", "")
    Path("study.toml").write_text(f'scene = "s.toml"\n[design]\nkind = "latin_hypercube"\npoints = 4\n{text}')
    drawn = []
    for seed in (None, 3, 3):
        wanted = asked({"seed": seed, "set_": ["time.end=50 us"]})
        with studies.changing("study.toml", wanted):
            drawn.append(studies.find("study.toml")[0].points)
            again = changes.as_options()
    assert (drawn[0] != drawn[1]).all() and (drawn[1] == drawn[2]).all()
    assert sorted(again.split(" --")) == ["", "seed 3", "set 'time.end=50 us'"] and changes.as_options() == ""


@pytest.mark.parametrize(
    ("made", "known"),
    [
        (scenefile.schema, changes.SCENE),
        (specification.schema, changes.STUDY),
        (problemfile.schema, changes.CALIBRATION),
        (designfile.schema, changes.DESIGN),
    ],
    ids=["scene", "study", "calibration", "design"],
)
def test_every_table_of_a_file_can_be_set(made, known):
    assert {*known, "scene"} == {*made()["properties"]}


def test_a_calibration_is_changed():
    wanted = [changes.parse(text) for text in ("free.stiffness=[2e8, 3e8]", "experiment.1.noise=3 N")]
    with changes.changing("p.toml", wanted, changes.CALIBRATION):
        problem = problemfile.load("p.toml")
    free = {f.name: f for f in problem.free}["stiffness"]
    assert (free.lower, free.upper) == (2e8, 3e8) and problem.experiments[0].channels[0].sigma == 3.0


def test_a_design_is_asked_in_a_file_or_on_the_command_line():
    name, one = designs.vary("damping=0.1:1 s/m:0.01")
    more = {"objective": {"minimize": "contact.peak"}, "vary": {name: one}, "search": {"starts": 3}}
    asked = designfile.load("s.toml", more)
    designs.check(asked)
    assert asked.free["damping"] == bj.Free(0.1, "1 s/m", 0.01) and asked.search.starts == 3 and not asked.note
    text = 'scene = "s.toml"\n[objective]\nmaximize = { "contact.peak" = 2.0 }\n[vary]\nmass = ["10 g", "20 g"]\n'
    Path("d.toml").write_text(text)
    asked = designfile.load("d.toml", {})
    assert (
        asked.search.sense == "maximise" and asked.objective == {"contact.peak": 2.0} and list(asked.free) == ["mass"]
    )
    Path("d.toml").write_text(text.replace('"20 g"]', '"20 g", "1 g"]'))
    with changes.changing("d.toml", [changes.parse("vary.mass.upper=30 g")], changes.DESIGN):
        assert designfile.load("d.toml", {}).free["mass"] == bj.Free("10 g", "30 g", "1 g")


def test_a_joint_is_designed_among_equilibria():
    more = {
        "objective": {"minimize": "seat_cage.peak"},
        "vary": {"clearance_seat_cage": {"lower": 1e-5, "upper": 2e-4}},
    }
    asked = designfile.load("joint", more)
    assert not asked.scene.traits.history and len(asked.times) == 49 and "equilibrium" in asked.note
    with changes.changing("joint", [changes.parse("time.end=0.2 s"), changes.parse("scene.fidelity=dynamic")]):
        asked = designfile.load("joint", more)
    assert asked.scene.traits.history and asked.times[-1] == 0.2


def test_groups_and_patterns_of_parameters():
    scene = plain_joint()
    params = scene.parameters()
    clearances = complete(scene, params, ["clearances"])[1]
    assert len(clearances) == 5 and all(name.startswith("clearance_") for name in clearances)
    assert complete(scene, params, ["clearance_*"])[1] == clearances
    assert complete(scene, params, ["clearance_seat_*", "stiffnesses"])[1][:2] == clearances[:1] + clearances[3:4]
    assert set(complete(scene, params, ["all"])[1]) == set(params)


@pytest.mark.full
def test_results_as_json_on_stdout_alone(tmp_path):
    # What a verb before wrote is no result of this one.
    earlier = tmp_path / "earlier" / "summary.json"
    outputs.write_json(Path("out/summary.json"), {})
    outputs.write_json(earlier, {"status": "of another"})
    shutil.rmtree("out")
    done = bcfj("simulate", "impact", "--set", "mass=20 g", "--samples", "101", "--json", "-q", "--out", "out")
    assert done.exit_code == 0 and done.stderr == ""
    found = json.loads(done.stdout)
    assert found["result"] == json.loads(Path("out/summary.json").read_text())
    assert "out/forces.csv" in found["files"] and "results in out" in found["text"]
    assert tomllib.loads(Path("out/run.toml").read_text())["parameters"]["mass"] == pytest.approx(0.02)
    done = bcfj("simulate", "impact", "--set", "mas=20 g", "--json")
    assert json.loads(done.stdout)["error"]["where"] == "--set mas=20 g" and done.exit_code == 2


def verbs(group=None, prefix=()):
    import typer

    command = group or typer.main.get_command(app)
    for name, one in getattr(command, "commands", {}).items():
        if hasattr(one, "commands"):
            yield from verbs(one, (*prefix, name))
        else:
            yield (*prefix, name), one


@pytest.mark.parametrize(("name", "command"), [pytest.param(*v, id=" ".join(v[0])) for v in verbs()])
def test_every_verb_has_an_example_and_the_shared_options(name, command):
    shown = bcfj(*name, "-h").stdout
    assert f"Example: bcfj {' '.join(name)}" in re.sub(r"\s+", " ", shown)
    options = {option for parameter in command.params for option in parameter.opts}
    assert {"--json", "--quiet", "-q", "--verbose", "-v"} <= options


SIMULATING = ("simulate", "animate", "sensitivity", "tradeoff", "design", "study run", "study resume")
DRAWING = ("calibrate", "design", "study run", "study resume", "study indices")


@pytest.mark.parametrize(("name", "command"), [pytest.param(*v, id=" ".join(v[0])) for v in verbs()])
def test_verbs_that_simulate_can_be_changed_and_those_that_draw_have_a_seed(name, command):
    options = {option for parameter in command.params for option in parameter.opts}
    said = " ".join(name)
    if said in SIMULATING:
        assert {"--set", "--end", "--samples", "--level", "--out"} <= options
    if said in (*SIMULATING, "calibrate", "reproduce") and said != "study resume":
        assert "--dry-run" in options
    assert ("--seed" in options) == (said in DRAWING or said in ("study status", "study merge", "study surface"))


def test_the_page_of_commands_names_every_verb_and_option():
    page = (Path(__file__).parents[2] / "docs" / "commands.md").read_text(encoding="utf-8")
    for name, command in verbs():
        assert f"`bcfj {' '.join(name)}" in page, name
        for parameter in command.params:
            for option in parameter.opts if parameter.param_type_name == "option" else ():
                assert f"`{option}" in page, (name, option)


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        ("sensitivity impact --wrt stiffness --wrt damping", "separate its values by commas"),
        ("simulate impact --end 1 --end 2", "give it once"),
        ("study run s.toml --out a --out b", "give it once"),
        ("simulate impact --set mass=1 --set parameters.mass=2 --dry-run", "parameters.mass is set twice"),
        ("simulate impact --set time.end=1 --end 2 --dry-run", "time.end is set twice"),
        ("simulate impact -q -q --set stiffness=1e9 --set damping=0 --dry-run", None),
    ],
)
def test_an_option_given_twice_is_refused(words, remedy):
    found = bcfj(*words.split())
    assert (found.exit_code, remedy is None or remedy in found.output) == (0 if remedy is None else 2, True)


def test_doctor_finds_faults(monkeypatch, tmp_path):
    kept = tmp_path / "programs"
    kept.mkdir(mode=0o700)
    monkeypatch.setattr(programs.Settings, "folder", kept)
    assert doctor.healthy(doctor.examine())
    monkeypatch.setattr(doctor, "_installed", lambda name: {"jax": "0.10.2", "pyarrow": None}.get(name, "99.0"))
    found = {one.what: one for one in doctor.examine()}
    assert found["jax"].state == doctor.BAD and "!=0.10.2" in found["jax"].remedy
    assert found["extra study"].state == doctor.NOTE and 'bcfj-jax[study]"' in found["extra study"].remedy
    text = doctor.text(list(found.values()))
    assert "What can be done:" in text and "fault(s) were found" in text
    monkeypatch.setenv("BCFJ_CACHE", "off")
    assert "BCFJ_CACHE=off" in {one.what: one for one in doctor.examine()}["compiled programs"].found


def test_stages_are_counted_and_the_last_speaks(monkeypatch):
    said: list[str] = []
    for name, value in (("say", said.append), ("after", 0.0), ("every", 0.1), ("bar", None)):
        monkeypatch.setattr(Waiting, name, value)
    with stage("outer"), stage("blocks", 4) as done:
        for k in range(1, 4):
            done(k)
            time.sleep(0.2)
    assert said[:2] == ["outer", "blocks"]
    assert any(re.fullmatch(r"blocks: [123] of 4, about \d s left", line) for line in said)
    assert not any(line.startswith("outer (") for line in said)
    said.clear()
    # What was there before the stage began took none of its time.
    with stage("blocks", 100) as done:
        for k in (90, 91):
            done(k)
            time.sleep(0.2)
    assert re.fullmatch(r"blocks: 91 of 100, about [1-5] s left", said[-1])
    said.clear()
    with stage("alone"):
        time.sleep(0.3)
    assert said[0] == "alone" and said[1] == "alone (0 s so far)"


def test_bars_come_and_go():
    from bcfj_jax.cli.bars import Bars

    bars = Bars()
    first, second = bars("first", None), bars("second", 3)
    first.tick(2.0, False)
    second.advance(1)
    second.tick(2.0, True)
    assert len(bars.display.tasks) == 2 and second.key is not None
    second.advance(2)
    assert next(task for task in bars.display.tasks if task.id == second.key).fields["count"] == "2 of 3"
    first.close()
    second.close()
    assert bars.display is None


def test_only_a_command_that_went_well_is_timed(monkeypatch):
    timed = []
    monkeypatch.setattr(plan.programs, "remember", lambda name, seconds: timed.append(name))
    assert plan.ended("simulate", "impact", 0.0, False) == 3 and not timed
    # A budget may have left runs behind, for which whatever computes would wait.
    monkeypatch.setattr(scenefile, "from_table", lambda *_: pytest.fail("nothing is built for it"))
    assert plan.ended("simulate", "impact", 0.0, True) == 0 and timed == ["bcfj simulate impact"]
