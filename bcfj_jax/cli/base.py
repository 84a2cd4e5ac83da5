"""The application, and what every verb does: exit codes, messages, options that all have, getting ready for a file."""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from bcfj_jax.cli.options import CHANGES, asked
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.progress import Waiting, stage
from bcfj_jax.io import streams
from bcfj_jax.xla.surroundings import get_ready

DONE, FAILED, BAD_INPUT, SIMULATION_FAILED, INTERRUPTED = 0, 1, 2, 3, 5

EXIT_CODES = (
    "Exit codes: 0 done, 2 bad input, 3 a simulation failed, 4 the calibration's verdict is neither 'identified' nor "
    "'adequate', 5 interrupted and resumable, 130 or 143 interrupted by Ctrl-C or SIGTERM: to be started again."
)
SEEDS = (
    "What draws random numbers takes --seed: calibrate (starting points, posterior), design (starting points), study "
    "(points that are drawn), study indices (bootstrap). All else gives the same numbers in every run."
)
EPILOG = (
    f"{EXIT_CODES} Compiled programs are kept per user between runs, in the folder that BCFJ_CACHE "
    "names (BCFJ_CACHE=off keeps none), by default the system's cache folder for bcfj-jax."
)

app = typer.Typer(
    name="bcfj",
    help="Differentiable contact dynamics of the ball-cage flexible joint.",
    epilog=f"{SEEDS}\n\n{EPILOG}",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

# What every verb takes, beside its own.
_SHARED: dict[str, Any] = {
    "quiet": Annotated[bool, typer.Option("--quiet", "-q", help="No progress: warnings and errors alone.")],
    "verbose": Annotated[bool, typer.Option("--verbose", "-v", help="Every stage of the work, with its time.")],
    "as_json": Annotated[bool, typer.Option("--json", help="The result as one JSON document on stdout.")],
}
# The file of results whose content --json prints, by verb.
_MAIN = {
    "simulate": "summary.json", "sensitivity": "certificate.json", "tradeoff": "tradeoff.json",
    "design": "design.json", "calibrate": "fit.json", "reproduce": "reproduce.json", "study run": "study.json",
    "study resume": "study.json", "study merge": "study.json", "study indices": "indices.json",
    "study surface": "surface.json",
}  # fmt: skip
_HEARD_ALWAYS = ("warning:", "error:", "interrupted", "stopped", "finished work")


class Session:
    """How the verb that runs was asked to speak, and what it has to say in JSON where no file of results has it."""

    quiet = False
    content: Mapping[str, Any] | None = None


def say(text: str) -> None:
    """A line of progress, a warning or an error, on stderr; of these ``--quiet`` leaves warnings and errors."""
    if not Session.quiet or text.startswith(_HEARD_ALWAYS):
        typer.echo(text, err=True)


def result(content: Mapping[str, Any]) -> None:
    """What ``--json`` prints of a verb that writes no file of results."""
    Session.content = content


def ready(files: list[Path] | None, what: str | Path = "") -> None:
    """Get ready for a file of the user's, or a scene's name, and execute the user's own code.

    A file that cannot be read is refused before JAX is imported. The cache comes before all code: JAX decides at its first
    compilation whether there is one.
    """
    if Path(what).suffix == ".toml":
        from bcfj_jax.io import tables

        tables.read(Path(what))
    from bcfj_jax.io import second_process

    second_process.begin(_drawing)
    with stage("importing JAX"):
        get_ready()
    if files:
        from bcfj_jax.io.usercode import use_code

        for file in files:
            use_code(file)


def _drawing() -> None:
    from bcfj_jax.io import plots

    plots.rehearse()


class _Command(typer.core.TyperCommand):
    """A verb that refuses an option given twice, of which the last would hold without a word."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        *_, order = self.make_parser(ctx).parse_args(args=list(args))
        for option in (one for one in order if isinstance(one, typer.core.TyperOption)):
            if order.count(option) > 1 and not (option.multiple or option.is_flag or ctx.resilient_parsing):
                joined = ", and separate its values by commas" if "by commas" in (option.help or "") else ""
                ctx.fail(f"{option.opts[0]} is given {order.count(option)} times: give it once{joined}")
        return super().parse_args(ctx, args)


Changed = Callable[[Mapping[str, Any], Sequence[Any]], contextlib.AbstractContextManager[None]]


def verb(
    to: typer.Typer,
    name: str | None = None,
    *,
    example: str = "",
    changed: Changed | None = None,
    changes: Mapping[str, Any] = CHANGES,
) -> Callable[[Callable[..., int]], Callable[..., None]]:
    """Make a function a verb: its return value is the exit code, its docstring the help; bad input becomes a message.

    It gets ``--quiet``, ``--verbose`` and ``--json``; with ``changed`` also ``--set`` and what is short for it: from the verb's
    arguments and the changes ``changed`` makes a context within which its file reads as changed.
    """

    def added(function: Callable[..., int]) -> Callable[..., None]:
        said = name or function.__name__
        command = said if to is app else f"{to.info.name or 'study'} {said}"

        @functools.wraps(function)
        def wrapped(**options: Any) -> None:
            quiet, verbose, as_json = (options.pop(key) for key in _SHARED)
            wanted = {key: options.pop(key) for key in changes} if changed else {}

            def run() -> int:
                with changed(options, asked(wanted)) if changed else contextlib.nullcontext():
                    return function(**options)

            with _speaking(quiet, verbose):
                code, document = _done(run, as_json)
            if as_json:
                typer.echo(json.dumps(_plain({"command": command, "exit_code": code, **document}, command), indent=2))
            raise typer.Exit(_heard(code, as_json or not any(path.exists() for path in _written())))

        signature = inspect.signature(function, eval_str=True)
        parameters = list(signature.parameters.values())
        for key, hint in {**_SHARED, **(changes if changed else {})}.items():
            default = False if hint.__args__[0] is bool else None
            kind = inspect.Parameter.KEYWORD_ONLY
            parameters.append(inspect.Parameter(key, kind, default=default, annotation=hint))
        # Typer reads options from the signature.
        wrapped.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        wrapped.__annotations__ = {p.name: p.annotation for p in parameters}
        shown = "\n\n".join([f"Example: {line}" for line in example.splitlines()] + [EPILOG])
        return to.command(name, cls=_Command, epilog=shown)(wrapped)

    return added


def _done(run: Callable[[], int], as_json: bool) -> tuple[int, dict[str, Any]]:
    """Run a verb: its exit code; and, for ``--json``, its error and what it would have printed."""
    from bcfj_jax.io.guard import guarded

    heard, document = io.StringIO(), {}
    Session.content = None
    # A verb before this one, in the same process, has written other files.
    _written().clear()

    def noted() -> int:
        try:
            code = run()
            if second := sys.modules.get("bcfj_jax.io.second_process"):
                second.finish()
            return code
        except InputError as error:
            document["error"] = {"where": error.where, "found": error.found, "remedy": error.remedy}
            raise

    with contextlib.redirect_stdout(heard) if as_json else contextlib.nullcontext():
        code = guarded(noted, say)
    return code, {**document, "text": heard.getvalue().rstrip("\n")}


def _written() -> list[Path]:
    """Files that verbs of this process have left; the module that writes them may not be needed at all."""
    outputs = sys.modules.get("bcfj_jax.io.outputs")
    return outputs.written if outputs else []


def _heard(code: int, printed: bool) -> int:
    """The exit code of a verb: what was only printed, and could not be, is an error."""
    if code == DONE and printed and (why := streams.lost()):
        say(f"error: stdout cannot be written ({why}); free some space, or print to another place")
        return BAD_INPUT
    return code


@contextlib.contextmanager
def _speaking(quiet: bool, verbose: bool) -> Iterator[None]:
    """Stages are said late, or not at all, or each as it begins."""
    before = Session.quiet, Waiting.say, Waiting.after, Waiting.times, Waiting.bar
    Session.quiet = quiet
    Waiting.say = None if quiet else say
    Waiting.after, Waiting.times = 0.0 if verbose else before[2], verbose
    if sys.stderr.isatty() and not verbose:
        from bcfj_jax.cli.bars import Bars

        Waiting.bar = Bars()
    try:
        yield
    finally:
        Session.quiet, Waiting.say, Waiting.after, Waiting.times, Waiting.bar = before


def _plain(document: dict[str, Any], command: str) -> dict[str, Any]:
    """The document of ``--json``: exit code, files written, the content of the main one."""
    outputs = sys.modules.get("bcfj_jax.io.outputs")
    if outputs:
        # Of a run that was interrupted, what was written is taken back.
        there = [path for path in dict.fromkeys(outputs.written) if path.exists()]
        document["files"] = [str(path) for path in there]
        main = next((path for path in reversed(there) if path.name == _MAIN.get(command)), None)
        if main is not None:
            document["result"] = json.loads(main.read_text(encoding="utf-8"))
        outputs.written.clear()
    if Session.content is not None:
        document["result"] = dict(Session.content)
    return outputs.plain(document) if outputs else document


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
    # A false alarm of XLA about every program from its cache, its advice on slow compilations, features of processors.
    # JAX sets 1 itself, and a notebook that has imported it hands that on to its commands.
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") == "1":
        os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
