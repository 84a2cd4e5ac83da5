"""Derivatives of steady motion: of a pitch that repeats the one before, as soon as derivatives have forgotten their start.

A turning model that has forgotten its start repeats itself after a pitch T(p), its members renumbered. With the map
P(x, p) over one pitch, renumbered back, the state x at one phase of the drive and its derivative are fixed points,

    x = P(x, p),    dx/dp = dP/dx dx/dp + dP/dp.

A pitch after the other leads there, each from the end of the one before: what is wrong with dx/dp is multiplied by dP/dx.
A disturbance that is solved beside the derivatives shows how much of itself a pitch leaves, and so how many are enough. What
the motion does not decide (phase of a prescribed drive, a length that is kept: ``model.neutral``) is no part of it and
moves with the initial state. Times are shares of the pitch. One program: a solve of one pitch with its tangents.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from time import perf_counter as clock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.batch import filling, places
from bcfj_jax.analysis.derivatives.certificate import apart, of_feature
from bcfj_jax.analysis.derivatives.jacobian import Histories, by_channel
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.repeating import earlier
from bcfj_jax.analysis.features import KINDS, OF_TURN
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.status import OK
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.mechanism.observed import BEGIN, START, Onward
from bcfj_jax.solve.plan import Plan, Points, plan
from bcfj_jax.solve.simulation import readings
from bcfj_jax.xla.programs import ask, program

# Samples of a pitch, both ends included, and where in it they lie.
SAMPLES = 101
_SHARES = np.linspace(0.0, 1.0, SAMPLES)
# Force error of a pitch's solve; a second one, so much looser, says how good its derivatives are. At 1e-5 those by weak
# parameters are 4 to 8 % off, at 1e-6 less than 1 %, in half as many steps again (benchmarks/models/joint_steady.py).
_ERROR, _LOOSER = 1e-6, 10.0
# A motion repeats itself where a pitch changes its state by less, in units of the states' natural sizes.
_SETTLED = 0.1
# Share of a derivative by which it may be wrong where the pitch that is told of begins, and what it is after the looser
# pitches; pitches at most.
_FORGOTTEN, _LOOSE, _MOST = 1e-3, 0.1, 40


class _Start(NamedTuple):
    """Where a pitch begins, so many pitches after time 0: state (n,), derivatives (n, P) and a disturbance (n,).

    In units of the states' natural sizes, derivatives by shares of the parameters; NaN stands for those of the initial state.
    """

    state: Any
    slopes: Any
    disturbance: Any
    pitches: Any


class _Pitch(NamedTuple):
    """What one pitch gave."""

    end: _Start  # of the pitch, renumbered back, so that the next can begin there
    # Force (K, C, 3) [N], depth (K, C) [m] at K shares of it, and their derivatives, shares of parameters (P) as the last axis.
    force: Any
    depth: Any
    force_slopes: Any
    depth_slopes: Any
    grown: Any  # size of the disturbance over what it was
    pitch: Any  # [s], and its derivative (P,)
    pitch_slope: Any
    code: Any
    steps: Any

    @property
    def good(self) -> bool:
        """Whether it was solved, with finite derivatives."""
        finite = np.isfinite(self.end.slopes).all() and np.isfinite(self.force_slopes).all()
        return int(self.code) == OK and bool(finite)


def _pitch(
    scene: AbstractModel, wrt: tuple[str, ...], params: Params, sizes: Array, begin: _Start, shares: Array, how: Plan
) -> _Pitch:
    """The map over one pitch, and what contacts do meanwhile. Pure."""
    from bcfj_jax.solve.integrate import integrate  # With diffrax, which a kept program does not need.

    scale, theta = scene.error_scale(params), jnp.zeros(len(wrt) + 1)

    def moved(theta: Array) -> dict:
        return {**params, **{name: params[name] + sizes[k] * theta[k] for k, name in enumerate(wrt)}}

    initial = jax.jacfwd(lambda theta: scene.initial_state(moved(theta)) / scale)(theta)[:, :-1]
    begun = jnp.where(jnp.isnan(begin.slopes), initial, begin.slopes)
    disturbance = scene.neutral(scale * begin.state, scale * begin.disturbance) / scale
    before = jnp.column_stack([begun, disturbance])

    def at(theta: Array) -> Any:
        p = moved(theta)
        pitch = scene.pitch(p)
        start = scale * (begin.state + before @ theta)
        onward, given = Onward(scene), {**p, START: start, BEGIN: begin.pitches * pitch}
        found = integrate(onward, given, shares * pitch, how, "forward", True)
        force, depth, _ = by_channel(scene, readings(onward, given, shares * pitch, found.states))
        value = scene.pitch_before(p, found.states[-1]) / scale, force, depth, pitch
        return value, (value, found.code, found.accepted + found.rejected)

    slopes, (value, code, steps) = jax.jacfwd(at, has_aux=True)(theta)
    after, force, depth, pitch = (x[..., :-1] for x in slopes)
    left = scene.neutral(scale * value[0], scale * slopes[0][:, -1]) / scale
    size = jnp.linalg.norm(left)
    end = begin._replace(state=value[0], slopes=after, disturbance=left / jnp.where(size > 0.0, size, 1.0))
    grown = size / jnp.linalg.norm(disturbance)
    return _Pitch(end, value[1], value[2], force, depth, grown, value[3], pitch, code, steps)


class Steady(NamedTuple):
    """Steady motion of a run that repeats itself every pitch, and its derivatives; of one turn of the drive."""

    pitch: float  # [s]
    turn: float  # of the drive [s]
    features: dict[str, float]  # value by name, over one turn
    feature_derivatives: dict[str, dict[str, float]]  # by parameter and name, per SI unit
    # By parameter and name, relative difference of the derivatives at two tolerances.
    apart: dict[str, dict[str, float]]
    verdicts: dict[str, dict[str, str]]  # likewise: what that difference makes of them
    force: np.ndarray  # per channel (K, C, 3) over one pitch [N], K even shares of it
    derivative: np.ndarray  # (P, K, C, 3) per SI unit
    off: float  # what one more pitch would change the state by, in units of the states' natural sizes
    memory: float  # share of a disturbance that is left after a pitch, the greatest that was seen
    reason: str  # why there is none; "" where there is
    # steps, wall_s, compile_s: of its solves.
    steps: int
    wall_s: float
    compile_s: float


class _Orbit(NamedTuple):
    """A pitch that repeats the one before; off, memory and steps of all pitches: as ``Steady``'s."""

    last: _Pitch
    off: float
    memory: float
    steps: int

    @property
    def pitch(self) -> float:
        """[s]."""
        return float(self.last.pitch)


class Restless(Exception):
    """Why a motion has no derivatives of its own."""


def steady(problem: Problem, state: np.ndarray, time: float) -> Steady | None:
    """Derivatives of the steady motion to which a run has come; None for a model that does not know a pitch.

    Args:
        problem: what is differentiated.
        state: (n,) of the run at ``time`` [s], late in it.
    """
    found = first_of_steady(problem, state, time)
    return found and found[1]()


def first_of_steady(problem: Problem, state: np.ndarray, time: float) -> tuple[Steady, Callable[[], Steady]] | None:
    """As ``steady``, at the looser tolerance alone, with no verdicts; and what gives the whole."""
    scene, params, wrt, sizes = problem.scene, problem.params, problem.names, problem.sizes
    if not scene.recurs(params):
        return None
    begin = clock()
    kinds = [f for f in problem.wanted if f.kind in OF_TURN]
    if not kinds:
        nothing = _none("it has none of these features")
        return nothing, lambda: nothing
    solve, compile_s = prepared(problem)
    orbits = _orbits(problem, state, time, solve)

    def found(solved: Sequence[_Orbit]) -> Steady:
        orbit, named, of_kinds = solved[-1], {n: {} for n in wrt}, problem._replace(wanted=kinds)
        numbers, slopes = _features(of_kinds, orbit)
        derivative = np.moveaxis(orbit.last.force_slopes, -1, 0) / sizes[:, None, None, None]
        if len(solved) > 1:
            loose = _features(of_kinds, solved[0])[1]
            named = of_kinds.by_name(apart(loose, slopes, numbers, np.ones(len(wrt))))
        return Steady(
            orbit.pitch, scene.period(params)[0], {f.name: float(x) for f, x in zip(kinds, numbers, strict=True)},
            of_kinds.by_name(slopes / sizes), named,
            {n: {name: of_feature(x) for name, x in row.items()} for n, row in named.items() if row},
            orbit.last.force, derivative, orbit.off, orbit.memory, "",
            sum(one.steps for one in solved), clock() - begin - compile_s, compile_s,
        )  # fmt: skip

    def tried(*earlier: _Orbit) -> tuple[Steady, _Orbit | None]:
        try:
            one = next(orbits)
        except Restless as why:
            return _none(str(why)), None
        return found([*earlier, one]), one

    first, loose = tried()
    return first, lambda: first if loose is None else tried(loose)[0]


def check_recurs(scene: AbstractModel, params: Params) -> None:
    """Refuse a scene whose steady motion is not known to repeat itself, and one whose level is not chosen."""
    if scene.traits.open or not scene.recurs(params):
        found = f"the steady motion of the scene '{scene.kind}' is not known to repeat itself every pitch"
        raise InputError("steady", found, "leave it out, or take a joint with an even drive and a steady load")


def turn(problem: Problem, state: np.ndarray, time: float) -> tuple[Histories, Histories, float]:
    """One turn of the steady motion to which a run has come, at even shares of it, both ends included.

    Its histories, their derivatives per SI unit at a fixed share of the turn, and the seconds of compiling; arguments are those
    of ``steady``. ``Restless`` where there is none.
    """
    if not problem.scene.recurs(problem.params):
        raise Restless("its motion has no pitch")
    solve, compile_s = prepared(problem)
    *_, last = _orbits(problem, state, time, solve)
    value, slopes = _turn(problem, last)
    by = [x / problem.sizes.reshape(-1, *[1] * (x.ndim - 1)) for x in slopes[:3]]
    return value, Histories(*by, state=None), compile_s


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
    count, fill = len(last), filling(len(last), size)
    given = {name: leaf[fill] for name, leaf in params.items()}
    arguments = given, last[fill], Plan(how.tolerance, how.max_steps), np.asarray(count)
    batch, compile_s = program("batch to the end", _ends, (scene,), arguments)
    *found, rounds = batch(*arguments)
    state, code, end, steps = (x[:count] for x in found)
    return Ends(state, code, end, steps, int(rounds), compile_s)


def _ends(scene: AbstractModel, params: dict, ends: Array, how: Plan, count: Array) -> tuple:
    from bcfj_jax.solve.work_queue import integrate_queue  # With diffrax, which a kept program does not need.

    points = Points(params, ends, jnp.array([0.0, 1.0]))
    found, rounds = integrate_queue(scene, points, how, count, min(places(), ends.size))
    return found.states[:, -1], found.code, found.end, found.accepted + found.rejected, rounds


def _orbits(problem: Problem, state: np.ndarray, time: float, solve: Callable[..., _Pitch]) -> Iterator[_Orbit]:
    """The orbit at two tolerances, the looser first; ``Restless`` where there is none."""
    scene, params = problem.scene, problem.params
    settled = scene.settled_from(params)
    if time < settled:
        raise Restless(f"the run ends before {settled:.4g} s, when {scene.settled_when}")
    pitches = np.asarray(time / scene.period(params)[1])
    begin = _begin(state / ask("scales", _scales, (scene,), (dict(params),)), len(problem.names), pitches)
    for tightened, wrong in ((1.0 / _LOOSER, 1.0), (1.0, _LOOSE)):
        orbit = _orbit(lambda begin, by=tightened: solve(begin, by), begin, wrong)
        if orbit is None:
            raise Restless("no motion was found that repeats itself every pitch")
        if not orbit.off <= _SETTLED or not orbit.memory < 1.0:
            kept = f"a disturbance keeps {orbit.memory:.2g} of itself in a pitch"
            raise Restless(f"the motion does not repeat itself: {kept}")
        yield orbit
        begin = orbit.last.end


def _scales(scene: AbstractModel, params: Params) -> Array:
    return scene.error_scale(params)


def _begin(state: np.ndarray, parameters: int, pitches: np.ndarray) -> _Start:
    """A pitch's start at a late state of a run, with some disturbance of all of it."""
    disturbance = np.random.default_rng(0).normal(size=len(state)) / np.sqrt(len(state))
    return _Start(state, np.full((len(state), parameters), np.nan), disturbance, pitches)


def prepared(problem: Problem) -> tuple[Callable[[_Start, float], _Pitch], float]:
    """The compiled map over a pitch, of a start and how much tighter than ``_ERROR``; the seconds of getting it."""
    scene, params, sizes, most = problem.scene, dict(problem.params), problem.sizes, problem.max_steps
    tight = plan(scene, _ERROR, most)
    (count,) = jax.eval_shape(scene.initial_state, params).shape
    begin = _begin(np.zeros(count), len(sizes), np.asarray(1.0))
    solve, compile_s = program("pitch", _pitch, (scene, problem.names), (params, sizes, begin, _SHARES, tight))

    def solved(begin: _Start, tightened: float) -> _Pitch:
        return solve(params, sizes, begin, _SHARES, Plan(tight.tolerance / tightened, most, tight.tangents))

    return solved, compile_s


def _none(why: str) -> Steady:
    nan = float("nan")
    return Steady(nan, nan, {}, {}, {}, {}, np.zeros((0, 0, 3)), np.zeros((0, 0, 0, 3)), nan, nan, why, 0, 0.0, 0.0)


def _orbit(solve: Callable[[_Start], _Pitch], begin: _Start, wrong: float) -> _Orbit | None:
    """Pitch after pitch until derivatives, wrong by that share at first, have forgotten it; None where one fails."""
    memory, steps = 0.0, 0
    for count in range(_MOST):
        found = solve(begin)
        steps += int(found.steps)
        if not found.good:
            return None
        memory, off = max(memory, float(found.grown)), float(np.abs(found.end.state - begin.state).max())
        begin = found.end
        if wrong <= _FORGOTTEN or (memory >= 1.0 and count > 1):
            break
        wrong *= memory
    else:
        memory = 1.0
    return _Orbit(found, off, memory, steps)


def _pitches(scene: AbstractModel, params: Params) -> int:
    """Pitches of a turn."""
    whole, pitch = scene.period(params)
    return round(whole / pitch)


def _turn(problem: Problem, orbit: _Orbit) -> tuple[Histories, Histories]:
    """Histories of a turn, pitch by pitch, members renumbered, and their derivatives by shares."""
    pieces = earlier(problem.scene, problem.params, _pitches(problem.scene, problem.params))

    def unfolded(force: np.ndarray, depth: np.ndarray, axis: int) -> Histories:
        """As histories with rates of 0, times along an axis."""
        each: list[np.ndarray] = []
        for x in (force, depth):
            whole = [np.take(x, piece, axis + 1) for piece in pieces]
            each.append(np.concatenate([*(np.delete(part, -1, axis) for part in whole[:-1]), whole[-1]], axis))
        return Histories(each[0], each[1], np.zeros_like(each[1]), None)

    last = orbit.last
    by_force, by_depth = (np.moveaxis(x, -1, 0) for x in (last.force_slopes, last.depth_slopes))
    return unfolded(last.force, last.depth, 0), unfolded(by_force, by_depth, 1)


def _features(problem: Problem, orbit: _Orbit) -> tuple[np.ndarray, np.ndarray]:
    """Features (F,) over one turn, and their derivatives (F, P) by shares."""
    scene, params, wanted = problem.scene, problem.params, problem.wanted
    contacts, count = scene.members, _pitches(scene, params)
    times = count * orbit.pitch * shares(scene, params)
    value, derivative = _turn(problem, orbit)
    found, slopes = measure(times, value, derivative, [f for f in wanted if f.kind != "period"], contacts, True)
    both, rest, pitch_slope = [], iter(zip(found, slopes, strict=True)), np.asarray(orbit.last.pitch_slope)
    for feature in wanted:
        if feature.kind == "period":
            # A member's own, or that of a contact with members: a turn; of any other a pitch.
            pitches = count if contacts.get(feature.contacts[0], 1) else 1
            both.append((pitches * orbit.pitch, pitches * pitch_slope))
            continue
        number, slope = next(rest)
        # Times are shares of the pitch, which moves too.
        moved = number * pitch_slope / orbit.pitch if KINDS[feature.kind].turn == "longer" else 0.0
        both.append((number, slope + moved))
    numbers, changes = zip(*both, strict=True)
    return np.array(numbers), np.stack(changes)
