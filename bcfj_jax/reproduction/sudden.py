"""The sudden start: six knobs turned by hand until all peaks of the paper are met, and what that is worth.

The torque is stepped on in 0.1 ms, the law is ADAMS' IMPACT with its default damping, there is play, and the first
milliseconds are read every microsecond: impacts of parts that cross their play, which the settled joint never sees.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.model import joint_of_keys
from bcfj_jax.models.joint.scene import PLAIN, Joint
from bcfj_jax.reproduction.fit import targets
from bcfj_jax.reproduction.measures import six
from bcfj_jax.reproduction.record import STEP, Record, record

# Until when and how finely the start is read [s].
START = (3e-3, 1e-6)
# How finely readings are compared [samples of the start]: 1, 10 and 1000 us.
READINGS = (1, 10, 1000)
_STEP = {"load_ramp": 1e-4, "damping_depth": 1e-4}
_PLAY = {f"clearance_{name}": 85e-6 for name in ("cage_ball", "seat_ball", "head_ball")}
_PILOTS = {f"clearance_{name}": 10e-6 for name in ("seat_cage", "head_cage")}
# Each with its words; the first is the column of the table of claims.
VARIANTS = {
    "sudden start": (
        {**_STEP, **_PLAY, **_PILOTS, "dashpot": 1e4, "smoothing": 2e-6, "contact_angle": float(np.radians(68.0))},
        "torque in 0.1 ms, IMPACT damping 10 N s/mm to 0.1 mm depth, balls' play 85 um, pilots' 10 um (with the stiffness "
        "of 50 um), contact angle 68 deg, smoothing 2 um",
    ),
    "as given, torque in 0.1 ms": (
        _STEP | {"dashpot": 5e4},
        "the values as given, IMPACT damping 50 N s/mm, torque in 0.1 ms",
    ),
}
SUDDEN = next(iter(VARIANTS))
IDENTIFIES = (
    "Six numbers met by hand with several knobs identify nothing; they only refute that the peaks are out of reach."
)


def scene() -> Joint:
    """The plain joint, in which the knobs were turned."""
    return joint_of_keys(law="adams_impact", **PLAIN)


def start(found: Record) -> dict[float, np.ndarray]:
    """Six peaks of a start [N], in the order of ``fit.TARGETS``, by how finely they are read [s]."""
    early = found.fine.times < START[0] - 0.5 * START[1]
    cut = {name: values[early] for name, values in found.fine.force.items()}
    run = found.fine._replace(times=found.fine.times[early], force=cut)
    return {every * START[1]: six(run, every) for every in READINGS}


def duration(name: str, end: float) -> float:
    """How long a variant runs [s]: the first, whose settled joint is looked at too, to ``end``; others past the start."""
    return end if name == SUDDEN else min(end, START[0] + STEP)


def simulate(name: str, end: float, instants: int = 0) -> tuple[Record, Params]:
    """A variant's run to ``end`` [s] and its parameters; ``instants`` as ``record`` takes them."""
    made = scene()
    params = made.parameters(VARIANTS[name][0])
    return record(made, params, end, start=START, instants=instants), params


def rows(found: Mapping[str, Mapping[float, np.ndarray]]) -> list[list[str]]:
    """Peaks of every variant, how each is read, and by how much they miss the paper's."""
    wanted = targets()
    head = ["start", "read every", "Q20", "Q21", "Q23 least", "Q23 greatest", "Q26", "Q27", "worst miss"]
    table = [head, ["paper", "-", *(f"{value / 1e3:.4g} kN" for value in wanted), "-"]]
    for name, one in found.items():
        for every, values in one.items():
            miss = values / wanted - 1.0
            cells = [f"{v / 1e3:.4g} kN ({m:+.0%})" for v, m in zip(values, miss, strict=True)]
            table.append([name, f"{every * 1e6:g} us", *cells, f"{np.max(np.abs(miss)):.0%}"])
    return table
