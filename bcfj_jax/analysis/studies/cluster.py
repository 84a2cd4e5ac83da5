"""Many machines: blocks go to the workers of a Dask scheduler, their files come back and are kept here.

Workers need the package and no common folder. Dask gives a block to another worker when one dies; when the scheduler goes,
what was not back yet is handed to the next one at the same address. A worker imports this module, so it loads nothing at
the top that reads the environment.
"""

from __future__ import annotations

import functools
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bcfj_jax.analysis.studies.store import Store

# Names and contents of the user's own files.
Files = tuple[tuple[str, bytes], ...]
# How long a scheduler may be away [s].
PATIENCE_S = 300.0
_PAUSE_S = 1.0


@functools.lru_cache(maxsize=4)
def _blocks(study: str, size: int, code: Files) -> Any:
    import tomllib

    from bcfj_jax.xla.compile_cache import open_cache

    open_cache()
    from bcfj_jax.io import usercode

    usercode.use_only(code)
    from bcfj_jax.analysis.studies.block import Blocks
    from bcfj_jax.analysis.studies.specification import from_table

    return Blocks(from_table(tomllib.loads(study)), size)


def compute_block(study: str, size: int, block: int, name: str, code: Files = ()) -> dict[str, bytes]:
    """On a worker: the files of a block, by their names in ``blocks/``; ``study``: ``run.toml``; ``size``: of a block."""
    blocks = _blocks(study, size, code)
    from bcfj_jax.analysis.studies.block import compute
    from bcfj_jax.analysis.studies.store import Store

    if blocks.names[block] != name:
        raise RuntimeError("this worker has another version of bcfj-jax, or of jax")
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder), blocks)
        store.write(block, compute(blocks.study, blocks.points(block), blocks.size))
        files = (path for path in store.place.rglob("*") if path.is_file())
        return {path.relative_to(store.place).as_posix(): path.read_bytes() for path in files}


def run(store: Store, address: str, progress: Callable[[int], None]) -> None:
    """Have all missing blocks computed by a scheduler's workers; ``worker.Stopped`` if it stays away, or a block cannot be."""
    from bcfj_jax.analysis.studies.worker import Stopped, written
    from bcfj_jax.core.extras import library
    from bcfj_jax.io.stop import check

    distributed = library("distributed", "bcfj study", "cluster")
    from bcfj_jax.io import usercode

    study, size = (store.folder / "run.toml").read_text(encoding="utf-8"), store.blocks.size
    code = tuple((str(one.path), one.text) for one in usercode.used())
    seen = time.monotonic()
    away = (OSError, TimeoutError, distributed.CancelledError, distributed.comm.CommClosedError)
    while missing := [k for k in range(len(store.blocks)) if not store.finished(k)]:
        check()
        try:
            with distributed.Client(address, timeout=10, set_as_default=False) as client:
                seen = time.monotonic()
                names = store.blocks.names
                asked = {
                    client.submit(compute_block, study, size, k, names[k], code, key=f"bcfj-{names[k]}"): k
                    for k in missing
                }
                for future in distributed.as_completed(asked, loop=client.loop):
                    check()
                    files = future.result()
                    # Of ours, not of the scheduler's: no disk is full because a scheduler is away.
                    with written():
                        store.keep(asked[future], files)
                    future.release()
                    seen = time.monotonic()
                    progress(store.there())
        except distributed.KilledWorker as error:
            raise Stopped(f"a block ended every worker that had it: {error}") from None
        except RuntimeError as error:
            if "version" in str(error):
                raise Stopped(str(error)) from None
            raise
        except away as error:
            if time.monotonic() - seen > PATIENCE_S:
                raise Stopped(f"no scheduler at {address}: {error}") from None
            sys.stderr.write(f"the scheduler at {address} is away; {len(missing)} blocks wait for it\n")
            time.sleep(_PAUSE_S)
