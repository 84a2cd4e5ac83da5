"""The next experiment: what candidates are said to bring, against closed forms of an undamped Hertz impact."""

from __future__ import annotations

import numpy as np
import pytest

from bcfj_jax import InputError, scenes
from bcfj_jax.contact.restitution import undamped_duration
from calibration import Channel, Experiment, Free, Problem
from calibration.selection.next_experiment import Candidate, predicted, table

pytestmark = pytest.mark.filterwarnings("error")

SCENE = scenes.impact(law="hertz", smoothing=False)
STIFFNESS, EXPONENT, MASS, SPEED = 1e8, 1.5, 0.1, 1.0
FREE = (Free("stiffness", 1e6, 1e10), Free("exponent", 1.0, 2.5))
TRUTH = {"stiffness": STIFFNESS, "exponent": EXPONENT}
WIDTHS = np.log([1e10 / 1e6, 2.5])
READINGS = 5


def peak(speed: float) -> float:
    """F = K^(1/(n + 1)) [(n + 1) m v^2/2]^(n/(n + 1))."""
    n = EXPONENT
    return STIFFNESS ** (1 / (n + 1)) * ((n + 1) * MASS * speed**2 / 2) ** (n / (n + 1))


def peak_slopes(speed: float) -> np.ndarray:
    """Derivative of that peak by ln K and ln n. At its peak a force does not depend on when it is read."""
    n = EXPONENT
    energy = (n + 1) * MASS * speed**2 / 2
    by_stiffness = 1 / (n + 1)
    by_exponent = (np.log(energy) - np.log(STIFFNESS)) / (n + 1) ** 2 + n / (n + 1) ** 2
    return peak(speed) * np.array([by_stiffness, n * by_exponent])


def at_peak(speed: float) -> np.ndarray:
    """Times so close about the peak that each reads it."""
    middle = 0.5 * float(undamped_duration(STIFFNESS, EXPONENT, MASS, speed))
    return middle * (1.0 + 1e-5 * np.linspace(-1.0, 1.0, READINGS))


def information(speed: float, sigma: float) -> np.ndarray:
    slopes = peak_slopes(speed) * WIDTHS / sigma
    return READINGS * np.outer(slopes, slopes)


def problem(*speeds: float, share: float = 0.01, free=FREE) -> Problem:
    params = SCENE.parameters(mass=MASS, approach_speed=SPEED, **TRUTH)
    records = tuple(
        Experiment(
            f"{v:g} m/s", at_peak(v), (Channel("contact.normal", np.full(READINGS, peak(v)), share * peak(v)),),
            fixed={"approach_speed": v},
        )
        for v in speeds
    )  # fmt: skip
    return Problem(SCENE, {k: float(v) for k, v in params.items()}, records, free)


def candidate(speed: float, share: float = 0.01) -> Candidate:
    return Candidate(f"{speed:g} m/s", at_peak(speed), {"contact.normal": share}, {"approach_speed": speed}, share=True)


@pytest.mark.slow
def test_the_exponent_of_hertz_needs_two_speeds():
    # Peaks of one speed fix one combination of K and n: every other speed tells the second, the further the better.
    speeds = (1.0, 1.2, 2.0, 4.0)
    gains = predicted(problem(SPEED), TRUTH, [candidate(v) for v in speeds])
    assert [gain.name for gain in gains] == ["4 m/s", "2 m/s", "1.2 m/s", "1 m/s"]
    first = information(SPEED, 0.01 * peak(SPEED)) + 12 * np.eye(2)
    for gain in gains:
        v = float(gain.name.removesuffix(" m/s"))
        before, after = np.linalg.inv(first), np.linalg.inv(first + information(v, 0.01 * peak(v)))
        assert gain.information == pytest.approx(0.5 * np.log(np.linalg.det(before) / np.linalg.det(after)), rel=1e-3)
        ratios = np.diag(after) / np.diag(before)
        assert gain.variance_left == pytest.approx(ratios.mean(), rel=1e-3)
        assert list(gain.shrink.values()) == pytest.approx(list(np.sqrt(ratios)), rel=1e-3)
    # The same again halves no interval that the first has left open.
    assert gains[-1].shrink["exponent"] > 0.99 and gains[0].shrink["exponent"] < 0.1


@pytest.mark.slow
def test_better_noise_and_more_readings_count_as_information():
    two = problem(1.0, 4.0)
    once, twice = predicted(two, TRUTH, [candidate(2.0, share=0.01), candidate(2.0, share=0.001)])
    assert once.information > twice.information and once.name == twice.name
    # Four times as precise data of both speeds: intervals of a quarter, whatever is known of the bounds.
    sharp = [candidate(v, share=0.01 / np.sqrt(15.0)) for v in (1.0, 4.0)]
    for gain, v in zip(sorted(predicted(two, TRUTH, sharp), key=lambda g: g.name), (1.0, 4.0), strict=True):
        before = information(1.0, 0.01 * peak(1.0)) + information(4.0, 0.01 * peak(4.0)) + 12 * np.eye(2)
        after = before + 15.0 * information(v, 0.01 * peak(v))
        ratios = np.diag(np.linalg.inv(after)) / np.diag(np.linalg.inv(before))
        assert list(gain.shrink.values()) == pytest.approx(list(np.sqrt(ratios)), rel=1e-3)


@pytest.mark.slow
def test_a_parameter_of_its_own_is_unknown_in_a_candidate_too():
    # With a gain of its own, free within a factor of 4, a peak tells only what the gain's bounds leave of it.
    gain = Free("gain", 0.5, 2.0)
    free = (*FREE, gain)
    values = {**TRUTH, "gain": 1.0}
    (informed,) = predicted(problem(SPEED, free=free), values, [candidate(4.0)])
    (sure,) = predicted(problem(SPEED), TRUTH, [candidate(4.0)])
    assert informed.information < 0.5 * sure.information
    width = np.log(4.0)

    def eliminated(speed: float) -> np.ndarray:
        slopes = np.append(peak_slopes(speed) * WIDTHS, peak(speed) * width) / (0.01 * peak(speed))
        whole = READINGS * np.outer(slopes, slopes) + 12 * np.diag([0.0, 0.0, 1.0])
        return whole[:2, :2] - np.outer(whole[:2, 2], whole[:2, 2]) / whole[2, 2]

    before = np.linalg.inv(eliminated(SPEED) + 12 * np.eye(2))
    after = np.linalg.inv(eliminated(SPEED) + eliminated(4.0) + 12 * np.eye(2))
    assert informed.information == pytest.approx(0.5 * np.log(np.linalg.det(before) / np.linalg.det(after)), rel=1e-3)


@pytest.mark.slow
def test_what_cannot_be_ranked_is_said():
    for broken, said in (
        (Candidate("a", at_peak(1.0), {"contact.normal": 1.0}, {"aproach_speed": 2.0}), "approach_speed"),
        (Candidate("a", at_peak(1.0), {"contact.normal": 0.0}), "deviation above 0"),
        (Candidate("a", at_peak(1.0), {"contcat.normal": 1.0}), "contact"),
        (Candidate("a", at_peak(1.0)[::-1], {"contact.normal": 1.0}), "must increase"),
    ):
        with pytest.raises(InputError, match=said):
            predicted(problem(SPEED), TRUTH, [broken])
    with pytest.raises(InputError, match="candidates: none"):
        predicted(problem(SPEED), TRUTH, [])
    # Where every parameter that is looked for is known of a candidate, it tells nothing.
    known = Candidate("known", at_peak(1.0), {"contact.normal": 1.0}, TRUTH)
    (gain,) = predicted(problem(SPEED), TRUTH, [known])
    assert gain.information == 0.0 and set(gain.shrink.values()) == {1.0}


def test_the_table_marks_what_shrinks_most():
    rows = table(predicted(problem(SPEED), TRUTH, [candidate(1.0), candidate(4.0)]))
    assert rows[1][0] == "4 m/s" and sum("*" in cell for cell in rows[1]) == 1
