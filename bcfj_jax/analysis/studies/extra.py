"""Libraries of the extra ``study``: imported where they are needed, and missed in words."""

from __future__ import annotations

import importlib
from typing import Any

from bcfj_jax.core.errors import InputError


def library(name: str) -> Any:
    """A library of the extra ``study``.

    Raises:
        InputError: if it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        package = name.partition(".")[0]
        raise InputError("bcfj study", f"needs {package}, which is not installed", "install bcfj-jax[study]") from None
