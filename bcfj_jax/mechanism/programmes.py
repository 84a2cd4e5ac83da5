"""Amounts over time, of loads and drives: how they rise, fluctuate and reverse, or the table that they follow."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import InputError, one_of, quoted
from bcfj_jax.core.numerics import smooth_rise, smooth_step
from bcfj_jax.core.vectors import Number, plus, times
from bcfj_jax.mechanism import sizes
from bcfj_jax.mechanism.arrays import refuse_traced
from bcfj_jax.mechanism.sizes import Parameters, Params, Size

# Two rows of one length: times [s], increasing, and values.
Table = tuple[tuple[float, ...], tuple[float, ...]]


def _line(fraction: ArrayLike) -> Array:
    return jnp.clip(fraction, 0.0, 1.0)


# How an amount rises from 0 to 1: C2, C1 (the ADAMS ``STEP``), C0.
SHAPES = {"smooth": smooth_rise, "step": smooth_step, "linear": _line}


def progress(t: ArrayLike, over: ArrayLike) -> Array:
    """Time over that of a rise; of none, 0 before time 0 and 1 from then on."""
    sudden = jnp.asarray(over) == 0
    return jnp.where(sudden, 1.0 * (jnp.asarray(t) >= 0), t / jnp.where(sudden, 1.0, over))


def risen(shape: str, fraction: ArrayLike) -> Array:
    """Integral of a shape from 0 to s = min(fraction, 1), a polynomial."""
    s = _line(fraction)
    if shape == "smooth":
        return s**4 * (2.5 + s * (s - 3.0))
    return s**3 * (1.0 - 0.5 * s) if shape == "step" else 0.5 * s * s


def checked_shape(where: str, shape: Any) -> None:
    """Refuse a shape that is not known."""
    one_of(where, "shape", shape, SHAPES)


def checked_table(where: str, table: Any, least: int = 2, what: str = "times") -> Table:
    """A table as two rows of plain numbers."""
    remedy = f"give [[{what}], [values]]"
    try:
        knots, values = (np.asarray(row, dtype=float) for row in table)
    except (TypeError, ValueError):
        raise InputError(where, f"{quoted(table)} is no table", remedy) from None
    if knots.ndim != 1 or knots.shape != values.shape or knots.size < least:
        raise InputError(where, f"{knots.size} {what} beside {values.size} values", f"{remedy}, {least} or more")
    if not (np.isfinite(knots).all() and np.isfinite(values).all()):
        raise InputError(where, "its numbers are not finite", "give finite numbers")
    late = np.flatnonzero(np.diff(knots) <= 0)
    if late.size:
        k = int(late[0])
        unit = " s" if what == "times" else ""
        found = f"its {what} do not increase: {what[:-1]} {k + 2} is {knots[k + 1]:g}{unit} after {knots[k]:g}{unit}"
        raise InputError(where, found, f"give {what} that increase")
    return tuple(knots.tolist()), tuple(values.tolist())


def given_table(where: str, table: Any, what: str = "times") -> Table | None:
    """``checked_table`` of a table that may be None."""
    refuse_traced(where, table)
    return None if table is None else checked_table(where, table, what=what)


def given_breaks(times: Any) -> tuple[float, ...] | None:
    """Times of breaks as floats [s]; None for none that are given."""
    try:
        return None if times is None else tuple(map(float, times))
    except (TypeError, ValueError):
        raise InputError("breaks", f"{quoted(times)} are no times", "give a list of times [s], or None") from None


def looked_up(t: ArrayLike, table: Table) -> Array:
    """A table's value at a time, linear between its points and constant beyond."""
    return jnp.interp(jnp.asarray(t), jnp.asarray(table[0]), jnp.asarray(table[1]))


def area(t: Array, table: Table) -> Array:
    """Integral of ``looked_up`` from time 0 to t."""
    knots, values = (np.asarray(row) for row in table)
    sums = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(knots))])

    def until(t: ArrayLike) -> Array:
        inside = jnp.clip(t, knots[0], knots[-1])
        i = jnp.clip(jnp.searchsorted(jnp.asarray(knots), inside, side="right") - 1, 0, knots.size - 2)
        first = jnp.asarray(values)[i]
        found = jnp.asarray(sums)[i] + 0.5 * (first + looked_up(inside, table)) * (inside - jnp.asarray(knots)[i])
        return found + (t - inside) * jnp.where(t > inside, values[-1], values[0])

    return until(t) - until(0.0)


class Programme(eqx.Module):
    """An amount A(t) = r(t) (size + amplitude sin(2 pi frequency t)), or size times a table's value.

    r(t) = s(t/ramp), and with a reversal  r(t) = s(t/ramp) (1 - 2 s((t - reversal)/reversal_ramp)).
    """

    size: Size = eqx.field(static=True, default=None)  # what it rises to; None with a table of absolute values
    ramp: Size = eqx.field(static=True, default=None)  # rise time [s]; None: there from the start
    shape: str = eqx.field(static=True, default="smooth")  # s, a name of ``SHAPES``
    # Times [s] and values, linear between them, constant beyond.
    table: Table | None = eqx.field(static=True, default=None)
    # amplitude, frequency: of a fluctuation [Hz]; None for none.
    amplitude: Size = eqx.field(static=True, default=None)
    frequency: Size = eqx.field(static=True, default=None)
    # reversal, reversal_ramp: when the amount begins to change its sign, and over what time [s]; None for never.
    reversal: Size = eqx.field(static=True, default=None)
    reversal_ramp: Size = eqx.field(static=True, default=None)

    def __call__(self, t: Array, name: str, p: Params) -> Number:
        """The amount; ``name`` is the load's."""
        if self.table is not None:
            share = looked_up(t, self.table)
            return share if self.size is None else times(share, sizes.value(self.size, name, "size", p))
        size, share = sizes.value(self.size, name, "size", p), self.share(t, name, p)
        if self.amplitude is not None:
            turns = sizes.value(self.frequency, name, "frequency", p) * t
            size = plus(size, times(sizes.value(self.amplitude, name, "amplitude", p), jnp.sin(2.0 * jnp.pi * turns)))
        return times(share, size)

    def share(self, t: ArrayLike, name: str, p: Params) -> Number:
        """r(t)."""
        rise = SHAPES[self.shape]
        found = 1.0 if self.ramp is None else rise(progress(t, sizes.value(self.ramp, name, "ramp", p)))
        if self.reversal is not None:
            over = sizes.value(self.reversal_ramp, name, "reversal_ramp", p)
            found = times(found, 1.0 - 2.0 * rise(progress(t - sizes.value(self.reversal, name, "reversal", p), over)))
        return found

    def kinks(self, name: str, p: Params) -> list[ArrayLike]:
        """Times at which it bends [s]: knots of its table, ends of its ramp, begin and end of its reversal."""
        if self.table is not None:
            return [np.asarray(self.table[0])]
        found = [] if self.ramp is None else [sizes.value(self.ramp, name, "ramp", p)]
        if self.reversal is not None:
            begin = sizes.value(self.reversal, name, "reversal", p)
            found += [begin, begin + sizes.value(self.reversal_ramp, name, "reversal_ramp", p)]
        return found

    def parameters(self, name: str, unit: str) -> Parameters:
        if self.table is not None:
            what = f"what the table of {name} is multiplied by"
            return {} if self.size is None else sizes.own(self.size, name, "size", "1", what)
        found = sizes.own(self.size, name, "size", unit, f"size of {name}")
        for key, of, meaning in (
            ("ramp", "s", "time over which {} is raised"), ("amplitude", unit, "amplitude of the fluctuation of {}"),
            ("frequency", "Hz", "frequency of the fluctuation of {}"), ("reversal", "s", "when {} begins to change its sign"),
            ("reversal_ramp", "s", "time in which {} changes its sign"),
        ):  # fmt: skip
            if getattr(self, key) is not None:
                found |= sizes.own(getattr(self, key), name, key, of, meaning.format(name))
        return found
