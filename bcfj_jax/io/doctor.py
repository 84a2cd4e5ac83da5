"""What ``bcfj doctor`` finds: versions, devices, threads, the folder of compiled programs, extras; and what to do."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import stat
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

from packaging.requirements import Requirement

from bcfj_jax.core.extras import EXTRAS
from bcfj_jax.io import report
from bcfj_jax.io.provenance import installed as _installed
from bcfj_jax.io.provenance import version
from bcfj_jax.xla import backend, programs
from bcfj_jax.xla.threads import cores

GOOD, NOTE, BAD = "ok", "note", "FAULT"
# Variables that change what JAX, XLA and the threads of a run do.
VARIABLES = ("XLA_FLAGS", "JAX_PLATFORMS", "JAX_ENABLE_X64", "OMP_NUM_THREADS", "BCFJ_CACHE", "EQX_ON_ERROR")
_PACKAGE = "bcfj-jax"


class Finding(NamedTuple):
    """One thing that was looked at: ``GOOD``, ``NOTE`` or ``BAD``, what, what was found, and what to do ("" for nothing)."""

    state: str
    what: str
    found: str
    remedy: str = ""


def examine() -> list[Finding]:
    """Look at this installation and this machine. JAX is imported; nothing is compiled or written."""
    python = f"{platform.python_version()} at {sys.prefix}, bcfj-jax {version()}"
    limit = os.environ.get("OMP_NUM_THREADS")
    threads = f"{cores()} for this process{f', OMP_NUM_THREADS={limit}' if limit else ''}"
    return [
        Finding(GOOD, "Python", python), *_libraries(), *_devices(), Finding(GOOD, "cores", threads), _cache(), *_extras(),
        *(Finding(GOOD, name, os.environ[name][:200]) for name in VARIABLES if os.environ.get(name)),
    ]  # fmt: skip


def healthy(findings: Sequence[Finding]) -> bool:
    """Whether nothing is a fault."""
    return all(one.state != BAD for one in findings)


def text(findings: Sequence[Finding]) -> str:
    """The findings as a table, and what to do below it."""
    rows = [["", "what", "found"], *([one.state, one.what, one.found] for one in findings)]
    todo = [f"{one.what}: {one.remedy}" for one in findings if one.remedy]
    faults = sum(one.state == BAD for one in findings)
    end = f"{faults} fault(s) were found." if faults else "No fault was found."
    return "\n".join([report.text(rows), "", end, *(["What can be done:"] if todo else []), *todo])


def content(findings: Sequence[Finding]) -> dict[str, Any]:
    """The findings for ``--json``."""
    return {"healthy": healthy(findings), "findings": [one._asdict() for one in findings]}


def _requirements() -> list[Requirement]:
    try:
        return [Requirement(line) for line in importlib.metadata.requires(_PACKAGE) or ()]
    except importlib.metadata.PackageNotFoundError:
        return []


def _libraries() -> list[Finding]:
    """Required libraries: present, and of a version that is allowed; some of JAX's compute wrong numbers or hang."""
    required = [one for one in _requirements() if one.marker is None]
    if not required:
        return [Finding(NOTE, "libraries", "the package's requirements are not known", f"pip install {_PACKAGE}")]
    found = []
    for one in sorted(required, key=lambda one: one.name):
        version_ = _installed(one.name)
        if version_ is None:
            why = "not installed"
        elif version_ in [spec.version for spec in one.specifier if spec.operator == "!="]:
            why = f"{version_}, which computes wrong numbers, hangs or is slow"
        elif not one.specifier.contains(version_, prereleases=True):
            why = f"{version_}, allowed is {one.specifier}"
        else:
            continue
        found.append(Finding(BAD, one.name, why, f'pip install "{one}"'))
    names = ("jax", "jaxlib", "diffrax", "equinox", "numpy", "scipy")
    versions = ", ".join(f"{name} {_installed(name) or 'missing'}" for name in names)
    return [Finding(BAD if found else GOOD, "libraries", versions), *found]


def _devices() -> list[Finding]:
    import jax

    try:
        devices = jax.devices()
    except RuntimeError as error:
        why = str(error).splitlines()[0][:200]
        return [Finding(BAD, "devices", why, "set JAX_PLATFORMS=cpu, or install a jaxlib for the accelerator")]
    listed = ", ".join(f"{d.platform}:{d.id} {d.device_kind}" for d in devices)
    wide = bool(jax.config.jax_enable_x64)  # pyright: ignore[reportAttributeAccessIssue]
    numbers = (GOOD, "64-bit numbers", "on") if wide else (BAD, "64-bit numbers", "off", "unset JAX_ENABLE_X64")
    return [Finding(GOOD, "devices", listed), Finding(*numbers), Finding(GOOD, "studies", _of_studies())]


def _of_studies() -> str:
    if backend.on_cpu():
        return f"on the CPU, {cores()} threads"
    size = f", {backend.memory() / 2**30:.0f} GiB of its memory" if backend.memory() else ""
    return f"in one process on the accelerator{size}; JAX_PLATFORMS=cpu takes the CPU"


def _cache() -> Finding:
    what, given = "compiled programs", os.environ.get("BCFJ_CACHE")
    if given == "off":
        return Finding(NOTE, what, "not kept: BCFJ_CACHE=off", "unset BCFJ_CACHE: every run compiles anew without them")
    folder = programs.Settings.folder
    if folder is None:
        remedy = "name a folder that only you can write in BCFJ_CACHE: every run compiles anew without it"
        return Finding(BAD, what, "not kept: their folder cannot be used", remedy)
    files = [path for path in folder.parent.rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files)
    mode = stat.S_IMODE(folder.stat().st_mode)
    found = f"{len(files)} files, {size / 1e6:.0f} MB, in {folder.parent}, mode {mode:04o}"
    if mode & 0o077:
        return Finding(BAD, what, found, f"chmod -R go-rwx {folder.parent}: XLA trusts what it finds there")
    return Finding(GOOD, what, found)


def _extras() -> list[Finding]:
    found = []
    for extra, purpose in EXTRAS.items():
        parts = [one for one in _requirements() if one.marker and one.marker.evaluate({"extra": extra})]
        # JAX itself is there; what its own extra brings is a plugin.
        names = ["jax-cuda13-plugin" if one.name == "jax" else one.name for one in parts if one.name != _PACKAGE]
        missing = [name for name in names if _installed(name) is None]
        if missing:
            remedy = f'pip install "bcfj-jax[{extra}]"'
            found.append(Finding(NOTE, f"extra {extra}", f"{', '.join(missing)} missing; it is for {purpose}", remedy))
        elif names:
            found.append(Finding(GOOD, f"extra {extra}", ", ".join(f"{n} {_installed(n)}" for n in names)))
    return found
