"""Derivatives of the joint's contact wrenches: by relative motion, then by its coordinates.

Contacts are independent, so that derivatives by relative place and relative twist (``slopes``) take nine tangents at most. The
chain to the coordinates (``blocks``), for a wrench W on a ball from a body with arm r, relative twist h and angular velocity w:

    ball place p:      A = K - C_v [w]x            body place:    -A
    ball twist:        C                           body twist:    -C B,  B = (I, -[r]x; 0, I)
    body rotation:     G = K [r]x + C [h]x - [W]x  (the body's axes turn; the ball does not)

and the body feels  -B' W,  whose arm also moves with p. K = dW/dplace, C = dW/dtwist, all in world axes.

Friction's states (``bristles``) are eliminated face by face. A face's row of  (I/s - J) x = r  is, with a body that turns
at W and is displaced by a rotation t (``contacts.act``),

    M dz = r + Z_p dp + Z_h dh - (a [z]x + [Z]x) t - [z]x dW,        M = (1/s + a) I - [W]x

where dp and dh are changes as the body sees them. So dz is known once the bodies are, and what a wrench changes by dz
goes into its slopes: an effective friction slope of the step. A slip speed of late does not turn: [.]x and t fall out.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.bands import act
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.contacts import ContactForce, ContactLaws, dot
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.models.joint.system import Part, cross_columns
from bcfj_jax.xla.kept import kept
from bcfj_jax.xla.small import block_diagonal, product


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


class _Linear(ContactLaws):
    """Laws by their tangents in one state: a tangent of ``act`` then takes few products, whatever the laws are.

    Attributes:
        at: penetration, its rate and the slip's square there.
        held: normal force, its derivatives by depth and by rate, mobility and its derivative by the slip's square.
    """

    at: tuple[Array, Array, Array]
    held: tuple[Array, Array, Array, Array, Array]

    def normal(self, penetration: Array, rate: Array) -> Array:
        force, by_depth, by_rate = self.held[:3]
        return force + by_depth * (penetration - self.at[0]) + by_rate * (rate - self.at[1])

    def mobility(self, slip_squared: Array) -> Array:
        mobility, slope = self.held[3:]
        return mobility + slope * (slip_squared - self.at[2])


def _linear(laws: ContactLaws, touch: ContactForce) -> _Linear:
    """``laws`` about what ``touch`` found."""
    assert touch.slip_squared is not None
    depth, rate, square = at = (touch.penetration, touch.rate, touch.slip_squared)
    one, none = jnp.ones_like(depth), jnp.zeros_like(depth)
    force, by_depth = jax.jvp(laws.normal, (depth, rate), (one, none))
    by_rate = jax.jvp(laws.normal, (depth, rate), (none, one))[1]
    held = kept(force, by_depth, by_rate, *jax.jvp(laws.mobility, (square,), (one,)))
    return _Linear(laws.law, laws.friction, laws.coefficients, laws.smoothing, at, held)


def slopes(part: Part) -> Slopes:
    """Derivatives of ``act`` for contacts by relative place and twist; k = 3 or 6.

    Contacts are independent: one tangent serves all of them at once.
    """
    laws, geometry, bristles = part.laws, part.geometry, part.bristles
    place, velocity, spin = part.motion
    twist = (velocity,) if spin is None else (velocity, spin)
    at = geometry(place)
    if bristles is None:
        laws = _linear(laws, act(laws, at, velocity, spin))

    def wrench(at: Any, *twist: Array, bristles: Array | None = bristles) -> tuple[Array, Array | None]:
        touch = act(laws, at, twist[0], twist[1] if len(twist) > 1 else None, bristles)
        force = touch.force if touch.moment is None else jnp.concatenate([touch.force, touch.moment], -1)
        return force, touch.bending

    def along(way: Array) -> Any:
        return jax.jvp(lambda p: wrench(geometry(p), *twist), (place,), (jnp.broadcast_to(way, place.shape),))[1]

    def moving(way: Array) -> Any:
        tangents = tuple(jnp.broadcast_to(x, place.shape) for x in way)
        return jax.jvp(lambda *twist: wrench(at, *twist), twist, tangents)

    # Apart, so that the geometry is differentiated by the place alone.
    by_place, bent = jax.vmap(along, out_axes=-1)(jnp.eye(3))
    ways = jnp.eye(3 * len(twist)).reshape(-1, len(twist), 3)
    (value, bending), (by_twist, swung) = jax.vmap(moving, out_axes=(None, -1))(ways)
    if bending is None or bristles is None:
        return Slopes(value, by_place, by_twist)
    shape = bristles.shape[-2:]

    def by_state(way: Array) -> Any:
        bent = jnp.broadcast_to(way, bristles.shape)
        return jax.jvp(lambda z: wrench(at, *twist, bristles=z), (bristles,), (bent,))[1]

    pull, felt = jax.vmap(by_state, out_axes=-1)(jnp.eye(shape[0] * shape[1]).reshape(-1, *shape))
    pull = jnp.moveaxis(pull.reshape(*pull.shape[:-1], *shape), -2, -3)
    decay = -jnp.stack([felt[..., i, 0, i * shape[1]] for i in range(shape[0])], -1)
    return Slopes(value, by_place, by_twist, Bond(bristles, bending, pull, bent, swung, decay))


class Freed(NamedTuple):
    """A face's dz = inverse r + place dp + twist dh + turn t + spin dW, and ``Bond``'s pull; (..., f, 3 | k, .)."""

    inverse: Array
    place: Array
    twist: Array
    turn: Array
    spin: Array
    pull: Array


def free(bond: Bond, outer: Array, scale: Array) -> Freed:
    """Bristles of faces in terms of everything else (module docstring); ``outer`` (..., 3) is W, ``scale`` s [s]."""
    share = (scale / (1.0 + scale * bond.decay))[..., None, None]
    if bond.bristles.shape[-1] == 1:
        still = jnp.zeros((*bond.bristles.shape, 3))
        return Freed(share, share * bond.by_place, share * bond.by_twist, still, still, bond.pull)
    eye = jnp.eye(3)
    bristles, bending = bond.bristles[..., None, :], bond.bending[..., None, :]
    # (I - [w]x)^-1 = (I + [w]x + w w')/(1 + w.w), w = W/(1/s + a).
    w = share * outer[..., None, None, :]
    inverse = share * (eye + jnp.cross(eye, w) + w.swapaxes(-1, -2) * w) / (1.0 + jnp.sum(w * w, -1, keepdims=True))
    spin = -jnp.cross(inverse, bristles)
    turn = bond.decay[..., None, None] * spin - jnp.cross(inverse, bending)
    return Freed(inverse, inverse @ bond.by_place, inverse @ bond.by_twist, turn, spin, bond.pull)


def effective(found: Slopes, freed: Freed) -> tuple[Slopes, Array, Array]:
    """Slopes with the bristles' part, and what a wrench changes by t and dW besides, (..., k, 3) both."""
    assert found.bond is not None
    if found.bond.bristles.shape[-1] == 1:
        # Column times row: elementwise, as tiny products of matrices are slow.
        place, twist = (jnp.sum(freed.pull * x, -3) for x in (freed.place, freed.twist))
        still = jnp.zeros_like(place)
        return Slopes(found.value, found.by_place + place, found.by_twist + twist), still, still
    turn = freed.turn + jnp.cross(jnp.eye(3), found.bond.bristles[..., None, :])
    place, twist, turn, spin = (jnp.sum(freed.pull @ x, -3) for x in (freed.place, freed.twist, turn, freed.spin))
    return Slopes(found.value, found.by_place + place, found.by_twist + twist), turn, spin


class Bristled(NamedTuple):
    """What bristles do to a step, all F faces in the flat state's order.

    Attributes:
        inverse: (F, 3, 3) of each face's own block.
        lift: (n k + b, 3 F) generalised forces by deflections.
        back: (3 F, moving) deflections by all other states, the cage's turn as a rotation vector.
    """

    inverse: Array
    lift: Array
    back: Array


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


def _moment(arm: Array, wrench: Array) -> Array:
    """About the bodies' centres (n, m, 3, j), of wrenches on the balls (n, m, k, j): r x f + moment."""
    moment = cross_columns(arm, wrench[..., :3, :])
    return moment + wrench[..., 3:, :] if wrench.shape[-2] == 6 else moment


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
    """Derivatives of pilot and drive forces by coupling displacement and coupling rate, (b, b); bristles' ``_rows``.

    Spheres have no axes, so only the distance p of the centres and the relative twist count, and
    dv = ... - w_outer x dp; the forces' map moves with p too. Bands turn with the cage, as windows do.
    """
    b = scene.coupling
    place, rate, rows = jnp.zeros((b, b)), jnp.zeros((b, b)), []
    pilots, tilt = system.piloted(scene, c, state), scene.slices["cage_turn"]
    whole, spins = system.guided(scene, c, state) if pilots else (None, jnp.zeros((0, 3)))
    every = None if whole is None else system.guide_maps(scene, c, whole.arm)
    first = 0
    for part in pilots:
        at = slice(first, first + len(part.names))
        first, maps, spin = at.stop, jax.tree.map(lambda x, at=at: x[at], every), spins[at]
        motion, found, freed = part.motion, slopes(part), None
        if found.bond is not None:
            freed = free(found.bond, spin, scale)
            found, _, by_spin = effective(found, freed)
        value, by_place, by_twist = kept(*found[:3])
        back = jnp.swapaxes(maps.twist, -1, -2)
        at_inner, turned, _ = _seen(motion, spin, by_place, by_twist)
        displaced = product(at_inner, maps.place)
        if scene.banded and tilt is not None:
            carried = [jnp.cross(value[:, None, part], jnp.eye(3)) for part in (slice(3), slice(3, 6))]
            displaced = displaced.at[..., tilt].add(turned + jnp.concatenate(carried, -2))
        displaced, moved = kept(displaced, product(by_twist, maps.twist))
        # Outer spheres carry their material with the inner centres.
        lever = jnp.swapaxes(cross_columns(value[:, :3], maps.turning), -1, -2)
        place = place + jnp.sum(product(back, displaced) - product(lever, maps.place), 0)
        rate = rate + jnp.sum(product(back, moved), 0)
        if freed is None:
            continue
        at_inner, turned, _ = _seen(motion, spin, freed.place[:, 0], freed.twist[:, 0])
        by_place, by_rate = at_inner @ maps.place, freed.twist[:, 0] @ maps.twist
        if scene.width == 3:
            # An outer sphere's spin turns its bristles.
            rate = rate + jnp.sum(back @ by_spin @ maps.turning, 0)
            by_rate = by_rate + freed.spin[:, 0] @ maps.turning
        if scene.banded and tilt is not None:
            by_place = by_place.at[..., tilt].add(turned)
        rows += [
            (freed.inverse[i], back[i] @ freed.pull[i, 0], by_place[i], by_rate[i]) for i in range(first - at.start)
        ]
    if scene.drive == "flexible":
        seat = scene.slices["seat_turn"]
        assert seat is not None
        place, rate = place.at[seat, seat].add(-c.drive_stiffness), rate.at[seat, seat].add(-c.drive_damping)
    return place, rate, rows


def _seen(motion: system.Motion, spins: Array, by_place: Array, by_twist: Array) -> tuple[Array, Array, Array]:
    """A, K [r]x + C [h]x and -C B's last columns (module docstring), (..., i, 3) each, of bodies that turn at ``spins``."""
    arm, velocity, by_velocity = motion.arm[..., None, :], motion.velocity[..., None, :], by_twist[..., :3]
    at_ball = by_place - jnp.cross(by_velocity, spins[..., None, :])
    turned, swung = jnp.cross(by_place, arm) + jnp.cross(by_velocity, velocity), jnp.cross(by_velocity, arm)
    if motion.spin is None:
        return at_ball, turned, swung
    by_spin = by_twist[..., 3:]
    return at_ball, turned + jnp.cross(by_spin, motion.spin[..., None, :]), swung - by_spin


def _rows(c: Constants, relative_motions: system.RelativeMotions, freed: Freed, bodies: Any) -> tuple[Array, ...]:
    """States of ball contacts' friction: their inverses, the balls' and the coupling's forces by them, they by all states.

    With m the bodies and w numbers a face, their product with the faces F:
    (n, m f, w, w); (n, k, F), (n, b, F); (n, F, 3 | k | b | b) by ball place and twist, coupling place and rate.
    """
    motion, maps = jax.tree.map(lambda x: x[:, bodies], relative_motions.motion), c.body_maps[bodies]
    n, m = freed.place.shape[:2]
    by_place, by_twist, turn, spin = (
        x.reshape(n, m, -1, x.shape[-1]) for x in (freed.place, freed.twist, freed.turn, freed.spin)
    )
    at_ball, turned, swung = _seen(motion, relative_motions.spins[bodies], by_place, by_twist)
    turned, swung = turned + turn, swung + spin
    own = jnp.stack([jnp.concatenate([-at_ball, turned], -1), jnp.concatenate([-by_twist[..., :3], swung], -1)])
    # Elementwise: as tiny products of matrices these two took a quarter of what friction's states cost in a step.
    place, rate = jnp.sum(own[..., None] * maps[:, None], -2)
    pull = jnp.moveaxis(freed.pull, -2, 1)
    wrench = jnp.moveaxis(freed.pull, -2, 2).reshape(n, m, pull.shape[1], -1)
    wrench = jnp.concatenate([wrench[..., :3, :], _moment(motion.arm, wrench)], -2)
    felt = -jnp.moveaxis(jnp.sum(maps[..., None] * wrench[..., None, :], 2), 1, 2)
    merged = (x.reshape(n, -1, x.shape[-1]) for x in (at_ball, by_twist, place, rate))
    inverse = freed.inverse.reshape(n, -1, *freed.inverse.shape[-2:])
    return inverse, pull.reshape(n, pull.shape[1], -1), felt.reshape(n, felt.shape[1], -1), *merged


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


def _freed(c: Constants, relative_motions: system.RelativeMotions, found: list[Slopes], scale: Any) -> tuple:
    """Slopes with the bristles eliminated, their ``_rows``, and ``effective``'s turn and spin of all bodies."""
    slants, rows, turns, spins, first = [], [], [], [], 0
    for one in found:
        at = slice(first, first + one.value.shape[1])
        first, turn, spin = at.stop, *[jnp.zeros(one.by_place.shape)] * 2
        if one.bond is not None:
            freed = free(one.bond, relative_motions.spins[at], scale)
            one, turn, spin = effective(one, freed)
            rows.append(_rows(c, relative_motions, freed, at))
        for held, x in zip((slants, turns, spins), (one, turn, spin), strict=True):
            held.append(x)
    return slants, rows, jnp.concatenate(turns, 1), jnp.concatenate(spins, 1)


def blocks(scene: Joint, c: Constants, y: Array, scale: Any = None) -> Blocks:
    """All derivatives of contact wrenches and coupling forces in one state.

    ``scale`` is s [s] of the step in which bristles are eliminated; not read without them.
    """
    state = system.view(scene, c, y)
    relative_motions = system.relative_motions(scene, c, state)
    found = [slopes(part) for part in relative_motions.parts]
    bent, by_turn, by_spin = [], jnp.zeros(()), jnp.zeros(())
    if any(one.bond is not None for one in found):
        found, bent, by_turn, by_spin = _freed(c, relative_motions, found, scale)
    value, by_place, by_twist = kept(*(jnp.concatenate(x, 1) for x in zip(*(one[:3] for one in found), strict=True)))
    motion, eye = relative_motions.motion, jnp.eye(3)
    # By displacement and by rotation of the body, (n, m, k, 3) each: A, G by place, C_v and C B by rate.
    at_ball, turned, swung = _seen(motion, relative_motions.spins, by_place, by_twist)
    carried = [jnp.cross(value[..., None, i : i + 3], eye) for i in range(0, scene.twist, 3)]
    turned = turned + jnp.concatenate(carried, -2)
    if bent:
        turned, swung = turned + by_turn, swung + by_spin
    at_ball, turned, swung = kept(at_ball, turned, swung)
    # What the bodies feel of it: forces (n, m, 3, .) and moments; the arm, too, moves with the ball.
    moments = kept(*(_moment(motion.arm, x) for x in (at_ball, by_twist, turned, swung)))
    lifted = jnp.cross(eye, value[..., None, :3])
    forces = [-x[..., :3, :] for x in (at_ball, by_twist, turned, swung)]
    moments = [lifted - moments[0], *(-x for x in moments[1:])]
    column_place, column_rate = _spread(scene, c, -at_ball, turned), _spread(scene, c, -by_twist[..., :3], swung)
    rows = [_spread(scene, c, *(jnp.swapaxes(x[i], -1, -2) for x in (forces, moments))) for i in (0, 1)]

    # A body's own block: its place is minus all the balls' places.
    forces, moments = (
        [jnp.sum(x, 0) for x in (-part[0], part[2], -part[1][..., :3], part[3])] for part in (forces, moments)
    )
    own = [jnp.concatenate([jnp.concatenate(x[i : i + 2], -1) for x in (forces, moments)], -2) for i in (0, 2)]
    # What moves one body acts back on it alone. With a second axis of bodies ``_spread`` takes first the moves to the
    # coupling coordinates, then the wrenches.
    apart = jnp.stack(own)[:, :, None] * jnp.eye(own[0].shape[0])[:, :, None, None]
    half = jnp.swapaxes(_spread(scene, c, apart[..., :3], apart[..., 3:]), -1, -2)
    corner = jnp.swapaxes(_spread(scene, c, half[..., :3], half[..., 3:]), -1, -2)
    place, rate, guided = _alone(scene, c, state, scale)
    return Blocks(
        jnp.sum(at_ball, 1),
        jnp.sum(by_twist, 1),
        column_place,
        column_rate,
        jnp.swapaxes(rows[0], -1, -2),
        jnp.swapaxes(rows[1], -1, -2),
        place + corner[0],
        rate + corner[1],
        _bristled(scene, bent, guided) if scene.bristles else None,
    )
