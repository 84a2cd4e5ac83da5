"""From force to life: hand-computed cases, the standard's rainflow example, derivatives of wear against differences."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.analysis import life


def test_wear_by_hand():
    t = np.linspace(0.0, 2.0, 5)
    # 100 N over 2 s at 0.3 m/s, k/H = 1e-6/2e9: 60 J/2e15 Pa.
    assert float(life.archard(t, np.full(5, -100.0), 0.3, 1e-6, 2e9)) == pytest.approx(3e-14, rel=1e-14)
    depth = life.depth_map([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], [10.0] * 3, [1.0] * 3, [0.0, 1.0, 3.0], 0.01, 1e-9)
    np.testing.assert_allclose(depth, [1e-6, 5e-7], rtol=1e-14)


def test_clearance_grows_from_block_to_block():
    # V = 2e-9 m^2 c: each block of 100 runs over 1e-6 m^2 multiplies the clearance by 1.2.
    found = life.worn(lambda c: 2e-9 * c, 1e-5, 1e-6, 100.0, 3)
    np.testing.assert_allclose(found, 1e-5 * 1.2 ** np.arange(4), rtol=1e-14)


def test_static_safety_of_a_sphere_on_a_plane():
    modulus, radius, load = 113e9, 8e-3, 50.0
    pressure = bj.stiffness.elliptic_contact(modulus, radius, radius).peak_pressure(load)
    by_hand = (6.0 * load * modulus**2 / (np.pi**3 * radius**2)) ** (1.0 / 3.0)
    assert float(pressure) == pytest.approx(by_hand, rel=1e-12)
    # First yield at p0 = 1.6 Y (Johnson 1985).
    assert float(life.static_safety(1.6129, 1.0)) == pytest.approx(1.0, rel=1e-4)


def test_rolling_life_by_hand():
    # A third of the time at 2 kN, the rest at 1 kN: P^3 = (8 + 2)/3.
    t, load = np.linspace(0.0, 3.0, 30001), np.where(np.linspace(0.0, 3.0, 30001) < 1.0, 2e3, 1e3)
    assert float(life.equivalent_load(t, load)) == pytest.approx(1e3 * (10.0 / 3.0) ** (1.0 / 3.0), rel=1e-4)
    assert float(life.equivalent_load([0.0, 1.0], [-5.0, -5.0], 10 / 3)) == pytest.approx(5.0, rel=1e-14)
    assert float(life.rolling_life(2e4, 1e4)) == pytest.approx(8.0, rel=1e-14)


# ASTM E1049-85, figure 6: ranges and counts.
ASTM = (-2.0, 1.0, -3.0, 5.0, -1.0, 3.0, -4.0, 4.0, -2.0)


def test_rainflow_of_the_standard_and_its_damage():
    pytest.importorskip("fatpack", reason="fatpack is the extra life")
    # Samples between the reversals, and equal ones, change nothing.
    finer = np.interp(np.linspace(0.0, 8.0, 81), np.arange(9.0), ASTM).repeat(2)
    for series in (ASTM, finer):
        found = life.rainflow(series)
        counts = {
            float(r): float(found.count[np.isclose(found.range, r)].sum()) for r in np.unique(found.range.round(9))
        }
        assert counts == {3.0: 0.5, 4.0: 1.5, 6.0: 0.5, 8.0: 1.0, 9.0: 0.5}
    # m = 1: sum of n S over N0 S0.
    assert life.damage(found, 10.0, 100.0, 1.0) == pytest.approx((1.5 + 6.0 + 3.0 + 8.0 + 4.5) / 1000.0, rel=1e-12)
    with pytest.raises(bj.InputError, match="two finite values"):
        life.rainflow([1.0])


@pytest.mark.slow
def test_the_derivative_of_wear_agrees_with_differences():
    scene = bj.scenes.oblique_impact()
    params = scene.parameters()
    times = np.linspace(0.0, float(scene.horizon(params)), 801)
    volume = jax.jit(lambda p: life.wear_volume(scene, p, times, "contact"))
    slope = jax.jacfwd(volume)(params)
    assert float(volume(params)) > 0.0
    for name in ("stiffness", "friction_dynamic", "approach_speed"):
        step = 1e-4 * float(params[name])
        high, low = (float(volume({**params, name: params[name] + s})) for s in (step, -step))
        assert float(slope[name]) == pytest.approx((high - low) / (2.0 * step), rel=1e-3)


def test_material_data_have_sources():
    assert set(life.STEEL) == set(life.SOURCES)
    assert life.report().count("\n") == len(life.STEEL) - 1
