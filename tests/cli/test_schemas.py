"""The published JSON Schemas: current, and in agreement with the files that there are."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pydantic
import pytest

from bcfj_jax.analysis.studies.command import BUILT_IN
from bcfj_jax.cli.files import Kind, schema_of
from bcfj_jax.io import scenetemplate
from bcfj_jax.models import scenes

jsonschema = pytest.importorskip("jsonschema", reason="the extra test is not installed")
ROOT = Path(__file__).parents[2]
DESIGN = """
scene = "impact"
[objective]
minimize = "contact.peak"
[vary]
mass = ["10 g", "30 g"]
[vary.damping]
lower = 0.1
upper = "1 s/m"
tolerance = 0.01
[search]
starts = 4
"""


def schema(kind: str):
    return json.loads((ROOT / "docs" / "schemas" / f"{kind}.schema.json").read_text(encoding="utf-8"))


def faults(kind: str, table) -> list[str]:
    validator = jsonschema.Draft202012Validator(schema(kind))
    return [f"{list(error.path)}: {error.message[:200]}" for error in validator.iter_errors(table)]


def meant(part):
    """A schema as pydantic 2.10 writes it, too: it leaves out that further keys are accepted, and has more defaults."""
    if isinstance(part, list):
        return [meant(one) for one in part]
    if not isinstance(part, dict) or pydantic.VERSION > "2.11":
        return part
    return {k: meant(v) for k, v in part.items() if k != "default" and (k, v) != ("additionalProperties", True)}


@pytest.mark.parametrize("kind", list(Kind))
def test_schemas_are_current(kind):
    assert meant(schema(kind)) == meant(schema_of(kind)), f"bcfj schema {kind} > docs/schemas/{kind}.schema.json"
    jsonschema.Draft202012Validator.check_schema(schema(kind))


def kind_of(table) -> str:
    return "calibration" if "experiment" in table else "study" if "vary" in table else "scene"


@pytest.mark.parametrize("path", [*sorted((ROOT / "examples").glob("*.toml")), *BUILT_IN.glob("*.toml")], ids=str)
def test_examples_are_valid(path):
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    assert not faults(kind_of(table), table)


@pytest.mark.parametrize("name", [*scenes.SCENES, "mechanism"])
def test_templates_are_valid(name):
    assert not faults("scene", tomllib.loads(scenetemplate.template(name)))


def test_designs_are_valid():
    assert not faults("design", tomllib.loads(DESIGN))


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("scene", '[scene]\nkind = "impakt"'),
        ("scene", '[scene]\nkind = "impact"\nlawn = "hertz"'),
        ("scene", '[scene]\nkind = "impact"\n[time]\nsamples = "many"'),
        ("scene", '[scene]\nkind = "impact"\n[parameters]\nmass = true'),
        ("study", 'scene = "impact"\n[vary.mass]\nlowest = 1'),
        ("design", DESIGN.replace("starts = 4", "starts = 0")),
        ("calibration", 'scene = "impact"\n[free.mass]\nlower = 1'),
    ],
)
def test_faults_are_found(kind, text):
    assert faults(kind, tomllib.loads(text))
