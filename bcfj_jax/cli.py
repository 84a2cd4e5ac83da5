"""The command ``bcfj``: results to stdout and a folder, progress to stderr, exit codes as documented.

Verbs import what they need when they run, so that help is quick and nothing here pulls in calibration.
"""

from __future__ import annotations

import functools
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from bcfj_jax.core.compile_cache import open_cache
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.progress import Waiting, stage
from bcfj_jax.io.stop import heeded, leave

DONE, BAD_INPUT, SIMULATION_FAILED, INTERRUPTED = 0, 2, 3, 5

_EPILOG = (
    "Exit codes: 0 done, 2 bad input, 3 a simulation failed, 4 the calibration's verdict is neither 'identified' nor "
    "'adequate', "
    "5 interrupted and resumable. Compiled programs are kept per user between runs, in the folder that BCFJ_CACHE "
    "names (BCFJ_CACHE=off keeps none), by default the system's cache folder for bcfj-jax."
)

app = typer.Typer(
    name="bcfj",
    help="Differentiable contact dynamics of the ball-cage flexible joint.",
    epilog=_EPILOG,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

Code = Annotated[
    list[Path] | None,
    typer.Option("--code", help="A Python file of your own whose names the scene may use; can be given again."),
]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results; nothing in it is overwritten.")]


def _log(text: str) -> None:
    typer.echo(text, err=True)


def _unsaid() -> Callable[[logging.LogRecord], bool]:
    """A filter that lets each message pass once: the fits of several models find the same."""
    said: set[str] = set()

    def new(record: logging.LogRecord) -> bool:
        text = record.getMessage()
        return text not in said and not said.add(text)

    return new


def _use(files: list[Path] | None, what: str | Path = "") -> None:
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


def _guarded(verb: Callable[..., int]) -> Callable[..., None]:
    """A verb whose return value is the exit code, and whose bad input is a message instead of a traceback."""

    @functools.wraps(verb)
    def wrapped(*args: object, **options: object) -> None:
        try:
            code = verb(*args, **options)
        except InputError as error:
            _log(f"error: {error}")
            code = BAD_INPUT
        except KeyboardInterrupt:
            _log("interrupted")
            code = INTERRUPTED
        raise typer.Exit(code)

    return wrapped


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
    Waiting.say = _log


@app.command(epilog=_EPILOG)
@_guarded
def simulate(
    scene: Annotated[str, typer.Argument(help="A scene file, or a built-in scene's name for its defaults.")],
    measure_error: Annotated[bool, typer.Option(help="Whether to run once more, finer, to measure the error.")] = True,
    code: Code = None,
    out: Out = None,
) -> int:
    """Run a scene: forces.csv, summary.json with the measured force error, pictures and report.html."""
    _use(code, scene)
    from bcfj_jax.analysis.simulation import command

    good = command.run(scene, out, _log, typer.echo, measure_error)
    return DONE if good else SIMULATION_FAILED


@app.command(epilog=_EPILOG)
@_guarded
def calibrate(
    problem: Annotated[Path, typer.Argument(help="A calibration file.")],
    out: Out = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the starting points.")] = 0,
    starts: Annotated[int, typer.Option(min=4, help="Number of starting points.")] = 12,
    intervals: Annotated[str, typer.Option(help="covariance, profile or posterior.")] = "covariance",
    diagnose: Annotated[
        bool, typer.Option("--diagnose", help="Say what would explain a miss; confirm by fits.")
    ] = False,
    export_petab: Annotated[Path | None, typer.Option(help="Write PEtab 2 tables there instead of fitting.")] = None,
    code: Code = None,
) -> int:
    """Fit parameters to measured forces: fit.json, pictures and report.html.

    Finished starts are kept in DIR/journal.jsonl. After Ctrl-C (exit code 5), or a crash, the same command with the
    same --out goes on from there and finds the same fit; the journal is removed when the fit is written.
    """
    _use(code, problem)
    progress = logging.getLogger("calibration")
    progress.setLevel(logging.INFO)
    handler = logging.StreamHandler(sys.stderr)
    handler.addFilter(_unsaid())
    progress.addHandler(handler)
    from calibration import command

    if export_petab is not None:
        return command.export_petab(problem, export_petab)
    return command.run(problem, out, seed, starts, intervals, diagnose)


@app.command(epilog=_EPILOG)
@_guarded
def sensitivity(
    scene: Annotated[str, typer.Argument(help="A scene file, or a built-in scene's name for its defaults.")],
    wrt: Annotated[str, typer.Option(help="Parameters to differentiate by, names separated by commas.")],
    features: Annotated[str, typer.Option(help="Features such as seat_ball.peak; by default every one.")] = "",
    certify: Annotated[bool, typer.Option(help="Whether to say how good the derivatives are.")] = True,
    budget: Annotated[float, typer.Option(min=0.0, help="Seconds for runs to compare the derivatives with.")] = 60.0,
    code: Code = None,
    out: Out = None,
) -> int:
    """Differentiate a run: sensitivity.csv, certificate.json, a ranked table, pictures and report.html."""
    _use(code, scene)
    from bcfj_jax.analysis.derivatives import command

    names, wanted = ([n.strip() for n in text.split(",") if n.strip()] for text in (wrt, features))
    text, good = command.run(scene, names, wanted, certify, budget, out, _log, typer.echo)
    typer.echo(text)
    return DONE if good else SIMULATION_FAILED


@app.command(epilog=_EPILOG)
@_guarded
def tradeoff(
    scene: Annotated[str, typer.Argument(help="A scene file, or a built-in scene's name for its defaults.")],
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
    _use(code, scene)
    from bcfj_jax.analysis.tradeoff import command

    wanted = [name.strip() for name in only.split(",") if name.strip()]
    text, found = command.run(scene, wanted, derivatives, budget, out, _log)
    typer.echo(text)
    return found


@app.command(epilog=_EPILOG)
@_guarded
def reproduce(out: Out = None) -> int:
    """Run the paper's case: its claims beside the model's values, as given and calibrated, with pictures."""
    open_cache()
    from bcfj_jax.reproduction import command

    text, good = command.run(out, _log)
    typer.echo(text)
    return DONE if good else SIMULATION_FAILED


@app.command(epilog=_EPILOG)
@_guarded
def validate(
    file: Annotated[Path, typer.Argument(help="A scene file, a calibration file or a study file.")], code: Code = None
) -> int:
    """Check a file and say what it holds; nothing is run, and nothing is written."""
    _use(code, file)
    from bcfj_jax.io import scenefile, tables

    content = tables.read(file)
    if "experiment" in content or "free" in content:
        from calibration import problemfile

        problem = problemfile.load(file)
        free, records = [f.name for f in problem.free], len(problem.experiments)
        text = f"a calibration of {', '.join(free)} from {records} records, of the scene '{problem.scene.kind}'"
    elif "vary" in content:
        from bcfj_jax.analysis.studies import specification

        study = specification.load(file)
        text = f"a study of {', '.join(study.names)}: {study.count} points of the scene '{study.given.scene.kind}'"
    else:
        given = scenefile.load(file)
        contacts = ", ".join(contact.name for contact in given.scene.contacts) or "none"
        text = f"a scene '{given.scene.kind}', {len(given.params)} parameters, contacts: {contacts}"
    typer.echo(f"{file} is {text}")
    return DONE


@app.command(epilog=_EPILOG)
@_guarded
def init(
    what: Annotated[
        str, typer.Argument(metavar="SCENE|calibration", help="A built-in scene's name, mechanism, or calibration.")
    ],
    record: Annotated[Path | None, typer.Argument(help="The measured file, for calibration.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder for the file; by default this one.")] = None,
    scene: Annotated[str, typer.Option(help="Of a calibration: impact, bounce or oblique_impact.")] = "",
    mass: Annotated[str | None, typer.Option(help='Of a calibration, if it is known: "0.55 kg".')] = None,
    speed: Annotated[str | None, typer.Option(help='Of a calibration, if it is known: "0.86 m/s".')] = None,
    table: Annotated[str | None, typer.Option(help="Which table of a record that holds several.")] = None,
) -> int:
    """Write a commented scene file to start from; or, from a measured RECORD, a calibration file."""
    if what == "calibration":
        if record is None:
            raise InputError("init calibration", "no record", "give a measured file: bcfj init calibration drop.csv")
        from calibration import init as proposal

        return proposal.run(record, out, scene, mass, speed, table, typer.echo)
    if record is not None:
        raise InputError(
            "init", f"{record} after the scene '{what}'", "give one scene, or: bcfj init calibration RECORD"
        )
    from bcfj_jax.io.outputs import open_folder, write_text
    from bcfj_jax.io.scenetemplate import template

    text, name = template(what), f"{what}.toml"
    path = open_folder(out or Path("."), "init", what, [name]) / name
    write_text(path, text)
    typer.echo(f"wrote {path}")
    return DONE


studies = typer.Typer(help="Run a scene at many points of its parameters.", no_args_is_help=True, epilog=_EPILOG)
app.add_typer(studies, name="study")

StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help="A study file, or a built-in study: clearance.")]
StudyOut = Annotated[Path | None, typer.Option("--out", help="Folder of the study; by default results/study-NAME.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Processes on this machine; by default one a core.")]
Others = Annotated[list[Path] | None, typer.Option("--from", help="Another folder of the same study.")]
Dry = Annotated[bool, typer.Option("--dry-run", help="Count points, estimate time and disk; no more.")]
Scheduler = Annotated[str | None, typer.Option(help="Dask scheduler that shall do the work: tcp://HOST:PORT.")]


def _study(
    study: str, files: list[Path] | None, out: Path | None, workers: int | None, scheduler: str | None, dry: bool,
    resuming: bool,
) -> int:  # fmt: skip
    _use(files, study)
    from bcfj_jax.analysis.studies import command

    text, found = command.run(study, out, workers, scheduler, dry, _log, resuming)
    typer.echo(text)
    return found


@studies.command("run", epilog=_EPILOG)
@_guarded
def study_run(
    study: StudyFile, out: StudyOut = None, workers: Workers = None, scheduler: Scheduler = None, dry_run: Dry = False,
    code: Code = None,
) -> int:  # fmt: skip
    """Run a study: results.parquet, study.json, a picture and report.html; goes on with what its folder holds."""
    return _study(study, code, out, workers, scheduler, dry_run, False)


@studies.command("resume", epilog=_EPILOG)
@_guarded
def study_resume(
    study: StudyFile, out: StudyOut = None, workers: Workers = None, scheduler: Scheduler = None, code: Code = None
) -> int:
    """Compute what is missing of a study that was cut off."""
    return _study(study, code, out, workers, scheduler, False, True)


@studies.command("status", epilog=_EPILOG)
@_guarded
def study_status(study: StudyFile, out: StudyOut = None, code: Code = None) -> int:
    """Say what is finished, what failed and what is left (then the exit code is 5)."""
    _use(code, study)
    from bcfj_jax.analysis.studies import command

    text, found = command.status(study, out)
    typer.echo(text)
    return found


@studies.command("merge", epilog=_EPILOG)
@_guarded
def study_merge(study: StudyFile, out: StudyOut = None, other: Others = None, code: Code = None) -> int:
    """Take in blocks that were computed elsewhere, and write results.parquet when none is missing."""
    _use(code, study)
    from bcfj_jax.analysis.studies import command

    text, found = command.merge(study, out, other or [])
    typer.echo(text)
    return found


Features = Annotated[list[str] | None, typer.Option("--feature", help="Such as contact.peak; by default every one.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the bootstrap.")]
Slopes = Annotated[bool, typer.Option(help="Whether to use the study's derivatives, if it kept any.")]


@studies.command("indices", epilog=_EPILOG)
@_guarded
def study_indices(
    study: StudyFile, out: StudyOut = None, feature: Features = None, seed: Seed = 0, code: Code = None
) -> int:
    """Say how much of each feature's variation each parameter brings: a table, indices.json and bars."""
    _use(code, study)
    from bcfj_jax.analysis.studies import indices_command

    text, found = indices_command.run(study, out, feature or [], seed)
    typer.echo(text)
    return found


@studies.command("surface", epilog=_EPILOG)
@_guarded
def study_surface(
    study: StudyFile, out: StudyOut = None, feature: Features = None, derivatives: Slopes = True, code: Code = None
) -> int:
    """Lay a response surface through each feature: its errors, surface.json and a picture a feature."""
    _use(code, study)
    from bcfj_jax.analysis.studies import surface_command

    text, found = surface_command.run(study, out, feature or [], derivatives)
    typer.echo(text)
    return found


def main() -> None:
    """Entry point of the command ``bcfj``. Ctrl-C is heeded from here on: modules that load may swallow it."""
    try:
        with heeded():
            app()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except SystemExit as end:
        leave(end.code if isinstance(end.code, int) else DONE)
        raise
