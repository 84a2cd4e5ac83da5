"""The one place where a contact's force is computed, for every mechanism.

A face (``contact.gaps``) has a penetration d, a direction n and a gate g; the bodies' relative velocity w at the point of
contact gives the rest:

    rate  d' = n . w        sliding  u = w - d' n        force on b  f = -N n - N (mu(|u|)/|u|) u

with N = g F(d, d') from the normal-force law (``contact.normal.regularised_force``). Friction with bristles, deflected by z,
has its force by their part in the contact plane,  b = z - n (n . z),  and they bend (``LuGre.bond`` has k, s and m):

    f = -N n - N (s b + m u)        z' = W x z + (1 - o) (u - k z) - o z/tau

W is the angular velocity with which the gap says that bristles turn (``AbstractGap.carried``). o rises from 0 to 1 over a gap
of 1 um beyond the regularisation and tau is 1e-5 s, so that nothing is remembered from one touch to the next. Friction that
lags (``friction.Memory``) has its mobility by the slip speed of late besides, a number that each face keeps.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.friction import AbstractFriction
from bcfj_jax.contact.gaps import Coefficients, Face
from bcfj_jax.contact.normal import GAP, AbstractLaw, regularised_force
from bcfj_jax.core.numerics import smooth_step
from bcfj_jax.core.vectors import ZERO, Number, Vector, add, cross, dot, minus, negative, scale, subtract, times

# Coefficients of what resists rolling and drilling.
RESISTING = ("rolling_length", "drilling_length", "spin_speed")
# A bristle that touches nothing springs back with this time constant [s].
RELAX = 1e-5


class ContactForce(NamedTuple):
    """What one face does; numbers are scalars, or (k,) over members.

    Attributes:
        force: on b, friction included [N], world; ``drag`` is friction's part.
        normal: normal force [N] >= 0.
        rate, slip_squared: of the penetration [m/s], and the sliding speed squared [m^2/s^2].
        slide: sliding velocity of b on a [m/s], world.
        couple: on b, of a contact that resists rolling and drilling [N m], world; else None.
        bending: rate of the friction's state: of bristles z' [m/s], world; of friction that lags (w',) [m/s^2]; else None.
    """

    force: Vector
    drag: Vector
    normal: Number
    rate: Number
    slide: Vector
    bending: Vector | tuple[Number] | None = None
    couple: Vector | None = None

    @property
    def slip_squared(self) -> Number:
        """u . u."""
        return dot(self.slide, self.slide)


class FrictionState(NamedTuple):
    """What friction with a state reads; without one every law acts by its steady slip.

    Attributes:
        bristle: deflection z [m], world; ``spin``: with which it turns [rad/s], world.
        late: slip speed of late [m/s], of friction that lags.
    """

    bristle: Vector | None = None
    spin: Vector = ZERO
    late: Number | None = None


STEADY = FrictionState()


def press(
    law: AbstractLaw,
    friction: AbstractFriction | None,
    c: Coefficients,
    face: Face,
    velocity: Vector,
    state: FrictionState = STEADY,
) -> ContactForce:
    """Force of one face (module docstring).

    Args:
        law, friction: the contact's laws; friction None is none.
        c: their coefficients; ``smoothing`` among them is the half-width of the regularisation [m].
        face: where it touches.
        velocity: of b less that of a at the point of contact [m/s], world.
        state: of friction.
    """
    bristle, spin, late = state
    rate = dot(face.normal, velocity)
    normal = times(face.gate, regularised_force(law, face.depth, jnp.asarray(rate), c, c.get("smoothing")))
    slide = subtract(velocity, scale(rate, face.normal))
    push = negative(scale(normal, face.normal))
    if friction is None:
        return ContactForce(push, ZERO, normal, rate, slide)
    squared = jnp.asarray(dot(slide, slide))
    if late is not None:
        learnt, mobility = friction.lag(squared, jnp.asarray(late), c)
        drag = scale(-times(normal, mobility), slide)
        return ContactForce(add(push, drag), drag, normal, rate, slide, (learnt,))
    if bristle is None:
        drag = scale(-times(normal, friction.mobility(squared, c)), slide)
        return ContactForce(add(push, drag), drag, normal, rate, slide)
    forget, stick, mobility = friction.bond(squared, c)
    bent = subtract(bristle, scale(dot(face.normal, bristle), face.normal))
    drag = scale(-normal, add(scale(stick, bent), scale(mobility, slide)))
    apart = separated(face.depth, c)
    lost = scale(minus(1.0, apart), subtract(slide, scale(forget, bristle)))
    bending = add(cross(spin, bristle), lost, scale(-apart / RELAX, bristle))
    return ContactForce(add(push, drag), drag, normal, rate, slide, bending)


def couple(touch: ContactForce, normal: Vector, spin: Vector, c: Coefficients) -> Vector:
    """Torque on b that resists rolling and drilling [N m], world.

        M = -N (r w_t/sqrt(w_t . w_t + s^2) + b w_n/sqrt(w_n . w_n + s^2)),

    w_n and w_t the parts of the relative spin w along the normal and across it. Coulomb's laws of rolling and drilling
    friction (Johnson, Contact Mechanics, 1985, 8.3 and 8.5), regularised below s as ``friction.Coulomb`` is: a body at rest on
    a slope creeps. Of a Hertz contact of radius a that slides everywhere b is 3 pi mu a/16. Coefficients:
    ``rolling_length`` r, the lever of rolling resistance [m], ``drilling_length`` b [m], ``spin_speed`` s [rad/s].
    """
    found = ZERO
    along = scale(dot(normal, spin), normal)
    for part, lever in zip((subtract(spin, along), along), RESISTING, strict=False):
        size = jnp.sqrt(jnp.asarray(dot(part, part)) + c["spin_speed"] ** 2)
        found = add(found, scale(-times(touch.normal, c[lever]) / size, part))
    return found


def separated(depth: Number, c: Coefficients) -> Array:
    """0 wherever there may be a normal force, 1 from a gap of ``GAP`` beyond the regularisation; C1."""
    return smooth_step((-depth - c.get("smoothing", 0.0)) / GAP)
