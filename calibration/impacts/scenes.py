"""Problem files that come with a scene file of their own: slow tests and tossed bodies."""

from __future__ import annotations

import re
from pathlib import Path
from shlex import quote
from typing import NamedTuple

from bcfj_jax import InputError
from bcfj_jax.data.reading import read
from calibration.impacts import otherwise, slow_tests, tosses
from calibration.impacts.lines import Line, Said, read_as, toml
from calibration.impacts.proposal import Understood


class Proposed(NamedTuple):
    """Texts of a scene and of its problem file by lines, what the record is, and what is to be done first, "" for nothing."""

    scene: str
    lines: list[Line | str]
    kind: str
    missing: str


def scene_of(path: Path) -> Path:
    """Where the scene of a problem file goes."""
    return path.with_name(f"{path.stem}_scene.toml")


def slow(found: Understood, said: Said, path: Path, file: str) -> Proposed:
    """A slow test, whose problem file at ``path`` names the record ``file``."""
    if found.runs[0]:
        many = f"{found.runs[1]} slow tests, by {found.runs[0]}"
        raise InputError(str(found.path), many, f'choose one: --rows "{found.runs[0]} = 1"')
    scene, free = slow_tests.driven(found.records[0])
    lines = [
        f"# A slow test, {found.path.name}: the body is driven, its mass does not count. Next: bcfj calibrate {quote(path.name)}",
        *([f"# Read as {found.said}."] if found.said else []),
        Line(f"scene = {toml(scene_of(path).name)}", "in which the body follows the measured displacement"),
        "[[experiment]]",
        *read_as(found, said, file),
        Line(f'observe = {{ "contact.normal" = {toml(found.columns["N"])} }}'),
        Line('noise = "estimate"', 'or what the sensor is known to: "0.1 N", "2 %"'),
        "[free]",
        free,
    ]
    kind = "force and displacement are those of a slow test, no impact; --scene impact takes one all the same"
    return Proposed(scene, lines, kind, "")


def toss(moved: otherwise.InMotion, record: Path, said: Said, path: Path, file: str) -> Proposed:
    """Tossed bodies: a box's corners on a plane, and a first state of each run; arguments as of ``slow``."""
    paths = sorted(record.parent.glob(record.name)) if re.search("[*?]", record.name) else [record]
    headers, time, runs, axes = moved.columns, moved.table.clock, [], set[int]()
    for one in paths:
        clock, places, attitudes = tosses.read(read(one, "record", said.table, said.stated), time, headers)
        axes.add(tosses.upwards(clock, places))
        if clock[0] != 0.0 or len(axes) > 1:
            wrong = (
                f"its clock begins at {clock[0]:.6g} s" if clock[0] else "it falls along another axis than the first"
            )
            raise InputError(str(one), wrong, "let every toss begin at 0 s, and fall along one axis")
        runs.append(tosses.Toss(clock, places, tosses.first(clock, places, attitudes, max(axes))))
    half, mass, fixed = tosses.resting(runs, max(axes)), said.number("mass", "kg"), tosses.held(runs)
    names = {"place": otherwise.PLACES, "attitude": otherwise.ATTITUDE}
    observed = ", ".join(f'"body.{what}.{n}" = {toml(headers[n])}' for what, keys in names.items() for n in keys)
    lines: list[Line | str] = [
        f"# A body in motion, {record.name}, proposed by bcfj init calibration. Next: bcfj calibrate {quote(path.name)}",
        Line(f"scene = {toml(scene_of(path).name)}", "a box on a plane: CHECK its size and inertia there"),
        Line('sensor = "exact"', "each run has its own first state in place of a clock and zero"),
    ]
    for one, run_ in zip(paths, runs, strict=True):
        place = file if len(paths) == 1 else (Path(file).parent / one.name).as_posix()
        lines += [
            "[[experiment]]",
            f"file = {toml(place)}",
            *([f"table = {toml(said.table)}"] if said.table else []),
        ]
        lines += [
            f"time = {toml(time)}",
            f"observe = {{ {observed} }}",
            'noise = "estimate"',
            *tosses.own(run_, fixed),
        ]
    lines += ["[free]", *tosses.free(runs, half, mass)]
    kind = f"places and attitudes are those of a tossed body: CHECK its size and inertia in {scene_of(path)}"
    missing = "" if half else "write the sizes in place of the question marks, then "
    return Proposed(tosses.scene(runs, max(axes), half, mass), lines, kind, missing)
