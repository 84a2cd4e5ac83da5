"""What is worth showing of derivatives in Python: a few lines, tables, their pictures (``io.show.View``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives import pictures, ranking
from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity
from bcfj_jax.io.outputs import COMPONENTS
from bcfj_jax.io.show import Dataset, Told


def told(found: Sensitivity) -> Told:
    """What the derivatives are worth; per cent of each feature per per cent of each parameter, strongest first."""
    verdict = found.certificate.verdict if found.certificate else "not certified"
    if found.status != "ok":
        return Told("failed", [ranking.said(found)])
    rows = ranking.ranked_rows(found.features, ranking.ranking(found, found.values), found.sampled)
    wide = [[*row[:5], *(["..."] if len(row) > 5 else [])] for row in rows]
    return Told(verdict, [ranking.said(found)], wide, [f"derivatives by {len(found.wrt)} parameter(s) per SI unit"])


def frame(found: Sensitivity) -> tuple[dict[str, Any], str]:
    """A feature and a parameter a row: value, derivative per SI unit, % per %, verdict."""
    checks = found.certificate.parameters if found.certificate else {}
    table: dict[str, list[Any]] = {
        key: [] for key in ("feature", "parameter", "value", "unit", "derivative", "percent_per_percent", "verdict")
    }
    for feature, value in found.features.items():
        for name in found.wrt:
            slope = found.feature_derivatives[name][feature]
            share = slope * found.values[name] / value if value else np.nan
            verdict = checks[name].feature_verdicts.get(feature, "") if name in checks else ""
            verdict += ", bound from samples" if verdict and feature in found.sampled else ""
            row = (feature, name, value, feature_unit(feature), slope, share, verdict)
            for column, cell in zip(table.values(), row, strict=True):
                column.append(cell)
    return table, ""


def dataset(found: Sensitivity) -> Dataset:
    """Forces, their derivatives (dimension parameter), features and theirs."""
    variables: dict[str, Any] = {}
    names = list(found.features)
    coordinates: dict[str, Any] = {
        "time": (("time",), found.times, "s"),
        "component": (("component",), list(COMPONENTS), ""),
        "parameter": (("parameter",), list(found.wrt), ""),
        "feature": (("feature",), names, ""),
        "unit": (("feature",), [feature_unit(name) for name in names], ""),
    }
    for name, force in found.force.items():
        dims: tuple[str, ...] = ("time", "component")
        if force.ndim == 3:
            dims = ("time", f"{name}_member", "component")
            coordinates[dims[1]] = ((dims[1],), np.arange(1, force.shape[1] + 1), "")
        variables[f"{name}.force"] = (dims, force, "N")
        if found.derivative:
            slopes = np.stack([found.derivative[p][name] for p in found.wrt])
            variables[f"{name}.derivative"] = (("parameter", *dims), slopes, "N per SI unit")
    slopes = [[found.feature_derivatives[p][name] for name in names] for p in found.wrt]
    variables["value"] = (("feature",), [found.features[name] for name in names], "")
    variables["feature_derivative"] = (("parameter", "feature"), np.reshape(slopes, (len(found.wrt), len(names))), "")
    about = {"status": found.status, "reason": found.reason}
    return Dataset(
        variables, coordinates, about | ({"verdict": found.certificate.verdict} if found.certificate else {})
    )


def figures(found: Sensitivity) -> dict[str, Callable[[Any], Any]]:
    """Which parameter moves which feature; histories with what 1 % of a parameter does to them."""
    if found.status != "ok":
        return {}
    ranked = ranking.ranking(found, found.values)
    drawn: dict[str, Callable[[Any], Any]] = {"tornado": partial(pictures.tornado, ranked)}
    return drawn | ({"bands": partial(pictures.bands, found, found.values)} if found.derivative else {})
