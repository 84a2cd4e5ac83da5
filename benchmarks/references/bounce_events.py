"""Contacts of a bouncing mass and their derivatives, by closed forms and by SciPy's variational equations.

Shares no code with the package. The mass m falls from the height h under gravity g on the law F = K d^n (1 + a d').
With v the speed at a touch and w = sqrt(K/m):

* **closed** (n = 1, a = 0): d'' = g - w^2 d from d = 0, d' = v gives the duration T = (pi + 2 atan(g/(w v)))/w, the peak
  m g + m sqrt(g^2 + w^2 v^2) at T/2 and the impulse 2 m v + m g T; v = sqrt(2 g h) at every touch, the first at v/g, the
  others T + 2 v/g later.
* **integrated** (any n, a): flights are parabolas; a contact is DOP853 at 1e-12 up to the event d = 0, with the
  sensitivities S = d(d, d')/dp and those of the impulse beside it, on a clock that begins with the contact:
  S_d' = S_v, S_v' = -(F_d S_d + F_v S_v + F_p)/m + ..., T_p = -S_d(T)/d'(T).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

NAMES = ("stiffness", "exponent", "damping", "mass", "gravity", "drop_height")
KINDS = ("begin", "peak_time", "end", "peak", "impulse")
_TOLERANCE = 1e-12


def closed(p: dict[str, float], count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each of ``KINDS`` its values (count,) and derivatives (count, 6) by ``NAMES``; exponent 1, no damping.

    Derivatives by complex steps, exact to rounding; 0 by exponent and damping, which the closed form does not move.
    """

    def of(k: Any, m: Any, g: Any, h: Any) -> list[Any]:
        w, v = np.sqrt(k / m), np.sqrt(2.0 * g * h)
        length = (np.pi + 2.0 * np.arctan(g / (w * v))) / w
        begin = v / g + np.arange(count) * (2.0 * v / g + length)
        same = np.ones(count)
        peak, impulse = m * g + m * np.sqrt(g * g + w * w * v * v), 2.0 * m * v + m * g * length
        return [begin, begin + 0.5 * length, begin + length, same * peak, same * impulse]

    at, tiny = np.array([p[n] for n in ("stiffness", "mass", "gravity", "drop_height")]), 1e-30
    slopes = np.zeros((len(KINDS), count, len(NAMES)))
    for j, column in enumerate((0, 3, 4, 5)):
        moved = at.astype(complex)
        moved[j] += 1j * tiny * at[j]
        slopes[:, :, column] = np.imag(np.array(of(*moved))) / (tiny * at[j])
    return {kind: (np.array(x), slopes[i]) for i, (kind, x) in enumerate(zip(KINDS, of(*at), strict=True))}


def integrated(p: dict[str, float], count: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """As ``closed``, of any exponent and damping."""
    k, n, a, m, g, h = (p[name] for name in NAMES)
    many = len(NAMES)
    rows: dict[str, list[tuple[float, np.ndarray]]] = {kind: [] for kind in KINDS}
    v = np.sqrt(2.0 * g * h)
    v_p = np.zeros(many)
    v_p[4], v_p[5] = 0.5 * v / g, 0.5 * v / h
    begin, begin_p = v / g, v_p / g
    begin_p[4] -= v / g**2

    def force(d: Any, r: Any) -> Any:
        return k * np.maximum(d, 0.0) ** n * (1.0 + a * r)

    def slopes(d: float, r: float) -> tuple[float, float, np.ndarray]:
        """F_d, F_v, and F_p by ``NAMES``."""
        d = max(d, 0.0)
        power = d**n
        by = np.zeros(many)
        by[:3] = power * (1.0 + a * r), k * power * (np.log(d) if d > 0 else 0.0) * (1.0 + a * r), k * power * r
        return k * n * d ** (n - 1.0) * (1.0 + a * r), k * power * a, by

    def motion(_: float, z: np.ndarray) -> np.ndarray:
        d, r, s, u = z[0], z[1], z[3 : 3 + many], z[3 + many : 3 + 2 * many]
        f, (f_d, f_v, f_p) = force(d, r), slopes(d, r)
        change = f_d * s + f_v * u + f_p
        turn = -change / m
        turn[3] += f / m**2
        turn[4] += 1.0
        return np.concatenate([[r, g - f / m, f], u, turn, change])

    def apart(_: float, z: np.ndarray) -> float:
        return z[0]

    apart.terminal, apart.direction = True, -1  # pyright: ignore[reportFunctionMemberAccess]
    for _ in range(count):
        depth = (m * v**2 * (n + 1.0) / (2.0 * k)) ** (1.0 / (n + 1.0))
        start = np.concatenate([[0.0, v, 0.0], np.zeros(many), v_p, np.zeros(many)])
        sizes = np.array([p[name] or 1.0 for name in NAMES])
        scale = np.concatenate([[depth, v, m * v], depth / sizes, v / sizes, m * v / sizes])
        run = solve_ivp(
            motion, (0.0, 20.0 * depth / v), start, "DOP853", rtol=_TOLERANCE, atol=_TOLERANCE * scale, events=apart,
            dense_output=True, first_step=1e-6 * depth / v,
        )  # fmt: skip
        length, last = float(run.t_events[0][0]), run.y_events[0][0]
        sol: Any = run.sol
        length_p = -last[3 : 3 + many] / last[1]

        def rate(t: float, sol: Any = sol) -> float:
            d, r = sol(t)[:2]
            f_d, f_v, _ = slopes(d, r)
            return f_d * r + f_v * (g - force(d, r) / m)

        def by(t: float, sol: Any = sol) -> np.ndarray:
            z = sol(t)
            f_d, f_v, f_p = slopes(z[0], z[1])
            return f_d * z[3 : 3 + many] + f_v * z[3 + many : 3 + 2 * many] + f_p

        root: Any = brentq(rate, 0.02 * length, 0.98 * length, xtol=1e-15 * length)
        top, step = float(root), 1e-3 * length

        def derivative(f: Any, t: float = top, step: float = step) -> Any:
            return (8.0 * (f(t + step) - f(t - step)) - (f(t + 2.0 * step) - f(t - 2.0 * step))) / (12.0 * step)

        top_p = -derivative(by) / derivative(rate)
        rows["begin"].append((begin, begin_p.copy()))
        rows["peak_time"].append((begin + top, begin_p + top_p))
        rows["end"].append((begin + length, begin_p + length_p))
        rows["peak"].append((float(force(*sol(top)[:2])), by(top)))
        rows["impulse"].append((float(last[2]), last[3 + 2 * many :] + 0.0 * length_p))
        # The speed at the end, on the clock of the contact's begin, and where that clock is.
        v_p = -(last[3 + many : 3 + 2 * many] + g * length_p)
        v = -float(last[1])
        begin += length + 2.0 * v / g
        begin_p = begin_p + length_p + 2.0 * v_p / g
        begin_p[4] -= 2.0 * v / g**2
    return {kind: (np.array([x for x, _ in found]), np.array([d for _, d in found])) for kind, found in rows.items()}
