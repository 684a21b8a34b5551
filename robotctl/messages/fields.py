"""Fields of a message: their paths, the leaf fields, and messages as flat rows.

An array of up to 64 values has a column for each, `ranges[0]` and so on. A sequence, a longer
array, or an array of bytes has one column.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Final

from robotctl.messages.cdr import CdrReader
from robotctl.messages.definition import (
    NUMBERS,
    TEXT,
    WIDE_TEXT,
    Definition,
    Field,
    FieldShape,
    UnreadableType,
)
from robotctl.messages.values import WrongValue, read_field, unknown_field

_STEP = re.compile(r"([A-Za-z]\w*)((?:\[\d{1,9}\])*)")
_INDEX = re.compile(r"\[(\d+)\]")

Steps = tuple[str | int, ...]


def parse_path(definition: Definition, path: str) -> Steps:
    """Return the names and indexes that lead to a field of the type.

    Raises:
        WrongValue: The path is malformed, or leads to no field of the type.
    """
    steps: list[str | int] = []
    type_name = definition.root
    for text in path.split("."):
        match = _STEP.fullmatch(text)
        if match is None:
            raise WrongValue(f"{path!r} is no path to a field: use names with dots, like a.b[0].c")
        name, indexes = match[1], [int(each) for each in _INDEX.findall(match[2])]
        fields = definition.types.get(type_name)
        if fields is None:
            raise WrongValue(f"{path_text(steps)} is a {type_name}, which has no fields")
        field = next((each for each in fields if each.name == name), None)
        if field is None:
            raise WrongValue(unknown_field(name, type_name, fields))
        steps += [name, *indexes]
        if len(indexes) > (field.shape is not FieldShape.ONE):
            raise WrongValue(f"{path_text(steps[: -len(indexes)])} is a {field.type_text}: no list")
        if field.shape is FieldShape.ARRAY and indexes and indexes[0] >= (field.length or 0):
            raise WrongValue(f"{path_text(steps[:-1])} has {field.length} values, from [0]")
        is_list = field.shape is not FieldShape.ONE and not indexes
        type_name = field.type_text if is_list else field.type_name
    return tuple(steps)


def value_at(values: Mapping[str, Any], steps: Steps) -> Any:
    """Return the value at the end of a path.

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


def path_text(steps: Steps | list[str | int]) -> str:
    """Return the path that leads along the steps, such as `a.b[0].c`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps)[1:]


@dataclass(frozen=True, slots=True)
class LeafField:
    """A field that is a number or a text, or a list of any length.

    `steps` lead to its value. A list of numbers or texts is one leaf, and so
    is a sequence of messages, since its length differs from message to message.
    """

    path: str
    steps: Steps
    field: Field

    @property
    def is_number(self) -> bool:
        """Whether the value is one number or truth value."""
        return self.field.shape is FieldShape.ONE and self.field.type_name in NUMBERS

    @property
    def is_number_list(self) -> bool:
        """Whether the value is a list of numbers or truth values."""
        return self.field.shape is not FieldShape.ONE and self.field.type_name in NUMBERS


def leaf_fields(definition: Definition, below: str = "", steps: Steps = ()) -> Iterator[LeafField]:
    """Yield the leaf fields of a type, or of its nested type `below`, in the order of definition.

    `steps` lead to the message of type `below`. A type from a recording may have any number of
    leaves: read no more than you need.
    """
    return _leaves(definition, _types_with_leaves(definition), below or definition.root, steps)


def _leaves(
    definition: Definition, useful: Set[str], type_name: str, steps: Steps
) -> Iterator[LeafField]:
    for field in definition.types[type_name]:
        here = (*steps, field.name)
        if field.type_name not in definition.types or field.shape is FieldShape.SEQUENCE:
            yield LeafField(path_text(here), here, field)
        elif field.type_name not in useful:
            continue
        elif field.shape is FieldShape.ONE:
            yield from _leaves(definition, useful, field.type_name, here)
        else:
            for index in range(field.length or 0):
                yield from _leaves(definition, useful, field.type_name, (*here, index))


def _types_with_leaves(definition: Definition) -> Set[str]:
    """Return the types with a leaf. A search skips the others, which may be nested 2^64 times."""
    useful: set[str] = set()
    before = -1
    while len(useful) > before:
        before = len(useful)
        for name, fields in definition.types.items():
            if any(
                field.type_name not in definition.types
                or field.shape is FieldShape.SEQUENCE
                or (field.type_name in useful and field.length != 0)
                for field in fields
            ):
                useful.add(name)
    return useful


MAX_COLUMNS_OF_ARRAY: Final = 64
MAX_COLUMNS: Final = 4096
"""More than any ROS type has; a recording may describe a type with 2^64 fields."""

_PADDING: Final = "x"
"""A message without fields has one byte."""
_BYTE: Final = "B"


class ColumnKind(Enum):
    """What the values of a column are."""

    NUMBER = "number"
    TEXT = "text"
    BYTES = "bytes"
    LIST = "list"
    """A list of numbers or texts."""

    NESTED = "nested"
    """A list of messages, each a dict."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column: `name` is the path of its field, `type_name` the type of a value, or of an item."""

    name: str
    kind: ColumnKind
    type_name: str


_Step = str | Callable[[CdrReader], Any]
"""The `struct` codes of several columns, or a function that reads the value of one column."""


class FlatDecoder:
    """Decodes the messages of one type into flat rows."""

    def __init__(self, definition: Definition) -> None:
        """Plan the columns.

        Raises:
            UnreadableType: The type has more than MAX_COLUMNS columns.
        """
        self._definition = definition
        self._counts: dict[str, int] = {}
        count = self._count(definition.root)
        if count > MAX_COLUMNS:
            raise UnreadableType(f"{definition.root} has {count} fields, at most {MAX_COLUMNS}")
        columns: list[Column] = []
        self._steps: list[_Step] = []
        for column, step in self._plan(definition.root, ""):
            if column is not None:
                columns.append(column)
            last = self._steps[-1] if self._steps else None
            if isinstance(step, str) and isinstance(last, str):
                self._steps[-1] = last + step
            else:
                self._steps.append(step)
        self.columns = tuple(columns)
        """The columns, in the order of the fields."""

    def row(self, data: bytes) -> list[Any]:
        """Return the value of each column.

        Raises:
            struct.error: The message is cut short, or not in plain CDR.
        """
        reader = CdrReader(data)
        values: list[Any] = []
        for step in self._steps:
            if isinstance(step, str):
                values += reader.run(step)
            else:
                values.append(step(reader))
        return values

    def _count(self, type_name: str) -> int:
        """Return the number of columns of a message type, at least 1."""
        if type_name not in self._counts:
            fields = self._definition.types[type_name]
            count = sum(self._count_item(each.type_name) * self._repeats(each) for each in fields)
            self._counts[type_name] = max(count, 1)  # its padding
        return self._counts[type_name]

    def _count_item(self, type_name: str) -> int:
        return self._count(type_name) if type_name in self._definition.types else 1

    def _repeats(self, field: Field) -> int:
        """Return the length of an array that is spread over columns, otherwise 1."""
        return field.length or 1 if self._is_spread(field) else 1

    def _is_spread(self, field: Field) -> bool:
        """Return whether an array has a column for each of its values."""
        if field.shape is not FieldShape.ARRAY or NUMBERS.get(field.type_name) == _BYTE:
            return False
        length = field.length or 0
        return 0 < length * self._count_item(field.type_name) <= MAX_COLUMNS_OF_ARRAY

    def _plan(self, type_name: str, prefix: str) -> Iterator[tuple[Column | None, _Step]]:
        fields = self._definition.types[type_name]
        if not fields:
            yield None, _PADDING
        for field in fields:
            name = f"{prefix}{field.name}"
            if field.shape is FieldShape.ONE:
                yield from self._plan_item(name, field.type_name)
            elif self._is_spread(field):
                for place in range(field.length or 0):
                    yield from self._plan_item(f"{name}[{place}]", field.type_name)
            else:
                column = Column(name, self._kind_of_list(field.type_name), field.type_name)
                if column.kind is ColumnKind.BYTES:
                    yield column, partial(_read_bytes, self._definition, field)
                else:
                    yield column, partial(read_field, self._definition, field)

    def _plan_item(self, name: str, type_name: str) -> Iterator[tuple[Column | None, _Step]]:
        code = NUMBERS.get(type_name)
        if code:
            yield Column(name, ColumnKind.NUMBER, type_name), code
        elif type_name == TEXT:
            yield Column(name, ColumnKind.TEXT, type_name), CdrReader.text
        elif type_name == WIDE_TEXT:
            field = Field(name, type_name)
            yield (
                Column(name, ColumnKind.TEXT, type_name),
                partial(read_field, self._definition, field),
            )
        else:
            yield from self._plan(type_name, f"{name}.")

    def _kind_of_list(self, type_name: str) -> ColumnKind:
        if NUMBERS.get(type_name) == _BYTE:
            return ColumnKind.BYTES
        return ColumnKind.NESTED if type_name in self._definition.types else ColumnKind.LIST


def _read_bytes(definition: Definition, field: Field, reader: CdrReader) -> bytes:
    return bytes(read_field(definition, field, reader))
