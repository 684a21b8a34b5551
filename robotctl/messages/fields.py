"""Paths to the fields of a message, and the leaves of a type."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from robotctl.messages.definition import BYTE, NUMBERS, Definition, Field, FieldShape

_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d{1,9}\])*)")
_INDEX = re.compile(r"\[(\d+)\]")

Steps = tuple[str | int, ...]


class WrongValue(ValueError):
    """A path or value that a type does not allow."""


class ValueKind(Enum):
    """The kind of the values at a FieldPath."""

    NUMBER = "number"
    """Numbers or truth values."""

    TEXT = "text"
    BYTES = "bytes"
    LIST = "list"
    """Lists of numbers or texts."""

    MESSAGE = "message"
    NESTED = "nested"
    """Lists of messages."""


@dataclass(frozen=True, slots=True)
class FieldPath:
    """A path into a message: field names and list indexes (`steps`) that lead to `field`."""

    steps: Steps
    field: Field

    @property
    def name(self) -> str:
        """The path as text, such as `a.b[0].c`."""
        return path_text(self.steps)

    @property
    def kind(self) -> ValueKind:
        """The kind of the values that the path leads to."""
        code = NUMBERS.get(self.field.type_name)
        if self.field.shape is FieldShape.ONE:
            if self.field.is_message:
                return ValueKind.MESSAGE
            return ValueKind.NUMBER if code else ValueKind.TEXT
        if self.field.is_message:
            return ValueKind.NESTED
        return ValueKind.BYTES if code == BYTE else ValueKind.LIST


def path_text(steps: Steps) -> str:
    """Return the path made of `steps` as text, such as `a.b[0].c`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)[1:]


def parse_path(definition: Definition, path: str) -> FieldPath:
    """Return the FieldPath that the text `path` means, such as `a.b[0].c`.

    Raises:
        WrongValue: The path is malformed, or leads to no field of the type.
    """
    steps: Steps = ()
    field = Field("", definition.root)
    for text in path.split("."):
        match = _STEP.fullmatch(text)
        if match is None:
            raise WrongValue(f"{path!r} is no path to a field: use names with dots, like a.b[0].c")
        name, indexes = match[1], [int(each) for each in _INDEX.findall(match[2])]
        if field.shape is not FieldShape.ONE or not field.is_message:
            raise WrongValue(f"{path_text(steps)} is a {field.type_text}, which has no fields")
        fields = definition.types[field.type_name]
        found = next((each for each in fields if each.name == name), None)
        if found is None:
            raise WrongValue(unknown_field(name, field.type_name, fields))
        field, steps = found, (*steps, name)
        for index in indexes:
            if field.shape is FieldShape.ONE:
                raise WrongValue(f"{path_text(steps)} is a {field.type_text}: no list")
            if field.shape is FieldShape.ARRAY and index >= (field.length or 0):
                raise WrongValue(f"{path_text(steps)} has {field.length} values, from [0]")
            field, steps = field.item, (*steps, index)
    return FieldPath(steps, field)


def unknown_field(name: str, type_name: str, fields: tuple[Field, ...]) -> str:
    """Return the error text for a field that a type does not have."""
    from difflib import get_close_matches  # here: few commands need it

    names = [field.name for field in fields]
    near = get_close_matches(name, names, n=1, cutoff=0.4)
    contained = [each for each in names if name and name in each]
    if near or contained:
        hint = f"did you mean {(near or contained)[0]}?"
    else:
        hint = f"it has {', '.join(names) or 'no fields'}"
    return f"{type_name} has no field {name!r}: {hint}"


def value_at(values: Mapping[str, Any], steps: Steps) -> Any:
    """Return the value at the path `steps` in `values`.

    Raises:
        WrongValue: A sequence of this message is shorter than the path's index.
    """
    found: Any = values
    for place, step in enumerate(steps):
        try:
            found = found[step]
        except IndexError:
            count = len(found)
            raise WrongValue(
                f"{path_text(steps[:place])} has {count} values, no [{step}]"
            ) from None
    return found


def leaves(definition: Definition, below: FieldPath | None = None) -> Iterator[FieldPath]:
    """Yield the leaves of a type, or of the field at the path `below`, in the order of definition.

    A message without fields is a leaf without a value.
    """
    path = below or FieldPath((), Field("", definition.root))
    field, steps = path.field, path.steps
    fields = definition.types[field.type_name] if path.kind is ValueKind.MESSAGE else ()
    if definition.is_split(field):
        for place in range(field.length or 0):
            yield from leaves(definition, FieldPath((*steps, place), field.item))
    elif fields:
        for each in fields:
            yield from leaves(definition, FieldPath((*steps, each.name), each))
    else:
        yield path
