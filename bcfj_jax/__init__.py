"""Differentiable contact dynamics of the ball-cage flexible joint.

Reading order: ``laws`` (what a contact does), ``scene`` and ``scenes`` (what there is), ``dynamics`` (the
ODE and the instruments), ``integrate`` (the one place that solves), ``simulate`` (the public verbs).

Importing this package switches JAX to 64-bit numbers, for the whole process: penetrations of micrometres
over metres of travel mean nothing in 32 bits. That is its only side effect.
"""

import jax as _jax

_jax.config.update("jax_enable_x64", True)

from bcfj_jax import laws as laws  # noqa: E402
from bcfj_jax import restitution as restitution  # noqa: E402
from bcfj_jax import scenes as scenes  # noqa: E402
from bcfj_jax.errors import InputError as InputError  # noqa: E402
from bcfj_jax.errors import nearest as nearest  # noqa: E402
from bcfj_jax.scene import Body as Body  # noqa: E402
from bcfj_jax.scene import Contact as Contact  # noqa: E402
from bcfj_jax.scene import Load as Load  # noqa: E402
from bcfj_jax.scene import Scene as Scene  # noqa: E402
from bcfj_jax.scene import check_value as check_value  # noqa: E402
from bcfj_jax.simulate import Run as Run  # noqa: E402
from bcfj_jax.simulate import force_history as force_history  # noqa: E402
from bcfj_jax.simulate import simulate as simulate  # noqa: E402
