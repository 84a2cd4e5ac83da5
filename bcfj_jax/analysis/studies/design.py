"""Where the points of a study are, the same for the same seed."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.axes import Axis
from bcfj_jax.core.extras import library


class Kind(NamedTuple):
    """A kind of design: the keys in a study file of its size ("" where its axes make it) and of what it alone has; what an
    estimator of sensitivity indices needs whole, how many of these at least, and the method ("" where there are no indices).
    """

    size: str = ""
    option: str = ""
    parts: str = "points"
    fewest: int = 0
    method: str = ""


# Fewest: of Saltelli's blocks enough for a bootstrap, of trajectories as many as Morris used (Campolongo: 10), of points
# several for each of RBD-FAST's 10 harmonics.
KINDS = {
    "grid": Kind(),
    "list": Kind(),
    "latin_hypercube": Kind("points", fewest=100, method="RBD-FAST, PAWN"),
    "sobol": Kind("points", fewest=100, method="RBD-FAST, PAWN"),
    "saltelli": Kind("samples", "second_order", "blocks", 32, "Sobol"),
    "morris": Kind("trajectories", "levels", "trajectories", 4, "Morris"),
}


def needs(name: str) -> Any:
    """A module of a library that studies alone need; an ``InputError`` where it is not installed."""
    return library(name, "bcfj study", "study")


@dataclass(frozen=True)
class Design:
    """A design."""

    # Of ``KINDS``: "grid" (all combinations, the last axis fastest), "list" (the axes' values side by side),
    # "latin_hypercube" or "sobol" (scrambled; SciPy's ``qmc``), "saltelli" or "morris" (SALib's).
    kind: str
    axes: tuple[Axis, ...]
    # size, seed: of those that are drawn: points, base samples or trajectories.
    size: int = 0
    seed: int = 0
    second_order: bool = False  # of "saltelli", whether for second-order indices too
    levels: int = 4  # of "morris"

    @property
    def length(self) -> int:
        """Points that an estimator needs together: D + 2, or 2 D + 2 for second order; a trajectory's D + 1; else 1."""
        count = len(self.axes)
        return {"saltelli": (2 * count if self.second_order else count) + 2, "morris": count + 1}.get(self.kind, 1)

    @property
    def count(self) -> int:
        """How many points that is, without making them."""
        if self.kind == "grid":
            return math.prod(axis.steps for axis in self.axes)
        return self.axes[0].steps if self.kind == "list" else self.size * self.length

    @property
    def box(self) -> dict[str, Any]:
        """SALib's statement of the problem in shares: scales are ours, so that a log axis is uniform in its logarithm."""
        names = [axis.name for axis in self.axes]
        return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}

    def points(self) -> np.ndarray:
        """The points (N, D), in SI."""
        if not KINDS[self.kind].size:
            grids = [axis.grid() for axis in self.axes]
            mesh = np.meshgrid(*grids, indexing="ij") if self.kind == "grid" else grids
            return np.stack([part.ravel() for part in mesh], axis=1)
        with warnings.catch_warnings():
            # A count that is no power of two is said in the documentation, not on the terminal.
            warnings.simplefilter("ignore")
            shares = self._drawn()
        return np.stack([axis.at(shares[:, k]) for k, axis in enumerate(self.axes)], axis=1)

    def _drawn(self) -> np.ndarray:
        """Shares (N, D); of Saltelli's (2010) cross-sampled Sobol sequence, or of Morris's (1991) trajectories."""
        from scipy.stats import qmc

        drawn = {"latin_hypercube": qmc.LatinHypercube, "sobol": qmc.Sobol}.get(self.kind)
        if drawn is not None:
            return drawn(len(self.axes), rng=np.random.default_rng(self.seed)).random(self.size)
        key = {"saltelli": "calc_second_order", "morris": "num_levels"}[self.kind]
        sample = needs(f"SALib.sample.{'sobol' if self.kind == 'saltelli' else 'morris'}").sample
        return sample(self.box, self.size, seed=self.seed, **{key: getattr(self, KINDS[self.kind].option)})

    @property
    def resolved(self) -> dict[str, Any]:
        """[design] of a study file, with every default."""
        kind = KINDS[self.kind]
        found: dict[str, Any] = {"kind": self.kind, "seed": self.seed} | ({kind.size: self.size} if kind.size else {})
        return found | ({kind.option: getattr(self, kind.option)} if kind.option else {})
