"""The animation of a run: what is drawn against kinematics and forces, and the interactive figure."""

from __future__ import annotations

import json
import re
import struct
import sys
from html.parser import HTMLParser
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tiers
from joints import plain_joint
from scipy.spatial.transform import Rotation

import bcfj_jax as bj
from bcfj_jax.core import shapes
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.view import animation, export, fragment, gltf, painter
from bcfj_jax.models.joint.kinematic import nominal

pytestmark = pytest.mark.full


@pytest.fixture(scope="module")
def crank():
    scene = bj.scenes.slider_crank()
    params = scene.parameters()
    run = bj.simulate(scene, params, np.linspace(0.0, 0.012, 401))
    return scene, params, run, animation.animation(scene, params, run, "A slider-crank", 60)


def picked(of, run):
    """Samples that the frames are."""
    return np.searchsorted(run.times, of.times)


def test_shapes_face_outwards_and_have_their_sizes():
    for mesh in (
        shapes.ball(0.5),
        shapes.cylinder(0.3, 0.2, 0.1),
        shapes.box((0.1, 0.2, 0.3)),
        shapes.rod((1, 2, 3), (2, 2, 5), 0.1),
    ):
        a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
        area = np.cross(b - a, c - a)
        assert np.all(np.sum(area * mesh.normals[mesh.triangles[:, 0]], axis=1) > 0)
        assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1.0)
        # Gauss: a closed surface has no resultant area, and its volume is positive.
        assert np.allclose(area.sum(axis=0), 0.0, atol=1e-12)
        assert np.sum(a * area) > 0
    ball = shapes.ball(0.5, 60)
    corners = ball.points[ball.triangles]
    volume = np.einsum("mi,mi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.125, rel=0.01)


def cam(r, c):
    return c["cam_radius"] - jnp.hypot(r[0] - c["throw"], r[1])


def camshaft():
    """A cam of one's own: its outline is known to the function of its gap alone."""
    sizes = (bj.Quantity("cam_radius", "m", "radius of the cam", 0.0), bj.Quantity("throw", "m", "of the cam", 0.0))
    bodies = [
        bj.Body("camshaft", "hinge", mass=0.5, inertia=1e-4, drive=bj.Drive("constant", speed=40.0)),
        bj.Body("follower", "slide", axis="y", mass=0.2, start={"position": 0.0302}),
    ]
    gap = bj.gaps.from_depth(cam, ("cam_radius", "throw"), sizes)
    tip = bj.Contact("tip", ("camshaft", "follower"), gap, friction="coulomb")
    given = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.5, "friction_dynamic": 0.2, "friction_speed": 1e-2}
    push = bj.loads.Force("push", "follower", "-y", size=200.0)
    return bj.Mechanism("cam", bodies, [tip], [push], given=given | {"cam_radius": 0.03, "throw": 0.005}, end=0.05)


def yoke():
    bodies = [
        bj.Body("crank", "hinge", mass=0.3, inertia=1e-4, drive=bj.Drive("constant", speed=30.0)),
        bj.Body("yoke", "slide", axis="x", mass=2.0, start={"position": 0.05}),
    ]
    pin = bj.Contact("pin", ("yoke", "crank"), bj.gaps.PinInSlot(axis="y"), at=((0, 0, 0), (0.05, 0, 0)))
    given = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.3, "radius": 0.008, "clearance_pin": 5e-5}
    return bj.Mechanism(
        "yoke", bodies, [pin], [bj.loads.Force("push", "yoke", "-x", size=200.0)], given=given, end=0.05
    )


SHOWN = {
    "cam": camshaft, "yoke": yoke, "slider_crank": bj.scenes.slider_crank, "slider_guide": bj.scenes.slider_guide,
    "four_bar": bj.scenes.four_bar, "backlash": bj.scenes.backlash, "chain": bj.scenes.chain,
    "bounce": bj.scenes.bounce, "oblique_impact": bj.scenes.oblique_impact, "impact": bj.scenes.impact,
}  # fmt: skip


@pytest.mark.parametrize("name", tiers.ci(SHOWN, "impact"))
def test_pictures_show_the_tables_numbers(name):
    """Every arrow is as long as the force of its sample in forces.csv, and points as its readings in the world's axes."""
    scene = SHOWN[name]()
    params = scene.parameters()
    times = np.linspace(0.0, float(scene.horizon(params)), 201)
    asked = [f"{c.name}.force.{x}" for c in scene.contacts for x in "xyz"]
    run = bj.simulate(scene, params, times, accuracy=1e-3, read=asked)
    of = animation.animation(scene, params, run, count=60)
    at, some = picked(of, run), False
    back = {c.name: -1.0 if c.between[1] == "ground" else 1.0 for c in scene.contacts}
    for force in of.forces:
        pick = (at, force.member - 1) if force.member else (at,)
        world = np.stack([run.readings[f"{force.contact}.force.{x}"][pick] for x in "xyz"], axis=-1)
        top = np.max(np.abs(world))
        some = some or top > 0
        assert np.allclose(force.force, back[force.contact] * world, rtol=0, atol=1e-9 * top)
        # Components in the contact's own axes have the same size; those of several members are each their own.
        table = run.force[force.contact][pick]
        assert np.allclose(np.linalg.norm(table, axis=-1), np.linalg.norm(world, axis=-1), rtol=0, atol=1e-9 * top)
    assert some and of.peak == pytest.approx(max(np.linalg.norm(f.force, axis=1).max() for f in of.forces), rel=1e-12)
    # Every body can be seen.
    assert {track for track, *_ in of.parts} >= set(range(len(of.tracks)))


def test_a_gap_of_ones_own_is_drawn_where_its_penetration_is_zero():
    gap = bj.gaps.from_depth(cam, ("cam_radius", "throw"))
    look = bj.gaps.Look(0.1, np.array([-0.03, -0.03, 0.0]), np.array([0.04, 0.03, 0.0]))
    (wall,), _ = gap.drawn({"cam_radius": 0.03, "throw": 0.005}, look)
    away = wall.points[:, :2] - [0.005, 0.0]
    assert np.allclose(np.linalg.norm(away, axis=1), 0.03, atol=1e-4)
    assert np.ptp(np.arctan2(away[:, 1], away[:, 0])) > 6.0
    assert np.all(np.sum(wall.normals[:, :2] * away, axis=1) > 0.0)


def test_what_nothing_touches_is_seen_to_move():
    """A wheel, a table and a top that no contact and no body shows have a shape, no two of its axes alike about their joint's."""
    kinds = {"wheel": "hinge", "table": "slide", "top": "free"}
    bodies = [bj.Body(name, joint, mass=1.0, inertia=1.0) for name, joint in kinds.items()]
    scene = bj.Mechanism("shop", [*bodies, bj.Body("foot", "fixed", mass=1.0, inertia=1.0)])
    for name in kinds:
        (shape,) = (s for s in scene.drawing(scene.parameters()).shapes if s.body == name)
        across = np.ptp(shape.mesh.points, axis=0)[:2]
        assert across.max() > 2.0 * across.min() > 0.0


def test_turns_and_their_vectors():
    rng = np.random.default_rng(3)
    vectors = rng.normal(size=(40, 3))
    vectors[0], vectors[1] = 0.0, (np.pi - 1e-9, 0.0, 0.0)
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    still = np.zeros((40, 3))
    track = animation.Track("body", still, animation.quaternion(matrices), still, still)
    assert np.allclose(animation.posed(track, slice(None))[1], matrices)
    # The same turn as a deviation from axes along the world's.
    track = track._replace(quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (40, 1)), turn=vectors)
    assert np.allclose(animation.posed(track, slice(None))[1], matrices, atol=1e-9)
    for k in range(40):
        assert np.allclose(animation.posed(track, k)[1], matrices[k], atol=1e-9)


def test_a_body_is_drawn_where_it_is_and_an_arrow_is_the_force(crank):
    scene, params, run, of = crank
    at = picked(of, run)
    moved = jax.jit(jax.vmap(lambda t, y: scene.motions(t, y, params)))(run.times[at], run.trajectory[at])
    for track in of.tracks:
        motion, body = moved[track.name], scene.body(track.name)
        for k in (0, len(at) // 2, len(at) - 1):
            place, axes = animation.posed(track, k)
            arm = (0.5 * float(params["rod_length"]), 0.0, 0.0) if body.name == "rod" else (0.0, 0.0, 0.0)
            assert np.allclose(place + axes @ arm, motion.place[k], atol=1e-12)
            if motion.axes is not None:
                assert np.allclose(axes, motion.axes[k], atol=1e-9)
    read = jax.jit(jax.vmap(lambda t, y: scene.observe(t, y, params)))(run.times[at], run.trajectory[at])["journal"]
    (force,) = of.forces
    assert np.allclose(force.force, read.world, rtol=1e-9, atol=1e-9 * of.peak)
    # The arrow is on the pin, a radius away from its centre, against the force.
    k = int(np.argmax(np.linalg.norm(force.force, axis=1)))
    rod = of.tracks[force.track]
    place, axes = animation.posed(rod, k)
    pin = place + axes @ [float(params["rod_length"]), 0.0, 0.0]
    lever = place + force.lever[k] - pin
    assert np.linalg.norm(lever) == pytest.approx(float(params["radius"]), rel=1e-9)
    assert lever @ force.force[k] == pytest.approx(-float(params["radius"]) * of.peak, rel=1e-6)


def test_the_ideal_mechanism_has_no_play(crank):
    _, params, _, of = crank
    by_name = {t.name: t for t in of.tracks}
    for k in (0, 20, 45):
        rod, slider = (animation.posed(by_name[name], k, 0.0) for name in ("rod", "slider"))
        pin = rod[0] + rod[1] @ [float(params["rod_length"]), 0.0, 0.0]
        assert np.allclose(pin, slider[0], atol=1e-9)
        # What is exaggerated is the play: s times as far apart.
        s = 20.0
        apart = [animation.posed(by_name[n], k, s)[0] - animation.posed(by_name[n], k, 0.0)[0] for n in by_name]
        assert np.allclose(apart, [s * t.shift[k] for t in of.tracks])
    assert of.exaggeration in fragment.steps(of.most) and of.exaggeration > 1.0


@pytest.mark.slow
def test_play_that_is_seen_is_not_exaggerated():
    scene = bj.scenes.bounce()
    run = bj.simulate(scene, scene.parameters(), np.linspace(0.0, 0.3, 301))
    of = animation.animation(scene, scene.parameters(), run, count=50)
    assert of.exaggeration == of.most == 1.0
    assert "true to scale" in fragment.fragment(of)
    # The shortest contact is among the frames: each spell of time shows its largest force.
    assert of.peak == pytest.approx(np.abs(run.force["contact"]).max(), rel=1e-12)
    assert len(of.times) <= 52 and of.times[0] == 0.0 and of.times[-1] == run.times[-1]


def test_a_failed_run_is_shown_up_to_its_failure(crank):
    scene, params, run, _ = crank
    broken = np.array(run.trajectory)
    broken[100:] = np.nan
    of = animation.animation(scene, params, run._replace(trajectory=broken), count=60)
    assert of.times[-1] == run.times[99] and of.samples == 100
    assert animation.animation(scene, params, run._replace(trajectory=np.full_like(broken, np.nan)), count=60) is None


@pytest.fixture(scope="module")
def joint():
    scene = plain_joint()
    params = scene.parameters()
    times = np.linspace(0.0, 0.06, 31)
    states = np.array(jax.jit(jax.vmap(lambda t: nominal(scene, params, params["drive_speed"] * t)))(times))
    # Balls and head off their ideal places: some contacts press.
    states[:, :18] += 1e-5 * np.sin(np.arange(18))
    states[:, 18] += 2e-5
    force = {"seat_ball": np.ones((31, 6, 3))}
    run = bj.Run(times, force, {}, {}, {}, "ok", "", float("nan"), {}, trajectory=states)
    return scene, params, run, animation.animation(scene, params, run, "The joint", 31)


@pytest.mark.slow
def test_the_joint_is_drawn_where_it_is(joint):
    scene, params, run, of = joint
    prepared = jax.jit(scene.prepare)(params)
    at = picked(of, run)
    both = jax.jit(jax.vmap(lambda t, y: (scene.motions(t, y, prepared), scene.observe(t, y, prepared))))
    moved, read = both(run.times[at], run.trajectory[at])
    names = {t.name: t for t in of.tracks}
    assert list(names) == ["seat", "head", "cage", *(f"ball {k}" for k in range(1, 7))]
    for k in (0, len(at) - 1):
        for i in range(6):
            assert np.allclose(animation.posed(names[f"ball {i + 1}"], k)[0], moved["ball"].place[k, i], atol=1e-12)
        for name in ("seat", "head"):
            place, axes = animation.posed(names[name], k)
            assert np.allclose(place, moved[name].place[k], atol=1e-12)
            assert np.allclose(axes, moved[name].axes[k], atol=1e-9)
        # The ideal balls are in the middles of the cage's windows.
        cage, cage_axes = animation.posed(names["cage"], k, 0.0)
        for i in range(6):
            arm = cage_axes.T @ (animation.posed(names[f"ball {i + 1}"], k, 0.0)[0] - cage)
            assert abs(arm[2]) < 1e-9
            assert np.cos(np.arctan2(arm[1], arm[0]) - np.pi / 3.0 * i) > np.cos(0.02)
    for force in of.forces:
        world = np.asarray(read[force.contact].world)
        world = world[:, force.member - 1] if force.member else world
        assert np.allclose(force.force, world, rtol=1e-9, atol=1e-6)
    assert {f.contact for f in of.forces} == {c.name for c in scene.contacts}


def test_the_figure_of_a_joint_keeps_its_size(joint):
    of = joint[3]
    # As many frames as a report shows.
    longer = lambda x: np.resize(x, (animation.FRAMES, *x.shape[1:]))  # noqa: E731
    tracks = [
        t._replace(**{k: longer(getattr(t, k)) for k in ("place", "quaternion", "shift", "turn")}) for t in of.tracks
    ]
    forces = [f._replace(lever=longer(f.lever), force=longer(f.force)) for f in of.forces]
    text = fragment.fragment(of._replace(tracks=tracks, forces=forces, times=longer(of.times)))
    whole = len(text.encode())
    assert whole < 400_000
    assert "windows are drawn where the balls are" in text


class Outline(HTMLParser):
    """Open elements and their attributes; what closes nothing is an error."""

    def __init__(self):
        super().__init__()
        self.open, self.found = [], []

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in ("img", "input", "meta"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_the_figure_stands_alone(crank):
    of = crank[3]
    text = fragment.fragment(of)
    assert text == fragment.fragment(of)
    assert len(fragment._text("viewer.js").encode()) <= 30_000
    assert len(text.encode()) < 150_000
    assert not re.search(r"https?:|//[a-z]+\.[a-z]|@import|\burl\(|\beval\b|new Function|console\.", text)
    page = Outline()
    page.feed(text)
    assert not page.open
    tags = [tag for tag, _ in page.found]
    assert tags.count("canvas") == tags.count("img") == 1
    # No name of its own that a second figure on the page would have, too.
    assert not any("id" in attrs for _, attrs in page.found)
    canvas = next(attrs for tag, attrs in page.found if tag == "canvas")
    assert canvas["tabindex"] == "0" and canvas["aria-label"]
    assert all(attrs.get("alt") for tag, attrs in page.found if tag == "img")
    assert f"{of.exaggeration:g} times as large" in text
    assert f"{len(of.times)} of {of.samples} samples" in text


def test_the_data_of_a_figure_are_those_of_the_run(crank):
    import base64

    of = crank[3]
    data = fragment.content(of)
    raw = base64.b64decode(data["blob"])
    kinds = {"f": "<f4", "h": "<i2", "b": "i1", "H": "<u2"}

    def values(entry, width):
        kind, offset, length, *scale = entry
        found = np.frombuffer(raw, kinds[kind], length, offset).astype(float).reshape(-1, width)
        return found * (scale[0] if scale else 1.0)

    for track, entry in zip(of.tracks, data["tracks"], strict=True):
        assert np.allclose(values(entry["p"], 3), track.place, atol=of.size / 32767)
        assert np.allclose(values(entry["d"], 3), track.shift, atol=np.abs(track.shift).max() / 32767 + 1e-15)
    assert np.allclose(values(data["forces"][0]["f"], 3), of.forces[0].force, atol=of.peak / 32767)
    assert np.allclose(values(data["times"], 1)[:, 0], of.times, rtol=1e-6)
    for part in data["parts"]:
        mesh = data["meshes"][part["mesh"]]
        triangles = values(mesh["t"], 3)
        assert triangles.max() < mesh["p"][2] / 3
    assert json.loads(json.dumps(data)) is not None


def test_a_title_cannot_break_out_of_the_figure(crank):
    of = crank[3]._replace(title='</script><script>alert(1)</script>"')
    text = fragment.fragment(of)
    assert "alert(1)</script>" not in text


def test_the_still_picture_shows_the_arrow(crank):
    of = crank[3]
    k = fragment.strongest(of)
    picture = np.asarray(painter.paint(of, k, (320, 200)), float) / 255.0
    dark = np.array(painter.COLOURS[-1])
    none = of._replace(forces=[])
    without = np.asarray(painter.paint(none, k, (320, 200)), float) / 255.0
    seen, others = ((np.abs(x - dark).max(axis=2) < 0.25).sum() for x in (picture, without))
    assert seen > others + 50


def test_colours_of_forces_darken_with_every_step():
    linear = [
        np.where(np.array(c) > 0.04045, ((np.array(c) + 0.055) / 1.055) ** 2.4, np.array(c) / 12.92)
        for c in painter.COLOURS
    ]
    bright = [x @ [0.2126, 0.7152, 0.0722] for x in linear]
    assert all(a > 1.3 * b for a, b in pairwise(bright))


def test_a_model_without_shapes_has_no_animation(crank):
    class Bare:
        def level(self, name):
            return self

        def drawing(self, params, size=1.0, travel=None):
            return shapes.Drawing()

    assert animation.animation(Bare(), {}, crank[2]) is None  # pyright: ignore[reportArgumentType]


def chunks(data):
    """JSON and binary part of a binary glTF 2.0 of two chunks, whose lengths are those that it states."""
    assert struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    rest, second = struct.unpack_from("<I4s", data, 20 + size)
    assert (kind, second) == (b"JSON", b"BIN\0") and 28 + size + rest == len(data)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def test_gltf_reads_back(crank):
    of = crank[3]
    data = gltf.glb(of)
    assert data == gltf.glb(of)
    content, binary = chunks(data)
    assert len(binary) == -(-content["buffers"][0]["byteLength"] // 4) * 4
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

    def values(index):
        accessor = content["accessors"][index]
        view = content["bufferViews"][accessor["bufferView"]]
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= len(binary)
        assert view["byteLength"] == 4 * accessor["count"] * width[accessor["type"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        found = np.frombuffer(binary, kind, view["byteLength"] // 4, view["byteOffset"]).reshape(accessor["count"], -1)
        assert np.allclose(found.min(axis=0), accessor["min"]) and np.allclose(found.max(axis=0), accessor["max"])
        return found

    names = {node["name"]: i for i, node in enumerate(content["nodes"])}
    assert {"ground", "crank", "rod", "slider", "force journal"} <= set(names)
    children = [c for node in content["nodes"] for c in node.get("children", [])]
    assert sorted([*children, *content["scenes"][0]["nodes"]]) == list(range(len(content["nodes"])))
    for mesh in content["meshes"]:
        (part,) = mesh["primitives"]
        points, normals = (values(part["attributes"][key]) for key in ("POSITION", "NORMAL"))
        assert len(points) == len(normals) and np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
        assert values(part["indices"]).max() < len(points)
        assert part["material"] < len(content["materials"])
    (moving,) = content["animations"]
    keyed = {}
    for channel in moving["channels"]:
        sampler = moving["samplers"][channel["sampler"]]
        clock = values(sampler["input"])[:, 0]
        assert np.all(np.diff(clock) > 0) and clock[0] == 0.0 and clock[-1] == pytest.approx(12.0)
        target = channel["target"]
        keyed[content["nodes"][target["node"]]["name"], target["path"]] = values(sampler["output"])
        assert len(keyed[content["nodes"][target["node"]]["name"], target["path"]]) == len(of.times)
    assert len(keyed) == 2 * 3 + 3
    rod = next(t for t in of.tracks if t.name == "rod")
    for k in (0, 30):
        place, axes = animation.posed(rod, k, of.exaggeration)
        assert np.allclose(keyed["rod", "translation"][k], place, atol=1e-7)
        assert np.allclose(Rotation.from_quat(keyed["rod", "rotation"][k]).as_matrix(), axes, atol=1e-6)
        # The arrow's axis is along the force.
        turned = Rotation.from_quat(keyed["force journal", "rotation"][k]).as_matrix()
        size = np.linalg.norm(of.forces[0].force[k])
        if size > animation.LEAST * of.peak:
            assert np.allclose(turned[:, 2], of.forces[0].force[k] / size, atol=1e-6)


def test_movies(crank, tmp_path, monkeypatch):
    from PIL import Image

    monkeypatch.setattr(export, "_GIF", (4, 12))
    monkeypatch.setattr(export, "_MP4", (6, 25))
    scene, params, run, _ = crank
    path = bj.animate(scene, params, run, tmp_path / "a.gif")
    with Image.open(path) as found:
        assert found.size == export.SIZE and getattr(found, "n_frames", 1) == 4
    mp4 = bj.animate(scene, params, run, tmp_path / "a.mp4").read_bytes()
    assert mp4[4:8] == b"ftyp" and len(mp4) > 2000
    page = bj.animate(scene, params, run, tmp_path / "a.html", "A < B").read_text()
    assert "<title>A &lt; B</title>" in page and "<canvas" in page
    with pytest.raises(InputError, match="already"):
        bj.animate(scene, params, run, tmp_path / "a.gif")
    with pytest.raises(InputError, match="no format"):
        bj.animate(scene, params, run, tmp_path / "a.avi")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.gif", "a.html", "a.mp4"]


def test_a_missing_extra_is_said_before_the_run(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from bcfj_jax.cli import app

    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    done = CliRunner().invoke(app, ["simulate", "impact", "--animate", "mp4", "--out", "out"])
    assert done.exit_code == 2 and 'pip install "bcfj-jax[animation]"' in done.stderr
    assert not (tmp_path / "out").exists()
    done = CliRunner().invoke(app, ["simulate", "impact", "--animate", "avi", "--out", "out"])
    assert done.exit_code == 2 and "no format 'avi'" in done.stderr


def test_a_scene_in_motion_by_its_own_command(tmp_path, monkeypatch):
    """One file by the scene's name; refused before the run where it is there, for a format and a scene that are not known."""
    from commands import bcfj

    monkeypatch.chdir(tmp_path)
    body = '[[body]]\nname = "ball"\njoint = "slide"\naxis = "y"\nmass = 1.0\n'
    content = f'[scene]\nkind = "mechanism"\n{body}[[load]]\nkind = "gravity"\n[time]\nend = 0.1\nsamples = 50\n'
    (tmp_path / "fall.toml").write_text(content)
    done = bcfj("animate", "fall.toml", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["files"] == ["fall.html"] and "<canvas" in (tmp_path / "fall.html").read_text()
    for words, code, said in (
        (["fall.toml"], 2, "is there already"), (["impact", "--to", "avi"], 2, "no format 'avi'"), (["inpact"], 2, "impact"),
        (["fall.toml", "--to", "gif", "--dry-run"], 0, ""),
    ):  # fmt: skip
        done = bcfj("animate", *words)
        assert done.exit_code == code and said in done.stderr, done.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["fall.html", "fall.toml"]


@pytest.mark.slow
def test_the_command_writes_what_was_asked_for(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from bcfj_jax.cli import app

    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["simulate", "impact", "--animate", "gltf,html", "--out", "out"])
    assert done.exit_code == 0
    chunks((tmp_path / "out" / "animation.glb").read_bytes())
    assert "<canvas" in (tmp_path / "out" / "animation.html").read_text()
