"""TOML files in, checked tables out: syntax, keys and types, each error with file, key and remedy."""

from __future__ import annotations

import re
import tomllib
import typing
from pathlib import Path
from typing import Any, TypeVar

import pydantic

from bcfj_jax.core.errors import InputError, nearest

M = TypeVar("M", bound="Table")


class Table(pydantic.BaseModel):
    """A TOML table: unknown keys are errors, and a text is not a number or a truth value."""

    model_config = pydantic.ConfigDict(extra="forbid", strict=True, frozen=True, arbitrary_types_allowed=True)


def read(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: when there is no such file, it is no text or no TOML; the last with its line.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(str(path), "there is no such file", "give the path of a TOML file") from None
    except OSError as error:
        raise InputError(str(path), f"cannot be read ({error.strerror})", "give the path of a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(str(path), "is not UTF-8 text", "save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        text, line = str(error), re.search(r"at line (\d+)", str(error))
        where = f"{path}, line {line[1]}" if line else str(path)
        raise InputError(where, f"not TOML: {text}", "write key = value; a text goes in quotes") from None


def validated(model: type[M], table: object, where: str, inside: str = "") -> M:
    """A table checked against its model.

    Args:
        model: what the table may hold.
        table: what it does hold.
        where: file name, for the message.
        inside: the table's own name, where it is part of a file.

    Raises:
        InputError: for the first key that is unknown (with the nearest right one), missing or of a wrong type.
    """
    try:
        return model.model_validate(table)
    except pydantic.ValidationError as error:
        problems = error.errors(include_url=False, include_context=False)
    unknown = [p for p in problems if p["type"] == "extra_forbidden"]
    problem = (unknown or problems)[0]
    path = [part for part in (inside, *problem["loc"]) if part != ""]
    key, parents = str(path[-1]) if path else "", path[:-1]
    place = f"{where}: [{'.'.join(map(str, parents))}] {key}" if parents else f"{where}: {key}"
    if problem["type"] == "extra_forbidden":
        raise InputError(place, f"unknown key '{key}'", nearest(key, _known(model, problem["loc"][:-1])))
    if problem["type"] == "missing":
        raise InputError(place, f"the key '{key}' is missing", "it must be given")
    message = problem["msg"].removeprefix("Input should be ")
    raise InputError(place, f"{problem['input']!r} is not accepted", f"give {message}")


def _known(model: type[pydantic.BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Keys that the table at a place in the model may have."""
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
