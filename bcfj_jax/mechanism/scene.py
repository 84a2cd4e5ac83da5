"""A scene lists its bodies, contacts and loads; what it does not list is not in the compiled program.

Scenes are static structure: no arrays, hashable, one compiled program per distinct scene. Numbers live
in the parameters, a flat dict of float64 scalars that may be traced, batched and differentiated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.laws import AbstractLaw
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.quantities import CATALOGUE, Quantity, check_order
from bcfj_jax.core.quantities import check_value as check_value

Params = Mapping[str, Array]


class Body(eqx.Module):
    """A translating rigid body with the parameter that holds its mass and its number of coordinates."""

    name: str = eqx.field(static=True)
    mass: str = eqx.field(static=True, default="mass")
    coordinates: int = eqx.field(static=True, default=1)


class Contact(eqx.Module):
    """A pair of surfaces: where they are (gap), what they do (law).

    Attributes:
        gap: (positions, params) -> signed gap [m], positive apart. Its gradient is the force's direction.
        law: the normal-force law; its coefficients are parameters of the scene.
        smoothed: whether the penetration has a C2 onset of width ``smoothing``.
        approach: (positions, velocities, params) -> the speed [m/s] at the next touch, for laws that need it.
        memory_rate: (approach, params) -> rate [1/s] at which a remembered approach speed forgets the
            last impact while apart. None: the speed is the same for the whole run and needs no state.
        first: as ``approach``, remembered at time 0, if a start without a flight before it needs another.
    """

    name: str = eqx.field(static=True)
    gap: Callable[[Array, Params], Array] = eqx.field(static=True)
    law: AbstractLaw
    smoothed: bool = eqx.field(static=True, default=True)
    approach: Callable[[Array, Array, Params], Array] | None = eqx.field(static=True, default=None)
    memory_rate: Callable[[Array, Params], Array] | None = eqx.field(static=True, default=None)
    first: Callable[[Array, Array, Params], Array] | None = eqx.field(static=True, default=None)

    @property
    def remembers(self) -> bool:
        """Whether the contact carries a state of its own: its last approach speed."""
        return self.memory_rate is not None and "approach_speed" in self.law.needs

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the parameters the contact reads."""
        own = tuple(name for name in self.law.needs if name != "approach_speed")
        return own + (("smoothing",) if self.smoothed else ())


class Load(eqx.Module):
    """An applied force: (params) -> generalised force [N] on the coordinates."""

    name: str = eqx.field(static=True)
    force: Callable[[Params], Array] = eqx.field(static=True)
    needs: tuple[str, ...] = eqx.field(static=True)


class AbstractScene:
    """What every kind of scene says about itself, and the making of its parameters. Every scene is a static module.

    Attributes:
        kind: name of the family the scene belongs to.
        contacts: what touches; each has a ``name`` and a ``law``.
        defaults: default value of every parameter that has one, SI.
        samples: a number of output times over the horizon that resolves a contact.
        horizon: (params) -> a sensible end time [s] where the user gives none.
        quantities: every parameter the scene has, in a readable order, by name.
    """

    kind: str
    contacts: tuple[Any, ...]
    samples: int
    defaults: Any
    horizon: Any
    quantities: Any

    def parameters(self, values: Mapping[str, ArrayLike] | None = None, **more: ArrayLike) -> dict[str, Array]:
        """The scene's parameters as a pytree of float64 leaves, SI; those without a default only where given.

        Args:
            values: values by name (for names with a dot in them).
            more: values by name. A value may be a number, an array (a batch for ``vmap``) or traced.

        Raises:
            InputError: for a name the scene does not have (with the nearest it has) and for a number
                outside its quantity's range.
        """
        given = {**(values or {}), **more}
        known = self.quantities
        for name, value in given.items():
            if name not in known:
                raise InputError(f"scene '{self.kind}'", f"no parameter '{name}' = {value}", nearest(name, known))
            check_value(f"scene '{self.kind}'", known[name], value)
        defaults = dict(self.defaults)
        check_order(f"scene '{self.kind}'", known, {**defaults, **given})
        return {
            name: jnp.asarray(given[name] if name in given else defaults[name], dtype=jnp.float64)
            for name in known
            if name in given or name in defaults
        }


class Scene(AbstractScene, eqx.Module):
    """Static structure of a simulation.

    Attributes:
        kind: name of the family the scene belongs to.
        bodies, contacts, loads: what is in it, and all that is in it.
        needs: parameters of motion and placement beside those of contacts, masses and loads.
        defaults: every parameter's default value, SI.
        start: (params) -> positions [m] and velocities [m/s] at time 0.
        impact_scale: (params) -> typical mass [kg] and speed [m/s] of an impact, from which the error
            control takes its units.
        horizon: (params) -> a sensible end time [s] where the user gives none.
        samples: a number of output times over that horizon that resolves a contact.
        flight: (params) -> time from a contact to the next [s], where there is more than one.
    """

    kind: str = eqx.field(static=True)
    bodies: tuple[Body, ...]
    contacts: tuple[Contact, ...]
    loads: tuple[Load, ...]
    needs: tuple[str, ...] = eqx.field(static=True)
    defaults: tuple[tuple[str, float], ...] = eqx.field(static=True)
    start: Callable[[Params], tuple[Array, Array]] = eqx.field(static=True)
    impact_scale: Callable[[Params], tuple[Array, Array]] = eqx.field(static=True)
    horizon: Callable[[Params], Array] = eqx.field(static=True)
    samples: int = eqx.field(static=True, default=1001)
    flight: Callable[[Params], Array] | None = eqx.field(static=True, default=None)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Every parameter the scene has, in a readable order, by name."""
        names = [name for contact in self.contacts for name in contact.coefficients]
        names += [body.mass for body in self.bodies]
        names += [*self.needs, *(name for load in self.loads for name in load.needs)]
        return {name: CATALOGUE[name] for name in dict.fromkeys(names)}
