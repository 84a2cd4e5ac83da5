"""Options and arguments that several verbs take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Scene = Annotated[str, typer.Argument(help="A scene file, or a built-in scene's name for its defaults.")]
Code = Annotated[
    list[Path] | None,
    typer.Option("--code", help="A Python file of your own whose names the scene may use; can be given again."),
]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results; a file that is there is kept.")]
