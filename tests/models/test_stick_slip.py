"""A recorded bit torque on a drill string, against SciPy's run of the same string with friction at the bit."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "stick_slip.py"


@pytest.mark.slow
def test_a_recorded_torque_gives_the_recorded_motion():
    spec = importlib.util.spec_from_file_location("stick_slip", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    run, right, found = example.compared(6.0)
    assert run.status == "ok"
    # It sticks, and slips at more than twice the top's speed.
    speed = right["lump_3.speed"]
    assert 0.05 < np.mean(speed == 0.0) < 0.9 and speed.max() > 2.0 * example.GIVEN["drive_speed"]
    # Where the bit stops, its torque falls by 3 kN m within a millisecond of the record: 1.5 N m s or 0.13 % of the speed's range
    # each time, which the drive damps slowly. Noise of 15 N m adds 0.05 %.
    assert max(largest for largest, _ in found.values()) < 1e-2 and max(rms for _, rms in found.values()) < 5e-3
    # Every joint's contacts are there under the torque that passes.
    assert run.force["seat_ball"].shape == (6001, 18, 3) and np.all(np.isfinite(run.force["seat_ball"]))
