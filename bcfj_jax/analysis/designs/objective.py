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

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis import crests
from bcfj_jax.analysis.crests import Curve
from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names
from bcfj_jax.analysis.derivatives.measures import vector
from bcfj_jax.analysis.derivatives.names import Feature, event, feature, feature_unit, kind_unit, members
from bcfj_jax.analysis.features import KINDS
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

    def of(self, values: Sequence[Array]) -> Array:
        """The objective of the features' values. Pure."""
        if self.combine is not None:
            return self.combine({f.name: x for f, x in zip(self.features, values, strict=True)})
        return sum((w * x for w, x in zip(self.weights, values, strict=True)), start=jnp.zeros(()))


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


def measured(
    times: np.ndarray, found: Histories, wanted: Objective, contacts: Mapping[str, int], norm: Array | None
) -> list[Array]:
    """Values of the objective's features at times (T,) [s] of one run. Pure, differentiable.

    ``norm``: q; infinity takes crests, None the greatest samples.
    """
    names = channel_names(contacts)

    def one(feature: Feature) -> Array:
        if feature.kind not in _PEAKS:
            return vector(times, found, [feature], contacts, {})[0]
        index = np.array([names.index(m) for m in members(feature.contacts[0], contacts)])
        values = (found.penetration if feature.kind == "peak_penetration" else found.force[:, :, 0])[:, index]
        if feature.of_size and feature.kind != "peak_penetration":
            values = jnp.where(values < 0, -values, values)
        high = jnp.max(values)
        # Of a force the summit of the continuous curve, where the run knows it.
        curve = None if feature.kind == "peak_penetration" else found.curve
        summit = jnp.asarray(jnp.nan)
        if curve is not None:
            each = jax.vmap(lambda c: crests.summit(high, Curve(*c), feature.of_size))(curve[index])
            summit = jnp.max(jnp.where(jnp.isnan(each), -jnp.inf, each))
        given = jnp.isfinite(summit)
        if norm is None:
            return jnp.where(given, summit, high)
        crest = jnp.where(given, summit, crests.crest(times, values))
        return jnp.where(jnp.isfinite(norm), _norm(times, values, jnp.where(jnp.isfinite(norm), norm, 2.0)), crest)

    return [one(feature) for feature in wanted.features]


def sampled(
    read: Sequence[np.ndarray], wanted: Objective, contacts: Mapping[str, int], stretch: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The samples (K,) whose greatest is the objective, with slopes (K, P), and which of them no neighbour in time is
    above; |F| is the greater of F and -F.

    ``read``: force and penetration (T, C), and their slopes (T, C, P), which are multiplied by ``stretch`` (P,).
    """
    feature, names = wanted.features[0], channel_names(contacts)
    index = np.array([names.index(m) for m in members(feature.contacts[0], contacts)])
    k = int(feature.kind == "peak_penetration")
    values, slopes = read[k][:, index], read[2 + k][:, index] * stretch
    if feature.of_size and not k:
        values, slopes = np.concatenate([values, -values], axis=1), np.concatenate([slopes, -slopes], axis=1)
    beside = np.pad(values, ((1, 1), (0, 0)), constant_values=-np.inf)
    peaks = (values >= beside[:-2]) & (values >= beside[2:])
    return values.ravel(), slopes.reshape(-1, stretch.size), peaks.ravel()


def _norm(times: np.ndarray, values: Array, q: Array) -> Array:
    """||F||_q over time, of what presses, the largest of members counting together."""
    pressed = jnp.maximum(values, 0.0)
    size = jax.lax.stop_gradient(jnp.max(pressed))
    size = jnp.where(size > 0.0, size, 1.0)
    share = pressed / size
    # |x|^q and its slope are 0 at x = 0 for q > 1; the logarithm must not be asked.
    power = jnp.where(share > 0.0, jnp.exp(q * jnp.log(jnp.where(share > 0.0, share, 1.0))), 0.0)
    mean = jnp.trapezoid(jnp.sum(power, axis=1), jnp.asarray(times)) / (times[-1] - times[0])
    return size * jnp.where(mean > 0.0, jnp.exp(jnp.log(jnp.where(mean > 0.0, mean, 1.0)) / q), 0.0)
