"""Turn one request into its reply: check it, decode it, call the handler, encode the result."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import msgspec

from robotctl.base.errors import Refused, RobotctlError, UsageError
from robotctl.ipc.answers import Hello
from robotctl.ipc.listener import has_event
from robotctl.ipc.method_params import HelloParams, decode
from robotctl.ipc.protocol import (
    MAX_RESPONSE_BYTES,
    PROTOCOL_VERSION,
    Code,
    Request,
    encode_error,
    guest_of,
    is_emergency_stop,
)


@dataclass(frozen=True, slots=True)
class ClientLimits:
    """Limits on the connections, and on the time for each request and reply."""

    clients: int = 64
    """The number of connections with full service; further ones get the error "busy"."""
    overflow: int = 256
    """The maximum number of connections beyond `clients`; each may send one emergency stop.

    To accept one more, the daemon closes the oldest idle one of them. `clients` + `overflow` is
    well below 1,024 open files, the usual limit of a process."""
    request_s: float = 10.0
    """Time from the connection's start, or the last reply, until a whole request is received."""
    overflow_request_s: float = 1.0
    """As `request_s`, for a connection beyond `clients`."""
    write_s: float = 5.0
    """Time to send a reply; a client that does not read it in time is disconnected."""
    hangup_poll_s: float = 0.1
    """The period of the check that the client of a call without deadline is still connected."""


DEFAULT_LIMITS = ClientLimits()


P = TypeVar("P")


@dataclass(frozen=True, slots=True)
class Method(Generic[P]):
    """A method: its parameters, its handler, and the handler's deadline.

    The handler is called in the loop with the decoded parameters. A RobotctlError that it raises
    is sent to the client with its text and exit code. The handler is cancelled at its deadline and
    when its client disconnects, so its state must be consistent at every await.
    """

    params: type[P]
    handler: Callable[[P], Awaitable[object]]
    deadline_s: float | None = 10.0
    """None: no deadline while the client stays connected."""


_log = logging.getLogger(__name__)

_encoder = msgspec.json.Encoder()


@dataclass(frozen=True, slots=True)
class Identity:
    """The daemon's identity, which `hello` returns to the client."""

    robot: str
    version: str
    pid: int


class _Rejected(Exception):
    """A request that did not reach its handler, or whose handler missed its deadline."""

    def __init__(self, code: Code, cause: RobotctlError) -> None:
        super().__init__(str(cause))
        self.code = code
        self.cause = cause


class RequestHandler:
    """Handles the requests of one connection, one at a time."""

    def __init__(
        self,
        sock: socket.socket,
        methods: Mapping[str, Method[Any]],
        identity: Identity,
        limits: ClientLimits,
        *,
        over_cap: bool,
    ) -> None:
        """With `over_cap`, accept only hello and an emergency stop. `sock` is polled, not read."""
        self._sock = sock
        self._methods = methods
        self._identity = identity
        self._limits = limits
        self._over_cap = over_cap
        self._greeted = False

    async def reply(self, request: Request) -> bytes | bytearray:
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
            if _being_cancelled():
                raise
            return _internal_error(request)
        except Exception:  # noqa: BLE001 - logged; a bug ends one request, not the daemon
            return _internal_error(request)

    def busy(self) -> Refused:
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
        """Return `params`; if another user is connected, append that user's uid to `source`."""
        guest, source = guest_of(self._sock), getattr(params, "source", None)
        if guest is None or source is None:
            return params
        named: P = msgspec.structs.replace(params, source=f"{source} of uid {guest}")  # type: ignore[type-var]
        return named

    def _check_admitted(self) -> None:
        if self._over_cap:
            raise _Rejected(Code.BUSY, self.busy())
        if not self._greeted:
            text = f"the first request is hello with protocol {PROTOCOL_VERSION}"
            raise _Rejected(Code.INVALID_REQUEST, UsageError(text))

    @contextmanager
    def _until_hangup(self, deadline: asyncio.Timeout) -> Iterator[None]:
        """Within the `with` block, end the time until `deadline` when the client disconnects.

        The end of the client's stream does not show a disconnect: the client may have closed only
        its sending half. So the state of the socket is polled.
        """
        loop, period_s = asyncio.get_running_loop(), self._limits.hangup_poll_s
        timer: asyncio.TimerHandle

        def look() -> None:
            nonlocal timer
            if has_event(self._sock, 0):
                deadline.reschedule(loop.time())
            else:
                timer = loop.call_later(period_s, look)

        timer = loop.call_later(period_s, look)
        try:
            yield
        finally:
            timer.cancel()


def encode_failure(request_id: int | str | None, code: Code, error: RobotctlError) -> bytes:
    """Encode an error as one reply line."""
    return encode_error(request_id, code, str(error), error.exit_code, error.details())


def log_failure(what: str) -> None:
    """Log the exception that is being handled, with `what` as the message.

    A MemoryError is passed to the loop's exception handler, because it concerns the whole daemon.
    """
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
    """Encode one reply line; NaN and infinity, which stand for unknown values, become null."""
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


def _being_cancelled() -> bool:
    """Return whether this task is being cancelled; if not, a handler raised CancelledError."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
