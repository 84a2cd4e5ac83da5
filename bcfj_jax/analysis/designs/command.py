"""``bcfj design``: a feature made least or most over free parameters, in a folder and in a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bcfj_jax.analysis import plausibility
from bcfj_jax.analysis.designs import result
from bcfj_jax.analysis.designs.api import design, posed
from bcfj_jax.analysis.designs.designfile import Question, load
from bcfj_jax.analysis.designs.result import FAILED, Design, shown, value_rows
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.progress import stage
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.growing import COMPLETE, Growing
from bcfj_jax.io.page import BAD, FAIR, GOOD, Page, Picture, Table, Verdict, brief
from bcfj_jax.xla.programs import keep_asked

FILES = ("design.json", "starts.png", "slices.png", *report.FILES, "run.toml", "environment.json")


def vary(text: str) -> tuple[str, dict[str, Any]]:
    """A free parameter as it is typed: "clearance_seat_cage=10um:200um", or with a tolerance "...=10um:200um:5um"."""
    name, equals, given = (part.strip() for part in text.partition("="))
    ends = [part.strip() for part in given.split(":")]
    if not (name and equals and len(ends) in (2, 3) and all(ends)):
        raise InputError(
            f"--vary {text[:200]}", "this is no NAME=LOWER:UPPER", "write --vary clearance_seat_cage=10um:200um"
        )
    return name, dict(zip(("lower", "upper", "tolerance"), map(_number, ends), strict=False))


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def run(
    what: str, more: Mapping[str, Any], out: Path | None, say: Callable[[str], None], show: Callable[[str], None]
) -> tuple[str, bool]:
    """Find, write and describe the design that ``designfile.load`` reads; in words, and whether any start had a value.

    ``say`` receives the progress, ``show`` what is known before the design is complete.
    """
    asked = load(what, more)
    check(asked)
    stem = Path(what).stem
    folder = outputs.open_folder(out, stem, outputs.Claim("design", FILES))
    source = [p for p in (Path(what), asked.given.source) if p and p.suffix == ".toml"]
    known = outputs.environment(seed=asked.search.seed, data=list(dict.fromkeys(source)))
    outputs.write_origin(folder, asked.resolved, f"{what}, every default, SI", known)
    if asked.note:
        say(asked.note)
    say(f"{sentence(asked)}: {asked.search.starts} starts, {len(asked.times)} times to {asked.times[-1]:.6g} s")
    plots.get_ready()
    growing, params = Growing(folder / "design.json", show), asked.given.params

    def kept(found: Design, stage: str) -> tuple[list[plausibility.Finding], list[str]]:
        """Write a design; what is not plausible of it, or of the given one where there is none, which is said first."""
        doubts = plausibility.at(
            asked.scene, params if found.status == FAILED else {**params, **found.values}, asked.times
        )
        growing.write(stage, found.content() | {"plausibility": plausibility.content(doubts)})
        return doubts, [f"At the design that was found {plausibility.headline(doubts)}"] if doubts else []

    def so_far(found: Design) -> None:
        growing.tell([*kept(found, found.status)[1], *_texts(found)], reason(found))

    found = design(asked.scene, params, asked.times, asked.objective, asked.free, tell=so_far, **vars(asked.search))
    doubts, doubted = kept(found, COMPLETE)
    with stage("drawing"):
        drawn = [result.draw_slices(found, folder / "slices.png")] if found.slices else []
        drawn += [result.draw_starts(found, folder / "starts.png")] if found.status != FAILED else []
    said = page(f"Design of {stem}", found, asked.note, drawn, doubts)
    report.write(folder, said, asked.given.scene.model_form)
    keep_asked()
    headline, *tables = _texts(found)
    parts = [*doubted, f"{headline} {reason(found)}", *tables, f"results in {folder}"]
    return "\n\n".join(parts), found.status != FAILED


def _texts(found: Design) -> list[str]:
    """The outcome in a sentence, and its tables."""
    return [verdict(found), *(report.text(rows) for rows in (value_rows(found), fact_rows(found)))]


def check(asked: Question) -> None:
    """Refuse what ``design`` would refuse, before anything is written or compiled."""
    posed((asked.scene, asked.given.params, asked.times), asked.objective, asked.free, asked.search.checked())


def sentence(asked: Question) -> str:
    """The question in a sentence."""
    name = asked.objective if isinstance(asked.objective, str) else " + ".join(asked.objective)
    return f"{'minimizing' if asked.search.sense == 'minimise' else 'maximizing'} {name} over {', '.join(asked.free)}"


def verdict(found: Design) -> str:
    """The outcome in a sentence."""
    if found.status == FAILED:
        return "No design was found."
    before, after = (brief(x, found.unit) for x in (found.before, found.after))
    state = "" if found.status == "ok" else f" Status: {found.status}."
    return f"{found.objective}: {before} before, {after} after{found.change}.{state}"


def reason(found: Design) -> str:
    """All that is to be said of the outcome, as a sentence."""
    return f"{found.reason[:1].upper()}{found.reason[1:]}."


def page(title: str, found: Design, note: str, drawn: list[Picture], absurd: Sequence[plausibility.Finding]) -> Page:
    """The report: what the objective became, by which values, and how far that is to be trusted."""
    kind = GOOD if found.status == "ok" else BAD if found.status == FAILED else FAIR
    word = "Improved" if found.status == "ok" else found.status[:1].upper() + found.status[1:]
    sentence = verdict(found)
    if found.status != FAILED:
        ends = f"{brief(found.before, found.unit)} to {brief(found.after, found.unit)}"
        quantities = dict(zip(found.space.names, found.space.quantities, strict=True))
        place = ", ".join(
            f"{name} {shown(x, quantities[name]).replace(' u', ' µ')}" for name, x in found.values.items()
        )
        sentence = f"{found.objective} goes from {ends}{found.change}, at {place}."
    answer = plausibility.judged(absurd, Verdict(kind, word, sentence))
    tables = (Table("Design", value_rows(found), reason(found)), Table("Objective", fact_rows(found)))
    rows = [["search", "value"], *([name, f"{value:.4g}"] for name, value in found.stats.items())]
    folded = (Table("Search", rows),)
    return Page(title, answer, tuple(drawn), (note,) if note else (), tables, folded=folded)


def fact_rows(found: Design) -> list[list[str]]:
    """Table of the objective: before, after, the independent check, tolerances."""
    pairs = [(found.objective, found.before, found.after)]
    if (check := found.confirmation) is not None:
        pairs.append((f"checked by the {check.how}", check.before, check.after))
    if (wide := found.robustness) is not None:
        first = found.robustness_before.sampled_worst if found.robustness_before else math.nan
        pairs.append(("worst over the tolerances, by runs", first, wide.sampled_worst))
    rows = ([name, *(brief(x, found.unit) for x in both)] for name, *both in pairs)
    return [["objective", "before", "after"], *rows]
