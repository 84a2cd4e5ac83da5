"""A PEtab 2 problem read as a ``Problem``, for what a scene can take; the rest is refused by name, never ignored."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax import InputError, nearest
from bcfj_jax.analysis.derivatives.names import kind_unit
from bcfj_jax.core.errors import quoted
from bcfj_jax.core.extras import library
from bcfj_jax.io import scenefile
from bcfj_jax.mechanism.channels import is_reading
from calibration.filters import Filter
from calibration.instrument import Limit
from calibration.problem import (
    ADEQUATE,
    NUISANCES,
    OFFSETS,
    OWN,
    Channel,
    Doubt,
    Experiment,
    Free,
    Observation,
    Problem,
)

_TABLES = ("Parameter", "Observable", "Condition", "Experiment", "Measurement", "Mapping")


def load(path: str | Path, scene: str | Path | None = None) -> Problem:
    """The problem in a PEtab YAML file.

    Args:
        scene: a scene file or a built-in scene's name; None: the model file that the YAML names.

    Raises:
        InputError: when PEtab is not installed, a file is missing or broken, or for what no scene can take: priors,
            noise that is not normal, several periods, formulas that are not gain x output + offset.
    """
    path = Path(path)
    v2 = library("petab.v2", str(path), "petab")
    tables, config = _read(v2, path)
    extension = _extension(config)
    models = list((config.model_files or {}).values())
    if scene is None and (len(models) != 1 or models[0].language != "bcfj"):
        found = ", ".join(m.language for m in models) or "none"
        raise InputError(f"{path}: model_files", f"language {found}", "name a scene: load(path, scene)")
    base = scenefile.load(scene if scene is not None else path.parent / str(models[0].location))
    reader = _Reader(path, tables, extension)
    experiments = reader.experiments(False)
    if "held_out" in extension:
        beside = path.parent / extension["held_out"]
        others, other_config = _read(v2, beside)
        experiments += _Reader(beside, others, _extension(other_config)).experiments(True)
    return Problem(
        scene=base.scene,
        params={name: float(value) for name, value in base.params.items()} | reader.fixed,
        experiments=tuple(experiments),
        free=reader.free(),
        accuracy=float(extension.get("accuracy", 0.0)),
        where=str(path),
        loss=extension.get("loss", "linear"),
        adequate=float(extension.get("adequate", ADEQUATE)),
        tolerances=extension.get("tolerances", {}),
        filter=_filter(extension.get("filter", "unknown"), path),
        doubts=tuple(Doubt(*doubt) for doubt in extension.get("doubts", [])),
    )


def _filter(said: Any, path: Path) -> Any:
    """The filter between sensor and record, as our part of the YAML has it."""
    if said in ("none", "unknown"):
        return said
    if not isinstance(said, dict) or not said.keys() <= {*Filter._fields}:
        raise InputError(f"{path}: filter", quoted(said), f"give {', '.join(Filter._fields)}, none or unknown")
    return Filter(**said).checked(f"{path}: filter")


def _read(v2: Any, path: Path) -> tuple[Any, Any]:
    """The tables and the configuration of a YAML file, without its models."""
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        config = v2.ProblemConfig(**content, base_path=path.parent, filepath=path)
        with warnings.catch_warnings():
            # petab 0.8 calls pandas in ways that pandas 3.1 is to drop; that is between the two.
            warnings.simplefilter("ignore", DeprecationWarning)
            tables = {}
            for kind in _TABLES:
                table, files = getattr(v2, f"{kind}Table"), getattr(config, f"{kind.lower()}_files")
                tables[f"{kind.lower()}_tables"] = [table.from_tsv(file, path.parent) for file in files]
        problem = v2.Problem(**tables)
    # pydantic, pandas and YAML each have their own errors; to the user all of them are one thing.
    except Exception as error:
        reason = f"{type(error).__name__}: {error}".replace("\n", " ")[:300]
        raise InputError(str(path), f"cannot be read as PEtab 2 ({reason})", "check it with petablint") from error
    if config.format_version_tuple[0] != 2:
        raise InputError(str(path), f"PEtab version {config.format_version}", "convert it to version 2 with petab1to2")
    return problem, config


def _extension(config: Any) -> dict[str, Any]:
    """Our part of the YAML; a dict in libpetab 0.8, an object in later releases."""
    found = (config.extensions or {}).get("bcfj", {})
    return found if isinstance(found, dict) else found.model_dump()


class _Reader:
    """What one set of tables says, by the names that a scene uses."""

    def __init__(self, path: Path, tables: Any, extension: dict[str, Any]) -> None:
        self.path, self.extension = path, extension
        self.native = {m.petab_id: m.model_id for m in tables.mappings if m.model_id}
        self.titles = {m.petab_id: m.name for m in tables.mappings if m.name and not m.model_id}
        self.rows = {p.id: p for p in tables.parameters}
        self.conditions = {c.id: {x.target_id: x.target_value for x in c.changes} for c in tables.conditions}
        self.observables = {o.id: o for o in tables.observables}
        self.periods = {e.id: e.periods for e in tables.experiments}
        self.measured: dict[str, list[Any]] = {}
        for m in tables.measurements:
            self.measured.setdefault(m.experiment_id or "", []).append(m)
        # What only noise depends on: it is found from the residuals, not searched.
        self.noise = {str(s) for o in tables.observables if o.noise_formula for s in o.noise_formula.free_symbols}
        changes = [change for condition in self.conditions.values() for change in condition.items()]
        self.noise |= {str(s) for target, value in changes if target in self.noise for s in value.free_symbols}
        self._check(changes)

    def _check(self, changes: list[tuple[str, Any]]) -> None:
        for p in self.rows.values():
            if p.estimate and p.prior_distribution is not None and p.prior_distribution.value != "uniform":
                found = f"prior {p.prior_distribution.value}"
                raise InputError(f"{self.path}: parameter {p.id}", found, "take it out: only bounds count here")
        for o in self.observables.values():
            if o.noise_distribution.value != "normal":
                found = f"{o.noise_distribution.value} noise"
                raise InputError(f"{self.path}: observable {o.id}", found, "only normal noise is known here")
        for target, value in changes:
            if not value.is_number and str(value) not in self.rows:
                found = f"'{target}' becomes '{value}'"
                raise InputError(f"{self.path}: condition table", found, "give a number, or one parameter of the table")

    def name(self, label: str) -> str:
        """The scene's name of a PEtab identifier."""
        return self.native.get(label, label)

    def known(self, value: Any) -> float | None:
        """A number in the tables, or None for what is estimated."""
        if value.is_number:
            return float(value)
        row = self.rows.get(str(value))
        return float(row.nominal_value) if row is not None and not row.estimate else None

    @property
    def fixed(self) -> dict[str, float]:
        """Parameters that no experiment changes and that are not estimated."""
        used = {str(value) for changes in self.conditions.values() for value in changes.values()}
        rows = [p for p in self.rows.values() if not p.estimate and p.id not in self.noise | used]
        return {self.name(p.id): float(p.nominal_value) for p in rows if self.name(p.id) not in NUISANCES}

    def free(self) -> tuple[Free, ...]:
        """Estimated parameters: shared ones, and those that every experiment has its own of."""
        scale, start = self.extension.get("scale", {}), self.extension.get("start", {})
        pairs = [pair for changes in self.conditions.values() for pair in changes.items() if pair[0] not in self.noise]
        owner = {str(value): self.name(target) for target, value in pairs}
        found: dict[str, Free] = {}
        for p in self.rows.values():
            if not p.estimate or p.id in self.noise:
                continue
            where, name, each = f"{self.path}: parameter {p.id}", owner.get(p.id, self.name(p.id)), p.id in owner
            # Said only where it is not what holds by default; of one experiment it says nothing.
            usual = name in OWN
            own = each if each != usual and (len(self.measured) > 1 or name not in NUISANCES) else None
            one = Free(name, float(p.lb), float(p.ub), start.get(name), scale.get(name), own)
            if found.setdefault(name, one) != one:
                # Its own bounds go to each experiment: ``_bounds``.
                wide = replace(one, lower=min(one.lower, found[name].lower), upper=max(one.upper, found[name].upper))
                if not each or wide.start != found[name].start or wide.scale != found[name].scale:
                    raise InputError(where, f"'{name}' has several bounds", "give it the same in every experiment")
                found[name] = wide
        return tuple(found.values())

    def _bounds(self, changes: dict[str, Any]) -> dict[str, tuple[float, float]]:
        """Bounds of an experiment's own parameters, where they are not those of all."""
        shared = {f.name: (f.lower, f.upper) for f in self.free()}
        rows = {self.name(t): self.rows[str(v)] for t, v in changes.items() if str(v) in self.rows}
        own = {name: (float(p.lb), float(p.ub)) for name, p in rows.items() if p.estimate and name in shared}
        return {name: bounds for name, bounds in own.items() if bounds != shared[name]}

    def experiments(self, hold_out: bool) -> list[Experiment]:
        """Every experiment that was measured."""
        return [self._experiment(label, rows, hold_out) for label, rows in self.measured.items()]

    def _experiment(self, label: str, rows: list[Any], hold_out: bool) -> Experiment:
        where, periods = f"{self.path}: experiment {label or 'without a name'}", self.periods.get(label, [])
        if len(periods) > 1:
            raise InputError(where, f"{len(periods)} periods", "a scene has one; make an experiment of each")
        if any(m.observable_parameters or m.noise_parameters for m in rows):
            raise InputError(where, "placeholders", "write the parameters into the formulas or the condition table")
        changes: dict[str, Any] = {}
        for condition in periods[0].condition_ids if periods else []:
            changes |= self.conditions[condition]
        values = {self.name(t): self.known(v) for t, v in changes.items() if t not in self.noise}
        fixed = {name: value for name, value in values.items() if value is not None}
        by = {o: [m for m in rows if m.observable_id == o] for o in dict.fromkeys(m.observable_id for m in rows)}
        reads = {o: self._reads(o, fixed) for o in by}
        histories = [o for o in by if is_reading(reads[o])]
        times = np.array(sorted({m.time for o in histories for m in by[o]}))
        channels, features, spans = [], [], set()
        for o, measured in by.items():
            sigma, relative = self._noise(o, changes)
            if o not in histories:
                if sigma is None or relative:
                    raise InputError(f"{self.path}: observable {o}", "its noise is no number", "state it")
                features += [Observation(reads[o], m.measurement, sigma) for m in measured]
                spans |= {m.time for m in measured}
                continue
            read = np.full(times.size, np.nan)
            if len({m.time for m in measured}) < len(measured):
                raise InputError(where, f"'{o}' was measured twice at one time", "average what was repeated")
            read[np.searchsorted(times, [m.time for m in measured])] = [m.measurement for m in measured]
            memory, known = (self._own(key, label).get(reads[o]) for key in ("correlation", "instrument"))
            memory = None if memory == "estimate" else memory or 0.0
            said = {key: Limit(*value) for key, value in (known or {}).items()}
            channels.append(Channel(reads[o], read, sigma, relative, memory, instrument=said))
        if len(spans) > 1:
            raise InputError(where, "features at several times", "give all the time that they were taken over")
        name, span = self.titles.get(label, label or "measurements"), next(iter(spans), None)
        more = {"tolerances": self._own("tolerances_of", label), "bounds": self._bounds(changes)}
        return Experiment(name, times, tuple(channels), hold_out, fixed, where, tuple(features), span, **more)

    def _own(self, key: str, label: str) -> dict[str, Any]:
        """What the extension says of one experiment."""
        return self.extension.get(key, {}).get(label, {})

    def _reads(self, observable: str, fixed: dict[str, float]) -> str:
        """The channel or feature that an observable reads; a gain or offset in its formula goes to ``fixed``."""
        where = f"{self.path}: observable {observable}"
        if observable not in self.observables:
            raise InputError(str(self.path), f"no observable '{observable}'", nearest(observable, self.observables))
        formula = self.observables[observable].formula
        names = {s: self.name(str(s)) for s in formula.free_symbols}
        outputs = [s for s, name in names.items() if is_reading(name) or kind_unit(name.rpartition(".")[2])]
        right = 'write gain * output + force_offset, with the output mapped to "contact.normal" or the like'
        linear = len(outputs) == 1 and formula.is_polynomial(outputs[0])
        factors = formula.as_poly(outputs[0]).all_coeffs() if linear else []
        parts = (("gain", 1.0, ("gain",)), ("force_offset", 0.0, tuple(OFFSETS.values())))
        known = [f.is_number or str(f) in names for f, (_, _, names) in zip(factors, parts, strict=False)]
        if len(factors) != 2 or not all(known):
            raise InputError(where, f"the formula '{formula}'", right)
        for factor, (name, neutral, _) in zip(factors, parts, strict=True):
            if factor.is_number and float(factor) != neutral:
                fixed[name] = float(factor)
        return self.name(str(outputs[0]))

    def _noise(self, observable: str, changes: dict[str, Any]) -> tuple[float | None, float]:
        """Absolute part (None: estimated) and part relative to the reading, of a formula sqrt(a^2 + (b reading)^2)."""
        import sympy

        where, right = f"{self.path}: observable {observable}", "write a number, or sqrt(a^2 + (b * observable)^2)"
        stated = self.observables[observable].noise_formula
        if stated is None:
            raise InputError(where, "no noise formula", right)
        # Exponents come as floats, which no polynomial has.
        formula: Any = sympy.nsimplify(stated, rational=True)
        # What a condition sets may itself be a parameter of the table.
        for _ in range(2):
            values = {s: changes.get(str(s), s) for s in formula.free_symbols}
            formula = formula.subs({s: v if self.known(v) is None else self.known(v) for s, v in values.items()})
        square: Any = (formula**2).expand()
        unknown: list[Any] = list(square.free_symbols)
        if len(unknown) == 1 and str(unknown[0]) in self.rows and square == unknown[0] ** 2:
            return None, 0.0
        readings = [s for s in unknown if str(s) == observable]
        if len(unknown) > len(readings) or (readings and not square.is_polynomial(readings[0])):
            raise InputError(where, f"the noise formula '{formula}'", right)
        if not readings:
            return float(formula), 0.0
        factors = [float(f) for f in square.as_poly(readings[0]).all_coeffs()]
        if len(factors) != 3 or factors[1] != 0 or min(factors) < 0:
            raise InputError(where, f"the noise formula '{formula}'", right)
        return math.sqrt(factors[2]), math.sqrt(factors[0])
