"""The daemon's log on ROS: lines on /rosout, and the services for the levels of its loggers."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from contextlib import contextmanager

from robotctl.base.ros_arguments import LEVELS, LogLevel, level_name
from robotctl.daemon.log.levels import LoggerLevels
from robotctl.daemon.log.loop_handler import LoopHandler
from robotctl.ros.nodes.node_services import LoggerServices, set_native_level
from robotctl.ros.nodes.publishers import RosoutLine, RosoutPublisher
from robotctl.ros.session import Session


@contextmanager
def published_log(session: Session, levels: LoggerLevels) -> Iterator[None]:
    """Publish the log on /rosout within the block; used in the loop's thread."""
    publisher = RosoutPublisher(session)

    def publish(record: logging.LogRecord, text: str) -> None:
        publisher.publish(
            RosoutLine(
                t_ns=round(record.created * 1e9),
                level=LEVELS.get(level_name(record.levelno), LEVELS["DEBUG"]),
                logger=levels.name_of(record.name),
                text=text,
                file=record.pathname,
                function=record.funcName or "",
                line=record.lineno,
            )
        )

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

    def change(name: str, level: int, source: str) -> str:
        refusal = levels.refusal(name, level) or _set_native(LogLevel(name, level))
        if not refusal:
            levels.set(name, level, source)
        return refusal

    for node in session.visible_nodes.values():
        LoggerServices(node, levels.get, change)


def apply_levels(levels: LoggerLevels, given: tuple[LogLevel, ...]) -> None:
    """Set the levels that a command line gives, for the loggers of Python and of rcl."""
    for each in given:
        _set_native(each)
    levels.apply(given)


def _set_native(level: LogLevel) -> str:
    """Set the level of a logger of rcl, if `level` names one; return why it was refused, or "".

    rcl's default level is never changed: at DEBUG, rcl writes two lines for each message.
    """
    return set_native_level(level.logger, level.level) if level.logger else ""
