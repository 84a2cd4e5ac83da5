"""``study``: the verb. A study in, a finished folder and its table out; what was finished before is not done again.

A finished study is ``read`` for its analyses: points as shares of their ranges, features, and which rows are usable.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from bcfj_jax.analysis.studies import specification, worker
from bcfj_jax.analysis.studies.block import Blocks, block_size
from bcfj_jax.analysis.studies.block import compute as run_points
from bcfj_jax.analysis.studies.specification import Study, needs
from bcfj_jax.analysis.studies.store import (
    ENVIRONMENT,
    Store,
    facts_of,
    merge,
    opened,
    print_fault,
    read_whole,
    write_parquet,
)
from bcfj_jax.core import presented
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.extras import library
from bcfj_jax.core.quantities import whole
from bcfj_jax.io import outputs, report, usercode
from bcfj_jax.io.stop import heeded
from bcfj_jax.io.units import format_si
from bcfj_jax.xla import backend
from bcfj_jax.xla.threads import cores

if TYPE_CHECKING:
    import pyarrow as pa

T = TypeVar("T")
RESULTS, STATE, RUN = "results.parquet", "study.json", "run.toml"
# What a study's folder will hold; the page and the picture are the command's.
_WRITES = (RUN, ENVIRONMENT, RESULTS, STATE, "blocks", "report.html", "report.json", "study.png")
# How long to wait for another run of the study that begins the folder [s].
_WAIT_S = 30.0


class Result(NamedTuple):
    """A finished study: its folder, its table as the contract has it, what ``study.json`` says, and what was asked."""

    folder: Path
    table: pa.Table
    state: dict[str, Any]
    study: Study

    _view = "bcfj_jax.analysis.studies.view"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot

    def column(self, name: str) -> np.ndarray:
        """A column (N,) by name."""
        return self.table.column(name).to_numpy(zero_copy_only=False)

    @property
    def failed(self) -> int:
        """Points that failed."""
        return self.state["failed"]

    def forces(self, point: int) -> tuple[np.ndarray, np.ndarray]:
        """Times (T,) [s] and forces (T, C, 3) [N] of a point; ``InputError`` where the study keeps none of it."""
        for path in sorted((self.folder / "blocks").glob("*.zarr")):
            group = needs("zarr").open_group(path, mode="r")
            at = np.flatnonzero(group["point"][:] == point)
            if at.size:
                return group["time"][int(at[0])], group["force"][int(at[0])]
        remedy = "give a point of the study, and histories = true in its file"
        raise InputError(f"point {point}", "the study keeps no forces of it", remedy)


def study(
    what: Path | str | Mapping[str, Any], out: Path | str, *, workers: int | None = None, scheduler: str | None = None,
    progress: Callable[[int, int], None] = lambda done, all: None, tell: Callable[[Result], None] | None = None,
) -> Result:  # fmt: skip
    """Run a study, or what is missing of it.

    Args:
        what: a study file, or its content.
        out: the folder; one that holds the same study is gone on with.
        workers: processes on this machine, in place of a thread a core; one in all where there is an accelerator.
        scheduler: address of a Dask scheduler that shall do the work in place of this machine.
        progress: receives the numbers of finished and of all blocks.
        tell: receives what there is of the study after its first block, and whenever twice as many are finished.

    Raises:
        InputError: for bad input, and a folder that holds another study.
        worker.Stopped: if the disk is full, or workers die again and again. What is finished stays.
    """
    for key, value, kinds in (("study", what, (str, Path, Mapping)), ("out", out, (str, Path))):
        if not isinstance(value, kinds):
            remedy = "give a file's name" + (", or its content as a table" if key == "study" else "")
            raise InputError(key, quoted(value), remedy)
    if workers is not None:
        whole("workers", workers, most=4096)
    found = specification.from_table(what) if isinstance(what, Mapping) else specification.load(Path(what))
    store = prepare(found, Path(out))
    with heeded():
        compute(store, workers, scheduler, growing(store, progress, tell) if tell else progress)
    return finish(store)


def growing(
    store: Store, progress: Callable[[int, int], None], tell: Callable[[Result], None]
) -> Callable[[int, int], None]:
    """As ``progress``; whenever twice as many blocks of this run are finished ``tell`` receives what there is, but the whole."""
    told: list[int] = []

    def on(done: int, total: int) -> None:
        progress(done, total)
        if not told:
            # What an earlier run left.
            told.append(done)
        elif max(2 * told[-1], 1) <= done < total:
            told.append(done)
            tell(so_far(store))

    return on


def needed(histories: bool, scheduler: bool = False) -> None:
    """Ask for every library that a run imports sooner or later; ``InputError`` if one is not installed."""
    for name in ("pyarrow", "filelock", *(["zarr"] if histories else [])):
        needs(name)
    if scheduler:
        library("distributed", "bcfj study", "cluster")


def prepare(found: Study, folder: Path) -> Store:
    """The folder of a study, made if it is not there; ``InputError`` if it holds another one, or is no folder."""
    needed(found.histories)
    said = folder / RUN
    # Several runs may share the folder; only one begins it.
    with outputs.session():
        outputs.open_folder(folder, "", outputs.Claim("study", _WRITES, goes_on=RUN, wait_s=_WAIT_S))
        if said.exists():
            if specification.load(said).resolved != found.resolved:
                remedy = "give --set and --seed as it was begun, or another folder: nothing is overwritten"
                raise InputError(f"--out {folder}", "holds another study", remedy)
            usercode.same_as(_code(folder), f"--out {folder}: the study there")
        else:
            known = outputs.environment(seed=found.design.seed) | {"block_size": block_size(found)}
            outputs.write_json(folder / ENVIRONMENT, known)
            outputs.write_toml(said, found.resolved, "the study as it was run: every default, SI")
    return opened(folder, found)


def _code(folder: Path) -> list[dict[str, str]]:
    """The user's own files that a study was begun with, as ``usercode.record`` had them."""
    path = folder / ENVIRONMENT
    if not path.exists():
        return []
    try:
        found = json.loads(path.read_bytes())["code"]
        return [{"path": str(one["path"]), "sha256": str(one["sha256"])} for one in found]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(str(path), "is damaged", "name another folder, or remove it if no --code was used") from None


def compute(store: Store, workers: int | None, scheduler: str | None, progress: Callable[[int, int], None]) -> None:
    """Have every block computed."""
    total = len(store.blocks)
    # All are looked at, so that every broken one is taken away before there are workers.
    if all([store.finished(k) for k in range(total)]):
        progress(total, total)
        return
    progress(store.there(), total)
    if scheduler is not None:
        from bcfj_jax.analysis.studies import cluster

        cluster.run(store, scheduler, lambda done: progress(done, total))
        return
    # One process has an accelerator: others would find no memory left there.
    count = min(workers or default_workers(), total) if backend.on_cpu() else 1
    if count == 1 or workers is None:
        with worker.written():
            worker.in_threads(store, count, lambda done: progress(done, total))
    else:
        worker.run(store, count, lambda done: progress(done, total))


def default_workers() -> int:
    """One a core; one in all where an accelerator does the work."""
    return cores() if backend.on_cpu() else 1


def finish(store: Store) -> Result:
    """``results.parquet`` and ``study.json`` of a folder whose blocks are all there."""
    table, found = merge(store), state(store)
    with worker.written():
        write_parquet(store.folder / RESULTS, table)
        outputs.write_json(store.folder / STATE, found)
    return Result(store.folder, table, found, store.study)


def so_far(store: Store) -> Result:
    """What there is of a study, of which a block is finished at least."""
    return Result(store.folder, merge(store), state(store), store.study)


def state(store: Store) -> dict[str, Any]:
    """What ran and what is left."""
    blocks, count = store.blocks, store.study.count
    finished = [k for k in range(len(blocks)) if store.finished(k)]
    points = sum(len(blocks.points(k)) for k in finished)
    failures, steps, rounds = [], 0, 0
    for k in finished:
        table, facts = store.read(k), facts_of(store.path(k))
        each = zip(table["reason"].to_pylist(), table["status"].to_pylist(), strict=True)
        failures += [text.split(" at ")[0] for text, status in each if status == "failed"]
        steps, rounds = steps + sum(facts["steps"]), rounds + facts["rounds"]
    return {
        "points": count, "finished": points, "left": count - points, "failed": len(failures),
        "reasons": dict(Counter(failures)), "blocks": len(blocks), "blocks_finished": len(finished), "steps": steps,
        "rounds": rounds, "code": usercode.record(), "status": "finished" if points == count else "unfinished",
        "written": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }  # fmt: skip


def estimate(study: Study, workers: int | None) -> str:
    """How many points, and about how long and how large, from a few that are run here and thrown away."""
    blocks = Blocks(study)
    at = blocks.order[np.unique(np.linspace(0, study.count - 1, min(blocks.size, 8)).astype(int))]
    begin = time.perf_counter()
    run_points(study, at, blocks.size)
    middle = time.perf_counter()
    table = run_points(study, at, blocks.size)
    each = (time.perf_counter() - middle) / len(at)
    team = (workers or default_workers()) if backend.on_cpu() else 1
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


class Finished(NamedTuple):
    """A study and its table, in the order of the points: values (N, D) as they were run [SI], (N,) of each of
    ``study.columns``, NaN where a run failed, and whether each did not.
    """

    study: Study
    values: np.ndarray
    columns: Mapping[str, np.ndarray]
    ok: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """(N, D) of the way from each lower bound to the upper one: by logarithm on a log axis, by probability on a normal."""
        return np.stack([axis.share(self.values[:, k]) for k, axis in enumerate(self.study.design.axes)], axis=1)

    def feature(self, name: str) -> np.ndarray:
        """A feature (N,), NaN where the run failed; ``InputError`` for one that the study did not keep."""
        known = [f.name for f in self.study.features]
        if name not in known:
            raise InputError(f"feature '{name}'", "the study did not keep it", nearest(name, known))
        return np.where(self.ok, self.columns[name], np.nan)

    def each(self, ask: Callable[[str], T], features: Sequence[str] = ()) -> tuple[list[T], dict[str, str]]:
        """What ``ask`` gives of the features named, or of all that have it, and why the others have none.

        An error is raised where one that is named has none, or where no feature has any.
        """
        good, errors = [], {}
        for name in features or [f.name for f in self.study.features]:
            try:
                good.append(ask(name))
            except InputError as error:
                errors[name] = error
        if errors and (features or not good):
            raise next(iter(errors.values()))
        return good, {name: f"{error.found}; {error.remedy}" for name, error in errors.items()}


def _table(folder: Path, study: Study) -> Any:
    """``results.parquet``, made again of its blocks where it is damaged."""
    path, remedy = folder / RESULTS, "say bcfj study resume"
    if not path.exists():
        raise InputError(str(folder), f"there is no {RESULTS}: the study is not finished", remedy)
    table, fault = read_whole(path)
    if table is not None:
        return table
    store = opened(folder, study)
    missing = sum(not store.finished(k) for k in range(len(store.blocks)))
    if missing:
        raise InputError(str(path), f"{fault}, and {missing} of {len(store.blocks)} blocks are missing", remedy)
    print_fault(path, fault)
    return finish(store).table


Source = Finished | Result | Path | str


def read(source: Source) -> Finished:
    """A finished study, from what ``bcfj_jax.study`` gave back or from its folder; ``InputError`` where there is none."""
    if isinstance(source, Finished):
        return source
    if isinstance(source, Result):
        folder, study, table = source.folder, source.study, source.table
    else:
        folder = Path(source)
        if not (folder / RUN).exists():
            raise InputError(str(folder), "there is no study", "name the folder of one: what --out said")
        study = specification.load(folder / RUN)
        table = _table(folder, study)
    if table.num_rows != study.count:
        found = f"{table.num_rows} rows for {study.count} points"
        raise InputError(str(folder / RESULTS), found, "say bcfj study resume")

    def column(name: str) -> np.ndarray:
        return table.column(name).to_numpy(zero_copy_only=False)

    values = np.stack([column(name) for name in study.names], axis=1)
    return Finished(study, values, {name: column(name) for name in study.columns}, column("status") == "ok")
