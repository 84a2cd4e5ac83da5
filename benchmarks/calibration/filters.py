"""Records behind a low-pass: does a verdict that is sure hold the truth, whether the filter is stated or not?

One contact by SciPy, behind a Butterworth or Bessel filter of order 1 to 8, causal or run forwards and backwards, made by
``scipy.signal`` at a higher rate, with a cut-off between 0.5 and 20 times the contact's own frequency 1/(2 T); then noise.
The problem file says nothing of it, its kind, or its kind and cut-off, in turn. False is a verdict ``identified`` or
``adequate`` with a printed interval of a coefficient or the reference force that excludes the truth.

    python -m benchmarks.calibration.filters [--records 200] [--first 0] [--minutes 5] [--stated nothing]

adds to results/filters.json: a record that is run again replaces its row.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from bcfj_jax import InputError
from benchmarks.clock import until
from benchmarks.common import known, options, save, tally
from benchmarks.references import impact
from calibration import Fit, fit
from calibration.problemfile import load

TRUTH = {"stiffness": 5e6, "exponent": 1.4, "damping": 0.2}
MASS, SPEED, SAMPLES, FINER = 0.6, 0.9, 300, 16
STATED = ("nothing", "kind", "kind and cut-off")
FILE = """scene = "impact"
{filter}
[[experiment]]
file = "run.csv"
time = "time [s]"
observe = {{ "contact.normal" = "force [N]" }}
align = "onset"
noise = "estimate"
parameters = {{ mass = "{mass} kg", approach_speed = "{speed} m/s" }}
[free]
stiffness = [1e5, 3e8]
exponent = [1.0, 2.5]
damping = [0.01, 3.0]
"""


EXACT = impact.contact(TRUTH, MASS, SPEED)


def record(seed: int) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Times (T,), readings (T,) and what the filter was."""
    rng = np.random.default_rng(seed)
    duration = EXACT.end
    step = 4.5 * duration / SAMPLES
    fine = -1.5 * duration + step / FINER * np.arange(SAMPLES * FINER) + step * rng.uniform()
    ratio = float(np.exp(rng.uniform(np.log(0.5), np.log(20.0))))
    what = {
        "kind": str(rng.choice(["butterworth", "bessel"])), "order": int(rng.integers(1, 9)),
        "zero_phase": bool(rng.integers(2)), "cutoff": ratio / (2.0 * duration),
    }  # fmt: skip
    if what["kind"] == "butterworth":
        sections = signal.butter(what["order"], what["cutoff"], fs=FINER / step, output="sos")
    else:
        sections = signal.bessel(what["order"], what["cutoff"], fs=FINER / step, output="sos", norm="mag")
    run = signal.sosfiltfilt if what["zero_phase"] else signal.sosfilt
    smooth = np.asarray(run(sections, EXACT.force(fine)))[::FINER]
    noise = float(rng.choice([0.003, 0.01, 0.03]))
    read = smooth + noise * smooth.max() * rng.standard_normal(smooth.size)
    return fine[::FINER] - fine[0], read, what | {"ratio": ratio, "noise": noise}


def stated(what: dict[str, Any], how: str) -> str:
    """The line of the problem file."""
    if how == "nothing":
        return ""
    cutoff = f', cutoff = "{what["cutoff"]:.6g} Hz"' if how == STATED[2] else ""
    back = str(what["zero_phase"]).lower()
    return f'filter = {{ kind = "{what["kind"]}", order = {what["order"]}, zero_phase = {back}{cutoff} }}'


def missed(found: Fit) -> list[str]:
    """What printed intervals exclude."""
    wrong = [n for n, true in TRUTH.items() if (e := found.parameters[n].ci95) and not e[0] <= true <= e[1]]
    at = found.reference
    if at and at.ci95:
        true = TRUTH["stiffness"] * at.penetration ** TRUTH["exponent"]
        wrong += [] if at.ci95[0] <= true <= at.ci95[1] else ["reference force"]
    return wrong


def one(seed: int, folder: Path, how: str) -> dict[str, Any]:
    """A row: the filter, what was stated, the verdict, and what it gets wrong."""
    times, read, what = record(seed)
    table = np.stack([times, read], axis=1)
    np.savetxt(folder / "run.csv", table, "%.9g", ",", header="time [s],force [N]", comments="")
    (folder / "run.toml").write_text(FILE.format(filter=stated(what, how), mass=MASS, speed=SPEED))
    row = {"seed": seed, **what, "stated": how}
    try:
        found = fit(load(folder / "run.toml"), seed=seed)
    except InputError as error:
        return row | {"verdict": "refused", "wrong": [], "why": str(error)[:200]}
    values = {name: found.parameters[name].value for name in TRUTH}
    sure = found.verdict in ("identified", "adequate")
    because = found.reasons[0][:160] if found.reasons else ""
    return row | {
        "verdict": found.verdict, "wrong": missed(found) if sure else [], "values": values, "because": because
    }  # fmt: skip


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """By what was stated: verdicts, sure ones and false ones."""
    found = {}
    for how in dict.fromkeys(r["stated"] for r in rows):
        own = [r for r in rows if r["stated"] == how]

        sure = [r for r in own if r["verdict"] in ("identified", "adequate")]
        found[how] = {
            "records": len(own), "sure": len(sure), "false": sum(bool(r["wrong"]) for r in sure),
            "verdicts": tally(r["verdict"] for r in own),
        }  # fmt: skip
    return found


def main() -> None:
    first = (0, "seed of the first record")
    given = options(__doc__, records=200, first=first, minutes=5.0, stated=list(STATED))
    before = known("filters") or {"seconds": 0.0, "rows": []}
    rows, begin = {(row["seed"], row["stated"]): row for row in before["rows"]}, time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for seed in until(given.minutes, range(given.first, given.first + given.records)):
            how = given.stated[seed % len(given.stated)]
            rows[seed, how] = one(seed, Path(folder), how)
            print({k: v for k, v in rows[seed, how].items() if k != "values"}, flush=True)
            seconds, every = before["seconds"] + time.perf_counter() - begin, list(rows.values())
            save("filters", {"seconds": seconds, "summary": summary(every), "rows": every})
    print(summary(list(rows.values())))


if __name__ == "__main__":
    main()
