"""``bcfj tradeoff``: the study of a scene in a folder and in tables; it goes on where it was cut off."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.tradeoff import advice as advise
from bcfj_jax.analysis.tradeoff.measures import NAMES, worst
from bcfj_jax.analysis.tradeoff.picture import tradeoff
from bcfj_jax.analysis.tradeoff.settings import MODEL, settings
from bcfj_jax.analysis.tradeoff.study import COLUMNS, NO_TIME, OK, Study, study
from bcfj_jax.io import outputs, report
from bcfj_jax.io.journal import NAME as JOURNAL
from bcfj_jax.io.journal import Journal, key_of
from bcfj_jax.io.page import BAD, FAIR, GOOD, Listing, Page, Table, Verdict, brief
from bcfj_jax.io.scenefile import load, shown
from bcfj_jax.io.stop import heeded
from bcfj_jax.io.units import format_si

DONE, FAILED, INTERRUPTED = 0, 3, 5
FILES = ("tradeoff.csv", "tradeoff.json", "tradeoff.png", *report.FILES, "run.toml", "environment.json")
# What tables, pictures and report take of the budget [s], at most a quarter of it.
_REPORT_S = 4.0
_AT_REFERENCE = "At the reference: the setting differs from the reference by less than the two reference runs differ."
Rows = Sequence[Sequence[str]]


def run(
    what: str, only: Sequence[str], derivatives: bool, budget: float, out: Path | None, say: Callable[[str], None]
) -> tuple[str, int]:
    """Study a scene file, or go on with a study that its folder holds the journal of.

    Args:
        what: a scene file, or a built-in scene's name.
        only, derivatives: as ``settings.settings``.
        budget: seconds for this call.
        out: folder for the results, None for one made up.
        say: receives the progress.

    Returns:
        The results in words, and the exit code of the contract.

    Raises:
        InputError: for bad input, and where something would be overwritten.
    """
    begin_s = time.monotonic()
    given = shown(load(what))
    todo = settings(given, only, derivatives)
    stem = given.source.stem if given.source else what
    folder = outputs.open_folder(out, "tradeoff", stem, FILES, goes_on=JOURNAL)
    known = outputs.environment(data=[given.source] if given.source else [])
    key = key_of("tradeoff", given.resolved, derivatives, known["packages"], known["device"])
    with heeded(), Journal(folder, key) as journal:
        if journal.resumed:
            say(f"going on in {folder}: {len(journal)} pieces are finished")
        spent = time.monotonic() - begin_s + min(_REPORT_S, 0.25 * budget)
        found = study(given, todo, journal, max(budget - spent, 0.0), say)
    options = {"only": list(only), "derivatives": derivatives, "budget": budget}
    outputs.write_toml(folder / "run.toml", {**given.resolved, "tradeoff": options}, f"{what}, every default, SI")
    outputs.write_json(folder / "environment.json", known)
    text = write(folder, found, stem, given.scene.model_form)
    if found.interrupted:
        say(f"interrupted; go on with: bcfj tradeoff {what} --out {folder}")
        return text, INTERRUPTED
    return text, DONE if found.reference and found.reference.truth else FAILED


def write(folder: Path, found: Study, stem: str, known: str) -> str:
    """Write the tables, the picture and the report; the results in words. ``known``: the scene's ``model_form``."""
    advice, doubts = advise.recommended(found), advise.doubts(found.reference)
    outputs.write_csv(folder / "tradeoff.csv", COLUMNS, [[row[name] for name in COLUMNS] for row in found.rows])
    outputs.write_json(folder / "tradeoff.json", as_json(found, advice, doubts))
    chosen = recommended_rows(advice)
    front = sorted((row for row in found.rows if row["pareto"]), key=lambda row: row["wall_s"])
    choices, moved = model_rows(found), model_form(found)
    said = verdict(advice, doubts, found)
    tables: list[tuple[str, Rows]] = [("Recommended settings", chosen)]
    tables += [("Model form: what other choices of the model change", choices)]
    tables += [("Reference", reference_rows(found)), ("Pareto front, the fastest first", _front(front))]
    pictures = []
    if any(np.isfinite(worst(row)) for row in found.rows if row["status"] == OK):
        pictures.append(tradeoff(found, advice, folder / "tradeoff.png", stem))
    changes = {one["setting"]: one["change"] for one in advice.values() if one["setting"] and one["change"]}
    blocks = [
        (f"For {budgets}: set this, [accuracy] in place of yours", [["TOML"], *([x] for x in toml.splitlines())])
        for name, budgets in advise.shared(advice).items()
        if (toml := changes.get(name))
    ]
    every = Table("Every setting, dominated and failed ones too", rows_of(found.rows))
    sections = [
        Table("Recommended settings", chosen),
        *(Listing(head, "\n".join(row[0] for row in rows[1:])) for head, rows in blocks),
        Table("Pareto front: no other setting is both faster and more accurate", _front(front), _AT_REFERENCE, (every,))
        if front
        else Table("Pareto front", [["setting"], ["none ran"]], "", (every,)),
        *([Table("Model form: what other choices of the model change", choices, moved)] if len(choices) > 1 else []),
        Table("Reference: what errors are measured against", reference_rows(found)),
    ]
    page = Page(
        f"Speed and accuracy of {stem}", answer(advice, doubts, found), tuple(pictures), tuple(doubts), tuple(sections),
        model_form=moved,
    )  # fmt: skip
    report.write(folder, page, known)
    parts = [said, *([f"Model form: {moved}"] if moved else []), *(f"warning: {doubt}" for doubt in doubts)]
    parts += [f"{head}\n{report.text(rows)}" for head, rows in tables if len(rows) > 1]
    parts += [f"{head}\n" + "\n".join(row[0] for row in rows[1:]) for head, rows in blocks]
    return "\n\n".join([*parts, f"every setting, whole scene files to paste, pictures: {folder}"])


def as_json(found: Study, advice: dict[str, Any], doubts: list[str]) -> dict[str, Any]:
    """``tradeoff.json``: status and reasons, the reference's certificate, what is recommended, every setting."""
    certificate = found.reference.certificate if found.reference else {"status": "not run"}
    status = "interrupted" if found.interrupted else "ok" if certificate["status"] == "ok" else "failed"
    expected = advise.expected(found)
    return {
        "status": status,
        "reasons": doubts,
        "reference": certificate,
        "safety": advise.SAFETY,
        "recommended": advice,
        "settings": [
            row | {"expected_error": error, "physics": setting.physics, "change": setting.change}
            for row, setting, error in zip(found.rows, found.settings, expected, strict=True)
        ],
    }


def answer(advice: dict[str, Any], doubts: list[str], found: Study) -> Verdict:
    """The recommended setting for each error budget."""
    walls = {one["setting"]: one["wall_s"] for one in advice.values() if one["setting"]}
    if not walls:
        return Verdict(BAD, "No setting", verdict(advice, doubts, found))
    parts = [
        f"for {budgets}: {name}, {brief(walls[name], 's')} a run" for name, budgets in advise.shared(advice).items()
    ]
    kind, word = (FAIR, "Recommended, with doubts") if doubts else (GOOD, "Recommended")
    if found.interrupted:
        kind, word = FAIR, "Interrupted; recommended so far"
    return Verdict(kind, word, f"{'; '.join(parts)}.")


def verdict(advice: dict[str, Any], doubts: list[str], found: Study) -> str:
    """The result in a sentence."""
    walls = {one["setting"]: one["wall_s"] for one in advice.values() if one["setting"]}
    ran = sum(row["status"] == OK for row in found.rows)
    out = sum(row["status"] == NO_TIME for row in found.rows)
    head = f"{ran} of {len(found.rows)} settings ran{f'; the budget left out {out}' if out else ''}."
    if not walls:
        return f"{head} No setting is recommended: {doubts[0] if doubts else 'none keeps a budget'}."
    parts = [f"for {b}: {name}, {format_si(walls[name], 's', 3)}" for name, b in advise.shared(advice).items()]
    return f"{head} The cheapest {'; '.join(parts)}."


def recommended_rows(advice: dict[str, Any]) -> Rows:
    """Table of what to take for which budget."""
    rows = [["budget", "setting", "time of a run", "faster than given", "worst error", "model"]]
    for budget, one in advice.items():
        if not one["setting"]:
            rows.append([budget, "-", "-", "-", "-", one["reason"]])
            continue
        fast = one["times_as_fast_as_given"]
        rows.append(
            [
                budget,
                one["setting"],
                format_si(one["wall_s"], "s", 3),
                f"{fast:.2g} times" if fast else "-",
                _share(max(one["errors"].values())),
                one["physics"],
            ]
        )
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
    rows += [[f"differ by: {name.replace('_', ' ')}", _share(certificate["errors"][name])] for name in NAMES]
    slopes = certificate["derivatives"]
    if slopes["methods"]:
        rows.append(["derivatives by", ", ".join(slopes["parameters"])])
        rows.append([f"{' and '.join(m['solver'] for m in slopes['methods'])} differ by", _share(slopes["error"])])
    return rows


def model_rows(found: Study) -> Rows:
    """Table of other choices of the model, what moves forces most first: each against the scene as given."""
    every = zip(found.settings, found.rows, strict=True)
    rows: list[dict[str, Any]] = [row | {"physics": s.physics} for s, row in every if s.group == MODEL]
    own = found.rows[0]["wall_s"]
    rows.sort(key=lambda row: -abs(row["peak_change"]) if np.isfinite(row["peak_change"]) else 1.0)
    head = [["choice", "largest change of a peak", "force rms", "wall", "what differs", "status"]]
    for row in rows:
        change = f"{row['contact']} {100 * row['peak_change']:+.2g} %" if np.isfinite(row["peak_change"]) else "-"
        times = row["wall_s"] / own if own else float("nan")
        wall = f"{times:.2g} times" if np.isfinite(times) else "-"
        status = f"{row['status']} {row['reason']}".strip()
        head.append([row["setting"], change, _share(row["force_rms_error"]), wall, row["physics"], status])
    return head


def model_form(found: Study) -> str:
    """How far other choices of the model moved the scene's peaks, in a sentence; "" where none was run."""
    rows = [row for row in found.rows if row["group"] == MODEL and np.isfinite(row["peak_change"])]
    if not rows:
        return ""
    most = max(rows, key=lambda row: abs(row["peak_change"]))
    return (
        f"{len(rows)} other choices of the model were run beside the given one. They move a peak by up to "
        f"{100 * abs(most['peak_change']):.2g} % ({most['setting']}: {most['contact']} {100 * most['peak_change']:+.2g} %). "
        "The errors in the other tables are those of the computation."
    )


def rows_of(rows: Sequence[dict[str, Any]]) -> Rows:
    """Table of settings."""
    head = [["setting", *(name.removesuffix("_error").replace("_", " ") for name in (*NAMES, "derivative_error"))]]
    head[0] += ["time of a run", "compile", "front", "status"]
    for row in rows:
        status = f"{row['status']} {row['reason']}".strip()
        head.append(
            [
                row["setting"],
                *(_share(row[name]) for name in (*NAMES, "derivative_error")),
                format_si(row["wall_s"], "s", 3),
                format_si(row["compile_s"], "s", 3),
                "yes" if row["pareto"] else "",
                f"{status} (at the reference)" if row["at_reference"] else status,
            ]
        )
    return head


def _front(rows: Sequence[dict[str, Any]]) -> Rows:
    """The same of the Pareto front, without the columns that say nothing there."""
    table = rows_of(rows)
    said = [any(row[k] not in ("-", "") for row in table[1:]) for k in range(len(table[0]))]
    kept = [k for k, head in enumerate(table[0]) if said[k] and head not in ("compile", "front")]
    return [[row[k] for k in kept] for row in table]


def _share(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{100 * value:.2g} %"
