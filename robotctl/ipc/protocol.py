"""The messages of the control socket, and the identity of the process at its other end.

    bytes -> LineBuffer.receive -> LineBuffer.next_line -> parse_request / parse_response
    request / result / error -> encode_* -> bytes with their newline

Each request gets one reply. There are no batches and no notifications.
"""

from __future__ import annotations

import json
import os
import re
import socket
import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, NamedTuple, NoReturn

from robotctl.base.errors import RobotctlError
from robotctl.base.trust import ROOT_UID

PROTOCOL_VERSION = 1

MAX_REQUEST_BYTES = 64 * 1024
"""Room for the longest request, `drive_path` with 2,000 points of 24 bytes."""

MAX_RESPONSE_BYTES = 8 * 1024 * 1024
"""Room for the longest answers, `graph` with 15,000 names and `path` with 20,000 points."""

MAX_DEPTH = 16
"""Limit on nested brackets, as the decoder recurses. The answer of `path` has the most, 4."""

MAX_ID_LENGTH = 64
MAX_ID = 2**53
"""The largest integer that every JSON implementation represents exactly."""

EMERGENCY_STOP_MODE = 3

MAX_MARK_LENGTH = 1000
"""In characters."""

MAX_REASON = 200
"""In characters."""

REASON_PATTERN = r"^[^\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069]*\Z"
"""Excludes characters that move the cursor, end the line or change the text direction."""

MAX_GRAPH_NAME = 255
"""In characters. A discovery message of Fast DDS has no room for a longer name."""


class Code(IntEnum):
    """The error codes of JSON-RPC 2.0, and those that robotctl adds."""

    PARSE_ERROR = -32700
    INVALID_REQUEST = -32600
    METHOD_NOT_FOUND = -32601
    INVALID_PARAMS = -32602
    INTERNAL_ERROR = -32603
    ROBOTCTL_ERROR = -32000
    BUSY = -32001
    TIMEOUT = -32002
    FORBIDDEN = -32003
    PROTOCOL_MISMATCH = -32004
    STOPPING = -32005


class ProtocolError(RobotctlError):
    """A received line is not a valid message. `request_id` is None without a valid id."""

    def __init__(self, code: Code, text: str, request_id: int | str | None = None) -> None:
        super().__init__(text)
        self.code = code
        self.request_id = request_id


# A NamedTuple: `dataclasses` imports `inspect`, which takes 10 ms.
class Request(NamedTuple):
    """A call. The peer sends exactly one reply with the same `id`."""

    id: int | str
    method: str
    params: dict[str, Any]


class Result(NamedTuple):
    """The reply to a request that succeeded."""

    id: int | str
    result: Any


class Failure(NamedTuple):
    """The reply to a request that failed. `id` is None if the request had no valid id."""

    id: int | str | None
    code: int
    message: str
    data: Any


class LineBuffer:
    """A buffer that splits a byte stream into lines of at most `limit` bytes."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._buffer = bytearray()
        self._searched = 0

    def receive(self, data: bytes) -> None:
        """Append received bytes."""
        self._buffer += data

    def next_line(self) -> bytes | None:
        """Return the next whole line without its newline, or None until more bytes arrive.

        Raises:
            ProtocolError: The line is longer than the limit; the rest of the stream is unusable.
        """
        end = self._buffer.find(b"\n", self._searched)
        if (len(self._buffer) if end < 0 else end) > self._limit:
            raise ProtocolError(Code.INVALID_REQUEST, f"a line is longer than {self._limit} bytes")
        if end < 0:
            self._searched = len(self._buffer)
            return None
        line = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        self._searched = 0
        return line


def encode_request(request_id: int, method: str, params: dict[str, Any]) -> bytes:
    """Encode one request line.

    Raises:
        ValueError: `params` contains NaN or infinity.
    """
    return _encode({"jsonrpc": "2.0", "id": request_id, "method": method, "params": params})


def encode_error(
    request_id: int | str | None,
    code: int,
    message: str,
    exit_code: int = 1,
    details: Mapping[str, Any] | None = None,
) -> bytes:
    """Encode one error line. `exit_code` is for the client's process.

    Raises:
        ValueError: `details` contains NaN or infinity.
    """
    error = {"code": code, "message": message, "data": {"exit_code": exit_code, **(details or {})}}
    return _encode({"jsonrpc": "2.0", "id": request_id, "error": error})


def parse_request(line: bytes) -> Request:
    """Parse one request line.

    Raises:
        ProtocolError: The line is not a request.
    """
    message = _parse_object(line)
    request_id = _id(message)
    if request_id is None:
        raise ProtocolError(
            Code.INVALID_REQUEST, f"id must be an integer, or text of at most {MAX_ID_LENGTH}"
        )
    if unknown := message.keys() - {"jsonrpc", "id", "method", "params"}:
        _invalid(f"unknown member {min(unknown)[:40]!r}", request_id)
    method = message.get("method")
    if not isinstance(method, str):
        _invalid("method must be text", request_id)
    params = message.get("params", {})
    if not isinstance(params, dict):
        _invalid("params must be an object", request_id)
    return Request(request_id, method, params)


def parse_response(line: bytes) -> Result | Failure:
    """Parse one reply line.

    Raises:
        ProtocolError: The line is not a reply.
    """
    message = _parse_object(line)
    request_id = _id(message)
    if ("result" in message) == ("error" in message):
        _invalid("a reply holds either a result or an error", request_id)
    if "result" in message:
        if request_id is None:
            _invalid("a result names the request that it answers", request_id)
        return Result(request_id, message["result"])
    error = message["error"]
    if not isinstance(error, dict):
        _invalid("error must be an object", request_id)
    code, text = error.get("code"), error.get("message")
    if type(code) is not int or not isinstance(text, str):
        _invalid("an error holds an integer code and a message", request_id)
    return Failure(request_id, code, text, error.get("data"))


def is_emergency_stop(request: Request) -> bool:
    """Return whether `request` is an emergency stop, which the server always admits."""
    mode = request.params.get("mode")
    return request.method == "set_mode" and type(mode) is int and mode == EMERGENCY_STOP_MODE


def _encode(message: dict[str, Any]) -> bytes:
    return json.dumps(message, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _invalid(text: str, request_id: int | str | None) -> NoReturn:
    raise ProtocolError(Code.INVALID_REQUEST, text, request_id)


def _id(message: dict[str, Any]) -> int | str | None:
    """Return the id of the message, or None if it is missing or not valid."""
    value = message.get("id")
    if isinstance(value, str) and len(value) <= MAX_ID_LENGTH:
        return value
    if type(value) is int and abs(value) <= MAX_ID:
        return value
    return None


def _parse_object(line: bytes) -> dict[str, Any]:
    """Decode one JSON-RPC object. Refuse duplicate members, NaN, infinity and deep nesting."""
    _check_depth(line)
    try:
        message = _DECODER.decode(line.decode())
        if b"\\u" in line:
            json.dumps(message, ensure_ascii=False).encode()  # refuses half a surrogate pair
    except ValueError as error:  # UnicodeError and JSONDecodeError are ValueErrors
        raise ProtocolError(Code.PARSE_ERROR, f"not a JSON object on one line: {error}") from None
    if not isinstance(message, dict):
        raise ProtocolError(Code.INVALID_REQUEST, "not an object (batches are not taken)")
    if message.get("jsonrpc") != "2.0":
        _invalid('jsonrpc must be "2.0"', _id(message))
    return message


_STRING_OR_BRACKET = re.compile(rb'"(?:[^"\\]|\\.)*+"?|[\[{]|[\]}]', re.DOTALL)


def _check_depth(line: bytes) -> None:
    """Raise ProtocolError for a line nested deeper than MAX_DEPTH, before it is decoded."""
    if line.count(b"[") + line.count(b"{") <= MAX_DEPTH:
        return
    depth = 0
    for token in _STRING_OR_BRACKET.finditer(line):
        first = line[token.start()]
        if first in b"[{":
            depth += 1
            if depth > MAX_DEPTH:
                raise ProtocolError(Code.PARSE_ERROR, f"nested deeper than {MAX_DEPTH} levels")
        elif first in b"]}":
            depth -= 1


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) != len(pairs):
        raise ValueError("a member appears twice")
    return members


def _finite(text: str) -> float:
    value = float(text)
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"{text[:40]} is out of range")
    return value


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number")


_DECODER = json.JSONDecoder(
    object_pairs_hook=_unique, parse_float=_finite, parse_constant=_no_constant
)


_UCRED = struct.Struct("iII")

SO_PEERGROUPS: Final = 59
"""A socket option of asm-generic/socket.h that Python lacks."""

_GROUPS_BYTES: Final = 1024
"""The largest buffer for Python's `getsockopt`, with room for 256 groups."""


class Peer(NamedTuple):
    """A process (struct ucred of unix(7)). `pid` is 0 for a process in another pid namespace."""

    pid: int
    uid: int
    gid: int


def peer_of(sock: socket.socket) -> Peer:
    """Return the process at the other end, as it was at its `connect` or `listen`."""
    raw = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
    return Peer(*_UCRED.unpack(raw))


def groups_of(sock: socket.socket) -> frozenset[int]:
    """Return the gids of the process at the other end. Above 256, return only the primary gid."""
    primary = peer_of(sock).gid
    try:
        raw = sock.getsockopt(socket.SOL_SOCKET, SO_PEERGROUPS, _GROUPS_BYTES)
    except OSError:  # more than 256 groups
        return frozenset((primary,))
    return frozenset((primary, *struct.unpack(f"{len(raw) // 4}I", raw)))


def guest_of(sock: socket.socket) -> int | None:
    """Return the uid of the process at the other end, or None if it is root's or our own."""
    uid = peer_of(sock).uid
    return None if uid in (ROOT_UID, os.getuid()) else uid
