"""Whether only an implicit solver takes long steps: strong damping by loads, friction or contact states that are stiff.

An explicit method takes steps below 3/r, r the fastest relaxation of the mechanism, however slowly anything moves; springs
of frequency w ask for steps below 1/w of every method. With T the length of the run, an implicit solver pays where

- a load damps strongly: r is the largest real eigenvalue of -df/dy at the start, without contact forces (a spring's are
  -a +- i w), and r T > STEEP, r > w;
- friction is stiff: N m(0) v resists a slip v, with the law's mobility m(0) [s/m] at rest. For a contact of the expected
  depth d and speed v_n (``mechanism.scales``) the normal force is about m v_n^2/d and the contact's frequency
  w = v_n/d, so r = m(0) v_n w. Friction is stiff where r T > STEEP, and r > STIFF w or r T > LONG;
- a state of a normal-force law relaxes fast at the expected depth, by the same limits.

STIFF is far above 1, since an implicit step costs several explicit ones and is hardly longer (benchmarks/solve/friction.py).
Bristles (LuGre) are stiff always.
Damping within contacts acts for the time of a contact, which has to be resolved anyway, and does not count.
"""

from __future__ import annotations

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism.checks import asked
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.loads import CoordinateLoad
from bcfj_jax.mechanism.scales import expected
from bcfj_jax.mechanism.sizes import Params
from bcfj_jax.xla import host

# Relaxations in a run that an explicit solver may follow, in some 10 000 steps.
STEEP = 3e4
# Relaxations of friction in a period of the contact, and in a run: the latter some 300 000 steps.
STIFF, LONG = 50.0, 1e6


def implicit(scene: Dynamics, params: Params, end: float) -> bool:
    """Whether a run of these parameters until ``end`` [s] needs an implicit solver. Not under a trace."""
    if (known := _known(scene)) is not None:
        return known
    jacobian, rate, frequency = asked(_rates, scene, dict(scene.completed(params)))
    return _slow(jacobian, rate, frequency, end)


@lru_cache(maxsize=256)
def implicit_by_default(scene: Dynamics) -> bool:
    """The same of the default values and horizon, by NumPy alone: under a trace, too.

    Where a value is missing, of which ``check`` tells, or NumPy is not enough, friction is stiff.
    """
    if (known := _known(scene)) is not None:
        return known
    names, values = [name for name, _ in scene.defaults], [value for _, value in scene.defaults]
    shapes = [jax.ShapeDtypeStruct(np.shape(value), jnp.float64) for value in values]

    def all_of(*values: Array) -> tuple[Array, ...]:
        params = dict(zip(names, values, strict=True))
        return *_rates(scene, params), *(() if isinstance(scene.end, (int, float)) else (scene.horizon(params),))

    try:
        jacobian, rate, frequency, *end = host.evaluate(jax.make_jaxpr(all_of)(*shapes), values)
    except (host.Unknown, InputError, KeyError):
        return any(c.friction is not None for c in scene.contacts)
    return _slow(jacobian, rate, frequency, float(end[0] if end else scene.end))


def _known(scene: Dynamics) -> bool | None:
    """What needs no numbers: bristles are stiff; without friction, states of laws and dampers nothing is."""
    frictions = [c.friction for c in scene.contacts if c.friction is not None]
    if scene._bristly or any(friction.bristles for friction in frictions):
        return True
    damps = bool(scene._free) and any(load.damps for load in scene.loads)
    return None if frictions or damps or any(c.law.states for c in scene.contacts) else False


def _slow(jacobian: np.ndarray, rate: np.ndarray, frequency: np.ndarray, end: float) -> bool:
    r, w = float(rate), float(frequency)
    # A rate that is not known is taken as stiff.
    if not r * end <= STEEP and not (r <= STIFF * w and r * end <= LONG):
        return True
    if not (jacobian.size and np.isfinite(jacobian).all()):
        return False
    found = np.linalg.eigvals(jacobian)
    fastest = float(np.max(-found.real, initial=0.0))
    return fastest * end > STEEP and fastest > float(np.max(np.abs(found.imag), initial=0.0))


def _rates(scene: Dynamics, params: Params) -> tuple[Array, Array, Array]:
    """J (n, n) at the start, of loads that damp; the fastest relaxation in contacts and a contact's frequency [1/s]."""
    t, y = jnp.zeros(()), scene.initial_state(params)
    jacobian = jnp.zeros((0, 0))
    if scene._free and any(load.damps for load in scene.loads):
        # Not ``jacfwd``, whose primitives NumPy is not told of (``xla.host``).
        # At rest, where dry friction in joints is steepest.
        places = sum(k or 1 for *_, k in scene._placed)
        dry = any(isinstance(load, CoordinateLoad) and load.dry for load in scene.loads)
        at = y * (np.arange(y.size) < places) if dry else y
        along = lambda way: jax.jvp(lambda y: scene.motion(t, y, params), (at,), (way,))[1]  # noqa: E731
        jacobian = jax.vmap(along, out_axes=1)(jnp.eye(y.size))
    frictions = [(c.friction, c.coefficients(params)) for c in scene.contacts if c.friction is not None]
    lasting = [c for c in scene.contacts if c.law.states]
    if not (frictions or lasting):
        return jacobian, jnp.zeros(()), jnp.ones(())
    found = expected(scene, params)
    frequency = found.speed / found.depth
    rates = [law.mobility(jnp.zeros(()), told) * found.speed * frequency for law, told in frictions]
    rates += [_relaxation(c.law, found.depth, c.coefficients(params)) for c in lasting]
    return jacobian, jnp.max(jnp.stack(rates)), frequency


def _relaxation(law: AbstractLaw, depth: Array, values: Params) -> Array:
    """Fastest rate [1/s] at which states of a law relax of themselves, in a contact at rest that remembers nothing."""
    nothing = jnp.zeros_like(depth)
    rates = lambda kept: law.rates(depth, nothing, {**values, **kept})  # noqa: E731
    fresh, ones = (dict.fromkeys(law.states, x) for x in (nothing, jnp.ones_like(depth)))
    return jnp.max(-jnp.stack(jax.jvp(rates, (fresh,), (ones,))[1]))
