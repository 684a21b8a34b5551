"""From one request to its reply: check it, decode it, call the handler, encode the result."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from robotctl.errors import Refused, RobotctlError, UsageError
from robotctl.ipc.answers import Hello
from robotctl.ipc.client_limits import ClientLimits
from robotctl.ipc.deadline import Deadline, DeadlineMissed
from robotctl.ipc.method import Method
from robotctl.ipc.params import HelloParams, decode
from robotctl.ipc.peer import guest_of
from robotctl.ipc.protocol import (
    MAX_RESPONSE_BYTES,
    PROTOCOL_VERSION,
    Code,
    Request,
    encode_error,
    is_emergency_stop,
)
from robotctl.ipc.readiness import is_hung_up

_log = logging.getLogger(__name__)

P = TypeVar("P")

_encoder = msgspec.json.Encoder()


@dataclass(frozen=True, slots=True)
class Identity:
    """The daemon's identity, which `hello` returns to the client."""

    robot: str
    version: str
    pid: int


class _Rejected(Exception):
    """A request that did not reach its handler, or that exceeded its deadline there."""

    def __init__(self, code: Code, cause: RobotctlError) -> None:
        super().__init__(str(cause))
        self.code = code
        self.cause = cause


class RequestHandler:
    """The handler of one connection's requests, one at a time."""

    def __init__(
        self,
        sock: socket.socket,
        methods: Mapping[str, Method[Any]],
        identity: Identity,
        limits: ClientLimits,
        deadline: Deadline,
        *,
        over_cap: bool,
    ) -> None:
        """`over_cap` says that only an emergency stop is taken; `sock` shows a disconnect."""
        self._deadline = deadline
        self._sock = sock
        self._methods = methods
        self._identity = identity
        self._limits = limits
        self._over_cap = over_cap
        self._greeted = False

    async def reply(self, request: Request) -> bytes | bytearray:
        """Carry out a request and return its one reply, for any failure of the handler.

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
        """Return the error for a client above the limit."""
        return Refused(f"the daemon is busy with {self._limits.clients} clients", "try again")

    async def _call(self, request: Request) -> object:
        """Return the handler's result.

        Raises:
            _Rejected: The handler was not called, or was late.
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
            with self._deadline.within(method.deadline_s):
                if method.deadline_s is not None:
                    return await method.handler(params)
                with self._until_hangup():
                    return await method.handler(params)
        except DeadlineMissed:
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
        """Return the parameters with the uid of a guest, which Linux tells, behind its name."""
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
    def _until_hangup(self) -> Iterator[None]:
        """Let the deadline be missed when the client disconnects.

        The end of the client's stream is not enough: it may have closed its sending half only. So
        the socket itself is checked.
        """
        loop, period_s = asyncio.get_running_loop(), self._limits.hangup_poll_s
        timer: asyncio.TimerHandle

        def look() -> None:
            nonlocal timer
            if is_hung_up(self._sock):
                self._deadline.miss()
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
    """Log the exception that is being handled.

    A MemoryError is passed to the loop's exception handler, which decides for the whole daemon.
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
    """Encode one reply line; NaN and infinity, the unknown values of ROS, become null."""
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
    """Return whether a CancelledError is for this task, and not a bug of the handler."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
