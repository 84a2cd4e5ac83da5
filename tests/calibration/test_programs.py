"""What a calibration compiles: a few programs, which the next process reads; with and without them one result."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from compiled import COMPILED

from bcfj_jax.xla import programs
from calibration import fit, load
from calibration.forward import model
from calibration.forward.runs import contacts, failure

DEMO = Path(__file__).parents[2] / "examples" / "chung_ooi_fit.toml"
# The spheres' stiffness, whether a run can start, the residuals with their Jacobian, a run that is looked at, and one whose
# penetrations are held against the sizes of the bodies.
NAMES = {"two spheres", "at_start", "adam", "calibration", "calibration run", "simulate"}
# The command in a process of its own, and what that traced, read, compiled and missed in XLA's cache.
COMMAND = """
import collections, json, sys
from bcfj_jax.xla.compile_cache import open_cache
open_cache()
import jax
seen = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: seen.update([event.rpartition("/")[2]]))
jax.monitoring.register_event_duration_secs_listener(lambda event, _, **__: seen.update([event.rpartition("/")[2]]))
from pathlib import Path
from bcfj_jax.xla import programs
from calibration import command
code = command.run(Path(sys.argv[1]), Path(sys.argv[2]), 0, 4)
unused = sorted({"numpyro", "petab", "pypesto", "matplotlib.pyplot"} & sys.modules.keys())
print(json.dumps([code, programs.traced, programs.fetched, seen["backend_compile_duration"], seen["cache_misses"], unused]))
"""


def calibrated(out: Path, cache: str) -> tuple[list, dict]:
    """What the command says of itself, and its ``fit.json``."""
    env = {**os.environ, "BCFJ_CACHE": cache}
    env.pop("JAX_COMPILATION_CACHE_DIR", None)
    job = subprocess.run([sys.executable, "-c", COMMAND, DEMO, out], env=env, capture_output=True, text=True)
    assert job.returncode == 0, job.stderr
    found = json.loads((out / "fit.json").read_text())
    found.pop("wall_s")
    return json.loads(job.stdout.splitlines()[-1]), found


@pytest.mark.slow
def test_a_second_process_traces_nothing_and_misses_nothing_and_finds_the_same_bits(tmp_path):
    (code, traced, fetched, _, misses, unused), first = calibrated(tmp_path / "first", str(tmp_path / "cache"))
    assert (code, set(traced), fetched, unused) == (0, NAMES, [], []) and misses
    (code, traced, fetched, compiled, misses, _), second = calibrated(tmp_path / "second", str(tmp_path / "cache"))
    assert (code, traced, set(fetched), misses) == (0, [], NAMES, 0)
    # No operation by itself beside them. Of them the start is kept for two kinds of runs.
    assert compiled == len(fetched) == len(NAMES) + 1
    (_, traced, fetched, *_), third = calibrated(tmp_path / "third", "off")
    assert set(traced) == NAMES and not fetched
    assert first == second == third


@pytest.fixture(scope="module")
def demo():
    return load(DEMO)


@pytest.fixture(scope="module")
def found(demo):
    return fit(demo, starts=4)


@pytest.mark.slow
def test_other_numbers_bounds_losses_and_horizons_share_one_program(demo, found):
    """Once a fit has run, others of the same structure trace and compile nothing, whatever their numbers."""
    assert found.verdict == "identified"
    wider = tuple(replace(f, upper=1.1 * f.upper) for f in demo.free)
    before = list(programs.traced)
    COMPILED.clear()
    for other, starts in ((replace(demo, free=wider), 4), (replace(demo, loss="soft_l1", accuracy=1e-5), 5)):
        fit(other, starts=starts, seed=1)
    assert not COMPILED and programs.traced == before


@pytest.mark.slow
def test_a_point_is_the_same_alone_and_among_others(demo):
    built = model.build(demo, demo.experiments).at_depth(-8.0)
    points = np.random.default_rng(0).uniform(0.2, 0.8, (15, 3))
    together = model.evaluation(built)(points)
    assert together.jacobians.shape == (15, 24, 3)
    for k in (0, 11, 12, 14):
        residuals, jacobian = model.residuals_and_jacobian(built, points[k])
        np.testing.assert_array_equal(together.residuals[k], residuals)
        np.testing.assert_array_equal(together.jacobians[k], jacobian)
        np.testing.assert_array_equal(together.readings[k], model.predictions(built, points[k]))


@pytest.mark.slow
def test_runs_beside_the_residuals_share_one_program(demo, found):
    """Contacts, failures and the pictures' runs are of as many samples each."""
    optimum = found.optimum
    before = list(programs.traced)
    assert contacts(optimum.model, optimum.end.point)
    assert failure(optimum.model, optimum.end.point)
    assert programs.traced == before
