"""Shared test set-up: float64, and a compilation cache inside the build tree so a second run is quick."""

from __future__ import annotations

import os
from pathlib import Path

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are (see the CLI).
os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
from hypothesis import settings

BUILD = Path(__file__).resolve().parent.parent / "build"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", str(BUILD / "jax-cache"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

# Deterministic on CI and here; compiling inside an example is slow, which is no failure.
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=100, database=None)
settings.load_profile("ci")
