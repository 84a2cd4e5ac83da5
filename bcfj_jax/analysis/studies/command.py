"""``bcfj study``: a study of a folder, its progress and what it says in the end."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis.derivatives.names import feature_unit
from bcfj_jax.analysis.plausibility import Finding, at, headline, judged
from bcfj_jax.analysis.studies import api, local, pictures, specification
from bcfj_jax.analysis.studies.block import Blocks, compute
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.analysis.studies.store import Store, facts_of, fault_of
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.progress import stage
from bcfj_jax.io import changes, report, tables
from bcfj_jax.io.changes import Change
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Table, Verdict, brief, counted, span
from bcfj_jax.io.stop import heeded
from bcfj_jax.io.units import format_si

DONE, FAILED, INTERRUPTED = 0, 3, 5
BUILT_IN = Path(__file__).with_name("built_in")


def find(what: str) -> tuple[Study, str]:
    """A study file, or a built-in study's name; the study, and what to call it.

    Raises:
        InputError: for neither, and for anything in the file that is not right.
    """
    known = {path.stem: path for path in sorted(BUILT_IN.glob("*.toml"))}
    if what in known:
        return specification.load(known[what]), what
    if not what.endswith(".toml"):
        raise InputError(what, "no study file and no built-in study", nearest(what, list(known)))
    return specification.load(Path(what)), Path(what).stem


@contextlib.contextmanager
def changing(what: str, wanted: Sequence[Change]) -> Iterator[None]:
    """Within, a study reads as changed: its own tables, and those of the scene that it varies.

    Raises:
        InputError: as ``changes.changing``, and for what is no study file.
    """
    path = {path.stem: path for path in BUILT_IN.glob("*.toml")}.get(what, Path(what))
    with tables.changing_both(path, wanted, changes.STUDY):
        yield


def folder_of(out: Path | None, stem: str) -> Path:
    """Where a study is, unless it is said."""
    return out or Path("results") / f"study-{stem}"


def run(
    what: str, out: Path | None, workers: int | None, scheduler: str | None, dry: bool, say: Callable[[str], None],
    resuming: bool = False,
) -> tuple[str, int]:  # fmt: skip
    """Run a study, or go on with it; the results in words, and the exit code.

    Raises:
        InputError: for bad input, a folder that holds another study, and nothing there to resume.
    """
    study, stem = find(what)
    folder = folder_of(out, stem)
    if resuming and not (folder / "run.toml").exists():
        raise InputError(f"--out {folder}", "there is no study to resume", "say run, or name its folder")
    # A dry run refuses what the run would refuse.
    api.needed(study.histories, scheduler is not None)
    if dry:
        return estimate(study, workers), DONE
    store = api.prepare(study, folder)
    say(f"{counted(study.count, 'point')} in {counted(len(store.blocks), 'block')} of {store.blocks.size}, in {folder}")
    with heeded():
        try:
            size = store.blocks.size
            with stage("computing points", study.count) as done:
                api.compute(store, workers, scheduler, lambda n, _: done(min(n * size, study.count)))
            result = api.finish(store)
            with local.written():
                text = write(result, study, stem)
        except local.Stopped as stopped:
            say(f"stopped: {stopped}")
            return f"bcfj study resume {what} --out {folder}{changes.as_options()}", INTERRUPTED
        except KeyboardInterrupt:
            say(f"interrupted: {store.there()} of {len(store.blocks)} blocks are finished")
            return f"bcfj study resume {what} --out {folder}{changes.as_options()}", INTERRUPTED
    return f"{text}\nresults in {folder}", FAILED if result.failed == study.count else DONE


def estimate(study: Study, workers: int | None) -> str:
    """How many points, and about how long and how large, from a few that are run here and thrown away."""
    blocks = Blocks(study)
    at = blocks.order[np.unique(np.linspace(0, study.count - 1, min(blocks.size, 8)).astype(int))]
    begin = time.perf_counter()
    compute(study, at, blocks.size)
    middle = time.perf_counter()
    table = compute(study, at, blocks.size)
    each = (time.perf_counter() - middle) / len(at)
    team = workers or api.default_workers()
    histories = table.force.nbytes / len(at) if study.histories else 0.0
    disk = study.count * (8.0 * (len(study.names) + len(study.columns) + 1) + histories)
    rows = [
        ["points", str(study.count)],
        ["blocks", f"{len(blocks)} of {blocks.size}"],
        ["compiling", f"{middle - begin - each * len(at):.1f} s"],
        ["computing", f"about {format_si(study.count * each / min(team, len(blocks)), 's', 2)} with {team} workers"],
        ["disk", f"about {disk / 1e6:.3g} MB" if disk >= 1e6 else f"about {disk / 1e3:.3g} kB"],
    ]
    return report.text(rows)


def status(what: str, out: Path | None) -> tuple[str, int]:
    """What is finished and what is left; the exit code is 5 while something is.

    Raises:
        InputError: where there is no such study.
    """
    store = existing(what, out)
    found = api.state(store)
    rows = [[key.replace("_", " "), str(found[key])] for key in ("status", "points", "finished", "left", "failed")]
    rows += [[f"  {text}", str(count)] for text, count in sorted(found["reasons"].items(), key=lambda item: -item[1])]
    return report.text(rows), DONE if found["status"] == "finished" else INTERRUPTED


def merge(what: str, out: Path | None, others: list[Path]) -> tuple[str, int]:
    """Take in other folders' blocks and write the table if none is missing.

    Raises:
        InputError: where there is no such study.
    """
    store = existing(what, out)
    taken = sum(take(store, other) for other in others)
    found = api.state(store)
    if found["left"]:
        return f"{taken} blocks taken in; {found['left']} of {found['points']} points are missing", INTERRUPTED
    return f"{taken} blocks taken in\n{write(api.finish(store), store.study, Path(what).stem)}", DONE


def take(store: Store, other: Path) -> int:
    """Copy the blocks that are whole in another folder and missing here; their number."""
    count = 0
    for block in range(len(store.blocks)):
        source = other / "blocks" / store.path(block).name
        if store.finished(block) or not source.exists():
            continue
        if fault := fault_of(source, store.blocks.names[block], len(store.blocks.points(block))):
            sys.stderr.write(f"{source}: {fault}; it is not taken\n")
            continue
        files = [f"{source.stem}.zarr/{part}" for part in facts_of(source).get("histories", {})]
        store.keep(block, {name: (source.parent / name).read_bytes() for name in [*files, source.name]})
        count += 1
    return count


def existing(what: str, out: Path | None) -> Store:
    """The store of a study that was begun.

    Raises:
        InputError: where there is none, or another.
    """
    study, stem = find(what)
    folder = folder_of(out, stem)
    if not (folder / "run.toml").exists():
        raise InputError(f"--out {folder}", "there is no study", "say bcfj study run first, or name its folder")
    return api.prepare(study, folder)


def write(result: api.Result, study: Study, stem: str) -> str:
    """Pictures and report; the results in words."""
    found = result.state
    said = f"{found['finished']} points, {found['failed']} of them failed."
    rows: list[list[Any]] = [["", "least", "median", "largest"]]
    good = result.column("status") == "ok"
    units = {feature.name: feature_unit(feature.name) for feature in study.features}
    for name in study.columns:
        values = result.column(name)[good]
        values = values[np.isfinite(values)]
        ends = (np.min(values), np.median(values), np.max(values)) if values.size else (None,) * 3
        rows.append([name, *(brief(x, units.get(name, "1")) for x in ends)])
    absurd = _absurd(result, study)
    with stage("drawing"):
        drawn = pictures.overview(study, result, result.folder)
    report.write(result.folder, page(f"Study {stem}", result, study, drawn, absurd), study.given.scene.model_form)
    first = [f"At its {place} {headline(findings)}" for place, findings in absurd.items()]
    more = [f"  {text}: {count}" for text, count in found["reasons"].items()]
    return "\n".join([*first, said, *more, "", report.text(rows)])


def _absurd(result: api.Result, study: Study) -> dict[str, list[Finding]]:
    """What is not plausible at the points of the least and of the largest value of the first feature, run again alone."""
    name = study.features[0].name
    values = np.where(result.column("status") == "ok", result.column(name), np.nan)
    if not np.isfinite(values).any():
        return {}
    found = {}
    for word, k in (("largest", int(np.nanargmax(values))), ("least", int(np.nanargmin(values)))):
        params = {key: float(x[0]) for key, x in study.params(study.points[k : k + 1]).items()}
        times = study.given.times * (study.ends[k] / study.given.times[-1])
        found[f"{word} {name}, point {k},"] = at(study.given.scene, params, times)
    return {place: findings for place, findings in found.items() if findings}


def page(
    title: str,
    result: api.Result,
    study: Study,
    drawn: Sequence[Picture],
    absurd: Mapping[str, list[Finding]] | None = None,
) -> Page:
    """The report: which parameter moves which feature most, the range of every feature, and points that failed."""
    good = result.column("status") == "ok"
    rows = [["feature", "least", "median", "largest"]]
    for feature in study.features:
        values, unit = result.column(feature.name)[good], feature_unit(feature.name)
        values = values[np.isfinite(values)]
        ends = (np.min(values), np.median(values), np.max(values)) if values.size else [float("nan")] * 3
        rows.append([feature.name, *(brief(float(x), unit) for x in ends)])
    varied = [["parameter", "from", "to"]]
    for name in study.names:
        unit, values = study.given.scene.quantities[name].unit, result.column(name)
        varied.append([name, brief(float(np.min(values)), unit), brief(float(np.max(values)), unit)])
    tables = [Table("Features over all points", rows), Table("What was varied", varied)]
    warnings = []
    if found := result.failed:
        share = f"{found} of {study.count} points failed; the features do not include them."
        warnings.append(share)
        reasons = [[text, str(count)] for text, count in result.state["reasons"].items()]
        tables.append(Table("Failures", [["reason", "points"], *reasons]))
    verdict = judged([one for findings in (absurd or {}).values() for one in findings], _answer(result, study, good))
    return Page(title, verdict, tuple(drawn), tuple(warnings), tuple(tables))


def _answer(result: api.Result, study: Study, good: np.ndarray) -> Verdict:
    """Which parameter moves which feature most, by the range of the feature over its median.

    With several parameters the one whose ranks correlate most with the feature's.
    """
    count = f"{study.count} points"
    if not good.any():
        return Verdict(BAD, "Failed", f"None of {count} has a result.")
    best, feature = -1.0, None
    for one in study.features:
        values = result.column(one.name)[good]
        middle = float(np.nanmedian(np.abs(values))) if np.isfinite(values).any() else 0.0
        spread = float(np.nanmax(values) - np.nanmin(values)) / middle if middle > 0 else -1.0
        if spread > best:
            best, feature = spread, one.name
    kind, word = (FAIR, "Finished, with failures") if result.failed else (GOOD, "Finished")
    if feature is None:
        return Verdict(kind, word, f"{count}; no feature has a value.")
    values = result.column(feature)[good]
    extent = span(values, feature_unit(feature))
    if pictures.together(study, result):
        name = " and ".join(study.names)
    else:
        name = max(study.names, key=lambda n: _rank_correlation(result.column(n)[good], values))
    what = "move" if " and " in name else "moves"
    return Verdict(kind, word, f"{name} {what} {feature} most: {extent} over {count}.")


def _rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Size of Spearman's coefficient; 0 where one does not vary."""
    known = np.isfinite(x) & np.isfinite(y)
    ranks = [np.argsort(np.argsort(v[known])).astype(float) for v in (x, y)]
    if np.count_nonzero(known) < 2 or np.ptp(x[known]) == 0 or np.ptp(y[known]) == 0:
        return 0.0
    return abs(float(np.corrcoef(np.stack(ranks))[0, 1]))
