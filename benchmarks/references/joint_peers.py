"""Other people's solvers on the joint's field: SciPy's LSODA and Radau, and diffrax's, for ``benchmarks.models.joint precision``.

All take the state in units of ``scales``, z = y/scales, and ``tol`` in those units, and return ``Peer``: states (T, n)
at the times, the wall time of the solve, accepted steps, and what was compiled before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from scipy.integrate import LSODA, Radau

from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.scene import Joint
from benchmarks.references.joint_casadi import Peer, build, cvodes, require_defaults

# SciPy asks for a relative tolerance above 0. Scaled states reach 5e3, so this share of tol does not count.
RELATIVE = 1e-6
MAX_WALL_S, MAX_STEPS, MAX_IMPLICIT_STEPS = 60.0, 300_000, 20_000


def _field(t, z, args):
    scene, made, scales = args
    return system.field(t, z * scales, (scene, made)) / scales


def _scipy(
    method: type, scene: Joint, params: Mapping[str, Any], times: np.ndarray, tol: float, scales: np.ndarray,
    max_wall_s: float = MAX_WALL_S,
) -> Peer:  # fmt: skip
    """By SciPy on the C field of ``joint_casadi``: a call of JAX's costs several times the field."""
    require_defaults(scene)
    made = build(params, scales)
    field, jacobian = made.callables()
    grid = np.asarray(times, dtype=float)
    start = np.asarray(nominal(scene, dict(params), jnp.zeros(()))) / scales
    out = np.full((grid.size, start.size), np.nan)
    out[0], filled, steps, failed = start, 1, 0, None
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
    size = optx.rms_norm(z)
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
    solver: Callable[[float], Any],
    scene: Joint,
    params: Mapping[str, Any],
    times: np.ndarray,
    tol: float,
    scales: np.ndarray,
    max_steps: int | None = None,
) -> Peer:
    made = solver(tol)
    if max_steps is None:
        max_steps = MAX_IMPLICIT_STEPS if isinstance(made, dfx.AbstractImplicitSolver) else MAX_STEPS
    arguments = (made, scene, dict(params), jnp.asarray(times), jnp.asarray(tol), jnp.asarray(scales), max_steps)
    key = (made, scene, len(times), max_steps)
    if key not in _SOLVES:
        begin = time.perf_counter()
        _SOLVES[key] = (_solve.lower(*arguments).compile(), time.perf_counter() - begin)
    run, compile_s = _SOLVES[key]
    begin = time.perf_counter()
    states, steps, rejected, result = jax.block_until_ready(run(*arguments))
    wall = time.perf_counter() - begin
    failed = None if bool(result == dfx.RESULTS.successful) else f"{dfx.RESULTS[result]}"
    if failed is not None:
        reached = times[int(np.sum(np.all(np.isfinite(states), axis=1))) - 1]
        failed = f"at {reached:.3f} s after {int(steps)} steps and {int(rejected)} rejected: {failed.split('.')[0]}"
    return Peer(np.asarray(states), wall, int(steps), compile_s, failed)


def _tsit5(tol: float) -> dfx.Tsit5:
    del tol
    return dfx.Tsit5()


def _implicit(solver: type, tol: float) -> Any:
    """Kvaerno's methods with full Newton iterations: with the frozen Jacobian that they are shipped with few runs finish."""
    return solver(root_finder=optx.Newton(rtol=RELATIVE * tol, atol=tol, norm=_norm))


SOLVERS: dict[str, Callable[..., Peer]] = {
    "CVODES (CasADi)": cvodes,
    "LSODA (SciPy, C field)": partial(_scipy, LSODA),
    "Radau (SciPy, C field)": partial(_scipy, Radau),
    "Tsit5 (diffrax)": partial(_diffrax, _tsit5),
    "Kvaerno3 (diffrax, Newton)": partial(_diffrax, partial(_implicit, dfx.Kvaerno3)),
    "Kvaerno5 (diffrax, Newton)": partial(_diffrax, partial(_implicit, dfx.Kvaerno5)),
}


def groove_forces(scene: Joint, params: Mapping[str, Any], states: np.ndarray) -> np.ndarray:
    """Normal forces of the first flank of each groove, (T, balls, 2) [N]."""
    made = constants(scene, dict(params))

    def one(y):
        found = system.by_name(scene, system.contact_forces(scene, made, system.view(scene, made, y)))
        return jnp.stack([found[name].normal[..., 0] for name in ("seat_ball", "head_ball")], 1)

    return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(states)))


class Errors(NamedTuple):
    """Against a reference [N]: rms of all; rms of the loaded flanks; the median over time of each sample's rms.

    An unloaded ball rattles in its clearance with up to 50 N, and forgets how it began only when it is loaded
    again. There two solvers agree on no digit, at whatever tolerance: a floor of 0.3 to 0.9 N under the rms of all.
    """

    rms: float
    loaded: float
    median: float


LOADED_N = 200.0


def errors(found: np.ndarray, reference: np.ndarray) -> Errors:
    """How far forces (T, ...) are from a reference."""
    square = (found - reference) ** 2
    samples = np.sqrt(np.mean(square.reshape(len(square), -1), axis=1))
    loaded = reference > LOADED_N
    return Errors(float(np.sqrt(np.mean(square))), float(np.sqrt(np.mean(square[loaded]))), float(np.median(samples)))
