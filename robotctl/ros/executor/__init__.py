"""AsyncioExecutor: rclpy callbacks in the asyncio loop, without a spinning thread.

This package imports nothing of robotctl outside itself. Each name is imported when it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.ros.executor.executor import AsyncioExecutor
    from robotctl.ros.executor.raw import RawTap
    from robotctl.ros.executor.ticker import Tick, Ticker

__all__ = ["AsyncioExecutor", "RawTap", "Tick", "Ticker"]

_MODULES = {
    "AsyncioExecutor": "robotctl.ros.executor.executor",
    "RawTap": "robotctl.ros.executor.raw",
    "Tick": "robotctl.ros.executor.ticker",
    "Ticker": "robotctl.ros.executor.ticker",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
