"""Converts any message to plain values and back by its definition.

A message becomes a dict. An array or sequence becomes a list, or `bytes` if its items are bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from math import isfinite
from typing import Any, Final

from robotctl.messages.cdr import CdrReader, CdrWriter
from robotctl.messages.definition import BYTE, NUMBERS, TEXT, Definition, Field, FieldShape
from robotctl.messages.fields import FieldPath, ValueKind, WrongValue, leaves, unknown_field

_PADDING: Final = "x"
"""The one byte of a message without fields."""

_Step = str | Callable[[CdrReader], Any]
"""The `struct` codes of several leaves, or a function that reads the value of one leaf."""


class Decoder:
    """Decodes the messages of one type."""

    def __init__(self, definition: Definition) -> None:
        self._definition = definition
        self._plans: dict[str, Sequence[_Step]] = {}
        self._root = Field("", definition.root)
        self.columns = tuple(
            each for each in leaves(definition) if each.kind is not ValueKind.MESSAGE
        )
        """The path of each column of `row`."""

    def row(self, data: bytes) -> list[Any]:
        """Return the values of the message `data`, one for each of `columns`.

        Raises:
            struct.error: The message is cut short, or not in plain CDR.
        """
        return self._read(self._root, CdrReader(data))

    def values(self, data: bytes) -> dict[str, Any]:
        """Return the message as a dict from field name to value.

        Raises:
            struct.error: The message is cut short, or not in plain CDR.
        """
        values: dict[str, Any] = self._nested(self._root, iter(self.row(data)))
        return values

    def _read(self, message: Field, reader: CdrReader) -> list[Any]:
        """Return the primitive values of the next message in `reader`, in field order."""
        plan = self._plans.get(message.type_name)
        if plan is None:
            plan = self._plans[message.type_name] = self._plan(message)
        values: list[Any] = []
        for step in plan:
            if isinstance(step, str):
                values += reader.run(step)
            else:
                values.append(step(reader))
        return values

    def _plan(self, message: Field) -> Sequence[_Step]:
        steps: list[_Step] = []
        for leaf in leaves(self._definition, FieldPath((), message)):
            code = _PADDING if leaf.kind is ValueKind.MESSAGE else NUMBERS.get(leaf.field.type_name)
            if leaf.field.shape is not FieldShape.ONE:
                steps.append(partial(self._read_list, leaf.field))
            elif code is None:
                steps.append(_text_reader(leaf.field))
            elif steps and isinstance(steps[-1], str):
                steps[-1] += code
            else:
                steps.append(code)
        return steps

    def _read_list(self, field: Field, reader: CdrReader) -> Any:
        if field.shape is FieldShape.ARRAY:
            count = field.length or 0
        else:
            (count,) = reader.take("I")
        code = NUMBERS.get(field.type_name)
        if code == BYTE:
            return reader.octets(count)
        if code:
            return list(reader.take(code, count)) if count else []  # an empty list is not aligned
        if field.is_text:
            read = _text_reader(field)
            return [read(reader) for _ in range(count)]
        item = field.item
        return [self._nested(item, iter(self._read(item, reader))) for _ in range(count)]

    def _nested(self, field: Field, values: Iterator[Any]) -> Any:
        """Return the value of a field (dict, list or single value) from the next `values`."""
        if field.shape is FieldShape.ONE and field.is_message:
            fields = self._definition.types[field.type_name]
            return {each.name: self._nested(each, values) for each in fields}
        if not self._definition.is_split(field):
            return next(values)
        if field.is_message:
            return [self._nested(field.item, values) for _ in range(field.length or 0)]
        return list(islice(values, field.length))


def _text_reader(field: Field) -> Callable[[CdrReader], str]:
    return CdrReader.text if field.type_name == TEXT else CdrReader.wide_text


def encode(definition: Definition, values: Mapping[str, Any]) -> bytes:
    """Return `values`, which must fit `definition`, as a serialized message."""
    writer = CdrWriter()
    _write(definition, Field("", definition.root), values, writer)
    return bytes(writer.data)


def _write(definition: Definition, field: Field, value: Any, writer: CdrWriter) -> None:
    code = NUMBERS.get(field.type_name)
    if field.shape is not FieldShape.ONE:
        if field.shape is FieldShape.SEQUENCE:
            writer.put("I", len(value))
        if code and len(value):  # an empty list is not aligned
            writer.put(code, *value)
        elif not code:
            item = field.item
            for each in value:
                _write(definition, item, each, writer)
    elif field.is_message:
        fields = definition.types[field.type_name]
        if not fields:
            writer.put(BYTE, 0)
        for inner in fields:
            _write(definition, inner, value[inner.name], writer)
    elif code:
        writer.put(code, value)
    elif field.type_name == TEXT:
        writer.text(value)
    else:
        writer.wide_text(value)


def zero(definition: Definition, field: Field) -> Any:
    """Return the default value of a field, which is 0, False or empty."""
    if field.shape is FieldShape.SEQUENCE:
        return []
    if field.shape is FieldShape.ARRAY:
        return [zero(definition, field.item) for _ in range(field.length or 0)]
    if field.is_message:
        return {each.name: zero(definition, each) for each in definition.types[field.type_name]}
    return {"?": False, "f": 0.0, "d": 0.0, "": ""}.get(NUMBERS.get(field.type_name, ""), 0)


def filled(definition: Definition, defaults: Mapping[str, Any], given: object) -> dict[str, Any]:
    """Return `defaults`, overridden by the fields in `given`.

    Raises:
        WrongValue: A field does not exist, or has a value of another type or size.
    """
    merged: dict[str, Any] = _filled(definition, Field("", definition.root), defaults, given, "")
    return merged


def _filled(definition: Definition, field: Field, before: Any, given: object, path: str) -> Any:
    if field.shape is not FieldShape.ONE:
        return _filled_list(definition, field, given, path)
    kind = field.type_name
    if field.is_message:
        if not isinstance(given, Mapping):
            raise WrongValue(f"{path or kind}: {given!r} is not in the form {{field: value}}")
        fields, merged = {each.name: each for each in definition.types[kind]}, dict(before)
        for name, value in given.items():
            inner = fields.get(str(name))
            if inner is None:
                raise WrongValue(unknown_field(str(name), kind, tuple(fields.values())))
            place = f"{path}.{name}".lstrip(".")
            merged[inner.name] = _filled(definition, inner, merged[inner.name], value, place)
        return merged
    if field.is_text:
        if not isinstance(given, str) or "\0" in given:
            raise WrongValue(f"{path}: {given!r} is no text ({field.type_text}): put it in quotes")
        size = len(given.encode(errors="replace"))
        if field.text_bound is not None and size > field.text_bound:
            raise WrongValue(f"{path}: longer than {field.text_bound} bytes ({field.type_text})")
        return given
    if kind != "bool":
        return _number(NUMBERS[kind], kind, given, path)
    if not isinstance(given, bool):
        raise WrongValue(f"{path}: {given!r} is neither true nor false")
    return given


def _filled_list(definition: Definition, field: Field, given: object, path: str) -> list[Any]:
    if not isinstance(given, list | bytes):
        raise WrongValue(f"{path}: {given!r} is no list ({field.type_text})")
    count, limit = len(given), field.length
    if field.shape is FieldShape.ARRAY and count != limit:
        raise WrongValue(f"{path}: {count} values, not {limit} ({field.type_text})")
    if limit is not None and count > limit:
        raise WrongValue(f"{path}: {count} values, at most {limit} ({field.type_text})")
    item = field.item
    before = zero(definition, item)
    return [
        _filled(definition, item, before, each, f"{path}[{place}]")
        for place, each in enumerate(given)
    ]


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
