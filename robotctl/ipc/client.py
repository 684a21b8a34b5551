"""The blocking client of the control socket, on the standard library alone."""

from __future__ import annotations

import socket
import struct
import time
from typing import Any, Self, TypeVar, overload

from robotctl.base.errors import (
    IN_PARENTHESES,
    NoDaemon,
    Refused,
    RobotctlError,
    UsageError,
    error_for_exit_code,
)
from robotctl.base.paths import DEFAULT_ROBOT, chain_to, socket_path
from robotctl.base.trust import user_text
from robotctl.ipc.method_names import MethodName
from robotctl.ipc.protocol import (
    MAX_RESPONSE_BYTES,
    PROTOCOL_VERSION,
    Code,
    Failure,
    LineBuffer,
    ProtocolError,
    Request,
    Result,
    encode_request,
    is_emergency_stop,
    parse_response,
    peer_of,
)

CALL_DEADLINE_S = 12.0
"""Longer than the server's usual deadline, so that the server's timeout error still arrives."""

LIVENESS_S = 5.0
"""The time between two checks, in a call without a deadline, that the daemon still replies."""

_RECEIVE_BYTES = 65536
_TIMEVAL = struct.Struct("ll")
_HELLO_ID = 0

A = TypeVar("A")


class NoAnswer(NoDaemon):
    """A running daemon did not reply. It may or may not carry out the request."""


@overload
def call(
    robot: str,
    method: MethodName[A],
    params: dict[str, Any] | None = None,
    *,
    deadline_s: float | None = CALL_DEADLINE_S,
) -> A: ...
@overload
def call(
    robot: str,
    method: str,
    params: dict[str, Any] | None = None,
    *,
    deadline_s: float | None = CALL_DEADLINE_S,
) -> Any: ...
def call(
    robot: str,
    method: str,
    params: dict[str, Any] | None = None,
    *,
    deadline_s: float | None = CALL_DEADLINE_S,
) -> object:
    """Open a connection, make one call and return its result, as `Client.call` does."""
    with Client(robot) as client:
        return client.call(method, params, deadline_s=deadline_s)


class Client:
    """A connection to the daemon of `robot`, open within the `with` block.

    After a call has raised NoDaemon, open a new client.

    Raises:
        NoDaemon: The socket does not exist, or no process listens on it.
        Refused: A process of another user listens on it.
        UsageError: `robot` is not a valid name, or another user could have created the socket.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._path = socket_path(robot)
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._lines = LineBuffer(MAX_RESPONSE_BYTES)
        self._greeted = False
        self._last_id = _HELLO_ID

    def __enter__(self) -> Self:
        try:
            self._connect()
        except BaseException:
            self._sock.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._sock.close()

    def _connect(self) -> None:
        chain = chain_to(self._path.parent).for_client()
        # SO_SNDTIMEO, and not settimeout: a non-blocking connect fails at once on a full backlog.
        try:
            chain.check()
            self._set_timeout(socket.SO_SNDTIMEO, CALL_DEADLINE_S)
            self._sock.connect(str(self._path))
            server = peer_of(self._sock)
            is_trusted = chain.trusts(server.uid)
        except (FileNotFoundError, NotADirectoryError, ConnectionRefusedError):
            raise no_daemon(self._robot) from None
        except BlockingIOError:
            raise self._no_answer(f"did not answer within {CALL_DEADLINE_S:g} s") from None
        except PermissionError:
            raise Refused(f"{self._path} belongs to another user") from None
        if not is_trusted:
            raise Refused(
                f"the process at {self._path} belongs to {user_text(server.uid)}, neither you "
                "nor root: nothing was sent",
                f"see which it is: ps -fp {server.pid}" if server.pid else "",
                sentence=IN_PARENTHESES,
            )

    @property
    def daemon_pid(self) -> int:
        """The pid of the daemon, or 0 if the daemon is in another pid namespace."""
        return peer_of(self._sock).pid

    @overload
    def call(
        self,
        method: MethodName[A],
        params: dict[str, Any] | None = None,
        *,
        deadline_s: float | None = CALL_DEADLINE_S,
    ) -> A: ...
    @overload
    def call(
        self,
        method: str,
        params: dict[str, Any] | None = None,
        *,
        deadline_s: float | None = CALL_DEADLINE_S,
    ) -> Any: ...
    def call(
        self,
        method: str,
        params: dict[str, Any] | None = None,
        *,
        deadline_s: float | None = CALL_DEADLINE_S,
    ) -> object:
        """Call `method` in the daemon and return its result.

        If `deadline_s` is None, wait without limit while the daemon replies to a hello every
        LIVENESS_S.

        Raises:
            NoAnswer: The daemon did not answer in time, or closed the connection.
            RobotctlError: The daemon replied with an error; its exit code selects the class.
        """
        self._last_id += 1
        request = Request(self._last_id, method, params or {})
        lines = encode_request(self._last_id, method, request.params)
        hello = not self._greeted
        if hello:  # in one write with the request, to save a round trip
            params_of_hello = {"protocol": PROTOCOL_VERSION}
            lines = encode_request(_HELLO_ID, "hello", params_of_hello) + lines
        until = None if deadline_s is None else time.monotonic() + deadline_s
        refusal: Refused | None = None
        try:
            self._write(lines)
            if hello:
                refusal = self._greet(until)
                if refusal and not is_emergency_stop(request):  # the daemon accepts it anyway
                    raise refusal
            return self._result(self._last_id, until)
        except TimeoutError:
            within_s = deadline_s or LIVENESS_S
            raise self._no_answer(f"did not answer within {within_s:g} s") from None
        except ConnectionError:
            closed = self._no_answer("closed the connection before it answered")
            raise refusal or closed from None
        except ProtocolError as error:
            raise RobotctlError(f"the daemon of robot {self._robot!r} answered: {error}") from error

    def _greet(self, until: float | None) -> Refused | None:
        """Read the reply to hello. Return the refusal, or None if the client is accepted."""
        try:
            version = self._result(_HELLO_ID, until).get("protocol")
        except Refused as refusal:
            return refusal
        if version != PROTOCOL_VERSION:
            return Refused(
                f"the daemon speaks protocol {version!r}, this client {PROTOCOL_VERSION}",
                f"stop it with kill {self.daemon_pid} and start again",
            )
        self._greeted = True
        return None

    def _result(self, request_id: int, until: float | None) -> dict[str, Any]:
        reply = parse_response(self._read_line(until))
        if isinstance(reply, Failure) and reply.id in (request_id, None):
            raise _error(reply)
        if reply.id != request_id or not isinstance(reply, Result):
            raise ProtocolError(Code.INVALID_REQUEST, f"a reply to another request: {reply.id!r}")
        if not isinstance(reply.result, dict):
            raise ProtocolError(Code.INVALID_REQUEST, "a result that is not an object")
        return reply.result

    def _write(self, lines: bytes) -> None:
        try:
            self._sock.sendall(lines)
        except BlockingIOError:
            raise TimeoutError from None
        except BrokenPipeError:
            pass  # the daemon closed the connection; its reason can still be read

    def _read_line(self, until: float | None) -> bytes:
        """Return the next line.

        Raises:
            TimeoutError: No complete line arrived in time.
            ConnectionError: The daemon closed the connection.
            ProtocolError: The line is too long.
        """
        while (line := self._lines.next_line()) is None:
            remaining = LIVENESS_S if until is None else until - time.monotonic()
            if remaining <= 0:
                raise TimeoutError
            self._set_timeout(socket.SO_RCVTIMEO, remaining)
            try:
                data = self._sock.recv(_RECEIVE_BYTES)
            except BlockingIOError:
                if until is None:
                    self._check_alive()
                continue
            if not data:
                raise ConnectionResetError
            self._lines.receive(data)
        return line

    def _check_alive(self) -> None:
        """Raise NoDaemon, TimeoutError or ConnectionError if a new connection gets no hello."""
        with Client(self._robot) as other:
            other._write(encode_request(_HELLO_ID, "hello", {"protocol": PROTOCOL_VERSION}))
            other._greet(time.monotonic() + LIVENESS_S)

    def _set_timeout(self, option: int, seconds: float) -> None:
        microseconds = max(1, int(seconds * 1e6))  # 0 would mean no timeout
        value = _TIMEVAL.pack(*divmod(microseconds, 1_000_000))
        self._sock.setsockopt(socket.SOL_SOCKET, option, value)

    def _no_answer(self, what: str) -> NoAnswer:
        return NoAnswer(
            f"the daemon of robot {self._robot!r} {what}",
            f"see: {command_for(self._robot, 'logs')}",
            sentence=IN_PARENTHESES,
        )


def no_daemon(robot: str) -> NoDaemon:
    """Return the error for a `robot` without a daemon, with the command to start one."""
    return NoDaemon(
        f"no daemon for robot {robot!r}",
        f"start one with: {command_for(robot, 'start')}",
        sentence=IN_PARENTHESES,
    )


def command_for(robot: str, command: str) -> str:
    """Return the command line of `command` for `robot`, without `--robot` for the default robot."""
    return f"robotctl {command}" + ("" if robot == DEFAULT_ROBOT else f" --robot {robot}")


def _error(failure: Failure) -> RobotctlError:
    data = failure.data
    exit_code = data.get("exit_code") if isinstance(data, dict) else None
    if isinstance(exit_code, int):
        return error_for_exit_code(exit_code, failure.message, data)
    if failure.code == Code.INVALID_PARAMS:
        return UsageError(failure.message)
    return RobotctlError(failure.message)
