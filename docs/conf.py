"""How the pages become a site: Sphinx with MyST, built and read without a network (``make docs``)."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

from docutils.nodes import SkipNode
from docutils.utils.math import latex2mathml

HERE = Path(__file__).resolve().parent
os.environ.setdefault("JAX_PLATFORMS", "cpu")
sys.path.insert(0, str(HERE.parent))

from bcfj_jax._version import __version__  # noqa: E402  (of this checkout, before any other)

project = "bcfj-jax"
author = "the bcfj-jax authors"
copyright = "the bcfj-jax authors, MIT licence"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "index"
exclude_patterns = ["drawings"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
highlight_language = "text"

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_class_signature = "separated"
autodoc_preserve_defaults = False
napoleon_numpy_docstring = False
napoleon_use_ivar = True
# Types of other packages have no page here, since nothing is fetched; nor have types of inner modules.
nitpick_ignore_regex = [(r"py:.*", r"(?!(bcfj_jax|calibration)\.\w+$).*")]

html_theme = "furo"
html_title = "bcfj-jax"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_math_renderer = "mathml"

# Pages whose text stands elsewhere in the repository.
BROUGHT = {"benchmarks": HERE.parent / "benchmarks" / "README.md", "changelog": HERE.parent / "CHANGELOG.md"}


def bring(app: Any, page: str, text: list[str]) -> None:
    """Put a file from outside in a page's place, with links that hold on the site."""
    if page in BROUGHT:
        text[0] = re.sub(r"\]\((?:\.\./)?docs/", "](", BROUGHT[page].read_text(encoding="utf-8"))
    text[0] = (
        text[0].replace("](../benchmarks/README.md", "](benchmarks.md").replace("](../CHANGELOG.md", "](changelog.md")
    )


def plain(app: Any, what: str, name: str, thing: object, options: Any, lines: list[str]) -> None:
    """Docstrings are plain text with ``code``: |x|, a*b and a trailing x_ mean nothing else."""
    for number, line in enumerate(lines):
        # One line for several arguments: "a, b: text". Napoleon would take the first for a type.
        line = re.sub(r"^(\s+)(\w+(?:, \w+)+)(?=:(?: |$))", lambda m: m[1] + m[2].replace(", ", "/"), line)
        pieces = re.split(r"(``.*?``|:\w+(?::\w+)?:`.*?`)", line)
        marks = re.compile(r"(?<!\\)([|*]|_(?=\W|$))")
        lines[number] = "".join(p if at % 2 else marks.sub(r"\\\1", p) for at, p in enumerate(pieces))


def left_out(app: Any, what: str, name: str, thing: object, skip: bool, options: Any) -> bool | None:
    """Fields of a NamedTuple stand in the docstring of their class."""
    return True if type(thing).__name__ == "_tuplegetter" else None


def _formula(block: bool) -> Any:
    """A formula as MathML, which browsers draw themselves: no script, no font from a network."""

    def visit(translator: Any, node: Any) -> None:
        inner = latex2mathml.tex2mathml(node.astext(), as_block=block)
        translator.body.append(f'<div class="formula">{inner}</div>' if block else inner)
        raise SkipNode

    return visit


def setup(app: Any) -> None:
    """What Sphinx calls: docstrings before napoleon reads their sections."""
    app.connect("source-read", bring)
    app.connect("autodoc-process-docstring", plain, priority=100)
    app.connect("autodoc-skip-member", left_out)
    app.add_html_math_renderer("mathml", (_formula(False), None), (_formula(True), None))
