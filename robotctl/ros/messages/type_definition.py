"""Definitions and hashes of ROS types; a recording that has them is readable without the types.

A description is the JSON form of type_description_interfaces/msg/TypeDescription: fields with the
numbers of FieldType.msg, without comments and constants.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rclpy.qos import QoSProfile

from robotctl.ros.messages import qos
from robotctl.ros.messages.classes import UnusableType, parse_type_name

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
"""In FieldType.msg, the number of a type plus 1, 2 or 3 times this value stands for an array, a
bounded sequence or an unbounded sequence of that type."""


def texts_of(type_name: str, described: Mapping[str, Any]) -> dict[str, str]:
    """Return `pkg/T` -> ros2msg text for a type and each of its dependencies, depth first.

    `described` is a description; `type_name` is its root type or one of its referenced types.

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


_SEPARATOR = "=" * 80
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+")
_BYTES = re.compile(r"^\s*(?:u?int8|byte|char)\[\]\s", re.MULTILINE)
_BUILT_IN = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
_UNKNOWN = (OSError, PackageNotFoundError, UnusableType, ValueError, KeyError)
"""The exceptions for a type that is not installed, or whose files are not those of Jazzy."""


@lru_cache(maxsize=1024)
def definition_of(type_name: str) -> str:
    """Return the ros2msg text of a type and its dependencies, "" if it is not installed.

    The form is rosbag2's: the type's own text, then each dependency once, depth first, after a
    line of 80 "=" and a line `MSG: pkg/T`. The text of `pkg/msg/T` is its .msg file. Types that
    services and actions imply have no such file; their text is made from their fields.
    """
    try:
        name = parse_type_name(type_name)
        if name.kind == "msg":
            texts = _texts_of_message(f"{name.package}/{name.short}")
        else:
            texts = texts_of(type_name, _described(type_name)["type_description_msg"])
    except _UNKNOWN:
        return ""
    (_, own), *others = texts.items()
    parts = [own, *(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


@lru_cache(maxsize=1024)
def holds_bytes(type_name: str) -> bool:
    """Return whether a type has an unbounded array of bytes, as images and point clouds do."""
    return _BYTES.search(definition_of(type_name)) is not None


@lru_cache(maxsize=1024)
def type_hash_of(type_name: str) -> str:
    """Return the RIHS01 hash of a type, "" if the type is not installed."""
    try:
        for entry in _described(type_name)["type_hashes"]:
            if entry["type_name"] == type_name:
                return str(entry["hash_string"])
    except _UNKNOWN:
        pass
    return ""


def _texts_of_message(root: str) -> dict[str, str]:
    found: dict[str, str] = {}

    def collect(name: str) -> None:
        package, _, short = name.partition("/")
        text = _interface_file(package, "msg", f"{short}.msg")
        found[name] = text
        for line in text.splitlines():
            match = _FIELD.match(line.partition("#")[0])
            if match is None or match[1] in _BUILT_IN:
                continue
            dependency = match[1] if "/" in match[1] else f"{package}/{match[1]}"
            if dependency not in found:
                collect(dependency)

    collect(root)
    return found


def _described(type_name: str) -> Any:
    name = parse_type_name(type_name)
    return json.loads(_interface_file(name.package, name.kind, f"{name.interface}.json"))


def _interface_file(package: str, kind: str, name: str) -> str:
    return (Path(get_package_share_directory(package)) / kind / name).read_text(encoding="utf-8")


@dataclass(frozen=True, slots=True)
class TopicDescription:
    """A topic's full name, its type with definition and hash, and its publishers' QoS as YAML."""

    name: str
    type_name: str
    definition: str
    type_hash: str
    offered_qos: str


def describe(name: str, type_name: str, offered: Iterable[QoSProfile]) -> TopicDescription:
    """Describe a topic by its full name, its type and the profiles that its publishers offer."""
    return TopicDescription(
        name, type_name, definition_of(type_name), type_hash_of(type_name), qos.to_yaml(offered)
    )
