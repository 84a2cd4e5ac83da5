"""Settings of a verb as one object: a frozen dataclass has them with their defaults, a caller gives them as keywords.

A verb takes ``**settings: Unpack[Keys]``, where ``Keys`` is a ``TypedDict`` of the same names, for type checkers. It makes
the dataclass of them and hands it down, or hands the keywords on.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

F = TypeVar("F", bound=Callable[..., Any])


def taking(kind: type, **defaults: Any) -> Callable[[F], F]:
    """Let a function's ``**settings`` be the fields of a dataclass: its signature has them, any other is a ``TypeError``.

    ``defaults``: of this function, where they are not the dataclass's.
    """

    def decorated(function: F) -> F:
        own = [p for p in inspect.signature(function).parameters.values() if p.kind is not p.VAR_KEYWORD]
        fields = [
            p.replace(kind=p.KEYWORD_ONLY, default=defaults.get(p.name, p.default))
            for p in inspect.signature(kind).parameters.values()
        ]
        signature = inspect.Signature([*own, *fields])

        @functools.wraps(function)
        def checked(*given: Any, **named: Any) -> Any:
            for name in named:
                if name not in signature.parameters:
                    raise TypeError(f"{function.__name__}() got an unexpected keyword argument '{name}'")
            return function(*given, **{**defaults, **named})

        checked.__dict__["__signature__"] = signature
        return cast(F, checked)

    return decorated
