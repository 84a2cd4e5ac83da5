"""Folders of results: reserved for one process, tried before anything is computed, and left as found where a run fails.

A command opens its folder by ``open_folder`` within a ``session``. The folder is made, locked by the file ``.bcfj-run``
in it, and written to before the run, so that a full disk or a read-only one is found first. The lock is the system's
and ends with its process. The file names what the run will write: where it is found unlocked, that run was killed, or
interrupted after a stage (``stays``), and what it left is no whole result: the next run replaces it.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import itertools
import json
import os
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from bcfj_jax.core.errors import InputError
from bcfj_jax.io import stop

try:
    import fcntl
except ImportError:  # Windows: folders are not locked there.
    fcntl = None

LOCK = ".bcfj-run"
# Free space below which no run is begun [bytes]: tables, pictures and the report of a small one.
LEAST_FREE = 1_000_000
# How long to wait for a folder that another process has [s].
WAIT_S = 1.0
# Of a lock file that is read [bytes].
_MOST = 100_000
_REMEDIES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "free some space, or name another folder"),
    **dict.fromkeys((errno.EACCES, errno.EPERM), "name a folder that you may write"),
    errno.EROFS: "name a folder that can be written",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ENOTDIR: "name a folder that is not below a file",
    errno.ELOOP: "name a folder",
}


class Claim(NamedTuple):
    """What a command will do to its folder."""

    verb: str  # of the command
    names: Sequence[str]  # of the files to come
    goes_on: str = ""  # name of the file that keeps finished work; a folder that holds it is gone on with
    size: int = LEAST_FREE  # free space that the results need [bytes]
    wait_s: float = WAIT_S  # how long to wait for a folder that another process has [s]


@dataclass
class _Reserved:
    """A folder of this process: files that it may write, folders that were made for it, and the ``stage`` that stays."""

    folder: Path
    names: tuple[str, ...]
    goes_on: str
    made: list[Path]
    handle: int
    stage: str = ""

    @property
    def kept(self) -> bool:
        return bool(self.goes_on) and (self.folder / self.goes_on).exists()

    def release(self, good: bool, interrupted: bool = False) -> None:
        """Give the folder back; of a run that failed and keeps nothing, take away what was written."""
        stays = interrupted and self.stage and not self.kept
        with contextlib.suppress(OSError):
            for name in self.names:
                for path in self.folder.glob(f".{glob.escape(name)}.*"):
                    path.unlink(missing_ok=True)
                if not (good or self.kept or stays):
                    (self.folder / name).unlink(missing_ok=True)
            if not stays:
                (self.folder / LOCK).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            os.close(self.handle)
        if not self.kept:
            _remove_empty(self.made)


@dataclass
class Session:
    """Folders ``reserved`` for this process, those ``kept`` with finished work, and ``stages`` that an interruption leaves."""

    kept: list[Path] = field(default_factory=list)
    stages: list[str] = field(default_factory=list)
    reserved: list[_Reserved] = field(default_factory=list)


_sessions: list[Session] = []


@contextlib.contextmanager
def session() -> Iterator[Session]:
    """Within, folders that are opened belong to this process; an error takes back what was written and is not kept."""
    mine, good, interrupted = Session(), False, False
    _sessions.append(mine)
    try:
        yield mine
        good = True
    except KeyboardInterrupt:
        interrupted = True
        raise
    finally:
        _sessions.remove(mine)
        mine.kept += [one.folder for one in mine.reserved if one.kept]
        mine.stages += [f"{one.folder} (stage: {one.stage})" for one in mine.reserved if one.stage]
        for outer in _sessions[-1:]:
            outer.kept += mine.kept
            outer.stages += mine.stages
        for one in reversed(mine.reserved):
            one.release(good, interrupted)


def stays(folder: Path, stage: str) -> None:
    """An interruption from now on leaves what is written in a folder of this process, a result that has come so far."""
    for one in (one for mine in _sessions for one in mine.reserved if one.folder == folder):
        one.stage = stage


def open_folder(out: Path | None, stem: str, claim: Claim) -> Path:
    """The folder for a command's results. Within a ``session`` it is made, locked and tried here.

    ``out`` is what the user asked for; None: ``results/<verb>-<stem>``, numbered where that exists. Refused are a folder that
    holds one of the files already, is none, cannot be written, has no space, or in which another process writes.
    """
    stop.check()
    default = Path("results") / f"{claim.verb}-{stem}"
    try:
        if not _sessions:
            if out is not None:
                _refuse_what_is_there(out, claim)
            return out or next(folder for folder in _numbered(default) if not folder.exists())
        folder, made = (out, _make(out)) if out is not None else _fresh(default)
        try:
            _sessions[-1].reserved.append(_reserve(folder, made, claim if out else claim._replace(wait_s=0.0)))
        except BaseException:
            _remove_empty(made)
            raise
    except InputError:
        raise
    except (OSError, ValueError) as error:
        where = "the folder results" if out is None else f"--out {str(out)[:200]}"
        raise unwritable(where, error) from None
    return folder


def check_folder(out: Path, will_write: Sequence[str] = ()) -> None:
    """Refuse what ``open_folder`` would refuse of a folder before it is made."""
    stop.check()
    try:
        _refuse_what_is_there(out, Claim("", will_write))
    except OSError as error:
        raise unwritable(f"--out {str(out)[:200]}", error) from None


def unwritable(where: str, error: Exception) -> InputError:
    """What cannot be written, and what to do, from the system's error."""
    code, said = (error.errno, error.strerror) if isinstance(error, OSError) else (None, None)
    return InputError(where, f"cannot be written ({said or error})", _REMEDIES.get(code or 0, "name another folder"))


def already_there(folder: Path, names: Sequence[str]) -> InputError:
    """Files that are in the way."""
    remedy = "name another folder, or remove them: nothing is overwritten"
    return InputError(f"--out {folder}", f"already holds {', '.join(names)}", remedy)


def _numbered(folder: Path) -> Iterator[Path]:
    yield folder
    yield from (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2))


def _fresh(default: Path) -> tuple[Path, list[Path]]:
    """A folder that did not exist, and those that were made: of two processes that ask at once, each gets its own."""
    made, names = _make(default.parent), _numbered(default)
    folder = next(names)
    while True:
        try:
            folder.mkdir()
            return folder, [*made, folder]
        except FileExistsError:
            folder = next(names)
        except FileNotFoundError:  # Another process that gave up has taken the empty folder results away.
            made = _make(default.parent)


def _make(folder: Path) -> list[Path]:
    """Make a folder; those that were made, the outermost first."""
    missing = []
    for path in (folder, *folder.parents):
        if path.exists():
            break
        missing.insert(0, path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise InputError(f"--out {folder}", "this is not a folder", "name a folder") from None
    except BaseException:
        _remove_empty(missing)
        raise
    return missing


def _remove_empty(folders: Sequence[Path]) -> None:
    with contextlib.suppress(OSError):
        for folder in reversed(folders):
            folder.rmdir()


def _reserve(folder: Path, made: list[Path], asked: Claim) -> _Reserved:
    until, names = time.monotonic() + asked.wait_s, tuple(asked.names)
    while (handle := _locked(folder, made)) is None:
        if time.monotonic() >= until:
            found = f"another process writes there ({_said(folder / LOCK).get('verb', 'bcfj')})"
            raise InputError(f"--out {folder}", found, "name another folder, or wait for it")
        time.sleep(0.02)
    reserved = _Reserved(folder, names, asked.goes_on, made, handle)
    try:
        # Of a run that was killed: what it names and this one writes as well is half a result.
        killed = _said(folder / LOCK).get("files", [])
        if not reserved.kept:
            for name in set(names).intersection(x for x in killed if isinstance(x, str)):
                (folder / name).unlink(missing_ok=True)
        _refuse_what_is_there(folder, asked)
        free = shutil.disk_usage(folder).free
        if free < asked.size:
            found = f"{free / 1e6:.3g} MB are free, and the results need about {asked.size / 1e6:.3g} MB"
            raise InputError(f"--out {folder}", found, _REMEDIES[errno.ENOSPC])
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps({"verb": f"bcfj {asked.verb}", "files": names}).encode(), 0)
    except BaseException:
        reserved.names = ()
        reserved.release(False)
        raise
    return reserved


def _locked(folder: Path, made: list[Path]) -> int | None:
    """The lock file of a folder, held; None where another process holds it."""
    path = folder / LOCK
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except FileNotFoundError:  # Another process gave up, and took the empty folder away.
        made[:] = [*made, *(x for x in _make(folder) if x not in made)]
        return None
    try:
        if fcntl is not None:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                return None
            except OSError as error:
                # A file system without locks.
                if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL):
                    raise
        # Its holder may have removed it between the two calls; then it locks nothing.
        with contextlib.suppress(FileNotFoundError):
            if os.stat(path).st_ino == os.fstat(handle).st_ino:
                return handle
    except BaseException:
        os.close(handle)
        raise
    os.close(handle)
    return None


def _said(path: Path) -> dict:
    try:
        with path.open("rb") as file:
            found = json.loads(file.read(_MOST))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) and isinstance(found.get("files", []), list) else {}


def _refuse_what_is_there(folder: Path, asked: Claim) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--out {folder}", "this is not a folder", "name a folder")
    if asked.goes_on and (folder / asked.goes_on).exists():
        return
    if there := [name for name in asked.names if (folder / name).exists()]:
        raise already_there(folder, there)


def inside(folder: Path, name: str, where: str) -> Path:
    """The path of a file in a folder by a name (parts separated by "/") that came from a worker, a file, a record."""
    parts = name.split("/")
    bad = [x for x in parts if x in ("", ".", "..") or len(os.fsencode(x)) > 255]
    if bad or any(x in "\\:" or not x.isprintable() for x in name):
        raise InputError(where, f"the name {name[:200]!r} may leave its folder", "give a plain name")
    return folder.joinpath(*parts)
