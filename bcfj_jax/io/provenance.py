"""What a result was made with: versions, commit, device, seed, the checksums of the data and of the user's own code."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.metadata
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bcfj_jax._version import __version__

_PACKAGES = ("jax", "jaxlib", "diffrax", "equinox", "optimistix", "lineax", "numpy", "scipy", "pint", "pydantic")


def version() -> str:
    """The version of bcfj-jax: of this code, whatever an installer has noted."""
    return __version__


def installed(package: str) -> str | None:
    """The version of an installed package; None where it is not installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _commit() -> dict[str, Any]:
    root = Path(__file__).resolve().parents[2]

    def git(*words: str) -> str:
        asked = ["git", "-C", str(root), *words]
        return subprocess.run(asked, capture_output=True, text=True, timeout=10, check=True).stdout.strip()

    # An installed package may lie inside some other repository, whose commit says nothing.
    if (root / ".git").exists():
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            return {"commit": git("rev-parse", "HEAD"), "modified": bool(git("status", "--porcelain"))}
    return {"commit": None, "modified": None}


def environment(seed: int | None = None, data: Sequence[Path] = ()) -> dict[str, Any]:
    """``environment.json``: versions, device, seed, and the SHA-256 of every data file and of the user's own code."""
    import jax

    from bcfj_jax.io import usercode

    return {
        "bcfj_jax": version(),
        "git": _commit(),
        "python": sys.version.split()[0],
        "platform": platform.platform(),
        "packages": {name: installed(name) or "unknown" for name in _PACKAGES},
        "device": {"backend": jax.default_backend(), "devices": [str(d) for d in jax.devices()]},
        "seed": seed,
        "data": {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in data},
        "code": usercode.record(),
    }
