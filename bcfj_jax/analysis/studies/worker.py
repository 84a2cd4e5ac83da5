"""Workers on this machine: threads of this process, or processes that are started again when they die.

``python -m bcfj_jax.analysis.studies.worker DIR NUMBER PARENT [--code FILE SHA256]...`` is one of these. Its exit codes are
those of the command line: 0 nothing is left, 2 the folder cannot be worked on, 5 the disk is full.
"""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from bcfj_jax.analysis.studies.block import compute
from bcfj_jax.analysis.studies.specification import load
from bcfj_jax.analysis.studies.store import Store, opened
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import usercode
from bcfj_jax.io.stop import abandon, check, heeded

DONE, BAD_INPUT, INTERRUPTED = 0, 2, 5
# How often to look for blocks that others have, for the process that started this one, and for processes that ended [s].
_LOOK_S, _PARENT_S, _TEAM_S = 0.05, 0.5, 0.2
# Workers that may die one after the other without a block being finished.
_DEATHS = 6


def work(
    store: Store, progress: Callable[[int], None] = lambda _: None, enough: Callable[[], bool] = lambda: False
) -> None:
    """Compute what is missing, until nothing is, whoever computed it, or ``enough``, asked before each block, is true."""
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


class Stopped(Exception):
    """A study that could not go on; its folder holds what was finished."""


@contextlib.contextmanager
def written() -> Iterator[None]:
    """Within, what cannot be written raises ``Stopped``, saying why."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        where = f" ({error.filename})" if error.filename else ""
        said = f"{error.strerror or error}{where}: "
        raise Stopped(said + ("free some space and resume" if full else "mend that and resume")) from None


def in_threads(store: Store, threads: int, progress: Callable[[int], None]) -> None:
    """Have all blocks computed by threads of this process; ``progress`` receives the number of finished blocks.

    XLA runs without Python's lock, so threads are as fast as processes. On Ctrl-C the blocks under way are left behind.
    """
    enough, telling = threading.Event(), threading.Lock()

    def tell(_: int) -> None:
        # Counted within the lock, so that a smaller number never follows a greater one.
        with telling:
            progress(store.there())

    pool = ThreadPoolExecutor(threads)
    try:
        for done in as_completed([pool.submit(work, store, tell, enough.is_set) for _ in range(threads)]):
            done.result()
    except BaseException:
        abandon()
        raise
    finally:
        enough.set()
        pool.shutdown(wait=False)


def run(store: Store, workers: int, progress: Callable[[int], None]) -> None:
    """Have all blocks computed by processes of their own; ``Stopped`` if the disk is full, or workers die again and again."""
    team: dict[int, subprocess.Popen] = {}
    deaths, most = 0, store.there()
    try:
        for number in range(workers):
            team[number] = start(store, number)
        while team:
            check()
            time.sleep(_TEAM_S)
            there = store.there()
            deaths, most = (0, there) if there > most else (deaths, most)
            progress(there)
            for number, worker in list(team.items()):
                code = worker.poll()
                if code is None:
                    continue
                del team[number]
                if code == INTERRUPTED:
                    raise Stopped("a worker could not write; its message stands above")
                if code == BAD_INPUT:
                    raise Stopped("a worker could not read the study")
                if code != DONE:
                    deaths += 1
                    if deaths >= _DEATHS:
                        raise Stopped(f"{deaths} workers ended (code {code}) and no block was finished in between")
                    sys.stderr.write(f"worker {number} ended (code {code}); another takes its place\n")
                    team[number] = start(store, number)
    finally:
        for worker in team.values():
            worker.terminate()
        for worker in team.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                worker.wait(5)
            worker.kill()
            worker.wait()


def start(store: Store, number: int) -> subprocess.Popen:
    """A worker, which goes when this process goes."""
    given = str(store.folder), str(number), str(os.getpid()), *usercode.arguments()
    command = [sys.executable, "-m", "bcfj_jax.analysis.studies.worker", *given]
    # Read when equinox is imported: JAX keeps no program with equinox's checks in its cache (``compile_cache``).
    env = {"EQX_ON_ERROR": "nan", **os.environ}
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=env)


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
