"""The inside of an open AsyncioExecutor, for tests of how it works."""

from __future__ import annotations

from typing import Any

from robotctl.ros import AsyncioExecutor
from robotctl.ros.executor.engine import Engine
from robotctl.ros.executor.runtime import Runtime


def engine_of(executor: AsyncioExecutor) -> Engine:
    """Return the part of it that exists while it is open."""
    assert executor._engine is not None
    return executor._engine


def sources_of(executor: AsyncioExecutor) -> dict[Any, Any]:
    """Return its sources, by entity; what a source has depends on its kind."""
    return engine_of(executor).attachments.sources


def runtime_of(executor: AsyncioExecutor) -> Runtime:
    """Return the state that its sources share."""
    return engine_of(executor).runtime
