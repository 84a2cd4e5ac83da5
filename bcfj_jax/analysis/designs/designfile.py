"""Design files: what is made least or most, over which parameters; checked, in SI (docs/design.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic

from bcfj_jax.analysis.designs import space
from bcfj_jax.core import limits
from bcfj_jax.core.errors import InputError
from bcfj_jax.io import scenefile, tables
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.mechanism.model import AbstractModel

# Instants of equilibrium that a pitch of a turning mechanism gets.
_INSTANTS = 49


class VaryTable(tables.Table):
    """[vary.NAME]: bounds and tolerance, numbers in SI or texts with a unit."""

    lower: tables.Number
    upper: tables.Number
    tolerance: tables.Number = 0.0
    relative: bool = False
    scale: str = "linear"

    @pydantic.model_validator(mode="before")
    @classmethod
    def _pair(cls, given: Any) -> Any:
        if isinstance(given, list) and len(given) in (2, 3):
            return dict(zip(("lower", "upper", "tolerance"), given, strict=False))
        return given


class _Objective(tables.Table):
    minimize: str | dict[str, float] | None = None
    maximize: str | dict[str, float] | None = None
    steady: bool = False


class Search(tables.Table):
    """[search]: options of ``design``, with its defaults."""

    starts: int = pydantic.Field(default=8, ge=1, le=limits.STARTS)
    kappa: float = pydantic.Field(default=0.0, ge=0.0)
    distribution: Literal["normal", "uniform"] = "normal"
    samples: int = pydantic.Field(default=64, ge=1, le=limits.RUNS)
    iterations: int = pydantic.Field(default=60, ge=1, le=limits.RUNS)
    seed: int = pydantic.Field(default=0, ge=0)
    confirm: bool = True
    certify: bool = True


class File(tables.Table):
    """A design file."""

    scene: str
    objective: _Objective = _Objective()
    vary: dict[str, VaryTable] = pydantic.Field(default_factory=dict)
    search: Search = Search()


@dataclass(frozen=True)
class Question:
    """A design ready to be found."""

    given: SceneFile
    # scene, times: the model that is searched, and its times [s].
    scene: AbstractModel
    times: np.ndarray
    note: str  # which one, where the file left it open; else ""
    # objective, free, search: as design takes them.
    objective: str | dict[str, float]
    free: dict[str, space.Free]
    search: space.Search

    @property
    def resolved(self) -> dict[str, Any]:
        """The question with every default, as ``run.toml`` has it."""
        search = {name: getattr(self.search, name) for name in Search.model_fields}
        return {
            **self.given.resolved,
            "design": {
                ("minimize" if self.search.sense == "minimise" else "maximize"): self.objective,
                "steady": self.search.steady,
                "begin": float(self.times[0]), "end": float(self.times[-1]), "samples": len(self.times),
                "vary": {name: one._asdict() for name, one in self.free.items()},
                **search, "confirm": self.search.confirm is not None,
            },
        }  # fmt: skip


def schema() -> dict[str, Any]:
    """The JSON Schema of a design file."""
    return tables.published(
        pydantic.create_model("Design", __base__=File, vary=(dict[str, VaryTable | list[tables.Number]], ...)), "design"
    )


def load(what: str, more: Mapping[str, Any]) -> Question:
    """A design file, or a scene, in a file or built in, whose question ``more`` asks: tables in place of the file's own."""
    path = Path(what)
    table: dict[str, Any] = tables.read(path) if path.suffix == ".toml" else {}
    table, beside = (table, path.parent) if "objective" in table else ({"scene": what}, Path("."))
    # What is no table is left as it is, and refused below.
    vary, search, wanted = (table.get(name, {}) for name in ("vary", "search", "objective"))
    vary = {**tables.nested(vary, VaryTable), **more.get("vary", {})} if isinstance(vary, Mapping) else vary
    search = {**search, **more.get("search", {})} if isinstance(search, Mapping) else search
    if isinstance(wanted, Mapping) and more.get("objective"):
        wanted = {key: wanted[key] for key in ("steady",) if key in wanted} | dict(more["objective"])
    table = {**table, "vary": vary, "search": search, "objective": wanted}
    file = tables.validated(File, table, what)
    asked = file.objective
    if (asked.minimize is None) == (asked.maximize is None):
        found = "nothing is to be minimized or maximized" if asked.minimize is None else "both are given"
        raise InputError(f"{what}: [objective]", found, "give one: --minimize seat_cage.peak, or --maximize")
    if not file.vary:
        raise InputError(f"{what}: [vary]", "nothing is varied", "say --vary clearance_seat_cage=10um:200um")
    scene = str(beside / file.scene) if file.scene.endswith(".toml") else file.scene
    given = scenefile.load(scene)
    if asked.steady:
        model, times, note = given.scene.full(), given.times, ""
    else:
        model, times, note = searched(given, "end" in scenefile.content(scene).get("time", {}))
    own: dict[str, Any] = {
        "confirm": "auto" if file.search.confirm else None, "max_steps": given.max_steps, "steady": asked.steady,
        "sense": "minimise" if asked.maximize is None else "maximise",
    }  # fmt: skip
    free = {name: space.Free(**one.model_dump()) for name, one in file.vary.items()}
    objective = asked.minimize or asked.maximize or ""
    return Question(given, model, times, note, objective, free, space.Search(**file.search.model_dump() | own))


def searched(given: SceneFile, ends: bool) -> tuple[AbstractModel, np.ndarray, str]:
    """The model that is searched, its times (T,) [s], and a sentence about both; "" for the scene as it is.

    Of a scene with levels, which the file left open, equilibria. ``ends``: whether the file says when the run ends.
    """
    scene, levels = given.scene, given.scene.coarser()
    if not (given.open and levels):
        return scene, given.times, ""
    level = levels[-1]
    model = replace(scene, **level.options)
    note = f"searching among equilibria ({level.physics}), as motion is chaotic over long times; the optimum is checked by motion"
    if ends or not scene.recurs(given.params):
        return model, given.times, note
    begin, pitch = scene.settled_from(given.params), scene.period(given.params)[1]
    return model, begin + np.linspace(0.0, pitch, _INSTANTS), f"{note}; over one pitch, {_INSTANTS} instants"
