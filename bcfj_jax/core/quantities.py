"""What every parameter name means: its unit, its range and one sentence. Units are metadata, not magic.

Beside it what is refused of values, of values beside each other, and of times.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.core.errors import QUOTED, InputError, quoted
from bcfj_jax.core.numerics import is_traced
from bcfj_jax.core.upward import upward


class Quantity(NamedTuple):
    """One parameter of a scene.

    ``unit`` is how the value is kept (SI); ``N/m^n`` stands for newtons over metres to the contact's
    exponent. The value must lie in [low, high], without ``low`` itself where ``open_low``. A parameter that is an array
    has its ``shape``.
    """

    name: str
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    shape: tuple[int, ...] = ()

    def valid(self, value: Any) -> Any:
        """Whether a value lies in the range, of an array each number, traced ones too; NaN and infinities never do."""
        above = value > self.low if self.open_low else value >= self.low
        return (abs(value) < math.inf) & above & (value <= self.high)

    def text(self, value: float, digits: int = 6) -> str:
        """A value as people read it, with its unit where it has one."""
        return f"{value:.{digits}g}" if self.unit == "1" else f"{value:.{digits}g} {self.unit}"

    @property
    def range(self) -> str:
        """The range in words."""
        low = "" if self.low == -math.inf else f"{'>' if self.open_low else '>='} {self.low:g}"
        high = "" if self.high == math.inf else f"<= {self.high:g}"
        return " and ".join(part for part in (low, high) if part) or "finite"


def _positive(name: str, unit: str, meaning: str) -> Quantity:
    return Quantity(name, unit, meaning, low=0.0, open_low=True)


def _not_negative(name: str, unit: str, meaning: str) -> Quantity:
    return Quantity(name, unit, meaning, low=0.0)


# Of the earth [m/s^2], where nothing else is given.
GRAVITY = 9.81
CATALOGUE: dict[str, Quantity] = {
    q.name: q
    for q in (
        # coefficients of the contact laws
        _positive("stiffness", "N/m^n", "contact stiffness K of F = K d^n"),
        Quantity("exponent", "1", "force exponent n of F = K d^n", 1.0, 3.0),
        _positive("reference_force", "N", "force at the reference penetration"),
        _positive("reference_penetration", "m", "penetration at which the reference force is stated"),
        _not_negative("bottoming_stiffness", "N/m", "stiffness added where the soft layer bottoms out"),
        _positive("bottoming_penetration", "m", "penetration at which the soft layer bottoms out"),
        _not_negative("bottoming_width", "m", "half-width of the rounding where the soft layer bottoms out"),
        _not_negative("bottoming_damping", "s/m", "a of the stop alone, where it has one of its own"),
        _positive("effective_modulus", "Pa", "E*, 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2"),
        _positive("contact_length", "m", "length of the cylindrical contact"),
        _positive("radius", "m", "radius of the sphere, of the socket or of the pin"),
        _positive("radius_difference", "m", "hole radius less body radius"),
        _not_negative("damping", "s/m", "a of F = f(d) (1 + a d')"),
        Quantity("restitution", "1", "coefficient of restitution e the law is asked for", 0.0, 1.0),
        _not_negative("dashpot", "N s/m", "viscous coefficient c (Kelvin-Voigt, ElastoGap), c_max (ADAMS IMPACT)"),
        _not_negative("relaxation", "1", "force that relaxes over the force that stays (standard linear solid)"),
        _positive("relaxation_time", "s", "time in which the relaxing force falls to 1/e at constant penetration"),
        _positive("yield_penetration", "m", "penetration at which the surface begins to yield (Thornton)"),
        _positive("damping_depth", "m", "penetration at which the ADAMS dashpot is fully in"),
        _not_negative("smoothing", "m", "half-width of the contact regularisation (C2); 0 is the sharp contact"),
        # coefficients of the friction laws
        Quantity("friction_static", "1", "friction coefficient mu_s at break-away", 0.0, 2.0, open_low=True),
        _not_negative("friction_dynamic", "1", "friction coefficient mu_d of fast sliding"),
        _positive("friction_speed", "m/s", "transition speed of friction: v_t, or v_s of the static peak"),
        _positive("friction_memory", "s", "time tau by which the friction coefficient lags behind the slip"),
        _not_negative("friction_viscous", "s/m", "viscous part of friction: coefficient over slip speed"),
        _positive("bristle_stiffness", "1/m", "sigma0 of LuGre: tangential stiffness over normal force"),
        _not_negative("bristle_damping", "s/m", "sigma1 of LuGre: bristle damping over normal force"),
        _not_negative("rolling_length", "m", "lever of rolling resistance: its torque over the normal force"),
        _not_negative("drilling_length", "m", "lever of drilling friction: its torque over the normal force"),
        _positive("spin_speed", "rad/s", "relative spin below which rolling and drilling resistance fade"),
        # sizes of the gaps
        _not_negative("clearance", "m", "clearance between the surfaces of centred bodies"),
        _positive("radius_a", "m", "radius of the first body's sphere"),
        _positive("radius_b", "m", "radius of the second body's sphere"),
        _positive(
            "half_length", "m", "half of the length of the block along its guide, of the pin, capsule or cylinder"
        ),
        _not_negative("half_length_a", "m", "half of the length of the first body's capsule, without its ends"),
        _not_negative("half_length_b", "m", "half of the length of the second body's capsule, without its ends"),
        Quantity("half_angle", "rad", "angle of a wedge's face from its middle plane", 0.0, 1.5707, True),
        _positive("half_width", "m", "half of the width of the block across its guide"),
        _positive("half_height", "m", "half of the height of the box, along its z axis"),
        # bodies, motion, loads
        _positive("mass", "kg", "mass of the moving body (effective mass m1 m2/(m1 + m2) of two)"),
        _positive("struck_mass", "kg", "mass of a free body that is struck"),
        _not_negative("approach_speed", "m/s", "speed towards the surface at time 0"),
        _not_negative("clearance_contact", "m", "gap between body and surface at time 0"),
        _not_negative("drop_height", "m", "height of the body's lowest point at time 0, at rest"),
        _not_negative("gravity", "m/s^2", "gravitational acceleration towards the surface"),
        # the ball-cage flexible joint
        Quantity("drive_speed", "rad/s", "speed of the seat"),
        Quantity("load_torque", "N m", "resisting torque on the head, against the drive's sense"),
        _positive("load_ramp", "s", "time over which the torque is raised"),
        Quantity("axial_load", "N", "force on the head along its axis, towards the seat (weight on bit)"),
        Quantity("start_speed", "rad/s", "speed of the seat at time 0"),
        _positive("drive_ramp", "s", "time over which the seat comes to its speed"),
        _positive("axial_ramp", "s", "time over which the axial load is raised"),
        Quantity("load_amplitude", "N m", "amplitude of the torque's fluctuation"),
        _not_negative("load_frequency", "Hz", "frequency of the torque's fluctuation"),
        Quantity("axial_amplitude", "N", "amplitude of the axial load's fluctuation"),
        _not_negative("axial_frequency", "Hz", "frequency of the axial load's fluctuation"),
        _not_negative("reversal_time", "s", "when the torque begins to change its sign"),
        _positive("reversal_ramp", "s", "time over which the torque changes its sign"),
        _positive("stick_ratio", "1", "torque of a bit that sticks over that of one that turns fast"),
        _positive("stick_speed", "rad/s", "speed of the head at which half of the torque's excess is gone"),
        _positive("stick_width", "rad/s", "speed of the head below which the torque fades: the width of its sign"),
        _positive(
            "bit_bristle_stiffness",
            "1/rad",
            "torque of a bit that sticks, by its turn, over that of one that turns fast",
        ),
        _not_negative(
            "bit_bristle_damping", "s/rad", "sigma1 of LuGre at the bit, over the torque of one that turns fast"
        ),
        # a string of such joints in a hole
        _positive("hole_radius", "m", "radius of the curve of the hole's axis"),
        _positive("segment_length", "m", "distance of neighbouring joints"),
        _positive("segment_radius", "m", "radius of a segment, where it rubs on the hole"),
        _not_negative("segment_bore", "m", "radius of a segment's bore"),
        _not_negative("hole_clearance", "m", "radius of the hole less that of a segment"),
        Quantity("bend_limit", "rad", "the most that a joint bends", 0.0, 1.5, open_low=True),
        _not_negative("bit_torque", "N m", "resisting torque at the bit"),
        _not_negative("weight_on_bit", "N", "axial force at the bit, pressing the string together"),
        _positive("drive_torque", "N m", "the most that the drive turns with"),
        _not_negative("wall_friction", "1", "friction coefficient of segments on the hole's wall"),
        _not_negative("feed_speed", "m/s", "speed of the string along the hole"),
        _positive("segment_modulus", "Pa", "Young's modulus of a segment"),
        _positive("segment_strength", "Pa", "stress at which a segment yields"),
        _positive("segment_density", "kg/m^3", "density of a segment"),
        _not_negative("bit_inertia", "kg m^2", "inertia of the bit about the string's axis"),
        _not_negative("twist_relaxation", "s", "damping over stiffness of a segment's and joint's twist"),
        _positive("wall_speed", "m/s", "sliding speed below which friction of the wall fades"),
        Quantity("joint_angle", "rad", "deflection: 180 degrees less the included angle", 0.0, 1.5),
        _positive("seat_radius", "m", "radius of the seat's hollow sphere"),
        _positive("head_radius", "m", "radius of the head's sphere"),
        _positive("ball_radius", "m", "radius of a ball"),
        _positive("pitch_radius", "m", "distance of the balls from the axis in the undeflected joint"),
        _not_negative("offset", "m", "distance of either track's centre from the joint's centre"),
        Quantity("contact_angle", "rad", "angle of the flank contact from the radial direction", 0.0, 1.5707, True),
        Quantity("conformity", "1", "groove section radius over ball diameter", 0.5, 2.0, True),
        *(
            _not_negative(f"clearance_{name}", "m", meaning)
            for name, meaning in (
                ("seat_cage", "radial clearance between seat sphere and cage"),
                ("head_cage", "radial clearance between cage and head sphere"),
                ("cage_ball", "gap of a centred ball to either window face"),
                ("cage_window_end", "gap of a centred ball to either end of its window, around the cage"),
                ("seat_ball", "clearance of the ball to the seat's groove, normal to a flank"),
                ("head_ball", "clearance of the ball to the head's groove, normal to a flank"),
            )
        ),
        Quantity("oversize", "m", "radius of this ball less ball_radius", -1e-3, 1e-3),
        Quantity("extra_clearance", "m", "clearance of this ball less that of all", -1e-3, 1e-3),
        Quantity("pilot_band", "rad", "latitude about the cage's axis up to which pilots bear", 0.0, 1.5, True),
        _positive("ball_mass", "kg", "mass of a ball"),
        _positive("head_mass", "kg", "mass of the head and what shifts with it"),
        _positive("head_inertia", "kg m^2", "inertia of the head about its axis"),
        _positive("cage_mass", "kg", "mass of the cage"),
        _positive("cage_inertia", "kg m^2", "inertia of the cage about any axis through its centre"),
        _positive("seat_inertia", "kg m^2", "inertia of the seat about its axis"),
        _positive("drive_stiffness", "N m/rad", "torsional stiffness between drive and seat"),
        _not_negative("drive_damping", "N m s/rad", "torsional damping between drive and seat"),
    )
}


# The first must not be more than the second, in every contact that reads both, and why.
_ORDERED = (
    ("friction_dynamic", "friction_static", "sliding does not hold more than break-away"),
    ("sliding", "breakaway", "sliding does not hold more than break-away"),
    ("bottoming_width", "bottoming_penetration", "the backing does not push before the layer is touched"),
)
# Their names.
ORDERED = frozenset(name for low, high, _ in _ORDERED for name in (low, high))


def check_value(where: str, quantity: Quantity, value: object) -> None:
    """Refuse what is no number, and numbers outside the quantity's range; traced values cannot be looked at and pass.

    Raises:
        InputError: naming the place, the value and the range.
    """
    if is_traced(value):
        return
    for number in np.ravel(real(where, quantity.name, value)):
        if not quantity.valid(float(number)):
            found = f"{quantity.name} = {quantity.text(float(number))} is out of range"
            raise InputError(where, found, f"{quantity.meaning} must be {quantity.range}")


def real(where: str, name: str, value: object) -> np.ndarray:
    """A number, or an array of numbers, as float64; refuses texts, None, truth values, complex numbers, uneven lists, units."""
    try:
        if value is None or hasattr(value, "units") or hasattr(value, "unit"):
            raise TypeError
        array = np.asarray(value)
        # Kind "V" is that of JAX's small floats; objects may be fractions, or whole numbers of many digits.
        objects = array.ravel() if array.dtype.kind == "O" else ()
        if array.dtype.kind not in "fiuVO" or any(isinstance(x, (bool, str, bytes, type(None))) for x in objects):
            raise TypeError
        return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        remedy = 'give an SI number, or a text with a unit such as "20 um"'
        raise InputError(where, f"{name} = {quoted(value)} is not a number", remedy) from None


def number(where: str, quantity: Quantity, value: Any, exponent: float | None = None) -> Any:
    """A value as the verbs take it: float64, SI, in range. The one place that says what a number is.

    It is a number, a text with its unit, an array of NumPy or JAX, which stays one, or traced, which passes. ``exponent``: of
    the contact, for a stiffness, whose unit depends on it.
    """
    if is_traced(value):
        return jnp.asarray(value, dtype=jnp.float64)
    if isinstance(value, str):
        if len(value) > QUOTED:
            raise InputError(where, f"{quantity.name} = {quoted(value)}", "give a number and its unit")
        value = upward("quantity")(value, quantity.unit, f"{where} {quantity.name}".strip(), exponent=exponent)
    check_value(where, quantity, value)
    if isinstance(value, Array) and value.dtype == jnp.float64 and not value.weak_type:
        return value
    return real(where, quantity.name, value)


def check_order(where: str, known: Collection[str], values: Mapping[str, ArrayLike]) -> None:
    """Refuse a sliding friction above the static one, and a rounding wider than the depth it is at; traced values pass.

    Of ``known``, the scene's parameters, a contact reads ``contact.name``; among ``values`` its own come before the shared.
    """
    for low, high, why in _ORDERED:
        places = {name.removesuffix(low) for name in known if name.endswith(low)}
        # A scene that names its contacts' own coefficients reads the shared ones through them.
        for place in sorted(places - {""} or places):
            keys = [place + name if place + name in values else name for name in (low, high)]
            if place + high not in known or any(values.get(key) is None or is_traced(values[key]) for key in keys):
                continue
            less, more = (np.asarray(values[key], dtype=float) for key in keys)
            if np.any(less > more):
                found = f"{keys[0]} = {np.max(less):g} is more than {keys[1]} = {np.min(more):g}"
                raise InputError(where, found, f"give {keys[0]} <= {keys[1]}: {why}")


def scalar(where: str, quantity: Quantity, value: Any, exponent: float | None = None) -> float:
    """One number of ``number``, as a ``float``."""
    if quantity.shape:
        remedy = "name a parameter that is one number; arrays are trained by jax.grad of bj.force_history"
        raise InputError(where, f"{quantity.name} is an array of shape {quantity.shape}", remedy)
    found = number(where, quantity, value, exponent)
    if np.ndim(found):
        raise InputError(where, f"{quantity.name} has shape {np.shape(found)}", "give one number")
    return float(found)


def increasing(times: object, fewest: int = 1) -> np.ndarray:
    """Times as checked numbers: (T,) float64 [s], finite, increasing, ``fewest`` or more."""
    right = f"give a 1-D array of {fewest} or more finite times [s] that increase"
    if is_traced(times):
        raise InputError("times", "are traced, and must be known here", "call this outside of jit, grad and vmap")
    try:
        t = real("times", "times", times)
    except InputError:
        raise InputError("times", f"{quoted(times)} is no array of numbers", right) from None
    if t.ndim != 1 or t.size < fewest:
        raise InputError("times", f"shape {t.shape}", right)
    lost = np.flatnonzero(~np.isfinite(t))
    if lost.size:
        raise InputError("times", f"times[{lost[0]}] = {t[lost[0]]:g}", right)
    late = np.flatnonzero(np.diff(t) <= 0)
    if late.size:
        k = int(late[0])
        raise InputError("times", f"times[{k + 1}] = {t[k + 1]:g} follows {t[k]:g}", "times must increase")
    return t


def instants(times: Any) -> Array:
    """Times of a pure function: traced ones pass with one axis, others are ``increasing``."""
    if not is_traced(times):
        return jnp.asarray(increasing(times))
    if times.ndim != 1:
        raise InputError("times", f"shape {times.shape}", "give a 1-D array of times [s]")
    return jnp.asarray(times, dtype=jnp.float64)


def whole(where: str, value: object, least: int = 1, most: int = 1_000_000_000) -> int:
    """A whole number of some range, as an ``int``."""
    try:
        found = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        found = least - 1
    if isinstance(value, (bool, np.bool_)) or not least <= found <= most:
        raise InputError(where, quoted(value), f"give a whole number from {least} to {most}")
    return found


def rounded(value: float, digits: int = 2, sign: str = "") -> str:
    """A number of few digits, without a power of ten below a million: (123.0, 2) -> "120".  sign: "+" for a change."""
    return f"{float(f'{value:.{digits}g}'):{sign}.{max(digits, 6)}g}"


def percent(share: float | None, digits: int = 3, sign: str = "") -> str:
    """A share in percent, as ``rounded``: (0.998, 2) -> "100 %"; "-" where there is none."""
    return "-" if share is None or not math.isfinite(share) else f"{rounded(100.0 * share, digits, sign)} %"
