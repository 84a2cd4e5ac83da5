"""``bcfj study``: a study of a folder, its progress and what it says in the end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.plausibility import Finding, at, headline, judged
from bcfj_jax.analysis.studies import api, specification, view, worker
from bcfj_jax.analysis.studies.api import Finished, Result, read
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.analysis.studies.store import Store
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.progress import stage
from bcfj_jax.io import changes, outputs, report, tables
from bcfj_jax.io.changes import Change
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Table, Verdict, counted, span
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
    """Run a study (a file, or a built-in study's name), or go on with it; in words, and the exit code.

    ``team``: workers and scheduler, as ``api.study``. ``say`` receives the progress, ``show`` ranges of what there is after the
    first block. ``resuming``: whether it must have been begun.
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
            with worker.written():
                text = write(result, stem)
        except (worker.Stopped, KeyboardInterrupt) as stopped:
            finished = f"interrupted: {store.there()} of {len(blocks)} blocks are finished"
            say(f"stopped: {stopped}" if isinstance(stopped, worker.Stopped) else finished)
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
    return f"{head}\n{report.text(view.ranges(found, found.study.columns))}\n"


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


def write(result: Result, stem: str) -> str:
    """Pictures and report; the results in words."""
    found, study = result.state, result.study
    absurd = _absurd(result)
    with stage("drawing"):
        drawn = view.overview(result, result.folder)
    report.write(result.folder, page(f"Study {stem}", result, drawn, absurd), study.given.scene.model_form)
    first = [f"At its {place} {headline(findings)}" for place, findings in absurd.items()]
    said = f"{found['finished']} points, {found['failed']} of them failed."
    more = [f"  {text}: {count}" for text, count in found["reasons"].items()]
    return "\n".join([*first, said, *more, "", report.text(view.ranges(result, study.columns))])


def _absurd(result: Result) -> dict[str, list[Finding]]:
    """What is not plausible at the points of the least and of the largest value of the first feature, run again alone."""
    study, name = result.study, result.study.features[0].name
    values = np.where(result.column("status") == "ok", result.column(name), np.nan)
    if not np.isfinite(values).any():
        return {}
    found = {}
    for word, k in (("largest", int(np.nanargmax(values))), ("least", int(np.nanargmin(values)))):
        params = {key: float(x[0]) for key, x in study.params(study.points[k : k + 1]).items()}
        times = study.given.times * (study.ends[k] / study.given.times[-1])
        found[f"{word} {name}, point {k},"] = at(study.given.scene, params, times)
    return {place: findings for place, findings in found.items() if findings}


def page(title: str, result: Result, drawn: Sequence[Picture], absurd: Mapping[str, list[Finding]]) -> Page:
    """The report: which parameter moves which feature most, the range of every feature, and points that failed."""
    study = result.study
    rows = view.ranges(result, [f.name for f in study.features], "feature")
    tables = [Table("Features over all points", rows)]
    tables.append(Table("What was varied", view.ranges(result, study.names, "parameter")))
    warnings = ()
    if found := result.failed:
        warnings = (f"{found} of {study.count} points failed; the features do not include them.",)
        reasons = [[text, str(count)] for text, count in result.state["reasons"].items()]
        tables.append(Table("Failures", [["reason", "points"], *reasons]))
    verdict = judged([one for findings in absurd.values() for one in findings], _answer(result))
    return Page(title, verdict, tuple(drawn), warnings, tuple(tables))


def _answer(result: Result) -> Verdict:
    """Which parameter moves which feature most, by the feature's range over its median: of several the one whose ranks
    correlate most with the feature's (Spearman).
    """
    study, good = result.study, result.column("status") == "ok"
    count = f"{study.count} points"
    if not good.any():
        return Verdict(BAD, "Failed", f"None of {count} has a result.")
    spreads = {}
    for one in study.features:
        values = result.column(one.name)[good]
        middle = float(np.nanmedian(np.abs(values))) if np.isfinite(values).any() else 0.0
        if middle > 0:
            spreads[one.name] = float(np.nanmax(values) - np.nanmin(values)) / middle
    kind, word = (FAIR, "Finished, with failures") if result.failed else (GOOD, "Finished")
    if not spreads:
        return Verdict(kind, word, f"{count}; no feature has a value.")
    feature = max(spreads, key=lambda name: spreads[name])
    values = result.column(feature)[good]
    extent = span(values, feature_unit(feature))
    if view.together(result):
        name = " and ".join(study.names)
    else:
        name = max(study.names, key=lambda n: _rank_correlation(result.column(n)[good], values))
    what = "move" if " and " in name else "moves"
    return Verdict(kind, word, f"{name} {what} {feature} most: {extent} over {count}.")


def _rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Size of Spearman's coefficient; 0 where one does not vary."""
    from scipy.stats import spearmanr

    x, y = (v[np.isfinite(x) & np.isfinite(y)] for v in (x, y))
    if x.size < 2 or np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    return abs(float(spearmanr(x, y)[0]))  # pyright: ignore[reportArgumentType]
