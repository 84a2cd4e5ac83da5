"""Motion that repeats itself is solved until it does; later times are read a whole number of pitches earlier.

A model that ``recurs`` does after a pitch T what it did before, its members renumbered, once it has forgotten its start. By
parameters that leave T as it is, derivatives repeat themselves likewise, from when their own start is forgotten:

    F_later(t) = F(t - k T),    dF_later/dp (t) = dF/dp (t - k T).

Whether they do is not assumed but seen: in the states a pitch apart, of a run of values, which knows a slow drift from
rest; then in forces and derivatives over the last pitch and the one before, whose difference is part of the bound.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.jacobian import Level
from bcfj_jax.mechanism.channels import is_reading
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.mechanism.repeating import Folded, folded
from bcfj_jax.solve.plan import Plan
from bcfj_jax.solve.simulation import timed
from bcfj_jax.xla.programs import ask, program

# Pitches that a short run has after the start is forgotten, at least.
_LEAST = 3
# Instants of a pitch that are compared with those of the pitch before.
_PHASES = 24
# A short run is this much shorter, or it is none.
_SHORTER = 2.0
# Share of the tolerance asked for at which motion is looked at.
_FINER = 0.1
# By how much a state may drift in all pitches that are left out, in units of its natural size.
_DRIFT = 0.25


class Fold(NamedTuple):
    """A short run that stands for a long one."""

    run: Folded  # its times, and which answers what
    channels: np.ndarray  # (K, C) which channel did 0, 1 ... K - 1 pitches ago what each does now.
    end: float  # of the short run [s]

    @property
    def times(self) -> np.ndarray:
        """At which to solve [s]."""
        return self.run.times

    def unfolded(self, level: Level) -> Level:
        """A solve at ``times`` as one at the T times wanted; ``uneven`` says how well it repeats itself."""
        force, slope, run = level.value.force, level.derivative.force, self.run
        channel = self.channels[run.pitches]

        def read(values: np.ndarray, axis: int) -> np.ndarray:
            taken = np.take(values, run.index, axis)
            shape = [1] * taken.ndim
            shape[axis : axis + 2] = channel.shape
            return np.take_along_axis(taken, channel.reshape(shape), axis + 1)

        value, derivative = (
            x._replace(
                **{name: read(getattr(x, name), axis) for name in ("force", "penetration", "rate")},
                state=np.take(x.state, run.index, axis),
            )
            for axis, x in ((0, level.value), (1, level.derivative))
        )
        uneven = [_off(by[run.last], by[run.before][:, self.channels[1]]) for by in (force, *slope)]
        return level._replace(value=value, derivative=derivative, uneven=np.array(uneven))


def _off(last: np.ndarray, before: np.ndarray) -> float:
    """Relative difference of a pitch from the one before; 0 where both are 0."""
    size = np.sqrt(np.mean(last**2))
    return float(np.sqrt(np.mean((last - before) ** 2)) / size) if size > 0.0 else float(np.any(before))


def fold(scene: AbstractModel, params: Params, times: np.ndarray, end: float) -> Fold:
    """The short run until ``end`` [s] that stands for one at (T,) times."""
    pitch = scene.period(params)[1]
    back = pitch * np.arange(_PHASES)[::-1] / _PHASES
    run = folded(times, pitch, end, back)
    return Fold(run, earlier(scene, params, max(2, int(run.pitches.max(initial=0)) + 1)), end)


def earlier(scene: AbstractModel, params: Params, pitches: int) -> np.ndarray:
    """(K, C) of every channel the one that did 0, 1 ... K - 1 ``pitches`` ago what it does now."""
    ago, parts, first = scene.turned(params) * np.arange(pitches)[:, None], [], 0
    for members in scene.members.values():
        parts.append(first + (np.arange(members or 1) + ago) % (members or 1))
        first += members or 1
    return np.concatenate(parts, axis=1)


def _slope(scene: AbstractModel, params: dict) -> Params:
    """Derivative of the pitch by every parameter."""
    return jax.grad(lambda p: jnp.asarray(scene.pitch(p)))(params)


def _drift(scene: AbstractModel, params: dict, states: Array) -> Array:
    """(N,) by how much (N, n) states a pitch apart are off the last one, taken back as many pitches, in their natural sizes."""
    _, ago = jax.lax.scan(lambda x, _: (scene.pitch_before(params, x), x), states[-1], None, length=len(states))
    return jnp.max(jnp.abs(ago[::-1] - states) / scene.error_scale(params), axis=1)


def settled(
    scene: AbstractModel, params: Params, times: np.ndarray, names: tuple[str, ...], how: Plan
) -> tuple[Fold, np.ndarray, float] | None:
    """The short run that stands for the one wanted, and a late state and its time [s]; None where motion does not repeat itself.

    By a parameter (``names``) that moves the pitch no derivative does. ``how``: of a run of values.
    """
    # What is read of a body that turns on does not repeat itself.
    if not scene.recurs(params) or len(times) < 4 * _PHASES or any(map(is_reading, scene.members)):
        return None
    slopes = ask("slope of the pitch", _slope, (scene,), (dict(params),))
    begin, pitch = scene.settled_from(params), scene.period(params)[1]
    count = int((times[-1] - begin) / pitch) + 1
    if any(np.any(slopes[name]) for name in names) or not 2 * _LEAST <= count < len(times) // 2:
        return None
    ends = begin + pitch * np.arange(count)
    # As many instants as are wanted: the program of ``simulate``; finer, so that its errors are no drift.
    before = np.linspace(0.0, begin, len(times) - count, endpoint=False)
    run = timed(scene, params, np.append(before, ends), Plan(_FINER * how.tolerance, how.max_steps))
    if run.status != "ok" or run.trajectory is None:
        return None
    given = dict(params), run.trajectory[-count:]
    drift = program("drift", _drift, (scene,), given)[0](*given)
    uneven = np.flatnonzero(drift > _DRIFT)
    # One pitch that repeats the one before, and one more for derivatives.
    last = max(int(uneven[-1]) + 1 if uneven.size else 0, _LEAST - 2) + 2
    if _SHORTER * ends[min(last, count - 1)] > times[-1]:
        return None
    return fold(scene, params, times, float(ends[last])), run.trajectory[-1], float(ends[-1])
