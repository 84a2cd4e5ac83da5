"""Parts of a design by gradient alone: the descent of many starts, kinks, equal peaks, crests and norms."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.analysis.crests import crest
from bcfj_jax.analysis.designs.descent import descend, starts
from bcfj_jax.analysis.designs.evaluate import Values
from bcfj_jax.analysis.designs.objective import _norm
from bcfj_jax.analysis.designs.refine import minimax, refine, stationarity
from bcfj_jax.analysis.designs.result import Design
from bcfj_jax.core.dual import Dual


def quadratic(values):
    """A batch of values and slopes of a function of unit coordinates, NaN where it is."""

    def evaluate(points, norm=np.inf):
        del norm
        pairs = [values(u) for u in points]
        value = np.array([p[0] for p in pairs])
        reasons = ["" if math.isfinite(x) else "broken" for x in value]
        return Values(value, np.array([p[1] for p in pairs]), value, value, reasons)

    return evaluate


def test_descent_through_a_region_without_values():
    """f = 1 + |u - c|^2 with c = (0.3, 0.6); nothing has a value left of 0.1, where a lower f would be."""

    def values(u):
        if u[0] < 0.1:
            return math.nan, np.full(2, math.nan)
        gap = u - np.array([0.3, 0.6])
        return 1.0 + float(gap @ gap), 2.0 * gap

    evaluate = quadratic(values)
    begin = starts(evaluate, np.array([0.05, 0.9]), 6, 0)
    assert begin.shape == (6, 2)
    ways = descend(evaluate, begin, (), 50)
    assert math.isnan(ways[0].goal) and ways[0].failed == 1
    best = min(ways[1:], key=lambda way: way.goal)
    refined = refine(evaluate, best.end)
    assert refined.arrived
    np.testing.assert_allclose(refined.point, [0.3, 0.6], atol=1e-9)
    assert all(np.all(np.diff(way.best) <= 0) for way in ways[1:])


def test_a_start_goes_its_way_alone():
    def values(u):
        x, y = 4.0 * u - 2.0
        return (1 - x) ** 2 + 100 * (y - x * x) ** 2, 4.0 * np.array(
            [-2 * (1 - x) - 400 * x * (y - x * x), 200 * (y - x * x)]
        )

    begin = np.random.default_rng(0).random((5, 2))
    together, alone = descend(quadratic(values), begin, (), 200), descend(quadratic(values), begin[2:3], (), 200)
    np.testing.assert_array_equal(together[2].end, alone[0].end)
    np.testing.assert_allclose(together[2].end, [0.75, 0.75], atol=1e-4)


def test_an_interrupt_ends_all_descents():
    def evaluate(points, norm=np.inf):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        descend(evaluate, np.full((3, 2), 0.5), (), 10)


def test_a_kink_is_no_optimum_of_derivatives():
    found = refine(quadratic(lambda u: (1.0 + abs(u[0] - 0.4), np.sign(u - 0.4))), np.array([0.4 + 1e-8]))
    assert not found.arrived


@pytest.mark.full
def test_crest_and_norm():
    t = np.linspace(0.0, 1.0, 101)

    def of(p):
        values = jnp.stack([p * jnp.sin(3.0 * (t - 0.01 * p)), 0.5 * jnp.ones_like(t)], axis=1)
        return crest(t, values)

    every = jax.jit(lambda p: (of(p), jax.grad(of)(p), jax.jacfwd(jax.jacfwd(of))(p)))

    # max over t of p sin is p, wherever that is between the samples; so is its slope, and it has no bend.
    for p in (1.2, 1.3):
        value, rise, bend = map(float, every(p))
        assert value == pytest.approx(p, rel=1e-9)
        assert rise == pytest.approx(1.0, rel=1e-7)
        assert bend == pytest.approx(0.0, abs=1e-6)
    # A jump keeps its greatest sample.
    step = jnp.where(t > 0.5, 1.0 - t, 0.0)[:, None]
    assert float(crest(np.arange(len(step), dtype=float), step)) == pytest.approx(0.49)
    # ||t||_q over 0 to 1 is (q + 1)^(-1/q).
    fine = np.linspace(0.0, 1.0, 20001)
    for q in (2.0, 40.0):
        # Of p t it is p times that.
        found = _norm(fine, [Dual(fine, fine[None])], q)
        assert float(found.value) == pytest.approx((q + 1.0) ** (-1.0 / q), rel=1e-6)
        assert float(found.slope[0]) == pytest.approx(float(found.value), rel=1e-9)


class Lines:
    """An evaluator of the greatest of linear functions a.u + b: an optimum where three of them meet."""

    def __init__(self, slopes, offsets):
        self.slopes, self.offsets = np.array(slopes, float), np.array(offsets, float)

    def samples(self, unit):
        return self.slopes @ unit + self.offsets, self.slopes, self.offsets > 0


def test_the_least_of_the_greatest_of_three_planes():
    # 2 + x - 0.3, 2 - x + 0.3 + (y - 0.6), 2 - (y - 0.6): all equal, and least, at (0.3, 0.6).
    found = minimax(Lines([[1, 0], [-1, 1], [0, -1]], [1.7, 1.7, 2.6]), np.array([0.35, 0.5]), 0)
    assert found.arrived and found.equal == 3
    np.testing.assert_allclose(found.point, [0.3, 0.6], atol=1e-9)
    # With y held at most at a bound below, two of them and the wall.
    found = minimax(Lines([[1, 0], [-1, 0], [0, -1]], [1.7, 2.3, 1.0]), np.array([0.5, 0.5]), 0)
    assert found.point[0] == pytest.approx(0.3, abs=1e-9) and found.residual < 1e-9


def test_a_place_that_is_no_optimum_has_a_residual():
    planes = Lines([[1, 0], [-1, 1], [0, -1]], [1.7, 1.7, 2.6])
    assert stationarity(np.array([0.3, 0.6]), *planes.samples(np.array([0.3, 0.6]))[:2])[1] < 1e-12
    assert stationarity(np.array([0.5, 0.6]), *planes.samples(np.array([0.5, 0.6]))[:2])[1] > 0.1
    # At a bound that the slope pushes against, and at the other one.
    one = np.array([2.0]), np.array([[1.0]])
    assert stationarity(np.array([0.0]), *one)[1] < 1e-12 and stationarity(np.array([1.0]), *one)[1] > 0.1


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [(2.0, 1.0, " (-50 %)"), (-2.0, -3.0, " (-50 %)"), (-2.0, -1.0, " (+50 %)"), (0.0, 1.0, ""), (np.nan, 1.0, "")],
)
def test_a_change_is_of_the_size_before(before, after, said):
    """A force of the other sign that grows has fallen; of a design that had no value nothing is said."""
    found = Design(*[None] * len(Design._fields))._replace(before=before, after=after)
    assert found.change == said
