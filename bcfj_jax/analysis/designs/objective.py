"""What is made least: a feature, a weighted sum of features, or a function of several.

A peak is a maximum over samples: as a parameter moves, the greatest sample changes and the slope jumps. Two stand-ins
that do not:

- the *crest*, the maximum of the quartic through the greatest sample and its four neighbours; its own place follows
  the parameters, so that second derivatives are right, too. Good to (omega dt)^5;
- the *norm*, ||F||_q = (1/T integral |F|^q dt)^(1/q) over time and members, which tends to the maximum from below as q
  grows and sees several equal peaks at once; a descent begins with it where ``norms`` says so.

Where a run lands on its contacts, the summit of the continuous force takes the place of the crest, and is what is reported
(``derivatives.trains``). What is reported otherwise is the greatest sample.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis import crests
from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names
from bcfj_jax.analysis.derivatives.measures import measure
from bcfj_jax.analysis.derivatives.names import Feature, event, feature, feature_unit, kind_unit, members
from bcfj_jax.analysis.features import KINDS
from bcfj_jax.core.dual import Dual, still
from bcfj_jax.core.errors import InputError, quoted, texts

# Beside the features of ``derivatives``: the deepest penetration, and the greatest |F| where a force has two signs.
OWN = {"peak_penetration": "m", "largest": "N"}
_PEAKS = ("peak", *OWN)

Combine = Callable[[Mapping[str, Array]], Array]


class Objective(NamedTuple):
    """Features, and what is made of them: their weighted sum, or ``combine`` of all by name; least, or with a sign of -1 most."""

    name: str
    features: tuple[Feature, ...]
    weights: tuple[float, ...]
    combine: Combine | None
    unit: str
    sign: float = 1.0

    @property
    def peaked(self) -> bool:
        """Whether a maximum over time is in it."""
        return any(f.kind in _PEAKS for f in self.features)

    @property
    def sampled(self) -> bool:
        """Whether it is one greatest sample and nothing else."""
        return self.combine is None and self.weights == (1.0,) and self.peaked

    def of(self, values: Sequence[Dual]) -> Dual:
        """The objective of the features' values, with its derivatives."""
        numbers, slopes = np.array([float(x.value) for x in values]), np.stack([x.slope for x in values])
        if self.combine is None:
            whole, by = np.dot(self.weights, numbers), np.array(self.weights)
        else:
            whole, by = map(np.asarray, _combined(self.combine, tuple(f.name for f in self.features))(numbers))
        return Dual(whole, by @ slopes)


@functools.lru_cache(maxsize=4)
def _combined(combine: Combine, names: tuple[str, ...]) -> Any:
    """A user's function of numbers (F,), and its derivatives by them."""
    return jax.jit(jax.value_and_grad(lambda x: jnp.asarray(combine(dict(zip(names, x, strict=True))), float)))


def objective(
    asked: str | Mapping[str, float] | Combine, features: Sequence[str], contacts: Mapping[str, int]
) -> Objective:
    """What is made least: a feature's name, weights by name, or a function of a dict of ``features``; of members by contact.

    ``InputError`` for a name that is not known, and for a period, which is found on the host.
    """
    features = texts("features", features, 'name features, such as "contact.peak"')
    if callable(asked):
        if not features:
            raise InputError("features", "none", "name the features that the objective reads")
        names, weights, combine = features, (1.0,) * len(features), asked
        text, unit = getattr(asked, "__name__", "objective"), ""
        parts = tuple(_feature(name, contacts) for name in names)
    else:
        table = {asked: 1.0} if isinstance(asked, str) else dict(asked) if isinstance(asked, Mapping) else {}
        plain = all(isinstance(w, (int, float, np.number)) and np.isfinite(w) for w in table.values())
        if not table or not plain or not all(isinstance(name, str) for name in table):
            raise InputError("objective", quoted(asked), "give one feature or more, each with a finite weight")
        names, weights, combine = tuple(table), tuple(float(w) for w in table.values()), None
        alone = len(names) == 1 and weights == (1.0,)
        # Known to be a feature's name from here on.
        parts = tuple(_feature(name, contacts) for name in names)
        text = names[0] if alone else " + ".join(f"{w:.3g} {n}" for n, w in table.items())
        unit = unit_of(names[0]) if alone else ""
    return Objective(text, parts, weights, combine, unit)


def unit_of(name: str) -> str:
    """Unit of a feature by its name."""
    kind = name.rpartition(".")[2]
    return feature_unit(name) if kind_unit(kind) else OWN[kind]


def _feature(name: str, contacts: Mapping[str, int]) -> Feature:
    place, _, kind = name.rpartition(".")
    if kind in KINDS and KINDS[kind].host:
        raise InputError(f"feature '{name}'", f"a {kind} has no derivative in a batch", "take another feature")
    if event(kind):
        found = "a single contact may vanish on the way, and the objective with it"
        raise InputError(f"feature '{name}'", found, "take a feature of the whole run, such as peak or impulse")
    if kind in OWN:
        return Feature(name, kind, feature(f"{place}.peak", contacts).contacts)
    return feature(name, contacts)


def _peaking(
    value: Histories, derivative: Histories, one: Feature, contacts: Mapping[str, int]
) -> list[tuple[int, Dual]]:
    """Numbers of a peak's channels, and the histories (T,) whose greatest it is of: forces, or penetrations."""
    names, deep = channel_names(contacts), one.kind == "peak_penetration"
    x, dx = (h.penetration if deep else h.force[..., 0] for h in (value, derivative))
    index = [names.index(member) for member in members(one.contacts[0], contacts)]
    return [(k, Dual(x[:, k], dx[:, :, k])) for k in index]


def measured(
    times: np.ndarray, value: Histories, derivative: Histories, wanted: Objective, contacts: Mapping[str, int],
    norm: float | None,
) -> list[Dual]:  # fmt: skip
    """Values of the objective's features at times (T,) [s] of one run, with their derivatives (P,).

    ``norm``: q; infinity takes crests, None the greatest samples.
    """

    def one(feature: Feature) -> Dual:
        if feature.kind not in _PEAKS:
            numbers, slopes = measure(times, value, derivative, [feature], contacts, False)
            return Dual(numbers[0], slopes[0])
        channels, deep = _peaking(value, derivative, feature, contacts), feature.kind == "peak_penetration"
        each: list[Any] = [np.abs(x) if feature.of_size and not deep else x for _, x in channels]
        if norm is not None and np.isfinite(norm):
            return _norm(times, each, norm)
        highest = max(each, key=lambda x: np.max(still(x)))
        # Of a force the summit of the continuous curve, where the run knows it.
        curves = (
            [] if deep or value.curve is None else [Dual(value.curve[k], derivative.curve[:, k]) for k, _ in channels]
        )
        known = (Curve(*(x[k] for k in range(len(Curve._fields)))) for x in curves)
        summits = [crests.summit(np.max(still(highest)), x, feature.of_size) for x in known]
        summits = [x for x in summits if np.isfinite(still(x))]
        if summits:
            return max(summits, key=lambda x: float(still(x)))
        return np.max(highest) if norm is None else crests.crest(times, highest)

    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        return [one(feature) for feature in wanted.features]


def sampled(
    value: Histories, derivative: Histories, wanted: Objective, contacts: Mapping[str, int], stretch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The samples (K,) whose greatest is the objective, with slopes (K, P), and which of them no neighbour in time is
    above; |F| is the greater of F and -F. Slopes are multiplied by ``stretch`` (P,).
    """
    feature = wanted.features[0]
    each = [x for _, x in _peaking(value, derivative, feature, contacts)]
    each += [-x for x in each] if feature.of_size and feature.kind != "peak_penetration" else []
    values, slopes = np.stack([x.value for x in each], axis=1), np.stack([x.slope.T for x in each], axis=1) * stretch
    beside = np.pad(values, ((1, 1), (0, 0)), constant_values=-np.inf)
    peaks = (values >= beside[:-2]) & (values >= beside[2:])
    return values.ravel(), slopes.reshape(-1, stretch.size), peaks.ravel()


def _norm(times: np.ndarray, each: Sequence[Dual], q: float) -> Dual:
    """||F||_q over time, of what presses, members (T,) counting together: d||F|| = ||F||^(1-q) (1/T) integral of F^(q-1) dF."""
    pressed = np.maximum(np.stack([x.value for x in each]), 0.0)
    size, span = float(np.max(pressed)) or 1.0, times[-1] - times[0]
    share, slopes = pressed / size, np.stack([x.slope for x in each], axis=1)
    mean = np.trapezoid(np.sum(share**q, axis=0), times) / span
    along = np.trapezoid(np.sum(share ** (q - 1.0) * slopes, axis=1), times) / span
    return Dual(size * mean ** (1.0 / q), mean ** (1.0 / q - 1.0) * along if mean > 0.0 else 0.0 * along)
