"""Many starts, each by SciPy's L-BFGS-B within the unit box, all in one compiled batch.

Every start has a thread in which ``scipy.optimize.minimize`` runs by itself. What they ask for is gathered until all that
still run have asked, computed as one batch, and handed back. A start's way does not depend on those beside it.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from bcfj_jax.analysis.designs.evaluate import Values

Evaluate = Callable[..., Values]

# Optimality is asked of the objective over its size at the start: both beyond what a trust in gradients needs.
_PROJECTED, _DECREASE = 1e-9, 1e-13
# A point without a value counts as this much worse than the start, in units of the start's size.
_FAILED = 10.0
# Sobol points looked at for each start.
_SCREEN = 4


class Path(NamedTuple):
    """One start's way: unit coordinates of its beginning and of its best point, the true objective there, the one that
    points are compared by, the true one after each evaluation (of the best so far), failed ones, SciPy's last word.
    """

    start: np.ndarray
    end: np.ndarray
    value: float
    goal: float
    best: np.ndarray
    failed: int
    message: str


def starts(evaluate: Evaluate, given: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Starts (count, P), or fewer where fewer have a value: the given point, then half the best of a scrambled Sobol design,
    half spread over the rest.
    """
    inside = np.clip(given, 0.0, 1.0)[None]
    if count == 1:
        return inside
    power = int(np.ceil(np.log2(_SCREEN * count)))
    design = qmc.Sobol(given.size, rng=np.random.default_rng(seed)).random_base2(power)
    found = evaluate(design, np.inf).smooth
    order = np.argsort(found, kind="stable")[: np.isfinite(found).sum()]
    good = count // 2
    rest = order[good:]
    spread = rest[:: max(1, len(rest) // max(1, count - 1 - good))][: count - 1 - good]
    return np.concatenate([inside, design[order[:good]], design[spread]])


def descend(evaluate: Evaluate, points: np.ndarray, norms: Sequence[float], iterations: int) -> list[Path]:
    """L-BFGS-B from every point (B, P) of the unit box, first on each of the norms q, increasing, then on crests; each of
    these stages of each start has at most so many ``iterations``.
    """
    stages = (*norms, np.inf)
    tracks: list[list[tuple[float, float, np.ndarray]]] = [[] for _ in points]
    messages, at = [""] * len(points), np.array(points)
    for norm in stages:
        ends = _together(lambda u, norm=norm: evaluate(u, norm), at, tracks, iterations)
        for k, (end, message) in enumerate(ends):
            at[k], messages[k] = end, message
    return [_path(points[k], tracks[k], messages[k]) for k in range(len(points))]


def _path(start: np.ndarray, track: list, message: str) -> Path:
    goals = np.array([goal for goal, _, _ in track])
    known = np.isfinite(goals)
    if not known.any():
        return Path(start, start, np.nan, np.nan, np.full(len(track), np.nan), len(track), "no point had a value")
    k, least = int(np.nanargmin(goals)), np.where(known, goals, np.inf)
    first = [int(np.argmin(least[: i + 1])) for i in range(len(track))]
    best = np.array([track[j][1] if known[j] else np.nan for j in first])
    return Path(start, track[k][2], track[k][1], float(goals[k]), best, int((~known).sum()), message)


def _together(
    evaluate: Callable[[np.ndarray], Values], points: np.ndarray, tracks: list[list], iterations: int
) -> list[tuple[np.ndarray, str]]:
    """One stage of all starts."""
    count, inbox = len(points), queue.Queue()
    answers = [queue.Queue() for _ in points]

    def descent(k: int) -> tuple[np.ndarray, str]:
        size: list[float] = []

        def asked(u: np.ndarray) -> tuple[float, np.ndarray]:
            inbox.put((k, np.array(u)))
            got = answers[k].get()
            if got is None:
                raise InterruptedError
            value, slope = got
            if not np.isfinite(value):
                return (_FAILED if size else 0.0), np.zeros_like(u)
            if not size:
                size.extend((value, max(abs(value), 1e-300)))
            return (value - size[0]) / size[1], slope / size[1]

        try:
            found = minimize(
                asked, points[k], jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * points.shape[1],
                options={"maxiter": iterations, "ftol": _DECREASE, "gtol": _PROJECTED},
            )  # fmt: skip
            return (found.x if size else points[k]), str(found.message)
        except InterruptedError:
            return points[k], "interrupted"
        finally:
            inbox.put((k, None))

    with ThreadPoolExecutor(count) as pool:
        jobs = [pool.submit(descent, k) for k in range(count)]
        live = set(range(count))
        waiting: dict[int, np.ndarray] = {}
        try:
            while live:
                while len(waiting) < len(live):
                    k, u = inbox.get()
                    if u is None:
                        live.discard(k)
                    else:
                        waiting[k] = u
                if waiting:
                    who = sorted(waiting)
                    asked_for = [waiting[k] for k in who]
                    got = evaluate(np.stack(asked_for))
                    waiting.clear()
                    for i, k in enumerate(who):
                        tracks[k].append((float(got.goal[i]), float(got.true[i]), asked_for[i]))
                        answers[k].put((float(got.smooth[i]), got.slope[i]))
        except BaseException:
            # Whoever waits for an answer, or will, learns that there is none.
            for answer in answers:
                answer.put(None)
            raise
        return [job.result() for job in jobs]
