"""The verb that improves a scene: design."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from bcfj_jax.cli.base import DONE, SIMULATION_FAILED, app, ready, say, verb
from bcfj_jax.cli.options import Code, Dry, Out, of_design
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
    text, good = command.run(what, more, out, say)
    typer.echo(text)
    return DONE if good else SIMULATION_FAILED
