"""A small calibration problem as files, and ways to change them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

# A small smooth pulse of 100 N over 1 ms; none of these tests asks whether a law fits it.
TIMES = np.linspace(0.0, 1.2, 13)
FORCES = 100.0 * np.clip(np.sin(np.pi * TIMES), 0.0, None)
TABLE = "time [ms],force [N]\n" + "".join(f"{t:.3f},{f:.6f}\n" for t, f in zip(TIMES, FORCES, strict=True))
SCENE = '[scene]\nkind = "impact"\n[parameters]\nmass = 0.1\napproach_speed = 1.0\nstiffness = 1e8\n'
PROBLEM = """scene = "s.toml"
[[experiment]]
file = "d.csv"
time = "time [ms]"
observe = { "contact.normal" = "force [N]" }
noise = "1 N"
[free.stiffness]
lower = 1e6
upper = 1e10
"""
FREE = PROBLEM[PROBLEM.index("[free") :]


def swap(old: str, new: str, file: str = "p.toml"):
    """A change of one of the files, which must indeed change it."""

    def change():
        text = Path(file).read_text()
        assert old in text
        Path(file).write_text(text.replace(old, new, 1))

    return change


def drop(file: str):
    return lambda: Path(file).unlink()


def lines(change) -> None:
    """Change the data's lines, the header being line 1."""

    def apply():
        rows = Path("d.csv").read_text().splitlines()
        Path("d.csv").write_text("\n".join(change(rows)) + "\n")

    return apply
