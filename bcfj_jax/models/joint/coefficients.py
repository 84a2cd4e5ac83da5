"""Coefficients of each contact's laws: its own parameters, or the shared ones, or what the joint's geometry gives.

A contact is that of a ball or sphere of radius R_b in a hollow of radius R_s, or on a flat:

| contact                    | R_b                | R_s                                | K of F = K d^1.5                      |
|----------------------------|--------------------|------------------------------------|---------------------------------------|
| seat_cage                  | R_s less clearance | seat_radius                        | Lankarani-Nikravesh, sphere in socket |
| head_cage                  | head_radius        | R_b and clearance                  | the same                              |
| seat_ball, head_ball       | ball_radius        | of the groove's section, see below | elliptic Hertz, ball in a torus       |
| cage_ball, cage_window_end | ball_radius        | flat                               | Hertz, sphere on plane                |

The section of a groove is the circle of radius  R_s = R_b + q + clearance  to which ``contacts.grooves`` measures a
flank, q = ball_radius (2 conformity - 1); of a circular track q is 0. Along the track its curvature is that of the
centre circle, at the contact angle; in a circular track torque takes a ball to 90 degrees (physics sheet 5.3). An
elastic part for conformal contacts reads ``radius`` R_s (R_b on a flat) and ``radius_difference`` R_s - R_b: so
clearance moves its stiffness.

All are formulas of ``contact.stiffness`` for contacts small against R_b; ``engineering`` says where a run leaves that.
Single balls' sizes (``Joint.clearance``) do not enter: 10 um of a radius of 8 mm change K by less than 2 %.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact import stiffness as hertz
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import geometry
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.scene import FLAT, PILOTS, Joint


def coefficients(scene: Joint, params: Params, name: str) -> dict[str, Array]:
    """What the laws of a contact read, by name, SI."""
    contact = scene.contact(name)
    derived = {
        "radius": radius,
        "radius_difference": radius_difference,
        "stiffness": stiffness,
        "exponent": lambda *_: jnp.asarray(1.5),
    }
    return {
        key: derived[key](scene, params, name) if key in contact.derived else scene.coefficient(params, name, key)
        for key in contact.needs
    }


def radius_difference(scene: Joint, params: Params, name: str) -> Array:
    """R_s - R_b [m] of a contact that is not flat."""
    play = params[f"clearance_{name}"]
    if name in PILOTS or scene.track != "gothic":
        return play
    return params["ball_radius"] * (2.0 * params["conformity"] - 1.0) + play


def radius(scene: Joint, params: Params, name: str) -> Array:
    """R_s [m]; R_b of a flat contact."""
    if name == "seat_cage":
        return params["seat_radius"]
    inner = params["head_radius"] if name in PILOTS else params["ball_radius"]
    return inner if name in FLAT else inner + radius_difference(scene, params, name)


def modulus(scene: Joint, params: Params, name: str) -> Array:
    """E* [Pa]: a parameter where a stiffness is geometric, else that of steel on steel."""
    if scene.contact(name).geometric:
        return scene.coefficient(params, name, "effective_modulus")
    return jnp.asarray(DEFAULTS["effective_modulus"][0])


def groove(scene: Joint, params: Params, name: str) -> hertz.EllipticContact:
    """Hertz contact of a ball with one flank."""
    ball = params["ball_radius"]
    angle = params["contact_angle"] if scene.track == "gothic" else jnp.asarray(0.5 * jnp.pi)
    along = geometry.track_radius(params["pitch_radius"], params["offset"])
    conformity = 0.5 * radius(scene, params, name) / ball
    return hertz.ball_in_groove(modulus(scene, params, name), ball, along, angle, conformity, name == "seat_ball")


def patch(scene: Joint, params: Params, name: str) -> tuple[hertz.EllipticContact, Array]:
    """Hertz contact of any of the joint's contacts, whatever its stiffness is, and R_b [m], which a patch is small against."""
    ball = params["ball_radius"]
    if name not in FLAT and name not in PILOTS:
        return groove(scene, params, name), ball
    relative = ball
    if name in PILOTS:
        outer, apart = radius(scene, params, name), radius_difference(scene, params, name)
        ball = outer - apart
        relative = outer * ball / apart
    return hertz.elliptic_contact(modulus(scene, params, name), relative, relative), ball


def stiffness(scene: Joint, params: Params, name: str) -> Array:
    """K [N/m^1.5] from geometry; infinite or NaN without a radius difference, which ``checks`` refuses."""
    if name not in FLAT and name not in PILOTS:
        return groove(scene, params, name).stiffness
    elastic = modulus(scene, params, name)
    if name in FLAT:
        return hertz.sphere_plane(elastic, params["ball_radius"])
    outer = radius(scene, params, name)
    return hertz.sphere_in_socket(elastic, outer, outer - radius_difference(scene, params, name))
