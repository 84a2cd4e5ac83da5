"""Where the points of a study are: grids, lists, Latin hypercubes and Sobol sequences, the same for the same seed."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

KINDS = ("grid", "list", "latin_hypercube", "sobol")
SCALES = ("linear", "log")


class Axis(NamedTuple):
    """A varied parameter: its values [SI], or its bounds, their scale, and how many values a grid takes of it."""

    name: str
    values: tuple[float, ...] | None
    lower: float
    upper: float
    scale: str
    steps: int

    def at(self, share: np.ndarray) -> np.ndarray:
        """Values at shares 0 to 1 of the way from the lower bound to the upper one."""
        if self.scale == "log":
            return self.lower * (self.upper / self.lower) ** share
        return self.lower + (self.upper - self.lower) * share

    def grid(self) -> np.ndarray:
        """Its values in a grid or a list."""
        if self.values is not None:
            return np.array(self.values)
        found = self.at(np.linspace(0.0, 1.0, self.steps))
        # Powers do not give a bound back to the last bit.
        found[0], found[-1] = (self.lower, self.upper) if self.steps > 1 else (found[0], found[-1])
        return found


def points(kind: str, axes: Sequence[Axis], count: int, seed: int) -> np.ndarray:
    """The points (N, D) of a design, in SI.

    Args:
        kind: "grid" (all combinations, the last axis fastest), "list" (the axes' values side by side),
            "latin_hypercube" or "sobol" (scrambled; SciPy's ``qmc``).
        axes: what is varied.
        count, seed: of the last two.
    """
    if kind == "grid":
        mesh = np.meshgrid(*(axis.grid() for axis in axes), indexing="ij")
        return np.stack([part.ravel() for part in mesh], axis=1)
    if kind == "list":
        return np.stack([axis.grid() for axis in axes], axis=1)
    from scipy.stats import qmc

    if kind == "latin_hypercube":
        shares = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count)
    else:
        with warnings.catch_warnings():
            # A count that is no power of two is said in the documentation, not on the terminal.
            warnings.simplefilter("ignore")
            shares = qmc.Sobol(len(axes), rng=np.random.default_rng(seed)).random(count)
    return np.stack([axis.at(shares[:, k]) for k, axis in enumerate(axes)], axis=1)


def number(kind: str, axes: Sequence[Axis], count: int) -> int:
    """How many points that is, without making them."""
    if kind == "grid":
        return math.prod(axis.steps for axis in axes)
    return axes[0].steps if kind == "list" else count
