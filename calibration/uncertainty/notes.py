"""What a reader must know of a fit's intervals though nothing failed, in sentences."""

from __future__ import annotations

import numpy as np

from bcfj_jax.mechanism.channels import unit_of
from calibration.diagnostics import fit_tests
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series, overstated
from calibration.forward.model import Model
from calibration.noise.noise_model import Estimate
from calibration.uncertainty.estimates import Parameter
from calibration.uncertainty.intervals import half

WIDE = "with what the law misses and runs differ by allowed for, the data do not determine"
SPANNING = "with every error that may act allowed for, not to a factor of two:"


def of_integrator(noise: Estimate) -> list[str]:
    """Of channels whose noise is the integrator's own error."""
    return [
        f"the noise of {name} is the integrator's: residuals are no larger than what its own error may be, "
        f"and count as {noise.sigma[name]:.2g} {unit_of(name)}"
        for name in noise.integrator
    ]


def wide(model: Model, parameters: dict[str, Parameter]) -> list[str]:
    """Of headlines that are wider than what is called determined, though the noise's interval is not."""
    wide = [
        name
        for axis, (name, p) in zip(model.coordinates, parameters.items(), strict=True)
        if p.intervals.get("noise") and (p.ci95 is None or half(p.ci95, axis.log) >= fit_tests.widest(axis))
    ]
    return [f"{WIDE} {' and '.join(wide)} to a factor of two"] if wide else []


def spanning(at: Optimum, parameters: dict[str, Parameter]) -> list[str]:
    """Of intervals to quote that span more than a factor of two."""
    log = {name for name, axis in zip(at.labels, at.model.coordinates, strict=True) if axis.log}
    wide = {n: p.ci95[1] / p.ci95[0] for n, p in parameters.items() if n in log and p.ci95 and p.ci95[0] > 0.0}
    wide = [f"{n} (a factor of {x:.2g} from end to end)" for n, x in wide.items() if x > fit_tests.WIDEST_FACTOR]
    return [f"{SPANNING} {' and '.join(wide)}"] if wide else []


def bent(tests: list[fit_tests.Test]) -> list[str]:
    """Of a cost that is no parabola where intervals take it for one."""
    if not tests:
        return []
    worst = max(tests, key=lambda t: abs(np.log(max(t.value, 1e-300))))
    others = f", and of {len(tests) - 1} more" if len(tests) > 1 else ""
    said = f"intervals take the cost for a parabola, but {worst.reason}{others}"
    return [f"{said}: --intervals profile walks along the cost"]


def overstated_noise(series: list[Series], residuals: np.ndarray) -> list[str]:
    """Of noise that was stated larger than residuals show."""
    worst = min((np.sqrt(np.mean(residuals[s.rows] ** 2)) for s in series if overstated(s, residuals)), default=1.0)
    said = "it was stated too large, and intervals use what residuals show"
    return [f"residuals are {worst:.2g} times the stated noise: {said}"] if worst < 1.0 else []
