"""The built-in scenes. Default numbers are the BCFJ's: a 16 mm steel ball meeting a flat steel face.

E = 207 GPa and nu = 0.29 are the paper's; the ball's size is the group's published key size; mass and
stiffness follow from them (physics sheet 1.4: ball on flat window 1.3476e10 N/m^1.5); the approach
speed is the paper's 1.5 m/s. The damping is a GUESS (e = 0.9 at that speed), as it is nowhere stated.
``bounce`` has the same ball on a surface a thousand times softer (a GUESS: rubber), so that its contacts of a
millisecond show among flights of a tenth of a second. The numbers of ``joint`` are in ``joint.defaults``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact import laws as normal_laws
from bcfj_jax.contact.restitution import undamped_duration
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.mechanism.scene import Body, Contact, Load, Scene
from bcfj_jax.models.joint.model import joint

_STEEL_BALL = {
    "stiffness": 1.3476e10,
    "exponent": 1.5,
    "reference_force": 1.3476e10 * 2e-5**1.5,
    "reference_penetration": 2e-5,
    "bottoming_stiffness": 1e9,
    "bottoming_penetration": 2e-5,
    "bottoming_width": 2e-6,
    "bottoming_damping": 0.111,
    "effective_modulus": 113.0e9,
    "contact_length": 16e-3,
    "radius": 8e-3,
    "radius_difference": 50e-6,
    "damping": 0.111,
    "restitution": 0.9,
    "dashpot": 100.0,
    "damping_depth": 1e-4,
    "smoothing": 0.0,
    "mass": 0.016731,
}


def _approach_speed(q: Array, v: Array, params: Params) -> Array:
    del q, v
    return params["approach_speed"]


def _impact_gap(q: Array, params: Params) -> Array:
    return params["clearance_contact"] - q[0]


def _impact_start(params: Params) -> tuple[Array, Array]:
    return jnp.zeros(1), params["approach_speed"][None]


def _impact_scale(params: Params) -> tuple[Array, Array]:
    return params["mass"], params["approach_speed"]


def _impact_horizon(params: Params) -> Array:
    # Flight to the surface and one and a half undamped contacts; a scene without K d^n gets the ball's.
    stiffness = params.get("stiffness", jnp.asarray(_STEEL_BALL["stiffness"]))
    exponent = params.get("exponent", jnp.asarray(1.0))
    speed = jnp.maximum(params["approach_speed"], 1e-6)
    contact = undamped_duration(stiffness, exponent, params["mass"], speed)
    return params["clearance_contact"] / speed + 1.5 * contact


def impact(law: str = "memory_free", elastic: str | None = None, smoothing: bool = True) -> Scene:
    """One mass strikes one surface head-on: one coordinate, the distance travelled towards the surface.

    Two free bodies are the same scene with the effective mass and the closing speed. At time 0 the body
    is ``clearance_contact`` away, moving at ``approach_speed``. The force is (normal, 0, 0).

    Args:
        law: name of a normal-force law (``laws.LAWS``).
        elastic: name of its elastic part (``laws.ELASTIC``).
        smoothing: whether the onset of penetration can be smoothed; False takes it out of the program.
    """
    contact = Contact("contact", _impact_gap, normal_laws.make(law, elastic), smoothing, _approach_speed)
    return Scene(
        kind="impact",
        bodies=(Body("body"),),
        contacts=(contact,),
        loads=(),
        needs=("approach_speed", "clearance_contact"),
        defaults=tuple({**_STEEL_BALL, "approach_speed": 1.5, "clearance_contact": 0.0}.items()),
        start=_impact_start,
        impact_scale=_impact_scale,
        horizon=_impact_horizon,
        samples=1001,
    )


def _bounce_gap(q: Array, params: Params) -> Array:
    del params
    return q[0]


def _bounce_start(params: Params) -> tuple[Array, Array]:
    return params["drop_height"][None], jnp.zeros(1)


def _weight(params: Params) -> Array:
    return -(params["mass"] * params["gravity"])[None]


def _fall_speed(q: Array, v: Array, params: Params) -> Array:
    # The speed at the next touch is constant all through a flight, so remembering it is smooth at touch.
    return jnp.sqrt(jnp.square(v[0]) + 2.0 * params["gravity"] * jnp.maximum(q[0], 0.0) + 1e-24)


def _sag(params: Params) -> Array:
    """Penetration under the body's own weight [m], (m g/K)^(1/n); of conformal contacts its order of magnitude."""
    weight, exponent = params["mass"] * jnp.maximum(params["gravity"], 1e-9), params.get("exponent", jnp.asarray(1.0))
    if "stiffness" in params:
        return (weight / params["stiffness"]) ** (1.0 / exponent)
    if "reference_force" in params:
        return params["reference_penetration"] * (weight / params["reference_force"]) ** (1.0 / exponent)
    # K ~ E L/sqrt(dR), where that is less deep than the play.
    length = params.get("contact_length", params.get("radius", params["radius_difference"]))
    return (weight * jnp.sqrt(params["radius_difference"]) / (params["effective_modulus"] * length)) ** (2.0 / 3.0)


def _first_speed(q: Array, v: Array, params: Params) -> Array:
    # A mass let go on the surface has had no flight. It moves as quickly as falling by its sag; a restitution law with
    # a speed of 0 would be rigid. The first flight, if there is one, forgets this.
    return jnp.sqrt(jnp.square(_fall_speed(q, v, params)) + 2.0 * params["gravity"] * _sag(params))


def _forget(approach: Array, params: Params) -> Array:
    # A flight lasts 2 v/g: 20 g/v leaves exp(-40) of the last impact, whatever the height.
    return 20.0 * params["gravity"] / jnp.maximum(approach, 1e-9)


def _bounce_scale(params: Params) -> tuple[Array, Array]:
    # A body let go on the surface falls by its sag.
    return params["mass"], jnp.sqrt(2.0 * params["gravity"] * (params["drop_height"] + _sag(params)))


def _bounce_flight(params: Params) -> Array:
    return 2.0 * jnp.sqrt(2.0 * (params["drop_height"] + _sag(params)) / jnp.maximum(params["gravity"], 1e-9))


def _bounce_horizon(params: Params) -> Array:
    return 5.0 * jnp.sqrt(2.0 * params["drop_height"] / jnp.maximum(params["gravity"], 1e-9))


def bounce(law: str = "memory_free", elastic: str | None = None, smoothing: bool = True) -> Scene:
    """One mass dropped on one surface under gravity, bouncing: one coordinate, the height of its lowest point.

    At time 0 it rests at ``drop_height``. The force is (normal, 0, 0). With a law stated by restitution the
    contact remembers its approach speed, flight by flight, so that e is the same at every bounce; the
    remembered speed forgets the last impact within the next flight.

    Args:
        law, elastic, smoothing: as ``impact``.
    """
    contact = Contact(
        "contact", _bounce_gap, normal_laws.make(law, elastic), smoothing, _fall_speed, _forget, _first_speed
    )
    return Scene(
        kind="bounce",
        bodies=(Body("body"),),
        contacts=(contact,),
        loads=(Load("weight", _weight, ("gravity",)),),
        needs=("drop_height",),
        defaults=tuple({**_STEEL_BALL, "stiffness": 1e7, "drop_height": 0.1, "gravity": 9.81}.items()),
        start=_bounce_start,
        impact_scale=_bounce_scale,
        horizon=_bounce_horizon,
        samples=10001,
        flight=_bounce_flight,
    )


SCENES: dict[str, Callable[..., AbstractModel]] = {"impact": impact, "bounce": bounce, "joint": joint}


def make(kind: str, **options: object) -> AbstractModel:
    """A built-in scene by name, with its options.

    Raises:
        InputError: for a kind or an option that does not exist, with the nearest that does.
    """
    if kind not in SCENES:
        raise InputError("scene", f"no scene '{kind}'", nearest(kind, SCENES))
    known = inspect.signature(SCENES[kind]).parameters
    for name, value in options.items():
        if name not in known:
            raise InputError(f"scene '{kind}'", f"no option '{name}' = {value}", nearest(name, known))
    return SCENES[kind](**options)
