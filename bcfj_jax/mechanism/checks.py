"""What is refused of a mechanism before anything is compiled, each with the place, the value and what would be right."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.contact.gaps import SphereInSocket, SphereOnSphere
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.numerics import is_traced, positive
from bcfj_jax.core.vectors import length, spread
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.arrays import refuse_traced
from bcfj_jax.mechanism.bodies import GROUND, principal, refuse_impossible
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.loads import LOADS, CoordinateLoad, Spring, checked
from bcfj_jax.mechanism.scales import expected, known_at
from bcfj_jax.mechanism.sizes import Params, check_fields, nothing
from bcfj_jax.xla import programs

# Bodies that overlap at the start by more than so many times the penetration that is to be expected were not placed
# there; an overlap below the second [m] is rounding.
_DEEP, _TOUCH = 20.0, 1e-9
# Least eigenvalue of a mass matrix whose diagonal is 1.
_REGULAR = 1e-12
# What a load acts by, if it has them.
_ACTING = ("stiffness", "damping", "turning_stiffness", "turning_damping")
# Of joint "sphere".
_SPHERE, _FREE = "sphere: its rotation is not computed", "give it joint = 'free', or put this part on the other body"


def check_structure(scene: Dynamics) -> None:
    """Refuse bodies, contacts and loads that do not make a mechanism."""
    where = f"mechanism {quoted(scene.kind)}"
    if not scene.bodies:
        raise InputError(where, "has no bodies", "list at least one")
    check_fields(where, scene)
    for load in scene.loads:
        checked(f"{where} load", load)
    _check_tree(scene, where)
    names: dict[str, str] = {b.name: "body" for b in scene.bodies}
    for part, what in [*((c, "contact") for c in scene.contacts), *((x, "load") for x in scene.loads)]:
        _check_static(f"{where} {type(part).__name__.lower()} '{part.name}'", part)
        if part.name in names and not (what == "load" and part.name == "gravity" and names[part.name] != "load"):
            found = f"the name '{part.name}' already belongs to a {names[part.name]}"
            raise InputError(f"{where} {what}", found, "give another name")
        names[part.name] = what
    _check_contacts(scene, where)
    _check_loads(scene, where)
    for name, _ in scene.given:
        if scene.canonical(name) not in scene.quantities:
            found = f"no parameter '{name}'"
            raise InputError(f"{where} defaults", found, nearest(name, scene.quantities))


def _check_tree(scene: Dynamics, where: str) -> None:
    parents: dict[str, str] = {}
    for b in scene.bodies:
        if b.name in parents:
            remedy = (
                "give every body a name of its own; where one body hangs on two others, its second joint would close a loop: "
                "make that a contact with clearance, or a bush"
            )
            raise InputError(f"{where} body '{b.name}'", f"two bodies have the name '{b.name}'", remedy)
        parents[b.name] = b.parent
    for b in scene.bodies:
        place, parent = f"{where} body '{b.name}' parent", None if b.parent == GROUND else b.parent
        if parent is not None and parent not in parents:
            raise InputError(place, f"no body '{parent}'", nearest(parent, [*parents, GROUND]))
        if parent is not None and scene.body(parent).members:
            raise InputError(place, f"'{parent}' has members", "give a parent without members")
        if parent is not None and scene.body(parent).joint == "sphere":
            raise InputError(place, f"'{parent}' is a {_SPHERE}", _FREE)
        chain, at = [b.name], b.parent
        while at != GROUND:
            if at in chain:
                found = f"the parents form a circle: {' on '.join([*chain, at])}"
                raise InputError(place, found, f"give one of them the parent '{GROUND}'")
            chain.append(at)
            at = parents[at]
    heavy = {one.name for b in scene.bodies if not b.massless for one in scene.ancestry(b.name)}
    for b in scene.bodies:
        if b.name not in heavy and b.drive is None and b.rates:
            remedy = "give it a mass, hang a body with a mass on it, or drive it"
            raise InputError(
                f"{where} body '{b.name}' mass", "has no mass, and nothing that has one hangs on it", remedy
            )


def _check_known(scene: Dynamics, where: str) -> None:
    """Refuse contacts and loads between bodies that are not there."""
    known = [*(b.name for b in scene.bodies), GROUND]
    named = [(f"contact '{c.name}' between", c.between) for c in scene.contacts]
    for what, bodies in [*named, *((f"load '{load.name}'", load.touches) for load in scene.loads)]:
        for body in bodies:
            if body not in known:
                raise InputError(f"{where} {what}", f"no body '{body}'", nearest(body, known))


def _check_contacts(scene: Dynamics, where: str) -> None:
    _check_known(scene, where)
    for c in scene.contacts:
        for body, place in zip(c.between, c.at, strict=True):
            round_ = body != GROUND and scene.body(body).joint == "sphere"
            faces = body == c.between[0] and not isinstance(c.gap, (SphereOnSphere, SphereInSocket))
            if round_ and (faces or any(place)):
                what = f"{type(c.gap).__name__} on" if faces else "a place off the centre of"
                raise InputError(f"{where} contact '{c.name}'", f"{what} '{body}', a {_SPHERE}", _FREE)
        counts = {scene.body(b).members for b in c.between if b != GROUND and scene.body(b).members}
        counts |= {c.gap.members} if c.gap.members else set()
        if len(counts) > 1:
            found = f"the bodies and the gap have different numbers of members: {sorted(counts)}"
            raise InputError(f"{where} contact '{c.name}'", found, "give all of them the same number")


def _check_loads(scene: Dynamics, where: str) -> None:
    for load in scene.loads:
        if isinstance(load, CoordinateLoad):
            bodies = [None if name == GROUND else scene.body(name) for name in load.coordinates]
            moves = any(b is not None and b.drive is None for b in bodies)
            for name, b in zip(load.coordinates, bodies, strict=True):
                free = 0 if b is None else len(b.rates)
                # Of two joints one may be driven; friction of a joint that is driven costs its drive a force.
                if free != 1 and not ((moves or load.dry) and b is not None and b.drive is not None):
                    found = f"'{name}' has {free} free coordinates"
                    remedy = "give a body that slides or hinges freely"
                    raise InputError(f"{where} load '{load.name}' body", found, remedy)
    for load in (x for x in scene.loads if type(x) in LOADS.values()):
        acting = [getattr(load, name) for name in _ACTING if hasattr(load, name)]
        if acting and all(map(nothing, acting)) and getattr(load, "table", None) is None:
            found = "its stiffness and damping are 0: it does nothing"
            raise InputError(f"{where} load '{load.name}'", found, "give one of them, or a table where it takes one")
        if not isinstance(load, CoordinateLoad) and load.touches in ((GROUND,), (load.acts_on, load.acts_on)):
            found = f"it acts on '{load.acts_on}' alone: it moves nothing"
            raise InputError(
                f"{where} load '{load.name}'", found, "give a body that moves, of two ends two that differ"
            )


def _check_static(where: str, part: Any) -> None:
    """Refuse a part with traced values, or with a field that no program can be found by."""
    refuse_traced(where, part)
    try:
        hash(part)
    except TypeError as error:
        remedy = "give tuples in place of lists, and arrays as fields of an equinox module that are not static"
        raise InputError(where, f"is not hashable: {error}", remedy) from None


class _Recorder(Mapping):
    """Parameters that remember which of them were read, and say which is missing."""

    def __init__(self, values: Mapping[str, Array], scene: Dynamics, where: str) -> None:
        self.values_, self.scene, self.where, self.read = values, scene, where, set()

    def __getitem__(self, name: str) -> Array:
        if name in self.values_:
            self.read.add(name)
            return self.values_[name]
        if name not in self.scene.quantities:
            remedy = f"{nearest(name, self.scene.quantities)} Declare quantities of your own in ``own``"
            raise InputError(self.where, f"no parameter '{name}'", remedy)
        owners = [known.rpartition(".")[0] for known in self.scene.quantities if known.endswith(f".{name}")]
        missing = [owner for owner in owners if owner and f"{owner}.{name}" not in self.values_]
        if name == "mass" and missing:
            remedy = f"a body that moves needs a mass: give {missing[0]}.mass, or mass for all bodies"
            raise InputError(f"{self.where} body '{missing[0]}' mass", f"no mass for {', '.join(missing)}", remedy)
        if name == "inertia" and missing:
            turned = [b for b in missing if b in self.scene.body_names and not self.scene.body(b).turns]
            why = f"'{turned[0]}' turns with '{self.scene.body(turned[0]).parent}', which carries it" if turned else ""
            remedy = f"a body that turns needs an inertia about its centre of mass: give {missing[0]}.inertia"
            found = f"no inertia for {', '.join(missing)}{f'; {why}' if why else ''}"
            raise InputError(f"{self.where} body '{missing[0]}' inertia", found, remedy)
        reads = f"; it is read by {', '.join(missing)}" if missing else ""
        beside = f", or {missing[0]}.{name}" if missing else ""
        in_file = f"; in a scene file: [parameters] {name} = ..., also of a parameter that is fitted"
        raise InputError(self.where, f"the parameter '{name}' has no value{reads}", f"give {name}{beside}{in_file}")

    def __contains__(self, name: object) -> bool:
        if name in self.values_:
            self.read.add(name)
        return name in self.values_

    def __iter__(self) -> Iterator[str]:
        return iter(self.values_)

    def __len__(self) -> int:
        return len(self.values_)


@lru_cache(maxsize=256)
def _read(scene: Dynamics, names: tuple[str, ...], where: str) -> frozenset[str]:
    """Names that the equations read, of parameters that have a value; traced abstractly, not compiled."""
    seen: set[str] = set()

    def everything(values: dict[str, Array]) -> Array:
        p = _Recorder(values, scene, where)
        # A rest that is sought reads nothing else.
        y = scene.recalling(scene.placed_state(p), p)
        rates = scene.vector_field(jnp.zeros(()), y, p)
        scene.read(jnp.zeros(()), y, p)
        scene.horizon(p)
        seen.update(p.read)
        return rates

    known = scene.quantities
    jax.eval_shape(everything, {name: jax.ShapeDtypeStruct(known[name].shape, jnp.float64) for name in names})
    return frozenset(seen)


def names_read(scene: Dynamics, params: Params, where: str) -> frozenset[str]:
    """Names of the parameters that the mechanism's equations read."""
    return _read(scene, tuple(params), where)


def check_inertia(scene: Dynamics, params: Params, where: str) -> None:
    """Refuse three moments of inertia that no body has; traced and batched ones pass."""
    for body in scene.bodies:
        moments = scene.inertia(body, params)
        if isinstance(moments, tuple) and not any(is_traced(x) or np.ndim(x) for x in moments):
            refuse_impossible(f"{where} body '{body.name}' inertia", principal(moments))


def check_values(scene: Dynamics, params: Params, where: str = "") -> None:
    """Refuse values that no run can answer; batched and traced ones pass."""
    where = where or f"scene '{scene.kind}'"
    inputs.values(scene, params, where)
    read = _read(scene, tuple(params), where)
    for quantity, _ in scene.own:
        if quantity.name not in read:
            remedy = "use its name in a size or a coefficient, or remove the parameter"
            raise InputError(where, f"nothing reads the parameter '{quantity.name}'", remedy)
    known = scene.quantities
    if any(is_traced(x) or np.shape(x) != known[name].shape for name, x in params.items()):
        return
    for c in scene.contacts:
        wrong = c.gap.impossible({name: float(np.asarray(x).min()) for name, x in c.coefficients(params).items()})
        if wrong is not None:
            raise InputError(f"{where} contact '{c.name}'", *wrong)
        # With a regularisation a law is asked of what overlaps alone; those of the package are 0 apart.
        if c.smoothing or type(c.law).__module__.startswith("bcfj_jax."):
            continue
        apart = c.law.force(jnp.array([-1e-6, -1e-3]), jnp.zeros(2), known_at(c, jnp.ones(()), params))
        if np.any(np.asarray(apart) != 0.0):
            found = f"its law {type(c.law).__name__} bears {np.min(apart):.3g} N where the surfaces are apart"
            remedy = "make it 0 there: jnp.maximum(penetration, 0.0) in place of penetration"
            raise InputError(f"{where} contact '{c.name}' law", found, remedy)
    _check_start(scene, dict(scene.completed(params)), where)


def suspects(scene: Dynamics, params: Params) -> np.ndarray:
    """Which of N runs (leaves (N,), in their ranges) ``check_values`` must look at one by one: it passes the others."""
    first = {name: leaf[0] for name, leaf in params.items()}
    every = np.ones(len(next(iter(params.values()))), bool)
    try:
        # What does not depend on values, and what the others share with the first.
        check_values(scene, first)
    except InputError:
        return every
    if any(c.smoothing and "approach_speed" in c.law.needs for c in scene.contacts):
        return every
    depths, expected, _ = programs.ask("starts", _starts, (scene,), (dict(params),))
    deepest = np.max([np.asarray(depth) for depth in depths.values()], axis=0, initial=-np.inf)
    # Not what is deep: what is not known to be no deeper than that, so that a NaN is looked at.
    return every & ~(deepest <= np.maximum(_DEEP * np.asarray(expected), _TOUCH))


def _check_start(scene: Dynamics, params: dict[str, Array], where: str) -> None:
    if any(b.massless and b.rates and not b.members for b in scene.bodies):
        _check_masses(scene, params, where)
    _check_regularisation(scene, params, where)
    for name, far in (asked(_lengths, scene, params) if _pushing(scene) else {}).items():
        if not np.min(far) > 0.0:
            found = "both ends are at one place at the start, where its force has no direction"
            raise InputError(f"{where} load '{name}'", found, "place them apart, or leave free_length out")
    depths, expected, speed = asked(_at_start, scene, params)
    deep = []
    for name, depth in depths.items():
        deepest = float(np.max(depth))
        if not np.isfinite(deepest):
            raise InputError(
                f"{where} contact '{name}'",
                f"the penetration at time 0 is {deepest}",
                "correct the gap of this contact, or the sizes of its bodies",
            )
        deep += [name] if deepest > max(_DEEP * float(expected), _TOUCH) else []
    # Bodies that are held in balance, such as a ball with preload, start as deep as they like.
    thrown = asked(_thrown, scene, params) if deep else {}
    for name in deep:
        if float(thrown[name]) > _DEEP * float(speed):
            a, b = scene.contact(name).between
            found = f"'{a}' and '{b}' start {float(depths[name]):.3g} m inside each other"
            remedy = (
                f"move them apart, or reduce the penetration to what their load causes (about {float(expected):.2g} m)"
            )
            raise InputError(f"{where} contact '{name}'", found, remedy)


def _check_masses(scene: Dynamics, params: dict[str, Array], where: str) -> None:
    """Refuse a start in which a joint of a body without mass moves nothing that has inertia."""
    least, way = (np.asarray(x) for x in asked(_lightest, scene, params))
    if not least > _REGULAR:
        names = [name for name, _, k in scene._velocities if not k]
        share = {name: abs(x) for x, name in zip(way, names, strict=True) if scene.body(name).massless}
        found = "it has no mass, and at the start its joint moves nothing that has inertia"
        remedy = "give it a mass and an inertia, or an inertia to what hangs on it"
        raise InputError(f"{where} body '{max(share, key=lambda name: share[name])}' mass", found, remedy)


def _lightest(scene: Dynamics, params: dict[str, Array]) -> tuple[Array, Array]:
    """Least eigenvalue of the mass matrix at the start, its diagonal being 1, and its motion; of bodies without members."""
    t, y = jnp.zeros(()), scene.initial_state(params)
    found = scene.assembled(t, scene.instant(t, y, params, laws=False), params, pressing=False)
    own = [j for j, (*_, k) in enumerate(scene._velocities) if not k]
    matrix = jnp.stack([jnp.stack([jnp.asarray(found.entry(j, k), float) for k in own]) for j in own])
    size = jnp.sqrt(jnp.diagonal(matrix))
    size = jnp.where(size > 0.0, size, 1.0)
    values, ways = jnp.linalg.eigh(matrix / size[:, None] / size)
    return values[0], ways[:, 0]


def _check_regularisation(scene: Dynamics, params: dict[str, Array], where: str) -> None:
    """Refuse a body that the contact regularisation pushes away before it has arrived.

    A law whose damping goes by the approach speed is rigid to a body that leaves faster than that.
    """
    needing = [c for c in scene.contacts if c.smoothing and "approach_speed" in c.law.needs]
    widths = {c.name: float(scene.coefficient(params, c.name, "smoothing")) for c in needing}
    if not any(widths.values()):
        return
    apart, out = asked(_stored_energy, scene, params)
    for name, width in widths.items():
        if width > 0.0 and bool(out[name]):
            gap = -float(apart[name])
            found = f"with {width:g} m the contact pushes the body away before it has arrived: it starts {gap:g} m away"
            remedy = "reduce smoothing, start further away, or use a law without restitution (memory_free)"
            raise InputError(f"{where} smoothing", found, remedy)


def _pushing(scene: Dynamics) -> list[Spring]:
    """Springs that push where they have no length."""
    return [x for x in scene.loads if isinstance(x, Spring) and x.side != "pull" and not nothing(x.free_length)]


def _lengths(scene: Dynamics, params: dict[str, Array]) -> dict[str, Array]:
    """Their lengths at the start [m]."""
    bodies = scene.instant(jnp.zeros(()), scene.initial_state(params), params, laws=False).bodies
    return {load.name: jnp.asarray(length(load.apart(bodies, params))) for load in _pushing(scene)}


def _stored_energy(scene: Dynamics, params: dict[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Penetration of each contact at time 0, and whether more is stored there than its approach brings."""
    depths, _ = _faces(scene, jnp.zeros(()), scene.initial_state(params), params)
    found = expected(scene, params)
    deepest = {name: jnp.max(depth) for name, depth in depths.items()}
    return deepest, {name: found.stored[name] > found.brought[name] for name in depths}


def asked(what: Callable[..., Any], scene: Dynamics, params: dict[str, Array]) -> Any:
    """A function of mechanism and parameters, answered without compiling, so that a bad mechanism is refused at once."""
    return programs.ask(what.__name__.strip("_"), what, (scene,), (params,))


def _at_start(scene: Dynamics, params: dict[str, Array]) -> tuple[dict[str, Array], Array, Array]:
    """Penetration of each contact at time 0, and the one and the speed that are to be expected of motion and loads."""
    p = scene.completed(params)
    depths, _ = _faces(scene, jnp.zeros(()), scene.initial_state(p), p)
    found = expected(scene, p, inside=False)
    return {name: jnp.max(depth) for name, depth in depths.items()}, found.depth, found.speed


def _starts(scene: Dynamics, params: dict[str, Array]) -> tuple[dict[str, Array], Array, Array]:
    """``_at_start`` of N runs."""
    return jax.vmap(lambda one: _at_start(scene, one))(params)


def _thrown(scene: Dynamics, params: dict[str, Array]) -> dict[str, Array]:
    """Speed [m/s] at which each contact throws its bodies apart from their start, to a factor of about 1."""
    t, y = jnp.zeros(()), scene.initial_state(params)
    motion = (jnp.ones(()), scene.vector_field(t, y, scene.prepare(params)))
    depths, _ = _faces(scene, t, y, params)
    _, gains = jax.jvp(lambda t, y: _faces(scene, t, y, params)[1], (t, y), motion)
    return {name: jnp.max(jnp.sqrt(positive(-gains[name]) * positive(depths[name]))) for name in depths}


def _faces(scene: Dynamics, t: Array, y: Array, params: Params) -> tuple[dict[str, Array], dict[str, Array]]:
    """Penetration and its rate of every face of each contact."""
    now, found = scene.instant(t, y, params, laws=False), []
    for c in scene.bundles:
        rows = [spread(x, scene.side_by_side(c)) for face, touch in now.faces[c.name] for x in (face.depth, touch.rate)]
        found.append((jnp.stack(rows[::2], -1), jnp.stack(rows[1::2], -1)))
    depths, rates = (scene.by_contact([pair[k] for pair in found]) for k in (0, 1))
    return depths, rates
