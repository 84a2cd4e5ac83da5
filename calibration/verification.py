"""The check of ``bcfj verify`` that needs a calibration: known coefficients are found again."""

from __future__ import annotations

import numpy as np

from bcfj_jax import scenes
from bcfj_jax.verification.check import Check, check, relative
from calibration.fit import fit
from calibration.problem import Channel, Experiment, Free, Problem

_TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.15}
_MASS, _SPEED, _SAMPLES = 0.1, 1.0, 60


def record(times: np.ndarray, law: dict[str, float] | None = None) -> np.ndarray:
    """Force [N] at the times (T,) of an impact with K d^n (1 + a d'), by SciPy's DOP853 in plain NumPy."""
    from scipy.integrate import solve_ivp

    k, n, a = (law or _TRUTH).values()

    def force(d: float, rate: float) -> float:
        return k * max(d, 0.0) ** n * max(1.0 + a * rate, 0.0)

    def motion(_: float, state: np.ndarray) -> tuple[float, float]:
        return state[1], -force(state[0], state[1]) / _MASS

    run = solve_ivp(motion, (0.0, times[-1]), (0.0, _SPEED), "DOP853", times, rtol=1e-11, atol=1e-15, max_step=1e-5)
    return np.array([force(d, v) for d, v in run.y.T])


@check("calibration: stiffness, exponent, damping from a force record", "record by SciPy's DOP853, known law", 1e-3)
def recovered() -> float:
    """Without noise, from starts over four decades of stiffness; NaN unless the verdict is identified."""
    times = np.linspace(0.0, 9e-4, _SAMPLES)
    scene = scenes.impact(smoothing=False)
    force = record(times)
    seen = Experiment("a", times, (Channel("contact.normal", force, 1e-3 * float(force.max())),))
    params = {name: float(x) for name, x in scene.parameters(mass=_MASS, approach_speed=_SPEED).items()}
    free = (Free("stiffness", 1e6, 1e10), Free("exponent", 1.0, 2.5), Free("damping", 0.01, 2.0))
    found = fit(Problem(scene, params, (seen,), free))
    if found.verdict != "identified":
        raise RuntimeError(f"the verdict is '{found.verdict}', not 'identified'")
    return relative([found.parameters[name].value for name in _TRUTH], list(_TRUTH.values()))


CHECKS: tuple[Check, ...] = (recovered,)
