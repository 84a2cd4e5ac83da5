"""Energy balance over a run: what went in, came out, was lost and is stored, and how well the sum closes.

    work given = work taken (by loads, friction, damping) + change of what is stored

The powers are read from the run's own states between the times asked for, and integrated by Simpson's rule; what is
stored is a function of the state. So ``closure`` sees errors of solver, interpolation, quadrature and equations alike.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.integrate import cumulative_simpson

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import Quantity, increasing, scalar
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Flows, Params, as_model
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import Plan, plan

# Readings evaluated side by side.
_CHUNK = 512
_STEP = Quantity("step", "s", "longest panel of the quadrature", 0.0, open_low=True)


class EnergyBalance(NamedTuple):
    """Energies of a run [J] at T times, each counted from the first of them."""

    times: np.ndarray  # (T,) [s]
    given: dict[str, np.ndarray]  # by source, work into the system since the first time (T,)
    taken: dict[str, np.ndarray]  # by sink, work out of it since the first time (T,): loads, friction, damping
    stored: dict[str, np.ndarray]  # by store, kinetic, elastic and spring energy (T,), as it is, not as it changed
    residual: np.ndarray  # (T,) given less taken, less the change of all stores: 0 for an exact balance
    # Largest |residual| over the largest |work| of a term or change of the stores [-]; NaN for a failed run.
    closure: float


@eqx.filter_jit
def _flows(model: AbstractModel, params: Params, instants: Array, how: Plan) -> Flows:
    """Powers and stores at the instants; NaN from a failure on."""
    params = model.completed(params)
    states = integrate(model, params, instants, how, "forward").states
    prepared = model.prepare(params)

    def read(at: tuple[Array, Array]) -> Flows:
        t, y = at
        # A law reads NaN as no contact, which would balance.
        failed = jnp.where(jnp.all(jnp.isfinite(y)), 0.0, jnp.nan)
        return jax.tree.map(lambda x: x + failed, model.flows(t, y, prepared))

    return jax.lax.map(read, (instants, states), batch_size=_CHUNK)


def _work(power: np.ndarray, instants: np.ndarray, panels: int) -> np.ndarray:
    """Integral of a power up to every time, each so many instants after the one before."""
    return cumulative_simpson(power, x=instants, initial=0.0)[::panels]


def _instants(times: np.ndarray, step: float) -> tuple[np.ndarray, int]:
    """All instants and the (even) number of panels an interval has: none longer than ``step``."""
    panels = 2 * max(1, int(np.ceil(np.max(np.diff(times)) / (2.0 * step) - 1e-9)))
    share = np.arange(panels) / panels
    inner = times[:-1, None] + np.diff(times)[:, None] * share
    return np.append(inner.ravel(), times[-1]), panels


def balance(
    model: AbstractModel, params: Params, times: ArrayLike, accuracy: str | float | Plan = "balanced",
    step: float = 1e-5,
) -> EnergyBalance:  # fmt: skip
    """Run a model and sum up its energy.

    Compiles once per model and number of instants.

    Args:
        model: one with a history and ``flows``.
        params: its parameters, SI.
        times: (T,) two or more, increasing, from 0 on [s]; energies are counted from the first.
        accuracy: level, force error as a fraction of the peak, or a ``Plan``.
        step: longest panel of the quadrature [s].

    Raises:
        InputError: for a model that has no energy balance, and for times or a step that cannot be used.
    """
    params = inputs.parameters(as_model(model), params, traced=False)
    t = increasing(times, 2)
    if t[0] < 0:
        raise InputError("times", f"times[0] = {t[0]:g}", "give times from 0 on: the run starts there")
    step = scalar("balance", _STEP, step)
    how = accuracy if isinstance(accuracy, Plan) else plan(model, accuracy)
    instants, panels = _instants(t, step)
    found = jax.device_get(_flows(model, dict(params), jnp.asarray(instants), how))
    given, taken = (
        {name: _work(x, instants, panels) for name, x in part.items()} for part in (found.given, found.taken)
    )
    stored = {name: np.asarray(x)[::panels] for name, x in found.stored.items()}
    total = sum(stored.values(), np.zeros(t.size))
    change = total - total[0]
    residual = sum(given.values(), np.zeros(t.size)) - sum(taken.values(), np.zeros(t.size)) - change
    done = max(float(np.max(np.abs(value))) for value in (*given.values(), *taken.values(), change))
    closure = float(np.max(np.abs(residual))) / done if done > 0 else float(np.max(np.abs(residual)))
    return EnergyBalance(t, given, taken, stored, residual, closure)
