"""The paper's claims about clearance (4.2.2) as two studies of the joint, and where the model disagrees.

    python -m benchmarks.analysis.clearance [--points 24] [--workers 2]
writes results/clearance.json, docs/images/clearance.png and the table in docs/studies.md.

Claims (Machines 2023, 11(4), 466; the reference-load table of physics.md): the residual oscillation grows with
clearance; that of the axial component is less than the normal one's (1.68 against 12.42 kN at the seat and cage); that
of ball and groove is less than that of cage and seat; larger clearances give fewer, higher impacts. An oscillation is
the amplitude of what a polynomial of order 9 leaves, normal from 1.18 to 1.82 s, axial from 1.52 to 2.75 s. Nothing
here was fitted to the paper, and most of the joint's numbers are guesses (docs/joint.md): signs and orders count.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr

import bcfj_jax as bj
import benchmarks.common as harness
from bcfj_jax.analysis.features import residual_oscillation
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import ROOT, drawing, options, publish, save

NORMAL, AXIAL = (1.18, 1.82), (1.52, 2.75)
LOW, HIGH, SAMPLES = 1e-6, 2e-4, 3001
PILOTS = ("seat_cage", "head_cage")
# Of the study of all clearances: times the default numbers.
LEAST, MOST = 0.02, 4.0


def studied(points: int, workers: int, every: bool, folder: Path) -> dict[str, Any]:
    """Normal and axial oscillation [N] by contact (N,), the worst member's, against clearance [m]."""
    scene = bj.scenes.joint_of_keys(**PLAIN)
    default = {name: float(x) for name, x in scene.parameters().items() if name.startswith("clearance")}
    if every:
        factors = np.geomspace(LEAST, MOST, points)
        vary = {name: {"values": (factors * value).tolist()} for name, value in default.items()}
        clearance = factors * default["clearance_seat_cage"]
    else:
        clearance = np.geomspace(LOW, HIGH, points)
        vary = {f"clearance_{name}": {"values": clearance.tolist()} for name in PILOTS}
    table = {
        "scene": {"scene": {"kind": "joint", **PLAIN}, "time": {"end": 3.0, "samples": SAMPLES}},
        "design": {"kind": "list"}, "vary": vary,
        "results": {"features": [f"{name}.peak" for name in scene.members], "histories": True},
    }  # fmt: skip
    result = bj.study(table, folder, workers=workers)
    found: dict[str, Any] = {"clearance": clearance.tolist(), "failed": result.failed}
    parts = {name: max(count, 1) for name, count in scene.members.items()}
    for k in range(points):
        times, force = result.forces(k)
        at = 0
        for name, count in parts.items():
            own, at = force[:, at : at + count], at + count
            row = found.setdefault(name, {"normal": [], "axial": [], "peak": [], "contacts": []})
            for part, window, axis in (("normal", NORMAL, 0), ("axial", AXIAL, 1)):
                each = [float(residual_oscillation(times, own[:, i, axis], window)) for i in range(count)]
                row[part].append(max(each))
            inside = (times >= NORMAL[0]) & (times <= NORMAL[1])
            loads = np.abs(own[inside, :, 0])
            row["peak"].append(float(loads.max()))
            # Onsets as sampled, of what bears more than a hundredth of the peak.
            bears = loads > 0.01 * loads.max()
            row["contacts"].append(float(np.mean(np.sum(bears[1:] & ~bears[:-1], axis=0))))
    return found


def rank(x: list[float], y: list[float]) -> float:
    """Spearman's rank correlation."""
    return float(spearmanr(x, y).statistic)  # pyright: ignore[reportAttributeAccessIssue]


def claims(found: dict[str, Any]) -> dict[str, Any]:
    """Each claim with what the model says of it."""
    x = found["clearance"]
    names = [n for n in found if isinstance(found[n], dict)]
    grows = {n: rank(x, found[n]["normal"]) for n in names}
    ratio = {n: found[n]["normal"][-1] / found[n]["normal"][0] for n in names}
    seat, axial = (np.array(found["seat_cage"][part]) for part in ("normal", "axial"))
    ball = np.array(found["seat_ball"]["normal"])
    return {
        "grows_spearman": grows, "last_over_first": ratio,
        "axial_less_than_normal": {
            n: float(np.mean(np.array(found[n]["axial"]) < np.array(found[n]["normal"]))) for n in names
        },
        "axial_over_normal_seat_cage": float(np.median(axial / seat)),
        "ball_less_than_cage": float(np.mean(ball < seat)), "ball_over_cage": float(np.median(ball / seat)),
        "impacts": [min(found["seat_cage"]["contacts"]), max(found["seat_cage"]["contacts"])],
        "higher_impacts_spearman": rank(x, found["seat_cage"]["peak"]),
    }  # fmt: skip


def drawn(found: dict[str, dict[str, Any]]) -> None:
    with drawing("clearance.png", (11, 4.2), 2, sharey=True) as both:
        for axes, (title, one) in zip(both, found.items(), strict=True):
            x = np.array(one["clearance"]) * 1e6
            for name in (n for n in one if isinstance(one[n], dict)):
                (line,) = axes.plot(x, np.array(one[name]["normal"]) / 1e3, label=name)
                axes.plot(x, np.array(one[name]["axial"]) / 1e3, "--", lw=0.9, color=line.get_color())
            axes.set(xscale="log", yscale="log", xlabel="radial clearance of the seat's pilot [um]", title=title)
        both[0].set_ylabel("residual oscillation [kN]")
        both[0].legend(fontsize=8, title="normal; dashed: axial")


def table(found: dict[str, dict[str, Any]]) -> str:
    """Claims against the model, as Markdown."""

    def grows(name: str, c: dict[str, Any]) -> str:
        rank, last = c["grows_spearman"][name], c["last_over_first"][name]
        return f"{'yes' if rank > 0.5 else 'no'}: rank correlation {rank:.2f}, last over first {last:.3g}"

    def axial(c: dict[str, Any]) -> str:
        shares = ", ".join(f"{n} {v:.0%}" for n, v in c["axial_less_than_normal"].items())
        return f"{shares} of points; median {c['axial_over_normal_seat_cage']:.2f} at cage and seat"

    def impacts(c: dict[str, Any]) -> str:
        least, most = c["impacts"]
        onsets = f"{least:.0f} to {most:.0f} onsets" if most else "none: it never lets go"
        return f"{onsets}; rank correlation of the peak {c['higher_impacts_spearman']:.2f}"

    said: dict[str, Callable[[dict[str, Any]], str]] = {
        **{
            f"oscillation grows with clearance: {name}": partial(grows, name)
            for name in ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball")
        },
        "axial less than normal (0.14 at cage and seat)": axial,
        "ball and groove less than cage and seat":
            "{ball_less_than_cage:.0%} of points; median ratio {ball_over_cage:.2f}".format_map,
        "fewer, higher impacts of cage and seat": impacts,
    }  # fmt: skip
    made = {title: claims(one) for title, one in found.items()}
    models = {title: lambda row, c=c: row[1](c) for title, c in made.items()}
    return harness.table({"the paper says": lambda row: row[0], **models}, said.items())


def main() -> None:
    given = options(__doc__, points=24, workers=2)
    os.environ.setdefault("BCFJ_CACHE", str(ROOT / "build" / "jax-cache"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = {
            "clearance of both pilots": studied(given.points, given.workers, False, folder / "pilots"),
            "all clearances together": studied(given.points, given.workers, True, folder / "all"),
        }
    save("clearance", {"found": found, "claims": {k: claims(v) for k, v in found.items()}})
    drawn(found)
    publish("clearance", table(found), "docs/studies.md")


if __name__ == "__main__":
    main()
