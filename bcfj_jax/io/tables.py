"""TOML files in, checked tables out: syntax, keys and types, each error with file, key and remedy."""

from __future__ import annotations

import contextlib
import os
import re
import tomllib
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import pydantic

from bcfj_jax.core.errors import InputError, clip, nearest
from bcfj_jax.io import changes
from bcfj_jax.io.opening import LARGEST_TOML, content

# Parts of a dotted key. The reader's time grows with their square.
_DEEPEST = 30

M = TypeVar("M", bound="Table")
# What a number may be written as; checked by ``units``, which knows the unit.
Number = Annotated[Any, pydantic.WithJsonSchema({"type": ["number", "string"]})]


class Table(pydantic.BaseModel):
    """A TOML table: unknown keys are errors, and a text is not a number or a truth value."""

    model_config = pydantic.ConfigDict(extra="forbid", strict=True, frozen=True, arbitrary_types_allowed=True)


def published(model: type[Table], kind: str) -> dict[str, Any]:
    """The JSON Schema of a file of one kind; in it names with a point are quoted, which the loader does not need."""
    schema = model.model_json_schema()
    # Long notes for readers of the code do not help who writes a file.
    for part in (schema, *schema.get("$defs", {}).values()):
        if "description" in part:
            part["description"] = part["description"].split("\n\n")[0].replace("``", "").replace("\n", " ")
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "$id": f"bcfj-{kind}.schema.json"}
    return {**head, **schema, "title": f"bcfj {kind} file"}


def read(path: Path) -> dict[str, Any]:
    """The content of a TOML file, with what the command line changed of it (``io.changes``); a fault is named with its line."""
    shown, right = clip(str(path)), "give the path of a TOML file"
    try:
        raw = content(path, LARGEST_TOML, shown, right, "give a file of settings; data go in a file of their own")
    except InputError as error:
        # The path is the place already.
        found = "there is no such file" if error.found.startswith("no file") else error.found
        raise InputError(shown, found.removeprefix(f"{shown} "), error.remedy) from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        found = f"byte 0x{raw[error.start]:02x} is not UTF-8 text"
        raise InputError(f"{shown}, line {line}", found, "save the file as UTF-8") from None
    for number, line in enumerate(text.splitlines(), 1):
        if line.partition("=")[0].count(".") > _DEEPEST:
            raise InputError(f"{shown}, line {number}", f"a key of more than {_DEEPEST} parts", "write a shorter key")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        said, line = str(error), re.search(r"at line (\d+)", str(error))
        where = f"{shown}, line {line[1]}" if line else shown
        raise InputError(where, f"not TOML: {clip(said)}", "write key = value; a text goes in quotes") from None
    except RecursionError:
        raise InputError(shown, "brackets inside brackets, too deep to be read", "write a flat table") from None
    except ValueError as error:  # An integer of more digits than Python converts, a date that does not exist.
        raise InputError(shown, f"not TOML: {clip(str(error))}", "write numbers as 4e10") from None
    return changes.applied(path, table)


@contextlib.contextmanager
def changing_both(path: Path, wanted: Sequence[changes.Change], own: Sequence[str]) -> Iterator[None]:
    """Within, a study's or a design's file and the scene that it names, or holds as a table, read as changed: changes of a table
    in ``own`` are the file's, others the scene's.
    """
    mine = [change for change in wanted if change.words[0] in own]
    others = [change for change in wanted if change.words[0] not in own]
    with contextlib.ExitStack() as stack:
        stack.enter_context(changes.changing(path, mine, own))
        scene = read(path).get("scene") if others else None
        if isinstance(scene, str):
            beside = path.parent / scene
            target = beside if scene.endswith(".toml") and os.path.exists(beside) else scene
            stack.enter_context(changes.changing(target, others))
        elif scene is not None:
            stack.enter_context(changes.changing(path, others, inside="scene"))
        yield


@contextlib.contextmanager
def placed(place: Callable[[str], str]) -> Iterator[None]:
    """Within, what is refused names another place, which is made of the one that it names itself."""
    try:
        yield
    except InputError as error:
        raise InputError(place(error.where), error.found, error.remedy) from error.__cause__


def flat(table: Mapping[str, Any], inside: str = "") -> dict[str, Any]:
    """Parameters by name of a table in which a point in a name made a table: ``seat_ball.stiffness = 1e10``."""
    found: dict[str, Any] = {}
    for key, value in table.items():
        name = f"{inside}{key}"
        found.update(flat(value, f"{name}.") if isinstance(value, Mapping) and value else {name: value})
    return found


def nested(table: Mapping[str, Any], model: type[Table], inside: str = "") -> dict[str, Any]:
    """As ``flat``, of tables by name: ``[free.seat_ball.stiffness]`` is the table of ``seat_ball.stiffness``, since a table of
    nothing but tables that are no keys of ``model`` is a part of a name.
    """
    found: dict[str, Any] = {}
    for key, value in table.items():
        name, keys = f"{inside}{key}", [f.alias or n for n, f in model.model_fields.items()]
        part = isinstance(value, Mapping) and value and not set(value) & set(keys)
        part = part and all(isinstance(x, (Mapping, list)) for x in value.values())
        found.update(nested(value, model, f"{name}.") if part else {name: value})
    return found


def validated(model: type[M], table: object, where: str, inside: str = "") -> M:
    """A table checked against its model; ``inside``: its own name in the file. The first key that is unknown is refused with the
    nearest right one, else one that is missing or of a wrong type.
    """
    try:
        return model.model_validate(table)
    except pydantic.ValidationError as error:
        problems = error.errors(include_url=False, include_context=False)
    unknown = [p for p in problems if p["type"] == "extra_forbidden"]
    problem = (unknown or problems)[0]
    path = [part for part in (inside, *problem["loc"]) if part != ""]
    key, parents = str(path[-1]) if path else "", path[:-1]
    shown = clip(key)
    place = f"{where}: [{clip('.'.join(map(str, parents)))}] {shown}" if parents else f"{where}: {shown}"
    if problem["type"] == "extra_forbidden":
        raise InputError(place, f"unknown key '{clip(key)}'", nearest(key, _known(model, problem["loc"][:-1])))
    if problem["type"] == "missing":
        raise InputError(place, f"the key '{key}' is missing", "it must be given")
    tabled = problem["type"] in ("model_type", "model_attributes_type", "dict_type")
    message = "a table: keys and values" if tabled else problem["msg"].removeprefix("Input should be ")
    given = repr(problem["input"]) if isinstance(problem["input"], str) else problem["input"]
    raise InputError(place, f"{clip(given)} is not accepted", f"give {message}")


def _known(model: type[pydantic.BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    for part in loc:
        field = model.model_fields.get(str(part))
        # A part that names no field is a position in a list or a free name in a table of tables.
        found = _model_in(field.annotation) if field else None
        model = found or model
    return [field.alias or name for name, field in model.model_fields.items()]


def _model_in(annotation: object) -> type[pydantic.BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, pydantic.BaseModel):
        return annotation
    found = (_model_in(part) for part in typing.get_args(annotation))
    return next((m for m in found if m), None)
