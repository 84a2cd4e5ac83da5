"""Contacts that are alike are computed side by side: a mechanism with many of them is no larger a program than with one.

Contacts between the same two bodies that have one gap, law and friction differ in numbers alone: where their markers are, and
coefficients of their own. Together they are one contact whose numbers are (k,), as those of a body with members are.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.vectors import Number
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.sizes import Params

_PACKAGE = __name__.partition(".")[0] + "."


class Alike(Contact):
    """Contacts in the place of one, whose numbers have an axis over them.

    Attributes:
        each: the contacts, in the mechanism's order; its own fields are the first one's.
    """

    each: tuple[Contact, ...] = eqx.field(static=True, default=())

    def coefficients(self, p: Params) -> dict[str, Array]:
        """A scalar where all have the same, else (k,)."""
        every = [c.coefficients(p) for c in self.each]
        return {name: side_by_side([one[name] for one in every]) for name in every[0]}

    def marker(self, which: int, p: Params) -> tuple[Number, Number, Number]:
        """Places of the markers in the body's axes."""
        x, y, z = map(side_by_side, zip(*(c.marker(which, p) for c in self.each), strict=True))
        return x, y, z


def side_by_side(numbers: Sequence[Number]) -> Number:
    """Numbers along an axis; the number itself where all are the same one."""
    first = numbers[0]
    if all(x is first for x in numbers) or all(isinstance(x, (int, float)) and x == first for x in numbers):
        return first
    return jnp.stack([jnp.asarray(x, dtype=jnp.float64) for x in numbers])


def apart(c: Contact, found: Any) -> dict[str, Any]:
    """What was found of contacts side by side, by name: numbers and trees of them, (k,) or the same for all."""
    if len(c.each) == 1:
        return {c.name: found}
    leaves, tree = jax.tree.flatten(found)
    rows = [[x[i] if getattr(x, "ndim", 0) else x for x in leaves] for i in range(len(c.each))]
    return {one.name: jax.tree.unflatten(tree, row) for one, row in zip(c.each, rows, strict=True)}


def bundled(contacts: Sequence[Contact], members: Mapping[str, int]) -> tuple[Contact, ...]:
    """Contacts in their order, those that are alike in the place of the first of them."""
    groups: dict[Any, list[Contact]] = {}
    for c in contacts:
        same = (c.between, c.gap, c.law, c.friction, c.smoothing, c.approach)
        alone = members[c.name] or not all(map(_ours, (c.gap, c.law, c.friction)))
        groups.setdefault((c.name,) if alone else same, []).append(c)
    return tuple(_together(group) if len(group) > 1 else group[0] for group in groups.values())


def _ours(part: Any) -> bool:
    """Whether a part takes (k,) numbers, as all of ours do; a user's own code may have been written for scalars."""
    if not isinstance(part, eqx.Module):
        return not callable(part) or getattr(part, "__module__", "").startswith(_PACKAGE)
    fields = (getattr(part, field.name) for field in dataclasses.fields(part))
    return type(part).__module__.startswith(_PACKAGE) and all(map(_ours, fields))


def _together(group: Sequence[Contact]) -> Alike:
    c = group[0]
    return Alike(
        c.name, c.between, c.gap, c.law, c.friction, None, c.smoothing, c.at, c.values, c.approach, tuple(group)
    )
