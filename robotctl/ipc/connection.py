"""The server's side of one connection: one request at a time, each with a deadline."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import msgspec

from robotctl.errors import NoDaemon, Refused, RobotctlError, UsageError
from robotctl.ipc.answers import Hello
from robotctl.ipc.params import HelloParams, decode
from robotctl.ipc.protocol import (
    MAX_REQUEST_BYTES,
    MAX_RESPONSE_BYTES,
    PROTOCOL_VERSION,
    Code,
    Lines,
    ProtocolError,
    Request,
    encode_error,
    is_emergency_stop,
    parse_request,
)
from robotctl.ipc.readiness import is_hung_up, is_readable, until_readable

_log = logging.getLogger(__name__)

_HANGUP_POLL_S = 0.1
"""How soon a call without a deadline notices that its client is gone: a robot may be driving."""

P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class Method(Generic[P]):
    """One method: what it takes, what carries it out, and how long that may take.

    The handler is called in the loop with the decoded parameters; a RobotctlError that it raises
    crosses to the client with text and exit code. It is cancelled at its deadline and when its
    client hangs up, so it must leave a consistent state behind at every await.
    """

    params: type[P]
    handler: Callable[[P], Awaitable[object]]
    deadline_s: float | None = 10.0
    """None: as long as the client stays connected."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Who answers; `hello` tells it to the client."""

    robot: str
    version: str
    pid: int


@dataclass(frozen=True, slots=True)
class Limits:
    """What one client, and all of them together, may take from the daemon."""

    clients: int = 64
    """Beyond these a connection is told that the daemon is busy."""
    overflow: int = 256
    """Connections over the cap that are listened to, each for one emergency stop; for a further one
    the oldest that says nothing is closed. Together with `clients` well below the usual 1,024 open
    files."""
    request_s: float = 10.0
    """For a request to arrive whole, from the connection's start or the reply before it."""
    overflow_request_s: float = 1.0
    write_s: float = 5.0
    """For a client to take its reply."""


DEFAULT_LIMITS = Limits()


class _Rejected(Exception):
    """A request that did not reach its handler, or ran out of time there."""

    def __init__(self, code: Code, cause: RobotctlError) -> None:
        super().__init__(str(cause))
        self.code = code
        self.cause = cause


class Connection:
    """Answers one client until it leaves, misses a deadline or sends an endless line."""

    def __init__(
        self,
        sock: socket.socket,
        methods: Mapping[str, Method[Any]],
        identity: Identity,
        limits: Limits,
        *,
        over_cap: bool,
    ) -> None:
        self._sock = sock
        self._methods = methods
        self._identity = identity
        self._limits = limits
        self._over_cap = over_cap
        self._lines = Lines(MAX_REQUEST_BYTES)
        self._greeted = False
        self._is_listening = False

    def is_idle(self) -> bool:
        """Whether the client has sent nothing that is still to be read or answered."""
        return self._is_listening and not is_readable(self._sock)

    def dismiss(self) -> None:
        """Tell an idle client that another one takes its place; it is not waited for."""
        self._say_last(None, Code.BUSY, self._busy())

    async def run(self) -> None:
        """Serve until the connection is to be closed; raises OSError when the client is gone."""
        lines_left = 2 if self._over_cap else None  # hello, and the one emergency stop
        while lines_left != 0:
            line = await self._read_line()
            if line is None:
                return
            await self._send(await self._answer(line))
            await asyncio.sleep(0)  # no read or write above waits while a client keeps both full
            if lines_left is not None:
                lines_left -= 1

    async def refuse(self, code: Code, error: RobotctlError) -> None:
        """Say why nothing more will be answered here."""
        await self._send(_encode_failure(None, code, error))

    async def _read_line(self) -> bytes | None:
        """The next line, or None when the client left, was too slow or sent an endless line."""
        limits = self._limits
        deadline_s = limits.overflow_request_s if self._over_cap else limits.request_s
        try:
            async with asyncio.timeout(deadline_s):
                while (line := self._lines.next_line()) is None:
                    data = await self._receive()
                    if not data:
                        return None
                    self._lines.receive(data)
                return line
        except ProtocolError as error:
            await self.refuse(error.code, error)
        except TimeoutError:
            text = f"no whole request within {deadline_s:g} s: the connection is closed"
            await self.refuse(Code.TIMEOUT, RobotctlError(text))
        return None

    async def _receive(self) -> bytes:
        """As `loop.sock_recv`, but what was not yet given to this task is still in the socket."""
        while True:
            try:
                return self._sock.recv(MAX_REQUEST_BYTES)
            except BlockingIOError:
                self._is_listening = True
                try:
                    await until_readable(self._sock)
                finally:
                    self._is_listening = False

    async def _send(self, line: bytes) -> None:
        """Write a reply, in this very loop turn where the socket takes it whole."""
        async with asyncio.timeout(self._limits.write_s):
            await asyncio.get_running_loop().sock_sendall(self._sock, line)

    async def _answer(self, line: bytes) -> bytes:
        """The one reply to a request line, whatever the line and the handler do."""
        try:
            request = parse_request(line)
        except ProtocolError as error:
            return _encode_failure(error.request_id, error.code, error)
        try:
            return _encode_result(request.id, await self._call(request))
        except _Rejected as rejected:
            return _encode_failure(request.id, rejected.code, rejected.cause)
        except RobotctlError as error:
            return _encode_failure(request.id, Code.ROBOTCTL_ERROR, error)
        except asyncio.CancelledError:
            if _being_cancelled():
                self._say_last(request.id, Code.STOPPING, NoDaemon("the daemon is stopping"))
                raise
            return _internal_error(request)
        except Exception:  # noqa: BLE001 - logged; a mishap ends one request, not the daemon
            return _internal_error(request)

    async def _call(self, request: Request) -> object:
        """Carry out a request; raises _Rejected where its handler has no say."""
        if request.method == "hello":
            return self._hello(_decode(request, HelloParams))
        if not is_emergency_stop(request):
            self._check_admitted()
        method = self._methods.get(request.method)
        if method is None:
            text = f"robotctl {self._identity.version} has no method {request.method[:40]!r}"
            raise _Rejected(Code.METHOD_NOT_FOUND, UsageError(text))
        params = _decode(request, method.params)
        try:
            async with asyncio.timeout(method.deadline_s) as deadline:
                if method.deadline_s is not None:
                    return await method.handler(params)
                with self._until_hangup(deadline):
                    return await method.handler(params)
        except TimeoutError:
            if not deadline.expired():
                raise
            text = f"{request.method} took longer than {method.deadline_s} s"
            raise _Rejected(Code.TIMEOUT, RobotctlError(text)) from None

    def _hello(self, params: HelloParams) -> Hello:
        identity = self._identity
        if params.protocol != PROTOCOL_VERSION:
            text = (
                f"the daemon (robotctl {identity.version}) speaks protocol {PROTOCOL_VERSION}, "
                f"this client {params.protocol}: stop it with kill {identity.pid} and start again"
            )
            raise _Rejected(Code.PROTOCOL_MISMATCH, Refused(text))
        self._greeted = True
        return {
            "protocol": PROTOCOL_VERSION,
            "version": identity.version,
            "robot": identity.robot,
            "pid": identity.pid,
        }

    def _check_admitted(self) -> None:
        if self._over_cap:
            raise _Rejected(Code.BUSY, self._busy())
        if not self._greeted:
            text = f"the first request is hello with protocol {PROTOCOL_VERSION}"
            raise _Rejected(Code.INVALID_REQUEST, UsageError(text))

    def _busy(self) -> Refused:
        return Refused(f"the daemon is busy with {self._limits.clients} clients", "try again")

    @contextmanager
    def _until_hangup(self, deadline: asyncio.Timeout) -> Iterator[None]:
        """Expire `deadline` when the client is gone.

        The end of its stream is no proof (it may have closed its sending half alone), so the
        socket is asked.
        """
        loop = asyncio.get_running_loop()
        timer: asyncio.TimerHandle

        def look() -> None:
            nonlocal timer
            if is_hung_up(self._sock):
                deadline.reschedule(loop.time())
            else:
                timer = loop.call_later(_HANGUP_POLL_S, look)

        timer = loop.call_later(_HANGUP_POLL_S, look)
        try:
            yield
        finally:
            timer.cancel()

    def _say_last(self, request_id: int | str | None, code: Code, error: RobotctlError) -> None:
        """Send an error without waiting: the connection ends now."""
        with suppress(OSError):
            self._sock.send(encode_error(request_id, code, str(error), error.exit_code))


def _decode(request: Request, kind: type[P]) -> P:
    try:
        return decode(request.params, kind)
    except UsageError as error:
        cause = UsageError(f"{request.method}: {error.cause}", error.cure)
        raise _Rejected(Code.INVALID_PARAMS, cause) from None


def _encode_result(request_id: int | str, result: object) -> bytes:
    """One reply line; NaN and infinity, the unknown values of ROS, become null."""
    line = msgspec.json.encode({"jsonrpc": "2.0", "id": request_id, "result": result}) + b"\n"
    if len(line) > MAX_RESPONSE_BYTES:
        raise ValueError(f"a reply of {len(line)} bytes: the limit is {MAX_RESPONSE_BYTES}")
    return line


def _encode_failure(request_id: int | str | None, code: Code, error: RobotctlError) -> bytes:
    return encode_error(request_id, code, str(error), error.exit_code, error.details())


def log_failure(what: str) -> None:
    """Log the exception that is being handled.

    A lack of memory is no matter of one connection: the loop's exception handler decides.
    """
    error = sys.exception()
    if isinstance(error, MemoryError):
        context = {"message": what, "exception": error}
        asyncio.get_running_loop().call_exception_handler(context)
    else:
        _log.exception("%s", what)


def _internal_error(request: Request) -> bytes:
    log_failure(f"{request.method!r} failed")
    text = f"internal error in {request.method!r}: the daemon's log holds the cause"
    return encode_error(request.id, Code.INTERNAL_ERROR, text)


def _being_cancelled() -> bool:
    """Whether a CancelledError is meant for this task, and not a handler's own mishap."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
