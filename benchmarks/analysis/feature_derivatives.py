"""Whether derivatives of features of a contact are those of the continuous curve, over laws, gaps and frictions.

Scenes of one impact, with values drawn at random: every law in a bounce, every gap between a wall and a body in a plane, and
every friction under a disc. ``bj.sensitivity`` at a force error of 1e-5, with few samples in the contact, against central
differences of runs without derivatives at 1e-9. A derivative counts where differences of two steps agree to 1e-4; a derivative
below 0.01 % per 1 % counts as that much. The duration is end less begin, and its bound is made of theirs.

    python -m benchmarks.analysis.feature_derivatives [--draws 1] [--only TEXT]
        writes results/feature_derivatives.json
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax import Body, Contact, Mechanism, gaps, loads
from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.certificate import LEAST
from bcfj_jax.analysis.derivatives.jacobian import channel_names, histories
from bcfj_jax.contact.laws import FRICTION, LAWS
from bcfj_jax.mechanism.observed import observing
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.analysis import chosen
from benchmarks.common import load, options, save

# Of the run, columns of ``Histories.curve``; of its only contact.
RUN, EVENTS = ("peak", "impulse", "dissipated_work", "penetration.peak"), ("begin_1", "end_1", "peak_time_1")
ACCURACY, TIGHT, STEPS, AGREE = 1e-5, 1e-9, (3e-4, 1e-4), 1e-4
# Values at 1e-9 are known to some 1e-10, which the shorter step makes 1e-6.
NOISE = 1e-6
# A gap with its sizes [m], how a body in the plane starts beside it, and the channel that touches first.
GAPS: dict[str, tuple[Any, dict[str, float], dict[str, float], str]] = {
    "sphere_on_sphere": (gaps.SphereOnSphere(), {"radius_a": 0.01, "radius_b": 0.01}, {"x": 2e-3, "y": -0.0202}, ""),
    "sphere_in_socket": (gaps.SphereInSocket(), {"clearance": 1e-4, "radius": 0.01}, {"x": 2e-5}, ""),
    "pin_in_bearing": (gaps.PinInBearing(), {"clearance": 1e-4, "radius": 0.01}, {"x": 2e-5}, ""),
    "pin_in_slot": (gaps.PinInSlot("x"), {"clearance": 1e-4, "radius": 0.01}, {"y": 2e-5}, ""),
    "slider_in_guide": (
        gaps.SliderInGuide("x"), {"clearance": 1e-4, "half_length": 0.02, "half_width": 0.01}, {"angle": 1e-3}, "_3",
    ),
    "two_sided_stop": (gaps.TwoSidedStop("y"), {"clearance": 1e-4}, {"y": 2e-5}, ""),
    "ball_in_groove": (
        gaps.BallInGroove(section="circular"), {"clearance": 1e-4, "ball_radius": 5e-3, "pitch_radius": 0.03, "offset": 2e-3},
        {"x": 0.03, "y": 2e-5}, "",
    ),
    "ball_between_planes": (gaps.BallBetweenPlanes("y"), {"clearance": 1e-4, "ball_radius": 5e-3}, {"y": 2e-5}, ""),
    "from_depth": (
        gaps.from_depth(lambda p, c: p[1] + 0.1 * p[0] - c["clearance"], needs=("clearance",)), {"clearance": 1e-4},
        {"y": 2e-5}, "",
    ),
}  # fmt: skip
SHARED = {
    "stiffness": 1e8, "exponent": 1.5, "mass": 0.02, "damping": 0.1, "friction_dynamic": 0.1, "friction_static": 0.15,
    "friction_speed": 0.05, "friction_memory": 1e-3, "friction_viscous": 0.01, "bristle_stiffness": 1e5,
    "bristle_damping": 10.0, "restitution": 0.7, "which": 0.0,
}  # fmt: skip
DROP = {
    "stiffness": 1e7, "mass": 0.5, "dashpot": 50.0, "damping_depth": 1e-4, "bottoming_stiffness": 1e7,
    "bottoming_penetration": 5e-4, "bottoming_width": 1e-4, "bottoming_damping": 0.2, "relaxation": 0.4,
    "relaxation_time": 1e-3, "yield_penetration": 3e-4,
}  # fmt: skip


def _remembers(law: Any) -> bool:
    return "approach_speed" in law.needs


# Laws, and frictions, of which one program serves all: with an approach speed, with states, and with neither.
SPEEDS, COURSES = ({n: x for n, x in LAWS.items() if test(x)} for test in (_remembers, lambda x: x.states))
OTHERS = {n: x for n, x in LAWS.items() if n not in (*SPEEDS, *COURSES)}
PLAIN = {n: x for n, x in FRICTION.items() if not (x.bristles or x.lags)}
LOSSES = ("restitution", "damping", "dashpot", "relaxation", "yield_penetration")
# Name, scene, what it is differentiated by, the channel that touches first, and the number of the law.
Case = tuple[str, Mechanism, tuple[str, ...], str, int]


def plane(gap: Any, sizes: dict[str, float], start: dict[str, Any], law: str, friction: Any) -> Mechanism:
    """A body in a plane beside a gap, under gravity."""
    body = Body("b", "planar", mass="mass", inertia=2.5e-6, start=start)
    contact = Contact("contact", ("ground", "b"), gap, law=law, friction=friction, smoothing=False, values=sizes)
    own = [(bj.Quantity(n, u, n), x) for n, u, x in (("height", "m", 0.0105), ("fall", "m/s", 0.5))]
    return _made("disc", body, contact, [one for one in own if one[0].name in start.values()], SHARED, 5e-3)


def drop(law: Any) -> Mechanism:
    """A body that falls on a surface."""
    body = Body("body", "slide", axis="y", mass="mass", start={"position": "drop_height"})
    contact = Contact("contact", ("ground", "body"), gaps.PointOnPlane("y"), law=law, smoothing=False)
    return _made("bounce", body, contact, [(bj.Quantity("drop_height", "m", "height"), 0.1)], SHARED | DROP, 0.3)


def _made(kind: str, body: Body, contact: Contact, own: list, values: dict[str, float], end: float) -> Mechanism:
    def scene(given: dict[str, float]) -> Mechanism:
        return Mechanism(kind, [body], [contact], [loads.Gravity("-y")], own=own, given=given, end=end)

    known = scene({}).quantities
    return scene({n: x for n, x in values.items() if n in known})


def cases() -> Iterator[Case]:
    """Scenes; of those of one program the scene is one object."""
    start = {"y": "height", "vx": 0.5, "vy": -0.5, "speed": 10.0}
    wrt = ("height", "mass", "stiffness", "friction_dynamic")
    disc = partial(plane, gaps.SphereOnPlane("y"), {"radius": 0.01}, start)
    yield "disc, flores, friction coulomb", disc("flores", "coulomb"), wrt, "contact", 0
    yield "disc, memory_free, friction None", disc("memory_free", None), wrt[:-1], "contact", 0
    scene = disc("memory_free", chosen.friction(PLAIN))
    for i, friction in enumerate(PLAIN):
        yield f"disc, memory_free, friction {friction}", scene, wrt, "contact", i
    for friction in (n for n in FRICTION if n not in PLAIN):
        yield f"disc, memory_free, friction {friction}", disc("memory_free", friction), wrt, "contact", 0
    for name, (gap, sizes, at, member) in GAPS.items():
        moving = {**at, "vx": 0.03, "vy": "fall", "speed": 0.5}
        by = ("fall", "mass", "stiffness", *(("clearance_contact",) if "clearance" in sizes else ()))
        yield f"gap {name}", plane(gap, sizes, moving, "memory_free", None), by, f"contact{member}", 0
    for title, known in (("speeds", SPEEDS), ("courses", COURSES), ("others", OTHERS)):
        scene = drop(chosen.law(known))
        for i, (law, one) in enumerate(known.items()):
            by = ("drop_height", "mass", "stiffness", *(n for n in LOSSES if n in one.needs))
            yield f"bounce, {title}, {law}", scene, by, "contact", i


def drawn(scene: Mechanism, wrt: tuple[str, ...], which: int, rng: np.random.Generator) -> dict[str, Any]:
    """The scene's values, those that it is differentiated by within a factor of 1.3, of a height above the disc 1.02."""
    found = {name: float(x) for name, x in scene.parameters().items()}
    found |= {"which": float(which)} if "which" in found else {}
    for name in wrt:
        reach = {"height": 0.02, "restitution": 0.1}.get(name, 0.3)
        found[name] *= float(np.exp(rng.uniform(-reach, reach)))
    return found


@lru_cache
def curve_of(scene: Mechanism, channel: str) -> Callable[[dict[str, Any], float], np.ndarray]:
    """Peak, impulse, work and greatest penetration of a run of values, which ends its steps on surfaces."""
    seen = observing(scene, [f"{channel}.penetration.peak"])
    names, how = channel_names(seen.members), Plan(plan(scene, TIGHT).tolerance)
    force, depth = names.index(channel), names.index(f"{channel}.penetration")
    run = jax.jit(lambda p, last: histories(seen, p, last * jnp.array([0.0, 1.0]), how, "reverse")[0].curve)

    def numbers(params: dict[str, Any], last: float) -> np.ndarray:
        found = run({n: jnp.asarray(x) for n, x in params.items()}, last)
        return np.array([*found[force, :3], found[depth, Curve._fields.index("peak")]])

    return numbers


def judged(name: str, scene: Mechanism, wrt: tuple[str, ...], channel: str, params: dict[str, Any]) -> list[dict]:
    """One row a derivative: relative error, bound, verdict, and how well its reference is known."""
    asked = [f"{channel}.{n}" for n in EVENTS]
    first = bj.contact_events(
        scene, params, np.array([0.0, 0.3 if scene.kind == "bounce" else 5e-3]), accuracy=TIGHT, features=asked
    )
    begin, end = (first.features[f"{channel}.{n}"] for n in EVENTS[:2])
    last = end + 0.5 * min(begin, end - begin)
    curve = curve_of(scene, channel)

    def numbers(changed: dict[str, Any]) -> np.ndarray:
        found = bj.contact_events(scene, changed, np.array([0.0, last]), accuracy=TIGHT, features=asked)
        times = [found.features[n] for n in asked]
        return np.array([*curve(changed, last), *times, times[1] - times[0]])

    # Some ten samples in the contact; as many of every scene.
    times = np.concatenate([[0.0], np.linspace(begin - 0.3 * min(begin, end - begin), last, 19)])
    kinds, here = (*RUN, *EVENTS), numbers(params)
    # The same names of every scene of a program.
    every = tuple(sorted({*wrt, *(n for n in LOSSES if n in scene.quantities)}))
    found = bj.sensitivity(scene, params, times, every, accuracy=ACCURACY, features=[f"{channel}.{n}" for n in kinds])
    assert found.certificate is not None
    rows = []
    for p in wrt:
        far, near = (
            (numbers({**params, p: params[p] * (1 + h)}) - numbers({**params, p: params[p] * (1 - h)}))
            / (2 * h * params[p])
            for h in STEPS
        )
        check = found.certificate.parameters[p]
        own = [found.feature_derivatives[p][f"{channel}.{n}"] for n in kinds]
        bounds = [check.features[f"{channel}.{n}"] for n in kinds]
        said = [check.feature_verdicts[f"{channel}.{n}"] for n in kinds]
        begun, ended = (kinds.index(n) for n in EVENTS[:2])
        own.append(own[ended] - own[begun])
        least = LEAST * np.abs(here / params[p])
        size = np.maximum(np.abs(near), least)
        bounds.append((bounds[ended] * size[ended] + bounds[begun] * size[begun]) / size[-1])
        said.append(max(said[begun], said[ended], key=lambda x: x != "trusted"))
        for k, kind in enumerate((*kinds, "duration")):
            if kind == "dissipated_work" and name.endswith("hertz"):
                continue  # None is lost.
            rows.append(
                {
                    "scene": name, "parameter": p, "feature": kind, "error": abs(own[k] - near[k]) / size[k],
                    "reference": abs(near[k] - far[k]) / size[k], "bound": bounds[k], "verdict": said[k],
                }
            )  # fmt: skip
    return rows


def main() -> None:
    """Judge, print and keep."""
    given = options(__doc__, draws=1, only=("", "scenes whose name holds this; others stay as they were kept"))
    rows = [r for r in load("feature_derivatives")["rows"] if given.only not in r["scene"]] if given.only else []
    for name, scene, wrt, channel, which in cases():
        if given.only not in name:
            continue
        # The same values whichever scenes are asked for.
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        own = [
            row for _ in range(given.draws) for row in judged(name, scene, wrt, channel, drawn(scene, wrt, which, rng))
        ]
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
