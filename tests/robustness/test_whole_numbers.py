"""Every whole number that a public function takes may be one of NumPy's, and none costs memory before it is refused."""

from __future__ import annotations

import inspect
import types

import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from attacks import _problem

import bcfj_jax as bj
import calibration
from bcfj_jax import InputError, nonlinear

pytestmark = pytest.mark.full
TIMES = np.linspace(0.0, 60e-6, 31)
SCENE = bj.scenes.impact()
PARAMS = SCENE.parameters()
DRIVEN = bj.scenes.backlash()
N = np.int32


def _study(out, **options):
    content = {
        "scene": {"scene": {"kind": "impact"}, "time": {"end": "60 us", "samples": 31}},
        "vary": {"mass": {"lower": 0.1, "upper": 0.2, "steps": 2}},
        "results": {"features": ["contact.peak"]},
    }
    return bj.study(content, out, **options)


def _design(**options):
    few = {"starts": N(2), "iterations": N(2), "samples": N(2)} | options
    free = {"damping": (0.0, 1.0)}
    return bj.design(SCENE, PARAMS, TIMES, "contact.peak", free, confirm=None, certify=False, slices=False, **few)


def _logistic(x, r=3.9):
    return r * x * (1.0 - x)


def _decay(t, y):
    return -y


# Where each function that takes whole numbers is called with NumPy's in all their places.
CALLS = {
    "Body": lambda out: bj.Body("b", "particle", members=N(2)),
    "Mechanism": lambda out: bj.Mechanism("m", (bj.Body("b", "slide", mass=1.0),), samples=N(11)),
    "Plan": lambda out: bj.Plan(np.asarray(1e-6), N(1000)),
    "simulate": lambda out: bj.simulate(SCENE, PARAMS, TIMES, max_steps=N(4000)),
    "sensitivity": lambda out: bj.sensitivity(
        SCENE, PARAMS, TIMES, "mass", levels=N(2), max_steps=N(4000), differences="none"
    ),
    "smoothing_ladder": lambda out: bj.smoothing_ladder(
        SCENE, PARAMS, TIMES, "mass", [1e-7], levels=N(2), max_steps=N(4000)
    ),
    "hessian_vector": lambda out: bj.hessian_vector(
        SCENE, PARAMS, TIMES, "contact.mean", ("mass",), [1.0], max_steps=N(4000)
    ),
    "contact_events": lambda out: bj.contact_events(SCENE, PARAMS, TIMES, max_steps=N(4000)),
    "design": lambda out: _design(max_steps=N(4000), seed=N(1)),
    "study": lambda out: _study(out / "study", workers=N(1)),
    "nonlinear.map_exponent": lambda out: nonlinear.map_exponent(
        _logistic, jnp.asarray(0.3), N(200), transients=N(10), batches=N(4), seed=N(1)
    ),
    "nonlinear.two_trajectories": lambda out: nonlinear.two_trajectories(
        _logistic, jnp.asarray([0.3]), N(200), separation=1e-8, transients=N(10), batches=N(4), seed=N(1)
    ),
    "nonlinear.flow_exponent": lambda out: nonlinear.flow_exponent(
        _decay, jnp.ones(2), N(20), interval=0.1, transients=N(2), max_steps=N(1000), batches=N(4), seed=N(1)
    ),
    "nonlinear.flow_step": lambda out: nonlinear.flow_step(_decay, 0.1, max_steps=N(1000))(jnp.ones(2)),
    "nonlinear.map_bifurcation": lambda out: nonlinear.map_bifurcation(
        _logistic, 0.3, [3.2, 3.5], transients=N(10), kept=N(4)
    ),
    "nonlinear.period_number": lambda out: nonlinear.period_number(np.tile([1.0, 2.0], 8), 1e-9, most=N(4)),
    "calibration.Candidate": lambda out: calibration.Candidate("next", np.arange(3.0), {"contact.normal": 1.0}, runs=N(2)),
    "calibration.fit": lambda out: calibration.fit(_problem(), seed=N(0), starts=N(4)),
}  # fmt: skip


def _taking():
    """Public functions and classes that take whole numbers, by name."""
    found = {}
    for name in dir(bj):
        value = getattr(bj, name)
        if isinstance(value, types.ModuleType):
            own = {key: x for key, x in vars(value).items() if inspect.isfunction(x) and key[0] != "_"}
            package = value.__name__.rpartition(".")[0]
            found |= {f"{name}.{key}": x for key, x in own.items() if x.__module__.startswith(package)}
        elif callable(value):
            found[name] = value
    found |= {f"calibration.{name}": x for name in dir(calibration) if callable(x := getattr(calibration, name))}
    for name, value in found.items():
        with_int = [
            p.name for p in inspect.signature(value).parameters.values() if str(p.annotation).split(" ")[0] == "int"
        ]
        # A result is no input.
        if with_int and not hasattr(value, "_view"):
            yield name, with_int


TAKING = dict(_taking())
# Scenes are run below; what follows the drive of a mechanism needs a run of many turns, and takes its numbers by the same words.
ELSEWHERE = {"scenes.chain", "scenes.string", "nonlinear.bifurcation", "nonlinear.impact_bifurcation",
             "nonlinear.scene_exponent", "nonlinear.stroboscopic"}  # fmt: skip


def test_every_function_that_takes_whole_numbers_is_called():
    assert {name for name in TAKING if name not in CALLS} <= ELSEWHERE, TAKING
    assert len(TAKING) > 15


COSTLY = {
    "calibration.fit", "design", "contact_events", "hessian_vector", "sensitivity", "smoothing_ladder", "study",
}  # fmt: skip


@pytest.mark.parametrize("name", tiers.ci(CALLS, *(CALLS.keys() - COSTLY)))
def test_numpys_whole_numbers_are_taken(name, tmp_path):
    found = CALLS[name](tmp_path)
    assert getattr(found, "status", "ok") == "ok"


def test_scenes_take_them_too():
    joints = [bj.scenes.joint(bj.scenes.JointGeometry(balls=n)) for n in (np.int8(7), 7)]  # pyright: ignore
    assert joints[0] == joints[1]
    assert bj.scenes.chain(np.uint8(4)) == bj.scenes.chain(4)
    assert hash(bj.scenes.chain(np.int64(4))) == hash(bj.scenes.chain(4))
    assert bj.scenes.string(np.int16(2)) == bj.scenes.string(2)


@pytest.mark.parametrize(
    "asked",
    [
        lambda: calibration.fit(_problem(), starts=10**9),
        lambda: _design(starts=10**9),
        lambda: _design(samples=10**9),
        lambda: bj.scenes.chain(10**9),
        lambda: bj.scenes.string(10**9),
        lambda: bj.scenes.joint(bj.scenes.JointGeometry(balls=10**9)),
        lambda: bj.Body("b", "particle", members=10**9),
        lambda: bj.Mechanism("m", (bj.Body("b", "slide", mass=1.0),), samples=10**9),
        lambda: nonlinear.map_bifurcation(_logistic, 0.3, [3.2], transients=1, kept=10**9),
        lambda: nonlinear.map_exponent(_logistic, jnp.asarray(0.3), 10**9),
        lambda: nonlinear.stroboscopic(DRIVEN, DRIVEN.parameters(), revolutions=10**9),
    ],
)
def test_slips_of_the_hand_are_refused_before_memory_is_taken(asked):
    with pytest.raises(InputError, match="give a whole number from"):
        asked()
