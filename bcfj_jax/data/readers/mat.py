"""MATLAB up to version 7.2 by SciPy, 7.3 as HDF5, and JSON: the vectors of a file by the path of the struct that holds them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from bcfj_jax.data.clock import is_rate, is_step
from bcfj_jax.data.columns import UNIT_NAMES, Columns, Content, Tables, alone, group, headed, text, vector, with_units
from bcfj_jax.data.readers import hdf5

KINDS, LIBRARY = (".mat", ".json"), "h5py"
SIGNATURE = b""
_VALUES = ("values", "value", "data", "samples")


def read(file: str, wanted: str) -> Content:
    """The columns of each struct by its path."""
    if file.lower().endswith(".json"):
        with open(file, encoding="utf-8-sig") as content:
            found = _columns(json.load(content))
        return Content(tables_of(found if isinstance(found, dict) else {"column": found}))
    from scipy.io import loadmat

    return hdf5.read(file, wanted) if hdf5.is_hdf5(file) else Content(tables_of(loadmat(file, simplify_cells=True)))


def tables_of(content: Mapping[str, Any]) -> Tables:
    """Tables of structs in structs: vectors, matrices (``columns.group``); Testlab's has a unit in "quantity", a name beside."""
    tables: Tables = {}
    said: Tables = {}

    def visit(table: str, struct: Mapping[str, Any], above: Columns) -> None:
        columns: Columns = {}
        rates = {**above, **alone(struct)}
        matrices: dict[str, np.ndarray] = {}
        tables[table] = {}
        for name, value in headed(struct).items():
            if isinstance(value, (list, np.ndarray)) and len(value) and all(isinstance(v, Mapping) for v in value):
                value = {f"run {k}": v for k, v in enumerate(value, 1)}
            if isinstance(value, Mapping):
                # A struct about one list of values, and none as long beside it, is a channel.
                more = [len(v) for k, v in value.items() if k not in _VALUES and (isinstance(v, list) or np.ndim(v))]
                own = next((k for k in _VALUES if k in value and max(more, default=0) < 64), "")
                if not own:
                    visit(f"{table}/{name}".strip("/"), value, rates)
                    continue
                held = q if isinstance(q := value.get("quantity"), Mapping) else {}
                unit = next((value[k] for k in UNIT_NAMES if k in value), held.get("label"))
                beside = [v["name"] for v in struct.values() if held and isinstance(v, Mapping) and "name" in v]
                columns.update({k: c for k, c in alone(value).items() if is_rate(k) or is_step(k)})
                name, value = str(text(value.get("label", value.get("name", *beside))) or name), value[own]
            else:
                unit = None
            if not name.startswith("__"):
                with contextlib.suppress(ValueError):  # A cell of vectors that differ in length.
                    array = np.asarray(value)
                    if found := vector(array, unit):
                        columns[name] = found
                    elif array.ndim == 2:
                        matrices[name] = array
        tables[table] = {**said.pop(table, {}), **group(columns, matrices)}
        if any(c.size > 1 for c in tables[table].values()):
            tables[table] = {**rates, **tables[table]}
        parent, _, last = table.rpartition("/")
        # A struct of single values is about those beside it.
        if table and last not in UNIT_NAMES and {c.size for c in tables[table].values()} == {1}:
            said[parent] = {**said.get(parent, {}), **tables.pop(table)}

    visit("", content, {})
    return with_units(tables)


def _columns(content: Any) -> Any:
    """Content whose lists of objects are objects of lists."""
    if isinstance(content, dict):
        return {str(key): _columns(value) for key, value in content.items()}
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        if all(isinstance(row.get(next((k for k in _VALUES if k in row), "")), list) for row in content):
            return {str(row.get("name", row.get("label", k))): row for k, row in enumerate(content, 1)}
        rows = [_flat(row) for row in content]
        return {key: [row.get(key) for row in rows] for key in dict.fromkeys(key for row in rows for key in row)}
    return content


def _flat(row: dict[str, Any], above: str = "") -> dict[str, Any]:
    """The values of objects within objects by their path."""
    found: dict[str, Any] = {}
    for key, value in row.items():
        found |= _flat(value, f"{above}{key}.") if isinstance(value, dict) else {f"{above}{key}": value}
    return found
