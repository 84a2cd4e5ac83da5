"""What a calibration is made of: plain data, no arithmetic. Everything is SI by the time it is here."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bcfj_jax import InputError, check_value, nearest
from bcfj_jax.derivatives.jacobian import channel_names, channels
from bcfj_jax.quantities import Quantity
from bcfj_jax.scene import AbstractScene

# Nuisance parameters of the measuring chain: reading(t) = gain F(t - time_offset) + force_offset.
NUISANCES = {
    "time_offset": Quantity("time_offset", "s", "clock of the record ahead of the model's"),
    "force_offset": Quantity("force_offset", "N", "reading at no force"),
    "gain": Quantity("gain", "1", "reading per force", low=0.0, open_low=True),
}
COMPONENTS = ("normal", "axial", "tangential")


@dataclass(frozen=True)
class Channel:
    """What a sensor saw in one experiment.

    Attributes:
        observes: "contact.component", as in "contact.normal".
        values: (T,) force [N]; NaN where there is no sample.
        sigma: standard deviation of its noise [N]; None: to be estimated from the residuals.
    """

    observes: str
    values: np.ndarray
    sigma: float | None


@dataclass(frozen=True)
class Experiment:
    """One record: times (T,) [s], increasing, and what the channels saw. ``fixed`` overrides scene parameters."""

    name: str
    times: np.ndarray
    channels: tuple[Channel, ...]
    hold_out: bool = False
    fixed: dict[str, float] = field(default_factory=dict)
    source: str = ""


@dataclass(frozen=True)
class Free:
    """A parameter to be found between two bounds; ``start`` adds a start there to the design.

    ``each`` gives every experiment its own value (always so for nuisances).
    """

    name: str
    lower: float
    upper: float
    start: float | None = None
    scale: Literal["log", "linear"] | None = None
    each: bool = False

    @property
    def log(self) -> bool:
        """Whether it is searched on a logarithmic scale: by default where both bounds are positive."""
        return self.scale == "log" if self.scale else self.lower > 0

    @property
    def per_experiment(self) -> bool:
        """Whether every experiment has its own."""
        return self.each or self.name in NUISANCES


@dataclass(frozen=True)
class Problem:
    """Scene, fixed parameter values, experiments and free parameters.

    Raises:
        InputError: on construction, for a free parameter the scene does not have, bounds the wrong way
            round or out of range, a start outside its bounds, a channel the scene has no contact for, times
            that do not increase, fewer samples than free parameters.
    """

    scene: AbstractScene
    params: dict[str, float]
    experiments: tuple[Experiment, ...]
    free: tuple[Free, ...]
    accuracy: float = 1e-5
    where: str = "problem"

    def __post_init__(self) -> None:
        if not self.free:
            raise InputError(
                self.where, "no free parameter", "add a table such as [free.stiffness] with lower and upper"
            )
        if not any(not e.hold_out for e in self.experiments):
            raise InputError(self.where, "no experiment to fit", "give at least one [[experiment]] without hold_out")
        for parameter in self.free:
            self._check_free(parameter)
        # Of a contact with members one is observed: seat_ball_2.
        contacts = channel_names(channels(self.scene))
        for experiment in self.experiments:
            _check_experiment(experiment, contacts)
        fitted = [e for e in self.experiments if not e.hold_out]
        samples = sum(np.isfinite(c.values).sum() for e in fitted for c in e.channels)
        unknowns = sum(len(fitted) if f.per_experiment else 1 for f in self.free)
        if samples <= unknowns:
            found = f"{samples} samples for {unknowns} free parameters"
            raise InputError(self.where, found, "free fewer parameters or give more data")
        if len({c.sigma is None for e in self.experiments for c in e.channels}) > 1:
            raise InputError(
                self.where, "some noise is stated and some is 'estimate'", "state all of it, or estimate all"
            )
        for e in self.experiments:
            for f in self.free:
                if f.name in e.fixed:
                    found = f"'{f.name}' is free, and known to be {e.fixed[f.name]:g} in {e.name}"
                    raise InputError(self.where, found, "take one of them out")

    def unit(self, name: str) -> str:
        """SI unit of a scene's parameter or nuisance."""
        return self._known()[name].unit

    def _known(self) -> dict[str, Quantity]:
        return {**self.scene.quantities, **NUISANCES}

    def _check_free(self, f: Free) -> None:
        where, known = f"{self.where}: [free.{f.name}]", self._known()
        if f.name not in known:
            raise InputError(where, f"scene '{self.scene.kind}' has no parameter '{f.name}'", nearest(f.name, known))
        for value in (f.lower, f.upper):
            check_value(where, known[f.name], value)
        if not f.lower < f.upper:
            raise InputError(where, f"lower = {f.lower:g} is not below upper = {f.upper:g}", "swap the bounds")
        if f.start is not None and not f.lower <= f.start <= f.upper:
            raise InputError(
                where, f"start = {f.start:g} is outside [{f.lower:g}, {f.upper:g}]", "start within the bounds"
            )
        if f.log and f.lower <= 0:
            raise InputError(where, f"scale = log with lower = {f.lower:g}", "use positive bounds or scale = 'linear'")


def _check_experiment(experiment: Experiment, contacts: list[str]) -> None:
    where = experiment.source or experiment.name
    late = np.flatnonzero(np.diff(experiment.times) <= 0)
    if late.size:
        k = int(late[0])
        found = f"time {experiment.times[k + 1]:g} s follows {experiment.times[k]:g} s in {experiment.name}"
        raise InputError(
            where, found, "times must increase: sort the rows, or split the runs with rows = { column = ... }"
        )
    for channel in experiment.channels:
        contact, _, component = channel.observes.partition(".")
        if contact not in contacts:
            raise InputError(where, f"observe '{channel.observes}': no contact '{contact}'", nearest(contact, contacts))
        if component not in COMPONENTS:
            raise InputError(where, f"observe '{channel.observes}'", nearest(component, COMPONENTS))
