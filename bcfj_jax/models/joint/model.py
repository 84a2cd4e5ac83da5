"""The joint as everything outside sees it: ``scene.Joint`` with its equations, instruments, checks and levels.

``joint`` makes one from options.
"""

# Methods that other modules define call their first argument ``scene`` and not ``self``.
# pyright: reportAssignmentType=false
from __future__ import annotations

import dataclasses
import math
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.status import OK, UNBALANCED
from bcfj_jax.mechanism.model import (
    AbstractModel,
    Bodies,
    BodyMotion,
    Coarser,
    Flows,
    ModelTraits,
    Params,
    Reading,
    Scenery,
    Solution,
)
from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.models.joint import checks, engineering, fidelity, periodic, scales, summary, system
from bcfj_jax.models.joint import drawing as shapes
from bcfj_jax.models.joint import variants as others
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.batched_newton import origin
from bcfj_jax.models.joint.build import structure
from bcfj_jax.models.joint.constants import constants, patch
from bcfj_jax.models.joint.energy import power, stored
from bcfj_jax.models.joint.kinematic import kinematic_readings, kinematic_states, nominal
from bcfj_jax.models.joint.observe import BODIES, motions, observe, observe_at_rest
from bcfj_jax.models.joint.options import (
    GROUPS,
    JointCage,
    JointDrive,
    JointGeometry,
    JointLoads,
    JointMaterials,
    JointOptions,
    instead,
    keyed,
    with_keys,
)
from bcfj_jax.models.joint.quasistatic import quasistatic
from bcfj_jax.models.joint.scene import AUTO, FIDELITIES, OF_A_BALL, Joint

# What the levels without inertia leave out.
_PHYSICS = {
    "kinematic": "closed-form load sharing: no clearance, no friction, no inertia",
    "quasistatic": "equilibrium at each instant: no inertia, no friction, no damping, no impacts",
    "dynamic": "",
}


class JointModel(Joint):
    """The ball-cage flexible joint as a model; made by ``joint``. Methods that other modules define are named here."""

    # What it is.

    @property
    def traits(self) -> ModelTraits:
        """Friction is stiff, the drive turns, and contacts begin and end all the time."""
        return ModelTraits(
            stiff=True, history=self.in_motion, turning=True, large=True, rough=self.in_motion,
            open=self.fidelity == AUTO,
        )  # fmt: skip

    @property
    def title(self) -> str:
        """Its fidelity, and that it is a joint."""
        return f"{self.fidelity} joint"

    @property
    def members(self) -> dict[str, int]:
        """Balls of the contacts that each ball has."""
        return {contact.name: self.balls if contact.name in OF_A_BALL else 0 for contact in self.contacts}

    @property
    def body_names(self) -> tuple[str, ...]:
        """Of a joint in motion; without inertia nothing has an acceleration."""
        return BODIES if self.in_motion else ()

    @property
    def body_members(self) -> dict[str, int]:
        """Balls."""
        return {"ball": self.balls}

    def coordinates(self) -> dict[str, tuple[int, int]]:
        """All but cage_turn, which is an axis with a spin and no such pair."""
        balls, places = self.balls, 3 * self.balls + self.coupling
        found = {
            f"ball[{i + 1}].{axis}": (3 * i + k, places + self.twist * i + k)
            for i in range(balls)
            for k, axis in enumerate("xyz")
        }
        for name, piece in self.slices.items():
            if piece is None or name == "cage_turn":
                continue
            for k in range(piece.start, piece.stop):
                own = name if piece.stop == piece.start + 1 else f"{name}.{'xyz'[k - piece.start]}"
                found[own] = (3 * balls + k, places + self.twist * balls + k)
        return found

    @property
    def drive_coordinate(self) -> str:
        """The seat's turn."""
        return "seat_turn"

    # Its equations, and what solvers ask.

    def prepare(self, params: Params) -> Any:
        """``constants``; the parameters themselves for closed-form load sharing."""
        return dict(params) if self.fidelity == "kinematic" else constants(self, params)

    def initial_state(self, params: Params) -> Array:
        """``kinematic.nominal`` with the seat at 0."""
        return nominal(self, params, jnp.zeros(()))

    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        """``system.field``."""
        return system.field(t, y, (self, prepared))

    def structure(self) -> AbstractStructure:
        """Balls one by one, then the rest."""
        return Arrowhead()

    error_scale = scales.scales
    tolerance = scales.tolerance

    def first_step(self, params: Params, scales: Array) -> ArrayLike:
        """A microsecond."""
        del params, scales
        return 1e-6

    def origin(self, count: int) -> Any:
        """``batched_newton.origin``."""
        return origin(self, count) if self.fidelity == "quasistatic" else ()

    def instants(self, params: Params, times: Array, near: Any = None, rates: bool = True) -> tuple[Solution, Any]:
        """Closed form, or equilibria, which a run ends at where the first was not found."""
        none = jnp.asarray(0)
        if self.fidelity == "kinematic":
            return Solution(kinematic_states(self, params, times), jnp.asarray(OK), times[-1], none, none), ()
        found = quasistatic(self, params, times, near, rates)
        good = jnp.all(found.converged)
        code, end = jnp.where(good, OK, UNBALANCED), jnp.where(good, times[-1], times[jnp.argmin(found.converged)])
        return Solution(found.states, code, end, jnp.sum(found.iterations), none), found.places

    # What instruments read.

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """``observe.observe``, or what its fidelity has in its place."""
        if self.fidelity == "kinematic":
            return jax.tree.map(lambda x: x[0], kinematic_readings(self, prepared, jnp.asarray(t)[None]))
        look = observe_at_rest if self.fidelity == "quasistatic" else observe
        return look(self, prepared, y)

    def motions(self, t: Array, y: Array, prepared: Any) -> dict[str, BodyMotion]:
        """``observe.motions``."""
        return motions(self, prepared, t, y)

    def flows(self, t: Array, y: Array, prepared: Any) -> Flows:
        """``energy.power`` and ``energy.stored``."""
        if not self.in_motion:
            remedy = "give fidelity = 'dynamic': the other models have no inertia"
            raise InputError("balance", f"scene 'joint', {self.fidelity}", remedy)
        flow = power(self, prepared, t, y)._asdict()
        given = {name: flow.pop(name) for name in ("drive", "hold")}
        return Flows(given, flow, stored(self, prepared, t, y)._asdict())

    drawing = shapes.drawing
    carriers = shapes.carriers

    def scenery(self, t: Array, y: Array, params: Params) -> Scenery:
        """``drawing.scenery``."""
        return shapes.scenery(self, self.observe(t, y, self.prepare(params)), y, params)

    # What is refused, and what is known beside.

    check = checks.check_joint
    suspects = checks.suspects
    warnings = engineering.warnings

    def envelope(self, params: Params, times: np.ndarray) -> tuple[dict[str, float], list[str]]:
        """``scales.envelope_place``; and whether anything but the defaults was tried."""
        del times
        tried = dataclasses.replace(self, fidelity="dynamic") == joint()
        return scales.envelope_place(self, params), [] if tried else ["options other than the defaults"]

    def unit_pressure(self, params: Params, contact: str, material: Any) -> Array | None:
        """By its own radii and modulus (``constants.patch``)."""
        del material
        return jnp.stack([patch(self, params, contact)[0].peak_pressure(1.0), 1.0 / 3.0, 0.0])

    def bodies_at(self, params: Params, contact: str, deepest: float) -> Bodies:
        """A ball, which is the smallest body at every contact that it has, and thinner than any other at the rest."""
        del contact, deepest
        return Bodies(float(params["ball_radius"]))

    # Motion that repeats itself.

    def period(self, params: Params) -> tuple[float, float]:
        """Of the seat, and of one ball's pitch; InputError without a history, and for a drive that stands still."""
        if self.fidelity != "dynamic":
            found = f"'{self.fidelity}' has no dynamics"
            raise InputError("scene 'joint' fidelity", found, "give fidelity = 'dynamic'")
        speed = abs(float(params["drive_speed"]))
        if not speed > 0.0:
            raise InputError("drive_speed", f"{speed:g} rad/s", "give a speed other than 0")
        turn = 2.0 * math.pi / speed
        return turn, turn * self.pitches / self.balls

    def recurs(self, params: Params) -> bool:
        """A joint in motion whose seat turns."""
        steady = self.fidelity == "dynamic" and not self.programmes.lasting
        return steady and float(params["drive_speed"]) != 0.0

    def pitch(self, params: Params) -> Array:
        """The time in which the seat turns by one ball's pitch; by a whole turn with unequal balls."""
        return 2.0 * jnp.pi * self.pitches / (self.balls * jnp.abs(params["drive_speed"]))

    pitch_before = periodic.pitch_before
    turned = periodic.ways

    def neutral(self, state: Array, tangent: Array) -> Array:
        """Without the phase of a prescribed drive and the length of the cage's axis."""
        places = 3 * self.balls
        rates = places + self.coupling + self.balls * self.twist
        seat, cage = self.slices["seat_turn"], self.slices["cage_turn"]
        assert seat is not None
        if self.drive == "prescribed":
            tangent = tangent.at[jnp.array([places + seat.start, rates + seat.start])].set(0.0)
        if cage is not None:
            at = slice(places + cage.start, places + cage.stop)
            axis = state[at]
            tangent = tangent.at[at].add(-axis * (axis @ tangent[at]) / (axis @ axis))
        return tangent

    def settled_from(self, params: Params) -> float:
        """When the load has risen and a ball's pitch has passed."""
        return periodic.risen(self, params, 1)

    @property
    def settled_when(self) -> str:
        """As ``settled_from``."""
        return "the load has risen and the drive has turned on by one ball"

    # Its levels.

    level = fidelity.resolved
    choose = fidelity.adaptive
    variants = others.variants

    def full(self) -> AbstractModel:
        """Its motion."""
        return fidelity.resolved(self, "dynamic")

    def choice_options(self) -> dict[str, Any]:
        """Fidelity "auto", where drive and loads are the usual ones."""
        return {"fidelity": AUTO} if self.programmes.usual else {}

    def coarser(self) -> tuple[Coarser, ...]:
        """Fidelities that leave out more; none where drive or loads are programmes over time."""
        if not self.programmes.usual:
            return ()
        count = len(FIDELITIES) if self.fidelity == AUTO else FIDELITIES.index(self.fidelity)
        return tuple(Coarser(name, {"fidelity": name}, _PHYSICS[name]) for name in FIDELITIES[:count])

    @property
    def model_form(self) -> str:
        """What was measured of the default joint; of a joint without a motion what it leaves out."""
        return others.model_form() if self.in_motion else "this level has neither friction nor inertia"

    # A run as a whole.

    @property
    def tables(self) -> tuple[str, ...]:
        """Resultants and moments, of a joint that moves."""
        return (summary.RESULTANTS, summary.MOMENTS) if self.in_motion else ()

    whole = summary.of_the_run
    orbits = summary.orbits


def joint(
    geometry: JointGeometry | None = None,
    cage: JointCage | str | None = None,
    materials: JointMaterials | None = None,
    drive: JointDrive | str | None = None,
    loads: JointLoads | None = None,
    fidelity: str = "dynamic",
    **old: Any,
) -> JointModel:
    """The ball-cage flexible joint: a driven seat, a loaded head, a cage and balls (physics sheet 5).

    What an option takes out is not in the program. Force components: ``joint.observe``.

    Args:
        geometry: bodies and tracks; defaults where this or another group is left out.
        cage: how it is held, and where it bears.
        materials: contacts and their laws.
        drive, loads: what turns the seat, and what the head bears.
        fidelity: one of kinematic, quasistatic, dynamic, auto, as ``JointOptions``.
        old: single options as keywords, by the names of the groups' fields; deprecated.

    Raises:
        InputError: for a name that is not known, and for contacts that do not make a joint.
    """
    given = {"geometry": geometry, "cage": cage, "materials": materials, "drive": drive, "loads": loads}
    # Of the old keywords two have the name of a group.
    old |= {name: given.pop(name) for name in ("cage", "drive") if isinstance(given[name], str)}
    for name, group in given.items():
        if not (group is None or isinstance(group, GROUPS[name])):
            found, kind = f"{name} = {quoted(group)}", GROUPS[name].__name__
            raise InputError("scene 'joint'", found, f"give {name} = bj.scenes.{kind}(...)")
    options = JointOptions(fidelity=fidelity, **{name: group for name, group in given.items() if group is not None})
    if old:
        options = with_keys(options, old, "scene 'joint'")
        warnings.warn(f"joint({', '.join(old)}): {instead(old)}", DeprecationWarning, stacklevel=2)
    return JointModel(**structure(options))


@keyed(JointOptions)
def joint_of_keys(**given: Any) -> JointModel:
    """The ball-cage flexible joint from the keys of [scene] of a scene file."""
    return JointModel(**structure(with_keys(JointOptions(), given, "scene 'joint'")))
