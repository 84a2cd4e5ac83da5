"""A small stiff model with a closed form, made of nothing but the interface: a mass on a spring and a strong damper."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.model import AbstractModel, Flows, ModelTraits, Reading

# Times at which the spring is read [s]: the mass creeps back within some c/k = 20 ms, and its speed settles within
# m/c = 5 us.
TIMES = np.linspace(0.0, 0.05, 11)
NAMES = ("stiffness", "damping", "mass", "place")
VALUES = np.array([1e4, 200.0, 1e-3, 1e-3])


class Spring(eqx.Module):
    """The one contact: it has no law of its own."""

    name: str = eqx.field(static=True, default="spring")
    law: None = None
    friction: None = None


class Damped(AbstractModel):
    """m x'' + c x' + k x = 0 from x = place at rest, x counted towards the contact."""

    kind: str = eqx.field(static=True, default="damped")
    contacts: tuple = (Spring(),)
    samples: int = eqx.field(static=True, default=101)
    defaults: tuple = eqx.field(static=True, default=tuple(zip(NAMES, VALUES.tolist(), strict=True)))

    @property
    def traits(self):
        return ModelTraits(stiff=True)

    @property
    def quantities(self):
        units = ("N/m", "N s/m", "kg", "m")
        return {name: Quantity(name, unit, name, 0.0) for name, unit in zip(NAMES, units, strict=True)}

    def horizon(self, params):
        return 2.5 * params["damping"] / params["stiffness"]

    def initial_state(self, params):
        return jnp.stack([params["place"], jnp.zeros(())])

    def vector_field(self, t, y, prepared):
        p = prepared
        return jnp.stack([y[1], -(p["damping"] * y[1] + p["stiffness"] * y[0]) / p["mass"]])

    def error_scale(self, params, end=jnp.inf):
        return jnp.stack([params["place"], params["place"] * params["stiffness"] / params["damping"]])

    def tolerance(self, force_error):
        return 0.5 * force_error

    def observe(self, t, y, prepared):
        normal = prepared["stiffness"] * y[0]
        return {"spring": Reading(jnp.stack([normal, 0.0 * normal, 0.0 * normal]), y[0], y[1])}

    def flows(self, t, y, prepared):
        p = prepared
        stored = {"kinetic": 0.5 * p["mass"] * y[1] ** 2, "elastic": 0.5 * p["stiffness"] * y[0] ** 2}
        return Flows({}, {"damping": p["damping"] * y[1] ** 2}, stored)


def exact(values: jax.Array, times=TIMES) -> jax.Array:
    """Force of the spring [N] at the times, from (stiffness, damping, mass, place)."""
    k, c, m, place = values
    root = jnp.sqrt((0.5 * c / m) ** 2 - k / m)
    fast = -0.5 * c / m - root
    slow = k / m / fast
    return k * place * (fast * jnp.exp(slow * times) - slow * jnp.exp(fast * times)) / (fast - slow)


def counted() -> tuple[AbstractModel, list[int]]:
    """The model, and how often its field is traced."""
    count = [0]

    class Counted(Damped):
        def vector_field(self, t, y, prepared):
            count[0] += 1
            return super().vector_field(t, y, prepared)

    return dataclasses.replace(Counted()), count
