"""What the control socket of every daemon offers."""

from __future__ import annotations

import asyncio
from typing import Any

from robotctl.daemon.api.status import StatusSource
from robotctl.ipc.connection import Method
from robotctl.ipc.params import NoParams


def common_methods(status: StatusSource, stop: asyncio.Event) -> dict[str, Method[Any]]:
    """Return `status`, and `stop`, which sets the event."""

    async def get_status(_: NoParams) -> dict[str, Any]:
        return status.status()

    async def end(_: NoParams) -> dict[str, Any]:
        stop.set()
        return {"message": f"Stopped: {status.status()['recorder']['file']}"}

    return {"status": Method(NoParams, get_status), "stop": Method(NoParams, end)}
