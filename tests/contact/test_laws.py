"""Contact laws: what each delivers to a mass, its derivatives and its losses."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_numpy import by_numpy
from hypothesis import example, given
from hypothesis import strategies as st
from oracles import agrees, strike, within
from scipy.integrate import quad

from bcfj_jax import laws, scenes
from bcfj_jax.contact.elastic import ELASTIC, bai_zhao_stiffness
from bcfj_jax.contact.normal import KelvinVoigt
from bcfj_jax.contact.restitution import FACTORS, delivered_restitution, undamped_duration
from bcfj_jax.core.errors import InputError
from bcfj_jax.verification import oracles

# One value for every coefficient any law reads: a steel joint of this size; states as before the first touch.
COEFFICIENTS = {
    "stiffness": 3e10, "exponent": 1.5, "reference_force": 2e4, "reference_penetration": 8e-5,
    "effective_modulus": 1.13e11, "contact_length": 0.01, "radius": 0.03, "radius_difference": 1e-4,
    "bottoming_stiffness": 2e9, "bottoming_penetration": 5e-5, "bottoming_width": 2e-5,
    "bottoming_damping": 0.5, "dashpot": 5e4, "damping": 0.2, "restitution": 0.7, "approach_speed": 1.5,
    "damping_depth": 1e-4, "relaxation": 0.3, "relaxation_time": 1e-4, "yield_penetration": 1e-5,
    "relaxed_force": 0.0, "unloaded": 0.0,
}  # fmt: skip
UNIT = {"stiffness": 1.0, "exponent": 1.5}
PUSHING = {(law, part): laws.make(law, part) for law in laws.LAWS for part in ELASTIC}


# --- what a law delivers to one mass


@pytest.mark.parametrize("row", oracles.ADAMS_IMPACT, ids=" ".join)
def test_adams_impact(row):
    mass, speed, dashpot, *printed, exponent = row
    n = float(exponent)
    c = {"stiffness": 1e5 * 1e3**n, "exponent": n, "dashpot": 1e3 * float(dashpot), "damping_depth": 1e-4}
    assert all(map(agrees, strike(laws.make("adams_impact"), c, float(mass), float(speed)), printed))


def test_undamped_impacts():
    c = {"stiffness": 1e5 * 1e3**1.5, "exponent": 1.5, "dashpot": 0.0, "damping_depth": 1e-4}
    for law in ("adams_impact", "hertz"):
        found = strike(laws.make(law), c, 1.0, 1.5)
        assert agrees(found.penetration, "2.39683e-4") and agrees(found.peak, "11734.25")
        assert found.restitution == pytest.approx(1.0, abs=1e-9)
        assert found.duration == within(float(undamped_duration(c["stiffness"], 1.5, 1.0, 1.5)), 1e-9)


@pytest.mark.parametrize(("damping_ratio", "pushing", "pulling"), oracles.KELVIN_VOIGT)
def test_kelvin_voigt(damping_ratio, pushing, pulling):
    c = {"stiffness": 1.0, "dashpot": 2.0 * damping_ratio}
    assert agrees(strike(laws.make("kelvin_voigt"), c, 1.0, 1.0).restitution, pushing)
    if pulling:
        assert agrees(strike(KelvinVoigt(tension=True), c, 1.0, 1.0).restitution, pulling)


def test_memory_free_law():
    law = laws.make("memory_free")
    for exponent in (1.0, 1.5, 2.2):  # the same e for any exponent
        found = strike(law, {"stiffness": 1.0, "exponent": exponent, "damping": 0.8}, 1.0, 1.0)
        assert found.restitution == pytest.approx(oracles.HUNT_CROSSLEY, abs=1e-9)
    for damping, speed in ((0.2, 0.5), (0.2, 4.0), (1.0, 4.0)):  # and e falling with speed, for any mass
        found = strike(law, {"stiffness": 3e10, "exponent": 1.5, "damping": damping}, 0.4, speed)
        assert found.restitution == pytest.approx(float(delivered_restitution(damping * speed)), abs=1e-9)


def test_stop_with_a_damping_of_its_own():
    law, d = laws.make("damped_stop"), np.linspace(-1e-5, 1.5e-4, 400)[:, None]
    rate = np.array([-9.0, -1.0, 0.0, 2.0])
    alike = COEFFICIENTS | {"bottoming_damping": COEFFICIENTS["damping"]}
    plain = laws.make("memory_free", "two_stage")
    assert np.allclose(law.force(d, rate, alike), plain.force(d, rate, alike), rtol=1e-14)
    # A layer that gives way to nothing leaves the stop, met at the same speed: Hunt and Crossley's linear contact.
    alone = COEFFICIENTS | {"stiffness": 1e-9, "bottoming_width": 0.0}
    found, expected = strike(law, alone, 0.4, 1.5), float(delivered_restitution(0.5 * 1.5))
    assert found.restitution == pytest.approx(expected, abs=1e-9) and found.penetration > alone["bottoming_penetration"]


@pytest.mark.parametrize("part", ELASTIC)
def test_exact_factor_delivers_with_every_elastic_part(part):
    found = strike(laws.make("exact", part), COEFFICIENTS, 0.4, COEFFICIENTS["approach_speed"])
    assert found.restitution == pytest.approx(COEFFICIENTS["restitution"], abs=1e-9)


def test_the_family_differs_in_its_factor_only():
    d, rate, c = 3e-5, np.array([-0.6, 0.0, 0.9]), COEFFICIENTS
    for name, factor in FACTORS.items():
        expected = c["stiffness"] * d**1.5 * (1.0 + float(factor(0.7)) * rate / 1.5)
        assert np.allclose(laws.make(name).force(d, rate, c), expected, rtol=1e-14), name
    resting = laws.make("exact").force(1e-5, 1e-12, c | {"approach_speed": 0.0})
    assert np.isfinite(resting) and resting > 0.0


# --- elastic parts

DEPTHS = np.array([1e-9, 1e-6, 1e-5, 1e-4, 1e-3])


def elastic(name, depth=DEPTHS, **changed):
    return ELASTIC[name].force(depth, COEFFICIENTS | changed)


def test_elastic_formulas():
    names = ("effective_modulus", "contact_length", "radius", "radius_difference")
    e, length, radius, gap = (COEFFICIENTS[k] for k in names)
    d = DEPTHS
    expected = {
        "power": 3e10 * d**1.5,
        "linear": 3e10 * d,
        "liu": 0.5 * np.pi * e * length * d * np.sqrt(d / (2.0 * (gap + d))),
        "liu_sphere": 2.0 / 3.0 * np.pi * e * radius * d**2 / (gap + d),
    }
    for name, force in expected.items():
        assert np.allclose(elastic(name), force, rtol=1e-14, atol=0.0), name
    for n in (1.0, 1.5, 2.2):  # the two forms of the power law, K = F_ref/d_ref^n
        power = elastic("power", stiffness=2e4 / 8e-5**n, exponent=n)
        assert np.allclose(elastic("reference", exponent=n), power, rtol=1e-13)


def test_two_stages():
    depth, width = (COEFFICIENTS[k] for k in ("bottoming_penetration", "bottoming_width"))
    soft, backing = COEFFICIENTS["stiffness"], COEFFICIENTS["bottoming_stiffness"]
    force = jax.jit(functools.partial(elastic, "two_stage"))
    before, beyond = np.linspace(1e-6, depth - width, 7), np.linspace(depth + width, 3 * depth, 7)
    assert np.allclose(force(before), soft * before**1.5, rtol=1e-14)
    # Mindlin 1945: the bilinear cushion, and its sharp corner where the width is 0.
    assert np.allclose(force(beyond), soft * beyond**1.5 + backing * (beyond - depth), rtol=1e-13)
    every = np.concatenate([before, beyond])
    corner = soft * every**1.5 + backing * np.maximum(every - depth, 0.0)
    assert np.allclose(elastic("two_stage", every, bottoming_width=0.0), corner, rtol=1e-13)
    # The stored energy of the docstring, within the rounding and beyond it.
    within_it = depth + width * np.array([-0.9, -0.3, 0.4, 1.0])
    s = (within_it - depth + width) / (2 * width)
    rounded = 2 * width**2 * s**5 * (1 - s + 2 * s**2 / 7)
    straight = (beyond - depth) ** 2 / 2 + width**2 / 14
    for d, stored in zip(np.r_[within_it, beyond], np.r_[rounded, straight], strict=True):
        work = quad(lambda x: float(force(x)), 0.0, d, points=[depth - width, min(d, depth + width)], epsabs=0.0)[0]
        assert work == within(soft * d**2.5 / 2.5 + backing * stored, 1e-8)
    # Smooth where it sets in: slope and curvature are the soft law's on one side and the stiff one's on the other.
    slope = jax.jit(jax.vmap(jax.grad(force)))
    curvature = jax.jit(jax.vmap(jax.grad(jax.grad(force))))
    for edge, added in ((depth - width, 0.0), (depth + width, backing)):
        near = edge + np.array([-1.0, 1.0]) * 1e-9
        assert np.allclose(slope(near), 1.5 * soft * near**0.5 + added, atol=1e-6 * backing)
        assert np.allclose(curvature(near), 0.75 * soft / near**0.5, atol=1e-3 * backing / width)


def test_two_stages_must_not_overlap_the_surface():
    with pytest.raises(InputError, match="bottoming_width = 6e-05 is more than bottoming_penetration = 5e-05"):
        scenes.impact(elastic="two_stage").parameters(bottoming_width=6e-5, bottoming_penetration=5e-5)


def test_bai_zhao_stiffness_is_the_slope_of_liu():
    e, length = COEFFICIENTS["effective_modulus"], COEFFICIENTS["contact_length"]
    liu_slope = jax.jit(jax.grad(lambda d, gap: elastic("liu", d, radius_difference=gap)))
    tangent = jax.jit(bai_zhao_stiffness)
    for gap in (2e-5, 1e-4, 5e-4):
        slope = np.array([liu_slope(d, gap) for d in DEPTHS]) / length
        assert np.allclose(bai_zhao_stiffness(DEPTHS, e, gap), slope, rtol=1e-12, atol=0.0)
        # The energy-consistent form stores the integral of K_n, the secant (3 DR + 2 d)/(2 (DR + d)) times that.
        stored = [quad(lambda *x: float(tangent(*x)), 0.0, d, args=(e, gap), epsrel=1e-11)[0] for d in DEPTHS[2:]]
        assert np.allclose(elastic("bai_zhao", DEPTHS[2:], radius_difference=gap), length * np.array(stored), rtol=1e-9)
        ratio = elastic("bai_zhao_secant", radius_difference=gap) / elastic("bai_zhao", radius_difference=gap)
        assert np.allclose(ratio, (3.0 * gap + 2.0 * DEPTHS) / (2.0 * (gap + DEPTHS)), rtol=1e-13)
        assert np.all((ratio > 1.0) & (ratio < 1.5))
    assert elastic("bai_zhao_secant", 1e-4) / elastic("bai_zhao", 1e-4) == within(1.25, 1e-14)


@pytest.mark.parametrize(
    ("depth", "printed"),
    [(1e-4, "1.241e11 1.196e11 1.109e11 7.259e10"), (1e-5, "9.66e10 7.26e10 5.50e10 2.62e10")],
)
def test_bai_zhao_stiffness_to_the_printed_digits(depth, printed):
    gaps = np.array([2e-5, 5e-5, 1e-4, 5e-4])
    assert all(map(agrees, bai_zhao_stiffness(depth, 113.0e9, gaps), printed.split()))


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 2.5])
def test_bai_zhao_as_printed_depends_on_its_units(n):
    def printed(d, e, gap):  # the formula as it stands, in whatever units
        return np.pi / 8.0 * e * np.sqrt(2.0 * d * (3.0 * gap + 2.0 * d) ** 2 / (gap + d) ** 3) * d**n

    in_mm_n = printed(1e3 * DEPTHS, 1.13e11 * 1e-6, 0.1)
    in_m_n = printed(DEPTHS, 1.13e11, 1e-4)
    found = elastic("bai_zhao_as_printed", exponent=n)
    assert np.allclose(found, in_mm_n, rtol=1e-13)
    assert np.allclose(in_m_n / found, 10.0 ** (3.0 * (2.0 - n)), rtol=1e-12)  # no force, unless n = 2 by accident


# --- every law with every elastic part


def forces_of(held, needed_alone=False):
    """Forces of laws by name, as a function of penetrations and rates: all evaluated at once."""

    def given_to(law):
        return {k: COEFFICIENTS[k] for k in (*law.needs, *law.states)} if needed_alone else COEFFICIENTS

    return by_numpy(lambda d, rate: {key: law.force(d, rate, given_to(law)) for key, law in held.items()})


def test_apart_or_in_tension_there_is_no_force():
    d = np.array([-1e-3, -1e-30, 0.0, 1e-30, 1e-7, 1e-4, 1e-3])
    d, rate = np.meshgrid(d, [-50.0, -1.0, 0.0, 1.0, 50.0])
    found, needed = forces_of(PUSHING)(d, rate), forces_of(PUSHING, needed_alone=True)(d, rate)
    for key, law in PUSHING.items():
        force = found[key]
        assert np.all(force >= 0.0) and np.all(force[d <= 0.0] == 0.0), key
        assert np.all(force[(d >= 1e-7) & (rate >= 0.0)] > 0.0), key
        assert set(law.needs) <= set(COEFFICIENTS) and len(set(law.needs)) == len(law.needs), key
        assert np.all(np.isfinite(force)) and np.array_equal(needed[key], force), key


def test_closed_loops_lose_energy():
    """Work over one press and release, d = A (1 - cos wt)/2: never negative, and nothing without damping.

    States stand still here: what they lose is in ``test_memory``.
    """
    phase = (np.arange(400) + 0.5) * 2.0 * np.pi / 400
    depth, pulse = np.array([[1e-4], [1e-3], [1e-5]]), np.array([[1e3], [1e4], [10.0]])
    d, rate = 0.5 * depth * (1.0 - np.cos(phase)), 0.5 * depth * pulse * np.sin(phase)
    lossless = ("hertz", "walton_braun", "thornton")
    pulling = {("pulling", part): KelvinVoigt(elastic=ELASTIC[part], tension=True) for part in ELASTIC}
    for key, force in forces_of(PUSHING | pulling)(d, rate).items():
        power = force * rate
        share = np.sum(power, axis=1) / np.sum(np.abs(power), axis=1)
        assert np.all(np.abs(share) < 1e-12) if key[0] in lossless else np.all(share > 1e-9), key


# One law of every class: the factors of the family enter the derivatives below as a constant only.
CLASSES = ("hertz", "kelvin_voigt", "memory_free", "adams_impact", "exact")


@functools.cache
def derivatives(part):
    """Force and gradient of every law, forward, with gradient and Hessian of one of every class, reverse.

    By penetration, rate and exponent.
    """

    def forces(x, names):
        held = [PUSHING[name, part] for name in names]
        held.append(KelvinVoigt(elastic=ELASTIC[part], tension=True))
        return jnp.stack([law.force(x[0], x[1], COEFFICIENTS | {"exponent": x[2]}) for law in held])

    def evaluate(x):
        reverse = jax.jacrev(forces)
        hessian, gradient = jax.jacfwd(lambda y: (reverse(y, CLASSES),) * 2, has_aux=True)(x)
        return forces(x, laws.LAWS), jax.jacfwd(forces)(x, laws.LAWS), gradient, hessian

    return jax.jit(evaluate)


# Below 1e-30 m the curvature d^(n - 2) of the laws themselves runs out of floating point.
# The rest in make all-tests.
FULL = ("power", "two_stage", "bai_zhao_secant")
depths = st.floats(-1e-3, -1e-30) | st.just(0.0) | st.floats(1e-30, 1e-3)


@pytest.mark.parametrize(
    "part", [pytest.param(x, marks=pytest.mark.full if x in FULL else pytest.mark.slow) for x in ELASTIC]
)
@given(depths, st.floats(-50.0, 50.0), st.floats(1.0, 3.0))
@example(0.0, 0.0, 1.0)
@example(0.0, 0.0, 1.5)
@example(0.0, -1.0, 2.0)
@example(-1e-5, 0.0, 1.0)
@example(COEFFICIENTS["damping_depth"], -50.0, 1.5)
@example(1e-5, -1.0 / COEFFICIENTS["damping"], 1.5)
def test_derivatives_are_finite(part, depth, rate, exponent):
    value, gradient, *reverse = derivatives(part)(jnp.array([depth, rate, exponent]))
    assert all(np.all(np.isfinite(x)) for x in (value, gradient, *reverse))
    assert np.all(value[:-1] >= 0.0)
    if depth <= 0.0:
        assert not np.any(value) and not np.any(gradient[:, 1:])
    if depth < 0.0:
        assert not any(np.any(x) for x in (gradient, *reverse))


@pytest.mark.parametrize(
    ("law", "elastic", "remedy"),
    [
        ("memory_fre", None, "law: no law 'memory_fre'; did you mean 'memory_free'"),
        ("lankarani-nikravesh", None, "did you mean 'lankarani_nikravesh'"),
        ("hertz", "powr", "elastic: no elastic part 'powr'; did you mean 'power'"),
        ("q", None, "known here: adams_impact, carvalho_martins"),
        ("hertz", "q", "known here: bai_zhao, "),
    ],
)
def test_unknown_names_are_answered_with_the_nearest(law, elastic, remedy):
    with pytest.raises(InputError, match=remedy):
        laws.make(law, elastic)


def test_default_elastic_parts():
    assert laws.make().needs == ("stiffness", "exponent", "damping")
    assert laws.make("kelvin_voigt").needs == ("stiffness", "dashpot")
    assert laws.make("exact", "liu").needs[:3] == ELASTIC["liu"].needs
