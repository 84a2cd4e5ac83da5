"""Checks of derivatives, of energy, and of what this machine's JAX makes of a batch."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.energy_balance import balance
from bcfj_jax.contact import restitution
from bcfj_jax.models import scenes
from bcfj_jax.solve.simulation import force_history
from bcfj_jax.verification.check import ABSOLUTE, Check, check, relative

_RUNS = 20_000


@check("derivative of an impact's peak by stiffness, mass, speed", "Hertz's closed form", 1e-5)
def peak_derivative() -> float:
    """ln F0 = ln(K)/(n+1) + n/(n+1) ln(m v0^2) + ..., by reverse mode through the solver."""
    scene, n = scenes.impact("hertz", smoothing=False), 1.5
    params = scene.parameters(stiffness=1e9, exponent=n, mass=0.1, approach_speed=1.0)
    half = 0.5 * float(restitution.undamped_duration(1e9, n, 0.1, 1.0))

    @jax.jit
    def slopes(p: dict[str, Array]) -> dict[str, Array]:
        # At the time of the peak the force does not depend on time: its derivative is the peak's.
        return jax.grad(
            lambda p: jnp.log(force_history(scene, p, jnp.array([0.0, half]), accuracy=1e-6)["contact"][1, 0])
        )(p)

    found = slopes(params)
    logs = [float(found[name]) * float(params[name]) for name in ("stiffness", "mass", "approach_speed")]
    return relative(logs, (1.0 / (n + 1.0), n / (n + 1.0), 2.0 * n / (n + 1.0)))


@check("derivative of the impulse by damping, 4 dampings", "implicit derivative of the restitution relation", 1e-5)
def damping_derivative() -> float:
    """J = m v0 (1 + e(a v0)): dJ/da = m v0^2 de/dchi, by forward mode through the solver."""
    from scipy.special import lambertw

    scene = scenes.impact("memory_free", smoothing=False)
    params = scene.parameters(stiffness=1e9, exponent=1.5, mass=0.1, approach_speed=1.0)
    times = np.linspace(0.0, 2.0 * float(restitution.undamped_duration(1e9, 1.5, 0.1, 1.0)), 4001)

    def impulse(damping: Array) -> Array:
        force = force_history(scene, {**params, "damping": damping}, times, accuracy=1e-6, mode="forward")
        return jnp.trapezoid(force["contact"][:, 0], times)

    chi = np.array([0.05, 0.2, 0.8, 2.0])
    e = (1.0 + lambertw(-(1.0 + chi) * np.exp(-(1.0 + chi))).real) / chi
    slope = (1.0 + e - 1.0 / (1.0 + chi) - e / (1.0 - chi * e)) * (1.0 - chi * e) / (chi**2 * e)
    differentiated = jax.jit(jax.jacfwd(impulse))
    return relative([float(differentiated(x)) for x in chi], 0.1 * slope)


@check("energy of a bounce with losses, of a slider-crank with friction", "first law: work in = out + stored", 1e-4)
def energy() -> float:
    """Largest gap of the balance over the largest work."""
    drop = scenes.bounce()
    crank = scenes.slider_crank(friction=True)
    worst = balance(drop, drop.parameters(), np.array([0.0, 0.3]), 1e-5, step=2e-5).closure
    params = crank.parameters(friction_static=0.1, friction_dynamic=0.05)
    return float(np.maximum(worst, balance(crank, params, np.array([0.0, 3e-3]), 1e-5, step=5e-7).closure))


@check("20 000 small matrix products in one batch", "NumPy; the jax error jax-ml/jax#39103", 1e-12, ABSOLUTE)
def batched_products() -> float:
    """jax 0.10.2 returns wrong sums from 16 385 runs on, without a word."""
    rng = np.random.default_rng(1)
    worst = 0.0
    for rows in (3, 6):
        a, x = rng.normal(size=(rows, 3)), rng.normal(size=(_RUNS, 3))
        for reduce in ("sum", "min"):
            found = jax.jit(jax.vmap(lambda v, a=a, reduce=reduce: getattr(jnp, reduce)(jnp.asarray(a) @ v)))(x)
            expected = getattr(np, reduce)(x @ a.T, axis=1)
            worst = float(np.maximum(worst, np.abs(np.asarray(found) - expected).max()))
    return worst


@check("20 000 impacts in one batch: force against time", "half sine of a linear contact, closed form", 5e-2)
def batched_impacts() -> float:
    """At the level fast, which promises 5 % of the peak: F = v sqrt(K m) sin(sqrt(K/m) t) until it ends."""
    scene = scenes.impact("hertz", "linear", smoothing=False)
    mass, speed = 0.02, 1.5
    stiffness = np.geomspace(1e7, 1e8, _RUNS)
    times = np.linspace(0.1, 1.3, 5) * np.pi * np.sqrt(mass / 5e7)
    params = scene.parameters(mass=mass, approach_speed=speed)

    @jax.jit
    @jax.vmap
    def forces(k: Array) -> Array:
        return force_history(scene, {**params, "stiffness": k}, times, accuracy="fast", mode="forward")["contact"][:, 0]

    root = np.sqrt(stiffness / mass)[:, None]
    expected = speed * root * mass * np.maximum(np.sin(np.minimum(root * times, np.pi)), 0.0)
    peak = speed * np.sqrt(stiffness * mass)
    return float(np.max(np.abs(np.asarray(forces(stiffness)) - expected) / peak[:, None]))


CHECKS: tuple[Check, ...] = (peak_derivative, damping_derivative, energy, batched_products, batched_impacts)
