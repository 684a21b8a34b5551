"""The control socket of a daemon: who may come in, how many, and what is left behind."""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import socket
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from robotctl.errors import Refused, UsageError
from robotctl.ipc.connection import DEFAULT_LIMITS, Connection, Identity, Limits, Method
from robotctl.ipc.peer import peer_of
from robotctl.ipc.protocol import Code
from robotctl.paths import make_private

__all__ = ["ControlServer", "Identity", "Limits", "Method"]

_log = logging.getLogger(__name__)

BACKLOG = 1024
"""Clients that may wait to be accepted. With a full backlog asyncio's own connect hands out a
socket that is not connected, so the backlog takes the largest burst that is promised."""

_OUT_OF_RESOURCES = {errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM}
_RETRY_ACCEPT_S = 0.1


class ControlServer:
    """Listens from `with` on, answers while `serve` runs, removes the socket at the end.

    The caller owns the robot's lock: what lies at `path` is then a dead daemon's and is replaced.

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
        self._methods = dict(methods)
        self._identity = identity
        self._limits = limits
        self._admitted = 0
        self._inode = 0
        self._listener: socket.socket

    def __enter__(self) -> Self:
        """Bind and listen: from here on clients wait instead of failing.

        Raises:
            UsageError: The folder is another user's, or something else lies at the path.
        """
        make_private(self._path.parent)
        _remove_stale(self._path)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            previous = os.umask(0o177)  # a chmod after bind would leave a moment open to everybody
            try:
                self._listener.bind(str(self._path))
            finally:
                os.umask(previous)
            self._inode = self._path.stat().st_ino
            self._listener.listen(BACKLOG)
            self._listener.setblocking(False)
        except BaseException:
            self._listener.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._listener.close()
        with suppress(OSError):
            if self._path.stat().st_ino == self._inode:
                self._path.unlink()

    async def serve(self) -> None:
        """Answer clients until cancelled; every connection is closed when this returns."""
        places = asyncio.Semaphore(self._limits.clients + self._limits.overflow)
        async with asyncio.TaskGroup() as connections:
            while True:
                await places.acquire()
                sock = await self._accept()
                over_cap = self._admitted >= self._limits.clients
                self._admitted += not over_cap
                task = connections.create_task(self._handle(sock, over_cap))

                # Not in the task itself: one that is cancelled before its first step runs nothing.
                def release(
                    _: asyncio.Task[None], sock: socket.socket = sock, over_cap: bool = over_cap
                ) -> None:
                    sock.close()
                    self._admitted -= not over_cap
                    places.release()

                task.add_done_callback(release)

    async def _accept(self) -> socket.socket:
        loop = asyncio.get_running_loop()
        while True:
            try:
                return (await loop.sock_accept(self._listener))[0]
            except OSError as error:
                if error.errno in _OUT_OF_RESOURCES:
                    _log.warning("no connection can be accepted: %s", error)
                    await asyncio.sleep(_RETRY_ACCEPT_S)
                elif error.errno != errno.ECONNABORTED:
                    raise

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


def _remove_stale(path: Path) -> None:
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise UsageError(f"{path} is not a socket: remove it, then start again")
        path.unlink()
