"""Where a run leaves the range of the formulas that a geometric stiffness is from (``coefficients``).

Hertz's theory takes the gap between the bodies for a parabola and the bodies for half-spaces. Over a contact of
half-width a against the ball's or inner sphere's radius R_b the gap of two nearly equal radii is larger than the
parabola by 3/4 (a/R_b)^2: 7 % at the limit here. In a spherical pilot a/R_b = sqrt(d/clearance): the limit is a depth
of 9 % of the clearance. Beyond, ``liu_sphere`` is meant for pilots.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from bcfj_jax.core.programs import ask
from bcfj_jax.mechanism.model import Params
from bcfj_jax.models.joint import coefficients
from bcfj_jax.models.joint.scene import Joint

# Greatest half-width of a contact over the radius of the ball or the inner sphere.
LIMIT = 0.3


def widths(scene: Joint, params: Params, depths: dict[str, Array]) -> dict[str, Array]:
    """a/R_b of contacts with a geometric stiffness at penetrations [m], by name; of grooves the longer half-axis."""
    found = {}
    for name, depth in depths.items():
        contact, ball = coefficients.patch(scene, params, name)
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
