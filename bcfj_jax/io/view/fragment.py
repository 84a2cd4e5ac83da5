"""The interactive figure of a run as a piece of HTML: it needs no network, and shows a still picture without scripts."""

from __future__ import annotations

import base64
import io
import json
from importlib import resources
from typing import Any

import numpy as np

from bcfj_jax.core.shapes import Mesh
from bcfj_jax.io.report import rendered
from bcfj_jax.io.units import engineering
from bcfj_jax.io.view import painter
from bcfj_jax.io.view.animation import ARROW, LEAST, Animation, steps

# Seconds that a run takes to be played; width and height of the still picture.
LASTS, STILL = 12.0, (720, 450)


def _text(name: str) -> str:
    return resources.files("bcfj_jax.io.view").joinpath(name).read_text(encoding="utf-8")


class _Blob:
    """Arrays one after another in one text."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0

    def put(self, values: np.ndarray, kind: str, scale: float | None = None) -> list[Any]:
        """Add an array; the entry that finds it: kind, offset, length, scale.

        Kinds: "f" float32, "h" int16 and "b" int8 in units of ``scale`` (by default so that the largest fits), "H" uint16.
        """
        if kind in "hb":
            top = 32767 if kind == "h" else 127
            scale = scale or (float(np.abs(values).max(initial=0.0)) or 1.0) / top
            values = np.round(values / scale)
        raw = np.ascontiguousarray(values, {"f": "<f4", "h": "<i2", "b": "i1", "H": "<u2"}[kind]).tobytes()
        entry = [kind, self.size, int(values.size), *([scale] if kind in "hb" else [])]
        raw += b"\0" * (-len(raw) % 4)
        self.parts.append(raw)
        self.size += len(raw)
        return entry

    def text(self) -> str:
        """All of them."""
        return base64.b64encode(b"".join(self.parts)).decode("ascii")


def _mesh(blob: _Blob, mesh: Mesh) -> dict[str, Any]:
    """A mesh with every point once: places in 16 bits of its size, normals and slack in 8."""
    scale = (float(np.abs(mesh.points).max()) or 1.0) / 32767
    rows = [np.round(mesh.points / scale), np.round(127.0 * mesh.normals)]
    wide = 0.0
    if mesh.slack is not None and mesh.slack.any():
        wide = float(np.abs(mesh.slack).max()) / 127.0
        rows.append(np.round(mesh.slack / wide))
    table = np.concatenate(rows, axis=1).astype(np.int16)
    once, index = np.unique(table, axis=0, return_inverse=True)
    if len(once) > 65535:
        raise ValueError(f"a mesh of {len(once)} points has too many for the viewer")
    four = np.zeros((len(once), 1), np.int16)
    found = {
        "p": [*blob.put(once[:, :3], "H"), scale],
        "n": blob.put(np.concatenate([once[:, 3:6], four], axis=1), "b", 1.0),
        "t": blob.put(index.reshape(-1)[mesh.triangles].ravel(), "H"),
    }
    found["p"][0] = "h"
    if wide:
        found["k"] = [*blob.put(np.concatenate([once[:, 6:9], four], axis=1), "b", 1.0)[:3], wide]
    return found


def _rows(blob: _Blob, values: np.ndarray, kind: str) -> list[Any]:
    still = np.all(values == values[0])
    return blob.put((values[:1] if still else values).ravel(), kind)


def unit_of(largest: float, unit: str) -> list[Any]:
    """Factor, unit and decimals of a number on the screen."""
    factor, prefix = engineering([largest or 1.0])
    return [factor, f"{prefix.replace('u', 'µ')}{unit}", 2]


def content(of: Animation) -> dict[str, Any]:
    """What ``viewer.js`` reads."""
    blob = _Blob()
    kept: dict[tuple[bytes, bytes], int] = {}
    meshes: list[dict[str, Any]] = []
    parts = []
    for track, mesh, tone in of.parts:
        key = (mesh.points.tobytes(), b"" if mesh.slack is None else mesh.slack.tobytes())
        if key not in kept:
            kept[key] = len(meshes)
            meshes.append(_mesh(blob, mesh))
        body = "ground" if track < 0 else of.tracks[track].name.split(" ")[0]
        parts.append({"track": track, "mesh": kept[key], "tone": tone, "body": body})
    tracks = [
        {
            "name": t.name, "p": _rows(blob, t.place, "h"), "q": _rows(blob, t.quaternion, "h"),
            "d": _rows(blob, t.shift, "h"), "r": _rows(blob, t.turn, "h"),
        }
        for t in of.tracks
    ]  # fmt: skip
    forces = [
        {"contact": f.contact, "track": f.track, "p": _rows(blob, f.lever, "h"), "f": _rows(blob, f.force, "h")}
        for f in of.forces
    ]
    times = blob.put(of.times, "f")
    return {
        "meshes": meshes, "parts": parts, "tracks": tracks, "forces": forces, "times": times,
        "start": strongest(of), "exaggeration": of.exaggeration, "steps": steps(of.most), "lasts": LASTS,
        "eye": list(of.eye), "up": list(of.up), "centre": of.centre.tolist(), "half": of.half.tolist(), "size": of.size,
        "arrow": ARROW * of.size, "peak": of.peak or 1.0, "least": LEAST,
        "clock": unit_of(float(np.abs(of.times).max()), "s"), "newton": unit_of(of.peak, "N"),
        "tones": painter.TONES, "colours": painter.COLOURS, "blob": blob.text(),
    }  # fmt: skip


def strongest(of: Animation) -> int:
    """The frame with the largest force; the middle one without forces."""
    sizes = [np.linalg.norm(f.force, axis=1) for f in of.forces]
    return int(np.argmax(np.max(sizes, axis=0))) if sizes and of.peak > 0 else len(of.times) // 2


def _sentences(of: Animation) -> list[str]:
    found = []
    if of.samples > len(of.times):
        found.append(
            f"Shown are {len(of.times)} of {of.samples} samples: of each spell of time the one with the largest force."
        )
    span = float(of.times[-1] - of.times[0])
    factor, unit, _ = unit_of(span, "s")
    scale = (
        f"Clearances, and displacements from where the mechanism would be without them, are drawn {of.exaggeration:g} times "
        "as large as they are."
    )
    scale = scale if of.exaggeration > 1.0 else "Everything is drawn true to scale."
    return [*found, f"The run of {span * factor:.4g} {unit} is played in {LASTS:.0f} s.", scale, *of.notes]


def still(of: Animation) -> bytes:
    """The picture at the largest force, PNG."""
    from PIL import Image

    few = painter.paint(of, strongest(of), STILL).quantize(64, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    stream = io.BytesIO()
    few.save(stream, format="PNG", compress_level=6)
    return stream.getvalue()


def fragment(of: Animation) -> str:
    """One ``<figure>`` with picture, controls, caption, data and script; several may stand on one page."""
    from markupsafe import Markup  # CSS and JavaScript of this package, and JSON without an end of its script

    factor, unit, _ = unit_of(of.peak, "N")
    contacts = dict.fromkeys(f.contact for f in of.forces)
    bodies = dict.fromkeys(of.tracks[t].name.split(" ")[0] if t >= 0 else "ground" for t, *_ in of.parts)
    data = json.dumps(content(of), separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return rendered(
        "figure.html", of=of, style=Markup(_text("viewer.css")), script=Markup(_text("viewer.js")), data=Markup(data),
        still=base64.b64encode(still(of)).decode("ascii"), sentences=_sentences(of), unit=unit,
        boxes=(("Forces of", "c", list(contacts)), ("Bodies", "b", list(bodies))),
        ticks=[f"{of.peak * factor * share:.3g}" for share in (0.0, 0.25, 1.0)],
        stops=",".join("rgb({:.0f},{:.0f},{:.0f})".format(*(255.0 * x for x in c)) for c in painter.COLOURS),
    )  # fmt: skip
