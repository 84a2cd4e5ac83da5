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
from bcfj_jax.io.view.animation import ARROW, LEAST, Animation, poses, quaternion
from bcfj_jax.io.view.painter import COLOURS, TONES, arrow, arrow_share

_FLOAT, _INDEX = 5126, 5125
_ARRAY, _ELEMENTS = 34962, 34963
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
# Hidden where there is no force; a viewer may refuse a scale of 0.
_NOTHING = 1e-6


class _File:
    """The binary part, and the tables of JSON that describe it."""

    def __init__(self) -> None:
        self.data = b""
        self.tables: dict[str, list[dict[str, Any]]] = {
            name: [] for name in ("nodes", "meshes", "accessors", "bufferViews", "channels", "samplers")
        }

    def add(self, table: str, entry: dict[str, Any]) -> int:
        """One more entry of a table; its index."""
        self.tables[table].append(entry)
        return len(self.tables[table]) - 1

    def put(self, values: np.ndarray, kind: str, target: int | None = None) -> int:
        """Add an array of "SCALAR", "VEC3" or "VEC4"; the index of its accessor."""
        whole = np.issubdtype(values.dtype, np.integer)
        raw = np.ascontiguousarray(values, "<u4" if whole else "<f4")
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": raw.nbytes}
        self.data += raw.tobytes()
        rows = raw.reshape(len(raw), -1)
        return self.add("accessors", {
            "bufferView": self.add("bufferViews", view | ({"target": target} if target else {})),
            "componentType": _INDEX if whole else _FLOAT, "count": len(raw),
            "type": kind, "min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist(),
        })  # fmt: skip

    def mesh(self, mesh: Mesh, material: int, name: str) -> int:
        """A mesh of one primitive; its index."""
        size = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
        attributes = {
            "POSITION": self.put(mesh.points, "VEC3", _ARRAY),
            "NORMAL": self.put(mesh.normals / size, "VEC3", _ARRAY),
        }
        indices = self.put(mesh.triangles.reshape(-1).astype(np.uint32), "SCALAR", _ELEMENTS)
        primitive = {"attributes": attributes, "indices": indices, "material": material}
        return self.add("meshes", {"primitives": [primitive], "name": name})

    def keyed(self, node: int, clock: int, path: str, values: np.ndarray) -> None:
        """Keyframes of a node; rotations are (F, 3, 3)."""
        if path == "rotation":
            values = quaternion(values)[:, [1, 2, 3, 0]]
        output = self.put(values, f"VEC{values.shape[1]}")
        sampler = self.add("samplers", {"input": clock, "output": output, "interpolation": "LINEAR"})
        self.add("channels", {"sampler": sampler, "target": {"node": node, "path": path}})


def glb(of: Animation, lasts: float = 12.0) -> bytes:
    """The file's content; the run is played in ``lasts`` seconds."""
    file, tones = _File(), list(TONES)
    materials = [_material(name, TONES[name]) for name in tones] + [_material("force", (*COLOURS[-1], 1.0))]
    span = float(of.times[-1] - of.times[0])
    clock = file.put((of.times - of.times[0]) * lasts / span, "SCALAR")
    drawn = poses(of.tracks, exaggeration=of.exaggeration)
    tops = _bodies(file, of, clock, drawn) + _arrows(file, of, clock, drawn, len(materials) - 1)
    note = {
        "exaggeration": of.exaggeration, "seconds_of_the_run_in_a_second": span / lasts,
        "largest_force_N": of.peak, "length_of_an_arrow": "square root of the force", "notes": of.notes,
    }  # fmt: skip
    channels, samplers = file.tables.pop("channels"), file.tables.pop("samplers")
    content = {
        "asset": {"version": "2.0", "generator": f"bcfj-jax {version()}"},
        "scene": 0,
        "scenes": [{"name": of.title, "nodes": tops, "extras": note}],
        "materials": materials,
        "animations": [{"name": of.title, "channels": channels, "samplers": samplers}],
        **file.tables,
        "buffers": [{"byteLength": len(file.data)}],
    }
    text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    data = file.data + b"\0" * (-len(file.data) % 4)
    head = struct.pack("<III", _MAGIC, 2, 12 + 8 + len(text) + 8 + len(data))
    return head + struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(data), _BIN) + data


def _bodies(file: _File, of: Animation, clock: int, drawn: list[Any]) -> list[int]:
    """A node for each body, with a child for each of its tones; their indices."""
    kept: dict[tuple[int, str], int] = {}

    def shape(mesh: Mesh, tone: str) -> int:
        key = id(mesh), tone
        if key not in kept:
            slack = 0.0 if mesh.slack is None else (of.exaggeration - 1.0) * mesh.slack
            kept[key] = file.mesh(mesh._replace(points=mesh.points + slack), list(TONES).index(tone), tone)
        return kept[key]

    tops = []
    for k in range(-1, len(of.tracks)):
        name = "ground" if k < 0 else of.tracks[k].name
        own = file.add("nodes", {"name": name})
        parts = [(mesh, tone) for track, mesh, tone in of.parts if track == k]
        children = [file.add("nodes", {"mesh": shape(mesh, tone), "name": f"{name}: {tone}"}) for mesh, tone in parts]
        if children:
            file.tables["nodes"][own]["children"] = children
        if k >= 0:
            file.keyed(own, clock, "translation", drawn[k][0])
            file.keyed(own, clock, "rotation", drawn[k][1])
        tops.append(own)
    return tops


def _arrows(file: _File, of: Animation, clock: int, drawn: list[Any], material: int) -> list[int]:
    """A node for each force; their indices. The arrow has the longest one's size, and a force scales it."""
    longest, tops = ARROW * of.size, []
    shape = file.mesh(arrow(longest, longest), material, "force") if of.forces else 0
    for force in of.forces:
        size = np.linalg.norm(force.force, axis=1)
        seen = size >= LEAST * of.peak
        way = np.where(seen[:, None], force.force / np.where(size > 0, size, 1.0)[:, None], [0.0, 0.0, 1.0])
        share = np.array([arrow_share(float(x), of.peak) if s else _NOTHING for x, s in zip(size, seen, strict=True)])
        name = f"force {force.contact}{f' {force.member}' if force.member else ''}"
        node = file.add("nodes", {"name": name, "mesh": shape, "extras": {"unit": "N", "largest": float(size.max())}})
        file.keyed(node, clock, "translation", force.lever + drawn[force.track][0])
        file.keyed(node, clock, "rotation", np.stack([frame(w) for w in way]))
        file.keyed(node, clock, "scale", np.stack([share, share, share], axis=1))
        tops.append(node)
    return tops


def _material(name: str, colour: tuple[float, ...]) -> dict[str, Any]:
    # Colours of glTF are linear.
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour[:3]]
    look = {"baseColorFactor": [*linear, colour[3]], "metallicFactor": 0.1, "roughnessFactor": 0.6}
    see_through = {"alphaMode": "BLEND", "doubleSided": True} if colour[3] < 1.0 else {}
    return {"name": name, "pbrMetallicRoughness": look, **see_through}
