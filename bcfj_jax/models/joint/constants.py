"""From the scene's parameters to what the equations of motion read, computed once a run.

Coefficients of each contact's laws: its own parameters, or the shared ones, or what the joint's geometry gives.

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

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact import stiffness as hertz
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import geometry
from bcfj_jax.models.joint.bands import LEAST, WIDTH, Bands
from bcfj_jax.models.joint.contacts import ContactLaws, Groove
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.scene import BODIES, FLAT, GROOVES, PILOTS, Joint, JointContact

# What the balls touch, in the order of every array over bodies, which has as many as the scene. The cage stands twice:
# for the faces and for the ends of its windows.
BALLS = ("seat_ball", "head_ball", "cage_ball", "cage_window_end")


class Constants(eqx.Module):
    """Numbers of one run, in the shapes in which they are used."""

    groove: Groove
    # ball_laws, pilot_laws: of each of the groups of contacts; coefficients side by side (m, 1).
    ball_laws: tuple[ContactLaws, ...]
    window_clearance: Array  # of faces, and of ends where there are any (m, 1); of unequal balls (balls, m, 1)
    pilot_laws: tuple[ContactLaws, ...]
    pilot_clearance: Array
    pilot_hollow: Array
    bands: Bands | None
    body_maps: Array  # of ``body_maps``
    axes: Array  # (2, 3) unit axes of seat and head; ``radial`` and ``tangent``: where track 0 lies at turn 0
    radial: Array
    tangent: Array
    bisector: Array  # normal of the bisecting plane
    ball_inverse_mass: Array  # (twist,) and coupling_inverse_mass (coupling,): inverse masses and inertias
    coupling_inverse_mass: Array
    # drive_stiffness, drive_damping: 0 of a prescribed drive.
    drive_stiffness: Array
    drive_damping: Array
    programmes: dict[str, Array]  # what drive and loads read
    beside: dict[str, Array] = eqx.field(default_factory=dict)  # what readings of it multiply (``mechanism.observed``)


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


def laws_of(scene: Joint, params: Params, name: str) -> ContactLaws:
    """The laws of a contact with its coefficients: its own where given, else the shared ones."""
    contact = scene.contact(name)
    smoothing = scene.coefficient(params, name, "smoothing") if scene.smoothing else None
    return ContactLaws(contact.law, contact.friction, coefficients(scene, params, name), smoothing)


def groups(scene: Joint, names: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Neighbours among contacts of the scene that are computed together: of one law, friction law and number of faces."""

    def kind(contact: JointContact) -> tuple[Any, ...]:
        return contact.law, contact.friction, contact.name in GROOVES and scene.track != "gothic"

    there = [scene.contact(name) for name in names if scene.has(name)]
    return [tuple(contact.name for contact in some) for _, some in itertools.groupby(there, kind)]


def laws_together(scene: Joint, params: Params, names: tuple[str, ...]) -> ContactLaws:
    """Laws of contacts of one kind with their coefficients side by side (m, 1)."""
    several = [laws_of(scene, params, name) for name in names]
    coefficients, smoothing = jax.tree.map(
        lambda *x: jnp.stack(x)[:, None], *((dict(laws.coefficients), laws.smoothing) for laws in several)
    )
    return ContactLaws(several[0].law, several[0].friction, coefficients, smoothing)


def body_maps(scene: Joint, axes: Array) -> Array:
    """Velocity and angular velocity of ``BODIES`` by the coupling's velocities, (m, 6, coupling).

    The cage once more where windows have ends (``BALLS``).
    """
    bodies = (*BODIES, "cage") if scene.has("cage_window_end") else BODIES
    maps = jnp.zeros((len(bodies), 6, scene.coupling))
    for index, body in enumerate(bodies):
        place, turn = scene.slices.get(body), scene.slices[f"{body}_turn"]
        if place is not None:
            maps = maps.at[index, :3, place].set(jnp.eye(3))
        if turn is not None:
            maps = maps.at[index, 3:, turn].set(jnp.eye(3) if body == "cage" else axes[index][:, None])
    return maps


def _groove(scene: Joint, p: Params) -> Groove:
    gothic = scene.track == "gothic"
    return Groove(
        radius=geometry.track_radius(p["pitch_radius"], p["offset"]),
        offset=jnp.stack([p["offset"], -p["offset"]]),
        side=jnp.array([1.0, -1.0]),
        flank=p["ball_radius"] * (2.0 * p["conformity"] - 1.0) if gothic else jnp.zeros(()),
        sine=jnp.sin(p["contact_angle"]) if gothic else jnp.zeros(()),
        cosine=jnp.cos(p["contact_angle"]) if gothic else jnp.ones(()),
        clearance=jnp.stack([scene.clearance(p, name) for name in GROOVES], -1),
        ball=p["ball_radius"],
        gothic=jnp.array([1.0, -1.0]) if gothic else jnp.array([0.0]),
    )


def _of_balls(scene: Joint, p: Params) -> dict[str, Any]:
    """Laws and clearances of the balls' contacts."""
    flat = [scene.clearance(p, name) for name in FLAT if scene.has(name)]
    clearance = jnp.stack(flat, -1)[..., None] if flat else jnp.zeros(0)
    laws = tuple(laws_together(scene, p, names) for names in groups(scene, BALLS))
    return {"ball_laws": laws, "window_clearance": clearance}


def _of_pilots(scene: Joint, p: Params) -> dict[str, Any]:
    """Laws and sizes of the pilots."""
    if not scene.pilots:
        return {"pilot_laws": (), "pilot_clearance": jnp.zeros(0), "pilot_hollow": jnp.zeros(0), "bands": None}
    each = {name: p[f"clearance_{name}"] for name in scene.pilots}
    clearance, bands = jnp.stack(list(each.values())), None
    hollow = {"seat_cage": p["seat_radius"], "head_cage": p["head_radius"] + each.get("head_cage", 0.0)}
    if scene.banded:
        lever = {"seat_cage": -p["seat_radius"], "head_cage": p["head_radius"]}
        band, levers = p["pilot_band"], jnp.stack([lever[name] for name in scene.pilots])
        bands = Bands(jnp.sin(band), jnp.cos(band), WIDTH * clearance + LEAST, clearance, levers)
    return {
        "pilot_laws": tuple(laws_together(scene, p, names) for names in groups(scene, PILOTS)), "pilot_clearance": clearance,
        "pilot_hollow": jnp.stack([hollow[name] for name in scene.pilots]), "bands": bands,
    }  # fmt: skip


def _inverse_masses(scene: Joint, p: Params) -> tuple[Array, Array]:
    """Of a ball (twist,) and of the coupling coordinates (coupling,)."""
    three = jnp.ones(3)
    ball = three / p["ball_mass"]
    if scene.spin:
        # A solid sphere: 2/5 m r^2.
        ball = jnp.concatenate([ball, 2.5 / (p["ball_mass"] * p["ball_radius"] ** 2) * three])
    parts = {"head": three / p["head_mass"], "head_turn": 1.0 / p["head_inertia"][None]}
    if scene.cage == "free":
        parts |= {"cage": three / p["cage_mass"], "cage_turn": three / p["cage_inertia"]}
    parts["seat_turn"] = 1.0 / p["seat_inertia"][None] if scene.drive == "flexible" else jnp.zeros(1)
    return ball, scene.coupled(parts)


def constants(scene: Joint, params: Params) -> Constants:
    """Everything ``system`` reads, from the parameters [SI]."""
    p, zero = params, jnp.zeros(())
    angle, flexible = p["joint_angle"], scene.drive == "flexible"
    axes = jnp.stack([jnp.array([0.0, 0.0, 1.0]), geometry.head_axis(angle)])
    ball, coupling = _inverse_masses(scene, p)
    return Constants(
        groove=_groove(scene, p),
        body_maps=body_maps(scene, axes),
        axes=axes,
        radial=jnp.stack([jnp.array([1.0, 0.0, 0.0]), jnp.stack([jnp.cos(angle), zero, -jnp.sin(angle)])]),
        tangent=jnp.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]),
        bisector=geometry.bisector(angle),
        ball_inverse_mass=ball,
        coupling_inverse_mass=coupling,
        drive_stiffness=p["drive_stiffness"] if flexible else zero,
        drive_damping=p["drive_damping"] if flexible else zero,
        programmes={n: p[n] for n in ("drive_speed", "load_torque", "axial_load", *scene.programmes.names)},
        **_of_balls(scene, p),
        **_of_pilots(scene, p),
    )
