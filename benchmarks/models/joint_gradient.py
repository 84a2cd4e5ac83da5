"""Reverse derivatives of the joint: error by tolerance beside forward and CVODES' adjoint, cost, memory, compiling.

    python -m benchmarks.models.joint_gradient [plain] [peer] [default] [cost] [cost_plain] [before]
        writes those parts of results/joint_gradient.json, tables of docs/derivatives.md; ``peer`` needs ``bench``

Two numbers of the normal forces of ``seat_ball`` over 0.6 s at 1 ms: their mean square, and a smooth peak, the 16-norm.

- ``plain``: eight logarithms against the file of ``analysis.derivatives``; ``peer``: the same by CVODES' adjoint.
- ``default``: the same of the default joint over 0.3 s against forward derivatives at 1e-8.
- ``cost``: all logarithms, a hundred of them with unequal balls and window ends, against reverse ones at 1e-8, which
  forward ones by single parameters and along a random direction check; beside forward's Jacobian by the most
  influential ones. ``cost_plain``: the same of the plain joint.
- ``before``: compiling alone, of whatever package is imported.

Seconds are of the process, medians.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.analysis.derivatives.names import complete
from bcfj_jax.models.joint.scene import PLAIN
from bcfj_jax.solve.plan import Plan
from benchmarks.analysis.derivatives import CONTACTS, MOVED, load, moved
from benchmarks.clock import seconds as took
from benchmarks.common import Some, known, markdown, options, publish

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
# ``plan`` controls the tangents' error below a force error of 5e-4, half of the tolerance.
CONTROLLED_BELOW, MAX_STEPS, COUNT, REPEATS, SHORT_S = 1e-3, 400_000, 100, 3, 0.3
# Of CVODES' adjoint: ``between`` and ``size`` of ``joint_sensitive``.
SETTINGS = ((1, None), (100, 0.1))
# Of the parameters of ``cost``: how many forward's Jacobian has, how many forward derivatives check, at which tolerance.
SOME, CHECKED, TIGHT = 16, 8, 1e-8
PAGE = "docs/derivatives.md"
OBSERVED = ("mean square", "peak")


def numbers(normal: Any) -> Any:
    """Both numbers (2,) of normal forces (T, 6) [N], as logarithms."""
    size = jnp.max(jax.lax.stop_gradient(normal))
    return jnp.log(jnp.stack([jnp.mean(normal**2), size * jnp.mean((normal / size) ** 16) ** (1 / 16)]))


def scalars(scene: Any, params: Any, times: Any, mode: Any, controlled: bool, max_steps: int = MAX_STEPS) -> Callable:
    """(logarithms, tolerance) -> both numbers."""

    def function(change: Callable, logs: Any, tolerance: Any) -> Any:
        how = Plan(tolerance, max_steps, controlled)
        return numbers(
            bj.force_history(scene, change(params, logs), times, accuracy=how, mode=mode)["seat_ball"][..., 0]
        )

    return function


def compiled(function: Callable, size: int) -> tuple[Any, dict[str, float]]:
    """A program of (logarithms, tolerance), seconds that it took by stage, and its memory [MB]."""
    begin = time.process_time()
    traced = jax.jit(function).trace(jnp.zeros(size), jnp.asarray(1e-2))
    lowered, trace = traced.lower(), time.process_time() - begin
    made, total = lowered.compile(), time.process_time() - begin
    memory = made.memory_analysis()
    assert memory is not None
    return made, {"trace_s": trace, "compile_s": total, "memory_MB": memory.temp_size_in_bytes / 1e6}


def timed(program: Any, size: int, tolerance: float) -> tuple[Any, float]:
    """What a program returns, and the median of several runs' seconds."""
    arguments = jnp.zeros(size), jnp.asarray(tolerance)
    result = jax.tree.map(np.asarray, program(*arguments))
    return result, float(np.median(took(lambda: program(*arguments), REPEATS, most=10.0)))


def apart(found: np.ndarray, exact: np.ndarray, counts: np.ndarray) -> tuple[float, float]:
    """Of a gradient (P,): the relative L2 error, and the largest relative one of the parameters that count."""
    whole = np.linalg.norm(found - exact) / np.linalg.norm(exact)
    return float(whole), float(np.abs(found[counts] / exact[counts] - 1.0).max())


def counting(exact: np.ndarray) -> np.ndarray:
    """Which parameters have more than 1 % of the largest derivative."""
    return np.abs(exact) > 0.01 * np.abs(exact).max()


def off(found: np.ndarray, exact: np.ndarray) -> dict[str, float]:
    """Of both gradients (2, P): ``apart``."""
    rows: dict[str, float] = {}
    for name, a, b in zip(OBSERVED, found, exact, strict=True):
        rows[name], rows[f"{name}, worst"] = apart(a, b, counting(b))
    return rows


def table_of(scene: Any, params: Any, times: Any, exact: Any, tolerances: Any) -> dict[str, Any]:
    """Rows of reverse and forward; without ``exact``, against forward at 1e-8."""
    change, rows, compiling = moved, [], {}
    programs: dict[Any, Any] = {}
    for controlled in (False, True):
        for way, d in (("reverse", jax.jacrev), ("forward", jax.jacfwd)):
            function = scalars(scene, params, times, way, controlled)
            program = d(lambda logs, tolerance, f=function: f(change, logs, tolerance))
            programs[way, controlled], compiling[f"{way}, {controlled}"] = compiled(program, len(MOVED))
            print(way, controlled, compiling[f"{way}, {controlled}"], flush=True)
    apart = None
    if exact is None:
        exact, looser = (timed(programs["forward", True], len(MOVED), t)[0] for t in (1e-8, 1e-7))
        apart = off(looser, exact)
    for tolerance in tolerances:
        controlled = tolerance < CONTROLLED_BELOW
        row: dict[str, Any] = {"tolerance": tolerance}
        for way in ("reverse", "forward"):
            found, seconds = timed(programs[way, controlled], len(MOVED), tolerance)
            row[way] = {**off(found, exact), "cpu_s": seconds}
        rows.append(row)
        print(row, flush=True)
    return {"rows": rows, "compiling": compiling, "reference's own": apart, "exact": exact.tolist()}


def exact_of_plain(kept: Any) -> np.ndarray:
    """Gradients (2, 8) of the plain joint from the file of CVODES' forward sensitivities."""
    at = sum(size for name, size in list(CONTACTS.items())[: list(CONTACTS).index("seat_ball")])
    ours = slice(at, at + CONTACTS["seat_ball"])
    by_force = jax.jacrev(numbers)(jnp.asarray(kept.force[:, ours]))
    return np.einsum("stc,tcp->sp", np.asarray(by_force), kept.slope[:, ours])


def plain() -> dict[str, Any]:
    """The plain joint."""
    scene, kept = bj.scenes.joint_of_keys(**PLAIN), load()
    return table_of(scene, scene.parameters(), jnp.asarray(kept.times), exact_of_plain(kept), TOLERANCES)


def peer() -> dict[str, Any]:
    """The plain joint by CVODES' adjoint, the better of ``SETTINGS``."""
    from benchmarks.references.joint_casadi import default_scales
    from benchmarks.references.joint_sensitive import Sensitive

    scene, kept, rows = bj.scenes.joint_of_keys(**PLAIN), load(), []
    params, exact = scene.parameters(), exact_of_plain(kept)
    made = Sensitive(scene, params, default_scales(scene), MOVED)

    def read(states: Any, logs: Any) -> Any:
        prepared = scene.prepare(moved(params, logs))
        force = jax.vmap(lambda y: scene.observe(jnp.zeros(()), y, prepared)["seat_ball"].force)(states)
        return numbers(force[..., 0])

    seeded = jax.jit(jax.jacrev(read, (0, 1)))
    for tolerance in TOLERANCES:
        states, *_ = made.states(kept.times, tolerance)
        seeds, direct = (np.asarray(x) for x in seeded(jnp.asarray(states), jnp.zeros(len(MOVED))))
        tried = []
        for between, size in SETTINGS:
            try:
                parts = [made.gradient(kept.times, tolerance, seed, between, size) for seed in seeds]
                errors = off(np.stack([slope for slope, _ in parts]) + direct, exact)
                found = {**errors, "cpu_s": sum(seconds for _, seconds in parts)}
            except RuntimeError as error:
                found = {"failed": str(error).splitlines()[-1].rpartition(":")[2].strip()}
            tried.append({"between": between, "size": size, **found})
            print(tolerance, tried[-1], flush=True)
        best = min(tried, key=lambda x: x.get(OBSERVED[0], np.inf))
        rows.append({"tolerance": tolerance, "CVODES": best, "tried": tried})
    return {"rows": rows}


def default() -> dict[str, Any]:
    """The default joint."""
    scene = bj.scenes.joint()
    times = jnp.linspace(0.0, SHORT_S, round(SHORT_S / 1e-3) + 1)
    return table_of(scene, scene.parameters(), times, None, TOLERANCES)


def hundred(scene: Any) -> tuple[dict[str, Any], list[str]]:
    """The joint's parameters, and as many of its contacts' own coefficients as make up ``COUNT`` that are not 0."""
    rng, params = np.random.default_rng(0), scene.parameters()
    # Unequal balls, by 2 um or so.
    single = [name for name in params if name.endswith((".oversize", ".extra_clearance"))]
    params = {**params, **dict(zip(single, jnp.asarray(2e-6 * rng.uniform(0.5, 1.0, len(single))), strict=True))}
    names = [name for name, value in params.items() if float(value) != 0.0]
    for own in scene.quantities:
        shared = own.partition(".")[2]
        if len(names) < COUNT and own not in params and shared in params and float(params[shared]) != 0.0:
            params, _ = complete(scene, params, (own,))
            names.append(own)
    return params, names


def unlike() -> Any:
    """A joint with window ends and unequal balls, which has a hundred parameters."""
    return bj.scenes.joint_of_keys(spin=False, bands=False, window_ends=True, unequal=True)


def cost(scene: Any) -> dict[str, Any]:
    """A gradient by all logarithms, a hundred at most, beside runs of values in the same process."""
    params, names = hundred(scene)
    times, k = jnp.asarray(load().times), len(names)

    def change(params: Any, logs: Any) -> Any:
        return params | {name: params[name] * jnp.exp(log) for name, log in zip(names, logs, strict=True)}

    def square(mode: str, controlled: bool) -> Callable:
        """(logarithms, tolerance) -> the first of both numbers."""
        function = scalars(scene, params, times, mode, controlled)
        return lambda logs, tolerance: function(change, logs, tolerance)[0]

    value, _ = compiled(square("auto", False), k)
    programs, memory = {}, {}
    for controlled in (False, True):
        programs[controlled], memory[str(controlled)] = compiled(jax.grad(square("reverse", controlled)), k)
    exact = np.asarray(programs[True](jnp.zeros(k), jnp.asarray(TIGHT)))
    order, counts = np.argsort(-np.abs(exact)), counting(exact)

    # Forward at the same tolerance, along one direction at a time: by single parameters and along a random one.
    ahead = jax.jit(lambda way, t: jax.jvp(lambda x: square("forward", True)(x, t), (jnp.zeros(k),), (way,))[1])
    single = order[np.linspace(0, np.sum(counts) - 1, CHECKED).round().astype(int)]
    way = np.random.default_rng(0).normal(size=k)
    *alone, along = (float(ahead(jnp.asarray(x), jnp.asarray(TIGHT))) for x in (*np.eye(k)[single], way))
    size = float(np.linalg.norm(exact))
    checked = {names[i]: {"of its own": abs(x / exact[i] - 1), "of all": abs(x - exact[i]) / size}
               for i, x in zip(single, alone, strict=True)}  # fmt: skip
    # Along a random direction the parts cancel, and what is left shows their errors many times as large.
    parts = {"forward": along, "reverse": float(exact @ way), "sum of sizes": float(np.abs(exact * way).sum())}
    print(checked, parts, flush=True)

    some, jacobians = order[:SOME], {}
    for controlled in (False, True):
        function = square("forward", controlled)
        jacobians[controlled] = jax.jit(jax.jacfwd(lambda y, t, f=function: f(jnp.zeros(k).at[some].set(y), t)))
    _, run = timed(value, k, 2e-3)
    rows = []
    for tolerance in (1e-2, 2e-3, *TOLERANCES[1:]):
        controlled = tolerance < CONTROLLED_BELOW
        found, seconds = timed(programs[controlled], k, tolerance)
        forward, of_some = timed(jacobians[controlled], SOME, tolerance)
        _, same = timed(value, k, tolerance)
        rows.append({"tolerance": tolerance, "cpu_s": seconds, "runs": seconds / same, "runs at 0.1 %": seconds / run})
        rows[-1]["mean square"], rows[-1]["mean square, worst"] = apart(found, exact, counts)
        for name, a in ((f"{SOME} of them", found[some]), (f"{SOME} of them, forward", forward)):
            rows[-1][name], rows[-1][f"{name}, worst"] = apart(a, exact[some], counts[some])
        rows[-1]["forward_cpu_s"] = of_some
        print(rows[-1], flush=True)
    return {
        "parameters": k, "rows": rows, "programs": memory, "value_at_0.1_percent_cpu_s": run,
        f"reverse at {TIGHT:g} against forward": checked, "along a random direction": parts,
    }  # fmt: skip


def before() -> dict[str, Any]:
    """Compiling of the plain joint's gradient at ``balanced`` by the package that is imported."""
    found, scene, times = {}, bj.scenes.joint_of_keys(**PLAIN), jnp.linspace(0.0, 0.6, 601)
    params = scene.parameters()
    for mode in ("reverse", "auto"):
        function = scalars(scene, params, times, mode, False)
        program, cost = compiled(jax.grad(lambda x, t, f=function: f(moved, x, t)[0]), len(MOVED))
        found[mode] = {**cost, **{f"cpu_s at {t}": timed(program, len(MOVED), t)[1] for t in (2e-2, 1e-3)}}
        print(mode, found[mode], flush=True)
    return found


PARTS: dict[str, Callable[[], dict[str, Any]]] = {
    "plain": plain,
    "peer": peer,
    "default": default,
    "cost": lambda: cost(unlike()),
    "cost_plain": lambda: cost(bj.scenes.joint_of_keys(**PLAIN)),
    "before": before,
    "after": before,
}


def main() -> None:
    # What is kept from another process would not be compiled.
    jax.config.update("jax_enable_compilation_cache", False)
    usual = Some([part for part in PARTS if part != "before"])
    harness.parts("joint_gradient", PARTS, options(__doc__, {"parts": usual}).parts)
    show(known("joint_gradient"))


def cells(row: dict[str, Any], names: tuple[str, ...]) -> list[str]:
    """Errors, and seconds, of what may have failed."""
    if names[0] not in row:
        return ["failed" if row else ""] + [""] * len(names)
    return [*(f"{100 * row[name]:.2g} %" for name in names), f"{row['cpu_s']:.2f}"]


def tables(found: dict[str, Any]) -> dict[str, str]:
    """By part its table."""
    rows = {part: {row["tolerance"]: row for row in found.get(part, {}).get("rows", [])} for part in PARTS}
    tables = {}
    for part in ("plain", "default"):
        peers = {tolerance: rows["peer"].get(tolerance, {}).get("CVODES", {}) for tolerance in rows[part]}
        ways = ("reverse", "forward", *(("CVODES' adjoint",) if part == "plain" else ()))
        table = [["tolerance", *(x for way in ways for x in (f"{way}, mean square", "peak", "s"))]]
        for tolerance, row in rows[part].items():
            each = {**row, "CVODES' adjoint": peers[tolerance]}
            table.append([f"{tolerance:g}", *(cell for way in ways for cell in cells(each[way], OBSERVED))])
        tables[part] = markdown(table)
    for part in ("cost", "cost_plain"):
        table = [["tolerance", "error", "worst", "s", "runs of values at that tolerance", "at 0.002"]]
        table[0] += [f"the {SOME} strongest{way}: {what}" for way in ("", ", forward") for what in ("error", "worst")]
        for tolerance, row in rows[part].items():
            whole, some, forward = (
                cells(row, (x, f"{x}, worst")) for x in ("mean square", f"{SOME} of them", f"{SOME} of them, forward")
            )
            runs = [f"{row[x]:.1f}" for x in ("runs", "runs at 0.1 %")]
            table.append([f"{tolerance:g}", *whole, *runs, *some[:-1], *forward[:-1]])
        tables[part] = markdown(table)
    return tables


def show(found: dict[str, Any]) -> None:
    """The tables, those of the plain joint and of a hundred parameters in docs/derivatives.md, too."""
    markers = {"plain": "gradient", "default": "gradient-default", "cost": "gradient-cost"}
    for part, table in tables(found).items():
        publish(markers[part], table, PAGE) if part in markers else print(part, table, sep="\n")
    for when in ("before", "after"):
        for name, row in found.get(when, {}).items():
            print(when, name, row)


if __name__ == "__main__":
    main()
