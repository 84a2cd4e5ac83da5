"""What verbs take: values of any type and unit become the same run; traced values pass; messages name the place."""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers

import bcfj_jax as bj
import calibration
from bcfj_jax.core.quantities import whole
from bcfj_jax.core.status import OK
from bcfj_jax.core.upward import NAMES, upward
from bcfj_jax.mechanism.model import Reading, Solution
from bcfj_jax.solve.plan import Plan
from bcfj_jax.solve.simulation import story
from bcfj_jax.xla import programs

SCENE = bj.scenes.impact()
PARAMS = SCENE.parameters(mass=0.5)
TIMES = np.linspace(0.0, 60e-6, 61)


@pytest.fixture(scope="module")
def usual():
    return bj.simulate(SCENE, PARAMS, TIMES)


@pytest.mark.parametrize(
    "mass", [0.5, "0.5 kg", "500 g", np.float32(0.5), np.array(0.5), jnp.asarray(0.5, jnp.float32), jnp.asarray(0.5)]
)
def test_whatever_a_number_is_the_run_is_the_same_and_nothing_compiles(usual, mass):
    traced = len(programs.traced)
    found = bj.simulate(SCENE, {**PARAMS, "mass": mass}, TIMES)
    assert len(programs.traced) == traced
    np.testing.assert_array_equal(found.force["contact"], usual.force["contact"])


def test_whole_numbers_and_lists_of_times_are_taken(usual):
    assert bj.simulate(SCENE, {**PARAMS, "mass": 1}, TIMES.tolist()).status == "ok"
    assert bj.simulate(SCENE, PARAMS, jnp.asarray(TIMES, jnp.float64), accuracy="1 %").status == usual.status


def test_units_are_those_of_the_parameter():
    params = SCENE.parameters(stiffness="20 GN/m^1.5", clearance_contact="20 um", approach_speed="1 m/s")
    assert [float(params[name]) for name in ("stiffness", "clearance_contact")] == [2e10, 2e-5]
    with pytest.raises(bj.InputError, match="scene 'impact' clearance_contact: '20 kg'"):
        SCENE.parameters(clearance_contact="20 kg")


def test_a_contacts_own_name_overrides_what_is_there():
    other = bj.scenes.backlash()
    assert "clearance_stop" in other.parameters()
    usual, own, both = (
        bj.simulate(other, {**other.parameters(), **more}, [0.0, 1e-5]).penetration["stop"]
        for more in ({}, {"stop.clearance": "1 um"}, {"clearance_stop": 1e-6})
    )
    np.testing.assert_array_equal(own, both)
    assert not np.allclose(own, usual, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_traced_values_pass(usual):
    def peak(mass):
        return bj.force_history(SCENE, {**PARAMS, "mass": mass}, TIMES)["contact"][:, 0].max()

    many = jax.jit(jax.vmap(peak))(jnp.array([0.5, 0.6]))
    assert float(many[0]) == pytest.approx(usual.force["contact"][:, 0].max()) and many[1] > many[0]
    # Its trace alone: what derivatives are worth is asked in analysis/test_derivatives.py, and compiling takes long.
    assert jax.eval_shape(jax.grad(peak), 0.5).shape == ()
    with pytest.raises(bj.InputError, match=r"bj\.force_history"):
        jax.jit(lambda mass: bj.simulate(SCENE, {**PARAMS, "mass": mass}, TIMES).times)(0.5)


def test_the_message_names_what_is_missing_and_what_is_near():
    less = {name: value for name, value in PARAMS.items() if name != "mass"}
    for verb in (bj.simulate, bj.force_history):
        with pytest.raises(bj.InputError, match="'mass' has no value"):
            verb(SCENE, less, TIMES)
        with pytest.raises(bj.InputError, match="did you mean 'stiffness'"):
            verb(SCENE, {**PARAMS, "stifness": 1.0}, TIMES)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_run_whose_force_is_not_finite_has_failed(bad):
    force = np.zeros((4, 3))
    force[2:, 0] = bad
    readings = {"contact": Reading(force, np.zeros(4), np.zeros(4))}
    solution = Solution(np.zeros((4, 2)), np.asarray(OK), np.asarray(3.0), np.asarray(9), np.asarray(0))
    walls = {"wall_s": 0.0, "compile_s": 0.0}
    run = story(SCENE, np.arange(4.0), solution, readings, Plan(np.asarray(1e-3)), walls)
    assert (run.status, run.failure_time) == ("failed", 2.0)
    assert run.reason == "a contact force stopped being finite"


def test_a_law_that_lacks_something_says_what_and_shows_one():
    class Lawless(bj.laws.AbstractLaw):
        """Nothing."""

    class One(bj.laws.AbstractElastic):
        """A text where names are wanted."""

        needs = "stiffness"

        def force(self, penetration, c):
            """Nothing."""
            return penetration

    with pytest.raises(bj.InputError, match=r"class Lawless: it lacks force and needs; .*\nclass Linear"):
        Lawless()
    with pytest.raises(bj.InputError, match=r'needs = \("stiffness",\)'):
        One()
    with pytest.raises(bj.InputError, match=r"give an object of it: MemoryFree\(\)"):
        bj.Contact("c", ("ground", "b"), bj.gaps.PointOnPlane("x"), bj.laws.MemoryFree)


def test_a_load_that_lacks_something_says_what_and_shows_one():
    class Idle(bj.loads.AbstractLoad):
        """Nothing."""

    class Nameless(bj.loads.AbstractLoad):
        """No name."""

        def actions(self, t, bodies, p):
            """Nothing."""
            return []

    with pytest.raises(bj.InputError, match=r"class Idle: it lacks actions and name; .*\nclass Pull"):
        Idle()
    with pytest.raises(bj.InputError, match=r"class Nameless: it lacks name; "):
        Nameless()
    known = {"bj": bj, "eqx": eqx}
    exec(bj.loads.AbstractLoad.example, known)
    bodies = [bj.Body("mass", joint="slide")]
    made = bj.Mechanism("pulled", bodies, loads=[known["Pull"]()], given={"mass.mass": 2.0})
    assert bj.simulate(made, made.parameters(), [0.0, 1.0]).status == "ok"
    for bad, found in (
        (known["Pull"], r"give an object of it: Pull\("),
        (lambda t, bodies, p: [], r'bj.Load\("my_load", '),
        ("gravity", r"'gravity' is no load; .*\nclass Pull"),
    ):
        with pytest.raises(bj.InputError, match=found):
            bj.Mechanism("pulled", bodies, loads=[bad])
    for bad, found in ((lambda *_: [(1.0, 0.0)], "is no Action"), (lambda *_: [bj.loads.Action("mas")], "'mas'.*mass")):
        wrong = bj.Mechanism("pulled", bodies, loads=[bj.Load("mine", bad)], given={"mass.mass": 2.0})
        with pytest.raises(bj.InputError, match=rf"load 'mine'.*{found}"):
            bj.simulate(wrong, wrong.parameters(), [0.0, 1.0])


@pytest.mark.parametrize("kind", ["AbstractLaw", "AbstractElastic", "AbstractFriction"])
def test_the_examples_of_messages_are_right(kind):
    known = {"bj": bj, "jnp": jnp}
    exec(getattr(bj.laws, kind).example, known)
    (made,) = [x for x in known.values() if isinstance(x, type) and issubclass(x, getattr(bj.laws, kind))]
    made()


def test_what_is_used_of_upper_layers_is_there():
    assert all(callable(upward(name)) for name in NAMES)


def test_whole_numbers():
    assert whole("n", np.int64(3)) == 3
    for bad in (True, 0, 1.0, "1", None, 10**12):
        with pytest.raises(bj.InputError, match="whole number"):
            whole("n", bad)


OUT_OF_RANGE = {
    "mass": -1.0,
    "stiffness": -1e9,
    "exponent": 0.5,
    "approach_speed": -1.0,
    "clearance_contact": -1e-6,
    "damping": -1.0,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", tiers.ci(OUT_OF_RANGE, "clearance_contact"))
def test_traced_parameters_out_of_range_make_all_of_a_run_nan(name):
    """No value, no reading and no derivative is a plausible number, and the lanes beside it do not know of it."""
    scene, times = bj.scenes.impact(), np.linspace(0.0, 60e-6, 13)
    params = scene.parameters()

    def forces(x):
        return bj.force_history(scene, {**params, name: x}, times)["contact"]

    def place(x):
        return bj.reading_history(scene, {**params, name: x}, times, ["body.place.x"])["body.place.x"]

    good = float(params[name])
    lanes = np.asarray(jax.vmap(forces)(jnp.array([good, OUT_OF_RANGE[name], good])))
    assert np.isnan(lanes[1]).all()
    np.testing.assert_array_equal(lanes[0], lanes[2])
    np.testing.assert_allclose(lanes[0], forces(good), rtol=1e-9, atol=1e-9 * np.abs(lanes[0]).max())
    assert np.isnan(jax.jit(place)(OUT_OF_RANGE[name])).all()
    assert np.isnan(jax.jacfwd(lambda x: jnp.sum(forces(x)))(OUT_OF_RANGE[name]))
    with pytest.raises(bj.InputError, match="out of range"):
        forces(OUT_OF_RANGE[name])


def test_a_model_shows_itself_on_a_screen():
    for kind in ("impact", "chain", "joint", "four_bar", "slider_guide"):
        lines = repr(getattr(bj.scenes, kind)()).splitlines()
        assert len(lines) <= 24 and max(map(len, lines)) <= 100, kind
        assert f"'{kind}'" in lines[0] or kind in lines[0]


def test_dir_holds_public_names_alone():
    for module in (bj, calibration):
        names = dir(module)
        assert len(names) == len(set(names)) and all(hasattr(module, name) for name in names)
        assert [name for name in names if name.startswith("_")] == ["__version__"]
    assert {"simulate", "scenes", "Mechanism"} <= set(dir(bj)) and not {"annotations", "importlib", "core"} & set(
        dir(bj)
    )


def test_programs_run_where_jit_is_disabled():
    scene, times = bj.scenes.impact(), np.linspace(0.0, 60e-6, 13)
    usual = bj.simulate(scene, scene.parameters(), times)
    with jax.disable_jit():
        found = bj.simulate(scene, scene.parameters(), times)
    np.testing.assert_array_equal(found.force["contact"], usual.force["contact"])


_BALL = bj.Body("ball", "slide", axis="x", mass=1.0)
_TOUCH = bj.Contact("touch", ("ground", "ball"), bj.gaps.SphereOnPlane())


def _body(**more):
    return bj.Body("ball", "slide", **{"axis": "x", "mass": 1.0, **more})


def _contact(**more):
    return bj.Contact("touch", gap=bj.gaps.SphereOnPlane(), **{"between": ("ground", "ball"), **more})


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: bj.Mechanism([_BALL], [_TOUCH]), r"mechanism bodies: Contact.* is no body; give bj.Mechanism\(\"name\","),
        (lambda: bj.Mechanism("m", _BALL, [_TOUCH]), "mechanism bodies: Body.* is no list"),
        (lambda: bj.Mechanism("m", {"ball": _BALL}), "mechanism bodies: .* is no list"),
        (lambda: bj.Mechanism("m", [_BALL], None), "mechanism contacts: None is no list"),
        (lambda: bj.Mechanism("m", [_BALL], [bj.loads.Gravity()]), "mechanism contacts: Gravity.* is no contact"),
        (lambda: bj.Mechanism("m", [_BALL], [], bj.loads.Gravity()), "mechanism loads: Gravity.* is no list"),
        (lambda: bj.Mechanism(3, [_BALL]), "mechanism 3 kind: 3; give a text"),
        (lambda: bj.Mechanism("m", [_BALL], given=3), "mechanism given: 3 is no table by names"),
        (lambda: bj.Mechanism("m", [_BALL], implicit="yes"), "implicit: 'yes'; give True, False or None"),
        (lambda: bj.Mechanism("m", [_BALL], scale=3), "scale: 3; give a function"),
        (lambda: _body(mass=[1.0]), "body 'ball' mass: .*; give a number in SI units"),
        (lambda: _body(mass=True), "body 'ball' mass: True; give a number in SI units"),
        (lambda: _body(start=[0.0, 1.0]), "body start: .* is no table by names"),
        (lambda: _body(at=3), "body 'ball' at: 3; give three numbers"),
        (lambda: _body(inertia=np.eye(3)), "body 'ball' inertia: 3 numbers or rows"),
        (lambda: _body(parent=_BALL), "body 'ball' parent: .*; give its name, 'ball'"),
        (lambda: _body(drive="ramp"), "body 'ball' drive: 'ramp' is no drive; give bj.Drive"),
        (lambda: _contact(at=(0.0, 0.0, 0.0)), "contact 'touch' at: .*; give a place in each body's axes"),
        (lambda: _contact(between="ball"), "contact 'touch' between: .*; give the names of two bodies"),
        (lambda: _contact(values=[1.0]), "contact values: .* is no table by names"),
        (lambda: bj.Mechanism("m", [_BALL], [], [bj.loads.Gravity(9.81)]), "direction: axis 9.81 is not a direction"),
        (lambda: bj.Mechanism("m", [_BALL], [], [bj.loads.Force("push", _BALL)]), "body: .*; give its name, 'ball'"),
        (lambda: bj.Mechanism("m", [_BALL], [], [bj.loads.Force("push", "ball", "up")]), "direction: no axis 'up'"),
        (lambda: bj.Mechanism("m", [_BALL], [], [bj.Load("push", 3)]), "load 'push' function: 3; give a function"),
    ],
)  # fmt: skip
def test_parts_that_are_none_say_where_and_what_would_be_right(made, said):
    with pytest.raises(bj.InputError, match=f"(?s){said}"):
        made()


class _Twice(bj.laws.AbstractLaw):
    needs = ("stiffness",)

    def force(self, penetration, rate, coefficients):
        return jnp.stack(2 * [coefficients["stiffness"] * penetration])


@pytest.mark.parametrize(
    ("law", "load", "said"),
    [
        (_Twice(), None, r"law _Twice: a force of shape \(2,\) for a penetration of shape \(\)"),
        ("hertz", bj.Load("push", lambda t, bodies, p: [bj.loads.Action("ball", (1.0, 0.0))]), "Action with force = "),
    ],
)
def test_what_a_users_code_returns_has_its_shape(law, load, said):
    contact = bj.Contact("touch", ("ground", "ball"), bj.gaps.SphereOnPlane(), law)
    given = {"stiffness": 1e6, "radius": 0.01} | ({"exponent": 1.5} if load else {})
    scene = bj.Mechanism("m", [_BALL], [contact], [load] if load else [], given=given)
    with pytest.raises(bj.InputError, match=said):
        bj.simulate(scene, scene.parameters(), [0.0, 1e-3])


_SWING = bj.Body("arm", "hinge", mass=1.0, inertia=1.0)
_BETWEEN = {"name": "own", "between": ("ground", "ball"), "stiffness": 1.0}
_MADE = {
    "Mechanism": (bj.Mechanism, {"kind": "m", "bodies": [_BALL]}),
    "Body": (bj.Body, {"name": "ball", "mass": 1.0, "inertia": 1.0}),
    "Drive": (bj.Drive, {"speed": 1.0}),
    "Contact": (bj.Contact, {"name": "touch", "between": ("ground", "ball"), "gap": bj.gaps.SphereOnPlane()}),
    "SphereInSocket": (bj.gaps.SphereInSocket, {}),
    "BallInGroove": (bj.gaps.BallInGroove, {}),
    "MemoryFree": (bj.laws.MemoryFree, {}),
    "Gravity": (bj.loads.Gravity, {}),
    "Force": (bj.loads.Force, {"name": "own", "body": "ball"}),
    "Spring": (bj.loads.Spring, _BETWEEN),
    "Bush": (bj.loads.Bush, _BETWEEN),
    "JointSpring": (bj.loads.JointSpring, {"name": "own", "body": "ball", "stiffness": 1.0}),
    "JointFriction": (bj.loads.JointFriction, {"name": "own", "body": "ball", "sliding": 1.0, "speed": 1.0}),
    "Coupling": (bj.loads.Coupling, {"name": "own", "joints": ("ball", "arm"), "ratio": 1.0, "stiffness": 1.0}),
}


@pytest.mark.parametrize("part", _MADE)
def test_no_value_of_a_field_ends_in_an_error_of_pythons(part):
    """Every field of every part, with values of every kind: it is taken, or refused by its place."""
    make, usual = _MADE[part]
    values = (
        "x",
        "",
        3,
        -1,
        np.nan,
        True,
        None,
        [],
        [1.0],
        ["a", "b"],
        {},
        {"a": 1.0},
        [[1, 2], [3]],
        int,
        1j,
    )
    refused = 0
    for field in dataclasses.fields(make):
        if field.name == "life":
            continue
        for value in values:
            try:
                found = make(**{**usual, field.name: value})
                if isinstance(found, bj.loads.AbstractLoad):
                    bj.Mechanism("m", [_BALL, _SWING], loads=[found])
            except bj.InputError:
                refused += 1
    assert refused
