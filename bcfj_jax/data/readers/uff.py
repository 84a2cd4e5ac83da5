"""Universal files, dataset 58, by pyuff: histories over time, a table for each clock."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from bcfj_jax.data.columns import Content, Refused, Sampled, sampled

KINDS, LIBRARY = (".uff", ".unv", ".uf", ".bunv", ".58"), "pyuff"
SIGNATURE = rb"\s*-1\s*\r?\n\s{0,6}(15|55|58b?|82|151|164|2411|2414)\b"
_NONE = ("", "NONE", "none", "None")
# Of ordinates by the code of what they measure, where their axis has no name.
_MEASURED = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
_HISTORY = 1
# The first line of a binary dataset, with the number of its bytes, and eleven more.
_BINARY = re.compile(rb"(?m)^ {4}58b.{24}([ \d]{12}).*\n(?:.*\n){11}")


def read(file: str, wanted: str) -> Content:
    """The histories in a file; other functions, as of frequency, are left out and said."""
    import pyuff

    content = pyuff.UFF(file)
    where = [k for k, kind in enumerate(content.get_set_types()) if kind == 58]
    sets: list[Any] = [content.read_sets(k) for k in where]
    histories = [one for one in sets if int(one["func_type"]) in (0, _HISTORY)]
    if not histories:
        raise Refused("it holds no history over time in a dataset 58", "export time histories as dataset 58")
    channels, names = [], [_name(one) for one in histories]
    firsts = [str(one.get("id1", "")).strip() for one in histories]
    # Hits of one sensor differ by their first line.
    names = firsts if len(set(names)) < len(names) == len(set(firsts)) else names
    for one, name in zip(histories, names, strict=True):
        values = np.asarray(one["data"])
        if values.size != int(one["num_pts"]) or np.iscomplexobj(values) or not np.isfinite(values).all():
            raise Refused(f"'{name}' states {int(one['num_pts'])} numbers and holds {values.size}", None)
        if not int(one.get("abscissa_spacing", 1)):
            raise Refused(f"'{name}' has no even clock", "export it with an even step, or as CSV")
        unit = str(one.get("ordinate_axis_units_lab", "")).strip()
        step = float(one["abscissa_inc"])
        if not step > 0.0:
            raise Refused(f"the clock of '{name}' has a step of {step}", "export it again")
        channels.append(Sampled(name, None if unit in _NONE else unit, values, float(one["abscissa_min"]), step))
    _check_binary(file)
    left = len(sets) - len(histories)
    note = f"{left} functions that are no history over time are left out" if left else ""
    return Content(sampled("", channels), note)


def _check_binary(file: str) -> None:
    """Refuse a binary dataset 58 whose numbers do not end where its first line says."""
    with open(file, "rb") as content:
        raw = content.read()
    for found in _BINARY.finditer(raw):
        end = found.end() + int(found[1])
        # A last byte that is the end of a line is none of a number, but of the line that follows.
        if not re.match(rb"(\r?\n)? {4}-1", raw[end:]) or raw[end - 1 : end] == b"\n":
            raise Refused(f"a binary dataset 58 states {int(found[1])} bytes of numbers and does not end there", None)


def _name(one: Any) -> str:
    """The axis, or what is measured, with the node and direction where they say something."""
    label = str(one.get("ordinate_axis_lab", "")).strip()
    first = str(one.get("id1", "")).strip()
    measured = _MEASURED.get(int(one.get("ordinate_spec_data_type", 0)), "")
    name = next((x for x in (label, measured, first) if x not in _NONE), "channel")
    node = int(one.get("rsp_node", 0))
    return f"{name} {node}" if node > 1 else name
