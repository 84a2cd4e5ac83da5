"""Contacts that are alike are computed side by side: a mechanism with many of them is hardly a larger program than with one.

Contacts between the same two bodies that have one gap, law and friction differ in numbers alone: where their markers are, and
coefficients of their own. Together they are one contact whose numbers are (k,), as those of a body with members are. So are
contacts of a row, each between two bodies of its own; their bodies' places and velocities are then side by side, too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
from jax import Array, lax

from bcfj_jax.core.vectors import Number
from bcfj_jax.mechanism.bodies import GROUND, Part
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.rows import FEW, ByName, Places, side_by_side, taken
from bcfj_jax.mechanism.sizes import Params

_PACKAGE = __name__.partition(".")[0] + "."


class Alike(Contact):
    """Contacts in the place of one, whose numbers have an axis over them."""

    # The contacts, in the mechanism's order; its own fields are the first one's.
    each: tuple[Contact, ...] = eqx.field(static=True, default=())

    def coefficients(self, p: Params) -> dict[str, Array]:
        """A scalar where all have the same, else (k,)."""
        every = [c.coefficients(p) for c in self.each]
        return {name: side_by_side([one[name] for one in every]) for name in every[0]}

    def parts(self, parts: Mapping[str, Part]) -> tuple[Part, Part]:
        """Its bodies in motion, side by side where they are different ones; what velocities move them by is each one's own."""
        if not scattered(self):
            return super().parts(parts)
        first, second = (_joined(parts, [c.between[k] for c in self.each]) for k in (0, 1))
        return first, second

    def places(self, parts: Mapping[str, Part]) -> tuple[Places | None, Places | None] | None:
        """Where its bodies are in rows, None for the ground; None as well where any is in no row."""
        names = [[c.between[k] for c in self.each] for k in (0, 1)]
        found = [parts.places(x) if isinstance(parts, ByName) else None for x in names]
        still = [set(x) == {GROUND} for x in names]
        return (found[0], found[1]) if all(x or y for x, y in zip(found, still, strict=True)) and any(found) else None

    def marker(self, which: int, p: Params) -> tuple[Number, Number, Number]:
        """Places of the markers in the body's axes."""
        x, y, z = map(side_by_side, zip(*(c.marker(which, p) for c in self.each), strict=True))
        return x, y, z


def scattered(c: Contact) -> bool:
    """Whether contacts side by side are between different bodies."""
    return any(one.between != c.between for one in c.each)


def _joined(parts: Mapping[str, Part], names: Sequence[str]) -> Part:
    """Bodies in motion as one with an axis over them; without partial velocities."""
    where = parts.places(names) if isinstance(parts, ByName) else None
    if where is not None:
        return taken(parts[where.row]._replace(partials={}), where.at)
    bare = [parts[name]._replace(partials={}, of=None) for name in names]
    return jax.tree.map(lambda *x: side_by_side(x), *bare)


def apart(c: Contact, found: Any) -> dict[str, Any]:
    """What was found of contacts side by side, by name: numbers and trees of them, (k,) or the same for all."""
    if len(c.each) == 1:
        return {c.name: found}
    leaves, tree = jax.tree.flatten(found)
    rows = [
        [lax.index_in_dim(x, i, keepdims=False) if getattr(x, "ndim", 0) else x for x in leaves]
        for i in range(len(c.each))
    ]
    return {one.name: jax.tree.unflatten(tree, row) for one, row in zip(c.each, rows, strict=True)}


def bundled(contacts: Sequence[Contact], members: Mapping[str, int], kind: Callable[[str], Any]) -> tuple[Contact, ...]:
    """Contacts in their order, alike ones in the place of their first; between other bodies if these are of one ``kind``.

    A kind is whether a body is the ground, whether anything turns it, and which row of several it is in, None for none.
    """
    pairs: dict[Any, list[Contact]] = {}
    for c in contacts:
        same = (c.between, c.gap, c.law, c.friction, c.smoothing, c.approach, c.rolling)
        alone = members[c.name] or not _plain(c)
        pairs.setdefault((c.name,) if alone else same, []).append(c)
    groups: dict[Any, list[Contact]] = {}
    for key, group in pairs.items():
        kinds = [kind(name) for name in group[0].between]
        inside = any(row for *_, row in kinds) and all(ground or row for ground, _, row in kinds)
        single = (len(group) == 1 or inside) and len(key) > 1
        groups.setdefault((*kinds, *key[1:]) if single else (key,), []).extend(group)
    found: list[Contact] = []
    for key, group in groups.items():
        few = len(key) > 1 and len(group) < FEW
        found += group if few or len(group) == 1 else [_together(group)]
    return tuple(found)


def _plain(c: Contact) -> bool:
    """Whether all of a contact takes (k,) numbers, and its coefficients are numbers."""
    return all(map(_ours, (c.gap, c.law, c.friction))) and not any(q.shape for q, _ in c.parameters().values())


def _ours(part: Any) -> bool:
    """Whether a part takes (k,) numbers, as all of ours do; a user's own code may have been written for scalars."""
    if isinstance(part, partial):
        return all(map(_ours, (part.func, *part.args, *part.keywords.values())))
    if not isinstance(part, eqx.Module):
        return not callable(part) or getattr(part, "__module__", "").startswith(_PACKAGE)
    fields = (getattr(part, field.name) for field in dataclasses.fields(part))
    return type(part).__module__.startswith(_PACKAGE) and all(map(_ours, fields))


def _together(group: Sequence[Contact]) -> Alike:
    first: dict[str, Any] = {field.name: getattr(group[0], field.name) for field in dataclasses.fields(Contact)}
    # Its law has the elastic part already.
    first["elastic"] = None
    return Alike(**first, each=tuple(group))
