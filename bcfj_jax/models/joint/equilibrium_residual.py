"""Forces out of balance in the joint at rest, and their derivative: what ``quasistatic`` solves.

Massless parts, no friction, no damping. Arrays have the instants along their last axis. Unknown are displacements from the
zero-clearance position [m]; angles are times the pitch radius. Forces are those of ``system`` at rest, as a gradient. Balls
touch the coupling's bodies alone, so their derivative is an arrowhead: a 3 x 3 block a ball, and coupling coordinates of
head and cage. It is not symmetric where a flank's sector ends (``contact.gaps.balls.sector``).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.models.joint import bands, contacts, system
from bcfj_jax.models.joint.constants import BALLS, Constants, groups
from bcfj_jax.models.joint.contacts import ContactLaws
from bcfj_jax.models.joint.scene import PILOTS, Joint


class Problem(NamedTuple):
    """What equilibrium depends on, differentiable.

    Attributes:
        ball: (3, n, T) zero-clearance places.
        seat, torque: (T,) angle of the seat, load on the head.
        spring: stiffness of the grounding [N/m].
        lever: length [m] that an unknown angle is times.
    """

    c: Constants
    ball: Array
    seat: Array
    torque: Array
    spring: Array
    lever: Array


class Places(NamedTuple):
    """Displacements [m] from the zero-clearance position: balls (3, n, T), coupling (b, T)."""

    ball: Array
    coupling: Array


class Matrix(NamedTuple):
    """Derivative of the forces: ball (3, 3, n, T), column (3, b, n, T), row (b, 3, n, T), coupling (b, b, T).

    seat: (3, n, T), that of the balls' forces by the seat's angle where nothing else moves.
    """

    ball: Array
    column: Array
    row: Array
    coupling: Array
    seat: Array


def slices_of(scene: Joint) -> dict[str, slice]:
    """Where the unknowns of the coupling coordinates are; the cage's tilt has two, a turn about its own axis does nothing."""
    sizes = {"head": 3 * (scene.head == "free"), "turn": 1}
    sizes |= {"cage": 3, "tilt": 2} if scene.cage == "free" else {}
    ends = np.cumsum(list(sizes.values())).tolist()
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True) if size}


def tilted_axis(c: Constants, tilt: Array) -> tuple[Array, Array]:
    """Unit axis of the cage (3,) tilted by (u, v) [rad], b + u e + v f made unit; its derivatives (3, 2)."""
    across = jnp.array([0.0, 1.0, 0.0])
    ways = jnp.stack([jnp.cross(across, c.bisector), across], 1)
    long = c.bisector + ways @ tilt
    size = jnp.sqrt(long @ long)
    axis = long / size
    return axis, (ways - axis[:, None] * (axis @ ways)) / size


def _push(laws: ContactLaws, penetration: Array) -> Array:
    """Normal forces at rest."""
    return laws.normal(penetration, jnp.zeros_like(penetration))


def _by_balls(scene: Joint, p: Problem, arm: Array, angles: Array) -> Array:
    """Forces of all balls against seat, head and windows at one instant (n, m, 5), as a gradient.

    By the ball's place relative to each body (n, m, 3), and by the body's angles times the lever (m, 2): its turn, or the
    cage's tilts.
    """
    c = p.c
    across = system.track_normals(scene, c, angles[:2, 0] / p.lever)
    axis, ways = c.bisector, c.axes[:, None] * jnp.array([1.0, 0.0])[:, None]
    if arm.shape[1] > 2:
        axis, tilts = tilted_axis(c, angles[2] / p.lever)
        ways = jnp.concatenate([ways, jnp.cross(axis, tilts.T)[None]])
    forces, first = [], 0
    for names, laws in zip(groups(scene, BALLS[:3]), c.ball_laws, strict=False):
        at = slice(first, first + len(names))
        touch = system.around_balls(c, across, axis[None], at, arm[:, at])
        push = _push(laws.first(len(names)), touch.penetration) * (1.0 if touch.gate is None else touch.gate)
        forces.append(jnp.sum(push[..., None] * touch.normal, -2))
        first = at.stop
    force = jnp.concatenate(forces, 1)
    torque = jnp.cross(arm, force)
    return jnp.concatenate([force, -jnp.sum(torque[..., None, :] * ways, -1) / p.lever], -1)


def _moves(scene: Joint) -> np.ndarray:
    """What ``_by_balls`` reads besides a ball's own place, by the coupling's unknowns (3, 5, b)."""
    slices = slices_of(scene)
    found = np.zeros((3, 5, max(piece.stop for piece in slices.values())))
    for body, name, first, sign in ((1, "head", 0, -1), (1, "turn", 3, 1), (2, "cage", 0, -1), (2, "tilt", 3, 1)):
        if name in slices:
            size = slices[name].stop - slices[name].start
            found[body, first : first + size, slices[name]] = sign * np.eye(size)
    return found


def _apart(scene: Joint, p: Problem, coupling: Array) -> Array:
    """Forces of pilots, loads and grounding at one instant on the coupling's unknowns (b,), as a gradient."""
    c, slices = p.c, slices_of(scene)
    loads = {"turn": p.torque[None] / p.lever, "head": c.programmes["axial_load"] * c.axes[1]}
    size = {name: piece.stop - piece.start for name, piece in slices.items()}
    found = p.spring * coupling + jnp.concatenate([loads.get(name, jnp.zeros(n)) for name, n in size.items()])
    if not scene.pilots:
        return found
    on_head = jnp.array([[name == "head_cage"] for name in scene.pilots])

    def depths(x: Array) -> Array:
        head, cage = (x[slices[name]] if name in slices else jnp.zeros(3) for name in ("head", "cage"))
        place = jnp.where(on_head, head, 0.0) - cage
        if c.bands is None:
            return contacts.pilots(c.pilot_clearance, c.pilot_hollow, place).penetration[:, 0]
        axis = tilted_axis(c, x[slices["tilt"]] / p.lever)[0] if "tilt" in slices else c.bisector
        return bands.band(c.bands, place, axis).penetration[:, 0]

    pushes, first = [], 0
    for names, laws in zip(groups(scene, PILOTS), c.pilot_laws, strict=True):
        pushes.append(_push(laws, depths(coupling)[first : first + len(names), None])[:, 0])
        first += len(names)
    return found + jnp.concatenate(pushes) @ jax.jacfwd(depths)(coupling)


def balance(scene: Joint, problem: Problem, at: Places) -> tuple[Places, Matrix]:
    """Unbalanced generalised forces (those that resist, as a gradient; 0 in equilibrium) and their derivative."""
    bodies = 3 if scene.has("cage_ball") else 2
    moves = _moves(scene)[:bodies]

    def one(ball: Array, seat: Array, torque: Array, moved: Array, coupling: Array) -> tuple[Places, Matrix]:
        p = problem._replace(seat=seat, torque=torque)
        turned = jnp.zeros((bodies, 5)).at[:2, 3].set(seat * p.lever) + moves @ coupling
        arm, angles = (ball + moved).T[:, None] + turned[:, :3], turned[:, 3:]
        # A body's forces follow from its own places and angles: one tangent serves all balls and bodies.
        ways = jnp.eye(5)

        def along(way: Array) -> tuple[Array, Array]:
            tangents = jnp.broadcast_to(way[:3], arm.shape), jnp.broadcast_to(way[3:], angles.shape)
            return jax.jvp(lambda *x: _by_balls(scene, p, *x), (arm, angles), tangents)

        force, stiff = jax.vmap(along, out_axes=(None, -1))(ways)
        column = jnp.einsum("nmij,mjb->nmib", stiff, moves)
        own, apart = jax.jacfwd(lambda x: (_apart(scene, p, x),) * 2, has_aux=True)(coupling)
        pushed = apart + jnp.einsum("nmi,mib->b", force, moves)
        return Places(jnp.sum(force[..., :3], 1).T + p.spring * moved, pushed), Matrix(
            jnp.transpose(jnp.sum(stiff[..., :3, :3], 1), (1, 2, 0)) + p.spring * jnp.eye(3)[..., None],
            jnp.transpose(jnp.sum(column[..., :3, :], 1), (1, 2, 0)),
            jnp.einsum("nmij,mib->bjn", stiff[..., :3], moves),
            own + jnp.einsum("nmib,mic->cb", column, moves),
            stiff[:, 0, :3, 3].T * p.lever,
        )

    return jax.vmap(one, -1, -1)(problem.ball, problem.seat, problem.torque, at.ball, at.coupling)


def _inverse3(m: Array) -> Array:
    """Inverse of (3, 3, ...) by cross products."""
    a, b, c = m[0], m[1], m[2]
    cross = [jnp.cross(x, y, axis=0) for x, y in ((b, c), (c, a), (a, b))]
    return jnp.stack(cross, 1) / jnp.sum(a * cross[0], 0)


def solve(m: Matrix, *rights: Places) -> list[Places]:
    """The arrowhead's solutions, linear in ``rights``: balls eliminated, the rest by Gauss-Jordan, no pivoting."""
    inverse = _inverse3(m.ball)
    none = jnp.zeros(())
    column = sum((inverse[:, j, None] * m.column[j] for j in range(3)), none)
    balls = [sum((inverse[:, j] * right.ball[j] for j in range(3)), none) for right in rights]
    coupling = m.coupling - jnp.sum(sum(m.row[:, j, None] * column[j] for j in range(3)), 2)
    lines = [
        right.coupling - jnp.sum(sum(m.row[:, j] * ball[j] for j in range(3)), 1)
        for right, ball in zip(rights, balls, strict=True)
    ]
    size = m.coupling.shape[0]

    # A loop and not copies: they were half of what the compiler had to read. The right sides stand apart from the
    # matrix, in which the loop is not linear: the reverse mode transposes them.
    def clear(k: Array, both: tuple[Array, Array]) -> tuple[Array, Array]:
        a, b = both
        others = (a[:, k] - (jnp.arange(size) == k)[:, None]) / a[k, k]
        return a - others[:, None] * a[k], b - others[:, None] * b[k]

    _, solved = jax.lax.fori_loop(0, size, clear, (coupling, jnp.stack(lines, 1)))
    return [Places(ball - jnp.sum(column * solved[:, i][:, None], 1), solved[:, i]) for i, ball in enumerate(balls)]
