"""The levels of log lines, by the names and numbers that ROS gives them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from robotctl.errors import UsageError

LEVELS: Final = {"DEBUG": 10, "INFO": 20, "WARN": 30, "ERROR": 40, "FATAL": 50}
"""The numbers of rcl_interfaces/msg/Log, which are also those of `logging`."""

UNSET: Final = 0
"""The level of a logger that takes the level of its parent."""


@dataclass(frozen=True, slots=True)
class LogLevel:
    """A level for a logger; `logger` is "" for all that have no level of their own."""

    logger: str
    level: int


def read_log_level(text: str) -> LogLevel:
    """Return the meaning of a `--log-level LEVEL` or `--log-level LOGGER:=LEVEL`.

    Raises:
        UsageError: The text has another form, or there is no such level.
    """
    logger, sign, name = text.rpartition(":=")
    level = LEVELS.get(name.upper())
    if level is None or (sign and not logger.strip()):
        names = ", ".join(LEVELS).lower()
        raise UsageError(f"--log-level {text!r} is not allowed", f"use {names}, or LOGGER:=LEVEL")
    return LogLevel(logger.strip(), level)


def level_name(level: int) -> str:
    """Return the name of the highest ROS level up to this one, "UNSET" below all."""
    return max((each, name) for name, each in {"UNSET": UNSET, **LEVELS}.items() if each <= level)[
        1
    ]
