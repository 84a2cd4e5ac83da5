"""``bcfj calibrate``: a problem file in, a folder of results and an exit code out."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bcfj_jax import InputError
from bcfj_jax.analysis import plausibility
from bcfj_jax.core.extras import library
from bcfj_jax.core.programs import keep_asked
from bcfj_jax.core.progress import stage
from bcfj_jax.io import outputs, report, scenefile, tables
from bcfj_jax.io.journal import NAME, Journal, key_of
from bcfj_jax.io.page import Page, Table, bounded, brief, percent
from bcfj_jax.io.plots import get_ready
from bcfj_jax.io.stop import heeded
from bcfj_jax.io.units import format_si
from calibration.data.preparation import Prepared
from calibration.diagnostics.answers import Answer
from calibration.fit import AllStartsFailed, Fit, Parameter
from calibration.problem import Problem
from calibration.problemfile import base_of, load, load_with_records, sources
from calibration.report import plots_uncertainty
from calibration.report.diagnosis import as_json as diagnosis_json
from calibration.report.diagnosis import sections
from calibration.search.starts import Interrupted
from calibration.selection import agreement, apart, choice, diagnosis
from calibration.selection.alternatives import Outcome, solve
from calibration.selection.next_experiment import as_json as candidates_json
from calibration.selection.next_experiment import table as candidates_table
from calibration.uncertainty import intervals as uncertainty
from calibration.uncertainty import unstated_filter
from calibration.uncertainty.estimates import REFERENCE
from calibration.uncertainty.intervals import check_kind
from calibration.uncertainty.law_miss import NEXT_RUN

DONE, FAILED, NOT_IDENTIFIED, INTERRUPTED = 0, 3, 4, 5
FILES = (
    "fit.json", "fitted_scene.toml", "data.png", "fit.png", "force_penetration.png", "starts.png", *report.FILES,
    "run.toml", "models.json", "environment.json", *plots_uncertainty.FILES,
)  # fmt: skip
_SO_FAR = "interrupted.json"
# What an interval allows for, by its kind.
MEANING = {
    "noise": "noise alone",
    "runs": "runs differ",
    "robust": "runs, or blocks of samples, differ",
    "discrepancy": "the law misses a shape of the contact",
    unstated_filter.KIND: "a filter that nobody stated",
    apart.KIND: "contacts differ: no law",
    NEXT_RUN: "the estimate of one more run by itself",
}
_BUDGET = "Errors of the sensor and of fixed values that residuals do not show: how far each moves the estimates"
_HEAD = ["parameter", "value", "95 % interval", "which allows for", "with the errors below", "remark"]
# Of intervals that hold on a condition.
_IF_SO = "95 % interval, if so"


def run(
    path: Path, out: Path | None, seed: int, starts: int, intervals: str = "covariance", diagnose: bool = False
) -> int:
    """Calibrate a problem file; write the results; return the exit code of the contract.

    A folder that holds the journal of this very fit is gone on with: finished starts are taken from there. What would
    explain a miss is ranked where the law is not consistent; ``diagnose``: always, and the best confirmed by fits.

    Raises:
        InputError: for bad input, before anything is written.
    """
    path = Path(path)
    check_kind(intervals)
    problem, understood = load_with_records(path)
    folder = outputs.open_folder(out, "calibrate", path.stem, (*FILES, _SO_FAR), goes_on=NAME)
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
        try:
            outcome = solve(path, problem, base, seed=seed, starts=starts, journal=journal, intervals=intervals)
            diagnosed = _diagnosed(outcome, diagnose, seed)
        except InputError:
            _take_back(folder, journal)
            raise
        except AllStartsFailed as error:
            _take_back(folder, journal)
            print(f"error: {path}: {error}", file=sys.stderr)
            return FAILED
        except KeyboardInterrupt as stop:
            return _interrupted(folder, path, stop)
        result, absurd = outcome.fit, _absurd(outcome)
        _write(folder, path, outcome, starts, time.perf_counter() - begin, diagnosed, absurd)
        print("\n".join(filter(None, [plausibility.headline(absurd), text(result)])))
        for heading, rows in [*_comparisons(outcome), *_explained(outcome, diagnosed)]:
            print(f"\n{heading}\n{report.text(rows)}")
        print(f"\nresults and pictures, all in report.html: {folder}", flush=True)
        with stage("drawing"):
            _draw(folder, path, outcome, understood, diagnosed, absurd)
        (folder / _SO_FAR).unlink(missing_ok=True)
        journal.remove()
    keep_asked()
    return DONE if result.verdict in ("identified", "adequate") else NOT_IDENTIFIED


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
    (folder / _SO_FAR).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def _interrupted(folder: Path, path: Path, stop: KeyboardInterrupt) -> int:
    """Leave the best so far, which is no fit yet, and say how to go on."""
    print(f"interrupted; go on with: bcfj calibrate {path} --out {folder} (same options)", file=sys.stderr)
    if not isinstance(stop, Interrupted):
        stop = Interrupted("all", None, float("nan"), "assessment")
    best = {"finished_starts": stop.finished, "stage": stop.stage, "chi2_of_stage": stop.cost, "best": stop.values}
    # Gone on with and cut off again at once, it knows less than before.
    if stop.values is not None or not (folder / _SO_FAR).exists():
        outputs.write_json(folder / _SO_FAR, best)
    print(f"{stop.finished} starts finished; the best so far is in {folder / _SO_FAR}", file=sys.stderr)
    return INTERRUPTED


def _absurd(outcome: Outcome) -> list[plausibility.Finding]:
    """What is not plausible of the longest record that is fitted, as the fitted values run it."""
    problem, scene = outcome.problem, outcome.problem.scene
    longest = max(
        (e for e in problem.experiments if not e.hold_out), key=lambda e: e.times[-1] if e.times.size else 0.0
    )
    fitted = {name: p.value for name, p in outcome.fit.parameters.items() if name in scene.quantities}
    params = {name: x for name, x in {**problem.params, **longest.fixed, **fitted}.items() if name in scene.quantities}
    return plausibility.at(scene, params, longest.times) if longest.times.size else []


def text(result: Fit) -> str:
    """The fit in words: verdict, the three answers, then a line a parameter."""
    lines = [f"verdict: {result.verdict}"]
    for question, found in _answers(result):
        lines += [f"{question}: {found.answer}", *(f"  - {reason}" for reason in found.because)]
    lines += ["", *_on_condition(result), report.text([_head(result), *_rows(result)])]
    if any(len(p.intervals) > 1 and p.headline for p in _shown(result).values()):
        lines += ["", "every kind of interval:", report.text(_kinds(result))]
    # Of a fit that knows nothing but on a condition the line above has it.
    if result.reference and (result.reference.ci95 or not result.conditional):
        lines += [
            "",
            f"force at {brief(result.reference.penetration, 'm')}: {_interval(result.reference, 'N')}"
            + (
                f", with the errors below {_ends(result.reference.with_budget, 'N')}"
                if result.reference.with_budget
                else ""
            )
            + " (the power law where the data are; the stiffness is derived from it)",
        ]
    if result.systematic:
        lines += ["", f"{_BUDGET}:", report.text(_budget_rows(result))]
    lines += [
        "",
        f"residual: {_sizes(result.residual['rms'])} rms over {result.residual['samples']} samples",
    ]
    for name, seen in result.residual["features"].items():
        lines.append(
            f"{name}: {seen['fitted']:.4g} fitted, {seen['measured']:.4g} measured (sigma {seen['sigma']:.2g})"
        )
    for name, errors in (result.held_out or {}).items():
        worst, rms = errors["max_error_of_peak"], errors["rms_error_of_peak"]
        lines.append(f"held out, {name}: at most {worst:.2%} of the peak, {rms:.2%} rms where the force acts")
    return "\n".join([*lines, *(f"note: {note}" for note in result.notes)])


def _on_condition(result: Fit) -> list[str]:
    """In words what holds on a condition that the record leaves open."""
    found = result.conditional
    if found is None:
        return []
    told = {*_shared(result), *(found.parameters.keys() - result.parameters.keys())}
    known = [f"{name} {_interval(p, p.unit)}" for name, p in found.parameters.items() if p.ci95 and name in told]
    reference = found.reference
    known += (
        [f"force at {brief(reference.penetration, 'm')} {_interval(reference, 'N')}"]
        if reference and reference.ci95
        else []
    )
    return [f"if {found.condition}: {'; '.join(known)}", ""]


def _shown(result: Fit) -> dict[str, Parameter]:
    """The estimates, with the intervals that hold on a condition where there are none without."""
    return {**result.parameters, **(result.conditional.parameters if result.conditional else {})}


def _head(result: Fit) -> list[str]:
    return [_IF_SO if result.conditional and cell == _HEAD[2] else cell for cell in _HEAD]


def _answers(result: Fit) -> list[tuple[str, Answer]]:
    return [("search", result.search), ("data", result.data), ("law", result.law)]


def _kinds(result: Fit) -> list[list[str]]:
    """Every interval by its kind, the headline marked."""
    every = _shown(result)
    kinds = [k for k in MEANING if any(k in p.intervals for p in every.values())]
    rows = [["parameter", *kinds]]
    for name in _shared(result):
        p = every[name]
        shown = {k: _ends(ends, p.unit) + (" *" if k == p.headline else "") for k, ends in p.intervals.items()}
        rows.append([name, *(shown.get(k, "") for k in kinds)])
    return rows


def _budget_rows(result: Fit) -> list[list[str]]:
    """What each estimate moves by for every error, a share of itself, and for all together."""
    found = result.systematic
    assert found is not None
    names = [name for name in (REFERENCE, *_shared(result)) if name in found.names]
    rows = [["error", "up to", *names]]
    for line in found.lines:
        moves = [_moved(line.moves[name], result, name) for name in names]
        rows.append([line.error, line.limit, *moves])
    return [*rows, ["all together", "", *(_moved(max(found.widened(name, 0.0)), result, name) for name in names)]]


def _shared(result: Fit) -> list[str]:
    """Parameters that all records share; where there are none, all."""
    axes = result.optimum.model.coordinates
    own = [label for label, axis in zip(result.labels, axes, strict=True) if axis.experiment is None]
    return own or list(result.labels)


def _moved(move: float, result: Fit, name: str) -> str:
    share = percent(move, 2) if move >= 1e-4 else "< 0.01 %"
    if name == REFERENCE or result.optimum.model.coordinates[result.labels.index(name)].log:
        return share
    return format_si(move, result.parameters[name].unit, 2)


def _ends(ends: tuple[float, float] | None, unit: str) -> str:
    return " to ".join(bounded(ends, ends, unit)) if ends else "none"


def _sizes(by_unit: dict[str, float]) -> str:
    return " and ".join(brief(value, unit) for unit, value in by_unit.items()) or "0 N"


def _interval(thing: Any, unit: str) -> str:
    value = thing.force if hasattr(thing, "force") else thing.value
    return bounded([value], thing.ci95 or (), unit)[0] + (f", 95 % {_ends(thing.ci95, unit)}" if thing.ci95 else "")


def _rows(result: Fit) -> list[list[str]]:
    rows = []
    for name, p in _shown(result).items():
        ends = _ends(p.ci95, p.unit), MEANING.get(p.headline, ""), _ends(p.with_budget, p.unit)
        rows.append([name, *bounded([p.value], p.ci95 or (), p.unit), *ends, _remark(p)])
    return rows


def _remark(p: Parameter) -> str:
    remarks = [p.kind] if p.kind != "fitted" else []
    remarks += [f"interval by {p.interval_kind}"] if p.headline == "noise" and p.interval_kind != "covariance" else []
    remarks += [f"at its {p.at_bound} bound"] if p.at_bound else []
    remarks += [] if p.identifiable else ["not determined by the data"]
    return ", ".join(remarks)


def as_json(result: Fit) -> dict[str, Any]:
    """``fit.json`` of the contract."""
    reference = result.reference
    return {
        "verdict": result.verdict,
        "reasons": result.reasons,
        **{question: found._asdict() for question, found in _answers(result)},
        "notes": result.notes,
        "parameters": {
            name: {
                "value": p.value,
                "unit": p.unit,
                "ci95": p.ci95,
                "headline": p.headline or None,
                "with_budget": p.with_budget,
                "intervals": p.intervals,
                "identifiable": p.identifiable,
                "at_bound": p.at_bound or None,
                "kind": p.kind,
                "interval": p.interval_kind if p.headline == "noise" else None,
            }
            for name, p in result.parameters.items()
        },
        "reference": None
        if reference is None
        else {
            "penetration": reference.penetration,
            "force": reference.force,
            "ci95": reference.ci95,
            "with_budget": reference.with_budget,
        },
        "tests": [
            {"name": t.name, "value": float(t.value), "threshold": float(t.threshold), "passed": bool(t.passed)}
            for t in result.tests
        ],
        "starts": result.starts,
        "residual": result.residual,
        "noise": result.noise,
        "check": result.check,
        "held_out": result.held_out,
        "systematic": [line._asdict() for line in result.systematic.lines] if result.systematic else [],
        "correlation": None
        if result.correlation is None
        else {"labels": list(result.labels), "matrix": result.correlation},
        "seed": result.seed,
        "conditional": _conditional(result),
        **uncertainty.as_json(result.evidence),
    }


def _conditional(result: Fit) -> dict[str, Any] | None:
    """``conditional`` of ``fit.json``: the intervals that hold on a condition which the record leaves open."""
    found = result.conditional
    if found is None:
        return None
    own = {n: {k: getattr(p, k) for k in ("value", "unit", "ci95", "with_budget")} for n, p in found.parameters.items()}
    r = found.reference
    reference = r and {k: getattr(r, k) for k in ("penetration", "force", "ci95", "with_budget")}
    return {"condition": found.condition, "parameters": own, "reference": reference}


def _comparisons(outcome: Outcome) -> list[tuple[str, list[list[str]]]]:
    """Tables of contacts between flights, of models and of candidates, with what is said of them."""
    seen = apart.rows(outcome.fit)
    found = [(apart.HEADING, seen)] if seen else []
    if outcome.choice:
        found.append((f"Models: {'; '.join(outcome.choice.reasons)}", choice.table(outcome.choice)))
        if agreed := agreement.of_choice(outcome.choice):
            found.append((agreement.heading(agreed), agreement.rows(agreed)))
    if outcome.gains:
        heading = "The next experiment: width of each interval after it, over that before (* shrinks most)"
        found.append((heading, candidates_table(outcome.gains)))
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


def _explained(outcome: Outcome, diagnosed: diagnosis.Diagnosis | None) -> list[tuple[str, list[list[str]]]]:
    return sections(diagnosed, outcome.fit) if diagnosed else []


def _write(
    folder: Path,
    path: Path,
    outcome: Outcome,
    starts: int,
    seconds: float,
    diagnosed: diagnosis.Diagnosis | None,
    absurd: Sequence[plausibility.Finding],
) -> None:
    """The result. The journal is there until ``_draw`` is done: cut off before, the same command completes the folder."""
    problem, result = outcome.problem, outcome.fit
    _write_scene(folder / "fitted_scene.toml", path, outcome.base, result)
    outputs.write_toml(
        folder / "run.toml",
        _resolved(path, outcome.base, problem, result.seed, starts),
        f"resolved input of bcfj calibrate {path.name}",
    )
    data = sources(path)
    outputs.write_json(folder / "environment.json", outputs.environment(seed=result.seed, data=data))
    if outcome.choice:
        outputs.write_json(folder / "models.json", choice.as_json(outcome.choice))
    said: dict[str, Any] = {"diagnosis": diagnosis_json(diagnosed, result)} if diagnosed else {}
    agreed = (outcome.choice and agreement.of_choice(outcome.choice)) or (diagnosed and diagnosed.agreed)
    said |= {"elastic_force": agreement.as_json(agreed)} if agreed else {}
    outputs.write_json(
        folder / "fit.json",
        {
            **as_json(result),
            "plausibility": plausibility.content(absurd),
            **_compared(outcome),
            **said,
            "wall_s": seconds,
        },
    )


def _draw(
    folder: Path,
    path: Path,
    outcome: Outcome,
    understood: list[Prepared],
    diagnosed: diagnosis.Diagnosis | None,
    absurd: Sequence[plausibility.Finding],
) -> None:
    """Pictures, and the report that holds them."""
    from calibration.data import plot as dataplot
    from calibration.report import page, plots

    problem, result = outcome.problem, outcome.fit
    drawn = [
        plots.records(result, problem, folder / "fit.png"),
        plots.force_penetration(result, problem, folder / "force_penetration.png"),
        dataplot.data(understood, folder / "data.png"),
        plots.starts(result, folder / "starts.png"),
        *plots_uncertainty.draw(result, folder),
    ]
    notes = [[record.name, note] for record in understood for note in record.notes]
    note = " ".join([*_on_condition(result)[:1], "* in the table below marks the kind that is printed here."])
    found = [Table("Parameters", [_head(result), *_rows(result)], note,
                   (Table("Every kind of interval (* the one printed)", _kinds(result)),))]  # fmt: skip
    answers = [["question", "answer", "because"], *_answer_rows(result)]
    answers = answers if any(row[2] for row in answers[1:]) else [row[:2] for row in answers]
    found.append(Table("The three questions behind the verdict", answers))
    found += [page.block(heading, rows) for heading, rows in _explained(outcome, diagnosed)]
    if result.systematic:
        found.append(Table(_BUDGET, _budget_rows(result)))
    if result.held_out:
        head = ["record", "largest error of the peak", "rms of the peak, where the force acts"]
        rows = [
            [n, percent(e["max_error_of_peak"]), percent(e["rms_error_of_peak"])] for n, e in result.held_out.items()
        ]
        found.append(Table("Records that were held out", [head, *rows]))
    found += [page.block(heading, rows) for heading, rows in _comparisons(outcome)]
    folded = [
        Table("Tests", [["test", "value", "limit", "passed"], *[_test_row(t) for t in result.tests]]),
        Table("Data: what was understood of each record", [["record", "what was understood"], *notes]),
    ]
    shown = [one for one in drawn if one is not None]
    verdict, words = plausibility.judged(absurd, page.verdict(result)), (*result.reasons, *result.notes)
    made = Page(
        f"Calibration of {path.name}", verdict, tuple(shown[:2]), words, tuple(found), tuple(shown[2:]), tuple(folded)
    )
    report.write(folder, made, outcome.base.scene.model_form)


def _compared(outcome: Outcome) -> dict[str, Any]:
    """What ``fit.json`` says of other models and candidates."""
    found: dict[str, Any] = {"model": outcome.choice.chosen} if outcome.choice else {}
    return found | ({"next_experiment": candidates_json(outcome.gains)} if outcome.gains else {})


def _answer_rows(result: Fit) -> list[list[str]]:
    return [[question, found.answer, "; ".join(found.because)] for question, found in _answers(result)]


def _test_row(t: Any) -> list[str]:
    return [t.name, f"{t.value:.4g}", f"{t.threshold:.4g}", "yes" if t.passed else "NO"]


def _write_scene(target: Path, path: Path, base: scenefile.SceneFile, result: Fit) -> None:
    """A scene file with the fitted shared values, ready for ``bcfj simulate``."""
    resolved = base.resolved
    fitted = {n: v for n, v in result.values.items() if n in resolved["parameters"]}
    content = {**resolved, "parameters": {**resolved["parameters"], **fitted}}
    outputs.write_toml(target, content, f"fitted by bcfj calibrate {path.name}; verdict: {result.verdict}")


def _resolved(path: Path, base: scenefile.SceneFile, problem: Problem, seed: int, starts: int) -> dict[str, Any]:
    """The problem with every default, SI: what ``run.toml`` gets."""
    return {
        "problem": str(path),
        "seed": seed,
        "starts": starts,
        "loss": problem.loss,
        "accuracy": problem.accuracy,
        "adequate": problem.adequate,
        "scene": base.resolved,
        "experiment": [
            {
                "name": e.name,
                "source": e.source,
                "hold_out": e.hold_out,
                "samples": int(e.times.size),
                "parameters": e.fixed,
                "bounds": {name: list(own) for name, own in e.bounds.items()},
                "noise": {c.observes: "estimate" if c.sigma is None else c.sigma for c in e.channels},
            }
            for e in problem.experiments
        ],
        "free": {
            f.name: {
                "lower": f.lower,
                "upper": f.upper,
                "scale": "log" if f.log else "linear",
                "each": f.per_experiment,
                **({} if f.start is None else {"start": f.start}),
            }
            for f in problem.free
        },
    }
