"""From force to life: static safety of a Hertz contact, wear, rainflow counting, damage, rolling-contact life.

Pure functions of histories, SI. ``wear_volume``, ``worn`` and ``equivalent_load`` are JAX's and are differentiated;
``rainflow`` counts, and is NumPy's. Material data of steel stand in ``STEEL``, with their sources in ``SOURCES``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.analysis import features
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.extras import library
from bcfj_jax.core.numerics import power
from bcfj_jax.core.quantities import real
from bcfj_jax.io import outputs
from bcfj_jax.mechanism.channels import READ_BY, Seen, channel, read, shares
from bcfj_jax.mechanism.materials import SOURCES as SOURCES
from bcfj_jax.mechanism.materials import STEEL as STEEL
from bcfj_jax.mechanism.materials import material
from bcfj_jax.mechanism.materials import with_materials as with_materials
from bcfj_jax.mechanism.model import AbstractModel, Params, Reading
from bcfj_jax.solve.simulation import reading_history

# Greatest shear stress under the surface over the greatest pressure p0 (Johnson 1985, Contact Mechanics, 3.4 and 4.2).
POINT_SHEAR, LINE_SHEAR = 0.31, 0.30


def static_safety(pressure: ArrayLike, yield_stress: ArrayLike, shear: float = POINT_SHEAR) -> Array:
    """Safety against first yield under the surface,  S = (Y/2)/(shear p0)  (Tresca; Johnson 1985, 6.1).

    Args:
        pressure: greatest Hertz pressure p0 [Pa], as of ``stiffness.EllipticContact.peak_pressure``.
        yield_stress: Y of uniaxial tension [Pa].
        shear: greatest shear stress over p0: ``POINT_SHEAR`` (a circle, nu = 0.3) or ``LINE_SHEAR``.

    Returns:
        S [-]; infinite without pressure.
    """
    return jnp.asarray(0.5 * jnp.asarray(yield_stress) / (shear * jnp.asarray(pressure)))


def archard(times: ArrayLike, normal: ArrayLike, slip: ArrayLike, coefficient: ArrayLike, hardness: ArrayLike) -> Array:
    """Wear volume of a contact  V = (k/H) integral of |N| |v_slide| dt  [m^3], by the trapezoidal rule (Archard 1953).

    Args:
        times: (T,) [s].
        normal, slip: (T, ...) normal force [N] and sliding speed [m/s].
        coefficient, hardness: k [-], H of the softer body [Pa].
    """
    rubbed = jnp.trapezoid(jnp.abs(jnp.asarray(normal)) * jnp.abs(jnp.asarray(slip)), jnp.asarray(times), axis=0)
    return jnp.multiply(coefficient / jnp.asarray(hardness), rubbed)


def wear_volume(
    scene: AbstractModel, params: Params, times: ArrayLike, contact: str, *,
    coefficient: ArrayLike = STEEL["wear_coefficient"], hardness: ArrayLike = STEEL["hardness"],
) -> Array:  # fmt: skip
    """``archard`` of a contact of a scene, as a pure function of its parameters [m^3]: jit, vmap, jvp and grad go through.

    Args:
        scene, params, times: as of ``force_history``.
        contact: a contact with friction; ``<contact>_<k>`` of several alike.
        coefficient, hardness: as of ``archard``.

    Raises:
        InputError: for a contact that the scene has not, or that has no friction and hence no sliding speed.
    """
    names = f"{contact}.normal", f"{contact}.slip"
    found = reading_history(scene, params, times, names)
    return archard(times, found[names[0]], found[names[1]], coefficient, hardness)


def of_run(scene: AbstractModel, params: Params, run: Any) -> dict[str, dict[str, float]]:
    """Wear volume, greatest Hertz pressure and rolling life of a finished run, by contact, members apart; from its samples.

    By the scene's materials. What a contact has not (a wear without friction, a pressure of no point contact) is left out.
    """
    found: dict[str, dict[str, float]] = {}
    for contact in scene.contacts:
        name = contact.name
        reading = Reading(run.force[name], run.penetration[name], run.rate[name], run.slip.get(name))
        for kind, what in READ_BY.items():
            one = channel(f"{name}.{what}", scene)
            try:
                values = read([one], Seen({name: reading}, shares=shares([one], scene, params)))[one.name]
            except InputError:
                continue
            for member, x in outputs.channels({name: np.asarray(values)}).items():
                number = features.KINDS[kind].of(features.Seen(run.times, x, None))
                found.setdefault(member, {})[kind] = float(number)
    return found


def depth_map(
    place: ArrayLike, times: ArrayLike, normal: ArrayLike, slip: ArrayLike, edges: ArrayLike, width: float, rate: float
) -> np.ndarray:
    """Wear depth along a track [m], a value a cell: the volume that was worn there over the cell's area. NumPy.

    Args:
        place: (T,) where along the track the contact is [m].
        times, normal, slip: (T,) as of ``archard``.
        edges: (C + 1,) of the cells along the track [m]; what is worn beyond them is in no cell.
        width: of the worn strip [m].
        rate: k/H [1/Pa].
    """
    where, t, cells = (np.asarray(x, dtype=float) for x in (place, times, edges))
    power_lost = np.abs(np.asarray(normal, dtype=float) * np.asarray(slip, dtype=float))
    volumes = rate * 0.5 * (power_lost[1:] + power_lost[:-1]) * np.diff(t)
    total, _ = np.histogram(0.5 * (where[1:] + where[:-1]), cells, weights=volumes)
    return total / (width * np.diff(cells))


def worn(volume: Callable[[float], float], clearance: float, area: float, repeats: float, blocks: int) -> np.ndarray:
    """Clearance (blocks + 1,) [m] that grows by wear: after each block of ``repeats`` runs the run is made anew.

    c' = c + repeats V(c)/A.

    Args:
        volume: wear volume of one run at a clearance [m^3].
        clearance: at first [m]; area: that wears [m^2].
        repeats: runs in a block; blocks: their number.
    """
    found = [float(clearance)]
    for _ in range(blocks):
        found.append(found[-1] + repeats * float(volume(found[-1])) / area)
    return np.array(found)


def grown(
    scene: AbstractModel, params: Params, times: ArrayLike, contact: str, runs_by_area: float, blocks: int
) -> np.ndarray:
    """``worn`` of a contact of a scene, whose run is made anew with each clearance; of members the mean volume.

    Args:
        scene, params, times: as of ``wear_volume``; materials are the scene's (``with_materials``).
        contact: one with friction and the parameter ``clearance_<contact>``.
        runs_by_area: runs in a block over the area that wears [1/m^2].
        blocks: as of ``worn``.

    Raises:
        InputError: as ``wear_volume``, and for a contact without a clearance.
    """
    name, read = f"clearance_{contact}", material(scene, contact)
    if name not in params:
        raise InputError(f"contact '{contact}'", "has no clearance that could grow", "name one with a clearance")

    def volume(clearance: float) -> float:
        how = {"coefficient": read["wear_coefficient"], "hardness": read["hardness"]}
        return float(jnp.mean(wear_volume(scene, {**params, name: jnp.asarray(clearance)}, times, contact, **how)))

    return worn(volume, float(params[name]), 1.0, runs_by_area, blocks)


class Cycles(NamedTuple):
    """Counted cycles: their ranges and means, in the history's unit, and counts (1, or 0.5 of half cycles)."""

    range: np.ndarray
    mean: np.ndarray
    count: np.ndarray


def rainflow(history: ArrayLike) -> Cycles:
    """Rainflow cycles of a history, ASTM E1049-85 (2017), 5.4.4; what does not close counts half. By fatpack (extra life).

    Raises:
        InputError: without fatpack, and for a history of fewer than two values or that is not finite.
    """
    y = real("rainflow", "history", history).ravel()
    if y.size < 2 or not np.isfinite(y).all():
        raise InputError("rainflow", f"{y.size} values", "give two finite values or more")
    fatpack = library("fatpack", "rainflow", "life")
    # Exact reversals: fatpack's own are those of values sorted into classes.
    y = y[np.concatenate([[True], np.diff(y) != 0])]
    inner = np.flatnonzero(np.diff(np.sign(np.diff(y)))) + 1
    turns = y[np.unique(np.concatenate([[0], inner, [y.size - 1]]))]
    closed, rest = fatpack.find_rainflow_cycles(turns)
    closed, rest = np.reshape(closed, (-1, 2)), np.asarray(rest)
    pairs = np.concatenate([closed, np.stack([rest[:-1], rest[1:]], 1)])
    count = np.concatenate([np.ones(len(closed)), np.full(len(pairs) - len(closed), 0.5)])
    return Cycles(np.abs(pairs[:, 1] - pairs[:, 0]), pairs.mean(1), count)


def damage(cycles: Cycles, stress: float, cycles_there: float, exponent: float) -> float:
    """Damage sum of Palmgren and Miner,  D = sum n_i/N_i,  N_i = N0 (S0/S_i)^m; failure is expected at D = 1.

    Args:
        cycles: of stress ranges [Pa] (or forces [N], and S0 in their unit).
        stress, cycles_there, exponent: S0, N0 and m of the S-N line, which goes on below S0 (without an endurance limit).
    """
    return float(np.sum(cycles.count * (cycles.range / stress) ** exponent) / cycles_there)


def equivalent_load(times: ArrayLike, normal: ArrayLike, exponent: ArrayLike = 3.0, speed: ArrayLike = 1.0) -> Array:
    """p-mean of a load over the rolled distance,  P = (int |N|^p w dt / int w dt)^(1/p)  [N] (ISO 281:2007, ISO/TS 16281).

    Differentiable where loaded.

    Args:
        times, normal: (T,) [s], (T, ...) [N].
        exponent: p: 3 of balls, 10/3 of rollers.
        speed: rolling speed w, in any unit; constant by default.
    """
    t, force = jnp.asarray(times), jnp.abs(jnp.asarray(normal))
    weight = jnp.broadcast_to(jnp.asarray(speed, dtype=float), force.shape)
    mean = jnp.trapezoid(power(force, exponent) * weight, t, axis=0) / jnp.trapezoid(weight, t, axis=0)
    return power(mean, 1.0 / jnp.asarray(exponent))


def rolling_life(rating: ArrayLike, load: ArrayLike, exponent: ArrayLike = 3.0) -> Array:
    """L10 = (C/P)^p in millions of revolutions (ISO 281:2007, 5.3): reached by 90 % of alike bearings.

    Args:
        rating: dynamic load rating C [N]; load: equivalent load P [N]; exponent: p as of ``equivalent_load``.
    """
    return (jnp.asarray(rating) / jnp.asarray(load)) ** exponent


def report(values: Mapping[str, float] = STEEL) -> str:
    """Material data with their sources, a line each."""
    return "\n".join(f"{name} = {value:g}: {SOURCES.get(name, 'given')}" for name, value in values.items())
