"""What a contact's wrench and its bristles change by: derivatives by relative place, relative twist and deflection."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.core.kept import kept
from bcfj_jax.models.joint.contacts import Geometry, dot
from bcfj_jax.models.joint.law_pair import RELAX, ContactLaws, LawPair


class Bond(NamedTuple):
    """The bristles z of each face, ``contacts.act``: Z = z' less W x z, and its derivatives.

    Or the slip speed of late w, Z = w', which does not turn with a body: then 1 in place of the last 3 of z.

    Attributes:
        bristles, bending: (..., f, 3) z [m] and Z [m/s].
        pull: (..., f, k, 3) derivative of the wrench by z.
        by_place, by_twist: (..., f, 3, 3) and (..., f, 3, k) derivatives of Z.
        decay: (..., f) a [1/s]; by z, the derivative of Z is -a.
    """

    bristles: Array
    bending: Array
    pull: Array
    by_place: Array
    by_twist: Array
    decay: Array


class Slopes(NamedTuple):
    """Wrench (..., k) of ``act``, its derivatives by place (..., k, 3) and by twist (..., k, k); its bristles'."""

    value: Array
    by_place: Array
    by_twist: Array
    bond: Bond | None = None


def slopes(
    laws: ContactLaws | LawPair, at: Geometry, velocity: Array, spin: Array | None, bristles: Array | None = None
) -> Slopes:
    """Derivatives of ``act``, whose arguments these are; k = 3 or 6.

    With H the Hessian of d, g = H v and the laws' slopes N_d, N_r, D_2 = N d(mu/|u|)/d(u.u):

        dN = (N_d n + N_r g) . dp + N_r n . dv        du = (I - nn') dv - (n g' + d' H) dp    (no spin)
        df = -n dN - N H dp - u dD - D du             dD = (mu/|u|) dN + 2 D_2 u . du

    and with spin the lever's sweep  w x d(l n) + dw x l n  in du, and the moment  l n x (-D u).
    Bristles have D = N m, and  -N s b  beside  -D u,  with  db = (I - nn') dz - (H dp) (n . z) - n (z . H dp).
    Friction that lags has  dD = (mu/|u|) dN + 2 D_2 u . du + N d(mu/|u|)/dw dw.
    """
    v, n = velocity[..., None, :], at.normal
    rate = dot(n, v)
    normal, by_depth = jax.jvp(lambda d: laws.normal(d, rate), (at.penetration,), (jnp.ones_like(at.penetration),))
    by_rate = jax.jvp(lambda r: laws.normal(at.penetration, r), (rate,), (jnp.ones_like(rate),))[1]
    hessian = sum(((e * curve[..., None])[..., :, None] * e[..., None, :] for e, curve in at.bends), jnp.zeros(()))
    curved = len(at.bends) > 0
    drift = sum(((e * (curve * dot(e, v))[..., None]) for e, curve in at.bends), jnp.zeros(3))
    load_place = by_depth[..., None] * n + by_rate[..., None] * drift
    if at.gate is not None:
        load_place = at.gate[..., None] * load_place + normal[..., None] * at.gate_slope
        normal, by_rate = normal * at.gate, by_rate * at.gate
    normal, by_rate, load_place = kept(normal, by_rate, load_place)
    load_twist = by_rate[..., None] * n
    by_place = -dyad(n, load_place) - (normal[..., None, None] * hessian if curved else 0.0)
    by_twist = -dyad(n, load_twist)
    force = -normal[..., None] * n
    if laws.friction is None:
        k = 3 if spin is None else 6
        wide = [(0, 0)] * (by_place.ndim - 3)
        value, by_place, by_twist = jnp.sum(force, -2), jnp.sum(by_place, -3), jnp.sum(by_twist, -3)
        value = jnp.pad(value, [*wide, (0, k - 3)])
        by_place = jnp.pad(by_place, [*wide, (0, k - 3), (0, 0)])
        return Slopes(value, by_place, jnp.pad(by_twist, [*wide, *[(0, k - 3)] * 2]))
    slide = v - rate[..., None] * n
    plane = jnp.eye(3) - dyad(n, n)
    slide_place = -(dyad(n, drift) + rate[..., None, None] * hessian) if curved else jnp.zeros_like(plane)
    lever = at.lever[..., None]
    if spin is not None:
        w = spin[..., None, :]
        slide = slide + jnp.cross(w, lever * n)
        sweep = lever[..., None] * hessian + at.lever_slope * dyad(n, n) if curved else jnp.zeros_like(plane)
        slide_place = slide_place + cross_columns(w, sweep)
    slide, slide_place = kept(slide, slide_place)
    squared = dot(slide, slide)
    lags = bristles is not None and bristles.shape[-1] == 1
    late = bend_late = rate_late = learnt = rate_bend = jnp.zeros(())
    if lags:
        assert bristles is not None
        late = bristles[..., 0]
        ones = jnp.ones_like(late)
        (learnt, mobility), (rate_bend, bend) = jax.jvp(lambda x: laws.lag(x, late), (squared,), (ones,))
        rate_late, bend_late = jax.jvp(lambda x: laws.lag(squared, x), (late,), (ones,))[1]
    elif bristles is None:
        mobility, bend = jax.jvp(laws.mobility, (squared,), (jnp.ones_like(squared),))
    else:
        found, slants = jax.jvp(laws.bond, (squared,), (jnp.ones_like(squared),))
        (forget, stick, mobility), (forget_bend, stick_bend, bend) = found, slants
    drag, pull = normal * mobility, (2.0 * normal * bend)[..., None] * slide
    drag, pull = kept(drag, pull)
    drag_place = mobility[..., None] * load_place + _row(pull, slide_place)
    # By the velocity of the point of contact, v + w x l n; ``_with_spin`` adds what follows by w. ``pull`` is in the plane.
    drag_twist = mobility[..., None] * load_twist + pull
    rub = -drag[..., None] * slide
    rub_place = -dyad(slide, drag_place) - drag[..., None, None] * slide_place
    rub_twist = -dyad(slide, drag_twist) - drag[..., None, None] * plane
    bond = None
    if lags:
        assert bristles is not None
        swing = (2.0 * rate_bend)[..., None] * slide
        pull = (-(normal * bend_late)[..., None] * slide)[..., None]
        bond = Bond(
            bristles,
            learnt[..., None],
            pull if spin is None else jnp.concatenate([pull, cross_columns(lever * n, pull)], -2),
            _row(swing, slide_place)[..., None, :],
            _with_spin(swing[..., None, :], spin, lever * n),
            -rate_late,
        )
    elif bristles is not None:
        # Twice the slopes by u.u times u: changes of k and s by the sliding u.
        forget_slide, stick_slide = (2.0 * x[..., None] * slide for x in (forget_bend, stick_bend))
        out = dot(n, bristles)[..., None]
        bent, hold = bristles - out * n, normal * stick
        bent_place = -(out[..., None] * hessian + dyad(n, dot(hessian, bristles[..., None, :]))) if curved else 0.0
        grip = normal[..., None] * stick_slide
        rub = rub - hold[..., None] * bent
        rub_place = rub_place - dyad(bent, stick[..., None] * load_place + _row(grip, slide_place))
        rub_place = rub_place - hold[..., None, None] * bent_place
        rub_twist = rub_twist - dyad(bent, stick[..., None] * load_twist + grip)
        pull = -hold[..., None, None] * plane
        apart, opening = jax.jvp(laws.apart, (at.penetration,), (jnp.ones_like(at.penetration),))
        close, lost = (1.0 - apart)[..., None, None], slide - forget[..., None] * bristles + bristles / RELAX
        bond = Bond(
            bristles,
            (1.0 - apart)[..., None] * lost - bristles / RELAX,
            pull if spin is None else jnp.concatenate([pull, cross_columns(lever * n, pull)], -2),
            close * (slide_place - dyad(bristles, _row(forget_slide, slide_place)))
            - dyad(lost, opening[..., None] * n),
            _with_spin(close * (plane - dyad(bristles, forget_slide)), spin, lever * n),
            (1.0 - apart) * forget + apart / RELAX,
        )
    rub, rub_place, rub_twist = kept(rub, rub_place, rub_twist)
    value, by_place, by_twist = force + rub, by_place + rub_place, by_twist + rub_twist
    if spin is not None:
        arm = lever * n
        value = jnp.concatenate([value, jnp.cross(arm, rub)], -1)
        moment_place = cross_columns(arm, rub_place) - cross_columns(rub, sweep)
        by_place = jnp.concatenate([by_place, moment_place], -2)
        by_twist = _with_spin(jnp.concatenate([by_twist, cross_columns(arm, rub_twist)], -2), spin, arm)
    return Slopes(jnp.sum(value, -2), jnp.sum(by_place, -3), jnp.sum(by_twist, -3), bond)


def dyad(a: Array, b: Array) -> Array:
    """a b' of vectors along the last axis."""
    return a[..., :, None] * b[..., None, :]


def _with_spin(rows: Array, spin: Array | None, arm: Array) -> Array:
    """Derivatives by the relative twist (v, w) from rows r by the velocity v + w x a of the point of contact.

    r . (dw x a) = dw . (a x r), for a ball that spins; others have no w.
    """
    return rows if spin is None else jnp.concatenate([rows, jnp.cross(arm[..., None, :], rows)], -1)


def _row(a: Array, matrix: Array) -> Array:
    return jnp.sum(a[..., :, None] * matrix, -2)


def cross_columns(a: Array, matrix: Array) -> Array:
    """a x (each column of the matrix)."""
    return jnp.cross(a[..., None, :], matrix.swapaxes(-1, -2)).swapaxes(-1, -2)
