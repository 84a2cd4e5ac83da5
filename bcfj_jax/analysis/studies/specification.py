"""Study files: which points of which scene, and what is kept of each; checked, in SI.

scene     a scene file (beside the study file), a built-in scene's name, or a table with a scene file's content
[design]  kind = grid | list | latin_hypercube | sobol; points and seed of the last two
          saltelli: samples, second_order, seed; morris: trajectories, levels, seed (for global sensitivities)
[vary.X]  lower, upper, steps, scale = linear | log | normal; or values. X may be a pattern: "ball_*.oversize"
[results] features, histories, derivatives, steady
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jax import Array

from bcfj_jax.analysis.derivatives.contact_events import check_followed
from bcfj_jax.analysis.derivatives.names import Feature, complete, event, expanded, feature
from bcfj_jax.analysis.derivatives.steady import KINDS as OF_STEADY
from bcfj_jax.analysis.derivatives.steady import check_recurs
from bcfj_jax.analysis.studies.design import DEFAULTS, DRAWN, KINDS, SCALES, Axis, Options, block_length, number, points
from bcfj_jax.core.errors import InputError, clip, nearest
from bcfj_jax.core.programs import program
from bcfj_jax.core.quantities import CATALOGUE, scalar
from bcfj_jax.io import scenefile, tables
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, of_numbers
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.models import scenes

MOST_POINTS = 100_000_000


@dataclass(frozen=True)
class Study:
    """A study ready to run.

    Attributes:
        given: the scene that is varied.
        kind, axes, count, seed, options: the design, as ``design.points``.
        features: what is kept of each point.
        histories: whether forces are kept, too.
        derivatives: parameters by which features are differentiated.
        steady: whether features are those of the steady motion (``derivatives.steady``).
        own_end: whether each point runs to the horizon of its own parameters.
        resolved: the study with every default, SI: a study file itself.
    """

    given: SceneFile
    kind: str
    axes: tuple[Axis, ...]
    count: int
    seed: int
    features: tuple[Feature, ...]
    histories: bool
    derivatives: tuple[str, ...]
    own_end: bool
    resolved: dict[str, Any]
    options: Options = DEFAULTS
    steady: bool = False

    @cached_property
    def points(self) -> np.ndarray:
        """(N, D) values of the varied parameters."""
        return points(self.kind, self.axes, self.count, self.seed, self.options)

    @cached_property
    def ends(self) -> np.ndarray:
        """(N,) last time of each point's run [s]."""
        if not self.own_end:
            return np.full(self.count, self.given.times[-1])
        arguments = (self.params(self.points),)
        return program("study ends", _ends, (self.given.scene,), arguments)[0](*arguments)

    @property
    def names(self) -> tuple[str, ...]:
        """The varied parameters."""
        return tuple(axis.name for axis in self.axes)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of what is computed: features, then d(feature)/d(parameter)."""
        slopes = (f"d({f.name})/d({p})" for f in self.features for p in self.derivatives)
        return (*(f.name for f in self.features), *slopes)

    def params(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Parameters of points (n, D): leaves (n,), those that do not vary too."""
        fixed = {name: np.full(len(values), float(value)) for name, value in self.given.params.items()}
        return fixed | {name: values[:, k].astype(float) for k, name in enumerate(self.names)}


def _ends(scene: AbstractModel, params: dict) -> Array:
    return jax.vmap(lambda p: jnp.asarray(scene.horizon(p), float))(params)


class _Design(tables.Table):
    kind: str = "grid"
    points: int | None = pydantic.Field(default=None, ge=1, le=MOST_POINTS)
    samples: int | None = pydantic.Field(default=None, ge=1, le=MOST_POINTS)
    second_order: bool | None = None
    trajectories: int | None = pydantic.Field(default=None, ge=1, le=MOST_POINTS)
    levels: int | None = pydantic.Field(default=None, ge=2, le=1000)
    seed: int = pydantic.Field(default=0, ge=0)


class _Axis(tables.Table):
    lower: tables.Number = None
    upper: tables.Number = None
    steps: int | None = pydantic.Field(default=None, ge=1, le=MOST_POINTS)
    scale: str = "linear"
    values: list[Any] | None = None


class _Results(tables.Table):
    features: list[str] | None = None
    histories: bool = False
    derivatives: list[str] = pydantic.Field(default_factory=list)
    steady: bool = False


class _File(tables.Table):
    scene: Any
    design: _Design = _Design()
    vary: dict[str, _Axis]
    results: _Results = _Results()


def schema() -> dict[str, Any]:
    """The JSON Schema of a study file."""
    return tables.published(_File, "study")


def load(path: Path) -> Study:
    """A study file; errors as ``from_table``, and for a file that is missing or no TOML."""
    return from_table(tables.read(path), str(path), path.parent)


def from_table(table: Mapping[str, Any], where: str = "study", beside: Path = Path(".")) -> Study:
    """The study that a file's content describes.

    Args:
        table: the content.
        where: the file, for messages.
        beside: folder in which a scene file is sought.

    Raises:
        InputError: for anything that is not right, naming the key and what would be.
    """
    table = dict(table)
    if isinstance(table.get("vary"), Mapping):
        table["vary"] = tables.nested(table["vary"], _Axis)
    file = tables.validated(_File, table, where)
    given, own_end = _scene(file.scene, where, beside)
    of_numbers(given.scene)
    kind = file.design.kind
    if kind not in KINDS:
        raise InputError(f"{where}: [design] kind", f"no design '{kind}'", nearest(kind, KINDS))
    drawn, size = kind in DRAWN, _size(file.design, where)
    if not file.vary:
        raise InputError(f"{where}: [vary]", "nothing is varied", f"vary one of {', '.join(given.scene.quantities)}")
    varied = _spread(given, file.vary, where)
    axes = tuple(_axis(given, name, one, kind, where) for name, one in varied.items())
    if len({axis.name for axis in axes}) < len(axes):
        raise InputError(f"{where}: [vary]", "one parameter is varied twice, under two names", "remove one of them")
    if kind == "list" and len({axis.steps for axis in axes}) > 1:
        found = ", ".join(f"{axis.name}: {axis.steps}" for axis in axes)
        raise InputError(
            f"{where}: [vary]", f"lists of different lengths: {found}", "give every parameter the same number of values"
        )
    options = Options(file.design.second_order or False, file.design.levels or DEFAULTS.levels)
    count = number(kind, axes, block_length(kind, len(axes), options) * size)
    if count > MOST_POINTS:
        raise InputError(f"{where}: [vary]", f"{count} points", f"a study has at most {MOST_POINTS}")
    wanted = file.results.features
    if wanted is None:
        # What is read of a scene without contacts has either sign.
        what, given = "peak" if given.scene.contacts else "largest", scenefile.shown(given)
        wanted = [f"{name}.{what}" for name in given.scene.members]
    if len(set(wanted)) < len(wanted):
        twice = next(name for name in wanted if wanted.count(name) > 1)
        raise InputError(f"{where}: [results] features", f"'{twice}' is listed twice", "name it once")
    slopes = tuple(file.results.derivatives)
    try:
        given = replace(given, scene=observing(given.scene, wanted))
        features = tuple(feature(name, given.scene.members) for name in wanted)
        if any(event(one.kind) for one in features):
            check_followed(given.scene)
        if slopes:
            complete(given.scene, given.params, slopes)
        if file.results.steady:
            _steady(given, features, file.results.histories)
    except InputError as error:
        raise InputError(f"{where}: [results] {error.where}", error.found, error.remedy) from None
    resolved = {
        "scene": _inline(given, own_end),
        "design": {"kind": kind, "seed": file.design.seed} | _resolved_design(kind, size, options),
        "vary": {axis.name: _resolved(axis, drawn) for axis in axes},
        "results": {
            "features": [f.name for f in features], "histories": file.results.histories, "derivatives": list(slopes),
            "steady": file.results.steady,
        },
    }  # fmt: skip
    return Study(
        given,
        kind,
        axes,
        count,
        file.design.seed,
        features,
        file.results.histories,
        slopes,
        own_end,
        resolved,
        options,
        file.results.steady,
    )


def _steady(given: SceneFile, features: Sequence[Feature], histories: bool) -> None:
    """Refuse what a study of steady motion cannot have."""
    check_recurs(given.scene, given.params)
    if given.solver is not None:
        raise InputError("steady", f"with the solver '{given.solver}'", "leave the solver out")
    if histories:
        raise InputError("histories", "with steady = true", "say histories = false: a turn's forces are not kept")
    for one in features:
        if one.kind not in OF_STEADY:
            raise InputError(f"feature '{one.name}'", "is none of steady motion", f"take {', '.join(OF_STEADY)}")


# What says how large a design is, and what else it may say.
_SIZES = {"latin_hypercube": "points", "sobol": "points", "saltelli": "samples", "morris": "trajectories"}
_OPTIONS = {"saltelli": "second_order", "morris": "levels"}


def _size(design: _Design, where: str) -> int:
    """How many points, base samples or trajectories; 0 for a design that its axes make."""
    kind = design.kind
    own = _SIZES.get(kind)
    for key in ("points", "samples", "trajectories", "second_order", "levels"):
        if getattr(design, key) is None or key in (own, _OPTIONS.get(kind)):
            continue
        found = (
            f"a {kind} gets its number of points from its axes"
            if key == "points" and own is None
            else f"no key of a {kind}"
        )
        remedy = f"say {own}" if own and key in _SIZES.values() else "take it out"
        raise InputError(f"{where}: [design] {key}", found, remedy)
    if own is None:
        return 0
    if getattr(design, own) is None:
        raise InputError(f"{where}: [design] {own}", f"missing for {kind}", f"give the number of {own}")
    if design.levels is not None and design.levels % 2:
        raise InputError(f"{where}: [design] levels", f"{design.levels} is odd", "give an even number (Morris 1991)")
    return getattr(design, own)


def _resolved_design(kind: str, size: int, options: Options) -> dict[str, Any]:
    sized = {_SIZES[kind]: size} if kind in _SIZES else {}
    return sized | ({_OPTIONS[kind]: getattr(options, _OPTIONS[kind])} if kind in _OPTIONS else {})


def _scene(scene: Any, where: str, beside: Path) -> tuple[SceneFile, bool]:
    """The scene, and whether it leaves the end to each point's parameters."""
    if isinstance(scene, Mapping):
        if "scene" not in scene:
            found = "has a kind, as in a scene file" if "kind" in scene else "has no table scene"
            remedy = "write [scene.scene], [scene.parameters] and so on, or scene = with a file or a name"
            raise InputError(f"{where}: [scene]", found, remedy)
        try:
            table, given = scene, scenefile.from_table(scene, None)
        except InputError as error:
            raise InputError(f"{where}: {error.where}", error.found, error.remedy) from None
    elif isinstance(scene, str):
        path = beside / scene
        found = path if scene.endswith(".toml") and os.path.exists(path) else scene
        if scene not in scenes.SCENES and not os.path.exists(found):
            hint = nearest(scene, scenes.SCENES)
            raise InputError(f"{where}: scene", f"no file and no scene '{clip(scene)}'", f"{hint} Or give a .toml file")
        given = scenefile.load(found)
        table = tables.read(Path(found)) if given.source else {}
    else:
        raise InputError(f"{where}: scene", clip(scene), "give a scene file, or the name of a built-in scene")
    return given, "end" not in table.get("time", {})


def _inline(given: SceneFile, own_end: bool) -> dict[str, Any]:
    time = {k: v for k, v in given.resolved["time"].items() if not (own_end and k == "end")}
    return {**given.resolved, "time": time}


def _resolved(axis: Axis, drawn: bool) -> dict[str, Any]:
    if axis.values is not None:
        return {"values": list(axis.values)}
    bounds = {"lower": axis.lower, "upper": axis.upper, "scale": axis.scale}
    return bounds if drawn else bounds | {"steps": axis.steps}


def _spread(given: SceneFile, vary: Mapping[str, _Axis], where: str) -> dict[str, _Axis]:
    """The varied parameters, in which a pattern (``ball_*.oversize``) stands for every one that has a value here.

    Raises:
        InputError: for a pattern that stands for nothing, or for a parameter that is named besides.
    """
    found: dict[str, _Axis] = {}
    for name, one in vary.items():
        place = f"{where}: [vary.{name}]"
        try:
            names = expanded(given.scene, given.params, (name,)) if set(name) & set("*?[") else (name,)
        except InputError as error:
            raise InputError(place, error.found, error.remedy) from None
        if twice := [each for each in names if each in found]:
            raise InputError(place, f"'{twice[0]}' is varied twice", "remove one of them")
        found |= dict.fromkeys(names, one)
    return found


def _axis(given: SceneFile, name: str, table: _Axis, kind: str, where: str) -> Axis:
    place, known = f"{where}: [vary.{name}]", given.scene.quantities
    name = given.scene.canonical(name)
    if name not in known:
        hint = f"known here: {', '.join(sorted(known))}" if name in CATALOGUE else nearest(name, known)
        raise InputError(place, f"scene '{given.scene.kind}' has no parameter '{name}'", hint)
    if table.scale not in SCALES:
        raise InputError(f"{place} scale", f"no scale '{table.scale}'", nearest(table.scale, SCALES))
    drawn = kind in DRAWN
    bounded = table.lower is not None or table.upper is not None
    if table.values is not None:
        if bounded or table.steps is not None:
            raise InputError(place, "values and bounds are both given", "give one of them")
        if drawn:
            raise InputError(f"{place} values", f"a {kind} draws between bounds", "give lower and upper")
        if not table.values:
            raise InputError(f"{place} values", "is empty", "give one value or more")
        values = tuple(_value(given, name, x, f"{place} values") for x in table.values)
        return Axis(name, values, min(values), max(values), "linear", len(values))
    if table.lower is None or table.upper is None:
        raise InputError(place, "no bounds", "give lower and upper, or values")
    if kind == "list":
        raise InputError(place, "a list needs values", "give values = [...]")
    if drawn and table.steps is not None:
        raise InputError(f"{place} steps", f"a {kind} has no steps", f"say [design] {_SIZES[kind]} in place of it")
    if not drawn and table.steps is None:
        raise InputError(f"{place} steps", "missing", "give the number of values of the grid")
    lower, upper = (_value(given, name, getattr(table, end), f"{place} {end}") for end in ("lower", "upper"))
    if not lower < upper:
        raise InputError(place, f"lower = {lower:g} is not below upper = {upper:g}", "give lower < upper")
    if table.scale == "log" and lower <= 0:
        raise InputError(f"{place} lower", f"{lower:g} on a log scale", "give a lower bound > 0")
    return Axis(name, None, lower, upper, table.scale, table.steps or 0)


def _value(given: SceneFile, name: str, value: Any, place: str) -> float:
    power = inputs.exponent(given.scene, name, given.params)
    return scalar(place, given.scene.quantities[name], value, power)
