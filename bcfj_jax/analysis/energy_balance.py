"""Energy over a run of the joint: what went in, came out, was lost and is kept, and how well the books close.

    work of drive and hold = work of load and axial + losses of friction, damping and edge + change of the store

The powers are read from the run's own states between the times asked for, and integrated by Simpson's rule; the
store is a function of the state. So ``closure`` sees errors of solver, interpolation, quadrature and equations alike.
"""

from __future__ import annotations

from typing import NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import increasing
from bcfj_jax.mechanism.scene import Params
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.energy import Power, Stored, power, stored
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.solve.integrate import Plan, integrate, plan

# Readings evaluated side by side.
_CHUNK = 512


class Ledger(NamedTuple):
    """Energies of a run [J] at T times, each counted from the first of them.

    Attributes:
        times: (T,) [s].
        drive, hold, load, axial, friction, damping, edge: (T,) work since the first time, as ``energy.Power``.
        stored: kinetic, elastic and spring energy (T,), as they are, not as they changed.
        residual: (T,) in less out, less lost, less the store's change: 0 for exact books.
        closure: largest |residual| over the largest |work| of a term or change of the store [-]; NaN for a failed run.
    """

    times: np.ndarray
    drive: np.ndarray
    hold: np.ndarray
    load: np.ndarray
    axial: np.ndarray
    friction: np.ndarray
    damping: np.ndarray
    edge: np.ndarray
    stored: Stored
    residual: np.ndarray
    closure: float


@eqx.filter_jit
def _flows(scene: Joint, params: Params, instants: Array, how: Plan) -> tuple[Power, Stored]:
    """Powers and stores at the instants; NaN from a failure on."""
    states = integrate(scene, params, instants, how, dfx.ForwardMode()).states
    c = constants(scene, params)

    def read(at: tuple[Array, Array]) -> tuple[Power, Stored]:
        t, y = at
        # A law reads NaN as no contact, which would balance.
        failed = jnp.where(jnp.all(jnp.isfinite(y)), 0.0, jnp.nan)
        return jax.tree.map(lambda x: x + failed, (power(scene, c, t, y), stored(scene, c, t, y)))

    return jax.lax.map(read, (instants, states), batch_size=_CHUNK)


def _instants(times: np.ndarray, step: float) -> tuple[np.ndarray, int]:
    """All instants and the (even) number of panels an interval has: none longer than ``step``."""
    panels = 2 * max(1, int(np.ceil(np.max(np.diff(times)) / (2.0 * step) - 1e-9)))
    share = np.arange(panels) / panels
    inner = times[:-1, None] + np.diff(times)[:, None] * share
    return np.append(inner.ravel(), times[-1]), panels


def _work(values: np.ndarray, times: np.ndarray, panels: int) -> np.ndarray:
    """Integral from the first time to each, by Simpson's rule in every interval."""
    parts = np.append(values[:-1].reshape(-1, panels), values[panels::panels, None], axis=1)
    weights = np.tile([4.0, 2.0], panels // 2)[:-1] / (3.0 * panels)
    ends = (parts[:, 0] + parts[:, -1]) / (3.0 * panels)
    return np.append(0.0, np.cumsum(np.diff(times) * (parts[:, 1:-1] @ weights + ends)))


def balance(
    scene: Joint, params: Params, times: ArrayLike, accuracy: str | float | Plan = "balanced", step: float = 1e-5
) -> Ledger:
    """Run a joint and keep its books of energy.

    Compiles once per scene and number of instants.

    Args:
        scene: a joint whose parts have inertia.
        params: its parameters, SI.
        times: (T,) two or more, increasing, from 0 on [s]; the books open at the first.
        accuracy: level, force error as a fraction of the peak, or a ``Plan``.
        step: longest panel of the quadrature [s].

    Raises:
        InputError: for another scene or fidelity, and for times or a step that cannot be used.
    """
    if not isinstance(scene, Joint) or scene.fidelity != "dynamic":
        what = f"scene '{scene.kind}'" + (f", {scene.fidelity}" if isinstance(scene, Joint) else "")
        raise InputError("balance", what, "give a joint with fidelity = 'dynamic': nothing else has inertia")
    t = increasing(times, 2)
    if t[0] < 0:
        raise InputError("times", f"times[0] = {t[0]:g}", "give times from 0 on: the run starts there")
    if not step > 0:
        raise InputError("step", f"{step:g} s", "give a step > 0")
    how = accuracy if isinstance(accuracy, Plan) else plan(scene, accuracy)
    instants, panels = _instants(t, step)
    flow, store = jax.device_get(_flows(scene, dict(params), jnp.asarray(instants), how))
    work = {name: _work(np.asarray(value), t, panels) for name, value in flow._asdict().items()}
    held = Stored(*(jnp.asarray(part)[::panels] for part in store))
    net = Power(**{name: jnp.asarray(value) for name, value in work.items()}).net
    residual = np.asarray(net - (held.total - held.total[0]))
    done = max(float(np.max(np.abs(value))) for value in (*work.values(), held.total - held.total[0]))
    closure = float(np.max(np.abs(residual))) / done if done > 0 else float(np.max(np.abs(residual)))
    return Ledger(t, **work, stored=held, residual=residual, closure=closure)
