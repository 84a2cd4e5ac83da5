"""Design sensitivity as people read it: percent change of a feature per percent change of a parameter."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import AVERAGED, BROKEN, LEAST, NOT, TRUSTED, Certificate, of_feature
from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity
from bcfj_jax.io.page import brief
from bcfj_jax.io.units import format_si


class Ranking(NamedTuple):
    """Elasticities (F, P), d ln f/d ln p [-], features and parameters strongest first; NaN where there is none.

    What is not known within 10 % says nothing of the order, and comes after what is.

    ``apart`` (F, P): relative error of each at most; NaN without a certificate.
    """

    features: list[str]
    parameters: list[str]
    elasticity: np.ndarray
    apart: np.ndarray


def meaningful(found: Sensitivity) -> list[str]:
    """Parameters whose derivatives are not called ``not differentiable here``."""
    checks = found.certificate.parameters if found.certificate else {}
    return [name for name in found.wrt if name not in checks or checks[name].verdict != NOT]


def ranking(found: Sensitivity, values: Mapping[str, Any]) -> Ranking:
    """Elasticities p/f df/dp of the run's features, sorted; features without a value, or with 0, come last.

    A parameter of which nothing means anything (``Check.lost``) has none.
    """
    checks = found.certificate.parameters if found.certificate else {}
    known = {p for p in found.wrt if p not in checks or not checks[p].lost}
    distance = {p: checks[p].features if p in checks else {} for p in found.wrt}
    return _ranked(found.features, found.feature_derivatives, distance, found.wrt, known, values)


def steady_ranking(found: Sensitivity, values: Mapping[str, Any]) -> Ranking:
    """Elasticities of the features of steady motion."""
    steady = found.steady
    assert steady is not None
    return _ranked(steady.features, steady.feature_derivatives, steady.apart, found.wrt, set(found.wrt), values)


def _ranked(features, derivatives, distance, wrt, known, values) -> Ranking:
    names, parameters = list(features), list(wrt)
    table, apart = (np.full((len(names), len(parameters)), np.nan) for _ in range(2))
    for i, name in enumerate(names):
        f = features[name]
        for k, p in enumerate(parameters):
            apart[i, k] = distance[p].get(name, np.nan)
            if f and p in known and math.isfinite(f) and float(values[p]) != 0.0:
                table[i, k] = float(values[p]) / f * derivatives[p][name]
    size = np.nan_to_num(np.abs(table), nan=-2.0, posinf=1e300)
    size = np.where((apart > BROKEN) & (size >= 0.0), -1.0, size)
    rows = np.argsort(-size.max(axis=1, initial=-2.0), kind="stable")
    columns = np.argsort(-size.max(axis=0, initial=-2.0), kind="stable")
    at = np.ix_(rows, columns)
    return Ranking([names[i] for i in rows], [parameters[k] for k in columns], table[at], apart[at])


def ranked_rows(
    features: Mapping[str, float], ranked: Ranking, sampled: Collection[str] = (), mark: str = ""
) -> list[list[str]]:
    """The table: features down with their values, parameters across; ``sampled`` ones have a star, and every row a mark."""
    rows = [["% per %", "value", *ranked.parameters, *([""] if mark else [])]]
    for name, *lines in zip(ranked.features, ranked.elasticity, ranked.apart, strict=True):
        cells = [_cell(x, apart) for x, apart in zip(*lines, strict=True)]
        starred = f"{name} *" if name in sampled else name
        rows.append([starred, brief(features[name], feature_unit(name)), *cells, *([mark] if mark else [])])
    return rows


LEGEND = (
    "Without a mark: good to 3 % (a small number to 0.0003). ±: its error at most. "
    "In brackets: not known within 10 % (0.001), so that it is a size only. 0: below 0.0001. -: no derivative."
)

SAMPLED = "*: of samples alone; the error counts what lies between them."


def legend(found: Sensitivity) -> str:
    """What the table's marks mean; "" of a result that is not certified."""
    return " ".join([LEGEND, *([SAMPLED] if found.sampled else [])]) if found.certificate else ""


def _cell(elasticity: float, apart: float) -> str:
    """A number no better than it is; a small one's error is a share of ``LEAST``."""
    if not math.isfinite(elasticity):
        return "-"
    if math.isnan(apart):
        return f"{elasticity:+.3g}"
    if math.isinf(apart):
        return f"({elasticity:+.1g} ±?)"
    verdict, small = of_feature(apart), abs(elasticity) < LEAST
    if verdict == TRUSTED:
        return f"{elasticity:+.3g}" if not small else "0" if abs(elasticity) < 1e-4 else f"{elasticity:+.4f}"
    error = f"±{apart * LEAST:.4f}" if small else f"±{100 * apart:.0f} %"
    if verdict == AVERAGED:
        return f"{elasticity:+.4f} {error}" if small else f"{elasticity:+.2g} {error}"
    return f"({elasticity:+.3f} {error})" if small else f"({elasticity:+.1g} {error})"


def drivers(found: Sensitivity, values: Mapping[str, Any]) -> list[str]:
    """Which parameter drives each feature, in sentences: "clearance_seat_cage drives seat_cage.peak: -0.54 % per %".

    Of three features at most: those that were asked for first; of more, the peak that a parameter moves by most
    newtons, so that no contact that bears next to nothing stands for the forces. Where
    motion becomes steady, its features are taken, which do not depend on the start. No sentence where nothing is known
    (``unknown``).
    """
    if found.steady is not None and not found.steady.reason:
        ranked, kind, size_of = steady_ranking(found, values), "steady ", found.steady.features
    else:
        ranked, kind, size_of = ranking(found, values), "", found.features
    known = {name: k for k, name in enumerate(ranked.features)}
    wanted = [name for name in found.features if name in known]
    sentences = []
    moved = np.abs(np.nan_to_num(ranked.elasticity)).max(axis=1, initial=0.0)
    peaks = [name for name in ranked.features if name.endswith(".peak")]
    peaks.sort(key=lambda name: -moved[known[name]] * abs(float(np.nan_to_num(size_of[name]))))
    for name in wanted if len(wanted) <= 3 else (peaks or ranked.features)[:1]:
        row, apart = ranked.elasticity[known[name]], ranked.apart[known[name]]
        size = np.where(np.isfinite(row), np.abs(row), -1.0)
        first, *others = np.argsort(-size, kind="stable")
        if size[first] <= 0.0:
            continue
        text = f"{ranked.parameters[first]} drives {kind}{name}: {row[first]:+.2g} % per %"
        if others and size[others[0]] > 0.0:
            text += f", then {ranked.parameters[others[0]]}: {row[others[0]]:+.2g}"
        unsure = math.isfinite(apart[first]) and of_feature(float(apart[first])) == NOT
        sentences.append(text + (", a size only: not known within 10 %" if unsure else ""))
    return sentences


def unknown(found: Sensitivity) -> str:
    """Why no parameter is known to drive a feature, and what would help."""
    reasons = ["no derivative is finite"]
    if empty := [name for name, force in found.force.items() if not np.any(force)]:
        zero = f"at all {len(found.times)} samples the force of {', '.join(empty)} is 0"
        reasons = [f"{zero}, and a shorter contact needs more samples"]
    elif found.certificate is not None:
        remarks = dict.fromkeys(check.remark for check in found.certificate.parameters.values() if check.remark)
        reasons = list(remarks) or ["of no feature is it known within 10 %"]
    return f"What drives {next(iter(found.features), 'the forces')} is not known: {'; '.join(reasons)}"


def certificate_rows(certificate: Certificate) -> list[list[str]]:
    """The certificate's table: a parameter a row."""
    rows = [["parameter", "verdict", "pointwise", "averaged", "tangent growth", "breaks down", "remark"]]
    for name, check in certificate.parameters.items():
        figures = (_percent(check.pointwise), _percent(check.average), _plain(check.growth))
        rows.append([name, check.verdict, *figures, brief(check.breakdown, "s"), check.remark])
    return rows


def _percent(x: float) -> str:
    return "-" if math.isnan(x) else f"{100 * x:.2g} %" if math.isfinite(x) else "unbounded"


def _plain(x: float) -> str:
    return "-" if math.isnan(x) else f"{x:.2g}"


def said(found: Sensitivity) -> str:
    """The outcome in sentences, failures first."""
    if found.status != "ok":
        return f"The simulation failed at {format_si(found.failure_time, 's')}: {found.reason}."
    if found.certificate is None:
        parts = ["Derivatives were not certified: nothing says how good they are.", *_missing(found)]
        return " ".join([*parts, *_of_steady(found)])
    checks = found.certificate.parameters
    groups: dict[str, list[str]] = {}
    for name, check in checks.items():
        until = check.breakdown
        good = f" (until {format_si(until, 's')})" if math.isfinite(until) and until > found.times[0] else ""
        groups.setdefault(check.verdict, []).append(name + good)
    parts = [f"{verdict[0].upper()}{verdict[1:]}: {', '.join(names)}." for verdict, names in groups.items()]
    told = [v for c in checks.values() for v in c.feature_verdicts.values()]
    if set(groups) != {TRUSTED}:
        parts[0] = f"Histories. {parts[0]}"
        parts.append(f"Derivatives of features: {_counted(told)}.")
    unchecked: dict[str, list[str]] = {}
    for name, check in checks.items():
        if check.unchecked:
            unchecked.setdefault(check.unchecked, []).append(name)
    parts += [f"Of {', '.join(names)} {text}." for text, names in unchecked.items()]
    return " ".join([*parts, *_missing(found), *_of_steady(found)])


def _missing(found: Sensitivity) -> list[str]:
    """Why features of single contacts have no value."""
    return [f"{name} has no value: {why}." for name, why in found.reasons.items()]


def _counted(told: list[str]) -> str:
    words = {TRUSTED: "trusted", AVERAGED: "good to 10 %", NOT: "not known within 10 %"}
    return ", ".join(f"{told.count(v)} {words[v]}" for v in words if v in told)


def _of_steady(found: Sensitivity) -> list[str]:
    steady = found.steady
    if steady is None:
        return []
    if steady.reason:
        return [f"Steady motion has no derivative of its own: {steady.reason}."]
    told = [v for row in steady.verdicts.values() for v in row.values()]
    return [f"Derivatives of features of steady motion: {_counted(told) or 'not checked'}."]
