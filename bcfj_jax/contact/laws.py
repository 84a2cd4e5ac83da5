"""Contact laws by name: an elastic part (``elastic``) in a normal-force law (``normal``); friction (``friction``)."""

from __future__ import annotations

import dataclasses

from bcfj_jax.contact.elastic import ELASTIC as ELASTIC
from bcfj_jax.contact.elastic import AbstractElastic as AbstractElastic
from bcfj_jax.contact.elastic import bai_zhao_stiffness as bai_zhao_stiffness
from bcfj_jax.contact.friction import FRICTION as FRICTION
from bcfj_jax.contact.friction import AbstractFriction as AbstractFriction
from bcfj_jax.contact.friction import make_friction as make_friction
from bcfj_jax.contact.normal import AbstractLaw as AbstractLaw
from bcfj_jax.contact.normal import (
    AdamsImpact,
    DampedStop,
    ElastoGap,
    Hertz,
    KelvinVoigt,
    MemoryFree,
    Restitution,
    StandardLinearSolid,
    Thornton,
    WaltonBraun,
)
from bcfj_jax.contact.normal import regularised_force as regularised_force
from bcfj_jax.contact.restitution import FACTORS
from bcfj_jax.core.errors import InputError, nearest, quoted

# Each with its own default elastic part: ``linear`` for ``kelvin_voigt`` and ``walton_braun``, ``power`` for the rest.
LAWS: dict[str, AbstractLaw] = {
    "memory_free": MemoryFree(),
    "damped_stop": DampedStop(),
    "hertz": Hertz(),
    "kelvin_voigt": KelvinVoigt(),
    "adams_impact": AdamsImpact(),
    "elasto_gap": ElastoGap(),
    "standard_linear_solid": StandardLinearSolid(),
    "walton_braun": WaltonBraun(),
    "thornton": Thornton(),
    **{name: Restitution(factor=factor) for name, factor in FACTORS.items()},
}


def make(law: str = "memory_free", elastic: str | None = None) -> AbstractLaw:
    """A normal-force law by name.

    Args:
        law: one of ``LAWS``; a name of ``restitution.FACTORS`` gives that member of the family.
        elastic: one of ``ELASTIC``; by default ``linear`` for ``kelvin_voigt`` and ``walton_braun``, ``power`` for the
            rest.

    Raises:
        InputError: for a name that is not known, with the nearest one that is.
    """
    if not isinstance(law, str) or law not in LAWS:
        raise InputError("law", f"no law {quoted(law)}", nearest(law, LAWS))
    found = LAWS[law]
    if elastic is None:
        return found
    if not isinstance(elastic, str) or elastic not in ELASTIC:
        raise InputError("elastic", f"no elastic part {quoted(elastic)}", nearest(elastic, ELASTIC))
    if "elastic" not in (field.name for field in dataclasses.fields(found)):
        raise InputError(
            "elastic", f"the law '{law}' has no elastic part to replace by '{elastic}'", "leave elastic out"
        )
    return dataclasses.replace(found, elastic=ELASTIC[elastic])
