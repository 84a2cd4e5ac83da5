"""The peaks that the calibration reads, of the quasistatic joint without friction, with exact derivatives.

Two small programs instead of one large one, which takes minutes to compile: the search for equilibrium, and forces as
functions of the parameters about the places found, by the implicit function theorem. Neither computes velocities.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.stiffness import sphere_in_socket
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.model import joint_of_keys
from bcfj_jax.models.joint.quasistatic import Found, quasistatic_forces, quasistatic_places
from bcfj_jax.models.joint.scene import PLAIN, Joint

# The numbers fitted, in this order, and the claims they are of; Q23 is a range, and so two numbers.
TARGETS = ("Q20", "Q21", "Q23 least", "Q23 greatest", "Q26", "Q27")
_INSTANTS = 24


def still_scene() -> Joint:
    """The joint of the calibration: equilibrium at each instant, no friction."""
    return joint_of_keys(fidelity="quasistatic", friction=False, **PLAIN)


def tied(params: Params, free: Params) -> Params:
    """``free`` with the stiffness of each pilot whose clearance is in it: Lankarani and Nikravesh's of that clearance."""
    modulus, found = DEFAULTS["effective_modulus"][0], dict(free)
    if "clearance_seat_cage" in free:
        play, seat = free["clearance_seat_cage"], params["seat_radius"]
        found["seat_cage.stiffness"] = sphere_in_socket(modulus, seat, seat - play)
    if "clearance_head_cage" in free:
        play, head = free["clearance_head_cage"], params["head_radius"]
        found["head_cage.stiffness"] = sphere_in_socket(modulus, head + play, head)
    return found


def instants(params: Params, balls: int) -> np.ndarray:
    """Times over one passage of a ball [s], well past the load ramp: equal balls repeat what the joint does."""
    turn = 2.0 * np.pi / float(params["drive_speed"])
    first = turn * np.ceil(2.0 * float(params["load_ramp"]) / turn)
    return first + turn / balls * np.arange(_INSTANTS) / _INSTANTS


def _peaks(scene: Joint, params: Params, times: Array, found: Found) -> Array:
    force = quasistatic_forces(scene, params, times, found)
    window = force["cage_ball"]
    seat, head, into, out = (jnp.max(force[n]) for n in ("seat_cage", "head_cage", "seat_ball", "head_ball"))
    return jnp.stack([seat, head, jnp.min(window), jnp.max(window), into, out])


@eqx.filter_jit
def _slopes(scene: Joint, params: Params, free: Params, times: Array, found: Found) -> tuple[Array, Params]:
    def at(free: Params) -> tuple[Array, Array]:
        peaks = _peaks(scene, {**params, **tied(params, free)}, times, found)
        return peaks, peaks

    slopes, peaks = jax.jacfwd(at, has_aux=True)(free)
    return peaks, slopes


def peaks(scene: Joint, params: Params, free: Params) -> tuple[np.ndarray, dict[str, np.ndarray], bool]:
    """The numbers of ``TARGETS`` [N], their derivatives by each parameter in ``free``, and whether equilibrium was found.

    Those in ``free`` replace the ones in ``params``; stiffnesses follow (``tied``).
    """
    times = jnp.asarray(instants(params, scene.balls))
    free = {name: jnp.asarray(value, dtype=float) for name, value in free.items()}
    found = quasistatic_places(scene, {**params, **tied(params, free)}, times)
    values, slopes = _slopes(scene, dict(params), free, times, found)
    good = bool(jnp.all(found.converged)) and bool(jnp.all(jnp.isfinite(values)))
    return np.asarray(values), {name: np.asarray(slope) for name, slope in slopes.items()}, good
