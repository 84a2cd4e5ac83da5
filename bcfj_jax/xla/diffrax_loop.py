"""Diffrax's loop over steps, without the operations that it makes of one number and one question.

``diffrax._integrate.loop`` (0.7.2) goes down from the run's end by a hundred ULPs, one unrolled call after the other: 400
of the 1 835 operations of an impact's program. It also traces a whole step twice beforehand, to learn whether its jump and
its result are constants, which here they hardly ever are, and checks its times by branches. Within ``shortened`` the hundred
calls are one subtraction, with the same bits. A step is traced once. What is wrong is NaN without a branch. What others
solve by diffrax, in this process or thread, is as it was.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any, NamedTuple

import diffrax._integrate as loop
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from equinox import _config as config
from jax import Array

from bcfj_jax.xla.inside import Tracer

_thread = threading.local()


class Below(NamedTuple):
    """The number that is ``ulps`` below a time; it can be compared with a time, which is all that diffrax does with it."""

    time: Any
    ulps: int

    def __lt__(self, other: Any) -> Array:
        return self.value() < other

    def value(self) -> Array:
        """By the order of IEEE 754: the bits of neighbours, read as whole numbers, differ by one."""
        time = jax.lax.stop_gradient(jnp.asarray(self.time, dtype=jnp.float64))
        bits = jax.lax.bitcast_convert_type(time, jnp.int64)
        return jax.lax.bitcast_convert_type(bits - self.ulps, jnp.float64)


def _before(time: Any) -> Below:
    return Below(time.time, time.ulps + 1) if isinstance(time, Below) else Below(time, 1)


def _shapes(fun: Any, *args: Any) -> Any:
    """``filter_eval_shape``, but that a step's jump and result are never known beforehand, which is always right."""
    return (None, True, True) if getattr(fun, "__name__", "") == "body_fun_aux" else eqx.filter_eval_shape(fun, *args)


def _checked(x: Any, wrong: Any, message: str) -> Any:
    """``error_if``; where ``EQX_ON_ERROR`` makes errors NaN, by a choice. Equinox formats the stack for a message first."""
    if config.EQX_ON_ERROR != "nan" or not isinstance(wrong, Tracer):
        return eqxi.error_if(x, wrong, message)
    return jnp.where(jnp.any(wrong), jnp.nan, x)


class _Module:
    """A module as diffrax's loop sees it: within ``shortened`` with some of its functions replaced."""

    def __init__(self, module: Any, **instead: Any) -> None:
        self._module, self._instead = module, instead

    def __getattr__(self, name: str) -> Any:
        shortened = getattr(_thread, "shortened", False) and name in self._instead
        return self._instead[name] if shortened else getattr(self._module, name)


loop.eqx = _Module(eqx, filter_eval_shape=_shapes)  # pyright: ignore[reportPrivateImportUsage]
loop.eqxi = _Module(eqxi, prevbefore=_before, error_if=_checked)  # pyright: ignore[reportPrivateImportUsage]


@contextlib.contextmanager
def shortened() -> Iterator[None]:
    """A run from a time that is not negative to a later one is traced in here."""
    before = getattr(_thread, "shortened", False)
    _thread.shortened = True
    try:
        yield
    finally:
        _thread.shortened = before
