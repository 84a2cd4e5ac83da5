"""Parts of a mechanism in value and in derivative by formulas written here: at one instant, at rest, over a stroke.

Both sides are functions of the parameters, and each is differentiated by itself.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from by_numpy import by_numpy

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps
from bcfj_jax.mechanism import springs
from bcfj_jax.mechanism.bodies import GROUND, Drive
from bcfj_jax.mechanism.channels import channel, looked
from bcfj_jax.mechanism.loads import Bush, Coupling, Force, Gravity, JointSpring, Spring

NOW = jnp.zeros(())
LINEAR = {"stiffness": 1e6, "dashpot": 0.0, "smoothing": 0.0}


def agree(found, closed, params, names, rtol=1e-9, atol=1e-12):
    """Values, and derivatives by every name, or by several at once in unlike shares; ``atol`` is of the largest."""
    ways = [(names,) if isinstance(names, str) else names for names in names]
    shares = [{name: (k + 1.0) * params[name] for k, name in enumerate(way)} for way in ways]

    def both(function):
        def at(x):
            return jnp.stack([jnp.asarray(v, float) for v in function({**params, **x})])

        def of(p):
            x = [{name: p[name] for name in way} for way in ways]
            return at({}), [jax.jvp(at, (one,), (share,))[1] for one, share in zip(x, shares, strict=True)]

        return by_numpy(of)(params)

    ours, theirs = both(found), both(closed)
    for way, one, other in zip(("value", *ways), (ours[0], *ours[1]), (theirs[0], *theirs[1]), strict=True):
        assert np.abs(other).max() > 0.0, f"{way}: the formula does not depend on it"
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol * np.abs(other).max(), err_msg=str(way))


def instant(scene, read):
    """``read`` of the state and the parameters at the start, as a function of the parameters."""
    return lambda p: read(scene.initial_state(p), p)


def readings(scene, *names, t=NOW):
    """Readings by their names at the start, as a function of the parameters."""
    asked = [channel(name, scene) for name in names]

    def found(y, p):
        seen = looked(asked, scene, scene.observe(t, y, p) if scene.contacts else {}, {})(t, y, p)
        return [seen[name] for name in names]

    return instant(scene, found)


# --- readings


def test_the_pin_of_a_pendulum():
    """-m L w^2 + m g sin a along the bar, m g cos a I/(I + m L^2) across it."""
    bar = Body("bar", "hinge", center=(0.4, 0, 0), mass=2.0, inertia=0.01, start={"angle": 0.3, "speed": 1.5})
    scene = Mechanism("pendulum", [bar], loads=[Gravity()])

    def pin(p):
        a, w, m, spin = p["bar.angle"], p["bar.speed"], p["bar.mass"], p["bar.inertia"]
        along = m * (p["gravity"] * jnp.sin(a) - 0.4 * w**2)
        across = m * p["gravity"] * jnp.cos(a) * spin / (spin + 0.16 * m)
        return along * jnp.cos(a) - across * jnp.sin(a), along * jnp.sin(a) + across * jnp.cos(a)

    names = ("bar.angle", "bar.speed", "bar.mass", "bar.inertia", "gravity")
    agree(readings(scene, "bar.reaction.x", "bar.reaction.y"), pin, scene.parameters(), names)


def test_the_power_of_a_drive():
    """A crank that is turned at w against its weight: m g L cos(w t) of torque, w times that of power."""
    crank = Body("crank", "hinge", center=(0.3, 0, 0), mass=2.0, inertia=0.01, drive=Drive("constant", speed=4.0))
    scene = Mechanism("crank", [crank], loads=[Gravity()])
    t, speed = jnp.asarray(0.2), "crank.drive_speed"
    torque = lambda p: p["crank.mass"] * p["gravity"] * 0.3 * jnp.cos(p[speed] * t)  # noqa: E731
    closed = lambda p: (p[speed] * t, p[speed], torque(p), p[speed] * torque(p))  # noqa: E731
    found = readings(scene, "crank.angle", "crank.speed", "crank.torque", "crank.power", t=t)
    agree(found, closed, scene.parameters(), (speed, "crank.mass", "gravity"))


# --- loads and couplings


def test_both_sides_of_a_pair_of_gears():
    """F = -k e - c e' on the second and i F on the first, e = q_2 - i q_1 less half the play; within it nothing."""
    start = [{"angle": 10.0, "speed": 3.0}, {"angle": -3.97, "speed": -1.0}]
    bodies = [Body(name, "hinge", mass=1.0, inertia=0.02, start=x) for name, x in zip("ab", start, strict=True)]
    scene = Mechanism("gears", bodies, loads=[Coupling("mesh", ("a", "b"), -0.4, 300.0, 0.7, backlash=0.02)])

    def sides(p):
        i, e = p["mesh.ratio"], p["b.angle"] - p["mesh.ratio"] * p["a.angle"]
        rate = p["b.speed"] - i * p["a.speed"]
        force = -p["mesh.stiffness"] * (e - 0.5 * p["mesh.backlash"]) - p["mesh.damping"] * rate
        return -i * force / p["a.inertia"], force / p["b.inertia"]

    field = instant(scene, lambda y, p: scene.vector_field(NOW, y, p)[2:])
    names = [f"mesh.{x}" for x in ("ratio", "stiffness", "damping", "backlash")] + ["a.angle", "b.speed"]
    agree(field, sides, scene.parameters(), names)


def test_a_bush_along_and_about_its_axes():
    """-k r along the first body's axes, which are turned by a; -k_t b about its z, b the second's turn against it."""
    a, b = 0.7, 0.4
    first = Body("first", "hinge", mass=1.0, inertia=1.0, start={"angle": a})
    second = Body("second", "planar", mass=1.0, inertia=1.0, start={"x": 0.02, "y": 0.03, "angle": a + b})
    bush = Bush("bush", ("first", "second"), (1e3, 2e3, 0.0), turning_stiffness=(5.0, 6.0, 7.0))
    scene = Mechanism("bush", [first, second], loads=[bush])

    def pushed(p):
        c, s, x, y = jnp.cos(p["first.angle"]), jnp.sin(p["first.angle"]), p["second.x"], p["second.y"]
        u, v = -p["bush.stiffness_x"] * (c * x + s * y), -p["bush.stiffness_y"] * (c * y - s * x)
        return c * u - s * v, s * u + c * v, -p["bush.turning_stiffness_z"] * (p["second.angle"] - p["first.angle"])

    found = instant(scene, lambda y, p: scene.vector_field(NOW, y, p)[5:])
    names = ("first.angle", "second.x", "second.y", "second.angle", "bush.stiffness_x", "bush.stiffness_y")
    agree(found, pushed, scene.parameters(), (*names, "bush.turning_stiffness_z"))


@pytest.mark.parametrize(("side", "x"), [("both", 0.15), ("both", 0.3), ("pull", 0.05), ("push", -0.3)])
def test_a_spring_by_a_table_has_the_slope_of_its_stretch(side, x):
    """Between two points of the table its line, beyond the ends the last line, and the damper beside it."""
    table = ((-1.0, 0.0, 0.1, 0.2), (-1.0, 0.0, 1.0, 4.0))
    line = {0.15: (30.0, -2.0), 0.3: (30.0, -2.0), 0.05: (10.0, 0.0), -0.3: (1.0, 0.0)}[x]
    found = lambda p: [springs.force(p["x"], p["rate"], 0.0, 0.2, table, side)]  # noqa: E731
    closed = lambda p: [line[0] * p["x"] + line[1] + 0.2 * p["rate"]]  # noqa: E731
    agree(found, closed, {"x": x, "rate": np.sign(x) * 0.3}, ("x", "rate"))


# --- bodies and joints


def test_a_free_body_with_six_numbers_of_inertia():
    """w' = -W^-1 (w x W w) by every number of W and of w, which are along the joint's axes."""
    six, spin = (0.02, 0.03, 0.04, 1e-3, -2e-3, 3e-3), {"wx": 0.3, "wy": -1.0, "wz": 2.0}
    scene = Mechanism("top", [Body("top", "free", mass=1.0, inertia=six, start=spin)])

    def gains(p):
        xx, yy, zz, xy, yz, zx = (p[f"top.inertia_{k}"] for k in ("x", "y", "z", "xy", "yz", "zx"))
        matrix = jnp.stack([jnp.stack(row) for row in ((xx, xy, zx), (xy, yy, yz), (zx, yz, zz))])
        w = jnp.stack([p[f"top.{k}"] for k in spin])
        torque = -jnp.cross(w, matrix @ w)
        # Of a symmetric matrix: its adjugate's columns are cross products of its rows.
        one, two, three = matrix
        columns = [jnp.cross(two, three), jnp.cross(three, one), jnp.cross(one, two)]
        return jnp.stack(columns, 1) @ torque / (one @ columns[0])

    found = instant(scene, lambda y, p: scene.motions(NOW, y, p)["top"].spin_rate)
    names = [f"top.inertia_{k}" for k in ("x", "y", "z", "xy", "yz", "zx")] + [f"top.{k}" for k in spin]
    agree(found, gains, scene.parameters(), names)


def test_a_light_arm_passes_on_what_its_weight_does():
    """(m L^2 + I) q'' = -m g L cos q - k q - 2 m L q' v of an arm without mass and a weight that slides along it."""
    arm = Body("arm", "hinge", mass=0, start={"angle": 0.4, "speed": 2.0})
    bob = Body(
        "bob",
        "slide",
        "arm",
        at=(0.5, 0, 0),
        axis="x",
        mass=0.7,
        inertia=1e-3,
        start={"position": 0.05, "velocity": 0.1},
    )
    scene = Mechanism("arm", [arm, bob], loads=[Gravity(), JointSpring("coil", "arm", 3.0)])

    def gains(p):
        m, q, w, reach = p["bob.mass"], p["arm.angle"], p["arm.speed"], 0.5 + p["bob.position"]
        torque = (
            -m * p["gravity"] * reach * jnp.cos(q) - p["coil.stiffness"] * q - 2.0 * m * reach * w * p["bob.velocity"]
        )
        return torque / (m * reach**2 + p["bob.inertia"]), reach * w**2 - p["gravity"] * jnp.sin(q)

    names = ("bob.mass", "bob.inertia", "arm.angle", "arm.speed", "bob.velocity", "bob.position", "coil.stiffness")
    agree(instant(scene, lambda y, p: scene.vector_field(NOW, y, p)[2:]), gains, scene.parameters(), names)


def test_the_pins_of_a_universal_joint():
    """Its z axis is R_x(a) R_y(b) e_z, its spin a' e_x + b' R_x(a) e_y."""
    start = {"first": 0.6, "second": -0.9, "first_speed": 1.3, "second_speed": -0.4}
    names = [f"shaft.{k}" for k in start]
    body = Body("shaft", "universal", mass=1.0, inertia=(0.01, 0.02, 0.025), start=start)
    scene = Mechanism("shaft", [body])

    def moved(y, p):
        one = scene.motions(NOW, y, p)["shaft"]
        return jnp.concatenate([jnp.asarray(one.axes)[:, 2], one.spin])

    def closed(p):
        a, b = p["shaft.first"], p["shaft.second"]
        axis = jnp.sin(b), -jnp.sin(a) * jnp.cos(b), jnp.cos(a) * jnp.cos(b)
        rate = p["shaft.second_speed"]
        own = [p[name] for name in names]
        return (*axis, p["shaft.first_speed"], rate * jnp.cos(a), rate * jnp.sin(a), *own)

    by_name = readings(scene, *names)
    agree(lambda p: (*instant(scene, moved)(p), *by_name(p)), closed, scene.parameters(), names)


# --- contacts with edges


@pytest.mark.parametrize("kind", ["box", "wedge"])
def test_a_ball_on_an_edge_is_pushed_along_the_line_from_it(kind):
    """K (r - s)^1.5 along that line, s = |p - edge|, of a finite plane and of a wedge of a right angle."""
    ball = Body("ball", "sphere", mass=2.0, inertia=1e-3, start={"x": 0.22, "y": 0.13})
    gap, at, sizes = {
        "box": (gaps.SphereOnBox(), (0.0, 0.0, 0.0), {"half_length": 0.2, "half_width": 0.1, "half_height": 0.3}),
        "wedge": (gaps.SphereOnWedge((1.0, 1.0, 0.0)), (0.2, 0.1, 0.0), {"half_angle": 0.25 * np.pi}),
    }[kind]
    hit = Contact("c", (GROUND, "ball"), gap, "hertz", at=(at, (0, 0, 0)))
    given = {"stiffness": 1e7, "exponent": 1.5, "radius": 0.05, "smoothing": 0.0, **sizes}
    scene = Mechanism("edge", [ball], [hit], given=given)

    def pushed(p):
        x = jnp.stack([p["ball.x"] - p.get("half_length", 0.2), p["ball.y"] - p.get("half_width", 0.1)])
        far = jnp.sqrt(x @ x)
        return p["stiffness"] * (p["radius"] - far) ** 1.5 * x / far / 2.0

    names = ("ball.x", "ball.y", "radius", "stiffness", *(("half_length", "half_width") if kind == "box" else ()))
    found = instant(scene, lambda y, p: scene.motions(NOW, y, p)["ball"].acceleration[:2])
    agree(found, pushed, scene.parameters(), names)


@pytest.mark.parametrize("gap", [gaps.CylinderOnPlane("z"), gaps.CapsuleOnPlane("z")], ids=["cylinder", "capsule"])
def test_a_cylinder_that_slides_sideways_begins_to_roll(gap):
    """2 K d bears it on both ends; -mu N v/sqrt(v^2 + v_t^2) brakes it, and turns it by that times (r - d)/I."""
    start = {"z": 0.05 - 1e-5, "vx": 0.4, "q0": np.sqrt(0.5), "q1": -np.sqrt(0.5)}
    body = Body("log", "free", mass=2.0, inertia=(6e-3, 6e-3, 2.5e-3), start=start)
    given = {**LINEAR, "radius": 0.05, "half_length": 0.1, "friction_dynamic": 0.3, "friction_speed": 0.2}
    scene = Mechanism("log", [body], [Contact("c", (GROUND, "log"), gap, "kelvin_voigt", "coulomb")], given=given)

    def rates(p):
        v, push = p["log.vx"], 2.0 * p["stiffness"] * (p["radius"] - p["log.z"])
        drag = -p["friction_dynamic"] * push * v / jnp.sqrt(v**2 + p["friction_speed"] ** 2)
        return drag / p["log.mass"], push / p["log.mass"], -drag * p["radius"] / p["log.inertia_z"]

    def found(y, p):
        one = scene.motions(NOW, y, p)["log"]
        return one.acceleration[0], one.acceleration[2], one.spin_rate[1]

    names = ("log.z", "log.vx", "radius", "stiffness", "friction_dynamic", "friction_speed", "log.inertia_z")
    agree(instant(scene, found), rates, scene.parameters(), names)


def test_a_box_on_its_edge_turns_by_what_tips_it():
    """I q'' = F c - x N: N = 2 K d at the arm x of its far corners, F at the height c above the middle; m y'' = N - m g."""
    q, deep = -0.2, 1e-5
    low = 0.1 * np.sin(-q) + 0.05 * np.cos(q)
    body = Body("box", "planar", mass=2.0, inertia=0.01, start={"y": low - deep, "angle": q})
    given = {**LINEAR, "half_length": 0.1, "half_width": 0.05, "half_height": 0.04}
    push = Force("push", "box", "x", 20.0, at=(0.0, 0.03, 0.0))
    floor = Contact("floor", (GROUND, "box"), gaps.BoxOnPlane("y"), "kelvin_voigt")
    scene = Mechanism("box", [body], [floor], [Gravity(), push], given=given)

    def rates(p):
        a, b, c, s = p["half_length"], p["half_width"], jnp.cos(p["box.angle"]), jnp.sin(p["box.angle"])
        bears, arm = -2.0 * p["stiffness"] * (p["box.y"] + a * s - b * c), a * c + b * s
        return (
            p["push.size"] / p["box.mass"],
            bears / p["box.mass"] - p["gravity"],
            (arm * bears - 0.03 * c * p["push.size"]) / p["box.inertia"],
        )

    names = ("box.y", "box.angle", "half_length", "half_width", "stiffness", "push.size", "box.mass", "box.inertia")
    agree(instant(scene, lambda y, p: scene.vector_field(NOW, y, p)[3:]), rates, scene.parameters(), names)


def test_a_press_fit_holds_by_its_interference():
    """n pads, pressed by k i each, brake a shaft that turns in them by n mu k i r."""
    shaft = Body("pin", "hinge", mass=0.1, inertia=1e-5, start={"speed": 3.0})
    fit = Contact("fit", (GROUND, "pin"), gaps.PinInBearing(pads=8), "kelvin_voigt", "coulomb")
    given = {**LINEAR, "radius": 0.01, "friction_dynamic": 0.3, "friction_speed": 0.02, "clearance_fit": -1e-5}
    scene = Mechanism("press", [shaft], [fit], given=given)

    def braked(p):
        slip = p["radius"] * p["pin.speed"]
        held = p["friction_dynamic"] * slip / jnp.sqrt(slip**2 + p["friction_speed"] ** 2)
        return [8.0 * held * p["stiffness"] * p["clearance_fit"] * p["radius"] / p["pin.inertia"]]

    names = ("clearance_fit", "stiffness", "friction_dynamic", "friction_speed", "pin.speed", "pin.inertia")
    agree(instant(scene, lambda y, p: scene.vector_field(NOW, y, p)[1:]), braked, scene.parameters(), names)


# --- at rest


@pytest.mark.full
@pytest.mark.parametrize(("push", "at"), [(4.0, "both"), (30.0, "one")])
def test_an_interference_fit_under_a_push(push, at):
    """F/2k while both sides are pressed, F below 2 k i; F/k - i beyond, where one side alone bears."""
    pin = Body("pin", "slide", axis="x", mass=0.1)
    fit = Contact("fit", (GROUND, "pin"), gaps.TwoSidedStop("x"), "kelvin_voigt")
    scene = Mechanism("fit", [pin], [fit], [Force("push", "pin", "x", push)], start="static",
                      given={**LINEAR, "clearance_fit": -1e-5})  # fmt: skip

    def closed(p):
        f, k, c = p["push.size"], p["stiffness"], p["clearance_fit"]
        return (f / (2.0 * k) if at == "both" else f / k + c), f

    names = ("push.size", "stiffness", *(("clearance_fit",) if at == "one" else ()))
    agree(readings(scene, "pin.position", "fit.normal"), closed, scene.parameters(), [names], rtol=1e-6)


@pytest.mark.full
def test_the_sag_of_a_chain_on_springs():
    """Each pin's spring bears the moment of all weights beyond it: k q_i = -m g sum of their arms."""
    links = [
        Body(f"link{i}", "hinge", f"link{i - 1}" if i else GROUND, at=(0.1, 0, 0) if i else (0, 0, 0), center=(0.05, 0, 0),
             mass="mass", inertia=1e-4) for i in range(3)
    ]  # fmt: skip
    coils = [JointSpring(f"coil{i}", f"link{i}", "coil") for i in range(3)]
    own = [(bj.Quantity("coil", "N m/rad", "of every pin"), 3.0)]
    scene = Mechanism("chain", links, loads=[Gravity(), *coils], start="static", own=own, given={"mass": 0.2})

    upto = np.tril(np.ones((3, 3)))

    def bent(q, p):
        way = jnp.cos(upto @ q)
        pins = 0.1 * (upto - np.eye(3)) @ way
        arms = [jnp.sum((pins + 0.05 * way)[i:] - pins[i]) for i in range(3)]
        return -p["mass"] * p["gravity"] * jnp.stack(arms) / p["coil"]

    def closed(p):
        q = jnp.zeros(3)
        for _ in range(40):  # It contracts by m g l/k.
            q = bent(q, p)
        return q

    found = readings(scene, *(f"link{i}.angle" for i in range(3)))
    agree(found, closed, scene.parameters(), [("coil", "mass")], rtol=1e-8)


@pytest.mark.full
@pytest.mark.parametrize("load", [1500.0, 3400.0], ids=["closed", "open"])
def test_the_preload_of_a_bolted_flange_and_its_opening(load):
    """Bolt k_b (x + s), s its preload's stretch: x = (F - k_b s)/(k_b + k_c) below 0, F/k_b - s above (Shigley, 8-7)."""
    plate = Body("plate", "slide", axis="z", at=(0, 0, 0.05), mass=1.0)
    flange = Contact("flange", (GROUND, "plate"), gaps.PointOnPlane("z"), "kelvin_voigt", at=((0, 0, 0.05), (0, 0, 0)))
    acting = [Spring("bolt", (GROUND, "plate"), 4e5, free_length=0.05 - 7e-3), Force("load", "plate", "z", load)]
    scene = Mechanism("flange", [plate], [flange], acting, start="static", given=LINEAR)

    def closed(p):
        k, c, s, f = p["bolt.stiffness"], p["stiffness"], 0.05 - p["bolt.free_length"], p["load.size"]
        x = jnp.where(f < k * s, (f - k * s) / (k + c), f / k - s)
        return x, k * (x + s), c * jnp.maximum(-x, 0.0)

    names = ("load.size", "bolt.stiffness", "bolt.free_length", *(("stiffness",) if load < 2800.0 else ()))
    found = readings(scene, "plate.position", "bolt.pull", "flange.normal")
    agree(found, closed, scene.parameters(), [names], rtol=1e-6, atol=1e-8)
