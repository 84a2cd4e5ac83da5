"""Balls that are not alike: an oversize of each ball's radius, an extra clearance of each of its contacts.

Ball i, counted from 1 as in ``seat_ball_2``, has in a contact of its own the clearance

    clearance_<contact> + <contact>_<i>.extra_clearance - ball_<i>.oversize

which may be negative: such a ball is pressed in. The oversize d counts in full in grooves, whose flanks are where they
were, and at both planes of a window. Masses, levers and stiffnesses remain those of ``ball_radius``: of d/ball_radius.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.scene import Joint, ball_sizes


def clearance(scene: Joint, params: Params, name: str) -> Array:
    """Clearance of every ball in one of its contacts: (balls,) [m] of unequal balls, else a scalar."""
    shared = params[f"clearance_{name}"]
    if not scene.unequal:
        return shared
    oversize, extra = (jnp.stack([params[key] for key in keys]) for keys in ball_sizes(scene.balls, name))
    return shared + extra - oversize
