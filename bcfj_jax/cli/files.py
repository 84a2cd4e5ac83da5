"""Verbs about files: validate, schema, init, report; and about the installation: verify, doctor."""

from __future__ import annotations

import enum
import importlib
import json
from pathlib import Path
from typing import Annotated, Any

import typer

from bcfj_jax.cli.base import DONE, FAILED, app, ready, result, say, verb
from bcfj_jax.cli.options import Code, split
from bcfj_jax.core.errors import InputError


@verb(app, example="bcfj validate examples/chung_ooi_fit.toml")
def validate(
    file: Annotated[Path, typer.Argument(help="A scene, calibration, study or design file.")], code: Code = None
) -> int:
    """Check a file and say what it holds; nothing is run, and nothing is written."""
    ready(code, file)
    from bcfj_jax.io import scenefile, tables

    content = tables.read(file)
    if "experiment" in content or "free" in content:
        from bcfj_jax.io.page import counted
        from calibration import problemfile

        problem = problemfile.load(file)
        free, records = ", ".join(f.name for f in problem.free), counted(len(problem.experiments), "record")
        kind, text = "calibration", f"a calibration of {free} from {records}, of the scene '{problem.scene.kind}'"
    elif "objective" in content:
        from bcfj_jax.analysis.designs import command, designfile

        asked = designfile.load(str(file), {})
        command.check(asked)
        kind, text = "design", f"a design: {command.sentence(asked)}, of the scene '{asked.scene.kind}'"
    elif "vary" in content:
        from bcfj_jax.analysis.studies import specification

        study = specification.load(file)
        varied = f"{', '.join(study.names)}: {study.count} points"
        kind, text = "study", f"a study of {varied} of the scene '{study.given.scene.kind}'"
    else:
        given = scenefile.load(file)
        contacts = ", ".join(contact.name for contact in given.scene.contacts) or "none"
        kind, text = "scene", f"a scene '{given.scene.kind}', {len(given.params)} parameters, contacts: {contacts}"
    result({"file": str(file), "kind": kind, "text": text})
    typer.echo(f"{file} is {text}")
    return DONE


# Files that have a schema, and the module that loads them.
_LOADERS = {
    "scene": "bcfj_jax.io.scenefile",
    "calibration": "calibration.problemfile",
    "study": "bcfj_jax.analysis.studies.specification",
    "design": "bcfj_jax.analysis.designs.designfile",
}
Kind = enum.StrEnum("Kind", list(_LOADERS))


@verb(app, example="bcfj schema scene > scene.schema.json")
def schema(kind: Annotated[Kind, typer.Argument(help="The kind of file.")]) -> int:
    """Print the JSON Schema of a file, for editors and programs that write such files."""
    ready(None)
    content = schema_of(kind)
    result(content)
    typer.echo(json.dumps(content, indent=2))
    return DONE


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file."""
    return importlib.import_module(_LOADERS[kind]).schema()


@verb(app, example="bcfj init impact\nbcfj init calibration examples/chung_ooi_test1_curve.csv")
def init(
    what: Annotated[
        str, typer.Argument(metavar="SCENE|calibration", help="A built-in scene's name, mechanism, or calibration.")
    ],
    record: Annotated[Path | None, typer.Argument(help="The measured file, for calibration.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for the file, or the file itself: name.toml."),
    ] = None,
    scene: Annotated[str, typer.Option(help="Of a calibration: impact, bounce or oblique_impact.")] = "",
    mass: Annotated[str | None, typer.Option(help='Of a calibration, if it is known: "0.55 kg".')] = None,
    speed: Annotated[str | None, typer.Option(help='Of a calibration, if it is known: "0.86 m/s".')] = None,
    struck_mass: Annotated[str | None, typer.Option(help='Of the body that is struck: "4.8 kg", or fixed.')] = None,
    table: Annotated[str | None, typer.Option(help="Which table or sheet of a record that holds several.")] = None,
    separator: Annotated[str | None, typer.Option(help="Of a text: comma, semicolon, tab, pipe or blank.")] = None,
    decimal: Annotated[str | None, typer.Option(help='Of a text: "." or ",".')] = None,
    encoding: Annotated[str | None, typer.Option(help='Of a text: "utf-8", "cp1252", "utf-16".')] = None,
    header: Annotated[int | None, typer.Option(help="Line of the columns' names; 0: there are none.")] = None,
    sensitivity: Annotated[
        str | None, typer.Option(help='Of a sensor in volts or charge: "2.3 mV/N", "CH1 = 4 pC/N".')
    ] = None,
    full_scale: Annotated[
        str | None, typer.Option(help='Of a WAV file: what its full scale stands for, "500 N".')
    ] = None,
    rate: Annotated[str | None, typer.Option(help='Of a record that states no clock: "20 kHz".')] = None,
    time: Annotated[
        str | None, typer.Option(help='Column of times, with a unit where it has none: "column 1 (us)".')
    ] = None,
    observe: Annotated[str | None, typer.Option(help='Column of readings, likewise: "column 2 (N)".')] = None,
    runs_by: Annotated[
        str | None, typer.Option(help='Column that numbers runs; "columns" or "tables": each is a run.')
    ] = None,
    rows: Annotated[str | None, typer.Option(help='Rows to take: "Sensor = A".')] = None,
    code: Code = None,
) -> int:
    """Write a commented scene file to start from; or, from a measured RECORD, a calibration file."""
    if what == "calibration":
        if record is None:
            raise InputError("init calibration", "no record", "give a measured file: bcfj init calibration drop.csv")
        ready(code)
        from bcfj_jax.data.textfile import Stated
        from calibration import init as proposal
        from calibration.impacts.proposal import Hints

        stated = Stated(separator, decimal, encoding, header, sensitivity, full_scale, rate)
        wanted = proposal.rows_of(rows)
        said = proposal.Said(scene, mass, speed, table, struck_mass, stated, Hints(time, observe, runs_by, wanted))
        return proposal.run(record, out, said, typer.echo)
    if record is not None:
        found = f"{record} after the scene '{what}'"
        raise InputError("init", found, "give one scene, or: bcfj init calibration RECORD")
    ready(None)
    from bcfj_jax.io.outputs import create, placed
    from bcfj_jax.io.scenetemplate import template

    path = placed(out, f"{what}.toml")
    create(path, template(what))
    typer.echo(f"wrote {path}")
    return DONE


@verb(app, example="bcfj simulate impact --out first\nbcfj report first")
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that a command of bcfj has written.")],
    code: Code = None,
) -> int:
    """Write report.html of a result folder again, as this version makes it.

    report.html is replaced, as a whole. No other file is: of a run the pictures in the report are drawn again from its
    CSV files, and a picture file that is missing is written. A run whose scene needs your own code takes --code.
    """
    from bcfj_jax.io.report import kept

    # A folder without results is refused before JAX is imported.
    if not (folder / "summary.json").is_file():
        kept(folder)
    ready(code)
    from bcfj_jax.analysis.simulation.folder import rebuild

    typer.echo(f"report: {rebuild(folder, say)}")
    return DONE


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


@verb(app, example="bcfj export impact --to mujoco --out drop")
def export(
    what: Annotated[
        str,
        typer.Argument(metavar="FIT|SCENE", help="A calibration's folder or fit.json, a scene file or a scene's name."),
    ],
    to: Annotated[str, typer.Option(help="mujoco, adams, exudyn, modelica or chrono.")],
    contact: Annotated[str, typer.Option(help="Of several contacts; by default the first.")] = "",
    mass: Annotated[
        str, typer.Option(help='Effective mass of the drop, where the scene does not say it: "2 kg".')
    ] = "",
    speed: Annotated[str, typer.Option(help='Speed of the drop, likewise: "1.5 m/s".')] = "",
    out: Annotated[Path | None, typer.Option(help="Folder for the file, or the file itself; by default here.")] = None,
    code: Code = None,
) -> int:
    """Write a contact in another simulator's terms: a file that runs there, what is lost, the drop with either law."""
    ready(code, what)
    from bcfj_jax.analysis import export as leaving
    from bcfj_jax.io.outputs import create, placed
    from bcfj_jax.io.report import text

    found = leaving.export(leaving.source(what, contact, mass, speed), to)
    path = placed(out, found.name)
    create(path, found.text)
    shown = leaving.tables(found)
    typer.echo("\n\n".join(text(rows) for rows in shown))
    off = f"; peak or rebound differ by more than {100 * leaving.AGREES:g} %: this law cannot say it"
    typer.echo(f"\nwrote {path}{'' if found.same else off}")
    keys = "before", "after", "terms"
    result({"file": str(path), "same": found.same, **{k: getattr(found, k) for k in keys}, "rows": shown[1]})
    return DONE
