"""Moments of the contacts on cage, seat and head, and what the bearings of both shafts take.

Of every body the moments are about its own centre (of the seat: about the joint's), those of the contacts alone. The
cage's are in its own axes (``system.cage_frame``). Axes of a shaft: z along it, y across the plane of both shafts
(world y), x in that plane, so that those of the seat are the world's.

The bearings of a shaft hold it against all but its turning:

    couple  C = -(M - (M . z) z)        force  R = -F   (seat, fixed head; less the axial load)

with M and F the contacts'. A head that shifts has no bearing that takes a force. The couple that a joint bent by beta puts
on each shaft in the plane of both, the *secondary couple*  M . x,  is  T tan(beta/2)  where a massless joint without
friction transmits the torque T at constant velocity (Seherr-Thoss, Schmelz, Aucktor, Universal Joints and Driveshafts):
the moments M on both shafts cancel, and T along both axes leaves nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.scene import CONTACTS, Joint
from bcfj_jax.models.joint.system import Loads

SHAFTS = ("seat", "head")


class Moments(NamedTuple):
    """In one state."""

    cage: dict[str, Array]  # by contact (3,) moment on the cage in its axes [N m]
    bearings: dict[str, Loads]  # by shaft what its bearings exert on it, in the shaft's axes; the couple has no z
    secondary: dict[str, Array]  # by shaft () secondary couple of the contacts on it [N m]


def moments(scene: Joint, c: Constants, t: Array, y: Array) -> Moments:
    """Everything in ``Moments`` of one flat state at time t [s]."""
    state = system.view(scene, c, y)
    exerted, turned = system.on_parts(scene, c, state), system.cage_frame(state)
    bearings, secondary = {}, {}
    normal = jnp.array([0.0, 1.0, 0.0])
    for i, shaft in enumerate(SHAFTS):
        axes = jnp.stack([jnp.cross(normal, c.axes[i]), normal, c.axes[i]])
        force, moment = (axes @ sum(x, jnp.zeros(3)) for x in zip(*exerted[shaft].values(), strict=True))
        if shaft == "head":
            load = jnp.array([0.0, 0.0, 1.0]) * system.loads(scene, c, t, state)[1]
            force = force - load if scene.slices["head"] is None else jnp.zeros(3)
        bearings[shaft] = Loads(-force, -moment.at[2].set(0.0))
        secondary[shaft] = moment[0]
    return Moments({name: turned.T @ one.moment for name, one in exerted["cage"].items()}, bearings, secondary)


class _History(NamedTuple):
    """A vector over time (T, n): what ``moments.csv`` calls it, its components there, what ``summary.json`` calls its size."""

    column: str
    axes: Sequence[str]
    words: str
    values: np.ndarray
    unit: str = "N m"


def _histories(scene: Joint, found: Moments) -> list[_History]:
    # JAX gives dictionaries back in the order of their keys.
    cage = {name: np.asarray(found.cage[name]) for name in CONTACTS if name in found.cage}
    rows = [_History(f"cage.{name}.moment", "xyz", f"moment on the cage, of {name}", x) for name, x in cage.items()]
    if cage:
        rows.append(_History("cage.moment", "xyz", _ALL, np.sum(list(cage.values()), 0)))
    for shaft in SHAFTS:
        force, couple = (np.asarray(x) for x in found.bearings[shaft])
        secondary = np.asarray(found.secondary[shaft])[:, None]
        rows.append(_History(f"{shaft}.secondary_couple", ("",), f"secondary couple on the {shaft}", secondary))
        rows.append(_History(f"{shaft}_bearing.couple", "xy", f"bearing couple of the {shaft}", couple))
        if shaft == "seat" or scene.slices["head"] is None:
            rows.append(_History(f"{shaft}_bearing.force", "xyz", f"bearing force of the {shaft}", force, "N"))
    return rows


_ALL = "moment on the cage, of all contacts"


def table(scene: Joint, found: Moments) -> dict[str, np.ndarray]:
    """Columns (T,) of ``moments.csv`` by their heads, of histories; single numbers last."""
    rows = sorted(_histories(scene, found), key=lambda row: row.axes == ("",))
    return {
        f"{'.'.join(filter(None, (row.column, axis)))} [{row.unit}]": row.values[:, k]
        for row in rows
        for k, axis in enumerate(row.axes)
    }


NOTE = (
    "Sizes; mean of the last two thirds, and peak of the whole run. On the cage: about its centre. Secondary couple: of all "
    "contacts on a shaft, in the plane of both. Bearing couple and force: what holds a shaft. Histories: moments.csv."
)


def quantities(scene: Joint, times: np.ndarray, found: Moments) -> dict[str, dict[str, Any]]:
    """What ``summary.json`` says of histories at times (T,) [s]: by name ``mean``, ``peak`` of the size, and ``unit``."""
    late, entries = times >= times[-1] / 3.0, {}
    for row in _histories(scene, found):
        if row.words == _ALL and len(found.cage) == 1:
            continue
        sizes = np.linalg.norm(row.values, axis=-1)
        known, settled = sizes[np.isfinite(sizes)], sizes[late & np.isfinite(sizes)]
        mean = float(settled.mean()) if settled.size else float("nan")
        peak = float(known.max()) if known.size else float("nan")
        entries[row.words] = {"mean": mean, "peak": peak, "unit": row.unit}
    return entries
