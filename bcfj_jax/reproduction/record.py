"""The paper's run with its states: what ``simulate`` gives, and what Newton's law for the cage is tested on."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.mechanism.model import Params, Reading
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.observe import observe
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.models.joint.system import contact_forces, on_bodies, view
from bcfj_jax.solve.integrate import Solution, integrate
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import Run, story

END, STEP, INSTANT = 3.0, 1e-3, 1.51
# Of a force error in fractions of the peak, as ``simulate`` takes it.
ACCURACY = 1e-2
_MAX_STEPS = 200_000
# Half the interval over which the cage's velocity is differenced: far below the millisecond of its quickest motion.
_HALF = 1e-5


class Balance(NamedTuple):
    """The cage at one instant: sum of its contact forces (3,), mass times differenced acceleration (3,) [N]."""

    time: float
    forces: np.ndarray
    inertia: np.ndarray


class Record(NamedTuple):
    """A run at the paper's output times, and the cage at ``INSTANT`` (at half time of a shorter run)."""

    run: Run
    balance: Balance


@eqx.filter_jit
def _run(scene: Joint, params: Params, times: Array, how: Plan) -> tuple[Solution, dict[str, Reading], Array, Array]:
    """Solution, readings, and per instant the contact forces on the cage and its velocity, (T, 3) each."""
    solution = integrate(scene, params, times, how, "forward")
    c = constants(scene, params)

    def look(y: Array) -> tuple[dict[str, Reading], Array, Array]:
        state = view(scene, c, y)
        _, coupling = on_bodies(scene, c, state, contact_forces(scene, c, state))
        return observe(scene, c, y), coupling[scene.slices["cage"]], state.cage_velocity

    readings, forces, velocity = jax.vmap(look)(solution.states)
    return solution, readings, forces, velocity


_compiled: dict[tuple[Joint, int], Callable[..., tuple[Solution, dict[str, Reading], Array, Array]]] = {}


def record(scene: Joint, params: Params, end: float = END, step: float = STEP) -> Record:
    """Run a dynamic joint with a free cage as the paper did: output every ``step`` up to ``end`` [s]."""
    regular = np.linspace(0.0, end, round(end / step) + 1)
    instant = INSTANT if end > INSTANT + _HALF else 0.5 * end
    at = np.array([instant - _HALF, instant, instant + _HALF])
    times = np.unique(np.concatenate([regular, at]))
    # ``unique`` keeps two numbers that differ by rounding; an instant that is a sample is wanted once.
    times = times[np.concatenate([[True], np.diff(times) > 1e-9])]
    how = plan(scene, ACCURACY, _MAX_STEPS)
    arguments = (scene, dict(params), jnp.asarray(times), how)
    begin = time.perf_counter()
    key = (scene, times.size)
    if key not in _compiled:
        _compiled[key] = _run.lower(*arguments).compile()
    compiled = time.perf_counter()
    solution, readings, forces, velocity = jax.device_get(_compiled[key](*arguments))
    done = time.perf_counter()
    keep = np.searchsorted(times, regular - 1e-9)
    readings = jax.tree.map(lambda part: part[keep], readings)
    walls = {"wall_s": done - compiled, "compile_s": compiled - begin}
    run = story(scene, regular, solution, readings, how, walls)
    low, middle, high = np.searchsorted(times, at - 1e-9)
    pace = np.asarray(velocity)
    rate = (pace[high] - pace[low]) / (times[high] - times[low])
    mass = float(params["cage_mass"])
    return Record(run, Balance(float(times[middle]), np.asarray(forces)[middle], mass * rate))
