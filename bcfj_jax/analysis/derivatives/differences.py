"""Central differences of histories against derivatives, with what the differences themselves are worth.

A step changes the forces by about a share h of themselves: parameter k moves by h s_k,

    s_k = min(|p_k|, ||F||/||dF/dp_k||),    h = 0.3 e^(1/3),

e the force error of the histories, so that their noise e/h and the truncation h^2 are alike. A second step a quarter
as long is the one compared; where it agrees neither at once nor within a small noise, the longer one is run too and gives the
error of the differences, and what exceeds it and the noise is the derivative's. Where a run of the shorter step fails, the
comparison ends there; where it fails early, the difference is infinite: nothing was checked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import Comparison, compare
from bcfj_jax.analysis.derivatives.norms import Difference, norm
from bcfj_jax.xla.threads import together

Forces = Callable[[np.ndarray], np.ndarray]
_SEED = 4
# Share of the samples that a comparison needs, and what is found where there is something; own error beyond which it is none.
_LEAST, _VAGUE = 0.1, 0.5
# Noise, as a share of the derivative, within which the shorter step alone is believed: a joint's two steps are as much apart.
_CLEAR = 0.05


def scales(times: np.ndarray, values: np.ndarray, force: np.ndarray, derivative: np.ndarray) -> np.ndarray:
    """s_k (P,), in each parameter's unit; 0 for a parameter at 0, whose other side may not exist."""
    size = norm(times, force)
    slope = norm(times, derivative)
    with np.errstate(divide="ignore", over="ignore"):
        reach = np.where((slope > 0) & np.isfinite(slope), size / np.where(slope > 0, slope, 1.0), np.inf)
    return np.minimum(np.abs(values), reach)


def direction(count: int) -> np.ndarray:
    """A direction of all parameters, the same at every run: of each a random share, 1/3 to 1, of either sign.

    Not +1 or -1 each: clearance and speed that grow alike leave the time of a touch where it is, and hide a jump there.
    """
    rng = np.random.default_rng(_SEED)
    return rng.choice([-1.0, 1.0], count) * rng.uniform(1.0 / 3.0, 1.0, count)


class Beside(NamedTuple):
    """Runs that a derivative is held against.

    Attributes:
        times: (T,) [s].
        forces: values (P,) -> forces (T, M) without derivatives.
        values: where (P,).
        error: e of the forces.
        width: of the moving average [s].
    """

    times: np.ndarray
    forces: Forces
    values: np.ndarray
    error: float
    width: float


def against(runs: Beside, step: np.ndarray, derivative: np.ndarray, what: str = "", enough: float = 0.0) -> Comparison:
    """The derivative (T, M) along a direction held against central differences.

    Args:
        runs: without derivatives.
        step: the direction (P,), scaled by ``scales``.
        derivative: along it.
        what: in words.
        enough: pointwise difference of the shorter step at which the longer one is not run; nor is it within a noise of 5 %.
    """
    times, forces, values, error, width = runs
    h = 0.3 * error ** (1.0 / 3.0)

    def pair(h: float) -> tuple[np.ndarray, np.ndarray]:
        above, below = together(lambda: forces(values + h * step), lambda: forces(values - h * step))
        return above, below

    above, below = pair(0.25 * h)
    whole = len(times)
    sound = np.isfinite(above).all(axis=-1) & np.isfinite(below).all(axis=-1)
    count = whole if sound.all() else int(np.argmin(sound))
    if _LEAST * whole <= count < whole:
        # One of the two failed: what came before is compared.
        times, derivative, above, below = times[:count], derivative[:count], above[:count], below[:count]
    near = (above - below) / (0.5 * h)
    noise = error * float(np.sqrt(np.mean(np.sum(above * above, axis=-1)))) / (0.25 * h)
    found = compare(f"{what}, relative steps of {0.25 * h:.2g}", times, derivative, near, noise, width)
    found = found._replace(until=float(times[-1]) if count < whole else float("nan"))
    size = max(float(norm(times, derivative)), float(norm(times, near)), 1e-300)
    noisy = noise * float(np.sqrt(max(times[-1] - times[0], 0.0) or 1.0)) / size
    if found.pointwise.relative <= enough:
        return found
    if found.pointwise.relative <= noisy <= _CLEAR:
        nothing = Difference(0.0, 0.0, float("nan"))
        return _beyond(found, nothing, nothing, noisy)
    far = np.subtract(*pair(h))[: len(times)] / (2.0 * h)
    found = found._replace(what=f"{what}, relative steps of {h:.2g} and {0.25 * h:.2g}")
    own = compare("", times, far, near, noise, width)
    left = _beyond(found, own.pointwise, own.average, noisy)
    # Differences that disagree with each other by half check nothing, unless even that does not explain what they find.
    return left._replace(vague=bool(own.pointwise.relative + noisy > _VAGUE and left.pointwise.relative < _LEAST))


def _beyond(found: Comparison, pointwise: Difference, average: Difference, noisy: float) -> Comparison:
    """What of a comparison exceeds the differences' own error and noise."""

    def excess(d: Difference, own: Difference) -> Difference:
        # Where the longer step's run failed nothing is known of the differences' own error, and none is taken off.
        known = own.relative if np.isfinite(own.relative) else 0.0
        return d._replace(relative=max(0.0, d.relative - known - noisy) if np.isfinite(d.relative) else d.relative)

    return found._replace(pointwise=excess(found.pointwise, pointwise), average=excess(found.average, average))
