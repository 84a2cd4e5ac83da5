"""How deep and how fast a mechanism's contacts are to be expected, from its first instant; its error scale.

Nobody has run a mechanism before it is run. What can be known is how its bodies would move without contact forces: of
each face the relative velocity w and free acceleration a of its two points, and the mass m that it feels, 1/(J M^-1 J')
with J its row of partial velocities. Across the gap g the impact comes at  v = sqrt((n . w)^2 + 2 |n . a| g)  with the
energy m v^2/2, and a contact that holds bears m |n . a|. The penetration of every contact follows from the largest such
energy and force by its own law; the error scale is the least of them. Where a gap has no direction yet (a pin in the
middle of its bearing) that of the acceleration stands in.

The scale is a guess; every run can measure its own error (``simulate``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.normal import regularised_force
from bcfj_jax.core.numerics import bisected, positive, smooth_ramp
from bcfj_jax.core.vectors import ZERO, Number, Vector, add, cross, dot, plus, scale, subtract, times, unit
from bcfj_jax.mechanism import alike
from bcfj_jax.mechanism.bodies import Part
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.equations import Equations, onto, solved
from bcfj_jax.mechanism.rows import ByName, Places, taken
from bcfj_jax.mechanism.rows import own as own_of
from bcfj_jax.mechanism.sizes import Params

# A velocity that equations count, and of one of several bodies that are alike its place; else None.
Velocity = tuple[int, int | None]
# Where nothing is known: a penetration of a micrometre [m], a speed of a millimetre a second [m/s].
DEPTH, SPEED = 1e-6, 1e-3
# A load that is none [N].
_NOTHING = 1e-9


class Expected(NamedTuple):
    """What the first instant says."""

    # depth, speed: penetration [m] and speed [m/s] of the contacts to come.
    depth: Array
    speed: Array
    levers: list[Number]  # by velocity of ``rows``, how far the points of contact move by it [m/rad, or 1]
    # brought, stored: by contact, energy [J] that it is to take in, and that its first penetration holds.
    brought: dict[str, Array]
    stored: dict[str, Array]
    # By contact, time [s] from a touch to the next under the free acceleration; infinite without one.
    flight: dict[str, Array]


def expected(scene: Dynamics, params: Params, inside: bool = True) -> Expected:
    """What the first instant says (module docstring); ``inside``: with what bodies store that start in each other."""
    t = jnp.zeros(())
    now = scene.instant(t, scene.initial_state(params), params, laws=False)
    gathered = scene.assembled(t, now, params, pressing=False)
    count = len(scene._velocities)
    rates = gathered.accelerations(count)
    felt = _Felt(gathered, count, [[] for _ in range(count)])
    parts = now.bodies.parts
    # Bodies with their accelerations without contact forces for their drifts.
    free = lambda part: part._replace(**dict(zip(("drift", "swirl"), part.gained(rates), strict=True)))  # noqa: E731
    freed: Mapping[str, Part] = {}
    if any(map(alike.scattered, scene.bundles)):
        freed = parts.changed(free) if isinstance(parts, ByName) else {n: free(part) for n, part in parts.items()}
    brought, stored, flight, met = {}, {}, {}, []
    forces, speeds, masses = [], [], []
    for c in scene.bundles:
        # Velocities are each body's own: those of bodies side by side are gathered before, in their accelerations.
        scattered = alike.scattered(c)
        first, second = c.parts(freed if scattered else parts)
        place, count_of = c.place(1, second, params), len(c.each)
        energies, held, flights = [], [], []
        for (face, touch), own in zip(now.faces[c.name], now.memory[c.name], strict=True):
            point = add(place, face.lever)
            arms = subtract(point, first.place), subtract(point, second.place)
            gain = subtract(second.drift_at(arms[1]), first.drift_at(arms[0]))
            partials = {} if scattered else felt.partials((first, second), arms)
            gain = add(gain, *(scale(own_of(rates[j], k), v) for (j, k), v in partials.items()))
            moving = add(touch.slide, scale(touch.rate, face.normal))
            way = _direction(face.normal, gain, moving)
            if isinstance(c, alike.Alike) and (places := c.places(parts)) is not None:
                mass = felt.beside(parts, places, way, arms)
            elif scattered:
                own_arms = alike.apart(c, (way, arms))
                each = (
                    (felt.partials(one.parts(parts), own_arms[one.name][1]), own_arms[one.name][0]) for one in c.each
                )
                mass = jnp.stack([felt.mass(*pair) for pair in each])
            else:
                mass = felt.mass(partials, way)
            pull, rate = jnp.abs(jnp.asarray(dot(way, gain))), jnp.asarray(dot(way, moving))
            gap = positive(-jnp.asarray(face.depth))
            squared = rate**2 + 2.0 * pull * gap
            if c.remembers:
                # A contact that begins pressed knows of the fall that loads it so.
                squared = jnp.maximum(squared, jnp.asarray(own[0]) ** 2)
            energies.append(_of_each(jnp.max, 0.5 * mass * squared, count_of))
            forces.append(jnp.max(mass * pull))
            speeds.append(jnp.max(jnp.sqrt(squared + 1e-300)))
            masses.append(jnp.min(jnp.where(mass > 0, mass, jnp.inf)))
            held.append(_of_each(jnp.max, _stored(c, jnp.asarray(face.depth), params), count_of))
            flights.append(_of_each(jnp.min, 2.0 * jnp.sqrt(squared + 1e-300) / jnp.maximum(pull, 1e-300), count_of))
        most, kept = (jnp.max(jnp.stack(x), axis=0) for x in (energies, held))
        # A body that starts inside the regularisation is thrown out: what is stored there counts as well.
        met.append(jnp.max(most + kept if inside else most))
        brought |= alike.apart(c, most)
        stored |= alike.apart(c, kept)
        flight |= alike.apart(c, jnp.min(jnp.stack(flights), axis=0))
    found = [jnp.max(jnp.stack(jnp.broadcast_arrays(*x)), axis=0) if x else jnp.ones(()) for x in felt.levers]
    lengths: list[Number] = [jnp.where(x > 1e-9, x, 1.0) for x in found]
    if not scene.contacts:
        return Expected(jnp.asarray(DEPTH), jnp.asarray(SPEED), lengths, brought, stored, flight)
    energy = jnp.max(jnp.stack(met))
    force, mass = jnp.max(jnp.stack(forces)), jnp.min(jnp.stack(masses))
    mass = jnp.where(jnp.isfinite(mass), mass, 1.0)
    speed = jnp.maximum(jnp.max(jnp.stack(speeds)), jnp.sqrt(2.0 * energy / mass))
    depth = jnp.min(jnp.stack([jnp.min(_depth(c, energy, force, speed, params)) for c in scene.bundles]))
    swing = jnp.sqrt(force * depth / mass)
    return Expected(depth, jnp.maximum(jnp.maximum(speed, swing), SPEED), lengths, brought, stored, flight)


def expected_scale(scene: Dynamics, params: Params) -> Array:
    """Error scale (n,): a coordinate by the expected penetration over its lever, a velocity by the speed over it.

    With friction the speed is no more than friction's transition speed over its coefficient: a fraction of that is as
    large an error of the force as the same fraction of the penetration.
    """
    found = expected(scene, params)
    speed = found.speed
    for c in scene.bundles:
        values = c.coefficients(params) if c.friction is not None else {}
        if "friction_speed" in values:
            share = values.get("friction_static", values.get("friction_dynamic", jnp.ones(())))
            speed = jnp.minimum(speed, jnp.min(values["friction_speed"] / jnp.clip(share, 1e-9, 1.0)))
    places, at = [], 0
    for b in (row.body for row in scene.rows):
        own = found.levers[at : at + len(b.rates)]
        at += len(b.rates)
        plain = len(b.coordinates) - (4 if "q0" in b.coordinates else 0)
        turning = jnp.broadcast_arrays(*own[plain:]) if len(b.coordinates) > plain else [jnp.ones(())]
        longest = jnp.max(jnp.stack(turning), axis=0)
        places += [found.depth / x for x in own[:plain]] + [found.depth / longest] * (len(b.coordinates) - plain)
    kept: list[Number] = []
    for c in scene.contacts:
        kept += c.sizes(found.speed, found.depth, known_at(c, found.speed, params)) * c.faces if c.memory else []
    kept += [load.reach(params) for load in scene._bristly]
    return scene.state(places, [speed / x for x in found.levers], kept)


class _Felt(NamedTuple):
    """The mass that a face feels, by the mass matrix of so many free velocities; ``levers``: how far contacts moved by each."""

    gathered: Equations
    count: int
    levers: list[list[Array]]

    def partials(self, bodies: tuple[Part, Part], arms: tuple[Vector, Vector]) -> dict[Velocity, Vector]:
        """By velocity, that of the second body's point past the first's, at ``arms`` from their origins."""
        found: dict[Velocity, Vector] = {}
        for part, arm, sign in zip(bodies, arms, (-1.0, 1.0), strict=True):
            for j in part.partials:
                if j < self.count:
                    w, origin = part.partials[j]
                    v = scale(sign, add(origin, cross(w, arm)))
                    key = j, part.of and part.of[0]
                    found[key] = add(found.get(key, ZERO), v)
                    self.levers[j].append(onto(jnp.max(_size(v)), 0, part.of))
        return found

    def mass(self, partials: dict[Velocity, Vector], way: Vector) -> Array:
        """Along a direction; 0 of what nothing moves."""
        row = {key: dot(way, v) for key, v in partials.items()}
        found: Number = 0.0
        for k in {k for _, k in row}:
            mine = {j: x for (j, of), x in row.items() if of == k}
            found = plus(found, _compliance(self.gathered, mine, self.count, lambda x, k=k: own_of(x, k)))
        return _mass(found)

    def beside(
        self,
        parts: Mapping[str, Part],
        places: tuple[Places | None, Places | None],
        way: Vector,
        arms: Sequence[Vector],
    ) -> Array:
        """Of contacts side by side whose bodies are in rows, or the ground."""
        found: Number = 0.0
        for where, arm in zip(places, arms, strict=True):
            if where is None:
                continue
            row = {}
            for j, (w, origin) in taken(parts[where.row].partials, where.at).items():
                v = add(origin, cross(w, arm))
                row[j] = dot(way, v)
                self.levers[j].extend(where.spread(_size(v)))
            found = plus(found, _compliance(self.gathered, row, self.count, lambda x, where=where: taken(x, where.at)))
        return _mass(found)


def _of_each(most: Callable[[Array], Array], values: Array, count: int) -> Array:
    """The most, or least, of a contact's members; of contacts side by side each one's own."""
    return jnp.broadcast_to(values, (count,)) if count > 1 else most(values)


def _direction(normal: Vector, gain: Vector, moving: Vector) -> Vector:
    """The normal, or where there is none the free acceleration's direction, or the velocity's."""
    squared = dot(normal, normal)
    if isinstance(squared, (int, float)):
        return normal
    some = jnp.asarray(dot(gain, gain)) > 0
    other = [
        jnp.where(some, x, y) for x, y in zip(map(jnp.asarray, unit(gain)), map(jnp.asarray, unit(moving)), strict=True)
    ]
    x, y, z = (jnp.where(squared > 0.25, n, o) for n, o in zip(normal, other, strict=True))
    return x, y, z


def _size(v: Vector) -> Array:
    return jnp.sqrt(jnp.asarray(dot(v, v)) + 1e-300)


def _mass(compliance: Number) -> Array:
    mass = 1.0 / jnp.maximum(jnp.asarray(compliance), 1e-30)
    return jnp.where(mass < 1e20, mass, 0.0)


def _compliance(gathered: Equations, row: dict[int, Number], count: int, of: Callable[[Number], Number]) -> Number:
    """J M^-1 J' of one face's row; ``of``: of a row's numbers those of the face's body."""
    found: Number = 0.0
    for block in gathered.blocks(count):
        own = [row.get(j, 0.0) for j in block]
        if all(isinstance(x, float) and x == 0.0 for x in own):
            continue
        moved = solved([[of(gathered.entry(j, k)) for k in block] for j in block], own)
        for a, b in zip(own, moved, strict=True):
            found = plus(found, times(a, b))
    return found


def known_at(c: Contact, speed: Array, params: Params) -> dict[str, Array]:
    """Its coefficients, of a contact that comes at a speed [m/s] and remembers no other."""
    values = c.coefficients(params) | dict.fromkeys(c.law.states, jnp.zeros(()))
    return values | {"approach_speed": speed} if c.remembers else values


def _stored(c: Contact, depth: Array, params: Params) -> Array:
    """Energy [J] of a contact at rest, to a factor of n + 1: force times depth, of its regularisation's."""
    values = known_at(c, jnp.ones(()), params)
    reach = smooth_ramp(depth, values["smoothing"])[0] if "smoothing" in values else positive(depth)
    return c.law.force(reach, jnp.zeros_like(reach), values) * reach


def _depth(c: Contact, energy: Array, force: Array, speed: Array, params: Params) -> Array:
    """Penetration that takes in an energy (force times depth is twice it), or bears a force, whichever is deeper."""
    values = known_at(c, speed, params)

    def enough(level: Array) -> Array:
        depth = jnp.exp(level)
        push = regularised_force(c.law, depth, jnp.zeros_like(depth), values, values.get("smoothing"))
        return (push * depth > 2.0 * energy) & (push > force)

    # Contacts side by side may have coefficients of their own.
    shape = (len(c.each),) if len(c.each) > 1 else ()
    bracket = jnp.full(shape, jnp.log(1e-15)), jnp.full(shape, jnp.log(10.0))
    found = jnp.exp(bisected(enough, bracket, 30)[1])
    # Nothing that moves or pulls: nothing is known.
    return jnp.where((energy > 1e-30) | (force > _NOTHING), found, DEPTH)
