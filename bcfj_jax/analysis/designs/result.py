"""What a design came to, in numbers and in words, and as files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.analysis.derivatives.certificate import Certificate
from bcfj_jax.analysis.designs.confirm import Confirmation
from bcfj_jax.analysis.designs.descent import Path as Way
from bcfj_jax.analysis.designs.space import Space
from bcfj_jax.analysis.designs.tolerance import Robustness
from bcfj_jax.core import presented
from bcfj_jax.io import outputs

OK, FAILED, NOT_CONFIRMED, NOT_TRUSTED, ALONE, ROUGH, NO_GAIN = (
    "ok", "failed", "not confirmed", "gradient not trusted", "one start alone", "not converged", "no gain",
)  # fmt: skip


class Slice(NamedTuple):
    """The true objective (N,) along one parameter's values (N,) [SI] through the optimum; NaN where a run fails."""

    values: np.ndarray
    objective: np.ndarray


class Design(NamedTuple):
    """A finished design.

    Attributes:
        status: "ok", or the worst of what is wrong: "failed" (no start had a value), "not confirmed" (by the
            independent run), "gradient not trusted" (by the certificate, where there is one), "not converged" (no
            optimum in the sense of derivatives: a kink, a flat place, or too few iterations), "one start alone" (no
            other came to the same value), "no gain".
        reason: all that is to be said, in words.
        objective, sense, unit: what was made least or most.
        values, before_values: SI values of the free parameters after and before.
        at_bound: by name "lower" or "upper" for what lies at a bound and is pushed against it.
        before, after: the true objective by the optimiser's own solver; gain, positive where it became better.
        gradient: by name, of the crest (with the robust part, if any), per SI unit.
        step, curvature: as ``newton.Refined``: how far the optimum may still be, a share of a range.
        starts: of every start its way, first that of the given design; agree: how many ended within 1e-4 of the best
            descent's value, near: how many of these within 1e-2 of every range of its place.
        confirmation: the independent run beside; None where it was not asked for.
        certificate: of the derivatives at the optimum; None for equilibria and where it was not asked for.
        robustness: over the tolerances, of the optimum and of the design before; None without tolerances.
        slices: the objective along each parameter, by name.
        failures: runs without a value, by reason.
        stats: batches, points, wall_s, compile_s, lanes (points of a batch).
        space: the free parameters.
    """

    status: str
    reason: str
    objective: str
    sense: str
    unit: str
    values: dict[str, float]
    before_values: dict[str, float]
    at_bound: dict[str, str]
    before: float
    after: float
    gain: float
    gradient: dict[str, float]
    step: float
    curvature: float
    starts: tuple[Way, ...]
    agree: int
    near: int
    confirmation: Confirmation | None
    certificate: Certificate | None
    robustness: Robustness | None
    robustness_before: Robustness | None
    slices: dict[str, Slice]
    failures: dict[str, int]
    stats: dict[str, float]
    space: Space

    _view = "bcfj_jax.analysis.designs.view"
    __repr__ = presented.text
    _repr_html_ = presented.html
    to_pandas = presented.to_pandas
    to_xarray = presented.to_xarray
    plot = presented.plot

    @property
    def change(self) -> str:
        """By how much the objective changed, of its size before: " (-54 %)"; "" where that is unknown."""
        share = (self.after - self.before) / abs(self.before) if self.before else math.nan
        return f" ({100.0 * share:+.3g} %)" if math.isfinite(share) else ""

    def content(self) -> dict[str, Any]:
        """The design as ``design.json`` has it."""
        table = {k: v for k, v in self._asdict().items() if k not in ("starts", "certificate", "slices", "space")}
        for key in ("confirmation", "robustness", "robustness_before"):
            table[key] = None if table[key] is None else table[key]._asdict()
        space = self.space
        table["free"] = {
            name: {
                "unit": q.unit, "lower": space.lower[k], "upper": space.upper[k], "tolerance": space.tolerance[k],
                "relative": bool(space.relative[k]), "scale": "log" if space.log[k] else "linear",
            }
            for k, (name, q) in enumerate(zip(space.names, space.quantities, strict=True))
        }  # fmt: skip
        table["verdict"] = self.certificate.verdict if self.certificate else None
        table["starts"] = [
            {
                "start": dict(zip(space.names, space.values(way.start).tolist(), strict=True)),
                "end": dict(zip(space.names, space.values(way.end).tolist(), strict=True)),
                "value": way.value, "evaluations": len(way.best), "failed": way.failed, "message": way.message,
            }
            for way in self.starts
        ]  # fmt: skip
        return table

    def save(self, folder: Path | str) -> Path:
        """Write ``design.json``, ``starts.png`` and ``slices.png``; the folder.

        Raises:
            InputError: if the folder holds one of them already.
        """
        from bcfj_jax.analysis.designs import pictures

        names = ("design.json", "starts.png", "slices.png")
        with outputs.session():
            where = outputs.open_folder(Path(folder), "design", "", names)
            outputs.write_json(where / names[0], self.content())
            pictures.starts(self, where / names[1])
            if self.slices:
                pictures.slices(self, where / names[2])
        return where
