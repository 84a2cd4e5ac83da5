"""Restitution and damping factors, against SciPy's DOP853, mpmath and the physics sheet (section 3)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import agrees, family, impact, within

from bcfj_jax import restitution
from bcfj_jax.verification import oracles

delivered = jax.jit(restitution.delivered_restitution)
exact = jax.jit(restitution.exact)

# The e delivered for an e asked for, every law of the family; the second column is the exact chi.
PRINTED = np.array(oracles.RESTITUTION).T
ASKED = PRINTED[0].astype(float)


@pytest.mark.parametrize("name", ["exact", *oracles.RESTITUTION_LAWS])
def test_delivered_restitution(name):
    chi = np.asarray(restitution.FACTORS[name](ASKED))
    if name == "exact":
        assert all(map(agrees, chi, PRINTED[1]))
        printed = [f"{e:.5f}" for e in ASKED]
    else:
        printed = PRINTED[2 + oracles.RESTITUTION_LAWS.index(name)]
    found = np.asarray(delivered(chi))
    assert all(map(agrees, found, printed))
    by_motion = [impact(family(x, 1.5), 1.0, 1.0).restitution for x in chi]
    # The motion is good to about 1e-11; the requirement is 1e-6.
    assert np.max(np.abs(found - by_motion)) < 1e-9


def test_every_factor_is_in_the_table():
    assert set(restitution.FACTORS) == {"exact", *oracles.RESTITUTION_LAWS}
    for name, factor in restitution.FACTORS.items():
        assert factor(1.0) == 0.0, name  # nothing lost where nothing shall be
        assert np.isfinite(factor(0.0)) and np.isfinite(jax.grad(factor)(0.0)), name
        # 3/2 of e = 1 - 2 chi/3 at the elastic end, but for the three that miss it.
        slope = {"lee_wang": 0.75, "gonthier": 2.0, "flores": 1.6, "safaeifar_farshidianfar": 1.25}.get(name, 1.5)
        assert -jax.grad(factor)(1.0) == within(slope, 1e-12), name


# --- closed forms of one impact

EXPONENTS = tuple(oracles.UNDAMPED_DURATIONS)


@pytest.mark.parametrize("chi", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("exponent", EXPONENTS)
def test_impact_closed_forms(exponent, chi):
    scene = (3e9, exponent, 0.2, 1.3)  # K, n, m, v0
    moved = impact(family(chi, exponent, 3e9, 1.3), 0.2, 1.3)
    if chi == 0.0:
        found = (restitution.undamped_penetration(*scene), restitution.undamped_peak(*scene))
        assert restitution.undamped_duration(*scene) == within(moved.duration, 1e-9)
    else:
        found = (restitution.damped_penetration(chi, *scene), restitution.damped_peak(chi, *scene))
    assert found == within((moved.penetration, moved.peak), 1e-9)
    assert delivered(chi) == pytest.approx(moved.restitution, abs=1e-9)


def test_undamped_constants():
    durations = restitution.undamped_duration(1.0, np.array(EXPONENTS), 1.0, 1.0)
    durations /= restitution.undamped_penetration(1.0, np.array(EXPONENTS), 1.0, 1.0)
    assert all(map(agrees, durations, oracles.UNDAMPED_DURATIONS.values()))
    unit = (1.0, 1.5, 1.0, 1.0)
    assert agrees(restitution.undamped_penetration(*unit), "1.0933621")
    assert agrees(restitution.undamped_peak(*unit), "1.1432626")
    assert agrees(restitution.undamped_duration(*unit), "3.2180655")


@pytest.mark.parametrize("row", oracles.DAMPED_RATIOS, ids=lambda row: row[0])
def test_damped_ratios(row):
    e, penetration, peak, rate, duration = row
    unit = (1.0, 1.5, 1.0, 1.0)
    chi = float(exact(float(e)))
    assert agrees(restitution.damped_penetration(chi, *unit) / restitution.undamped_penetration(*unit), penetration)
    strongest = restitution.damped_peak(chi, *unit)
    assert agrees(strongest / restitution.undamped_peak(*unit), peak)
    moved = impact(family(chi, 1.5), 1.0, 1.0)
    assert moved.restitution == pytest.approx(float(e), abs=1e-9)
    assert agrees(moved.duration / restitution.undamped_duration(*unit), duration)
    # F = K d^n (1 + chi u) with d^(n+1) = n m v0^2 u/(chi K) at the printed rate u: dF/F < 2 du/u there.
    u = float(rate)
    assert (1.5 * u / chi) ** 0.6 * (1 + chi * u) == within(float(strongest), 1e-5 / u)


# --- chi to e and back


def lambert(chi: float) -> float:
    """e(chi) by the Lambert function, in 50 digits."""
    with mpmath.workdps(50):
        x = mpmath.mpf(chi)
        return float((1 + mpmath.lambertw(-(1 + x) * mpmath.exp(-(1 + x))).real) / x)


@given(st.floats(1e-6, 1e4))
def test_delivered_is_the_lambert_form(chi):
    # Just above the seam the balance (*) is flat as chi^2: 1e-16 / 0.02^2.
    assert float(delivered(chi)) == pytest.approx(lambert(chi), abs=2e-12)


@given(st.floats(0.001, 1.0))
def test_round_trip(e):
    chi = exact(e)
    assert chi >= 0.0
    assert float(delivered(chi)) == pytest.approx(e, abs=1e-11)
    if chi > 1e-3:
        assert float(exact(delivered(chi))) == within(float(chi), 1e-8)


@pytest.mark.parametrize(
    ("function", "seam"), [(restitution.delivered_restitution, 0.02), (restitution.exact, 1.0 - 0.02)]
)
def test_series_meets_newton(function, seam):
    both = jax.jit(jax.vmap(jax.value_and_grad(function)))
    (left, right), slopes = both(jnp.array([seam - 1e-9, seam + 1e-9]))
    assert right - left == pytest.approx(2e-9 * float(slopes[0]), abs=5e-12)  # as flat as above
    assert slopes[1] == within(float(slopes[0]), 1e-8)


@pytest.mark.parametrize("lost", [0.0199, 0.01, 1e-3, 1e-6])
def test_series_to_rounding(lost):
    assert float(delivered(lost)) == pytest.approx(lambert(lost), abs=4e-16)
    with mpmath.workdps(50):
        e = mpmath.mpf(1.0 - lost)
        root = mpmath.findroot(lambda x: x * (1 + e) - mpmath.log((1 + x) / (1 - x * e)), 1.5 * (1 - e) * (1 + 1 - e))
    # The ninth term of chi, 0.9 (1 - e)^9, is the last left out: 1.5e-14 of chi at the seam.
    assert float(exact(1.0 - lost)) == within(float(root), 2e-14)


def test_derivative_of_the_delivered_restitution():
    slope = jax.jit(jax.vmap(jax.grad(restitution.delivered_restitution)))
    chi = np.array([0.03, 0.1, 0.3, 1.0, 3.0, 6.0])
    e = np.array([lambert(x) for x in chi])
    loss = 1.0 - chi * e  # 1e-5 at chi = 6, and 1e-16 of rounding in it: 1e-11
    formula = (1.0 + e - 1.0 / (1.0 + chi) - e / loss) * loss / (chi**2 * e)
    assert np.allclose(slope(chi), formula, rtol=1e-9, atol=0.0)
    assert slope(np.array([100.0]))[0] == within(-1e-4, 1e-12)  # e -> 1/chi
    # e = 1 - 2 chi/3 + 4 chi^2/9 - ...
    first = jax.grad(restitution.delivered_restitution)
    assert (first(0.0), jax.jit(jax.grad(first))(0.0)) == within((-2 / 3, 8 / 9), 1e-14)


def test_exact_is_the_inverse_in_its_derivative_too():
    e = np.array([0.001, 0.01, 0.1, 0.5, 0.9, 0.97, 0.985, 0.999, 1.0])
    chi = exact(e)
    there = jax.jit(jax.vmap(jax.grad(restitution.exact)))(e)
    back = jax.jit(jax.vmap(jax.grad(restitution.delivered_restitution)))(chi)
    assert np.allclose(there * back, 1.0, rtol=1e-8, atol=0.0)


def test_a_nan_in_a_batch_stays_alone():
    for function, x in ((exact, 0.1), (delivered, 2.0)):
        alone, batch = float(function(x)), function(np.array([np.nan, x]))
        assert np.isnan(batch[0]) and batch[1] == within(alone, 1e-13)
