"""What a finished study says: its report, and its results in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.plausibility import Finding, at, headline, judged
from bcfj_jax.analysis.studies import view
from bcfj_jax.analysis.studies.api import Result
from bcfj_jax.core.progress import stage
from bcfj_jax.io import report
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Table, Verdict, brief, span


def write(result: Result, stem: str) -> str:
    """Pictures and report; the results in words."""
    found, study = result.state, result.study
    absurd = _absurd(result)
    with stage("drawing"):
        drawn = view.overview(result, result.folder)
    report.write(result.folder, page(f"Study {stem}", result, drawn, absurd), study.given.scene.model_form)
    first = [f"At its {place} {headline(findings)}" for place, findings in absurd.items()]
    said = f"{found['finished']} points, {found['failed']} of them failed."
    more = [f"  {text}: {count}" for text, count in found["reasons"].items()]
    rows = [["", "least", "median", "largest"], *ranges(result, study.columns)]
    return "\n".join([*first, said, *more, "", report.text(rows)])


def ranges(result: Result, names: Sequence[str]) -> list[list[str]]:
    """Least, median and largest value of columns over the points that did not fail."""
    good = result.column("status") == "ok"
    units = {feature.name: feature_unit(feature.name) for feature in result.study.features}
    rows = []
    for name in names:
        values = result.column(name)[good]
        values = values[np.isfinite(values)]
        ends = (np.min(values), np.median(values), np.max(values)) if values.size else [float("nan")] * 3
        rows.append([name, *(brief(float(x), units.get(name, "1")) for x in ends)])
    return rows


def _absurd(result: Result) -> dict[str, list[Finding]]:
    """What is not plausible at the points of the least and of the largest value of the first feature, run again alone."""
    study, name = result.study, result.study.features[0].name
    values = np.where(result.column("status") == "ok", result.column(name), np.nan)
    if not np.isfinite(values).any():
        return {}
    found = {}
    for word, k in (("largest", int(np.nanargmax(values))), ("least", int(np.nanargmin(values)))):
        params = {key: float(x[0]) for key, x in study.params(study.points[k : k + 1]).items()}
        times = study.given.times * (study.ends[k] / study.given.times[-1])
        found[f"{word} {name}, point {k},"] = at(study.given.scene, params, times)
    return {place: findings for place, findings in found.items() if findings}


def page(title: str, result: Result, drawn: Sequence[Picture], absurd: Mapping[str, list[Finding]]) -> Page:
    """The report: which parameter moves which feature most, the range of every feature, and points that failed."""
    study = result.study
    rows = [["feature", "least", "median", "largest"], *ranges(result, [f.name for f in study.features])]
    varied = [["parameter", "from", "to"]]
    for name in study.names:
        unit, values = study.given.scene.quantities[name].unit, result.column(name)
        varied.append([name, brief(float(np.min(values)), unit), brief(float(np.max(values)), unit)])
    tables = [Table("Features over all points", rows), Table("What was varied", varied)]
    warnings = ()
    if found := result.failed:
        warnings = (f"{found} of {study.count} points failed; the features do not include them.",)
        reasons = [[text, str(count)] for text, count in result.state["reasons"].items()]
        tables.append(Table("Failures", [["reason", "points"], *reasons]))
    verdict = judged([one for findings in absurd.values() for one in findings], _answer(result))
    return Page(title, verdict, tuple(drawn), warnings, tuple(tables))


def _answer(result: Result) -> Verdict:
    """Which parameter moves which feature most, by the range of the feature over its median.

    With several parameters the one whose ranks correlate most with the feature's (Spearman).
    """
    study, good = result.study, result.column("status") == "ok"
    count = f"{study.count} points"
    if not good.any():
        return Verdict(BAD, "Failed", f"None of {count} has a result.")
    best, feature = -1.0, None
    for one in study.features:
        values = result.column(one.name)[good]
        middle = float(np.nanmedian(np.abs(values))) if np.isfinite(values).any() else 0.0
        spread = float(np.nanmax(values) - np.nanmin(values)) / middle if middle > 0 else -1.0
        if spread > best:
            best, feature = spread, one.name
    kind, word = (FAIR, "Finished, with failures") if result.failed else (GOOD, "Finished")
    if feature is None:
        return Verdict(kind, word, f"{count}; no feature has a value.")
    values = result.column(feature)[good]
    extent = span(values, feature_unit(feature))
    if view.together(result):
        name = " and ".join(study.names)
    else:
        name = max(study.names, key=lambda n: _rank_correlation(result.column(n)[good], values))
    what = "move" if " and " in name else "moves"
    return Verdict(kind, word, f"{name} {what} {feature} most: {extent} over {count}.")


def _rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Size of Spearman's coefficient; 0 where one does not vary."""
    from scipy.stats import spearmanr

    x, y = (v[np.isfinite(x) & np.isfinite(y)] for v in (x, y))
    if x.size < 2 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return abs(float(spearmanr(x, y)[0]))  # pyright: ignore[reportArgumentType]
