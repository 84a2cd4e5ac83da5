"""The files of one run, and what they say of it: contacts, measured accuracy, what to be warned of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from bcfj_jax.analysis import balance, envelope, features, life, plausibility
from bcfj_jax.analysis.simulation import page, pictures
from bcfj_jax.core.quantities import percent
from bcfj_jax.io import outputs, report, second_process
from bcfj_jax.io.page import Table, counted, model_form
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.channels import Channel, channel
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.mechanism.readings import STATES
from bcfj_jax.solve.measured_error import FACTOR, Accuracy
from bcfj_jax.solve.plan import force_error
from bcfj_jax.solve.simulation import Run
from bcfj_jax.xla.programs import make

# Of peak force times deepest penetration: work that the integral's rounding is.
_ROUNDING = 1e-6
# A contact that is pressed in this share of the samples carries its load where samples show it: bounces between two
# samples are counted in the table, and not warned of.
_CARRIES = 0.5
FILES = ("forces.csv", "contacts.csv", "summary.json", *report.FILES, "run.toml", "environment.json")
# Of contacts, and of what [[read]] asks for.
PICTURES, READINGS = (page.FORCES, page.LOOPS), ("readings.csv", page.READINGS)
# Of forces in the axes of bodies, which are asked for.
FRAMED, WORLD = "forces_in_frames.csv", "world"


def framed(scene: AbstractModel, frames: Sequence[str]) -> tuple[Channel, ...]:
    """The whole force of every contact in the axes of bodies, or "world": its components as readings."""
    return tuple(
        channel(f"{name}.force.{axis}", scene, "" if frame == WORLD else frame, "--frames")
        for frame in dict.fromkeys(frames)
        for name in scene.members
        for axis in "xyz"
    )


def files(given: SceneFile, framed: Sequence[Channel] = ()) -> tuple[str, ...]:
    """Names of the files that ``write`` may leave for a scene file, with forces in frames where they are asked for."""
    drawn, asked = PICTURES if given.scene.contacts else (), READINGS if given.reads else ()
    more = page.VIEWS if given.scene.contacts else ()
    return (*FILES, *drawn, *more, *given.scene.tables, *asked, *([FRAMED] if framed else []))


def verdict(run: Run) -> str:
    """How the run went, in a sentence; when it and the finer run disagree."""
    if run.status == "failed":
        return f"The simulation failed at {format_si(run.failure_time, 's')}: {run.reason}."
    reached, accuracy = f"The simulation reached {format_si(float(run.times[-1]), 's')}", run.accuracy
    if accuracy is not None and np.isfinite(accuracy.agree_until):
        since = format_si(accuracy.agree_until, "s", 4)
        reached += f", but it and the finer run disagree from {since} on, in {accuracy.differs}"
    return f"{reached}." if run.status == "ok" else f"{reached}; {run.status}: {run.reason}."


def measured_errors(accuracy: Accuracy) -> dict[str, dict[str, float]]:
    """By contact its measured errors, fractions: rms and peak of the contact's peak, impulse of its impulse."""
    parts = {"rms": accuracy.rms, "peak": accuracy.peak, "impulse": accuracy.impulse}
    return {name: {part: errors[name] for part, errors in parts.items()} for name in accuracy.rms}


def accuracy_sentences(run: Run) -> list[str]:
    """A line a contact, "seat_ball: asked 1 %, measured 0.3 %" (the worst of its errors); from when on runs disagree."""
    accuracy = run.accuracy
    if accuracy is None:
        return []
    lines = []
    for name, errors in measured_errors(accuracy).items():
        worst = float(np.max(list(errors.values())))
        measured = percent(worst, 2) if np.isfinite(worst) else "unknown"
        lines.append(f"{name}: asked {percent(accuracy.asked, 6)}, measured {measured}")
    if np.isfinite(accuracy.agree_until):
        lines.append(
            f"This run and the same at a tenth of its tolerance agree until {format_si(accuracy.agree_until, 's', 4)}: "
            f"then the force of {accuracy.differs} differs by more than {FACTOR:g} times the error asked for."
        )
    return lines


def share_of_time(times: np.ndarray, state: np.ndarray) -> dict[str, float]:
    """Share of the time, half an interval on either side of a sample, spent in each of ``STATES``, of samples whose state is
    known; NaN where none is.
    """
    gaps = np.diff(times)
    weight = np.where(state >= 0, 0.5 * (np.append(gaps, 0.0) + np.append(0.0, gaps)), 0.0)
    total = weight.sum() if weight.any() else float("nan")
    return {word: float(weight[state == code].sum() / total) for code, word in enumerate(STATES)}


# Of a contact in the summary of a run whose peaks are those of the solver's steps.
RESOLVED_UNITS = {"peak_of_samples": "N", "peak_time": "s", "least": "N", "least_time": "s", "onset": "s"}


def resolved(run: Run) -> dict[str, dict[str, float]]:
    """By contact, members apart, what was found in the solver's steps; nothing where that was not asked for."""
    apart: dict[str, dict[str, float]] = {}
    for name, found in run.extremes.items():
        for key, each in found._asdict().items():
            for member, x in outputs.channels({name: each[None]}).items():
                apart.setdefault(member, {})[key] = float(x[0])
    return apart


def summary(run: Run, turning: bool) -> dict[str, Any]:
    """``summary.json``: status, every contact's features, accuracy, what the solver did, a level that was chosen.

    The period of a scene that is ``turning`` is that of its force history (last two thirds); else that of its contacts.
    """
    penetration, rate, state = (outputs.channels(x) for x in (run.penetration, run.rate, run.state))
    stats, contacts = run.stats, {}
    for name, force in outputs.channels(run.force, 1).items():
        one: dict[str, Any] = features.summary(run.times, force[:, 0], penetration[name], rate[name], turning)
        if turning and run.status != "ok":
            one["period"] = float("nan")
        contacts[name] = one | {page.BETWEEN: len(features.unseen(run.times, penetration[name], rate[name]))}
    # Of a failed run nothing is known as a whole.
    for name, found in resolved(run).items() if run.status != "failed" else ():
        whole = features.of_steps(float(run.times[-1]), found)
        kept = {"period": contacts[name]["period"]} if turning else {}
        more = {key: found[key] for key in RESOLVED_UNITS if key in found}
        contacts[name] |= {"peak_of_samples": contacts[name]["peak"]} | whole | more | kept
    for name, codes in state.items():
        contacts[name]["share_of_time"] = share_of_time(run.times, codes)
    chosen, accuracy, known = {"fidelity": run.choice._asdict()} if run.choice else {}, run.accuracy, {}
    if accuracy is not None:
        of_times = {"from": accuracy.begin, "agree_until": accuracy.agree_until, "differs": accuracy.differs or None}
        units = {"asked": "1", "measured": "1", "from": "s", "agree_until": "s", "wall_s": "s"}
        known = {"asked": accuracy.asked, "measured": measured_errors(accuracy), **of_times}
        known |= {"tolerance": accuracy.tolerance, "wall_s": accuracy.wall_s, "units": units}
    return chosen | {
        "status": run.status, "reason": run.reason, "failure_time": run.failure_time, "contacts": contacts,
        "units": features.UNITS
        | (RESOLVED_UNITS if run.extremes else {})
        | {page.BETWEEN: "1", "share_of_time": "1", "failure_time": "s", "wall_s": "s", "compile_s": "s"},
        **({"accuracy": known} if known else {}),
        "solver": {key: stats[key] for key in ("accepted", "rejected", "tolerance")},
        "wall_s": stats["wall_s"], "compile_s": stats["compile_s"],
    }  # fmt: skip


def resolution_warnings(run: Run) -> list[str]:
    """Contacts that the samples do not resolve, so that peaks and impulses taken from them are wrong."""
    missed, shortest = {}, {}
    rate = outputs.channels(run.rate)
    for name, depth in outputs.channels(run.penetration).items():
        if np.mean(depth > 0) < _CARRIES and (count := len(features.unseen(run.times, depth, rate[name]))):
            missed[name] = count
        edges = np.diff(np.concatenate([[False], depth > 0, [False]]).astype(int))
        lengths = np.flatnonzero(edges < 0) - np.flatnonzero(edges > 0)
        if lengths.size and lengths.min() < pictures.FEW_SAMPLES and run.status == "ok":
            shortest[name] = int(lengths.min())
    found = [] if run.force or run.readings else ["the scene has no contact; name readings in [[read]] tables"]
    more = f"raise [time] samples, or say --samples {10 * (len(run.times) - 1) + 1}"
    if missed:
        count = sum(missed.values())
        one, several = ("1 short contact begins and ends", "it"), (f"{count} short contacts begin and end", "them")
        short, them = one if count == 1 else several
        what = "histories and pictures" if run.extremes else "peak, mean, impulse and work"
        found.append(f"{_several(missed)}: {short} between two samples; {what} do not include {them}; {more}")
    if shortest:
        samples = counted(min(shortest.values()), "sample")
        coarse = "histories and pictures of it" if run.extremes else "its peak, impulse and work"
        found.append(
            f"{_several(shortest)}: the shortest contact has only {samples}, so that {coarse} are coarse; {more}"
        )
    return found


def work_warnings(run: Run) -> list[str]:
    """Contacts whose dissipated work is below 0, and why: no contact makes energy."""
    if run.status != "ok":
        return []
    penetration, given_back, coarse, steps = outputs.channels(run.penetration), [], [], resolved(run)
    for name, force in outputs.channels(run.force, 1).items():
        pushed, depth = np.abs(force[:, 0]), penetration[name]
        work = steps[name]["work"] if steps else float(features.dissipated_work(pushed, depth))
        if work < -_ROUNDING * float(pushed.max() * np.abs(depth).max()):
            # The integral of F dd ends below 0 where less is stored at the end than at the start.
            (given_back if depth[0] > max(depth[-1], 0.0) else coarse).append(name)
    begins = "the run begins with the contact pressed, and the elastic energy that was stored then has come out"
    samples = (
        "which no contact does: the samples do not resolve the force against the penetration: raise [time] samples"
    )
    found = [f"{_several(given_back)}: the dissipated work is below 0: {begins}"] if given_back else []
    # In the solver's steps that is the error of the energy balance, which is judged.
    return found + ([f"{_several(coarse)}: the dissipated work is below 0, {samples}"] if coarse and not steps else [])


def _several(names: Iterable[str]) -> str:
    first, *more = names
    return f"{first} and {len(more)} more" if len(more) > 2 else ", ".join([first, *more])


def input_rows(given: SceneFile) -> list[list[str]]:
    """The scene file for people: a row an option or parameter, with its meaning."""
    resolved: dict[str, Any] = given.resolved
    values, time = resolved["parameters"], resolved["time"]
    return [
        ["", "value", "meaning"],
        *([f"scene: {key}", str(value), ""] for key, value in resolved["scene"].items()),
        *([k, q.text(values[k], 8), q.meaning] for k, q in given.scene.quantities.items() if k in values),
        ["time: end", format_si(time["end"], "s"), ""],
        ["time: samples", str(time["samples"]), ""],
        *([f"accuracy: {key}", str(value), ""] for key, value in resolved["accuracy"].items()),
    ]


def _readings(reads: Sequence[Channel], run: Run) -> dict[str, np.ndarray]:
    """What [[read]] asks for, by heads that hold a unit; a column a member."""
    found: dict[str, np.ndarray] = {}
    for whole in reads:
        values = run.readings[whole.name]
        members = range(values.shape[1]) if values.ndim > 1 else ()
        parts = [(whole._replace(member=k + 1), values[:, k]) for k in members] or [(whole, values)]
        found |= {f"{one.name} [{one.unit}]": column for one, column in parts}
    return found


def _readings_rows(given: SceneFile, run: Run, digits: int = 6) -> list[list[str]]:
    """What [[read]] asks for, for people: least, largest and last value."""
    rows = [["reading", "least", "largest", "at the end"]]
    for head, column in _readings(given.reads, run).items():
        name, _, unit = head.removesuffix("]").rpartition(" [")
        known = column[np.isfinite(column)]
        values = (known.min(), known.max(), column[-1]) if known.size else [float("nan")] * 3
        rows.append([name, *(format_si(float(x), unit, digits) for x in values)])
    return rows


def get_ready(given: SceneFile) -> None:
    """Make the programs that ``write`` and ``draw`` need, before there is a run; of it only the shape matters to them."""
    from bcfj_jax.io.view.animation import animation

    model, params, times = given.scene, given.params, given.times
    # Such a model chooses its level by the run.
    if model.traits.open:
        return
    size = jax.eval_shape(model.initial_state, model.completed(params)).size
    blank = Run(times, {}, {}, {}, {}, "ok", "", float("nan"), {}, trajectory=np.zeros((len(times), size)))
    make(partial(model.whole, params, blank))
    make(partial(balance.of_run, model, params, blank, 1.0))
    make(partial(model.orbits, params, blank))
    make(partial(animation, model, params, blank))


class Written(NamedTuple):
    """What ``write`` has written: the results in words, what to warn of, ``summary.json``, and what is not plausible."""

    text: str
    warnings: list[str]
    content: dict[str, Any]
    absurd: Sequence[plausibility.Finding] = ()


def write(folder: Path, given: SceneFile, run: Run, stem: str, framed: Sequence[Channel] = ()) -> Written:
    """Write the numbers of a run: of ``files`` all but pictures and report, less tables that the level does not have."""
    scene, params = given.scene, given.params
    warnings = resolution_warnings(run) + work_warnings(run) + envelope.warnings(scene, params, run.times)
    warnings += envelope.of_the_start(scene, params, run.times, run.force) + given.scene.warnings(params, run)
    source = str(given.source) if given.source else f"the built-in scene '{stem}'"
    head = f"{source}, as it was run: every default, SI\n{page.choice_sentence(run)}".strip()
    outputs.write_origin(folder, given.resolved, head, outputs.environment(data=given.sources))
    whole, extra = scene.whole(params, run)
    found: dict[str, Any] = {"forces.csv": outputs.force_columns(run), "contacts.csv": outputs.contact_columns(run)}
    found |= {name: _readings(reads, run) for name, reads in ((READINGS[0], given.reads), (FRAMED, framed)) if reads}
    for name, columns in {**found, **extra}.items():
        outputs.write_columns(folder / name, {"time [s]": run.times, **columns})
    judged = balance.of_run(given.scene, given.params, run, force_error(given.accuracy))
    if judged.verdict == balance.MISSED:
        warnings.insert(0, judged.reason)
    absurd = plausibility.of_run(given.scene, given.params, run)
    absurd += plausibility.of_engineers(whole) if not absurd else []
    warnings = [*filter(None, [plausibility.headline(absurd)]), *warnings]
    found = {"balance": judged.content(), "plausibility": plausibility.content(absurd)}
    content = summary(run, given.scene.traits.turning) | found | whole
    if scene.life and run.status == "ok":
        for name, numbers in life.of_run(scene, params, run).items():
            content["contacts"][name] |= numbers
        content["units"] |= features.OF_LIFE
    warnings += filter(None, [whole.get("engineering", {}).get("warning")])
    content |= {"warnings": warnings}
    outputs.write_json(folder / "summary.json", content)
    tables = [page.contact_rows(given.scene, content)] if run.force else []
    if rows := page.quantity_rows(content):
        tables.append(rows)
    if given.reads:
        tables.append(_readings_rows(given, run))
    answer = page.verdict(run, content, absurd)
    said = f"{answer.word}. {answer.sentence} {page.choice_sentence(run)}".strip()
    said = verdict(run) if run.status == "failed" else said
    digits = [f"{page.note(content['contacts'])}All digits: summary.json."] if run.force else []
    text = "\n\n".join([said, *map(report.text, tables), *digits])
    lines = accuracy_sentences(run)
    lines += [f"Model form: {model_form(given.scene.model_form)}"] if lines else []
    accuracy = "".join(f"{line}\n" for line in lines)
    # What is missed stands first.
    balanced = "" if judged.verdict == balance.MISSED else f"{judged.sentence()}\n"
    second_process.finish()
    return Written(f"{text}\n\n{balanced}{accuracy}", warnings, content, absurd)


def draw(folder: Path, given: SceneFile, run: Run, stem: str, written: Written, animations: Sequence[str] = ()) -> None:
    """The pictures of a run, its report, and files with the run in motion (``io.view.export``)."""
    shown = page.drawn(folder, run, given.scene, given.params, given.reads, written.content["contacts"])
    found = page.made(
        f"Simulation of {stem}", page.Ran(run, given.scene, written.content, written.absurd), shown,
        [Table("Input: values and what they mean", input_rows(given))],
        _readings_rows(given, run, 3) if given.reads else (),
    )  # fmt: skip
    from bcfj_jax.io.view import animation, export, fragment

    moving = animation.animation(given.scene, given.params, run, f"Simulation of {stem}")
    if moving is not None:
        found = replace(found, animation=f"<section><h2>In motion</h2>{fragment.fragment(moving)}</section>")
        for name in animations:
            export.write(moving, folder / name)
    report.write(folder, found, given.scene.model_form)
