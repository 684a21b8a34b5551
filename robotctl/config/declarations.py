"""Each key of the configuration as a declared parameter: its type, its range, when it changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cache
from typing import Any

from robotctl.config.schema import Config
from robotctl.config.settings import as_in_file, keyed_leaves
from robotctl.kernel.parameters import value_at
from robotctl.kernel.ranges import Change, Range

FileValue = bool | int | float | str | list[str]
"""A value in the form that a file uses."""


class Kind(Enum):
    """The type of a value."""

    BOOLEAN = "boolean"
    INTEGER = "whole number"
    NUMBER = "number"
    TEXT = "text"
    TEXTS = "texts"


_KINDS = {bool: Kind.BOOLEAN, int: Kind.INTEGER, float: Kind.NUMBER, str: Kind.TEXT}


@dataclass(frozen=True, slots=True)
class Declaration:
    """One parameter; `range` holds the allowed numbers, None where there is no limit."""

    key: str
    kind: Kind
    default: FileValue
    about: str
    allowed: str
    change: Change
    range: Range | None


@cache
def declarations() -> Mapping[str, Declaration]:
    """Return the declaration of every key, in the order of the schema."""
    config = Config()
    found = {}
    for key, leaf in keyed_leaves(config):
        value, metadata = value_at(config, leaf.path), leaf.declared.metadata
        default: Any = as_in_file(value)
        found[key] = Declaration(
            key,
            _KINDS.get(type(default), Kind.TEXTS),
            default,
            metadata["about"],
            _allowed(value, metadata),
            metadata["change"],
            metadata.get("range"),
        )
    return found


def _allowed(value: object, metadata: Mapping[str, Any]) -> str:
    """Return the allowed values in words."""
    limits = metadata.get("range")
    if limits is not None:
        return f"{limits.low:g} to {limits.high:g} {limits.unit}".rstrip()
    if isinstance(value, Enum):
        return ", ".join(member.value for member in type(value))
    if "choices" in metadata:
        return ", ".join(metadata["choices"])
    if metadata.get("rates"):
        return "topics, globs, types, each with a rate"
    if metadata.get("corners"):
        return '3 to 64 corners; "" for none'
    if metadata.get("topic"):
        return 'a topic; "" for none' if metadata["optional"] else "a topic"
    if metadata.get("command"):
        return 'a command line; "" for none'
    if metadata.get("group"):
        return 'a Unix group; "" for none'
    if metadata.get("frame"):
        return 'the name of a frame; "" for any' if metadata["optional"] else "the name of a frame"
    if isinstance(value, bool):
        return "true, false"
    return "a whole number" if isinstance(value, int) else "a list of topics, globs, types"
