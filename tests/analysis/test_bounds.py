"""Bounds of derivatives from solves at tolerances far apart; the solves are made up, so that the truth is known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bcfj_jax.analysis.derivatives import bounds, problem
from bcfj_jax.analysis.derivatives.bounds import Budget, bounded, climb, feature_bounds
from bcfj_jax.analysis.derivatives.jacobian import Histories, Level
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.core.status import OK, STEPS
from bcfj_jax.solve.plan import Plan

TIMES = np.linspace(0.0, 1.0, 201)
TRUE = np.stack([np.sin(3.0 * TIMES), np.cos(5.0 * TIMES)])
VALUES = np.array([2.0, 0.5])
SCENE = {stiff: SimpleNamespace(traits=SimpleNamespace(stiff=stiff, history=True)) for stiff in (False, True)}


class Solved:
    """Stands for ``jacobian.level``: derivatives that are wrong by ``error(tolerance)`` of themselves, in a random way."""

    def __init__(self, error, fails_below=0.0, steps=100):
        self.error, self.fails_below, self.steps, self.asked = error, fails_below, steps, []

    def __call__(self, scene, params, times, names, how):
        tolerance = float(how.tolerance)
        self.asked.append(tolerance)
        draw = np.random.default_rng(len(self.asked)).normal(size=TRUE.shape)
        draw *= np.sqrt(np.mean(TRUE**2, axis=1) / np.mean(draw**2, axis=1))[:, None]
        slope = np.zeros((2, TIMES.size, 1, 3))
        slope[..., 0, 0] = TRUE + self.error(tolerance) * draw
        state = np.ones((2, TIMES.size, 1))
        force = np.ones((TIMES.size, 1, 3))
        code = STEPS if tolerance < self.fails_below else OK
        return Level(
            tolerance, Histories(force, None, None, None), Histories(slope, None, None, state), code, 1.0, self.steps, 0,
            1.0, 0.0, np.ones(1),
        )  # fmt: skip


def climbed(monkeypatch, solved, stiff=False, tolerance=1e-5, levels=6, budget=None, max_steps=100_000, error=0.01):
    monkeypatch.setattr(problem, "level", solved)
    monkeypatch.setattr(bounds, "plan", lambda *_: Plan(cast(Any, np.asarray(1e-5)), max_steps, True))
    how = Plan(cast(Any, np.asarray(tolerance)), max_steps)
    return climb(asked(stiff, error), how, levels, Budget(budget))


def asked(stiff=False, error=0.01):
    params = cast(Any, dict(zip("ab", VALUES, strict=True)))
    return Problem(cast(Any, SCENE[stiff]), params, TIMES, ("a", "b"), (), error, 0.0, 100_000)


@pytest.mark.parametrize(("stiff", "levels"), [(False, 3), (True, 2)])
@pytest.mark.parametrize("order", [0.4, 0.8])
def test_what_is_stated_is_the_error_and_no_less(monkeypatch, stiff, levels, order):
    found = climbed(monkeypatch, Solved(lambda tolerance: 0.01 * (tolerance / 1e-5) ** order), stiff)
    assert len(found.levels) == levels and found.last is found.levels[0] and not found.unchecked
    assert found.levels[0].tolerance / found.levels[-1].tolerance == pytest.approx(40.0 if stiff else 16.0**2)
    for one, true, slope in zip(bounded(asked(), found), TRUE, found.last.derivative.force[..., 0, 0], strict=True):
        error = np.sqrt(np.trapezoid((slope - true) ** 2, TIMES) / np.trapezoid(true**2, TIMES))
        assert error < one.pointwise.relative < 2.0 * error and not one.unbounded


def test_it_goes_on_until_it_is_good_enough(monkeypatch):
    solved = Solved(lambda tolerance: (tolerance / 1e-3) ** 0.5)
    found = climbed(monkeypatch, solved, tolerance=1e-3)
    # Of 100 % three tightenings by 16 leave 1.6 %, below 3 %; two more bound that.
    assert found.last is found.levels[3] and len(found.levels) == 6 and found.bounded
    # The first two are solved side by side.
    assert sorted(solved.asked, reverse=True) == pytest.approx([1e-3 * 16.0**-k for k in range(6)])


def test_what_does_not_converge_cannot_be_bounded(monkeypatch):
    found = climbed(monkeypatch, Solved(lambda tolerance: 0.05))
    assert all(one.unbounded and one.pointwise.relative > 0.05 for one in bounded(asked(), found))


def test_a_bound_that_is_missing_is_named(monkeypatch):
    def right(tolerance):
        return 1e-3 * tolerance / 1e-5

    assert "the budget of 0 s was spent" in climbed(monkeypatch, Solved(right), budget=0.0).unchecked
    assert "no tightening was left" in climbed(monkeypatch, Solved(right), levels=1).unchecked
    assert "more than 150 steps" in climbed(monkeypatch, Solved(right), max_steps=150).unchecked
    failed = climbed(monkeypatch, Solved(right, fails_below=1e-7))
    assert "it failed" in failed.unchecked and failed.last is failed.levels[0]
    # Two solves, or one, are not called bounded.
    assert not failed.bounded and failed.beside == (failed.levels[1], failed.levels[1])
    alone = climbed(monkeypatch, Solved(right, fails_below=5e-6))
    assert alone.beside is None and alone.last.good
    assert all(np.isinf(one.average.relative) for one in bounded(asked(), alone))


def test_tolerances_end_above_rounding(monkeypatch):
    solved = Solved(lambda tolerance: tolerance)
    climbed(monkeypatch, solved, tolerance=5e-13)
    assert solved.asked[-1] == pytest.approx(1e-14) and len(solved.asked) == 3


def test_a_feature_is_bounded_likewise():
    reported, between, tight = (np.array([[x]]) for x in (1.03, 1.002, 1.0))
    found = feature_bounds([reported, between, tight], np.array([1.0]), np.array([1.0]))
    assert 0.03 < found[0, 0] < 0.04
