"""Derivatives and calibration of the joint with rolling balls, window ends and bands, beside those of the plain joint.

    python -m benchmarks.models.joint_fuller                    all parts, into benchmarks/results/joint_fuller.json
    python -m benchmarks.models.joint_fuller derivatives plain  or any other part, variant or both

Derivatives: of the normal forces of 0.3 s by eight logarithms at the level ``balanced``, with their certificate: each
parameter's verdict and the bound of its error, pointwise and of averages over 5 ms.
Calibration: the seven coefficients that the record tells (``benchmarks.calibration.joint_calibration``) and the
clearance of one ball in its groove, 5 um more than that of the others, from a record of 0.3 s with noise of 2 % of each
peak, of the same joint solved to 1e-5 of the peak. The fit ends at 1e-3 of it. Walls hang on what else runs. Beside each
estimate stands what the draw of the noise alone, and the solver's error alone, would move the best unbiased estimate by, to
first order: with the Jacobian J at the truth, by BDF at 1e-5, (J^T J)^-1 J^T n of the whitened noise n.
Draws: the last leg of that fit, for more draws of the noise: trust region, mean Jacobian and the step with it, from a start
two deviations off the truth.
Tangents: how large they become by tolerance and method, here and in joints in which a ball carries nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import MAX_STEPS, Plan
from benchmarks.calibration.joint_calibration import BOUNDS
from benchmarks.clock import clocked, keep_programs
from benchmarks.common import Some, add, known
from benchmarks.common import options as asked_for
from calibration import Channel, Experiment, Free, Problem, fit
from calibration.diagnostics.fit_tests import spread
from calibration.forward.model import Model, build, residuals_and_jacobian
from calibration.noise.averaging import averaged, stepped
from calibration.search.evaluate import evaluator, loosened
from calibration.search.refinement import End, finish
from calibration.uncertainty.estimates import placed

FULLER = dict.fromkeys(PLAIN, True)
BANDS = PLAIN | {"bands": True}
# Contact regularisation of 20 um holds a ball that carries nothing with less than a newton.
NARROW, WIDE = {"smoothing": 20e-6}, {"smoothing": 30e-6}
# Options, values, and the seed of the noise.
VARIANTS: dict[str, tuple[dict[str, Any], dict[str, float], int]] = {
    "plain": (PLAIN, NARROW, 0),
    "fuller": (FULLER, NARROW, 0),
    "fuller, 30 um": (FULLER, WIDE, 0),
    "plain, 0.5 rad": (PLAIN, NARROW | {"joint_angle": 0.5}, 0),
    "bands": (BANDS, NARROW, 0),
    "bands, 30 um": (BANDS, WIDE, 0),
    "fuller, 30 um, draw 1": (FULLER, WIDE, 1),
    "fuller, 30 um, draw 2": (FULLER, WIDE, 2),
}
TIMES = np.linspace(0.0, 0.3, 301)
CONTACTS = ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball")
ONE_BALL, EXTRA = "seat_ball_2.extra_clearance", 5e-6
NOISE, STARTS = 0.02, 4
# Reference of the noise's part, and the accuracies of which the solver's part is told.
TIGHT, ASKED = 1e-5, (1e-2, 1e-3)
# Seeds of the last legs; ln of a reference penetration [m].
DRAWS, DEPTH = range(12), float(np.log(1e-5))
QUANTILE = float(special.ndtri(0.975))
# Solver tolerances, and whether tangents count in the step control (BDF) or not (SDIRK2).
TOLERANCES = ((5e-3, False), (1e-3, False), (1e-3, True), (1e-4, True), (1e-5, True))


def derivatives(options: dict[str, Any], values: dict[str, float], seed: int) -> dict[str, Any]:
    """Verdicts and differences of a variant."""
    del seed
    scene = bj.scenes.joint_of_keys(**options)
    params = scene.parameters(values)
    found, took = clocked(lambda: bj.sensitivity(scene, params, TIMES, list(BOUNDS), features=["seat_cage.mean"]))
    certificate = found.certificate
    assert certificate is not None
    return {
        "verdict": certificate.verdict,
        "parameters": {name: _check(check) for name, check in certificate.parameters.items()},
        "direction": certificate.direction, "steps": certificate.steps, "cpu_s": took["cpu_s"],
    }  # fmt: skip


def _check(check: Any) -> dict[str, Any]:
    names = ("verdict", "remark", "pointwise", "average", "influence")
    return {name: getattr(check, name) for name in names}


class Setting:
    """A variant's joint, its truth, and its record without noise."""

    def __init__(self, options: dict[str, Any], values: dict[str, float]) -> None:
        self.scene = bj.scenes.joint_of_keys(unequal=True, **options)
        given = self.scene.parameters(values | {ONE_BALL: EXTRA})
        self.truth = {name: float(value) for name, value in given.items()}
        run = bj.simulate(self.scene, self.scene.parameters(self.truth), TIMES, accuracy=TIGHT)
        assert run.status == "ok", run.reason
        self.forces: dict[str, np.ndarray] = {}
        for contact in CONTACTS:
            force = np.asarray(run.force[contact])[..., 0].reshape(TIMES.size, -1)
            for i, normal in enumerate(force.T):
                self.forces[f"{contact}_{i + 1}.normal" if force.shape[1] > 1 else f"{contact}.normal"] = normal

    def noise(self, seed: int) -> dict[str, np.ndarray]:
        """White noise of deviation 1 by channel."""
        draw = np.random.default_rng(seed)
        return {name: draw.standard_normal(force.size) for name, force in self.forces.items()}

    def problem(self, noise: dict[str, np.ndarray] | None = None, accuracy: float = 0.0) -> Problem:
        """The record, with noise or without, and what is free; an accuracy of 0 is the usual one."""
        channels = []
        for name, force in self.forces.items():
            sigma = NOISE * float(np.abs(force).max())
            channels.append(Channel(name, force + sigma * noise[name] if noise else force, sigma))
        truth = self.truth
        free = [Free(name, a * truth[name], b * truth[name]) for name, (a, b) in BOUNDS.items() if name != "damping"]
        free.append(Free(ONE_BALL, -15e-6, 15e-6))
        record = Experiment("record", TIMES, tuple(channels))
        return Problem(self.scene, truth, (record,), tuple(free), accuracy)

    def model(self, noise: dict[str, np.ndarray] | None = None, accuracy: float = 0.0) -> tuple[Model, np.ndarray]:
        """Its model and the truth in the unit box."""
        problem = self.problem(noise, accuracy)
        built = build(problem, problem.experiments).at_depth(DEPTH)
        return built, built.point(np.array([self.truth[axis.name] for axis in built.coordinates]))


class Linear:
    """What the best unbiased estimate is moved by to first order, in its deviations."""

    def __init__(self, setting: Setting) -> None:
        tight, truth = setting.model(accuracy=TIGHT)
        _, self.jacobian = residuals_and_jacobian(tight, truth)
        self.covariance = np.linalg.inv(self.jacobian.T @ self.jacobian)
        self.names = [axis.name for axis in tight.coordinates]
        self.channels = tight.channels
        end = End(truth, truth, 0.0, np.zeros(0), self.jacobian, True)
        self.slopes = placed(tight, end)[1]
        self.deviations = np.sqrt(np.diag(self.slopes @ self.covariance @ self.slopes.T))

    def moved(self, white: np.ndarray) -> np.ndarray:
        """Of the estimates (P,), by errors (N,) of the record in deviations of its noise."""
        return self.slopes @ self.covariance @ self.jacobian.T @ white / self.deviations

    def chi2(self, white: np.ndarray) -> float:
        """Of all estimates together: chi-square of P degrees of freedom, if the errors are white."""
        push = self.jacobian.T @ white
        return float(push @ self.covariance @ push)

    def flat(self, noise: dict[str, np.ndarray]) -> np.ndarray:
        """Noise by channel in the order of the residuals (N,)."""
        return np.concatenate([noise[name] for name in self.channels])


def calibration(options: dict[str, Any], values: dict[str, float], seed: int) -> dict[str, Any]:
    """Estimates over the truth, and the extra clearance of one ball, of a variant and one draw of the noise."""
    setting = Setting(options, values)
    noise, truth = setting.noise(seed), setting.truth
    found, walls = clocked(lambda: fit(setting.problem(noise), seed=0, starts=STARTS))
    logs = {axis.name: axis.log for axis in found.optimum.model.coordinates}
    linear = Linear(setting)
    white = linear.flat(noise)
    alone = dict(zip(linear.names, linear.moved(white).tolist(), strict=True))
    chi2 = linear.chi2(white)
    return {
        "verdict": found.verdict, "reasons": found.reasons, "notes": found.notes,
        "reduced_chi2": found.residual["reduced_chi2"],
        "solver_test": next(t.value for t in found.tests if t.name == "error of the integrator"),
        "parameters": {
            name: {
                "estimate_over_truth": one.value / truth[name],
                "ci95_over_truth": one.ci95 and [end / truth[name] for end in one.ci95],
                "identifiable": one.identifiable,
                "deviations": one.ci95 and _deviations(one.value, one.ci95, truth[name], logs[name]),
                "noise_alone": alone[name],
            }
            for name, one in found.parameters.items()
        },
        "noise_chi2": chi2, "noise_p": float(special.chdtrc(len(alone), chi2)),
        "solver_alone": {f"{accuracy:g}": _solver(setting, linear, accuracy) for accuracy in ASKED},
        **walls,
    }  # fmt: skip


def _deviations(value: float, ends: tuple[float, float], truth: float, log: bool) -> float:
    """How far an estimate is off, in deviations of its interval."""
    value, low, high, truth = np.log([value, *ends, truth]) if log else np.array([value, *ends, truth])
    return float((value - truth) / ((high - low) / (2.0 * QUANTILE)))


def _solver(setting: Setting, linear: Linear, accuracy: float) -> dict[str, float]:
    """What the solver's error at an accuracy moves the estimates by."""
    model, truth = setting.model(accuracy=accuracy)
    errors, _ = residuals_and_jacobian(model, truth)
    return dict(zip(linear.names, (-linear.moved(errors)).tolist(), strict=True))


def draws(options: dict[str, Any], values: dict[str, float], seed: int) -> dict[str, Any]:
    """How often intervals of last legs exclude the truth, beside those of the best unbiased estimate of the same draws."""
    setting = Setting(options, values)
    linear = Linear(setting)
    ends, own, chi2, best, cpu = [], [], [], [], time.process_time()
    for k in DRAWS:
        noise = setting.noise(seed + k)
        model, truth = setting.model(noise)
        off = 2.0 * np.linalg.cholesky(linear.covariance) @ np.random.default_rng(1000 + k).standard_normal(truth.size)
        begin = np.clip(truth + off, 1e-3, 1.0 - 1e-3)
        end = finish(model, begin, begin)
        covariance = spread(end, end.residuals.size, [], "linear").covariance
        assert covariance is not None
        end = stepped(evaluator(model), averaged(evaluator(loosened(model)), end, covariance))
        covariance = spread(end, end.residuals.size, [], "linear").covariance
        assert covariance is not None
        zero = End(truth, truth, 0.0, end.residuals, end.jacobian, True)
        (z, slopes), (at, _) = placed(model, end), placed(model, zero)
        ends.append((z - at) / np.sqrt(np.diag(slopes @ covariance @ slopes.T)))
        own.append(linear.moved(linear.flat(noise)))
        chi2.append(float((end.point - truth) @ np.linalg.solve(covariance, end.point - truth)))
        best.append(linear.chi2(linear.flat(noise)))
    return {
        "draws": len(ends), "intervals": int(np.size(ends)), "cpu_s": time.process_time() - cpu,
        "last_legs": _told(np.array(ends), chi2), "noise_alone": _told(np.array(own), best),
        "together_up_to": float(special.chdtri(len(linear.names), 0.05)),
    }  # fmt: skip


def _told(deviations: np.ndarray, chi2: list[float]) -> dict[str, Any]:
    """Of deviations (draws, P): how many exclude the truth, by draw and in all; chi-square of all P together."""
    out = np.abs(deviations) > QUANTILE
    return {
        "exclude": int(out.sum()), "by_draw": out.sum(axis=1).tolist(), "chi2": chi2,
        "mean": deviations.mean(axis=0).tolist(), "rms": float(np.sqrt(np.mean(deviations**2))),
    }  # fmt: skip


def tangents(options: dict[str, Any], values: dict[str, float], seed: int) -> dict[str, float]:
    """Largest derivative [N] of any normal force of the first 0.12 s by the logarithm of ``stiffness``, by tolerance."""
    del seed
    scene = bj.scenes.joint_of_keys(**options)
    params = scene.parameters(values)

    def largest(tolerance: Any, controlled: bool) -> Any:
        def forces(log: Any) -> Any:
            moved = {**params, "stiffness": params["stiffness"] * jnp.exp(log)}
            how = Plan(tolerance, MAX_STEPS, controlled)
            found = bj.force_history(scene, moved, TIMES[:121], accuracy=how, mode="forward")
            return [force[..., 0] for force in found.values()]

        slopes = jax.jvp(forces, (jnp.zeros(()),), (jnp.ones(()),))[1]
        return jnp.max(jnp.stack([jnp.max(jnp.abs(slope)) for slope in slopes]))

    programs = {controlled: jax.jit(lambda x, c=controlled: largest(x, c)) for controlled in (False, True)}
    return {
        f"{'BDF' if controlled else 'SDIRK2'} {tolerance:g}": float(programs[controlled](jnp.asarray(tolerance)))
        for tolerance, controlled in TOLERANCES
    }


PARTS: dict[str, Callable[..., Any]] = {
    "derivatives": derivatives,
    "calibration": calibration,
    "draws": draws,
    "tangents": tangents,
}
# Of which variants, unless some are asked for.
_THREE, _AGAIN = ["plain", "fuller", "fuller, 30 um"], ["fuller, 30 um, draw 1", "fuller, 30 um, draw 2"]
USUAL = {
    "derivatives": _THREE,
    "calibration": _THREE + _AGAIN,
    "draws": _THREE[1:],
    "tangents": [name for name in VARIANTS if name not in _AGAIN],
}


def main() -> None:
    """The parts asked for, of the variants asked for or all."""
    keep_programs()
    asked = asked_for(__doc__, {"what": Some()}).what
    for name in [x for x in asked if x in PARTS] or PARTS:
        for variant in [x for x in asked if x in VARIANTS] or USUAL[name]:
            found = PARTS[name](*VARIANTS[variant])
            add("joint_fuller", {name: known("joint_fuller").get(name, {}) | {variant: found}})


if __name__ == "__main__":
    main()
