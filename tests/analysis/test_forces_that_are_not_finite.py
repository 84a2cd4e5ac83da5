"""A run that is said to be good has finite forces, in a study's batch and in a solve with derivatives.

No run that is integrated gives them on demand, so the compiled program's answer is put in its place.
"""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax.analysis.derivatives import jacobian
from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.names import Feature
from bcfj_jax.analysis.studies import batch
from bcfj_jax.core.status import NO_FORCE, OK, STEEP, STEPS, reason
from bcfj_jax.io.scenefile import load
from bcfj_jax.solve.plan import plan

IMPACT = load("impact")
HOW = plan(IMPACT.scene, "fast", 777)
SHARE = Feature("contact.contact_fraction", "contact_fraction", ("contact",))


def answers(monkeypatch, module, answer) -> None:
    monkeypatch.setattr(module, "program", lambda *given: ((lambda *arguments: answer), 0.0))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("kind", ["peak", "mean", "impulse"])
def test_a_feature_of_a_force_that_is_not_finite_fails_its_run_alone(kind, bad, monkeypatch):
    values = np.array([[1.0, 0.1], [bad, 0.2], [3.0, np.nan], [bad, 0.4], [5.0, 0.5]])
    codes = np.array([OK, OK, OK, STEPS, OK])
    answers(monkeypatch, batch, (values, codes, np.ones(5), np.full(5, 9), np.asarray(2)))
    wanted = (Feature(f"contact.{kind}", kind, ("contact",)), SHARE)
    params = {name: np.full(5, float(value)) for name, value in IMPACT.params.items()}
    found = batch.run(IMPACT.scene, batch.Points(params, np.ones(5), np.linspace(0.0, 1.0, 3)), wanted, HOW, 5)
    # A share of time that is not known is no force: its run stays good.
    assert found.reason == ["", reason(NO_FORCE, 777), "", reason(STEPS, 777), ""]
    np.testing.assert_array_equal(found.features, [[1.0, 0.1], [np.nan] * 2, [3.0, np.nan], [np.nan] * 2, [5.0, 0.5]])


def solved(monkeypatch, code=OK, **broken):
    """A solve at 4 times, 3 channels and 2 parameters; ``broken`` gives places of NaN in the values and slopes."""
    shapes = {"force": (4, 3, 3), "penetration": (4, 3), "rate": (4, 3), "state": (4, 2)}
    value = Histories(**{name: np.ones(shape) for name, shape in shapes.items()})
    slopes = Histories(**{name: np.ones((2, *shape)) for name, shape in shapes.items()})
    for field, place in broken.items():
        of = value if field == "value" else slopes
        at, parameter = place
        if field == "value":
            of.force[at] = np.inf
        else:
            getattr(of, field)[("mass", "stiffness").index(parameter)][at] = np.nan
    answers(monkeypatch, jacobian, (slopes, (value, (np.asarray(code), np.asarray(9.0), 5, 1)), np.ones(2)))
    times = np.array([0.0, 0.1, 0.2, 0.3])
    found = jacobian.level(IMPACT.scene, IMPACT.params, times, ("mass", "stiffness"), HOW)
    return found.code, found.end, found.good


@pytest.mark.parametrize(
    ("broken", "expected"),
    [
        ({}, (OK, 9.0, True)),
        ({"value": ((2, 1, 0), "")}, (NO_FORCE, 0.2, False)),
        ({"force": ((3, 0, 2), "stiffness")}, (STEEP, 0.3, False)),
        ({"state": ((1, 1), "mass")}, (STEEP, 0.1, False)),
        # The earlier of the two places; what the force lost comes first.
        ({"force": ((3, 0, 0), "mass"), "state": ((2, 0), "stiffness")}, (STEEP, 0.2, False)),
        ({"value": ((3, 0, 0), ""), "force": ((1, 0, 0), "mass")}, (NO_FORCE, 0.3, False)),
        # A penetration apart from contact may have a slope that is not known.
        ({"penetration": ((1, 0), "mass"), "rate": ((1, 0), "mass")}, (OK, 9.0, True)),
    ],
)
def test_a_level_is_good_where_forces_and_slopes_are_finite(broken, expected, monkeypatch):
    assert solved(monkeypatch, **broken) == expected


def test_the_first_reason_of_a_failed_run_stays(monkeypatch):
    broken = {"value": ((0, 0, 0), ""), "force": ((0, 0, 0), "mass")}
    assert solved(monkeypatch, STEPS, **broken) == (STEPS, 9.0, False)
