"""What a run's summary says where its numbers look odd."""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax.analysis import features
from bcfj_jax.analysis.simulation import results
from bcfj_jax.solve.simulation import Run

TIMES = np.linspace(0.0, 1.0, 4001)


def run(depth, force):
    """A run of one contact with this history."""
    forces = np.stack([force, np.zeros_like(force), np.zeros_like(force)], axis=1)
    history = {"contact": depth}
    return Run(TIMES, {"contact": forces}, history, {"contact": np.gradient(depth, TIMES)}, {}, "ok", "", np.nan, {})


def test_a_contact_lasts_from_its_first_touch_to_its_last():
    depth = np.sin(2 * np.pi * 5 * TIMES - 0.5)
    found = features.summary(TIMES, np.maximum(depth, 0.0), depth, np.gradient(depth, TIMES))
    assert found["contact_count"] == 5
    assert found["contact_start"] == pytest.approx(0.5 / (10 * np.pi), abs=1e-4)
    assert found["contact_end"] == pytest.approx((9 * np.pi + 0.5) / (10 * np.pi), abs=1e-4)
    assert found["contact_end"] - found["contact_start"] > found["contact_fraction"]


def test_a_contact_that_lasts_has_no_end():
    depth = TIMES - 0.25
    found = features.summary(TIMES, np.maximum(depth, 0.0), depth, np.ones_like(TIMES))
    assert found["contact_start"] == pytest.approx(0.25)
    assert np.isnan(found["contact_end"])


def test_work_below_0_is_explained():
    unloaded = 1.0 - TIMES
    (said,) = results.work_warnings(run(unloaded, 100.0 * unloaded))
    assert "elastic energy that was stored" in said
    loop = np.sin(np.pi * TIMES)
    (said,) = results.work_warnings(run(loop, np.where(TIMES < 0.5, 0.9, 1.0) * loop))
    assert "raise [time] samples" in said
    assert not results.work_warnings(run(loop, np.where(TIMES < 0.5, 1.0, 0.9) * loop))
    assert not results.work_warnings(run(loop, loop))
