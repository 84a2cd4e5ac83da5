"""The code of the pages runs: Python blocks in order in one namespace, TOML blocks as the files that they name, and the
commands of the README, of the tutorials and of the how-to pages.

A Python block that begins with a comment like ``# my_parts.py`` is added to that file. A TOML block that begins with
``# cam.toml --code my_parts.py`` is written to cam.toml, with the user's code in use: a scene is then simulated, a
calibration fitted, a study run.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path
from typing import NamedTuple

import pytest
import tiers

ROOT = Path(__file__).resolve().parent.parent
OUTSIDE = (ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "benchmarks" / "README.md")
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), *OUTSIDE])
MECHANISMS = ROOT / "docs" / "mechanisms.md"
OWN_PARTS = ROOT / "docs" / "howto" / "own_parts.md"


class Block(NamedTuple):
    """A fenced block of a page: where it begins, its language, its text."""

    place: str
    line: int
    language: str
    text: str

    @property
    def file(self) -> str:
        """The file that its first line names; "" for none."""
        match = re.match(r"# (\S+\.(?:py|toml))( --code \S+)?\n", self.text)
        return match[1] if match else ""

    @property
    def code(self) -> str:
        """The user's code that its first line names; "" for none."""
        match = re.match(r"# \S+ --code (\S+)\n", self.text)
        return match[1] if match else ""


def blocks(page: Path, *languages: str) -> list[Block]:
    """Fenced blocks of a page in some languages, in order."""
    text, found = page.read_text(encoding="utf-8"), []
    for match in re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        line = text.count("\n", 0, match.start()) + 2
        found.append(Block(f"{page.name}, line {line}", line, match[1], match[2]))
    return [block for block in found if block.language in languages]


def code_lines(text: str) -> int:
    """Lines that are neither empty nor a comment alone."""
    return sum(1 for line in text.splitlines() if line.strip() and not line.strip().startswith("#"))


def run_toml(block: Block, whole: bool) -> None:
    """Write the file that a block names, and do with it what its tables ask for; a fit or a study is only read unless whole."""
    import bcfj_jax as bj
    import calibration
    from bcfj_jax.analysis.studies import specification
    from bcfj_jax.io import scenefile

    if block.code:
        bj.use_code(block.code)
    Path(block.file).write_text(block.text, encoding="utf-8")
    tables = tomllib.loads(block.text)
    if "experiment" in tables:
        problem = calibration.load(block.file)
        if whole:
            found = calibration.fit(problem, starts=4)
            assert found.verdict == "identified", found.reasons
    elif "design" in tables:
        if whole:
            bj.study(block.file, Path(block.file).with_suffix(""), workers=1)
        else:
            specification.load(Path(block.file))
    else:
        file = scenefile.load(block.file)
        assert bj.simulate(file.scene, file.params, file.times).status == "ok"


def run_python(block: Block, names: dict[str, object]) -> None:
    """Add a block to the file that it names, or execute it."""
    if block.file:
        with Path(block.file).open("a", encoding="utf-8") as file:
            file.write(block.text)
        compile(Path(block.file).read_text(encoding="utf-8"), block.file, "exec")
        return
    exec(compile("\n" * (block.line - 1) + block.text, block.place, "exec"), names)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of its own, with the examples in it, in which a page's files lie."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    from bcfj_jax.io import usercode

    usercode.forget()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_blocks_can_be_read(page):
    for block in blocks(page, "python"):
        ast.parse(block.text, block.place)
    for block in blocks(page, "toml"):
        tomllib.loads(block.text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    text = page.read_text(encoding="utf-8")
    for target, heading in re.findall(r"\]\(([^)#:\s]*)(?:#([^)\s]+))?\)", text):
        other = (page.parent / target).resolve() if target else page
        assert other.exists(), target
        if heading and other.suffix == ".md":
            titles = re.findall(r"^#+ (.*)$", other.read_text(encoding="utf-8"), re.MULTILINE)
            assert heading in [re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles], heading


def test_files_and_modules_that_the_pages_name_exist():
    for page in PAGES:
        text = re.sub(
            r"<!-- (\w+): begin -->.*?<!-- \1: end -->", "", page.read_text(encoding="utf-8"), flags=re.DOTALL
        )
        for name in re.findall(r"`((?:bcfj_jax|calibration|benchmarks|tests|examples)/[\w./*-]+)`", text):
            assert any(ROOT.glob(name.rstrip("/"))), f"{page.name}: {name}"
        for name in re.findall(r"python -m (benchmarks[\w.]+)", text):
            assert (ROOT / (name.replace(".", "/") + ".py")).exists(), f"{page.name}: {name}"


def test_every_public_name_is_in_the_reference():
    """Each public name of both packages has a docstring, and a place in docs/api."""
    import bcfj_jax as bj
    import calibration

    reference = "\n".join(page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs" / "api").glob("*.md")))
    shown = set(re.findall(r"^\.\. auto\w+:: (\S+)", reference, re.MULTILINE))
    fitted = {name for name, thing in vars(calibration).items() if not name.startswith("_") and callable(thing)}
    for package, names in ((bj, set(bj._PUBLIC)), (calibration, fitted)):
        for name in sorted(names):
            thing = getattr(package, name)
            assert inspect.getdoc(thing), f"{package.__name__}.{name} has no docstring"
            module = thing.__name__ if inspect.ismodule(thing) else ""
            assert {f"{package.__name__}.{name}", module} & shown, f"docs/api has no {package.__name__}.{name}"


def test_every_benchmark_is_in_the_index():
    index = (ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8")
    for path in sorted((ROOT / "benchmarks").glob("*/*.py")):
        if path.name != "__init__.py":
            name = path.stem if path.parent.name == "references" else f"{path.parent.name}.{path.stem}"
            assert f"`{name}`" in index or f"`{name} " in index, f"benchmarks/README.md has no {name}"


def test_a_mechanism_is_short():
    python = next(b for b in blocks(MECHANISMS, "python") if "Mechanism(" in b.text)
    assert code_lines(python.text) <= 25
    own = [b for b in blocks(OWN_PARTS, "python") if b.file == "my_parts.py"]
    assert len(own) == 4
    assert all(code_lines(b.text) <= 15 for b in own)


@pytest.mark.parametrize(
    ("page", "whole"),
    [
        pytest.param(ROOT / "README.md", True, id="README.md"),
        pytest.param(MECHANISMS, False, id="mechanisms.md", marks=pytest.mark.slow),
        pytest.param(OWN_PARTS, True, id="own_parts.md, its fit and its study", marks=pytest.mark.slow),
    ],
)
def test_blocks_run(page, whole, folder):
    names: dict[str, object] = {}
    for block in blocks(page, "python", "toml"):
        if block.language == "python":
            run_python(block, names)
        elif block.file:
            run_toml(block, whole)


def run_commands(block: Block) -> None:
    """The lines of a block that begin with ``bcfj``; one that ends otherwise than with 0 says so: ``# exit code 4``."""
    from typer.testing import CliRunner

    from bcfj_jax.cli import app

    for line in block.text.splitlines():
        if line.startswith("bcfj "):
            command, _, comment = line.partition("  #")
            code = re.search(r"exit code (\d)", comment)
            done = CliRunner().invoke(app, shlex.split(command)[1:])
            assert done.exit_code == int(code[1] if code else 0), f"{block.place}: {line}\n{done.output}"


# Tutorials and how-to pages whose commands are cheap; the others run in the slow tier.
CHEAP = ("data_files",)
GUIDES = [page for page in PAGES if page.parent.name in ("tutorials", "howto")]


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.full if page.stem in CHEAP else pytest.mark.slow) for page in GUIDES],
    ids=lambda page: f"{page.parent.name}/{page.stem}",
)
def test_guides_run(page, folder):
    """Python in one namespace, TOML blocks as the files that they name, commands by the command line, in order."""
    names: dict[str, object] = {}
    for block in blocks(page, "python", "toml", "bash"):
        if block.language == "python":
            run_python(block, names)
        elif block.language == "bash":
            run_commands(block)
        elif block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")


def examples() -> dict[str, list[str]]:
    """Example lines of each verb's help."""
    import typer

    from bcfj_jax.cli import app

    def verbs(group, prefix: str):
        for name, one in group.commands.items():
            if hasattr(one, "commands"):
                yield from verbs(one, f"{prefix}{name} ")
            else:
                yield f"{prefix}{name}", one

    root = typer.main.get_command(app)
    return {name: re.findall(r"^Example: bcfj (.*)$", one.epilog or "", re.MULTILINE) for name, one in verbs(root, "")}


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """(line, folder as it left it) of lines with which the examples of several verbs begin."""
    every = [lines[0] for lines in examples().values() if len(lines) > 1]
    return {line: tmp_path_factory.mktemp("begun") / "folder" for line in every if every.count(line) > 1}


@pytest.mark.slow
@pytest.mark.parametrize("verb", examples())
def test_examples_of_the_help_run(verb, folder, begun, monkeypatch):
    """In order, as printed, in a folder that holds the examples; a line with which several verbs begin runs once."""
    # Commands in the tests' own process keep no programs, and ``doctor`` is to know it.
    monkeypatch.setenv("BCFJ_CACHE", "off")
    from typer.testing import CliRunner

    from bcfj_jax.cli import app

    for k, line in enumerate(examples()[verb]):
        left = begun.get(line) if k == 0 else None
        if left and left.exists():
            shutil.copytree(left, folder, dirs_exist_ok=True)
            continue
        command, _, target = line.partition(" > ")
        done = CliRunner().invoke(app, shlex.split(command))
        assert done.exit_code == 0, f"{line}\n{done.output}"
        assert not target or done.stdout
        if left:
            shutil.copytree(folder, left)


# The README's commands, and what they write beside run.toml and environment.json.
WRITES = {
    "init impact": ("impact.toml",),
    "init calibration examples/chung_ooi_test1_curve.csv": ("chung_ooi_test1_curve.toml",),
    "simulate examples/chung_ooi_test1.toml": ("forces.csv", "contacts.csv", "summary.json"),
    "simulate joint": ("forces.csv", "contacts.csv", "summary.json"),
    "animate slider_crank": ("slider_crank.html",),
    "calibrate examples/chung_ooi_fit.toml": ("fit.json", "fitted_scene.toml"),
    "sensitivity impact --wrt stiffness,damping": ("sensitivity.csv", "certificate.json"),
    "study run clearance": ("results.parquet", "study.json"),
}


def test_every_command_of_the_readme_is_known():
    found = re.findall(r"^bcfj (.*?) *(?:#.*)?$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert found == list(WRITES)


def bcfj(*arguments: str):
    from typer.testing import CliRunner

    from bcfj_jax.cli import app

    return CliRunner().invoke(app, [*arguments, "--out", "out"])


@pytest.mark.parametrize("command", WRITES)
def test_commands_run(command, folder):
    done = bcfj(*command.split())
    assert done.exit_code == 0, done.stderr
    written = {path.name for path in (folder / "out").iterdir()}
    common = set() if command.startswith(("init", "animate")) else {"run.toml", "environment.json", "report.html"}
    assert {*common, *WRITES[command]} <= written


MISSES = [("", "adequate", 0), ('adequate = "0.01 %"\n', "misfit", 4)]


@pytest.mark.parametrize(("more", "verdict", "code"), tiers.ci(MISSES, MISSES[1]))
def test_exit_codes_of_a_law_that_misses(folder, more, verdict, code):
    """README: "its correlation is estimated, too; without it the verdict is `adequate`"."""
    file = folder / "examples/chung_ooi_fit.toml"
    text, count = re.subn(r"^correlation = .*\n", "", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert count == 1
    file.write_text(more + text, encoding="utf-8")
    done = bcfj("calibrate", "examples/chung_ooi_fit.toml", "--starts", "4")
    assert done.exit_code == code, done.stderr
    found = json.loads((folder / "out/fit.json").read_text(encoding="utf-8"))
    assert found["verdict"] == verdict
    assert found["search"]["answer"] == "converged" and found["law"]["answer"] in ("adequate", "inadequate")
    assert found["parameters"]["exponent"]["headline"] in ("errors", "filter")
