"""Whether loads damp a mechanism so strongly that only an implicit solver takes long steps.

Without contact forces the equations are  y' = f(t, y);  at the start they are linearised, J = df/dy. A damper that relaxes
a velocity is a real eigenvalue -r of J. An explicit method takes steps below 3/r, however slowly anything moves; springs,
eigenvalues -a +- i w, ask for steps below 1/w of every method. Damping is strong where

    r T > STEEP   and   r > max w,    T the length of the run.

Damping within contacts acts for the time of a contact, which has to be resolved anyway, and does not count.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core import host
from bcfj_jax.mechanism.checks import asked

if TYPE_CHECKING:
    from bcfj_jax.mechanism.mechanism import Mechanism
    from bcfj_jax.mechanism.sizes import Params

# Relaxations in a run that an explicit solver may follow, in some 10 000 steps.
STEEP = 3e4


def strong(scene: Mechanism, params: Params, end: float) -> bool:
    """Whether a run of these parameters until ``end`` [s] is strongly damped by its loads. Not under a trace."""
    return _steep(asked(_slope, scene, dict(params)), end)


@lru_cache(maxsize=256)
def strong_by_default(scene: Mechanism) -> bool:
    """The same of the default values and horizon, by NumPy alone: under a trace, too."""
    names, values = [name for name, _ in scene.defaults], [value for _, value in scene.defaults]
    shapes = [jax.ShapeDtypeStruct((), jnp.float64)] * len(names)

    def all_of(*values: Array) -> tuple[Array, ...]:
        params = dict(zip(names, values, strict=True))
        return _slope(scene, params), *(() if isinstance(scene.end, (int, float)) else (scene.horizon(params),))

    try:
        jacobian, *end = host.evaluate(jax.make_jaxpr(all_of)(*shapes), values)
        return _steep(jacobian, float(end[0] if end else scene.end))
    except host.Unknown:
        return False


def _steep(jacobian: np.ndarray, end: float) -> bool:
    if not np.isfinite(jacobian).all():
        return False
    found = np.linalg.eigvals(jacobian)
    fastest = float(np.max(-found.real, initial=0.0))
    return fastest * end > STEEP and fastest > float(np.max(np.abs(found.imag), initial=0.0))


def _slope(scene: Mechanism, params: Params) -> Array:
    """J (n, n) at the start."""
    t, y = jnp.zeros(()), scene.initial_state(params)
    # Not ``jacfwd``, whose primitives NumPy is not told of (``core.host``).
    along = lambda way: jax.jvp(lambda y: scene.motion(t, y, params), (y,), (way,))[1]  # noqa: E731
    return jax.vmap(along, out_axes=1)(jnp.eye(y.size))
