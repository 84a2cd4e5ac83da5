"""Parts of the measuring chain against SciPy and by hand; what of it is shared, and what must be given."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lsim

from bcfj_jax import InputError, scenes, simulate
from calibration import Channel, Experiment, Free, Problem
from calibration.forward.model import build, predictions, residuals_and_jacobian
from calibration.forward.observables import resonant as resonant_by_steps
from calibration.forward.observables import through

pytestmark = pytest.mark.filterwarnings("error")
SCENE = scenes.impact(smoothing=False)
PARAMS = {k: float(v) for k, v in SCENE.parameters({"mass": 0.1, "approach_speed": 1.0, "stiffness": 1e8}).items()}
TIMES = np.linspace(0.0, 1.6e-3, 81)
# An operation at a time it compiles a hundred little programs.
resonant = jax.jit(resonant_by_steps)


@pytest.mark.full
@pytest.mark.parametrize("damping", [0.02, 0.7])
def test_a_second_order_sensor_is_scipys(damping):
    rng = np.random.default_rng(0)
    times, values = np.linspace(0.0, 0.02, 400), rng.standard_normal((400, 2))
    w = 2.0 * np.pi * 300.0
    ours = resonant(jnp.asarray(times), jnp.asarray(values), jnp.asarray(300.0), jnp.asarray(damping))
    for column in range(2):
        system = ([w**2], [1.0, 2.0 * damping * w, w**2])
        _, out, _ = lsim(system, values[:, column] - values[0, column], times)
        np.testing.assert_allclose(ours[:, column], out + values[0, column], atol=1e-9)


def test_a_stiff_sensor_reads_what_is_there_and_has_a_derivative():
    times, values = jnp.array([0.0, 0.0, 1e-3, 3e-3]), jnp.array([[1.0], [5.0], [2.0], [2.0]])
    np.testing.assert_allclose(resonant(times, values, jnp.asarray(1e12), jnp.asarray(0.05))[2:], values[2:], atol=1e-8)
    slopes = jax.jit(jax.jacfwd(lambda p: resonant(times, values, p[0], p[1])))(jnp.array([500.0, 0.1]))
    assert np.isfinite(slopes).all()


def test_the_chain_is_what_its_docstring_says():
    times, x = np.linspace(0.0, 0.1, 50), np.linspace(-2.0, 5.0, 50)
    chain = {
        "time_offset": 0.01, "gain": 2.0, "gain_bend": -0.02, "drift": 7.0,
        "hum_frequency": 50.0, "hum_sine": 0.3, "hum_cosine": -0.2,
    }  # fmt: skip
    read = through(
        {k: jnp.asarray(v) for k, v in chain.items()}, jnp.asarray(times), jnp.asarray(x)[:, None], jnp.asarray(3.0)
    )[:, 0]
    t, w = times + 0.01, 100.0 * np.pi
    expected = 2.0 * x * (1.0 - 0.02 * np.abs(x)) + 3.0 + 7.0 * t + 0.3 * np.sin(w * t) - 0.2 * np.cos(w * t)
    np.testing.assert_allclose(read, expected, rtol=1e-12)


def two_runs(*free: Free, **known: float) -> Problem:
    force = simulate(SCENE, PARAMS, TIMES).force["contact"][:, 0]
    runs = (Experiment(n, TIMES, (Channel("contact.normal", np.asarray(force), 1.0),), fixed=known) for n in "ab")
    return Problem(SCENE, PARAMS, tuple(runs), (Free("stiffness", 1e7, 1e9), *free))


def shared_and_own():
    problem = two_runs(Free("resonance", 1e3, 1e5), Free("drift", -1.0, 1.0), Free("gain", 0.5, 2.0, each=False))
    return build(problem, problem.experiments)


@pytest.mark.slow
def test_a_sensors_own_numbers_are_shared_and_a_records_are_not():
    assert [(a.name, a.experiment) for a in shared_and_own().coordinates] == [
        ("stiffness", None), ("resonance", None), ("gain", None), ("drift", 0), ("drift", 1),
    ]  # fmt: skip


@pytest.mark.slow
def test_derivatives_by_numbers_of_sensor_and_record_are_those_of_differences():
    model = shared_and_own()
    point = model.point(np.array([1e8, 4e3, 1.1, 0.5, -0.5]))
    _, jacobian = residuals_and_jacobian(model, point)
    for k in range(5):
        step = np.where(np.arange(5) == k, 1e-5, 0.0)
        ends = [residuals_and_jacobian(model, point + s * step)[0] for s in (-1, 1)]
        slope = (ends[1] - ends[0]) / 2e-5
        np.testing.assert_allclose(jacobian[:, k], slope, atol=1e-5 * np.abs(slope).max() + 1e-9)


@pytest.mark.slow
def test_a_known_sensor_is_part_of_the_prediction():
    """Beside SciPy's at a hundred times the resolution."""
    problem = two_runs(resonance=3e3, resonance_damping=0.1)
    model = build(problem, problem.experiments)
    read = predictions(model, model.point(np.array([1e8])))[0, 0]
    dense = np.linspace(0.0, TIMES[-1], 8001)
    force = np.asarray(simulate(SCENE, PARAMS, dense).force["contact"][:, 0])
    w = 6e3 * np.pi
    _, out, _ = lsim(([w**2], [1.0, 0.2 * w, w**2]), force, dense)
    np.testing.assert_allclose(read, np.interp(TIMES, dense, out), atol=2e-4 * force.max())


def test_parts_that_need_another_are_refused_without_it():
    with pytest.raises(InputError, match=r"hum_sine: a has no hum_frequency; give hum_frequency in .*\[free.hum_freq"):
        two_runs(Free("hum_sine", -1.0, 1.0))
    with pytest.raises(InputError, match=r"\[free.hum_frequency\]: the hum has no size; add \[free.hum_sine\]"):
        two_runs(Free("hum_frequency", 10.0, 100.0))
    with pytest.raises(InputError, match=r"resonance_damping: a has no resonance"):
        two_runs(Free("resonance_damping", 0.01, 0.5))
    one = two_runs()
    channels = (*one.experiments[0].channels, Channel("body.acceleration.x", TIMES, 1.0))
    both = (replace(one.experiments[0], channels=channels),)
    with pytest.raises(InputError, match=r"one gain_bend for channels in N and m/s\^2"):
        replace(one, experiments=both, free=(*one.free, Free("gain_bend", -1e-3, 1e-3)))
