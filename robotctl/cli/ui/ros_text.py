"""Names and messages of ROS as text, as `ros2` prints them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Any, Final

from robotctl.cli.ui.output import print_answer
from robotctl.cli.ui.text import printable


def is_hidden(name: str) -> bool:
    """Return whether ROS tools hide this name: a part of it begins with an underscore."""
    return "/_" in name


def print_names(graph: Any, kind: str, *, every: bool, as_json: bool, types: bool = False) -> None:
    """Print the names in a ROS graph; `kind` is "topics", "services" or "nodes"."""
    found = [(each if kind == "nodes" else each["name"], each) for each in graph[kind]]
    listed = [(name, each) for name, each in found if every or not is_hidden(name)]
    lines = [printable(name) for name, _ in listed]
    if types:
        kinds = (", ".join(map(printable, each["types"])) for _, each in listed)
        lines = [f"{line} [{kind}]" for line, kind in zip(lines, kinds, strict=True)]
    if graph["left_out"]:
        lines.append(f"and {graph['left_out']} more")
    print_answer({kind: [each for _, each in listed]}, lines, as_json=as_json)


SHOWN_LENGTH: Final = 128
"""The maximum number of items of a list or characters of a text, as in `ros2 topic echo`."""

_CUT: Final = "..."
_PLAIN = re.compile(r"[A-Za-z_/][A-Za-z0-9_/]*")
"""Texts that every YAML parser reads as text, except the words below."""

_WORDS = frozenset({"true", "false", "yes", "no", "on", "off", "null", "y", "n"})


def message_lines(value: Any, limit: int | None = SHOWN_LENGTH) -> Iterator[str]:
    """Yield a ROS message, or a field of a message, as lines of YAML.

    At most `limit` items of a list or characters of a text are shown; None shows all.
    """
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            lines = message_lines(inner, limit)
            if inner and (isinstance(inner, Mapping) or _is_list(inner)):
                indent = "  " if isinstance(inner, Mapping) else ""
                yield f"{name}:"
                yield from (f"{indent}{line}" for line in lines)
            else:
                yield f"{name}: {next(lines)}"
    elif _is_list(value) and value:
        for item in value[:limit]:
            first, *others = message_lines(item, limit)
            yield f"- {first}"
            yield from (f"  {line}" for line in others)
        if limit is not None and len(value) > limit:
            yield f"- '{_CUT}'"
    else:
        yield _scalar(value, limit)


def _is_list(value: Any) -> bool:
    return isinstance(value, list | bytes)


def _scalar(value: Any, limit: int | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, str):
        cut = limit is not None and len(value) > limit
        return _text(value[:limit] + _CUT if cut else value)
    if isinstance(value, Mapping):
        return "{}"
    return "[]" if _is_list(value) else str(value)


def _number(value: float) -> str:
    if not isfinite(value):
        return ".nan" if value != value else ".inf" if value > 0 else "-.inf"
    text = repr(value)
    mantissa, sign, exponent = text.partition("e")
    return f"{mantissa}.0e{exponent}" if sign and "." not in mantissa else text


def _text(text: str) -> str:
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    if text.isprintable():
        return "'" + text.replace("'", "''") + "'"
    escaped = json.dumps(text, ensure_ascii=False)
    return "".join(each if each.isprintable() else printable(each) for each in escaped)


def plain_json(value: Any) -> Any:
    """Return a message as JSON values: NaN and infinity become null, bytes a list of numbers."""
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: plain_json(inner) for name, inner in value.items()}
    return [plain_json(inner) for inner in value] if _is_list(value) else value
