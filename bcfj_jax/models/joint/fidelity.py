"""``fidelity = "auto"``: the cheapest level of the joint's ladder that keeps the error budget, and why.

The budget is the force error asked for (``accuracy``): of each contact the rms over the times of the difference of
normal forces from those of the dynamic model at the same accuracy, its worst member's, as a fraction of the contact's
peak; the worst contact counts. The levels, cheapest first, and what estimates their error:

| level | what is solved | estimated by |
|---|---|---|
| ``kinematic`` | nothing | its distance from equilibrium with what that leaves out, ``joint.model_error`` |
| ``quasistatic`` | equilibrium at each instant | what it leaves out, at some instants, to first order |
| ``periodic`` | motion until the load has risen and some pitches have passed; then the last one again and again | how far the last was from repeating the one before, ``joint.periodic`` |
| ``dynamic`` | motion to the end | |

Each estimate is multiplied by a factor. That of ``periodic`` was found on 33 random joints (errors were at most 0.64 of
the raw estimate), that of what equilibrium leaves out on 99 (8.0 times the raw estimate at most, whatever the friction);
``benchmarks/models/joint_auto.py`` holds the choice to the budget on others. Nothing here is traced: the choice is made before
the run that counts.
"""  # noqa: E501

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bcfj_jax.core.quantities import percent
from bcfj_jax.mechanism.model import Choice, Params
from bcfj_jax.models.joint import periodic
from bcfj_jax.models.joint.model_error import Statics, statics
from bcfj_jax.models.joint.scene import PILOTS, WINDOW_END, Joint
from bcfj_jax.xla.programs import program

# What estimates are multiplied by: of what equilibrium leaves out, of how far the last pitch is from repeating.
_STATIC, _REPEAT = 12.0, 1.5
# However large the budget: what does not repeat to a percent has not settled, and may go anywhere.
_SETTLED = 0.01
# The estimate, with its factor, is at least this multiple of the friction coefficient (5.4 and more on 99 random
# joints): where that is more than the budget none is needed.
_FRICTION = 5.0
# Pitches under full load after which a motion is asked whether it repeats; again after more, if it does not.
_PITCHES = (2, 4)
# A run this many times as long as a short one, or less, is not worth it.
_LONG = 1.3
# Instants at which equilibrium is looked at.
_LOOKS = 32


def resolved(scene: Joint, fidelity: str) -> Joint:
    """The joint at a level, as the solvers take it: a periodic one is dynamic."""
    return dataclasses.replace(scene, fidelity="dynamic" if fidelity == "periodic" else fidelity)


def of_run(scene: Joint, run: Any) -> Joint:
    """The joint at the level that a run has."""
    return resolved(scene, run.choice.fidelity) if run.choice else scene


def _spread(times: np.ndarray) -> np.ndarray:
    """Instants out of the times that see every phase: steps of the golden section alias with no period."""
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    share = np.sort(np.mod(golden * np.arange(1, _LOOKS + 1), 1.0))
    return times[np.minimum((share * times.size).astype(int), times.size - 1)]


def static_errors(found: Statics) -> dict[str, float]:
    """Error of both static levels at the instants looked at, the worst contact's; infinite without equilibrium."""
    if not np.all(found.converged):
        return {"kinematic": np.inf, "quasistatic": np.inf}
    true = {name: np.asarray(force + found.left_out[name]) for name, force in found.quasistatic.items()}
    return {
        "kinematic": max(_off(found.kinematic[name], force) for name, force in true.items()),
        "quasistatic": max(_off(found.quasistatic[name], force) for name, force in true.items()),
    }


def _off(found: Any, true: np.ndarray) -> float:
    top = np.abs(true).max()
    off = np.sqrt(np.mean(np.square(np.asarray(found) - true), axis=0)).max()
    return float(off / top) if top != 0.0 else float(off != 0.0)


def _least_friction(scene: Joint, params: Params) -> float:
    """The smallest friction coefficient of all contacts; 0 where one has none."""
    least = []
    for contact in scene.contacts:
        names = [n for n in (contact.friction.needs if contact.friction else ()) if n in _COEFFICIENTS]
        least += [float(scene.coefficient(params, contact.name, name)) for name in names] or [0.0]
    return min(least)


_COEFFICIENTS = ("friction_static", "friction_dynamic")


def _statics_apply(scene: Joint, params: Params, budget: float) -> bool:
    held = scene.cage == "fixed" or any(scene.has(name) for name in PILOTS)
    # Friction alone presses balls against the ends of their windows: a level without it is wrong there by all of it.
    if scene.has(WINDOW_END) and any(contact.friction for contact in scene.contacts):
        return False
    return held and scene.drive == "prescribed" and _FRICTION * _least_friction(scene, params) <= budget


def _look(scene: Joint, params: Params, times: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
    """Estimates of the static levels, with the factor, and the seconds they took."""
    arguments = (dict(params), _spread(times))
    look, compile_s = program("statics", statics, (resolved(scene, "quasistatic"),), arguments)
    begin = time.perf_counter()
    found = look(*arguments)
    errors = {name: _STATIC * error for name, error in static_errors(found).items()}
    return errors, {"wall_s": time.perf_counter() - begin, "compile_s": compile_s}


def adaptive(
    scene: Joint, params: Params, times: np.ndarray, budget: float, run: Callable[[Joint, np.ndarray], Any]
) -> Any:
    """Run a joint of fidelity "auto" at the cheapest level that keeps the budget; arguments as ``AbstractModel.choose``.

    Seconds and steps of the run, which has its ``choice``, are those of all that was tried.
    """
    errors: dict[str, float] = {}
    spent: list[Mapping[str, float]] = []

    def chosen(found: Any, fidelity: str, reason: str) -> Any:
        stats = dict(found.stats)
        for key in ("wall_s", "compile_s", "accepted", "rejected"):
            stats[key] += sum(part.get(key, 0) for part in spent)
        return found._replace(stats=stats, choice=Choice(fidelity, budget, errors, reason))

    if _statics_apply(scene, params, budget):
        estimates, seconds = _look(scene, params, times)
        errors |= estimates
        spent.append(seconds)
        for name, error in estimates.items():
            if error <= budget:
                reason = f"what it leaves out changes the forces by {percent(error, 2)}, within {percent(budget, 2)}"
                return chosen(run(resolved(scene, name), times), name, reason)
    motion = resolved(scene, "dynamic")
    ends = [periodic.risen(scene, params, count * scene.pitches) for count in _PITCHES]
    ends = [end for end in ends if _LONG * end < times[-1]]
    enough = min(budget, _SETTLED)
    for end in ends:
        folded = periodic.fold(scene, params, times, end)
        short = run(motion, folded.times)
        if short.status != "ok":
            # From the failure on every answer is the last one, which is none.
            index = np.where(times >= short.failure_time, folded.times.size - 1, folded.index)
            failed = _unfolded(motion, params, times, folded._replace(index=index), short)
            return chosen(failed, "dynamic", "the dynamic model failed")
        errors["periodic"] = _REPEAT * max(
            periodic.mismatch(motion, params, folded, short.force, short.trajectory).values()
        )
        if errors["periodic"] <= enough:
            reason = f"the last pitch repeats the one before to {percent(errors['periodic'], 2)}, within {percent(enough, 2)}"
            return chosen(_unfolded(motion, params, times, folded, short), "periodic", reason)
        spent.append(short.stats)
    if not ends:
        reason = "no cheaper level keeps the budget, and the run is too short for one that repeats a pitch"
        return chosen(run(motion, times), "dynamic", reason)
    # At as many times as the short runs: the same program.
    folded = periodic.fold(scene, params, times, ends[0], whole=True)
    reason = (
        f"the last pitch repeats the one before to {percent(errors['periodic'], 2)}, more than {percent(enough, 2)}"
    )
    return chosen(_unfolded(motion, params, times, folded, run(motion, folded.times)), "dynamic", reason)


def _unfolded(scene: Joint, params: Params, times: np.ndarray, folded: periodic.Folded, run: Any) -> Any:
    """The long run from the short one."""
    parts = {
        name: periodic.unfolded(scene, params, folded, getattr(run, name))
        for name in ("force", "penetration", "rate", "slip", "state")
    }
    trajectory = periodic.unfolded_states(scene, params, folded, run.trajectory)
    return run._replace(times=times, trajectory=trajectory, **parts)
