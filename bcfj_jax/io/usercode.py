"""Python of the user's own: a file that is executed once, and what it defines as names for scene files.

    bcfj simulate my.toml --code my_file.py         bj.use_code("my_file.py")

A scene file alone never runs code: a file runs only where the command line, or a script, names it. What it defines then
stands beside the built-in names:

    a subclass of AbstractLaw, AbstractElastic, AbstractFriction or AbstractGap, or an object of one      law, elastic, ...
    a function that can be called without positional arguments, and returns a model         [scene] kind, with its options
    a class with sniff(path, head) and read(path), which returns columns by header                    a reader of measured files
    any other function                                           [[load]] kind: (t, bodies, p); drive kind: (t, p)

Names that begin with "_", and names that are imported, stay with the file. ``sys.path`` is not changed, so the file cannot
import its neighbours: what a result depends on is the one file, whose SHA-256 is kept with the result.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import equinox as eqx

from bcfj_jax.contact import gaps, laws
from bcfj_jax.contact.elastic import AbstractElastic
from bcfj_jax.contact.friction import AbstractFriction
from bcfj_jax.contact.gaps import AbstractGap
from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.core.errors import InputError, origin
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.io import opening
from bcfj_jax.models import scenes

# The kind of scene whose parts a file lists; no function may have its name.
MECHANISM = "mechanism"
# What a class is a name of, and where names of its kind are kept.
_KINDS: tuple[tuple[type, str, MutableMapping[str, Any]], ...] = (
    (AbstractLaw, "law", laws.LAWS),
    (AbstractElastic, "elastic part", laws.ELASTIC),
    (AbstractFriction, "friction law", laws.FRICTION),
    (AbstractGap, "gap", gaps.GAPS),
)


@dataclass(frozen=True)
class Code:
    """A file that was executed."""

    path: Path  # as it was named, absolute
    sha256: str  # of its content
    text: bytes  # its content, for workers on other machines
    module: ModuleType  # what it defined
    names: tuple[tuple[MutableMapping[str, Any], str], ...]  # (registry, name) of what scene files can name now


_used: dict[Path, Code] = {}
_functions: dict[str, Callable[..., Any]] = {}


def use_code(path: str | Path, sha256: str = "") -> ModuleType:
    """Execute a Python file, once, and let scene files use what it defines (module docstring); the file as a module.

    Named again, it is executed again only where its content is another. ``sha256``: what its content must be, if known.

    Raises:
        InputError: for a file that cannot be read, has another content, or raises; for a class that is not complete, and a
            name that is taken.
    """
    path = Path(path)
    where, remedy = f"--code {path}", "name a Python file"
    text = opening.content(path, opening.LARGEST_TOML, where, remedy, remedy)
    return _use(path.resolve(), text, str(path), sha256)


def use_only(files: Iterable[tuple[str, bytes]]) -> None:
    """Have these files in use and no other: names and contents of files that may be on another machine."""
    files = tuple(files)
    for code in used():
        # Of an earlier job of this process, in which a name may have meant something else.
        if (str(code.path), code.text) not in files:
            _withdraw(code)
    for name, text in files:
        _use(Path(name), text, name, "")


def used() -> tuple[Code, ...]:
    """The files in use, in the order in which they were named."""
    return tuple(_used.values())


def record() -> list[dict[str, str]]:
    """Path and SHA-256 of each file in use, as results keep them."""
    return [{"path": str(code.path), "sha256": code.sha256} for code in used()]


def arguments() -> list[str]:
    """What makes another process use the same files: ``from_arguments`` there."""
    return [part for code in used() for part in ("--code", str(code.path), code.sha256)]


def from_arguments(given: list[str]) -> list[str]:
    """Use the files that ``arguments`` names at the end of a process's arguments; what comes before them."""
    if "--code" not in given:
        return given
    first = given.index("--code")
    for _, path, sha256 in zip(*[iter(given[first:])] * 3, strict=True):
        use_code(path, sha256)
    return given[:first]


def functions() -> Mapping[str, Callable[..., Any]]:
    """Functions of the user's own by name."""
    return _functions


def hint() -> str:
    """What to add to a refusal of a name: where names of one's own come from."""
    return "" if _used else " (a name of your own needs --code FILE)"


def same_as(kept: Iterable[Mapping[str, str]], where: str) -> None:
    """Refuse to go on with a job that was begun with other code; ``kept`` is what ``record`` was then."""
    before, now = ({Path(x["path"]).name: x["sha256"] for x in entries} for entries in (kept, record()))
    for name, digest in before.items():
        if name not in now:
            raise InputError(where, f"was begun with --code {name}", f"give --code {name} again")
        if now[name] != digest:
            found = f"was begun with another content of {name} (SHA-256 {digest[:12]}..., now {now[name][:12]}...)"
            raise InputError(where, found, "name another folder, or take the former content")
    if more := [name for name in now if name not in before]:
        raise InputError(where, f"was begun without --code {more[0]}", "name another folder, or leave the file out")


def forget() -> None:
    """Take the names of all files back."""
    for code in used():
        _withdraw(code)


def _withdraw(code: Code) -> None:
    for registry, name in code.names:
        registry.pop(name, None)
    sys.modules.pop(code.module.__name__, None)
    _used.pop(code.path, None)


def _use(path: Path, text: bytes, shown: str, expected: str) -> ModuleType:
    digest = hashlib.sha256(text).hexdigest()
    if expected and digest != expected:
        found = f"has changed: its SHA-256 was {expected[:12]}... and is {digest[:12]}..."
        raise InputError(f"--code {shown}", found, "take the former content, or begin anew")
    known = _used.get(path)
    if known is not None and known.sha256 == digest:
        return known.module
    if known is not None:
        _withdraw(known)
    module = _executed(path, text, shown, digest)
    names = _registered(module, shown)
    _used[path] = Code(path, digest, text, module, names)
    return module


def _executed(path: Path, text: bytes, shown: str, digest: str) -> ModuleType:
    name = f"bcfj_code_{path.stem}_{digest[:8]}"
    spec = importlib.util.spec_from_loader(name, loader=None, origin=str(path))
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    # Classes look their module up, for their annotations.
    sys.modules[name] = module
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        if isinstance(error, SyntaxError):
            raise InputError(f"{shown}, line {error.lineno}", f"is no Python: {error.msg}", "mend that line") from None
        line = origin(error).rpartition(", line ")[2]
        where = f"{shown}, line {line}" if line else shown
        remedy = "mend that line"
        if isinstance(error, ModuleNotFoundError):
            remedy = "put what it imports into the same file, or install it as a package"
        raise InputError(where, f"its code raised {type(error).__name__}: {error}", remedy) from error
    return module


def _registered(module: ModuleType, shown: str) -> tuple[tuple[MutableMapping[str, Any], str], ...]:
    found: list[tuple[MutableMapping[str, Any], str, Any]] = []
    for name, value in vars(module).items():
        if name.startswith("_"):
            continue
        # A function that is jitted is no FunctionType.
        plain = callable(value) and not isinstance(value, (type, eqx.Module))
        if plain and getattr(value, "__module__", "") == module.__name__:
            found.append((_functions, name, value))
            if _of_a_scene(cast("Callable[..., Any]", value)):
                found.append((scenes.SCENES, name, value))
        elif part := _part(module, name, value, shown):
            found.append((part[0], name, part[1]))
    for registry, name, _ in found:
        if name in registry or (registry is scenes.SCENES and name == MECHANISM):
            owners = (c.path.name for c in used() for r, n in c.names if r is registry and n == name)
            taken = f"the name '{name}' is taken by {next(owners, 'the package')}"
            raise InputError(f"{shown} {name}", taken, "give yours another name")
    for registry, name, value in found:
        registry[name] = value
    return tuple((registry, name) for registry, name, _ in found)


def _of_a_scene(function: Callable[..., Any]) -> bool:
    """Whether a function can be called without positional arguments, as one that returns a model."""
    optional = (inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.VAR_KEYWORD)
    parameters = inspect.signature(function).parameters.values()
    return all(x.default is not x.empty or x.kind in optional for x in parameters)


def _part(module: ModuleType, name: str, value: Any, shown: str) -> tuple[MutableMapping[str, Any], Any] | None:
    """The registry of a law, an elastic part, a friction law or a gap, and what goes there; None of anything else."""
    own = isinstance(value, type) and value.__module__ == module.__name__
    where = f"{shown} {name}"
    if own and callable(getattr(value, "sniff", None)) and callable(getattr(value, "read", None)):
        return opening.READERS, value()
    for kind, called, registry in _KINDS:
        if isinstance(value, kind):
            _check(value, called, where)
            return registry, value
        if not (own and issubclass(value, kind)):
            continue
        if missing := sorted(getattr(value, "__abstractmethods__", ())):
            if name.startswith("Abstract"):
                return None
            found = f"the {called} lacks {', '.join(missing)}"
            raise InputError(where, found, "give it, or call the class Abstract...")
        if kind is AbstractGap:
            return registry, value
        try:
            made = value()
        except InputError as error:
            raise InputError(f"{shown} {error.where.removeprefix('class ')}", error.found, error.remedy) from None
        except TypeError:
            return None  # It needs arguments: objects of it may have names of their own.
        _check(made, called, where)
        return registry, made
    return None


def _check(part: Any, called: str, where: str) -> None:
    """Refuse what a law says of its coefficients in a form that nobody could read."""
    needs, quantities = getattr(part, "needs", None), getattr(part, "quantities", {})
    if isinstance(needs, str) or not all(isinstance(x, str) for x in needs or ()) or needs is None:
        raise InputError(f"{where} needs", f"{needs!r}", f'give names of the {called}\'s coefficients: ("stiffness",)')
    good = isinstance(quantities, Mapping)
    if not good or not all(isinstance(q, Quantity) and q.name == name for name, q in quantities.items()):
        remedy = 'give {"wear": Quantity("wear", "1/m", "what it means")}, each by its own name'
        raise InputError(f"{where} quantities", f"{quantities!r}", remedy)
