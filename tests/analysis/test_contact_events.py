"""Trains of impacts: timing and shape apart, against closed forms and variational equations that share no code."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import JOINT

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives.contact_events import numbers, solved_at
from bcfj_jax.analysis.derivatives.names import EVENTS, Feature, complete, feature, feature_unit
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.analysis.derivatives.trains import NODES, PHASES, _rule
from bcfj_jax.solve.integrate import landed
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.references.bounce_events import KINDS, NAMES, closed, integrated

SCENE = bj.scenes.bounce(smoothing=False)
BALL = {"mass": 0.1, "gravity": 9.81, "drop_height": 0.05}
LINEAR = {"stiffness": 1e5, "exponent": 1.0, "damping": 0.0, **BALL}
HERTZ = {"stiffness": 1e5, "exponent": 1.5, "damping": 0.05, **BALL}
# A derivative below 0.01 % per 1 % counts as that much, as in a certificate.
LEAST = 0.01


def span(exact) -> float:
    """Until 0.3 of the flight after the last contact."""
    return float(exact["end"][0][-1] + 0.3 * (exact["begin"][0][-1] - exact["end"][0][-2]))


def check(found, exact, wrt, tolerance, values=1e-6) -> None:
    given = found.trains["contact"]
    for kind in KINDS:
        value, slope = exact[kind]
        np.testing.assert_allclose(getattr(given, kind), value, rtol=values)
        for name in wrt:
            true, p = slope[:, NAMES.index(name)], (LINEAR if found.wrt == wrt else HERTZ)[name]
            size = np.maximum(np.abs(true), LEAST * np.abs(value) / p)
            own = getattr(found.derivative[name]["contact"], kind)
            assert np.max(np.abs(own - true) / size) < tolerance, (kind, name)


@pytest.mark.slow
def test_thirty_bounces_at_balanced_are_those_of_the_closed_form(optimised):
    """Times, peaks and impulses and their derivatives to 1e-4, where the force at a fixed time is a spike."""
    exact, wrt = closed(LINEAR, 30), ("stiffness", "mass", "gravity", "drop_height")
    found = bj.contact_events(SCENE, SCENE.parameters(LINEAR), np.array([0.0, span(exact)]), wrt)
    assert found.counts == {"contact": 30} and not found.reasons and found.status == "ok"
    check(found, exact, wrt, 1e-4)
    assert max(np.nanmax(x["contact"][:5]) for x in found.apart.values()) < 1e-3
    # A sine of half a period: its centre is its middle, its width (1/4 - 2/pi^2)^(1/2) of it but for gravity, 1 %.
    train = found.trains["contact"]
    np.testing.assert_allclose(train.center, 0.5 * (train.begin + train.end), rtol=1e-8)
    np.testing.assert_allclose(train.width, np.sqrt(0.25 - 2.0 / np.pi**2) * (train.end - train.begin), rtol=0.02)
    # On the moving clock an undamped force keeps its shape: its derivative is the peak's share, and at fixed times a spike.
    own, share = found.derivative["drop_height"]["contact"], train.force[29] / train.peak[29]
    middle = slice(4, -4)
    np.testing.assert_allclose(own.force[29][middle] / own.peak[29], share[middle], rtol=0.05)
    assert np.max(np.abs(own.pointwise[29])) > 100.0 * np.max(np.abs(own.force[29]))


@pytest.mark.slow
@pytest.mark.parametrize("law", [HERTZ, {**HERTZ, "stiffness": 1e8}, {**HERTZ, "exponent": 2.2, "damping": 0.02}])
def test_damped_bounces_are_those_of_variational_equations(law):
    exact = integrated(law, 10)
    found = bj.contact_events(SCENE, SCENE.parameters(law), np.array([0.0, span(exact)]), NAMES)
    for kind in KINDS:
        value, slope = exact[kind]
        own = np.stack([getattr(found.derivative[n]["contact"], kind) for n in NAMES], axis=1)
        least = LEAST * np.abs(value)[:, None] / np.array([law[n] for n in NAMES])
        assert np.max(np.abs(own - slope) / np.maximum(np.abs(slope), least)) < 1e-4, kind


def test_the_references_agree():
    exact, found = closed(LINEAR, 3), integrated(LINEAR, 3)
    for kind in KINDS:
        np.testing.assert_allclose(found[kind][0], exact[kind][0], rtol=1e-10)
        columns = [NAMES.index(n) for n in ("stiffness", "mass", "gravity", "drop_height")]
        np.testing.assert_allclose(found[kind][1][:, columns], exact[kind][1][:, columns], rtol=1e-7, atol=1e-13)


def test_a_landing_keeps_what_the_contact_conserves():
    """A law K d^n (1 + a d') restores the same share of the speed whatever K: the derivative of the rebound is 0."""
    scene = bj.scenes.impact(smoothing=False)
    p = scene.parameters(
        mass=0.1, stiffness=1e5, exponent=1.5, damping=0.05, approach_speed=1.0, clearance_contact=1e-3
    )
    times = jnp.array([2.0 * float(scene.horizon(p))])

    def speed(log):
        moved = {**p, "stiffness": p["stiffness"] * jnp.exp(log)}
        return landed(scene, moved, times, Plan(jnp.asarray(1e-6), 10_000), 2)[0].states[0, 1]

    value, slope = jax.jit(lambda x: jax.jvp(speed, (x,), (1.0,)))(0.0)
    # chi (1 + e) = ln((1 + chi)/(1 - chi e)), chi = a v (physics: energy balance of the law).
    e, chi = -float(value), 0.05
    assert chi * (1.0 + e) == pytest.approx(np.log((1.0 + chi) / (1.0 - chi * e)), rel=1e-6)
    assert abs(float(slope)) < 1e-4


@pytest.mark.slow
def test_what_is_not_there_says_why():
    p = SCENE.parameters(LINEAR)
    first, period = np.sqrt(2 * 0.05 / 9.81), np.pi * np.sqrt(0.1 / 1e5)
    names = ("contact.begin_2", "contact.end_1", "contact.impulse_1", "contact.begin_1")
    found = bj.contact_events(SCENE, p, np.array([0.0, first + 0.4 * period]), (), features=names)
    assert found.reasons == {
        "contact.begin_2": "contact has 1 contact until the run's end",
        "contact.end_1": "it lasts beyond the run's end",
        "contact.impulse_1": "it lasts beyond the run's end",
    }
    assert np.isnan([found.features[n] for n in names[:3]]).all()
    assert found.features["contact.begin_1"] == pytest.approx(first, rel=1e-9)


@pytest.mark.slow
def test_members_and_several_contacts_count_for_themselves():
    """A chain: the impact travels, each contact begins after the one before it."""
    scene = bj.scenes.chain(3)
    params = scene.parameters()
    end = float(scene.horizon(params))
    found = bj.contact_events(
        scene, params, np.array([0.0, end]), (), features=("contact_1.peak_time_1", "contact_2.peak_time_1")
    )
    assert found.features["contact_1.peak_time_1"] < found.features["contact_2.peak_time_1"] < end


def test_names():
    contacts = {"contact": 0, "ball": 3}
    assert feature("ball_2.begin_12", contacts).kind == "begin_12"
    assert [feature_unit(f"contact.{k}_1") for k in ("begin", "peak", "impulse", "width")] == ["s", "N", "N s", "s"]
    for wrong, right in (("begn_3", "begin_3"), ("begin", "begin_1"), ("peak_0", "peak_1"), ("center_", "center_1")):
        with pytest.raises(bj.InputError, match=f"did you mean '{right}'"):
            feature(f"contact.{wrong}", contacts)


def implicit(law, count, exact):
    """The bounce as a user has it who wants implicit steps, and its derivatives; BDF does not land on contacts."""
    params, end = SCENE.parameters(law), span(exact)
    return bj.contact_events(SCENE.suited(params, end, "bdf"), params, np.array([0.0, end]), WRT, accuracy=1e-6)


WRT = ("stiffness", "mass", "gravity", "drop_height")


@pytest.mark.slow
def test_implicit_steps_give_the_contacts_of_the_closed_form():
    exact = closed(LINEAR, 10)
    found = implicit(LINEAR, 10, exact)
    assert found.counts == {"contact": 10} and found.missed == {"contact": 0} and not found.reasons
    check(found, exact, WRT, 1e-4)
    # The undamped force keeps its shape, a sine but for gravity: here on the moving clock, with its derivative.
    train, own = found.trains["contact"], found.derivative["drop_height"]["contact"]
    np.testing.assert_allclose(train.width, np.sqrt(0.25 - 2.0 / np.pi**2) * (train.end - train.begin), rtol=0.02)
    middle = slice(4, -4)
    share = train.force[9][middle] / train.peak[9]
    np.testing.assert_allclose(own.force[9][middle] / own.peak[9], share, rtol=0.05)
    assert np.max(np.abs(own.pointwise[9])) > 30.0 * np.max(np.abs(own.force[9]))
    # What two tolerances differ by is not less than what the tighter is off.
    for name in WRT:
        for kind, apart in zip(EVENTS, found.apart[name]["contact"], strict=True):
            if kind not in KINDS:
                continue
            value, slope = exact[kind]
            true = slope[:, NAMES.index(name)]
            size = np.maximum(np.abs(true), LEAST * np.abs(value) / LINEAR[name])
            off = np.max(np.abs(getattr(found.derivative[name]["contact"], kind) - true) / size)
            assert off < 1.5 * np.max(apart), (name, kind)


@pytest.mark.slow
@pytest.mark.parametrize("law", [HERTZ, {**HERTZ, "stiffness": 1e8}, {**HERTZ, "exponent": 2.2, "damping": 0.02}])
def test_implicit_steps_give_the_contacts_of_variational_equations(law):
    exact = integrated(law, 5)
    end, params = span(exact), SCENE.parameters(law)
    scene = SCENE.suited(params, end, "bdf")
    found = bj.contact_events(scene, params, np.array([0.0, end]), NAMES, accuracy=1e-7)
    for kind in KINDS:
        value, slope = exact[kind]
        own = np.stack([getattr(found.derivative[n]["contact"], kind) for n in NAMES], axis=1)
        least = LEAST * np.abs(value)[:, None] / np.array([law[n] for n in NAMES])
        assert np.max(np.abs(own - slope) / np.maximum(np.abs(slope), least)) < 1e-4, kind


def both(scene, params, end, wrt, features, accuracy):
    """Features (F,) and derivatives (F, P) by steps that land on contacts, and by BDF's."""
    found = []
    for solver in ("tsit5", "bdf"):
        suited = scene.suited(params, end, solver)
        full, names = complete(suited, params, wrt)
        wanted = [feature(name, suited.members) for name in features]
        problem = Problem(suited, full, np.array([end]), names)
        found.append(numbers(suited, solved_at(problem, plan(suited, accuracy), wanted), wanted))
    return found


@pytest.mark.slow
def test_stiff_friction_has_the_contact_of_steps_that_land():
    """A sphere on a plane with friction so steep that it is stiff."""
    scene = bj.scenes.oblique_impact()
    params = scene.parameters(friction_speed=1e-4, clearance_contact=1e-5)
    end = 2.0 * float(scene.horizon(params))
    assert scene.suited(params, end).traits.stiff
    wrt = ("stiffness", "exponent", "approach_speed", "clearance_contact", "restitution")
    names = [f"contact.{kind}_1" for kind in EVENTS]
    (value, slope), (own, by) = both(scene, params, end, wrt, names, 1e-7)
    np.testing.assert_allclose(own, value, rtol=1e-6)
    least = LEAST * np.abs(value)[:, None] / np.array([float(params[n]) for n in wrt])
    assert np.max(np.abs(by - slope) / np.maximum(np.abs(slope), least)) < 1e-4


@pytest.mark.slow
def test_a_mechanism_has_the_same_contacts_by_implicit_steps():
    scene = bj.scenes.slider_crank()
    params = scene.parameters()
    wrt = ("clearance_journal", "stiffness")
    names = [f"journal.{kind}_{k}" for k in (1, 2, 3) for kind in ("begin", "end", "peak", "impulse")]
    (value, slope), (own, by) = both(scene, params, 0.2 * float(scene.horizon(params)), wrt, names, 1e-7)
    np.testing.assert_allclose(own, value, rtol=1e-5)
    least = LEAST * np.abs(value)[:, None] / np.array([float(params[n]) for n in wrt])
    assert np.max(np.abs(by - slope) / np.maximum(np.abs(slope), least)) < 1e-3


@pytest.mark.slow
def test_derivatives_of_the_joints_contacts_are_those_of_differences():
    """Central differences of runs without derivatives, which take other steps."""
    end, name, h = 0.06, "stiffness", 1e-4
    full, names = complete(JOINT, JOINT.parameters(), (name,))
    # Of runs at 1e-8 the differences of peaks' times are off by up to 36 %.
    found, tight = solved_at(Problem(JOINT, full, np.array([end]), names), plan(JOINT, 1e-8), []), plan(JOINT, 1e-9)
    wanted = [
        Feature(f"{c}.{kind}_1", f"{kind}_1", (c,))
        for c in ("seat_cage", "seat_ball_1", "head_ball_1", "cage_ball_4", "cage_ball_6")
        for kind in EVENTS
    ] + [feature("cage_ball_1.impulse_1", JOINT.members), feature("cage_ball_1.end_1", JOINT.members)]
    value, slope = numbers(JOINT, found, wanted)
    beside = (full | {name: full[name] * (1.0 + s * h)} for s in (-1.0, 1.0))
    low, high = (
        numbers(JOINT, solved_at(Problem(JOINT, one, np.array([end]), ()), tight, wanted), wanted)[0] for one in beside
    )
    differences = (high - low) / (2.0 * h)
    good = np.isfinite(value)
    assert good.sum() > 8
    off = np.abs(slope[:, 0] * float(full[name]) - differences) / np.maximum(np.abs(differences), LEAST * np.abs(value))
    # Flat tops: of their times differences are known to some percent, with steps of any length.
    late = np.array([f.kind.startswith("peak_time") for f in wanted])
    assert np.max(off[good & ~late]) < 2e-3, off
    assert np.max(off[good & late]) < 0.1, off


@pytest.mark.slow
def test_features_of_a_stiff_scene_in_a_sensitivity_and_a_study(tmp_path):
    """The begin is the gap over the normal speed; what follows of it in closed form."""
    law = {"friction_speed": 1e-4, "clearance_contact": 1e-5}
    scene = bj.scenes.oblique_impact()
    params = scene.parameters(law)
    end, names = 2.0 * float(scene.horizon(params)), ("contact.begin_1", "contact.impulse_1", "contact.end_2")
    found = bj.sensitivity(
        scene, params, np.linspace(0.0, end, 301), ("approach_speed",), features=names, differences="none"
    )
    speed, angle = float(params["approach_speed"]), float(params["impact_angle"])
    begin = 1e-5 / (speed * np.cos(angle))
    assert found.features[names[0]] == pytest.approx(begin, rel=1e-6)
    by = found.feature_derivatives["approach_speed"]
    assert by[names[0]] == pytest.approx(-begin / speed, rel=1e-4)
    # The law restores a share of the speed that depends on the speed little: the impulse is m v (1 + e).
    assert by[names[1]] == pytest.approx(found.features[names[1]] / speed, rel=1e-3)
    assert found.certificate is not None
    verdicts = found.certificate.parameters["approach_speed"].feature_verdicts
    assert verdicts[names[0]] == verdicts[names[1]] == "trusted"
    assert "until the run's end" in found.reasons[names[2]]
    lines = "\n".join(f"{k} = {v}" for k, v in law.items())
    (tmp_path / "scene.toml").write_text(
        f'[scene]\nkind = "oblique_impact"\n[parameters]\n{lines}\n[time]\nend = {end}\nsamples = 101\n'
    )
    (tmp_path / "study.toml").write_text(
        'scene = "scene.toml"\n[design]\nkind = "list"\n[vary.approach_speed]\nvalues = [3.9, 4.5]\n'
        '[results]\nfeatures = ["contact.begin_1"]\nderivatives = ["approach_speed"]\n'
    )
    result = bj.study(tmp_path / "study.toml", tmp_path / "out")
    for k, v in enumerate((3.9, 4.5)):
        begin = 1e-5 / (v * np.cos(angle))
        assert result.column("contact.begin_1")[k] == pytest.approx(begin, rel=1e-6)
        assert result.column("d(contact.begin_1)/d(approach_speed)")[k] == pytest.approx(-begin / v, rel=1e-4)


def test_refusals():
    joint = bj.scenes.joint(fidelity="quasistatic")
    with pytest.raises(bj.InputError, match="no history"):
        bj.contact_events(joint, joint.parameters(), np.array([0.0, 0.1]))
    with pytest.raises(bj.InputError, match="of no single contact"):
        bj.contact_events(SCENE, SCENE.parameters(LINEAR), np.array([0.0, 1.0]), features=["contact.peak"])
    with pytest.raises(bj.InputError, match="may vanish"):
        bj.design(SCENE, SCENE.parameters(LINEAR), np.array([0.0, 1.0]), "contact.peak_1", {"mass": (0.1, 0.2)})


def test_the_rule_integrates_polynomials():
    for count in (NODES, NODES // 2 + 1):
        at, weights = _rule(count)
        for power in (0, 1, 2, 7, count - 1):
            assert weights @ at**power == pytest.approx(1.0 / (power + 1.0), rel=1e-13)
    assert PHASES[0] == 0.0 and PHASES[-1] == 1.0


@pytest.mark.slow
def test_features_of_a_sensitivity_and_of_a_study(tmp_path):
    exact, end = closed(LINEAR, 3), 0.7
    p = SCENE.parameters(LINEAR)
    found = bj.sensitivity(
        SCENE,
        p,
        np.linspace(0.0, end, 501),
        ("drop_height",),
        features=("contact.begin_3", "contact.end_9"),
        differences="none",
    )
    true = exact["begin"][1][2, NAMES.index("drop_height")]
    assert found.feature_derivatives["drop_height"]["contact.begin_3"] == pytest.approx(true, rel=1e-4)
    assert found.certificate is not None
    assert found.certificate.parameters["drop_height"].feature_verdicts["contact.begin_3"] == "trusted"
    assert "until the run's end" in found.reasons["contact.end_9"] and "contact.end_9 has no value" in repr(found)
    file = tmp_path / "study.toml"
    lines = "\n".join(f"{k} = {v}" for k, v in LINEAR.items())
    (tmp_path / "scene.toml").write_text(
        f'[scene]\nkind = "bounce"\nsmoothing = false\n[parameters]\n{lines}\n[time]\nend = {end}\nsamples = 101\n'
    )
    file.write_text(
        'scene = "scene.toml"\n[design]\nkind = "list"\n[vary.drop_height]\nvalues = [0.05, 0.06]\n'
        '[results]\nfeatures = ["contact.begin_2"]\nderivatives = ["drop_height"]\n'
    )
    result = bj.study(file, tmp_path / "out")
    for k, height in enumerate((0.05, 0.06)):
        value, slope = closed({**LINEAR, "drop_height": height}, 2)["begin"]
        assert result.column("contact.begin_2")[k] == pytest.approx(value[1], rel=1e-6)
        assert result.column("d(contact.begin_2)/d(drop_height)")[k] == pytest.approx(
            slope[1, NAMES.index("drop_height")], rel=1e-4
        )
