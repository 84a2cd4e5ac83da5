"""``bcfj calibrate``: a problem file in, a folder of results and an exit code out."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from bcfj_jax import outputs, report, scenefile
from bcfj_jax.units import format_si
from calibration import plots
from calibration.fit import AllStartsFailed, Fit, Parameter, fit
from calibration.problem import Problem
from calibration.problemfile import load, sources

DONE, FAILED, NOT_IDENTIFIED = 0, 3, 4
FILES = (
    "fit.json", "fitted_scene.toml", "fit.png", "force_penetration.png", "starts.png", "report.html", "run.toml",
    "environment.json",
)  # fmt: skip


def run(path: Path, out: Path | None, seed: int, starts: int) -> int:
    """Calibrate a problem file; write the results; return the exit code of the contract.

    Raises:
        InputError: for bad input, before anything is written.
    """
    problem = load(path)
    folder = outputs.open_folder(out, "calibrate", Path(path).stem, FILES)
    begin = time.perf_counter()
    try:
        result = fit(problem, seed=seed, starts=starts)
    except AllStartsFailed as error:
        print(f"error: {path}: {error}", file=sys.stderr)
        return FAILED
    seconds = time.perf_counter() - begin
    _write(folder, Path(path), problem, result, seconds)
    print(text(result))
    print(f"\nresults and pictures (fit.png, force_penetration.png, starts.png, report.html): {folder}")
    return DONE if result.verdict == "identified" else NOT_IDENTIFIED


def text(result: Fit) -> str:
    """The fit in words: verdict, reasons, then a line a parameter."""
    lines = [f"verdict: {result.verdict}", *(f"  - {reason}" for reason in result.reasons)]
    lines += ["", report.text([["parameter", "value", "95 % interval", "remark"], *_rows(result)])]
    if result.reference:
        lines += [
            "",
            f"force at {format_si(result.reference.penetration, 'm')}: {_interval(result.reference, 'N')}"
            " (the power law where the data are; the stiffness is derived from it)",
        ]
    lines += [
        "",
        f"residual: {format_si(result.residual['rms_force'], 'N')} rms over {result.residual['samples']} samples",
    ]
    for name, errors in (result.held_out or {}).items():
        worst, rms = errors["max_error_of_peak"], errors["rms_error_of_peak"]
        lines.append(f"held out, {name}: at most {worst:.2%} of the peak, {rms:.2%} rms")
    return "\n".join(lines)


def _interval(thing: Any, unit: str) -> str:
    value = thing.force if hasattr(thing, "force") else thing.value
    ends = f", 95 % {format_si(thing.ci95[0], unit)} to {format_si(thing.ci95[1], unit)}" if thing.ci95 else ""
    return format_si(value, unit) + ends


def _rows(result: Fit) -> list[list[str]]:
    rows = []
    for name, p in result.parameters.items():
        ends = f"{format_si(p.ci95[0], p.unit)} to {format_si(p.ci95[1], p.unit)}" if p.ci95 else "none"
        rows.append([name, format_si(p.value, p.unit), ends, _remark(p)])
    return rows


def _remark(p: Parameter) -> str:
    remarks = [p.kind] if p.kind != "fitted" else []
    remarks += [f"at its {p.at_bound} bound"] if p.at_bound else []
    remarks += [] if p.identifiable else ["not determined by the data"]
    return ", ".join(remarks)


def as_json(result: Fit) -> dict[str, Any]:
    """``fit.json`` of the contract."""
    reference = result.reference
    return {
        "verdict": result.verdict,
        "reasons": result.reasons,
        "parameters": {
            name: {
                "value": p.value,
                "unit": p.unit,
                "ci95": p.ci95,
                "identifiable": p.identifiable,
                "at_bound": p.at_bound or None,
                "kind": p.kind,
            }
            for name, p in result.parameters.items()
        },
        "reference": None
        if reference is None
        else {"penetration": reference.penetration, "force": reference.force, "ci95": reference.ci95},
        "tests": [
            {"name": t.name, "value": float(t.value), "threshold": float(t.threshold), "passed": bool(t.passed)}
            for t in result.tests
        ],
        "starts": result.starts,
        "residual": result.residual,
        "held_out": result.held_out,
        "correlation": None
        if result.correlation is None
        else {"labels": list(result.labels), "matrix": result.correlation},
        "seed": result.seed,
    }


def _write(folder: Path, path: Path, problem: Problem, result: Fit, seconds: float) -> None:
    outputs.write_json(folder / "fit.json", {**as_json(result), "wall_s": seconds})
    plots.records(result, problem, folder / "fit.png")
    plots.force_penetration(result, problem, folder / "force_penetration.png")
    plots.starts(result, folder / "starts.png")
    _write_scene(folder / "fitted_scene.toml", path, problem, result)
    outputs.write_toml(
        folder / "run.toml", _resolved(path, problem, result), f"resolved input of bcfj calibrate {path.name}"
    )
    data = sources(path)
    outputs.write_json(folder / "environment.json", outputs.environment(seed=result.seed, data=data))
    tables = [
        ("Parameters", [["parameter", "value", "95 % interval", "remark"], *_rows(result)]),
        ("Tests", [["test", "value", "limit", "passed"], *[_test_row(t) for t in result.tests]]),
    ]
    if result.held_out:
        rows = [
            [n, f"{e['max_error_of_peak']:.2%}", f"{e['rms_error_of_peak']:.2%}"] for n, e in result.held_out.items()
        ]
        tables.append(("Held out", [["record", "largest error of the peak", "rms of the peak"], *rows]))
    pictures = [folder / name for name in FILES if name.endswith(".png")]
    report.write(folder, f"Calibration of {path.name}", result.verdict, tables, pictures, result.reasons)


def _test_row(t: Any) -> list[str]:
    return [t.name, f"{t.value:.4g}", f"{t.threshold:.4g}", "yes" if t.passed else "NO"]


def _write_scene(target: Path, path: Path, problem: Problem, result: Fit) -> None:
    """A scene file with the fitted shared values, ready for ``bcfj simulate``."""
    resolved = _base(path, problem).resolved
    fitted = {n: v for n, v in result.values.items() if n in resolved["parameters"]}
    content = {**resolved, "parameters": {**resolved["parameters"], **fitted}}
    outputs.write_toml(target, content, f"fitted by bcfj calibrate {path.name}; verdict: {result.verdict}")


def _base(path: Path, problem: Problem) -> scenefile.SceneFile:
    from bcfj_jax import tables

    named = tables.read(path)["scene"]
    return scenefile.load(path.parent / named if str(named).endswith(".toml") else named)


def _resolved(path: Path, problem: Problem, result: Fit) -> dict[str, Any]:
    """The problem with every default, SI: what ``run.toml`` gets."""
    return {
        "problem": str(path),
        "seed": result.seed,
        "starts": len(result.starts),
        "scene": _base(path, problem).resolved,
        "experiment": [
            {
                "name": e.name,
                "source": e.source,
                "hold_out": e.hold_out,
                "samples": int(e.times.size),
                "parameters": e.fixed,
                "noise": {c.observes: "estimate" if c.sigma is None else c.sigma for c in e.channels},
            }
            for e in problem.experiments
        ],
        "free": {
            f.name: {
                "lower": f.lower,
                "upper": f.upper,
                "scale": "log" if f.log else "linear",
                "each": f.per_experiment,
                **({} if f.start is None else {"start": f.start}),
            }
            for f in problem.free
        },
    }
