"""Plain values, as JSON holds them, turned into dataclasses and checked."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

import msgspec

Kind = TypeVar("Kind")


class Typed(Generic[Kind]):
    """Turns plain values into one class. Make it when a module is imported.

    msgspec prepares a class when it first meets it; two threads that do so at once crash Python.
    """

    def __init__(self, kind: type[Kind]) -> None:
        self._kind = kind
        msgspec.json.Decoder(kind)  # prepares it

    def __call__(self, value: Any) -> Kind:
        """Return the value as an object of the class.

        Raises:
            ValueError: It is none.
        """
        try:
            return msgspec.convert(value, self._kind)
        except (msgspec.ValidationError, RecursionError) as error:
            raise ValueError(str(error)) from error
