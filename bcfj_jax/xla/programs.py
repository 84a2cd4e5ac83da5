"""Compiled programs: made once a process, and kept between processes as exported StableHLO (``jax.export``).

A program is a pure function of static structure and arrays. ``program`` traces and compiles it on first use. Where a
folder is set (``xla.compile_cache``), the traced program is written there, and the next process reads it instead of
tracing; XLA's own cache then has the machine code. A kept program is found by a digest of all that it depends on: name,
structure, shapes, the package's sources, versions, XLA's options. Its file holds the digest of its content, and a file
that does not match is made anew. Nothing is pickled. What holds a user's own code is not kept: its text alone does not
say what it does.

XLA takes some 120 to 350 memory maps for each program, of which Linux gives a process 65 530, and dies where there are
none left. ``make_room`` drops the oldest programs before.
"""

from __future__ import annotations

import contextlib
import contextvars
import dataclasses
import enum
import functools
import gc
import hashlib
import importlib
import importlib.metadata
import json
import logging
import math
import os
import tempfile
import threading
import time
import types
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.export
import jax.monitoring
import numpy as np

from bcfj_jax.core.progress import stage
from bcfj_jax.xla import host
from bcfj_jax.xla.threads import ahead, cores

_LOG = logging.getLogger("bcfj_jax.programs")
_ROOT = Path(__file__).resolve().parent.parent
_OURS = ("bcfj_jax", "calibration")
# Whose classes and functions are known by name and version.
_KNOWN = (*_OURS, "jax", "jaxlib", "diffrax", "equinox", "lineax", "optimistix", "numpy", "builtins", "functools")
_VERSIONS = ("jax", "jaxlib", "diffrax", "equinox", "lineax", "optimistix", "numpy")
_SUFFIX = ".stablehlo"
# Where compile times are kept, and from which on [s].
_SECONDS, _LONG = "seconds.json", 1.0
# Those of built-in scenes, measured (benchmarks/solve/compile_seconds.py): seconds of one core.
_MEASURED = Path(__file__).with_name("compile_seconds.json")
_MAGIC = b"bcfj-jax program 1\n"
# Options for a program that runs once: to compile quickly matters more than to run quickly.
QUICK = {"xla_backend_optimization_level": 0}


class Settings:
    """Where programs are kept: None for nowhere. ``limit`` is the folder's size [bytes]; the oldest go first."""

    folder: Path | None = None
    limit: int = 512 << 20


# Names of the programs that this process traced, and of those that it read from the folder, in order.
traced: list[str] = []
fetched: list[str] = []
_loaded: dict[Any, Callable[..., Any]] = {}
_locks: dict[Any, threading.Lock] = {}
# What NumPy has answered: the program, its trace, how often.
_asked: dict[Any, list[Any]] = {}
# What begins once XLA works (``beside``).
_beside: list[Callable[[], object]] = []
# So many times NumPy answers a question.
_BY_HAND = 3
_told: set[str] = set()
_remembering = threading.Lock()
# Python traces one program at a time: side by side, each would begin to compile only when all are traced.
_tracing = threading.RLock()
_within: contextvars.ContextVar[bool] = contextvars.ContextVar("whether this thread is tracing", default=False)
_only_made: contextvars.ContextVar[bool] = contextvars.ContextVar(
    "whether programs are made and not run", default=False
)
# Share of Linux's limit of memory maps that programs may take, and after how many compilations that is looked at again.
_SHARE, _EVERY = 0.5, 16
_MAPS, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
_compilations = {"now": 0, "looked": 0}


class Unkept(Exception):
    """Static structure of which no text says what it does, such as a user's function."""


def program(
    name: str,
    function: Callable[..., Any],
    static: tuple[Any, ...],
    arguments: tuple[Any, ...],
    options: Mapping[str, Any] | None = None,
) -> tuple[Callable[..., Any], float]:
    """A compiled program for arguments like these, and the seconds [s] that getting it took now.

    Args:
        name: of the program; one name stands for one function.
        function: ``function(*static, *arguments)``, pure; a module's own function, or one made from nothing but
            what ``static`` says.
        static: hashable structure: models, names, numbers, None.
        arguments: pytrees of arrays and numbers; only their shapes matter here.
        options: of XLA's compiler; one name stands for one set of options, too.

    Returns:
        A function of arguments of the same shapes; it gives the result as NumPy arrays.

    Within ``jax.disable_jit()`` it is compiled all the same: that is for the user's own functions.
    """
    begin = time.perf_counter()
    make_room()
    wanted = _wanted(name, function, static, arguments)._replace(options=dict(options or {}))
    with _making(wanted), jax.disable_jit(False):
        found = _loaded.get(wanted.key) or _fetched(wanted) or _made(wanted)
        _loaded[wanted.key] = found
    if _only_made.get():
        raise Made(name)
    return found, time.perf_counter() - begin


def ask(name: str, function: Callable[..., Any], static: tuple[Any, ...], arguments: tuple[Any, ...]) -> Any:
    """What a small program gives, for a question that is asked once before a run, such as whether it can start.

    A kept program answers. Without one the function is traced, and NumPy answers the first times (``xla.host``), so
    that a run that is refused compiles nothing; who asks more often, as a study does, gets a compiled program. What was
    answered so is compiled and kept by ``keep_asked``. Arguments as ``program``'s.
    """
    make_room()
    wanted = _wanted(name, function, static, arguments)
    if (known := _loaded.get(wanted.key)) is not None:
        return known(*arguments)
    with _making(wanted), jax.disable_jit(False):
        return _answered(wanted, arguments)


def _answered(wanted: _Wanted, arguments: tuple[Any, ...]) -> Any:
    if (found := _loaded.get(wanted.key) or _fetched(wanted)) is not None:
        _loaded[wanted.key] = found
        return found(*arguments)
    if wanted.key not in _asked:
        _asked[wanted.key] = [wanted, _traced(wanted), 0]
    entry = _asked[wanted.key]
    _, (jitted, known), count = entry
    entry[2] = count + 1
    if count < _BY_HAND:
        with contextlib.suppress(host.Unknown):
            leaves = [np.asarray(x, s.dtype) for x, s in zip(jax.tree.leaves(arguments), wanted.shapes, strict=True)]
            found = host.evaluate(known.jaxpr, leaves)
            return jax.tree.unflatten(jax.tree.structure(known.out_info), found)
    _asked.pop(wanted.key, None)
    _loaded[wanted.key] = found = _made(wanted, jitted)
    return found(*arguments)


def keep_asked() -> None:
    """Compile and keep what NumPy has answered in this process, so that the next one traces nothing."""
    if Settings.folder is not None:
        for key, (wanted, (jitted, _), _) in list(_asked.items()):
            _loaded[key] = _made(wanted, jitted)
    _asked.clear()


class Made(Exception):
    """A program is made, and is not run (``make``)."""


def make(use: Callable[[], object]) -> None:
    """Make the program that a function asks for first, and go no further. What it raises is raised where it is needed."""
    token = _only_made.set(True)
    try:
        with contextlib.suppress(Exception):
            use()
    finally:
        _only_made.reset(token)


def beside(task: Callable[[], object]) -> None:
    """Begin what will be needed later, such as other programs, once XLA has the next one: then Python is free."""
    if cores() > 1:
        # Of a command that was refused before one may be left.
        _beside[:] = [task]


def _compiled_one(event: str, *_: Any, **__: Any) -> None:
    if event.endswith("backend_compile_duration"):
        _compilations["now"] += 1


jax.monitoring.register_event_duration_secs_listener(_compiled_one)


def make_room() -> None:
    """Drop the oldest half of this process's programs, and what JAX keeps itself, where memory maps become few.

    Also those of the user's own jitted functions: they compile again when they are next called. Elsewhere than on Linux
    nothing is dropped.
    """
    if _compilations["now"] - _compilations["looked"] < _EVERY:
        return
    _compilations["looked"] = _compilations["now"]
    try:
        most = int(_MOST.read_text())
        with _MAPS.open("rb") as file:
            taken = sum(1 for _ in file)
    except (OSError, ValueError):
        return
    if taken > _SHARE * most:
        for key in list(_loaded)[: (len(_loaded) + 1) // 2]:
            _loaded.pop(key, None)
        _asked.clear()
        jax.clear_caches()
        gc.collect()


def forget() -> None:
    """Forget the programs of this process; kept files stay."""
    _loaded.clear()
    _asked.clear()


class _Wanted(NamedTuple):
    """A program that is asked for: what it is made of, and its key in this process."""

    name: str
    function: Callable[..., Any]
    static: tuple[Any, ...]
    tree: Any
    shapes: tuple[jax.ShapeDtypeStruct, ...]
    options: Mapping[str, Any] = types.MappingProxyType({})

    @property
    def key(self) -> tuple[Any, ...]:
        return self.name, self.static, self.tree, tuple((s.shape, s.dtype) for s in self.shapes)


def _wanted(name: str, function: Callable[..., Any], static: tuple[Any, ...], arguments: tuple[Any, ...]) -> _Wanted:
    leaves, tree = jax.tree.flatten(arguments)
    shapes = tuple(jax.ShapeDtypeStruct(np.shape(x), _dtype(x)) for x in leaves)
    return _Wanted(name, function, static, tree, shapes)


def _making(wanted: _Wanted) -> contextlib.AbstractContextManager[Any]:
    """Wait for another thread that makes the program; not within a trace, for whose end that thread may wait."""
    return contextlib.nullcontext() if _within.get() else _locks.setdefault(wanted.key, threading.Lock())


def _dtype(x: Any) -> np.dtype:
    return np.dtype(np.float64) if isinstance(x, float) else np.asarray(x).dtype if np.isscalar(x) else x.dtype


def _traced(wanted: _Wanted) -> tuple[Any, Any]:
    """The function of flat arguments, to be compiled, and its trace. The user's mistakes raise here."""

    def flat(*leaves: Any) -> Any:
        return wanted.function(*wanted.static, *jax.tree.unflatten(wanted.tree, leaves))

    jitted = jax.jit(flat)
    known = jitted.trace(*wanted.shapes)
    traced.append(wanted.name)
    return jitted, known


def _fetched(wanted: _Wanted) -> Callable[..., Any] | None:
    """A kept program, compiled; None where there is none."""
    path = _path(wanted)
    found = _read(path) if path else None
    if found is None:
        return None
    fetched.append(wanted.name)
    return _compiled(_lowered(found.call, wanted), wanted)


def _made(wanted: _Wanted, jitted: Any = None) -> Callable[..., Any]:
    """A program traced, kept and compiled."""
    path, begin = _path(wanted), time.perf_counter()
    model = f"{wanted.name} {_kind(wanted)}"
    with stage(f"compiling '{wanted.name}'", hint=_estimate(wanted.name, model)):
        with _tracing:
            token = _within.set(True)
            try:
                jitted = jitted or _traced(wanted)[0]
                lowered = _lowered((_export(path, jitted, wanted.shapes) if path else None) or jitted, wanted)
            finally:
                _within.reset(token)
        made = _compiled(lowered, wanted)
    remember(model, time.perf_counter() - begin)
    return made


def _lowered(call: Callable[..., Any], wanted: _Wanted) -> Any:
    return jax.jit(call).lower(*wanted.shapes)


def _compiled(lowered: Any, wanted: _Wanted) -> Callable[..., Any]:
    while _beside:
        ahead(_beside.pop())
    try:
        compiled = lowered.compile(compiler_options=dict(wanted.options))
    except jax.errors.JaxRuntimeError as error:
        # Options make a program quicker, no more; another jaxlib may not have them.
        if "No such compile option" not in str(error):
            raise
        compiled = lowered.compile()

    def run(*arguments: Any) -> Any:
        leaves = zip(jax.tree.leaves(arguments), wanted.shapes, strict=True)
        with stage(f"running '{wanted.name}'"), jax.disable_jit(False):
            return jax.device_get(compiled(*(np.asarray(x, s.dtype) if np.isscalar(x) else x for x, s in leaves)))

    return run


# How long programs took to compile, by name and kind of model; sources and values may have changed since.


def _kind(wanted: _Wanted) -> str:
    """Kind of the model that a program is of ("joint"); else the name of what it is of."""
    first = wanted.static[0] if wanted.static else None
    scene = getattr(first, "scene", first)
    return getattr(scene, "kind", "" if scene is None else type(scene).__name__)


def _estimate(name: str, model: str) -> str:
    """How long compiling will take: as the last time here; else as measured elsewhere; "" where nobody knows."""
    if known := seconds(model):
        return f": {known:.0f} s the last time"
    kept = "; kept for the next run" if Settings.folder else ""
    measured = _numbers(_MEASURED)
    alike = [measured[model]] if model in measured else [t for m, t in measured.items() if m.rpartition(" ")[0] == name]
    # One other model says nothing of this one.
    if len(alike) < (1 if model in measured else 2) or max(alike) < _LONG:
        return ""
    span = " to ".join(dict.fromkeys(f"{max(t, 1.0):.0f}" for t in (min(alike), max(alike))))
    return f" for the first time here: {span} s of one core where it was measured{kept}"


def _numbers(path: Path) -> dict[str, float]:
    """Seconds by name [s] of a file; none of a file that is damaged."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        found = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(found, dict):
            return {name: took for name, took in found.items() if isinstance(took, float) and 0.0 < took < math.inf}
    return {}


def seconds(name: str) -> float | None:
    """How long something took the last time [s], where that was long enough to be kept; else None."""
    return _numbers(Settings.folder / _SECONDS).get(name) if Settings.folder else None


def remember(name: str, took: float) -> None:
    """Keep how long something took [s]: the compilation of a program, or a whole command."""
    if Settings.folder is not None and took > _LONG:
        with contextlib.suppress(OSError), _remembering:
            path = Settings.folder / _SECONDS
            _write(path, json.dumps({**_numbers(path), name: round(took, 1)}).encode())


# Files.


def _path(wanted: _Wanted) -> Path | None:
    """The file of a program; None where none is kept."""
    if Settings.folder is None:
        return None
    shapes = repr([(s.shape, str(s.dtype)) for s in wanted.shapes])
    try:
        parts = [wanted.name, describe(wanted.static), _text(wanted.tree), shapes, _surroundings()]
    except Unkept:
        return None
    return Settings.folder / f"{hashlib.sha256(json.dumps(parts).encode()).hexdigest()}{_SUFFIX}"


def _read(path: Path) -> Any:
    """The program of a file; None where there is none, or none that is whole and of that name."""
    try:
        content = path.read_bytes()
        head, _, payload = content.removeprefix(_MAGIC).partition(b"\n")
        known = json.loads(head)
        whole = known["digest"] == hashlib.sha256(payload).hexdigest() and known["program"] == path.stem
        if not (content.startswith(_MAGIC) and whole):
            return None
        for outcome in known["outcomes"]:
            _register(outcome)
        found = jax.export.deserialize(bytearray(payload))
        os.utime(path)
    except FileNotFoundError:
        return None
    except Exception:  # Whatever a damaged or foreign file does, the program is made anew.
        return None
    return found


def _export(path: Path, jitted: Any, shapes: tuple[Any, ...]) -> Callable[..., Any] | None:
    """Write a program; what calls it, or None where it cannot be exported (it calls back to the host)."""
    try:
        outcomes = sorted(set(_outcomes(jax.eval_shape(jitted, *shapes))))
        for outcome in outcomes:
            _register(outcome)
        exported = jax.export.export(jitted)(*shapes)
        payload = bytes(exported.serialize())
    except Exception:  # An operation that is not exported, or an outcome that has no name: the program still runs.
        return None
    head = {"program": path.stem, "digest": hashlib.sha256(payload).hexdigest(), "outcomes": outcomes}
    try:
        _write(path, _MAGIC + json.dumps(head).encode() + b"\n" + payload)
        prune(path.parent, Settings.limit)
    except OSError as error:
        say_once(f"compiled programs cannot be kept in {path.parent}: {error.strerror or error}; runs stay right")
    return exported.call


def _write(path: Path, content: bytes) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def prune(folder: Path, limit: int) -> None:
    """Delete the files of a folder that were used longest ago until the others fit into so many bytes."""
    known = []
    for entry in os.scandir(folder):
        # Another process may delete it meanwhile.
        try:
            about = entry.stat()
        except FileNotFoundError:
            continue
        known.append((about.st_mtime, about.st_size, entry.path))
    total = sum(size for _, size, _ in known)
    for _, size, path in sorted(known):
        if total <= limit:
            return
        Path(path).unlink(missing_ok=True)
        total -= size


def say_once(text: str) -> None:
    """Log a warning, the first time in this process."""
    if text not in _told:
        _told.add(text)
        _LOG.warning("%s", text)


def _outcomes(tree: Any) -> Iterable[str]:
    """Names of the named tuples in a result, all of them our own classes."""
    if isinstance(tree, tuple) and hasattr(tree, "_fields"):
        yield f"{type(tree).__module__}:{type(tree).__qualname__}"
    if isinstance(tree, Mapping):
        tree = tuple(tree.values())
    for part in tree if isinstance(tree, (tuple, list)) else ():
        yield from _outcomes(part)


@functools.cache
def _register(outcome: str) -> None:
    module, _, name = outcome.partition(":")
    if module.partition(".")[0] not in _OURS:
        raise Unkept(outcome)
    jax.export.register_namedtuple_serialization(
        getattr(importlib.import_module(module), name), serialized_name=outcome
    )


# What a program depends on, as text.


def describe(x: Any) -> str:
    """Static structure as text: equal texts mean equal programs."""
    if x is None or isinstance(x, (bool, int, str, bytes)):
        return f"{type(x).__name__}:{x!r}"
    if isinstance(x, (float, np.generic)):
        return f"{type(x).__name__}:{float(x).hex()}"
    if isinstance(x, enum.Enum):
        return f"{_name(type(x))}.{x.name}"
    if isinstance(x, np.ndarray):
        return f"array:{x.dtype}:{x.shape}:{hashlib.sha256(np.ascontiguousarray(x).tobytes()).hexdigest()}"
    if isinstance(x, (tuple, list)):
        return f"{_name(type(x))}({','.join(map(describe, x))})"
    if isinstance(x, (set, frozenset)):
        return f"{_name(type(x))}({','.join(sorted(map(describe, x)))})"
    if isinstance(x, Mapping):
        return f"{_name(type(x))}({','.join(f'{describe(k)}={describe(v)}' for k, v in x.items())})"
    if isinstance(x, type):
        return _name(x)
    if isinstance(x, functools.partial):
        return f"partial({describe(x.func)},{describe(x.args)},{describe(x.keywords)})"
    if isinstance(x, types.MethodType):
        return f"method({describe(x.__self__)},{x.__func__.__qualname__})"
    if isinstance(x, types.FunctionType):
        cells = [cell.cell_contents for cell in x.__closure__ or ()]
        return f"{_name(x)}:{x.__code__.co_firstlineno}({describe(x.__defaults__)},{describe(cells)})"
    if dataclasses.is_dataclass(x):
        fields = (f"{f.name}={describe(getattr(x, f.name))}" for f in dataclasses.fields(x) if hasattr(x, f.name))
        return f"{_name(type(x))}({','.join(fields)})"
    if callable(x) and not hasattr(x, "__closure__") and getattr(x, "__module__", None) and hasattr(x, "__qualname__"):
        return _name(x)
    raise Unkept(repr(x))


def _name(x: Any) -> str:
    module = x.__module__ or ""
    if module.partition(".")[0] not in _KNOWN:
        raise Unkept(f"{module}.{x.__qualname__}")
    return f"{module}.{x.__qualname__}"


def _text(tree: Any) -> str:
    text = str(tree)
    if " at 0x" in text:
        raise Unkept(text)
    return text


@functools.cache
def _surroundings() -> str:
    """Sources of the package, versions, device and the options that JAX and XLA compile with."""
    digest = hashlib.sha256()
    for package in _OURS:
        for path in sorted((_ROOT.parent / package).rglob("*.py")):
            digest.update(path.relative_to(_ROOT.parent).as_posix().encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    versions = {name: importlib.metadata.version(name) for name in _VERSIONS}
    options = [os.environ.get(name, "") for name in ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64")]
    return json.dumps([digest.hexdigest(), versions, options, jax.default_backend(), jax.config.jax_enable_x64])  # pyright: ignore[reportAttributeAccessIssue]
