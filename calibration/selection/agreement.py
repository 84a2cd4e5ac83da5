"""What laws of loss agree on: the elastic force, at penetrations that all of them reach, and how far they differ there.

A record fixes the force at rest better than the way in which energy is lost. Where no law of loss explains it, or several
do, this force is what may be handed on. It comes from fits with several laws, or to first order about one fit: with the
residuals r, their Jacobian J and the signature S of another loss, the least squares of r + J x + S y moves the estimates by x.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bcfj_jax.core.quantities import percent
from bcfj_jax.io.page import brief
from calibration.diagnostics.suspects import Found
from calibration.fit import Fit
from calibration.forward.runs import contacts
from calibration.selection.choice import Choice

# Penetrations as shares of the greatest that every law reaches.
_SHARES = (0.1, 0.25, 0.5, 1.0)
# A law whose residuals are so many times those of the best is not one that fits.
_WORST = 1.5
FITS, FIRST_ORDER = "fits", "first order about the fit, which --diagnose makes fits"


class Agreement(NamedTuple):
    """Elastic forces (P,) [N] by law at penetrations (P,) [m]; what each law misses, as a share of the peak; by what."""

    penetrations: np.ndarray
    forces: dict[str, np.ndarray]
    missed: dict[str, float]
    by: str

    @property
    def spread(self) -> np.ndarray:
        """Largest less smallest force over their mean, (P,)."""
        every = np.stack(list(self.forces.values()))
        return np.ptp(every, axis=0) / every.mean(axis=0)


def of_choice(choice: Choice) -> Agreement | None:
    """Of the models of a calibration file."""
    return of_fits({r.name: r.fit for r in choice.rivals})


def of_fits(fits: Mapping[str, Fit]) -> Agreement | None:
    """Of fits of the same data, those whose search converged and that miss at most 1.5 times as much as the best.

    None of fewer than two, and where a scene has no contact of one power law or the like.
    """
    good = {name: f for name, f in fits.items() if f.search.answer == "converged" and _law(f)}
    least = min((f.residual["rms_of_peak"] for f in good.values()), default=0.0)
    good = {name: f for name, f in good.items() if f.residual["rms_of_peak"] <= _WORST * least}
    if len(good) < 2:
        return None
    depths = np.array(_SHARES) * min(_deepest(f) for f in good.values())
    forces = {name: _elastic(f, f.values, depths) for name, f in good.items()}
    return _checked(Agreement(depths, forces, {n: f.residual["rms_of_peak"] for n, f in good.items()}, FITS))


def of_signatures(plain: Fit, law: str, found: Sequence[Found]) -> Agreement | None:
    """Of a fit and what other losses make of it to first order; None as ``of_fits``."""
    if not _law(plain):
        return None
    at, model = plain.optimum, plain.optimum.model
    depths = np.array(_SHARES) * _deepest(plain)
    size, missed = plain.residual["rms_of_peak"], {law: plain.residual["rms_of_peak"]}
    forces = {law: _elastic(plain, plain.values, depths)}
    whole = float(at.end.residuals @ at.end.residuals)
    for f in found:
        if f.columns is None:
            continue
        columns = np.hstack([at.end.jacobian, f.columns])
        scale = np.linalg.norm(columns, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        step = np.linalg.lstsq(columns / scale, -at.end.residuals, rcond=1e-9)[0] / scale
        left = at.end.residuals + columns @ step
        moved = np.clip(at.end.point + step[: at.end.point.size], 0.0, 1.0)
        found_values = model.values(moved)
        shared = {
            a.name: float(v) for a, v in zip(model.coordinates, found_values, strict=True) if a.experiment is None
        }
        forces[f.name] = _elastic(plain, {**plain.values, **shared}, depths)
        missed[f.name] = size * float(np.sqrt(left @ left / whole))
    return _checked(Agreement(depths, forces, missed, FIRST_ORDER))


def _checked(found: Agreement) -> Agreement | None:
    good = {name: x for name, x in found.forces.items() if np.isfinite(x).all() and (x > 0.0).all()}
    return found._replace(forces=good) if len(good) > 1 else None


def _law(fit: Fit) -> Any:
    """The one contact's law, if its elastic coefficients are shared by all records; else None."""
    law = fit.optimum.model.scene.only_law()
    elastic = getattr(law, "elastic", law)
    return elastic if elastic is not None and set(elastic.needs) <= fit.values.keys() else None


def _elastic(fit: Fit, values: Mapping[str, float], depths: np.ndarray) -> np.ndarray:
    part = _law(fit)
    return np.asarray(part.force(depths, {name: values[name] for name in part.needs}))


def _deepest(fit: Fit) -> float:
    at = fit.optimum
    return max((c.deepest for c in contacts(at.model, at.end.point)), default=0.0)


def heading(found: Agreement) -> str:
    """The table's title, which says how far the laws agree."""
    worst = percent(float(found.spread[1:].max()), 2)
    count = len(found.forces)
    return (
        f"The elastic force that {count} laws of loss agree on within {worst} (by {found.by}; the shallowest left out)"
    )


def rows(found: Agreement) -> list[list[str]]:
    """A row a law, and the spread."""
    table = [["law", *(f"at {brief(float(d), 'm')}" for d in found.penetrations), "misses, of the peak"]]
    for name, force in found.forces.items():
        table.append([name, *(brief(float(x), "N") for x in force), percent(found.missed[name], 2)])
    mean = np.mean(list(found.forces.values()), axis=0)
    table.append(["mean", *(brief(float(x), "N") for x in mean), ""])
    return [*table, ["spread", *(percent(float(x), 2) for x in found.spread), ""]]


def as_json(found: Agreement) -> dict[str, Any]:
    """``elastic_force`` of ``fit.json``."""
    return {
        "by": found.by,
        "penetrations": found.penetrations,
        "forces": found.forces,
        "spread": found.spread,
        "missed_of_peak": {name: found.missed[name] for name in found.forces},
    }
