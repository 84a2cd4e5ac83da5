"""Friction laws: slip velocity and coefficients in, traction per unit of normal force out.

The friction force on the moving body is -N mobility(v.v) v, with N the normal force and v the slip
velocity in the contact plane [m/s]. A law is thus a smooth function of v.v: the direction v/|v|, which has no
derivative at rest, is never formed. These laws creep under load at rest; ``LuGre`` alone sticks, for the price of
a state. ``Memory`` and ``FrictionalLag`` have a state, too, by which the coefficient falls from mu_s to mu_d: the slip
speed of late, and the fall itself.

To add a law: a subclass of ``AbstractFriction`` that gives ``needs`` and ``mobility``; and a line in ``FRICTION``.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from bcfj_jax.contact.elastic import Coefficients
from bcfj_jax.contact.part import Part
from bcfj_jax.core.errors import InputError, one_of
from bcfj_jax.core.numerics import smooth_step


def _tanhc(square: Array) -> Array:
    """tanh(y)/y of y^2 >= 0, with finite and accurate derivatives in y^2 of every order.

    Below y^2 = 0.1 the seventh convergent of Lambert's continued fraction y^2/(1 + y^2/(3 + y^2/(5 + ...))) over
    y^2, which is exact there to 1e-18. The quotient itself would lose 1e-16/y^(2 k) of its k-th derivative.
    """
    small = square < 0.1
    q = jnp.where(small, square, 0.0)
    above = 135135.0 + q * (17325.0 + q * (378.0 + q))
    below = 135135.0 + q * (62370.0 + q * (3150.0 + q * 28.0))
    y = jnp.sqrt(jnp.where(small, 1.0, square))
    return jnp.where(small, above / below, jnp.tanh(y) / y)


def _direction(speed_squared: Array, c: Coefficients) -> Array:
    """tanh(4 |v|/v_t)/|v| [s/m]."""
    speed = c["friction_speed"]
    return 4.0 / speed * _tanhc(16.0 * speed_squared / speed**2)


class AbstractFriction(Part):
    """Friction coefficient mu(|v|) >= 0 of one contact, as a mobility smooth in v.v.

    ``bristles`` says whether the law carries a deflection of each face, a vector [m] that bears load, so that a contact
    sticks; it then has its own ``bond``. ``lags`` says whether it carries a number of each face that follows the slip
    with a delay; it then has ``lag``. Of either, ``reach`` is the size.
    """

    example: ClassVar[str] = """
class Plain(bj.laws.AbstractFriction):
    needs = ("friction_dynamic", "friction_speed")
    def mobility(self, speed_squared, c):
        return c["friction_dynamic"] / jnp.sqrt(speed_squared + c["friction_speed"] ** 2)
"""

    needs: ClassVar[tuple[str, ...]]
    bristles: ClassVar[bool] = False
    lags: ClassVar[bool] = False
    # Errors of a sliding velocity are measured in ``friction_speed`` times this: where the coefficient passes from mu_s to mu_d.
    span: ClassVar[float] = 1.0

    @abstractmethod
    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """mu(|v|)/|v| [s/m]; the traction is -N v times this.

        Smooth in v.v, finite at v = 0, with finite derivatives there (forward, reverse, second).

        Args:
            speed_squared: v.v >= 0 [m^2/s^2] of the slip velocity, of any shape.
            c: the coefficients named by ``needs``, SI.
        """

    def bond(self, speed_squared: Array, c: Coefficients) -> tuple[Array, Array, Array]:
        """What a bristle would do: nothing; the traction is v times the last, the mobility. See ``LuGre.bond``."""
        mobility = self.mobility(speed_squared, c)
        return jnp.zeros_like(mobility), jnp.zeros_like(mobility), mobility

    def lag(self, speed_squared: Array, late: Array, c: Coefficients) -> tuple[Array, Array]:
        """What a memory would do: nothing; the traction is v times the last, the mobility. See ``Memory.lag``."""
        return jnp.zeros_like(late), self.mobility(speed_squared, c)

    def reach(self, c: Coefficients) -> Array:
        """Size of the state, in which its errors are measured; of a law without a state nobody reads it."""
        return jnp.ones(())

    def crest(self, c: Coefficients) -> Array:
        """Slip speed up to which the coefficient rises [m/s], to a thousandth; 1000 where it never falls."""
        coefficient = jax.vmap(lambda v: self.coefficient(v, c))
        grid, best = jnp.geomspace(1e-9, 1e3, 241), jnp.ones(())
        for _ in range(2):
            values = coefficient(best * grid.reshape(-1, *(1 for _ in best.shape)))
            falls = jnp.concatenate([values[1:] < values[:-1], jnp.ones_like(values[:1], bool)])
            best, grid = best * grid[jnp.argmax(falls, axis=0)], jnp.linspace(0.85, 1.15, 301)
        return lax.stop_gradient(best)

    def holding(self, squared: Array, c: Coefficients, time: float) -> tuple[Array, Array]:
        """Of a contact that has moved by s ``time`` [m]: mobility [s/m], and the share of s that stays (``mechanism.stuck``).

        ``squared`` is s.s [m^2/s^2]. What is beyond the greatest coefficient, or a bristle's break-away, has slid.
        """
        most = self.reach(c) / time if self.bristles else self.crest(c)
        beyond = squared > most**2
        share = jnp.where(beyond, most / jnp.sqrt(jnp.where(beyond, squared, 1.0)), 1.0)
        if self.bristles:
            return time * self.bond(jnp.zeros_like(squared), c)[1], share
        return self.mobility(squared * share * share, c), share

    @classmethod
    def lacking(cls) -> list[str]:
        """A law with a state says how that changes, and its size."""
        named = [("bond", cls.bristles), ("lag", cls.lags), ("reach", cls.bristles or cls.lags)]
        return [name for name, asked in named if asked and getattr(cls, name) is getattr(AbstractFriction, name)]

    def coefficient(self, speed: Array, c: Coefficients) -> Array:
        """mu(|v|) [-] of a signed speed [m/s], odd in it: the force is -N times this."""
        return self.mobility(speed * speed, c) * speed


class Coulomb(AbstractFriction):
    """mu = mu_d v/sqrt(v^2 + v_t^2): Coulomb's constant mu_d, regularised below the transition speed v_t.

    Low by v_t^2/2 v^2 of mu_d at v >> v_t. Coefficients: ``friction_dynamic`` mu_d, ``friction_speed`` v_t [m/s].
    """

    needs: ClassVar[tuple[str, ...]] = ("friction_dynamic", "friction_speed")

    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """mu_d/sqrt(v.v + v_t^2)."""
        return c["friction_dynamic"] / jnp.sqrt(speed_squared + c["friction_speed"] ** 2)


class Step(AbstractFriction):
    """The static-dynamic law of ADAMS and of Bai and Zhao, made of cubic STEPs (physics sheet 2); C1.

    mu_s (3 x - x^3)/2, x = v/v_s, up to the static speed v_s; then mu_s + (mu_d - mu_s) s^2 (3 - 2 s),
    s = (v - v_s)/(v_d - v_s), up to the dynamic speed v_d = ratio v_s; mu_d above. The first part is the sheet's
    STEP from (-v_s, -mu_s) to (v_s, mu_s): with s = (x + 1)/2,
    mu_s [2 s^2 (3 - 2 s) - 1] = mu_s [(x + 1)^2 (2 - x)/2 - 1] = mu_s (3 x - x^3)/2,
    written so that mu/v is a polynomial in v^2 and the rounding of "- 1" at rest is gone.
    Coefficients: ``friction_static`` mu_s, ``friction_dynamic`` mu_d, ``friction_speed`` v_s [m/s].

    Args:
        ratio: v_d/v_s > 1; 10 as in the ADAMS defaults, 100 and 1000 mm/s.
    """

    needs: ClassVar[tuple[str, ...]] = ("friction_static", "friction_dynamic", "friction_speed")
    ratio: float = eqx.field(static=True, default=10.0)

    def __check_init__(self):
        if not self.ratio > 1.0:
            raise InputError("friction", f"ratio of dynamic to static speed {self.ratio:g}", "give one above 1")

    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """mu_s (3 - x^2)/2 v_s below the static speed, mu(v)/v above."""
        static, dynamic, speed = (c[name] for name in self.needs)
        square = speed_squared / speed**2
        core = square < 1.0
        inner = 0.5 * static * (3.0 - square)
        x = jnp.sqrt(jnp.where(core, 1.0, square))
        outer = (static + (dynamic - static) * smooth_step((x - 1.0) / (self.ratio - 1.0))) / x
        return jnp.where(core, inner, outer) / speed


class BrownMcPhee(AbstractFriction):
    """mu = mu_d tanh(4 r) + (mu_s - mu_d) r/(r^2/4 + 3/4)^2, r = v/v_t; smooth of every order.

    Brown and McPhee 2016, without the viscous part. Peaks at r = 1 to within the slope of tanh(4 r) there, with
    mu_d tanh 4 + mu_s - mu_d = mu_s - 7e-4 mu_d. Needs mu_s >= mu_d to be a Stribeck curve. The default.
    Coefficients: ``friction_static`` mu_s, ``friction_dynamic`` mu_d, ``friction_speed`` v_t [m/s].
    """

    needs: ClassVar[tuple[str, ...]] = ("friction_static", "friction_dynamic", "friction_speed")

    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """4 mu_d tanh(4 r)/(4 r) + (mu_s - mu_d)/(r^2/4 + 3/4)^2, over v_t."""
        static, dynamic, speed = (c[name] for name in self.needs)
        square = speed_squared / speed**2
        bump = 1.0 / (0.25 * square + 0.75)
        return (4.0 * dynamic * _tanhc(16.0 * square) + (static - dynamic) * bump * bump) / speed


class Memory(AbstractFriction):
    """Stribeck friction that lags behind the slip: frictional memory.

    The coefficient falls from mu_s to mu_d with the slip speed of late, w, and not with that of the instant:

        traction = C(w) tanh(4 |v|/v_t) v/|v|,    C(w) = mu_d + (mu_s - mu_d)/(1 + (w/3 v_t)^4),    w' = (|v| - w)/tau

    At steady slip mu(v) = C(v) tanh(4 v/v_t): mu_s to 2 % at 0.9 v_t, half-way to mu_d at 3 v_t, mu_d to 4 % at 9 v_t. A
    sudden change of slip never meets a falling coefficient, so that a light and stiff body does not chatter; beyond tau
    the falling curve is back, and with it slow stick-slip. Hess and Soom (1990) measured such a lag, 3 to 9 ms, in a
    lubricated line contact; the law of seven parameters (Armstrong-Helouvry et al. 1994) has it as a pure delay. It
    dissipates at every state. The state goes on across a gap.
    |v| here is sqrt(v.v + e^2) - e, e = v_t/10, whose derivative exists at rest; at steady slip that e is out again.
    Coefficients: ``friction_static`` mu_s, ``friction_dynamic`` mu_d, ``friction_speed`` v_t [m/s],
    ``friction_memory`` tau [s].
    """

    needs: ClassVar[tuple[str, ...]] = ("friction_static", "friction_dynamic", "friction_speed", "friction_memory")
    lags: ClassVar[bool] = True
    span: ClassVar[float] = 3.0

    @staticmethod
    def _level(square: Array, c: Coefficients) -> Array:
        """C of (w/v_t)^2."""
        return c["friction_dynamic"] + (c["friction_static"] - c["friction_dynamic"]) / (1.0 + square * square / 81.0)

    def lag(self, speed_squared: Array, late: Array, c: Coefficients) -> tuple[Array, Array]:
        """w' [m/s^2] and the mobility [s/m] at v.v [m^2/s^2] and w [m/s]."""
        speed = c["friction_speed"]
        edge = 0.1 * speed
        rate = (jnp.sqrt(speed_squared + edge**2) - edge - late) / c["friction_memory"]
        # w = sqrt(v.v + e^2) - e at steady slip, so this is v.v there.
        square = late * (late + 2.0 * edge) / speed**2
        return rate, self._level(square, c) * _direction(speed_squared, c)

    def reach(self, c: Coefficients) -> Array:
        return c["friction_speed"]

    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """Steady slip, w = |v|."""
        return self._level(speed_squared / c["friction_speed"] ** 2, c) * _direction(speed_squared, c)


class FrictionalLag(AbstractFriction):
    """Stribeck friction whose coefficient relaxes to its steady value, with a viscous part.

        traction = (C tanh(4 |v|/v_t) + c |v|) v/|v|,    C = mu_s - (mu_s - mu_d) x,    x' = (X(|v|) - x)/tau,
        X(v) = 1 - 1/(1 + (v/3 v_t)^4)

    At steady slip this is ``Memory`` and c v. ``Memory`` lags in the speed: a jump to the speed v weakens it within
    3 v_t tau/v, at 1 m/s some 30 times sooner than tau. Here the coefficient itself takes the time tau at every speed, as
    in the delay that Hess and Soom (1990) measured, and as the sliding force of the generalised Maxwell-slip model
    relaxes to Stribeck's curve (Al-Bender, Lampaert, Swevers 2005). The viscous part is that of the law of seven
    parameters (Armstrong-Helouvry et al. 1994). It dissipates at every state. The state goes on across a gap.
    Coefficients: ``friction_static`` mu_s, ``friction_dynamic`` mu_d, ``friction_speed`` v_t [m/s],
    ``friction_memory`` tau [s], ``friction_viscous`` c [s/m].
    """

    needs: ClassVar[tuple[str, ...]] = (*Memory.needs, "friction_viscous")
    lags: ClassVar[bool] = True
    # Measured with rolling balls: forces are within 0.3 % (rms) at ``fast`` and 0.15 % at ``balanced``; at 9 ``fast`` fails.
    span: ClassVar[float] = 5.0

    @staticmethod
    def _fallen(speed_squared: Array, c: Coefficients) -> Array:
        """X."""
        square = speed_squared / c["friction_speed"] ** 2
        return 1.0 - 1.0 / (1.0 + square * square / 81.0)

    def lag(self, speed_squared: Array, late: Array, c: Coefficients) -> tuple[Array, Array]:
        """x' [1/s] and the mobility [s/m] at v.v [m^2/s^2] and x."""
        static, dynamic, _, memory, viscous = (c[name] for name in self.needs)
        level = static - (static - dynamic) * late
        return (self._fallen(speed_squared, c) - late) / memory, level * _direction(speed_squared, c) + viscous

    def reach(self, c: Coefficients) -> Array:
        """1: from mu_s to mu_d."""
        return jnp.ones(())

    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """Steady slip, x = X."""
        return self.lag(speed_squared, self._fallen(speed_squared, c), c)[1]


class LuGre(AbstractFriction):
    """Bristles that bend, creep and slide (Canudas de Wit et al. 1995), normalised by the load (physics sheet 2).

    Per unit of normal force, with the deflection z [m] a vector in the contact plane and no viscous part:
    z' = v - |v| z/g,  g = mu(v)/sigma0,  mu = mu_d + (mu_s - mu_d) exp(-(v/v_s)^2),  traction = sigma0 z + sigma1 z'.
    At steady slip the traction is mu(v) v/|v|; below break-away the contact is a spring of N sigma0.
    With sigma0 z.z/2 as store it takes energy at every state where sigma1 |v| <= 4 mu(v), and may give some
    beyond, being a dashpot of constant sigma1. Whoever keeps z also turns it with the contact plane and lets
    it go on separation, as ``joint.contacts`` does.
    |v| here is sqrt(v.v + (1e-9 v_s)^2): its derivative exists at rest, where z relaxes at 1e-9 v_s/g per second.
    Coefficients: ``friction_static`` mu_s, ``friction_dynamic`` mu_d > 0, ``friction_speed`` v_s [m/s],
    ``bristle_stiffness`` sigma0 [1/m], ``bristle_damping`` sigma1 [s/m].
    """

    needs: ClassVar[tuple[str, ...]] = (*BrownMcPhee.needs, "bristle_stiffness", "bristle_damping")
    bristles: ClassVar[bool] = True

    def _steady(self, speed_squared: Array, c: Coefficients) -> Array:
        """mu(v) of steady slip, v > 0."""
        static, dynamic, speed, *_ = (c[name] for name in self.needs)
        return dynamic + (static - dynamic) * jnp.exp(-speed_squared / speed**2)

    def bond(self, speed_squared: Array, c: Coefficients) -> tuple[Array, Array, Array]:
        """k = |v|/g [1/s], s = sigma0 - sigma1 k [1/m], m = sigma1 [s/m]: z' = v - k z, traction = s z + m v."""
        speed = jnp.sqrt(speed_squared + (1e-9 * c["friction_speed"]) ** 2)
        forget = c["bristle_stiffness"] * speed / self._steady(speed_squared, c)
        stick = c["bristle_stiffness"] - c["bristle_damping"] * forget
        return forget, stick, jnp.broadcast_to(c["bristle_damping"], forget.shape)

    def reach(self, c: Coefficients) -> Array:
        """mu_s/sigma0: the deflection at break-away."""
        return c["friction_static"] / c["bristle_stiffness"]

    def mobility(self, speed_squared: Array, c: Coefficients) -> Array:
        """Steady slip without the state: mu(v)/sqrt(v.v + v_min^2), v_min = 1e-3 v_s.

        mu(v) sign(v) jumps at rest, so this rounds it over v_min, and is low by 5e-7 (v_s/v)^2 of mu at v >> v_min.
        """
        least = 1e-3 * c["friction_speed"]
        return self._steady(speed_squared, c) / jnp.sqrt(speed_squared + least**2)


FRICTION: dict[str, AbstractFriction] = {
    "coulomb": Coulomb(),
    "step": Step(),
    "brown_mcphee": BrownMcPhee(),
    "memory": Memory(),
    "frictional_lag": FrictionalLag(),
    "lugre": LuGre(),
}


def make_friction(name: str | bool) -> AbstractFriction | None:
    """A friction law by name.

    Args:
        name: one of ``FRICTION``; True is ``brown_mcphee``, False is no friction, None.

    Raises:
        InputError: for a name that is not known, with the nearest one that is.
    """
    if isinstance(name, bool):
        return FRICTION["brown_mcphee"] if name else None
    one_of("friction", "friction law", name, FRICTION)
    return FRICTION[name]
