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

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any

os.environ.setdefault("EQX_ON_ERROR", "nan")

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

import bcfj_jax as bj
from bcfj_jax.analysis.features import residual_oscillation
from bcfj_jax.io import plots
from bcfj_jax.models.joint.scene import PLAIN
from benchmarks.common import ROOT, markdown, put_in_readme, save

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


def drawn(found: dict[str, dict[str, Any]], path: Path) -> None:
    with plots.style():
        figure = Figure(figsize=(11, 4.2), layout="constrained")
        for axes, (title, one) in zip(figure.subplots(1, 2, sharey=True), found.items(), strict=True):
            x = np.array(one["clearance"]) * 1e6
            for name in (n for n in one if isinstance(one[n], dict)):
                (line,) = axes.plot(x, np.array(one[name]["normal"]) / 1e3, label=name)
                axes.plot(x, np.array(one[name]["axial"]) / 1e3, "--", lw=0.9, color=line.get_color())
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xlabel("radial clearance of the seat's pilot [um]")
            axes.set_title(title)
        figure.axes[0].set_ylabel("residual oscillation [kN]")
        figure.axes[0].legend(fontsize=8, title="normal; dashed: axial")
        figure.savefig(path, dpi=110)


def table(found: dict[str, dict[str, Any]]) -> str:
    """Claims against the model, as Markdown."""
    rows = [["the paper says", *found]]
    made = [claims(one) for one in found.values()]

    def said(words: str, of: Any) -> None:
        rows.append([words, *map(of, made)])

    for name in ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball"):
        said(
            f"oscillation grows with clearance: {name}",
            lambda c, name=name: (
                f"{'yes' if c['grows_spearman'][name] > 0.5 else 'no'}: rank correlation "
                f"{c['grows_spearman'][name]:.2f}, last over first {c['last_over_first'][name]:.3g}"
            ),
        )
    said(
        "axial less than normal (0.14 at cage and seat)",
        lambda c: (
            f"{', '.join(f'{n} {v:.0%}' for n, v in c['axial_less_than_normal'].items())} of points; "
            f"median {c['axial_over_normal_seat_cage']:.2f} at cage and seat"
        ),
    )
    said(
        "ball and groove less than cage and seat",
        lambda c: f"{c['ball_less_than_cage']:.0%} of points; median ratio {c['ball_over_cage']:.2f}",
    )
    said(
        "fewer, higher impacts of cage and seat",
        lambda c: (
            (f"{c['impacts'][0]:.0f} to {c['impacts'][1]:.0f} onsets" if c["impacts"][1] else "none: it never lets go")
            + f"; rank correlation of the peak {c['higher_impacts_spearman']:.2f}"
        ),
    )
    return markdown(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=24)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    os.environ.setdefault("BCFJ_CACHE", str(ROOT / "build" / "jax-cache"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = {
            "clearance of both pilots": studied(given.points, given.workers, False, folder / "pilots"),
            "all clearances together": studied(given.points, given.workers, True, folder / "all"),
        }
    save("clearance", {"found": found, "claims": {k: claims(v) for k, v in found.items()}})
    drawn(found, ROOT / "docs" / "images" / "clearance.png")
    print(table(found))
    put_in_readme("clearance", table(found), "docs/studies.md")


if __name__ == "__main__":
    main()
