"""What an engineer reads of the joint's contacts: pressure, patch and power loss, and where elastic laws are void.

Hertz (1881) at the highest normal force of each contact, from the joint's own radii whatever its stiffness is: ellipse of a
ball in a groove, circle of a ball on a flat window, sphere in a socket for pilots. Pressures are those of elastic bodies.

Hertz's theory takes the gap between the bodies for a parabola and the bodies for half-spaces. Over a contact of
half-width a against the ball's or inner sphere's radius R_b the gap of two nearly equal radii is larger than the
parabola by 3/4 (a/R_b)^2: 7 % at the limit here. In a spherical pilot a/R_b = sqrt(d/clearance): the limit is a depth
of 9 % of the clearance. Beyond, ``liu_sphere`` is meant for pilots.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from bcfj_jax.contact.stiffness import ISO_76
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint.constants import patch
from bcfj_jax.models.joint.scene import Joint
from bcfj_jax.xla.programs import ask

# Greatest half-width of a contact over the radius of the ball or the inner sphere.
LIMIT = 0.3
UNITS = {"force": "N", "pressure": "Pa", "half_axes": "m", "power": "W"}
TITLES = {"pressure": "Hertz pressure", "half_axes": "half-axes of patch", "power": "friction power"}
NOTE = (
    "Pressure and half-axes of the patch are Hertz's at the highest normal force of each contact; friction power is that of "
    "all members, the mean of the last two thirds."
)


def _patches(scene: Joint, params: Params, forces: dict[str, Array]) -> dict[str, tuple[Array, Array, Array, Array]]:
    found = {}
    for name, force in forces.items():
        contact, radius = patch(scene, params, name)
        long, short = contact.half_axes(force)
        found[name] = (contact.peak_pressure(force), long, short, radius)
    return found


def of_the_contacts(
    scene: Joint, params: Params, run: Any, rubbed: Mapping[str, ArrayLike] | None = None
) -> dict[str, Any]:
    """By contact: pressure and half-axes at the highest force, mean power lost to friction, and what is void.

    ``rubbed``: by contact (T,) power that friction takes of all members [W]; none of a model without friction. The entry is as
    ``AbstractModel.whole`` says; ``void`` is a sentence or "".
    """
    forces = {name: jnp.asarray(np.nanmax(np.abs(run.force[name][..., 0]))) for name in run.force}
    patches = ask("joint's patches", _patches, (scene,), (dict(params), forces))
    late, ball = run.times >= run.times[-1] / 3.0, float(params["ball_radius"])
    found: dict[str, Any] = {}
    depths = {name: float(np.nanmax(np.asarray(run.penetration[name]))) for name in forces}
    # Deeper than a ball's radius bodies are out of each other's gaps: a flank's force is no gradient of an energy there.
    deep = [f"{name} {depth:.2g} m" for name, depth in depths.items() if depth > ball]
    yields, wide = [], []
    for name, force in forces.items():
        pressure, long, short, radius = (float(x) for x in patches[name])
        halves, width = [max(long, short), min(long, short)], max(long, short) / radius
        found[name] = {"force": float(force), "pressure": pressure, "half_axes": halves}
        found[name] |= {"power": float(np.nanmean(np.asarray(rubbed[name])[late]))} if rubbed else {}
        void = []
        if pressure > ISO_76:
            yields.append(f"{name} {pressure / 1e9:.3g} GPa")
            void.append(f"{pressure / 1e9:.2g} GPa is above 4.2 GPa (ISO 76, ball contact): the surface yields")
        if width > LIMIT:
            wide.append(f"{name} {width:.2g}")
            void.append(f"the patch is {width:.2g} of the radius, beyond {LIMIT:g}: too wide for Hertz")
        # A clearance of 0 has no patch.
        found[name]["void"] = "; ".join(void) if np.isfinite(pressure) else "no clearance, no patch"
    reasons = {
        "bodies pass through each other, deeper than a ball's radius": deep,
        "the surface yields above 4.2 GPa (ISO 76, ball contact)": yields,
        f"a patch wider than {LIMIT:g} of the radius is too wide for Hertz": wide,
    }
    said = "; ".join(f"{reason}: {', '.join(which)}" for reason, which in reasons.items() if which)
    warning = f"elastic laws are void at the highest forces: {said}" if said else ""
    return found | {"units": UNITS, "titles": TITLES, "note": NOTE, "warning": warning}


def widths(scene: Joint, params: Params, depths: dict[str, Array]) -> dict[str, Array]:
    """a/R_b of contacts with a geometric stiffness at penetrations [m], by name; of grooves the longer half-axis."""
    found = {}
    for name, depth in depths.items():
        contact, ball = patch(scene, params, name)
        found[name] = jnp.maximum(*contact.half_axes(contact.stiffness * jnp.maximum(depth, 0.0) ** 1.5)) / ball
    return found


def warnings(scene: Joint, params: Params, run: Any) -> list[str]:
    """What to say of a run in which a contact with a geometric stiffness is too wide for it."""
    names = [contact.name for contact in scene.contacts if contact.geometric]
    depths = {name: np.asarray(np.nanmax(run.penetration[name], initial=0.0)) for name in names}
    if not names:
        return []
    found = ask("joint's contact widths", widths, (scene,), (dict(params), depths))
    wide = [f"{name} {float(x):.2f}" for name, x in found.items() if not float(x) <= LIMIT]
    if not wide:
        return []
    return [
        "stiffness from geometry is beyond its range, contacts no wider than "
        f"{LIMIT:g} of the ball's or inner sphere's radius (docs/joint.md): {', '.join(wide)}"
    ]
