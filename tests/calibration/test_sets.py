"""Averages over sets of acting errors against dense Gaussian algebra, and by simulation of linear worlds."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import tiers

from calibration.uncertainty import quote, sets
from calibration.uncertainty.sets import ACTS, QUANTILE, SCALES, Error, Linear, evaluated, mixture

COUNT, COORDINATES = 60, 3


class World:
    """A random linear fit of 60 readings, with two errors, of which the first has two columns and is stated: it always acts."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)
        self.jacobian = self.rng.standard_normal((COUNT, COORDINATES))
        self.rows = self.rng.standard_normal((2, COORDINATES))
        self.errors = [
            Error("a", "", 1.0, self.rng.standard_normal((COUNT, 2)), stated=True),
            Error("b", "", 2.0, self.rng.standard_normal((COUNT, 1)) + 0.5),
        ]

    def at(self, data: np.ndarray, floor: float = 1.0) -> Linear:
        return Linear(data, self.jacobian, self.rows, floor, COUNT - COORDINATES)


def dense(world: World, data: np.ndarray, scales: tuple[float, float], variance: float):
    """Mean, deviation, Type A and log evidence of generalised least squares with S = v 1 + A A^T, of readings less their mean.

    An error that has a sign is half normal: mean and deviation are sqrt(2/pi) and sqrt(1 - 2/pi) of the normal one's.
    """
    a, b = (e.columns * e.most / QUANTILE for e in world.errors)
    if world.errors[1].sign:
        data, b = data - scales[1] * np.sqrt(2.0 / np.pi) * b[:, 0], b * np.sqrt(1.0 - 2.0 / np.pi)
    columns = np.hstack([scales[1] * b, a])
    inverse = np.linalg.inv(variance * np.eye(COUNT) + columns @ columns.T)
    information = world.jacobian.T @ inverse @ world.jacobian
    way = world.rows @ np.linalg.solve(information, world.jacobian.T @ inverse)
    deviation = np.sqrt(np.diag(world.rows @ np.linalg.solve(information, world.rows.T)))
    left = data - world.jacobian @ np.linalg.solve(information, world.jacobian.T @ inverse @ data)
    size = left @ inverse @ left - np.linalg.slogdet(inverse)[1] + np.linalg.slogdet(information)[1]
    odds = [np.log(ACTS / (1 - ACTS)) + np.log(SCALES[s]) if s else 0.0 for s in scales]
    return way @ data, deviation, np.sqrt(variance) * np.linalg.norm(way, axis=1), -0.5 * size + sum(odds)


@pytest.mark.parametrize("sign", [0, 1])
def test_every_set_is_generalised_least_squares(sign):
    world = World(0)
    world.errors[1] = world.errors[1]._replace(sign=sign)
    data = 2.0 * world.rng.standard_normal(COUNT) + world.errors[1].columns[:, 0]
    found = mixture(world.at(data), world.errors)
    sets = list(product((0.0, *SCALES), repeat=2))
    exact = [dense(world, data, scales, found.variance) for scales in sets]
    log = np.array([e[3] for e in exact])
    weights = np.exp(log - np.logaddexp.reduce(log))
    mean = sum(w * e[0] for w, e in zip(weights, exact, strict=True))
    np.testing.assert_allclose(found.weights @ found.means, mean, rtol=1e-4, atol=1e-5)
    second = sum(w * (e[1] ** 2 + (e[0] - mean) ** 2) for w, e in zip(weights, exact, strict=True))
    np.testing.assert_allclose(found.combined()[0], np.sqrt(second), rtol=1e-4)
    noise = sum(w * e[2] ** 2 for w, e in zip(weights, exact, strict=True))
    np.testing.assert_allclose(found.combined()[1], np.sqrt(noise), rtol=1e-4)
    acting = [[scales[k] > 0.0 for scales in sets] for k in range(2)]
    np.testing.assert_allclose(found.chances, np.array(acting, float) @ weights, rtol=1e-4)


def test_what_always_acts_counts_in_the_evidence_of_a_point():
    """Points whose errors of that kind have other signatures, by dense matrices."""
    world = World(8)
    data, found, exact = world.rng.standard_normal(COUNT), [], []
    for scale in (1.0, 4.0):
        world.errors[0] = world.errors[0]._replace(columns=scale * world.errors[0].columns)
        every = evaluated(world.at(data), world.errors, 1.3)
        found.append(every.log[~every.members.any(axis=1)][0])
        exact.append(dense(world, data, (0.0, 0.0), 1.3)[3])
    assert found[1] - found[0] == pytest.approx(exact[1] - exact[0], rel=1e-9) and abs(exact[1] - exact[0]) > 0.1


def test_without_errors_it_is_the_interval_of_the_noise():
    world = World(1)
    data = world.rng.standard_normal(COUNT)
    found = mixture(world.at(data), [])
    covariance = np.linalg.inv(world.jacobian.T @ world.jacobian)
    centre = world.rows @ covariance @ world.jacobian.T @ data
    half = QUANTILE * np.sqrt(found.variance * np.diag(world.rows @ covariance @ world.rows.T))
    np.testing.assert_allclose(found.ends(), np.stack([centre - half, centre + half], axis=1), rtol=1e-6)
    assert found.combined()[2] == pytest.approx(np.zeros(2))
    # Noise that is stated is never taken for less; noise that is estimated is what is left.
    left = data - world.jacobian @ covariance @ world.jacobian.T @ data
    assert mixture(world.at(0.1 * data), []).variance == 1.0
    assert mixture(world.at(0.1 * data, floor=0.0), []).variance == pytest.approx(0.01 * left @ left / 57)


def test_an_error_that_acts_is_found_and_taken_out():
    world = World(2)
    data = (
        world.jacobian @ np.ones(COORDINATES) + 3.0 * world.errors[1].columns[:, 0] + world.rng.standard_normal(COUNT)
    )
    errors = [e._replace(stated=False) for e in world.errors]
    found = mixture(world.at(data), errors)
    assert found.chances[1] > 0.999 and found.chances[0] < found.prior[0]
    truth, ends = world.rows @ np.ones(COORDINATES), found.ends()
    assert np.all((ends[:, 0] < truth) & (truth < ends[:, 1]))
    # Known not to act, it leaves the wrong answer; the sets that are left have weights that sum to 1.
    assert found.without(0).weights.sum() == pytest.approx(1.0)


def test_a_stated_prior_narrows_and_kinds_exclude_each_other():
    world = World(3)
    data = world.rng.standard_normal(COUNT)
    hidden = Error("c", "", 1.0, world.jacobian[:, :1])
    widths = [np.diff(mixture(world.at(data), [hidden._replace(most=m)]).ends(), axis=1) for m in (2.0, 0.5, 0.05)]
    assert np.all(widths[0] > widths[1]) and np.all(widths[1] > widths[2])
    twins = [e._replace(kind="one", stated=False) for e in world.errors]
    assert not mixture(world.at(data), twins).members.all(axis=1).any()


@pytest.mark.parametrize("known", [{"columns": np.zeros((COUNT, 1))}, {"stated": True, "most": 1e-3}])
def test_what_is_known_of_one_error_makes_no_other_likelier(known):
    """Four that no residual shows, of which two act: one known not to act, or stated small, leaves one of the others or two."""
    world = World(9)
    data = world.rng.standard_normal(COUNT)
    errors = [
        Error(f"{k}", "", 1.0 + k, world.jacobian @ world.rng.standard_normal((COORDINATES, 1))) for k in range(4)
    ]
    before, after = (
        mixture(world.at(data), [first, *errors[1:]]) for first in (errors[0], errors[0]._replace(**known))
    )
    np.testing.assert_allclose(after.prior, before.prior)
    np.testing.assert_allclose(after.chances[1:], before.chances[1:], rtol=1e-6)
    assert np.all(np.diff(after.ends(), axis=1) < np.diff(before.ends(), axis=1))


def test_units_of_coordinates_and_order_of_errors_do_not_matter():
    world = World(4)
    data = world.rng.standard_normal(COUNT) + world.errors[1].columns[:, 0]
    plain = mixture(world.at(data), world.errors).ends()
    scale = np.array([1e6, 1.0, 1e-6])
    other = world.at(data)._replace(jacobian=world.jacobian * scale, rows=world.rows * scale)
    np.testing.assert_allclose(mixture(other, world.errors).ends(), plain, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(mixture(world.at(data), world.errors[::-1]).ends(), plain, rtol=1e-6, atol=1e-9)
    # An amplitude in other units is the same error.
    rescaled = [e._replace(columns=e.columns * 1e3, most=e.most * 1e-3) for e in world.errors]
    np.testing.assert_allclose(mixture(world.at(data), rescaled).ends(), plain, rtol=1e-6, atol=1e-9)


def test_what_has_a_sign_or_is_likely_is_allowed_for_accordingly():
    """An error that no residual shows: of one sign it moves one end; one that is likely to act widens more."""
    world = World(7)
    data, hidden = world.rng.standard_normal(COUNT), Error("c", "", 2.0, world.jacobian[:, :1])
    kinds = (hidden, hidden._replace(sign=1), hidden._replace(chance=0.97))
    both, one, likely = (mixture(world.at(data), [e]) for e in kinds)
    way = np.sign((world.rows @ np.linalg.pinv(world.jacobian) @ hidden.columns)[:, 0])
    for found, other in ((one, both), (both, likely)):
        assert np.all(np.diff(found.ends(), axis=1) < np.diff(other.ends(), axis=1))
    shift = way * (one.ends().mean(axis=1) - both.ends().mean(axis=1))
    assert np.all(shift < 0.0) and likely.chances[0] == pytest.approx(0.97)


def test_noise_with_a_memory_widens():
    world = World(5)
    white = world.rng.standard_normal(COUNT)
    smooth = np.convolve(white, np.ones(5) / np.sqrt(5.0), mode="same")
    series = (np.arange(COUNT),)
    plain, aware = (mixture(world.at(smooth)._replace(series=s), []).variance for s in ((), series))
    assert aware > 2.0 * plain
    assert mixture(world.at(white)._replace(series=series), []).variance == mixture(world.at(white), []).variance


@pytest.mark.parametrize("noise", tiers.ci([1.0, 3.0], 3.0))
def test_intervals_cover_worlds_with_none_one_and_two_errors(noise):
    """Twelve errors, of which few act with sizes of their own; 95 % within what 200 worlds tell."""
    rng, held = np.random.default_rng(6), []
    for k in range(200):
        jacobian = rng.standard_normal((40, 2)) + np.linspace(0.0, 1.0, 40)[:, None]
        errors = [Error(str(j), "", QUANTILE, rng.standard_normal((40, 1)) + 1.0) for j in range(12)]
        data = noise * rng.standard_normal(40)
        for j in rng.choice(12, k % 3, replace=False):
            data += errors[j].columns[:, 0] * rng.standard_normal() * rng.choice([0.1, 1.0, 2.0])
        ends = mixture(Linear(data, jacobian, np.eye(2), 0.0, 38), errors).ends()
        held.append((ends[:, 0] <= 0.0) & (ends[:, 1] >= 0.0))
    assert 0.91 < np.mean(held) < 0.995


def test_how_far_a_set_leads_does_not_depend_on_how_well_its_point_knows():
    """A move of 3 from a point is further than one of 2 from another, whatever the noise leaves there."""
    world = World(6)
    one = evaluated(world.at(world.rng.standard_normal(COUNT)), world.errors, 1.0)
    points = [
        one._replace(means=np.full_like(one.means, move), type_a=one.type_a * wide)
        for move, wide in ((2.0, 1.0), (3.0, 9.0))
    ]
    k, reach, log = sets.nearest(points, "log")
    assert not k.any() and reach == pytest.approx(np.max(2.0 / one.type_a[0])) and np.array_equal(log, one.log)


def test_quantiles_of_means_that_nothing_spreads_are_among_them():
    weights = np.array([0.9, 0.1])
    for q, wanted in ((0.025, 0.0), (0.975, 1e-9)):
        assert sets._quantile(np.array([0.0, 1e-9]), np.zeros(2), weights, q) == pytest.approx(wanted, abs=1e-12)
    assert sets._quantile(np.zeros(3), np.zeros(3), np.full(3, 1 / 3), 0.975) == pytest.approx(0.0, abs=1e-12)


def test_an_interval_to_quote_holds_its_estimate():
    """Errors that lead away from the optimum lead the value, too; where that stays the interval reaches to it."""
    known = quote.Parameter(0.066, "s/m", (0.05, 0.08), True, "")
    how = quote.Moving(("damping",), np.log([0.066]), np.eye(1), (True,), np.array([[-np.inf, np.inf]]))
    for ends, reaching in (((0.139, 0.159), (0.066, 0.159)), ((0.06, 0.07), (0.06, 0.07))):
        moves = np.log(np.array([ends]) / 0.066)
        by = quote.Quoted(how.names, moves, moves.mean(axis=1), {}, [])
        moved, stays = (quote.with_errors(known, 0, how, by, m) for m in (True, False))
        assert (*moved.ci95, moved.value, moved.least_squares) == pytest.approx((*ends, np.sqrt(np.prod(ends)), 0.066))
        assert (*stays.ci95, stays.value) == pytest.approx((*reaching, 0.066))
        # Where an error acts beyond its prior nobody knows how large errors are: the value leads, the interval holds both.
        both = quote.with_errors(known, 0, how, by._replace(beyond="b"), True)
        assert (*both.ci95, both.value) == pytest.approx((*reaching, moved.value))


@pytest.mark.parametrize(("size", "seen"), [(0.0, None), (1.0, None), (6.0, 1)])
def test_an_error_beyond_its_prior_is_seen(size, seen):
    """Its prior allows for one unit; none, one and six act."""
    world = World(4)
    errors = [e._replace(stated=False, most=1.0, columns=10.0 * e.columns) for e in world.errors]
    data = world.jacobian @ np.ones(COORDINATES) + size * errors[1].columns[:, 0] + world.rng.standard_normal(COUNT)
    assert mixture(world.at(data), errors).beyond() == seen
