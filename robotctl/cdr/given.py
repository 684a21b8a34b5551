"""Values that a user has written for a message, checked against its type."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from difflib import get_close_matches
from math import isfinite
from typing import Any

from robotctl.cdr.definition import NUMBERS, TEXT, WIDE_TEXT, Definition, Field, FieldShape
from robotctl.cdr.values import zero


class WrongValue(ValueError):
    """A value that the type does not allow; the error names the field and what it may hold."""


def filled(definition: Definition, defaults: Mapping[str, Any], given: object) -> dict[str, Any]:
    """Return `defaults` with what is given in their place.

    Raises:
        WrongValue: A field does not exist, or has a value of another type or size.
    """
    return _message(definition, definition.root, defaults, given, "")


def unknown_field(name: str, type_name: str, fields: tuple[Field, ...]) -> str:
    """Return a sentence about a field that a type does not have."""
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
    """Return the zero of a field's type where that is a message, else an empty dict."""
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
