"""``impact``: one mass strikes one surface head-on; ``bounce``: the same under gravity, many contacts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps import PointOnPlane
from bcfj_jax.core.vectors import Number
from bcfj_jax.mechanism.bodies import Body
from bcfj_jax.mechanism.contacts import Approach, Contact
from bcfj_jax.mechanism.loads import Gravity
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.mechanism.model import Params
from bcfj_jax.mechanism.scales import expected_scale
from bcfj_jax.models.steel_ball import STEEL_BALL, arriving, picked
from bcfj_jax.xla.programs import ask

# Contacts until the end of a run whose errors, all of one sign at worst, the tolerance already allows for.
_MANY = 5.0
# A flight of so many contacts' length shifts a force by no more than the tolerance allows for.
_RARE = 10.0


def impact(
    law: str = "memory_free",
    elastic: str | None = None,
    smoothing: bool = True,
    struck: bool = False,
    gravity: bool = False,
) -> Mechanism:
    """One mass strikes one surface head-on: one coordinate, the distance travelled towards the surface.

    Where the surface is that of a second body, which is free and at rest, ``struck`` gives it a coordinate and the mass
    ``struck_mass``: the force is that of the effective mass m M/(m + M), and either body's motion may be read. At time 0 the body
    is ``clearance_contact`` away, moving at ``approach_speed``. The force is (normal, 0, 0). The approach speed of 1.5 m/s
    is the paper's; the ball is ``steel_ball``'s.

    Args:
        law: name of a normal-force law (``laws.LAWS``).
        elastic: name of its elastic part (``laws.ELASTIC``).
        smoothing: whether the contact is regularised; False takes it out of the program.
        struck: whether the surface is on a free body, at rest at first.
        gravity: whether bodies weigh, towards the surface: ``gravity`` [m/s^2].
    """
    bodies = (Body("body", "slide", axis="x", mass="mass", start={"velocity": "approach_speed"}),)
    bodies += (Body("struck", "slide", axis="x", mass="struck_mass"),) if struck else ()
    pair = ("struck" if struck else "ground", "body")
    surface = Contact(
        "contact", pair, PointOnPlane("-x", clearance=True), law, elastic=elastic, smoothing=smoothing,
        approach="parameter",
    )  # fmt: skip
    given = picked({**STEEL_BALL, "clearance_contact": 0.0}, [*surface.reads, "mass", "clearance_contact"])
    given |= {"approach_speed": 1.5} | ({"struck_mass": STEEL_BALL["mass"]} if struck else {})
    given |= {"gravity": 9.81} if gravity else {}
    return Mechanism(
        "impact", bodies, (surface,), (Gravity("x"),) if gravity else (), given=given, end=_impact_end, samples=1001,
        more=_envelope, touch=_met,
    )  # fmt: skip


def _met(p: Mapping[str, float]) -> float | None:
    """First contact [s]: the clearance c at the approach speed v, 2 c/(v + sqrt(v^2 + 2 g c)) where a body alone falls."""
    gap, speed = p["clearance_contact"], p["approach_speed"]
    falling = 0.0 if "struck_mass" in p else p.get("gravity", 0.0)
    together = speed + float(np.sqrt(max(speed * speed + 2.0 * falling * gap, 0.0)))
    return 2.0 * gap / together if together > 0 else None


def _impact_end(p: Params) -> Array:
    mass = p["mass"] * p["struck_mass"] / (p["mass"] + p["struck_mass"]) if "struck_mass" in p else p["mass"]
    return arriving(STEEL_BALL, p, mass, p["approach_speed"])


class _Fall(Approach):
    """The speed at the next touch, sqrt(v^2 + 2 g h), is constant all through a flight: it is smooth at touch."""

    def first(self, gap: Number, rate: Number, p: Params) -> Array:
        """A mass let go on the surface has had no flight: it moves as quickly as falling by its sag.

        A restitution law with an approach speed of 0 would be rigid. The first flight, if there is one, forgets this.
        """
        return jnp.sqrt(jnp.square(_fall(gap, rate, p)) + 2.0 * p["gravity"] * _sag(p))

    def learning(self, gap: Number, rate: Number, memory: Number, p: Params) -> Array:
        """A flight lasts 2 v/g: at 20 g/v only exp(-40) of the last impact is left, whatever the height."""
        target = _fall(gap, rate, p)
        return 20.0 * p["gravity"] / jnp.maximum(target, 1e-9) * (target - memory)


def _fall(gap: Number, rate: Number, p: Params) -> Array:
    return jnp.sqrt(jnp.square(rate) + 2.0 * p["gravity"] * jnp.maximum(gap, 0.0) + 1e-24)


def bounce(law: str = "memory_free", elastic: str | None = None, smoothing: bool = True) -> Mechanism:
    """One mass dropped on one surface under gravity, bouncing: one coordinate, the height of its lowest point.

    At time 0 it rests at ``drop_height``. The force is (normal, 0, 0). With a law stated by restitution the
    contact remembers its approach speed, flight by flight, so that e is the same at every bounce; the
    remembered speed forgets the last impact within the next flight. The surface is a thousand times softer than steel
    (a GUESS: rubber), so that contacts of a millisecond show among flights of a tenth of a second.

    Args:
        law, elastic, smoothing: as ``impact``.
    """
    body = Body("body", "slide", axis="y", mass="mass", start={"position": "drop_height"})
    surface = Contact(
        "contact", ("ground", "body"), PointOnPlane("y"), law, elastic=elastic, smoothing=smoothing, approach=_Fall()
    )
    given = picked(STEEL_BALL, [*surface.reads, "mass"])
    given |= {"drop_height": 0.1, "gravity": 9.81} | ({"stiffness": 1e7} if "stiffness" in given else {})
    return Mechanism(
        "bounce", (body,), (surface,), (Gravity("-y"),), given=given, end=_bounce_end, samples=10001,
        scale=_bounce_scale, more=_envelope, touch=_landed,
    )  # fmt: skip


def _landed(p: Mapping[str, float]) -> float | None:
    """First contact [s]: sqrt(2 h/g)."""
    return float(np.sqrt(2.0 * p["drop_height"] / p["gravity"])) if p["gravity"] > 0 else None


def _sag(p: Params) -> Array:
    """Penetration under the body's own weight [m], (m g/K)^(1/n); of conformal contacts its order of magnitude."""
    weight = p["mass"] * jnp.maximum(p["gravity"], 1e-9)
    exponent = p["exponent"] if "exponent" in p else jnp.asarray(1.0)
    if "stiffness" in p:
        return (weight / p["stiffness"]) ** (1.0 / exponent)
    if "reference_force" in p:
        return p["reference_penetration"] * (weight / p["reference_force"]) ** (1.0 / exponent)
    # K ~ E L/sqrt(dR), where that is less deep than the play.
    length = next(p[name] for name in ("contact_length", "radius", "radius_difference") if name in p)
    return (weight * jnp.sqrt(p["radius_difference"]) / (p["effective_modulus"] * length)) ** (2.0 / 3.0)


def _flight(p: Params) -> Array:
    """Time from a contact to the next [s]; a body let go on the surface falls by its sag."""
    return 2.0 * jnp.sqrt(2.0 * (p["drop_height"] + _sag(p)) / jnp.maximum(p["gravity"], 1e-9))


def _bounce_end(p: Params) -> Array:
    return 5.0 * jnp.sqrt(2.0 * p["drop_height"] / jnp.maximum(p["gravity"], 1e-9))


def _bounce_scale(scene: Mechanism, p: Params, end: Any) -> Array:
    """The expected impact's, less where contacts are many until ``end`` [s], or rare.

    Every rebound adds its error to the speed, and to the energy: twice the contacts ask for half of it. A speed that is
    wrong shifts the next touch by that part of a flight, and a force that lasts a thousandth of it is gone: errors go
    as flight over contact (benchmarks/solve/levels.py: to the power 0.99).
    """
    sizes = expected_scale(scene, p)
    flight = _flight(p)
    shorter = jnp.minimum(1.0, _MANY * flight / jnp.asarray(end)) * jnp.minimum(
        1.0, _RARE * _contact_time(sizes) / flight
    )
    return jnp.where(jnp.isinf(jnp.asarray(end)), sizes, sizes * shorter)


def _contact_time(sizes: Array) -> Array:
    """Duration [s] of an undamped contact, some three times its depth over its speed."""
    return 3.0 * sizes[0] / sizes[1]


def _envelope(scene: Mechanism, params: Params, times: np.ndarray) -> dict[str, float]:
    """Where a run lies among those on which the promised error was measured."""
    p = {name: float(value) for name, value in params.items()}
    sizes, flight = ask("envelope", _sizes, (scene,), (dict(params),))
    depth, speed, contact = float(sizes[0]), float(sizes[1]), 3.0 * float(sizes[0] / sizes[1])
    found = {"onset": p.get("smoothing", 0.0) / depth, "loss": _loss(p, depth, speed)}
    if "exponent" in p:
        found["exponent"] = p["exponent"]
    if "drop_height" not in p:
        return found | {"durations": float(times[-1]) / contact}
    return found | {"flights": float(times[-1]) / float(flight), "rarity": float(flight) / contact}


def _sizes(scene: Mechanism, params: Params) -> tuple[Array, Array]:
    return expected_scale(scene, params), _flight(params) if "drop_height" in params else jnp.zeros(())


def _loss(p: dict[str, float], depth: float, speed: float) -> float:
    if "restitution" in p:
        return 1.0 - p["restitution"]
    if "dashpot" in p:
        return p["dashpot"] * depth / (p["mass"] * speed)
    return p.get("damping", 0.0) * speed
