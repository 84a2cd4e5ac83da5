"""Global sensitivity against closed forms: Ishigami's function, and the impact's peak, a product of powers."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from commands import bcfj
from studies import IMPACT, ishigami, peak_variances

import bcfj_jax as bj
from bcfj_jax.analysis.studies import sensitivity
from bcfj_jax.analysis.studies.api import Finished, read
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.core.errors import InputError

pytest.importorskip("SALib", reason="the extra study is not installed")
pytest.importorskip("pyarrow", reason="the extra study is not installed")

ISHIGAMI_S1, ISHIGAMI_ST = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)


def test_ishigami_by_sobol():
    found = sensitivity.indices(ishigami('kind = "saltelli"\nsamples = 2048'), "contact.peak")
    assert (found.method, found.points, found.blocks, found.dropped) == ("Sobol", 2048 * 5, 2048, 0)
    np.testing.assert_allclose(found.values["S1"], ISHIGAMI_S1, atol=0.02)
    np.testing.assert_allclose(found.values["ST"], ISHIGAMI_ST, atol=0.02)


def test_ishigami_with_failed_points_loses_whole_blocks_and_no_more():
    whole = ishigami('kind = "saltelli"\nsamples = 2048')
    # 13 points of 12 blocks, two of them in the last.
    bad = np.array([*(5 * np.arange(0, 1100, 100) + np.arange(11) % 5), 10238, 10239])
    found = sensitivity.indices(broken(whole, bad), "contact.peak")
    assert (found.failed, found.dropped, found.blocks, found.points) == (13, 12, 2036, 2036 * 5)
    np.testing.assert_allclose(found.values["S1"], ISHIGAMI_S1, atol=0.03)
    np.testing.assert_allclose(found.values["ST"], ISHIGAMI_ST, atol=0.03)


def test_second_order_of_ishigami():
    # V_13 is all that S1 leave: 1 - 0.3139 - 0.4424.
    found = sensitivity.indices(ishigami('kind = "saltelli"\nsamples = 2048\nsecond_order = true'), "contact.peak")
    second = found.pairs["S2"]
    assert found.points == 2048 * 8 and second[0, 2] == pytest.approx(0.2437, abs=0.03)
    assert abs(second[0, 1]) < 0.04 and abs(second[1, 2]) < 0.04 and np.isnan(second[1, 0])


@pytest.mark.parametrize("kind", ["latin_hypercube", "sobol"])
def test_ishigami_from_given_data(kind):
    whole = ishigami(f'kind = "{kind}"\npoints = 2048')
    found = sensitivity.indices(broken(whole, np.arange(0, 2048, 50)), "contact.peak")
    assert found.dropped == 41 and found.blocks == found.points == 2007
    np.testing.assert_allclose(found.values["S1"], ISHIGAMI_S1, atol=0.03)
    # The third acts through the first alone: no first order, yet more than nothing.
    assert found.values["pawn"].min() > 1.5 * found.dummy


def test_elementary_effects_of_ishigami():
    found = sensitivity.indices(ishigami('kind = "morris"\ntrajectories = 2000\nlevels = 4'), "contact.peak")
    # On levels 0, 1/3, 2/3, 1 of [-pi, pi], steps of 2/3: sin^2 changes by 3/4 either way, sin by sqrt(3)/2, and
    # between |x_3| of pi and pi/3 x_3^4 changes by pi^4 (1 - 1/81).
    a, b, step = 7.0, 0.1, 2 / 3
    mean_sine = np.sqrt(3) / 4
    expected = [
        np.sqrt(3) / 2 * (1 + b * np.pi**4 * (1 + 1 / 81) / 2) / step,
        a * 0.75 / step,
        mean_sine * b * np.pi**4 * (1 - 1 / 81) / step,
    ]
    error = found.values["mu_star_conf"] / 1.96
    assert np.all(np.abs(found.values["mu_star"] - expected) <= 3 * error + 1e-9) and np.all(error < 0.2)
    assert found.values["mu_star"][1] == pytest.approx(expected[1], rel=1e-9)


def test_a_trajectory_with_a_failed_point_is_dropped():
    whole = ishigami('kind = "morris"\ntrajectories = 500')
    found = sensitivity.indices(broken(whole, np.array([5, 6, 400])), "contact.peak")
    assert (found.failed, found.dropped, found.points) == (3, 2, 498 * 4)


def broken(whole: Finished, bad: np.ndarray) -> Finished:
    """The same with some points that failed; their features hold what must not be read."""
    ok, y = whole.ok.copy(), whole.columns["contact.peak"].copy()
    ok[bad], y[bad] = False, 1e6
    return whole._replace(ok=ok, columns={"contact.peak": y})


@pytest.mark.parametrize(
    ("design", "bad", "said"),
    [
        (
            'kind = "saltelli"\nsamples = 64',
            np.arange(0, 33 * 5, 5),
            r"only 31 of 64 blocks have no failed .*; 32 are needed",
        ),
        ('kind = "saltelli"\nsamples = 16', np.zeros(0, int), r"16 of 16 blocks"),
        ('kind = "morris"\ntrajectories = 6', np.arange(0, 12, 4), r"3 of 6 trajectories .* 4 are needed"),
        ('kind = "sobol"\npoints = 64', np.zeros(0, int), r"64 of 64 points .* 100 are needed"),
    ],
)
def test_too_few_are_refused(design, bad, said):
    with pytest.raises(InputError, match=said):
        sensitivity.indices(broken(ishigami(design), bad), "contact.peak")


def test_what_cannot_be_shared_out_is_refused():
    whole = ishigami('kind = "saltelli"\nsamples = 64')
    flat = whole._replace(columns={"contact.peak": np.full(320, 2.0)})
    with pytest.raises(InputError, match="is 2 at every point"):
        sensitivity.indices(flat, "contact.peak")
    with pytest.raises(InputError, match=r"did not keep it; did you mean 'contact.peak'"):
        sensitivity.indices(whole, "contact.peek")


def test_a_grid_has_no_distribution():
    study = from_table({"scene": "impact", "vary": {"stiffness": {"values": [1e6, 1e7]}}})
    whole = Finished(study, study.points, {"contact.peak": np.array([1.0, 2.0])}, np.ones(2, bool))
    with pytest.raises(InputError, match="points of a grid have no distribution"):
        sensitivity.indices(whole, "contact.peak")


# 2048 or more points of each study: blocks of one size, one compiled program.


@pytest.mark.slow
def test_sobol_indices_of_the_impacts_peak_are_those_of_a_product_of_powers(here):
    result = bj.study(tomllib.loads(IMPACT + '[design]\nkind = "saltelli"\nsamples = 512'), here / "out", workers=1)
    found = sensitivity.indices(result, "contact.peak")
    # F = prod_i f_i, V(F)/E(F)^2 = prod (1 + c_i) - 1 with c_i = V(f_i)/E(f_i)^2.
    c = peak_variances(read(result).study)
    total = np.prod(1 + c) - 1
    np.testing.assert_allclose(found.values["S1"], c / total, atol=0.02)
    np.testing.assert_allclose(found.values["ST"], c * np.prod(1 + c) / (1 + c) / total, atol=0.02)
    again = sensitivity.indices(here / "out", "contact.peak")
    np.testing.assert_array_equal(again.values["S1_conf"], found.values["S1_conf"])


@pytest.mark.slow
def test_elementary_effects_of_the_impacts_peak_are_in_order(here):
    result = bj.study(tomllib.loads(IMPACT + '[design]\nkind = "morris"\ntrajectories = 512'), here / "out", workers=1)
    found = sensitivity.indices(result, "contact.peak")
    c = peak_variances(read(result).study)
    assert np.argsort(found.values["mu_star"]).tolist() == np.argsort(c).tolist()
    # Every one of them pushes the peak up.
    np.testing.assert_array_equal(found.values["mu"], found.values["mu_star"])


@pytest.mark.slow
def test_on_the_command_line(here):
    text = IMPACT + '[design]\nkind = "saltelli"\nsamples = 256\nsecond_order = true'
    Path("study.toml").write_text(text)
    missing = bcfj("study", "indices", "study.toml", "--out", "out")
    assert missing.exit_code == 2 and "there is no study" in missing.stderr
    assert bcfj("study", "run", "study.toml", "--out", "out", "--workers", 1).exit_code == 0
    done = bcfj("study", "indices", "study.toml", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "approach_speed" in done.output and "S1" in done.output and "0 points failed" in done.output
    said = json.loads(Path("out/indices.json").read_text())
    assert said["features"]["contact.peak"]["ST"]["approach_speed"] > said["features"]["contact.peak"]["ST"]["mass"]
    assert said["features"]["contact.peak"]["S2"]["stiffness x mass"] is not None
    assert "indices.png" in os.listdir("out")
    wrong = bcfj("study", "indices", "study.toml", "--out", "out", "--feature", "contact.peek")
    assert wrong.exit_code == 2 and "contact.peak" in wrong.stderr
    Path("out/results.parquet").unlink()
    unfinished = bcfj("study", "indices", "study.toml", "--out", "out")
    assert unfinished.exit_code == 5 and "resume" in unfinished.output


@pytest.mark.slow  # A program of its own.
def test_runs_that_fail_take_their_blocks_along(here):
    table = {
        "scene": {
            "scene": {"kind": "bounce"},
            "time": {"end": 0.6, "samples": 1001},
            "accuracy": {"level": "balanced", "max_steps": 170},
        },
        "design": {"kind": "saltelli", "samples": 64},
        "vary": {"drop_height": {"lower": 0.05, "upper": 0.5}, "damping": {"lower": 0.0, "upper": 0.3}},
        "results": {"features": ["contact.peak", "contact.period"]},
    }
    result = bj.study(table, here / "out", workers=1)
    bad = np.flatnonzero(result.column("status") == "failed")
    assert 0 < bad.size < 60
    found = sensitivity.indices(result, "contact.peak")
    assert found.failed == bad.size and found.dropped == np.unique(bad // 4).size
    assert found.points == 4 * found.blocks == 256 - 4 * found.dropped
    good, without = sensitivity.every(result)
    assert [one.feature for one in good] == ["contact.peak"] and "64 blocks" in without["contact.period"]
