"""Derivatives of the joint's contact wrenches, by the coordinates of the bodies that touch.

A contact's force and moment on its second body (a ball, an inner sphere) follow from how that body moves as the first one sees it
(``contacts.tangents``). Where the first body turns by t they turn with it, and what it sees turns by -t:

    second body moves by dp           arm + dp,  velocity - W x dp
    first body turns by t             arm - t x arm,  velocity, spin and bristles likewise;  found + t x found
    twist (dv, dw), first's spin dW   velocity + dv - dW x arm,  spin + dw - dW

with W the first body's angular velocity. It moves by d where the second one moves by -d. It feels the force -F, and the moment
-(M + arm x F) about its own centre. All in world axes.

Friction's states z (``bristles``) are eliminated face by face: a face's row of  (I/s - J) x = r  is

    N dz = r + Z dx,    N = (1/s + a) I - [W]x,    Z dx = the change of z' by all other states,

so dz is known once the bodies are, and what a wrench changes by dz goes into its slopes: an effective friction slope of the
step. A slip speed of late does not turn, and has a number in place of the 3 of a bristle.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.bands import tangents
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.contacts import dot
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.models.joint.system import Part
from bcfj_jax.xla.kept import kept
from bcfj_jax.xla.small import block_diagonal, product, skew


class Faces(NamedTuple):
    """Friction's states of each face, w numbers:  dz = inverse r + place dx + rate dx',  with x and x' as of ``Slopes``."""

    inverse: Array  # (..., f, w, w)
    place: Array  # (..., f, w, 6)
    rate: Array  # (..., f, w, k + 3)
    pull: Array  # (..., o, f w) derivative of what the contact exerts by z


class Slopes(NamedTuple):
    """Derivatives of what contacts exert, (..., o): force on the second body, moment about its centre where it spins, and
    moment about the first body's centre. Friction's states are eliminated from them.
    """

    place: Array  # (..., o, 6) by the second body's displacement dp, the first one's rotation t
    rate: Array  # (..., o, k + 3) by the second body's twist (dv, dw) or velocity dv, the first one's spin dW
    faces: Faces | None = None  # friction's states


def slopes(part: Part, outer: Array, scale: Any) -> Slopes:
    """Of contacts whose first bodies turn at ``outer`` (..., 3) [rad/s]; friction's states in a step of s = ``scale`` [s]."""
    arm = part.motion.arm
    found = tangents(part.laws, part.geometry, *part.motion, part.bristles)
    value = found.value
    place, rate = _seen(part.motion, outer, found.place, found.twist)
    place = place.at[..., 3:].add(
        jnp.concatenate([_turned(value[..., i : i + 3]) for i in range(0, value.shape[-1], 3)], -2)
    )
    if found.bending is None:
        return Slopes(_about(arm, place, value), _about(arm, rate))
    state, pull = part.bristles, found.pull
    assert state is not None and pull is not None and found.decay is not None
    width, decay, (bending, bent, swung) = state.shape[-1], found.decay, found.bending
    bent, swung = _seen(jax.tree.map(lambda x: x[..., None, :], part.motion), outer[..., None, :], bent, swung)
    if width == 3:
        # Bristles turn with the first body.
        held = _turned(state)
        bent = bent.at[..., 3:].add(_turned(bending) + decay[..., None, None] * held)
        swung = swung.at[..., -3:].add(held)
        place = place.at[..., 3:].add(-pull @ held.reshape(*held.shape[:-3], -1, 3))
    inverse = _inverse(scale / (1.0 + scale * decay), outer, width)
    bent, swung = product(inverse, bent), product(inverse, swung)
    place, rate = (
        _about(arm, x + product(pull, freed.reshape(*freed.shape[:-3], -1, freed.shape[-1])), *rest)
        for x, freed, *rest in ((place, bent, value), (rate, swung))
    )
    return Slopes(place, rate, Faces(inverse, bent, swung, _about(arm, pull)))


def _turned(x: Array) -> Array:
    """t x x by t, (..., 3, 3)."""
    return -skew(x)


def _seen(motion: system.Motion, outer: Array, place: Array, twist: Array) -> tuple[Array, Array]:
    """By (dp, t) and (dv, dw, dW), of derivatives by the relative motion (module docstring), (..., o, .)."""
    arm, velocity, by_velocity = skew(motion.arm), skew(motion.velocity), twist[..., :3]
    turned, swung = product(place, arm) + product(by_velocity, velocity), product(by_velocity, arm)
    if motion.spin is not None:
        turned, swung = turned + product(twist[..., 3:], skew(motion.spin)), swung - twist[..., 3:]
    displaced = place - product(by_velocity, skew(outer))
    return jnp.concatenate([displaced, turned], -1), jnp.concatenate([twist, swung], -1)


def _about(arm: Array, change: Array, value: Array | None = None) -> Array:
    """Changes of wrenches (..., k, x), and of their moments about the first body's centre; ``value``: whose arm moves by dp."""
    moment = product(skew(arm), change[..., :3, :])
    moment = moment + change[..., 3:, :] if change.shape[-2] == 6 else moment
    moment = moment if value is None else moment.at[..., :3].add(_turned(value[..., :3]))
    return jnp.concatenate([change, moment], -2)


def _inverse(share: Array, outer: Array, width: int) -> Array:
    """N^-1 (..., f, w, w), with 1/share = 1/s + a:  (I - [w]x)^-1 = (I + [w]x + w w')/(1 + w.w),  w = W share."""
    share = share[..., None, None]
    if width == 1:
        return share
    eye, w = jnp.eye(3), share * outer[..., None, None, :]
    return share * (eye + jnp.cross(eye, w) + w.swapaxes(-1, -2) * w) / (1.0 + jnp.sum(w * w, -1, keepdims=True))


class Bristled(NamedTuple):
    """What bristles do to a step, all F faces in the flat state's order."""

    inverse: Array  # (F, 3, 3) of each face's own block
    lift: Array  # (n k + b, 3 F) generalised forces by deflections
    back: Array  # (3 F, moving) deflections by all other states, the cage's turn as a rotation vector


class Blocks(NamedTuple):
    """Derivative of contact wrenches and coupling forces; n balls, k twists, b coupling coordinates.

    ``place`` by displacement, ``rate`` by velocity: of ball i by itself (n, k, 3 | k), of ball i by the coupling
    (n, k, b), of the coupling coordinates by ball i (n, b, 3 | k), of the coupling by itself (b, b). The cage's turn is a
    rotation vector here.
    """

    ball_place: Array
    ball_rate: Array
    column_place: Array
    column_rate: Array
    row_place: Array
    row_rate: Array
    coupling_place: Array
    coupling_rate: Array
    bristles: Bristled | None = None


def _spread(scene: Joint, c: Constants, along: Array, about: Array) -> Array:
    """From displacements and rotations of the bodies (..., m, j, 3) to coupling coordinates (..., j, coupling)."""
    parts = {
        "head": along[..., 1, :, :],
        "head_turn": dot(about[..., 1, :, :], c.axes[1])[..., None],
        "cage": jnp.sum(along[..., 2:, :, :], -3),
        "cage_turn": jnp.sum(about[..., 2:, :, :], -3),
        "seat_turn": dot(about[..., 0, :, :], c.axes[0])[..., None],
    }
    return scene.coupled(parts)


def _alone(scene: Joint, c: Constants, state: system.State, scale: Any) -> tuple[Array, Array, list[tuple]]:
    """Derivatives of pilot and drive forces by coupling displacement and coupling rate, (b, b).

    And of the pilots' faces: inverse, the coupling's forces by them (k, b, w), they by coupling displacement and rate (k, w, b).
    """
    b = scene.coupling
    place, rate, rows, first = jnp.zeros((b, b)), jnp.zeros((b, b)), [], 0
    for part in system.piloted(scene, c, state):
        at = slice(first, first + len(part.names))
        first, maps = at.stop, system.guide_maps(scene, c)[at]
        found = slopes(part, system.guided(scene, c, state)[1][at], scale)
        back = jnp.swapaxes(maps * system.FELT[:, None], -1, -2)
        moved = jnp.concatenate([maps[:, :3], maps[:, 6:]], 1)
        displaced, swung = kept(product(found.place, moved), product(found.rate, maps))
        place, rate = (x + jnp.sum(product(back, y), 0) for x, y in ((place, displaced), (rate, swung)))
        if (faces := found.faces) is not None:
            by = back @ faces.pull, faces.place[:, 0] @ moved, faces.rate[:, 0] @ maps
            rows += zip(faces.inverse, *by, strict=True)
    if scene.drive == "flexible":
        seat = scene.slices["seat_turn"]
        assert seat is not None
        place, rate = place.at[seat, seat].add(-c.drive_stiffness), rate.at[seat, seat].add(-c.drive_damping)
    return place, rate, rows


def _rows(maps: Array, faces: Faces, k: int) -> tuple[Array, ...]:
    """States of ball contacts' friction: their inverses, the balls' and the coupling's forces by them, they by all states.

    With m the bodies, ``maps`` (m, 6, b) theirs, and w numbers a face, their product with the faces F:
    (n, m f, w, w); (n, k, F), (n, b, F); (n, F, 3 | k | b | b) by ball place and twist, coupling place and rate.
    """
    n, m = faces.place.shape[:2]
    place, rate = (x.reshape(n, m, -1, x.shape[-1]) for x in (faces.place, faces.rate))
    own = jnp.stack([place.at[..., :3].multiply(-1.0), jnp.concatenate([-rate[..., :3], rate[..., k:]], -1)])
    # Elementwise: as tiny products of matrices these two took a quarter of what friction's states cost in a step.
    at, by_rate = jnp.sum(own[..., None] * maps[:, None], -2)
    pull = faces.pull
    felt = jnp.concatenate([pull[..., :3, :], pull[..., -3:, :]], -2)
    felt = -jnp.moveaxis(jnp.sum(maps[..., None] * felt[..., None, :], 2), 1, 2)
    pull = jnp.moveaxis(pull[..., :k, :], 1, 2)
    merged = (x.reshape(n, -1, x.shape[-1]) for x in (place[..., :3], rate[..., :k], at, by_rate))
    inverse = faces.inverse.reshape(n, -1, *faces.inverse.shape[-2:])
    return inverse, pull.reshape(n, k, -1), felt.reshape(n, felt.shape[1], -1), *merged


def _bristled(scene: Joint, balls: list[tuple], pilots: list[tuple]) -> Bristled:
    """From the rows of the balls' contacts and of the pilots. Dense: one product of 100 x 60 is one kernel."""
    n, k, b = scene.balls, scene.twist, scene.coupling
    inverses, lifts, backs = [], [], []
    if balls:
        axes = (1, 2, 2, 1, 1, 1, 1)
        parts = [jnp.concatenate(x, axis) for x, axis in zip(zip(*balls, strict=True), axes, strict=True)]
        inverse, pull, felt, place, twist, at, rate = parts
        size = n * place.shape[1]
        inverses.append(inverse.reshape(-1, scene.width, scene.width))
        lifts.append(jnp.concatenate([block_diagonal(pull), jnp.swapaxes(felt, 0, 1).reshape(b, size)]))
        coupling = (at.reshape(size, b), block_diagonal(twist), rate.reshape(size, b))
        backs.append(jnp.concatenate([block_diagonal(place), *coupling], 1))
    for inverse, pull, at, rate in pilots:
        inverses.append(inverse)
        lifts.append(jnp.concatenate([jnp.zeros((n * k, pull.shape[-1])), pull]))
        wide = len(at)
        backs.append(jnp.concatenate([jnp.zeros((wide, 3 * n)), at, jnp.zeros((wide, n * k)), rate], 1))
    return Bristled(jnp.concatenate(inverses), jnp.concatenate(lifts, 1), jnp.concatenate(backs))


def blocks(scene: Joint, c: Constants, y: Array, scale: Any = None) -> Blocks:
    """All derivatives of contact wrenches and coupling forces in one state.

    ``scale`` is s [s] of the step in which bristles are eliminated; not read without them.
    """
    state, k = system.view(scene, c, y), scene.twist
    around = system.relative_motions(scene, c, state)
    found, rows, first = [], [], 0
    for part in around.parts:
        at = slice(first, first + len(part.names))
        first, one = at.stop, slopes(part, around.spins[at], scale)
        found.append(one)
        rows += [] if one.faces is None else [_rows(c.body_maps[at], one.faces, k)]
    place, rate = kept(*(jnp.concatenate(x, 1) for x in zip(*(one[:2] for one in found), strict=True)))
    # By a body's displacement and rotation, by its velocity and spin.
    by_body = [jnp.concatenate([-x[..., :3], x[..., i:]], -1) for x, i in ((place, 3), (rate, k))]
    columns = [_spread(scene, c, x[..., :k, :3], x[..., :k, 3:]) for x in by_body]
    turned = [-jnp.swapaxes(x, -1, -2) for x in (place[..., :3], rate[..., :k])]
    lines = [_spread(scene, c, x[..., :3], x[..., -3:]) for x in turned]
    # A body's own block: what moves one body acts back on it alone. With a second axis of bodies ``_spread`` takes first the
    # moves to the coupling coordinates, then the wrenches.
    own = [-jnp.sum(jnp.concatenate([x[..., :3, :], x[..., -3:, :]], -2), 0) for x in by_body]
    apart = jnp.stack(own)[:, :, None] * jnp.eye(own[0].shape[0])[:, :, None, None]
    half = jnp.swapaxes(_spread(scene, c, apart[..., :3], apart[..., 3:]), -1, -2)
    corner = jnp.swapaxes(_spread(scene, c, half[..., :3], half[..., 3:]), -1, -2)
    alone, braked, guided = _alone(scene, c, state, scale)
    return Blocks(
        ball_place=jnp.sum(place[..., :k, :3], 1),
        ball_rate=jnp.sum(rate[..., :k, :k], 1),
        column_place=columns[0],
        column_rate=columns[1],
        row_place=jnp.swapaxes(lines[0], -1, -2),
        row_rate=jnp.swapaxes(lines[1], -1, -2),
        coupling_place=alone + corner[0],
        coupling_rate=braked + corner[1],
        bristles=_bristled(scene, rows, guided) if scene.bristles else None,
    )
