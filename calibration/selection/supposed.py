"""What a fit that its record contradicts would be if the doubt is right: the same with another parameter free."""

from __future__ import annotations

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
    conditions = [doubt.condition for doubt in doubts]
    return with_another(found, freed(problem, doubts), starts, "with doubted values free", conditions)


def with_another(
    found: Fit, problem: Problem, starts: int, what: str, conditions: list[str],
    known: dict[str, Parameter] | None = None,
) -> Fit:  # fmt: skip
    """A fit that gives no interval, with those of another problem's fit that holds on conditions: ``conditional``.

    Unchanged where that fit fails or gives none. ``what``: it is, for its reasons. ``known``: estimates that need no fit; then
    of others only what the fit itself has a name for.
    """
    try:
        with stage(what):
            one = fit(problem, seed=found.seed, starts=starts)
    except (InputError, AllStartsFailed):
        return found
    because, own, reference = [], one.parameters, one.reference
    if one.conditional:
        conditions = [*conditions, one.conditional.condition]
        own, reference = {**own, **one.conditional.parameters}, one.conditional.reference
        because = [text for text in one.data.because[:1] if not any(text in said for said in found.data.because)]
    own = {name: p for name, p in own.items() if p.ci95 and (known is None or name in found.parameters.keys() - known)}
    if not own:
        return found
    reasons = [f"{what}: {text}" for text in because]
    return replace(
        found,
        conditional=Conditional(" and ".join(dict.fromkeys(conditions)), {**(known or {}), **own}, reference),
        data=Answer(found.data.answer, [*reasons, *found.data.because]),
        reasons=[*reasons, *found.reasons],
        systematic=one.systematic,
    )


def freed(problem: Problem, doubts: list[Doubt]) -> Problem:
    """The problem with what doubts name free, between the least and the most that any of them leaves."""
    names = dict.fromkeys(doubt.name for doubt in doubts)
    free = [f for f in problem.free if f.name not in names]
    for name in names:
        own = [doubt for doubt in doubts if doubt.name == name]
        low, high = min(doubt.lower for doubt in own), max(doubt.upper for doubt in own)
        free.append(Free(name, low, high, each=any(doubt.each for doubt in own)))

    def without(one: Any, *keys: str) -> Any:
        return replace(one, **{k: {n: x for n, x in getattr(one, k).items() if n not in names} for k in keys})

    experiments = tuple(without(e, "fixed", "tolerances", "bounds") for e in problem.experiments)
    left = tuple(doubt for doubt in problem.doubts if not doubt.name)
    rest = {n: x for n, x in problem.tolerances.items() if n not in names}
    return replace(problem, free=tuple(free), experiments=experiments, tolerances=rest, doubts=left)
