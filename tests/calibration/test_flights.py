"""What flights between contacts say of the loss, before a law is fitted: against closed forms, and on a record."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from typer.testing import CliRunner

from bcfj_jax import InputError
from bcfj_jax.cli import app
from bcfj_jax.contact import laws
from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.data.reading import read
from calibration import init, load
from calibration.impacts.events import Event, contacts, falls
from calibration.impacts.flights import contradicted, loss, restitutions
from calibration.impacts.proposal import Run, understood
from calibration.impacts.slow_tests import is_slow

VALUES = {"stiffness": 1e6, "exponent": 1.5, "damping": 0.05, "mass": 0.2}


def exact(a: float, v: float) -> float:
    """Restitution of K d^n (1 + a d'), any n: a v - ln(1 + a v) = -a e v - ln(1 - a e v) (Hunt and Crossley 1975)."""
    x = a * v
    return brentq(lambda e: x - np.log1p(x) + e * x + np.log1p(-e * x), 1e-9, min(1.0, (1.0 - 1e-12) / x))


def drop(kept, speed: float, count: int, step: float = 1e-4) -> list[Event]:
    """Contacts of a drop whose restitution is a function of the speed."""
    begin, found = 0.3, []
    for _ in range(count):
        found.append(Event(0, 9, begin - step, begin, begin + 5e-3, 1.0, step))
        speed *= kept(speed)
        begin += 2.0 * speed / 9.80665
    return found


class Own(AbstractLaw):
    """A user's law that reads what ``memory_free`` reads."""

    needs = ("stiffness", "exponent", "damping")

    def force(self, penetration, rate, c):
        return c["stiffness"] * penetration ** c["exponent"] * jnp.maximum(1.0 + c["damping"] * rate, 0.0)


@pytest.mark.parametrize("law", [laws.make("memory_free"), Own()], ids=["memory_free", "own"])
@pytest.mark.parametrize("n", [1.0, 1.5, 2.3])
def test_the_restitution_of_a_law_is_the_closed_forms(n, law):
    speeds, values = np.array([0.3, 1.0, 4.0]), VALUES | {"exponent": n}
    found = restitutions(law, values, 0.2, speeds)
    np.testing.assert_allclose(found, [exact(0.05, v) for v in speeds], rtol=1e-3)
    assert contradicted("own", drop(lambda v: exact(0.05, v), 1.0, 7), law, values) == ""
    assert "1 - e grows" in contradicted("own", drop(lambda v: 0.7, 1.0, 7), law, values)


@pytest.mark.parametrize("b", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_the_exponent_of_a_loss_is_found(b, speed):
    found = loss(drop(lambda v: 1.0 - 0.1 * (v / speed) ** b, speed, 7))
    assert found is not None and abs(found.exponent - b) < 0.02 + 3.0 * found.deviation
    np.testing.assert_allclose(found.kept, 1.0 - 0.1 * (found.speeds / speed) ** b, rtol=2e-3)


def test_few_flights_and_no_loss_say_nothing():
    assert loss(drop(lambda v: 0.8, 2.0, 4)) is None
    assert loss(drop(lambda v: 1.0, 2.0, 9)) is None


def test_a_law_is_contradicted_by_flights_of_another_loss_alone():
    law = laws.make("memory_free")
    assert contradicted("own", drop(lambda v: exact(0.05, v), 3.0, 7), law, VALUES) == ""
    # What the damping is does not matter.
    assert contradicted("own", drop(lambda v: exact(0.05, v), 3.0, 7), law, VALUES | {"damping": 0.01}) == ""
    said = contradicted("drop", drop(lambda v: 0.85, 3.0, 7), law, VALUES)
    assert (
        "loss depends on speed otherwise" in said
        and "0.85 at 2.55 m/s" in said
        and "restitution in place of damping" in said
    )
    # Of a scene that calls its mass otherwise nothing is foretold.
    without = {name: x for name, x in VALUES.items() if name != "mass"}
    assert contradicted("drop", drop(lambda v: 0.85, 3.0, 7), law, without) == ""
    assert contradicted("drop", drop(lambda v: 0.85, 3.0, 7), laws.make("flores"), VALUES | {"restitution": 0.8}) == ""


def record(kept, path: Path) -> None:
    """A table of forces: half sines of 6 ms where a drop strikes."""
    times, force, mass, speed, begin = np.arange(0.0, 2.6, 1e-3), 0.0, 0.15, 3.0, 0.3
    for _ in range(6):
        own = kept(speed)
        inside = (times > begin) & (times < begin + 6e-3)
        peak = mass * speed * (1.0 + own) * np.pi / 12e-3
        force = force + np.where(inside, peak * np.sin(np.pi * (times - begin) / 6e-3), 0.0)
        begin, speed = begin + 6e-3 + 2.0 * own * speed / 9.80665, own * speed
    force = force + 0.3 * np.random.default_rng(1).standard_normal(times.size)
    np.savetxt(path, np.stack([times, force], 1), "%.6g", ",", header="Time (s),Fz (N)", comments="")


def test_a_drop_that_keeps_its_share_gets_a_law_of_restitution(here):
    record(lambda v: 0.86, Path("ball.csv"))
    done = CliRunner().invoke(app, ["init", "calibration", "ball.csv"])
    assert done.exit_code == 0, done.output
    text = Path("ball.toml").read_text()
    assert "restitution = { lower = 0.7" in text and "damping" not in text
    good = load("ball.toml")
    assert "restitution" in good.scene.quantities and not good.doubts
    # The law whose loss grows with the speed is doubted before the fit.
    Path("damped.toml").write_text(text.replace("restitution = {", "damping = { lower = 0.003, upper = 1.6 } #"))
    (doubt,) = load("damped.toml").doubts
    assert "loss depends on speed otherwise" in doubt.text


def test_a_drop_whose_loss_grows_keeps_its_damping(here):
    record(lambda v: exact(0.08, v), Path("ball.csv"))
    assert CliRunner().invoke(app, ["init", "calibration", "ball.csv"]).exit_code == 0
    assert "damping = {" in Path("ball.toml").read_text() and not load("ball.toml").doubts


def ball(rate=200.0, height=0.5, kept=0.8, held=0.1, span=1.5):
    """Clock (N,) [s] and height (N,) [m] of a ball that is held, falls, and bounces with a restitution."""
    clock = np.arange(0.0, span, 1.0 / rate)
    t, speed = clock - held - np.sqrt(2.0 * height / 9.81), kept * np.sqrt(2.0 * 9.81 * height)
    z = np.where(clock < held, height, height - 0.5 * 9.81 * np.maximum(clock - held, 0.0) ** 2)
    while (t > 0.0).any():
        z = np.where(t > 0.0, speed * t - 0.5 * 9.81 * t**2, z)
        t, speed = t - 2.0 * speed / 9.81, kept * speed
    return clock, z


@pytest.mark.parametrize(("rate", "noise"), [(30.0, 2e-3), (100.0, 5e-4), (240.0, 2e-4), (1000.0, 2e-5)])
def test_places_that_fall_say_their_unit_and_which_way_is_up(rate, noise):
    clock, z = ball(rate)
    z = z + noise * np.random.default_rng(1).standard_normal(z.size)
    for unit in (1.0, 1e-2, 1e-3):
        for up in (1.0, -1.0):
            assert falls(clock, up * z / unit + 7.0) == up * unit
    z[::9] = np.nan
    assert falls(clock, z) == 1.0
    # Neither a cart, a swing nor a body at rest falls, nor one that falls on the moon.
    for other in (0.8 * np.abs(clock - 0.6), 0.1 * np.sin(9.0 * clock), noise * z, z / 6.0):
        assert falls(clock, other) == 0.0


@pytest.mark.parametrize(("rate", "noise"), [(100.0, 5e-4), (240.0, 2e-4), (1000.0, 2e-4), (4000.0, 1e-5)])
def test_the_bounces_of_places_and_of_velocities_are_its_contacts(rate, noise):
    clock, z = ball(rate)
    speed, first = np.gradient(z, clock), 0.1 + np.sqrt(2.0 * 0.5 / 9.81)
    rng, touches = np.random.default_rng(2), first + np.sqrt(8.0 * 0.5 / 9.81) * np.cumsum([0.0, 0.8, 0.64])
    for kind, values, size in (("place", z, noise), ("velocity", -speed, 0.01)):
        found = contacts(f"body.{kind}.y", clock, values + size * rng.standard_normal(z.size))
        begins = np.array([e.begin + e.loose for e in found])
        assert begins.size >= 3 and np.abs(begins[:3] - touches[touches < 1.5][:3]).max() < 0.012 + 1.0 / rate


def test_a_bouncing_ball_is_a_drop_under_gravity(tmp_path):
    clock, z = ball()
    rows = "".join(f"{k},{3 * t:.4f},{1e3 * h:.2f}\n" for k, (t, h) in enumerate(zip(clock, z, strict=True)))
    (tmp_path / "ball.csv").write_text("Trajectories\n200\n,Ball,\nFrame,X,Z\n,mm,mm\n" + rows)
    init.run(tmp_path / "ball.csv", tmp_path / "ball.toml", init.Said(mass="0.1 kg"), lambda line: None)
    problem = load(tmp_path / "ball.toml")
    assert problem.scene.kind == "bounce" and problem.params["gravity"] == pytest.approx(9.81, rel=1e-3)
    low, high = next((f.lower, f.upper) for f in problem.free if f.name == "drop_height")
    assert low < 0.5 < high and problem.experiments[0].channels[0].observes == "body.place.y"
    np.testing.assert_allclose(problem.experiments[0].channels[0].values, z, atol=1e-5)
    # Of one bounce the fall says when and from where.
    (tmp_path / "one.csv").write_text(
        "t [s],h [m]\n" + "".join(f"{t},{h:.6f}\n" for t, h in zip(clock[:110], z[:110], strict=True))
    )
    init.run(tmp_path / "one.csv", tmp_path / "one.toml", init.Said(mass="0.1 kg"), lambda line: None)
    one = load(tmp_path / "one.toml")
    bounds = {f.name: (f.lower, f.upper) for f in one.free}
    low, high = one.experiments[0].bounds["time_offset"]
    assert one.scene.kind == "bounce" and bounds["drop_height"][0] < 0.5 < bounds["drop_height"][1] and low < 0.1 < high
    touches = [e.begin for e in contacts("body.place.y", clock, z)]
    first = 0.1 + np.sqrt(2.0 * 0.5 / 9.81)
    np.testing.assert_allclose(touches[:2], [first, first + 2.0 * 0.8 * np.sqrt(2.0 * 0.5 / 9.81)], atol=0.01)


def test_an_accelerometer_that_is_held_and_dropped_is_read_from_its_release_on(tmp_path):
    clock = np.arange(0.0, 1.5, 1e-3)
    reading = np.where(clock < 0.2, 9.81, 0.0)
    for at, peak in ((0.5, 300.0), (0.95, 200.0), (1.25, 130.0)):
        reading += np.where(np.abs(clock - at) < 0.01, peak * np.cos((clock - at) / 0.02 * np.pi), 0.0)
    rows = "".join(f"{t:.4f},{a:.4f}\n" for t, a in zip(clock, reading, strict=True))
    (tmp_path / "phone.csv").write_text("Time (s),Acceleration z (m/s^2)\n" + rows)
    init.run(tmp_path / "phone.csv", tmp_path / "phone.toml", init.Said(mass="0.2 kg"), lambda line: None)
    (one,) = load(tmp_path / "phone.toml").experiments
    assert one.times[0] == pytest.approx(0.2)
    low, high = one.bounds["acceleration_offset"]
    assert low < 9.81 < high  # In flight it reads 0, and falls by g.


def test_a_contact_that_rises_through_the_weight_ends_no_release(tmp_path):
    """Of an accelerometer slow enough that a sample before its contact reads its weight again."""
    clock = np.arange(0.0, 1.2, 1e-3)
    rises = np.where(np.abs(clock - 0.6) < 0.02, 250.0 * np.cos((clock - 0.6) / 0.04 * np.pi) ** 2, 0.0)
    reading = np.where(clock < 0.25, 9.81, 0.0) + rises + np.where(clock > 1.0, 9.81, 0.0)
    rows = "".join(f"{t:.4f},{-a:.4f}\n" for t, a in zip(clock, reading, strict=True))
    (tmp_path / "tup.csv").write_text("Time (s),Acceleration z (m/s^2)\n" + rows)
    found = understood(read(tmp_path / "tup.csv", "record"))
    (run,) = found.records
    assert clock[np.flatnonzero(np.isfinite(run.readings["m/s^2"]))[0]] == pytest.approx(0.25, abs=1.1e-3)
    assert len(run.events) == 1 and run.events[0].begin == pytest.approx(0.582, abs=4e-3)


@pytest.mark.parametrize("given", [True, False])
def test_places_that_fall_go_before_what_was_derived_from_them(given, tmp_path):
    """An accelerometer reads nothing in flight and its weight at rest; the second derivative of a place sums up to no weight."""
    clock, z = ball(rate=400.0)
    speed = np.gradient(z, clock)
    gained = np.gradient(speed, clock) + (0.0 if given else 9.81)
    rows = "".join(f"{t:.5f},{a:.5f},{v:.5f},{w:.4f}\n" for t, a, v, w in zip(clock, z, speed, gained, strict=True))
    (tmp_path / "ball.csv").write_text("Time (s),Position (m),Velocity (m/s),Acceleration (m/s²)\n" + rows)
    found = understood(read(tmp_path / "ball.csv", "record"))
    assert [*found.columns] == (["m"] if given else ["m/s^2", "m/s", "m"]) and found.falls == given


@pytest.mark.parametrize(("name", "head", "falls"), [
    ("tup", "Falling height [mm];250\n", True), ("tower", "Falltest;7\n", True), ("hammer", "", False),
])  # fmt: skip
def test_a_drop_that_the_file_states_has_its_weight_in_contact(name, head, falls, tmp_path):
    """Of a soft contact gravity gives 4 % of the speed; where nothing says that the body falls, a comment gives the line."""
    clock = np.arange(0.0, 0.06, 1e-4)
    push = 400.0 * np.sin(np.pi * np.clip((clock - 0.02) / 0.02, 0.0, 1.0))
    rows = "".join(f"{1e3 * t:.2f};{f:.3f}\n" for t, f in zip(clock, push, strict=True))
    (tmp_path / f"{name}.csv").write_text(f"{head}\nTime [ms];Force [N]\n" + rows)
    said = init.Said(mass="2 kg", speed="1.5 m/s")
    init.run(tmp_path / f"{name}.csv", tmp_path / "out.toml", said, lambda line: None)
    (one,) = load(tmp_path / "out.toml").experiments
    assert one.fixed.get("gravity", 0.0) == pytest.approx(9.81 * falls)
    assert ("where the body falls, add gravity" in (tmp_path / "out.toml").read_text()) != falls


@pytest.mark.parametrize(("kept", "kind"), [(1.0, "impact"), (0.97, "bounce")])
def test_hits_at_equal_times_are_no_bounces(kept, kind, tmp_path):
    """Of a swing, whose hits get weaker at one period; a ball that keeps 97 % of its speed flies shorter each time."""
    clock, begins = np.arange(0.0, 4.0, 1e-3), 0.5 + np.cumsum([0.0, *(0.8 * kept**k for k in range(4))])
    force = sum(100.0 * 0.8**k * np.sin(np.pi * np.clip((clock - t) / 0.02, 0.0, 1.0)) for k, t in enumerate(begins))
    rows = "".join(f"{t:.4f},{f:.4f}\n" for t, f in zip(clock, force, strict=True))
    (tmp_path / "hits.csv").write_text("t [s],F [N]\n" + rows)
    init.run(tmp_path / "hits.csv", tmp_path / "hits.toml", init.Said(mass="0.2 kg"), lambda line: None)
    assert load(tmp_path / "hits.toml").scene.kind == kind


def test_two_bodies_that_move_are_asked_for(tmp_path):
    clock = np.arange(0.0, 0.8, 2e-3)
    way = 0.25 * np.tanh((clock - 0.4) / 0.02)
    rows = "".join(f"{t:.4f},{0.25 - w:.5f},{0.25 + w:.5f}\n" for t, w in zip(clock, way, strict=True))
    (tmp_path / "carts.csv").write_text("Time (s),Cart A Velocity (m/s),Cart B Velocity (m/s)\n" + rows)
    with pytest.raises(InputError, match=r"two bodies move.*relative \[m/s\]"):
        understood(read(tmp_path / "carts.csv", "record"))


def test_a_place_that_an_instrument_shows_from_the_touch_on_is_that_of_an_impact():
    clock = np.linspace(-2e-3, 6e-3, 400)
    hit = np.where((clock > 0.0) & (clock < 4e-3), np.sin(np.pi * np.clip(clock, 0.0, 4e-3) / 4e-3), 0.0)
    for force in (1e3 * hit, 1e3 * hit**1.5, 1e3 * hit**2.5):  # The steeper the law, the later it is seen to touch.
        event = contacts("contact.normal", clock, force)
        assert not is_slow(Run("", clock, {"N": force, "m": 1e-3 * hit}, event))
    pressed = np.clip(clock, 0.0, 6e-3)
    event = contacts("contact.normal", clock, 1e6 * pressed)
    assert is_slow(Run("", clock, {"N": 1e6 * pressed, "m": pressed}, event))
