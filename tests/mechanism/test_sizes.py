"""Numbers of any library are sizes; what is impossible of a body, a table or a name is refused with its reason."""

from __future__ import annotations

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax.mechanism.readings import STATES

KINDS = {
    "numpy": np.float64,
    "numpy 32": np.float32,
    "0-d": np.asarray,
    "jax": jnp.asarray,
    "whole": lambda x: x,
}
ROWS = {"list": list, "numpy": np.asarray, "jax": jnp.asarray, "numbers": lambda row: [np.float64(x) for x in row]}
PLANE = bj.gaps.PointOnPlane("y")


def made(number, row):
    """A mechanism of numbers and rows of some library."""
    arm = bj.Body(
        "arm", "hinge", at=row([0.5, 0.0, 0.25]), axis=row([0.0, 0.0, 1.0]), center=row([0.25, 0.0, 0.0]),
        mass=number(2.0), inertia=row([1.0, 2.0, 2.5]), start={"angle": number(0.5), "speed": number(0.25)},
        tilt=("x", number(0.125)),
    )  # fmt: skip
    table = row([0.0, 1.0, 2.0]), row([0.0, 0.5, 0.25])
    slide = bj.Body("slide", "slide", mass=number(1.0), drive=bj.Drive("table", table=table))
    speed = bj.Body("speed", "slide", mass=number(1.0), drive=bj.Drive("speeds", table=table, speed=number(2.0)))
    ball = bj.Body("ball", "particle", mass=number(1.0), start=[("y", number(0.5))])
    pad = bj.Contact(
        "pad", ("ground", "ball"), PLANE, at=(row([0.0, -0.5, 0.0]), row([0.0, 0.0, 0.0])),
        values={"stiffness": number(1e5), "exponent": number(1.5), "damping": number(0.125)},
    )  # fmt: skip
    loads = [
        bj.loads.Force("push", "ball", row([0.0, -1.0, 0.0]), table=table, at=row([0.0, 0.0, 0.0])),
        bj.loads.Force("steady", "ball", "x", number(2.0), ramp=number(0.5)),
        bj.loads.Spring(
            "spring", ["arm", "ball"], number(10.0), number(0.5), number(1.0), at=[row([0.5, 0.0, 0.0])] * 2
        ),
        bj.loads.JointSpring("back", "arm", number(3.0), rest=number(0.25)),
        bj.loads.Gravity(row([0.0, -1.0, 0.0])),
    ]
    return bj.Mechanism(
        "any", [arm, slide, speed, ball], [pad], loads, given={"smoothing": number(0.0)}, end=number(1.0),
        own=[(bj.Quantity("w", "1", "w"), number(1.0))],
    )  # fmt: skip


def test_numbers_and_rows_of_any_library_make_the_same_mechanism():
    """Equal and of one hash, so that programs are found again; no library warns."""
    usual = made(float, tuple)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for number in KINDS.values():
            for row in ROWS.values():
                other = made(number, row)
                assert other == usual and hash(other) == hash(usual)
    assert all(type(value) is float for _, value in usual.defaults)


def test_what_is_no_number_is_refused_where_it_stands():
    cases = {
        "body mass": lambda bad: bj.Body("b", "slide", mass=bad),
        "body at": lambda bad: bj.Body("b", "slide", at=(0.0, bad, 0.0)),
        "body start position": lambda bad: bj.Body("b", "slide", start={"position": bad}),
        "force size": lambda bad: bj.loads.Force("f", "b", size=bad),
        "drive speed": lambda bad: bj.Drive(speed=bad),
        "contact values stiffness": lambda bad: bj.Contact("c", ("ground", "b"), PLANE, values={"stiffness": bad}),
        "given mass": lambda bad: bj.Mechanism("m", [bj.Body("b", "slide")], given={"mass": bad}),
    }
    for where, make in cases.items():
        for bad in (1j, object()):
            with pytest.raises(bj.InputError) as caught:
                make(bad)
            assert caught.value.where == where and "is no number" in caught.value.found
        # A number with a unit is for files; here it would be the name of a parameter.
        for bad in ("100 g", "-0.5 m"):
            with pytest.raises(bj.InputError, match="number in SI units") as caught:
                make(bad)
            assert caught.value.where == where


TABLE = ((0.0, 1.0, 2.0), (0.0, 0.5, 0.25))
STILL = bj.Drive("constant", speed=0.0)


@pytest.mark.parametrize(
    ("where", "make"),
    {
        "drive start": lambda: bj.Drive("table", table=TABLE, start=0.5),
        "drive speed": lambda: bj.Drive("function", function=jnp.sin, speed=2.0),
        "drive over": lambda: bj.Drive("constant", speed=2.0, over=0.1),
        "drive table": lambda: bj.Drive("ramp", speed=2.0, over=0.1, table=TABLE),
        "load 'f' ramp": lambda: bj.loads.Force("f", "b", table=TABLE, ramp=0.1),
        "load 'f' amplitude": lambda: bj.loads.Torque("f", "b", table=TABLE, amplitude=1.0, frequency=3.0),
        "load 's' rest": lambda: bj.loads.JointSpring("s", "b", stiffness=1.0, rest=0.1, drive=STILL),
        "contact 'c' elastic": lambda: bj.Contact(
            "c", ("ground", "b"), PLANE, law=bj.laws.MemoryFree(), elastic="linear"
        ),
    }.items(),
)
def test_what_a_kind_does_not_read_is_refused(where, make):
    with pytest.raises(bj.InputError, match=f"has no {where.split()[-1]};") as caught:
        make()
    assert caught.value.where == where


class Everywhere(bj.laws.AbstractLaw):
    """A law that pulls where surfaces are apart, as a first one often does."""

    needs = ("stiffness",)

    def force(self, penetration, rate, c):
        return c["stiffness"] * penetration


def test_a_law_that_acts_across_a_gap_is_refused():
    body = bj.Body("b", "slide", axis="y", mass=1.0, start={"position": 1e-3, "velocity": -1.0})
    times = np.linspace(0.0, 6e-3, 61)
    for smoothing in (False, True):
        pad = bj.Contact("pad", ("ground", "b"), PLANE, Everywhere(), smoothing=smoothing)
        scene = bj.Mechanism("m", [body], [pad], given={"stiffness": 1e6})
        if smoothing:  # Asked of the overlap alone, it is a spring that bounces the body back.
            run = bj.simulate(scene, scene.parameters(), times, read="b.velocity.y", accuracy=1e-5)
            np.testing.assert_allclose(run.readings["b.velocity.y"][-1], 1.0, rtol=1e-4)
            assert run.force["pad"].min() >= 0.0
            continue
        with pytest.raises(bj.InputError, match=r"bears -1e\+03 N where the surfaces are apart") as caught:
            bj.simulate(scene, scene.parameters(), times)
        assert caught.value.where.endswith("contact 'pad' law")


def test_code_and_units_of_a_user_are_refused_where_they_stand():
    wrong = {"one argument": lambda t: t, "numpy": lambda t, p: np.sin(t)}
    for function in wrong.values():
        body = bj.Body("b", "slide", mass=1.0, drive=bj.Drive("function", function=function))
        scene = bj.Mechanism("m", [body])
        with pytest.raises(bj.InputError, match="body 'b' drive: its code raised"):
            bj.simulate(scene, scene.parameters(), [0.0, 1.0])
    own = [(bj.Quantity("h", "cubits", "height"), 1.0)]
    scene = bj.Mechanism("m", [bj.Body("b", "slide", mass=1.0, start={"position": "h"})], own=own)
    with pytest.raises(bj.InputError, match="'cubits' has no unit that is known here"):
        scene.parameters(h="1 m")


@pytest.mark.parametrize("row", ROWS.values(), ids=ROWS)
@pytest.mark.parametrize(
    ("times", "values", "found"),
    [
        ([0.0, 2.0, 1.0], [0.0, 1.0, 2.0], r"time 3 is 1 s after 2 s; give times that increase"),
        ([0.0, 1.0, 1.0], [0.0, 1.0, 2.0], r"time 3 is 1 s after 1 s"),
        ([0.0, 1.0], [0.0, 1.0, 2.0], r"2 times beside 3 values"),
        ([0.0, np.inf, np.inf], [0.0, 1.0, 2.0], r"not finite"),
        ([0.0], [0.0], r"1 times beside 1 values"),
    ],
)
def test_tables_of_loads_and_drives_are_refused_alike(row, times, values, found):
    for make in (
        lambda table: bj.loads.Force("f", "b", table=table),
        lambda table: bj.loads.Torque("f", "b", table=table),
        lambda table: bj.Drive("table", table=table),
        lambda table: bj.Drive("speeds", table=table),
    ):
        with pytest.raises(bj.InputError, match=found):
            make((row(times), row(values)))


def test_moments_of_inertia_obey_the_triangle_inequality():
    """As given, and as values of parameters; a flat body, whose greatest moment is the sum, passes."""
    for a, b in np.random.default_rng(0).uniform(0.1, 5.0, (20, 2)):
        for greatest in ((a, b, a + b), (a + b, a, b), (b, a + b, a)):
            bj.Body("b", "free", inertia=greatest)
            impossible = np.where(np.asarray(greatest) == max(greatest), 1.001, 1.0) * greatest
            with pytest.raises(bj.InputError, match=r"body 'b' inertia: .* more than the others' sum.*no body has"):
                bj.Body("b", "free", inertia=impossible)
    scene = bj.Mechanism("top", [bj.Body("b", "free", mass=1.0, inertia=(1.0, 2.0, 2.5))])
    for params in ({"b.inertia_x": 5.0}, {"b.inertia_z": "3.1 kg m^2"}):
        for verb in (bj.simulate, bj.force_history):
            with pytest.raises(bj.InputError, match=r"'top' body 'b' inertia: .*no body has such"):
                verb(scene, scene.parameters(params), [0.0, 1.0])
    assert bj.simulate(scene, scene.parameters({"b.inertia_z": 3.0}), [0.0, 1e-3]).status == "ok"
    with pytest.raises(
        bj.InputError, match=r"inertia: 5 numbers .*give one number, three about the body's axes, or six"
    ):
        bj.Body("b", "free", inertia=(1.0, 1.0, 1.0, 0.0, 0.0))


def test_two_of_one_name_are_told_so():
    one, other = bj.Body("b", "slide", mass=1.0), bj.Body("b", "hinge", mass=1.0)
    with pytest.raises(bj.InputError, match="two bodies have the name 'b'; give every body a name of its own"):
        bj.Mechanism("m", [one, other])
    pad = bj.Contact("pad", ("ground", "b"), PLANE)
    push = bj.loads.Force("push", "b")
    for contacts, loads, found in (
        ([pad, pad], [], "'pad' already belongs to a contact"),
        ([pad], [push, push], "'push' already belongs to a load"),
        ([], [bj.loads.Force("b", "b")], "'b' already belongs to a body"),
    ):
        with pytest.raises(bj.InputError, match=found):
            bj.Mechanism("m", [one], contacts, loads)


def test_a_particle_on_a_hinge_is_told_why_it_needs_an_inertia():
    bodies = [bj.Body("arm", "hinge", mass=1.0, inertia=1.0), bj.Body("bob", "particle", "arm", mass=1.0)]
    scene = bj.Mechanism("pendulum", bodies)
    with pytest.raises(bj.InputError, match=r"no inertia for bob; 'bob' turns with 'arm'.*give bob\.inertia"):
        bj.simulate(scene, scene.parameters(), [0.0, 1.0])


def test_a_coefficient_that_only_a_contact_has_is_named():
    law = bj.Contact("c", ("ground", "b"), PLANE, "walton_braun", values={"restitution": 0.5, "stiffness": 1e6})
    scene = bj.Mechanism("m", [bj.Body("b", "particle", mass=1.0, start={"y": 1e-3})], [law])
    with pytest.raises(bj.InputError, match=r"'restitution' has no value here; name c\.restitution"):
        bj.sensitivity(scene, scene.parameters(), np.linspace(0.0, 0.01, 11), ["restitution"])


@pytest.mark.slow
def test_a_block_held_by_bristles_is_stuck_up_to_break_away():
    """Pushed by a share of its static friction; beyond all of it, it slides."""
    block = bj.Body("block", "particle", mass=1.0, start={"y": -9.81e-6})
    values = {
        "stiffness": 1e6, "exponent": 1.0, "damping": 0.5, "friction_static": 0.5, "friction_dynamic": 0.3,
        "friction_speed": 1e-2, "bristle_stiffness": 1e5, "bristle_damping": 300.0,
    }  # fmt: skip
    pad = bj.Contact("pad", ("ground", "block"), PLANE, "memory_free", "lugre", smoothing=False, values=values)
    push = bj.loads.Force("push", "block", "x", 0.0, ramp=0.05)
    scene = bj.Mechanism("held", [block], [pad], [bj.loads.Gravity(), push])
    for share in (0.0, 1e-3, 0.1, 0.5, 0.9):
        params = scene.parameters({"push.size": share * 0.5 * 9.81})
        run = bj.simulate(scene, params, np.linspace(0.0, 0.5, 11))
        assert {STATES[code] for code in run.state["pad"]} == {"stuck"}, share
    run = bj.simulate(scene, scene.parameters({"push.size": 1.05 * 0.5 * 9.81}), np.linspace(0.0, 0.5, 11))
    assert STATES[run.state["pad"][-1]] == "sliding"


def check_on_rail(*loads):
    cart = bj.Body("cart", "slide", axis="x", mass=1.0, start={"position": 0.2})
    scene = bj.Mechanism("rail", [cart], loads=loads)
    scene.check(scene.parameters())


@pytest.mark.parametrize(
    ("load", "told"),
    [
        (bj.loads.Spring("tie", ("cart", "cart"), 10.0, at=((0, 0, 0), (0.1, 0, 0))), "it acts on 'cart' alone"),
        (bj.loads.Bush("tie", ("ground", "ground")), "it acts on 'ground' alone"),
        (bj.loads.Force("tie", "ground", "x", 1.0), "it acts on 'ground' alone"),
        (bj.loads.Torque("tie", "cart", "z", 1.0, against="cart"), "it acts on 'cart' alone"),
        (bj.loads.Spring("tie", ("ground", "cart"), free_length=0.1), "stiffness and damping are 0"),
        (bj.loads.JointSpring("tie", "cart", rest=0.1), "stiffness and damping are 0"),
        (bj.loads.Spring("tie", ("ground", "cart"), 10.0, free_length=0.1, at=((0.2, 0, 0), (0, 0, 0))), "at one place"),
    ],
)  # fmt: skip
def test_a_load_that_does_nothing_is_told(load, told):
    """Between one body and itself, on the ground, by no number, or along a line that has no direction at the start."""
    with pytest.raises(bj.InputError, match=rf"load 'tie'.*{told}"):
        check_on_rail(load)


def test_a_slack_cable_and_a_spring_without_length_may_begin_at_one_place():
    ends = {"between": ("ground", "cart"), "stiffness": 10.0, "at": ((0.2, 0, 0), (0, 0, 0))}
    check_on_rail(bj.loads.Spring("slack", free_length=0.1, side="pull", **ends), bj.loads.Spring("tie", **ends))
