"""``bcfj verify``: good numbers pass, and each wrong number, failure and missing number fails."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
import tiers
from commands import bcfj
from test_docs import examples

from bcfj_jax import stiffness
from bcfj_jax.contact import restitution
from bcfj_jax.verification import check, command, derivatives, formulas, motion, oracles
from calibration import verification as calibrated

QUICK = ("hertz_impact", "batched_products")


def outcome(one):
    return check.carried_out(one)


def verified(*names):
    return bcfj("verify", "--only", ",".join(names))


@pytest.mark.parametrize("one", formulas.CHECKS, ids=lambda one: one.name)
def test_formulas_pass(one):
    row = outcome(one)
    assert row.ok and not row.error and 0.0 <= row.deviation <= row.tolerance


@pytest.mark.full
def test_the_command_passes_and_its_rows_are_complete():
    done = bcfj("verify", "--only", ",".join(QUICK), "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["exit_code"] == 0 and "2 of 2 checks passed" in found["text"]
    found = found["result"]
    assert found["passed"] and {row["name"] for row in found["checks"]} == set(QUICK)
    for row in found["checks"]:
        assert row["what"] and row["source"] and row["deviation"] <= row["tolerance"]


@pytest.mark.full
@pytest.mark.parametrize("name", tiers.ci(["joint_deflected", "joint_in_motion"], "joint_deflected"))
def test_the_joint_is_that_of_the_references(name):
    assert outcome(next(one for one in motion.CHECKS if one.name == name)).ok


def test_every_check_passes_where_the_examples_of_the_help_run():
    """``bcfj verify``, of which any other exit code than 0 fails there, takes more than a minute: it runs once."""
    assert "verify" in examples()["verify"]


# One printed number changed in its last digits but one: the check that reads it, and the constant.
WRONG = {
    "restitution_laws": ("RESTITUTION", lambda t: (*t[:-1], (*t[-1][:-1], ".99155"))),
    "undamped_durations": ("UNDAMPED_DURATIONS", lambda t: t | {1.5: "2.943255"}),
    "sphere_stiffness": ("BALL_ON_FLAT", lambda t: "1.3486e10"),
    "chung_ooi_formulas": ("CHUNG_OOI", lambda t: (t[0], t[1]._replace(speed=0.2001))),
    "groove_races": ("RACES", lambda t: ((*t[0][:2], t[0][2].replace("33.2", "34.2")), *t[1:])),
    "hunt_crossley": ("HUNT_CROSSLEY", lambda t: t * (1 + 1e-5)),
    "chain": ("CHAIN", lambda t: t | {(5, 1.5): (*t[5, 1.5][:-1], t[5, 1.5][-1] + 1e-5)}),
}


# What they compile takes seconds.
COSTLY = {"hunt_crossley": pytest.mark.full, "chain": pytest.mark.slow}


@pytest.mark.parametrize("name", [pytest.param(x, marks=COSTLY.get(x, ())) for x in WRONG])
def test_a_wrong_number_fails(name, monkeypatch):
    constant, change = WRONG[name]
    monkeypatch.setattr(oracles, constant, change(getattr(oracles, constant)))
    done = verified(name)
    assert done.exit_code == 1, done.output
    assert "0 of 1 checks passed" in done.stdout and f"failed: {name}: deviation" in done.stdout


# A mistake of 1e-6 or so in what the package computes.
@pytest.mark.parametrize(
    ("name", "module", "function"),
    [
        ("restitution_lambert", restitution, "delivered_restitution"),
        ("elliptic_contact", stiffness, "elliptic_contact"),
        ("johnson_cylinder", stiffness, "cylinder_force"),
    ],
)
def test_a_wrong_formula_fails(name, module, function, monkeypatch):
    right = getattr(module, function)
    monkeypatch.setattr(module, function, lambda first, *more: right(first * (1 + 1e-6), *more))
    assert verified(name).exit_code == 1


def test_a_wrong_batch_fails(monkeypatch):
    # What jax 0.10.2 did: a sum of a batch that is not that of its rows.
    monkeypatch.setattr(derivatives.jax, "vmap", lambda f: lambda x: np.asarray([f(x[0])] * len(x)))
    monkeypatch.setattr(derivatives.jax, "jit", lambda f: f)
    row = outcome(derivatives.batched_products)
    assert not row.ok and row.deviation > 0.1 and not row.error


@pytest.mark.parametrize("stopped", [ValueError("no such thing"), RuntimeError("the run failed")])
def test_a_check_that_raises_fails(stopped):
    def raising():
        raise stopped

    row = outcome(check.Check("x", "a number", "a paper", 1.0, check.RELATIVE, raising))
    assert not row.ok and math.isnan(row.deviation) and str(stopped) in row.error
    assert command.document([row])["checks"][0]["deviation"] is None
    text = command.table([row])
    assert "FAILED" in text and str(stopped) in text and "0 of 1 checks passed" in text


def test_not_a_number_fails_and_nothing_at_all_is_no_pass():
    row = outcome(check.Check("x", "a number", "a paper", 1.0, check.RELATIVE, lambda: float("nan")))
    assert not row.ok and not command.passed([row]) and not command.passed([])


def test_deviations():
    assert check.relative([1.0, 2.2], [1.0, 2.0]) == pytest.approx(0.1)
    assert check.of_largest([1.0, 0.0], [1.0, 0.1]) == pytest.approx(0.1)
    assert check.last_digits([1.234, 9.96], ["1.23", "9.9"]) == pytest.approx(0.6)
    assert math.isnan(check.relative([1.0, math.nan], [1.0, 2.0]))
    for compare in (check.relative, check.of_largest):
        with pytest.raises(ValueError, match="found"):
            compare([1.0], [1.0, 2.0])


def test_names_are_distinct_and_an_unknown_one_is_answered():
    names = [one.name for one in (*command.CHECKS, *calibrated.CHECKS)]
    assert len(set(names)) == len(names)
    assert all(one.tolerance > 0.0 and one.source for one in command.CHECKS)
    done = verified("hertz_impct")
    assert done.exit_code == 2 and "did you mean 'hertz_impact'" in done.output


def test_a_run_that_fails_is_said(monkeypatch):
    # Time that ends within the contact.
    monkeypatch.setattr(motion, "_undamped", lambda **values: motion._Struck(1.0, 1e-6, 1e-6, 1.0, 0.2))
    row = outcome(motion.hertz_impact)
    assert not row.ok and "still in contact" in row.error
