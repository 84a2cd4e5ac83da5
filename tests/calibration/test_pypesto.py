"""Estimates and profile bounds of an impact beside pyPESTO's, on the same objective."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from test_profile import NORMAL, impact

from calibration import Free
from calibration.diagnostics import fit_tests
from calibration.diagnostics.optimum import Optimum
from calibration.forward import model
from calibration.noise.noise_model import Estimate
from calibration.search.refinement import finish
from calibration.uncertainty import profile

pypesto = pytest.importorskip("pypesto", reason="pyPESTO is a test extra")

# numba and fides, which pyPESTO loads, warn on import; that is theirs.
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


def test_estimates_and_profiles_equal_pypestos():
    import pypesto.optimize
    import pypesto.profile

    free = (Free("stiffness", 1e7, 1e9), Free("exponent", 1.2, 1.8))
    problem = impact(free)
    built = model.build(problem, problem.experiments).at_depth(float(np.log(2e-4)))

    def both(u):
        return (np.asarray(a) for a in model.residuals_and_jacobian(built, jnp.asarray(u)))

    def cost(u):
        residuals, _ = both(u)
        return 0.5 * float(residuals @ residuals)

    def gradient(u):
        residuals, jacobian = both(u)
        return jacobian.T @ residuals

    middle = np.full(2, 0.5)
    best = finish(built, middle, middle)
    spread = fit_tests.spread(best, problem.experiments[0].samples, [], "linear")
    ours = profile.of_optimum(Optimum(built, problem.experiments, best, Estimate({}, {}, []), spread))

    theirs = pypesto.Problem(
        pypesto.Objective(fun=cost, grad=gradient),
        lb=np.zeros(2),
        ub=np.ones(2),
        x_names=["reference_force", "exponent"],
    )
    optimizer = pypesto.optimize.ScipyOptimizer("L-BFGS-B", options={"ftol": 1e-14, "gtol": 1e-8})
    result = pypesto.optimize.minimize(
        theirs, optimizer, n_starts=1, startpoint_method=lambda **_: middle[None], progress_bar=False, filename=None
    )
    sigma = np.sqrt(np.diag(np.linalg.inv(best.jacobian.T @ best.jacobian)))
    assert result.optimize_result[0].x == pytest.approx(best.point, abs=1e-3 * sigma.min())
    lower, width = (np.asarray(a) for a in built.box)
    for i, name in enumerate(("reference_force", "exponent")):
        steps = {f"{kind}_step_size_absolute": 0.4 * sigma[i] for kind in ("default", "min", "max")}
        steps |= {f"{kind}_step_size_relative": 0.0 for kind in ("default", "min", "max")}
        result = pypesto.profile.parameter_profile(
            theirs,
            result,
            optimizer,
            profile_index=np.array([i]),
            profile_options=pypesto.profile.ProfileOptions(**steps, ratio_min=0.1),
            next_guess_method="fixed_step",
            progress_bar=False,
            filename=None,
        )
        path = result.profile_result.list[-1][i]
        # Their points, away from the optimum where their ratio is 1 to rounding; the root of the rise is smooth.
        rise = np.sqrt(np.maximum(-2 * np.log(path["ratio_path"]), 0.0)) * np.sign(path["x_path"][i] - best.point[i])
        far = np.abs(rise) > 0.2
        ends = np.exp(lower[i] + width[i] * CubicSpline(rise[far], path["x_path"][i][far])([-NORMAL, NORMAL]))
        assert ours[name].interval == pytest.approx(tuple(ends), abs=1e-3 * (ends[1] - ends[0]) / 2)
