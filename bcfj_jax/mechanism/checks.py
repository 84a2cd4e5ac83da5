"""What is refused of a mechanism before anything is compiled, each with the place, the value and what would be right."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from bcfj_jax.core import host
from bcfj_jax.core.errors import InputError, nearest
from bcfj_jax.core.quantities import check_order, check_value
from bcfj_jax.mechanism.bodies import GROUND
from bcfj_jax.mechanism.loads import JointSpring

if TYPE_CHECKING:
    from bcfj_jax.mechanism.mechanism import Mechanism
    from bcfj_jax.mechanism.sizes import Params

# Bodies that overlap at the start by so many times the penetration that is to be expected were not placed there.
_DEEP = 20.0
# So many times NumPy looks at a mechanism's start; who asks more often, as a study does, gets a compiled program.
_BY_HAND = 3
_LOOKS: Counter[tuple[Mechanism, tuple[str, ...]]] = Counter()


def check_structure(scene: Mechanism) -> None:
    """Refuse bodies, contacts and loads that do not make a mechanism.

    Raises:
        InputError: for a loop of ideal joints, a cycle in the tree, a body that is not there, names given twice.
    """
    where = f"mechanism '{scene.kind}'"
    if not scene.bodies:
        raise InputError(where, "has no bodies", "list at least one")
    bodies: dict[str, str] = {}
    for b in scene.bodies:
        if b.name in bodies:
            found = f"body '{b.name}' hangs on '{bodies[b.name]}' and on '{b.parent}': joints alone would close a loop"
            remedy = "give it one parent, and close the loop by a contact with clearance or a bush"
            raise InputError(f"{where} body '{b.name}'", found, remedy)
        bodies[b.name] = b.parent
    for b in scene.bodies:
        if b.parent != GROUND and b.parent not in bodies:
            raise InputError(
                f"{where} body '{b.name}' parent", f"no body '{b.parent}'", nearest(b.parent, [*bodies, GROUND])
            )
        if b.parent != GROUND and scene.body(b.parent).members:
            raise InputError(f"{where} body '{b.name}' parent", f"'{b.parent}' has members", "members carry nothing")
        chain, at = [b.name], b.parent
        while at != GROUND:
            if at in chain:
                found = f"the tree goes round: {' on '.join([*chain, at])}"
                raise InputError(f"{where} body '{b.name}' parent", found, f"hang one of them on '{GROUND}'")
            chain.append(at)
            at = bodies[at]
    names: dict[str, str] = dict.fromkeys(bodies, "body")
    for part, what in [(c, "contact") for c in scene.contacts] + [(x, "load") for x in scene.loads]:
        if part.name in names and not (what == "load" and part.name == "gravity" and names[part.name] != "load"):
            raise InputError(
                f"{where} {what}", f"the name '{part.name}' is a {names[part.name]}'s", "give another name"
            )
        names[part.name] = what
    known = [*bodies, GROUND]
    for c in scene.contacts:
        for body in c.between:
            if body not in known:
                raise InputError(f"{where} contact '{c.name}' between", f"no body '{body}'", nearest(body, known))
        counts = {scene.body(b).members for b in c.between if b != GROUND and scene.body(b).members}
        counts |= {c.gap.members} if c.gap.members else set()
        if len(counts) > 1:
            found = f"{sorted(counts)} members side by side"
            raise InputError(f"{where} contact '{c.name}'", found, "give the bodies and the gap as many members")
    for load in scene.loads:
        for body in load.touches:
            if body not in known:
                raise InputError(f"{where} load '{load.name}'", f"no body '{body}'", nearest(body, known))
        if isinstance(load, JointSpring):
            free = len(scene.body(load.body).rates) if load.body != GROUND else 0
            if free != 1:
                found = f"'{load.body}' has {free} free coordinates"
                raise InputError(f"{where} load '{load.name}' body", found, "give a body that slides or hinges freely")
    for name, _ in scene.given:
        if scene.canonical(name) not in scene.quantities:
            found = f"no parameter '{name}'"
            raise InputError(f"{where} defaults", found, nearest(name, scene.quantities))


class _Recorder(Mapping):
    """Parameters that remember which of them were read, and say which is missing."""

    def __init__(self, values: Mapping[str, Array], scene: Mechanism, where: str) -> None:
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
        if name == "mass":
            remedy = f"a body needs one to be moved: give {missing[0]}.mass, or mass for every body without its own"
            raise InputError(f"{self.where} body '{missing[0]}' mass", f"{', '.join(missing)} without a mass", remedy)
        reads = f", which {', '.join(missing)} would read" if missing else ""
        beside = f", or {missing[0]}.{name}" if missing else ""
        raise InputError(self.where, f"the parameter '{name}' has no value{reads}", f"give {name}{beside}")

    def __contains__(self, name: object) -> bool:
        if name in self.values_:
            self.read.add(name)
        return name in self.values_

    def __iter__(self) -> Iterator[str]:
        return iter(self.values_)

    def __len__(self) -> int:
        return len(self.values_)


@lru_cache(maxsize=256)
def _read(scene: Mechanism, names: tuple[str, ...], where: str) -> frozenset[str]:
    """Names that the equations read, of parameters that have a value; traced abstractly, not compiled."""
    seen: set[str] = set()

    def everything(values: dict[str, Array]) -> Array:
        p = _Recorder(values, scene, where)
        y = scene.initial_state(p)
        rates = scene.vector_field(jnp.zeros(()), y, p)
        scene.observe(jnp.zeros(()), y, p)
        scene.horizon(p)
        seen.update(p.read)
        return rates

    shape = jax.ShapeDtypeStruct((), jnp.float64)
    jax.eval_shape(everything, dict.fromkeys(names, shape))
    return frozenset(seen)


def names_read(scene: Mechanism, params: Params, where: str) -> frozenset[str]:
    """Names of the parameters that the mechanism's equations read."""
    return _read(scene, tuple(params), where)


def check_values(scene: Mechanism, params: Params, where: str = "") -> None:
    """Refuse values that no run can answer; batched and traced ones pass.

    Raises:
        InputError: for a value that is missing or out of range, a quantity of the user's that nothing reads, code of
            the user's that raises, bodies that start deep inside each other.
    """
    where = where or f"scene '{scene.kind}'"
    known = scene.quantities
    for name, value in params.items():
        if name not in known:
            raise InputError(where, f"no parameter '{name}'", nearest(name, known))
        check_value(where, known[name], value)
    check_order(where, known, params)
    read = _read(scene, tuple(params), where)
    for quantity, _ in scene.own:
        if quantity.name not in read:
            remedy = "name it where a size or a coefficient is read from it, or take it out"
            raise InputError(where, f"nothing reads the parameter '{quantity.name}'", remedy)
    if any(isinstance(x, Tracer) or np.ndim(x) for x in params.values()):
        return
    _check_start(scene, dict(params), where)


def _check_start(scene: Mechanism, params: dict[str, Array], where: str) -> None:
    depths, expected = _looked_at(scene, params)
    for name, depth in depths.items():
        deepest = float(np.max(depth))
        if not np.isfinite(deepest):
            raise InputError(
                f"{where} contact '{name}'", f"the penetration at time 0 is {deepest}", "mend its gap or its sizes"
            )
        if deepest > _DEEP * float(expected) and deepest > 1e-9:
            a, b = scene.contact(name).between
            found = f"'{a}' and '{b}' start {deepest:.3g} m inside each other"
            remedy = f"place them apart, or no deeper than their load presses them (some {float(expected):.2g} m)"
            raise InputError(f"{where} contact '{name}'", found, remedy)


def _looked_at(scene: Mechanism, params: dict[str, Array]) -> tuple[dict[str, Array], Array]:
    """``_at_start`` by NumPy the first times, so that a bad mechanism is refused before anything is compiled."""
    key = (scene, tuple(params))
    _LOOKS[key] += 1
    if _LOOKS[key] <= _BY_HAND:
        with contextlib.suppress(host.Unknown):
            traced, shape = _traced(*key)
            found = host.evaluate(traced, [params[name] for name in sorted(params)])
            return jax.tree.unflatten(jax.tree.structure(shape), found)
    return jax.device_get(_compiled(scene, params))


@lru_cache(maxsize=64)
def _traced(scene: Mechanism, names: tuple[str, ...]) -> tuple[Any, Any]:
    shapes = dict.fromkeys(names, jax.ShapeDtypeStruct((), jnp.float64))
    return jax.make_jaxpr(partial(_at_start, scene), return_shape=True)(shapes)


def _at_start(scene: Mechanism, params: dict[str, Array]) -> tuple[dict[str, Array], Array]:
    """Penetration of each contact at time 0, and the one that is to be expected."""
    from bcfj_jax.mechanism.scales import expected

    y = scene.initial_state(params)
    now = scene.instant(jnp.zeros(()), y, params, laws=False)
    depths = {
        name: jnp.max(jnp.stack([jnp.max(jnp.asarray(face.depth)) for face, _ in touching]))
        for name, touching in now.faces.items()
    }
    return depths, expected(scene, params).depth


_compiled = jax.jit(_at_start, static_argnums=0)
