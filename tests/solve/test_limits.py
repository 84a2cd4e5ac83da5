"""Limits with known answers: rigid impacts, no loss, no rebound, rest, grazing, no friction, no clearance."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from joints import GROOVES, LITTLE, plain_joint
from oracles import within

from bcfj_jax import scenes, simulate
from bcfj_jax.contact.restitution import delivered_restitution, undamped_duration, undamped_peak
from bcfj_jax.models.joint.quasistatic import quasistatic_forces

GRAVITY, HEIGHT, MASS = 9.81, 0.1, 0.0167


def flights(run, drop):
    """Energy per mass [m^2/s^2] of the samples in flight, with their times [s]."""
    height, up = -run.penetration["contact"], -run.rate["contact"]
    flying = height > 1e-3 * drop
    return run.times[flying], (0.5 * up**2 + GRAVITY * height)[flying]


def rigid(times, e):
    """Height [m] of a body that bounces in no time, by the map  v -> e v."""
    fall = np.sqrt(2 * HEIGHT / GRAVITY)
    height, start, speed = HEIGHT - 0.5 * GRAVITY * times**2, fall, e * GRAVITY * fall
    for _ in range(4):
        since = times - start
        height = np.where(since > 0, speed * since - 0.5 * GRAVITY * since**2, height)
        start, speed = start + 2 * speed / GRAVITY, e * speed
    return height


@pytest.mark.full
@pytest.mark.parametrize("n", [1.0, 1.5, 3.0])
def test_stiffness_to_infinity_is_the_rigid_impact(n):
    """The way of a body differs by its contacts' duration, which goes as K^(-1/(n+1))."""
    e, scene = 0.8, scenes.bounce("exact")
    # Within the fourth flight.
    times, errors, powers = np.linspace(0.0, 0.66, 331), [], np.array([5.0, 7.0, 9.0])
    for power in powers:
        # At 10 um every exponent is as stiff.
        params = scene.parameters(
            stiffness=10**power * 1e-5 ** (1.0 - n), exponent=n, restitution=e, mass=MASS, drop_height=HEIGHT
        )
        run = simulate(scene, params, times, accuracy=1e-6)
        assert run.status == "ok"
        errors.append(np.max(np.abs(-run.penetration["contact"] - rigid(times, e))))
    order = np.diff(np.log10(errors)) / np.diff(powers)
    assert order == pytest.approx(-1.0 / (n + 1.0), abs=0.03)


@pytest.mark.slow
def test_restitution_1_keeps_the_energy_over_a_thousand_bounces():
    """What a rebound may add is shared among the bounces."""
    scene = scenes.bounce("exact")
    drop = 1e-3
    params = scene.parameters(restitution=1.0, drop_height=drop)
    bounces = 1000
    end = (2 * bounces + 1) * np.sqrt(2 * drop / GRAVITY) + bounces * 1e-3
    run = simulate(scene, params, np.linspace(0.0, end, 20001), accuracy=1e-6, max_steps=2_000_000)
    assert run.status == "ok"
    _, energy = flights(run, drop)
    assert np.max(np.abs(energy / (GRAVITY * drop) - 1.0)) < 1e-6


@pytest.mark.slow
def test_restitution_0_comes_to_rest():
    scene = scenes.bounce("exact")
    params = scene.parameters(restitution=0.0, stiffness=1e5, exponent=1.0, mass=MASS, drop_height=1e-3)
    run = simulate(scene, params, np.linspace(0.0, 0.1, 1001), accuracy="balanced")
    assert run.status == "ok"
    fall = np.sqrt(2 * 1e-3 / GRAVITY)
    after = run.times > fall + 0.02
    # 1 % of the peak, which is what was asked for.
    assert run.force["contact"][after, 0] == pytest.approx(MASS * GRAVITY, abs=1e-2 * run.force["contact"].max())
    # The lowest restitution there is, 0.001, is a flight of 28 ns.
    assert np.all(run.penetration["contact"][after] > -1e-9)


@pytest.mark.full
@pytest.mark.parametrize("n", tiers.ci([1.0, 1.5, 3.0], 1.5))
@pytest.mark.parametrize("law", [pytest.param("hertz", marks=pytest.mark.slow), "memory_free"])
def test_what_rests_presses_by_its_weight(law, n):
    scene = scenes.bounce(law)
    sag = 1e-6
    values = {"stiffness": MASS * GRAVITY / sag**n, "exponent": n, "mass": MASS, "drop_height": 0.0}
    # Let go on the surface without loss it swings about its sag; with much, it rests there.
    values |= {"damping": 1e3} if law == "memory_free" else {}
    params = scene.parameters(values)
    period = 2 * np.pi * np.sqrt(sag / (n * GRAVITY))
    run = simulate(scene, params, np.linspace(0.0, 40 * period, 4001), accuracy=1e-4)
    force = run.force["contact"][:, 0]
    if law == "memory_free":
        assert force[-1] == within(MASS * GRAVITY, 1e-4)
    # Momentum: the mean force is the weight, up to the swing's own momentum over the time.
    swing = MASS * np.sqrt(2 * GRAVITY * 3 * sag)
    mean = np.trapezoid(force, run.times) / run.times[-1]
    assert mean == pytest.approx(MASS * GRAVITY, abs=2 * swing / run.times[-1] + 1e-3 * MASS * GRAVITY)


@pytest.mark.slow
@pytest.mark.parametrize("clearance", [0.0, 1e-9])
@pytest.mark.parametrize("speed", [1e-6, 1e-9])
def test_a_grazing_touch_is_an_impact_like_any_other(speed, clearance):
    """Peak ~ v^(2n/(n+1)), duration ~ v^(-(n-1)/(n+1)): the closed forms, down to 1 nm/s and forces of 1e-8 N."""
    scene = scenes.impact("exact")
    stiffness, n, e = 1.3476e10, 1.5, 0.7
    params = scene.parameters(
        stiffness=stiffness, exponent=n, restitution=e, mass=MASS, approach_speed=speed, clearance_contact=clearance
    )
    duration = float(undamped_duration(stiffness, n, MASS, speed))
    times = clearance / speed + duration * np.linspace(-0.2 if clearance else 0.0, 3.0, 1601)
    run = simulate(scene, params, times, accuracy=1e-3)
    assert run.status == "ok"
    force = run.force["contact"][:, 0]
    assert np.trapezoid(force, run.times) == within(MASS * speed * (1 + e), 1e-3)
    elastic = scenes.impact("hertz")
    bare = {name: value for name, value in params.items() if name != "restitution"}
    bounced = simulate(elastic, bare, times, accuracy=1e-3)
    pressed = bounced.force["contact"][:, 0]
    assert pressed.max() == within(float(undamped_peak(stiffness, n, MASS, speed)), 1e-3)
    lasted = np.ptp(bounced.times[pressed > 0])
    assert lasted == pytest.approx(duration, abs=2.1 * np.diff(times).max())


@pytest.mark.slow
def test_restitution_to_1_is_no_damping():
    """What 1 - e leaves of the exact law is  chi = 3 (1 - e)/2:  the force tends to the elastic one in first order."""
    times = np.linspace(0.0, 5e-5, 201)
    elastic = simulate(scenes.impact("hertz"), scenes.impact("hertz").parameters(), times, accuracy=1e-8)
    scene, gaps = scenes.impact("exact"), []
    for left in (1e-2, 1e-3, 1e-4):
        run = simulate(scene, scene.parameters(restitution=1.0 - left), times, accuracy=1e-8)
        gaps.append(np.max(np.abs(run.force["contact"] - elastic.force["contact"])))
    assert np.diff(np.log10(gaps)) == pytest.approx([-1.0, -1.0], abs=0.02)
    assert float(delivered_restitution(jnp.asarray(1.5e-4))) == pytest.approx(1 - 1e-4, abs=1e-7)


@pytest.mark.slow
def test_friction_to_0_is_no_friction():
    """In first order of the coefficient, while nothing has begun to rattle."""
    times, ramp = np.linspace(0.0, 5e-4, 51), {"load_ramp": 1e-3}
    smooth, rough = plain_joint(**LITTLE), plain_joint(**(LITTLE | {"friction": True}))
    bare = simulate(smooth, smooth.parameters(ramp), times, accuracy=1e-5)
    gaps, mus = [], np.array([1e-2, 1e-3, 1e-4])
    for mu in mus:
        params = rough.parameters({**ramp, "friction_static": mu, "friction_dynamic": 0.5 * mu})
        run = simulate(rough, params, times, accuracy=1e-5)
        assert run.status == bare.status == "ok"
        gaps.append(max(np.abs(run.force[name][..., 0] - bare.force[name][..., 0]).max() for name in GROOVES))
    assert np.diff(np.log(gaps)) / np.diff(np.log(mus)) == pytest.approx([1.0, 1.0], abs=0.05)


@pytest.mark.slow
def test_clearance_to_0_is_the_joint_without_clearance():
    """In line, T = z Rp N sin(alpha) is shared evenly; play changes that in first order, by its share of the radius."""
    scene = plain_joint(**(LITTLE | {"contacts": ("cage_ball", *GROOVES), "fidelity": "quasistatic"}))
    # So stiff that nothing but play moves the balls.
    base = scene.parameters(joint_angle=0.0, smoothing=0.0, stiffness=1e16, **{"cage_ball.stiffness": 1e16})
    ball = float(base["load_torque"]) / (3 * float(base["pitch_radius"]) * np.sin(float(base["contact_angle"])))

    @jax.jit
    @jax.vmap
    def forces(play):
        params = {**base, **{f"clearance_{contact.name}": play for contact in scene.contacts}}
        return quasistatic_forces(scene, params, jnp.array([1.0]))["seat_ball"][0]

    plays = np.array([0.0, 1e-9, 1e-8, 1e-7, 1e-6])
    found = np.asarray(forces(jnp.asarray(plays)))
    assert found[0] == within(np.full(3, ball), 1e-3)
    gaps = np.abs(found[2:] - found[0]).max(1)
    assert np.diff(np.log(gaps)) / np.diff(np.log(plays[2:])) == pytest.approx([1.0, 1.0], abs=0.1)
    assert found[1] == within(found[0], 1e-4)
