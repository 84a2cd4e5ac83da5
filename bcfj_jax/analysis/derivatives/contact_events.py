"""The verb ``contact_events``: trains of impacts, timing and shape apart, with derivatives and how good they are.

Two passes: a run without derivatives finds the contacts; one with derivatives, which takes the same steps, is read at them
(``trains``). Both land on contacts (``solve.landing``), which is why the level's own tolerance is enough: after 30 bounces at
``balanced`` derivatives are right to some 1e-4, where a pointwise one is a spike. The same at a sixteenth of the tolerance
gives the result, and their difference how far it may be off.

A stiff model's runs do not land on contacts; both passes are BDF's with the tangents' error in its steps, which are the same
in both, and a force error of at most ``_STIFF`` (``solve.crossings``).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple, Unpack, cast

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from bcfj_jax.analysis.derivatives.certificate import apart
from bcfj_jax.analysis.derivatives.jacobian import by_shares, channel_names
from bcfj_jax.analysis.derivatives.names import Feature, complete, event, members
from bcfj_jax.analysis.derivatives.names import feature as named
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.trains import PHASES, TILTED, Marks, Train, flat, instants, planned, train
from bcfj_jax.analysis.features import EVENTS, Event
from bcfj_jax.core.dual import Dual
from bcfj_jax.core.errors import InputError, texts
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import OK, reason
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import Plan, Solving, SolvingKeys, plan
from bcfj_jax.solve.simulation import ready
from bcfj_jax.xla.programs import program

# Contacts of a channel that are looked at, and of a run.
MOST, _ALL = 128, 1024
# Contacts of a stiff model that are read in one run, and its force error at most: from 1e-4 to 1e-6 errors of the joint's
# derivatives fall to a thirtieth or less, and the steps grow to twice as many (benchmarks/analysis/contact_events.py).
_BLOCK, _STIFF = 64, 1e-6
# The run that is taken is so much tighter than the one that it is compared with.
TIGHTER = 1.0 / 16.0
# Tolerances of the two solves that bound a number of a contact (``bounds``), over its own, by whether the model is stiff. One
# number of two solves may agree by luck, as one in ten of the joint's does.
BOUNDING = {False: (1.0 / 16.0, 1.0 / 256.0), True: (1.0 / 4.0, 1.0 / 40.0)}
# An impulse of so uneven a force is not known.
_UNEVEN = 1e-3


class ContactEvents(NamedTuple):
    """What ``contact_events`` found.

    Attributes:
        wrt: names of the parameters.
        phases: (N,) at which forces are given, 0 at a contact's begin and 1 at its end.
        trains: by channel (``contact``, ``seat_ball_2``) its contacts.
        derivative: by parameter and channel.
        apart: by parameter and channel, how far the derivatives of each of ``features.EVENTS`` (E, K) are from
            those at a tolerance 16 times as large, as a share; 0.01 % of the number per 1 % of the parameter counts as
            least.
        features: value by name (``contact.begin_3``), those asked for or all.
        feature_derivatives: by parameter and name.
        reasons: by name of a feature, why it is NaN; nothing for the others.
        counts: by channel, how many contacts began within the run.
        status, reason, failure_time: as ``Run``.
        stats: steps, wall_s and compile_s.
        missed: by channel, contacts and separations that began and ended within one step of an implicit solver. They are
            left out, and numbers of later contacts are without them.
    """

    wrt: tuple[str, ...]
    phases: Float[np.ndarray, " N"]
    trains: dict[str, Train]
    derivative: dict[str, dict[str, Train]]
    apart: dict[str, dict[str, np.ndarray]]
    features: dict[str, float]
    feature_derivatives: dict[str, dict[str, float]]
    reasons: dict[str, str]
    counts: dict[str, int]
    status: str
    reason: str
    failure_time: float
    stats: dict[str, float]
    missed: dict[str, int]


class Solved(NamedTuple):
    """M contacts at one tolerance: their channels and numbers, values and derivatives by parameter, how the run ended."""

    channel: np.ndarray
    number: np.ndarray
    value: Train
    derivative: dict[str, Train]
    counts: np.ndarray
    code: int
    end: float
    accepted: int
    rejected: int
    wall_s: float
    compile_s: float
    missed: np.ndarray


@taking(Solving)
def contact_events(
    scene: AbstractModel, params: Params, times: Float[ArrayLike, " T"], wrt: Sequence[str] = (), *,
    features: Sequence[str] = (), **settings: Unpack[SolvingKeys],
) -> ContactEvents:  # fmt: skip
    """When the contacts of a run begin, peak and end, their peaks, impulses and shapes, with derivatives.

    Not of a model without a history.

    Args:
        scene, params, accuracy, max_steps: as ``simulate``.
        times: (T,) [s] of which the last is the run's end.
        wrt: names of parameters, groups or patterns, as of ``sensitivity``; none for values alone.
        features: names such as ``contact.begin_3`` or ``seat_ball_2.peak_1``; by default all of every contact.

    Raises:
        InputError: for names that are not known, with the nearest, for times that are not right, and for a scene whose
            contacts cannot be followed.
    """
    scene, params, t = ready(scene, params, times)
    full, names = complete(scene, params, wrt) if len(wrt) else (dict(params), ())
    given = texts("features", features, 'name features, such as "contact.begin_1"')
    asked = [named(name, scene.members) for name in given]
    for one in asked:
        if event(one.kind) is None:
            right = f"use one of {', '.join(EVENTS)} with a number"
            raise InputError(f"feature '{one.name}'", "is of no single contact", right)
    how = plan(scene, **settings)
    problem = Problem(scene, full, t, names, asked, max_steps=how.max_steps)
    return _presented(problem, *(solved_at(problem, how, asked, tighter) for tighter in (1.0, TIGHTER)))


def check_followed(scene: AbstractModel) -> None:
    """Refuse a scene whose contacts cannot be followed: one without contacts, or without a history."""
    traits, where = scene.traits, f"scene '{scene.kind}'"
    if not scene.members:
        raise InputError(where, "has no contact", "contacts' begins, peaks and ends need one")
    if traits.open or not traits.history:
        raise InputError(where, "has no history of its own", "contacts' begins, peaks and ends need a motion")


def _places_of(scene: AbstractModel, one: Feature) -> list[tuple[str, int, int]]:
    """Name, number of the channel and number of the contact, from 0, of what a feature is of: every member's."""
    channels, (_, number) = channel_names(scene.members), cast(tuple, event(one.kind))
    return [(name, channels.index(name), number - 1) for name in members(one.contacts[0], scene.members)]


def solved_at(problem: Problem, how: Plan, asked: Sequence[Feature], tighter: float = 1.0) -> Solved:
    """The contacts that features ask for (all for none), at a share of the plan's tolerance; see ``contact_events``."""
    scene, wrt = problem.scene, problem.names
    check_followed(scene)
    how, stiff = planned(scene, how, tighter, _STIFF), scene.traits.stiff
    wanted = {place[1:] for one in asked for place in _places_of(scene, one)}
    most = MOST if not wanted else 1 << max(3, max(k for _, k in wanted).bit_length())
    given, last, spent = dict(problem.params), np.asarray(float(problem.times[-1])), np.zeros(2)

    def ask(name: str, function: Any, static: tuple, arguments: tuple) -> Any:
        run, compile_s = program(name, function, static, arguments)
        begin = time.perf_counter()
        result = run(*arguments)
        spent[:] += time.perf_counter() - begin, compile_s
        return result

    def read(marks: Sequence[Any]) -> Any:
        marks = Marks(*map(np.asarray, marks))  # pyright: ignore[reportArgumentType]
        return ask("contact events", _solved, ((scene, wrt, most if stiff else 1),), (given, marks, last, how))

    # One program serves runs with about as many contacts.
    places = _places(len(wanted))
    if stiff:
        # Steps with derivatives are others than those without: a run that reads nothing finds the contacts.
        places = min(places, _BLOCK) if wanted else _BLOCK
        found = read([np.zeros(places, int), *[np.full(places, np.nan)] * 4])[2][-1]
    else:
        found = ask("contacts", _found, (scene, most), (given, last, how))
    counts = np.asarray(found.count)
    pairs = sorted(wanted) or [(c, k) for c, count in enumerate(counts) for k in range(min(int(count), MOST))]
    if len(pairs) > _ALL:
        raise InputError("features", f"{len(pairs)} contacts", f"name those that are wanted, {_ALL} at most")
    places = places if stiff else _places(len(pairs))
    parts, rows = [], np.array(pairs, int).reshape(-1, 2)
    for k in range(0, max(len(pairs), 1), places):
        block = rows[k : k + places]
        filled_up = np.array([*block, *[(0, most)] * (places - len(block))])
        slopes, value, ended = read(flat(found, *filled_up.T))
        own = slice(len(block))
        one = jax.tree.map(lambda x, own=own: np.asarray(x)[own], value)
        parts.append((one, jax.tree.map(lambda x, own=own: np.asarray(x)[:, own], slopes), ended))
    value, slopes = (jax.tree.map(lambda *x, axis=k: np.concatenate(x, axis), *(p[k] for p in parts)) for k in (0, 1))
    code, stop, accepted, rejected, _ = parts[0][2]
    by, missed = {name: jax.tree.map(lambda x, k=k: x[k], slopes) for k, name in enumerate(wrt)}, found.missed
    return Solved(
        rows[:, 0], rows[:, 1], value, by, counts, int(code), float(stop), int(accepted), int(rejected), float(spent[0]),
        float(spent[1]), np.zeros_like(counts) if missed is None else np.asarray(missed),
    )  # fmt: skip


def _places(count: int) -> int:
    """Places for so many contacts, a power of 2."""
    return 1 << max(2, math.ceil(math.log2(max(count, 1))))


def _found(scene: AbstractModel, most: int, params: dict, end: Array, how: Plan) -> Any:
    return instants(scene, params, end, how, most)


def _solved(what: tuple[AbstractModel, tuple[str, ...], int], params: dict, marks: Marks, end: Array, how: Plan) -> Any:
    """Derivatives of the train, the train, how the run ended, and the contacts that it found."""
    scene, wrt, most = what

    def at(params: dict) -> tuple:
        found, ended, seen = train(scene, params, marks, end, how, most)
        return found, (ended.code, ended.end, ended.accepted, ended.rejected, seen)

    if not wrt:
        return (), *at(params)
    slopes, (found, rest) = by_shares(at, params, wrt)
    return slopes, found, rest


def filled(problem: Problem, how: Plan, values: np.ndarray, slopes: np.ndarray, tighter: float = 1.0) -> dict[str, str]:
    """Put what is of single contacts into features (F,) and derivatives (F, P); by name, why one is NaN."""
    own = [i for i, f in enumerate(problem.wanted) if event(f.kind)]
    if not own:
        return {}
    asked = [problem.wanted[i] for i in own]
    found = solved_at(problem, how, asked, tighter)
    values[own], slopes[own] = numbers(problem.scene, found, asked)
    return _reasons(problem.scene, found, asked)


def numbers(scene: AbstractModel, found: Solved, asked: Sequence[Feature]) -> tuple[np.ndarray, np.ndarray]:
    """Features (F,) of contacts and their derivatives (F, P); the mean of members, of peaks the largest."""
    where = {pair: i for i, pair in enumerate(zip(found.channel.tolist(), found.number.tolist(), strict=True))}
    values, slopes = np.full(len(asked), np.nan), np.full((len(asked), len(found.derivative)), np.nan)
    for i, one in enumerate(asked):
        kind = EVENTS[cast(tuple, event(one.kind))[0]]
        rows = [where[place[1:]] for place in _places_of(scene, one)]
        by = np.reshape([kind.of(d)[rows] for d in found.derivative.values()], (-1, len(rows)))
        # One reason for a value and its derivatives.
        if not why(scene, found, one):
            whole = kind.members(Dual(kind.of(found.value)[rows], by))
            values[i], slopes[i] = whole.value, whole.slope
    return values, slopes


def _reasons(scene: AbstractModel, found: Solved, asked: Sequence[Feature]) -> dict[str, str]:
    return {f.name: text for f in asked if (text := why(scene, found, f))}


def why(scene: AbstractModel, found: Solved, one: Feature) -> str:
    """Why a feature of a contact is NaN; "" where it is not."""
    known = EVENTS[cast(tuple, event(one.kind))[0]]
    return next(filter(None, (_why(found, known, *place) for place in _places_of(scene, one))), "")


def _why(found: Solved, known: Event, name: str, channel: int, number: int) -> str:
    many, failed = int(found.counts[channel]), f"the run failed at {found.end:.6g} s"
    if number >= many:
        until = f"{name} has {many or 'no'} contact{'' if many == 1 else 's'} until the run's end"
        return until if found.code == OK else failed
    row = int(np.flatnonzero((found.channel == channel) & (found.number == number))[0])
    v = found.value
    if "begin" in known.needs and not np.isfinite(v.begin[row]):
        return "it was closed at the start"
    if "end" in known.needs and not np.isfinite(v.end[row]):
        return "it lasts beyond the run's end" if found.code == OK else failed
    if known.integral and not v.unsure[row] <= _UNEVEN:
        return f"its force is too uneven: the points that it is read at give its impulse to {v.unsure[row]:.1g}"
    if known.summit:
        length = np.sqrt(2.0 * v.peak[row] / max(-v.bend[row], 1e-300))
        if not (v.bend[row] < 0 and abs(v.tilt[row]) * length <= TILTED * v.peak[row]):
            return "its force has no smooth peak"
    return "" if np.isfinite(known.of(v)[row]) else "it is not finite: the contact begins or ends without speed"


def _presented(problem: Problem, loose: Solved, tight: Solved) -> ContactEvents:
    scene, params, wrt = problem.scene, problem.params, problem.names
    channels = channel_names(scene.members)
    wanted = list(problem.wanted) or [
        Feature(f"{channels[c]}.{kind}_{k + 1}", f"{kind}_{k + 1}", (channels[c],))
        for c, k in zip(tight.channel, tight.number, strict=True)
        for kind in EVENTS
    ]
    values, slopes = numbers(scene, tight, wanted)
    used = {channels[c]: int(c) for c in np.unique(tight.channel)}
    apart = {p: {name: _apart(loose, tight, c, p, float(params[p])) for name, c in used.items()} for p in wrt}
    by_channel = [dict(zip(channels, map(int, n), strict=True)) for n in (tight.counts, tight.missed)]
    failed = tight.code != OK
    return ContactEvents(
        wrt, PHASES.copy(), {name: _train(tight, c, tight.value) for name, c in used.items()},
        {p: {name: _train(tight, c, tight.derivative[p]) for name, c in used.items()} for p in wrt}, apart,
        {f.name: float(x) for f, x in zip(wanted, values, strict=True)}, problem._replace(wanted=wanted).by_name(slopes),
        _reasons(scene, tight, wanted), by_channel[0], "failed" if failed else "ok", reason(tight.code, problem.max_steps),
        tight.end if failed else float("nan"),
        {
            "accepted": tight.accepted, "rejected": tight.rejected,
            "wall_s": loose.wall_s + tight.wall_s, "compile_s": loose.compile_s + tight.compile_s,
        },
        by_channel[1],
    )  # fmt: skip


def _train(found: Solved, channel: int, of: Train) -> Train:
    """One channel's contacts in their order, from 1 to the last that was looked at."""
    own = np.flatnonzero((found.channel == channel) & (found.number < found.counts[channel]))
    most = int(found.number[own].max(initial=-1)) + 1

    def placed(values: np.ndarray) -> np.ndarray:
        table = np.full((most, *values.shape[1:]), np.nan)
        table[found.number[own]] = values[own]
        return table

    return Train(*map(placed, of))


def _apart(loose: Solved, tight: Solved, channel: int, parameter: str, value: float) -> np.ndarray:
    """How far derivatives (E, K) at two tolerances are apart."""
    tables = (loose, loose.derivative[parameter]), (tight, tight.derivative[parameter]), (tight, tight.value)
    first, second, numbers = (_train(found, channel, of) for found, of in tables)
    rows = []
    for known in EVENTS.values():
        a, b, n = map(known.of, (first, second, numbers))
        full = np.full(b.size, np.nan)
        full[: min(a.size, b.size)] = a[: b.size]
        rows.append(apart(full[:, None], b[:, None], n, np.array([value]))[:, 0])
    return np.array(rows)
