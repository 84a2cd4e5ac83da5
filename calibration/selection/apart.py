"""The contacts of a drop one by one, where no law follows the whole record: what flights and impulses say, and a fit of each.

Between two flights the speeds v before and e v after a contact are known, and with its impulse the mass, whatever the law
and whatever low-pass there is (``data.flights``). With these each contact is an impact under gravity that loses what its flights
say: neither how the loss goes with the speed nor how flights add up is asked of a law, and only the elastic force is sought. A
filter is sought in them as in any record of impacts (``uncertainty.unstated_filter``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bcfj_jax import scenes
from bcfj_jax.contact import laws
from bcfj_jax.io.page import brief
from calibration.diagnostics.catalogue import GAIN
from calibration.fit import Conditional, Fit, Parameter
from calibration.impacts.events import contacts
from calibration.impacts.flights import Passage, passages
from calibration.problem import Channel, Experiment, Free, Problem
from calibration.selection.supposed import STANDS, with_another

# Contacts that are fitted, at least and at most; samples of each; starts of the fit.
_FEWEST, _MOST, _SAMPLES, _STARTS = 2, 6, 100, 4
# What a speed by flights may be wrong by, in samples of the clock; the clock's bounds, in samples and durations.
_ENDS, _LATE = 1.0, (2.0, 0.25)
_KEPT = (0.05, 1.0)
# Of the measuring chain what single contacts show.
_SENSOR = ("cutoff", "bandwidth", "resonance", "resonance_damping", "gain_bend")
# Kind of the intervals that flights and impulses give, and on what condition they hold.
KIND = "flights"
# Of the table of contacts: by attribute of a ``Passage`` its name and unit.
_COLUMNS = {
    "begin": ("at", "s"), "speed": ("speed", "m/s"), "kept": ("e", "1"), "impulse": ("impulse", "N s"),
    "mass": ("mass", "kg"), "duration": ("duration", "s"), "peak": ("peak", "N"),
}  # fmt: skip
_FREELY = "bodies fall freely between contacts"
_ALONE = "each contact loses what its flights say, as force and rate go"


def with_contacts_apart(problem: Problem, found: Fit) -> Fit:
    """A fit of a drop that gives no interval, with what its contacts say one by one: ``conditional``, ``check["flights"]``.

    Unchanged where the fit stands by itself, and where fewer than two contacts lie between flights.
    """
    seen = _passages(problem)
    every = [one for _, passing in seen for one in passing]
    if len(every) < _FEWEST:
        return found
    found = replace(found, check={**found.check, "flights": [_row(e, one) for e, passing in seen for one in passing]})
    if found.verdict in STANDS or (found.conditional and not problem.doubts):
        return found
    known = _known(problem, every)
    found = replace(found, conditional=Conditional(_FREELY, known, None) if known else None)
    # Of an impact's own coordinates, such as each clock, nothing is said of the drop.
    return with_another(found, single_impacts(problem, seen), _STARTS, "contacts one by one", [_FREELY, _ALONE], known)


def _passages(problem: Problem) -> list[tuple[Experiment, list[Passage]]]:
    """Contacts between flights of every record of a drop that is fitted, with its force."""
    names, free = problem.scene.quantities, {f.name for f in problem.free}
    if "drop_height" not in names or "gravity" in free or problem.scene.only_law() is None:
        return []
    found = []
    for e in problem.experiments:
        channel = next((c for c in e.channels if c.observes == "contact.normal"), None)
        gravity = (problem.params | e.fixed).get("gravity", 0.0)
        if channel is None or e.hold_out or not gravity > 0.0:
            continue
        events = contacts(channel.observes, e.times, channel.values)
        found.append((e, passages(e.times, channel.values, events, gravity)))
    return found


def _row(e: Experiment, one: Passage) -> dict[str, Any]:
    return {"experiment": e.name, **{key: getattr(one, key) for key in _COLUMNS}}


def _known(problem: Problem, every: Sequence[Passage]) -> dict[str, Parameter]:
    """Mass and restitution by flights and impulses, if they are sought: of contacts that differ, the hull of what each says."""
    free, found = {f.name for f in problem.free}, {}
    kept = np.array([one.kept for one in every])
    if "mass" in free:
        mass, reach = _mean_mass(every)
        wider = float(np.hypot(reach, GAIN * mass))
        found["mass"] = _parameter(mass, "kg", (mass - reach, mass + reach), (mass - wider, mass + wider))
    if "restitution" in free:
        ends = (float(kept.min()), float(kept.max()))
        found["restitution"] = _parameter(float(np.median(kept)), "1", ends, ends)
    return found


def _mean_mass(every: Sequence[Passage]) -> tuple[float, float]:
    """Mean of the contacts' masses, and twice its deviation [kg]."""
    masses = np.array([one.mass for one in every])
    return float(masses.mean()), 2.0 * float(np.std(masses, ddof=1)) / float(np.sqrt(masses.size))


def _parameter(value: float, unit: str, ends: tuple[float, float], wider: tuple[float, float]) -> Parameter:
    return Parameter(value, unit, ends, True, "", KIND, intervals={KIND: ends}, headline=KIND, with_budget=wider)


def single_impacts(problem: Problem, seen: Sequence[tuple[Experiment, Sequence[Passage]]]) -> Problem:
    """Contacts between flights as records of impacts, with speed, restitution and mass given: F = K d^n (1 + a d') or with
    another elastic force, where a is what the restitution of each contact makes it.
    """
    elastic, exact = getattr(problem.scene.only_law(), "elastic", None), laws.make("exact")
    law: Any = exact if elastic is None else replace(exact, elastic=elastic)
    scene = scenes.impact(gravity=True).with_law(law, dict(problem.scene.defaults))
    shared = {name: value for name, value in problem.params.items() if name in scene.quantities}
    params = {**scene.parameters({"restitution": 1.0}), **shared, "clearance_contact": 0.0}
    kept = {*law.needs, *_SENSOR} - {"restitution", "approach_speed"}
    free = [replace(f, start=None) for f in problem.free if f.name in kept]
    every = [(e, one) for e, passing in seen for one in passing]
    picked = [every[k] for k in np.unique(np.linspace(0, len(every) - 1, _MOST).round().astype(int))]
    mass, reach = _mean_mass([one for _, one in every])
    sought = "mass" in {f.name for f in problem.free}
    experiments, late = [], 0.0
    for k, (e, one) in enumerate(picked):
        channel = next(c for c in e.channels if c.observes == "contact.normal")
        step, width = max(1, one.clock.size // _SAMPLES), float(np.median(np.diff(one.clock)))
        gravity = (problem.params | e.fixed)["gravity"]
        fixed = {name: x for name, x in e.fixed.items() if name in {*scene.quantities, *_SENSOR}}
        fixed |= {"approach_speed": one.speed, "gravity": gravity, "restitution": float(np.clip(one.kept, *_KEPT))}
        wrong = 0.5 * gravity * _ENDS * width
        tolerances = {"approach_speed": wrong, "restitution": wrong * (1.0 + one.kept) / one.speed}
        if sought:
            fixed["mass"], tolerances["mass"] = mass, reach
        late = max(late, _LATE[0] * width + _LATE[1] * one.duration)
        read = Channel(channel.observes, one.force[::step], channel.sigma, channel.relative)
        experiments.append(
            Experiment(f"contact {k + 1} of {e.name}", one.clock[::step], (read,), fixed=fixed, tolerances=tolerances)
        )
    return replace(
        problem, scene=scene, params=params, experiments=tuple(experiments),
        free=(*free, Free("time_offset", -late, late)), tolerances={}, doubts=(), accuracy=0.0,
    )  # fmt: skip


HEADING = (
    "Contacts between flights, without a law: speed and restitution e by the flights, mass by the impulse over the change of "
    "speed. No low-pass changes these; a gain that is wrong goes into impulse and mass"
)


def rows(found: Fit) -> list[list[str]]:
    """A row a contact; none where no flights are known, or the fit stands without them."""
    seen = found.check.get("flights", [])
    if not seen or found.verdict in STANDS:
        return []
    cells = [[brief(one[key], unit) for key, (_, unit) in _COLUMNS.items()] for one in seen]
    head = ["record", *(name for name, _ in _COLUMNS.values())]
    return [head, *([one["experiment"], *own] for one, own in zip(seen, cells, strict=True))]
