"""The verbs that check the installation: verify, against published numbers; doctor, what there is and what to do."""

from __future__ import annotations

from typing import Annotated

import typer

from bcfj_jax.cli.base import DONE, FAILED, app, ready, result, say, verb
from bcfj_jax.cli.options import split


@verb(app, example="bcfj verify\nbcfj verify --only hertz_impact,chain --json")
def verify(
    only: Annotated[str, typer.Option(help="Names of checks, separated by commas; by default every check.")] = "",
) -> int:
    """Compute published numbers and closed forms on this machine, and compare: what, source, tolerance, deviation.

    The exit code is 0 where every check passed, and 1 where one failed. The first run compiles programs and takes some
    two minutes; later runs take less than one.
    """
    ready(None)
    from bcfj_jax.verification import command
    from calibration import verification

    rows = command.run(command.picked((*command.CHECKS, *verification.CHECKS), split(only)), say)
    result(command.document(rows))
    typer.echo(command.table(rows))
    return DONE if command.passed(rows) else FAILED


@verb(app, example="bcfj doctor\nbcfj doctor --json")
def doctor() -> int:
    """Look at this installation: versions, devices, cores, the folder of compiled programs, extras; say what to do.

    The exit code is 0 where nothing is wrong, and 1 where something is. Extras that are missing are no fault.
    """
    ready(None)
    from bcfj_jax.io import doctor as examination

    found = examination.examine()
    result(examination.content(found))
    typer.echo(examination.text(found))
    return DONE if examination.healthy(found) else FAILED
