"""Other people's solvers on the joint's field: SciPy's LSODA and Radau, and diffrax as shipped.

All take the state in units of ``scales``, z = y/scales, and ``tol`` in those units, and return ``Peer``: states (T, n) at
the times, the wall time of the solve, accepted steps (SciPy: steps), and what was compiled before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from joint_casadi import Peer, cvodes, default_scales, default_scene
from optimistix import rms_norm
from scipy.integrate import LSODA, Radau

from bcfj_jax.joint import system
from bcfj_jax.joint.constants import constants
from bcfj_jax.joint.scene import Joint
from bcfj_jax.joint.start import nominal

# SciPy asks for a relative tolerance above 0. Scaled states reach 5e3, so this share of tol does not count.
RELATIVE = 1e-6
MAX_WALL_S, MAX_STEPS, MAX_IMPLICIT_STEPS = 60.0, 300_000, 40_000


def _field(t, z, args):
    scene, made, scales = args
    return system.field(t, z * scales, (scene, made)) / scales


def _jacobian(t, z, args):
    return jax.jacfwd(_field, argnums=1)(t, z, args)


class _Compiled:
    """Field and Jacobian of one set of numbers, called with NumPy arrays.

    The numbers are closed over: a hundred small arrays as arguments cost a hundred times the field in every call.
    """

    def __init__(self, scene: Joint, params: Mapping[str, Any], scales: np.ndarray):
        begin = time.perf_counter()
        args = (scene, constants(scene, dict(params)), jnp.asarray(scales))
        self.field = jax.jit(lambda t, z: _field(t, z, args))
        self.jacobian = jax.jit(lambda t, z: _jacobian(t, z, args))
        z = np.asarray(nominal(scene, dict(params), jnp.zeros(()))) / scales
        jax.block_until_ready((self.field(0.0, z), self.jacobian(0.0, z)))
        self.compile_s = time.perf_counter() - begin


_COMPILED: dict[Any, _Compiled] = {}


def _scipy(
    method: type,
    scene: Joint,
    params: Mapping[str, Any],
    times: Sequence[float],
    tol: float,
    scales: np.ndarray,
    max_wall_s: float = MAX_WALL_S,
) -> Peer:
    key = (scene, tuple((name, float(value)) for name, value in params.items()), np.asarray(scales).tobytes())
    if key not in _COMPILED:
        _COMPILED[key] = _Compiled(scene, params, scales)
    made = _COMPILED[key]
    grid = np.asarray(times, dtype=float)
    start = np.asarray(nominal(scene, dict(params), jnp.zeros(()))) / scales
    out = np.full((grid.size, start.size), np.nan)
    out[0], filled, steps, failed = start, 1, 0, None

    def field(t, z):
        return np.asarray(made.field(t, z))

    def jacobian(t, z):
        return np.asarray(made.jacobian(t, z))

    begin = time.perf_counter()
    solver = method(field, grid[0], start, grid[-1], rtol=RELATIVE * tol, atol=tol, jac=jacobian)
    if isinstance(solver, Radau):
        # SciPy takes Newton's tolerance from rtol, which says nothing here: the same formula of tol.
        solver.newton_tol = max(10 * np.finfo(float).eps / tol, min(0.03, tol**0.5))
    while solver.status == "running":
        message = solver.step()
        steps += 1
        if solver.status == "failed":
            failed = str(message)
            break
        until = int(np.searchsorted(grid, solver.t, side="right"))
        if until > filled:
            out[filled:until] = solver.dense_output()(grid[filled:until]).T
            filled = until
        if time.perf_counter() - begin > max_wall_s:
            failed = f"stopped after {max_wall_s:g} s at t = {solver.t:.4f} s"
            break
    wall = time.perf_counter() - begin
    return Peer(out * scales, wall, steps, made.compile_s, failed)


def _norm(z):
    size = rms_norm(z)
    return jnp.where(jnp.isfinite(size), size, jnp.inf)


@eqx.filter_jit
def _solve(solver, scene, params, times, tol, scales, max_steps):
    made = constants(scene, params)
    start = nominal(scene, params, jnp.zeros(())) / scales
    sol = dfx.diffeqsolve(
        dfx.ODETerm(_field),
        solver,
        t0=times[0],
        t1=times[-1],
        dt0=1e-6,
        y0=start,
        args=(scene, made, scales),
        saveat=dfx.SaveAt(ts=times),
        stepsize_controller=dfx.PIDController(rtol=0.0, atol=tol, norm=_norm),
        max_steps=max_steps,
        throw=False,
        adjoint=dfx.ForwardMode(),
    )
    return sol.ys * scales, sol.stats["num_accepted_steps"], sol.stats["num_rejected_steps"], sol.result


_SOLVES: dict[Any, tuple[Any, float]] = {}


def _diffrax(
    solver: type,
    scene: Joint,
    params: Mapping[str, Any],
    times: Sequence[float],
    tol: float,
    scales: np.ndarray,
    max_steps: int = MAX_STEPS,
) -> Peer:
    implicit = issubclass(solver, dfx.AbstractImplicitSolver)
    if implicit:
        # The default root finder takes rtol = 0 from the controller; these are the controller's, with a floor.
        made = solver(root_finder=dfx.VeryChord(rtol=RELATIVE * tol, atol=tol, norm=_norm))
    else:
        made = solver()
    arguments = (made, scene, dict(params), jnp.asarray(times), jnp.asarray(tol), jnp.asarray(scales), max_steps)
    key = (solver, scene, len(times), tol if implicit else None, max_steps)
    if key not in _SOLVES:
        begin = time.perf_counter()
        _SOLVES[key] = (_solve.lower(*arguments).compile(), time.perf_counter() - begin)
    run, compile_s = _SOLVES[key]
    begin = time.perf_counter()
    states, steps, rejected, result = jax.block_until_ready(run(*arguments))
    wall = time.perf_counter() - begin
    failed = None if bool(result == dfx.RESULTS.successful) else f"{dfx.RESULTS[result]}"
    if failed is not None:
        failed = f"not finished after {int(steps)} steps and {int(rejected)} rejected: {failed}"
    return Peer(np.asarray(states), wall, int(steps), compile_s, failed)


SOLVERS: dict[str, Callable[..., Peer]] = {
    "CVODES (CasADi)": cvodes,
    "LSODA (SciPy)": partial(_scipy, LSODA),
    "Radau (SciPy)": partial(_scipy, Radau),
    "Tsit5 (diffrax)": partial(_diffrax, dfx.Tsit5),
    "Kvaerno3 (diffrax)": partial(_diffrax, dfx.Kvaerno3, max_steps=MAX_IMPLICIT_STEPS),
    "Kvaerno5 (diffrax)": partial(_diffrax, dfx.Kvaerno5, max_steps=MAX_IMPLICIT_STEPS),
}
lsoda, radau, tsit5, kvaerno3, kvaerno5 = (SOLVERS[name] for name in list(SOLVERS)[1:])


def groove_forces(scene: Joint, params: Mapping[str, Any], states: np.ndarray) -> np.ndarray:
    """Normal forces of the first flank of each groove, (T, balls, 2) [N]."""
    made = constants(scene, dict(params))

    def one(y):
        return system.touches(scene, made, system.view(scene, made, y)).grooves.normal[..., 0]

    return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(states)))


def main() -> None:
    """A rough table: error against CVODES at 1e-9, steps, wall."""
    scene = default_scene()
    params, scales, times = scene.parameters(), default_scales(scene), np.linspace(0.0, 0.6, 301)
    reference = groove_forces(scene, params, cvodes(scene, params, times, 1e-9, scales).states)
    print(f"rms {np.sqrt(np.mean(reference**2)):.0f} N, peak {reference.max():.0f} N")
    for name, solve in SOLVERS.items():
        for tol in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
            found = solve(scene, params, times, tol, scales)
            error = np.sqrt(np.mean((groove_forces(scene, params, found.states) - reference) ** 2))
            what = found.failed or f"{found.steps:7d} steps  {error:9.3f} N"
            print(f"{name:20s} {tol:.0e}  {found.wall_s:7.3f} s  {what}", flush=True)
            if found.wall_s > MAX_WALL_S / 3:
                # A tighter one takes longer still.
                break


if __name__ == "__main__":
    main()
