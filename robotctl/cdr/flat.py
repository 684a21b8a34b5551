"""Messages as flat rows: one value for each column, such as `pose.pose.position.x`.

An array of up to 64 values has a column for each, `ranges[0]` and so on. A sequence, or a longer
array, has one column, and so have bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Final

from robotctl.cdr.definition import (
    NUMBERS,
    TEXT,
    WIDE_TEXT,
    Definition,
    Field,
    FieldShape,
    UnreadableType,
)
from robotctl.cdr.reader import CdrReader
from robotctl.cdr.values import read_field

MAX_COLUMNS_OF_ARRAY: Final = 64
MAX_COLUMNS: Final = 4096
"""More than any type of ROS has; a recording may describe a type with 2^64 fields."""

_PADDING: Final = "x"
"""A message without fields has one byte."""
_BYTE: Final = "B"


class ColumnKind(Enum):
    """What the values of a column are."""

    NUMBER = "number"
    TEXT = "text"
    BYTES = "bytes"
    LIST = "list"
    """Numbers or texts."""

    NESTED = "nested"
    """A list of messages, each a dict."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column: the path of its field, and what its values are; `type_name` is that of one item."""

    name: str
    kind: ColumnKind
    type_name: str


_Step = str | Callable[[CdrReader], Any]
"""Codes of numbers, each with a column; or a function that reads the value of one column."""


class FlatDecoder:
    """Decodes the messages of one type."""

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
        """Return how many times a field has its columns side by side; 1 also if it is a list."""
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
