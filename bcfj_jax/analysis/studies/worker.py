"""A worker: computes blocks of a study's folder until none is left. ``python -m bcfj_jax.analysis.studies.worker DIR NUMBER
PARENT [--code FILE SHA256]...``.

Exit codes are those of the command line: 0 nothing is left, 2 the folder cannot be worked on, 5 the disk is full.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from bcfj_jax.analysis.studies.block import compute
from bcfj_jax.analysis.studies.specification import load
from bcfj_jax.analysis.studies.store import Store, opened
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import usercode
from bcfj_jax.io.stop import check, heeded

DONE, BAD_INPUT, INTERRUPTED = 0, 2, 5
# How often to look for blocks that others have, and for the process that started this one [s].
_LOOK_S, _PARENT_S = 0.05, 0.5


def work(
    store: Store, progress: Callable[[int], None] = lambda _: None, enough: Callable[[], bool] = lambda: False
) -> None:
    """Compute what is missing; return when nothing is, whoever computed it or when ``enough``, asked before each block, is true.

    ``progress`` receives the number of blocks that are there.
    """
    left = list(range(len(store.blocks)))
    while left:
        before = len(left)
        for block in left:
            check()
            if enough():
                return
            if store.finished(block):
                continue
            with store.claimed(block) as mine:
                # Another may have finished it between the look and the claim.
                if mine and not store.finished(block):
                    table = compute(store.study, store.blocks.points(block), store.blocks.size)
                    store.write(block, table)
                    progress(store.there())
        left = [block for block in left if not store.finished(block)]
        if left and len(left) == before:
            time.sleep(_LOOK_S)


def own_core(number: int) -> None:
    """Keep a worker to one core, where the system can: two on one core wait for each other's caches."""
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[number % len(cores)]})


def go_with(parent: int) -> None:
    """End when the process that started this one has gone, whatever it died of."""

    def beat() -> None:
        while os.getppid() == parent:
            time.sleep(_PARENT_S)
        os._exit(INTERRUPTED)

    threading.Thread(target=beat, daemon=True).start()


def main() -> int:
    """Entry point."""
    from bcfj_jax.xla.compile_cache import open_cache

    given = sys.argv[: sys.argv.index("--code")] if "--code" in sys.argv else sys.argv
    folder, number = Path(given[1]), int(given[2])
    own_core(number)
    go_with(int(given[3]))
    open_cache()
    try:
        usercode.from_arguments(sys.argv)
        with heeded():
            work(opened(folder, load(folder / "run.toml")))
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return BAD_INPUT
    except OSError as error:
        sys.stderr.write(f"error: {error.strerror or error}: {error.filename or folder}\n")
        return INTERRUPTED
    except KeyboardInterrupt:
        return INTERRUPTED
    return DONE


if __name__ == "__main__":
    sys.exit(main())
