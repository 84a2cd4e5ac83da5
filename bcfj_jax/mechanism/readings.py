"""What a contact is doing, from what an instrument reads of it: apart, touching, sticking or sliding. On the host."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bcfj_jax.mechanism.model import AbstractModel, Params, Reading

APART, TOUCHING, STICKING, SLIDING = range(4)
STATES = ("apart", "touching", "sticking", "sliding")
UNKNOWN = -1


def contact_state(normal: np.ndarray, slip: np.ndarray | None = None, transition: float | None = None) -> np.ndarray:
    """What a contact is doing, as codes that count ``STATES``, of the shape of its normal force; ``UNKNOWN`` where NaN.

    Apart: no normal force, because damping lets go in a rebound or for a gap; the regularisation bears a little across
    a gap, which the caller takes out. Touching: a force, without friction. With friction: sticking
    where it slides slower than friction's transition speed (these laws creep under load, so nothing ever stands),
    sliding from there on.

    Args:
        normal: normal force [N] of either sign.
        slip, transition: sliding speed and friction's transition speed [m/s]; none without friction.
    """
    state = np.where(normal == 0.0, APART, TOUCHING)
    unknown = np.isnan(normal)
    if slip is not None and transition is not None:
        state = np.where(state == APART, APART, np.where(slip < transition, STICKING, SLIDING))
        unknown = unknown | np.isnan(slip)
    return np.where(unknown, UNKNOWN, state).astype(np.int8)


def pressed(reading: Reading) -> np.ndarray:
    """Normal force where surfaces overlap: what the regularisation bears across a gap is numerical."""
    return np.where(np.asarray(reading.penetration) < 0, 0.0, np.asarray(reading.force)[..., 0])


def contact_states(model: AbstractModel, params: Params, readings: Mapping[str, Reading]) -> dict[str, np.ndarray]:
    """``contact_state`` of every contact, from what ``observe`` read; of its deepest face.

    A model without a history knows no friction: what presses is touching.
    """
    found = {}
    for contact in model.contacts:
        reading, friction = readings[contact.name], contact.friction if model.traits.history else None
        rubs = friction is not None and "friction_speed" in friction.needs
        transition = float(model.coefficient(params, contact.name, "friction_speed")) if rubs else None
        slip = None if reading.slip is None else np.asarray(reading.slip)
        found[contact.name] = contact_state(pressed(reading), slip, transition)
    return found
