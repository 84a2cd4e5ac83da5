"""What of JAX lies outside its stable interface: only here are ``jax.core``, ``jax.extend`` and ``jax.interpreters`` imported.

A release of JAX that moves something is met here. ``scripts/pythons.py`` runs the tests on the oldest, the pinned and the
newest release that pyproject.toml admits, and ``tests/solve/test_composed.py`` composes every transformation with every other.
"""

from __future__ import annotations

from typing import Any

from jax.core import ShapedArray as ShapedArray
from jax.core import Tracer as Tracer
from jax.extend.core import ClosedJaxpr as ClosedJaxpr
from jax.extend.core import Jaxpr as Jaxpr
from jax.extend.core import Literal as Literal
from jax.extend.core import Primitive as Primitive
from jax.interpreters import ad as ad
from jax.interpreters import batching, mlir, partial_eval

# The axis of an operand that is not batched, as batching rules are given it: from JAX 0.11 on None.
NOT_MAPPED: Any = getattr(batching, "not_mapped", None)
# Batching rules by primitive, and that of a primitive which works on every entry by itself.
batchers, elementwise = batching.primitive_batchers, batching.defvectorized
# How a primitive is compiled: by a function of its operands, or as MLIR.
lowered_by, register_lowering = mlir.lower_fun, mlir.register_lowering


def to_be_transposed(tangent: Any) -> bool:
    """Whether a tangent is an unknown of a linear map, as when a gradient is being made."""
    return isinstance(tangent, partial_eval.JaxprTracer)
