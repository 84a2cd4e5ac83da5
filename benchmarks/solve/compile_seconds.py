"""How long the programs of the built-in scenes take to compile: what a first run says before it knows its own machine.

Every command runs in a process of its own that keeps nothing from before. A program's time is the processor time of the
process while that program alone is traced and compiled, so that other work on the machine changes it little.

    python -m benchmarks.solve.compile_seconds [--only joint,impact]    rewrites bcfj_jax/xla/compile_seconds.json
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
FILE = ROOT / "bcfj_jax" / "xla" / "compile_seconds.json"
_SEVERAL = "stiffness,damping"
COMMANDS: dict[str, list[list[str]]] = {
    "joint": [["simulate", "joint"], ["sensitivity", "joint", "--wrt", _SEVERAL]],
    "impact": [["simulate", "impact"], ["sensitivity", "impact", "--wrt", _SEVERAL]],
    **{
        name: [["simulate", name]]
        for name in ("bounce", "chain", "slider_crank", "slider_guide", "four_bar", "backlash")
    },
    "calibration": [["calibrate", str(ROOT / "examples" / "chung_ooi_fit.toml")]],
}
# What is shorter is not said [s].
_LEAST = 0.5


def worker(words: list[str]) -> None:
    """One command in this process, whose programs compile one after another; their seconds, as JSON, to stdout's end."""
    from bcfj_jax.cli import main
    from bcfj_jax.xla import programs

    alone, seconds, make = threading.Lock(), {}, programs._made

    def made(wanted: Any, jitted: Any = None) -> Any:
        with alone:
            begin = time.process_time()
            found = make(wanted, jitted)
            name = f"{wanted.name} {programs._kind(wanted)}"
            seconds[name] = max(seconds.get(name, 0.0), round(time.process_time() - begin, 1))
        return found

    programs._made = made
    sys.argv = ["bcfj", *words]
    try:
        main()
    finally:
        Path("seconds.json").write_text(json.dumps(seconds))


def measured(words: list[str]) -> dict[str, float]:
    """Seconds of the programs of one command [s], by program and kind of model."""
    with tempfile.TemporaryDirectory() as folder:
        cache = str(Path(folder) / "cache")
        env = {**os.environ, "BCFJ_CACHE": cache, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, str(Path(__file__)), "--worker", *words, "--out", "out"]
        subprocess.run(command, cwd=folder, env=env, check=True, capture_output=True)
        return json.loads((Path(folder) / "seconds.json").read_text())


def main() -> None:
    """Measure, and keep what takes long enough to be said."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(COMMANDS), help="names, separated by commas")
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in parser.parse_args().only.split(","):
        for words in COMMANDS[name]:
            found |= {key: took for key, took in measured(words).items() if took >= _LEAST}
            FILE.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n")
            print(" ".join(words), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(sys.argv[2:])
    else:
        main()
