"""AsyncioExecutor: rclpy callbacks in the asyncio loop, without a spinning thread.

Only the names of `__all__` are stable. `Tick`, `Ticker` and the errors need no rclpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.ros.executor.event_loop import EventLoop, run
    from robotctl.ros.executor.executor import AsyncioExecutor
    from robotctl.ros.executor.raw_tap import UNKNOWN_GID, RawTap, SerializedData, Sink, ViewSink
    from robotctl.ros.executor.rcutils import RclCallFailed, UnsupportedPlatform
    from robotctl.ros.executor.replies import requester
    from robotctl.ros.executor.runtime import ExceptionHandler
    from robotctl.ros.executor.ticker import Tick, Ticker

__all__ = [
    "UNKNOWN_GID",
    "AsyncioExecutor",
    "EventLoop",
    "ExceptionHandler",
    "RawTap",
    "RclCallFailed",
    "SerializedData",
    "Sink",
    "Tick",
    "Ticker",
    "UnsupportedPlatform",
    "ViewSink",
    "requester",
    "run",
]

_MODULES = ("event_loop", "rcutils", "ticker", "raw_tap", "runtime", "replies", "executor")
"""The modules to search for a name, in this order. Those before `runtime` need no rclpy."""


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    modules = (import_module(f"{__name__}.{each}") for each in _MODULES)
    return next(getattr(module, name) for module in modules if hasattr(module, name))
