"""What a trade-off says: its tables, its report, and its results in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.tradeoff import advice as advise
from bcfj_jax.analysis.tradeoff.measures import NAMES, worst
from bcfj_jax.analysis.tradeoff.picture import tradeoff
from bcfj_jax.analysis.tradeoff.settings import MODEL
from bcfj_jax.analysis.tradeoff.study import COLUMNS, NO_TIME, OK, Study
from bcfj_jax.io import outputs, report
from bcfj_jax.io.page import BAD, FAIR, GOOD, Listing, Page, Table, Verdict, brief
from bcfj_jax.io.units import format_si

_AT_REFERENCE = "At the reference: the setting differs from the reference by less than the two reference runs differ."
Rows = Sequence[Sequence[str]]


def write(folder: Path, found: Study, stem: str, known: str) -> str:
    """Write the tables, the picture and the report; the results in words. ``known``: the scene's ``model_form``."""
    advice, doubts = advise.recommended(found), advise.doubts(found.reference)
    outputs.write_csv(folder / "tradeoff.csv", COLUMNS, [[row[name] for name in COLUMNS] for row in found.rows])
    outputs.write_json(folder / "tradeoff.json", as_json(found, advice, doubts))
    chosen, choices, reference, moved = (
        recommended_rows(advice),
        model_rows(found),
        reference_rows(found),
        model_form(found),
    )
    front = _front(sorted((row for row in found.rows if row["pareto"]), key=lambda row: row["wall_s"]))
    pictures = ()
    if any(np.isfinite(worst(row)) for row in found.rows if row["status"] == OK):
        pictures = (tradeoff(found, advice, folder / "tradeoff.png", stem),)
    changes = {one["setting"]: one["change"] for one in advice.values() if one["setting"] and one["change"]}
    blocks = [
        (f"For {budgets}: set this, [accuracy] in place of yours", changes[name].rstrip("\n"))
        for name, budgets in advise.shared(advice).items()
        if name in changes
    ]
    best, model = (
        "Pareto front: no other setting is both faster and more accurate",
        "what other choices of the model change",
    )
    every, nothing = (
        (Table("Every setting, dominated and failed ones too", rows_of(found.rows)),),
        [["setting"], ["none ran"]],
    )
    sections = [
        Table("Recommended settings", chosen),
        *(Listing(head, toml) for head, toml in blocks),
        Table(best, front, _AT_REFERENCE, every) if len(front) > 1 else Table("Pareto front", nothing, "", every),
        *([Table(f"Model form: {model}", choices, moved)] if len(choices) > 1 else []),
        Table("Reference: what errors are measured against", reference),
    ]  # fmt: skip
    title, said = f"Speed and accuracy of {stem}", answer(advice, doubts, found)
    report.write(folder, Page(title, said, pictures, tuple(doubts), tuple(sections), model_form=moved), known)
    parts = [verdict(advice, doubts, found), *([f"Model form: {moved}"] if moved else [])]
    parts += [f"warning: {doubt}" for doubt in doubts]
    heads = ("Recommended settings", f"Model form: {model}", "Reference", "Pareto front, the fastest first")
    tables = zip(heads, (chosen, choices, reference, front), strict=True)
    parts += [f"{head}\n{report.text(rows)}" for head, rows in tables if len(rows) > 1]
    parts += [f"{head}\n{toml}" for head, toml in blocks]
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
        fast, wall = one["times_as_fast_as_given"], format_si(one["wall_s"], "s", 3)
        times, error = f"{fast:.2g} times" if fast else "-", _share(max(one["errors"].values()))
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
    errors = (*NAMES, "derivative_error")
    heads = [name.removesuffix("_error").replace("_", " ") for name in errors]
    table = [["setting", *heads, "time of a run", "compile", "front", "status"]]
    for row in rows:
        status = f"{row['status']} {row['reason']}".strip() + (" (at the reference)" if row["at_reference"] else "")
        walls = (format_si(row[name], "s", 3) for name in ("wall_s", "compile_s"))
        front = "yes" if row["pareto"] else ""
        table.append([row["setting"], *(_share(row[name]) for name in errors), *walls, front, status])
    return table


def _front(rows: Sequence[dict[str, Any]]) -> Rows:
    """The same of the Pareto front, without the columns that say nothing there."""
    table = rows_of(rows)
    said = [any(row[k] not in ("-", "") for row in table[1:]) for k in range(len(table[0]))]
    kept = [k for k, head in enumerate(table[0]) if said[k] and head not in ("compile", "front")]
    return [[row[k] for k in kept] for row in table]


def _share(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{100 * value:.2g} %"
