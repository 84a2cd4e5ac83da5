"""A finished study as its analyses read it: points as shares of their ranges, features, and which rows are usable."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from bcfj_jax.analysis.studies import specification
from bcfj_jax.analysis.studies.api import RESULTS, RUN, Result, finish
from bcfj_jax.analysis.studies.specification import Study
from bcfj_jax.analysis.studies.store import opened, print_fault, read_whole
from bcfj_jax.core.errors import InputError, nearest

T = TypeVar("T")


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
