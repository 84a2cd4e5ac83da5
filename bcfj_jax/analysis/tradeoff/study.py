"""The study: reference first, then settings, cheap ones before dear ones, until all are done or the time is spent."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.tradeoff import reference as references
from bcfj_jax.analysis.tradeoff.measures import (
    UNKNOWN,
    compared,
    derivative_error,
    errors,
    measured,
    peak_change,
    worst,
)
from bcfj_jax.analysis.tradeoff.reference import Reference, reference, restore
from bcfj_jax.analysis.tradeoff.settings import MODEL, Setting
from bcfj_jax.analysis.tradeoff.trial import loaded, single, slopes, trial
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.io.stop import OutOfTime, check, within

OK, FAILED = "ok", "failed"
NO_TIME, CUT_OFF, NO_REFERENCE = "not run: budget", "not run: interrupted", "not run: no reference"
COLUMNS = (
    "setting", "force_rms_error", "peak_error", "impulse_error", "derivative_error", "wall_s", "compile_s", "status",
    "pareto", "period_error", "dissipated_error", "group", "force_error", "precision", "steps", "repeats",
    "derivative_wall_s", "derivative_compile_s", "at_reference", "reason", "contact", "peak_change",
)  # fmt: skip
_NOTHING = {name: float("nan") for name in COLUMNS[1:7]} | {
    "status": FAILED, "pareto": False, **UNKNOWN, "precision": "", "steps": 0, "repeats": 0,
    "derivative_wall_s": float("nan"), "derivative_compile_s": float("nan"), "at_reference": False, "reason": "",
    "contact": "", "peak_change": float("nan"),
}  # fmt: skip
# A row that lacks them is not kept: another call may have the time.
_NO_SLOPES = "no derivatives: too little time was left"
# How much dearer the next level of a ladder is taken to be, at least.
_NEXT = 1.5


class Study(NamedTuple):
    """What a study found.

    Attributes:
        settings: all there are, in the order they are run.
        rows: of each a row with ``COLUMNS``; NaN for what is unknown.
        reference: the truth, or None where it was cut off before.
        interrupted: whether Ctrl-C ended it.
    """

    settings: list[Setting]
    rows: list[dict[str, Any]]
    reference: Reference | None
    interrupted: bool


class _Clock:
    """Seconds left, and what the next piece of work will take by those before it, compiling included."""

    def __init__(self, budget: float) -> None:
        self._end = time.monotonic() + budget
        self._compiles: list[float] = []
        self._tangents: list[float] = []
        self._programs: set[Any] = set()
        self._ladders: dict[str, float] = {}

    def left(self) -> float:
        return self._end - time.monotonic()

    def stop(self) -> None:
        """No more time: something that was left behind still computes, and would disturb what is measured."""
        self._end = -math.inf

    def takes(self, setting: Setting, program: Any) -> float:
        compile_s = statistics.median(self._compiles) if self._compiles and program not in self._programs else 0.0
        return compile_s + _NEXT * self._ladders.get(setting.ladder, 0.0)

    def took(self, setting: Setting, program: Any, row: Mapping[str, Any]) -> None:
        self.compiled([row.get("compile_s", 0.0)], [row.get("derivative_compile_s", 0.0)])
        self._programs.add(program)
        runs = row.get("repeats", 0) * row.get("wall_s", 0.0), row.get("derivative_wall_s", 0.0)
        self._ladders[setting.ladder] = float(np.nansum(runs))

    def compiled(self, values: Sequence[float], tangents: Sequence[float]) -> None:
        """Seconds that compiling took, of values and of derivatives; 0 and NaN where nothing was."""
        self._compiles += [s for s in values if s > 0.0]
        self._tangents += [s for s in tangents if s > 0.0]

    def derivatives(self, program: Any, wall_s: float) -> float:
        """What derivatives will take beside a run of so many seconds."""
        known = self._tangents and program not in self._programs
        return (statistics.median(self._tangents) if known else 0.0) + references.TANGENTS * wall_s


def study(given: SceneFile, todo: list[Setting], journal: Journal, budget: float, say: Callable[[str], None]) -> Study:
    """Measure settings of a scene, which as it stands defines the truth; Ctrl-C ends it with what is finished.

    Args:
        todo: the settings, ``settings.settings``.
        journal: where finished settings are kept, and taken from; the reference's arrays lie beside it.
        budget: seconds; what would not fit any more is not run, and what was begun and did not fit is left behind.
        given, say: the scene; receives the progress.
    """
    clock = _Clock(budget)
    rows = [_NOTHING | {"setting": s.name, "group": s.group, "force_error": s.error, "status": CUT_OFF} for s in todo]
    truth = None
    try:
        truth = _certified(given, any(setting.derivatives for setting in todo), journal, clock, say)
        for number, setting in enumerate(todo):
            check()
            rows[number] |= _row(given, setting, truth, journal, clock)
            if rows[number]["status"] not in (NO_TIME, NO_REFERENCE):
                say(f"[{number + 1}/{len(todo)}] {setting.name}: {_line(rows[number])}")
    except KeyboardInterrupt:
        return Study(todo, _fronted(rows, truth), truth, True)
    return Study(todo, _fronted(rows, truth), truth, False)


def _line(row: dict[str, Any]) -> str:
    if row["status"] != OK:
        return f"{row['status']} {row['reason']}".strip()
    return f"worst error {worst(row):.1e}, {row['wall_s']:.3g} s"


def _certified(
    given: SceneFile, derivatives: bool, journal: Journal, clock: _Clock, say: Callable[[str], None]
) -> Reference:
    kept, folder = journal.get("reference"), journal.path.parent
    if isinstance(kept, dict):
        whole = restore(kept.get("certificate"), folder, kept.get("file"))
        if whole is not None:
            return whole
        say(f"{folder / references.NAME}: is missing or damaged; the reference is computed again")
    found = reference(given, clock.left, say, derivatives)
    parts = found.certificate["methods"], found.certificate["derivatives"]["methods"]
    clock.compiled(*([one.get("compile_s", 0.0) for one in part] for part in parts))
    if found.late:
        clock.stop()
    if found.truth is not None:
        found = found._replace(digest=references.save(found, folder))
        journal.add("reference", {"certificate": found.certificate, "file": found.digest})
    return found


def _row(given: SceneFile, setting: Setting, truth: Reference, journal: Journal, clock: _Clock) -> dict[str, Any]:
    """A setting's row, from the journal or else by running it; a failure is a row too."""
    # What was measured against another reference is no row of this study.
    name = f"{setting.name} {setting.digest} {truth.digest}"
    kept = journal.get(name)
    if isinstance(kept, dict) and set(kept) <= set(COLUMNS) and "status" in kept:
        return {key: float("nan") if value is None else value for key, value in kept.items()}
    if truth.truth is None:
        return {"status": NO_REFERENCE, "reason": truth.certificate["reason"]}
    try:
        file = loaded(setting.table)
        program = (file.scene, len(file.times), file.solver, file.max_steps, setting.bits)
        if clock.takes(setting, program) > clock.left():
            return {"status": NO_TIME, "reason": f"{max(clock.left(), 0.0):.0f} s are left"}
        row = _measured(given, file, setting, program, truth, clock)
        clock.took(setting, program, row)
    except OutOfTime:
        clock.stop()
        return {"status": NO_TIME, "reason": "it was begun, and took longer than was left"}
    except (InputError, RuntimeError) as error:  # The latter JAX's: no memory for it, say.
        row = {"status": FAILED, "reason": str(error)}
    if row.get("reason") != _NO_SLOPES:
        journal.add(name, row)
    return row


def _measured(
    given: SceneFile, file: SceneFile, setting: Setting, program: Any, truth: Reference, clock: _Clock
) -> dict[str, Any]:
    assert truth.truth is not None
    left = clock.left()
    found, cost = within(left, lambda: trial(file)) if setting.bits == 64 else single(setting.table, left)
    row: dict[str, Any] = {**cost, "precision": f"float{setting.bits}"}
    if found.status != "ok":
        return row | {"status": FAILED, "reason": f"{found.reason}, at {found.failure_time:g} s"}
    names, wanted = ([contact.name for contact in x.scene.contacts] for x in (file, given))
    ours = measured(found, given.times, given.scene.traits.turning)
    ours, theirs = compared(ours, names, truth.truth, wanted)
    row |= {"status": OK, **errors(ours, theirs, given.times)}
    row["at_reference"] = worst(row) <= truth.least_error
    if moved := peak_change(ours, theirs):
        row |= {"contact": [name for name in wanted if name in names][moved[0]], "peak_change": moved[1]}
    if setting.derivatives and truth.slopes is not None:
        row |= _differentiated(file, program, truth, row["wall_s"], clock)
    return row


def _differentiated(file: SceneFile, program: Any, truth: Reference, wall_s: float, clock: _Clock) -> dict[str, Any]:
    """What a setting's derivatives are worth and cost, or why there are none."""
    assert truth.slopes is not None
    if clock.derivatives(program, wall_s) > clock.left():
        return {"reason": _NO_SLOPES}
    names = tuple(truth.certificate["derivatives"]["parameters"])
    try:
        each = within(clock.left(), lambda: slopes(file, names))
    except OutOfTime:
        clock.stop()
        return {"reason": _NO_SLOPES}
    costs = {"derivative_wall_s": each.wall_s, "derivative_compile_s": each.compile_s}
    if each.value is None:
        return costs | {"reason": f"no derivatives: {each.reason}"}
    return costs | {"derivative_error": derivative_error(each.value, truth.slopes)}


def _fronted(rows: list[dict[str, Any]], truth: Reference | None) -> list[dict[str, Any]]:
    """Rows with the Pareto front of wall time and worst error marked; below the reference's own error all are equal.

    Numbers that the package refuses are on no front, nor are other choices of the model.
    """
    least_error = truth.least_error if truth and truth.truth else 0.0
    runs = [row["status"] == OK and row["group"] not in ("precision", MODEL) for row in rows]
    place = [
        (r["wall_s"], np.maximum(worst(r), least_error)) if here else None for r, here in zip(rows, runs, strict=True)
    ]
    known = [p for p in place if p is not None and np.isfinite(p[1])]

    def best(p: tuple[float, float] | None) -> bool:
        if p is None or not np.isfinite(p[1]):
            return False
        return not any(q[0] <= p[0] and q[1] <= p[1] and q != p for q in known)

    return [row | {"pareto": best(p)} for row, p in zip(rows, place, strict=True)]
