"""The ros2msg texts and RIHS01 hashes of the installed types, read without ROS."""

from __future__ import annotations

import json
import os
import re
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from robotctl.messages.definition import (
    MAX_FIELDS,
    fields_in,
    parse_definition,
    read_description,
    rihs01_hash,
    ros2msg,
)

MAX_TYPE_NAME: Final = 255
"""Limit on the characters of a type name, because of Fast DDS's discovery."""

_CALL = r"(?:_Request|_Response|_Event)?"
_IMPLIED = {
    "msg": "",
    "srv": _CALL,
    "action": rf"(?:_Goal|_Result|_Feedback|_FeedbackMessage|_(?:SendGoal|GetResult){_CALL})?",
}
"""Kind of interface -> pattern of the suffixes of its types, such as `_Request` of a service."""

_TYPE_NAMES = {
    kind: re.compile(rf"([a-z](?:_?[a-z0-9])*)/{kind}/([A-Z][A-Za-z0-9]*){implied}")
    for kind, implied in _IMPLIED.items()
}
"""The type names that rosidl allows (rosidl_adapter.parser)."""

_BYTES = re.compile(r"^\s*(?:u?int8|byte|char)\[\]\s", re.MULTILINE)


class UnusableType(ImportError):
    """A type cannot be used here; the text is a predicate such as "is not installed"."""


class TypeName(NamedTuple):
    """The parts of a type name `package/kind/short`."""

    package: str
    kind: str
    short: str
    interface: str
    """The interface that defines the type, such as `SetMode` of `SetMode_Request`."""


def parse_type_name(type_name: str) -> TypeName:
    """Return `type_name` split into package, kind and name.

    Raises:
        UnusableType: ROS does not allow the name.
    """
    if len(type_name) <= MAX_TYPE_NAME:
        for kind, pattern in _TYPE_NAMES.items():
            if match := pattern.fullmatch(type_name):
                return TypeName(match[1], kind, type_name.rpartition("/")[2], match[2])
    raise UnusableType("is not the name of a ROS type")


class InstalledType(NamedTuple):
    """A type's definition as ros2msg text, and its RIHS01 hash, each "" if unknown."""

    text: str
    type_hash: str

    @property
    def holds_bytes(self) -> bool:
        """Whether the type has an unbounded array of bytes, as images and point clouds do."""
        return _BYTES.search(self.text) is not None


NOT_INSTALLED: Final = InstalledType("", "")


@lru_cache(maxsize=1024)
def installed_type(type_name: str) -> InstalledType:
    """Return text and hash of an installed type, such as `pkg/msg/T` or `pkg/srv/T_Event`."""
    try:
        name = parse_type_name(type_name)
    except UnusableType:
        return NOT_INSTALLED
    try:
        built = json.loads(_file(name.package, name.kind, f"{name.interface}.json"))
        hashes = {each["type_name"]: str(each["hash_string"]) for each in built["type_hashes"]}
    except (OSError, ValueError, LookupError, TypeError):
        built, hashes = {}, {}  # ROS distributions before Iron have no such file
    try:
        text = _text_of(name, built)
        known = hashes.get(type_name) or rihs01_hash(type_name, parse_definition(type_name, text))
    except (OSError, ValueError, LookupError):
        return InstalledType("", hashes.get(type_name, ""))
    return InstalledType(text, known)


def _text_of(name: TypeName, built: dict[str, Any]) -> str:
    """Return the text of a type; `built` is the content of its .json file."""
    if name.kind == "msg":
        texts: dict[str, str] = {}
        _collect(f"{name.package}/{name.short}", texts)
        return ros2msg(texts)
    return read_description("/".join(name[:3]), built["type_description_msg"]).text


def _collect(short: str, texts: dict[str, str]) -> None:
    """Add the .msg text of a type `pkg/T` and, depth first, those of the types that it needs."""
    package, _, name = short.partition("/")
    texts[short] = _file(package, "msg", f"{name}.msg")
    for field in fields_in(short, texts[short], MAX_FIELDS):
        if field.is_message and field.type_name not in texts:
            _collect(field.type_name, texts)


def _file(package: str, kind: str, name: str) -> str:
    prefixes = [each for each in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    for prefix in (*prefixes, sys.prefix):
        path = Path(prefix) / "share" / package / kind / name
        if path.is_file():
            return path.read_text(encoding="utf-8", errors="replace")
    raise FileNotFoundError(f"{package}/{kind}/{name} is not installed")


def installed_name(type_name: str) -> TypeName:
    """Return `type_name` split into package, kind and name, if the type is installed.

    Raises:
        UnusableType: ROS does not allow the name, or the type is not installed.
    """
    name = parse_type_name(type_name)
    if installed_type(type_name) == NOT_INSTALLED:
        raise UnusableType("is not installed")
    return name
