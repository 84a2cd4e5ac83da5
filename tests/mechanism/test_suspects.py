"""Which of many runs must be looked at one by one before a study: none that ``check`` would refuse is left out."""

from __future__ import annotations

import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import InputError
from bcfj_jax.contact.gaps import PointOnPlane
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Gravity
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import AbstractModel


def drop(law: str = "hertz", smoothing: bool = False) -> Mechanism:
    body = Body("body", "slide", axis="y", mass=0.1, start={"position": "height", "velocity": "speed"})
    surface = Contact("floor", ("ground", "body"), PointOnPlane("y"), law, smoothing=smoothing)
    own = ((Quantity("height", "m", "height at time 0"), 0.1), (Quantity("speed", "m/s", "speed at time 0"), 0.0))
    given = {
        name: x for name, x in {"stiffness": 1e9, "exponent": 1.5, "restitution": 0.8}.items() if name in surface.reads
    }
    return Mechanism("drop", (body,), (surface,), (Gravity("-y"),), own=own, given=given, end=1.0)


def many(scene, **columns: list[float]) -> dict[str, np.ndarray]:
    count = len(next(iter(columns.values())))
    return {k: np.array(columns.get(k, [float(v)] * count)) for k, v in scene.parameters().items()}


def refused(scene, params: dict[str, np.ndarray]) -> np.ndarray:
    def one(k: int) -> bool:
        try:
            scene.check({name: float(x[k]) for name, x in params.items()})
        except InputError:
            return True
        return False

    return np.array([one(k) for k in range(len(next(iter(params.values()))))])


def test_bodies_that_start_apart_are_none_and_deep_ones_are():
    scene = drop()
    params = many(scene, height=[0.1, -1e-12, -0.01, 0.0, float("nan")], speed=[0.0, 0.0, 0.0, -1.0, 0.0])
    assert scene.suspects(params).tolist() == [False, False, True, False, True]
    assert refused(scene, params).tolist() == [False, False, True, False, True]


def test_all_are_where_the_first_is_refused_or_a_regularised_contact_may_push_too_early():
    scene = drop()
    assert scene.suspects(many(scene, height=[-0.01, 0.1])).all()
    scene = drop("flores", smoothing=True)
    assert scene.suspects(many(scene, height=[0.1, 0.2])).all()


@pytest.mark.parametrize("seed", range(3))
def test_none_that_is_refused_is_left_out(seed):
    scene, draw = drop(), np.random.default_rng(seed)
    params = many(
        scene, height=[0.1, *(-(10.0 ** draw.uniform(-9, -2, 15)))], speed=[0.0, *(-(10.0 ** draw.uniform(-3, 2, 15)))]
    )
    bad = refused(scene, params)
    assert 0 < bad.sum() < len(bad) and (scene.suspects(params) | ~bad).all()


def test_a_model_that_does_not_know_has_all_looked_at():
    scene = drop()
    assert AbstractModel.suspects(scene, many(scene, height=[0.1, 0.2])).all()


# Each column with values that pass and values that do not.
JOINTS = {
    "clearances": {"clearance_seat_cage": (0.0, 2e-2), "clearance_cage_ball": (-1e-5, 1e-4)},
    "sizes": {"pitch_radius": (0.03, 0.045), "seat_radius": (0.036, 0.045), "ball_radius": (0.006, 0.012)},
    "angles": {"joint_angle": (0.0, 1.2), "contact_angle": (0.5, 1.7), "offset": (0.0, 9e-3)},
    "what no check reads": {"stiffness": (1e10, 1e11)},
}


@pytest.mark.parametrize(
    "options", [{}, {"spin": False, "bands": False, "window_ends": False}, {"fidelity": "kinematic"}]
)
@pytest.mark.parametrize("name", JOINTS)
def test_none_of_the_joints_that_are_refused_is_left_out(name, options):
    scene, draw = bj.scenes.make("joint", **options), np.random.default_rng(1)
    params = scene.parameters()
    columns = {
        key: np.r_[float(params[key]), low, draw.uniform(low, high, 38)] for key, (low, high) in JOINTS[name].items()
    }
    given = {key: columns.get(key, np.full(40, float(x))) for key, x in params.items()}
    bad = refused(scene, given)
    found = scene.suspects(given)
    assert (found | ~bad).all() and not found[0]
    # And next to none is looked at in vain.
    assert (found & ~bad).sum() <= 1
    assert bad.any() != (name == "what no check reads")


@pytest.mark.slow
def test_a_speed_that_is_not_remembered_is_said():
    body = Body("body", "slide", axis="y", mass=0.1, start={"position": "height", "velocity": "speed"})
    floor = Contact("floor", ("ground", "body"), PointOnPlane("y"), "exact", smoothing=False)
    own = ((Quantity("height", "m", "height at time 0"), 1e-4), (Quantity("speed", "m/s", "speed at time 0"), 0.0))
    given = {"stiffness": 1e9, "exponent": 1.5, "restitution": 0.7}
    scene = Mechanism("drop", (body,), (floor,), (Gravity("-y"),), own=own, given=given, end=1.0)
    for height, said in ((1e-4, False), (2e-8, True)):
        params, fall = scene.parameters({"height": height}), np.sqrt(2.0 * height / 9.81)
        run = bj.simulate(scene, params, np.linspace(0.0, fall + 6e-4, 3001), read=["body.velocity.y"])
        speed, met = run.readings["body.velocity.y"], np.sqrt(2.0 * 9.81 * height)
        # Off by more than a twentieth where, and only where, it is said.
        assert (abs(np.max(speed) / met / 0.7 - 1.0) > 0.05) == said
        assert (run.status == "doubtful") == said
        assert ("restitution is not the one asked for" in run.reason) == said
        assert not said or abs(run.failure_time / fall - 1.0) < 0.05
