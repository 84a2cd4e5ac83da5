"""The Jacobian of a model whose forces come in spikes: its mean over where the estimate may lie.

An arrival that shifts by more than its spike is long moves the forces by less than the Jacobian at one point says. The mean over
the estimate's normal distribution is the slope of the best straight line through it (Stein 1981, Annals of Statistics 9,
lemma 1). One Gauss-Newton step with it leads on from any of the cost's little minima (Le Cam's one-step estimator; van der Vaart,
Asymptotic Statistics, 5.7).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.search.descent import Evaluate
from calibration.search.refinement import End


def averaged(evaluate: Evaluate, best: End, covariance: np.ndarray, rotations: int = 1) -> End:
    """An optimum with the mean of its Jacobian over N(point, covariance).

    By the cubature rule of degree 3 (Arasaratnam and Haykin 2009): 2 P points, sqrt(P) deviations off along the principal
    axes, and along random orthonormal ones of the whitened coordinates for the other ``rotations``. Points beyond the box are
    taken at its wall; pairs that fail are left out.
    """
    sizes, axes = np.linalg.eigh(covariance)
    count, random = best.point.size, np.random.default_rng(0)
    turned = [np.linalg.qr(random.standard_normal((count, count)))[0] for _ in range(rotations - 1)]
    steps = np.concatenate([np.eye(count), *turned]) @ (np.sqrt(count * np.maximum(sizes, 0.0))[:, None] * axes.T)
    points = np.clip(np.concatenate([best.point + steps, best.point - steps]), 0.0, 1.0)
    _, jacobians = evaluate(points)
    pairs = jacobians.reshape(2, len(steps), *jacobians.shape[1:]).mean(axis=0)
    sound = np.isfinite(pairs).all(axis=(1, 2))
    return replace(best, jacobian=pairs[sound].mean(axis=0)) if sound.any() else best


def stepped(evaluate: Evaluate, best: End) -> End:
    """An averaged optimum, one Gauss-Newton step on; as it was where that leads out of the box, or to no run, or so far
    that no straight line reaches: more than a deviation in every direction.
    """
    step = np.linalg.lstsq(best.jacobian, -best.residuals)[0]
    point = best.point + step
    if np.any((point <= 0.0) | (point >= 1.0)) or np.sum(np.square(best.jacobian @ step)) > step.size:
        return best
    residuals = evaluate(point[None])[0][0]
    if not np.isfinite(residuals).all():
        return best
    return replace(best, point=point, residuals=residuals, cost=float(np.sum(np.square(residuals))))
