"""Each contact and each ball of the joint by itself: elastic parts, stiffness from geometry, unequal balls."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import QUICK, make_constants, noisy, plain_joint
from oracles import within

import bcfj_jax as bj
from bcfj_jax import scenes
from bcfj_jax.analysis.histories import settled_period
from bcfj_jax.contact import laws
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.scenefile import from_table
from bcfj_jax.models.joint import constants as numbers
from bcfj_jax.models.joint import engineering, system
from bcfj_jax.models.joint.periodic import pitch_before

E = 113e9


# --- stiffness and elastic parts


def test_stiffness_from_geometry_is_that_of_the_formulas():
    scene = plain_joint(stiffness="geometry", window_ends=True)
    params = scene.parameters({"clearance_seat_cage": 40e-6, "cage_ball.effective_modulus": 2 * E})
    found = {x.name: float(numbers.stiffness(scene, params, x.name)) for x in scene.contacts}
    socket = lambda outer, gap: 4 / 3 * E * np.sqrt(outer * (outer - gap) / gap)  # noqa: E731
    assert found["seat_cage"] == within(socket(0.040, 40e-6), 1e-10)
    assert found["head_cage"] == within(socket(0.031 + 50e-6, 50e-6), 1e-10)
    assert found["cage_window_end"] == within(4 / 3 * E * np.sqrt(0.008), 1e-12)
    assert found["cage_ball"] == within(2.0 * found["cage_window_end"], 1e-12)
    # By Brewe and Hamrock's fit of the elliptic integrals, good to 3 %; the outer race is the closer fit.
    for name, sign in (("seat_ball", 1.0), ("head_ball", -1.0)):
        ball, section = 0.008, 0.008 * 1.04 + 10e-6
        g = ball * np.cos(np.radians(40.0)) / np.hypot(0.0355, 0.0045)
        across, along = ball * section / (section - ball), ball * (1.0 + sign * g)
        ratio, radius = across / along, 1.0 / (1.0 / across + 1.0 / along)
        k, first, second = (
            ratio ** (2 / np.pi),
            np.pi / 2 + (np.pi / 2 - 1) * np.log(ratio),
            1 + (np.pi / 2 - 1) / ratio,
        )
        assert found[name] == within(2 * np.pi * k * E * np.sqrt(radius * second / (4.5 * first**3)), 0.03)
    assert found["seat_ball"] > found["head_ball"]
    assert not {"stiffness", "exponent", "seat_ball.stiffness"} & set(scene.quantities)
    # The default joint's stated numbers are these formulas'.
    given = dict(plain_joint().defaults)
    usual = scene.parameters()
    for name, stated in (("seat_cage", given["seat_cage.stiffness"]), ("cage_ball", given["cage_ball.stiffness"])):
        assert float(numbers.stiffness(scene, usual, name)) == within(stated, 1e-3)


def test_stiffness_from_geometry_moves_with_clearance_conformity_and_radii():
    scene = plain_joint(stiffness="geometry", elastics={"head_cage": "liu_sphere"})
    params = scene.parameters()

    @jax.jit
    def both(params):
        told = {name: numbers.coefficients(scene, params, name) for name in ("seat_cage", "seat_ball", "cage_ball")}
        stiffness = jnp.stack([told[name]["stiffness"] for name in told])
        liu = numbers.coefficients(scene, params, "head_cage")
        return jnp.append(stiffness, scene.contact("head_cage").law.force(jnp.asarray(1e-5), jnp.zeros(()), liu))

    slopes = jax.jit(jax.jacfwd(both))(params)
    back = jax.jit(jax.jacrev(both))(params)
    for name in ("clearance_seat_cage", "clearance_head_cage", "conformity", "ball_radius", "clearance_seat_ball"):
        h = 1e-5 * float(params[name])
        up, down = (both({**params, name: params[name] + s * h}) for s in (1.0, -1.0))
        by_difference = np.asarray(up - down) / (2 * h)
        size = np.abs(by_difference).max()
        assert size > 0 and np.abs(slopes[name] - by_difference).max() < 1e-6 * size
        assert np.abs(slopes[name] - back[name]).max() <= 1e-12 * size
    # K of a socket falls as the root of its clearance; a closer groove is stiffer.
    assert float(slopes["clearance_seat_cage"][0]) * 50e-6 == within(-0.5 * float(both(params)[0]), 2e-3)
    assert float(slopes["conformity"][1]) < 0.0


def test_an_elastic_part_of_one_contact_reads_that_contacts_radii():
    scene = plain_joint(elastics={"seat_cage": "liu_sphere", "seat_ball": "bai_zhao", "cage_ball": "liu"})
    params = scene.parameters({"clearance_seat_cage": 30e-6, "clearance_seat_ball": 12e-6})
    told = {x.name: numbers.coefficients(scene, params, x.name) for x in scene.contacts}
    assert float(told["seat_cage"]["radius"]) == 0.040 and float(told["seat_cage"]["radius_difference"]) == 30e-6
    assert float(told["seat_ball"]["radius_difference"]) == within(0.008 * 0.04 + 12e-6, 1e-12)
    # A window is flat: what stands for its radius difference remains a parameter. The others are power laws.
    assert "cage_ball.radius_difference" in scene.quantities and "seat_cage.radius_difference" not in scene.quantities
    assert isinstance(scene.contact("head_cage").law.elastic, laws.ELASTIC["power"].__class__)
    d = 4e-6
    force = scene.contact("seat_cage").law.force(jnp.asarray(d), jnp.zeros(()), told["seat_cage"])
    assert float(force) == within(2 / 3 * np.pi * E * 0.040 * d * d / (30e-6 + d), 1e-12)


def test_a_scene_file_says_the_same():
    table = {
        "scene": {
            "kind": "joint", "elastics": {"seat_cage": "liu_sphere"}, "stiffnesses": {"seat_ball": "geometry"}, "unequal": True,
        },
        "parameters": {"ball_2": {"oversize": "10 um"}, "seat_ball_3": {"extra_clearance": "5 um"}},
    }  # fmt: skip
    given = from_table(table, None)
    same = scenes.joint(
        geometry=scenes.JointGeometry(unequal=True),
        materials=scenes.JointMaterials(elastics={"seat_cage": "liu_sphere"}, stiffnesses={"seat_ball": "geometry"}),
    )
    assert given.scene == same
    assert (
        float(given.params["ball_2.oversize"]) == 10e-6 and float(given.params["seat_ball_3.extra_clearance"]) == 5e-6
    )
    assert from_table(given.resolved, None).resolved == given.resolved


REFUSED = [
    ({"elastics": {"seat_cage": "liuu"}}, ["elastics", "seat_cage: no elastic part 'liuu'", "did you mean 'liu'?"]),
    ({"elastics": {"seat_cag": "liu"}}, ["elastics", "no contact 'seat_cag'", "'seat_cage'"]),
    ({"stiffness": "hertz"}, ["stiffness", "'hertz'", "geometry"]),
    ({"stiffnesses": {"seat_cage": "geometric"}}, ["stiffnesses", "no stiffness 'geometric'", "geometry"]),
    ({"stiffness": "geometry", "laws": {"head_ball": "kelvin_voigt"}}, ["head_ball", "no power law", "elastics"]),
]


@pytest.mark.parametrize(("options", "parts"), REFUSED, ids=[str(n) for n in range(len(REFUSED))])
def test_what_is_refused(options, parts):
    with pytest.raises(InputError) as caught:
        plain_joint(**options)
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def test_no_clearance_is_refused_where_a_stiffness_needs_one():
    for options in ({"stiffness": "geometry"}, {"elastics": {"seat_cage": "liu_sphere"}}):
        scene = plain_joint(**options)
        with pytest.raises(InputError, match=r"clearance_seat_cage: 0 m.*give a clearance > 0"):
            scene.check(scene.parameters(clearance_seat_cage=0.0))
    plain_joint().check(plain_joint().parameters(clearance_seat_cage=0.0))


def test_contacts_too_wide_for_their_stiffness_are_told():
    scene = plain_joint(stiffness="geometry", fidelity="quasistatic")
    params = scene.parameters()
    d = 0.09 * 50e-6
    found = jax.device_get(
        engineering.widths(scene, params, {"seat_cage": d, "cage_ball": 0.008 * 0.09, "seat_ball": 46.8e-6})
    )
    assert found["seat_cage"] == within(0.3, 1e-3) and found["cage_ball"] == within(0.3, 1e-12)
    # A patch of 3.7 mm under 12 kN.
    assert found["seat_ball"] == within(3.66e-3 / 0.008, 0.01)

    class Ran:
        penetration = {name: np.full((3, 6), 1e-6) for name in scene.members}

    assert scene.warnings(params, Ran()) == []
    Ran.penetration["seat_cage"] = np.array([1e-6, 9e-6, np.nan])
    (said,) = scene.warnings(params, Ran())
    assert "seat_cage 0.42" in said and "head_cage" not in said
    assert plain_joint().warnings(plain_joint().parameters(), Ran()) == []


# --- unequal balls


@pytest.mark.full
def test_an_oversize_closes_all_gaps_of_its_ball_and_no_other():
    scene, plain = plain_joint(unequal=True, window_ends=True), plain_joint(window_ends=True)
    usual = plain.parameters()
    y, t = jnp.asarray(noisy(plain, usual, 3)), 0.01

    @functools.partial(jax.jit, static_argnums=0, compiler_options=QUICK)
    def look(scene, params):
        c = make_constants(scene, params)
        depths = {name: x.penetration for name, x in scene.observe(t, y, c).items()}
        return depths, system.field(t, y, (scene, c))

    usually, field = jax.device_get(look(plain, usual))
    equal, same_field = jax.device_get(look(scene, scene.parameters()))
    values = scene.parameters({"ball_2.oversize": 7e-6, "head_ball_5.extra_clearance": 3e-6})
    depths, _ = jax.device_get(look(scene, values))
    # Balls of no oversize are those of the usual joint.
    assert np.abs(same_field - field).max() <= 1e-10 * np.abs(field).max()
    for name in ("seat_ball", "head_ball", "cage_ball", "cage_window_end"):
        assert np.allclose(equal[name], usually[name], rtol=0, atol=1e-18)
        expected = np.zeros(6)
        expected[1] = 7e-6
        if name == "head_ball":
            expected[4] = -3e-6
        assert np.allclose(depths[name] - usually[name], expected, rtol=0, atol=1e-15), name
    assert np.array_equal(depths["seat_cage"], usually["seat_cage"])


@pytest.mark.slow
def test_equal_balls_of_an_unequal_joint_run_as_the_usual_ones():
    times = np.linspace(0.0, 0.03, 31)
    found = []
    for options in ({}, {"unequal": True}):
        scene = plain_joint(**options)
        found.append(bj.force_history(scene, scene.parameters(load_ramp=0.01), times))
    for name, force in found[0].items():
        assert np.abs(force - found[1][name]).max() <= 1e-10 * np.abs(force).max(), name


def test_unequal_balls_repeat_themselves_after_a_turn():
    scene, plain = plain_joint(unequal=True), plain_joint()
    params = scene.parameters()
    assert scene.period(params) == (pytest.approx(0.6), pytest.approx(0.6))
    assert plain.period(plain.parameters()) == (pytest.approx(0.6), pytest.approx(0.1))
    assert scene.turned(params) == 0 and float(scene.pitch(params)) == within(0.6, 1e-12)
    y = noisy(scene, params, 1)
    before = np.asarray(pitch_before(scene, params, jnp.asarray(y)))
    moved = np.flatnonzero(np.abs(before - y) > 1e-12)
    assert len(moved) == 2 and np.allclose(y[moved] - before[moved], 2 * np.pi, atol=1e-12)


@pytest.mark.slow
def test_equilibrium_of_unequal_balls():
    # Half a turn on, balls stand where the opposite ones stood: exchange their sizes, and forces are exchanged.
    scene = plain_joint(unequal=True, fidelity="quasistatic")
    sizes = np.array([8.0, -3.0, 0.0, 5.0, -6.0, 2.0]) * 1e-6

    def forces(sizes, time):
        params = scene.parameters({f"ball_{i + 1}.oversize": x for i, x in enumerate(sizes)} | {"load_ramp": 1e-6})
        return bj.force_history(scene, params, np.array([time]))

    first, second = forces(sizes, 0.13), forces(np.roll(sizes, 3), 0.43)
    for name in ("seat_ball", "head_ball", "cage_ball"):
        found = np.roll(np.asarray(second[name]), 3, axis=1)
        assert np.abs(first[name] - found).max() <= 1e-6 * np.abs(found).max(), name
    none = forces(np.zeros(6), 0.13)
    assert np.abs(none["seat_ball"] - first["seat_ball"]).max() > 200.0


@pytest.mark.slow
def test_unequal_balls_give_the_pilots_force_the_period_of_a_turn():
    times = np.linspace(0.0, 1.8, 1801)
    scene, periods = plain_joint(unequal=True), []
    for size in (0.0, 10e-6):
        draw = np.random.default_rng(24).normal(size=6)
        params = scene.parameters({f"ball_{i + 1}.oversize": size * x for i, x in enumerate(draw)})
        periods.append(settled_period(times, bj.force_history(scene, params, times)["seat_cage"][:, 0]))
    assert periods[0] == within(0.1, 5e-3) and periods[1] == within(0.6, 5e-3)


@pytest.mark.slow
def test_derivatives_by_single_balls_and_by_what_a_stiffness_is_made_of():
    scene = plain_joint(
        unequal=True, stiffness="geometry", elastics={"head_cage": "liu_sphere"}, fidelity="quasistatic"
    )
    params = scene.parameters({"load_ramp": 1e-6, "ball_2.oversize": 5e-6})
    names = (
        "ball_2.oversize",
        "seat_ball_3.extra_clearance",
        "clearance_seat_cage",
        "clearance_head_cage",
        "conformity",
    )

    @jax.jit
    def forces(values):
        given = {**params, **dict(zip(names, values, strict=True))}
        found = bj.force_history(scene, given, np.array([0.13]))
        return jnp.concatenate([x[..., 0].ravel() for x in found.values()])

    at = jnp.array([float(params[name]) for name in names])
    slopes = np.asarray(jax.jacfwd(forces)(at))
    for k, name in enumerate(names):
        h = np.zeros(len(names))
        h[k] = 1e-5 if name == "conformity" else 1e-8
        by_difference = (np.asarray(forces(at + h)) - np.asarray(forces(at - h))) / (2 * h[k])
        size = np.abs(by_difference).max()
        assert size > 0 and np.abs(slopes[:, k] - by_difference).max() < 1e-4 * size, name
