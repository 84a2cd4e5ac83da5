"""The setting to take for an error budget, as TOML; docs/tradeoff.md gives the rules and their reasons.

A setting is within a budget if ``SAFETY`` times its expected error is: the worst of force rms, peak and impulse there, on the
next looser level of its ladder and on every tighter one that was run. A solver that was off by more than ``LOST`` on any level
is not recommended on another. Of those as cheap, within the ``NOISE`` of walls, one that keeps the model is taken, then one
that keeps the solver, then the most accurate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bcfj_jax.analysis.tradeoff.measures import MAIN, worst
from bcfj_jax.analysis.tradeoff.reference import NOT_ASKED, Reference
from bcfj_jax.analysis.tradeoff.settings import AS_GIVEN, MODEL, Setting
from bcfj_jax.analysis.tradeoff.study import OK, Study
from bcfj_jax.core.quantities import percent

BUDGETS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.001)
SAFETY = 2.0
LOST = 1.0
NOISE = 0.25


def expected(study: Study) -> list[float]:
    """Error of each setting that a budget is held against, see the top of the file; inf for none."""
    ladders: dict[str, list[tuple[float, float]]] = {}
    for setting, row in zip(study.settings, study.rows, strict=True):
        if row["status"] == OK:
            error = worst(row)
            ladders.setdefault(setting.ladder, []).append((setting.error, error if math.isfinite(error) else math.inf))

    def one(setting: Setting, row: Mapping[str, Any]) -> float:
        if row["status"] != OK or setting.group in ("output", "precision", MODEL):
            return math.inf
        ladder = ladders[setting.ladder]
        if any(error > LOST for _, error in ladder):
            return math.inf
        looser = min((asked for asked, _ in ladder if asked > setting.error), default=setting.error)
        return max(error for asked, error in ladder if asked <= looser)

    return [one(*pair) for pair in zip(study.settings, study.rows, strict=True)]


def recommended(study: Study) -> dict[str, dict[str, Any]]:
    """By budget ("1 %"): setting, its TOML, what it changes, its errors and wall; or why there is none."""
    trusted = study.reference is not None and study.reference.truth is not None
    known = expected(study)
    return {f"{100 * budget:g} %": _one(study, known, budget, trusted) for budget in BUDGETS}


def _one(study: Study, known: Sequence[float], budget: float, trusted: bool) -> dict[str, Any]:
    if not trusted or study.reference is None:
        return {"setting": None, "reason": "no reference to compare with"}
    if SAFETY * study.reference.least_error > budget:
        return {"setting": None, "reason": f"the reference is certain to {study.reference.least_error:.1e} only"}
    every = enumerate(zip(study.settings, known, strict=True))
    within = [k for k, (setting, error) in every if SAFETY * error <= budget and asks(setting, budget)]
    if not within:
        missing = sum(row["status"].startswith("not run") for row in study.rows)
        also = f"; {missing} settings were not run" if missing else ""
        return {"setting": None, "reason": f"no setting that was run keeps it{also}"}
    cheapest = min(study.rows[k]["wall_s"] for k in within)
    near = [k for k in within if study.rows[k]["wall_s"] <= (1.0 + NOISE) * cheapest]
    kept = study.settings[0].table["accuracy"].get("solver")

    def preferred(k: int) -> tuple[bool, bool, float]:
        setting = study.settings[k]
        return bool(setting.physics), setting.table["accuracy"].get("solver") != kept, known[k]

    best = min(near, key=preferred)
    setting, row, own = study.settings[best], study.rows[best], study.rows[0]
    as_fast = own["wall_s"] / row["wall_s"] if own["status"] == OK and own["setting"] == AS_GIVEN else None
    return {
        "setting": setting.name, "wall_s": row["wall_s"], "times_as_fast_as_given": as_fast,
        "errors": {name: row[name] for name in MAIN}, "expected_error": known[best],
        "physics": setting.physics or "the model is the given one", **pasted(setting, f"{100 * budget:g} %"),
    }  # fmt: skip


def asks(setting: Setting, budget: float) -> bool:
    """Whether a setting asks for a budget, or for less; equilibria and closed forms ask for no error."""
    return not setting.integrated or setting.error <= budget


def shared(advice: Mapping[str, Mapping[str, Any]]) -> list[tuple[Mapping[str, Any], str]]:
    """The advice for each recommended setting, of several budgets that of the last, and what it is for: "5 %, 2 %"."""
    found: dict[str, list[str]] = {}
    for budget, one in advice.items():
        if one["setting"]:
            found.setdefault(one["setting"], []).append(budget.removesuffix(" %"))
    return [(advice[f"{budgets[-1]} %"], f"{', '.join(budgets)} %") for budgets in found.values()]


def pasted(setting: Setting, budget: str) -> dict[str, str]:
    """As TOML what of the user's file it changes, "" for the file as it stands; and the whole, which ``scenefile`` loads."""
    import tomli_w

    head = f"# Recommended by bcfj tradeoff for an error of {budget}: {setting.name}.\n"
    head += f"# Another model than the given one: {setting.physics}.\n" if setting.physics else ""
    change = tomli_w.dumps({section: dict(values) for section, values in setting.change.items()})
    return {"change": change, "toml": head + tomli_w.dumps(dict(setting.table))}


def doubts(reference: Reference | None) -> list[str]:
    """What to know of the reference before its numbers are believed."""
    if reference is None:
        return ["the study ended before its reference was computed"]
    certificate = reference.certificate
    if reference.truth is None:
        return [f"no reference: {certificate['reason']}"]
    found, smallest = [], BUDGETS[-1]
    if not np.any(reference.truth.force):
        nothing = "no contact touches at any sample: every error is 0 and says nothing"
        found.append(f"{nothing}; a later [time] end is needed")
    if SAFETY * reference.least_error > smallest:
        why = f": {certificate['reason']}" if certificate["reason"] else ""
        found.append(
            f"the two references differ by {worst(certificate['errors']):.1e}: budgets below "
            f"{percent(SAFETY * reference.least_error, 2)} cannot be tested{why}"
        )
    if reference.slopes is None and certificate["derivatives"]["reason"] != NOT_ASKED:
        found.append(f"no reference for derivatives: {certificate['derivatives']['reason']}")
    return found
