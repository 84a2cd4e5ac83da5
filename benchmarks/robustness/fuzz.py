"""Thousands of damaged inputs: no traceback, no hang, no run called good whose forces are wrong.

    python -m benchmarks.robustness.fuzz [--cases 2000] [--only scene,calibration,...] [--seed 0] [--keep]

With ``--keep`` each kind's row takes the place of that kind's earlier row in benchmarks/results/fuzz.json.

Each case is a mutation of a good file (``mutations``), drawn from its own seed, read as the command reads it:

scene         loaded; if it is accepted and its scene runs quickly, it is simulated. A run that is ``ok`` must have finite
              forces. Where the mutated file is still an impact by the default law, the highest force must be the closed form's
              (../shared/physics.md section 3), computed here from the parameters alone.
calibration   loaded with its records, as ``bcfj validate`` does
study         loaded, its points drawn if there are fewer than 100 000
... values    files that use every table (``wholes``): each of their values in turn replaced by one of every other kind
csv, ...      records of each data format, read with the columns and units of a good calibration
journal, ...  what a cut-off job has kept, restored

A refusal must be an ``InputError`` that names the file, quotes at most 200 characters of a value, and gives a remedy.
"""

from __future__ import annotations

import collections
import faulthandler
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w
from scipy.optimize import brentq

import benchmarks.common as harness
from benchmarks.common import ROOT, known, options, publish, save
from benchmarks.robustness import kept, records, wholes
from benchmarks.robustness.mutations import of_bytes, of_lines, of_nodes, of_toml

HANG = 5.0
# A message may list what is known; the value that it refuses is cut.
LONGEST_MESSAGE = 2000
LONGEST_VALUE = 200


class Case(NamedTuple):
    """How one case ended.

    Attributes:
        outcome: "accepted", "refused", or what is wrong: "traceback", "hang", "bad message", "wrong force".
        seconds: of reading alone.
        detail: the message, or the end of the traceback.
    """

    outcome: str
    seconds: float
    detail: str


class Hang(BaseException):
    """Raised by the timer; no ``except Exception`` catches it."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Interrupt Python code after a time of its own, whatever else the machine does; after 12 times that on the wall, end."""

    def stop(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    # No signal's handler runs within a library's own loop: then this process ends, and says where.
    faulthandler.dump_traceback_later(12.0 * seconds, exit=True, file=2)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def message_fault(message: str, file: Path, content: bytes) -> str:
    """What is wrong with a refusal's words; "" for nothing."""
    # What is kept has a name of its own, and a file may name another that is at fault.
    where = Path(message.partition(": ")[0]).name
    if file.name not in message and file.suffix != ".kept" and where.encode() not in content:
        return "does not name the file"
    if "; " not in message:
        return "gives no remedy"
    if len(message) > LONGEST_MESSAGE:
        return f"has {len(message)} characters"
    text = content.decode("utf-8", "replace")
    # Long runs of one character are the mutations' own; a message that repeats one repeats the value.
    for character in "x9[(µ":
        if character * (LONGEST_VALUE + 1) in text and character * (LONGEST_VALUE + 1) in message:
            return "repeats a long value"
    return ""


def run_case(read: Callable[[Path], Any], then: Callable[[Any], str], file: Path, content: bytes) -> Case:
    """Write a mutated file, read it, and look at what was accepted."""
    from bcfj_jax import InputError

    file.write_bytes(content)
    begun = time.perf_counter()
    try:
        with limited(HANG):
            found = read(file)
        seconds = time.perf_counter() - begun
        wrong = then(found)
        return Case("wrong force" if wrong else "accepted", seconds, wrong)
    except InputError as error:
        fault = message_fault(str(error), file, content)
        detail = f"{fault}: {str(error)[:600]}" if fault else str(error)[:300]
        return Case("bad message" if fault else "refused", time.perf_counter() - begun, detail)
    except Hang:
        return Case("hang", time.perf_counter() - begun, "".join(traceback.format_exc(limit=-6)))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return Case("traceback", time.perf_counter() - begun, "".join(traceback.format_exc(limit=-5))[-1500:])


def closed_peak(mass: float, speed: float, stiffness: float, exponent: float, damping: float) -> float:
    """Highest force [N] of F = K d^n (1 + a d') against a wall, ../shared/physics.md section 3 with chi = a v0."""
    n, chi = exponent, damping * speed
    if chi < 1e-6:
        depth = ((n + 1.0) * mass * speed**2 / (2.0 * stiffness)) ** (1.0 / (n + 1.0))
        return stiffness * depth**n

    # The peak's rate u v0: (1 - u) - n u/(n + 1) = ln((1 + chi)/(1 + chi u))/chi.
    u: Any = brentq(
        lambda u: (1.0 - u) - n * u / (n + 1.0) - (np.log1p(chi) - np.log1p(chi * u)) / chi, 0.0, 1.0, xtol=1e-15
    )
    depth = (n * mass * speed**2 * u / (chi * stiffness)) ** (1.0 / (n + 1.0))
    return stiffness * depth**n * (1.0 + chi * u)


class Simulated:
    """Runs scenes that were accepted: those of one degree of freedom always, others until their share is used up.

    Every structure of a scene compiles its own program, which is not what is tested here.
    """

    def __init__(self, others: int) -> None:
        self.left = collections.Counter({kind: others for kind in ("oblique_impact", "backlash", "chain", "mechanism")})
        self.left |= collections.Counter(impact=10**9, bounce=10**9)
        self.runs = 0
        self.compared = 0

    def __call__(self, given: Any) -> str:
        """What is wrong with the run of a scene that was accepted; "" for nothing."""
        kind = given.scene.kind
        if self.left[kind] <= 0 or len(given.times) > 200_000:
            return ""
        self.left[kind] -= 1
        from bcfj_jax import simulate

        run = simulate(
            given.scene, given.params, given.times, accuracy=given.accuracy, max_steps=min(given.max_steps, 20_000),
            solver=given.solver,
        )  # fmt: skip
        self.runs += 1
        forces = [force for force in run.force.values() if force.size]
        finite = all(np.isfinite(force).all() for force in forces)
        if run.status == "ok" and not finite:
            return f"ok with forces that are not finite, {given.resolved}"
        if run.status != "ok" and not run.reason:
            return f"failed without a reason, {given.resolved}"
        return self._compare(given, run) if kind == "impact" and run.status == "ok" else ""

    def _compare(self, given: Any, run: Any) -> str:
        """The highest force of an impact by the default law beside the closed form's."""
        options = given.resolved["scene"]
        if options.get("law") != "memory_free" or options.get("elastic", "power") != "power":
            return ""
        p = {name: float(value) for name, value in given.params.items()}
        if not p["approach_speed"] > 0.0:
            return ""
        expected = closed_peak(p["mass"], p["approach_speed"], p["stiffness"], p["exponent"], p["damping"])
        depth = (expected / p["stiffness"]) ** (1.0 / p["exponent"])
        start = p["clearance_contact"] / p["approach_speed"]
        contact = depth / p["approach_speed"]
        over = float(given.times[-1]) > start + 4.0 * contact
        fine = (given.times[1] - given.times[0]) < 0.02 * contact
        # A regularised contact, and a law that jumps at first touch, have another peak.
        plain = p.get("smoothing", 0.0) < 1e-3 * depth and p["damping"] * p["approach_speed"] < 10.0
        if not (over and fine and plain and np.isfinite(expected)):
            return ""
        self.compared += 1
        found = float(np.max(run.force["contact"][:, 0]))
        share = given.accuracy if isinstance(given.accuracy, float) else 0.05
        return (
            "" if abs(found / expected - 1.0) <= 0.02 + share else f"peak {found:g} N, closed form {expected:g} N, {p}"
        )


def good_scenes() -> list[str]:
    """Texts of scene files that load."""
    from bcfj_jax.io.scenetemplate import template

    others = ("bounce", "oblique_impact", "backlash", "chain", "slider_crank", "joint", "mechanism")
    kinds = (*("impact",) * 3, *others)
    return [template(kind) for kind in kinds] + [(ROOT / "examples/chung_ooi_test1.toml").read_text()]


STUDIES = (
    """scene = "impact"
[design]
kind = "grid"
[vary.stiffness]
lower = 1e9
upper = 1e11
steps = 4
scale = "log"
[vary.clearance_contact]
values = ["1 um", "2 um"]
[results]
features = ["contact.peak", "contact.impulse"]
derivatives = ["stiffness"]
""",
    """scene = { scene = { kind = "bounce" }, time = { end = "0.2 s", samples = 501 } }
[design]
kind = "latin_hypercube"
points = 16
seed = 3
[vary.drop_height]
lower = "1 mm"
upper = "5 cm"
[vary.damping]
lower = "0.01 s/m"
upper = "0.5 s/m"
[results]
histories = true
""",
    """scene = "joint"
[design]
kind = "sobol"
points = 32
[vary.clearance_seat_cage]
lower = "10 um"
upper = "200 um"
[results]
features = ["seat_cage.peak", "seat_ball.peak"]
""",
)


class Target(NamedTuple):
    """A kind of file.

    Attributes:
        good: contents that are read without a fault.
        mutate: how one is damaged.
        suffix: of the damaged file's name.
        read: how it is read.
        then: what is done with what was accepted; a text says what is wrong with that.
        count: number of cases; of ``wholes`` at most.
        wholes: contents each of whose values is changed in turn, in place of ``good`` and ``mutate``.
    """

    good: list[bytes]
    mutate: Callable[[np.random.Generator, bytes], bytes]
    suffix: str
    read: Callable[[Path], Any]
    then: Callable[[Any], str]
    count: int
    wholes: tuple[Any, ...] = ()


def nothing(found: Any) -> str:
    """What was accepted is not looked at."""
    del found
    return ""


def damaged_record(rng: np.random.Generator, good: bytes) -> bytes:
    """A few bytes; of a text every other time a few of its lines."""
    return of_lines(rng, good.decode()) if good.isascii() and rng.random() < 0.5 else of_bytes(rng, good)


def targets(count: int, folder: Path) -> dict[str, Target]:
    """Every kind of file; ``count`` cases of TOML files, a quarter of that of each format of data."""
    from bcfj_jax.analysis.designs import designfile
    from bcfj_jax.analysis.studies import specification
    from bcfj_jax.io import scenefile
    from calibration import problemfile

    def drawn(study: Any) -> str:
        if study.count < 100_000 and not np.isfinite(study.points).all():
            return "points that are not finite"
        return ""

    def fitted(file: Path) -> Any:
        problem = folder / f"of_{file.name}.toml"
        problem.write_text(records.problem(file.name))
        return problemfile.load(problem)

    problems = [(ROOT / "examples" / name).read_text() for name in ("chung_ooi_fit.toml", "joint_fit.toml")]
    two_models = '[[model]]\nname = "Hertz"\nparameters = { exponent = 1.5 }\n[free]'
    problems.append(problems[0].replace("[free]", two_models))
    files = {
        "scene": (good_scenes(), scenefile.load, Simulated(count // 100)),
        "calibration": (problems, problemfile.load, nothing),
        "study": (list(STUDIES), specification.load, drawn),
    }
    found = {
        name: Target([text.encode() for text in good], of_toml, ".toml", read, then, count)
        for name, (good, read, then) in files.items()
    }
    (folder / "whole.csv").write_bytes(records.FORMATS[".csv"]())
    for name, whole, read in (
        ("scene values", wholes.MECHANISM, scenefile.load),
        ("calibration values", wholes.CALIBRATION, problemfile.load),
        ("study values", wholes.STUDY, specification.load),
        ("design values", wholes.DESIGN, lambda file: designfile.load(str(file), {})),
    ):
        found[name] = Target([whole.encode()], of_toml, ".toml", read, nothing, 2 * count, (tomllib.loads(whole),))
    for suffix, write in records.FORMATS.items():
        found[suffix] = Target([write()], damaged_record, suffix, fitted, nothing, count // 4)
    for name, make in kept.KINDS.items():
        place = folder / name
        place.mkdir()
        work = make(place)
        found[name] = Target([work.content], of_bytes, ".kept", work.read, work.then, count // 4)
    return found


def cases(name: str, how: Target, folder: Path, seed: int) -> Iterator[tuple[int, Case]]:
    """The cases of one kind of file, one after the other; each can be made again from the seed and its number."""
    file = folder / f"{name.strip('.').replace(' ', '_')}_case{how.suffix}"
    if how.wholes:
        every = [one for whole in how.wholes for one in of_nodes(whole)]
        chosen = np.random.default_rng(seed).permutation(len(every))[: how.count]
        for k in sorted(chosen.tolist()):
            yield k, run_case(how.read, how.then, file, tomli_w.dumps(every[k][1]).encode())
        return
    for k in range(how.count):
        rng = np.random.default_rng([seed, k, len(name)])
        yield k, run_case(how.read, how.then, file, how.mutate(rng, how.good[k % len(how.good)]))


def one_kind(target: str, how: Target, folder: Path, seed: int) -> dict[str, Any]:
    """Run the cases of one kind; each fault is said once. What is kept of them."""
    ended: collections.Counter[str] = collections.Counter()
    slowest, said = 0.0, set()
    for k, case in cases(target, how, folder, seed):
        ended[case.outcome] += 1
        slowest = max(slowest, case.seconds)
        key = (case.outcome, case.detail.strip().splitlines()[-1][:80] if case.detail.strip() else "")
        if case.outcome not in ("accepted", "refused") and key not in said:
            said.add(key)
            print(f"--- {target} case {k} (seed {seed}): {case.outcome}\n{case.detail}", file=sys.stderr, flush=True)
    bad = {outcome: n for outcome, n in ended.items() if outcome not in ("accepted", "refused")}
    # With that of the processes that read files in this one's stead.
    memory = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {
        "cases": sum(ended.values()), "accepted": ended["accepted"], "refused": ended["refused"], "faults": sum(bad.values()),
        "of": bad, "slowest to read [s]": round(slowest, 3), "simulated": getattr(how.then, "runs", 0),
        "compared": getattr(how.then, "compared", 0), "highest memory [GB]": round(memory / 1024**2, 3),
    }  # fmt: skip


def keep(target: str, row: dict[str, Any], seed: int) -> None:
    """Put one kind's row among those kept before, each with its seed."""
    rows = known("fuzz").get("rows", {}) | {target: {"seed": seed, **row}}
    save("fuzz", {"rows": rows})
    publish("fuzz", table(rows), "docs/trust.md")


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Kinds of files and what became of them, as a table in Markdown."""
    counts = (
        "cases",
        "accepted",
        "refused",
        "faults",
        "slowest to read [s]",
        "simulated",
        "compared",
        "highest memory [GB]",
    )
    columns = {"files": "{kind}", **{name: lambda row, name=name: row[name] for name in counts}}
    return harness.table(columns, ({"kind": kind, **row} for kind, row in rows.items()))


def main() -> int:
    """Run the cases, print the table, say every fault once; whether there are any."""
    keeping = (False, "keep the rows in benchmarks/results/fuzz.json")
    given = options(__doc__, cases=2000, only="", seed=0, keep=keeping)
    import bcfj_jax as bj

    bj.use_cache()
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in (ROOT / "examples").iterdir():
            shutil.copy(path, folder)
        for target, how in targets(given.cases, folder).items():
            if given.only and target not in given.only.split(","):
                continue
            found[target] = one_kind(target, how, folder, given.seed)
            if given.keep:
                keep(target, found[target], given.seed)
    print(table(found))
    return int(any(row["faults"] for row in found.values()))


if __name__ == "__main__":
    sys.exit(main())
