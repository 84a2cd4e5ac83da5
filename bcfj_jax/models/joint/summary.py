"""What ``summary.json`` says of a run of the joint as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcfj_jax.models.joint.observe import Whole


def of_the_whole(times: np.ndarray, whole: Whole) -> dict[str, Any]:
    """What ``summary.json`` says of a joint as a whole: what it transmits, its energy, Newton's law of its cage.

    Transmission is that of the last two thirds. Works [J] are trapezoidal sums over the samples, and their closure,
    |in - out - lost - change of the store| over the largest of them, is as good as these: ``energy_balance.balance`` resolves
    the motion between samples.
    """
    settled = times >= times[-1] / 3.0

    def work(power: Any, part: Any = slice(None)) -> float:
        return float(np.trapezoid(np.asarray(power)[part], times[part]))

    works = {name: work(flow) for name, flow in whole.power._asdict().items()}
    store = np.asarray(whole.stored.total)
    change = float(store[-1] - store[0])
    largest = max(map(abs, (*works.values(), change)))
    error, ratio = (np.asarray(x)[settled] for x in (whole.angle_error, whole.speed_ratio))
    given = work(whole.power.drive + whole.power.hold, settled)
    found = {
        "transmission": {
            "angle_error_min": float(error.min()),
            "angle_error_max": float(error.max()),
            "speed_ratio_min": float(ratio.min()),
            "speed_ratio_mean": float(ratio.mean()),
            "speed_ratio_max": float(ratio.max()),
            "efficiency": work(whole.power.load, settled) / given if given else float("nan"),
            "units": {"angle_error": "rad", "speed_ratio": "1", "efficiency": "1"},
        },
        "energy": {
            **works,
            "stored_change": change,
            "closure": abs(work(whole.power.net) - change) / largest if largest else float("nan"),
            "units": {"work": "J", "closure": "1"},
        },
    }
    if whole.cage_residual is not None:
        on_cage = [np.asarray(whole.resultants[name]) for name in whole.resultants if "cage" in name]
        found["cage_equilibrium"] = {
            "largest_residual": float(np.abs(whole.cage_residual).max()),
            "largest_resultant": float(np.abs(on_cage).max()) if on_cage else 0.0,
            "units": {"largest_residual": "N", "largest_resultant": "N"},
        }
    return found
