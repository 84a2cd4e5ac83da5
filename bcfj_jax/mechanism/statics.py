"""A start at rest: the places at which all forces balance, and their derivatives.

Sought are coordinates q with Q(q, u = 0, t = 0) = 0, Q the force on every free velocity u (``equations``): weight, springs,
preload and contacts; drives hold their places of time 0. Friction gives nothing at rest, and states of laws and bristles are
as at a first touch. From the places of ``start`` the bodies move as if damped heavily (pseudo-transient continuation;
Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508):

    (M/s + K) d = Q,    K = -dQ/dq,    q <- q + d,

M the diagonal of the mass matrix; s grows where a step loses energy, (Q + Q') . d >= 0, and falls where it gains. So a fall
ends on what is below, and a pendulum hangs. With s large this is Newton's method. Steps of it beyond the
solution carry the derivatives (implicit function theorem: dq = K^-1 dQ; two steps for second ones). Where K has no stiffness
and nothing pulls, as along a floor, bodies stay where they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism import equations
from bcfj_jax.mechanism.bodies import Drive, unit_of
from bcfj_jax.mechanism.checks import asked
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.instruments import Forces
from bcfj_jax.mechanism.sizes import Params

# Steps; a force is balanced to this share of all that act along it, or to what K makes of places so far off [m, rad].
_STEPS, _BALANCED, _ROUNDED = 2000, 1e-9, 1e-14
# s [s^2] at first and at most; a step's turn at most [rad].
_FIRST, _MOST, _TURN = 1e-6, 1e4, 0.5
# A motion is named whose force is so much of the greatest left; of K relative to M, below which it is none [1/s^2].
_NAMED, _SOFT = 1e-2, 1e-3


class Rest(NamedTuple):
    """What is found: coordinates; by velocity the force left, the sizes of all that act, and the least stiff motion.

    Attributes:
        places: (q,) coordinates.
        left, sizes: (n,) [N, N m].
        balanced: whether the forces balance.
        softest: least eigenvalue of K over M [1/s^2], negative where the equilibrium is unstable; its ``mode`` (n,).
    """

    places: Array
    left: Array
    sizes: Array
    balanced: Array
    softest: Array
    mode: Array


class _Held:
    """A drive that stays where it is at time 0."""

    def __init__(self, drive: Drive, body: str) -> None:
        self.drive, self.body = drive, body

    def __call__(self, t: Array, p: Params) -> Any:
        return jnp.asarray(self.drive.position(jnp.zeros_like(t), self.body, p))


class _Sizes(Forces):
    """Sizes by the forces themselves: of a rod that hangs straight no moment is left to compare with."""

    rounding = 1.0


class _Read(Mapping):
    """Parameters, and those of them that were read."""

    def __init__(self, p: Params) -> None:
        self.given, self.read = p, {}

    def __getitem__(self, name: str) -> Array:
        self.read[name] = self.given[name]
        return self.given[name]

    def __contains__(self, name: object) -> bool:
        return name in self.given

    def __iter__(self) -> Iterator[str]:
        return iter(self.given)

    def __len__(self) -> int:
        return len(self.given)


class _Search:
    """The forces of one mechanism at rest; flat coordinates (q,), moves (n,) one a velocity."""

    def __init__(self, m: Dynamics, p: Params) -> None:
        held = [b if b.drive is None else replace(b, drive=Drive("function", function=_Held(b.drive, b.name), breaks=()))
                for b in m.bodies]  # fmt: skip
        self.scene = replace(m, bodies=tuple(held), start="", one_by_one=True)
        self.placed, self.free = [k for *_, k in m._placed], [k for *_, k in m._free]
        self.count = sum(k or 1 for k in self.free)
        self.given = m.placed_state(p)[: sum(k or 1 for k in self.placed)]
        read = _Read(p)
        self._forces(self.given, read)
        # As a function of its own it is traced once, however often it is asked for; of what it reads, and no more.
        self.read, self.forces = read.read, jax.jit(self._forces)
        turning = [unit_of(rate) == "rad/s" for _, rate, k in m._free for _ in range(k or 1)]
        self.turning = np.array(turning, bool)

    def moved(self, places: Array, move: Array) -> Array:
        """Coordinates after a move."""
        q, v = equations.apart(places, self.placed), equations.apart(move, self.free)
        now: Any = _Moved(list(q), list(v))
        found = places + equations.flat(self.scene._rates(now), self.placed)
        q = equations.apart(found, self.placed)
        for i, (_, key, _) in enumerate(self.scene._placed):
            if key == "q0":
                size = jnp.sqrt(sum((x * x for x in q[i : i + 4]), jnp.zeros(())))
                q[i : i + 4] = [x / size for x in q[i : i + 4]]
        return equations.flat(q, self.placed)

    def _forces(self, places: Array, p: Params) -> tuple[Array, Array, Array]:
        """Force on every free velocity, the sizes of all that act, the diagonal of the mass matrix; (n,) each."""
        scene, t = self.scene, jnp.zeros(())
        y = scene.recalling(jnp.concatenate([places, jnp.zeros(self.count)]), p)
        now, found = scene.instant(t, y, p), _Sizes(scene._members)
        scene._pressed(found, now, p)
        for load in scene.loads:
            scene._loaded(found, load, t, now, p)
        n = len(self.free)
        for b in scene.ordered:
            part = now.bodies.parts[b.name]
            found.body(part, now.bodies.center[b.name], now.bodies.mass[b.name], scene.inertia(b, p))
        mass = [found.entry(j, j) for j in range(n)]
        return tuple(equations.flat(x[:n], self.free) for x in (found.forces, found.sizes, mass))  # pyright: ignore[reportReturnType]

    def stiffness(self, places: Array, p: Params) -> Array:
        """K (n, n)."""
        return -jax.jacfwd(lambda move: self.forces(self.moved(places, move), p)[0])(jnp.zeros(self.count))

    def newton(self, places: Array, p: Params, beside: Array | float = 0.0) -> Array:
        """One step with s at its largest, ``beside`` added to the forces."""
        force, _, mass = self.forces(places, p)
        matrix = jnp.diag(mass / _MOST) + self.stiffness(places, p)
        return self.moved(places, jnp.linalg.solve(matrix, force + mass / _MOST * beside))


class _Moved(NamedTuple):
    """What ``Dynamics._rates`` reads of an instant."""

    q: list[Any]
    v: list[Any]


def _crept(search: _Search, places: Array, p: Params) -> tuple[Array, Array]:
    """Coordinates where the bodies come to rest, and whether they do."""

    def step(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        places, s, i, _ = carry
        force, sizes, mass = search.forces(places, p)
        matrix = search.stiffness(places, p)
        # Forces of springs are rounded as their lengths are.
        rounded = _ROUNDED * jnp.maximum(1.0, jnp.max(jnp.abs(places), initial=0.0)) * jnp.sum(jnp.abs(matrix), 1)
        done = jnp.all(jnp.abs(force) <= _BALANCED * sizes + rounded)
        move = jnp.linalg.solve(jnp.diag(mass / s) + matrix, force)
        turn = jnp.max(jnp.where(search.turning, jnp.abs(move), 0.0), initial=0.0)
        move = move / jnp.maximum(turn / _TURN, 1.0)
        there = search.moved(places, move)
        after = search.forces(there, p)[0]
        lost = (jnp.dot(force, move) > 0.0) & (jnp.dot(force + after, move) >= 0.0)
        s = jnp.clip(jnp.where(lost, 4.0 * s, s / 8.0), 1e-30, _MOST)
        return jnp.where(lost & ~done, there, places), s, i + 1, done

    def more(carry: tuple[Array, Array, Array, Array]) -> Array:
        return (carry[2] < _STEPS) & ~carry[3]

    begin = places, jnp.asarray(_FIRST), jnp.asarray(0), jnp.asarray(False)
    found, _, _, balanced = lax.while_loop(more, step, begin)
    return found, balanced


def initial_state(m: Dynamics, p: Params, begun: Array) -> Array:
    """The state at rest, from the one at which the bodies are placed; velocities that a start gives stay. NaN without rest."""
    search = _Search(m, p)
    placed, still = lax.stop_gradient((search.given, search.read))
    found, balanced = _crept(search, placed, still)
    ways = jax.jacfwd(partial(search.moved, found))(jnp.zeros(search.count))
    # 0, with the derivatives of the places given: they stay where nothing holds a body.
    beside = jnp.linalg.solve(ways.T @ ways, ways.T @ (search.given - placed))
    found = search.newton(found, search.read, beside)
    found = search.newton(found, search.read)
    moving = jnp.concatenate([jnp.where(balanced, found, jnp.nan), begun[found.size : found.size + search.count]])
    return m.recalling(moving, p)


def rest(m: Dynamics, p: Params) -> Rest:
    """What is found of one set of parameters."""
    search = _Search(m, p)
    found, balanced = _crept(search, search.given, search.read)
    found = jnp.where(balanced, search.newton(found, search.read), found)
    force, sizes, mass = search.forces(found, search.read)
    scaled = 1.0 / jnp.sqrt(jnp.maximum(mass, 1e-300))
    matrix = search.stiffness(found, search.read) * scaled[:, None] * scaled
    values, modes = jnp.linalg.eigh(0.5 * (matrix + matrix.T))
    return Rest(found, force, sizes, balanced, values[0], modes[:, 0] * scaled)


def check(m: Dynamics, p: Params, where: str) -> None:
    """Refuse a mechanism that finds no rest, or is not stable there, with the motion that is free. On the host."""
    found = asked(rest, m, dict(p))
    names = [f"'{body}' ({rate})" for body, rate, k in m._free for _ in range(k or 1)]
    units = ["N m" if unit_of(rate) == "rad/s" else "N" for _, rate, k in m._free for _ in range(k or 1)]

    def moving(share: np.ndarray) -> str:
        large = share >= _NAMED * np.max(share)
        return " and ".join(dict.fromkeys(name for name, one in zip(names, large, strict=True) if one))

    left = np.abs(np.asarray(found.left))
    if not bool(found.balanced):
        worst = int(np.nanargmax(left)) if np.isfinite(left).any() else 0
        held = f"there is no equilibrium: nothing stops {moving(left / np.maximum(np.asarray(found.sizes), 1e-300))}"
        remedy = (
            "hold it by a spring, a contact or a drive, place it nearer to where it rests, or take start = 'static' out"
        )
        raise InputError(f"{where} start", f"{held}; {left[worst]:.3g} {units[worst]} are left", remedy)
    if float(found.softest) < -_SOFT:
        said = f"the equilibrium is unstable: {moving(np.abs(np.asarray(found.mode)))} would leave it"
        raise InputError(f"{where} start", said, "start it beside, or hold it")
