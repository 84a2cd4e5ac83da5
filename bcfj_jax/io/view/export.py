"""``animate``: a run as a page, glTF or a movie, by the suffix of a path."""

from __future__ import annotations

import html
from pathlib import Path

from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.io.outputs import atomic, write_text
from bcfj_jax.io.view import movie
from bcfj_jax.io.view.animation import Animation, animation
from bcfj_jax.io.view.fragment import fragment
from bcfj_jax.io.view.gltf import glb
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.simulation import Run

# By the word of the command line, the suffix of the file.
FORMATS = {"html": ".html", "gltf": ".glb", "mp4": ".mp4", "gif": ".gif"}


def checked(word: str, where: str = "--animate") -> str:
    """The suffix of a format by its name, whose library is there.

    Raises:
        InputError: for a name that is not known, and a format whose extra is not installed.
    """
    if word not in FORMATS:
        raise InputError(where, f"no format '{word}'", nearest(word, FORMATS))
    movie.needed(FORMATS[word])
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
    if path.suffix not in words:
        raise InputError(f"animate {path}", f"no format '{path.suffix}'", nearest(path.suffix, words))
    checked(words[path.suffix], f"animate {path}")
    if path.exists():
        raise InputError(f"animate {path}", "is there already", "give another name")
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
        movie.write(of, path)
