"""What ``check_geometry`` refuses, with which words, and that its plain formulas are those of ``joint.geometry``."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from oracles import within

from bcfj_jax.core.errors import InputError
from bcfj_jax.models.joint import checks, geometry
from bcfj_jax.models.joint.checks import check_geometry

CLEARANCES = [f"clearance_{pair}" for pair in ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball")]
JOINT = {
    "seat_radius": 0.040,
    "head_radius": 0.031,
    "ball_radius": 0.008,
    "pitch_radius": 0.0355,
    "offset": 0.0045,
    "contact_angle": math.radians(40.0),
    "conformity": 0.52,
    "joint_angle": math.radians(23.0),
    "balls": 6,
    **dict.fromkeys(CLEARANCES, 50e-6),
}


@given(angle=st.floats(0.0, 23.0), clearance=st.floats(0.0, 200e-6))
def test_the_default_joint_passes(angle, clearance):
    check_geometry({**JOINT, "joint_angle": math.radians(angle), **dict.fromkeys(CLEARANCES, clearance)})


@pytest.mark.parametrize(
    "more",
    [
        {"offset": 0.0},
        {"offset": -0.0045},
        {"balls": 13},
        {"balls": 1},
        {"name": "not a number, not read"},
    ],
)
def test_what_can_be_built_passes(more):
    check_geometry({**JOINT, **more})


# Changed values, the key that is named, its value as quoted, what would be right.
REFUSED = [
    ({"seat_radius": 0.030}, "seat_radius", "0.03 m", "larger than the head"),
    ({"clearance_seat_cage": 0.01}, "clearance_seat_cage", "0.01 m", "smaller clearances"),
    ({"clearance_head_cage": 0.01}, "clearance_seat_cage", "clearance_head_cage = 0.01 m", "smaller clearances"),
    ({"ball_radius": 0.0045}, "ball_radius", "0.0045 m", "give more than 0.0045 m"),
    ({"pitch_radius": 0.032}, "pitch_radius", "0.032 m", "give about 0.0328"),
    ({"pitch_radius": 0.0385}, "pitch_radius", "0.0385 m", "give about 0.0380"),
    ({"offset": 0.03}, "pitch_radius", "seat's track", "or a joint_angle of at most 0.2467 rad (14.135 deg)"),
    ({"clearance_seat_cage": 0.004}, "pitch_radius", "out of its window", "or less"),
    ({"balls": 14}, "balls", "14 balls", "fewer or smaller balls"),
    ({"clearance_cage_ball": -1e-6}, "clearance_cage_ball", "-1e-06 m", "does not fit into a smaller window"),
    *(({name: -1e-6}, name, "-1e-06 m", "give") for name in (*CLEARANCES, "clearance_of_another")),
    ({"joint_angle": math.pi / 2}, "joint_angle", "90 deg", "less than 90 deg"),
    ({"joint_angle": -0.1}, "joint_angle", "-0.1 rad", "less than 90 deg"),
    ({"joint_angle": math.radians(80.0)}, "joint_angle", "80 deg", "or a joint_angle of at most"),
    ({"joint_angle": 1.3, "contact_angle": 1.57, "offset": 0.0}, "joint_angle", "1.3 rad", "of at most 1.0"),
    ({"conformity": 0.5}, "conformity", "0.5", "ratio > 0.5"),
    ({"contact_angle": 0.0}, "contact_angle", "0 rad", "above 0 and below 90 deg"),
    ({"contact_angle": math.pi / 2}, "contact_angle", "90 deg", "above 0 and below 90 deg"),
    ({"balls": 6.5}, "balls", "6.5", "whole number"),
    ({"balls": 0}, "balls", "0", "whole number"),
    ({"ball_radius": math.nan}, "ball_radius", "nan m", "length > 0"),
    ({"offset": math.inf}, "offset", "inf m", "finite"),
    ({"pitch_radius": 0.0}, "pitch_radius", "0 m", "length > 0"),
    ({"clearance_cage_window_end": 0.02}, "clearance_cage_window_end", "0.02 m", "give less than 0.012 m"),
    ({"clearance_cage_window_end": 2e-4}, "clearance_cage_window_end", "0.0002 m", "or more"),
    ({"pilot_band": 0.1}, "pilot_band", "0.1 rad", "give more than"),
]


@pytest.mark.parametrize(("change", "key", "value", "remedy"), REFUSED, ids=lambda x: str(x)[:40])
def test_refusals_name_key_value_and_remedy(change, key, value, remedy):
    with pytest.raises(InputError) as caught:
        check_geometry({**JOINT, **change}, "my.toml: [scene]")
    where, rest = str(caught.value).split(f"my.toml: [scene] {key}: ")
    found, _, right = rest.rpartition("; ")
    assert not where and value in rest and remedy in right and found


def test_every_check_refuses_something_and_a_missing_key_skips_it():
    table = {check for _, check in checks._CHECKS}
    fired = set()
    for change, *_ in REFUSED:
        values = {k: float(v) for k, v in {**JOINT, **change}.items()}
        if any(checks._in_range(*item) for item in values.items()):
            continue
        fired |= {c for keys, c in checks._CHECKS if set(keys) <= set(values) and c(*(values[k] for k in keys))}
    assert fired == table


@pytest.mark.parametrize(("change", "key"), [(change, key) for change, key, *_ in REFUSED if len(change) == 1])
def test_missing_keys_skip_the_checks_that_need_them(change, key):
    check_geometry({})
    alone = any(checks._in_range(k, float(v)) for k, v in change.items())
    if not alone:
        # A value that is right by itself is wrong only beside the others.
        check_geometry(change)
    else:
        with pytest.raises(InputError, match=key):
            check_geometry(change)


SHAPES = {
    "rp": st.floats(0.02, 0.06),
    "ratio": st.floats(-0.5, 0.5),
    "beta": st.floats(0.0, 1.5),
}
AROUND = np.linspace(0.0, 2.0 * np.pi, 1441)


@given(**SHAPES)
def test_plain_formulas_are_those_of_the_geometry(rp, ratio, beta):
    e = ratio * rp
    rc = float(geometry.track_radius(rp, e))
    p = np.asarray(geometry.ball_centre(AROUND, beta, rc, e))
    reach = np.linalg.norm(p, axis=-1)
    assert checks.distances(rp, e, beta) == within((reach.min(), reach.max()), 1e-12)


@given(**SHAPES, balls=st.integers(2, 14), radius=st.floats(0.002, 0.02))
def test_balls_are_refused_exactly_where_they_overlap(rp, ratio, beta, balls, radius):
    e = ratio * rp
    rc = float(geometry.track_radius(rp, e))
    p = np.asarray(geometry.ball_centre(AROUND, beta, rc, e))
    q = np.asarray(geometry.ball_centre(AROUND + 2.0 * np.pi / balls, beta, rc, e))
    nearest = np.linalg.norm(p - q, axis=-1).min()
    # The grid misses the nearest place by up to an eighth of a degree.
    assume(abs(nearest - 2.0 * radius) > 1e-4 * rp)
    assert (checks.apart(balls, radius, rp, e, beta) is None) == (nearest > 2.0 * radius)


@given(**SHAPES, alpha=st.floats(0.1, 1.5), radius=st.floats(0.002, 0.02), thick=st.floats(1.0, 1.3))
def test_a_deflection_is_refused_exactly_where_no_mouth_is_left(rp, ratio, beta, alpha, radius, thick):
    """A mouth whose edge the shaft's axis does not reach, and the contacts of all balls on its side behind it."""
    e, seat = abs(ratio) * rp, thick * rp
    rc = float(geometry.track_radius(rp, e))
    p = np.asarray(geometry.ball_centre(AROUND, beta, rc, e))
    height = p[:, 2] + radius * np.cos(alpha) * (p[:, 2] - e) / rc
    mouths = np.linspace(0.0, seat, 2001)
    behind = (mouths > height.max()) | (mouths > -height.min())
    free = np.arctan2(np.sqrt(seat**2 - mouths**2), mouths) > beta
    left = seat * np.cos(beta) - min(height.max(), -height.min())
    assume(abs(left) > seat / 2000)
    assert (checks.mouth_open(seat, radius, rp, e, alpha, beta) is None) == bool(np.any(behind & free))


@pytest.mark.parametrize("alpha", [40.0, None])
def test_the_largest_deflection_named_is_one_that_passes(alpha):
    joint = {k: v for k, v in JOINT.items() if alpha is not None or k != "contact_angle"}
    with pytest.raises(InputError) as caught:
        check_geometry({**joint, "joint_angle": math.radians(80.0)})
    named = float(str(caught.value).rpartition("at most ")[2].split()[0])
    assert 50.0 < math.degrees(named) < 65.0
    check_geometry({**joint, "joint_angle": named})
    with pytest.raises(InputError, match="joint_angle"):
        check_geometry({**joint, "joint_angle": named + 2e-4})
