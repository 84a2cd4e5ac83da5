"""A problem written as PEtab tables, which PEtab's own checks must pass."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.extras import library
from calibration.filters import Filter
from calibration.problem import NEUTRAL, Experiment, Free, Problem, offsets_of, size

FILES = {
    f"{kind}_tables": f"{kind}s.tsv" for kind in ("parameter", "observable", "condition", "experiment", "measurement")
}
FILES["mapping_tables"] = "mapping.tsv"
YAML = "problem.yaml"


def export(problem: Problem, scene: dict[str, Any], folder: Path) -> Path:
    """Write a problem as PEtab 2; held-out records become a problem of their own in ``held_out``.

    Args:
        scene: the scene's file with every default, as ``scenefile.load(...).resolved``.
        folder: where to; made where there is none.

    Returns:
        The YAML file.

    Raises:
        InputError: where PEtab is not installed, or its checks refuse the tables.
    """
    for e in problem.experiments:
        if any(c.jitter for c in e.channels):
            found = f"the noise of {e.name} depends on the slope of its readings"
            raise InputError(str(folder), found, "PEtab has no place for jitter: state the noise without it")
    held_out = any(e.hold_out for e in problem.experiments)
    if held_out:
        _write(problem, True, scene, folder / "held_out", {})
    return _write(problem, False, scene, folder, {"held_out": f"held_out/{YAML}"} if held_out else {})


def _write(problem: Problem, held_out: bool, scene: dict[str, Any], folder: Path, more: dict[str, Any]) -> Path:
    v2 = library("petab.v2", str(folder), "petab")
    experiments = tuple(e for e in problem.experiments if e.hold_out == held_out)
    tables = _tables(v2, problem, experiments, scene)
    for name, file in FILES.items():
        for table in getattr(tables, name):
            table.rel_path = Path(file)
    # PEtab asks every extension for a version, and whether the problem means something else without it.
    ours = {"version": "1.0.0", "required": False} | _extension(problem, experiments) | more
    tables.config = v2.ProblemConfig(filepath=YAML, extensions={"bcfj": ours})
    issues = [i for i in tables.validate() if i.level >= v2.lint.ValidationIssueSeverity.ERROR]
    if issues:
        remedy = "PEtab has no place for it; report it with the problem file"
        raise InputError(str(folder), f"PEtab's checks say: {issues[0].message}", remedy)
    folder.mkdir(parents=True, exist_ok=True)
    tables.to_files(folder)
    return folder / YAML


def _tables(v2: Any, problem: Problem, experiments: tuple[Experiment, ...], scene: dict[str, Any]) -> Any:
    from calibration.petab.model import SceneModel, identifier

    channels = dict.fromkeys(c.observes for e in experiments for c in e.channels)
    features = dict.fromkeys(o.feature for e in experiments for o in e.features)
    relative = {c.observes for e in experiments for c in e.channels if c.relative}
    free = {f.name: f for f in problem.free}
    own = [f.name for f in problem.free if f.per_experiment]
    # What differs between experiments is set by conditions, and then in all of them.
    known = {**NEUTRAL, **problem.params}
    varied = dict.fromkeys([*own, *(name for e in experiments for name in e.fixed)])
    petab = v2.Problem(models=[SceneModel(problem.scene, problem.params, (*channels, *features), scene)])
    for observes in channels:
        output, noise = f"model__{identifier(observes)}", f"noise__{identifier(observes)}"
        formula = f"gain * {output}" if "gain" in {*varied, *free} else output
        formula += "".join(f" + {name}" for name in offsets_of(observes, channels) if name in {*varied, *free})
        # PEtab's library 0.8 prints sqrt(x) as x^1/2 and reads that as x/2.
        share = f"({noise}^2 + (share__{identifier(observes)} * {identifier(observes)})^2)^0.5"
        petab.add_observable(identifier(observes), formula, share if observes in relative else noise, name=observes)
    for feature in features:
        output, noise = f"model__{identifier(feature)}", f"noise__{identifier(feature)}"
        petab.add_observable(identifier(feature), output, noise, name=feature)
    for name in (*channels, *features):
        petab.add_mapping(f"model__{identifier(name)}", name)
    for k, e in enumerate(experiments, 1):
        changes: dict[str, Any] = {}
        for name in varied:
            value = e.fixed.get(name, f"{identifier(name)}__e{k}" if name in own else known.get(name))
            changes |= {} if value is None else {identifier(name): value}
        for c in e.channels:
            at = identifier(c.observes)
            changes[f"noise__{at}"] = f"deviation__{at}" if c.sigma is None else c.sigma
            changes |= {f"share__{at}": c.relative} if c.observes in relative else {}
        changes |= {f"noise__{identifier(o.feature)}": o.sigma for o in e.features}
        petab.add_condition(f"c{k}", **changes)
        petab.add_experiment(f"e{k}", float(min([0.0, *e.times[:1]])), [f"c{k}"])
        petab.add_mapping(f"e{k}", name=e.name)
        _measure(petab, e, f"e{k}", identifier)
        for name in own:
            _add_free(petab, problem, free[name], f"{identifier(name)}__e{k}", e.bounds.get(name))
    for name in dict.fromkeys([*(n for n in free if n not in own), *problem.params]):
        if name in varied:
            continue
        if name in free:
            _add_free(petab, problem, free[name], identifier(name))
        elif np.isfinite(problem.params[name]):
            petab.add_parameter(identifier(name), False, float(problem.params[name]))
    for name in dict.fromkeys([*free, *problem.params, *varied]):
        if identifier(name) != name:
            petab.add_mapping(identifier(name), name)
    every = [c for e in experiments for c in e.channels]
    for observes in dict.fromkeys(c.observes for c in every if c.sigma is None):
        largest = float(max(size(observes, c.values) for c in every if c.observes == observes))
        petab.add_parameter(f"deviation__{identifier(observes)}", True, 1e-2 * largest, 1e-6 * largest, largest)
    return petab


def _measure(petab: Any, experiment: Experiment, label: str, identifier: Any) -> None:
    for channel in experiment.channels:
        output, seen = identifier(channel.observes), np.isfinite(channel.values)
        for time, value in zip(experiment.times[seen].tolist(), channel.values[seen].tolist(), strict=True):
            petab.add_measurement(output, experiment_id=label, time=time, measurement=value)
    for seen in experiment.features:
        end = float(experiment.times[-1]) if experiment.span is None else experiment.span
        petab.add_measurement(identifier(seen.feature), experiment_id=label, time=end, measurement=seen.value)


def _add_free(petab: Any, problem: Problem, f: Free, label: str, own: tuple[float, float] | None = None) -> None:
    lower, upper = own or (f.lower, f.upper)
    nominal = f.start if f.start is not None else {**NEUTRAL, **problem.params}.get(f.name, lower)
    petab.add_parameter(label, True, float(np.clip(nominal, lower, upper)), lower, upper)


def _extension(problem: Problem, experiments: tuple[Experiment, ...]) -> dict[str, Any]:
    """What PEtab has no place for; ``required`` where another tool would compute another objective without it."""
    memory = {
        f"e{k}": {c.observes: "estimate" if c.correlation is None else c.correlation for c in e.channels}
        for k, e in enumerate(experiments, 1)
        if any(c.correlation != 0 for c in e.channels)
    }
    passed = problem.filter._asdict() if isinstance(problem.filter, Filter) else problem.filter
    return {
        "version": "1.0.0",
        "required": problem.loss != "linear" or bool(memory) or isinstance(problem.filter, Filter),
        "loss": problem.loss,
        "accuracy": problem.accuracy,
        "correlation": memory,
        "filter": passed,
        "adequate": problem.adequate,
        "tolerances": dict(problem.tolerances),
        "tolerances_of": {f"e{k}": dict(e.tolerances) for k, e in enumerate(experiments, 1) if e.tolerances},
        "instrument": {
            f"e{k}": {c.observes: {key: list(x) for key, x in c.instrument.items()} for c in e.channels}
            for k, e in enumerate(experiments, 1)
            if any(c.instrument for c in e.channels)
        },
        "doubts": [list(doubt) for doubt in problem.doubts],
        "scale": {f.name: f.scale for f in problem.free if f.scale},
        "start": {f.name: float(f.start) for f in problem.free if f.start is not None},
    }
