"""Libraries of the extra ``study``: imported where they are needed; before work begins, ``needed`` asks for all."""

from __future__ import annotations

from typing import Any

from bcfj_jax.core import extras


def library(name: str, extra: str = "study") -> Any:
    """A library of the extra ``study``, or of another.

    Raises:
        InputError: if it is not installed.
    """
    return extras.library(name, "bcfj study", extra)


def needed(histories: bool, scheduler: bool = False) -> None:
    """Ask for every library that a run of a study imports sooner or later.

    Args:
        histories: whether the study keeps them.
        scheduler: whether a Dask scheduler does the work.

    Raises:
        InputError: if one is not installed.
    """
    for name in ("pyarrow", "filelock", *(["zarr"] if histories else [])):
        library(name)
    if scheduler:
        library("distributed", "cluster")
