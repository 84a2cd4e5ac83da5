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
    load_velocity = by_rate[..., None] * n
    by_place = -dyad(n, load_place) - (normal[..., None, None] * hessian if curved else 0.0)
    by_velocity = -dyad(n, load_velocity)
    force = -normal[..., None] * n
    if laws.friction is None:
        k = 3 if spin is None else 6
        wide = [(0, 0)] * (by_place.ndim - 3)
        value, by_place, by_twist = jnp.sum(force, -2), jnp.sum(by_place, -3), jnp.sum(by_velocity, -3)
        value = jnp.pad(value, [*wide, (0, k - 3)])
        by_place = jnp.pad(by_place, [*wide, (0, k - 3), (0, 0)])
        return Slopes(value, by_place, jnp.pad(by_twist, [*wide, *[(0, k - 3)] * 2]))
    slide = v - rate[..., None] * n
    plane = jnp.eye(3) - dyad(n, n)
    slide_place = -(dyad(n, drift) + rate[..., None, None] * hessian) if curved else jnp.zeros_like(plane)
    lever = at.lever[..., None]
    arm = lever * n
    turned = sweep = jnp.zeros(())
    if spin is not None:
        w = spin[..., None, :]
        slide = slide + jnp.cross(w, arm)
        sweep = lever[..., None] * hessian + at.lever_slope * dyad(n, n) if curved else jnp.zeros_like(plane)
        slide_place = slide_place + cross_columns(w, sweep)
        turned = skew(-arm)
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
    rub = -drag[..., None] * slide
    # By place, velocity and spin, one after the other: only their sums over the faces are put together.
    parts = [(slide_place, load_place), (plane, load_velocity)]
    if spin is not None:
        parts.append((turned, jnp.zeros(())))
    rubs = [
        -dyad(slide, mobility[..., None] * load + _row(pull, sliding)) - drag[..., None, None] * sliding
        for sliding, load in parts
    ]
    bond = None
    if lags:
        assert bristles is not None
        swing = (2.0 * rate_bend)[..., None] * slide
        pull = (-(normal * bend_late)[..., None] * slide)[..., None]
        bond = Bond(
            bristles,
            learnt[..., None],
            pull if spin is None else jnp.concatenate([pull, cross_columns(arm, pull)], -2),
            _row(swing, slide_place)[..., None, :],
            jnp.concatenate([_row(swing, sliding) for sliding, _ in parts[1:]], -1)[..., None, :],
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
        rubs = [
            rub - dyad(bent, stick[..., None] * load + _row(grip, sliding))
            for rub, (sliding, load) in zip(rubs, parts, strict=True)
        ]
        rubs[0] = rubs[0] - hold[..., None, None] * bent_place
        pull = -hold[..., None, None] * plane
        apart, opening = jax.jvp(laws.apart, (at.penetration,), (jnp.ones_like(at.penetration),))
        close, lost = (1.0 - apart)[..., None, None], slide - forget[..., None] * bristles + bristles / RELAX
        bond = Bond(
            bristles,
            (1.0 - apart)[..., None] * lost - bristles / RELAX,
            pull if spin is None else jnp.concatenate([pull, cross_columns(arm, pull)], -2),
            close * (slide_place - dyad(bristles, _row(forget_slide, slide_place)))
            - dyad(lost, opening[..., None] * n),
            jnp.concatenate([close * (x - dyad(bristles, _row(forget_slide, x))) for x, _ in parts[1:]], -1),
            (1.0 - apart) * forget + apart / RELAX,
        )
    rub, *rubs = kept(rub, *rubs)
    value, by_place, by_velocity = (
        jnp.sum(force + rub, -2), jnp.sum(by_place + rubs[0], -3), jnp.sum(by_velocity + rubs[1], -3)
    )  # fmt: skip
    if spin is None:
        return Slopes(value, by_place, by_velocity, bond)
    moments = [cross_columns(arm, x) for x in rubs]
    moments[0] = moments[0] - cross_columns(rub, sweep)
    about_place, about_velocity, about_spin = (jnp.sum(x, -3) for x in kept(*moments))
    value = jnp.concatenate([value, jnp.sum(jnp.cross(arm, rub), -2)], -1)
    upper = jnp.concatenate([by_velocity, jnp.sum(rubs[2], -3)], -1)
    lower = jnp.concatenate([about_velocity, about_spin], -1)
    return Slopes(value, jnp.concatenate([by_place, about_place], -2), jnp.concatenate([upper, lower], -2), bond)


def dyad(a: Array, b: Array) -> Array:
    """a b' of vectors along the last axis."""
    return a[..., :, None] * b[..., None, :]


def _row(a: Array, matrix: Array) -> Array:
    return jnp.sum(a[..., :, None] * matrix, -2)


def skew(a: Array) -> Array:
    """[a]x: the matrix of  a x  (..., 3, 3)."""
    zero = jnp.zeros_like(a[..., 0])
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    rows = ([zero, -z, y], [z, zero, -x], [-y, x, zero])
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def cross_columns(a: Array, matrix: Array) -> Array:
    """a x (each column of the matrix)."""
    x, y, z = (a[..., i, None] for i in range(3))
    u, v, w = (matrix[..., i, :] for i in range(3))
    return jnp.stack([y * w - z * v, z * u - x * w, x * v - y * u], -2)
