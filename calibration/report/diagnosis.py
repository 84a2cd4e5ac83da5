"""What would explain the miss, as tables for screen and report and as ``diagnosis`` of ``fit.json``."""

from __future__ import annotations

from typing import Any

from bcfj_jax.io.page import bounded
from calibration.fit import Fit, Parameter
from calibration.selection import agreement
from calibration.selection.choice import DECISIVE
from calibration.selection.diagnosis import SEEN, Diagnosis, Trial
from calibration.selection.remedies import ADVICE
from calibration.uncertainty.estimates import briefly

# A suspect that explains less and is not named is not shown.
_LEAST = 0.01


def rows(d: Diagnosis) -> list[list[str]]:
    """The table of suspects, those that explain anything."""
    table = [["suspect", "explains, held out", "by chance", "fit with it", "what to do"]]
    for f in d.found:
        if f.explained < _LEAST and not f.named:
            continue
        trial = next((t for t in d.trials if t.names == (f.name,)), None)
        seen = "seen in the readings" if f.name in SEEN and f.named else _said(trial)
        chance = "" if f.name in SEEN else f"{f.chance:.1g}"
        advice = ADVICE[f.name] if f.name in d.named else ""
        table.append([("* " if f.named else "") + f.name, f"{f.explained:.0%}", chance, seen, advice])
    return table + [[t.label, "", "", _said(t), ""] for t in d.trials if len(t.names) > 1 or t.law]


def _said(trial: Trial | None) -> str:
    if trial is None:
        return ""
    if trial.fit is None:
        return f"fails: {trial.reason}"
    word = "confirmed" if trial.confirmed else "not confirmed"
    search = "" if trial.fit.search.answer == "converged" else ", search not converged"
    return f"{word}: law {trial.fit.law.answer}, BIC {-trial.gain:+.0f}{search}"


def values(d: Diagnosis, plain: Fit) -> list[list[str]]:
    """Estimates of the plain fit beside those of the fits with suspects."""
    fits = [(t.law or t.label, t.fit) for t in d.trials if t.fit is not None]
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
    ends = f" ({' to '.join(bounded(p.ci95, p.ci95, p.unit))}, {p.headline})" if p.ci95 else ""
    return bounded([p.value], p.ci95 or (), p.unit)[0] + ends


def sentence(d: Diagnosis) -> str:
    """What the table comes to."""
    if not d.named:
        return "no suspect explains more of the held-out samples than chance would"
    first, *others = d.named
    text = f"{first} explains {d.found[0].explained:.0%} of the held-out squares of the residuals"
    if first in SEEN:
        return f"{text}: it is seen in the readings"
    if not d.trials:
        return f"{text}; run --diagnose to confirm by fits"
    best = next((t for t in d.trials if t.confirmed and t.fit), None)
    if best is None:
        return f"{text}{_laws(d) if d.trials[0].law else '; no fit confirms it'}"
    text += _laws(d) if best.law else ""
    if alone := d.alone[0].fit:
        text += f"; the fit with {best.law or 'it'} is decisively better, and the law is {alone.law.answer} then"
    pair = next((t for t in d.trials if len(t.names) > 1 and t.confirmed), None)
    text += f"; {' and '.join(pair.names)} together explain more" if pair and pair.gain > best.gain + DECISIVE else ""
    return text + (f"; the data do not distinguish it from {' or '.join(others)}" if others else "")


def _laws(d: Diagnosis) -> str:
    """What the fits with other laws of loss come to."""
    tried = [t for t in d.trials if t.law and t.fit]
    good = [t.law for t in tried if t.fit and t.fit.law.answer == "consistent"]
    return f"; the law {' or '.join(good)} explains it" if good else f"; none of {len(tried)} other laws explains it"


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
                "names": list(t.names), "with_law": t.law or None, "lines": t.lines,
                "bic_change": -t.gain, "confirmed": t.confirmed,
                "verdict": t.fit.verdict if t.fit else None, "law": t.fit.law.answer if t.fit else None,
                "reason": t.reason or None, "parameters": briefly(t.fit.parameters) if t.fit else {},
            }
            for t in d.trials
        ],
        "plain": briefly(plain.parameters),
    }  # fmt: skip


def sections(d: Diagnosis, plain: Fit) -> list[tuple[str, list[list[str]]]]:
    """Headings and tables for screen and report; what to put in the problem file, of a pair that is better still, too."""
    head, table = f"What would explain the miss: {sentence(d)}", rows(d)
    found = [(head, table)] if len(table) > 1 else []
    if d.agreed:
        found.append((agreement.heading(d.agreed), agreement.rows(d.agreed)))
    if d.trials:
        found.append(("Estimates with each, their 95 % intervals and the kinds that these are", values(d, plain)))
    lines = [(name, d.lines[name]) for name in d.named if d.lines[name]]
    lines += [(" and ".join(t.names), t.lines) for t in d.trials if len(t.names) > 1 and t.confirmed]
    for name, text in lines:
        found.append(("Lines for the problem file", [[f"# {name}"], *([line] for line in text.splitlines())]))
    return found or [(head, [["suspect"], ["none"]])]
