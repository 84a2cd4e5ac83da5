"""Model choice: the same data against several laws or fidelities, and the cheapest that the data cannot refuse.

Two scores rank the models. The held-out score is the error of predicting records that were not fitted. The information
criteria weigh the likelihood at the optimum against the number of numbers found, noise included:
AICc = D + 2 k + 2 k (k + 1)/(n - k - 1) (Hurvich and Tsai 1989) and BIC = D + k ln n (Schwarz 1978), D = -2 ln L.
Both take residuals for as independent as the noise model makes them; where that test fails they promise too much.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jax import Array

from bcfj_jax import InputError
from bcfj_jax.io.journal import Chapter, Journal
from bcfj_jax.io.units import format_si
from bcfj_jax.xla.programs import program
from calibration.fit import Fit, fit
from calibration.forward.model import Model, build, divided, whole
from calibration.noise import noise_model
from calibration.problem import Experiment, Problem
from calibration.search.descent import levenberg
from calibration.search.evaluate import evaluator
from calibration.solver_budget import budget
from calibration.uncertainty.estimates import briefly

log = logging.getLogger("calibration")

# Models whose BIC is higher by more have "very strong" evidence against them (Kass and Raftery 1995).
DECISIVE = 10.0
# Models are as cheap as the fastest up to this factor of time a prediction; the number of parameters decides then.
AS_FAST = 3.0
# Steps at most to the optimum of a part of the data, from that of all.
_STEPS = 20


class Likelihood(NamedTuple):
    """D = -2 ln L at an optimum, the numbers found (parameters and noise) and the samples they were found from."""

    deviance: float
    numbers: int
    samples: int

    @property
    def bic(self) -> float:
        """Schwarz's criterion."""
        return self.deviance + self.numbers * float(np.log(self.samples))

    @property
    def aicc(self) -> float:
        """Akaike's criterion, corrected for few samples; infinite where there are too few."""
        left = self.samples - self.numbers - 1
        more = 2.0 * self.numbers * (self.numbers + 1) / left if left > 0 else float("inf")
        return self.deviance + 2.0 * self.numbers + more


@dataclass(frozen=True)
class Rival:
    """One model that was fitted."""

    name: str
    fit: Fit
    # None where a robust loss, which is no likelihood, was asked for, or nothing was fitted.
    likelihood: Likelihood | None
    held_out: float | None  # rms of held-out errors as a share of each record's peak; None without held-out records
    seconds: float  # of one prediction of all fitted records
    # Whether its search converged, its law is no misfit, and no other such model is decisively better by BIC.
    kept: bool = False

    @property
    def bic(self) -> float:
        """Of its likelihood; infinite where there is none."""
        return self.likelihood.bic if self.likelihood else float("inf")

    @property
    def refused(self) -> bool:
        """Whether its verdict is one of a model that is not kept."""
        return self.fit.verdict in ("misfit", "not_converged")


@dataclass(frozen=True)
class Choice:
    """Models ranked, best first; the one chosen by name; why, in words."""

    rivals: tuple[Rival, ...]
    chosen: str
    reasons: list[str]

    @property
    def fit(self) -> Fit:
        """The chosen model's fit."""
        return next(rival.fit for rival in self.rivals if rival.name == self.chosen)

    def reported(self, found: Fit) -> Choice:
        """With the verdict that the chosen model's fit ends with: models are compared by what residuals show alone."""
        before, own = self.fit.verdict, {"verdict": found.verdict, "reasons": found.reasons}
        if found.verdict == before:
            return self
        rivals = (replace(r, fit=replace(r.fit, **own)) if r.name == self.chosen else r for r in self.rivals)
        said = f"residuals alone call '{self.chosen}' {before}, as they call the others what the table says"
        said += f"; what they do not show makes it {found.verdict}"
        return replace(self, rivals=tuple(rivals), reasons=[*self.reasons, said])


def choose(
    models: Sequence[tuple[str, Problem]], *, journal: Journal | None = None,
    tell: Callable[[Fit], None] | None = None, **options: Any,
) -> Choice:  # fmt: skip
    """Fit every model to the same data and choose.

    Args:
        journal: where finished starts are kept, of every model in a chapter of its own.
        tell: as ``fit``'s, with a note of whose fit it is.
        options: of every fit, as ``fit``: seed, starts.

    Where models follow the record of a tumbling body differently far, likelihoods are those of the part that all follow.

    Raises:
        InputError: for no model, a name given twice, or models of other data.
        AllStartsFailed: if no start of a model simulates.
    """
    names = [name for name, _ in models]
    if not names or len(set(names)) < len(names):
        raise InputError("[[model]]", f"names: {', '.join(names) or 'none'}", "give every model a name of its own")
    for name, problem in models:
        if problem.experiments is not models[0][1].experiments:
            raise InputError(f"[[model]] '{name}'", "has other experiments", "compare models on the same data")
    rivals = []
    for name, problem in models:
        own = Chapter(journal, name) if journal is not None else None
        told = tell and (lambda found, name=name: tell(replace(found, notes=[f"this is model '{name}'", *found.notes])))
        found = fit(problem, journal=own, systematic=False, tell=told, **options)
        log.info("model '%s': %s", name, found.verdict)
        rivals.append(rival(name, problem, found))
    return decided(_over_the_same([problem for _, problem in models], rivals))


def _over_the_same(problems: Sequence[Problem], rivals: Sequence[Rival]) -> list[Rival]:
    """Rivals with likelihoods of the same data: where they follow a tumbling body differently far, of what all follow."""
    ends = [tuple(max(e.times, default=0.0) for e in r.fit.optimum.experiments) for r in rivals]
    least = tuple(map(min, zip(*ends, strict=True)))
    return [
        r if end == least or r.likelihood is None else replace(r, likelihood=_up_to(problem, r.fit, least))
        for problem, r, end in zip(problems, rivals, ends, strict=True)
    ]


def _up_to(problem: Problem, found: Fit, ends: Sequence[float]) -> Likelihood:
    """Likelihood of the beginning of each record, up to ``ends`` [s], at its own optimum, which is sought from the fit's."""
    cut = problem.until(ends)
    model = build(cut, cut.fitted)
    point = model.point(found.optimum.model.values(np.asarray(found.optimum.end.point)))
    noise = noise_model.Estimate({}, {}, [])
    for _ in range(2):
        if not noise_model.known(cut.fitted):
            model, noise = noise_model.estimate(model, cut.fitted, point)
        point = levenberg(evaluator(model), point[None], _STEPS, budget(model).tolerance).points[0]
    residuals = np.asarray(evaluator(model)(point[None])[0][0])
    return likelihood_of(cut.fitted, model, residuals, noise)


def rival(name: str, problem: Problem, found: Fit) -> Rival:
    """A model's scores: likelihood, held-out error, seconds a prediction."""
    at = found.optimum
    likelihood = (
        None if problem.loss != "linear" else likelihood_of(at.experiments, at.model, at.end.residuals, at.noise)
    )
    errors = [e["rms_error_of_peak"] for e in (found.held_out or {}).values()]
    score = float(np.sqrt(np.mean(np.square(errors)))) if errors else None
    return Rival(name, found, likelihood, score, _seconds(at.model, at.end.point))


def likelihood_of(
    fitted: tuple[Experiment, ...], model: Model, residuals: np.ndarray, found: noise_model.Estimate
) -> Likelihood:
    """Likelihood of records at an optimum, with estimated deviations where they are likeliest."""
    weights, memory = np.asarray(model.data.weights), np.asarray(model.data.memory)
    seen = weights > 0
    white, own = residuals[: seen.size].reshape(seen.shape), residuals[seen.size :]
    weighted = np.asarray(model.data.feature_weights).ravel()
    weighted = weighted[weighted > 0]
    volume = 0.5 * np.sum(np.log1p(-(memory[seen] ** 2))) - np.sum(np.log(weights[seen])) - np.sum(np.log(weighted))
    deviance = 2.0 * float(volume) + float(own @ own)
    for i, experiment in enumerate(fitted):
        for channel in experiment.channels:
            j = model.channels.index(channel.observes)
            deviance += float(np.sum(white[i, j][seen[i, j]] ** 2)) if channel.sigma is not None else 0.0
    for name in found.sigma:
        j = model.channels.index(name)
        rows = [i for i, e in enumerate(fitted) for c in e.channels if c.observes == name and c.sigma is None]
        squares = white[rows, j][seen[rows, j]] ** 2
        # The deviation found allows for the parameters; the likeliest one does not.
        deviance += squares.size * (1.0 + float(np.log(squares.mean())))
    samples = int(seen.sum()) + weighted.size
    numbers = len(model.coordinates) + len(found.sigma) + len(found.correlation)
    return Likelihood(deviance + samples * float(np.log(2.0 * np.pi)), numbers, samples)


def decided(rivals: Sequence[Rival]) -> Choice:
    """Rank fitted models and choose the cheapest that is kept, or where none is, the best predictor.

    Ranked by held-out score where all have one, else by BIC, else by their own cost. Kept are those whose
    verdict is neither ``misfit`` nor ``not_converged``, less those that BIC decisively refuses among them. The cheapest
    is the one of fewest numbers among those within ``AS_FAST`` of the fastest.
    """
    passing = [r for r in rivals if not r.refused]
    lowest = min((r.bic for r in passing), default=float("inf"))
    names = {r.name for r in passing if r.bic <= lowest + DECISIVE or not np.isfinite(lowest)}
    by_held_out = all(r.held_out is not None for r in rivals)
    by_bic = all(r.likelihood is not None for r in rivals)

    def score(r: Rival) -> float:
        if by_held_out:
            return float(r.held_out or 0.0)
        return r.bic if by_bic else float(r.fit.residual["rms_of_peak"])

    ranked = tuple(replace(r, kept=r.name in names) for r in sorted(rivals, key=score))
    kept = [r for r in ranked if r.kept]
    by = "the held-out prediction" if by_held_out else "BIC" if by_bic else "the size of its residuals"
    if not kept:
        best = ranked[0]
        why = f"the data refuse every model; '{best.name}' is the best by {by}; its verdict is {best.fit.verdict}"
        return Choice(ranked, best.name, [why, *_differences(best, ranked)])
    quick = [r for r in kept if r.seconds <= AS_FAST * min(r.seconds for r in kept)]
    best = min(quick, key=lambda r: (len(r.fit.labels), score(r)))
    others = ", ".join(f"'{r.name}'" for r in kept if r.name != best.name)
    why = f"'{best.name}' is the cheapest model that the data do not refuse; they do not ask for {others}"
    why = why if others else f"'{best.name}' is the only model that the data do not refuse"
    return Choice(ranked, best.name, [why, *_differences(best, ranked)])


def table(choice: Choice) -> list[list[str]]:
    """The ranking, a row a model: for a terminal or a report."""
    lowest = min((r.bic for r in choice.rivals), default=0.0)
    lowest_aicc = min((r.likelihood.aicc for r in choice.rivals if r.likelihood), default=0.0)
    rows = [["model", "verdict", "held-out rms", "BIC - best", "AICc - best", "numbers found", "time a prediction", ""]]
    for r in choice.rivals:
        remark = "chosen" if r.name == choice.chosen else "" if r.kept else "refused"
        held_out = "-" if r.held_out is None else f"{r.held_out:.2%} of the peak"
        found = r.likelihood
        criteria = [f"{found.bic - lowest:.1f}", f"{found.aicc - lowest_aicc:.1f}"] if found else ["-", "-"]
        count, seconds = str(found.numbers if found else len(r.fit.labels)), format_si(r.seconds, "s")
        rows.append([r.name, r.fit.verdict, held_out, *criteria, count, seconds, remark])
    return rows


def as_json(choice: Choice) -> dict[str, Any]:
    """``models.json``: the models ranked, the one chosen and why."""
    return {
        "chosen": choice.chosen,
        "reasons": choice.reasons,
        "models": [
            {
                "name": r.name,
                "verdict": r.fit.verdict,
                "reasons": r.fit.reasons,
                "kept": r.kept,
                "held_out_rms_of_peak": r.held_out,
                "bic": r.likelihood and r.likelihood.bic,
                "aicc": r.likelihood and r.likelihood.aicc,
                "minus_two_log_likelihood": r.likelihood and r.likelihood.deviance,
                "numbers_found": r.likelihood.numbers if r.likelihood else len(r.fit.labels),
                "samples": r.likelihood.samples if r.likelihood else r.fit.residual["samples"],
                "prediction_s": r.seconds,
                "parameters": briefly(r.fit.parameters),
            }
            for r in choice.rivals
        ],
    }


def _differences(best: Rival, ranked: Sequence[Rival]) -> list[str]:
    """What each other model lacks, or costs, beside the chosen one."""
    said = []
    for r in ranked:
        if r.name == best.name:
            continue
        parts = []
        if r.held_out is not None and best.held_out:
            parts.append(f"its held-out error is {r.held_out / best.held_out:.3g} times as large")
        if r.likelihood and best.likelihood:
            more = r.likelihood.bic - best.likelihood.bic
            parts.append(f"its BIC is {abs(more):.3g} {'higher' if more > 0 else 'lower'}")
        if not r.kept:
            why = f"its verdict is {r.fit.verdict}" if r.refused else "a model of lower BIC fits far better"
            parts.append(why)
        said.append(f"'{r.name}': {', '.join(parts)}")
    return said


def _seconds(model: Model, point: np.ndarray) -> float:
    """Shortest of three predictions of all records, compiled before."""
    frame, numbers = divided(model)
    arguments = numbers, np.asarray(point)
    predict, _ = program("calibration prediction", _predicted, (frame,), arguments)
    predict(*arguments)
    taken = []
    for _ in range(3):
        begin = time.perf_counter()
        predict(*arguments)
        taken.append(time.perf_counter() - begin)
    return min(taken)


def _predicted(frame: Model, numbers: tuple[Any, ...], point: Array) -> Array:
    return whole(frame, numbers).predictions(point)
