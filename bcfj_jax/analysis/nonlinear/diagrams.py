"""Bifurcation diagrams: what a section settles to, against one parameter, all values in one compiled program.

Every value of the parameter begins at the scene's own start, so the diagram shows the attractor which that start goes
to, and no hysteresis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from bcfj_jax.analysis.nonlinear.sections import Sectioning, SectioningKeys, drive_period, impacts
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, nearest, one_of
from bcfj_jax.core.quantities import real, whole
from bcfj_jax.core.settings import taking
from bcfj_jax.core.status import reason
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params, Reading, as_model
from bcfj_jax.solve.plan import Plan, Points, Solving, SolvingKeys, plan
from bcfj_jax.solve.simulation import readings
from bcfj_jax.solve.work_queue import integrate_queue


class Diagram(NamedTuple):
    """Sections at P values of a parameter; a value whose run failed is NaN throughout.

    Attributes:
        name, values: the parameter, and its values (P,) in SI.
        times: (P, N) [s] of the section.
        force: per contact (P, N, 3), or (P, N, balls, 3): normal, axial, tangential [N].
        penetration, rate: per contact (P, N), or (P, N, balls): [m], [m/s].
        reasons: P texts, why a run failed; "" for a good one.
    """

    name: str
    values: np.ndarray
    times: np.ndarray
    force: dict[str, np.ndarray]
    penetration: dict[str, np.ndarray]
    rate: dict[str, np.ndarray]
    reasons: list[str]

    @property
    def failed(self) -> np.ndarray:
        """Which values' runs failed, (P,)."""
        return np.array([bool(text) for text in self.reasons])


def map_bifurcation(
    step: Callable[[Any, Array], Any], start: Any, values: ArrayLike, *, transients: int, kept: int
) -> Any:
    """Orbits of a map at many values of its parameter, one ``vmap``.

    Args:
        step: (state, value) -> state, traceable.
        start: state that every orbit begins at.
        values: (P,) of the parameter.
        transients: iterations that are not kept.
        kept: N, those that are.

    Returns:
        The states, like ``start``, with leading axes (P, N).
    """
    transients = whole("transients", transients, least=0, most=limits.SAMPLES)
    kept = whole("kept", kept, most=limits.SAMPLES)

    def orbit(value: Array) -> Any:
        begun = jax.tree.map(lambda x: jnp.asarray(x, float), start)
        settled = jax.lax.fori_loop(0, transients, lambda _, state: step(state, value), begun)

        def once(state: Any, _: None) -> tuple[Any, Any]:
            state = step(state, value)
            return state, state

        return jax.lax.scan(once, settled, None, kept)[1]

    return jax.tree.map(np.array, jax.jit(jax.vmap(orbit))(jnp.asarray(values, float)))


@taking(Sectioning)
def bifurcation(
    scene: AbstractModel, params: Params, name: str, values: ArrayLike, revolutions: int = 40, *, places: int = 8,
    **settings: Unpack[SectioningKeys],
) -> Diagram:  # fmt: skip
    """Stroboscopic sections of a driven scene against one parameter: clearance, drive speed, friction.

    Args:
        name, values: the parameter to change and its values (P,) in SI.
        places: runs under way at one time (``solve.work_queue``); a run that ends is replaced by the next.
        scene, params, revolutions, transients, phase, period, accuracy, max_steps: as ``sections.stroboscopic``. Each
            value has the revolutions of its own drive speed, or period.

    Raises:
        InputError: for a parameter the scene does not have, for values it cannot take, and as ``stroboscopic``.
    """
    name = scene.canonical(name)
    batch, each = _batch(scene, params, name, values)
    asked = Sectioning(**settings)
    turns = asked.turns(revolutions)
    ends = np.array([turns[-1] * drive_period(scene, one, asked.period) for one in each])
    shares = turns / turns[-1]
    reasons, seen = _solve(scene, batch, ends, np.concatenate([[0.0], shares]), asked, places)
    force, depth, rate = (
        {contact: _without(getattr(r, part), reasons)[:, 1:] for contact, r in seen.items()}
        for part in ("force", "penetration", "rate")
    )
    return Diagram(name, np.asarray(batch[name]), ends[:, None] * shares, force, depth, rate, reasons)


class TouchingKeys(SolvingKeys, total=False):
    """``Touching`` as keywords."""

    contact: str
    samples: int
    places: int


@dataclass(frozen=True)
class Touching(Solving):
    """Settings of ``impact_bifurcation``."""

    contact: str = "contact"
    samples: int = 10_001
    places: int = 8


@taking(Touching)
def impact_bifurcation(
    scene: AbstractModel, params: Params, name: str, values: ArrayLike, end: float, kept: int,
    **settings: Unpack[TouchingKeys],
) -> tuple[np.ndarray, list[str]]:  # fmt: skip
    """Approach speeds at the last touches of a scene without a drive, against one parameter.

    Args:
        end: of every run [s].
        kept: N, how many of the last touches to keep.
        contact: which contact.
        samples: over the run; they must resolve a flight (``sections.impacts``).
        scene, params, name, values, accuracy, max_steps, places: as ``bifurcation``.

    Returns:
        Speeds (P, N) [m/s], the last at the end, NaN in front where there were fewer and wherever a run failed; and P
        reasons as in ``Diagram``.

    Raises:
        InputError: for a parameter or a contact the scene does not have, and for values it cannot take.
    """
    asked = Touching(**settings)
    one_of(f"scene '{scene.kind}'", "contact", asked.contact, [one.name for one in scene.contacts])
    batch, each = _batch(scene, params, scene.canonical(name), values)
    grid = np.linspace(0.0, 1.0, whole("samples", asked.samples, least=2, most=limits.SAMPLES))
    kept = whole("kept", kept)
    ends = np.full(len(each), float(end))
    reasons, seen = _solve(scene, batch, ends, grid, asked, asked.places)
    read = seen[asked.contact]
    speeds = np.full((len(each), kept), np.nan)
    for row, text in enumerate(reasons):
        if not text:
            last = impacts(end * grid, read.penetration[row], read.rate[row]).speeds[-kept:]
            speeds[row, kept - last.size :] = last
    return speeds, reasons


def _batch(scene: AbstractModel, params: Params, name: str, values: ArrayLike) -> tuple[dict[str, Array], list[Params]]:
    """Parameters with leaves (P,), and one by one; ``name`` is a canonical one."""
    params = inputs.parameters(as_model(scene), params, traced=False)
    if name not in params:
        raise InputError(f"scene '{scene.kind}'", f"no parameter '{name}'", nearest(name, params))
    some = real(name, "values", values)
    if some.ndim != 1 or some.size < 1:
        raise InputError(name, f"values of shape {some.shape}", "give a list of one or more")
    each: list[Params] = [scene.parameters({**params, name: value}) for value in some]
    for one in each:
        scene.check(one)
    return {key: jnp.stack([one[key] for one in each]) for key in each[0]}, each


def _solve(
    scene: AbstractModel, batch: dict[str, Array], ends: np.ndarray, grid: np.ndarray, asked: Solving, places: int
) -> tuple[list[str], dict[str, Reading]]:
    """Why runs failed, and what their contacts read at shares of their ends."""
    how, places = plan(scene, asked.accuracy, asked.max_steps), whole("places", places, most=limits.MEMBERS)
    grids = jnp.asarray(ends), jnp.asarray(grid)
    codes, seen = jax.device_get(_run(scene, places, batch, *grids, Plan(how.tolerance, how.max_steps)))
    return [reason(int(code), how.max_steps) for code in codes], seen


@partial(jax.jit, static_argnums=(0, 1))
def _run(
    scene: AbstractModel, places: int, batch: dict[str, Array], ends: Array, grid: Array, how: Plan
) -> tuple[Array, dict[str, Reading]]:
    found, _ = integrate_queue(scene, Points(batch, ends, grid), how, ends.size, min(places, ends.size))
    seen = jax.vmap(lambda p, end, states: readings(scene, p, end * grid, states))(batch, ends, found.states)
    return found.code, seen


def _without(x: np.ndarray, reasons: list[str]) -> np.ndarray:
    """NaN in every row that failed: what a run showed before it did was perhaps still a transient."""
    failed = np.array([bool(text) for text in reasons])
    return np.where(failed.reshape(-1, *[1] * (x.ndim - 1)), np.nan, x)
