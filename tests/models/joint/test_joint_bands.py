"""Pilots as bands: geometry against the hull of the band, friction against its points, forces against statics by hand."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_numpy import by_numpy
from joints import constants, made, plain_joint, unit
from oracles import within

from bcfj_jax.core.errors import InputError
from bcfj_jax.models.joint import bands, system
from bcfj_jax.models.joint.equilibrium_residual import Places, balance
from bcfj_jax.models.joint.quasistatic import posed, quasistatic_forces
from benchmarks.references.joint_parts import as_mechanism

AXIS = np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
LATITUDE = np.radians(30.0)


def on_the_band(count: int = 4000) -> np.ndarray:
    """Directions between the latitudes, and on both edges."""
    rng = np.random.default_rng(0)
    height = np.r_[rng.uniform(-0.5, 0.5, count), np.repeat([-0.5, 0.5], 500)]
    turn = rng.uniform(0.0, 2.0 * np.pi, height.size)
    first = np.cross(AXIS, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    round_ = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(AXIS, first)
    return np.sqrt(1.0 - height**2)[:, None] * round_ + height[:, None] * AXIS


def off_centre(rng: np.random.Generator, kind: int) -> np.ndarray:
    """Places of both spheres from the cage's centre: any; near the axis, where an edge bears all round."""
    place = unit(rng, 2) * 10.0 ** rng.uniform(-4.4, -3.7, (2, 1))
    return 1.3e-4 * AXIS * rng.choice([-1.0, 1.0], (2, 1)) + 4e-6 * rng.normal(size=(2, 3)) if kind else place


@functools.cache
def looked():
    scene, params, c = made(bands=True)

    @jax.jit
    def look(place):
        found = bands.band(c.bands, place, jnp.asarray(AXIS))
        slope = jax.jacfwd(lambda x: bands.band(c.bands, x, jnp.asarray(AXIS)).penetration[:, 0])(place)
        i = jnp.arange(2)
        return found, slope[i, i]

    return look, scene, params, c


def test_the_mean_direction_is_the_hulls_point_nearest_to_the_sphere():
    look, _, _, c = looked()
    points, rng = on_the_band(), np.random.default_rng(1)
    width = np.asarray(c.bands.width)
    assert width == pytest.approx(10.1e-6)
    whole = 0
    for k in range(60):
        place = off_centre(rng, k % 2)
        found, slope = jax.device_get(look(place))
        # Nearest: no point of the band, and so of its hull, lies further towards p/w.
        ahead = np.einsum("ki,kni->kn", place / width[:, None] - found.mean, points - found.mean[:, None])
        assert ahead.max() <= 1e-9
        # d is the farthest that a point of the band has come, but for w; and its gradient.
        farthest = (points @ place.T).max(0) - np.asarray(c.bands.clearance)
        assert np.all(found.penetration[:, 0] >= farthest - 1e-15)
        assert np.all(found.penetration[:, 0] <= farthest + 0.5 * width)
        assert np.allclose(found.mean, slope, rtol=0, atol=1e-12)
        whole += np.count_nonzero(found.spread > 1e-9)
    assert 20 < whole < 80


@pytest.mark.full
def test_friction_that_lags_takes_the_power_of_its_actual_force():
    c = made(bands=True, friction="memory")[2]
    rng = np.random.default_rng(2)

    @jax.jit
    def look(place, velocity, spin, late):
        return bands.act(c.pilot_laws[0], bands.band(c.bands, place, jnp.asarray(AXIS)), velocity, spin, late[:, None])

    pressed = 0
    for k in range(40):
        late = 0.1 * rng.uniform(size=(2, 1))
        velocity, spin = 0.2 * rng.normal(size=(2, 3)), 20.0 * rng.normal(size=(2, 3))
        found = jax.device_get(look(off_centre(rng, k % 2), velocity, spin, late))
        power = np.sum(found.drag * velocity + found.moment * spin, -1)
        assert np.allclose(found.rubbed[:, 0], -power, rtol=1e-9, atol=1e-12 * np.abs(power).max())
        pressed += np.abs(found.force).max() > 1.0
    assert pressed > 15


@pytest.mark.parametrize("shift", [0.0, 1e-4], ids=["all round", "one point"])
def test_friction_of_an_edge_is_that_of_its_points(shift):
    # Along the axis the whole edge bears evenly; far to the side one point of it does.
    _, _, _, c = looked()
    x = np.cross(AXIS, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    place = np.tile(1.3e-4 * AXIS + shift * x, (2, 1))
    rng = np.random.default_rng(3)
    velocity, spin = 0.02 * rng.normal(size=(2, 3)), 2.0 * rng.normal(size=(2, 3))
    found = bands.act(c.pilot_laws[0], bands.band(c.bands, jnp.asarray(place), jnp.asarray(AXIS)), velocity, spin)
    turn = 2.0 * np.pi * np.arange(720) / 720 if shift == 0.0 else np.zeros(1)
    ring = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * np.cross(AXIS, x)
    points = np.cos(LATITUDE) * ring + np.sin(LATITUDE) * AXIS
    for k in range(2):
        lever = float(c.bands.lever[k])
        slide = velocity[k] - (points @ velocity[k])[:, None] * points + lever * np.cross(spin[k], points)
        slip = np.sqrt(np.mean(np.sum(slide**2, 1)))
        assert float(found.slip[k, 0]) == within(slip, 1e-9)
        # One mobility for all points: that of their mean square sliding.
        hold = float(found.normal[k, 0]) * float(c.pilot_laws[0].mobility(jnp.full((2, 1), slip**2))[k, 0])
        drag, moment = -hold * slide.mean(0), -hold * lever * np.cross(points, slide).mean(0)
        assert np.allclose(found.drag[k], drag, rtol=0, atol=1e-9 * np.abs(drag).max())
        assert np.allclose(found.moment[k], moment, rtol=0, atol=1e-9 * np.abs(moment).max())
        # What friction takes is what the points take.
        power = drag @ velocity[k] + moment @ spin[k]
        assert power == within(-hold * slip**2, 1e-9)


def test_an_axial_load_needs_twice_as_much_normal_force():
    # By hand: 7.2 kN along the axis, evenly around the edge at 30 degrees: 14.4 kN, K d^1.5.
    scene = plain_joint(bands=True, smoothing=False, friction=False)
    params = scene.parameters(damping=0.0)
    c = constants(scene, params)
    stiffness, clearance = np.array([8.518e11, 6.606e11]), 50e-6
    deep = (7.2e3 / np.sin(LATITUDE) / stiffness) ** (2.0 / 3.0)
    width = np.asarray(c.bands.width)
    place = (clearance + deep - 0.5 * width * np.cos(LATITUDE) ** 2) / np.sin(LATITUDE)
    at = bands.band(c.bands, jnp.asarray(place[:, None] * AXIS), jnp.asarray(AXIS))
    found = bands.act(c.pilot_laws[0], at, jnp.zeros((2, 3)), jnp.zeros((2, 3)))
    assert np.asarray(found.normal)[:, 0] == pytest.approx(14.4e3, rel=1e-9)
    assert np.asarray(found.force) == pytest.approx(np.tile(-7.2e3 * AXIS, (2, 1)), abs=1e-6)
    # Nothing turns a smooth sphere.
    assert not np.any(np.asarray(found.moment))


@functools.cache
def at_rest():
    """Normal forces in equilibrium at 16 instants, as a function of values."""
    scene = plain_joint(bands=True, friction=False, fidelity="quasistatic")
    times = np.linspace(0.02, 0.12, 16)
    return lambda **values: jax.device_get(quasistatic_forces(scene, scene.parameters(**values), times))


@pytest.mark.slow
def test_pilots_of_the_straight_joint_bear_twice_what_the_windows_push():
    # Undeflected, the cage is pushed along its axis alone, and its edges bear evenly: N sin(30 deg) is the axial force.
    found = at_rest()(joint_angle=0.0)
    pushed = float(found["cage_ball"][-1].sum())
    pilots = [float(found[name][-1]) for name in ("seat_cage", "head_cage")]
    assert pushed > 5e3 and 0.5 * sum(pilots) == within(pushed, 1e-5)
    assert min(pilots) > 0.9 * max(pilots)


@pytest.mark.slow
def test_equilibrium_is_found_where_the_cage_stands_on_two_edges():
    # There it is held by next to nothing, and some places of equilibrium are saddles: a search that climbs finds none.
    found = at_rest()()
    assert all(np.isfinite(x).all() for x in found.values())
    assert found["head_cage"].max() > 5e3


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"cage": "fixed"}, {"head": "fixed"}], ids=str)
def test_matrix_of_equilibrium_is_the_derivative(options):
    scene = plain_joint(bands=True, fidelity="quasistatic", **options)
    params = scene.parameters(axial_load=1e3)
    rng, n = np.random.default_rng(4), scene.balls
    size = sum({"head": 3 * (scene.head == "free"), "turn": 1, "cage": 5 * (scene.cage == "free")}.values())
    at = Places(jnp.asarray(3e-5 * rng.normal(size=(3, n, 2))), jnp.asarray(1e-4 * rng.normal(size=(size, 2))))

    def both(at):
        problem = posed(scene, params, jnp.array([0.06, 0.1]))
        rest = lambda coupling: balance(scene, problem, at._replace(coupling=coupling))[0].coupling  # noqa: E731
        return jax.jacfwd(rest)(at.coupling), balance(scene, problem, at)[1].coupling

    wanted, found = by_numpy(both)(at)
    wanted = wanted[:, [0, 1], :, [0, 1]].transpose(1, 2, 0)
    assert np.allclose(found, wanted, rtol=0, atol=1e-10 * np.abs(wanted).max())


@pytest.mark.slow
def test_within_the_bands_latitudes_nothing_has_changed():
    full, banded = (plain_joint(bands=flag) for flag in (False, True))
    params = banded.parameters()
    y = np.array(full.initial_state(params))
    first = 3 * full.balls
    cage, head = (slice(first + full.slices[name].start, first + full.slices[name].stop) for name in ("cage", "head"))
    # Across the axis and a little along it.
    half = 0.5 * float(params["joint_angle"])
    axis, across = np.array([np.sin(half), 0.0, np.cos(half)]), np.array([0.0, 1.0, 0.0])
    y[cage] = 6e-5 * across + 1e-5 * axis
    y[head] = y[cage] - 7e-5 * across
    readings = []
    for scene in (full, banded):
        look = by_numpy(lambda y, c, scene=scene: (scene.observe(0.0, y, c), scene.vector_field(0.0, y, c)))
        readings.append(look(y, scene.prepare(params)))
    (one, rates), (two, same) = readings
    assert np.allclose(rates, same, rtol=0, atol=5e-3 * np.abs(rates).max())
    for name in ("seat_cage", "head_cage"):
        assert one[name].force[0] > 1e3 and two[name].force[0] == within(float(one[name].force[0]), 1e-9)
        # The head's lever is its radius, and not the hollow sphere's less the shift.
        assert two[name].force == pytest.approx(one[name].force, rel=5e-3, abs=1e-3 * float(one[name].force[0]))
        assert two[name].world == pytest.approx(one[name].world, abs=1e-3 * float(one[name].force[0]))


def test_bands_are_refused_where_there_is_no_cage():
    scene = plain_joint(bands=True)
    with pytest.raises(InputError, match=r"pilot_band.*within its windows"):
        scene.check(scene.parameters(pilot_band=0.1))
    with pytest.raises(InputError, match="pilot_band"):
        scene.check(scene.parameters(pilot_band=1.6))
    with pytest.raises(InputError, match="bands = false"):
        as_mechanism(scene)
    grooves = ("seat_ball", "head_ball")
    assert "pilot_band" not in plain_joint(bands=True, contacts=("cage_ball", *grooves)).quantities
    assert not {"seat_cage", "head_cage"} & set(plain_joint(bands=True, friction="lugre").bristles)
    assert {"seat_cage", "head_cage"} <= set(plain_joint(bands=True, friction="memory").bristles)


def test_friction_of_bands_is_compiled_with_bands_alone():
    scene, params, c = made()
    assert c.bands is None
    state = system.view(scene, c, scene.initial_state(params))
    (part,) = system.piloted(scene, c, state)
    assert not isinstance(part.geometry(part.motion.arm), bands.Band)
