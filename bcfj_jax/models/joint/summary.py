"""What a joint does as a whole in a run, and what ``summary.json`` says of that."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.mechanism.model import Orbit, Params
from bcfj_jax.models.joint import energy, engineering
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.fidelity import of_run
from bcfj_jax.models.joint.moments import NOTE, Moments, moments, quantities, table
from bcfj_jax.models.joint.observe import resultants
from bcfj_jax.models.joint.scene import GUIDES, Joint
from bcfj_jax.models.joint.system import view
from bcfj_jax.xla.programs import QUICK, program

RESULTANTS, MOMENTS = "resultants.csv", "moments.csv"


class Whole(NamedTuple):
    """What the joint as a whole does at T instants of a run with inertia."""

    resultants: dict[str, Array]  # by contact (T, 3) [N], see ``resultants``
    # power, stored: flows [W] and stores [J] of energy, (T,) each.
    power: energy.Power
    stored: energy.Stored
    # (T, 3) Newton's law of the cage, ``energy.cage_equilibrium`` [N]; None for a fixed cage.
    cage_residual: Array | None
    angle_error: Array  # (T,) head's turn less seat's [rad]
    speed_ratio: Array  # (T,) head's speed over seat's [-]
    rubbed: dict[str, Array] = {}  # by contact (T,) power that friction takes [W]
    moments: Moments | None = None  # ``moments.Moments``; None in a summary made by hand


def whole(scene: Joint, params: Params, times: Array, states: Array) -> Whole:
    """Everything in ``Whole``, of flat states (T, n) at the times [s]; NaN where a state is. On the host."""
    arguments = (dict(params), times, states)
    return program("whole", _whole, (scene,), arguments, QUICK)[0](*arguments)


def _whole(scene: Joint, params: Params, times: Array, states: Array) -> Whole:
    c = constants(scene, params)

    def one(t: Array, y: Array) -> Whole:
        # A law clips NaN to no force.
        failed = jnp.where(jnp.all(jnp.isfinite(y)), 0.0, jnp.nan)
        state = view(scene, c, y)
        found = Whole(
            resultants(scene, c, y),
            energy.power(scene, c, t, y),
            energy.stored(scene, c, t, y),
            energy.cage_equilibrium(scene, c, y, t) if scene.cage == "free" else None,
            state.head_turn - state.seat_turn,
            state.head_spin / state.seat_spin,
            energy.rubbed(scene, c, y),
            moments(scene, c, t, y),
        )
        return jax.tree.map(lambda x: x + failed, found)

    return jax.vmap(one)(times, states)


def of_the_whole(times: np.ndarray, whole: Whole) -> dict[str, Any]:
    """What ``summary.json`` says of a joint as a whole: what it transmits, its energy, Newton's law of its cage.

    Transmission is that of the last two thirds. Works [J] are trapezoidal sums over the samples, and their closure,
    |in - out - lost - change of the store| over the largest of them, is as good as these: ``energy_balance.balance`` resolves
    the motion between samples.
    """
    settled = times >= times[-1] / 3.0

    def work(power: Any, part: Any = slice(None)) -> float:
        return float(np.trapezoid(np.asarray(power)[part], times[part]))

    works = {name: work(flow) for name, flow in whole.power._asdict().items()}
    store = np.asarray(whole.stored.total)
    change = float(store[-1] - store[0])
    largest = max(map(abs, (*works.values(), change)))
    error, ratio = (np.asarray(x)[settled] for x in (whole.angle_error, whole.speed_ratio))
    given = work(whole.power.drive + whole.power.hold, settled)
    found = {
        "transmission": {
            "angle_error_min": float(error.min()),
            "angle_error_max": float(error.max()),
            "speed_ratio_min": float(ratio.min()),
            "speed_ratio_mean": float(ratio.mean()),
            "speed_ratio_max": float(ratio.max()),
            "efficiency": work(whole.power.load, settled) / given if given else float("nan"),
            "units": {"angle_error": "rad", "speed_ratio": "1", "efficiency": "1"},
        },
        "energy": {
            **works,
            "stored_change": change,
            "closure": abs(work(whole.power.net) - change) / largest if largest else float("nan"),
            "units": {"work": "J", "closure": "1"},
        },
    }
    if whole.cage_residual is not None:
        on_cage = [np.asarray(whole.resultants[name]) for name in whole.resultants if "cage" in name]
        found["cage_equilibrium"] = {
            "largest_residual": float(np.abs(whole.cage_residual).max()),
            "largest_resultant": float(np.abs(on_cage).max()) if on_cage else 0.0,
            "units": {"largest_residual": "N", "largest_resultant": "N"},
        }
    return found


def of_the_run(scene: Joint, params: Params, run: Any) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
    """``AbstractModel.whole``, at the level that the run has: pressure, patch and power of contacts; of motion transmission,
    energy, the cage's equilibrium, resultants.
    """
    scene = of_run(scene, run)
    if not scene.in_motion:
        return {"engineering": engineering.of_the_contacts(scene, params, run)}, {}
    found = whole(scene, params, run.times, run.trajectory)
    assert found.moments is not None
    columns = {
        f"{contact.name}.{axis} [N]": np.asarray(found.resultants[contact.name])[:, k]
        for contact in scene.contacts
        for k, axis in enumerate("xyz")
    }
    read = engineering.of_the_contacts(scene, params, run, found.rubbed)
    read |= {"quantities": quantities(scene, run.times, found.moments), "quantities_note": NOTE}
    tables = {RESULTANTS: columns, MOMENTS: table(scene, found.moments)}
    return of_the_whole(run.times, found) | {"engineering": read}, tables


def orbits(scene: Joint, params: Params, run: Any) -> dict[str, Orbit]:
    """``AbstractModel.orbits``: the cage in the seat, across the seat's axis, the head in the cage, across the head's.

    Of motion only. The joint's plane holds both axes.
    """
    scene = of_run(scene, run)
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
