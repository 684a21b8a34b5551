"""The control socket of a daemon, which answers permitted clients up to a limit."""

from __future__ import annotations

import asyncio
import logging
import os
import select
import socket
import sys
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import msgspec

from robotctl.base.errors import NoDaemon, Refused, RobotctlError, UsageError
from robotctl.ipc.answers import Hello
from robotctl.ipc.listener import Listener, SocketGroup, has_event, until_readable
from robotctl.ipc.method_params import HelloParams, decode
from robotctl.ipc.protocol import (
    MAX_REQUEST_BYTES,
    MAX_RESPONSE_BYTES,
    PROTOCOL_VERSION,
    Code,
    LineBuffer,
    ProtocolError,
    Request,
    encode_error,
    groups_of,
    guest_of,
    is_emergency_stop,
    parse_request,
)


@dataclass(frozen=True, slots=True)
class ClientLimits:
    """Limits on the connections, and on the time for each request and reply."""

    clients: int = 64
    """The number of connections with full service. Further ones get the error "busy"."""
    # `clients` + `overflow` is well below 1,024 open files, the usual limit of a process.
    overflow: int = 256
    """The number of connections beyond `clients`, each for one emergency stop."""
    request_s: float = 10.0
    """The time for a whole request, after the client has connected or got a reply."""
    overflow_request_s: float = 1.0
    """As `request_s`, for a connection beyond `clients`."""
    write_s: float = 5.0
    """The time in which a client must read a reply."""
    hangup_poll_s: float = 0.1
    """The time between two checks that the client of a call without deadline is still connected."""


DEFAULT_LIMITS = ClientLimits()


P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class Method(Generic[P]):
    """A method with its parameters, its handler and the handler's deadline.

    The handler runs in the loop. Its RobotctlError is sent to the client. The handler is cancelled
    at its deadline or, without one, when its client disconnects: its state must be consistent at
    every await.
    """

    params: type[P]
    handler: Callable[[P], Awaitable[object]]
    deadline_s: float | None = 10.0
    """The handler's deadline [s], or None for none while the client stays connected."""


_log = logging.getLogger(__name__)

_encoder = msgspec.json.Encoder()


@dataclass(frozen=True, slots=True)
class Identity:
    """The daemon's identity in the answer to `hello`."""

    robot: str
    version: str
    pid: int


class _Rejected(Exception):
    """A request that did not reach its handler, or whose handler missed its deadline."""

    def __init__(self, code: Code, cause: RobotctlError) -> None:
        super().__init__(str(cause))
        self.code = code
        self.cause = cause


def encode_failure(request_id: int | str | None, code: Code, error: RobotctlError) -> bytes:
    """Encode an error as one reply line."""
    return encode_error(request_id, code, str(error), error.exit_code, error.details())


def log_failure(what: str) -> None:
    """Log the handled exception, or pass a MemoryError to the loop's exception handler."""
    error = sys.exception()
    if isinstance(error, MemoryError):
        context = {"message": what, "exception": error}
        asyncio.get_running_loop().call_exception_handler(context)
    else:
        _log.exception("%s", what)


def _decode(request: Request, kind: type[P]) -> P:
    try:
        return decode(request.params, kind)
    except UsageError as error:
        cause = UsageError(f"{request.method}: {error.cause}", error.cure)
        raise _Rejected(Code.INVALID_PARAMS, cause) from None


def _encode_result(request_id: int | str, result: object) -> bytearray:
    """Encode one reply line. NaN and infinity, for unknown values, become null."""
    line = bytearray()
    _encoder.encode_into({"jsonrpc": "2.0", "id": request_id, "result": result}, line)
    line += b"\n"
    if len(line) > MAX_RESPONSE_BYTES:
        raise ValueError(f"a reply of {len(line)} bytes: the limit is {MAX_RESPONSE_BYTES}")
    return line


def _internal_error(request: Request) -> bytes:
    log_failure(f"{request.method!r} failed")
    text = f"internal error in {request.method!r}: the daemon's log holds the cause"
    return encode_error(request.id, Code.INTERNAL_ERROR, text)


class Connection:
    """Serves one client. If there are too many (`over_cap`), only hello and an emergency stop."""

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
        self._methods = methods
        self._identity = identity
        self._limits = limits
        self._over_cap = over_cap
        self._greeted = False
        self._lines = LineBuffer(MAX_REQUEST_BYTES)
        self._is_listening = False

    def is_idle(self) -> bool:
        """Return whether everything from the client is read and answered."""
        return self._is_listening and not has_event(self._sock, select.POLLIN)

    def dismiss(self) -> None:
        """Send the error "busy", without waiting. The caller then closes the connection."""
        self._say_last(None, Code.BUSY, self._busy())

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
        """Send `error` to the client. The caller then closes the connection."""
        await self._send(encode_failure(None, code, error))

    async def _answer(self, line: bytes) -> bytes | bytearray:
        try:
            request = parse_request(line)
        except ProtocolError as error:
            return encode_failure(error.request_id, error.code, error)
        try:
            return await self._reply(request)
        except asyncio.CancelledError:
            self._say_last(request.id, Code.STOPPING, NoDaemon("the daemon is stopping"))
            raise

    async def _read_line(self) -> bytes | None:
        """Return the next line. None after a disconnect, a missed deadline or an overlong line."""
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
        """Read some bytes, but leave the data in the socket if the read is cancelled."""
        while True:
            self._is_listening = True
            try:
                await until_readable(self._sock)
            finally:
                self._is_listening = False
            with suppress(BlockingIOError):
                return self._sock.recv(MAX_REQUEST_BYTES)

    async def _send(self, line: bytes | bytearray) -> None:
        """Send a reply within `write_s`. Other tasks run only if the socket's buffer is full."""
        async with asyncio.timeout(self._limits.write_s):
            await asyncio.get_running_loop().sock_sendall(self._sock, line)

    def _say_last(self, request_id: int | str | None, code: Code, error: RobotctlError) -> None:
        """Try to send an error without waiting, just before the connection is closed."""
        with suppress(OSError):
            self._sock.send(encode_failure(request_id, code, error))

    # One request

    async def _reply(self, request: Request) -> bytes | bytearray:
        """Carry out a request and return its one reply, even if the handler fails.

        Raises:
            asyncio.CancelledError: The task that waits for the reply is cancelled.
        """
        try:
            return _encode_result(request.id, await self._call(request))
        except _Rejected as rejected:
            return encode_failure(request.id, rejected.code, rejected.cause)
        except RobotctlError as error:
            return encode_failure(request.id, Code.ROBOTCTL_ERROR, error)
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if task is not None and task.cancelling():  # else a handler raised it
                raise
            return _internal_error(request)
        except Exception:  # noqa: BLE001 - logged; a bug ends one request, not the daemon
            return _internal_error(request)

    def _busy(self) -> Refused:
        """Return the error for a client beyond the limit on clients."""
        return Refused(f"the daemon is busy with {self._limits.clients} clients", "try again")

    async def _call(self, request: Request) -> object:
        """Return the handler's result.

        Raises:
            _Rejected: The handler was not called, or missed its deadline.
        """
        if request.method == "hello":
            return self._hello(_decode(request, HelloParams))
        if not is_emergency_stop(request):
            self._check_admitted()
        method = self._methods.get(request.method)
        if method is None:
            text = f"robotctl {self._identity.version} has no method {request.method[:40]!r}"
            raise _Rejected(Code.METHOD_NOT_FOUND, UsageError(text))
        params = self._vouched(_decode(request, method.params))
        try:
            async with asyncio.timeout(method.deadline_s) as deadline:
                if method.deadline_s is not None:
                    return await method.handler(params)
                with self._until_hangup(deadline):
                    return await method.handler(params)
        except TimeoutError:
            if not deadline.expired():  # the handler raised it
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

    def _vouched(self, params: P) -> P:
        """Return `params`, with another user's uid appended to `source`."""
        guest, source = guest_of(self._sock), getattr(params, "source", None)
        if guest is None or source is None:
            return params
        named: P = msgspec.structs.replace(params, source=f"{source} of uid {guest}")  # type: ignore[type-var]
        return named

    def _check_admitted(self) -> None:
        if self._over_cap:
            raise _Rejected(Code.BUSY, self._busy())
        if not self._greeted:
            text = f"the first request is hello with protocol {PROTOCOL_VERSION}"
            raise _Rejected(Code.INVALID_REQUEST, UsageError(text))

    @contextmanager
    def _until_hangup(self, deadline: asyncio.Timeout) -> Iterator[None]:
        """Make `deadline` expire when the client disconnects within the `with` block."""
        loop, period_s = asyncio.get_running_loop(), self._limits.hangup_poll_s
        timer: asyncio.TimerHandle

        def look() -> None:
            nonlocal timer
            # Not the end of the client's stream: the client may have closed only its sending half.
            if has_event(self._sock, 0):
                deadline.reschedule(loop.time())
            else:
                timer = loop.call_later(period_s, look)

        timer = loop.call_later(period_s, look)
        try:
            yield
        finally:
            timer.cancel()


_FULL_POLL_S = 0.005
"""The time between two looks for a connection to close, while a new client waits."""


class ControlServer:
    """Listens at the control socket in the `with` block, and answers clients while `serve` runs.

    The caller must own the robot's lock.

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
        """Listen. From now on clients can connect. Raises as `Listener.open` does."""
        self._listener.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    async def serve(self) -> None:
        """Answer clients until cancelled, and then close every connection."""
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
        """Return a sentence on the losses of the socket, or "" if there were none."""
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
        """Close the oldest idle connection above the limit, and return whether there was one."""
        # This makes room for an emergency stop even if many silent connections are open.
        for task, connection in self._overflow.items():
            if connection.is_idle():
                connection.dismiss()
                task.cancel()
                del self._overflow[task]
                return True
        return False

    async def _handle(self, sock: socket.socket, connection: Connection) -> None:
        """Serve one client. No failure here affects the others."""
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
