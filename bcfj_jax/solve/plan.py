"""How a model will be integrated: the accuracy asked for, as a tolerance, with a step budget and a solver.

Without diffrax, which is imported where something is traced (``solve.integrate``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypedDict

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.quantities import Quantity, whole
from bcfj_jax.core.upward import upward
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve import named

# Which derivatives go through a solve; values do in either.
Way = Literal["forward", "reverse"]
LEVELS = {"fast": 5e-2, "balanced": 1e-2, "reference": 1e-5}
# Attempted steps that a run may take where nothing else is asked for.
MAX_STEPS = 400_000
# The largest force error that may be asked for.
_LOOSEST = 0.5

# Steps that a run which measures the error of another takes at least.
LOOKS = 200
LONGEST = Quantity("longest_step", "s", "longest step of a solver", 0.0, open_low=True)

# Force error below which a stiff model's tangents count in the step control. In the joint a ball that carries nothing
# swings below 1 N, and tangents depend on its phase: loose steps damp the swing, and tight ones resolve it only where the
# tangents' own error is controlled. At a tolerance of 1e-4 tangents are 34 % off without, and at 2e-4 0.9 % with
# (benchmarks/models/joint_derivatives.py).
_TANGENTS_BELOW = 5e-4


class SolvingKeys(TypedDict, total=False):
    """``Solving`` as keywords."""

    accuracy: str | float
    max_steps: int


@dataclass(frozen=True)
class Solving:
    """What every verb that solves takes: accuracy and step budget, as ``plan``."""

    accuracy: str | float = "balanced"
    max_steps: int = MAX_STEPS


class Plan(eqx.Module):
    """How a model will be integrated.

    ``tolerance`` may be traced: changing it does not compile again; changing the rest does. ``tangents``: whether a stiff
    model's steps are chosen for the error of its tangents, too; an explicit one's, where it is differentiated, always end where
    contacts begin and end (``solve.landing``). ``solver``: a name of
    ``solve.named``, where the model's own is not wanted. ``extremes``: whether each contact is looked at in every step
    (``solve.extremes``); of values alone. ``longest``: of all steps [s], may be traced; a model has its own beside it.
    """

    tolerance: Array
    max_steps: int = eqx.field(static=True, default=MAX_STEPS, converter=lambda n: whole("max_steps", n))
    tangents: bool = eqx.field(static=True, default=False)
    solver: str | None = eqx.field(static=True, default=None)
    extremes: bool = eqx.field(static=True, default=False)
    longest: Any = eqx.field(default_factory=lambda: np.asarray(np.inf))


class Points(NamedTuple):
    """Runs of one model side by side: parameters, leaves (N,); each one's last time (N,) [s]; shares of it (T,), 0 to 1."""

    params: Mapping[str, Any]
    ends: Any
    grid: Any

    def one(self, i: Any) -> dict[str, Any]:
        """Parameters of one point."""
        return {name: leaf[i] for name, leaf in self.params.items()}


def plan(
    model: AbstractModel, accuracy: str | ArrayLike = "balanced", max_steps: int = MAX_STEPS, solver: str | None = None
) -> Plan:
    """Tolerance for a model and an accuracy.

    Args:
        model: what will be integrated.
        accuracy: a level (``LEVELS``) or the tolerated force error as a fraction of the peak, 1e-9 to 0.5. A traced number is
            taken as it is, and cannot choose between a stiff model's methods: it takes the one for loose steps.
        max_steps: budget of attempted steps; beyond it a run fails with that reason.
        solver: a name of ``solve.named`` in place of the model's own.

    Raises:
        InputError: for an unknown level or solver, an error out of range, a budget below 1, and where the host has
            switched JAX back to 32-bit numbers (``benchmarks/solve/precision.py`` says what they would cost).
    """
    check_bits()
    stiff = model.traits.stiff
    named.check(solver, stiff)
    if is_traced(accuracy):
        # Tolerances are in proportion to the error, up to a loosest one.
        share = jnp.asarray(accuracy) / LEVELS["balanced"]
        traced = jnp.minimum(share * model.tolerance(LEVELS["balanced"]), model.tolerance(_LOOSEST))
        return Plan(traced, max_steps, solver == "bdf", solver)
    error = force_error(accuracy)
    tangents = solver == "bdf" or (solver is None and stiff and error < _TANGENTS_BELOW)
    # An array of NumPy, which compiles nothing.
    tolerance: Any = np.asarray(model.tolerance(error), dtype=np.float64)
    return Plan(tolerance, max_steps, tangents, solver)


def check_bits() -> None:
    """Refuse 32-bit numbers, to which the host may have switched JAX back."""
    if jnp.result_type(float) != jnp.float64:
        raise InputError(
            "jax_enable_x64", "is off, so numbers would have 32 bits", "do not change it after importing bcfj_jax"
        )


def force_error(accuracy: str | ArrayLike) -> float:
    """Force error that a level, a number or a text such as "1 %" asks for, as a fraction of the peak.

    ``InputError`` for an unknown level, and for an error outside 1e-9 to 0.5.
    """
    if isinstance(accuracy, str) and not accuracy.strip()[:1].isdigit():
        if accuracy not in LEVELS:
            raise InputError("accuracy", f"no level {quoted(accuracy)}", nearest(accuracy, LEVELS))
        return LEVELS[accuracy]
    error = upward("quantity")(accuracy, "1", "accuracy") if isinstance(accuracy, str) else accuracy
    if isinstance(error, (Array, np.ndarray)) and error.ndim == 0:
        error = float(error)
    if not isinstance(error, (int, float, np.number)) or not 1e-9 <= error <= _LOOSEST:
        right = f"give {', '.join(LEVELS)}, or a fraction of the peak from 1e-9 to 0.5"
        raise InputError("accuracy", f"force_error = {quoted(accuracy)}", right)
    return float(error)
