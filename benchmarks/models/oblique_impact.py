"""Does a sphere that strikes a plane at an angle rebound as measured? Tangential restitution and spin by angle.

    python -m benchmarks.models.oblique_impact
writes results/oblique_impact.json, docs/images/kharaz.png and the table in docs/oblique_impact.md.

The scene ``oblique_impact`` with Coulomb friction and with LuGre, beside Kharaz, Gorham and Salman's measurements, the
closed forms of the rigid sphere, and the independent integration with Mindlin's tangential stiffness.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from bcfj_jax import scenes, simulate
from bcfj_jax.io.plots import figure, style
from benchmarks.common import IMAGES, markdown, publish, save
from benchmarks.references import oblique_impact as reference

ANGLES = np.unique(np.r_[np.arange(1.0, 66.0), reference.KHARAZ["restitution"][:, 0], reference.KHARAZ["spin"][:, 0]])
# Of every run, as a share of the peak force.
ACCURACY = 1e-6
# Column of a curve's rows (restitution, spin).
CURVES = {"restitution": 0, "spin": 1}
NAMED = {
    "rigid": "rigid sphere, closed form", "coulomb": "`oblique_impact`, coulomb", "lugre": "`oblique_impact`, lugre",
    "mindlin": "with Mindlin's tangential stiffness",
}  # fmt: skip


def ours(friction: str) -> np.ndarray:
    """Tangential restitution [-] and spin after [rad/s] of the scene at ``ANGLES``, shape (A, 2)."""
    scene, rows = scenes.oblique_impact(friction=friction, smoothing=False), []
    for angle in np.radians(ANGLES):
        params = scene.parameters(impact_angle=float(angle))
        times = np.array([0.0, float(scene.horizon(params))])
        run = simulate(scene, params, times, accuracy=ACCURACY, read=("sphere.velocity.x", "sphere.spin.z"))
        assert run.status == "ok" and run.penetration["contact"][-1] < 0.0, run.reason
        along, turning = run.readings["sphere.velocity.x"], run.readings["sphere.spin.z"]
        # Rolling the way it flies turns the sphere about -z.
        rows.append((along[-1] / along[0], -turning[-1]))
    return np.array(rows)


def theirs(friction: str) -> np.ndarray:
    """The same of the reference: "rigid" in closed form, else integrated with a law of friction."""
    rows, steel = [], reference.Impact(friction=friction, stiffness_ratio=reference.KHARAZ_MINDLIN)
    for angle in np.radians(ANGLES):
        at = dataclasses.replace(steel, angle=float(angle))
        rows.append((reference.rigid(at) if friction == "rigid" else reference.rebound(at, 1e-9))[1:3])
    return np.array(rows)


def from_spin(points: np.ndarray) -> np.ndarray:
    """Angle [deg] and tangential restitution [-] that measured spins imply: v' - v = -(2/5) R w' whatever the friction."""
    p = reference.Impact()
    along = p.speed * np.sin(np.radians(points[:, 0]))
    return np.stack([points[:, 0], 1.0 - 0.4 * p.radius * points[:, 1] / along], axis=1)


def lowest(points: np.ndarray) -> str:
    """The least of (angle, value) rows, in words."""
    angle, value = points[points[:, 1].argmin()]
    return f"{value:.3f} at {angle:.0f}°"


def table(found: dict[str, Any]) -> str:
    """The least restitution of each, and measured points beside all models, as Markdown."""
    rows = [["", "angle", "measured", *NAMED.values()]]
    curves = {name: np.array(values) for name, values in found["models"].items()}
    for curve, column in CURVES.items():
        told = {"restitution": "tangential restitution", "spin": "spin [rad/s]"}[curve]
        for angle, measured in reference.KHARAZ[curve]:
            modelled = [curves[name][np.searchsorted(ANGLES, angle), column] for name in NAMED]
            digits = (lambda x: f"{x:.3f}") if column == 0 else (lambda x: f"{x:.0f}")
            rows.append([told, f"{angle:.1f}°", *map(digits, (measured, *modelled))])
    least = {"measured": reference.KHARAZ["restitution"], "measured by spin": from_spin(reference.KHARAZ["spin"])}
    least |= {NAMED[n]: np.stack([ANGLES, curves[n][:, 0]], axis=1) for n in ("lugre", "mindlin")}
    told = ", ".join(f"{name} {lowest(points)}" for name, points in least.items())
    return f"Least tangential restitution: {told}; rigid and coulomb 5/7 = 0.714.\n\n{markdown(rows)}"


def drawn(curves: dict[str, np.ndarray], path: Path) -> None:
    """Both curves over the angle, measured points on top."""
    looks: dict[str, dict[str, Any]] = {
        "rigid": {"color": "0.6", "linewidth": 4.0}, "coulomb": {}, "lugre": {}, "mindlin": {"linestyle": "--"},
    }  # fmt: skip
    with style():
        drawing, axes = figure(1, 2, width=10.0, height=4.0)
        for axis, (curve, column) in zip(axes, CURVES.items(), strict=True):
            for name, told in NAMED.items():
                axis.plot(ANGLES, curves[name][:, column], label=told.replace("`", ""), **looks[name])
            axis.plot(*reference.KHARAZ[curve].T, "ko", label="measured (Kharaz et al. 2001)")
            if curve == "restitution":
                axis.plot(*from_spin(reference.KHARAZ["spin"]).T, "ko", mfc="none", label="from measured spin")
            axis.axvline(math.degrees(reference.rolling_angle(reference.Impact())), color="0.6", linewidth=0.8)
            axis.set_xlabel("angle of impact from the normal [°]")
            axis.set_ylabel({"restitution": "tangential restitution [-]", "spin": "spin after impact [rad/s]"}[curve])
        # Where nothing is drawn.
        axes[1].legend(*axes[0].get_legend_handles_labels(), loc="lower right", fontsize=8.5)
        drawing.savefig(path)


def main() -> None:
    curves = {"rigid": theirs("rigid"), "coulomb": ours("coulomb"), "lugre": ours("lugre"), "mindlin": theirs("spring")}
    found = {
        "what": "tangential restitution [-] and spin after [rad/s] of Kharaz's sphere, by angle [deg] from the normal",
        "angles": ANGLES.tolist(), "rolling_angle": math.degrees(reference.rolling_angle(reference.Impact())),
        "measured": {name: points.tolist() for name, points in reference.KHARAZ.items()},
        "restitution_from_spin": from_spin(reference.KHARAZ["spin"]).tolist(),
        "models": {name: rows.tolist() for name, rows in curves.items()},
    }  # fmt: skip
    save("oblique_impact", found)
    publish("kharaz", table(found), "docs/oblique_impact.md")
    drawn(curves, IMAGES / "kharaz.png")


if __name__ == "__main__":
    main()
