"""The definition of a ROS type: its fields, as its ros2msg text gives them, and its RIHS01 hash."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from typing import Any, Final

TEXT: Final = "string"
WIDE_TEXT: Final = "wstring"

NUMBERS: Final[Mapping[str, str]] = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""The `struct` code of each numeric type."""

_MAX_DEPTH: Final = 64
"""Limit on nested types, more than any ROS type has; a recording may hold any text."""

_SEPARATOR = re.compile(r"^=+[ \t]*\n(?=MSG: )", re.MULTILINE)
_FIELD = re.compile(
    r"\s*(?P<type>[A-Za-z][\w/]*)(?:<=(?P<text_bound>\d+))?"
    r"(?P<array>\[(?P<upper><=)?(?P<length>\d*)\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<constant>=)?"
)


class UnreadableType(ValueError):
    """The text is no readable definition of a type; the error says why."""


class FieldShape(Enum):
    """How many values a field has."""

    ONE = "one"
    ARRAY = "array"
    SEQUENCE = "sequence"


@dataclass(frozen=True, slots=True)
class Field:
    """A field: its name, its type (a built-in one, or `pkg/T`) and how many values it has.

    `length` is the length of an array or the bound of a sequence, None for an unbounded sequence
    or a single value. `text_bound` is the bound of a string, None if it is unbounded.
    """

    name: str
    type_name: str
    shape: FieldShape = FieldShape.ONE
    length: int | None = None
    text_bound: int | None = None

    @property
    def type_text(self) -> str:
        """The type as a .msg file writes it."""
        bound = "" if self.text_bound is None else f"<={self.text_bound}"
        if self.shape is FieldShape.ONE:
            return self.type_name + bound
        limit = "<=" if self.shape is FieldShape.SEQUENCE and self.length is not None else ""
        return f"{self.type_name}{bound}[{limit}{'' if self.length is None else self.length}]"


@dataclass(frozen=True, slots=True)
class Definition:
    """The fields of the type `root` and of all types that it needs, by `pkg/T`."""

    root: str
    types: Mapping[str, tuple[Field, ...]]

    @property
    def fields(self) -> tuple[Field, ...]:
        """The fields of the type `root`."""
        return self.types[self.root]


def is_built_in(type_name: str) -> bool:
    """Return whether a type is a number, a bool or a string."""
    return type_name in NUMBERS or type_name in (TEXT, WIDE_TEXT)


def short_type(type_name: str) -> str:
    """Return `pkg/T` of `pkg/msg/T`, `pkg/srv/T` or `pkg/action/T`."""
    package, _, rest = type_name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}"


def parse_definition(type_name: str, text: str) -> Definition:
    """Return the fields of a type and of the types that it needs, from its ros2msg text.

    Raises:
        UnreadableType: A line is no field, a type is missing, or a type contains itself.
    """
    own, *others = _SEPARATOR.split(text)
    root = short_type(type_name)
    types = {root: _fields(root, own)}
    for part in others:
        head, _, body = part.partition("\n")
        name = short_type(head.removeprefix("MSG: ").strip())
        types.setdefault(name, _fields(name, body))
    _check(types, root, (), set())
    return Definition(root, types)


def needed_types(owner: str, text: str) -> list[str]:
    """Return the message types, as `pkg/T`, that `text` names: the .msg text of `owner` alone.

    Raises:
        UnreadableType: A line is no field.
    """
    return [each.type_name for each in _fields(owner, text) if not is_built_in(each.type_name)]


def _fields(owner: str, text: str) -> tuple[Field, ...]:
    package = owner.partition("/")[0]
    found = []
    for line in text.splitlines():
        line = line.partition("#")[0]
        if not line.strip():
            continue
        match = _FIELD.match(line)
        if match is None:
            raise UnreadableType(f"{owner} has a line that is no field: {line.strip()[:80]!r}")
        if match["constant"]:
            continue
        type_name = match["type"]
        if not is_built_in(type_name):
            type_name = short_type(type_name if "/" in type_name else f"{package}/{type_name}")
        shape = FieldShape.ONE
        if match["array"]:
            is_array = match["length"] and not match["upper"]
            shape = FieldShape.ARRAY if is_array else FieldShape.SEQUENCE
        length = int(match["length"]) if match["length"] else None
        bound = int(match["text_bound"]) if match["text_bound"] else None
        found.append(Field(match["name"], type_name, shape, length, bound))
    return tuple(found)


def _check(
    types: Mapping[str, tuple[Field, ...]], name: str, around: tuple[str, ...], good: set[str]
) -> None:
    """Check that `types` has all types that `name` needs, and that none needs itself.

    `around` are the types that contain `name`; the types that passed are added to `good`.
    """
    if name in around or len(around) > _MAX_DEPTH:
        raise UnreadableType(f"{name} contains itself")
    for field in types[name]:
        inner = field.type_name
        if is_built_in(inner) or inner in good:
            continue
        if inner not in types:
            raise UnreadableType(f"{name} needs {inner}, which is not described")
        _check(types, inner, (*around, name), good)
    good.add(name)


_NESTED: Final = 1
_BUILT_IN: Final[Mapping[str, int]] = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,  # in a .msg file, another name of uint8
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
}
_BOUNDED_TEXT: Final = 4
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
"""Offsets that are added to a type's number, as in type_description_interfaces/msg/FieldType."""

_EMPTY: Final = (Field("structure_needs_at_least_one_member", "uint8"),)
"""ROS gives this field to a type that has none."""


def rihs01_hash(type_name: str, definition: Definition) -> str:
    """Return the RIHS01 hash of a type `pkg/msg/T`, `pkg/srv/T` or `pkg/action/T`.

    Comments, constants and default values do not change the hash.
    """
    package, _, rest = type_name.partition("/")
    own_kind = rest.partition("/")[0]

    def full(short: str) -> str:
        owner, _, name = short.partition("/")
        implied = owner == package and "_" in name  # part of a service or action: T_Request
        return f"{owner}/{own_kind if implied else 'msg'}/{name}"

    def described(short: str, name: str) -> dict[str, Any]:
        fields = definition.types[short] or _EMPTY
        return {"type_name": name, "fields": [_described(field, full) for field in fields]}

    others = sorted((full(short), short) for short in _needed(definition))
    text = json.dumps(
        {
            "type_description": described(definition.root, type_name),
            "referenced_type_descriptions": [described(short, name) for name, short in others],
        }
    )
    return f"RIHS01_{sha256(text.encode()).hexdigest()}"


def _described(field: Field, full: Callable[[str], str]) -> dict[str, Any]:
    built_in = is_built_in(field.type_name)
    number = _BUILT_IN[field.type_name] if built_in else _NESTED
    if field.text_bound is not None:
        number += _BOUNDED_TEXT
    match field.shape:
        case FieldShape.ARRAY:
            number += _ARRAY
        case FieldShape.SEQUENCE:
            number += _SEQUENCE if field.length is None else _BOUNDED_SEQUENCE
        case FieldShape.ONE:
            pass
    return {
        "name": field.name,
        "type": {
            "type_id": number,
            "capacity": field.length or 0,
            "string_capacity": field.text_bound or 0,
            "nested_type_name": "" if built_in else full(field.type_name),
        },
    }


def _needed(definition: Definition) -> set[str]:
    """Return the types that the root needs, as `pkg/T`."""
    needed: set[str] = set()
    waiting = [definition.root]
    while waiting:
        for field in definition.types[waiting.pop()]:
            if not is_built_in(field.type_name) and field.type_name not in needed:
                needed.add(field.type_name)
                waiting.append(field.type_name)
    return needed
