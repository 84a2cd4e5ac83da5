"""What a design came to, in numbers and in words, and as files."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import Certificate
from bcfj_jax.analysis.designs.confirm import Confirmation, Robustness
from bcfj_jax.analysis.designs.descent import Path as Way
from bcfj_jax.analysis.designs.space import Space
from bcfj_jax.core import presented
from bcfj_jax.core.quantities import Quantity, percent
from bcfj_jax.io import outputs
from bcfj_jax.io.page import Picture
from bcfj_jax.io.plots import COLOURS, label, panels, sheet
from bcfj_jax.io.show import Dataset, Told
from bcfj_jax.io.units import engineering, format_si

OK, FAILED, NOT_CONFIRMED, NOT_TRUSTED, ALONE, ROUGH, NO_GAIN = (
    "ok", "failed", "not confirmed", "gradient not trusted", "one start alone", "not converged", "no gain",
)  # fmt: skip
# Of a design that is told of before it is finished.
UNCHECKED, INCOMPLETE = "not checked yet", "not complete yet"

_DIGITS = 4
_BEST, _OTHER, _GIVEN = COLOURS[0], "#b5b5b5", COLOURS[1]


class Slice(NamedTuple):
    """The true objective (N,) along one parameter's values (N,) [SI] through the optimum; NaN where a run fails."""

    values: np.ndarray
    objective: np.ndarray


class Design(NamedTuple):
    """A finished design."""

    # "ok", or the worst of what is wrong: "failed" (no start had a value), "not confirmed" (by the independent run),
    # "gradient not trusted" (by the certificate, where there is one), "not converged" (no optimum in the sense of
    # derivatives: a kink, a flat place, or too few iterations), "one start alone" (no other came to the same value),
    # "no gain". While it is told of: "not checked yet" (the best descent's end), "not complete yet" (refined and
    # checked by independent runs).
    status: str
    reason: str  # all that is to be said, in words
    # objective, sense, unit: what was made least or most.
    objective: str
    sense: str
    unit: str
    # values, before_values: SI values of the free parameters after and before.
    values: dict[str, float]
    before_values: dict[str, float]
    at_bound: dict[str, str]  # by name "lower" or "upper" for what lies at a bound and is pushed against it
    # before, after: the true objective by the optimiser's own solver; gain, positive where it became better.
    before: float
    after: float
    gain: float
    gradient: dict[str, float]  # by name, of the crest (with the robust part, if any), per SI unit
    # step, curvature: as refine.Refined: how far the optimum may still be, a share of a range.
    step: float
    curvature: float
    starts: tuple[Way, ...]  # of every start its way, first that of the given design
    # How many ended within 1e-4 of the best descent's value, near: how many of these within 1e-2 of every range of its
    # place.
    agree: int
    near: int
    confirmation: Confirmation | None  # the independent run beside; None where it was not asked for
    # Of the derivatives at the optimum; None for equilibria and where it was not asked for.
    certificate: Certificate | None
    # Over the tolerances, of the optimum and of the design before; None without tolerances.
    robustness: Robustness | None
    robustness_before: Robustness | None
    slices: dict[str, Slice]  # the objective along each parameter, by name
    failures: dict[str, int]  # runs without a value, by reason
    stats: dict[str, float]  # batches, points, wall_s, compile_s, lanes (points of a batch)
    space: Space  # the free parameters

    _view = __name__
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot

    @property
    def change(self) -> str:
        """By how much the objective changed, of its size before: " (-54 %)"; "" where that is unknown."""
        share = (self.after - self.before) / abs(self.before) if self.before else math.nan
        return f" ({percent(share, 3, '+')})" if math.isfinite(share) else ""

    def content(self) -> dict[str, Any]:
        """The design as ``design.json`` has it."""
        table = {k: v for k, v in self._asdict().items() if k not in ("starts", "certificate", "slices", "space")}
        for key in ("confirmation", "robustness", "robustness_before"):
            table[key] = None if table[key] is None else table[key]._asdict()
        space = self.space
        table["free"] = {
            axis.name: {
                "unit": q.unit, "lower": axis.lower, "upper": axis.upper, "tolerance": tolerance,
                "relative": bool(relative), "scale": axis.scale,
            }
            for axis, q, tolerance, relative in zip(space.axes, space.quantities, space.tolerance, space.relative, strict=True)
        }  # fmt: skip
        table["verdict"] = self.certificate.verdict if self.certificate else None
        table["starts"] = [
            {
                "start": space.named(space.values(way.start)), "end": space.named(space.values(way.end)),
                "value": way.value, "evaluations": len(way.best), "failed": way.failed, "message": way.message,
            }
            for way in self.starts
        ]  # fmt: skip
        return table

    def save(self, folder: Path | str) -> Path:
        """Write ``design.json``, ``starts.png`` and ``slices.png``, of which the folder may hold none yet; the folder."""
        names = ("design.json", "starts.png", "slices.png")
        with outputs.session():
            where = outputs.open_folder(Path(folder), "", outputs.Claim("design", names))
            outputs.write_json(where / names[0], self.content())
            draw_starts(self, where / names[1])
            if self.slices:
                draw_slices(self, where / names[2])
        return where


def draw_starts(found: Design, path: Path) -> Picture:
    """The best value of every start so far, against its evaluations."""
    ends = np.array([way.value for way in found.starts])
    scale, prefix = engineering([found.before, *ends[np.isfinite(ends)]]) if found.unit else (1.0, "")
    with sheet(path, height=3.6) as (axis,):
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
    shows = f"The best value of every start so far against its evaluations; {found.agree} of {len(found.starts)} agree."
    return Picture(path.name, "What every start came to", shows)


def draw_slices(found: Design, path: Path) -> Picture:
    """The objective along each parameter, the others at the optimum; its bounds, and the tolerance about it."""
    every = np.concatenate([cut.objective for cut in found.slices.values()])
    scale, prefix = engineering(every[np.isfinite(every)]) if found.unit else (1.0, "")
    halves = found.space.halves(np.array([found.values[n] for n in found.space.names]))
    with panels(len(found.slices), 3, path, 3.6, 2.9) as axes:
        for k, (axis, (name, cut)) in enumerate(zip(axes, found.slices.items(), strict=True)):
            quantity, bounds = found.space.quantities[k], found.space.axes[k]
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
            for bound, text in ((bounds.lower, "bounds"), (bounds.upper, None)):
                axis.axvline(bound * wide, color="#4a4a4a", linewidth=1.2, label=text)
            axis.set_xscale(bounds.scale)
            side = found.at_bound.get(name)
            axis.set_title(name + (f" ({side} bound)" if side else ""), fontsize=9.5)
            unit = "deg" if angle else quantity.unit
            axis.set_xlabel(label("value", unit, small) if unit != "1" else "value")
            if k == 0:
                axis.legend(fontsize=7, loc="best")
            if k % 3 == 0:
                axis.set_ylabel(label(found.objective, found.unit, prefix) if found.unit else "objective")
    shows = "The objective along each parameter, the others at the optimum; bounds and tolerances are marked."
    return Picture(path.name, "The objective about the optimum", shows)


# What is worth showing of a design in Python (``io.show.View``).


def told(found: Design) -> Told:
    """Its status, what it gained, and the free parameters before and after."""
    before, after = (format_si(x, found.unit, _DIGITS) for x in (found.before, found.after))
    lines = [] if found.status == FAILED else [f"{found.sense} {found.objective}: {before} to {after}{found.change}"]
    return Told(found.status, lines, value_rows(found), [found.reason])


def value_rows(found: Design) -> list[list[str]]:
    """Table of the free parameters: before, after, bounds."""
    rows = [["parameter", "before", "after", "lower", "upper", "remark"]]
    for axis, quantity in zip(found.space.axes, found.space.quantities, strict=True):
        side = found.at_bound.get(axis.name)
        numbers = (found.before_values[axis.name], found.values[axis.name], axis.lower, axis.upper)
        rows.append([axis.name, *(shown(x, quantity) for x in numbers), f"at its {side} bound" if side else ""])
    return rows


def shown(value: float, quantity: Quantity) -> str:
    """A parameter's value for people, angles in degrees."""
    if quantity.unit == "rad" and math.isfinite(value):
        return f"{math.degrees(value):.{_DIGITS}g} deg"
    return format_si(value, quantity.unit, _DIGITS)


def frame(found: Design) -> tuple[dict[str, Any], str]:
    """A free parameter a row, SI."""
    space = found.space
    return {
        "parameter": list(space.names),
        "before": [found.before_values[name] for name in space.names],
        "after": [found.values[name] for name in space.names],
        "unit": [quantity.unit for quantity in space.quantities],
        "lower": np.array([axis.lower for axis in space.axes]),
        "upper": np.array([axis.upper for axis in space.axes]),
        "at_bound": [found.at_bound.get(name, "") for name in space.names],
        "gradient": [found.gradient[name] for name in space.names],
        "tolerance": space.tolerance,
    }, "parameter"


def dataset(found: Design) -> Dataset:
    """The objective along each parameter through the optimum: a dimension a parameter."""
    units = {name: quantity.unit for name, quantity in zip(found.space.names, found.space.quantities, strict=True)}
    coordinates = {name: ((name,), cut.values, units[name]) for name, cut in found.slices.items()}
    variables = {f"objective along {name}": ((name,), cut.objective, found.unit) for name, cut in found.slices.items()}
    about = {"status": found.status, "objective": found.objective, "before": found.before, "after": found.after}
    return Dataset(variables, coordinates, about)


def figures(found: Design) -> dict[str, Callable[[Any], Any]]:
    """The objective along each parameter, and what every start did."""
    if found.status == FAILED or not any(np.isfinite(way.value) for way in found.starts):
        return {}
    drawn: dict[str, Callable[[Any], Any]] = {"slices": partial(draw_slices, found)} if found.slices else {}
    return drawn | {"starts": partial(draw_starts, found)}
