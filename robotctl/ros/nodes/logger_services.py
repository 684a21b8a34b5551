# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""The services of a node that tell and change the levels of loggers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from rcl_interfaces.msg import LoggerLevel, SetLoggerLevelsResult
from rclpy.logging import set_logger_level
from rclpy.logging_service import LoggingService
from rclpy.node import Node

MAX_LEVELS: Final = 100
"""Levels that a call may change; a longer list would hold up the loop."""

Get = Callable[[str], int]
"""Returns the level of a logger, 0 where it has none."""

Set = Callable[[str, int, str], str]
"""Sets the level of a logger for the named service; returns the refusal, or ""."""


class LoggerServices(LoggingService):
    """The services `get_logger_levels` and `set_logger_levels` of a node, as rclpy offers them."""

    def __init__(self, node: Node, get: Get, set_level: Set) -> None:
        self._get = get
        self._set = set_level
        self._source = f"the ROS service {node.get_fully_qualified_name()}/set_logger_levels"
        super().__init__(node)

    def _get_logger_levels(self, request: Any, response: Any) -> Any:
        response.levels = [
            LoggerLevel(name=name, level=self._get(name)) for name in request.names[:MAX_LEVELS]
        ]
        return response

    def _set_logger_levels(self, request: Any, response: Any) -> Any:
        asked = request.levels
        reasons = [self._set(each.name, each.level, self._source) for each in asked[:MAX_LEVELS]]
        results = [SetLoggerLevelsResult(successful=not each, reason=each) for each in reasons]
        left_out = SetLoggerLevelsResult(reason=f"more than {MAX_LEVELS} levels in one call")
        response.results = [*results, *[left_out] * len(asked[MAX_LEVELS:])]
        return response


def set_native_level(name: str, level: int) -> str:
    """Set the level of a logger of rcl and rclpy; return why that failed, "" where it did not."""
    try:
        set_logger_level(name, level, detailed_error=True)
    except (RuntimeError, TypeError, ValueError) as error:  # TypeError: it is not UTF-8
        return str(error)
    return ""
