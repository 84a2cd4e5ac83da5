"""The study: reference first, then settings, cheap ones before dear ones, until all are done or the time is spent."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.tradeoff import measures
from bcfj_jax.analysis.tradeoff import reference as references
from bcfj_jax.analysis.tradeoff.measures import MAIN, derivative_error, worst
from bcfj_jax.analysis.tradeoff.reference import Reference, reference, restore
from bcfj_jax.analysis.tradeoff.settings import MODEL, Setting
from bcfj_jax.analysis.tradeoff.trial import Clock, Trial, loaded, singles, slopes, trial
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.progress import stage
from bcfj_jax.io.journal import Journal
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.io.stop import OutOfTime, check, within
from bcfj_jax.xla.threads import cores

OK, FAILED, UNCOMPARED = "ok", "failed", "not compared: no reference yet"
NO_TIME, CUT_OFF, NO_REFERENCE = "not run: budget", "not run: interrupted", "not run: no reference"
# A row of which nothing is known, in the order of the table's columns.
_NOTHING = {
    "setting": "", **dict.fromkeys((*MAIN, "derivative_error", "wall_s", "compile_s"), math.nan), "status": CUT_OFF,
    "pareto": False, "period_error": math.nan, "dissipated_error": math.nan, "group": "", "force_error": math.nan,
    "precision": "", "steps": 0, "repeats": 0, "derivative_wall_s": math.nan, "derivative_compile_s": math.nan,
    "at_reference": False, "reason": "", "contact": "", "peak_change": math.nan,
}  # fmt: skip
COLUMNS = tuple(_NOTHING)
# A row that lacks them is not kept: another call may have the time.
_NO_SLOPES = "no derivatives: too little time was left"


class Study(NamedTuple):
    """What a study found: all settings in the order they are run, of each a row with ``COLUMNS`` (NaN for what is unknown), the
    truth (None where it was cut off before), whether Ctrl-C ended it, and by contact the largest normal force of the scene's
    own run [N] (none where another call has run it).
    """

    settings: list[Setting]
    rows: list[dict[str, Any]]
    reference: Reference | None
    interrupted: bool
    peaks: Mapping[str, float] = {}


class _Runs:
    """Runs of settings in the time left, as ``clock`` has it: the scene's own is made first; those in 32-bit numbers are made
    together, beside the reference where there is a core for them.
    """

    def __init__(self, clock: Clock, todo: list[Setting]) -> None:
        self.clock, self.known = clock, dict[str, Trial | RuntimeError]()
        self.narrow = [setting for setting in todo if setting.bits != 64]
        self.beside = threading.Thread(target=self._beside, daemon=True)

    def first(self, setting: Setting) -> dict[str, float]:
        """Make the scene's own run: largest normal force by contact [N]; none where it fails or takes too long."""
        try:
            file = loaded(setting.table)
            with stage("running the scene as given"):
                found = self.known[setting.name] = within(self.clock.left(), lambda: trial(file))
        except (OutOfTime, InputError, RuntimeError):
            return {}
        forces = found.run.force if found.run.status == OK else {}
        return {name: float(np.max(force[..., 0], initial=0.0)) for name, force in forces.items()}

    def _all_narrow(self) -> None:
        found = singles([one.table for one in self.narrow], self.clock.left())
        self.known |= dict(zip((one.name for one in self.narrow), found, strict=True))

    def _beside(self) -> None:
        with contextlib.suppress(KeyboardInterrupt):  # The main thread has it, too.
            self._all_narrow()

    def begin(self) -> None:
        """Begin those in 32-bit numbers."""
        if self.narrow and cores() > 1:
            self.beside.start()

    def settle(self) -> None:
        """Wait for them: nothing else may compute while settings are timed."""
        if self.beside.is_alive():
            with contextlib.suppress(OutOfTime):
                self.clock.within(self.beside.join)

    def of(self, setting: Setting, file: SceneFile) -> Trial:
        """A setting's run; errors as ``trial``."""
        if setting.bits != 64 and setting.name not in self.known:
            self._all_narrow()
        known = self.known.pop(setting.name, None) or self.clock.within(lambda: trial(file))
        if isinstance(known, RuntimeError):
            raise known
        return known


def study(
    given: SceneFile, todo: list[Setting], journal: Journal, budget: float, say: Callable[[str], None],
    tell: Callable[[Study], None] | None = None,
) -> Study:  # fmt: skip
    """Measure settings of a scene, which as it stands defines the truth; Ctrl-C ends it with what is finished.

    Finished settings are kept in the journal, and taken from it; the reference's arrays lie beside it. What would not fit into
    the ``budget`` [s] is not run, and what was begun and did not fit is left behind. ``say`` receives the progress, ``tell`` what
    there is: the scene's own run, then, after the reference, a row more each time.
    """
    clock, told = Clock(budget), tell or (lambda _: None)
    runs, peaks = _Runs(clock, todo), dict[str, float]()
    rows = [_NOTHING | {"setting": s.name, "group": s.group, "force_error": s.error} for s in todo]
    truth, interrupted = None, False
    try:
        truth = _restored(journal, say)
        if truth is None and (peaks := runs.first(todo[0])):
            own: Any = runs.known[todo[0].name]
            rows[0] |= {**own.cost, "precision": "float64", "status": UNCOMPARED}
            told(Study(todo, rows, None, False, peaks))
            runs.begin()
        truth = truth or _certified(given, any(setting.derivatives for setting in todo), journal, clock, say)
        runs.settle()
        with stage("running settings", len(todo)) as done:
            for number, setting in enumerate(todo):
                check()
                rows[number] |= _row(given, setting, truth, journal, runs)
                told(Study(todo, rows, truth, False, peaks))
                done(number + 1)
    except KeyboardInterrupt:
        interrupted = True
    return Study(todo, _fronted(rows, truth), truth, interrupted, peaks)


def _restored(journal: Journal, say: Callable[[str], None]) -> Reference | None:
    """The reference that another call has left."""
    kept, folder = journal.get("reference"), journal.path.parent
    if not isinstance(kept, dict):
        return None
    whole = restore(kept.get("certificate"), folder, kept.get("file"))
    if whole is None:
        say(f"{folder / references.NAME}: is missing or damaged; the reference is computed again")
    return whole


def _certified(
    given: SceneFile, derivatives: bool, journal: Journal, clock: Clock, say: Callable[[str], None]
) -> Reference:
    found = reference(given, clock, say, derivatives)
    parts = found.certificate["methods"], found.certificate["derivatives"]["methods"]
    clock.compiled(*([one.get("compile_s", 0.0) for one in part] for part in parts))
    if found.truth is not None:
        found = found._replace(digest=references.save(found, journal.path.parent))
        journal.add("reference", {"certificate": found.certificate, "file": found.digest})
    return found


def _row(given: SceneFile, setting: Setting, truth: Reference, journal: Journal, runs: _Runs) -> dict[str, Any]:
    """A setting's row, from the journal or else by running it; a failure is a row too."""
    # What was measured against another reference is no row of this study.
    name = f"{setting.name} {setting.digest} {truth.digest}"
    kept = journal.get(name)
    if isinstance(kept, dict) and set(kept) <= set(COLUMNS) and "status" in kept:
        return {key: float("nan") if value is None else value for key, value in kept.items()}
    if truth.truth is None:
        return {"status": NO_REFERENCE, "reason": truth.certificate["reason"]}
    clock = runs.clock
    try:
        file = loaded(setting.table)
        program = (file.scene, len(file.times), file.solver, file.max_steps, setting.bits)
        if setting.name not in runs.known and clock.takes(setting.ladder, program) > clock.left():
            return {"status": NO_TIME, "reason": f"{max(clock.left(), 0.0):.0f} s are left"}
        row = _measured(given, file, setting, program, truth, runs)
        clock.took(setting.ladder, program, row)
    except OutOfTime:
        return {"status": NO_TIME, "reason": "it was begun, and took longer than was left"}
    except (InputError, RuntimeError) as error:  # The latter JAX's: no memory for it, say.
        row = {"status": FAILED, "reason": str(error)}
    if row.get("reason") != _NO_SLOPES:
        journal.add(name, row)
    return row


def _measured(
    given: SceneFile, file: SceneFile, setting: Setting, program: Any, truth: Reference, runs: _Runs
) -> dict[str, Any]:
    assert truth.truth is not None
    found, cost = runs.of(setting, file)
    row: dict[str, Any] = {**cost, "precision": f"float{setting.bits}"}
    if found.status != "ok":
        return row | {"status": FAILED, "reason": f"{found.reason}, at {found.failure_time:g} s"}
    names, wanted = ([contact.name for contact in x.scene.contacts] for x in (file, given))
    ours = measures.measured(found, given.times, given.scene.traits.turning)
    ours, theirs = measures.compared(ours, names, truth.truth, wanted)
    row |= {"status": OK, **measures.errors(ours, theirs, given.times)}
    row["at_reference"] = worst(row) <= truth.least_error
    if moved := measures.peak_change(ours, theirs):
        row |= {"contact": [name for name in wanted if name in names][moved[0]], "peak_change": moved[1]}
    if setting.derivatives and truth.slopes is not None:
        row |= _differentiated(file, program, truth, row["wall_s"], runs.clock)
    return row


def _differentiated(file: SceneFile, program: Any, truth: Reference, wall_s: float, clock: Clock) -> dict[str, Any]:
    """What a setting's derivatives are worth and cost, or why there are none."""
    assert truth.slopes is not None
    if clock.derivatives(program, wall_s) > clock.left():
        return {"reason": _NO_SLOPES}
    names = tuple(truth.certificate["derivatives"]["parameters"])
    try:
        each = clock.within(lambda: slopes(file, names))
    except OutOfTime:
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
    places: list[tuple[float, float] | None] = []
    for row in rows:
        error = float(np.maximum(worst(row), least_error)) if row["status"] == OK else math.nan
        apart = row["group"] in ("precision", MODEL)
        places.append(None if apart or not math.isfinite(error) else (row["wall_s"], error))
    known = [place for place in places if place]

    def best(p: tuple[float, float] | None) -> bool:
        return p is not None and not any(q[0] <= p[0] and q[1] <= p[1] and q != p for q in known)

    return [row | {"pareto": best(place)} for row, place in zip(rows, places, strict=True)]
