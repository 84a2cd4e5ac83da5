"""Ball-cage joint, Hooke's joint and double Hooke's joint at equal envelope, torque, angle and speed.

    python -m benchmarks.models.hooke     some three minutes on two cores; benchmarks/results/hooke.json, docs/images/hooke.svg

Each runs with its defaults (1800 N m, 23 degrees, 100 r/min, friction 0.12/0.03) until a turn after the torque has risen; all
figures are of that last turn. Transmission error is the output's angle less the input's, less its mean. Sliding work and wear
are sums over all contacts and members, wear by ``analysis.life`` at its default material. Pressure is Hertz's: of the joint's
contacts by its own radii, of pins that of a line as long as the pin is thick (``stiffness.LineContact``).
Life is ``life.rolling_life`` of the
contact that bears most at one load rating for all, so that only the loads are compared: a pin does not roll.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.analysis import life
from bcfj_jax.mechanism import materials
from bcfj_jax.mechanism.channels import channel, histories
from benchmarks.common import IMAGES, publish, save

SCENES: dict[str, tuple[Any, str]] = {
    "ball-cage joint": (bj.scenes.joint, "head"),
    "Hooke": (bj.scenes.hooke, "output"),
    "double Hooke": (lambda: bj.scenes.hooke(double=True), "output"),
}
SAMPLES, RATING = 6501, 30e3
HEADS = {
    "transmission_error": ("transmission error, peak to peak [mrad]", 1e3),
    "drive_ripple": ("drive torque, greatest less least [N m]", 1.0),
    "peak_force": ("greatest contact force [kN]", 1e-3),
    "pressure": ("greatest Hertz pressure [GPa]", 1e-9),
    "sliding_work": ("sliding work a turn [J]", 1.0),
    "efficiency": ("efficiency [%]", 100.0),
    "wear": ("wear a turn [1e-6 mm^3]", 1e15),
    "life": ("L10 of the contact loaded most [1e6]", 1.0),
}


def _pressure(scene: Any, params: Any, name: str, force: float) -> float:
    """Greatest Hertz pressure of a contact [Pa] at a force [N]."""
    share, exponent, least = (float(x) for x in materials.share(scene, params, name, "pressure"))
    return max(share * force**exponent, least * force)


def of(name: str) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """Figures of one joint, the input's turn over its last turn [rad], and its transmission error there [rad]."""
    make, output = SCENES[name]
    scene = make()
    params = scene.parameters()
    start, speed = float(params["load_ramp"]), float(params["drive_speed"])
    times = np.linspace(0.0, start + 2.0 * np.pi / speed, SAMPLES)
    run = bj.simulate(scene, params, times)
    t, y = jnp.asarray(times), jnp.asarray(run.trajectory)
    late = times >= start
    prepared = scene.prepare(params)
    flows = jax.jit(jax.vmap(lambda t, y: scene.flows(t, y, prepared)))(t, y)
    angle = jax.jit(lambda y: histories(scene, params, t, y, [channel(f"{output}.angle", scene)]))(y)
    turned: Any = np.unwrap(np.asarray(angle[f"{output}.angle"]))
    error = turned - speed * times
    error = (error - error[late].mean())[late]
    work = {k: float(np.trapezoid(np.asarray(x)[late], times[late])) for k, x in (flows.given | flows.taken).items()}
    drive = next(k for k in flows.given if "drive" in k)
    given, load = work[drive], next(abs(x) for k, x in work.items() if "load" in k or "torque" in k)
    torque = np.asarray(flows.given[drive])[late] / speed
    found: dict[str, float] = {"steps": float(run.stats["accepted"] + run.stats["rejected"])}
    peaks, rubbed, worn, lives, pressures = {}, 0.0, 0.0, [], []
    for contact, force in run.force.items():
        normal, slip = np.abs(force[late, ..., 0]), run.slip[contact][late]
        peaks[contact] = float(normal.max())
        worn += float(
            np.sum(life.archard(times[late], normal, slip, life.STEEL["wear_coefficient"], life.STEEL["hardness"]))
        )
        drag = np.hypot(force[late, ..., 1], force[late, ..., 2]) * slip
        rubbed += float(np.sum(np.trapezoid(drag, times[late], axis=0)))
        lives.append(float(np.min(life.rolling_life(RATING, life.equivalent_load(times[late], normal)))))
        pressures.append(_pressure(scene, params, contact, peaks[contact]))
    found |= {
        "transmission_error": float(np.ptp(error)), "drive_ripple": float(np.ptp(torque)), "peak_force": max(peaks.values()),
        "pressure": max(pressures), "sliding_work": rubbed, "efficiency": load / given, "wear": worn, "life": min(lives),
        "drive_work": given, "load_work": load,
    }  # fmt: skip
    print(name, found, peaks, work, flush=True)
    return found | {f"peak {k}": x for k, x in peaks.items()}, speed * (times[late] - start), error


def main() -> None:
    """All joints, their table and picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    found = {name: of(name) for name in SCENES}
    save("hooke", {"joints": {name: row for name, (row, _, _) in found.items()}})
    cells = {n: lambda one, n=n: f"{one[1][1] * found[n][0][one[0]]:.3g}" for n in found}
    publish("hooke", harness.table({"": lambda one: one[1][0], **cells}, HEADS.items()), "docs/hooke.md")
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for name, (_, turn, error) in found.items():
        left.plot(np.degrees(turn), 1e3 * error, label=name)
    left.set(xlabel="turn of the input [deg]", ylabel="transmission error [mrad]")
    left.legend(fontsize=8)
    keys = ("peak_force", "sliding_work", "wear")
    for i, (name, (row, _, _)) in enumerate(found.items()):
        share = [row[key] / found["ball-cage joint"][0][key] for key in keys]
        right.bar(np.arange(len(keys)) + 0.27 * (i - 1), share, 0.25, label=name)
    right.set(
        xticks=np.arange(len(keys)),
        xticklabels=["greatest force", "sliding work", "wear"],
        ylabel="over the ball-cage joint's",
    )
    figure.savefig(IMAGES / "hooke.svg")


if __name__ == "__main__":
    main()
