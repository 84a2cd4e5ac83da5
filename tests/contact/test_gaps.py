"""Gaps against geometry in NumPy and searched surfaces: penetration, normal, point of contact, rate, derivatives."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gap_cases import BALL, BLOCK, CASES, GOTHIC, ZERO, R, found, frame, look, numbers, placed, rate, stacked, turned
from joints import unit
from scipy.optimize import minimize

from bcfj_jax.contact.gaps import GAPS, Frame, make_gap
from bcfj_jax.core.vectors import WORLD, array

every = pytest.mark.parametrize("key", CASES)


# --- penetration, by other means


def furthest(function, size: float) -> float:
    """Largest value [m] of a function over the sphere of directions, searched for."""
    best = -np.inf
    for start in ((0.3, 0.2), (-0.5, 2.2), (0.4, 4.3)):
        result = minimize(lambda x: -function(directed(x)) / size, start, method="BFGS", options={"gtol": 1e-9})
        best = max(best, -result.fun * size)
    return best


def directed(x) -> np.ndarray:
    return np.array([np.cos(x[0]) * np.cos(x[1]), np.cos(x[0]) * np.sin(x[1]), np.sin(x[0])])


def _plane(place, other, s, up):
    """The deepest point of the sphere."""
    up = np.asarray(up, dtype=float)
    radius = s.get("radius", 0.0)
    return [furthest(lambda n: -up @ (place + radius * n), 1e-2) - s.get("clearance", 0.0)]


def _walls(place, other, s, across, radius):
    """The deepest points of a ball or a pin between walls ``radius + clearance`` from the middle."""
    half = radius + s["clearance"]
    return [furthest(lambda n, k=k: k * np.dot(across, place + radius * n), 1e-2) - half for k in (1.0, -1.0)]


def _socket(place, other, s):
    """The point of the sphere furthest from the socket's centre."""
    inner = s["radius"] - s["clearance"]
    return [furthest(lambda n: np.linalg.norm(place + inner * n), 1e-2) - s["radius"]]


def _spheres(place, other, s):
    return [s["radius_a"] + furthest(lambda n: -np.linalg.norm(place + s["radius_b"] * n), 1e-2)]


def _bearing(place, other, s):
    """The point of the pin's circle, in a plane across the bearing, furthest from the bearing's axis."""
    ends = np.array([[1.0], [-1.0]]) * s["half_length"] * other[:, 2] if "half_length" in s else np.zeros((1, 3))
    depths = [
        furthest(lambda n, e=e: np.hypot(*(place + e + s["radius"] * n)[:2]), 1e-2) - (s["radius"] + s["clearance"])
        for e in ends
    ]
    return [depths] if len(ends) == 2 else depths


def _slider(place, other, s, across):
    corners = [(-1, 1), (1, 1), (-1, -1), (1, -1)]
    heights = [np.dot(across, place + other @ [i * s["half_length"], j * s["half_width"], 0.0]) for i, j in corners]
    wall = s["half_width"] + s["clearance"]
    return [[heights[0] - wall, heights[1] - wall, -heights[2] - wall, -heights[3] - wall]]


def _ways(place, s, ways, radius):
    """How far the round part of b reaches beyond the bearing or socket along directions of a."""
    return [[furthest(lambda n, w=w: w @ (place + radius * n), 1e-2) - radius - s["clearance"] for w in ways]]


def _pads(place, other, s):
    angle = 2 * np.pi * np.arange(5) / 5
    return _ways(place, s, np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), s["radius"])


def _rims(place, other, s):
    """The lowest points of both rims, among all."""
    rim = lambda x, k: place + other @ [s["radius"] * np.cos(x), s["radius"] * np.sin(x), k * s["half_length"]]  # noqa: E731
    angles = np.linspace(0, 2 * np.pi, 13)
    return [[max(-minimize(lambda x, k=k: 1e2 * rim(x[0], k)[2], [x], options={"gtol": 1e-9}).fun / 1e2 for x in angles)
             for k in (1, -1)]]  # fmt: skip


def _capsule(place, other, s):
    return [[_plane(place + k * s["half_length"] * other[:, 2], other, s, (0, 0, 1))[0] for k in (1, -1)]]


def _capsules(place, other, s):
    """Radii less the least distance of the segments, searched for."""
    far = lambda x: 1e3 * np.linalg.norm(place + x[1] * other[:, 2] - [0, 0, x[0]])  # noqa: E731
    bounds = [(-s["half_length_a"], s["half_length_a"]), (-s["half_length_b"], s["half_length_b"])]
    least = min(
        minimize(far, x, bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-10}).fun for x in ((0, 0), (0.04, -0.02))
    )
    return [s["radius_a"] + s["radius_b"] - 1e-3 * least]


def _box(place, other, s):
    half = np.array([s["half_length"], s["half_width"], s["half_height"]])
    far = lambda x: 1e3 * np.linalg.norm(place - x)  # noqa: E731
    bounds = [(-h, h) for h in half]
    return [s["radius"] - 1e-3 * minimize(far, 0.5 * half, bounds=bounds, options={"ftol": 1e-15, "gtol": 1e-10}).fun]


def _wedge(place, other, s, out):
    """Least distance from either face, half planes that begin at the edge."""
    out, aside = np.array(out), np.cross([0, 0, 1], out)
    g, low = s["half_angle"], []
    for k in (1, -1):
        face = -np.cos(g) * out + k * np.sin(g) * aside
        far = lambda x, f=face: 1e3 * np.linalg.norm(place - x[0] * f - [0, 0, x[1]])  # noqa: E731
        low.append(
            minimize(far, (0.01, 0.1), bounds=[(0, 1), (None, None)], options={"ftol": 1e-15, "gtol": 1e-10}).fun
        )
    return [s["radius"] - 1e-3 * min(low)]


SEARCHED = {
    "point": functools.partial(_plane, up=(0, 0, 1)),
    "stop": functools.partial(_plane, up=(-1, 0, 0)),
    "sphere": functools.partial(_plane, up=(0, 0, 1)),
    "slope": functools.partial(_plane, up=(0.6, 0, 0.8)),
    "spheres": _spheres,
    "socket": _socket,
    "socket-of-b": _socket,
    "bearing": _bearing,
    "ends": _bearing,
    "slot": functools.partial(_walls, across=(0, 1, 0), radius=R),
    "slot-y": functools.partial(_walls, across=(-1, 0, 0), radius=R),
    "slot-oblique": functools.partial(_walls, across=(-0.8, 0.6, 0), radius=R),
    "slider": functools.partial(_slider, across=(0, 1, 0)),
    "slider-y": functools.partial(_slider, across=(1, 0, 0)),
    "stops": functools.partial(_walls, across=(1, 0, 0), radius=0.0),
    "window": functools.partial(_walls, across=(0, 0, 1), radius=R),
    "pads": _pads,
    "socket-pads": lambda place, other, s: _ways(
        place, s, np.repeat(np.eye(3), 2, axis=0) * np.tile([1, -1], 3)[:, None], s["radius"] - s["clearance"]
    ),
    "capsule": _capsule,
    "cylinder": _rims,
    "capsules": _capsules,
    "capsules-end": _capsules,
    "on-face": _box,
    "on-edge": _box,
    "on-corner": _box,
    "wedge": functools.partial(_wedge, out=(0, 1, 0)),
    "wedge-edge": functools.partial(_wedge, out=(-1, 0, 0)),
}
# Searched to the square root of rounding; capsules also miss what keeps parallel ones apart.
LOOSE = {"capsules": 2e-9, "capsules-end": 2e-9} | dict.fromkeys(
    ("on-face", "on-edge", "on-corner", "wedge", "wedge-edge"), 1e-9
)


@pytest.mark.parametrize("key", SEARCHED)
def test_penetration_is_the_overlap_of_the_surfaces(key):
    case = CASES[key]
    for seed in range(3):
        (axes, start, other, place), (depth, *_) = look(case, seed)
        wanted = SEARCHED[key](axes.T @ (place - start), axes.T @ other, case.sizes)
        assert depth.shape == np.shape(wanted)
        assert np.allclose(depth, wanted, rtol=0, atol=1e-14 if "slider" in key else LOOSE.get(key, 1e-11))


@pytest.mark.parametrize("key", [key for key in CASES if key.startswith("groove")])
def test_groove_is_a_torus(key):
    """Ball radius less the least distance of the ball's centre from any point of the torus, searched for."""
    case = CASES[key]
    (axes, start, _, place), (depth, *_) = look(case, 5)
    s, kappa = case.sizes, 1.0 if case.options["side"] == "outer" else -1.0
    signs = (1.0, -1.0) if case.options["section"] == "gothic" else (0.0,)
    q = R * (2 * s["conformity"] - 1) if "conformity" in s else 0.0
    angle, circle = s.get("contact_angle", 0.0), np.hypot(s["pitch_radius"], s["offset"])
    tracks = np.atleast_2d((place - start) @ axes)
    for i in {0, len(tracks) // 3}:
        f = 2 * np.pi * i / len(tracks)
        # The race's frame turned to the track: x outward in its plane, y across it.
        local = turned(f, np.array([0.0, 0.0, 1.0])).T @ tracks[i] - np.array([0, 0, kappa * s["offset"]])
        flat, high = np.hypot(local[0], local[2]), local[1]
        for face, sign in enumerate(signs):
            middle = circle - kappa * q * np.cos(angle)
            level, tube = -sign * q * np.sin(angle), R + q + s["clearance"]

            def distance(x, middle=middle, level=level, tube=tube, flat=flat, high=high):
                reach = middle + tube * np.cos(x[0])
                surface = np.array([reach * np.cos(x[1]), reach * np.sin(x[1]), level + tube * np.sin(x[0])])
                return 1e3 * np.linalg.norm(surface - [flat, 0.0, high])

            starts = [(v, 0.1) for v in np.linspace(0, 2 * np.pi, 6, endpoint=False)]
            least = min(minimize(distance, x, method="BFGS", options={"gtol": 1e-7}).fun for x in starts)
            assert depth.reshape(len(signs), -1)[face, i] == pytest.approx(R - 1e-3 * least, abs=1e-10)


def test_slider_of_flores_leine_glocker():
    """Physics sheet 4 (B4): g1,2 = d/2 - (l1 s1 + l2 s2 -+ a s3 + b c3), g3,4 = d/2 + l1 s1 + l2 s2 -+ a s3 - b c3."""
    l1, l2, a, b, c = 0.153, 0.306, 0.05, 0.025, 1e-3
    t1, t2, t3 = 0.7, -0.3175, 0.013
    y, d = l1 * np.sin(t1) + l2 * np.sin(t2), 2 * (b + c)
    s3, c3 = np.sin(t3), np.cos(t3)
    g = [d / 2 - (y - a * s3 + b * c3), d / 2 - (y + a * s3 + b * c3), d / 2 + y - a * s3 - b * c3]
    g.append(d / 2 + y + a * s3 - b * c3)
    block = Frame((jnp.asarray(0.44), jnp.asarray(y), 0.0), ((c3, s3, 0.0), (-s3, c3, 0.0), (0.0, 0.0, 1.0)))
    (face,) = make_gap("slider_in_guide").faces(Frame((0.0, 0.0, 0.0), WORLD), block, numbers(BLOCK))
    assert np.allclose(face.depth, -np.array(g), rtol=0, atol=1e-16)
    assert np.array_equal(face.normal[1], [1, 1, -1, -1])


# --- normal, point of contact, rate


@every
def test_normal_is_the_gradient_of_the_penetration(key):
    case = CASES[key]
    for seed in range(3):
        (axes, start, other, place), (depth, normal, _, gate) = look(case, seed)
        assert np.allclose(np.linalg.norm(normal, axis=-1), 1.0, rtol=0, atol=1e-12)
        assert np.all((gate >= 0) & (gate <= 1)) and gate.shape == depth.shape
        a, b, c = frame(start, axes), frame(place, other), numbers(case.sizes)
        still = jax.tree.map(jnp.zeros_like, (a, b))
        step = 1e-9
        for i in range(3):
            way = tuple(jnp.full_like(x, float(i == j)) for j, x in enumerate(b.place))
            _, (slope, *_) = rate(case.gap, a, b, (still[0], still[1]._replace(place=way)), c)
            assert np.allclose(slope, normal[..., i], rtol=0, atol=1e-9)
            # And by finite differences, since a wrong chain rule would be in both.
            shifts = [place + s * step * np.eye(3)[i] for s in (1, -1)]
            up, down = (np.asarray(found(case.gap, a, frame(x, other), c)[0]) for x in shifts)
            assert np.allclose((up - down) / (2 * step), normal[..., i], rtol=0, atol=2e-5)


@every
def test_rate_is_the_closing_speed_at_the_point_of_contact(key):
    """d' = n . (v_b - v_a) there, for every rigid motion of both bodies: what the mechanism relies on."""
    case = CASES[key]
    for seed in range(5):
        (axes, start, other, place), (_, normal, lever, _) = look(case, seed)
        rng = np.random.default_rng(100 + seed)
        (va, vb), (wa, wb) = 2.0 * rng.normal(size=(2, 3)), 30.0 * rng.normal(size=(2, 3))
        moves = tuple(
            frame(np.broadcast_to(v, np.shape(x)), np.cross(w, m.T).T)
            for v, w, x, m in ((va, wa, start, axes), (vb, wb, place, other))
        )
        _, (slope, *_) = rate(case.gap, frame(start, axes), frame(place, other), moves, numbers(case.sizes))
        speed = vb + np.cross(wb, lever) - va - np.cross(wa, place - start + lever)
        assert np.max(abs(speed)) > 0.1
        wanted = np.sum(normal * speed, -1)
        assert np.allclose(slope, wanted, rtol=1e-9, atol=1e-9 * np.max(abs(speed)))


@every
def test_point_of_contact(key):
    """It lies on b's surface, on its far side along the normal; in a socket, on the socket; between two spheres."""
    case, s = CASES[key], CASES[key].sizes
    (_, start, other, place), (depth, normal, lever, _) = look(case, 1)
    if case.name in ("point_on_plane", "two_sided_stop"):
        assert np.all(lever == 0.0)
    elif case.name in ("capsule_on_plane", "cylinder_on_plane"):
        # On the surface, and as far along the cylinder as its end.
        local, along = lever @ other, [s["half_length"], -s["half_length"]]
        along = np.repeat(along, case.options.get("points", 1))
        beyond = s["radius"] * (normal @ other) if case.name == "capsule_on_plane" else 0.0
        assert np.allclose((local - beyond)[..., 2], [along], atol=1e-15)
        if case.name == "cylinder_on_plane":
            assert np.allclose(np.hypot(local[..., 0], local[..., 1]), s["radius"], rtol=1e-12)
    elif case.name == "capsule_on_capsule":
        # As far inside of either.
        for centre, way, which, sign in ((start, look(case, 1)[0][0][:, 2], "a", -1.0), (place, other[:, 2], "b", 1.0)):
            point = place + lever[0] - centre
            reach = np.clip(point @ way, -s[f"half_length_{which}"], s[f"half_length_{which}"])
            arm = sign * (point - reach * way) @ normal[0]
            assert s[f"radius_{which}"] - arm == pytest.approx(0.5 * depth[0], abs=1e-11)
    elif case.name == "sphere_in_socket" and not case.options.get("pads"):
        point = place + lever - start
        assert np.allclose(np.linalg.norm(point, axis=-1), s["radius"], rtol=1e-14)
        inner = s["radius"] - s["clearance"]
        assert np.allclose(np.linalg.norm(lever, axis=-1), inner - depth, rtol=1e-12)
    elif case.name == "box_on_box":
        # Corners of b: as far from them along the normal as half of what they are apart from a.
        corners = np.array(list(itertools.product((-1, 1), repeat=3))) * [
            s[f"half_{k}_b"] - 4e-3 for k in ("length", "width", "height")
        ]
        arm = lever[0, :8] - corners @ other.T
        assert np.allclose(arm, 0.5 * (2 * 4e-3 - depth[0, :8, None]) * normal[0, :8], atol=1e-15)
    elif case.name == "sphere_on_sphere":
        # As far inside of either sphere.
        reach = [np.linalg.norm(place + lever - centre, axis=-1) for centre in (start, place)]
        assert np.allclose([s["radius_a"] - reach[0], s["radius_b"] - reach[1]], 0.5 * depth, rtol=0, atol=1e-15)
    elif case.name == "box_on_plane":
        corners = lever @ other / [s["half_length"], s["half_width"], s["half_height"]]
        assert np.allclose(corners, [list(itertools.product((-1, 1), repeat=3))], atol=1e-15)
    elif case.name == "slider_in_guide":
        corners = lever @ other
        size = [s["half_length"], s["half_width"], 0.0]
        assert np.allclose(corners, [[[-1, 1, 0], [1, 1, 0], [-1, -1, 0], [1, -1, 0]]] * np.array(size), atol=1e-15)
    else:
        radius = s.get("radius", s.get("radius_b", s.get("ball_radius")))
        radius = radius - s["clearance"] if case.name == "sphere_in_socket" else radius
        arm = lever
        if case.options.get("ends"):
            ends = np.repeat([[1.0], [-1.0]], case.options.get("pads", 1), axis=0)
            arm = lever - ends * s["half_length"] * other[:, 2]
        assert np.allclose(arm, radius * normal, rtol=0, atol=1e-16)


@every
def test_frame_indifference(key):
    case = CASES[key]
    (axes, start, other, place), (depth, normal, lever, gate) = look(case, 2)
    rng = np.random.default_rng(9)
    q, shift = turned(2.1, unit(rng)), rng.normal(size=3)
    a, b = frame(q @ start + shift, q @ axes), frame(place @ q.T + shift, q @ other)
    c = numbers(case.sizes)
    again = found(case.gap, a, b, c)
    assert np.allclose(again[0], depth, rtol=0, atol=1e-14)
    # The direction of 50 um of eccentricity, of places that are known to 1e-16 m.
    assert np.allclose(again[1], normal @ q.T, rtol=0, atol=1e-9)
    assert np.allclose(again[2], lever @ q.T, rtol=0, atol=1e-11)
    assert np.allclose(again[3], gate, rtol=0, atol=1e-9)
    one = array(case.gap.axial(frame(start, axes), frame(place, other), c))
    two = array(case.gap.axial(a, b, c))
    assert np.allclose(two, np.asarray(one) @ q.T, rtol=0, atol=1e-12)


def test_axial_directions():
    wanted = {"point": (0, 0), "stop": (0, 2), "sphere": (0, 0), "slope": (0, 0), "spheres": (0, 2), "socket": (0, 2)}
    wanted |= {"socket-of-b": (1, 2), "bearing": (0, 2), "ends": (0, 2), "slot": (0, 0), "slot-y": (0, 1)}
    wanted |= {"box": (0, 0), "box-above": (0, 2), "slider": (0, 0), "stops": (0, 2)}
    for key, (body, axis) in wanted.items():
        axes, start, other, place = placed(CASES[key], 6)
        got = array(CASES[key].gap.axial(frame(start, axes), frame(place, other), numbers(CASES[key].sizes)))
        assert np.allclose(got, (axes, other)[body][:, axis], rtol=0, atol=1e-15), key
    assert {name for name, kind in GAPS.items() if kind.signed} == {
        "pin_in_slot",
        "two_sided_stop",
        "ball_between_planes",
    }


# The normal of a sphere on a sphere, or in one, points everywhere.
@pytest.mark.parametrize("key", [k for k in CASES if CASES[k].name not in ("sphere_on_sphere", "sphere_in_socket")])
def test_axial_direction_is_not_the_normal(key):
    case = CASES[key]
    (axes, start, other, place), (_, normal, _, _) = look(case, 3)
    axial = np.asarray(array(case.gap.axial(frame(start, axes), frame(place, other), numbers(case.sizes))))
    axial = axial / np.linalg.norm(axial, axis=-1, keepdims=True)
    cosine = np.abs(np.sum(normal * axial, -1))
    assert np.all(cosine < (0.01 if case.name == "ball_between_planes" else 0.71))
    if case.name == "ball_in_groove":
        assert np.all(cosine < 1e-12)


# --- members, zeros, derivatives


@pytest.mark.full
@pytest.mark.parametrize("key", [key for key in CASES if key != "boxes"])  # Its members are corners and pairs of edges.
def test_members_side_by_side(key):
    """A body of members gives each what it has alone, each with a coefficient of its own."""
    case = CASES[key]
    gap, k = case.gap, case.gap.members or 4
    axes, start, other, _ = placed(case, 4)
    rng = np.random.default_rng(4)
    places = np.array([np.reshape(case.place(rng), (-1, 3))[i if case.options.get("tracks") else 0] for i in range(k)])
    places = start + places @ axes.T
    scatter = np.linspace(0.9, 1.1, k)
    many = {name: x * scatter for name, x in case.sizes.items()}
    together = found(gap, frame(start, axes), frame(places, other), numbers(many))
    for i in range(k):
        one = {name: x[i] for name, x in many.items()}
        alone = found(gap, frame(start, axes), frame(places[i], other), numbers(one))
        for x, y in zip(together, alone, strict=True):
            assert np.allclose(x[:, i], y[:, i] if gap.members else y, rtol=0, atol=1e-15)


COINCIDENT = {
    "spheres": ZERO,
    "socket": ZERO,
    "bearing": ZERO,
    "slot": ZERO,
    "slider": ZERO,
    "stops": ZERO,
    "window": ZERO,
    "groove-outer-circular-0": CASES["groove-outer-circular-0"].track(0),
    "groove-inner-circular-0": np.array([0.0, 0.0, -BALL["offset"]]),
    # The centre of a flank's circle: (T, A) = -q (sin, cos), in the plane of the race's axis.
    "groove-outer-gothic-0": np.array([0.0, 0.0, GOTHIC["offset"]])
    + np.array(
        [np.hypot(0.0355, 4.5e-3) - 3.2e-4 * np.cos(GOTHIC["contact_angle"]), -3.2e-4 * np.sin(np.radians(40)), 0]
    ),
}


@pytest.mark.full
@pytest.mark.parametrize("key", COINCIDENT)
def test_derivatives_are_finite_where_centres_coincide(key):
    case, c = CASES[key], numbers(CASES[key].sizes)

    def everything(x):
        b = Frame((x[0], x[1], x[2]), WORLD)
        parts = stacked(case.gap, Frame((0.0, 0.0, 0.0), WORLD), b, c)
        axial = array(case.gap.axial(Frame((0.0, 0.0, 0.0), WORLD), b, c))
        return jnp.concatenate([jnp.ravel(part) for part in (*parts, axial)])

    at = jnp.asarray(COINCIDENT[key])
    whole = jax.jit(lambda x: (everything(x), jax.jacrev(everything)(x), jax.jacfwd(jax.jacrev(everything))(x)))
    for part in whole(at):
        assert np.all(np.isfinite(part))
    if key in ("spheres", "socket", "bearing", "groove-outer-circular-0"):
        # No direction, hence no force.
        depth, normal, _, _ = found(case.gap, frame(ZERO, np.eye(3)), frame(np.asarray(at), np.eye(3)), c)
        assert np.max(abs(np.asarray(normal))) < 1e-4 and np.all(np.isfinite(depth))


def test_what_is_zero_leaves_the_program():
    """A planar mechanism has no third component."""
    turn = jnp.asarray(0.2)
    plane = ((jnp.cos(turn), jnp.sin(turn), 0.0), (-jnp.sin(turn), jnp.cos(turn), 0.0), (0.0, 0.0, 1.0))
    a, b = (
        Frame((jnp.asarray(1.0), jnp.asarray(2.0), 0.0), plane),
        Frame((jnp.asarray(1.1), jnp.asarray(2.0), 0.0), plane),
    )
    for key in ("stop", "spheres", "socket", "bearing", "slot", "slider", "stops"):
        for face in CASES[key].gap.faces(a, b, numbers(CASES[key].sizes)):
            assert isinstance(face.normal[2], float) and face.normal[2] == 0.0, key
            assert isinstance(face.lever[2], float) and face.lever[2] == 0.0, key


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.05, 0.0, 0.02), (-0.049, 0.0, 0.019), (0.05, -0.03, 0.02)])
def test_a_centre_equally_near_to_faces_of_a_box_has_one_of_their_normals(place):
    """In the middle of the box, on its edge or corner, and inside by as much from two faces; the rate is the normal's."""
    case = CASES["on-face"]
    b = lambda x: Frame((x[0], x[1], x[2]), WORLD)  # noqa: E731
    deep = lambda x: case.gap.faces(Frame((0.0, 0.0, 0.0), WORLD), b(x), numbers(case.sizes))[0]  # noqa: E731
    face, slope = deep(jnp.asarray(place)), jax.grad(lambda x: deep(x).depth)(jnp.asarray(place))
    assert sorted(np.abs(face.normal)) == [0.0, 0.0, 1.0]
    np.testing.assert_array_equal(slope, face.normal)


def test_a_cylinder_that_nearly_stands_closes_by_its_rim():
    """Tilted by 1e-9 about x it bears a radius beside its axis: so its depth changes with the tilt."""
    c = numbers(CASES["cylinder"].sizes)

    def depths(tilt):
        axes = ((1.0, 0.0, 0.0), (0.0, jnp.cos(tilt), jnp.sin(tilt)), (0.0, -jnp.sin(tilt), jnp.cos(tilt)))
        return CASES["cylinder"].gap.faces(Frame(ZERO, WORLD), Frame((0.0, 0.0, 0.03), axes), c)[0].depth

    np.testing.assert_allclose(jax.jacfwd(depths)(jnp.asarray(1e-9)), R, rtol=1e-6)


def test_two_spheres_may_be_exchanged():
    """With their radii: the same penetration and the same point in space, the opposite normal, and bristles that turn alike."""
    case = CASES["spheres"]
    axes, start, other, place = placed(case, 7)
    s = case.sizes
    back = {"radius_a": s["radius_b"], "radius_b": s["radius_a"]}
    depth, normal, lever, _ = found(case.gap, frame(start, axes), frame(place, other), numbers(s))
    again = found(case.gap, frame(place, other), frame(start, axes), numbers(back))
    assert np.allclose(again[0], depth, rtol=0, atol=1e-16) and np.allclose(again[1], -normal, rtol=0, atol=1e-15)
    assert np.allclose(start + again[2], place + lever, rtol=0, atol=1e-15)
    assert case.gap.carried((1.0, 2.0, 3.0), (5.0, 0.0, 1.0)) == case.gap.carried((5.0, 0.0, 1.0), (1.0, 2.0, 3.0))
