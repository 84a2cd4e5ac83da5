"""Motion that repeats itself: what a short run says of a long one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from joints import plain_joint

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives import sensitivity, steady
from bcfj_jax.analysis.derivatives.jacobian import Histories, Level
from bcfj_jax.analysis.derivatives.repeating import fold
from bcfj_jax.core.status import OK

PITCH = 0.13
TIMES = np.linspace(0.0, 3.0, 701)


def scene(turned: int) -> Any:
    """Five members that do one after the other what one did, and a contact without members."""
    return SimpleNamespace(members={"ball": 5, "seat": 0}, turned=lambda _: turned, period=lambda _: (5 * PITCH, PITCH))


def course(times: np.ndarray, turned: int, fades: float = 0.0) -> np.ndarray:
    """(T, 6) of motion that is steady but for what fades: member j does a pitch later what member j + turned did."""
    # Where members are not renumbered, each repeats itself every pitch.
    ahead = pow(turned, -1, 5) if turned else 0
    phase = (1 if turned else 5) * times[:, None] / PITCH + np.arange(5) * ahead
    force = [
        np.sin(2 * np.pi * phase / 5) + 0.3 * np.cos(6 * np.pi * phase / 5),
        np.cos(2 * np.pi * times / PITCH)[:, None],
    ]
    return np.concatenate(force, axis=1) + fades * np.exp(-times)[:, None]


def solved(times: np.ndarray, turned: int, fades: float = 0.0) -> Level:
    value, slope = course(times, turned), np.stack([course(times, turned, fades), 2.0 * course(times, turned)])
    thrice = (value[..., None] * np.ones(3), value, value)
    by = (slope[..., None] * np.ones(3), slope, slope)
    state = np.stack([times, times])[..., None]
    return Level(
        1e-5, Histories(*thrice, state=times[:, None]), Histories(*by, state=state), OK, 3.0, 1, 0, 1.0, 0.0, np.ones(1)
    )


@pytest.mark.parametrize("turned", [1, -1, 2, 0])
@pytest.mark.parametrize("end", [0.6, 0.731, 1.3])
def test_a_short_run_says_what_the_long_one_does(turned, end):
    short = fold(scene(turned), cast(Any, {}), TIMES, end)
    assert np.all(np.diff(short.times) > 0) and short.times[-1] == pytest.approx(end)
    found, whole = short.unfolded(solved(short.times, turned)), solved(TIMES, turned)
    for one, other in ((found.value, whole.value), (found.derivative, whole.derivative)):
        for key in ("force", "penetration", "rate"):
            np.testing.assert_allclose(getattr(one, key), getattr(other, key), atol=1e-8)
    np.testing.assert_allclose(found.uneven, 0.0, atol=1e-8)


def test_what_has_not_faded_is_seen():
    short = fold(scene(1), cast(Any, {}), TIMES, 0.8)
    found = short.unfolded(solved(short.times, 1, fades=0.5))
    # The force and the second derivative repeat themselves; the first loses an eighth of exp(-t)/2 in a pitch.
    assert found.uneven[[0, 2]] == pytest.approx(0.0, abs=1e-8)
    assert 0.02 < found.uneven[1] < 0.1


@pytest.mark.parametrize("kept", [0.0, 1e-3, 0.3, 0.8, 1.02])
def test_pitch_after_pitch_leads_to_the_derivatives_of_the_fixed_point(kept):
    # x' = A x + B p, A of spectral radius "kept": dx/dp = (I - A)^-1 B.
    rng = np.random.default_rng(1)
    turned, _ = np.linalg.qr(rng.normal(size=(5, 5)))
    matrix, given = kept * turned, rng.normal(size=(5, 2))

    def solve(begin: steady._Start) -> steady._Pitch:
        slopes, left = matrix @ begin.slopes + given, matrix @ begin.disturbance
        size = np.linalg.norm(left)
        end = begin._replace(slopes=slopes, disturbance=left / (size or 1.0))
        # The pitch's forces are its start.
        return steady._Pitch(
            end, np.zeros((1, 5, 1)), np.zeros((1, 5)), begin.slopes[None, :, None], begin.slopes[None], size, 1.0,
            np.zeros(2), OK, 1,
        )  # fmt: skip

    start = steady._Start(np.zeros(5), np.zeros((5, 2)), np.full(5, 0.2**0.5), 1.0)
    found = steady._orbit(solve, start, 1.0)
    assert found is not None and found.memory == pytest.approx(kept)
    if kept < 1.0:
        exact = np.linalg.solve(np.eye(5) - matrix, given)
        assert np.abs(found.last.force_slopes[0, :, 0] - exact).max() < 2e-3 * np.abs(exact).max()


@pytest.mark.slow
def test_derivatives_of_the_short_run_are_those_of_the_whole(monkeypatch):
    joint = plain_joint()
    params, times, wrt = joint.parameters(), np.linspace(0.0, 2.0, 1001), ("stiffness", "clearance_seat_cage")
    stages: list[Any] = []
    short = bj.sensitivity(joint, params, times, wrt, differences="none", steady=True, tell=stages.append)
    # Steady motion is told first, then what nothing was compared with.
    alone, first = stages[:2]
    assert not alone.features and alone.steady and not alone.steady.verdicts
    assert first.features == short.features and first.certificate is None and first.steady is alone.steady
    assert short.steady and not short.steady.reason and short.steady.memory < 0.01
    for name, row in short.steady.feature_derivatives.items():
        for feature, slope in row.items():
            stated, least = (
                short.steady.apart[name][feature],
                0.01 * abs(short.steady.features[feature] / float(params[name])),
            )
            other = alone.steady.feature_derivatives[name][feature]
            assert abs(slope - other) <= (stated + 0.01) * max(abs(slope), abs(other), least)
    folded = []
    monkeypatch.setattr(sensitivity, "settled", lambda *_: folded.append(0))
    whole = bj.sensitivity(joint, params, times, wrt, differences="none")
    assert folded and short.certificate and whole.certificate
    assert short.stats["accepted"] < 0.7 * whole.stats["accepted"]
    for name in wrt:
        for contact, slope in short.derivative[name].items():
            other = whole.derivative[name][contact]
            size = np.linalg.norm(np.concatenate([x.ravel() for x in whole.derivative[name].values()]))
            stated = sum(c.parameters[name].pointwise for c in (short.certificate, whole.certificate))
            assert np.linalg.norm(slope - other) <= stated * size
        for feature, slope in short.feature_derivatives[name].items():
            other = whole.feature_derivatives[name][feature]
            bounds = [c.parameters[name].features[feature] for c in (short.certificate, whole.certificate)]
            least = 0.01 * abs(whole.features[feature] / float(params[name]))
            if np.isfinite(other):
                assert abs(slope - other) <= sum(bounds) * max(abs(slope), abs(other), least)
