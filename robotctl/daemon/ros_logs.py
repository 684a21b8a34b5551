"""The daemon's log on ROS: lines on /rosout, and the services for logger levels."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Final

from robotctl.base.ros_arguments import LEVELS, UNSET, LogLevel, level_name
from robotctl.base.text import printable
from robotctl.daemon.log_lines import LoopHandler
from robotctl.ros.nodes.node_services import LoggerServices, set_native_level
from robotctl.ros.nodes.publishers import RosoutPublisher
from robotctl.ros.session import Session

PACKAGE: Final = "robotctl"
"""The parent of the loggers of all our modules."""

MAX_NAMES: Final = 200
"""Limit on the loggers with a level, as any ROS node may name new ones and Python keeps all."""

MAX_NAME_LENGTH: Final = 256

_log = logging.getLogger(__name__)
_log.setLevel(logging.INFO)  # changes are logged even if all loggers are set higher


class LoggerLevels:
    """Gets and sets Python logger levels by ROS name; all loggers of robotctl are named `own`."""

    def __init__(self, own: str) -> None:
        self.own = own
        self.named: set[str] = set()
        """The ROS names of the loggers that got a level from `set`."""

    def name_of(self, logger: str) -> str:
        """Return the ROS name of a Python logger."""
        return self.own if logger == PACKAGE or logger.startswith(f"{PACKAGE}.") else logger

    def get(self, name: str) -> int:
        """Return the ROS level that is set on this logger itself, 0 if none is set."""
        if name == "":
            return LEVELS[level_name(logging.getLogger().level)]
        logger = logging.root.manager.loggerDict.get(self._python_name(name))
        level = logger.level if isinstance(logger, logging.Logger) else UNSET
        return {"UNSET": UNSET, **LEVELS}[level_name(level)]

    def refusal(self, name: str, level: int) -> str:
        """Return "" if the level can be set, else the reason."""
        if level not in (UNSET, *LEVELS.values()):
            return "Failed reason: Invalid logger level."  # the words of rclpy
        if len(name) > MAX_NAME_LENGTH:
            return f"a name of a logger has at most {MAX_NAME_LENGTH} characters"
        if name not in self.named and len(self.named) >= MAX_NAMES:
            return f"{MAX_NAMES} loggers have a level already: set one of those"
        return ""

    def set(self, name: str, level: int, source: str) -> None:
        """Set a level that `refusal` allows, and log it. UNSET for the root logger means INFO."""
        before = self.get(name)
        if name == "" and level == UNSET:
            level = logging.INFO  # as in rcutils
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

    def change(self, name: str, level: int, source: str) -> str:
        """Set the level of a logger in Python and in rcl; return "" or the reason for a refusal."""
        # rcl's default level stays: at DEBUG, rcl writes two lines for each message.
        refusal = self.refusal(name, level) or (set_native_level(name, level) if name else "")
        if not refusal:
            self.set(name, level, source)
        return refusal

    def apply(self, levels: Iterable[LogLevel]) -> None:
        """Set the levels given on a command line, except those that `refusal` refuses."""
        for each in levels:
            self.change(each.logger, each.level, "the command line")

    def _python_name(self, name: str) -> str:
        return PACKAGE if name == self.own else name


@contextmanager
def published_log(session: Session, levels: LoggerLevels) -> Iterator[None]:
    """Publish the log on /rosout within the block; used in the loop's thread."""
    publisher = RosoutPublisher(session)

    def publish(record: logging.LogRecord, text: str) -> None:
        level = LEVELS.get(level_name(record.levelno), LEVELS["DEBUG"])
        publisher.publish(record, level, levels.name_of(record.name), text)

    handler = LoopHandler(asyncio.get_running_loop(), publish)
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)
        handler.close()


def serve_logger_levels(session: Session, levels: LoggerLevels) -> None:
    """Add the services that get and set logger levels to each visible node."""
    for node in session.visible_nodes.values():
        LoggerServices(node, levels.get, levels.change)
