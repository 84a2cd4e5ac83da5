"""Features are defined once: a row of a table is in every verb, with its derivative and its unit."""

from __future__ import annotations

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import bcfj

import bcfj_jax as bj
from bcfj_jax.analysis import features
from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.measures import measure, vector
from bcfj_jax.analysis.derivatives.names import feature, feature_unit, smooth
from bcfj_jax.analysis.features import EVENTS, KINDS, Kind
from bcfj_jax.analysis.studies import block
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.core.dual import backend
from calibration import Experiment, Free, Observation, Problem
from calibration.forward import model

# An impact without loss: T = c (m/K)^(2/5) v^(-1/5), c = 2.9432 (5/4)^(2/5).
SCENE = bj.scenes.impact("hertz", smoothing=False)
AT = {"stiffness": 1e10, "exponent": 1.5, "mass": 0.02, "approach_speed": 1.5}
PARAMS = SCENE.parameters(AT)
LASTS = 2.943275 * (1.25 * 0.02 / 1e10) ** 0.4 * 1.5**-0.2
TIMES = np.linspace(0.0, 1.25 * LASTS, 1001)
NAMES = ["contact.duration", "contact.duration_1"]


def histories(t, shift):
    """A force of two channels whose contacts move with a shift."""
    wave = np.stack([np.sin(9.0 * (t - shift) - 0.3), np.sin(7.0 * (t - 2.0 * shift) - 0.4)], axis=1)
    force = np.zeros((t.size, 2, 3))
    force[..., 0] = 1e3 * np.maximum(wave, 0.0) * (1.0 + shift)
    return Histories(force, 1e-5 * wave, np.gradient(1e-5 * wave, t, axis=0), None)


def slopes(t):
    """Central differences of the histories."""
    high, low = (histories(t, s * 1e-6) for s in (1.0, -1.0))
    return Histories(*((a - b)[None] / 2e-6 for a, b in zip(high[:3], low[:3], strict=True)), None)


def test_a_row_is_all_that_a_new_feature_takes(monkeypatch):
    def energy(s):
        return backend(s.force).sum(s.force * s.force)

    monkeypatch.setitem(KINDS, "energy", Kind("N^2", "sum of squares", energy, 2, steps=lambda x, end: x["peak"] ** 2))
    t, contacts = np.linspace(0.0, 2.0, 801), {"a": 2}
    wanted = [feature("a.energy", contacts), feature("a_2.duration", contacts)]
    assert [feature_unit(f.name) for f in wanted] == ["N^2", "s"] and smooth("energy")
    value, by = histories(t, 0.0), slopes(t)
    numbers, own = measure(t, value, by, wanted, contacts, True)
    low, high = (measure(t, histories(t, s), by, wanted, contacts, True)[0] for s in (-1e-6, 1e-6))
    assert own[:, 0] == pytest.approx((high - low) / 2e-6, rel=1e-5)

    def function(force, depth):
        return vector(t, Histories(force, depth, None, None), wanted, contacts, {})

    at, along = ([jnp.asarray(x) for x in pair] for pair in (value[:2], (by.force[0], by.penetration[0])))
    traced = jax.jvp(function, tuple(at), tuple(along))
    assert np.asarray(traced[0]) == pytest.approx(numbers, rel=1e-12)
    assert np.asarray(traced[1]) == pytest.approx(own[:, 0], rel=1e-9)
    seen = features.summary(t, value.force[:, 0, 0], value.penetration[:, 0], value.rate[:, 0])
    assert seen["energy"] == pytest.approx(np.sum(value.force[:, 0, 0] ** 2))


def test_rows_say_what_they_are():
    for name, row in {**KINDS, **EVENTS}.items():
        assert row.unit and row.meaning, name
    for name in features.NAMED:
        place = "a:b" if name == features.PAIR else "a"
        assert feature(f"{place}.{name}", {"a": 0, "b": 0}).kind == name
    assert {feature_unit(f"a.{name}_1") for name in EVENTS} == {"s", "N", "N s"}


@pytest.mark.slow
def test_a_duration_is_differentiated_by_sensitivity_study_and_fit():
    wrt = ("stiffness", "mass", "approach_speed")
    exact = np.array([-0.4, 0.4, -0.2]) * LASTS / [AT[name] for name in wrt]

    def sensitivity(values):
        return bj.sensitivity(SCENE, SCENE.parameters(values), TIMES, wrt, features=NAMES, certify=False)

    found = sensitivity(AT)
    assert [feature_unit(name) for name in NAMES] == ["s", "s"]
    for name in NAMES:
        assert found.features[name] == pytest.approx(LASTS, rel=1e-5)
        assert [found.feature_derivatives[p][name] for p in wrt] == pytest.approx(exact, rel=1e-4)
        high, low = (sensitivity({**AT, "mass": 0.02 * (1.0 + s)}).features[name] for s in (1e-3, -1e-3))
        assert found.feature_derivatives["mass"][name] == pytest.approx((high - low) / 4e-5, rel=1e-4)
    train = bj.contact_events(SCENE, PARAMS, TIMES, wrt)
    assert train.features["contact.duration_1"] == train.trains["contact"].duration[0] == pytest.approx(LASTS, rel=1e-5)
    assert train.derivative["mass"]["contact"].duration[0] == pytest.approx(exact[1], rel=1e-4)
    # A study, of the runs' samples and with derivatives, and of single contacts.
    table = {
        "scene": {
            "scene": {"kind": "impact", "law": "hertz", "smoothing": False}, "parameters": AT,
            "time": {"end": float(TIMES[-1]), "samples": TIMES.size},
        },
        "vary": {"mass": {"values": [0.02, 0.03]}},
    }  # fmt: skip
    for more in ({"features": NAMES[:1]}, {"features": NAMES, "derivatives": ["stiffness"]}):
        study = from_table({**table, "results": more})
        rows = block.compute(study, np.arange(2), 2).results
        count = len(more["features"])
        assert rows[0, :count] == pytest.approx([LASTS] * count, rel=1e-5)
        assert rows[0, count:] == pytest.approx([exact[0]] * (len(rows[0]) - count), rel=1e-4)
    # A fit.
    seen = tuple(Observation(name, LASTS, 0.01 * LASTS) for name in NAMES)
    one = Experiment("a", np.zeros(0), (), features=seen, span=float(TIMES[-1]))
    built = model.build(Problem(SCENE, PARAMS, (one,), (Free("mass", 0.01, 0.04),), 1e-6), (one,))
    residuals, jacobian = model.residuals_and_jacobian(built, jnp.asarray(built.point(np.array([0.02]))))
    np.testing.assert_allclose(residuals, 0.0, atol=0.01)
    # d ln T/d ln m = 0.4, in units of 1 %, over a box of ln 4.
    assert jacobian[:, 0] == pytest.approx([40.0 * np.log(4.0)] * 2, rel=1e-3)


@pytest.mark.slow
def test_the_shortest_contact_of_a_design_has_the_stiffest_spring():
    found = bj.design(SCENE, PARAMS, TIMES, "contact.duration", {"stiffness": (5e9, 2e10)}, starts=2)
    assert found.unit == "s" and found.values["stiffness"] == pytest.approx(2e10, rel=1e-6)
    assert found.after == pytest.approx(LASTS * 0.5**0.4, rel=1e-4)


@pytest.mark.slow
def test_commands_show_a_duration(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = bcfj("simulate", "impact", "--out", "run")
    assert done.exit_code == 0, done.stderr
    told = json.loads(Path("run/summary.json").read_text())
    one = told["contacts"]["contact"]
    assert told["units"]["duration"] == "s"
    assert one["duration"] == pytest.approx(one["contact_end"] - one["contact_start"], rel=1e-9)
    assert "duration" in done.stdout and "duration" in Path("run/report.html").read_text()
    asked = ["sensitivity", "impact", "--wrt", "stiffness", "--features", ",".join(NAMES), "--out", "by"]
    done = bcfj(*asked)
    assert done.exit_code == 0, done.stderr
    told = json.loads(Path("by/certificate.json").read_text())["features"]
    assert [told[name]["unit"] for name in NAMES] == ["s", "s"] and all(name in done.stdout for name in NAMES)
