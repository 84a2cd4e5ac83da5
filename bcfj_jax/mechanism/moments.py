"""What a run knows of touches and summits, between the instants that it is read at."""

from __future__ import annotations

from typing import NamedTuple

from jax import Array


class Continuous(NamedTuple):
    """Of each of C channels, whatever the samples: (C,) time [s] and (C, n) state of the step's end at which its force was
    greatest, (C,) lengths of the steps before and after it [s], and integrals (C,) of the size of its normal force by the
    time [N s] and by the penetration [J].
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
