"""``kill -9`` at random moments of a study: of a worker, of the whole run, of a Dask scheduler with its worker.

    python -m benchmarks.analysis.study_kills [TRIALS] [--add] [--kinds worker run scheduler]
writes results/study_kills.json. A trial starts a study in a fresh folder, kills once at a random moment, lets the study
go on (or resumes it), and compares ``results.parquet`` byte for byte with that of an undisturbed run.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.common import load, options, save
from benchmarks.processes import environment

_VARIABLES = {"EQX_ON_ERROR": "nan"}
STUDY = """
scene = { scene = { kind = "bounce" }, time = { end = 1.0, samples = 2001 } }
[design]
kind = "sobol"
points = 6000
[vary.stiffness]
lower = 1e5
upper = 1e8
scale = "log"
[vary.damping]
lower = 0.0
upper = 0.3
[results]
features = ["contact.peak", "contact.impulse"]
"""


def start(*arguments: str, module: str = "bcfj_jax") -> subprocess.Popen:
    command = [sys.executable, "-m", module, *arguments]
    # A session of its own, so that all of it can be killed.
    nothing = subprocess.DEVNULL
    return subprocess.Popen(
        command, env=environment(_VARIABLES), start_new_session=True, stdout=nothing, stderr=nothing
    )


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def cluster(port: int, workers: int = 1, begin_s: tuple[float, float] = (2.0, 0.0)) -> list[subprocess.Popen]:
    """A scheduler and workers; seconds that it and they are given to begin."""
    host = ("--host", "127.0.0.1", "--port", str(port))
    jobs = [start(*host, "--no-dashboard", module="distributed.cli.dask_scheduler")]
    time.sleep(begin_s[0])
    words = (f"tcp://127.0.0.1:{port}", "--nthreads", "1", "--no-nanny", "--no-dashboard")
    jobs += [start(*words, module="distributed.cli.dask_worker") for _ in range(workers)]
    time.sleep(begin_s[1])
    return jobs


def end(process: subprocess.Popen) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def trial(kind: str, study: Path, folder: Path, last: float, draw: random.Random) -> tuple[float, int]:
    """One study that is disturbed; when [s], and how many blocks were there then."""
    port = free_port()
    dask = cluster(port) if kind == "scheduler" else []
    options = ["--scheduler", f"tcp://127.0.0.1:{port}"] if dask else ["--workers", "2"]
    job = start("study", "run", str(study), "--out", str(folder), *options)
    moment = draw.uniform(0.5, last)
    time.sleep(moment)
    there = len(list(folder.glob("blocks/*.parquet")))
    if kind == "worker":
        with contextlib.suppress(psutil.Error, IndexError):
            draw.choice(psutil.Process(job.pid).children()).kill()
        job.wait()
    elif kind == "run":
        end(job)
        job = start("study", "run", str(study), "--out", str(folder), *options)
        job.wait()
    else:
        for process in dask:
            end(process)
        dask = cluster(port)
        job.wait()
    for process in dask:
        end(process)
    if job.returncode != 0:
        raise SystemExit(f"{kind}: exit code {job.returncode} in {folder}")
    return moment, there


def main() -> None:
    more = (False, "to the trials that are kept, at other moments")
    given = options(__doc__, {"trials": 100}, add=more, kinds=["worker", "run", "scheduler"])
    rows = load("study_kills")["trials"] if given.add else []
    draw = random.Random(len(rows))
    with tempfile.TemporaryDirectory() as place:
        study = Path(place) / "study.toml"
        study.write_text(STUDY)
        for name in ("first", "undisturbed"):  # The first run compiles.
            begin = time.perf_counter()
            if start("study", "run", str(study), "--out", str(Path(place) / name), "--workers", "2").wait():
                raise SystemExit("the undisturbed study failed")
            lasts = time.perf_counter() - begin
        expected = (Path(place) / "undisturbed" / "results.parquet").read_bytes()
        for count in range(given.trials):
            kind = given.kinds[count % len(given.kinds)]
            folder = Path(place) / f"trial{count}"
            moment, there = trial(kind, study, folder, lasts, draw)
            same = (folder / "results.parquet").read_bytes() == expected
            rows.append({"kind": kind, "moment_s": moment, "blocks_there": there, "same": same})
            print(rows[-1], flush=True)
            save("study_kills", {"undisturbed_s": lasts, "trials": rows, "same": sum(r["same"] for r in rows)})

    print(f"{sum(r['same'] for r in rows)} of {len(rows)} tables are byte-identical")


if __name__ == "__main__":
    main()
