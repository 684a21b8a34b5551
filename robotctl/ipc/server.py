"""The control socket of a daemon: who may come in, and how many."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from robotctl.errors import Refused
from robotctl.ipc.client_limits import DEFAULT_LIMITS, ClientLimits
from robotctl.ipc.connection import Connection
from robotctl.ipc.listener import Listener
from robotctl.ipc.method import Method
from robotctl.ipc.peer import peer_of
from robotctl.ipc.protocol import Code
from robotctl.ipc.request_handler import Identity, log_failure

_log = logging.getLogger(__name__)

_FULL_POLL_S = 0.005
"""How often a connection looks for a place while all the others are being answered."""


class ControlServer:
    """Listens from `with` on, answers while `serve` runs, removes the socket at the end.

    What a dead daemon has left at `path` is replaced; the caller owns the robot's lock.

        with ControlServer(path, methods, identity) as server:
            tasks.create_task(server.serve())
    """

    def __init__(
        self,
        path: Path,
        methods: Mapping[str, Method[Any]],
        identity: Identity,
        *,
        limits: ClientLimits = DEFAULT_LIMITS,
        on_unreachable: Callable[[str], None] = lambda problem: None,
    ) -> None:
        """`on_unreachable(problem)` is told why no client finds us, "" when one can again."""
        self._path = path
        self._listener = Listener(path)
        self._on_unreachable = on_unreachable
        self._lost = 0
        self._methods = dict(methods)
        self._identity = identity
        self._limits = limits
        self._admitted = 0
        self._overflow: dict[asyncio.Task[None], Connection] = {}
        """Over the cap, the oldest first."""

    def __enter__(self) -> Self:
        """Listen: from here on clients wait instead of failing. Raises as Listener.open does."""
        self._listener.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    async def serve(self) -> None:
        """Answer clients until cancelled; every connection is closed when this returns."""
        async with asyncio.TaskGroup() as tasks:
            while True:
                accepting = tasks.create_task(self._accept_clients(tasks))
                await self._listener.lost()
                accepting.cancel()
                await asyncio.wait({accepting})
                await self._listener.reopen(self._on_unreachable)
                self._lost += 1
                self._lost_at = time.strftime("%H:%M:%S")
                _log.warning("%s", self.warning())
                self._on_unreachable("")

    def warning(self) -> str:
        """Say that the socket was lost, "" where it never was."""
        if not self._lost:
            return ""
        times = "once" if self._lost == 1 else f"{self._lost} times"
        return (
            f"the control socket {self._path} was removed or replaced {times}, "
            f"the last time found at {self._lost_at}: it was made again"
        )

    async def _accept_clients(self, connections: asyncio.TaskGroup) -> None:
        while True:
            sock = await self._listener.accept(self._dismiss_idle)
            try:
                while self._is_full() and not self._dismiss_idle():  # noqa: ASYNC110
                    await asyncio.sleep(_FULL_POLL_S)
            except BaseException:
                sock.close()
                raise
            self._take_in(sock, connections)
            await asyncio.sleep(0)  # many that come at once must not hold up a tick

    def _take_in(self, sock: socket.socket, connections: asyncio.TaskGroup) -> None:
        over_cap = self._admitted >= self._limits.clients
        connection = Connection(
            sock, self._methods, self._identity, self._limits, over_cap=over_cap
        )
        task = connections.create_task(self._handle(sock, connection))
        if over_cap:
            self._overflow[task] = connection
        else:
            self._admitted += 1

        # Not in the task itself: one that is cancelled before its first step runs nothing.
        def release(ended: asyncio.Task[None]) -> None:
            sock.close()
            self._admitted -= not over_cap
            self._overflow.pop(ended, None)

        task.add_done_callback(release)

    def _is_full(self) -> bool:
        limits = self._limits
        return self._admitted >= limits.clients and len(self._overflow) >= limits.overflow

    def _dismiss_idle(self) -> bool:
        """Close the connection over the cap that has been idle for the longest, if there is one.

        An emergency stop must find a place, however many connections say nothing.
        """
        for task, connection in self._overflow.items():
            if connection.is_idle():
                connection.dismiss()
                task.cancel()
                del self._overflow[task]
                return True
        return False

    async def _handle(self, sock: socket.socket, connection: Connection) -> None:
        """Serve one client; whatever happens here, the others do not notice."""
        try:
            uid = peer_of(sock).uid
            if uid not in (0, os.getuid()):
                _log.warning("uid %d was refused", uid)
                text = f"robot {self._identity.robot!r} belongs to uid {os.getuid()}, not {uid}"
                await connection.refuse(Code.FORBIDDEN, Refused(text))
            else:
                await connection.run()
        except OSError as error:  # TimeoutError among them: a client that does not take its reply
            _log.debug("a client is gone: %s", error)
        except Exception:  # noqa: BLE001 - it ends this connection, not the daemon
            log_failure("a connection failed")
