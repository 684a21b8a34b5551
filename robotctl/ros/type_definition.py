"""The text and the hash of a ROS type, as a recording needs them to stand alone."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

_SEPARATOR = "=" * 80
_FIELD = re.compile(r"^\s*([A-Za-z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+\w+")
_BUILT_IN = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)


@lru_cache(maxsize=1024)
def definition_of(type_name: str) -> str:
    """Return the ros2msg text of `pkg/msg/T` with all that it needs, "" where it has no .msg file.

    In rosbag2's form: the type's own text, then its dependencies depth first, each once, after a
    line of 80 "=" and `MSG: pkg/T`.
    """
    found: dict[str, str] = {}

    def collect(name: str) -> None:
        package, _, short = name.partition("/")
        text = _message_file(package, short, ".msg")
        found[name] = text
        for line in text.splitlines():
            match = _FIELD.match(line.partition("#")[0])
            if match is None or match[1] in _BUILT_IN:
                continue
            dependency = match[1] if "/" in match[1] else f"{package}/{match[1]}"
            if dependency not in found:
                collect(dependency)

    try:
        package, kind, short = type_name.split("/")
        if kind != "msg":
            return ""
        root = f"{package}/{short}"
        collect(root)
    except (OSError, PackageNotFoundError, ValueError):
        return ""
    parts = [found.pop(root)]
    parts += [f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in found.items()]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


@lru_cache(maxsize=1024)
def type_hash_of(type_name: str) -> str:
    """Return the RIHS01 hash of `pkg/msg/T`, "" where the type is not installed."""
    try:
        package, _, short = type_name.split("/")
        described = json.loads(_message_file(package, short, ".json"))
        for entry in described["type_hashes"]:
            if entry["type_name"] == type_name:
                return str(entry["hash_string"])
    except (OSError, PackageNotFoundError, ValueError, KeyError):
        pass
    return ""


def _message_file(package: str, short: str, suffix: str) -> str:
    folder = Path(get_package_share_directory(package)) / "msg"
    return (folder / f"{short}{suffix}").read_text(encoding="utf-8")
