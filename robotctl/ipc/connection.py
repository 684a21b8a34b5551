"""The server's side of one connection: one request at a time, each with a deadline."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from robotctl.errors import NoDaemon, RobotctlError
from robotctl.ipc.client_limits import ClientLimits
from robotctl.ipc.deadline import Deadline, DeadlineMissed
from robotctl.ipc.method import Method
from robotctl.ipc.protocol import (
    MAX_REQUEST_BYTES,
    Code,
    LineBuffer,
    ProtocolError,
    parse_request,
)
from robotctl.ipc.readiness import is_readable, until_readable
from robotctl.ipc.request_handler import Identity, RequestHandler, encode_failure


class Connection:
    """The connection of one client, until its end, a missed deadline or a line that is too long.

    With `over_cap` there are too many clients already: then one emergency stop is answered.
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
        self._deadline = Deadline()
        self._handler = RequestHandler(
            sock, methods, identity, limits, self._deadline, over_cap=over_cap
        )
        self._lines = LineBuffer(MAX_REQUEST_BYTES)
        self._is_listening = False

    def is_idle(self) -> bool:
        """Return whether everything that the client has sent is read and answered."""
        return self._is_listening and not is_readable(self._sock)

    def dismiss(self) -> None:
        """Tell an idle client, without waiting, that another client takes its place."""
        self._say_last(None, Code.BUSY, self._handler.busy())

    async def run(self) -> None:
        """Answer requests until the connection is to be closed.

        Raises:
            OSError: The client is gone.
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
        """Send the reason why this connection is closed."""
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
        """Return the next line; None after a disconnect, a missed deadline or a line too long."""
        limits = self._limits
        deadline_s = limits.overflow_request_s if self._over_cap else limits.request_s
        try:
            with self._deadline.within(deadline_s):
                line = self._lines.next_line()
                if line is not None:
                    await asyncio.sleep(0)  # a turn for others, however many lines are here
                while line is None:
                    data = await self._receive()
                    if not data:
                        return None
                    self._lines.receive(data)
                    line = self._lines.next_line()
                return line
        except ProtocolError as error:
            await self.refuse(error.code, error)
        except DeadlineMissed:
            text = f"no whole request within {deadline_s:g} s: the connection is closed"
            await self.refuse(Code.TIMEOUT, RobotctlError(text))
        return None

    async def _receive(self) -> bytes:
        """Read as `loop.sock_recv` does, but a cancelled read leaves the data in the socket.

        Others get a turn, also if there are data already.
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
        """Send a reply in time; other tasks get no turn if the socket takes it at once."""
        with self._deadline.within(self._limits.write_s):
            await asyncio.get_running_loop().sock_sendall(self._sock, line)

    def _say_last(self, request_id: int | str | None, code: Code, error: RobotctlError) -> None:
        """Send an error without waiting: the connection is closed next."""
        with suppress(OSError):
            self._sock.send(encode_failure(request_id, code, error))
