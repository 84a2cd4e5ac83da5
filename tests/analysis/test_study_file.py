"""Study files: what they mean, and what is said of those that mean nothing."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from studies import STUDY

from bcfj_jax.analysis.studies.block import Blocks
from bcfj_jax.analysis.studies.specification import from_table, load
from bcfj_jax.core.errors import InputError


def given(text: str):
    return from_table(tomllib.loads(text), "s.toml")


def test_a_grid_has_all_combinations_and_its_own_bounds():
    found = given(STUDY)
    assert found.points.shape == (14, 2) and len(np.unique(found.points, axis=0)) == 14
    np.testing.assert_allclose(np.unique(found.points[:, 0]), np.geomspace(1e6, 1e8, 7), rtol=1e-14)
    assert found.points[0, 0] == 1e6 and found.points[-1, 0] == 1e8


def test_values_have_units():
    found = given(
        'scene = "joint"\n[vary.clearance_seat_cage]\nvalues = ["10 um", 2e-5]\n[vary.joint_angle]\nvalues = ["8 deg"]'
    )
    np.testing.assert_allclose(found.points, [[1e-5, np.deg2rad(8)], [2e-5, np.deg2rad(8)]])


def test_a_list_is_side_by_side():
    text = 'scene = "impact"\n[design]\nkind = "list"\n[vary.mass]\nvalues = [1.0, 2.0]\n'
    text += "[vary.damping]\nvalues = [0.1, 0.2]"
    np.testing.assert_array_equal(given(text).points, [[1.0, 0.1], [2.0, 0.2]])


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_drawn_designs_fill_every_stratum_and_are_the_same_for_the_same_seed(kind):
    text = (
        f'scene = "impact"\n[design]\nkind = "{kind}"\npoints = 64\nseed = SEED\n'
        '[vary.mass]\nlower = 0.1\nupper = 10.0\nscale = "log"\n[vary.damping]\nlower = 0.0\nupper = 0.5'
    )
    one, same, other = (given(text.replace("SEED", seed)).points for seed in ("3", "3", "4"))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
    shares = np.stack([np.log(one[:, 0] / 0.1) / np.log(100.0), one[:, 1] / 0.5], axis=1)
    assert all(sorted((64 * column).astype(int)) == list(range(64)) for column in shares.T)


def test_a_normal_scale_is_a_normal_distribution_cut_off_at_its_bounds():
    text = 'scene = "impact"\n[design]\nkind = "sobol"\npoints = 4096\n[vary.mass]\nlower = 0.4\nupper = 1.0\nscale = "normal"'
    found = given(text)
    values, (axis,) = found.points[:, 0], found.design.axes
    assert values.min() >= 0.4 and values.max() <= 1.0
    # Of a normal distribution cut off at 3 deviations, 1 - 6 phi(3)/(1 - 2 Phi(-3)) of the variance is left.
    assert abs(values.mean() - 0.7) < 1e-4 and abs(values.std() / 0.1 - 0.9866) < 1e-3
    assert abs(np.mean(np.abs(values - 0.7) < 0.1) - 0.6827 / 0.9973) < 1e-3
    shares = axis.share(values)
    assert np.allclose(np.sort(shares), (np.arange(4096) + 0.5) / 4096, atol=1 / 4096)
    h = 1e-6
    slope = (axis.at(shares[:50] + h) - axis.at(shares[:50] - h)) / (2 * h)
    assert np.allclose(axis.steepness(values[:50]), slope, rtol=1e-4)
    assert from_table(found.resolved, "s.toml").resolved == found.resolved


def test_a_pattern_varies_every_parameter_that_it_stands_for():
    text = 'scene = {{ scene = {{ kind = "joint", unequal = true, balls = 4 }} }}\n[design]\nkind = "sobol"\npoints = 4\n{}'
    table = '[vary."{}"]\nlower = "-30 um"\nupper = "30 um"\nscale = "normal"\n'
    found = given(text.format(table.format("ball_*.oversize")))
    assert found.names == tuple(f"ball_{i}.oversize" for i in range(1, 5))
    assert len({tuple(column) for column in found.points.T}) == 4
    for more, said in (("ball_2.oversize", "'ball_2.oversize' is varied twice"), ("ball_*.size", "names no parameter")):
        with pytest.raises(InputError, match=said):
            given(text.format(table.format("ball_*.oversize") + table.format(more)))


DRAWN = (
    'scene = "impact"\n[design]\nKIND\nseed = 0\n'
    '[vary.mass]\nlower = 0.1\nupper = 10.0\nscale = "log"\n[vary.damping]\nlower = 0.0\nupper = 0.5'
)


@pytest.mark.parametrize(("options", "length"), [("second_order = false", 4), ("second_order = true", 6)])
def test_saltellis_blocks_take_one_parameter_from_the_other_sample(options, length):
    pytest.importorskip("SALib", reason="the extra study is not installed")
    found = given(DRAWN.replace("KIND", f'kind = "saltelli"\nsamples = 8\n{options}'))
    assert found.count == 8 * length and found.points.shape == (8 * length, 2)
    for block in found.points.reshape(8, length, 2):
        a, b = block[0], block[-1]
        np.testing.assert_array_equal(block[1:3], [[b[0], a[1]], [a[0], b[1]]])


def test_a_trajectory_of_morris_moves_each_parameter_once_and_evenly_on_a_log_axis():
    pytest.importorskip("SALib", reason="the extra study is not installed")
    found = given(DRAWN.replace("KIND", 'kind = "morris"\ntrajectories = 8\nlevels = 4'))
    assert found.count == 8 * 3
    shares = np.stack([axis.share(found.points[:, k]) for k, axis in enumerate(found.design.axes)], axis=1)
    steps = np.abs(np.diff(shares.reshape(8, 3, 2), axis=1))
    np.testing.assert_allclose(steps.sum(axis=1), 2 / 3, atol=1e-12)
    assert np.all(np.count_nonzero(steps, axis=2) == 1)


@pytest.mark.parametrize(
    "text",
    [
        STUDY,
        DRAWN.replace("KIND", 'kind = "saltelli"\nsamples = 16\nsecond_order = true'),
        DRAWN.replace("KIND", 'kind = "morris"\ntrajectories = 16\nlevels = 6'),
    ],
)
def test_what_was_resolved_means_the_same(tmp_path, text):
    import tomli_w

    found = given(text)
    path = tmp_path / "run.toml"
    path.write_text(tomli_w.dumps(found.resolved))
    again = load(path)
    assert again.resolved == found.resolved and again.own_end == found.own_end
    np.testing.assert_array_equal(again.points, found.points)
    blocks, same = Blocks(found), Blocks(again)
    assert blocks.names == same.names


def test_blocks_take_every_point_once_the_costly_first():
    text = (
        'scene = "bounce"\n[time]'
        if False
        else STUDY.replace('"impact"', '"bounce"').replace("steps = 7", "steps = 40")
    )
    blocks = Blocks(given(text))
    assert sorted(np.concatenate([blocks.points(k) for k in range(len(blocks))])) == list(range(80))
    stiffness = blocks.study.points[blocks.order, 0]
    assert stiffness[:20].mean() > stiffness[-20:].mean()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (('kind = "grid"', 'kind = "gird"'), r"\[design\] kind: no design 'gird'; .*grid"),
        (('kind = "grid"', 'kind = "sobol"'), r"points: missing for sobol"),
        (('kind = "grid"', 'kind = "grid"\npoints = 3'), r"points: a grid gets its number of points"),
        (('kind = "grid"', 'kind = "saltelli"'), r"samples: missing for saltelli"),
        (('kind = "grid"', 'kind = "saltelli"\npoints = 64'), r"points: no key of a saltelli; say samples"),
        (('kind = "grid"', 'kind = "morris"\ntrajectories = 9\nlevels = 5'), r"levels: 5 is odd"),
        (('kind = "grid"', 'kind = "morris"\ntrajectories = 9\nsecond_order = true'), r"second_order: no key of a"),
        (('kind = "grid"', 'kind = "grid"\nlevels = 4'), r"levels: no key of a grid; take it out"),
        (("steps = 7", ""), r"vary.stiffness\] steps: missing"),
        (("lower = 1e6", "lower = 1e9"), r"is not below upper"),
        (("lower = 1e6", "lower = -1.0"), r"out of range"),
        (("[vary.stiffness]", "[vary.stifness]"), r"no parameter 'stifness'.*stiffness"),
        (("[vary.stiffness]", "[vary.clearance_seat_cage]"), r"no parameter 'clearance_seat_cage'"),
        (('scale = "log"', 'scale = "ln"'), r"no scale 'ln'"),
        (("contact.peak", "contact.peek"), r"no feature 'peek'.*peak"),
        (("contact.peak", "contact.impulse"), r"'contact.impulse' is listed twice"),
        (("[results]", "[results]\nhistory = true"), r"unknown key 'history'.*histories"),
        (("[results]", '[results]\nderivatives = ["masss"]'), r"no parameter 'masss'.*mass"),
        (('scene = "impact"', 'scene = "impcat"'), r"scene: no file and no scene .impcat.; did you mean .impact"),
        (("values = [0.0, 0.1]", "values = []"), r"values: is empty"),
        (("values = [0.0, 0.1]", "values = [0.1]\nlower = 0.0"), r"values and bounds are both given"),
    ],
)
def test_what_means_nothing_is_said_so(change, said):
    with pytest.raises(InputError, match=f"(?s){said}"):
        given(STUDY.replace(*change))
