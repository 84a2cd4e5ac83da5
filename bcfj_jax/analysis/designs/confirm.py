"""The check: the design before and after by runs that know nothing of gradients, norms or batches.

``simulate`` at a tighter tolerance and, where there is another, by another solver. A design of equilibria is checked by
the equations of motion, which have what equilibrium leaves out: inertia, friction, damping and impacts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.designs.objective import Objective, measured
from bcfj_jax.io.outputs import channels
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.plan import LEVELS, force_error
from bcfj_jax.solve.simulation import Run, simulate
from bcfj_jax.xla.programs import program

# Share of the gain that must be seen again: with the same model, and with one that has more in it.
SAME, OTHER = 0.9, 0.5
_TIGHTEST = 1e-9


class By(NamedTuple):
    """What checks: a model, a solver, None for the model's own, and the force error."""

    model: AbstractModel
    solver: str | None
    accuracy: float


class Confirmation(NamedTuple):
    """What independent runs found.

    Attributes:
        before, after: the true objective; NaN where a run failed; features_before, features_after: what it is made of.
        gain: of the objective, positive where it became better; share: that over the optimiser's.
        confirmed: whether the share is enough, ``SAME`` or ``OTHER``.
        how: in words: fidelity, solver, accuracy; reason: why a run failed; "" for none.
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


def independent(scene: AbstractModel, model: AbstractModel | str, accuracy: str | float) -> By:
    """What checks a design: the model that leaves nothing out, or the one named, by another method, at a tenth of the
    optimiser's force error, and no more than ``reference``.
    """
    checker = scene.full() if isinstance(model, str) else model
    asked = max(min(0.1 * force_error(accuracy), LEVELS["reference"]), _TIGHTEST)
    return By(checker, "rodas3" if checker.traits.stiff else "dopri5", asked)


def confirm(
    scene: AbstractModel, by: By, designs: Sequence[tuple[Params, np.ndarray]], objective: Objective, gain: float
) -> Confirmation:
    """Run the designs before and after again, each with its times; ``scene`` was optimised, by so much ``gain``."""
    found = []
    for params, times in designs:
        # Another model may not have every parameter.
        known: Any = {name: np.asarray(x, dtype=float) for name, x in params.items() if name in by.model.quantities}
        run = simulate(by.model, known, times, accuracy=by.accuracy, solver=by.solver)
        found.append((*features(run, by.model, times, objective), run.reason if run.status != "ok" else ""))
    (before, first, why), (after, second, also) = found
    seen = objective.sign * (before - after)
    share = seen / gain if gain else np.nan
    least = SAME if by.model == scene else OTHER
    how = f"{by.model.title} by {by.solver or 'its own solver'} at a force error of {by.accuracy:.0e}"
    confirmed, said = bool(gain > 0 and share >= least), "; ".join(filter(None, (why, also)))
    return Confirmation(before, after, first, second, seen, share, confirmed, how, said)


def features(run: Run, scene: AbstractModel, times: np.ndarray, objective: Objective) -> tuple[float, dict[str, float]]:
    """The true objective of a run, and the features it is made of by name; NaN where it failed."""

    def stacked(table: Mapping[str, np.ndarray], axes: int) -> np.ndarray:
        return np.stack(list(channels(table, axes).values()), axis=1)

    arguments = stacked(run.force, 1), stacked(run.penetration, 0)
    # Designs of explicit models are compared by summits, which a crest between samples stands for here.
    between = scene.traits.history and not scene.traits.stiff
    static = times.tobytes(), objective, tuple(scene.members.items()), between
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
