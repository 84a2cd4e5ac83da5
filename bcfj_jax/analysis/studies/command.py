"""``bcfj study``: a study of a folder, its progress and what it says in the end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from bcfj_jax.analysis.studies import api, local, specification
from bcfj_jax.analysis.studies.finished import Finished, read
from bcfj_jax.analysis.studies.pages import ranges, write
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.analysis.studies.store import Store
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.progress import stage
from bcfj_jax.io import changes, outputs, report, tables
from bcfj_jax.io.changes import Change
from bcfj_jax.io.page import counted
from bcfj_jax.io.stop import heeded

DONE, FAILED, INTERRUPTED = 0, 3, 5
BUILT_IN = Path(__file__).with_name("built_in")


def _built_in() -> dict[str, Path]:
    return {path.stem: path for path in sorted(BUILT_IN.glob("*.toml"))}


def find(what: str) -> tuple[Study, str]:
    """A study file, or a built-in study's name; the study, and what to call it. ``InputError`` for neither."""
    known = _built_in()
    if what not in known and not what.endswith(".toml"):
        raise InputError(what, "no study file and no built-in study", nearest(what, list(known)))
    path = known.get(what, Path(what))
    return specification.load(path), path.stem


@contextlib.contextmanager
def changing(what: str, wanted: Sequence[Change]) -> Iterator[None]:
    """Within, a study reads as changed: its own tables, and those of the scene that it varies."""
    with tables.changing_both(_built_in().get(what, Path(what)), wanted, changes.STUDY):
        yield


def _begun(what: str, out: Path | None, missing: tuple[str, str] | None) -> tuple[Study, Path, str]:
    """A study, its folder, by default ``results/study-NAME``, and its name; ``missing``: what to say where none was begun."""
    study, stem = find(what)
    folder = out or Path("results") / f"study-{stem}"
    if missing and not (folder / "run.toml").exists():
        raise InputError(f"--out {folder}", *missing)
    return study, folder, stem


def run(
    what: str, out: Path | None, team: tuple[int | None, str | None], say: Callable[[str], None],
    show: Callable[[str], None], resuming: bool = False,
) -> tuple[str, int]:  # fmt: skip
    """Run a study, or go on with it; in words, and the exit code.

    Args:
        what: a study file, or a built-in study's name.
        out: its folder, None for one made up.
        team: workers and scheduler, as ``api.study``.
        say: receives the progress; show: ranges of what there is after the first block.
        resuming: whether it must have been begun.
    """
    missing = ("there is no study to resume", "say run, or name its folder") if resuming else None
    study, folder, stem = _begun(what, out, missing)
    workers, scheduler = team
    store = api.prepare(study, folder)
    blocks, size = store.blocks, store.blocks.size
    say(f"{counted(study.count, 'point')} in {counted(len(blocks), 'block')} of {size}, in {folder}")
    first: list[str] = []

    def so_far(found: api.Result) -> None:
        outputs.write_json(folder / api.STATE, found.state)
        if not first:
            first.append(_so_far(found))
            show(first[0])

    with heeded():
        try:
            with stage("computing points", study.count) as done:
                progress = api.growing(store, lambda n, _: done(min(n * size, study.count)), so_far)
                api.compute(store, workers, scheduler, progress)
            result = api.finish(store)
            with local.written():
                text = write(result, stem)
        except (local.Stopped, KeyboardInterrupt) as stopped:
            finished = f"interrupted: {store.there()} of {len(blocks)} blocks are finished"
            say(f"stopped: {stopped}" if isinstance(stopped, local.Stopped) else finished)
            return f"bcfj study resume {what} --out {folder}{changes.as_options()}", INTERRUPTED
    return f"{text}\nresults in {folder}", FAILED if result.failed == study.count else DONE


def dry(what: str, out: Path | None, team: tuple[int | None, str | None]) -> str:
    """How many points, and about how long and how large; refused is what ``run`` would refuse."""
    study, _, _ = _begun(what, out, None)
    workers, scheduler = team
    api.needed(study.histories, scheduler is not None)
    return api.estimate(study, workers)


def _so_far(found: api.Result) -> str:
    """Ranges of what is finished of a study."""
    done = found.state["finished"]
    head = f"Over {done} of {found.state['points']} points, {found.failed} of them failed; not complete yet."
    return f"{head}\n{report.text([['', 'least', 'median', 'largest'], *ranges(found, found.study.columns)])}\n"


def status(what: str, out: Path | None) -> tuple[str, int]:
    """What is finished and what is left; the exit code is 5 while something is."""
    store = existing(what, out)
    found = api.state(store)
    rows = [[key.replace("_", " "), str(found[key])] for key in ("status", "points", "finished", "left", "failed")]
    rows += [[f"  {text}", str(count)] for text, count in sorted(found["reasons"].items(), key=lambda item: -item[1])]
    whole = found["status"] == "finished"
    ranged = f"\n\n{_so_far(api.so_far(store))}" if found["finished"] and not whole else ""
    return report.text(rows) + ranged, DONE if whole else INTERRUPTED


def merge(what: str, out: Path | None, others: list[Path]) -> tuple[str, int]:
    """Take in other folders' blocks and write the table if none is missing."""
    store = existing(what, out)
    taken = sum(store.take(other) for other in others)
    found = api.state(store)
    if found["left"]:
        return f"{taken} blocks taken in; {found['left']} of {found['points']} points are missing", INTERRUPTED
    return f"{taken} blocks taken in\n{write(api.finish(store), Path(what).stem)}", DONE


def existing(what: str, out: Path | None) -> Store:
    """The store of a study that was begun; ``InputError`` where there is none, or another."""
    study, folder, _ = _begun(what, out, ("there is no study", "say bcfj study run first, or name its folder"))
    return api.prepare(study, folder)


def finished(what: str, out: Path | None) -> tuple[Finished | None, Path, str]:
    """A study, or None where something of it is left; its folder, and what to say and do first."""
    folder = existing(what, out).folder
    found = read(folder) if (folder / api.RESULTS).exists() else None
    return found, folder, f"the study is not finished; first say\nbcfj study resume {what} --out {folder}"
