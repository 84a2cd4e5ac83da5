"""Verbs that run a scene: simulate, animate, sensitivity, tradeoff, reproduce."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from bcfj_jax.cli.base import app, ready, result, say, verb
from bcfj_jax.cli.options import Code, Dry, Out, Scene, of_scene, split

Animate = Annotated[
    str, typer.Option(help="Also write animation.html, .glb, .mp4 or .gif: html, gltf, mp4 or gif, several by commas.")
]
Frames = Annotated[
    str, typer.Option(help="Also write forces_in_frames.csv: forces in the axes of bodies, or world, by commas.")
]


@verb(
    app,
    example="bcfj simulate joint --set clearance_seat_cage='80 um' --end '0.5 s' --level fast --out joint",
    changed=of_scene,
)
def simulate(
    scene: Scene,
    measure_error: Annotated[bool, typer.Option(help="Whether to run once more, finer, to measure the error.")] = True,
    animate: Animate = "",
    frames: Frames = "",
    code: Code = None,
    out: Out = None,
    dry_run: Dry = False,
) -> int:
    """Run a scene: forces.csv, summary.json with the measured force error, pictures and report.html."""
    ready(code, scene)
    from bcfj_jax.analysis.simulation import command
    from bcfj_jax.cli import plan

    movies = command.movies(split(animate))
    if dry_run:
        runs = "2: one more measures the error" if measure_error else "1"
        return plan.of_scene("simulate", scene, out, [["runs", runs]])
    begin = time.perf_counter()
    good = command.run(scene, command.Wanted(measure_error, movies, split(frames)), out, say, typer.echo)
    return plan.ended("simulate", scene, begin, good)


@verb(app, example="bcfj animate slider_crank --to gif\nbcfj animate joint --end '0.1 s'", changed=of_scene)
def animate(
    scene: Scene,
    to: Annotated[str, typer.Option(help="html (interactive, one file, opens offline), gltf, mp4 or gif.")] = "html",
    code: Code = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for the file, or the file itself; by default here.")
    ] = None,
    dry_run: Dry = False,
) -> int:
    """Run a scene and write it in motion: SCENE.html, .glb, .mp4 or .gif. No file is replaced."""
    ready(code, scene)
    from bcfj_jax.analysis.simulation import command
    from bcfj_jax.cli import plan

    if dry_run:
        return plan.of_scene("animate", scene, None, [["file", str(command.movie(scene, to, out))]])
    begin = time.perf_counter()
    path, good = command.animated(scene, to, out, say)
    result({"file": str(path)})
    typer.echo(f"wrote {path}")
    return plan.ended("animate", scene, begin, good)


@verb(
    app,
    example="bcfj sensitivity joint --wrt clearances --features seat_cage.peak\n"
    "bcfj sensitivity impact --wrt stiffness,damping",
    changed=of_scene,
)
def sensitivity(
    scene: Scene,
    wrt: Annotated[
        str,
        typer.Option(
            help="Parameters to differentiate by, separated by commas: names, patterns such as clearance_*, or a "
            "group: clearances, stiffnesses, dampings, exponents, frictions, masses, all."
        ),
    ],
    features: Annotated[str, typer.Option(help="Features such as seat_ball.peak; by default every one.")] = "",
    certify: Annotated[bool, typer.Option(help="Whether to say how good the derivatives are.")] = True,
    budget: Annotated[
        float, typer.Option(min=0.0, help="Seconds for comparing the derivatives with other runs, compiling included.")
    ] = 15.0,
    code: Code = None,
    out: Out = None,
    dry_run: Dry = False,
) -> int:
    """Differentiate a run: sensitivity.csv, certificate.json, a ranked table, pictures and report.html."""
    ready(code, scene)
    from bcfj_jax.analysis.derivatives import command
    from bcfj_jax.analysis.derivatives.sensitivity import DerivingKeys
    from bcfj_jax.cli import plan

    names, wanted = split(wrt), split(features)
    if dry_run:
        found, kept = command.checked(scene, names, wanted)
        rows = [
            ["derivatives", f"{len(found)}: {', '.join(found)}"],
            ["features", str(len(kept))],
            ["solves", "2 or more, each far tighter than the one before it" if certify else "1"],
            ["comparisons", f"{budget:g} s at most" if certify else "none"],
        ]
        return plan.of_scene("sensitivity", scene, out, rows)
    begin = time.perf_counter()
    asked = DerivingKeys(features=wanted, certify=certify, budget=budget)
    text, good = command.run(scene, names, asked, out, say, typer.echo)
    typer.echo(text)
    return plan.ended("sensitivity", scene, begin, good)


@verb(app, example="bcfj tradeoff impact --budget 120 --only tsit5,smoothing", changed=of_scene)
def tradeoff(
    scene: Scene,
    only: Annotated[str, typer.Option(help="Groups of settings and solvers, such as tsit5,smoothing.")] = "",
    derivatives: Annotated[bool, typer.Option(help="Whether to measure derivatives, too.")] = True,
    budget: Annotated[float, typer.Option(min=0.0, help="Seconds; what would not fit is left out.")] = 900.0,
    code: Code = None,
    out: Out = None,
    dry_run: Dry = False,
) -> int:
    """Measure what accuracy costs on a scene: tradeoff.csv, a setting per error budget, pictures and report.html.

    Finished settings are kept in DIR/journal.jsonl: the same command with the same --out goes on after Ctrl-C (exit
    code 5), after a crash, and with what the budget left out.
    """
    ready(code, scene)
    from bcfj_jax.analysis.tradeoff import command
    from bcfj_jax.cli import plan

    wanted = split(only)
    if dry_run:
        from bcfj_jax.analysis.tradeoff.settings import settings
        from bcfj_jax.io.scenefile import load, shown

        count = len(settings(shown(load(scene)), wanted, derivatives))
        return plan.of_scene("tradeoff", scene, out, [["settings", str(count)], ["time", f"{budget:g} s at most"]])
    text, found = command.run(scene, command.Wanted(wanted, derivatives, budget), out, say, typer.echo)
    typer.echo(text)
    return found


@verb(app, example="bcfj reproduce --out paper")
def reproduce(out: Out = None, dry_run: Dry = False) -> int:
    """Run the paper's case: its claims beside the model's values, as given and calibrated, with pictures."""
    ready(None)
    from bcfj_jax.cli import plan
    from bcfj_jax.reproduction import command

    if dry_run:
        rows = [["runs", "3: as given, with small clearances, calibrated"], ["fits", "1, of equilibria"]]
        return plan.of_scene("reproduce", "joint", out, rows)
    begin = time.perf_counter()
    text, good = command.run(out, say)
    typer.echo(text)
    return plan.ended("reproduce", "joint", begin, good)
