"""What a run knows of touches and summits, between the instants that it is read at."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array


class Continuous(NamedTuple):
    """Of each of C channels, whatever the samples: of its greatest force and its least, and integrals of its size.

    Attributes:
        time: (2, C) [s], state: (2, C, n) of the ends of the steps at which it was greatest, and least.
        before, after: (2, C) lengths of the steps before and after these [s].
        impulse, work: (C,) integrals of the size by the time [N s] and by the penetration [J]; a reading keeps its sign.
    """

    time: Array
    state: Array
    before: Array
    after: Array
    impulse: Array
    work: Array


class Approaches(NamedTuple):
    """Of k remembered approach speeds (k,): the penetration beyond which each stays [m], its rate [m/s], the speed [m/s]."""

    depth: Array
    rate: Array
    speed: Array
