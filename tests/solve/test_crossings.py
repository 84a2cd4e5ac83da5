"""What a watch of BDF's steps sees in them: crossings, summits, and what came and went within a step."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from bcfj_jax.solve.crossings import Watch, _Memory, _summit
from bcfj_jax.solve.landing import Instants, Look


def memory(depth, rate, force, times=(0.0, 1.0), past=0.0, inside=False):
    one = lambda x: jnp.asarray([x], dtype=float)  # noqa: E731
    none = jnp.full((1, 2), jnp.nan)
    found = Instants(none, none, none, jnp.zeros(1, int))
    before = Look(one(depth), one(rate), one(force))
    return _Memory(
        jnp.asarray(times), one(past), before, jnp.asarray([inside]), found, none, jnp.zeros(1, int), one(0.0),
        one(0.0), one(0.0),
        jnp.asarray([True]),
    )  # fmt: skip


def test_a_summit_is_that_of_the_parabola():
    top, height, bend = 1.3, 7.0, -2.5
    force = lambda t: height + 0.5 * bend * (t - top) ** 2  # noqa: E731
    times, end = (0.8, 1.2), 2.1
    at, reach = _summit(
        memory(0.0, 0.0, force(times[1]), times, force(times[0])), jnp.asarray(end), force(jnp.array([end]))
    )
    assert float(at[0]) == pytest.approx(top, rel=1e-12)
    # By so much it falls by the watch's share of what it is at the middle look.
    assert height - float(force(top + reach[0])) == pytest.approx(0.05 * force(times[1]), rel=1e-9)
    _, none = _summit(memory(0.0, 0.0, 1.0, times, 0.5), jnp.asarray(end), jnp.asarray([2.0]))
    assert np.isnan(none[0])


def test_what_comes_and_goes_within_a_step_is_counted():
    """d = -a + v t - v t^2 in a step of 1 s rises to -a + v/4."""
    watch = Watch(None, None, jnp.asarray(9.0), jnp.asarray(1e-3), 2)  # pyright: ignore[reportArgumentType]
    for rise, inside, missed in ((0.05, False, 1), (-0.05, False, 0), (5e-4, False, 0), (0.05, True, 1)):
        sign, v = (-1.0 if inside else 1.0), 1.0
        low = sign * (rise - 0.25 * v)
        seen = memory(low, sign * v, 0.0, inside=inside)
        now = Look(jnp.asarray([low]), jnp.asarray([-sign * v]), jnp.zeros(1))
        assert int(watch._missed(seen, now, jnp.asarray(1.0))[0]) == missed
