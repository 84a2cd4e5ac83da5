"""Contacts beside Exudyn: its models of impact, a sphere in a hollow sphere, a sphere in a torus.

    python -m benchmarks.models.contact_peers      a minute; needs the extra ``bench``

Equal laws in both. Exudyn has two models of impact: 1 is Hunt and Crossley's factor 3 (1 - e)/2; 2 takes Gonthier's
(1 - e^2)/e up to e = 1/3 and Carvalho and Martins' above, as its rebounds say (its documentation names both). Its friction
grows in proportion to slip up to a speed, and is constant above: ``Ramp``, a friction law of three lines here.
Forces are vectors in the world's axes, normal and friction together; the error is the largest over time, as a share of the
peak. The cost is CPU time of one core, of runs whose error is at most 1 % of the peak: ours with its program compiled and at
the coarsest of ``ACCURACIES``, Exudyn at the fewest of ``STEPS``, that keep it. The slider-crank is in ``slider_crank_peers``.
"""

from __future__ import annotations

import functools
import importlib.metadata
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import exudyn as exu
import jax.numpy as jnp
import numpy as np
from exudyn.utilities import (
    InertiaSphere,
    MarkerBodyRigid,
    NodeGenericData,
    ObjectContactSphereSphere,
    ObjectContactSphereTorus,
    SensorBody,
    SensorObject,
)

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.contact.restitution import FACTORS
from benchmarks.clock import clocked
from benchmarks.common import publish, save

RESTITUTIONS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
MASS, RADIUS, STIFFNESS, EXPONENT = 0.0167, 8e-3, 2e9, 1.5
RESTITUTION, FRICTION, ZONE = 0.7, 0.2, 0.02
PLAY, MAJOR = 2e-3, 0.04
GRAVITY, END = 9.81, 0.05
# Largest error of what is timed, as a share of the peak, and the settings of ours, from coarse to fine.
ASKED, ACCURACIES = 1e-2, (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
# Exudyn's steps, from few to many; the finest run, twice the last, is read at every SPARSE-th.
STEPS, SPARSE = tuple(1000 * 2**k for k in range(9)), 50


class Ramp(bj.laws.AbstractFriction):
    """mu = mu_d |v|/v_t up to v_t, mu_d above: Exudyn's regularisation."""

    needs = ("friction_dynamic", "friction_speed")

    def mobility(self, speed_squared, c):
        """As ``AbstractFriction``."""
        return c["friction_dynamic"] / jnp.sqrt(jnp.maximum(speed_squared, c["friction_speed"] ** 2))


def mixed(e: Any) -> Any:
    """Exudyn's impactModel 2."""
    return jnp.where(jnp.asarray(e) <= 1 / 3, FACTORS["gonthier"](e), FACTORS["carvalho_martins"](e))


LAWS = {1: bj.laws.make("hunt_crossley"), 2: bj.laws.Restitution(factor=mixed)}


class Case(NamedTuple):
    """A ball in something that is fixed.

    Attributes:
        gap: ours; coefficients of the gap; place, velocity, spin of the ball at the start.
        contact: the kind of Exudyn's contact, and what it is told beside the law.
        friction: whether there is.
    """

    gap: bj.gaps.AbstractGap
    sizes: dict[str, float]
    place: tuple[float, float, float]
    velocity: tuple[float, float, float]
    contact: Callable[..., Any]
    told: dict[str, Any]
    friction: bool = True


HOLLOW = Case(
    bj.gaps.SphereInSocket(),
    {"clearance": PLAY, "radius": RADIUS + PLAY},
    (0.0, 0.0, 0.0),
    (0.25, 0.1, 0.0),
    ObjectContactSphereSphere,
    {"spheresRadii": [RADIUS, RADIUS + PLAY], "isHollowSphere1": True},
)
# The torus is about the y axis, so that the ball runs in the plane of x and z, as in a track of the joint.
TORUS = Case(
    bj.gaps.BallInGroove(section="circular"),
    {"clearance": PLAY, "ball_radius": RADIUS, "pitch_radius": MAJOR, "offset": 0.0},
    (MAJOR * math.sin(0.6), 0.0, -MAJOR * math.cos(0.6)),
    (0.15, 0.0, 0.0),
    ObjectContactSphereTorus,
    {
        "sphereRadius": RADIUS,
        "torusMajorRadius": MAJOR,
        "torusMinorRadius": RADIUS + PLAY,
        "torusAxis": [0.0, 1.0, 0.0],
    },
)
CASES = {
    "sphere in a hollow sphere": HOLLOW._replace(friction=False),
    "the same, with friction": HOLLOW,
    "sphere in a torus": TORUS._replace(friction=False),
    "the same torus, with friction": TORUS,
}


def exudyn(
    case: Case, steps: int, end: float = END, model: int = 2, restitution: float = RESTITUTION
) -> dict[str, Any]:
    """One run of Exudyn: times, forces on the ball (T, 3), its velocity at the end, CPU seconds."""
    system = exu.SystemContainer()
    mbs = system.AddSystem()
    ground = mbs.CreateGround()
    ball = mbs.CreateRigidBody(
        referencePosition=list(case.place), initialVelocity=list(case.velocity), inertia=InertiaSphere(MASS, RADIUS),
        gravity=[0.0, 0.0, -GRAVITY],
    )  # fmt: skip
    markers = [mbs.AddMarker(MarkerBodyRigid(bodyNumber=b, localPosition=[0, 0, 0])) for b in (ball, ground)]
    node = mbs.AddNode(NodeGenericData(initialCoordinates=[1e-9, 0, 0, 0], numberOfDataCoordinates=4))
    contact = mbs.AddObject(
        case.contact(
            markerNumbers=markers, nodeNumber=node, contactStiffness=STIFFNESS, contactStiffnessExponent=EXPONENT,
            restitutionCoefficient=restitution, impactModel=model, minimumImpactVelocity=1e-6,
            dynamicFriction=FRICTION if case.friction else 0.0, frictionProportionalZone=ZONE, **case.told,
        )
    )  # fmt: skip
    force = mbs.AddSensor(
        SensorObject(objectNumber=contact, storeInternal=True, outputVariableType=exu.OutputVariableType.Force)
    )
    speed = mbs.AddSensor(
        SensorBody(bodyNumber=ball, storeInternal=True, outputVariableType=exu.OutputVariableType.Velocity)
    )
    mbs.Assemble()
    settings = exu.SimulationSettings()
    integration = settings.timeIntegration
    integration.endTime, integration.numberOfSteps = end, steps
    integration.newton.useModifiedNewton = False
    integration.discontinuous.useRecommendedStepSize = False
    integration.discontinuous.maxIterations = 20
    integration.minimumStepSize = 1e-9 * end
    integration.verboseMode = 0
    settings.solutionSettings.writeSolutionToFile = False
    settings.solutionSettings.sensorsWritePeriod = end / steps
    _, took = clocked(lambda: mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2))
    kept = mbs.GetSensorStoredData(force)
    velocity = mbs.GetSensorStoredData(speed)[-1, 1:4]
    return {"t": kept[:, 0], "force": kept[:, 1:4], "velocity": velocity, "cpu_s": took["cpu_s"]}


def mechanism(case: Case, model: int = 2) -> bj.Mechanism:
    """The same scene here."""
    start = dict(zip(("x", "y", "z", "vx", "vy", "vz"), (*case.place, *case.velocity), strict=True))
    ball = bj.Body("ball", "sphere", mass=MASS, inertia=0.4 * MASS * RADIUS**2, start=start)
    contact = bj.Contact(
        "contact", ("ground", "ball"), case.gap, law=LAWS[model], friction=Ramp() if case.friction else None,
        smoothing=False, values=case.sizes,
    )  # fmt: skip
    return bj.Mechanism("ball", [ball], [contact], [bj.loads.Gravity("-z")], end=END)


def ours(scene: bj.Mechanism, times: np.ndarray, accuracy: float, restitution: float = RESTITUTION) -> dict[str, Any]:
    """One run: forces on the ball in the world's axes, velocity at the end, CPU seconds once compiled."""
    values = {"stiffness": STIFFNESS, "exponent": EXPONENT, "restitution": restitution, "gravity": GRAVITY}
    if scene.contacts[0].friction is not None:
        values |= {"friction_dynamic": FRICTION, "friction_speed": ZONE}
    params = scene.parameters(**values)
    read = [f"contact.force.{k}" for k in "xyz"] + [f"ball.velocity.{k}" for k in "xyz"]
    run = functools.partial(bj.simulate, scene, params, times, accuracy=accuracy, read=read)
    run()
    found, took = clocked(run)
    force, velocity = (np.stack([found.readings[name] for name in part], axis=-1) for part in (read[:3], read[3:]))
    return {"force": force, "velocity": velocity[-1], "cpu_s": took["cpu_s"], "status": found.status}


def largest(found: np.ndarray, right: np.ndarray) -> float:
    """Largest difference of two force histories, over the peak."""
    return float(np.linalg.norm(found - right, axis=1).max() / np.linalg.norm(right, axis=1).max())


def impulses(t: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Running integral of a force [N s], (T, 3)."""
    steps = 0.5 * np.diff(t)[:, None] * (force[1:] + force[:-1])
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def compared(case: Case) -> dict[str, float]:
    """Both at their finest, then what 1 % of the peak costs each."""
    right = exudyn(case, 2 * STEPS[-1])
    scene = mechanism(case)
    # Ours at some of Exudyn's own instants.
    times, force = right["t"][::SPARSE], right["force"][::SPARSE]
    fine = ours(scene, times, 1e-6)
    there, here = impulses(times, force)[-1], impulses(times, fine["force"])[-1]
    found = {
        "peak_N": float(np.linalg.norm(force, axis=1).max()),
        "force": largest(fine["force"], force),
        "impulse": float(np.linalg.norm(here - there) / np.linalg.norm(there)),
        "velocity": float(np.linalg.norm(fine["velocity"] - right["velocity"]) / np.linalg.norm(right["velocity"])),
    }
    for accuracy in ACCURACIES:
        error = largest(ours(scene, times, accuracy)["force"], fine["force"])
        if error <= ASKED:
            cpu = ours(scene, np.linspace(0.0, END, 1001), accuracy)["cpu_s"]
            found |= {"ours_accuracy": accuracy, "ours_error": error, "ours_cpu_s": cpu}
            break
    for steps in STEPS:
        run = exudyn(case, steps)
        at = np.stack([np.interp(run["t"], right["t"], right["force"][:, k]) for k in range(3)], axis=-1)
        error = largest(run["force"], at)
        if error <= ASKED:
            return found | {"exudyn_steps": steps, "exudyn_error": error, "exudyn_cpu_s": run["cpu_s"]}
    raise RuntimeError(f"no number of steps of {STEPS} has an error of {ASKED}: {error}")


def rebounds() -> list[dict[str, float]]:
    """Rebound over approach of a sphere that meets the wall of a hollow one at 0.5 m/s, by restitution asked for and model."""
    case = HOLLOW._replace(friction=False, velocity=(0.5, 0.0, 0.0))
    end = 2 * PLAY / 0.5
    rows = []
    for model in LAWS:
        scene = mechanism(case, model)
        for e in RESTITUTIONS:
            there = exudyn(case, 16000, 0.75 * end, model, e)["velocity"]
            here = ours(scene, np.array([0.0, 0.75 * end]), 1e-6, e)["velocity"]
            rows.append({"model": model, "asked": e, "exudyn": -float(there[0]) / 0.5, "ours": -float(here[0]) / 0.5})
    return rows


def pushed_aside() -> dict[str, float]:
    """A ball 1 um deep in the side of a torus, along the torus' axis, where symmetry leaves one direction for the force.

    Sine of the angle between the force and the axis, in Exudyn and here.
    """
    depth = 1e-6
    case = TORUS._replace(friction=False, place=(0.0, PLAY + depth, -MAJOR), velocity=(0.0, 0.0, 0.0))
    there = exudyn(case, 10, 1e-9)["force"][1]
    here = ours(mechanism(case), np.array([0.0, 1e-9]), 1e-6)["force"][1]
    return {name: float(np.hypot(f[0], f[2]) / np.linalg.norm(f)) for name, f in (("exudyn", there), ("ours", here))}


def tables(found: dict[str, Any]) -> str:
    """Those of the page."""

    def cost(tool: str, how: str) -> Callable[[dict[str, Any]], str]:
        return lambda c: f"{1e3 * c[f'{tool}_cpu_s']:.0f} ms, {c[f'{tool}_{how}']:g}, {c[f'{tool}_error']:.1e}"

    cases = harness.table({
        "scene": "{name}", "peak": "{peak_N:.1f} N", "force": "{force:.1e}", "impulse": "{impulse:.1e}",
        "speed at the end": "{velocity:.1e}", "ours: CPU, accuracy, error": cost("ours", "accuracy"),
        "Exudyn: CPU, steps, error": cost("exudyn", "steps"),
    }, ({"name": name, **c} for name, c in found["cases"].items()))  # fmt: skip
    by = {(r["model"], r["asked"]): r for r in found["rebounds"]}
    models = {
        f"model {m}: Exudyn, ours": lambda e, m=m: f"{by[m, e]['exudyn']:.5f}, {by[m, e]['ours']:.5f}" for m in LAWS
    }
    return f"{cases}\n\n{harness.table({'restitution asked for': '{0:g}'.format, **models}, RESTITUTIONS)}"


def main() -> None:
    """Run, keep, publish."""
    found = {
        "cases": {name: compared(case) for name, case in CASES.items()}, "rebounds": rebounds(), "aside": pushed_aside()
    }  # fmt: skip
    save("contact_peers", {"exudyn": importlib.metadata.version("exudyn"), **found})
    publish("contact_peers", tables(found), "docs/speed.md")
    print(found["aside"], max(abs(r["exudyn"] - r["ours"]) for r in found["rebounds"]))


if __name__ == "__main__":
    main()
