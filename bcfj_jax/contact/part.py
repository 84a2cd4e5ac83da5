"""What laws, elastic parts, friction laws and gaps have in common: one that is not complete says what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax

from bcfj_jax.core.errors import InputError, origin, quoted


def complete(cls: type, missing: Sequence[str], example: str) -> None:
    """Refuse a class that leaves something out."""
    if missing:
        found = f"it lacks {' and '.join(sorted(missing))}"
        raise InputError(f"class {cls.__name__}", found, f"it needs at least:\n{example.strip()}")


class Part(eqx.Module):
    """A part of a contact, which users may write themselves; ``example`` is the least that one needs."""

    example: ClassVar[str] = ""

    @classmethod
    def lacking(cls) -> list[str]:
        """Methods that what a class says of itself makes necessary, and that it does not have."""
        return []

    def __new__(cls, *args: Any, **more: Any) -> Any:
        """Refuse a class that leaves a method out."""
        needs = [] if hasattr(cls, "needs") else ["needs"]
        complete(cls, [*getattr(cls, "__abstractmethods__", ()), *needs, *cls.lacking()], cls.example)
        if isinstance(cls.needs, str):  # type: ignore[attr-defined]
            remedy = f'give a tuple of names: needs = ("{cls.needs}",)'  # type: ignore[attr-defined]
            raise InputError(f"class {cls.__name__} needs", f"'{cls.needs}' is one text", remedy)  # type: ignore[attr-defined]
        return super().__new__(cls)


def of(field: str, name: str) -> Any:
    """A property that is the one of what an object has in a field."""
    return property(lambda self: getattr(getattr(self, field), name))


def checked(where: str, given: Any, kind: type[Any], what: str, by_name: str) -> Any:
    """A part that was given as itself, of an abstract class; ``what`` it is called, and ``by_name`` what else may be given."""
    if isinstance(given, kind):
        return given
    remedy = f"{by_name}, or an object of a class such as:\n{kind.example.strip()}"
    if isinstance(given, type) and issubclass(given, kind):
        remedy = f"give an object of it: {given.__name__}()"
    raise InputError(where, f"{quoted(given)} is no {what}", remedy)


def raised(where: str, error: Exception) -> InputError:
    """What a user's own code raised, as an error that names the place, the file and the line."""
    if isinstance(error, InputError):
        return error
    at, said = origin(error), f"{error}".splitlines()
    found = f"its code raised {type(error).__name__}{f' in {at}' if at else ''}: {said[0] if said else ''}".rstrip(": ")
    remedy = "correct that code"
    if isinstance(error, jax.errors.TracerArrayConversionError):
        remedy = "use jax.numpy in place of numpy: JAX traces the numbers"
    elif isinstance(error, jax.errors.ConcretizationTypeError):
        remedy = "use jnp.where in place of 'if', and jnp.maximum in place of 'max': JAX traces the numbers"
    elif isinstance(error, KeyError):
        remedy = "list the coefficients that it reads in 'needs'; bodies go by their names"
    return InputError(where, found, remedy)
