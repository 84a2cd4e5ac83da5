"""What accuracy mechanisms keep: force errors of every built-in scene down a ladder of tolerances.

Each case is run until before its contacts lose the order that two tight runs by different methods agree on, then at
rising tolerances against the tighter of them. An error is the worst of force rms, peak and impulse over all contacts.
Of every promise the largest tolerance that keeps it, it and all tighter ones, is found; over the promise that is the
constant (``mechanism.EXPLICIT``, ``IMPLICIT``) that the case would bear.

    python -m benchmarks.solve.mechanisms [--only CASE ...]      writes results/mechanisms.json
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import benchmarks.common as harness
from bcfj_jax.contact.gaps import PointOnPlane
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.loads import Gravity, Spring
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.models import scenes
from bcfj_jax.solve import measured_error
from bcfj_jax.solve.plan import MAX_STEPS, Plan
from bcfj_jax.solve.simulation import Run, timed
from benchmarks.clock import keep_programs
from benchmarks.common import known, load, options, save

ASKED = (5e-2, 1e-2, 1e-3, 1e-5)
LADDER = {
    False: tuple(10.0 ** (-0.25 * k) for k in range(12, 41)),
    True: tuple(10.0 ** (-0.25 * k) for k in range(0, 24)),
}
# Tight runs that stand for the truth, by method and tolerance; the second confirms the first.
TIGHT = {False: (("tsit5", 1e-12), ("dopri5", 1e-11)), True: (("bdf", 1e-7), ("rodas3", 3e-7))}
# References further apart than this fraction of a promise are none; stands for the error of a failed run.
CERTAIN, LOST = 0.05, 1e9


class Case(NamedTuple):
    """A scene, or its name and options, with parameters, run to an end [s]; None for the scene's own."""

    kind: str | Mechanism
    options: dict[str, Any] = {}
    values: dict[str, float] = {}
    end: float | None = None


def _dragged(friction: str) -> Mechanism:
    """A block that a spring drags over a plane, jerk by jerk: it sticks until the spring is stretched enough."""
    bodies = (
        Body("hand", "slide", axis="x", mass=1.0, drive=Drive("constant", speed=0.05)),
        Body("block", "planar", mass=1.0, inertia=1e-3),
    )
    corners = [
        Contact(
            name, ("ground", "block"), PointOnPlane("y"), friction=friction, smoothing=False, at=((0, 0, 0), (x, 0, 0))
        )
        for name, x in (("heel", -0.05), ("toe", 0.05))
    ]
    loads = (Gravity("-y"), Spring("spring", ("hand", "block"), 1e3, at=((0, 1e-3, 0), (0, 0, 0))))
    given = {
        "stiffness": 1e8, "exponent": 1.5, "damping": 1.0, "friction_static": 0.3, "friction_dynamic": 0.15,
        "friction_speed": 0.01, "bristle_stiffness": 1e5, "bristle_damping": 10.0,
    }  # fmt: skip
    known = {"stiffness", "exponent", "damping", *corners[0].friction.needs}  # pyright: ignore
    return Mechanism("dragged", bodies, corners, loads, given={k: v for k, v in given.items() if k in known}, end=0.5)


_LIGHT = {"clearance_journal": 5e-5, "damping": 0.1665}
_LAWS = {"friction": "lugre"}, {"friction": "coulomb"}, {"friction": "step"}
CASES: dict[str, Case] = {
    "impact": Case("impact"),
    "chain": Case("chain"),
    "chain, damped": Case("chain", {"count": 5, "law": "memory_free"}),
    "crank 0.05 mm": Case("slider_crank", values={"clearance_journal": 5e-5}),
    "crank 0.2 mm": Case("slider_crank", values={"clearance_journal": 2e-4}),
    "crank 0.5 mm": Case("slider_crank"),
    "crank, rubbing": Case("slider_crank", {"friction": True}),
    "crank, rubbing, light": Case("slider_crank", {"friction": True}, _LIGHT),
    "crank 0.5 mm, rubbing, light": Case("slider_crank", {"friction": True}, {"damping": 0.1665}, end=6e-3),
    "crank 0.05 mm, light": Case("slider_crank", values=_LIGHT),
    "crank, latched": Case("slider_crank", {"law": "lankarani_nikravesh"}, end=5e-3),
    "guide": Case("slider_guide"),
    "guide, elastic": Case("slider_guide", {"law": "hertz"}),
    "guide, rubbing": Case("slider_guide", {"friction": True}),
    "backlash": Case("backlash"),
    "backlash, free": Case("backlash", {"driven": False}),
    "backlash, smooth": Case("backlash", {"law": "memory_free"}, {"smoothing": 0.05}),
    "oblique": Case("oblique_impact"),
    "oblique, 60 deg": Case("oblique_impact", values={"impact_angle": 1.05}),
    "oblique, no friction": Case("oblique_impact", {"friction": False}),
    **{f"oblique, {law['friction']}": Case("oblique_impact", law) for law in _LAWS},
    "oblique, 5 deg": Case("oblique_impact", values={"impact_angle": 0.09}),
    **{f"dragged, {law}": Case(_dragged(law)) for law in ("brown_mcphee", "lugre")},
    "guide, elastic, rubbing": Case("slider_guide", {"law": "hertz", "friction": True}),
    "four-bar": Case("four_bar", end=0.3),
    "four-bar, smooth": Case("four_bar", {"friction": False}, end=0.3),
}


def measured(case: Case) -> dict[str, Any]:
    """Errors and steps of a case at the tolerances of ``ASKED`` and down the ladder."""
    scene = scenes.make(case.kind, **case.options) if isinstance(case.kind, str) else case.kind
    params = scene.parameters(case.values)
    end = float(scene.horizon(params)) if case.end is None else case.end
    times, stiff = np.linspace(0.0, end, scene.samples), scene.traits.stiff

    def at(tolerance: float, solver: str | None = None) -> Run:
        return timed(scene, params, times, Plan(jnp.asarray(tolerance), 10 * MAX_STEPS, solver=solver))

    truth, other = (at(tight, solver) for solver, tight in TIGHT[stiff])

    def off(run: Run) -> float:
        found = measured_error.measured(1.0, 0.0, times, run.force, truth.force, tolerance=0.0, wall_s=0.0).worst
        return float(found) if np.isfinite(found) else LOST

    row: dict[str, Any] = {"stiff": stiff, "end_s": end, "apart": off(other), "tight_steps": truth.stats["accepted"]}

    def error(tolerance: float) -> tuple[float, int]:
        run = at(tolerance)
        return off(run), int(run.stats["accepted"] + run.stats["rejected"])

    stated = [error(scene.tolerance(asked)) for asked in ASKED]
    row |= {"asked": ASKED, "error": [e for e, _ in stated], "steps": [n for _, n in stated]}
    row["ladder"] = [error(tolerance)[0] for tolerance in LADDER[stiff]]
    row["kept"] = [_kept(row["ladder"], LADDER[stiff], asked) for asked in ASKED]
    return row


def _kept(errors: list[float], ladder: tuple[float, ...], promise: float) -> float | None:
    """The largest tolerance that keeps a promise, as all tighter ones do, over it."""
    broken = np.flatnonzero(np.array(errors) > promise)
    first = int(broken[-1]) + 1 if broken.size else 0
    return ladder[first] / promise if first < len(ladder) else None


def report(rows: dict[str, dict[str, Any]]) -> str:
    """A table: by case the error over what was asked and, in brackets, the constant that would keep it."""

    def cell(row: dict[str, Any], k: int) -> str:
        bears = "-" if row["kept"][k] is None else f"{row['kept'][k]:.1g}"
        return f"{row['error'][k] / ASKED[k]:.2g} ({bears})" if row["apart"] <= CERTAIN * ASKED[k] else "no reference"

    return harness.table({
        "case": "{name}", "solver": lambda row: "implicit" if row["stiff"] else "explicit",
        **{f"{100 * asked:g} %": lambda row, k=k: cell(row, k) for k, asked in enumerate(ASKED)},
        "steps": "{steps[1]}", "references apart": "{apart:.1g}",
    }, ({"name": name, **row} for name, row in rows.items()))  # fmt: skip


def main() -> None:
    only = options(__doc__, only=CASES).only
    keep_programs()
    every = known("mechanisms").get("cases", {})
    for name in only:
        every[name] = measured(CASES[name])
        print(report({name: every[name]}).splitlines()[-1], flush=True)
        kept = {name: every[name] for name in CASES if name in every}
        save("mechanisms", {"asked": ASKED, "ladder": {str(k): v for k, v in LADDER.items()}, "cases": kept})
    print(report(load("mechanisms")["cases"]))


if __name__ == "__main__":
    main()
