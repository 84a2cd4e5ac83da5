"""Design by gradient: closed forms' optima to 1e-6, bounds, tolerances, failures, and what an independent run says."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from joints import plain_joint
from scipy.optimize import brentq
from shown import brief, drawn

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives.certificate import Certificate, Check
from bcfj_jax.analysis.designs import api
from bcfj_jax.analysis.designs.confirm import robust
from bcfj_jax.analysis.designs.evaluate import Evaluator
from bcfj_jax.analysis.designs.objective import objective
from bcfj_jax.analysis.designs.space import space
from bcfj_jax.solve.plan import plan

# A mass m on spring k and dashpot c = 2 z sqrt(k m), approaching at v: a linear oscillator until the force vanishes.
K, M, V = 1e6, 0.5, 2.0
RATE, UNIT = math.sqrt(K / M), 2.0 * math.sqrt(K * M)
TIMES = np.linspace(0.0, 2.0 / RATE, 401)
# A greatest sample misses the peak by (w dt)^2/8 at most.
SAMPLED = 4e-6
HOW = {"starts": 4, "accuracy": 1e-8, "samples": 16}
BOX = (0.02 * UNIT, 0.45 * UNIT)


def peak(z: float) -> float:
    """Greatest |acceleration| over v sqrt(k/m), z < 1/2: a' = 0 at tan(w t) = r (1 - 4 z^2)/(z (3 - 4 z^2))."""
    r = math.sqrt(1.0 - z * z)
    return math.exp(-z / r * math.atan2(r * (1.0 - 4.0 * z * z), z * (3.0 - 4.0 * z * z)))


def depth(z: float) -> float:
    """Greatest penetration over v/sqrt(k/m): x' = 0 at tan(w t) = r/z."""
    r = math.sqrt(1.0 - z * z)
    return math.exp(-z / r * math.atan2(r, z))


def slope(function, z: float, h: float = 1e-4) -> float:
    """Fourth-order difference."""
    return (8 * (function(z + h) - function(z - h)) - (function(z + 2 * h) - function(z - 2 * h))) / (12 * h)


@pytest.fixture(scope="module")
def dashpot():
    scene = bj.scenes.impact("kelvin_voigt", smoothing=False)
    return scene, scene.parameters(stiffness=K, mass=M, approach_speed=V, dashpot=0.05 * UNIT)


@pytest.mark.slow
def test_least_peak_of_a_damped_impact(dashpot, tmp_path, monkeypatch):
    found = bj.design(*dashpot, TIMES, "contact.peak", {"dashpot": (*BOX, 0.1, True)}, **HOW)
    right = brentq(lambda z: slope(peak, z), 0.2, 0.3, xtol=1e-13)
    assert right == pytest.approx(0.2649, abs=1e-4)
    assert found.status == "ok", found.reason
    assert found.values["dashpot"] / UNIT == pytest.approx(right, rel=1e-6)
    assert found.after == pytest.approx(peak(right) * M * V * RATE, rel=SAMPLED)
    assert found.before == pytest.approx(peak(0.05) * M * V * RATE, rel=SAMPLED)
    assert found.agree == found.near == 4 and not found.at_bound and found.step < 1e-6
    assert found.certificate.verdict == "trusted"
    assert found.confirmation.confirmed and found.confirmation.share == pytest.approx(1.0, abs=1e-6)
    # At an optimum the gradient sees nothing of the tolerance; runs do.
    wide = found.robustness
    assert wide.linear_worst == pytest.approx(found.after, rel=1e-6)
    ends = max(peak(0.9 * right), peak(1.1 * right)) * M * V * RATE
    assert found.after < wide.sampled_worst <= ends * (1.0 + 1e-6)
    folder = found.save(tmp_path / "design")
    kept = json.loads((folder / "design.json").read_text())
    assert kept["status"] == "ok" and len(kept["starts"]) == 4
    assert (folder / "starts.png").stat().st_size > 1e4 and (folder / "slices.png").stat().st_size > 1e4
    brief(found, "Design: ok")
    drawn(found, tmp_path, monkeypatch)
    assert found.to_pandas().loc["dashpot", "upper"] == BOX[1]
    assert found.to_xarray()["dashpot"].attrs["units"] == "N s/m"


@pytest.mark.slow
def test_least_product_of_peak_and_depth(dashpot):
    def product(features):
        return jnp.log(features["contact.peak"]) + jnp.log(features["contact.peak_penetration"])

    names = ("contact.peak", "contact.peak_penetration")
    found = bj.design(*dashpot, TIMES, product, {"dashpot": BOX}, features=names, certify=False, slices=False, **HOW)
    right = brentq(lambda z: slope(lambda x: math.log(peak(x) * depth(x)), z), 0.3, 0.45, xtol=1e-13)
    # The packaging engineer's number.
    assert right == pytest.approx(0.404, abs=1e-3)
    assert found.values["dashpot"] / UNIT == pytest.approx(right, rel=1e-6)
    assert math.exp(found.after) == pytest.approx(0.5206 * M * V**2, rel=1e-3)


@pytest.mark.slow
def test_an_optimum_on_a_bound_and_its_tolerance(dashpot):
    tolerance = 0.02 * UNIT
    free = {"dashpot": (0.3 * UNIT, 0.45 * UNIT, tolerance)}
    found = bj.design(*dashpot, TIMES, "contact.peak", free, certify=False, slices=False, distribution="uniform", **HOW)
    assert found.status == "ok", found.reason
    assert found.values["dashpot"] == 0.3 * UNIT
    assert found.at_bound == {"dashpot": "lower"}
    force = M * V * RATE
    rise = slope(peak, 0.3)
    assert found.gradient["dashpot"] == pytest.approx(rise * force / UNIT, rel=1e-5)
    wide = found.robustness
    assert wide.linear_worst == pytest.approx((peak(0.3) + 0.02 * rise) * force, rel=SAMPLED)
    assert wide.linear_deviation == pytest.approx(0.02 * rise * force / math.sqrt(3.0), rel=1e-5)
    assert wide.sampled_worst == pytest.approx(peak(0.32) * force, rel=SAMPLED)
    assert wide.failed == 0


@pytest.mark.slow
def test_most_instead_of_least(dashpot):
    found = bj.design(
        *dashpot, TIMES, "contact.peak", {"dashpot": BOX}, sense="maximise", certify=False, slices=False, **HOW
    )
    assert found.at_bound == {"dashpot": "lower"} and found.gain > 0
    assert found.after == pytest.approx(peak(0.02) * M * V * RATE, rel=SAMPLED)


@pytest.mark.full
def test_a_gain_that_another_model_does_not_see(dashpot):
    # A spring without the dashpot knows nothing of it.
    other = bj.scenes.impact("hertz", "linear", smoothing=False)
    found = bj.design(
        *dashpot, TIMES, "contact.peak", {"dashpot": BOX}, confirm=other, certify=False, slices=False, **HOW
    )
    assert found.status == "not confirmed"
    assert found.gain > 100.0 and found.confirmation.gain == pytest.approx(0.0, abs=1e-6)
    assert "not confirmed by the impact" in found.reason


def test_a_gradient_that_is_not_trusted(dashpot, monkeypatch):
    check = Check("not differentiable here", "chaotic", (), 1.0, 1.0, {}, 1e9, 10.0, 1.0, 0.0, 0.0)
    chaos = Certificate("not differentiable here", {"dashpot": check}, 5e-3, 0.03, (1e-6,), (10,), None)
    monkeypatch.setattr(api, "sensitivity", lambda *_, **__: SimpleNamespace(certificate=chaos))
    found = bj.design(*dashpot, TIMES, "contact.peak", {"dashpot": BOX}, confirm=None, slices=False, **HOW)
    assert found.status == "gradient not trusted"
    assert "dashpot (chaotic)" in found.reason


def test_runs_that_cannot_be_are_counted(dashpot):
    # A tolerance that reaches below 0 N s/m.
    free = {"dashpot": (0.02 * UNIT, 0.06 * UNIT, 0.1 * UNIT)}
    found = bj.design(*dashpot, TIMES, "contact.peak", free, certify=False, slices=False, confirm=None, **HOW)
    assert found.robustness.failed > 0
    assert list(found.robustness.reasons) == ["dashpot must be >= 0"]
    assert "dashpot must be >= 0" in found.reason


def evaluator(dashpot, free, **how):
    scene, params = dashpot
    wanted = objective("contact.peak", (), scene.members)
    box = space(scene, params, free)
    return Evaluator(scene, params, TIMES, plan(scene, 1e-8, **how), box, wanted, 4)


@pytest.mark.parametrize(("scale", "relative"), [("linear", False), ("linear", True), ("log", False), ("log", True)])
def test_the_robust_objective_and_its_gradient(dashpot, scale, relative):
    share = 0.05 if relative else 0.01 * UNIT
    tested = evaluator(dashpot, {"dashpot": (*BOX, share, relative, scale)})
    at = np.array([0.15, 0.4]) * UNIT
    found = robust(tested, 2.0)(tested.space.unit(at[:, None]), np.inf)

    def right(z: float) -> float:
        half = 0.05 * z if relative else 0.01
        return M * V * RATE * (peak(z) + 2.0 * abs(slope(peak, z)) * half)

    for k, z in enumerate((0.15, 0.4)):
        assert found.goal[k] == pytest.approx(right(z), rel=1e-5)
        by_value = found.slope[k, 0] / tested.space.slope(at[k : k + 1])[0]
        assert by_value == pytest.approx(slope(right, z, 1e-3) / UNIT, rel=1e-3)


@pytest.mark.slow
def test_no_start_with_a_value(dashpot):
    found = bj.design(*dashpot, TIMES, "contact.peak", {"dashpot": BOX}, max_steps=2, **HOW)
    assert found.status == "failed"
    assert "no start has a value" in found.reason and math.isnan(found.after)
    assert sum(found.failures.values()) > 4


@pytest.mark.slow
def test_peak_against_depth_of_a_hertzian_impact():
    """F/F0 + w d/d0 with F ~ K^(1/(n+1)), d ~ K^(-1/(n+1)): least at (K/K0)^(1/(n+1)) = sqrt(w)."""
    scene = bj.scenes.impact("hertz", smoothing=False)
    params = scene.parameters(stiffness=1e9, mass=M, approach_speed=V)
    n, energy = 1.5, 0.5 * (1.5 + 1.0) * M * V**2
    force, deep = 1e9 ** (1 / (n + 1)) * energy ** (n / (n + 1)), (energy / 1e9) ** (1 / (n + 1))
    weights = {"contact.peak": 1.0 / force, "contact.peak_penetration": 2.0 / deep}
    t = np.linspace(0.0, 2.5 * deep / V, 801)
    free = {"stiffness": (1e8, 1e11, 0.05, True, "log")}
    found = bj.design(scene, params, t, weights, free, certify=False, **HOW)
    assert found.status == "ok", found.reason
    assert found.values["stiffness"] == pytest.approx(1e9 * 2.0 ** ((n + 1) / 2), rel=1e-6)
    assert found.after == pytest.approx(2.0 * math.sqrt(2.0), rel=1e-6)


@pytest.mark.slow
def test_undeflected_joint_takes_least_offset_and_steepest_flank():
    """Physics sheet 5.4: F_c = 2 T/(z Rp) cot(alpha) e/R_c a ball; both parameters go to their bounds."""
    scene = plain_joint(fidelity="kinematic")
    params = scene.parameters(joint_angle=0.0, load_ramp=1e-3)
    free = {"offset": ("3 mm", "5 mm"), "contact_angle": ("35 deg", "45 deg")}
    found = bj.design(
        scene, params, np.linspace(0.01, 0.02, 11), "cage_ball.largest", free, confirm=None, slices=False, starts=3
    )
    assert found.at_bound == {"offset": "lower", "contact_angle": "upper"}
    load = 1800.0 / (6 * 0.0355)
    assert found.after == pytest.approx(2.0 * load * 0.003 / math.hypot(0.0355, 0.003), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"objective": "contact.height"}, "feature 'contact.height'"),
        ({"objective": "contact.period"}, "feature 'contact.period'"),
        ({"objective": lambda f: 0.0}, "features"),
        ({"free": {}}, "free"),
        ({"free": {"dashpott": BOX}}, "free"),
        ({"free": {"dashpot": (2.0, 1.0)}}, "free 'dashpot'"),
        ({"free": {"dashpot": (-2.0, 1.0)}}, "free 'dashpot' lower"),
        ({"free": {"dashpot": ("1 mm", 1.0)}}, "free 'dashpot' lower"),
        ({"free": {"dashpot": (0.0, 1.0, 0.0, False, "log")}}, "free 'dashpot' lower"),
        ({"free": {"dashpot": (1.0, 2.0, -1.0)}}, "free 'dashpot' tolerance"),
        ({"sense": "least"}, "sense"),
        ({"kappa": -1.0}, "kappa"),
        ({"norms": (0.5,)}, "norms"),
        ({"distribution": "cauchy"}, "distribution"),
        ({"starts": 0}, "starts"),
    ],
)
def test_bad_input_is_said(dashpot, change, where):
    given = {"objective": "contact.peak", "free": {"dashpot": BOX}, **change}
    with pytest.raises(bj.InputError) as error:
        bj.design(*dashpot, TIMES, given.pop("objective"), given.pop("free"), **given)
    assert error.value.where.startswith(where)


@pytest.mark.slow
def test_a_joint_against_a_grid_of_plain_runs():
    """Equilibria: nothing on a grid over both parameters, by ``simulate`` alone, is below what was found."""
    scene = plain_joint(fidelity="quasistatic")
    params = scene.parameters()
    t = 0.2 + np.linspace(0.0, 0.1, 13)
    free = {"offset": ("3 mm", "5 mm", "20 um"), "contact_angle": ("35 deg", "45 deg", "1 deg")}
    found = bj.design(scene, params, t, "cage_ball.largest", free, starts=3, samples=8, confirm=None, slices=False)
    assert found.status in ("ok", "one start alone"), found.reason
    assert found.after < found.before

    def largest(offset, angle):
        run = bj.simulate(scene, scene.parameters(offset=offset, contact_angle=angle), t)
        return float(np.abs(run.force["cage_ball"][..., 0]).max())

    grid = [largest(e, a) for e in np.linspace(3e-3, 5e-3, 6) for a in np.radians(np.linspace(35.0, 45.0, 6))]
    assert found.after <= min(grid) * (1.0 + 1e-9)
    assert largest(found.values["offset"], found.values["contact_angle"]) == pytest.approx(found.after, rel=1e-8)
