"""The declaration of a parameter with default, range and time of change."""

from __future__ import annotations

from dataclasses import field
from enum import Enum
from typing import Any, NamedTuple


class Range(NamedTuple):
    """The smallest and the largest allowed value, and their unit."""

    low: float
    high: float
    unit: str = ""


class Change(Enum):
    """When a parameter may get a new value: while the robot stands, at any time, or at a start."""

    STANDING = "while the robot stands"
    ANY_TIME = "at any time"
    START = "at a start"


def setting(default: Any, about: str, change: Change = Change.STANDING, **metadata: Any) -> Any:
    """Return a dataclass field with the `default`, and all other arguments as its metadata."""
    return field(default=default, metadata={"about": about, "change": change, **metadata})


def bounded(
    default: float,
    low: float,
    high: float,
    unit: str = "",
    about: str = "",
    change: Change = Change.STANDING,
) -> Any:
    """Return a dataclass field for a number, with its `Range` in the metadata."""
    return setting(default, about, change, range=Range(low, high, unit))


def topic(default: str, about: str, *, optional: bool = False) -> Any:
    """Return a dataclass field for a parameter that names a ROS topic; "" only if `optional`."""
    return setting(default, about, Change.START, topic=True, optional=optional)


def frame(default: str, about: str, *, optional: bool = False) -> Any:
    """Return a dataclass field for a parameter that names a frame; "" only if `optional`."""
    return setting(default, about, Change.START, frame=True, optional=optional)
