"""A block of a study: some of its points, computed together and never apart, as a table.

Its content follows from the study and the block's number alone: that lets it be thrown away and done again.
"""

from __future__ import annotations

import hashlib
import json
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from bcfj_jax.analysis.engine import refusal, said
from bcfj_jax.analysis.studies.batch import has_history, of_study, together
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import ORDERED, check_order, check_value
from bcfj_jax.io.journal import key_of
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.xla import backend
from bcfj_jax.xla.programs import program

# Points of a block: of the motion of a large model, of all else. Enough to fill the places of a batch several times over,
# few enough that little is lost with one; and numbers of state that a block may hold at once.
_OF_MOTION, _OTHERS, _FEWEST, _NUMBERS = 64, 512, 4, 2**24
# The same on an accelerator, where a batch takes hardly longer than a point until some thousands are in it (docs/howto/gpu.md);
# and which part of its memory [bytes] a number of state may take.
_MANY_OF_MOTION, _MANY, _SHARE = 16_384, 65_536, 1 / 48
# A run that failed is tried once more with steps of so much less error.
SAFER = 0.1


class Table(NamedTuple):
    """What a block's n points gave, one row a point."""

    point: np.ndarray  # numbers in the design
    values: np.ndarray  # (n, D) of the varied parameters
    results: np.ndarray  # (n, F) of ``Study.columns``
    status: list[str]
    reason: list[str]
    steps: np.ndarray  # (n,) attempted
    rounds: int  # of all places of the batch (``solve.work_queue``)
    force: np.ndarray  # (n, T, C, 3) [N], or empty
    ends: np.ndarray  # (n,) last times [s]


class Blocks:
    """A study cut into blocks of the ``size`` that it was begun with, else one that suits the device.

    Costly points come first, so that no worker begins a long block when all others are done.
    """

    def __init__(self, study: Study, size: int | None = None) -> None:
        self.study = study
        self.size = size or block_size(study)

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


def fitting(study: Study, accelerated: bool | None = None) -> int:
    """Points that are run at once: by memory, and so many that more would be no faster; on an accelerator, where this process
    computes or as ``accelerated`` says, more of what is one program.
    """
    scene, many = study.given.scene, _many(study, accelerated)
    large = scene.traits.large
    few, numbers = (_OF_MOTION if large and has_history(scene) else _OTHERS), _NUMBERS
    if many:
        few = _MANY_OF_MOTION if large else _MANY
        numbers = max(_NUMBERS, int(_SHARE * backend.memory()))
    # Tangents are as many numbers again for each parameter; contacts' readings stay until features are taken.
    held = numbers // ((64 if large else 4) * len(study.given.times) * (1 + 2 * len(study.derivatives)))
    return max(_FEWEST, min(few, held))


def block_size(study: Study, accelerated: bool | None = None) -> int:
    """Points of a block of a study: on a CPU four blocks at least, so that there is work for several."""
    most = study.count if _many(study, accelerated) else -(-study.count // 4)
    return max(_FEWEST, min(fitting(study, accelerated), most))


def _many(study: Study, accelerated: bool | None) -> bool:
    return (not backend.on_cpu() if accelerated is None else accelerated) and together(study)


def predicted_cost(study: Study) -> np.ndarray:
    """(N,) of each point in units of its own: the time simulated over a contact's time; 1 where all cost alike."""
    scene = study.given.scene
    if not has_history(scene) or scene.traits.turning:
        # Steps are set by the contacts, which begin and end with the turns.
        turns = has_history(scene) and "drive_speed" in study.names
        return np.abs(study.points[:, study.names.index("drive_speed")]) if turns else np.ones(study.count)
    arguments = study.params(study.points), study.ends, plan(scene, study.given.accuracy)
    steps = program("study steps", _steps, (scene,), arguments)[0](*arguments)
    # Not to the last bit: what rounds differently elsewhere must not change the order.
    return np.asarray([float(f"{x:.3g}") for x in steps])


def _steps(scene: AbstractModel, params: dict, ends: Array, how: Plan) -> Array:
    from bcfj_jax.solve.integrate import problem  # With diffrax, which a kept program needs not.

    return jax.vmap(lambda p, end: end / problem(scene, p, end, how, False).first_step)(params, ends)


def compute(study: Study, at: np.ndarray, size: int) -> Table:
    """Run a block's points by their numbers, up to ``size`` or what this device takes at once; those that fail once more,
    with safer settings.
    """
    size, scene = min(size, fitting(study)), study.given.scene

    def parts(which: np.ndarray) -> list[np.ndarray]:
        return [which[k : k + size] for k in range(0, len(which), size)]

    values, last = study.points[at], study.ends[at]
    reasons = [why for part in parts(values) for why in _refusals(study, part, size)]
    status, steps, rounds = ["failed"] * len(at), np.zeros(len(at), int), 0
    results = np.full((len(at), len(study.columns)), np.nan)
    shape = (len(study.given.times), sum(max(1, k) for k in scene.members.values()), 3)
    force = np.full((len(at), *shape), np.nan) if study.histories else np.zeros((len(at), 0, 0, 0))
    which = np.flatnonzero([not text for text in reasons])
    for safety in (1.0, SAFER) if has_history(scene) else (1.0,):
        for part in parts(which):
            batch = of_study(study, values[part], last[part], size, safety)
            rounds += batch.rounds
            steps[part] += batch.steps
            results[part] = batch.features
            if study.histories:
                force[part] = batch.force
            for i, why, end in zip(part, batch.reason, batch.end, strict=True):
                failure = f"{why} at {end:.6g} s" if why else ""
                status[i] = "failed" if failure else "ok"
                again = f"{failure or 'ok'} with a tenth of the tolerance; before: {reasons[i]}"
                reasons[i] = failure if safety == 1.0 else again
        which = np.array([i for i in which if status[i] == "failed"], int)
    return Table(at, values, results, status, reasons, steps, rounds, force, last)


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
            found[i] = said(error)
    if not good:
        return found
    # The program takes ``size`` points: the last one fills the places that are left.
    fill = np.array(good)[np.minimum(np.arange(size), len(good) - 1)]
    suspect = scene.suspects(study.params(values[fill]))[: len(good)]  # pyright: ignore[reportArgumentType]
    for i in np.array(good)[suspect]:
        found[i] = refusal(scene, params | dict(zip(study.names, values[i].tolist(), strict=True)))
    return found
