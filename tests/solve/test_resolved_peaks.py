"""Peaks found in the solver's steps: closed forms, and no dependence on the times asked for."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from joints import plain_joint
from oracles import within

import bcfj_jax as bj
from bcfj_jax.analysis.simulation import results
from bcfj_jax.core.errors import InputError
from bcfj_jax.solve.extremes import crest


def test_the_crest_of_a_parabola():
    x = np.array([0.0, 0.5, 1.0])
    for place, size in ((0.3, 2.0), (0.5, 1.0), (0.7, 5.0)):
        top, at = crest(*(jnp.asarray(v) for v in 7.0 - size * (x - place) ** 2))
        assert (float(top), float(at)) == within([7.0, place], 1e-13)
    # No crest inside: the greatest of the three, where it is; and none of what is not pressed.
    assert [float(v) for v in crest(*map(jnp.asarray, (1.0, 2.0, 4.0)))] == [4.0, 1.0]
    assert [float(v) for v in crest(*map(jnp.asarray, (4.0, 2.0, 1.0)))] == [4.0, 0.0]
    assert [float(v) for v in crest(*map(jnp.asarray, (-1e-9, 0.0, -2e-9)))] == [0.0, 0.5]


@pytest.mark.parametrize("samples", tiers.ci([3, 1001], 1001))
def test_the_peak_of_an_impact_does_not_hang_on_its_samples(samples):
    # Hertz without damping: d0 = (5 m v^2 / 4 K)^(2/5), F0 = K d0^1.5, reached after half of 2.943275 d0/v.
    scene = bj.scenes.impact(law="hertz", smoothing=False)
    params = scene.parameters(stiffness=1e9, mass=1.0, approach_speed=1.0, exponent=1.5)
    deepest = (1.25 / 1e9) ** 0.4
    end = 4.0 * deepest
    run = bj.simulate(scene, params, np.linspace(0.0, end, samples), accuracy=1e-5, resolved_peaks=True)
    found = run.extremes["contact"]
    gap = float(params.get("clearance_contact", 0.0))
    assert found.peak == within(1e9 * deepest**1.5, 1e-5) and found.least == 0.0
    assert found.peak_time == within(gap + 0.5 * 2.943275 * deepest, 1e-3)
    if samples == 3:
        assert np.max(run.force["contact"][:, 0]) < 0.9 * found.peak
        content = results.summary(run, False)["contacts"]["contact"]
        assert content["peak"] == float(found.peak) > content["peak_of_samples"]


def test_resolved_peaks_are_values_by_a_solver_with_steps():
    scene = plain_joint()
    with pytest.raises(InputError, match=r"resolved_peaks.*rodas3"):
        bj.simulate(scene, scene.parameters(), [0.0, 1e-3], solver="bdf", resolved_peaks=True)
    run = bj.simulate(bj.scenes.impact(), bj.scenes.impact().parameters(), np.linspace(0.0, 1e-3, 50))
    assert run.extremes == {} and "peak_of_samples" not in results.summary(run, False)["contacts"]["contact"]


@pytest.mark.slow
def test_a_sudden_start_has_the_same_peaks_from_coarse_and_from_fine_outputs():
    scene = plain_joint(load_profile="step")
    params = scene.parameters(load_ramp=1e-4)
    coarse, fine = (
        bj.simulate(scene, params, np.linspace(0.0, 0.02, count), resolved_peaks=True) for count in (21, 4001)
    )
    for name, found in coarse.extremes.items():
        for key in ("peak", "least"):
            values = [np.max(np.abs(getattr(run.extremes[name], key))) for run in (coarse, fine)]
            assert values[0] == within(values[1], 1e-9)
        # The fine samples see them, too.
        assert np.max(found.peak) == within(float(fine.force[name][..., 0].max()), 1.5e-2)
    assert np.max(coarse.extremes["seat_cage"].peak) > 5.0 * coarse.force["seat_cage"][:, 0].max()
