"""Forces out of balance in the joint at rest, and their derivative: what ``quasistatic`` solves.

Massless parts, no friction, no damping. Arrays have the instants along their last axis, so that the processor's
the batch is over instants. Unknown are displacements from the zero-clearance position [m]; angles are times the pitch
radius. The derivative is an arrowhead: a 3 x 3 block a ball, and coupling coordinates of head and cage. It is the exact one, not
symmetric where a flank's sector ends (``contact.gaps.balls.sector``). Races, flanks, faces and pilots are axes of arrays and not
copies of the program, which would take the compiler as many times as long.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps.balls import sector
from bcfj_jax.core.kept import kept
from bcfj_jax.models.joint.bands import depth
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.law_pair import ContactLaws, LawPair
from bcfj_jax.models.joint.scene import Joint


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


def _dot(a: Any, b: Any) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _law(laws: ContactLaws | LawPair, penetration: Array) -> tuple[Array, Array]:
    """Normal force and stiffness at rest."""
    still = jnp.zeros_like(penetration)
    return jax.jvp(lambda d: laws.normal(d, still), (penetration,), (jnp.ones_like(penetration),))


class _Grooves(NamedTuple):
    """Forces of both races' grooves, as a gradient: of ball (3, 2, n, T), of turn (2, n, T); their derivatives."""

    ball: Array
    turn: Array
    by_ball: Array
    column: Array
    row: Array
    by_turn: Array


def _grooves(scene: Joint, c: Constants, place: Array, turn: Array) -> _Grooves:
    """``contacts.grooves`` at rest with its derivatives, for balls at ``place`` (3, 2, n, T) in races that are turned.

    In the track's own axes (across, radial at mid-track, the race's axis) the place is (t, x, z); with D = |(x, z)|
    the forces depend on (t, D) alone, and a turn (2, T) of the race changes (t, x) by (-x, t).
    """
    g = c.groove
    cosine, sine = np.cos(scene.azimuths)[:, None], np.sin(scene.azimuths)[:, None]
    far, near = jnp.cos(turn)[:, None], jnp.sin(turn)[:, None]
    cosine, sine = cosine * far - sine * near, sine * far + cosine * near
    radial, tangent, axis = (v.T[:, :, None, None] for v in (c.radial, c.tangent, c.axes))
    frame = (cosine * tangent - sine * radial, cosine * radial + sine * tangent, axis)
    across, mid, _ = frame
    place = place - g.offset[:, None, None] * axis
    t, x, z = kept(*(_dot(place, e) for e in frame))
    distance = jnp.sqrt(x * x + z * z)
    r_x, r_z = x / distance, z / distance
    # Flanks along the first axis.
    sign = g.gothic[:, None, None, None]
    y_t = t + sign * (g.flank * g.sine)
    y_a = distance - g.radius + g.side[:, None, None] * (g.flank * g.cosine)
    length = jnp.sqrt(y_t * y_t + y_a * y_a + 1e-24)
    n_t, n_a, length = kept(y_t / length, y_a / length, length)
    # Races, and balls or one for all.
    depth = length - g.flank - jnp.atleast_2d(g.clearance).T[..., None]
    # ``groove_laws`` has the races along the last axis but one.
    law = _law(c.groove_laws, depth.reshape(*depth.shape[:2], -1))
    force, stiff = (part.reshape(depth.shape) for part in law)
    edge = jnp.zeros_like(force)
    if g.gothic.size == 2:
        share, slope = jax.jvp(sector, (sign * n_t,), (jnp.ones_like(n_t),))
        edge = sign * slope * force / length
        force, stiff = share * force, share * stiff
    force, stiff, edge = kept(force, stiff, edge)
    bend = force / length
    stiff = stiff - bend
    e_t, e_a = edge * (1.0 - n_t * n_t), -edge * n_t * n_a
    g_t, g_a = jnp.sum(force * n_t, 0), jnp.sum(force * n_a, 0)
    j_tt = jnp.sum(stiff * n_t * n_t + bend + n_t * e_t, 0)
    j_ta, j_at = (jnp.sum(stiff * n_t * n_a + e, 0) for e in (n_t * e_a, n_a * e_t))
    j_aa = jnp.sum(stiff * n_a * n_a + bend + n_a * e_a, 0)
    g_t, g_a, j_tt, j_ta, j_at, j_aa, r_x, r_z, distance = kept(g_t, g_a, j_tt, j_ta, j_at, j_aa, r_x, r_z, distance)
    hoop = g_a / distance
    j_xz = (j_aa - hoop) * r_x * r_z
    j_xx, j_zz = j_aa * r_x * r_x + hoop * r_z * r_z, j_aa * r_z * r_z + hoop * r_x * r_x
    local = ((j_tt, j_ta * r_x, j_ta * r_z), (j_at * r_x, j_xx, j_xz), (j_at * r_z, j_xz, j_zz))
    g_x = g_a * r_x
    swing = t * g_x - x * g_t
    moves = [j[1] * t - j[0] * x for j in local]
    pulls = [local[1][k] * t - local[0][k] * x for k in range(3)]
    drift = g_x * across - g_t * mid
    world = [sum(j * f for j, f in zip(row, frame, strict=True)) for row in local]
    return _Grooves(
        g_t * across + g_x * mid + g_a * r_z * axis,
        swing,
        jnp.asarray(sum(e[:, None] * row for e, row in zip(frame, world, strict=True))),
        sum(m * e for m, e in zip(moves, frame, strict=True)) + drift,
        sum(m * e for m, e in zip(pulls, frame, strict=True)) + drift,
        moves[1] * t - moves[0] * x - t * g_t - x * g_x,
    )


def tilted_axis(c: Constants, tilt: Array) -> tuple[Array, list[Array], list[list[Array]]]:
    """Unit axis of the cage (3, T) tilted by (u, v) [rad], b + u e + v f made unit; its derivatives."""
    across = jnp.array([0.0, 1.0, 0.0])
    ways = [v[:, None] for v in (jnp.cross(across, c.bisector), across)]
    long = c.bisector[:, None] + tilt[0] * ways[0] + tilt[1] * ways[1]
    size = jnp.sqrt(_dot(long, long))
    axis = long / size
    along = [_dot(axis, e) for e in ways]
    first = [(e - s * axis) / size for e, s in zip(ways, along, strict=True)]
    second = [
        [-(first[j] * along[i] + axis * _dot(first[j], ways[i]) + first[i] * along[j]) / size for j in (0, 1)]
        for i in (0, 1)
    ]
    return axis, first, second


def _banded(scene: Joint, p: Problem, coupling: Array) -> tuple[Array, Array]:
    """Generalised forces of pilots that are bands on the coupling's unknowns (b, T), and their derivative (b, b, T)."""
    c, slices = p.c, slices_of(scene)
    bands = c.bands
    assert bands is not None and c.pilot_laws is not None
    on_head = jnp.array([[name == "head_cage"] for name in scene.pilots])

    def depths(x: Array) -> Array:
        head, cage = (x[slices[name]] if name in slices else jnp.zeros(3) for name in ("head", "cage"))
        axis = tilted_axis(c, x[slices["tilt"], None] / p.lever)[0][:, 0] if "tilt" in slices else c.bisector
        return depth(bands, jnp.where(on_head, head, 0.0) - cage, axis)

    def look(x: Array) -> tuple[Array, Array, Array]:
        return depths(x), jax.jacfwd(depths)(x), jax.jacfwd(jax.jacfwd(depths))(x)

    deep, slope, bend = jax.vmap(look, 1)(coupling)
    push, stiff = _law(c.pilot_laws, deep.T)
    block = jnp.einsum("kt,tki,tkj->ijt", stiff, slope, slope) + jnp.einsum("kt,tkij->ijt", push, bend)
    return jnp.einsum("kt,tki->it", push, slope), block


def balance(scene: Joint, p: Problem, at: Places) -> tuple[Places, Matrix]:
    """Unbalanced generalised forces (those that resist, as a gradient; 0 in equilibrium) and their derivative."""
    c, slices = p.c, slices_of(scene)
    size, shape = at.coupling.shape[0], at.ball.shape[1:]
    ball = p.ball + at.ball
    rest: dict[str, Array] = {name: p.spring * at.coupling[piece] for name, piece in slices.items()}
    eye = jnp.eye(3)[:, :, None]
    pairs: dict[tuple[str, str], Array] = {}
    column: dict[str, Array] = {}
    row: dict[str, Array] = {}

    def add(one: str, other: str, block: Array) -> None:
        pairs[one, other] = pairs[one, other] + block if (one, other) in pairs else block

    turn = p.seat + at.coupling[slices["turn"]][0] / p.lever
    still = jnp.zeros((3, shape[1]))
    head = at.coupling[slices["head"]] if "head" in slices else still
    cage = at.coupling[slices["cage"]] if "cage" in slices else still
    centres = jnp.array([0.0, 1.0])[:, None, None] * head[:, None, None]
    race = _Grooves(*kept(*_grooves(scene, c, ball[:, None] - centres, jnp.stack([p.seat, turn]))))
    force = p.spring * at.ball + jnp.sum(race.ball, 1)
    block = p.spring * eye[..., None] + jnp.sum(race.by_ball, 2)
    column["turn"], row["turn"] = race.column[:, None, 1] / p.lever, race.row[None, :, 1] / p.lever
    rest["turn"] += (jnp.sum(race.turn[1], 0) + p.torque)[None] / p.lever
    add("turn", "turn", jnp.sum(race.by_turn[1], 0)[None, None] / p.lever**2)
    if "head" in slices:
        rest["head"] += c.axial_load * c.axes[1][:, None] - jnp.sum(race.ball[:, 1], 1)
        column["head"] = row["head"] = -race.by_ball[:, :, 1]
        add("head", "head", jnp.sum(race.by_ball[:, :, 1], 2))
        add("head", "turn", -jnp.sum(column["turn"], 2))
        add("turn", "head", -jnp.sum(row["turn"], 2))
    if c.window_laws is not None:
        tilt = at.coupling[slices["tilt"]] / p.lever if "tilt" in slices else jnp.zeros((2, shape[1]))
        axis, first, second = tilted_axis(c, tilt)
        arm = ball - cage[:, None]
        height = _dot(arm, axis)
        faces = jnp.array([1.0, -1.0])[:, None, None]
        pushes, stiffs = _law(c.window_laws, faces * height - c.window_clearance.reshape(-1, 1))
        push, stiff, axis = kept(pushes[0] - pushes[1], stiffs[0] + stiffs[1], axis)
        face = stiff * (axis[:, None] * axis[None])[:, :, None]
        force, block = force + push * axis[:, None], block + face
        if "cage" in slices:
            reach = kept(*(_dot(arm, a[:, None]) for a in first))
            rest["cage"] -= jnp.sum(push, 0) * axis
            rest["tilt"] += jnp.stack([jnp.sum(push * r, 0) for r in reach]) / p.lever
            cross = [(stiff * r) * axis[:, None] + push * a[:, None] for r, a in zip(reach, first, strict=True)]
            column["cage"] = row["cage"] = -face
            column["tilt"] = jnp.stack(cross, 1) / p.lever
            row["tilt"] = jnp.stack(cross) / p.lever
            add("cage", "cage", jnp.sum(face, 2))
            add("cage", "tilt", -jnp.sum(column["tilt"], 2))
            add("tilt", "cage", -jnp.sum(row["tilt"], 2))
            bend = [
                [jnp.sum(stiff * reach[i] * reach[j] + push * _dot(arm, second[i][j][:, None]), 0) for j in (0, 1)]
                for i in (0, 1)
            ]
            add("tilt", "tilt", jnp.stack([jnp.stack(b) for b in bend]) / p.lever**2)
    if c.pilot_laws is not None and c.bands is None:
        ways = [("cage",) if name == "seat_cage" else ("head", "cage") for name in scene.pilots]
        place = jnp.stack([cage if way == ("cage",) else head - cage for way in ways], 1)
        distance = jnp.sqrt(_dot(place, place) + 1e-24)
        normal = place / distance
        push, stiff = _law(c.pilot_laws, distance - c.pilot_clearance[:, None])
        push, stiff, normal, distance = kept(push, stiff, normal, distance)
        bend = push / distance
        spring = (stiff - bend) * normal[:, None] * normal[None] + bend * eye[..., None]
        for index, way in enumerate(ways):
            signs = {part: 1.0 if part == way[0] else -1.0 for part in way if part in slices}
            for one, sign in signs.items():
                rest[one] += sign * (push * normal)[:, index]
                for other, back in signs.items():
                    add(one, other, sign * back * spring[:, :, index])
    names, sizes = list(slices), {name: piece.stop - piece.start for name, piece in slices.items()}
    lines = [
        [pairs.get((one, other), jnp.zeros((sizes[one], sizes[other], shape[1]))) for other in names] for one in names
    ]
    coupling = jnp.concatenate([jnp.concatenate(line, 1) for line in lines]) + p.spring * jnp.eye(size)[:, :, None]
    columns = [column.get(k, jnp.zeros((3, sizes[k], *shape))) for k in names]
    rows = [row.get(k, jnp.zeros((sizes[k], 3, *shape))) for k in names]
    total = jnp.concatenate([rest[k] for k in names])
    if c.bands is not None:
        pushed, stiffened = _banded(scene, p, at.coupling)
        total, coupling = total + pushed, coupling + stiffened
    residual = Places(force, total)
    return residual, Matrix(block, jnp.concatenate(columns, 1), jnp.concatenate(rows), coupling, race.column[:, 0])


def _inverse3(m: Array) -> Array:
    """Inverse of (3, 3, ...) by cross products."""
    a, b, c = m[0], m[1], m[2]
    cross = [jnp.cross(x, y, axis=0) for x, y in ((b, c), (c, a), (a, b))]
    return jnp.stack(cross, 1) / _dot(a, cross[0])


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
