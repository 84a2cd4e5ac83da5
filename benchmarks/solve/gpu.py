"""What one GPU gives against the cores of its host: studies, histories, Jacobians, impacts.

    python -u -m benchmarks.solve.gpu [--out FOLDER] [--quick] [--parts study histories ...] [--for 330]
    python -m benchmarks.solve.gpu --tables FOLDER/gpu.json    results/gpu.json, and the tables in docs/howto/gpu.md

Every measurement is a process of its own, and is written to gpu.json as soon as it is there; what fails or takes too long is
named there and loses nothing else. Those of "one core" run on the same machine with JAX_PLATFORMS=cpu on one core. ``--quick``:
tiny sizes, to see that it works where there is no GPU. Nothing new is begun after ``--for`` seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import benchmarks.common as harness
from benchmarks.clock import seconds
from benchmarks.common import RESULTS, Some, machine, markdown, options, publish

STUDY = """scene = "scene.toml"
[design]
kind = "grid"
[vary.clearance_seat_cage]
lower = 1e-5
upper = 1e-4
steps = {first}
scale = "log"
[vary.stiffness]
lower = {low}
upper = {high}
steps = {second}
[results]
features = ["seat_cage.peak", "seat_ball.peak", "seat_ball.mean"]
"""
SCENE = '[scene]\nkind = "joint"\n[time]\nend = 0.6\nsamples = 301\n'
WRT = (
    "clearance_seat_cage", "clearance_cage_ball", "clearance_head_ball", "clearance_seat_ball", "stiffness", "load_ramp",
    "friction_static",
)  # fmt: skip
# By value: name, lanes or points, of --quick, seconds at most, where.
PARTS: tuple[tuple[str, int, int, int, str], ...] = (
    ("study", 4096, 8, 120, "gpu"),
    ("histories", 8192, 4, 70, "gpu"),
    ("histories", 64, 4, 60, "core"),
    ("study", 65536, 16, 150, "gpu"),
    ("jacobian", 1024, 2, 110, "gpu"),
    ("impact", 65536, 64, 60, "gpu"),
    ("jacobian", 32, 2, 90, "core"),
    ("study", 256, 8, 60, "gpu"),
    ("study", 256, 8, 90, "cores"),
    ("study", 1024, 8, 60, "gpu"),
    ("impact", 65536, 64, 60, "core"),
    ("study", 1024, 8, 120, "cores"),
    ("study", 64, 8, 60, "gpu"),
    ("study", 64, 8, 60, "cores"),
    ("study", 16, 8, 60, "gpu"),
    ("study", 16, 8, 60, "cores"),
)


def in_batch(what: str, lanes: int) -> dict[str, Any]:
    """Seconds of the first call and of the best of the next ones, sums and largest values of lane 0; in a process of its own."""
    import jax
    import jax.numpy as jnp

    import bcfj_jax as bj

    scene = bj.scenes.impact() if what == "impact" else bj.scenes.joint_of_keys()
    params = scene.parameters()
    end = float(scene.horizon(params)) if what == "impact" else 0.6
    times = jnp.linspace(0.0, end, 301)
    few = [name for name in WRT if name in params]
    some = 1.0 + 0.05 * jnp.linspace(0.0, 1.0, lanes)
    leaves = {name: jnp.full(lanes, value) for name, value in params.items()}
    varied = "stiffness" if "stiffness" in leaves else next(iter(leaves))
    leaves[varied] = leaves[varied] * some

    def history(one: dict) -> Any:
        return bj.force_history(scene, one, times)

    def mean(few: dict, others: dict) -> Any:
        return jnp.mean(history({**others, **few})["seat_ball"])

    if what == "jacobian":
        program = jax.jit(jax.vmap(lambda p: jax.jacfwd(mean)({k: p[k] for k in few}, p)))
    else:
        program = jax.jit(jax.vmap(history))
    begin = time.perf_counter()
    found = jax.block_until_ready(program(leaves))
    first_s = time.perf_counter() - begin
    runs = seconds(lambda: program(leaves), 2, time.perf_counter, 12.0)
    first = [leaf[0] for leaf in jax.tree.leaves(found)]
    return {
        "first_s": first_s, "run_s": min(runs), "wrt": few if what == "jacobian" else [],
        "sums": [float(jnp.sum(x)) for x in first], "peaks": [float(jnp.max(jnp.abs(x))) for x in first],
        "device": jax.devices()[0].device_kind,
    }  # fmt: skip


def studied(points: int, folder: Path) -> list[str]:
    """The command of a study of so many joints."""
    second = max(1, 2 ** (points.bit_length() // 2))
    (folder / "scene.toml").write_text(SCENE)
    import bcfj_jax as bj

    stiffness = float(bj.scenes.joint_of_keys().parameters()["stiffness"])
    text = STUDY.format(first=points // second, second=second, low=0.9 * stiffness, high=1.1 * stiffness)
    (folder / "study.toml").write_text(text)
    return [sys.executable, "-m", "bcfj_jax", "study", "run", str(folder / "study.toml"), "--out", str(folder / "out")]


def surroundings(where: str, cache: Path) -> tuple[dict[str, str], Any]:
    """Environment of a process, and what it does first."""
    env = {**os.environ, "BCFJ_CACHE": str(cache), "PYTHONUNBUFFERED": "1", "EQX_ON_ERROR": "off"}
    if where != "gpu":
        env["JAX_PLATFORMS"] = "cpu"
    pinned = (lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})) if where == "core" else None
    return env, pinned


def measure(what: str, size: int, where: str, most: float, out: Path) -> dict[str, Any]:
    """One measurement; what it said where it failed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # A study is measured as at first; its programs are not kept from an earlier one.
        env, first = surroundings(where, folder / "cache")
        own = [sys.executable, "-m", "benchmarks.solve.gpu", "--one", what, str(size)]
        command = studied(size, folder) if what == "study" else own
        begin = time.perf_counter()
        try:
            ran = subprocess.run(command, env=env, preexec_fn=first, capture_output=True, text=True, timeout=most)
        except subprocess.TimeoutExpired as error:
            said = error.stderr or b""
            return {
                "failed": f"not done in {most:.0f} s",
                "said": (said if isinstance(said, str) else said.decode())[-1500:],
            }
        whole = time.perf_counter() - begin
        if ran.returncode:
            return {"failed": f"exit code {ran.returncode}", "said": (ran.stdout + ran.stderr)[-3000:]}
        if what != "study":
            return {"whole_s": whole, **json.loads(ran.stdout.splitlines()[-1])}
        kept = out / f"study_{size}_{where}.parquet"
        (folder / "out" / "results.parquet").rename(kept) if size <= 4096 else None
        state = json.loads((folder / "out" / "study.json").read_text())
        known = json.loads((folder / "out" / "environment.json").read_text())
        row = {"whole_s": whole, "block_size": known["block_size"], "device": known["device"]["devices"]}
        row |= {key: state[key] for key in ("points", "failed", "blocks", "steps", "rounds")}
        # Once more, with the programs that the first one kept.
        begin = time.perf_counter()
        again = subprocess.run([*command[:-1], str(folder / "again")], env=env, capture_output=True, timeout=most)
        return row | ({} if again.returncode else {"kept_s": time.perf_counter() - begin})


def differences(out: Path) -> dict[str, float]:
    """Largest relative difference of features between a GPU and a CPU, of the studies that both ran."""
    import numpy as np
    import pyarrow.parquet as pq

    found: dict[str, float] = {}
    for gpu in sorted(out.glob("study_*_gpu.parquet")):
        cpu = gpu.with_name(gpu.name.replace("_gpu", "_cores"))
        if not cpu.exists():
            continue
        a, b = pq.read_table(gpu), pq.read_table(cpu)
        for name in (n for n in a.column_names if n.endswith((".peak", ".mean"))):
            x, y = a[name].to_numpy(), b[name].to_numpy()
            found[name] = max(found.get(name, 0.0), float(np.nanmax(np.abs(x / y - 1.0))))
    return found


def run(given: argparse.Namespace) -> None:
    """All parts in order, each written as soon as it is there."""
    out, begin = Path(given.out), time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = {"environment": machine(), "cores": len(os.sched_getaffinity(0)), "rows": []}
    content["quick"] = given.quick

    def keep() -> None:
        (out / "gpu.json").write_text(json.dumps(content, indent=1) + "\n")

    for what, size, tiny, most, where in PARTS:
        left = vars(given)["for"] - (time.perf_counter() - begin)
        if (given.parts and what not in given.parts) or left < 10.0:
            continue
        size = tiny if given.quick else size
        try:
            found = measure(what, size, where, min(most, left) if not given.quick else 400.0, out)
        except Exception as error:  # One measurement that cannot be made loses no other.
            found = {"failed": f"{type(error).__name__}: {error}"[:500]}
        content["rows"].append({"what": what, "size": size, "where": where, **found})
        print(f"{time.perf_counter() - begin:.0f} s", json.dumps(content["rows"][-1])[:700], flush=True)
        keep()
    try:
        content["differences"] = differences(out)
    except Exception as error:  # As above.
        content["differences"] = {}
        print(f"no differences: {error}", flush=True)
    print(json.dumps(content["differences"]), flush=True)
    keep()


def tables(path: Path) -> None:
    """Keep what was measured, and write the page's tables."""
    content = json.loads(path.read_text())
    good = {(r["what"], r["size"], r["where"]): r for r in content["rows"] if not r.get("failed")}

    def cell(key: tuple, number: str = "whole_s") -> str:
        return f"{good[key][number]:.3g}" if number in good.get(key, {}) else "-"

    studies = harness.table({
        "joints of 0.6 s": str, "one GPU, nothing kept [s]": lambda n: cell(("study", n, "gpu")),
        "programs kept [s]": lambda n: cell(("study", n, "gpu"), "kept_s"),
        f"{content['cores']} CPU cores [s]": lambda n: cell(("study", n, "cores")),
    }, sorted({size for what, size, _ in good if what == "study"}))  # fmt: skip
    batches = [["what", "on a GPU", "on one core", "ratio a run", "first call on the GPU [s]"]]
    for what in ("histories", "jacobian", "impact"):
        a, b = (
            [(n, r["run_s"]) for (w, n, x), r in good.items() if (w, x) == (what, where)] for where in ("gpu", "core")
        )
        if a:
            (n, run), (m, slow) = a[-1], b[-1] if b else (0, 0.0)
            ratio = f"{(slow / m) / (run / n):.0f}" if b else "-"
            texts = [f"{count} in {taken:.3g} s" if count else "-" for count, taken in ((n, run), (m, slow))]
            batches.append([what, *texts, ratio, cell((what, n, "gpu"), "first_s")])
    worst = max(content["differences"].values(), default=None)
    device = next((r["device"] for k, r in good.items() if k[2] == "gpu" and k[0] != "study"), "a GPU")
    text = f"Measured on one {device}, and on the {content['cores']} cores of its host.\n\n{studies}"
    if worst is not None:
        text += f"\n\nFeatures of the GPU and of the CPU differ by {worst:.1g} at most, relative to themselves."
    publish("gpu", f"{text}\n\n{markdown(batches)}", "docs/howto/gpu.md")
    (RESULTS / "gpu.json").write_text(json.dumps(content, indent=1) + "\n")


def main() -> None:
    more: dict[str, Any] = {"for": 330.0}
    given = options(__doc__, None, out="build/gpu", quick=False, parts=Some(), tables=Path, one=Some(), **more)
    if given.one:
        print(json.dumps(in_batch(given.one[0], int(given.one[1]))))
    elif given.tables:
        tables(given.tables)
    else:
        run(given)


if __name__ == "__main__":
    main()
