"""Studies: the points, the table, what happens when blocks break, and the command line around them."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
from commands import bcfj
from pages import check
from studies import STUDY

import bcfj_jax as bj
from bcfj_jax import InputError
from bcfj_jax.analysis import features
from bcfj_jax.analysis.studies.api import read
from bcfj_jax.analysis.studies.block import Blocks
from bcfj_jax.analysis.studies.specification import from_table
from bcfj_jax.analysis.studies.store import Store

pytest.importorskip("pyarrow", reason="the extra study is not installed")
filelock = pytest.importorskip("filelock", reason="the extra study is not installed")


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def done(here):
    """A folder with a study file in it, run by one worker into ``out``."""
    Path("study.toml").write_text(STUDY)
    result = bcfj("study", "run", "study.toml", "--out", "out", "--workers", 1)
    assert result.exit_code == 0, result.output
    return here


def single(stiffness: float, damping: float, finer: int = 1) -> dict[str, float]:
    scene = bj.scenes.impact()
    params = scene.parameters(stiffness=stiffness, damping=damping)
    times = np.linspace(0.0, float(scene.horizon(params)), finer * (scene.samples - 1) + 1)
    run = bj.simulate(scene, params, times)
    return features.summary(times, run.force["contact"][:, 0], run.penetration["contact"], run.rate["contact"])


def test_the_table_is_what_single_runs_give_and_others_read_it(done):
    duckdb, pandas = pytest.importorskip("duckdb"), pytest.importorskip("pandas")
    table = pandas.read_parquet("out/results.parquet")
    assert list(table.columns) == [
        "point", "stiffness", "damping", "contact.peak", "contact.impulse", "contact.contact_fraction", "status",
        "reason",
    ]  # fmt: skip
    assert table["point"].tolist() == list(range(14))
    for row in (table.iloc[0], table.iloc[9], table.iloc[13]):
        expected = single(row["stiffness"], row["damping"])
        # A peak is that of the curve between the samples.
        assert row["contact.peak"] == pytest.approx(single(row["stiffness"], row["damping"], 100)["peak"], rel=1e-6)
        for name in ("impulse", "contact_fraction"):
            assert row[f"contact.{name}"] == pytest.approx(expected[name], rel=1e-9)
    count, best = duckdb.sql(
        "select count(*), max(\"contact.peak\") from 'out/results.parquet' where status = 'ok'"
    ).fetchall()[0]
    assert (count, best) == (14, table["contact.peak"].max())
    said = json.loads(Path("out/study.json").read_text())
    assert (said["status"], said["points"], said["left"], said["failed"]) == ("finished", 14, 0, 0)
    assert {"study.png", "report.html", "run.toml", "environment.json"} <= set(os.listdir("out"))
    check(Path("out/report.html"))


def test_the_stiffest_undamped_impact_is_that_of_energy(done):
    # F_max = K d^n with K d^(n+1)/(n+1) = m v^2/2.
    import pyarrow.parquet as parquet

    table = parquet.read_table("out/results.parquet").to_pylist()
    scene = bj.scenes.impact()
    p = {name: float(x) for name, x in scene.parameters().items()}
    for row in (r for r in table if r["damping"] == 0.0):
        k, n = row["stiffness"], p["exponent"]
        depth = ((n + 1) * p["mass"] * p["approach_speed"] ** 2 / (2 * k)) ** (1 / (n + 1))
        assert row["contact.peak"] == pytest.approx(k * depth**n, rel=2e-3)


@pytest.mark.parametrize(
    "harm", ["cut", *(pytest.param(name, marks=pytest.mark.slow) for name in ("gone", "flipped", "another"))]
)
def test_a_block_that_is_broken_is_done_again_and_the_table_is_the_same(optimised, done, harm):
    # Without XLA's optimisations, as other tests run, a program that is made and the same one kept differ by a rounding.
    before = digest(Path("out/results.parquet"))
    files = sorted(Path("out/blocks").glob("*.parquet"))
    content = files[0].read_bytes()
    if harm == "cut":
        files[0].write_bytes(content[: len(content) // 2])
    elif harm == "gone":
        files[0].unlink()
    elif harm == "flipped":
        files[0].write_bytes(content[:60] + bytes([content[60] ^ 0xFF]) + content[61:])
    else:
        files[0].write_bytes(files[1].read_bytes())
    assert bcfj("study", "status", "study.toml", "--out", "out").exit_code == 5
    resumed = bcfj("study", "resume", "study.toml", "--out", "out", "--workers", 1)
    assert resumed.exit_code == 0, resumed.output
    assert digest(Path("out/results.parquet")) == before
    assert files[0].read_bytes() == content


@pytest.mark.full
def test_a_damaged_table_is_made_again_of_its_blocks_or_refused(done, capsys):
    parquet = pytest.importorskip("pyarrow.parquet")
    path, before = Path("out/results.parquet"), digest(Path("out/results.parquet"))
    whole = path.read_bytes()
    table = parquet.read_table(path)
    for harm in ("cut", "empty", "altered"):
        if harm == "altered":
            peak = table.column("contact.peak").to_numpy().copy()
            peak[3] *= 1.001
            at = table.column_names.index("contact.peak")
            parquet.write_table(table.set_column(at, "contact.peak", [peak]), path)
        else:
            path.write_bytes(whole[: len(whole) // 2] if harm == "cut" else b"")
        capsys.readouterr()
        assert len(read("out").values) == 14
        assert "results.parquet: " in capsys.readouterr().err
        assert digest(path) == before
    path.write_bytes(whole[:99])
    block = next(iter(sorted(Path("out/blocks").glob("*.parquet"))))
    parquet.write_table(parquet.read_table(block).slice(0, 1), block)
    with pytest.raises(InputError, match=r"cannot be read \(ArrowInvalid\), and 1 of 4 blocks are missing.*resume"):
        read("out")
    assert bcfj("study", "run", "study.toml", "--out", "out", "--workers", 1).exit_code == 0
    assert digest(path) == before
    Path("out/environment.json").write_text('{"code": 3}')
    refused = bcfj("study", "status", "study.toml", "--out", "out")
    assert refused.exit_code == 2 and "environment.json: is damaged" in refused.stderr


@pytest.mark.parametrize(
    "name", ["../../x.parquet", "/tmp/x.parquet", "{}.zarr/../../x", "other.parquet", "", "{}.zarr/"]
)
def test_a_worker_writes_nothing_but_its_block(here, name):
    store = Store(here / "out", Blocks(from_table({"scene": "impact", "vary": {"stiffness": {"values": [1e6, 1e7]}}})))
    before = sorted(here.iterdir())
    with pytest.raises(InputError, match="a worker"):
        store.keep(0, {name.format(store.blocks.names[0]): b"x"})
    assert [p for p in (here / "out").rglob("*") if p.is_file()] == []
    assert sorted(p for p in here.iterdir() if p.name != "out") == before


def test_what_is_finished_is_not_computed_again(done, monkeypatch):
    monkeypatch.setattr("bcfj_jax.analysis.studies.worker.compute", lambda *_: pytest.fail("computed again"))
    assert bcfj("study", "run", "study.toml", "--out", "out", "--workers", 1).exit_code == 0


def test_another_study_is_refused_in_the_same_folder(done):
    before = digest(Path("out/results.parquet"))
    Path("study.toml").write_text(STUDY.replace("steps = 7", "steps = 8"))
    found = bcfj("study", "run", "study.toml", "--out", "out")
    assert found.exit_code == 2 and "holds another study" in found.stderr
    assert digest(Path("out/results.parquet")) == before


@pytest.mark.slow
def test_blocks_from_elsewhere_are_merged(done):
    files = sorted(Path("out/blocks").glob("*.parquet"))
    before = digest(Path("out/results.parquet"))
    assert bcfj("study", "run", "study.toml", "--out", "two", "--workers", 1).exit_code == 0
    for path in files[:-1]:
        (Path("two/blocks") / path.name).unlink()
    Path("two/results.parquet").unlink()
    assert bcfj("study", "merge", "study.toml", "--out", "two").exit_code == 5
    assert not Path("two/results.parquet").exists()
    merged = bcfj("study", "merge", "study.toml", "--out", "two", "--from", "out")
    assert merged.exit_code == 0, merged.output
    assert digest(Path("two/results.parquet")) == before


@pytest.mark.slow
def test_a_full_disk_stops_clearly_and_can_be_resumed(done, monkeypatch):
    before = digest(Path("out/results.parquet"))
    from bcfj_jax.analysis.studies import store

    whole, count = store.to_disk, []

    def full(path):
        count.append(path)
        if len(count) > 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        whole(path)

    monkeypatch.setattr(store, "to_disk", full)
    stopped = bcfj("study", "run", "study.toml", "--out", "full", "--workers", 1)
    assert stopped.exit_code == 5 and "No space left" in stopped.stderr and "resume" in stopped.output
    assert not list(Path("full/blocks").glob(".*"))
    monkeypatch.setattr(store, "to_disk", whole)
    assert bcfj("study", "resume", "study.toml", "--out", "full", "--workers", 1).exit_code == 0
    assert digest(Path("full/results.parquet")) == before


def test_a_block_that_another_has_is_left_alone(here):
    blocks = Blocks(from_table({"scene": "impact", "vary": {"stiffness": {"values": [1e6, 1e7]}}}))
    one, other = Store(here, blocks), Store(here, blocks)
    with one.claimed(0) as mine, other.claimed(0) as too:
        assert mine and not too
    with other.claimed(0) as free:
        assert free


@pytest.mark.full
def test_points_that_fail_are_rows_with_reasons(here):
    table = {
        "scene": {
            "scene": {"kind": "bounce"},
            "time": {"end": 1.0, "samples": 101},
            "accuracy": {"level": "balanced", "max_steps": 30},
        },
        "vary": {"friction": {"values": [1.0]}},
    }
    with pytest.raises(bj.InputError, match="no parameter 'friction'"):
        from_table(table)
    # From 10 m the mass is still in the air when the run ends: a few steps.
    table["vary"] = {"drop_height": {"values": [0.05, 10.0, 0.1]}}
    result = bj.study(table, here / "out", workers=1)
    status, reason, peak = (result.column(name) for name in ("status", "reason", "contact.peak"))
    failed = status == "failed"
    assert failed.tolist() == [True, False, True]
    assert np.isnan(peak[failed]).all() and peak[1] == 0.0
    assert all("30 steps" in text and "tenth of the tolerance" in text for text in reason[failed])


def test_a_point_that_no_joint_has_is_a_row_with_its_reason(here):
    table = {
        "scene": {"scene": {"kind": "joint", "fidelity": "kinematic"}, "time": {"end": 0.1, "samples": 3}},
        "vary": {"ball_radius": {"values": [0.01, 0.05]}},
        "results": {"features": ["seat_ball.peak"]},
    }
    result = bj.study(table, here / "out", workers=1)
    assert result.column("status").tolist() == ["ok", "failed"]
    assert "moves a ball out of its window" in result.column("reason")[1]


@pytest.mark.slow
def test_histories_are_kept_and_guarded(here):
    zarr = pytest.importorskip("zarr")
    table = {
        "scene": "impact", "vary": {"stiffness": {"values": [1e6, 1e7, 1e8]}},
        "results": {"features": ["contact.peak"], "histories": True},
    }  # fmt: skip
    result = bj.study(table, here / "out", workers=1)
    for point in range(3):
        times, force = result.forces(point)
        # The peak is that of the curve between the samples.
        assert 0.0 <= result.column("contact.peak")[point] / force[:, 0, 0].max() - 1.0 < 1e-5
        assert np.all(np.diff(times) > 0)
    group = zarr.open_group(next((here / "out/blocks").glob("*.zarr")), mode="r")
    assert group.attrs["contacts"] == ["contact"]
    kept = result.forces(1)[1]
    chunk = next(p for p in (here / "out/blocks").rglob("c/*") if p.is_file() or p.is_dir())
    target = chunk if chunk.is_file() else next(p for p in chunk.rglob("*") if p.is_file())
    target.write_bytes(target.read_bytes()[:-7])
    again = bj.study(table, here / "out", workers=1)
    assert np.array_equal(again.forces(1)[1], kept)


@pytest.mark.slow
def test_derivatives_are_those_of_sensitivity(here):
    table = {
        "scene": "impact", "vary": {"stiffness": {"values": [2e6, 3e7]}},
        "results": {"features": ["contact.peak"], "derivatives": ["stiffness", "mass"]},
    }  # fmt: skip
    result = bj.study(table, here / "out", workers=1)
    scene = bj.scenes.impact()

    def peak(at: float, k: float) -> float:
        times = np.linspace(0.0, float(scene.horizon(scene.parameters(stiffness=at))), scene.samples)
        return float(
            bj.simulate(scene, scene.parameters(stiffness=k), times, accuracy=1e-8).force["contact"][:, 0].max()
        )

    for row, at in enumerate((2e6, 3e7)):
        step = 1e-4 * at
        slope = (peak(at, at + step) - peak(at, at - step)) / (2 * step)
        assert result.column("d(contact.peak)/d(stiffness)")[row] == pytest.approx(slope, rel=5e-3)


def test_an_estimate_writes_nothing(here):
    Path("study.toml").write_text(STUDY)
    reported = bcfj("study", "run", "study.toml", "--out", "out", "--dry-run", "--workers", 1)
    assert reported.exit_code == 0 and "14" in reported.output and not Path("out").exists()
