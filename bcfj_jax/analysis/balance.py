"""Whether what a run says of its forces agrees with what it says of its motion: balances of momentum and energy.

    p(t) - p(0) = integral of dp/dt,   E(t) - E(0) = work given - work taken

at the end of every step (or at every sample), for every generalised momentum of a mechanism (``instruments.momenta``) and for
the energy of every model that has ``flows``. The left sides are those of the states, the rates follow from forces and powers
in the states. The integral is that of the solver's steps where they were looked at (``Run.totals``), else that of the samples
(``solve.extremes.sampled``).

An error is a share of the largest term: of the momentum or energy at either end, and of the integral of the sizes of all
forces, torques and powers. Allowed are the force error asked for and the error of the quadrature, which is bounded by the
difference of two rules. Samples prove no error below 1 %: what turns between two of them is in neither rule. What the samples
show and no step has met was stepped over. NumPy, on the host.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import numpy as np

from bcfj_jax.analysis import features
from bcfj_jax.core.quantities import percent
from bcfj_jax.io.outputs import channels
from bcfj_jax.io.page import brief
from bcfj_jax.mechanism.model import AbstractModel, Params
from bcfj_jax.solve.extremes import Totals, sampled
from bcfj_jax.solve.simulation import Run
from bcfj_jax.xla.programs import QUICK, program

CLOSED, MISSED, UNKNOWN = "closed", "missed", "unknown"
# A sample may exceed what is greatest in the steps by this factor: they are looked at twice a step.
_BEYOND = 1.5
# Of the mean size of all forces on a velocity, what a sample may exceed the steps by besides.
_MEAN = 0.1
# Least error that samples can prove, how many times their bound it must be beyond, and the bound from which on they are too few.
_PROVEN, _TIMES, _FEW = 1e-2, 3.0, 0.05
_UNITS = {"momentum": "N s", "angular_momentum": "N m s", "energy": "J"}


class Error(NamedTuple):
    """Error of one balance and what is allowed, shares of its largest term."""

    error: float
    allowed: float

    @property
    def closed(self) -> bool:
        """Whether the error is no larger than that; NaN is not."""
        return self.error <= self.allowed


class Balance(NamedTuple):
    """What the balances of a run say."""

    verdict: str  # ``CLOSED``, ``MISSED`` or ``UNKNOWN``
    reason: str  # what is missed, or why nothing can be said, as a sentence; "" for closed
    quadrature: str = ""  # "steps" or "samples"; "" for none
    # By body, and "scene" for the energy, by "momentum", "angular_momentum" or "energy".
    errors: dict[str, dict[str, Error]] = {}

    def worst(self) -> tuple[str, str, Error] | None:
        """Body, quantity and error of the balance that is furthest from what is allowed; None for none."""
        every = [(body, what, one) for body, found in self.errors.items() for what, one in found.items()]
        return max(every, key=lambda x: np.inf if np.isnan(x[2].error) else x[2].error / x[2].allowed, default=None)

    def sentence(self) -> str:
        """The verdict in words."""
        worst = self.worst()
        if self.verdict != CLOSED or worst is None:
            return self.reason
        body, what, one = worst
        where = "" if what == "energy" else f" of {body}"
        return f"Momentum and energy balance to {percent(one.error, 2)} of the largest term (worst: {_plain(what)}{where})."

    def content(self) -> dict[str, Any]:
        """As ``summary.json`` has it."""
        of = {
            body: {"verdict": CLOSED if all(one.closed for one in found.values()) else MISSED}
            | {what: one._asdict() for what, one in found.items()}
            for body, found in self.errors.items()
        }
        return {
            "verdict": self.verdict, "reason": self.reason, "sentence": self.sentence(), "quadrature": self.quadrature,
            "of": of, "units": {"error": "1", "allowed": "1"},
        }  # fmt: skip


def of_run(model: AbstractModel, params: Params, run: Run, asked: float) -> Balance:
    """The balances of a run that has its trajectory; ``asked``: force error, a fraction of the peak."""
    if run.trajectory is None or not np.all(np.isfinite(run.trajectory)):
        return Balance(UNKNOWN, "The balance is not known: the run did not reach its end.")
    model = model.level(run.choice.fidelity) if run.choice else model
    if not model.traits.history:
        return Balance(
            UNKNOWN, "The balance is not known: the model has no inertia, and every instant is solved for itself."
        )
    arguments = dict(model.completed(params)), run.times, run.trajectory
    return _judged(asked, run, jax.device_get(program("accounts", sampled, (model,), arguments, QUICK)[0](*arguments)))


def _judged(asked: float, run: Run, samples: Mapping[str, Totals]) -> Balance:
    """The balances of a run, whose samples add up to ``samples``."""
    # Contacts that begin and end between two samples.
    depth, rate, steps = channels(run.penetration), channels(run.rate), run.totals
    hidden = [name for name in depth if len(features.unseen(run.times, depth[name], rate[name]))]
    if not samples:
        return Balance(UNKNOWN, "The balance is not known: the model has neither momenta nor an energy balance.")
    quadrature = "steps" if steps else "samples"
    errors: dict[str, dict[str, Error]] = {}
    said, few = [], False
    # The directions of one momentum are measured by the largest.
    for body, what in dict.fromkeys(map(_subject, samples)):
        rows = [(steps or samples)[name] for name in samples if _subject(name) == (body, what)]
        scale = max(_top(x) for row in rows for x in (row.first, row.last, row.size)) or 1.0
        worst = max(rows, key=lambda row: _top(row.miss))
        coarse = _top(worst.coarse) / scale
        few |= not coarse <= _FEW
        one = Error(_top(worst.miss) / scale, asked + coarse if steps else max(asked, _PROVEN) + _TIMES * coarse)
        errors.setdefault(body, {})[what] = one
        if not one.closed:
            said.append(_missed(body, what, worst, one))
    over = _stepped_over(asked, run, samples)
    if over or (said and (steps or not hidden)):
        return Balance(MISSED, " ".join([*over, *said][:1]), quadrature, errors)
    if said or (few and not steps):
        why = f"contacts of {hidden[0]} begin and end between two samples" if hidden else "the samples are too few"
        return Balance(UNKNOWN, f"The balance is not known: {why}.", quadrature, errors)
    return Balance(CLOSED, "", quadrature, errors)


def _subject(name: str) -> tuple[str, str]:
    """Body and quantity of an account."""
    body, what = name.split()[:2] if " " in name else ("scene", name)
    return body, what


def _top(x: Any) -> float:
    return float(np.max(np.abs(x)))


def _plain(what: str) -> str:
    return what.replace("_", " ")


def _missed(body: str, what: str, row: Totals, error: Error) -> str:
    of = "The energy" if what == "energy" else f"The {_plain(what)} of {body}"
    unit, cause = _UNITS[what], "powers" if what == "energy" else "forces"
    return (
        f"{of} and its {cause} contradict each other by {brief(_top(row.miss), unit)}: "
        f"an error of {percent(error.error, 2)}, allowed {percent(error.allowed, 2)}."
    )


def _stepped_over(asked: float, run: Run, samples: Mapping[str, Totals]) -> list[str]:
    """What samples show and no step of the solver has met, in sentences."""
    tops = {name: np.max(np.abs(force[..., 0]), axis=0) for name, force in run.force.items()}
    found, most, duration = [], max((_top(x) for x in tops.values()), default=0.0), float(run.times[-1])
    for name, extremes in run.extremes.items():
        met = np.asarray(extremes.peak)
        beyond = tops[name] > _BEYOND * met + asked * most
        if np.any(beyond):
            k = np.unravel_index(int(np.argmax(np.where(beyond, tops[name], -np.inf))), beyond.shape)
            shown, seen = (brief(float(x[k]), "N") for x in (tops[name], met))
            found.append(
                f"A sample shows {shown} in {name}, the solver's steps {seen} at most: the solver stepped over a contact."
            )
    for name, row in run.totals.items():
        shown, (body, what) = samples[name], _subject(name)
        stronger = shown.greatest > _BEYOND * row.greatest + (_MEAN / duration * row.size if duration > 0.0 else 0.0)
        more = shown.size - shown.coarse > _BEYOND * row.size + asked * np.maximum(np.abs(row.first), np.abs(row.last))
        if np.any(stronger | more):
            at = brief(float(np.ravel(shown.when)[int(np.argmax(shown.greatest))]), "s")
            of = "the energy" if what == "energy" else f"the {_plain(what)} of {body}"
            found.append(
                f"What changes {of} at {at} was met by no step of the solver: the solver stepped over a force."
            )
    return found
