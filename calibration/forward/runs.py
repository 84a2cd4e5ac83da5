"""What the simulations at a point of the search space did: why they failed, when and where there was contact."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis.derivatives.jacobian import by_channel, channel_names
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.status import OK, reason
from bcfj_jax.solve.simulation import outcome
from calibration.forward.model import Model

_SAMPLES = 2001
_NOT_DIFFERENTIABLE = "the simulation ends well, but its derivative is not finite"


class Contact(NamedTuple):
    """One channel of contact in one experiment's record: (T,) times [s] of the model's clock and whether it touches.

    ``offset`` [s] is how far the record's clock is ahead of that; ``turned``: whether it is deepest before the end.
    """

    experiment: int
    name: str
    offset: float
    times: np.ndarray
    touching: np.ndarray
    turned: bool

    @property
    def durations(self) -> np.ndarray:
        """Of each contact, as far as it is inside the record [s]."""
        ends = np.flatnonzero(np.diff(np.r_[False, self.touching, False]))
        return self.times[ends[1::2] - 1] - self.times[ends[::2]]


def together(contacts: list[Contact]) -> Contact:
    """Several channels of one experiment as one, which touches where any of them does."""
    return contacts[0]._replace(touching=np.any([c.touching for c in contacts], axis=0))


@eqx.filter_jit
def _depths(model: Model, point: Array, log_depth: Array, times: Array) -> tuple[Array, Array]:
    """Penetrations (E, T, C) of all contacts at times (E, T), and how each run ended (E,)."""
    table, _ = model.settings(point, log_depth)

    def one(params: dict, times: Array) -> tuple[Array, Array]:
        solution, readings = outcome(model.scene, params, times, model.how, "forward", True)
        depth = by_channel(model.scene, readings)[1] if readings else jnp.zeros((times.size, 0))
        return depth, solution.code

    return jax.vmap(one)(table, times)


def _spans(model: Model) -> np.ndarray:
    """First and last time (E, 2) of each experiment in its own clock [s]; features are of a run from 0 on."""
    times, seen = np.asarray(model.data.times), np.asarray(model.data.weights).max(axis=1, initial=0.0) > 0
    spans = np.array([[t[s].min(initial=np.inf), t[s].max(initial=-np.inf)] for t, s in zip(times, seen, strict=True)])
    for i, observed in enumerate(model.observed_features):
        if observed.names:
            spans[i] = min(spans[i, 0], 0.0), max(spans[i, 1], observed.end)
    return spans


def contacts(model: Model, point: np.ndarray, log_depth: float) -> list[Contact]:
    """When each channel of contact touches within each record, as the model has it at a point."""
    at, depth = jnp.asarray(point), jnp.asarray(log_depth)
    offsets = np.asarray(model.settings(at, depth)[1]["time_offset"])
    spans = np.maximum(_spans(model) - offsets[:, None], 0.0)
    times = np.linspace(spans[:, 0], np.maximum(spans[:, 1], spans[:, 0] + 1e-9), _SAMPLES, axis=1)
    found, _ = _depths(model, at, depth, jnp.asarray(times))
    names = channel_names(model.scene.members)
    # Not by the force: the regularisation bears a little across a gap.
    inside = np.asarray(found)
    turned = (inside.max(axis=1) > 0) & (inside.argmax(axis=1) < _SAMPLES - 1)
    return [
        Contact(i, name, float(offsets[i]), times[i], inside[i, :, k] > 0, bool(turned[i, k]))
        for i in range(len(times))
        for k, name in enumerate(names)
    ]


def refusal(model: Model, point: np.ndarray, log_depth: float) -> str:
    """Why the values at a point are no parameters of the scene, as one that contradicts another; "" if they are."""
    table, _ = model.settings(jnp.asarray(point), jnp.asarray(log_depth))
    for i in range(len(model.data.times)):
        try:
            model.scene.check(model.scene.parameters({name: float(values[i]) for name, values in table.items()}))
        except InputError as error:
            return str(error)
    return ""


def failure(model: Model, point: np.ndarray, log_depth: float) -> str:
    """Why the simulations at a point do not count, in words."""
    if refused := refusal(model, point, log_depth):
        return refused
    spans = _spans(model)
    times = np.linspace(np.minimum(spans[:, 0], 0.0), np.maximum(spans[:, 1], 1e-9), _SAMPLES, axis=1)
    _, codes = _depths(model, jnp.asarray(point), jnp.asarray(log_depth), jnp.asarray(times))
    bad = [int(code) for code in np.asarray(codes) if int(code) != OK]
    return reason(bad[0], model.how.max_steps) if bad else _NOT_DIFFERENTIABLE


def commonest_failure(model: Model, points: np.ndarray, log_depth: float) -> str:
    """The reason that most of some points share, and how many of them."""
    found = Counter(failure(model, point, log_depth) for point in points)
    text, count = found.most_common(1)[0]
    return f"{text} ({count} of {len(points)})" if len(found) > 1 else text
