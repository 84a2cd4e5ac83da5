"""Scene files: what they say, what they refuse and how."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bcfj_jax import laws, scenefile
from bcfj_jax.errors import InputError
from bcfj_jax.scenefile import from_table, load, template
from bcfj_jax.tables import read

pytestmark = pytest.mark.filterwarnings("error")

IMPACT = '[scene]\nkind = "impact"\n'
SPHERES = '[scene.spheres]\nradius = ["10 mm", inf]\nyoungs_modulus = ["70 GPa", inf]\npoisson = [0.3, 0.3]\n'
SPHERES += "density = [2699, 2699]\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", ["impact", "bounce"])
def test_template_loads_back_to_the_defaults(tmp_path, kind):
    named, filed = load(kind), load(written(tmp_path, template(kind)))
    assert filed.resolved == named.resolved
    assert filed.scene == named.scene
    assert named.source is None
    if "damping" in named.params:
        assert "GUESS" in next(line for line in template(kind).splitlines() if line.startswith("damping"))


@pytest.mark.parametrize("name", ["chung_ooi_test1", "chung_ooi_test2"])
def test_resolved_input_loads_back_to_itself(name):
    first = load(Path(__file__).parent.parent / "examples" / f"{name}.toml")
    again = from_table(first.resolved, Path("run.toml"))
    assert again.resolved == first.resolved
    assert np.array_equal(again.times, first.times)
    assert {k: float(v) for k, v in again.params.items()} == {k: float(v) for k, v in first.params.items()}


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


def test_missing_files(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        load(tmp_path / "none.toml")
    with pytest.raises(InputError, match=r"no such file and no such scene; .*impact, bounce"):
        load("impakt")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path)


def test_template_of_an_unknown_scene():
    with pytest.raises(InputError, match="did you mean 'bounce'"):
        scenefile.template("bounc")
