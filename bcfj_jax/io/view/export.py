"""``animate``: a run as a page, glTF or a movie, by the suffix of a path.

GIF is written by Pillow, MP4 by ffmpeg (extra ``animation``).
"""

from __future__ import annotations

import html
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.core.errors import InputError, one_of, quoted
from bcfj_jax.core.extras import library
from bcfj_jax.core.progress import stage
from bcfj_jax.io.outputs import atomic, write_text
from bcfj_jax.io.view import painter
from bcfj_jax.io.view.animation import Animation, animation
from bcfj_jax.io.view.fragment import fragment, unit_of
from bcfj_jax.io.view.gltf import glb
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.simulation import Run

if TYPE_CHECKING:
    from PIL.Image import Image

# By the word of the command line, the suffix of the file.
FORMATS = {"html": ".html", "gltf": ".glb", "mp4": ".mp4", "gif": ".gif"}
# Pictures, and pictures a second; width and height [pixels].
_GIF, _MP4 = (80, 12), (200, 25)
SIZE = (640, 400)


def checked(word: str, where: str = "--animate") -> str:
    """The suffix of a format by its name; refuses one that is not known, or whose extra is not installed."""
    one_of(where, "format", word, FORMATS)
    if FORMATS[word] == ".mp4":
        library("imageio_ffmpeg", "animation .mp4", "animation")
    return FORMATS[word]


def animate(scene: AbstractModel, params: Params, run: Run, path: str | Path, title: str = "") -> Path:
    """Write a run that moves: ``.html`` (interactive, no network), ``.glb`` (glTF 2.0), ``.mp4`` or ``.gif``.

    Args:
        scene, params: what was simulated.
        run: ``simulate``'s.
        path: of the file; nothing is overwritten.
        title: by default the model's.

    Returns:
        The file written.

    Raises:
        InputError: for another suffix, a file that is there already, a missing extra (MP4 needs ``animation``), and a
            model or a run that cannot be drawn.
    """
    path = Path(path)
    words = {suffix: word for word, suffix in FORMATS.items()}
    one_of(f"animate {path}", "format", path.suffix, words)
    checked(words[path.suffix], f"animate {path}")
    if path.exists():
        raise InputError(f"animate {path}", "is there already", "give another name")
    if not isinstance(run, Run):
        raise InputError(f"animate {path}", f"{quoted(run)} is no run", "give what bj.simulate returns")
    of = animation(scene, params, run, title)
    if of is None:
        raise InputError(f"animate {path}", "has nothing to draw", "give a mechanism, and a run of two samples or more")
    write(of, path)
    return path


def write(of: Animation, path: Path) -> None:
    """Write an animation by the path's suffix."""
    if path.suffix == ".html":
        title = html.escape(of.title)
        head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        style = "<style>body{font:1rem/1.5 system-ui,sans-serif;max-width:64rem;margin:0 auto;padding:1rem}</style>"
        text = f"<head>{head}<title>{title}</title>{style}</head><body><h1>{title}</h1>{fragment(of)}</body>"
        write_text(path, f'<!DOCTYPE html>\n<html lang="en">{text}</html>\n')
    elif path.suffix == ".glb":
        with atomic(path) as temporary:
            temporary.write_bytes(glb(of))
    else:
        movie(of, path)


def movie(of: Animation, path: Path) -> None:
    """Write a GIF or an MP4, by the path's suffix."""
    from PIL import Image

    with stage(f"drawing {path.name}"), atomic(path) as temporary:
        if path.suffix == ".gif":
            count, rate = _GIF
            first, *others = [p.quantize(64, dither=Image.Dither.NONE) for p in pictures(of, count)]
            later = {"append_images": others, "duration": round(1000 / rate), "loop": 0}
            first.save(temporary, format="GIF", save_all=True, optimize=False, **later)
            return
        _encoded(of, temporary)


def _encoded(of: Animation, path: Path) -> None:
    count, rate = _MP4
    # JAX warns of a fork with a hook, which imageio_ffmpeg's own writer is.
    program = library("imageio_ffmpeg", "animation .mp4", "animation").get_ffmpeg_exe()
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{SIZE[0]}x{SIZE[1]}", "-r", str(rate), "-i", "-"]
    made = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4", str(path)]
    command = [program, "-y", "-loglevel", "error", *given, *made]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdin is not None and running.stderr is not None
        for picture in pictures(of, count):
            running.stdin.write(picture.tobytes())
        running.stdin.close()
        said = running.stderr.read().decode(errors="replace").strip()
    if running.returncode:
        raise InputError("animation .mp4", f"ffmpeg failed: {said[:200]}", "write a GIF instead")


def pictures(of: Animation, count: int) -> Iterator[Image]:
    """Pictures at equal steps of time, each of the frame nearest to it, with time and exaggeration written below."""
    from PIL import ImageDraw

    factor, unit, digits = unit_of(float(np.abs(of.times).max()), "s")
    scale = "true to scale" if of.exaggeration == 1.0 else f"clearances x {of.exaggeration:g}"
    for t in np.linspace(of.times[0], of.times[-1], count):
        k = int(np.argmin(np.abs(of.times - t)))
        picture = painter.paint(of, k, SIZE)
        # The font that Pillow brings has no mu.
        text = f"{of.title}   {of.times[k] * factor:.{digits}f} {unit.replace('µ', 'u')}   {scale}"
        ImageDraw.Draw(picture).text((10, SIZE[1] - 22), text, fill=(27, 31, 35), font_size=14)
        yield picture
