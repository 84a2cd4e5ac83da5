"""``bcfj simulate``: a run in a folder and in words; ``bcfj animate``: a run in motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from bcfj_jax.analysis.engine import simulated
from bcfj_jax.analysis.simulation import results
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.progress import stage
from bcfj_jax.io.folder import LEAST_FREE
from bcfj_jax.io.outputs import Claim, open_folder, placed
from bcfj_jax.io.plots import get_ready
from bcfj_jax.io.scenefile import load, quickest
from bcfj_jax.xla.programs import beside, keep_asked
from bcfj_jax.xla.threads import begun

# Of a contact's sample in both tables [bytes].
_BYTES = 100


def movies(words: Sequence[str]) -> tuple[str, ...]:
    """Names of the files with the run in motion, by the formats that ``--animate`` names, each known and installed."""
    from bcfj_jax.io.view import export

    return tuple(f"animation{export.checked(word)}" for word in dict.fromkeys(words))


def movie(what: str, word: str, out: Path | None) -> Path:
    """The file that ``animated`` writes: the scene's name, by the format; refused where it is there already."""
    (name,) = movies([word])
    path = placed(out, f"{Path(what).stem}{Path(name).suffix}")
    if path.exists():
        raise InputError(f"animate {path}", "is there already", "give another folder by --out, or take it away")
    return path


def animated(what: str, word: str, out: Path | None, say: Callable[[str], None]) -> tuple[Path, bool]:
    """Simulate a scene and write it in motion, as far as it came; the file, and whether the run reached its end."""
    from bcfj_jax.io.view import export

    path, given = movie(what, word, out), quickest(load(what))
    say(f"simulating {what}: {len(given.times)} samples to {given.times[-1]:.6g} s")
    found = simulated(given, measure_error=False, resolved_peaks=False)
    if found.status != "ok":
        say(f"error: {results.verdict(found)}")
    with stage("drawing"):
        path.parent.mkdir(parents=True, exist_ok=True)
        export.animate(given.scene, given.params, found, path, path.stem)
    keep_asked()
    return path, found.status == "ok"


class Wanted(NamedTuple):
    """What is asked beside a run: whether it is made once more, ten times finer, to measure its force error; files as ``movies``
    names them; bodies, or "world", in whose axes the forces of all contacts are written, too.
    """

    measure_error: bool = True
    animations: Sequence[str] = ()
    frames: Sequence[str] = ()


def run(what: str, wanted: Wanted, out: Path | None, say: Callable[[str], None], show: Callable[[str], None]) -> bool:
    """Simulate a scene file, or a built-in scene, and write what ``results.files`` names: numbers, then pictures.

    ``out``: the folder, None for one made up; ``say``, ``show`` receive progress and warnings, and the results. Whether the run
    reached its end.
    """
    given = quickest(load(what))
    framed, animations = results.framed(given.scene, wanted.frames), wanted.animations
    names = list(dict.fromkeys(channel.name for channel in (*given.reads, *framed)))
    stem = given.source.stem if given.source else what
    channels = sum(max(1, members) for members in given.scene.members.values())
    size = LEAST_FREE + _BYTES * channels * len(given.times)
    folder = open_folder(out, stem, Claim("simulate", (*results.files(given, framed), *animations), size=size))
    say(f"simulating {what}: {len(given.times)} samples to {given.times[-1]:.6g} s")
    get_ready()
    beside(partial(results.get_ready, given))
    # A large model compiles the looks for seconds, and its contacts carry: samples show them.
    looked = given.resolved_peaks or (not given.scene.traits.large and given.solver != "bdf")
    found = simulated(given, measure_error=wanted.measure_error, read=names, resolved_peaks=looked)
    written = results.write(folder, given, found, stem, framed)
    show(f"{written.text}\nresults in {folder}")
    for warning in written.warnings:
        say(f"warning: {warning}")
    if found.status != "ok":
        say(f"error: {results.verdict(found)}")
    kept = begun(keep_asked)
    with stage("drawing"):
        results.draw(folder, given, found, stem, written, animations)
    for name in animations:
        if not (folder / name).exists():
            say(f"warning: {name} was not written: this scene, or this run, has nothing to draw")
    kept()
    return found.status == "ok"
