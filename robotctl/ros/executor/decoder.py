"""Decodes serialized messages to rclpy's message objects, by a function generated for each type.

The functions read plain CDR, little endian (OMG DDSI-RTPS 10.2). rclpy decodes everything else.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from typing import Any, Final

import numpy
from rclpy.serialization import deserialize_message
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    Array,
    BasicType,
    NamespacedType,
)

Decode = Callable[[bytes], Any]
"""Returns the message that the bytes encode. Raises an exception if bytes are missing."""

_PLAIN_CDR: Final = b"\x00\x01"
_BODY: Final = 4
"""Offset [bytes] of the first field, from which alignment counts."""

_NUMBERS: Final = {
    "boolean": "?",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float": "f",
    "double": "d",
}
"""Number types of the IDL -> their codes in `struct`, `array` and numpy."""


class _Unusual(Exception):
    """The type has a field that only rclpy can decode."""


@lru_cache(maxsize=512)
def decoder_of(message_type: Any) -> Decode:
    """Return a function that decodes as `deserialize_message` does, but faster for most types."""

    def by_rclpy(data: bytes) -> Any:
        return deserialize_message(data, message_type)

    if sys.byteorder != "little":
        return by_rclpy
    try:
        return _Source(message_type, by_rclpy).compile()
    except (_Unusual, ImportError, AttributeError):
        return by_rclpy


class _Source:
    """Generates the source of `decode(data)`, field by field."""

    def __init__(self, message_type: Any, by_rclpy: Decode) -> None:
        self._lines: list[str] = []
        self._names: dict[str, Any] = {
            "array": array,
            "by_rclpy": by_rclpy,
            "error": ValueError,
            "errors": (struct.error, ValueError),
            "new": object.__new__,
            "numbers": numpy.frombuffer,
        }
        self._indent = "        "
        # The next field begins `_ahead` bytes after `_at`: the constant `_BODY` or, after a field
        # of variable length, the variable `at` of the generated code. `_aligned` is a power of two
        # that divides the distance from `_BODY` to `_at`.
        self._at = str(_BODY)
        self._aligned = 8
        self._ahead = 0
        self._run_format = ""
        self._run_names: list[str] = []
        self._run_start = 0
        self._count = 0
        self._message_type = message_type

    def compile(self) -> Decode:
        """Return the compiled function. It passes data that it cannot decode to rclpy.

        Raises:
            _Unusual: Only rclpy can decode this type.
        """
        message = self._message(self._message_type)
        self._end_run()
        self._line(f"if {self._here()} > len(data): raise error('cut short')")
        self._line(f"return {message}")
        source = "\n".join(
            [
                "def decode(data):",
                f"    if not data.startswith({_PLAIN_CDR!r}): return by_rclpy(data)",
                "    try:",
                *self._lines,
                "    except errors: return by_rclpy(data)",
            ]
        )
        exec(compile(source, f"<decoder of {self._message_type.__name__}>", "exec"), self._names)
        decode: Decode = self._names["decode"]
        return decode

    # Fields

    def _message(self, message_type: Any) -> str:
        """Generate code that reads a message, and return the name of the message's variable."""
        default = message_type()
        slots = [slot for slot in message_type.__slots__ if slot != "_check_fields"]
        if not slots:
            raise _Unusual  # an empty message has one byte on the wire
        values = [
            (slot, self._value(kind))
            for slot, kind in zip(slots, message_type.SLOT_TYPES, strict=True)
        ]
        self._end_run()
        kind, message = self._constant(message_type), self._variable()
        self._line(f"{message} = new({kind})")
        self._line(f"{message}._check_fields = {bool(default._check_fields)}")
        for slot, value in values:
            self._line(f"{message}.{slot} = {value}")
        return message

    def _value(self, kind: Any) -> str:
        if isinstance(kind, BasicType):
            return self._number(_format_of(kind))
        if isinstance(kind, AbstractString):
            return self._string()
        if isinstance(kind, NamespacedType):
            return self._message(getattr(import_module(".".join(kind.namespaces)), kind.name))
        if isinstance(kind, Array):
            return self._array(kind)
        if isinstance(kind, AbstractSequence):
            return self._sequence(kind)
        raise _Unusual  # wide strings

    def _string(self) -> str:
        length = self._number("I")
        self._end_run()
        text = self._variable()
        start = self._here()
        self._line(f"{text} = str(data[{start}:{start} + {length} - 1], 'utf-8', 'replace')")
        self._go_to(f"{start} + {length}")
        return text

    def _array(self, kind: Any) -> str:
        item, count = kind.value_type, kind.size
        if isinstance(item, BasicType) and item.typename != "boolean":
            format_ = _format_of(item)
            size = struct.calcsize(format_)
            self._align(size)
            self._end_run()
            values = self._variable()
            self._line(f"{values} = numbers(data, {format_!r}, {count}, {self._here()}).copy()")
            self._ahead += size * count
            return values
        return f"[{', '.join([self._value(item) for _ in range(count)])}]"

    def _sequence(self, kind: Any) -> str:
        item, count = kind.value_type, self._number("I")
        self._end_run()
        values = self._variable()
        if isinstance(item, BasicType):
            format_ = _format_of(item)
            size = struct.calcsize(format_)
            start = self._variable()
            # An empty sequence has no padding before its items.
            self._line(f"{start} = {self._aligned_here(size)} if {count} else {self._here()}")
            span = f"data[{start}:{start} + {size} * {count}]"
            made = f"list(map(bool, {span}))" if format_ == "?" else f"array({format_!r}, {span})"
            self._line(f"{values} = {made}")
            self._go_to(f"{start} + {size} * {count}")
            return values
        self._line(f"{values} = []")
        self._go_to(self._here())
        with self._repeated(count):
            self._line(f"{values}.append({self._value(item)})")
            self._end_run()
            self._go_to(self._here())
        return values

    # Offsets

    def _number(self, format_: str) -> str:
        """Add a number to the next `struct` call, and return the name of its variable."""
        size = struct.calcsize(format_)
        self._align(size)
        if not self._run_names:
            self._run_start = self._ahead
        gap = self._ahead - self._run_start - struct.calcsize(f"<{self._run_format}")
        self._run_format += "x" * gap + format_
        self._ahead += size
        name = self._variable()
        self._run_names.append(name)
        return name

    def _align(self, size: int) -> None:
        if size > self._aligned:
            self._end_run()
            self._go_to(self._aligned_here(size), size)
        self._ahead += -self._ahead % size

    def _aligned_here(self, size: int) -> str:
        """Return the expression for the aligned offset of the next field, of `size` bytes."""
        if size <= self._aligned:
            return f"{self._at} + {self._ahead + -self._ahead % size}"
        return f"({self._here()} - {_BODY} + {size - 1} & {-size}) + {_BODY}"

    def _here(self) -> str:
        return f"{self._at} + {self._ahead}"

    def _go_to(self, place: str, aligned: int = 1) -> None:
        self._line(f"at = {place}")
        self._at, self._aligned, self._ahead = "at", aligned, 0

    def _end_run(self) -> None:
        """Generate code that reads the collected run of numbers."""
        if not self._run_names:
            return
        unpack = self._constant(struct.Struct(f"<{self._run_format}").unpack_from)
        names = ", ".join(self._run_names)
        self._line(f"{names}, = {unpack}(data, {self._at} + {self._run_start})")
        self._run_format, self._run_names = "", []

    # Lines and names of the generated code

    @contextmanager
    def _repeated(self, count: str) -> Iterator[None]:
        self._line(f"for _ in range({count}):")
        self._indent += "    "
        yield
        self._indent = self._indent[:-4]

    def _line(self, text: str) -> None:
        self._lines.append(self._indent + text)

    def _variable(self) -> str:
        self._count += 1
        return f"v{self._count}"

    def _constant(self, value: Any) -> str:
        name = f"c{len(self._names)}"
        self._names[name] = value
        return name


def _format_of(kind: Any) -> str:
    try:
        return _NUMBERS[kind.typename]
    except KeyError:
        raise _Unusual from None  # octets, which are bytes in Python, and wide characters
