"""The control socket of a daemon: accepts permitted clients up to a limit, and answers them."""

from __future__ import annotations

import asyncio
import logging
import os
import select
import socket
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from robotctl.base.errors import NoDaemon, Refused, RobotctlError
from robotctl.ipc.listener import Listener, SocketGroup, has_event, until_readable
from robotctl.ipc.protocol import (
    MAX_REQUEST_BYTES,
    Code,
    LineBuffer,
    ProtocolError,
    groups_of,
    guest_of,
    parse_request,
)
from robotctl.ipc.request_handler import (
    DEFAULT_LIMITS,
    ClientLimits,
    Identity,
    Method,
    RequestHandler,
    encode_failure,
    log_failure,
)


class Connection:
    """Serves one client until a disconnect, a missed deadline or an overlong line.

    With `over_cap` (too many clients) it serves only two lines: hello and an emergency stop.
    """

    def __init__(
        self,
        sock: socket.socket,
        methods: Mapping[str, Method[Any]],
        identity: Identity,
        limits: ClientLimits,
        *,
        over_cap: bool,
    ) -> None:
        self._sock = sock
        self._limits = limits
        self._over_cap = over_cap
        self._handler = RequestHandler(sock, methods, identity, limits, over_cap=over_cap)
        self._lines = LineBuffer(MAX_REQUEST_BYTES)
        self._is_listening = False

    def is_idle(self) -> bool:
        """Return whether everything that the client has sent is read and answered."""
        return self._is_listening and not has_event(self._sock, select.POLLIN)

    def dismiss(self) -> None:
        """Send the error "busy", without waiting; the caller then closes the connection."""
        self._say_last(None, Code.BUSY, self._handler.busy())

    async def run(self) -> None:
        """Answer requests until the connection must be closed.

        Raises:
            OSError: The client has disconnected, or does not read its reply.
        """
        lines_left = 2 if self._over_cap else None  # hello, and the one emergency stop
        while lines_left != 0:
            line = await self._read_line()
            if line is None:
                return
            await self._send(await self._answer(line))
            if lines_left is not None:
                lines_left -= 1

    async def refuse(self, code: Code, error: RobotctlError) -> None:
        """Send `error` to the client; then the caller closes the connection."""
        await self._send(encode_failure(None, code, error))

    async def _answer(self, line: bytes) -> bytes | bytearray:
        try:
            request = parse_request(line)
        except ProtocolError as error:
            return encode_failure(error.request_id, error.code, error)
        try:
            return await self._handler.reply(request)
        except asyncio.CancelledError:
            self._say_last(request.id, Code.STOPPING, NoDaemon("the daemon is stopping"))
            raise

    async def _read_line(self) -> bytes | None:
        """Return the next line; None after a disconnect, a missed deadline or an overlong line."""
        limits = self._limits
        deadline_s = limits.overflow_request_s if self._over_cap else limits.request_s
        try:
            async with asyncio.timeout(deadline_s):
                line = self._lines.next_line()
                if line is not None:
                    await asyncio.sleep(0)  # let other tasks run, even if many lines are buffered
                while line is None:
                    data = await self._receive()
                    if not data:
                        return None
                    self._lines.receive(data)
                    line = self._lines.next_line()
                return line
        except ProtocolError as error:
            await self.refuse(error.code, error)
        except TimeoutError:
            text = f"no whole request within {deadline_s:g} s: the connection is closed"
            await self.refuse(Code.TIMEOUT, RobotctlError(text))
        return None

    async def _receive(self) -> bytes:
        """Read like `loop.sock_recv`, but leave the data in the socket if the read is cancelled.

        Other tasks get a turn first, even if data have arrived already.
        """
        while True:
            self._is_listening = True
            try:
                await until_readable(self._sock)
            finally:
                self._is_listening = False
            with suppress(BlockingIOError):
                return self._sock.recv(MAX_REQUEST_BYTES)

    async def _send(self, line: bytes | bytearray) -> None:
        """Send a reply within `write_s`; other tasks run only if the socket's buffer is full."""
        async with asyncio.timeout(self._limits.write_s):
            await asyncio.get_running_loop().sock_sendall(self._sock, line)

    def _say_last(self, request_id: int | str | None, code: Code, error: RobotctlError) -> None:
        """Try to send an error without waiting, just before the connection is closed."""
        with suppress(OSError):
            self._sock.send(encode_failure(request_id, code, error))


_log = logging.getLogger(__name__)

_FULL_POLL_S = 0.005
"""How often [s] to look for a connection to close, while a new client waits for its place."""


class ControlServer:
    """Listens at the control socket in the `with` block; answers clients while `serve` runs.

    It replaces the socket file of a dead daemon at `path`. The caller must own the robot's lock.

        with ControlServer(path, methods, identity) as server:
            tasks.create_task(server.serve())
    """

    def __init__(
        self,
        path: Path,
        methods: Mapping[str, Method[Any]],
        identity: Identity,
        *,
        group: SocketGroup | None = None,
        limits: ClientLimits = DEFAULT_LIMITS,
        on_unreachable: Callable[[str], None] = lambda problem: None,
    ) -> None:
        """Call `on_unreachable(problem)` if clients cannot connect, with "" when they can again."""
        self._path = path
        self._group = group
        self._listener = Listener(path, group)
        self._on_unreachable = on_unreachable
        self._lost = 0
        self._methods = dict(methods)
        self._identity = identity
        self._limits = limits
        self._admitted = 0
        self._overflow: dict[asyncio.Task[None], Connection] = {}
        """Connections above the limit, the oldest first."""

    def __enter__(self) -> Self:
        """Listen; from now on clients can connect. Raises what Listener.open raises."""
        self._listener.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    async def serve(self) -> None:
        """Answer clients until cancelled; then close every connection."""
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
        """Return a sentence on how often the socket was lost, or "" if it never was."""
        if not self._lost:
            return ""
        times = "once" if self._lost == 1 else f"{self._lost} times"
        return (
            f"the control socket {self._path} was removed or replaced {times}, "
            f"last noticed at {self._lost_at}: it was created again"
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
            await asyncio.sleep(0)  # many clients at once must not delay a tick

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

        # Not in the task itself: a task that is cancelled before its first step runs no code.
        def release(ended: asyncio.Task[None]) -> None:
            sock.close()
            self._admitted -= not over_cap
            self._overflow.pop(ended, None)

        task.add_done_callback(release)

    def _is_full(self) -> bool:
        limits = self._limits
        return self._admitted >= limits.clients and len(self._overflow) >= limits.overflow

    def _dismiss_idle(self) -> bool:
        """Close the oldest idle connection above the limit; return whether there was one.

        This makes room for an emergency stop even if many silent connections are open.
        """
        for task, connection in self._overflow.items():
            if connection.is_idle():
                connection.dismiss()
                task.cancel()
                del self._overflow[task]
                return True
        return False

    async def _handle(self, sock: socket.socket, connection: Connection) -> None:
        """Serve one client; no failure here affects the others."""
        try:
            uid = guest_of(sock)
            if uid is None or (self._group is not None and self._group.gid in groups_of(sock)):
                await connection.run()
            else:
                _log.warning("uid %d was refused", uid)
                text = f"robot {self._identity.robot!r} belongs to uid {os.getuid()}, not {uid}"
                await connection.refuse(Code.FORBIDDEN, Refused(text))
        except OSError as error:  # including TimeoutError: the client does not read its reply
            _log.debug("a client is gone: %s", error)
        except Exception:  # noqa: BLE001 - it ends this connection, not the daemon
            log_failure("a connection failed")
