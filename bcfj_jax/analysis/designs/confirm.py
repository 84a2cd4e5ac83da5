"""The check: the design before and after by runs that know nothing of gradients, norms or batches.

``simulate`` at a tighter tolerance and, where there is another, by another solver. A design of equilibria is checked by
the equations of motion, which have what equilibrium leaves out: inertia, friction, damping and impacts.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.designs.objective import Objective, measured
from bcfj_jax.core.programs import program
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import LEVELS, force_error
from bcfj_jax.solve.simulation import Run, simulate

# Share of the gain that must be seen again: with the same model, and with one that has more in it.
SAME, OTHER = 0.9, 0.5
_TIGHTEST = 1e-9


class Confirmation(NamedTuple):
    """What independent runs found.

    Attributes:
        before, after: the true objective; NaN where a run failed.
        features_before, features_after: what it is made of, by name.
        gain: of the objective, positive where it became better.
        share: that gain over the optimiser's.
        confirmed: whether the share is enough, ``SAME`` or ``OTHER``.
        how: in words: fidelity, solver, accuracy.
        reason: why a run failed; "" for none.
    """

    before: float
    after: float
    features_before: dict[str, float]
    features_after: dict[str, float]
    gain: float
    share: float
    confirmed: bool
    how: str
    reason: str


def independent(scene: AbstractModel) -> tuple[AbstractModel, str | None]:
    """A model and a solver to check a design of this model with: what leaves nothing out, by another method."""
    return scene.full(), "rodas3" if scene.traits.stiff else "dopri5"


def tighter(accuracy: str | float) -> float:
    """Force error of the check: a tenth of the optimiser's, and no more than ``reference``."""
    asked = force_error(accuracy)
    return max(min(0.1 * asked, LEVELS["reference"]), _TIGHTEST)


def confirm(
    scene: AbstractModel,
    checker: AbstractModel,
    solver: str | None,
    designs: tuple[Params, Params],
    times: tuple[np.ndarray, np.ndarray],
    objective: Objective,
    sign: float,
    gain: float,
    accuracy: float,
) -> Confirmation:
    """Run both designs again.

    Args:
        scene: the one that was optimised; checker: the one that checks.
        solver: of the check.
        designs: parameters before and after; times: of either.
        objective, sign: as the optimiser had them.
        gain: that the optimiser saw.
        accuracy: force error of the check.

    Raises:
        InputError: as ``simulate``.
    """
    # Another model may not have every parameter.
    known = checker.quantities
    both: list[Any] = [
        {name: np.asarray(x, dtype=float) for name, x in one.items() if name in known} for one in designs
    ]
    runs = [simulate(checker, p, t, accuracy=accuracy, solver=solver) for p, t in zip(both, times, strict=True)]
    (before, first), (after, second) = (
        features(run, checker, t, objective) for run, t in zip(runs, times, strict=True)
    )
    found = sign * (before - after)
    share = found / gain if gain else np.nan
    same = checker == scene
    least = SAME if same else OTHER
    return Confirmation(
        before, after, first, second, found, share, bool(gain > 0 and share >= least),
        f"{checker.title} by {solver or 'its own solver'} at a force error of {accuracy:.0e}",
        "; ".join(run.reason for run in runs if run.status != "ok"),
    )  # fmt: skip


def features(run: Run, scene: AbstractModel, times: np.ndarray, objective: Objective) -> tuple[float, dict[str, float]]:
    """The true objective of a run, and the features it is made of by name; NaN where it failed."""
    contacts = scene.members

    def stacked(table: Mapping[str, np.ndarray], axes: int) -> np.ndarray:
        parts = [table[name] if contacts[name] else table[name][:, None] for name in contacts]
        assert all(part.ndim == axes for part in parts)
        return np.concatenate(parts, axis=1)

    arguments = stacked(run.force, 3), stacked(run.penetration, 2)
    # Designs of explicit models are compared by summits, which a crest between samples stands for here.
    between = scene.traits.history and not scene.traits.stiff
    static = times.tobytes(), objective, tuple(contacts.items()), between
    whole, values = program("design features", _features, static, arguments)[0](*arguments)
    unknown = float("nan")
    bad = run.status != "ok"
    found = {f.name: unknown if bad else float(x) for f, x in zip(objective.features, values, strict=True)}
    return unknown if bad else float(whole), found


def _features(
    grid: bytes, objective: Objective, contacts: tuple[tuple[str, int], ...], between: bool, force: Array, depth: Array
) -> tuple[Array, list[Array]]:
    norm, found = jnp.asarray(jnp.inf) if between else None, Histories(force, depth, None, None)
    values = measured(np.frombuffer(grid), found, objective, dict(contacts), norm)
    return objective.of(values), values
