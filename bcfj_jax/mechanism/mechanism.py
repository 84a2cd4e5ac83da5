"""A mechanism: bodies in a tree of ideal joints, contacts with clearance between them, loads on them.

    scene = Mechanism("door", bodies, contacts, loads, given={"stiffness": 1e8, ...})

It is a model like every other (``mechanism.model``). Every loop of bodies is closed by a contact or a bush, so that what
is integrated is a plain ODE in the coordinates of the joints. The state is flat: coordinates, velocities, then what the
contacts, and bristles in joints, remember; a driven body has none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.gaps import AbstractGap
from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.contact.stiffness import LineContact
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.mechanism import checks, efforts, instruments, scenery, sizes, statics, stepping, stiff
from bcfj_jax.mechanism.bodies import GROUND
from bcfj_jax.mechanism.dynamics import Dynamics
from bcfj_jax.mechanism.model import IMPLICIT_SOLVERS, Account, Bodies, ModelTraits, Params
from bcfj_jax.mechanism.scales import DEPTH, SPEED, expected_scale

# Local error a step, in units of ``error_scale``, per unit of force error asked for: of explicit methods, derived by
# benchmarks/solve/levels.py on random impacts and bounces; of implicit ones, by benchmarks/solve/mechanisms.py.
EXPLICIT, IMPLICIT, LOOSEST = 5e-4, 1e-2, 1e-3


class Mechanism(Dynamics):
    """A mechanism, from its parts.

    Attributes:
        kind: its name.
        bodies, contacts, loads: what is in it, and all that is in it.
        own: quantities of the user's, with defaults: parameters that sizes name.
        given: default values of parameters, by name.
        end: a sensible end time [s]: a number, a parameter's name, or a function of the parameters.
        samples: output times over it.
        scale: (mechanism, params, end) -> error scale, in place of the one from the expected loads.
        more: what a scene knows beside: (params, times) -> its numbers for the envelope.
        life: numbers of materials that are not those of steel (``materials``).
        touch: time of the first contact [s] of parameters, or None; where the start alone tells it.
        longest_step: of a solver [s]; None: as long as its errors allow.
        start: "static": bodies start where they are at rest, sought from where they are placed (``mechanism.statics``); "":
            as their own starts say.
        one_by_one: whether bodies that are alike are computed one by one (``mechanism.rows``).
        implicit: whether an implicit solver takes it (``mechanism.stiff``); None: as its default values say.
    """

    def __check_init__(self):
        checks.check_structure(self)
        if self.start not in ("", "static"):
            raise InputError(f"mechanism '{self.kind}' start", quoted(self.start), "give 'static', or leave it out")

    # What it is.

    @property
    def traits(self) -> ModelTraits:
        """Implicit as ``implicit`` says, else as default values do; a period is the drive's where something is driven."""
        implicit = stiff.implicit_by_default(self) if self.implicit is None else self.implicit
        driven = any(b.drive is not None for b in self.bodies)
        history = bool(self._free or self._memory)
        return ModelTraits(stiff=implicit, history=history, turning=driven, rough=driven and history)

    def suited(self, params: Params, end: float, solver: str | None = None) -> Mechanism:
        """With ``implicit`` as the solver that is named is, or as these values say."""
        if solver is not None:
            return replace(self, implicit=solver in IMPLICIT_SOLVERS)
        return self if self.implicit is not None else replace(self, implicit=stiff.implicit(self, params, end))

    def only_law(self) -> AbstractLaw | None:
        return self.contacts[0].law if len(self.contacts) == 1 else None

    def with_law(self, law: AbstractLaw, more: Mapping[str, float]) -> Mechanism:
        """As ``AbstractModel``; the mechanism's own defaults go before ``more``."""
        (contact,) = self.contacts
        other = replace(contact, law=law)
        given = {name: value for name, value in self.given if name not in {*contact.reads} - {*other.reads}}
        own = {name: value for name, value in more.items() if name in other.reads}
        return replace(self, contacts=(other,), given=own | given)

    def first_touch(self, params: Mapping[str, float]) -> float | None:
        return None if self.touch is None else self.touch(params)

    @property
    def shows_proximity(self) -> bool:
        """Where there are contacts, or loads that begin somewhere."""
        return bool(self.contacts or self.corners)

    @property
    def unsure(self) -> bool:
        """Where a gap does not say what bends it."""
        return any(type(c.gap).bends is AbstractGap.bends for c in self.contacts)

    @property
    def unweighed(self) -> bool:
        """Where the motion of both bodies of a contact is given."""
        given = {GROUND, *(b.name for b in self.bodies if all(x.drive is not None for x in self.ancestry(b.name)))}
        return any(given.issuperset(c.between) for c in self.contacts)

    # What is worked out beside, as ``AbstractModel`` has it.

    proximity, breaks = stepping.proximity, stepping.breaks  # pyright: ignore[reportAssignmentType]
    remembered = cached_property(stepping.places)  # pyright: ignore[reportAssignmentType]
    approaches, misremembered = stepping.approaches, stepping.doubt  # pyright: ignore[reportAssignmentType]
    observe, motions, flows = instruments.observe, instruments.motions, instruments.flows  # pyright: ignore[reportAssignmentType]
    efforts = efforts.efforts  # pyright: ignore[reportAssignmentType]
    read = instruments.read  # pyright: ignore[reportAssignmentType]
    orbits, drawing, scenery = scenery.orbits, scenery.drawing, scenery.scenery  # pyright: ignore[reportAssignmentType]
    suspects = checks.suspects  # pyright: ignore[reportAssignmentType]

    @property
    def _at_rest(self) -> bool:
        """Whether places at rest are sought; there are none where every motion is given."""
        return bool(self.start and self._free)

    def check(self, params: Params, where: str = "") -> None:
        """As ``AbstractModel``; a start at rest that there is not, too."""
        shapes = {name: q.shape for name, q in self.quantities.items()} if self._at_rest else {}
        if shapes and not any(is_traced(x) or np.shape(x) != shapes.get(name) for name, x in params.items()):
            said = where or f"scene '{self.kind}'"
            checks.names_read(self, params, said)
            statics.check(self, params, said)
        checks.check_values(self, params, where)

    def completed(self, params: Params) -> Params:
        """With the state at rest where that is the start."""
        if not self._at_rest or statics.REST in params:
            return params
        return {**params, statics.REST: statics.rest(self, params).state}

    def initial_state(self, params: Params) -> Array:
        """As the bodies start, or where they are at rest."""
        return self.completed(params)[statics.REST] if self._at_rest else super().initial_state(params)

    def accounts(self, t: Array, y: Array, prepared: Params) -> dict[str, Account]:
        """Energy, and the generalised momentum of every free velocity."""
        return super().accounts(t, y, prepared) | instruments.momenta(self, t, y, prepared)

    @property
    def body_names(self) -> tuple[str, ...]:
        return tuple(b.name for b in self.ordered)

    @property
    def body_members(self) -> dict[str, int]:
        return {b.name: b.members for b in self.bodies}

    @property
    def load_names(self) -> tuple[str, ...]:
        return tuple(load.name for load in self.loads)

    def coefficient(self, params: Params, owner: str, name: str) -> Array:
        """A contact's coefficient as it reads it; else as any model's."""
        for c in self.contacts:
            if c.name == owner and name in c.reads:
                return c.coefficients(params)[name]
        return super().coefficient(params, owner, name)

    def carriers(self) -> dict[str, str]:
        """The second body, or the first where that is the ground."""
        return {c.name: c.between[0] if c.between[1] == GROUND else c.between[1] for c in self.contacts}

    # Accuracy.

    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        """Places by the penetration that the contacts are to expect, velocities by the speed (``mechanism.scales``)."""
        return self.scale(self, params, end) if self.scale is not None else expected_scale(self, params)

    def first_step(self, params: Params, scales: Array) -> Array:
        """A hundredth of the time in which the expected speed crosses the expected penetration."""
        first = sum(k or 1 for *_, k in self._placed)
        if not first:
            return jnp.asarray(1e-2 * DEPTH / SPEED)
        return 1e-2 * scales[0] / scales[first]

    def tolerance(self, force_error: float) -> float:
        """``EXPLICIT`` or ``IMPLICIT`` times the force error, at most ``LOOSEST``."""
        return min(LOOSEST, (IMPLICIT if self.traits.stiff else EXPLICIT) * force_error)

    # Checks and what is known beside.

    def require(self, params: Params, where: str = "") -> None:
        """What the equations read and nobody gave."""
        where = where or f"scene '{self.kind}'"
        checks.names_read(self, params, where)
        checks.check_inertia(self, params, where)

    def period(self, params: Params) -> tuple[float, float]:
        """One turn of the first driven hinge."""
        for b in self._driven:
            if b.joint == "hinge" and b.drive is not None and b.drive.kind in ("constant", "ramp"):
                speed = abs(float(sizes.value(b.drive.speed, b.name, "drive_speed", params)))
                if not speed > 0.0:
                    raise InputError(f"{b.name} drive", f"{speed:g} rad/s", "give a speed other than 0")
                return 2.0 * np.pi / speed, 2.0 * np.pi / speed
        if self._driven:
            found = f"none of its drives turns: {', '.join(b.name for b in self._driven)}"
            raise InputError(f"scene '{self.kind}'", found, "give the period, or interval and settle")
        return super().period(params)

    def unit_pressure(self, params: Params, contact: str, material: Mapping[str, float]) -> Array | None:
        """Of a circle, (6 E*^2/(pi^3 R^2))^(1/3), R the gap's relative radius (Johnson 1985, 4.2); of a pin ``LineContact``."""
        one = self.contact(contact)
        read: Any = one.coefficients(params)
        modulus, line = read.get("effective_modulus", material["effective_modulus"]), one.gap.line(read)
        if line is not None:
            long = read.get("contact_length", material.get("contact_length", 2.0 * line[1]))
            return LineContact(modulus, long, *line).unit_pressure
        radius = one.gap.radius(read)
        if radius is None:
            return None
        share = (6.0 * jnp.square(modulus / jnp.asarray(radius)) / jnp.pi**3) ** (1.0 / 3.0)
        return jnp.stack([share, 1.0 / 3.0, 0.0])

    def bodies_at(self, params: Params, contact: str, deepest: float) -> Bodies:
        """By the sizes that the contact's gap reads, its ``misread``, and the masses."""
        found = next(one for one in self.contacts if one.name == contact)
        read = found.coefficients(params)
        c = {name: float(np.min(np.asarray(read[name]))) for name in found.gap.needs}
        # A driven body's mass has no bearing on its motion and may be anything.
        bodies = [b for b in self.bodies if b.name in found.between and b.drive is None and not b.massless]
        mass = max((float(np.min(sizes.value(b.mass, b.name, "mass", params))) for b in bodies), default=None)
        return Bodies(found.gap.size(c), found.gap.radius(c), found.gap.misread(c, deepest), mass)

    def coordinates(self) -> dict[str, tuple[int, int]]:
        """By ``<body>.<coordinate>``; a body of one coordinate by its name."""
        found: dict[str, tuple[int, int]] = {}
        places = np.cumsum([0, *(k or 1 for *_, k in self._placed)])
        rates = places[-1] + np.cumsum([0, *(k or 1 for *_, k in self._free)])
        for b in self.ordered:
            own = [i for i, (name, key, _) in enumerate(self._placed) if name == b.name and not key.startswith("q")]
            speeds = [j for j, (name, _, _) in enumerate(self._free) if name == b.name]
            for i, j in zip(own, speeds, strict=False):
                key = b.name if len(own) == 1 else f"{b.name}.{self._placed[i][1]}"
                for m in range(b.members or 1):
                    label = f"{b.name}[{m + 1}].{self._placed[i][1]}" if b.members else key
                    found[label] = (int(places[i]) + m, int(rates[j]) + m)
        return found

    def envelope(self, params: Params, times: np.ndarray) -> tuple[dict[str, float], list[str]]:
        """What the scene knows of its place among those on which its promise was measured."""
        return (self.more(self, params, times) if self.more is not None else {}), []
