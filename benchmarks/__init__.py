"""Benchmarks."""

import os

# Before equinox is imported: JAX keeps no program with host callbacks, which diffrax's checks are.
os.environ.setdefault("EQX_ON_ERROR", "nan")
