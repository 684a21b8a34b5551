"""The control socket of a daemon: who may come in, and how many."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from robotctl.errors import Refused
from robotctl.ipc.connection import DEFAULT_LIMITS, Connection, Identity, Limits, Method
from robotctl.ipc.listener import Listener
from robotctl.ipc.peer import peer_of
from robotctl.ipc.protocol import Code

__all__ = ["ControlServer", "Identity", "Limits", "Method"]

_log = logging.getLogger(__name__)


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
        limits: Limits = DEFAULT_LIMITS,
    ) -> None:
        self._path = path
        self._listener = Listener(path)
        self._methods = dict(methods)
        self._identity = identity
        self._limits = limits
        self._places = asyncio.Semaphore(limits.clients + limits.overflow)
        self._admitted = 0

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
                await self._listener.removed()
                _log.warning("somebody has removed %s: it is made anew", self._path)
                accepting.cancel()
                await asyncio.wait({accepting})
                await self._listener.reopen()

    async def _accept_clients(self, connections: asyncio.TaskGroup) -> None:
        while True:
            await self._places.acquire()
            try:
                sock = await self._listener.accept()
            except BaseException:
                self._places.release()
                raise
            over_cap = self._admitted >= self._limits.clients
            self._admitted += not over_cap
            task = connections.create_task(self._handle(sock, over_cap))

            # Not in the task itself: one that is cancelled before its first step runs nothing.
            def release(
                _: asyncio.Task[None], sock: socket.socket = sock, over_cap: bool = over_cap
            ) -> None:
                sock.close()
                self._admitted -= not over_cap
                self._places.release()

            task.add_done_callback(release)

    async def _handle(self, sock: socket.socket, over_cap: bool) -> None:
        """Serve one client; whatever happens here, the others do not notice."""
        connection = Connection(
            sock, self._methods, self._identity, self._limits, over_cap=over_cap
        )
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
            _log.exception("a connection failed")
