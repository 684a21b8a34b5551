"""What a value of the configuration may be, kept beside its default."""

from __future__ import annotations

from dataclasses import field
from typing import Any, NamedTuple


class Range(NamedTuple):
    """What a number may be, both ends included."""

    low: float
    high: float
    unit: str = ""


def bounded(default: float, low: float, high: float, unit: str = "") -> Any:
    """Make a dataclass field whose metadata holds the Range that a configuration must respect."""
    return field(default=default, metadata={"range": Range(low, high, unit)})


def topic(default: str, *, optional: bool = False) -> Any:
    """Make a dataclass field for the name of a ROS topic; "" means none where it is `optional`."""
    return field(default=default, metadata={"topic": True, "optional": optional})
