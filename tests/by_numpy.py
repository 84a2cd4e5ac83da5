"""Functions of JAX evaluated by NumPy: what is asked at one point is not worth compiling.

Run op by op, a function of some hundred kinds of operations compiles each of them; compiled as a whole, it costs more still.
"""

from __future__ import annotations

import jax
import numpy as np

from bcfj_jax.core import host


def by_numpy(function):
    """The function, traced and evaluated by NumPy; its arguments and results are pytrees of arrays."""

    def run(*arguments):
        known = jax.jit(function).trace(*arguments)
        found = host.evaluate(known.jaxpr, [np.asarray(x) for x in jax.tree.leaves(arguments)])
        return jax.tree.unflatten(jax.tree.structure(known.out_info), found)

    return run
