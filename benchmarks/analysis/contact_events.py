"""Trains of impacts: derivatives of when each contact begins, peaks and ends, of its peak and its impulse, and their price.

A ball bounces 10 and 30 times on K d^n (1 + a d'). The reference is a closed form where there is one (n = 1, a = 0), else
variational equations by SciPy at 1e-12 (``references.bounce_events``, which the closed form confirms to 1e-9). Errors are
relative to the derivative itself, or to 0.01 % of the number per 1 % of the parameter where it is smaller (the least that a
certificate counts). Beside it: the begins' derivatives from samples of the same level, as ``bj.sensitivity`` has periods.
The last cases are solved by BDF, which does not land on contacts.

The plain joint has no closed form. Its reference is the same at a force error of 1e-10 (``JOINT_TIGHT``); central differences
of runs without derivatives confirm it (``tests/analysis/test_contact_events.py``), to 1e-4 but for times of peaks.

    python -m benchmarks.analysis.contact_events [--joint]    keeps results/contact_events.json and tables of docs/derivatives.md
"""

from __future__ import annotations

from typing import Any

import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.analysis import features
from bcfj_jax.analysis.derivatives.bounds import feature_bounds
from bcfj_jax.analysis.derivatives.certificate import apart as differing
from bcfj_jax.analysis.derivatives.contact_events import BOUNDING, TIGHTER, numbers, solved_at, why
from bcfj_jax.analysis.derivatives.jacobian import channel_names, level
from bcfj_jax.analysis.derivatives.names import EVENTS, Feature, complete
from bcfj_jax.analysis.derivatives.problem import Problem
from bcfj_jax.core.dual import Dual
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import plan
from bcfj_jax.xla.programs import program
from benchmarks.clock import seconds as took
from benchmarks.common import load, options, publish, save
from benchmarks.references.bounce_events import KINDS, NAMES, closed, integrated

SCENE = bj.scenes.bounce(smoothing=False)
BALL = {"mass": 0.1, "gravity": 9.81, "drop_height": 0.05}
CASES = {
    "n = 1, undamped": {"stiffness": 1e5, "exponent": 1.0, "damping": 0.0},
    "n = 1.5, damped": {"stiffness": 1e5, "exponent": 1.5, "damping": 0.05},
    "n = 1.5, damped, hard": {"stiffness": 1e8, "exponent": 1.5, "damping": 0.05},
}
BY_BDF = ("n = 1, undamped", "n = 1.5, damped")
COUNTS, LEAST, REPEATS = (10, 30), 0.01, 7
JOINT, JOINT_END, JOINT_REPEATS = bj.scenes.joint_of_keys(**PLAIN), 0.3, 3
JOINT_WRT = ("stiffness", "friction_static", "damping", "clearance_seat_cage")
# What was asked for, and how much looser runs are than that asks for; the first is as of a fit.
JOINT_LEVELS, JOINT_TIGHT = ((1e-6, 100.0), ("balanced", 1.0), (1e-7, 1.0)), (1e-9, 0.1)
TITLES = {"peak_time": "time of peak"}


def errors(
    found: Any, exact: dict[str, tuple[np.ndarray, np.ndarray]], p: dict[str, float], wrt: tuple[str, ...]
) -> dict:
    """Largest relative error of the derivatives of each kind, over contacts and parameters."""
    column, worst = [NAMES.index(n) for n in wrt], {}
    for kind in KINDS:
        value, slope = exact[kind]
        own = np.stack([getattr(found.derivative[n], kind)[: value.size] for n in wrt], axis=1)
        least = LEAST * np.abs(value)[:, None] / np.array([p[n] for n in wrt])
        worst[kind] = float(np.max(np.abs(own - slope[:, column]) / np.maximum(np.abs(slope[:, column]), least)))
    return worst


def from_samples(scene: Any, params: dict, end: float, wrt: tuple[str, ...], exact: Any, p: dict[str, float]) -> float:
    """The same of begins, by roots of the samples' cubics, at the level's tolerance by steps that end anywhere."""
    times = np.linspace(0.0, end, scene.samples)
    found = level(scene, params, times, wrt, plan(scene, "balanced"))
    depth, rate = found.value.penetration[:, 0], found.value.rate[:, 0]
    starts = [begin for begin, _ in features.contact_times(times, depth, rate)]
    by = [found.derivative.penetration[:, :, 0], found.derivative.rate[:, :, 0]]
    own = np.array([features.start_at(times, Dual(depth, by[0]), Dual(rate, by[1]), at).slope for at in starts])
    value, slope = exact["begin"]
    slope, many = slope[:, [NAMES.index(n) for n in wrt]], min(value.size, len(own))
    least = LEAST * np.abs(value)[:many, None] / np.array([p[n] for n in wrt])
    off = np.abs(own[:many] - slope[:many]) / np.maximum(np.abs(slope[:many]), least)
    # Of begins that lie between samples no derivative is known.
    return float(np.nanmax(off[1:])) if np.isfinite(off[1:]).any() else float("nan")


def seconds(run: Any, repeats: int = REPEATS) -> float:
    """CPU seconds, the median of a few, after one that compiles."""
    run()
    return float(np.median(took(run, repeats)))


def case(name: str, count: int, by_bdf: bool = False) -> dict[str, Any]:
    law = CASES[name]
    p = {**law, **BALL}
    simple = law["exponent"] == 1.0 and law["damping"] == 0.0
    # By an exponent of 1 and a damping of 0 the closed form has no derivative.
    wrt = tuple(n for n in NAMES if not simple or n not in ("exponent", "damping"))
    exact = (closed if simple else integrated)(p, count)
    flight = exact["begin"][0][-1] - exact["end"][0][-2]
    end = float(exact["end"][0][-1] + 0.3 * flight)
    params = SCENE.parameters(p)
    scene = SCENE.suited(params, end, "bdf" if by_bdf else "tsit5")
    full, names = complete(scene, params, wrt)
    how = plan(scene, "balanced")
    loose, tight = (solved_at(Problem(scene, full, np.array([end]), names), how, [], t) for t in (1.0, TIGHTER))
    apart = bj.contact_events(scene, params, np.array([0.0, end]), wrt)
    stated = max(float(np.nanmax(x["contact"][:5, :count])) for x in apart.apart.values())
    row = {
        "case": f"{name}, by BDF" if by_bdf else name, "contacts": count,
        "reference": "closed form" if simple else "variational equations",
        "contact_over_flight": float((exact["end"][0][0] - exact["begin"][0][0]) / flight), "found": int(tight.counts[0]),
        "level": errors(loose, exact, p, wrt), "given": errors(tight, exact, p, wrt), "stated": stated,
        "from_samples": from_samples(scene, full, end, wrt, exact, p),
        "steps": {"level": loose.accepted + loose.rejected, "given": tight.accepted + tight.rejected},
    }  # fmt: skip
    times = np.linspace(0.0, end, 2001)
    plain = program("simulate", *_plain(scene, full, times, how))[0]
    cpu = {
        "values_s": seconds(lambda: plain(dict(full), times, how)),
        "events_s": seconds(lambda: solved_at(Problem(scene, full, np.array([end]), names), how, [], TIGHTER)),
        "samples_s": seconds(lambda: level(scene, full, times, names, how)),
    }
    print(name, count, row["level"], row["given"], row["from_samples"], cpu, flush=True)
    return {**row, **cpu}


def _plain(scene: Any, params: dict, times: np.ndarray, how: Any) -> tuple:
    from bcfj_jax.solve.simulation import _run

    return _run, (scene, ()), (dict(params), times, how)


def joint() -> list[dict[str, Any]]:
    """Every contact that the joint takes up or leaves in its first 0.3 s, at two accuracies."""
    params = JOINT.parameters()
    full, names = complete(JOINT, params, JOINT_WRT)
    values = np.array([float(full[n]) for n in names])

    def of(accuracy: float | str, tighter: float = 1.0) -> Any:
        return solved_at(Problem(JOINT, full, np.array([JOINT_END]), names), plan(JOINT, accuracy), [], tighter)

    exact = of(*JOINT_TIGHT)
    channels = channel_names(JOINT.members)
    wanted = [
        Feature(f"{channels[c]}.{kind}_{k + 1}", f"{kind}_{k + 1}", (channels[c],))
        for c, k in zip(exact.channel, exact.number, strict=True)
        for kind in EVENTS
    ]
    wanted = [f for f in wanted if not why(JOINT, exact, f)]
    value, slope = numbers(JOINT, exact, wanted)
    kinds = np.array([f.kind.rpartition("_")[0] for f in wanted])
    rows = []
    for accuracy, looser in JOINT_LEVELS:
        both = (looser, looser * TIGHTER)
        loose, tight = (of(accuracy, t) for t in both)
        assert np.array_equal(tight.counts, exact.counts) and np.array_equal(loose.counts, exact.counts)
        at, (own, by) = numbers(JOINT, loose, wanted)[1], numbers(JOINT, tight, wanted)
        off, stated = differing(by, slope, value, values), differing(at, by, own, values)
        # What a sensitivity states, but for half of the history's bound.
        solved = [by, *(numbers(JOINT, of(accuracy, both[1] * share), wanted)[1] for share in BOUNDING[True])]
        bound = feature_bounds(solved, own, values)
        how = plan(JOINT, accuracy)
        without = solved_at(Problem(JOINT, full, np.array([JOINT_END]), ()), how, [], both[1])
        row = {
            "accuracy": accuracy, "looser": looser, "contacts": int(np.sum(exact.counts)), "numbers": int(off.size),
            "off": {k: np.nanquantile(off[kinds == k], (0.5, 0.9, 1.0)).tolist() for k in EVENTS},
            "values_off": {k: float(np.nanmax(np.abs(own / value - 1.0)[kinds == k])) for k in EVENTS},
            "bounded": float(np.mean(off <= np.maximum(stated, 1e-9))),
            "bounded_thrice": float(np.mean(off <= np.maximum(3.0 * stated, 1e-9))),
            "trusted": float(np.mean(bound <= 0.03)), "bounded_of_trusted": float(np.mean((off <= bound)[bound <= 0.03])),
            "worst_of_trusted": float(np.max((off / np.maximum(bound, 1e-9))[bound <= 0.03])),
            "overestimate": float(np.median((bound / np.maximum(off, 1e-12))[bound <= 0.03])),
            "missed": int(np.sum(tight.missed)), "lost": int(np.sum(~np.isfinite(by).all(axis=1))),
            "steps": tight.accepted + tight.rejected, "steps_without": without.accepted + without.rejected,
            "events_s": seconds(lambda a=accuracy, ts=both: [of(a, t) for t in ts], JOINT_REPEATS),
            "without_s": seconds(
                lambda how=how, t=both[1]: solved_at(Problem(JOINT, full, np.array([JOINT_END]), ()), how, [], t), JOINT_REPEATS
            ),
        }  # fmt: skip
        print(row, flush=True)
        rows.append(row)
    return rows


def joint_table(rows: list[dict[str, Any]]) -> str:
    def percent(key: str) -> Any:
        return lambda r: f"{100 * r[key]:.1f} %"

    def name(r: dict[str, Any]) -> str:
        return f"{r['accuracy'] * r['looser']:.0e} (a fit's)" if r["looser"] > 1.0 else str(r["accuracy"])

    return harness.table({
        "accuracy": name, **{TITLES.get(k, k): f"{{off[{k}][0]:.0e}} ({{off[{k}][1]:.0e}})" for k in EVENTS},
        "error below `apart`": percent("bounded"), "`trusted` in a sensitivity": percent("trusted"),
        "error at most as stated": percent("bounded_of_trusted"), "worst error over stated": "{worst_of_trusted:.1f}",
        "steps": "{steps}", "CPU s": "{events_s:.1f}",
    }, rows)  # fmt: skip


def shape() -> dict[str, Any]:
    """Of the tenth contact, the derivative of its force by the damping: in its phase, and at fixed times."""
    p = {**CASES["n = 1.5, damped"], **BALL}
    found = bj.contact_events(
        SCENE, SCENE.parameters(p), np.array([0.0, 2.4]), ("damping", "stiffness"), features=["contact.peak_10"]
    )
    own = {name: found.derivative[name]["contact"] for name in found.wrt}
    return {
        "phases": found.phases.tolist(), "force": found.trains["contact"].force[9].tolist(),
        **{f"{n}_{k}": (p[n] * getattr(own[n], k)[9]).tolist() for n in own for k in ("force", "pointwise")},
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    return harness.table({
        "law": "{case}", "contacts": "{contacts}", "contact over flight": lambda r: f"1/{1.0 / r['contact_over_flight']:.0f}",
        **{TITLES.get(k, k): f"{{given[{k}]:.0e}} ({{level[{k}]:.0e}})" for k in KINDS}, "stated": "{stated:.0e}",
        "begins from samples": "{from_samples:.2g}", "steps": "{steps[given]}",
        "CPU, over a run without derivatives": lambda r: f"{r['events_s'] / r['values_s']:.1f}",
    }, rows)  # fmt: skip


def main() -> None:
    alone = options(__doc__, joint=(False, "the joint alone; the bounces are those that are kept")).joint
    if alone:
        kept = load("contact_events")
        rows, of_shape = kept["cases"], kept["shape"]
    else:
        rows = [case(name, count) for name in CASES for count in COUNTS]
        rows += [case(name, count, True) for name in BY_BDF for count in COUNTS]
        of_shape = shape()
    of_joint = joint()
    save("contact_events", {"cases": rows, "least": LEAST, "shape": of_shape, "joint": of_joint})
    publish("contact-events", table(rows), "docs/derivatives.md")
    publish("contact-events-joint", joint_table(of_joint), "docs/derivatives.md")


if __name__ == "__main__":
    main()
