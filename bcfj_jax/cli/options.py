"""Options and arguments that several verbs take, and the changes that ``--set`` and its short forms ask for."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from bcfj_jax.io import changes
from bcfj_jax.io.changes import Change

Scene = Annotated[str, typer.Argument(help="A scene file, or a built-in scene's name for its defaults.")]
Code = Annotated[
    list[Path] | None,
    typer.Option("--code", help="A Python file of your own whose names the scene may use; can be given again."),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", help="Folder for the results, by default a new one in results/. No file there is replaced."),
]
Dry = Annotated[bool, typer.Option("--dry-run", help="Check everything, say what would be done, and write nothing.")]

# What every verb takes whose scene can be changed.
CHANGES: dict[str, Any] = {
    "set_": Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="PATH=VALUE",
            help="Another value than the file's: stiffness=4e10, seat_ball.stiffness=1e10, time.end='3 s', "
            "scene.friction=true. A path that begins with no table of the file is a parameter. Can be given again.",
        ),
    ],
    "end": Annotated[str | None, typer.Option("--end", help="Short for --set time.end=...: '3 s', 0.5.")],
    "samples": Annotated[int | None, typer.Option("--samples", help="Short for --set time.samples=...")],
    "longest_step": Annotated[
        str | None,
        typer.Option("--longest-step", help="Short for --set time.longest_step=...: a solver's longest step, '1 ms'."),
    ],
    "level": Annotated[
        str | None, typer.Option("--level", help="Short for --set accuracy.level=...: fast, balanced or reference.")
    ],
}  # fmt: skip
SET_ALONE = {"set_": CHANGES["set_"]}
# Of the verbs of a study, whose points may be drawn.
CHANGES_DRAWN: dict[str, Any] = CHANGES | {
    "seed": Annotated[
        int | None, typer.Option("--seed", min=0, help="Seed of points that are drawn: short for --set design.seed=...")
    ]
}
_SHORT = {
    "end": ("time", "end"), "longest_step": ("time", "longest_step"), "samples": ("time", "samples"),
    "level": ("accuracy", "level"), "seed": ("design", "seed"),
}  # fmt: skip


def asked(options: Mapping[str, Any]) -> list[Change]:
    """The changes that options ask for, the short forms last."""
    found = [changes.parse(text) for text in options.get("set_") or ()]
    for name, words in _SHORT.items():
        if (value := options.get(name)) is not None:
            read = changes.value(value) if isinstance(value, str) and name != "level" else value
            found.append(Change(f"--{name} {value}", words, read))
    return found


def of_scene(options: Mapping[str, Any], wanted: Sequence[Change]) -> contextlib.AbstractContextManager[None]:
    """The context within which the verb's scene reads as changed."""
    return changes.changing(options["scene"], wanted)


def of_problem(options: Mapping[str, Any], wanted: Sequence[Change]) -> contextlib.AbstractContextManager[None]:
    """The same of the verb's calibration file."""
    return changes.changing(options["problem"], wanted, changes.CALIBRATION)


def of_design(options: Mapping[str, Any], wanted: Sequence[Change]) -> contextlib.AbstractContextManager[None]:
    """The same of the verb's design file and its scene, or of a scene alone."""
    path = Path(options["what"])
    if wanted and path.suffix == ".toml":
        from bcfj_jax.io import tables

        if "objective" in tables.read(path):
            return tables.changing_both(path, wanted, changes.DESIGN)
    return changes.changing(options["what"], wanted)


def of_study(options: Mapping[str, Any], wanted: Sequence[Change]) -> contextlib.AbstractContextManager[None]:
    """The same of the verb's study file and the scene that it varies."""
    if not wanted:
        return contextlib.nullcontext()
    from bcfj_jax.analysis.studies.command import changing

    return changing(options["study"], wanted)


def split(text: str) -> list[str]:
    """Names separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]
