"""Where the points of a study are, the same for the same seed.

Grids, lists, Latin hypercubes and Sobol sequences; and the designs of global sensitivity analysis, whose points come
in blocks that an estimator needs whole: Saltelli's and Morris's.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.extras import library

KINDS = ("grid", "list", "latin_hypercube", "sobol", "saltelli", "morris")
DRAWN = ("latin_hypercube", "sobol", "saltelli", "morris")
IN_BLOCKS = ("saltelli", "morris")
SCALES = ("linear", "log", "normal")
# Half of a normal scale's width, in standard deviations, and what of the distribution lies beyond either bound.
_SIGMAS = 3.0
_OUT = 0.5 * math.erfc(_SIGMAS / math.sqrt(2.0))


class Axis(NamedTuple):
    """A varied parameter: its values [SI], or its bounds, their scale, and how many values a grid takes of it.

    On the scale "normal" equal shares are equal probabilities of a normal distribution between the bounds, which are
    three standard deviations off its mean and cut it off: a tolerance.
    """

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
        if self.scale == "normal":
            from scipy.special import ndtri

            share = 0.5 + 0.5 * ndtri(_OUT + (1.0 - 2.0 * _OUT) * share) / _SIGMAS
        return self.lower + (self.upper - self.lower) * share

    def share(self, value: np.ndarray) -> np.ndarray:
        """How far values are on the way from the lower bound to the upper one: the inverse of ``at``."""
        from scipy.special import ndtr

        return self.share_by(value, np, ndtr)

    def share_by(self, value: Any, xp: Any, ndtr: Any) -> Any:
        """``share`` by another library: its arrays, and its distribution function of the standard normal."""
        if self.upper == self.lower:
            return xp.zeros_like(value)
        if self.scale == "log":
            return xp.log(value / self.lower) / np.log(self.upper / self.lower)
        share = (value - self.lower) / (self.upper - self.lower)
        if self.scale == "normal":
            return (ndtr(_SIGMAS * (2.0 * share - 1.0)) - _OUT) / (1.0 - 2.0 * _OUT)
        return share

    def steepness(self, value: np.ndarray) -> np.ndarray:
        """Derivative of values by their shares."""
        if self.scale == "log":
            return value * np.log(self.upper / self.lower)
        width = np.full_like(value, self.upper - self.lower)
        if self.scale != "normal":
            return width
        z = _SIGMAS * (2.0 * (value - self.lower) / width - 1.0)
        return width * (1.0 - 2.0 * _OUT) * np.sqrt(2.0 * np.pi) * np.exp(0.5 * z * z) / (2.0 * _SIGMAS)

    def grid(self) -> np.ndarray:
        """Its values in a grid or a list."""
        if self.values is not None:
            return np.array(self.values)
        found = self.at(np.linspace(0.0, 1.0, self.steps))
        # Powers do not give a bound back to the last bit.
        found[0], found[-1] = (self.lower, self.upper) if self.steps > 1 else (found[0], found[-1])
        return found


class Options(NamedTuple):
    """What only designs in blocks have: "saltelli" whether for second-order indices too; "morris" its levels."""

    second_order: bool = False
    levels: int = 4


DEFAULTS = Options()


def points(kind: str, axes: Sequence[Axis], count: int, seed: int, options: Options = DEFAULTS) -> np.ndarray:
    """The points (N, D) of a design, in SI.

    Args:
        kind: "grid" (all combinations, the last axis fastest), "list" (the axes' values side by side),
            "latin_hypercube" or "sobol" (scrambled; SciPy's ``qmc``), "saltelli" or "morris" (SALib's).
        axes: what is varied.
        count, seed: of those that are drawn.
        options: of the last two.
    """
    if kind == "grid":
        mesh = np.meshgrid(*(axis.grid() for axis in axes), indexing="ij")
        return np.stack([part.ravel() for part in mesh], axis=1)
    if kind == "list":
        return np.stack([axis.grid() for axis in axes], axis=1)
    from scipy.stats import qmc

    if kind == "latin_hypercube":
        shares = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count)
    elif kind in IN_BLOCKS:
        shares = _in_blocks(kind, axes, count // block_length(kind, len(axes), options), seed, options)
    else:
        with warnings.catch_warnings():
            # A count that is no power of two is said in the documentation, not on the terminal.
            warnings.simplefilter("ignore")
            shares = qmc.Sobol(len(axes), rng=np.random.default_rng(seed)).random(count)
    return np.stack([axis.at(shares[:, k]) for k, axis in enumerate(axes)], axis=1)


def block_length(kind: str, parameters: int, options: Options = DEFAULTS) -> int:
    """Points that an estimator needs together: D + 2, or 2 D + 2 for second order; a trajectory's D + 1; else 1."""
    if kind == "saltelli":
        return 2 * parameters + 2 if options.second_order else parameters + 2
    return parameters + 1 if kind == "morris" else 1


def unit_box(axes: Sequence[Axis]) -> dict[str, Any]:
    """SALib's statement of the problem in shares: scales are ours, so that a log axis is uniform in its logarithm."""
    return {"num_vars": len(axes), "names": [axis.name for axis in axes], "bounds": [[0.0, 1.0]] * len(axes)}


def _in_blocks(kind: str, axes: Sequence[Axis], blocks: int, seed: int, options: Options) -> np.ndarray:
    """Shares (N, D) of Saltelli's (2010) cross-sampled Sobol sequence, or of Morris's (1991) trajectories."""
    box = unit_box(axes)
    with warnings.catch_warnings():
        # As for the Sobol sequence.
        warnings.simplefilter("ignore")
        if kind == "saltelli":
            sample = library("SALib.sample.sobol", "bcfj study", "study").sample
            return sample(box, blocks, calc_second_order=options.second_order, seed=seed)
        return library("SALib.sample.morris", "bcfj study", "study").sample(
            box, blocks, num_levels=options.levels, seed=seed
        )


def number(kind: str, axes: Sequence[Axis], count: int) -> int:
    """How many points that is, without making them."""
    if kind == "grid":
        return math.prod(axis.steps for axis in axes)
    return axes[0].steps if kind == "list" else count
