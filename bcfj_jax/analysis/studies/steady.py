"""Points of a study of steady motion: features of one turn that repeats itself, and their derivatives.

All points run to their ends in one batch; from there each point's orbit is found by itself (``derivatives.steady``),
whose matrix over all states leaves nothing to gain by doing several side by side (docs/studies.md).
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.analysis.derivatives.steady import steady
from bcfj_jax.analysis.studies.batch import Batch, places
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.core.programs import program
from bcfj_jax.core.status import OK, reason
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve.plan import Plan


def of_steady(study: Study, values: np.ndarray, last: np.ndarray, how: Plan, size: int) -> Batch:
    """As ``batch.run``, of steady motion; where it does not repeat itself, the reason says so.

    Args:
        study: whose points these are.
        values: (n, D) of the varied parameters; last: (n,) ends of the runs [s].
        how: of the runs to their ends; the orbit has its own tolerances.
        size: of the program.
    """
    scene, count = study.given.scene, len(last)
    params = study.params(values)
    fill = np.where(np.arange(size) < count, np.arange(size), 0)
    how = Plan(how.tolerance, how.max_steps)
    arguments = {name: leaf[fill] for name, leaf in params.items()}, last[fill], how, np.asarray(count)
    ends, compile_s = program("batch to the end", _ends, (scene,), arguments)
    states, codes, stops, steps, rounds = ends(*arguments)
    rows, reasons = np.full((count, len(study.columns)), np.nan), []
    stops, steps = stops[:count].copy(), steps[:count].copy()
    for i, end in enumerate(last):
        if codes[i] != OK:
            reasons.append(reason(int(codes[i]), how.max_steps))
            continue
        one, wrt = {name: leaf[i] for name, leaf in params.items()}, ()
        if study.derivatives:
            one, wrt = complete(scene, one, study.derivatives)
        found = steady(scene, one, states[i], float(end), wrt, study.features, how.max_steps)
        reasons.append("no steady motion: it has no pitch" if found is None else found.reason)
        if found is None or found.reason:
            continue
        steps[i], compile_s = steps[i] + found.steps, compile_s + found.compile_s
        numbers = [found.features[f.name] for f in study.features]
        rows[i] = numbers + [found.feature_derivatives[p][f.name] for f in study.features for p in wrt]
    return Batch(rows, reasons, stops, steps, int(rounds), np.zeros((count, 0, 0, 0)), compile_s)


def _ends(scene: AbstractModel, params: dict, ends: Array, how: Plan, count: Array) -> tuple:
    """State (N, n) at the end of each run, and how it ended."""
    from bcfj_jax.solve.work_queue import integrate_queue  # With diffrax, which a kept program needs not.

    grid = jnp.array([0.0, 1.0])
    found, rounds = integrate_queue(scene, params, ends, grid, how, count, min(places(), ends.size))
    return found.states[:, -1], found.code, found.end, found.accepted + found.rejected, rounds
