"""Records with an imperfection that no prior knows: the verdict says that a shape is missed, and no interval is narrow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import tiers

from bcfj_jax import scenes, simulate
from calibration import Channel, Experiment, Free, Problem, fit

SCENE = scenes.impact(smoothing=False)
TRUTH = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}
TIMES = np.linspace(0.0, 1.6e-3, 161)
Change = Callable[[np.ndarray, float], np.ndarray]


def _jump(f: np.ndarray, size: float) -> np.ndarray:
    return f + 0.08 * size * f.max() * (TIMES > 4e-4)


def _sticks(f: np.ndarray, size: float) -> np.ndarray:
    held = f[np.searchsorted(TIMES, 2.5e-4)]
    return np.where((TIMES > 2.5e-4) & (TIMES < 5e-4), f + size * (held - f), f)


def _rings(f: np.ndarray, size: float) -> np.ndarray:
    return f + 0.06 * size * f.max() * np.sin(2.0 * np.pi * 9e3 * TIMES) * (f > 0.0)


def _skips(f: np.ndarray, size: float) -> np.ndarray:
    return np.interp(TIMES + 40e-6 * size * (TIMES > 5e-4), TIMES, f)


def problem(change: Change, size: float) -> Problem:
    params = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, **TRUTH}).items()}
    force = simulate(SCENE, params, TIMES, accuracy=1e-8).force["contact"][:, 0]
    noise = 2e-3 * float(force.max()) * np.random.default_rng(0).standard_normal(force.size)
    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.0, 2.5), Free("damping", 1e-3, 1.0))
    channel = Channel("contact.normal", change(force, size) + noise, None)
    return Problem(SCENE, params, (Experiment("drop", TIMES, (channel,)),), free)


@pytest.mark.parametrize("size", tiers.ci([0.3, 1.0], 1.0))
@pytest.mark.parametrize("change", tiers.ci([_jump, _sticks, _rings, _skips], _sticks))
def test_what_no_prior_knows_is_a_shape_that_is_missed(change, size):
    """A zero that jumps, a sensor that sticks, one that rings nine times, a clock that skips: 15 to 100 deviations."""
    found = fit(problem(change, size), starts=4)
    assert found.verdict in ("misfit", "adequate"), found.verdict
    assert any("misses a shape" in reason for reason in found.reasons), found.reasons
    for name, p in found.parameters.items():
        assert p.ci95 is None or p.ci95[0] <= TRUTH[name] <= p.ci95[1], (name, p.value, p.ci95)
