"""Histories and their derivatives by named parameters: one compiled program, all parameters together.

Forward mode: the tangents of all parameters go through one solve and share its factorisations. The tolerance is
traced, so that the same program climbs a certificate's levels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.trains import of_curve
from bcfj_jax.core.status import NO_FORCE, OK, STEEP
from bcfj_jax.io.outputs import channels
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import Plan, Way

# The histories behind ``force_history``, with penetrations and states beside the forces.
from bcfj_jax.solve.simulation import Run, readings, timed
from bcfj_jax.xla.programs import program


class Histories(NamedTuple):
    """What a run left at T times; of a derivative, the same with parameters (P,) as the first axis."""

    force: Any  # (T, C, 3) [N], penetration, rate: (T, C) [m, m/s] of C channels, a contact's members one by one
    penetration: Any
    rate: Any
    state: Any  # (T, n) in units of the states' natural sizes
    # (C, 4) what is known of the continuous curve (``crests.Curve``); None where there are samples alone.
    curve: Any = None

    @property
    def constant(self) -> Histories:
        """Derivatives by no parameter."""
        return Histories(*(None if x is None else x[None][:0] for x in self))


class Search(NamedTuple):
    """How instants of a model without a history are searched (``AbstractModel.instants``): from where, and whether with rates."""

    near: Any
    rates: bool = True


class Level(NamedTuple):
    """One solve with its derivatives: at which tolerance, what came out, what it cost, how it ended.

    ``scale`` (n,): the states' natural sizes. ``uneven``: of a run that stands for a longer one (``repeating``), how far its
    last pitch is from the one before, of forces and of their derivative by each parameter, (1 + P,); empty of any other.
    """

    tolerance: float
    value: Histories
    derivative: Histories
    code: int
    end: float
    accepted: int
    rejected: int
    wall_s: float
    compile_s: float
    scale: Any
    uneven: np.ndarray = np.zeros(0)

    @property
    def steps(self) -> int:
        """Attempted steps."""
        return self.accepted + self.rejected

    @property
    def good(self) -> bool:
        """Whether the run reached its end and every derivative is finite."""
        return self.code == OK


def channel_names(contacts: Mapping[str, int]) -> list[str]:
    """Names of the channels in the order of ``Histories``."""
    return [n for c, k in contacts.items() for n in ([f"{c}_{i + 1}" for i in range(k)] if k else [c])]


def histories(
    scene: AbstractModel, params: Params, times: Array, how: Plan, mode: Way = "forward", search: Search | None = None
) -> tuple[Histories, tuple]:
    """Histories by the solver meant for derivatives; code, end, accepted, rejected, and from where to search next. Pure."""
    params = scene.completed(params)
    if search is None:
        from bcfj_jax.solve.integrate import integrate  # With diffrax, which a kept program does not need.

        solution, ahead = integrate(scene, params, times, how, mode, "whole"), ()
    else:
        solution, ahead = scene.instants(params, times, *search)
    force, depth, rate = by_channel(scene, readings(scene, params, times, solution.states))
    curve = jnp.full((force.shape[1], len(Curve._fields)), jnp.nan)
    if solution.whole is not None:
        curve = of_curve(scene, params, solution.whole, times[0], times[-1])
    found = Histories(force, depth, rate, solution.states / jax.lax.stop_gradient(scene.error_scale(params)), curve)
    return found, (solution.code, solution.end, solution.accepted, solution.rejected, ahead)


def by_channel(scene: AbstractModel, readings: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Forces (T, C, 3), penetrations and their rates (T, C) of all channels. Pure."""
    ordered = [readings[contact.name] for contact in scene.contacts]
    count = ordered[0].force.shape[0]
    force = jnp.concatenate([r.force.reshape(count, -1, 3) for r in ordered], axis=1)
    depth, rate = (
        jnp.concatenate([getattr(r, k).reshape(count, -1) for r in ordered], 1) for k in ("penetration", "rate")
    )
    return force, depth, rate


def level(scene: AbstractModel, params: Params, times: np.ndarray, wrt: tuple[str, ...], how: Plan) -> Level:
    """Solve once with the derivatives by all of ``wrt``, per SI unit."""
    arguments = (dict(params), np.asarray(times), how)
    solve, compile_s = program("jacobian", _jacobian, (scene, wrt), arguments)
    begin = time.perf_counter()
    derivative, (value, (code, end, accepted, rejected, *_)), scale = solve(*arguments)
    wall = time.perf_counter() - begin
    # A force that is 0 has a derivative of 0, whatever the state's is.
    finite = np.isfinite(derivative.force).all(axis=(0, 2, 3)) & np.isfinite(derivative.state).all(axis=(0, 2))
    if code == OK and not np.isfinite(value.force).all():
        code, end = NO_FORCE, times[np.argmin(np.isfinite(value.force).all(axis=(1, 2)))]
    if code == OK and not finite.all():
        code, end = STEEP, times[np.argmin(finite)]
    return Level(
        float(how.tolerance), value, derivative, int(code), float(end), int(accepted), int(rejected), wall, compile_s,
        scale,
    )  # fmt: skip


def _jacobian(scene: AbstractModel, wrt: tuple[str, ...], params: dict, times: Array, how: Plan) -> Any:
    """Derivatives of the histories, (histories, how the run ended), and the states' natural sizes."""
    return *by_shares(lambda p: histories(scene, p, times, how), params, wrt), scene.error_scale(params)


def by_shares(function: Callable[[dict], tuple[Any, Any]], params: dict, wrt: Sequence[str]) -> tuple[Any, tuple]:
    """Derivatives (P, ...) of a pytree by the named parameters, per SI unit, and (it, what stands beside it). Pure.

    By shares of the parameters: where the tangents' error is controlled, what is small is an effect of 100 %. ``function`` of
    all parameters returns the pytree, and what is not differentiated.
    """
    from bcfj_jax.solve.work_queue import shifted, sizes  # With diffrax, which a kept program does not need.

    def at(shares: Array) -> tuple:
        found, rest = function({**params, **shifted(params, wrt, shares)})
        return found, (found, rest)

    slopes, rest = jax.jacfwd(at, has_aux=True)(jnp.zeros(len(wrt)))
    return jax.tree.map(lambda x: jnp.moveaxis(x / sizes(params, wrt), -1, 0), slopes), rest


def forces(scene: AbstractModel, params: Params, times: np.ndarray, how: Plan) -> np.ndarray:
    """Forces (T, C, 3) without derivatives, by the solver meant for values: the program of ``simulate``."""
    return of_run(timed(scene, params, times, how)).force


def of_run(run: Run) -> Histories:
    """The histories of a finished run, NumPy."""
    tables = (run.force, 1), (run.penetration, 0), (run.rate, 0)
    return Histories(*(np.stack(list(channels(table, axes).values()), 1) for table, axes in tables), state=None)
