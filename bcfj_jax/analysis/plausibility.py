"""Whether the penetrations and forces of a run can be those of solid bodies; what cannot is said before all else.

A run may be solved to the last digit and mean nothing: a stiffness in another unit, a clearance along the wrong axis, a mass
in grams. A contact law is one of small penetrations d beside the bodies' size L, and of surfaces that do not yield:

    d <= 0.1 L,     p_0 = 3 F/(2 pi R d) <= 4.2 GPa

L is the least length of the bodies that the contact's gap reads (``AbstractGap.size``). Where it reads none, the limit is
d <= (m/rho)^(1/3), the edge of a cube as heavy as the heavier body and as dense as water, rho = 1000 kg/m^3: most materials of
machines are denser. p_0 is Hertz's pressure at the centre of
a patch of half-width sqrt(R d), of bodies that touch at a point of two equal curvatures (``AbstractGap.radius``). At d = 0.1 L
the patch of a sphere of radius L is 0.3 L wide, the limit of Hertz's theory; 4.2 GPa is the static limit of balls of hardened
steel (ISO 76). Where a scene says neither sizes nor masses, nothing is judged. NumPy, on the host.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.contact.stiffness import ISO_76
from bcfj_jax.core.errors import InputError
from bcfj_jax.io.page import BAD, FAIR, Verdict, brief
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.simulation import Run, simulate

# Deepest penetration beside the least length of the bodies.
DEEPEST = 0.1
WATER = 1000.0
PENETRATION, PRESSURE = "penetration", "pressure"
# What makes bodies pass into each other in a file that means something else, and what a yielding surface means.
_CAUSES = {
    PENETRATION: "check the unit of the stiffness, the masses, and the direction of the gap",
    PRESSURE: "forces are those of surfaces that stay elastic; check the load, the radii and the unit of the stiffness",
}
_NAMED = 3


class Finding(NamedTuple):
    """What of a contact cannot be: its name, ``PENETRATION`` or ``PRESSURE``, the number [m or Pa] and its largest sound one.

    ``cause``: in words, what the gap itself says of it (``AbstractGap.misread``), or a body's mass.
    """

    contact: str
    what: str
    value: float
    most: float
    cause: str = ""

    @property
    def sentence(self) -> str:
        """In words."""
        if self.cause:
            return f"{self.contact}: {self.cause}"
        if self.what == PENETRATION:
            share = f"{self.value * DEEPEST / self.most:.2g} of the smallest body's size ({brief(self.most / DEEPEST, 'm')})"
            return f"{self.contact} is pressed {brief(self.value, 'm')} deep, {share}: the bodies pass into each other"
        bears = f"above the {brief(self.most, 'Pa')} that hardened steel bears (ISO 76)"
        return f"{self.contact} has a Hertz pressure of {brief(self.value, 'Pa')}, {bears}: the surfaces yield"


def of_run(model: AbstractModel, params: Params, run: Run) -> list[Finding]:
    """What of a run is not plausible, a finding a contact at most; the times until a failure count.

    Peaks and penetrations are those of the solver's steps where they were looked at.
    """
    found = []
    for name, depth in run.penetration.items():
        steps = run.extremes.get(name)
        force = np.abs(run.force[name][..., 0]) if steps is None else np.asarray(steps.peak)
        found += of_contact(model, params, name, np.asarray(depth if steps is None else steps.deepest), force)
    return found


def of_contact(
    model: AbstractModel, params: Params, contact: str, depth: np.ndarray, force: np.ndarray
) -> list[Finding]:
    """As ``of_run``, of penetrations [m] and normal forces [N] of one contact."""
    known = [x for x in np.ravel(depth) if np.isfinite(x) and x > 0.0]
    deepest = max(known, default=0.0)
    bodies = model.bodies_at(params, contact, float(deepest))
    if bodies.size is not None and deepest > DEEPEST * bodies.size:
        return [Finding(contact, PENETRATION, float(deepest), DEEPEST * bodies.size, bodies.misread)]
    if bodies.size is None and bodies.mass and deepest > (edge := (bodies.mass / WATER) ** (1.0 / 3.0)):
        cube = f"a cube of {brief(bodies.mass, 'kg')} of water is {brief(edge, 'm')} wide"
        cause = bodies.misread or f"pressed {brief(float(deepest), 'm')} deep, more than its body can be large: {cube}"
        return [Finding(contact, PENETRATION, float(deepest), edge, cause)]
    highest = float(np.max(force, initial=0.0, where=np.isfinite(force)))
    if bodies.radius is None or not deepest:
        return []
    pressure = 1.5 * highest / (np.pi * bodies.radius * deepest)
    return [Finding(contact, PRESSURE, float(pressure), ISO_76)] if pressure > ISO_76 else []


def at(model: AbstractModel, params: Mapping[str, Any], times: np.ndarray) -> list[Finding]:
    """As ``of_run``, of a run at the level "fast"; nothing where it cannot be made."""
    try:
        return of_run(model, params, simulate(model, params, times, accuracy="fast"))
    except InputError:
        return []


def of_engineers(whole: Mapping[str, Any]) -> list[Finding]:
    """Pressures that a model knows itself (``AbstractModel.whole``), beyond what surfaces bear."""
    entries = whole.get("engineering", {}).items()
    known = {name: one["pressure"] for name, one in entries if isinstance(one, Mapping) and "pressure" in one}
    return [
        Finding(name, PRESSURE, float(x), ISO_76) for name, x in known.items() if not isinstance(x, str) and x > ISO_76
    ]


def headline(found: Sequence[Finding]) -> str:
    """What is said first: the worst finding in a sentence, the other contacts by name, and what to look at; "" for none."""
    if not found:
        return ""
    first, *others = sorted(found, key=lambda one: (one.what != PENETRATION, -one.value / one.most))
    more = ", ".join(one.contact for one in others[:_NAMED])
    more += f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
    return f"{first.sentence}{f'; so do those of {more}' if more else ''}; {_CAUSES[first.what]}."


def judged(found: Sequence[Finding], otherwise: Verdict) -> Verdict:
    """A report's verdict with what is not plausible in front of it."""
    if not found:
        return otherwise
    deep = any(one.what == PENETRATION for one in found)
    word = "Not plausible" if deep else "Surfaces yield"
    return Verdict(BAD if deep else FAIR, word, f"{headline(found)} {otherwise.word}. {otherwise.sentence}".strip())


def content(found: Sequence[Finding]) -> dict[str, Any]:
    """As JSON files have it."""
    return {
        "verdict": "implausible" if found else "plausible",
        "reason": headline(found),
        "findings": [one._asdict() for one in found],
        "units": {PENETRATION: "m", PRESSURE: "Pa"},
    }
