"""A scene lists its bodies, contacts and loads; what it does not list is not in the compiled program.

Scenes are static structure: no arrays, hashable, one compiled program per distinct scene. Numbers live
in the parameters, a flat dict of float64 scalars that may be traced, batched and differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.laws import AbstractLaw
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.mechanism.model import AbstractModel, ModelTraits, Params, Reading


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
    def friction(self) -> None:
        """None: it only approaches."""

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


class Scene(AbstractModel):
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

    @property
    def traits(self) -> ModelTraits:
        """A few springs: oscillatory, not stiff."""
        return ModelTraits()

    def initial_state(self, params: Params) -> Array:
        """``dynamics.initial_state``."""
        return _dynamics().initial_state(self, params)

    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        """``dynamics.field``."""
        return _dynamics().field(t, y, (self, prepared))

    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        """``dynamics.error_sizes``."""
        return _dynamics().error_sizes(self, params, jnp.asarray(end))

    def tolerance(self, force_error: float) -> float:
        """In proportion: the force error of random impacts and bounces stays below (``benchmarks/solve/levels.py``)."""
        return 5e-4 * force_error

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """``dynamics.observe``."""
        return _dynamics().observe(self, y, prepared)

    def check(self, params: Params, where: str = "") -> None:
        """``dynamics.check_start``."""
        _dynamics().check_start(self, params, where)

    def coordinates(self) -> dict[str, tuple[int, int]]:
        """Every body's, numbered where it has several."""
        names = [f"{b.name}.{k}" if b.coordinates > 1 else b.name for b in self.bodies for k in range(b.coordinates)]
        return {name: (k, len(names) + k) for k, name in enumerate(names)}

    def envelope(self, params: Params, times: np.ndarray) -> tuple[dict[str, float], list[str]]:
        """``dynamics.place``."""
        return _dynamics().place(self, params, times), []


def _dynamics() -> Any:
    """The module that computes a scene; it imports this one."""
    from bcfj_jax.mechanism import dynamics

    return dynamics
