"""Whether a value is allowed for a key of the configuration."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import Enum
from reprlib import repr as short_repr
from typing import Any

from robotctl.errors import ConfigError
from robotctl.kernel.fence import corners_of
from robotctl.kernel.ranges import Range

_TOPIC = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_FRAME = re.compile(r"[A-Za-z0-9_/]{1,200}")
_PATTERN = re.compile(r"(?:type:|(?=[/*?\[]))[A-Za-z0-9_/*?!\[\]-]{1,300}")
MAX_RATE_HZ = 1e5
RATES_HELP = 'use topics, globs or types with rates, such as {"/camera/*": 5}'
MAX_GROUP_NAME = 256
"""Longer than a name of group(5) or of a directory service."""

PATTERN_HELP = "a topic (/scan), a glob (/camera/*) or a type (type:sensor_msgs/msg/Image)"


def checked_value(key: str, value: object, kind: Any, metadata: Mapping[str, Any]) -> object:
    """Return `value` in the type of its field, if it is allowed for `key`.

    Raises:
        ConfigError: The value is not allowed; the error says what is.
    """
    if kind == tuple[str, ...]:
        return (_checked_rates if metadata.get("rates") else _checked_patterns)(key, value)
    if issubclass(kind, Enum):
        choices = {member.value: member for member in kind}
        # 100 and true are no text in YAML.
        if type(value) in (str, int, bool) and (text := str(value).lower()) in choices:
            return choices[text]
        raise not_allowed(key, value, f"use {', '.join(choices)}")
    if kind is float:
        low, high, unit = metadata.get("range", Range(-1e12, 1e12))
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise not_allowed(key, value, f"use a number from {low:g} to {high:g} {unit}".rstrip())
        if not low <= value <= high:  # NaN is refused, too
            raise not_allowed(key, value, f"use {low:g} to {high:g} {unit}".rstrip())
        return float(value)
    if "choices" in metadata and value not in metadata["choices"]:
        raise not_allowed(key, value, f"use {', '.join(metadata['choices'])}")
    if metadata.get("topic") and not _is_topic(value, optional=metadata["optional"]):
        none = ', or "" for none' if metadata["optional"] else ""
        raise not_allowed(key, value, f"use the name of a ROS topic, such as /a/b{none}")
    if metadata.get("frame") and not _is_frame(value, optional=metadata["optional"]):
        none = ', or "" for any' if metadata["optional"] else ""
        raise not_allowed(key, value, f"use the name of a frame, such as base_link{none}")
    if metadata.get("group") and not _is_group(value):
        raise not_allowed(key, value, 'use the name of a Unix group, or "" for none')
    if metadata.get("corners") and not _are_corners(value):
        raise not_allowed(key, value, "use 3 to 64 corners, such as 0,0 2,0 2,1")
    if type(value) is not kind:
        names = {int: "a whole number", str: "text", bool: "true or false"}
        raise not_allowed(key, value, f"use {names[kind]}")
    if isinstance(value, int) and "range" in metadata:
        low, high, _ = metadata["range"]
        if not low <= value <= high:
            raise not_allowed(key, value, f"use {low} to {high}")
    return value


def _is_group(value: object) -> bool:
    return isinstance(value, str) and value.isprintable() and len(value) <= MAX_GROUP_NAME


def _are_corners(value: object) -> bool:
    try:
        return isinstance(value, str) and len(corners_of(value)) >= 0
    except ValueError:
        return False


def _checked_patterns(key: str, value: object) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise not_allowed(key, value, f"use a list, each {PATTERN_HELP}")
    for pattern in value:
        if not is_topic_pattern(pattern):
            raise not_allowed(key, pattern, f"use {PATTERN_HELP}")
    return tuple(value)


def _checked_rates(key: str, value: object) -> tuple[str, ...]:
    """Return rates by topic as PATTERN=RATE; a file may give them as a mapping."""
    if isinstance(value, dict):
        value = [f"{pattern}={rate}" for pattern, rate in value.items()]
    if not isinstance(value, list):
        raise not_allowed(key, value, RATES_HELP)
    for each in value:
        pattern, _, rate = each.rpartition("=") if isinstance(each, str) else ("", "", "")
        if not (is_topic_pattern(pattern) and _is_rate(rate)):
            raise not_allowed(key, each, RATES_HELP)
    return tuple(value)


def _is_rate(text: str) -> bool:
    try:
        return 0.0 <= float(text) <= MAX_RATE_HZ
    except ValueError:
        return False


def is_topic_pattern(value: object) -> bool:
    """Return whether the value is a topic, glob or type that can select topics."""
    return isinstance(value, str) and _PATTERN.fullmatch(value) is not None


def _is_topic(value: object, *, optional: bool) -> bool:
    if not isinstance(value, str):
        return False
    if not value:
        return optional
    return _TOPIC.fullmatch(value) is not None and "__" not in value and len(value) <= 200


def not_allowed(key: str, value: object, allowed: str) -> ConfigError:
    """Return the error for a value that is not allowed, with what is."""
    return ConfigError(f"{key}: {short_repr(value)} is not allowed", allowed)


def _is_frame(value: object, *, optional: bool) -> bool:
    return isinstance(value, str) and bool(_FRAME.fullmatch(value) or (optional and not value))
