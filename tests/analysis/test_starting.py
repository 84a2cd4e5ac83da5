"""Onset, start-up window and settling by their names: closed forms, derivatives, and the same from a batch."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bcfj_jax.analysis.derivatives.jacobian import Histories
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import feature, feature_unit
from bcfj_jax.analysis.designs.objective import objective
from bcfj_jax.analysis.studies import batch
from bcfj_jax.core.errors import InputError

CONTACTS = {"pilot": 0, "ball": 2}
TIMES, PERIOD, FADE = np.linspace(0.0, 6.0, 6001), 0.6, 0.5


def test_the_first_and_the_last_member_bear_when_their_lines_say():
    force = np.zeros((TIMES.size, 3, 3))
    for k, at in enumerate((0.5, 0.1, 0.9)):
        force[:, k, 0] = (-1.0 if k == 0 else 1.0) * np.clip(5.0 * (TIMES - at), 0.0, 4.0)
    # By a shift of the lines, and by their size.
    later = np.where((np.abs(force) > 0.0) & (np.abs(force) < 4.0), -5.0 * np.sign(force), 0.0)
    flat = np.zeros(force.shape[:2])
    value, slopes = (
        Histories(force, flat, flat, None),
        Histories(np.stack([later, force]), flat[None], flat[None], None),
    )
    names = ("pilot.onset", "ball.onset", "ball.start_window", "ball_2.onset", "pilot.settling")
    wanted = [feature(name, CONTACTS) for name in names]
    numbers, by = measure(TIMES, value, slopes, wanted, CONTACTS, turning=True)
    # 5 % of 4 N is borne 0.04 s after the beginning.
    assert numbers[:4] == pytest.approx([0.54, 0.14, 0.94, 0.94], abs=1e-9)
    assert by[:4, 0] == pytest.approx(np.ones(4), abs=1e-6) and by[:4, 1] == pytest.approx(np.zeros(4), abs=1e-9)
    assert math.isnan(numbers[4]) and np.isnan(by[4]).all()
    assert {feature_unit(name) for name in names} == {"s"}
    silent = measure(TIMES, value._replace(force=0.0 * force), slopes, wanted, CONTACTS, turning=True)
    assert np.isnan(silent[0]).all()


class Turning:
    """What ``batch`` asks of a scene."""

    members = CONTACTS
    traits = type("Traits", (), {"turning": True})


def test_settling_is_when_what_fades_no_longer_shows():
    fading = 2.0 + np.sin(2.0 * np.pi * TIMES / PERIOD)
    force = np.stack([fading + np.exp(-TIMES / (slow * FADE)) for slow in (1.0, 0.5, 1.5)], 1)
    # The period is found from the history, to 2e-4 of it, which moves these times by some 10 ms.
    # exp(-t/s) (1 - exp(-T/s)) = 0.05 max F, whose peak is 3 at the end.
    expected = [-s * math.log(0.15 / (1.0 - math.exp(-PERIOD / s))) for s in (FADE, 0.5 * FADE, 1.5 * FADE)]
    grid = TIMES / TIMES[-1]
    for name, wanted in (
        ("pilot.settling", expected[0]),
        ("ball_1.settling", expected[1]),
        ("ball.settling", expected[2]),
    ):
        at = feature(name, CONTACTS)
        three = np.repeat(force[:, :, None], 3, 2)
        value, none = Histories(three, force, force, None), np.zeros((0, *force.shape))
        assert 6.0 * batch.measured(Turning, [at], grid, value)[0][0] == pytest.approx(wanted, abs=0.02)
        slopes = Histories(np.zeros((0, *three.shape)), none, none, None)
        assert measure(TIMES, value, slopes, [at], CONTACTS, True)[0][0] == pytest.approx(wanted, abs=0.02)
    onset = feature("ball.onset", CONTACTS)
    assert batch.measured(Turning, [onset], grid, value)[0][0] == 0.0


def test_no_batch_differentiates_a_time_of_a_start():
    with pytest.raises(InputError, match="onset has no derivative"):
        objective("pilot.onset", (), CONTACTS)
