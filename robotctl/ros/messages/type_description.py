"""Texts in ros2msg, made from the type descriptions that rosidl installs.

A description is the JSON form of type_description_interfaces/msg/TypeDescription: fields with the
numbers of FieldType.msg; it has no comments and no constants.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_NESTED = 1
_NAMES = {
    2: "int8",
    3: "uint8",
    4: "int16",
    5: "uint16",
    6: "int32",
    7: "uint32",
    8: "int64",
    9: "uint64",
    10: "float32",
    11: "float64",
    13: "char",
    15: "bool",
    16: "byte",
    17: "string",
    18: "wstring",
    21: "string",
    22: "wstring",
}
_BOUNDED_TEXTS = (21, 22)
_SHAPE = 48
"""The number of a type plus 1, 2 or 3 times this means an array, a bounded or an unbounded sequence
of it."""


def texts_of(type_name: str, described: Mapping[str, Any]) -> dict[str, str]:
    """Return the texts of a type and of its dependencies by `pkg/T`, depth first.

    The description holds `type_name` as its root or as a type that the root refers to.

    Raises:
        KeyError: A type is missing, or ros2msg cannot express it (long double, fixed strings).
    """
    root = described["type_description"]
    known = {each["type_name"]: each for each in described["referenced_type_descriptions"]}
    known[root["type_name"]] = root
    found: dict[str, str] = {}

    def collect(name: str) -> None:
        fields = known[name]["fields"]
        found[_short(name)] = "".join(f"{_type(each['type'])} {each['name']}\n" for each in fields)
        for each in fields:
            needed = each["type"]["nested_type_name"]
            if needed and _short(needed) not in found:
                collect(needed)

    collect(type_name)
    return found


def _short(type_name: str) -> str:
    package, _, short = type_name.split("/")
    return f"{package}/{short}"


def _type(described: Mapping[str, Any]) -> str:
    shape, number = divmod(described["type_id"], _SHAPE)
    capacity = described["capacity"]
    suffix = ("", f"[{capacity}]", f"[<={capacity}]", "[]")[shape]
    if number == _NESTED:
        return _short(described["nested_type_name"]) + suffix
    limit = f"<={described['string_capacity']}" if number in _BOUNDED_TEXTS else ""
    return _NAMES[number] + limit + suffix
