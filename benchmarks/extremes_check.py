"""Cases of the box that ended well, against an independent solver: is the force error what "balanced" promises?

SciPy (DOP853, Radau where a law is stiff) with NumPy's own laws, in units of the impact, from the onset of each contact
to its end; flights are closed forms. Of an impact the whole history counts, of a bounce the first contacts.

    python benchmarks/extremes_check.py [--cases N]    after extremes.py; adds to benchmarks/results/extremes.json
"""

from __future__ import annotations

import argparse
import json
import os
import random
import warnings
from typing import Any, NamedTuple

os.environ.setdefault("EQX_ON_ERROR", "nan")

import jax
import numpy as np
from _common import ROOT, load, save
from extremes import ACCURACY, GRAVITY, KEPT
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import gamma

import bcfj_jax as bj

PROMISED, CONTACTS, SAMPLES = 1e-2, 3, 301


class Case(NamedTuple):
    """Numbers of a mass on a surface in NumPy: law by name, p its parameters, w the onset's half-width."""

    law: str
    p: dict[str, float]

    @property
    def n(self) -> float:
        """Exponent."""
        return self.p.get("exponent", 1.0)

    @property
    def w(self) -> float:
        """Half-width of the onset [m]."""
        return self.p["smoothing"]

    def onset(self, d: float) -> tuple[float, float]:
        """Smoothed depth [m] and its slope."""
        if self.w <= 0:
            return max(d, 0.0), float(d > 0)
        s = min(max((d + self.w) / (2 * self.w), 0.0), 1.0)
        return (d if d >= self.w else 2 * self.w * s**4 * (2.5 - 3 * s + s * s)), s**3 * (10 - 15 * s + 6 * s * s)

    def damping(self, approach: float) -> float:
        """a of f(d) (1 + a d')."""
        if self.law == "memory_free":
            return self.p["damping"]
        if self.law not in ("exact", "flores"):
            return 0.0
        e = max(self.p["restitution"], 1e-3)
        if self.law == "flores":
            return 1.6 * (1 - e) / e / max(approach, 1e-9)
        if 1 - e < 1e-6:
            return 1.5 * (1 - e) / max(approach, 1e-9)
        low, high = max(1e-9, 0.5 * (1 - e)), (1 + 1e-12) / e
        chi: Any = brentq(lambda c: c * e - 1 + (1 + c) * np.exp(-c * (1 + e)), low, high, xtol=1e-15)
        return float(chi) / max(approach, 1e-9)

    def force(self, d: float, rate: float, a: float) -> float:
        """Normal force [N]; a from ``damping``."""
        r, slope = self.onset(d)
        if r <= 0:
            return 0.0
        elastic = self.p["stiffness"] * r**self.n
        if self.law == "kelvin_voigt":
            return slope * max(0.0, elastic + self.p["dashpot"] * rate)
        if self.law == "adams_impact":
            s = min(r / self.p["damping_depth"], 1.0)
            return slope * max(0.0, elastic + self.p["dashpot"] * s * s * (3 - 2 * s) * rate)
        return slope * elastic * max(0.0, 1 + a * rate)

    def depth(self, d: float, speed: float) -> float:
        """Depth at which all energy is stored [m]."""
        k, n = self.p["stiffness"], self.n
        energy = 0.5 * self.p["mass"] * speed**2 + k * self.onset(d)[0] ** (n + 1) / (n + 1)
        return ((n + 1) * energy / k) ** (1 / (n + 1))


class Touch(NamedTuple):
    """One contact: start and natural time [s], its force (times), end and state there; instants that resolve it."""

    start: float
    unit: float
    force: Any
    end: float
    place: float
    rate: float
    instants: np.ndarray


def contact(case: Case, start: float, d: float, rate: float, approach: float, gravity: float) -> Touch | None:
    """From depth d [m] and rate [m/s] until the surfaces part, or five natural durations."""
    mass, a = case.p["mass"], case.damping(approach)
    depth = case.depth(d, rate)
    speed = np.sqrt(2 * case.p["stiffness"] * depth ** (case.n + 1) / (case.n + 1) / mass)
    unit, q = depth / speed, 1 / (case.n + 1)
    duration = 2 * np.sqrt(np.pi) * gamma(1 + q) / gamma(0.5 + q) + 4 * case.w / depth

    def motion(_: float, y: Any) -> tuple[float, float]:
        pull = case.force(y[0] * depth, y[1] * speed, a) / mass
        return y[1], (gravity - pull) * unit / speed

    def apart(_: float, y: Any) -> float:
        return y[0] + case.w / depth

    apart.terminal, apart.direction = True, -1
    loss = a * speed + (case.p.get("dashpot", 0.0) * unit / mass)
    begin = (d / depth if d > -case.w else -case.w / depth * (1 - 1e-13) + 1e-18, rate / speed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = solve_ivp(
            motion, (0.0, 2 * duration), begin, "Radau" if loss > 30 else "DOP853",
            rtol=1e-9 if loss > 30 else 1e-11, atol=1e-13, events=apart, dense_output=True,
        )  # fmt: skip
    if not run.success:
        return None

    def force(t: np.ndarray) -> np.ndarray:
        x = (t - start) / unit
        inside = (x >= 0) & (x <= run.t[-1])
        y = run.sol(np.clip(x, 0, run.t[-1]))
        found = [case.force(u * depth, v * speed, a) for u, v in y.T]
        return np.where(inside, found, 0.0)

    steps = np.interp(np.linspace(0, run.t.size - 1, SAMPLES), np.arange(run.t.size), run.t)
    end, place, rate = start + run.t[-1] * unit, run.y[0, -1] * depth, run.y[1, -1] * speed
    return Touch(start, unit, force, end, place, rate, start + steps * unit)


def touches(kind: str, case: Case) -> list[Touch]:
    """The first contacts of a case; empty where there is none."""
    p = case.p
    if kind == "impact":
        gap, speed = p["clearance_contact"], p["approach_speed"]
        if speed <= 0 and (gap > case.w or case.onset(-gap)[0] <= 0):
            return []
        free = max(gap - case.w, 0.0)
        one = contact(case, free / speed if free else 0.0, -min(gap, case.w), speed, speed, 0.0)
        return [one] if one else []
    height, found = p["drop_height"], []
    sag = (p["mass"] * GRAVITY / p["stiffness"]) ** (1 / case.n)
    free = max(height - case.w, 0.0)
    now, d, rate = np.sqrt(2 * free / GRAVITY), -min(height, case.w), np.sqrt(2 * GRAVITY * free)
    # What is remembered at the start is forgotten in the first fall.
    fall = np.sqrt(2 * GRAVITY * height)
    left = np.exp(-20 * GRAVITY * now / fall) if fall > 0 else 1.0
    first = fall + (np.sqrt(2 * GRAVITY * (height + sag)) - fall) * left
    for _ in range(CONTACTS):
        # A whole flight forgets the last touch.
        known = np.sqrt(rate**2 + 2 * GRAVITY * case.w) if found else first
        one = contact(case, float(now), d, rate, known, GRAVITY)
        if one is None:
            return []
        found.append(one)
        # What does not part, or flies less than ten contacts, is not a bounce any more.
        flight = -2 * one.rate / GRAVITY
        if flight < 10 * (one.end - one.start):
            break
        now, d, rate = one.end + flight, -case.w, -one.rate
    return found


def compare(kind: str, law: str, row: dict[str, Any]) -> dict[str, float] | None:
    """Errors of a case in fractions of each contact's peak; None where nothing touches or the reference failed."""
    scene = bj.scenes.make(kind, law=law)
    params = scene.parameters({name: row[name] for name in row if name in scene.quantities})
    case = Case(law, {name: float(value) for name, value in params.items()})
    found = touches(kind, case)
    if not found:
        return None
    times, which = [], []
    for k, one in enumerate(found):
        last = one.end - one.start
        # A rebound within the promise shifts the next contact by many of its durations.
        room = 0.3 * (one.start - found[k - 1].end) / last if k else 0.0
        margin = min(50.0, room)
        if k == 0:
            times.append(one.instants)
        else:
            times.append(np.linspace(one.start - margin * last, one.start + (1.1 + margin) * last, 10 * SAMPLES))
        which.append(np.full(times[-1].size, k))
    while len(times) < (CONTACTS if kind == "bounce" else 1):
        # One program for all: what is over is followed by a little nothing.
        end = times[-1][-1]
        times.append(end * (1 + 1e-9 * np.arange(1, 10 * SAMPLES + 1)))
        which.append(np.full(10 * SAMPLES, -1))
    clock, which = np.concatenate(times), np.concatenate(which)
    if np.any(np.diff(clock) <= 0):
        return None
    run = bj.simulate(scene, params, clock, accuracy=ACCURACY, max_steps=20_000)
    if run.status != "ok":
        return {"failed": 1.0}
    errors: dict[str, float] = {"peak": 0.0, "impulse": 0.0}
    for k, one in enumerate(found):
        t, got = clock[which == k], run.force["contact"][which == k, 0]
        # At the same instants where there is no doubt about the time of the touch, so that sampling is no error.
        if k == 0:
            # A law that jumps does so at the first instant, on either side of rounding.
            t, got = t[1:], got[1:]
        fine = np.linspace(one.start, one.end, 1001) if k else t
        exact = one.force(fine)
        peak, impulse = exact.max(), np.trapezoid(exact, fine)
        if k == 0:
            gap = got - exact
            errors |= {"history": float(np.max(np.abs(gap)) / peak), "rms": float(np.sqrt(np.mean(gap**2)) / peak)}
        errors["peak"] = max(errors["peak"], abs(got.max() / peak - 1))
        errors["impulse"] = max(errors["impulse"], abs(np.trapezoid(got, t) / impulse - 1))
    return {**errors, "contacts": len(found), "rounding": float(found[0].start * 2.2e-16 / found[0].unit)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # pyright: ignore[reportOptionalMemberAccess]
    parser.add_argument("--cases", type=int, default=110, help="cases of a scene")
    count = parser.parse_args().cases
    jax.config.update("jax_compilation_cache_dir", str(ROOT / "build" / "jax-cache"))
    results = load("extremes")["scenes"]
    for kind in ("impact", "bounce"):
        rows = []
        for path in sorted(KEPT.glob(f"{kind}-*-sobol-*.jsonl")):
            law = path.name.split("-")[1]
            rows += [(law, json.loads(line)) for line in path.read_text().splitlines()]
        ok = [(law, row) for law, row in rows if row["class"] == "ok"]
        random.Random(0).shuffle(ok)
        checked = []
        for law, row in ok:
            found = compare(kind, law, row)
            if found is not None:
                checked.append({"law": law, **row, **found})
            if len(checked) == count:
                break
        (KEPT / f"check-{kind}.json").write_text(json.dumps(checked, indent=1))
        good = [row for row in checked if "failed" not in row]
        within = [row for row in good if max(row["peak"], row["rms"]) <= PROMISED]
        worst = {key: float(max(row[key] for row in good)) for key in ("peak", "rms", "history", "impulse")}
        results[kind]["checked"] = {"cases": len(checked), "ended": len(good), "within": len(within), "worst": worst}
        save("extremes", {"scenes": results})
        print(kind, json.dumps(results[kind]["checked"]), flush=True)


if __name__ == "__main__":
    main()
