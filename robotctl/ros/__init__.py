"""ROS 2 in the asyncio loop: the only package of robotctl that imports rclpy.

The names are loaded on first use, so that importing this package costs nothing by itself.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.ros.executor import AsyncioExecutor
    from robotctl.ros.raw import RawTap
    from robotctl.ros.ticker import Tick, Ticker

__all__ = ["AsyncioExecutor", "RawTap", "Tick", "Ticker"]

_HOMES = {
    "AsyncioExecutor": "robotctl.ros.executor",
    "RawTap": "robotctl.ros.raw",
    "Tick": "robotctl.ros.ticker",
    "Ticker": "robotctl.ros.ticker",
}


def __getattr__(name: str) -> object:
    try:
        home = _HOMES[name]
    except KeyError:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    return getattr(importlib.import_module(home), name)
