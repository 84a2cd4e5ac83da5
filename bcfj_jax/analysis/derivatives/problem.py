"""What is differentiated, by what and how well: handed down as one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import Comparison, Growth, chaotic, compare, flat, growth, norm
from bcfj_jax.analysis.derivatives.jacobian import Level, level
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import Feature
from bcfj_jax.analysis.derivatives.repeating import Fold
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import MAX_STEPS, Plan


class Problem(NamedTuple):
    """A run whose histories and features are differentiated.

    Attributes:
        scene, params: the model, and its parameters with a value for every name.
        times: (T,) [s].
        names: of the parameters (P,).
        wanted: features (F,).
        error: force error that was asked for.
        width: of the moving average [s].
        max_steps: of every run.
        fold: the short run that stands for this one (``repeating``), or None.
    """

    scene: AbstractModel
    params: Params
    times: np.ndarray
    names: tuple[str, ...]
    wanted: Sequence[Feature] = ()
    error: float = 0.0
    width: float = 0.0
    max_steps: int = MAX_STEPS
    fold: Fold | None = None

    @property
    def values(self) -> np.ndarray:
        """(P,) of the parameters [SI]."""
        return np.array([float(self.params[name]) for name in self.names])

    @property
    def sizes(self) -> np.ndarray:
        """(P,) of the parameters [SI]; 1 unit of one that is 0."""
        return np.where(self.values == 0, 1.0, np.abs(self.values))

    def solve(self, how: Plan) -> Level:
        """One solve with its derivatives."""
        times = self.times if self.fold is None else self.fold.times
        found = level(self.scene, self.params, times, self.names, how)
        return found if self.fold is None else self.fold.unfolded(found)

    def measure(self, solved: Level) -> tuple[np.ndarray, np.ndarray]:
        """Features (F,) of a solve and their derivatives (F, P)."""
        scene = self.scene
        return measure(self.times, solved.value, solved.derivative, self.wanted, scene.members, scene.traits.turning)

    def named(self, values: np.ndarray) -> dict[str, float]:
        """(P,) by parameter."""
        return dict(zip(self.names, map(float, values), strict=True))

    def by_name(self, table: np.ndarray) -> dict[str, dict[str, float]]:
        """(F, P) by parameter and feature."""
        return {n: {f.name: float(table[i, k]) for i, f in enumerate(self.wanted)} for k, n in enumerate(self.names)}

    def moved(self, values: np.ndarray) -> Params:
        """The parameters, with others (P,) in the places of those that are differentiated by."""
        new: Any = {n: np.asarray(x) for n, x in zip(self.names, values, strict=True)}
        return {**self.params, **new}

    def influences(self, solved: Level) -> np.ndarray:
        """Each parameter's ||p dF/dp|| over the largest (P,)."""
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = norm(self.times, flat(solved.derivative.force)) * self.sizes
        largest = sizes.max(initial=0.0)
        return sizes / largest if largest > 0 else sizes

    def growths(self, solved: Level) -> list[Growth]:
        """Growth of the state's tangent, one a parameter."""
        return [growth(self.times, p * x) for p, x in zip(self.sizes, solved.derivative.state, strict=True)]

    def chaotic(self, solved: Level, histories: Sequence[Comparison]) -> bool:
        """Whether the derivative by one of the parameters means nothing."""
        return any(map(chaotic, self.growths(solved), histories))

    def between(self, coarse: Level, fine: Level) -> list[Comparison]:
        """Comparisons of two levels, one a parameter."""
        what = f"the same derivative at a tolerance of {coarse.tolerance:.3g} against {fine.tolerance:.3g}"
        smallest = 1e-3 * float(np.sqrt(np.mean(np.sum(fine.value.force**2, axis=(1, 2)))))
        rows = zip(self.values, flat(coarse.derivative.force), flat(fine.derivative.force), strict=True)
        return [compare(what, self.times, a, b, smallest / max(abs(p), 1e-30), self.width) for p, a, b in rows]
