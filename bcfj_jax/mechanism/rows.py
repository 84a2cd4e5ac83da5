"""Bodies that are alike are one row: a mechanism with many of them is hardly a larger program than with one.

Bodies that hang on the ground by one kind of joint, and that carry nothing, differ in numbers alone. Together they are
computed as a body with members is: coordinates, velocities, mass and inertia are (k,). What a mechanism is asked is answered
body by body.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from bcfj_jax.core.vectors import Number, spread
from bcfj_jax.mechanism import sizes
from bcfj_jax.mechanism.bodies import GROUND, Body, Part

# Fewer bodies, or contacts between different bodies, are computed one by one.
FEW = 4
# Numbers from so many runs of places are cut and joined; those from more are gathered, which XLA fuses with nothing.
_RUNS = 4


class Row(NamedTuple):
    """A body, or several that are alike."""

    name: str  # the body's; of several one that no body has
    each: tuple[Body, ...]  # the bodies, in the mechanism's order

    @property
    def body(self) -> Body:
        """The one, or the first: all have its joint and its axes."""
        return self.each[0]

    @property
    def members(self) -> int:
        """How many numbers each of its coordinates is; 0 for one."""
        return len(self.each) if len(self.each) > 1 else self.body.members

    def numbers(self, read: Callable[[Body], Any]) -> Any:
        """What is read of a body, numbers of several side by side."""
        return jax.tree.map(lambda *x: side_by_side(x), *map(read, self.each))

    def apart(self, found: Any) -> dict[str, Any]:
        """What was found of it, by body."""
        if len(self.each) == 1:
            return {self.name: found}
        return {b.name: jax.tree.map(lambda x, k=k: own(x, k), found) for k, b in enumerate(self.each)}


def side_by_side(numbers: Sequence[Number]) -> Number:
    """Numbers along an axis; the number itself where all are the same one."""
    first = numbers[0]
    if all(x is first for x in numbers) or all(isinstance(x, (int, float)) and x == first for x in numbers):
        return first
    return jnp.stack([jnp.asarray(x, dtype=jnp.float64) for x in numbers])


def own(x: Number, k: int | None) -> Number:
    """The k-th of numbers along their first axis; a number that all share, and any for None, as it is."""
    return x if k is None or not getattr(x, "ndim", 0) else lax.index_in_dim(x, k, keepdims=False)


def rows(bodies: Sequence[Body], tied: Collection[str]) -> tuple[Row, ...]:
    """Bodies in their order, alike ones in the place of their first; those whose names are ``tied`` stay by themselves."""
    carriers, groups = {b.parent for b in bodies}, {}
    for b in bodies:
        alone = b.parent != GROUND or b.members or b.drive is not None or b.tilt is not None
        alone = alone or b.name in tied or b.name in carriers
        kind = (b.joint, sizes.axis(b.axis, b.name), len(b.inertia) if isinstance(b.inertia, tuple) else 0)
        groups.setdefault(b.name if alone else kind, []).append(b)
    found: list[Row] = []
    for group in groups.values():
        if len(group) < FEW:
            found += [Row(b.name, (b,)) for b in group]
        else:
            found.append(Row(f"{group[0].name} and {len(group) - 1} more", tuple(group)))
    return tuple(found)


class Places(NamedTuple):
    """Where the bodies of contacts are in a row."""

    row: str  # its name
    at: np.ndarray  # of each contact the place of its body (c,)
    of: np.ndarray  # of each body the places of its contacts (m, k), c for none

    def spread(self, x: Any) -> Iterator[Any]:
        """Numbers of contacts as numbers of bodies, in as many parts as a body has contacts; 0 for none."""
        for at in self.of:
            yield jax.tree.map(lambda x, at=at: self._spread(x, at), x)

    def _spread(self, x: Number, at: np.ndarray) -> Number:
        if isinstance(x, (int, float)) and x == 0:
            return x
        return taken(jnp.append(spread(x, len(self.at)), 0.0), at)


def taken(x: Any, at: np.ndarray) -> Any:
    """Numbers along an axis at places; those that all share as they are."""

    def one(x: Number) -> Number:
        if not getattr(x, "ndim", 0):
            return x
        if np.array_equal(at, np.arange(x.shape[0])):
            return x
        runs = np.split(at, np.flatnonzero(np.diff(at) != 1) + 1)
        if len(runs) > _RUNS:
            return x.at[at].get(mode="promise_in_bounds")
        cut = [lax.slice_in_dim(x, int(run[0]), int(run[-1]) + 1) for run in runs]
        return cut[0] if len(cut) == 1 else lax.concatenate(cut, 0)

    return jax.tree.map(one, x)


class ByName(Mapping[str, Any]):
    """What is known of bodies, by name: of bodies in a row each one's own numbers; by the name of a row those of all."""

    def __init__(self, among: Sequence[Row], found: dict[str, Any]) -> None:
        self._rows, self._found, self._own = among, found, {}
        self._where = {b.name: (row, k) for row in among if len(row.each) > 1 for k, b in enumerate(row.each)}

    def __getitem__(self, name: str) -> Any:
        if name in self._found:
            return self._found[name]
        if name not in self._own:
            row, k = self._where[name]
            cut = jax.tree.map(lambda x: own(x, k), self._found[row.name])
            self._own[name] = cut._replace(of=(k, row.members)) if isinstance(cut, Part) else cut
        return self._own[name]

    def __iter__(self) -> Iterator[str]:
        yield from ([GROUND] if GROUND in self._found else [])
        yield from (b.name for row in self._rows for b in row.each)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        return name in self._found or name in self._where

    def changed(self, change: Callable[[Any], Any]) -> ByName:
        """With another thing known of each row."""
        return ByName(self._rows, {name: change(x) for name, x in self._found.items()})

    def places(self, names: Sequence[str]) -> Places | None:
        """Where bodies are, if all are in one row of several."""
        found = [self._where[name] for name in names if name in self._where]
        if len(found) < len(names) or len({row.name for row, _ in found}) > 1:
            return None
        row, at = found[0][0], np.array([k for _, k in found])
        each = [np.flatnonzero(at == k) for k in range(row.members)]
        of = np.full((max(map(len, each)), row.members), len(at))
        for k, one in enumerate(each):
            of[: len(one), k] = one
        return Places(row.name, at, of)
