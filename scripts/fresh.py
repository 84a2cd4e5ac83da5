"""Fresh virtual environments outside the tree, and commands in them that see nothing of this checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
# Variables that a command keeps: where to install from, and nothing about this checkout or its caches.
_KEPT = ("PATH", "LANG", "LC_ALL", "TMPDIR", "SSL_CERT_FILE", "REQUESTS_CA_BUNDLE")
_KEPT_PREFIXES = ("PIP_", "UV_")


class Done(NamedTuple):
    """A command that ended."""

    code: int
    seconds: float
    stdout: str
    stderr: str


def surroundings(home: Path, **more: str) -> dict[str, str]:
    """Environment variables with a home folder of its own, so that no cache is warm."""
    kept = {k: v for k, v in os.environ.items() if k in _KEPT or k.startswith(_KEPT_PREFIXES)}
    return {**kept, "HOME": str(home), "BCFJ_CACHE": str(home / "bcfj-cache"), "MPLBACKEND": "agg", **more}


def run(command: Sequence[str | Path], cwd: Path, env: dict[str, str], timeout: float = 3600.0) -> Done:
    """Run a command; its output is kept, not shown."""
    begin = time.perf_counter()
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=env, capture_output=True, text=True, timeout=timeout, check=False
    )
    return Done(done.returncode, time.perf_counter() - begin, done.stdout, done.stderr)


def must(command: Sequence[str | Path], cwd: Path, env: dict[str, str]) -> Done:
    """Run a command that has to work; end this process with what it said, where it does not."""
    done = run(command, cwd, env)
    if done.code != 0:
        sys.exit(f"failed ({done.code}): {' '.join(map(str, command))}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}")
    return done


def environment(folder: Path, python: str, env: dict[str, str], *wanted: str | Path) -> Path:
    """A virtual environment with something installed by pip; returns the folder of its programs."""
    must([python, "-m", "venv", folder], folder.parent, env)
    programs = folder / "bin"
    must([programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted], ROOT, env)
    return programs
