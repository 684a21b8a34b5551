"""The methods that the control socket of every daemon has."""

from __future__ import annotations

import asyncio
from typing import Any

from robotctl.daemon.api.status import StatusSource
from robotctl.ipc.answers import Status, Stopped
from robotctl.ipc.method import Method
from robotctl.ipc.method_names import STATUS, STOP
from robotctl.ipc.params import NoParams


def common_methods(status: StatusSource, stop: asyncio.Event) -> dict[str, Method[Any]]:
    """Return the methods `status`, and `stop`, which sets the event `stop`."""

    async def get_status(_: NoParams) -> Status:
        stats = status.stats()
        await asyncio.sleep(0)  # with 500 topics that all change each half takes 0.3 ms
        return status.status(stats)

    async def end(_: NoParams) -> Stopped:
        stop.set()
        return {"message": f"Stopped: {status.stats().file}"}

    return {STATUS: Method(NoParams, get_status), STOP: Method(NoParams, end)}
