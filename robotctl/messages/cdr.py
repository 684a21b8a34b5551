"""A reader and a writer of CDR, the serialized form of ROS messages."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Any, Final

ODOMETRY: Final = "nav_msgs/msg/Odometry"
ROBOT_STATUS: Final = "robot_controller/msg/RobotStatus"
JOURNAL_ENTRY: Final = "robot_controller/msg/JournalEntry"


ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""The first bytes of a message in plain CDR, little endian."""

LITTLE_ENDIAN: Final = ENCAPSULATION[:2]
BIG_ENDIAN: Final = b"\x00\x00"

BODY: Final = len(ENCAPSULATION)
"""The offset of the fields; alignment counts from here."""

_LARGEST: Final = 8
"""The largest alignment of plain CDR [bytes]."""


class CdrReader:
    """Reads the fields of a message in their order.

    Each method raises struct.error if the message is cut short.
    """

    def __init__(self, data: bytes) -> None:
        """Read `data` from its first field.

        Raises:
            struct.error: The message is not in plain CDR.
        """
        if data[:2] not in (LITTLE_ENDIAN, BIG_ENDIAN):
            raise struct.error(f"not plain CDR: it begins with {data[:2].hex() or 'nothing'}")
        self._data = data
        self._position = BODY
        self._order = "<" if data[:2] == LITTLE_ENDIAN else ">"

    def take(self, code: str, count: int = 1) -> tuple[Any, ...]:
        """Return the next `count` numbers; `code` is their format in `struct`."""
        size = struct.calcsize(code)
        self._position += (BODY - self._position) % size
        numbers = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._position)
        self._position += size * count
        return numbers

    def run(self, codes: str) -> tuple[Any, ...]:
        """Return one number for each `struct` code in `codes`; an `x` skips a byte."""
        layout = _aligned(self._order, codes, (self._position - BODY) % _LARGEST)
        numbers = layout.unpack_from(self._data, self._position)
        self._position += layout.size
        return numbers

    def text(self) -> str:
        """Return the next string; bytes that are not UTF-8 are replaced."""
        (size,) = self.take("I")
        return self.octets(size)[:-1].decode(errors="replace")

    def skip_header(self) -> None:
        """Skip a std_msgs/Header."""
        self.take("I", 2)
        self.octets(*self.take("I"))

    def wide_text(self) -> str:
        """Return the next wide string; units that are not UTF-16 are replaced."""
        (count,) = self.take("I")
        units = b"".join(struct.pack("<H", each & 0xFFFF) for each in self.take("I", count))
        return units.decode("utf-16-le", "replace")

    def octets(self, count: int) -> bytes:
        """Return the next `count` bytes."""
        begin, self._position = self._position, self._position + count
        if self._position > len(self._data):
            raise struct.error("a string or an array is longer than its message")
        return self._data[begin : self._position]


@lru_cache(maxsize=1024)
def _aligned(order: str, codes: str, phase: int) -> struct.Struct:
    """Return the layout, with padding, of numbers whose offset is `phase` modulo 8."""
    layout, position = [order], phase
    for code in codes:
        size = struct.calcsize(f"<{code}")
        padding = -position % size
        layout.append(f"{padding}x{code}" if padding else code)
        position += padding + size
    return struct.Struct("".join(layout))


class CdrWriter:
    """Serializes a message as plain CDR, little endian. Add its fields in their order."""

    def __init__(self) -> None:
        self.data = bytearray(ENCAPSULATION)

    def put(self, code: str, *numbers: Any) -> None:
        """Add numbers; `code` is their format in `struct`."""
        self.data += bytes((BODY - len(self.data)) % struct.calcsize(code))
        self.data += struct.pack(f"<{len(numbers)}{code}", *numbers)

    def text(self, text: str) -> None:
        """Add a string; characters that UTF-8 cannot encode are written as escapes."""
        content = text.encode(errors="backslashreplace") + b"\0"
        self.put("I", len(content))
        self.data += content

    def wide_text(self, text: str) -> None:
        """Add a wide string."""
        content = text.encode("utf-16-le", errors="surrogatepass")
        units = struct.unpack(f"<{len(content) // 2}H", content)
        self.put("I", len(units), *units)
