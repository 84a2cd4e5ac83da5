"""The verbs of a study: run, resume, status, merge, indices, surface."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from bcfj_jax.cli.base import EPILOG, app, ready, say, verb
from bcfj_jax.cli.options import CHANGES_DRAWN, Code, of_study

studies = typer.Typer(help="Run a scene at many points of its parameters.", no_args_is_help=True, epilog=EPILOG)
app.add_typer(studies, name="study")

StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help="A study file, or a built-in study: clearance.")]
StudyOut = Annotated[Path | None, typer.Option("--out", help="Folder of the study; by default results/study-NAME.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Number of processes; by default threads of one process.")]
Others = Annotated[
    list[Path] | None, typer.Option("--from", help="Another folder of the same study; can be given again.")
]
StudyDry = Annotated[bool, typer.Option("--dry-run", help="Count points, estimate time and disk; write nothing.")]
Scheduler = Annotated[str | None, typer.Option(help="Dask scheduler that shall do the work: tcp://HOST:PORT.")]


_of_study = partial(verb, studies, changed=of_study, changes=CHANGES_DRAWN)
_RUN = "bcfj study run clearance --out study"
_SPREAD = "bcfj study run examples/impact_spread.toml --out spread"


def _command(study: str, code: list[Path] | None) -> Any:
    ready(code, study)
    from bcfj_jax.analysis.studies import command

    return command


def _told(found: tuple[str, int]) -> int:
    text, code = found
    typer.echo(text)
    return code


@_of_study("run", example=f"{_RUN}\nbcfj study run examples/impact_spread.toml --set design.samples=16 --dry-run")
def study_run(
    study: StudyFile, out: StudyOut = None, workers: Workers = None, scheduler: Scheduler = None, dry_run: StudyDry = False,
    code: Code = None,
) -> int:  # fmt: skip
    """Run a study: results.parquet, study.json, a picture and report.html; goes on with what its folder holds."""
    command = _command(study, code)
    if dry_run:
        return _told((command.dry(study, out, (workers, scheduler)), command.DONE))
    return _told(command.run(study, out, (workers, scheduler), say, typer.echo))


@_of_study("resume", example=f"{_RUN}\nbcfj study resume clearance --out study")
def study_resume(
    study: StudyFile, out: StudyOut = None, workers: Workers = None, scheduler: Scheduler = None, code: Code = None
) -> int:
    """Compute what is missing of a study that was cut off."""
    return _told(_command(study, code).run(study, out, (workers, scheduler), say, typer.echo, True))


@_of_study("status", example=f"{_RUN}\nbcfj study status clearance --out study")
def study_status(study: StudyFile, out: StudyOut = None, code: Code = None) -> int:
    """Say what is finished, what failed and what is left (then the exit code is 5)."""
    return _told(_command(study, code).status(study, out))


@_of_study(
    "merge",
    example="bcfj study run clearance --out first\nbcfj study run clearance --out second\n"
    "bcfj study merge clearance --out first --from second",
)
def study_merge(study: StudyFile, out: StudyOut = None, other: Others = None, code: Code = None) -> int:
    """Take in blocks that were computed elsewhere, and write results.parquet when none is missing."""
    return _told(_command(study, code).merge(study, out, other or []))


Features = Annotated[list[str] | None, typer.Option("--feature", help="Such as contact.peak; by default every one.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the bootstrap; of the study's points: --set design.seed=...")]
Slopes = Annotated[bool, typer.Option(help="Whether to use the study's derivatives, if it kept any.")]


@verb(
    studies,
    "indices",
    example=f"{_SPREAD}\nbcfj study indices examples/impact_spread.toml --out spread --feature contact.peak",
    changed=of_study,
)
def study_indices(
    study: StudyFile, out: StudyOut = None, feature: Features = None, seed: Seed = 0, code: Code = None
) -> int:
    """Say how much of each feature's variation each parameter brings: a table, indices.json and bars."""
    ready(code, study)
    from bcfj_jax.analysis.studies import sensitivity

    return _told(sensitivity.run(study, out, feature or [], seed))


@_of_study(
    "surface",
    example=f"{_SPREAD}\nbcfj study surface examples/impact_spread.toml --out spread --feature contact.peak",
)
def study_surface(
    study: StudyFile, out: StudyOut = None, feature: Features = None, derivatives: Slopes = True, code: Code = None
) -> int:
    """Lay a response surface through each feature: its errors, surface.json and a picture a feature."""
    ready(code, study)
    from bcfj_jax.analysis.studies import surface

    return _told(surface.run(study, out, feature or [], derivatives))
