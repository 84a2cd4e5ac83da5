"""What a low layer uses of a high one: by name, on first use, and only what this table lists.

Imports point down (``docs/architecture.md``). Two things are asked for from below all the same: a text with a unit,
wherever a number may stand, and how a result shows itself. Both need libraries that the physics does not import.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from typing import Any

NAMES = {
    "quantity": "bcfj_jax.io.units:quantity",
    "programme": "bcfj_jax.io.programmes:table",
    "text": "bcfj_jax.io.show:text",
    "html": "bcfj_jax.io.show:html",
    "frame": "bcfj_jax.io.show:frame",
    "dataset": "bcfj_jax.io.show:dataset",
    "figure": "bcfj_jax.io.show:figure",
}


@functools.cache
def upward(name: str) -> Callable[..., Any]:
    """The function that ``NAMES`` has under this name."""
    module, _, attribute = NAMES[name].partition(":")
    return getattr(importlib.import_module(module), attribute)
