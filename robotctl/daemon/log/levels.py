"""The levels of the daemon's loggers, by the names that they have on ROS."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Final

from robotctl.base.ros_arguments import LEVELS, UNSET, LogLevel, level_name
from robotctl.base.text import printable

PACKAGE: Final = "robotctl"
"""The parent of the loggers of all our modules."""

MAX_NAMES: Final = 200
"""Different names that get a level; Python forgets none, and any process on ROS may invent them."""

MAX_NAME_LENGTH: Final = 256

_log = logging.getLogger(__name__)
_log.setLevel(logging.INFO)  # a change is told also while nothing else is


class LoggerLevels:
    """The levels of Python's loggers; `own` is the name on ROS for those of our modules."""

    def __init__(self, own: str) -> None:
        self.own = own
        self.named: set[str] = set()
        """The names that got a level."""

    def name_of(self, logger: str) -> str:
        """Return the name on ROS of a logger of Python."""
        return self.own if logger == PACKAGE or logger.startswith(f"{PACKAGE}.") else logger

    def get(self, name: str) -> int:
        """Return the level that a logger has of its own: a number of ROS, 0 where it has none."""
        if name == "":
            return LEVELS[level_name(logging.getLogger().level)]
        logger = logging.root.manager.loggerDict.get(self._python_name(name))
        level = logger.level if isinstance(logger, logging.Logger) else UNSET
        return {"UNSET": UNSET, **LEVELS}[level_name(level)]

    def refusal(self, name: str, level: int) -> str:
        """Return why a level cannot be set, "" where it can."""
        if level not in (UNSET, *LEVELS.values()):
            return "Failed reason: Invalid logger level."  # the words of rclpy
        if len(name) > MAX_NAME_LENGTH:
            return f"a name of a logger has at most {MAX_NAME_LENGTH} characters"
        if name not in self.named and len(self.named) >= MAX_NAMES:
            return f"{MAX_NAMES} loggers have a level already: set one of those"
        return ""

    def set(self, name: str, level: int, source: str) -> None:
        """Set a level that is not refused, and log by whom it was changed.

        An unset level of the root, whose name is "", is INFO, as in rcutils.
        """
        before = self.get(name)
        if name == "" and level == UNSET:
            level = logging.INFO
        if level == before:
            return
        self.named.add(name)
        logging.getLogger(self._python_name(name)).setLevel(level)
        _log.info(
            "log level of %s: %s -> %s, by %s",
            printable(name) or "all loggers",
            level_name(before),
            level_name(level),
            source,
        )

    def apply(self, levels: Iterable[LogLevel]) -> None:
        """Set the levels of a command line."""
        for each in levels:
            if not self.refusal(each.logger, each.level):
                self.set(each.logger, each.level, "the command line")

    def _python_name(self, name: str) -> str:
        return PACKAGE if name == self.own else name
