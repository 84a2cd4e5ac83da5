"""What a design may change, and how it is sought: free parameters with bounds and tolerances, the unit box that they fill,
the options of ``design``; checked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypedDict

import numpy as np

from bcfj_jax.analysis.axes import SCALES, Axis, bounded
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, nearest, one_of, quoted, texts
from bcfj_jax.core.quantities import Quantity, number, real, scalar, whole
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import MAX_STEPS


class Free(NamedTuple):
    """One free parameter. Numbers are SI; texts such as "20 um" are converted.

    Attributes:
        lower, upper: bounds of the nominal value.
        tolerance, relative: half width of what manufacture makes of it, in its unit; whether as a fraction of it instead.
        scale: "linear", or "log" for what spans decades (stiffnesses, dashpots).
    """

    lower: float | str
    upper: float | str
    tolerance: float | str = 0.0
    relative: bool = False
    scale: str = "linear"


class Space(NamedTuple):
    """The P free parameters: axes, half widths of tolerances (P,) [SI], which of these are relative, what each is."""

    axes: tuple[Axis, ...]
    tolerance: np.ndarray
    relative: np.ndarray
    quantities: tuple[Quantity, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters."""
        return tuple(axis.name for axis in self.axes)

    def _each(self, what: str, x: np.ndarray) -> np.ndarray:
        return np.stack([getattr(axis, what)(x[..., k]) for k, axis in enumerate(self.axes)], axis=-1)

    def values(self, unit: np.ndarray) -> np.ndarray:
        """SI values (..., P) at points of the unit box."""
        return self._each("at", unit)

    def unit(self, values: np.ndarray) -> np.ndarray:
        """Coordinates (..., P) of SI values; outside of 0 to 1 for what lies beyond its bounds."""
        return self._each("share", values)

    def slope(self, values: np.ndarray) -> np.ndarray:
        """d(value)/d(coordinate) (..., P)."""
        return self._each("steepness", values)

    def halves(self, values: np.ndarray) -> np.ndarray:
        """Half widths of the tolerance box about nominal values [SI], (P,)."""
        return self.tolerance * np.where(self.relative, np.abs(values), 1.0)

    def legal(self, values: np.ndarray) -> str:
        """Which value lies outside of what its parameter may be at all; "" for none."""
        pairs = zip(self.quantities, values, strict=True)
        return next((f"{q.name} must be {q.range}" for q, x in pairs if not q.valid(float(x))), "")

    def named(self, values: Any) -> dict[str, float]:
        """One number a parameter, by its name."""
        return dict(zip(self.names, map(float, values), strict=True))


def space(scene: AbstractModel, params: Params, free: Mapping[str, Free | Sequence[Any]]) -> Space:
    """The free parameters, checked, each a ``Free`` or its fields in order: (lower, upper), (lower, upper, tolerance), ...

    ``params``: the others' values, as a stiffness' unit depends on the exponent.
    """
    known, some = scene.quantities, f"name one or more of {', '.join(scene.quantities)}"
    if not isinstance(free, Mapping):
        raise InputError("free", quoted(free), 'give bounds by name: {"stiffness": (1e9, 1e11)}')
    if not free:
        raise InputError("free", "no parameter", some)
    texts("free", list(free), some)
    given: dict[str, Free] = {}
    for name, one in free.items():
        fits = isinstance(one, Free) or (isinstance(one, Sequence) and 2 <= len(one) <= len(Free._fields))
        if isinstance(one, str) or not fits:
            raise InputError(f"free '{name}'", quoted(one), f"give ({', '.join(Free._fields)}), the first two at least")
        fields: Any = one
        given[scene.canonical(name)] = Free(*fields)
    axes, tolerance = [], []
    for name, one in given.items():
        where = f"free '{name}'"
        if name not in known:
            raise InputError(where, f"scene '{scene.kind}' has no such parameter", nearest(name, known))
        axis: Any = Axis(name, one.lower, one.upper, one.scale)  # type: ignore[arg-type]
        axes.append(bounded(where, scene, params, axis, SCALES[:2]))
        half = Quantity("tolerance", "1" if one.relative else known[name].unit, "half width of a tolerance", 0.0)
        power = inputs.exponent(scene, name, params)
        tolerance.append(scalar(f"{where} tolerance", half, one.tolerance, power))
    relative = np.array([one.relative for one in given.values()])
    return Space(tuple(axes), np.array(tolerance), relative, tuple(known[name] for name in given))


SENSES = {"minimise": 1.0, "maximise": -1.0}
# Half widths of a tolerance box in standard deviations, by distribution.
SIGMAS = {"normal": 3.0, "uniform": np.sqrt(3.0)}
_KAPPA = Quantity("kappa", "1", "weight of the linear worst change", 0.0)
_NORM = Quantity("norms", "1", "exponent of a norm", 1.0, open_low=True)


class SearchKeys(TypedDict, total=False):
    """``Search`` as keywords."""

    features: Sequence[str]
    sense: Literal["minimise", "maximise"]
    kappa: float
    distribution: Literal["normal", "uniform"]
    samples: int
    starts: int
    norms: Sequence[float] | None
    iterations: int
    accuracy: str | float
    max_steps: int
    confirm: AbstractModel | Literal["auto"] | None
    certify: bool
    slices: bool
    seed: int
    steady: bool


@dataclass(frozen=True)
class Search:
    """Options of ``design``.

    Attributes:
        features: names that an objective that is a function reads.
        sense: whether the objective is made least or most.
        kappa: weight of the linear worst change over the tolerances in what is made least.
        distribution: of deviations, for the scatter: "normal" (three standard deviations to a half width) or "uniform".
        samples: runs for the tolerances' effect, of each kind.
        starts: how many, and how many batch the batch has.
        norms: increasing q > 1 of the norms that stand for peaks first; by default (40,) where contacts have members, none else.
        iterations: limit of L-BFGS-B, for each norm and start.
        accuracy, max_steps: as ``simulate``, of the optimiser's runs.
        confirm: the model that checks; by default the one that leaves nothing out; None for no check.
        certify: whether the gradient at the optimum gets its certificate; equilibria have none.
        slices: whether the objective along each parameter is taken, for the pictures.
        seed: of all Sobol designs.
        steady: whether the objective is of one turn of the steady motion to which a run until the last of the times comes
            (``derivatives.steady``), of a model that knows a pitch. Where the motion does not repeat itself, a design has no
            value. Its derivatives hold to two tolerances, or there is no value; no certificate is made.
    """

    features: Sequence[str] = ()
    sense: Literal["minimise", "maximise"] = "minimise"
    kappa: float = 0.0
    distribution: Literal["normal", "uniform"] = "normal"
    samples: int = 64
    starts: int = 8
    norms: Sequence[float] | None = None
    iterations: int = 60
    accuracy: str | float = "reference"
    max_steps: int = MAX_STEPS
    confirm: AbstractModel | Literal["auto"] | None = "auto"
    certify: bool = True
    slices: bool = True
    seed: int = 0
    steady: bool = False

    @property
    def sign(self) -> float:
        """1 for least, -1 for most."""
        return SENSES[self.sense]

    def checked(self) -> Search:
        """The same with plain numbers; ``InputError`` for options that are not right."""
        one_of("sense", "sense", self.sense, SENSES)
        one_of("distribution", "distribution", self.distribution, SIGMAS)
        for q in np.ravel(real("norms", "norms", [] if self.norms is None else self.norms)):
            number("norms", _NORM, q)
        most: dict[str, Any] = {"samples": limits.RUNS, "iterations": limits.RUNS, "starts": limits.STARTS}
        counts = {name: whole(name, getattr(self, name), most=limit) for name, limit in most.items()}
        kappa, seed = scalar("kappa", _KAPPA, self.kappa), whole("seed", self.seed, least=0)
        return replace(self, kappa=kappa, seed=seed, **counts)
