"""A chaotic scene for tests: a ball bouncing without loss on a floor of bumps, which defocus it."""

from __future__ import annotations

import jax.numpy as jnp

from bcfj_jax import laws
from bcfj_jax.mechanism.scene import Body, Contact, Load, Scene


def _gap(q, params):
    del params
    return q[1] - 0.02 * jnp.cos(20.0 * q[0])


def _weight(params):
    return jnp.stack([jnp.zeros(()), -params["mass"] * params["gravity"]])


def _start(params):
    return jnp.stack([jnp.asarray(0.013), params["drop_height"]]), jnp.zeros(2)


def _scale(params):
    return params["mass"], jnp.sqrt(2.0 * params["gravity"] * params["drop_height"])


def _horizon(params):
    del params
    return jnp.asarray(8.0)


def bumps() -> Scene:
    """Bumps of 20 mm, 0.3 m apart, under a drop of 0.3 m."""
    defaults = {"stiffness": 1e5, "exponent": 1.5, "mass": 0.02, "gravity": 9.81, "drop_height": 0.3}
    return Scene(
        kind="bumps",
        bodies=(Body("body", coordinates=2),),
        contacts=(Contact("contact", _gap, laws.make("hertz"), False),),
        loads=(Load("weight", _weight, ("gravity",)),),
        needs=("drop_height",),
        defaults=tuple(defaults.items()),
        start=_start,
        impact_scale=_scale,
        horizon=_horizon,
    )
