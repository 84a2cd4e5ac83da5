"""``simulate`` against closed forms and SciPy: impacts, bounces, the promise on force, failures, wrong input."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from oracles import family, within
from oracles import impact as struck

from bcfj_jax import InputError, force_history, scenes, simulate
from bcfj_jax.contact.restitution import delivered_restitution, undamped_duration, undamped_peak

# Trapezoids over 2001 samples of one hump err by 1e-6 in impulse and 1e-6 in peak: below every promise here.
SAMPLES = 2001
# Chung and Ooi 2011, test 1: two glass spheres (E 48 GPa, nu 0.2, R 10 mm, 2800 kg/m^3) closing at 20 m/s.
GLASS = {
    "stiffness": 4 / 3 * 48e9 / (2 * 0.96) * np.sqrt(0.005),
    "exponent": 1.5,
    "mass": 2800 * 4 / 3 * np.pi * 1e-6 / 2,
    "approach_speed": 20.0,
}
HERTZ, MEMORY_FREE, EXACT = (scenes.impact(law) for law in ("hertz", "memory_free", "exact"))


def impulse(times, force):
    """Integral of a sampled force."""
    return np.trapezoid(force, times)


def strike(scene, accuracy="reference", until=2.0, **values):
    """Times and normal force of an impact, up to ``until`` undamped durations after the touch."""
    p = scene.parameters({**GLASS, **values})
    touch = float(p["clearance_contact"] / p["approach_speed"])
    contact = float(undamped_duration(p["stiffness"], p["exponent"], p["mass"], p["approach_speed"]))
    times = np.linspace(0.0, touch + until * contact, SAMPLES)
    run = simulate(scene, p, times, accuracy=accuracy)
    assert run.status == "ok" and run.reason == "" and np.isnan(run.failure_time)
    return times, run.force["contact"][:, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("elastic", "restitution"),
    [
        (None, 0.0),
        (None, 0.5),
        pytest.param("reference", 0.0, marks=pytest.mark.slow),
        pytest.param("reference", 0.5, marks=pytest.mark.slow),
        ("liu", 0.5),
    ],
)
def test_a_mass_let_go_on_the_surface_comes_to_rest(elastic, restitution):
    scene = scenes.bounce("flores", elastic)
    params = scene.parameters(drop_height=0.0, restitution=restitution)
    run = simulate(scene, params, np.linspace(0.0, 0.1, 11))
    assert run.status == "ok"
    assert run.force["contact"][-1, 0] == pytest.approx(float(params["mass"] * params["gravity"]), rel=1e-3)


def test_chung_and_ooi_1():
    times, force = strike(HERTZ)
    assert force.max() == within(10696.9, 1e-3)  # 0.1 %: what the benchmark asks
    assert times[force > 0][-1] == within(40.339e-6, 1e-3)  # and one sample is 0.1 % of two durations


@pytest.mark.parametrize(
    ("scene", "value"), [(MEMORY_FREE, {"damping": 0.02}), tiers.slow((EXACT, {"restitution": 0.6}))]
)
def test_the_impulse_is_that_of_the_rebound(scene, value):
    times, force = strike(scene, until=3.0, **value)
    e = value.get("restitution") or float(delivered_restitution(value["damping"] * 20.0))
    # 1e-4: ten times the force error asked for ("reference", 1e-5), as it adds up over the contact.
    assert impulse(times, force) == within(GLASS["mass"] * 20.0 * (1 + e), 1e-4)


def test_clearance_delays_the_force():
    times, near = strike(HERTZ)
    clearance = 1e-3
    p = HERTZ.parameters(**GLASS, clearance_contact=clearance)
    far = simulate(HERTZ, p, times + clearance / 20.0, accuracy="reference").force["contact"][:, 0]
    # Each history is within 1e-5 of the peak of the true one.
    assert np.abs(far - near).max() < 2e-5 * near.max()
    assert not np.any(simulate(HERTZ, p, times * 0.4, accuracy="reference").force["contact"])


def touches(scene, **values):
    """Times of the touches and speeds of the flights, from the energy of every sample in flight."""
    p = scene.parameters(values, drop_height=0.9, gravity=9.81, stiffness=1e13)
    times = np.linspace(0.0, 3.2, 641)
    run = simulate(scene, p, times, accuracy="reference")
    assert run.status == "ok"
    height, up = -run.penetration["contact"], -run.rate["contact"]
    flying = height > 0
    speed = np.sqrt(up**2 + 2 * 9.81 * height)[flying]
    touch = times[flying] + (up[flying] + speed) / 9.81
    first = np.concatenate([[True], np.diff(touch) > 1e-3])
    return touch[first], speed[first]


@pytest.mark.slow
def test_bounces_with_a_restitution():
    touch, speed = touches(scenes.bounce("exact"), restitution=0.8)
    assert touch[0] == within(0.42835294, 1e-7)
    flights = np.diff(touch)[:6]
    # A contact lasts 6 us to 8 us beside flights of 0.69 s to 0.22 s: 3e-5. The apex ratio is e^2.
    assert flights[1:] / flights[:-1] == pytest.approx(0.8, abs=1e-3)
    assert (speed[1:7] / speed[:6]) ** 2 == pytest.approx(0.64, abs=1e-3)


@pytest.mark.slow
def test_bounces_without_memory_lose_by_their_own_speed():
    _, speed = touches(scenes.bounce("memory_free"), damping=0.1)
    e = speed[1:7] / speed[:6]
    assert e == pytest.approx(np.asarray(delivered_restitution(0.1 * speed[:6])), abs=1e-3)
    assert np.all(np.diff(e) > 0)


def test_smoothing_keeps_the_peak_and_can_be_left_out():
    p = HERTZ.parameters(GLASS)
    depth = 20.0 * float(undamped_duration(*[p[k] for k in GLASS])) / 2.94  # T0 = 2.94 d0 / v0
    # The onset begins a width before the surface, so the body starts further away than that.
    _, force = strike(HERTZ, smoothing=0.2 * depth, clearance_contact=0.3 * depth)
    assert force.max() == within(float(undamped_peak(*GLASS.values())), 2e-5)  # the promise 1e-5 and the sampling
    bare = scenes.impact("hertz", smoothing=False)
    assert "smoothing" in HERTZ.quantities and "smoothing" not in bare.quantities
    with pytest.raises(InputError, match="no parameter 'smoothing'"):
        bare.parameters(smoothing=0.0)


@pytest.mark.parametrize("asked", [5e-2, 1e-2, 1e-3])
@pytest.mark.parametrize("n", [1.0, 1.5, 2.5])
@pytest.mark.parametrize("e", [1.0, 0.5])
def test_the_force_error_is_what_was_asked_for(e, n, asked):
    chi = {1.0: 0.0, 0.5: 1.48}[e]  # e(1.48) is about 0.5; what matters is that both sides get the same
    stiffness, mass, speed = 1e9 * 1e-4 ** (1.5 - n), 0.01, 2.0
    true = struck(family(chi, n, stiffness, speed), mass, speed)
    times = np.linspace(0.0, 1.2 * true.duration, SAMPLES)
    values = {"stiffness": stiffness, "exponent": n, "mass": mass, "approach_speed": speed, "damping": chi / speed}
    force = simulate(MEMORY_FREE, MEMORY_FREE.parameters(values), times, accuracy=asked).force["contact"][:, 0]
    assert force.max() == within(true.peak, asked)
    assert impulse(times, force) == within(mass * speed * (1 + true.restitution), asked)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([], "1 or more finite"),
        ([[0.0, 1.0]], "1-D"),
        ([0.0, np.nan], "finite"),
        ([0.0, np.inf], "finite"),
        ([0.0, 2.0, 1.0], r"times\[2\] = 1 follows 2"),
        ([0.0, 0.0], "increase"),
    ],
)
def test_wrong_times(times, said):
    with pytest.raises(InputError, match=said):
        simulate(HERTZ, HERTZ.parameters(), times)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: HERTZ.parameters(stifness=1.0), "did you mean 'stiffness'"),
        (lambda: HERTZ.parameters(exponent=0.5), r"exponent = 0.5 .*>= 1 and <= 3"),
        (lambda: HERTZ.parameters(mass=0.0), r"mass = 0 kg .*> 0"),
        (lambda: HERTZ.parameters(stiffness=np.array([1.0, np.nan])), "stiffness = nan"),
        (lambda: scenes.impact("memory_fre"), "did you mean 'memory_free'"),
        (lambda: scenes.impact("hertz", "powr"), "did you mean 'power'"),
        (lambda: scenes.make("impct"), "did you mean 'impact'"),
        (lambda: scenes.make("impact", lw="hertz"), "law"),
        (lambda: simulate(HERTZ, HERTZ.parameters(), [0.0], accuracy="fats"), "did you mean 'fast'"),
        (lambda: simulate(HERTZ, HERTZ.parameters(), [0.0], accuracy=0.7), "force_error = 0.7"),
        (lambda: force_history(HERTZ, HERTZ.parameters(), [0.0], mode="back"), "auto, forward or reverse"),
    ],
)
def test_wrong_names_and_values(call, said):
    with pytest.raises(InputError, match=said):
        call()


def test_a_spent_budget_is_a_failed_run():
    times = np.linspace(0.0, 50e-6, 101)
    run = simulate(HERTZ, HERTZ.parameters(GLASS), times, accuracy="reference", max_steps=5)
    assert run.status == "failed" and "5 steps" in run.reason
    assert 0.0 < run.failure_time < times[-1]
    good = np.isfinite(run.force["contact"][:, 0])
    assert np.array_equal(good, times <= run.failure_time)


@jax.jit
def single(stiffness):
    p = HERTZ.parameters(GLASS)
    return force_history(HERTZ, {**p, "stiffness": stiffness}, jnp.linspace(0.0, 40e-6, 9))["contact"][:, 0]


in_a_batch = jax.jit(jax.vmap(single))


@pytest.mark.full
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_failed_run_of_a_batch_fails_alone(bad):
    batch = jnp.array([1e9, bad, 3e9])
    together = np.asarray(in_a_batch(batch))
    assert np.all(np.isnan(together[1, 1:]))
    for row in (0, 2):
        # The same steps, rounded otherwise by another program: 1e-9 is rounding grown over the run.
        assert together[row] == pytest.approx(np.asarray(single(batch[row])), rel=1e-9, abs=1e-6)


def test_times_before_the_start_read_the_initial_state():
    p = HERTZ.parameters(GLASS, clearance_contact=1e-4)
    # As many as elsewhere, for which there is a program.
    times = np.linspace(-2.0, 0.0, SAMPLES - 1)
    run = simulate(HERTZ, p, [*times, 1e-6])
    assert run.status == "ok" and not np.any(run.force["contact"])
    assert run.penetration["contact"] == pytest.approx([-1e-4] * times.size + [-8e-5], rel=1e-12)
    assert run.rate["contact"] == pytest.approx([20.0] * SAMPLES, rel=1e-12)
