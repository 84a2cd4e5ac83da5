"""Processes of their own: the command ``bcfj``, functions of benchmarks, and what signals and surroundings do to them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import psutil

from benchmarks.common import ROOT

# A shell's background jobs, and what they start, ignore Ctrl-C; a user's do not.
_COMMAND = (
    "import runpy, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "runpy.run_module('bcfj_jax', run_name='__main__', alter_sys=True)"
)
IMPACT = '[scene]\nkind = "impact"\n'
STUDY = """\
scene = "impact"
[design]
kind = "grid"
[vary.stiffness]
lower = 1e6
upper = 1e8
steps = {steps}
scale = "log"
[vary.damping]
values = [0.0, 0.1]
[results]
features = ["contact.peak", "contact.impulse", "contact.contact_fraction"]
"""
EXAMPLE = ROOT / "examples" / "chung_ooi_fit.toml"


def environment(variables: Mapping[str, str | None] | None = None, checkout: Path = ROOT) -> dict[str, str]:
    """The variables of a process: ours, with the package of a checkout, and some set and, by None, some taken away."""
    paths = [str(checkout), os.environ.get("PYTHONPATH", "")] if checkout == ROOT else [str(checkout)]
    found: dict[str, str | None] = {
        **{k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64", "EQX_ON_ERROR")},
        "BCFJ_CACHE": str(ROOT / "build" / "jax-cache"),
        "PYTHONPATH": os.pathsep.join(paths),
        **(variables or {}),
    }
    return {name: value for name, value in found.items() if value is not None}


class Done(NamedTuple):
    """How a process ended.

    Attributes:
        first_s: until its first line on stdout.
        cpu_s, peak_mb: processor time, and most memory held, of the process and its children.
    """

    code: int
    out: str
    err: str
    first_s: float
    wall_s: float
    cpu_s: float
    peak_mb: float


def done(command: Sequence[str | Path], cwd: Path = ROOT, environment: Mapping[str, str] | None = None) -> Done:
    """Run a process to its end; its errors are passed on with the exit code."""
    with tempfile.TemporaryFile("w+") as err:
        begin = time.perf_counter()
        job = subprocess.Popen(
            command, cwd=cwd, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=err, text=True
        )
        assert job.stdout is not None
        line = job.stdout.readline()
        first = time.perf_counter() - begin
        out = line + job.stdout.read()
        _, status, used = os.wait4(job.pid, 0)
        wall, job.returncode = time.perf_counter() - begin, os.waitstatus_to_exitcode(status)
        err.seek(0)
        return Done(job.returncode, out, err.read(), first, wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)


def bcfj(
    words: Sequence[str], cwd: Path = ROOT, variables: Mapping[str, str | None] | None = None, checkout: Path = ROOT
) -> Done:
    """The command of a checkout, run to its end."""
    return done([sys.executable, "-m", "bcfj_jax", *words], cwd, environment(variables, checkout))


# Runs a function of a file, whose folder need not be a package's, and ends with its result as JSON.
_CALL = "import json, runpy, sys; print(json.dumps(runpy.run_path(sys.argv[1])[sys.argv[2]](*json.loads(sys.argv[3]))))"


def call(
    file: str, function: str, *arguments: Any, variables: Mapping[str, str | None] | None = None, checkout: Path = ROOT
) -> Any:
    """What a function of a file gives in a process of its own, with the package of a checkout; both sides are JSON."""
    command = [sys.executable, "-c", _CALL, file, function, json.dumps(arguments)]
    ran = done(command, checkout, environment(variables, checkout))
    if ran.code:
        raise SystemExit(f"{file}, {function}: exit code {ran.code}\n{ran.err[-3000:]}")
    return json.loads(ran.out.splitlines()[-1])


def commit(checkout: Path) -> str:
    """What a checkout is at."""
    return done(["git", "rev-parse", "HEAD"], checkout).out.strip()


def command(words: Sequence[str]) -> list[str]:
    """``bcfj`` with these words, which heeds Ctrl-C."""
    return [sys.executable, "-c", _COMMAND, *words]


def start(
    arguments: list[str], cwd: Path, variables: Mapping[str, str | None] | None = None, umask: int = -1,
    stdout: int = subprocess.PIPE, prefix: Sequence[str] = (), stderr: int | IO[str] = subprocess.PIPE,
) -> subprocess.Popen[str]:  # fmt: skip
    """A command that runs.

    Args:
        arguments: of ``bcfj``.
        cwd: its folder.
        variables: see ``environment``.
        umask: of its files, -1 for ours.
        stdout: where it prints.
        prefix: words before the command's own.
        stderr: where it says what it does.
    """
    return subprocess.Popen(
        [*prefix, *command(arguments)], cwd=cwd, env=environment(variables), umask=umask,
        stdin=subprocess.DEVNULL, stdout=stdout, stderr=stderr, text=True, errors="replace",
    )  # fmt: skip


def spent(job: subprocess.Popen[str]) -> float:
    """Processor time [s] of a process and its children so far; of one that has ended, infinite."""
    try:
        root = psutil.Process(job.pid)
        if root.status() == psutil.STATUS_ZOMBIE:
            return float("inf")
        own = root.cpu_times()
        total = own.user + own.system + own.children_user + own.children_system
        for child in root.children(recursive=True):
            try:
                times = child.cpu_times()
            except psutil.Error:
                continue
            total += times.user + times.system
        return total
    except psutil.Error:
        return float("inf")


def wait_for(job: subprocess.Popen[str], processor_s: float) -> None:
    """Return when a process has used so much processor time, or has ended: that does not depend on who else computes."""
    while (left := processor_s - spent(job)) > 0.0:
        # On all cores a process could not reach it earlier; to look at every process costs some time itself.
        time.sleep(max(0.02, left / 4.0))


def ended(job: subprocess.Popen[str], seconds: float = 600.0) -> tuple[int, str, str]:
    """Exit code (None's place is 124 for a hang), output and errors of a command."""
    try:
        out, err = job.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        job.kill()
        out, err = job.communicate()
        return 124, out or "", err or ""
    return job.returncode, out or "", err or ""


def files(folder: Path) -> list[str]:
    """Names of the files below a folder."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()) if folder.exists() else []


def last_line(text: str, place: Path) -> str:
    """The last line that is an error, else the last one, at most 160 characters of it, without paths of this machine."""
    text = re.sub(
        rf"{re.escape(tempfile.gettempdir())}/tmp\w+/", "", text.replace(f"{place}/", "").replace(f"{ROOT}/", "")
    )
    lines = [line for line in text.splitlines() if line.strip()]
    wrong = [line for line in lines if line.startswith(("error:", "interrupted", "stopped:"))]
    return (wrong or lines or [""])[-1][:160]
