"""The field's words in the pages and in messages, in place of words that only their authors know.

Ordinary words are not listed although modules once had their names: where, around, touch, reach, balance, repeat,
directions; nor ``twist`` and ``settle``, which mechanics has as well. Not looked at are code, generated tables, links.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUTSIDE = (ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "benchmarks" / "README.md")
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), *OUTSIDE])
# A word of ours, the field's, and where ours is the right one all the same.
WORDS: tuple[tuple[str, str, str], ...] = (
    (r"rooms?", "module, layer, folder", r"room temperature"),
    (r"floors?", "layer; for a bound: least value", ""),
    (r"skins?|skinpairs?", "contact law pair", ""),
    (r"borders?|bordered", "coupling coordinates", r"border of coupling coordinates|bordered block-diagonal"),
    (r"lightness", "inverse mass", ""),
    (r"slots", "state slices; search coordinates; places of a batch", ""),
    (r"onsets?", "contact regularisation (its width is `smoothing`); of a record: first contact", ""),
    (r"rungs?", "refinement level; model level", ""),
    (r"omitted", "model-error estimate; left out", ""),
    (r"ledgers?|books", "energy balance", ""),
    (r"lanes?", "run of a batch; batch with a work queue", ""),
    (r"two[ _-]way", "forward-and-reverse rule", ""),
    (r"endings?", "status codes", ""),
    (r"efforts?", "solver budget", ""),
    (r"staged", "continuation", ""),
    (r"polish(?:es|ed|ing)?", "refinement", ""),
    (r"judges?|judged|judgements?", "fit tests", ""),
    (r"whiteness", "residual tests", ""),
    (r"pools?", "batched Newton", r"(?:process|worker) pools?|pools? of (?:two )?processes"),
    (r"watch(?:es|ed)?", "observed feature", ""),
    (r"told|tells?", "say it plainly: state, give, report", ""),
)


def found(text: str) -> list[tuple[str, str]]:
    """Words of ours in a text, with the field's."""
    hits = []
    for ours, theirs, allowed in WORDS:
        plain = re.sub(allowed, lambda m: " " * len(m[0]), text, flags=re.IGNORECASE) if allowed else text
        hits += [(m[0], theirs) for m in re.finditer(rf"\b(?:{ours})\b", plain, re.IGNORECASE)]
    return hits


def prose(page: Path) -> str:
    """A page, line by line, without code, generated tables and the targets of links."""
    text = page.read_text(encoding="utf-8")
    for pattern in (r"(?ms)^<!-- (\w+): begin -->.*?^<!-- \1: end -->", r"(?ms)^```.*?^```$", r"(?m)^    \S.*$"):
        text = re.sub(pattern, lambda match: "\n" * match[0].count("\n"), text)
    return re.sub(r"`[^`\n]*`|\]\([^)\n]*\)", " ", text)


def messages(path: Path) -> Iterator[tuple[int, str]]:
    """Texts of a module that a user may read, with their lines: all with a space but docstrings; those of commands."""
    tree, inside = ast.parse(path.read_text(encoding="utf-8")), set()
    for node in ast.walk(tree):
        named = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node)
        if named and not (path.parent.name == "cli" and getattr(node, "decorator_list", [])):
            inside.add(node.body[0].value)
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) and node not in inside else None
        if isinstance(text, str) and " " in text.strip():
            yield node.lineno, text


def test_pages_use_the_fields_words():
    places = [
        f"{page.relative_to(ROOT)}:{number}: '{ours}': {theirs}"
        for page in PAGES
        for number, line in enumerate(prose(page).splitlines(), 1)
        for ours, theirs in found(line)
    ]
    assert not places, "\n" + "\n".join(places)


def test_messages_use_the_fields_words():
    places = [
        f"{path.relative_to(ROOT)}:{number}: '{ours}': {theirs}"
        for package in ("bcfj_jax", "calibration")
        for path in sorted((ROOT / package).rglob("*.py"))
        for number, text in messages(path)
        for ours, theirs in found(text)
    ]
    assert not places, "\n" + "\n".join(places)


def test_words_are_found_and_exceptions_are_kept(tmp_path):
    assert found("The books close.") == [("books", "energy balance")]
    assert found("a pool of two processes, a bookshelf, the settling time") == []
    page, module = tmp_path / "page.md", tmp_path / "module.py"
    page.write_text("A rung.\n```\na lane\n```\n<!-- x: begin -->\nonset\n<!-- x: end -->\n`onset` told\n")
    assert [found(line) != [] for line in prose(page).splitlines()] == [True] + 6 * [False] + [True]
    module.write_text(
        '"""Of lanes."""\nfound = f"an {onset} of rungs"\nonset = "onset"\nraise InputError("x: a room", found)\n'
    )
    assert [line for line, text in messages(module) if found(text)] == [2, 4]
