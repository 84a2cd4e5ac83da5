"""The rules of every report, for the tests of whatever writes one."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

from bcfj_jax.io.page import SIGNS

LARGEST = 1_000_000  # bytes


class Seen(HTMLParser):
    """What a test asks of a page: tags in order with their attributes, ids, and text by tag."""

    VOID = ("meta", "link", "img", "br", "hr", "input")

    def __init__(self, page: str):
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text: list[tuple[str, str]] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, "tags are closed in order"

    def handle_data(self, data):
        if data.strip():
            self.text.append((self.open[-1], data.strip()))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def check(path: Path) -> Seen:
    """The rules of every report."""
    page = path.read_text(encoding="utf-8")
    assert path.stat().st_size <= LARGEST
    seen = Seen(page)
    assert not seen.open
    names = [tag for tag, _ in seen.tags]
    assert page.startswith("<!DOCTYPE html>") and seen.all("html")[0]["lang"] == "en"
    assert names.count("h1") == 1 and names.count("main") == 1
    # The verdict is the first thing after the heading: a sign, a word and one sentence, not colour alone.
    after = seen.tags[names.index("main") + 1]
    kind = (after[1]["class"] or "").split()[1]
    assert after[0] == "p" and (after[1]["class"] or "").startswith("verdict ") and kind in SIGNS
    assert page.index("</h1>") < page.index('class="verdict') < page.index("<h2")
    for image in seen.all("img"):
        assert (image["src"] or "").startswith("data:image/png;base64,")
        alt = image["alt"] or ""
        assert " " in alt and alt.endswith("."), "alt is a sentence"
    assert all(cell.get("scope") in ("row", "col") for cell in seen.all("th"))
    ids = [attributes["id"] for _, attributes in seen.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    # Scroll regions can be reached by keyboard, and have a name.
    for tag, attributes in seen.tags:
        if tag == "pre" or attributes.get("class") == "scroll":
            assert attributes["tabindex"] == "0" and attributes["role"] == "region" and attributes["aria-label"]
    # Nothing is fetched.
    for _, attributes in seen.tags:
        for name in ("src", "href", "action", "data"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#"))
    assert "@import" not in page and "url(" not in page.partition("</style>")[0]
    return seen
