"""A scene as PEtab's library sees a model, and the identifiers of what is in it.

Imported only where PEtab is used, since it imports that library.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from petab.v2.models.model import Model

from bcfj_jax.io.outputs import write_toml
from bcfj_jax.mechanism.model import AbstractModel
from calibration.problem import NUISANCES, OFFSETS

LANGUAGE = "bcfj"
# Nuisances that an observable's formula can hold; the others are inputs of the model.
IN_FORMULA = ("gain", *OFFSETS.values())


def identifier(name: str) -> str:
    """A name as PEtab allows it: "seat_ball.stiffness" -> "seat_ball__stiffness"."""
    plain = re.sub(r"\W", "__", name, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain


class SceneModel(Model):
    """The entities of a scene: its parameters, the inputs of the measuring chain, and the outputs that are read."""

    type_id = LANGUAGE  # pyright: ignore[reportAssignmentType]

    def __init__(
        self, scene: AbstractModel, params: dict[str, float], outputs: Iterable[str], resolved: dict[str, Any]
    ) -> None:
        self._kind, self._params, self._resolved = scene.kind, params, resolved
        self._inputs = (*scene.quantities, *(name for name in NUISANCES if name not in IN_FORMULA))
        self._outputs = tuple(outputs)
        self.rel_path, self.base_path = Path("scene.toml"), None

    @staticmethod
    def from_file(filepath_or_buffer: Any, model_id: str, base_path: str | Path | None = None) -> Model:
        """Not from here: ``reading.load`` reads the scene."""
        raise NotImplementedError("use calibration.petab.load")

    def to_file(self, filename: str | Path | None = None) -> None:
        """Write the scene file."""
        write_toml(Path(filename or self.rel_path), self._resolved, "the model of the PEtab problem beside it")

    @property
    def model_id(self) -> str:
        """The scene's kind."""
        return self._kind

    def get_parameter_value(self, id_: str) -> float:
        """Value of a parameter [SI]."""
        if id_ not in self._params:
            raise ValueError(f"no parameter {id_}")
        return self._params[id_]

    def get_free_parameter_ids_with_values(self) -> Iterable[tuple[str, float]]:
        """Every parameter with its value."""
        return self._params.items()

    def get_parameter_ids(self) -> Iterable[str]:
        """Every input."""
        return self._inputs

    get_valid_parameters_for_parameter_table = get_valid_ids_for_condition_table = get_parameter_ids

    def has_entity_with_id(self, entity_id: str) -> bool:
        """Whether it is an input or an output."""
        return entity_id in self._inputs or entity_id in self._outputs

    def symbol_allowed_in_observable_formula(self, id_: str) -> bool:
        """Only outputs are."""
        return id_ in self._outputs

    def is_valid(self) -> bool:
        """A scene is checked where it is made."""
        return True

    def is_state_variable(self, id_: str) -> bool:
        """States stay inside a scene."""
        return False
