"""The box of the extremes: what is varied how far, for every scene, and the cases in it.

A case is a row of numbers by name, SI. Sobol points fill the box; on every axis a stated share of the cases sits on its
corner values, such as a clearance of exactly 0. ``corners`` gives the combinations of ends and corner values.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import qmc

import bcfj_jax as bj
from bcfj_jax.models.joint.scene import PLAIN

# Share of the cases that sit on an axis's corner values, where it has any.
SHARE = 0.2


class Axis(NamedTuple):
    """One varied number: its range, whether by decades, and corner values that a range by decades does not have."""

    name: str
    low: float
    high: float
    log: bool = True
    corners: tuple[float, ...] = ()

    def at(self, u: np.ndarray) -> np.ndarray:
        """Values at points (N,) of (0, 1): the corner values below ``SHARE``, the range above."""
        share = SHARE if self.corners else 0.0
        inside = (u - share) / (1.0 - share)
        ends = (np.log(self.low), np.log(self.high)) if self.log else (self.low, self.high)
        value = ends[0] + np.clip(inside, 0.0, 1.0) * (ends[1] - ends[0])
        value = np.exp(value) if self.log else value
        if not self.corners:
            return value
        which = np.clip((u / share * len(self.corners)).astype(int), 0, len(self.corners) - 1)
        return np.where(u < share, np.asarray(self.corners)[which], value)

    @property
    def ends(self) -> tuple[float, ...]:
        """Corner values, and the ends of the range."""
        return tuple(dict.fromkeys((*self.corners, self.low, self.high)))


class Variant(NamedTuple):
    """One program to try: a scene with its options, and its axes.

    Attributes:
        scene, name: whose counts it belongs to, and its own name there.
        options: of ``scenes.make``.
        axes: what is varied; ``fixed``: what has another value than the default.
        horizon: axis of the end time [s]. Its corner value 0 stands for the scene's own horizon.
        share: of the scene's cases.
        budget: attempted steps, which keep a case from hanging.
        slopes: whether derivatives are asked for, too.
    """

    scene: str
    name: str
    options: dict[str, Any]
    axes: tuple[Axis, ...]
    horizon: Axis
    share: float
    budget: int
    slopes: bool = True
    fixed: dict[str, float] = {}


_BALL, _GRAVITY = 0.016731, 9.81
_SPEED = Axis("approach_speed", 1e-6, 50.0, corners=(0.0,))
_ELASTIC = (Axis("stiffness", 1e3, 1e13), Axis("exponent", 1.0, 3.0, False, (1.0, 1.5)))
_BODY = (
    Axis("mass", 1e-3 * _BALL, 1e3 * _BALL),
    Axis("smoothing", 1e-9, 1e-4, corners=(0.0,)),
)
_RESTITUTION = Axis("restitution", 0.0, 1.0, False, (0.0, 1.0))
_LOSS = {
    "exact": (*_ELASTIC, _RESTITUTION),
    "flores": (*_ELASTIC, _RESTITUTION),
    "memory_free": (*_ELASTIC, Axis("damping", 1e-4, 1e2, corners=(0.0,))),
    "kelvin_voigt": (_ELASTIC[0], Axis("dashpot", 1e-3, 1e5, corners=(0.0,))),
    "adams_impact": (*_ELASTIC, Axis("dashpot", 1e-3, 1e5, corners=(0.0,)), Axis("damping_depth", 1e-9, 1e-3)),
}
_TIME = Axis("end", 1e-7, 1e3, corners=(0.0,))
_IMPACT = (_SPEED, Axis("clearance_contact", 1e-9, 5e-3, corners=(0.0,)))
# The drop that gives the speed; 5 mm and less of it is also the box's clearance.
_BOUNCE = (Axis("drop_height", 1e-12 / (2 * _GRAVITY), 2500.0 / (2 * _GRAVITY), corners=(0.0,)),)
_CONTACTS = ("seat_cage", "head_cage", "cage_ball", "seat_ball", "head_ball")
_PLAY = tuple(Axis(f"clearance_{name}", 1e-9, 5e-3, corners=(0.0,)) for name in _CONTACTS)
_SMOOTHING = Axis("smoothing", 1e-9, 1e-4, corners=(0.0,))
_AXIAL = Axis("axial_load", 1.0, 2e4, corners=(0.0,))
# To ten times the nominal 1.8 kN m.
_LOAD = (Axis("load_torque", 1.8, 1.8e4, corners=(0.0,)), _AXIAL, _SMOOTHING)
# One revolution in service, and 1 000 of them.
_TURNS = Axis("end", 1e-7, 600.0, corners=(0.0, 600.0))
_MASSES = tuple(
    Axis(name, 1e-3 * value, 1e3 * value)
    for name, value in (("ball_mass", _BALL), ("cage_mass", 0.4), ("head_mass", 1.5))
)
_FRICTION = (Axis("friction_static", 1e-3, 2.0), Axis("friction_speed", 1e-4, 1.0))
_DAMPING = Axis("damping", 1e-4, 1e2, corners=(0.0,))
# The seat's rim: 1 um/s to 50 m/s at the pitch radius.
_DRIVE = Axis("drive_speed", 1e-6 / 0.0355, 50.0 / 0.0355, corners=(0.0, 100 * 2 * np.pi / 60))
_BRIEF = Axis("end", 1e-7, 0.1)
_ROUGH, _SMOOTH = {"law": "exact", **PLAIN}, {"friction": False, **PLAIN}
# A joint that somebody would build, and a longer look at it: factors of 3 about the default numbers.
_NEAR = (
    Axis("stiffness", 1.2e10, 1.1e11),
    Axis("load_torque", 600.0, 5400.0),
    Axis("friction_static", 0.04, 0.36),
    Axis("friction_speed", 0.03, 0.3),
    Axis("drive_speed", 3.5, 31.4),
)
_FULL = (*_ELASTIC, _RESTITUTION, *_PLAY, *_LOAD, *_MASSES, *_FRICTION, _DRIVE)
_FREE = (*_ELASTIC, _RESTITUTION, *_PLAY, _AXIAL, _SMOOTHING, *_MASSES, *_FRICTION)
_STILL = {"drive_speed": 0.0, "load_torque": 0.0}

# Options of the joint as it is built, each drawn from these for a joint; and the axes that some of them add.
_OPTIONS: dict[str, tuple[Any, ...]] = {
    "law": ("exact", "memory_free", "flores"),
    "friction": ("brown_mcphee", "memory", "frictional_lag"),
    "track": ("gothic", "circular"),
    "head": ("free", "fixed"),
    "spin": (False, True),
    "window_ends": (False, True),
    "bands": (False, True),
    "unequal": (False, True),
    "stiffness": ("given", "geometry"),
    "drive_profile": ("constant", "smooth", "step"),
    "load_profile": ("smooth", "step", "linear"),
    "stick_slip": (False, True),
    "torque_reversal": (False, True),
}
_BUILT = {"law": "exact", "window_ends": True, "bands": True, "spin": True, "unequal": True}
_ADDED = (
    Axis("clearance_cage_window_end", 3e-4, 5e-3),
    Axis("pilot_band", 0.3, 0.7, False),
    Axis("load_ramp", 1e-5, 1.0),
    Axis("drive_ramp", 1e-4, 1.0),
    Axis("friction_memory", 1e-4, 1e-1),
    Axis("friction_viscous", 1e-3, 1.0, corners=(0.0,)),
    Axis("ball_2.oversize", -1e-4, 1e-4, False, (0.0,)),
    Axis("seat_ball_3.extra_clearance", -1e-5, 1e-4, False, (0.0,)),
)
_JOINTS, _PILOTS = 6, ("clearance_seat_cage", "clearance_head_cage")


def _drawn(number: int, axes: tuple[Axis, ...]) -> Variant:
    """A joint whose options are drawn at random; of the axes it has those that its options read."""
    rng = np.random.default_rng(2024 + number)
    options = {name: values[rng.integers(len(values))] for name, values in _OPTIONS.items()}
    scene = bj.scenes.make("joint", **options)
    mine = [axis for axis in axes if axis.name in scene.quantities]
    if options["stiffness"] == "geometry":
        # Without a difference of radii there is no stiffness: such pilots are refused, whatever else is drawn.
        mine = [axis._replace(corners=()) if axis.name in _PILOTS else axis for axis in mine]
    return Variant("options", f"joint {number}", options, tuple(mine), _BRIEF, 0.9 / _JOINTS, 600)


VARIANTS: tuple[Variant, ...] = (
    *(Variant("impact", law, {"law": law}, (*x, *_BODY, *_IMPACT), _TIME, 0.2, 20_000) for law, x in _LOSS.items()),
    *(Variant("bounce", law, {"law": law}, (*x, *_BODY, *_BOUNCE), _TIME, 0.2, 8_000) for law, x in _LOSS.items()),
    Variant(
        "kinematic", "joint", {"fidelity": "kinematic", **PLAIN}, (*_ELASTIC, *_PLAY, *_LOAD, _DRIVE), _TURNS, 1.0, 1
    ),
    Variant(
        "quasistatic", "joint", {"fidelity": "quasistatic", **PLAIN}, (*_ELASTIC, *_PLAY, *_LOAD, _DRIVE), _TURNS, 1.0, 1
    ),
    Variant("dynamic", "driven", _ROUGH, _FULL, _BRIEF, 0.65, 600),
    # Nothing drives it, nothing but its axial load pulls: its energy is known.
    Variant("dynamic", "passive", _ROUGH, _FREE, _BRIEF, 0.15, 600, fixed=_STILL),
    Variant("dynamic", "frictionless", _SMOOTH, (*_ELASTIC, _DAMPING, *_FULL[3:-3], _DRIVE), _BRIEF, 0.19, 600),
    Variant("dynamic", "30 s", _ROUGH, _NEAR, Axis("end", 30.0, 30.0), 0.01, 60_000, slopes=False),
    *(_drawn(number, (*_FULL, _DAMPING, *_ADDED)) for number in range(1, _JOINTS + 1)),
    Variant("options", "passive", _BUILT, (*_FREE, *_ADDED[:2], *_ADDED[6:]), _BRIEF, 0.1, 600, fixed=_STILL),
)  # fmt: skip


def sobol(variant: Variant, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """``count`` cases over the box by name, (count,) each, the end time as "end"."""
    axes = (*variant.axes, variant.horizon)
    points = qmc.Sobol(len(axes), scramble=True, rng=seed).random_base2(int(np.ceil(np.log2(max(count, 2)))))[:count]
    return {axis.name: axis.at(points[:, k]) for k, axis in enumerate(axes)}


def corners(variant: Variant, count: int, seed: int = 1) -> dict[str, np.ndarray]:
    """All combinations of every axis's ends and corner values, or ``count`` of them drawn without repetition."""
    axes = (*variant.axes, variant.horizon)
    total = int(np.prod([float(len(axis.ends)) for axis in axes]))
    if total <= count:
        rows = np.array(list(itertools.product(*(axis.ends for axis in axes))))
        return {axis.name: rows[:, k] for k, axis in enumerate(axes)}
    rng = np.random.default_rng(seed)
    drawn = {axis.name: rng.integers(len(axis.ends), size=2 * count) for axis in axes}
    unique = np.unique(np.stack(list(drawn.values()), 1), axis=0)
    rows = rng.permutation(unique)[:count]
    return {axis.name: np.asarray(axis.ends)[rows[:, k]] for k, axis in enumerate(axes)}
