"""What an engineer reads of the joint's contacts: pressure, patch and power loss, and where elastic laws are void.

Hertz (1881) at the highest normal force of each contact, from the joint's own radii whatever its stiffness is: ellipse of a
ball in a groove, circle of a ball on a flat window, sphere in a socket for pilots. Pressures are those of elastic bodies.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.stiffness import EllipticContact, ball_in_groove, elliptic_contact
from bcfj_jax.core.programs import ask
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import geometry
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.scene import GROOVES, Joint

# ISO 76: largest pressure of a ball's static load rating [Pa]; a lasting dent of 1e-4 of the ball's diameter.
ISO_76 = 4.2e9
# Half-axis of a patch over the radius of the ball or inner sphere, up to which Hertz's parabola holds to 7 %.
WIDEST = 0.3
UNITS = {"force": "N", "pressure": "Pa", "half_axes": "m", "power": "W"}


def contact_shape(scene: Joint, p: Mapping[str, Array], name: str) -> tuple[EllipticContact, Array]:
    """Hertz contact of one of the joint's contacts, and the radius [m] that its patch must be small against."""
    modulus = p.get("effective_modulus", jnp.asarray(DEFAULTS["effective_modulus"][0]))
    ball = p["ball_radius"]
    if name in GROOVES:
        track = geometry.track_radius(p["pitch_radius"], p["offset"])
        if scene.track == "gothic":
            angle, conformity = p["contact_angle"], p["conformity"]
        else:
            # Under torque the ball of a circular groove bears at its flank, in a section wider by the clearance.
            angle, conformity = jnp.asarray(0.5 * jnp.pi), 0.5 + 0.5 * p[f"clearance_{name}"] / ball
        return ball_in_groove(modulus, ball, track, angle, conformity, name == "seat_ball"), ball
    if name in ("seat_cage", "head_cage"):
        play = p[f"clearance_{name}"]
        inner = p["seat_radius"] - play if name == "seat_cage" else p["head_radius"]
        radius = (inner + play) * inner / play
        return elliptic_contact(modulus, radius, radius), inner
    return elliptic_contact(modulus, ball, ball), ball


def _patches(scene: Joint, params: Params, forces: dict[str, Array]) -> dict[str, tuple[Array, Array, Array, Array]]:
    found = {}
    for name, force in forces.items():
        shape, radius = contact_shape(scene, params, name)
        long, short = shape.half_axes(force)
        found[name] = (shape.peak_pressure(force), long, short, radius)
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
    if width > WIDEST:
        parts.append(f"the patch is {width:.2g} of the radius, beyond {WIDEST:g}: too wide for Hertz")
    return "; ".join(parts)
