"""Paths in the clearance: the centre of a pin, a ball or a cage seen from what it moves in."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.vectors import dot, subtract
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.model import Orbit, Params
from bcfj_jax.xla.programs import QUICK, program


def orbits(model: Dynamics, params: Params, run: Any) -> dict[str, Orbit]:
    """Of contacts whose gap is round, without members: the second body's marker seen from the first's."""
    names = _round(model)
    if not names or run.trajectory is None:
        return {}
    arguments = (dict(params), run.times, run.trajectory)
    apart = program("orbits", _paths, (model,), arguments, QUICK)[0](*arguments)
    found = {}
    for name in names:
        contact = model.contact(name)
        outer, inner = contact.between
        x, y = apart[name]
        clearance = float(contact.coefficients(params)["clearance"])
        axes = (f"x of {outer}", f"y of {outer}")
        found[name] = Orbit(np.asarray(x), np.asarray(y), clearance, f"{inner} in {outer}", axes)
    return found


def _round(model: Dynamics) -> list[str]:
    return [c.name for c in model.contacts if c.gap.round and not model.members[c.name]]


def _paths(model: Dynamics, params: Params, times: Array, states: Array) -> dict[str, tuple[Array, Array]]:
    return jax.vmap(lambda t, y: _apart(model, t, y, params))(times, states)


def _apart(model: Dynamics, t: Array, y: Array, p: Params) -> dict[str, tuple[Array, Array]]:
    """By contact with a round gap, its markers' distance [m] along the first body's x and y axes."""
    parts, found = model.instant(t, y, p, laws=False).bodies.parts, {}
    for name in _round(model):
        c = model.contact(name)
        first, second = c.frames(parts, p)
        apart = subtract(second.place, first.place)
        found[name] = jnp.asarray(dot(first.axes[0], apart)), jnp.asarray(dot(first.axes[1], apart))
    return found
