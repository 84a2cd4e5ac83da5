"""Many workers: threads, killed processes, on a scheduler, on several devices. The table is always the same bytes."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from conftest import BUILD
from studies import STUDY

from bcfj_jax.analysis.studies import api, specification, worker
from bcfj_jax.core.errors import InputError
from bcfj_jax.xla import programs

pytest.importorskip("pyarrow", reason="the extra study is not installed")

PROGRAM = """
import sys
from bcfj_jax.xla.compile_cache import open_cache
open_cache()
from bcfj_jax.analysis.studies.api import study
study("study.toml", sys.argv[1], workers=1)
"""


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / api.RESULTS).read_bytes()).hexdigest()


@pytest.fixture
def expected(here) -> str:
    Path("study.toml").write_text(STUDY)
    return digest(api.study("study.toml", "alone", workers=1).folder)


@pytest.mark.full
def test_threads_give_the_same_bytes_as_one_and_share_its_programs(here, expected, monkeypatch):
    monkeypatch.setattr(api, "default_workers", lambda: 3)
    threads, traced = set(), len(programs.traced)
    compute = worker.compute

    def watched(*given):
        threads.add(threading.get_ident())
        time.sleep(0.05)  # So that no thread takes all blocks before the others have begun.
        return compute(*given)

    monkeypatch.setattr(worker, "compute", watched)
    seen = []
    result = api.study("study.toml", "threads", progress=lambda there, _: seen.append(there))
    assert digest(result.folder) == expected and len(threads) > 1
    assert len(programs.traced) == traced
    assert seen == sorted(seen) and seen[-1] == result.state["blocks"]


@pytest.mark.parametrize(
    "raised", [KeyboardInterrupt(), OSError(28, "No space left on device"), InputError("a", "b", "c")]
)
def test_what_one_thread_raises_stops_the_others_after_their_block(here, monkeypatch, raised):
    """The thread that fails does so while the other computes; the rest of the blocks is left."""
    Path("study.toml").write_text(STUDY)
    store, begun = api.prepare(specification.load(Path("study.toml")), here / "out"), []
    both = threading.Barrier(2)

    def fails(study, at, size):
        begun.append(at)
        first = both.wait(10) == 0
        if first:
            raise raised
        time.sleep(0.3)
        raise AssertionError("left behind: nobody hears of it")

    left = []
    monkeypatch.setattr(worker, "compute", fails)
    monkeypatch.setattr(worker, "abandon", lambda: left.append(True))
    with pytest.raises(type(raised)):
        worker.in_threads(store, 2, lambda _: None)
    assert len(store.blocks) > 2
    time.sleep(0.6)
    assert len(begun) == 2 and left == [True]


@pytest.mark.slow
def test_a_worker_that_is_killed_is_replaced(here, expected, monkeypatch):
    started = []
    start = worker.start

    def watched(store, number):
        worker = start(store, number)
        if not started:
            worker.send_signal(signal.SIGKILL)
        started.append(worker)
        return worker

    monkeypatch.setattr(worker, "start", watched)
    monkeypatch.setenv("PYTHONPATH", str(Path(api.__file__).parents[3]))
    result = api.study("study.toml", "two", workers=2)
    assert len(started) == 3 and digest(result.folder) == expected


@pytest.mark.slow
def test_a_run_that_is_killed_takes_its_workers_with_it_and_can_be_resumed(here, expected):
    environment = {**os.environ, "PYTHONPATH": str(Path(api.__file__).parents[3])}
    command = [sys.executable, "-m", "bcfj_jax", "study", "run", "study.toml", "--out", "cut", "--workers", "2"]
    job = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while not list(Path("cut").glob("blocks/*.parquet")) and job.poll() is None and time.monotonic() < until:
        time.sleep(0.02)
    job.kill()
    job.wait()
    result = api.study("study.toml", "cut", workers=1)
    assert digest(result.folder) == expected


@pytest.mark.slow
def test_a_schedulers_workers_give_the_same_bytes(here, expected):
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        result = api.study("study.toml", "dask", scheduler=cluster.scheduler_address)
    assert digest(result.folder) == expected


def test_a_worker_with_another_version_is_refused(here):
    from bcfj_jax.analysis.studies.cluster import compute_block

    Path("study.toml").write_text(STUDY)
    store = api.prepare(specification.load(Path("study.toml")), here / "out")
    with pytest.raises(RuntimeError, match="another version"):
        compute_block((store.folder / "run.toml").read_text(), store.blocks.size, 0, "0" * 32)


@pytest.mark.slow
def test_several_devices_share_a_block(here, expected):
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(api.__file__).parents[3]),
        "XLA_FLAGS": "--xla_force_host_platform_device_count=2",
        "BCFJ_CACHE": str(BUILD / "jax-cache"),
    }
    done = subprocess.run([sys.executable, "-c", PROGRAM, "devices"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    # Each device has half of a block in another order of slots: a run is the same to the last bit all the same.
    assert digest(Path("devices")) == expected
