"""The application, and what every verb does: exit codes, messages, getting ready for a file of the user's."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from bcfj_jax.core.compile_cache import open_cache
from bcfj_jax.core.progress import Waiting, stage

DONE, BAD_INPUT, SIMULATION_FAILED, INTERRUPTED = 0, 2, 3, 5

EPILOG = (
    "Exit codes: 0 done, 2 bad input, 3 a simulation failed, 4 the calibration's verdict is neither 'identified' nor "
    "'adequate', 5 interrupted and resumable, 130 or 143 interrupted by Ctrl-C or SIGTERM with nothing kept. Compiled "
    "programs are kept per user between runs, in the folder that BCFJ_CACHE names (BCFJ_CACHE=off keeps none), by "
    "default the system's cache folder for bcfj-jax."
)

app = typer.Typer(
    name="bcfj",
    help="Differentiable contact dynamics of the ball-cage flexible joint.",
    epilog=EPILOG,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def say(text: str) -> None:
    """A line of progress, a warning or an error, on stderr."""
    typer.echo(text, err=True)


def ready(files: list[Path] | None, what: str | Path = "") -> None:
    """Get ready for a file of the user's, or a scene's name, and execute the user's own code.

    A file that cannot be read is refused before JAX is imported. The cache comes before all code: JAX decides at its
    first compilation whether there is one.
    """
    if Path(what).suffix == ".toml":
        from bcfj_jax.io import tables

        tables.read(Path(what))
    with stage("importing JAX"):
        open_cache()
    if files:
        from bcfj_jax.io.usercode import use_code

        for file in files:
            use_code(file)


def verb(to: typer.Typer, name: str | None = None) -> Callable[[Callable[..., int]], Callable[..., None]]:
    """Make a function a verb: its return value is the exit code, its docstring the help.

    Bad input becomes a message instead of a traceback.
    """

    def added(function: Callable[..., int]) -> Callable[..., None]:
        @functools.wraps(function)
        def wrapped(*args: object, **options: object) -> None:
            from bcfj_jax.io.guard import guarded

            raise typer.Exit(guarded(functools.partial(function, *args, **options), say))

        return to.command(name, epilog=EPILOG)(wrapped)

    return added


def _show_version(wanted: bool) -> None:
    if wanted:
        from bcfj_jax.io.provenance import version

        typer.echo(f"bcfj-jax {version()}")
        raise typer.Exit(DONE)


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    del version
    Waiting.say = say
