"""What a mechanism looks like, what moves in it, and paths in clearances: from its bodies, joints and gaps.

A contact is drawn as its gap says (``AbstractGap.drawn``); a body as bars between its joints and contacts; an ideal joint
as a pin or a bar along which it slides. A mechanism says neither how thick a bar is nor how large a point: these are
fractions of the scene's size.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps import Look
from bcfj_jax.core import shapes
from bcfj_jax.core.shapes import Drawing, Shape
from bcfj_jax.core.vectors import WORLD, add, array, dot, scale, seen, spread, stacked, subtract
from bcfj_jax.mechanism import sizes
from bcfj_jax.mechanism.bodies import GROUND, Body, Part, rotated
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.model import Arrow, Orbit, Params, Pose, Scenery
from bcfj_jax.xla.programs import QUICK, program

# Of the scene's size: radius of a bar, of a line along which something slides, of a pin.
_BAR, _LINE, _PIN = 0.013, 0.004, 0.024
# Newton steps to the state in which every contact just closes; its matrix is singular where contacts are redundant.
_STEPS, _SINGULAR = 4, 1e-10
_NOTES = (
    "Bars, plates and points have no size in the model: they are drawn by the size of the scene.",
    "Bodies are drawn undeformed: they overlap by their penetration.",
)


def drawing(m: Dynamics, params: Params, size: float = 1.0, travel: Mapping[str, Any] | None = None) -> Drawing:
    """``AbstractModel.drawing`` of a mechanism."""
    p: Any = {name: np.asarray(value) for name, value in params.items()}
    still = (np.zeros(3), np.zeros(3))
    found: list[Shape] = []
    for c in m.contacts:
        low, high = (travel or {}).get(c.name, still)
        values = {name: float(np.max(x)) for name, x in c.coefficients(p).items()}
        drawn = c.gap.drawn(values, Look(size, np.asarray(low), np.asarray(high)))
        for which, (body, meshes) in enumerate(zip(c.between, drawn, strict=True)):
            tone = "ground" if body == GROUND else ("other", "body")[which]
            found += [Shape(body, mesh.moved(_marker(c, which, p)), tone) for mesh in meshes]
    found = _once(found)
    for b in m.ordered:
        found += _joint(m, b, p, size, [s for s in found if s.body == b.name], (travel or {}).get(b.name, still))
        found += _bars(m, b, p, size)
        if b.joint != "fixed" and all(s.body != b.name for s in found):  # Seen to move by a bar across its axis.
            bar = shapes.box(_PIN * size * np.array((2.5, 0.7, 0.7)))
            across = shapes.frame(np.array(sizes.axis(b.axis, b.name)))
            found.append(Shape(b.name, bar.moved(_at(b, p, "center"), across), "body"))
    return Drawing((*found, *_ground(m, p, size)), notes=_NOTES)


def _marker(c: Contact, which: int, p: Params) -> np.ndarray:
    """Place of a contact's marker in its body's axes [m]."""
    return np.array([float(np.max(x)) for x in c.marker(which, p)])


def _touching(m: Dynamics, body: str) -> list[tuple[Contact, int]]:
    """A body's contacts, and which of their two bodies it is."""
    return [(c, i) for c in m.contacts for i, name in enumerate(c.between) if name == body]


def _ground(m: Dynamics, p: Params, size: float) -> list[Shape]:
    """A line between the places on the ground about which bodies turn."""
    points = [_at(b, p) for b in m.ordered if b.parent == GROUND and b.joint == "hinge"]
    points += [_marker(c, i, p) for c, i in _touching(m, GROUND) if m.turning(c.between[1 - i])]
    ends = [(a, c) for a, c in pairwise(points) if np.linalg.norm(c - a) > 1e-3 * size]
    return [Shape(GROUND, shapes.rod(a, c, _LINE * size), "ground") for a, c in ends]


def _once(found: list[Shape]) -> list[Shape]:
    """Without shapes that another one equals: a ball that touches two others is drawn once."""
    kept: list[Shape] = []
    for shape in found:
        same = (s for s in kept if s.body == shape.body and np.array_equal(s.mesh.points, shape.mesh.points))
        if not any(same):
            kept.append(shape._replace(tone="ball") if _round(shape) else shape)
    return kept


def _round(shape: Shape) -> bool:
    size = np.linalg.norm(shape.mesh.points - shape.mesh.points.mean(axis=0), axis=1)
    return len(size) > 200 and bool(np.ptp(size) < 0.1 * size.max())


def _at(b: Body, p: Params, key: str = "at") -> np.ndarray:
    """Place of a body's joint in its parent's axes, or of its ``center`` in its own [m]."""
    return np.array([float(np.max(x)) for x in sizes.point(getattr(b, key), b.name, key, p)])


def _basis(b: Body, p: Params) -> np.ndarray:
    """The joint's axes as columns in those of the parent, n last."""
    n = np.array(sizes.axis(b.axis, b.name))
    if b.tilt is None:
        return shapes.frame(n)
    k, angle = np.array(sizes.axis(b.tilt[0], b.name)), float(np.max(sizes.length(b.tilt[1], b.name, "tilt", p)))
    return np.array(rotated(WORLD, tuple(k), angle), float).T @ shapes.frame(n)


def _joint(m: Dynamics, b: Body, p: Params, size: float, own: list[Shape], travel: Any) -> list[Shape]:
    """Its ideal joint on the parent: a pin about a hinge's axis; a line along a slide, with a block where arms hang on it."""
    place, basis = _at(b, p), _basis(b, p)
    if b.joint == "hinge":
        tone = "ground" if b.parent == GROUND else "other"
        return [Shape(b.parent, shapes.cylinder(_PIN * size, 2.2 * _PIN * size).moved(place, basis), tone)]
    if b.joint != "slide":
        return []
    along, tone = basis[:, 2], "ground" if b.parent == GROUND else "other"
    met = {c.between[1 - i] for c, i in _touching(m, b.name)}
    arms = {c.name for c in m.bodies if c.parent == b.name} | met
    if not any(m.turning(name) for name in arms):
        low, high = (np.asarray(x) @ along for x in travel)
        ends = (place + (low - 0.2 * size) * along, place + (high + 0.2 * size) * along)
        return [Shape(b.parent, shapes.rod(*ends, _LINE * size), tone)]
    # A slider: the block holds what it carries, between two rails.
    points = np.concatenate([s.mesh.points for s in own]) if own else np.zeros((1, 3))
    half = np.maximum(np.abs(points).max(axis=0), 2.0 * _PIN * size)
    across = np.cross((0.0, 0.0, 1.0) if abs(along[2]) < 0.7 else (1.0, 0.0, 0.0), along)
    wide = float(np.abs(across) @ half)
    axes = shapes.frame(np.cross(along, across), along)
    low, high = sorted(float(np.asarray(x) @ along) for x in travel)
    middle, reach = place + 0.5 * (low + high) * along, 0.5 * (high - low) + 1.9 * wide
    back = -axes[:, 2] * (float(np.abs(axes[:, 2]) @ half) + 0.1 * wide)
    parts = [Shape(b.name, shapes.box((1.5 * wide, 1.28 * wide, 0.1 * wide)).moved(back, axes), "other")]
    for sign in (-1.0, 1.0):
        pad = shapes.box((1.5 * wide, 0.16 * wide, 0.55 * wide))
        parts.append(Shape(b.name, pad.moved(sign * 1.12 * wide * across, axes), "other"))
        rail = shapes.box((reach, 0.1 * wide, 0.7 * wide))
        parts.append(Shape(b.parent, rail.moved(middle + sign * 1.4 * wide * across, axes), tone))
    return parts


def _bars(m: Dynamics, b: Body, p: Params, size: float) -> list[Shape]:
    """Bars of a body that turns, from end to end of what hangs on it and touches it."""
    if not m.turning(b.name):
        return []
    points = [np.zeros(3)] if b.joint in ("hinge", "spherical") else []
    points += [_at(c, p) for c in m.bodies if c.parent == b.name]
    points += [_marker(c, i, p) for c, i in _touching(m, b.name)]
    spread = np.ptp(np.stack(points), axis=0) if points else np.zeros(3)
    if not spread.any():
        return []
    order = sorted(points, key=lambda x: float(x[int(np.argmax(spread))]))
    pairs = [(a, c) for a, c in pairwise(order) if np.linalg.norm(c - a) > 1e-3 * spread.max()]
    return [Shape(b.name, shapes.rod(a, c, _BAR * size), "body") for a, c in pairs]


def scenery(m: Dynamics, t: Array, y: Array, p: Params) -> Scenery:
    """``AbstractModel.scenery`` of a mechanism."""
    now = m.instant(t, y, p)
    arrows, offsets = {}, {}
    for c in m.contacts:
        first, second = c.frames(now.bodies.parts, p)
        # The first member stands for all.
        offsets[c.name] = array(seen(first.axes, subtract(second.place, first.place))).reshape(-1, 3)[0]
        faces, members = m.faces_of(now, c.name), m.members[c.name]
        points = [stacked(add(second.place, face.lever), members) for face, _ in faces]
        force = jnp.sum(jnp.stack([stacked(touch.force, members) for _, touch in faces]), axis=0)
        normals = [spread(touch.normal, members) for _, touch in faces]
        best = jnp.argmax(jnp.stack(normals), axis=0)
        point = jnp.take_along_axis(jnp.stack(points), best[None, ..., None], axis=0)[0]
        arrows[c.name] = Arrow(point, force if c.between[1] != GROUND else -force)
    for b in m.ordered:
        if b.joint == "slide":
            part, parent = now.bodies.parts[b.name], now.bodies.parts[b.parent]
            at = sizes.point(b.at, b.name, "at", p)
            moved = subtract(seen(parent.axes, subtract(part.place, parent.place)), at)
            offsets[b.name] = array(moved).reshape(-1, 3)[0]
    return Scenery(_poses(m, now.bodies.parts), _poses(m, _closed(m, t, y, p)), arrows, offsets)


def _poses(m: Dynamics, parts: Mapping[str, Part]) -> dict[str, Pose]:
    found = {}
    for b in m.ordered:
        part, k = parts[b.name], b.members
        found[b.name] = Pose(stacked(part.place, k), jnp.stack([stacked(x, k) for x in part.axes], -1))
    return found


def _closed(m: Dynamics, t: Array, y: Array, p: Params) -> Mapping[str, Part]:
    """Bodies in the nearest state in which every contact just closes: no play, no penetration. Drives keep their places."""
    count = sum(k or 1 for *_, k in m._placed)
    rest = y[count:]

    def moving(places: Array) -> Mapping[str, Part]:
        q, v, _ = m.numbers(jnp.concatenate([places, rest]))
        return m.moving(t, q, v, p).parts

    def off(places: Array) -> Array:
        parts = moving(places)
        found = []
        for c in m.contacts:
            values = c.coefficients(p)
            first, second = c.frames(parts, p)
            for face in c.gap.faces(first, second, values):
                play = values["clearance"] if "clearance" in c.gap.needs else 0.0
                found.append(array(scale(face.depth + play, face.normal)).ravel())
        return jnp.concatenate(found)

    places = y[:count]
    if not count or not m.contacts:
        return moving(places)

    def step(_: Any, places: Array) -> Array:
        miss, slope = off(places), jax.jacfwd(off)(places)
        # J' (J J' + s)^-1 = (J' J + s)^-1 J', whichever is smaller: two boxes have 480 rows.
        wide = miss.size <= count
        square = slope @ slope.T if wide else slope.T @ slope
        square = square + _SINGULAR * (jnp.trace(square) + 1e-300) * jnp.eye(len(square))
        if wide:
            return places - slope.T @ jnp.linalg.solve(square, miss)
        return places - jnp.linalg.solve(square, slope.T @ miss)

    places = jax.lax.fori_loop(0, _STEPS, step, places)
    return moving(jnp.where(jnp.all(jnp.isfinite(places)), places, y[:count]))


def orbits(model: Dynamics, params: Params, run: Any) -> dict[str, Orbit]:
    """Of contacts whose gap is round, without members: the second body's marker seen from the first's."""
    names = _in_rings(model)
    if not names or run.trajectory is None:
        return {}
    arguments = (dict(params), run.times, run.trajectory)
    apart = program("orbits", _paths, (model,), arguments, QUICK)[0](*arguments)
    found = {}
    for name in names:
        contact = model.contact(name)
        outer, inner = contact.between
        x, y = apart[name]
        clearance = float(contact.coefficients(params)["clearance"])
        axes = (f"x of {outer}", f"y of {outer}")
        found[name] = Orbit(np.asarray(x), np.asarray(y), clearance, f"{inner} in {outer}", axes)
    return found


def _in_rings(model: Dynamics) -> list[str]:
    return [c.name for c in model.contacts if c.gap.round and not model.members[c.name]]


def _paths(model: Dynamics, params: Params, times: Array, states: Array) -> dict[str, tuple[Array, Array]]:
    return jax.vmap(lambda t, y: _apart(model, t, y, params))(times, states)


def _apart(model: Dynamics, t: Array, y: Array, p: Params) -> dict[str, tuple[Array, Array]]:
    """By contact with a round gap, its markers' distance [m] along the first body's x and y axes."""
    parts, found = model.instant(t, y, p, laws=False).bodies.parts, {}
    for name in _in_rings(model):
        c = model.contact(name)
        first, second = c.frames(parts, p)
        apart = subtract(second.place, first.place)
        found[name] = jnp.asarray(dot(first.axes[0], apart)), jnp.asarray(dot(first.axes[1], apart))
    return found
