"""Workers on this machine: threads of this process, or processes that are started again when they die."""

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

from bcfj_jax.analysis.studies.store import Store
from bcfj_jax.analysis.studies.worker import BAD_INPUT, DONE, INTERRUPTED, work
from bcfj_jax.io import usercode
from bcfj_jax.io.stop import abandon, check

# Workers that may die one after the other without a block being finished.
_DEATHS = 6
_LOOK_S = 0.2


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
    """Have all blocks computed by threads of this process, which share its programs and its imports.

    XLA runs without Python's lock, so threads are as fast as processes where its runs take most of the time. ``progress``
    receives the number of finished blocks, in any of the threads. On Ctrl-C the blocks under way are left behind.
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
    """Have all blocks computed by processes of their own; they end with this one.

    Raises:
        Stopped: if the disk is full, or workers die again and again.
    """
    team: dict[int, subprocess.Popen] = {}
    deaths, most = 0, store.there()
    try:
        for number in range(workers):
            team[number] = start(store, number)
        while team:
            check()
            time.sleep(_LOOK_S)
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
    command = [
        sys.executable,
        "-m",
        "bcfj_jax.analysis.studies.worker",
        str(store.folder),
        str(number),
        str(os.getpid()),
        *usercode.arguments(),
    ]
    # Read when equinox is imported: JAX keeps no program with equinox's checks in its cache (``compile_cache``).
    env = {"EQX_ON_ERROR": "nan", **os.environ}
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=env)
