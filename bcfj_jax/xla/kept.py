"""Values that are computed once: a fence between the kernels into which XLA fuses elementwise code.

XLA on a CPU fuses a value into everything that reads it, and computes it anew for each entry that does: a contact's normal
force once for every component of its force and moment, and a chain of such values by the product of their readers.
``optimization_barrier`` is taken out before fusion. A loop is not fused, so the value passes through one that never turns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.xla import inside
from bcfj_jax.xla.backend import on_cpu
from bcfj_jax.xla.inside import Primitive, ad


def kept(*values: Array) -> Any:
    """The values themselves, each computed once. Linear: derivatives of every kind and batches go through."""
    found = _KEPT.bind(*values)
    return found[0] if len(values) == 1 else tuple(found)


def once(wanted: Array, function: Callable[[], Any], otherwise: Any) -> Any:
    """``function()`` where wanted, else what is given: a branch of which XLA makes one kernel, where it can.

    A loop that turns once at most; ``xla.backend`` says which loops become one kernel. One kernel of a hundred small ones
    saves what calling them costs. Not to be differentiated in reverse.
    """
    return jax.lax.while_loop(lambda x: x[0], lambda x: (jnp.zeros_like(x[0]), function()), (wanted, otherwise))[1]


def each(function: Callable[[Any], Any], rows: Any) -> Any:
    """``function`` of every row: on a CPU one after the other, so that small products call no library; else at once."""
    return jax.lax.map(function, rows) if on_cpu() else jax.vmap(function)(rows)


def _loop(*values: Array) -> list[Array]:
    first = values[0].reshape(-1)[0]
    # Never true; XLA does not know.
    never = (first != first) & (first > 0)
    body = lambda carry: (carry[0] & False, *(0.5 * x for x in carry[1:]))  # noqa: E731
    return list(jax.lax.while_loop(lambda carry: carry[0], body, (never, *values))[1:])


_KEPT = Primitive("kept")
_KEPT.multiple_results = True
_KEPT.def_impl(lambda *values: list(values))
_KEPT.def_abstract_eval(lambda *values: list(values))
inside.register_lowering(_KEPT, inside.lowered_by(_loop, multiple_results=True))
inside.batchers[_KEPT] = lambda values, axes: (_KEPT.bind(*values), axes)


def _jvp(values: Any, tangents: Any) -> tuple[list[Array], list[Any]]:
    moving = [i for i, x in enumerate(tangents) if not isinstance(x, ad.Zero)]
    found = list(tangents)
    for i, x in zip(moving, _KEPT.bind(*(tangents[i] for i in moving)), strict=True):
        found[i] = x
    return _KEPT.bind(*values), found


ad.primitive_jvps[_KEPT] = _jvp
ad.primitive_transposes[_KEPT] = lambda cotangents, *values: list(cotangents)
