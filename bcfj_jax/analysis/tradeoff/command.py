"""``bcfj tradeoff``: the study of a scene in a folder, which goes on where it was cut off; its tables, picture and report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.tradeoff import advice as advise
from bcfj_jax.analysis.tradeoff.measures import NAMES, worst
from bcfj_jax.analysis.tradeoff.settings import MODEL, settings
from bcfj_jax.analysis.tradeoff.study import COLUMNS, NO_TIME, OK, Study, study
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import percent, rounded
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.growing import COMPLETE, Growing
from bcfj_jax.io.journal import NAME as JOURNAL
from bcfj_jax.io.journal import Journal, key_of
from bcfj_jax.io.page import BAD, FAIR, GOOD, Listing, Page, Picture, Rows, Table, Verdict, brief, span
from bcfj_jax.io.scenefile import load, shown
from bcfj_jax.io.stop import heeded
from bcfj_jax.io.units import format_si

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DONE, FAILED, INTERRUPTED = 0, 3, 5
FILES = ("tradeoff.csv", "tradeoff.json", "tradeoff.png", *report.FILES, "run.toml", "environment.json")
# What tables, pictures and report take of the budget [s], at most a quarter of it.
_REPORT_S = 4.0
# Stages of tradeoff.json; while rows come it is written again after so long [s].
OWN, ROWS, _EVERY_S = "not compared yet", "settings left", 5.0
_CUT = "interrupted"
_AT_REFERENCE = "At the reference: the setting differs from the reference by less than the two reference runs differ."
_MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
# Errors above have lost the motion; they are drawn at the edge.
_TOP, _LEAST = 10.0, 1e-12


class Wanted(NamedTuple):
    """What is tried (``only``, ``derivatives``: as ``settings.settings``), and the seconds for this call."""

    only: Sequence[str]
    derivatives: bool
    budget: float


def run(
    what: str, wanted: Wanted, out: Path | None, say: Callable[[str], None], show: Callable[[str], None]
) -> tuple[str, int]:
    """Study a scene file, or go on with a study that its folder holds the journal of; in words, and the exit code.

    ``say`` receives the progress, ``show`` what is known before all is.
    """
    begin_s = time.monotonic()
    given, budget = shown(load(what)), wanted.budget
    todo = settings(given, wanted.only, wanted.derivatives)
    stem = given.source.stem if given.source else what
    folder = outputs.open_folder(out, stem, outputs.Claim("tradeoff", FILES, goes_on=JOURNAL))
    known = outputs.environment(data=given.sources)
    key = key_of("tradeoff", given.resolved, wanted.derivatives, known["packages"], known["device"])
    growing, next_s = Growing(folder / "tradeoff.json", show), 0.0

    def told(found: Study) -> None:
        """Show what is new, and write it from time to time."""
        nonlocal next_s
        new = growing.new(so_far(found))
        if found.reference is None:
            new.append("Not compared yet: two tight methods that agree, the reference, come next.\n")
        if new:
            show("\n".join(new))
        if found.reference is None or time.monotonic() > next_s:
            write_tables(growing, ROWS if found.reference else OWN, found)
            next_s = time.monotonic() + _EVERY_S * bool(found.reference)

    plots.get_ready()
    with heeded(), Journal(folder, key) as journal:
        if journal.resumed:
            say(f"going on in {folder}: {len(journal)} pieces are finished")
        spent = time.monotonic() - begin_s + min(_REPORT_S, 0.25 * budget)
        found = study(given, todo, journal, max(budget - spent, 0.0), say, told)
    options = {**wanted._asdict(), "only": list(wanted.only)}
    outputs.write_origin(folder, {**given.resolved, "tradeoff": options}, f"{what}, every default, SI", known)
    with stage("drawing"):
        text = write(growing, found, stem, given.scene.model_form)
    if found.interrupted:
        say(f"interrupted; go on with: bcfj tradeoff {what} --out {folder}")
        return text, INTERRUPTED
    return text, DONE if found.reference and found.reference.truth else FAILED


def write_tables(growing: Growing, stage: str, found: Study) -> tuple[dict[str, Any], list[str]]:
    """Write ``tradeoff.csv`` and ``tradeoff.json``; the advice in it, and the doubts."""
    advice, doubts = advise.recommended(found), advise.doubts(found.reference)
    rows = [[row[name] for name in COLUMNS] for row in found.rows]
    outputs.write_csv(growing.path.with_name("tradeoff.csv"), COLUMNS, rows)
    growing.write(stage, as_json(found, advice, doubts))
    return advice, doubts


def so_far(found: Study) -> list[str]:
    """What is known of the settings, a paragraph for the scene's own run and a line a finished row."""
    own, parts = found.rows[0], []
    if found.peaks:
        peaks = ", ".join(f"{name} {brief(peak, 'N')}" for name, peak in found.peaks.items())
        cost = f"{own['setting']}: {format_si(own['wall_s'], 's', 3)} a run, {own['steps']} steps"
        parts = [f"{cost}; largest normal force: {peaks}"]
    for k, row in enumerate(found.rows, 1):
        said = f"worst error {worst(row):.1e}, {row['wall_s']:.3g} s" if row["status"] == OK else _status(row)
        parts += [] if row["status"].startswith("not ") else [f"[{k}/{len(found.rows)}] {row['setting']}: {said}"]
    return parts


def _status(row: Mapping[str, Any]) -> str:
    return f"{row['status']} {row['reason']}".strip()


def write(growing: Growing, found: Study, stem: str, known: str) -> str:
    """Write the tables, the picture and the report; the results in words. ``known``: the scene's ``model_form``."""
    folder = growing.path.parent
    advice, doubts = write_tables(growing, _CUT if found.interrupted else COMPLETE, found)
    moved = model_form(found)
    front = _front(sorted((row for row in found.rows if row["pareto"]), key=lambda row: row["wall_s"]))
    pictures = ()
    if any(np.isfinite(worst(row)) for row in found.rows if row["status"] == OK):
        pictures = (picture(found, advice, folder / "tradeoff.png", stem),)
    blocks = [
        Listing(f"For {budgets}: set this, [accuracy] in place of yours", one["change"].rstrip("\n"))
        for one, budgets in advise.shared(advice)
        if one["change"]
    ]
    chosen = Table("Recommended settings", recommended_rows(advice))
    choices = Table("Model form: what other choices of the model change", model_rows(found), moved)
    reference = Table("Reference: what errors are measured against", reference_rows(found))
    every = (Table("Every setting, dominated and failed ones too", rows_of(found.rows)),)
    best = Table("Pareto front: no other setting is both faster and more accurate", front, _AT_REFERENCE, every)
    best = best if len(front) > 1 else Table("Pareto front", [["setting"], ["none ran"]], "", every)
    sections = (chosen, *blocks, best, *([choices] if len(choices.rows) > 1 else []), reference)
    title, said = f"Speed and accuracy of {stem}", answer(advice, doubts, found)
    report.write(folder, Page(title, said, pictures, tuple(doubts), sections, model_form=moved), known)
    parts = [verdict(advice, doubts, found), *([f"Model form: {moved}"] if moved else [])]
    parts += [f"warning: {doubt}" for doubt in doubts]
    tables = (chosen.title, chosen.rows), (choices.title, choices.rows), ("Reference", reference.rows)
    tables = (*tables, ("Pareto front, the fastest first", front))
    parts += [f"{head}\n{report.text(rows)}" for head, rows in tables if len(rows) > 1]
    parts += [f"{block.title}\n{block.text}" for block in blocks]
    return "\n\n".join([*parts, f"every setting, whole scene files to paste, pictures: {folder}"])


def as_json(found: Study, advice: dict[str, Any], doubts: list[str]) -> dict[str, Any]:
    """``tradeoff.json``: status and reasons, the reference's certificate, what is recommended, every setting."""
    certificate = found.reference.certificate if found.reference else {"status": "not run"}
    status = "interrupted" if found.interrupted else "ok" if certificate["status"] == "ok" else "failed"
    rows = [
        row | {"expected_error": error, "physics": setting.physics, "change": setting.change}
        for row, setting, error in zip(found.rows, found.settings, advise.expected(found), strict=True)
    ]
    head = {"status": status, "reasons": doubts, "peaks": found.peaks, "reference": certificate}
    return head | {"safety": advise.SAFETY, "recommended": advice, "settings": rows}


def answer(advice: dict[str, Any], doubts: list[str], found: Study) -> Verdict:
    """The recommended setting for each error budget."""
    parts = [f"for {b}: {one['setting']}, {brief(one['wall_s'], 's')} a run" for one, b in advise.shared(advice)]
    if not parts:
        return Verdict(BAD, "No setting", verdict(advice, doubts, found))
    word = "Interrupted; recommended so far" if found.interrupted else f"Recommended{', with doubts' if doubts else ''}"
    return Verdict(FAIR if found.interrupted or doubts else GOOD, word, f"{'; '.join(parts)}.")


def verdict(advice: dict[str, Any], doubts: list[str], found: Study) -> str:
    """The result in a sentence."""
    states = [row["status"] for row in found.rows]
    out = states.count(NO_TIME)
    head = f"{states.count(OK)} of {len(states)} settings ran{f'; the budget left out {out}' if out else ''}."
    parts = [f"for {b}: {one['setting']}, {format_si(one['wall_s'], 's', 3)}" for one, b in advise.shared(advice)]
    if not parts:
        return f"{head} No setting is recommended: {doubts[0] if doubts else 'none keeps a budget'}."
    return f"{head} The cheapest {'; '.join(parts)}."


def recommended_rows(advice: dict[str, Any]) -> Rows:
    """Table of what to take for which budget."""
    rows = [["budget", "setting", "time of a run", "faster than given", "worst error", "model"]]
    for budget, one in advice.items():
        if not one["setting"]:
            rows.append([budget, "-", "-", "-", "-", one["reason"]])
            continue
        fast, wall = one["times_as_fast_as_given"], format_si(one["wall_s"], "s", 3)
        times, error = f"{rounded(fast)} times" if fast else "-", percent(max(one["errors"].values()), 2)
        rows.append([budget, one["setting"], wall, times, error, one["physics"]])
    return rows


def reference_rows(found: Study) -> Rows:
    """Table of the reference: its methods, and by how much they differ."""
    if found.reference is None or found.reference.truth is None:
        return [["reference", "none"]]
    certificate = found.reference.certificate
    rows = [["reference", "value"]]
    for method in certificate["methods"]:
        asked = method["force_error"]
        how = f"force error {asked:g}, " if asked is not None and np.isfinite(asked) else ""
        rows.append([method["solver"], f"{how}{method['steps']} steps, {format_si(method['wall_s'], 's', 3)}"])
    rows += [[f"differ by: {name.replace('_', ' ')}", percent(certificate["errors"][name], 2)] for name in NAMES]
    slopes = certificate["derivatives"]
    if slopes["methods"]:
        rows.append(["derivatives by", ", ".join(slopes["parameters"])])
        rows.append([f"{' and '.join(m['solver'] for m in slopes['methods'])} differ by", percent(slopes["error"], 2)])
    return rows


def model_rows(found: Study) -> Rows:
    """Table of other choices of the model, what moves forces most first: each against the scene as given."""
    every = zip(found.settings, found.rows, strict=True)
    rows: list[dict[str, Any]] = [row | {"physics": s.physics} for s, row in every if s.group == MODEL]
    own = found.rows[0]["wall_s"]
    rows.sort(key=lambda row: -abs(row["peak_change"]) if np.isfinite(row["peak_change"]) else 1.0)
    head = [["choice", "largest change of a peak", "force rms", "wall", "what differs", "status"]]
    for row in rows:
        change = f"{row['contact']} {percent(row['peak_change'], 2, '+')}" if np.isfinite(row["peak_change"]) else "-"
        times = row["wall_s"] / own if own else float("nan")
        wall = f"{rounded(times)} times" if np.isfinite(times) else "-"
        head.append([row["setting"], change, percent(row["force_rms_error"], 2), wall, row["physics"], _status(row)])
    return head


def model_form(found: Study) -> str:
    """How far other choices of the model moved the scene's peaks, in a sentence; "" where none was run."""
    rows = [row for row in found.rows if row["group"] == MODEL and np.isfinite(row["peak_change"])]
    if not rows:
        return ""
    most = max(rows, key=lambda row: abs(row["peak_change"]))
    return (
        f"{len(rows)} other choices of the model were run beside the given one. They move a peak by up to "
        f"{percent(abs(most['peak_change']), 2)} ({most['setting']}: {most['contact']} {percent(most['peak_change'], 2, '+')}). "
        "The errors in the other tables are those of the computation."
    )


def rows_of(rows: Sequence[dict[str, Any]]) -> Rows:
    """Table of settings."""
    errors = (*NAMES, "derivative_error")
    heads = [name.removesuffix("_error").replace("_", " ") for name in errors]
    table = [["setting", *heads, "time of a run", "compile", "front", "status"]]
    for row in rows:
        status = _status(row) + (" (at the reference)" if row["at_reference"] else "")
        walls = (format_si(row[name], "s", 3) for name in ("wall_s", "compile_s"))
        front = "yes" if row["pareto"] else ""
        table.append([row["setting"], *(percent(row[name], 2) for name in errors), *walls, front, status])
    return table


def _front(rows: Sequence[dict[str, Any]]) -> Rows:
    """The same of the Pareto front, without the columns that say nothing there."""
    table = rows_of(rows)
    said = [any(row[k] not in ("-", "") for row in table[1:]) for k in range(len(table[0]))]
    kept = [k for k, head in enumerate(table[0]) if said[k] and head not in ("compile", "front")]
    return [[row[k] for k in kept] for row in table]


def picture(study: Study, advice: Mapping[str, Mapping[str, Any]], path: Path, title: str) -> Picture:
    """Work-precision: one panel of values, one of derivatives where there are any."""
    known = {row["setting"]: worst(row) for row in study.rows if row["status"] == OK}
    walls = {row["setting"]: row["wall_s"] for row in study.rows if row["status"] == OK}
    slopes = {row["setting"]: row["derivative_error"] for row in study.rows if np.isfinite(row["derivative_error"])}
    truth, chosen = study.reference, advise.shared(advice)
    with plots.sheet(path, 1, 2 if slopes else 1, width=12.5 if slopes else 8.0, height=5.4) as axes:
        least_error = truth.least_error if truth else float("nan")
        _panel(axes[0], study, walls, known, least_error)
        best = sorted((row["wall_s"], known[row["setting"]]) for row in study.rows if row["pareto"])
        if best:
            x, y = np.array(best).T
            y = np.minimum(np.maximum(y, least_error if least_error > 0 else 0.0), _TOP)
            axes[0].step(x, y, where="post", color="#222222", linewidth=2.2, alpha=0.35, label="Pareto front", zorder=0)
        # Rings round recommended settings, with the budgets they are for.
        for number, (one, budgets) in enumerate(chosen):
            place = (walls[one["setting"]], max(known[one["setting"]], _LEAST))
            label = "recommended, with the budgets it keeps" if not number else None
            axes[0].plot(*place, "o", markersize=12, markerfacecolor="none", markeredgecolor="#b84e00", label=label)
            axes[0].annotate(budgets, place, (9, 7), textcoords="offset points", fontsize=8, color="#b84e00")
        axes[0].set(title=f"{plots.plain(title)}: worst of force rms, peak and impulse", ylabel="error [-]")
        axes[0].legend(fontsize=7.5, loc="upper left", bbox_to_anchor=(0.0, -0.13), ncols=4)
        if slopes:
            spent = {row["setting"]: row["derivative_wall_s"] for row in study.rows}
            _panel(axes[1], study, spent, slopes, truth.least_slope_error if truth else float("nan"))
            axes[1].set(title="derivatives of the forces, rms", ylabel="error of derivatives [-]")
    named = [(one["setting"], budgets) for one, budgets in chosen if one["setting"] in known]
    rings = [f"{name} ({span([known[name]])}) for {budgets}" for name, budgets in named]
    shows = f"Worst error against wall time of {len(known)} settings"
    shows += f"; recommended, with their error as a share: {'; '.join(rings)}." if rings else "; none is recommended."
    return Picture(path.name, "Error against time", shows)


def _panel(
    axis: Axes, study: Study, walls: Mapping[str, float], errors: Mapping[str, float], least_error: float
) -> None:
    """Ladders of solvers as lines, other settings by what they set."""
    kinds: dict[str, list[str]] = {}
    for setting in study.settings:
        if np.isfinite(errors.get(setting.name, np.nan)):
            kind = setting.ladder if setting.group == "tolerance" else setting.group
            kinds.setdefault(kind, []).append(setting.name)
    solvers = {setting.ladder for setting in study.settings if setting.group == "tolerance"}
    for number, (kind, names) in enumerate(sorted(kinds.items(), key=lambda item: item[0] not in solvers)):
        x, y = np.array([walls[n] for n in names]), np.clip([errors[n] for n in names], _LEAST, _TOP)
        look: dict[str, Any] = {
            "color": plots.COLOURS[number % len(plots.COLOURS)],
            "linestyle": "-" if kind in solvers else "none",
        }
        mark = _MARKS[number % len(_MARKS)]
        axis.plot(x, y, marker=mark, label=kind, markersize=4.5, linewidth=0.7, alpha=0.85, **look)
    axis.set(xscale="log", yscale="log", xlabel="wall time of a run, compiled [s]")
    low, high = axis.get_ylim()
    if least_error > 0:
        low = min(low, least_error / 3.0)
        axis.axhspan(low, least_error, color="#9a9a9a", alpha=0.18, linewidth=0)
        inside = {"transform": axis.get_yaxis_transform(), "fontsize": 7.5, "color": "#555555"}
        axis.text(0.99, least_error, "below: not distinguished by the reference", ha="right", va="top", **inside)
    axis.set_ylim(low, high)
