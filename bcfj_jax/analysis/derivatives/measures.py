"""Features of histories and their derivatives along the histories' tangents.

``vector`` is in JAX, for whatever differentiates through it. ``measure`` is of a finished run, in NumPy with duals
(``core.dual``), and compiles nothing. Both take the definitions of ``analysis.features``, of the size of a contact's force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.analysis import crests
from bcfj_jax.analysis.crests import UNKNOWN, Curve
from bcfj_jax.analysis.derivatives.certificate import apart
from bcfj_jax.analysis.derivatives.jacobian import Histories, channel_names
from bcfj_jax.analysis.derivatives.names import Feature, event, members, smooth
from bcfj_jax.analysis.features import KINDS, PAIR, Kind, Seen
from bcfj_jax.core.dual import Dual, backend, either, still, unsloped
from bcfj_jax.mechanism.channels import is_reading

_FEW = 6  # samples: of fewer in a contact the loop of force against penetration is not known


def seen(times: np.ndarray, reading: Any, force: Any, depth: Any, rate: Any, curve: Any) -> Seen:
    """What features of a channel are taken from: (T,) normal force and others, and its row (4,) of ``Histories.curve``.

    Of a contact with the size of the force; what is a ``reading`` in a contact's place keeps its sign. Pure, in JAX, NumPy and
    duals.
    """
    known = UNKNOWN if curve is None else Curve(*(curve[k] for k in range(len(Curve._fields))))
    whole = known._replace(peak=either(reading, lambda: known.peak, lambda: crests.top(known)))
    turned = (still(force) < 0) & (not reading if isinstance(reading, bool) else ~reading)
    return Seen(times, force * backend(force).where(turned, -1.0, 1.0), depth, rate, whole)


def _pairs(feature: Feature, contacts: Mapping[str, int]) -> list[tuple[str, str]]:
    """Channels by channels of a pair of contacts; the first members' where their numbers are unlike."""
    first, second = (members(c, contacts) for c in feature.contacts)
    return list(zip(first, second, strict=True)) if len(first) == len(second) else [(first[0], second[0])]


def vector(
    times: np.ndarray, found: Histories, wanted: Sequence[Feature], contacts: Mapping[str, int],
    periods: Mapping[str, float],
) -> Array:  # fmt: skip
    """The wanted features (F,) of histories. Pure; ``times`` and ``periods`` are numbers.

    What JAX does not differentiate is 0, and filled in by ``measure``; what is of single contacts NaN (``contact_events``).
    ``contacts``: members of each; ``periods``: by channel, the period [s] within which a delay is sought; without one, or NaN:
    the whole history.
    """
    names = channel_names(contacts)
    place, readings = {name: i for i, name in enumerate(names)}, np.array([is_reading(name) for name in names])
    curve = jnp.full((len(place), len(Curve._fields)), jnp.nan) if found.curve is None else found.curve
    kinds = {f.kind: KINDS[f.kind] for f in wanted if smooth(f.kind) and len(times) >= KINDS[f.kind].fewest}

    def each(reading: Any, force: Array, depth: Array, curve: Array) -> dict[str, Array]:
        what = seen(times, reading, force, depth, None, curve)
        return {"force": what.force} | {name: kind.of(what) for name, kind in kinds.items()}

    every = jax.vmap(each, in_axes=(0, 1, 1, 0))(readings, found.force[:, :, 0], found.penetration, curve)

    def one(feature: Feature) -> Any:
        if feature.kind in kinds:
            index = np.array([place[name] for name in members(feature.contacts[0], contacts)])
            return kinds[feature.kind].members(every[feature.kind][index])
        if feature.kind != PAIR or len(times) < KINDS[PAIR].fewest:
            return 0.0 if feature.kind in KINDS and KINDS[feature.kind].host else jnp.nan
        what = [
            Seen(times, every["force"][place[a]], None, cycle=periods.get(a, np.nan), other=every["force"][place[b]])
            for a, b in _pairs(feature, contacts)
        ]
        return KINDS[PAIR].members(jnp.stack([KINDS[PAIR].of(pair) for pair in what]))

    return jnp.stack([jnp.asarray(one(feature)) for feature in wanted])


class _Run:
    """The channels of a run with their slopes, and their periods, each taken once."""

    def __init__(self, times: np.ndarray, value: Histories, derivative: Histories, turning: bool) -> None:
        self.times, self.value, self.derivative, self.turning = times, value, derivative, turning
        self.channels: dict[int, Seen] = {}
        self.periods: dict[int, Dual] = {}

    def channel(self, name: str, k: int) -> Seen:
        """What is seen of the channel ``k``."""
        if k not in self.channels:
            x, dx = self.value, self.derivative
            force = Dual(x.force[:, k, 0], np.ascontiguousarray(dx.force[:, :, k, 0]))
            depth = Dual(x.penetration[:, k], np.ascontiguousarray(dx.penetration[:, :, k]))
            curve = None if x.curve is None or dx.curve is None else Dual(x.curve[k], dx.curve[:, k])
            found = seen(self.times, is_reading(name), force, depth, Dual(x.rate[:, k], dx.rate[:, :, k]), curve)
            self.channels[k] = found._replace(turning=self.turning)
        return self.channels[k]

    def taken(self, kind: Kind, name: str, k: int, other: Seen | None = None) -> Dual:
        """A feature of a channel, with its slopes: 0 where it does not depend on the histories, NaN where it is not known."""
        what = self.channel(name, k)
        if kind.cyclic:
            if k not in self.periods:
                self.periods[k] = self.taken(KINDS["period"], name, k)
            what = what._replace(cycle=self.periods[k], other=other and other.force)
        # What is sought in a history needs all of it.
        whole = len(self.times) >= kind.fewest and (not kind.host or np.isfinite(still(what.force)).all())
        found = kind.of(what) if whole else np.nan
        rest = 0.0 if np.isfinite(still(found)) else np.nan
        return found if isinstance(found, Dual) else Dual(found, np.full(len(self.derivative.force), rest))


def measure(
    times: np.ndarray, value: Histories, derivative: Histories, wanted: Sequence[Feature], contacts: Mapping[str, int],
    turning: bool,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Features (F,) and their derivatives (F, P) from histories and theirs. NumPy: nothing is compiled.

    What is of a single contact (``names.event``) is in no history: NaN, filled in by ``contact_events.filled``. ``turning``:
    as of ``features.Seen``.
    """
    run, place = _Run(times, value, derivative, turning), {n: i for i, n in enumerate(channel_names(contacts))}

    def one(feature: Feature) -> Dual:
        if event(feature.kind):
            return Dual(np.nan, np.full(len(derivative.force), np.nan))
        kind = KINDS[feature.kind]
        if feature.kind == PAIR:
            pairs = _pairs(feature, contacts)
            found = [run.taken(kind, a, place[a], run.channel(b, place[b])) for a, b in pairs]
        else:
            found = [run.taken(kind, name, place[name]) for name in members(feature.contacts[0], contacts)]
        each: Any = found
        number = found[0] if len(found) == 1 else kind.members(np.stack(each))
        return number if isinstance(number, Dual) else unsloped(number, found[0])

    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        found = [one(feature) for feature in wanted]
    slopes = np.array([x.slope for x in found]).reshape(len(found), len(derivative.force))
    return np.array([float(x.value) for x in found]), slopes


def sampling(
    times: np.ndarray, value: Histories, derivative: Histories, wanted: Sequence[Feature], contacts: Mapping[str, int],
    values: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Relative errors (F, P) of features' derivatives that come from the samples, whatever the solver; 0 where unknown.

    None where a number is of the continuous curve (``Histories.curve``). Of peaks that of the crest (``analysis.crests``). Of
    integrals what every second sample, even or odd, gives otherwise, which is three times the error of the trapezoidal
    rule where samples are many; of works infinite where fewer than ``_FEW`` samples bear more than a twentieth of the peak in
    a contact, on average. ``values`` (P,) are the parameters'.
    """
    found, run = np.zeros((len(wanted), len(values))), _Run(times, value, derivative, False)
    place, works = {name: i for i, name in enumerate(channel_names(contacts))}, []
    for i, f in enumerate(wanted):
        kind = KINDS.get(f.kind)
        own = members(f.contacts[0], contacts) if kind and kind.curve else []
        if not kind or not own:
            continue
        channels = [run.channel(name, place[name]) for name in own]
        if kind.curve != "peak":
            works += [] if all(np.isfinite(still(getattr(s.curve, kind.curve))) for s in channels) else [i]
            continue
        numbers = [run.taken(kind, name, place[name]) for name in own]
        top = int(np.argmax([float(x.value) for x in numbers]))
        seen, by = channels[top], numbers[top].slope
        error = crests.error(times, seen.force, seen.curve, f.kind == "largest")
        known = np.isfinite(error)
        off = apart((by + np.where(known, error, 0.0))[None], by[None], numbers[top].value[None], values)[0]
        found[i] = np.where(known, off, error)
    if not works or len(times) < 4:
        return found
    kept, last = [wanted[i] for i in works], len(times) - 1
    numbers, slopes = measure(times, value, derivative, kept, contacts, False)
    for first in (0, 1):
        every = np.unique(np.concatenate([[0], np.arange(first, last, 2), [last]]))
        thin = Histories(*(x[every] for x in value[:3]), state=None)
        thinner = Histories(*(x[:, every] for x in derivative[:3]), state=None)
        coarse = measure(times[every], thin, thinner, kept, contacts, False)[1]
        found[works] = np.maximum(found[works], apart(coarse, slopes, numbers, values))
    for i, slope in zip(works, slopes, strict=True):
        if KINDS[wanted[i].kind].curve != "work":
            continue
        force = np.abs(value.force[:, [place[m] for m in members(wanted[i].contacts[0], contacts)], 0])
        bears = force > 0.05 * force.max(axis=0, initial=0.0)
        begins = np.count_nonzero(bears[1:] & ~bears[:-1], axis=0) + bears[0]
        if np.any((begins > 0) & (bears.sum(axis=0) < _FEW * begins)):
            found[i] = np.where(slope != 0.0, np.inf, 0.0)
    return found
