"""Derivatives of steady motion: of the periodic orbit, by the implicit function theorem over one pitch.

A turning model that has forgotten its start repeats itself after a pitch T(p), its members renumbered. With the map
P(x, p) over one pitch, renumbered back, the state x at one phase of the drive solves

    x = P(x, p),    dx/dp = (I - dP/dx)^-1 dP/dp,

and Newton's method with the same matrix finds x from the end of a run. What the motion does not decide (phase of a
prescribed drive, a length that is kept: ``model.neutral``) is taken out of dP/dx and moves with the initial state.
Times are shares of the pitch. One program: a solve of one pitch with all tangents, of states and parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter as clock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.batch import places
from bcfj_jax.analysis.derivatives.certificate import apart, of_feature
from bcfj_jax.analysis.derivatives.jacobian import Histories, by_channel
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import Feature
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.features import KINDS, OF_TURN
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.programs import program
from bcfj_jax.core.status import OK
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.mechanism.onward import BEGIN, START, Onward
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import readings

# Samples of a pitch, both ends included, and where in it they lie.
SAMPLES = 101
_SHARES = np.linspace(0.0, 1.0, SAMPLES)
# Force error of a pitch's solve; a second one, so much looser, says how good its derivatives are. At 1e-5 those by weak
# parameters are 4 to 8 % off, at 1e-6 less than 1 %, in half as many steps again (benchmarks/models/joint_steady.py).
_ERROR, _LOOSER = 1e-6, 10.0
# A motion repeats itself where Newton's last correction is less, in units of the states' natural sizes.
_SETTLED = 0.1


class _Pitch(NamedTuple):
    """What one pitch gave; states in units of their natural sizes, parameters in shares of their sizes (P).

    Attributes:
        end: (n,) state after the pitch, renumbered back; force (K, C, 3) [N], depth (K, C) [m] at K shares of it.
        by_params, by_start: derivatives of (end, force, depth), parameters (P) or states (n) as the last axis.
        scale: (n,) the states' natural sizes.
        kept: (n, n) projection that ``model.neutral`` makes; begun: (n, P) derivative of the initial state.
        pitch: [s], with its derivative (P,).
    """

    end: Any
    force: Any
    depth: Any
    by_params: Any
    by_start: Any
    kept: Any
    begun: Any
    pitch: Any
    pitch_slope: Any
    scale: Any
    code: Any
    steps: Any


def _pitch(
    scene: AbstractModel, wrt: tuple[str, ...], params: Params, sizes: Array, state: Array, pitches: Array,
    shares: Array, how: Plan,
) -> _Pitch:  # fmt: skip
    """The map over one pitch from a state ``pitches`` pitches after time 0, and what contacts do meanwhile. Pure."""
    from bcfj_jax.solve.integrate import integrate  # With diffrax, which a kept program does not need.

    scale = scene.error_scale(params)

    def moved(theta: Array) -> dict:
        return {**params, **{name: params[name] + sizes[k] * theta[k] for k, name in enumerate(wrt)}}

    def at(theta: Array, start: Array) -> Any:
        p = moved(theta)
        pitch = scene.pitch(p)
        onward, given = Onward(scene), {**p, START: state + scale * start, BEGIN: pitches * pitch}
        times = shares * pitch
        found = integrate(onward, given, times, how, "forward", True)
        force, depth, _ = by_channel(scene, readings(onward, given, times, found.states))
        end = scene.pitch_before(p, found.states[-1]) / scale
        return (end, force, depth), (end, force, depth, found.code, found.accepted + found.rejected)

    theta, zero = jnp.zeros(len(wrt)), jnp.zeros(state.size)
    slopes, (end, force, depth, code, steps) = jax.jacfwd(at, argnums=(0, 1), has_aux=True)(theta, zero)
    by_params, by_start = zip(*slopes, strict=True)
    kept = jax.vmap(lambda e: scene.neutral(state, scale * e) / scale, out_axes=1)(jnp.eye(state.size))
    begun = jax.jacfwd(lambda theta: scene.initial_state(moved(theta)) / scale)(theta)
    pitch, pitch_slope = scene.pitch(params), jax.jacfwd(lambda theta: scene.pitch(moved(theta)))(theta)
    return _Pitch(end, force, depth, by_params, by_start, kept, begun, pitch, pitch_slope, scale, code, steps)


class Steady(NamedTuple):
    """Steady motion of a run that repeats itself every pitch, and its derivatives; of one turn of the drive.

    Attributes:
        pitch: [s]; turn: of the drive [s].
        features: value by name, over one turn; feature_derivatives: by parameter and name, per SI unit.
        apart: by parameter and name, relative difference of the derivatives at two tolerances.
        verdicts: likewise: what that difference makes of them.
        force: per channel (K, C, 3) over one pitch [N], K even shares of it; derivative: (P, K, C, 3) per SI unit.
        off: what one more pitch would change the state by, in units of the states' natural sizes.
        memory: share of a disturbance that is left after a pitch (spectral radius of the map).
        reason: why there is none; "" where there is.
        steps, wall_s, compile_s: of its solves.
    """

    pitch: float
    turn: float
    features: dict[str, float]
    feature_derivatives: dict[str, dict[str, float]]
    apart: dict[str, dict[str, float]]
    verdicts: dict[str, dict[str, str]]
    force: np.ndarray
    derivative: np.ndarray
    off: float
    memory: float
    reason: str
    steps: int
    wall_s: float
    compile_s: float


class _Orbit(NamedTuple):
    """A solved pitch: force and depth as ``_Pitch``'s, with their whole derivatives, parameters in shares (P) first."""

    value: Histories
    derivative: Histories
    pitch: float
    pitch_slope: np.ndarray
    state: np.ndarray
    off: float
    memory: float
    good: bool
    steps: int


def steady(problem: Problem, state: np.ndarray, time: float) -> Steady | None:
    """Derivatives of the steady motion to which a run has come; None for a model that does not know a pitch.

    Args:
        problem: what is differentiated.
        state: (n,) of the run at ``time`` [s], late in it.
    """
    scene, params, wrt = problem.scene, problem.params, problem.names
    if not scene.recurs(params):
        return None
    begin = clock()
    kinds = [f for f in problem.wanted if f.kind in OF_TURN]
    if not kinds:
        return _none("it has none of these features")
    (first, last), why, compile_s = _orbits(scene, params, state, time, wrt, problem.max_steps)
    if why:
        return _none(why)
    sizes, pitch = _sizes(params, wrt), last.pitch
    numbers, slopes = _features(scene, params, last, kinds)
    loose_slopes = _features(scene, params, first, kinds)[1]
    distance = apart(loose_slopes, slopes, numbers, np.ones(len(wrt)))
    named = {n: {f.name: float(distance[i, k]) for i, f in enumerate(kinds)} for k, n in enumerate(wrt)}
    per_unit = {n: {f.name: float(slopes[i, k] / sizes[k]) for i, f in enumerate(kinds)} for k, n in enumerate(wrt)}
    return Steady(
        pitch, scene.period(params)[0], {f.name: float(x) for f, x in zip(kinds, numbers, strict=True)}, per_unit, named,
        {n: {name: of_feature(x) for name, x in row.items()} for n, row in named.items()},
        last.value.force, last.derivative.force / sizes[:, None, None, None], last.off, last.memory, "",
        first.steps + last.steps, clock() - begin - compile_s, compile_s,
    )  # fmt: skip


def check_recurs(scene: AbstractModel, params: Params) -> None:
    """Refuse a scene whose steady motion is not known to repeat itself.

    Raises:
        InputError: for such a scene, and for one whose level is not chosen.
    """
    if scene.traits.open or not scene.recurs(params):
        found = f"the steady motion of the scene '{scene.kind}' is not known to repeat itself every pitch"
        raise InputError("steady", found, "leave it out, or take a joint with an even drive and a steady load")


class Turn(NamedTuple):
    """One turn of steady motion at even shares of it, both ends included; the reason why there is none, or "".

    ``derivative`` is per SI unit, at a fixed share of the turn.
    """

    value: Histories
    derivative: Histories
    reason: str
    compile_s: float


def turn(
    scene: AbstractModel, params: Params, state: np.ndarray, time: float, wrt: tuple[str, ...], max_steps: int
) -> Turn:
    """Histories of one turn of the steady motion to which a run has come; arguments are those of ``steady``."""
    nothing = Histories(None, None, None, None)
    if not scene.recurs(params):
        return Turn(nothing, nothing, "its motion has no pitch", 0.0)
    (_, last), why, compile_s = _orbits(scene, params, state, time, wrt, max_steps)
    if why:
        return Turn(nothing, nothing, why, compile_s)
    value, slopes = _turn(scene, params, last)
    unit = _sizes(params, wrt)
    by = [x / unit.reshape(-1, *[1] * (x.ndim - 1)) for x in slopes[:3]]
    return Turn(value, Histories(*by, state=None), "", compile_s)


def shares(scene: AbstractModel, params: Params) -> np.ndarray:
    """(K,) instants of ``turn`` as shares of it, from 0 to 1."""
    return np.linspace(0.0, 1.0, _pitches(scene, params) * (SAMPLES - 1) + 1)


class Ends(NamedTuple):
    """States (N, n) at the ends of N runs, how and when [s] each ended, attempted steps, rounds of the batch."""

    state: np.ndarray
    code: np.ndarray
    end: np.ndarray
    steps: np.ndarray
    rounds: int
    compile_s: float


def to_the_end(scene: AbstractModel, params: Mapping[str, np.ndarray], last: np.ndarray, how: Plan, size: int) -> Ends:
    """Run N points, at most ``size``, to their ends (N,) [s] in one batch; leaves of ``params`` are (N,)."""
    count = len(last)
    fill = np.where(np.arange(size) < count, np.arange(size), 0)
    given = {name: leaf[fill] for name, leaf in params.items()}
    arguments = given, last[fill], Plan(how.tolerance, how.max_steps), np.asarray(count)
    batch, compile_s = program("batch to the end", _ends, (scene,), arguments)
    *found, rounds = batch(*arguments)
    state, code, end, steps = (x[:count] for x in found)
    return Ends(state, code, end, steps, int(rounds), compile_s)


def _ends(scene: AbstractModel, params: dict, ends: Array, how: Plan, count: Array) -> tuple:
    from bcfj_jax.solve.work_queue import integrate_queue  # With diffrax, which a kept program does not need.

    grid, width = jnp.array([0.0, 1.0]), min(places(), ends.size)
    found, rounds = integrate_queue(scene, params, ends, grid, how, count, width)
    return found.states[:, -1], found.code, found.end, found.accepted + found.rejected, rounds


def _orbits(
    scene: AbstractModel, params: Params, state: np.ndarray, time: float, wrt: tuple[str, ...], max_steps: int
) -> tuple[list[_Orbit], str, float]:
    """The orbit at two tolerances, why there is none or "", and the seconds that getting the program took."""
    nothing: list[Any] = [None, None]
    settled = scene.settled_from(params)
    if time < settled:
        return nothing, f"the run ends before {settled:.4g} s, when {scene.settled_when}", 0.0
    pitch, sizes, start = scene.period(params)[1], _sizes(params, wrt), clock()
    solve, tight = prepared(scene, params, wrt, max_steps)
    compile_s = clock() - start
    loose = Plan(_LOOSER * tight.tolerance, max_steps, tight.tangents)
    orbits: list[_Orbit] = []
    for how in (loose, tight):
        found = solve(dict(params), sizes, state, np.asarray(time / pitch), _SHARES, how)
        orbits.append(_orbit(params, wrt, found, state, scene))
        state = orbits[-1].state
        if not orbits[-1].good:
            return nothing, "no motion was found that repeats itself every pitch", compile_s
    last = orbits[-1]
    # Newton's correction at the tighter tolerance says how far the first was from repeating itself.
    if not last.off <= _SETTLED or not last.memory < 1.0:
        why = f"the motion does not repeat itself: a disturbance keeps {last.memory:.2g} of itself in a pitch"
        return nothing, why, compile_s
    return orbits, "", compile_s


def prepared(
    scene: AbstractModel, params: Params, wrt: tuple[str, ...], max_steps: int
) -> tuple[Callable[..., _Pitch], Plan]:
    """The compiled map over a pitch of a model that knows one, and how it is solved at the tighter tolerance."""
    tight = plan(scene, _ERROR, max_steps)
    state = np.zeros(jax.eval_shape(scene.initial_state, params).shape)
    arguments = (dict(params), _sizes(params, wrt), state, np.asarray(1.0), _SHARES, tight)
    return program("pitch", _pitch, (scene, wrt), arguments)[0], tight


def _none(why: str) -> Steady:
    nan = float("nan")
    return Steady(nan, nan, {}, {}, {}, {}, np.zeros((0, 0, 3)), np.zeros((0, 0, 0, 3)), nan, nan, why, 0, 0.0, 0.0)


def _sizes(params: Params, wrt: Sequence[str]) -> np.ndarray:
    """What a share of each parameter is a share of: its size, or 1 of its unit at 0."""
    values = np.array([float(params[name]) for name in wrt])
    return np.where(values == 0.0, 1.0, np.abs(values))


def _orbit(params: Params, wrt: Sequence[str], found: _Pitch, state: np.ndarray, scene: AbstractModel) -> _Orbit:
    """Newton's next state, and derivatives along the orbit, dx/dp = (I - dP/dx)^-1 dP/dp, in what the motion decides."""
    kept, by_start = found.kept, found.by_start[0]
    inner = kept @ by_start @ kept
    good = int(found.code) == OK and bool(np.isfinite(inner).all() and np.isfinite(found.by_params[0]).all())
    if not good:
        nothing = Histories(None, None, None, None)
        return _Orbit(nothing, nothing, 0.0, np.zeros(0), state, np.inf, np.inf, False, int(found.steps))
    scale, matrix = found.scale, np.eye(len(state)) - inner
    given = (np.eye(len(state)) - kept) @ found.begun
    change = given + np.linalg.solve(matrix, kept @ (by_start @ given + found.by_params[0]))
    correction = np.linalg.solve(matrix, kept @ (found.end - state / scale))
    force, depth = (found.by_params[k] + found.by_start[k] @ change for k in (1, 2))
    memory = float(np.abs(np.linalg.eigvals(inner)).max())
    return _Orbit(
        Histories(found.force, found.depth, np.zeros_like(found.depth), None),
        Histories(np.moveaxis(force, -1, 0), np.moveaxis(depth, -1, 0), np.moveaxis(0.0 * depth, -1, 0), None),
        float(found.pitch), np.asarray(found.pitch_slope), state + scale * correction,
        float(np.abs(correction).max()), memory, True, int(found.steps),
    )  # fmt: skip


def _pitches(scene: AbstractModel, params: Params) -> int:
    """Pitches of a turn."""
    whole, pitch = scene.period(params)
    return round(whole / pitch)


def _turn(scene: AbstractModel, params: Params, orbit: _Orbit) -> tuple[Histories, Histories]:
    """Histories of a turn, pitch by pitch, members renumbered, and their derivatives by shares."""
    contacts, turned = scene.members, scene.turned(params)
    channel = np.arange(orbit.value.force.shape[1])
    pieces = []
    for k in range(_pitches(scene, params)):
        # Pitches later member j does what member j + turned did.
        later, first = channel.copy(), 0
        for members in contacts.values():
            if members:
                later[first : first + members] = first + (np.arange(members) + turned * k) % members
            first += members or 1
        pieces.append(later)

    def unfolded(x: np.ndarray, axis: int) -> np.ndarray:
        whole = [np.take(x, piece, axis + 1) for piece in pieces]
        ends = [np.delete(part, -1, axis) for part in whole[:-1]]
        return np.concatenate([*ends, whole[-1]], axis)

    value = Histories(*(unfolded(x, 0) for x in orbit.value[:3]), state=None)
    return value, Histories(*(unfolded(x, 1) for x in orbit.derivative[:3]), state=None)


def _features(
    scene: AbstractModel, params: Params, orbit: _Orbit, wanted: Sequence[Feature]
) -> tuple[np.ndarray, np.ndarray]:
    """Features (F,) over one turn, and their derivatives (F, P) by shares."""
    contacts, count = scene.members, _pitches(scene, params)
    times = count * orbit.pitch * shares(scene, params)
    value, derivative = _turn(scene, params, orbit)
    found, slopes = measure(times, value, derivative, [f for f in wanted if f.kind != "period"], contacts, True)
    numbers, changes, rest = [], [], iter(zip(found, slopes, strict=True))
    for feature in wanted:
        if feature.kind == "period":
            # A member's own, or that of a contact with members: a turn; of any other a pitch.
            pitches = count if contacts.get(feature.contacts[0], 1) else 1
            numbers.append(pitches * orbit.pitch)
            changes.append(pitches * orbit.pitch_slope)
            continue
        number, slope = next(rest)
        # Times are shares of the pitch, which moves too.
        moved = number * orbit.pitch_slope / orbit.pitch if KINDS[feature.kind].turn == "longer" else 0.0
        numbers.append(number)
        changes.append(slope + moved)
    return np.array(numbers), np.stack(changes)
