"""Studies: where their points are, the same for the same seed; study files, checked, in SI (docs/studies.md)."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
from jax import Array

from bcfj_jax.analysis.axes import SCALES, Axis, bounded
from bcfj_jax.analysis.derivatives.contact_events import check_followed
from bcfj_jax.analysis.derivatives.names import Feature, complete, event, expanded, feature
from bcfj_jax.analysis.derivatives.steady import check_recurs
from bcfj_jax.analysis.engine import columns
from bcfj_jax.analysis.features import OF_TURN
from bcfj_jax.core.errors import InputError, clip, nearest
from bcfj_jax.core.extras import library
from bcfj_jax.core.quantities import CATALOGUE, scalar
from bcfj_jax.io import scenefile, tables
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.model import AbstractModel, of_numbers
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.models import scenes
from bcfj_jax.xla.programs import program

MOST_POINTS = 100_000_000


class Kind(NamedTuple):
    """A kind of design: the keys in a study file of its size ("" where its axes make it) and of what it alone has; what an
    estimator of sensitivity indices needs whole, how many of these at least, and the method ("" where there are no indices).
    """

    size: str = ""
    option: str = ""
    parts: str = "points"
    fewest: int = 0
    method: str = ""


# Fewest: of Saltelli's blocks enough for a bootstrap, of trajectories as many as Morris used (Campolongo: 10), of points
# several for each of RBD-FAST's 10 harmonics.
KINDS = {
    "grid": Kind(),
    "list": Kind(),
    "latin_hypercube": Kind("points", fewest=100, method="RBD-FAST, PAWN"),
    "sobol": Kind("points", fewest=100, method="RBD-FAST, PAWN"),
    "saltelli": Kind("samples", "second_order", "blocks", 32, "Sobol"),
    "morris": Kind("trajectories", "levels", "trajectories", 4, "Morris"),
}


def needs(name: str) -> Any:
    """A module of a library that studies alone need; an ``InputError`` where it is not installed."""
    return library(name, "bcfj study", "study")


@dataclass(frozen=True)
class Design:
    """A design."""

    # Of ``KINDS``: "grid" (all combinations, the last axis fastest), "list" (the axes' values side by side),
    # "latin_hypercube" or "sobol" (scrambled; SciPy's ``qmc``), "saltelli" or "morris" (SALib's).
    kind: str
    axes: tuple[Axis, ...]
    # size, seed: of those that are drawn: points, base samples or trajectories.
    size: int = 0
    seed: int = 0
    second_order: bool = False  # of "saltelli", whether for second-order indices too
    levels: int = 4  # of "morris"

    @property
    def length(self) -> int:
        """Points that an estimator needs together: D + 2, or 2 D + 2 for second order; a trajectory's D + 1; else 1."""
        count = len(self.axes)
        return {"saltelli": (2 * count if self.second_order else count) + 2, "morris": count + 1}.get(self.kind, 1)

    @property
    def count(self) -> int:
        """How many points that is, without making them."""
        if self.kind == "grid":
            return math.prod(axis.steps for axis in self.axes)
        return self.axes[0].steps if self.kind == "list" else self.size * self.length

    @property
    def box(self) -> dict[str, Any]:
        """SALib's statement of the problem in shares: scales are ours, so that a log axis is uniform in its logarithm."""
        names = [axis.name for axis in self.axes]
        return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}

    def points(self) -> np.ndarray:
        """The points (N, D), in SI."""
        if not KINDS[self.kind].size:
            grids = [axis.grid() for axis in self.axes]
            mesh = np.meshgrid(*grids, indexing="ij") if self.kind == "grid" else grids
            return np.stack([part.ravel() for part in mesh], axis=1)
        with warnings.catch_warnings():
            # A count that is no power of two is said in the documentation, not on the terminal.
            warnings.simplefilter("ignore")
            shares = self._drawn()
        return np.stack([axis.at(shares[:, k]) for k, axis in enumerate(self.axes)], axis=1)

    def _drawn(self) -> np.ndarray:
        """Shares (N, D); of Saltelli's (2010) cross-sampled Sobol sequence, or of Morris's (1991) trajectories."""
        from scipy.stats import qmc

        drawn = {"latin_hypercube": qmc.LatinHypercube, "sobol": qmc.Sobol}.get(self.kind)
        if drawn is not None:
            return drawn(len(self.axes), rng=np.random.default_rng(self.seed)).random(self.size)
        key = {"saltelli": "calc_second_order", "morris": "num_levels"}[self.kind]
        sample = needs(f"SALib.sample.{'sobol' if self.kind == 'saltelli' else 'morris'}").sample
        return sample(self.box, self.size, seed=self.seed, **{key: getattr(self, KINDS[self.kind].option)})

    @property
    def resolved(self) -> dict[str, Any]:
        """[design] of a study file, with every default."""
        kind = KINDS[self.kind]
        found: dict[str, Any] = {"kind": self.kind, "seed": self.seed} | ({kind.size: self.size} if kind.size else {})
        return found | ({kind.option: getattr(self, kind.option)} if kind.option else {})


@dataclass(frozen=True)
class Study:
    """A study ready to run."""

    # given, design: the scene that is varied, and its points.
    given: SceneFile
    design: Design
    # features, histories: what is kept of each point; whether forces are, too.
    features: tuple[Feature, ...]
    histories: bool
    derivatives: tuple[str, ...]  # parameters by which features are differentiated
    steady: bool  # whether features are those of the steady motion (``derivatives.steady``)
    own_end: bool  # whether each point runs to the horizon of its own parameters

    @cached_property
    def points(self) -> np.ndarray:
        """(N, D) values of the varied parameters."""
        return self.design.points()

    @property
    def count(self) -> int:
        """N."""
        return self.design.count

    @property
    def names(self) -> tuple[str, ...]:
        """The varied parameters."""
        return tuple(axis.name for axis in self.design.axes)

    @cached_property
    def ends(self) -> np.ndarray:
        """(N,) last time of each point's run [s]."""
        if not self.own_end:
            return np.full(self.count, self.given.times[-1])
        arguments = (self.params(self.points),)
        return program("study ends", _ends, (self.given.scene,), arguments)[0](*arguments)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of what is computed: features, then d(feature)/d(parameter)."""
        slopes = (f"d({f.name})/d({p})" for f in self.features for p in self.derivatives)
        return (*(f.name for f in self.features), *slopes)

    def params(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """Parameters of points (n, D): leaves (n,), those that do not vary too."""
        return columns(self.given.params, self.names, values)

    @property
    def resolved(self) -> dict[str, Any]:
        """The study with every default, SI: a study file itself."""
        scene = dict(self.given.resolved)
        scene["time"] = {k: v for k, v in scene["time"].items() if not (self.own_end and k == "end")}
        kept = {
            "features": [f.name for f in self.features], "histories": self.histories,
            "derivatives": list(self.derivatives), "steady": self.steady,
        }  # fmt: skip
        vary = {axis.name: _resolved(axis) for axis in self.design.axes}
        return {"scene": scene, "design": self.design.resolved, "vary": vary, "results": kept}


def _ends(scene: AbstractModel, params: dict) -> Array:
    return jax.vmap(lambda p: jnp.asarray(scene.horizon(p), float))(params)


def _resolved(axis: Axis) -> dict[str, Any]:
    if axis.values is not None:
        return {"values": list(axis.values)}
    steps = {"steps": axis.steps} if axis.steps else {}
    return {"lower": axis.lower, "upper": axis.upper, "scale": axis.scale} | steps


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
    """The study that a file's content describes; ``InputError`` for what is not right names the key and what would be.

    ``where``: the file, for messages; ``beside``: the folder in which a scene file is sought.
    """
    table = dict(table)
    if isinstance(table.get("vary"), Mapping):
        table["vary"] = tables.nested(table["vary"], _Axis)
    file = tables.validated(_File, table, where)
    given, own_end = _scene(file.scene, where, beside)
    of_numbers(given.scene)
    design = _designed(file, given, where)
    results = file.results
    if results.features is None:
        # What is read of a scene without contacts has either sign.
        kind, given = "peak" if given.scene.contacts else "largest", scenefile.shown(given)
        results = results.model_copy(update={"features": [f"{name}.{kind}" for name in given.scene.members]})
    with _prefixed(f"{where}: [results] "):
        given, features = _kept(given, results)
    return Study(given, design, features, results.histories, tuple(results.derivatives), results.steady, own_end)


@contextlib.contextmanager
def _prefixed(place: str) -> Iterator[None]:
    """Within, errors have the place in the file in front of theirs."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}{error.where}", error.found, error.remedy) from None


def _kept(given: SceneFile, results: _Results) -> tuple[SceneFile, tuple[Feature, ...]]:
    """The scene that reads what is kept of it, and the features, checked."""
    wanted = results.features or []
    if len(set(wanted)) < len(wanted):
        twice = next(name for name in wanted if wanted.count(name) > 1)
        raise InputError("features", f"'{twice}' is listed twice", "name it once")
    given = replace(given, scene=observing(given.scene, wanted))
    features = tuple(feature(name, given.scene.members) for name in wanted)
    if any(event(one.kind) for one in features):
        check_followed(given.scene)
    if results.derivatives:
        complete(given.scene, given.params, results.derivatives)
    if not results.steady:
        return given, features
    check_recurs(given.scene, given.params)
    if given.solver is not None:
        raise InputError("steady", f"with the solver '{given.solver}'", "leave the solver out")
    if results.histories:
        raise InputError("histories", "with steady = true", "say histories = false: a turn's forces are not kept")
    for one in features:
        if one.kind not in OF_TURN:
            raise InputError(f"feature '{one.name}'", "is none of steady motion", f"take {', '.join(OF_TURN)}")
    return given, features


def _designed(file: _File, given: SceneFile, where: str) -> Design:
    """[design] and [vary]."""
    asked, place = file.design, f"{where}: [vary]"
    if asked.kind not in KINDS:
        raise InputError(f"{where}: [design] kind", f"no design '{asked.kind}'", nearest(asked.kind, KINDS))
    size = _size(asked, where)
    if not file.vary:
        raise InputError(place, "nothing is varied", f"vary one of {', '.join(given.scene.quantities)}")
    varied = _spread(given, file.vary, where)
    axes = tuple(_axis(given, name, one, asked.kind, where) for name, one in varied.items())
    if len({axis.name for axis in axes}) < len(axes):
        raise InputError(place, "one parameter is varied twice, under two names", "remove one of them")
    if asked.kind == "list" and len({axis.steps for axis in axes}) > 1:
        found = ", ".join(f"{axis.name}: {axis.steps}" for axis in axes)
        remedy = "give every parameter the same number of values"
        raise InputError(place, f"lists of different lengths: {found}", remedy)
    design = Design(asked.kind, axes, size, asked.seed, asked.second_order or False, asked.levels or Design.levels)
    if design.count > MOST_POINTS:
        raise InputError(place, f"{design.count} points", f"a study has at most {MOST_POINTS}")
    return design


def _size(design: _Design, where: str) -> int:
    """How many points, base samples or trajectories; 0 for a design that its axes make."""
    kind, place = KINDS[design.kind], f"{where}: [design]"
    sizes = {other.size for other in KINDS.values()}
    for key in ("points", "samples", "trajectories", "second_order", "levels"):
        if getattr(design, key) is None or key in (kind.size, kind.option):
            continue
        found = f"no key of a {design.kind}"
        if key == "points" and not kind.size:
            found = f"a {design.kind} gets its number of points from its axes"
        remedy = f"say {kind.size}" if kind.size and key in sizes else "take it out"
        raise InputError(f"{place} {key}", found, remedy)
    if not kind.size:
        return 0
    size = getattr(design, kind.size)
    if size is None:
        raise InputError(f"{place} {kind.size}", f"missing for {design.kind}", f"give the number of {kind.size}")
    if design.levels is not None and design.levels % 2:
        raise InputError(f"{place} levels", f"{design.levels} is odd", "give an even number (Morris 1991)")
    return size


def _scene(scene: Any, where: str, beside: Path) -> tuple[SceneFile, bool]:
    """The scene, and whether it leaves the end to each point's parameters."""
    if isinstance(scene, Mapping):
        if "scene" not in scene:
            found = "has a kind, as in a scene file" if "kind" in scene else "has no table scene"
            remedy = "write [scene.scene], [scene.parameters] and so on, or scene = with a file or a name"
            raise InputError(f"{where}: [scene]", found, remedy)
        with _prefixed(f"{where}: "):
            table, given = scene, scenefile.from_table(scene, None)
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


def _spread(given: SceneFile, vary: Mapping[str, _Axis], where: str) -> dict[str, _Axis]:
    """The varied parameters, in which a pattern (``ball_*.oversize``) stands for every one that has a value here."""
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
    place, scene, size = f"{where}: [vary.{name}]", given.scene, KINDS[kind].size
    name, known = scene.canonical(name), scene.quantities
    if name not in known:
        hint = f"known here: {', '.join(sorted(known))}" if name in CATALOGUE else nearest(name, known)
        raise InputError(place, f"scene '{scene.kind}' has no parameter '{name}'", hint)
    listed, lower, upper = table.values is not None, table.lower, table.upper
    some = any(x is not None for x in (lower, upper, table.steps))
    faults = (
        (table.scale not in SCALES, " scale", f"no scale '{table.scale}'", nearest(table.scale, SCALES)),
        (listed and some, "", "values and bounds are both given", "give one of them"),
        (listed and size, " values", f"a {kind} draws between bounds", "give lower and upper"),
        (table.values == [], " values", "is empty", "give one value or more"),
        (not listed and (lower is None or upper is None), "", "no bounds", "give lower and upper, or values"),
        (not listed and kind == "list", "", "a list needs values", "give values = [...]"),
        (size and table.steps is not None, " steps", f"a {kind} has no steps", f"say [design] {size} in place of it"),
        (not (size or listed or table.steps), " steps", "missing", "give the number of values of the grid"),
    )
    for wrong, key, found, remedy in faults:
        if wrong:
            raise InputError(f"{place}{key}", found, remedy)
    axis = Axis(name, lower, upper, table.scale, table.steps or 0)  # pyright: ignore[reportArgumentType]
    if table.values is None:
        return bounded(place, scene, given.params, axis)
    power = inputs.exponent(scene, name, given.params)
    values = tuple(scalar(f"{place} values", known[name], x, power) for x in table.values)
    return Axis(name, min(values), max(values), "linear", len(values), values)
