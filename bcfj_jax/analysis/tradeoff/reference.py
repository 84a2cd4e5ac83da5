"""The truth of a study and how far it can be trusted: two methods that know nothing of each other, both tight.

The first method's run is the truth; its difference from the second, in every error of ``measures``, is the reference's own
error. Both are tightened until they agree, or until more would cost more than a third of the time left (docs/tradeoff.md).
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.tradeoff.measures import Measured, derivative_error, errors, measured, worst
from bcfj_jax.analysis.tradeoff.settings import accuracy_of, level, overlaid
from bcfj_jax.analysis.tradeoff.trial import READ, TANGENTS, Clock, loaded, parameters, slopes, trial
from bcfj_jax.core.progress import stage
from bcfj_jax.io.outputs import atomic
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.io.stop import OutOfTime
from bcfj_jax.solve.plan import MAX_STEPS
from bcfj_jax.solve.simulation import Run

NAME = "reference.npz"
# Below this many times its own error a reference does not distinguish settings.
SEPARATES = 3.0
# By whether the scene is stiff: solver and force error, step by step; of those in a step the first two that succeed.
_METHODS = {
    False: tuple(tuple((solver, e) for solver in ("tsit5", "kvaerno5", "bosh3")) for e in (1e-7, 1e-9)),
    True: tuple((("bdf", e), ("rodas3", 100 * e), ("sdirk2", 100 * e)) for e in (1e-5, 1e-7, 1e-8, 1e-9)),
}
# The same of derivatives. SDIRK2's are not in its step control, so that a tighter tolerance is not a better one: both
# are run, and the nearer witnesses (docs/derivatives.md has tighter ones, which are worse).
_SLOPES = {
    False: (("tsit5", 1e-9), ("kvaerno5", 1e-8), ("bosh3", 1e-8)),
    True: (("bdf", 1e-6), ("sdirk2", 2e-3), ("sdirk2", 1e-3)),
}
# Worst difference at which tightening ends.
_GOAL = {False: 1e-8, True: 1e-5}
# A step of tightening costs at most so many times the one before; a step of an implicit method so many of another's.
_DEARER, _IMPLICIT = 5.0, 50.0
# Steps that a method may take whatever the time left.
_LEAST_STEPS = 20_000
_NO_TIME = "would take more than a third of the time left"
_LATE = "took longer than was left"

# Why there are no derivatives where the user left them out.
NOT_ASKED = "not asked for"


class Reference(NamedTuple):
    """The truth and its certificate."""

    truth: Measured | None  # forces and what is compared of them; None where two methods could not be had
    slopes: np.ndarray | None  # d(force)/d ln(parameter) (P, T, C, 3) [N], or None
    certificate: dict[str, Any]  # methods, their differences, why there is no more; as ``tradeoff.json`` has it
    digest: str = ""  # of the file that keeps it

    @property
    def least_error(self) -> float:
        """Error below which settings are not distinguished."""
        return SEPARATES * worst(self.certificate["errors"]) if self.truth else math.nan

    @property
    def least_slope_error(self) -> float:
        """The same of derivatives."""
        return SEPARATES * float(self.certificate["derivatives"]["error"]) if self.slopes is not None else math.nan


def reference(given: SceneFile, clock: Clock, say: Callable[[str], None], derivatives: bool = True) -> Reference:
    """Certify a scene's truth, and its derivatives where they are wanted, in the time of the whole study."""
    names, begin, found = parameters(given), clock.left(), None
    truth, certificate = _values(given, clock, say)
    said: dict[str, Any] = {"parameters": names, "methods": [], "error": math.nan, "reason": ""}
    if truth is None:
        return Reference(None, None, certificate | {"derivatives": said})
    if not derivatives:
        said["reason"] = NOT_ASKED
    elif not names:
        said["reason"] = "no parameter to take them by"
    elif not given.scene.traits.history:
        said["reason"] = "fidelities without inertia have no solver"
    elif TANGENTS * (begin - clock.left()) > clock.left() / 3.0:
        said["reason"] = f"they {_NO_TIME}"
    else:
        say(f"reference derivatives by {', '.join(names)}")
        found = _slopes(given, said, clock)
    return Reference(truth, found, certificate | {"derivatives": said})


def _tried(name: str, run: Callable[[], Any], clock: Clock, failures: list[str]) -> Any:
    """What a run gives; None where it fails, or takes longer than the seconds left, which is said among the failures."""
    try:
        with stage(f"reference by {name}"):
            return clock.within(run)
    except OutOfTime:
        failures.append(f"{name} {_LATE}")
    except RuntimeError as error:  # Of JAX: no memory for it, say.
        failures.append(f"{name}: {error}")
    return None


def _method(given: SceneFile, solver: str, error: float) -> SceneFile:
    """The scene by another solver, with steps enough."""
    accuracy = {**accuracy_of(given, error, solver), "max_steps": max(given.max_steps, MAX_STEPS)}
    return loaded(overlaid(given.resolved, {"accuracy": accuracy}))


def _values(given: SceneFile, clock: Clock, say: Callable[[str], None]) -> tuple[Measured | None, dict[str, Any]]:
    """The truth and its certificate."""
    best: dict[str, Any] = {"status": "failed", "reason": "", "methods": [], "errors": {}}
    truth, spent, failures, stiff = None, 0.0, list[str](), given.scene.traits.stiff
    for candidates in _candidates(given):
        if truth is not None and spent * _DEARER > clock.left() / 3.0:
            best["reason"] = f"a tighter one {_NO_TIME}"
            break
        pair: list[tuple[dict[str, Any], Measured]] = []
        spent = 0.0
        for solver, error, file, every in candidates:
            if pair and not stiff:
                file = _shortened(file, pair[0][0], clock.left() / 3.0)
            found = _tried(solver, lambda file=file: trial(file, repeated=False), clock, failures)
            if clock.over:
                best["reason"] = f"a tighter one {_LATE}"
                break
            if found is None:
                continue
            spent += found.cost["wall_s"]
            if found.run.status != "ok":
                failures.append(f"{solver}: {found.run.reason}")
                continue
            known = measured(_thinned(found.run, every), given.times, given.scene.traits.turning)
            pair.append(({"solver": solver, "force_error": error, **found.cost}, known))
            if len(pair) == 2:
                break
        if len(pair) < 2:
            break
        (first, now), (second, other) = pair
        apart = errors(other, now, given.times)
        if truth is not None and not worst(apart) < worst(best["errors"]):
            break
        truth = now
        best |= {"status": "ok", "methods": [first, second], "errors": apart}
        say(f"reference: {first['solver']} and {second['solver']} differ by {worst(apart):.1e}")
        if worst(apart) <= _GOAL[stiff]:
            break
    if truth is None:
        best["reason"] = f"no two methods reached the end: {'; '.join(failures)}"
    return truth, best


def _shortened(file: SceneFile, first: dict[str, Any], seconds: float) -> SceneFile:
    """A file whose budget of steps fits, beside an explicit method that took so many steps; of two implicit ones a step costs
    about as much. Another budget is another program, so that there are few.
    """
    if not first["steps"]:
        return file
    excess = file.max_steps / max(seconds / (_IMPLICIT * first["wall_s"] / first["steps"]), _LEAST_STEPS)
    return replace(file, max_steps=file.max_steps // 4 ** max(math.ceil(math.log(excess / 2.0, 4.0)), 0))


def _candidates(given: SceneFile) -> Iterator[list[tuple[str, float, SceneFile, int]]]:
    """Ever tighter candidates: solver, force error, the scene file, and which of its samples are at the user's times."""
    if given.scene.traits.history:
        for methods in _METHODS[given.scene.traits.stiff]:
            yield [(solver, error, _method(given, solver, error), 1) for solver, error in methods]
        return
    count, name = given.resolved["time"]["samples"], level(given)
    double = loaded(overlaid(given.resolved, {"time": {"samples": 2 * count - 1}}))
    yield [(name, math.nan, given, 1), (f"{name}, other starts", math.nan, double, 2)]


def _thinned(run: Run, every: int) -> Run:
    parts = {key: {k: x[::every] for k, x in getattr(run, key).items()} for key in READ}
    return run._replace(times=run.times[::every], **parts)


def _slopes(given: SceneFile, said: dict[str, Any], clock: Clock) -> np.ndarray | None:
    """Derivatives, and what is ``said`` of them."""
    truth, first, spent, failures = None, {}, 0.0, list[str]()
    witnesses: list[tuple[float, dict[str, Any]]] = []
    for solver, error in _SLOPES[given.scene.traits.stiff]:
        if solver == first.get("solver"):
            continue
        if spent > clock.left() / 3.0:
            failures.append(f"{solver}: {_NO_TIME}")
            break
        file, begin = _method(given, solver, error), clock.left()
        each = _tried(solver, lambda file=file: slopes(file, said["parameters"]), clock, failures)
        if clock.over:
            break
        spent = begin - clock.left()
        if each is None or each.value is None:
            failures += [] if each is None else [f"{solver}: {each.reason}"]
            continue
        how_dear = {"solver": solver, "force_error": error, "wall_s": each.wall_s, "compile_s": each.compile_s}
        if truth is None:
            truth, first = each.value, how_dear
            continue
        witnesses.append((derivative_error(each.value, truth), how_dear))
        if not given.scene.traits.stiff:
            break
    said |= {"methods": [first] if first else [], "reason": "; ".join(failures)}
    if not witnesses:
        return None
    said["error"], nearest = min(witnesses, key=lambda witness: witness[0])
    said["methods"] = [first, nearest]
    return truth


def save(found: Reference, folder: Path) -> str:
    """Keep a reference's arrays beside the journal, which keeps its certificate; the digest of the file."""
    assert found.truth is not None
    arrays = found.truth._asdict() | ({} if found.slopes is None else {"slopes": found.slopes})
    with atomic(folder / NAME) as temporary:
        with temporary.open("wb") as file:
            # Old releases of NumPy take allow_pickle for an array of that name.
            np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]
        return hashlib.sha256(temporary.read_bytes()).hexdigest()


def restore(certificate: Any, folder: Path, digest: Any) -> Reference | None:
    """A kept reference, of which the journal has certificate and digest; None where its file is not as ``save`` wrote it."""
    try:
        content = (folder / NAME).read_bytes()
        if hashlib.sha256(content).hexdigest() != digest:
            return None
        with np.load(io.BytesIO(content), allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        found = arrays.pop("slopes", None)
        # A journal has no word for what is not a number.
        slopes = certificate["derivatives"]
        error = math.nan if slopes["error"] is None else slopes["error"]
        return Reference(Measured(**arrays), found, certificate | {"derivatives": slopes | {"error": error}}, digest)
    except (OSError, ValueError, TypeError, KeyError, EOFError):
        return None
