"""Where a mechanism's state keeps the approach speeds that its contacts remember, and what they are at a touch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.contacts import SLOWEST
from bcfj_jax.mechanism.equations import flat
from bcfj_jax.mechanism.model import Approaches

if TYPE_CHECKING:
    from bcfj_jax.mechanism.mechanism import Mechanism
    from bcfj_jax.mechanism.sizes import Params


def places(scene: Mechanism) -> tuple[int, ...]:
    """Indices in the state of the approach speeds (``contacts.Approach``), in the order of ``approaches``."""
    found: list[int] = []
    at, members = sum(k or 1 for *_, k in (*scene._placed, *scene._free)), scene.members
    for c in scene.contacts:
        count = members[c.name] or 1
        for _ in range(c.faces if c.memory else 0):
            found += range(at, at + count) if c.remembers else ()
            at += count * len(c.memory)
    return tuple(found)


def approaches(scene: Mechanism, t: Array, y: Array, p: Params) -> Approaches:
    """As ``AbstractModel.approaches``; the memory of a regularised contact stays from the regularisation on."""
    now, members = scene.instant(t, y, p, laws=False), scene.members
    rows, counts = [], []
    for c in scene.contacts:
        if not c.remembers:
            continue
        width = c.coefficients(p).get("smoothing", 0.0)
        for face, touch in now.faces[c.name]:
            rows.append((face.depth + width, touch.rate, jnp.maximum(touch.rate, SLOWEST)))
            counts.append(members[c.name])
    return Approaches(*(flat(list(part), counts) for part in zip(*rows, strict=True)))
