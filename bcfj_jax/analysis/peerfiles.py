"""Files that run a drop in other simulators, from coefficients in their own terms (``analysis.export``).

In each a mass meets a fixed surface at a speed, without weight, and starts at touch; SI units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

Terms = Mapping[str, float]


def _mujoco(terms: Terms, mass: float, speed: float, lasting: float) -> tuple[str, str]:
    """MJCF: a sphere on a slide above a plane, one contact pair; load the keyframe before the first step."""
    return (
        "drop.xml",
        f"""<mujoco model="drop">
  <option gravity="0 0 0" timestep="{lasting / 2000:.9g}" cone="elliptic" solver="Newton" tolerance="0"/>
  <worldbody>
    <geom name="surface" type="plane" size="1 1 1"/>
    <body pos="0 0 0.1">
      <joint name="height" type="slide" axis="0 0 1"/>
      <geom name="ball" type="sphere" size="0.1" mass="{mass:.17g}"/>
    </body>
  </worldbody>
  <contact>
    <!-- negative solref: (-stiffness, -damping), per unit of mass -->
    <pair geom1="surface" geom2="ball" condim="1" solref="{-terms["stiffness"]:.17g} {-terms["damping"]:.17g}"
          solimp="0.9999 0.9999 0.001 0.5 2"/>
  </contact>
  <keyframe><key name="touch" qpos="0" qvel="{-speed:.17g}"/></keyframe>
</mujoco>
""",
    )


def _adams(terms: Terms, mass: float, speed: float, lasting: float) -> tuple[str, str]:
    """Adams/Solver dataset: a part on a translational joint and an SFORCE with IMPACT."""
    k, e, c, d = (f"{terms[name]:.12g}" for name in ("k", "e", "cmax", "d"))
    return (
        "drop.adm",
        f"""drop: IMPACT contact
UNITS/FORCE = NEWTON, MASS = KILOGRAM, LENGTH = METER, TIME = SECOND
PART/1, GROUND
MARKER/1, PART = 1
PART/2, MASS = {mass:.12g}, CM = 2, IP = 1, 1, 1, VZ = {-speed:.12g}
MARKER/2, PART = 2
MARKER/3, PART = 2
JOINT/1, TRANSLATIONAL, I = 3, J = 1
SFORCE/1, TRANSLATION, I = 2, J = 1
, FUNCTION = IMPACT(DZ(2, 1), VZ(2, 1), 0.0, {k},
, {e}, {c}, {d})
REQUEST/1, FORCE, I = 2, J = 1
INTEGRATOR/GSTIFF, SI2, ERROR = 1E-8, HMAX = {lasting / 500:.9g}
OUTPUT/REQSAVE
END
""",
    )


def _exudyn(terms: Terms, mass: float, speed: float, lasting: float) -> tuple[str, str]:
    """Python for Exudyn: a sphere against a sphere that is fixed; prints peak force and rebound."""
    return (
        "drop_exudyn.py",
        f"""import exudyn as exu
import numpy as np
from exudyn.utilities import (
    MarkerBodyRigid, NodeGenericData, ObjectContactSphereSphere, SensorBody, SensorObject, InertiaSphere
)

mass, speed, lasting, radius = {mass!r}, {speed!r}, {lasting!r}, 1.0
SC = exu.SystemContainer()
mbs = SC.AddSystem()
ground = mbs.CreateGround()
ball = mbs.CreateRigidBody(
    referencePosition=[0, 0, 2 * radius + 0.01 * speed * lasting],
    initialVelocity=[0, 0, -speed],
    inertia=InertiaSphere(mass, radius),
)
markers = [mbs.AddMarker(MarkerBodyRigid(bodyNumber=b, localPosition=[0, 0, 0])) for b in (ground, ball)]
node = mbs.AddNode(NodeGenericData(initialCoordinates=[1e-9, 0, 0, 0], numberOfDataCoordinates=4))
contact = mbs.AddObject(ObjectContactSphereSphere(
    markerNumbers=markers, nodeNumber=node, spheresRadii=[radius, radius],
    contactStiffness={terms["contactStiffness"]!r},
    contactStiffnessExponent={terms["contactStiffnessExponent"]!r},
    contactDamping={terms["contactDamping"]!r},
    restitutionCoefficient={terms["restitutionCoefficient"]!r},
    impactModel={int(terms["impactModel"])}, minimumImpactVelocity=1e-3 * speed,
))
force = mbs.AddSensor(SensorObject(objectNumber=contact, storeInternal=True, outputVariableType=exu.OutputVariableType.Force))
rate = mbs.AddSensor(SensorBody(bodyNumber=ball, storeInternal=True, outputVariableType=exu.OutputVariableType.Velocity))
mbs.Assemble()
settings = exu.SimulationSettings()
settings.timeIntegration.endTime = 8.0 * lasting
settings.timeIntegration.numberOfSteps = 16000
settings.timeIntegration.newton.useModifiedNewton = False
settings.timeIntegration.discontinuous.useRecommendedStepSize = False
settings.timeIntegration.discontinuous.maxIterations = 20
settings.timeIntegration.minimumStepSize = 1e-6 * lasting
settings.timeIntegration.verboseMode = 0
settings.solutionSettings.writeSolutionToFile = False
settings.solutionSettings.sensorsWritePeriod = lasting / 2000
mbs.SolveDynamic(settings, solverType=exu.DynamicSolverType.TrapezoidalIndex2)
peak = np.linalg.norm(mbs.GetSensorStoredData(force)[:, 1:4], axis=1).max()
rebound = mbs.GetSensorStoredData(rate)[-1, 3] / speed
print(f"peak {{peak:.9g}} rebound {{rebound:.9g}}")
""",
    )


def _modelica(terms: Terms, mass: float, speed: float, lasting: float) -> tuple[str, str]:
    """Modelica: a mass and an ElastoGap; Modelica Standard Library 4.0."""
    c, n, d = (f"{terms[name]:.17g}" for name in ("c", "n", "d"))
    return (
        "Drop.mo",
        f"""model Drop "One contact; Modelica Standard Library 4.0"
  Modelica.Mechanics.Translational.Components.Fixed surface;
  Modelica.Mechanics.Translational.Components.ElastoGap contact(c = {c}, n = {n}, d = {d}, s_rel0 = 0);
  Modelica.Mechanics.Translational.Components.Mass ball(
    m = {mass:.17g}, L = 0, s(start = 0, fixed = true), v(start = {-speed:.17g}, fixed = true));
equation
  connect(surface.flange, contact.flange_a);
  connect(contact.flange_b, ball.flange_a);
  annotation(experiment(StopTime = {8.0 * lasting:.9g}, Interval = {lasting / 500:.9g}, Tolerance = 1e-10));
end Drop;
""",
    )


def _chrono(terms: Terms, mass: float, speed: float, lasting: float) -> tuple[str, str]:
    """Python for PyChrono 9: a sphere of 1 m radius on a large fixed box, kn and gn given."""
    model = "Hertz" if terms["hertz"] else "Hooke"
    return (
        "drop_chrono.py",
        f"""import pychrono as chrono

mass, speed, lasting, radius = {mass!r}, {speed!r}, {lasting!r}, 1.0
system = chrono.ChSystemSMC()
system.SetGravitationalAcceleration(chrono.ChVector3d(0, 0, 0))
system.SetCollisionSystemType(chrono.ChCollisionSystem.Type_BULLET)
system.SetContactForceModel(chrono.ChSystemSMC.{model})
system.SetAdhesionForceModel(chrono.ChSystemSMC.AdhesionForceModel_Constant)
system.UseMaterialProperties(False)
material = chrono.ChContactMaterialSMC()
material.SetKn({terms["kn"]!r})
material.SetGn({terms["gn"]!r})  # per unit of effective mass
material.SetFriction(0.0)
ball = chrono.ChBodyEasySphere(radius, 1.0, False, True, material)
ball.SetMass(mass)
ball.SetPos(chrono.ChVector3d(0, radius, 0))
ball.SetPosDt(chrono.ChVector3d(0, -speed, 0))
surface = chrono.ChBodyEasyBox(10, 1, 10, 1.0, False, True, material)
surface.SetMass(1e12 * mass)
surface.SetPos(chrono.ChVector3d(0, -0.5, 0))
surface.SetFixed(True)
system.Add(ball)
system.Add(surface)
step, peak = lasting / 5000, 0.0
while system.GetChTime() < 8.0 * lasting:
    system.DoStepDynamics(step)
    peak = max(peak, abs(mass * ball.GetPosDt2().y))
print(f"peak {{peak:.9g}} rebound {{ball.GetPosDt().y / speed:.9g}}")
""",
    )


FILES: dict[str, Callable[[Terms, float, float, float], tuple[str, str]]] = {
    "mujoco": _mujoco, "adams": _adams, "exudyn": _exudyn, "modelica": _modelica, "chrono": _chrono
}  # fmt: skip
