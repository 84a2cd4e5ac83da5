"""What is proposed of a record: files, their lines, and what a user says beside the record."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

from bcfj_jax.data.textfile import Stated
from bcfj_jax.io.units import quantity
from calibration.impacts.proposal import Hints, Understood

# The struck body where it cannot move.
FIXED = "fixed"


class Draft(NamedTuple):
    """Texts of files to be made, what is to be said of them, and whether nothing is left to fill in."""

    files: dict[Path, str]
    said: list[str]
    whole: bool


class Line(NamedTuple):
    """A line of the file, and what is said behind it."""

    text: str
    note: str = ""

    def __str__(self) -> str:
        return f"{self.text:<60}  # {self.note}" if self.note else self.text


NOISE = Line('noise = "estimate"', 'or what the sensor is known to: "0.1 N", "2 %"')


class Said(NamedTuple):
    """What is said beside the record."""

    scene: str = ""  # impact, bounce or oblique_impact; "" takes what the record looks like
    # mass, speed: texts with units, where they are known.
    mass: str | None = None
    speed: str | None = None
    table: str | None = None  # which table inside the file
    struck: str | None = None  # mass of the body that is struck, with a unit, or "fixed"
    # How the record is written, where it is not to be found; the problem file then says so, too.
    stated: Stated = Stated()
    hints: Hints = Hints()  # which columns are what

    def number(self, key: str, unit: str) -> float | None:
        """A mass or a speed, SI."""
        said = getattr(self, key)
        return None if said is None else quantity(said, unit, f"--{key}")

    @property
    def other(self) -> float | None:
        """Mass of the body that is struck [kg], if that is free and known."""
        return None if self.struck in (None, FIXED) else quantity(self.struck, "kg", "--struck-mass")


def toml(value: Any) -> str:
    """A value as TOML has it: headers of measured files may hold quotes and backslashes."""
    return json.dumps(value, ensure_ascii=False)


def joined(lines: Iterable[Line | str]) -> str:
    """The text of a file."""
    return "\n".join(map(str, lines)) + "\n"


def box(name: str, bounds: Iterable[str], note: str = "", more: str = "") -> Line:
    """A line of [free]: bounds as they are written."""
    lower, upper = bounds
    return Line(f"{name} = {{ lower = {lower}, upper = {upper}{more} }}", note)


def read_as(found: Understood, said: Said, file: str) -> list[Line | str]:
    """Lines that say where a record is and how it is read."""
    every = f"every {found.runs[0]} is a record" if found.runs[0] and not (found.each or found.parts) else ""
    stated = {key: v for key, v in vars(said.stated).items() if v is not None}
    return [
        *(f"name = {toml(part.name)}" for part in found.parts),
        Line(f"file = {toml(file)}", every),
        *([f"table = {toml(found.table)}"] if found.table else []),
        *(f"{key} = {toml(v)}" for key, v in stated.items()),
        f"time = {toml(found.time)}",
        *(f"rows = {{ {toml(header)} = {toml(value)} }}" for header, value in found.rows.items()),
    ]


def with_scene(path: Path, scene: str, lines: Iterable[Line | str], kind: str, missing: str = "") -> Draft:
    """A problem file at ``path`` with a scene file of its own: what the record is, and what is to be done first."""
    files = {scene_of(path): scene, path: joined(lines)}
    said = [kind, f"wrote {scene_of(path)} and {path}", f"next: {missing}bcfj calibrate {quote(str(path))}"]
    return Draft(files, said, not missing)


def scene_of(path: Path) -> Path:
    """Where the scene of a problem file goes."""
    return path.with_name(f"{path.stem}_scene.toml")
