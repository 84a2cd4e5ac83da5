"""Settings that verbs take as keywords: shown with their defaults, typed alike, and no others."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import typing
from pathlib import Path

import pytest

import bcfj_jax as bj
import calibration
from bcfj_jax import nonlinear

ROOT = Path(__file__).resolve().parents[2]
VERBS = {
    bj.simulate: "accuracy='balanced', max_steps=400000, solver=None, measure_error=False, read=(), resolved_peaks=False, "
    "longest_step=None",
    bj.sensitivity: "accuracy='balanced', max_steps=400000, average=0.005, levels=6, features=(), mode='auto', certify=True, "
    "differences='direction', steady=False, budget=None, tell=None",
    bj.smoothing_ladder: "knob='smoothing', accuracy='balanced', max_steps=400000, average=0.005, levels=6",
    bj.hessian_vector: "accuracy='reference', max_steps=400000",
    bj.contact_events: "features=(), accuracy='balanced', max_steps=400000",
    nonlinear.stroboscopic: "accuracy='balanced', max_steps=400000, transients=20, phase=0.0, period=None",
    nonlinear.bifurcation: "places=8, accuracy='balanced', max_steps=400000, transients=20, phase=0.0, period=None",
    nonlinear.impact_bifurcation: "accuracy='balanced', max_steps=400000, contact='contact', samples=10001, places=8",
    nonlinear.map_exponent: "interval=1.0, transients=0, batches=20, seed=0",
    nonlinear.flow_exponent: "tolerance=1e-07, max_steps=100000, transients=0, batches=20, seed=0",
    nonlinear.two_trajectories: "separation=1e-07, scales=1.0, interval=1.0, transients=0, batches=20, seed=0",
    nonlinear.scene_exponent: "interval=None, settle=None, accuracy=1e-05, max_steps=400000, batches=10, seed=0",
    calibration.fit: "seed=0, starts=12, journal=None, intervals='covariance', systematic=True, tell=None",
}  # fmt: skip


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_a_verb_shows_its_keywords_and_takes_no_others(verb):
    shown = [p for p in inspect.signature(verb).parameters.values() if p.kind is p.KEYWORD_ONLY]
    assert ", ".join(f"{p.name}={p.default!r}" for p in shown if p.default is not p.empty) == VERBS[verb]
    assert verb.__doc__
    with pytest.raises(TypeError, match=re.escape(f"{verb.__name__}() got an unexpected keyword argument 'acuracy'")):
        verb(None, None, None, acuracy=1)


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.__name__)
def test_a_verb_shows_its_own_source_and_types(verb):
    assert f"def {verb.__name__}(" in inspect.getsource(verb)
    assert "return" in typing.get_type_hints(verb)


def test_keywords_are_typed_as_the_settings_are():
    pairs = 0
    for path in (p for package in ("bcfj_jax", "calibration") for p in (ROOT / package).rglob("*.py")):
        for name in re.findall(r"^class (\w+)Keys\(", path.read_text(encoding="utf-8"), re.MULTILINE):
            module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
            keys, kind = getattr(module, f"{name}Keys"), getattr(module, name)
            types = {field.name: field.type for field in dataclasses.fields(kind)}
            assert {key: hint.__forward_arg__ for key, hint in keys.__annotations__.items()} == types
            pairs += 1
    assert pairs == 10
