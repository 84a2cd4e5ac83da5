"""Every verb on every built-in scene, with good input and with thirty kinds of bad input.

No traceback, the exit codes of the contract, one message that names the place and the value, and nothing written.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import MappingProxyType

import pytest
from commands import bcfj
from conftest import BUILD
from problems import PROBLEM, TABLE

from bcfj_jax.io.scenefile import load
from bcfj_jax.models import scenes

SCENES = tuple(scenes.SCENES)
EXAMPLES = Path(__file__).parents[2] / "examples"
STUDY = (
    'scene = "impact"\n[vary.mass]\nlower = "10 g"\nupper = "30 g"\nsteps = 3\n[results]\nfeatures = ["contact.peak"]\n'
)
DESIGN = 'scene = "impact"\n[objective]\nminimize = "contact.peak"\n[vary]\ndamping = [0.1, 1.0]\n'
SCENE = '[scene]\nkind = "impact"\n'


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Each test in a folder of its own, with a good file of each kind in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    files = {"s.toml": SCENE, "study.toml": STUDY, "design.toml": DESIGN, "p.toml": PROBLEM, "d.csv": TABLE}
    for name, text in files.items():
        Path(name).write_text(text)
    return tmp_path


def refused(done, *parts: str, usage: bool = False) -> None:
    """Exit code 2 with a message and without a traceback; nothing on stdout."""
    assert isinstance(done.exception, SystemExit | type(None)), done.exception
    assert done.exit_code == 2, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr and not done.stdout
    assert usage or "error: " in done.stderr
    for part in parts:
        assert part in done.stderr


def state(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def some(name: str) -> tuple[str, str]:
    """A parameter and a feature that a scene has; not one that sets how the scene is built."""
    given = load(name)
    wanted = ("stiffness", "damping", "seat_ball.stiffness")
    parameter = next((p for p in wanted if p in given.params), next(iter(given.params)))
    return parameter, f"{given.scene.contacts[0].name}.peak"


def arguments(verb: str, scene: str) -> list[str]:
    """A good command line of a verb on a scene, without what it is refused for."""
    parameter, feature = some(scene if scene in SCENES else "impact")
    given = load(scene if scene in SCENES else "impact")
    value, traits = float(given.params[parameter]), given.scene.traits
    # A scene without a history takes no steps, and has no solver.
    group = ("rodas3" if traits.stiff else "tsit5") if traits.history else "tolerance"
    return {
        "simulate": ["simulate", scene],
        "sensitivity": ["sensitivity", scene, "--wrt", parameter, "--features", feature],
        "tradeoff": ["tradeoff", scene, "--only", group],
        "design": ["design", scene, "--minimize", feature, "--vary", f"{parameter}={0.9 * value:g}:{1.1 * value:g}"],
    }[verb]


VERBS = ("simulate", "sensitivity", "tradeoff", "design")


# Good input.


def marked(scene: str):
    """The scenes of the full tier; the others are slow."""
    return pytest.param(scene, marks=pytest.mark.full if scene in ("impact", "joint") else pytest.mark.slow)


@pytest.mark.parametrize("scene", [marked(name) for name in SCENES])
def test_every_verb_plans_every_scene(scene, here):
    before = state(here)
    for verb in VERBS:
        done = bcfj(*arguments(verb, scene), "--dry-run", "--json", "-q", "--out", "out")
        assert done.exit_code == 0, (verb, done.stderr, done.exception)
        assert done.stderr == ""
        found = json.loads(done.stdout)
        assert found["command"] == verb and found["exit_code"] == 0 and found["result"]["dry_run"]
    assert state(here) == before and not Path("out").exists()


@pytest.mark.parametrize(
    "command",
    [
        ("validate", "s.toml"), ("validate", "study.toml"), ("validate", "design.toml"), ("validate", "p.toml"),
        ("calibrate", "p.toml", "--dry-run"), ("design", "design.toml", "--dry-run"),
        pytest.param(("study", "run", "study.toml", "--dry-run"), marks=pytest.mark.slow, id="study dry"),
        ("doctor",), ("schema", "study"), ("reproduce", "--dry-run"),
    ],
    ids=lambda x: " ".join(x),
)  # fmt: skip
def test_verbs_that_write_nothing(command, here, monkeypatch, tmp_path_factory):
    if command == ("doctor",):
        # It asks for a folder of programs.
        monkeypatch.setenv("BCFJ_CACHE", str(tmp_path_factory.mktemp("kept")))
    before = state(here)
    done = bcfj(*command, "--json")
    assert done.exit_code == 0, (done.stderr, done.exception)
    assert json.loads(done.stdout)["exit_code"] == 0
    assert state(here) == before


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_is_simulated_and_differentiated(scene):
    short = ["--samples", "51", "--level", "fast"]
    assert bcfj("simulate", scene, *short, "--out", "run").exit_code == 0
    done = bcfj(*arguments("sensitivity", scene), *short, "--budget", "5", "--out", "slopes")
    assert done.exit_code == 0, done.stderr
    assert " drives " in done.stdout


# Bad input: as --set and options, of every scene and verb; by file, of every verb that takes one.

BY_OPTION = {
    "unknown parameter": (["--set", "stifness=1"], ["--set stifness=1", "no parameter 'stifness'"]),
    "unknown table": (["--set", "tme.end=1"], ["--set tme.end=1", "did you mean 'time.end'?"]),
    "unknown key": (["--set", "time.ennd=1"], ["--set time.ennd=1", "did you mean 'end'?"]),
    "unknown kind": (["--set", "scene.kind=jiont"], ["--set scene.kind=jiont", "did you mean 'joint'?"]),
    "unknown option": (["--set", "scene.lawn=hertz"], ["--set scene.lawn=hertz", "unknown key 'lawn'"]),
    "no path": (["--set", "4e10"], ["--set 4e10", "path=value"]),
    "no value": (["--set", "time.end="], ["--set time.end=", "path=value"]),
    "wrong type": (["--set", "time.samples=many"], ["--set time.samples=many", "'many' is not accepted"]),
    "wrong unit": (["--end", "3 kg"], ["--end 3 kg", "'3 kg'"]),
    "no number": (["--end", "soon"], ["--end soon", "'soon'"]),
    "negative time": (["--end", "-1"], ["--end -1", "out of range"]),
    "infinite time": (["--set", "time.end=inf"], ["--set time.end=inf"]),
    "time that is no number": (["--set", "time.end=nan"], ["--set time.end=nan"]),
    "no samples": (["--samples", "0"], ["--samples 0", "0 is not accepted"]),
    "unknown level": (["--level", "fats"], ["--level fats", "did you mean 'fast'?"]),
    "error out of range": (["--set", "accuracy.force_error=7"], ["--set accuracy.force_error=7"]),
    "no steps": (["--set", "accuracy.max_steps=0"], ["--set accuracy.max_steps=0"]),
    "unknown solver": (["--set", "accuracy.solver=euler"], ["--set accuracy.solver=euler", "euler"]),
    "a list": (["--set", "time.end=[1,2]"], ["--set time.end=[1,2]"]),
    "a table for a parameter": (["--set", "parameters=3"], ["--set parameters=3"]),
    "a word of a value": (["--set", "scene=3"], ["--set scene=3"]),
    "a missing code file": (["--code", "mine.py"], ["mine.py"]),
    "out below a file": (["--out", "s.toml/out"], ["--out s.toml/out"]),
    "out is a file": (["--out", "s.toml"], ["--out s.toml", "not a folder"]),
}


@pytest.mark.parametrize("verb", VERBS)
def test_bad_options_of_every_verb(verb, here):
    before, good = state(here), arguments(verb, "impact")
    for name, (options, parts) in BY_OPTION.items():
        done = bcfj(*good, *options)
        assert done.exit_code == 2, (name, done.exit_code, done.stdout, done.stderr)
        refused(done, *parts)
        assert state(here) == before, name


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(name, marks=pytest.mark.full if name == "joint" else pytest.mark.slow)
        for name in SCENES
        if name != "impact"
    ],
)
def test_bad_options_of_every_scene(scene, here):
    before = state(here)
    parameter = some(scene)[0]
    cases = BY_OPTION | {
        "out of range": (["--set", f"{parameter}=-1"], [f"--set {parameter}=-1"]),
        "value that is no number": (["--set", f"{parameter}=nan"], [f"--set {parameter}=nan"]),
        "value of another unit": (["--set", f"{parameter}=3 V"], [f"--set {parameter}=3 V"]),
    }
    for name, (options, parts) in cases.items():
        done = bcfj("simulate", scene, *options)
        assert done.exit_code == 2, (name, done.exit_code, done.stdout, done.stderr)
        refused(done, *parts)
        assert state(here) == before, name


FILES: MappingProxyType[str, bytes] = MappingProxyType(
    {
        "empty": b"",
        "not TOML": b"kind = impact\n",
        "binary": bytes(range(256)),
        "UTF-16": SCENE.encode("utf-16"),
        "a list of nothing": b"x = []\n",
        "scene is a number": b"scene = 3\n",
        "scene is a list": b"scene = [1, 2]\n",
        "unknown table": b'[scene]\nkind = "impact"\n[zzz]\na = 1\n',
        "no kind": b"[scene]\n",
        "kind is a number": b"[scene]\nkind = 3\n",
        "parameters are a list": b'parameters = [1]\n[scene]\nkind = "impact"\n',
        "two values": b'[scene]\nkind = "impact"\n[parameters]\nmass = [1, 2]\n',
        "a parameter twice": b'[scene]\nkind = "impact"\n[parameters]\nmass = 1\nmass = 2\n',
        "a design of nothing": b'scene = "impact"\nobjective = 3\n',
        "a design over a number": b'scene = "impact"\nvary = 3\nsearch = 3\n[objective]\nminimize = "contact.peak"\n',
        "a study over a list": b'scene = "impact"\nvary = [1]\n',
        "records that are a number": b'scene = "impact"\nexperiment = 3\nfree = 3\n',
        "a huge number": b'[scene]\nkind = "impact"\n[parameters]\nmass = 1e400\n',
    }
)
BY_FILE = {
    "simulate": ["simulate", "x.toml"],
    "sensitivity": ["sensitivity", "x.toml", "--wrt", "mass"],
    "tradeoff": ["tradeoff", "x.toml"],
    "design": ["design", "x.toml", "--minimize", "contact.peak", "--vary", "mass=10g:20g"],
    "calibrate": ["calibrate", "x.toml"],
    "validate": ["validate", "x.toml"],
    "study run": ["study", "run", "x.toml"],
    "study status": ["study", "status", "x.toml"],
}


@pytest.mark.parametrize("verb", BY_FILE)
def test_bad_files_of_every_verb(verb, here):
    refused(bcfj(*BY_FILE[verb]), "x.toml", "there is no such file")
    Path("x.toml").mkdir()
    refused(bcfj(*BY_FILE[verb]), "x.toml")
    Path("x.toml").rmdir()
    for name, content in FILES.items():
        Path("x.toml").write_bytes(content)
        before, done = state(here), bcfj(*BY_FILE[verb])
        assert done.exit_code == 2, (name, done.exit_code, done.stdout, done.stderr, done.exception)
        refused(done)
        assert state(here) == before, name


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="who may write everything is refused nothing")
@pytest.mark.parametrize("verb", VERBS)
def test_folders_that_cannot_be_written(verb):
    Path("locked").mkdir(mode=0o500)
    refused(bcfj(*arguments(verb, "impact"), "--out", "locked/out"), "locked")


@pytest.mark.parametrize(
    ("command", "parts"),
    [
        (("sensitivity", "impact", "--wrt", "stifness"), ["wrt", "did you mean 'stiffness'?"]),
        (("sensitivity", "impact", "--wrt", ""), ["wrt", "no parameter"]),
        (("sensitivity", "impact", "--wrt", "mass,mass"), ["'mass' is named twice"]),
        (("sensitivity", "impact", "--wrt", "rotor_*"), ["'rotor_*' names no parameter of the scene"]),
        (("sensitivity", "impact", "--wrt", "mass", "--features", "contact.peek"), ["did you mean 'peak'?"]),
        (("sensitivity", "impact", "--wrt", "mass", "--features", "pin.peak"), ["no contact 'pin'"]),
        (("tradeoff", "impact", "--only", "zzz"), ["zzz"]),
        (("design", "impact", "--vary", "mass=1:2"), ["nothing is to be minimized"]),
        (("design", "impact", "--minimize", "contact.peak"), ["nothing is varied"]),
        (("design", "impact", "--minimize", "contact.peak", "--maximize", "contact.mean", "--vary", "mass=1:2"), ["both"]),
        (("design", "impact", "--minimize", "contact.peak", "--vary", "mass"), ["--vary mass"]),
        (("design", "impact", "--minimize", "contact.peak", "--vary", "mas=1:2"), ["did you mean 'mass'?"]),
        (("design", "impact", "--minimize", "contact.peak", "--vary", "mass=2:1"), ["lower = 2 is not below"]),
        (("design", "impact", "--minimize", "contact.period", "--vary", "mass=1:2"), ["contact.period"]),
        (("calibrate", "p.toml", "--intervals", "zzz"), ["'zzz'"]),
        (("calibrate", "p.toml", "--set", "free.stiffness=3"), ["free.stiffness"]),
        (("calibrate", "p.toml", "--set", "loss=zzz"), ["zzz"]),
        (("calibrate", "p.toml", "--set", "experiment.7.noise=1"), ["no entry '7'"]),
        (("calibrate", "p.toml", "--set", "mass=3"), ["--set mass=3", "no table 'mass'"]),
        (("study", "run", "study.toml", "--set", "vary.mass.steps=0"), ["--set vary.mass.steps=0"]),
        (("study", "run", "study.toml", "--set", "vary.mas.steps=1"), ["vary.mas"]),
        (("study", "run", "study.toml", "--set", "design.kind=zzz"), ["--set design.kind=zzz"]),
        (("study", "run", "study.toml", "--set", "results.features=['a.peak']"), ["'a'"]),
        (("study", "run", "study.toml", "--set", "stifness=1"), ["--set stifness=1"]),
        (("study", "run", "zzz"), ["zzz"]),
        (("study", "resume", "study.toml", "--out", "out"), ["no study to resume"]),
        (("study", "indices", "study.toml", "--out", "out"), ["there is no study"]),
        (("init", "zzz"), ["zzz"]),
        (("init", "impact", "--out", "s.toml"), ["already holds s.toml"]),
        (("init", "calibration"), ["no record"]),
        (("init", "calibration", "no.csv"), ["no.csv"]),
        (("verify", "--only", "zzz"), ["zzz"]),
        (("report", "zzz"), ["zzz"]),
        (("simulate", "zzz"), ["zzz", "no such scene"]),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, tuple) else "",
)  # fmt: skip
def test_what_verbs_refuse(command, parts, here):
    before = state(here)
    refused(bcfj(*command), *parts)
    assert state(here) == before


@pytest.mark.parametrize(
    "name",
    [
        "run.toml",
        "environment.json",
        "results.parquet",
        "study.json",
        "report.html",
        "report.json",
        "study.png",
        "blocks",
    ],
)
def test_a_study_leaves_what_a_folder_holds(name, here):
    Path("out").mkdir()
    Path("out", name).write_text("mine")
    before = state(here)
    refused(bcfj("study", "run", "study.toml", "--out", "out"), "out", name)
    assert state(here) == before


def test_a_study_leaves_another_study(here):
    from bcfj_jax.analysis.studies import api, specification

    api.prepare(specification.load(Path("study.toml")), Path("out"))
    Path("study.toml").write_text(STUDY.replace("steps = 3", "steps = 4"))
    before = state(here)
    for options in ((), ("--set", "vary.mass.steps=5")):
        refused(bcfj("study", "run", "study.toml", "--out", "out", *options), "--out out: holds another study")
    assert state(here) == before


@pytest.mark.parametrize(
    "command",
    [
        ("calibrate", "p.toml", "--seed", "-1"), ("calibrate", "p.toml", "--seed", "x"), ("simulate",), ("zzz",),
        ("calibrate", "p.toml", "--starts", "0"), ("sensitivity", "impact", "--wrt", "mass", "--budget", "-1"),
        ("simulate", "impact", "--samples", "x"), ("schema", "zzz"), ("design", "impact", "--seed", "-1"),
        ("simulate", "impact", "--zzz"), ("study", "run", "study.toml", "--workers", "0"), ("study", "zzz"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_bad_usage(command, here):
    before = state(here)
    refused(bcfj(*command), usage=True)
    assert state(here) == before
