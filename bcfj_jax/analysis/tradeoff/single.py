"""A setting in 32-bit numbers: what they would cost. The package refuses them; a process of its own measures them.

    python -m bcfj_jax.analysis.tradeoff.single TABLE.json OUT.npz

JAX's width of numbers belongs to a whole process, so that the study's own cannot change it for one run.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bcfj_jax.analysis.tradeoff.trial import Trial, loaded, repeatedly
from bcfj_jax.core.compile_cache import open_cache
from bcfj_jax.io import usercode
from bcfj_jax.io.outputs import plain
from bcfj_jax.io.stop import check as check_stop
from bcfj_jax.solve.plan import Plan, plan
from bcfj_jax.solve.simulation import Run, timed

# What of a run is compared, contact by contact.
_READ = ("force", "penetration", "rate", "slip")


def single(table: Mapping[str, Any], seconds: float) -> Trial:
    """Run a scene file in 32-bit numbers, in another process, for so many seconds at most.

    Raises:
        RuntimeError: where the other process failed, with its last line, or did not end in time.
        KeyboardInterrupt: for a Ctrl-C that came meanwhile, which the other process takes as well.
    """
    with tempfile.TemporaryDirectory() as place:
        asked, out = Path(place, "table.json"), Path(place, "out.npz")
        asked.write_text(json.dumps(plain(table)))
        command = [sys.executable, "-m", __name__, str(asked), str(out), *usercode.arguments()]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=max(seconds, 1.0), check=False)
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"32-bit numbers: not done within the {seconds:.0f} s that were left") from None
        check_stop()
        if done.returncode:
            last = [line for line in done.stderr.splitlines() if line.strip()][-1:] or [f"exit {done.returncode}"]
            raise RuntimeError(f"32-bit numbers: {last[0]}")
        with np.load(out) as kept:
            result = json.loads(str(kept["result"]))
            parts = {name: {c: kept[f"{name} {c}"] for c in result["contacts"][name]} for name in _READ}
            run = Run(times=kept["times"], **parts, **result["status"])
    return Trial(run, result["cost"])


def _child(table: Mapping[str, Any], out: Path) -> None:
    given = loaded(table)
    given.scene.check(given.params)
    # Planned in the width that planning asks for.
    tolerance = float(plan(given.scene, given.accuracy, given.max_steps, given.solver).tolerance)
    jax.config.update("jax_enable_x64", False)
    warnings.filterwarnings("ignore", message="Explicitly requested dtype")
    params = {name: jax.numpy.asarray(np.float32(value)) for name, value in given.params.items()}
    how = Plan(jax.numpy.asarray(np.float32(tolerance)), given.max_steps, solver=given.solver)
    run, cost = repeatedly(lambda: timed(given.scene, params, given.times, how))
    result = {
        "contacts": {name: list(getattr(run, name)) for name in _READ},
        "status": {"status": run.status, "reason": run.reason, "failure_time": run.failure_time, "stats": run.stats},
        "cost": cost,
    }
    arrays = {f"{name} {c}": np.asarray(x, float) for name in _READ for c, x in getattr(run, name).items()}
    np.savez(out, times=given.times, result=json.dumps(result), **arrays)  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    open_cache()
    usercode.from_arguments(sys.argv)
    _child(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2]))
