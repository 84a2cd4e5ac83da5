"""Gaps by name with their options, what is refused of them, and a gap of one's own."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from gap_cases import CASES, found, frame, numbers, turned
from joints import unit

from bcfj_jax.contact import gaps
from bcfj_jax.contact.gaps import GAPS, AbstractGap, Face, Frame, from_depth, make_gap
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.quantities import CATALOGUE, Quantity
from bcfj_jax.core.vectors import seen, subtract


def test_gaps_by_name():
    assert len(GAPS) == 17
    for name, kind in GAPS.items():
        gap = make_gap(name)
        assert type(gap) is kind and hash(gap) == hash(make_gap(name)) and gap == make_gap(name)
        assert set(gap.needs) <= set(CATALOGUE) | set(gap.quantities)
        for need in CASES:
            case = CASES[need]
            if case.name == name:
                assert set(case.gap.needs) == set(case.sizes)
                sizes = {key: abs(x) if case.gap.preloads else x for key, x in case.sizes.items()}
                assert all({**CATALOGUE, **gap.quantities}[key].valid(x) for key, x in sizes.items())
    assert make_gap("sphere_on_plane", axis=[0, 3, 4]) == make_gap("sphere_on_plane", axis=(0.0, 0.6, 0.8))


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("pin_in_bering", {}, "gap: no gap 'pin_in_bering'; did you mean 'pin_in_bearing'?"),
        ("ball_in_groove", {"track": 6}, "gap 'ball_in_groove': no option 'track'; did you mean 'tracks'?"),
        ("sphere_on_sphere", {"radius": 1.0}, "no option 'radius'; known here: nothing"),
        ("ball_in_groove", {"side": "outter"}, "did you mean 'outer'?"),
        ("ball_in_groove", {"tracks": -1}, "give a whole number from 0 to 1000"),
        ("ball_in_groove", {"tracks": True}, "give a whole number from 0 to 1000"),
        ("sphere_on_plane", {"axis": "w"}, "no axis 'w'"),
        ("sphere_on_plane", {"axis": [0, 0, 0]}, "give x, y or z"),
        ("sphere_on_plane", {"axis": [0, 1]}, "give x, y or z"),
        ("sphere_on_plane", {"axis": 3}, "give x, y or z"),
        ("sphere_on_plane", {"clearance": 1e-3}, "give true or false"),
        ("pin_in_slot", {"axis": "z"}, "is not across z"),
        ("pin_in_bearing", {"ends": "both"}, "give true or false"),
        ("sphere_in_socket", {"axis_of": "c"}, "no axis_of 'c'"),
    ],
)
def test_what_is_refused(name, options, said):
    with pytest.raises(InputError, match="gap") as refused:
        make_gap(name, **options)
    assert said in str(refused.value)


# --- one of your own


class PinOnCam(AbstractGap):
    """A pin of b on a round cam of a, off its axis: fifteen lines or fewer."""

    needs = ("cam_radius", "throw", "radius")
    quantities = {
        q.name: q for q in (Quantity("cam_radius", "m", "radius of the cam", 0.0), Quantity("throw", "m", "e"))
    }

    def faces(self, a: Frame, b: Frame, c) -> tuple[Face, ...]:
        x, y, _ = seen(a.axes, subtract(b.place, a.place))
        distance = jnp.hypot(x - c["throw"], y)
        n = tuple(-((x - c["throw"]) * e + y * f) / distance for e, f in zip(*a.axes[:2], strict=True))
        return (Face(c["cam_radius"] + c["radius"] - distance, n, tuple(c["radius"] * e for e in n)),)


def test_a_gap_of_ones_own():
    sizes = {"cam_radius": 0.03, "throw": 0.01, "radius": 5e-3}
    simple = from_depth(lambda r, c: c["cam_radius"] + c["radius"] - jnp.hypot(r[0] - c["throw"], r[1]), tuple(sizes))
    rng = np.random.default_rng(14)
    axes, start = turned(0.7, unit(rng)), rng.normal(size=3)
    local = np.array([0.04, 0.02, 0.01]) + 1e-3 * rng.normal(size=(5, 3))
    a, b = frame(start, axes), frame(start + local @ axes.T, np.eye(3))
    one, two = (found(gap, a, b, numbers(sizes)) for gap in (PinOnCam(), simple))
    assert np.allclose(one[0], 0.035 - np.hypot(local[:, 0] - 0.01, local[:, 1]), rtol=0, atol=1e-14)
    assert np.allclose(one[0], two[0], rtol=0, atol=1e-15) and np.allclose(one[1], two[1], rtol=0, atol=1e-12)
    assert np.allclose(one[2], 5e-3 * np.asarray(one[1])) and np.all(two[2] == 0.0)
    # Each member with a throw of its own; alone, without members.
    throws = {**sizes, "throw": 0.01 * np.linspace(0.9, 1.1, 5)}
    many = found(simple, a, b, numbers(throws))
    last = found(simple, a, frame(start + axes @ local[4], np.eye(3)), numbers({**sizes, "throw": 0.011}))
    assert np.allclose(many[0][:, 4], last[0]) and np.allclose(many[1][:, 4], last[1])
    assert simple.needs == tuple(sizes) and PinOnCam().quantities["throw"].unit == "m"
    assert PinOnCam().members == 0 and not PinOnCam().signed


@pytest.mark.parametrize(
    "given", [3.0, "x", [0.1, 0.1], [-0.1, 0.2, 0.3], [[0.0] * 6], [[0.0, 0.0, 1.0], [0.0]], [[np.nan] * 6]]
)
def test_edges_that_are_none_are_refused(given):
    with pytest.raises(InputError, match=r"option 'edges_a'.*give a list of edges"):
        gaps.CapsuleOnCapsule(edges_a=given)
    if isinstance(given, (float, str)):
        with pytest.raises(InputError, match=r"option 'points'.*give a list of points"):
            gaps.SphereOnBox(points=given)
    box = gaps.CapsuleOnCapsule(edges_a=np.array([0.3, 0.2, 0.1])).edges_a
    ends = np.reshape(box, (12, 2, 3))
    assert len(set(box)) == 12 and np.all(np.abs(ends) == [0.3, 0.2, 0.1])
    np.testing.assert_allclose(np.sort(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)), np.repeat([0.2, 0.4, 0.6], 4))
