"""Verbs that search parameters: design, for a better scene; calibrate, for what records say."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from bcfj_jax.cli.base import DONE, SIMULATION_FAILED, Session, app, ready, say, verb
from bcfj_jax.cli.options import SET_ALONE, Code, Dry, Out, of_design, of_problem
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError


@verb(
    app,
    example="bcfj design joint --minimize seat_cage.peak --vary clearance_seat_cage=10um:200um\n"
    "bcfj design impact --minimize contact.peak --vary damping=0.1:1 --vary mass=10g:30g --starts 4",
    changed=of_design,
)
def design(
    what: Annotated[str, typer.Argument(metavar="SCENE|FILE", help="A scene's name, a scene file or a design file.")],
    minimize: Annotated[str | None, typer.Option(help="The feature to make least, such as seat_cage.peak.")] = None,
    maximize: Annotated[str | None, typer.Option(help="The feature to make most.")] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOWER:UPPER[:TOLERANCE]",
            help="A free parameter with its bounds and, where it is known, the tolerance it is made to. Can be given "
            "again.",
        ),
    ] = None,
    starts: Annotated[
        int | None, typer.Option(min=1, max=limits.STARTS, help="Number of starting points, by default 8.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the starting points, by default 0.")] = None,
    confirm: Annotated[bool | None, typer.Option(help="Whether an independent run checks the optimum.")] = None,
    certify: Annotated[bool | None, typer.Option(help="Whether the gradient at the optimum is certified.")] = None,
    code: Code = None,
    out: Out = None,
    dry_run: Dry = False,
) -> int:
    """Make a feature least, or most, over free parameters: design.json, pictures and report.html."""
    ready(code, what)
    from bcfj_jax.analysis.designs import command, designfile

    free = [command.vary(text) for text in vary or ()]
    names = [name for name, _ in free]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError("--vary", f"'{twice}' is varied twice", "vary it once")
    options = {"starts": starts, "seed": seed, "confirm": confirm, "certify": certify}
    given = {"minimize": minimize, "maximize": maximize}
    more: dict[str, Any] = {
        "objective": {key: value for key, value in given.items() if value is not None},
        "vary": dict(free),
        "search": {key: value for key, value in options.items() if value is not None},
    }
    if dry_run:
        from bcfj_jax.cli import plan

        asked = designfile.load(what, more)
        command.check(asked)
        rows = [
            ["question", command.sentence(asked)],
            ["model", asked.note or "the scene's own"],
            ["times", f"{len(asked.times)} to {asked.times[-1]:.6g} s"],
            ["starts", str(asked.search.starts)],
            ["runs", f"{4 * asked.search.starts} first, then {asked.search.starts * asked.search.iterations} at most"],
        ]
        plan.show(rows, out)
        return DONE
    text, good = command.run(what, more, out, say, typer.echo)
    typer.echo(text)
    return DONE if good else SIMULATION_FAILED


def _unsaid() -> Callable[[logging.LogRecord], bool]:
    """A filter that lets each message pass once: the fits of several models find the same."""
    said: set[str] = set()

    def new(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        return text not in said and not said.add(text)

    return new


@verb(
    app,
    example="bcfj calibrate examples/chung_ooi_fit.toml --set free.exponent=[1,2] --starts 6",
    changed=of_problem,
    changes=SET_ALONE,
)
def calibrate(
    problem: Annotated[Path, typer.Argument(help="A calibration file.")],
    out: Out = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starting points.")] = 0,
    starts: Annotated[int, typer.Option(min=4, max=limits.STARTS, help="Number of starting points.")] = 12,
    intervals: Annotated[str, typer.Option(help="covariance, profile, posterior or bound.")] = "covariance",
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="Say what would explain a miss; confirm by fits.")
    ] = False,
    export_petab: Annotated[Path | None, typer.Option(help="Write PEtab 2 tables there instead of fitting.")] = None,
    code: Code = None,
    dry_run: Dry = False,
) -> int:
    """Fit parameters to measured forces: fit.json, pictures and report.html.

    Finished starts are kept in DIR/journal.jsonl. After Ctrl-C (exit code 5), or a crash, the same command with the
    same --out goes on from there and finds the same fit; the journal is removed when the fit is written.
    """
    ready(code, problem)
    if dry_run:
        from bcfj_jax.cli import plan
        from calibration import problemfile

        given = problemfile.load(problem)
        fitted = [e for e in given.experiments if not e.hold_out]
        rows = [
            ["scene", given.scene.kind],
            ["records", f"{len(fitted)} to fit, {len(given.experiments) - len(fitted)} held out"],
            ["samples", str(sum(e.samples for e in fitted))],
            ["free", ", ".join(f.name for f in given.free)],
            ["fits", f"{starts} starts, intervals by {intervals}"],
        ]
        plan.show(rows, out)
        return DONE
    progress = logging.getLogger("calibration")
    progress.setLevel(logging.INFO)
    handler = logging.StreamHandler(sys.stderr)
    handler.addFilter(_unsaid())
    if not Session.quiet:
        progress.addHandler(handler)
    from calibration import command

    if export_petab is not None:
        return command.export_petab(problem, export_petab)
    return command.run(problem, out, seed, starts, intervals, diagnose)
