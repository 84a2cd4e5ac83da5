"""Cases of the box that ended well, against solvers that share nothing with the package: is what was promised kept?

Of ``impact`` and ``bounce`` forces, and derivatives that a certificate calls trusted, by ``extremes_mass``; of a joint
shared loads, equilibria with their derivatives, and short motions, by ``extremes_joint`` (which needs the extra
``bench``). A case in which nothing touches checks nothing, and one whose reference is not known does not either: both
are counted apart.

    python -m benchmarks.analysis.extremes_check [CHECK ...]    after extremes.py; adds to benchmarks/results/extremes.json
"""

from __future__ import annotations

import json
import random
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.analysis.derivatives.certificate import INFLUENCE, POINTWISE, TRUSTED
from bcfj_jax.core.status import OK
from bcfj_jax.solve.plan import plan
from bcfj_jax.solve.simulation import outcome
from benchmarks.analysis.extremes import ACCURACY, KEPT, SAMPLES, instants
from benchmarks.analysis.extremes_box import VARIANTS, Variant
from benchmarks.analysis.extremes_joint import KNOWN, apart, balanced, differences, moved, shared, stacked
from benchmarks.analysis.extremes_mass import CONTACTS, Case, slope, touches
from benchmarks.analysis.extremes_mass import SAMPLES as FINE
from benchmarks.clock import keep_programs
from benchmarks.common import load, options, save

# What ``balanced`` promises, and what is solved to rounding.
PROMISED, ROUNDING = 1e-2, 1e-6
SLOPES = 120
Errors = dict[str, float]
NOTHING, UNKNOWN, FAILED = "nothing touches", "no reference", "failed"


def scene_of(variant: Variant) -> Any:
    """The scene of a variant of the box."""
    return bj.scenes.make(variant.scene if variant.scene in bj.scenes.SCENES else "joint", **variant.options)


def numbers(variant: Variant, row: dict[str, Any]) -> dict[str, float]:
    """All parameters of a case: what rules all contacts rules each one's own."""
    scene = scene_of(variant)
    p = {name: float(value) for name, value in scene.parameters(variant.fixed).items()}
    given = {name: float(row[name]) for name in row if name in scene.quantities}
    return p | given | {own: given[own.split(".")[1]] for own in p if own.partition(".")[2] in given}


def mass_forces(variant: Variant, row: dict[str, Any]) -> Errors | str:
    """Errors of an impact's or a bounce's forces in fractions of each contact's peak."""
    params, kind = numbers(variant, row), variant.scene
    found = touches(kind, Case(variant.name, params))
    if not found:
        return NOTHING
    times, which = [], []
    for k, one in enumerate(found):
        last = one.end - one.start
        # A rebound within the promise shifts the next contact by many of its durations.
        margin = min(50.0, 0.3 * (one.start - found[k - 1].end) / last if k else 0.0)
        later = np.linspace(one.start - margin * last, one.start + (1.1 + margin) * last, 10 * FINE)
        times.append(later if k else one.instants)
        which.append(np.full(times[-1].size, k))
    while len(times) < (CONTACTS if kind == "bounce" else 1):
        # One program for all: what is over is followed by a little nothing.
        times.append(times[-1][-1] * (1 + 1e-9 * np.arange(1, 10 * FINE + 1)))
        which.append(np.full(10 * FINE, -1))
    clock, which = np.concatenate(times), np.concatenate(which)
    if np.any(np.diff(clock) <= 0):
        return UNKNOWN
    scene = scene_of(variant)
    given = scene.parameters(params)
    run = bj.simulate(scene, given, clock, accuracy=ACCURACY, max_steps=20_000)
    # Once more with all instants about the peaks of later contacts: a damped one is a spike.
    for k in range(1, len(found)):
        own = np.flatnonzero(which == k)
        top = own[np.argmax(np.nan_to_num(run.force["contact"][own, 0]))]
        clock[own] = np.linspace(clock[max(top - 3, own[0])], clock[min(top + 3, own[-1])], own.size)
    run = bj.simulate(scene, given, clock, accuracy=ACCURACY, max_steps=20_000) if len(found) > 1 else run
    if run.status != "ok":
        return FAILED
    errors = {"peak": 0.0}
    for k, one in enumerate(found):
        t, got = clock[which == k], run.force["contact"][which == k, 0]
        if k == 0:
            # At the same instants where there is no doubt about the time of the touch, so that sampling is no error.
            # A law that jumps does so at the first one, on either side of rounding.
            t, got = t[1:], got[1:]
        exact = one.force(np.linspace(one.instants[0], one.instants[-1], 30_001) if k else t)
        errors["peak"] = max(errors["peak"], abs(got.max() / exact.max() - 1))
        if k == 0:
            errors["rms"] = float(np.sqrt(np.mean((got - exact) ** 2)) / exact.max())
    return errors


def mass_slopes(variant: Variant, row: dict[str, Any]) -> Errors | str:
    """Errors of derivatives by stiffness, mass and speed (of a bounce the height), relative, where trusted."""
    params, kind = numbers(variant, row), variant.scene
    case = Case(variant.name, params)
    found = touches(kind, case)
    if not found:
        return NOTHING
    parts = [SLOPES // len(found)] * len(found)
    parts[-1] += SLOPES - sum(parts)
    # Within the contacts: at a jump no derivative is a number.
    ends = [(one.start + 0.02 * (one.end - one.start), one.end - 0.02 * (one.end - one.start)) for one in found]
    clock = np.concatenate([np.linspace(begin, end, n) for (begin, end), n in zip(ends, parts, strict=True)])
    if np.any(np.diff(clock) <= 0):
        return UNKNOWN
    scene, last = scene_of(variant), "approach_speed" if kind == "impact" else "drop_height"
    wrt = tuple(name for name in ("stiffness", "mass", last) if params[name] > 0)
    run = bj.sensitivity(
        scene, scene.parameters(params), clock, wrt, accuracy=ACCURACY, features=("contact.peak",), max_steps=20_000
    )
    if run.status != "ok" or run.certificate is None:
        return FAILED
    right = {name: x for name in wrt if (x := slope(kind, case, name, clock, found)) is not None}
    if len(right) < len(wrt):
        return UNKNOWN
    sizes = {name: float(np.linalg.norm(x)) for name, x in right.items()}
    # As the certificate does: what has next to no influence does not count.
    strong = [name for name in wrt if sizes[name] > INFLUENCE * max(sizes.values())]
    verdicts = {name: run.certificate.parameters[name].verdict for name in strong}
    errors = [
        float(np.linalg.norm(run.derivative[name]["contact"][:, 0] * params[name] - right[name])) / sizes[name]
        for name in strong
        if verdicts[name] == TRUSTED
    ]
    return {"derivative": max(errors)} if errors else "not trusted" if strong else NOTHING


@eqx.filter_jit
def history(scene: Any, params: Any, move: Any, times: Any, how: Any) -> Any:
    """Normal forces by contact (T, k) with their derivative in a direction, flat states, and how it ended."""

    def forces(p: Any) -> Any:
        solution, readings = outcome(scene, p, times, how, "forward", move is not None)
        normal = {name: r.force[..., 0].reshape(times.size, -1) for name, r in readings.items()}
        return normal, (solution.states, solution.code)

    if move is None:
        normal, (states, code) = forces(params)
        return normal, None, states, code
    normal, slopes, (states, code) = jax.jvp(forces, (params,), (move,), has_aux=True)
    return normal, slopes, states, code


def followed(variant: Variant, row: dict[str, Any], slopes: bool, accuracy: Any = ACCURACY) -> Any:
    """Numbers, times and ``history`` of a joint of the box; the direction is that of every number by its own size."""
    scene, p = scene_of(variant), numbers(variant, row)
    single = {name: np.full(1, value) for name, value in p.items()}
    times = instants(scene, np.array([row["end"]]), single, SAMPLES[variant.scene])[0]
    given = {name: jnp.asarray(value) for name, value in p.items()}
    how = plan(scene, accuracy, variant.budget)
    return p, times, jax.device_get(history(scene, given, given if slopes else None, jnp.asarray(times), how))


def compared(got: Any, right: dict[str, np.ndarray], slopes: dict[str, np.ndarray] | None) -> Errors | str:
    """Errors of forces and of their derivatives, each over the force's own peak."""
    normal, by, _, code = got
    if code != OK:
        return FAILED
    if max(np.max(np.abs(x)) for x in right.values()) < 1e-6:
        return NOTHING
    errors = {"force": apart(normal, right)}
    return errors if slopes is None else errors | {"derivative": apart(by, slopes)}


def kinematic(variant: Variant, row: dict[str, Any]) -> Errors | str:
    """Shared loads against the closed form."""
    p, times, got = followed(variant, row, True)

    def make(p: dict[str, float]) -> dict[str, np.ndarray]:
        return stacked([shared(p, t) for t in times])

    return compared(got, make(p), differences(make, p, row["end"]))


def quasistatic(variant: Variant, row: dict[str, Any]) -> Errors | str:
    """Equilibria against SciPy's roots, and their derivatives."""
    p, times, got = followed(variant, row, True)
    if got[3] != OK:
        return FAILED
    right = balanced(p, times, got[2])
    if right is None:
        return UNKNOWN
    return compared(got, right, differences(lambda p: balanced(p, times, got[2]), p, row["end"]))


def dynamic(variant: Variant, row: dict[str, Any], accuracy: Any = ACCURACY) -> Errors | str:
    """Motion against CVODES, which must agree with itself at a tenth of the tolerance."""
    p, times, got = followed(variant, row, False, accuracy)
    if got[3] != OK:
        return FAILED
    right = [moved(variant.options, p, times, tolerance) for tolerance in (1e-9, 1e-8)]
    if right[0] is None or right[1] is None or max(np.max(np.abs(x)) for x in right[0].values()) < 1e-6:
        return NOTHING if right[0] is not None and right[1] is not None else UNKNOWN
    if apart(right[1], right[0]) > KNOWN:
        return UNKNOWN
    return compared(got, right[0], None)


# What is checked, of which scene, by which solver, how wrong each figure may be, how many cases.
CHECKS: dict[str, tuple[str, Callable[..., Errors | str], str, Errors, int]] = {
    "impact": ("impact", mass_forces, "SciPy DOP853 or Radau", {"peak": PROMISED, "rms": PROMISED}, 110),
    "bounce": ("bounce", mass_forces, "the same, flights in closed form", {"peak": PROMISED, "rms": PROMISED}, 110),
    "impact, derivatives": ("impact", mass_slopes, "its central differences", {"derivative": POINTWISE}, 40),
    "bounce, derivatives": ("bounce", mass_slopes, "its central differences", {"derivative": POINTWISE}, 40),
    "kinematic": ("kinematic", kinematic, "closed form, NumPy", {"force": ROUNDING, "derivative": PROMISED}, 60),
    "quasistatic": (
        "quasistatic", quasistatic, "SciPy root on CasADi's forces", {"force": ROUNDING, "derivative": PROMISED}, 24
    ),
    "dynamic": ("dynamic", dynamic, "CVODES on CasADi's forces", {"force": PROMISED}, 20),
    "dynamic, asked for 0.02 %": (
        "dynamic", partial(dynamic, accuracy=2e-4), "the same, still 1 % allowed", {"force": PROMISED}, 20
    ),
}  # fmt: skip


def drawn(scene: str) -> list[tuple[Variant, dict[str, Any]]]:
    """Cases that ended well, in an order of chance; of the dynamic joint those that do not take 30 s."""
    found = []
    for variant in VARIANTS:
        if variant.scene == scene and variant.name != "30 s":
            for path in sorted(KEPT.glob(f"{scene}-{variant.name}-*-sobol-*.jsonl")):
                rows = [json.loads(line) for line in path.read_text().splitlines()]
                found += [(variant, row) for row in rows if row["class"] == "ok"]
    random.Random(0).shuffle(found)
    return found


def main() -> None:
    asked = options(__doc__, {"checks": CHECKS}, cases=(int, "cases with a verdict"))
    keep_programs()
    for name in asked.checks:
        scene, check, against, allowed, wanted = CHECKS[name]
        wanted, begin = asked.cases or wanted, time.process_time()
        good: list[dict[str, Any]] = []
        beside: dict[str, int] = {}
        for variant, row in drawn(scene)[: 4 * wanted]:
            errors = check(variant, row)
            if isinstance(errors, str):
                beside[errors] = beside.get(errors, 0) + 1
            else:
                share = max(value / allowed[key] for key, value in errors.items())
                good.append({"variant": variant.name, **row, "errors": errors, "share": float(share)})
            if len(good) == wanted:
                break
        good.sort(key=lambda row: -row["share"])
        (KEPT / f"check {name}.json").write_text(json.dumps(good, indent=1))
        results = load("extremes")["scenes"]
        within = sum(row["share"] <= 1 for row in good)
        found = {key: [row["errors"][key] for row in good if key in row["errors"]] for key in allowed}
        worst = {key: [len(x), float(np.median(x)), float(max(x))] for key, x in found.items() if x}
        results[scene].setdefault("checked", {})[name] = {
            "against": against, "allowed": allowed, "cases": len(good), "within": within, "count_median_worst": worst,
            "beside": beside,
        }  # fmt: skip
        save("extremes", {"scenes": results})
        print(name, json.dumps(results[scene]["checked"][name]), f"{time.process_time() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
