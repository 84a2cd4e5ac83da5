"""JSON: lists of numbers by the path of the objects that hold them, or a list of objects, each of which is a row."""

from __future__ import annotations

import json
from typing import Any

from bcfj_jax.data.columns import Content
from bcfj_jax.data.readers.mat import tables_of

KINDS, LIBRARY = (".json",), ""
SIGNATURE = b""


def read(file: str, wanted: str) -> Content:
    """The columns of each object by its path."""
    with open(file, encoding="utf-8-sig") as text:
        content = _columns(json.load(text))
    return Content(tables_of(content if isinstance(content, dict) else {"column": content}))


def _columns(content: Any) -> Any:
    """Content whose lists of objects are objects of lists."""
    if isinstance(content, dict):
        return {str(key): _columns(value) for key, value in content.items()}
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        rows = [_flat(row) for row in content]
        return {key: [row.get(key) for row in rows] for key in dict.fromkeys(key for row in rows for key in row)}
    return content


def _flat(row: dict[str, Any], above: str = "") -> dict[str, Any]:
    """The values of objects within objects by their path."""
    found: dict[str, Any] = {}
    for key, value in row.items():
        found |= _flat(value, f"{above}{key}.") if isinstance(value, dict) else {f"{above}{key}": value}
    return found
