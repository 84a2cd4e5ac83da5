"""Response surfaces: kriging against autodiff and brute force, and the impact's peak against its closed form."""

from __future__ import annotations

import json
import os
import tomllib
from functools import lru_cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from studies import IMPACT, POWERS, peak
from typer.testing import CliRunner

import bcfj_jax as bj
from bcfj_jax.analysis.studies import surface
from bcfj_jax.analysis.studies.api import Finished
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.cli import app
from bcfj_jax.core.errors import InputError

pytest.importorskip("pyarrow", reason="the extra study is not installed")

PEAK = "contact.peak"
ALL = (0, 1, 2)


@lru_cache
def closed(points: int, seed: int = 0) -> Finished:
    """A Latin hypercube whose peaks and derivatives are those of the closed form; no run is done."""
    study = from_table(tomllib.loads(IMPACT + f'[design]\nkind = "latin_hypercube"\npoints = {points}\nseed = {seed}'))
    y = peak(study.points)
    slopes = {f"d({PEAK})/d({name})": POWERS[name] * y / study.points[:, k] for k, name in enumerate(study.names)}
    return Finished(study, study.points, {PEAK: y} | slopes, np.ones(points, bool))


@lru_cache
def fitted(points: int, derivatives: bool):
    return surface.fit(closed(points), PEAK, derivatives)


def test_covariances_with_derivatives_are_derivatives_of_the_covariance():
    rng = np.random.default_rng(1)
    a, b = jnp.asarray(rng.random((4, 3))), jnp.asarray(rng.random((5, 3)))
    length = jnp.array([0.3, 1.0, 2.5])

    def k(x, y):
        r = jnp.sqrt(jnp.sum(((x - y) / length) ** 2))
        return (1 + 5**0.5 * r + 5 / 3 * r**2) * jnp.exp(-(5**0.5) * r)

    def every(x, y):
        return k(x, y), jax.grad(k)(x, y), jax.grad(k, 1)(x, y), jax.jacfwd(jax.grad(k), 1)(x, y)

    right = np.array([2, 0])
    covariance = jax.jit(surface.covariance, static_argnums=(3, 4))
    found = covariance(a, b, length, ALL, (2, 0)).reshape(4, 4, 5, 3)
    value, left, to, both = jax.jit(jax.vmap(lambda x: jax.vmap(lambda y: every(x, y))(b)))(a)
    np.testing.assert_allclose(found[:, 0, :, 0], value, rtol=1e-12)
    np.testing.assert_allclose(found[:, 1:, :, 0].swapaxes(1, 2), left, atol=1e-12)
    np.testing.assert_allclose(found[:, 0, :, 1:], to[..., right], atol=1e-12)
    np.testing.assert_allclose(found[:, 1:, :, 1:].swapaxes(1, 2), both[..., right], atol=1e-10)
    # 5/3/l^2 is the variance of a derivative.
    own = covariance(a[:1], a[:1], length, ALL, ALL)
    np.testing.assert_allclose(own, np.diag([1.0, *(5 / 3 / np.asarray(length) ** 2)]), atol=1e-12)


@pytest.mark.full
@pytest.mark.parametrize("directions", [(), (0, 2)])
def test_leaving_a_point_out_is_solving_without_it(directions):
    rng = np.random.default_rng(2)
    each = 1 + len(directions)
    x, y = jnp.asarray(rng.random((7, 3))), rng.standard_normal((7, each))
    hyper = surface.Hyper(jnp.array([0.5, 1.0, 2.0]), jnp.asarray(1e-3), jnp.asarray(1e-2))
    whole = surface.solve(x, jnp.asarray(y.ravel()), hyper, directions)
    error, spread = surface.left_out(whole, jnp.asarray(y.ravel()), directions)
    for i in range(7):
        rest = np.arange(7) != i
        without = surface.solve(x[rest], jnp.asarray(y[rest].ravel()), hyper, directions)
        mean, variance = surface.predict(without, x[i : i + 1], directions)
        assert error[i] == pytest.approx(y[i, 0] - float(mean[0]), rel=1e-8)
        assert spread[i] == pytest.approx(float(variance[0]), rel=1e-8)


@pytest.mark.full
def test_the_surface_goes_through_the_points_and_knows_it():
    found = fitted(32, False)
    mean, deviation = found.predict(closed(32).values)
    np.testing.assert_allclose(mean, closed(32).columns[PEAK], atol=1e-3 * found.error.spread)
    assert float(jnp.max(deviation)) < 1e-2 * found.error.spread


@pytest.mark.slow
def test_errors_are_far_below_the_spread_and_derivatives_help():
    plain, enhanced = fitted(32, False), fitted(32, True)
    assert plain.directions == () and enhanced.directions == ALL
    spread = float(np.std(closed(1000, 9).columns[PEAK]))
    assert misses(plain) < 0.03 * spread and misses(enhanced) < 0.01 * spread
    assert misses(enhanced) < 0.4 * misses(plain)
    # What leave-one-out says is what there is, within a factor.
    for found in (plain, enhanced):
        assert 0.3 < found.error.rms / misses(found) < 3.0


@pytest.mark.full
@pytest.mark.parametrize("derivatives", [False, tiers.slow(True)])
def test_deviations_on_the_closed_form_are_not_too_small(derivatives):
    test, found = closed(1000, 9), fitted(32, derivatives)
    mean, deviation = found.predict(test.values)
    ratio = np.abs(np.asarray(mean) - test.columns[PEAK]) / np.asarray(deviation)
    # The peak is smoother than the kernel's functions: no fewer than of Gaussian errors, and none far out.
    assert np.mean(ratio < 1) > 0.6 and np.mean(ratio < 2) > 0.9 and ratio.max() < 15


@pytest.mark.slow
@pytest.mark.parametrize("derivatives", [False, True])
def test_deviations_cover_draws_of_the_process_as_often_as_they_say(derivatives):
    rng, ratios = np.random.default_rng(0), []
    for seed in range(4):
        train, test = closed(32, seed), closed(300, 50 + seed)
        x = jnp.asarray(np.concatenate([train.shares, test.shares]))
        matrix = np.asarray(surface.covariance(x, x, jnp.array([0.5, 1.0, 2.0]), ALL, ALL))
        draw = np.linalg.cholesky(matrix + 1e-9 * np.eye(len(matrix))) @ rng.standard_normal(len(matrix))
        draw = 7.0 + 3.0 * draw.reshape(-1, 4)
        columns = {PEAK: draw[:32, 0]}
        for k, axis in enumerate(train.study.design.axes):
            by_share = (draw[:32, 1 + k] - 7.0) / train.values[:, k] / np.log(axis.upper / axis.lower)
            columns[f"d({PEAK})/d({axis.name})"] = by_share
        mean, deviation = surface.fit(train._replace(columns=columns), PEAK, derivatives).predict(test.values)
        ratios.append(np.abs(np.asarray(mean) - draw[32:, 0]) / np.asarray(deviation))
    ratio = np.concatenate(ratios)
    assert np.mean(ratio < 1) == pytest.approx(0.68, abs=0.08)
    assert np.mean(ratio < 2) == pytest.approx(0.95, abs=0.04)


@pytest.mark.slow
def test_noise_is_found_and_counted():
    whole = closed(128)
    noisy = whole.columns[PEAK] + 20.0 * np.random.default_rng(3).standard_normal(128)
    found = surface.fit(whole._replace(columns={PEAK: noisy}), PEAK)
    noise = float(found.scale * jnp.sqrt(found.fitted.variance * found.fitted.hyper.nugget))
    assert noise == pytest.approx(20.0, rel=0.25)
    assert found.error.rms == pytest.approx(20.0, rel=0.25)


@pytest.mark.full
def test_failed_points_are_left_out_and_counted():
    whole = closed(32)
    ok, y = whole.ok.copy(), whole.columns[PEAK].copy()
    ok[[3, 17]], y[[3, 17]] = False, 1e9
    found = surface.fit(whole._replace(ok=ok, columns={PEAK: y}), PEAK)
    assert (found.error.points, found.error.dropped) == (30, 2)
    assert found.error.rms < 0.05 * found.error.spread
    with pytest.raises(InputError, match="8 usable points of 32; 9 are needed"):
        surface.fit(whole._replace(ok=np.arange(32) < 8), PEAK)


@pytest.mark.full
def test_a_surface_is_a_pytree_that_is_differentiated():
    found, at = fitted(32, True), jnp.array([3e7, 0.7, 1.0])
    slope = jax.jit(jax.grad(lambda p, s: s.predict(p)[0][0]))(at, found)
    np.testing.assert_allclose(slope * at / peak(np.asarray(at)[None]), [0.4, 0.6, 1.2], rtol=0.02)


def misses(found: surface.Surface) -> float:
    """Rms error at points of the closed form."""
    test = closed(1000, 9)
    return float(jnp.sqrt(jnp.mean((found.predict(test.values)[0] - test.columns[PEAK]) ** 2)))


@pytest.mark.slow
def test_of_a_study_that_ran(here):
    Path("study.toml").write_text(IMPACT + '[design]\nkind = "latin_hypercube"\npoints = 32')
    found = surface.fit(bj.study("study.toml", here / "out", workers=1), PEAK)
    assert misses(found) < 0.03 * found.error.spread
    done = CliRunner().invoke(app, ["study", "surface", "study.toml", "--out", "out"])
    assert done.exit_code == 0, done.output
    said = json.loads(Path("out/surface.json").read_text())[PEAK]
    assert said["derivatives"] == [] and said["leave_one_out"]["points"] == 32
    assert said["leave_one_out"]["rms"] == pytest.approx(found.error.rms, rel=1e-3)
    assert f"surface-{PEAK}.png" in os.listdir("out") and f"{found.error.rms:.3g}" in done.output
    wrong = CliRunner().invoke(app, ["study", "surface", "study.toml", "--out", "out", "--feature", "contact.peek"])
    assert wrong.exit_code == 2 and "did you mean 'contact.peak'" in wrong.stderr
    Path("out/results.parquet").unlink()
    assert CliRunner().invoke(app, ["study", "surface", "study.toml", "--out", "out"]).exit_code == 5


@pytest.mark.slow  # The derivatives' own program.
def test_of_a_study_with_derivatives(here):
    table = tomllib.loads(IMPACT + '[design]\nkind = "latin_hypercube"\npoints = 32')
    table["results"]["derivatives"] = list(POWERS)
    bj.study(table, here / "out", workers=1)
    enhanced, plain = surface.fit(here / "out", PEAK), surface.fit(here / "out", PEAK, derivatives=False)
    assert enhanced.directions == ALL and plain.directions == ()
    assert misses(enhanced) < 0.4 * misses(plain)


@pytest.mark.full
def test_derivatives_that_mean_nothing_do_little_harm():
    whole, rng = closed(32), np.random.default_rng(4)
    wild = {name: x * 10 ** rng.standard_normal(32) * rng.choice([-1, 1], 32) for name, x in whole.columns.items()}
    found = surface.fit(whole._replace(columns=wild | {PEAK: whole.columns[PEAK]}), PEAK)
    assert found.directions == ALL and found.fitted.hyper.rough > 0.1
    mean, _ = found.predict(closed(1000, 9).values)
    assert np.std(np.asarray(mean) - closed(1000, 9).columns[PEAK]) < 0.05 * found.error.spread
