"""Contacts that push both ways: every feature is of the size of the force, and the side stands beside it."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.analysis import features, plausibility
from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.measures import measure, sampling, vector
from bcfj_jax.analysis.derivatives.names import feature
from bcfj_jax.analysis.simulation import page, pictures, results, view
from bcfj_jax.solve.extremes import Look, after, begun

TIMES = np.linspace(0.0, 1.0, 201)
KINDS = (
    "peak", "mean", "impulse", "dissipated_work", "residual_oscillation", "contact_fraction", "largest", "ripple", "period",
    "duration",
)  # fmt: skip


def two_contacts():
    """Penetration, its rate and force of two contacts."""
    depth = 1e-3 * np.sin(4.0 * np.pi * TIMES)
    rate = 4e-3 * np.pi * np.cos(4.0 * np.pi * TIMES)
    pressed = np.maximum(depth, 0.0)
    return depth, rate, 1e6 * pressed + 2e3 * pressed * np.maximum(rate, 0.0)


def test_a_summary_knows_no_sign_but_the_side():
    depth, rate, force = two_contacts()
    one, two = (features.summary(TIMES, s * force, depth, rate) for s in (1.0, -1.0))
    assert (one.pop("side"), two.pop("side")) == (1.0, -1.0)
    assert one["peak"] > 0.0 and one["impulse"] > 0.0
    for key in one:
        assert two[key] == pytest.approx(one[key], rel=1e-14, nan_ok=True), key
    assert features.summary(TIMES, 0.0 * force, depth - 1.0, rate)["side"] == 0.0
    assert set(features.UNITS) == {*one, "side"}


@pytest.mark.parametrize("signs", [(-1.0, -1.0), (1.0, -1.0)])
def test_features_and_their_derivatives_are_those_of_the_size(signs):
    """Of a force on the other side, or on either side in turn: what the force pressed, by the parameter that scales it."""
    depth, rate, force = two_contacts()
    sign = np.where(TIMES < 0.5, *signs)
    contacts = {"pin": 0}
    wanted = [feature(f"pin.{kind}", contacts) for kind in KINDS]

    def histories(normal):
        table = np.zeros((TIMES.size, 1, 3))
        table[:, 0, 0] = normal
        return Histories(table, depth[:, None], rate[:, None], None)

    plain, signed = histories(force), histories(sign * force)
    by = [
        Histories(x.force[None], 0.0 * depth[None, :, None], 0.0 * rate[None, :, None], None) for x in (plain, signed)
    ]
    ours, theirs = (measure(TIMES, x, d, wanted, contacts, False) for x, d in zip((plain, signed), by, strict=True))
    for a, b in zip(ours, theirs, strict=True):
        assert np.allclose(a, b, rtol=1e-12, atol=0, equal_nan=True)
    assert ours[0][0] > 0.0 and ours[1][0, 0] == pytest.approx(ours[0][0])
    off = [sampling(TIMES, x, d, wanted, contacts, np.ones(1)) for x, d in zip((plain, signed), by, strict=True)]
    assert np.allclose(*off, rtol=1e-9)
    smooth = [f for f in wanted if f.kind != "period"]
    traced = jax.jit(lambda *x: vector(TIMES, Histories(*x, None), smooth, contacts, {}))
    values = [traced(*h[:3]) for h in (plain, signed)]
    assert np.allclose(*values, rtol=1e-12)


def test_a_reading_keeps_its_sign():
    table = np.zeros((TIMES.size, 1, 3))
    table[:, 0, 0] = -2.0
    rest = np.zeros((TIMES.size, 1))
    contacts = {"crank.torque": 0}
    wanted = [feature(f"crank.torque.{kind}", contacts) for kind in ("mean", "largest")]
    slopes = Histories(table[None], rest[None], rest[None], None)
    values, by = measure(TIMES, Histories(table, rest, rest, None), slopes, wanted, contacts, False)
    assert np.allclose(values, [-2.0, 2.0]) and np.allclose(by[:, 0], [-2.0, 2.0])


def test_steps_know_no_sign_but_the_least_force():
    depth, rate, force = two_contacts()
    found = []
    for sign in (1.0, -1.0):
        looks = [Look(*(jnp.asarray([x]) for x in row)) for row in zip(sign * force, depth, rate, strict=True)]
        known = begun(0.0, looks[0])
        for k in range(0, 100, 2):
            known = after(known, TIMES[k], TIMES[k + 2], *looks[k : k + 3])
        found.append({key: float(x[0]) for key, x in known._asdict().items()})
    one, two = found
    whole = [features.of_steps(0.5, x) for x in found]
    assert (whole[0].pop("side"), whole[1].pop("side")) == (1.0, -1.0)
    assert whole[0]["peak"] == pytest.approx(np.max(force), rel=1e-3)
    assert whole[1] == pytest.approx(whole[0], nan_ok=True)
    assert two["least"] == -one["peak"] and one["least"] == pytest.approx(0.0)


def yoke(axis="y"):
    """A Scotch yoke: the pin of a driven crank in the slot of a yoke that slides along x, held against one of its walls."""
    crank = bj.Body("crank", "hinge", mass=0.3, inertia=1e-4, drive=bj.Drive("constant", speed=30.0))
    slide = bj.Body("yoke", "slide", axis="x", mass=2.0, start={"position": 0.05})
    pin = bj.Contact("pin", ("yoke", "crank"), bj.gaps.PinInSlot(axis=axis), at=((0, 0, 0), (0.05, 0, 0)))
    given = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.3, "radius": 0.008, "clearance_pin": 5e-5}
    load = bj.loads.Force("push", "yoke", "x", size=200.0)
    return bj.Mechanism("yoke", [crank, slide], [pin], [load], given=given, end=0.02)


@pytest.mark.slow
def test_a_yoke_that_is_pushed_either_way(tmp_path):
    """The other wall bears; the crank starts at its dead centre, so that peaks differ, and no number is 0 under a force."""
    scene, times = yoke(), np.linspace(0.0, 0.02, 401)
    for side in (-1.0, 1.0):
        params = scene.parameters({"push.size": 200.0 * side})
        run = bj.simulate(scene, params, times, accuracy=1e-4, read=["pin.side"])
        normal = run.force["pin"][:, 0]
        top = np.max(np.abs(normal))
        assert np.array_equal(run.readings["pin.side"], np.sign(normal)) and top > 100.0
        one = results.summary(run, True)["contacts"]["pin"]
        assert one["side"] == side and one["peak"] == pytest.approx(top, rel=1e-3)
        assert one["impulse"] == pytest.approx(np.trapezoid(np.abs(normal), times), rel=1e-2)
        assert pictures.peaks(run)["pin"].force == pytest.approx(top, rel=1e-3)
        # The picture has the sign; its words are those of the table.
        shows = pictures.forces(run, tmp_path / "forces.png").shows
        assert pictures.peaks(run)["pin"].side == side and ("on side -1" in shows) == (side < 0)
        assert bool(pictures.sides(normal)) == (side < 0)
        assert view.told(run).rows[1][1] != "0 N" and "force 0 N" not in page.verdict(run, {}).sentence
        asked = ("pin.peak", "pin.mean")
        found = bj.sensitivity(scene, params, times, wrt=("stiffness",), features=asked, certify=False)
        assert found.features["pin.peak"] == pytest.approx(top, rel=1e-3)
        assert found.features["pin.mean"] == pytest.approx(one["mean"], rel=1e-3)
        assert not plausibility.of_run(scene, params, run)


@pytest.mark.full
def test_a_slot_across_the_stroke_is_said():
    scene = yoke(axis="x")
    params = scene.parameters({"push.size": -200.0})
    run = bj.simulate(scene, params, np.linspace(0.0, 0.02, 101))
    (found,) = plausibility.of_run(scene, params, run)
    said = found.sentence
    assert "pin" in said and "lies across the pin's travel" in said and "(1, 0, 0)" in said
    verdict = page.verdict(run, {}, [found])
    assert "across" in verdict.sentence and verdict.kind == page.BAD
    # Every command says it: here what sensitivities and designs ask.
    assert plausibility.at(scene, params, np.linspace(0.0, 0.02, 101))[0].cause == found.cause


@pytest.mark.slow
def test_integrals_of_a_reading_keep_its_sign():
    """A body that falls: the mean of its velocity is -g t/2, by gravity -t/2, whatever contacts are of the size of."""
    body = bj.Body("b", "slide", axis="y", mass=1.0, start={"position": 1.0})
    floor = bj.Contact(
        "c", ("ground", "b"), bj.gaps.PointOnPlane("y"), law="hertz", elastic="linear", values={"stiffness": 1e6}
    )
    scene = bj.Mechanism("falling", [body], [floor], [bj.loads.Gravity("-y")], end=0.4)
    times, name = np.linspace(0.0, 0.4, 41), "b.velocity.y.mean"
    found = bj.sensitivity(scene, scene.parameters(), times, ["gravity"], features=[name], certify=False)
    assert found.features[name] == pytest.approx(-9.81 * 0.2, rel=1e-6)
    assert found.feature_derivatives["gravity"][name] == pytest.approx(-0.2, rel=1e-6)
