"""The joint without a solve: zero-clearance motion, and the loads that statics of first order shares out.

Places are those of ``nominal``, which also is the start of every motion. Normal loads are of first order in the deflection:
within 10 % at 6 deg and 14 % at 10 deg, and a sketch beyond kappa = 1, where balls unload. There is no friction.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.numerics import bisected, positive, smooth_rise
from bcfj_jax.mechanism.model import Params, Reading
from bcfj_jax.models.joint import geometry
from bcfj_jax.models.joint.constants import laws_of
from bcfj_jax.models.joint.contacts import ContactLaws
from bcfj_jax.models.joint.scene import Flat, Joint

# Halvings of 10 m, down to 1e-20 m.
_HALVINGS = 70


def nominal(scene: Joint, params: Params, seat_turn: Array) -> Array:
    """Flat state of the zero-clearance joint at a seat angle, turning at the drive's first speed (physics sheet 5.2).

    Constant velocity: the head turns by the seat's angle, and so does the cage, centred on the bisector: balls swing
    evenly about the middles of their windows. Spinning balls turn with the cage.
    """
    p = params
    radius = geometry.track_radius(p["pitch_radius"], p["offset"])

    def centres(turn):
        return geometry.ball_centre(turn + scene.azimuths, p["joint_angle"], radius, p["offset"])

    speed = scene.programmes.start_speed(p)
    places, velocities = jax.jvp(centres, (seat_turn,), (speed,))
    axis, none, turn = geometry.bisector(p["joint_angle"]), jnp.zeros(3), seat_turn[None]
    at = {"head": none, "head_turn": turn, "cage": none, "cage_turn": axis, "seat_turn": turn}
    rate = {"head": none, "head_turn": speed[None], "cage": none, "cage_turn": speed * axis, "seat_turn": speed[None]}
    if scene.spin:
        velocities = jnp.concatenate([velocities, jnp.broadcast_to(speed * axis, (scene.balls, 3))], -1)
    others = jnp.zeros(scene.states - scene.moving)
    others = others if scene.azimuth is None else others.at[-1].set(seat_turn)
    return Flat(places, scene.coupled(at), velocities, scene.coupled(rate), others).whole()


def kinematic_states(scene: Joint, params: Params, times: Array) -> Array:
    """``nominal`` at the seat angle drive_speed t, (T, scene.states)."""
    seat = params["drive_speed"] * jnp.asarray(times, dtype=float)
    return jax.vmap(lambda angle: nominal(scene, params, angle))(seat)


def ball_loads(scene: Joint, params: Params, times: Array) -> tuple[Array, Array]:
    """Normal load of each ball on either track, and its force on the cage along the cage's axis, both (T, balls) [N].

    N_i ~ max(0, 1 - kappa sin(phi_i)), scaled so that the balls carry the torque,  sum N_i Rp sin(alpha) = T;  F_c
    is ``geometry.deflected_cage_load``. The head resists what the seat drives, so that azimuths are mirrored, unless the
    torque is negative. A circular track has no contact angle: 90 degrees, evenly shared. NaN for gothic tracks without
    offset.
    """
    p = params
    times = jnp.asarray(times, dtype=float)
    torque = p["load_torque"] * smooth_rise(times / p["load_ramp"])[:, None]
    azimuth = (p["drive_speed"] * times[:, None] + scene.azimuths) * jnp.where(p["load_torque"] < 0, 1.0, -1.0)
    radius = geometry.track_radius(p["pitch_radius"], p["offset"])
    if scene.track == "gothic":
        angle = p["contact_angle"]
        uneven = geometry.kappa(angle, p["joint_angle"], radius, p["offset"])
    else:
        angle, uneven = jnp.asarray(0.5 * jnp.pi), jnp.zeros(())
    share = 1.0 - uneven * jnp.sin(azimuth)
    share = jnp.where(jnp.isnan(share), share, positive(share))
    total = jnp.sum(share, 1, keepdims=True)
    # One ball alone may be left without load by the formula: it carries all the same.
    share = jnp.where(total == 0, 1.0, share) / jnp.where(total == 0, float(scene.balls), total)
    normal = jnp.abs(torque) * share / (p["pitch_radius"] * jnp.sin(angle))
    cage = geometry.deflected_cage_load(normal, azimuth, angle, p["joint_angle"], radius, p["offset"])
    return normal, cage


def kinematic_readings(scene: Joint, params: Params, times: Array) -> dict[str, Reading]:
    """What every contact of the scene does, by name, at each of T times.

    Force (T, balls, 3) of seat_ball, head_ball and cage_ball (signed: on the cage along its axis), (T, 3) of the
    pilots, which carry half of the cage's sum of forces each; axial and tangential force 0, and all of cage_window_end:
    without friction nothing drives the cage against its windows' ends. Penetration by the
    elastic law inverted at rest (0 where there is no load), rate 0.
    """
    normal, cage = ball_loads(scene, params, times)
    # Along the cage's axis: the edge of a band bears more than it holds up.
    pilot = 0.5 * jnp.abs(jnp.sum(cage, 1)) / (jnp.sin(params["pilot_band"]) if scene.banded else 1.0)
    loads = {"seat_ball": normal, "head_ball": normal, "cage_ball": cage, "seat_cage": pilot, "head_cage": pilot}
    loads["cage_window_end"] = jnp.zeros_like(normal)
    readings = {}
    for contact in scene.contacts:
        load = loads[contact.name]
        depth = penetration(laws_of(scene, params, contact.name), jnp.abs(load))
        none = jnp.zeros_like(load)
        readings[contact.name] = Reading(jnp.stack([load, none, none], -1), depth, none)
    return readings


def penetration(laws: ContactLaws, force: Array) -> Array:
    """Penetration [m] at which a contact at rest bears ``force`` [N]; 0 for none; NaN beyond what 10 m would give.

    Bisection, then one step of Newton, which carries the derivatives of the implicit function.
    """
    loaded = force > 0
    safe = jnp.where(loaded, force, 1.0)
    width = jnp.zeros(()) if laws.smoothing is None else laws.smoothing

    def law(laws: ContactLaws, depth: Array) -> Array:
        return laws.normal(depth, jnp.zeros_like(depth))

    still, target, width = jax.lax.stop_gradient((laws, safe, width))
    bracket = (jnp.zeros_like(target) - width, jnp.full_like(target, 10.0))
    depth = bisected(lambda depth: law(still, depth) >= target, bracket, _HALVINGS)[1]
    slope = jax.jvp(lambda d: law(still, d), (depth,), (jnp.ones_like(depth),))[1]
    # No slope is left of a force too small for the law's arithmetic.
    depth = depth - jnp.where(slope > 0, (law(laws, depth) - safe) / jnp.where(slope > 0, slope, 1.0), 0.0)
    within = jnp.isfinite(force) & (jax.lax.stop_gradient(depth) < 9.9)
    return jnp.where(within, jnp.where(loaded, depth, 0.0), jnp.nan)
