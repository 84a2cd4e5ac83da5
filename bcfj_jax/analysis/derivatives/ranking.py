"""Design sensitivity as people read it: percent change of a feature per percent change of a parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import NOT, Certificate
from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity
from bcfj_jax.io.units import format_si


class Ranking(NamedTuple):
    """Elasticities (F, P), d ln f/d ln p [-], features and parameters strongest first; NaN where there is none."""

    features: list[str]
    parameters: list[str]
    elasticity: np.ndarray


def meaningful(found: Sensitivity) -> list[str]:
    """Parameters whose derivatives are not called ``not differentiable here``."""
    checks = found.certificate.parameters if found.certificate else {}
    return [name for name in found.wrt if name not in checks or checks[name].verdict != NOT]


def ranking(found: Sensitivity, values: Mapping[str, Any]) -> Ranking:
    """Elasticities p/f df/dp, sorted; features without a value, or with 0, come last.

    A parameter whose verdict is ``not differentiable here`` has none: its figures would mean nothing.
    """
    names, parameters = list(found.features), list(found.wrt)
    table = np.full((len(names), len(parameters)), np.nan)
    known = meaningful(found)
    for i, name in enumerate(names):
        f = found.features[name]
        for k, p in enumerate(parameters):
            if f and p in known and math.isfinite(f) and float(values[p]) != 0.0:
                table[i, k] = float(values[p]) / f * found.feature_derivatives[p][name]
    size = np.nan_to_num(np.abs(table), nan=-1.0, posinf=1e300)
    rows = np.argsort(-size.max(axis=1, initial=-1.0), kind="stable")
    columns = np.argsort(-size.max(axis=0, initial=-1.0), kind="stable")
    return Ranking([names[i] for i in rows], [parameters[k] for k in columns], table[np.ix_(rows, columns)])


def ranked_rows(found: Sensitivity, ranked: Ranking) -> list[list[str]]:
    """The table: features down with their values, parameters across."""
    rows = [["% per %", "value", *ranked.parameters]]
    for name, line in zip(ranked.features, ranked.elasticity, strict=True):
        value = format_si(found.features[name], feature_unit(name), 5)
        rows.append([name, value, *("-" if not math.isfinite(x) else f"{x:+.3g}" for x in line)])
    return rows


def certificate_rows(certificate: Certificate) -> list[list[str]]:
    """The certificate's table: a parameter a row."""
    rows = [["parameter", "verdict", "pointwise", "averaged", "tangent growth", "breaks down", "remark"]]
    for name, check in certificate.parameters.items():
        figures = (_percent(check.pointwise), _percent(check.average), _plain(check.growth))
        rows.append([name, check.verdict, *figures, format_si(check.breakdown, "s", 4), check.remark])
    return rows


def _percent(x: float) -> str:
    return "-" if math.isnan(x) else f"{100 * x:.2g} %" if math.isfinite(x) else "unbounded"


def _plain(x: float) -> str:
    return "-" if math.isnan(x) else f"{x:.2g}"


def said(found: Sensitivity) -> str:
    """The outcome in a sentence or two, failures first."""
    if found.status != "ok":
        return f"The simulation failed at {format_si(found.failure_time, 's')}: {found.reason}."
    if found.certificate is None:
        return "Derivatives were not certified: nothing says how good they are."
    groups: dict[str, list[str]] = {}
    for name, check in found.certificate.parameters.items():
        groups.setdefault(check.verdict, []).append(name)
    return " ".join(f"{verdict[0].upper()}{verdict[1:]}: {', '.join(names)}." for verdict, names in groups.items())
