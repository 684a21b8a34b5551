"""Reading serialized messages without ROS: CDR (OMG DDSI-RTPS 10.2), a field after the other."""

from __future__ import annotations

import struct
from typing import Any, Final

_BODY: Final = 4
"""Where the message itself begins; alignment counts from here."""


class CdrReader:
    """Gives a message's fields in their order. Raises struct.error where it is cut short."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = _BODY
        self._order = "<" if data[1:2] == b"\x01" else ">"

    def take(self, code: str, count: int = 1) -> tuple[Any, ...]:
        """So many numbers of one format of `struct`."""
        size = struct.calcsize(code)
        self._position += (_BODY - self._position) % size
        numbers = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._position)
        self._position += size * count
        return numbers

    def text(self) -> str:
        """A string; what is not UTF-8 in it is replaced."""
        (size,) = self.take("I")
        begin, self._position = self._position, self._position + size
        if self._position > len(self._data):
            raise struct.error("a string is longer than its message")
        return self._data[begin : self._position - 1].decode(errors="replace")
