"""Which interval each estimate gets: the covariance's, its profile's, or the posterior's; and the tests that follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.extras import library
from calibration.diagnostics import fit_tests
from calibration.forward.coordinates import Coordinate
from calibration.forward.model import Model
from calibration.search.refinement import End
from calibration.solver_budget import budget
from calibration.uncertainty import posterior, profile
from calibration.uncertainty.estimates import Parameter, Reference, ends_of
from calibration.uncertainty.law_miss import NEXT_RUN
from calibration.uncertainty.posterior import WORST_RHAT, Chains, Posterior
from calibration.uncertainty.profile import Profile

KINDS = ("covariance", "profile", "posterior")


@dataclass(frozen=True)
class Evidence:
    """What stands behind intervals that are not the covariance's: profiles by name, or draws."""

    profiles: dict[str, Profile] = field(default_factory=dict)
    posterior: Posterior | None = None

    def withheld(self, why: str) -> Evidence:
        """The same without intervals, for a fit whose verdict stands behind none."""
        bare = {name: replace(p, ends=(None, None)) for name, p in self.profiles.items()}
        return Evidence(bare, self.posterior and replace(self.posterior, refusal=self.posterior.refusal or why))


def as_json(evidence: Evidence) -> dict[str, Any]:
    """What ``fit.json`` holds of it: "profiles" by parameter, and "posterior"."""
    content: dict[str, Any] = {}
    if evidence.profiles:
        content["profiles"] = {
            name: {
                "shape": p.shape, "ends": p.ends, "threshold": p.threshold,
                "values": p.values, "rises": p.rises, "notes": p.notes,
            }
            for name, p in evidence.profiles.items()
        }  # fmt: skip
    if evidence.posterior:
        p = evidence.posterior
        content["posterior"] = {
            "rhat": dict(zip(p.labels, p.rhat.tolist(), strict=True)),
            "effective": dict(zip(p.labels, p.effective.tolist(), strict=True)),
            "draws": p.draws[..., 0].size, "divergences": p.divergences, "refusal": p.refusal,
        }  # fmt: skip
    return content


def check_kind(kind: str) -> None:
    """Refuse a kind of interval that there is not.

    Raises:
        InputError: naming those that there are; and where the library of one is not installed.
    """
    if kind not in KINDS:
        raise InputError("intervals", f"'{kind}'", f"use one of {', '.join(KINDS)}")
    if kind == "posterior":
        # Before the search, whose time would be lost.
        library(posterior.LIBRARY, "intervals = posterior", "uq")


def revised(
    kind: str,
    model: Model,
    labels: Sequence[str],
    place: np.ndarray,
    quality: fit_tests.Spread,
    parameters: dict[str, Parameter],
    reference: Reference | None,
    tests: list[fit_tests.Test],
    *,
    estimated: Sequence[str],
    batch: int,
    seed: int,
) -> tuple[dict[str, Parameter], Reference | None, list[fit_tests.Test], Evidence]:
    """Estimates and their tests with the intervals that were asked for.

    With "covariance", a parameter whose cost does not rise as the covariance says gets its profile's interval instead,
    if that is all that fails.

    Args:
        kind: one of ``KINDS``.
        model, labels, place, quality: of the optimum.
        parameters, reference, tests: as the covariance has them, from ``estimates``.
        estimated: channels whose noise has an estimated deviation.
        batch: points evaluated together.
        seed: of the sampler.
    """
    if kind == "posterior":
        if quality.covariance is None:  # The sampler has no metric, and the test of the rank has spoken.
            return parameters, reference, tests, Evidence()
        drawn = posterior.of_model(model, place, quality.covariance, labels, estimated=estimated, chains=Chains(seed))
        ends, why = drawn.intervals, dict.fromkeys(labels, drawn.refusal)
        content = f"posterior: {drawn.refusal}"
        mixed = fit_tests.Test(
            "chains of the posterior", float(np.max(drawn.rhat)), WORST_RHAT, not drawn.refusal, content
        )
        parameters, reference = _replaced(kind, model, labels, parameters, reference, ends)
        return parameters, reference, [*_retested(model, labels, tests, ends, why), mixed], Evidence(posterior=drawn)
    failed = {t.name for t in tests if not t.passed}
    bent = {name for name in labels if f"interval of {name}" in failed}
    # Where more fails no interval will be given, whatever a profile says; and a rough cost makes it a profile of noise.
    if kind == "covariance" and (len(failed) > len(bent) or budget(model.scene).rough):
        return parameters, reference, tests, Evidence()
    names = [*labels, "reference_force"] if kind == "profile" else sorted(bent)
    if not names:
        return parameters, reference, tests, Evidence()
    allowed = profile.rise_allowed(quality)
    found = profile.of_model(model, place, allowed, labels, only=names, batch=batch)
    ends = {name: p.interval for name, p in found.items()}
    why = {name: f"the profile of {name} is {p.shape}: {'; '.join(p.notes)}" for name, p in found.items()}
    parameters, reference = _replaced("profile", model, labels, parameters, reference, ends)
    return parameters, reference, _retested(model, labels, tests, ends, why), Evidence(found)


def _replaced(
    kind: str,
    model: Model,
    labels: Sequence[str],
    parameters: dict[str, Parameter],
    reference: Reference | None,
    ends: Mapping[str, tuple[float, float] | None],
) -> tuple[dict[str, Parameter], Reference | None]:
    """Estimates with other intervals; one wider than what counts as determined is none."""
    changed = dict(parameters)
    for axis, name in zip(model.coordinates, labels, strict=True):
        if name in ends:
            known = half(ends[name], axis.log) < fit_tests.widest(axis)
            own = ends[name] if known else None
            changed[name] = replace(parameters[name], ci95=own, identifiable=known, interval_kind=kind)
    if reference and "reference_force" in ends:
        known = half(ends["reference_force"], True) < np.log(fit_tests.WIDEST_FACTOR)
        reference = replace(reference, ci95=ends["reference_force"] if known else None, interval_kind=kind)
    return changed, reference


def half(ends: tuple[float, float] | None, log: bool) -> float:
    """Half the length of an interval on the search scale; infinite for none."""
    if ends is None:
        return float("inf")
    return 0.5 * float(np.log(ends[1] / ends[0]) if log else ends[1] - ends[0])


def _retested(
    model: Model,
    labels: Sequence[str],
    tests: list[fit_tests.Test],
    ends: Mapping[str, tuple[float, float] | None],
    why: Mapping[str, str],
) -> list[fit_tests.Test]:
    """Tests of the covariance's intervals give way to those of the intervals that replace them."""
    changed = []
    for axis, name in zip(model.coordinates, labels, strict=True):
        if name in ends:
            own, limit = half(ends[name], axis.log), fit_tests.widest(axis)
            reason = f"the data do not determine {name}: they allow a factor or share beyond the limit"
            reason = why[name] if ends[name] is None else reason
            changed.append(fit_tests.Test(f"{name} determined", own, limit, own < limit, reason))
    gone = {f"interval of {name}" for name in ends} | {t.name for t in changed}
    # That direction is the covariance's: where every parameter turns out bounded it is not weak.
    if set(labels) <= set(ends) and all(t.passed for t in changed):
        gone.add("weak direction")
    return [t for t in tests if t.name not in gone] + changed


def headlined(
    model: Model,
    labels: tuple[str, ...],
    best: End,
    misses: dict[str, fit_tests.Spread],
    parameters: dict[str, Parameter],
    reference: Reference | None,
    given: bool,
) -> tuple[dict[str, Parameter], Reference | None]:
    """Estimates with their intervals by kind, and the headline: the widest.

    Args:
        misses: spreads beside the noise's; none where the law is the noise.
        given: whether there is one: not after a search that failed, nor where the data allow another answer.
    """
    kinds = {kind: ends_of(model, labels, best, spread) for kind, spread in misses.items()}

    def headline(by_kind: dict[str, tuple[float, float] | None]) -> tuple[Any, str]:
        if not given or any(ends is None for ends in by_kind.values()):
            return None, ""
        by_kind = {kind: ends for kind, ends in by_kind.items() if kind != NEXT_RUN}
        kind = max(by_kind, key=lambda k: by_kind[k][1] - by_kind[k][0])  # pyright: ignore[reportOptionalSubscript]
        return by_kind[kind], kind

    shown = {}
    for axis, name in zip(model.coordinates, labels, strict=True):
        p = parameters[name]
        by_kind = {"noise": p.ci95, **{kind: ends[name] for kind, (ends, _) in kinds.items()}}
        ends, kind = headline(by_kind)
        if ends and _everything(ends, axis):
            ends, kind = None, ""
        shown[name] = replace(p, ci95=ends, headline=kind, intervals=by_kind if given else {})
    if reference:
        by_kind = {"noise": reference.ci95, **{kind: own for kind, (_, own) in kinds.items()}}
        reference = replace(reference, ci95=headline(by_kind)[0])
    return shown, reference


def _everything(ends: tuple[float, float], axis: Coordinate) -> bool:
    """Whether an interval is all that the bounds allow."""
    low, high = np.log(ends) if axis.log else ends
    margin = 1e-6 * (axis.upper - axis.lower)
    return bool(low <= axis.lower + margin and high >= axis.upper - margin)
