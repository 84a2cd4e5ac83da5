"""Mechanisms of one's own in scene files: the same as in Python; every mistake named by table and entry, uncompiled."""

from __future__ import annotations

import csv
import re
import runpy
import tomllib
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomli_w
from commands import bcfj
from compiled import COMPILED
from conftest import BUILD

import bcfj_jax as bj
from bcfj_jax.io import scenefile
from bcfj_jax.io.scenefile import load, template
from bcfj_jax.mechanism import checks
from bcfj_jax.xla import host, programs

pytestmark = pytest.mark.filterwarnings("error")

# A user's own: a slider-crank whose rod meets the slider in a bearing with clearance.
PYTHON = """\
import numpy as np
import bcfj_jax as bj
from bcfj_jax import Body, Contact, Drive, Mechanism, Quantity, gaps

LENGTHS = [(Quantity("crank_length", "m", "crank's pins"), 0.05), (Quantity("rod_length", "m", "rod's pins"), 0.12)]
crank = Body("crank", "hinge", mass=0.30, inertia=1.0e-4, drive=Drive("constant", speed=500.0))
rod = Body("rod", "hinge", parent="crank", at=("crank_length", 0, 0), center=(0.06, 0, 0), mass=0.21, inertia=2.5e-4,
           start={"speed": -708.0})
slider = Body("slider", "slide", axis="x", mass=0.14, start={"position": 0.17})
journal = Contact("journal", ("slider", "rod"), gaps.PinInBearing(), at=((0, 0, 0), ("rod_length", 0, 0)))
numbers = {"stiffness": 6.61e10, "exponent": 1.5, "damping": 0.333, "radius": 9.5e-3, "clearance_journal": 0.5e-3}
scene = Mechanism("my_slider_crank", (crank, rod, slider), (journal,), own=LENGTHS, given=numbers)
times = np.linspace(0.0, 0.004, 201)
run = bj.simulate(scene, scene.parameters(), times)
"""
TOML = """\
[scene]
kind = "mechanism"
[quantity.crank_length]
unit = "m"
default = "50 mm"
[quantity.rod_length]
unit = "m"
default = "120 mm"
[[body]]
name = "crank"
joint = "hinge"
mass = "0.30 kg"
inertia = 1.0e-4
drive = { speed = "500 rad/s" }
[[body]]
name = "rod"
joint = "hinge"
parent = "crank"
at = ["crank_length", 0, 0]
center = ["60 mm", 0, 0]
inertia = 2.5e-4
start = { speed = "-708 rad/s" }
[[body]]
name = "slider"
joint = "slide"
axis = "x"
mass = "140 g"
start = { position = "17 cm" }
[[contact]]
name = "journal"
between = ["slider", "rod"]
gap = "pin_in_bearing"
at = [[0, 0, 0], ["rod_length", 0, 0]]
[parameters]
"rod.mass" = "0.21 kg"
"journal.stiffness" = "6.61e10"
exponent = 1.5
damping = "0.333 s/m"
radius = "9.5 mm"
"journal.clearance" = "0.5 mm"
[time]
end = "4 ms"
samples = 201
"""


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Each test in a folder outside the package, with the tests' compile cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    return tmp_path


def written(text: str, name: str = "my.toml") -> Path:
    Path(name).write_text(text, encoding="utf-8")
    return Path(name)


def code_lines(text: str) -> int:
    return sum(1 for line in text.splitlines() if line.strip())


@pytest.mark.slow
def test_a_slider_crank_in_25_lines_of_python_and_the_same_in_toml_give_the_same_forces():
    assert code_lines(PYTHON) <= 25
    mine = runpy.run_path(str(written(PYTHON, "mine.py")))
    given = load(written(TOML))
    run = bj.simulate(given.scene, given.params, given.times)
    assert mine["run"].status == run.status == "ok"
    expected = mine["run"].force["journal"]
    assert np.abs(expected).max() > 1e3
    np.testing.assert_allclose(run.force["journal"], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_what_was_run_loads_back_to_the_same_model():
    reads = '[[read]]\nof = "journal.force.x"\nframe = "rod"\n[[read]]\nof = "slider.acceleration.x"\n'
    load_ = '[[load]]\nkind = "force"\nname = "gas"\nbody = "slider"\ndirection = "-x"\nsize = "1 kN"\nramp = "1 ms"\n'
    first = load(written(TOML + reads + load_))
    assert [c.name for c in first.reads] == ["journal.force.x in rod", "slider.acceleration.x"]
    again = load(written(tomli_w.dumps(first.resolved), "run.toml"))
    assert again.resolved == first.resolved
    assert again.scene == first.scene and hash(again.scene) == hash(first.scene)
    assert again.params == first.params and again.reads == first.reads
    assert np.array_equal(again.times, first.times)
    parameters = first.resolved["parameters"]
    assert parameters["rod.center_x"] == 0.06 and parameters["rod_length"] == 0.12 and parameters["gas.ramp"] == 1e-3


@pytest.mark.slow
def test_the_command_line_keeps_what_is_read():
    done = bcfj("simulate", written(TOML + '[[read]]\nof = "crank.torque"\n'), "--out", "out", "--no-measure-error")
    assert done.exit_code == 0, done.stderr
    with Path("out/readings.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", "crank.torque [N m]"] and len(rows) == 202
    assert load("out/run.toml").resolved == load("my.toml").resolved


def test_the_file_to_start_from_loads_and_says_every_table():
    assert bcfj("init", "mechanism").exit_code == 0
    given = load("mechanism.toml")
    assert given.scene.kind == "mechanism"
    assert given.resolved == load(written(tomli_w.dumps(given.resolved), "run.toml")).resolved
    done = bcfj("validate", "mechanism.toml")
    assert done.exit_code == 0 and "contacts: journal" in done.stdout
    for name in ("body", "contact", "load", "read"):
        assert f"[[{name}]]" in template("mechanism")
    for gap in bj.gaps.GAPS:
        assert gap in template("mechanism")


@pytest.mark.slow
def test_the_file_to_start_from_runs():
    assert bcfj("init", "mechanism").exit_code == 0
    done = bcfj("simulate", "mechanism.toml", "--out", "out")
    assert done.exit_code == 0, done.stderr


PENDULUM = """\
[scene]
kind = "mechanism"
friction = "coulomb"
law = "hertz"
[[body]]
name = "arm"
joint = "hinge"
axis = [0, 0, 2]
tilt = ["x", "90 deg"]
center = [0, "-10 cm", 0]
mass = 1
inertia = [1e-3, 2e-3, "3e-3 kg m^2"]
start = { angle = "6 deg" }
[[body]]
name = "cart"
joint = "slide"
axis = "x"
mass = 2
drive = { kind = "table", table = [["0 ms", "10 ms", "20 ms"], ["0 mm", "1 mm", "0 mm"]] }
[[body]]
name = "balls"
joint = "sphere"
members = 3
mass = "5 g"
inertia = 1e-7
start = { y = "1 cm" }
[[body]]
name = "wheel"
joint = "hinge"
mass = 1
inertia = 1
[[body]]
name = "lead"
joint = "hinge"
mass = 1
inertia = 1
drive = { kind = "ramp", speed = "10 rad/s", over = "5 ms", start = "10 deg" }
[[contact]]
name = "floor"
between = ["ground", "balls"]
gap = { kind = "sphere_on_plane", axis = "y" }
values = { exponent = 1, radius = "ball_radius", stiffness = "1 kN/m", friction_speed = 0.01 }
law = "kelvin_voigt"
elastic = "power"
smoothing = false
approach = "parameter"
[[contact]]
name = "stop"
between = ["ground", "arm"]
gap = { kind = "two_sided_stop", axis = "x" }
at = [[0, 0, 0], [0, "-20 cm", 0]]
friction = false
[[load]]
kind = "gravity"
direction = "-y"
[[load]]
kind = "force"
name = "push"
body = "arm"
at = [0, "-l", 0]
table = [[0, 1], ["0 N", "2 kN"]]
follows = true
[[load]]
kind = "torque"
name = "brake"
body = "wheel"
against = "arm"
direction = "z"
size = "-2 N m"
[[load]]
kind = "spring"
name = "coil"
between = ["ground", "arm"]
at = [[0, 0, 0], [0, "-5 cm", 0]]
stiffness = "1 N/mm"
damping = "c"
free_length = "4 cm"
[[load]]
kind = "bush"
name = "rubber"
between = ["cart", "arm"]
stiffness = "1 N/mm"
turning_damping = "1 N m s/rad"
[[load]]
kind = "joint_spring"
name = "shaft"
body = "wheel"
stiffness = "200 N m/rad"
damping = 1
drive = { speed = "20 r/min" }
[quantity.l]
unit = "m"
lower = 0
upper = "1 m"
default = "200 mm"
[quantity.c]
unit = "N s/m"
default = 3
[parameters]
stiffness = 1e6
exponent = 1
ball_radius = "5 mm"
clearance_stop = "30 mm"
friction_dynamic = 0.1
dashpot = 1
"""


def test_every_kind_of_part_can_be_written_with_units_and_loads_back():
    given = load(written(PENDULUM))
    p = given.params
    assert p["arm.angle"] == pytest.approx(np.pi / 30) and p["arm.tilt"] == pytest.approx(np.pi / 2)
    assert p["floor.stiffness"] == 1e3 and p["stiffness"] == 1e6 and p["coil.stiffness"] == 1e3
    assert p["coil.free_length"] == 0.04 and p["shaft.drive_speed"] == pytest.approx(2 * np.pi / 3)
    assert p["lead.drive_start"] == pytest.approx(np.pi / 18) and p["brake.size"] == -2.0
    assert given.scene.quantities["shaft.stiffness"].unit == "N m/rad"
    assert given.scene.members == {"floor": 3, "stop": 0}
    # A turn of the first drive that turns, for want of an end.
    assert given.times[-1] == pytest.approx(2 * np.pi / 10)
    again = load(written(tomli_w.dumps(given.resolved), "run.toml"))
    assert again.resolved == given.resolved and again.scene == given.scene


SQUEEZED = """
[scene]
kind = "mechanism"
law = "hertz"
[[body]]
name = "ball"
joint = "slide"
axis = "x"
mass = 0.1
[[contact]]
name = "left"
between = ["ground", "ball"]
gap = { kind = "sphere_on_plane", axis = "x" }
at = [["-9.9 mm", 0, 0], [0, 0, 0]]
[[contact]]
name = "right"
between = ["ground", "ball"]
gap = { kind = "sphere_on_plane", axis = "-x" }
at = [["9.9 mm", 0, 0], [0, 0, 0]]
[parameters]
radius = "10 mm"
stiffness = 1e10
exponent = 1.5
[time]
end = "1 ms"
"""


def test_a_ball_with_preload_starts_in_balance_and_one_out_of_place_is_refused():
    given = load(written(SQUEEZED))
    assert float(given.scene.error_scale(given.params)[0]) > 0
    with pytest.raises(bj.InputError, match=r"\[\[contact\]\] 1 'left': 'ground' and 'ball' start 0.003 m inside"):
        load(written(SQUEEZED.replace("-9.9 mm", "-7 mm")))


def test_models_of_a_calibration_file_change_the_options_of_a_mechanism():
    from calibration.problemfile import load as problem
    from calibration.selection.alternatives import models

    written(TOML.replace('"rod.mass"', 'restitution = 0.9\n"rod.mass"').replace('damping = "0.333 s/m"\n', ""))
    rows = (f"{t:.4f},{100.0 * max(0.0, np.sin(np.pi * t)):.4f}" for t in np.linspace(0.0, 1.2, 25))
    written("\n".join(["time [ms],force [N]", *rows]), "d.csv")
    text = 'scene = "my.toml"\n[[experiment]]\nfile = "d.csv"\ntime = "time [ms]"\nnoise = "1 N"\n'
    text += 'observe = { "journal.normal" = "force [N]" }\n[free.restitution]\nlower = 0.5\nupper = 1\n'
    text += '[free."journal.stiffness"]\nlower = 1e9\nupper = 1e12\n'
    text += '[[model]]\nname = "by restitution"\n[[model]]\nname = "elastic"\nscene = { law = "hertz" }\n'
    path = written(text, "p.toml")
    first, second = models(path, problem(path))
    assert first.base.scene.contacts[0].remembers and "restitution" in first.base.params
    assert "restitution" not in second.base.scene.quantities
    # The clearance is given by its other name.
    assert float(second.base.params["clearance_journal"]) == 0.5e-3


def test_a_law_by_restitution_is_taken_where_one_is_given():
    given = load(written(TOML.replace("damping = ", "restitution = ").replace('"0.333 s/m"', "0.9")))
    assert given.resolved["scene"]["law"] == "exact" and given.scene.contacts[0].remembers


def test_options_of_the_scene_make_another_model_of_the_same_parts():
    table = tomllib.loads(TOML)
    table["scene"] = {"kind": "mechanism", "law": "hertz"}
    assert "damping" not in scenefile.model(table).quantities


# What is changed in TOML; what the message must say.
ROD = '[[body]]\nname = "rod"\njoint = "hinge"\nparent = "slider"\n'
BAD = {
    "a loop of ideal joints": ("[[contact]]", f"{ROD}[[contact]]", ["[[body]] 4 'rod'", "close a loop", "a bush"]),
    "two parents": ('parent = "crank"', 'parent = ["crank", "slider"]', ["[[body]] 2 'rod' parent", "close a loop"]),
    "a body without mass": ('"rod.mass" = "0.21 kg"\n', "", ["[[body]] 2 'rod' mass", "no mass for", "rod.mass"]),
    "a mass of nothing": ('"rod.mass" = "0.21 kg"', '"rod.mass" = 0', ["rod.mass = 0 kg is out of range"]),
    "itself": ('["slider", "rod"]', '["rod", "rod"]', ["[[contact]] 1 'journal' between", "'rod' with itself"]),
    "deep": ('"17 cm"', '"16 cm"', ["[[contact]] 1 'journal'", "'slider' and 'rod' start 0.0095 m inside each other"]),
    "nobody reads it": ("exponent = 1.5", "exponent = 1.5\nstiffness = 1e9", ["[parameters] stiffness", "nothing reads"]),
    "own that nobody reads": (
        "[[contact]]", '[quantity.wear]\nunit = "m"\ndefault = 0\n[[contact]]', ["nothing reads the parameter 'wear'"]
    ),
    "a cycle": ('name = "crank"', 'name = "crank"\nparent = "rod"', ["'crank' parent", "form a circle: crank on rod on crank"]),
    "unit of a length": ('"60 mm"', '"60 ms"', ["[[body]] 2 'rod' center[0]", "'60 ms'", "converts to m"]),
    "unit of a mass": ('"0.30 kg"', '"0.30 N"', ["[[body]] 1 'crank' mass", "'0.30 N'", '"16.7 g"']),
    "unit of a speed": ('"500 rad/s"', '"500 m/s"', ["[[body]] 1 'crank' drive.speed", "'500 m/s'"]),
    "unit of a quantity": ('unit = "m"\ndefault = "50', 'unit = "mm"\ndefault = "50', ["[quantity.crank_length] unit", "give m"]),
    "quantity of another kind": ('["crank_length", 0', '["crank.drive_speed", 0', ["at[0]", "is in rad/s, and this is in m"]),
    "unit of a parameter": ('"9.5 mm"', '"9.5 kg"', ["[parameters] radius", "'9.5 kg'"]),
    "a quantity that is not there": ('["crank_length", 0', '["crank_lenght", 0', ["at[0]", "did you mean 'crank_length'?"]),
    "a body that is not there": ('parent = "crank"', 'parent = "krank"', ["[[body]] 2 'rod' parent", "mean 'crank'?"]),
    "a body of a contact": ('"slider", "rod"', '"slidr", "rod"', ["[[contact]] 1 'journal' between", "mean 'slider'?"]),
    "three bodies": ('"slider", "rod"', '"slider", "rod", "crank"', ["[[contact]] 1 'journal' between", "two bodies"]),
    "a key of a body": ('parent = "crank"', 'parnet = "crank"', ["[[body]] 2 'rod' parnet", "mean 'parent'?"]),
    "a key of a drive": ("speed = \"500", "sped = \"500", ["[[body]] 1 'crank' drive.sped", "mean 'speed'?"]),
    "a key that the drive does not read": ('rad/s" }', 'rad/s", over = 1 }', ["drive.over", "'constant' has no over"]),
    "a kind of drive": ("{ speed", '{ kind = "rampe", speed', ["drive.kind", "did you mean 'ramp'?", "--code"]),
    "a key of a contact": ("gap =", "gab =", ["[[contact]] 1 'journal' gab", "mean 'gap'?"]),
    "a table": ("[[contact]]", "[[contakt]]", ["my.toml: contakt", "mean 'contact'?"]),
    "a gap": ('"pin_in_bearing"', '"pin_in_baering"', ["[[contact]] 1 'journal' gap", "mean 'pin_in_bearing'?"]),
    "an option of a gap": (
        '"pin_in_bearing"', '{ kind = "pin_in_bearing", end = true }', ["'journal' gap.end", "mean 'ends'?"]
    ),
    "a law": ("gap =", 'law = "hertzz"\ngap =', ["[[contact]] 1 'journal' law", "mean 'hertz'?"]),
    "an elastic part": ("gap =", 'elastic = "powr"\ngap =', ["[[contact]] 1 'journal' elastic", "mean 'power'?"]),
    "a friction law": ("gap =", 'friction = "colomb"\ngap =', ["[[contact]] 1 'journal' friction", "mean 'coulomb'?"]),
    "a joint": ('joint = "slide"', 'joint = "slid"', ["[[body]] 3 'slider' joint", "mean 'slide'?"]),
    "an axis": ('axis = "x"', 'axis = "w"', ["[[body]] 3 'slider' axis", "no axis 'w'"]),
    "a coordinate": ("{ position", "{ postion", ["[[body]] 3 'slider' start.postion", "mean 'position'?"]),
    "a place of two numbers": ('["60 mm", 0, 0]', '["60 mm", 0]', ["[[body]] 2 'rod' center", "three numbers"]),
    "a coefficient": ("gap =", "values = { dampin = 1 }\ngap =", ["'journal' values.dampin", "mean 'damping'?"]),
    "a load": ("[[contact]]", '[[load]]\nkind = "forse"\n[[contact]]', ["[[load]] 1 kind", "mean 'force'?"]),
    "a body of a load": (
        "[[contact]]", '[[load]]\nkind = "force"\nname = "f"\nbody = "rood"\n[[contact]]', ["[[load]] 1 'f'", "mean 'rod'?"]
    ),
    "a load without a size": (
        "[[contact]]", '[[load]]\nkind = "force"\nname = "f"\nbody = "rod"\n[[contact]]', ["'size' has no value", "f.size"]
    ),
    "a spring on a joint that is driven": (
        "[[contact]]", '[[load]]\nkind = "joint_spring"\nname = "f"\nbody = "crank"\n[[contact]]', ["[[load]] 1 'f' body"]
    ),
    "a reading": ("[time]", '[[read]]\nof = "journal.nrmal"\n[time]', ["[[read]] 1 of", "mean 'normal'?"]),
    "a frame": ("[time]", '[[read]]\nof = "rod.place.x"\nframe = "krank"\n[time]', ["[[read]] 1 frame", "mean 'crank'?"]),
    "a parameter": ("radius =", "radios =", ["[parameters] radios", "mean 'radius'?"]),
    "a name given twice": ('name = "journal"', 'name = "rod"', ["the name 'rod' already belongs to a body"]),
    "no kind of load": ("[[contact]]", '[[load]]\nname = "f"\n[[contact]]', ["[[load]] 1 'f' kind", "is missing"]),
    "bounds": ('unit = "m"\ndefault = "50', 'unit = "m"\nlower = 1\ndefault = "50', ["[quantity.crank_length] default"]),
    "a default in words": ('default = "50 mm"', 'default = "short"', ["[quantity.crank_length] default", "'short'"]),
    "an option of the gap": (
        'gap = "pin_in_bearing"', 'gap = "pin_in_bearing"\npads = 6', ["'journal' pads", 'gap = { kind = "pin_in_bearing", pads']
    ),
    "a coefficient among the keys": (
        'gap = "pin_in_bearing"', 'gap = "pin_in_bearing"\nstiffness = 1', ["'journal' stiffness", '"journal.stiffness" in']
    ),
    "parts of a scene that has its own": ('kind = "mechanism"', 'kind = "impact"', ["[[body]]", "'impact' has its own parts"]),
}  # fmt: skip


@pytest.mark.parametrize("which", BAD)
def test_a_bad_mechanism_is_refused_by_place_before_anything_is_compiled(which, monkeypatch):
    old, new, said = BAD[which]
    assert old in TOML
    written(TOML.replace(old, new, 1))
    # A mechanism that was looked at often, or by an earlier process, is checked by a compiled program.
    monkeypatch.setenv("BCFJ_CACHE", "off")
    monkeypatch.setattr(programs.Settings, "folder", None)
    programs.forget()
    COMPILED.clear()
    done = bcfj("simulate", "my.toml", "--out", "out")
    assert done.exit_code == 2, done.output
    assert done.stderr.startswith("error: my.toml") and done.stderr.count("\n") == 1
    for text in said:
        assert text in done.stderr, done.stderr
    assert not COMPILED and not Path("out").exists()


@pytest.mark.slow
def test_a_good_mechanism_is_checked_without_compiling_and_then_compiled(monkeypatch):
    written(TOML)
    monkeypatch.setattr(programs.Settings, "folder", None)
    programs.forget()
    COMPILED.clear()
    given = load("my.toml")
    assert not COMPILED
    bj.simulate(given.scene, given.params, given.times[:3])
    assert COMPILED


@pytest.mark.full
@pytest.mark.parametrize(
    "kind", ["slider_crank", *(pytest.param(x, marks=pytest.mark.slow) for x in ("bounce", "impact"))]
)
@pytest.mark.parametrize("law", ["memory_free", "exact", pytest.param("zhang", marks=pytest.mark.slow)])
def test_numpy_sees_of_a_start_what_the_compiled_program_sees(kind, law):
    scene = bj.scenes.make(kind, law=law)
    params = scene.parameters()
    for what in (checks._at_start, checks._thrown):
        mine_all = host.evaluate(jax.make_jaxpr(partial(what, scene))(params), jax.tree.leaves(params))
        for mine, compiled in zip(mine_all, jax.tree.leaves(jax.jit(partial(what, scene))(params)), strict=True):
            np.testing.assert_allclose(mine, compiled, rtol=1e-12)


def test_numpy_knows_what_a_gap_of_ones_own_is_made_of():
    """A place that is not computed twice, and slopes of what reads its parts."""
    own = bj.gaps.from_depth(lambda r, c: c["wall"] - jnp.hypot(r[0], r[1] - 0.2) + jnp.sum(r[1:] ** 2), ("wall",))
    bob = bj.Body("bob", "hinge", center=(0.5, 0.0, 0.1), mass=2.0, inertia=0.01, start={"angle": -1.5})
    touch = bj.Contact("touch", ("ground", "bob"), own, "hertz", at=((0, 0, 0), (0.5, 0, 0)))
    scene = bj.Mechanism("own", [bob], [touch], given={"wall": 0.8, "stiffness": 1e6, "exponent": 1.5}, end=1.0)
    params = scene.parameters()
    y = scene.initial_state(params)
    traced = jax.make_jaxpr(lambda y, p: scene.vector_field(0.0, y, p))(y, params)
    assert {"optimization_barrier", "pad"} <= set(re.findall(r"\w+", str(traced)))
    (found,) = host.evaluate(traced, jax.tree.leaves((y, params)))
    wanted = jax.jit(lambda y, p: scene.vector_field(0.0, y, p))(y, params)
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    assert abs(found[1]) > 1.0


def test_numpy_pads_as_xla_does():
    x, sides = np.arange(6.0).reshape(2, 3), ((1, 2, 1), (0, 1, 2))
    traced = jax.make_jaxpr(lambda x: jax.lax.pad(x, -1.0, sides))(x)
    np.testing.assert_array_equal(host.evaluate(traced, [x])[0], jax.lax.pad(x, -1.0, sides))
    cut = jax.make_jaxpr(lambda x: jax.lax.pad(x, 0.0, ((-1, 0, 0), (0, 0, 0))))(x)
    with pytest.raises(host.Unknown, match="pad that cuts"):
        host.evaluate(cut, [x])


def test_a_primitive_unknown_to_numpy_is_named():
    traced = jax.make_jaxpr(lambda x: jax.lax.sort(x))(np.zeros(3))
    with pytest.raises(host.Unknown, match="sort"):
        host.evaluate(traced, [np.zeros(3)])


def test_numpy_follows_loops_branches_and_slices():
    def function(x):
        last = jax.lax.while_loop(lambda c: c < 9.0, lambda c: 2.0 * c, x[0])
        total, each = jax.lax.scan(lambda c, y: (c + y, c * y), 0.0, x, reverse=True)
        chosen = jax.lax.cond(x[1] > 0, jax.numpy.sin, jax.numpy.cos, x[2])
        spread = jax.numpy.interp(0.3, jax.numpy.arange(3.0), x)
        return last, total, each, chosen, spread, jax.numpy.where(x > 0, x, -x) @ x, jax.numpy.clip(x, 0, 1).max()

    x = np.array([1.5, -2.0, 0.7])
    found = host.evaluate(jax.make_jaxpr(function)(x), [x])
    for mine, compiled in zip(found, jax.jit(function)(x), strict=True):
        np.testing.assert_allclose(mine, compiled, rtol=1e-14)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('[quantity]\nrod = "z"\n', r"\[quantity\.rod\]: 'z' is not accepted; give a table"),
        ("[quantity]\nrod = [1.0]\n", r"\[quantity\.rod\]: \[1\.0\] is not accepted; give a table"),
        ("[[contact]]\nname = 'c'\nbetween = ['ground', 'm']\ngap = { kind = ['a'] }\n", r"gap: no gap '\['a'\]'"),
        ("[time]\nlongest_step = [1, 2]\n", r"\[time\]: longest_step has shape \(2,\); give one number"),
    ],
)
def test_a_value_of_another_kind_is_refused_in_words(table, said, tmp_path):
    file = tmp_path / "scene.toml"
    body = '[scene]\nkind = "mechanism"\n[[body]]\nname = "m"\njoint = "slide"\nmass = 1.0\n'
    file.write_text(body + table)
    with pytest.raises(bj.InputError, match=said):
        scenefile.load(file)
