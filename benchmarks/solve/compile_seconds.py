"""How long the programs of the built-in scenes take to compile: what a first run says before it knows its own machine.

Every command runs in a process of its own that keeps nothing from before. A program's time is the processor time of the
process while that program alone is traced and compiled, so that other work on the machine changes it little.

    python -m benchmarks.solve.compile_seconds [--only joint,impact]    rewrites bcfj_jax/xla/compile_seconds.json
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import threading
import time
from typing import Any

from benchmarks.common import ROOT, options
from benchmarks.processes import call

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


def worker(words: list[str], folder: str) -> dict[str, float]:
    """One command in this process, whose programs compile one after another; the seconds of each."""
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
    os.chdir(folder)
    sys.argv = ["bcfj", *words, "--out", "out"]
    with contextlib.suppress(SystemExit):
        main()
    return seconds


def main() -> None:
    """Measure, and keep what takes long enough to be said."""
    only = options(__doc__, only=(",".join(COMMANDS), "names, separated by commas")).only
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in only.split(","):
        for words in COMMANDS[name]:
            with tempfile.TemporaryDirectory() as folder:
                variables = {"BCFJ_CACHE": f"{folder}/cache", "OMP_NUM_THREADS": "1"}
                took = call(__file__, "worker", words, folder, variables=variables)
            found |= {key: one for key, one in took.items() if one >= _LEAST}
            FILE.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n")
            print(" ".join(words), flush=True)


if __name__ == "__main__":
    main()
