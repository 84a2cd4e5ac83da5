"""A start at rest: the places at which all forces balance, and their derivatives.

Sought are coordinates q with Q(q, u = 0, t = 0) = 0, Q the force on every free velocity u (``equations``): weight, springs,
preload, contacts; drives hold their places of time 0. Friction holds from where the search first touches (``stuck``, whose
slips are found with the places); what laws remember is as at a first touch. From the places of ``start`` the bodies move as if
damped heavily (pseudo-transient continuation; Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508):

    (M/s + K) d = Q,    K = -dQ/dq,    q <- q + d,

M the diagonal of the mass matrix; s grows where a step loses energy, (Q + Q') . d >= 0, and falls where it gains. So a fall
ends on what is below, and a pendulum hangs. With s large this is Newton's method. Steps of it beyond the
solution carry the derivatives (implicit function theorem: dq = K^-1 dQ; two steps for second ones). Where K has no stiffness
and nothing pulls, as along a floor, bodies stay where they are. A change of the places given moves what friction holds with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.mechanism import equations, stuck
from bcfj_jax.mechanism.bodies import Drive, unit_of
from bcfj_jax.mechanism.checks import asked
from bcfj_jax.mechanism.dynamics import Dynamics, Instant
from bcfj_jax.mechanism.instruments import Forces
from bcfj_jax.mechanism.loads import CoordinateLoad
from bcfj_jax.mechanism.sizes import Params
from bcfj_jax.mechanism.stuck import TIME, Slips, Ways

# Name under which completed parameters have the state.
REST = "(state at rest)"
# Steps; a force is balanced to this share of all that act along it, or to what K makes of places so far off [m, rad].
_STEPS, _BALANCED, _ROUNDED, _FAR = 2000, 1e-9, 1e-14, 1e3
# Of that share a creep's velocities may lack.
_CREPT = 1e-6
# s [s^2] at first and at most; a step's turn at most [rad].
_FIRST, _MOST, _TURN = 1e-6, 1e4, 0.5
# A motion is named whose force is so much of the greatest left; of K relative to M, below which it is none [1/s^2].
_NAMED, _SOFT = 1e-2, 1e-3


class _Known(NamedTuple):
    """What is known of places: by velocity the force, the sizes of all that act and the diagonal of the mass matrix; K (n, n)."""

    force: Array
    sizes: Array
    mass: Array
    stiffness: Array


class Rest(NamedTuple):
    """The state at time 0, NaN without rest; what is known of its places; whether the forces balance."""

    state: Array
    known: _Known
    balanced: Array


# Places (q,) and slips.
_At = tuple[Array, Slips]
# What is known of places, s, the step's number, and how many steps all has been balanced.
_Carry = tuple[tuple[_At, _Known, Ways], Array, Array, Array]


def _held(drive: Any, body: str, t: Array, p: Params) -> Array:
    """A drive's place at time 0, whatever the time."""
    return jnp.asarray(drive.position(jnp.zeros_like(t), body, p))


class _Search:
    """The forces of one mechanism at rest; flat coordinates (q,), moves (n,) one a velocity.

    ``bound``: whether friction has limits.
    """

    def __init__(self, m: Dynamics, p: Params, bound: bool = True) -> None:
        held = {b.name: Drive("function", function=partial(_held, b.drive, b.name), breaks=()) for b in m._driven}
        fixed = [replace(b, drive=held[b.name]) if b.name in held else b for b in m.bodies]
        self.scene = replace(m, bodies=tuple(fixed), start="", one_by_one=True)
        self.placed, self.free = [k for *_, k in m._placed], [k for *_, k in m._free]
        self.count = sum(k or 1 for k in self.free)
        self.given = m.placed_state(p)[: sum(k or 1 for k in self.placed)]
        self.bound = bound
        # As functions of their own they are traced once, however often asked for.
        self.read, self.forces, self.ways = dict(p), jax.jit(self._forces), jax.jit(self._ways)
        here = jax.eval_shape(self.ways, self.given, p)
        # By NumPy: what is made under a trace may not be closed over.
        self.unknown = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), here)
        self.held: Slips = jax.tree.map(lambda x: np.zeros(x.shape[:-1]), self.unknown.slips)
        turning = [unit_of(rate) == "rad/s" for _, rate, k in m._free for _ in range(k or 1)]
        self.turning = np.array(turning, bool)

    def moved(self, places: Array, move: Array) -> Array:
        """Coordinates after a move."""
        q, v = equations.apart(places, self.placed), equations.apart(move, self.free)
        now: Any = Instant(list(q), list(v), None, {}, {}, {})  # pyright: ignore[reportArgumentType]
        found = places + equations.flat(self.scene._rates(now), self.placed)
        q = equations.apart(found, self.placed)
        for i, (_, key, _) in enumerate(self.scene._placed):
            if key == "q0":
                size = jnp.sqrt(sum((x * x for x in q[i : i + 4]), jnp.zeros(())))
                q[i : i + 4] = [x / size for x in q[i : i + 4]]
        return equations.flat(q, self.placed)

    def _at(self, places: Array, p: Params) -> Instant:
        y = self.scene.recalling(jnp.concatenate([places, jnp.zeros(self.count)]), p)
        return self.scene.instant(jnp.zeros(()), y, p)

    def _ways(self, places: Array, p: Params) -> Ways:
        """What moves of these places are as slips."""
        now = self._at(places, p)
        mass = self._massed(Forces(self.scene._members, 1.0), now, p)
        return stuck.ways(self.scene, now, places, mass, p, self.bound)

    def slid(self, here: Ways, held: Slips, move: Array, p: Params) -> Slips:
        """Slips after a move."""
        return stuck.added(self.scene, here, held, move, p, self.bound)

    def _massed(self, found: Forces, now: Instant, p: Params) -> Array:
        """The diagonal of the mass matrix (n,), gathered in ``found``."""
        for b in self.scene.ordered:
            part = now.bodies.parts[b.name]
            found.body(part, now.bodies.center[b.name], now.bodies.mass[b.name], self.scene.inertia(b, p))
        return equations.flat([found.entry(j, j) for j in range(len(self.free))], self.free)

    def _forces(self, places: Array, held: Slips, p: Params) -> tuple[Array, Array, Array]:
        """Force on every free velocity, the sizes of all that act, the diagonal of the mass matrix; (n,) each."""
        # Sizes by the forces themselves: of a rod that hangs straight no moment is left to compare with.
        scene, t, found = self.scene, jnp.zeros(()), Forces(self.scene._members, 1.0)
        now, dry = stuck.rubbed(scene, self._at(places, p), held, p, self.bound)
        scene._pressed(found, now, p)
        for load in scene.loads:
            scene._loaded(found, load, t, now, p)
            if isinstance(load, CoordinateLoad) and load.name in dry:
                found.push(scene._coordinate(load.body, t, now, p)[0], dry[load.name])
        mass, n = self._massed(found, now, p), len(self.free)
        return equations.flat(found.forces[:n], self.free), equations.flat(found.sizes[:n], self.free), mass

    def known(self, places: Array, here: Ways, held: Slips, p: Params) -> _Known:
        """Forces, and how stiff they are: one pass for both."""

        def forces(move: Array) -> tuple[Array, tuple[Array, Array, Array]]:
            found = self.forces(self.moved(places, move), self.slid(here, held, move, p), p)
            return found[0], found

        slope, found = jax.jacfwd(forces, has_aux=True)(jnp.zeros(self.count))
        force, sizes, mass = found
        return _Known(force, sizes, mass, -slope)

    def newton(self, at: _At, p: Params, beside: Array) -> _At:
        """One step with s at its largest from places and slips; ``beside``: a move of the places given (0)."""
        places, here = at[0], self.ways(at[0], p)
        held = self.slid(here, stuck.fallen(here, at[1], -beside), -beside, p)
        force, _, mass, matrix = self.known(places, here, held, p)
        move = jnp.linalg.solve(jnp.diag(mass / _MOST) + matrix, force + mass / _MOST * beside)
        return self.moved(places, move), self.slid(here, held, move, p)

    def creep(self, at: _At, p: Params) -> tuple[_At, Array, Array]:
        """Places and slips at which friction bears as it creeps, its velocities (n,), and what force they leave (n,)."""
        (places, held), here = at, self.ways(at[0], p)

        def there(v: Array) -> Array:
            return self.moved(places, TIME * (v - here.level @ v))

        def slips(v: Array) -> Slips:
            return stuck.given(self.scene, held, here.along(here.level @ v))

        speeds, left = stuck.creep(lambda v: self.forces(there(v), slips(v), p)[0], self.forces(places, held, p)[2])
        return (there(speeds), slips(speeds)), here.level @ speeds, left


def _crept(search: _Search, places: Array, p: Params) -> tuple[_At, _Known, Array]:
    """Coordinates and slips where the bodies come to rest, what is known there, and whether forces balance."""

    def step(carry: _Carry) -> _Carry:
        (at, known, here), s, i, done = carry
        move = jnp.linalg.solve(jnp.diag(known.mass / s) + known.stiffness, known.force)
        turn = jnp.max(jnp.where(search.turning, jnp.abs(move), 0.0), initial=0.0)
        move = move / jnp.maximum(turn / _TURN, 1.0)
        there = search.moved(at[0], move), search.slid(here, at[1], move, p)
        beyond = search.ways(there[0], p)
        after = search.known(there[0], beyond, there[1], p)
        work = jnp.dot(known.force, move)
        # The first step is none: it begins to know. At the end rounding decides what a step loses.
        nearer = (done > 0) & (jnp.sum(after.force**2 / known.mass) < jnp.sum(known.force**2 / known.mass))
        lost = (i == 0) | (work > 0.0) & (work + jnp.dot(after.force, move) >= 0.0) | nearer
        at, known, here = jax.tree.map(partial(jnp.where, lost), (there, after, beyond), (at, known, here))
        s = jnp.where(i == 0, s, jnp.clip(jnp.where(lost, 4.0 * s, s / 8.0), 1e-30, _MOST))
        # Forces of springs are rounded as their lengths are; what is farther away flees.
        far = jnp.clip(jnp.max(jnp.abs(at[0]), initial=0.0), 1.0, _FAR)
        rounded = _ROUNDED * far * jnp.sum(jnp.abs(known.stiffness), 1)
        balanced = jnp.all(jnp.abs(known.force) <= _BALANCED * known.sizes + rounded)
        # Two steps more, of Newton's method.
        return (at, known, here), jnp.where(balanced, _MOST, s), i + 1, jnp.where(balanced, done + 1, 0)

    def more(carry: _Carry) -> Array:
        return (carry[2] < _STEPS) & (carry[3] < 3)

    none, unit = jnp.zeros(search.count), jnp.ones(search.count)
    begin = (places, search.held), _Known(none, none, unit, jnp.zeros((none.size, none.size))), search.unknown
    found = lax.while_loop(more, step, (begin, jnp.asarray(_FIRST), jnp.asarray(0), jnp.asarray(0)))
    (at, known, _), *_, done = found
    return at, known, done > 0


def _found(search: _Search) -> Callable[[Array, Params], tuple[_At, _Known, Array]]:
    """``_crept``; where it is differentiated, two steps of Newton's method beyond carry the derivatives."""

    def beyond(given: Array, read: Params) -> tuple[_At, _Known, Array]:
        placed = lax.stop_gradient(given)
        at, known, balanced = lax.stop_gradient(_crept(search, placed, lax.stop_gradient(read)))
        ways = jax.jacfwd(partial(search.moved, at[0]))(jnp.zeros(search.count))
        # 0, with the derivatives of the places given: they stay where nothing holds a body.
        known_by = ways.T @ ways
        # What turns a ``sphere`` is no coordinate: nothing is beside.
        known_by = known_by + jnp.diag(jnp.where(jnp.diagonal(known_by) > 0.0, 0.0, 1.0))
        beside = jnp.linalg.solve(known_by, ways.T @ (given - placed))
        # A loop compiles one of both steps.
        step = lambda at, share: (search.newton(at, read, share * beside), None)  # noqa: E731
        return lax.scan(step, at, jnp.array([1.0, 0.0]))[0], known, balanced

    found = jax.custom_jvp(partial(_crept, search))
    found.defjvp(lambda primals, tangents: jax.jvp(beyond, primals, tangents))
    return found


def settled(m: Dynamics, p: Params) -> Rest:
    """The state at rest and what is known of it; the velocities that a start gives stay, those of friction's creep are added."""
    search = _Search(m, p)
    found, known, balanced = _found(search)(search.given, search.read)
    (places, slips), speeds = found, m.placed_state(p)[found[0].size :]
    if search.held:
        (places, slips), creep, left = search.creep(found, search.read)
        speeds, balanced = speeds + creep, balanced & jnp.all(jnp.abs(left) <= _CREPT * known.sizes)
    moving = jnp.concatenate([jnp.where(balanced, places, jnp.nan), speeds])
    return Rest(m.recalling(moving, p, stuck.bent(search.scene, slips)), known, balanced)


def rest(m: Dynamics, p: Params) -> Rest:
    """``settled`` by a program of its own where the parameters are numbers: one for whatever is asked of the run."""
    if any(is_traced(x) for x in p.values()):
        return settled(m, p)
    return asked(settled, replace(m, implicit=False), dict(p))


def sticking(m: Dynamics, p: Params) -> tuple[Array, dict[str, tuple[Array, Array]]]:
    """Whether friction without limits finds a rest; by contact and load what it needs there, and what friction has."""
    search = _Search(m, p, bound=False)
    (places, held), _, balanced = _crept(search, search.given, search.read)
    return balanced, stuck.needed(search.scene, search._at(places, p), held, p)


def check(m: Dynamics, p: Params, where: str) -> None:
    """Refuse a mechanism that finds no rest, or is not stable there, with the motion that is free. On the host."""
    found = rest(m, p)
    names = [f"'{body}' ({rate})" for body, rate, k in m._free for _ in range(k or 1)]
    units = ["N m" if unit_of(rate) == "rad/s" else "N" for _, rate, k in m._free for _ in range(k or 1)]

    def moving(share: np.ndarray) -> str:
        large = share >= _NAMED * np.max(share)
        return " and ".join(dict.fromkeys(name for name, one in zip(names, large, strict=True) if one))

    force, sizes, mass, matrix = (np.asarray(x) for x in found.known)
    left, scaled = np.abs(force), 1.0 / np.sqrt(np.maximum(mass, 1e-300))
    if not bool(found.balanced):
        worst = int(np.nanargmax(left)) if np.isfinite(left).any() else 0
        held = f"there is no equilibrium: nothing stops {moving(left / np.maximum(sizes, 1e-300))}"
        remedy = (
            "hold it by a spring, a contact or a drive, place it nearer to where it rests, or take start = 'static' out"
        )
        balanced, ratios = asked(sticking, m, dict(p))
        lacking = [
            f"{float(need):.3g} at '{name}' (it has {float(has):.3g})"
            for name, (need, has) in ratios.items()
            if float(need) > float(has)
        ]
        if bool(balanced) and lacking:
            remedy = f"friction of {' and '.join(lacking)} would hold it; give that, or {remedy}"
        raise InputError(f"{where} start", f"{held}; {left[worst]:.3g} {units[worst]} are left", remedy)
    # Friction's part of K is not symmetric.
    values, modes = np.linalg.eig(matrix * scaled[:, None] * scaled)
    rates = np.real(values)
    softest = int(np.argmin(rates)) if rates.size else 0
    if rates.size and rates[softest] < -_SOFT:
        leaving = moving(np.abs(modes[:, softest]) * scaled)
        said = f"the equilibrium is unstable: {leaving} would leave it"
        raise InputError(f"{where} start", said, "start it beside, or hold it")
