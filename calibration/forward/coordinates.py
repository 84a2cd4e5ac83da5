"""Coordinates of the search: what a point of the unit box stands for, and on which scale."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calibration.problem import Experiment, Problem


class Coordinate(NamedTuple):
    """One coordinate: which parameter, which experiment (None: shared), its scale, and its bounds on that.

    ``decades``: whether starts are drawn over the logarithm of a coordinate that is linear.
    """

    name: str
    experiment: int | None
    log: bool
    lower: float
    upper: float
    decades: bool = False

    def drawn(self, u: np.ndarray) -> np.ndarray:
        """Unit-box coordinates of numbers (N,) that are even over (0, 1)."""
        return np.expm1(u * np.log(self.upper / self.lower)) / (self.upper / self.lower - 1.0) if self.decades else u

    def label(self, experiments: tuple[Experiment, ...]) -> str:
        """Name in results: the experiment is added where there are several."""
        own = self.experiment is not None and len(experiments) > 1
        return f"{self.name}[{experiments[self.experiment].name}]" if own and self.experiment is not None else self.name


def coordinates_of(problem: Problem, experiments: tuple[Experiment, ...]) -> tuple[Coordinate, ...]:
    """One coordinate for each shared parameter, then one for each experiment of the others, in its own bounds."""
    coordinates = []
    for f in sorted(problem.free, key=lambda f: f.per_experiment):
        share = f.as_share
        for owner in range(len(experiments)) if f.per_experiment else [None]:
            own = (f.lower, f.upper) if owner is None else experiments[owner].bounds.get(f.name, (f.lower, f.upper))
            low, high = _reached(*(_logarithms(*own) if share else own))
            coordinates.append(Coordinate(f.name, owner, share, float(low), float(high), f.log and not share))
    return tuple(coordinates)


def _reached(low: float, high: float) -> tuple[float, float]:
    """Bounds such that the far end of the unit box, low + 1 (high - low), lies within them in spite of rounding."""
    top = high
    while low + (top - low) > high:
        top = float(np.nextafter(top, -np.inf))
    return low, top


def _logarithms(lower: float, upper: float) -> tuple[float, float]:
    """Logarithms of bounds, such that their exponentials lie within the bounds in spite of rounding."""
    low, high = np.log(lower), np.log(upper)
    while np.exp(low) < lower:
        low = np.nextafter(low, np.inf)
    while np.exp(high) > upper:
        high = np.nextafter(high, -np.inf)
    return float(low), float(high)
