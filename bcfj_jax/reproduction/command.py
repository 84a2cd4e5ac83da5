"""``bcfj reproduce``: the paper's run beside the model, in a folder and in a few lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.io import outputs, report
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Rows, Table, Verdict, counted
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.model import joint_of_keys
from bcfj_jax.models.joint.scene import PLAIN, Joint
from bcfj_jax.reproduction import frames, pictures, sudden, tables
from bcfj_jax.reproduction.claims import CLAIMS, FIGURE
from bcfj_jax.reproduction.fit import ERROR, TARGETS, PeakFit, fit, targets
from bcfj_jax.reproduction.measures import Inequality, Measured, inequalities, measure, residuals
from bcfj_jax.reproduction.record import ACCURACY, END, STEP, Record, record
from bcfj_jax.solve.simulation import Run

FILES = ("reproduce.json", "reproduce.md", *report.FILES, "environment.json", "run.toml", *pictures.FILES)
TITLE = "The paper's run beside the model"
# Share of the clearances that the run with small ones keeps.
TIGHT = 0.1
GIVEN, SUDDEN, CALIBRATED = tables.VARIANTS
SMALL = "small clearances"
# Tables that the report shows beside the claims; the others are folded.
_FITTED, _QUALITATIVE = "Peaks fitted: not predictions", "Qualitative claims"
_FIGURES = frozenset(row.id for row in CLAIMS if row.kind == FIGURE)


class Outcome(NamedTuple):
    """What was run, by name, and what follows from it."""

    # scene, used, records, fit: the joint as given; parameters; the runs, failed ones too; the fit to the paper's
    # peaks.
    scene: Joint
    used: Mapping[str, Params]
    records: Mapping[str, Record]
    fit: PeakFit
    # end, seconds: time simulated, and that all of it took [s].
    end: float
    seconds: float
    runs: dict[str, Run]  # those that ended well
    # seen, frame: by variant and frame the claims that depend on the frame; the one that makes most sense of the paper.
    seen: dict[str, dict[str, dict[str, tuple[float, ...]]]]
    frame: str
    # measured, tests: by variant the numbers of each claim, and the qualitative claims.
    measured: dict[str, dict[str, Measured]]
    tests: dict[str, list[Inequality]]
    claims: list[list[str]]  # the table of claims
    starts: dict[str, dict[float, np.ndarray]]  # six peaks of every sudden start, by how finely they are read [s]
    residuals: dict[str, dict[str, tuple[float, float]]]  # by run and contact what the polynomial leaves over


def assess(
    scene: Joint, used: Mapping[str, Params], records: Mapping[str, Record], found: PeakFit, end: float, seconds: float
) -> Outcome:
    """Measure the runs. Arguments as the attributes of ``Outcome``."""
    turn = 2.0 * np.pi / float(used[GIVEN]["drive_speed"])
    runs = {name: r.run for name, r in records.items() if r.run.status == "ok"}
    good = {name: records[name] for name in tables.VARIANTS if name in runs}
    seen = {n: {frame: frames.measured(r, frame, turn) for frame in frames.FRAMES} for n, r in good.items()}
    frame = frames.sensible(seen[GIVEN], ERROR) if GIVEN in seen else frames.CONTACT
    # Peaks are those of a size, which no frame changes.
    framed = {id: frame for id in frames.FRAMED if id not in ("Q20", "Q21")}
    measured = {name: measure(r.run, r.balance, turn, r.fine) for name, r in good.items()}
    for name in good if frame != frames.CONTACT else ():
        measured[name] |= {id: Measured(seen[name][frame][id]) for id in framed}
    # The run with small clearances is that of the values as given.
    tests = {n: inequalities(r.run, turn, runs.get(SMALL) if n == GIVEN else None) for n, r in good.items()}
    claims = tables.rows(tables.used(used[GIVEN], end, STEP, scene.balls), measured, tests, framed)
    starts = {name: sudden.start(records[name]) for name in sudden.VARIANTS if name in runs}
    left = {name: residuals(runs[name]) for name in (*good, SMALL) if name in runs}
    return Outcome(
        scene, used, records, found, end, seconds, runs, seen, frame, measured, tests, claims, starts, left,
    )  # fmt: skip


def verdict(o: Outcome) -> str:
    """The outcome in a few sentences, failures first."""
    failed = [
        f"The run {name} failed at {format_si(r.run.failure_time, 's')} ({r.run.reason})."
        for name, r in o.records.items()
        if name not in o.runs
    ]
    found, each = o.fit, zip(TARGETS, o.fit.residuals, strict=True)
    missed = [f"{name} by {miss:+.0%}" for name, miss in each if abs(miss) > ERROR]
    reached = (
        f"Misfit: no start found values within physical bounds that give all peaks; the best miss {', '.join(missed)}."
        if missed
        else f"The peaks {tables.FITTED_TO} are reached within {ERROR:.0%} by the fit."
    )
    count = sum(e.verdict == "determined" for e in found.estimates.values())
    tested = (
        f"The peaks determine {found.combinations} of the {len(found.estimates)} combinations of unknowns, and "
        f"{counted(count, 'unknown')} by {'itself' if count == 1 else 'themselves'}"
        f"{', were the model right' if missed else ''}."
    )
    bounds = [f"At a bound: {', '.join(found.at_bound)}."] if found.at_bound else []
    hand = []
    if SUDDEN in o.starts:
        worst = float(np.max(np.abs(next(iter(o.starts[SUDDEN].values())) / targets() - 1.0)))
        hand = [f"A sudden start meets all six peaks within {worst:.0%}. {sudden.IDENTIFIES}"]
    return " ".join([*failed, reached, tested, *bounds, *hand])


def notes(o: Outcome) -> list[str]:
    """What must be known to read the tables."""
    words = f"{SUDDEN[0].upper()}{SUDDEN[1:]}: {sudden.VARIANTS[SUDDEN][1]}. {sudden.IDENTIFIES}"
    found = [tables.AS_GIVEN, tables.CALIBRATED, tables.BOUNDED, words]
    if GIVEN in o.seen:
        seen = o.seen[GIVEN]
        period = {name: numbers["Q17"][0] for name, numbers in seen.items()}
        once = [name for name in seen if frames.reached((period[name],) * 3, "Q17", ERROR)]
        behind = np.degrees(frames.slip(o.records[GIVEN]))
        found.append(
            f"The frame decides the period: as given, the normal force of point 1 repeats itself after "
            f"{period['contact']:.3f} s in the contact's own frame, and after one turn in the axes "
            f"{', '.join(once) or 'of none'} (of a cage that is {behind:.0f} deg behind its balls at the end: "
            f"{period['cage']:.3f} s). The paper's 0.615 s makes sense in axes that turn with a part. Q17 to Q19, Q22, Q35 "
            f"and Q36 are read in the axes '{o.frame}': {frames.FRAMES[o.frame]}. The axial force keeps "
            f"{seen[o.frame]['Q17'][1]:.3f} s there."
        )
    found.append(tables.SETTLED_WINDOW)
    return found + ([tables.MISFIT] if np.max(np.abs(o.fit.residuals)) > ERROR else [])


def parts(o: Outcome) -> list[tuple[str, Rows]]:
    """Every table, the claims first."""
    combinations = f"Combinations of the unknowns that peaks known to {ERROR:.0%} determine"
    return [
        ("Claims", o.claims),
        ("The pilots' forces in the axes of different observers", tables.frame_rows(o.seen)),
        ("Sudden starts: six peaks met by hand", sudden.rows(o.starts)),
        (_FITTED, tables.peak_rows(o.measured.get(GIVEN), o.fit, o.measured.get(CALIBRATED))),
        ("Unknowns", tables.unknown_rows(o.used[GIVEN], o.fit)),
        (combinations, tables.combination_rows(o.fit)),
        ("Residuals, absolute and relative", tables.residual_rows(o.residuals)),
        (_QUALITATIVE, tables.inequality_rows(o.tests)),
        ("Runs", _run_rows(o.records, o.seconds)),
    ]


def tightened(params: Params) -> Params:
    """The same joint with small clearances."""
    return {name: value * TIGHT if name.startswith("clearance_") else value for name, value in params.items()}


def run(out: Path | None, say: Callable[[str], None], end: float = END) -> tuple[str, bool]:
    """Run the paper's case to ``end`` [s], fit, measure, draw and write: the results in words, and whether all runs went well."""
    folder = outputs.open_folder(out, "joint", outputs.Claim("reproduce", FILES))
    begin = time.perf_counter()
    scene = joint_of_keys(**PLAIN)
    params = scene.parameters()
    records: dict[str, Record] = {}

    def simulate(name: str, with_params: Params) -> None:
        say(f"simulating the joint to {end:g} s, {name}")
        records[name] = record(scene, with_params, end)
        done, stats = records[name].run, records[name].run.stats
        cost = f"{stats['accepted']} steps, {stats['wall_s']:.1f} s, compiled in {stats['compile_s']:.1f} s"
        say(cost if done.status == "ok" else f"failed at {format_si(done.failure_time, 's')}: {done.reason}")

    simulate(GIVEN, params)
    simulate(SMALL, tightened(params))
    say(f"fitting {tables.FITTED_TO} in the quasistatic model")
    found = fit(params, say=say)
    used = {GIVEN: params, CALIBRATED: found.applied(params)}
    simulate(CALIBRATED, used[CALIBRATED])
    instants = 0
    for name in sudden.VARIANTS:
        until = sudden.duration(name, end)
        say(f"simulating the joint to {until:g} s, {name}")
        records[name], used[name] = sudden.simulate(name, until, instants)
        instants = records[name].fine.times.size
    outcome = assess(scene, used, records, found, end, time.perf_counter() - begin)
    text = write(folder, outcome)
    return f"{text}\n\nresults and pictures: {folder}", len(outcome.runs) == len(records)


def write(folder: Path, o: Outcome) -> str:
    """Every file of ``FILES``; the results in words."""
    said, about, shown = verdict(o), notes(o), parts(o)
    outputs.write_origin(folder, _resolved(o), "what bcfj reproduce ran, SI", outputs.environment())
    outputs.write_json(folder / "reproduce.json", {"verdict": said, "notes": about, **_json(o)})
    outputs.write_text(folder / "reproduce.md", tables.markdown(TITLE, said, about, shown))
    runs = {name: o.runs[name] for name in (GIVEN, CALIBRATED) if name in o.runs}
    started = o.records[SUDDEN].fine if SUDDEN in o.runs else None
    drawn = pictures.draw(folder, runs, o.runs.get(SMALL), o.records[GIVEN], started) if GIVEN in o.runs else []
    report.write(folder, _page(o, shown, drawn), o.scene.model_form)
    rows = [row[:7] for row in o.claims if row[0] in _FIGURES or row is o.claims[0]]
    brief = [[row[0], _short(row[1]), _short(row[2]), *row[3:]] for row in rows]
    return "\n\n".join([said, report.text(brief), *about])


def _page(o: Outcome, shown: Sequence[tuple[str, Rows]], drawn: Sequence[Picture]) -> Page:
    """The report: how many of the paper's claims the model reaches, and the table of them."""
    first, *others = [Table(title, rows) for title, rows in shown]
    first = _folded(
        first, f"Three verdicts are those of the three runs, in order. {tables.AS_GIVEN} {tables.CALIBRATED}"
    )
    open_, folded = [], []
    for table in others:
        (open_ if table.title in (_FITTED, _QUALITATIVE) else folded).append(table)
    said, about = verdict(o), notes(o)
    if not {GIVEN, CALIBRATED} & set(o.measured):
        return Page(TITLE, Verdict(BAD, "Failed", said), (), tuple(about), (first, *open_), folded=tuple(folded))
    # What is said of the columns stands below the table.
    warnings = [said, *(note for note in about if note not in (tables.AS_GIVEN, tables.CALIBRATED, tables.BOUNDED))]
    leading = sorted(drawn, key=lambda one: one.file not in pictures.LEADING)
    return Page(
        TITLE, _reached(o), tuple(leading[:2]), tuple(warnings), (first, *open_), tuple(leading[2:]), tuple(folded)
    )


def _reached(o: Outcome) -> Verdict:
    """How many of the paper's claims the calibrated model reaches, or else the one as given."""
    name = CALIBRATED if CALIBRATED in o.measured else GIVEN
    kinds: dict[str, list[str]] = {tables.REACHED: [], tables.MISSED: [], tables.OPEN: []}
    for row in CLAIMS:
        if row.kind == FIGURE and row.values:
            kinds[tables.verdict_of(row, o.measured[name])].append(row.id)
    reached, missed, open_ = kinds.values()
    held = [t.holds for t in o.tests[name]]
    sentence = (
        f"Of {len(reached) + len(missed) + len(open_)} claims with a number the {name} model reaches {len(reached)} within "
        f"{ERROR:.0%} ({sum(id in tables.FITTED for id in reached)} of them were fitted), misses {len(missed)}, and "
        f"{len(open_)} cannot be decided; {held.count(True)} of {len(held)} qualitative claims hold, {held.count(None)} "
        "cannot be decided."
    )
    if not missed and len(o.runs) == len(o.records):
        return Verdict(GOOD, "Reached", sentence)
    return Verdict(FAIR, "Partly reached", sentence) if reached else Verdict(BAD, "Missed", sentence)


def _folded(claims: Table, note: str) -> Table:
    """The claims that the paper's simulation gave, with verdicts; how each is read, inputs and statements are folded."""
    head, *rows = claims.rows
    at = list(head).index("verdict")
    # What a reader looks for fits on the screen.
    shown = (head, *(row for row in rows if row[0] in _FIGURES))
    first = [[row[0], row[1], row[at], _short(row[2], 30), *row[3:at]] for row in shown]
    how = [[row[0], row[1], *row[at + 1 :]] for row in shown]
    rest = [head, *(row for row in rows if row[0] not in _FIGURES)]
    below = (Table("How each claim is read, and remarks", how), Table("Inputs and statements of the paper", rest))
    return Table(claims.title, first, note, below)


def _short(text: str, most: int = 44) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _run_rows(records: Mapping[str, Record], seconds: float) -> list[list[str]]:
    table = [["run", "status", "steps accepted", "rejected", "wall time", "compile time"]]
    for name, r in records.items():
        stats = r.run.stats
        status = r.run.status if r.run.status == "ok" else f"failed at {r.run.failure_time:.4g} s: {r.run.reason}"
        walls = (f"{stats[k]:.2f} s" for k in ("wall_s", "compile_s"))
        table.append([name, status, str(stats["accepted"]), str(stats["rejected"]), *walls])
    return [*table, ["in all", "", "", "", f"{seconds:.1f} s", ""]]


def _resolved(o: Outcome) -> dict[str, Any]:
    plain = {name: {key: float(value) for key, value in params.items()} for name, params in o.used.items()}
    return {
        "scene": {"kind": "joint", "friction": True},
        "sudden_scene": {"kind": "joint", "law": "adams_impact", "spin": False, "window_ends": False},
        "time": {"end": o.end, "step": STEP},
        "accuracy": {"force_error": ACCURACY},
        "small_clearances": TIGHT,
        **{name.replace(",", "").replace(" ", "_"): values for name, values in plain.items()},
    }


def _json(o: Outcome) -> dict[str, Any]:
    """``reproduce.json``: the table in numbers, the fit, the runs."""
    claims = []
    for row, cells in zip(CLAIMS, o.claims[1:], strict=True):
        entry: dict[str, Any] = row._asdict()
        entry |= dict(zip(("verdict", "read_in", "picture", "remark"), cells[6:], strict=True))
        entry["fitted_to"] = row.id in tables.FITTED
        for column, name in enumerate(tables.VARIANTS, 3):
            value = o.measured.get(name, {}).get(row.id)
            entry[name.replace(" ", "_")] = {"values": value.values if value else None, "text": cells[column]}
        claims.append(entry)
    return {
        "claims": claims,
        "qualitative": {name: [t._asdict() for t in each] for name, each in o.tests.items()},
        "fit": tables.fit_json(o.fit, o.used[GIVEN]) | {"paper": targets()},
        "options": {"end": o.end, "step": STEP, "accuracy": ACCURACY, "small_clearances": TIGHT},
        "runs": {
            name: {"status": r.run.status, "reason": r.run.reason, "failure_time": r.run.failure_time, **r.run.stats}
            for name, r in o.records.items()
        },
        "seconds": o.seconds,
        "frame": o.frame,
        "frames": o.seen,
        "residuals": o.residuals,
        "sudden_starts": {n: {f"{t:g} s": v for t, v in peaks.items()} for n, peaks in o.starts.items()},
    }
