"""An animation as binary glTF 2.0 (``.glb``): a node for each body and each force, with keyframes.

Clearances are exaggerated as the animation says; the file states it, and how much faster or slower than the run it plays.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from bcfj_jax.core.shapes import Mesh, frame
from bcfj_jax.io.provenance import version
from bcfj_jax.io.view.animation import ARROW, LEAST, Animation, posed, quaternion
from bcfj_jax.io.view.painter import COLOURS, TONES, arrow, arrow_share

_FLOAT, _INDEX = 5126, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
# Hidden where there is no force; a viewer may refuse a scale of 0.
_NOTHING = 1e-6


class _Buffer:
    """The binary part, and the tables of JSON that describe it."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def put(self, values: np.ndarray, kind: str, target: int | None = None) -> int:
        """Add an array of "SCALAR", "VEC3" or "VEC4"; the index of its accessor."""
        whole = np.issubdtype(values.dtype, np.integer)
        raw = np.ascontiguousarray(values, "<u4" if whole else "<f4")
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": raw.nbytes}
        self.views.append(view | ({"target": target} if target else {}))
        self.data += raw.tobytes()
        rows = raw.reshape(len(raw), -1)
        self.accessors.append({
            "bufferView": len(self.views) - 1, "componentType": _INDEX if whole else _FLOAT, "count": len(raw),
            "type": kind, "min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist(),
        })  # fmt: skip
        return len(self.accessors) - 1

    def mesh(self, mesh: Mesh, material: int) -> dict[str, Any]:
        """A mesh of one primitive."""
        size = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
        attributes = {
            "POSITION": self.put(mesh.points, "VEC3", _ARRAY),
            "NORMAL": self.put(mesh.normals / size, "VEC3", _ARRAY),
        }
        indices = self.put(mesh.triangles.reshape(-1).astype(np.uint32), "SCALAR", _ELEMENTS)
        return {"primitives": [{"attributes": attributes, "indices": indices, "material": material}]}


def glb(of: Animation, lasts: float = 12.0) -> bytes:
    """The file's content; the run is played in ``lasts`` seconds."""
    buffer = _Buffer()
    tones = list(TONES)
    materials = [_material(name, TONES[name]) for name in tones]
    materials.append(_material("force", (*COLOURS[-1], 1.0)))
    meshes: list[dict[str, Any]] = []
    nodes: list[dict[str, Any]] = []
    kept: dict[tuple[int, str], int] = {}
    channels: list[dict[str, Any]] = []
    samplers: list[dict[str, Any]] = []
    span = float(of.times[-1] - of.times[0])
    clock = buffer.put((of.times - of.times[0]) * lasts / span, "SCALAR")

    def keyed(node: int, path: str, values: np.ndarray, kind: str) -> None:
        samplers.append({"input": clock, "output": buffer.put(values, kind), "interpolation": "LINEAR"})
        channels.append({"sampler": len(samplers) - 1, "target": {"node": node, "path": path}})

    def shape(mesh: Mesh, tone: str) -> int:
        if (id(mesh), tone) not in kept:
            own = (
                mesh if mesh.slack is None else mesh._replace(points=mesh.points + (of.exaggeration - 1.0) * mesh.slack)
            )
            kept[id(mesh), tone] = len(meshes)
            meshes.append(buffer.mesh(own, tones.index(tone)) | {"name": tone})
        return kept[id(mesh), tone]

    bodies = [[(mesh, tone) for track, mesh, tone in of.parts if track == k] for k in range(-1, len(of.tracks))]
    poses = [[posed(t, k, of.exaggeration) for k in range(len(of.times))] for t in of.tracks]
    for k, parts in enumerate(bodies):
        name = "ground" if k == 0 else of.tracks[k - 1].name
        children = [{"mesh": shape(mesh, tone), "name": f"{name}: {tone}"} for mesh, tone in parts]
        nodes.append({"name": name, "children": list(range(len(nodes) + 1, len(nodes) + 1 + len(children)))})
        if not children:
            del nodes[-1]["children"]
        own = len(nodes) - 1
        nodes += children
        if k:
            keyed(own, "translation", np.array([p for p, _ in poses[k - 1]]), "VEC3")
            turns = quaternion(np.array([axes for _, axes in poses[k - 1]]))
            keyed(own, "rotation", turns[:, [1, 2, 3, 0]], "VEC4")
    tops = [i for i, node in enumerate(nodes) if not any(i in n.get("children", ()) for n in nodes)]
    longest = ARROW * of.size
    drawn = len(meshes)
    if of.forces:
        # Of unit length and the longest arrow's thickness: a force scales its length.
        meshes.append(buffer.mesh(arrow(longest, longest), len(materials) - 1) | {"name": "force"})
    for force in of.forces:
        size = np.linalg.norm(force.force, axis=1)
        seen = size >= LEAST * of.peak
        way = np.where(seen[:, None], force.force / np.where(size > 0, size, 1.0)[:, None], [0.0, 0.0, 1.0])
        share = np.array([arrow_share(float(x), of.peak) if s else _NOTHING for x, s in zip(size, seen, strict=True)])
        base = np.zeros(3) if force.track < 0 else np.array([p for p, _ in poses[force.track]])
        name = f"force {force.contact}{f' {force.member}' if force.member else ''}"
        nodes.append({"name": name, "mesh": drawn, "extras": {"unit": "N", "largest": float(size.max())}})
        node = len(nodes) - 1
        tops.append(node)
        keyed(node, "translation", force.lever + base, "VEC3")
        keyed(node, "rotation", quaternion(np.stack([frame(w) for w in way]))[:, [1, 2, 3, 0]], "VEC4")
        keyed(node, "scale", np.stack([share, share, share], axis=1), "VEC3")
    note = {
        "exaggeration": of.exaggeration, "seconds_of_the_run_in_a_second": span / lasts,
        "largest_force_N": of.peak, "length_of_an_arrow": "square root of the force", "notes": of.notes,
    }  # fmt: skip
    content = {
        "asset": {"version": "2.0", "generator": f"bcfj-jax {version()}"},
        "scene": 0,
        "scenes": [{"name": of.title, "nodes": tops, "extras": note}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": materials,
        "animations": [{"name": of.title, "channels": channels, "samplers": samplers}],
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": len(buffer.data)}],
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    data = buffer.data + b"\0" * (-len(buffer.data) % 4)
    head = struct.pack("<III", _MAGIC, 2, 12 + 8 + len(text) + 8 + len(data))
    return head + struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(data), _BIN) + data


def _material(name: str, colour: tuple[float, ...]) -> dict[str, Any]:
    # Colours of glTF are linear.
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour[:3]]
    look = {"baseColorFactor": [*linear, colour[3]], "metallicFactor": 0.1, "roughnessFactor": 0.6}
    see_through = {"alphaMode": "BLEND", "doubleSided": True} if colour[3] < 1.0 else {}
    return {"name": name, "pbrMetallicRoughness": look, **see_through}


def read(data: bytes) -> tuple[dict[str, Any], bytes]:
    """JSON and binary part of a file's content.

    Raises:
        ValueError: for what is no binary glTF 2.0 of these two chunks.
    """
    magic, edition, whole = struct.unpack_from("<III", data)
    if (magic, edition, whole) != (_MAGIC, 2, len(data)):
        raise ValueError("no binary glTF 2.0 of this length")
    size, kind = struct.unpack_from("<II", data, 12)
    rest, second = struct.unpack_from("<II", data, 20 + size)
    if (kind, second) != (_JSON, _BIN) or 28 + size + rest != len(data):
        raise ValueError("chunks of another kind or length")
    return json.loads(data[20 : 20 + size]), data[28 + size :]
