"""Are the extremes survived? Every case of a wide box, forward and with its derivative, must end well or say why not.

A case is ``ok`` (finite forces and derivatives, energy not created), ``failed`` with a reason and a time, ``refused``
by the validation of its numbers, or ``void``: energy is created, in a joint whose bodies pass through each other by
more than a ball's radius, which a run says in a warning; anything else is a defect: a NaN as success, energy from
nowhere, more steps than were allowed.

    python -m benchmarks.analysis.extremes [SCENE ...] [--cases N] [--fresh]

Finished pieces are kept in build/extremes and read from there by the next run; --fresh measures them again. The counts
go to benchmarks/results/extremes.json.
"""

from __future__ import annotations

import json
import re
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
from bcfj_jax.core.status import OK, STEEP, reason
from bcfj_jax.models.joint.constants import constants
from bcfj_jax.models.joint.energy import stored
from bcfj_jax.models.joint.scales import scales as joint_scales
from bcfj_jax.models.joint.system import view
from bcfj_jax.solve.plan import plan
from bcfj_jax.solve.simulation import outcome
from benchmarks.analysis.extremes_box import VARIANTS, Variant, corners, sobol
from benchmarks.clock import keep_programs
from benchmarks.common import ROOT, known, options, save

KEPT = ROOT / "build" / "extremes"
ACCURACY = "balanced"
# Runs side by side, instants, and cases of a scene. An equilibrium is searched for case by case: no run waits.
BATCH = {"impact": 512, "bounce": 512, "kinematic": 512, "quasistatic": 1, "dynamic": 20, "options": 20}
SAMPLES = {"impact": 65, "bounce": 65, "kinematic": 17, "quasistatic": 5, "dynamic": 33, "options": 33}
CASES = {
    "impact": 10_000, "bounce": 10_000, "kinematic": 10_000, "quasistatic": 10_000, "dynamic": 1_600, "options": 1_600,
}  # fmt: skip
MOVING = ("dynamic", "options")
# Energy above what was there at the start, as a fraction of it, that counts as created: the force error asked for.
CREATED = 1e-2
# A derivative, over the force, by a whole change of the parameters, that no certificate would trust.
LARGE = 1e6
GRAVITY = 9.81
_NUMBER = re.compile(r"(?<![\w.])-?\d[\d.]*(e[+-]?\d+)?")


@eqx.filter_jit
def attempt(scene: Any, params: Any, moves: Any, times: Any, how: Any) -> dict[str, Any]:
    """Batches of runs, each with the derivative of its forces in one direction of all parameters, if there is one."""

    def forces(p: Any, t: Any) -> Any:
        solution, readings = outcome(scene, p, t, how, "forward", moves is not None)
        force = jnp.concatenate([readings[c.name].force.reshape(t.size, -1) for c in scene.contacts], 1)
        depth = jnp.max(jnp.stack([jnp.max(readings[c.name].penetration) for c in scene.contacts]))
        return (force, solution.states), (solution, depth)

    def one(p: Any, move: Any, t: Any) -> dict[str, Any]:
        if move is None:
            (force, states), (solution, depth) = forces(p, t)
            slopes = (jnp.zeros_like(force),)
        else:
            (force, states), slopes, (solution, depth) = jax.jvp(lambda p: forces(p, t), (p,), (move,), has_aux=True)
        finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(x), 1) for x in slopes]), 0)
        return {
            "force": jnp.all(jnp.isfinite(force)),
            "peak": jnp.max(jnp.abs(force)),
            "depth": depth,
            "slope": jnp.all(finite),
            "grown": jnp.max(jnp.where(jnp.isfinite(slopes[0]), jnp.abs(slopes[0]), 0.0)),
            "lost": t[jnp.argmin(finite)],
            "code": solution.code,
            "end": solution.end,
            "steps": solution.accepted + solution.rejected,
            "states": states,
        }

    if times.shape[0] == 1:
        alone = one(*jax.tree.map(lambda x: x[0], (params, moves, times)))
        return jax.tree.map(lambda x: jnp.asarray(x)[None], alone)
    return jax.vmap(one)(params, moves, times)


@eqx.filter_jit
def passive_energy(scene: Any, params: Any, times: Any, states: Any) -> Any:
    """Energy of joints that nothing drives (N, T): of motion, of contacts, and of the head under its axial load."""

    def one(p: Any, times: Any, states: Any) -> Any:
        c = constants(scene, p)
        head = lambda y: view(scene, c, y).head_place @ c.axes[1]  # noqa: E731
        return jax.vmap(lambda t, y: stored(scene, c, t, y).total + c.programmes["axial_load"] * head(y))(times, states)

    return jax.vmap(one)(params, times, states)


def instants(scene: Any, end: np.ndarray, params: dict[str, np.ndarray], samples: int) -> np.ndarray:
    """Times (N, samples) of every case; where the end is 0, the scene's own horizon."""
    own = np.asarray(jax.vmap(scene.horizon)({k: jnp.asarray(v) for k, v in params.items()}))
    until = np.where(end > 0, end, np.where((own > 0) & np.isfinite(own), own, 1e-3))
    return until[:, None] * np.linspace(0.0, 1.0, samples)


def refusal(scene: Any, row: dict[str, float]) -> str:
    """What the validation says of a case; empty where it lets it pass."""
    try:
        scene.check(scene.parameters(row))
    except bj.InputError as error:
        return f"{error.where}: {error.found}"
    return ""


def ramp(d: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The smoothed penetration, in NumPy."""
    safe = np.where(w > 0, w, 1.0)
    s = np.clip((d + safe) / (2 * safe), 0.0, 1.0)
    return np.where((w > 0) & (d < w), 2 * safe * s**4 * (2.5 - 3 * s + s * s), np.maximum(d, 0.0))


def energies(p: dict[str, np.ndarray], scene: str, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Energy (N, T) of a mass on a surface, and that of its sag (N, 1) [J]."""
    p = {name: np.asarray(value)[:, None] for name, value in p.items()}
    n = p.get("exponent", np.ones_like(p["stiffness"]))
    place, speed = states[..., 0], states[..., 1]
    fall = p["gravity"] if scene == "bounce" else 0.0 * p["mass"]
    depth = -place if scene == "bounce" else place - p["clearance_contact"]
    energy = 0.5 * p["mass"] * speed**2 + p["mass"] * fall * -depth
    energy = energy + p["stiffness"] * ramp(depth, p["smoothing"]) ** (n + 1) / (n + 1)
    return energy, p["mass"] * fall * (p["mass"] * fall / p["stiffness"]) ** (1 / n)


def gained(energy: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Greatest energy (N, T) above the first, as a fraction of it and of ``size`` (N, 1); (N,)."""
    above = energy - energy[:, :1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(above > 0, above / (np.abs(energy[:, :1]) + size), 0.0)
    return np.nan_to_num(np.max(np.where(np.isnan(share), 0.0, share), 1), posinf=1e300)


def created(variant: Variant, scene: Any, p: dict[str, np.ndarray], times: Any, states: np.ndarray) -> np.ndarray:
    """Energy that a case has created, ``gained``; 0 where none is known."""
    if variant.name == "passive":
        mechanical = np.asarray(passive_energy(scene, {k: jnp.asarray(v) for k, v in p.items()}, times, states))
        # What is stored while the head falls is as large as what it gives; unloaded, 10 N through the unit of places.
        depth = np.asarray(jax.vmap(lambda q: joint_scales(scene, q)[0])({k: jnp.asarray(v) for k, v in p.items()}))
        return gained(mechanical, np.nanmax(np.abs(mechanical), 1, keepdims=True) + 10.0 * depth[:, None])
    if variant.scene not in ("impact", "bounce"):
        return np.zeros(states.shape[0])
    return gained(*energies(p, variant.scene, states))


def verdicts(variant: Variant, cases: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Every case with its class, its reason and its figures."""
    scene = bj.scenes.make(variant.scene if variant.scene in bj.scenes.SCENES else "joint", **variant.options)
    if "friction_static" in cases:
        cases = cases | {"friction_dynamic": 0.7 * cases["friction_static"]}
    names = [name for name in cases if name != "end"]
    count, count_at_once = cases["end"].size, BATCH[variant.scene]
    rows = [{name: float(cases[name][k]) for name in names} | variant.fixed for k in range(count)]
    said = [refusal(scene, row) for row in rows]
    good = np.array([k for k in range(count) if not said[k]], int)
    found: list[dict[str, Any]] = [{"class": "refused", "reason": text} for text in said]
    if good.size:
        start = {name: float(value) for name, value in scene.parameters(variant.fixed).items()}
        params = {name: np.full(good.size, value) for name, value in start.items()}
        params |= {name: cases[name][good] for name in names}
        # What rules all contacts rules each one's own.
        params |= {own: params[own.split(".")[1]] for own in params if own.partition(".")[2] in names}
        times = instants(scene, cases["end"][good], params, SAMPLES[variant.scene])
        # Together with its own size, or where that is 0 with a small one: every parameter counts.
        moves = {name: np.where(value != 0, value, 1e-6) for name, value in params.items()}
        # The last runs are repeated: one program for any number of cases.
        pad = np.concatenate([np.arange(good.size), np.full(-good.size % count_at_once, good.size - 1)])
        how = plan(scene, ACCURACY, variant.budget)
        for k in range(0, pad.size, count_at_once):
            some = pad[k : k + count_at_once]
            own = {name: value[some] for name, value in params.items()}
            batch, move = ({n: jnp.asarray(v[some]) for n, v in x.items()} for x in (params, moves))
            t = jnp.asarray(times[some])
            # Of a joint in motion values have a solver of their own.
            alone = variant.scene in MOVING
            got = jax.device_get(attempt(scene, batch, None if alone else move, t, how))
            above = created(variant, scene, own, t, got["states"])
            steep = jax.device_get(attempt(scene, batch, move, t, how)) if alone and variant.slopes else None
            for member, which in enumerate(some[: max(0, good.size - k)]):
                ends = [{key: x[member] for key, x in run.items() if key != "states"} for run in (got, steep) if run]
                through = float(own.get("ball_radius", np.full(len(some), np.inf))[member])
                checks = [
                    checked(end, float(above[member]), float(times[which, -1]), variant.budget, through) for end in ends
                ]
                worst = next((j for j in checks if j["class"] != "ok"), checks[0])
                # A run that went well, whose derivatives did not.
                part = "derivatives: " if worst is not checks[0] else ""
                found[good[which]] = worst | {"reason": part + worst["reason"] if worst["reason"] else ""}
    return [{**row, "end": float(cases["end"][k]), **found[k]} for k, row in enumerate(rows)]


def checked(one: dict[str, Any], above: float, end: float, budget: int, through: float) -> dict[str, Any]:
    """The class of one finished case; ``through``: penetration [m] beyond which bodies are out of each other's gaps."""
    code, steps = int(one["code"]), int(one["steps"])
    if code == OK and bool(one["force"]) and not bool(one["slope"]):
        # As ``sensitivity`` does.
        code, one = STEEP, one | {"end": one["lost"]}
    text = reason(code, budget)
    large = bool(one["grown"] > LARGE * max(float(one["peak"]), 1e-300))
    figures = {"steps": steps, "peak": float(one["peak"]), "created": above, "large": large}
    if code != OK:
        labelled = bool(text) and 0.0 <= float(one["end"]) <= end * (1 + 1e-12)
        label = {"class": "failed" if labelled else "defect", "reason": text or "no reason", "at": float(one["end"])}
        return label | figures
    faults = {
        "NaN as success": not bool(one["force"]),
        "energy created": above > CREATED,
        "more steps than allowed": steps > budget and budget > 1,
    }
    fault = next((name for name, there in faults.items() if there), "")
    if fault == "energy created" and float(one["depth"]) > through:
        return {"class": "void", "reason": "bodies pass through each other", "depth": float(one["depth"])} | figures
    return {"class": "defect" if fault else "ok", "reason": fault} | figures


def pieces(variant: Variant, count: int) -> Iterator[tuple[Path, dict[str, np.ndarray]]]:
    """The variant's cases in pieces, each with the file that keeps it; cases of like cost side by side."""
    for kind, cases in (("sobol", sobol(variant, count)), ("corners", corners(variant, count // 4))):
        order = np.argsort(cost(variant, cases), kind="stable")
        size = 2048 if variant.scene not in MOVING else 100
        for k in range(0, order.size, size):
            some = order[k : k + size]
            name = f"{variant.scene}-{variant.name}-{count}-{kind}-{k // size}.jsonl"
            yield KEPT / name, {n: v[some] for n, v in cases.items()}


def cost(variant: Variant, cases: dict[str, np.ndarray]) -> np.ndarray:
    """What a run may cost, in any unit: flights, or time and stiffness."""
    end = cases["end"]
    if variant.scene == "bounce":
        flight = np.sqrt(8 * np.maximum(cases["drop_height"], 1e-12) / GRAVITY)
        return np.where(end > 0, end / flight, 3.0)
    return end


def measure(variant: Variant, count: int, fresh: bool) -> list[dict[str, Any]]:
    """All cases of a variant, from the kept pieces where there are any."""
    found = []
    for path, cases in pieces(variant, count):
        if fresh or not path.exists():
            rows = verdicts(variant, cases)
            path.parent.mkdir(parents=True, exist_ok=True)
            part = path.with_suffix(".part")
            part.write_text("".join(json.dumps(row) + "\n" for row in rows))
            part.replace(path)
        found += [json.loads(line) for line in path.read_text().splitlines()]
    return found


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts by class and reason, and the extremes of the figures."""
    ok = [row for row in rows if row["class"] == "ok"]
    return {
        "cases": len(rows),
        "classes": dict(Counter(row["class"] for row in rows)),
        "reasons": dict(Counter(f"{r['class']}: {_NUMBER.sub('..', r['reason'])}" for r in rows if r["reason"])),
        "steps": {"median": float(np.median([r["steps"] for r in ok])), "most": max(r["steps"] for r in ok)}
        if ok
        else {},
        "most_energy_created": max((row["created"] for row in ok), default=0.0),
        "large_derivatives": sum(row["large"] and row["peak"] > 0 for row in ok),
    }


def main() -> None:
    given = options(
        __doc__, {"scenes": CASES}, cases=(int, "Sobol cases of a scene; a quarter as many corners come on top"),
        fresh=(False, "measure kept pieces again"),
    )  # fmt: skip
    keep_programs()
    results = known("extremes").get("scenes", {})
    for name in given.scenes:
        mine = [variant for variant in VARIANTS if variant.scene == name]
        total = given.cases or CASES[name]
        begin = time.process_time()
        found = {v.name: measure(v, round(v.share * total), given.fresh) for v in mine}
        results[name] = {
            "accuracy": ACCURACY,
            "max_steps": {v.name: v.budget for v in mine},
            "all": summary([row for rows in found.values() for row in rows]),
            **{key: summary(rows) for key, rows in found.items()},
        }
        save("extremes", {"scenes": results})
        print(json.dumps({name: results[name]}, indent=1), f"{time.process_time() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    main()
