"""Derivatives of many runs in one batch: those of closed forms, each as it is alone; and studies of steady motion."""

from __future__ import annotations

import hashlib
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_numpy import by_numpy
from stiff import NAMES, TIMES, VALUES, Damped, exact
from studies import IMPACT, POWERS

import bcfj_jax as bj
from bcfj_jax import InputError
from bcfj_jax.analysis.derivatives import batch
from bcfj_jax.analysis.derivatives.jacobian import level
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import feature
from bcfj_jax.analysis.studies import block
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.core.status import OK
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import Points, plan
from bcfj_jax.xla.batched_jvp import changes

pytest.importorskip("pyarrow", reason="the extra study is not installed")

SHARES = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
WRT = ("damping", "stiffness")


def impacts(**more) -> dict:
    """A study of undamped impacts at a grid of two by two by two points, with derivatives by what is varied."""
    table = tomllib.loads(IMPACT)
    for axis in table["vary"].values():
        axis["steps"] = 2
    table["results"]["derivatives"] = list(POWERS)
    return {**table, **more}


def one_by_one(monkeypatch, table: dict) -> block.Table:
    """The first block of a study without a batch."""
    study = from_table(table)
    with monkeypatch.context() as patch:
        patch.setattr(batch, "possible", lambda *_: False)
        return block.compute(study, block.Blocks(study).points(0), block.Blocks(study).size)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The study of impacts, and its folder."""
    folder = tmp_path_factory.mktemp("impacts") / "out"
    return bj.study(impacts(), folder, workers=1), folder


@pytest.mark.slow
def test_derivatives_of_a_study_are_those_of_the_closed_form(done):
    result, _ = done
    assert result.failed == 0 and result.table.num_rows == 8
    for name, power in POWERS.items():
        # The peak is a product of powers, so that dF/dp = power F / p; that of the greatest sample is up to half a sample
        # off the top.
        slope = power * result.column("contact.peak") / result.column(name)
        assert result.column(f"d(contact.peak)/d({name})") == pytest.approx(slope, rel=1e-2)


@pytest.mark.slow
def test_derivatives_of_a_study_are_those_of_single_runs(done, monkeypatch):
    table, (result, _) = impacts(), done
    alone = one_by_one(monkeypatch, table)
    for row, point in zip(alone.results, alone.point, strict=True):
        # The same steps: nothing but rounding, which impacts amplify, may differ.
        together = [result.column(name)[point] for name in from_table(table).columns]
        assert together == pytest.approx(row.tolist(), rel=1e-9)


@pytest.mark.slow
def test_a_block_with_derivatives_that_is_lost_comes_back_in_the_same_bytes(done):
    _, folder = done
    files = [*sorted((folder / "blocks").glob("*.parquet")), folder / "results.parquet"]
    before = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    files[0].unlink()
    bj.study(impacts(), folder, workers=1)
    after = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    assert len(files) == 3 and after == before


@pytest.mark.slow
def test_a_point_that_fails_is_a_row_with_its_time_and_harms_no_other():
    table = {
        "scene": {
            "scene": {"kind": "bounce"}, "time": {"end": 1.0, "samples": 101},
            "accuracy": {"level": "balanced", "max_steps": 30},
        },
        "vary": {"drop_height": {"values": [0.05, 10.0, 0.1]}},
        "results": {"features": ["contact.mean", "contact.contact_fraction"], "derivatives": ["gravity"]},
    }  # fmt: skip
    study = from_table(table)
    found = block.compute(study, np.arange(3), 4)
    assert found.status == ["failed", "ok", "failed"]
    for k in (0, 2):
        assert "30 steps was spent at 0." in found.reason[k] and "with a tenth of the tolerance" in found.reason[k]
    # From 10 m the mass is still in the air when the run ends.
    assert found.results[1, 0] == 0.0 and np.isnan(found.results[[0, 2]]).all()


def stiff(order: np.ndarray, accuracy: float = 1e-3) -> batch.Runs:
    """A stiff oscillator at several dampings."""
    model = Damped()
    params = {name: np.full(len(order), value) for name, value in zip(NAMES, VALUES, strict=True)}
    params["damping"] = params["damping"] * SHARES[order]
    ends = np.full(len(order), TIMES[-1])
    return batch.run(model, Points(params, ends, np.asarray(TIMES / TIMES[-1])), WRT, plan(model, accuracy), 5)


def test_a_stiff_batch_has_the_derivatives_of_the_closed_form_whatever_stands_beside(monkeypatch):
    # Three places for five runs.
    monkeypatch.setattr(batch, "_PLACES", 3)
    found = stiff(np.arange(5))
    assert np.all(found.code == OK)
    model, how = Damped(), plan(Damped(), 1e-3)
    for k, share in enumerate(SHARES):
        values = np.array(VALUES)
        values[NAMES.index("damping")] *= share
        slopes = by_numpy(jax.jacfwd(exact))(values) * values
        for i, name in enumerate(WRT):
            at = NAMES.index(name)
            own = found.derivative.force[k, i, :, 0, 0] * values[at]
            assert np.abs(own - slopes[:, at]).max() < 5e-3 * np.abs(slopes).max()
        if k in (0, 4):
            alone = level(model, dict(zip(NAMES, map(np.asarray, values), strict=True)), np.asarray(TIMES), WRT, how)
            size = np.abs(alone.derivative.force[..., :1]).max()
            assert np.abs(found.derivative.force[k] - alone.derivative.force[..., :1]).max() < 1e-9 * size
            assert found.steps[k] == alone.steps
    other = np.array([3, 1, 4, 0, 2])
    again = stiff(other)
    np.testing.assert_array_equal(found.derivative.force[other], again.derivative.force)
    np.testing.assert_array_equal(found.value.force[other], again.value.force)
    np.testing.assert_array_equal(found.steps[other], again.steps)
    # A queue knows no continuous curve; features are then those of the samples.
    value, slopes = measure(TIMES, *found.one(0), [feature("spring.peak", {"spring": 0})], {"spring": 0}, False)
    assert value[0] == found.value.force[0].max() and np.isfinite(slopes).all()


def test_what_has_no_batch_is_told_apart():
    model = Damped()
    assert batch.possible(model, plan(model, 1e-3)) and not batch.possible(model, plan(model, 1e-5))
    assert not batch.possible(model, plan(model, 1e-3, solver="sdirk2"))
    impact = bj.scenes.impact()
    assert batch.possible(impact, plan(impact, 1e-8))


def test_changes_say_what_never_moves():
    found = changes(lambda x: {"moves": x[0] * jnp.ones(2), "still": jnp.ones(3), "both": x}, jnp.array([2.0, 3.0]))
    assert found["still"] is None
    np.testing.assert_array_equal(found["moves"], [[1.0, 1.0], [0.0, 0.0]])
    np.testing.assert_array_equal(found["both"], np.eye(2))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"scene": "impact"}, "not known to repeat itself"),
        ({"results": {"features": ["seat_ball.residual_oscillation"]}}, "none of steady motion"),
        ({"results": {"histories": True}}, "steady = true"),
        ({"scene": {"scene": {"kind": "joint", "fidelity": "auto"}}}, "not known to repeat itself"),
        ({"scene": {"scene": {"kind": "joint"}, "accuracy": {"solver": "rodas3"}}}, "with the solver"),
    ],
)
def test_what_has_no_steady_motion_is_refused(change, match):
    name = "stiffness"
    table = {
        "scene": {"scene": {"kind": "joint", "fidelity": "dynamic"}},
        "vary": {name: {"values": [1e10]}}, "results": {},
    } | change  # fmt: skip
    table["results"] = {**table["results"], "steady": True}
    with pytest.raises(InputError, match=match):
        from_table(table)


@pytest.mark.slow  # Two programs of the joint.
def test_steady_derivatives_of_a_study_are_differences_of_steady_motion(here):
    step = 2e-3
    table = {
        "scene": {"scene": {"kind": "joint", **PLAIN}, "time": {"end": 0.5, "samples": 3}},
        "vary": {"friction_static": {"values": [0.1 * (1 - step), 0.1, 0.1 * (1 + step)]}},
        "results": {
            "features": ["seat_cage.mean", "seat_ball.mean"],
            "derivatives": ["friction_static"],
            "steady": True,
        },
    }
    result = bj.study(table, here / "out", workers=1)
    assert result.failed == 0
    for name in table["results"]["features"]:
        values, slope = result.column(name), result.column(f"d({name})/d(friction_static)")[1]
        assert slope == pytest.approx((values[2] - values[0]) / (2 * step * 0.1), rel=0.02)
    # A run that ends before the start is forgotten has no steady motion, and says when it would have one.
    table["scene"]["time"]["end"] = 0.1
    early = bj.study(table, here / "early", workers=1)
    assert early.failed == 3
    assert all("the run ends before" in text for text in early.column("reason"))


@pytest.mark.slow
def test_an_objective_of_steady_motion_is_that_of_a_turn_and_has_its_derivative():
    from bcfj_jax.analysis.derivatives.steady import shares
    from bcfj_jax.analysis.designs.evaluate import Evaluator
    from bcfj_jax.analysis.designs.objective import objective
    from bcfj_jax.analysis.designs.space import space

    scene = bj.scenes.make("joint", **PLAIN)
    params = scene.parameters()
    box = space(scene, params, {"friction_static": (0.05, 0.2)})
    wanted = objective("seat_cage.mean", (), scene.members)
    evaluate = Evaluator(scene, params, shares(scene, params), plan(scene), box, wanted, 3, steady=0.5)
    found = evaluate.at(np.array([[0.0998], [0.1], [0.1002]]))
    assert found.reasons == [""] * 3
    slope = found.slope[1, 0] / box.slope(np.array([[0.1]]))[0, 0]
    assert slope == pytest.approx((found.true[2] - found.true[0]) / 4e-4, rel=0.02)
    # A run that has not forgotten its start has no value.
    early = Evaluator(scene, params, shares(scene, params), plan(scene), box, wanted, 3, steady=0.1)
    assert "the run ends before" in early.at(np.array([[0.1]])).reasons[0]


def test_a_design_without_steady_motion_is_refused():
    scene = bj.scenes.impact()
    with pytest.raises(InputError, match="not known to repeat itself"):
        bj.design(
            scene, scene.parameters(), np.linspace(0.0, 1e-3, 11), "contact.peak", {"damping": (0.1, 0.2)}, steady=True
        )
    joint = bj.scenes.joint()
    with pytest.raises(InputError, match="no objective of steady motion"):
        bj.design(
            joint, joint.parameters(), np.linspace(0.0, 0.5, 11), "seat_ball.impulse", {"stiffness": (1e10, 2e10)},
            steady=True,
        )  # fmt: skip
