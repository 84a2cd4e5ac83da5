"""Which interval each estimate gets, the tests that follow, and what a reader must know of intervals though nothing failed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bcfj_jax import InputError
from bcfj_jax.core.extras import library
from bcfj_jax.core.quantities import rounded
from bcfj_jax.mechanism.channels import unit_of
from calibration.diagnostics import fit_tests
from calibration.diagnostics.optimum import Optimum
from calibration.diagnostics.residual_tests import Series, overstated
from calibration.forward.coordinates import Coordinate
from calibration.noise.noise_model import Estimate
from calibration.solver_budget import budget
from calibration.uncertainty import posterior, profile
from calibration.uncertainty.estimates import REFERENCE, Ends, Estimates, Parameter
from calibration.uncertainty.law_miss import NEXT_RUN
from calibration.uncertainty.posterior import WORST_RHAT, Chains, Posterior
from calibration.uncertainty.profile import Profile

# The last is the covariance with every error at its limit beside it.
BOUND = "bound"
KINDS = ("covariance", "profile", "posterior", BOUND)
# Intervals by the name of what they are of; None where there is none.
ByName = Mapping[str, Ends | None]


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
        kept = ("shape", "ends", "threshold", "values", "rises", "notes")
        content["profiles"] = {n: {key: getattr(p, key) for key in kept} for n, p in evidence.profiles.items()}
    if p := evidence.posterior:
        by_label = {key: dict(zip(p.labels, getattr(p, key).tolist(), strict=True)) for key in ("rhat", "effective")}
        counts = {"draws": p.draws[..., 0].size, "divergences": p.divergences}
        content["posterior"] = {**by_label, **counts, "refusal": p.refusal}
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


def revised(kind: str, at: Optimum, found: Estimates, seed: int) -> tuple[Estimates, Evidence]:
    """Estimates and their tests with the intervals that were asked for.

    With "covariance", a parameter whose cost does not rise as the covariance says gets its profile's interval instead, if
    that is all that fails. ``seed``: of the sampler.
    """
    kind = "covariance" if kind == BOUND else kind
    if kind == "posterior":
        if at.spread.covariance is None:  # The sampler has no metric, and the test of the rank has spoken.
            return found, Evidence()
        drawn = posterior.of_optimum(at, Chains(seed))
        found = replaced(kind, at, found, drawn.intervals, dict.fromkeys(at.labels, drawn.refusal))
        worst, why = float(np.max(drawn.rhat)), f"posterior: {drawn.refusal}"
        mixed = fit_tests.Test("chains of the posterior", worst, WORST_RHAT, not drawn.refusal, why)
        return found._replace(tests=[*found.tests, mixed]), Evidence(posterior=drawn)
    failed = {t.name for t in found.tests if not t.passed}
    bent = {name for name in at.labels if f"interval of {name}" in failed}
    # Where more fails no interval will be given, whatever a profile says; and a rough cost makes it a profile of noise.
    if kind == "covariance" and (len(failed) > len(bent) or budget(at.model).rough):
        return found, Evidence()
    profiles = profile.of_optimum(at, only=None if kind == "profile" else sorted(bent))
    ends = {name: p.interval for name, p in profiles.items()}
    why = {name: f"the profile of {name} is {p.shape}: {'; '.join(p.notes)}" for name, p in profiles.items()}
    return replaced("profile", at, found, ends, why), Evidence(profiles)


def replaced(kind: str, at: Optimum, found: Estimates, ends: ByName, why: Mapping[str, str]) -> Estimates:
    """Estimates with other intervals, each with its test; one wider than what counts as determined is none.

    Tests of the covariance's intervals give way to those of the intervals that replace them; ``why`` there is none.
    """
    parameters, tests = dict(found.parameters), []
    for axis, name in zip(at.model.coordinates, at.labels, strict=True):
        if name in ends:
            own, reason = ends[name], "" if ends[name] else why.get(name, "")
            test = fit_tests.determined_test(name, half(own, axis.log), axis, reason)
            tests.append(test)
            own = own if test.passed else None
            parameters[name] = replace(parameters[name], ci95=own, identifiable=test.passed, interval_kind=kind)
    if REFERENCE in parameters and "reference_force" in ends:
        own = ends["reference_force"]
        own = own if half(own, True) < np.log(fit_tests.WIDEST_FACTOR) else None
        parameters[REFERENCE] = replace(parameters[REFERENCE], ci95=own, interval_kind=kind)
    gone = {f"interval of {name}" for name in ends} | {t.name for t in tests}
    # That direction is the covariance's: where every parameter turns out bounded it is not weak.
    if set(at.labels) <= set(ends) and all(t.passed for t in tests):
        gone.add("weak direction")
    return Estimates(parameters, [t for t in found.tests if t.name not in gone] + tests)


def half(ends: Ends | None, log: bool) -> float:
    """Half the length of an interval on the search scale; infinite for none."""
    if ends is None:
        return float("inf")
    return 0.5 * float(np.log(ends[1] / ends[0]) if log else ends[1] - ends[0])


def headlined(at: Optimum, kinds: Mapping[str, ByName], found: Estimates, given: bool) -> Estimates:
    """Estimates with their intervals by kind, and the headline: the widest. None where not ``given``: after a search that
    failed, or where the data allow another answer. ``kinds``: beside the noise's (``law_miss.misses``).
    """
    limits, parameters = dict(zip(at.labels, at.model.coordinates, strict=True)), {}
    for name, p in found.parameters.items():
        by_kind = {"noise": p.ci95, **{kind: ends[name] for kind, ends in kinds.items()}}
        ends, kind = None, ""
        if given and all(by_kind.values()):
            kind, ends = max(
                ((k, e) for k, e in by_kind.items() if e and k != NEXT_RUN), key=lambda item: item[1][1] - item[1][0]
            )
            if name in limits and _everything(ends, limits[name]):
                ends, kind = None, ""
        shown = by_kind if given or name == REFERENCE else {}
        parameters[name] = replace(p, ci95=ends, headline=kind, intervals=shown)
    return found._replace(parameters=parameters)


def _everything(ends: Ends, axis: Coordinate) -> bool:
    """Whether an interval is all that the bounds allow."""
    low, high = np.log(ends) if axis.log else ends
    margin = 1e-6 * (axis.upper - axis.lower)
    return bool(low <= axis.lower + margin and high >= axis.upper - margin)


# What a reader must know though nothing failed, in sentences.
SPANNING = "with every error that may act allowed for, not to a factor of two:"


def of_integrator(noise: Estimate) -> list[str]:
    """Of channels whose noise is the integrator's own error."""
    return [
        f"the noise of {name} is the integrator's: residuals are no larger than what its own error may be, "
        f"and count as {noise.sigma[name]:.2g} {unit_of(name)}"
        for name in noise.integrator
    ]


def of_spanning(at: Optimum, parameters: dict[str, Parameter]) -> list[str]:
    """Of intervals to quote that span more than a factor of two."""
    log = {name for name, axis in zip(at.labels, at.model.coordinates, strict=True) if axis.log}
    ratios = {n: p.ci95[1] / p.ci95[0] for n, p in parameters.items() if n in log and p.ci95 and p.ci95[0] > 0.0}
    wide = [f"{n} (a factor of {rounded(x)} from end to end)" for n, x in ratios.items() if x > fit_tests.WIDEST_FACTOR]
    return [f"{SPANNING} {' and '.join(wide)}"] if wide else []


def of_bent(tests: list[fit_tests.Test]) -> list[str]:
    """Of a cost that is no parabola where intervals take it for one."""
    if not tests:
        return []
    worst = max(tests, key=lambda t: abs(np.log(max(t.value, 1e-300))))
    others = f", and of {len(tests) - 1} more" if len(tests) > 1 else ""
    said = f"intervals take the cost for a parabola, but {worst.reason}{others}"
    return [f"{said}: --intervals profile walks along the cost"]


def of_overstated(series: list[Series], residuals: np.ndarray) -> list[str]:
    """Of noise that was stated larger than residuals show."""
    worst = min((np.sqrt(np.mean(residuals[s.rows] ** 2)) for s in series if overstated(s, residuals)), default=1.0)
    said = "it was stated too large, and intervals use what residuals show"
    return [f"residuals are {rounded(worst)} times the stated noise: {said}"] if worst < 1.0 else []
