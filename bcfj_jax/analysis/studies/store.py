"""A study's folder: one file a finished block, whole or not there at all; what is missing is what is left to do.

    run.toml            the study with every default
    environment.json    versions, device, and how many points a block has
    study.json          what ran and what is left, for people and scripts
    blocks/NAME.parquet a block's table; NAME is a digest of all that its content follows from
    blocks/NAME.zarr    its forces, where they are kept
    results.parquet     all tables as one, in the order of the points

A block is written under another name, brought to the disk and moved. It counts as finished if it can be read, its
checksums hold and it says that it is what its name says; else it is done again. A lock that dies with its process
keeps two workers from one block; if the file system has none, both compute the same bytes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcfj_jax.analysis.derivatives.jacobian import channel_names
from bcfj_jax.analysis.studies.block import Blocks, Table, block_size
from bcfj_jax.analysis.studies.specification import Study, needs
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.folder import inside

if TYPE_CHECKING:
    import pyarrow as pa

ENVIRONMENT = "environment.json"
_FACTS = b"bcfj"


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """A name beside a file or folder, of which nothing is left where the block ends by an error."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    _remove(temporary)
    try:
        yield temporary
    finally:
        _remove(temporary)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


class Store:
    """The folder of a study that is cut into blocks."""

    def __init__(self, folder: Path, blocks: Blocks) -> None:
        self.folder, self.blocks, self.study = folder, blocks, blocks.study
        self.place = folder / "blocks"
        self._finished: set[int] = set()

    def path(self, block: int) -> Path:
        """The file of a block's table."""
        return self.place / f"{self.blocks.names[block]}.parquet"

    def finished(self, block: int) -> bool:
        """Whether a block is there and whole; one that is broken is taken away."""
        if block in self._finished:
            return True
        if not self.path(block).exists():
            return False
        if fault := fault_of(self.path(block), self.blocks.names[block], len(self.blocks.points(block))):
            self.discard(block)
            print_fault(self.path(block), fault)
            return False
        self._finished.add(block)
        return True

    def there(self) -> int:
        """How many blocks have a file, whole or not: for a look in passing. Another version's blocks are none."""
        return len({path.stem for path in self.place.glob("*.parquet")}.intersection(self.blocks.names))

    def discard(self, block: int) -> None:
        """Take a block away."""
        self.path(block).unlink(missing_ok=True)
        shutil.rmtree(self.path(block).with_suffix(".zarr"), ignore_errors=True)
        self._finished.discard(block)

    @contextmanager
    def claimed(self, block: int) -> Iterator[bool]:
        """Whether this process alone has the block, within."""
        filelock = needs("filelock")
        locks = self.folder / "locks"
        locks.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(locks / f"{self.blocks.names[block]}.lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            yield False
            return
        try:
            yield True
        finally:
            lock.release()

    def write(self, block: int, table: Table) -> None:
        """Keep a block; on disk when this returns."""
        self.place.mkdir(parents=True, exist_ok=True)
        path = self.path(block)
        steps = table.steps.tolist()
        facts: dict[str, Any] = {"block": self.blocks.names[block], "rounds": table.rounds, "steps": steps}
        if self.study.histories:
            facts["histories"] = _write_forces(path.with_suffix(".zarr"), self.study, table)
        write_parquet(path, arrow(self.study, table), facts)
        self._finished.add(block)

    def keep(self, block: int, files: Mapping[str, bytes]) -> None:
        """Keep a block whose files were written elsewhere; on disk when this returns. ``InputError`` for another's file."""
        self.place.mkdir(parents=True, exist_ok=True)
        path = self.path(block)
        forces = path.with_suffix(".zarr")
        with _whole(self.place / path.stem) as temporary:
            for name, content in files.items():
                target = inside(temporary, str(name), "a worker")
                if str(name).split("/")[0] not in (path.name, forces.name) or not isinstance(content, bytes):
                    raise InputError("a worker", f"sent {str(name)[:200]!r} for block {path.stem}", "end that worker")
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)
                to_disk(target)
            if (temporary / forces.name).exists():
                _remove(forces)
                os.replace(temporary / forces.name, forces)
            os.replace(temporary / path.name, path)
        to_disk(self.place)

    def take(self, other: Path) -> int:
        """Copy the blocks that are whole in another folder and missing here; their number."""
        count = 0
        for block, name in enumerate(self.blocks.names):
            source = other / "blocks" / f"{name}.parquet"
            if self.finished(block) or not source.exists():
                continue
            if fault := fault_of(source, name, len(self.blocks.points(block))):
                sys.stderr.write(f"{source}: {fault}; it is not taken\n")
                continue
            files = [f"{name}.zarr/{part}" for part in facts_of(source).get("histories", {})]
            self.keep(block, {file: (source.parent / file).read_bytes() for file in [*files, source.name]})
            count += 1
        return count

    def read(self, block: int) -> pa.Table:
        """A finished block's table."""
        return _table(self.path(block))


def _table(path: Path) -> pa.Table:
    return needs("pyarrow.parquet").read_table(path, page_checksum_verification=True)


def print_fault(path: Path, fault: str) -> None:
    """Report that a block is done again."""
    sys.stderr.write(f"{path.name}: {fault}; it is computed again\n")


def arrow(study: Study, table: Table) -> pa.Table:
    """A block's table as the contract has it: point, varied parameters, features, status, reason."""
    columns = {"point": table.point.astype(np.int64)}
    columns |= {name: table.values[:, k] for k, name in enumerate(study.names)}
    columns |= {name: table.results[:, k] for k, name in enumerate(study.columns)}
    return needs("pyarrow").table({**columns, "status": table.status, "reason": table.reason})


def write_parquet(path: Path, table: pa.Table, facts: dict[str, Any] | None = None) -> None:
    """A Parquet file with checksums, whole or not at all: the same bytes for the same content."""
    facts = {**(facts or {}), "digest": _content_digest(table, facts or {})}
    table = table.replace_schema_metadata({_FACTS: json.dumps(facts, sort_keys=True).encode()})
    with _whole(path) as temporary:
        needs("pyarrow.parquet").write_table(table, temporary, write_page_checksum=True)
        to_disk(temporary)
        os.replace(temporary, path)
    to_disk(path.parent)


def _content_digest(table: pa.Table, facts: Mapping[str, Any]) -> str:
    """Of columns and facts, however they lie in a file."""
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    for name, column in zip(table.column_names, table.columns, strict=True):
        digest.update(f"{name}\n{column.type}\n".encode())
        texts = str(column.type) == "string"
        digest.update(json.dumps(column.to_pylist()).encode() if texts else column.to_numpy().tobytes())
    return digest.hexdigest()


def to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def facts_of(path: Path) -> dict[str, Any]:
    """What a block's file says of itself."""
    metadata = needs("pyarrow.parquet").read_schema(path).metadata or {}
    return json.loads(metadata.get(_FACTS, b"{}"))


def read_whole(path: Path) -> tuple[pa.Table | None, str]:
    """The table of a file that ``write_parquet`` wrote; else None, and what is wrong with it."""
    needs("pyarrow.parquet")
    try:
        table = _table(path)
        facts = facts_of(path)
        digest = facts.pop("digest")
        same = digest == _content_digest(table, facts)
    except Exception as error:  # Whatever its reader makes of broken bytes.
        return None, f"cannot be read ({type(error).__name__})"
    return (table, "") if same else (None, "is not as it was written")


def fault_of(path: Path, name: str, rows: int) -> str:
    """What is wrong with a block's file; "" if nothing."""
    table, fault = read_whole(path)
    if table is None:
        return fault
    facts = facts_of(path)
    if facts.get("block") != name or table.num_rows != rows:
        return "is not what its name says"
    for part, digest in facts.get("histories", {}).items():
        file = inside(path.with_suffix(".zarr"), part, str(path))
        if not file.exists() or _digest(file) != digest:
            return f"{file.parent.name}/{file.name} is missing or broken"
    return ""


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _write_forces(path: Path, study: Study, table: Table) -> dict[str, str]:
    """Forces (n, T, C, 3) [N], times (n, T) [s] and points (n,) as a Zarr group; digests of its files."""
    with _whole(path) as temporary:
        group = needs("zarr").open_group(temporary, mode="w")
        grid = study.given.times / study.given.times[-1]
        group.create_array("force", data=table.force, chunks=(1, *table.force.shape[1:]))
        group.create_array("time", data=table.ends[:, None] * grid)
        group.create_array("point", data=table.point.astype(np.int64))
        group.attrs["contacts"] = channel_names(study.given.scene.members)
        group.attrs["components"] = ["normal", "axial", "tangential"]
        files = sorted(p for p in temporary.rglob("*") if p.is_file())
        for file in files:
            to_disk(file)
        _remove(path)
        os.replace(temporary, path)
        return {(name := file.relative_to(temporary).as_posix()): _digest(path / name) for file in files}


def opened(folder: Path, study: Study) -> Store:
    """A folder's store, in blocks of the size that the study was begun with; of older ones, which do not say it, a CPU's."""
    path = folder / ENVIRONMENT
    try:
        size = json.loads(path.read_bytes()).get("block_size") if path.exists() else None
        if not (size is None or (type(size) is int and size > 0)):
            raise ValueError(size)
    except (ValueError, AttributeError, RecursionError):
        raise InputError(str(path), "is damaged", "name another folder") from None
    return Store(folder, Blocks(study, size or block_size(study, accelerated=False)))


def merge(store: Store) -> pa.Table:
    """All finished blocks as one table, in the order of the points."""
    parts = [store.read(k).replace_schema_metadata(None) for k in range(len(store.blocks)) if store.finished(k)]
    return needs("pyarrow").concat_tables(parts).combine_chunks().sort_by("point")
