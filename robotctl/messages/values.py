"""Converts any message to plain values and back by its definition; checks values from users.

A message becomes a dict, an array or sequence becomes a list. An array or sequence of bytes becomes
`bytes` if it is not empty.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from difflib import get_close_matches
from math import isfinite
from typing import Any, Final

from robotctl.messages.cdr import BODY, ENCAPSULATION, CdrReader
from robotctl.messages.definition import NUMBERS, TEXT, WIDE_TEXT, Definition, Field, FieldShape

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
    """Return the serialized form of values that fit the definition (see `filled`)."""
    writer = _Writer()
    _write(definition, definition.root, values, writer)
    return bytes(writer.data)


def zero(definition: Definition, type_name: str) -> dict[str, Any]:
    """Return a message with numbers 0 and bools False, whose texts and sequences are empty."""
    return {field.name: zero_of(definition, field) for field in definition.types[type_name]}


def zero_of(definition: Definition, field: Field) -> Any:
    """Return the value of a field in a message that `zero` returns."""
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
    """Collects a message in CDR; alignment counts from the end of the encapsulation."""

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


class WrongValue(ValueError):
    """A value that the type does not allow; the error names the field and what it may hold."""


def filled(definition: Definition, defaults: Mapping[str, Any], given: object) -> dict[str, Any]:
    """Return `defaults`, overridden by the fields in `given`.

    Raises:
        WrongValue: A field does not exist, or has a value of another type or size.
    """
    return _message(definition, definition.root, defaults, given, "")


def unknown_field(name: str, type_name: str, fields: tuple[Field, ...]) -> str:
    """Return the error text for a field that a type does not have."""
    names = [field.name for field in fields]
    near = get_close_matches(name, names, n=1, cutoff=0.4)
    contained = [each for each in names if name and name in each]
    if near or contained:
        hint = f"did you mean {(near or contained)[0]}?"
    else:
        hint = f"it has {', '.join(names) or 'no fields'}"
    return f"{type_name} has no field {name!r}: {hint}"


def _message(
    definition: Definition, type_name: str, values: Mapping[str, Any], given: object, path: str
) -> dict[str, Any]:
    if not isinstance(given, Mapping):
        raise WrongValue(f"{path or type_name}: {given!r} is not in the form {{field: value}}")
    fields = {field.name: field for field in definition.types[type_name]}
    merged = dict(values)
    for name, value in given.items():
        field = fields.get(str(name))
        if field is None:
            raise WrongValue(unknown_field(str(name), type_name, tuple(fields.values())))
        merged[field.name] = _value(
            definition, field, merged[field.name], value, f"{path}.{name}".lstrip(".")
        )
    return merged


def _value(definition: Definition, field: Field, before: Any, given: object, path: str) -> Any:
    if field.shape is FieldShape.ONE:
        return _item(definition, field, before, given, path)
    if not isinstance(given, list | bytes):
        raise WrongValue(f"{path}: {given!r} is no list ({field.type_text})")
    count, limit = len(given), field.length
    if field.shape is FieldShape.ARRAY and count != limit:
        raise WrongValue(f"{path}: {count} values, not {limit} ({field.type_text})")
    if limit is not None and count > limit:
        raise WrongValue(f"{path}: {count} values, at most {limit} ({field.type_text})")
    before = None if NUMBERS.get(field.type_name) else zero_message(definition, field)
    return [
        _item(definition, field, before, item, f"{path}[{place}]")
        for place, item in enumerate(given)
    ]


def zero_message(definition: Definition, field: Field) -> dict[str, Any]:
    """Return `zero` for the type of a field if that is a message type, otherwise {}."""
    return zero(definition, field.type_name) if field.type_name in definition.types else {}


def _item(definition: Definition, field: Field, before: Any, given: object, path: str) -> Any:
    kind = field.type_name
    if kind in definition.types:
        return _message(definition, kind, before, given, path)
    if kind in (TEXT, WIDE_TEXT):
        if not isinstance(given, str) or "\0" in given:
            raise WrongValue(f"{path}: {given!r} is no text ({field.type_text}): put it in quotes")
        size = len(given.encode(errors="replace"))
        if field.text_bound is not None and size > field.text_bound:
            raise WrongValue(f"{path}: longer than {field.text_bound} bytes ({field.type_text})")
        return given
    code = NUMBERS[kind]
    if code == "?":
        if not isinstance(given, bool):
            raise WrongValue(f"{path}: {given!r} is neither true nor false")
        return given
    return _number(code, kind, given, path)


def _number(code: str, kind: str, given: object, path: str) -> int | float:
    if code in "fd":
        if not isinstance(given, int | float) or isinstance(given, bool):
            raise WrongValue(f"{path}: {given!r} is no number ({kind})")
        try:
            number = float(given)
            packed = struct.pack(f"<{code}", number)
        except OverflowError:
            raise WrongValue(f"{path}: {given!r} is too large for {kind}") from None
        (kept,) = struct.unpack(f"<{code}", packed)
        if isfinite(number) and not isfinite(kept):
            raise WrongValue(f"{path}: {given!r} is too large for {kind}")
        return number
    if not isinstance(given, int) or isinstance(given, bool):
        raise WrongValue(f"{path}: {given!r} is no whole number ({kind})")
    bits = struct.calcsize(f"<{code}") * 8
    low, high = (0, 2**bits - 1) if code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    if not low <= given <= high:
        raise WrongValue(f"{path}: {given} is not in {low} to {high} ({kind})")
    return given
