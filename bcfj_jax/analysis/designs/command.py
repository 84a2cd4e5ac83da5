"""``bcfj design``: a feature made least or most over free parameters, in a folder and in a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bcfj_jax.analysis import plausibility
from bcfj_jax.analysis.designs import result
from bcfj_jax.analysis.designs.api import design, posed
from bcfj_jax.analysis.designs.designfile import Question, load
from bcfj_jax.analysis.designs.result import FAILED, Design
from bcfj_jax.analysis.designs.search import Search
from bcfj_jax.analysis.designs.view import fact_rows, page, reason, value_rows, verdict
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.progress import stage
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.growing import COMPLETE, Growing
from bcfj_jax.io.page import Picture
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
    """Find the design that ``designfile.load`` reads, write and describe it; in words, and whether any start had a value.

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
    growing = Growing(folder / "design.json", show)

    given = asked.scene, asked.given.params, asked.times

    def absurd(found: Design) -> list[plausibility.Finding]:
        """What is not plausible of a design, which is said first."""
        return plausibility.at(asked.scene, {**asked.given.params, **found.values}, asked.times)

    def so_far(found: Design) -> None:
        doubts = absurd(found)
        growing.write(found.status, found.content() | {"plausibility": plausibility.content(doubts)})
        growing.tell([*_doubted(doubts), *_texts(found)], reason(found))

    found = design(*given, asked.objective, asked.free, tell=so_far, **asked.options)
    doubts = absurd(found) if found.status != FAILED else plausibility.at(*given)
    growing.write(COMPLETE, found.content() | {"plausibility": plausibility.content(doubts)})
    drawn: list[Picture] = []
    with stage("drawing"):
        if found.status != FAILED:
            result.draw_starts(found, folder / "starts.png")
            shows = f"The best value of every start so far against its evaluations; {found.agree} of {len(found.starts)} agree."
            drawn.append(Picture("starts.png", "What every start came to", shows))
        if found.slices:
            result.draw_slices(found, folder / "slices.png")
            shows = "The objective along each parameter, the others at the optimum; bounds and tolerances are marked."
            drawn.insert(0, Picture("slices.png", "The objective about the optimum", shows))
    shown = page(f"Design of {stem}", found, asked.note, drawn, doubts)
    report.write(folder, shown, asked.given.scene.model_form)
    keep_asked()
    headline, *tables = _texts(found)
    parts = [*_doubted(doubts), f"{headline} {reason(found)}", *tables, f"results in {folder}"]
    return "\n\n".join(parts), found.status != FAILED


def _doubted(absurd: Sequence[plausibility.Finding]) -> list[str]:
    return [f"At the design that was found {plausibility.headline(absurd)}"] if absurd else []


def _texts(found: Design) -> list[str]:
    """The outcome in a sentence, and its tables."""
    return [verdict(found), *(report.text(rows) for rows in (value_rows(found), fact_rows(found)))]


def check(asked: Question) -> None:
    """Refuse what ``design`` would refuse, before anything is written or compiled."""
    given = asked.scene, asked.given.params, asked.times
    posed(given, asked.objective, asked.free, Search(**asked.options).checked())


def sentence(asked: Question) -> str:
    """The question in a sentence."""
    name = asked.objective if isinstance(asked.objective, str) else " + ".join(asked.objective)
    return f"{'minimizing' if asked.sense == 'minimise' else 'maximizing'} {name} over {', '.join(asked.free)}"
