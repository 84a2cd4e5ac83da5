"""The demo's fit for ten seeds beside theory; keeps the result, the README's table and its picture.

python -m benchmarks.calibration.demo
"""

from __future__ import annotations

import statistics
from typing import Any

import calibration
from bcfj_jax.io.units import format_si
from benchmarks.common import IMAGES, ROOT, load, markdown, publish, save, tally
from calibration.report import plots

SEEDS = range(10)
THEORY = {"stiffness": 4 / 3 * 48e9 / (2 * (1 - 0.2**2)) * (10e-3 / 2) ** 0.5, "exponent": 1.5}


def table(result: dict[str, Any]) -> str:
    rows = [["", "fitted", "95 % interval", "Hertz", "spread over ten seeds"]]
    units = {"stiffness": "N/m^n", "exponent": "1", "force": "N"}
    depth = format_si(result["depth"], "m", 3)
    names = {"force": f"force at {depth}", "exponent": "exponent n", "stiffness": "stiffness K"}
    for key in names:
        row = result["rows"][key]
        ends = " to ".join(format_si(v, units[key], 4) for v in row["ci95"]) if row["ci95"] else ""
        cells = [format_si(row["value"], units[key], 5), ends, format_si(row["theory"], units[key], 5)]
        rows.append([names[key], *cells, f"{row['spread']:.0e}"])
    verdicts = ", ".join(f"{verdict} ({count} of 10)" for verdict, count in result["verdicts"].items())
    return f"{markdown(rows)}\n\nVerdict: {verdicts}."


def main() -> None:
    problem = calibration.load(ROOT / "examples" / "chung_ooi_fit.toml")
    fits = [calibration.fit(problem, seed=seed) for seed in SEEDS]
    first, rows = fits[0], {}
    for name, theory in THEORY.items():
        values = [fit.parameters[name].value for fit in fits]
        spread = (max(values) - min(values)) / statistics.mean(values)
        rows[name] = {"value": values[0], "ci95": first.parameters[name].ci95, "theory": theory, "spread": spread}
    told = first.reference
    assert told is not None
    forces, theory = [fit.force_at(told.penetration) for fit in fits], THEORY["stiffness"] * told.penetration**1.5
    spread = (max(forces) - min(forces)) / theory
    rows["force"] = {"value": told.value, "ci95": told.ci95, "theory": theory, "spread": spread}
    save("demo", {"rows": rows, "depth": told.penetration, "verdicts": tally(fit.verdict for fit in fits)})
    publish("demo", table(load("demo")))
    plots.records(first, problem, IMAGES / "demo_fit.png")


if __name__ == "__main__":
    main()
