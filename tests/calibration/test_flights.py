"""What flights between contacts say of the loss, before a law is fitted: against closed forms, and on a record."""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq
from typer.testing import CliRunner

from bcfj_jax.cli import app
from bcfj_jax.contact import laws
from bcfj_jax.contact.normal import AbstractLaw
from calibration import load
from calibration.impacts.events import Event
from calibration.impacts.flights import contradicted, loss, restitutions

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
