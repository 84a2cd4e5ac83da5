"""A JAX function evaluated by NumPy, primitive by primitive: nothing is compiled, for what is asked only once or twice.

A check before a run must not cost the compilation of a program of its own. The function is traced, which is quick, and
its few hundred operations are done by NumPy. It serves small programs of scalars and short vectors; what it does not
know it says (``Unknown``), and the caller compiles instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from bcfj_jax.xla.inside import ClosedJaxpr, Jaxpr, Literal


class Unknown(Exception):
    """A primitive without a NumPy equivalent here."""


def _select(which: Any, *cases: Any) -> Any:
    return np.where(which, cases[1], cases[0]) if which.dtype == bool else np.choose(which, cases)


def _divided(a: Any, b: Any) -> Any:
    # Whole numbers as XLA divides them, towards zero.
    return a / b if np.issubdtype(np.result_type(a, b), np.floating) else np.trunc(a / b).astype(np.result_type(a, b))


def _broadcast(x: Any, shape: Sequence[int], broadcast_dimensions: Sequence[int], **_: Any) -> Any:
    apart = [1] * len(shape)
    for axis, size in zip(broadcast_dimensions, np.shape(x), strict=True):
        apart[axis] = size
    return np.broadcast_to(np.reshape(x, apart), shape)


def _slice(x: Any, start_indices: Any, limit_indices: Any, strides: Any = None, **_: Any) -> Any:
    steps = strides or (1,) * len(start_indices)
    return x[tuple(slice(a, b, s) for a, b, s in zip(start_indices, limit_indices, steps, strict=True))]


def _pad(x: Any, value: Any, padding_config: Sequence[tuple[int, int, int]]) -> Any:
    """What differentiates ``x[k]``: zeros around it."""
    if any(min(sides) < 0 for sides in padding_config):
        raise Unknown("pad that cuts")
    shape = [
        low + n + max(n - 1, 0) * gap + high for n, (low, high, gap) in zip(np.shape(x), padding_config, strict=True)
    ]
    found = np.full(shape, value)
    found[tuple(slice(low, m - high, gap + 1) for m, (low, high, gap) in zip(shape, padding_config, strict=True))] = x
    return found


def _dynamic_slice(x: Any, *starts: Any, slice_sizes: Sequence[int], **_: Any) -> Any:
    places = [int(np.clip(s, 0, n - k)) for s, n, k in zip(starts, np.shape(x), slice_sizes, strict=True)]
    return x[tuple(slice(s, s + k) for s, k in zip(places, slice_sizes, strict=True))]


def _gather(x: Any, at: Any, dimension_numbers: Any, slice_sizes: Sequence[int], **_: Any) -> Any:
    """Rows along one axis, as ``x.at[at].get`` takes them."""
    known = dimension_numbers
    if (
        len(known.start_index_map) != 1
        or known.collapsed_slice_dims != known.start_index_map
        or known.operand_batching_dims
    ):
        raise Unknown("gather along several axes")
    (axis,), wide = known.start_index_map, np.ndim(at) - 1
    others = [i for i in range(np.ndim(x)) if i != axis]
    apart = [i if i < axis else i + wide - 1 for i in others]
    if list(known.offset_dims) != apart or any(slice_sizes[i] != x.shape[i] for i in others):
        raise Unknown("gather of parts")
    return np.take(x, np.clip(at[..., 0], 0, x.shape[axis] - 1), axis)


def _dot(a: Any, b: Any, dimension_numbers: Any, **_: Any) -> Any:
    (left, right), (first, second) = dimension_numbers
    if first or second:
        raise Unknown("dot_general over a batch")
    return np.tensordot(a, b, (left, right))


def _over(reduce: Callable[..., Any]) -> Callable[..., Any]:
    return lambda x, axes, **_: reduce(x, axis=tuple(axes))


# Elementwise operations, which have no parameters that matter here.
_ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "add": np.add, "add_any": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "div": _divided,
    "rem": np.fmod, "pow": np.power, "sqrt": np.sqrt, "rsqrt": lambda x: 1.0 / np.sqrt(x), "cbrt": np.cbrt, "square": np.square,
    "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1, "log": np.log, "log1p": np.log1p,
    "cos": np.cos, "sin": np.sin, "tan": np.tan, "acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "atan2": np.arctan2,
    "lgamma": np.vectorize(math.lgamma, otypes=[float]),
    "cosh": np.cosh, "sinh": np.sinh, "tanh": np.tanh, "logistic": lambda x: 1.0 / (1.0 + np.exp(-x)),
    "abs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil, "is_finite": np.isfinite,
    "max": np.maximum, "min": np.minimum, "clamp": lambda low, x, high: np.minimum(np.maximum(x, low), high),
    "gt": np.greater, "lt": np.less, "ge": np.greater_equal, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal,
    "gt_to": np.greater, "lt_to": np.less, "ge_to": np.greater_equal, "le_to": np.less_equal,
    "and": np.bitwise_and, "or": np.bitwise_or, "not": np.invert, "xor": np.bitwise_xor,
    "select_n": _select, "copy": np.asarray, "copy_p": np.asarray, "stop_gradient": np.asarray,
}  # fmt: skip
_SHAPED: dict[str, Callable[..., Any]] = {
    "integer_pow": lambda x, y, **_: np.power(x, y) if y >= 0 else 1.0 / np.power(x, -y),
    "broadcast_in_dim": _broadcast, "slice": _slice, "dynamic_slice": _dynamic_slice, "gather": _gather, "dot_general": _dot,
    "pad": _pad,
    "convert_element_type": lambda x, new_dtype, **_: x.astype(new_dtype),
    "reshape": lambda x, new_sizes, **_: np.reshape(x, new_sizes),
    "squeeze": lambda x, dimensions, **_: np.squeeze(x, tuple(dimensions)),
    "expand_dims": lambda x, dimensions, **_: np.expand_dims(x, tuple(dimensions)),
    "transpose": lambda x, permutation, **_: np.transpose(x, permutation),
    "rev": lambda x, dimensions, **_: np.flip(x, tuple(dimensions)),
    "concatenate": lambda *x, dimension, **_: np.concatenate(x, dimension),
    "stack": lambda *x, axis, **_: np.stack(x, axis),
    "iota": lambda dtype, shape, dimension, **_: _broadcast(np.arange(shape[dimension], dtype=dtype), shape, (dimension,)),
    "reduce_max": _over(np.max), "reduce_min": _over(np.min), "reduce_sum": _over(np.sum), "reduce_prod": _over(np.prod),
    "reduce_and": _over(np.all), "reduce_or": _over(np.any),
    "argmax": lambda x, axes, index_dtype, **_: np.argmax(x, axes[0]).astype(index_dtype),
    "argmin": lambda x, axes, index_dtype, **_: np.argmin(x, axes[0]).astype(index_dtype),
}  # fmt: skip


def evaluate(traced: ClosedJaxpr, arguments: Sequence[Any]) -> list[np.ndarray]:
    """The outputs of a traced function, by NumPy.

    Args:
        traced: from ``jax.make_jaxpr``.
        arguments: its inputs, flat, in their order.
    """
    with np.errstate(all="ignore"):
        return _closed(traced, [np.asarray(x) for x in arguments])


def _closed(traced: ClosedJaxpr, arguments: Sequence[Any]) -> list[Any]:
    return _run(traced.jaxpr, [np.asarray(x) for x in traced.consts], arguments)


def _run(jaxpr: Jaxpr, consts: Sequence[Any], arguments: Sequence[Any]) -> list[Any]:
    known: dict[Any, Any] = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*consts, *arguments], strict=True))
    for equation in jaxpr.eqns:
        given = [np.asarray(x.val) if isinstance(x, Literal) else known[x] for x in equation.invars]
        found = _done(equation.primitive.name, given, equation.params)
        for variable, value in zip(equation.outvars, found, strict=True):
            known[variable] = value
    return [np.asarray(x.val) if isinstance(x, Literal) else known[x] for x in jaxpr.outvars]


def _done(name: str, given: list[Any], params: Mapping[str, Any]) -> list[Any]:
    if name == "scan":
        return _scan(given, params)
    if name == "while":
        return _while(given, params)
    if name == "cond":
        return _closed(params["branches"][int(np.clip(given[0], 0, len(params["branches"]) - 1))], given[1:])
    # A function within: jit, custom derivatives, checkpoints.
    inner = next((params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr") if key in params), None)
    if inner is not None:
        return _closed(inner, given) if isinstance(inner, ClosedJaxpr) else _run(inner, [], given)
    if name in _ELEMENTWISE:
        return [np.asarray(_ELEMENTWISE[name](*given))]
    if name in _SHAPED:
        return [np.asarray(_SHAPED[name](*given, **params))]
    # It tells XLA what not to fuse.
    if name == "optimization_barrier":
        return given
    if name == "unstack":
        return list(np.moveaxis(given[0], params["axis"], 0))
    if name == "split":
        return np.split(given[0], np.cumsum(params["sizes"])[:-1], params["axis"])
    # From JAX 0.12 on the search within ``interp`` is one operation.
    searched: Any = params.get("_prim")
    if type(searched).__name__ == "SearchSorted" and not searched.batch_dims:
        return [np.searchsorted(*given, side=searched.side).astype(np.int32)]
    raise Unknown(name)


def _scan(given: list[Any], params: Mapping[str, Any]) -> list[Any]:
    fixed, carried = _scanned(params)
    length = params["length"]
    consts, carry, rows = given[:fixed], given[fixed : fixed + carried], given[fixed + carried :]
    outs: list[list[Any]] = []
    for i in reversed(range(length)) if params["reverse"] else range(length):
        found = _closed(params["jaxpr"], [*consts, *carry, *(row[i] for row in rows)])
        carry = found[:carried]
        outs.append(found[carried:])
    outs = outs[::-1] if params["reverse"] else outs
    if not outs and len(params["jaxpr"].jaxpr.outvars) > carried:
        raise Unknown("scan of no length")
    return [*carry, *(np.stack(column) for column in zip(*outs, strict=True))]


def _scanned(params: Mapping[str, Any]) -> tuple[int, int]:
    """Numbers of constants and of carried values of a scan; from JAX 0.12 on its inputs are a tree of three branches."""
    if "ft_in" not in params:
        return params["num_consts"], params["num_carry"]
    consts, carry, _ = params["ft_in"].unpack()
    return len(consts), len(carry)


def _while(given: list[Any], params: Mapping[str, Any]) -> list[Any]:
    first, second = params["cond_nconsts"], params["body_nconsts"]
    asking, doing, carry = given[:first], given[first : first + second], given[first + second :]
    while bool(_closed(params["cond_jaxpr"], [*asking, *carry])[0]):
        carry = _closed(params["body_jaxpr"], [*doing, *carry])
    return carry
