"""The one interface that solvers, analyses and the calibration know: what every model says about itself.

Nothing outside ``models`` and ``mechanism`` asks what kind of model it holds. A model is static structure (an equinox
module without arrays, hashable): one compiled program per distinct model. Numbers live in the parameters, a flat dict
of float64 scalars that may be traced, batched and differentiated.
"""

from __future__ import annotations

import dataclasses
import textwrap
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.normal import AbstractLaw
from bcfj_jax.core.errors import InputError, quoted
from bcfj_jax.core.quantities import Quantity
from bcfj_jax.core.shapes import Drawing
from bcfj_jax.mechanism import inputs
from bcfj_jax.mechanism.arrays import leaf
from bcfj_jax.mechanism.moments import Account as Account
from bcfj_jax.mechanism.moments import Approaches as Approaches
from bcfj_jax.mechanism.moments import Arrow as Arrow
from bcfj_jax.mechanism.moments import Bodies as Bodies
from bcfj_jax.mechanism.moments import BodyMotion as BodyMotion
from bcfj_jax.mechanism.moments import Chain as Chain
from bcfj_jax.mechanism.moments import Choice as Choice
from bcfj_jax.mechanism.moments import Coarser as Coarser
from bcfj_jax.mechanism.moments import Continuous as Continuous
from bcfj_jax.mechanism.moments import Effort as Effort
from bcfj_jax.mechanism.moments import Flows as Flows
from bcfj_jax.mechanism.moments import Life as Life
from bcfj_jax.mechanism.moments import Orbit as Orbit
from bcfj_jax.mechanism.moments import Pose as Pose
from bcfj_jax.mechanism.moments import Proximity as Proximity
from bcfj_jax.mechanism.moments import Reading as Reading
from bcfj_jax.mechanism.moments import Scenery as Scenery
from bcfj_jax.mechanism.moments import Variant as Variant
from bcfj_jax.mechanism.structure import AbstractStructure, Dense
from bcfj_jax.xla.programs import ask

Params = Mapping[str, Array]
# Names of the implicit solvers of ``solve``, which ask a model for its structure.
IMPLICIT_SOLVERS = ("rodas3", "sdirk2", "bdf")


class ModelTraits(NamedTuple):
    """What solvers, budgets and features follow from."""

    # Whether it needs an implicit solver (stiff friction, strong damping); springs alone are oscillatory.
    stiff: bool = False
    # Whether it is integrated; without, each instant is solved for itself (``AbstractModel.instants``).
    history: bool = True
    # Whether a period is that of the force history (a drive turns), and not the interval between contacts.
    turning: bool = False
    large: bool = False  # whether one run fills a core (tens of states): batches are small and gain little
    rough: bool = False  # whether a fit's cost is rough in its parameters: many contacts begin and end in every run
    # Whether the model is yet to be chosen (``AbstractModel.choose``): ``simulate`` alone can run it.
    open: bool = False


class Solution(NamedTuple):
    """States (T, n) at the times asked for, NaN from a failure on; a status code; the time at which the run ended [s]."""

    states: Array
    code: Array
    end: Array
    # accepted, rejected: numbers of steps.
    accepted: Array
    rejected: Array
    # In the order of ``AbstractModel.alike`` ``solve.extremes.Extremes``, where the plan asks for them.
    extremes: Any = None
    totals: Any = None  # by account rows of ``solve.extremes.Totals``, likewise
    # What is of the continuous curves between the first and the last time, where it was asked for.
    whole: Continuous | None = None


class AbstractModel(eqx.Module):
    """Every model, as everything outside sees it.

    Attributes:
        kind: name of the family the model belongs to.
        contacts: what touches; each has a ``name``, a ``law`` and ``friction`` (or None).
        samples: a number of output times over the horizon that resolves a contact.
        defaults: default value of every parameter that has one, SI.
        horizon: (params) -> a sensible end time [s] where the user gives none.
    """

    if TYPE_CHECKING:
        # Fields, properties or methods of every model; as fields of this class they would come first in every model's.
        @property
        def kind(self) -> str: ...
        @property
        def contacts(self) -> tuple[Any, ...]: ...
        @property
        def samples(self) -> int: ...
        @property
        def defaults(self) -> tuple[tuple[str, float], ...]: ...
        @property
        def horizon(self) -> Callable[[Params], Array]: ...

    # Equinox also compares what a model has computed of itself and keeps; one made anew is still the same program.
    def __eq__(self, other: object) -> bool:  # pyright: ignore[reportIncompatibleMethodOverride]
        return type(self) is type(other) and all(
            getattr(self, field.name) == getattr(other, field.name) for field in dataclasses.fields(self)
        )

    __hash__ = eqx.Module.__hash__

    def __repr__(self) -> str:
        """What it is made of, by name: a few lines of at most 100 characters, whatever its size."""
        parts = {"bodies": self.body_names, "contacts": self.members, "parameters": self.quantities}
        lines = [
            f"{label}: {textwrap.shorten(', '.join(names), 85, placeholder=' ...')}" for label, names in parts.items()
        ]
        counted = ", ".join(f"{len(names)} {label}" for label, names in parts.items())
        return "\n  ".join([f"<{type(self).__name__} '{self.title}': {counted}", *lines]) + ">"

    # What it is.

    @property
    @abstractmethod
    def traits(self) -> ModelTraits:
        """What solvers, budgets and features follow from."""

    @property
    @abstractmethod
    def quantities(self) -> dict[str, Quantity]:
        """Every parameter the model has, in a readable order, by name."""

    @property
    def title(self) -> str:
        """What a sentence calls it."""
        return self.kind

    @property
    def members(self) -> dict[str, int]:
        """By contact, in the model's order, the number of its members (balls); 0 for a contact without."""
        return {contact.name: 0 for contact in self.contacts}

    # The ODE.

    def completed(self, params: Params) -> Params:
        """Parameters with what takes a search: every program of a run that prepares would search for it again."""
        return params

    def prepare(self, params: Params) -> Any:
        """What the field reads, computed once a run from the parameters; a pytree."""
        return dict(params)

    @abstractmethod
    def initial_state(self, params: Params) -> Array:
        """Flat state (n,) at time 0."""

    @abstractmethod
    def vector_field(self, t: Array, y: Array, prepared: Any) -> Array:
        """Time derivative of the flat state; ``prepared`` is ``prepare``'s."""

    @abstractmethod
    def error_scale(self, params: Params, end: ArrayLike = jnp.inf) -> Array:
        """(n,) what a step's error of each state is measured in, for a run until ``end`` [s].

        Without an end: the natural size of each state, the first that of a penetration [m].
        """

    @abstractmethod
    def tolerance(self, force_error: float) -> float:
        """Local error per step in units of ``error_scale`` for a force error as a fraction of the peak."""

    def first_step(self, params: Params, scales: Array) -> ArrayLike:
        """Length of the first step to try [s]; ``scales`` is ``error_scale``'s."""
        return 1e-2 * scales[0] / scales[-1]

    def structure(self) -> AbstractStructure:
        """Linear algebra of ``I/s - J`` for implicit solvers; its ``args`` are (model, prepared)."""
        return Dense(field)

    def origin(self, count: int) -> Any:
        """Where ``instants`` begins its search at so many times if it knows nothing, as NumPy arrays; () for none."""
        return ()

    def instants(self, params: Params, times: Array, near: Any = None, rates: bool = True) -> tuple[Solution, Any]:
        """States of a model without a history at times (T,), and from where to search those of similar parameters.

        Args:
            near: the second of these of an earlier call for the same number of times, or ``origin``'s.
            rates: whether velocities are wanted; those of a search cost a second derivative where it is differentiated.
        """
        raise InputError(
            f"scene '{self.kind}'", "has a history: it is integrated", "this is an error in bcfj-jax: please report it"
        )

    @property
    def shows_proximity(self) -> bool:
        """Whether steps are looked at for contacts that they hide, by ``proximity``; not where none can hide one."""
        return False

    @property
    def unsure(self) -> bool:
        """Whether steps are looked at between their ends, too, since what bends a penetration's course is not known."""
        return False

    def proximity(self, t: Array, y: Array, prepared: Any) -> Proximity:
        """How near all surfaces are to each other in one state. Only of a model that ``shows_proximity``."""
        raise InputError(f"scene '{self.kind}'", "shows no proximity", "this is an error in bcfj-jax: please report it")

    # Number of places where loads begin to act, or bend; runs that are differentiated end steps there.
    corners = 0

    def onsets(self, t: Array, y: Array, prepared: Any) -> tuple[Array, Array, Array]:
        """How far beyond each of ``corners`` a state is [m, rad] (C,), the rates, and forces that are cut off at 0."""
        return jnp.zeros(0), jnp.zeros(0), jnp.zeros(0)

    def breaks(self, params: Params, end: ArrayLike) -> Array | None:
        """Times (B,) at which a step until ``end`` [s] has to end: amounts over time have a kink there; None for none."""
        return None

    @property
    def longest_step(self) -> float | None:
        """Longest step that a solver may take [s]; None: as long as its errors allow."""
        return None

    @property
    def unweighed(self) -> bool:
        """Whether a contact acts between bodies whose motion is given, so that no step's error weighs what its force does."""
        return False

    @property
    def remembered(self) -> tuple[int, ...]:
        """Indices in the state of approach speeds, which a touch sets and which stay until the next (``approaches``)."""
        return ()

    def approaches(self, t: Array, y: Array, prepared: Any) -> Approaches:
        """What every speed of ``remembered`` is at a touch in this state."""
        return Approaches(*[jnp.zeros(0)] * 3)

    def misremembered(self, params: Params, run: Any) -> tuple[str, float]:
        """Why a run (``simulation.Run``) met other approach speeds than it remembers, and from when on [s]; "" and NaN if not."""
        return "", float("nan")

    # What instruments read.

    @abstractmethod
    def observe(self, t: Array, y: Array, prepared: Any) -> dict[str, Reading]:
        """Every contact's reading in one state."""

    @property
    def alike(self) -> tuple[tuple[str, ...], ...]:
        """Names of the contacts that ``read`` has side by side; here each by itself."""
        return tuple((c.name,) for c in self.contacts)

    def read(self, t: Array, y: Array, prepared: Any) -> list[Reading]:
        """``observe`` in the order of ``alike``: arrays of several contacts have an axis over them, their first."""
        found = self.observe(t, y, prepared)
        return [found[name] for (name,) in self.alike]

    def by_contact(self, found: Sequence[Any], axis: int = 0) -> dict[str, Any]:
        """What ``read`` gives, or anything in its order, by contact; ``axis``: the one over contacts."""

        def at(x: Any, k: int) -> Any:
            # NumPy's own arrays stay NumPy's: nothing is compiled.
            return x.take(k, axis) if isinstance(x, np.ndarray) else jax.lax.index_in_dim(x, k, axis, keepdims=False)

        parted: dict[str, Any] = {}
        for names, one in zip(self.alike, found, strict=True):
            for k, name in enumerate(names):
                parted[name] = one if len(names) == 1 else jax.tree.map(lambda x, k=k: at(x, k), one)
        return {c.name: parted[c.name] for c in self.contacts}

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies whose ``motions`` can be read."""
        return ()

    @property
    def body_members(self) -> dict[str, int]:
        """By body, the number of its members; a body without need not be named."""
        return {}

    def motions(self, t: Array, y: Array, prepared: Any) -> dict[str, BodyMotion]:
        """Every body's motion in one state."""
        return {}

    @property
    def load_names(self) -> tuple[str, ...]:
        """Names of the loads whose ``efforts`` can be read."""
        return ()

    def efforts(self, t: Array, y: Array, prepared: Any) -> dict[str, Effort]:
        """By body what its joint does, and by load what that does, in one state."""
        raise InputError(f"scene '{self.kind}'", "keeps no forces of joints and loads", "give a mechanism")

    def drawing(
        self, params: Params, size: float = 1.0, travel: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None
    ) -> Drawing:
        """What the model looks like; nothing by default, and then there is no ``scenery`` either. On the host.

        Args:
            params: as ever, as NumPy numbers.
            size: of the whole scene [m]; what has no size of its own (rods, points, planes) is drawn by it.
            travel: by contact and sliding body, least and greatest ``Scenery.offsets`` (3,) of a run.
        """
        return Drawing()

    def carriers(self) -> dict[str, str]:
        """By contact the body that its arrow is drawn on."""
        return {}

    def scenery(self, t: Array, y: Array, params: Params) -> Scenery:
        """What moves in the drawing, in one state. Pure."""
        raise InputError("drawing", f"scene '{self.kind}' cannot be drawn", "give a mechanism")

    def level(self, fidelity: str) -> AbstractModel:
        """The model of a level that ``choose`` chose, by its ``Choice.fidelity``."""
        return self

    def flows(self, t: Array, y: Array, prepared: Any) -> Flows:
        """The energy balance in one state."""
        raise InputError("balance", f"scene '{self.kind}' keeps no energy balance", "give a mechanism")

    def accounts(self, t: Array, y: Array, prepared: Any) -> dict[str, Account]:
        """What a run must balance, in one state: "energy", as ``flows`` have it; nothing where the model has none.

        A mechanism has, too, "<body> momentum <velocity>" and "<body> angular_momentum <velocity>".
        """
        try:
            given, taken, stored = self.flows(t, y, prepared)
        except InputError:
            return {}
        powers = [*given.values(), *taken.values()]
        rate = sum(given.values(), jnp.zeros(())) - sum(taken.values(), jnp.zeros(()))
        return {"energy": Account(sum(stored.values(), jnp.zeros(())), rate, sum(map(jnp.abs, powers), jnp.zeros(())))}

    # What is refused, and what is known beside.

    def check(self, params: Params, where: str = "") -> None:
        """Refuse parameters that no run can answer, before anything is compiled.

        Raises:
            InputError: naming the place, the value and what would be right.
        """

    def suspects(self, params: Params) -> np.ndarray:
        """Which of N runs ``check`` must look at, (N,): all, where a model does not know sooner that it passes them.

        Args:
            params: leaves (N,), in their ranges.
        """
        return np.ones(len(next(iter(params.values()))), bool)

    def require(self, params: Params, where: str = "") -> None:
        """Refuse parameters among which one is missing. Nothing is computed, and traced values do."""
        inputs.require_defaults(self, params, where or f"scene '{self.kind}'")

    def only_law(self) -> AbstractLaw | None:
        """The normal-force law of its one contact; None where there are several or none."""
        return None

    def with_law(self, law: AbstractLaw, more: Mapping[str, float]) -> AbstractModel:
        """This model with another law in its one contact, and ``more`` defaults of what that reads."""
        raise ValueError(f"{law} is for a model with one contact")

    def first_touch(self, params: Mapping[str, float]) -> float | None:
        """Time of the first contact [s], where the start alone tells it; None where only a run does."""
        return None

    def period(self, params: Params) -> tuple[float, float]:
        """Time of one turn of the drive, and of the pitch in which it repeats [s].

        Raises:
            InputError: for a model without a drive that turns.
        """
        raise InputError(f"scene '{self.kind}'", "has no drive, so it has no revolution", "take impacts, of a run")

    def coordinates(self) -> dict[str, tuple[int, int]]:
        """By name, where a coordinate and its velocity are in the flat state."""
        return {}

    @property
    def drive_coordinate(self) -> str:
        """Name in ``coordinates`` of the drive's turn; "" for a model without a drive that turns."""
        return ""

    def recurs(self, params: Params) -> bool:
        """Whether steady motion repeats itself after a ``pitch``. Decided on the host."""
        return False

    def pitch(self, params: Params) -> Array:
        """Time [s] in which steady motion repeats itself, its members renumbered: the second of ``period``. Pure."""
        raise InputError(f"scene '{self.kind}'", "has no pitch", "this is an error in bcfj-jax: please report it")

    def pitch_before(self, params: Params, state: Array) -> Array:
        """State of steady motion a ``pitch`` before this one. Pure."""
        raise InputError(f"scene '{self.kind}'", "has no pitch", "this is an error in bcfj-jax: please report it")

    def turned(self, params: Params) -> int:
        """Which member is a pitch ago where the first is now, counted from it: what it does is done a pitch later."""
        return 0

    def neutral(self, state: Array, tangent: Array) -> Array:
        """A tangent without what neither grows nor fades: the phase of a drive, a length that is kept."""
        return tangent

    def envelope(self, params: Params, times: np.ndarray) -> tuple[dict[str, float], list[str]]:
        """How far a run is from those on which its promised error was measured: numbers, and what no number says."""
        return {}, []

    def warnings(self, params: Params, run: Any) -> list[str]:
        """What a run (``solve.simulation.Run``) says against the model's own assumptions."""
        return []

    # Numbers of materials that are not those of steel (``materials``).
    life = ()

    def unit_pressure(self, params: Params, contact: str, material: Mapping[str, float]) -> Array | None:
        """(3,) s, m, c of Hertz's greatest pressure  p0 = max(s F^m, c F)  [Pa]; None where it is not known. Pure.

        m is 1/3 of a point and 1/2 of a line; c is of a pin that touches half of its hole (``stiffness.LineContact``), else 0.
        ``material`` (``materials``) has E* of a model without one, and the length of a line.
        """

    def bodies_at(self, params: Params, contact: str, deepest: float) -> Bodies:
        """How large the bodies at a contact are that is so deep at most [m], as far as the model reads it. On the host."""
        return Bodies()

    def settled_from(self, params: Params) -> float:
        """Time [s] from which the promised error holds: 0 unless the model forgets its start first.

        A run that ends before has no promise.
        """
        return 0.0

    @property
    def settled_when(self) -> str:
        """What has happened by ``settled_from``, in words."""
        return "the start is forgotten"

    def full(self) -> AbstractModel:
        """The model of the same thing that leaves nothing out: this one, unless it is a coarser one."""
        return self

    def suited(self, params: Params, end: float, solver: str | None = None) -> AbstractModel:
        """This model as a run of these parameters until ``end`` [s] is solved: stiff or not. Decided on the host.

        ``solver`` is one that the user names (``solve.named``): a model that explicit and implicit ones can solve
        takes it.
        """
        return self

    def choice_options(self) -> dict[str, Any]:
        """Fields, and options of the scene file, with which ``simulate`` chooses the level; empty without levels."""
        return {}

    def coarser(self) -> tuple[Coarser, ...]:
        """Cheaper models of the same thing, cheapest first; of an ``open`` model all that may be chosen."""
        return ()

    def variants(self, params: Params) -> tuple[Variant, ...]:
        """Other choices of the model, one change each, whose effect is the error of the model form; on the host."""
        return ()

    @property
    def model_form(self) -> str:
        """What is known of the error of the model form, to go on "the error is that of the computation; "."""
        return "laws, coefficients and rigid bodies are taken as given"

    def choose(
        self, params: Params, times: np.ndarray, budget: float, run: Callable[[AbstractModel, np.ndarray], Any]
    ) -> Any:
        """The run of the cheapest level that keeps a budget of force error, with its ``Choice``.

        ``run(model, times)`` makes a ``solve.simulation.Run``. Only of a model whose traits say ``open``.
        """
        return run(self, times)

    @property
    def tables(self) -> tuple[str, ...]:
        """Names of the files of ``whole``'s tables."""
        return ()

    def whole(self, params: Params, run: Any) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
        """What a run says of the model as a whole: entries of the summary, and by file name tables.

        A table has (T,) columns by their heads, which hold a unit, as ``seat_ball.x [N]``; time is not among them.
        An entry ``engineering`` is shown beside the contacts: by contact numbers, or pairs, of the keys in its ``units``,
        called by its ``titles``; a ``note`` on them; a ``warning``; ``quantities``, by name numbers by what they are
        (mean, peak), and their ``unit``; a ``quantities_note``.
        """
        return {}, {}

    def chain(self, params: Params) -> Chain | None:
        """What its links bear, of a model that is a row of them."""
        return None

    def orbits(self, params: Params, run: Any) -> dict[str, Orbit]:
        """By contact with a round clearance, where its inner body's centre is in it, of a run with its trajectory."""
        return {}

    # Parameters.

    def coefficient(self, params: Params, owner: str, name: str) -> Array:
        """``<owner>.<name>`` where the parameters have it, else the shared ``<name>``."""
        own = f"{owner}.{name}"
        return params[own] if own in params else params[name]

    def parameters(
        self, values: Mapping[str, ArrayLike | str] | None = None, **more: ArrayLike | str
    ) -> dict[str, Array]:
        """The model's parameters as a pytree of float64 leaves, SI; those without a default only where given.

        Args:
            values: values by name (for names with a dot in them).
            more: values by name. A value may be a number, a text with its unit ("20 um"), an array (a batch for
                ``vmap``) or traced.

        Raises:
            InputError: for a name the model does not have (with the nearest it has), for what is no number of the
                parameter's unit, and for a number outside its range.
        """
        known, defaults = self.quantities, dict(self.defaults)
        given = inputs.values(self, inputs.merged(values, more))
        return {
            name: leaf(given[name] if name in given else defaults[name])
            for name in known
            if name in given or name in defaults
        }

    def canonical(self, name: str) -> str:
        """The one name of a parameter: ``<contact>.clearance`` is ``clearance_<contact>``."""
        contact, _, own = name.rpartition(".")
        return f"clearance_{contact}" if own == "clearance" and contact else name


def as_model(given: Any) -> AbstractModel:
    """What was given as a model, if it is one."""
    if isinstance(given, AbstractModel):
        return given
    remedy = (
        f"give bj.scenes.{given}()" if isinstance(given, str) and given.isidentifier() else "give bj.scenes.impact()"
    )
    if isinstance(given, type) or callable(given):
        remedy = "call it: it makes the model"
    elif isinstance(given, Mapping):
        remedy = "the model comes first, then the parameters, then the times"
    raise InputError("scene", f"{quoted(given)} is no model", remedy)


def of_numbers(given: Any) -> AbstractModel:
    """As ``as_model``, of what varies or fits numbers: a batch of points has no place for parameters that are arrays."""
    found = as_model(given)
    arrays = [name for name, quantity in found.quantities.items() if quantity.shape]
    if arrays:
        remedy = "vary it by bj.force_history and jax.vmap, train it by jax.grad; or close over its arrays as constants"
        raise InputError(f"scene '{found.kind}'", f"has parameters that are arrays: {', '.join(arrays)}", remedy)
    return found


def horizon(model: AbstractModel, params: Params) -> float:
    """A sensible end time [s] of a run where none is given; nothing is compiled for it."""
    return float(ask("horizon", _horizon, (model,), (dict(params),)))


def _horizon(model: AbstractModel, params: Params) -> Array:
    return jnp.asarray(model.horizon(params))


@eqx.filter_jit  # Traced once for all of its places.
def field(t: Any, y: Array, args: tuple[AbstractModel, Any]) -> Array:
    """The vector field with arguments (model, what it has prepared)."""
    model, prepared = args
    return model.vector_field(t, y, prepared)
