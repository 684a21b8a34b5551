"""What an open executor has inside, for tests that look there."""

from __future__ import annotations

from typing import Any

from robotctl.ros import AsyncioExecutor
from robotctl.ros.executor.runtime import Runtime


def sources_of(executor: AsyncioExecutor) -> dict[Any, Any]:
    """Return its sources, by entity; what a source has depends on its kind."""
    assert executor._attachments is not None
    return executor._attachments.sources


def runtime_of(executor: AsyncioExecutor) -> Runtime:
    """Return the state that its sources share."""
    assert executor._runtime is not None
    return executor._runtime
