"""Any message as plain values, and back, by the definition of its type: no ROS is needed.

A message becomes a dict, an array or sequence a list, and an array or sequence of bytes `bytes`.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, Final

from robotctl.cdr.definition import NUMBERS, TEXT, WIDE_TEXT, Definition, Field, FieldShape
from robotctl.cdr.reader import BODY, ENCAPSULATION, CdrReader

_BYTE: Final = "B"
_EMPTY: Final = "B"
"""A message without fields has one byte in CDR: C++ knows no empty structure."""


def decode(definition: Definition, data: bytes) -> dict[str, Any]:
    """Return the values of a serialized message.

    Raises:
        struct.error: The message is cut short, or not in plain CDR.
    """
    return _read(definition, definition.root, CdrReader(data))


def encode(definition: Definition, values: Mapping[str, Any]) -> bytes:
    """Return the serialized form of values that fit the definition (see `cdr.given`)."""
    writer = _Writer()
    _write(definition, definition.root, values, writer)
    return bytes(writer.data)


def zero(definition: Definition, type_name: str) -> dict[str, Any]:
    """Return a message whose numbers are 0, whose texts and sequences are empty."""
    return {field.name: zero_of(definition, field) for field in definition.types[type_name]}


def zero_of(definition: Definition, field: Field) -> Any:
    """Return the value of a field in such a message."""
    if field.shape is FieldShape.SEQUENCE:
        return []
    if field.shape is FieldShape.ARRAY:
        return [_zero_item(definition, field) for _ in range(field.length or 0)]
    return _zero_item(definition, field)


def _zero_item(definition: Definition, field: Field) -> Any:
    if field.type_name in (TEXT, WIDE_TEXT):
        return ""
    code = NUMBERS.get(field.type_name)
    if code is None:
        return zero(definition, field.type_name)
    return {"?": False, "f": 0.0, "d": 0.0}.get(code, 0)


def _read(definition: Definition, type_name: str, reader: CdrReader) -> dict[str, Any]:
    fields = definition.types[type_name]
    if not fields:
        reader.take(_EMPTY)
    return {field.name: read_field(definition, field, reader) for field in fields}


def read_field(definition: Definition, field: Field, reader: CdrReader) -> Any:
    """Return the value of the next field.

    Raises:
        struct.error: The message is cut short.
    """
    code = NUMBERS.get(field.type_name)
    if field.shape is FieldShape.ONE:
        return reader.take(code)[0] if code else _read_item(definition, field.type_name, reader)
    if field.shape is FieldShape.ARRAY:
        count = field.length or 0
    else:
        (count,) = reader.take("I")
    if not count:  # an empty sequence is not aligned
        return []
    if code == _BYTE:
        return reader.octets(count)
    if code:
        return list(reader.take(code, count))
    return [_read_item(definition, field.type_name, reader) for _ in range(count)]


def _read_item(definition: Definition, type_name: str, reader: CdrReader) -> Any:
    if type_name == TEXT:
        return reader.text()
    if type_name == WIDE_TEXT:
        (count,) = reader.take("I")
        units = reader.take("I", count) if count else ()
        return b"".join(struct.pack("<H", unit & 0xFFFF) for unit in units).decode(
            "utf-16-le", "replace"
        )
    return _read(definition, type_name, reader)


class _Writer:
    """The bytes written so far; alignment counts from the end of the header."""

    def __init__(self) -> None:
        self.data = bytearray(ENCAPSULATION)

    def put(self, code: str, *numbers: Any) -> None:
        size = struct.calcsize(f"<{code}")
        self.data += bytes((BODY - len(self.data)) % size)
        self.data += struct.pack(f"<{len(numbers)}{code}", *numbers)

    def text(self, text: str) -> None:
        content = text.encode() + b"\0"
        self.put("I", len(content))
        self.data += content

    def wide_text(self, text: str) -> None:
        content = text.encode("utf-16-le")
        units = struct.unpack(f"<{len(content) // 2}H", content)
        self.put("I", len(units))
        for unit in units:
            self.put("I", unit)


def _write(
    definition: Definition, type_name: str, values: Mapping[str, Any], writer: _Writer
) -> None:
    fields = definition.types[type_name]
    if not fields:
        writer.put(_EMPTY, 0)
    for field in fields:
        value = values[field.name]
        items = [value] if field.shape is FieldShape.ONE else value
        if field.shape is FieldShape.SEQUENCE:
            writer.put("I", len(items))
        code = NUMBERS.get(field.type_name)
        if code and len(items):
            writer.put(code, *items)
        elif not code:
            for item in items:
                _write_item(definition, field.type_name, item, writer)


def _write_item(definition: Definition, type_name: str, item: Any, writer: _Writer) -> None:
    if type_name == TEXT:
        writer.text(item)
    elif type_name == WIDE_TEXT:
        writer.wide_text(item)
    else:
        _write(definition, type_name, item, writer)
