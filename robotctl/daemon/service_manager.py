"""Reports to systemd: ready, alive, mode, stopping (sd_notify(3))."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

STATUS_PERIOD_S = 1.0


class ServiceManager:
    """Sends reports to the service manager, if any; drops reports that cannot be sent."""

    def __init__(self) -> None:
        """Connect to the socket, and remove the manager's variables from the environment."""
        address = os.environ.pop("NOTIFY_SOCKET", "")
        watchdog = os.environ.pop("WATCHDOG_USEC", "")
        self._period_s = STATUS_PERIOD_S
        if watchdog.isdecimal() and int(watchdog):
            self._period_s = min(STATUS_PERIOD_S, int(watchdog) / 1e6 / 2.0)
        self._socket: socket.socket | None = None
        if address.startswith(("/", "@")):  # opened once: later reports need no free descriptor
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
            with suppress(OSError):
                self._socket.connect(address.replace("@", "\0", 1))

    def ready(self) -> None:
        """Report that the daemon is ready."""
        self._tell("READY=1")

    @asynccontextmanager
    async def reporting(self, status: Callable[[], str]) -> AsyncIterator[None]:
        """Report keep-alives and the status within the block, and "stopping" at its end."""
        task = asyncio.create_task(self._run(status))
        try:
            yield
        finally:
            task.cancel()
            self._tell("STOPPING=1\nSTATUS=stopping")
            if self._socket is not None:
                self._socket.close()

    async def _run(self, status: Callable[[], str]) -> None:
        told = ""
        while True:
            lines = ["WATCHDOG=1"]
            if told != (told := status()):
                lines.append(f"STATUS={told}")
            self._tell("\n".join(lines))
            await asyncio.sleep(self._period_s)

    def _tell(self, text: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.send(text.encode())
