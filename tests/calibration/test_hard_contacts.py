"""Contacts of a thousandth of the flight: found in the record, met by the search, never told as a wrong law."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.calibration import hard_bounces
from calibration import Channel, Experiment, Free, Problem
from calibration.forward.model import build
from calibration.forward.runs import SAMPLES, contacts
from calibration.search.starts import referred

TRUTH = {"stiffness": 6.4e8, "exponent": 1.1, "damping": 0.385}


def problem(truth: dict[str, float], count: int) -> tuple[Problem, float]:
    times, force, share = hard_bounces.record(truth, count)
    known = {"mass": hard_bounces.MASS, "drop_height": hard_bounces.HEIGHT, "gravity": hard_bounces.GRAVITY}
    params = {k: float(v) for k, v in hard_bounces.SCENE.parameters({**known, **truth}).items()}
    free = (Free("stiffness", truth["stiffness"] / 2, 2 * truth["stiffness"]), Free("exponent", 1.0, 3.0))
    experiment = Experiment("drop", times, (Channel("contact.normal", force, None),))
    return Problem(hard_bounces.SCENE, params, (experiment,), free), share


@pytest.mark.slow
def test_a_contact_of_a_thousandth_of_the_flight_is_seen():
    given, share = problem(TRUTH, 3)
    assert share < 1e-3
    model = build(given, given.experiments)
    point = model.point(np.array([TRUTH["stiffness"], TRUTH["exponent"]]))
    (seen,) = contacts(model, point)
    assert seen.times.size == SAMPLES and np.all(np.diff(seen.times) > 0)
    assert len(seen.durations) == 3 and np.count_nonzero(seen.touching) > 100
    # And the reference penetration lies inside them: below the depth at which all speed is gone.
    speed = np.sqrt(2.0 * hard_bounces.GRAVITY * hard_bounces.HEIGHT)
    deepest = (hard_bounces.MASS * speed**2 * 2.1 / (2.0 * TRUTH["stiffness"])) ** (1.0 / 2.1)
    assert 0.2 * deepest < np.exp(referred(model, [point]).log_depth) < deepest


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 7])
def test_ten_hard_bounces_are_met(seed):
    """Case 7 has 5 % of noise: after the first contacts the next is uncertain by many times its duration."""
    found = hard_bounces.one(seed)
    assert found["verdict"] == "identified", found["reasons"]
    assert abs(found["force_error"]) < 0.1 and abs(found["damping_error"]) < 0.01
