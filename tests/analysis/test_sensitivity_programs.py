"""``bcfj sensitivity`` in a second process: every program is fetched, none traced, none compiled anew."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

_SCRIPT = """
import json, sys
from bcfj_jax.xla.compile_cache import open_cache
open_cache()
import jax.monitoring
from pathlib import Path
missed = []
jax.monitoring.register_event_listener(lambda name, **_: missed.append(name) if name.endswith("cache_misses") else None)
from bcfj_jax.analysis.derivatives import command
from bcfj_jax.xla import programs
wanted = {"features": [], "certify": True, "budget": 60.0}
text, good = command.run(sys.argv[1], sys.argv[2].split(","), wanted, Path(sys.argv[3]), lambda _: None, print)
csv = (Path(sys.argv[3]) / "sensitivity.csv").read_text()
found = {"good": good, "csv": csv, "traced": programs.traced, "fetched": programs.fetched, "missed": len(missed)}
print(json.dumps(found))
"""


def run(scene, wrt, folder, out):
    environment = {**os.environ, "BCFJ_CACHE": str(folder)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, scene, wrt, str(out)], env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "wrt", "solves"),
    [
        ("impact", "stiffness,damping", {"jacobian", "simulate"}),
        ("joint", "stiffness,friction_static", {"jacobian", "pitch", "simulate"}),
    ],
)
def test_a_second_process_traces_nothing(tmp_path, scene, wrt, solves):
    first, second = (run(scene, wrt, tmp_path / "cache", tmp_path / out) for out in ("one", "two"))
    assert first["good"] and second["good"]
    assert solves <= set(first["traced"])
    # Two programs at most for the derivatives; the third is that of ``bcfj simulate``.
    assert len(set(first["traced"]) & {"jacobian", "pitch", "gradient"}) == len(solves) - 1 <= 2
    assert second["traced"] == [] and second["missed"] == 0
    assert sorted(second["fetched"]) == sorted(first["traced"])
    assert second["csv"] == first["csv"]
    certificate = json.loads((tmp_path / "one/certificate.json").read_text())
    for name in wrt.split(","):
        found = certificate["parameters"][name]
        # Of every feature a number and a verdict, whether or not the history's derivative is trusted.
        assert set(found["feature_verdicts"]) == set(certificate["features"])
        assert found["verdict"] != "not differentiable here" and not found["unchecked"]
    if scene == "joint":
        steady = certificate["steady"]
        assert steady["reason"] == "" and steady["memory"] < 0.01
        told = {verdict for row in steady["verdicts"].values() for verdict in row.values()}
        assert told <= {"trusted", "averaged only"}
        # Independent of the start, and near to the run's own, which has the start in it.
        slope = certificate["features"]["seat_cage.mean"]["derivatives"]["friction_static"]
        assert abs(steady["feature_derivatives"]["friction_static"]["seat_cage.mean"] / slope - 1.0) < 0.03
