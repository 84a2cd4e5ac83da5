"""Points of a study of steady motion: features of one turn that repeats itself, and their derivatives.

All points run to their ends in one batch; from there each point's orbit is found by itself (``derivatives.steady``),
whose matrix over all states leaves nothing to gain by doing several side by side (docs/studies.md).
"""

from __future__ import annotations

import numpy as np

from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.analysis.derivatives.steady import steady, to_the_end
from bcfj_jax.analysis.studies.batch import Batch
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.core.status import OK, reason
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
    found = to_the_end(scene, params, last, how, size)
    states, codes = found.state, found.code
    rows, reasons = np.full((count, len(study.columns)), np.nan), []
    stops, steps, rounds = found.end, found.steps.copy(), found.rounds
    for i, end in enumerate(last):
        if codes[i] != OK:
            reasons.append(reason(int(codes[i]), how.max_steps))
            continue
        one, wrt = {name: leaf[i] for name, leaf in params.items()}, ()
        if study.derivatives:
            one, wrt = complete(scene, one, study.derivatives)
        orbit = steady(scene, one, states[i], float(end), wrt, study.features, how.max_steps)
        reasons.append("its motion has no pitch" if orbit is None else orbit.reason)
        if orbit is None or orbit.reason:
            continue
        steps[i] += orbit.steps
        numbers = [orbit.features[f.name] for f in study.features]
        rows[i] = numbers + [orbit.feature_derivatives[p][f.name] for f in study.features for p in wrt]
    return Batch(rows, reasons, stops, steps, rounds, np.zeros((count, 0, 0, 0)))
