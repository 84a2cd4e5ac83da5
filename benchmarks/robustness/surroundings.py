"""Every verb in odd surroundings: it does its work, or says in a sentence why not and leaves nothing behind.

    python -m benchmarks.robustness.surroundings [--verbs init,simulate,...] [--cases "full disk",...]
writes results/surroundings.json. ``full disk`` and ``read-only folder`` are file systems of 1 MB in memory, which only the
administrator can mount; elsewhere they are left out. A cell is good if the exit code is that of the verb in plain
surroundings and the same files are there; or if it is 2, or 5 where work is kept, with one line that begins with
"error:" and no file left. There must be no traceback, and no wait beyond 120 s.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.common import markdown, save
from benchmarks.robustness.running import EXAMPLE, IMPACT, STUDY, ended, files, last_line, start

_HANG_S = 120.0
PLAIN = "plain"


class Case(NamedTuple):
    """Surroundings: variables, umask, a file system for the results, and what else is odd."""

    variables: dict[str, str | None] = {}
    umask: int = -1
    disk: str = ""
    name: str = "impact.toml"
    reader: bool = True


CASES = {
    PLAIN: Case(),
    "full disk": Case(disk="full"),
    "disk of 1 MB": Case(disk="small"),
    "read-only folder": Case(disk="read-only"),
    "below a file": Case(disk="below a file"),
    "read-only home": Case({"HOME": "/proc", "BCFJ_CACHE": None, "XDG_CACHE_HOME": None}),
    "no home": Case({"HOME": None, "BCFJ_CACHE": None, "XDG_CACHE_HOME": None}),
    "umask 000": Case(umask=0o000),
    "umask 777": Case(umask=0o777),
    "MPLBACKEND of Jupyter": Case({"MPLBACKEND": "module://matplotlib_inline.backend_inline"}),
    "JAX_PLATFORMS=foo": Case({"JAX_PLATFORMS": "foo"}),
    "JAX_DISABLE_JIT=1": Case({"JAX_DISABLE_JIT": "1"}),
    "JAX_ENABLE_X64=0": Case({"JAX_ENABLE_X64": "0"}),
    "JAX_DEBUG_NANS=maybe": Case({"JAX_DEBUG_NANS": "maybe"}),
    "EQX_ON_ERROR=breakpoint": Case({"EQX_ON_ERROR": "breakpoint"}),
    "XLA_FLAGS=--xla_foo": Case({"XLA_FLAGS": "--xla_foo"}),
    "no TERM; LC_ALL=C; name not ASCII": Case({"TERM": None, "LC_ALL": "C", "LANG": None}, name="schräg µ.toml"),
    "name of no characters": Case(name=os.fsdecode(b"odd\xff\xe4.toml")),
    "nobody reads the output": Case(reader=False),
}


def verbs(scene: str, out: str) -> dict[str, list[str]]:
    to = ["--out", out]
    return {
        "init": ["init", "impact", *to],
        "validate": ["validate", scene],
        "simulate": ["simulate", scene, *to],
        "sensitivity": ["sensitivity", scene, "--wrt", "stiffness", "--budget", "1", *to],
        "tradeoff": ["tradeoff", scene, "--only", "tsit5", "--no-derivatives", *to],
        "design": ["design", scene, "--minimize", "contact.peak", "--vary", "damping=0.1:1", "--starts", "2", *to],
        "calibrate": ["calibrate", str(EXAMPLE), "--starts", "4", *to],
        "study": ["study", "run", "study.toml", "--workers", "1", *to],
        "reproduce": ["reproduce", *to],
    }


@contextlib.contextmanager
def disk(kind: str, place: Path) -> Iterator[Path]:
    """A folder for results on a file system of 1 MB, full or read-only; or below a file."""
    if kind == "below a file":
        (place / "file").write_text("")
        yield place / "file" / "out"
        return
    mounted = place / "disk"
    mounted.mkdir()
    if not kind:
        yield mounted / "out"
        return
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(mounted)], check=True)
    try:
        if kind == "full":
            with contextlib.suppress(OSError), (mounted / "filler").open("wb", buffering=0) as file:
                while file.write(b"x" * 4096):
                    pass
        if kind == "read-only":
            subprocess.run(["mount", "-o", "remount,ro", str(mounted)], check=True)
        yield mounted / "out"
    finally:
        subprocess.run(["umount", str(mounted)], check=True)


def tried(verb: str, case: Case, plain: dict[str, Any] | None) -> dict[str, Any]:
    """One verb in one case."""
    with tempfile.TemporaryDirectory() as name, disk(case.disk, Path(name)) as out:
        place = Path(name)
        (place / case.name).write_text(IMPACT)
        (place / "study.toml").write_text(STUDY.format(steps=3))
        words = verbs(case.name, str(out))[verb]
        before = sorted(p.name for p in place.iterdir())
        if case.reader:
            code, _, err = ended(start(words, place, case.variables, case.umask), _HANG_S)
        else:
            readable, writable = os.pipe()
            os.close(readable)
            job = start(words, place, case.variables, case.umask, writable)
            os.close(writable)
            code, _, err = ended(job, _HANG_S)
        left = files(out) if case.disk != "below a file" else []
        strays = sorted(set(p.name for p in place.iterdir()) - set(before))
    said = last_line(err.replace(f"{place}/", ""))
    row = {"code": code, "files": len(left), "strays": strays, "said": said if code else ""}
    refused = code in (2, 5) and said.startswith("error:") and (not left or code == 5)
    worked = plain is None or (code == plain["code"] and len(left) == plain["files"])
    row["good"] = "Traceback" not in err and not strays and (worked or refused)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--verbs", default=",".join(verbs("", "")))
    parser.add_argument("--cases", default=",".join(CASES))
    given = parser.parse_args()
    names, cases = given.verbs.split(","), [PLAIN, *(c for c in CASES if c in given.cases.split(",") and c != PLAIN)]
    rows: dict[str, dict[str, Any]] = {}
    table = [["", *(f"`{name}`" for name in names)]]
    for title in cases:
        rows[title] = {}
        for verb in names:
            try:
                rows[title][verb] = tried(verb, CASES[title], rows[PLAIN].get(verb) if title != PLAIN else None)
            except (subprocess.CalledProcessError, FileNotFoundError):
                rows[title][verb] = {"code": None, "good": None, "said": "needs an administrator"}
            print(title, verb, rows[title][verb], flush=True)
        cells = [rows[title][verb] for verb in names]
        table.append(
            [title, *(f"{c['code']}{'' if c['good'] else ' NOT GOOD' if c['good'] is False else ''}" for c in cells)]
        )
        save("surroundings", {"cases": rows})
    print(markdown(table))


if __name__ == "__main__":
    main()
