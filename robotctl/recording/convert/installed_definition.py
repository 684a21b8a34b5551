"""The definition of a message type in ros2msg, from the .msg files that are installed."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from typing import Final

from robotctl.messages.definition import UnreadableType, needed_types, short_type

_PREFIXES: Final = "AMENT_PREFIX_PATH"
_SEPARATOR: Final = "=" * 80
_NAME = re.compile(r"([A-Za-z]\w*)/msg/([A-Za-z]\w*)")


def installed_definition(type_name: str, type_hash: str) -> str:
    """Return the text of the type `pkg/msg/T` and of what it needs, as rosbag2 writes it, or "".

    It is "" if a .msg file is missing, or if the installed type has another hash than `type_hash`,
    unless that is "".
    """
    texts: dict[str, str] = {}
    try:
        known = _collect(type_name, texts) and _has_hash(type_name, type_hash)
    except (OSError, UnreadableType):
        known = False
    if not known:
        return ""
    (_, own), *others = texts.items()
    parts = [own, *(f"{_SEPARATOR}\nMSG: {short_type(name)}\n{text}" for name, text in others)]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def _collect(type_name: str, texts: dict[str, str]) -> bool:
    """Add the texts of a type and of what it needs, depth first; return whether all are there."""
    if type_name in texts:
        return True
    path = _installed(type_name, ".msg")
    if path is None:
        return False
    texts[type_name] = text = path.read_text(encoding="utf-8", errors="replace")
    needed = (each.replace("/", "/msg/") for each in needed_types(short_type(type_name), text))
    return all(_collect(each, texts) for each in needed)


def _has_hash(type_name: str, type_hash: str) -> bool:
    path = _installed(type_name, ".json")
    if not type_hash or path is None:
        return True
    try:
        told = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
        hashes = {each["type_name"]: each["hash_string"] for each in told}
    except (ValueError, KeyError, TypeError):
        return False
    return bool(hashes.get(type_name) == type_hash)


def _installed(type_name: str, suffix: str) -> Path | None:
    match = _NAME.fullmatch(type_name)
    if match is None:
        return None
    prefixes = [each for each in os.environ.get(_PREFIXES, "").split(os.pathsep) if each]
    for prefix in (*prefixes, sys.prefix):
        path = Path(prefix) / "share" / match[1] / "msg" / f"{match[2]}{suffix}"
        if path.is_file():
            return path
    return None
