"""A model that shows readings of bodies beside its contacts, so that whatever takes features of contacts takes theirs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.mechanism.channels import Channel, channel, is_reading, needs_bodies, read
from bcfj_jax.mechanism.model import AbstractModel, Bodies, Coarser, Params, Reading


class Shown(NamedTuple):
    """A reading in a contact's place: its name, and no laws."""

    name: str
    law: None = None
    friction: None = None


def _of(name: str) -> Any:
    return property(lambda self: getattr(self.inner, name))


class Observed(AbstractModel):
    """``inner`` with readings (``channels``) as further contacts: their values stand where a normal force does."""

    inner: AbstractModel
    channels: tuple[Channel, ...] = eqx.field(static=True)

    kind, samples, defaults, horizon, traits, quantities, title = map(  # pyright: ignore[reportAssignmentType]
        _of, ("kind", "samples", "defaults", "horizon", "traits", "quantities", "title")
    )
    prepare, initial_state, vector_field, error_scale, tolerance = map(
        _of, ("prepare", "initial_state", "vector_field", "error_scale", "tolerance")
    )
    first_step, structure, origin, instants, motions, flows = map(
        _of, ("first_step", "structure", "origin", "instants", "motions", "flows")
    )
    proximity, shows_proximity, unsure, unweighed, breaks, longest_step = map(
        _of, ("proximity", "shows_proximity", "unsure", "unweighed", "breaks", "longest_step")
    )  # pyright: ignore[reportAssignmentType]
    body_names, body_members, drive_coordinate, settled_when, tables, model_form = map(  # pyright: ignore[reportAssignmentType]
        _of, ("body_names", "body_members", "drive_coordinate", "settled_when", "tables", "model_form")
    )
    check, require, period, coordinates, neutral, envelope, settled_from = map(
        _of, ("check", "require", "period", "coordinates", "neutral", "envelope", "settled_from")
    )
    recurs, pitch, pitch_before, turned = map(_of, ("recurs", "pitch", "pitch_before", "turned"))
    choice_options, whole, orbits, variants = map(_of, ("choice_options", "whole", "orbits", "variants"))
    coefficient, canonical, remembered, approaches, misremembered = map(  # pyright: ignore[reportAssignmentType]
        _of, ("coefficient", "canonical", "remembered", "approaches", "misremembered")
    )
    drawing, carriers, scenery, level = map(_of, ("drawing", "carriers", "scenery", "level"))

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

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """The model's contacts, and each reading as a normal force without penetration."""
        found = self.inner.observe(t, y, prepared)
        moving = needs_bodies(self.channels, self.inner)
        values = read(self.channels, found, self.inner.motions(t, y, prepared) if moving else {})
        shown = {
            name: Reading(jnp.stack([x, zero, zero], -1), zero, zero)
            for name, x, zero in ((name, x, jnp.zeros_like(x)) for name, x in values.items())
        }
        return {**found, **shown}

    def bodies_at(self, params: Params, contact: str, deepest: float) -> Bodies:
        """The model's; a reading has none."""
        return self.inner.bodies_at(params, contact, deepest) if contact in self.inner.members else Bodies()

    def full(self) -> AbstractModel:
        """The model's, with the same readings."""
        return Observed(self.inner.full(), self.channels)

    def suited(self, params: Params, end: float, solver: str | None = None) -> AbstractModel:
        """The model's, observed likewise."""
        return Observed(self.inner.suited(params, end, solver), self.channels)

    def coarser(self) -> tuple[Coarser, ...]:
        """The model's."""
        return self.inner.coarser()

    def choose(
        self, params: Params, times: np.ndarray, budget: float, run: Callable[[AbstractModel, np.ndarray], Any]
    ) -> Any:
        """The model's choice."""
        return self.inner.choose(params, times, budget, lambda level, at: run(Observed(level, self.channels), at))


def observing(model: AbstractModel, features: Iterable[str]) -> AbstractModel:
    """A model that shows the readings which features are of: "slider.acceleration.x.peak" asks for the acceleration.

    Raises:
        InputError: for a reading that the model has not, with the nearest that it has.
    """
    contacts, wanted = model.members, {}
    known = [*contacts, *(f"{c}_{k + 1}" for c, count in contacts.items() for k in range(count))]
    for feature in features:
        for place in feature.rpartition(".")[0].split(":"):
            if place not in known and is_reading(place):
                wanted[place] = channel(place, model, where=f"feature '{feature}'")
    return Observed(model, tuple(wanted.values())) if wanted else model
