"""The joint by CVODES with forward and adjoint sensitivities: CasADi differentiates the field, CVODES integrates both.

The field is the one of ``joint_casadi_field`` with the moved parameters left as symbols.
"""

# CasADi has no types, and is not installed where types are checked.
# pyright: basic, reportMissingImports=false

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from bcfj_jax.models.joint.kinematic import nominal
from bcfj_jax.models.joint.scene import Joint
from benchmarks.references.joint_casadi import library, on_scales, settings
from benchmarks.references.joint_casadi_field import Expressions, expressions, require_defaults

MAX_STEPS, JIT_FLAGS = 5_000_000, ["-O1", "-march=native", "-fno-math-errno"]
Moved = Mapping[str, Sequence[str]]


def symbolic(params: Mapping[str, Any], moved: Moved, logs: ca.SX) -> Expressions:
    """The field, the parameters of each entry of ``moved`` times the exponential of one of ``logs``, symbols."""
    values = dict(params)
    for i, names in enumerate(moved.values()):
        values |= {name: float(values[name]) * ca.exp(logs[i]) for name in names}
    return expressions(values)


class Sensitive:
    """The compiled field, Jacobian and sensitivities of the joint, by a logarithm for each entry of ``moved``."""

    def __init__(self, scene: Joint, params: Mapping[str, Any], scales: np.ndarray, moved: Moved):
        require_defaults(scene)
        begin = time.perf_counter()
        self.scene, self.params, self.scales, self.size = scene, dict(params), np.asarray(scales), len(moved)
        # The start, zero clearance and no load, depends on none of them.
        self.start = np.asarray(nominal(scene, dict(params), np.zeros(()))) / self.scales
        logs = ca.SX.sym("p", self.size)
        e = symbolic(params, moved, logs)
        z, rate, scaled, unused = on_scales(e, self.scales)
        by_time, by_logs = ca.jacobian(rate, e.t), ca.jacobian(rate, logs)
        field = ca.Function("ode", [e.t, z, logs], [rate], ["t", "z", "p"], ["rate"])
        # The name, arguments and results by which an external function ``ode`` finds its derivative.
        jac = ca.Function("jac_ode", [e.t, z, logs, unused], ca.cse([by_time, scaled, by_logs]))
        self.symbols = {"t": e.t, "x": z, "p": logs, "ode": rate}
        self.folder = tempfile.TemporaryDirectory(prefix="joint_sensitive_")
        self.field = ca.external("ode", library(self.folder.name, field, jac))
        self.compile_s = time.perf_counter() - begin
        self._integrators: dict[Any, Any] = {}

    def _integrator(self, times: np.ndarray, tol: float, ahead: bool = False, back: bool = False) -> ca.Function:
        key = times.tobytes(), tol, ahead, back
        if key not in self._integrators:
            how = settings(tol, MAX_STEPS)
            if ahead or back:
                # An external function has no second derivatives, which CasADi asks for here: it writes its own C.
                problem = self.symbols
                jit = {"compiler": "cc", "flags": JIT_FLAGS, "cleanup": False}
                how |= {"jit": True, "compiler": "shell", "jit_cleanup": False, "jit_options": jit}
                how |= {"second_order_correction": False}
            else:
                t, z, p = ca.MX.sym("t"), ca.MX.sym("z", self.scales.size), ca.MX.sym("p", self.size)
                problem = {"t": t, "x": z, "p": p, "ode": self.field(t, z, p)}
            # What CasADi compiles itself it writes to the working directory.
            with contextlib.chdir(self.folder.name):
                made = ca.integrator("cvodes", "cvodes", problem, float(times[0]), times[1:], how)
                self._integrators[key] = made.forward(self.size) if ahead else _transposed(made) if back else made
        return self._integrators[key]

    def states(self, times: np.ndarray, tol: float, logs: np.ndarray | None = None) -> tuple[np.ndarray, float, int]:
        """States (T, n), CPU time of the solve [s] and steps; ``times`` from 0."""
        logs = np.zeros(self.size) if logs is None else logs
        solver = self._integrator(times, tol)
        begin = time.process_time()
        found = solver(x0=self.start, p=logs)["xf"]
        seconds = time.process_time() - begin
        return np.vstack([self.start, np.asarray(found).T]) * self.scales, seconds, int(solver.stats()["nsteps"])

    def sensitivities(self, times: np.ndarray, tol: float) -> tuple[np.ndarray, np.ndarray, float]:
        """States (T, n), their derivatives (T, n, k), CPU time [s], by CVODES on the augmented system."""
        k, n, count = self.size, self.scales.size, times.size - 1
        solver = self._integrator(times, tol, ahead=True)
        begin = time.process_time()
        found = solver(x0=self.start, p=np.zeros(k), fwd_p=np.eye(k))["fwd_xf"]
        seconds = time.process_time() - begin
        value = self._integrator(times, min(tol, 1e-6))(x0=self.start, p=np.zeros(k))["xf"]
        slope = np.asarray(found).reshape(n, k, count)
        states = np.vstack([self.start, np.asarray(value).T]) * self.scales
        slopes = np.concatenate([np.zeros((1, n, k)), np.moveaxis(slope, 2, 0)]) * self.scales[:, None]
        return states, slopes, seconds

    def gradient(
        self, times: np.ndarray, tol: float, seeds: np.ndarray, between: int = 1, size: float | None = None
    ) -> tuple[np.ndarray, float]:
        """Derivatives (k,) of the sum of seeds (T, n) times states by the logarithms, CPU time [s]: CVODES' adjoint.

        The backward solve has the forward's tolerances, and begins anew at each output that has a seed.

        Args:
            between: outputs for each that is asked for, all but one without a seed. CasADi sets the limit of steps of the
                forward solve alone; backwards CVODES stops after 500 between two outputs.
            size: to which the largest seed of the scaled states is scaled, since tolerances are absolute.
        """
        fine = np.interp(np.arange(between * (times.size - 1) + 1) / between, np.arange(times.size), times)
        scaled = (seeds[1:] * self.scales).T
        factor = 1.0 if size is None else size / np.abs(scaled).max()
        spread = np.zeros((scaled.shape[0], fine.size - 1))
        spread[:, between - 1 :: between] = factor * scaled
        solver = self._integrator(fine, tol, back=True)
        begin = time.process_time()
        found = solver(self.start, np.zeros(self.size), spread)
        return np.asarray(found).ravel() / factor, time.process_time() - begin


def _transposed(made: ca.Function) -> ca.Function:
    """(start, parameters, seeds of the outputs) -> derivatives by the parameters."""
    start, p = ca.MX.sym("start", made.size1_in("x0")), ca.MX.sym("p", made.size1_in("p"))
    found = made(x0=start, p=p)["xf"]
    seeds = ca.MX.sym("seeds", *found.shape)
    return ca.Function("transposed", [start, p, seeds], [ca.jtimes(found, p, seeds, True)])
