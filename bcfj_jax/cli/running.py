"""Verbs that run a scene: simulate, sensitivity, tradeoff, reproduce."""

from __future__ import annotations

from typing import Annotated

import typer

from bcfj_jax.cli.base import DONE, SIMULATION_FAILED, app, ready, say, verb
from bcfj_jax.cli.options import Code, Out, Scene
from bcfj_jax.core.compile_cache import open_cache


@verb(app)
def simulate(
    scene: Scene,
    measure_error: Annotated[bool, typer.Option(help="Whether to run once more, finer, to measure the error.")] = True,
    code: Code = None,
    out: Out = None,
) -> int:
    """Run a scene: forces.csv, summary.json with the measured force error, pictures and report.html."""
    ready(code, scene)
    from bcfj_jax.analysis.simulation import command

    good = command.run(scene, out, say, typer.echo, measure_error)
    return DONE if good else SIMULATION_FAILED


@verb(app)
def sensitivity(
    scene: Scene,
    wrt: Annotated[str, typer.Option(help="Parameters to differentiate by, names separated by commas.")],
    features: Annotated[str, typer.Option(help="Features such as seat_ball.peak; by default every one.")] = "",
    certify: Annotated[bool, typer.Option(help="Whether to say how good the derivatives are.")] = True,
    budget: Annotated[float, typer.Option(min=0.0, help="Seconds for runs to compare the derivatives with.")] = 60.0,
    code: Code = None,
    out: Out = None,
) -> int:
    """Differentiate a run: sensitivity.csv, certificate.json, a ranked table, pictures and report.html."""
    ready(code, scene)
    from bcfj_jax.analysis.derivatives import command

    names, wanted = ([n.strip() for n in text.split(",") if n.strip()] for text in (wrt, features))
    text, good = command.run(scene, names, wanted, certify, budget, out, say, typer.echo)
    typer.echo(text)
    return DONE if good else SIMULATION_FAILED


@verb(app)
def tradeoff(
    scene: Scene,
    only: Annotated[str, typer.Option(help="Groups of settings and solvers, such as tsit5,smoothing.")] = "",
    derivatives: Annotated[bool, typer.Option(help="Whether to measure derivatives, too.")] = True,
    budget: Annotated[float, typer.Option(min=0.0, help="Seconds; what would not fit is left out.")] = 900.0,
    code: Code = None,
    out: Out = None,
) -> int:
    """Measure what accuracy costs on a scene: tradeoff.csv, a setting per error budget, pictures and report.html.

    Finished settings are kept in DIR/journal.jsonl: the same command with the same --out goes on after Ctrl-C (exit
    code 5), after a crash, and with what the budget left out.
    """
    ready(code, scene)
    from bcfj_jax.analysis.tradeoff import command

    wanted = [name.strip() for name in only.split(",") if name.strip()]
    text, found = command.run(scene, wanted, derivatives, budget, out, say)
    typer.echo(text)
    return found


@verb(app)
def reproduce(out: Out = None) -> int:
    """Run the paper's case: its claims beside the model's values, as given and calibrated, with pictures."""
    open_cache()
    from bcfj_jax.reproduction import command

    text, good = command.run(out, say)
    typer.echo(text)
    return DONE if good else SIMULATION_FAILED
