"""How a design is sought and what its optimum is asked: the options of ``design``, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict

import numpy as np

from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.quantities import Quantity, number, real, scalar, whole
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import MAX_STEPS

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
        for name, value, known in (("sense", self.sense, SENSES), ("distribution", self.distribution, SIGMAS)):
            if not isinstance(value, str) or value not in known:
                raise InputError(name, f"no {name} {quoted(value)}", nearest(value, known))
        for q in np.ravel(real("norms", "norms", [] if self.norms is None else self.norms)):
            number("norms", _NORM, q)
        most: dict[str, Any] = {"samples": limits.RUNS, "iterations": limits.RUNS, "starts": limits.STARTS}
        counts = {name: whole(name, getattr(self, name), most=limit) for name, limit in most.items()}
        kappa, seed = scalar("kappa", _KAPPA, self.kappa), whole("seed", self.seed, least=0)
        return replace(self, kappa=kappa, seed=seed, **counts)
