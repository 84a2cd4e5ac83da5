"""The joint as everything outside sees it: ``scene.Joint`` with its equations, instruments, checks and levels.

``joint`` makes one from options.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact import laws as normal_laws
from bcfj_jax.core import limits, quantities
from bcfj_jax.core.errors import InputError, nearest, quoted
from bcfj_jax.core.shapes import Drawing
from bcfj_jax.core.status import OK, UNBALANCED
from bcfj_jax.mechanism.model import (
    AbstractModel,
    Bodies,
    BodyMotion,
    Coarser,
    Flows,
    ModelTraits,
    Orbit,
    Params,
    Reading,
    Scenery,
    Solution,
    Variant,
)
from bcfj_jax.mechanism.structure import AbstractStructure
from bcfj_jax.models.joint import (
    drawing,
    engineering,
    envelope,
    moments,
    programmes,
    summary,
    system,
    validity,
    variants,
)
from bcfj_jax.models.joint.arrowhead import Arrowhead
from bcfj_jax.models.joint.batched_newton import origin
from bcfj_jax.models.joint.checks import check_joint, suspects
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.energy import power, stored
from bcfj_jax.models.joint.fidelity import adaptive, resolved
from bcfj_jax.models.joint.guides import GUIDES
from bcfj_jax.models.joint.kinematic import kinematic_readings, kinematic_states
from bcfj_jax.models.joint.observe import BODIES, motions, observe, observe_at_rest, whole
from bcfj_jax.models.joint.periodic import pitch_before, risen
from bcfj_jax.models.joint.quasistatic import quasistatic
from bcfj_jax.models.joint.scales import scales, tolerance
from bcfj_jax.models.joint.scene import (
    AUTO,
    CAGES,
    CONTACTS,
    DRIVES,
    FIDELITIES,
    GEOMETRY,
    GIVEN,
    GROOVES,
    HEADS,
    OF_A_BALL,
    PILOTS,
    STIFFNESSES,
    TRACKS,
    USUAL,
    WINDOW_END,
    Joint,
    JointContact,
)
from bcfj_jax.models.joint.start import nominal

# What the levels without inertia leave out.
_PHYSICS = {
    "kinematic": "closed-form load sharing: no clearance, no friction, no inertia",
    "quasistatic": "equilibrium at each instant: no inertia, no friction, no damping, no impacts",
    "dynamic": "",
}
_TABLE, _MOMENTS = "resultants.csv", "moments.csv"


class JointModel(Joint):
    """The ball-cage flexible joint as a model; made by ``joint``."""

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

    def prepare(self, params: Params) -> Any:
        """``constants``; the parameters themselves for closed-form load sharing."""
        return dict(params) if self.fidelity == "kinematic" else constants(self, params)

    def initial_state(self, params: Params) -> Array:
        """``start.nominal`` with the seat at 0."""
        return nominal(self, params, jnp.zeros(()))

    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        """``system.field``."""
        return system.field(t, y, (self, prepared))

    def structure(self) -> AbstractStructure:
        """Balls one by one, then the rest."""
        return Arrowhead()

    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        """``scales.scales``."""
        return scales(self, params, jnp.asarray(end))

    def first_step(self, params: Params, scales: Array) -> ArrayLike:
        """A microsecond."""
        del params, scales
        return 1e-6

    def tolerance(self, force_error: float) -> float:
        """``scales.tolerance``."""
        return tolerance(self, force_error)

    def origin(self, count: int) -> Any:
        """``batched_newton.origin``."""
        return origin(self, count) if self.fidelity == "quasistatic" else ()

    def instants(self, params: Params, times: Array, near: Any = None, rates: bool = True) -> tuple[Solution, Any]:
        """Closed form, or equilibria, which a run ends at where the first was not found."""
        none = jnp.asarray(0)
        if self.fidelity == "kinematic":
            states = kinematic_states(self, params, times)
            return Solution(states, jnp.asarray(OK), times[-1], none, none), ()
        found = quasistatic(self, params, times, near, rates)
        good = jnp.all(found.converged)
        code, end = jnp.where(good, OK, UNBALANCED), jnp.where(good, times[-1], times[jnp.argmin(found.converged)])
        return Solution(found.states, code, end, jnp.sum(found.iterations), none), found.places

    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """``observe.observe``, or what its fidelity has in its place."""
        if self.fidelity == "kinematic":
            return jax.tree.map(lambda x: x[0], kinematic_readings(self, prepared, jnp.asarray(t)[None]))
        look = observe_at_rest if self.fidelity == "quasistatic" else observe
        return look(self, prepared, y)

    @property
    def body_names(self) -> tuple[str, ...]:
        """Of a joint in motion; without inertia nothing has an acceleration."""
        return BODIES if self.in_motion else ()

    @property
    def body_members(self) -> dict[str, int]:
        """Balls."""
        return {"ball": self.balls}

    def motions(self, t: Array, y: Array, prepared: Any) -> dict[str, BodyMotion]:
        """``observe.motions``."""
        return motions(self, prepared, t, y)

    def drawing(self, params: Params, size: float = 1.0, travel: Any = None) -> Drawing:
        """``drawing.drawing``: the joint has sizes of its own."""
        del size, travel
        return drawing.drawing(self, params)

    def carriers(self) -> dict[str, str]:
        """``drawing.carriers``."""
        return drawing.carriers(self)

    def scenery(self, t: Array, y: Array, params: Params) -> Scenery:
        """``drawing.scenery``."""
        return drawing.scenery(self, self.observe(t, y, self.prepare(params)), y, params)

    def level(self, fidelity: str) -> AbstractModel:
        """``fidelity.resolved``."""
        return resolved(self, fidelity)

    def flows(self, t: Array, y: Array, prepared: Any) -> Flows:
        """``energy.power`` and ``energy.stored``."""
        if not self.in_motion:
            remedy = "give fidelity = 'dynamic': the other models have no inertia"
            raise InputError("balance", f"scene 'joint', {self.fidelity}", remedy)
        flow = power(self, prepared, t, y)._asdict()
        given = {name: flow.pop(name) for name in ("drive", "hold")}
        return Flows(given, flow, stored(self, prepared, t, y)._asdict())

    def check(self, params: Params, where: str = "") -> None:
        """``checks.check_joint``."""
        check_joint(self, params, where or "scene 'joint'")

    def suspects(self, params: Params) -> np.ndarray:
        """``checks.suspects``."""
        return suspects(self, params)

    def period(self, params: Params) -> tuple[float, float]:
        """Of the seat, and of one ball's pitch.

        Raises:
            InputError: for a fidelity that has no history, and for a drive that stands still.
        """
        if self.fidelity != "dynamic":
            raise InputError(
                "scene 'joint' fidelity", f"'{self.fidelity}' has no dynamics", "give fidelity = 'dynamic'"
            )
        speed = abs(float(params["drive_speed"]))
        if not speed > 0.0:
            raise InputError("drive_speed", f"{speed:g} rad/s", "give a speed other than 0")
        turn = 2.0 * math.pi / speed
        return turn, turn * self.pitches / self.balls

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
            for k in range(piece.stop - piece.start):
                own = f"{name}.{'xyz'[k]}" if piece.stop - piece.start > 1 else name
                found[own] = (3 * balls + piece.start + k, places + self.twist * balls + piece.start + k)
        return found

    @property
    def drive_coordinate(self) -> str:
        """The seat's turn."""
        return "seat_turn"

    def recurs(self, params: Params) -> bool:
        """A joint in motion whose seat turns."""
        steady = self.fidelity == "dynamic" and not self.programmes.lasting
        return steady and float(params["drive_speed"]) != 0.0

    def pitch(self, params: Params) -> Array:
        """The time in which the seat turns by one ball's pitch; by a whole turn with unequal balls."""
        return 2.0 * jnp.pi * self.pitches / (self.balls * jnp.abs(params["drive_speed"]))

    def pitch_before(self, params: Params, state: Array) -> Array:
        """``periodic.pitch_before``."""
        return pitch_before(self, params, state)

    def turned(self, params: Params) -> int:
        """Ball j does what ball j + 1 did, or j - 1 where the seat turns the other way; of unequal balls what it did."""
        return 0 if self.unequal else int(np.sign(float(params["drive_speed"])))

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

    def envelope(self, params: Params, times: np.ndarray) -> tuple[dict[str, float], list[str]]:
        """``envelope.place``; and whether anything but the defaults was tried."""
        del times
        tried = dataclasses.replace(self, fidelity="dynamic") == joint()
        return envelope.place(self, params), [] if tried else ["options other than the defaults"]

    def warnings(self, params: Params, run: Any) -> list[str]:
        """``validity.warnings``."""
        return validity.warnings(self, params, run)

    def bodies_at(self, params: Params, contact: str, deepest: float) -> Bodies:
        """A ball, which is the smallest body at every contact that it has, and thinner than any other at the rest."""
        del contact, deepest
        return Bodies(float(params["ball_radius"]))

    def settled_from(self, params: Params) -> float:
        """When the load has risen and a ball's pitch has passed."""
        return risen(self, params, 1)

    @property
    def settled_when(self) -> str:
        """As ``settled_from``."""
        return "the load has risen and the drive has turned on by one ball"

    def full(self) -> AbstractModel:
        """Its motion."""
        return resolved(self, "dynamic")

    def choice_options(self) -> dict[str, Any]:
        """Fidelity "auto", where drive and loads are the usual ones."""
        return {"fidelity": AUTO} if self.programmes.usual else {}

    def coarser(self) -> tuple[Coarser, ...]:
        """Fidelities that leave out more; none where drive or loads are programmes over time."""
        if not self.programmes.usual:
            return ()
        count = len(FIDELITIES) if self.fidelity == AUTO else FIDELITIES.index(self.fidelity)
        return tuple(Coarser(name, {"fidelity": name}, _PHYSICS[name]) for name in FIDELITIES[:count])

    def variants(self, params: Params) -> tuple[Variant, ...]:
        """``variants.variants``."""
        return variants.variants(self, params)

    @property
    def model_form(self) -> str:
        """What was measured of the default joint; of a joint without a motion what it leaves out."""
        if not self.in_motion:
            return "this level has neither friction nor inertia"
        return variants.model_form()

    def choose(
        self, params: Params, times: np.ndarray, budget: float, run: Callable[[AbstractModel, np.ndarray], Any]
    ) -> Any:
        """``fidelity.adaptive``."""
        return adaptive(self, params, times, budget, run)

    @property
    def tables(self) -> tuple[str, ...]:
        """Resultants and moments, of a joint that moves."""
        return (_TABLE, _MOMENTS) if self.in_motion else ()

    def whole(self, params: Params, run: Any) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
        """Pressure, patch and power of contacts; of motion transmission, energy, the cage's equilibrium, resultants."""
        scene = resolved(self, run.choice.fidelity) if run.choice else self
        if not scene.in_motion:
            return {"engineering": engineering.of_the_contacts(scene, params, run)}, {}
        found = whole(scene, params, run.times, run.trajectory)
        assert found.moments is not None
        columns = {
            f"{contact.name}.{axis} [N]": np.asarray(found.resultants[contact.name])[:, k]
            for contact in self.contacts
            for k, axis in enumerate("xyz")
        }
        entries = summary.of_the_whole(run.times, found)
        read = engineering.of_the_contacts(scene, params, run, found.rubbed)
        read |= {"quantities": moments.quantities(scene, run.times, found.moments), "quantities_note": moments.NOTE}
        tables = {_TABLE: columns, _MOMENTS: moments.table(scene, found.moments)}
        return entries | {"engineering": read}, tables

    def orbits(self, params: Params, run: Any) -> dict[str, Orbit]:
        """The cage in the seat, across the seat's axis, and the head in the cage, across the head's; of motion only.

        The joint's plane holds both axes.
        """
        scene = resolved(self, run.choice.fidelity) if run.choice else self
        if not scene.in_motion or run.trajectory is None:
            return {}
        coupling = run.trajectory[:, 3 * scene.balls :][:, : scene.coupling]
        place = {"seat": 0.0, "head": 0.0, "cage": 0.0}
        place |= {body: coupling[:, at] for body in ("head", "cage") if (at := scene.slices.get(body)) is not None}
        angle, found = float(params["joint_angle"]), {}
        for name in scene.pilots:
            outer, inner = GUIDES[name]
            apart = np.broadcast_to(place[inner] - place[outer], (len(run.times), 3))
            # The head's axis leans to +x.
            tilt = angle if "head" in (outer, inner) else 0.0
            x = math.cos(tilt) * apart[:, 0] - math.sin(tilt) * apart[:, 2]
            z = math.sin(tilt) * apart[:, 0] + math.cos(tilt) * apart[:, 2]
            axes = ("in the joint's plane", "across the joint's plane")
            found[name] = Orbit(x, apart[:, 1], float(params[f"clearance_{name}"]), f"{inner} in {outer}", axes, z)
        return found


def joint(
    law: str = "memory_free",
    elastic: str | None = None,
    smoothing: bool = True,
    friction: bool | str = True,
    laws: Mapping[str, str] | None = None,
    frictions: Mapping[str, bool | str] | None = None,
    elastics: Mapping[str, str] | None = None,
    stiffness: str = GIVEN,
    stiffnesses: Mapping[str, str] | None = None,
    contacts: Sequence[str] | None = None,
    track: str = "gothic",
    spin: bool | None = None,
    unequal: bool = False,
    cage: str = "free",
    window_ends: bool | None = None,
    bands: bool | None = None,
    head: str = "free",
    drive: str = "prescribed",
    fidelity: str = "dynamic",
    balls: int = 6,
    drive_profile: str = "constant",
    drive_table: list[list[Any]] | str | None = None,
    load_profile: str = "smooth",
    load_table: list[list[Any]] | str | None = None,
    axial_profile: str = "constant",
    axial_table: list[list[Any]] | str | None = None,
    fluctuating: Sequence[str] | None = None,
    torque_reversal: bool = False,
    stick_slip: bool = False,
) -> JointModel:
    """The ball-cage flexible joint: a driven seat, a loaded head, a cage and balls (physics sheet 5).

    What an option takes out is not in the program. Force components: ``joint.observe``.

    Args:
        law, elastic, smoothing: as ``impact``, for every contact. A law stated by restitution takes the parameter
            ``approach_speed`` for all impacts, as the paper does.
        friction: False for none, True for Brown-McPhee, or a name of ``laws.FRICTION``.
        laws, frictions: other normal-force and friction laws for single contacts, by name.
        elastics: other elastic parts for single contacts, by name, such as seat_cage = "liu_sphere". The radii of one
            that reads them are the joint's own, so that clearance moves it.
        stiffness: one of given, geometry. given: a parameter. geometry: of Hertz contacts of the joint's own radii,
            conformity and clearances, and of effective_modulus.
        stiffnesses: as stiffness for single contacts, by name, such as seat_cage = "geometry".
        contacts: those there are; by default all, but seat_cage and cage_window_end where the cage is fixed. Balls need
            both of theirs.
        track: one of gothic, circular: two flanks at the contact angle, or one, of the ball's radius and clearance.
        spin: true lets the balls turn, and so roll; false makes each a particle at its centre. By default true where
            friction turns them, but not where it keeps a state (memory, frictional_lag, lugre): they then roll and slip
            by turns, in many times the steps.
        unequal: true gives each ball an oversize of its radius and each of its contacts an extra clearance, by default
            0: ball_2.oversize, seat_ball_2.extra_clearance and so on.
        cage: one of free, fixed: to the bisecting plane, turning with the drive.
        window_ends: true gives a free cage's windows ends: the contact cage_window_end of every ball, and the cage's
            azimuth as a state. By default true where contacts are not listed. Without, friction lets the cage slip
            through its own windows.
        bands: true lets the cage's pilots, seat_cage and head_cage, bear up to the latitude pilot_band alone, where a cage
            ends, and on its edges; false makes them full spheres. By default true unless they have bristles (lugre), which
            a band has not.
        head: one of free, fixed: at the centre; it turns about its own axis either way.
        drive: one of prescribed, flexible: adds seat_inertia, drive_stiffness and drive_damping.
        fidelity: one of kinematic, quasistatic, dynamic, auto. kinematic: closed-form load sharing. quasistatic:
            equilibrium at each instant, without friction. dynamic: motion. auto: the cheapest that keeps the accuracy
            asked for, and motion of the last pitch repeated where it repeats itself. A scene file that gives none:
            dynamic, and at the level fast auto.
        balls: 3 or more, each in a track of its own.
        drive_profile: one of constant, smooth, step, linear, table. The speed rises from start_speed, 0 by default, to
            drive_speed over drive_ramp; step is the ADAMS STEP.
        drive_table: [[times], [speeds]] of the profile table, or a CSV file with two columns; drive_speed scales it.
        load_profile: one of smooth, step, linear, table. How the torque rises over load_ramp.
        load_table: [[times], [torques]] of the profile table, or a CSV file; load_torque scales it.
        axial_profile: one of constant, smooth, step, linear, table. The axial load, there from the start or raised over
            axial_ramp.
        axial_table: [[times], [forces]] of the profile table, or a CSV file; axial_load scales it.
        fluctuating: of torque, axial. Which loads swing about their size, by load_amplitude at load_frequency, and by
            axial_amplitude at axial_frequency.
        torque_reversal: true lets the torque change its sign, from reversal_time on, over reversal_ramp.
        stick_slip: true lets the torque fall with the head's speed as a bit's does: joint.programmes.falling.

    Raises:
        InputError: for a name that is not known, and for contacts that do not make a joint.
    """
    where = "scene 'joint'"
    choices = {"track": TRACKS, "cage": CAGES, "head": HEADS}
    choices |= {"drive": DRIVES, "fidelity": (*FIDELITIES, AUTO), "stiffness": STIFFNESSES}
    given = {"track": track, "cage": cage, "head": head, "drive": drive, "fidelity": fidelity, "stiffness": stiffness}
    for name, value in given.items():
        if value not in choices[name]:
            raise InputError(f"{where} {name}", f"no {name} '{value}'", nearest(value, choices[name]))
    balls = quantities.whole(f"{where} balls", balls, least=0)
    if not 3 <= balls <= limits.MEMBERS:
        raise InputError(
            f"{where} balls", f"{balls} balls", f"give a whole number from 3 to {limits.MEMBERS}: a joint has 3 or more"
        )
    names = tuple(contacts) if contacts is not None else USUAL[1:] if cage == "fixed" else USUAL
    # Who lists contacts has listed those of the windows.
    ends = contacts is None if window_ends is None else window_ends
    if ends and cage == "free" and "cage_ball" in names and WINDOW_END not in names:
        names = (*names, WINDOW_END)
    own = {"laws": laws, "frictions": frictions, "elastics": elastics, "stiffnesses": stiffnesses}
    for what, group in {"contacts": names, **own}.items():
        for name in group or ():
            if name not in CONTACTS:
                raise InputError(f"{where} {what}", f"no contact '{name}'", nearest(name, CONTACTS))
            if name not in names:
                found = f"'{name}' is not among the contacts"
                raise InputError(f"{where} {what}", found, f"there are {', '.join(names)}")
    for what, (one, known) in {
        "laws": ("law", normal_laws.LAWS), "elastics": ("elastic part", normal_laws.ELASTIC),
        "stiffnesses": ("stiffness", STIFFNESSES),
    }.items():  # fmt: skip
        for name, value in (own[what] or {}).items():
            if value not in known:
                raise InputError(f"{where} {what}", f"{name}: no {one} {quoted(value)}", nearest(value, known))
    missing = [name for name in GROOVES if name not in names]
    if missing:
        raise InputError(
            f"{where} contacts", f"without {missing[0]}", "give it: balls need both tracks to carry torque"
        )
    if cage == "fixed" and "seat_cage" in names:
        raise InputError(
            f"{where} contacts", "seat_cage with a fixed cage", "remove it: seat and fixed cage never touch"
        )
    if WINDOW_END in names and cage == "fixed":
        remedy = f"remove {WINDOW_END}: a fixed cage turns as the drive does"
        raise InputError(f"{where} contacts", f"{WINDOW_END} with a fixed cage", remedy)
    if WINDOW_END in names and "cage_ball" not in names:
        remedy = "add cage_ball: a window that has ends has faces"
        raise InputError(f"{where} contacts", f"{WINDOW_END} without cage_ball", remedy)
    if cage == "free" and fidelity == "quasistatic" and not set(PILOTS) & set(names):
        found = "only the windows hold the free cage, so it has no equilibrium"
        raise InputError(f"{where} contacts", found, f"add {' or '.join(PILOTS)}, or give cage = 'fixed'")
    over_time = programmes.made(
        where, drive_profile, drive_table, load_profile, load_table, axial_profile, axial_table, fluctuating,
        torque_reversal, stick_slip,
    )  # fmt: skip
    if not over_time.usual and fidelity != "dynamic":
        remedy = "give fidelity = 'dynamic'"
        raise InputError(f"{where} fidelity", f"'{fidelity}' with a drive or a load over time", remedy)
    if over_time.drive is not None and cage == "fixed":
        raise InputError(
            f"{where} drive_profile", f"'{drive_profile}' with a fixed cage, which turns evenly", "give cage = 'free'"
        )
    ordered = [name for name in CONTACTS if name in names]
    made = tuple(
        JointContact(
            name,
            normal_laws.make((laws or {}).get(name, law), (elastics or {}).get(name, elastic)),
            normal_laws.make_friction((frictions or {}).get(name, friction)),
            (stiffnesses or {}).get(name, stiffness) == GEOMETRY,
        )
        for name in ordered
    )
    rubs = {contact.name: contact.friction for contact in made if contact.friction}
    balls_rub = [rubs[name] for name in OF_A_BALL if name in rubs]
    if spin is None:
        spin = bool(balls_rub) and not any(law.bristles or law.lags for law in balls_rub)
    if bands is None:
        bands = not any(rubs[name].bristles for name in PILOTS if name in rubs)
    return JointModel(
        contacts=made, balls=balls, track=track, spin=spin, unequal=unequal, cage=cage, bands=bands, head=head,
        drive=drive, smoothing=smoothing, fidelity=fidelity, programmes=over_time,
    )  # fmt: skip
