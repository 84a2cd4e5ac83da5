"""Normal-force laws: (penetration, penetration rate, coefficients) in, force out.

A law is an elastic part with a way to lose energy. It takes one scalar contact (or any broadcast
shape) and knows nothing of geometry, bodies or time. The force is pushing only: every law is clipped
at zero, since a formula with damping turns tensile just before separation.

A law may have states (relaxation, plastic deformation). They stand beside the coefficients, by their names. A state is 0
where the surfaces have not touched; the contact integrates its rate and lets it go when apart (``regularised_rates``).

To add a law: a subclass of ``AbstractLaw`` that gives ``needs`` and ``force`` (``AbstractLaw.example``), and a line in
``laws.LAWS``; one with states also gives ``rates``, ``sizes`` and ``stored``.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.elastic import BACKING, AbstractElastic, Coefficients, Linear, Power, backing
from bcfj_jax.contact.part import Part, checked
from bcfj_jax.contact.restitution import LOWEST_RESTITUTION
from bcfj_jax.core.errors import InputError
from bcfj_jax.core.numerics import bisected, positive, smooth_ramp, smooth_step

# Gap [m] over which a contact forgets what it remembered while it touched.
GAP = 1e-6
# A surface that is pressed again yields from this fraction of its greatest penetration before that penetration.
_RELOADED = 1e-3
# The rate of a greatest penetration has a corner where it is reached: a step across it is as wrong in the derivatives as
# the square root of its error. With this part of the size they are some 30 times better for half as many steps more.
_CORNER = 1e-2
# Gauss-Legendre on (0, 1) in s, x = r s^2: exact for d^1.5, and to rounding for every power n >= 1 or its root.
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(24), (1.0, 0.0), strict=True))


class AbstractLaw(Part):
    """Normal force F(d, d') >= 0 of one contact; ``states`` names the numbers that the law remembers of it.

    ``bends`` says whether the force has a corner over the penetration where that turns, from approach to departure; ``ends``
    whether it may end, with a corner, before the surfaces part, and ``jumps`` whether it may be above 0 where they touch.
    """

    states: ClassVar[tuple[str, ...]] = ()
    bends: ClassVar[bool] = False
    ends: ClassVar[bool] = False
    jumps: ClassVar[bool] = True
    example: ClassVar[str] = """
class Linear(bj.laws.AbstractLaw):
    needs = ("stiffness",)
    def force(self, penetration, rate, c):
        return c["stiffness"] * jnp.maximum(penetration, 0.0)
"""

    @property
    @abstractmethod
    def needs(self) -> tuple[str, ...]:
        """Names of the coefficients read by ``force``."""

    @abstractmethod
    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        """Normal force [N].

        Args:
            penetration: d [m], 0 or less when apart.
            rate: d' [m/s], positive while approaching.
            c: the coefficients named by ``needs`` and the states, SI.
        """

    def rates(self, penetration: Array, rate: Array, c: Coefficients) -> tuple[Array, ...]:
        """Time derivatives of the states while the surfaces overlap. Arguments as ``force``."""
        return ()

    def sizes(self, penetration: Array, c: Coefficients) -> tuple[Array, ...]:
        """Of each state, the change whose effect is about that of an error as large as the penetration to expect [m]."""
        return ()

    def stored(self, penetration: Array, c: Coefficients) -> Array:
        """Elastic energy [J]; what work exceeds its change is lost. Without states: the work of the force at rest."""
        return _work(lambda x, c: self.force(x, jnp.zeros_like(x), c), penetration, c)

    def forgets(self, c: Coefficients) -> ArrayLike:
        """Gap [m] over which the states are let go."""
        return GAP


def _work(force: Callable[[Array, Coefficients], Array], penetration: Array, c: Coefficients) -> Array:
    """Integral of a force from 0 to the penetration [J]."""
    reach = positive(penetration)
    # Names with a dot are of arrays that a law reads as a whole (``mechanism.arrays``).
    wide = {name: x[..., None] if getattr(x, "ndim", 0) and "." not in name else x for name, x in c.items()}
    return jnp.sum(force(reach[..., None] * _NODES**2, wide) * 2.0 * _NODES * _WEIGHTS, -1) * reach


class AbstractElasticLaw(AbstractLaw):
    """A law f(d) with a loss; ``reads`` names the coefficients of the loss, beside those of the elastic part f."""

    jumps: ClassVar[bool] = False
    reads: ClassVar[tuple[str, ...]] = ()
    elastic: AbstractElastic = Power()

    def __check_init__(self):
        remedy = "give one of bj.laws, such as Power()"
        checked(f"law {type(self).__name__} elastic", self.elastic, AbstractElastic, "elastic part", remedy)

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.elastic.needs, *self.reads)))


class Hertz(AbstractElasticLaw):
    """F = f(d): elastic, no loss. Hertz 1881 with the default power part; valid for v0 << 1e-5 sqrt(E/rho)."""

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        return self.elastic.force(penetration, c)


class KelvinVoigt(AbstractElasticLaw):
    """F = K d + c d' in contact (Kelvin-Voigt): jumps by c v0 at first touch unless the contact is regularised.

    Pushing only: restitution as Schwager and Poeschel 2007. With ``tension`` the dashpot may pull until
    the gap opens, and e = exp(-pi z / sqrt(1 - z^2)), z = c / (2 sqrt(K m)).
    Coefficients: ``stiffness`` K [N/m], ``dashpot`` c [N s/m].
    """

    ends: ClassVar[bool] = True
    jumps: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("dashpot",)
    elastic: AbstractElastic = Linear()
    tension: bool = eqx.field(static=True, default=False)

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        total = self.elastic.force(penetration, c) + c["dashpot"] * rate
        total = jnp.where(penetration > 0, total, 0.0)
        return total if self.tension else positive(total)


class MemoryFree(AbstractElasticLaw):
    """F = f(d) (1 + a d'). Hunt and Crossley 1975 as they wrote it: no memory of the approach speed.

    chi = a v0 for each impact, so the restitution falls with speed (e = 1 - 2 a v0 / 3 + ...), as metals do.
    No event and no latched state: the law to prefer in simulation. Any speed; the restitution is
    ``restitution.delivered_restitution(a v0)``.
    Coefficients: those of the elastic part and ``damping`` a [s/m] >= 0.
    """

    reads: ClassVar[tuple[str, ...]] = ("damping",)

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        return self.elastic.force(penetration, c) * positive(1.0 + c["damping"] * rate)


class DampedStop(AbstractElasticLaw):
    """F = f(d) (1 + a d') + K_b r(d - d_b) (1 + a_b d'): a layer on a stop, each with the loss of its own.

    ``MemoryFree`` of the layer, and Hunt and Crossley's again of the stop of ``elastic.TwoStage``; each part pushes
    only. The energy that they take adds up; a_b = a is ``MemoryFree`` with the elastic part ``two_stage``.
    Coefficients: those of the elastic part, ``damping`` a [s/m], ``bottoming_stiffness`` K_b [N/m],
    ``bottoming_penetration`` d_b [m], ``bottoming_width`` w [m] and ``bottoming_damping`` a_b [s/m] >= 0.
    """

    reads: ClassVar[tuple[str, ...]] = ("damping", *BACKING, "bottoming_damping")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        layer = self.elastic.force(penetration, c) * positive(1.0 + c["damping"] * rate)
        return layer + backing(penetration, c) * positive(1.0 + c["bottoming_damping"] * rate)


class Restitution(AbstractElasticLaw):
    """F = f(d) (1 + chi(e) d'/v0), the family of ``restitution.FACTORS``; v0 is the approach speed of this impact.

    Validity is the factor's: a comment there says which e each delivers. ``exact`` delivers all.
    Coefficients: those of the elastic part, ``restitution`` e [-] and ``approach_speed`` v0 [m/s] > 0, which
    the scene supplies (at least 1e-9 m/s, which keeps a resting contact finite).
    """

    factor: Callable[[Array], Array] = eqx.field(static=True, kw_only=True)
    reads: ClassVar[tuple[str, ...]] = ("restitution", "approach_speed")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        damping = self.factor(c["restitution"]) / jnp.maximum(c["approach_speed"], 1e-9)
        return self.elastic.force(penetration, c) * positive(1.0 + damping * rate)


class AdamsImpact(AbstractElasticLaw):
    """F = max(0, K d^n + c_max step(d, 0, 0, h, 1) d'): the IMPACT function of ADAMS and MotionSolve.

    The cubic step s^2 (3 - 2 s), s = min(d/h, 1), lets the dashpot in over the depth h. Loses much energy
    at high speed: c_max = 50 N s/mm is nearly plastic at 1.5 m/s, and its damping raises the peak.
    Coefficients: those of the elastic part, ``dashpot`` c_max [N s/m], ``damping_depth`` h [m] > 0.
    """

    ends: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("dashpot", "damping_depth")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        share = smooth_step(penetration / c["damping_depth"])
        return positive(self.elastic.force(penetration, c) + c["dashpot"] * share * rate)


class ElastoGap(AbstractElasticLaw):
    """F = f(d) + clip(c d', -f(d), f(d)): a dashpot that neither pulls nor weighs more than the spring beside it.

    ElastoGap of Modelica.Mechanics.Translational (Modelica Standard Library 4.0; physics sheet 1.2) for one direction:
    0 <= F <= 2 f(d), so the force neither jumps at touch nor pulls before separation. With f(d) = K d the restitution is
    the same at every speed, below Kelvin-Voigt's loss: while c d' > K d the stop is a spring of 2 K. The corners where
    the dashpot is limited are no smoother than that.
    Coefficients: those of the elastic part, ``dashpot`` c [N s/m].
    """

    ends: ClassVar[bool] = True
    jumps: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("dashpot",)

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        spring = self.elastic.force(penetration, c)
        damped = jnp.clip(c["dashpot"] * rate, -spring, spring)
        # Apart both are 0; so are then their derivatives.
        return jnp.where(penetration > 0, spring + damped, 0.0)


class StandardLinearSolid(AbstractElasticLaw):
    """F = f(d) (1 + a d')_+ + s,  s' = r f' - s/tau: ``MemoryFree`` with a Maxwell branch beside it (Zener).

    The standard linear solid (Zener 1948, Elasticity and Anelasticity of Metals; Lakes 2009, Viscoelastic Materials,
    2.6) with f in place of K d, which is Fung's quasi-linear viscoelasticity with one exponential. A quick press meets
    (1 + r) f(d); held, the force falls to f(d) as exp(-t/tau). The loss is greatest for contacts as long as some tau;
    presses much quicker or slower than tau are elastic. With r = 0 it is ``MemoryFree``. Linear in f: strains where
    the modulus does not depend on the strain.
    The state is the relaxed force q [N],  q' = (f - q)/tau,  s = r (f - q): smooth at touch, no f' needed. The branch
    is free of load at each new touch. A body that is pressed at time 0 has been pressed there at once.
    Stored are Phi(d) and the branch's r int_p^d (f - q) dx, with Phi the integral of f, f(p) = q; the branch loses
    r (f - q)(d - p)/tau >= 0. Where F = 0 the surface lags behind the body: d is then where the two parts cancel. What
    the branch holds when the body leaves is lost there.
    Coefficients: those of the elastic part, ``damping`` a [s/m], ``relaxation`` r [-] >= 0, ``relaxation_time`` tau [s].
    """

    states: ClassVar[tuple[str, ...]] = ("relaxed_force",)
    ends: ClassVar[bool] = True
    reads: ClassVar[tuple[str, ...]] = ("damping", "relaxation", "relaxation_time")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        spring = self.elastic.force(penetration, c)
        branch = c["relaxation"] * (spring - positive(c["relaxed_force"]))
        return positive(spring * positive(1.0 + c["damping"] * rate) + branch)

    def rates(self, penetration: Array, rate: Array, c: Coefficients) -> tuple[Array, ...]:
        """The relaxed force follows the elastic one: q' = (f - q)/tau."""
        return ((self.elastic.force(penetration, c) - c["relaxed_force"]) / c["relaxation_time"],)

    def sizes(self, penetration: Array, c: Coefficients) -> tuple[Array, ...]:
        # Of a branch stiffer than the elastic part, that which has the branch's force as large.
        return (self.elastic.force(penetration, c) / jnp.maximum(c["relaxation"], 1.0),)

    def stored(self, penetration: Array, c: Coefficients) -> Array:
        # Both springs' energy. The surface's and the branch's penetrations are stationary points of it, hence constants.
        r, q = c["relaxation"], positive(c["relaxed_force"])
        surface = jnp.maximum(penetration, self._penetration(r * q / (1.0 + r), c))
        relaxed = self._penetration(q, c)
        work = lambda d: _work(self.elastic.force, d, c)  # noqa: E731
        return (1.0 + r) * work(surface) - r * (q * surface - q * relaxed + work(relaxed))

    def _penetration(self, force: Array, c: Coefficients) -> Array:
        """Penetration [m] of an elastic force, by bisection; a constant to derivatives."""
        force = jax.lax.stop_gradient(force)
        c = {name: jax.lax.stop_gradient(value) for name, value in c.items()}
        deep = lambda level: self.elastic.force(jnp.exp(level), c) > force  # noqa: E731
        bracket = (jnp.full_like(force, jnp.log(1e-18)), jnp.full_like(force, jnp.log(1e2)))
        return jnp.where(force > 0, jnp.exp(bisected(deep, bracket, 64)[1]), 0.0)


class AbstractPlastic(AbstractElasticLaw):
    """F = h f(m - u/w): loading along h f(d), unloading and reloading along an elastic curve from the greatest penetration.

    m is the greatest penetration of this contact and u = m - d >= 0 the state ``unloaded`` [m]: u' = -d' while the
    surfaces part. While they close u' = -d' until u is 0, where the surface yields again: it begins to yield when u is
    below 0.1 % of m, which makes m too great by at most 0.1 % where it is pressed again. The first loading is exact.
    The dent is not kept: after the surfaces part (d < 0) they meet elsewhere and the next contact starts afresh.
    A first loading changes no state: where every body is driven, a solver with nothing else to follow may step across an
    unloading. Quasi-static: F does not depend on the rate. The energy stored is h w Phi(m - u/w), with Phi the integral of f.
    """

    states: ClassVar[tuple[str, ...]] = ("unloaded",)
    bends: ClassVar[bool] = True
    ends: ClassVar[bool] = True

    @abstractmethod
    def unloading(self, deepest: Array, c: Coefficients) -> tuple[Array, Array]:
        """Height h and width w of the unloading curve from the greatest penetration [m], both relative to f."""

    def _unloaded(self, penetration: Array, c: Coefficients) -> tuple[Array, Array, Array]:
        """h, w and m - u/w."""
        unloaded = positive(c["unloaded"])
        deepest = penetration + unloaded
        height, width = self.unloading(deepest, c)
        return height, width, deepest - unloaded / width

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        height, _, equivalent = self._unloaded(penetration, c)
        return height * self.elastic.force(equivalent, c)

    def rates(self, penetration: Array, rate: Array, c: Coefficients) -> tuple[Array, ...]:
        """The distance grows as the surfaces part, and falls to 0 as they close; at separation it stops without a jump."""
        unloaded = c["unloaded"]
        deepest = jnp.maximum(penetration + unloaded, 1e-30)
        left, right = (smooth_step(x / (_RELOADED * deepest)) for x in (penetration, unloaded))
        return (-rate * jnp.where(rate < 0, left, right),)

    def sizes(self, penetration: Array, c: Coefficients) -> tuple[Array, ...]:
        """A part of the unloading curve's width."""
        _, width = self.unloading(penetration, c)
        return (_CORNER * width * penetration,)

    def forgets(self, c: Coefficients) -> Array:
        """The dent's own depth, where that is less than ``GAP``: a flight may be lower than a micrometre."""
        return jnp.clip(c["unloaded"], 1e-15, GAP)

    def stored(self, penetration: Array, c: Coefficients) -> Array:
        """Work of the unloading: h w Phi(m - u/w)."""
        height, width, equivalent = self._unloaded(penetration, c)
        return height * width * _work(self.elastic.force, equivalent, c)


class WaltonBraun(AbstractPlastic):
    """F = K1 d loading, F = K2 (d - d0) unloading,  d0 = m (1 - K1/K2),  K2 = K1/e^2; m the greatest penetration.

    Walton and Braun 1986 (Journal of Rheology 30, 949), their latching spring with constant K1/K2: the restitution is e
    at every speed. Stated by e instead of K2, since e is what a drop test measures, is bounded, and for no loss is 1.
    With another elastic part, F = f(m - (m - d)/e^2): the loading curve narrowed by e^2, which keeps the restitution at
    e for every f. Needs no approach speed. Collisions whose loss is plastic and whose restitution hardly depends on
    the speed. e below 0.001 is taken as 0.001.
    Contact from touch to no force: (1 + e) (pi/2) sqrt(m/K1) for a mass m.
    Coefficients: those of the elastic part (``linear`` by default: ``stiffness`` K1 [N/m]), ``restitution`` e [-].
    """

    reads: ClassVar[tuple[str, ...]] = ("restitution",)
    elastic: AbstractElastic = Linear()

    def unloading(self, deepest: Array, c: Coefficients) -> tuple[Array, Array]:
        """1 and e^2."""
        return jnp.ones(()), jnp.maximum(c["restitution"], LOWEST_RESTITUTION) ** 2


class Thornton(AbstractPlastic):
    """Hertz up to the yield penetration d_y, then F = f(d_y) + f'(d_y)(d - d_y); unloading Hertzian of a larger radius.

    Thornton 1997 (Journal of Applied Mechanics 64, 383): elastic, perfectly plastic spheres. Beyond yield the contact
    pressure is constant, so F rises along the tangent at d_y, and unloading is Hertz's with the radius R/b,
    b = F(m)/f(m), from the greatest penetration m:  F = b f(m - (m - d)/b). With f = K d^1.5 the yield speed is
    V_y = sqrt(4 K d_y^2.5 / (5 mass)), e = 1 up to it and above, with x = V_y/V,
    e^2 = (6 sqrt(3)/5) (1 - x^2/6) sqrt(x / (x + 2 sqrt(6/5 - x^2/5))), about 1.19 x^(1/4) for x << 1.
    Contact pressure at the centre at yield, with the relative radius R: p_y = (2 E*/pi) sqrt(d_y/R). Real metals
    harden, so that V from some 50 V_y on is beyond the theory.
    Coefficients: those of the elastic part, ``yield_penetration`` d_y [m] > 0.
    """

    reads: ClassVar[tuple[str, ...]] = ("yield_penetration",)

    def unloading(self, deepest: Array, c: Coefficients) -> tuple[Array, Array]:
        first = c["yield_penetration"]
        force, slope = jax.jvp(lambda d: self.elastic.force(d, c), (first,), (jnp.ones_like(first),))
        beyond = jnp.maximum(deepest, first)
        share = (force + slope * (beyond - first)) / self.elastic.force(beyond, c)
        return share, share


def regularised_force(law: AbstractLaw, penetration: Array, rate: Array, c: Coefficients, width: Array | None) -> Array:
    """Normal force [N] of a law from penetration d [m] and rate d' [m/s].

    With a regularisation r(d) of width w (``numerics.smooth_ramp``) the force is  F = r'(d) law(r(d), d'):
    the law's own energy stored along r instead of d. Whatever lies beyond d = w is then exactly the
    sharp law's: for every law f(d) (1 + chi d'/v0), peak force, greatest penetration, restitution and
    hence impulse do not change at all where the peak is beyond w, and the contact lasts 2 w / v0 longer
    (first order in w over the greatest penetration). Only the first and last 2 w of the loop differ.
    A body that starts nearer than w has not felt the beginning of the regularisation: from touching, d = 0, the peak of an
    undamped impact is higher by the fraction n/(n+1) (0.15625 w/d0)^(n+1), the energy not yet stored.

    Args:
        law, penetration, rate, c: as ``AbstractLaw.force``.
        width: half-width w [m] of the regularisation, >= 0; None takes the smoothing out of the program.
    """
    ramp, slope = (penetration, 1.0) if width is None else smooth_ramp(penetration, width)
    found = law.force(ramp, rate, c)
    if jnp.shape(found) not in ((), jnp.shape(ramp)):
        seen = f"a force of shape {jnp.shape(found)} for a penetration of shape {jnp.shape(ramp)}"
        raise InputError(f"law {type(law).__name__}", seen, "return one force [N] for each penetration")
    return found if width is None else slope * found


def regularised_rates(
    law: AbstractLaw, penetration: Array, rate: Array, c: Coefficients, width: ArrayLike
) -> tuple[Array, ...]:
    """Rates of a law's states, along the regularised penetration. Arguments as ``regularised_force``; no width is 0.

    Apart, beyond the regularisation, a state s is let go as the bodies part at the speed v, over the gap g:
    s' = -4 v s/(g + l),  l = ``law.forgets``, which sets in over that gap (C1). s falls as the fourth power of the gap, whatever
    the scale.
    """
    if not law.states:
        return ()
    ramp, slope = smooth_ramp(penetration, width)
    gap = positive(-penetration - width)
    reach = law.forgets(c)
    apart, loss = smooth_step(gap / reach), 4.0 * positive(-rate) / (gap + reach)
    found = zip(law.states, law.rates(ramp, slope * rate, c), strict=True)
    return tuple((1.0 - apart) * x - apart * loss * c[name] for name, x in found)


def regularised_energy(
    law: AbstractLaw, penetration: Array, rate: Array, c: Coefficients, changes: Coefficients, width: Array | None
) -> tuple[Array, Array]:
    """Elastic energy [J] along the regularised penetration, and the power [W] of the force at rest that its states lose.

    ``changes`` are the rates of the states; other arguments as ``regularised_force``.
    """

    def energy(penetration: Array, kept: Coefficients) -> Array:
        return law.stored(positive(penetration) if width is None else smooth_ramp(penetration, width)[0], {**c, **kept})

    if not law.states:
        return energy(penetration, {}), jnp.zeros_like(penetration)
    at, along = ({name: jnp.broadcast_to(x[name], penetration.shape) for name in law.states} for x in (c, changes))
    stored, gain = jax.jvp(energy, (penetration, at), (rate, along))
    return stored, regularised_force(law, penetration, jnp.zeros_like(rate), c, width) * rate - gain
