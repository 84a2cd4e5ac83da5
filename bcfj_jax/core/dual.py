"""Arrays of NumPy that carry derivatives along: one definition gives a number of a finished run and its slopes.

A ``Dual`` is a value x (...) with slopes dx (P, ...), one for each of P parameters. NumPy's functions on it follow the chain
rule, df = sum_i (df/dx_i) dx_i; nothing is compiled. What is defined by these functions alone takes arrays of NumPy, of JAX
(``backend``) and duals alike. Of functions over an axis the values are (N,), of products of matrices one factor is plain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.lib.mixins import NDArrayOperatorsMixin


def backend(*values: Any) -> Any:
    """NumPy for arrays of the host and duals, on which nothing is compiled; ``jax.numpy`` for traced ones."""
    return jnp if any(isinstance(x, Array) for x in values) else np


def still(x: Any) -> Any:
    """The value, whose derivative is 0."""
    return x.value if isinstance(x, Dual) else jax.lax.stop_gradient(x) if isinstance(x, Array) else x


def unsloped(value: float, like: Any) -> Any:
    """A number without a derivative: NaN slopes where ``like`` has slopes."""
    return Dual(np.asarray(value), np.full(len(like.slope), np.nan)) if isinstance(like, Dual) else value


def either(known: Any, first: Callable[[], Any], other: Callable[[], Any]) -> Any:
    """What the first gives where ``known``, else the other; of a traced condition both are taken."""
    if isinstance(known, Array):
        return jnp.where(known, first(), other())
    return first() if known else other()


class Dual(NDArrayOperatorsMixin):
    """Value (...) and its slopes (P, ...)."""

    __slots__ = ("slope", "value")

    def __init__(self, value: Any, slope: Any) -> None:
        self.value, self.slope = np.asarray(value), slope

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the value."""
        return self.value.shape

    @property
    def ndim(self) -> int:
        """Of the value."""
        return self.value.ndim

    @property
    def size(self) -> int:
        """Of the value."""
        return self.value.size

    def __len__(self) -> int:
        return len(self.value)

    def __getitem__(self, index: Any) -> Dual:
        return Dual(self.value[index], self.slope[(slice(None), *(index if isinstance(index, tuple) else (index,)))])

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **_: Any) -> Any:
        values = [still(x) for x in inputs]
        if method != "__call__":
            return NotImplemented
        if ufunc is np.matmul:
            return _product(*inputs)
        if ufunc is np.conjugate:
            return Dual(ufunc(self.value), ufunc(self.slope))
        found = ufunc(*values)
        if ufunc in _PLAIN:
            return found
        total = None
        for partial, x in zip(_PARTIALS[ufunc](found, *values), inputs, strict=True):
            if isinstance(x, Dual):
                # A number beside an array.
                slope = x.slope.reshape(*x.slope.shape[:1], *[1] * (np.ndim(found) - x.value.ndim), *x.shape)
                part = slope if partial is None else slope * partial
                total = part if total is None else total + part
        return Dual(found, total)

    def __array_function__(self, function: Any, types: Any, args: Sequence[Any], kwargs: dict) -> Any:
        if function in _LINEAR:
            return Dual(*(function(x, *args[1:], **kwargs) for x in (args[0].value, args[0].slope)))
        return _FUNCTIONS[function](*args, **kwargs)


_PLAIN = {np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.isfinite, np.isnan, np.sign}
# Partial derivatives by each argument, of the result and the arguments; None for 1.
_PARTIALS: dict[Any, Callable[..., tuple]] = {
    np.add: lambda f, a, b: (None, None),
    np.subtract: lambda f, a, b: (None, -1.0),
    np.multiply: lambda f, a, b: (b, a),
    np.divide: lambda f, a, b: (1.0 / b, -f / b),
    np.negative: lambda f, a: (-1.0,),
    np.absolute: lambda f, a: (np.sign(a),),
    np.sqrt: lambda f, a: (0.5 / f,),
    np.maximum: lambda f, a, b: (a > b, b >= a),
    np.minimum: lambda f, a, b: (a < b, b <= a),
}
# Along the last axis.
_LINEAR = {np.diff, np.fft.rfft, np.fft.irfft}


def _product(a: Any, b: Any) -> Dual:
    """A matrix or a row times values (N,), or these times a row."""
    slope = b.slope @ np.transpose(a) if isinstance(b, Dual) else a.slope @ b
    return Dual(still(a) @ still(b), slope)


def _where(test: Any, a: Any, b: Any) -> Dual:
    """Of a test (N,), and values (N,) or numbers without slopes."""
    slopes = [x.slope if isinstance(x, Dual) else 0.0 for x in (a, b)]
    return Dual(np.where(test, still(a), still(b)), np.where(test, *slopes))


def _joined(parts: Sequence[Any]) -> Dual:
    count = next(len(x.slope) for x in parts if isinstance(x, Dual))
    slopes = [x.slope if isinstance(x, Dual) else np.zeros((count, len(x))) for x in parts]
    return Dual(np.concatenate([still(x) for x in parts]), np.concatenate(slopes, axis=1))


def _trapezoid(y: Any, x: Any) -> Any:
    return np.sum(np.diff(x) * (y[1:] + y[:-1]) / 2.0)


_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.sum: lambda a: Dual(a.value.sum(), a.slope.sum(-1)),
    np.mean: lambda a: Dual(a.value.mean(), a.slope.mean(-1)),
    np.max: lambda a: a[int(np.argmax(a.value))],
    np.min: lambda a: a[int(np.argmin(a.value))],
    np.argmax: lambda a: np.argmax(a.value),
    np.cumsum: lambda a: Dual(np.cumsum(a.value), np.cumsum(a.slope, axis=-1)),
    np.where: _where,
    np.clip: lambda a, low, high: np.minimum(np.maximum(a, low), high),
    np.concatenate: _joined,
    np.stack: lambda parts: Dual(np.stack([x.value for x in parts]), np.stack([x.slope for x in parts], axis=-1)),
    np.trapezoid: _trapezoid,
    np.interp: lambda at, x, a: Dual(
        np.interp(at, x, a.value), np.array([np.interp(at, x, row) for row in a.slope]).reshape(len(a.slope), len(at))
    ),
}
