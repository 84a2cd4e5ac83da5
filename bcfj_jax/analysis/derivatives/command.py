"""``bcfj sensitivity``: derivatives of a scene's histories and features, in a folder and in a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax.analysis import plausibility
from bcfj_jax.analysis.derivatives import table
from bcfj_jax.analysis.derivatives.certificate import TRUSTED
from bcfj_jax.analysis.derivatives.names import complete, derivative_unit, feature_unit
from bcfj_jax.analysis.derivatives.sensitivity import Deriving, DerivingKeys, Sensitivity, posed, sensitivity
from bcfj_jax.core.progress import stage
from bcfj_jax.io import outputs, plots, report, second_process
from bcfj_jax.io.growing import COMPLETE, Growing
from bcfj_jax.io.page import BAD, FAIR, GOOD, PLAIN, Page, Picture, Table, Verdict, counted
from bcfj_jax.io.scenefile import load, shown
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import is_reading, unit_of
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.xla.programs import keep_asked
from bcfj_jax.xla.threads import begun

FILES = (
    "sensitivity.csv", "certificate.json", "tornado.png", "histories.png", *report.FILES, "run.toml", "environment.json",
)  # fmt: skip
# How far a result has come: what ``certificate.json`` holds, what is said below its tables, and what is done next.
STEADY, UNCHECKED, BOUNDED = "steady motion, not checked yet", "not checked yet", "bounded"
_NEXT = {
    STEADY: "Not checked yet: the derivatives of the whole run come next.",
    UNCHECKED: "Not checked yet: far tighter solves come next.",
    BOUNDED: "Before the comparison with central differences: {}",
}
_NOW = {
    STEADY: "solving the whole run with derivatives",
    UNCHECKED: "bounding the errors by far tighter solves",
    BOUNDED: "comparing with central differences, for {:g} s at most",
}
# Rows of the report's tables that are not folded.
_MOST_ROWS = 12
Tables = list[tuple[str, list[list[str]]]]


class _Told:
    """What is written and shown of a result as it grows; ``judged`` gives what is not plausible of the run itself."""

    def __init__(
        self, folder: Path, scene: AbstractModel, judged: Callable[[], Sequence[plausibility.Finding]],
        show: Callable[[str], None],
    ) -> None:  # fmt: skip
        self.folder, self.scene, self.judged = folder, scene, judged
        self.growing = Growing(folder / "certificate.json", show)
        self.ends: list[float] = []

    @property
    def doubts(self) -> list[str]:
        """What is said before all else, or nothing."""
        return list(filter(None, [plausibility.headline(self.judged())]))

    def write(self, found: Sensitivity, stage: str) -> Tables:
        """The files; tables as they are shown."""
        ends = [_end(found, name) for name in found.wrt]
        if ends != self.ends and found.derivative:
            write_histories(self.folder / "sensitivity.csv", self.scene, found)
            self.ends = ends
        content = certificate_json(found, self.scene) | {"plausibility": plausibility.content(self.judged())}
        self.growing.write(stage, content)
        return _tables(found, UNCHECKED if stage == UNCHECKED else "")

    def so_far(self, found: Sensitivity) -> str:
        """Write and show what is new; how far the result has come."""
        stage = BOUNDED if found.certificate else UNCHECKED if found.derivative else STEADY
        tables = self.write(found, stage)
        self.growing.tell([*self.doubts, *_driven(found), *_texts(tables)], _NEXT[stage].format(table.said(found)))
        # Drawing comes last; its import would have kept the first answer waiting.
        plots.get_ready()
        return stage

    def at_last(self, found: Sensitivity) -> tuple[str, Tables]:
        """The outcome in words, with tables that the comparison has changed; and all tables."""
        tables = self.write(found, COMPLETE)
        certificate = [("Certificate", table.certificate_rows(found.certificate))] if found.certificate else []
        drives, again = (_driven(found), tables) if self.growing.new(_texts(tables)) else ([], [])
        return "\n\n".join([*self.doubts, *drives, table.said(found), *_texts([*certificate, *again])]), tables


def run(
    what: str, wrt: Sequence[str], wanted: DerivingKeys, out: Path | None, say: Callable[[str], None],
    show: Callable[[str], None],
) -> tuple[str, bool]:  # fmt: skip
    """Differentiate a scene file's run, or a built-in scene's, by parameters; in words, and whether the run ended well.

    ``wanted``: settings of ``sensitivity``, a budget among them; ``out``: the folder, None for one made up; ``say`` receives
    the progress, ``show`` what is known before the result is complete.
    """
    given = shown(load(what))
    params, names = complete(given.scene, given.params, wrt)
    stem = given.source.stem if given.source else what
    folder = outputs.open_folder(out, stem, outputs.Claim("sensitivity", FILES))
    resolved = {**given.resolved, "sensitivity": {"wrt": list(names), **wanted}}
    outputs.write_origin(folder, resolved, f"{what}, every default, SI", outputs.environment(data=given.sources))
    say(f"differentiating {what} by {', '.join(names)}: {len(given.times)} samples to {given.times[-1]:.6g} s")
    plots.load_fonts()

    def judged() -> list[plausibility.Finding]:
        absurd = plausibility.at(given.scene, params, given.times)
        if absurd:
            say(f"warning: {plausibility.headline(absurd)}")
        return absurd

    told = _Told(folder, given.scene, begun(judged), show)

    def so_far(found: Sensitivity) -> None:
        say(_NOW[told.so_far(found)].format(wanted.get("budget")))

    how = DerivingKeys(accuracy=given.accuracy, max_steps=given.max_steps, mode="forward", steady=True, tell=so_far)
    found = sensitivity(given.scene, params, given.times, names, **(wanted | how))
    stats = found.stats
    say(
        f"{counted(int(stats['levels']), 'solve')}, the last of {stats['accepted']} steps, {stats['wall_s']:.2f} s, "
        f"compiled in {stats['compile_s']:.1f} s"
    )
    text, tables = told.at_last(found)
    with stage("drawing"):
        bars = table.tornado(table.ranking(found), folder / "tornado.png")
        drawn = bars, table.bands(found, folder / "histories.png")
    report.write(folder, page(f"Sensitivity of {stem}", found, tables, drawn, told.judged()), given.scene.model_form)
    keep_asked()
    return f"{text}\n\nresults in {folder}", found.status == "ok"


def page(
    title: str, found: Sensitivity, tables: Tables, drawn: tuple[Picture, ...], absurd: Sequence[plausibility.Finding]
) -> Page:
    """The report: which parameter drives which feature, how far the derivatives can be trusted; ``tables`` as on the screen."""
    legend = table.legend(found)
    shown = [_strongest(head.removesuffix(f". {legend}").removesuffix("."), rows, legend) for head, rows in tables]
    if found.certificate:
        note = "Pointwise and averaged: the relative error at most, over the whole run. "
        note += "Tangent growth: how much a small change grows over the run."
        shown.append(
            Table("Certificate of the histories' derivatives", table.certificate_rows(found.certificate), note)
        )
    solver = report.solver_table(found.stats, [["solves", str(found.stats["levels"])]])
    return Page(title, plausibility.judged(absurd, answer(found)), drawn, tables=tuple(shown), folded=(solver,))


def _strongest(title: str, rows: list[list[str]], note: str) -> Table:
    """The table with its strongest rows; the others are folded."""
    most = _MOST_ROWS + 1
    rest = (Table(f"{len(rows) - most} weaker features", [rows[0], *rows[most:]]),) if len(rows) > most + 2 else ()
    return Table(title, rows[:most] if rest else rows, note, rest)


def answer(found: Sensitivity) -> Verdict:
    """Which parameter drives which feature, and whether to trust it."""
    if found.status != "ok":
        return Verdict(BAD, "Failed", table.said(found))
    sentences = table.drivers(found)
    sentence = f"{'; '.join(sentences) or table.unknown(found)}."
    if found.certificate is None:
        return Verdict(PLAIN, "Not certified", f"{sentence} {table.said(found)}")
    known = np.isfinite(table.ranking(found).known).any() or bool(sentences)
    checks = found.certificate.parameters.values()
    verdicts, whole = {check.verdict for check in checks}, not any(check.unchecked for check in checks)
    kind = GOOD if verdicts == {TRUSTED} else FAIR if known else BAD
    word = "Trusted" if kind == GOOD else "Partly trusted" if kind == FAIR else "Not differentiable here"
    return Verdict(kind, word, f"{sentence} {'' if kind == GOOD and whole else table.said(found)}".strip())


def checked(what: str, wrt: Sequence[str], features: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    """Full names of the parameters and the features that ``run`` would take; it raises what ``run`` would raise."""
    given = shown(load(what))
    problem = posed(given.scene, given.params, given.times, wrt, Deriving(features=features))
    return problem.names, [one.name for one in problem.wanted]


def _tables(found: Sensitivity, mark: str) -> Tables:
    """Of the run's features, with a mark in every row, and of those of steady motion."""
    tables = []
    if found.features:
        head = f"Percent change of features per percent change of parameters. {table.legend(found)}".strip()
        tables.append((head, table.ranked_rows(table.ranking(found), found.sampled, mark)))
    if found.steady is not None and table.in_steady(found):
        turn = format_si(found.steady.turn, "s", 4)
        head = f"Percent change per percent change of parameters in steady motion, over one turn of {turn}, whatever the start"
        pending = "" if found.steady.verdicts else UNCHECKED
        tables.append((head, table.ranked_rows(table.ranking(found, of_steady=True), mark=pending)))
    return tables


def _driven(found: Sensitivity) -> list[str]:
    return ["\n".join(table.drivers(found) or [table.unknown(found)])] if found.status == "ok" else []


def _texts(tables: Tables) -> list[str]:
    return [f"{head}\n{report.text(rows)}" for head, rows in tables]


def write_histories(path: Path, scene: AbstractModel, found: Sensitivity) -> None:
    """``sensitivity.csv``: time [s], then d(<contact>.<component>)/d(<parameter>) or d(<reading>)/d(<parameter>).

    In the reading's SI unit, a force's [N], per the parameter's.
    What the certificate calls not differentiable is left out from where it breaks down.
    """
    header, columns = ["time [s]"], [found.times]
    for name in found.wrt:
        for contact, slope in outputs.channels(found.derivative[name], 1).items():
            parts = [contact] if is_reading(contact) else [f"{contact}.{part}" for part in outputs.COMPONENTS]
            unit = derivative_unit(unit_of(parts[0]), scene.quantities[name].unit)
            header += [f"d({part})/d({name}) [{unit}]" for part in parts]
            columns += list(np.where(found.times < _end(found, name), slope.T, np.nan))[: len(parts)]
    outputs.write_columns(path, dict(zip(header, columns, strict=True)))
    second_process.finish()


def _end(found: Sensitivity, name: str) -> float:
    """Time up to which a parameter's derivatives mean something."""
    broken = found.certificate.parameters[name].breakdown if found.certificate else float("nan")
    return broken if np.isfinite(broken) else float("inf")


def certificate_json(found: Sensitivity, scene: AbstractModel) -> dict[str, Any]:
    """``certificate.json``: the verdicts, and features with their derivatives."""
    certificate = found.certificate._asdict() if found.certificate else {}
    checks = certificate.pop("parameters", {})
    content: dict[str, Any] = {key: getattr(found, key) for key in ("status", "reason", "failure_time")}
    content |= {"verdict": certificate.pop("verdict", None)}
    content["parameters"] = {
        name: {"value": found.values[name], "unit": scene.quantities[name].unit}
        | (checks[name]._asdict() if name in checks else {})
        for name in found.wrt
    }
    by = found.feature_derivatives
    content["features"] = {
        name: {"value": value, "unit": feature_unit(name), "derivatives": {p: by[p][name] for p in found.wrt}}
        for name, value in found.features.items()
    }
    # Histories of the orbit are long, and for Python.
    steady = found.steady and {k: v for k, v in found.steady._asdict().items() if k not in ("force", "derivative")}
    return content | {"solver": found.stats, "steady": steady} | certificate
