"""What the distributions hold, what the package declares that it needs, and when a release is refused."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bcfj_jax import InputError
from bcfj_jax._version import __version__
from bcfj_jax.cli import app
from bcfj_jax.core.extras import EXTRAS, library
from calibration.uncertainty.intervals import check_kind
from scripts import first_run, pythons, release

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FOR_US = ("test", "bench", "docs")


def name_of(requirement: str) -> str:
    return re.match(r"[A-Za-z0-9_.-]+", requirement)[0].lower().replace("_", "-")


def in_tree(*packages: str) -> set[str]:
    """Files of packages that a distribution has to hold."""
    files = (path for package in packages for path in (ROOT / package).rglob("*") if path.is_file())
    return {str(path.relative_to(ROOT)) for path in files if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A wheel and an sdist of the tree, by the build backend alone."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def test_the_wheel_holds_every_file_of_both_packages_and_nothing_else(built):
    with zipfile.ZipFile(built[0]) as wheel:
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        metadata = wheel.read(f"bcfj_jax-{__version__}.dist-info/METADATA").decode()
        scripts = wheel.read(f"bcfj_jax-{__version__}.dist-info/entry_points.txt").decode()
    assert names == in_tree("bcfj_jax", "calibration")
    # What is no Python is what gets lost.
    for path in ("bcfj_jax/py.typed", "calibration/py.typed", "bcfj_jax/io/templates/report.html"):
        assert path in names
    assert {"bcfj_jax/io/templates/mechanism.toml", "bcfj_jax/analysis/studies/built_in/clearance.toml"} <= names
    assert f"\nVersion: {__version__}\n" in metadata and "bcfj = bcfj_jax.cli:command" in scripts
    assert all(f"Provides-Extra: {extra}\n" in metadata for extra in EXTRAS)


def test_the_sdist_holds_tests_and_documents(built):
    with tarfile.open(built[1]) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}
    assert in_tree("bcfj_jax", "calibration", "tests", "docs", "examples", "scripts") <= names
    assert {"LICENSE", "README.md", "CHANGELOG.md", "Makefile", "pyproject.toml", "constraints.txt"} <= names
    assert not [name for name in names if name.startswith((".venv", "build/", "results/"))]


def test_every_import_is_declared_and_every_extra_says_what_it_is_for():
    declared = {name_of(text) for text in PROJECT["dependencies"]}
    for extra, wanted in PROJECT["optional-dependencies"].items():
        if extra not in FOR_US:
            declared |= {name_of(text) for text in wanted}
    found = {}
    for path in (*ROOT.glob("bcfj_jax/**/*.py"), *ROOT.glob("calibration/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module]
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "library":
                names = [node.args[0].value] if node.args and isinstance(node.args[0], ast.Constant) else []
            found |= {name.partition(".")[0]: path for name in names}
    ours = {"bcfj_jax", "calibration", "__future__"}
    outside = {name: path for name, path in found.items() if name not in ours | sys.stdlib_module_names}
    known = packages_distributions()
    lacking = [
        f"{name} ({path.relative_to(ROOT)})"
        for name, path in outside.items()
        if not {name_of(one) for one in known.get(name, [name])} & declared
    ]
    assert not lacking, "give each a line in pyproject.toml"
    assert set(EXTRAS) == set(PROJECT["optional-dependencies"]) - set(FOR_US), "core.extras and pyproject.toml differ"


def test_every_requirement_has_a_lower_bound_that_the_pins_keep():
    pins = dict(
        line.lower().replace("_", "-").split("==")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    )
    extras = (PROJECT["optional-dependencies"][name] for name in pythons.users_extras(PROJECT))
    for text in (*PROJECT["dependencies"], *(line for wanted in extras for line in wanted)):
        if (name := name_of(text)) == "bcfj-jax":
            continue
        bound = re.search(r">=([0-9.]+)", text)
        assert bound, f"{text} has no lower bound"
        bound = bound[1]
        assert name in pins, f"constraints.txt lacks {name}"
        numbers = [[int(x) for x in re.findall(r"\d+", v)] for v in (bound, pins[name])]
        assert numbers[0] <= numbers[1], f"{name}: pinned below its lower bound"


# --- a missing extra is said before work begins


def test_a_study_says_what_it_lacks_before_a_dry_run(here, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    done = CliRunner().invoke(app, ["study", "run", "clearance", "--dry-run"])
    assert done.exit_code == 2 and done.stdout == ""
    assert "needs pyarrow" in done.stderr and 'pip install "bcfj-jax[study]"' in done.stderr


def test_a_posterior_is_refused_before_the_search(monkeypatch):
    for name in ("numpyro", "numpyro.infer"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"needs numpyro.*bcfj-jax\[uq\].*NUTS"):
        check_kind("posterior")
    check_kind("profile")


def test_every_extra_has_its_purpose_in_the_message():
    for extra, purpose in EXTRAS.items():
        with pytest.raises(InputError) as caught:
            library("no_such_library.part", "here", extra)
        assert f"bcfj-jax[{extra}]" in str(caught.value) and purpose in str(caught.value)


# --- releases


@pytest.fixture
def tree(tmp_path):
    (tmp_path / "bcfj_jax").mkdir()
    (tmp_path / "bcfj_jax" / "_version.py").write_text('__version__ = "1.2.3"\n')
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 1.2.3\n\n- New.\n\n## 1.2.2\n\n- Old.\n")
    (tmp_path / "CITATION.cff").write_text("cff-version: 1.2.0\nversion: 1.2.3\n")
    return tmp_path


def test_a_release_in_order_has_no_problems(tree):
    assert release.problems(tree, "main", "", ["v1.2.2", "other"]) == []
    assert release.section((tree / "CHANGELOG.md").read_text(), "1.2.3") == "- New."


@pytest.mark.parametrize(
    ("file", "text", "git", "said"),
    [
        ("bcfj_jax/_version.py", '__version__ = "1.2"\n', ("main", "", []), "MAJOR.MINOR.PATCH"),
        ("CHANGELOG.md", "## 1.2.2\n\n- Old.\n", ("main", "", []), "no section"),
        ("CHANGELOG.md", "## 1.2.3\n\n## 1.2.2\n\n- Old.\n", ("main", "", []), "empty"),
        ("CITATION.cff", "cff-version: 1.2.0\nversion: 1.2.2\n", ("main", "", []), "cites version 1.2.2"),
        (None, "", ("work", "", []), "release from main"),
        (None, "", ("main", " M README.md", []), "README.md"),
        (None, "", ("main", "", ["v1.2.3"]), "exists"),
        (None, "", ("main", "", ["v1.10.0"]), "older than the tag v1.10.0"),
    ],
)
def test_a_release_is_refused(tree, file, text, git, said):
    if file:
        (tree / file).write_text(text)
    (problem,) = release.problems(tree, *git)
    assert said in problem


def test_the_tree_is_ready_but_for_git():
    assert release.problems(ROOT, "main", "", []) == []


# --- the first run


def test_the_commands_of_a_page_are_found_without_comments():
    page = "# A\n\n```\nmake demo    # sets up\n.venv/bin/bcfj simulate joint\nresults in r\n```\n\n```python\nmake = 1\n```\n"
    assert first_run.commands(page) == ["make demo", ".venv/bin/bcfj simulate joint"]


def test_readme_and_start_page_have_commands_and_each_target_exists():
    found = [line for page in first_run.PAGES for line in first_run.commands((ROOT / page).read_text(encoding="utf-8"))]
    assert {"make demo", "make test"} <= set(found)
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert all(f"\n{line.split()[1]}:" in makefile for line in found if line.startswith("make "))


def test_a_bare_machine_sees_python_and_make_and_nothing_else(tmp_path):
    env = first_run.machine(tmp_path, sys.executable)
    tool = f"{env['PATH']}/sh"
    for command, good in (("python3 -c 'import sys'", True), ("make --version", True), ("git --version", False)):
        done = subprocess.run([tool, "-c", command], env=env, capture_output=True, check=False)
        assert (done.returncode == 0) == good, command
    assert not list((tmp_path / "home").iterdir())
