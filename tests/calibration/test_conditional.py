"""A fit that identifies nothing says what holds on which condition: as if the condition were stated in the file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_loss_laws import EXPONENT, MASS, STIFFNESS, TIMES, contact

from bcfj_jax import scenes
from calibration import Channel, Experiment, Fit, Free, Problem, fit
from calibration.command import as_json, text

SCENE = scenes.impact(smoothing=False)
FREE = (Free("stiffness", 1e6, 1e9), Free("exponent", 1.0, 2.5), Free("time_offset", 0.0, 4e-4))


@pytest.fixture(scope="module")
def elastic() -> Problem:
    """A contact without loss, with nothing but its law free."""
    force = contact(1.2, 0.0, 1.0, TIMES)[0]
    read = force + 0.005 * force.max() * np.random.default_rng(0).standard_normal(TIMES.size)
    known = {"approach_speed": 1.2, "mass": MASS}
    run = Experiment("run", TIMES + 2e-4, (Channel("contact.normal", read, None),), fixed=known)
    params = {k: float(v) for k, v in SCENE.parameters({"damping": 1e-4}).items()}
    return Problem(SCENE, params, (run,), FREE, filter="none")


def told(found: Fit, names: tuple[str, ...]) -> list[tuple[float, float]]:
    source = found.conditional.parameters if found.conditional else found.parameters
    return [source[name].ci95 for name in names]


@pytest.mark.slow
def test_at_a_bound_the_others_are_given_as_if_it_were_stated(elastic):
    found = fit(replace(elastic, free=(*FREE, Free("damping", 1e-4, 3.0))), starts=4)
    assert found.verdict == "not_identified" and all(p.ci95 is None for p in found.parameters.values())
    assert found.parameters["damping"].at_bound == "lower" and found.conditional.condition.startswith("damping is 100")
    ends = told(found, ("stiffness", "exponent"))
    np.testing.assert_allclose(ends, told(fit(elastic, starts=4), ("stiffness", "exponent")), rtol=0.02)
    for (low, high), true in zip(ends, (STIFFNESS, EXPONENT), strict=True):
        assert low < true < high
    assert found.conditional.parameters["damping"].ci95 is None
    assert all(found.conditional.parameters[n].with_budget for n in ("stiffness", "exponent"))
    printed, content = text(found), as_json(found)["conditional"]
    assert "if damping is 100" in printed and "95 % interval, if so" in printed
    assert content["parameters"]["stiffness"]["ci95"] == ends[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_a_bound_on_a_linear_scale_is_held_too(elastic):
    """The exponent, whose bounds leave the truth out: the stiffness is given as if that exponent were stated."""
    wide = Free("exponent", 1.45, 1.49, scale="linear")
    found = fit(replace(elastic, free=(FREE[0], wide, FREE[2])), starts=4)
    assert found.verdict == "not_identified" and found.conditional.condition == "exponent is 1.49"
    known = {**elastic.params, "exponent": found.parameters["exponent"].value}
    exactly = {"exponent": 0.0}
    stated = fit(replace(elastic, params=known, free=(FREE[0], FREE[2]), tolerances=exactly), starts=4)
    np.testing.assert_allclose(told(found, ("stiffness",)), told(stated, ("stiffness",)), rtol=0.005)


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_what_nothing_tells_apart_is_given_with_one_of_them_held(elastic):
    """Of noise that is more than half the peak: no empty table."""
    run = elastic.experiments[0]
    loud = run.channels[0].values + 0.6 * run.channels[0].values.max() * np.random.default_rng(2).standard_normal(240)
    other = replace(run, channels=(replace(run.channels[0], values=loud),))
    found = fit(replace(elastic, experiments=(other,), free=(*FREE, Free("damping", 1e-4, 3.0))), starts=4)
    assert found.verdict == "not_identified" and all(p.ci95 is None for p in found.parameters.values())
    assert found.conditional is not None and any(p.ci95 for p in found.conditional.parameters.values())
    assert " is " in found.conditional.condition and "95 % interval, if so" in text(found)


@pytest.mark.slow
def test_what_is_identified_has_no_condition(elastic):
    found = fit(elastic, starts=4)
    assert found.verdict == "identified" and found.conditional is None and "if so" not in text(found)
