"""Normal-force laws: (penetration, penetration rate, coefficients) in, force out.

A law is an elastic part with a way to lose energy. It takes one scalar contact (or any broadcast
shape) and knows nothing of geometry, bodies or time. The force is pushing only: every law is clipped
at zero, since a formula with damping turns tensile just before separation.

To add a law: a final module with ``needs`` and ``force``, and a line in ``laws.LAWS``.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from bcfj_jax.contact.elastic import BACKING, AbstractElastic, Coefficients, Linear, Power, backing
from bcfj_jax.core.numerics import positive, smooth_ramp, smooth_step


class AbstractLaw(eqx.Module):
    """Normal force F(d, d') >= 0 of one contact."""

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
            c: the coefficients named by ``needs``, SI.
        """


class Hertz(AbstractLaw):
    """F = f(d): elastic, no loss. Hertz 1881 with the default power part; valid for v0 << 1e-5 sqrt(E/rho)."""

    elastic: AbstractElastic = Power()

    @property
    def needs(self) -> tuple[str, ...]:
        return self.elastic.needs

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        del rate
        return self.elastic.force(penetration, c)


class KelvinVoigt(AbstractLaw):
    """F = K d + c d' in contact (Kelvin-Voigt): jumps by c v0 at first touch unless the contact is regularised.

    Pushing only: restitution as Schwager and Poeschel 2007. With ``tension`` the dashpot may pull until
    the gap opens, and e = exp(-pi z / sqrt(1 - z^2)), z = c / (2 sqrt(K m)).
    Coefficients: ``stiffness`` K [N/m], ``dashpot`` c [N s/m].
    """

    elastic: AbstractElastic = Linear()
    tension: bool = eqx.field(static=True, default=False)

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.elastic.needs, "dashpot")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        total = self.elastic.force(penetration, c) + c["dashpot"] * rate
        total = jnp.where(penetration > 0, total, 0.0)
        return total if self.tension else positive(total)


class MemoryFree(AbstractLaw):
    """F = f(d) (1 + a d'). Hunt and Crossley 1975 as they wrote it: no memory of the approach speed.

    chi = a v0 for each impact, so the restitution falls with speed (e = 1 - 2 a v0 / 3 + ...), as metals do.
    No event and no latched state: the law to prefer in simulation. Any speed; the restitution is
    ``restitution.delivered_restitution(a v0)``.
    Coefficients: those of the elastic part and ``damping`` a [s/m] >= 0.
    """

    elastic: AbstractElastic = Power()

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.elastic.needs, "damping")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        return self.elastic.force(penetration, c) * positive(1.0 + c["damping"] * rate)


class DampedStop(AbstractLaw):
    """F = f(d) (1 + a d') + K_b r(d - d_b) (1 + a_b d'): a layer on a stop, each with the loss of its own.

    ``MemoryFree`` of the layer, and Hunt and Crossley's again of the stop of ``elastic.TwoStage``; each part pushes
    only. The energy that they take adds up; a_b = a is ``MemoryFree`` with the elastic part ``two_stage``.
    Coefficients: those of the elastic part, ``damping`` a [s/m], ``bottoming_stiffness`` K_b [N/m],
    ``bottoming_penetration`` d_b [m], ``bottoming_width`` w [m] and ``bottoming_damping`` a_b [s/m] >= 0.
    """

    elastic: AbstractElastic = Power()

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.elastic.needs, "damping", *BACKING, "bottoming_damping")))

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        layer = self.elastic.force(penetration, c) * positive(1.0 + c["damping"] * rate)
        return layer + backing(penetration, c) * positive(1.0 + c["bottoming_damping"] * rate)


class Backed(AbstractLaw):
    """F = F_law(d, d') + K_b r(d - d_b): any law with an elastic stop of ``elastic.TwoStage`` behind it.

    Coefficients: those of the law, ``bottoming_stiffness`` K_b [N/m], ``bottoming_penetration`` d_b [m] and
    ``bottoming_width`` w [m].
    """

    law: AbstractLaw

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.law.needs, *BACKING)))

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        return self.law.force(penetration, rate, c) + backing(penetration, c)


class Restitution(AbstractLaw):
    """F = f(d) (1 + chi(e) d'/v0), the family of ``restitution.FACTORS``; v0 is the approach speed of this impact.

    Validity is the factor's: each docstring there says which e it delivers. ``exact`` delivers all.
    Coefficients: those of the elastic part, ``restitution`` e [-] and ``approach_speed`` v0 [m/s] > 0, which
    the scene supplies (at least 1e-9 m/s, which keeps a resting contact finite).
    """

    factor: Callable[[Array], Array] = eqx.field(static=True)
    elastic: AbstractElastic = Power()

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.elastic.needs, "restitution", "approach_speed")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        damping = self.factor(c["restitution"]) / jnp.maximum(c["approach_speed"], 1e-9)
        return self.elastic.force(penetration, c) * positive(1.0 + damping * rate)


class AdamsImpact(AbstractLaw):
    """F = max(0, K d^n + c_max step(d, 0, 0, h, 1) d'): the IMPACT function of ADAMS and MotionSolve.

    The cubic step s^2 (3 - 2 s), s = min(d/h, 1), lets the dashpot in over the depth h. Loses much energy
    at high speed: c_max = 50 N s/mm is nearly plastic at 1.5 m/s, and its damping raises the peak.
    Coefficients: those of the elastic part, ``dashpot`` c_max [N s/m], ``damping_depth`` h [m] > 0.
    """

    elastic: AbstractElastic = Power()

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.elastic.needs, "dashpot", "damping_depth")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        share = smooth_step(penetration / c["damping_depth"])
        return positive(self.elastic.force(penetration, c) + c["dashpot"] * share * rate)


class ElastoGap(AbstractLaw):
    """F = f(d) + clip(c d', -f(d), f(d)): a dashpot that neither pulls nor weighs more than the spring beside it.

    ElastoGap of Modelica.Mechanics.Translational (Modelica Standard Library 4.0; physics sheet 1.2) for one direction:
    0 <= F <= 2 f(d), so the force neither jumps at touch nor pulls before separation. With f(d) = K d the restitution is
    the same at every speed, below Kelvin-Voigt's loss: while c d' > K d the stop is a spring of 2 K. The corners where
    the dashpot is limited are no smoother than that.
    Coefficients: those of the elastic part, ``dashpot`` c [N s/m].
    """

    elastic: AbstractElastic = Power()

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.elastic.needs, "dashpot")

    def force(self, penetration: Array, rate: Array, c: Coefficients) -> Array:
        spring = self.elastic.force(penetration, c)
        damped = jnp.clip(c["dashpot"] * rate, -spring, spring)
        # Apart both are 0; so are then their derivatives.
        return jnp.where(penetration > 0, spring + damped, 0.0)


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
    if width is None:
        return law.force(penetration, rate, c)
    ramp, slope = smooth_ramp(penetration, width)
    return slope * law.force(ramp, rate, c)
