"""Design sensitivity as people read it: percent change of a feature per percent change of a parameter.

A table, sentences and pictures of them, for a terminal, a report and Python (``io.show.View``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import AVERAGED, BROKEN, LEAST, NOT, TRUSTED, Certificate, of_feature
from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity
from bcfj_jax.core.quantities import percent, rounded
from bcfj_jax.io.outputs import COMPONENTS
from bcfj_jax.io.page import Picture, brief
from bcfj_jax.io.plots import COLOURS, label, panels
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import engineering, format_si
from bcfj_jax.mechanism.channels import is_reading, quantity_of, unit_of

LEGEND = (
    "Without a mark: good to 3 % (a small number to 0.0003). ±: its error at most. "
    "In brackets: not known within 10 % (0.001), so that it is a size only. 0: below 0.0001. -: no derivative."
)
SAMPLED = "*: of samples alone; the error counts what lies between them."
_WORDS = {TRUSTED: "trusted", AVERAGED: "good to 10 %", NOT: "not known within 10 %"}
_MOST_PANELS, _MOST_BANDS = 6, 3
# Changes of a parameter that a band may stand for, and the share of the largest value that one can see.
_CHANGES, _VISIBLE = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5), 0.05


class Ranking(NamedTuple):
    """Elasticities (F, P), d ln f/d ln p [-], features and parameters strongest first; NaN where there is none.

    What is not known within 10 % says nothing of the order, and comes after what is. ``apart`` (F, P): relative error of
    each at most; NaN without a certificate. ``values`` (F,): of the features.
    """

    features: list[str]
    parameters: list[str]
    elasticity: np.ndarray
    apart: np.ndarray
    values: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """Elasticities, NaN for what is not known within 10 %."""
        return np.where(self.apart > BROKEN, np.nan, self.elasticity)


def in_steady(found: Sensitivity) -> bool:
    """Whether there are derivatives of steady motion."""
    return found.steady is not None and not found.steady.reason


def ranking(found: Sensitivity, of_steady: bool = False) -> Ranking:
    """Elasticities p/f df/dp of the run's features, or of those of its steady motion, sorted.

    Features without a value, or with 0, come last. A parameter of which nothing means anything (``Check.lost``) has none.
    """
    checks = found.certificate.parameters if found.certificate and not of_steady else {}
    source: Any = found.steady if of_steady else found
    apart = source.apart if of_steady else {p: check.features for p, check in checks.items()}
    names, wrt = list(source.features), list(found.wrt)
    f = np.array([source.features[name] for name in names], float)
    p = np.array([np.nan if x in checks and checks[x].lost else float(found.values[x]) or np.nan for x in wrt])
    by = np.array([[source.feature_derivatives[x][name] for x in wrt] for name in names]).reshape(len(f), len(p))
    off = np.array([[apart.get(x, {}).get(name, np.nan) for x in wrt] for name in names]).reshape(by.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        table = p / np.where(np.isfinite(f) & (f != 0.0), f, np.nan)[:, None] * by
    size = np.nan_to_num(np.abs(table), nan=-2.0, posinf=1e300)
    size = np.where((off > BROKEN) & (size >= 0.0), -1.0, size)
    rows, columns = (np.argsort(-size.max(axis=axis, initial=-2.0), kind="stable") for axis in (1, 0))
    at = np.ix_(rows, columns)
    return Ranking([names[i] for i in rows], [wrt[k] for k in columns], table[at], off[at], f[rows])


def ranked_rows(ranked: Ranking, sampled: Collection[str] = (), mark: str = "") -> list[list[str]]:
    """The table: features down with their values, parameters across; ``sampled`` ones have a star, and every row a mark."""
    more = [mark] if mark else []
    rows = [["% per %", "value", *ranked.parameters, *([""] if mark else [])]]
    for name, value, line, apart in zip(ranked.features, ranked.values, ranked.elasticity, ranked.apart, strict=True):
        starred = f"{name} *" if name in sampled else name
        rows.append([starred, brief(float(value), feature_unit(name)), *map(_cell, line, apart), *more])
    return rows


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
        return f"({rounded(elasticity, 1, '+')} ±?)"
    verdict, small = of_feature(apart), abs(elasticity) < LEAST
    if verdict == TRUSTED:
        return f"{elasticity:+.3g}" if not small else "0" if abs(elasticity) < 1e-4 else f"{elasticity:+.4f}"
    error = f"±{apart * LEAST:.4f}" if small else f"±{100 * apart:.0f} %"
    if verdict == AVERAGED:
        return f"{elasticity:+.4f} {error}" if small else f"{rounded(elasticity, 2, '+')} {error}"
    return f"({elasticity:+.3f} {error})" if small else f"({rounded(elasticity, 1, '+')} {error})"


def drivers(found: Sensitivity) -> list[str]:
    """Which parameter moves which feature most, in sentences.

    Of three features at most: those that were asked for first; of more, the peak that a parameter moves by most
    newtons, so that no contact that bears next to nothing stands for the forces. Where motion becomes steady, its features
    are taken, which do not depend on the start. No sentence where nothing is known (``unknown``).
    """
    ranked, kind = ranking(found, in_steady(found)), "steady " if in_steady(found) else ""
    known = {name: k for k, name in enumerate(ranked.features)}
    wanted = [name for name in found.features if name in known]
    moved = np.abs(np.nan_to_num(ranked.elasticity)).max(axis=1, initial=0.0) * np.abs(np.nan_to_num(ranked.values))
    peaks = [name for name in ranked.features if name.endswith(".peak")]
    peaks.sort(key=lambda name: -moved[known[name]])
    sentences = []
    for name in wanted if 0 < len(wanted) <= 3 else (peaks or ranked.features)[:1]:
        row, apart = ranked.elasticity[known[name]], ranked.apart[known[name]]
        size = np.where(np.isfinite(row), np.abs(row), -1.0)
        first, *others = np.argsort(-size, kind="stable")
        if size[first] <= 0.0:
            continue
        text = f"{ranked.parameters[first]} drives {kind}{name}: {rounded(row[first], 2, '+')} % per %"
        if others and size[others[0]] > 0.0:
            text += f", then {ranked.parameters[others[0]]}: {rounded(row[others[0]], 2, '+')}"
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

    def share(x: float) -> str:
        return "unbounded" if math.isinf(x) else percent(x, 2)

    rows = [["parameter", "verdict", "pointwise", "averaged", "tangent growth", "breaks down", "remark"]]
    for name, check in certificate.parameters.items():
        grown = "-" if math.isnan(check.growth) else rounded(check.growth)
        figures = share(check.pointwise), share(check.average), grown, brief(check.breakdown, "s")
        rows.append([name, check.verdict, *figures, check.remark])
    return rows


def said(found: Sensitivity) -> str:
    """The outcome in sentences, failures first."""
    if found.status != "ok":
        return f"The simulation failed at {format_si(found.failure_time, 's')}: {found.reason}."
    checks = found.certificate.parameters if found.certificate else {}
    parts = [] if checks else ["Derivatives were not certified: nothing says how good they are."]
    groups, unchecked = dict[str, list[str]](), dict[str, list[str]]()
    for name, check in checks.items():
        until = check.breakdown
        good = f" (until {format_si(until, 's')})" if math.isfinite(until) and until > found.times[0] else ""
        groups.setdefault(check.verdict, []).append(name + good)
        if check.unchecked:
            unchecked.setdefault(check.unchecked, []).append(name)
    parts += [f"{verdict[0].upper()}{verdict[1:]}: {', '.join(names)}." for verdict, names in groups.items()]
    if checks and set(groups) != {TRUSTED}:
        parts[0] = f"Histories. {parts[0]}"
        parts.append(f"Derivatives of features: {_counted(check.feature_verdicts for check in checks.values())}.")
    parts += [f"Of {', '.join(names)} {text}." for text, names in unchecked.items()]
    parts += [f"{name} has no value: {why}." for name, why in found.reasons.items()]
    if found.steady is not None and found.steady.reason:
        parts.append(f"Steady motion has no derivative of its own: {found.steady.reason}.")
    elif found.steady is not None:
        counted = _counted(found.steady.verdicts.values()) or "not checked"
        parts.append(f"Derivatives of features of steady motion: {counted}.")
    return " ".join(parts)


def _counted(by_parameter: Iterable[Mapping[str, str]]) -> str:
    """How many of each verdict."""
    told = [verdict for row in by_parameter for verdict in row.values()]
    return ", ".join(f"{told.count(v)} {_WORDS[v]}" for v in _WORDS if v in told)


def tornado(ranked: Ranking, path: Path) -> Picture:
    """Bars of % per %, one panel for each of the strongest features, the strongest parameter on top.

    What is not known within 10 % has no bar.
    """
    rows = np.flatnonzero(np.isfinite(ranked.known).any(axis=1))[:_MOST_PANELS]
    title, said = "Which parameter moves which feature", []
    height = 1.1 + 0.28 * len(ranked.parameters)
    with panels(max(1, len(rows)), 2, path, 6.2, height) as axes:
        if not len(rows):
            axes[0].text(0.5, 0.5, "no feature has a derivative", transform=axes[0].transAxes, ha="center")
        for axis, row in zip(axes, rows, strict=False):
            line = np.nan_to_num(ranked.known[row])
            order = np.argsort(np.abs(line), kind="stable")
            colours = [COLOURS[0] if line[k] >= 0 else COLOURS[1] for k in order]
            bars = axis.barh([ranked.parameters[k] for k in order], line[order], color=colours)
            axis.bar_label(bars, [rounded(float(line[k]), 2, "+") for k in order], padding=3, fontsize=8)
            axis.set_axisbelow(True)
            axis.margins(x=0.16)
            axis.axvline(0.0, color=COLOURS[5], linewidth=0.8)
            axis.set_title(ranked.features[row])
            axis.set_xlabel("change [% per % of the parameter]")
            strongest = ranked.parameters[order[-1]]
            said.append(
                f"{ranked.features[row]} most by {strongest} ({rounded(float(line[order[-1]]), 2, '+')} % per %)"
            )
    if not said:
        return Picture(path.name, title, "No feature has a derivative that is known within 10 %.")
    return Picture(path.name, title, f"Change of each feature per 1 % of each parameter: {'; '.join(said)}.")


def bands(found: Sensitivity, path: Path) -> Picture:
    """Normal forces with what a change of the strongest parameters does to them, to first order; first members only.

    The change of a parameter is the least of ``_CHANGES`` that one can see. A parameter whose verdict is ``not
    differentiable here`` has no band.
    """
    # Of steady motion one turn: over many, a band is as thin as a line.
    turn = found.steady.turn if found.steady is not None and in_steady(found) else 0.0
    part = found.times >= found.times[-1] - 1.0001 * turn if turn else slice(None)
    times = found.times[part]
    scale_t, prefix_t = engineering(times)
    checks = found.certificate.parameters if found.certificate else {}
    meaningful = [name for name in found.wrt if name not in checks or checks[name].verdict != NOT]
    said = []
    several = len(found.force) > 1
    with panels(len(found.force), 2, path, 6.2 if several else 9.5, 3.0 if several else 3.6) as axes:
        for axis, (name, force) in zip(axes, found.force.items(), strict=True):
            pick = (lambda x: x[part, 0, 0]) if force.ndim == 3 else (lambda x: x[part, 0])
            line = pick(force)
            scale, prefix = engineering(line, unit_of(name))
            top = float(np.nanmax(np.abs(line), initial=0.0))
            slopes = {p: found.values[p] * pick(found.derivative[p][name]) for p in meaningful}
            sizes = {p: float(np.max(np.abs(m))) for p, m in slopes.items() if np.isfinite(m).all()}
            shown = []
            for k, p in enumerate(sorted(sizes, key=lambda p: -sizes[p])[:_MOST_BANDS]):
                change = next((c for c in _CHANGES if c * sizes[p] >= _VISIBLE * top), _CHANGES[-1])
                move = np.clip(change * np.abs(slopes[p]), 0.0, 10.0 * top)
                low, high = (line - move) * scale, (line + move) * scale
                text = f"{p} ± {100 * change:g} %"
                axis.fill_between(times * scale_t, low, high, color=COLOURS[k + 1], alpha=0.35, lw=0, label=text)
                shown.append(f"{text}: at most {brief(float(np.max(move)), unit_of(name))}")
            axis.plot(times * scale_t, line * scale, color=COLOURS[0], linewidth=1.2)
            read = is_reading(name)
            called = name if read or force.ndim == 2 else f"{name}_1"
            axis.set_title(called if read else f"{called}: normal force")
            axis.set_xlabel(label("time", "s", prefix_t))
            axis.set_ylabel(label(*quantity_of(name), prefix) if read else label("force", "N", prefix))
            if sizes:
                axis.legend(fontsize=8, loc="best")
            said.append(f"{called}: {', '.join(shown) or 'no derivative'}")
    title = "What a change of a parameter does to the histories"
    when = "over the last turn" if turn else "over the run"
    return Picture(path.name, title, f"Histories with bands {when}, to first order. {'; '.join(said)}.")


def told(found: Sensitivity) -> Told:
    """What the derivatives are worth; per cent of each feature per per cent of each parameter, strongest first."""
    verdict = found.certificate.verdict if found.certificate else "not certified"
    if found.status != "ok":
        return Told("failed", [said(found)])
    rows = ranked_rows(ranking(found), found.sampled)
    wide = [[*row[:5], *(["..."] if len(row) > 5 else [])] for row in rows]
    return Told(verdict, [said(found)], wide, [f"derivatives by {len(found.wrt)} parameter(s) per SI unit"])


def frame(found: Sensitivity) -> tuple[dict[str, Any], str]:
    """A feature and a parameter a row: value, derivative per SI unit, % per %, verdict."""
    checks = found.certificate.parameters if found.certificate else {}
    keys = ("feature", "parameter", "value", "unit", "derivative", "percent_per_percent", "verdict")
    rows: list[tuple[Any, ...]] = []
    for feature, value in found.features.items():
        for name in found.wrt:
            slope = found.feature_derivatives[name][feature]
            share = slope * found.values[name] / value if value else np.nan
            verdict = checks[name].feature_verdicts.get(feature, "") if name in checks else ""
            verdict += ", bound from samples" if verdict and feature in found.sampled else ""
            rows.append((feature, name, value, feature_unit(feature), slope, share, verdict))
    return {key: [row[k] for row in rows] for k, key in enumerate(keys)}, ""


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
    about |= {"verdict": found.certificate.verdict} if found.certificate else {}
    return Dataset(variables, coordinates, about)


def figures(found: Sensitivity) -> dict[str, Callable[[Any], Any]]:
    """Which parameter moves which feature; histories with what 1 % of a parameter does to them."""
    if found.status != "ok":
        return {}
    drawn: dict[str, Callable[[Any], Any]] = {"tornado": partial(tornado, ranking(found))}
    return drawn | ({"bands": partial(bands, found)} if found.derivative else {})
