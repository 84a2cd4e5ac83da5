"""Scene files: what a TOML file says, checked, in SI, with every default filled in.

    [scene]        kind, the options that the scene's function takes (law, elastic, smoothing, ...), some: [scene.spheres]
    [parameters]   values by name, SI numbers or texts with a unit; "0.55 kg +- 2 %" says how well one is known
    [time]         end, samples; the run starts at 0
    [accuracy]     force_error or level, max_steps and solver, resolved_peaks
    [[read]]       of, frame: readings to keep (``mechanism.channels``)
    [life]         numbers of materials (``mechanism.materials``), of one contact in [life.CONTACT]

A scene of kind "mechanism" lists its parts in further tables (``mechanismfile``).
Without a ``law``, a file that gives ``restitution`` gets the law ``exact``, which delivers it.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import os
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic
from jax import Array

from bcfj_jax.contact import laws, stiffness
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError, clip, one_of
from bcfj_jax.core.quantities import check_order, check_value, scalar
from bcfj_jax.io import changes, mechanismfile, mechanismtables, programmes, tables, usercode
from bcfj_jax.io.scenetemplate import template as template
from bcfj_jax.io.units import quantity, toleranced
from bcfj_jax.mechanism import inputs, materials
from bcfj_jax.mechanism.channels import Channel
from bcfj_jax.mechanism.model import AbstractModel, horizon
from bcfj_jax.mechanism.observed import Observed
from bcfj_jax.models import scenes
from bcfj_jax.solve import named
from bcfj_jax.solve.plan import LEVELS, LONGEST, MAX_STEPS
from bcfj_jax.xla.programs import ask

_DEFAULT_LEVEL = "balanced"


@dataclass(frozen=True)
class SceneFile:
    """A scene ready to run."""

    scene: AbstractModel  # what ``simulate`` takes, with the next two
    params: dict[str, Array]
    times: np.ndarray
    accuracy: str | float  # level, or force error as a fraction of the peak
    resolved: dict[str, Any]  # the file with every default, SI numbers: what ``run.toml`` gets; loads back to the same
    source: Path | None  # the file; None for a built-in scene's defaults
    max_steps: int = MAX_STEPS  # budget of attempted steps
    solver: str | None = None  # by which values are integrated; None: the scene's own
    open: bool = False  # whether the level of the model was left to what runs it
    resolved_peaks: bool = False  # whether peaks are found in the solver's steps, and not in the samples
    reads: tuple[Channel, ...] = ()  # what [[read]] asks for
    # How well parameters are known, SI, where the file says it; read by the calibration
    tolerances: Mapping[str, float] = field(default_factory=dict)

    @property
    def sources(self) -> list[Path]:
        """The file, where there is one."""
        return [self.source] if self.source else []


Pair = tuple[Any, Any]


def _stiffness(modulus: Pair, poisson: Pair, radius: Pair) -> Array:
    return stiffness.sphere_sphere(stiffness.effective_modulus(modulus[0], poisson[0], modulus[1], poisson[1]), *radius)


class Spheres(tables.Table):
    """``[scene.spheres]``: one value a body; a plane is a sphere of infinite radius, and infinitely heavy."""

    radius: list[Any]  # > 0 [m], ``inf`` for a plane
    youngs_modulus: list[Any]  # > 0 [Pa], ``inf`` for a rigid body
    poisson: list[Any]  # Poisson's ratios [-], -1 < nu <= 0.5
    density: list[Any]  # > 0 [kg/m^3]; that of a plane does not matter

    def derived(self, where: str) -> dict[str, float]:
        """Stiffness (4/3) E* sqrt(R), exponent 1.5 and effective mass m1 m2/(m1 + m2) of a Hertz contact."""
        radius = self._pair("radius", "m", where, 0.0, math.inf)
        modulus = self._pair("youngs_modulus", "Pa", where, 0.0, math.inf)
        poisson = self._pair("poisson", "1", where, -1.0, 0.5)
        density = self._pair("density", "kg/m^3", where, 0.0, math.inf)
        for name, pair in (("radius", radius), ("youngs_modulus", modulus)):
            if all(math.isinf(value) for value in pair):
                raise InputError(f"{where} {name}", "both are infinite", "one of the two bodies must have a finite one")
        masses = [4.0 / 3.0 * math.pi * r**3 * rho for r, rho in zip(radius, density, strict=True)]
        heavy = [m for m in masses if math.isfinite(m)]
        if not heavy:
            raise InputError(f"{where} density", "no body has a finite mass", "give at least one a finite density")
        return {
            "stiffness": float(ask("two spheres", _stiffness, (), (modulus, poisson, radius))),
            "exponent": 1.5,
            "mass": 1.0 / sum(1.0 / m for m in heavy),
        }

    def _pair(self, name: str, unit: str, where: str, low: float, high: float) -> Pair:
        place = f"{where} {name}"
        given = getattr(self, name)
        if len(given) != 2:
            raise InputError(place, f"{given} has {len(given)} values", "give a list of two, one a body")
        pair = (quantity(given[0], unit, place), quantity(given[1], unit, place))
        for value in pair:
            # A NaN lies in no range.
            if not low < value <= high:
                bound = "" if math.isinf(high) else f" and <= {high:g}"
                raise InputError(place, f"{value:g} is out of range", f"give values > {low:g}{bound}")
        return pair


class _Time(tables.Table):
    end: tables.Number = None
    samples: int | None = pydantic.Field(default=None, ge=2, le=limits.SAMPLES)
    longest_step: tables.Number = None


class _Accuracy(tables.Table):
    force_error: tables.Number = None
    level: str | None = None
    max_steps: int = pydantic.Field(default=MAX_STEPS, ge=1, le=1_000_000_000)
    solver: str | None = None
    resolved_peaks: bool = False


class _File(tables.Table):
    scene: dict[str, Any]
    parameters: dict[str, Any] = pydantic.Field(default_factory=dict)
    time: _Time = _Time()
    accuracy: _Accuracy = _Accuracy()
    body: list[Any] = pydantic.Field(default_factory=list)
    contact: list[Any] = pydantic.Field(default_factory=list)
    load: list[Any] = pydantic.Field(default_factory=list)
    quantity: dict[str, Any] = pydantic.Field(default_factory=dict)
    read: list[Any] = pydantic.Field(default_factory=list)
    life: dict[str, tables.Number | dict[str, tables.Number]] = pydantic.Field(default_factory=dict)


def schema() -> dict[str, Any]:
    """The JSON Schema of a scene file: of every built-in scene, and of a mechanism's tables."""
    made: Any = pydantic.create_model
    literal: Any = Literal

    def one_of_kinds(models: Mapping[str, type[tables.Table]], what: str) -> list[Any]:
        return [made(f"{kind} {what}", __base__=base, kind=(literal[kind], ...)) for kind, base in models.items()]

    kinds = one_of_kinds({kind: _options(kind) for kind in scenes.SCENES}, "scene")
    kinds += one_of_kinds({mechanismfile.KIND: mechanismtables.SceneTable}, "scene")
    loads = one_of_kinds(mechanismtables.LOAD_TABLES, "load")
    fields: dict[str, Any] = {
        "scene": (typing.Union[tuple(kinds)], ...),  # noqa: UP007
        "parameters": (dict[str, tables.Number], {}),
        "body": (list[mechanismtables.BodyTable], []),
        "contact": (list[mechanismtables.ContactTable], []),
        "load": (list[typing.Union[(*loads, mechanismtables.OwnTable)]], []),
        "quantity": (dict[str, mechanismtables.QuantityTable], {}),
        "read": (list[mechanismtables.ReadTable], []),
    }
    return tables.published(pydantic.create_model("Scene", __base__=_File, **fields), "scene")


def load(what: str | Path) -> SceneFile:
    """A scene file, or the name of a built-in scene, which means its defaults; refuses anything that is not right."""
    return from_table(content(what), None if str(what) in scenes.SCENES else Path(what))


def content(what: str | Path) -> dict[str, Any]:
    """What a scene file says, or the name of a built-in scene stands for, as ``--set`` has changed it; unchecked."""
    path = Path(what)
    if str(what) in scenes.SCENES:
        return changes.applied(str(what), {"scene": {"kind": str(what)}})
    if path.suffix != ".toml" and not os.path.exists(path):
        names = ", ".join(scenes.SCENES)
        remedy = f"give a .toml file or a scene's name: {names}"
        raise InputError(clip(str(what)), "no such file and no such scene", remedy)
    return tables.read(path)


def kind(table: Mapping[str, Any]) -> Any:
    """The kind that a scene file's unchecked content states; "" without."""
    return table["scene"].get("kind", "") if isinstance(table.get("scene"), Mapping) else ""


def from_table(table: Mapping[str, Any], source: Path | None) -> SceneFile:
    """The scene that a file's content describes; errors as ``load``."""
    where = str(source) if source else f"scene '{clip(kind(table))}'"
    table = programmes.resolved(_plain(table), source.parent if source else None, where)
    file = tables.validated(_File, table, where)
    scene, made_of, spheres = _scene(file, where)
    values, tolerances = _values(scene, file.parameters, spheres, where)
    params = scene.parameters(values)
    listed = file.scene.get("kind") == mechanismfile.KIND
    with mechanismfile.placed(table, where) if listed else contextlib.nullcontext():
        scene.check(params, where)
    if listed:
        mechanismfile.refuse_unread(scene, params, file.parameters, where)
    readings, reads = mechanismfile.readings(table, scene, where)
    asked = file.time.end
    end = horizon(scene, params) if asked is None else quantity(asked, "s", f"{where}: [time] end")
    if not (math.isfinite(end) and end > 0):
        raise InputError(f"{where}: [time] end", f"{end:g} s is out of range", "give a time > 0")
    samples = file.time.samples or scene.samples
    accuracy, solver = _accuracy(file.accuracy, where), file.accuracy.solver
    steps, peaks = file.accuracy.max_steps, file.accuracy.resolved_peaks
    longest = file.time.longest_step
    if longest is not None:
        longest = scalar(f"{where}: [time]", LONGEST, longest)
        scene = replace(scene, longest_step=longest)  # pyright: ignore[reportArgumentType]
    if file.life:
        scene = _with_life(scene, file.life, f"{where}: [life]")
    scene = scene.suited(params, end, solver)
    named.check(solver, scene.traits.stiff, f"{where}: [accuracy] ")
    resolved = {
        **made_of,
        "parameters": {name: float(value) for name, value in params.items()},
        "time": {"end": end, "samples": samples, **_said(longest_step=longest)},
        "accuracy": {
            "level" if isinstance(accuracy, str) else "force_error": accuracy,
            "max_steps": steps,
            **_said(solver=solver, resolved_peaks=peaks),
        },
        **_said(read=readings, life=scene.life and materials.listed(scene.life)),
    }
    times = np.linspace(0.0, end, samples)
    levels = scene.choice_options()
    free = bool(levels) and not set(levels) & set(file.scene)
    if peaks and solver == "bdf":
        remedy = "leave the solver out, or take rodas3 or sdirk2"
        raise InputError(f"{where}: [accuracy] resolved_peaks", "with the solver 'bdf'", remedy)
    return SceneFile(scene, params, times, accuracy, resolved, source, steps, solver, free, peaks, reads, tolerances)


def _said(**optional: Any) -> dict[str, Any]:
    return {key: value for key, value in optional.items() if value}


def _with_life(scene: AbstractModel, given: Mapping[str, Any], where: str) -> AbstractModel:

    def plain(name: str, value: Any) -> Any:
        return quantity(value, materials.GIVEN[name], f"{where} {name}") if name in materials.GIVEN else value

    numbers = {
        key: {name: plain(name, x) for name, x in value.items()} if isinstance(value, Mapping) else plain(key, value)
        for key, value in given.items()
    }
    return materials.with_materials(scene, numbers, where)


def _plain(table: Mapping[str, Any]) -> dict[str, Any]:
    """A file's content whose parameters go by their whole names: TOML makes tables of ``seat_ball.stiffness = 1``."""
    own = table.get("parameters")
    return {**table, "parameters": tables.flat(own)} if isinstance(own, Mapping) else dict(table)


def shown(given: SceneFile) -> SceneFile:
    """A scene file whose scene has contacts; where it has none, its [[read]] tables stand in their place."""
    if given.scene.contacts:
        return given
    if not given.reads:
        where = str(given.source) if given.source else f"scene '{given.scene.kind}'"
        remedy = 'say what is to be seen: [[read]] of = "<body>.place.x"'
        raise InputError(where, "has no contact and no reading", remedy)
    return replace(given, scene=Observed(given.scene, given.reads))


def model(table: Mapping[str, Any], where: str = "scene") -> AbstractModel:
    """The model that a file's content describes, whatever its parameters are; errors as ``load``."""
    return _scene(tables.validated(_File, programmes.resolved(_plain(table), None, where), where), where)[0]


def quickest(given: SceneFile) -> SceneFile:
    """A scene file as ``bcfj simulate`` runs it: at ``fast`` the level of the model is chosen, if it was left open, within the
    same 5 %. Derivatives and fits need a model by name, and take the whole one.
    """
    if not (given.open and given.accuracy == "fast"):
        return given
    options = given.scene.choice_options()
    resolved = given.resolved | {"scene": given.resolved["scene"] | options}
    return replace(given, scene=replace(given.scene, **options), resolved=resolved)


def _scene(file: _File, where: str) -> tuple[AbstractModel, dict[str, Any], Spheres | None]:
    """The scene, the tables of its parts with every default, and the spheres that set its parameters."""
    kind, kinds = file.scene.get("kind"), (*scenes.SCENES, mechanismfile.KIND)
    place = f"{where}: [scene]"
    if kind is None:
        raise InputError(f"{place} kind", "the key 'kind' is missing", f"give one of {', '.join(kinds)}")
    one_of(f"{place} kind", "scene", kind, kinds, usercode.hint())
    parts = {name: getattr(file, name) for name in mechanismfile.TABLES}
    if kind == mechanismfile.KIND:
        return *mechanismfile.build({"scene": file.scene, **parts}, where, file.parameters), None
    if given := [name for name, entries in parts.items() if entries]:
        brackets = f"[quantity.{next(iter(file.quantity))}]" if given[0] == "quantity" else f"[[{given[0]}]]"
        remedy = f'say kind = "{mechanismfile.KIND}" to list parts of your own'
        raise InputError(f"{where}: {brackets}", f"the scene '{kind}' has its own parts", remedy)
    checked = tables.validated(_options(kind), file.scene, where, "scene")
    options = {name: value for name, value in checked if name not in ("kind", "spheres")}
    if "law" in options and "law" not in file.scene and "restitution" in file.parameters:
        options["law"] = "exact"
    for name, known in (("law", laws.LAWS), ("elastic", laws.ELASTIC)):
        if options.get(name) is not None:
            one_of(f"{place} {name}", f"such {name}", options[name], known, usercode.hint())
    own = f"scene '{kind}'"
    with tables.placed(lambda said: f"{place} {said.removeprefix(own).strip()}"):
        scene = scenes.make(kind, **options)
    spheres = getattr(checked, "spheres", None)
    if spheres and _elastic_name(scene) != "power":
        found = f"spheres with elastic = '{_elastic_name(scene)}'"
        raise InputError(f"{place} elastic", found, "spheres are in Hertz contact: leave elastic out, or say 'power'")
    # Options that the file gives, as it writes them.
    given_options = {name: file.scene.get(name, value) for name, value in options.items()}
    return scene, {"scene": {"kind": kind} | _resolved_options(scene, given_options)}, spheres


def _resolved_options(scene: AbstractModel, options: Mapping[str, Any]) -> dict[str, Any]:
    """A scene's options as it was made of them; what TOML has no word for (nothing) is left out."""
    found = dict(options)
    if "contacts" in options:
        found["contacts"] = [contact.name for contact in scene.contacts]
    # With several contacts there may be no one elastic part to name: each contact's law has its own.
    if "elastic" in options and len(scene.contacts) == 1:
        found["elastic"] = _elastic_name(scene)
    # Switches that follow from other options unless they are given.
    open_ones = [name for name, value in options.items() if value is None]
    found |= {name: value for name in open_ones if isinstance(value := getattr(scene, name, None), bool)}
    return {name: value for name, value in found.items() if value is not None}


def _elastic_name(scene: AbstractModel) -> str | None:
    part = getattr(scene.contacts[0].law, "elastic", None)
    return next((name for name, known in laws.ELASTIC.items() if type(known) is type(part)), None)


def _options(kind: str) -> type[tables.Table]:
    """The keys of [scene]: the scene function's own keyword arguments."""
    function = scenes.SCENES[kind]
    hints = typing.get_type_hints(function)
    # A function of the user's own may say no type, and give no default.
    fields: dict[str, Any] = {
        name: (hints.get(name, Any), ... if parameter.default is parameter.empty else parameter.default)
        for name, parameter in inspect.signature(function).parameters.items()
    }
    if kind in scenes.OF_SPHERES:
        fields["spheres"] = (Spheres | None, None)
    return pydantic.create_model("Options", __base__=tables.Table, kind=(str, ...), **fields)


def _values(
    scene: AbstractModel, written: Mapping[str, Any], spheres: Spheres | None, where: str
) -> tuple[dict[str, float], dict[str, float]]:
    """Values, and how well they are known where that is said."""
    derived = spheres.derived(f"{where}: [scene.spheres]") if spheres else {}
    known, given = scene.quantities, {}
    for key, value in written.items():
        place, name = f"{where}: [parameters] {key}", scene.canonical(key)
        if name in given:
            raise InputError(place, f"'{name}' is given twice, by two names", "take one of them out")
        if name in derived:
            raise InputError(place, f"'{name}' is given twice", "[scene.spheres] sets it too: take one of them out")
        given |= inputs.named(scene, {key: value}, place)
    values = {name: value for name, value in derived.items() if name in known}
    tolerances: dict[str, float] = {}
    defaults = dict(scene.defaults)
    # Exponents first: the unit of a stiffness depends on its contact's, or else on the shared one.
    for name in sorted(given, key=inputs.exponents_first):
        place = f"{where}: [parameters] {name}"
        power = inputs.exponent(scene, name, values, defaults)
        values[name], tolerance = toleranced(given[name], known[name].unit, place, exponent=power)
        check_value(place, known[name], values[name])
        if tolerance is not None:
            tolerances[name] = tolerance
    check_order(f"{where}: [parameters]", known, {**defaults, **values})
    return values, tolerances


def _accuracy(table: _Accuracy, where: str) -> str | float:
    place = f"{where}: [accuracy]"
    if table.level is not None and table.force_error is not None:
        raise InputError(place, "both level and force_error are given", "give exactly one of them")
    if table.force_error is None:
        level = table.level or _DEFAULT_LEVEL
        one_of(f"{place} level", "level", level, LEVELS)
        return level
    error = quantity(table.force_error, "1", f"{place} force_error")
    if not 1e-9 <= error <= 0.5:
        raise InputError(f"{place} force_error", f"{error:g}", 'give a fraction of the peak from 1e-9 to 0.5, or "1 %"')
    return error
