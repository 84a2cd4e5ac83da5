"""Is a contact ever stepped over? Random scenes in which bodies meet at speed, far from each other and for a short time.

Twelve families of scenes, 250 draws of each: 2 to 6 bodies that fly, roll, turn or are driven meet at distances of 1 to
1 000 times their size and at speeds over four decades; pulses take 1e-5 to 1e-1 of the run; rams dwell and strike. Each is
run by every solver that can, at ``balanced`` and at 1e-4, and beside that with steps of 1e-4 of the run, which is the
reference. Compared are which contacts happen, and the velocities of all bodies at the end, that is the impulses that they
received. A run of several bounces that hangs on rounding is told by the reference itself: where the reference at a third of
its step differs from it by more than a tenth of the limit, the draw is not judged.

    python -m benchmarks.solve.stepped_over [--draws N] [--only FAMILY ...] [--solvers NAME ...]   stepped_over.json
    python -m benchmarks.solve.stepped_over --before --solvers tsit5 rodas3     without looks: stepped_over_before.json
    python -m benchmarks.solve.stepped_over page      writes the table into docs/theory/steps.md
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import jax.numpy as jnp
import numpy as np

from bcfj_jax.contact import gaps
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism import loads
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.common import RESULTS, load, markdown, put_in_readme, save

ACCURACIES = ("balanced", 1e-4)
EXPLICIT, IMPLICIT = ("tsit5", "dopri5", "dopri8", "bosh3", "kvaerno5"), ("rodas3", "sdirk2", "bdf")
# Steps of the reference, shares of the run; of its own check.
STEPS = (1e-4, 5e-5)
# Instants at which velocities are read, for the greatest.
_SAMPLES = 65
# Velocities at the end may be off by this share of the greatest, per accuracy; a contact missed is off by all of it.
LIMITS = {"balanced": 3e-2, 1e-4: 3e-3}


class Family(NamedTuple):
    """A scene whose numbers are parameters, how they are drawn, and its end.

    Attributes:
        scene: the mechanism; ``draw``: (random generator) -> its parameters of its own and the end [s].
    """

    scene: Mechanism
    draw: Callable[[np.random.Generator], tuple[dict[str, float], float]]


def _own(*names: str) -> list[tuple[Quantity, float]]:
    return [(Quantity(name, "1", name), 0.0) for name in names]


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


HARD = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}


def _meeting(rng: np.random.Generator, radius: float) -> tuple[float, float]:
    """Distance of 1 to 1 000 sizes and a speed over four decades."""
    return radius * _log(rng, 3.0, 1e3), _log(rng, 1e-2, 1e2)


def two_balls() -> Family:
    """Two balls in space; the second may pass beside the first."""
    names = ("ax", "ay", "vx", "vy", "ux", "radius")
    bodies = [
        Body("a", "particle", mass=0.1, start={"x": "ax", "y": "ay", "vx": "vx", "vy": "vy"}),
        Body("b", "particle", mass=0.2, start={"vx": "ux"}),
    ]
    hit = Contact("hit", ("a", "b"), gaps.SphereOnSphere(), values={"radius_a": "radius", "radius_b": "radius"})

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 1e-1)
        far, speed = _meeting(rng, radius)
        drift = rng.uniform(-0.5, 0.5) * speed
        aim, time = rng.uniform(-2.4, 2.4) * radius, far / speed
        way = rng.uniform(0.2, 0.8)
        return {
            "ax": -far, "ay": aim, "vx": speed + drift, "vy": 0.0, "ux": drift, "radius": radius,
        }, time / way  # fmt: skip

    return Family(Mechanism("two_balls", bodies, [hit], own=_own(*names), given=HARD), draw)


def in_mid_air() -> Family:
    """One ball falls, one is thrown up beneath it."""
    bodies = [
        Body("down", "particle", mass=0.05, start={"y": "height", "x": "aim"}),
        Body("up", "particle", mass=0.05, start={"vy": "speed"}),
    ]
    hit = Contact("hit", ("down", "up"), gaps.SphereOnSphere(), values={"radius_a": "radius", "radius_b": "radius"})

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 3e-2)
        height, speed = _meeting(rng, radius)
        return {"height": height, "speed": speed, "radius": radius, "aim": rng.uniform(-1.8, 1.8) * radius}, min(
            1.0, height / speed / rng.uniform(0.3, 0.9)
        )

    return Family(
        Mechanism("in_mid_air", bodies, [hit], [loads.Gravity("-y")], own=_own("height", "speed", "radius", "aim"), given=HARD),
        draw,
    )  # fmt: skip


def row() -> Family:
    """The first of five balls in a row, far from each other, sets off the rest."""
    places, first = [f"x{k}" for k in range(5)], {"velocity": "speed"}
    bodies = [
        Body(f"b{k}", "slide", axis="x", mass=0.1 * (1 + k % 2), start={"position": place} | (first if k == 0 else {}))
        for k, place in enumerate(places)
    ]
    hits = [
        Contact(f"hit{k}", (f"b{k}", f"b{k + 1}"), gaps.SphereOnSphere(), values={"radius_a": "radius", "radius_b": "radius"})
        for k in range(4)
    ]  # fmt: skip

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 3e-2)
        at, found = 0.0, {}
        speed = _log(rng, 1e-2, 1e2)
        for name in places:
            found[name] = at
            at += radius * (2.0 + _log(rng, 1.0, 300.0))
        return found | {"speed": speed, "radius": radius}, 1.5 * at / speed

    return Family(Mechanism("row", bodies, hits, own=_own(*places, "speed", "radius"), given=HARD), draw)


def rolling() -> Family:
    """A ball rolls into one at rest on a table."""
    radius = 0.0286
    mass, stiff = 0.17, 1e5
    rest = radius - mass * 9.81 / stiff
    bodies = [
        Body(name, "sphere", mass=mass, inertia=0.4 * mass * radius**2, start={"z": rest} | start)
        for name, start in (("a", {"x": "ax", "y": "aim", "vx": "speed", "wy": "spin"}), ("b", {}))
    ]
    table = {
        "stiffness": stiff,
        "exponent": 1.0,
        "damping": 0.5,
        "radius": radius,
        "friction_dynamic": 0.2,
        "friction_speed": 1e-2,
    }
    felt = [
        Contact("felt_" + n, ("ground", n), gaps.SphereOnPlane("z"), friction="coulomb", values=table) for n in "ab"
    ]
    hit = Contact("hit", ("a", "b"), gaps.SphereOnSphere(), values={"radius_a": radius, "radius_b": radius})

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        far, speed = radius * _log(rng, 3.0, 100.0), _log(rng, 3e-2, 10.0)
        return {
            "ax": -far,
            "aim": rng.uniform(-1.2, 1.2) * radius,
            "speed": speed,
            "spin": speed / radius,
        }, far / speed / rng.uniform(0.5, 0.9)

    return Family(
        Mechanism(
            "rolling", bodies, [*felt, hit], [loads.Gravity("-z")], own=_own("ax", "aim", "speed", "spin"), given=HARD
        ),
        draw,
    )


def rotor() -> Family:
    """The tip of a rotor meets a ball at rest."""
    bodies = [
        Body("rotor", "hinge", mass=1.0, inertia=1e-2, start={"speed": "spin"}),
        Body("ball", "particle", mass=0.01, start={"x": "bx", "y": "by"}),
    ]
    hit = Contact("hit", ("rotor", "ball"), gaps.SphereOnSphere(), at=((0.2, 0, 0), (0, 0, 0)),
                  values={"radius_a": 0.004, "radius_b": 0.004})  # fmt: skip

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        spin, angle, off = _log(rng, 1e-1, 1e3), rng.uniform(0.3, 6.0), rng.uniform(-0.0078, 0.0078)
        away = (0.2 + off) * np.exp(1j * angle)
        return {"spin": spin, "bx": away.real, "by": away.imag}, angle / spin / rng.uniform(0.3, 0.9)

    return Family(Mechanism("rotor", bodies, [hit], own=_own("spin", "bx", "by"), given=HARD), draw)


def paddle() -> Family:
    """A plane that a drive turns strikes a point at rest; both leave each other."""
    bodies = [
        Body("paddle", "hinge", mass=1.0, inertia=1e-2, drive=Drive("constant", speed="spin")),
        Body("ball", "particle", mass=0.01, start={"x": "bx", "y": "by"}),
    ]
    hit = Contact("hit", ("paddle", "ball"), gaps.PointOnPlane("y"))

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        spin, angle, arm = _log(rng, 1e-1, 1e3), rng.uniform(0.2, 1.5), _log(rng, 1e-2, 1.0)
        return {"spin": spin, "bx": arm * np.cos(angle), "by": arm * np.sin(angle)}, angle / spin / rng.uniform(
            0.3, 0.9
        )

    return Family(Mechanism("paddle", bodies, [hit], own=_own("spin", "bx", "by"), given=HARD), draw)


def pulse() -> Family:
    """A pulse of a function of time drives a block; it may reach a wall."""
    block = Body("block", "slide", axis="x", mass=1.0)
    wall = Contact("wall", ("ground", "block"), gaps.PointOnPlane("-x"), at=(("far", 0, 0), (0, 0, 0)))

    def push(t: Any, bodies: Any, p: Any) -> list[loads.Action]:
        inside = jnp.abs(t - p["middle"]) < 0.5 * p["width"]
        wave = jnp.where(inside, jnp.cos(jnp.pi * (t - p["middle"]) / p["width"]), 0.0)
        return [loads.Action("block", (p["peak"] * wave, 0.0, 0.0))]

    known = [(Quantity(name, "1", name), 0.0) for name in ("middle", "width", "peak")]
    load = loads.Load("pulse", push, ("block",), tuple(known))

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        end, middle = _log(rng, 1e-2, 1e2), rng.uniform(0.1, 0.6)
        # A function is looked at 16 384 times in a run; shorter pulses are a table's, or have breaks.
        width, speed = _log(rng, 3e-4, 1e-1), _log(rng, 1e-2, 1e1)
        far = speed * (1.0 - middle) * end * rng.uniform(0.3, 2.0)
        return {
            "middle": middle * end, "width": width * end, "peak": speed * np.pi / (2.0 * width * end), "far": far,
        }, end  # fmt: skip

    return Family(Mechanism("pulse", [block], [wall], [load], own=_own("far"), given=HARD), draw)


def table_pulse() -> Family:
    """A pulse of a table, 1e-5 to 1e-1 of the run, by a table of shares of the run."""
    block = Body("block", "slide", axis="x", mass=1.0)
    wall = Contact("wall", ("ground", "block"), gaps.PointOnPlane("-x"), at=(("far", 0, 0), (0, 0, 0)))
    knots, values = [0.0], [0.0]
    for k, width in enumerate((1e-5, 1e-4, 1e-3, 1e-2, 1e-1)):
        knots += [0.15 * (k + 1), 0.15 * (k + 1) + 0.5 * width, 0.15 * (k + 1) + width]
        values += [0.0, 2.0 / width, 0.0]
    push = loads.Force("push", "block", "x", size="speed", table=(tuple(knots), tuple(values)))

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        speed = _log(rng, 1e-2, 1e2)
        return {"speed": speed, "far": speed * rng.uniform(0.2, 3.0)}, 1.0

    return Family(Mechanism("table_pulse", [block], [wall], [push], own=_own("far", "speed"), given=HARD), draw)


def ram() -> Family:
    """A ram dwells, strokes onto a sprung anvil, and dwells again, by a function of time."""

    def stroke(t: Any, p: Any) -> Any:
        inside = jnp.abs(t - p["middle"]) < 0.5 * p["width"]
        return jnp.where(inside, p["far"] * 1.02 * jnp.cos(jnp.pi * (t - p["middle"]) / p["width"]) ** 4, 0.0)

    bodies = [
        Body("ram", "slide", axis="x", mass=1.0, drive=Drive("function", function=stroke)),
        Body("anvil", "slide", axis="x", mass=1.0, start={"position": "far"}),
    ]
    hit = Contact("hit", ("anvil", "ram"), gaps.PointOnPlane("-x"))
    spring = loads.JointSpring("spring", "anvil", stiffness=2e3, damping=5.0, rest="far")

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        end = _log(rng, 1e-1, 1e1)
        return {
            "middle": rng.uniform(0.2, 0.8) * end,
            "width": _log(rng, 3e-3, 1e-1) * end,
            "far": _log(rng, 1e-3, 1e-1),
        }, end

    return Family(Mechanism("ram", bodies, [hit], [spring], own=_own("middle", "width", "far"), given=HARD), draw)


def stops() -> Family:
    """A mass flies between two stops, several times."""
    body = Body("a", "slide", axis="x", mass=1.0, start={"velocity": "speed"})
    stop = Contact("stop", ("ground", "a"), gaps.TwoSidedStop("x"), values={"clearance": "free"})

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        speed, free = _log(rng, 1e-2, 1e2), _log(rng, 1e-3, 1.0)
        return {"speed": speed, "free": free}, rng.uniform(0.5, 7.0) * free / speed

    return Family(Mechanism("stops", [body], [stop], own=_own("speed", "free"), given=HARD), draw)


def six() -> Family:
    """Six balls in a plane, all towards the middle."""
    names = [f"{c}{k}" for k in range(6) for c in ("x", "y", "u", "v")]
    bodies = [
        Body(f"b{k}", "particle", mass=0.1, start={"x": f"x{k}", "y": f"y{k}", "vx": f"u{k}", "vy": f"v{k}"})
        for k in range(6)
    ]
    hits = [
        Contact(f"h{i}{k}", (f"b{i}", f"b{k}"), gaps.SphereOnSphere(), values={"radius_a": "radius", "radius_b": "radius"})
        for i in range(6) for k in range(i + 1, 6)
    ]  # fmt: skip

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 3e-2)
        far, speed = radius * _log(rng, 5.0, 50.0), _log(rng, 1e-2, 1e2)
        found = {"radius": radius}
        for k in range(6):
            away = far * rng.uniform(0.8, 1.2) * np.exp(1j * (k + rng.uniform(-0.2, 0.2)) * np.pi / 3.0)
            aim = radius * complex(*rng.uniform(-1.0, 1.0, 2))
            way = (aim - away) / abs(aim - away) * speed * rng.uniform(0.9, 1.1)
            found |= {f"x{k}": away.real, f"y{k}": away.imag, f"u{k}": way.real, f"v{k}": way.imag}
        return found, 1.15 * far / speed

    return Family(Mechanism("six", bodies, hits, own=_own(*names, "radius"), given=HARD), draw)


def spun() -> Family:
    """A dumbbell flies and spins past a fixed ball, one of its ends may strike it."""
    bodies = [
        Body("bar", "free", mass=0.2, inertia=1e-4, start={"x": "ax", "vx": "speed", "wz": "spin", "wy": "tumble"}),
        Body("ball", "particle", mass=0.2),
    ]
    hits = [
        Contact(f"end_{side}", ("bar", "ball"), gaps.SphereOnSphere(), at=((0.0, y, 0.0), (0.0, 0.0, 0.0)),
                values={"radius_a": 0.01, "radius_b": 0.01})
        for side, y in (("a", 0.03), ("b", -0.03))
    ]  # fmt: skip

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        far, speed = 0.03 * _log(rng, 3.0, 100.0), _log(rng, 1e-2, 1e2)
        turns = rng.uniform(-20.0, 20.0) * speed / far
        return {
            "ax": -far,
            "speed": speed,
            "spin": turns,
            "tumble": rng.uniform(-5.0, 5.0) * speed / far,
        }, 1.6 * far / speed

    return Family(Mechanism("spun", bodies, hits, own=_own("ax", "speed", "spin", "tumble"), given=HARD), draw)


FAMILIES: dict[str, Callable[[], Family]] = {
    f.__name__: f
    for f in (two_balls, in_mid_air, row, rolling, rotor, paddle, pulse, table_pulse, ram, stops, six, spun)
}


class _Before(Mechanism):
    """A mechanism as it was solved before steps were looked at."""

    @property
    def shows_proximity(self) -> bool:
        """No."""
        return False

    def breaks(self, params: Any, end: Any) -> None:
        """None."""
        del params, end


def table() -> str:
    """By solver and accuracy: runs, and in how many of them a contact was missed or a velocity was off."""
    rows = [["solver, accuracy", "runs", "a contact missed", "velocities off", "failed", "the same before"]]
    totals: dict[str, dict[str, float]] = {}
    before: dict[str, float] = {}
    for name, into in (("stepped_over", totals), ("stepped_over_before", None)):
        for family in load(name)["families"].values():
            for solver, counts in family["solvers"].items():
                if into is None:
                    wrong = max(counts["contact missed"], counts["velocity off"])
                    before[solver] = before.get(solver, 0) + wrong
                    before[f"{solver} runs"] = before.get(f"{solver} runs", 0) + counts["runs"]
                    continue
                sums = into.setdefault(solver, dict.fromkeys(counts, 0))
                for key, value in counts.items():
                    sums[key] = max(sums[key], value) if key == "worst" else sums[key] + value
    for solver, sums in totals.items():
        told = f"{before[solver]} of {before[f'{solver} runs']} wrong" if solver in before else ""
        missed = "not looked at" if solver.startswith("bdf") else f"{sums['contact missed']}"
        rows.append(
            [solver.replace(" ", ", "), f"{sums['runs']}", missed, f"{sums['velocity off']}", f"{sums['failed']}", told]
        )
    return markdown(rows)


def _program(scene: Mechanism, how: Plan) -> Callable[..., Any]:
    """(parameters, end, tolerance, longest) -> velocities over the run, contacts, status, steps, last begin."""
    count = len(scene._free)
    first = sum(k or 1 for *_, k in scene._placed)

    def run(params: dict[str, Any], end: Any, tolerance: Any, longest: Any) -> Any:
        asked = Plan(tolerance, how.max_steps, solver=how.solver, extremes=how.extremes, longest=longest)
        found = integrate(scene, params, end * jnp.linspace(0.0, 1.0, _SAMPLES), asked)
        met = found.extremes or {}
        counts = jnp.stack([jnp.stack([x.onset < jnp.inf, x.count]) for x in met.values()]) if met else None
        last = jnp.max(jnp.stack([jnp.where(x.latest < jnp.inf, x.latest, 0.0) for x in met.values()])) if met else None
        return found.states[:, first : first + count], counts, found.code, found.accepted + found.rejected, last

    return jax.jit(run)


def judged(name: str, draws: int, solvers: Sequence[str], before: bool = False, seed: int = 0) -> dict[str, Any]:
    """What solvers make of so many draws of a family: by solver and accuracy, counts of what was wrong.

    ``before``: without looks within steps and without breaks; the reference has both.
    """
    family = FAMILIES[name]()
    rng = np.random.default_rng((seed, *name.encode()))
    cases = [family.draw(rng) for _ in range(draws)]
    base = Mechanism.parameters(family.scene, dict.fromkeys((q.name for q, _ in family.scene.own), 1.0))
    cases = [({**base, **{k: np.asarray(v) for k, v in values.items()}}, end) for values, end in cases]
    references, certain = [], []
    scene = family.scene.suited(base, 1.0, "tsit5")
    program = _program(scene, Plan(jnp.zeros(()), 10_000_000, solver="tsit5", extremes=True))
    tight = plan(scene, 1e-6).tolerance
    for values, end in cases:
        found = [jax.device_get(program(values, end, tight, np.asarray(step * end))) for step in STEPS]
        references.append(found[1])
        # What begins just before the end may as well begin just after it.
        certain.append(_off(found[0], found[1]) < 0.1 * LIMITS[1e-4] and not 0.98 * end < found[1][4])
    rows: dict[str, Any] = {}
    kind = _Before if before else Mechanism
    for solver in solvers:
        scene = family.scene.suited(base, 1.0, solver)
        scene = kind(**{f.name: getattr(scene, f.name) for f in fields(scene)})
        looked = solver != "bdf"
        for accuracy in ACCURACIES:
            how = Plan(jnp.zeros(()), 400_000, solver=solver, extremes=looked)
            program = _program(scene, how)
            tolerance = plan(scene, accuracy, solver=solver).tolerance
            counts = {
                "runs": 0,
                "failed": 0,
                "contact missed": 0,
                "count off": 0,
                "velocity off": 0,
                "worst": 0.0,
                "steps": 0,
            }
            for (values, end), truth, sure in zip(cases, references, certain, strict=True):
                if not sure:
                    continue
                found = jax.device_get(program(values, end, tolerance, np.asarray(np.inf)))
                off = _off(found, truth)
                counts["runs"] += 1
                counts["failed"] += int(found[2] != 0)
                if looked:
                    counts["contact missed"] += int(np.any(found[1][:, 0] != truth[1][:, 0]))
                    counts["count off"] += int(np.any(found[1][:, 1] != truth[1][:, 1]))
                counts["velocity off"] += int(not off <= LIMITS[accuracy])
                counts["worst"] = float(max(counts["worst"], off))
                counts["steps"] += int(found[3])
            rows[f"{solver} {accuracy}"] = counts
    return {"draws": draws, "not judged": int(draws - sum(certain)), "solvers": rows}


def _off(found: Any, truth: Any) -> float:
    """Greatest difference of velocities at the end over the greatest of the run; infinite for a failure."""
    off = np.max(np.abs(found[0][-1] - truth[0][-1])) / max(np.max(np.abs(truth[0])), 1e-12)
    return float(off) if np.isfinite(off) else float("inf")


def main() -> None:
    """Run the families and keep the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=250)
    parser.add_argument("--only", nargs="*", default=list(FAMILIES))
    parser.add_argument("--solvers", nargs="*", default=[*EXPLICIT, *IMPLICIT])
    parser.add_argument("--before", action="store_true")
    parser.add_argument("--name", default="")
    parser.add_argument("what", nargs="?", choices=["run", "page"], default="run")
    options = parser.parse_args()
    name = options.name or ("stepped_over_before" if options.before else "stepped_over")
    if options.what == "page":
        put_in_readme("stepped_over", table(), "docs/theory/steps.md")
        return
    # Runs of several calls add up in one file.
    path = RESULTS / f"{name}.json"
    found = load(name)["families"] if path.exists() else {}
    for family in options.only:
        new = judged(family, options.draws, options.solvers, options.before)
        print(family, new["not judged"], "of", options.draws, "not judged", flush=True)
        for solver, counts in new["solvers"].items():
            print("   ", solver, counts, flush=True)
        found[family] = {**new, "solvers": found.get(family, {}).get("solvers", {}) | new["solvers"]}
        save(name, {"families": found})
        jax.clear_caches()


if __name__ == "__main__":
    main()
