"""Greatest and least contact forces of a run, found by the solver's own steps and not by the samples that it is read at.

A solver is wrapped: at the middle and the end of every accepted step each contact is looked at, through the step's own
interpolation, and a parabola through the two and the step's beginning gives the crest between them. An impact that the
step control resolves is thereby seen, however coarse the samples are; two looks a step are what it costs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp
from jax import Array

# Where a step is looked at, as shares of it.
_LOOKS = (0.5, 1.0)


class Extremes(NamedTuple):
    """Of one contact, () or of its members (k,).

    Attributes:
        peak, least: greatest and least normal force [N]; the least is a peak, too, where a contact has two sides.
        peak_time, least_time: when they were [s].
        onset: when the surfaces first touched [s]; infinite where they have not.
    """

    peak: Array
    peak_time: Array
    least: Array
    least_time: Array
    onset: Array


class Look(NamedTuple):
    """Normal force [N] and penetration [m] of one contact."""

    force: Array
    penetration: Array


def _look(t: Any, y: Array, args: tuple) -> dict[str, Look]:
    model, prepared = args
    return {name: Look(r.force[..., 0], r.penetration) for name, r in model.observe(t, y, prepared).items()}


def _begun(t: Any, look: Look) -> Extremes:
    at = jnp.full_like(look.force, t)
    return Extremes(look.force, at, look.force, at, jnp.where(look.penetration > 0, at, jnp.inf))


def crest(first: Array, middle: Array, last: Array) -> tuple[Array, Array]:
    """Top of the parabola through values at 0, 1/2 and 1 where the middle one is greatest, else the greatest; its place.

    Only above 0: a contact that is apart has no crest.
    """
    bend = first - 2.0 * middle + last
    inside = (middle >= first) & (middle >= last) & (middle > 0) & (bend < 0)
    bend = jnp.where(inside, bend, -1.0)
    share = 0.5 - 0.25 * (last - first) / bend
    value = middle - 0.125 * (last - first) ** 2 / bend
    end = jnp.where(last >= first, last, first)
    return jnp.where(inside, value, jnp.maximum(middle, end)), jnp.where(
        inside, share, jnp.where(middle > end, 0.5, jnp.where(last >= first, 1.0, 0.0))
    )


def _after(known: Extremes, t0: Any, t1: Any, before: Look, middle: Look, end: Look) -> Extremes:
    top, high = crest(before.force, middle.force, end.force)
    bottom, low = crest(-before.force, -middle.force, -end.force)
    width = t1 - t0
    higher, lower = top > known.peak, -bottom < known.least
    depths = before.penetration, end.penetration
    rise = depths[1] - depths[0]
    crossed = t0 + width * jnp.clip(-depths[0] / jnp.where(rise > 0, rise, 1.0), 0.0, 1.0)
    first = jnp.where((depths[1] > 0) & (known.onset == jnp.inf), crossed, known.onset)
    return Extremes(
        jnp.where(higher, top, known.peak),
        jnp.where(higher, t0 + width * high, known.peak_time),
        jnp.where(lower, -bottom, known.least),
        jnp.where(lower, t0 + width * low, known.least_time),
        first,
    )


class Watched(dfx.AbstractAdaptiveSolver):
    """A solver whose memory holds ``Extremes`` by contact as well; diffrax keeps it at accepted steps alone.

    The arguments of its field are (model, what it has prepared).
    """

    solver: dfx.AbstractAdaptiveSolver

    @property
    def term_structure(self):
        """The solver's."""
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        """The solver's."""
        return self.solver.interpolation_cls

    def order(self, terms):
        """The solver's."""
        return self.solver.order(terms)

    def error_order(self, terms):
        """The solver's."""
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        """The solver's memory, what is seen at the start, and the extremes so far."""
        seen = _look(t0, y0, args)
        begun = {name: _begun(t0, look) for name, look in seen.items()}
        return self.solver.init(terms, t0, t1, y0, args), seen, begun

    def func(self, terms, t0, y0, args):
        """The solver's."""
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        """The solver's step, and what was seen in it."""
        memory, before, known = solver_state
        y1, error, dense, memory, result = self.solver.step(terms, t0, t1, y0, args, memory, made_jump)
        between = self.interpolation_cls(t0=t0, t1=t1, **dense)
        times = t0 + (t1 - t0) * jnp.asarray(_LOOKS)
        states = jnp.stack([between.evaluate(times[0]), y1])
        seen = jax.vmap(lambda t, y: _look(t, y, args))(times, states)
        middle, end = ({name: Look(*(x[i] for x in look)) for name, look in seen.items()} for i in (0, 1))
        found = {name: _after(known[name], t0, t1, before[name], middle[name], end[name]) for name in known}
        return y1, error, dense, (memory, end, found), result
