"""What a fit that its record contradicts would be if the doubt is right: the same with another parameter free."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from bcfj_jax import InputError
from bcfj_jax.core.progress import stage
from calibration.diagnostics.answers import Answer
from calibration.fit import AllStartsFailed, Conditional, Fit, Parameter, fit
from calibration.problem import Doubt, Free, Problem

STANDS = ("identified", "adequate")


def with_doubts_right(problem: Problem, found: Fit, starts: int) -> Fit:
    """A fit that gives no interval, with those of the fit in which doubted values are free: ``conditional``.

    Unchanged where no doubt names a parameter, and where that fit gives no interval either.
    """
    doubts = [doubt for doubt in problem.doubts if doubt.name]
    if not doubts or found.verdict in STANDS:
        return found
    with stage("with doubted values free"):
        one = fitted(freed(problem, doubts), found.seed, starts)
    if one is None:
        return found
    return attached(found, one, [doubt.condition for doubt in doubts], {}, "with doubted values free")


def freed(problem: Problem, doubts: list[Doubt]) -> Problem:
    """The problem with what doubts name free, between the least and the most that any of them leaves."""
    names = dict.fromkeys(doubt.name for doubt in doubts)
    free = [f for f in problem.free if f.name not in names]
    for name in names:
        own = [doubt for doubt in doubts if doubt.name == name]
        low, high = min(doubt.lower for doubt in own), max(doubt.upper for doubt in own)
        free.append(Free(name, low, high, each=any(doubt.each for doubt in own)))

    def others(own: Mapping[str, Any]) -> dict[str, Any]:
        return {name: x for name, x in own.items() if name not in names}

    experiments = tuple(
        replace(e, fixed=others(e.fixed), tolerances=others(e.tolerances), bounds=others(e.bounds))
        for e in problem.experiments
    )
    tolerances = others(problem.tolerances)
    left = tuple(doubt for doubt in problem.doubts if not doubt.name)
    return replace(problem, free=tuple(free), experiments=experiments, tolerances=tolerances, doubts=left)


def fitted(problem: Problem, seed: int, starts: int) -> Fit | None:
    """A fit; None where there is none."""
    try:
        return fit(problem, seed=seed, starts=starts)
    except (InputError, AllStartsFailed):
        return None


def attached(found: Fit, one: Fit, conditions: list[str], known: dict[str, Parameter], what: str) -> Fit:
    """A fit that gives no interval, with those of another that holds on conditions: ``conditional``.

    Args:
        found: the fit.
        one: the other.
        conditions: on which it holds, before its own.
        known: estimates that need no fit, with their intervals.
        what: the other is, for its reasons.
    """
    because, own, reference = [], one.parameters, one.reference
    if one.conditional:
        conditions = [*conditions, one.conditional.condition]
        own, reference = {**own, **one.conditional.parameters}, one.conditional.reference
        because = [text for text in one.data.because[:1] if not any(text in said for said in found.data.because)]
    own = {name: p for name, p in own.items() if p.ci95 and name not in known}
    if not own:
        return found
    reasons = [f"{what}: {text}" for text in because]
    conditional = Conditional(" and ".join(dict.fromkeys(conditions)), {**known, **own}, reference)
    data = Answer(found.data.answer, [*reasons, *found.data.because])
    return replace(
        found, conditional=conditional, data=data, reasons=[*reasons, *found.reasons], systematic=one.systematic
    )
