"""Any stiff model, with the dense structure that it has by itself: every way it is solved, against a closed form."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from by_numpy import by_numpy
from stiff import NAMES, TIMES, VALUES, Damped, counted, exact

import bcfj_jax as bj
from bcfj_jax.analysis import energy_balance
from bcfj_jax.core.status import OK
from bcfj_jax.solve.measured_error import measured
from bcfj_jax.solve.plan import Points, plan
from bcfj_jax.solve.work_queue import integrate_queue

MODEL = Damped()
TRUE = np.asarray(exact(VALUES))
SLOPES = by_numpy(jax.jacfwd(exact))(np.asarray(VALUES)) * VALUES


def force(shares, accuracy, mode):
    """The spring's force [N] where every parameter is its default times a share."""
    params = {name: value * shares[k] for k, (name, value) in enumerate(zip(NAMES, VALUES, strict=True))}
    return bj.force_history(MODEL, params, TIMES, accuracy=accuracy, mode=mode)["spring"][:, 0]


@pytest.mark.full
@pytest.mark.parametrize("solver", tiers.ci([None, "rodas3", "sdirk2", "bdf"], None, "bdf"))
def test_values(solver):
    run = bj.simulate(MODEL, MODEL.parameters(), TIMES, accuracy=1e-4, solver=solver)
    assert run.status == "ok" and run.stats["accepted"] < 2000
    assert np.abs(run.force["spring"][:, 0] - TRUE).max() < 1e-3 * TRUE.max()


def test_a_solver_that_is_explicit_is_refused():
    with pytest.raises(bj.InputError, match="solver"):
        bj.simulate(MODEL, MODEL.parameters(), TIMES, solver="tsit5")


@pytest.mark.full
@pytest.mark.parametrize(("accuracy", "within"), tiers.ci([(1e-3, 5e-3), (1e-5, 1e-4)], (1e-5, 1e-4)))
def test_forward_derivatives(accuracy, within):
    # Below 5e-4 tangents are in the step control, and BDF solves them.
    assert plan(MODEL, accuracy).tangents == (accuracy < 5e-4)
    found = jax.jit(jax.jacfwd(lambda shares: force(shares, accuracy, "forward")))(jnp.ones(4))
    assert np.abs(found - SLOPES).max() < within * np.abs(SLOPES).max()


@pytest.mark.parametrize(
    "mode", [pytest.param("reverse", marks=pytest.mark.slow), pytest.param("auto", marks=pytest.mark.full)]
)
def test_reverse_derivatives(mode):
    found = jax.jit(jax.grad(lambda shares: jnp.sum(force(shares, 1e-4, mode))))(jnp.ones(4))
    assert np.asarray(found) == pytest.approx(SLOPES.sum(0), abs=5e-3 * np.abs(SLOPES.sum(0)).max())


@pytest.mark.full
@pytest.mark.parametrize("accuracy", tiers.ci([1e-2, 1e-3]))
def test_loose_reverse_derivatives_are_as_good_as_forward_ones(accuracy):
    assert not plan(MODEL, accuracy).tangents
    forward = jax.jit(jax.jacfwd(lambda x: force(x, accuracy, "forward")))(jnp.ones(4))
    reverse = jax.jit(jax.jacrev(lambda x: force(x, accuracy, "reverse")))(jnp.ones(4))
    assert np.abs(reverse - SLOPES).max() < 2.0 * np.abs(forward - SLOPES).max()


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", tiers.ci([1e-2, 1e-6], 1e-6))
def test_reverse_is_as_accurate_as_asked_in_a_batch(accuracy):
    batch = jnp.stack([jnp.ones(4), jnp.array([1.0, 0.8, 1.0, 1.0])])
    found = np.asarray(jax.jit(jax.vmap(jax.jacrev(lambda x: force(x, accuracy, "auto"))))(batch))
    for one, shares in zip(found, np.asarray(batch), strict=True):
        slopes = by_numpy(jax.jacfwd(exact))(VALUES * shares) * VALUES
        assert np.abs(one - slopes).max() < 5.0 * accuracy * np.abs(slopes).max()


@pytest.mark.slow
def test_many_at_once():
    shares = jnp.array([0.5, 1.0, 2.0, 4.0, 8.0])
    params = {name: jnp.full(5, value) for name, value in zip(NAMES, VALUES, strict=True)}
    params["damping"] = params["damping"] * shares
    grid, count, how = jnp.asarray(TIMES / TIMES[-1]), jnp.asarray(5), plan(MODEL, 1e-4)
    solve = jax.jit(lambda p, ends: integrate_queue(MODEL, Points(p, ends, grid), how, count, 2)[0])
    found = solve(params, jnp.full(5, TIMES[-1]))
    assert np.all(found.code == OK)
    for k, share in enumerate(shares):
        true = exact(VALUES * np.array([1.0, share, 1.0, 1.0])) / VALUES[0]
        assert np.abs(found.states[k, :, 0] - true).max() < 1e-3 * VALUES[3]


@pytest.mark.slow
def test_a_certificate():
    found = bj.sensitivity(MODEL, MODEL.parameters(), TIMES, ["damping", "stiffness"], accuracy=1e-3)
    assert found.status == "ok" and found.certificate is not None and found.certificate.verdict == "trusted"
    assert found.derivative["damping"]["spring"][:, 0] * VALUES[1] == pytest.approx(SLOPES[:, 1], abs=5e-3 * 20.0)


@pytest.mark.full
def test_its_energy_is_balanced():
    # From 5 ms on: the speed settles within 5 us, which the quadrature does not resolve.
    found = energy_balance.balance(MODEL, MODEL.parameters(), TIMES[1:], 1e-5, step=1e-4)
    left = 0.5 * TRUE**2 / VALUES[0]
    assert found.closure < 1e-4 and found.taken["damping"][-1] == pytest.approx(left[1] - left[-1], rel=1e-3)


# --- A measured error ---


def test_a_measured_error_is_the_error_and_compiles_nothing():
    model, count = counted()
    params = model.parameters()
    run = bj.simulate(model, params, TIMES, accuracy=1e-2)
    traces = count[0]
    assert run.accuracy is None
    stated = bj.simulate(model, params, TIMES, accuracy=1e-2, measure_error=True)
    assert count[0] == traces and np.array_equal(stated.force["spring"], run.force["spring"])
    found = stated.accuracy
    assert found is not None and found.asked == 1e-2 and found.tolerance == run.stats["tolerance"]
    off = np.sqrt(np.mean(np.square(run.force["spring"][:, 0] - TRUE))) / TRUE.max()
    # The tighter run is no truth: it has a tenth of the tolerance, and some 5 of 10 parts of the error by order 3.
    assert found.rms["spring"] == pytest.approx(off, rel=0.5) and found.worst < 1e-2
    assert found.peak["spring"] == 0.0 and np.isnan(found.agree_until)


def test_errors_that_normal_forces_do_not_show():
    """A contact between two samples by the motion after it; a preload that presses both sides alike by friction's size."""
    times = np.linspace(0.0, 1.0, 11)
    rates = np.where(times < 0.55, 2.0, -1.6)
    none, rubs = np.zeros((11, 3)), np.stack([np.zeros(11), np.full(11, 4.0), np.zeros(11)], 1)
    forces = {"between": none, "held": 1.01 * rubs}, {"between": none, "held": rubs}
    found = measured(
        0.01, 0.0, times, *forces, ({"between": rates}, {"between": np.where(times < 0.55, 2.0, -1.5)}),
        tolerance=1.0, wall_s=0.0,
    )  # fmt: skip
    assert found.rms == pytest.approx({"between": 0.05 * np.sqrt(5 / 11), "held": 0.01})
    assert found.impulse == {"between": 0.0, "held": 0.0} and found.doubt[0] == ""


def test_where_two_runs_part():
    times = np.linspace(0.0, 1.0, 11)
    truth = np.stack([np.full(11, 10.0), np.zeros(11), np.zeros(11)], 1)
    ours = truth.copy()
    ours[7:, 0] += 1.5
    twice = {"one": truth, "ball": np.stack([truth, truth], 1)}
    found = measured(
        0.01, 0.0, times, {"one": ours, "ball": np.stack([truth, ours], 1)}, twice, tolerance=1.0, wall_s=0.0
    )
    # Apart by 15 %, where 1 % was asked for and ten times that is let pass.
    assert (found.agree_until, found.differs) == (times[7], "one") and found.peak == pytest.approx(
        {"one": 0.15, "ball": 0.15}
    )
    assert found.rms["ball"] == pytest.approx(0.15 * np.sqrt(4 / 11))
    assert found.impulse["one"] == pytest.approx(1.5 * 0.35 / 10.0)
    assert measured(0.02, 0.0, times, {"one": ours}, twice, tolerance=1.0, wall_s=0.0).agree_until is not None
    ours[9:] = np.nan
    failed = measured(0.02, 0.0, times, {"one": ours}, twice, tolerance=1.0, wall_s=0.0)
    assert failed.agree_until == times[9] and np.isnan(failed.worst)
    late = measured(0.01, 0.95, times, {"one": truth}, twice, tolerance=1.0, wall_s=0.0)
    assert late.begin == 0.0 and late.worst == 0.0
