"""Unknowns of the joint fitted to the paper's five peaks, and what those peaks determine of them.

Least squares on relative residuals r_i = F_i/paper_i - 1 of the six numbers that the five peaks are (Q23 has two), over the
logarithms of the unknowns in a box, with Huber's loss at ``ERROR``: a number that the model cannot reach does not drag the
others along. Forces are those of the quasistatic joint without friction: two small programs in place of one that takes
minutes to compile search for equilibrium, and give forces as functions of the parameters by the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.optimize import least_squares
from scipy.stats import qmc

from bcfj_jax.contact.stiffness import sphere_in_socket
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.defaults import DEFAULTS
from bcfj_jax.models.joint.model import joint_of_keys
from bcfj_jax.models.joint.quasistatic import Found, quasistatic_forces, quasistatic_places
from bcfj_jax.models.joint.scene import PLAIN, Joint
from bcfj_jax.reproduction.claims import claim

# The numbers fitted, in this order, and the claims they are of; Q23 is a range, and so two numbers.
TARGETS = ("Q20", "Q21", "Q23 least", "Q23 greatest", "Q26", "Q27")
_INSTANTS = 24

# What a peak of the paper is taken to be known to: a share of it. A GUESS; the paper states no error.
ERROR = 0.05
_SCREENED, _STARTS = 16, 4
_FAILED = 1e2
# Within this share of its range an unknown is at its bound.
_EDGE = 1e-3
# An unknown known to worse than this factor at 95 % is not determined, as in ``calibration``.
WIDEST_FACTOR = 2.0
# A box alone knows each unit coordinate to sqrt(1/12); to halve that takes a singular value s with s^2 + 12 > 4 x 12.
KNOWN = 6.0


def still_scene() -> Joint:
    """The joint of the calibration: equilibrium at each instant, no friction."""
    return joint_of_keys(fidelity="quasistatic", friction=False, **PLAIN)


def tied(params: Params, free: Params) -> Params:
    """``free`` with the stiffness of each pilot whose clearance is in it: Lankarani and Nikravesh's of that clearance."""
    modulus, found = DEFAULTS["effective_modulus"][0], dict(free)
    if "clearance_seat_cage" in free:
        play, seat = free["clearance_seat_cage"], params["seat_radius"]
        found["seat_cage.stiffness"] = sphere_in_socket(modulus, seat, seat - play)
    if "clearance_head_cage" in free:
        play, head = free["clearance_head_cage"], params["head_radius"]
        found["head_cage.stiffness"] = sphere_in_socket(modulus, head + play, head)
    return found


def instants(params: Params, balls: int) -> np.ndarray:
    """Times over one passage of a ball [s], well past the load ramp: equal balls repeat what the joint does."""
    turn = 2.0 * np.pi / float(params["drive_speed"])
    first = turn * np.ceil(2.0 * float(params["load_ramp"]) / turn)
    return first + turn / balls * np.arange(_INSTANTS) / _INSTANTS


def _peaks(scene: Joint, params: Params, times: Array, found: Found) -> Array:
    force = quasistatic_forces(scene, params, times, found)
    window = force["cage_ball"]
    seat, head, into, out = (jnp.max(force[n]) for n in ("seat_cage", "head_cage", "seat_ball", "head_ball"))
    return jnp.stack([seat, head, jnp.min(window), jnp.max(window), into, out])


@eqx.filter_jit
def _slopes(scene: Joint, params: Params, free: Params, times: Array, found: Found) -> tuple[Array, Params]:
    def at(free: Params) -> tuple[Array, Array]:
        peaks = _peaks(scene, {**params, **tied(params, free)}, times, found)
        return peaks, peaks

    slopes, peaks = jax.jacfwd(at, has_aux=True)(free)
    return peaks, slopes


def peaks(scene: Joint, params: Params, free: Params) -> tuple[np.ndarray, dict[str, np.ndarray], bool]:
    """The numbers of ``TARGETS`` [N] with ``free`` in place of ``params`` (``tied``), their derivatives by each of these, and
    whether equilibrium was found.
    """
    times = jnp.asarray(instants(params, scene.balls))
    free = {name: jnp.asarray(value, dtype=float) for name, value in free.items()}
    found = quasistatic_places(scene, {**params, **tied(params, free)}, times)
    values, slopes = _slopes(scene, dict(params), free, times, found)
    good = bool(jnp.all(found.converged)) and bool(jnp.all(jnp.isfinite(values)))
    return np.asarray(values), {name: np.asarray(slope) for name, slope in slopes.items()}, good


class Unknown(NamedTuple):
    """A parameter that the paper leaves open: its bounds [SI], searched on a logarithmic scale, and their reason."""

    name: str
    lower: float
    upper: float
    unit: str
    reason: str


UNKNOWNS = (
    Unknown("contact_angle", np.radians(35.0), np.radians(45.0), "rad", "usual for gothic grooves (no source at hand)"),
    Unknown("offset", 0.08 * 35.5e-3, 0.14 * 35.5e-3, "m", "usual share of the pitch radius, 0.08 to 0.14 (no source at "
            "hand)"),
    Unknown("stiffness", 2.865e10, 6.245e10, "N/m^1.5", "elliptic Hertz (contact.stiffness.ball_in_groove) for "
            "conformities of 0.54 to 0.505"),
    Unknown("cage_ball.stiffness", 0.5 * 1.3476e10, 1.05 * 1.3476e10, "N/m^1.5", "Hertz, ball on flat (Johnson 1985), with "
            "a modulus 5 % higher at most; half of it for a window bar that bends (GUESS)"),
    Unknown("clearance_seat_cage", 20e-6, 100e-6, "m", "usual radial play (no source at hand); the stiffness follows, "
            "Lankarani and Nikravesh 1990, which needs a penetration far below the play"),
    Unknown("clearance_head_cage", 20e-6, 100e-6, "m", "as clearance_seat_cage"),
)  # fmt: skip


def targets() -> np.ndarray:
    """The paper's numbers, in the order of ``TARGETS`` [N]."""
    return np.array([v for name in dict.fromkeys(t.split()[0] for t in TARGETS) for v in claim(name).values])


class Estimate(NamedTuple):
    """One fitted unknown: "determined", "not determined" or "at bound"; it could be larger or smaller by ``factor95``, were the
    peaks known to ``ERROR`` and the model right.
    """

    value: float
    factor95: float
    verdict: str


class PeakFit(NamedTuple):
    """A fit to the peaks."""

    estimates: dict[str, Estimate]  # by name
    peaks: np.ndarray  # the quasistatic model's [N], in the order of ``TARGETS``
    residuals: np.ndarray  # peaks/paper - 1
    singular: np.ndarray  # singular values of the residuals' derivative by the unknowns in the unit box, over ``ERROR``
    directions: np.ndarray  # (k, unknowns), the combination each belongs to
    combinations: int  # how many of them the data determine: singular value above ``KNOWN``
    costs: tuple[float, ...]  # of every start's end, least first; infinite for one that failed
    reach: np.ndarray  # (2, numbers) least and greatest of each peak at any point evaluated [N]
    # Starts that ended within a hundredth of the least cost (or of one miss by ``ERROR``, if that is more).
    agreeing: int
    evaluations: int  # of the model and its derivatives

    @property
    def values(self) -> dict[str, float]:
        """The fitted unknowns [SI]."""
        return {name: estimate.value for name, estimate in self.estimates.items()}

    @property
    def at_bound(self) -> list[str]:
        """Unknowns that ended at a bound: the peaks ask for more than is physical."""
        return [name for name, estimate in self.estimates.items() if estimate.verdict == "at bound"]

    def applied(self, params: Params) -> Params:
        """All parameters with the fitted unknowns, and the pilots' stiffnesses that follow from them."""
        found = tied(params, {name: jnp.asarray(value) for name, value in self.values.items()})
        return {**params, **found}


class _Model:
    """Relative residuals and their derivative in the unit box of logarithms; a failure is a residual far above any."""

    def __init__(self, params: Params, unknowns: tuple[Unknown, ...], wanted: np.ndarray):
        self.scene = still_scene()
        self.params = {name: params[name] for name in self.scene.parameters() if name in params}
        self.unknowns, self.wanted = unknowns, wanted
        self.low = np.log([u.lower for u in unknowns])
        self.span = np.log([u.upper for u in unknowns]) - self.low
        self.evaluations = 0
        self.reach = np.array([np.full(wanted.size, np.inf), np.full(wanted.size, -np.inf)])
        self._last: tuple[bytes, tuple[np.ndarray, np.ndarray, np.ndarray]] | None = None

    def values(self, point: np.ndarray) -> dict[str, float]:
        """Unknowns [SI] at a point of the box."""
        at = np.exp(self.low + self.span * point)
        return {u.name: float(v) for u, v in zip(self.unknowns, at, strict=True)}

    def __call__(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals, their derivative, peaks."""
        key = np.asarray(point).tobytes()
        if self._last is None or self._last[0] != key:
            free = self.values(point)
            found, slopes, good = peaks(self.scene, self.params, {k: jnp.asarray(v) for k, v in free.items()})
            slope = np.stack([slopes[name] * free[name] for name in free], -1) * self.span / self.wanted[:, None]
            residual = found / self.wanted - 1.0
            if not (good and np.isfinite(slope).all()):
                found = np.full_like(found, np.nan)
                residual, slope = np.full(self.wanted.size, _FAILED), np.zeros((self.wanted.size, len(free)))
            self.evaluations += 1
            self.reach = np.array([np.fmin(self.reach[0], found), np.fmax(self.reach[1], found)])
            self._last = key, (residual, slope, found)
        return self._last[1]


def _cost(residual: np.ndarray) -> float:
    """Huber's loss, as ``least_squares`` has it."""
    size = np.abs(residual) / ERROR
    return float(0.5 * ERROR**2 * np.sum(np.where(size <= 1, size**2, 2 * size - 1)))


def fit(
    params: Params,
    unknowns: tuple[Unknown, ...] = UNKNOWNS,
    wanted: np.ndarray | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> PeakFit:
    """Fit unknowns, from their values in ``params`` and others, to six peaks ordered as ``TARGETS``, by default the paper's."""
    model = _Model(params, unknowns, targets() if wanted is None else wanted)
    design = qmc.Sobol(len(unknowns), rng=0).random(_SCREENED)
    costs = [_cost(model(point)[0]) for point in design]
    say(f"{sum(c < 1e2 for c in costs)} of {_SCREENED} screened points have an equilibrium")
    own = (np.log([float(params[u.name]) for u in unknowns]) - model.low) / model.span
    starts = [np.clip(own, 0.01, 0.99), *design[np.argsort(costs)[: _STARTS - 1]]]
    ends = []
    for number, start in enumerate(starts):
        result = least_squares(
            lambda u: model(u)[0], start, jac=lambda u: model(u)[1],  # pyright: ignore[reportArgumentType]
            bounds=(0.0, 1.0), x_scale=1.0, loss="huber", f_scale=ERROR, xtol=1e-6, ftol=1e-6, gtol=1e-8, max_nfev=30,
        )  # fmt: skip
        residual, _, _ = model(result.x)
        ends.append((np.inf if np.all(residual == _FAILED) else _cost(residual), result.x))
        say(f"start {number + 1} of {len(starts)}: cost {ends[-1][0]:.4g} after {result.nfev} evaluations")
    ends.sort(key=lambda end: end[0])
    return _assess(model, ends)


def _assess(model: _Model, ends: list[tuple[float, np.ndarray]]) -> PeakFit:
    """What the best end is worth."""
    best, point = ends[0]
    residual, slope, found = model(point)
    _, singular, directions = np.linalg.svd(slope / ERROR, full_matrices=False)
    # Peaks known to ERROR and an unknown that is anywhere in its range (variance 1/12 of the unit box).
    covariance = np.linalg.inv(slope.T @ slope / ERROR**2 + 12.0 * np.eye(point.size))
    factors = np.exp(1.96 * np.sqrt(np.diag(covariance)) * model.span)
    estimates = {}
    each = zip(model.unknowns, point, factors, model.values(point).values(), model.span, strict=True)
    for unknown, place, factor, value, width in each:
        at_bound = not _EDGE < place < 1.0 - _EDGE
        # A narrow box must not pass for knowledge: the data must have halved it too.
        known = factor < min(WIDEST_FACTOR, float(np.exp(0.5 * 1.96 * np.sqrt(1.0 / 12.0) * width)))
        verdict = "at bound" if at_bound else "determined" if known else "not determined"
        estimates[unknown.name] = Estimate(value, float(factor), verdict)
    costs = tuple(cost for cost, _ in ends)
    agreeing = sum(cost <= best + 0.01 * max(best, 0.5 * ERROR**2) for cost in costs)
    determined = int(np.sum(singular > KNOWN))
    return PeakFit(
        estimates, found, residual, singular, directions, determined, costs, model.reach, agreeing, model.evaluations
    )


def combination(direction: np.ndarray, names: Sequence[str]) -> str:
    """A direction in words: the unknowns that make it up, most first."""
    parts = sorted(zip(direction, names, strict=True), key=lambda part: -abs(part[0]))
    return " ".join(f"{weight:+.2f} {name}" for weight, name in parts if abs(weight) >= 0.2)
