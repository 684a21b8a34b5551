"""A server of the view in this loop, without a source."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

from robotctl.view.admission import Admission
from robotctl.view.view_server import ViewServer

TOKEN = "a-token-of-this-run"
STRING = ("std_msgs/msg/String", "string data\n")


class Served:
    """A running server, and where it listens."""

    def __init__(self, server: ViewServer, port: int) -> None:
        self.server = server
        self.port = port
        self.url = f"ws://127.0.0.1:{port}/?token={TOKEN}"


@asynccontextmanager
async def served(**options: Any) -> AsyncIterator[Served]:
    """Serve during a block."""
    server = ViewServer("test", Admission(TOKEN), **options)
    port = await server.listen("127.0.0.1", 0)
    running = asyncio.create_task(server.run())
    try:
        yield Served(server, port)
    finally:
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
        server.close()
