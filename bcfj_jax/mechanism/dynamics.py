"""Bodies, contacts and loads as equations of motion: a plain ODE in the coordinates of the joints.

The state is flat: coordinates, velocities, then what the contacts remember; a driven body has none. What a mechanism answers
beside (``mechanism.mechanism``) is worked out from this by the other modules of the folder, which import nothing above it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache, partial
from itertools import chain
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps import Face
from bcfj_jax.contact.part import raised
from bcfj_jax.contact.wrench import ContactForce, FrictionState, couple, press
from bcfj_jax.core import limits
from bcfj_jax.core.quantities import CATALOGUE, Quantity, whole
from bcfj_jax.core.status import OK
from bcfj_jax.core.vectors import ZERO, Number, Vector, add, cross, dot, negative, scale, spread, subtract, turned
from bcfj_jax.mechanism import alike, arrays, equations, rows, sizes
from bcfj_jax.mechanism.acting import Onset
from bcfj_jax.mechanism.bodies import GROUND, INERTIAS, STILL, Body, Own, Part, carried, quaternion_rate
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.equations import Equations, flat
from bcfj_jax.mechanism.loads import AbstractLoad, CoordinateLoad, Moving, checked_action, kept, quantities
from bcfj_jax.mechanism.model import AbstractModel, Life, Params, Solution
from bcfj_jax.mechanism.rows import Row


class Instant(NamedTuple):
    """Everything at one instant.

    Coordinates, velocities, bodies; faces and touches, and memory, by names of ``bundles``; bristles by names of loads.
    """

    q: list[Number]
    v: list[Number]
    bodies: Moving
    faces: dict[str, list[tuple[Face, ContactForce]]]
    memory: dict[str, list[list[Number]]]
    bent: dict[str, Number]


class Dynamics(AbstractModel):
    """Parts of a mechanism, told at ``Mechanism``, and its equations."""

    kind: str = eqx.field(static=True)
    # Static, as functions within them are: a model has no leaves, and goes through every transformation as it is.
    bodies: tuple[Body, ...] = eqx.field(static=True, converter=partial(sizes.parts, "bodies", Body))
    contacts: tuple[Contact, ...] = eqx.field(
        static=True, converter=partial(sizes.parts, "contacts", Contact), default=()
    )
    loads: tuple[AbstractLoad, ...] = eqx.field(
        static=True, converter=lambda x: tuple(map(kept, sizes.parts("loads", object, x))), default=()
    )
    own: tuple[tuple[Quantity, Any], ...] = eqx.field(static=True, converter=lambda x: quantities("own", x), default=())
    given: tuple[tuple[str, float], ...] = eqx.field(static=True, converter=lambda x: _sorted(x), default=())
    end: Any = sizes.field("end", default=1.0)
    samples: int = eqx.field(
        static=True, default=2001, converter=lambda n: whole("samples", n, least=2, most=limits.SAMPLES)
    )
    scale: Callable[..., Array] | None = eqx.field(static=True, default=None)
    more: Callable[..., dict[str, float]] | None = eqx.field(static=True, default=None)
    implicit: bool | None = eqx.field(static=True, default=None)
    touch: Callable[[Mapping[str, float]], float | None] | None = eqx.field(static=True, default=None)
    longest_step: float | None = eqx.field(static=True, default=None)
    life: Life = eqx.field(static=True, default=())  # pyright: ignore[reportIncompatibleMethodOverride]
    start: str = eqx.field(static=True, default="")
    one_by_one: bool = eqx.field(static=True, default=False)

    @cached_property
    def ordered(self) -> tuple[Body, ...]:
        """Bodies, each after the one that it hangs on."""
        return tuple(sorted(self.bodies, key=lambda b: len(self.ancestry(b.name))))

    def ancestry(self, name: str) -> list[Body]:
        """A body, the one that it hangs on, and so on down to the ground, which is not among them."""
        found: list[Body] = []
        while name != GROUND:
            found.append(self.body(name))
            name = found[-1].parent
        return found

    def body(self, name: str) -> Body:
        """A body by name."""
        return next(b for b in self.bodies if b.name == name)

    def contact(self, name: str) -> Contact:
        """A contact by name."""
        return next(c for c in self.contacts if c.name == name)

    @property
    def members(self) -> dict[str, int]:
        """Of a contact the members of its bodies, or of its gap; 0 for one."""
        count = {GROUND: 0} | {b.name: b.members for b in self.bodies}
        return {c.name: c.gap.members or max(count[name] for name in c.between) for c in self.contacts}

    @cached_property
    def bundles(self) -> tuple[Contact, ...]:
        """The contacts, those that are alike as one (``mechanism.alike``)."""
        row = {b.name: row.name for row in self.rows if len(row.each) > 1 for b in row.each}
        return alike.bundled(
            self.contacts, self.members, lambda name: (name == GROUND, self.turning(name), row.get(name))
        )

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """The bodies, each after the one that it hangs on, those that are alike as one (``mechanism.rows``)."""
        joints = (load.coordinates for load in self.loads if isinstance(load, CoordinateLoad))
        tied = {b.name for b in self.bodies} if self.one_by_one else set(chain.from_iterable(joints))
        return rows.rows(self.ordered, tied)

    @property
    def alike(self) -> tuple[tuple[str, ...], ...]:
        return _alike(self) if len(self.contacts) > 1 else super().alike

    def side_by_side(self, c: Contact) -> int:
        """Length of the axis of one of ``bundles``; 0 for none."""
        return len(c.each) if len(c.each) > 1 else self.members[c.name]

    def faces_of(self, now: Instant, name: str) -> list[tuple[Face, ContactForce]]:
        """Faces and touches of one contact."""
        c = next(c for c in self.bundles if any(one.name == name for one in c.each))
        return alike.apart(c, now.faces[c.name])[name]

    def turning(self, name: str) -> bool:
        """Whether anything turns a body: its own joint or one that it hangs on."""
        return any(b.turns for b in self.ancestry(name))

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Every parameter: shared coefficients, each contact's own, clearances, bodies, drives, loads, the user's."""
        return {name: quantity for name, (quantity, _) in self._parameters.items()}

    @cached_property
    def _parameters(self) -> sizes.Parameters:
        found: sizes.Parameters = {}
        parts = [c.parameters() for c in self.contacts]
        shared = {n: x for part in parts for n, x in part.items() if "." not in n and not n.startswith("clearance_")}
        for part in (shared, *parts, *(b.parameters(self.turning(b.name)) for b in self.bodies)):
            found |= {name: x for name, x in part.items() if found.get(name, (None, None))[1] is None}
        for load in self.loads:
            on = load.coordinates if isinstance(load, CoordinateLoad) else ()
            found |= load.parameters(*(self.body(name).joint == "hinge" for name in on))
        found |= {quantity.name: (quantity, arrays.plain(default)) for quantity, default in self.own}
        for name in self._named():
            if name not in found and name in CATALOGUE:
                found[name] = (CATALOGUE[name], None)
        return found

    def _named(self) -> list[str]:
        """Names that sizes give in place of numbers; words that are none, such as axes, among them."""
        parts: list[Any] = [*self.bodies, *self.contacts, *self.loads]
        parts += [part.drive for part in parts if getattr(part, "drive", None) is not None]
        found = [sizes.given(part) for part in parts]
        found += [
            size for part in (*(b.start for b in self.bodies), *(c.values for c in self.contacts)) for _, size in part
        ]
        return [x.removeprefix("-") for x in jax.tree.leaves(found) if isinstance(x, str)]

    @property
    def defaults(self) -> tuple[tuple[str, Any], ...]:
        """Default values, numbers or arrays: the mechanism's, then its parts'; ``smoothing`` is 0 where nobody says."""
        found = {name: default for name, (_, default) in self._parameters.items() if default is not None}
        if "smoothing" in self._parameters:
            found.setdefault("smoothing", 0.0)
        known, canonical = self._parameters, self.canonical
        given = {canonical(name): arrays.plain(value) for name, value in self.given}
        values = {**found, **given}
        return tuple((name, values[name]) for name in known if name in values)

    def horizon(self, params: Params) -> Array:
        return jnp.asarray(
            self.end if isinstance(self.end, (int, float)) else sizes.value(self.end, self.kind, "end", params)
        )

    # The state.

    @cached_property
    def _free(self) -> tuple[tuple[str, str, int], ...]:
        """(body, velocity, members) of every free velocity, in order."""
        return tuple((b.name, rate, b.members) for b in self.ordered for rate in b.rates)

    @cached_property
    def _placed(self) -> tuple[tuple[str, str, int], ...]:
        """(body, coordinate, members) of every coordinate, in order."""
        return tuple((b.name, key, b.members) for b in self.ordered for key in b.coordinates)

    @cached_property
    def _velocities(self) -> tuple[tuple[str, str, int], ...]:
        """(row, velocity, members) of every free velocity of ``rows``: what partial velocities and equations count."""
        return tuple((row.name, rate, row.members) for row in self.rows for rate in row.body.rates)

    @cached_property
    def _coordinates(self) -> tuple[tuple[str, str, int], ...]:
        """(row, coordinate, members) of every coordinate of ``rows``."""
        return tuple((row.name, key, row.members) for row in self.rows for key in row.body.coordinates)

    @cached_property
    def _order(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Where coordinates and velocities of ``rows`` are in the state, and the other way round; None for where they stand."""
        at: dict[tuple[str, str], np.ndarray] = {}
        first = 0
        for name, key, k in (*self._placed, *self._free):
            at[name, key] = np.arange(first, first + (k or 1))
            first += k or 1
        each = {row.name: row.each for row in self.rows}
        keys = [(b.name, key) for name, key, _ in (*self._coordinates, *self._velocities) for b in each[name]]
        found = np.concatenate([at[key] for key in keys]) if keys else np.arange(0)
        return None if np.array_equal(found, np.arange(first)) else (found, np.argsort(found))

    def numbers(self, y: Array) -> tuple[list[Number], list[Number], list[Number]]:
        """Coordinates and velocities of ``rows``, and what contacts remember."""
        places, rates = [k for *_, k in self._coordinates], [k for *_, k in self._velocities]
        if self._order is not None:
            moved = rows.taken(y[: self._order[0].size], self._order[0])
            y = jnp.concatenate([moved, y[self._order[0].size :]]) if self._memory else moved
        found = equations.apart(y, [*places, *rates, *(k for _, k in self._memory)])
        count = len(places) + len(rates)
        return found[: len(places)], found[len(places) : count], found[count:]

    def state(self, q: Sequence[Number], v: Sequence[Number], memory: Sequence[Number] = ()) -> Array:
        """Numbers of ``rows``, and of contacts, as they stand in the state."""
        counts = [k for *_, k in (*self._coordinates, *self._velocities)]
        remembered = [k for _, k in self._memory] if memory else []
        if self._order is None:
            return flat([*q, *v, *memory], [*counts, *remembered])
        moved = rows.taken(flat([*q, *v], counts), self._order[1])
        return jnp.concatenate([moved, flat(memory, remembered)]) if memory else moved

    @cached_property
    def _driven(self) -> tuple[Body, ...]:
        return tuple(b for b in self.ordered if b.drive is not None)

    @cached_property
    def _members(self) -> tuple[int, ...]:
        """Members by velocity, driven ones last."""
        return (*(k for *_, k in self._velocities), *(b.members for b in self._driven))

    @cached_property
    def _memory(self) -> tuple[tuple[str, int], ...]:
        """(contact, members) of every number that contacts remember, in order: ``Contact.memory`` of each face; then of loads."""
        found, members = [], self.members
        for c in self.contacts:
            each = len(c.memory)
            found += [(c.name, members[c.name])] * (each * c.faces if each else 0)
        return (*found, *((load.name, self.body(load.body).members) for load in self._bristly))

    @cached_property
    def _bristly(self) -> tuple[CoordinateLoad, ...]:
        """Loads on joints that keep a number."""
        return tuple(load for load in self.loads if isinstance(load, CoordinateLoad) and load.bristles)

    def initial_state(self, params: Params) -> Array:
        """Coordinates and velocities as the bodies start; contacts remember the rate at which they close."""
        return self.recalling(self.placed_state(params), params)

    def placed_state(self, params: Params) -> Array:
        """Coordinates and velocities as the bodies' ``start`` gives them."""
        q, v = [], []
        for b in self.ordered:
            places, rates = b.starting(params)
            q, v = q + places, v + rates
        moving = [*flat(q, [k for *_, k in self._placed]), *flat(v, [k for *_, k in self._free])]
        return jnp.stack(moving) if moving else jnp.zeros(0)

    def recalling(self, start: Array, params: Params, bent: Mapping[str, Any] | None = None) -> Array:
        """The state at time 0 of coordinates and velocities: with what contacts remember; ``bent``: bristles by owner."""
        if not self._memory:
            return start
        unknown = jnp.zeros(sum(k or 1 for _, k in self._memory))
        found = self.instant(jnp.zeros(()), jnp.concatenate([start, unknown]), params, laws=False)
        memory: list[Number] = []
        for c in self.contacts:
            for i, (face, touch) in enumerate(self.faces_of(found, c.name)):
                first = c.first(face, touch, params)
                memory += [*first[:-3], *bent[c.name][i]] if bent and c.bristles else first
        memory += [bent[load.name] if bent else 0.0 for load in self._bristly]
        return jnp.concatenate([start, flat(memory, [k for _, k in self._memory])])

    def instants(self, params: Params, times: Array, near: Any = None, rates: bool = True) -> tuple[Solution, Any]:
        """Of a mechanism whose every joint is driven, and whose contacts remember nothing: nothing is integrated."""
        nothing = jnp.zeros((times.shape[0], 0))
        return Solution(nothing, jnp.asarray(OK), times[-1], jnp.asarray(0), jnp.asarray(0)), near

    # The equations.

    def moving(self, t: Array, q: list[Number], v: list[Number], p: Params) -> Moving:
        """All bodies from coordinates and velocities of ``rows``."""
        parts: dict[str, Part] = {GROUND: STILL}
        mass: dict[str, Number] = {}
        center: dict[str, Vector] = {}
        at, first, driven = 0, 0, len(self._velocities)
        for row in self.rows:
            b, n, m = row.body, len(row.body.coordinates), len(row.body.rates)
            own = Own(q[at : at + n], v[first : first + m], first, driven)
            hung = row.numbers(lambda b: sizes.point(b.at, b.name, "at", p))
            part = carried(b, hung, parts[b.parent], own, t, p)
            at, first, driven = at + n, first + m, driven + (b.drive is not None)
            parts[row.name] = part
            mass[row.name] = row.numbers(lambda b: sizes.length(b.mass, b.name, "mass", p))
            center[row.name] = turned(part.axes, row.numbers(lambda b: sizes.point(b.center, b.name, "center", p)))
        if len(self.rows) == len(self.bodies):
            return Moving(parts, mass, center)
        named = [rows.ByName(self.rows, found) for found in (parts, mass, center)]
        return Moving(named[0], named[1], named[2], tuple(row.name for row in self.rows))

    def inertias(self, row: Row, p: Params) -> Any:
        """``inertia`` of a body, or of several that are alike."""
        return row.numbers(lambda b: self.inertia(b, p))

    def inertia(self, body: Body, p: Params) -> Any:
        """About the centre of mass; None of a body that nothing turns, and of one without."""
        if not self.turning(body.name) or (body.massless and (body.inertia is None or sizes.nothing(body.inertia))):
            return None
        if isinstance(body.inertia, tuple):
            pairs = zip(INERTIAS, body.inertia, strict=False)
            return tuple(sizes.length(s, body.name, f"inertia_{k}", p) for k, s in pairs)
        return sizes.value(body.inertia, body.name, "inertia", p)

    def instant(self, t: Array, y: Array, p: Params, laws: bool = True) -> Instant:
        """Everything at one instant; without ``laws`` no force, for what reads geometry and rates alone."""
        q, v, kept = self.numbers(y)
        bodies = self.moving(t, list(q), list(v), p)
        apart: dict[str, list[list[Number]]] = {}
        for c in self.contacts:
            each = len(c.memory)
            own, kept = kept[: each * c.faces], kept[each * c.faces :]
            apart[c.name] = [own[each * i : each * (i + 1)] for i in range(c.faces)]
        faces, memory = {}, {}
        for c in self.bundles:
            memory[c.name] = apart[c.name]
            if len(c.each) > 1 and c.memory:
                every = zip(*(apart[one.name] for one in c.each), strict=True)
                memory[c.name] = [[rows.side_by_side(x) for x in zip(*face, strict=True)] for face in every]
            faces[c.name] = self._touching(c, bodies, memory[c.name], p, laws)
        bent = dict(zip((load.name for load in self._bristly), kept, strict=True))
        return Instant(list(q), list(v), bodies, faces, memory, bent)

    def _touching(
        self, c: Contact, bodies: Moving, memory: list[list[Number]], p: Params, laws: bool
    ) -> list[tuple[Face, ContactForce]]:
        first, second = c.parts(bodies.parts)
        frames, coefficients = c.frames(bodies.parts, p), c.coefficients(p)
        try:
            faces = c.gap.faces(*frames, coefficients)
        except Exception as error:
            raise raised(f"contact '{c.name}' gap {type(c.gap).__name__}", error) from error
        found = []
        for face, own in zip(faces, memory, strict=True):
            if c.gap.members and not jnp.ndim(face.depth):
                # Members that are equally deep, as on a body without axes: each bears.
                face = face._replace(depth=jnp.broadcast_to(face.depth, (c.gap.members,)))
            point = add(frames[1].place, face.lever)
            velocity = subtract(
                second.velocity_at(subtract(point, second.place)), first.velocity_at(subtract(point, first.place))
            )
            if not laws:
                rate = dot(face.normal, velocity)
                found.append((face, ContactForce(ZERO, ZERO, 0.0, rate, subtract(velocity, scale(rate, face.normal)))))
                continue
            c_values = coefficients | dict(zip(c.memory, own, strict=True))
            bristle = (own[-3], own[-2], own[-1]) if c.bristles else None
            turn = c.gap.carried(first.spin, second.spin)
            try:
                kept = FrictionState(bristle, turn, own[-1] if c.lags else None)
                touch = press(c.law, c.friction, c_values, face, velocity, kept)
            except Exception as error:
                raise raised(f"contact '{c.name}' law {type(c.law).__name__}", error) from error
            if c.rolling:
                spin = subtract(second.spin, first.spin)
                touch = touch._replace(couple=couple(touch, face.normal, spin, c_values))
            found.append((face, touch))
        return found

    def assembled(self, t: Array, now: Instant, p: Params, pressing: bool = True) -> Equations:
        """Mass matrix and forces; without ``pressing`` no contact force."""
        found = Equations(self._members)
        for row in self.rows:
            bodies, name = now.bodies, row.name
            found.body(bodies.parts[name], bodies.center[name], bodies.mass[name], self.inertias(row, p))
        for load in self.loads:
            self._loaded(found, load, t, now, p)
        if pressing:
            self._pressed(found, now, p)
        return found

    def _pressed(self, found: Equations, now: Instant, p: Params) -> None:
        for c in self.bundles:
            bodies = c.parts(now.bodies.parts)
            place, acting = c.place(1, bodies[1], p), []
            for face, touch in now.faces[c.name]:
                point = add(place, face.lever)
                arms = (subtract(point, body.place) for body in bodies)
                turn = touch.couple or ZERO
                couples, forces = (turn, negative(turn)), (touch.force, negative(touch.force))
                acting += zip((1, 0), forces, [*arms][::-1], couples, strict=True)
            # A body of several contacts takes the sum of their forces; bodies that differ take each its own.
            if not alike.scattered(c):
                for which, force, arm, turn in acting:
                    found.act(bodies[which], arm, force, turn)
                continue
            acting = [(k, force, add(cross(arm, force), turn), arm) for k, force, arm, turn in acting]
            places = c.places(now.bodies.parts) if isinstance(c, alike.Alike) else None
            if places is not None:
                for which, *wrench in acting:
                    if (where := places[which]) is not None:
                        for each in where.spread(tuple(wrench)):
                            found.wrench(now.bodies.parts[where.row], *each)
                continue
            parted = alike.apart(c, acting)
            for one in c.each:
                own = one.parts(now.bodies.parts)
                for which, *wrench in parted[one.name]:
                    found.wrench(own[which], *wrench)

    def _loaded(self, found: Equations, load: AbstractLoad, t: Array, now: Instant, p: Params) -> None:
        if isinstance(load, CoordinateLoad):
            for j, force, _ in self.sprung(load, t, now, p):
                found.push(j, force)
            return
        try:
            actions = load.actions(t, now.bodies, p)
        except Exception as error:
            raise raised(f"load '{load.name}'", error) from error
        for given in actions:
            action = checked_action(f"load '{load.name}'", given, now.bodies.parts)
            part = now.bodies.parts[action.body]
            found.act(part, turned(part.axes, action.at), action.force, action.torque)

    def loaded(self, loads: Sequence[AbstractLoad], t: Array, y: Array, p: Params) -> Array:
        """Forces of some loads on the velocities, driven ones last."""
        now, found = self.instant(t, y, p, laws=False), Equations(self._members)
        for load in loads:
            self._loaded(found, load, t, now, p)
        return flat(found.forces, self._members)

    @cached_property
    def corners(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        return sum(len(load.corners) * (self._beside(load) or 1) for load in self.loads)

    def _beside(self, load: AbstractLoad) -> int:
        """Members of the bodies that a load begins to act on."""
        return max((self.body(name).members for name in load.touches if name != GROUND), default=0)

    def begun(self, t: Array, now: Instant, p: Params) -> list[Onset]:
        """How far every load is beyond its ``corners``; numbers (k,)."""
        found: list[Onset] = []
        for load in (load for load in self.loads if load.corners):
            if isinstance(load, CoordinateLoad):
                _, q, v = zip(*(self._coordinate(name, t, now, p) for name in load.coordinates), strict=True)
                onsets = load.onsets_on(t, q, v, p)
            else:
                onsets = load.onsets(now.bodies, p)
            found += [Onset(*(jnp.atleast_1d(spread(x, self._beside(load))) for x in one)) for one in onsets]
        return found

    def onsets(self, t: Array, y: Array, prepared: Params) -> tuple[Array, Array, Array]:
        found = self.begun(t, self.instant(t, y, prepared, laws=False), prepared)
        depth, rate, _, force, _ = map(jnp.concatenate, zip(*found, strict=True))
        return depth, rate, force

    def sprung(self, load: CoordinateLoad, t: Array, now: Instant, p: Params) -> list[tuple[int, Number, Number]]:
        """Which velocities a load on joints acts on, its force on each [N, N m], and each velocity."""
        found = [self._coordinate(name, t, now, p) for name in load.coordinates]
        kept = (now.bent[load.name],) if load.bristles else ()
        forces = load.on_coordinates(t, [q for _, q, _ in found], [v for *_, v in found], p, *kept)
        return [(j, force, v) for (j, _, v), force in zip(found, forces, strict=True)]

    def _coordinate(self, name: str, t: Array, now: Instant, p: Params) -> tuple[int, Number, Number]:
        """Index of the velocity of a slide or hinge, its coordinate and its velocity; of a driven one, too."""
        for k, b in enumerate(self._driven):
            if b.name == name and b.drive is not None:
                return len(self._velocities) + k, *b.drive.motion(t, name, p)[:2]
        j = next(j for j, (body, *_) in enumerate(self._velocities) if body == name)
        i = next(i for i, (body, *_) in enumerate(self._coordinates) if body == name)
        return j, now.q[i], now.v[j]

    def motion(self, t: Array, y: Array, p: Params) -> Array:
        """Rates of coordinates and velocities without contact forces; of what contacts remember 0."""
        now, count = self.instant(t, y, p, laws=False), len(self._velocities)
        moved = self.state(self._rates(now), self.assembled(t, now, p, pressing=False).accelerations(count))
        return jnp.concatenate([moved, jnp.zeros(y.size - moved.size)])

    def vector_field(self, t: Array, y: Array, prepared: Params) -> Array:
        """Newton's law, and what contacts remember."""
        now = self.instant(t, y, prepared)
        accelerations = self.assembled(t, now, prepared).accelerations(len(self._velocities))
        bent = [
            load.bending(self._coordinate(load.body, t, now, prepared)[2], now.bent[load.name], prepared)
            for load in self._bristly
        ]
        return self.state(self._rates(now), accelerations, self._remembered(now, prepared) + bent)

    def _rates(self, now: Instant) -> list[Number]:
        """Rates of the coordinates: the velocities, but for attitudes."""
        found, at, first = [], 0, 0
        for b in (row.body for row in self.rows):
            q, v = now.q[at : at + len(b.coordinates)], now.v[first : first + len(b.rates)]
            at, first = at + len(q), first + len(v)
            plain = len(q) - (4 if "q0" in b.coordinates else 0)
            found += v[:plain]
            if plain < len(q):
                found += quaternion_rate(q[plain:], v[plain : plain + 3])
        return found

    def _remembered(self, now: Instant, p: Params) -> list[Number]:
        found: dict[str, list[Number]] = {}
        for c in self.bundles:
            rates: list[Number] = []
            for (face, touch), own in zip(now.faces[c.name], now.memory[c.name], strict=True):
                rates += c.learning(face, touch, own, p) if c.memory else []
            found |= alike.apart(c, rates)
        return [rate for c in self.contacts for rate in found[c.name]]


@lru_cache(maxsize=256)  # Of equal mechanisms once: every run makes another one (``suited``).
def _alike(m: Dynamics) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(one.name for one in c.each) for c in m.bundles)


def _sorted(values: Any) -> tuple[tuple[str, Any], ...]:
    return tuple(
        (name, arrays.number(f"given {name}", value)) for name, value in sizes.by_name("mechanism given", values)
    )
