"""What a study and a design compile: kept programs, which the next process reads; with and without them one result."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pyarrow.parquet
import pytest
from studies import STUDY

# A process of its own, and what it traced, read, missed in XLA's cache and imported.
HEAD = """
import collections, json, sys
import bcfj_jax as bj
"""
SEEN = """
import jax
seen = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: seen.update([event.rpartition("/")[2]]))
"""
TAIL = """
from bcfj_jax.xla import programs
print(json.dumps([found, programs.traced, programs.fetched, seen["cache_misses"], "diffrax" in sys.modules]))
"""
RUN = """
from pathlib import Path
from bcfj_jax.analysis.studies import command
found = command.run(sys.argv[1], Path(sys.argv[2]), (None, None), lambda text: None, print)[1]
"""
DESIGN = """
import numpy as np
scene = bj.scenes.impact()
given = bj.design(scene, scene.parameters(), np.linspace(0.0, 2e-4, 41), "contact.peak", {"stiffness": ("1e9", "1e10")},
                  starts=2, samples=2, certify=False, slices=False, norms=())
found = [given.status, given.before.hex(), given.after.hex()]
"""


def told(code, *arguments, cache):
    """What a process says of itself."""
    use = f"bj.use_cache({str(cache)!r})\n" if cache else ""
    env = {key: value for key, value in os.environ.items() if key not in ("BCFJ_CACHE", "JAX_COMPILATION_CACHE_DIR")}
    command = [sys.executable, "-c", HEAD + use + SEEN + code + TAIL, *map(str, arguments)]
    job = subprocess.run(command, env=env, capture_output=True, text=True)
    assert job.returncode == 0, job.stderr
    return json.loads(job.stdout.splitlines()[-1])


@pytest.mark.slow
def test_a_second_study_traces_nothing_and_misses_nothing_and_finds_the_same_bits(tmp_path):
    file, cache = tmp_path / "study.toml", tmp_path / "cache"
    file.write_text(STUDY)
    code, traced, fetched, misses, _ = told(RUN, file, tmp_path / "first", cache=cache)
    assert (code, fetched) == (0, []) and misses and {"batch", "study steps", "study ends"} <= set(traced)
    code, again, fetched, misses, solvers = told(RUN, file, tmp_path / "second", cache=cache)
    assert (code, again, misses, solvers) == (0, [], 0, False) and set(fetched) == set(traced)
    code, again, fetched, _, _ = told(RUN, file, tmp_path / "third", cache=None)
    assert (code, set(again), fetched) == (0, set(traced), [])
    first, *others = (
        pyarrow.parquet.read_table(tmp_path / name / "results.parquet") for name in ("first", "second", "third")
    )
    assert all(first.equals(other) for other in others)


@pytest.mark.slow
def test_a_second_design_traces_nothing_and_misses_nothing_and_finds_the_same_bits(tmp_path):
    first, traced, fetched, misses, _ = told(DESIGN, cache=tmp_path / "cache")
    assert not fetched and misses and "batched jacobian" in traced
    second, again, fetched, misses, solvers = told(DESIGN, cache=tmp_path / "cache")
    assert (again, misses, solvers) == ([], 0, False) and set(fetched) == set(traced)
    third, again, fetched, _, _ = told(DESIGN, cache=None)
    assert first == second == third and set(again) == set(traced) and not fetched
