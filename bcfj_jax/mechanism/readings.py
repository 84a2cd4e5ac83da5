"""What a contact is doing, from what an instrument reads of it: apart, touching, creeping, sliding or stuck."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # It imports JAX, which who only writes files does not need.
    from bcfj_jax.mechanism.model import AbstractModel, Params, Reading

APART, TOUCHING, CREEPING, SLIDING, STUCK = range(5)
STATES = ("apart", "touching", "creeping", "sliding", "stuck")
UNKNOWN = -1
# Bristles that bear less than this share of the friction of steady slip hold; in steady slip they bear all of it, to
# within the error of a run.
_HELD = 0.97
# Friction of steady slip is read at this share of the transition speed or above: at rest its coefficient is rounded to 0.
_SLOW = 0.1


def contact_state(
    normal: np.ndarray,
    slip: np.ndarray | None = None,
    transition: float | None = None,
    held: np.ndarray | None = None,
) -> np.ndarray:
    """What a contact is doing, as codes that count ``STATES``, of the shape of its normal force; ``UNKNOWN`` where NaN.

    Apart: no normal force, because damping lets go in a rebound or for a gap; the regularisation bears a little across
    a gap, which the caller takes out. Touching: a force, without friction. With friction: creeping
    where it slides slower than friction's transition speed (energy is dissipated, however slow it is), sliding from
    there on. Stuck: slower than that, and held by bristles.

    Args:
        normal: normal force [N] of either sign.
        slip, transition: sliding speed and friction's transition speed [m/s]; none without friction.
        held: whether bristles bear the load; none for a law without.
    """
    state = np.where(normal == 0.0, APART, TOUCHING)
    unknown = np.isnan(normal)
    if slip is not None and transition is not None:
        slow = CREEPING if held is None else np.where(held, STUCK, CREEPING)
        state = np.where(state == APART, APART, np.where(slip < transition, slow, SLIDING))
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
        held = None
        if friction is not None and friction.bristles and slip is not None:
            c = {name: model.coefficient(params, contact.name, name) for name in friction.needs}
            force = np.asarray(reading.force)
            faster = np.maximum(slip, 0.0 if transition is None else _SLOW * transition)
            sliding = np.asarray(friction.coefficient(faster, c)) * np.abs(force[..., 0])
            held = (slip == 0.0) | (np.hypot(force[..., 1], force[..., 2]) < _HELD * sliding)
        found[contact.name] = contact_state(pressed(reading), slip, transition, held)
    return found
