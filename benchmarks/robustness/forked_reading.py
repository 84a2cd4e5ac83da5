"""Read binary files as ``bcfj_jax.data.isolated`` does, from a process that has imported the reader's library already.

Of a small file, importing the library takes ten times as long as reading. Here one process imports it, and forks for every file;
the fork has the limits, the output and the exit code of ``bcfj_jax.data.child``, which it runs.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any


def serve(child: Any, reader: str, good: str) -> None:
    """Fork for every line of the standard input, [arguments of ``child``, file for its output, file for its errors]."""
    module = importlib.import_module(f"bcfj_jax.data.readers.{child.stand_in(reader)}")
    # It imports what it needs when it reads.
    with contextlib.suppress(Exception):
        module.read(good, "")
    for line in sys.stdin:
        given, out, errors = json.loads(line)
        fork = os.fork()
        if not fork:
            for number, name in ((1, out), (2, errors)):
                os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
            sys.argv[1:] = given
            code = child.main()
            sys.stderr.flush()
            os._exit(code)
        print(os.waitstatus_to_exitcode(os.waitpid(fork, 0)[1]), flush=True)


@contextlib.contextmanager
def imported(reader: ModuleType, good: Path) -> Iterator[None]:
    """Within the block, ``isolated`` reads files of this reader by forks of one process, which has read a good one."""
    from bcfj_jax.data import child, isolated

    command = [sys.executable, "-P", "-W", "ignore", __file__, child.__file__, str(reader.__file__), str(good)]
    quiet = {**os.environ, **dict.fromkeys(isolated._THREADS, "1")}
    server = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=quiet, start_new_session=True
    )
    asked, answers = server.stdin, server.stdout
    assert asked and answers
    with tempfile.TemporaryDirectory() as folder:
        out, errors = Path(folder) / "out", Path(folder) / "errors"

        def run(given: Sequence[str], *, timeout: float, **_: Any) -> Any:
            # Of the whole command, "python -P -W ignore child.py", the arguments.
            print(json.dumps([list(given[5:]), str(out), str(errors)]), file=asked, flush=True)
            if not select.select([answers], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired(given, timeout)
            return SimpleNamespace(
                returncode=int(answers.readline()), stdout=out.read_bytes(), stderr=errors.read_bytes()
            )

        before = isolated.subprocess
        isolated.subprocess = SimpleNamespace(**{**vars(subprocess), "run": run})  # pyright: ignore[reportAttributeAccessIssue]
        try:
            yield
        finally:
            isolated.subprocess = before
            # The fork that reads without end, too.
            os.killpg(server.pid, signal.SIGKILL)
            server.wait()


if __name__ == "__main__":
    _, file, *rest = sys.argv
    spec: Any = importlib.util.spec_from_file_location("child", file)
    spec.loader.exec_module(found := importlib.util.module_from_spec(spec))
    serve(found, *rest)
