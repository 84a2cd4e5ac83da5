"""Attacks on the Python API: every verb with every kind of bad value, and what may come of it.

An attack is refused by an ``InputError`` that names a place, a finding and a remedy; or the run fails with a reason. It
never ends "ok" with a force that is not finite, and never in an error from below. ``table()`` makes them;
``test_attacks.py`` runs all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
NO_TIMES: dict[str, Any] = {
    "None": None, "number": 1.0, "text": "soon", "empty": [], "nan": [0.0, NAN], "inf": [0.0, INF], 
    "falling": [0.0, 2.0, 1.0],
    "equal": [0.0, 1.0, 1.0], "matrix": np.zeros((2, 2)), "texts": ["a", "b"], "dict": {},
    "complex": [0.0, 1j], "object": object(),
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
    return [*_of_values(), *_of_the_rest(), *_of_designs(), *_of_calibrations(), *_of_studies(), *_of_parts()]


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


def _of_values() -> list[Attack]:
    """Bad models, tables, times and values to every verb."""
    scene, params, times = _scene()
    found = []
    for verb, call in _verbs().items():
        for label, bad in NO_MODELS.items():
            found.append(Attack(verb, "scene", label, lambda c=call, b=bad: c(b, params, times)))
        for label, bad in NO_TABLES.items():
            found.append(Attack(verb, "params", label, lambda c=call, b=bad: c(scene, b, times)))
        for label, bad in NO_TIMES.items():
            found.append(Attack(verb, "times", label, lambda c=call, b=bad: c(scene, params, b)))
        for label, bad in NO_NUMBERS.items():
            found.append(Attack(verb, "mass", label, lambda c=call, b=bad: c(scene, {**params, "mass": b}, times)))
        for name, values in OUT_OF_RANGE.items():
            for bad in values:
                given = {**params, name: bad}
                found.append(Attack(verb, name, f"{bad:g}", lambda c=call, g=given: c(scene, g, times)))
        for name in params:
            given = {key: value for key, value in params.items() if key != name}
            found.append(Attack(verb, name, "missing", lambda c=call, g=given: c(scene, g, times)))
    for label, bad in NO_NUMBERS.items():
        if "array" not in label and label != "list":
            found.append(Attack("parameters", "mass", label, lambda b=bad: scene.parameters(mass=b)))
    for label, bad in NO_TABLES.items():
        if label not in ("None", "empty"):
            found.append(Attack("parameters", "values", label, lambda b=bad: scene.parameters(b)))
    return found


def _of_the_rest() -> list[Attack]:
    """Bad options to the verbs that take them."""
    given = _scene()
    verbs = _verbs()
    calls: dict[tuple[str, str], Callable[[Any], Any]] = {
        ("simulate", "accuracy"): lambda bad: bj.simulate(*given, accuracy=bad),
        ("force_history", "accuracy"): lambda bad: bj.force_history(*given, accuracy=bad),
        ("sensitivity", "accuracy"): lambda bad: bj.sensitivity(*given, "mass", accuracy=bad),
    }
    found = [
        Attack(*key, k, lambda c=call, b=bad: c(b)) for key, call in calls.items() for k, bad in NO_OPTIONS.items()
    ]
    counts: dict[tuple[str, str], Callable[[Any], Any]] = {
        ("simulate", "max_steps"): lambda bad: bj.simulate(*given, max_steps=bad),
        ("sensitivity", "max_steps"): lambda bad: bj.sensitivity(*given, "mass", max_steps=bad),
        ("sensitivity", "levels"): lambda bad: bj.sensitivity(*given, "mass", levels=bad),
    }
    found += [
        Attack(*key, k, lambda c=call, b=bad: c(b)) for key, call in counts.items() for k, bad in NO_COUNTS.items()
    ]
    names: dict[tuple[str, str], Callable[[Any], Any]] = {
        ("sensitivity", "wrt"): lambda bad: bj.sensitivity(*given, bad),
        ("hessian_vector", "wrt"): lambda bad: bj.hessian_vector(*given, "contact.mean", bad, [1.0]),
        ("reading_history", "read"): lambda bad: bj.reading_history(*given, bad),
        ("simulate", "read"): lambda bad: bj.simulate(*given, read=bad),
        ("sensitivity", "features"): lambda bad: bj.sensitivity(*given, "mass", features=bad),
    }
    # No reading and no feature is an answer, not an attack.
    fine = {"reading_history": ("empty", "dict"), "simulate": ("empty", "dict"), "sensitivity": ("empty", "dict")}
    found += [
        Attack(verb, what, k, lambda c=call, b=bad: c(b))
        for (verb, what), call in names.items()
        for k, bad in NO_NAMES.items()
        if what == "wrt" or k not in fine[verb]
    ]
    words = ("", "unknown", None, 3, NAN, [], {}, object())
    for verb, what in (
        ("simulate", "solver"),
        ("force_history", "mode"),
        ("sensitivity", "mode"),
        ("sensitivity", "differences"),
    ):
        call = {"sensitivity": lambda **more: bj.sensitivity(*given, "mass", **more)}.get(
            verb, lambda v=verb, **more: verbs[v](*given, **more)
        )
        for bad in words:
            if not (what == "solver" and bad is None):
                found.append(Attack(verb, what, repr(bad)[:20], lambda c=call, w=what, b=bad: c(**{w: b})))
    found += [
        Attack("sensitivity", "average", k, lambda b=bad: bj.sensitivity(*given, "mass", average=b))
        for k, bad in NO_NUMBERS.items()
    ]
    found += [
        Attack("hessian_vector", "vector", k, lambda b=bad: bj.hessian_vector(*given, "contact.mean", ("mass",), b))
        for k, bad in NO_NUMBERS.items()
    ]
    return found


def _of_designs() -> list[Attack]:
    given = _scene()

    def design(objective: Any = "contact.peak", free: Any = None, **more: Any) -> Any:
        return bj.design(*given, objective, {"damping": (0.0, 1.0)} if free is None else free, starts=2, **more)

    found = [Attack("design", "objective", k, lambda b=bad: design(b)) for k, bad in NO_NAMES.items()]
    found += [
        Attack("design", "free", k, lambda b=bad: design(free={"damping": b}))
        for k, bad in NO_NUMBERS.items()
        if "array" not in k and k != "list"
    ]
    found += [
        Attack("design", "upper", k, lambda b=bad: design(free={"damping": (0.0, b)})) for k, bad in NO_NUMBERS.items()
    ]
    found += [
        Attack("design", "tolerance", k, lambda b=bad: design(free={"damping": (0.0, 1.0, b)}))
        for k, bad in NO_NUMBERS.items()
    ]
    tables = {k: bad for k, bad in NO_TABLES.items() if bad is not None}
    found += [Attack("design", "free", k, lambda b=bad: design(free=b)) for k, bad in tables.items()]
    for what in ("samples", "iterations"):
        found += [Attack("design", what, k, lambda w=what, b=bad: design(**{w: b})) for k, bad in NO_COUNTS.items()]
    for what in ("sense", "distribution"):
        found += [
            Attack("design", what, repr(bad)[:20], lambda w=what, b=bad: design(**{w: b}))
            for bad in ("", "up", None, 3, [])
        ]
    numbers = {k: bad for k, bad in NO_NUMBERS.items() if k not in ("no unit",)}
    found += [Attack("design", "kappa", k, lambda b=bad: design(kappa=b)) for k, bad in numbers.items()]
    found += [Attack("design", "max_steps", k, lambda b=bad: design(max_steps=b)) for k, bad in NO_COUNTS.items()]
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
    found = []
    # A stiffness and a share need no unit.
    numbers = {k: bad for k, bad in NO_NUMBERS.items() if k not in ("None", "no unit")}
    for what in ("lower", "upper", "start"):
        found += [
            Attack("calibration.Free", what, k, lambda w=what, b=bad: _problem(bounds={w: b}))
            for k, bad in numbers.items()
        ]
    found += [
        Attack("calibration.Free", "name", k, lambda b=bad: _problem(bounds={"name": b})) for k, bad in NO_NAMES.items()
    ]
    for what in ("sigma", "relative", "correlation", "jitter"):
        found += [
            Attack("calibration.Channel", what, k, lambda w=what, b=bad: _problem(channel={w: b}))
            for k, bad in numbers.items()
        ]
    found += [
        Attack("calibration.Channel", "values", k, lambda b=bad: _problem(channel={"values": b}))
        for k, bad in NO_NUMBERS.items()
    ]
    found += [
        Attack("calibration.Channel", "observes", k, lambda b=bad: _problem(channel={"observes": b}))
        for k, bad in NO_NAMES.items()
    ]
    found += [
        Attack("calibration.Experiment", "times", k, lambda b=bad: _problem(record={"times": b}))
        for k, bad in NO_TIMES.items()
    ]
    found += [
        Attack("calibration.Problem", "scene", k, lambda b=bad: _problem(scene=b)) for k, bad in NO_MODELS.items()
    ]
    tables = {k: bad for k, bad in NO_TABLES.items() if k != "empty"}
    found += [Attack("calibration.Problem", "params", k, lambda b=bad: _problem(params=b)) for k, bad in tables.items()]
    for what in ("experiments", "free"):
        found += [
            Attack("calibration.Problem", what, k, lambda w=what, b=bad: _problem(**{w: b}))
            for k, bad in NO_NAMES.items()
        ]
    found += [
        Attack("calibration.Problem", "loss", repr(bad)[:20], lambda b=bad: _problem(loss=b))
        for bad in ("", "up", None, 3, [])
    ]
    found += [
        Attack("calibration.Problem", "adequate", k, lambda b=bad: _problem(adequate=b)) for k, bad in numbers.items()
    ]
    found += [Attack("calibration.fit", "problem", k, lambda b=bad: calibration.fit(b)) for k, bad in NO_MODELS.items()]
    return found


def _study(**changed: Any) -> Any:
    content: dict[str, Any] = {
        "scene": {"scene": {"kind": "impact"}},
        "vary": {"mass": {"lower": 1.0, "upper": 2.0, "steps": 2}},
        "results": {"features": ["contact.peak"]},
    }
    return bj.study(content | changed, "/nonexistent/never/written")


def _of_studies() -> list[Attack]:
    def vary(**more: Any) -> Any:
        return {"vary": {"mass": {"lower": 1.0, "upper": 2.0, "steps": 2} | more}}

    found = [Attack("study", "what", k, lambda b=bad: bj.study(b, "/nonexistent/out")) for k, bad in NO_TABLES.items()]
    for what in ("lower", "upper"):
        found += [
            Attack("study", what, k, lambda w=what, b=bad: _study(**vary(**{w: b}))) for k, bad in NO_NUMBERS.items()
        ]
    found += [
        Attack("study", "steps", k, lambda b=bad: _study(**vary(steps=b)))
        for k, bad in NO_COUNTS.items()
        if bad is not None
    ]
    found += [
        Attack("study", "features", k, lambda b=bad: _study(results={"features": b}))
        for k, bad in NO_NAMES.items()
        if k not in ("empty", "None")
    ]
    scenes = {
        "impact": "impakt",
        "number": 3,
        "empty": {},
        "kind": {"kind": "impact"},
        "nothing": {"scene": {}},
        "list": [],
    }
    return found + [Attack("study", "scene", k, lambda b=bad: _study(scene=b)) for k, bad in scenes.items()]


def _of_parts() -> list[Attack]:
    """Scenes and mechanisms of bad parts."""

    class Lawless(bj.laws.AbstractLaw):
        pass

    class Gapless(bj.gaps.AbstractGap):
        pass

    bad_parts: Mapping[str, Any] = {
        "None": None,
        "unknown": "rubbber",
        "number": 3,
        "list": [],
        "class": Lawless,
        "object": object(),
    }
    found = [Attack("impact", "law", k, lambda b=bad: bj.scenes.impact(law=b)) for k, bad in bad_parts.items()]
    found += [
        Attack("impact", "elastic", k, lambda b=bad: bj.scenes.impact(elastic=b))
        for k, bad in bad_parts.items()
        if bad is not None
    ]
    for label, bad in {"none": 0, "negative": -3, "text": "three", "half": 2.5, "None": None}.items():
        found.append(Attack("chain", "count", label, lambda b=bad: bj.scenes.chain(count=b)))
    found += [
        Attack("a law without needs and force", "made", "", Lawless),
        Attack("a gap without faces", "made", "", Gapless),
    ]
    found += [
        Attack("Contact", "gap", k, lambda b=bad: bj.Contact("c", ("a", "ground"), b)) for k, bad in bad_parts.items()
    ]
    found += [
        Attack("Contact", "law", k, lambda b=bad: bj.Contact("c", ("a", "ground"), bj.gaps.SphereOnPlane(), b))
        for k, bad in bad_parts.items()
    ]
    found += [Attack("Body", "name", k, lambda b=bad: bj.Body(b)) for k, bad in NO_NAMES.items() if k != "unknown"]
    return found
