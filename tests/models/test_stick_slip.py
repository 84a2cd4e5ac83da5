"""A recorded bit torque on a drill string, against SciPy's run of the same string with friction at the bit."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "stick_slip.py"


@pytest.mark.full
def test_a_recorded_torque_gives_the_recorded_motion():
    spec = importlib.util.spec_from_file_location("stick_slip", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    run, right, found = example.compared(6.0)
    assert run.status == "ok"
    # It sticks, and slips at more than twice the top's speed.
    speed = right["lump_3.speed"]
    assert 0.05 < np.mean(speed == 0.0) < 0.9 and speed.max() > 2.0 * example.GIVEN["drive_speed"]
    # Noise of the record, 15 of 2 600 N m, and its straight lines between milliseconds.
    assert max(largest for largest, _ in found.values()) < 5e-3 and max(rms for _, rms in found.values()) < 2e-3
    # Every joint's contacts are there under the torque that passes.
    assert run.force["seat_ball"].shape == (6001, 18, 3) and np.all(np.isfinite(run.force["seat_ball"]))
