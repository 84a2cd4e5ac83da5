"""Which way imports point, who knows what, and the rules of the house, read from the sources."""

from __future__ import annotations

import ast
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from bcfj_jax.mechanism.model import AbstractModel

ROOT = Path(__file__).resolve().parent.parent
# A folder (or a module at the top of a package) may import from those before it. The front door, ``__init__``, may
# name everything.
LAYERS = {
    "bcfj_jax": (
        "_version", "core", "xla", "contact", "mechanism", "models", "solve", "io", "data", "analysis", "verification",
        "reproduction", "cli", "__main__",
    ),
    "calibration": (
        "solver_budget", "given", "filters", "attitudes", "instrument", "problem", "forward", "search", "noise", "diagnostics",
        "uncertainty", "fit", "verification", "impacts", "problemfile", "init", "selection", "petab", "report", "command",
    ),
}  # fmt: skip
# What is computed, without files, units, commands and pictures.
PHYSICS = ("core", "xla", "contact", "mechanism", "models", "solve")
PHYSICS_FILES = tuple(
    f"analysis/{name}.py" for name in ("features", "crests", "histories", "energy_balance", "balance", "envelope")
)
TOOLS = {"pint", "pydantic", "typer", "matplotlib", "calibration"}
# May know which model they hold: the models, what they are made of, and what is about one of them.
KNOWING = ("models", "mechanism", "reproduction")
# A question about the kind of a model, as opposed to a kind of feature, design or scene file.
ASKS = re.compile(
    r"isinstance\([^()]*(\([^()]*\)[^()]*)?,[^)]*\b(Joint|JointModel|Mechanism|Scene)\b"
    r"|\b(scene|model)\.kind *(==|!=|in\b|not in\b)|\.fidelity *(==|!=|in\b|not in\b)|\.in_motion\b"
)
INSIDES = re.compile(r"bcfj_jax\.(models\.(?!scenes\b)|mechanism\.(equations|scales)\b)")
# What fulfils a documented abstract method or property is documented there: of a law, a gap and a load, of diffrax's
# solvers and interpolations, of a structure, of equations, and of a model.
INHERITED = {"force", "needs", "mobility", "rates", "sizes", "stored", "unloading", "bond", "lag", "reach"}
INHERITED |= {"faces", "bends", "axial", "drawn", "members", "quantities", "carried", "radius", "size", "misread"}
INHERITED |= {"actions", "touches", "damps", "kinks", "parameters", "on_coordinate", "on_coordinates"}
INHERITED |= {"order", "error_order", "init", "func", "step", "evaluate"}
INHERITED |= {"field", "factor", "solve", "solve_transposed", "time_derivative", "push", "act", "wrench"}
INHERITED |= {"axial_by", "preloads", "bristles", "bending", "holding", "corners", "onsets", "onsets_on", "acts_on"}
INHERITED |= {name for name, x in vars(AbstractModel).items() if not name.startswith("_") and x.__doc__}
INHERITED |= {"defaults", "horizon"}
SOURCES = sorted(path for package in LAYERS for path in (ROOT / package).rglob("*.py"))
FRONT = [path for path in SOURCES if path.relative_to(ROOT).parts[1] != "__init__.py"]


def named(path: Path) -> str:
    """A test's name."""
    return str(path.relative_to(ROOT))


def layer(path: Path) -> str:
    """The folder, or the module at the top of its package, that a file belongs to."""
    return path.relative_to(ROOT).with_suffix("").parts[1]


def imports(path: Path, everywhere: bool = True):
    """Dotted names a file imports, inside functions too, or only at its top."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree) if everywhere else tree.body:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", FRONT, ids=named)
def test_imports_point_down(path):
    package, here = path.relative_to(ROOT).parts[0], layer(path)
    order = LAYERS[package]
    assert here in order, "a new folder: give it a place in LAYERS"
    for name in imports(path):
        first, second = (*name.split("."), "")[:2]
        # ``from bcfj_jax import simulate`` names a public function of the front door, which is in no layer.
        if first == package and second in order:
            assert order.index(second) <= order.index(here), f"{here} may not import {name}"


@pytest.mark.parametrize("path", sorted((ROOT / "bcfj_jax" / "data").rglob("*.py")), ids=named)
def test_measured_data_know_nothing_of_contact(path):
    ours = {name for name in imports(path) if name.startswith(("bcfj_jax", "calibration"))}
    allowed = ("bcfj_jax.core.", "bcfj_jax.data", "bcfj_jax.io.units.", "bcfj_jax.io.opening")
    assert all(name.startswith(allowed) for name in ours), ours
    if path.parent.name == "readers":
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 100


def test_no_files_import_each_other():
    """In no way round: at the top, inside functions, or for types alone."""
    files = {".".join(p.relative_to(ROOT).with_suffix("").parts): p for p in FRONT}
    graph = {}
    for name, path in files.items():
        known = ({n, n.rpartition(".")[0]} & files.keys() for n in imports(path))
        graph[name] = {max(found, key=len) for found in known if found} - {name}
    TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_tools_stay_out_of_the_physics(path):
    package, *inside = path.relative_to(ROOT).parts
    found = {name.split(".")[0] for name in imports(path)}
    assert "pickle" not in found
    if package == "bcfj_jax":
        top = {name.split(".")[0] for name in imports(path, everywhere=False)}
        assert "calibration" not in (top if layer(path) == "cli" else found)
        if inside[0] in PHYSICS or "/".join(inside) in PHYSICS_FILES:
            assert not found & TOOLS


@pytest.mark.parametrize("path", [p for p in FRONT if layer(p) not in KNOWING], ids=named)
def test_nobody_asks_what_kind_of_model_it_holds(path):
    text = path.read_text(encoding="utf-8")
    asked = [line.strip() for line in text.splitlines() if ASKS.search(line)]
    assert not asked, "ask the model itself (mechanism.model): its traits, or a method that every model has"
    known = [name for name in imports(path) if INSIDES.match(name)]
    assert not known, "know a model by its interface (mechanism.model), a built-in one by its name (models.scenes)"


def test_questions_about_the_kind_are_found():
    for line in (
        "if isinstance(scene, Joint):",
        "joint = not isinstance(given.scene, (Scene, Joint))",
        "if isinstance(self.of(scene), Mechanism) and large:",
        "if base.scene.kind in _IMPACTS:",
        'return model.kind == "joint"',
        'if scene.fidelity != "dynamic":',
    ):
        assert ASKS.search(line), line
    for line in ('if feature.kind == "peak":', "if kind not in scenes.SCENES:", "box = boxes.get(scene.kind)"):
        assert not ASKS.search(line), line


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_files_say_what_they_are(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
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


def many_arguments():
    """Functions with more than six arguments, each as its file and name; settings that are handed on count as none.

    Left out are signatures that diffrax prescribes, and commands, whose arguments are options of the command line.
    """
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                prescribed = path.parent.name == "solve" and node.name in ("init", "step", "adapt_step_size")
                command = "cli" in path.parts and any(ast.unparse(x).startswith("verb(") for x in node.decorator_list)
                if len([x for x in given if x.arg not in ("self", "cls")]) > 6 and not prescribed and not command:
                    yield path, node.name


def test_functions_have_few_arguments():
    """Six; more is inside a module, and rare. The one formula is of seven quantities."""
    many = list(many_arguments())
    assert [name for _, name in many if not name.startswith("_")] == ["depth_map"]
    assert len(many) <= 10, many


@pytest.mark.parametrize("path", [p for p in SOURCES if p.name != "inside.py"], ids=named)
def test_what_jax_may_move_is_imported_in_one_place(path):
    # ``jax.core.Tracer`` is in JAX's documented interface; nothing below ``xla`` needs more.
    allowed = {"jax.core.Tracer"} if path.parts[-2:] == ("core", "numerics.py") else set()
    unstable = ("jax.core", "jax.extend", "jax.interpreters", "jax._src", "jaxlib", "jax.experimental")
    assert not [name for name in {*imports(path)} - allowed if name.startswith(unstable)], "import it in xla/inside.py"
