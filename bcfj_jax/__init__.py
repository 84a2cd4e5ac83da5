"""Differentiable simulation of mechanisms with clearance: bodies, ideal joints, contacts and loads.

Reading order: ``contact`` (the force of one contact), ``mechanism`` (bodies, contacts, loads and their equations of
motion), ``models`` (the built-in scenes, and the ball-cage joint), ``solve`` (``simulate`` and ``force_history``),
``analysis`` (features, sensitivities, studies, designs), ``io`` and ``cli`` (files and commands).

The import has two side effects, for the whole process. It sets JAX to 64-bit numbers, because penetrations are
micrometres and travel is metres. It adds two options to ``XLA_FLAGS``, which compile the loops of a solver as single
kernels, and sooner. The first run puts a guard around two modules that diffrax's loop reads; only runs of this package see
anything else through it (``xla.diffrax_loop``). Public names are loaded on first use; JAX is too, so that ``bcfj --help``
does not wait for it (``xla.backend``).
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from bcfj_jax._version import __version__ as __version__
from bcfj_jax.xla import backend as _backend

_backend.set_up()

if TYPE_CHECKING:
    from bcfj_jax.analysis import nonlinear as nonlinear
    from bcfj_jax.analysis.derivatives.contact_events import ContactEvents as ContactEvents
    from bcfj_jax.analysis.derivatives.contact_events import contact_events as contact_events
    from bcfj_jax.analysis.derivatives.gradient import hessian_vector as hessian_vector
    from bcfj_jax.analysis.derivatives.sensitivity import Sensitivity as Sensitivity
    from bcfj_jax.analysis.derivatives.sensitivity import sensitivity as sensitivity
    from bcfj_jax.analysis.derivatives.sensitivity import smoothing_ladder as smoothing_ladder
    from bcfj_jax.analysis.designs.api import design as design
    from bcfj_jax.analysis.designs.space import Free as Free
    from bcfj_jax.analysis.studies.api import study as study
    from bcfj_jax.contact import gaps as gaps
    from bcfj_jax.contact import laws as laws
    from bcfj_jax.contact import restitution as restitution
    from bcfj_jax.contact import stiffness as stiffness
    from bcfj_jax.core.errors import InputError as InputError
    from bcfj_jax.core.errors import nearest as nearest
    from bcfj_jax.core.quantities import Quantity as Quantity
    from bcfj_jax.core.quantities import check_value as check_value
    from bcfj_jax.data.thinning import thinned as thinned
    from bcfj_jax.io.usercode import use_code as use_code
    from bcfj_jax.io.view.export import animate as animate
    from bcfj_jax.mechanism import loads as loads
    from bcfj_jax.mechanism.bodies import Body as Body
    from bcfj_jax.mechanism.bodies import Drive as Drive
    from bcfj_jax.mechanism.contacts import Contact as Contact
    from bcfj_jax.mechanism.loads import Load as Load
    from bcfj_jax.mechanism.mechanism import Mechanism as Mechanism
    from bcfj_jax.mechanism.model import AbstractModel as AbstractModel
    from bcfj_jax.models import scenes as scenes
    from bcfj_jax.solve.plan import Plan as Plan
    from bcfj_jax.solve.simulation import Run as Run
    from bcfj_jax.solve.simulation import force_history as force_history
    from bcfj_jax.solve.simulation import reading_history as reading_history
    from bcfj_jax.solve.simulation import simulate as simulate
    from bcfj_jax.xla.compile_cache import use_cache as use_cache

# Public names by the module that holds them; a name of its own stands for a module.
_PUBLIC = {
    "laws": "contact.laws",
    "restitution": "contact.restitution",
    "stiffness": "contact.stiffness",
    "scenes": "models.scenes",
    "nonlinear": "analysis.nonlinear",
    "use_cache": "xla.compile_cache",
    **{name: "core.errors" for name in ("InputError", "nearest")},
    **{name: "core.quantities" for name in ("Quantity", "check_value")},
    "gaps": "contact.gaps",
    "loads": "mechanism.loads",
    **{name: "mechanism.bodies" for name in ("Body", "Drive")},
    "Contact": "mechanism.contacts",
    "Load": "mechanism.loads",
    "Mechanism": "mechanism.mechanism",
    "AbstractModel": "mechanism.model",
    "Plan": "solve.plan",
    "thinned": "data.thinning",
    "use_code": "io.usercode",
    "animate": "io.view.export",
    **{name: "solve.simulation" for name in ("Run", "force_history", "reading_history", "simulate")},
    **{name: "analysis.derivatives.sensitivity" for name in ("Sensitivity", "sensitivity")},
    **{name: "analysis.derivatives.contact_events" for name in ("ContactEvents", "contact_events")},
    "study": "analysis.studies.api",
    "design": "analysis.designs.api",
    "Free": "analysis.designs.space",
    "smoothing_ladder": "analysis.derivatives.sensitivity",
    "hessian_vector": "analysis.derivatives.gradient",
}
_MODULES = ("gaps", "loads", "laws", "restitution", "stiffness", "scenes", "nonlinear")


def __getattr__(name: str) -> object:
    if name not in _PUBLIC:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    module = importlib.import_module(f"{__name__}.{_PUBLIC[name]}")
    value = module if name in _MODULES else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(["__version__", *_PUBLIC])
