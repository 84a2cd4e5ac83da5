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

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.models.joint import system
from bcfj_jax.models.joint.constants import Constants
from bcfj_jax.models.joint.scene import CONTACTS, Joint
from bcfj_jax.models.joint.system import Loads

SHAFTS = ("seat", "head")


class Moments(NamedTuple):
    """In one state.

    Attributes:
        cage: by contact (3,) moment on the cage in its axes [N m].
        bearings: by shaft what its bearings exert on it, in the shaft's axes; the couple has no z.
        secondary: by shaft () secondary couple of the contacts on it [N m].
    """

    cage: dict[str, Array]
    bearings: dict[str, Loads]
    secondary: dict[str, Array]


def moments(scene: Joint, c: Constants, t: Array, y: Array) -> Moments:
    """Everything in ``Moments`` of one flat state at time t [s]."""
    state = system.view(scene, c, y)
    exerted = system.on_parts(scene, c, state)
    turned = system.cage_frame(state)
    bearings, secondary = {}, {}
    normal = jnp.array([0.0, 1.0, 0.0])
    for i, shaft in enumerate(SHAFTS):
        axes = jnp.stack([jnp.cross(normal, c.axes[i]), normal, c.axes[i]])
        force = axes @ sum((one.force for one in exerted[shaft].values()), jnp.zeros(3))
        moment = axes @ sum((one.moment for one in exerted[shaft].values()), jnp.zeros(3))
        if shaft == "head":
            load = jnp.array([0.0, 0.0, 1.0]) * system.loads(scene, c, t, state)[1]
            force = force - load if scene.slices["head"] is None else jnp.zeros(3)
        bearings[shaft] = Loads(-force, -moment.at[2].set(0.0))
        secondary[shaft] = moment[0]
    return Moments({name: turned.T @ one.moment for name, one in exerted["cage"].items()}, bearings, secondary)


def _size(vectors: ArrayLike) -> np.ndarray:
    return np.linalg.norm(np.asarray(vectors), axis=-1)


def table(scene: Joint, found: Moments) -> dict[str, np.ndarray]:
    """Columns (T,) of ``moments.csv`` by their heads, of histories."""
    vectors: dict[str, tuple[np.ndarray, str, str]] = {}
    for name in _ordered(found):
        vectors[f"cage.{name}.moment"] = np.asarray(found.cage[name]), "xyz", "N m"
    if found.cage:
        vectors["cage.moment"] = np.sum([np.asarray(x) for x in found.cage.values()], 0), "xyz", "N m"
    for shaft in SHAFTS:
        vectors[f"{shaft}_bearing.couple"] = np.asarray(found.bearings[shaft].moment), "xy", "N m"
        if _bears(scene, shaft):
            vectors[f"{shaft}_bearing.force"] = np.asarray(found.bearings[shaft].force), "xyz", "N"
    columns = {
        f"{name}.{axis} [{unit}]": values[:, k]
        for name, (values, axes, unit) in vectors.items()
        for k, axis in enumerate(axes)
    }
    return columns | {f"{shaft}.secondary_couple [N m]": np.asarray(found.secondary[shaft]) for shaft in SHAFTS}


def _ordered(found: Moments) -> list[str]:
    # JAX gives dictionaries back in the order of their keys.
    return [name for name in CONTACTS if name in found.cage]


def _bears(scene: Joint, shaft: str) -> bool:
    return shaft == "seat" or scene.slices["head"] is None


NOTE = (
    "Sizes; mean of the last two thirds, and peak of the whole run. On the cage: about its centre. Secondary couple: of all "
    "contacts on a shaft, in the plane of both. Bearing couple and force: what holds a shaft. Histories: moments.csv."
)


def quantities(scene: Joint, times: np.ndarray, found: Moments) -> dict[str, dict[str, Any]]:
    """What ``summary.json`` says of histories at times (T,) [s]: by name ``mean``, ``peak`` of the size, and ``unit``."""
    late = times >= times[-1] / 3.0
    entries: dict[str, dict[str, Any]] = {}

    def add(name: str, sizes: np.ndarray, unit: str = "N m") -> None:
        known, settled = sizes[np.isfinite(sizes)], sizes[late & np.isfinite(sizes)]
        mean = float(settled.mean()) if settled.size else float("nan")
        entries[name] = {"mean": mean, "peak": float(known.max()) if known.size else float("nan"), "unit": unit}

    for name in _ordered(found):
        add(f"moment on the cage, of {name}", _size(found.cage[name]))
    if len(found.cage) > 1:
        add("moment on the cage, of all contacts", _size(np.sum([np.asarray(x) for x in found.cage.values()], 0)))
    for shaft in SHAFTS:
        add(f"secondary couple on the {shaft}", np.abs(np.asarray(found.secondary[shaft])))
        add(f"bearing couple of the {shaft}", _size(found.bearings[shaft].moment))
        if _bears(scene, shaft):
            add(f"bearing force of the {shaft}", _size(found.bearings[shaft].force), "N")
    return entries
