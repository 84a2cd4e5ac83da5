"""Whether derivatives of peaks, impulses and instants are those of the continuous curve, over laws, gaps and frictions.

Random scenes of one impact: a disc on a plane with frictions, and laws in a bounce. ``bj.sensitivity`` at a force error of 1e-5,
with few samples in the contact, against central differences of runs without derivatives at 1e-9. A derivative counts where
differences of two steps agree to 1e-4; a derivative below 0.01 % per 1 % counts as that much.

    python -m benchmarks.analysis.feature_derivatives [--draws 3] [--only TEXT]
        writes results/feature_derivatives.json
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps, loads
from bcfj_jax.analysis.derivatives.certificate import LEAST
from benchmarks.common import load, save

LAWS = (
    "flores", "walton_braun", "memory_free", "exact", "lankarani_nikravesh", "gonthier", "hunt_crossley", "zhang", "hertz",
)  # fmt: skip
FRICTIONS = (None, "coulomb")
# Feature of the run, and the same of its only contact.
SAME = {"peak": "peak_1", "impulse": "impulse_1"} | {x: x for x in ("begin_1", "end_1", "peak_time_1")}
ACCURACY, TIGHT, STEPS, AGREE = 1e-5, 1e-9, (3e-4, 1e-4), 1e-4
# Values at 1e-9 are known to some 1e-10, which the shorter step makes 1e-6.
NOISE = 1e-6
Case = tuple[str, Mechanism, tuple[str, ...]]


def cases() -> Iterator[Case]:
    """Scenes by name, each with the parameters that it is differentiated by."""
    for law, friction in (("flores", "coulomb"), *(("memory_free", y) for y in FRICTIONS)):
        body = Body(
            "b", "planar", mass="mass", inertia=2.5e-6, start={"y": "height", "vx": 0.5, "vy": -0.5, "speed": 10.0}
        )
        contact = Contact(
            "contact", ("ground", "b"), gaps.SphereOnPlane("y"), law=law, friction=friction, smoothing=False,
            values={"radius": 0.01},
        )  # fmt: skip
        own = [(bj.Quantity(n, u, n, 0.0), x) for n, u, x in (("height", "m", 0.0105),)]
        given = {"stiffness": 1e8, "exponent": 1.5, "mass": 0.02, "damping": 0.1, "restitution": 0.7}
        given |= {"friction_dynamic": 0.1, "friction_static": 0.15, "friction_speed": 0.05, "stribeck_speed": 0.2}
        scene = Mechanism("disc", [body], [contact], [loads.Gravity("-y")], own=own, end=5e-3)
        known = {n: x for n, x in given.items() if n in scene.quantities}
        scene = Mechanism("disc", [body], [contact], [loads.Gravity("-y")], own=own, given=known, end=5e-3)
        wrt = ("height", "mass", "stiffness", *(("friction_dynamic",) if friction else ()))
        yield f"disc, {law}, friction {friction}", scene, wrt
    for law in LAWS:
        scene = bj.scenes.bounce(law=law, smoothing=False)
        loss = tuple(n for n in ("restitution", "damping") if n in scene.quantities)
        yield f"bounce, {law}", scene, ("drop_height", "mass", "stiffness", *loss)


def drawn(scene: Mechanism, wrt: tuple[str, ...], rng: np.random.Generator) -> dict[str, Any]:
    """The scene's values, those that it is differentiated by within a factor of 1.3, of a height above the disc 1.02."""
    loss = {"restitution": 0.7} if "restitution" in scene.quantities else {}
    found = {name: float(x) for name, x in scene.parameters(loss).items()}
    for name in wrt:
        reach = {"height": 0.02, "restitution": 0.1}.get(name, 0.3)
        found[name] *= float(np.exp(rng.uniform(-reach, reach)))
    return found


def judged(name: str, scene: Mechanism, wrt: tuple[str, ...], params: dict[str, Any]) -> list[dict[str, Any]]:
    """One row a derivative: relative error, bound, verdict, and how well its reference is known."""
    asked = [f"contact.{n}" for n in SAME.values()]
    first = bj.contact_events(
        scene, params, np.linspace(0.0, 0.3 if scene.kind == "bounce" else 5e-3, 3), accuracy=TIGHT
    )
    begin, end = first.features["contact.begin_1"], first.features["contact.end_1"]
    last = end + 0.5 * min(begin, end - begin)

    def numbers(changed: dict[str, Any]) -> np.ndarray:
        found = bj.contact_events(scene, changed, np.array([0.0, last]), accuracy=TIGHT, features=asked)
        return np.array([found.features[n] for n in asked])

    # Some ten samples in the contact.
    times = np.linspace(0.0, last, int(10 * last / (end - begin)) + 2)
    if len(times) > 20_001:
        times = np.concatenate([[0.0], np.linspace(begin - 0.3 * (end - begin), last, 19)])
    found = bj.sensitivity(scene, params, times, wrt, accuracy=ACCURACY, features=[f"contact.{n}" for n in SAME])
    assert found.certificate is not None
    rows = []
    for p in wrt:
        far, near = (
            (numbers({**params, p: params[p] * (1 + h)}) - numbers({**params, p: params[p] * (1 - h)}))
            / (2 * h * params[p])
            for h in STEPS
        )
        check = found.certificate.parameters[p]
        for k, (feature, value) in enumerate(zip(SAME, numbers(params), strict=True)):
            own, least = found.feature_derivatives[p][f"contact.{feature}"], LEAST * abs(value / params[p])
            size = max(abs(near[k]), least)
            rows.append(
                {
                    "scene": name, "parameter": p, "feature": feature, "error": abs(own - near[k]) / size,
                    "reference": abs(near[k] - far[k]) / size, "bound": check.features[f"contact.{feature}"],
                    "verdict": check.feature_verdicts[f"contact.{feature}"],
                }
            )  # fmt: skip
    return rows


def main() -> None:
    """Judge, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--only", default="", help="scenes whose name holds this; others stay as they were kept")
    rng, given = np.random.default_rng(7), parser.parse_args()
    draws = given.draws
    rows = [r for r in load("feature_derivatives")["rows"] if given.only not in r["scene"]] if given.only else []
    for name, scene, wrt in cases():
        if given.only not in name:
            continue
        own = [row for _ in range(draws) for row in judged(name, scene, wrt, drawn(scene, wrt, rng))]
        known = [r for r in own if r["reference"] <= AGREE]
        worst = max(known, key=lambda r: r["error"], default=None)
        print(name, len(own), len(known), worst, flush=True)
        rows += own
        # Kept after each, so that what is cut short is not lost.
        save("feature_derivatives", summary(rows))
    print({k: v for k, v in summary(rows).items() if k != "rows"})


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How many are known, trusted and outside their bounds, and the worst."""
    known = [r for r in rows if r["reference"] <= AGREE]
    trusted = [r for r in known if r["verdict"] == "trusted"]
    # Beyond what the reference is known to, and what solves at 1e-9 are.
    outside = [r for r in trusted if r["error"] > r["bound"] + r["reference"] + NOISE]
    return {
        "derivatives": len(rows), "known": len(known), "trusted": len(trusted),
        "worst": max((r["error"] for r in known), default=None),
        "worst_trusted": max((r["error"] for r in trusted), default=None),
        "outside_bound": len(outside), "outside": outside, "rows": rows,
    }  # fmt: skip


if __name__ == "__main__":
    main()
