"""What would explain the miss, as tables for screen and report and as ``diagnosis`` of ``fit.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bcfj_jax.io.units import format_si
from calibration.fit import Fit, Parameter
from calibration.selection.diagnosis import Diagnosis, Trial
from calibration.selection.remedies import ADVICE


def rows(d: Diagnosis) -> list[list[str]]:
    """The table of suspects, those that explain anything."""
    table = [["suspect", "explains, held out", "by chance", "fit with it", "what to do"]]
    for f in d.found:
        if f.explained < 0.01 and not f.named:
            continue
        said = f"{f.explained:.0%}", f"{f.chance:.1g}" if f.chance > 0.0 else "never"
        trial = next((t for t in d.trials if t.names == (f.name,)), None)
        mark = "* " if f.named else ""
        table.append([mark + f.name, *said, _said(trial), ADVICE[f.name] if f.named else ""])
    table += [[" and ".join(t.names), "", "", _said(t), ""] for t in d.trials if len(t.names) > 1]
    return table


def _said(trial: Trial | None) -> str:
    if trial is None:
        return ""
    if trial.fit is None:
        return f"fails: {trial.reason}"
    word = "confirmed" if trial.confirmed else "not confirmed"
    return f"{word}: law {trial.fit.law.answer}, BIC {-trial.gain:+.0f}"


def values(d: Diagnosis, plain: Fit) -> list[list[str]]:
    """Estimates of the plain fit beside those of the fits with suspects."""
    fits = [(" and ".join(t.names), t.fit) for t in d.trials if t.fit is not None]
    names = dict.fromkeys([*plain.parameters, *(n for _, f in fits for n in f.parameters)])
    table = [["parameter", "plain", *(f"with {name}" for name, _ in fits)]]
    for name in names:
        cells = []
        for found in (plain, *(f for _, f in fits)):
            p = found.parameters.get(name)
            cells.append("" if p is None else _value(p))
        table.append([name, *cells])
    return table


def _value(p: Parameter) -> str:
    ends = f" ({format_si(p.ci95[0], p.unit)} to {format_si(p.ci95[1], p.unit)})" if p.ci95 else ""
    return format_si(p.value, p.unit) + ends


def sentence(d: Diagnosis) -> str:
    """What the table comes to."""
    if not d.named:
        return "no suspect explains more of the held-out samples than chance would"
    best = next((t for t in d.trials if t.confirmed), None)
    text = f"{d.named[0]} explains {d.found[0].explained:.0%} of the held-out squares of the residuals"
    if not d.trials:
        return text + ("; run --diagnose to confirm by fits" if d.lines[d.named[0]] else "")
    if best is None:
        return text + "; no fit confirms it"
    return text + f"; a fit with {' and '.join(best.names)} is decisively better, and its law is {best.fit.law.answer}"  # pyright: ignore[reportOptionalMemberAccess]


def _shown_lines(d: Diagnosis) -> list[tuple[str, str]]:
    """Names and lines of what to put in the problem file: of the named suspect, and of a pair that is better still."""
    found = [(name, d.lines[name]) for name in d.named if d.lines[name]]
    return found + [(" and ".join(t.names), t.lines) for t in d.trials if len(t.names) > 1 and t.confirmed]


def as_json(d: Diagnosis, plain: Fit) -> dict[str, Any]:
    """``diagnosis`` of ``fit.json``."""
    return {
        "sentence": sentence(d),
        "named": d.named,
        "suspects": [
            {
                "name": f.name, "explained": f.explained, "chance": f.chance, "values": f.values,
                "named": bool(f.named), "lines": d.lines[f.name], "advice": ADVICE[f.name],
            }
            for f in d.found
        ],
        "fits": [
            {
                "names": list(t.names), "lines": t.lines, "bic_change": -t.gain, "confirmed": t.confirmed,
                "verdict": t.fit.verdict if t.fit else None, "law": t.fit.law.answer if t.fit else None,
                "reason": t.reason or None,
                "parameters": {
                    name: {"value": p.value, "unit": p.unit, "ci95": p.ci95} for name, p in t.fit.parameters.items()
                } if t.fit else {},
            }
            for t in d.trials
        ],
        "plain": {name: {"value": p.value, "unit": p.unit, "ci95": p.ci95} for name, p in plain.parameters.items()},
    }  # fmt: skip


def sections(d: Diagnosis, plain: Fit) -> Sequence[tuple[str, list[list[str]]]]:
    """Headings and tables for screen and report."""
    found = [(f"What would explain the miss: {sentence(d)}", rows(d))] if len(rows(d)) > 1 else []
    if d.trials:
        found.append(("Estimates with each", values(d, plain)))
    for name, text in _shown_lines(d):
        found.append((f"Lines for the problem file: {name}", [["line"], *([line] for line in text.splitlines())]))
    return found or [(f"What would explain the miss: {sentence(d)}", [["suspect"], ["none"]])]
