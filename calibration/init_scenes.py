"""Problem files of ``bcfj init calibration`` that come with a scene file of their own: slow tests and tossed bodies."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from shlex import quote

from bcfj_jax import InputError
from bcfj_jax.data.reading import read
from bcfj_jax.io.outputs import create
from calibration import problemfile
from calibration.impacts import otherwise, tosses
from calibration.impacts.proposal import Understood
from calibration.init import Line, Said, paths_of, quoted, read_as


def _write_both(scene_path: Path, scene: str, path: Path, lines: list, say: Callable[[str], None], check: bool) -> None:
    """Write a scene and its problem file, or neither; ``check`` reads them and says what is in the records."""
    made: list[Path] = []
    try:
        for one, text in ((scene_path, scene), (path, "\n".join(map(str, lines)) + "\n")):
            create(one, text)
            made.append(one)
        for one in problemfile.prepared(path) if check else ():
            say(f"{one.name}: {'; '.join(one.notes)}")
    except InputError:
        for one in made:
            one.unlink()
        raise


def slow(found: Understood, record: Path, out: Path | None, said: Said, say: Callable[[str], None]) -> int:
    """Write the scene of a slow test and its problem file."""
    if found.runs[0]:
        many = f"{found.runs[1]} slow tests, by {found.runs[0]}"
        raise InputError(str(record), many, f'choose one: --rows "{found.runs[0]} = 1"')
    path, relative = paths_of(record, out)
    scene_path = path.with_name(f"{path.stem}_scene.toml")
    scene, free = otherwise.driven(found.records[0])
    lines = [
        f"# A slow test, {found.path.name}: the body is driven, its mass does not count. Next: bcfj calibrate {quote(path.name)}",
        *([f"# Read as {found.said}."] if found.said else []),
        Line(f"scene = {quoted(scene_path.name)}", "in which the body follows the measured displacement"),
        "[[experiment]]",
        *read_as(found, said, relative),
        Line(f'observe = {{ "contact.normal" = {quoted(found.columns["N"])} }}'),
        Line('noise = "estimate"', 'or what the sensor is known to: "0.1 N", "2 %"'),
        "[free]",
        free,
    ]
    _write_both(scene_path, scene, path, lines, say, check=True)
    say("force and displacement are those of a slow test, no impact; --scene impact takes one all the same")
    say(f"wrote {scene_path} and {path}")
    say(f"next: bcfj calibrate {quote(str(path))}")
    return 0


def toss(moved: otherwise.InMotion, record: Path, out: Path | None, said: Said, say: Callable[[str], None]) -> int:
    """Write the scene of a tossed body, with a box's corners on a plane, and a problem file with first states of each run."""
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
    path, relative = paths_of(record, out)
    scene_path = path.with_name(f"{path.stem}_scene.toml")
    half, mass, fixed = tosses.resting(runs, max(axes)), said.number("mass", "kg"), tosses.held(runs)
    names = {"place": otherwise.PLACES, "attitude": otherwise.ATTITUDE}
    observed = ", ".join(f'"body.{what}.{n}" = {quoted(headers[n])}' for what, keys in names.items() for n in keys)
    lines: list[Line | str] = [
        f"# A body in motion, {record.name}, proposed by bcfj init calibration. Next: bcfj calibrate {quote(path.name)}",
        Line(f"scene = {quoted(scene_path.name)}", "a box on a plane: CHECK its size and inertia there"),
        Line('sensor = "exact"', "each run has its own first state in place of a clock and zero"),
    ]
    for one, run_ in zip(paths, runs, strict=True):
        place = relative if len(paths) == 1 else (Path(relative).parent / one.name).as_posix()
        lines += [
            "[[experiment]]",
            f"file = {quoted(place)}",
            *([f"table = {quoted(said.table)}"] if said.table else []),
        ]
        lines += [
            f"time = {quoted(time)}",
            f"observe = {{ {observed} }}",
            'noise = "estimate"',
            *tosses.own(run_, fixed),
        ]
    lines += ["[free]", *tosses.free(runs, mass)]
    _write_both(scene_path, tosses.scene(runs, max(axes), half, mass), path, lines, say, check=half is not None)
    say(f"places and attitudes are those of a tossed body: CHECK its size and inertia in {scene_path}")
    say(f"wrote {scene_path} and {path}")
    say(
        f"next: {'' if half else 'write the sizes in place of the question marks, then '}bcfj calibrate {quote(str(path))}"
    )
    return 0
