"""The verb that fits parameters to records: calibrate."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from bcfj_jax.cli.base import DONE, Session, app, ready, verb
from bcfj_jax.cli.options import SET_ALONE, Code, Dry, Out, of_problem
from bcfj_jax.core import limits


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
    intervals: Annotated[str, typer.Option(help="covariance, profile or posterior.")] = "covariance",
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
