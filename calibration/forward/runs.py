"""What the simulations at a point of the search space did: why they failed, when and where there was contact."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.jacobian import channel_names
from bcfj_jax.core.errors import InputError
from bcfj_jax.mechanism.channels import Channel, channel, histories, unit_of
from bcfj_jax.mechanism.model import AbstractModel, Params, Reading, Solution
from bcfj_jax.solve.plan import Plan
from bcfj_jax.solve.simulation import Run, outcome, story
from bcfj_jax.xla.programs import program
from calibration.forward.model import Model

# Times of a run that is looked at by itself; as many always, so that all share one program.
SAMPLES = 2001
# Of them at the record's own times.
_OWN = 1000
# Parameters that mean a gap without being called so, with the contact that closes it.
_GAPS = {"drop_height": "contact"}
_PREFIX = "clearance_"
_NOT_DIFFERENTIABLE = "the simulation ends well, but its derivative is not finite"


class Contact(NamedTuple):
    """One channel of contact in one experiment's record: (T,) times [s] of the model's clock and whether it touches.

    ``offset`` [s] is how far the record's clock is ahead of that; ``turned``: whether it is deepest before the end;
    ``deepest`` [m] and ``peak`` [N]: greatest penetration and normal force.
    """

    experiment: int
    name: str
    offset: float
    times: np.ndarray
    touching: np.ndarray
    turned: bool
    deepest: float = 0.0
    peak: float = 0.0

    @property
    def durations(self) -> np.ndarray:
        """Of each contact, as far as it is inside the record [s]."""
        return np.array([self.times[last - 1] - self.times[first] for first, last in stretches(self.touching)])


def stretches(inside: np.ndarray) -> list[tuple[int, int]]:
    """First samples of runs of true values in (T,), each with the first after it."""
    edges = np.flatnonzero(np.diff(np.r_[False, inside, False].astype(int))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def together(contacts: list[Contact]) -> Contact:
    """Several channels of one experiment as one, which touches where any of them does."""
    return contacts[0]._replace(touching=np.any([c.touching for c in contacts], axis=0))


def of_contacts(model: Model) -> bool:
    """Whether a fit is of contacts: a coefficient of one is searched, or one is read."""
    scene = model.scene
    shared = {n for c in scene.contacts for part in (c.law, c.friction) if part is not None for n in part.needs}
    own = [axis.name.partition(".")[0] for axis in model.coordinates]
    read = [name.partition(".")[0] for name in model.channels]
    names = channel_names(scene.members)
    searched = any(axis.name in shared or gap_of(axis.name) is not None for axis in model.coordinates)
    return searched or not {*scene.members, *names}.isdisjoint([*own, *read])


def gap_of(name: str) -> str | None:
    """The contact whose gap a parameter is; None for one that is no clearance."""
    return name.removeprefix(_PREFIX) if name.startswith(_PREFIX) else _GAPS.get(name)


def ran(model: Model, params: Mapping[str, float], times: np.ndarray, more: Iterable[str] = ()) -> Run:
    """One run as the model integrates it, with what its channels read, and ``more`` of them; nothing is checked.

    Args:
        params: parameters [SI] by name; what is none of the scene's is passed over.
        times: (T,) [s] of the scene's clock. Runs of as many share one compiled program.
    """
    run, compile_s, arguments = _compiled(model, params, times, more)
    begin = time.perf_counter()
    solution, found, read = run(*arguments)
    walls = {"wall_s": time.perf_counter() - begin, "compile_s": compile_s}
    return story(model.scene, times, solution, found, model.how, walls)._replace(readings=read)


def _compiled(
    model: Model, params: Mapping[str, float], times: np.ndarray, more: Iterable[str]
) -> tuple[Callable[..., Any], float, tuple[Any, ...]]:
    """The program of ``ran``, the seconds that compiling it took, and its arguments."""
    names = tuple(dict.fromkeys((*model.channels, *more)))
    wanted = tuple(channel(name, model.scene) for name in names)
    arguments = ({name: float(params[name]) for name in model.data.fixed}, times, model.how)
    return *program("calibration run", _run, (model.scene, wanted), arguments), arguments


def _run(
    scene: AbstractModel, wanted: tuple[Channel, ...], params: Params, times: Array, how: Plan
) -> tuple[Solution, dict[str, Reading], dict[str, Array]]:
    """By the solver that is meant for derivatives, as the residuals are."""
    solution, found = outcome(scene, params, times, how, "forward", True)
    read = histories(scene, params, times, solution.states, wanted) if wanted else {}
    return solution, found, read


def params_at(model: Model, point: np.ndarray) -> list[dict[str, float]]:
    """Parameters and nuisances of each experiment, by name, at a point."""
    table, chain = model.settings(np.asarray(point))
    return [
        {name: float(values[i]) for known in (chain, table) for name, values in known.items()}
        for i in range(len(model.data.times))
    ]


def _spans(model: Model) -> np.ndarray:
    """First and last time (E, 2) of each experiment in its own clock [s]; features are of a run from 0 on, and so is motion,
    which contacts before its first reading have changed.
    """
    times, read = np.asarray(model.data.times), np.asarray(model.data.weights) > 0
    seen, forces = np.any(read, axis=1), [unit_of(name) == "N" for name in model.channels]
    spans = np.array([[t[s].min(initial=np.inf), t[s].max(initial=-np.inf)] for t, s in zip(times, seen, strict=True)])
    motion = ~read[:, forces].any(axis=(1, 2))
    spans[motion, 0] = np.minimum(spans[motion, 0], 0.0)
    for i, observed in enumerate(model.observed_features):
        if observed.names:
            spans[i] = min(spans[i, 0], 0.0), max(spans[i, 1], observed.end)
    return spans


def clocks(model: Model, point: np.ndarray) -> list[tuple[dict[str, float], np.ndarray]]:
    """Of each experiment its parameters at a point, and SAMPLES times of the model's clock within its record [s]."""
    found = []
    for i, (params, span) in enumerate(zip(params_at(model, point), _spans(model), strict=True)):
        first, last = np.maximum(span - params["time_offset"], 0.0)
        found.append((params, instants(model, i, params["time_offset"], first, max(last, first + 1e-9))))
    return found


def contacts(model: Model, point: np.ndarray) -> list[Contact]:
    """When each channel of contact touches within each record, as the model has it at a point."""
    names, found = channel_names(model.scene.members), []
    for i, (params, times) in enumerate(clocks(model, point)):
        # Not by the force: the regularisation bears a little across a gap.
        run = ran(model, params, times)
        inside = _side_by_side(run, run.penetration.values())
        force = np.abs(_side_by_side(run, (f[..., 0] for f in run.force.values())))
        turned = (inside.max(axis=0) > 0) & (inside.argmax(axis=0) < SAMPLES - 1)
        deepest, peaks = inside.max(axis=0), force.max(axis=0)
        found += [
            Contact(
                i, name, params["time_offset"], times, inside[:, k] > 0, bool(turned[k]), float(deepest[k]),
                float(peaks[k]),
            )
            for k, name in enumerate(names)
        ]  # fmt: skip
    return found


def instants(model: Model, experiment: int, offset: float, first: float, last: float) -> np.ndarray:
    """SAMPLES times [s] from first to last: those of the record at which most is read, and others between.

    A hard contact may take less than a thousandth of the record, and lies where the data are large.
    """
    d = model.data
    seen = np.asarray(d.weights)[experiment] > 0
    size = np.max(
        np.abs(np.where(seen, np.asarray(d.values)[experiment] * np.asarray(d.weights)[experiment], 0.0)),
        axis=0,
        initial=0.0,
    )
    own = np.asarray(d.times)[experiment] - offset
    order = np.argsort(-size, kind="stable")
    largest = own[order[(size[order] > 0) & (own[order] > first) & (own[order] < last)]][:_OWN]
    chosen = np.unique(np.concatenate([largest, np.linspace(first, last, SAMPLES - _OWN)]))
    # Equal times are filled up between the others.
    while chosen.size < SAMPLES:
        gaps = np.diff(chosen)
        widest = np.argsort(-gaps, kind="stable")[: SAMPLES - chosen.size]
        chosen = np.unique(np.concatenate([chosen, chosen[widest] + 0.5 * gaps[widest]]))
    return chosen


def _side_by_side(run: Run, read: Iterable[np.ndarray]) -> np.ndarray:
    """Readings of contacts, (T,) or (T, members) each, as (T, C) of all channels."""
    count = len(run.times)
    return np.concatenate([np.zeros((count, 0)), *(x.reshape(count, -1) for x in read)], axis=1)


def refusal(model: Model, point: np.ndarray) -> str:
    """Why the values at a point are no parameters of the scene, as one that contradicts another; "" if they are."""
    for params in params_at(model, point):
        try:
            model.scene.check(model.scene.parameters({name: params[name] for name in model.data.fixed}))
        except InputError as error:
            return str(error)
    return ""


def failure(model: Model, point: np.ndarray) -> str:
    """Why the simulations at a point do not count, in words."""
    if refused := refusal(model, point):
        return refused
    for params, (first, last) in zip(params_at(model, point), _spans(model), strict=True):
        run = ran(model, params, np.linspace(min(first, 0.0), max(last, 1e-9), SAMPLES))
        if run.status != "ok":
            return run.reason
    return _NOT_DIFFERENTIABLE


def commonest_failure(model: Model, points: np.ndarray) -> str:
    """The reason that most of some points share, and how many of them."""
    found = Counter(failure(model, point) for point in points)
    text, count = found.most_common(1)[0]
    return f"{text} ({count} of {len(points)})" if len(found) > 1 else text
