"""Makes lab_drop.csv: a synthetic drop test, written as a German data logger writes it. Not a measurement.

python examples/lab_drop.py    a 0.5 kg mass falls onto a pad at 1.1 m/s; scene `impact` with gravity, 1 % noise of a fixed seed

The law that made it: stiffness 8e5 N/m^1.4, exponent 1.4, damping 0.12 s/m. docs/howto/data_files.md finds it again.
"""

from pathlib import Path

import numpy as np

import bcfj_jax as bj

SPEED, FIRST = 1.1, 12.34e-3  # approach speed [m/s]; first contact on the logger's clock [s]
scene = bj.scenes.impact(gravity=True)
law = {"stiffness": 8e5, "exponent": 1.4, "damping": 0.12}
params = scene.parameters(mass=0.5, approach_speed=SPEED, **law)
clock = np.arange(0.0, 0.04, 1e-4)
inside = np.flatnonzero(clock >= FIRST)
run = bj.simulate(scene, params, np.concatenate([[0.0], clock[inside] - FIRST]), accuracy="reference")
force = np.zeros(clock.size)
force[inside] = np.asarray(run.force["contact"])[1:, 0]
force += 3.0 + 0.01 * force.max() * np.random.default_rng(22).standard_normal(
    clock.size
)  # the zero of the cell is off by 3 N


def german(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


lines = [
    "# Fallprüfstand Halle 2, Kraftmessdose 5 kN",
    "# synthetisch: siehe lab_drop.py",
    "Prüfer: Müller",
    "Abtastrate: 10 kHz",
    "",
    "Zeit [ms];Kraft [kN]",
    *(f"{german(1e3 * t, 1)};{german(1e-3 * f, 5)}" for t, f in zip(clock, force, strict=True)),
]
path = Path(__file__).parent / "lab_drop.csv"
path.write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))
