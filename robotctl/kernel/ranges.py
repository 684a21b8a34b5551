"""The allowed values of the configuration, declared together with their defaults."""

from __future__ import annotations

from dataclasses import field
from typing import Any, NamedTuple


class Range(NamedTuple):
    """The smallest and the largest allowed value, and the unit."""

    low: float
    high: float
    unit: str = ""


def bounded(default: float, low: float, high: float, unit: str = "") -> Any:
    """Return a dataclass field with a default, and with its `Range` in the metadata."""
    return field(default=default, metadata={"range": Range(low, high, unit)})


def topic(default: str, *, optional: bool = False) -> Any:
    """Return a dataclass field for the name of a ROS topic; "" is allowed if `optional`."""
    return field(default=default, metadata={"topic": True, "optional": optional})
