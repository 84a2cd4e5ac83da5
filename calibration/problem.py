"""What a calibration is made of: plain data, no arithmetic. Everything is SI by the time it is here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from bcfj_jax import InputError, nearest
from bcfj_jax.analysis.derivatives.contact_events import check_followed
from bcfj_jax.analysis.derivatives.names import event, feature, feature_unit, in_its_place, kind_unit
from bcfj_jax.core.errors import quoted
from bcfj_jax.core.quantities import Quantity, check_order, real, scalar
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.channels import ATTITUDE, quantity_of, unit_of
from bcfj_jax.mechanism.channels import channel as reading
from bcfj_jax.mechanism.model import AbstractModel, of_numbers
from bcfj_jax.mechanism.observed import observing
from calibration import attitudes, given, instrument
from calibration.filters import Filter
from calibration.solver_budget import budget

# A number, SI, or a text with its unit, which a ``Problem`` makes a number of.
Number = Any

# Nuisance parameters of the measuring chain, of a force or whatever else x is read, t being the record's clock:
#   reading(t) = gain G[b(R[L[x]])](t - time_offset) + force_offset + drift t + hum_sine sin(w t) + hum_cosine cos(w t),
# G the low-pass of ``Problem.filter`` with its cutoff; L a sensor of first order, y' = 2 pi bandwidth (x - y); R one of
# second order, y'' + 2 z v y' + v^2 y = v^2 x with v = 2 pi resonance and z = resonance_damping; b(y) = y (1 + gain_bend |y|);
# w = 2 pi hum_frequency.
NUISANCES = {
    "time_offset": Quantity("time_offset", "s", "clock of the record ahead of the model's"),
    "force_offset": Quantity("force_offset", "N", "reading where there is nothing to read, in the channels' unit"),
    "position_offset": Quantity("position_offset", "m", "reading of a position where the model's is 0"),
    "velocity_offset": Quantity("velocity_offset", "m/s", "reading of a velocity at rest"),
    "acceleration_offset": Quantity("acceleration_offset", "m/s^2", "reading of an acceleration where there is none"),
    "gain": Quantity("gain", "1", "reading per what is there", low=0.0, open_low=True),
    "bandwidth": Quantity(
        "bandwidth", "Hz", "frequency at which a first-order sensor passes 1/sqrt(2)", 0.0, 1e12, True
    ),
    "cutoff": Quantity("cutoff", "Hz", "frequency at which one pass of the filter passes 1/sqrt(2)", 0.0, 1e12, True),
    "resonance": Quantity("resonance", "Hz", "undamped frequency of a second-order sensor", 0.0, 1e12, True),
    "resonance_damping": Quantity(
        "resonance_damping", "1", "damping of a second-order sensor as a share of critical", 0.0, 0.99, True
    ),
    "gain_bend": Quantity("gain_bend", "1/N", "change of the gain per unit of what is there"),
    "drift": Quantity("drift", "N/s", "growth of the reading with the record's time, in the channels' unit"),
    "hum_frequency": Quantity("hum_frequency", "Hz", "frequency of a hum, such as the mains'", 0.0, 1e12, True),
    "hum_sine": Quantity("hum_sine", "N", "sine part of the hum in the record's time, in the channels' unit"),
    "hum_cosine": Quantity("hum_cosine", "N", "cosine part of the hum, likewise"),
}
# Offsets of channels by their unit.
OFFSETS = {
    q.unit: name for name, q in NUISANCES.items() if name.endswith("_offset") and name != "time_offset"
}  # fmt: skip
# Every record has its own of these unless each = false says otherwise; the others are a sensor's, one for all records.
OWN = ("time_offset", *OFFSETS.values(), "gain", "drift", "hum_sine", "hum_cosine")
# Of a chain that neither gives nor seeks them; what an element needs beside its own number.
NEUTRAL = {
    "time_offset": 0.0, **dict.fromkeys(OFFSETS.values(), 0.0), "gain": 1.0, "bandwidth": 1e12, "cutoff": 1e12,
    "resonance": 1e12, "resonance_damping": 0.05, "gain_bend": 0.0, "drift": 0.0, "hum_frequency": 50.0,
    "hum_sine": 0.0, "hum_cosine": 0.0,
}  # fmt: skip
_NEEDS = {"resonance_damping": "resonance", "hum_sine": "hum_frequency", "hum_cosine": "hum_frequency"}
# In the unit of what is read, so that one number does not serve channels of several; and what comes after that unit.
_IN_UNIT = {"force_offset": "{}", "drift": "{}/s", "hum_sine": "{}", "hum_cosine": "{}", "gain_bend": "1/({})"}
LOSSES = ("linear", "soft_l1", "cauchy")
# Of what is given: place, what is wrong, what would be right.
_Fault = tuple[str, str, str]


def _refuse(faults: Iterable[_Fault]) -> None:
    """Raise the first of the faults, if there is one."""
    for fault in faults:
        raise InputError(*fault)


def units_of(observed: Iterable[str]) -> dict[str, list[str]]:
    """Readings by their SI unit."""
    found: dict[str, list[str]] = {}
    for name in observed:
        found.setdefault(unit_of(name), []).append(name)
    return found


def error_unit(observes: str) -> str:
    """SI unit of a channel's errors: its reading's; of an attitude's rad (``attitudes``)."""
    return "rad" if quantity_of(observes)[0] == ATTITUDE else unit_of(observes)


def offsets_of(observes: str, among: Iterable[str]) -> tuple[str, ...]:
    """Names of the offsets that act on a channel: its unit's, and force_offset where all channels share one unit."""
    own = OFFSETS.get(unit_of(observes), "")
    names = (own, "force_offset" if len(units_of(among)) == 1 else "")
    return tuple(dict.fromkeys(name for name in names if name))


def size(observes: str, values: np.ndarray) -> float:
    """What a share of a channel is a share of: its largest reading; of a place its range; 1 of an attitude."""
    what = quantity_of(observes)[0]
    if what == ATTITUDE:
        return 1.0
    seen = values[np.isfinite(values)]
    if not seen.size:
        return 0.0
    return float(np.ptp(seen)) if what in ("place", "angle") and np.ptp(seen) > 0 else float(np.max(np.abs(seen)))


def nuisances(observed: Iterable[str]) -> dict[str, Quantity]:
    """Nuisance parameters of channels that observe some readings: an offset is in their unit, where they share one."""
    unit, *others = units_of(observed) or ("N",)
    if others or unit == "N":
        return dict(NUISANCES)
    return {**NUISANCES, **{name: NUISANCES[name]._replace(unit=text.format(unit)) for name, text in _IN_UNIT.items()}}


# Of the peak: what the laws of contact miss in published drop tests of steel and rubber (docs/calibration.md).
ADEQUATE = 0.03
_ADEQUATE = Quantity("adequate", "1", "share of the peak", 0.0, np.nextafter(1.0, 0.0))
_ACCURACY = Quantity("accuracy", "1", "error of the forces as a share of their peak", 0.0, 0.5, True)


@dataclass(frozen=True)
class Channel:
    """What a sensor saw in one experiment, with noise of variance sigma^2 + (relative reading)^2 + (jitter slope)^2.

    Attributes:
        observes: a reading of the scene (``bcfj_jax.mechanism.channels``), as "contact.normal" or "slider.acceleration.x".
        values: (T,) readings, SI; NaN where there is no sample.
        sigma: standard deviation of its noise, SI; None: to be estimated from the residuals, one number for all
            experiments that leave it so.
        relative: part of the noise that grows with the reading, as a share of it.
        correlation: time [s] over which the noise remembers itself, exp(-dt/correlation) between samples; 0 for
            white noise; None: to be estimated, likewise.
        jitter: deviation of the clock from sample to sample [s].
        instrument: what is stated of the sensor's errors, as texts or ``instrument.Limit``.
    """

    observes: str
    values: Float[np.ndarray, " T"]
    sigma: float | None
    relative: float = 0.0
    correlation: float | None = 0.0
    jitter: float = 0.0
    instrument: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        remedy = 'name a reading of the scene, such as "contact.normal"'
        where = f"channel {given.text('channel', self.observes, remedy)}"
        changed: dict[str, Any] = {"values": given.readings(where, self.values)}
        parts = (("sigma", error_unit(self.observes)), ("relative", "1"), ("correlation", "s"), ("jitter", "s"))
        for name, unit in parts:
            value = getattr(self, name)
            if value is not None or name in ("relative", "jitter"):
                changed[name] = given.plain(where, name, unit, value)
        said = given.table(f"{where} instrument", self.instrument)
        changed["instrument"] = instrument.stated(said, self.observes, {}, f"{where} instrument")
        given.fill(self, changed)

    def deviation(self, readings: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Standard deviation, SI, of the noise at readings and their times; to be estimated: 1 % of the largest value."""
        if self.sigma is None:
            return np.full(readings.shape, 0.01 * size(self.observes, self.values))
        # The least that was read bounds it where the model reads 0.
        least = self.relative * np.nanmin(np.abs(self.values))
        still = np.hypot(self.sigma, np.maximum(self.relative * np.abs(readings), least))
        return np.hypot(still, self.jitter * np.gradient(readings, times)) if self.jitter and times.size > 1 else still


@dataclass(frozen=True)
class Observation:
    """A feature that was measured: "contact.peak" or "first:second.delay", its value and standard deviation, SI."""

    feature: str
    value: float
    sigma: float

    def __post_init__(self) -> None:
        where = f"feature {given.text('feature', self.feature, 'name a feature, such as contact.peak')}"
        unit = feature_unit(self.feature) if kind_unit(self.feature.rpartition(".")[2]) else "1"
        given.fill(self, {key: given.plain(where, key, unit, getattr(self, key)) for key in ("value", "sigma")})


@dataclass(frozen=True)
class Experiment:
    """One record: times (T,) [s], increasing, and what the channels saw; or features of one, or both.

    ``fixed`` overrides scene parameters and nuisances; ``tolerances`` (SI) say how well they are known. ``bounds`` are its
    own of parameters that every experiment has its own of, in place of ``Free``'s. Features are those of the model's force
    from 0 to ``span`` [s]; without one, to the end of the record.
    """

    name: str
    times: Float[np.ndarray, " T"]
    channels: tuple[Channel, ...]
    hold_out: bool = False
    fixed: dict[str, float] = field(default_factory=dict)
    source: str = ""
    features: tuple[Observation, ...] = ()
    span: float | None = None
    tolerances: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f"experiment {given.text('experiment name', self.name, 'give it a name')}"
        times = real(where, "times", self.times)
        if times.ndim != 1 or not np.isfinite(times).all():
            raise InputError(f"{where} times", quoted(self.times), "give a 1-D array of finite times [s] that increase")
        channels = given.all_of(f"{where} channels", self.channels, Channel)
        for channel in channels:
            if channel.values.shape != times.shape:
                found = f"{channel.values.size} values at {times.size} times"
                raise InputError(f"{where} {channel.observes}", found, "give a value a time; nan where there is none")
        changed: dict[str, Any] = {"times": times, "channels": channels}
        changed["features"] = given.all_of(f"{where} features", self.features, Observation)
        for key in ("fixed", "tolerances", "bounds"):
            changed[key] = given.table(f"{where} {key}", getattr(self, key))
        if not isinstance(self.hold_out, (bool, np.bool_)):
            raise InputError(f"{where} hold_out", quoted(self.hold_out), "give True or False")
        if not isinstance(self.source, str):
            raise InputError(f"{where} source", quoted(self.source), "name the file, or leave it out")
        if self.span is not None:
            changed["span"] = given.not_negative(where, "span", "s", self.span)
        given.fill(self, changed)

    def until(self, end: float) -> Experiment:
        """The record up to a time [s]."""
        inside = self.times <= end
        channels = tuple(replace(c, values=c.values[inside]) for c in self.channels)
        return replace(self, times=self.times[inside], channels=channels)

    @property
    def samples(self) -> int:
        """Number of readings and features."""
        return int(sum(np.isfinite(c.values).sum() for c in self.channels)) + len(self.features)


@dataclass(frozen=True)
class Free:
    """A parameter to be found between two bounds; ``start`` adds a start there to the design.

    ``each`` gives every experiment its own value; by default so for the nuisances named in ``OWN``.

    ``scale`` is that on which starts are drawn; and of the interval, but for a clearance whose ``scale`` is not said.
    """

    name: str
    lower: Number
    upper: Number
    start: Number | None = None
    scale: Literal["log", "linear"] | None = None
    each: bool | None = None

    def __post_init__(self) -> None:
        name = given.text("free", self.name, "name a parameter")
        if self.scale is not None and not (isinstance(self.scale, str) and self.scale in ("log", "linear")):
            raise InputError(f"[free.{name}] scale", quoted(self.scale), "give 'log' or 'linear'")
        if not isinstance(self.each, (bool, type(None))):
            raise InputError(f"[free.{name}] each", quoted(self.each), "give True or False")

    @property
    def log(self) -> bool:
        """Whether starts are drawn on a logarithmic scale: by default where both bounds are positive."""
        return self.scale == "log" if self.scale else bool(self.lower > 0)

    @property
    def as_share(self) -> bool:
        """Whether the interval is one of the logarithm, as data determine a stiffness: to a share of itself.

        They determine a clearance to a length, however small it is. On a logarithmic scale its large estimates would seem
        better known than its small ones, and the verdict would pick those that came out too large.
        """
        return self.log and (self.scale == "log" or not self.name.startswith("clearance"))

    @property
    def per_experiment(self) -> bool:
        """Whether every experiment has its own."""
        return self.name in OWN if self.each is None else self.each


class Doubt(NamedTuple):
    """Why values that were given may be wrong, in words, and on what condition an estimate holds: "if ``condition``".

    ``name``, ``lower``, ``upper`` [SI], ``each``: the parameter that is free if the doubt is right, as in ``Free``; then the
    condition is that of a fit with it, ``selection.supposed``. "" for none: the condition is that the doubt is wrong.
    """

    text: str
    condition: str
    name: str = ""
    lower: float = 0.0
    upper: float = 0.0
    each: bool = False


@dataclass(frozen=True)
class Problem:
    """Scene, fixed parameter values, experiments and free parameters.

    ``accuracy`` is the error of the simulated forces as a share of their peak; by default 1e-6, and 1e-3 of a joint's
    motion, whose derivatives would take ten times as long. ``loss`` is SciPy's name for what a residual of z standard
    deviations costs (``losses.loss_of``). ``adequate``: share of the peak that a law may miss a contact by, to be called
    adequate (``diagnostics.answers``). ``tolerances`` (SI): how well fixed values are known, as limits of 95 %; without
    one, 1 % of the value (``uncertainty.systematic``). ``filter``: what the readings passed between sensor and record, whose
    ``cutoff`` is free or given; "none"; or "unknown": where the record's clock is free, too, a fit asks whether the record
    tells one from the law (``uncertainty.unstated_filter``). ``doubts``: why given values may be wrong; a fit with one
    identifies nothing, and says what holds on the condition that they are right.

    Raises:
        InputError: on construction, for a free parameter the scene does not have, bounds the wrong way
            round or out of range, a start outside its bounds, a channel the scene has no contact for, times
            that do not increase, fewer samples than free parameters.
    """

    scene: AbstractModel
    params: dict[str, float]
    experiments: tuple[Experiment, ...]
    free: tuple[Free, ...]
    accuracy: float = 0.0
    where: str = "problem"
    loss: str = "linear"
    adequate: float = ADEQUATE
    tolerances: dict[str, float] = field(default_factory=dict)
    filter: Filter | Literal["none", "unknown"] = "unknown"
    doubts: tuple[Doubt, ...] = ()

    def __post_init__(self) -> None:
        where = given.text("problem", self.where, "leave 'where' out")
        parts = {"experiments": Experiment, "free": Free}
        listed = {key: given.all_of(f"{where}: {key}", getattr(self, key), kind) for key, kind in parts.items()}
        scene = of_numbers(self.scene)
        if any(attitudes.attitudes(c.observes for c in e.channels) for e in listed["experiments"]):
            listed["experiments"] = tuple(map(_turned, listed["experiments"]))
        # <contact>.clearance and clearance_<contact> are one parameter.
        listed["free"] = tuple(replace(f, name=scene.canonical(f.name)) for f in listed["free"])
        names = [seen.feature for e in listed["experiments"] for seen in e.features]
        given.fill(self, {"scene": observing(scene, names), **listed})
        _refuse(self._incomplete())
        self._in_numbers(where)
        _refuse(fault for f in self.free for fault in self._wrong_free(f, f"{where}: [free.{f.name}]"))
        given.fill(self, {"adequate": scalar(f"{where}: adequate", _ADEQUATE, self.adequate)})
        if not isinstance(self.loss, str) or self.loss not in LOSSES:
            raise InputError(f"{where}: loss", f"no loss {quoted(self.loss)}", nearest(self.loss, LOSSES))
        for e in self.experiments:
            _refuse(self._wrong_record(e, e.source or e.name))
        _refuse(self._too_few())
        _refuse(self._wrong_chain())
        _refuse(self._said_twice())

    def _incomplete(self) -> Iterator[_Fault]:
        """What is missing; a filter needs a cut-off, and a cut-off a filter."""
        if not self.free:
            yield self.where, "no free parameter", "add a table such as [free.stiffness] with lower and upper"
        if all(e.hold_out for e in self.experiments):
            yield self.where, "no experiment to fit", "give at least one [[experiment]] without hold_out"
        where = f"{self.where}: filter"
        cut = ["cutoff" in {f.name for f in self.free} | e.fixed.keys() for e in self.experiments]
        if isinstance(self.filter, Filter):
            self.filter.checked(where)
            if not all(cut):
                yield where, "the cut-off is missing", "give cutoff, or add [free.cutoff]"
        elif not (isinstance(self.filter, str) and self.filter in ("none", "unknown")):
            yield where, quoted(self.filter), 'give a calibration.Filter, "none" or "unknown"'
        elif any(cut):
            remedy = 'give filter = { kind = "butterworth", order = 2, zero_phase = false }'
            yield f"{self.where}: cutoff", "no filter is given that it is of", remedy

    def _in_numbers(self, where: str) -> None:
        """Values, tolerances and bounds as numbers, SI."""
        known = self.quantities
        unsaid = isinstance(self.accuracy, (int, float)) and not self.accuracy
        asked = budget(self).accuracy if unsaid else self.accuracy
        changed: dict[str, Any] = {"params": given.numbers(f"{where}: params", self.params, known)}
        changed["accuracy"] = scalar(f"{where}: accuracy", _ACCURACY, asked)
        changed["tolerances"] = given.tolerances(f"{where}: tolerances", self.tolerances, known)
        experiments = tuple(self._known(e, known) for e in self.experiments)
        # Models of the same data share it, so that its programs are compiled once.
        if any(new is not old for new, old in zip(experiments, self.experiments, strict=True)):
            changed["experiments"] = experiments
        given.fill(self, changed)
        given.fill(self, {"free": tuple(self._in_si(f, known) for f in self.free)})

    def _known(self, e: Experiment, known: dict[str, Quantity]) -> Experiment:
        """An experiment whose own values are numbers, by the scene's names of them."""
        place, one = f"{self.where}: parameters of {e.name}", self.scene.canonical
        fixed, tolerances, bounds = ({one(k): v for k, v in x.items()} for x in (e.fixed, e.tolerances, e.bounds))
        for name in bounds.keys() & known.keys():  # Another model of the same data may have more.
            bounds[name] = given.pair(f"{self.where}: bounds of {name} in {e.name}", bounds[name], known[name])
        fixed, tolerances = given.numbers(place, fixed, known), given.tolerances(place, tolerances, known)
        own = {"fixed": fixed, "tolerances": tolerances, "bounds": bounds}
        return e if all(getattr(e, key) == value for key, value in own.items()) else replace(e, **own)

    def _in_si(self, f: Free, known: dict[str, Quantity]) -> Free:
        """A free parameter with its bounds and its start as numbers."""
        where = f"{self.where}: [free.{f.name}]"
        if f.name not in known:
            raise InputError(where, f"scene '{self.scene.kind}' has no parameter '{f.name}'", nearest(f.name, known))
        power = inputs.exponent(self.scene, f.name, self.params, dict(self.scene.defaults))
        parts = {key: getattr(f, key) for key in ("lower", "upper", "start") if getattr(f, key) is not None}
        return replace(f, **{k: scalar(f"{where} {k}", known[f.name], x, power) for k, x in parts.items()})

    def _wrong_free(self, f: Free, where: str) -> Iterator[_Fault]:
        if not f.lower < f.upper:
            yield where, f"lower = {f.lower:g} is not below upper = {f.upper:g}", "swap the bounds"
        if f.start is not None and not f.lower <= f.start <= f.upper:
            yield where, f"start = {f.start:g} is outside [{f.lower:g}, {f.upper:g}]", "start within the bounds"
        if f.log and f.lower <= 0:
            yield where, f"scale = log with lower = {f.lower:g}", "use positive bounds or scale = 'linear'"
        own = in_its_place(self.params, f.name) if f.name in self.scene.quantities else None
        if own is not None:
            beside = f"[free.{own[0]}]" if own else f"[parameters] {f.name} = ... in the scene file, or params"
            found = f"'{f.name}' has no value that the search could stand in for"
            yield where, found, f"{'write' if own else 'give it in'} {beside}"

    def _wrong_record(self, e: Experiment, where: str) -> Iterator[_Fault]:
        """Times, channels, values that must agree with each other, and features."""
        late = np.flatnonzero(np.diff(e.times) <= 0)
        if late.size:
            k = int(late[0])
            found = f"time {e.times[k + 1]:g} s follows {e.times[k]:g} s in {e.name}"
            remedy = "times must increase: sort the rows, or split the runs with rows = { column = ... }"
            yield where, found, remedy
        if not e.samples:
            yield where, f"{e.name} holds no reading and no feature", "give data, or leave it out"
        members = self.scene.members
        for channel in e.channels:
            yield from _wrong_noise(channel, f"{where}: noise of {channel.observes}")
            place = f"{where}: observe '{channel.observes}'"
            seen = reading(channel.observes, self.scene, where=place)
            if members.get(seen.part) and not seen.member:
                yield place, f"'{seen.part}' has {members[seen.part]} members", f"observe one, such as {seen.part}_1"
        sought = {f.name for f in self.free}
        values = {name: value for name, value in (self.params | e.fixed).items() if name not in sought}
        own = [name for name in self.scene.quantities if name in values]
        check_order(f"{self.where}: parameters of {e.name}", own, values)
        for seen in e.features:
            feature(seen.feature, members)  # Of a contact with members one is observed: seat_ball_2.
            if not (0.0 < seen.sigma < np.inf and np.isfinite(seen.value)):
                found = f"feature '{seen.feature}' = {seen.value:g} with a deviation of {seen.sigma:g}"
                yield where, found, "give a number and a feature_noise above 0"
        if e.features and e.span is None and not e.channels:
            yield where, "features without the time that they were taken over", 'give span, as in "50 ms"'
        if any(event(seen.feature.rpartition(".")[2]) for seen in e.features):
            # Of a scene that can be followed, and of no sensor but for clock and gain.
            check_followed(self.scene)
            wrong = sorted((sought | e.fixed.keys()) & (NUISANCES.keys() - {"time_offset", "gain"}))
            if wrong and not e.channels:
                found = (
                    f"{wrong[0]} moves features of single contacts of {e.name}, which are those of the contact itself"
                )
                yield self.where, found, "take it out, or fit samples"

    def _too_few(self) -> Iterator[_Fault]:
        """There are more samples than unknowns, and records that determine every noise which is to be estimated."""
        fitted = self.fitted
        samples = sum(e.samples for e in fitted)
        if samples <= self.unknowns:
            found = f"{samples} samples for {self.unknowns} free parameters"
            yield self.where, found, "free fewer parameters or give more data"
        known = {c.observes for e in fitted for c in e.channels if c.sigma is None}
        for e in self.experiments:
            for c in e.channels:
                if e.hold_out and c.sigma is None and c.observes not in known:
                    found = f"the noise of {c.observes} is 'estimate' in {e.name}, and no fitted record determines it"
                    yield self.where, found, "state its noise"

    def _wrong_chain(self) -> Iterator[_Fault]:
        """One number in the channels' unit needs channels of one unit; a part of the chain may need another."""
        free, units = {f.name for f in self.free}, list(units_of(self.observed))
        named = free.union(*(e.fixed for e in self.experiments))
        wrong = [name for name in _IN_UNIT if name in named and (name != "force_offset" or "N" not in units)]
        if len(units) > 1 and wrong:
            own = " or ".join(OFFSETS[u] for u in units if u in OFFSETS) if wrong[0] == "force_offset" else ""
            remedy = own or "take it out, or fit the channels apart"
            yield self.where, f"one {wrong[0]} for channels in {' and '.join(units)}", remedy
        for e in self.experiments:
            for name, need in _NEEDS.items():
                if name in free | e.fixed.keys() and need not in free | e.fixed.keys():
                    remedy = f"give {need} in [[experiment]] parameters, or add [free.{need}]"
                    yield f"{self.where}: {name}", f"{e.name} has no {need}", remedy
        if "hum_frequency" in free and not {"hum_sine", "hum_cosine"} & named:
            remedy = "add [free.hum_sine] and [free.hum_cosine]"
            yield f"{self.where}: [free.hum_frequency]", "the hum has no size", remedy

    def _said_twice(self) -> Iterator[_Fault]:
        """Bounds and values of one record beside those of all."""
        free = {f.name: f for f in self.free}
        for e in self.experiments:
            for name in e.bounds.keys() & free.keys():  # Another model of the same data may not search it.
                lower = e.bounds[name][0]
                if free[name].log and lower <= 0:
                    found = f"scale = log with a lower bound of {lower:g}"
                    yield f"{self.where}: bounds of {name} in {e.name}", found, "use positive bounds"
            for name in [f.name for f in self.free if f.name in e.fixed]:
                found = f"'{name}' is free, and known to be {e.fixed[name]:g} in {e.name}"
                yield self.where, found, "take one of them out"

    @property
    def fitted(self) -> tuple[Experiment, ...]:
        """The experiments that are not held out."""
        return tuple(e for e in self.experiments if not e.hold_out)

    def until(self, ends: Iterable[float]) -> Problem:
        """The problem of each fitted record up to a time, ``ends`` [s] in their order."""
        last = iter(ends)
        return replace(self, experiments=tuple(e if e.hold_out else e.until(next(last)) for e in self.experiments))

    @property
    def unknowns(self) -> int:
        """Numbers that are searched: of each fitted record its own."""
        count = len(self.fitted)
        return sum(count if f.per_experiment else 1 for f in self.free)

    @property
    def observed(self) -> tuple[str, ...]:
        """The readings of all channels, each once."""
        return tuple(dict.fromkeys(c.observes for e in self.experiments for c in e.channels))

    @property
    def quantities(self) -> dict[str, Quantity]:
        """What may be free: the scene's parameters and the nuisances."""
        return {**self.scene.quantities, **nuisances(self.observed)}


def _turned(experiment: Experiment) -> Experiment:
    """The experiment with the channels of its attitudes that are kept (``attitudes.reduced``)."""
    channels = {c.observes: c.values for c in experiment.channels}
    names = attitudes.attitudes(channels)
    if not names:
        return experiment
    kept = attitudes.reduced(experiment.times, channels, experiment.source or experiment.name)
    dropped = {name for parts in names.values() for name in parts.values()} - kept.keys()
    rest = (replace(c, values=kept.get(c.observes, c.values)) for c in experiment.channels if c.observes not in dropped)
    return replace(experiment, channels=tuple(rest))


def _wrong_noise(channel: Channel, where: str) -> Iterator[_Fault]:
    """Every sample must have a noise above 0, known or to be found."""
    unit = error_unit(channel.observes)
    if channel.correlation is not None and not 0.0 <= channel.correlation < np.inf:
        yield where, f"a correlation time of {channel.correlation:g} s", "give a finite time, 0 or more"
    if channel.sigma is None:
        if channel.relative or channel.jitter:
            yield where, "one part is stated, the other estimated", "state both or estimate one number"
        return
    if not all(0.0 <= part < np.inf for part in (channel.sigma, channel.relative, channel.jitter)):
        found = f"{channel.sigma:g} {unit} + {channel.relative:.3%} of reading + {channel.jitter:g} s of clock"
        yield where, found, "give finite deviations above 0"
    size = np.abs(channel.values[np.isfinite(channel.values)])
    least, peak = size.min(initial=np.inf), size.max(initial=0.0)
    # A ten-thousandth of the peak is below what any sensor resolves.
    if size.size and not channel.sigma + channel.relative * least > 1e-4 * channel.relative * peak:
        remedy = f'add an absolute part, as in "0.1 {"kN" if unit == "N" else unit} + 2 % of reading"'
        yield where, f"a reading of {least:g} {unit} would be exact", remedy
