"""Which way imports point, and the rules of the house, read from the sources."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# A room may import from rooms further left. Rooms of one floor may import each other only as WITHIN says.
FLOORS = {
    "bcfj_jax": (
        {"errors", "endings", "numerics", "quantities", "directions", "compile_cache"},
        {"restitution", "elliptic", "stiffness"},
        {"laws"},
        {"scene"},
        {"dynamics", "solvers"},
        {"joint"},
        {"scenes"},
        {"integrate", "two_way"},
        {"ledger", "fidelity", "lanes"},
        {"simulation"},
        {"features", "histories", "units", "tables", "spheres", "scenetemplate", "scenefile", "provenance", "stop"},
        {"outputs", "plots", "report", "envelope"},
        {"simulation_results", "reproduction", "derivatives", "journal"},
        {"tradeoff", "studies", "nonlinear", "designs"},
        {"cli"},
    ),
    "calibration": (
        {"effort"},
        {"problem"},
        {"losses", "observables", "slots"},
        {"model"},
        {"integration"},
        {"noise", "runs", "check"},
        {"descent", "horizon"},
        {"polish", "evaluate"},
        {"staged"},
        {"search", "settle"},
        {"judge"},
        {"whiteness", "clearance"},
        {"records", "estimates", "averaging"},
        {"where"},
        {"uncertainty"},
        {"fit"},
        {"choice", "next_experiment"},
        {"data"},
        {"problemfile", "plots", "plots_uncertainty", "petab"},
        {"alternatives"},
        {"command"},
    ),
}
WITHIN = {
    ("quantities", "errors"),
    ("stiffness", "elliptic"),
    ("features", "histories"),
    ("spheres", "units"),
    ("spheres", "tables"),
    ("scenetemplate", "units"),
    ("scenefile", "scenetemplate"),
    ("scenefile", "spheres"),
    ("scenefile", "tables"),
    ("scenefile", "units"),
    ("plots", "outputs"),
    ("report", "outputs"),
}
PHYSICS = {"laws", "numerics", "restitution", "elliptic", "stiffness", "dynamics", "integrate", "simulation", "two_way"}
PHYSICS |= {"scene", "scenes", "quantities", "errors", "features", "histories", "joint", "solvers", "ledger"}
PHYSICS |= {"envelope", "fidelity", "lanes"}
TOOLS = {"pint", "pydantic", "typer", "matplotlib", "calibration"}
# What fulfils a documented abstract method or property is documented there: of a law, of diffrax's solvers and
# interpolations, of a structure.
INHERITED = {"force", "needs", "mobility"}
INHERITED |= {"order", "error_order", "init", "func", "step", "evaluate"}
INHERITED |= {"field", "factor", "solve", "time_derivative"}
SOURCES = sorted(path for package in FLOORS for path in (ROOT / package).rglob("*.py"))


def room(path: Path) -> str:
    """The module or sub-package a file belongs to."""
    return path.relative_to(ROOT).with_suffix("").parts[1]


def named(path: Path) -> str:
    """A test's name."""
    return str(path.relative_to(ROOT))


def imports(path: Path, everywhere: bool = True):
    """Dotted names a file imports, inside functions too, or only at its top."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree) if everywhere else tree.body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


FRONT = [path for path in SOURCES if room(path) not in ("__init__", "__main__")]


@pytest.mark.parametrize("path", FRONT, ids=named)
def test_imports_point_down(path):
    package, here = path.relative_to(ROOT).parts[0], room(path)
    floor = {name: level for level, names in enumerate(FLOORS[package]) for name in names}
    assert here in floor, "a new room: give it a floor in FLOORS"
    for name in imports(path):
        first, second = (*name.split("."), "")[:2]
        # ``from bcfj_jax import simulate`` names a public function of the front door, which is no room below it.
        if first != package or second not in floor or second == here:
            continue
        assert floor[second] < floor[here] or (here, second) in WITHIN, f"{here} may not import {second}"


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_tools_stay_out_of_the_physics(path):
    package, found = path.relative_to(ROOT).parts[0], {name.split(".")[0] for name in imports(path)}
    assert "pickle" not in found
    if package == "bcfj_jax":
        top = {name.split(".")[0] for name in imports(path, everywhere=False)}
        assert "calibration" not in (top if room(path) == "cli" else found)
        if room(path) in PHYSICS:
            assert not found & TOOLS


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_files_are_short_and_say_what_they_are(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 300
    tree = ast.parse(text)
    assert ast.get_docstring(tree)
    missing = []

    def look(body, prefix=""):
        for node in body:
            if not isinstance(node, (ast.FunctionDef, ast.ClassDef)) or node.name.startswith("_"):
                continue
            if not ast.get_docstring(node) and not (prefix and node.name in INHERITED):
                missing.append(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                look(node.body, f"{node.name}.")

    look(tree.body)
    assert not missing
