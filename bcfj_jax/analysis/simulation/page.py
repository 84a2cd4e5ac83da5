"""The report of a run: highest force and its error, tables by contact, pictures by what the model has."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis import balance, features
from bcfj_jax.analysis.plausibility import Finding, headline, judged
from bcfj_jax.analysis.simulation import pictures, views
from bcfj_jax.analysis.simulation.views import Turning
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import percent
from bcfj_jax.io import report
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Rows, Table, Verdict, brief, span
from bcfj_jax.io.units import engineering
from bcfj_jax.mechanism.channels import Channel
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.mechanism.readings import STATES
from bcfj_jax.solve.simulation import Run

FORCES, LOOPS, READINGS = "forces.png", "force_penetration.png", "readings.png"
AROUND, ORBITS, STATE = "loads_around_axis.png", "clearance_circle.png", "contact_states.png"
CHAIN = "loads_along.png"
ORDERS = "order_spectrum.png"
# Of a contact in the summary: how often it was in contact between two samples alone.
BETWEEN = "between_samples"
# Features that a table of several contacts leaves to the table of each.
_ASIDE = tuple(name for name, kind in features.KINDS.items() if kind.aside)
# Of the models that have what they show.
VIEWS = (CHAIN, AROUND, ORBITS, STATE, ORDERS)


def turning(scene: AbstractModel, params: Params) -> Turning | None:
    """The drive's turn and pitch; None for a model without a drive that turns."""
    if not scene.traits.turning:
        return None
    try:
        return Turning(*scene.full().period(params))
    except InputError:
        return None


def widths(scene: AbstractModel, params: Params) -> dict[str, float]:
    """By contact, the width of its regularisation [m], where it has one."""
    known = [c.name for c in scene.contacts if f"{c.name}.smoothing" in params or "smoothing" in params]
    return {name: float(scene.coefficient(params, name, "smoothing")) for name in known}


def drawn(
    folder: Path, run: Run, scene: AbstractModel, params: Params, reads: Sequence[Channel], contacts: Mapping[str, Any]
) -> list[Picture]:
    """Draw all pictures of a run, those that matter first; ``contacts`` are those of ``summary.json``: their periods give the
    loading cycles in steady motion. A run read from files has no trajectory, and no orbits.
    """
    drive: Any = turning(scene, params)
    chain, orbits = scene.chain(params), scene.orbits(params, run)
    many = {name for name, count in scene.members.items() if count and name in run.force}
    good = bool(run.force) and run.status == "ok"
    cycles = {}
    for name in run.force if drive and good else ():
        period = contacts.get(f"{name}_1" if name in many else name, {}).get("period")
        if period is not None and math.isfinite(period):
            cycles[name] = float(period)
    several = len(run.state) > 1 or many or any(contact.friction for contact in scene.contacts)
    every: tuple[tuple[str, Any, Callable[[Path], Picture | None]], ...] = (
        (CHAIN, good and chain is not None, lambda path: views.chain(chain, path)),  # pyright: ignore[reportArgumentType]
        (AROUND, good and many, lambda path: views.around(run, path, drive)),
        (FORCES, run.force, lambda path: pictures.forces(run, path)),
        (LOOPS, run.force, lambda path: pictures.loops(run, path, cycles, widths(scene, params))),
        (READINGS, reads, lambda path: pictures.readings(run, reads, path)),
        (ORBITS, orbits, lambda path: views.orbits(run, orbits, path, drive)),
        (STATE, run.state and several, lambda path: views.states(run, path, drive)),
        (ORDERS, good and drive, lambda path: views.orders(run, path, drive)),
    )
    return [one for name, wanted, draw in every if wanted and (one := draw(folder / name)) is not None]


def verdict(run: Run, content: Mapping[str, Any], absurd: Sequence[Finding] = ()) -> Verdict:
    """The highest force, where and when, and its measured error; first what contradicts it, and what cannot be."""
    if run.status == "failed":
        ended = f"The run ended at {brief(run.failure_time, 's')}: {run.reason}."
        return Verdict(BAD, "Failed", f"{ended} {headline(absurd)}".strip())
    return judged(absurd, _verdict(run, content))


def _verdict(run: Run, content: Mapping[str, Any]) -> Verdict:
    accuracy, found = content.get("accuracy") or {}, content.get("balance", {})
    until, differs = accuracy.get("agree_until"), ""
    if until is not None and math.isfinite(until):
        differs = f"Two runs disagree from {brief(until, 's')} on, in {accuracy.get('differs') or 'a force'}."
    said, measured = _highest(run, accuracy), _worst(accuracy)
    name, worst = max(measured.items(), key=lambda x: np.inf if math.isnan(x[1]) else x[1], default=("", 0.0))

    def told(kind: str, word: str, *sentences: str) -> Verdict:
        return Verdict(kind, word, " ".join(filter(None, sentences)))

    if found.get("verdict") == balance.MISSED:
        return told(BAD, "Forces and motion contradict each other", found["reason"], differs, said)
    if run.status != "ok":
        return told(BAD, run.status.capitalize(), f"{run.reason}.", differs, said)
    if measured and not worst <= accuracy["asked"]:
        also = f"The worst is {name}: {percent(worst, 2)}." if f"in {name}" not in said else ""
        return told(FAIR, "Less accurate than asked", said, also, differs)
    return told(FAIR, f"Sure until {brief(until, 's')}", said, differs) if differs else Verdict(GOOD, "Finished", said)


def _worst(accuracy: Mapping[str, Any]) -> dict[str, float]:
    """By contact, or by reading of a scene without contacts, the worst of its measured errors; NaN: it is not known."""
    found = {}
    for name, errors in accuracy.get("measured", {}).items():
        known = [float(x) for x in errors.values() if x is not None]
        found[name] = float(np.max(known)) if known else math.nan
    return found


def _highest(run: Run, accuracy: Mapping[str, Any]) -> str:
    """The highest force, where and when, and its measured error, in a sentence."""
    end, worst = brief(float(run.times[-1]), "s"), _worst(accuracy)
    top = {name: p for name, p in pictures.peaks(run).items() if math.isfinite(p.force)}
    name, peak = max(top.items(), key=lambda item: item[1].force, default=("", pictures.Peak(0.0, 0.0, 0)))
    if peak.force > 0.0:
        where = f"{name}_{peak.member}" if peak.member else name
        said, error = f"Highest force {brief(peak.force, 'N')}, in {where} at {brief(peak.time, 's')}", worst.get(name)
    else:
        contact = f" without a contact{'' if run.extremes else ' at any sample'}" if top else "; it has no contact"
        said, error = f"The run reached {end}{contact}", max(worst.values(), default=None)
    if error is None:
        return f"{said}{'' if accuracy else '; its error was not measured'}."
    size = f"measured error {percent(error, 2)}" if math.isfinite(error) else "its measured error is not finite"
    return f"{said}; {size}, asked {percent(accuracy['asked'])}."


def by_contact(
    scene: AbstractModel, contacts: Mapping[str, Mapping[str, Any]]
) -> list[tuple[str, list[Mapping[str, Any]]]]:
    """By contact of the model, what is known of its members: a row of a table each."""
    found = []
    for name, count in scene.members.items():
        members = [contacts[f"{name}_{k + 1}"] for k in range(count) if f"{name}_{k + 1}" in contacts]
        members = members or ([contacts[name]] if name in contacts else [])
        if members:
            found.append((f"{name} (1 to {len(members)})" if len(members) > 1 else name, members))
    return found


def _rows(
    groups: Sequence[tuple[str, list[Mapping[str, Any]]]],
    without: Sequence[str] = (),
    between: bool = False,
    beside: Mapping[str, Sequence[str]] | None = None,
) -> list[list[str]]:
    """Features across and contacts down; the other way round for one or two contacts, and with more features ``beside``
    (by heading a cell a contact), which would not fit on a screen.
    """
    there = {key for _, group in groups for one in group for key in one} - set(without)
    backwards = any(one.get("side") == -1.0 for _, group in groups for one in group)
    units = features.UNITS | features.OF_LIFE
    known = [(key, unit) for key, unit in units.items() if key in there and (key != "side" or backwards)]
    known += [(BETWEEN, "1")] if between else []
    rows = [["contact", *(key.replace("_", " ") for key, _ in known)]]
    for k, (name, group) in enumerate(groups):
        cells = [span([one[key] for one in group if one.get(key) is not None], unit) for key, unit in known]
        rows.append([name, *cells, *(each[k] for each in (beside or {}).values())])
    rows[0] += list(beside or {})
    if len(groups) < 3 or beside:
        (_, *names), *rest = [list(row) for row in zip(*rows, strict=True)]
        return [["feature", *names], *rest]
    return rows


def _shares(groups: Sequence[tuple[str, list[Mapping[str, Any]]]]) -> Rows:
    spent = [one.get("share_of_time", {}) for _, group in groups for one in group]
    # Few laws stick: a column of zeros says nothing.
    words = [word for word in STATES if word != "stuck" or any(s.get(word) for s in spent)]
    rows = [["contact", *words]]
    for name, group in groups:
        shares = [one.get("share_of_time", {}) for one in group]
        cells = [span([100.0 * s[word] for s in shares if s.get(word) is not None]) for word in words]
        rows.append([name, *(cell if cell == "-" else f"{cell} %" for cell in cells)])
    return rows


def contact_rows(scene: AbstractModel, content: Mapping[str, Any]) -> list[list[str]]:
    """Features of every contact, of its members the range, with three digits; and what the model's engineers read."""
    groups = by_contact(scene, content["contacts"])
    # Of several contacts what fits on a screen.
    without = _ASIDE if len(groups) > 2 else ()
    between = any(one.get(BETWEEN) and "peak_of_samples" not in one for one in content["contacts"].values())
    return _rows(groups, without, between, _engineering(groups, content))


def _engineering(groups: Sequence[tuple[str, Any]], content: Mapping[str, Any]) -> dict[str, list[str]]:
    """By heading a cell a contact of the summary's entry ``engineering`` (``AbstractModel.whole``); the force is the peak."""
    found = content.get("engineering", {})
    known = [found.get(name.partition(" ")[0], {}) for name, _ in groups]
    units = {key: unit for key, unit in found.get("units", {}).items() if key != "force"}
    titles = found.get("titles", {})
    return {
        titles.get(key, key): [_pair(one.get(key), unit) for one in known]
        for key, unit in units.items()
        if any(key in one for one in known)
    }


def _pair(value: Any, unit: str) -> str:
    if not isinstance(value, Sequence):
        return brief(value, unit)
    scale, prefix = engineering([x for x in value if x is not None], unit)
    sizes = " x ".join("-" if x is None or math.isnan(x) else f"{x * scale:.3g}" for x in value)
    return f"{sizes} {prefix.replace('u', 'µ')}{unit}"


def quantity_rows(content: Mapping[str, Any]) -> list[list[str]]:
    """What the model's engineers read of it as a whole: a row a quantity of ``engineering``; none without."""
    found = content.get("engineering", {}).get("quantities", {})
    columns = list(dict.fromkeys(key for one in found.values() for key in one if key != "unit"))
    rows = [[name, *(brief(one.get(key), one["unit"]) for key in columns)] for name, one in found.items()]
    return [["quantity", *columns], *rows] if found else []


def note(contacts: Mapping[str, Mapping[str, Any]]) -> str:
    """Where the features come from; what the column of contacts that no sample shows means; "" where there is none."""
    if any("peak_of_samples" in one for one in contacts.values()):
        return "Peaks, impulses, works and contact times are those of the solver's steps. "
    if not any(one.get(BETWEEN) for one in contacts.values()):
        return ""
    return "Between samples: contacts too short for the samples, which the other features leave out. "


def tables(scene: AbstractModel, content: Mapping[str, Any]) -> list[Table]:
    """Features and errors by contact, of members the range; the members themselves are folded."""
    contacts = content["contacts"]
    groups = by_contact(scene, contacts)
    if not groups:
        return []
    many = any(len(group) > 1 for _, group in groups)
    folded = []
    if many or len(groups) > 2:
        each = [(name, [values]) for name, values in contacts.items()]
        folded.append(Table(f"Each of the {len(each)} contacts", _rows(each)))
    if all("share_of_time" in one for _, group in groups for one in group):
        folded.append(Table("Share of the time in each state", _shares(groups)))
    read = content.get("engineering", {})
    ranges = "Of contacts with members the range over the members. " if many else ""
    text = f"{read.get('note', '')} {ranges}{note(contacts)}Three significant digits; all digits: summary.json.".strip()
    found = [Table("Contacts", contact_rows(scene, content), text, tuple(folded))]
    if rows := quantity_rows(content):
        found.append(Table("Moments and forces on parts", rows, read.get("quantities_note", "")))
    if accuracy := content.get("accuracy"):
        found.append(_accuracy(accuracy))
    return found


def balances(content: Mapping[str, Any]) -> list[Table]:
    """How well momenta and energy balance, by body; nothing of a run that was made before they were judged."""
    found = content.get("balance")
    if not found:
        return []
    rows = [["body", "balance", "error", "allowed", "verdict"]]
    for body, one in found["of"].items():
        for what, error in ((what, error) for what, error in one.items() if isinstance(error, Mapping)):
            cells = (percent(error[key], 2) for key in ("error", "allowed"))
            rows.append([body, what.replace("_", " "), *cells, one["verdict"]])
    by = f" Integrated over the {found['quadrature']}; shares of the largest term." if found["quadrature"] else ""
    return [Table("Balances of momentum and energy", rows, f"{found['sentence']}{by}".strip())]


def _accuracy(accuracy: Mapping[str, Any]) -> Table:
    rows = [["contact", "asked", "force history (rms)", "peak", "impulse"]]
    for name, errors in accuracy["measured"].items():
        rows.append([name, percent(accuracy["asked"]), *(percent(errors[k], 2) for k in ("rms", "peak", "impulse"))])
    until = accuracy.get("agree_until")
    note = "Against the same run at a tenth of the tolerance. Shares of each contact's peak force and impulse."
    if until is not None and np.isfinite(until):
        where = accuracy.get("differs") or "a force"
        note += f" Both runs agree until {brief(until, 's')}; then {where} differs by more than the error asked for."
    return Table("Measured force error", rows, note)


def whole_table(content: Mapping[str, Any]) -> list[Table]:
    """What the summary says of the model as a whole: every group of numbers that is neither contacts nor solver."""
    rows = [["quantity", "value"]]
    for group, values in content.items():
        aside = ("contacts", "accuracy", "solver", "units", "fidelity", "engineering", "balance", "plausibility")
        if group in aside or not isinstance(values, Mapping):
            continue
        units = values.get("units", {})
        for key, value in values.items():
            if isinstance(value, (int, float)):
                unit = next((u for part, u in units.items() if part in key), "1")
                unit = next(iter(units.values())) if unit == "1" and len(set(units.values())) == 1 else unit
                rows.append([f"{group}: {key}".replace("_", " "), brief(float(value), unit)])
    return [Table("The model as a whole", rows)] if len(rows) > 1 else []


class Ran(NamedTuple):
    """A run: of which scene, what ``summary.json`` says of it, and what of it is not plausible."""

    run: Run
    scene: AbstractModel
    content: Mapping[str, Any]
    absurd: Sequence[Finding] = ()


def choice_sentence(run: Run) -> str:
    """Which level of the model was chosen, and why; "" where nothing was to be chosen."""
    return f"Fidelity {run.choice.fidelity}: {run.choice.reason}." if run.choice else ""


def made(title: str, of: Ran, shown: Sequence[Picture], folded: Sequence[Table], readings: Rows = ()) -> Page:
    """The page of a run, with its pictures, those that matter first, more tables to fold away, and what [[read]] asks for."""
    content = of.content
    answer = verdict(of.run, content, of.absurd)
    found = tables(of.scene, content)
    if len(readings) > 1:
        found.append(Table("Readings", readings))
    return Page(
        title, replace(answer, sentence=f"{answer.sentence} {choice_sentence(of.run)}".strip()), tuple(shown[:2]),
        tuple(content.get("warnings", ())), tuple(found), tuple(shown[2:]),
        (*balances(content), *whole_table(content), *folded, report.solver_table(of.run.stats)),
    )  # fmt: skip
