"""What would explain the miss: suspects ranked by residuals, the best of them confirmed by fits with their lines.

A fit with a suspect's lines (``remedies``) is compared with the plain one by BIC. Beside the signature of each that is
fitted the others are ranked again, and the pair that explains most is fitted together.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import equinox as eqx
import numpy as np

from bcfj_jax import InputError
from calibration.diagnostics import suspects
from calibration.diagnostics.catalogue import LOSS
from calibration.diagnostics.signatures import Scene, scene_of
from calibration.diagnostics.suspects import Found
from calibration.fit import AllStartsFailed, Fit, fit
from calibration.forward.model import predictions
from calibration.problem import Problem
from calibration.selection import agreement
from calibration.selection.agreement import Agreement
from calibration.selection.choice import DECISIVE, likelihood_of
from calibration.selection.remedies import altered, joined, laws_of, lines, loss_models, taken
from calibration.solver_budget import budget

log = logging.getLogger("calibration")

# Suspects that are fitted, if they explain more than this share of what the best one does; starts of such a fit.
_MOST, _NEAR, _STARTS = 3, 0.5, 4
# Share of the held-out squares that a second suspect must explain beside the first, to be fitted with it.
_MORE = 0.05
# Samples of a record that say something of it, at least.
_FEWEST = 4
# Suspects that are another way to lose energy, and the name of the law that was fitted among theirs.
_LOSSES, _PLAIN = (LOSS, "relaxation", "plasticity"), "as fitted"
# What is seen in the readings themselves: a fit has nothing to add.
SEEN = ("quantisation",)


@dataclass(frozen=True)
class Trial:
    """A fit with one or two suspects' lines, of the laws that are fitted for one suspect with ``law``; None where it failed.

    ``gain``: by how much BIC falls against the plain fit.
    """

    names: tuple[str, ...]
    lines: str
    fit: Fit | None
    gain: float
    reason: str = ""
    law: str = ""

    @property
    def label(self) -> str:
        """The suspects, and the law that stands for them."""
        return " and ".join(self.names) + (f": {self.law}" if self.law else "")

    @property
    def confirmed(self) -> bool:
        """Whether the data want it decisively; to leave samples out takes no number that they must pay for."""
        return self.fit is not None and self.gain > (0.0 if self.names == ("saturation",) else DECISIVE)


@dataclass(frozen=True)
class Diagnosis:
    """Suspects, the named one first; their lines by name; the fits with them, the best first where there are any.

    ``agreed``: the elastic force that laws of loss agree on, where another loss is named.
    """

    found: list[Found]
    lines: dict[str, str]
    trials: list[Trial]
    agreed: Agreement | None = None

    @property
    def named(self) -> list[str]:
        """The suspect that is named, and after it those that the fits cannot tell from it; none where none explains."""
        first = [f.name for f in self.found if f.named]
        best = next((t.gain for t in self.alone if [t.names[0]] == first), np.inf)
        return [*dict.fromkeys(first + [t.names[0] for t in self.alone if best - t.gain < DECISIVE])]

    @property
    def alone(self) -> list[Trial]:
        """Fits with one suspect that the data want, the best first."""
        return [t for t in self.trials if len(t.names) == 1 and t.confirmed]


def rank(problem: Problem, result: Fit) -> Diagnosis | None:
    """The suspects by residuals alone: no fit. None of a rough cost, a robust loss, and noise that is the integrator's."""
    scene = _scene(problem, result)
    if scene is None:
        return None
    ranking = _ranked(problem, result, scene)
    losses = [f for f in ranking.found if f.name in _LOSSES and f.likely]
    agreed = agreement.of_signatures(result, _PLAIN, losses) if {*ranking.named} & {*_LOSSES} else None
    return replace(ranking, agreed=agreed)


def diagnose(problem: Problem, result: Fit, seed: int = 0) -> Diagnosis | None:
    """The suspects, the best confirmed by fits; None as ``rank``."""
    scene = _scene(problem, result)
    if scene is None:
        return None
    ranking = _ranked(problem, result, scene)
    likely = [f for f in ranking.found if f.likely and f.explained > _NEAR * ranking.found[0].explained]
    likely = [f for f in likely if ranking.lines[f.name] and f.name not in SEEN][:_MOST]
    trials = [
        _trial(problem, result, (f.name,), text, seed, law)
        for f in likely
        for law, text in (loss_models(scene, problem) if f.name == LOSS else {"": ranking.lines[f.name]}).items()
    ]
    trials.sort(key=lambda t: (not t.confirmed, -t.gain))
    # Of two at once one may explain nothing alone: every suspect is tried as the first.
    pairs = [
        (1.0 - (1.0 - f.explained) * (1.0 - g.explained), f.name, g.name, text)
        for f in (ranking.found if trials else [])
        for g, text in _beside(problem, result, scene, f, ranking.lines[f.name])
        if LOSS not in (f.name, g.name)
    ]
    losses = {_PLAIN: result} | {t.law or t.label: t.fit for t in trials if t.names[0] in _LOSSES and t.fit}
    if pairs and max(pairs)[0] > ranking.found[0].explained + _MORE:
        _, first, second, text = max(pairs)
        trials.append(_trial(problem, result, (first, second), text, seed))
    found = _confirmed(Diagnosis(ranking.found, ranking.lines, trials))
    return replace(found, agreed=agreement.of_fits(losses)) if {*found.named} & {*_LOSSES} else found


def _scene(problem: Problem, result: Fit) -> Scene | None:
    at = result.optimum
    if not at.series or budget(problem).rough or problem.loss != "linear" or at.noise.integrator:
        return None
    if at.spread.covariance is None or min(s.rows.size for s in at.series) < _FEWEST:
        return None
    readings = predictions(at.model, at.end.point)
    return scene_of(at.model, at.series, readings, at.end.point)


def _ranked(problem: Problem, result: Fit, scene: Scene, first: Found | None = None) -> Diagnosis:
    """The ranking of the suspects, or of the others beside a first one's signature."""
    residuals, jacobian = result.optimum.end.residuals, result.optimum.end.jacobian
    known = taken(problem)
    if first is not None and first.columns is not None:
        known |= {first.name}
        if first.given:
            residuals = residuals + first.columns[:, 0]
        else:
            jacobian = np.hstack([jacobian, first.columns[:, np.any(first.columns, axis=0)]])
    found = suspects.ranked(scene, residuals, jacobian, laws_of(problem), known)
    return Diagnosis(found, {f.name: lines(f, scene, problem, result) for f in found}, [])


def _beside(problem: Problem, result: Fit, scene: Scene, first: Found, text: str) -> list[tuple[Found, str]]:
    """The suspect that explains most of what a first one leaves, and the lines of both; none where none does."""
    if first.columns is None:
        return []
    others = _ranked(problem, result, scene, first)
    return [(f, both) for f in others.found if f.named and (both := joined(text, others.lines[f.name]))]


def _confirmed(d: Diagnosis) -> Diagnosis:
    """With the name that the fits give: that of the best fit, where the residuals named one that was fitted."""
    if not d.alone or (d.found[0].name,) not in [t.names for t in d.trials]:
        return d
    best = d.alone[0].names[0]
    found = [f._replace(named=f.name == best) for f in d.found]
    return replace(d, found=sorted(found, key=lambda f: not f.named))


def _trial(problem: Problem, plain: Fit, names: tuple[str, ...], text: str, seed: int, law: str = "") -> Trial:
    log.info("diagnosis: a fit with %s", law or " and ".join(names))
    try:
        other = altered(problem, text, plain)
        found = fit(other, seed=seed, starts=_STARTS, systematic=False)
    except (InputError, AllStartsFailed) as error:
        return Trial(names, text, None, 0.0, str(error), law)
    # On the samples that both have: those at a sensor's limit are dropped.
    weights = np.where(
        np.asarray(found.optimum.model.data.weights) > 0, np.asarray(plain.optimum.model.data.weights), 0
    )
    return Trial(names, text, found, _bic(plain, weights) - _bic(found), law=law)


def _bic(found: Fit, weights: np.ndarray | None = None) -> float:
    at = found.optimum
    model, residuals = at.model, at.end.residuals
    if weights is not None:
        model = eqx.tree_at(lambda m: m.data.weights, model, weights)
        residuals = np.r_[residuals[: weights.size] * (weights.ravel() > 0), residuals[weights.size :]]
    return likelihood_of(at.experiments, model, residuals, at.noise).bic
