"""The paper's run with its states: what ``simulate`` gives, and what Newton's law for the cage is tested on."""

from __future__ import annotations

import time
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from bcfj_jax.mechanism.model import Params, Reading
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.geometry import azimuth_rate
from bcfj_jax.models.joint.observe import observe
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.models.joint.system import contact_forces, on_bodies, view
from bcfj_jax.solve.integrate import Solution, integrate
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import Run, story
from bcfj_jax.xla.programs import program

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


class Turns(NamedTuple):
    """How the bodies are turned at T instants: seat and head about their axes (T,) [rad], the cage's axis (T, 3), the cage's
    azimuth (T,) [rad]: a state where windows have ends, else the integral of its spin.
    """

    seat: np.ndarray
    head: np.ndarray
    cage_axis: np.ndarray
    cage: np.ndarray


class Record(NamedTuple):
    """A run at the paper's output times, and the cage at ``INSTANT`` (at half time of a shorter run)."""

    run: Run
    balance: Balance
    fine: Run  # the same run at every time it was asked for; where peaks and onsets are read
    # By contact (T, 3) or (T, balls, 3), force on the second body in world axes at the paper's times [N].
    world: dict[str, np.ndarray]
    # turns, angle: of the bodies at the paper's times; the joint's [rad].
    turns: Turns
    angle: float


def _run(
    scene: Joint, params: Params, times: Array, how: Plan
) -> tuple[Solution, dict[str, Reading], dict[str, Array]]:
    """Solution, readings, and per instant contact forces on the cage, its velocity, axis and azimuth or its rate, other turns."""
    solution = integrate(scene, params, times, how, "forward")
    c = constants(scene, params)

    def look(y: Array) -> tuple[dict[str, Reading], dict[str, Array]]:
        state = view(scene, c, y)
        _, coupling = on_bodies(scene, c, state, contact_forces(scene, c, state))
        azimuth = state.cage_azimuth
        if azimuth is None:
            azimuth = azimuth_rate(state.cage_axis, state.cage_spin)
        return observe(scene, c, y), {
            "forces": coupling[scene.slices["cage"]], "velocity": state.cage_velocity, "axis": state.cage_axis,
            "azimuth": azimuth, "seat": state.seat_turn, "head": state.head_turn,
        }  # fmt: skip

    readings, seen = jax.vmap(look)(solution.states)
    return solution, readings, seen


def record(
    scene: Joint, params: Params, end: float = END, start: tuple[float, float] | None = None, instants: int = 0
) -> Record:
    """Run a dynamic joint with a free cage as the paper did: output every ``STEP`` up to ``end`` [s].

    ``start``: until when and how finely the start is looked at besides [s, s]. ``instants``: least number of instants to look
    at, the added ones before the end: runs of one scene with as many share a compiled program.
    """
    regular = np.linspace(0.0, end, round(end / STEP) + 1)
    instant = INSTANT if end > INSTANT + _HALF else 0.5 * end
    at = np.array([instant - _HALF, instant, instant + _HALF])
    close = np.arange(0.0, start[0], start[1]) if start else np.zeros(1)
    times = np.unique(np.concatenate([regular, at, close]))
    # ``unique`` keeps two numbers that differ by rounding; an instant that is a sample is wanted once.
    times = times[np.concatenate([[True], np.diff(times) > 1e-9])]
    added = np.linspace(times[-2], times[-1], max(instants - times.size, 0) + 2)[1:-1]
    times = np.concatenate([times[:-1], added, times[-1:]])
    how = plan(scene, ACCURACY, _MAX_STEPS)
    arguments = dict(params), times, how
    run_it, compile_s = program("paper", _run, (scene,), arguments)
    begin = time.perf_counter()
    solution, readings, seen = run_it(*arguments)
    walls = {"wall_s": time.perf_counter() - begin, "compile_s": compile_s}
    keep = np.searchsorted(times, regular - 1e-9)
    fine = story(scene, times, solution, readings, how, walls)
    readings = jax.tree.map(lambda part: part[keep], readings)
    run = story(scene, regular, solution, readings, how, walls)
    low, middle, high = np.searchsorted(times, at - 1e-9)
    pace = seen["velocity"]
    rate = (pace[high] - pace[low]) / (times[high] - times[low])
    mass = float(params["cage_mass"])
    azimuth = seen["azimuth"]
    if scene.azimuth is None:
        azimuth = np.concatenate([[0.0], np.cumsum(0.5 * (azimuth[1:] + azimuth[:-1]) * np.diff(times))])
    turns = Turns(*(x[keep] for x in (seen["seat"], seen["head"], seen["axis"], azimuth)))
    world = {name: np.asarray(reading.world) for name, reading in readings.items()}
    balance = Balance(float(times[middle]), seen["forces"][middle], mass * rate)
    return Record(run, balance, fine, world, turns, float(params["joint_angle"]))
