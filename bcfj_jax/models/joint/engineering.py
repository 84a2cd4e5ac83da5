"""What an engineer reads of the joint's contacts: pressure, patch and power loss, and where elastic laws are void.

Hertz (1881) at the highest normal force of each contact, from the joint's own radii whatever its stiffness is: ellipse of a
ball in a groove, circle of a ball on a flat window, sphere in a socket for pilots. Pressures are those of elastic bodies.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.programs import ask
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.coefficients import patch
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.models.joint.validity import LIMIT

# ISO 76: largest pressure of a ball's static load rating [Pa]; a lasting dent of 1e-4 of the ball's diameter.
ISO_76 = 4.2e9
UNITS = {"force": "N", "pressure": "Pa", "half_axes": "m", "power": "W"}


def _patches(scene: Joint, params: Params, forces: dict[str, Array]) -> dict[str, tuple[Array, Array, Array, Array]]:
    found = {}
    for name, force in forces.items():
        contact, radius = patch(scene, params, name)
        long, short = contact.half_axes(force)
        found[name] = (contact.peak_pressure(force), long, short, radius)
    return found


def of_the_contacts(scene: Joint, params: Params, run: Any) -> dict[str, Any]:
    """By contact: pressure and half-axes at the highest force, mean power lost to friction, and what is void.

    Args:
        scene, params: the joint's.
        run: a run of it; NaN where it failed is left out.

    Returns:
        By contact a dict with ``force``, ``pressure``, ``half_axes`` (long, short), ``power`` (all members', mean of
        the last two thirds) and ``void``, a sentence or ""; and ``units``.
    """
    forces = {name: jnp.asarray(np.nanmax(np.abs(run.force[name][..., 0]))) for name in run.force}
    patches = ask("joint's patches", _patches, (scene,), (dict(params), forces))
    late = run.times >= run.times[-1] / 3.0
    found: dict[str, Any] = {}
    for name, force in forces.items():
        pressure, long, short, radius = (float(x) for x in patches[name])
        drag = np.linalg.norm(run.force[name][..., 1:], axis=-1)
        rubbed = (drag * run.slip[name])[late] if name in run.slip else np.zeros(1)
        power = float(np.nanmean(rubbed.reshape(len(rubbed), -1).sum(axis=1)))
        # A clearance of 0 has no patch.
        void = _void(name, pressure, max(long, short) / radius) if np.isfinite(pressure) else "no clearance, no patch"
        halves = [max(long, short), min(long, short)]
        found[name] = {"force": float(force), "pressure": pressure, "half_axes": halves, "power": power, "void": void}
    return found | {"units": UNITS}


def _void(name: str, pressure: float, width: float) -> str:
    """Why the elastic theory of a contact does not hold, "" where it does."""
    parts = []
    if pressure > ISO_76:
        parts.append(f"{pressure / 1e9:.2g} GPa is above 4.2 GPa (ISO 76, ball contact): the surface yields")
    if width > LIMIT:
        parts.append(f"the patch is {width:.2g} of the radius, beyond {LIMIT:g}: too wide for Hertz")
    return "; ".join(parts)
