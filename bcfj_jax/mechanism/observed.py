"""A model around another: one that shows readings beside its contacts, and one whose runs begin at a given state and time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.part import of
from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism.channels import READ_BY, Channel, channel, is_reading, looked, shares
from bcfj_jax.mechanism.model import AbstractModel, Bodies, Coarser, Params, Reading
from bcfj_jax.mechanism.structure import AbstractStructure


class Shown(NamedTuple):
    """A reading in a contact's place: its name, and no laws."""

    name: str
    law: None = None
    friction: None = None


# What a model works out from its contacts, or as a whole: here from those with readings. All else is the inner model's.
_OWN = ("alike", "read", "by_contact", "accounts", "parameters", "suspects", "only_law", "with_law", "first_touch")
_OWN += ("warnings", "chain")
_TOLD = {*vars(AbstractModel), "kind", "samples", "defaults", "horizon"}
_TOLD = sorted(name for name in _TOLD if not name.startswith("_") and name not in _OWN)
_Within: Any = type(AbstractModel)(  # pyright: ignore[reportGeneralTypeIssues]
    "_Within", (AbstractModel,), {"__module__": __name__, **{name: of("inner", name) for name in _TOLD}}
)


class Observed(_Within):
    """``inner`` with readings (``channels``) as further contacts: their values stand where a normal force does."""

    inner: AbstractModel
    channels: tuple[Channel, ...] = eqx.field(static=True)

    def __getattr__(self, name: str) -> Any:
        # What a model's own code asks of it beyond the interface: its structure solves with it.
        return getattr(object.__getattribute__(self, "inner"), name)

    @property
    def contacts(self) -> tuple[Any, ...]:
        """The model's, then the readings."""
        return (*self.inner.contacts, *(Shown(c.name) for c in self.channels))

    @property
    def members(self) -> dict[str, int]:
        """The model's; a reading has those of its part, unless it is of one of them."""
        count = self.inner.members | self.inner.body_members
        return self.inner.members | {c.name: 0 if c.member else count.get(c.part, 0) for c in self.channels}

    def prepare(self, params: Params) -> Any:
        """The model's, and beside it what readings of life multiply."""
        found, more = self.inner.prepare(params), shares(self.channels, self.inner, params)
        return found if not more else {**found, **more} if isinstance(found, Mapping) else replace(found, beside=more)

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """The model's contacts, and each reading as a normal force without penetration."""
        found = self.inner.observe(t, y, prepared)
        beside = prepared if isinstance(prepared, Mapping) else prepared.beside
        values = looked(self.channels, self.inner, found, beside)(t, y, prepared)
        shown = {
            name: Reading(jnp.stack([x, zero, zero], -1), zero, zero)
            for name, x, zero in ((name, x, jnp.zeros_like(x)) for name, x in values.items())
        }
        return {**found, **shown}

    def bodies_at(self, params: Params, contact: str, deepest: float) -> Bodies:
        return self.inner.bodies_at(params, contact, deepest) if contact in self.inner.members else Bodies()

    def full(self) -> AbstractModel:
        return Observed(self.inner.full(), self.channels)

    def suited(self, params: Params, end: float, solver: str | None = None) -> AbstractModel:
        return Observed(self.inner.suited(params, end, solver), self.channels)

    def coarser(self) -> tuple[Coarser, ...]:
        return self.inner.coarser()

    def choose(
        self, params: Params, times: np.ndarray, budget: float, run: Callable[[AbstractModel, np.ndarray], Any]
    ) -> Any:
        return self.inner.choose(params, times, budget, lambda level, at: run(Observed(level, self.channels), at))


def observing(model: AbstractModel, features: Iterable[str]) -> AbstractModel:
    """A model that shows the readings which features are of: "slider.acceleration.x.peak", "journal.wear_volume"."""
    contacts, wanted = model.members, {}
    known = [*contacts, *(f"{c}_{k + 1}" for c, count in contacts.items() for k in range(count))]
    for feature in features:
        parts, _, kind = feature.rpartition(".")
        for place in parts.split(":"):
            if kind in READ_BY and place in known:
                place = f"{place}.{READ_BY[kind]}"
                _check_friction(model, place, feature)
            if place not in known and is_reading(place):
                wanted[place] = channel(place, model, where=f"feature '{feature}'")
    return Observed(model, tuple(wanted.values())) if wanted else model


def _check_friction(model: AbstractModel, place: str, feature: str) -> None:
    one = channel(place, model, where=f"feature '{feature}'")
    if one.what == "wear_rate" and next(c for c in model.contacts if c.name == one.part).friction is None:
        found = f"'{one.part}' has no friction, and so no sliding speed that is read"
        raise InputError(f"feature '{feature}'", found, "give the contact a friction law")


# Beside the parameters: the state (n,) and the time [s] at which a run begins.
START, BEGIN = "start of the run", "time of the start"


def _begun(name: str) -> Any:
    def call(self: Any, t: Any, y: Array, args: Any, *more: Any) -> Any:
        prepared, begin = args[1]
        return getattr(self.inner, name)(t + begin, y, (self.model, prepared), *more)

    return call


class _Later(AbstractStructure):
    """The structure of a model, at times counted from ``BEGIN``; ``args`` is (model, (prepared, begin))."""

    inner: AbstractStructure
    model: AbstractModel

    solve, alone = map(partial(of, "inner"), ("solve", "alone"))  # pyright: ignore[reportAssignmentType]
    field, factor, time_derivative = map(_begun, ("field", "factor", "time_derivative"))  # pyright: ignore[reportAssignmentType]


def _later(name: str) -> Any:
    return lambda self, t, y, prepared: getattr(self.inner, name)(t + prepared[1], y, prepared[0])


class Onward(Observed):
    """``inner`` from the state ``START`` at the time ``BEGIN``, both among the parameters; times count from there."""

    channels: tuple = eqx.field(static=True, default=())

    def prepare(self, params: Params) -> Any:
        return self.inner.prepare(_own(params)), jnp.asarray(params[BEGIN])

    def initial_state(self, params: Params) -> Array:
        return jnp.asarray(params[START])

    vector_field, approaches, observe = map(_later, ("vector_field", "approaches", "observe"))  # pyright: ignore[reportAssignmentType]

    def structure(self) -> AbstractStructure:
        return _Later(self.inner.structure(), self.inner)


def _own(params: Params) -> Params:
    return {name: value for name, value in params.items() if name not in (START, BEGIN)}
