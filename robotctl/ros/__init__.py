"""ROS 2 in the asyncio loop: the only package of robotctl that imports rclpy."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.ros.executor import AsyncioExecutor, RawTap, Tick, Ticker

__all__ = ["AsyncioExecutor", "RawTap", "Tick", "Ticker"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("robotctl.ros.executor"), name)
