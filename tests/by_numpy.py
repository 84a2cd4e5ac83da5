"""Functions of JAX evaluated by NumPy: what is asked at one point is not worth compiling.

Run op by op, a function of some hundred kinds of operations compiles each of them; compiled as a whole, it costs more still.
"""

from __future__ import annotations

import functools

import jax
import numpy as np

from bcfj_jax.xla import host


def by_numpy(function, static=False):
    """The function, traced once for given shapes and evaluated by NumPy.

    Its arguments and results are pytrees of arrays; with ``static`` the first argument is structure. What NumPy does not
    know is compiled.
    """
    jitted = jax.jit(function, static_argnums=0 if static else None)
    traced = {}

    @functools.wraps(function)
    def run(*arguments):
        leaves, tree = jax.tree.flatten(arguments[static:])
        leaves = [np.asarray(x) for x in leaves]
        key = arguments[:static], tree, tuple((x.shape, x.dtype) for x in leaves)
        if key not in traced:
            traced[key] = jitted.trace(*arguments)
        try:
            found = host.evaluate(traced[key].jaxpr, leaves)
        except host.Unknown:
            return jax.tree.map(np.asarray, jitted(*arguments))
        return jax.tree.unflatten(jax.tree.structure(traced[key].out_info), found)

    return run
