"""Other models of the same data, and experiments that might be made: [[model]] and [[candidate]] of a calibration file.

What may be in them: docs/calibration.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from bcfj_jax import InputError, nearest
from bcfj_jax.io import scenefile, tables
from bcfj_jax.io.units import quantity
from bcfj_jax.mechanism.channels import unit_of
from calibration import instrument
from calibration.fit import Fit, fit, with_errors
from calibration.problem import NUISANCES, Problem, nuisances, units_of
from calibration.problemfile import FreeTable, free_of, options_of
from calibration.selection.apart import with_contacts_apart
from calibration.selection.choice import Choice, choose
from calibration.selection.next_experiment import Candidate, Gain, next_experiment
from calibration.selection.supposed import with_doubts_right
from calibration.uncertainty.intervals import BOUND


class _Model(tables.Table):
    name: str
    scene: dict[str, Any] = {}
    parameters: dict[str, Any] = {}
    free: dict[str, FreeTable] = {}


class _Candidate(tables.Table):
    name: str
    parameters: dict[str, Any] = {}
    observe: dict[str, Any] = {}
    start: Any = 0.0
    end: Any = None
    samples: int | None = pydantic.Field(None, ge=2, le=1_000_000)
    runs: int = pydantic.Field(1, ge=1, le=100)
    instrument: dict[str, Any] = {}


@dataclass(frozen=True)
class Alternative:
    """One model of the data: its name, its problem and the scene file that it stands for."""

    name: str
    problem: Problem
    base: scenefile.SceneFile


@dataclass(frozen=True)
class Outcome:
    """What came of a calibration file: the fit (of the model chosen), what it is of, the choice and the candidates."""

    fit: Fit
    problem: Problem
    base: scenefile.SceneFile
    choice: Choice | None
    gains: list[Gain]


def solve(path: Path, problem: Problem, base: scenefile.SceneFile, **options: Any) -> Outcome:
    """Fit a calibration file's problem, or its [[model]] tables and choose; then rank its [[candidate]] tables.

    Args:
        problem, base: what it states without its models.
        options: of every fit, as ``fit``: seed, starts, journal, tell; raises as it does.
    """
    rivals = models(path, problem)
    # What is wrong with a candidate is better known before the fit than after it; the chosen model may lack one's key.
    candidates(path, rivals[0].problem if rivals else problem)
    choice = choose([(r.name, r.problem) for r in rivals], **options) if rivals else None
    if choice is not None:
        chosen = next(r for r in rivals if r.name == choice.chosen)
        problem, base = chosen.problem, chosen.base
    found = with_errors(problem, choice.fit, options.get("intervals") == BOUND) if choice else fit(problem, **options)
    found = with_doubts_right(problem, with_contacts_apart(problem, found), options.get("starts", 12))
    choice, planned = choice and choice.reported(found), candidates(path, problem)
    return Outcome(found, problem, base, choice, next_experiment(problem, found, planned) if planned else [])


def models(path: Path, problem: Problem) -> list[Alternative]:
    """The [[model]] tables of a calibration file, whose problem without them is given: every model has its experiments."""
    content = tables.read(path)
    entries = enumerate(content.get("model", []), 1)
    found = [_model(tables.validated(_Model, x, str(path), f"model {k}"), content, path, problem) for k, x in entries]
    for name in content.get("free", {}):
        if found and not any(name in {**a.base.scene.quantities, **NUISANCES} for a in found):
            raise InputError(f"{path}: [free.{name}]", "no [[model]] has it", "take it out, or add a model with it")
    return found


def candidates(path: Path, problem: Problem) -> list[Candidate]:
    """The [[candidate]] tables of a calibration file; of one with [[model]], the problem is the chosen one's."""
    found = []
    for k, table in enumerate(tables.read(path).get("candidate", []), 1):
        entry = tables.validated(_Candidate, table, str(path), f"candidate {k}")
        found.append(_candidate(entry, f"{path}: [[candidate]] {k}", problem))
    return found


def _model(entry: _Model, content: dict[str, Any], path: Path, problem: Problem) -> Alternative:
    where = f"{path}: [[model]] '{entry.name}'"
    named = content["scene"]
    own = {name for e in problem.experiments for name in e.fixed} | {f.name for f in problem.free}
    built_in = {"scene": {"kind": named, **options_of(named, own)}}
    table = tables.read(path.parent / named) if named.endswith(".toml") else built_in
    options = {**table["scene"], **entry.scene}
    model = scenefile.model({**table, "scene": options}, where)
    known = model.quantities
    # What the scene file gives a law that this model does not have is left out; what the model gives must be known.
    given = {name: value for name, value in table.get("parameters", {}).items() if model.canonical(name) in known}
    base = scenefile.from_table({**table, "scene": options, "parameters": {**given, **entry.parameters}}, Path(where))
    every = {**known, **nuisances(problem.observed)}
    set_here = {model.canonical(name) for name in entry.parameters}
    free = {f.name: f for f in problem.free if f.name in every and f.name not in set_here}
    for name, own in ((model.canonical(name), own) for name, own in entry.free.items()):
        if name not in every:
            raise InputError(f"{where} free.{name}", f"no parameter '{name}'", nearest(name, known))
        free[name] = free_of(name, own, path, every)
    params = {name: float(value) for name, value in base.params.items()}
    changed = {"scene": base.scene, "params": params, "tolerances": dict(base.tolerances)}
    return Alternative(entry.name, replace(problem, free=tuple(free.values()), where=where, **changed), base)


def _candidate(entry: _Candidate, where: str, problem: Problem) -> Candidate:
    for key in ("observe", "end", "samples"):
        if getattr(entry, key) in ({}, None) and not (entry.instrument and not entry.observe):
            raise InputError(f"{where} {key}", f"the key '{key}' is missing", "it must be given of an experiment")
    observed = {c.observes: c for e in problem.experiments for c in e.channels}
    for name in observed:
        instrument.stated(entry.instrument, name, observed, f"{where} instrument")
    if not entry.observe:
        return Candidate(entry.name, np.zeros(0), {}, instrument=entry.instrument)
    fixed, quantities = {}, problem.quantities
    for name, value in ((problem.scene.canonical(name), value) for name, value in entry.parameters.items()):
        if name not in quantities:
            raise InputError(f"{where} parameters", f"no parameter '{name}'", nearest(name, quantities))
        fixed[name] = quantity(value, quantities[name].unit, f"{where} parameters.{name}")
    shares = {isinstance(v, str) and v.strip().endswith("%") for v in entry.observe.values()}
    if len(shares) > 1:
        mixed = f"noise in % and in {' and '.join(units_of(entry.observe))}"
        raise InputError(f"{where} observe", mixed, "give one or the other for all channels")
    share = shares.pop()
    units = {name: "1" if share else unit_of(name) for name in entry.observe}
    noise = {name: quantity(value, units[name], f"{where} observe") for name, value in entry.observe.items()}
    first, last = (quantity(v, "s", f"{where} {key}") for key, v in (("start", entry.start), ("end", entry.end)))
    if not first < last:
        raise InputError(f"{where} end", f"{last:g} s is not after the start, {first:g} s", "give a later end")
    clock = np.linspace(first, last, entry.samples or 2)
    return Candidate(entry.name, clock, noise, fixed, share, entry.runs, entry.instrument)
