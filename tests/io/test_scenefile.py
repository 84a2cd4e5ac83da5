"""Scene files: what they say, what they refuse and how."""

from __future__ import annotations

import copy
import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from bcfj_jax import laws, scenes
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import scenefile
from bcfj_jax.io.scenefile import from_table, load, template
from bcfj_jax.io.tables import read
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.scene import CAGES, DRIVES, FIDELITIES, HEADS, STIFFNESSES, TRACKS, USUAL

pytestmark = pytest.mark.filterwarnings("error")

IMPACT = '[scene]\nkind = "impact"\n'
JOINT = '[scene]\nkind = "joint"\n'
SPHERES = '[scene.spheres]\nradius = ["10 mm", inf]\nyoungs_modulus = ["70 GPa", inf]\npoisson = [0.3, 0.3]\n'
SPHERES += "density = [2699, 2699]\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", scenes.SCENES)
def test_template_loads_back_to_the_defaults(tmp_path, kind):
    named, filed = load(kind), load(written(tmp_path, template(kind)))
    assert filed.resolved == named.resolved
    assert filed.scene == named.scene
    assert named.source is None
    if scenes.sources(kind).by_name and "damping" in named.params:
        assert "GUESS" in next(line for line in template(kind).splitlines() if line.startswith("damping"))


@pytest.mark.parametrize("kind", scenes.SCENES)
def test_template_says_what_every_option_is(kind):
    # From the scene's own function: a new scene needs no word here.
    lines = {line.lstrip("# ").partition(" = ")[0]: line for line in template(kind).splitlines() if " = " in line}
    for name in inspect.signature(scenes.SCENES[kind]).parameters:
        below = "contacts" if name == "contacts" else ""
        assert below or "  # " in lines[name], name


def test_options_are_described_in_the_words_of_the_docstring():
    assert "# without clearance: rod and slider move as the crank's turn says" in template("slider_crank")
    assert "balls = 6  # 3 or more, each in a track of its own\n" in template("joint")


def test_a_clearance_goes_by_either_name(tmp_path):
    text = '[scene]\nkind = "slider_crank"\n[parameters]\n{} = "0.2 mm"\n'
    found = [load(written(tmp_path, text.format(name))) for name in ('"journal.clearance"', "clearance_journal")]
    assert found[0].resolved == found[1].resolved and float(found[0].params["clearance_journal"]) == 2e-4
    with pytest.raises(InputError, match="given twice, by two names"):
        load(written(tmp_path, text.format("clearance_journal") + '"journal.clearance" = 1e-4\n'))


def test_template_of_the_joint_says_what_every_number_is_and_where_it_is_from():
    scene, text = load("joint").scene, template("joint")
    lines = {line.lstrip("# ").partition(" = ")[0].strip('"'): line for line in text.splitlines() if " = " in line}
    for name in inspect.signature(scenes.SCENES["joint"]).parameters:
        assert name in lines
    for name, quantity in scene.quantities.items():
        unit = "-" if quantity.unit == "1" else quantity.unit
        assert f"# [{unit}] {quantity.range}. {quantity.meaning}." in lines[name]
        if name in DEFAULTS:
            value, source = DEFAULTS[name]
            assert lines[name].lstrip('"').startswith(name) and f" = {value!r} " in lines[name]
            assert lines[name].endswith(f". {source}.")
        else:
            assert lines[name].startswith(f'# "{name}" = {DEFAULTS[name.rpartition(".")[2]][0]!r} ')
    assert "GUESS" in lines["offset"] and "paper" in lines["friction_static"]
    for choices in (TRACKS, CAGES, HEADS, DRIVES, FIDELITIES, laws.FRICTION, STIFFNESSES, USUAL):
        assert ", ".join(choices) in text.replace('"', "")


def test_template_of_the_joint_with_all_its_own_coefficients_is_the_same_joint(tmp_path):
    # What stands behind the comment sign is good too: the shared values, contact by contact.
    text = re.sub(r'(?m)^# ("\w+\.\w+" = )', r"\1", template("joint"))
    given, named = load(written(tmp_path, text)), load("joint")
    own = set(given.params) - set(named.params)
    assert own == {name for name in named.scene.quantities if "." in name and name not in DEFAULTS}
    for contact in named.scene.contacts:
        for name in contact.needs:
            values = [float(named.scene.coefficient(x.params, contact.name, name)) for x in (given, named)]
            assert values[0] == values[1]


@pytest.mark.parametrize("name", ["chung_ooi_test1", "chung_ooi_test2"])
def test_resolved_input_loads_back_to_itself(name):
    first = load(Path(__file__).parents[2] / "examples" / f"{name}.toml")
    again = from_table(first.resolved, Path("run.toml"))
    assert again.resolved == first.resolved
    assert np.array_equal(again.times, first.times)
    assert {k: float(v) for k, v in again.params.items()} == {k: float(v) for k, v in first.params.items()}


JOINTS = {
    "defaults": "",
    "cage": 'cage = "fixed"\n',
    "frictions": 'friction = "step"\nfrictions = { cage_ball = false }\n',
    "contacts": 'contacts = ["seat_ball", "head_ball"]\nhead = "fixed"\nballs = 3\ntrack = "circular"\n',
    "own": 'fidelity = "quasistatic"\n[parameters]\n"seat_ball.stiffness" = "4e10 N/m^1.5"\nrestitution = 0.9\n',
    "laws": 'laws = { cage_ball = "hertz" }\nelastic = "linear"\n',
}


@pytest.mark.parametrize("text", JOINTS.values(), ids=JOINTS.keys())
def test_resolved_joint_loads_back_to_itself(tmp_path, text):
    first = load(written(tmp_path, JOINT + text))
    again = from_table(read_back(first.resolved, tmp_path), Path("run.toml"))
    assert again.resolved == first.resolved and again.scene == first.scene
    assert {k: float(v) for k, v in again.params.items()} == {k: float(v) for k, v in first.params.items()}


# The resolved elastic part is the first contact's: with kelvin_voigt for some contacts it is not that of the others.
@pytest.mark.parametrize("contact", ["cage_ball", "seat_cage"])
def test_resolved_joint_with_unlike_elastic_parts_loads_back_to_itself(tmp_path, contact):
    first = load(written(tmp_path, JOINT + f'laws = {{ {contact} = "kelvin_voigt" }}\n'))
    again = from_table(first.resolved, Path("run.toml"))
    assert again.scene == first.scene


def read_back(table: dict, folder: Path) -> dict:
    """A resolved table through a file, as ``run.toml``."""
    path = folder / "run.toml"
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return read(path)


def test_joint_in_units(tmp_path):
    text = '[parameters]\ndrive_speed = "100 r/min"\nload_torque = "1.8 kN m"\njoint_angle = "23 deg"\n'
    text += 'clearance_seat_cage = "30 um"\n"cage_ball.stiffness" = "1e5 N/mm^1.5"\n'
    given, named = load(written(tmp_path, JOINT + text)), load("joint")
    for name in ("drive_speed", "load_torque", "joint_angle"):
        assert float(given.params[name]) == pytest.approx(float(named.params[name]), rel=1e-12)
    assert float(given.params["clearance_seat_cage"]) == 30e-6
    assert float(given.params["cage_ball.stiffness"]) == pytest.approx(1e5 * 1000**1.5)


def test_stiffness_of_one_contact_goes_by_its_own_exponent(tmp_path):
    text = JOINT + '[parameters]\n"seat_ball.exponent" = 1.0\n"seat_ball.stiffness" = "1e5 N/mm"\n'
    given = load(written(tmp_path, text + 'stiffness = "1e5 N/mm^1.5"\n'))
    assert float(given.params["seat_ball.stiffness"]) == pytest.approx(1e8)
    assert float(given.params["stiffness"]) == pytest.approx(1e5 * 1000**1.5)


def test_stiffness_of_one_linear_contact_has_exponent_one(tmp_path):
    text = JOINT + 'laws = { seat_ball = "kelvin_voigt" }\n[parameters]\n"seat_ball.stiffness" = "2 N/um"\n'
    assert float(load(written(tmp_path, text)).params["seat_ball.stiffness"]) == pytest.approx(2e6)


def test_units_times_and_accuracy(tmp_path):
    text = IMPACT + '[parameters]\nmass = "16 g"\nstiffness = "1e5 N/mm^1.5"\n[time]\nend = "80 us"\nsamples = 5\n'
    given = load(written(tmp_path, text + '[accuracy]\nforce_error = "1 %"\nmax_steps = 77\n'))
    assert float(given.params["mass"]) == 0.016
    assert float(given.params["stiffness"]) == pytest.approx(1e5 * 1000**1.5)
    assert given.times == pytest.approx(np.linspace(0, 80e-6, 5))
    assert (given.accuracy, given.max_steps) == (0.01, 77)


def test_stiffness_of_a_linear_law_has_exponent_one(tmp_path):
    text = '[scene]\nkind = "impact"\nlaw = "kelvin_voigt"\n[parameters]\nstiffness = "2 N/um"\n'
    given = load(written(tmp_path, text))
    assert float(given.params["stiffness"]) == pytest.approx(2e6)
    assert given.resolved["scene"]["elastic"] == "linear"


def test_restitution_alone_selects_the_exact_law(tmp_path):
    given = load(written(tmp_path, IMPACT + "[parameters]\nrestitution = 0.7\n"))
    assert given.resolved["scene"]["law"] == "exact"
    assert given.scene.contacts[0].law == laws.make("exact")


def test_spheres_set_stiffness_exponent_and_mass(tmp_path):
    given = load(written(tmp_path, IMPACT + SPHERES))
    modulus = 70e9 / (1 - 0.3**2)
    assert float(given.params["stiffness"]) == pytest.approx(4 / 3 * modulus * math.sqrt(0.01))
    assert float(given.params["exponent"]) == 1.5
    assert float(given.params["mass"]) == pytest.approx(4 / 3 * math.pi * 0.01**3 * 2699)


BAD = [
    ("[scen]\nkind = 3\n", ["scen: unknown key 'scen'", "did you mean 'scene'?"]),
    ("[parameters]\n", ["scene", "missing"]),
    ("[scene]\n", ["[scene] kind", "missing", "impact, bounce"]),
    ('[scene]\nkind = "impakt"\n', ["[scene] kind", "'impakt'", "did you mean 'impact'?"]),
    (IMPACT + 'low = "hertz"\n', ["[scene] low", "unknown key 'low'", "did you mean 'law'?"]),
    (IMPACT + "friction = true\n", ["[scene] friction", "unknown key 'friction'"]),
    (IMPACT + 'law = "herz"\n', ["[scene] law", "'herz'", "did you mean 'hertz'?"]),
    (IMPACT + 'elastic = "liuu"\n', ["[scene] elastic", "'liuu'", "did you mean 'liu'?"]),
    (IMPACT + 'smoothing = "no"\n', ["[scene] smoothing", "'no'", "boolean"]),
    (IMPACT + "[parameters]\nstifness = 1\n", ["[parameters] stifness", "did you mean 'stiffness'?"]),
    (IMPACT + "[parameters]\nrestitution = 0.5\ndamping = 1\n", ["[parameters] damping", "known here:", "restitution"]),
    (IMPACT + '[parameters]\nmass = "3 m"\n', ["[parameters] mass", "'3 m'", '"16.7 g"']),
    (IMPACT + "[parameters]\nmass = true\n", ["[parameters] mass", "True"]),
    (IMPACT + "[parameters]\nmass = -1\n", ["[parameters] mass", "-1 kg", "> 0"]),
    (IMPACT + "[parameters]\nmass = nan\n", ["[parameters] mass", "nan"]),
    (IMPACT + '[parameters]\nstiffness = "1e5 N/mm"\n', ["[parameters] stiffness", "length^1,", "exponent is 1.5"]),
    (
        IMPACT + '[parameters]\nstiffness = "1e5 N/mm^1.5"\nexponent = 1.2\n',
        ["[parameters] stiffness", "exponent is 1.2", "N/m^1.2"],
    ),
    (IMPACT + "[time]\nendd = 1\n", ["[time] endd", "did you mean 'end'?"]),
    (IMPACT + '[time]\nend = "3 m"\n', ["[time] end", "'3 m'", '"60 us"']),
    (IMPACT + "[time]\nend = 0\n", ["[time] end", "0 s", "> 0"]),
    (IMPACT + "[time]\nsamples = 1\n", ["[time] samples", "1 is", "2"]),
    (IMPACT + "[time]\nsamples = 10.5\n", ["[time] samples", "10.5", "integer"]),
    (IMPACT + '[accuracy]\nlevel = "fast"\nforce_error = 0.01\n', ["[accuracy]", "both", "exactly one"]),
    (IMPACT + '[accuracy]\nlevel = "quick"\n', ["[accuracy] level", "'quick'", "balanced, fast, reference"]),
    (IMPACT + '[accuracy]\nforce_error = "90 %"\n', ["[accuracy] force_error", "0.9", "0.5"]),
    (IMPACT + "[accuracy]\nmax_steps = 0\n", ["[accuracy] max_steps", "0"]),
    (IMPACT + SPHERES + "[parameters]\nmass = 1\n", ["[parameters] mass", "given twice", "[scene.spheres]"]),
    (IMPACT + SPHERES + "[parameters]\nexponent = 1.5\n", ["[parameters] exponent", "given twice"]),
    (IMPACT + SPHERES.replace("poisson", "poison"), ["[scene.spheres] poison", "did you mean 'poisson'?"]),
    (IMPACT + SPHERES.replace('"10 mm"', "inf"), ["[scene.spheres] radius", "infinite"]),
    (IMPACT + SPHERES.replace('"10 mm"', "-1"), ["[scene.spheres] radius", "-1"]),
    (IMPACT + SPHERES.replace("[0.3, 0.3]", "[0.3]"), ["[scene.spheres] poisson", "two"]),
    (IMPACT + SPHERES.replace('"70 GPa"', '"70 GN"'), ["[scene.spheres] youngs_modulus", "'70 GN'", '"207 GPa"']),
    (IMPACT + 'elastic = "liu"\n' + SPHERES, ["[scene] elastic", "'liu'", "power"]),
    (IMPACT.replace("impact", "bounce") + SPHERES, ["[scene] spheres", "unknown key"]),
    (JOINT + "contact = []\n", ["[scene] contact", "unknown key", "did you mean 'contacts'?"]),
    (JOINT + "balls = 6.5\n", ["[scene] balls", "6.5", "integer"]),
    (JOINT + "[scene.spheres]\nradius = [1, 1]\n", ["[scene] spheres", "unknown key"]),
    (JOINT + 'law = "herz"\n', ["[scene] law", "'herz'", "did you mean 'hertz'?"]),
    (JOINT + "[parameters]\nclearance_seat_ball = -1e-5\n", ["[parameters] clearance_seat_ball", "-1e-05 m", ">= 0"]),
    (JOINT + '[parameters]\nclearance_cage_ball = "-1 um"\n', ["clearance_cage_ball: ", "window face", ">= 0"]),
    (JOINT + '[parameters]\njoint_angle = "95 deg"\n', ["[parameters] joint_angle", "1.65806 rad", "<= 1.5"]),
    (JOINT + "[parameters]\nconformity = 0.5\n", ["[parameters] conformity", "0.5", "> 0.5"]),
    (JOINT + '[parameters]\nload_torque = "1.8 kN"\n', ["[parameters] load_torque", "'1.8 kN'", '"1.8 kN m"']),
    (JOINT + '[parameters]\n"seat_bal.stiffness" = 1\n', ["[parameters] seat_bal.stiffness", "'seat_ball.stiffness'"]),
    (JOINT + '[parameters]\n"seat_ball.stiffness" = "1e5 N/mm"\n', ["seat_ball.stiffness", "exponent is 1.5"]),
    (JOINT + "[parameters]\nseat_inertia = 1\n", ["[parameters] seat_inertia", "with these options", "known here:"]),
    (JOINT + "friction = false\n[parameters]\nfriction_static = 0.1\n", ["friction_static", "known here:"]),
    (JOINT + '[parameters]\nball_radius = "4 mm"\n', ["ball_radius", "0.004 m", "both tracks", "more than 0.0045 m"]),
    (JOINT + '[parameters]\npitch_radius = "45 mm"\n', ["pitch_radius", "away from the head's track", "or less"]),
    (JOINT + '[parameters]\nhead_radius = "41 mm"\n', ["seat_radius", "does not enclose the head"]),
    (JOINT + '[parameters]\nclearance_seat_cage = "10 mm"\n', ["clearance_seat_cage", "a wall of", "give smaller"]),
    (JOINT + "balls = 14\n", ["balls", "14 balls", "overlap", "give fewer"]),
    ("[scene\n", [", line 1", "not TOML"]),
    (IMPACT + "law = hertz\n", [", line 3", "not TOML"]),
]


@pytest.mark.parametrize(("text", "parts"), BAD, ids=[str(i) for i in range(len(BAD))])
def test_bad_files_name_file_key_value_and_remedy(tmp_path, text, parts):
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load(path)
    for part in [str(path), *parts]:
        assert part in str(caught.value)


# What the scene itself refuses.
REFUSED = [
    ('track = "gothik"\n', ["[scene] track", "did you mean 'gothic'?"]),
    ('friction = "brown"\n', ["[scene] friction", "did you mean 'brown_mcphee'?"]),
    ('laws = { cage_ball = "herz" }\n', ["[scene] laws", "cage_ball", "did you mean 'hertz'?"]),
    ('laws = { cage_bal = "hertz" }\n', ["[scene] laws", "did you mean 'cage_ball'?"]),
    ('contacts = ["seat_ball"]\n', ["[scene] contacts", "without head_ball"]),
    ("balls = 2\n", ["[scene] balls", "from 3 to 1000"]),
]


@pytest.mark.parametrize(("text", "parts"), REFUSED, ids=[str(i) for i in range(len(REFUSED))])
def test_bad_options_of_the_joint_name_file_and_key(tmp_path, text, parts):
    path = written(tmp_path, JOINT + text)
    with pytest.raises(InputError) as caught:
        load(path)
    for part in [str(path), *parts]:
        assert part in str(caught.value)


def test_missing_files(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        load(tmp_path / "none.toml")
    with pytest.raises(InputError, match=r"no such file and no such scene; .*impact, bounce"):
        load("impakt")
    with pytest.raises(InputError, match="is a folder"):
        read(tmp_path)


def test_template_of_an_unknown_scene():
    with pytest.raises(InputError, match="did you mean 'bounce'"):
        scenefile.template("bounc")


def test_an_error_can_be_sent_from_a_worker_process():
    error = InputError("s.toml", "mass = -1 kg", "give more than 0")
    arrived = copy.copy(error)  # by what multiprocessing sends it by
    assert str(arrived) == str(error) and arrived.remedy == error.remedy
