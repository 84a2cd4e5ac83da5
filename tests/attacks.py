"""Attacks on the Python API: every verb with every kind of bad value, and what may come of it.

An attack is refused by an ``InputError`` that names a place, a finding and a remedy; or the run fails with a reason. It
never ends "ok" with a force that is not finite, and never in an error from below. ``table()`` makes them;
``test_attacks.py`` runs all.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
import calibration

NAN, INF = float("nan"), float("inf")
# What stands in the place of one number.
NO_NUMBERS: dict[str, Any] = {
    "nan": NAN, "inf": INF, "-inf": -INF, "None": None, "True": True, "text": "much", "empty text": "", "list": [1.0, 2.0],
    "dict": {}, "complex": 1 + 2j, "object": object(), "function": abs, "array": np.ones(3), "empty array": np.array([]),
    "bytes": b"1", "wrong unit": "3 V", "no unit": "3", "huge": 10**400, "jax nan": jnp.asarray(NAN), "set": {1.0},
    "array of texts": np.array(["1"]), "long text": "x" * 10_000, "uneven list": [[1.0], [1.0, 2.0]],
}  # fmt: skip
# A value a member may be given as a list.
NO_SINGLES = ("list", *(label for label in NO_NUMBERS if "array" in label))
NO_TIMES: dict[str, Any] = {
    "None": None, "number": 1.0, "text": "soon", "empty": [], "nan": [0.0, NAN], "inf": [0.0, INF], "falling": [0.0, 2.0, 1.0],
    "equal": [0.0, 1.0, 1.0], "matrix": np.zeros((2, 2)), "texts": ["a", "b"], "dict": {}, "complex": [0.0, 1j],
    "object": object(),
}  # fmt: skip
NO_NAMES: dict[str, Any] = {
    "None": None, "number": 3, "unknown": "stifness", "empty": (), "numbers": (1, 2), "twice": ("mass", "mass"), "bytes": b"mass",
    "dict": {}, "object": object(), "empty text": "",
}  # fmt: skip
NO_OPTIONS: dict[str, Any] = {
    "unknown": "medium", "None": None, "nan": NAN, "negative": -1.0, "zero": 0.0, "large": 2.0, "list": [1e-3],
    "object": object(), "empty": "", "dict": {},
}  # fmt: skip
NO_COUNTS: dict[str, Any] = {
    "zero": 0, "negative": -5, "half": 0.5, "nan": NAN, "text": "many", "None": None, "True": True, "list": [1], "huge": 10**30,
}  # fmt: skip
NO_WORDS = ("", "up", None, 3, [])
NO_MODELS: dict[str, Any] = {
    "None": None, "text": "impact", "class": bj.Mechanism, "function": bj.scenes.impact, "dict": {}, "number": 3,
}  # fmt: skip
NO_TABLES: dict[str, Any] = {
    "None": None, "list": [1.0], "text": "mass", "number": 1.0, "unknown key": {"masss": 1.0}, "number key": {1: 1.0},
    "empty": {}, "tuple": (("mass", 1.0),),
}  # fmt: skip
OUT_OF_RANGE = {
    "mass": (0.0, -1.0), "stiffness": (0.0, -1.0), "exponent": (0.5, -1.0, 4.0), "damping": (-1e-3,), "smoothing": (-1e-9,),
    "clearance_contact": (-1e-6,), "approach_speed": (-1.0,),
}  # fmt: skip


class Attack(NamedTuple):
    """What is attacked with what, and the attack."""

    verb: str
    what: str
    value: str
    run: Callable[[], Any]

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.verb}: {self.what} = {self.value}"


class Outcome(NamedTuple):
    """What came of an attack: whether that is right, "refused", "failed", "ok" or the error's name, and its words."""

    right: bool
    kind: str
    text: str


def outcome(attack: Attack) -> Outcome:
    """Run an attack."""
    try:
        found = attack.run()
    except bj.InputError as error:
        good = bool(error.where and error.found and error.remedy) and len(str(error)) < 2000
        return Outcome(good, "refused", str(error))
    except Exception as error:
        return Outcome(False, type(error).__name__, str(error)[:200])
    if getattr(found, "status", "ok") == "failed":
        return Outcome(bool(found.reason), "failed", found.reason)
    return Outcome(False, "ok", "")


def table() -> list[Attack]:
    """Every attack."""
    return [*_of_values(), *_of_options(), *_of_designs(), *_of_calibrations(), *_of_studies(), *_of_parts()]


def controls() -> dict[str, Callable[[], Any]]:
    """What the attacks change, unchanged: all of it is right, so that an attack is refused for its bad value alone."""
    scene, params, times = _scene()
    free = {"damping": (0.0, 1.0)}
    calls = {name: (lambda c=call: c(scene, params, times)) for name, call in _verbs().items() if name != "design"}
    short: Callable[[], Any] = lambda: bj.design(  # noqa: E731
        scene, params, times, "contact.peak", free, starts=2, iterations=2, confirm=None, certify=False, slices=False
    )
    return {**calls, "design": short, "problem": _problem, "parameters": scene.parameters}


def _scene() -> tuple[Any, dict[str, Any], np.ndarray]:
    scene = bj.scenes.impact()
    return scene, scene.parameters(), np.linspace(0.0, 60e-6, 61)


def _verbs() -> dict[str, Callable[..., Any]]:
    from bcfj_jax.analysis.energy_balance import balance

    return {
        "simulate": bj.simulate,
        "force_history": bj.force_history,
        "reading_history": lambda scene, params, times: bj.reading_history(scene, params, times, ["contact.normal"]),
        "sensitivity": lambda scene, params, times: bj.sensitivity(scene, params, times, "stiffness"),
        "hessian_vector": lambda *given: bj.hessian_vector(*given, "contact.mean", ("stiffness",), [1.0]),
        "smoothing_ladder": lambda *given: bj.smoothing_ladder(*given, ("stiffness",), [1e-7]),
        "balance": balance,
        "design": lambda *given: bj.design(*given, "contact.peak", {"damping": (0.0, 1.0)}),
    }


def _each(
    verb: str, what: str, bad: Mapping[str, Any] | Collection[Any], call: Callable[[Any], Any], but: Collection[str] = ()
) -> list[Attack]:  # fmt: skip
    """An attack a bad value, each by its label; ``but`` are labels of values that are not bad here."""
    labelled = bad if isinstance(bad, Mapping) else {repr(value)[:20]: value for value in bad}
    return [Attack(verb, what, label, partial(call, x)) for label, x in labelled.items() if label not in but]


def _of_values() -> list[Attack]:
    """Bad models, tables, times and values to every verb."""
    scene, params, times = _scene()
    found = []
    for verb, call in _verbs().items():
        found += _each(verb, "scene", NO_MODELS, lambda b, c=call: c(b, params, times))
        found += _each(verb, "params", NO_TABLES, lambda b, c=call: c(scene, b, times))
        found += _each(verb, "times", NO_TIMES, lambda b, c=call: c(scene, params, b))
        for name, values in (("mass", NO_NUMBERS), *OUT_OF_RANGE.items()):
            found += _each(verb, name, values, lambda b, c=call, n=name: c(scene, {**params, n: b}, times))
        less = {name: {k: v for k, v in params.items() if k != name} for name in params}
        found += _each(verb, "params without", less, lambda b, c=call: c(scene, b, times))
    found += _each("parameters", "mass", NO_NUMBERS, lambda b: scene.parameters(mass=b), NO_SINGLES)
    return found + _each("parameters", "values", NO_TABLES, lambda b: scene.parameters(b), ("None", "empty"))


def _of_options() -> list[Attack]:
    """Bad options to the verbs that take them."""
    given, mean = _scene(), "contact.mean"
    sensitivity = partial(bj.sensitivity, *given, "mass")
    found = [
        *_each("simulate", "accuracy", NO_OPTIONS, lambda b: bj.simulate(*given, accuracy=b)),
        *_each("force_history", "accuracy", NO_OPTIONS, lambda b: bj.force_history(*given, accuracy=b)),
        *_each("sensitivity", "accuracy", NO_OPTIONS, lambda b: sensitivity(accuracy=b)),
        *_each("simulate", "max_steps", NO_COUNTS, lambda b: bj.simulate(*given, max_steps=b)),
        *_each("sensitivity", "max_steps", NO_COUNTS, lambda b: sensitivity(max_steps=b)),
        *_each("sensitivity", "levels", NO_COUNTS, lambda b: sensitivity(levels=b)),
        *_each("sensitivity", "wrt", NO_NAMES, lambda b: bj.sensitivity(*given, b)),
        *_each("hessian_vector", "wrt", NO_NAMES, lambda b: bj.hessian_vector(*given, mean, b, [1.0])),
        *_each("sensitivity", "average", NO_NUMBERS, lambda b: sensitivity(average=b)),
        *_each("hessian_vector", "vector", NO_NUMBERS, lambda b: bj.hessian_vector(*given, mean, ("mass",), b)),
    ]
    # No reading and no feature is an answer, not an attack; nor is no solver.
    nothing = ("empty", "dict")
    found += _each("reading_history", "read", NO_NAMES, lambda b: bj.reading_history(*given, b), nothing)
    found += _each("simulate", "read", NO_NAMES, lambda b: bj.simulate(*given, read=b), nothing)
    found += _each("sensitivity", "features", NO_NAMES, lambda b: sensitivity(features=b), nothing)
    words = ("", "unknown", None, 3, NAN, [], {}, object())
    found += _each("simulate", "solver", words, lambda b: bj.simulate(*given, solver=b), ("None",))
    found += _each("force_history", "mode", words, lambda b: bj.force_history(*given, mode=b))
    found += _each("sensitivity", "mode", words, lambda b: sensitivity(mode=b))
    return found + _each("sensitivity", "differences", words, lambda b: sensitivity(differences=b))


def _of_designs() -> list[Attack]:
    given = _scene()

    def design(objective: Any = "contact.peak", free: Any = None, **more: Any) -> Any:
        return bj.design(*given, objective, {"damping": (0.0, 1.0)} if free is None else free, starts=2, **more)

    found = [
        *_each("design", "objective", NO_NAMES, design),
        *_each("design", "free", NO_NUMBERS, lambda b: design(free={"damping": b}), NO_SINGLES),
        *_each("design", "upper", NO_NUMBERS, lambda b: design(free={"damping": (0.0, b)})),
        *_each("design", "tolerance", NO_NUMBERS, lambda b: design(free={"damping": (0.0, 1.0, b)})),
        *_each("design", "free", NO_TABLES, lambda b: design(free=b), ("None",)),
        *_each("design", "kappa", NO_NUMBERS, lambda b: design(kappa=b), ("no unit",)),
    ]
    for what in ("samples", "iterations", "max_steps"):
        found += _each("design", what, NO_COUNTS, lambda b, w=what: design(**{w: b}))
    for what in ("sense", "distribution"):
        found += _each("design", what, NO_WORDS, lambda b, w=what: design(**{w: b}))
    return found


def _problem(**changed: Any) -> Any:
    scene, params, times = _scene()
    values = np.sin(np.linspace(0.0, np.pi, times.size))
    channel = {"observes": "contact.normal", "values": values, "sigma": 0.1} | changed.pop("channel", {})
    record = {"name": "one", "times": times} | changed.pop("record", {})
    free = {"name": "stiffness", "lower": 1e8, "upper": 1e12} | changed.pop("bounds", {})
    experiment = calibration.Experiment(channels=(calibration.Channel(**channel),), **record)
    parts = {"scene": scene, "params": params, "experiments": (experiment,), "free": (calibration.Free(**free),)}
    return calibration.Problem(**(parts | changed))


def _of_calibrations() -> list[Attack]:
    # A stiffness and a share need no unit.
    fine = ("None", "no unit")
    found = []
    for what in ("lower", "upper", "start"):
        found += _each("calibration.Free", what, NO_NUMBERS, lambda b, w=what: _problem(bounds={w: b}), fine)
    for what in ("sigma", "relative", "correlation", "jitter"):
        found += _each("calibration.Channel", what, NO_NUMBERS, lambda b, w=what: _problem(channel={w: b}), fine)
    for what, more in (("fixed", "empty"), ("tolerances", "unknown key"), ("bounds", "unknown key")):
        # Another model of the same data may have the name.
        found += _each(
            "calibration.Experiment", what, NO_TABLES, lambda b, w=what: _problem(record={w: b}), ("empty", more)
        )
        own = ("list",) if what == "bounds" else ()
        found += _each(
            "calibration.Experiment", what, NO_NUMBERS, lambda b, w=what: _problem(record={w: {"mass": b}}), own
        )
    for what in ("experiments", "free"):
        found += _each("calibration.Problem", what, NO_NAMES, lambda b, w=what: _problem(**{w: b}))
    return [
        *found,
        *_each("calibration.Free", "name", NO_NAMES, lambda b: _problem(bounds={"name": b})),
        *_each("calibration.Channel", "values", NO_NUMBERS, lambda b: _problem(channel={"values": b})),
        *_each("calibration.Channel", "observes", NO_NAMES, lambda b: _problem(channel={"observes": b})),
        *_each("calibration.Experiment", "times", NO_TIMES, lambda b: _problem(record={"times": b})),
        *_each("calibration.Experiment", "hold_out", NO_NUMBERS, lambda b: _problem(record={"hold_out": b}), ("True",)),
        *_each("calibration.Problem", "accuracy", NO_OPTIONS, lambda b: _problem(accuracy=b), ("zero",)),
        *_each("calibration.Problem", "tolerances", NO_NUMBERS, lambda b: _problem(tolerances={"mass": b})),
        *_each("calibration.load", "path", NO_NUMBERS, calibration.load),
        *_each("calibration.Problem", "scene", NO_MODELS, lambda b: _problem(scene=b)),
        *_each("calibration.Problem", "params", NO_TABLES, lambda b: _problem(params=b), ("empty",)),
        *_each("calibration.Problem", "loss", NO_WORDS, lambda b: _problem(loss=b)),
        *_each("calibration.Problem", "adequate", NO_NUMBERS, lambda b: _problem(adequate=b), fine),
        *_each("calibration.fit", "problem", NO_MODELS, calibration.fit),
    ]


def _study(**changed: Any) -> Any:
    content: dict[str, Any] = {
        "scene": {"scene": {"kind": "impact"}},
        "vary": {"mass": {"lower": 1.0, "upper": 2.0, "steps": 2}},
        "results": {"features": ["contact.peak"]},
    }
    return bj.study(content | changed, "/nonexistent/never/written")


def _of_studies() -> list[Attack]:
    def vary(**more: Any) -> Any:
        return _study(vary={"mass": {"lower": 1.0, "upper": 2.0, "steps": 2} | more})

    scenes = {
        "impact": "impakt",
        "number": 3,
        "empty": {},
        "kind": {"kind": "impact"},
        "nothing": {"scene": {}},
        "list": [],
    }
    return [
        *_each("study", "what", NO_TABLES, lambda b: bj.study(b, "/nonexistent/out")),
        *_each("study", "lower", NO_NUMBERS, lambda b: vary(lower=b)),
        *_each("study", "upper", NO_NUMBERS, lambda b: vary(upper=b)),
        *_each("study", "steps", NO_COUNTS, lambda b: vary(steps=b), ("None",)),
        *_each("study", "features", NO_NAMES, lambda b: _study(results={"features": b}), ("empty", "None")),
        *_each("study", "scene", scenes, lambda b: _study(scene=b)),
    ]


def _of_parts() -> list[Attack]:
    """Scenes and mechanisms of bad parts."""

    class Lawless(bj.laws.AbstractLaw):
        pass

    class Gapless(bj.gaps.AbstractGap):
        pass

    parts = {"None": None, "unknown": "rubbber", "number": 3, "list": [], "class": Lawless, "object": object()}
    counts = {"none": 0, "negative": -3, "text": "three", "half": 2.5, "None": None}
    plane = bj.gaps.SphereOnPlane()
    return [
        Attack("a law without needs and force", "made", "", Lawless),
        Attack("a gap without faces", "made", "", Gapless),
        *_each("impact", "law", parts, lambda b: bj.scenes.impact(law=b)),
        *_each("impact", "elastic", parts, lambda b: bj.scenes.impact(elastic=b), ("None",)),
        *_each("chain", "count", counts, lambda b: bj.scenes.chain(count=b)),
        *_each("Contact", "gap", parts, lambda b: bj.Contact("c", ("a", "ground"), b)),
        *_each("Contact", "law", parts, lambda b: bj.Contact("c", ("a", "ground"), plane, b)),
        *_each("Body", "name", NO_NAMES, bj.Body, ("unknown",)),
    ]
