"""Shared test set-up: float64, a compilation cache inside the build tree, and the two tiers.

The second tier, tests marked ``slow``, runs after everything else and only while time is left: one that would begin
later than ``--slow-until`` seconds after the first is skipped, and says so.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are (see the CLI).
os.environ.setdefault("EQX_ON_ERROR", "nan")
# Set by the first process, which workers inherit it from.
os.environ.setdefault("BCFJ_TESTS_BEGAN", repr(time.time()))

import jax
import pytest
from hypothesis import settings
from problems import PROBLEM, SCENE, TABLE

BUILD = Path(__file__).resolve().parent.parent / "build"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", str(BUILD / "jax-cache"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

# Deterministic on CI and here; compiling inside an example is slow, which is no failure.
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=100, database=None)
settings.load_profile("ci")


def pytest_addoption(parser):
    parser.addoption("--slow-until", type=float, default=float("inf"), help="no slow test begins after that [s]")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Slow tests last; a worker gets a file's tests of one tier together, for they share compiled programs."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is not None)
    for item in items:
        tier = "slow" if item.get_closest_marker("slow") else "fast"
        item.add_marker(pytest.mark.xdist_group(f"{item.path.name}-{tier}"))


def pytest_runtest_setup(item):
    late = time.time() - float(os.environ["BCFJ_TESTS_BEGAN"]) > item.config.getoption("--slow-until")
    if late and item.get_closest_marker("slow"):
        pytest.skip("second tier: no time left")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Each test in its own folder, with a good problem in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    for name, text in (("p.toml", PROBLEM), ("s.toml", SCENE), ("d.csv", TABLE)):
        Path(name).write_text(text)
    return tmp_path
