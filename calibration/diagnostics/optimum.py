"""Where a fit ended: what its tests, its intervals and its diagnosis are made from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.diagnostics.fit_tests import Spread
from calibration.diagnostics.residual_tests import Series
from calibration.forward.model import Model
from calibration.noise.noise_model import Estimate
from calibration.problem import Experiment
from calibration.search.refinement import End


@dataclass(frozen=True)
class Optimum:
    """The best end of a search, on the model with the weights of the noise as it was found; white residuals by record and
    channel.
    """

    model: Model
    experiments: tuple[Experiment, ...]
    end: End
    noise: Estimate
    spread: Spread
    series: list[Series] = field(default_factory=list)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the coordinates in results."""
        return tuple(axis.label(self.experiments) for axis in self.model.coordinates)

    @property
    def samples(self) -> int:
        """Readings and features that were fitted."""
        return sum(e.samples for e in self.experiments)


def start_rows(at: Optimum, ends: tuple[End, ...]) -> list[dict[str, Any]]:
    """``starts`` of ``fit.json``."""
    begin, finish = (at.model.values(np.array(u)) for u in ([e.start for e in ends], [e.point for e in ends]))
    return [
        {
            "chi2": end.cost if not end.failure else float("nan"),
            "converged": end.converged,
            "failure": end.failure,
            "from": dict(zip(at.labels, a.tolist(), strict=True)),
            "to": dict(zip(at.labels, b.tolist(), strict=True)),
        }
        for end, a, b in zip(ends, begin, finish, strict=True)
    ]
