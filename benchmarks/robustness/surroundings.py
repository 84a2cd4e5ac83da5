"""Every verb in odd surroundings: it does its work, or says in a sentence why not and leaves nothing behind.

    python -m benchmarks.robustness.surroundings [--verbs init,simulate,...] [--cases "full disk",...] [--more]
writes results/surroundings.json; ``--more`` replaces only the cells that it runs. The disks are file systems of 1 MB in
memory, which only the administrator can mount; elsewhere they are left out. The administrator may write everywhere: for a
read-only home and a umask of 777 that right is taken from the process.

A cell is good if the exit code is that of the verb in plain surroundings and the same files are there; or if it is 2,
or 5 where work is kept, with a line that begins with "error:" and no file left. ``doctor`` may also find a fault (1), and
``report`` leaves the folder that it was given as it was, byte for byte. There must be no traceback, and no wait
beyond 300 s.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.common import known, markdown, options, save
from benchmarks.processes import EXAMPLE, IMPACT, STUDY, ended, files, last_line, start

_HANG_S = 300.0
_MB = 1 << 20
# Takes from an administrator's process the rights that other users do not have.
_BOUND = ("setpriv", "--bounding-set=-all", "--inh-caps=-all")
PLAIN = "plain"


class Case(NamedTuple):
    """Surroundings.

    Attributes:
        variables: of the process, None for one that is taken away; {disk} and {place} are folders.
        umask: of the process, -1 for ours.
        disk: the file system for the results.
        name: of the scene's file.
        output: where the process prints: a pipe that is read, one that nobody reads, or a full disk.
        bound: whether modes of files hold for the process, an administrator's too.
    """

    variables: dict[str, str | None] = {}
    umask: int = -1
    disk: str = ""
    name: str = "impact.toml"
    output: str = "read"
    bound: bool = False


_NO_CACHE: dict[str, str | None] = {"BCFJ_CACHE": None, "XDG_CACHE_HOME": None}
CASES = {
    PLAIN: Case(),
    "full disk": Case(disk="full"),
    "disk of 1 MB": Case(disk="small"),
    "read-only disk": Case(disk="read-only"),
    "below a file": Case(disk="below a file"),
    "full disk for home, cache, temporary files": Case(
        {**_NO_CACHE, "HOME": "{disk}", "TMPDIR": "{disk}", "MPLCONFIGDIR": None}, disk="full, not for results"
    ),
    "output to a full disk": Case(output="full"),
    "output that nobody reads": Case(output="closed"),
    "read-only home": Case({**_NO_CACHE, "HOME": "{place}/home"}, bound=True),
    "no home": Case({**_NO_CACHE, "HOME": None}),
    "umask 000": Case(umask=0o000),
    "umask 777": Case(umask=0o777, bound=True),
    "MPLBACKEND of Jupyter": Case({"MPLBACKEND": "module://matplotlib_inline.backend_inline"}),
    "JAX_PLATFORMS=foo": Case({"JAX_PLATFORMS": "foo"}),
    "JAX_DISABLE_JIT=1": Case({"JAX_DISABLE_JIT": "1"}),
    "JAX_ENABLE_X64=0": Case({"JAX_ENABLE_X64": "0"}),
    "JAX_DEBUG_NANS=maybe": Case({"JAX_DEBUG_NANS": "maybe"}),
    "EQX_ON_ERROR=breakpoint": Case({"EQX_ON_ERROR": "breakpoint"}),
    "XLA_FLAGS=--xla_foo": Case({"XLA_FLAGS": "--xla_foo"}),
    "no TERM; LC_ALL=C; name not ASCII": Case({"TERM": None, "LC_ALL": "C", "LANG": None}, name="schräg µ.toml"),
    "name of no characters": Case(name=os.fsdecode(b"odd\xff\xe4.toml")),
}


def verbs(scene: str, out: str) -> dict[str, list[str]]:
    """What is run of each verb."""
    to = ["--out", out]
    return {
        "schema": ["schema", "scene"],
        "validate": ["validate", scene],
        "doctor": ["doctor"],
        "init": ["init", "impact", *to],
        "verify": ["verify", "--only", "hertz_impact"],
        "simulate": ["simulate", scene, *to],
        "report": ["report", out],
        "sensitivity": ["sensitivity", scene, "--wrt", "stiffness", "--budget", "1", *to],
        "calibrate": ["calibrate", str(EXAMPLE), "--starts", "4", *to],
        "study": ["study", "run", "study.toml", "--workers", "1", *to],
        "design": ["design", scene, "--minimize", "contact.peak", "--vary", "damping=0.1:1", "--starts", "2", *to],
        "tradeoff": ["tradeoff", scene, "--only", "tsit5", "--no-derivatives", *to],
        "reproduce": ["reproduce", *to],
    }


@contextlib.contextmanager
def disk(case: Case, place: Path, given: Path | None) -> Iterator[Path]:
    """A folder for results: on a file system of 1 MB, full or read-only; or below a file.

    Args:
        case: says which.
        place: the folder of the cell.
        given: results that are in the folder already, beside the 1 MB.
    """
    kind = case.disk
    if kind == "below a file":
        (place / "file").write_text("")
        yield place / "file" / "out"
        return
    mounted = place / "disk"
    mounted.mkdir()
    out = (place / "own" if kind == "full, not for results" else mounted) / "out"
    out.parent.mkdir(exist_ok=True)
    size = _MB + sum(-(-p.stat().st_size // 4096) * 4096 for p in given.iterdir()) if given else _MB
    if kind:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(mounted)], check=True)
    try:
        if given:
            shutil.copytree(given, out)
        if kind.startswith("full"):
            with contextlib.suppress(OSError), (mounted / "filler").open("wb", buffering=0) as file:
                while file.write(b"x" * 4096):
                    pass
        if kind == "read-only":
            subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
        (place / "home").mkdir(mode=0o555)
        yield out
    finally:
        if kind:
            subprocess.run(["umount", str(mounted)], check=True)


@contextlib.contextmanager
def output(kind: str) -> Iterator[int]:
    """Where a process prints."""
    if kind == "full":
        handle = os.open("/dev/full", os.O_WRONLY)
    elif kind == "closed":
        readable, handle = os.pipe()
        os.close(readable)
    else:
        yield subprocess.PIPE
        return
    try:
        yield handle
    finally:
        os.close(handle)


def digests(folder: Path) -> dict[str, str]:
    """What is in the files of a folder."""
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files(folder)}


def tried(verb: str, case: Case, plain: dict[str, Any] | None, results: Path) -> dict[str, Any]:
    """One verb in one case.

    Args:
        verb, case: which.
        plain: how the verb ended in plain surroundings.
        results: a folder that ``simulate`` has written.
    """
    given = results if verb == "report" and case.disk != "below a file" else None
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        (place / case.name).write_text(IMPACT)
        (place / "study.toml").write_text(STUDY.format(steps=3))
        variables = {key: x and x.format(disk=place / "disk", place=place) for key, x in case.variables.items()}
        with disk(case, place, given) as out:
            words = verbs(case.name, str(out))[verb]
            before, had = sorted(p.name for p in place.iterdir()), digests(out) if given else {}
            prefix = _BOUND if case.bound and os.geteuid() == 0 else ()
            with output(case.output) as prints:
                code, _, err = ended(start(words, place, variables, case.umask, prints, prefix), _HANG_S)
            left = digests(out) if case.disk != "below a file" else {}
            strays = sorted(set(p.name for p in place.iterdir()) - set(before))
    said = last_line(err, place)
    row = {"code": code, "files": len(left), "strays": strays, "said": said if code else ""}
    refused = code in (2, 5) and said.startswith("error:") and (left == had or code == 5)
    if verb == "doctor" and code == 1:
        refused = True
    worked = plain is None or (code == plain["code"] and len(left) == plain["files"])
    row["good"] = "Traceback" not in err and not strays and (worked or refused)
    if not row["good"]:
        row["errors"] = err[-1500:].replace(str(place), "")
    return row


def table(names: list[str], rows: dict[str, dict[str, Any]]) -> list[list[str]]:
    """Exit codes, a case a row, a verb a column; their number and that of the good ones in the last row."""

    def cell(found: dict[str, Any] | None) -> str:
        if found is None:
            return ""
        return f"{found['code']}" if found["good"] else "-" if found["good"] is None else f"{found['code']} NOT GOOD"

    cells = [c for row in rows.values() for c in row.values() if c["good"] is not None]
    good = sum(c["good"] for c in cells)
    lines = [[title, *(cell(row.get(name)) for name in names)] for title, row in rows.items()]
    return [["", *(f"`{name}`" for name in names)], *lines, [f"good: {good} of {len(cells)}", *("" for _ in names)]]


def main() -> None:
    cases, more = ("|".join(CASES), 'separated by "|"'), (False, "keep the cells of before that are not run")
    given = options(__doc__, verbs=",".join(verbs("", "")), cases=cases, more=more)
    names = given.verbs.split(",")
    rows: dict[str, dict[str, Any]] = {title: {} for title in CASES}
    if given.more:
        rows |= {title: row for title, row in known("surroundings").get("cases", {}).items() if title in CASES}
    asked = [title for title in CASES if title in given.cases.split("|")]
    with tempfile.TemporaryDirectory() as name:
        results = Path(name) / "results"
        code, _, err = ended(start(["simulate", "impact", "--out", str(results)], Path(name)))
        if code:
            raise SystemExit(f"simulate: exit code {code}: {err}")
        for title in asked:
            for verb in names:
                plain = None if title == PLAIN else rows[PLAIN].get(verb)
                try:
                    rows[title][verb] = tried(verb, CASES[title], plain, results)
                except (subprocess.CalledProcessError, FileNotFoundError, PermissionError):
                    rows[title][verb] = {"code": None, "good": None, "said": "needs an administrator"}
                print(title, verb, rows[title][verb], flush=True)
            save("surroundings", {"cases": rows})
    counted = table(list(verbs("", "")), rows)
    save("surroundings", {"cases": rows, "table": counted})
    print(markdown(counted))


if __name__ == "__main__":
    main()
