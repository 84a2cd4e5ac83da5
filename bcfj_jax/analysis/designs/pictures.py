"""Pictures of a design: what every start did, and the objective along each parameter through the optimum."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bcfj_jax.io.plots import COLOURS, figure, label, panels, save, style
from bcfj_jax.io.units import engineering

if TYPE_CHECKING:
    from bcfj_jax.analysis.designs.result import Design

_BEST, _OTHER, _GIVEN = COLOURS[0], "#b5b5b5", COLOURS[1]


def starts(found: Design, path: Path) -> None:
    """The best value of every start so far, against its evaluations."""
    ends = np.array([way.value for way in found.starts])
    scale, prefix = engineering([found.before, *ends[np.isfinite(ends)]]) if found.unit else (1.0, "")
    with style():
        drawing, axes = figure(1, height=3.6)
        axis = axes[0]
        sign = 1.0 if found.sense == "minimise" else -1.0
        order = np.argsort(np.where(np.isfinite(ends), sign * ends, np.inf))[::-1]
        for k in order:
            way, best = found.starts[k], k == order[-1]
            colour = _GIVEN if k == 0 else _BEST if best else _OTHER
            text = "from the given design" if k == 0 else "best start" if best else None
            count = np.arange(1, len(way.best) + 1)
            axis.plot(count, way.best * scale, color=colour, linewidth=1.8 if text else 1.0, label=text)
            axis.plot(count[-1:], way.best[-1:] * scale, "o", color=colour, markersize=4)
        axis.axhline(found.before * scale, color=_GIVEN, linestyle="--", linewidth=1.0, label="given design")
        axis.set_xlim(left=1)
        axis.set_title(f"{found.objective}: {found.agree} of {len(found.starts)} starts agree")
        axis.set_xlabel("evaluations of a start")
        axis.set_ylabel(label("best so far", found.unit, prefix) if found.unit else "best so far")
        axis.legend(fontsize=8, loc="best")
        save(drawing, path)


def slices(found: Design, path: Path) -> None:
    """The objective along each parameter, the others at the optimum; its bounds, and the tolerance about it."""
    every = np.concatenate([cut.objective for cut in found.slices.values()])
    scale, prefix = engineering(every[np.isfinite(every)]) if found.unit else (1.0, "")
    halves = found.space.halves(np.array([found.values[n] for n in found.space.names]))
    with panels(len(found.slices), 3, path, 3.6, 2.9) as axes:
        for k, (axis, (name, cut)) in enumerate(zip(axes, found.slices.items(), strict=True)):
            quantity = found.space.quantities[k]
            plain = quantity.unit not in ("m", "s", "N", "Pa")
            wide, small = (1.0, "") if plain else engineering(cut.values)
            angle = quantity.unit == "rad"
            wide = np.degrees(1.0) if angle else wide
            at, half = found.values[name] * wide, halves[k] * wide
            axis.plot(cut.values * wide, cut.objective * scale, color=_BEST)
            if half:
                axis.axvspan(at - half, at + half, color=_BEST, alpha=0.15, linewidth=0, label="its tolerance")
            axis.plot(at, found.after * scale, "o", color=_BEST, markersize=6, label="optimum")
            given = found.before_values[name] * wide
            axis.axvline(given, color=_GIVEN, linestyle="--", linewidth=1.0, label="given design")
            for bound, text in ((found.space.lower[k], "bounds"), (found.space.upper[k], None)):
                axis.axvline(bound * wide, color="#4a4a4a", linewidth=1.2, label=text)
            if found.space.log[k]:
                axis.set_xscale("log")
            side = found.at_bound.get(name)
            axis.set_title(name + (f" ({side} bound)" if side else ""), fontsize=9.5)
            unit = "deg" if angle else quantity.unit
            axis.set_xlabel(label("value", unit, small) if unit != "1" else "value")
            if k == 0:
                axis.legend(fontsize=7, loc="best")
            if k % 3 == 0:
                axis.set_ylabel(label(found.objective, found.unit, prefix) if found.unit else "objective")
