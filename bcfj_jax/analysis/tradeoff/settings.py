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
_THINNED = (4, 16)
# By parameter: factors, the change in words, and what a smaller factor does, and a larger one.
_FACTORS = {
    "smoothing": (
        (0.25, 0.5, 2.0, 4.0), "the contact regularisation is {:.2g} times as wide: contacts begin {}",
        ("more sharply", "earlier and more softly"),
    ),
    "friction_speed": (
        (1 / 3, 2.0, 3.0, 10.0), "friction's transition speed is {:.2g} times the given: what bears load creeps {}",
        ("less", "more"),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """One way to run the scene."""

    name: str  # unique in a study
    group: str  # what is set: tolerance, fidelity, model, smoothing, friction speed, friction law, output or precision
    ladder: str  # settings of one ladder differ in tolerance alone
    error: float  # the force error asked for, a fraction of the peak
    table: Mapping[str, Any]  # the whole scene file, as TOML holds it
    change: Mapping[str, Any] = field(default_factory=dict)  # what of it is not the user's, section by section
    physics: str = ""  # what it changes in the model, in words; "" where only numbers are computed in another way
    derivatives: bool = False  # whether its derivatives are measured, too
    bits: int = 64  # of the numbers it is computed in
    integrated: bool = True  # whether its model takes steps; one that is solved instant by instant asks for no error

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
    if "scene" in change and (model := _made(table)):
        table["parameters"] = {name: x for name, x in table["parameters"].items() if name in model.quantities}
    return table


def _made(table: Mapping[str, Any]) -> AbstractModel | None:
    """The model that a scene file's content names; None for options that make none, which a run will say."""
    try:
        return scenefile.model(table)
    except InputError:
        return None


def level(given: SceneFile) -> str:
    """The level of the user's own model as its file names it; what a sentence calls a model without levels."""
    option = next(iter(given.scene.choice_options()), None)
    return given.resolved["scene"][option] if option else given.scene.title


def accuracy_of(given: SceneFile, error: float, solver: str | None = None) -> dict[str, Any]:
    """[accuracy] of a scene file at a force error; its default solver is not named: that would be another program."""
    chosen = solver or given.solver
    default = named.known(given.scene.traits.stiff)[0]
    return {"force_error": error} | ({"solver": chosen} if chosen and chosen != default else {})


def settings(given: SceneFile, only: Sequence[str] = (), derivatives: bool = True) -> list[Setting]:
    """Every setting worth trying on a scene, the user's own first, then cheap ones before dear ones.

    ``only``: groups and solvers to try; by default all. ``derivatives``: whether they are measured where they can be.
    ``InputError`` for a group or a solver that this scene has not, and for a model whose level is yet to be chosen.
    """
    if given.scene.traits.open:
        option, value = next(iter(given.scene.choice_options().items()))
        remedy = f"give {given.scene.coarser()[-1].name}: all are tried"
        raise InputError(f"[scene] {option}", f"'{value}' leaves the choice of the model open", remedy)
    kinds = _tolerances, _fidelities, _knobs, _outputs, _models, _narrow
    more = sorted((s for kind in kinds for s in kind(given)), key=lambda s: (-s.error, s.group != "tolerance"))
    moves = given.scene.traits.history
    solver = given.solver or named.known(given.scene.traits.stiff)[0] if moves else "none"
    # An empty change: the file as it stands. Of settings that compute the same the first stays.
    own = Setting(AS_GIVEN, "tolerance", solver, force_error(given.accuracy), given.resolved, derivatives=moves)
    unlike: dict[tuple[str, int], Setting] = {}
    for s in (own, *more):
        unlike.setdefault((_same(s.table), s.bits), s)
    every = list(unlike.values())
    known = dict.fromkeys([s.group for s in every] + [s.ladder for s in every if s.group == "tolerance"])
    for name in only:
        if name not in known:
            raise InputError("--only", f"no group of settings and no solver '{name}' here", nearest(name, known))
    wanted = [s for s in every if not only or s.name == AS_GIVEN or {s.group, s.ladder} & set(only)]
    off = ({} if derivatives else {"derivatives": False}) | ({} if moves else {"integrated": False})
    return [replace(s, **off) for s in wanted]


def _same(table: Mapping[str, Any]) -> str:
    """What two settings that compute the same have in common: a level is its force error."""
    accuracy = dict(table["accuracy"])
    if "level" in accuracy:
        accuracy["force_error"] = LEVELS[accuracy.pop("level")]
    return json.dumps(plain({**table, "accuracy": accuracy}), sort_keys=True)


def _distinct(scene: AbstractModel, errors: tuple[float, ...] = ERRORS) -> list[float]:
    """Force errors that give different tolerances; of those with one tolerance the smallest."""
    return list({float(plan(scene, error).tolerance): error for error in errors}.values())


def _setting(given: SceneFile, name: str, group: str, change: Mapping[str, Any], **more: Any) -> Setting:
    """A change of the user's file, by default a ladder of its own at the file's own force error."""
    own: dict[str, Any] = {"ladder": name, "error": force_error(given.accuracy)}
    return Setting(name, group, table=overlaid(given.resolved, change), change=change, **(own | more))


def _laddered(given: SceneFile, name: str, group: str, change: Mapping[str, Any], **more: Any) -> Iterator[Setting]:
    """The same at a few force errors, of a model that asks for one."""
    for error in _distinct(given.scene, _KNOBS_AT[given.scene.traits.large]):
        at, label = change, name
        if given.scene.traits.history:
            at, label = {**change, "accuracy": accuracy_of(given, error)}, f"{name} at {100 * error:g} %"
        yield _setting(given, label, group, at, **{"ladder": name, "error": error, **more})


def _tolerances(given: SceneFile) -> Iterator[Setting]:
    stiff = given.scene.traits.stiff
    for solver in named.known(stiff) if given.scene.traits.history else ():
        for place, error in enumerate(_distinct(given.scene)):
            change = {"accuracy": accuracy_of(given, error, solver)}
            # The tangents' own control below 5e-4 is BDF's; looser ones are SDIRK2's (integrate).
            fit = {"sdirk2": error >= 5e-4, "bdf": 1e-5 <= error < 5e-4, "rodas3": False}
            more = {"ladder": solver, "error": error, "derivatives": fit[solver] if stiff else place % 2 == 0}
            yield _setting(given, f"{solver} at {100 * error:g} %", "tolerance", change, **more)


def _fidelities(given: SceneFile) -> Iterator[Setting]:
    for coarse in given.scene.coarser():
        model = _made(overlaid(given.resolved, {"scene": coarse.options}))
        # Sorted first: nothing is as cheap.
        more = {"error": 1.0, "physics": coarse.physics, "integrated": model is None or model.traits.history}
        yield _setting(given, coarse.name, "fidelity", {"scene": coarse.options}, **more)


def _models(given: SceneFile) -> Iterator[Setting]:
    """Other choices of the model: the scene's own, and other laws that read the same coefficients."""
    same, laws = _made(given.resolved), _USUAL_LAWS if "law" in given.resolved["scene"] else ()
    choices = [(one.name, one.change, one.physics, False) for one in given.scene.variants(given.params)]
    choices += [(f"law {x}", {"scene": {"law": x}}, f"contacts follow the law {x}", True) for x in laws]
    for name, change, physics, reads in choices:
        model = _made(overlaid(given.resolved, change))
        if model is None or (model == same and "scene" in change):
            continue
        if not reads or (same is not None and set(model.quantities) == set(same.quantities)):
            yield _setting(given, name, MODEL, change, physics=physics)


def _narrow(given: SceneFile) -> Iterator[Setting]:
    """In 32-bit numbers; a model that asks for no error at one."""
    every = _laddered(given, "32-bit numbers", "precision", {}, bits=32)
    own = _setting(given, "32-bit numbers", "precision", {}, bits=32)
    yield from every if given.scene.traits.history else [own]


def _knobs(given: SceneFile) -> Iterator[Setting]:
    """Smoothing, transition speed and law of friction."""
    values, options, moves = given.resolved["parameters"], given.resolved["scene"], given.scene.traits.history
    changes: list[tuple[str, str, dict[str, Any], str]] = []
    if "smoothing" in values and not values["smoothing"]:
        changes.append(("smoothing", "without smoothing", {"scene": {"smoothing": False}}, ""))
        depth = float(ask("depth", _first_scale, (given.scene,), (dict(given.params),)))  # A typical one [m].
        for share in _WIDTHS_OF_DEPTH:
            physics = f"contacts begin softly, over {100 * share:g} % of a typical penetration"
            parameters = {"parameters": {"smoothing": float(f"{share * depth:.3g}")}}
            changes.append(("smoothing", f"smoothing {share * depth:.2g} m", parameters, physics))
    for name, (factors, said, effects) in _FACTORS.items():
        scaled = [key for key in values if key.rpartition(".")[2] == name and values[key] > 0]
        for factor in factors if scaled and (moves or name == "smoothing") else ():
            parameters = {"parameters": {key: float(f"{factor * values[key]:.3g}") for key in scaled}}
            physics = said.format(factor, effects[factor > 1])
            changes.append((name.replace("_", " "), f"{name} x {factor:.2g}", parameters, physics))
    if moves and "friction" in options:
        now = "brown_mcphee" if options["friction"] is True else options["friction"]
        for law in [law for law in (False, *FRICTION) if law != now]:
            physics = f"friction by the law {law}" if law else "no friction at all"
            changes.append(("friction law", f"friction {law or 'none'}", {"scene": {"friction": law}}, physics))
    same, large = _made(given.resolved), given.scene.traits.large
    for group, name, change, physics in changes:
        # Contacts that name a friction law of their own, or a scene without contacts, do not heed the scene's.
        if "scene" not in change or _made(overlaid(given.resolved, change)) != same:
            slopes = not large and group == "smoothing"
            yield from _laddered(given, name, group, change, physics=physics, derivatives=slopes)


def _first_scale(scene: AbstractModel, params: dict) -> Array:
    return scene.error_scale(params)[0]


def _outputs(given: SceneFile) -> Iterator[Setting]:
    for every in _THINNED:
        samples = (given.resolved["time"]["samples"] - 1) // every + 1
        if samples > 10:
            physics = f"a sample of every {every} is kept, straight lines between: peaks between samples are cut"
            yield _setting(given, f"{samples} samples", "output", {"time": {"samples": samples}}, physics=physics)
