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

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import combinations
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import benchmarks.common as harness
from bcfj_jax.contact import gaps
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.mechanism import loads
from bcfj_jax.mechanism.bodies import Body, Drive
from bcfj_jax.mechanism.contacts import Contact
from bcfj_jax.mechanism.mechanism import Mechanism
from bcfj_jax.solve.integrate import integrate
from bcfj_jax.solve.plan import Plan, plan
from benchmarks.common import known, load, options, publish, save

ACCURACIES = ("balanced", 1e-4)
EXPLICIT, IMPLICIT = ("tsit5", "dopri5", "dopri8", "bosh3", "kvaerno5"), ("rodas3", "sdirk2", "bdf")
# Steps of the reference, shares of the run; of its own check.
STEPS = (1e-4, 5e-5)
# Instants at which velocities are read, for the greatest.
_SAMPLES = 65
# Velocities at the end may be off by this share of the greatest, per accuracy; a contact missed is off by all of it.
LIMITS = {"balanced": 3e-2, 1e-4: 3e-3}


class Family(NamedTuple):
    """A scene whose numbers are parameters, and how they are drawn.

    Attributes:
        scene: the mechanism; ``draw``: (random generator) -> its parameters of its own and the end [s].
    """

    scene: Mechanism
    draw: Callable[[np.random.Generator], tuple[dict[str, float], float]]


def _family(
    draw: Callable[[np.random.Generator], tuple[dict[str, float], float]], name: str, bodies: list[Body],
    contacts: list[Contact], forces: Sequence[Any] = (), apart: Sequence[str] = (),
) -> Family:  # fmt: skip
    """A family whose mechanism has the numbers that are drawn as its own, but for those ``apart``, which its loads have."""
    own = [(Quantity(key, "1", key), 0.0) for key in draw(np.random.default_rng(0))[0] if key not in apart]
    return Family(Mechanism(name, bodies, contacts, forces, own=own, given=HARD), draw)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


HARD = {"stiffness": 1e8, "exponent": 1.5, "damping": 0.1}


def _meeting(rng: np.random.Generator, radius: float) -> tuple[float, float]:
    """Distance of 1 to 1 000 sizes and a speed over four decades."""
    return radius * _log(rng, 3.0, 1e3), _log(rng, 1e-2, 1e2)


def _balls(name: str, first: str, second: str, radius: Any = "radius", **options: Any) -> Contact:
    """The contact of two balls of one radius."""
    sizes = {"radius_a": radius, "radius_b": radius}
    return Contact(name, (first, second), gaps.SphereOnSphere(), values=sizes, **options)


def two_balls() -> Family:
    """Two balls in space; the second may pass beside the first."""
    bodies = [
        Body("a", "particle", mass=0.1, start={"x": "ax", "y": "ay", "vx": "vx", "vy": "vy"}),
        Body("b", "particle", mass=0.2, start={"vx": "ux"}),
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 1e-1)
        far, speed = _meeting(rng, radius)
        drift = rng.uniform(-0.5, 0.5) * speed
        aim, time = rng.uniform(-2.4, 2.4) * radius, far / speed
        way = rng.uniform(0.2, 0.8)
        return {
            "ax": -far, "ay": aim, "vx": speed + drift, "vy": 0.0, "ux": drift, "radius": radius,
        }, time / way  # fmt: skip

    return _family(draw, "two_balls", bodies, [_balls("hit", "a", "b")])


def in_mid_air() -> Family:
    """One ball falls, one is thrown up beneath it."""
    bodies = [
        Body("down", "particle", mass=0.05, start={"y": "height", "x": "aim"}),
        Body("up", "particle", mass=0.05, start={"vy": "speed"}),
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 3e-2)
        height, speed = _meeting(rng, radius)
        found = {"height": height, "speed": speed, "radius": radius, "aim": rng.uniform(-1.8, 1.8) * radius}
        return found, min(1.0, height / speed / rng.uniform(0.3, 0.9))

    return _family(draw, "in_mid_air", bodies, [_balls("hit", "down", "up")], [loads.Gravity("-y")])


def row() -> Family:
    """The first of five balls in a row, far from each other, sets off the rest."""
    places, first = [f"x{k}" for k in range(5)], {"velocity": "speed"}
    bodies = [
        Body(f"b{k}", "slide", axis="x", mass=0.1 * (1 + k % 2), start={"position": place} | (first if k == 0 else {}))
        for k, place in enumerate(places)
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        radius = _log(rng, 1e-3, 3e-2)
        at, found = 0.0, {}
        speed = _log(rng, 1e-2, 1e2)
        for name in places:
            found[name] = at
            at += radius * (2.0 + _log(rng, 1.0, 300.0))
        return found | {"speed": speed, "radius": radius}, 1.5 * at / speed

    return _family(draw, "row", bodies, [_balls(f"hit{k}", f"b{k}", f"b{k + 1}") for k in range(4)])


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
        "stiffness": stiff, "exponent": 1.0, "damping": 0.5, "radius": radius, "friction_dynamic": 0.2, "friction_speed": 1e-2,
    }  # fmt: skip
    felt = [
        Contact("felt_" + n, ("ground", n), gaps.SphereOnPlane("z"), friction="coulomb", values=table) for n in "ab"
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        far, speed = radius * _log(rng, 3.0, 100.0), _log(rng, 3e-2, 10.0)
        found = {"ax": -far, "aim": rng.uniform(-1.2, 1.2) * radius, "speed": speed, "spin": speed / radius}
        return found, far / speed / rng.uniform(0.5, 0.9)

    return _family(draw, "rolling", bodies, [*felt, _balls("hit", "a", "b", radius)], [loads.Gravity("-z")])


def rotor() -> Family:
    """The tip of a rotor meets a ball at rest."""
    bodies = [
        Body("rotor", "hinge", mass=1.0, inertia=1e-2, start={"speed": "spin"}),
        Body("ball", "particle", mass=0.01, start={"x": "bx", "y": "by"}),
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        spin, angle, off = _log(rng, 1e-1, 1e3), rng.uniform(0.3, 6.0), rng.uniform(-0.0078, 0.0078)
        away = (0.2 + off) * np.exp(1j * angle)
        return {"spin": spin, "bx": away.real, "by": away.imag}, angle / spin / rng.uniform(0.3, 0.9)

    return _family(draw, "rotor", bodies, [_balls("hit", "rotor", "ball", 0.004, at=((0.2, 0, 0), (0, 0, 0)))])


def paddle() -> Family:
    """A plane that a drive turns strikes a point at rest; both leave each other."""
    bodies = [
        Body("paddle", "hinge", mass=1.0, inertia=1e-2, drive=Drive("constant", speed="spin")),
        Body("ball", "particle", mass=0.01, start={"x": "bx", "y": "by"}),
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        spin, angle, arm = _log(rng, 1e-1, 1e3), rng.uniform(0.2, 1.5), _log(rng, 1e-2, 1.0)
        found = {"spin": spin, "bx": arm * np.cos(angle), "by": arm * np.sin(angle)}
        return found, angle / spin / rng.uniform(0.3, 0.9)

    return _family(draw, "paddle", bodies, [Contact("hit", ("paddle", "ball"), gaps.PointOnPlane("y"))])


# A block that something drives, and a wall that it may reach.
_BLOCK = Body("block", "slide", axis="x", mass=1.0)
_WALL = Contact("wall", ("ground", "block"), gaps.PointOnPlane("-x"), at=(("far", 0, 0), (0, 0, 0)))


def pulse() -> Family:
    """A pulse of a function of time drives a block; it may reach a wall."""
    names = ("middle", "width", "peak")

    def push(t: Any, bodies: Any, p: Any) -> list[loads.Action]:
        inside = jnp.abs(t - p["middle"]) < 0.5 * p["width"]
        wave = jnp.where(inside, jnp.cos(jnp.pi * (t - p["middle"]) / p["width"]), 0.0)
        return [loads.Action("block", (p["peak"] * wave, 0.0, 0.0))]

    load = loads.Load("pulse", push, ("block",), tuple((Quantity(name, "1", name), 0.0) for name in names))

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        end, middle = _log(rng, 1e-2, 1e2), rng.uniform(0.1, 0.6)
        # A function is looked at 16 384 times in a run; shorter pulses are a table's, or have breaks.
        width, speed = _log(rng, 3e-4, 1e-1), _log(rng, 1e-2, 1e1)
        far = speed * (1.0 - middle) * end * rng.uniform(0.3, 2.0)
        return {
            "middle": middle * end, "width": width * end, "peak": speed * np.pi / (2.0 * width * end), "far": far,
        }, end  # fmt: skip

    return _family(draw, "pulse", [_BLOCK], [_WALL], [load], names)


def table_pulse() -> Family:
    """A pulse of a table, 1e-5 to 1e-1 of the run, by a table of shares of the run."""
    knots, values = [0.0], [0.0]
    for k, width in enumerate((1e-5, 1e-4, 1e-3, 1e-2, 1e-1)):
        knots += [0.15 * (k + 1), 0.15 * (k + 1) + 0.5 * width, 0.15 * (k + 1) + width]
        values += [0.0, 2.0 / width, 0.0]
    push = loads.Force("push", "block", "x", size="speed", table=(tuple(knots), tuple(values)))

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        speed = _log(rng, 1e-2, 1e2)
        return {"speed": speed, "far": speed * rng.uniform(0.2, 3.0)}, 1.0

    return _family(draw, "table_pulse", [_BLOCK], [_WALL], [push])


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
        middle, width = rng.uniform(0.2, 0.8) * end, _log(rng, 3e-3, 1e-1) * end
        return {"middle": middle, "width": width, "far": _log(rng, 1e-3, 1e-1)}, end

    return _family(draw, "ram", bodies, [hit], [spring])


def stops() -> Family:
    """A mass flies between two stops, several times."""
    body = Body("a", "slide", axis="x", mass=1.0, start={"velocity": "speed"})
    stop = Contact("stop", ("ground", "a"), gaps.TwoSidedStop("x"), values={"clearance": "free"})

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        speed, free = _log(rng, 1e-2, 1e2), _log(rng, 1e-3, 1.0)
        return {"speed": speed, "free": free}, rng.uniform(0.5, 7.0) * free / speed

    return _family(draw, "stops", [body], [stop])


def six() -> Family:
    """Six balls in a plane, all towards the middle."""
    bodies = [
        Body(f"b{k}", "particle", mass=0.1, start={"x": f"x{k}", "y": f"y{k}", "vx": f"u{k}", "vy": f"v{k}"})
        for k in range(6)
    ]

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

    return _family(draw, "six", bodies, [_balls(f"h{i}{k}", f"b{i}", f"b{k}") for i, k in combinations(range(6), 2)])


def spun() -> Family:
    """A dumbbell flies and spins past a fixed ball, one of its ends may strike it."""
    bodies = [
        Body("bar", "free", mass=0.2, inertia=1e-4, start={"x": "ax", "vx": "speed", "wz": "spin", "wy": "tumble"}),
        Body("ball", "particle", mass=0.2),
    ]
    hits = [
        _balls(f"end_{side}", "bar", "ball", 0.01, at=((0.0, y, 0.0), (0.0, 0.0, 0.0)))
        for side, y in (("a", 0.03), ("b", -0.03))
    ]

    def draw(rng: np.random.Generator) -> tuple[dict[str, float], float]:
        far, speed = 0.03 * _log(rng, 3.0, 100.0), _log(rng, 1e-2, 1e2)
        turns = rng.uniform(-20.0, 20.0) * speed / far
        return {
            "ax": -far, "speed": speed, "spin": turns, "tumble": rng.uniform(-5.0, 5.0) * speed / far,
        }, 1.6 * far / speed  # fmt: skip

    return _family(draw, "spun", bodies, hits)


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
    totals: dict[str, Counter[str]] = {}
    before: dict[str, Counter[str]] = {}
    for name, into in (("stepped_over", totals), ("stepped_over_before", before)):
        for family in load(name)["families"].values():
            for solver, counts in family["solvers"].items():
                wrong = {"wrong": max(counts["contact missed"], counts["velocity off"])}
                into.setdefault(solver, Counter()).update({**counts, **wrong})

    def wrong_before(solver: str) -> str:
        return f"{before[solver]['wrong']} of {before[solver]['runs']} wrong" if solver in before else ""

    return harness.table({
        "solver, accuracy": lambda one: one[0].replace(" ", ", "), "runs": lambda one: one[1]["runs"],
        "a contact missed": lambda one: "not looked at" if one[0].startswith("bdf") else one[1]["contact missed"],
        "velocities off": lambda one: one[1]["velocity off"], "failed": lambda one: one[1]["failed"],
        "the same before": lambda one: wrong_before(one[0]),
    }, totals.items())  # fmt: skip


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
            names = ("runs", "failed", "contact missed", "count off", "velocity off", "worst", "steps")
            counts = dict.fromkeys(names, 0) | {"worst": 0.0}
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
    given = options(
        __doc__, {"what": "run"}, draws=250, only=FAMILIES, solvers=[*EXPLICIT, *IMPLICIT], before=False, name=""
    )
    if given.what == "page":
        publish("stepped_over", table(), "docs/theory/steps.md")
        return
    name = given.name or ("stepped_over_before" if given.before else "stepped_over")
    # Runs of several calls add up in one file.
    found = known(name).get("families", {})
    for family in given.only:
        new = judged(family, given.draws, given.solvers, given.before)
        print(family, new["not judged"], "of", given.draws, "not judged", flush=True)
        print(*(f"    {solver} {counts}" for solver, counts in new["solvers"].items()), sep="\n", flush=True)
        found[family] = {**new, "solvers": found.get(family, {}).get("solvers", {}) | new["solvers"]}
        save(name, {"families": found})
        jax.clear_caches()


if __name__ == "__main__":
    main()
