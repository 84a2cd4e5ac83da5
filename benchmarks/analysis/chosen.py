"""Laws chosen among by a number, a coefficient of the contact: one compiled program serves them all."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
from jax import Array

import bcfj_jax as bj
from bcfj_jax import laws

WHICH = {"which": bj.Quantity("which", "1", "number of a law", 0.0)}


def _of(c: Mapping[str, Any], values: Sequence[Array]) -> Array:
    return jnp.select([jnp.abs(c["which"] - i) < 0.5 for i in range(len(values))], list(values))


def law(known: Mapping[str, Any]) -> laws.AbstractLaw:
    """The law of the number ``which`` among those by name; the states of the others stay as they are."""
    every = tuple(known.values())
    factors = [getattr(one, "factor", None) for one in every]

    class Chosen(laws.AbstractLaw):
        quantities = WHICH
        needs = tuple(dict.fromkeys((*(n for one in every for n in one.needs), "which")))  # pyright: ignore
        states = tuple(dict.fromkeys(n for one in every for n in one.states))
        bends = any(one.bends for one in every)
        ends = any(one.ends for one in every)

        def force(self, penetration, rate, c):
            if all(factors):
                one: Any = every[0]
                chosen = lambda e: _of(c, [factor(e) for factor in factors])  # noqa: E731  # pyright: ignore
                return dataclasses.replace(one, factor=chosen).force(penetration, rate, c)
            return _of(c, [one.force(penetration, rate, c) for one in every])

        def rates(self, penetration, rate, c):
            each = [dict(zip(one.states, one.rates(penetration, rate, c), strict=True)) for one in every]
            none = jnp.zeros_like(penetration)
            return tuple(_of(c, [x.get(name, none) for x in each]) for name in self.states)

        def sizes(self, penetration, c):
            found: dict[str, Array] = {}
            for one in every:
                found |= dict(zip(one.states, one.sizes(penetration, c), strict=True))
            return tuple(found[name] for name in self.states)

    return Chosen()


def friction(known: Mapping[str, Any]) -> laws.AbstractFriction:
    """Likewise of frictions without a state."""
    every = tuple(known.values())

    class Chosen(laws.AbstractFriction):
        quantities = WHICH
        needs = tuple(dict.fromkeys((*(n for one in every for n in one.needs), "which")))  # pyright: ignore

        def mobility(self, speed_squared, c):
            return _of(c, [one.mobility(speed_squared, c) for one in every])

    return Chosen()
