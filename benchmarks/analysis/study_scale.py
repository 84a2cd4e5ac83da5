"""Large studies: memory against points, a disk that is full, two Dask workers against one.

    python -m benchmarks.analysis.study_scale [memory] [disk] [dask]
writes results/study_scale.json and the table in docs/studies.md; every part by itself keeps what the others measured.

- memory: the quasistatic joint, 10 000 and 100 000 points; the largest process of each study, and whether pandas and
  DuckDB read the table as it stands.
- disk: a study in a tmpfs that is too small for it, resumed in one that is not. Needs the right to mount.
- dask: 2048 clearances of the dynamic joint by one local Dask worker and by two, and against the in-process table.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import bcfj_jax as bj
from benchmarks.analysis.study import dynamic, static
from benchmarks.analysis.study_kills import environment, free_port, start
from benchmarks.common import ROOT, load, markdown, put_in_readme, save

NAME = "study_scale"
FULL = 5


def ran(words: list[str]) -> tuple[int, str, float, float]:
    """``bcfj study`` in its own process: exit code, what it said, seconds, megabytes of the largest process."""
    begin = time.perf_counter()
    with tempfile.TemporaryFile("w+") as said:
        job = subprocess.Popen(
            [sys.executable, "-m", "bcfj_jax", "study", *words], env=environment(), stdout=said, stderr=said
        )
        _, status, used = os.wait4(job.pid, 0)
        job.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return job.returncode, said.read(), time.perf_counter() - begin, used.ru_maxrss / 1024


def written(table: dict[str, Any], folder: Path) -> Path:
    """A study file."""
    import tomli_w

    path = folder / "study.toml"
    path.write_text(tomli_w.dumps(table))
    return path


def digest(folder: Path) -> str:
    return hashlib.sha256((folder / "results.parquet").read_bytes()).hexdigest()


def memory() -> dict[str, Any]:
    import duckdb
    import pandas

    rows = []
    for points in (10_000, 100_000):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            path = written(static(points), folder)
            code, said, seconds, largest = ran(["run", str(path), "--out", str(folder / "out"), "--workers", "1"])
            assert code == 0, said
            table = folder / "out" / "results.parquet"
            frame = pandas.read_parquet(table)
            query = f"select count(*), max(\"seat_ball.peak\") from '{table}' where status = 'ok'"
            good, peak = duckdb.execute(query).fetchall()[0]
            assert len(frame) == points and good == (frame["status"] == "ok").sum()
            assert np.isclose(peak, frame["seat_ball.peak"].max(), rtol=0)
            rows.append(
                {"points": points, "failed": points - good, "seconds": seconds, "largest_mb": largest,
                 "disk_mb": sum(p.stat().st_size for p in (folder / "out").rglob("*") if p.is_file()) / 1e6}
            )  # fmt: skip
            print(rows[-1], flush=True)
    return {"rows": rows, "growth_mb": rows[1]["largest_mb"] - rows[0]["largest_mb"]}


def disk() -> dict[str, Any]:
    table = {
        "scene": {"scene": {"kind": "bounce"}, "time": {"end": 0.2, "samples": 201}},
        "design": {"kind": "sobol", "points": 16_384},
        "vary": {"stiffness": {"lower": 1e5, "upper": 1e8, "scale": "log"}},
        "results": {"features": ["contact.peak", "contact.impulse"]},
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        small, path = folder / "small", written(table, folder)
        small.mkdir()
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", small], capture_output=True)
        if mounted.returncode:
            return {"mounted": False, "why": mounted.stderr.decode().strip()}
        try:
            code, said, *_ = ran(["run", str(path), "--out", str(small / "out"), "--workers", "1"])
            blocks = len(list((small / "out" / "blocks").glob("*.parquet")))
            subprocess.run(["mount", "-o", "remount,size=100m", small], check=True)
            resumed, after, *_ = ran(["resume", str(path), "--out", str(small / "out"), "--workers", "1"])
            assert resumed == 0, after
            undisturbed, _, *_ = ran(["run", str(path), "--out", str(folder / "whole"), "--workers", "1"])
            assert undisturbed == 0
            same = digest(small / "out") == digest(folder / "whole")
        finally:
            subprocess.run(["umount", small], check=True)
    message = next((line for line in reversed(said.splitlines()) if "full" in line or "space" in line), said[-200:])
    return {
        "mounted": True,
        "exit": code,
        "said": message,
        "blocks_kept": blocks,
        "resumed": resumed,
        "same_bytes": same,
    }


def dask(points: int = 2048) -> dict[str, Any]:
    table, found = dynamic(points), {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Once in process, which also compiles.
        here = bj.study(table, folder / "here", workers=1)
        for workers in (1, 2, 1, 2):
            port = free_port()
            address = f"tcp://127.0.0.1:{port}"
            jobs = [
                start(
                    "--host",
                    "127.0.0.1",
                    "--port",
                    str(port),
                    "--no-dashboard",
                    module="distributed.cli.dask_scheduler",
                )
            ]
            time.sleep(3.0)
            jobs += [
                start(address, "--nthreads", "1", "--no-nanny", "--no-dashboard", module="distributed.cli.dask_worker")
                for _ in range(workers)
            ]
            time.sleep(8.0)
            try:
                out, seen = folder / f"{workers}-{port}", []
                run = bj.study(
                    table,
                    out,
                    scheduler=address,
                    progress=lambda done, _: seen.append((time.perf_counter(), done)),  # noqa: B023
                )
            finally:
                for job in reversed(jobs):
                    job.kill()
                    job.wait()
            # From when every worker has its program to the end.
            first, last = (at for at in seen if at[1] >= workers), seen[-1]
            begin = next(first)
            size = points / last[1]
            found.setdefault(str(workers), []).append((last[1] - begin[1]) * size / (last[0] - begin[0]))
            found["identical"] = found.get("identical", True) and digest(out) == digest(folder / "here")
            print(workers, found, flush=True)
        assert here.failed == run.failed
    rates = {k: float(np.median(found[k])) for k in ("1", "2")}
    return {"points": points, "rates": found, "gain": rates["2"] / rates["1"], "identical": found["identical"]}


PARTS = {"memory": memory, "disk": disk, "dask": dask}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=list(PARTS))
    given = parser.parse_args()
    path = ROOT / "benchmarks" / "results" / f"{NAME}.json"
    content = {k: v for k, v in load(NAME).items() if k in PARTS} if path.exists() else {}
    for part in given.parts:
        content[part] = PARTS[part]()
        save(NAME, content)
    print(json.dumps(content, indent=1))
    put_in_readme(NAME, text(content), "docs/studies.md")


def text(content: dict[str, Any]) -> str:
    """What was measured, as Markdown."""
    said = []
    if found := content.get("memory"):
        head = [["quasistatic points", "failed", "seconds", "largest process", "on disk"]]
        body = [
            [f"{r['points']}", f"{r['failed']}", f"{r['seconds']:.0f}", f"{r['largest_mb']:.0f} MB",
             f"{r['disk_mb']:.1f} MB"] for r in found["rows"]
        ]  # fmt: skip
        said.append(
            markdown(head + body)
            + "\n\nThe smaller one, which came first, compiled. pandas and DuckDB read the table as it stands."
        )
    if (found := content.get("disk")) and found["mounted"]:
        said.append(
            f"A full disk: exit code {found['exit']}, “{found['said'].strip()}”; resumed with room, the table is "
            + ("byte for byte that of an undisturbed run." if found["same_bytes"] else "**another one**.")
        )
    if found := content.get("dask"):
        said.append(
            f"Two Dask workers do {found['gain']:.2f} times the points of one"
            + (", byte for byte what one process does." if found["identical"] else ", **with other results**.")
        )
    return "\n\n".join(said)


if __name__ == "__main__":
    main()
