"""A block of a study: some of its points, computed together and never apart, as a table.

A block's content follows from the study and the block's number alone, not from who computes it nor when: that is what
lets it be thrown away and done again.
"""

from __future__ import annotations

import hashlib
import json
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives import batch as derivatives
from bcfj_jax.analysis.derivatives.contact_events import TIGHTER, filled
from bcfj_jax.analysis.derivatives.jacobian import Histories, level
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import complete, event, members
from bcfj_jax.analysis.simulation.results import resolved
from bcfj_jax.analysis.studies.batch import Batch, has_history, run
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.analysis.studies.steady import of_steady
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.programs import program
from bcfj_jax.core.quantities import ORDERED, check_order, check_value
from bcfj_jax.core.status import OK, reason
from bcfj_jax.io import outputs
from bcfj_jax.io.journal import key_of
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import LEVELS, Plan, plan
from bcfj_jax.solve.simulation import simulate

# Points of a block: of the motion of a large model, of all else. Enough to fill the places of a batch several times over,
# few enough that little is lost with one; and numbers of state that a block may hold at once.
_OF_MOTION, _OTHERS, _FEWEST, _NUMBERS = 64, 512, 4, 2**24
# A run that failed is tried once more with steps of so much less error.
SAFER = 0.1


class Table(NamedTuple):
    """What a block's points gave, one row a point.

    Attributes:
        point: (n,) numbers in the design.
        values: (n, D) of the varied parameters.
        results: (n, F) of ``Study.columns``.
        status, reason: (n,) texts.
        steps: (n,) attempted steps; rounds: of all places of the batch (``solve.work_queue``).
        force: (n, T, C, 3) [N], or empty.
        ends: (n,) last times [s].
    """

    point: np.ndarray
    values: np.ndarray
    results: np.ndarray
    status: list[str]
    reason: list[str]
    steps: np.ndarray
    rounds: int
    force: np.ndarray
    ends: np.ndarray


class Blocks:
    """A study cut into blocks.

    Costly points come first, so that no worker begins a long block when all others are done.
    """

    def __init__(self, study: Study) -> None:
        self.study = study
        scene = study.given.scene
        large = scene.traits.large
        few = _OF_MOTION if large and has_history(scene) else _OTHERS
        # Tangents are as many numbers again for each parameter; contacts' readings stay until features are taken.
        held = _NUMBERS // ((64 if large else 4) * len(study.given.times) * (1 + 2 * len(study.derivatives)))
        # Four blocks at least, so that there is work for several.
        self.size = max(_FEWEST, min(few, held, -(-study.count // 4)))

    def __len__(self) -> int:
        return -(-self.study.count // self.size)

    @cached_property
    def order(self) -> np.ndarray:
        """(N,) points in the order of the blocks."""
        return np.argsort(-predicted_cost(self.study), kind="stable")

    @cached_property
    def code_key(self) -> str:
        """Of the study's scene and results, and of the code: blocks of the same points under another are others."""
        resolved = {k: v for k, v in self.study.resolved.items() if k in ("scene", "results")}
        return key_of("study", resolved, self.study.names, [jax.__version__])

    def points(self, block: int) -> np.ndarray:
        """Numbers of a block's points."""
        return self.order[block * self.size : (block + 1) * self.size]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The blocks' names: digests of all that their content follows from."""
        found = []
        for block in range(len(self)):
            at = self.points(block)
            digest = hashlib.sha256(json.dumps([self.code_key, self.size]).encode())
            digest.update(at.astype("<i8").tobytes() + self.study.points[at].astype("<f8").tobytes())
            found.append(digest.hexdigest()[:32])
        return tuple(found)


def predicted_cost(study: Study) -> np.ndarray:
    """(N,) of each point in units of its own: the time simulated over a contact's time; 1 where all cost alike."""
    scene = study.given.scene
    if not has_history(scene) or scene.traits.turning:
        # Steps are set by the contacts, which begin and end with the turns.
        turns = has_history(scene) and "drive_speed" in study.names
        return np.abs(study.points[:, study.names.index("drive_speed")]) if turns else np.ones(study.count)
    how = plan(scene, study.given.accuracy)
    arguments = study.params(study.points), study.ends, how
    steps = program("study steps", _steps, (scene,), arguments)[0](*arguments)
    # Not to the last bit: what rounds differently elsewhere must not change the order.
    return np.asarray([float(f"{x:.3g}") for x in steps])


def _steps(scene: AbstractModel, params: dict, ends: Array, how: Plan) -> Array:
    from bcfj_jax.solve.integrate import problem  # With diffrax, which a kept program needs not.

    return jax.vmap(lambda p, end: end / problem(scene, p, end, how, False).first_step)(params, ends)


def compute(study: Study, at: np.ndarray, size: int) -> Table:
    """Run some points; those that fail once more, with safer settings.

    Args:
        study: whose.
        at: their numbers, at most ``size``.
        size: of the program.
    """
    values, given = study.points[at], study.given
    refused = _refusals(study, values, size)
    good = np.flatnonzero([not text for text in refused])
    last = study.ends[at]
    results = np.full((len(at), len(study.columns)), np.nan)
    status, reasons = ["failed"] * len(at), list(refused)
    steps, rounds = np.zeros(len(at), int), 0
    force = np.zeros((len(at), 0, 0, 0))
    if study.histories:
        force = np.full((len(at), len(given.times), sum(max(1, k) for k in given.scene.members.values()), 3), np.nan)
    grid = given.times / given.times[-1]

    def attempt(which: np.ndarray, safety: float) -> np.ndarray:
        """Run some of the points; which of them failed."""
        nonlocal rounds
        batch = _run(study, values[which], last[which], grid, size, safety)
        rounds += batch.rounds
        steps[which] += batch.steps
        results[which] = batch.features
        if study.histories:
            force[which] = batch.force
        for i, why, end in zip(which, batch.reason, batch.end, strict=True):
            failure = f"{why} at {end:.6g} s" if why else ""
            status[i] = "failed" if failure else "ok"
            again = f"{failure or 'ok'} with a tenth of the tolerance; before: {reasons[i]}"
            reasons[i] = failure if safety == 1.0 else again
        return which[np.array([bool(why) for why in batch.reason])]

    if good.size:
        failed = attempt(good, 1.0)
        if failed.size and has_history(given.scene):
            attempt(failed, SAFER)
    return Table(at, values, results, status, reasons, steps, rounds, force, last)


def _run(study: Study, values: np.ndarray, last: np.ndarray, grid: np.ndarray, size: int, safety: float) -> Batch:
    given = study.given
    scene: Any = given.scene
    how = plan(scene, given.accuracy, given.max_steps, given.solver)
    how = eqx.tree_at(lambda h: h.tolerance, how, how.tolerance * safety)
    if study.steady:
        return of_steady(study, values, last, how, size)
    single = any(event(f.kind) for f in study.features)
    if study.derivatives and not single and derivatives.possible(scene, how):
        return _with_derivatives(study, values, last, grid, how, size)
    if study.derivatives or single or given.solver is not None or given.resolved_peaks or scene.traits.open:
        return _one_by_one(study, values, last, grid, safety)
    how = Plan(how.tolerance, given.max_steps)
    return run(scene, study.params(values), last, grid, study.features, how, size, study.histories)


def _with_derivatives(
    study: Study, values: np.ndarray, last: np.ndarray, grid: np.ndarray, how: Plan, size: int
) -> Batch:
    """As ``batch.run``, with derivatives of the features."""
    scene, given = study.given.scene, study.params(values)
    params, wrt = complete(scene, given, study.derivatives)  # pyright: ignore[reportArgumentType]
    found = derivatives.run(scene, params, last, grid, wrt, how, size, study.histories)
    rows = []
    for i, (end, code) in enumerate(zip(last, found.code, strict=True)):
        if code != OK:
            rows.append(np.full(len(study.columns), np.nan))
            continue
        value, slopes = (
            Histories(*(x[i] for x in part[:3]), state=None, curve=part.curve[i])
            for part in (found.value, found.derivative)
        )
        rows.append(_row(study, end * grid, value, slopes))
    reasons = [reason(code, how.max_steps) for code in found.code]
    force = found.value.force if study.histories else np.zeros((len(last), 0, 0, 0))
    return Batch(np.array(rows), reasons, found.end, found.steps, found.rounds, force)


def _row(study: Study, times: np.ndarray, value: Histories, slopes: Histories) -> np.ndarray:
    """Features of one run, then their derivatives."""
    scene = study.given.scene
    numbers, by = measure(times, value, slopes, study.features, scene.members, scene.traits.turning)
    return np.concatenate([numbers, by.ravel()])


def _one_by_one(study: Study, values: np.ndarray, last: np.ndarray, grid: np.ndarray, safety: float) -> Batch:
    """As ``batch.run``, for what has no batch: a solver of one's own, a level to be chosen, features of single contacts,
    tangents that have a say in the steps (``derivatives.batch.possible``).
    """
    given = study.given
    scene, contacts, params = given.scene, given.scene.members, study.params(values)
    rows: list[tuple] = []
    for i, end in enumerate(last):
        one = {name: leaf[i] for name, leaf in params.items()}
        times = end * grid
        if study.derivatives:
            full, wrt = complete(scene, one, study.derivatives)
            how = plan(scene, given.accuracy, given.max_steps, given.solver)
            how = eqx.tree_at(lambda h: h.tolerance, how, how.tolerance * safety)
            found = level(scene, full, times, wrt, how)
            value, slopes, stop, steps = found.value, found.derivative, found.end, found.steps
            why = reason(found.code, given.max_steps)
        else:
            accuracy = LEVELS[given.accuracy] if isinstance(given.accuracy, str) else given.accuracy
            budget: dict[str, Any] = {
                "max_steps": given.max_steps,
                "solver": given.solver,
                "resolved_peaks": given.resolved_peaks,
            }
            single = simulate(scene, one, times, accuracy=max(1e-9, accuracy * safety), **budget)
            histories = ((single.force, 1), (single.penetration, 0), (single.rate, 0))
            read = [np.stack(list(outputs.channels(x, axes).values()), 1) for x, axes in histories]
            value, slopes = (Histories(read[0], read[1], read[2], None), _no_slopes(read))
            why, stop = single.reason, single.failure_time
            steps = int(single.stats["accepted"] + single.stats["rejected"])
        numbers, by = measure(times, value, slopes, study.features, contacts, scene.traits.turning)
        full, wrt = complete(scene, one, study.derivatives) if study.derivatives else (one, ())
        finer = plan(scene, given.accuracy, given.max_steps)
        filled(scene, full, float(end), wrt, finer, study.features, numbers, by, safety * TIGHTER)
        if given.resolved_peaks and not study.derivatives:
            peaks = {name: x["peak"] for name, x in resolved(single).items()}
            of_peak = {k: f for k, f in enumerate(study.features) if f.kind == "peak" and peaks}
            for k, f in of_peak.items():
                numbers[k] = max(peaks[name] for name in members(f.contacts[0], contacts))
        row = np.concatenate([numbers, by.ravel()])
        rows.append((np.full_like(row, np.nan) if why else row, why, stop, steps, value.force))
    features, whys, stop, steps, force = zip(*rows, strict=True)
    return Batch(np.array(features), list(whys), np.array(stop), np.array(steps), 0, np.array(force))


def _no_slopes(read: list[np.ndarray]) -> Histories:
    force, depth, rate = (np.zeros((0, *x.shape)) for x in read)
    return Histories(force, depth, rate, None)


def _refusals(study: Study, values: np.ndarray, size: int) -> list[str]:
    """Why points (n, D) cannot be run, n at most ``size``; "" where they can."""
    scene = study.given.scene
    known = {name: scene.quantities[name] for name in study.names}
    # Plain numbers once, for what thousands of points share.
    params = {name: float(value) for name, value in study.given.params.items()}
    ordered = any(name.rpartition(".")[2] in ORDERED for name in study.names)
    found, good = [""] * len(values), []
    for i, row in enumerate(values.tolist()):
        params |= dict(zip(study.names, row, strict=True))
        try:
            for name, quantity in known.items():
                check_value("", quantity, params[name])
            if ordered:
                check_order("", scene.quantities, params)
            good.append(i)
        except InputError as error:
            found[i] = _refusal(error)
    if not good:
        return found
    # The program takes ``size`` points: the last one fills the places that are left.
    fill = np.array(good)[np.minimum(np.arange(size), len(good) - 1)]
    suspect = scene.suspects(study.params(values[fill]))[: len(good)]  # pyright: ignore[reportArgumentType]
    for i in np.array(good)[suspect]:
        params |= dict(zip(study.names, values[i].tolist(), strict=True))
        try:
            scene.check(params)  # pyright: ignore[reportArgumentType]
        except InputError as error:
            found[i] = _refusal(error)
    return found


def _refusal(error: InputError) -> str:
    return f"{error.where}: {error.found}; {error.remedy}".strip(": ")
