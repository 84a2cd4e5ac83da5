"""No contact is stepped over: by momentum, by closed forms, by dense sampling; and steps end where amounts bend."""

from __future__ import annotations

import functools
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from by_numpy import by_numpy
from gap_cases import CASES
from hypothesis import given
from hypothesis import strategies as st
from oracles import within

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Drive, Mechanism, gaps, loads
from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism.model import Proximity
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.measured_error import measured, parted
from bcfj_jax.solve.plan import Plan, Points, plan
from bcfj_jax.solve.seeking import allowed
from bcfj_jax.solve.work_queue import integrate_queue

HARD = {"stiffness": 1e9, "exponent": 1.5}


def own(*names):
    return [(bj.Quantity(name, "1", name), 0.0) for name in names]


# Which steps are taken, of penetrations that are known functions of time.


def seen(function, t, speed, bends):
    depth, rate = jax.jvp(function, (t,), (jnp.ones_like(t),))
    return Proximity(*(jnp.atleast_1d(x) for x in (depth, rate, speed + jnp.abs(rate), 0.0 * t, bends + 0.0 * t)))


@functools.partial(jax.jit, static_argnums=(0, 4))
def walked(function, numbers, speed, bends, unsure=False):
    """From 0 to 1, each step tried ten times as long as the last: the ends of the steps taken, and steps tried."""
    sight = lambda t: seen(lambda t: function(t, numbers), t, speed, bends)  # noqa: E731

    def tried(carry):
        t, end, ends, taken, count = carry
        inner = tuple(sight(t + s * (end - t)) for s in (0.31, 0.5)) if unsure else ()
        share, longest = allowed(sight(t), sight(end), end - t, jnp.asarray(1e-9), inner, False)
        good = share >= 1.0
        ends = ends.at[taken].set(jnp.where(good, end, jnp.nan))
        return (
            jnp.where(good, end, t),
            jnp.where(good, jnp.minimum(1.0, end + jnp.minimum(10.0 * (end - t), longest)), t + share * (end - t)),
            ends,
            taken + good,
            count + 1,
        )

    start = jnp.zeros(()), jnp.ones(()), jnp.full(4000, jnp.nan), 0, 0
    _, _, ends, _, count = jax.lax.while_loop(lambda c: (c[0] < 1.0) & (c[4] < 4000), tried, start)
    return ends, count


def passing(t, n):
    """Two spheres of radii that add up to 1 pass each other on a straight line."""
    return 1.0 - jnp.sqrt((n[0] * (t - n[1])) ** 2 + n[2] ** 2)


@given(speed=st.floats(1.0, 1e3), when=st.floats(0.05, 0.95), aside=st.floats(0.0, 3.0))
def test_two_spheres_that_pass_each_other_are_seen_if_they_touch(speed, when, aside):
    ends, count = walked(passing, jnp.array([speed, when, aside]), speed, 1.0)
    ends = np.asarray(ends)[np.isfinite(ends)]
    assert ends[-1] == 1.0
    half = np.sqrt(max(1.0 - aside**2, 0.0)) / speed
    begins, over = when - half, when + half
    if abs(aside - 1.0) > 1e-3:
        # Some steps for each factor of ten of the distance, both ways, and more where they pass closely.
        assert count < 120
    if aside < 1.0 - 1e-6 and begins > 0.0:
        # A step ends while the spheres approach, where an error estimate then sees what the contact does.
        assert np.any((ends > begins - 1e-3 * half) & (ends < when + 1e-9))
        assert over > 1.0 or np.any((ends > begins) & (ends < over))


def waving(t, n):
    return n[0] * jnp.sin(n[1] * t + n[2]) - n[3]


@given(turns=st.floats(0.1, 40.0), phase=st.floats(0.0, 6.28), level=st.floats(-1.5, 1.5))
def test_a_wave_of_a_gap_of_the_users_own_is_seen_as_by_dense_sampling(turns, phase, level):
    numbers = jnp.array([1.0, 2.0 * np.pi * turns, phase, level])
    ends, count = walked(waving, numbers, 2.0 * np.pi * turns, 0.0, True)
    ends = np.append(0.0, np.asarray(ends)[np.isfinite(ends)])
    times = np.linspace(0.0, 1.0, 200_001)
    depth = np.sin(2.0 * np.pi * turns * times + phase) - level
    if np.abs(depth[[0, -1]]).min() < 1e-3 or np.abs(np.abs(level) - 1.0) < 1e-3:
        return
    changes = times[np.flatnonzero(np.diff(depth > 0))]
    # No step passes over two changes of the contact.
    assert ends[-1] == 1.0 and count < 40.0 * turns + 40.0
    assert np.all(np.diff(np.searchsorted(changes, ends)) <= 1)


# Gaps: the length over which they say that a penetration's course bends.

# Where a cylinder stands and capsules are parallel, and where an end takes over, the point of contact jumps. The penetration is
# the largest of all points', so that its course has a corner there below the cubic, which hides no touch. A cubic through the
# corner itself may be off: these begin turned from it, by an angle [rad], and near each other. Of boxes corners are above a face.
TURNED = {
    "cylinder": (0.3, None),
    "capsules": (0.3, (0.0102, 0.0136, -0.02)),
    "capsules-end": (0.0, (0.0102, 0.0, 0.094)),
    "boxes": (0.0, (0.01, 0.0, 0.05)),
}


@pytest.mark.parametrize("name", CASES)
def test_the_penetration_is_a_cubic_over_a_share_of_what_the_gap_says(name):
    """Both bodies move evenly, by a tenth of what bends it: the Hermite cubic then differs by a small share of that."""
    case = CASES[name]
    rng = np.random.default_rng(3)
    bends, angle, arm = case.gap.bends(cast(Any, case.sizes))
    begin, near = TURNED.get(name, (0.0, None))
    length = float(min(np.min(bends), 1e-2))
    # Only a gap of the user's own may say nothing.
    assert length > 0.0
    share, looked = 0.1, 0
    sizes = {k: np.asarray(v, dtype=float) for k, v in case.sizes.items()}

    def moving(place, way, spin, axis):
        """Penetrations at begin, middle and end of a motion from 0 to 1, and their rates at both ends."""

        def depths(t):
            turn = begin + spin * t
            c, s = jnp.cos(turn), jnp.sin(turn)
            zero = jnp.zeros(())
            cross = jnp.array([[zero, -axis[2], axis[1]], [axis[2], zero, -axis[0]], [-axis[1], axis[0], zero]])
            axes = c * jnp.eye(3) + s * cross + (1 - c) * jnp.outer(axis, axis)
            columns = tuple(tuple(axes[i, j] for i in range(3)) for j in range(3))
            moved = tuple(place[..., i] + way[i] * t for i in range(3))
            a = gaps.Frame((0.0, 0.0, 0.0), cast(Any, columns))
            b = gaps.Frame(moved, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
            return jnp.concatenate([jnp.ravel(jnp.asarray(f.depth)) for f in case.gap.faces(a, b, cast(Any, sizes))])

        return jax.vmap(lambda t: jax.jvp(depths, (t,), (jnp.ones_like(t),)))(jnp.array([0.0, 0.5, 1.0]))

    looking = by_numpy(moving)
    for _ in range(60):
        place = np.broadcast_to(case.place(rng), case.place(rng).shape)
        place = place if near is None else np.asarray(near) + 1e-3 * rng.uniform(-1.0, 1.0, 3)
        way = rng.normal(size=3)
        way *= share * length / np.linalg.norm(way)
        spin = share * (angle if np.isfinite(angle) else 30.0) / max(np.abs(place).max() / length, 1.0)
        spin = min(spin, share * length / float(arm)) if arm else spin
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        values, slopes = looking(place, way, spin, axis)
        # In the middle of a hollow the course bends sooner, and there is nothing to touch.
        near_enough = (values[1] >= -0.5 * length) | ~np.isfinite(np.min(bends))
        if not near_enough.any():
            continue
        looked += 1
        middle = 0.5 * (values[0] + values[2]) + (slopes[0] - slopes[2]) / 8.0
        above = (values[1] - middle)[near_enough]
        assert float(np.max(above if name in TURNED else np.abs(above))) <= 1e-3 * share * length + 1e-15
    assert looked


# Whole runs: two balls, by every solver, against momentum and energy.


def balls():
    bodies = [
        Body("a", "particle", mass=0.1, start={"x": "ax", "y": "ay", "vx": "vx"}),
        Body("b", "particle", mass=0.3),
    ]
    hit = Contact("hit", ("a", "b"), gaps.SphereOnSphere(), law="hertz", values={"radius_a": 0.01, "radius_b": 0.02})
    return Mechanism("balls", bodies, [hit], own=own("ax", "ay", "vx"), given=HARD)


BALLS = balls()


@functools.cache
def ends(solver):
    """(ax, ay, vx) -> velocities at the end of a run that lasts for twice the flight."""
    base = BALLS.parameters(ax=-1.0, vx=1.0)
    scene = BALLS.suited(base, 1.0, solver)
    how = plan(scene, "balanced", solver=solver)

    @jax.jit
    def run(ax, ay, vx):
        params = {**base, "ax": ax, "ay": ay, "vx": vx}
        end = -2.0 * ax / vx
        found = integrate(scene, params, jnp.stack([0.0 * end, end]), how)
        return found.states[-1, 6:], found.code

    return run


SOLVERS = ["tsit5", "dopri5", "dopri8", "bosh3", "rodas3", "kvaerno5", "sdirk2", "bdf"]


@pytest.mark.parametrize("solver", tiers.ci(SOLVERS, "tsit5"))
@given(far=st.floats(1.5, 1000.0), aim=st.floats(-2.5, 2.5), speed=st.floats(-1.0, 1.0))
def test_balls_that_meet_exchange_what_momentum_and_energy_say(solver, far, aim, speed):
    a, b, reach = 0.1, 0.3, 0.03
    ax, ay, vx = -far * reach, 0.4 * aim * reach, 10.0**speed
    velocities, code = ends(solver)(ax, ay, vx)
    u = np.asarray(velocities).reshape(2, 3)
    assert code == 0
    assert (a * u[0] + b * u[1]) == pytest.approx([a * vx, 0.0, 0.0], rel=1e-7, abs=1e-7 * a * vx)
    if abs(ay) > 0.999 * reach:
        return
    # Frictionless: the momentum along the line of centres at touch is 2 m v_n, m the reduced mass.
    normal = np.array([-np.sqrt(reach**2 - ay**2), ay, 0.0]) / reach
    push = 2.0 * a * b / (a + b) * vx * normal[0]
    expected = np.array([[vx, 0.0, 0.0] - push / a * normal, push / b * normal])
    # Meanwhile the line of centres turns: by the slip over its length, and a contact lasts for 2.94 d / v_n (Hertz), d its
    # greatest penetration.
    deepest = (1.25 * a * b / (a + b) * (vx * normal[0]) ** 2 / HARD["stiffness"]) ** 0.4
    turned = 2.94 * deepest / reach * abs(normal[1] / normal[0])
    assert u == pytest.approx(expected, rel=0.01 + turned, abs=(0.01 + turned) * vx)


@pytest.mark.slow
def test_one_program_of_a_queue_misses_none():
    base = BALLS.parameters(ax=-1.0, vx=1.0)
    far = np.array([0.05, 0.3, 1.0, 3.0, 10.0, 0.5, 0.06, 7.0])
    params = {name: np.broadcast_to(np.asarray(x), far.shape) for name, x in base.items()} | {"ax": -far}
    how = plan(BALLS, "balanced")
    found, _ = jax.jit(
        lambda p, e: integrate_queue(BALLS, Points(p, e, jnp.array([0.0, 1.0])), how, jnp.asarray(8), 4)
    )(params, 2.0 * far)
    assert np.asarray(found.code).tolist() == [0] * 8
    # Struck centrally: v (a - b)/(a + b) and 2 v a/(a + b).
    assert np.asarray(found.states)[:, -1, 6] == within(np.full(8, -0.5), 3e-3)
    assert np.asarray(found.states)[:, -1, 9] == within(np.full(8, 0.5), 3e-3)


@pytest.mark.slow
def test_a_plane_that_turns_strikes_what_it_would_pass():
    """A drive turns a plane; the point leaves it with the normal velocity that restitution gives."""
    paddle = Body("paddle", "hinge", mass=1.0, inertia=1e-2, drive=Drive("constant", speed=3.0))
    ball = Body("ball", "particle", mass=0.01, start={"x": 0.3 * np.cos(1.0).item(), "y": 0.3 * np.sin(1.0).item()})
    scene = Mechanism(
        "paddle", [paddle, ball], [Contact("hit", ("paddle", "ball"), gaps.PointOnPlane("y"), law="hertz")], given=HARD
    )
    run = bj.simulate(scene, scene.parameters(), np.linspace(0, 0.5, 6), read=["ball.velocity.x", "ball.velocity.y"])
    u = np.array([run.readings[f"ball.velocity.{k}"][-1] for k in "xy"])
    # Struck at 1/3 s, it leaves with twice the plane's velocity there, across the plane.
    assert u == within(2.0 * 3.0 * 0.3 * np.array([-np.sin(1.0), np.cos(1.0)]), 1e-2)


# Amounts over time.


def block(load):
    wall = Contact("wall", ("ground", "block"), gaps.PointOnPlane("-x"), at=((9.0, 0, 0), (0, 0, 0)), law="hertz")
    return Mechanism("block", [Body("block", "slide", axis="x", mass=2.0)], [wall], [load], given=HARD)


def wave(t, bodies, p):
    inside = jnp.abs(t - p["middle"]) < 0.5 * p["width"]
    return [loads.Action("block", (jnp.where(inside, 10.0, 0.0), 0.0, 0.0))]


@pytest.mark.parametrize("width", tiers.ci([1e-5, 1e-3, 1e-1]))
def test_a_pulse_of_a_table_gives_its_momentum(width):
    table = (np.array([0.0, 0.3, 0.3 + 0.5 * width, 0.3 + width]), np.array([0.0, 0.0, 7.0 / width, 0.0]))
    scene = block(loads.Force("push", "block", "x", table=tuple(tuple(x.tolist()) for x in table)))
    run = bj.simulate(scene, scene.parameters(), np.array([0.0, 1.0]), read=["block.velocity.x"])
    assert run.readings["block.velocity.x"][-1] == within(0.5 * 7.0 / 2.0, 1e-6)


@pytest.mark.parametrize("where", tiers.ci(["looked for", "given"], "looked for"))
@given(middle=st.floats(0.1, 0.9), size=st.floats(-3.3, -1.0))
def test_a_pulse_of_a_function_gives_its_momentum(where, middle, size):
    width = 10.0**size
    known = [(bj.Quantity(name, "s", name), 0.0) for name in ("middle", "width")]
    given_breaks = None if where == "looked for" else tuple(np.linspace(0.0, 1.0, 2001).tolist())
    scene = block(loads.Load("push", wave, ("block",), tuple(known), breaks=given_breaks))
    params = scene.parameters(middle=middle, width=width)
    run = bj.simulate(scene, params, np.array([0.0, 1.0]), read=["block.velocity.x"])
    assert run.readings["block.velocity.x"][-1] == within(10.0 * width / 2.0, 2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("solver", tiers.ci(["rodas3", "bdf"], "bdf"))
def test_functions_go_through_implicit_solvers(solver):
    known = [(bj.Quantity(name, "s", name), 0.0) for name in ("middle", "width")]
    scene = block(loads.Load("push", wave, ("block",), tuple(known))).suited({}, 1.0, solver)
    params = scene.parameters(middle=0.4, width=0.01)
    slope = jax.jit(
        jax.grad(
            lambda w: bj.reading_history(scene, {**params, "width": w}, jnp.array([0.0, 1.0]), ["block.velocity.x"])[
                "block.velocity.x"
            ][-1]
        )
    )
    run = bj.simulate(scene, params, np.array([0.0, 1.0]), read=["block.velocity.x"], solver=solver)
    assert run.readings["block.velocity.x"][-1] == within(10.0 * 0.01 / 2.0, 2e-2)
    assert np.isfinite(slope(jnp.asarray(0.01)))


def test_parts_say_where_they_bend():
    p = {"ramp": 0.2, "turn": 0.5, "over": 0.1, "hand.drive_ramp": 0.3}
    force = loads.Force("f", "b", size=1.0, ramp="ramp", reversal="turn", reversal_ramp="over")
    assert force.kinks(cast(Any, p)) == pytest.approx([0.2, 0.5, 0.6])
    assert loads.Gravity().kinks(cast(Any, p)) == [] and loads.Load("own", wave).kinks(cast(Any, p)) is None
    table = Drive("table", table=((0.0, 0.5, 2.0), (0.0, 1.0, 0.0)))
    assert np.concatenate(cast(Any, table.kinks("hand", cast(Any, p)))).tolist() == [0.0, 0.5, 2.0]
    assert Drive("ramp", speed=1.0, over=0.3).kinks("hand", cast(Any, p)) == [0.3]
    assert Drive("constant", speed=1.0).kinks("hand", cast(Any, p)) == []


@pytest.mark.slow
def test_unloading_is_seen_where_every_body_is_driven():
    """Walton and Braun's loop of a press, e = 0.7: it holds (1 - e^2) of the work of loading, 16 mJ."""
    press = Drive("table", table=((0, 0.5, 1, 1.5, 2), (0, 0.00025, 0.0005, 0.00025, 0)))
    pad = Contact("pad", ("ground", "platen"), gaps.PointOnPlane("-x", clearance=True), law="walton_braun")
    scene = Mechanism("press", [Body("platen", "slide", axis="x", mass=1.0, drive=press)], [pad],
                      given={"stiffness": 2e5, "restitution": 0.7, "clearance_pad": 1e-4}, end=2.0)  # fmt: skip
    times = np.linspace(0.0, 2.0, 4001)
    expected = 2e5 * (4e-4 - (4e-4 - float(press.position(jnp.asarray(1.25), "", {})) + 1e-4) / 0.49)
    many = bj.simulate(scene, scene.parameters(), times)
    few = bj.simulate(scene, scene.parameters(), times[::100], resolved_peaks=True)
    for run in (many, few):
        assert np.interp(1.25, run.times, run.force["pad"][:, 0]) == within(expected, 1e-3)
    held = 0.5 * 2e5 * 4e-4**2 * (1.0 - 0.49)
    assert np.trapezoid(many.force["pad"][:, 0], many.penetration["pad"]) == within(held, 1e-4)
    # What is summed in the solver's steps, however few samples are asked for.
    assert few.extremes["pad"].work == within(held, 1e-3)


# Limits and checks.


@pytest.mark.slow
def test_the_longest_step_is_kept():
    scene = block(loads.Force("push", "block", "x", size=1.0))
    params = scene.parameters()
    free = bj.simulate(scene, params, np.array([0.0, 1.0]))
    for longest in (1e-3, "1 ms"):
        run = bj.simulate(scene, params, np.array([0.0, 1.0]), longest_step=longest)
        assert run.stats["accepted"] >= 1000 > 100 > free.stats["accepted"]
    with pytest.raises(InputError, match="longest_step = -1"):
        bj.simulate(scene, params, np.array([0.0, 1.0]), longest_step=-1.0)


@pytest.mark.slow
def test_parameters_that_are_not_finite_do_not_cost_the_step_budget():
    scene, times = bj.scenes.impact(), jnp.linspace(0.0, 1e-3, 3)
    params = scene.parameters()
    run = jax.jit(lambda p: integrate(scene, p, times, plan(scene)))
    for name in ("stiffness", "mass", "approach_speed"):
        found = run({**params, name: jnp.asarray(np.nan)})
        assert found.code != 0 and int(found.accepted + found.rejected) < 100


def test_runs_that_part_in_one_event_are_told_from_chaos():
    times = np.linspace(0.0, 1.0, 101)
    still = {"hit": np.full(101, 2.0)}
    struck = {"hit": np.where(times < 0.25, 2.0, -2.0)}
    assert parted(times, still, struck, {}) == (0.25, "hit")
    assert parted(times, still, still, {}) == (pytest.approx(np.nan, nan_ok=True), "")
    # Under a load that stays on, rates ring; whether its forces part is seen by themselves.
    assert parted(times, still, struck, {"hit": np.ones((101, 1), bool)})[1] == ""
    # Errors that grow by ten at each of several events part no less in the end, and are no event.
    grown = {"hit": still["hit"] - 1e-6 * 10.0 ** np.floor(times * 8.0)}
    assert parted(times, still, grown, {})[1] == ""
    force = {"hit": np.zeros((101, 3))}
    found = measured(0.01, 0.0, times, force, force, (still, struck), tolerance=1e-5, wall_s=0.0)
    assert found.doubt[1] == 0.25 and "'hit'" in found.doubt[0] and found.worst == 0.0


def test_a_run_that_steps_over_a_contact_is_doubtful(monkeypatch):
    """Looks within steps switched off: the run misses the ball, the one that checks it does not."""
    monkeypatch.setattr(Mechanism, "shows_proximity", property(lambda self: False))
    scene = Mechanism("other_balls", BALLS.bodies, BALLS.contacts, own=BALLS.own, given=HARD)
    params = scene.parameters(ax=-0.5, vx=2.0)
    run = bj.simulate(scene, params, np.linspace(0.0, 0.6, 3001), measure_error=True)
    assert run.status == "doubtful" and "'hit'" in run.reason
    assert run.failure_time == within(0.47 / 2.0, 0.02)


@pytest.mark.slow
def test_a_plan_has_a_longest_step_that_may_be_traced():
    times = jnp.array([0.0, 1e-3])
    scene = bj.scenes.impact()
    steps = jax.jit(
        lambda x: integrate(scene, scene.parameters(), times, Plan(plan(scene).tolerance, longest=x)).accepted
    )
    assert int(steps(jnp.asarray(1e-5))) >= 100 > int(steps(jnp.asarray(jnp.inf)))
