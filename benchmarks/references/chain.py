"""A row of spheres that pass on an impact: Newton's cradle without gravity, physics.md B3 and B3'.

N equal spheres of mass m touch in a row. Sphere i has the displacement u_i [m] from its place and the velocity v_i
[m/s], both positive to the right; the overlap of i and i + 1 is d_i = u_i - u_(i+1). The contact presses with
F_i = K d_i^n max(0, 1 + a d_i') where d_i > 0, else 0, and m v_i' = F_(i-1) - F_i. The first sphere starts at ``speed``,
the others at rest. Without damping the final velocities over ``speed`` depend on N and n alone.

Sources: siconos ChainOfBalls (parameters), physics.md B3 (velocities to nine digits).
``python -m benchmarks.references.chain`` compares with them.
"""

from __future__ import annotations

import dataclasses
import sys

import numpy as np

from bcfj_jax.verification import oracles
from benchmarks.references import laws
from benchmarks.references.solving import check, compiled, run


@dataclasses.dataclass(frozen=True)
class Chain:
    """Row of spheres; the defaults are the steel of B3 (radius 10 mm, 7780 kg/m^3, 203 GPa, 0.3)."""

    count: int = 10
    mass: float = 7780.0 * 4.0 / 3.0 * np.pi * 0.01**3  # kg
    stiffness: float = 4.0 / 3.0 * laws.reduced_modulus(203e9, 0.3, 203e9, 0.3) * 0.005**0.5  # K [N/m^n]
    exponent: float = 1.5  # n
    damping: float = 0.0  # a [s/m]
    speed: float = 1.0  # of the first sphere [m/s]

    @property
    def depth(self) -> float:
        """Greatest overlap of two of the spheres alone, without damping [m]."""
        return laws.hertz(0.5 * self.mass, self.speed, self.stiffness, self.exponent)[0]

    @property
    def duration(self) -> float:
        """Time that two of the spheres alone touch, without damping [s]."""
        return laws.hertz(0.5 * self.mass, self.speed, self.stiffness, self.exponent)[2]


def _field(t: float, y: np.ndarray, p: np.ndarray) -> np.ndarray:
    count = y.size // 2
    rate = np.zeros(y.size)
    rate[:count] = y[count:]
    for i in range(count - 1):
        force, _ = laws.normal(y[i] - y[i + 1], y[count + i] - y[count + i + 1], p[1], p[2], p[3], 0.0)
        rate[count + i] -= force / p[0]
        rate[count + i + 1] += force / p[0]
    return rate


def simulate(chain: Chain, times: np.ndarray, rtol: float = 1e-13, method: str = "DOP853") -> np.ndarray:
    """States (T, 2 N): displacements, then velocities, at ``times`` [s]; the impact begins at times[0]."""
    start = np.zeros(2 * chain.count)
    start[chain.count] = chain.speed
    return _advance(chain, start, np.asarray(times, float), rtol, method)


def _advance(chain: Chain, start: np.ndarray, times: np.ndarray, rtol: float, method: str) -> np.ndarray:
    p = np.array([chain.mass, chain.stiffness, chain.exponent, chain.damping])
    scales = np.repeat([chain.depth, chain.speed], chain.count)
    return run(compiled(_field, laws.HELPERS), start, times, p, method=method, rtol=rtol, scales=scales).states


def forces(chain: Chain, states: np.ndarray) -> np.ndarray:
    """Contact forces [N], shape (T, N - 1), of states (T, 2 N)."""
    u, v = np.split(np.asarray(states), 2, axis=-1)
    return laws.normal_on(-np.diff(u), -np.diff(v), chain.stiffness, chain.exponent, chain.damping, 0.0)


def energy(chain: Chain, states: np.ndarray) -> np.ndarray:
    """Kinetic and elastic energy [J], shape (T,)."""
    u, v = np.split(np.asarray(states), 2, axis=-1)
    overlap = np.maximum(-np.diff(u), 0.0)
    elastic = chain.stiffness * overlap ** (chain.exponent + 1.0) / (chain.exponent + 1.0)
    return 0.5 * chain.mass * np.sum(v**2, axis=-1) + np.sum(elastic, axis=-1)


def final_velocities(chain: Chain, rtol: float = 1e-13, method: str = "DOP853") -> np.ndarray:
    """Velocities [m/s], shape (N,), once all spheres are apart and none can catch another."""
    state = np.zeros(2 * chain.count)
    state[chain.count] = chain.speed
    piece = np.array([0.0, 2.0 * chain.count * chain.duration])
    for _ in range(1000):
        u, v = np.split(state, 2)
        if np.all(np.diff(v) >= 0.0) and np.all(np.diff(u) >= 0.0) and v[0] != chain.speed:
            return v
        state = _advance(chain, state, piece, rtol, method)[-1]
    raise RuntimeError("the spheres are still touching")


def main() -> bool:
    """Compare with the printed velocities, and check momentum and energy."""
    held = True
    for (count, exponent), printed in oracles.CHAIN.items():
        # Half a unit of the last printed digit, with a little room.
        allowed = 5.5e-8 if np.array(printed).round(7).tolist() == printed else 5.5e-10
        found = final_velocities(Chain(count, 1.0, 1.0, exponent))
        held &= check(f"N = {count}, n = {exponent}", found, printed, allowed)
    steel = Chain()
    held &= check("N = 10, steel in SI", final_velocities(steel), oracles.CHAIN[10, 1.5], 5.5e-10)
    states = simulate(steel, np.linspace(0.0, 12.0 * steel.duration, 400))
    total = energy(steel, states)
    held &= check("energy over its start", total / total[0], 1.0, 1e-10)
    held &= check("momentum over its start", np.sum(states[:, 10:], axis=1), 1.0, 1e-11)
    return bool(held)


if __name__ == "__main__":
    sys.exit(not main())
