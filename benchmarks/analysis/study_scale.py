"""Large studies: memory against points, a disk that is full, two Dask workers against one.

    python -m benchmarks.analysis.study_scale [memory] [disk] [dask]
writes results/study_scale.json and the table in docs/studies.md; every part by itself keeps what the others measured.

- memory: the quasistatic joint, 10 000 and 100 000 points; the largest process of each study, and whether pandas and
  DuckDB read the table as it stands.
- disk: a study in a tmpfs that is too small for it, resumed in one that is not. Needs the right to mount.
- dask: 2048 clearances of the dynamic joint by one local Dask worker and by two, and against the in-process table.
"""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import bcfj_jax as bj
from benchmarks.analysis.study import dynamic, static, watched
from benchmarks.analysis.study_kills import cluster, end, free_port
from benchmarks.common import known, options, parts, publish
from benchmarks.common import table as tabled
from benchmarks.processes import Done, bcfj

FULL = 5


def ran(*words: str) -> Done:
    """``bcfj study`` in its own process."""
    return bcfj(["study", *words], variables={"EQX_ON_ERROR": "nan"})


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
            done = ran("run", str(path), "--out", str(folder / "out"), "--workers", "1")
            assert done.code == 0, done.err
            table = folder / "out" / "results.parquet"
            frame = pandas.read_parquet(table)
            query = f"select count(*), max(\"seat_ball.peak\") from '{table}' where status = 'ok'"
            good, peak = duckdb.execute(query).fetchall()[0]
            assert len(frame) == points and good == (frame["status"] == "ok").sum()
            assert np.isclose(peak, frame["seat_ball.peak"].max(), rtol=0)
            used = sum(p.stat().st_size for p in (folder / "out").rglob("*") if p.is_file()) / 1e6
            rows.append({
                "points": points, "failed": points - good, "seconds": done.wall_s, "largest_mb": done.peak_mb, "disk_mb": used,
            })  # fmt: skip
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
            cut = ran("run", str(path), "--out", str(small / "out"), "--workers", "1")
            blocks = len(list((small / "out" / "blocks").glob("*.parquet")))
            subprocess.run(["mount", "-o", "remount,size=100m", small], check=True)
            resumed = ran("resume", str(path), "--out", str(small / "out"), "--workers", "1")
            assert resumed.code == 0, resumed.err
            assert ran("run", str(path), "--out", str(folder / "whole"), "--workers", "1").code == 0
            same = digest(small / "out") == digest(folder / "whole")
        finally:
            subprocess.run(["umount", small], check=True)
    said = cut.out + cut.err
    message = next((line for line in reversed(said.splitlines()) if "full" in line or "space" in line), said[-200:])
    return {
        "mounted": True, "exit": cut.code, "said": message, "blocks_kept": blocks, "resumed": resumed.code, "same_bytes": same,
    }  # fmt: skip


def dask(points: int = 2048) -> dict[str, Any]:
    table, found = dynamic(points), {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Once in process, which also compiles.
        here = bj.study(table, folder / "here", workers=1)
        for workers in (1, 2, 1, 2):
            port = free_port()
            jobs, out = cluster(port, workers, (3.0, 8.0)), folder / f"{workers}-{port}"
            try:
                run, seen = watched(table, out, scheduler=f"tcp://127.0.0.1:{port}")
            finally:
                for job in reversed(jobs):
                    end(job)
            # From when every worker has its program to the end.
            begin, last = next(at for at in seen if at[1] >= workers), seen[-1]
            size = points / last[1]
            found.setdefault(str(workers), []).append((last[1] - begin[1]) * size / (last[0] - begin[0]))
            found["identical"] = found.get("identical", True) and digest(out) == digest(folder / "here")
            print(workers, found, flush=True)
        assert here.failed == run.failed
    rates = {k: float(np.median(found[k])) for k in ("1", "2")}
    return {"points": points, "rates": found, "gain": rates["2"] / rates["1"], "identical": found["identical"]}


PARTS = {"memory": memory, "disk": disk, "dask": dask}


def main() -> None:
    parts("study_scale", PARTS, options(__doc__, {"parts": PARTS}).parts)
    publish("study_scale", text(known("study_scale")), "docs/studies.md")


def text(content: dict[str, Any]) -> str:
    """What was measured, as Markdown."""
    said = []
    if found := content.get("memory"):
        said += [tabled({
            "quasistatic points": "{points}", "failed": "{failed}", "seconds": "{seconds:.0f}",
            "largest process": "{largest_mb:.0f} MB", "on disk": "{disk_mb:.1f} MB",
        }, found["rows"])]  # fmt: skip
        said += ["The smaller one, which came first, compiled. pandas and DuckDB read the table as it stands."]
    if (found := content.get("disk")) and found["mounted"]:
        end = "byte for byte that of an undisturbed run." if found["same_bytes"] else "**another one**."
        full = f"A full disk: exit code {found['exit']}, “{found['said'].strip()}”"
        said.append(f"{full}; resumed with room, the table is {end}")
    if found := content.get("dask"):
        end = ", byte for byte what one process does." if found["identical"] else ", **with other results**."
        said.append(f"Two Dask workers do {found['gain']:.2f} times the points of one{end}")
    return "\n\n".join(said)


if __name__ == "__main__":
    main()
