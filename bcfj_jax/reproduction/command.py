"""``bcfj reproduce``: the paper's run beside the model, in a folder and in a few lines."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from bcfj_jax.io import outputs, report
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Table, Verdict, counted
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.model import joint_of_keys
from bcfj_jax.models.joint.scene import PLAIN, Joint
from bcfj_jax.reproduction import frames, pictures, sudden, tables
from bcfj_jax.reproduction.claims import CLAIMS, FIGURE
from bcfj_jax.reproduction.fit import ERROR, PeakFit, fit, targets
from bcfj_jax.reproduction.measures import Inequality, Measured, inequalities, measure, residuals
from bcfj_jax.reproduction.peaks import TARGETS
from bcfj_jax.reproduction.record import ACCURACY, END, STEP, Record, record
from bcfj_jax.solve.simulation import Run

FILES = ("reproduce.json", "reproduce.md", *report.FILES, "environment.json", "run.toml", *pictures.FILES)
TITLE = "The paper's run beside the model"
# Share of the clearances that the run with small ones keeps.
TIGHT = 0.1
GIVEN, SUDDEN, CALIBRATED = tables.VARIANTS
SMALL = "small clearances"

Say = Callable[[str], None]
# Tables that the report shows beside the claims; the others are folded.
_FITTED, _QUALITATIVE = "Peaks fitted: not predictions", "Qualitative claims"
_OPEN = (_FITTED, _QUALITATIVE)


def tightened(params: Params) -> Params:
    """The same joint with small clearances."""
    return {name: value * TIGHT if name.startswith("clearance_") else value for name, value in params.items()}


def run(out: Path | None, say: Say, end: float = END) -> tuple[str, bool]:
    """Run the paper's case, fit, measure, draw and write.

    Args:
        out: folder for the results, None for one made up.
        say: receives the progress.
        end: time simulated [s]; the paper's, but for tests.

    Returns:
        The results in words, and whether every simulation ended well.

    Raises:
        InputError: where something would be overwritten.
    """
    folder = outputs.open_folder(out, "reproduce", "joint", FILES)
    begin = time.perf_counter()
    scene = joint_of_keys(**PLAIN)
    params = scene.parameters()
    records: dict[str, Record] = {}

    def simulate(name: str, with_params: Params) -> None:
        say(f"simulating the joint to {end:g} s, {name}")
        records[name] = record(scene, with_params, end)
        done = records[name].run
        stats = (
            f"{done.stats['accepted']} steps, {done.stats['wall_s']:.1f} s, compiled in {done.stats['compile_s']:.1f} s"
        )
        say(stats if done.status == "ok" else f"failed at {format_si(done.failure_time, 's')}: {done.reason}")

    simulate(GIVEN, params)
    simulate(SMALL, tightened(params))
    say(f"fitting {tables.FITTED_TO} in the quasistatic model")
    found = fit(params, say=say)
    fitted = found.applied(params)
    simulate(CALIBRATED, fitted)
    used = {GIVEN: params, CALIBRATED: fitted}
    instants = 0
    for name in sudden.VARIANTS:
        until = sudden.duration(name, end)
        say(f"simulating the joint to {until:g} s, {name}")
        records[name], used[name] = sudden.simulate(name, until, instants)
        instants = records[name].fine.times.size
    text = _write(folder, scene, used, records, found, end, time.perf_counter() - begin)
    return f"{text}\n\nresults and pictures: {folder}", all(r.run.status == "ok" for r in records.values())


def _good(records: Mapping[str, Record]) -> dict[str, Run]:
    return {name: r.run for name, r in records.items() if r.run.status == "ok"}


def verdict(found: PeakFit, records: Mapping[str, Record]) -> str:
    """The outcome in two sentences, failures first."""
    failed = [f"the run {name} failed at {format_si(r.run.failure_time, 's')} ({r.run.reason})"
              for name, r in records.items() if r.run.status != "ok"]  # fmt: skip
    missed = [
        f"{name} by {miss:+.0%}" for name, miss in zip(TARGETS, found.residuals, strict=True) if abs(miss) > ERROR
    ]
    bounds = f" At a bound: {', '.join(found.at_bound)}." if found.at_bound else ""
    count = sum(e.verdict == "determined" for e in found.estimates.values())
    reached = (
        f"The peaks {tables.FITTED_TO} are reached within {ERROR:.0%} by the fit."
        if not missed
        else f"Misfit: no start found values within physical bounds that give all peaks; the best miss {', '.join(missed)}."
    )
    tested = (
        f"The peaks determine {found.combinations} of the {len(found.estimates)} combinations of unknowns, and "
        f"{counted(count, 'unknown')} by {'itself' if count == 1 else 'themselves'}"
        f"{'' if not missed else ', were the model right'}.{bounds}"
    )
    hand = "" if SUDDEN not in records else by_hand(records[SUDDEN])
    return " ".join([*(f"{f[0].upper()}{f[1:]}." for f in failed), reached, tested, *([hand] if hand else [])])


def by_hand(record: Record) -> str:
    """What the sudden start reaches, and what that is worth."""
    if record.run.status != "ok":
        return ""
    peaks = next(iter(sudden.start(record).peaks.values()))
    worst = float(np.max(np.abs(peaks / targets() - 1.0)))
    return f"A sudden start meets all six peaks within {worst:.0%}. {sudden.IDENTIFIES}"


def _write(
    folder: Path,
    scene: Joint,
    used: Mapping[str, Params],
    records: Mapping[str, Record],
    found: PeakFit,
    end: float,
    seconds: float,
) -> str:
    """Every file of ``FILES``; the results in words."""
    params = used[GIVEN]
    turn = float(2.0 * jnp.pi / params["drive_speed"])
    runs = _good(records)
    columns = [name for name in tables.VARIANTS if name in runs]
    measured = {n: measure(runs[n], records[n].balance, turn, records[n].fine) for n in columns}
    seen = {n: {frame: frames.measured(records[n], frame, turn) for frame in frames.FRAMES} for n in columns}
    frame = frames.sensible(seen[GIVEN], ERROR) if GIVEN in seen else frames.CONTACT
    # Peaks are those of a size, which no frame changes.
    framed = {id: frame for id in frames.FRAMED if id not in ("Q20", "Q21")}
    for name in columns:
        for id in framed if frame != frames.CONTACT else ():
            measured[name][id] = Measured(seen[name][frame][id])
    tests: dict[str, list[Inequality]] = {}
    for name in columns:
        # The run with small clearances is that of the values as given.
        tests[name] = inequalities(runs[name], turn, runs.get(SMALL) if name == GIVEN else None)
    inputs = tables.used(params, end, STEP, scene.balls)
    given, calibrated = measured.get(GIVEN), measured.get(CALIBRATED)
    main = tables.rows(inputs, measured, tests, framed)
    starts = {name: sudden.start(records[name]) for name in sudden.VARIANTS if name in runs}
    both = {name: residuals(runs[name]) for name in (*columns, SMALL) if name in runs}
    parts: list[tuple[str, Sequence[Sequence[str]]]] = [
        ("Claims", main),
        ("The pilots' forces in the axes of different observers", tables.frame_rows(seen)),
        ("Sudden starts: six peaks met by hand", sudden.rows(starts)),
        (_FITTED, tables.peak_rows(given, found, calibrated)),
        ("Unknowns", tables.unknown_rows(params, found)),
        (f"Combinations of the unknowns that peaks known to {ERROR:.0%} determine", tables.combination_rows(found)),
        ("Residuals, absolute and relative", tables.residual_rows(both)),
        (_QUALITATIVE, tables.inequality_rows(tests)),
        ("Runs", _run_rows(records, seconds)),
    ]
    said = verdict(found, records)
    notes = [tables.AS_GIVEN, tables.CALIBRATED, tables.BOUNDED]
    notes.append(f"{SUDDEN[0].upper()}{SUDDEN[1:]}: {sudden.VARIANTS[SUDDEN][1]}. {sudden.IDENTIFIES}")
    if GIVEN in seen:
        notes.append(frame_note(seen[GIVEN], frame, records[GIVEN]))
    notes.append(tables.SETTLED_WINDOW)
    if np.max(np.abs(found.residuals)) > ERROR:
        notes.append(tables.MISFIT)
    outputs.write_toml(folder / "run.toml", _resolved(used, end), "what bcfj reproduce ran, SI")
    outputs.write_json(folder / "environment.json", outputs.environment(data=[]))
    numbers = _json(main, measured, tests, found, params, records, said, notes, seconds, end)
    numbers |= {"frame": frame, "frames": seen, "residuals": both}
    numbers["sudden_starts"] = {name: {f"{t:g} s": v for t, v in one.peaks.items()} for name, one in starts.items()}
    outputs.write_json(folder / "reproduce.json", numbers)
    outputs.write_text(folder / "reproduce.md", tables.markdown(TITLE, said, notes, parts))
    shown = {name: runs[name] for name in (GIVEN, CALIBRATED) if name in runs}
    started = records[SUDDEN].fine if SUDDEN in runs else None
    drawn = pictures.draw(folder, shown, runs.get(SMALL), records[GIVEN], started) if GIVEN in runs else []
    report.write(folder, _page(found, records, measured, tests, parts, drawn, notes), scene.model_form)
    figures = {row.id for row in CLAIMS if row.kind == FIGURE}
    brief = [main[0][:7]] + [row[:7] for row in main[1:] if row[0] in figures]
    brief = [[row[0], _short(row[1]), _short(row[2]), *row[3:]] for row in brief]
    return "\n\n".join([said, report.text(brief), *notes])


def frame_note(seen: Mapping[str, Mapping[str, tuple[float, ...]]], frame: str, record: Record) -> str:
    """Which frame makes sense of the paper, and how far each gets."""
    period = {name: seen[name]["Q17"][0] for name in seen}
    once = [name for name in seen if frames.reached((period[name],) * 3, "Q17", ERROR)]
    behind = np.degrees(frames.slip(record))
    return (
        f"The frame decides the period: as given, the normal force of point 1 repeats itself after {period['contact']:.3f} s in "
        f"the contact's own frame, and after one turn in the axes {', '.join(once) or 'of none'} (of a cage that is "
        f"{behind:.0f} deg behind its balls at the end: {period['cage']:.3f} s). The paper's 0.615 s makes sense in axes that "
        f"turn with a part. Q17 to Q19, Q22, Q35 and Q36 are read in the axes '{frame}': {frames.FRAMES[frame]}. The axial "
        f"force keeps {seen[frame]['Q17'][1]:.3f} s there."
    )


def _page(
    found: PeakFit,
    records: Mapping[str, Record],
    measured: Mapping[str, Mapping[str, Measured]],
    tests: Mapping[str, Sequence[Inequality]],
    parts: Sequence[tuple[str, Sequence[Sequence[str]]]],
    drawn: Sequence[Picture],
    notes: Sequence[str],
) -> Page:
    """The report: how many of the paper's claims the model reaches, and the table of them."""
    first, *others = [Table(title, rows) for title, rows in parts]
    first = _folded(
        first, f"Three verdicts are those of the three runs, in order. {tables.AS_GIVEN} {tables.CALIBRATED}"
    )
    folded = tuple(table for table in others if table.title not in _OPEN)
    others = [table for table in others if table.title in _OPEN]
    name = CALIBRATED if CALIBRATED in measured else GIVEN
    if name not in measured:
        return Page(
            TITLE, Verdict(BAD, "Failed", verdict(found, records)), (), tuple(notes), (first, *others), folded=folded
        )
    reached, missed, open_ = counts(measured[name])
    total = len(reached) + len(missed) + len(open_)
    held = [t.holds for t in tests[name]]
    fitted = [id for id in reached if id in tables.FITTED_TO.split(", ")]
    sentence = (
        f"Of {total} claims with a number the {name} model reaches {len(reached)} within {ERROR:.0%} "
        f"({len(fitted)} of them were fitted), misses {len(missed)}, and {len(open_)} cannot be decided; "
        f"{held.count(True)} of {len(held)} qualitative claims hold, {held.count(None)} cannot be decided."
    )
    good = not missed and all(r.run.status == "ok" for r in records.values())
    word = (
        Verdict(GOOD, "Reached", sentence)
        if good
        else Verdict(FAIR if reached else BAD, "Partly reached" if reached else "Missed", sentence)
    )
    # What is said of the columns stands below the table.
    warnings = [note for note in notes if note not in (tables.AS_GIVEN, tables.CALIBRATED, tables.BOUNDED)]
    leading = sorted(drawn, key=lambda one: one.file not in pictures.LEADING)
    return Page(
        TITLE, word, tuple(leading[:2]), (verdict(found, records), *warnings), (first, *others), tuple(leading[2:]),
        folded=folded,
    )  # fmt: skip


def _folded(claims: Table, note: str) -> Table:
    """The claims that the paper's simulation gave, with verdicts; how each is read, inputs and statements are folded."""
    head, *rows = claims.rows
    figures = {row.id for row in CLAIMS if row.kind == FIGURE}
    at = head.index("verdict")
    # What a reader looks for fits on the screen.
    shown = (head, *(row for row in rows if row[0] in figures))
    first = [[row[0], row[1], row[at], _short(row[2], 30), *row[3:at]] for row in shown]
    how = [[row[0], row[1], *row[at + 1 :]] for row in shown]
    rest = [head, *(row for row in rows if row[0] not in figures)]
    return Table(
        claims.title, first, note,
        (Table("How each claim is read, and remarks", how), Table("Inputs and statements of the paper", rest)),
    )  # fmt: skip


def counts(found: Mapping[str, Measured]) -> tuple[list[str], list[str], list[str]]:
    """Ids of the paper's figures that the model reaches within ``ERROR``, misses, and that cannot be decided."""
    kinds: dict[str, list[str]] = {tables.REACHED: [], tables.MISSED: [], tables.OPEN: []}
    for row in CLAIMS:
        if row.kind == FIGURE and row.values:
            kinds[tables.verdict_of(row, found)].append(row.id)
    return kinds[tables.REACHED], kinds[tables.MISSED], kinds[tables.OPEN]


def _short(text: str, most: int = 44) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _run_rows(records: Mapping[str, Record], seconds: float) -> list[list[str]]:
    table = [["run", "status", "steps accepted", "rejected", "wall time", "compile time"]]
    for name, r in records.items():
        stats = r.run.stats
        status = r.run.status if r.run.status == "ok" else f"failed at {r.run.failure_time:.4g} s: {r.run.reason}"
        numbers = [
            str(stats["accepted"]),
            str(stats["rejected"]),
            *(f"{stats[k]:.2f} s" for k in ("wall_s", "compile_s")),
        ]
        table.append([name, status, *numbers])
    return [*table, ["in all", "", "", "", f"{seconds:.1f} s", ""]]


def _resolved(used: Mapping[str, Params], end: float) -> dict[str, Any]:
    return {
        "scene": {"kind": "joint", "friction": True},
        "sudden_scene": {"kind": "joint", "law": "adams_impact", "spin": False, "window_ends": False},
        "time": {"end": end, "step": STEP},
        "accuracy": {"force_error": ACCURACY},
        "small_clearances": TIGHT,
        **{
            name.replace(",", "").replace(" ", "_"): {key: float(value) for key, value in params.items()}
            for name, params in used.items()
        },
    }


def _json(
    main: Sequence[Sequence[str]],
    measured: Mapping[str, Mapping[str, Measured]],
    tests: Mapping[str, Sequence[Inequality]],
    found: PeakFit,
    params: Params,
    records: Mapping[str, Record],
    said: str,
    notes: Sequence[str],
    seconds: float,
    end: float,
) -> dict[str, Any]:
    """``reproduce.json``: the table in numbers, the fit, the runs."""
    claims = []
    for row, cells in zip(CLAIMS, main[1:], strict=True):
        entry: dict[str, Any] = row._asdict() | {
            "remark": cells[-1],
            "verdict": cells[6],
            "read_in": cells[7],
            "picture": cells[8],
            "fitted_to": row.id in tables.FITTED_TO.split(", "),
        }
        for column, name in enumerate(tables.VARIANTS, 3):
            value = measured.get(name, {}).get(row.id)
            entry[name.replace(" ", "_")] = {"values": value.values if value else None, "text": cells[column]}
        claims.append(entry)
    return {
        "verdict": said,
        "notes": notes,
        "claims": claims,
        "qualitative": {name: [t._asdict() for t in each] for name, each in tests.items()},
        "fit": tables.fit_json(found, params) | {"paper": targets()},
        "options": {"end": end, "step": STEP, "accuracy": ACCURACY, "small_clearances": TIGHT},
        "runs": {
            name: {"status": r.run.status, "reason": r.run.reason, "failure_time": r.run.failure_time, **r.run.stats}
            for name, r in records.items()
        },
        "seconds": seconds,
    }
