"""Shared test set-up: float64, a compilation cache inside the build tree, and the two tiers.

The second tier, tests marked ``slow``, runs after everything else; ``make test`` runs the first alone.
"""

from __future__ import annotations

import os
from pathlib import Path

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are (see the CLI).
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import pytest
from hypothesis import settings
from problems import PROBLEM, SCENE, TABLE

BUILD = Path(__file__).resolve().parent.parent / "build"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", str(BUILD / "jax-cache"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

# Deterministic on CI and here; compiling inside an example is slow, which is no failure.
# All tests take a hundred examples; the fast tier takes 25 (--hypothesis-profile fast).
for name, count in (("all", 100), ("fast", 25)):
    settings.register_profile(name, deadline=None, derandomize=True, max_examples=count, database=None)
settings.load_profile("all")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Slow tests last; a worker gets a file's tests of one tier together, for they share compiled programs."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is not None)
    for item in items:
        tier = "slow" if item.get_closest_marker("slow") else "fast"
        item.add_marker(pytest.mark.xdist_group(f"{item.path.name}-{tier}"))


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Each test in its own folder, with a good problem in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BCFJ_CACHE", str(BUILD / "jax-cache"))
    for name, text in (("p.toml", PROBLEM), ("s.toml", SCENE), ("d.csv", TABLE)):
        Path(name).write_text(text)
    return tmp_path
