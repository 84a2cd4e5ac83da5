"""Python of the user's own, in a file outside the package: gaps, laws, friction, loads, drives, scenes; every verb."""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from compiled import COMPILED
from conftest import BUILD
from typer.testing import CliRunner

import bcfj_jax as bj
from bcfj_jax.cli import app
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import usercode
from bcfj_jax.io.journal import key_of
from bcfj_jax.io.scenefile import load

pytestmark = pytest.mark.filterwarnings("error")

HEAD = "import jax.numpy as jnp\nimport bcfj_jax as bj\n"
GAP = """
def _depth(r, c):
    return r[0] - c["wall"] + c["bulge"] * r[1] ** 2
_SIZES = (bj.Quantity("wall", "m", "distance of the wall"), bj.Quantity("bulge", "1/m", "half of its curvature"))
bump = bj.gaps.from_depth(_depth, ("wall", "bulge"), _SIZES)
"""
LAW = '''
class Rubber(bj.laws.AbstractLaw):
    """F = (K d + K3 d^3) (1 + a d'): a layer that hardens."""

    needs = ("stiffness", "hardening", "damping")
    quantities = {
        "stiffness": bj.Quantity("stiffness", "N/m", "K of the layer", 0.0),
        "hardening": bj.Quantity("hardening", "N/m^3", "K3 of the layer", 0.0),
    }

    def force(self, penetration, rate, c):
        d = jnp.maximum(penetration, 0.0)
        return (c["stiffness"] * d + c["hardening"] * d**3) * jnp.maximum(1.0 + c["damping"] * rate, 0.0)
'''
FRICTION = '''
class Fading(bj.laws.AbstractFriction):
    """mu = mu_d v/sqrt(v^2 + w^2), with a speed w of its own."""

    needs = ("friction_dynamic", "fade")
    quantities = {"fade": bj.Quantity("fade", "m/s", "speed of half the friction", 0.0, open_low=True)}

    def mobility(self, speed_squared, c):
        return c["friction_dynamic"] / jnp.sqrt(speed_squared + c["fade"] ** 2)
'''
MORE = '''
class Layer(bj.laws.AbstractElastic):
    """F = K d/(1 - d/h)."""

    needs = ("stiffness", "height")
    quantities = {"height": bj.Quantity("height", "m", "of the layer", 0.0, open_low=True)}

    def force(self, penetration, c):
        d = jnp.maximum(penetration, 0.0)
        return c["stiffness"] * d / (1.0 - d / c["height"])

def drag(t, bodies, p):
    v = bodies.velocity("puck")[0]
    return [bj.loads.Action("puck", force=(-p["drag_factor"] * v, 0.0, 0.0))]

def wobble(t, p):
    return 0.01 * jnp.sin(p["pace"] * t)

def my_scene(law: str = "Rubber", *, height: float):
    puck = bj.Body("puck", "slide", axis="x", mass=0.1, start={"velocity": 1.0})
    wall = bj.Contact("wall", ("ground", "puck"), bj.gaps.PointOnPlane("-x"), law=law)
    numbers = {"stiffness": 1e6, "hardening": height, "damping": 0.1}
    return bj.Mechanism("my_scene", [puck], [wall], given=numbers, end=2e-3, samples=201)

def no_scene():
    return 3
'''
CODE = HEAD + GAP + LAW + FRICTION + MORE
# A puck that strikes a curved wall at an angle, on a rail.
SCENE = """
[scene]
kind = "mechanism"
[[body]]
name = "puck"
joint = "slide"
axis = "x"
tilt = ["z", "30 deg"]
mass = "100 g"
start = { velocity = "1 m/s" }
[[contact]]
name = "wall"
between = ["ground", "puck"]
gap = "bump"
law = "Rubber"
friction = "Fading"
[parameters]
wall = "0.2 mm"
bulge = "1 1/m"
stiffness = "1 kN/mm"
hardening = 1e13
damping = 0.1
friction_dynamic = 0.2
fade = "0.1 m/s"
[time]
end = "2 ms"
samples = 101
"""
IMPACT = """
[scene]
kind = "impact"
law = "Rubber"
[parameters]
stiffness = "1 kN/mm"
hardening = 1e13
mass = "0.1 kg"
approach_speed = "1 m/s"
[time]
end = "1.2 ms"
samples = 121
"""
FIT = """
scene = "impact.toml"
[[experiment]]
file = "d.csv"
time = "time [s]"
observe = { "contact.normal" = "contact.normal [N]" }
noise = "1 N"
[free.hardening]
lower = 1e12
upper = 1e14
[free.damping]
lower = 0.01
upper = 1.0
"""
STUDY = """
scene = "s.toml"
[vary.hardening]
lower = 1e12
upper = 1e13
steps = 3
scale = "log"
[vary.fade]
values = [0.1, 0.2]
[results]
features = ["wall.peak", "wall.impulse"]
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Each test in a folder outside the package, with the user's files in it; the names are taken back after it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    texts = {"my.py": CODE, "s.toml": SCENE, "impact.toml": IMPACT, "fit.toml": FIT, "study.toml": STUDY}
    for name, text in texts.items():
        Path(name).write_text(text)
    yield tmp_path
    usercode.forget()


def bcfj(*arguments: object):
    """A command in a process of its own, as far as the user's code goes."""
    usercode.forget()
    return CliRunner().invoke(app, [str(a) for a in arguments])


def digest(name: str = "my.py") -> str:
    return hashlib.sha256(Path(name).read_bytes()).hexdigest()


@pytest.mark.parametrize("part", [GAP, LAW, FRICTION])
def test_a_part_of_ones_own_has_15_lines_at_most(part):
    assert sum(1 for line in part.splitlines() if line.strip()) <= 15


@pytest.mark.slow
def test_simulate_uses_own_gap_law_and_friction_and_keeps_what_code_it_was():
    done = bcfj("simulate", "s.toml", "--code", "my.py", "--out", "out", "--no-measure-error")
    assert done.exit_code == 0, done.stderr
    code = json.loads(Path("out/environment.json").read_text())["code"]
    assert code == [{"path": str(Path("my.py").resolve()), "sha256": digest()}]
    bj.use_code("my.py")
    given = load("out/run.toml")
    run = bj.simulate(given.scene, given.params, given.times)
    p = {name: float(value) for name, value in given.params.items()}
    # The force that the file's own formulas give.
    x = np.cos(np.pi / 6) * run.trajectory[:, 0]
    y, v = np.sin(np.pi / 6) * run.trajectory[:, 0], run.trajectory[:, 1]
    depth = x - p["wall"] + p["bulge"] * y**2
    # This penetration is no distance: its gradient (1, 2 b y) is the normal as it is.
    normal = np.stack([np.ones_like(y), 2 * p["bulge"] * y])
    rate = v * (normal[0] * np.cos(np.pi / 6) + normal[1] * np.sin(np.pi / 6))
    d = np.maximum(depth, 0.0)
    expected = (p["stiffness"] * d + p["hardening"] * d**3) * np.maximum(1 + p["damping"] * rate, 0.0)
    np.testing.assert_allclose(run.force["wall"][:, 0], expected, rtol=1e-9, atol=1e-9 * expected.max())
    assert expected.max() > 100.0 and np.abs(run.force["wall"][:, 2]).max() > 10.0


@pytest.mark.slow
def test_sensitivity_differentiates_by_coefficients_of_ones_own():
    wrt = "hardening,fade,bulge,stiffness"
    done = bcfj("sensitivity", "s.toml", "--wrt", wrt, "--code", "my.py", "--no-certify", "--out", "out")
    assert done.exit_code == 0, done.stderr
    for name in wrt.split(","):
        assert name in done.stdout
    assert (Path("out") / "sensitivity.csv").exists()


@pytest.mark.slow
def test_calibrate_finds_the_coefficients_of_a_law_of_ones_own():
    bj.use_code("my.py")
    given = load("impact.toml")
    force = bj.simulate(given.scene, given.params, given.times, accuracy="reference").force["contact"][:, 0]
    noisy = force + np.random.default_rng(0).normal(0.0, 1.0, force.size)
    rows = [f"{t!r},{f!r}" for t, f in zip(given.times.tolist(), noisy.tolist(), strict=True)]
    Path("d.csv").write_text("\n".join(["time [s],contact.normal [N]", *rows]))
    done = bcfj("calibrate", "fit.toml", "--code", "my.py", "--starts", "4", "--out", "out")
    assert done.exit_code == 0, done.output
    found = json.loads(Path("out/fit.json").read_text())["parameters"]
    assert found["hardening"]["unit"] == "N/m^3"
    low, high = found["hardening"]["ci95"]
    assert low < 1e13 < high and (high - low) < 2e12
    assert json.loads(Path("out/environment.json").read_text())["code"][0]["sha256"] == digest()


def test_the_key_of_a_job_is_another_for_another_content():
    without = key_of("job")
    bj.use_code("my.py")
    first = key_of("job")
    Path("my.py").write_text(CODE + "\n# changed\n")
    bj.use_code("my.py")
    assert len({without, first, key_of("job")}) == 3


@pytest.mark.slow
def test_a_study_keeps_its_code_and_is_not_resumed_with_another():
    pytest.importorskip("pyarrow", reason="the extra study is not installed")
    done = bcfj("study", "run", "study.toml", "--code", "my.py", "--out", "out", "--workers", "1")
    assert done.exit_code == 0, done.output
    state = json.loads(Path("out/study.json").read_text())
    assert state["status"] == "finished" and state["failed"] == 0
    assert state["code"] == json.loads(Path("out/environment.json").read_text())["code"] != []
    again = bcfj("study", "status", "study.toml", "--code", "my.py", "--out", "out")
    assert again.exit_code == 0, again.output
    without = bcfj("study", "resume", "study.toml", "--out", "out")
    assert without.exit_code == 2 and "--code" in without.stderr
    Path("my.py").write_text(CODE.replace("3\n", "4\n"))
    other = bcfj("study", "resume", "study.toml", "--code", "my.py", "--out", "out")
    assert other.exit_code == 2
    assert "was begun with another content of my.py" in other.stderr and digest()[:12] in other.stderr


def test_a_study_without_code_is_not_resumed_with_some():
    pytest.importorskip("pyarrow", reason="the extra study is not installed")
    from bcfj_jax.analysis.studies import api, specification

    text = STUDY.replace('"s.toml"', '"impact"').replace("hardening", "stiffness").replace("fade", "damping")
    Path("study.toml").write_text(text.replace("wall.", "contact."))
    api.prepare(specification.load(Path("study.toml")), Path("out"))
    bj.use_code("my.py")
    with pytest.raises(InputError, match=r"begun without --code my\.py"):
        api.prepare(specification.load(Path("study.toml")), Path("out"))


@pytest.mark.slow
def test_a_block_computed_on_another_machine_has_the_code_sent_to_it():
    pytest.importorskip("pyarrow", reason="the extra study is not installed")
    from bcfj_jax.analysis.studies import api, specification
    from bcfj_jax.analysis.studies.cluster import compute_block

    bj.use_code("my.py")
    store = api.prepare(specification.load(Path("study.toml")), Path("out"))
    files = tuple((str(code.path), code.text) for code in usercode.used())
    study, name = Path("out/run.toml").read_text(), store.blocks.names[0]
    usercode.forget()
    Path("my.py").unlink()
    found = compute_block(study, store.blocks.size, 0, name, files)
    assert set(found) == {f"{name}.parquet"}
    usercode.forget()
    with pytest.raises(InputError, match=r"no gap 'bump'.*--code FILE"):
        compute_block(study, store.blocks.size, 1, store.blocks.names[0], ())


@pytest.mark.slow
def test_workers_of_a_study_use_the_code_and_refuse_another(monkeypatch):
    pytest.importorskip("pyarrow", reason="the extra study is not installed")
    from bcfj_jax.analysis.studies import api, specification, worker

    monkeypatch.setenv("PYTHONPATH", str(Path(api.__file__).parents[3]))
    done = bcfj("study", "run", "study.toml", "--code", "my.py", "--out", "two", "--workers", "2")
    assert done.exit_code == 0, done.output
    alone = bcfj("study", "run", "study.toml", "--code", "my.py", "--out", "one", "--workers", "1")
    assert alone.exit_code == 0, alone.output
    assert Path("one/results.parquet").read_bytes() == Path("two/results.parquet").read_bytes()
    store = api.prepare(specification.load(Path("study.toml")), Path("late"))
    Path("my.py").write_text(CODE + "\n# changed since\n")
    with pytest.raises(worker.Stopped, match="could not read the study"):
        worker.run(store, 1, lambda _: None)


def test_loads_drives_elastic_parts_and_scenes_of_ones_own():
    bj.use_code("my.py")
    text = SCENE.replace('law = "Rubber"', 'law = "hertz"\nelastic = "Layer"').replace(
        "hardening = 1e13\ndamping = 0.1\n", ""
    )
    text = text.replace("[parameters]", '[[load]]\nkind = "drag"\nname = "air"\nbodies = ["puck"]\n'
                        '[[body]]\nname = "hammer"\njoint = "slide"\nmass = 1\ndrive = { kind = "wobble" }\n'
                        '[quantity.drag_factor]\nunit = "N s/m"\ndefault = 1\n[quantity.pace]\nunit = "rad/s"\ndefault = 9\n'
                        '[parameters]\nheight = "5 mm"')  # fmt: skip
    Path("s.toml").write_text(text)
    given = load("s.toml")
    assert {"drag_factor", "pace", "height", "wall.height"} <= set(given.scene.quantities)
    assert given.scene.quantities["height"].unit == "m"
    assert float(given.scene.motions(jnp.asarray(0.1), *_state(given))["hammer"].place[2]) == pytest.approx(
        0.01 * np.sin(0.9)
    )
    Path("own.toml").write_text('[scene]\nkind = "my_scene"\nheight = 2e12\n')
    own = load("own.toml")
    assert own.scene.kind == "my_scene" and float(own.params["hardening"]) == 2e12
    assert own.resolved["scene"] == {"kind": "my_scene", "law": "Rubber", "height": 2e12}
    assert bj.scenes.make("my_scene", height=1.0).contacts[0].law == own.scene.contacts[0].law
    for text, said in (('kind = "my_scene"', "height"), ('kind = "no_scene"', "returned 3")):
        Path("own.toml").write_text(f"[scene]\n{text}\n")
        with pytest.raises(InputError, match=said):
            load("own.toml")


def test_the_joint_reads_coefficients_of_a_law_of_ones_own():
    bj.use_code("my.py")
    Path("j.toml").write_text('[scene]\nkind = "joint"\nlaws = { cage_ball = "Rubber" }\n')
    with pytest.raises(InputError, match=r"'hardening' has no value; it is read by cage_ball"):
        load("j.toml")
    Path("j.toml").write_text(Path("j.toml").read_text() + '[parameters]\n"cage_ball.hardening" = "1 N/mm^3"\n')
    given = load("j.toml")
    assert float(given.params["cage_ball.hardening"]) == pytest.approx(1e9)
    assert given.scene.quantities["hardening"].unit == "N/m^3"


def _state(given):
    return given.scene.initial_state(given.params), given.params


def test_a_scene_file_alone_never_runs_code():
    for text in ('[scene]\nkind = "my_scene"\n', SCENE, SCENE + '[code]\nfile = "my.py"\n'):
        Path("s.toml").write_text(text)
        done = bcfj("simulate", "s.toml")
        assert done.exit_code == 2 and "error: s.toml" in done.stderr
        assert "--code FILE" in done.stderr or "unknown key 'code'" in done.stderr
    assert not usercode.used()


def test_code_is_executed_once_and_again_when_it_has_changed(tmp_path):
    Path("my.py").write_text("with open('log', 'a') as log:\n    log.write('x')\nVALUE = 1\n")
    before = list(sys.path)
    module = bj.use_code("my.py")
    assert bj.use_code(tmp_path / "my.py") is module and module.VALUE == 1
    assert sys.path == before and Path("log").read_text() == "x" and not Path("__pycache__").exists()
    Path("my.py").write_text("VALUE = 2\n")
    assert bj.use_code("my.py").VALUE == 2
    assert len(usercode.record()) == 1 and usercode.record()[0]["sha256"] == digest()


BAD = {
    "raises": ("x = 1\ny = x / 0\n", ["my.py, line 2: its code raised ZeroDivisionError: division by zero"]),
    "raises deep": ("def f():\n    return {}['a']\nf()\n", ["my.py, line 2: its code raised KeyError: 'a'"]),
    "is no Python": ("x = = 1\n", ["my.py, line 1: is no Python: invalid syntax"]),
    "exits": ("import sys\nsys.exit(3)\n", ["my.py, line 2: its code raised SystemExit"]),
    "imports a neighbour": ("import neighbour_of_mine\n", ["my.py, line 1", "into the same file"]),
    "takes a name": (HEAD + FRICTION.replace("Fading", "coulomb"), ["my.py coulomb: the name 'coulomb' is taken"]),
    "takes a scene": ("def joint():\n    pass\n", ["my.py joint: the name 'joint' is taken"]),
    "is not complete": (
        HEAD + "class Half(bj.laws.AbstractLaw):\n    needs = ()\n",
        ["my.py Half: the law lacks force"],
    ),
    "needs a tuple": (
        HEAD + LAW.replace('("stiffness", "hardening", "damping")', '"stiffness"'),
        ["my.py Rubber needs"],
    ),
    "says units badly": (
        HEAD + LAW.replace('"hardening": bj', '"hard": bj'),
        ["my.py Rubber quantities", "by its own name"],
    ),
}


@pytest.mark.parametrize("which", BAD)
def test_bad_code_is_refused_with_file_and_line(which):
    text, said = BAD[which]
    Path("my.py").write_text(text)
    done = bcfj("simulate", "s.toml", "--code", "my.py")
    assert done.exit_code == 2 and done.stderr.startswith("error: ")
    for part in said:
        assert part in done.stderr, done.stderr
    assert not usercode.used()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'c["hardening"] * d**3',
            'c["hardnes"] * d**3',
            ["[[contact]] 1 'wall' law", "KeyError", "my.py, line", "needs"],
        ),
        (
            "d = jnp.maximum(penetration, 0.0)",
            "d = max(penetration, 0.0)",
            ["'wall' law", "my.py, line", "jnp.maximum"],
        ),
        ("r[0] - c", "r[7].x - c", ["'wall' gap", "AttributeError", "my.py, line"]),
    ],
)
def test_code_that_raises_within_a_model_is_refused_with_file_and_line(old, new, said):
    assert old in CODE
    Path("my.py").write_text(CODE.replace(old, new))
    COMPILED.clear()
    done = bcfj("simulate", "s.toml", "--code", "my.py")
    assert done.exit_code == 2, done.output
    for part in said:
        assert part in done.stderr, done.stderr
    assert not COMPILED


def test_a_file_that_is_not_there():
    done = bcfj("simulate", "s.toml", "--code", "none.py")
    assert done.exit_code == 2 and "--code none.py: no file none.py" in done.stderr


def test_validate_says_what_every_kind_of_file_holds():
    rows = (f"{t:.4f},{100.0 * max(0.0, np.sin(np.pi * t)):.4f}" for t in np.linspace(0.0, 1.2, 25))
    Path("d.csv").write_text("\n".join(["time [s],contact.normal [N]", *rows]))
    for name, said in (("s.toml", "contacts: wall"), ("study.toml", "6 points"), ("fit.toml", "hardening, damping")):
        done = bcfj("validate", name, "--code", "my.py")
        assert done.exit_code == 0 and said in done.stdout, done.output
        assert bcfj("validate", name).exit_code == 2
