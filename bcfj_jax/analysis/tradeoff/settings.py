"""What can be set on a scene to trade accuracy for speed, as whole scene files around the user's own.

A ladder is a row of settings that differ in tolerance alone. The user's own scene is the first setting, ``as given``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jax import Array

from bcfj_jax.contact.laws import FRICTION
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.io import scenefile
from bcfj_jax.io.outputs import plain
from bcfj_jax.io.scenefile import SceneFile
from bcfj_jax.mechanism.model import AbstractModel
from bcfj_jax.solve import named
from bcfj_jax.solve.plan import LEVELS, force_error, plan
from bcfj_jax.xla.programs import ask

AS_GIVEN = "as given"
# Laws of the coefficient of restitution that the field uses most.
_USUAL_LAWS = ("hunt_crossley", "lankarani_nikravesh", "flores")
# Settings whose difference from the given scene is no error of its computation: none of them is the truth.
MODEL = "model"
ERRORS = (0.2, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 1e-6)
# Force errors at which anything but the tolerance is tried, by whether the scene is large: its runs are dear.
_KNOBS_AT = {False: (1e-2, 1e-3), True: (5e-3,)}
_WIDTHS_OF_DEPTH = (0.01, 0.03, 0.1, 0.3)
_FACTORS = {"smoothing": (0.25, 0.5, 2.0, 4.0), "friction_speed": (1 / 3, 2.0, 3.0, 10.0)}
_THINNED = (4, 16)
_PHYSICS = {
    "smoothing": "the contact regularisation is {:.2g} times as wide: contacts begin {}",
    "friction_speed": "friction's transition speed is {:.2g} times the given: what bears load creeps {}",
    "output": "a sample of every {} is kept, straight lines between: peaks between samples are cut",
}
# What a smaller factor does, and a larger one.
_EFFECT = {"smoothing": ("more sharply", "earlier and more softly"), "friction_speed": ("less", "more")}


@dataclass(frozen=True)
class Setting:
    """One way to run the scene.

    Attributes:
        name: unique in a study.
        group: what is set: tolerance, fidelity, model, smoothing, friction speed, friction law, output or precision.
        ladder: settings of one ladder differ in tolerance alone.
        error: the force error asked for, a fraction of the peak.
        table: the whole scene file, as TOML holds it.
        change: what of it is not the user's, section by section.
        physics: what it changes in the model, in words; "" where only numbers are computed in another way.
        derivatives: whether its derivatives are measured, too.
        bits: of the numbers it is computed in.
        integrated: whether its model takes steps; a model that is solved instant by instant asks for no error.
    """

    name: str
    group: str
    ladder: str
    error: float
    table: Mapping[str, Any]
    change: Mapping[str, Any] = field(default_factory=dict)
    physics: str = ""
    derivatives: bool = False
    bits: int = 64
    integrated: bool = True

    @property
    def digest(self) -> str:
        """SHA-256 of all that decides what comes out."""
        decisive = plain([self.table, self.derivatives, self.bits])
        return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()


def overlaid(resolved: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    """A resolved scene file with a change in it; accuracy is replaced but for its ``max_steps``, and parameters that changed
    options no longer read are left out.
    """
    table = dict(resolved) | {section: {**resolved.get(section, {}), **own} for section, own in change.items()}
    if "accuracy" in change:
        table["accuracy"] = {"max_steps": resolved["accuracy"]["max_steps"], **change["accuracy"]}
    if "scene" in change:
        model = _made(table)
        known = model.quantities if model else table["parameters"]
        table["parameters"] = {name: value for name, value in table["parameters"].items() if name in known}
    return table


def _made(table: Mapping[str, Any]) -> AbstractModel | None:
    """The model that a scene file's content names; None for options that make none, which a run will say."""
    try:
        return scenefile.model(table)
    except InputError:
        return None


def _default_solver(given: SceneFile) -> str:
    return named.known(given.scene.traits.stiff)[0]


def level(given: SceneFile) -> str:
    """The level of the user's own model as its file names it; what a sentence calls a model without levels."""
    option = next(iter(given.scene.choice_options()), None)
    return given.resolved["scene"][option] if option else given.scene.title


def distinct(scene: AbstractModel, errors: tuple[float, ...] = ERRORS) -> list[float]:
    """Force errors that give different tolerances; of those with one tolerance the smallest."""
    last: dict[float, float] = {float(plan(scene, error).tolerance): error for error in errors}
    return list(last.values())


def settings(given: SceneFile, only: Sequence[str] = (), derivatives: bool = True) -> list[Setting]:
    """Every setting worth trying on a scene, the user's own first, then cheap ones before dear ones.

    ``only``: groups and solvers to try; by default all. ``derivatives``: whether they are measured where they can be.
    ``InputError`` for a group or a solver that this scene has not, and for a model whose level is yet to be chosen.
    """
    if given.scene.traits.open:
        option, value = next(iter(given.scene.choice_options().items()))
        remedy = f"give {given.scene.coarser()[-1].name}: all are tried"
        raise InputError(f"[scene] {option}", f"'{value}' leaves the choice of the model open", remedy)
    every = _every(given)
    known = dict.fromkeys([s.group for s in every] + [s.ladder for s in every if s.group == "tolerance"])
    for name in only:
        if name not in known:
            raise InputError("--only", f"no group of settings and no solver '{name}' here", nearest(name, known))
    wanted = [s for s in every if not only or s.name == AS_GIVEN or {s.group, s.ladder} & set(only)]
    return wanted if derivatives else [replace(s, derivatives=False) for s in wanted]


def _every(given: SceneFile) -> list[Setting]:
    moves = given.scene.traits.history
    solver = given.solver or _default_solver(given) if moves else "none"
    # An empty change: the file as it stands.
    own = Setting(AS_GIVEN, "tolerance", solver, force_error(given.accuracy), given.resolved, derivatives=moves)
    more = [*(_tolerances(given) if moves else ()), *_fidelities(given), *_knobs(given, moves), *_outputs(given)]
    narrow = given, "32-bit numbers", "precision", {}
    more += [*_models(given), *(_laddered(*narrow, True, bits=32) if moves else [_setting(*narrow, bits=32)])]
    seen, found = {(_same(given.resolved), own.bits)}, [own]
    for setting in sorted(more, key=lambda s: (-s.error, s.group != "tolerance")):
        key = _same(setting.table), setting.bits
        if key not in seen:
            seen.add(key)
            found.append(setting)
    return found if moves else [replace(setting, integrated=False) for setting in found]


def _same(table: Mapping[str, Any]) -> str:
    """What two settings that compute the same have in common: a level is its force error."""
    accuracy = {key: value for key, value in table["accuracy"].items() if key != "level"}
    if "level" in table["accuracy"]:
        accuracy["force_error"] = LEVELS[table["accuracy"]["level"]]
    return json.dumps(plain({**table, "accuracy": accuracy}), sort_keys=True)


def accuracy_of(given: SceneFile, error: float, solver: str | None = None) -> dict[str, Any]:
    """[accuracy] of a scene file at a force error; its default solver is not named: that would be another program."""
    chosen = solver or given.solver
    return {"force_error": error} | ({"solver": chosen} if chosen and chosen != _default_solver(given) else {})


def _percent(error: float) -> str:
    return f"{100 * error:g} %"


def _setting(given: SceneFile, name: str, group: str, change: Mapping[str, Any], **more: Any) -> Setting:
    """A change of the user's file, by default a ladder of its own at the file's own force error."""
    own: dict[str, Any] = {"ladder": name, "error": force_error(given.accuracy)}
    return Setting(name, group, table=overlaid(given.resolved, change), change=change, **(own | more))


def _laddered(
    given: SceneFile, name: str, group: str, change: Mapping[str, Any], moves: bool, **more: Any
) -> Iterator[Setting]:
    """The same at a few force errors, of a model that asks for one."""
    for error in distinct(given.scene, _KNOBS_AT[given.scene.traits.large]):
        if moves:
            at = {**change, "accuracy": accuracy_of(given, error)}
            yield _setting(given, f"{name} at {_percent(error)}", group, at, ladder=name, error=error, **more)
        else:
            yield _setting(given, name, group, change, error=error, **more)


def _tolerances(given: SceneFile) -> Iterator[Setting]:
    stiff = given.scene.traits.stiff
    for solver in named.known(stiff):
        for place, error in enumerate(distinct(given.scene)):
            change = {"accuracy": accuracy_of(given, error, solver)}
            # The tangents' own control below 5e-4 is BDF's; looser ones are SDIRK2's (integrate).
            fit = {"sdirk2": error >= 5e-4, "bdf": 1e-5 <= error < 5e-4, "rodas3": False}
            more = {"ladder": solver, "error": error, "derivatives": fit[solver] if stiff else place % 2 == 0}
            yield _setting(given, f"{solver} at {_percent(error)}", "tolerance", change, **more)


def _fidelities(given: SceneFile) -> Iterator[Setting]:
    for coarse in given.scene.coarser():
        change = {"scene": coarse.options}
        model = _made(overlaid(given.resolved, change))
        steps = model is None or model.traits.history
        # Sorted first: nothing is as cheap.
        yield _setting(given, coarse.name, "fidelity", change, error=1.0, physics=coarse.physics, integrated=steps)


def _models(given: SceneFile) -> Iterator[Setting]:
    """Other choices of the model: the scene's own, and other laws that read the same coefficients."""
    same = _made(given.resolved)
    for one in given.scene.variants(given.params):
        model = _made(overlaid(given.resolved, one.change))
        if model is not None and (model != same or "scene" not in one.change):
            yield _setting(given, one.name, MODEL, one.change, physics=one.physics)
    if same is None or "law" not in given.resolved["scene"]:
        return
    for law in _USUAL_LAWS:
        change = {"scene": {"law": law}}
        model = _made(overlaid(given.resolved, change))
        if model is not None and model != same and set(model.quantities) == set(same.quantities):
            yield _setting(given, f"law {law}", MODEL, change, physics=f"contacts follow the law {law}")


def _knobs(given: SceneFile, moves: bool) -> Iterator[Setting]:
    values = given.resolved["parameters"]
    changes: list[tuple[str, str, dict[str, Any], str]] = []
    if "smoothing" in values and not values["smoothing"]:
        changes.append(("smoothing", "without smoothing", {"scene": {"smoothing": False}}, ""))
        depth = float(ask("depth", _first_scale, (given.scene,), (dict(given.params),)))  # A typical one [m].
        for share in _WIDTHS_OF_DEPTH:
            physics = f"contacts begin softly, over {_percent(share)} of a typical penetration"
            parameters = {"parameters": {"smoothing": float(f"{share * depth:.3g}")}}
            changes.append(("smoothing", f"smoothing {share * depth:.2g} m", parameters, physics))
    for name, factors in _FACTORS.items():
        scaled = [key for key in values if key.rpartition(".")[2] == name and values[key] > 0]
        for factor in factors if scaled and (moves or name == "smoothing") else ():
            parameters = {"parameters": {key: float(f"{factor * values[key]:.3g}") for key in scaled}}
            physics = _PHYSICS[name].format(factor, _EFFECT[name][factor > 1])
            changes.append((name.replace("_", " "), f"{name} x {factor:.2g}", parameters, physics))
    if moves and "friction" in given.resolved["scene"]:
        now = given.resolved["scene"]["friction"]
        now = "brown_mcphee" if now is True else now
        for law in (False, *FRICTION):
            if law != now:
                physics = f"friction by the law {law}" if law else "no friction at all"
                changes.append(("friction law", f"friction {law or 'none'}", {"scene": {"friction": law}}, physics))
    same, large = _made(given.resolved), given.scene.traits.large
    for group, name, change, physics in changes:
        # Contacts that name a friction law of their own, or a scene without contacts, do not heed the scene's.
        if "scene" in change and _made(overlaid(given.resolved, change)) == same:
            continue
        slopes = not large and group == "smoothing"
        yield from _laddered(given, name, group, change, moves, physics=physics, derivatives=slopes)


def _first_scale(scene: AbstractModel, params: dict) -> Array:
    return scene.error_scale(params)[0]


def _outputs(given: SceneFile) -> Iterator[Setting]:
    count = given.resolved["time"]["samples"]
    for every in _THINNED:
        samples = (count - 1) // every + 1
        if samples > 10:
            change, physics = {"time": {"samples": samples}}, _PHYSICS["output"].format(every)
            yield _setting(given, f"{samples} samples", "output", change, physics=physics)
