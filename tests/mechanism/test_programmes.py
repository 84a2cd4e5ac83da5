"""Amounts over time against their formulas in NumPy, and their integrals against SciPy's quadrature."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from bcfj_jax import Drive
from bcfj_jax.mechanism.programmes import SHAPES, Programme, area, looked_up, risen

TABLE = ((0.5, 1.0, 2.5, 3.0), (1.0, 3.0, -2.0, 0.5))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_rise_goes_from_0_to_1_and_its_integral_is_that_of_quadrature(shape):
    rise = SHAPES[shape]
    assert [float(rise(s)) for s in (-1.0, 0.0, 0.5, 1.0, 2.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]
    for s in (0.0, 0.3, 0.8, 1.0):
        assert float(risen(shape, s)) == pytest.approx(quad(lambda x: float(rise(x)), 0.0, s)[0], abs=1e-12)
    assert float(risen(shape, 7.0)) == float(risen(shape, 1.0))


def test_the_integral_of_a_table_is_that_of_quadrature_on_both_sides_of_it():
    for t in (-0.7, 0.0, 0.2, 0.5, 0.8, 1.7, 2.5, 3.0, 4.0):
        wanted = quad(lambda x: np.interp(x, *TABLE), 0.0, t, points=[p for p in TABLE[0] if p < t] or None)[0]
        assert float(area(jnp.asarray(t), TABLE)) == pytest.approx(wanted, abs=1e-9)
        assert float(looked_up(t, TABLE)) == pytest.approx(np.interp(t, *TABLE), abs=1e-15)


def test_an_amount_rises_fluctuates_and_reverses_as_its_formula_says():
    p = {"load.size": 5.0, "load.ramp": 0.4, "load.amplitude": 2.0, "load.frequency": 3.0}
    p |= {"load.reversal": 1.0, "load.reversal_ramp": 0.5}
    one = Programme(5.0, 0.4, "step", None, 2.0, 3.0, 1.0, 0.5)

    def step(s: float) -> float:
        s = min(max(s, 0.0), 1.0)
        return s * s * (3.0 - 2.0 * s)

    for t in (0.0, 0.1, 0.37, 0.4, 0.9, 1.1, 1.25, 1.5, 3.3):
        share = step(t / 0.4) * (1.0 - 2.0 * step((t - 1.0) / 0.5))
        assert float(one.share(t, "load", p)) == pytest.approx(share, abs=1e-12)
        wanted = share * (5.0 + 2.0 * np.sin(2.0 * np.pi * 3.0 * t))
        assert float(one(jnp.asarray(t), "load", p)) == pytest.approx(wanted, abs=1e-12)
    assert [float(k) for k in one.kinks("load", p)] == [0.4, 1.0, 1.5]
    assert {name: default for name, (_, default) in one.parameters("load", "N").items()} == p
    table = Programme(size=5.0, table=TABLE)
    assert float(table(jnp.asarray(1.4), "load", p)) == pytest.approx(5.0 * np.interp(1.4, *TABLE))
    assert float(Programme(table=TABLE)(jnp.asarray(1.4), "load", p)) == pytest.approx(np.interp(1.4, *TABLE))
    assert float(Programme(size=5.0)(jnp.asarray(0.0), "load", p)) == 5.0


@pytest.mark.parametrize("shape", SHAPES)
def test_a_rise_of_no_time_is_a_step(shape):
    p = {"load.size": 5.0, "load.ramp": 0.0, "load.reversal": 1.0, "load.reversal_ramp": 0.0}
    one = Programme(5.0, 0.0, shape, reversal=1.0, reversal_ramp=0.0)
    assert [float(one(jnp.asarray(t), "load", p)) for t in (0.0, 0.5, 1.0, 2.0)] == [5.0, 5.0, -5.0, -5.0]
    table = Programme(size=5.0, table=TABLE).parameters("load", "N")
    assert {name: default for name, (_, default) in table.items()} == {"load.size": 5.0}
    # A drive is at its speed at once; of a short rise it is half of that time behind.
    drive, p = Drive("ramp", speed=2.0, over=0.0, shape=shape), {"b.drive_speed": 2.0, "b.drive_ramp": 0.0}
    place, *rates = drive.motion(jnp.asarray(0.3), "b", p)
    assert (float(place), *map(float, rates)) == (0.6, 2.0, 0.0)
    assert [float(x) for x in drive.motion(jnp.asarray(0.0), "b", p)] == [0.0, 2.0, 0.0]
    behind = jax.grad(lambda over: drive.position(jnp.asarray(0.3), "b", p | {"b.drive_ramp": over}))(0.0)
    assert float(behind) == -1.0
