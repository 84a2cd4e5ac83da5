"""Springs by tables and on one side, bushes by axes, preload and press fits, six numbers of inertia: closed forms."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import bcfj_jax as bj
from bcfj_jax import Body, Contact, InputError, Mechanism, gaps
from bcfj_jax.mechanism import springs
from bcfj_jax.mechanism.bodies import GROUND, rotated
from bcfj_jax.mechanism.loads import Bush, Force, JointSpring, Spring

LINEAR = {"stiffness": 1e6, "dashpot": 0.0, "smoothing": 0.0}


def at_rest(scene, **values):
    params = scene.parameters(values)
    y = scene.initial_state(params)
    return y, scene.efforts(jnp.zeros(()), y, params), scene.observe(jnp.zeros(()), y, params)


def test_a_round_gap_of_one_face_has_no_interference():
    with pytest.raises(InputError, match="clearance"):
        Mechanism("pin", [Body("pin", "planar", mass=1.0, inertia=1.0)],
                  [Contact("pin_1", (GROUND, "pin"), gaps.PinInBearing(), "kelvin_voigt")],
                  given={**LINEAR, "radius": 0.01}).parameters({"pin_1.clearance": -1e-6})  # fmt: skip


@pytest.mark.slow
def test_a_press_fit_on_pads():
    """N pads hold as N k/2 in every direction, and follow the interference."""
    n, k, i, r = 8, 1e6, 10e-6, 0.01
    push = Force("push", "pin", (0.6, 0.8, 0.0), 12.0)
    fit = Contact("fit", (GROUND, "pin"), gaps.PinInBearing(pads=n), "kelvin_voigt")
    pin = Body("pin", "planar", mass=0.1, inertia=1e-5)
    scene = Mechanism("press", [pin], [fit], [push], start="static", given={**LINEAR, "radius": r})
    y, _, seen = at_rest(scene, **{"clearance_fit": -i})
    np.testing.assert_allclose(y[:2], 12.0 / (0.5 * n * k) * np.array([0.6, 0.8]), rtol=1e-6)
    bear = np.asarray(seen["fit"].force[:, 0])
    assert np.mean(bear) == pytest.approx(k * i, rel=1e-9) and np.ptp(bear) > 5.0


@pytest.mark.full
def test_a_ball_pressed_into_a_socket_of_pads():
    """Six pads hold as 2 k in every direction."""
    push, socket = Force("push", "ball", (2.0, -1.0, 2.0), 9.0), gaps.SphereInSocket(pads=True)
    scene = Mechanism("press", [Body("ball", "particle", mass=0.1)], [Contact("fit", (GROUND, "ball"), socket, "kelvin_voigt")],
                      [push], start="static", given={**LINEAR, "radius": 0.02})  # fmt: skip
    y, _, _ = at_rest(scene, **{"clearance_fit": -10e-6})
    np.testing.assert_allclose(y[:3], 9.0 / 2e6 * np.array([2.0, -1.0, 2.0]) / 3.0, rtol=1e-6)


def test_flanks_that_are_pressed_push_the_ball_out_of_its_groove():
    """2 k i cos(angle) along the section, 0 across it and along the track."""
    sizes = {"ball_radius": 8e-3, "pitch_radius": 0.035, "offset": 0.0, "contact_angle": 0.7, "conformity": 0.52}
    ball = Body("ball", "particle", mass=0.1, start={"x": 0.035})
    scene = Mechanism("groove", [ball], [Contact("flanks", (GROUND, "ball"), gaps.BallInGroove(), "kelvin_voigt")])
    params = scene.parameters({**LINEAR, **sizes, "clearance_flanks": -10e-6})
    seen = scene.observe(jnp.zeros(()), scene.initial_state(params), params)["flanks"]
    assert float(seen.force[0]) == pytest.approx(2.0 * 10.0, rel=1e-9)
    np.testing.assert_allclose(seen.world, [-20.0 * np.cos(0.7), 0.0, 0.0], atol=1e-8)
    other = Contact("round", (GROUND, "ball"), gaps.BallInGroove(section="circular"), "kelvin_voigt")
    plain = Mechanism("groove", [ball], [other])
    with pytest.raises(InputError, match="clearance"):
        plain.parameters({**LINEAR, "clearance_round": -1e-6})


@pytest.mark.slow
def test_a_preloaded_bearing():
    """N balls, each k/2 between the rings, pressed by k i: a ring that is pushed goes F/(N k/4) while all bear (Harris)."""
    n, k, i, play, pitch = 6, 1e6, 5e-6, 2e-5, 0.03
    angle = 2.0 * np.pi * np.arange(n) / n
    balls = [Body(f"ball_{j + 1}", "slide", axis=(np.cos(a), 0.0, np.sin(a)), mass=0.01, start={"position": pitch})
             for j, a in enumerate(angle)]  # fmt: skip
    ring = Body("ring", "planar", axis="y", mass=0.2, inertia=1e-4)
    races = [
        Contact(f"{side}_{j + 1}", (of, f"ball_{j + 1}"), gaps.BallInGroove(side=side, section="circular"), "kelvin_voigt",
                values={"pitch_radius": radius})
        for j in range(n) for of, side, radius in ((GROUND, "outer", pitch - play - i), ("ring", "inner", pitch + play + i))
    ]  # fmt: skip
    given = {**LINEAR, "ball_radius": 8e-3, "offset": 0.0, **{f"clearance_{c.name}": play for c in races}}
    scene = Mechanism(
        "bearing", [*balls, ring], races, [Force("push", "ring", (0.8, 0.0, 0.6), 1.0)], start="static", given=given
    )
    for force in (1e-3, 6.0):
        y, _, seen = at_rest(scene, **{"push.size": force})
        moved = scene.motions(jnp.zeros(()), y, scene.parameters({"push.size": force}))["ring"].place
        np.testing.assert_allclose(moved, force / (0.25 * n * k) * np.array([0.8, 0.0, 0.6]), rtol=2e-3, atol=1e-12)
        assert float(np.mean([seen[f"outer_{j + 1}"].force[0] for j in range(n)])) == pytest.approx(k * i, rel=1e-3)
    params = scene.parameters()
    slope = jax.jacfwd(lambda f: scene.initial_state({**params, "push.size": f}))(jnp.asarray(1.0))
    y = scene.initial_state(params)
    np.testing.assert_allclose(np.hypot(*slope[n : n + 2]), np.hypot(*y[n : n + 2]), rtol=2e-3)


@pytest.mark.slow
def test_a_pressed_pin_rings_at_twice_the_stiffness():
    """Struck with v it swings by v/w sin w t, w^2 = 2k/m, while v/w is below the interference."""
    pin = Body("pin", "slide", axis="x", mass=0.1, start={"velocity": 0.02})
    fit = Contact("fit", (GROUND, "pin"), gaps.TwoSidedStop("x"), "kelvin_voigt")
    scene = Mechanism("fit", [pin], [fit], given={**LINEAR, "clearance_fit": -10e-6}, start="static", end=3e-3)
    times, w = np.linspace(0.0, 3e-3, 61), np.sqrt(2e6 / 0.1)
    run = bj.simulate(scene, scene.parameters(), times, accuracy=1e-4)
    assert run.status == "ok"
    force = run.force["fit"][:, 0]
    np.testing.assert_allclose(force, 2e6 * 0.02 / w * np.sin(w * times), atol=2e-3 * np.abs(force).max())


@pytest.mark.parametrize(
    ("side", "table", "pairs"),
    [
        ("both", None, ((0.1, 5.0 + 0.4), (-0.1, -5.0 + 0.4))),
        ("pull", None, ((0.1, 5.4), (-0.1, 0.0), (0.001, 0.45))),
        ("push", None, ((0.1, 0.0), (-0.1, -4.6), (-0.001, 0.0))),
        ("both", ((-1.0, 0.0, 0.1, 0.2), (-1.0, 0.0, 1.0, 4.0)), ((-2.0, -1.6), (0.05, 0.9), (0.15, 2.9), (0.3, 7.4))),
    ],
)  # fmt: skip
def test_forces_of_springs(side, table, pairs):
    """At a rate of 0.2 m/s with 2 N s/m, of 50 N/m or a table with its slopes beyond the ends."""
    for x, force in pairs:
        assert float(springs.force(x, 0.2, 0.0 if table else 50.0, 2.0, table, side)) == pytest.approx(force)


@pytest.mark.full
def test_a_weight_on_a_cable():
    """Thrown up, it flies: y = v t - g t^2/2 until it is back, and the cable, taut, holds m g + m a again."""
    mass = Body("mass", "slide", axis="y", at=(0, -1.0, 0), mass=2.0, start={"velocity": 3.0})
    cable = Spring("cable", (GROUND, "mass"), 1e5, free_length=1.0, side="pull")
    scene = Mechanism("cable", [mass], loads=[cable, bj.loads.Gravity()], end=0.8)
    times = np.linspace(0.0, 0.75, 3001)
    run = bj.simulate(scene, scene.parameters(), times, read=["mass.position", "cable.pull"], accuracy=1e-4)
    back = 2.0 * 3.0 / 9.81
    fly = times < back
    np.testing.assert_allclose(run.readings["mass.position"][fly], (3.0 * times - 4.905 * times**2)[fly], atol=1e-6)
    assert np.all(run.readings["cable.pull"][fly] == 0.0)
    # Then half a swing about the sag: the peak is m g + sqrt((m g)^2 + m k v^2).
    peak = 2.0 * 9.81 + np.sqrt((2.0 * 9.81) ** 2 + 2.0 * 1e5 * 9.0)
    assert run.readings["cable.pull"].max() == pytest.approx(peak, rel=2e-2)


@pytest.mark.full
def test_a_cable_that_is_taut_again_has_its_derivative():
    """From 2 v/g on: y = s (cos w u - 1) - v/w sin w u, u = t - 2 v/g, s = m g/k; the pull -k y and its derivative by v."""
    mass = Body("mass", "slide", axis="y", at=(0, -1.0, 0), mass=2.0, start={"velocity": 3.0})
    cable = Spring("cable", (GROUND, "mass"), 1e5, free_length=1.0, side="pull")
    scene = Mechanism("cable", [mass], loads=[cable, bj.loads.Gravity()], end=0.63)
    params, times = scene.parameters(), np.array([0.0, 6.0 / 9.81 + 0.004])

    def pull(v):
        now = {**params, "mass.velocity": v}
        return bj.reading_history(scene, now, times, ["cable.pull"], accuracy=1e-5)["cable.pull"][-1]

    def closed(v):
        w, sag, u = jnp.sqrt(1e5 / 2.0), 2.0 * 9.81 / 1e5, times[1] - 2.0 * v / 9.81
        return -1e5 * (sag * (jnp.cos(w * u) - 1.0) - v / w * jnp.sin(w * u))

    found, want = (jax.jvp(f, (jnp.asarray(3.0),), (jnp.ones(()),)) for f in (pull, closed))
    np.testing.assert_allclose(found, want, rtol=2e-3)


def test_bushes_by_axes():
    """Force and torque along the first body's axes by hand, of bodies that are turned; no momentum is made."""
    turn, lean = 0.7, 0.4
    first = Body("first", "free", mass=1.0, inertia=1.0, start={"q0": np.cos(turn / 2), "q3": np.sin(turn / 2)})
    second = Body("second", "free", mass=1.0, inertia=1.0, start={
        "x": 0.02, "y": 0.03, "z": -0.01, "q0": np.cos((turn + lean) / 2), "q3": np.sin((turn + lean) / 2)})  # fmt: skip
    bush = Bush("bush", ("first", "second"), (1e3, 2e3, 3e3), turning_stiffness=(5.0, 6.0, 7.0))
    scene = Mechanism("bush", [first, second], loads=[bush])
    params = scene.parameters()
    y = scene.initial_state(params)
    effort = scene.efforts(jnp.zeros(()), y, params)["bush"]
    axes = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    force = -axes @ (np.array([1e3, 2e3, 3e3]) * (axes.T @ np.array([0.02, 0.03, -0.01])))
    np.testing.assert_allclose(effort.force, force, rtol=1e-12)
    np.testing.assert_allclose(effort.moment, [0, 0, -7.0 * lean], rtol=1e-12, atol=1e-12)
    rate = np.asarray(scene.vector_field(jnp.zeros(()), y, params))[14:]
    push, spun = rate[[0, 1, 2]] + rate[[6, 7, 8]], rate[[3, 4, 5]] + rate[[9, 10, 11]]
    np.testing.assert_allclose(push, 0.0, atol=1e-12)
    np.testing.assert_allclose(spun + np.cross([0.02, 0.03, -0.01], rate[6:9]), 0.0, atol=1e-12)


def test_a_bush_damps_no_motion_of_the_whole_and_makes_no_momentum():
    """Both bodies turn as one about the origin, far apart from where they are held: only the spring acts. Else momenta balance,
    one number is three equal ones, and either body may be the first.
    """
    rng = np.random.default_rng(5)
    places, attitudes = rng.normal(size=(2, 3)), rng.normal(size=(2, 4))
    points = [tuple(x) for x in rng.normal(size=(2, 3)).tolist()]
    bodies = [Body(name, "free", mass=1.0, inertia=1.0) for name in ("first", "second")]
    spin = rng.normal(size=3)
    rigid = np.concatenate([[*np.cross(spin, place), *spin] for place in places])

    def pushed(rates, damping, three=False, swapped=False):
        """Forces and torques about the centres, (2, 6); masses and inertias are 1."""
        several = (lambda x: (x, x, x)) if three else float
        way = slice(None, None, -1) if swapped else slice(None)
        sizes = several(1e3), several(damping), several(damping), tuple(points[way]), several(7.0)
        bush = Bush("bush", ("first", "second")[way], *sizes)
        scene = Mechanism("bush", bodies, loads=[bush])
        y = np.concatenate([*np.hstack([places, attitudes]), rates])
        return np.asarray(scene.vector_field(jnp.zeros(()), y, scene.parameters()))[14:].reshape(2, 6)

    np.testing.assert_allclose(pushed(rigid, 50.0), pushed(rigid, 0.0), rtol=1e-12, atol=1e-10)
    rates = rng.normal(size=12)
    one = pushed(rates, 50.0)
    moments = one[:, 3:] + np.cross(places, one[:, :3])
    assert np.abs(one).max() > 100.0
    np.testing.assert_allclose([one[:, :3].sum(0), moments.sum(0)], 0.0, atol=1e-10)
    for other in ({"three": True}, {"swapped": True}):
        np.testing.assert_allclose(pushed(rates, 50.0, **other), one, rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 2.9])
def test_the_turn_between_axes_is_rodrigues(angle):
    world = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    way = (2 / 3, -1 / 3, 2 / 3)
    found = lambda a: jnp.stack(springs.turn(world, rotated(world, way, a)))  # noqa: E731
    np.testing.assert_allclose(found(jnp.asarray(angle)), angle * np.array(way), rtol=1e-9, atol=1e-16)
    np.testing.assert_allclose(jax.jacfwd(found)(jnp.asarray(angle)), way, rtol=1e-7)


def test_six_numbers_of_inertia_are_a_turned_body():
    """Principal moments about axes turned by R against the matrix R I R' about the body's own: one motion."""
    spin = {"wx": 0.3, "wy": -1.0, "wz": 2.0}
    a, b = 0.5, -0.8
    turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) @ np.array(
        [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])  # fmt: skip
    w = turn @ np.diag([0.02, 0.03, 0.04]) @ turn.T
    q = np.array([np.cos(a / 2) * np.cos(b / 2), np.cos(a / 2) * np.sin(b / 2), np.sin(a / 2) * np.sin(b / 2),
                  np.sin(a / 2) * np.cos(b / 2)])  # fmt: skip
    own = Body("one", "free", mass=1.0, inertia=(0.02, 0.03, 0.04), start={**spin, **{f"q{k}": q[k] for k in range(4)}})
    six = (w[0, 0], w[1, 1], w[2, 2], w[0, 1], w[1, 2], w[2, 0])
    other = Body("two", "free", mass=1.0, inertia=six, start=spin)
    scene = Mechanism("two", [own, other])
    params = scene.parameters()
    y = scene.initial_state(params)
    moved = scene.motions(jnp.zeros(()), y, params)
    np.testing.assert_allclose(moved["one"].spin_rate, moved["two"].spin_rate, rtol=1e-12)
    want = -np.linalg.solve(w, np.cross([0.3, -1.0, 2.0], w @ np.array([0.3, -1.0, 2.0])))
    np.testing.assert_allclose(moved["two"].spin_rate, want, rtol=1e-12)
    for wrong, told in (
        ((1.0, 1.0, 1.0, 2.0, 0.0, 0.0), "above 0"),
        ((1.0, 1.0, 2.1, 0.0, 0.0, 0.0), "others' sum"),
        ((1.0, 1.0), "six"),
    ):
        with pytest.raises(InputError, match=told):
            Body("no", "free", inertia=wrong)


def test_attitude_and_spin_of_a_free_body_are_in_the_joints_axes():
    """A turn of pi/2 about the world's z and a spin about the world's x, along the body's -y then; with tilt the joint's."""
    start = {"q0": np.sqrt(0.5), "q3": np.sqrt(0.5), "wx": 2.0}
    for tilt, way in ((None, [2.0, 0.0, 0.0]), (("z", np.pi / 2), [0.0, 2.0, 0.0])):
        body = Body("top", "free", mass=1.0, inertia=(1.0, 2.0, 2.5), start=start, tilt=tilt)
        scene = Mechanism("top", [body])
        params = scene.parameters()
        moved = scene.motions(jnp.zeros(()), scene.initial_state(params), params)["top"]
        np.testing.assert_allclose(moved.spin, way, atol=1e-12)
        np.testing.assert_allclose(np.asarray(moved.axes).T @ np.asarray(moved.spin), [0.0, -2.0, 0.0], atol=1e-12)


def test_a_stop_of_a_turning_shaft_counts_turns():
    shaft = Body("shaft", "hinge", inertia=1.0, mass=1.0, start={"angle": 10.0})
    scene = Mechanism("shaft", [shaft], loads=[JointSpring("stop", "shaft", 4.0, rest=9.5, side="pull")])
    params = scene.parameters()
    y = scene.initial_state(params)
    assert float(scene.efforts(jnp.zeros(()), y, params)["stop"].drive) == pytest.approx(-2.0)
    with pytest.raises(InputError, match="no side"):
        Spring("spring", (GROUND, "shaft"), 1.0, side="puls")
    with pytest.raises(InputError, match="beside a stiffness"):
        Spring("spring", (GROUND, "shaft"), 1.0, table=((0.0, 1.0), (0.0, 1.0)))
