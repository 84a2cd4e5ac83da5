"""Compiled programs kept between runs. Imports nothing that reads the environment before it is set here."""

from __future__ import annotations

import os


def use_compile_cache() -> None:
    """Keep compiled programs between runs: ``BCFJ_CACHE``, JAX's own setting, or the user's cache folder."""
    import jax
    import platformdirs

    # JAX keeps no program that calls back to the host, as diffrax's checks do to raise. Here they give NaN instead,
    # which a run reports as its failure. Read when equinox is first imported, so it must be set before.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    own = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    folder = os.environ.get("BCFJ_CACHE") or own
    if folder == "off":
        return
    folder = folder or platformdirs.user_cache_dir("bcfj-jax")
    jax.config.update("jax_compilation_cache_dir", str(folder))
    # JAX's own threshold of a second would leave out most of these programs.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
