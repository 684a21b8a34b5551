"""The definition of a ROS type as ros2msg text and as description.

A description has the form of type_description_interfaces/msg/TypeDescription as plain values.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from typing import Any, Final

MAX_BYTES: Final = 256_000
MAX_TYPES: Final = 200
MAX_FIELDS: Final = 2_000
MAX_DEPTH: Final = 64
"""Limits on one definition: its text [bytes], its types, the fields of all its types together, and
the depth of nesting. The largest type of ROS itself has 16 kB, 20 types and 81 fields, 9 deep."""

MAX_SPLIT: Final = 64
MAX_LEAVES: Final = 4096
"""Limit on the leaves of a message (`leaf_count`): a short text may describe 2^64 of them."""

MAX_LENGTH: Final = 2**32 - 1
"""Limit on the length of an array or text (CDR counts with 32 bits)."""

TEXT: Final = "string"
WIDE_TEXT: Final = "wstring"

BUILT_IN: Final[Mapping[str, tuple[str, int]]] = {
    "int8": ("b", 2),
    "uint8": ("B", 3),
    "char": ("B", 3),  # in a .msg file, another name of uint8
    "int16": ("h", 4),
    "uint16": ("H", 5),
    "int32": ("i", 6),
    "uint32": ("I", 7),
    "int64": ("q", 8),
    "uint64": ("Q", 9),
    "float32": ("f", 10),
    "float64": ("d", 11),
    "bool": ("?", 15),
    "byte": ("B", 16),
    TEXT: ("", 17),
    WIDE_TEXT: ("", 18),
}
"""The built-in types of ros2msg: the `struct` code of a number, and the number of the type in
type_description_interfaces/msg/FieldType."""

NUMBERS: Final = {name: code for name, (code, _) in BUILT_IN.items() if code}
"""The `struct` code of each numeric type."""

BYTE: Final = "B"

_SEPARATOR = re.compile(r"^=+[ \t\r]*\n(?=MSG: )", re.MULTILINE)
_FIELD = re.compile(
    r"\s*+(?P<type>[A-Za-z][\w/]*+)(?:<=(?P<text_bound>\d+))?"
    r"(?P<array>\[(?P<upper><=)?(?P<length>\d*)\])?"
    r"\s++(?P<name>[A-Za-z]\w*+)\s*+(?P<constant>=)?",
    re.ASCII,
)
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_TYPE_NAME = re.compile(r"[A-Za-z]\w*/[A-Za-z]\w*/[A-Za-z]\w*", re.ASCII)


class UnreadableType(ValueError):
    """A text or description is no readable definition of a type."""


class FieldShape(Enum):
    """Whether a field is one value, an array of fixed length, or a sequence."""

    ONE = "one"
    ARRAY = "array"
    SEQUENCE = "sequence"


@dataclass(frozen=True, slots=True)
class Field:
    """A field of a type; `type_name` is a built-in type or `pkg/T`.

    `length` is the length of an array or the bound of a sequence, None for an unbounded sequence or
    a single value. `text_bound` is the bound of a string, None if it is unbounded.
    """

    name: str
    type_name: str
    shape: FieldShape = FieldShape.ONE
    length: int | None = None
    text_bound: int | None = None

    @property
    def is_message(self) -> bool:
        """Whether its values are messages."""
        return self.type_name not in BUILT_IN

    @property
    def is_text(self) -> bool:
        """Whether its values are texts."""
        return self.type_name in (TEXT, WIDE_TEXT)

    @property
    def item(self) -> Field:
        """The field of one item of this array or sequence."""
        return Field(self.name, self.type_name, text_bound=self.text_bound)

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
    """The fields of a type and of all types that it needs, with `root` first in `types`."""

    root: str
    types: Mapping[str, tuple[Field, ...]]
    leaf_counts: Mapping[str, int]
    """The number of leaves in a message of each type, at least 1."""

    def leaf_count(self, field: Field) -> int:
        """Return the number of leaves of a field: numbers, texts, empty messages, unsplit lists."""
        one = self.leaf_counts[field.type_name] if field.is_message else 1
        if field.shape is FieldShape.ONE:
            return one
        return one * (field.length or 0) if self.is_split(field) else 1

    def is_split(self, field: Field) -> bool:
        """Return whether each element of `field` has its own leaves, as in a short fixed array."""
        if field.shape is not FieldShape.ARRAY or NUMBERS.get(field.type_name) == BYTE:
            return False
        return self.leaf_count(field.item) * (field.length or 0) <= MAX_SPLIT

    @property
    def text(self) -> str:
        """The definition as ros2msg text, without comments, constants and defaults."""
        return ros2msg(
            {
                name: "".join(f"{field.type_text} {field.name}\n" for field in fields)
                for name, fields in self.types.items()
            }
        )


def short_type(type_name: str) -> str:
    """Return `pkg/T` of `pkg/msg/T`, `pkg/srv/T` or `pkg/action/T`."""
    package, _, rest = type_name.partition("/")
    return f"{package}/{rest.rpartition('/')[2]}"


def ros2msg(texts: Mapping[str, str]) -> str:
    """Return the text of a type and its dependencies in the form of rosbag2.

    `texts` maps `pkg/T` to its .msg text, the type itself first.
    """
    (_, own), *others = texts.items()
    parts = [own, *(f"{'=' * 80}\nMSG: {name}\n{text}" for name, text in others)]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def parse_definition(type_name: str, text: str) -> Definition:
    """Return the definition of a type from its ros2msg text.

    Raises:
        UnreadableType: A limit is exceeded, a line is not a field, or a type is missing or invalid.
    """
    if len(text) > MAX_BYTES or len(text.encode(errors="replace")) > MAX_BYTES:
        raise UnreadableType(f"its text is longer than {MAX_BYTES} bytes")
    own, *others = _SEPARATOR.split(text, MAX_TYPES)
    if len(others) >= MAX_TYPES:
        raise UnreadableType(f"it has more than {MAX_TYPES} types")
    root = short_type(type_name)
    types = {root: tuple(fields_in(root, own, MAX_FIELDS))}
    room = MAX_FIELDS - len(types[root])
    for part in others:
        head, _, body = part.partition("\n")
        name = short_type(head.removeprefix("MSG: ").strip())
        fields = tuple(fields_in(name, body, room))
        room -= len(fields)
        types.setdefault(name, fields)
    return _checked(root, types)


def fields_in(owner: str, text: str, most: int) -> Iterator[Field]:
    """Yield the fields in `text`, the content of the .msg file of the type `owner` (`pkg/T`).

    Raises:
        UnreadableType: A line is no field, or there are more than `most` fields.
    """
    package = owner.partition("/")[0]
    for line in text.splitlines():
        line = line.partition("#")[0]
        if not line.strip():
            continue
        match = _FIELD.match(line)
        if match is None or (match["text_bound"] and match["type"] not in (TEXT, WIDE_TEXT)):
            raise UnreadableType(f"{owner} has a line that is no field: {line.strip()[:80]!r}")
        if match["constant"]:
            continue
        if (most := most - 1) < 0:
            raise UnreadableType(f"it has more than {MAX_FIELDS} fields")
        type_name, shape = match["type"], FieldShape.ONE
        if type_name not in BUILT_IN:
            type_name = short_type(type_name if "/" in type_name else f"{package}/{type_name}")
        if match["array"]:
            is_array = match["length"] and not match["upper"]
            shape = FieldShape.ARRAY if is_array else FieldShape.SEQUENCE
        length, text_bound = (
            _length(int(digits[:20])) if digits else None
            for digits in (match["length"], match["text_bound"])
        )
        yield Field(match["name"], type_name, shape, length, text_bound)


def _length(length: object) -> int:
    """Return a length or bound from 1 to MAX_LENGTH; may raise UnreadableType."""
    if not isinstance(length, int) or not 0 < length <= MAX_LENGTH:
        raise UnreadableType(f"a length of {str(length)[:20]} is not in 1 to {MAX_LENGTH}")
    return length


def _checked(root: str, all_types: Mapping[str, tuple[Field, ...]]) -> Definition:
    """Return the definition of `root` with the types that it needs, out of `all_types`.

    Raises:
        UnreadableType: A type is missing, contains itself or has two fields of one name, types are
            nested more than MAX_DEPTH deep, or a message has more than MAX_LEAVES leaves.
    """
    types: dict[str, tuple[Field, ...]] = {}
    depths: dict[str, int] = {}
    leaf_counts: dict[str, int] = {}
    definition = Definition(root, types, leaf_counts)

    def add(name: str) -> None:
        fields = types[name] = all_types[name]
        if len({field.name for field in fields}) < len(fields):
            raise UnreadableType(f"{name} has two fields of the same name")
        inner = [field.type_name for field in fields if field.is_message]
        for each in inner:
            if each not in all_types:
                raise UnreadableType(f"{name} needs {each}, which is not described")
            if each not in types:
                add(each)
            elif each not in depths:
                raise UnreadableType(f"{each} contains itself")
        depths[name] = 1 + max(map(depths.__getitem__, inner), default=0)
        if depths[name] > MAX_DEPTH:
            raise UnreadableType(f"more than {MAX_DEPTH} types contain each other")
        leaf_counts[name] = max(sum(map(definition.leaf_count, fields)), 1)
        if leaf_counts[name] > MAX_LEAVES:
            raise UnreadableType(f"a message of type {name} has more than {MAX_LEAVES} leaves")

    add(root)
    return definition


_NESTED: Final = 1
_NAMES_OF_TYPES: Final = {number: name for name, (_, number) in BUILT_IN.items() if name != "char"}
_BOUNDED_TEXT: Final = 4
_SHAPE: Final = 48
"""A type's number plus 1, 2 or 3 times this stands for an array, a bounded or an unbounded sequence
of that type."""

_EMPTY: Final = (Field("structure_needs_at_least_one_member", "uint8"),)
"""The field that ROS adds to a type without fields."""


def rihs01_hash(type_name: str, definition: Definition) -> str:
    """Return the RIHS01 hash of a type `pkg/msg/T`, `pkg/srv/T` or `pkg/action/T`."""
    text = json.dumps(description_of(type_name, definition))
    return f"RIHS01_{sha256(text.encode()).hexdigest()}"


def description_of(type_name: str, definition: Definition) -> dict[str, Any]:
    """Return the TypeDescription of `pkg/msg/T`, `pkg/srv/T` or `pkg/action/T` as JSON values."""
    package, _, rest = type_name.partition("/")
    own_kind = rest.partition("/")[0]

    def full(short: str) -> str:
        owner, _, name = short.partition("/")
        is_implied = owner == package and "_" in name  # by a service or action: T_Request
        return f"{owner}/{own_kind if is_implied else 'msg'}/{name}"

    def described(field: Field) -> dict[str, Any]:
        kind, length = field.type_name, field.length
        number = _NESTED if field.is_message else BUILT_IN[kind][1]
        if field.text_bound is not None:
            number += _BOUNDED_TEXT
        if field.shape is FieldShape.SEQUENCE and length is None and kind == WIDE_TEXT:
            length = field.text_bound  # as rosidl does, by mistake
        if field.shape is FieldShape.ARRAY:
            number += _SHAPE
        elif field.shape is FieldShape.SEQUENCE:
            number += _SHAPE * (3 if length is None else 2)
        return {
            "name": field.name,
            "type": {
                "type_id": number,
                "capacity": length or 0,
                "string_capacity": field.text_bound or 0,
                "nested_type_name": full(field.type_name) if field.is_message else "",
            },
        }

    def one(name: str, fields: tuple[Field, ...]) -> dict[str, Any]:
        return {"type_name": name, "fields": [described(field) for field in fields or _EMPTY]}

    others = sorted((full(name), name) for name in definition.types if name != definition.root)
    return {
        "type_description": one(type_name, definition.types[definition.root]),
        "referenced_type_descriptions": [one(name, definition.types[key]) for name, key in others],
    }


def read_description(type_name: str, description: Mapping[str, Any]) -> Definition:
    """Return the definition of `type_name` from a description of it, or of a type that needs it.

    Raises:
        UnreadableType: The description is malformed, exceeds a limit or lacks a type, or ros2msg
            cannot express it (long double, fixed strings).
    """
    try:
        known = [description["type_description"], *description["referenced_type_descriptions"]]
        if len(known) > MAX_TYPES:
            raise UnreadableType(f"it has more than {MAX_TYPES} types")
        if sum(len(each["fields"]) for each in known) > MAX_FIELDS:
            raise UnreadableType(f"it has more than {MAX_FIELDS} fields")
        types = {
            _known_name(each["type_name"]): tuple(map(_described_field, each["fields"]))
            for each in known
        }
        return _checked(short_type(type_name), types)
    except (LookupError, TypeError, AttributeError) as error:
        raise UnreadableType(f"its description is not in the form of ROS: {error!r:.80}") from None


def _described_field(described: Mapping[str, Any]) -> Field:
    name, kind = described["name"], described["type"]
    if not _NAME.fullmatch(name):
        raise UnreadableType(f"{name[:80]!r} is no name of a field")
    shape, number = divmod(kind["type_id"], _SHAPE)
    text_bound = None
    if _NAMES_OF_TYPES.get(number - _BOUNDED_TEXT) in (TEXT, WIDE_TEXT):
        number -= _BOUNDED_TEXT
        text_bound = _length(kind["string_capacity"])
    if number == _NESTED:
        type_name = _known_name(kind["nested_type_name"])
    elif number in _NAMES_OF_TYPES:
        type_name = _NAMES_OF_TYPES[number]
    else:
        raise UnreadableType(f"the type of {name}, number {kind['type_id']}, has no ros2msg text")
    length = _length(kind["capacity"]) if shape in (1, 2) else None
    shapes = (FieldShape.ONE, FieldShape.ARRAY, FieldShape.SEQUENCE, FieldShape.SEQUENCE)
    return Field(name, type_name, shapes[shape], length, text_bound)


def _known_name(type_name: str) -> str:
    if not _TYPE_NAME.fullmatch(type_name):
        raise UnreadableType(f"{type_name[:80]!r} is no name of a type")
    return short_type(type_name)
