"""``bcfj calibrate``: a problem file in, a folder of results and an exit code out."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bcfj_jax import InputError
from bcfj_jax.analysis import plausibility
from bcfj_jax.core.extras import library
from bcfj_jax.core.progress import stage
from bcfj_jax.core.quantities import percent
from bcfj_jax.io import outputs, report, scenefile, tables
from bcfj_jax.io.growing import Growing
from bcfj_jax.io.journal import NAME, Journal, key_of
from bcfj_jax.io.page import BAD, FAIR, GOOD, Listing, Page, Rows, Table, Verdict, bounded, brief, span
from bcfj_jax.io.plots import get_ready
from bcfj_jax.io.stop import heeded
from bcfj_jax.io.units import format_si
from bcfj_jax.xla.programs import keep_asked
from calibration.diagnostics.answers import Answer
from calibration.fit import COMPLETE, NARROW, UNTESTED, AllStartsFailed, Fit, Parameter
from calibration.forward.runs import clocks, ran
from calibration.impacts.preparation import Prepared
from calibration.problem import NUISANCES, Problem
from calibration.problemfile import base_of, load, load_with_records, sources
from calibration.report import plots_uncertainty
from calibration.report.diagnosis import as_json as diagnosis_json
from calibration.report.diagnosis import sections
from calibration.search.starts import Interrupted
from calibration.selection import agreement, apart, choice, diagnosis
from calibration.selection.alternatives import Outcome, solve
from calibration.selection.next_experiment import as_json as candidates_json
from calibration.selection.next_experiment import said as candidates_said
from calibration.selection.next_experiment import table as candidates_table
from calibration.uncertainty import intervals as uncertainty
from calibration.uncertainty import quote, unstated_filter
from calibration.uncertainty.estimates import REFERENCE, Reference, one_by_one
from calibration.uncertainty.intervals import check_kind
from calibration.uncertainty.law_miss import NEXT_RUN

DONE, FAILED, NOT_IDENTIFIED, INTERRUPTED = 0, 3, 4, 5
FILES = (
    "fit.json", "fitted_scene.toml", "data.png", "fit.png", "force_penetration.png", "starts.png", *report.FILES,
    "run.toml", "models.json", "environment.json", *plots_uncertainty.FILES,
)  # fmt: skip
_SO_FAR = "interrupted.json"
_LIGHTS = {"identified": GOOD, "adequate": GOOD, "not_identified": FAIR, "not_converged": BAD, "misfit": BAD}
# Stages of fit.json before the last, beside those of ``fit``; and what comes after those.
UNDIAGNOSED = "not diagnosed yet"
_NEXT = {
    UNTESTED: "Not tested yet: what the data determine, whether the law fits, and intervals come next.",
    NARROW: "Not complete yet: errors of the sensor, of the law and of fixed values come next; they may widen the intervals.",
}
# What an interval allows for, by its kind.
MEANING = {
    "noise": "noise alone",
    "runs": "runs differ",
    "robust": "runs, or blocks of samples, differ",
    "discrepancy": "the law misses a shape of the contact",
    unstated_filter.KIND: "a filter that nobody stated",
    quote.KIND: "every error that may act, of which few do",
    apart.KIND: "contacts differ: no law",
    NEXT_RUN: "the estimate of one more run by itself",
}
_ERRORS = (
    "Errors that may act: what the record says of each, how far each alone moves the estimates, and what it costs: the "
    "combined uncertainty over that without the error. What costs most is what to measure or buy first"
)
_HEAD = ["to quote", "value", "95 % interval", "which allows for", "noise alone", "remark"]
# Of intervals that hold on a condition.
_IF_SO = "95 % interval, if so"


@dataclass(frozen=True)
class _Done:
    """What came of a problem file: its fit and what was said of it, with what it was asked."""

    path: Path
    folder: Path
    outcome: Outcome
    starts: int
    seconds: float
    understood: list[Prepared] = field(default_factory=list)
    diagnosed: diagnosis.Diagnosis | None = None
    absurd: Sequence[plausibility.Finding] = ()

    @property
    def explained(self) -> list[tuple[str, list[list[str]]]]:
        """Tables of what would explain a miss."""
        return sections(self.diagnosed, self.outcome.fit) if self.diagnosed else []


def run(
    path: Path, out: Path | None, seed: int, starts: int, intervals: str = "covariance", diagnose: bool = False
) -> int:
    """Calibrate a problem file; write the results; return the exit code of the contract.

    A folder that holds the journal of this very fit is gone on with. What would explain a miss is ranked where the law is not
    consistent; ``diagnose``: always, and the best confirmed by fits.

    Raises:
        InputError: for bad input, before anything is written.
    """
    path = Path(path)
    check_kind(intervals)
    problem, understood = load_with_records(path)
    folder = outputs.open_folder(out, path.stem, outputs.Claim("calibrate", (*FILES, _SO_FAR), goes_on=NAME))
    base = base_of(path)
    key = key_of(
        [asdict(e) for e in problem.experiments], _resolved(path, base, problem, seed, starts), problem.accuracy,
        problem.loss, tables.read(path).get("model"), packages=("bcfj_jax", "calibration"),
    )  # fmt: skip
    begin = time.perf_counter()
    with heeded(), Journal(folder, key) as journal:
        if journal.resumed:
            print(f"going on in {folder}: {len(journal)} batches are finished", file=sys.stderr)
        for record in understood:
            print(f"{record.name}: {'; '.join(record.notes)}", file=sys.stderr)
        get_ready()
        told = _Told(folder)
        try:
            options = {"seed": seed, "starts": starts, "journal": journal, "intervals": intervals, "tell": told.so_far}
            outcome = solve(path, problem, base, **options)
            absurd = _absurd(outcome)
            told.growing.write(UNDIAGNOSED, as_json(outcome.fit))
            print("\n".join(filter(None, [plausibility.headline(absurd), text(outcome.fit)])), flush=True)
            diagnosed = _diagnosed(outcome, diagnose, seed)
        except InputError:
            _take_back(folder, journal)
            raise
        except AllStartsFailed as error:
            _take_back(folder, journal)
            print(f"error: {path}: {error}", file=sys.stderr)
            return FAILED
        except KeyboardInterrupt as stop:
            return _interrupted(told, path, stop)
        seconds = time.perf_counter() - begin
        done = _Done(path, folder, outcome, starts, seconds, understood, diagnosed, absurd)
        _write(done, told.growing)
        for heading, rows in [*_comparisons(outcome), *done.explained]:
            print(f"\n{heading}\n{report.text(rows)}")
        print(f"\nresults and pictures, all in report.html: {folder}", flush=True)
        with stage("drawing"):
            _draw(done)
        (folder / _SO_FAR).unlink(missing_ok=True)
        journal.remove()
    keep_asked()
    return DONE if outcome.fit.verdict in ("identified", "adequate") else NOT_IDENTIFIED


class _Told:
    """What is written and shown of a fit as it grows."""

    def __init__(self, folder: Path) -> None:
        self.growing = Growing(folder / "fit.json", partial(print, flush=True))
        self.stage, self.values = "", None

    def so_far(self, found: Fit) -> None:
        """Write and show a fit that is not complete."""
        self.stage, self.values = found.stage, found.values
        self.growing.write(found.stage, as_json(found))
        if found.stage == UNTESTED:
            head = "best fit, not tested yet" if not found.notes else f"best fit, not tested yet; {found.notes[0]}"
            alone, ranges = _own(found.parameters)
            values = [[name, brief(found.parameters[name].value, found.parameters[name].unit)] for name in alone]
            rows = [head, report.text([["parameter", "value"], *values, *ranges]), _residual(found)]
        else:
            known = [row[:4] + row[5:] for row in (_head(found), *_rows(found))]
            rows = [f"verdict so far: {found.verdict}", report.text(known)]
        self.growing.tell(rows, _NEXT[found.stage])


def export_petab(path: Path, folder: Path) -> int:
    """Write a problem file as PEtab tables instead of fitting it.

    Raises:
        InputError: for bad input, before anything is written, or where PEtab is not installed.
    """
    from calibration.petab import export

    library("petab.v2", "--export-petab", "petab")
    problem = load(path)
    print(export(problem, base_of(Path(path)).resolved, folder))
    return DONE


def _take_back(folder: Path, journal: Journal) -> None:
    """Leave nothing of a fit that came to nothing: what is there would be in the way of the next."""
    journal.remove()
    for name in (_SO_FAR, "fit.json"):
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def _interrupted(told: _Told, path: Path, stop: KeyboardInterrupt) -> int:
    """Leave the best so far, which is no fit yet, and say how to go on."""
    folder = told.growing.path.parent
    print(f"interrupted; go on with: bcfj calibrate {path} --out {folder} (same options)", file=sys.stderr)
    if not isinstance(stop, Interrupted):
        stop = Interrupted("all", told.values, float("nan"), "assessment")
    best = {"finished_starts": stop.finished, "stage": stop.stage, "chi2_of_stage": stop.cost, "best": stop.values}
    # Gone on with and cut off again at once, it knows less than before.
    if stop.values is not None or not (folder / _SO_FAR).exists():
        outputs.write_json(folder / _SO_FAR, best)
    print(f"{stop.finished} starts finished; the best so far is in {folder / _SO_FAR}", file=sys.stderr)
    if told.stage:
        print(f"the fit so far ({told.stage}) is in {told.growing.path}", file=sys.stderr)
    return INTERRUPTED


def _absurd(outcome: Outcome) -> list[plausibility.Finding]:
    """What is not plausible of the longest record that is fitted, as the fitted values run it."""
    at = outcome.fit.optimum
    params: dict[str, Any]
    params, times = max(clocks(at.model, at.end.point), key=lambda one: one[1][-1])
    return plausibility.of_run(at.model.scene, params, ran(at.model, params, times))


def text(result: Fit) -> str:
    """The fit in words: verdict, what to quote, the three answers, then the rest."""
    lines = [f"verdict: {result.verdict}", *_on_condition(result), report.text([_head(result), *_rows(result)]), ""]
    for question, found in _answers(result):
        lines += [f"{question}: {found.answer}", *(f"  - {reason}" for reason in found.because)]
    if any(len(p.intervals) > 1 and p.headline for n, p in _shown(result).items() if n != REFERENCE):
        lines += ["", "every kind of interval:", report.text(_kinds(result))]
    for heading, rows in _error_tables(result):
        lines += ["", f"{heading}:", report.text(rows)]
    lines += ["", _residual(result)]
    for name, seen in result.residual["features"].items():
        sigma = f"(sigma {seen['sigma']:.2g})"
        lines.append(f"{name}: {seen['fitted']:.4g} fitted, {seen['measured']:.4g} measured {sigma}")
    for name, errors in (result.held_out or {}).items():
        worst, rms = errors["max_error_of_peak"], errors["rms_error_of_peak"]
        lines.append(f"held out, {name}: at most {worst:.2%} of the peak, {rms:.2%} rms where the force acts")
    return "\n".join([*lines, *(f"note: {note}" for note in result.notes)])


def _residual(result: Fit) -> str:
    sizes = " and ".join(brief(value, unit) for unit, value in result.residual["rms"].items()) or "0 N"
    return f"residual: {sizes} rms over {result.residual['samples']} samples"


def _on_condition(result: Fit) -> list[str]:
    """In words what holds on a condition that the record leaves open."""
    found = result.conditional
    if found is None:
        return []
    told = {REFERENCE, *_shared(result), *(found.parameters.keys() - result.parameters.keys())}
    known = [
        f"{_called(name, p)} {_interval(p.value, p.ci95, p.unit)}"
        for name, p in found.every.items()
        if p.ci95 and name in told
    ]
    return [f"if {found.condition}: {'; '.join(known)}", ""]


def _called(name: str, p: Parameter) -> str:
    return f"force at {brief(p.penetration, 'm')}" if isinstance(p, Reference) else name


def _shown(result: Fit) -> dict[str, Parameter]:
    """The estimates, with the intervals that hold on a condition where there are none without."""
    return {**result.every, **(result.conditional.every if result.conditional else {})}


def _head(result: Fit) -> list[str]:
    return [_IF_SO if result.conditional and cell == _HEAD[2] else cell for cell in _HEAD]


def _answers(result: Fit) -> list[tuple[str, Answer]]:
    return [("search", result.search), ("data", result.data), ("law", result.law)]


def _kinds(result: Fit) -> list[list[str]]:
    """Every interval by its kind, the headline marked."""
    every = {name: p for name, p in _shown(result).items() if name != REFERENCE}
    kinds = [k for k in MEANING if any(k in p.intervals for p in every.values())]
    rows = [["parameter", *kinds]]
    for name in _in_order(_shared(result)):
        p = every[name]
        shown = {k: _ends(ends, p.unit) + (" *" if k == p.headline else "") for k, ends in p.intervals.items()}
        rows.append([name, *(shown.get(k, "") for k in kinds)])
    return rows


def _error_tables(result: Fit) -> list[tuple[str, list[list[str]]]]:
    """Standard uncertainties in the words of JCGM 100; and of every error what the record says, what each estimate moves by
    for it alone, and what it costs, the dearest first. None where no errors are allowed for.
    """
    found = result.systematic
    if found is None:
        return []
    names = [name for name in _in_order([REFERENCE, *_shared(result)]) if name in found.names]
    own = [["", "Type A (noise)", "Type B (errors)", "combined", "coverage factor"]]
    for name in names:
        if name not in found.uncertainties:
            own.append([name, "held", "", "", ""])
            continue
        *parts, factor, _ = found.uncertainties[name]
        own.append([name, *(_moved(x, result, name) for x in parts), f"{factor:.2f}"])
    rows = [["error", "up to", "by the record", *names, "uncertainty over that without it"]]
    for line in sorted(found.lines, key=lambda line: -max(line.cost.get(name, 1.0) for name in names)):
        moved = (_moved(line.moves[name], result, name) for name in names)
        cost = max(line.cost[name] for name in names)
        rows.append([line.error, line.limit, f"{line.says} ({line.chance:.0%})", *moved, f"{cost:.2f}"])
    return [("standard uncertainty", own), (_ERRORS, rows)]


def _in_order(names: Iterable[str]) -> list[str]:
    """The reference force, losses, exponents, others, a stiffness, which follows from both, and last the sensor's numbers."""
    kinds = (REFERENCE, "restitution", "damping", "loss", "exponent")
    place = {n: next((k for k, kind in enumerate(kinds) if kind in n), 5 + ("stiffness" in n)) for n in names}
    place |= {n: 7 for n in place if n.partition("[")[0] in NUISANCES}
    return sorted(place, key=lambda n: place[n])


def _shared(result: Fit) -> list[str]:
    """Parameters that all records share; where there are none, all."""
    axes = result.optimum.model.coordinates
    own = [label for label, axis in zip(result.labels, axes, strict=True) if axis.experiment is None]
    return own or list(result.labels)


def _moved(move: float, result: Fit, name: str) -> str:
    if name == REFERENCE or result.optimum.model.coordinates[result.labels.index(name)].log:
        return percent(move, 2) if move >= 1e-4 else "< 0.01 %"
    return format_si(move, result.parameters[name].unit, 2)


def _ends(ends: tuple[float, float] | None, unit: str) -> str:
    return " to ".join(bounded(ends, ends, unit)) if ends else "none"


def _interval(value: float, ends: tuple[float, float] | None, unit: str) -> str:
    return bounded([value], ends or (), unit)[0] + (f", 95 % {_ends(ends, unit)}" if ends else "")


def _rows(result: Fit) -> list[list[str]]:
    """What to quote, first the force that the data know best; the interval of the noise alone beside."""
    rows, shown = [], _shown(result)
    alone, ranges = _own(shown)
    for name in _in_order(alone):
        p = shown[name]
        allowed, remark = MEANING.get(p.headline, ""), _remark(p)
        if name == REFERENCE:
            if result.conditional and not p.ci95:
                continue
            allowed, remark = MEANING[quote.KIND] if p.with_budget else "", "the power law where the data are"
        ends = _ends(p.ci95, p.unit), allowed, _ends(p.intervals.get("noise"), p.unit)
        rows.append([_called(name, p), *bounded([p.value], p.ci95 or (), p.unit), *ends, remark])
    return rows + [[*row, "", "", "", "each in fit.json"] for row in ranges]


def _own(shown: Mapping[str, Parameter]) -> tuple[list[str], list[list[str]]]:
    """Which estimates are shown one by one; of the others, that each run has of its own, name and range."""
    alone, own = one_by_one(list(shown)), dict[str, list[Parameter]]()
    for name in shown.keys() - set(alone):
        own.setdefault(name.partition("[")[0], []).append(shown[name])
    found = sorted(own.items())
    return alone, [[f"{name} of {len(each)} runs", span((p.value for p in each), each[0].unit)] for name, each in found]


def _remark(p: Parameter) -> str:
    remarks = ["derived from force and exponent"] if p.kind == "derived" else []
    remarks += ["not to a factor of two"] if p.ci95 and p.ci95[0] > 0.0 and p.ci95[1] > 2.0 * p.ci95[0] else []
    least = brief(p.least_squares, p.unit)
    remarks += [f"least squares {least}"] if least != brief(p.value, p.unit) else []
    remarks += [f"interval by {p.interval_kind}"] if p.headline == "noise" and p.interval_kind != "covariance" else []
    remarks += [f"at its {p.at_bound} bound"] if p.at_bound else []
    remarks += [] if p.identifiable else ["not determined by the data"]
    return ", ".join(remarks)


def as_json(result: Fit) -> dict[str, Any]:
    """``fit.json`` of the contract."""
    found, matrix = result.conditional, result.correlation
    return {
        "verdict": result.verdict,
        "quoted": _quoted_json(result),
        "reasons": result.reasons,
        **{question: found._asdict() for question, found in _answers(result)},
        "notes": result.notes,
        "parameters": {name: _parameter(p) for name, p in result.parameters.items()},
        "reference": _force(result.reference),
        "tests": [
            {"name": t.name, "value": float(t.value), "threshold": float(t.threshold), "passed": bool(t.passed)}
            for t in result.tests
        ],
        **_fields(result, "starts", "residual", "noise", "check", "held_out"),
        "systematic": [{**line._asdict(), "says": line.says} for line in result.systematic.lines] if result.systematic else [],
        "correlation": None if matrix is None else {"labels": list(result.labels), "matrix": matrix},
        "seed": result.seed,
        "conditional": found and {
            "condition": found.condition,
            "parameters": {n: _fields(p, "value", "unit", "ci95", "with_budget") for n, p in found.parameters.items()},
            "reference": _force(found.reference),
        },
        **uncertainty.as_json(result.evidence),
    }  # fmt: skip


def _fields(thing: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(thing, name) for name in names}


def _parameter(p: Parameter) -> dict[str, Any]:
    return {
        **_fields(p, "value", "unit", "ci95"),
        "headline": p.headline or None,
        **_fields(p, "least_squares", "with_budget", "intervals", "identifiable"),
        "at_bound": p.at_bound or None,
        "kind": p.kind,
        "interval": p.interval_kind if p.headline == "noise" else None,
    }


def _quoted_json(result: Fit) -> list[dict[str, Any]]:
    """What to quote, in order: value, interval, and its standard uncertainties where errors are allowed for."""
    known = result.systematic.uncertainties if result.systematic else {}
    found = []
    for name in _in_order(result.every):
        p = result.every[name]
        where = {"penetration": p.penetration} if isinstance(p, Reference) else {}
        own = {"name": name, **where, **_fields(p, "value", "unit", "ci95")}
        found.append(own | {"uncertainty": known[name]._asdict() if name in known else None})
    return found


def _force(reference: Reference | None) -> dict[str, Any] | None:
    return reference and {
        **_fields(reference, "penetration", "force", "ci95", "with_budget"),
        "intervals": {"noise": reference.noise},
    }


def _block(heading: str, rows: Rows) -> Table | Listing:
    """A table, or lines for an input file where there is one column."""
    if len(rows[0]) == 1:
        return Listing(heading, "\n".join(row[0] for row in rows))
    return Table(heading, rows)


def _comparisons(outcome: Outcome) -> list[tuple[str, list[list[str]]]]:
    """Tables of contacts between flights, of models and of candidates, with what is said of them."""
    seen = apart.rows(outcome.fit)
    found = [(apart.HEADING, seen)] if seen else []
    if outcome.choice:
        found.append((f"Models: {'; '.join(outcome.choice.reasons)}", choice.table(outcome.choice)))
        if agreed := agreement.of_choice(outcome.choice):
            found.append((agreement.heading(agreed), agreement.rows(agreed)))
    if outcome.gains:
        heading = (
            "The next experiment: width of each interval of the noise alone after it, over that before (* shrinks most)"
        )
        found.append((heading, candidates_table(outcome.gains)))
        if said := candidates_said(outcome.gains):
            found.append(
                ("What would narrow the intervals to quote (now, and then)", [["candidate"], *([x] for x in said)])
            )
    return found


def _diagnosed(outcome: Outcome, diagnose: bool, seed: int) -> diagnosis.Diagnosis | None:
    """What would explain the miss; None where nothing was asked and the law is consistent, or it cannot be said."""
    if diagnose:
        with stage("diagnosis"):
            return diagnosis.diagnose(outcome.problem, outcome.fit, seed)
    # A search that failed beside contacts, or values that the record contradicts, leave residuals that say nothing of it.
    failed = outcome.fit.search.answer != "converged" and bool(apart.rows(outcome.fit))
    failed = failed or (outcome.fit.conditional is not None and any(doubt.name for doubt in outcome.problem.doubts))
    return None if failed or outcome.fit.law.answer == "consistent" else diagnosis.rank(outcome.problem, outcome.fit)


def _write(done: _Done, growing: Growing) -> None:
    """The result. The journal is there until ``_draw`` is done: cut off before, the same command completes the folder."""
    outcome, result, folder, path = done.outcome, done.outcome.fit, done.folder, done.path
    scene, picked = outcome.base.resolved, outcome.choice
    fitted = {n: v for n, v in result.values.items() if n in scene["parameters"]}
    ready = {**scene, "parameters": {**scene["parameters"], **fitted}}
    said = f"fitted by bcfj calibrate {path.name}; verdict: {result.verdict}"
    outputs.write_toml(folder / "fitted_scene.toml", ready, said)
    resolved = _resolved(path, outcome.base, outcome.problem, result.seed, done.starts)
    known = outputs.environment(seed=result.seed, data=sources(path))
    outputs.write_origin(folder, resolved, f"resolved input of bcfj calibrate {path.name}", known)
    if picked:
        outputs.write_json(folder / "models.json", choice.as_json(picked))
    content = {**as_json(result), "plausibility": plausibility.content(done.absurd)}
    content |= {"model": picked.chosen} if picked else {}
    content |= {"next_experiment": candidates_json(outcome.gains)} if outcome.gains else {}
    content |= {"diagnosis": diagnosis_json(done.diagnosed, result)} if done.diagnosed else {}
    agreed = (picked and agreement.of_choice(picked)) or (done.diagnosed and done.diagnosed.agreed)
    content |= {"elastic_force": agreement.as_json(agreed)} if agreed else {}
    growing.write(COMPLETE, content | {"wall_s": done.seconds})


def _headline(result: Fit) -> Verdict:
    """The verdict, and the force where the data are, or the first parameter, with the interval to quote."""
    word, every = result.verdict.replace("_", " "), (result.conditional or result).every
    shown = [(name, p) for name, p in every.items() if p.ci95] or list(result.parameters.items())
    shown.sort(key=lambda item: item[0] != REFERENCE)
    known = ""
    if shown:
        name, p = shown[0]
        name = f"The {_called(name, p)}" if name == REFERENCE else name
        value, *ends = bounded([p.value, *(p.ci95 or ())], p.ci95 or (), p.unit)
        said = (
            f"with 95 % confidence {' to '.join(ends)}" if ends else "without an interval: the data do not determine it"
        )
        condition = f"If {result.conditional.condition}, " if result.conditional and ends else ""
        known = f"{condition}{name} is {value}, {said}."
    wide = [f"{note}." for note in result.notes if note.startswith(uncertainty.SPANNING)]
    lost = [name for name, p in result.parameters.items() if not p.identifiable]
    unknown = f"Not determined by the data: {', '.join(lost)}." if lost else ""
    said = " ".join(filter(None, [known, *wide, unknown]))
    return Verdict(_LIGHTS.get(result.verdict, BAD), f"{word[0].upper()}{word[1:]}", said)


def _draw(done: _Done) -> None:
    """Pictures, and the report that holds them."""
    from calibration.impacts import plot as dataplot
    from calibration.report import plots

    problem, result, folder = done.outcome.problem, done.outcome.fit, done.folder
    drawn = [
        plots.records(result, problem, folder / "fit.png"),
        plots.force_penetration(result, problem, folder / "force_penetration.png"),
        dataplot.data(done.understood, folder / "data.png"),
        plots.starts(result, folder / "starts.png"),
        *plots_uncertainty.draw(result, folder),
    ]
    note = " ".join([*_on_condition(result)[:1], "* in the table below marks the kind that is printed here."])
    found = [Table("To quote", [_head(result), *_rows(result)], note,
                   (Table("Every kind of interval (* the one printed)", _kinds(result)),))]  # fmt: skip
    answers = [[question, one.answer, "; ".join(one.because)] for question, one in _answers(result)]
    answers = [["question", "answer", "because"], *answers]
    answers = answers if any(row[2] for row in answers[1:]) else [row[:2] for row in answers]
    found.append(Table("The three questions behind the verdict", answers))
    found += [_block(heading, rows) for heading, rows in done.explained]
    found += [Table(f"{heading[0].upper()}{heading[1:]}", rows) for heading, rows in _error_tables(result)]
    if result.held_out:
        head = ["record", "largest error of the peak", "rms of the peak, where the force acts"]
        rows = [[n, *(percent(e[f"{k}_error_of_peak"]) for k in ("max", "rms"))] for n, e in result.held_out.items()]
        found.append(Table("Records that were held out", [head, *rows]))
    found += [_block(heading, rows) for heading, rows in _comparisons(done.outcome)]
    tests = [[t.name, f"{t.value:.4g}", f"{t.threshold:.4g}", "yes" if t.passed else "NO"] for t in result.tests]
    notes = [[record.name, note] for record in done.understood for note in record.notes]
    folded = (
        Table("Tests", [["test", "value", "limit", "passed"], *tests]),
        Table("Data: what was understood of each record", [["record", "what was understood"], *notes]),
    )
    shown = [one for one in drawn if one is not None]
    verdict, words = plausibility.judged(done.absurd, _headline(result)), (*result.reasons, *result.notes)
    first, others = tuple(shown[:2]), tuple(shown[2:])
    made = Page(f"Calibration of {done.path.name}", verdict, first, words, tuple(found), others, folded)
    report.write(folder, made, done.outcome.base.scene.model_form)


def _resolved(path: Path, base: scenefile.SceneFile, problem: Problem, seed: int, starts: int) -> dict[str, Any]:
    """The problem with every default, SI: what ``run.toml`` gets."""
    return {
        "problem": str(path), "seed": seed, "starts": starts, **_fields(problem, "loss", "accuracy", "adequate"),
        "scene": base.resolved,
        "experiment": [
            {
                **_fields(e, "name", "source", "hold_out"),
                "samples": int(e.times.size),
                "parameters": e.fixed,
                "bounds": {name: list(own) for name, own in e.bounds.items()},
                "noise": {c.observes: "estimate" if c.sigma is None else c.sigma for c in e.channels},
            }
            for e in problem.experiments
        ],
        "free": {
            f.name: {
                **_fields(f, "lower", "upper"), "scale": "log" if f.log else "linear", "each": f.per_experiment,
                **({} if f.start is None else {"start": f.start}),
            }
            for f in problem.free
        },
    }  # fmt: skip
