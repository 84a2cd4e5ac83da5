"""What ``bcfj simulate`` leaves behind, and what it says about a run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from bcfj_jax.analysis import envelope, features
from bcfj_jax.io import outputs, plots, report
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.io.units import format_si
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.models.joint.fidelity import resolved
from bcfj_jax.models.joint.observe import whole
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.solve.simulation import Run

FILES = (
    "forces.csv",
    "contacts.csv",
    "summary.json",
    "forces.png",
    "force_penetration.png",
    "report.html",
    "run.toml",
    "environment.json",
)


def files(scene: AbstractModel) -> tuple[str, ...]:
    """Names of the files that ``write`` leaves for a scene."""
    return (*FILES, "resultants.csv") if isinstance(scene, Joint) and scene.in_motion else FILES


def _as_run(scene: AbstractModel, run: Run) -> AbstractModel:
    """The scene at the rung that was chosen for it, if one was."""
    return resolved(scene, run.choice.fidelity) if isinstance(scene, Joint) and run.choice else scene


def choice_sentence(run: Run) -> str:
    """Which rung was chosen for a joint of fidelity "auto", and why; "" where nothing was to be chosen."""
    return f"Fidelity {run.choice.fidelity}: {run.choice.reason}." if run.choice else ""


def verdict(run: Run) -> str:
    """How the run went, in a sentence."""
    if run.status == "ok":
        return f"The simulation reached {format_si(float(run.times[-1]), 's')}."
    return f"The simulation failed at {format_si(run.failure_time, 's')}: {run.reason}."


def resolution_warnings(run: Run) -> list[str]:
    """Contacts that the samples do not resolve, so that peaks and impulses taken from them are wrong."""
    missed, shortest = {}, {}
    penetration, rate = outputs.channels(run.penetration), outputs.channels(run.rate)
    for name, depth in penetration.items():
        missed[name] = len(features.unseen(depth, rate[name]))
        pressed = np.concatenate([[False], depth > 0, [False]]).astype(int)
        lengths = np.flatnonzero(np.diff(pressed) < 0) - np.flatnonzero(np.diff(pressed) > 0)
        if lengths.size and lengths.min() < plots.FEW_SAMPLES and run.status == "ok":
            shortest[name] = int(lengths.min())
    found = []
    missed = {name: count for name, count in missed.items() if count}
    if missed:
        found.append(
            f"{_several(missed)}: contacts that lie between two samples: {sum(missed.values())}; peak, mean, impulse "
            "and work leave them out: raise [time] samples"
        )
    if shortest:
        found.append(
            f"{_several(shortest)}: the shortest contact has {min(shortest.values())} sample(s) only; peak, impulse "
            "and work are coarse: raise [time] samples"
        )
    return found


def _several(names: Iterable[str]) -> str:
    first, *more = names
    return f"{first} and {len(more)} more" if len(more) > 2 else ", ".join([first, *more])


def _contacts(contacts: dict[str, dict[str, float]]) -> list[list[str]]:
    """Rows for people: features down, contacts across; the other way round where there are many."""
    rows = [["", *contacts]]
    for name, unit in features.UNITS.items():
        values = (format_si(contact[name], unit) for contact in contacts.values())
        rows.append([name.replace("_", " "), *values])
    return [list(row) for row in zip(*rows, strict=True)] if len(contacts) > 3 else rows


def _input_rows(given: SceneFile) -> list[list[str]]:
    resolved: dict[str, Any] = given.resolved
    rows = [["", "value", "meaning"]]
    rows += [[f"scene: {key}", str(value), ""] for key, value in resolved["scene"].items()]
    for name, quantity in given.scene.quantities.items():
        if name not in resolved["parameters"]:
            continue
        rows.append([name, quantity.text(resolved["parameters"][name], 8), quantity.meaning])
    rows += [["time: end", format_si(resolved["time"]["end"], "s"), ""]]
    rows += [["time: samples", str(resolved["time"]["samples"]), ""]]
    rows += [[f"accuracy: {key}", str(value), ""] for key, value in resolved["accuracy"].items()]
    return rows


def write(folder: Path, given: SceneFile, run: Run, stem: str) -> tuple[str, list[str]]:
    """Write every one of ``files``.

    Returns:
        The results as a text table, and what to warn of.
    """
    summary, warnings = outputs.summary(run), resolution_warnings(run)
    warnings += envelope.warnings(given.scene, given.params, run.times)
    warnings += envelope.of_the_start(given.scene, given.params, run.times, run.force)
    source = str(given.source) if given.source else f"the built-in scene '{stem}'"
    head = f"{source}, as it was run: every default, SI\n{choice_sentence(run)}".strip()
    outputs.write_toml(folder / "run.toml", given.resolved, head)
    outputs.write_json(folder / "environment.json", outputs.environment(data=[given.source] if given.source else []))
    outputs.write_forces(folder / "forces.csv", run)
    outputs.write_contacts(folder / "contacts.csv", run)
    scene = _as_run(given.scene, run)
    if isinstance(scene, Joint) and scene.in_motion:
        found = jax.device_get(whole(scene, dict(given.params), run.times, run.trajectory))
        outputs.write_resultants(folder / "resultants.csv", run, found.resultants)
        summary |= outputs.joint_summary(run.times, found)
    outputs.write_json(folder / "summary.json", summary | {"warnings": warnings})
    plots.forces(run, folder / "forces.png")
    plots.loops(run, folder / "force_penetration.png")
    rows = _contacts(summary["contacts"])
    tables = [("Contacts", rows), ("Input", _input_rows(given)), ("Solver", report.solver_rows(run.stats))]
    pictures = [folder / "forces.png", folder / "force_penetration.png"]
    said = f"{verdict(run)} {choice_sentence(run)}".strip()
    report.write(folder, f"Simulation of {stem}", said, tables, pictures, warnings)
    return f"{said}\n\n{report.text(rows)}\n", warnings
