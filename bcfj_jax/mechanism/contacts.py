"""A contact of a mechanism: between which bodies, where on them, by which gap, law and friction; and what it remembers.

A contact has a state for three reasons, kept in one way (``Contact.memory``): a law stated by restitution remembers the
approach speed of the impact (one number a face), a law with states keeps those (``contact.normal``), and friction its own:
bristles their deflection (three numbers a face, world axes), friction that lags one number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact import laws
from bcfj_jax.contact.friction import AbstractFriction
from bcfj_jax.contact.gaps import AbstractGap, Face, Frame
from bcfj_jax.contact.normal import AbstractLaw, regularised_rates
from bcfj_jax.contact.part import checked, raised
from bcfj_jax.contact.wrench import RESISTING, ContactForce
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.numerics import positive
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.vectors import WORLD, ZERO, Number, Vector, add, turned
from bcfj_jax.mechanism import arrays, sizes
from bcfj_jax.mechanism.arrays import own_quantities
from bcfj_jax.mechanism.bodies import Part
from bcfj_jax.mechanism.sizes import ORIGIN, Parameters, Params, Place, Size

# Least approach speed of a law stated by restitution [m/s]: a resting contact would be rigid.
SLOWEST = 1e-3
# Gap within which the approach speed is settled [m].
_NEAR = 1e-7
# What bristles remember, and friction that lags.
_BRISTLE = ("bristle_x", "bristle_y", "bristle_z")
_LATE = ("late",)


class Approach(eqx.Module):
    """How a contact remembers the speed at which its bodies came together.

    While they are apart and closing at the rate v over the gap g, the memory s follows:  ds/dt = 4 v (v - s)/(g + l),
    l = 0.1 um: what it knew before is forgotten as the fourth power of the gap, whatever the scale. From touch on it
    stays. It knows the speed of l/3 before touch, so that it errs by the fraction a l/(3 v^2) under the acceleration a,
    and by ((g + l)/l)^-4 of the change since the last touch where the gap between was no more than g.
    """

    def first(self, gap: Number, rate: Number, p: Params) -> Number:
        """Memory at time 0 [m/s]."""
        return jnp.maximum(rate, SLOWEST)

    def learning(self, gap: Number, rate: Number, memory: Number, p: Params) -> Number:
        """Rate of the memory [m/s^2] over a gap [m] > 0; ``rate`` of the penetration [m/s], positive while closing."""
        closing = positive(rate)
        return 4.0 * closing * (jnp.maximum(closing, SLOWEST) - memory) / (positive(gap) + _NEAR)


class Contact(eqx.Module):
    """Two bodies with clearance between them.

    Attributes:
        name: unique; its coefficients are ``<name>.<coefficient>``, else the shared ``<coefficient>``.
        between: names of the bodies a and b, "ground" among them; the force that is read acts on b.
        gap: the geometry (``contact.gaps``).
        law, friction: normal-force law, by name or itself; friction law, by name or itself, None or False for none.
        elastic: name of the law's elastic part, where the law is given by its name.
        smoothing: whether the contact is regularised (coefficient ``smoothing`` [m]).
        at: places of the markers in the axes of a and of b [m].
        values: coefficients of its own: a number is a default, a text names a parameter.
        approach: where a law's ``approach_speed`` is from: "parameter", or a memory (``Approach``).
        rolling: whether it resists rolling and drilling (``contact.wrench.couple``).
    """

    name: str = eqx.field(static=True)
    between: tuple[str, str] = eqx.field(static=True, converter=sizes.pair)
    gap: AbstractGap
    law: AbstractLaw = eqx.field(default="memory_free", converter=lambda x: _law(x))
    friction: AbstractFriction | None = eqx.field(default=None, converter=lambda x: _friction(x))
    elastic: str | None = eqx.field(static=True, default=None)
    smoothing: bool = eqx.field(static=True, default=True)
    at: tuple[Place, Place] = sizes.field("contact at", default=(ORIGIN, ORIGIN))
    values: tuple[tuple[str, Size], ...] = eqx.field(
        static=True, default=(), converter=partial(sizes.items, "contact values")
    )
    approach: Any = eqx.field(static=True, default=Approach())
    rolling: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if isinstance(self.law, str):
            object.__setattr__(self, "law", laws.make(self.law, self.elastic))
            # The law has it now: a contact whose elastic part was named is the one that has it by default.
            object.__setattr__(self, "elastic", None)
        sizes.check_read(
            f"contact {quoted(self.name)}", self, "a law given as itself", ("elastic",), "give it to the law"
        )
        where = sizes.checked_name("contact", self.name)
        sizes.check_fields(where, self)
        if self.between[0] == self.between[1]:
            raise InputError(f"{where} between", f"'{self.between[0]}' with itself", "give two different bodies")
        if not isinstance(self.gap, AbstractGap):
            checked(
                f"{where} gap", self.gap, AbstractGap, "gap", "give one of bj.gaps, or bj.gaps.from_depth(function)"
            )
        if not isinstance(self.approach, Approach) and (
            not isinstance(self.approach, str) or self.approach != "parameter"
        ):
            raise InputError(f"{where} approach", f"{self.approach!r}", 'give "parameter" or an Approach')
        for name, _ in self.values:
            if name not in (*self.reads, "clearance", "smoothing"):
                found = f"its gap, law and friction read no coefficient '{name}'"
                raise InputError(f"{where} values", found, f"they read {', '.join(self.reads)}")

    @property
    def each(self) -> tuple[Contact, ...]:
        """The contacts that it stands for (``mechanism.alike``): itself."""
        return (self,)

    @property
    def remembers(self) -> bool:
        """Whether its approach speed is a state."""
        return "approach_speed" in self.law.needs and self.approach != "parameter"

    @property
    def bristles(self) -> bool:
        """Whether its friction has bristles."""
        return self.friction is not None and self.friction.bristles

    @property
    def lags(self) -> bool:
        """Whether its friction lags behind the slip."""
        return self.friction is not None and self.friction.lags

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of the numbers that each face remembers: approach speed, states of the law, state of the friction."""
        approach = ("approach_speed",) if self.remembers else ()
        return (*approach, *self.law.states, *(_BRISTLE if self.bristles else _LATE if self.lags else ()))

    def first(self, face: Face, touch: ContactForce, p: Params) -> list[Number]:
        """What a face remembers at time 0."""
        approach = [self.approach.first(-face.depth, touch.rate, p)] if self.remembers else []
        return [*approach, *(0.0 for _ in self.memory[len(approach) :])]

    def recalled(self, own: Sequence[Number], p: Params) -> dict[str, Array]:
        """Its coefficients and what a face remembers, by their own names."""
        return self.coefficients(p) | dict(zip(self.memory, own, strict=True))

    def learning(self, face: Face, touch: ContactForce, own: Sequence[Number], p: Params) -> list[Number]:
        """Rates of what a face remembers (``own``), where it touches with a force."""
        bending = list(touch.bending or ())
        if len(self.memory) == len(bending):
            return bending
        found, values = [], self.recalled(own, p)
        width = values.get("smoothing", 0.0)
        if self.remembers:
            # Within the regularisation there is a force: that is no flight.
            learning = self.approach.learning(-face.depth, touch.rate, own[0], p)
            found.append(jnp.where(-face.depth > width, learning, 0.0))
        depth, rate = jnp.asarray(face.depth), jnp.asarray(touch.rate)
        return [*found, *regularised_rates(self.law, depth, rate, values, width), *bending]

    def sizes(self, speed: Array, depth: Array, values: Mapping[str, Array]) -> list[Number]:
        """What errors of its memory are measured in, at the speed [m/s] and penetration [m] that are to be expected."""
        count = 3 if self.bristles else 1 if self.lags else 0
        bend = [self.friction.reach(values)] * count if self.friction is not None and count else []
        return [*([speed] if self.remembers else []), *self.law.sizes(depth, values), *bend]

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of all its coefficients."""
        rub = self.friction.needs if self.friction is not None else ()
        names = (*self.law.needs, *rub, *(("smoothing",) if self.smoothing else ()), *self.gap.needs)
        names += RESISTING if self.rolling else ()
        return tuple(dict.fromkeys(n for n in names if not (n == "approach_speed" and self.remembers)))

    def coefficients(self, p: Params) -> dict[str, Array]:
        """Its coefficients by their own names; a memory is not among them."""
        given = dict(self.values)
        return {name: self._coefficient(name, given.get(name), p) for name in self.reads}

    def _coefficient(self, name: str, size: Size, p: Params) -> Array:
        if isinstance(size, str) or callable(size):
            return sizes.value(size, self.name, name, p)
        if name == "clearance":
            return p[f"clearance_{self.name}"]
        return sizes.value(None, self.name, name, p)

    def parameters(self) -> Parameters:
        """Shared coefficients, its own and its clearance, with defaults."""
        given, found = dict(self.values), {}
        arrays_ = arrays.defaults(self.law, self.friction)
        special = {**self.gap.quantities, **own_quantities(self.law), **own_quantities(self.friction)}
        for name in self.reads:
            size = given.get(name)
            if isinstance(size, str) or callable(size):
                continue
            meaning = special.get(name) or CATALOGUE.get(name)
            if meaning is None:
                meaning = Quantity(name, "1", f"coefficient {name}")
            default = arrays_.get(name) if size is None else float(size)
            if name == "clearance":
                own = f"clearance_{self.name}"
                least = float("-inf") if self.gap.preloads else meaning.low
                known = CATALOGUE.get(own) or meaning._replace(name=own, meaning=f"clearance of {self.name}", low=least)
                found[own] = (known, default)
                continue
            if name not in arrays_:  # Those are of one contact.
                found.setdefault(name, (meaning, None))
            own = f"{self.name}.{name}"
            found[own] = (meaning._replace(name=own, meaning=f"{meaning.meaning}; of {self.name} alone"), default)
        for body, place in zip(self.between, self.at, strict=True):
            found |= sizes.of_point(place, self.name, body, f"{{}} of {self.name} on {body}")
        return found

    def marker(self, which: int, p: Params) -> tuple[Number, Number, Number]:
        """Place of a marker in its body's axes."""
        return sizes.point(self.at[which], self.name, self.between[which], p)

    def place(self, which: int, part: Part, p: Params) -> Vector:
        """Place of a marker [m], world, of its body in motion."""
        return add(part.place, turned(part.axes, self.marker(which, p)))

    def parts(self, parts: Mapping[str, Part]) -> tuple[Part, Part]:
        """Its bodies in motion."""
        return parts[self.between[0]], parts[self.between[1]]

    def frames(self, parts: Mapping[str, Part], p: Params) -> tuple[Frame, Frame]:
        """Frames of both markers, of bodies in motion."""
        first, second = self.parts(parts)
        places = self.place(0, first, p), self.place(1, second, p)
        return Frame(places[0], first.axes, first.turn), Frame(places[1], second.axes, second.turn)

    @property
    def faces(self) -> int:
        try:
            return _faces(self.gap)
        except InputError as error:
            raise InputError(f"contact '{self.name}' {error.where}", error.found, error.remedy) from error


def _law(law: Any) -> AbstractLaw:
    if isinstance(law, str):  # By its name it is made where the elastic part is known, too.
        return law  # pyright: ignore[reportReturnType]
    return arrays.kept(
        "contact law", checked("contact law", law, AbstractLaw, "law", "give a law's name"), arrays.HeldLaw
    )


def _friction(friction: Any) -> AbstractFriction | None:
    if friction is None or isinstance(friction, AbstractFriction):
        return friction and arrays.kept("contact friction", friction, arrays.HeldFriction)
    return laws.make_friction(friction)


class _Any(dict):
    def __missing__(self, key: str) -> Array:
        return jnp.asarray(1e-3)


@cache
def _faces(gap: AbstractGap) -> int:
    def count(x: Array) -> Array:
        frames = (Frame(ZERO, WORLD), Frame((1e-2 * x, 2e-2 * x, 3e-2 * x), WORLD))
        counted.append(len(gap.faces(*frames, _Any())))
        return x

    counted: list[int] = []
    try:
        jax.eval_shape(count, jax.ShapeDtypeStruct((), jnp.float64))
    except Exception as error:
        raise raised(f"gap {type(gap).__name__}", error) from error
    return counted[0]
